"""A cross-check as tests run it, and mirrors with a fault in them to be found."""

from __future__ import annotations

import sys
from pathlib import Path
from types import ModuleType
from typing import cast
from unittest.mock import patch

import mcp_asdf.fixed_point
import mcp_asdf.mirror
from mcp_asdf.mirror import MirrorRobot
from mcp_asdf.robot import Status
from mcp_asdf_tools.crosscheck.compare import Check, Failure, Firmware, compare_firmwares, crosscheck
from mcp_asdf_tools.crosscheck.oracle import Audit

SOURCES = {
    module.__name__: Path(cast(str, module.__file__)).read_text(encoding="utf-8")
    for module in (mcp_asdf.fixed_point, mcp_asdf.mirror)
}
"""The arithmetic of the mirror, in the order of imports."""
ROBOT = "robot:2:1:64:0:2147483648"
"""Of a scenario."""
SEED = 1
CALLS = 40_000
"""Maximum number of calls to catch a fault; most take a few hundred."""


def judged(left: Firmware, right: Firmware) -> Check:
    """A check that compares two firmwares and judges them."""
    audit = Audit()
    return lambda scenario: compare_firmwares(scenario, left, right, audit.judge)


def caught(check: Check, calls: int = CALLS) -> Failure | None:
    """The first failure that the check finds."""
    return crosscheck(check, SEED, calls, lambda done: None).failure


FAULTS = {
    "estimate: what says nothing": ("INFORMATIVE_G = 1 << 20", "INFORMATIVE_G = 1 << 21"),
    "estimate: c t": ("least = accuracy.c * total", "least = (accuracy.c ^ 1) * total"),
    "estimate: mirror image": ("return ONE - x_hat if mirrored", "return (ONE ^ 1) - x_hat if mirrored"),
    "alpha_word: cap": ("if exponent > SHIFT_MAX:", "if exponent > SHIFT_MAX ^ 1:"),
    "mean": ("// (closed.alpha + own)", "// (closed.alpha + own | 1)"),
    "test": ("table.entry(m) * spread", "(table.entry(m) ^ 1) * spread"),
    "test: fewest messages": ("(2 if mode == Filter.ADAPTIVE", "(3 if mode == Filter.ADAPTIVE"),
    "halving: ties to even": ("s.n >> 1 & 1) >> 1", "s.n >> 1 & 0) >> 1"),
    "counters": ("COUNTER_MASK = 0xFFFF", "COUNTER_MASK = 0xFFFE"),
    "filter period": ("if s.filter_left == 0:", "if s.filter_left <= 1:"),
    "vote: gain": ("crowd.votes.bit_length() - 3, 3)", "crowd.votes.bit_length() - 3, 2)"),
    "vote: clamp": ("step = min(distance, crowd.spread) >> shift", "step = distance >> shift"),
    "vote: spread": ("if distance > crowd.spread else", "if distance >= crowd.spread else"),
    "vote: trend": ("if step == 0:", "if distance == 0:"),
    "vote: without confidence": ("elif alpha >> 8:", "elif alpha:"),
    "robust: moving": ("1 << 13 <= self.trend", "1 << 13 < self.trend"),
    "robust: votes that halve": ("if crowd.votes >= 2 * VOTES_MOVED", "if crowd.votes > 2 * VOTES_MOVED"),
    "robust: voices": ("if crowd.voices.bit_count() < 3:", "if crowd.voices.bit_count() < 2:"),
    "robust: test": ("SIGMAS_SQUARED = 12", "SIGMAS_SQUARED = 13"),
    "robust: variance": ("variance = max(", "variance = min("),
    "robust: way back": ("return crowd.first if s.accuracy", "return None if s.accuracy"),
    "restore": ("repeated=words[27] >> 16", "repeated=words[27] >> 16 & 0x7FFF"),
}
"""Lines of SOURCES, and the same with one bit wrong."""


def planted(fault: str) -> Firmware:
    """A copy of the mirror with one of FAULTS."""
    right, wrong = FAULTS[fault]
    places = sum(source.count(right) for source in SOURCES.values())
    assert places == 1, f"the mirror's source has changed: plant {fault!r} anew"
    with patch.dict(sys.modules):
        for name, source in SOURCES.items():
            sys.modules[name] = ModuleType(name)
            exec(compile(source.replace(right, wrong), f"changed {name}", "exec"), vars(sys.modules[name]))
        return cast(Firmware, sys.modules[mcp_asdf.mirror.__name__].MirrorRobot)


class BrokenRobot(MirrorRobot):
    """Fails in a way no firmware may."""

    def settle(self) -> Status:
        raise ZeroDivisionError("in settle")
