"""Claims about the robust filter (docs/design.md, section 13), for all inputs.

A vote moves the centre and the spread as that section says, keeps both in their ranges, and never moves the
centre beyond the vote. The test of the initial b_hat is formed as that section says, none of its products
wraps, and it decides as exact rational arithmetic does, except within ``MARGIN`` of the threshold. A run of
the filter changes nothing but what it may change.
"""

from __future__ import annotations

from collections.abc import Iterator
from fractions import Fraction
from functools import partial
from typing import Any, cast

import z3

from mcp_asdf_tools.crosscheck import bounds
from proofs.arithmetic import SHIFT_RESULTS, WORD_CONTRACTS, are_leading_zeros, is_upper_product, zero_extend
from proofs.formulas import ONE, function_terms, is_same, result_of
from proofs.machine import Machine, Summary
from proofs.numbers import Number
from proofs.prove import Claim, Contract, Formula, UnprovenError, any_result, prove
from proofs.source import Program

MARGIN = bounds.ROBUST_TEST_MARGIN
"""By how much one side of the test's inequality must exceed the other, as a share of its right side."""
B_HAT_RANGE = (2**12, 2**32 - 2**12)
SLOTS = 32
VOTES_MAX = 2**9
DISPERSION_RANGE = (2**8, 2**16 - 1)


def minimum_of(a: Any, b: Any) -> Any:
    """Return the smaller of two words."""
    return z3.If(z3.ULT(a, b), a, b)


# --- A vote ----------------------------------------------------------------------------------------------


def votes_after(robust: dict[str, Any]) -> Any:
    """Return the number of votes after one more."""
    return minimum_of(zero_extend(robust["votes"], 32) + 1, z3.BitVecVal(VOTES_MAX, 32))


def gain_shift(votes: Any) -> Any:
    """Return max(bits(votes) - 3, 3), for fewer than 2^10 votes."""
    shift = z3.BitVecVal(3, 32)
    for bits in range(7, 11):
        shift = z3.If(z3.UGE(votes, 2 ** (bits - 1)), z3.BitVecVal(bits - 3, 32), shift)
    return shift


def _call_leading_zeros(machine: Machine, votes: Number) -> Number:
    """Stand in for leading_zeros() by its lemma, where its argument is the new number of votes."""
    robust = machine.argument_terms["robot"]["robust"]
    machine.require(votes.term == votes_after(robust) | 32, "votes")
    leading_zeros = WORD_CONTRACTS["leading_zeros"].as_summary("leading_zeros")
    return cast("Number", leading_zeros(machine, votes))


def _call_shift_right(machine: Machine, value: Number, count: Number) -> Number:
    """Stand in for shift_right() by its lemma, with a count that is the section's shift, or one more.

    The count is written as the section has it, so that the terms of both sides look alike.
    """
    shift = gain_shift(votes_after(machine.argument_terms["robot"]["robust"]))
    try:
        prove(count.term == shift, *machine.assumptions_here())
    except UnprovenError:
        prove(count.term == shift + 1, *machine.assumptions_here(), description="shift")
        shift += 1
    machine.require(z3.ULE(shift, 8), "a shift by at most 8")
    return Number(SHIFT_RESULTS["shift_right"](value.term, shift), value.type)


def _call_next_slot(machine: Machine, filled_slots: Number, turn: Number, has_confidence: Number) -> Number:
    """Stand in for next_slot(): the same slot for the same arguments, and 32 at most (see ``NEXT_SLOT``)."""
    slot = result_of("next_slot", filled_slots.term, turn.term, has_confidence.term)
    machine.assume(z3.ULE(slot, SLOTS))
    return Number(slot, filled_slots.type)


def is_in_range(robust: dict[str, Any]) -> Any:
    """Return that the members that a vote changes are in their ranges."""
    return z3.And(
        z3.ULE(robust["centre"], 2**30),
        z3.UGE(robust["spread"], 2**18),
        z3.ULE(robust["spread"], 2**28),
        z3.ULE(robust["votes"], VOTES_MAX),
    )


def may_vote(robot: dict[str, Any]) -> Any:
    """Return what a vote needs: the members in their ranges, and an own x_hat of at most 1."""
    return z3.And(is_in_range(robot["robust"]), z3.ULE(robot["x_hat"], ONE))


def _has_slots(robot: dict[str, Any]) -> Any:
    return robot["robust"]["filled_slots"] != 0


def _next_slot(robot: dict[str, Any]) -> Any:
    """Return the slot that votes; 32 stands for the robot's own estimate."""
    has_confidence = z3.If(z3.LShR(robot["alpha"], 8) != 0, z3.BitVecVal(1, 1), z3.BitVecVal(0, 1))
    robust = robot["robust"]
    return result_of("next_slot", robust["filled_slots"], zero_extend(robust["turn"], 32), has_confidence)


def _vote_of(robot: dict[str, Any]) -> Any:
    """Return the vote in units of 2^-30: 2^14 times a slot's estimate, or 2^7 times the robot's own x_hat."""
    # Of x_hat in units of 2^-23, and of slots in units of 2^-16.
    slot, vote = _next_slot(robot), robot["x_hat"] << 7
    for index, estimate in robot["received"]["estimates"].items():
        vote = z3.If(slot == int(index), zero_extend(estimate, 32) << 14, vote)
    return vote


def _vote_formulas(robot_after: dict[str, Any], robot: dict[str, Any]) -> tuple[Any, ...]:
    """Return the section's formulas for a vote, each by itself; without a filled slot nothing changes."""
    robust_before, robust_after = robot["robust"], robot_after["robust"]
    centre, spread, vote = robust_before["centre"], robust_before["spread"], _vote_of(robot)
    new_votes, slot = votes_after(robust_before), _next_slot(robot)
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
    # The next vote is of a later slot; after the robot's own estimate the turn begins anew.
    new_turn = z3.If(slot == SLOTS, z3.BitVecVal(0, 8), z3.Extract(7, 0, slot) + 1)
    changed_names = {"centre", "spread", "votes", "turn"}
    kept_members = {name: member for name, member in robust_before.items() if name not in changed_names}
    other_members = {name: member for name, member in robot.items() if name != "robust"}
    has_slots = _has_slots(robot)
    return (
        z3.Implies(has_slots, zero_extend(robust_after["votes"], 32) == new_votes),
        z3.Implies(z3.And(has_slots, is_above), robust_after["centre"] == centre + centre_step),
        z3.Implies(z3.And(has_slots, z3.Not(is_above)), robust_after["centre"] == centre - centre_step),
        z3.Implies(has_slots, robust_after["spread"] == limited_spread),
        z3.Implies(has_slots, robust_after["turn"] == new_turn),
        z3.Implies(z3.Not(has_slots), is_same(robust_after, robust_before)),
        z3.And(is_same(robust_after, kept_members), is_same(robot_after, other_members)),
    )


def _vote_step(formula_index: int) -> Formula:
    """Return one of the section's formulas as a step of the proof."""
    return lambda robot_after, robot: _vote_formulas(robot_after, robot)[formula_index]


def _stays_in_range(robot_after: dict[str, Any], robot: dict[str, Any]) -> Any:
    """Return that the ranges hold again, and the new centre is between the old one and the vote."""
    old_centre, new_centre = robot["robust"]["centre"], robot_after["robust"]["centre"]
    vote = _vote_of(robot)
    is_between = z3.Or(
        z3.And(z3.ULE(old_centre, new_centre), z3.ULE(new_centre, vote)),
        z3.And(z3.ULE(vote, new_centre), z3.ULE(new_centre, old_centre)),
    )
    return z3.And(is_in_range(robot_after["robust"]), z3.Or(z3.Not(_has_slots(robot)), is_between))


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
NEXT_SLOT = Contract(_is_next_slot, requires=_has_filled_slot)
VOTE = Contract(
    _stays_in_range,
    requires=may_vote,
    proof_steps=tuple(_vote_step(formula_index) for formula_index in range(7)),
    stand_ins={
        "leading_zeros": _call_leading_zeros,
        "shift_right": _call_shift_right,
        "next_slot": _call_next_slot,
    },
)

# --- The test ----------------------------------------------------------------------------------------------


# design: R38
def robust_test_claims(program: Program) -> Iterator[Claim]:
    """Claim that the code forms the section's test, of products that may be any."""
    arguments, result, _ = function_terms(program, "robust_test_rejects")
    robust, t, share = arguments["robust"], arguments["t"], arguments["share"]
    product, upper_product = partial(result_of, "multiply"), partial(result_of, "multiply_high")
    b_hat, centre = robust["initial_b_hat"], arguments["centre"]
    p = upper_product(b_hat, centre) + upper_product(~b_hat, ~centre)
    v_of_p, v_of_share = upper_product(p, -p), upper_product(share, -share)
    # g is |2 b_hat - 1|; the first bit of b_hat tells whether 2 b_hat - 1 is negative.
    g = z3.If(z3.LShR(b_hat, 31) == 0, -2 * b_hat, 2 * b_hat)
    wide_b_hat, wide_g = zero_extend(b_hat), zero_extend(g)
    is_positive_g = z3.And(2 * wide_b_hat - 2**32 == wide_g, z3.UGE(b_hat, 2**31))
    is_negated_g = 2**32 - 2 * wide_b_hat == wide_g
    is_b_hat = z3.And(z3.UGE(b_hat, B_HAT_RANGE[0]), z3.ULE(b_hat, B_HAT_RANGE[1]))
    yield Claim("g", z3.Or(is_positive_g, is_negated_g), [is_b_hat])
    # Squares have 64 bits and are in units of 2^-64.
    g_spread = upper_product(g, arguments["spread"])
    deviation = z3.If(z3.UGT(share, p), share - p, p - share)
    square, least_square = product(deviation, deviation), 12 * product(g_spread, g_spread)
    excess = square - least_square
    excess_high, excess_low = result_of("high_word", excess), result_of("low_word", excess)
    t_excess = product(t, excess_high) + zero_extend(result_of("high_word", product(t, excess_low)))
    v = z3.If(z3.UGT(v_of_share, v_of_p), v_of_share, v_of_p)
    # The product of a constant and a half word fits in the lower word.
    dispersion_product = product(z3.BitVecVal(12, 32), zero_extend(robust["dispersion"], 32))
    limit = z3.LShR(product(result_of("low_word", dispersion_product), v), 8)
    rejects = z3.And(z3.UGT(square, least_square), z3.UGT(t_excess, limit))
    yield Claim("the test", (result == 1) == rejects, [])


# --- A run of the filter ------------------------------------------------------------------------------------

RUN_CHANGES = ("batch_t", "batch_n", "dispersion")
"""Members of the robust filter that a run of it may change."""


def _is_b_hat_or_zero(b_hat: Any, *_arguments: Any) -> Any:
    return z3.Or(b_hat == 0, z3.And(z3.UGE(b_hat, B_HAT_RANGE[0]), z3.ULE(b_hat, B_HAT_RANGE[1])))


def may_run(robot: dict[str, Any]) -> Any:
    """Return what a run of the filter needs: an initial b_hat in its range."""
    b_hat = robot["robust"]["initial_b_hat"]
    return z3.And(b_hat != 0, _is_b_hat_or_zero(b_hat))


ESTIMATE_COUNT = z3.BitVec("estimate_count", 32)
"""Number of the estimates that a robot keeps. It stands for the result of sort_estimates()."""
REJECTS, IS_SUPPORTED = z3.BitVecs("rejects is_supported", 1)
"""Whether the test rejects, and whether two fifths support the robot: 1 for yes, 0 for no.

They stand for the results of robust_test_rejects() and is_supported(), of which nothing is known.
"""
NEW_B_HAT = z3.BitVec("new_b_hat", 32)
"""The re-estimated b_hat, or 0 if there is none. It stands for the result of reestimate().

Its range is what ``REESTIMATE`` proves.
"""


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


def _call_end_batch(machine: Machine, robot: Any, _: Number) -> None:
    """Stand in for end_batch(): it may change the batch and the dispersion."""
    for name in RUN_CHANGES:
        location = robot.select("robust", name)
        machine.store(location, machine.fresh_number(name, machine.load(location).type))


def _call_sort_estimates(machine: Machine, robot: Any, estimates: Any) -> Number:
    """Stand in for sort_estimates(): at most 32 estimates, whatever they are."""
    count = any_result("sort_estimates")(machine, robot, estimates)
    machine.assume(z3.ULE(ESTIMATE_COUNT, SLOTS))
    return Number(ESTIMATE_COUNT, count.type)


def _call_reestimate(machine: Machine, _robot: Any, x_bar: Number) -> Number:
    """Stand in for reestimate(): a b_hat in its range or 0, whatever it is."""
    machine.assume(_is_b_hat_or_zero(NEW_B_HAT))
    return Number(NEW_B_HAT, x_bar.type)


def _summary_with_result(name: str, term: Any) -> Summary:
    """Return what stands in for a function that returns this term and changes nothing."""

    def return_term(machine: Machine, *_arguments: Any) -> Number:
        result = machine.fresh_value(machine.program.signatures[name].type, name)
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
        "end_batch": _call_end_batch,
        "sort_estimates": _call_sort_estimates,
        "robust_test_rejects": _summary_with_result("robust_test_rejects", REJECTS),
        "is_supported": _summary_with_result("is_supported", IS_SUPPORTED),
        "reestimate": _call_reestimate,
        **{name: any_result(name) for name in ("quotient", "median_distance", "huber_step")},
    },
)

# --- Numbers: the test's integers, and how far they are from what they stand for -------------------------

UNIT = Fraction(1, 2**32)
WORD_MAX = 2**32 - 1


def _to_real(value: Fraction) -> Any:
    """Return a fraction as a term."""
    return z3.Q(value.numerator, value.denominator)


def _is_upper_word(quotient: Any, product: Any) -> Any:
    """Return that the quotient is the product / 2^32, rounded down."""
    return is_upper_product(quotient, product, 1)


def _phi_in_range(phi: Any) -> list[Any]:
    """Return that phi is in the range of the dispersion."""
    return [phi >= DISPERSION_RANGE[0], phi <= DISPERSION_RANGE[1]]


def _products_of_p(b_hat: Any, fill_ratio: Any, product: Any, other_product: Any) -> list[Any]:
    """Return what is known of the two products that the test adds up to p. Each is rounded down."""
    is_product = _is_upper_word(product, b_hat * fill_ratio)
    is_other_product = _is_upper_word(other_product, (WORD_MAX - b_hat) * (WORD_MAX - fill_ratio))
    ranges = [b_hat >= B_HAT_RANGE[0], b_hat <= B_HAT_RANGE[1], fill_ratio >= 0, fill_ratio <= WORD_MAX]
    return [*ranges, is_product, is_other_product]


def wrapping_claims() -> Iterator[Claim]:
    """Claim that no sum or product of the test wraps, so that its words are the section's integers."""
    b_hat, fill_ratio, product, other_product = z3.Ints("b_hat fill_ratio product other")
    p = product + other_product
    p_assumptions = _products_of_p(b_hat, fill_ratio, product, other_product)
    yield Claim("p", z3.And(p > 0, p < WORD_MAX), p_assumptions)

    g, spread, g_spread = z3.Ints("g spread g_spread")
    g_ranges = [g >= 0, g <= WORD_MAX, spread >= 0, spread <= 2**30]
    g_spread_fits = z3.And(g_spread >= 0, g_spread < 2**30)
    yield Claim("g spread", g_spread_fits, [*g_ranges, _is_upper_word(g_spread, g * spread)])
    least_square = 12 * (g_spread * g_spread)
    yield Claim("least", least_square < 2**64, [g_spread >= 0, g_spread < 2**30])

    share, v = z3.Ints("share v")
    v_assumptions = [share >= 1, share <= WORD_MAX, _is_upper_word(v, share * (2**32 - share))]
    yield Claim("v", z3.And(v >= 0, v <= 2**30), v_assumptions)

    dispersion, v = z3.Ints("dispersion v")
    dispersion_ranges = [dispersion >= 0, dispersion <= DISPERSION_RANGE[1], v >= 0, v <= 2**30]
    dispersion_fits = z3.And(12 * dispersion < 2**32, 12 * dispersion * v < 2**64)
    yield Claim("12 dispersion v", dispersion_fits, dispersion_ranges)

    t, excess, high, low, upper_product = z3.Ints("t excess high low above")
    t_assumptions = [t >= 0, t < 2**32, excess >= 0, excess < 2**64]
    t_assumptions += [excess == 2**32 * high + low, low >= 0, low < 2**32]
    t_assumptions += [_is_upper_word(upper_product, t * low), high >= 0]
    t_excess = t * high + upper_product
    t_excess_fits = z3.And(_is_upper_word(t_excess, t * excess), t_excess >= 0, t_excess < 2**64)
    yield Claim("t excess", t_excess_fits, t_assumptions)


# design: R37
def dispersion_claims() -> Iterator[Claim]:
    """Claim that no product of end_batch() wraps, and the dispersion stays in its range."""
    d, share, variance, phi = z3.Ints("d share variance phi")
    share_range = [share >= 0, share < 2**32]
    is_variance = _is_upper_word(variance, share * (2**32 - share))
    yield Claim("variance of one", z3.And(variance >= 0, variance <= 2**30), [*share_range, is_variance])
    ranges = [d >= 0, d <= 2**31, variance >= 0, variance <= 2**30, *_phi_in_range(phi)]
    yield Claim("variance of the batch", d * variance <= 2**61, ranges)
    yield Claim("limit", 12 * phi * (d * variance) < 2**63 * 2**18, ranges)

    high, low = z3.Ints("high low")
    word_ranges = [*_phi_in_range(phi), high >= 0, high <= 2**29, low >= 0, low < 2**32]
    yield Claim("its upper part", 12 * phi * high * 2**14 < 2**64, word_ranges)

    black, difference = z3.Ints("black difference")
    black_ranges = [black >= 0, black <= d, d <= 2**31, *share_range]
    is_difference = difference == 2**32 * black - d * share
    difference_fits = z3.And(difference <= 2**63, difference >= -(2**63))
    yield Claim("difference", difference_fits, [*black_ranges, is_difference])

    ratio = z3.Int("ratio")
    average_fits = z3.And(7 * phi + ratio >= 0, 7 * phi + ratio < 2**32)
    yield Claim("average", average_fits, [*_phi_in_range(phi), ratio >= 0, ratio < 2**20])


# design: R37
def centre_claims() -> Iterator[Claim]:
    """Claim that sums of 32 limited distances do not wrap, and quotient() gets what it requires."""
    spread, total, difference, inside = z3.Ints("spread total difference inside")
    yield Claim("a sum", total < 2**28, [spread >= 0, spread <= 2**22, total >= 0, total <= 32 * spread])
    ranges = [inside >= 1, inside <= 32, difference >= 0, difference < 2**28]
    divisor = 2**24 * inside
    yield Claim("divisor", z3.And(divisor > 0, divisor <= 2**29), ranges)
    dividend = z3.If(difference < divisor, difference, divisor)
    yield Claim("dividend", dividend <= divisor, ranges)
    centre, step = z3.Ints("centre step")
    largest_centre = (2**16 - 1) * 2**8
    centre_ranges = [centre >= 0, centre <= largest_centre, step >= 0, step <= 2**24]
    yield Claim("centre and step", centre + step < 2**32, centre_ranges)


def rounding_error_claims() -> Iterator[Claim]:
    """Claim that p, n / t, v and g spread, in units of 2^-32, are too small by what the section says."""
    b_hat, fill_ratio, product, other_product = z3.Reals("b_hat fill_ratio product other")
    p_assumptions = _products_of_p(b_hat, fill_ratio, product, other_product)
    word_limit = 2**32
    exact_p = b_hat * fill_ratio + (word_limit - b_hat) * (word_limit - fill_ratio)
    p_error = exact_p - word_limit * (product + other_product)
    yield Claim("p", z3.And(p_error >= 0, p_error < 4 * word_limit), p_assumptions)

    # T / 2 is rounded up to half, and n / t, which is x, is then rounded down to share.
    x, total, half, share = z3.Reals("x T half share")
    share_assumptions = [x >= 0, x <= 1, total >= 2**31, 2 * half > total, 2 * half <= total + 2]
    share_assumptions += [share * half <= 2**31 * x * total, 2**31 * x * total < (share + 1) * half]
    share_is_near = z3.And(share <= word_limit * x, word_limit * x < share + 4 * x + 1)
    yield Claim("n / t", share_is_near, share_assumptions)

    g, h, p = z3.Reals("g h p")
    # p = (1 + g h) / 2, where the fill ratio is (1 + h) / 2.
    p_of_g = [h >= -1, h <= 1, 2 * p - 1 == g * h]
    yield Claim("v is at least b_hat (1 - b_hat)", 4 * p * (1 - p) >= 1 - g * g, p_of_g)

    error, v = z3.Reals("error v")
    u, exact_v = UNIT, p * (1 - p)
    v_of_rounded_p = (p - error) * (1 - p + error)
    v_assumptions = [p >= 0, p <= 1, error >= 0, p - error >= 0]
    v_assumptions += [v <= v_of_rounded_p, v > v_of_rounded_p - _to_real(u)]
    v_is_near = z3.And(v <= exact_v + _to_real(5 * u), v >= exact_v - _to_real(6 * u))
    yield Claim("v of p", v_is_near, [*v_assumptions, error <= _to_real(4 * u)])
    yield Claim("v of n / t", v_is_near, [*v_assumptions, error <= _to_real(u) * (4 * p + 1)])


# design: R38
def exact_decision_claims() -> Iterator[Claim]:
    """Claim that the test is right, with errors as above, wherever its sides differ by MARGIN of the larger.

    It rejects for D^2 > L = 12 (v w + h^2), where h is g times the spread, and w the dispersion divided by t.
    Where g^2 <= 1/2, v is not small, else h is not. Where observations are few, D is not small either.
    """
    p, x, d, v, g, h, w = z3.Reals("p x D v g h w")
    m, limit = _to_real(MARGIN), 12 * (v * w + h * h)
    d_assumptions = [p >= 0, x <= 1, d == x - p, d >= 0, 3 * d <= 1, v >= p * (1 - p), v >= x * (1 - x)]
    yield Claim("v", 3 * v >= 2 * d, d_assumptions)

    ranges = [v > 0, 4 * v <= 1, w > 0, w <= 256, h >= 0, d >= 0, d <= 1, w * 2**31 >= 1, v * 2**21 >= 1]
    g_assumptions = [*ranges, g >= 0, g <= 1, 4 * v >= 1 - g, h * h * 2**24 >= g]
    limit_is_large = limit * 2**33 >= 12
    yield Claim("L", limit_is_large, g_assumptions)
    v_is_large, h_is_large = 8 * v >= 1, h * h * 2**25 >= 1
    yield Claim("v or h", z3.Or(v_is_large, h_is_large), g_assumptions)

    d_is_not_small = z3.Or(3 * d >= 1, 3 * v >= 2 * d)
    for case_name, is_case in (("v", v_is_large), ("h", h_is_large)):
        assumptions = [*ranges, limit_is_large, is_case, d_is_not_small]
        is_above_margin = d * d >= (1 + m) * limit
        yield Claim(
            f"above, {case_name}", d * d - _loss_above(d, w) >= limit, [*assumptions, is_above_margin]
        )
        is_below_margin = d * d <= (1 - m) * limit
        yield Claim(
            f"below, {case_name}", d * d + _gain_below(d, h, w) < limit, [*assumptions, is_below_margin]
        )


def _loss_above(d: Any, w: Any) -> Any:
    """Return by how much rounding may lower D^2 - L, where D^2 is above L."""
    u = _to_real(UNIT)
    return 10 * u * d + 61 * u * w


def _gain_below(d: Any, h: Any, w: Any) -> Any:
    """Return by how much rounding may raise D^2 - L, where D^2 is below L."""
    u = _to_real(UNIT)
    return 10 * u * d + 25 * u * u + 72 * u * w + 24 * u * h


def rounded_decision_claims() -> Iterator[Claim]:
    """Claim that ``exact_decision_claims`` carry over to the rounded numbers with which the code decides.

    The code has formed_d, formed_v and formed_h in place of d, v and h. w is the dispersion divided by t: at
    least 1 / t.
    """
    zeros, value = z3.BitVecs("zeros value", 32)
    is_long_word = [are_leading_zeros(zeros, value), z3.UGE(value, 32)]
    yield Claim("what any_calls.c admits", z3.ULE(zeros, 26), is_long_word)

    p, x, formed_p, formed_x = z3.Reals("p x formed_p formed_x")
    u = _to_real(UNIT)
    x_assumptions = [x <= 1, p >= formed_p, p < formed_p + 4 * u]
    x_assumptions += [x >= formed_x, x < formed_x + (4 * x + 1) * u]
    # x and p are each formed too small, so their distance may be off either way.
    exact_distance = z3.If(x > p, x - p, p - x)
    formed_distance = z3.If(formed_x > formed_p, formed_x - formed_p, formed_p - formed_x)
    d_error = exact_distance - formed_distance
    yield Claim("D", z3.And(d_error <= 5 * u, -d_error <= 5 * u), x_assumptions)

    product, above, limit, scaled = z3.Ints("product above limit scaled")
    # limit is scaled / 256, rounded down. An integer above limit is also above scaled / 256, and vice versa.
    is_scaled_limit = [256 * limit <= scaled, scaled < 256 * limit + 256]
    is_same_decision = (above > limit) == (256 * above > scaled)
    yield Claim("the dispersion's unit", is_same_decision, is_scaled_limit)
    is_product_decision = (above > limit) == (product >= 2**32 * (limit + 1))
    yield Claim("rejected", is_product_decision, [_is_upper_word(above, product)])

    d, formed_d, formed_v, v, h, formed_h, w, one_over_t = z3.Reals("D d V v h G w one_over_t")
    exact_limit = 12 * (v * w + h * h)
    formed_limit = 12 * (formed_v * w + formed_h * formed_h) + u * one_over_t
    ranges = [w > 0, w <= 256, one_over_t > 0, one_over_t <= w, formed_v >= 0, h >= 0, formed_h >= 0]
    above_assumptions = [*ranges, formed_h <= h, d >= 5 * u, formed_d >= d - 5 * u, formed_v <= v + 5 * u]
    above_assumptions += [d * d - _loss_above(d, w) >= exact_limit]
    yield Claim("above", formed_d * formed_d >= formed_limit, above_assumptions)
    below_assumptions = [*ranges, h < formed_h + u, d >= 0, formed_d >= 0]
    below_assumptions += [formed_d <= d + 5 * u, formed_v >= v - 6 * u]
    below_assumptions += [d * d + _gain_below(d, h, w) < exact_limit]
    yield Claim("below", formed_d * formed_d < formed_limit, below_assumptions)


CONTRACTS = {"next_slot": NEXT_SLOT, "take_vote": VOTE, "reestimate": REESTIMATE, "run_robust_filter": RUN}
OF_THE_CODE = (robust_test_claims,)
OF_THE_NUMBERS = (
    wrapping_claims,
    dispersion_claims,
    centre_claims,
    rounding_error_claims,
    exact_decision_claims,
    rounded_decision_claims,
)
