"""A single wrong bit in the mirror is found; what both firmwares do wrong, by the oracle."""

from __future__ import annotations

import pytest

from crosschecks import FAULTS, caught, judged, mirror_with
from mcp_asdf.mirror import MirrorRobot
from mcp_asdf.native import NativeRobot
from support import slow

LONG = ("robust: votes that halve", "vote: trend", "robust: way back")


@pytest.mark.parametrize("fault", [*(each for each in FAULTS if each not in LONG), *slow(LONG)])
def test_a_planted_fault_is_caught(fault: str) -> None:
    failure = caught(judged(NativeRobot, mirror_with(FAULTS[fault])))
    assert failure is not None
    assert judged(NativeRobot, MirrorRobot)(failure.scenario) is None, "it is not the fault that shows"


@pytest.mark.parametrize(
    "fault",
    [
        *("estimate: what says nothing", "estimate: mirror image", "alpha_word: cap", "mean", "test"),
        *("test: fewest messages", "filter period", "vote: gain", "vote: clamp", "vote: without confidence"),
        *("robust: moving", "robust: voices", "robust: test", "robust: variance", *slow(LONG[2:])),
    ],
)
def test_what_both_do_wrong_is_caught_by_exact_arithmetic(fault: str) -> None:
    wrong = mirror_with(FAULTS[fault])
    assert caught(judged(wrong, wrong)) is not None
