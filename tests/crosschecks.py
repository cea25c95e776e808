"""A cross-check as tests run it, and mirrors with a fault in them to be found."""

from __future__ import annotations

import ast
import sys
from pathlib import Path
from types import ModuleType
from typing import cast

import mcp_asdf.fixed_point
import mcp_asdf.mirror
from mcp_asdf.mirror import MirrorRobot
from mcp_asdf.robot import Status
from mcp_asdf_tools.crosscheck.compare import Check, Failure, Firmware, compare_firmwares, crosscheck
from mcp_asdf_tools.crosscheck.oracle import Audit

MIRROR, FIXED_POINT = mcp_asdf.mirror, mcp_asdf.fixed_point
SOURCES = {
    module: Path(cast(str, module.__file__)).read_text(encoding="utf-8") for module in (MIRROR, FIXED_POINT)
}
"""The arithmetic of the mirror."""
ROBOT = "robot:2:1:64:0:2147483648"
"""Of a scenario."""
SEED = 1
CALLS = 40_000
"""Maximum number of calls to catch a fault; most take a few hundred."""


def silent(done: int) -> None:
    """Report nothing."""


def judged(left: Firmware, right: Firmware) -> Check:
    """A check that compares two firmwares and judges them."""
    audit = Audit()
    return lambda scenario: compare_firmwares(scenario, left, right, audit.judge)


def caught(check: Check, calls: int = CALLS) -> Failure | None:
    """The first failure that the check finds."""
    return crosscheck(check, SEED, calls, silent).failure


def module_of(original: ModuleType, source: str | ast.Module) -> ModuleType:
    """A module of another source, under the name of the original."""
    module = ModuleType(original.__name__)
    exec(compile(source, f"changed {original.__name__}", "exec"), vars(module))
    return module


def copy_of_mirror(changed: ModuleType, source: str | ast.Module) -> Firmware:
    """The robot of a mirror in which one of SOURCES has changed."""
    if changed is MIRROR:
        return cast(Firmware, module_of(MIRROR, source).MirrorRobot)
    sys.modules[changed.__name__] = module_of(changed, source)
    try:
        return cast(Firmware, module_of(MIRROR, SOURCES[MIRROR]).MirrorRobot)
    finally:
        sys.modules[changed.__name__] = changed


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
    "restore": ("repeated=words[27] >> 16", "repeated=words[27] >> 16 & 0x7FFF"),
}
"""Lines of SOURCES, and the same with one bit wrong."""


def planted(fault: str) -> Firmware:
    """A copy of the mirror with one of FAULTS."""
    right, wrong = FAULTS[fault]
    counts = {module: source.count(right) for module, source in SOURCES.items()}
    assert sum(counts.values()) == 1, f"the mirror's source has changed: plant {fault!r} anew"
    module = max(counts, key=counts.__getitem__)
    return copy_of_mirror(module, SOURCES[module].replace(right, wrong))


class BrokenRobot(MirrorRobot):
    """Fails in a way no firmware may."""

    def settle(self) -> Status:
        raise ZeroDivisionError("in settle")
