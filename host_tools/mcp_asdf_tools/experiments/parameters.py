"""The words that describe experiments in files, on the command line and in results."""

from __future__ import annotations

from enum import Enum


class Topology(Enum):
    """Which robots hear each other."""

    FULLY_CONNECTED = "fully_connected"
    """Every robot hears every other, in the same tick."""
    DYNAMIC = "dynamic"
    """Robots move through an arena and hear those nearby; see docs/arena.md."""


class Floor(Enum):
    """The floor that moving robots observe."""

    TILES = "tiles"
    """Square tiles, each black with probability f; every trial has its own."""
    CODE = "code"
    """A pattern like a QR code's of which exactly the share f is black, the same in all trials."""
    PICTURE = "picture"
    """A black and white picture, stretched over the floor."""


class Mode(Enum):
    """Which robots re-estimate their assumed accuracy."""

    NONE = "none"
    ASDF_MINUS = "asdf_minus"
    """Only the flawed ones."""
    ASDF_PLUS = "asdf_plus"
    """All."""


class Activation(Enum):
    """When they do, every ``filter_period`` steps."""

    ADAPTIVE = "adaptive"
    """If the hypothesis test rejects (eq. 12)."""
    ALWAYS = "always"
    """Without a test."""


class Convention(Enum):
    """Whose reading of the equations the reference firmware follows; see ``mcp_asdf.reference``."""

    PAPER = "paper"
    AUTHORS = "authors"


class Drift(Enum):
    """How the true accuracy changes, from b at the first step; ``k`` counts steps from 0."""

    NONE = "none"
    LINEAR = "linear"
    """b + drift_rate k."""
    STEPPED = "stepped"
    """b + drift_rate k, with k rounded down to a multiple of drift_period."""
    WIENER = "wiener"
    """b + drift_rate k + drift_diffusion W(k): a Wiener process with drift of its own for every robot."""

    @property
    def is_random(self) -> bool:
        """Whether trials differ in it."""
        return self is Drift.WIENER
