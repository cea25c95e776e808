"""The cross-check finds a single wrong bit in the mirror, and by its oracle what both firmwares do wrong."""

from __future__ import annotations

import pytest

from crosschecks import FAULTS, check_with_audit, find_failure, mirror_with
from mcp_asdf.mirror import MirrorRobot
from mcp_asdf.native import NativeRobot
from support import slow

QUICK_FAULTS = (
    *("estimate: c t", "alpha_word: cap", "mean", "test", "counters"),
    *("slot: ids modulo 32", "vote: clamp", "dispersion: weight", "table: median", "robust test: variance"),
)
SLOW_FAULTS = tuple(fault for fault in FAULTS if fault not in QUICK_FAULTS)


@pytest.mark.parametrize("fault", [*QUICK_FAULTS, *slow(SLOW_FAULTS)])
def test_a_fault_in_one_firmware_is_found(fault: str) -> None:
    failure = find_failure(check_with_audit(NativeRobot, mirror_with(FAULTS[fault])))
    assert failure is not None
    is_without_fault_passed = check_with_audit(NativeRobot, MirrorRobot)(failure.scenario) is None
    assert is_without_fault_passed, "something else than the fault was found"


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
def test_a_fault_in_both_firmwares_is_found_by_exact_arithmetic(fault: str) -> None:
    faulty_mirror = mirror_with(FAULTS[fault])
    assert find_failure(check_with_audit(faulty_mirror, faulty_mirror)) is not None
