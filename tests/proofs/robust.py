"""Contracts of the robust filter (docs/design.md, section 13), for all inputs.

A vote moves the centre and the spread as that section says, keeps both in their ranges, and never moves the
centre beyond the vote. The dispersion after a batch and the test of the initial b_hat are formed as that
section says, and a run of the filter calls all this with the right arguments and changes nothing else.
``test_overflow.py`` shows that no product of the test wraps; how near its decision is to the exact one,
``mcp-asdf crosscheck`` tries with fractions.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import z3

from proofs.arithmetic import QUOTIENT, high_word, low_word, zero_extend
from proofs.machine import ConstantTable, Machine, Pointer
from proofs.numbers import IntegerType, Number
from proofs.prove import Contract, result_of, stand_in

ROBUST = 3
"""The configuration's value for the robust filter."""
ONE = 2**23
"""An x_hat of 1."""
B_HAT_RANGE = (2**12, 2**32 - 2**12)
SLOTS = 32
VOTES_MAX = 2**9


product, upper_product = partial(result_of, "multiply", 64), partial(result_of, "multiply_high", 32)
"""Results of multiply() and multiply_high() for two words.

In the proofs here both may be any functions: a claim holds whatever they return.
"""


def is_robust(config: Any) -> Any:
    """Return that a configuration has the robust filter."""
    return config["filter"] == ROBUST


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
    """Return the claims about a vote: its results follow the section's formulas, and are in their ranges.

    The new centre is between the old one and the vote.
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
    """Return that a vote counts the next slot's estimate, or the robot's own.

    Without a filled slot nothing changes.
    """
    robust = robot["robust"]
    has_confidence = z3.If(z3.LShR(robot["alpha"], 8) != 0, z3.BitVecVal(1, 1), z3.BitVecVal(0, 1))
    # 32 stands for the robot's own estimate.
    slot = result_of("next_slot", 32, robust["filled_slots"], zero_extend(robust["turn"], 32), has_confidence)
    # The x_hat of a robot is in units of 2^-23, and the estimate in a slot in units of 2^-16.
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
    used_lemmas=("leading_zeros", "shift_right"),
)
VOTE = Contract(
    _is_vote,
    requires=may_vote,
    stand_ins={
        "next_slot": stand_in(
            "next_slot", requires=_has_filled_slot, ensures=lambda slot, *_: z3.ULE(slot, SLOTS)
        ),
        "statistics_after_vote": stand_in("statistics_after_vote", requires=_may_count_vote),
    },
)

# --- The test ----------------------------------------------------------------------------------------------


def _variance_of_observation(p: Any) -> Any:
    """Return p (1 - p) of a share or a probability; both are in units of 2^-32."""
    return upper_product(p, -p)


def _slope_of_probability(b_hat: Any) -> Any:
    """Return |2 b_hat - 1| in units of 2^-32."""
    twice_b_hat = 2 * zero_extend(b_hat)
    is_negative = z3.ULT(b_hat, 2**31)
    return low_word(z3.If(is_negative, 2**32 - twice_b_hat, twice_b_hat - 2**32))


def _is_robust_test(rejects: Any, _robot_after: Any, robot: Any, share: Any, centre: Any, spread: Any) -> Any:
    """Return that the code forms the section's test, whatever the products in it are."""
    b_hat, t = robot["robust"]["initial_b_hat"], robot["t"]
    p = upper_product(b_hat, centre) + upper_product(~b_hat, ~centre)
    deviation = z3.If(z3.UGT(share, p), share - p, p - share)
    g_spread = upper_product(_slope_of_probability(b_hat), spread)
    # Squares have 64 bits and are in units of 2^-64. The left side of the test is t times what they differ.
    square, least_square = product(deviation, deviation), 12 * product(g_spread, g_spread)
    excess = square - least_square
    t_excess = product(t, high_word(excess)) + zero_extend(high_word(product(t, low_word(excess))))
    # The right side is 12 times the dispersion, a product that fits in a word, times v.
    v_of_share, v_of_p = _variance_of_observation(share), _variance_of_observation(p)
    v = z3.If(z3.UGT(v_of_share, v_of_p), v_of_share, v_of_p)
    limit = z3.LShR(product(_twelve_dispersions(robot), v), 8)
    is_rejected = z3.And(z3.UGT(square, least_square), z3.UGT(t_excess, limit))
    return (rejects == 1) == is_rejected


def _twelve_dispersions(robot: Any) -> Any:
    """Return 12 times the dispersion of a robot's observations: the lower word of a product."""
    dispersion = zero_extend(robot["robust"]["dispersion"], 32)
    return low_word(product(z3.BitVecVal(12, 32), dispersion))


# design: R38
ROBUST_TEST = Contract(
    _is_robust_test, stand_ins={name: stand_in(name) for name in ("multiply", "multiply_high")}
)

# --- A run of the filter ------------------------------------------------------------------------------------


def _is_robust_robot(robot: dict[str, Any], *_arguments: Any) -> Any:
    return is_robust(robot["config"])


def keeps_initial_b_hat(robot_after: dict[str, Any], robot: dict[str, Any], *_arguments: Any) -> Any:
    """Return that a call does not change the initial b_hat, which its caller needs after it.

    The contracts of take_vote() and end_batch() say so, too.
    """
    return robot_after["robust"]["initial_b_hat"] == robot["robust"]["initial_b_hat"]


def _is_batch_ended(robot_after: dict[str, Any], robot: dict[str, Any], share: Any) -> Any:
    """Return that the dispersion follows the ratio of the batch, and that the next batch begins."""
    robust = robot["robust"]
    count, black_count = robot["t"] - robust["batch_t"], robot["n"] - robust["batch_n"]
    variance = product(count, _variance_of_observation(share))
    # The largest ratio is 12 times the dispersion. A batch with the largest square has this ratio.
    largest_ratio = _twelve_dispersions(robot)
    largest_square = _ratio_times_variance(largest_ratio, variance)
    square = minimum_of(_square_of_deviation(black_count, product(count, share)), largest_square)
    # The ratio is as large a part of the largest ratio as the square is of the largest square.
    ratio = upper_product(largest_ratio, result_of("quotient", 32, square, largest_square))
    # The new dispersion is 7/8 of the old one and 1/8 of the ratio, within the range of the member.
    seven_dispersions = low_word(product(z3.BitVecVal(7, 32), zero_extend(robust["dispersion"], 32)))
    average = z3.LShR(seven_dispersions + ratio, 3)
    limited_average = minimum_of(average, z3.BitVecVal(2**16 - 1, 32))
    new_dispersion = z3.If(z3.ULT(limited_average, 2**8), z3.BitVecVal(2**8, 32), limited_average)
    new_members = {
        "batch_t": robot["t"],
        "batch_n": robot["n"],
        "dispersion": z3.If(largest_square == 0, robust["dispersion"], z3.Extract(15, 0, new_dispersion)),
    }
    return is_same(robot_after, {**robot, "robust": {**robust, **new_members}})


def _ratio_times_variance(ratio: Any, variance: Any) -> Any:
    """Return the product of a ratio and a variance in units of 2^-22, rounded down.

    The unit of the product is 2^-40 at first. It is formed of both words of the variance.
    """
    upper_part = product(ratio, high_word(variance)) << 14
    return upper_part + z3.LShR(product(ratio, low_word(variance)), 18)


def _square_of_deviation(black_count: Any, expected: Any) -> Any:
    """Return the squared difference of two counts in units of 2^-22; ``expected`` has the unit 2^-32.

    Where the difference, in units of 2^-11, has more than 32 bits, it counts as the largest word.
    """
    observed = z3.Concat(black_count, z3.BitVecVal(0, 32))
    deviation = z3.If(z3.UGT(observed, expected), observed - expected, expected - observed)
    short_deviation = z3.LShR(deviation, 21)
    limited_deviation = z3.If(
        high_word(short_deviation) == 0, low_word(short_deviation), z3.BitVecVal(-1, 32)
    )
    return product(limited_deviation, limited_deviation)


# design: R37
END_BATCH = Contract(
    _is_batch_ended,
    requires=_is_robust_robot,
    stand_ins={
        "quotient": stand_in("quotient", requires=QUOTIENT.requires),
        **{name: stand_in(name) for name in ("multiply", "multiply_high")},
    },
)

ESTIMATE_COUNT = z3.BitVec("estimate_count", 32)
SORTED_ESTIMATES = {index: z3.BitVec(f"sorted_estimate_{index}", 16) for index in range(SLOTS)}
"""The number of estimates that sort_estimates() writes, and the elements of its array: any numbers."""


def _call_sort_estimates(machine: Machine, _robot: Any, sorted_estimates: Pointer) -> Number:
    """Stand in for sort_estimates(), which fills an array, and returns a count of at most 32."""
    for index, estimate in SORTED_ESTIMATES.items():
        sorted_estimates.container[index] = Number(estimate, IntegerType(16))
    machine.facts.append(z3.ULE(ESTIMATE_COUNT, SLOTS))
    return Number(ESTIMATE_COUNT, IntegerType(32))


def is_b_hat_or_zero(b_hat: Any, *_arguments: Any) -> Any:
    """Return that the result of a function is in the range of b_hat, or 0 for none."""
    return z3.Or(b_hat == 0, z3.And(z3.UGE(b_hat, B_HAT_RANGE[0]), z3.ULE(b_hat, B_HAT_RANGE[1])))


def has_observed(robot: dict[str, Any], *_arguments: Any) -> Any:
    """Return that the robot has an observation."""
    return robot["t"] != 0


def may_run(robot: dict[str, Any]) -> Any:
    """Return what a run needs: the robust filter, an observation, and an initial b_hat in its range."""
    b_hat = robot["robust"]["initial_b_hat"]
    has_b_hat = z3.And(b_hat != 0, is_b_hat_or_zero(b_hat))
    return z3.And(_is_robust_robot(robot), has_observed(robot), z3.ULE(robot["n"], robot["t"]), has_b_hat)


def _median_of_estimates() -> Any:
    """Return the median of the sorted estimates in units of 2^-24: the middle one, or the mean of two."""

    def estimate_at(position: Any) -> Any:
        estimate = SORTED_ESTIMATES[0]
        for index, other_estimate in SORTED_ESTIMATES.items():
            estimate = z3.If(position == index, other_estimate, estimate)
        return zero_extend(estimate, 32)

    sum_of_middle_two = estimate_at(z3.UDiv(ESTIMATE_COUNT - 1, 2)) + estimate_at(z3.UDiv(ESTIMATE_COUNT, 2))
    # A shift by 8 would change the unit from 2^-16 to 2^-24. The mean is half of the sum: one bit less.
    return sum_of_middle_two << 7


def _is_run_of_filter(b_hat: Any, robot_after: dict[str, Any], robot: dict[str, Any]) -> Any:
    """Return that a run gives the b_hat of section 13, and counts its test.

    In this proof the called functions may return anything for their arguments: the claim is that each call
    has the right arguments. Beside the counter of tests, the run changes only what end_batch() changes.
    """
    initial_b_hat, tests = robot["robust"]["initial_b_hat"], robot["counters"]["tests"]
    estimates = (SORTED_ESTIMATES, ESTIMATE_COUNT)
    share = result_of("quotient", 32, zero_extend(robot["n"]), zero_extend(robot["t"]))
    centre = _median_of_estimates()
    spread = result_of("median_distance", 32, *estimates, centre)
    for _ in range(3):
        centre = result_of("huber_step", 32, *estimates, centre, spread)
    # The test takes units of 2^-32. Before it the batch has ended, and after it the robot stays as it is.
    centre, spread = centre << 8, spread << 8
    rejects = result_of("robust_test_rejects", 1, robot_after, share, centre, spread)
    is_supported = result_of("is_supported", 1, robot_after, *estimates, share, centre)
    new_b_hat = result_of("reestimate", 32, robot_after, centre)

    is_tested = z3.UGE(ESTIMATE_COUNT, 5)
    is_updated = z3.And(rejects != 0, is_supported == 0)
    # 0 means that b_hat stays as it is.
    kept_b_hat = z3.If(robot["accuracy"]["b_hat"] == initial_b_hat, z3.BitVecVal(0, 32), initial_b_hat)
    expected_b_hat = z3.If(is_updated, new_b_hat, kept_b_hat)
    expected_robot = {
        **robot,
        "robust": result_of("end_batch robust", robot["robust"], robot, share),
        "counters": {**robot["counters"], "tests": z3.If(is_tested, tests + 1, tests)},
    }
    return z3.And(
        b_hat == z3.If(is_tested, expected_b_hat, z3.BitVecVal(0, 32)),
        is_b_hat_or_zero(b_hat),
        is_same(robot_after, expected_robot),
    )


# design: R37
RUN = Contract(
    _is_run_of_filter,
    requires=may_run,
    stand_ins={
        "sort_estimates": _call_sort_estimates,
        "quotient": stand_in("quotient", requires=QUOTIENT.requires),
        "end_batch": stand_in("end_batch", "robust", requires=_is_robust_robot, ensures=keeps_initial_b_hat),
        "reestimate": stand_in("reestimate", requires=has_observed, ensures=is_b_hat_or_zero),
        **{
            name: stand_in(name)
            for name in ("median_distance", "huber_step", "robust_test_rejects", "is_supported")
        },
    },
)

CONTRACTS = {
    "next_slot": NEXT_SLOT,
    "statistics_after_vote": VOTE_STATISTICS,
    "take_vote": VOTE,
    "robust_test_rejects": ROBUST_TEST,
    "end_batch": END_BATCH,
    "run_robust_filter": RUN,
}
