"""Contracts of the robust filter (docs/design.md, section 13), for all inputs.

A vote moves the centre and the spread as that section says, keeps both in their ranges, and never moves the
centre beyond the vote. The test of the initial b_hat is formed as that section says. A run of the filter
changes nothing but what it may change. ``test_overflow.py`` shows that no product of the test wraps; how near
its decision is to the exact one, ``mcp-asdf crosscheck`` tries with fractions.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import z3

from proofs.arithmetic import QUOTIENT, high_word, low_word, zero_extend
from proofs.machine import ConstantTable, Machine, Summary
from proofs.numbers import Number, convert
from proofs.prove import Contract, any_result, result_of, uninterpreted

ONE = 2**23
"""An x_hat of 1."""
B_HAT_RANGE = (2**12, 2**32 - 2**12)
SLOTS = 32
VOTES_MAX = 2**9


def is_same(actual: Any, expected: Any) -> Any:
    """Return the formula that a structure and the targets of its pointers are as in ``expected``.

    Members that ``expected`` leaves out may hold anything; a table is constant.
    """
    if isinstance(expected, dict):
        return z3.And([is_same(actual[name], member) for name, member in expected.items()])
    return z3.BoolVal(True) if isinstance(expected, ConstantTable) else actual == expected


def choose_terms(condition: Any, terms_if_true: Any, terms_if_false: Any) -> Any:
    """Return the first terms where the condition holds, and the second elsewhere; tables are the same."""
    if isinstance(terms_if_true, dict):
        return {
            name: choose_terms(condition, member, terms_if_false[name])
            for name, member in terms_if_true.items()
        }
    if isinstance(terms_if_true, ConstantTable):
        return terms_if_true
    return z3.If(condition, terms_if_true, terms_if_false)


def minimum_of(a: Any, b: Any) -> Any:
    """Return the smaller of two words."""
    return z3.If(z3.ULT(a, b), a, b)


# --- A vote ----------------------------------------------------------------------------------------------


def gain_shift(votes: Any) -> Any:
    """Return max(bits(votes) - 3, 3), for fewer than 2^10 votes."""
    shift = z3.BitVecVal(3, 32)
    for bits in range(7, 11):
        shift = z3.If(z3.UGE(votes, 2 ** (bits - 1)), z3.BitVecVal(bits - 3, 32), shift)
    return shift


def _call_leading_zeros(machine: Machine, value: Number) -> Number:
    """Stand in for leading_zeros() by its lemma, which no other number fulfils."""
    return convert(machine.count_leading_zeros(Number(value.term | 1, value.type)), value.type)


def is_in_range(statistics: dict[str, Any]) -> Any:
    """Return that the members that a vote changes are in their ranges."""
    return z3.And(
        z3.ULE(statistics["centre"], 2**30),
        z3.UGE(statistics["spread"], 2**18),
        z3.ULE(statistics["spread"], 2**28),
        z3.ULE(statistics["votes"], VOTES_MAX),
    )


def _may_count_vote(statistics: dict[str, Any], x_hat: Any) -> Any:
    return z3.And(is_in_range(statistics), z3.ULE(x_hat, ONE))


def _are_statistics_after_vote(after: dict[str, Any], before: dict[str, Any], x_hat: Any) -> list[Any]:
    """Return the section's formulas for a vote, each by itself.

    The ranges hold again, and the new centre is between the old one and the vote.
    """
    # The vote is in units of 2^-30, and x_hat in units of 2^-23.
    centre, spread, vote = before["centre"], before["spread"], x_hat << 7
    new_votes = minimum_of(before["votes"] + 1, z3.BitVecVal(VOTES_MAX, 32))
    shift = gain_shift(new_votes)
    is_above = z3.UGT(vote, centre)
    distance = z3.If(is_above, vote - centre, centre - vote)
    # The centre moves towards the vote, the spread towards the median distance of votes.
    centre_step = z3.LShR(minimum_of(distance, spread), shift)
    spread_step = z3.LShR(spread, shift + 1)
    new_spread = z3.If(z3.UGT(distance, spread), spread + spread_step, spread - spread_step)
    limited_spread = z3.If(
        z3.ULT(new_spread, 2**18), z3.BitVecVal(2**18, 32), minimum_of(new_spread, z3.BitVecVal(2**28, 32))
    )
    new_centre = after["centre"]
    is_between = z3.Or(
        z3.And(z3.ULE(centre, new_centre), z3.ULE(new_centre, vote)),
        z3.And(z3.ULE(vote, new_centre), z3.ULE(new_centre, centre)),
    )
    return [
        after["votes"] == new_votes,
        new_centre == z3.If(is_above, centre + centre_step, centre - centre_step),
        after["spread"] == limited_spread,
        z3.And(is_in_range(after), is_between),
    ]


def may_vote(robot: dict[str, Any]) -> Any:
    """Return what a vote needs: the members in their ranges, and an own x_hat of at most 1."""
    return _may_count_vote(robot["robust"], robot["x_hat"])


def _is_vote(robot_after: dict[str, Any], robot: dict[str, Any]) -> Any:
    """Return that the next slot's estimate is counted, or the robot's own; without a filled slot nothing."""
    robust = robot["robust"]
    has_confidence = z3.If(z3.LShR(robot["alpha"], 8) != 0, z3.BitVecVal(1, 1), z3.BitVecVal(0, 1))
    # 32 stands for the robot's own estimate.
    slot = result_of("next_slot", 32, robust["filled_slots"], zero_extend(robust["turn"], 32), has_confidence)
    # Of x_hat in units of 2^-23, and of slots in units of 2^-16.
    x_hat = robot["x_hat"]
    for index, estimate in robot["received"]["estimates"].items():
        x_hat = z3.If(slot == index, zero_extend(estimate, 32) << 7, x_hat)
    votes = zero_extend(robust["votes"], 32)
    statistics = {"centre": robust["centre"], "spread": robust["spread"], "votes": votes}
    after = result_of("statistics_after_vote", statistics, statistics, x_hat)
    new_members = {
        "centre": after["centre"],
        "spread": after["spread"],
        "votes": z3.Extract(15, 0, after["votes"]),
        # The next vote is of a later slot; after the robot's own estimate the turn begins anew.
        "turn": z3.If(slot == SLOTS, z3.BitVecVal(0, 8), z3.Extract(7, 0, slot) + 1),
    }
    new_robust = choose_terms(robust["filled_slots"] != 0, {**robust, **new_members}, robust)
    return is_same(robot_after, {**robot, "robust": new_robust})


def _is_next_slot(slot: Any, filled_slots: Any, turn: Any, has_confidence: Any) -> Any:
    """Return that a slot is the one of section 13: the first line of its list that applies."""
    later_slots = filled_slots & z3.If(z3.ULT(turn, SLOTS), z3.BitVecVal(-1, 32) << turn, z3.BitVecVal(0, 32))
    # Without a later slot the turn begins anew with the first one.
    candidate_slots = z3.If(later_slots != 0, later_slots, filled_slots)
    is_own_turn = z3.And(later_slots == 0, has_confidence != 0)
    first_slot_bit = z3.BitVecVal(1, 32)
    slots_up_to_slot = (first_slot_bit << slot << 1) - 1
    # The slot is the lowest candidate: its bit is set, and none below it.
    is_lowest = z3.And(z3.ULT(slot, SLOTS), candidate_slots & slots_up_to_slot == first_slot_bit << slot)
    return z3.If(is_own_turn, slot == SLOTS, is_lowest)


def _has_filled_slot(filled_slots: Any, *_other_arguments: Any) -> Any:
    return filled_slots != 0


# design: R35
NEXT_SLOT = Contract(_is_next_slot, requires=_has_filled_slot, used_lemmas=("leading_zeros",))
VOTE_STATISTICS = Contract(
    _are_statistics_after_vote,
    requires=_may_count_vote,
    used_lemmas=("shift_right",),
    stand_ins={"leading_zeros": _call_leading_zeros},
)
VOTE = Contract(
    _is_vote,
    requires=may_vote,
    stand_ins={
        "next_slot": uninterpreted(
            "next_slot", requires=_has_filled_slot, ensures=lambda slot, *_: z3.ULE(slot, SLOTS)
        ),
        "statistics_after_vote": uninterpreted("statistics_after_vote", requires=_may_count_vote),
    },
)

# --- The test ----------------------------------------------------------------------------------------------


def _is_robust_test(rejects: Any, _robot_after: Any, robot: Any, share: Any, centre: Any, spread: Any) -> Any:
    """Return that the code forms the section's test, of products that may be any."""
    product, upper_product = partial(result_of, "multiply", 64), partial(result_of, "multiply_high", 32)
    robust, t = robot["robust"], robot["t"]
    b_hat = robust["initial_b_hat"]
    p = upper_product(b_hat, centre) + upper_product(~b_hat, ~centre)
    v_of_p, v_of_share = upper_product(p, -p), upper_product(share, -share)
    # g is |2 b_hat - 1| in units of 2^-32; the first bit of b_hat tells whether 2 b_hat - 1 is negative.
    twice_b_hat = 2 * zero_extend(b_hat)
    g = low_word(z3.If(z3.ULT(b_hat, 2**31), 2**32 - twice_b_hat, twice_b_hat - 2**32))
    # Squares have 64 bits and are in units of 2^-64.
    g_spread = upper_product(g, spread)
    deviation = z3.If(z3.UGT(share, p), share - p, p - share)
    square, least_square = product(deviation, deviation), 12 * product(g_spread, g_spread)
    excess = square - least_square
    t_excess = product(t, high_word(excess)) + zero_extend(high_word(product(t, low_word(excess))))
    v = z3.If(z3.UGT(v_of_share, v_of_p), v_of_share, v_of_p)
    # The product of a constant and a half word fits in the lower word.
    dispersion_product = product(z3.BitVecVal(12, 32), zero_extend(robust["dispersion"], 32))
    limit = z3.LShR(product(low_word(dispersion_product), v), 8)
    is_rejected = z3.And(z3.UGT(square, least_square), z3.UGT(t_excess, limit))
    return (rejects == 1) == is_rejected


# design: R38
ROBUST_TEST = Contract(
    _is_robust_test, stand_ins={name: uninterpreted(name) for name in ("multiply", "multiply_high")}
)

# --- A run of the filter ------------------------------------------------------------------------------------

RUN_CHANGES = ("batch_t", "batch_n", "dispersion")
"""Members of the robust filter that a run of it may change."""

ESTIMATE_COUNT = z3.BitVec("estimate_count", 32)
"""Number of the estimates that a robot keeps. It stands for the result of sort_estimates()."""
REJECTS, IS_SUPPORTED = z3.BitVecs("rejects is_supported", 1)
"""Whether the test rejects, and whether two fifths support the robot: 1 for yes, 0 for no.

They stand for the results of robust_test_rejects() and is_supported(), of which nothing is known.
"""
NEW_B_HAT = z3.BitVec("new_b_hat", 32)
"""The re-estimated b_hat, or 0 if there is none. It stands for the result of reestimate()."""


def _is_b_hat_or_zero(b_hat: Any, *_arguments: Any) -> Any:
    return z3.Or(b_hat == 0, z3.And(z3.UGE(b_hat, B_HAT_RANGE[0]), z3.ULE(b_hat, B_HAT_RANGE[1])))


def may_run(robot: dict[str, Any]) -> Any:
    """Return what a run of the filter needs: an observation, and an initial b_hat in its range."""
    b_hat, t = robot["robust"]["initial_b_hat"], robot["t"]
    return z3.And(t != 0, z3.ULE(robot["n"], t), b_hat != 0, _is_b_hat_or_zero(b_hat))


def _is_run_of_filter(b_hat: Any, robot_after: dict[str, Any], robot: dict[str, Any]) -> Any:
    """Return that a run gives the b_hat of section 13, and counts its test.

    Beside that it changes the batch and the dispersion at most.
    """
    robust_before = robot["robust"]
    initial_b_hat, tests = robust_before["initial_b_hat"], robot["counters"]["tests"]
    is_tested = z3.UGE(ESTIMATE_COUNT, 5)
    is_updated = z3.And(REJECTS != 0, IS_SUPPORTED == 0)
    # 0 means that b_hat stays as it is.
    kept_b_hat = z3.If(robot["accuracy"]["b_hat"] == initial_b_hat, z3.BitVecVal(0, 32), initial_b_hat)
    expected_b_hat = z3.If(is_updated, NEW_B_HAT, kept_b_hat)
    kept_members = {name: member for name, member in robust_before.items() if name not in RUN_CHANGES}
    other_members = {name: member for name, member in robot.items() if name not in ("robust", "counters")}
    expected_counters = {**robot["counters"], "tests": z3.If(is_tested, tests + 1, tests)}
    return z3.And(
        b_hat == z3.If(is_tested, expected_b_hat, z3.BitVecVal(0, 32)),
        _is_b_hat_or_zero(b_hat),
        is_same(robot_after["robust"], kept_members),
        is_same(robot_after["counters"], expected_counters),
        is_same(robot_after, other_members),
    )


def _returns(name: str, term: Any, fact: Any = True) -> Summary:
    """Return a stand-in for a function that is called once: it returns a term of which a fact is known."""

    def return_term(machine: Machine, *arguments: Any) -> Number:
        result = any_result(name)(machine, *arguments)
        machine.facts.append(z3.And(fact))
        return Number(term, result.type)

    return return_term


REESTIMATE = Contract(
    _is_b_hat_or_zero, stand_ins={name: any_result(name) for name in ("multiply", "quotient")}
)

# design: R37
RUN = Contract(
    _is_run_of_filter,
    requires=may_run,
    stand_ins={
        "quotient": any_result("quotient", requires=QUOTIENT.requires),
        "sort_estimates": _returns("sort_estimates", ESTIMATE_COUNT, z3.ULE(ESTIMATE_COUNT, SLOTS)),
        "robust_test_rejects": _returns("robust_test_rejects", REJECTS),
        "is_supported": _returns("is_supported", IS_SUPPORTED),
        "reestimate": _returns("reestimate", NEW_B_HAT, _is_b_hat_or_zero(NEW_B_HAT)),
        **{name: any_result(name) for name in ("multiply", "multiply_high", "median_distance", "huber_step")},
    },
)

CONTRACTS = {
    "next_slot": NEXT_SLOT,
    "statistics_after_vote": VOTE_STATISTICS,
    "take_vote": VOTE,
    "robust_test_rejects": ROBUST_TEST,
    "reestimate": REESTIMATE,
    "run_robust_filter": RUN,
}
