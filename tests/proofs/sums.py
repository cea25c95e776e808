"""x and x_bar are the exact quotients of their sums, rounded down, and the mean of eq. 8 is less than 8 units
of 2^-32 too small: for sums of messages that can have been sent.

S is the sum of alpha x_hat, which two words stand for: 2^32 H + L. Formulas of the C come first, then claims
about the numbers in them.
"""

from __future__ import annotations

from collections.abc import Iterator

import z3

from proofs.arithmetic import EXACT_RESULTS, QUOTIENT
from proofs.formulas import ONE, alpha_in_units, function_terms, result_of
from proofs.prove import Claim
from proofs.source import Program

high_word, low_word = EXACT_RESULTS["high_word"], EXACT_RESULTS["low_word"]


def round_mean_claims(program: Program) -> Iterator[Claim]:
    """Claim what round_mean() divides by what, and that quotient() gets what it requires.

    The sums are divided as they are, less a fraction below 2^-32 of alpha. Where alpha is short, both have 32
    bits more, and no fraction is lost.
    """
    arguments, result, _ = function_terms(program, "round_mean", ["quotient"])
    alpha, low, high = (arguments[name] for name in ("alpha", "alpha_x_low", "alpha_x_high"))
    # 96 bits: no sum or shift below wraps.
    wide_alpha, wide_low, wide_high = (z3.ZeroExt(32, word) for word in (alpha, low, high))
    total = (wide_high << 32) + wide_low
    assumptions = [alpha != 0, z3.ULT(alpha, 2**62), z3.ULT(low, 2**62), z3.ULT(high, 2**53)]
    assumptions += [z3.ULE(total, wide_alpha << 23)]
    is_short = z3.ULT(alpha, 2**32)
    # Dividend and divisor of each case.
    cases = {
        "long": (z3.LShR(total, 23), wide_alpha, [*assumptions, z3.Not(is_short)]),
        "short": (total << 9, wide_alpha << 32, [*assumptions, is_short]),
    }
    for case_name, (dividend, divisor, case_assumptions) in cases.items():
        fit_in_64_bits = z3.And(z3.Extract(95, 64, dividend) == 0, z3.Extract(95, 64, divisor) == 0)
        is_divisible = QUOTIENT.requires(*(z3.ZeroExt(32, word) for word in (dividend, divisor)))
        claim_name = f"{case_name}: what quotient() requires"
        yield Claim(claim_name, z3.And(fit_in_64_bits, is_divisible), case_assumptions)
        dividend_word, divisor_word = (z3.Extract(63, 0, word) for word in (dividend, divisor))
        is_quotient = result == result_of("quotient", dividend_word, divisor_word)
        yield Claim(f"{case_name}: quotient", is_quotient, case_assumptions)


# design: R21
def informed_estimate_claims(program: Program) -> Iterator[Claim]:
    """Claim that informed_estimate() computes eq. 7, with the robot's own message.

    It corrects the mean by the rest of the division, modulo 2^64.
    """
    arguments, result, _ = function_terms(program, "informed_estimate", ["round_mean", "multiply"])
    x_hat, own_alpha = arguments["x_hat"], arguments["own_alpha"]
    own_units = alpha_in_units(own_alpha)
    alpha = arguments["alpha"] + own_units
    low = arguments["alpha_x_low"] + result_of("multiply", low_word(own_units), x_hat)
    high = arguments["alpha_x_high"] + result_of("multiply", high_word(own_units), x_hat)
    # The mean is in units of 2^-32, and x in units of 2^-23.
    x = z3.LShR(result_of("round_mean", alpha, low, high), 9)
    zero_word = z3.BitVecVal(0, 32)
    upper_product = z3.Concat(x * high_word(alpha), zero_word)
    product = result_of("multiply", x, low_word(alpha)) + upper_product
    rest = low + z3.Concat(low_word(high), zero_word) - product
    correction = z3.If(z3.UGE(rest, alpha), z3.BitVecVal(1, 32), z3.BitVecVal(0, 32))
    yield Claim("nothing is known", result == x_hat, [alpha == 0])
    yield Claim("x", result == x + correction, [alpha != 0])


def mean_error_claims() -> Iterator[Claim]:
    """Claim that the mean is less than 8 units too small, by the lemma of quotient()."""
    total, alpha, dividend, q = z3.Ints("S alpha dividend q")
    assumptions = [total >= 0, alpha > 0, total <= ONE * alpha, q >= 0]
    is_mean = z3.And(q * ONE * alpha <= 2**32 * total, 2**32 * total < (q + 8) * ONE * alpha)
    # A long alpha loses the bits of S below ONE, which is less than a unit of the dividend.
    is_long = [*assumptions, alpha >= 2**32, total >= ONE * dividend, total < ONE * (dividend + 1)]
    yield Claim("long", is_mean, [*is_long, QUOTIENT.ensures(q, dividend, alpha)])
    is_short = [*assumptions, dividend == 2**9 * total, QUOTIENT.ensures(q, dividend, 2**32 * alpha)]
    yield Claim("short", is_mean, is_short)


# design: R21
def exact_estimate_claims() -> Iterator[Claim]:
    """Claim that the upper 23 bits of the mean, corrected by the rest, are the exact quotient rounded down.

    They are right or one too small; the rest, below 2 alpha, shows which.
    """
    closed, low, high, own_high, own_low, x_hat = z3.Ints("closed L H own_high own_low x_hat")
    assumptions = [closed >= 0, closed < 2**62 - 2**55, low >= 0, low < 2**62 - 2**55, high >= 0]
    assumptions += [high < 2**53 - 2**46, own_high >= 0, own_high < 2**23, own_low >= 0]
    assumptions += [own_low < 2**32, x_hat >= 0, x_hat <= ONE]
    assumptions += [2**32 * high + low <= ONE * closed]
    own_alpha = 2**32 * own_high + own_low
    new_low, new_high = low + own_low * x_hat, high + own_high * x_hat
    sums_fit = z3.And([closed + own_alpha < 2**62, new_low < 2**62, new_high < 2**53])
    yield Claim("sums of 128 robots", sums_fit, assumptions)
    total = 2**32 * new_high + new_low
    yield Claim("S", total == 2**32 * high + low + own_alpha * x_hat, assumptions)
    yield Claim("a mean of at most 1", total <= ONE * (closed + own_alpha), assumptions)

    alpha, s, mean, x = z3.Ints("alpha S mean x")
    ranges = [alpha > 0, alpha < 2**62, s >= 0, mean >= 0, x == mean / 2**9]
    is_mean = [mean * ONE * alpha <= 2**32 * s, 2**32 * s < (mean + 8) * ONE * alpha]
    is_at_most_one_too_small = z3.And(x * alpha <= s, s < x * alpha + 2 * alpha)
    yield Claim("right or one too small", is_at_most_one_too_small, [*ranges, *is_mean])

    # The C computes with the lower word of the upper product: the rest is only off by multiples of 2^64.
    upper, lower, times = z3.Ints("upper lower times")
    is_wrapped = upper == 2**32 * times + upper % 2**32
    wrapped_product = 2**32 * (upper % 2**32) + lower
    is_same_modulo_2_64 = 2**32 * upper + lower - wrapped_product == 2**64 * times
    yield Claim("x alpha modulo 2^64", is_same_modulo_2_64, [is_wrapped])

    product, result = z3.Ints("taken found")
    rest = s - product
    exact_assumptions = [*ranges, product <= s, s < product + 2 * alpha]
    yield Claim("the rest fits", z3.And(rest >= 0, rest < 2**63), exact_assumptions)
    is_floor = z3.And(result * alpha <= s, s < (result + 1) * alpha)
    is_corrected = result == x + z3.If(rest >= alpha, 1, 0)
    is_computed = [*exact_assumptions, product == x * alpha, is_corrected]
    yield Claim("the exact quotient, rounded down", is_floor, is_computed)


OF_THE_CODE = (round_mean_claims, informed_estimate_claims)
OF_THE_NUMBERS = (mean_error_claims, exact_estimate_claims)
