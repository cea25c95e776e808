"""What a robot should have computed, in exact rationals and in float64, and how far off the firmware is.

An ``Audit`` follows robots through scenarios. Everything is computed anew from what a robot knew before a
call, by the paper's equations: the estimates from t, n and b_hat, the social values from the round's
exact sums, the test's decision from those sums and the true threshold. What has one right answer to the last bit must have
it; the errors of the rest are collected by region.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from fractions import Fraction
from functools import lru_cache
from typing import NamedTuple

from mpmath import mp  # type: ignore[import-untyped]

from firmware_py.fixed_point import ALPHA_MAX, HALF, ONE, bits_to_alpha
from firmware_py.reference import (
    B_HAT_MARGIN,
    Message,
    assumed_accuracy_update,
    informed_estimate,
    local_confidence,
    local_estimate,
)
from firmware_py.robot import Filter
from host_tools.crosscheck import Look, State, Watcher
from host_tools.error_statistics import Errors
from host_tools.scenarios import Call, Setup, TableChoice, build_table
from host_tools.tables import parse_omega, true_thresholds, worst_threshold_error

REGIONS = (
    (2.0**-12, "below 2^-12"),
    (0.02, "2^-12 to 0.02"),
    (0.2, "0.02 to 0.2"),
    (0.9, "0.2 to 0.9"),
    (0.999, "0.9 to 0.999"),
    (1.0, "0.999 to 1"),
)
"""Upper ends, of |2 b_hat - 1| for what is estimated with b_hat, of |2 x_bar - 1| for b_hat itself."""

_EPSILON = Fraction(B_HAT_MARGIN)
_LARGEST_ALPHA = Fraction(bits_to_alpha(ALPHA_MAX))
_COARSE = Fraction(1, 2)
"""Where alpha is smaller, its grid of 2**-24 is coarser than 24 significant bits."""
_SATURATED = 0xFFFF
_THRESHOLD_SCALE = 128


class Key(NamedTuple):
    """What a set of errors is about."""

    quantity: str
    region: str
    place: str


@dataclass
class Deviations:
    """Errors of one kind, against exact rationals and against float64."""

    exact: Errors = field(default_factory=Errors)
    reference: Errors = field(default_factory=Errors)


@dataclass
class Decisions:
    """Hypothesis tests, compared with exact arithmetic and the true threshold.

    Attributes:
        tests: How many ran.
        disagreements: How many were decided otherwise than by the true threshold.
        nearest: The smallest relative distance to the threshold among all (of its square, k).
        bound: The largest relative error that the table's entries may have; none may disagree beyond it.
    """

    tests: int = 0
    disagreements: int = 0
    nearest: float = 1.0
    bound: float = 0.0


class Own(NamedTuple):
    """Exact values of the local estimate and confidence, float64 ones, and where they belong."""

    x_hat: Fraction
    alpha: Fraction
    message: Message
    region: str
    place: str


def exact_estimate(n: int, t: int, b_hat: Fraction) -> tuple[Fraction, Fraction]:
    """x_hat (eq. 3) and alpha (eq. 4) for t > 0, the latter cut to the firmware's largest."""
    d = 2 * b_hat - 1
    if abs(d) < Fraction(1, 2**12):
        return Fraction(1, 2), Fraction(0)
    x_hat = min(max((Fraction(n, t) + b_hat - 1) / d, Fraction(0)), Fraction(1))
    if x_hat == 0:
        alpha = d * d * (n / (1 - b_hat) ** 2 + (t - n) / b_hat**2)
    elif x_hat == 1:
        alpha = d * d * (n / b_hat**2 + (t - n) / (1 - b_hat) ** 2)
    else:
        alpha = d * d * Fraction(t**3, n * (t - n))
    return x_hat, min(alpha, _LARGEST_ALPHA)


def exact_b_hat(n: int, t: int, x_bar: Fraction) -> Fraction:
    """b_hat (eq. 8) for t > 0 and x_bar other than 1/2, kept in its range."""
    b_hat = (Fraction(n, t) + x_bar - 1) / (2 * x_bar - 1)
    return min(max(b_hat, _EPSILON), 1 - _EPSILON)


@lru_cache(maxsize=64)
def true_threshold(choice: TableChoice, m: int) -> int:
    """k_m for the omega of a table, in units of 2**-128, from 40 digits."""
    k = true_thresholds(parse_omega(choice.omega)).of_m[m - 2]
    return int(mp.nint(mp.ldexp(k, _THRESHOLD_SCALE)))


@lru_cache(maxsize=64)
def threshold_bound(choice: TableChoice, m: int) -> float:
    """The largest relative error that a table's entry for ``m`` messages may have."""
    table = build_table(choice)
    if m > table.q:
        error = worst_threshold_error(parse_omega(choice.omega), table).beyond_q
        return (1 + error) ** 2 - 1
    unit = 1 << (_THRESHOLD_SCALE - table.fraction_bits)
    return unit / 2 / true_threshold(choice, m)


class Audit:
    """Judges what robots do, and collects how far off they are."""

    def __init__(self) -> None:
        self.deviations: dict[Key, Deviations] = {}
        self.decisions = {"m <= q": Decisions(), "m > q": Decisions()}

    def follow(self, setup: Setup) -> Watcher:
        """A watcher for one scenario's robot."""
        return _Follower(self, setup)

    def add(self, key: Key, exact: Fraction | float, reference: float) -> None:
        """Count errors against both references."""
        deviations = self.deviations.setdefault(key, Deviations())
        deviations.exact.add(float(exact))
        deviations.reference.add(reference)


class _Follower:
    """Follows one robot."""

    def __init__(self, audit: Audit, setup: Setup) -> None:
        self._audit, self._setup = audit, setup
        self._own: Own | None = None

    def __call__(self, call: Call, before: Look, after: Look) -> list[str]:
        if call.name in ("restore", "damage") and after.image != before.image:
            self._own = None  # an estimate that no observation made
        if after.outcome.startswith("ERR"):
            return []
        if call.name in ("observe", "step") and call.numbers[0] < 2:
            self._estimate(before.state["b_hat"], after.state)
        if call.name in ("settle", "step"):
            return [*self._settled(call, before.state, after), *self._informed(after.state)]
        return []

    def _estimate(self, raw: int, state: State) -> None:
        """Compare x_hat and alpha, formed with the b_hat in ``raw``."""
        n, t, b_hat = state["n"], state["t"], Fraction(raw, 2**32)
        x_hat, alpha = exact_estimate(n, t, b_hat)
        guess = local_estimate(n, t, float(b_hat))
        confidence = min(local_confidence(n, t, float(b_hat)), float(_LARGEST_ALPHA))
        region, place = region_of(2 * b_hat - 1), "end" if x_hat in (0, 1) else "inside"
        self._own = Own(x_hat, alpha, Message(guess, confidence), region, place)
        found = Fraction(state["x_hat"], ONE)
        self._audit.add(Key("x_hat", region, place), found - x_hat, float(found) - guess)
        found = Fraction(bits_to_alpha(state["alpha"]))
        if alpha < _COARSE:
            self._audit.add(
                Key("alpha < 1/2", region, place), found - alpha, float(found) - confidence
            )
        else:
            relative = float(found) / confidence - 1
            self._audit.add(Key("alpha", region, place), found / alpha - 1, relative)

    def _informed(self, state: State) -> list[str]:
        """Compare x: to the bit with the rounded own values, by its error with the exact ones."""
        weight, total = closed_sums(state)
        alpha, x_hat = Fraction(bits_to_alpha(state["settled_alpha"])), Fraction(state["settled_x_hat"], ONE)
        problems = [
            *_must_be("x()", state, _floor_mean(alpha * x_hat + total, alpha + weight, state["settled_x_hat"])),
            *_must_be("x_bar()", state, _floor_mean(total, weight, HALF)),
        ]
        own, found = self._own, Fraction(state["x()"], ONE)
        if own is not None:
            sum_of_alpha = own.alpha + weight
            x = (own.alpha * own.x_hat + total) / sum_of_alpha if sum_of_alpha else own.x_hat
            others = [Message(float(total / weight), float(weight))] if weight else []
            reference = informed_estimate(own.message, others)
            self._audit.add(Key("x", own.region, own.place), found - x, float(found) - reference)
        return problems

    def _settled(self, call: Call, before: State, after: Look) -> list[str]:
        """Check whether the filter did what it should, and compare the new b_hat."""
        state = after.state
        updated = (
            after.outcome == "UPDATED"
            or state["b_hat"] != before["b_hat"]
            or state["updates"] != before["updates"]
        )
        if call.name == "step" and before["updates"] == _SATURATED and not updated:
            return []  # an update that left b_hat as it was cannot be seen then
        expected, problems = self._expected_update(call, before, state)
        if updated != expected:
            problems.append(f"b_hat re-estimated: {updated}; by exact arithmetic: {expected}")
        elif updated:
            self._reestimated(state)
        return problems

    def _expected_update(self, call: Call, before: State, state: State) -> tuple[bool, list[str]]:
        """Whether b_hat should have been re-estimated, and whether the table is right about it."""
        setup = self._setup
        due = before["comms_left"] <= (1 if call.name == "step" else 0)
        if not due or before["filter_left"] != setup.comms_period or state["t"] == 0:
            return False, []
        says_something = state["x_bar()"] != HALF
        if setup.filter != Filter.ADAPTIVE:
            return setup.filter == Filter.ALWAYS and says_something, []
        if before["open_count"] < 2:
            return False, []
        rejects, problems = self._decide(before, state["x_hat"])
        return rejects and says_something, problems

    def _decide(self, sums: State, x_hat: int) -> tuple[bool, list[str]]:
        """Eq. 12 with the table's entry, after comparing it with the true threshold."""
        assert self._setup.table is not None
        choice, m = self._setup.table, sums["open_count"]
        table = build_table(choice)
        left = (sums["open_x"] - m * x_hat) ** 2
        spread = m * sums["open_x_squared"] - sums["open_x"] ** 2
        rejects = left << table.fraction_bits > table.entry(m) * spread
        if choice.replaced:
            return rejects, []  # no true threshold belongs to it
        right = true_threshold(choice, m) * spread
        truly, distance = left << _THRESHOLD_SCALE > right, 1.0
        if spread:
            distance = abs((left << _THRESHOLD_SCALE) - right) / right
        bound = threshold_bound(choice, m)
        decisions = self._audit.decisions["m <= q" if m <= table.q else "m > q"]
        decisions.tests += 1
        decisions.disagreements += rejects != truly
        decisions.nearest = min(decisions.nearest, distance)
        decisions.bound = max(decisions.bound, bound)
        if rejects == truly or distance <= bound:
            return rejects, []
        return rejects, [f"m = {m}: the test is {distance:.3g} from the true threshold; bound {bound:.3g}"]

    def _reestimated(self, state: State) -> None:
        """Compare b_hat with eq. 8, of the rounded x_bar and of the round's exact one."""
        n, t = state["n"], state["t"]
        weight, total = closed_sums(state)
        found = Fraction(state["b_hat"], 2**32)
        for quantity, x_bar in (("b_hat", Fraction(state["x_bar()"], ONE)), ("b_hat, exact x_bar", total / weight)):
            reference = assumed_accuracy_update(n, t, float(x_bar))
            if reference is None:
                continue
            b_hat = exact_b_hat(n, t, x_bar)
            place = "end" if b_hat in (_EPSILON, 1 - _EPSILON) else "inside"
            key = Key(quantity, region_of(2 * x_bar - 1), place)
            self._audit.add(key, found - b_hat, float(found) - reference)


def region_of(value: Fraction) -> str:
    """The name of the region that |value| is in."""
    return next(name for end, name in REGIONS if abs(value) < end or end == 1)


def closed_sums(state: State) -> tuple[Fraction, Fraction]:
    """Sum of alpha and sum of alpha x_hat over the last closed round."""
    total = (state["closed_alpha_x_high"] << 32) + state["closed_alpha_x_low"]
    return Fraction(state["closed_alpha"], 2**24), Fraction(total, 2**47)


def _floor_mean(total: Fraction, weight: Fraction, otherwise: int) -> int:
    return int(total * ONE // weight) if weight else otherwise


def _must_be(name: str, state: State, expected: int) -> list[str]:
    return [] if state[name] == expected else [f"{name}: {state[name]}, exactly {expected}"]
