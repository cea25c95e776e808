"""The robust filter (docs/design.md, section 13): a vote, the test and what becomes of b_hat, in every state
that is possible, are what that section says; its ranges hold, and its test is that of exact rational
arithmetic, except within ``MARGIN`` of the border.
"""

from __future__ import annotations

from collections.abc import Iterator
from fractions import Fraction
from functools import partial
from typing import Any, cast

import z3

from mcp_asdf_tools.crosscheck import bounds
from proofs.arithmetic import SHIFTED, WORDS, are_leading_zeros, multiply_high
from proofs.formulas import ONE, Claim, call, formed, same
from proofs.machine import Machine
from proofs.numbers import Number
from proofs.prove import Contract, UnprovenError, prove
from proofs.source import Program

MARGIN = bounds.UNDECIDED
"""By how much one side of the test's inequality must exceed the other, as a share of its right side."""
B_HAT = (2**12, 2**32 - 2**12)

# --- A vote ----------------------------------------------------------------------------------------------


def _zeros(machine: Machine, votes: Number) -> Number:
    """leading_zeros() by its lemma; its argument is the new number of votes, at least 32."""
    machine.claim(votes.term == _votes(machine.given["robot"]["crowd"]) | 32, "votes")
    return cast("Number", WORDS["leading_zeros"].stands_in("leading_zeros")(machine, votes))


def _votes(crowd: dict[str, Any]) -> Any:
    return _least(_wide(crowd["votes"]) + 1, z3.BitVecVal(2**14, 32))


def _shift(votes: Any) -> Any:
    """max(bits(votes) - 3, 3), of fewer than 2^15 votes."""
    found = z3.BitVecVal(3, 32)
    for bits in range(7, 16):
        found = z3.If(z3.UGE(votes, 2 ** (bits - 1)), z3.BitVecVal(bits - 3, 32), found)
    return found


def _shifted(machine: Machine, value: Number, count: Number) -> Number:
    """shift_right() by its lemma, and by the section's shift or one more: written as there, so that what
    follows is alike."""
    shift = _shift(_votes(machine.given["robot"]["crowd"]))
    try:
        prove(count.term == shift, *machine.facts)
    except UnprovenError:
        prove(count.term == shift + 1, *machine.facts, about="shift")
        shift += 1
    machine.claim(z3.ULE(shift, 13), "a shift by at most 13")
    return Number(SHIFTED["shift_right"](value.term, shift), value.type)


def in_range(crowd: dict[str, Any]) -> Any:
    spread, votes = crowd["spread"], crowd["votes"]
    return z3.And(
        *(z3.ULE(crowd["centre"], 2**30), z3.UGE(spread, 2**18), z3.ULE(spread, 2**28)),
        *(z3.ULE(votes, 2**14), z3.UGE(crowd["first"], B_HAT[0]), z3.ULE(crowd["first"], B_HAT[1])),
    )


def _may_vote(robot: dict[str, Any], _: Any, x_hat: Any) -> Any:
    return z3.And(in_range(robot["crowd"]), z3.ULE(x_hat, ONE))


def _least(a: Any, b: Any) -> Any:
    return z3.If(z3.ULT(a, b), a, b)


def _wide(half_word: Any) -> Any:
    return z3.ZeroExt(16, half_word)


def _voted(after: dict[str, Any], robot: dict[str, Any], sender: Any, x_hat: Any) -> tuple[Any, ...]:
    """The section's formulas, each by itself."""
    crowd, found = robot["crowd"], after["crowd"]
    r, s, trend, said = crowd["centre"], crowd["spread"], _wide(crowd["trend"]), x_hat * 2**7
    votes, shift = _votes(crowd), _shift(_votes(crowd))
    is_above = z3.UGT(said, r)
    distance = z3.If(is_above, said - r, r - said)
    step, change = z3.LShR(_least(distance, s), shift), z3.LShR(s, shift + 1)
    way = z3.If(step == 0, z3.BitVecVal(128, 32), z3.If(is_above, z3.BitVecVal(255, 32), z3.BitVecVal(0, 32)))
    wider = z3.If(z3.UGT(distance, s), s + change, s - change)
    kept = z3.If(z3.ULT(wider, 2**18), 2**18, _least(wider, z3.BitVecVal(2**28, 32)))
    voices = crowd["voices"] | z3.BitVecVal(1, 32) << z3.ZeroExt(24, sender & 31)
    others = {name: each for name, each in robot.items() if name != "crowd"}
    return (
        _wide(found["votes"]) == votes,
        _wide(found["trend"]) == trend - z3.LShR(trend, 8) + way,
        z3.Implies(is_above, found["centre"] == r + step),
        z3.Implies(z3.Not(is_above), found["centre"] == r - step),
        found["spread"] == kept,
        z3.And(found["voices"] == voices, found["first"] == crowd["first"], same(after, others)),
    )


def _stays_in_range(after: dict[str, Any], robot: dict[str, Any], _: Any, x_hat: Any) -> Any:
    """And the centre is between where it was and what was said."""
    r, found, said = robot["crowd"]["centre"], after["crowd"]["centre"], x_hat * 2**7
    low, high = z3.If(z3.ULT(r, said), r, said), z3.If(z3.ULT(r, said), said, r)
    return z3.And(in_range(after["crowd"]), z3.ULE(low, found), z3.ULE(found, high))


# design: R35
VOTE = Contract(
    _stays_in_range,
    requires=_may_vote,
    steps=tuple(partial(lambda part, *of: _voted(*of)[part], part) for part in range(6)),
    instead={"leading_zeros": _zeros, "shift_right": _shifted},
)

# --- The test ----------------------------------------------------------------------------------------------


# design: R38
def of_robust_test(program: Program) -> Iterator[Claim]:
    """The section's test in words, of products and a quotient that may be any."""
    given, (found, _) = formed(program, "robust_test_rejects")
    crowd, t, product = given["crowd"], given["t"], partial(call, "multiply")
    first, centre, upper = crowd["first"], crowd["centre"], partial(call, "multiply_high")
    r = z3.If(z3.LShR(centre, 30) == 0, centre << 2, z3.BitVecVal(2**32 - 1, 32))
    long = partial(z3.ZeroExt, 32)
    yield "R", long(r) == _least(4 * long(centre), z3.BitVecVal(2**32 - 1, 64)), [in_range(crowd)]
    p = upper(first, r) + upper(~first, ~r)
    seen = call("quotient", long(given["n"]), long(t))
    v_p, v_seen = upper(p, -p), upper(seen, -seen)
    g = z3.If(z3.LShR(first, 31) == 0, -2 * first, 2 * first)
    is_positive = z3.And(2 * long(first) - 2**32 == long(g), z3.UGE(first, 2**31))
    yield "g", z3.Or(is_positive, 2**32 - 2 * long(first) == long(g)), [in_range(crowd)]
    g_spread = upper(g, crowd["spread"] << 2)
    distance = z3.If(z3.UGT(seen, p), seen - p, p - seen)
    square, least = product(distance, distance), 12 * product(g_spread, g_spread)
    high, low = call("high_word", square - least), call("low_word", square - least)
    above = product(t, high) + long(call("high_word", product(t, low)))
    most = product(z3.BitVecVal(12, 32), z3.If(z3.UGT(v_seen, v_p), v_seen, v_p))
    rejects = z3.And(z3.UGT(square, least), z3.UGT(above, most))
    yield "the test", (found == 1) == rejects, []


# --- The filter ---------------------------------------------------------------------------------------------


def _of_round(robot: dict[str, Any]) -> tuple[Any, Any]:
    """What b_hat becomes by the paper's filters, 0 if it stays; and whether a test is counted."""
    closed, count, mode = robot["closed"], robot["open"]["count"], robot["config"]["filter"]
    mean = call("round_mean", *(closed[name] for name in ("alpha", "alpha_x_low", "alpha_x_high")))
    is_tested = z3.And(mode == 0, z3.UGE(count, 2))
    runs = z3.Or(z3.And(is_tested, call("asdf_test_rejects") != 0), z3.And(mode == 1, z3.UGE(count, 1)))
    return z3.If(runs, call("reestimate", mean), 0), is_tested


def _of_crowd(robot: dict[str, Any]) -> tuple[Any, Any, Any]:
    """The same by the robust one; and what becomes of the votes."""
    crowd, trend = robot["crowd"], _wide(robot["crowd"]["trend"])
    is_moving = z3.Or(z3.ULT(trend, 2**13), z3.UGE(trend, 7 * 2**13))
    voices = sum(z3.LShR(crowd["voices"], bit) & 1 for bit in range(32))
    is_tested = z3.And(z3.Not(is_moving), z3.UGE(voices, 3))
    first = crowd["first"]
    kept = z3.If(robot["accuracy"]["b_hat"] == first, z3.BitVecVal(0, 32), first)
    b_hat = z3.If(is_tested, z3.If(call("robust_test_rejects") != 0, _anew(crowd), kept), z3.BitVecVal(0, 32))
    halved = z3.And(is_moving, z3.UGE(crowd["votes"], 2**9))
    return b_hat, is_tested, z3.If(halved, z3.LShR(crowd["votes"], 1), crowd["votes"])


def _anew(crowd: dict[str, Any]) -> Any:
    whole = crowd["centre"] == 2**30
    return call("reestimate", z3.If(whole, z3.BitVecVal(2**32 - 1, 32), 4 * crowd["centre"]))


# design: R10, R13, R23, R29, R37
def of_filter(program: Program) -> Iterator[Claim]:
    """If there was an observation, what the robot's own filter finds becomes b_hat, unless it is 0; nothing
    else changes but what counts it."""
    given, (found, after) = formed(program, "update_b_hat")
    counters, crowd, accuracy = (given[name] for name in ("counters", "crowd", "accuracy"))
    some, is_robust = given["t"] != 0, given["config"]["filter"] == 3
    (of_round, is_round_tested), (of_crowd, is_crowd_tested, votes) = _of_round(given), _of_crowd(given)
    b_hat, is_tested = (
        z3.If(is_robust, of_crowd, of_round),
        z3.If(is_robust, is_crowd_tested, is_round_tested),
    )
    updates, tests = z3.And(some, b_hat != 0), z3.And(some, is_tested)
    one, none = (z3.BitVecVal(value, 16) for value in (1, 0))
    changed = {
        "accuracy": {**accuracy, "b_hat": z3.If(updates, b_hat, accuracy["b_hat"])},
        "counters": {
            **counters,
            "tests": counters["tests"] + z3.If(tests, one, none),
            "updates": counters["updates"] + z3.If(updates, one, none),
        },
        "crowd": {**crowd, "votes": z3.If(z3.And(some, is_robust), votes, crowd["votes"])},
        "updated": z3.If(updates, z3.BitVecVal(1, 8), given["updated"]),
    }
    in_order = z3.And(in_range(crowd), _is_b_hat(_anew(crowd)))  # as of_reestimate() has it
    known = [z3.ULE(given["config"]["filter"], 3), z3.Implies(is_robust, in_order)]
    yield "updated", found == z3.If(updates, z3.BitVecVal(2, found.size()), 0), known
    yield "the robot", same(after, {**given, **changed}), known
    yield "in range", _is_b_hat(of_crowd), [in_order]


def _is_b_hat(found: Any) -> Any:
    return z3.Or(found == 0, z3.And(z3.UGE(found, B_HAT[0]), z3.ULE(found, B_HAT[1])))


# --- Of the numbers: the test's integers, and how far they are from what they stand for -----------------

UNIT = Fraction(1, 2**32)


def of_integers() -> Iterator[Claim]:
    """No sum or product of the test wraps, so that its words are the section's integers."""
    first, r, product, other = z3.Ints("first R product other")
    one, most = 2**32, 2**32 - 1
    known = [first >= B_HAT[0], first <= B_HAT[1], r >= 0, r <= most]
    known += [_floor(product, first * r), _floor(other, (most - first) * (most - r))]
    p = product + other
    yield "p", z3.And(p > 0, p < most), known
    g, spread, g_spread = z3.Ints("g s g_spread")
    known = [g >= 0, g <= most, spread >= 0, spread <= 2**28, _floor(g_spread, g * (4 * spread))]
    yield "g s", z3.And(g_spread >= 0, g_spread < 2**30), known
    yield "least", 12 * (g_spread * g_spread) < 2**64, [g_spread >= 0, g_spread < 2**30]
    seen, v = z3.Ints("seen v")
    known = [seen >= 1, seen <= most, _floor(v, seen * (one - seen))]
    yield "v", z3.And(v >= 0, v <= 2**30), known
    t, excess, high, low, above = z3.Ints("t excess high low above")
    known = [t >= 0, t < one, excess >= 0, excess < 2**64, excess == one * high + low, low >= 0, low < one]
    known += [_floor(above, t * low), high >= 0]
    total = t * high + above
    yield "t excess", z3.And(_floor(total, t * excess), total >= 0, total < 2**64), known


def _floor(found: Any, product: Any) -> Any:
    return multiply_high(found, product, 1)


def of_errors() -> Iterator[Claim]:
    """p, n / t, v and g s, in units of 2^-32, are too small by what the section says."""
    first, r, product, other = z3.Reals("first R product other")
    one, most = 2**32, 2**32 - 1
    known = [first >= B_HAT[0], first <= B_HAT[1], r >= 0, r <= most]
    known += [_floor(product, first * r), _floor(other, (most - first) * (most - r))]
    lost = first * r + (one - first) * (one - r) - one * (product + other)
    yield "p", z3.And(lost >= 0, lost < 4 * one), known
    known = [first >= B_HAT[0], first <= B_HAT[1], _floor(product, first * most)]
    yield "p where r is 1", z3.And(first - product >= 0, first - product < 4), known
    x, total, half, seen = z3.Reals("x T half seen")
    known = [x >= 0, x <= 1, total >= 2**31, 2 * half > total, 2 * half <= total + 2]
    known += [seen * half <= 2**31 * x * total, 2**31 * x * total < (seen + 1) * half]
    yield "n / t", z3.And(seen <= one * x, one * x < seen + 4 * x + 1), known
    g, h, p = z3.Reals("g h p")
    known = [h >= -1, h <= 1, 2 * p - 1 == g * h]
    yield "v is at least b_hat (1 - b_hat)", 4 * p * (1 - p) >= 1 - g * g, known
    error, v = z3.Reals("error v")
    exact, u = p * (1 - p), UNIT
    known = [p >= 0, p <= 1, error >= 0, p - error >= 0, v <= (p - error) * (1 - p + error)]
    known += [v > (p - error) * (1 - p + error) - _real(u)]
    for name, most_lost in (("v of p", _real(4 * u)), ("v of n / t", _real(u) * (4 * p + 1))):
        near = z3.And(v <= exact + _real(5 * u), v >= exact - _real(6 * u))
        yield name, near, [*known, error <= most_lost]


def _real(value: Fraction) -> Any:
    return z3.Q(value.numerator, value.denominator)


# design: R38
def of_the_decision() -> Iterator[Claim]:
    """Rejected is D^2 > L = 12 (v w + h^2), h being g s and w 1 / t: right, with errors as above,
    wherever the sides differ by MARGIN of the larger. Where g^2 <= 1/2, v is not small, else h is not; where
    observations are few, D is not small either."""
    p, x, d, v, g, h, w = z3.Reals("p x D v g h w")
    u, m, limit = _real(UNIT), _real(MARGIN), 12 * (v * w + h * h)
    known = [p >= 0, x <= 1, d == x - p, d >= 0, 3 * d <= 1, v >= p * (1 - p), v >= x * (1 - x)]
    yield "v", 3 * v >= 2 * d, known
    ranges = [v > 0, 4 * v <= 1, w > 0, w <= 1, h >= 0, d >= 0, d <= 1, w * 2**31 >= 1, v * 2**21 >= 1]
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
        lost = 10 * u * d + 25 * u * u + 71 * u * w + 24 * u * h
        yield f"below, {name}", d * d + lost < limit, below


def of_the_formed() -> Iterator[Claim]:
    """What the claims of the decision show is what the test needs: d, V and G are formed of D, v and h."""
    zeros, value = z3.BitVecs("zeros value", 32)
    known = [are_leading_zeros(zeros, value), z3.UGE(value, 32)]
    yield "what any_calls.c admits", z3.ULE(zeros, 26), known
    p, x, formed_p, formed_x = z3.Reals("p x formed_p formed_x")
    u = _real(UNIT)
    known = [x <= 1, p >= formed_p, p < formed_p + 4 * u, x >= formed_x, x < formed_x + (4 * x + 1) * u]
    off = z3.If(x > p, x - p, p - x) - z3.If(formed_x > formed_p, formed_x - formed_p, formed_p - formed_x)
    yield "D", z3.And(off <= 5 * u, -off <= 5 * u), known
    product, above, v = z3.Ints("product above v")
    is_more = (above > 12 * v) == (product >= 2**32 * (12 * v + 1))
    yield "rejected", is_more, [_floor(above, product)]
    d, formed_d, formed_v, v, h, formed_h, w = z3.Reals("D d V v h G w")
    limit, formed = 12 * (v * w + h * h), 12 * (formed_v * w + formed_h * formed_h) + u * w
    known = [w > 0, w <= 1, h >= 0, formed_h >= 0, formed_h <= h, d >= 5 * u, formed_d >= d - 5 * u]
    known += [formed_v <= v + 5 * u, d * d - (10 * u * d + 61 * u * w) >= limit]
    yield "above", formed_d * formed_d >= formed, known
    known = [w > 0, w <= 1, h >= 0, formed_h >= 0, h < formed_h + u, d >= 0, formed_d >= 0]
    known += [formed_d <= d + 5 * u, formed_v >= v - 6 * u]
    lost = 10 * u * d + 25 * u * u + 71 * u * w + 24 * u * h
    yield "below", formed_d * formed_d < formed, [*known, d * d + lost < limit]


CONTRACTS = {"update_crowd": VOTE}
OF_THE_CODE = (of_robust_test, of_filter)
OF_THE_NUMBERS = (of_integers, of_errors, of_the_decision, of_the_formed)
