"""How far x_hat, alpha, x_bar and b_hat are from the paper's equations, for all inputs: the limits of
tests/exact.py.

Two parts with the same names. Of the C: a run of estimate() in whole numbers, or of reestimate() in words, in
which each call of the arithmetic is a number; the proof says which numbers it is called with. Of the numbers:
what the functions' lemmas say of each result, and for each rounding an inequality. Both are settled by the
solver.

Names: T and P are t and the rarer colour's count, shifted until T has 32 bits; L is c T, rounded down; G is
2^32 - 2 c. Powers of two that shifts multiply by are numbers of their own.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator
from fractions import Fraction
from typing import Any

import z3

from proofs.core import C_MOST, ONE
from proofs.machine import Machine, Place, Summary
from proofs.numbers import Arithmetic, Integers, Number, Type, Words
from proofs.prove import terms
from proofs.source import Program

WORD, LONG = Type(32), Type(64)
LONG_RESULTS = {"multiply", "shift_right_64", "join"}
CALLED = (
    *("leading_zeros", "shift_left", "shift_right_64", "upper", "high_word", "low_word", "join"),
    *("multiply", "multiply_high", "divide_24", "alpha_word", "square_of_ratio"),
    *("mean", "quotient", "set_b_hat"),
)
Claim = tuple[str, Any, list[Any]]
"""Name of a claim, its formula, and of what it follows."""

# --- Of the C --------------------------------------------------------------------------------------------


class Sizes(Integers):
    """Whole numbers, with as much of ``^`` and of shifts by a bit as estimate() needs."""

    def binary(self, operator: str, left: Number, right: Number) -> Number:
        if operator == "^":
            differ = left.term / 2**31 != right.term / 2**31
            return Number(z3.If(differ, 2**31, 0) + z3.FreshInt("low") % 2**31, left.type)
        if operator == ">>" and not z3.is_int_value(z3.simplify(right.term)):
            shifted = z3.If(right.term == 1, left.term / 2, z3.FreshInt("shifted"))
            return Number(z3.If(right.term == 0, left.term, shifted), left.type)
        return super().binary(operator, left, right)


class Run:
    """A function on unknown arguments.

    Attributes:
        given: Terms of its arguments by name; the members of a structure that one points to by theirs.
        results: Results of the calls by function, in their order.
        arguments: Those of the same calls, pointers left out.
        found: Terms of what it returns, or else of what its first argument then points to.
        facts: What is known of all these.
    """

    def __init__(self, program: Program, name: str, arithmetic: Callable[..., Arithmetic] = Sizes) -> None:
        self.results: dict[str, list[Any]] = defaultdict(list)
        self.arguments: dict[str, list[tuple[Any, ...]]] = defaultdict(list)
        called = {each: self._stands_in(each) for each in CALLED if each != name}
        machine = Machine(program, arithmetic, called)
        parameters = program.parameters(name)
        values = [machine.unknown_of(each.type, each.name) for each in parameters]
        self.given: dict[str, Any] = {}
        for parameter, value in zip(parameters, values, strict=True):
            seen = terms(machine.load(value) if isinstance(value, Place) else value)
            self.given |= seen if isinstance(seen, dict) else {parameter.name: seen}
        found = machine.call(name, *values)
        result = found if found is not None else values[0]
        self.found = terms(machine.load(result) if isinstance(result, Place) else result)
        self.facts = machine.facts

    def _stands_in(self, name: str) -> Summary:
        def summary(machine: Machine, *arguments: Number | Place) -> Number:
            found = machine.unknown(name, LONG if name in LONG_RESULTS else WORD)
            self.results[name].append(found.term)
            numbers = [each for each in arguments if isinstance(each, Number)]
            self.arguments[name].append(tuple(each.term for each in numbers))
            return found

        return summary


def of_estimate(program: Program) -> Iterator[Claim]:
    """Which numbers estimate() forms, in which order, and what it returns."""
    run = Run(program, "estimate")
    yield from _inside(run)
    yield from _at_an_end(run)


def _inside(run: Run) -> Iterator[Claim]:
    t, n, b_hat, c, g_shift = (run.given[name] for name in ("t", "n", "b_hat", "c", "g_shift"))
    total, rarer, scale, above, dividend = run.results["shift_left"]
    least, root, square = run.results["multiply_high"]
    *_, spread = run.results["multiply"]
    shift, _, square_shift, spread_shift = run.results["leading_zeros"]
    x, ratio = run.results["divide_24"]
    _, divisor = run.results["upper"]
    known = _possible(run)
    white = t - n
    shifts = run.arguments["shift_left"]
    yield "t, shifted", z3.And(shifts[0][0] == t, shifts[0][1] == shift), known
    part = z3.If(n < white, n, white)
    yield "the rarer colour's count, shifted", z3.And(shifts[1][0] == part, shifts[1][1] == shift), known
    yield "c t", z3.And(*_equal(run.arguments["multiply_high"][0], (c, total))), known
    inside = [*known, rarer > least, c <= C_MOST]
    yield "g t", z3.And(*_equal(shifts[2], (total - 2 * least, g_shift))), inside
    yield "part - c t", z3.And(*_equal(shifts[3], (rarer - least, g_shift))), inside
    yield "x", z3.And(*_equal(run.arguments["divide_24"][0], (above, scale / 2))), inside
    products = run.arguments["multiply_high"]
    yield "(g t)^2", z3.And(*_equal(products[1], (scale, scale))), inside
    yield "(g t)^2 t", z3.And(*_equal(products[2], (root, total))), inside
    yield "p (1 - p)", z3.And(*_equal(run.arguments["multiply"][-1], (rarer, total - rarer))), inside
    yield "dividend", z3.And(*_equal(shifts[4], (square, square_shift))), inside
    yield "divisor", z3.And(*_equal(run.arguments["upper"][-1], (spread, spread_shift))), inside
    yield "ratio", z3.And(*_equal(run.arguments["divide_24"][1], (dividend / 2, divisor / 2))), inside
    ((mantissa, exponent),) = run.arguments["alpha_word"]
    excess = z3.If(ratio >= 2**24, 1, 0)
    upper = z3.If(excess == 1, ratio / 2, ratio)
    formed = (32 - 2 * g_shift - shift + spread_shift - square_shift + excess) % 2**32
    is_long = [*inside, ratio < 2**25]
    yield "mantissa and exponent", z3.And(mantissa == upper, exponent == formed), is_long
    mirrored = (n < white) == (b_hat < 2**31)
    near = z3.If(rarer <= least, 0, x / 4)
    x_hat = z3.If(mirrored, ONE - near, near)
    says_nothing = z3.And(rarer <= least, c == 2**32 - 1)
    returned = z3.If(says_nothing, run.found["x_hat"] == ONE / 2, run.found["x_hat"] == x_hat)
    small = [t < 2**31, x / 4 <= ONE]
    yield "x_hat", returned, [*known, *small]
    alpha = run.found["alpha"]
    yield "alpha", z3.If(says_nothing, alpha == 0, alpha == run.results["alpha_word"][0]), known


def _possible(run: Run) -> list[Any]:
    """Formulas known of the arguments and of the first results, by lemmas."""
    t, n, c, g_shift = (run.given[name] for name in ("t", "n", "c", "g_shift"))
    total, rarer, *_ = run.results["shift_left"]
    least = run.results["multiply_high"][0]
    return [
        *run.facts,
        *(t >= 1, t <= 2**31, n <= t, c >= 2**12, g_shift <= 11, total >= 2**31, 2 * rarer <= total),
        *(z3.Or(c <= C_MOST, c == 2**32 - 1), 2 * least <= total),
    ]


def _at_an_end(run: Run) -> Iterator[Claim]:
    """The sum, moved until it has 64 bits, of which the mantissa is the upper 24."""
    t, n, common, rare = (run.given[name] for name in ("t", "n", "common", "rare"))
    g_shift, rare_shift = run.given["g_shift"], run.given["rare_shift"]
    rarer, least = run.results["shift_left"][1], run.results["multiply_high"][0]
    first, second, _ = run.results["multiply"]
    (moved,), (joined,), (low,) = (run.results[name] for name in ("shift_right_64", "join", "low_word"))
    high, upper_word, _ = run.results["high_word"]
    known = [*_possible(run), rarer <= least, run.given["c"] <= C_MOST, rare_shift <= 38]
    known += [first < 2**63, second < 2**63, moved <= first]
    part = z3.If(n < t - n, n, t - n)
    products = run.arguments["multiply"]
    yield "part common", z3.And(*_equal(products[0], (t - part, common))), known
    yield "part rare", z3.And(*_equal(products[1], (part, rare))), [*known, part > 0]
    yield (
        "moved",
        z3.And(*_equal(run.arguments["shift_right_64"][0], (first, rare_shift))),
        [*known, part > 0],
    )
    total = z3.If(part == 0, first, second + moved)
    yield "sum", run.arguments["high_word"][0][0] == total, known
    long = z3.If(high == 0, joined, total)
    small = [*known, high == 0]
    yield "of a short sum, low", z3.And(run.arguments["low_word"][0][0] == total), small
    yield "of a short sum, joined", z3.And(*_equal(run.arguments["join"][0], (low, 0))), small
    yield "upper word", run.arguments["high_word"][1][0] == long, known
    sum_shift = run.results["leading_zeros"][1]
    yield "leading zeros", run.arguments["leading_zeros"][1][0] == upper_word, known
    yield "upper bits", z3.And(*_equal(run.arguments["upper"][0], (long, sum_shift))), known
    ((mantissa, exponent),) = run.arguments["alpha_word"]
    moves = z3.If(part == 0, 0, rare_shift) - z3.If(high == 0, 32, 0) - sum_shift
    yield "mantissa", mantissa == run.results["upper"][0] / 2**8, known
    yield "exponent", exponent == (34 - 2 * g_shift + moves) % 2**32, known


def of_set_b_hat(program: Program) -> Iterator[Claim]:
    """Of which quotients it keeps the squares, for any b_hat but 1/2."""
    run = Run(program, "set_b_hat")
    b_hat, held = run.given["b_hat"], run.found["accuracy"]
    g_shift, c_shift = run.results["leading_zeros"]
    shifted, again, shifted_c = run.results["shift_left"]
    common, rare = run.results["square_of_ratio"]
    known = [*run.facts, b_hat >= 2**12, b_hat <= 2**32 - 2**12, b_hat != 2**31, g_shift <= 31, c_shift <= 31]
    c = z3.If(b_hat < 2**31, b_hat, 2**32 - b_hat)
    g = 2**32 - 2 * c
    counted = run.arguments["leading_zeros"]
    yield "shifts of g and c", z3.And(counted[0][0] == g, counted[1][0] == c), known
    shifts = run.arguments["shift_left"]
    wanted = ((g, g_shift), (g, g_shift), (c, c_shift))
    yield (
        "g and c, shifted",
        z3.And([z3.And(*_equal(*each)) for each in zip(shifts, wanted, strict=True)]),
        known,
    )
    squares = run.arguments["square_of_ratio"]
    yield "g / (1 - c)", z3.And(*_equal(squares[0], (shifted, 2**32 - c))), known
    yield "g / c", z3.And(*_equal(squares[1], (again, shifted_c))), known
    members = {"common": common, "rare": rare, "g_shift": g_shift, "rare_shift": 2 * c_shift}
    yield "members", z3.And([held[name] == each for name, each in members.items()]), known


def _equal(found: tuple[Any, ...], wanted: tuple[Any, ...]) -> list[Any]:
    return [one == other for one, other in zip(found, wanted, strict=True)]


def of_square_of_ratio(program: Program) -> Iterator[Claim]:
    """The square of a quotient of 24 or 25 bits, whose unit is 2^-24."""
    run = Run(program, "square_of_ratio")
    (quotient,), (square,) = run.results["divide_24"], run.results["multiply_high"]
    known = [*run.facts, quotient < 2**25]
    halves = (run.given["g"] / 2, run.given["p"] / 2)
    yield "quotient", z3.And(*_equal(run.arguments["divide_24"][0], halves)), known
    ratio = quotient * 2**7
    yield "square", z3.And(*_equal(run.arguments["multiply_high"][0], (ratio, ratio))), known
    yield "result", run.found == square, known


def of_reestimate(program: Program) -> Iterator[Claim]:
    """Which quotient is b_hat, and when there is none; in words, of which products are any."""
    run = Run(program, "reestimate", Words)
    t, n, closed = (run.given[name] for name in ("t", "n", "closed"))
    (mean,), (quotient,), (joined,) = (run.results[name] for name in ("mean", "quotient", "join"))
    span, taken = run.results["multiply"]
    sums = (closed[name] for name in ("alpha", "alpha_x_low", "alpha_x_high"))
    yield "x_bar", z3.And(*_equal(run.arguments["mean"][0], tuple(sums))), run.facts
    is_below = z3.ULT(mean, 2**31)
    a, black = z3.If(is_below, ~mean, mean), z3.If(is_below, t - n, n)
    yield "whether x_bar says something", (run.found != 0) == z3.UGE(2 * a, 2**20), run.facts
    known = [*run.facts, z3.UGE(2 * a, 2**20)]
    spans = run.arguments["multiply"]
    yield "D", z3.And(*_equal(spans[0], (t, 2 * a))), known
    yield "t (1 - x_bar)", z3.And(*_equal(spans[1], (t, -a))), known
    yield "2^32 n", z3.And(*_equal(run.arguments["join"][0], (black, z3.BitVecVal(0, 32)))), known
    above = z3.If(joined - taken > 0, joined - taken, 0)
    dividend = z3.If(z3.ULT(above, span), above, span)
    yield "N / D, between 0 and 1", z3.And(*_equal(run.arguments["quotient"][0], (dividend, span))), known
    least, most = z3.BitVecVal(2**12, 32), z3.BitVecVal(2**32 - 2**12, 32)
    kept = z3.If(z3.ULT(quotient, least), least, z3.If(z3.UGT(quotient, most), most, quotient))
    yield "b_hat in its range", run.arguments["set_b_hat"][0][0] == kept, known


# --- Of the numbers --------------------------------------------------------------------------------------

BELOW = (Fraction(1, 2**28), Fraction(1, 2**27), Fraction(1, 2**31))
"""Shares that (g t)^2, (g t)^2 t and the dividend of alpha lose at most, of themselves."""
DIVISOR_LOSES = Fraction(1, 2**30)


def of_x_hat() -> Iterator[Claim]:
    """x lies between the exact quotient N / D and what is (1 - 2 N / D) r 2^-31 nearer to 1/2."""
    p, total, least, c = z3.Ints("P T L c")
    rounded = (2**32 * least <= c * total, c * total < 2**32 * (least + 1))
    yield "p > c is decided exactly", (p > least) == (2**32 * p > c * total), [*rounded]
    t, power, half = z3.Ints("t power half")
    is_even = z3.Or(total == 2**31, z3.And(total == t * power, power == 2 * half))
    yield "g t is even", total % 2 == 0, [is_even]
    yield "the rarer colour is at most half", 2 * p * power <= t * power, [2 * p <= t, power >= 1]
    x, above, scale = z3.Ints("X above scale")
    floor = (x * scale <= 2**24 * above, 2**24 * above < (x + 1) * scale, above >= 0, scale > 0, x >= 0)
    exact = z3.And(x / 4 * scale <= 2**22 * above, 2**22 * above < (x / 4 + 1) * scale)
    yield "x is a floor to 2^-23", exact, [*floor, x == 4 * (x / 4) + x % 4]
    n, d, e, of_t, g = z3.Reals("N D e T g")
    possible = [n >= 0, 2 * n <= d, d > 0, e >= 0, e < 1, d == g * of_t, of_t >= 2**31, g > 0]
    yield "x is not too near to the end", n * (d + 2 * e) <= d * (n + e), possible
    yield "and D not too small", (n + e) * d * d <= (n * d + d - 2 * n) * (d + 2 * e), possible
    yield "1 / D is at most r 2^-31", 2**31 * g <= d, possible


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
    is_floor = [2**32 * floor <= exact, exact < 2**32 * (floor + 1)]
    claim = 2**32 * floor * share.denominator >= exact * (share.denominator - share.numerator)
    yield name, claim, [*known, *is_floor]


SQUARE_LOSES = (Fraction(1, 2**23), Fraction(1, 2**23), Fraction(1, 2**28))
"""Shares that a square of a quotient loses at most, of itself: the quotient, twice, and the square."""
SUM_LOSES = Fraction(1, 2**28)
SQUARE_GAINS = Fraction(1, 2**30)


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
    known = [x >= 0, x <= 1, d >= 2**31, e >= d, e <= d + 2]
    known += [above >= 0, above <= x * d, above >= x * d - 1]
    yield "the ratio is not too large", above <= x * e, known
    lost = x * e - above
    yield "and loses 2 x + 1", lost <= 2 * x + 1, known
    share = [*(x >= 0, x <= 1, e >= 2**31), lost >= 0, lost <= 2 * x + 1]
    floor = [q * e <= 2**32 * above, 2**32 * above < (q + 1) * e]
    yield "the quotient is not too large", q <= 2**32 * x, [*share, *floor]
    yield "and less than 4 x + 3 too small", 2**32 * x < q + 4 * x + 3, [*share, *floor]


def of_b_hat() -> Iterator[Claim]:
    """b_hat of eq. 8 is as far off as tests/exact.py allows, and by 2^-26 where |2 x_bar - 1| >= 0.1.

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
