"""The lemmas of ``mcp_asdf.c``: what its quotients of sums are worth, and the form of alpha."""

from __future__ import annotations

from typing import Any

import z3

from proofs.arithmetic import contracts as arithmetic_contracts
from proofs.arithmetic import quotient_ensures
from proofs.machine import Machine, Summary
from proofs.numbers import Integers, Number, Type
from proofs.prove import By, Contract, Step
from proofs.source import SOURCES, Variant

CORE = SOURCES / "mcp_asdf.c"
ONE = 2**23
WORD, LONG = Type(32), Type(64)
OWN_HIGH, OWN_LOW, MEAN = z3.Ints("own_high own_low mean")
"""Results of units() and mean(): numbers that formulas may name."""
DIVIDEND, DIVISOR = z3.Ints("dividend divisor")
"""Arguments of quotient()."""
SUMS = z3.Ints("sum_alpha sum_low sum_high")
"""Arguments of mean()."""


def _product(_: Machine, a: Number, b: Number) -> Number:
    """multiply() in whole numbers, by its lemma."""
    return Number(a.term * b.term, LONG)


def _sum(high: Any, low: Any) -> Any:
    """The sum of alpha x_hat that two parts stand for."""
    return 2**32 * high + low


# --- Quotients of sums -----------------------------------------------------------------------------------


def _sums_possible(alpha: Any, low: Any, high: Any) -> Any:
    """The header's ranges, and a mean of at most 1."""
    return z3.And(alpha > 0, alpha < 2**62, low < 2**62, high < 2**53, _sum(high, low) <= ONE * alpha)


def _is_mean(found: Any, alpha: Any, low: Any, high: Any) -> Any:
    """Never too large, and less than 8 units of 2^-32 too small."""
    exact, scale = _sum(high, low) * 2**32, ONE * alpha
    return z3.And(found >= 0, found < 2**32, found * scale <= exact, exact < (found + 8) * scale)


def _quotient(machine: Machine, a: Number, d: Number) -> Number:
    """quotient() by its lemma, of numbers with names."""
    machine.know(z3.And(a.term == DIVIDEND, d.term == DIVISOR))
    machine.claim(z3.And(d.term > 0, a.term <= d.term), "what quotient requires")
    machine.know(z3.And(MEAN >= 0, quotient_ensures(MEAN, DIVIDEND, DIVISOR)))
    return Number(MEAN, WORD)


def _is_scaled(_: Any, alpha: Any, low: Any, high: Any) -> Any:
    """The sums are divided as they are, less a fraction below 2^-32 of alpha; a short alpha with 32 bits
    more, and no fraction lost."""
    exact = _sum(high, low)
    long = z3.And(alpha == DIVISOR, exact >= ONE * DIVIDEND, exact < ONE * (DIVIDEND + 1), alpha >= 2**32)
    return z3.Or(long, z3.And(2**32 * alpha == DIVISOR, 2**32 * exact == ONE * DIVIDEND))


def _is_quotient(found: Any, *sums: Any) -> Any:
    return z3.And(found >= 0, quotient_ensures(found, DIVIDEND, DIVISOR), _sums_possible(*sums))


def _closed_possible(closed: Any, x_hat: Any, _: Any) -> Any:
    sums = (closed["alpha"], closed["alpha_x_low"], closed["alpha_x_high"])
    empty = z3.And([each == 0 for each in sums])
    limit = 2**62 - 2**55
    ranges = z3.And(sums[0] < limit, sums[1] < limit, sums[2] < 2**53 - 2**46)
    return z3.And(z3.Or(empty, z3.And(_sums_possible(*sums), ranges)), x_hat <= ONE)


def _totals(closed: Any, x_hat: Any) -> tuple[Any, Any]:
    """Of alpha and of alpha x_hat, the own message included."""
    alpha = closed["alpha"] + _sum(OWN_HIGH, OWN_LOW)
    return alpha, _sum(closed["alpha_x_high"], closed["alpha_x_low"]) + _sum(OWN_HIGH, OWN_LOW) * x_hat


def _is_informed(found: Any, _: Any, closed: Any, x_hat: Any, __: Any) -> Any:
    """The exact quotient, rounded down."""
    alpha, total = _totals(closed, x_hat)
    floor = z3.And(found * alpha <= total, total < found * alpha + alpha)
    return z3.If(alpha == 0, found == x_hat, floor)


def _ranges(_: Any, __: Any, closed: Any, x_hat: Any, ___: Any) -> Any:
    """Of numbers that have a name."""
    own = z3.And(OWN_HIGH >= 0, OWN_HIGH < ONE, OWN_LOW >= 0, OWN_LOW < 2**32)
    return z3.Implies(_totals(closed, x_hat)[0] != 0, z3.And(own, closed["alpha"] >= 0))


def _products_fit(_: Any, __: Any, ___: Any, x_hat: Any, ____: Any) -> Any:
    """Of the own message."""
    low, high = OWN_LOW * x_hat, OWN_HIGH * x_hat
    return z3.And(low > -1, low < ONE * 2**32, high > -1, high < ONE * ONE)


def _are_totals(_: Any, __: Any, closed: Any, x_hat: Any, ___: Any) -> Any:
    alpha, total = _totals(closed, x_hat)
    return z3.Implies(
        alpha != 0, z3.And(SUMS[0] == alpha, _sum(SUMS[2], SUMS[1]) == total, alpha > 0, alpha < 2**62)
    )


def _has_mean(_: Any, __: Any, closed: Any, x_hat: Any, ___: Any) -> Any:
    return z3.Implies(_totals(closed, x_hat)[0] != 0, _is_mean(MEAN, *SUMS))


def _is_split(_: Any, __: Any, closed: Any, x_hat: Any, ___: Any) -> Any:
    """x alpha, from the two words of alpha."""
    high, low = _halves(1)
    x, alpha = MEAN / 2**9, _totals(closed, x_hat)[0]
    return z3.Implies(alpha != 0, x * alpha == 2**32 * (x * high) + x * low)


def _are_halves(_: Any, __: Any, closed: Any, x_hat: Any, ___: Any) -> Any:
    high, low = _halves(0)
    whole = closed["alpha_x_high"] + OWN_HIGH * x_hat == 2**32 * high + low
    return z3.Implies(_totals(closed, x_hat)[0] != 0, z3.And(whole, low >= 0, low < 2**32))


def _rest(closed: Any, x_hat: Any) -> Any:
    """The remainder of the division, modulo 2^64, from the words at hand."""
    (_, sum_low), (alpha_high, alpha_low) = _halves(0), _halves(1)
    x = MEAN / 2**9
    product = x * alpha_low + 2**32 * (x * alpha_high % 2**32)
    return (closed["alpha_x_low"] + OWN_LOW * x_hat + 2**32 * sum_low - product) % 2**64


def _is_rest(_: Any, __: Any, closed: Any, x_hat: Any, ___: Any) -> Any:
    alpha, total = _totals(closed, x_hat)
    return z3.Implies(alpha != 0, _rest(closed, x_hat) == total - MEAN / 2**9 * alpha)


def _is_corrected(found: Any, __: Any, closed: Any, x_hat: Any, ___: Any) -> Any:
    """By what the rest of the division says."""
    alpha, _ = _totals(closed, x_hat)
    one_more = z3.If(_rest(closed, x_hat) >= alpha, 1, 0)
    return z3.Implies(alpha != 0, found == MEAN / 2**9 + one_more)


def _halves(number: int) -> list[Any]:
    """Upper and lower word of alpha_x_high (0) and of alpha (1), in the order in which they are asked for."""
    return list(z3.Ints(f"high_{number} low_{number}"))


class Halves:
    """high_word() and low_word(): two numbers for each number that they are asked for."""

    def __init__(self) -> None:
        self.seen: list[Any] = []

    def part(self, index: int) -> Summary:
        def summary(machine: Machine, value: Number) -> Number:
            if not any(value.term.eq(each) for each in self.seen):
                self.seen.append(value.term)
            number = next(i for i, each in enumerate(self.seen) if value.term.eq(each))
            high, low = halves = _halves(number)
            whole = z3.And(value.term == 2**32 * high + low, high >= 0, high < 2**32, low >= 0, low < 2**32)
            machine.know(whole)
            return Number(halves[index], WORD)

        return summary


def _nearly(_: Any, __: Any, closed: Any, x_hat: Any, ___: Any) -> Any:
    """The upper 23 bits of the mean are right, or one too small."""
    alpha, total = _totals(closed, x_hat)
    x = MEAN / 2**9
    return z3.Implies(alpha != 0, z3.And(x * alpha <= total, total < x * alpha + 2 * alpha))


def _are_units(found: Any, alpha: Any) -> Any:
    mantissa, shift = z3.LShR(alpha, 8), alpha & 31
    return z3.Concat(found["high"], found["low"]) == z3.ZeroExt(32, mantissa) << z3.ZeroExt(32, shift)


def _own_units(machine: Machine, _: Number) -> Any:
    machine.know(z3.And(OWN_HIGH >= 0, OWN_HIGH < ONE, OWN_LOW >= 0, OWN_LOW < 2**32))
    return {"high": Number(OWN_HIGH, WORD), "low": Number(OWN_LOW, WORD)}


def _mean(machine: Machine, *sums: Number) -> Number:
    alpha, low, high = (each.term for each in sums)
    machine.claim(_sums_possible(alpha, low, high), "what mean requires")
    machine.know(z3.And(SUMS[0] == alpha, SUMS[1] == low, SUMS[2] == high))
    machine.know(_is_mean(MEAN, *SUMS))
    return Number(MEAN, WORD)


# --- alpha -----------------------------------------------------------------------------------------------


def _is_normal(mantissa: Any, exponent: Any) -> Any:
    """24 bits; the exponent modulo 2^32, at least -31."""
    return z3.And(mantissa >> 23 == 1, z3.Or(exponent >= -31, exponent >= 0))


def _is_on_grid(found: Any, mantissa: Any, exponent: Any) -> Any:
    """The largest confidence; the number itself; or whole units of it, rounded down, with shift 0."""
    largest, exact = 0xFFFFFF1F, mantissa << 8 | exponent
    below = z3.LShR(mantissa, -exponent) << 8
    return z3.If(exponent > 31, found == largest, found == z3.If(exponent >= 0, exact, below))


def _is_accuracy(after: Any, _: Any, b_hat: Any) -> Any:
    """The header's statements about the members, except the squares."""
    held = after["accuracy"]
    half = b_hat == 1 << 31
    c = z3.If(z3.ULT(b_hat, 1 << 31), b_hat, -b_hat)
    says_nothing = z3.UGT(c, C_MOST)
    is_scaled = z3.LShR((-2 * c) << held["g_shift"], 31) == 1
    return z3.And(
        held["b_hat"] == b_hat,
        z3.Or(half, is_scaled),
        held["c"] == z3.If(says_nothing, z3.BitVecVal(2**32 - 1, 32), c),
        z3.Or(half, z3.ULE(held["g_shift"], 11) == z3.Not(says_nothing)),
        z3.Or(z3.ULE(held["g_shift"], 30), z3.And(half, held["g_shift"] == 31)),
        z3.If(
            half,
            held["rare_shift"] == 0,
            z3.And(z3.UGE(held["rare_shift"], 2), z3.ULE(held["rare_shift"], 38)),
        ),
    )


C_MOST = (1 << 31) - (1 << 19)
"""The largest c that says something."""


def _square(machine: Machine, g: Number, p: Number) -> Number:
    """square_of_ratio(), which takes g and p of 32 bits, if b_hat is not 1/2."""
    is_long = z3.And(z3.ULE(1 << 31, g.term), z3.ULE(1 << 31, p.term))
    machine.claim(z3.Or(is_long, machine.given["b_hat"] == 1 << 31), "what square_of_ratio requires")
    return machine.unknown("square", WORD)


def _b_hat_in_range(_: Any, b_hat: Any) -> Any:
    return z3.And(z3.UGE(b_hat, 1 << 12), z3.ULE(b_hat, 2**32 - 2**12))


def _of_sums() -> dict[str, Contract]:
    halves = Halves()
    informed = Contract(
        _is_informed,
        Integers,
        _closed_possible,
        steps=(
            Step(_ranges),
            Step(_products_fit),
            Step(_are_totals, By.SUMS),
            Step(_has_mean, By.SUMS),
            Step(_nearly, By.STEPS),
            Step(_is_split),
            Step(_are_halves, By.SUMS),
            Step(_is_rest, By.STEPS | By.SUMS),
            Step(_is_corrected, By.STEPS | By.SUMS),
        ),
        by=By.STEPS,
        uses={
            **{"units": _own_units, "mean": _mean, "multiply": _product},
            **{"high_word": halves.part(0), "low_word": halves.part(1)},
        },
    )
    mean = Contract(
        _is_mean,
        Integers,
        _sums_possible,
        steps=(Step(_is_scaled), Step(_is_quotient)),
        by=By.STEPS,
        uses={"quotient": _quotient},
    )
    return {"units": Contract(_are_units), "mean": mean, "informed_estimate": informed}


def _of_alpha(lower: dict[str, Contract]) -> dict[str, Contract]:
    def stand_in(*names: str) -> dict[str, Summary]:
        return {name: lower[name].stands_in(name) for name in names}

    shifts = ("shift_left", "shift_right", "shift_right_64", "upper", "leading_zeros")
    words = stand_in("join", "high_word", "low_word", *shifts)
    return {
        "alpha_word": Contract(_is_on_grid, requires=_is_normal, uses=words),
        "set_b_hat": Contract(
            _is_accuracy,
            requires=_b_hat_in_range,
            uses={**words, "square_of_ratio": _square},
        ),
    }


def contracts(variant: Variant) -> dict[str, Contract]:
    """All of them, for one variant. The last three are shown to be safe here; ``accuracy`` shows what
    they compute, and that they keep what they owe the functions they call."""
    safe = dict.fromkeys(("square_of_ratio", "estimate", "reestimate"), Contract(None))
    return {**_of_sums(), **_of_alpha(arithmetic_contracts(variant)), **safe}
