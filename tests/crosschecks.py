"""Cross-checks as tests run them, and mirrors with a planted fault for them to find."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from types import ModuleType
from typing import cast
from unittest.mock import patch

import mcp_asdf.arithmetic
import mcp_asdf.fixed_point
import mcp_asdf.mirror
import mcp_asdf.robust_filter
from mcp_asdf.mirror import MirrorRobot
from mcp_asdf.robot import Status
from mcp_asdf_tools.crosscheck.compare import (
    CheckScenario,
    Failure,
    Firmware,
    compare_firmwares,
    run_crosscheck,
)
from mcp_asdf_tools.crosscheck.oracle import Audit

SOURCES = {
    module.__name__: Path(cast(str, module.__file__)).read_text(encoding="utf-8")
    for module in (mcp_asdf.fixed_point, mcp_asdf.arithmetic, mcp_asdf.robust_filter, mcp_asdf.mirror)
}
"""Sources of the mirror's arithmetic by module, in the order of their imports."""
ROBOT = "robot:2:1:64:0:2147483648"
"""The robot of a scenario, without a filter."""
SEED = 1
CALLS = 40_000
"""Maximum number of calls to find a fault; most take a few hundred."""


def check_with_audit(first: Firmware, second: Firmware) -> CheckScenario:
    """Return a check that compares two firmwares, and checks the first against the oracle."""
    audit = Audit()
    return lambda scenario: compare_firmwares(scenario, first, second, audit.check_call)


def find_failure(check_scenario: CheckScenario, calls: int = CALLS) -> Failure | None:
    """Return the first failure of the check in so many calls of random scenarios."""
    return run_crosscheck(check_scenario, SEED, calls, lambda calls_made: None).failure


FAULTS = {
    "estimate: what says nothing": "INFORMATIVE_G = 1 << {20 => 21}",
    "estimate: c t": "errors = multiply_high({accuracy.c => (accuracy.c ^ 1)}, total)",
    "estimate: mirror image": "return {ONE => (ONE ^ 1)} - x_hat if is_mirrored",
    "alpha_word: cap": "if exponent > {SHIFT_MAX => SHIFT_MAX ^ 1}:",
    "mean": "// (closed.alpha + own_alpha{ =>  | 1})",
    "test": "{table.entry(m) => (table.entry(m) ^ 1)} * scaled_variance",
    "test: fewest messages": "= {2 => 3} if config.filter == Filter.ADAPTIVE",
    "halving: ties to even": "s.n = {round(s.n / 2) => s.n // 2}",
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
    "robust: way back": "return None if is_initial else {crowd.first => None}",
    "restore": "repeated=accepted_and_repeated >> 16{ =>  & 0x7FFF}",
}
"""Faults by name, as `mirror_with` reads them: places in SOURCES and what is wrong there, often one bit."""


def mirror_with(*changes: str) -> Firmware:
    """Return the mirror with changes in its source.

    A change ``before {right => wrong} after`` replaces ``before right after``, which must be unique in the
    sources, by ``before wrong after``.
    """
    sources = dict(SOURCES)
    for change in changes:
        match = re.fullmatch(r"(.*?)\{(.*?) => (.*)\}(.*)", change, re.DOTALL)
        assert match is not None
        before, right, wrong, after = match.groups()
        right_text, wrong_text = before + right + after, before + wrong + after
        occurrences = sum(source.count(right_text) for source in sources.values())
        assert occurrences == 1, f"{change!r} occurs {occurrences} times: plant it anew"
        sources = {name: source.replace(right_text, wrong_text) for name, source in sources.items()}
    with patch.dict(sys.modules):
        for name, source in sources.items():
            sys.modules[name] = ModuleType(name)
            exec(compile(source, f"changed {name}", "exec"), vars(sys.modules[name]))
        return cast(Firmware, sys.modules[mcp_asdf.mirror.__name__].MirrorRobot)


class BrokenRobot(MirrorRobot):
    """Raises an exception that no firmware may raise."""

    def settle(self) -> Status:
        raise ZeroDivisionError("in settle")
