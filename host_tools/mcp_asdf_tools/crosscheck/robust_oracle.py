"""Check what a call does to the memory of the robust filter, what its test must decide, and what follows.

Slots, votes and the beginning of a batch have one right value, which they must have to the last bit; the
dispersion must keep the bounds of ``robust_bounds``. The test must decide as exact fractions do, unless it is
so close that the rounding of its terms may decide.

Names of the state's fields are those of ``MirrorRobot.state``.
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import Enum
from fractions import Fraction

from mcp_asdf.fixed_point import HALF, ONE
from mcp_asdf.reference import COUNTER_MODULUS
from mcp_asdf.robust_reference import SLOTS, TESTED_ESTIMATES_MIN, Observations, Votes
from mcp_asdf_tools.crosscheck.audit import Audit
from mcp_asdf_tools.crosscheck.checks import alpha_units, check_bounds, check_exact, check_whether_updated
from mcp_asdf_tools.crosscheck.robust_bounds import (
    dispersion_bounds,
    robust_test_outcome,
    rounded_centre_and_spread,
    rounded_votes_after,
    slot_estimate,
    support_outcome,
)
from mcp_asdf_tools.crosscheck.scenario import CALLS_THAT_REPLACE_ROBOT, CallRecord, State

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
    """What a test of the robust filter must decide; the value names it in a report."""

    TEST_ACCEPTS = "accepted"
    """The test does not reject the initial b_hat."""
    REJECTED_BUT_SUPPORTED = "supported"
    """The test rejects it, but more than two of five estimates support the robot."""
    REJECTED = "rejected"
    """The test rejects it, and b_hat is to be re-estimated."""
    ROUNDING_DECIDES = "undecided"
    """The rounding of its terms may decide the test, or the number of supporters."""


def check_robust_call(record: CallRecord, audit: Audit) -> list[str]:
    """Check x_bar, x and the filter's memory, and after a round b_hat. Return one line per problem.

    These events are counted in ``audit``:
        vote, own vote: An estimate in a slot was a vote, or the robot's own estimate.
        too few: The filter had too few estimates for a test.
        accepted, supported, rejected, undecided: What the filter's test had to decide; see `Decision`.
        returned: b_hat became the initial one again.
    """
    problems = _check_means(record.new_state)
    problems += _check_memory(record, audit)
    if record.is_end_of_round:
        problems += _check_filter(record, audit)
    return problems


def _check_means(state: State) -> list[str]:
    """Check x_bar, x and beta, and return one line per wrong value.

    x_bar and x are the centre of the votes, rounded down, and beta is 0. Without any vote x_bar is 1/2 and x
    is the robot's own x_hat.
    """
    x, x_bar = state["x_hat"], HALF
    has_votes = state["robust_votes"] > 0
    if has_votes:
        x = x_bar = state["robust_centre"] * ONE // _VOTE_UNITS  # from units of 2**-30 to 2**-23
    # Names that end in () are results of methods, of which the state has the values, too.
    return check_exact(state, {"x()": x, "x_bar()": x_bar, "beta()": 0})


def _check_filter(record: CallRecord, audit: Audit) -> list[str]:
    """Check the filter at the end of a round, and return one line per problem.

    If the filter does not run, or has too few estimates for a test, b_hat and the robot's counter of tests
    must be as before. Otherwise that counter must be one higher, and b_hat must be what follows from the
    test. Runs with too few estimates are counted in ``audit``.
    """
    if not record.had_to_run_filter:
        return _check_nothing_tested_or_updated(record)
    # Besides b_hat a run changes only the batch of observations and the dispersion, both before its test. So
    # all that it decides by is still in the new state.
    estimates = [_estimate_of_slot(record.new_state, slot) for slot in _filled_slots(record.new_state)]
    if len(estimates) < TESTED_ESTIMATES_MIN:
        audit.events["too few"] += 1
        return _check_nothing_tested_or_updated(record)
    expected_tests = (record.old_state["tests"] + 1) % COUNTER_MODULUS
    problems = check_exact(record.new_state, {"tests": expected_tests})
    return problems + _check_b_hat_after_test(record, estimates, audit)


def _check_b_hat_after_test(record: CallRecord, estimates: Sequence[Fraction], audit: Audit) -> list[str]:
    """Check b_hat after a test against these estimates, and return one line per problem.

    If the test rejects and the robot has too few supporters, b_hat must have been re-estimated, to the right
    value. If not, it must be the initial b_hat. Where rounding may decide which, b_hat is not checked. The
    test and its decision are counted in ``audit``.
    """
    audit.tests += 1
    centre, spread = rounded_centre_and_spread(estimates)
    decision = _expected_decision(record.new_state, estimates, centre, spread)
    audit.events[decision.value] += 1
    if decision is Decision.ROUNDING_DECIDES:
        return []
    if decision is Decision.REJECTED:
        return audit.check_b_hat(record, centre)
    return _check_initial_b_hat(record, audit)


def _check_nothing_tested_or_updated(record: CallRecord) -> list[str]:
    """Check that the filter has neither tested nor updated b_hat, and return one line per problem."""
    expected = {name: record.old_state[name] for name in ("b_hat()", "tests")}
    problems = check_exact(record.new_state, expected)
    return problems + check_whether_updated(record.is_updated, expected=False)


def _check_initial_b_hat(record: CallRecord, audit: Audit) -> list[str]:
    """Check that b_hat has its initial value after a test, and return one line per problem.

    If b_hat had another value before, the call must have reported an update, and this is counted as a return
    in ``audit``. If b_hat had its initial value already, the call must have reported no update.
    """
    initial_b_hat = record.new_state["robust_initial_b_hat"]
    is_return = record.old_state["b_hat()"] != initial_b_hat
    if is_return:
        audit.events["returned"] += 1
    problems = check_exact(record.new_state, {"b_hat()": initial_b_hat})
    return problems + check_whether_updated(record.is_updated, expected=is_return)


def _check_memory(record: CallRecord, audit: Audit) -> list[str]:
    """Check what a call has done to the memory of the robust filter, and return one line per problem.

    The memory consists of the estimates in the slots, the summary of the votes, and the batch of observations
    with their dispersion; what a call must not change there must be as before. After a ``restore`` or
    ``damage`` nothing is checked. Each vote is counted in ``audit``.
    """
    if record.call.name in CALLS_THAT_REPLACE_ROBOT:
        # The memory comes from an image. Here nothing is known of it; `compare_firmwares` compares it.
        return []
    expected = _memory_of(record.old_state) | _slot_after_message(record) | _batch_after_halving(record)
    if not record.is_end_of_round:
        return check_exact(record.new_state, expected)
    expected |= _votes_after_round(record, audit)
    problems: list[str] = []
    if record.had_to_run_filter:
        problems = _check_dispersion(expected, record.new_state)
        # The run ends the batch. The dispersion has been checked, and has no single right value.
        expected |= _new_batch(record.new_state)
        expected["robust_dispersion"] = record.new_state["robust_dispersion"]
    return problems + check_exact(record.new_state, expected)


def _memory_of(state: State) -> State:
    """Return the fields of the state that belong to the robust filter, by name."""
    return {name: value for name, value in state.items() if name.startswith(("robust_", "estimates_"))}


def _slot_after_message(record: CallRecord) -> State:
    """Return the new values of the fields that change when a message's estimate is put into a slot, by name.

    They are the estimate in the sender's slot, and the mask of the filled slots. No field changes, and the
    result is empty, if the call is no message, or one that is not accepted or has no confidence.
    """
    if record.call.name != "receive" or record.after.outcome != "OK":
        return {}
    sender, x_hat, alpha = record.call.numbers  # x_hat is in units of 2**-23
    if alpha_units(alpha) == 0:
        return {}
    slot = sender % SLOTS
    estimate = slot_estimate(Fraction(x_hat, ONE))
    return {
        f"estimates_{slot}": int(estimate * _ESTIMATE_UNITS),
        "robust_filled_slots": record.old_state["robust_filled_slots"] | (1 << slot),
    }


def _batch_after_halving(record: CallRecord) -> State:
    """Return the fields, by name, of a batch that begins because an observation has halved t and n.

    The old batch ends there, as its first counts could not be compared with the halved ones. The result is
    empty if the call has not halved t and n.
    """
    if not record.is_observation:
        return {}
    is_memory_halved = record.new_state["t"] != record.old_state["t"] + 1
    return _new_batch(record.new_state) if is_memory_halved else {}


def _new_batch(state: State) -> State:
    """Return the fields of a batch of observations that begins after those of this state."""
    return {"robust_batch_t": state["t"], "robust_batch_n": state["n"]}


def _filled_slots(state: State) -> list[int]:
    """Return the slots that have an estimate, in ascending order."""
    filled_slots = state["robust_filled_slots"]  # a mask with one bit per slot
    return [slot for slot in range(SLOTS) if filled_slots & (1 << slot)]


def _estimate_of_slot(state: State, slot: int) -> Fraction:
    """Return the estimate in a slot, in [0, 1)."""
    return Fraction(state[f"estimates_{slot}"], _ESTIMATE_UNITS)


def _votes_after_round(record: CallRecord, audit: Audit) -> State:
    """Return the new values of the fields that the vote at the end of a round changes, by name.

    These are the centre, the spread and the number of the votes, and the slot from which on the next vote is
    looked for. If all slots are empty there is no vote, and the result is empty. The vote is counted in
    ``audit``.
    """
    old_state = record.old_state
    if not _filled_slots(old_state):
        return {}
    x_hat, next_turn = _vote_and_next_turn(record, audit)
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


def _vote_and_next_turn(record: CallRecord, audit: Audit) -> tuple[Fraction, int]:
    """Return the x_hat that votes at the end of a round, and the slot from which on the next vote comes.

    The estimates in the slots vote by turns, and after the last of them the robot's own estimate if it has
    confidence. That is the one of the new state, as a ``step`` observes before it ends the round. There must
    be a filled slot. The vote is counted in ``audit``.
    """
    filled_slots = _filled_slots(record.old_state)
    remaining_slots = [slot for slot in filled_slots if slot >= record.old_state["robust_turn"]]
    has_own_confidence = alpha_units(record.new_state["alpha"]) > 0
    if not remaining_slots and has_own_confidence:
        audit.events["own vote"] += 1
        return Fraction(record.new_state["x_hat"], ONE), 0
    audit.events["vote"] += 1
    # After the last filled slot it is the turn of the first one again.
    slot = remaining_slots[0] if remaining_slots else filled_slots[0]
    return _estimate_of_slot(record.old_state, slot), slot + 1


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


def _expected_decision(
    state: State, estimates: Sequence[Fraction], centre: Fraction, spread: Fraction
) -> Decision:
    """Return what the filter's test of a robot in this state must have decided.

    ``centre`` and ``spread`` are those of the estimates in the robot's slots. If the test rejects, the
    decision also depends on whether more than two in five of these estimates support the robot.
    """
    initial_b_hat = Fraction(state["robust_initial_b_hat"], _B_HAT_UNITS)
    dispersion = Fraction(state["robust_dispersion"], _DISPERSION_UNITS)
    observations = Observations(state["n"], state["t"], dispersion)
    # Either is None if rounding may decide it.
    is_rejected = robust_test_outcome(observations, initial_b_hat, centre, spread)
    is_supported = support_outcome(observations, initial_b_hat, estimates, centre)
    if is_rejected is False:
        return Decision.TEST_ACCEPTS
    if is_rejected is None or is_supported is None:
        return Decision.ROUNDING_DECIDES
    return Decision.REJECTED_BUT_SUPPORTED if is_supported else Decision.REJECTED
