"""A cross-check as tests run it, and mirrors with a fault in them to be found."""

from __future__ import annotations

import re
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
    "estimate: what says nothing": "INFORMATIVE_G = 1 << {20 => 21}",
    "estimate: c t": "errors = {accuracy.c => (accuracy.c ^ 1)} * total",
    "estimate: mirror image": "return {ONE => (ONE ^ 1)} - x_hat if is_mirrored",
    "alpha_word: cap": "if exponent > {SHIFT_MAX => SHIFT_MAX ^ 1}:",
    "mean": "// (closed.alpha + own_alpha{ =>  | 1})",
    "test": "{table.entry(m) => (table.entry(m) ^ 1)} * spread",
    "test: fewest messages": "= {2 => 3} if config.filter == Filter.ADAPTIVE",
    "halving: ties to even": "(s.n >> 1 & {1 => 0})) >> 1",
    "counters": "COUNTER_MASK = {0xFFFF => 0xFFFE}",
    "filter period": "if s.filter_left {== 0 => <= 1}:",
    "vote: gain": "VOTES_OF_MAX_GAIN = {32 => 16}",
    "vote: clamp": "step = {min(distance, crowd.spread) => distance} >> gain_shift",
    "vote: spread": "if distance {> => >=} crowd.spread else",
    "vote: trend": "if {step => distance} == 0:",
    "vote: without confidence": "elif {alpha >> 8 => alpha}:",
    "robust: moving": "TREND_MOVING_DOWN {<= => <} self.trend",
    "robust: votes that halve": "if crowd.votes {>= => >} 2 * VOTES_MIN_WHILE_MOVING",
    "robust: voices": "SENDERS_MIN = {3 => 2}",
    "robust: test": "SIGMAS_SQUARED = {12 => 13}",
    "robust: variance": "variance = {max => min}(",
    "robust: way back": "return {crowd.first => None} if s.accuracy",
    "restore": "repeated=words[27] >> 16{ =>  & 0x7FFF}",
}
"""Places of SOURCES and how they become wrong, often by one bit: ``mirror_with`` reads them."""


def mirror_with(*changes: str) -> Firmware:
    """A copy of the mirror in which ``before {right => wrong} after`` has become ``before wrong after``."""
    sources = dict(SOURCES)
    for change in changes:
        found = re.fullmatch(r"(.*?)\{(.*?) => (.*)\}(.*)", change, re.DOTALL)
        assert found is not None
        before, right, wrong, after = found.groups()
        place, become = before + right + after, before + wrong + after
        assert sum(source.count(place) for source in sources.values()) == 1, f"plant {change!r} anew"
        sources = {name: source.replace(place, become) for name, source in sources.items()}
    with patch.dict(sys.modules):
        for name, source in sources.items():
            sys.modules[name] = ModuleType(name)
            exec(compile(source, f"changed {name}", "exec"), vars(sys.modules[name]))
        return cast(Firmware, sys.modules[mcp_asdf.mirror.__name__].MirrorRobot)


class BrokenRobot(MirrorRobot):
    """Fails in a way no firmware may."""

    def settle(self) -> Status:
        raise ZeroDivisionError("in settle")
