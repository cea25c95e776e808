"""Check what a call does to the memory of the robust filter, what its test must decide, and what follows.

Slots, votes and the beginning of a batch have one right value, which they must have to the last bit; the
dispersion must keep the bounds of ``robust_bounds``. The test must decide as exact fractions do, unless it is
so close that the rounding of its terms may decide.

Names of the state's fields are those of ``MirrorRobot.state``.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from enum import Enum
from fractions import Fraction
from typing import TYPE_CHECKING

from mcp_asdf.fixed_point import HALF, ONE
from mcp_asdf.reference import COUNTER_MODULUS
from mcp_asdf.robust_reference import SLOTS, TESTED_ESTIMATES_MIN, Observations, Votes
from mcp_asdf_tools.crosscheck.checks import (
    alpha_units,
    check_bounds,
    check_exact,
    check_whether_updated,
    ends_round,
    had_to_run_filter,
    is_observation,
)
from mcp_asdf_tools.crosscheck.robust_bounds import (
    dispersion_bounds,
    robust_test_outcome,
    rounded_centre_and_spread,
    rounded_votes_after,
    slot_estimate,
    support_outcome,
)
from mcp_asdf_tools.crosscheck.scenario import (
    CALLS_THAT_REPLACE_ROBOT,
    Call,
    CallResult,
    Setup,
    State,
)

if TYPE_CHECKING:
    from mcp_asdf_tools.crosscheck.oracle import Audit

# The state holds fractions as integers, in units of 1 / ... of these numbers.
_ESTIMATE_UNITS = 2**16
"""Units of 1.0 in the estimates of the slots."""
_VOTE_UNITS = 2**30
"""Units of 1.0 in the centre and the spread of the votes."""
_DISPERSION_UNITS = 2**8
"""Units of 1.0 in the dispersion."""
_B_HAT_UNITS = 2**32
"""Units of 1.0 in b_hat."""


class Decision(Enum):
    """What a run of the robust filter must decide; the value names it in a report."""

    TOO_FEW_ESTIMATES = "too few"
    """There are fewer than five estimates, and there must be no test."""
    TEST_ACCEPTS = "accepted"
    """The test does not reject the initial b_hat."""
    REJECTED_BUT_SUPPORTED = "supported"
    """The test rejects it, but more than two of five estimates support the robot."""
    REJECTED = "rejected"
    """The test rejects it, and b_hat is to be re-estimated."""
    ROUNDING_DECIDES = "undecided"
    """The rounding of its terms may decide the test, or the number of supporters."""


def check_robust_call(
    audit: Audit, setup: Setup, call: Call, before: CallResult, after: CallResult
) -> list[str]:
    """Return a line for each problem of the filter's memory, of x_bar and x, and of b_hat after a round.

    These events are counted in ``audit``:
        vote, own vote: An estimate in a slot was a vote, or the robot's own estimate.
        too few, accepted, supported, rejected, undecided: What the filter had to decide; see `Decision`.
        returned: b_hat became the initial one again.
    """
    events = audit.events["robust"]
    problems = _check_means(after.state)
    problems += _check_memory(call, before, after, events)
    if ends_round(call, after):
        is_updated = after.outcome == "UPDATED"
        problems += _check_filter(audit, events, before.state, after.state, is_updated)
    return problems


def _check_means(state: State) -> list[str]:
    """Return what is wrong with x_bar, x and beta, a line each.

    x_bar and x are the centre of the votes, rounded down, and beta is 0. Without any vote x_bar is 1/2 and x
    is the robot's own x_hat.
    """
    x, x_bar = state["x_hat"], HALF
    has_votes = state["robust_votes"] > 0
    if has_votes:
        x = x_bar = state["robust_centre"] * ONE // _VOTE_UNITS  # from units of 2**-30 to 2**-23
    return check_exact(state, {"x()": x, "x_bar()": x_bar, "beta()": 0})


def _check_filter(
    audit: Audit, events: Counter[str], old_state: State, new_state: State, is_updated: bool
) -> list[str]:
    """Return a line for each problem of the filter at the end of a round.

    If the filter does not run, or has too few estimates for a test, b_hat and the robot's counter of tests
    must be as before. Otherwise that counter must be one higher. Then b_hat must have been re-estimated, to
    the right value, if the test rejects and the robot has too few supporters, and must be the initial one if
    not. Where rounding may decide which, b_hat is not checked.

    Decisions and returns to the initial b_hat are counted in ``events``, and tests in ``audit.tests``.
    """
    if not had_to_run_filter(old_state, new_state):
        return _check_nothing_tested_or_updated(old_state, new_state, is_updated)
    decision, centre = _expected_decision(new_state)
    events[decision.value] += 1
    if decision is Decision.TOO_FEW_ESTIMATES:
        return _check_nothing_tested_or_updated(old_state, new_state, is_updated)
    audit.tests += 1
    expected_tests = (old_state["tests"] + 1) % COUNTER_MODULUS
    problems = check_exact(new_state, {"tests": expected_tests})
    if decision is Decision.REJECTED:
        assert centre is not None
        problems += audit.check_b_hat(new_state, centre, is_updated)
    if decision in (Decision.TEST_ACCEPTS, Decision.REJECTED_BUT_SUPPORTED):
        initial_b_hat = new_state["robust_initial_b_hat"]
        is_return = old_state["b_hat()"] != initial_b_hat
        if is_return:
            events["returned"] += 1
        problems += check_exact(new_state, {"b_hat()": initial_b_hat})
        problems += check_whether_updated(is_updated, expected=is_return)
    return problems


def _check_nothing_tested_or_updated(old_state: State, new_state: State, is_updated: bool) -> list[str]:
    """Return a line for each sign of a test or of an update of b_hat, where there must be neither."""
    problems = check_exact(new_state, {"b_hat()": old_state["b_hat()"], "tests": old_state["tests"]})
    return problems + check_whether_updated(is_updated, expected=False)


def _check_memory(call: Call, before: CallResult, after: CallResult, events: Counter[str]) -> list[str]:
    """Check what a call has done to the memory of the robust filter, and return a line for each problem.

    The memory consists of the estimates in the slots, the summary of the votes, and the batch of observations
    with their dispersion; what a call must not change there must be as before. After a ``restore`` or
    ``damage`` nothing is checked. Each vote is counted in ``events``.
    """
    old_state, new_state = before.state, after.state
    if call.name in CALLS_THAT_REPLACE_ROBOT:
        # The memory comes from an image. Here nothing is known of it; `compare_firmwares` compares it.
        return []
    expected = _memory_of(old_state)
    problems: list[str] = []
    if call.name == "receive":
        sender, x_hat, alpha = call.numbers
        has_confidence = alpha_units(alpha) > 0
        if after.outcome == "OK" and has_confidence:
            expected |= _slot_after(old_state, sender, x_hat)
    new_batch = {"robust_batch_t": new_state["t"], "robust_batch_n": new_state["n"]}
    if is_observation(call, after):
        is_memory_halved = new_state["t"] != old_state["t"] + 1
        if is_memory_halved:
            # The old counts cannot be compared with the halved ones, so a new batch begins.
            expected |= new_batch
    if ends_round(call, after):
        expected |= _votes_after_round(old_state, new_state, events)
        if had_to_run_filter(old_state, new_state):
            problems += _check_dispersion(expected, new_state)
            # The run ends the batch. The dispersion has been checked, and has no single right value.
            expected |= new_batch | {"robust_dispersion": new_state["robust_dispersion"]}
    return problems + check_exact(new_state, expected)


def _memory_of(state: State) -> State:
    """Return the fields of the state that belong to the robust filter, by name."""
    return {name: value for name, value in state.items() if name.startswith(("robust_", "estimates_"))}


def _slot_after(old_state: State, sender: int, x_hat: int) -> State:
    """Return the new values of the fields that change when a sender's estimate is put into its slot.

    They are the estimate in the slot, and the mask of the filled slots. ``x_hat`` is in units of 2**-23.
    """
    slot = sender % SLOTS
    estimate = slot_estimate(Fraction(x_hat, ONE))
    return {
        f"estimates_{slot}": int(estimate * _ESTIMATE_UNITS),
        "robust_filled_slots": old_state["robust_filled_slots"] | (1 << slot),
    }


def _filled_slots(state: State) -> list[int]:
    """Return the slots that have an estimate, in ascending order."""
    filled_slots = state["robust_filled_slots"]  # a mask with a bit for each slot
    return [slot for slot in range(SLOTS) if filled_slots & (1 << slot)]


def _estimate_of_slot(state: State, slot: int) -> Fraction:
    """Return the estimate in a slot, in [0, 1)."""
    return Fraction(state[f"estimates_{slot}"], _ESTIMATE_UNITS)


def _votes_after_round(old_state: State, new_state: State, events: Counter[str]) -> State:
    """Return the new values of the fields that the vote at the end of a round changes, by name.

    These are the centre, the spread and the number of the votes, and the slot from which on the next vote is
    looked for. If all slots are empty there is no vote, and the result is empty. The vote is counted in
    ``events``.
    """
    slots = _filled_slots(old_state)
    if not slots:
        return {}
    x_hat, next_turn = _vote_and_next_turn(slots, old_state, new_state, events)
    old_votes = Votes(
        centre=Fraction(old_state["robust_centre"], _VOTE_UNITS),
        spread=Fraction(old_state["robust_spread"], _VOTE_UNITS),
        count=old_state["robust_votes"],
    )
    votes = rounded_votes_after(old_votes, x_hat)
    return {
        "robust_centre": int(votes.centre * _VOTE_UNITS),
        "robust_spread": int(votes.spread * _VOTE_UNITS),
        "robust_votes": votes.count,
        "robust_turn": next_turn,
    }


def _vote_and_next_turn(
    filled_slots: Sequence[int], old_state: State, new_state: State, events: Counter[str]
) -> tuple[Fraction, int]:
    """Return the x_hat that votes at the end of a round, and the slot from which on the next vote comes.

    The estimates in the slots vote by turns, and after the last of them the robot's own estimate if it has
    confidence. That is the one of the new state, as a ``step`` observes before it ends the round. There must
    be a filled slot. The vote is counted in ``events``.
    """
    remaining_slots = [slot for slot in filled_slots if slot >= old_state["robust_turn"]]
    has_own_confidence = alpha_units(new_state["alpha"]) > 0
    if not remaining_slots and has_own_confidence:
        events["own vote"] += 1
        return Fraction(new_state["x_hat"], ONE), 0
    events["vote"] += 1
    # After the last filled slot it is the turn of the first one again.
    slot = remaining_slots[0] if remaining_slots else filled_slots[0]
    return _estimate_of_slot(old_state, slot), slot + 1


def _check_dispersion(old_memory: State, new_state: State) -> list[str]:
    """Return a line if the dispersion of a robot's observations is wrong after a run of its filter.

    The dispersion says how much more the observations vary from batch to batch than independent ones. A run
    of the filter ends a batch: the observations since the run before. ``old_memory`` are the fields of the
    robust filter as they were before this run, and ``new_state`` is the state after it.
    """
    n, t = new_state["n"], new_state["t"]
    old_dispersion = Fraction(old_memory["robust_dispersion"], _DISPERSION_UNITS)
    new_dispersion = Fraction(new_state["robust_dispersion"], _DISPERSION_UNITS)
    batch_black_count = n - old_memory["robust_batch_n"]
    batch_count = t - old_memory["robust_batch_t"]
    bounds = dispersion_bounds(Observations(n, t, old_dispersion), batch_black_count, batch_count)
    return check_bounds("dispersion", new_dispersion, bounds)


def _expected_decision(state: State) -> tuple[Decision, Fraction | None]:
    """Return what a run of the filter that has led to this state must have decided, and by which centre.

    That is the centre of the estimates, and None if there are too few of them for a test. All that it decides
    by is still in the state: besides b_hat a run changes only the batch of observations and the dispersion,
    and both before it decides.
    """
    estimates = [_estimate_of_slot(state, slot) for slot in _filled_slots(state)]
    if len(estimates) < TESTED_ESTIMATES_MIN:
        return Decision.TOO_FEW_ESTIMATES, None
    centre, spread = rounded_centre_and_spread(estimates)
    initial_b_hat = Fraction(state["robust_initial_b_hat"], _B_HAT_UNITS)
    dispersion = Fraction(state["robust_dispersion"], _DISPERSION_UNITS)
    observations = Observations(state["n"], state["t"], dispersion)
    is_rejected = robust_test_outcome(observations, initial_b_hat, centre, spread)
    is_supported = support_outcome(observations, initial_b_hat, estimates, centre)
    return _decision_by(is_rejected, is_supported), centre


def _decision_by(is_rejected: bool | None, is_supported: bool | None) -> Decision:
    """Return what a run of the filter must decide.

    ``is_rejected`` says whether its test rejects the initial b_hat, and ``is_supported`` whether enough
    estimates support the robot, which counts only if the test rejects. Either is None if rounding may decide
    it.
    """
    if is_rejected is False:
        return Decision.TEST_ACCEPTS
    if is_rejected is None or is_supported is None:
        return Decision.ROUNDING_DECIDES
    return Decision.REJECTED_BUT_SUPPORTED if is_supported else Decision.REJECTED
