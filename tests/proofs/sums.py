"""x and x_bar are the exact quotients of their sums, rounded down, and the mean of eq. 8 is less than 8 units
of 2^-32 too small: for sums of messages that can have been sent.

S is the sum of alpha x_hat, which two words stand for: 2^32 H + L. Formulas of the C come first, then claims
about the numbers in them.
"""

from __future__ import annotations

from collections.abc import Iterator

import z3

from proofs.arithmetic import EXACT, QUOTIENT
from proofs.formulas import ONE, Claim, call, formed, units
from proofs.source import Program

high_word, low_word = EXACT["high_word"], EXACT["low_word"]


def of_mean(program: Program) -> Iterator[Claim]:
    """The sums are divided as they are, less a fraction below 2^-32 of alpha; a short alpha with 32 bits
    more, and no fraction lost. What quotient() requires holds."""
    given, (found, _) = formed(program, "round_mean", ["quotient"])
    alpha, low, high = (given[name] for name in ("alpha", "alpha_x_low", "alpha_x_high"))
    wide_alpha, wide_low, wide_high = (z3.ZeroExt(32, each) for each in (alpha, low, high))
    total = (wide_high << 32) + wide_low
    known = [alpha != 0, z3.ULT(alpha, 2**62), z3.ULT(low, 2**62), z3.ULT(high, 2**53)]
    known += [z3.ULE(total, wide_alpha << 23)]
    is_short = z3.ULT(alpha, 2**32)
    cases = {
        "long": (z3.LShR(total, 23), wide_alpha, [*known, z3.Not(is_short)]),
        "short": (total << 9, wide_alpha << 32, [*known, is_short]),
    }
    for name, (dividend, divisor, possible) in cases.items():
        fits = z3.And(z3.Extract(95, 64, dividend) == 0, z3.Extract(95, 64, divisor) == 0)
        whole = QUOTIENT.requires(*(z3.ZeroExt(32, each) for each in (dividend, divisor)))
        yield f"{name}: what quotient() requires", z3.And(fits, whole), possible
        arguments = (z3.Extract(63, 0, each) for each in (dividend, divisor))
        yield f"{name}: quotient", found == call("quotient", *arguments), possible


# design: R21
def of_informed_estimate(program: Program) -> Iterator[Claim]:
    """Eq. 7, the own message included, and a correction by the rest of the division, modulo 2^64."""
    given, (found, _) = formed(program, "informed_estimate", ["round_mean", "multiply"])
    x_hat, own_alpha = given["x_hat"], given["own_alpha"]
    own = units(own_alpha)
    alpha = given["alpha"] + own
    low = given["alpha_x_low"] + call("multiply", low_word(own), x_hat)
    high = given["alpha_x_high"] + call("multiply", high_word(own), x_hat)
    x = z3.LShR(call("round_mean", alpha, low, high), 9)
    product = call("multiply", x, low_word(alpha)) + z3.Concat(x * high_word(alpha), z3.BitVecVal(0, 32))
    rest = low + z3.Concat(low_word(high), z3.BitVecVal(0, 32)) - product
    one_more = z3.If(z3.UGE(rest, alpha), z3.BitVecVal(1, 32), z3.BitVecVal(0, 32))
    yield "nothing is known", found == x_hat, [alpha == 0]
    yield "x", found == x + one_more, [alpha != 0]


def of_the_mean() -> Iterator[Claim]:
    """Claim that the mean is at most 7 units too small, by the lemma of quotient()."""
    total, alpha, dividend, q = z3.Ints("S alpha dividend q")
    known = [total >= 0, alpha > 0, total <= ONE * alpha, q >= 0]
    is_mean = z3.And(q * ONE * alpha <= 2**32 * total, 2**32 * total < (q + 8) * ONE * alpha)
    long = [*known, alpha >= 2**32, total >= ONE * dividend, total < ONE * (dividend + 1)]
    yield "long", is_mean, [*long, QUOTIENT.ensures(q, dividend, alpha)]
    short = [*known, dividend == 2**9 * total, QUOTIENT.ensures(q, dividend, 2**32 * alpha)]
    yield "short", is_mean, short


# design: R21
def of_the_rest() -> Iterator[Claim]:
    """The upper 23 bits of the mean are right or one too small; the rest, below 2 alpha, shows which."""
    closed, low, high, own_high, own_low, x_hat = z3.Ints("closed L H own_high own_low x_hat")
    known = [closed >= 0, closed < 2**62 - 2**55, low >= 0, low < 2**62 - 2**55, high >= 0]
    known += [high < 2**53 - 2**46, own_high >= 0, own_high < 2**23, own_low >= 0]
    known += [own_low < 2**32, x_hat >= 0, x_hat <= ONE]
    known += [2**32 * high + low <= ONE * closed]
    own, new_low, new_high = 2**32 * own_high + own_low, low + own_low * x_hat, high + own_high * x_hat
    ranges = [closed + own < 2**62, new_low < 2**62, new_high < 2**53]
    yield "sums of 128 robots", z3.And(ranges), known
    total = 2**32 * new_high + new_low
    yield "S", total == 2**32 * high + low + own * x_hat, known
    yield "a mean of at most 1", total <= ONE * (closed + own), known
    alpha, s, mean, x = z3.Ints("alpha S mean x")
    possible = [alpha > 0, alpha < 2**62, s >= 0, mean >= 0, x == mean / 2**9]
    is_mean = [mean * ONE * alpha <= 2**32 * s, 2**32 * s < (mean + 8) * ONE * alpha]
    nearly = z3.And(x * alpha <= s, s < x * alpha + 2 * alpha)
    yield "right or one too small", nearly, [*possible, *is_mean]
    upper, lower, times = z3.Ints("upper lower times")
    wrapped = upper == 2**32 * times + upper % 2**32
    product = 2**32 * (upper % 2**32) + lower
    yield "x alpha modulo 2^64", 2**32 * upper + lower - product == 2**64 * times, [wrapped]
    taken, found = z3.Ints("taken found")
    exact = [*possible, taken <= s, s < taken + 2 * alpha]
    yield "the rest fits", z3.And(s - taken >= 0, s - taken < 2**63), exact
    is_floor = z3.And(found * alpha <= s, s < (found + 1) * alpha)
    corrected = found == x + z3.If(s - taken >= alpha, 1, 0)
    yield "the exact quotient, rounded down", is_floor, [*exact, taken == x * alpha, corrected]


OF_THE_CODE = (of_mean, of_informed_estimate)
OF_THE_NUMBERS = (of_the_mean, of_the_rest)
