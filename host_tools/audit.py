"""Judging what a robot did in a scenario, by exact rationals and by float64, and collecting its errors.

Everything is computed anew from what the robot knew before a call: the estimates from t, n and b_hat, the
social values from the round's exact sums, the test's decision from those sums and the true threshold.
What has one right answer to the last bit must have it; the rest must keep the limits of ``exact``, and
its errors are collected by region.
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import asdict, dataclass, field
from fractions import Fraction
from typing import Any, NamedTuple

from firmware_py import fixed_point
from firmware_py.fixed_point import ONE, bits_to_alpha
from firmware_py.reference import (
    Message,
    assumed_accuracy_update,
    informed_estimate,
    local_confidence,
    local_estimate,
)
from firmware_py.robot import Filter
from host_tools.crosscheck import Look, State, Watcher
from host_tools.exact import (
    B_HAT_LIMIT,
    EPSILON,
    HALF,
    LARGEST_ALPHA,
    LATE,
    THRESHOLD_SCALE,
    alpha_limit,
    exact_b_hat,
    exact_estimate,
    threshold_limit,
    true_threshold,
    x_hat_limit,
)
from host_tools.scenarios import Call, Setup, build_table

REGIONS = (
    (2.0**-12, "below 2^-12"),
    (0.02, "2^-12 to 0.02"),
    (0.2, "0.02 to 0.2"),
    (0.9, "0.2 to 0.9"),
    (0.999, "0.9 to 0.999"),
    (math.inf, "0.999 to 1"),
)
"""Upper ends of regions: of |2 b_hat - 1|, or for b_hat itself of |2 x_bar - 1|."""

QUANTITIES = ("x_hat", "alpha", "small alpha", "x", "b_hat", "b_hat, x_bar exact")
PLACES = ("inside", "end", "late")
"""Inside the scale, clamped to one of its ends, or either with t of 2**31 or more."""

_COARSE = Fraction(1, 2)
"""An alpha below has fewer than 24 significant bits; its error is given in units of its grid, 2**-24."""
_SATURATED = 0xFFFF
_BINS_PER_OCTAVE = 16


@dataclass
class Errors:
    """Sizes of errors in bounded memory: the largest is exact, the others are in bins of 4.4 %."""

    count: int = 0
    largest: float = 0.0
    _bins: Counter[int] = field(default_factory=Counter)

    def add(self, error: float) -> None:
        """Count an error. O(1)."""
        size = abs(error)
        self.count += 1
        self.largest = max(self.largest, size)
        if size > 0:
            self._bins[math.floor(_BINS_PER_OCTAVE * math.log2(size))] += 1

    @property
    def percentile(self) -> float:
        """The 99.9 percentile, rounded up by less than 4.5 %."""
        outside = self.count // 1000
        for index in sorted(self._bins, reverse=True):
            outside -= self._bins[index]
            if outside < 0:
                return min(math.exp2((index + 1) / _BINS_PER_OCTAVE), self.largest)
        return 0.0


class Key(NamedTuple):
    """What errors are about: indices into QUANTITIES, REGIONS and PLACES, so that keys sort."""

    quantity: int
    region: int
    place: int


@dataclass
class Decisions:
    """Hypothesis tests, compared with exact arithmetic and the true threshold.

    Attributes:
        tests: How many ran.
        disagreements: How many went the other way.
        nearest: The smallest relative distance to the threshold (of its square) among all tests.
        limit: The largest relative error of an entry that was used; no disagreement is further away.
    """

    tests: int = 0
    disagreements: int = 0
    nearest: float = math.inf
    limit: float = 0.0

    def count(self, agrees: bool, distance: float, limit: float) -> None:
        """Count a test."""
        self.tests += 1
        self.disagreements += not agrees
        self.nearest, self.limit = min(self.nearest, distance), max(self.limit, limit)


class Audit:
    """Judges robots and collects how far off they are.

    Attributes:
        errors: Against exact rationals and against float64.
        decisions: Tests on rounds whose m has an entry of its own, and on larger ones.
    """

    def __init__(self) -> None:
        self.errors: dict[Key, tuple[Errors, Errors]] = {}
        self.decisions = {"m <= q": Decisions(), "m > q": Decisions()}

    def follow(self, setup: Setup) -> Watcher:
        """A watcher for one scenario's robot."""
        return _Follower(self, setup)

    def add(self, key: Key, exact: Fraction, reference: float) -> None:
        """Count an error against exact rationals, and the same against float64."""
        against_exact, against_float = self.errors.setdefault(key, (Errors(), Errors()))
        against_exact.add(float(exact))
        against_float.add(reference)

    def as_dict(self) -> dict[str, Any]:
        """Everything collected, as plain data."""
        return {
            "errors": [_row(key, *self.errors[key]) for key in sorted(self.errors)],
            "decisions": {kind: asdict(tally) for kind, tally in self.decisions.items() if tally.tests},
        }


def _row(key: Key, exact: Errors, reference: Errors) -> dict[str, Any]:
    return {
        "quantity": QUANTITIES[key.quantity],
        "region": REGIONS[key.region][1],
        "place": PLACES[key.place],
        "samples": exact.count,
        "exact": {"max": exact.largest, "p99.9": exact.percentile},
        "float64": {"max": reference.largest, "p99.9": reference.percentile},
    }


class _Own(NamedTuple):
    """The exact local estimate and confidence, the float64 ones, and where they belong."""

    x_hat: Fraction
    alpha: Fraction
    message: Message
    region: int
    place: int


class _Follower:
    """Follows one robot through a scenario."""

    def __init__(self, audit: Audit, setup: Setup) -> None:
        self._audit, self._setup = audit, setup
        self._own: _Own | None = None

    def __call__(self, call: Call, before: Look, after: Look) -> list[str]:
        if call.name in ("restore", "damage") and after.image != before.image:
            self._own = None  # x_hat and alpha may now be what no observation gives
        problems = [] if after.state["holds_invariants()"] else ["the invariants do not hold"]
        if after.outcome.startswith("ERR"):
            return problems
        if call.name in ("observe", "step") and call.numbers[0] < 2:
            problems += self._counted(call.numbers[0], before.state, after.state)
            problems += self._estimated(before.state["b_hat"], after.state)
        if call.name in ("settle", "step"):
            problems += self._informed(after.state) + self._settled(call, before.state, after)
        return problems

    def _counted(self, black: int, before: State, state: State) -> list[str]:
        """Check t and n, which are halved when t reaches the memory."""
        t, n = before["t"] + 1, before["n"] + black
        if t == self._setup.memory:
            t, n = t // 2, round(Fraction(n, 2))  # round() takes ties to even
        return _equal("t", state["t"], t) + _equal("n", state["n"], n)

    def _estimated(self, raw: int, state: State) -> list[str]:
        """Compare x_hat and alpha, which were formed with the b_hat ``raw``."""
        n, t, b_hat = state["n"], state["t"], Fraction(raw, 2**32)
        x_hat, alpha = exact_estimate(n, t, b_hat)
        guess = local_estimate(n, t, float(b_hat))
        confidence = min(local_confidence(n, t, float(b_hat)), float(LARGEST_ALPHA))
        place = 2 if t >= LATE else int(x_hat in (0, 1))
        own = self._own = _Own(x_hat, alpha, Message(guess, confidence), region_of(2 * b_hat - 1), place)

        found = Fraction(state["x_hat"], ONE)
        self._add("x_hat", own, found - x_hat, float(found) - guess)
        problems = _within("x_hat", found - x_hat, x_hat_limit(b_hat))
        found = Fraction(bits_to_alpha(state["alpha"]))
        if alpha < _COARSE:
            self._add("small alpha", own, (found - alpha) * 2**24, (float(found) - confidence) * 2**24)
        else:
            self._add("alpha", own, found / alpha - 1, float(found) / confidence - 1)
        return problems + _within("alpha", found - alpha, alpha_limit(n, t, b_hat, alpha))

    def _informed(self, state: State) -> list[str]:
        """Compare x_bar and x, which are exact but for their last bit, and x with one of exact own values."""
        weight, total = closed_sums(state)
        alpha, x_hat = Fraction(bits_to_alpha(state["settled_alpha"])), Fraction(state["settled_x_hat"], ONE)
        x = _floor_mean(alpha * x_hat + total, alpha + weight, otherwise=state["settled_x_hat"])
        x_bar = _floor_mean(total, weight, otherwise=fixed_point.HALF)
        own, found = self._own, Fraction(state["x()"], ONE)
        if own is not None:
            exact = (
                (own.alpha * own.x_hat + total) / (own.alpha + weight) if own.alpha + weight else own.x_hat
            )
            others = [Message(float(total / weight), float(weight))] if weight else []
            self._add("x", own, found - exact, float(found) - informed_estimate(own.message, others))
        return _equal("x()", state["x()"], x) + _equal("x_bar()", state["x_bar()"], x_bar)

    def _add(self, quantity: str, own: _Own, exact: Fraction, reference: float) -> None:
        self._audit.add(Key(QUANTITIES.index(quantity), own.region, own.place), exact, reference)

    def _settled(self, call: Call, before: State, after: Look) -> list[str]:
        """Check whether the filter did what it should, and compare the new b_hat."""
        state = after.state
        problems: list[str] = []
        updated = (
            after.outcome == "UPDATED"
            or state["b_hat"] != before["b_hat"]
            or state["updates"] != before["updates"]
        )
        rejects = self._filter_acts(call, before, state["t"])
        if rejects and self._setup.filter == Filter.ADAPTIVE:
            rejects, problems = self._decide(before, state["x_hat"])
        expected = rejects and state["x_bar()"] != fixed_point.HALF
        if updated:
            problems += self._reestimated(state) if expected else ["b_hat is re-estimated, wrongly"]
        elif expected and not (call.name == "step" and state["updates"] == _SATURATED):
            problems.append("b_hat is not re-estimated, wrongly")
        return problems

    def _filter_acts(self, call: Call, before: State, t: int) -> bool:
        """Whether a round closes that ends a filtering period, and there is something to go by."""
        closes = before["comms_left"] <= (1 if call.name == "step" else 0)
        ends = before["filter_left"] == self._setup.comms_period
        least = 2 if self._setup.filter == Filter.ADAPTIVE else 0
        enough = t > 0 and before["open_count"] >= least
        return closes and ends and enough and self._setup.filter != Filter.OFF

    def _decide(self, sums: State, x_hat: int) -> tuple[bool, list[str]]:
        """Eq. 12 with the table's entry; a problem if the true threshold decides otherwise without excuse."""
        assert self._setup.table is not None
        choice, m = self._setup.table, sums["open_count"]
        table = build_table(choice)
        left = (sums["open_x"] - m * x_hat) ** 2
        spread = m * sums["open_x_squared"] - sums["open_x"] ** 2
        rejects = left << table.fraction_bits > table.entry(m) * spread
        if choice.replaced:  # no omega belongs to such a table
            return rejects, []
        left, right, limit = (
            left << THRESHOLD_SCALE,
            true_threshold(choice, m) * spread,
            threshold_limit(choice, m),
        )
        distance = abs(left - right) / right if right else math.inf
        agrees = rejects == (left > right)
        self._audit.decisions["m <= q" if m <= table.q else "m > q"].count(agrees, distance, limit)
        if agrees or distance <= limit:
            return rejects, []
        problem = f"the true threshold, {distance:.3g} away (limit {limit:.3g}), decides otherwise"
        return rejects, [f"test with m = {m}: {problem}"]

    def _reestimated(self, state: State) -> list[str]:
        """Compare b_hat with eq. 8 of the x_bar that the firmware has rounded, and of the exact one."""
        n, t = state["n"], state["t"]
        weight, total = closed_sums(state)
        found, rounded = Fraction(state["b_hat"], 2**32), Fraction(state["x_bar()"], ONE)
        for quantity, x_bar in (("b_hat", rounded), ("b_hat, x_bar exact", total / weight)):
            reference = assumed_accuracy_update(n, t, float(x_bar))
            if x_bar == HALF or reference is None:
                continue
            b_hat = exact_b_hat(n, t, x_bar)
            place = int(b_hat in (EPSILON, 1 - EPSILON))
            key = Key(QUANTITIES.index(quantity), region_of(2 * x_bar - 1), place)
            self._audit.add(key, found - b_hat, float(found) - reference)
        error = found - exact_b_hat(n, t, rounded)
        return _within("b_hat", error + B_HAT_LIMIT / 2, B_HAT_LIMIT / 2)


def region_of(value: Fraction) -> int:
    """The index of the region that |value| is in."""
    return next(index for index, (end, _) in enumerate(REGIONS) if abs(value) < end)


def closed_sums(state: State) -> tuple[Fraction, Fraction]:
    """The sums of alpha and of alpha x_hat over the last closed round."""
    total = (state["closed_alpha_x_high"] << 32) + state["closed_alpha_x_low"]
    return Fraction(state["closed_alpha"], 2**24), Fraction(total, 2**47)


def _floor_mean(total: Fraction, weight: Fraction, otherwise: int) -> int:
    return total * ONE // weight if weight else otherwise


def _equal(name: str, found: int, expected: int) -> list[str]:
    return [] if found == expected else [f"{name} is {found}, exactly {expected}"]


def _within(name: str, error: Fraction, limit: Fraction) -> list[str]:
    if abs(error) <= limit:
        return []
    return [f"{name} is off by {float(error):.4g}, limit {float(limit):.4g}"]
