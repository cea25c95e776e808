"""The stage of a run whose parameters are known."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mcp_asdf_tools.common import plain_value
from mcp_asdf_tools.robots import Filtering, Population
from mcp_asdf_tools.view.film import Stage
from mcp_asdf_tools.world import Arena, Floor, Graph, code

_MOST_PIXELS = 800
"""Along a side of the floor: more than a page shows."""
_MODES = {
    Filtering.ASDF_PLUS: "ASDF+",
    Filtering.ASDF_MINUS: "ASDF\N{MINUS SIGN}",
    Filtering.NONE: "no filter",
}


def stage_of(population: Population, trial: int = 0) -> Stage:
    """The stage of a trial. Raises UsageError if its arena cannot be made."""
    settings = population
    moves = settings.is_dynamic
    return Stage(
        _title(settings, trial),
        range(settings.robots),
        range(settings.flawed),
        settings.fill_ratio,
        settings.steps,
        settings.steps_per_second,
        settings.comms_period,
        settings.sides if moves else None,
        settings.radio_range if moves else None,
        floor_of(Arena(settings, trial)) if moves else None,
    )


def floor_of(arena: Arena) -> NDArray[np.bool_]:
    """The floor, a pixel for each tile, or as many as a page shows. O(pixels)."""
    settings = arena.settings
    if settings.floor is Floor.CODE:
        return code(settings.fill_ratio)
    return arena.pixels(*(min(math.ceil(side / settings.tile), _MOST_PIXELS) for side in settings.sides))


def _title(settings: Population, trial: int) -> str:
    words = [
        f"{settings.robots} robots",
        f"{settings.flawed} flawed",
        _MODES[settings.filter],
        f"\N{GREEK SMALL LETTER TAU} = {settings.filter_period}",
        _topology(settings),
        f"seed {settings.seed}" + (f", trial {trial}" if trial else ""),
    ]
    if settings.filter is Filtering.NONE:
        del words[3]
    return ", ".join(words)


def _topology(settings: Population) -> str:
    if isinstance(settings.graph, Graph):
        return Path(settings.graph.source).name
    if settings.is_dynamic:
        return "moving"
    return str(plain_value(settings.topology)).replace("-", " ")
