"""How far x_hat, alpha, x_bar and b_hat are from the paper's equations, for all inputs: the limits of
the cross-check (bounds.py).

Two parts with the same names. The first says which numbers the C forms: each function that the limits depend
on equals a formula of calls, whatever the called functions compute. The second says of each rounding, by what
the functions' lemmas know of their results, how much it takes away.

Names: T and P are t and the rarer colour's count, shifted until T has 32 bits; L is c T, rounded down; G is
2^32 - 2 c. Powers of two that shifts multiply by are numbers of their own.
"""

from __future__ import annotations

from collections.abc import Iterator
from fractions import Fraction
from typing import Any

import z3

from proofs.arithmetic import are_leading_zeros, divide_24, divide_31, is_ratio, multiply_high
from proofs.formulas import C_MOST, ONE, Claim, call, formed
from proofs.source import Program

# --- Of the C --------------------------------------------------------------------------------------------


def half(word: Any) -> Any:
    return z3.LShR(word, 1)


# design: R18
def of_estimate(program: Program) -> Iterator[Claim]:
    """Eq. 3 and 4 as the second part writes them."""
    given, (found, _) = formed(program, "estimate")
    t, n, b_hat, c, g_shift = (given[name] for name in ("t", "n", "b_hat", "c", "g_shift"))
    white = t - n
    part = z3.If(z3.ULT(n, white), n, white)
    shift = call("leading_zeros", t)
    total, rarer = call("shift_left", t, shift), call("shift_left", part, shift)
    least = call("multiply_high", c, total)
    scale, above = call("shift_left", total - 2 * least, g_shift), call("shift_left", rarer - least, g_shift)
    at_end = z3.ULE(rarer, least)
    x = z3.If(at_end, z3.BitVecVal(0, 32), z3.LShR(call("divide_24", above, half(scale)), 2))
    mirrored = z3.ULT(n, white) == z3.ULT(b_hat, 2**31)
    known = [z3.ULE(n, t), z3.ULT(t, 2**31), z3.ULE(g_shift, 31)]
    nothing = z3.And(found["x_hat"] == ONE // 2, found["alpha"] == 0)
    yield "without information", nothing, [*known, at_end, c == 2**32 - 1]
    known = [*known, z3.Or(z3.Not(at_end), c != 2**32 - 1)]
    yield "x_hat", found["x_hat"] == z3.If(mirrored, ONE - x, x), known
    inside = _alpha_inside(given, shift, total, rarer, scale)
    yield "alpha", found["alpha"] == inside, [*known, z3.Not(at_end)]
    for name, side in (("one colour alone", part == 0), ("at an end", part != 0)):
        alpha = _alpha_at_an_end(given, t - part, part)
        yield f"alpha, {name}", found["alpha"] == alpha, [*known, at_end, side]


def _alpha_inside(given: dict[str, Any], shift: Any, total: Any, rarer: Any, scale: Any) -> Any:
    """(g t)^2 t over p (1 - p), whose upper bits are divided; the exponent takes the shifts out again."""
    square = call("multiply_high", call("multiply_high", scale, scale), total)
    spread = call("multiply", rarer, total - rarer)
    square_shift, spread_shift = (
        call("leading_zeros", square),
        call("leading_zeros", call("high_word", spread)),
    )
    dividend, divisor = call("shift_left", square, square_shift), call("upper", spread, spread_shift)
    ratio = call("divide_24", half(dividend), half(divisor))
    excess = z3.LShR(ratio, 24) & 1
    exponent = 32 - 2 * given["g_shift"] - shift + spread_shift - square_shift + excess
    return call("alpha_word_from_mantissa", z3.LShR(ratio, excess), exponent)


def _alpha_at_an_end(given: dict[str, Any], common: Any, rare: Any) -> Any:
    """The sum of both colours' terms, moved until it has 64 bits, of which the mantissa is the upper 24."""
    first, second = call("multiply", common, given["common"]), call("multiply", rare, given["rare"])
    some = rare != 0
    total = z3.If(some, second + call("shift_right_64", first, given["rare_shift"]), first)
    moved = z3.If(some, given["rare_shift"], z3.BitVecVal(0, 32))
    is_short = call("high_word", total) == 0
    long = z3.If(is_short, call("join", call("low_word", total), z3.BitVecVal(0, 32)), total)
    sum_shift = call("leading_zeros", call("high_word", long))
    exponent = 34 - 2 * given["g_shift"] + moved - z3.If(is_short, z3.BitVecVal(32, 32), 0) - sum_shift
    return call("alpha_word_from_mantissa", z3.LShR(call("upper", long, sum_shift), 8), exponent)


# design: R17
def of_set_b_hat(program: Program) -> Iterator[Claim]:
    """The squares are those of g / (1 - c) and of g / c."""
    given, (_, after) = formed(program, "set_b_hat")
    b_hat, held = z3.BitVec("b_hat_given", 32), after["accuracy"]
    c = z3.If(z3.ULT(b_hat, 2**31), b_hat, -b_hat)
    g = -2 * c
    g_shift, c_shift = call("leading_zeros", g), call("leading_zeros", c)
    shifted = call("shift_left", g, g_shift)
    says_nothing = z3.UGT(c, C_MOST)
    members = {
        **{"b_hat": b_hat, "c": z3.If(says_nothing, z3.BitVecVal(2**32 - 1, 32), c)},
        "common": call("square_of_ratio", shifted, -c),
        "rare": call("square_of_ratio", shifted, call("shift_left", c, c_shift)),
        **{"g_shift": g_shift, "rare_shift": 2 * c_shift},
    }
    for name, value in members.items():
        yield name, held[name] == value, [given["b_hat"] == b_hat, *_ranges_of_b_hat(b_hat)]


def _ranges_of_b_hat(b_hat: Any) -> list[Any]:
    return [z3.UGE(b_hat, 2**12), z3.ULE(b_hat, 2**32 - 2**12)]


def of_shifts() -> Iterator[Claim]:
    """What of_lengths takes for known of a b_hat that says something, and what square_of_ratio() is given for
    one that is not 1/2, by the lemma of leading_zeros()."""
    b_hat, g_shift, c_shift = z3.BitVecs("b_hat g_shift c_shift", 32)
    c = z3.If(z3.ULT(b_hat, 2**31), b_hat, -b_hat)
    g = -2 * c
    known = [*_ranges_of_b_hat(b_hat), b_hat != 2**31]
    known += [are_leading_zeros(g_shift, g), are_leading_zeros(c_shift, c)]
    yield "g_shift", z3.ULE(g_shift, 11) == z3.ULE(c, C_MOST), known
    yield "rare_shift", z3.And(z3.UGE(2 * c_shift, 2), z3.ULE(2 * c_shift, 38)), known
    long = [z3.UGE(each, 2**31) for each in (g << g_shift, -c, c << c_shift)]
    yield "32 bits", z3.And(long), known


def of_square_of_ratio(program: Program) -> Iterator[Claim]:
    """The square of a quotient of 24 or 25 bits, whose unit is 2^-24."""
    given, (found, _) = formed(program, "square_of_ratio")
    ratio = call("divide_24", half(given["g"]), half(given["p"])) << 7
    yield "square", found == call("multiply_high", ratio, ratio), []


# design: R25, R26
def of_reestimate(program: Program) -> Iterator[Claim]:
    """Which quotient is b_hat, and when there is none."""
    given, (found, _) = formed(program, "reestimate")
    t, n, mean = (given[name] for name in ("t", "n", "x_bar"))
    is_below = z3.ULT(mean, 2**31)
    a, black = z3.If(is_below, ~mean, mean), z3.If(is_below, t - n, n)
    says_something = z3.UGE(2 * a, 2**20)
    yield "whether x_bar says something", (found != 0) == says_something, []
    span, taken = call("multiply", t, 2 * a), call("multiply", t, -a)
    excess = call("join", black, z3.BitVecVal(0, 32)) - taken
    above = z3.If(excess > 0, excess, 0)
    quotient = call("quotient", z3.If(z3.ULT(above, span), above, span), span)
    least, most = z3.BitVecVal(2**12, 32), z3.BitVecVal(2**32 - 2**12, 32)
    kept = z3.If(z3.ULT(quotient, least), least, z3.If(z3.UGT(quotient, most), most, quotient))
    yield "N / D, in the range of b_hat", found == kept, [says_something]


# --- Of the numbers --------------------------------------------------------------------------------------

BELOW = (Fraction(1, 2**28), Fraction(1, 2**27), Fraction(1, 2**31))
"""Shares that (g t)^2, (g t)^2 t and the dividend of alpha lose at most, of themselves."""
DIVISOR_LOSES = Fraction(1, 2**30)


# design: R33
def of_x_hat() -> Iterator[Claim]:
    """x lies between the exact quotient N / D and what is (1 - 2 N / D) r 2^-31 nearer to 1/2."""
    p, total, least, c = z3.Ints("P T L c")
    is_exact = (p > least) == (2**32 * p > c * total)
    yield "p > c is decided exactly", is_exact, [multiply_high(least, c, total)]
    t, power, half = z3.Ints("t power half")
    is_even = z3.Or(total == 2**31, z3.And(total == t * power, power == 2 * half))
    yield "g t is even", total % 2 == 0, [is_even]
    yield "the rarer colour is at most half", 2 * p * power <= t * power, [2 * p <= t, power >= 1]
    x, above, scale = z3.Ints("X above scale")
    floor = (divide_24(x, above, scale), above >= 0, scale > 0)
    exact = z3.And(x / 4 * scale <= 2**22 * above, 2**22 * above < (x / 4 + 1) * scale)
    yield "x is a floor to 2^-23", exact, [*floor, x == 4 * (x / 4) + x % 4]
    n, d, e, of_t, g = z3.Reals("N D e T g")
    possible = [n >= 0, 2 * n <= d, d > 0, e >= 0, e < 1, d == g * of_t, of_t >= 2**31, g > 0]
    yield "x is not too near to the end", n * (d + 2 * e) <= d * (n + e), possible
    difference = (n * d + d - 2 * n) * (d + 2 * e) - (n + e) * d * d
    yield "and D not too small:", difference == (d - 2 * n) * ((1 - e) * d + 2 * e), []
    yield "a product of two that are not negative", z3.And(d - 2 * n >= 0, (1 - e) * d + 2 * e >= 0), possible
    yield "1 / D is at most r 2^-31", 2**31 * g <= d, possible


# design: R33
def of_alpha() -> Iterator[Claim]:
    """Each number on the way to alpha, in parts of what it would be without the last rounding."""
    scale, exact, e, g, total = z3.Reals("scale exact e g T")
    known = [exact == g * total, total >= 2**31, g > 0, e >= 0, e < 1, scale == exact + 2 * e]
    yield "g t is not too small", scale >= exact, known
    yield "and at most r 2^-30 too large", g * 2**30 * scale <= exact * (g * 2**30 + 1), known
    square, root, of_t = z3.Reals("square root T")
    yield from _loses("(g t)^2", BELOW[0], scale * scale, root, [scale >= 2**30])
    known = [root >= 2**28, of_t >= 2**31]
    yield from _loses("(g t)^2 t", BELOW[1], root * of_t, square, known)
    dividend, half = z3.Ints("dividend half")
    known = [dividend >= 2**31, half == dividend / 2]
    yield "dividend", half * 2**32 >= dividend * (2**31 - 1), known
    spread, power, upper, kept = z3.Ints("spread power upper kept")
    known = [spread * power >= 2**63, 2**32 * upper <= spread * power, kept == upper / 2]
    known += [spread * power < 2**32 * (upper + 1)]
    yield "divisor is not too large", kept * 2**33 <= spread * power, known
    yield "and not too small", kept * 2**33 * 2**30 >= spread * power * (2**30 - 1), known
    yield from _of_powers()


def _loses(name: str, share: Fraction, exact: Any, floor: Any, known: list[Any]) -> Iterator[Claim]:
    """The upper word of a product, and the share of itself that it loses at most."""
    is_floor = [multiply_high(floor, exact, 1)]
    claim = 2**32 * floor * share.denominator >= exact * (share.denominator - share.numerator)
    yield name, claim, [*known, *is_floor]


SQUARE_LOSES = (Fraction(1, 2**23), Fraction(1, 2**23), Fraction(1, 2**28))
"""Shares that a square of a quotient loses at most, of itself: the quotient, twice, and the square."""
SUM_LOSES = Fraction(1, 2**28)
SQUARE_GAINS = Fraction(1, 2**30)


# design: R33
def of_squares() -> Iterator[Claim]:
    """(g / p)^2 of an even g, and a p that is even or above 2^31 + 2^19."""
    g, p, half, r = z3.Ints("g p half r")
    ranges = [g >= 2**31, g < 2**32, p >= 2**31, p < 2**32, half == p / 2]
    floor = [r * half <= 2**23 * g, 2**23 * g < (r + 1) * half, r >= 2**23]
    yield "the quotient is not too small", r * p * 2**23 >= 2**24 * g * (2**23 - 1), [*ranges, *floor]
    yield "and not too large", r * (p - 1) <= 2**24 * g, [*ranges, *floor]
    yield "exactly so for an even p", r * p <= 2**24 * g, [*ranges, *floor, p % 2 == 0]
    wide = z3.Real("p")
    gained = wide * wide * 2**30 <= (wide - 1) * (wide - 1) * (2**30 + 1)
    yield "an odd p makes the square little larger", gained, [wide >= 2**31 + 2**19]
    yield "1 - c is so large", 2**32 - z3.Int("c") >= 2**31 + 2**19, [z3.Int("c") <= C_MOST]
    ratio, square = z3.Reals("ratio square")
    yield from _loses("square", SQUARE_LOSES[2], ratio * ratio, square, [ratio >= 2**30])


# design: R33
def of_alpha_at_an_end() -> Iterator[Claim]:
    """The sum of two positive terms, of which the second is rounded down."""
    first, second, moved = z3.Reals("first second moved")
    known = [first >= 2**28, second >= 0, moved <= second, second < moved + 1]
    yield "the sum", (first + moved) * 2**28 >= (first + second) * (2**28 - 1), known
    total, power, upper, mantissa = z3.Ints("sum power upper mantissa")
    known = [total * power >= 2**63, total * power < 2**64, mantissa == upper / 2**8]
    known += [2**32 * upper <= total * power, total * power < 2**32 * (upper + 1)]
    floor = z3.And(mantissa * 2**40 <= total * power, total * power < (mantissa + 1) * 2**40)
    yield "upper 24 bits", z3.And(floor, mantissa >= 2**23, mantissa < 2**24), known
    g, c, t, part, by_g, by_c, by_sum = names = z3.Reals("g c t part g_ c_ sum_")
    common, rare = (2**30 * (g * by_g / each) ** 2 for each in (1 - c, c * by_c))
    total = part * rare + (t - part) * common / by_c**2
    exact = part * (g / c) ** 2 + (t - part) * (g / (1 - c)) ** 2
    formed = total * by_sum / 2**40 * 2**34 / by_g**2 * by_c**2 / by_sum
    yield "powers of two", formed == 2**24 * exact, [*(each > 0 for each in names), c < 1]


def _of_powers() -> Iterator[Claim]:
    """The powers of two that shifts multiplied by are those that the exponent takes out again: with nothing
    rounded, the quotient times 2^exponent is alpha = g^2 t / (p (1 - p)) in units of 2^-24."""
    g, total, spread, by_g, by_t, by_square, by_spread = names = z3.Reals("G T spread g_ t_ square_ spread_")
    square = (g * total / 2**32 * by_g) ** 2 / 2**32 * total / 2**32
    quotient = 2**24 * (square * by_square / 2) / (spread * by_spread / 2**33)
    power = 2**32 * by_spread / (by_g**2 * by_t * by_square)
    alpha = 2**24 * (g / 2**32) ** 2 * (total / by_t) / (spread / total**2)
    yield "powers of two", quotient * power == alpha, [each > 0 for each in names]


def of_quotient() -> Iterator[Claim]:
    """x = a / d is never made too large, and by less than 4 x + 3 units of 2^-32 too small; also where a has
    been rounded down, which it is only if d has more bits than a word."""
    whole, upper, rest = z3.Ints("a upper rest")
    known = [rest >= 1, rest * upper <= whole, whole < rest * (upper + 1)]
    yield "the upper bits are those of a + 1, rounded down", whole + 1 <= rest * (upper + 1), known
    x, d, e, above, q = z3.Reals("x D E above q")
    lengths, parts = [d >= 2**31, e >= d, e <= d + 2], [above <= x * d, above >= x * d - 1]
    floor = [q * e <= 2**32 * above, 2**32 * above < (q + 1) * e]
    lemma = is_ratio(above, e / 2, 2**32 * (x * d), 2**32 * d)
    yield "what ratio() gives", z3.And(*lengths, *parts), [lemma]
    yield "what divide_31() gives", z3.And(floor), [divide_31(q, above, e / 2)]
    known = [x >= 0, x <= 1, above >= 0, *lengths, *parts]
    yield "the ratio is not too large", above <= x * e, known
    lost = x * e - above
    yield "and loses 2 x + 1", lost <= 2 * x + 1, known
    share = [*(x >= 0, x <= 1, e >= 2**31), lost >= 0, lost <= 2 * x + 1]
    yield "the quotient is not too large", q <= 2**32 * x, [*share, *floor]
    yield "and less than 4 x + 3 too small", 2**32 * x < q + 4 * x + 3, [*share, *floor]


# design: R33
def of_b_hat() -> Iterator[Claim]:
    """b_hat of eq. 8 is as far off as the cross-check allows, and by 2^-26 where |2 x_bar - 1| >= 0.1.

    With u = |2 x_bar - 1|, exact and as formed, eq. 8 is 1/2 + y / u, and y = n / t - 1/2 or its negative.
    """
    n, t, a = z3.Ints("n t A")
    dividend = 2**32 * n - t * (2**32 - a)
    possible = [n >= 0, n <= t, t >= 1, t <= 2**31, a >= 2**31, a < 2**32]
    yield "N fits", z3.And(dividend >= -(2**63), dividend < 2**63), possible
    p, x, of_t = z3.Reals("p x t")
    form = 2**32 * p * of_t - of_t * (2**32 - 2**32 * x)
    yield "N / D is eq. 8", form * (2 * x - 1) == of_t * (2**33 * x - 2**32) * (p + x - 1), []
    mirrored = ((1 - p) + (1 - x) - 1) * (2 * x - 1) == (p + x - 1) * (2 * (1 - x) - 1)
    yield "with both colours exchanged too", mirrored, []
    yield from _of_x_bar()
    yield from _of_eq_8()


def _of_x_bar() -> Iterator[Claim]:
    """u and v, exact and as formed, in units of 2^-32."""
    x, a = z3.Reals("x A")
    formed = [x >= 0, x <= 1, a <= 2**32 * x, 2**32 * x < a + 4 * x + 3]
    off = 2**32 * (2 * x - 1) - (2 * a - 2**32)
    yield "above 1/2", z3.And(off >= 0, off <= 8 * x + 6), formed
    off = 2**32 * (1 - 2 * x) - (2 * (2**32 - 1 - a) - 2**32)
    yield "below 1/2", z3.And(off <= 2, -off <= 8 * x + 4), formed
    yield "on the right side", (a >= 2**31) == (10 * x >= 5), [*formed, z3.Or(10 * x >= 6, 20 * x <= 9)]
    u = z3.If(10 * x >= 5, 2 * x - 1, 1 - 2 * x)
    error = z3.If(10 * x >= 5, 4 * x + 3, z3.If(4 * x + 2 > 1, 4 * x + 2, 1))
    yield "2^-26", error + 7 * u <= 64 * u, [*formed, 10 * u >= 1]


def _of_eq_8() -> Iterator[Claim]:
    """How eq. 8 moves with u, and what its own quotient and range add."""
    y, u, v, of_u, of_v = z3.Reals("y u v of_u of_v")
    known = [2 * y >= -1, 2 * y <= 1, u > 0, v > 0, of_u * u == y, of_v * v == y]
    moved = 2 * (_kept(of_u, -1, 1, 2) - _kept(of_v, -1, 1, 2))
    for name, difference in (("u is larger", u - v), ("v is larger", v - u)):
        larger = u if difference.eq(u - v) else v
        claim = z3.And(moved * larger <= difference, -moved * larger <= difference)
        yield f"eq. 8 moves by half the share where {name}", claim, [*known, difference >= 0]
    exact, formed, error = z3.Reals("exact formed error")
    off = exact - formed
    in_range = _kept(exact, 2**12, 2**32 - 2**12) - _kept(formed, 2**12, 2**32 - 2**12)
    near = [off <= error, -off <= error]
    yield "the range takes nothing away", z3.And(in_range <= error, -in_range <= error), near


def _kept(value: Any, least: int, most: int, parts: int = 1) -> Any:
    """The value, kept within two numbers that are given in ``parts`` of 1."""
    low, high = z3.RealVal(least) / parts, z3.RealVal(most) / parts
    return z3.If(value < low, low, z3.If(value > high, high, value))


def of_lengths() -> Iterator[Claim]:
    """Duties of estimate() to what it calls: numbers that are divided lie in [2^30, 2^31), so that
    the quotient has 24 or 25 bits; alpha_word() gets 24 bits and an exponent of at least -31.
    """
    p, total, least, c, g, root, square = z3.Ints("P T L c G root square")
    common = [*(c >= 2**12, c <= C_MOST, g == 2**32 - 2 * c, total >= 2**31, total < 2**32)]
    common.append(multiply_high(least, c, total))
    for shift in range(12):
        scale, power = (total - 2 * least) * 2**shift, g * 2**shift
        known = [*common, power >= 2**31, power < 2**32]
        yield f"g t, g shifted by {shift}", z3.And(scale >= 2**30, scale < 2**32, 2 * least <= total), known
    scale, above, power = z3.Ints("scale above power")
    known = [power >= 1, scale == (total - 2 * least) * power, above == (p - least) * power, 2 * p <= total]
    yield "above is at most half", 2 * above <= scale, known
    known = [2 * above <= scale, scale >= 2**30]
    yield "and below twice half the scale", above < 2 * (scale / 2), known
    known = [2**32 * least <= (2**32 - 1) * total, (2**32 - 1) * total < 2**32 * (least + 1)]
    yield "nothing is above c t without information", p <= least, [*known, 2 * p <= total, total >= 2**31]
    yield "a colour that is not at an end is not rare", p >= 2**11, [*common, p > least]
    yield "spread", p * (total - p) >= 2**41, [p >= 2**11, 2 * p <= total, total >= 2**31]
    floors = [multiply_high(root, scale, scale), scale >= 2**30]
    yield "(g t)^2", root >= 2**28, floors
    floors = [multiply_high(square, root, total), root >= 2**28]
    yield "(g t)^2 t", square >= 2**27, [*floors, total >= 2**31]
    a, d, found = z3.Ints("a d found")
    similar = [*(a >= 2**30, a < 2**31, d >= 2**30, d < 2**31), divide_24(found, a, d)]
    yield "a quotient of equally long numbers", z3.And(found >= 2**23, found < 2**25), similar
    yield "the square of one", 2**14 * found * found >= 2**60, [found >= 2**23]
    yield from _of_exponents()


def _of_exponents() -> Iterator[Claim]:
    """A product of at least 2^k has at most 63 - k leading zeros."""
    names = z3.Ints("g_shift shift spread_shift square_shift excess moved sum_shift short")
    g_shift, shift, spread_shift, square_shift, excess, moved, sum_shift, short = names
    counts = [z3.And(each >= 0, each <= 31) for each in names]
    exponent = 32 - 2 * g_shift - shift + spread_shift - square_shift + excess
    known = [*counts, g_shift <= 11, square_shift <= 31 - 27, excess <= 1]
    yield "exponent", z3.And(exponent >= -31, exponent < 2**31), known
    exponent = 34 - 2 * g_shift + moved - 32 * short - sum_shift
    known = [*counts[:-3], moved >= 0, moved <= 38, g_shift <= 11, counts[-2], short >= 0, short <= 1]
    known.append(z3.Implies(short == 1, sum_shift <= 31 - 28))
    yield "exponent at an end", z3.And(exponent >= -31, exponent < 2**31), known
    t, part, common, rare, first, moved_first = z3.Ints("t part common rare first moved_first")
    known = [*(t >= 1, t <= 2**31, part >= 0, 2 * part <= t), first == (t - part) * common]
    known += [*(common >= 2**28, common < 2**32, rare >= 2**28, rare < 2**32)]
    yield "the commoner colour's term", z3.And(first >= 2**28, first < 2**63), known
    known += [*(part >= 1, moved_first >= 0, moved_first < 2**63)]
    total = part * rare + moved_first
    yield "both terms", z3.And(total >= 2**28, total < 2**64), known


OF_THE_CODE = (of_estimate, of_reestimate, of_set_b_hat, of_square_of_ratio)
OF_THE_NUMBERS = (
    of_lengths,
    of_shifts,
    of_x_hat,
    of_alpha,
    of_squares,
    of_alpha_at_an_end,
    of_quotient,
    of_b_hat,
)
