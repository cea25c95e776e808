"""Check what a call does to the memory of the robust filter, and what its test must decide.

Slots, votes and the beginning of a batch have one right value, which they must have to the last bit; the
dispersion must keep the bounds of ``robust_bounds``. The test must decide as exact fractions do, unless it is
so close that the rounding of its terms may decide.

Names of the state's fields are those of ``MirrorRobot.state``.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from enum import Enum
from fractions import Fraction

from mcp_asdf.fixed_point import ONE
from mcp_asdf.robust_reference import SLOTS, TESTED_ESTIMATES_MIN, Observations, Votes
from mcp_asdf_tools.crosscheck.checks import check_bounds, check_exact, is_filter_run
from mcp_asdf_tools.crosscheck.compare import CallResult, State
from mcp_asdf_tools.crosscheck.robust_bounds import (
    dispersion_bounds,
    robust_test_outcome,
    rounded_centre_and_spread,
    rounded_votes_after,
    slot_estimate,
    support_outcome,
)
from mcp_asdf_tools.crosscheck.scenario import Call


class Decision(Enum):
    """What a run of the robust filter must decide; the value names it in a report."""

    TOO_FEW = "too few"
    """There are fewer than five estimates, and there must be no test."""
    ACCEPTED = "accepted"
    """The test does not reject the initial b_hat."""
    SUPPORTED = "supported"
    """The test rejects it, but more than two of five estimates support the robot."""
    REJECTED = "rejected"
    """The test rejects it, and b_hat is to be re-estimated."""
    UNDECIDED = "undecided"
    """The rounding of its terms may decide the test, or the number of supporters."""


@dataclass(frozen=True)
class FilterRun:
    """What a run of the robust filter must decide, and by which estimates.

    Attributes:
        decision: What it must decide.
        centre: Centre of the estimates, with which b_hat is re-estimated; None if there are too few of them.
    """

    decision: Decision
    centre: Fraction | None


def check_memory(call: Call, before: CallResult, after: CallResult, events: Counter[str]) -> list[str]:
    """Check what a call has done to the memory of the robust filter, and return a line for each problem.

    The memory consists of slots, votes, and the batch of observations with their dispersion; what a call must
    not change there must be as before. Each vote is counted in ``events``.
    """
    old_state, new_state = before.state, after.state
    if call.name in ("restore", "damage"):
        return []  # The memory comes from an image, and the firmwares compare it.
    expected = _memory_of(old_state)
    is_error = after.outcome.startswith("ERR")
    problems: list[str] = []
    if call.name == "receive":
        sender, x_hat, alpha = call.numbers
        has_confidence = alpha >> 8 > 0
        if after.outcome == "OK" and has_confidence:
            expected |= _slot_after(old_state, sender, x_hat)
    if call.name in ("observe", "step") and not is_error:
        is_halved = new_state["t"] != old_state["t"] + 1
        if is_halved:
            expected |= {"robust_batch_t": new_state["t"], "robust_batch_n": new_state["n"]}
    if call.name in ("settle", "step") and not is_error:
        expected |= _votes_after_round(old_state, new_state, events)
        if is_filter_run(old_state, new_state):
            problems += _check_dispersion(expected, new_state)
            expected |= {
                "robust_batch_t": new_state["t"],
                "robust_batch_n": new_state["n"],
                "robust_dispersion": new_state["robust_dispersion"],
            }
    return problems + check_exact(new_state, expected)


def _memory_of(state: State) -> State:
    """Return the fields of the state that belong to the robust filter."""
    return {name: value for name, value in state.items() if name.startswith(("robust_", "estimates_"))}


def _slot_after(old_state: State, sender: int, x_hat: int) -> State:
    """Return the fields that change when the estimate of a sender is put into its slot."""
    slot = sender % SLOTS
    estimate = slot_estimate(Fraction(x_hat, ONE))
    return {
        f"estimates_{slot}": int(estimate * 2**16),
        "robust_filled_slots": old_state["robust_filled_slots"] | 1 << slot,
    }


def _filled_slots(state: State) -> list[int]:
    """Return the slots that have an estimate, in ascending order."""
    return [slot for slot in range(SLOTS) if state["robust_filled_slots"] >> slot & 1]


def _estimate_of_slot(state: State, slot: int) -> Fraction:
    """Return the estimate in a slot."""
    return Fraction(state[f"estimates_{slot}"], 2**16)


def _votes_after_round(old_state: State, new_state: State, events: Counter[str]) -> State:
    """Return the fields that one vote changes at the end of a round; none if all slots are empty.

    The robot's own estimate is that of the new state: an observation before the end of the round counts.
    """
    slots = _filled_slots(old_state)
    if not slots:
        return {}
    remaining_slots = [slot for slot in slots if slot >= old_state["robust_turn"]]
    has_confidence = new_state["alpha"] >> 8 > 0
    if not remaining_slots and has_confidence:
        events["own vote"] += 1
        x_hat, turn = Fraction(new_state["x_hat"], ONE), 0
    else:
        events["vote"] += 1
        slot = (remaining_slots or slots)[0]
        x_hat, turn = _estimate_of_slot(old_state, slot), slot + 1
    votes = rounded_votes_after(
        Votes(
            centre=Fraction(old_state["robust_centre"], 2**30),
            spread=Fraction(old_state["robust_spread"], 2**30),
            count=old_state["robust_votes"],
        ),
        x_hat,
    )
    return {
        "robust_centre": int(votes.centre * 2**30),
        "robust_spread": int(votes.spread * 2**30),
        "robust_votes": votes.count,
        "robust_turn": turn,
    }


def _check_dispersion(memory: State, new_state: State) -> list[str]:
    """Check the dispersion after a run of the filter, from the memory before it."""
    n, t = new_state["n"], new_state["t"]
    old_dispersion = Fraction(memory["robust_dispersion"], 2**8)
    batch_black_count = n - memory["robust_batch_n"]
    batch_count = t - memory["robust_batch_t"]
    bounds = dispersion_bounds(Observations(n, t, old_dispersion), batch_black_count, batch_count)
    return check_bounds("dispersion", Fraction(new_state["robust_dispersion"], 2**8), bounds)


def expected_filter_run(state: State) -> FilterRun:
    """Return what the filter must have decided if it has run, and led to this state.

    Besides b_hat a run changes only the batch and the dispersion, before it decides.
    """
    estimates = [_estimate_of_slot(state, slot) for slot in _filled_slots(state)]
    if len(estimates) < TESTED_ESTIMATES_MIN:
        return FilterRun(Decision.TOO_FEW, None)
    centre, spread = rounded_centre_and_spread(estimates)
    initial_b_hat = Fraction(state["robust_initial_b_hat"], 2**32)
    dispersion = Fraction(state["robust_dispersion"], 2**8)
    observations = Observations(state["n"], state["t"], dispersion)
    is_rejected = robust_test_outcome(observations, initial_b_hat, centre, spread)
    is_supported = support_outcome(observations, initial_b_hat, estimates, centre)
    if is_rejected is False:
        decision = Decision.ACCEPTED
    elif is_rejected is None or is_supported is None:
        decision = Decision.UNDECIDED
    else:
        decision = Decision.SUPPORTED if is_supported else Decision.REJECTED
    return FilterRun(decision, centre)
