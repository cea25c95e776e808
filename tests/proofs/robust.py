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
from proofs.arithmetic import SHIFTED, WORDS, are_leading_zeros, multiply_high, widen
from proofs.formulas import ONE, Claim, call, formed, same
from proofs.machine import Machine, Summary
from proofs.numbers import Number
from proofs.prove import Contract, UnprovenError, any_result, prove
from proofs.source import Program

MARGIN = bounds.ROBUST_TEST_MARGIN
"""By how much one side of the test's inequality must exceed the other, as a share of its right side."""
B_HAT_RANGE = (2**12, 2**32 - 2**12)
SLOTS = 32
VOTES_MAX = 2**9
DISPERSION_RANGE = (2**8, 2**16 - 1)


def smaller(a: Any, b: Any) -> Any:
    """Return the smaller of two words."""
    return z3.If(z3.ULT(a, b), a, b)


# --- A vote ----------------------------------------------------------------------------------------------


def votes_after(robust: dict[str, Any]) -> Any:
    """Return the number of votes after one more."""
    return smaller(widen(robust["votes"], 32) + 1, z3.BitVecVal(VOTES_MAX, 32))


def gain_shift(votes: Any) -> Any:
    """Return max(bits(votes) - 3, 3), for fewer than 2^10 votes."""
    shift = z3.BitVecVal(3, 32)
    for bits in range(7, 11):
        shift = z3.If(z3.UGE(votes, 2 ** (bits - 1)), z3.BitVecVal(bits - 3, 32), shift)
    return shift


def _leading_zeros_of_votes(machine: Machine, votes: Number) -> Number:
    """Stand in for leading_zeros() by its lemma, where its argument is the new number of votes."""
    robust = machine.given["robot"]["robust"]
    machine.claim(votes.term == votes_after(robust) | 32, "votes")
    return cast("Number", WORDS["leading_zeros"].stands_in("leading_zeros")(machine, votes))


def _shift_by_gain(machine: Machine, value: Number, count: Number) -> Number:
    """Stand in for shift_right() by its lemma, with a count that is the section's shift, or one more.

    The count is written as the section has it, so that the terms of both sides look alike.
    """
    shift = gain_shift(votes_after(machine.given["robot"]["robust"]))
    try:
        prove(count.term == shift, *machine.known_here())
    except UnprovenError:
        prove(count.term == shift + 1, *machine.known_here(), about="shift")
        shift += 1
    machine.claim(z3.ULE(shift, 8), "a shift by at most 8")
    return Number(SHIFTED["shift_right"](value.term, shift), value.type)


def _slot_of_turn(machine: Machine, filled_slots: Number, turn: Number, has_confidence: Number) -> Number:
    """Stand in for next_slot(): the same slot for the same arguments, and 32 at most (see ``NEXT_SLOT``)."""
    slot = call("next_slot", filled_slots.term, turn.term, has_confidence.term)
    machine.know(z3.ULE(slot, SLOTS))
    return Number(slot, filled_slots.type)


def in_range(robust: dict[str, Any]) -> Any:
    """Return that the members that a vote changes are in their ranges."""
    return z3.And(
        z3.ULE(robust["centre"], 2**30),
        z3.UGE(robust["spread"], 2**18),
        z3.ULE(robust["spread"], 2**28),
        z3.ULE(robust["votes"], VOTES_MAX),
    )


def may_vote(robot: dict[str, Any]) -> Any:
    """Return what a vote needs: the members in their ranges, and an own x_hat of at most 1."""
    return z3.And(in_range(robot["robust"]), z3.ULE(robot["x_hat"], ONE))


def _has_slots(robot: dict[str, Any]) -> Any:
    return robot["robust"]["filled_slots"] != 0


def _next_slot(robot: dict[str, Any]) -> Any:
    """Return the slot that votes; 32 stands for the robot's own estimate."""
    has_confidence = z3.If(z3.LShR(robot["alpha"], 8) != 0, z3.BitVecVal(1, 1), z3.BitVecVal(0, 1))
    robust = robot["robust"]
    return call("next_slot", robust["filled_slots"], widen(robust["turn"], 32), has_confidence)


def _vote_of(robot: dict[str, Any]) -> Any:
    """Return the vote in units of 2^-30: 2^14 times a slot's estimate, or 2^7 times the robot's own x_hat."""
    slot, vote = _next_slot(robot), robot["x_hat"] << 7
    for index, estimate in robot["received"]["estimates"].items():
        vote = z3.If(slot == int(index), widen(estimate, 32) << 14, vote)
    return vote


def _vote_formulas(after: dict[str, Any], robot: dict[str, Any]) -> tuple[Any, ...]:
    """Return the section's formulas for a vote, each by itself; without a filled slot nothing changes."""
    before, result = robot["robust"], after["robust"]
    centre, spread, vote = before["centre"], before["spread"], _vote_of(robot)
    votes, slot = votes_after(before), _next_slot(robot)
    shift = gain_shift(votes)
    is_above = z3.UGT(vote, centre)
    distance = z3.If(is_above, vote - centre, centre - vote)
    step, spread_step = z3.LShR(smaller(distance, spread), shift), z3.LShR(spread, shift + 1)
    new_spread = z3.If(z3.UGT(distance, spread), spread + spread_step, spread - spread_step)
    limited_spread = z3.If(
        z3.ULT(new_spread, 2**18), z3.BitVecVal(2**18, 32), smaller(new_spread, z3.BitVecVal(2**28, 32))
    )
    turn = z3.If(slot == SLOTS, z3.BitVecVal(0, 8), z3.Extract(7, 0, slot) + 1)
    changed = {"centre", "spread", "votes", "turn"}
    unchanged = {name: member for name, member in before.items() if name not in changed}
    others = {name: member for name, member in robot.items() if name != "robust"}
    has_slots = _has_slots(robot)
    return (
        z3.Implies(has_slots, widen(result["votes"], 32) == votes),
        z3.Implies(z3.And(has_slots, is_above), result["centre"] == centre + step),
        z3.Implies(z3.And(has_slots, z3.Not(is_above)), result["centre"] == centre - step),
        z3.Implies(has_slots, result["spread"] == limited_spread),
        z3.Implies(has_slots, result["turn"] == turn),
        z3.Implies(z3.Not(has_slots), same(result, before)),
        z3.And(same(result, unchanged), same(after, others)),
    )


def _stays_in_range(after: dict[str, Any], robot: dict[str, Any]) -> Any:
    """Return that the ranges hold again, and the new centre is between the old one and the vote."""
    old, new, vote = robot["robust"]["centre"], after["robust"]["centre"], _vote_of(robot)
    is_between = z3.Or(
        z3.And(z3.ULE(old, new), z3.ULE(new, vote)), z3.And(z3.ULE(vote, new), z3.ULE(new, old))
    )
    return z3.And(in_range(after["robust"]), z3.Or(z3.Not(_has_slots(robot)), is_between))


def _is_next_slot(slot: Any, filled_slots: Any, turn: Any, has_confidence: Any) -> Any:
    """Return that a slot is the one of section 13: the first line of its list that applies."""
    later_slots = filled_slots & z3.If(z3.ULT(turn, SLOTS), z3.BitVecVal(-1, 32) << turn, z3.BitVecVal(0, 32))
    remaining = z3.If(later_slots != 0, later_slots, filled_slots)
    is_own_turn = z3.And(later_slots == 0, has_confidence != 0)
    one = z3.BitVecVal(1, 32)
    # The lowest bit that is set: this bit is set, and none below it.
    is_lowest = z3.And(z3.ULT(slot, SLOTS), remaining & ((one << slot << 1) - 1) == one << slot)
    return z3.If(is_own_turn, slot == SLOTS, is_lowest)


def _has_filled_slot(filled_slots: Any, *_: Any) -> Any:
    return filled_slots != 0


# design: R35
NEXT_SLOT = Contract(_is_next_slot, requires=_has_filled_slot)
VOTE = Contract(
    _stays_in_range,
    requires=may_vote,
    steps=tuple(partial(lambda part, *terms: _vote_formulas(*terms)[part], part) for part in range(7)),
    instead={
        "leading_zeros": _leading_zeros_of_votes,
        "shift_right": _shift_by_gain,
        "next_slot": _slot_of_turn,
    },
)

# --- The test ----------------------------------------------------------------------------------------------


# design: R38
def of_robust_test(program: Program) -> Iterator[Claim]:
    """The code forms the section's test, of products that may be any."""
    given, (result, _) = formed(program, "robust_test_rejects")
    robust, t, share = given["robust"], given["t"], given["share"]
    product, upper = partial(call, "multiply"), partial(call, "multiply_high")
    b_hat, centre = robust["initial_b_hat"], given["centre"]
    p = upper(b_hat, centre) + upper(~b_hat, ~centre)
    v_p, v_share = upper(p, -p), upper(share, -share)
    g = z3.If(z3.LShR(b_hat, 31) == 0, -2 * b_hat, 2 * b_hat)
    wide = partial(z3.ZeroExt, 32)
    is_positive = z3.And(2 * wide(b_hat) - 2**32 == wide(g), z3.UGE(b_hat, 2**31))
    is_b_hat = z3.And(z3.UGE(b_hat, B_HAT_RANGE[0]), z3.ULE(b_hat, B_HAT_RANGE[1]))
    yield "g", z3.Or(is_positive, 2**32 - 2 * wide(b_hat) == wide(g)), [is_b_hat]
    # Squares have 64 bits and are in units of 2^-64.
    g_spread = upper(g, given["spread"])
    deviation = z3.If(z3.UGT(share, p), share - p, p - share)
    square, least = product(deviation, deviation), 12 * product(g_spread, g_spread)
    high, low = call("high_word", square - least), call("low_word", square - least)
    t_excess = product(t, high) + wide(call("high_word", product(t, low)))
    v = z3.If(z3.UGT(v_share, v_p), v_share, v_p)
    # The product of a constant and a half word fits in the lower word.
    dispersion_12 = call("low_word", product(z3.BitVecVal(12, 32), widen(robust["dispersion"], 32)))
    limit = z3.LShR(product(dispersion_12, v), 8)
    rejects = z3.And(z3.UGT(square, least), z3.UGT(t_excess, limit))
    yield "the test", (result == 1) == rejects, []


# --- A run of the filter ------------------------------------------------------------------------------------

RUN_CHANGES = ("batch_t", "batch_n", "dispersion")
"""Members of the robust filter that a run of it may change."""


def _is_b_hat_or_zero(b_hat: Any) -> Any:
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


def _run_formulas(b_hat: Any, after: dict[str, Any], robot: dict[str, Any]) -> Any:
    """Return that a run gives the b_hat of section 13, and counts its test.

    Beside that it changes the batch and the dispersion at most.
    """
    before = robot["robust"]
    initial_b_hat, tests = before["initial_b_hat"], robot["counters"]["tests"]
    is_tested = z3.UGE(ESTIMATE_COUNT, 5)
    is_updated = z3.And(REJECTS != 0, IS_SUPPORTED == 0)
    kept_b_hat = z3.If(robot["accuracy"]["b_hat"] == initial_b_hat, z3.BitVecVal(0, 32), initial_b_hat)
    expected_b_hat = z3.If(is_updated, NEW_B_HAT, kept_b_hat)
    kept = {name: member for name, member in before.items() if name not in RUN_CHANGES}
    others = {name: member for name, member in robot.items() if name not in ("robust", "counters")}
    counters = {**robot["counters"], "tests": z3.If(is_tested, tests + 1, tests)}
    return z3.And(
        b_hat == z3.If(is_tested, expected_b_hat, z3.BitVecVal(0, 32)),
        _is_b_hat_or_zero(b_hat),
        same(after["robust"], kept),
        same(after["counters"], counters),
        same(after, others),
    )


def _batch_ends(machine: Machine, robot: Any, _: Number) -> None:
    """Stand in for end_batch(): it may change the batch and the dispersion."""
    for name in RUN_CHANGES:
        place = robot.below("robust", name)
        machine.store(place, machine.unknown(name, machine.load(place).type))


def _sorted_estimates(machine: Machine, robot: Any, estimates: Any) -> Number:
    """Stand in for sort_estimates(): at most 32 estimates, whatever they are."""
    count = any_result("sort_estimates")(machine, robot, estimates)
    machine.know(z3.ULE(ESTIMATE_COUNT, SLOTS))
    return Number(ESTIMATE_COUNT, count.type)


def _new_b_hat(machine: Machine, _: Any, x_bar: Number) -> Number:
    """Stand in for reestimate(): a b_hat in its range or 0, whatever it is."""
    machine.know(_is_b_hat_or_zero(NEW_B_HAT))
    return Number(NEW_B_HAT, x_bar.type)


def _result_named(name: str, term: Any) -> Summary:
    """Return what stands in for a function that returns this term and changes nothing."""

    def summary(machine: Machine, *_: Any) -> Number:
        return Number(term, machine.unknown_of(machine.program.heads[name].type, name).type)

    return summary


def _gives_b_hat_or_zero(b_hat: Any, *_: Any) -> Any:
    return _is_b_hat_or_zero(b_hat)


REESTIMATE = Contract(
    _gives_b_hat_or_zero, instead={name: any_result(name) for name in ("multiply", "quotient")}
)

# design: R37
RUN = Contract(
    _run_formulas,
    requires=may_run,
    instead={
        "end_batch": _batch_ends,
        "sort_estimates": _sorted_estimates,
        "robust_test_rejects": _result_named("robust_test_rejects", REJECTS),
        "is_supported": _result_named("is_supported", IS_SUPPORTED),
        "reestimate": _new_b_hat,
        **{name: any_result(name) for name in ("quotient", "median_distance", "huber_step")},
    },
)

# --- Numbers: the test's integers, and how far they are from what they stand for -------------------------

UNIT = Fraction(1, 2**32)


def _products_of_p(b_hat: Any, fill_ratio: Any, product: Any, other: Any) -> list[Any]:
    """Return what is known of the two products that the test adds up to p. Each is rounded down."""
    most = 2**32 - 1
    return [
        *(b_hat >= B_HAT_RANGE[0], b_hat <= B_HAT_RANGE[1], fill_ratio >= 0, fill_ratio <= most),
        *(_floor(product, b_hat * fill_ratio), _floor(other, (most - b_hat) * (most - fill_ratio))),
    ]


def of_integers() -> Iterator[Claim]:
    """No sum or product of the test wraps, so that its words are the section's integers."""
    b_hat, fill_ratio, product, other = z3.Ints("b_hat fill_ratio product other")
    one, most = 2**32, 2**32 - 1
    known = _products_of_p(b_hat, fill_ratio, product, other)
    p = product + other
    yield "p", z3.And(p > 0, p < most), known
    g, spread, g_spread = z3.Ints("g spread g_spread")
    known = [g >= 0, g <= most, spread >= 0, spread <= 2**30, _floor(g_spread, g * spread)]
    yield "g spread", z3.And(g_spread >= 0, g_spread < 2**30), known
    yield "least", 12 * (g_spread * g_spread) < 2**64, [g_spread >= 0, g_spread < 2**30]
    share, v = z3.Ints("share v")
    known = [share >= 1, share <= most, _floor(v, share * (one - share))]
    yield "v", z3.And(v >= 0, v <= 2**30), known
    dispersion, v = z3.Ints("dispersion v")
    known = [dispersion >= 0, dispersion <= DISPERSION_RANGE[1], v >= 0, v <= 2**30]
    yield "12 dispersion v", z3.And(12 * dispersion < 2**32, 12 * dispersion * v < 2**64), known
    t, excess, high, low, above = z3.Ints("t excess high low above")
    known = [t >= 0, t < one, excess >= 0, excess < 2**64, excess == one * high + low, low >= 0, low < one]
    known += [_floor(above, t * low), high >= 0]
    total = t * high + above
    yield "t excess", z3.And(_floor(total, t * excess), total >= 0, total < 2**64), known


# design: R37
def of_the_dispersion() -> Iterator[Claim]:
    """No product of end_batch() wraps, and the dispersion stays in its range."""
    d, share, variance, phi = z3.Ints("d share variance phi")
    known = [share >= 0, share < 2**32, _floor(variance, share * (2**32 - share))]
    yield "variance of one", z3.And(variance >= 0, variance <= 2**30), known
    known = [d >= 0, d <= 2**31, variance >= 0, variance <= 2**30]
    known += [phi >= DISPERSION_RANGE[0], phi <= DISPERSION_RANGE[1]]
    yield "variance of the batch", d * variance <= 2**61, known
    yield "limit", 12 * phi * (d * variance) < 2**63 * 2**18, known
    high, low = z3.Ints("high low")
    known = [phi >= DISPERSION_RANGE[0], phi <= DISPERSION_RANGE[1], high >= 0, high <= 2**29]
    known += [low >= 0, low < 2**32]
    yield "its upper part", 12 * phi * high * 2**14 < 2**64, known
    black, difference = z3.Ints("black difference")
    known = [black >= 0, black <= d, d <= 2**31, share >= 0, share < 2**32]
    known += [difference == 2**32 * black - d * share]
    yield "difference", z3.And(difference <= 2**63, difference >= -(2**63)), known
    ratio = z3.Int("ratio")
    known = [phi >= DISPERSION_RANGE[0], phi <= DISPERSION_RANGE[1], ratio >= 0, ratio < 2**20]
    yield "average", z3.And(7 * phi + ratio >= 0, 7 * phi + ratio < 2**32), known


# design: R37
def of_the_centre() -> Iterator[Claim]:
    """Sums of 32 limited distances do not wrap, and quotient() gets what it requires."""
    spread, total, difference, inside = z3.Ints("spread total difference inside")
    known = [spread >= 0, spread <= 2**22, total >= 0, total <= 32 * spread]
    yield "a sum", total < 2**28, known
    known = [inside >= 1, inside <= 32, difference >= 0, difference < 2**28]
    divisor = 2**24 * inside
    yield "divisor", z3.And(divisor > 0, divisor <= 2**29), known
    yield "dividend", z3.If(difference < divisor, difference, divisor) <= divisor, known
    centre, step = z3.Ints("centre step")
    largest = (2**16 - 1) * 2**8
    known = [centre >= 0, centre <= largest, step >= 0, step <= 2**24]
    yield "centre and step", centre + step < 2**32, known


def _floor(quotient: Any, product: Any) -> Any:
    return multiply_high(quotient, product, 1)


def of_errors() -> Iterator[Claim]:
    """p, n / t, v and g spread, in units of 2^-32, are too small by what the section says."""
    b_hat, fill_ratio, product, other = z3.Reals("b_hat fill_ratio product other")
    known = _products_of_p(b_hat, fill_ratio, product, other)
    one = 2**32
    lost = b_hat * fill_ratio + (one - b_hat) * (one - fill_ratio) - one * (product + other)
    yield "p", z3.And(lost >= 0, lost < 4 * one), known
    x, total, half, share = z3.Reals("x T half share")
    known = [x >= 0, x <= 1, total >= 2**31, 2 * half > total, 2 * half <= total + 2]
    known += [share * half <= 2**31 * x * total, 2**31 * x * total < (share + 1) * half]
    yield "n / t", z3.And(share <= one * x, one * x < share + 4 * x + 1), known
    g, h, p = z3.Reals("g h p")
    known = [h >= -1, h <= 1, 2 * p - 1 == g * h]
    yield "v is at least b_hat (1 - b_hat)", 4 * p * (1 - p) >= 1 - g * g, known
    error, v = z3.Reals("error v")
    exact, u = p * (1 - p), UNIT
    known = [p >= 0, p <= 1, error >= 0, p - error >= 0, v <= (p - error) * (1 - p + error)]
    known += [v > (p - error) * (1 - p + error) - _real(u)]
    for name, largest_error in (("v of p", _real(4 * u)), ("v of n / t", _real(u) * (4 * p + 1))):
        near = z3.And(v <= exact + _real(5 * u), v >= exact - _real(6 * u))
        yield name, near, [*known, error <= largest_error]


def _real(value: Fraction) -> Any:
    return z3.Q(value.numerator, value.denominator)


# design: R38
def of_the_decision() -> Iterator[Claim]:
    """The test is right, with errors as above, wherever its sides differ by MARGIN of the larger.

    It rejects for D^2 > L = 12 (v w + h^2), where h is g times the spread, and w the dispersion divided by t.
    Where g^2 <= 1/2, v is not small, else h is not. Where observations are few, D is not small either.
    """
    p, x, d, v, g, h, w = z3.Reals("p x D v g h w")
    u, m, limit = _real(UNIT), _real(MARGIN), 12 * (v * w + h * h)
    known = [p >= 0, x <= 1, d == x - p, d >= 0, 3 * d <= 1, v >= p * (1 - p), v >= x * (1 - x)]
    yield "v", 3 * v >= 2 * d, known
    ranges = [v > 0, 4 * v <= 1, w > 0, w <= 256, h >= 0, d >= 0, d <= 1, w * 2**31 >= 1, v * 2**21 >= 1]
    known = [*ranges, g >= 0, g <= 1, 4 * v >= 1 - g, h * h * 2**24 >= g]
    yield "L", limit * 2**33 >= 12, known
    large = z3.Or(8 * v >= 1, h * h * 2**25 >= 1)
    yield "v or h", large, known
    few = z3.Or(3 * d >= 1, 3 * v >= 2 * d)
    errors = 10 * u * d + 61 * u * w
    for name, case in (("v", 8 * v >= 1), ("h", h * h * 2**25 >= 1)):
        known = [*ranges, limit * 2**33 >= 12, case, few]
        above = [*known, d * d >= (1 + m) * limit]
        yield f"above, {name}", d * d - errors >= limit, above
        below = [*known, d * d <= (1 - m) * limit]
        lost = 10 * u * d + 25 * u * u + 72 * u * w + 24 * u * h
        yield f"below, {name}", d * d + lost < limit, below


def of_the_formed() -> Iterator[Claim]:
    """The code decides with rounded numbers, formed_d, formed_v and formed_h, in place of d, v and h.

    These claims carry of_the_decision() over to them. w is the dispersion divided by t: at least 1 / t.
    """
    zeros, value = z3.BitVecs("zeros value", 32)
    known = [are_leading_zeros(zeros, value), z3.UGE(value, 32)]
    yield "what any_calls.c admits", z3.ULE(zeros, 26), known
    p, x, formed_p, formed_x = z3.Reals("p x formed_p formed_x")
    u = _real(UNIT)
    known = [x <= 1, p >= formed_p, p < formed_p + 4 * u, x >= formed_x, x < formed_x + (4 * x + 1) * u]
    off = z3.If(x > p, x - p, p - x) - z3.If(formed_x > formed_p, formed_x - formed_p, formed_p - formed_x)
    yield "D", z3.And(off <= 5 * u, -off <= 5 * u), known
    product, above, limit, scaled = z3.Ints("product above limit scaled")
    # limit is scaled / 256, rounded down. An integer above limit is also above scaled / 256, and vice versa.
    known = [256 * limit <= scaled, scaled < 256 * limit + 256]
    yield "the dispersion's unit", (above > limit) == (256 * above > scaled), known
    is_more = (above > limit) == (product >= 2**32 * (limit + 1))
    yield "rejected", is_more, [_floor(above, product)]
    d, formed_d, formed_v, v, h, formed_h, w, one_over_t = z3.Reals("D d V v h G w one_over_t")
    limit, formed = 12 * (v * w + h * h), 12 * (formed_v * w + formed_h * formed_h) + u * one_over_t
    known = [w > 0, w <= 256, one_over_t > 0, one_over_t <= w, formed_v >= 0]
    above = [*known, h >= 0, formed_h >= 0, formed_h <= h, d >= 5 * u, formed_d >= d - 5 * u]
    above += [formed_v <= v + 5 * u, d * d - (10 * u * d + 61 * u * w) >= limit]
    yield "above", formed_d * formed_d >= formed, above
    below = [*known, h >= 0, formed_h >= 0, h < formed_h + u, d >= 0, formed_d >= 0]
    below += [formed_d <= d + 5 * u, formed_v >= v - 6 * u]
    lost = 10 * u * d + 25 * u * u + 72 * u * w + 24 * u * h
    yield "below", formed_d * formed_d < formed, [*below, d * d + lost < limit]


CONTRACTS = {"next_slot": NEXT_SLOT, "take_vote": VOTE, "reestimate": REESTIMATE, "run_robust_filter": RUN}
OF_THE_CODE = (of_robust_test,)
OF_THE_NUMBERS = (of_integers, of_the_dispersion, of_the_centre, of_errors, of_the_decision, of_the_formed)
