"""The cross-check finds a single wrong bit in the mirror, and by its oracle what both firmwares do wrong."""

from __future__ import annotations

import pytest

from crosschecks import FAULTS, compare_with_oracle, find_failure, mirror_with
from mcp_asdf.mirror import MirrorRobot
from mcp_asdf.native import NativeRobot
from support import slow

QUICK_FAULTS = (
    "estimate: c t",
    "alpha_word: cap",
    "mean",
    "test",
    "counters",
    "slot: ids up to 31",
    "vote: clamp",
    "dispersion: weight",
    "table: median",
    "robust test: variance",
)
"""Faults that each run of the tests plants; the others are for the slow tests."""
SLOW_FAULTS = tuple(fault for fault in FAULTS if fault not in QUICK_FAULTS)


@pytest.mark.parametrize("fault", [*QUICK_FAULTS, *slow(SLOW_FAULTS)])
def test_random_scenarios_show_a_fault_that_only_one_firmware_has(fault: str) -> None:
    """The fault, which has a name, is one wrong place in the source of the mirror, the firmware in Python.

    The failure has random calls. The C and this mirror give different results for them. With the
    right mirror the same calls give equal results.
    """
    faulty_mirror = mirror_with(FAULTS[fault])
    failure = find_failure(NativeRobot, faulty_mirror)
    assert failure is not None
    failure_without_fault = compare_with_oracle(failure.scenario, NativeRobot, MirrorRobot)

    assert failure_without_fault is None, "something else than the fault was found"


@pytest.mark.parametrize(
    "fault",
    [
        "alpha_word: cap",
        "mean",
        "test",
        "vote: clamp",
        "table: median",
        *slow(
            [
                "estimate: what says nothing",
                "estimate: mirror image",
                "test: fewest messages",
                "filter period",
                *(name for name in FAULTS if name.startswith(("slot:", "vote:", "batch:", "dispersion:"))),
                *(name for name in FAULTS if name.startswith(("table:", "robust test:", "robust:"))),
                "supporters: the other way",
            ]
        ),
    ],
)
def test_exact_arithmetic_shows_a_fault_that_both_firmwares_have(fault: str) -> None:
    """Two robots in Python with the same fault agree, so only exact arithmetic can find a failure.

    ``find_failure`` compares the first robot with it.
    """
    faulty_mirror = mirror_with(FAULTS[fault])
    failure = find_failure(faulty_mirror, faulty_mirror)
    assert failure is not None
