"""Judging the calls of a scenario by exact rationals and by float64, and collecting a robot's errors.

The estimates are computed anew from t, n and b_hat, the social values and the test's decision from the
round's sums, or with the robust filter from the crowd. Values with one right answer must have it to the last
bit; the others must keep the limits of ``exact``, and their errors are collected by region.
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import asdict, dataclass
from fractions import Fraction
from typing import Any

from mcp_asdf.fixed_point import HALF, ONE
from mcp_asdf.reference import assumed_accuracy_update, local_confidence, local_estimate
from mcp_asdf.robot import Filter
from mcp_asdf.table import FRACTION_BITS
from mcp_asdf_tools.crosscheck.compare import Look, State
from mcp_asdf_tools.crosscheck.exact import (
    LARGEST_ALPHA,
    alpha_limits,
    b_hat_error,
    deviates,
    exact_b_hat,
    exact_estimate,
    updates,
    vote_limits,
    x_hat_limits,
)
from mcp_asdf_tools.crosscheck.scenario import Call, Setup

REGIONS = (
    (2.0**-12, "below 2^-12"),
    (0.02, "2^-12 to 0.02"),
    (0.2, "0.02 to 0.2"),
    (0.9, "0.2 to 0.9"),
    (0.999, "0.9 to 0.999"),
    (math.inf, "0.999 to 1"),
)
"""Upper ends of regions: of |2 b_hat - 1|, or for b_hat itself of |2 x_bar - 1|."""

QUANTITIES = ("x_hat", "alpha", "b_hat")
"""Errors of alpha are relative, and those of one below 1/2, which has fewer than 24 bits, are left out."""


@dataclass
class Errors:
    """How many errors were met, and the largest against exact rationals and against float64."""

    samples: int = 0
    exact: float = 0.0
    float64: float = 0.0

    def add(self, exact: Fraction, float64: float) -> None:
        """Count an error. O(1)."""
        self.samples += 1
        self.exact, self.float64 = max(self.exact, abs(float(exact))), max(self.float64, abs(float64))


class Audit:
    """Judges robots and collects their errors.

    Attributes:
        errors: By quantity and region.
        tests: How many hypothesis tests were judged.
        robust: How often the robust filter did what: voted, moving, too few, rejected, returned, kept; and
            undecided, where a test was too close to be judged.
    """

    def __init__(self) -> None:
        self.errors = {(quantity, region): Errors() for quantity in QUANTITIES for _, region in REGIONS}
        self.tests = 0
        self.robust = Counter[str]()

    def judge(self, setup: Setup, call: Call, before: Look, after: Look) -> list[str]:
        """Problems of a call, by the looks before and after it."""
        old, new = before.state, after.state
        problems = [] if new["holds_invariants()"] else ["the invariants do not hold"]
        is_robust = setup.filter == Filter.ROBUST
        problems += _means(new, is_robust)
        if call.name == "receive" and is_robust:
            problems += self._voted(call, old, new, after.outcome == "OK" and call.numbers[2] >> 8 > 0)
        if call.name in ("observe", "step") and not after.outcome.startswith("ERR"):
            problems += self._estimated(old["b_hat()"], new)
        if call.name in ("settle", "step") and not after.outcome.startswith("ERR"):
            settled = self._crowd_settled if is_robust else self._settled
            problems += settled(setup, old, new, after.outcome == "UPDATED")
        return problems

    def _estimated(self, raw: int, state: State) -> list[str]:
        """Compare x_hat and alpha, which were formed with the b_hat ``raw``."""
        n, t, b_hat = state["n"], state["t"], Fraction(raw, 2**32)
        region, (x_hat, alpha) = region_of(2 * b_hat - 1), exact_estimate(n, t, b_hat)
        found, weight = Fraction(state["x_hat"], ONE), Fraction(_units(state["alpha"]), 2**24)
        self.errors["x_hat", region].add(found - x_hat, float(found) - local_estimate(n, t, float(b_hat)))
        if alpha >= Fraction(1, 2):
            confidence = min(local_confidence(n, t, float(b_hat)), float(LARGEST_ALPHA))
            self.errors["alpha", region].add(weight / alpha - 1, float(weight) / confidence - 1)
        x_limits, limits = x_hat_limits(n, t, b_hat), alpha_limits(n, t, b_hat)
        return _within("x_hat", found, *x_limits) + _within("alpha", weight, *limits)

    def _settled(self, setup: Setup, old: State, new: State, is_updated: bool) -> list[str]:
        """Check whether b_hat was re-estimated rightly (eq. 12 and 8), and what to."""
        is_adaptive, m = setup.filter == Filter.ADAPTIVE, old["open_count"]
        rejects = old["filter_left"] == 1 and setup.filter != Filter.OFF
        rejects = rejects and new["t"] > 0 and m >= (2 if is_adaptive else 1)
        if rejects and is_adaptive:
            assert setup.table is not None
            self.tests += 1
            squared = (old["open_x"] - m * new["x_hat"]) ** 2
            spread = m * old["open_x_squared"] - old["open_x"] ** 2
            rejects = squared << FRACTION_BITS > setup.table.build().entry(m) * spread
        x_bar = Fraction(_closed_alpha_x(new), new["closed_alpha"] * ONE) if rejects else Fraction(1, 2)
        expected = updates(x_bar) if rejects else False
        return self._reestimated(new, x_bar, is_updated, expected)

    def _voted(self, call: Call, old: State, new: State, is_vote: bool) -> list[str]:
        """Check what a message did to the robust filter's crowd."""
        if not is_vote:
            moved = [name for name in old if name.startswith("crowd") and new[name] != old[name]]
            return [f"{name} has changed without a vote" for name in moved]
        self.robust["voted"] += 1
        found = _crowd(new)
        limits = vote_limits(new["crowd_votes"], *_crowd(old), Fraction(call.numbers[1], ONE))
        return _within("centre", found[0], *limits[0]) + _within("spread", found[1], *limits[1])

    def _crowd_settled(self, _: Setup, old: State, new: State, is_updated: bool) -> list[str]:
        """Check what the robust filter made of b_hat."""
        if old["filter_left"] != 1 or new["t"] == 0:
            return _wrongly(is_updated, False)
        first, (centre, spread) = old["crowd_first"], _crowd(old)
        is_moving = not 1 / 8 <= old["crowd_trend"] / 2**16 < 7 / 8
        votes = old["crowd_votes"]
        halved = votes // 2 if is_moving and votes >= 2**9 else votes
        problems = _differing(new, {"crowd_votes": halved})
        if is_moving or old["crowd_voices"].bit_count() < 3:
            self.robust["moving" if is_moving else "too few"] += 1
            problems += _differing(new, {"b_hat()": old["b_hat()"], "tests": old["tests"]})
            return problems + _wrongly(is_updated, False)
        self.tests += 1
        rejects = deviates(new["n"], new["t"], Fraction(first, 2**32), centre, spread)
        if rejects is None:
            self.robust["undecided"] += 1
            return problems
        if rejects:
            self.robust["rejected"] += 1
            return problems + self._reestimated(new, centre, is_updated, updates(centre))
        self.robust["returned" if is_updated else "kept"] += 1
        return problems + _differing(new, {"b_hat()": first}) + _wrongly(is_updated, old["b_hat()"] != first)

    def _reestimated(
        self, state: State, x_bar: Fraction, is_updated: bool, expected: bool | None
    ) -> list[str]:
        """Compare b_hat with eq. 8 of the exact x_bar."""
        if not is_updated or expected is False:
            return _wrongly(is_updated, expected)
        n, t, found = state["n"], state["t"], Fraction(state["b_hat()"], 2**32)
        b_hat, limit = exact_b_hat(n, t, x_bar), b_hat_error(x_bar)
        reference = assumed_accuracy_update(n, t, float(x_bar))
        if reference is not None:
            errors = self.errors["b_hat", region_of(2 * x_bar - 1)]
            errors.add(found - b_hat, float(found) - reference)
        return _within("b_hat", found, b_hat - limit, b_hat + limit)

    def as_dict(self) -> dict[str, Any]:
        """Everything collected, as plain data."""
        rows = (
            {"quantity": quantity, "region": region} | asdict(errors)
            for (quantity, region), errors in self.errors.items()
        )
        return {
            "errors": [row for row in rows if row["samples"]],
            "tests": self.tests,
            "robust": dict(self.robust),
        }


def region_of(value: Fraction) -> str:
    """The name of the region that |value| is in."""
    return next(name for end, name in REGIONS if abs(value) < end)


def _units(word: int) -> int:
    """The value of an alpha word in units of 2**-24: mantissa 2**shift."""
    return (word >> 8) << word % 32


def _closed_alpha_x(state: State) -> int:
    return (state["closed_alpha_x_high"] << 32) + state["closed_alpha_x_low"]


def _crowd(state: State) -> tuple[Fraction, Fraction]:
    """Centre and spread of the robust filter."""
    return Fraction(state["crowd_centre"], 2**30), Fraction(state["crowd_spread"], 2**30)


def _wrongly(is_updated: bool, expected: bool | None) -> list[str]:
    if expected in (None, is_updated):
        return []
    return [f"b_hat is {'' if is_updated else 'not '}re-estimated, wrongly"]


def _means(state: State, is_robust: bool) -> list[str]:
    """Check x_bar and x, which are exact but for their last bit, rounded down."""
    if is_robust:
        centre, is_heard = int(_crowd(state)[0] * ONE), state["crowd_votes"] > 0
        x, x_bar = (centre, centre) if is_heard else (state["x_hat"], HALF)
        return _differing(state, {"x()": x, "x_bar()": x_bar, "beta()": 0})
    weight, total = state["closed_alpha"], _closed_alpha_x(state)
    alpha, x_hat = _units(state["alpha"]), state["x_hat"]
    x = (alpha * x_hat + total) // (alpha + weight) if alpha + weight else x_hat
    return _differing(state, {"x()": x, "x_bar()": total // weight if weight else HALF})


def _differing(state: State, expected: State) -> list[str]:
    """Values with one right answer that are others."""
    wrong = {name: value for name, value in expected.items() if state[name] != value}
    return [f"{name} is {state[name]}, exactly {value}" for name, value in wrong.items()]


def _within(name: str, found: Fraction, least: Fraction, most: Fraction) -> list[str]:
    if least <= found <= most:
        return []
    return [f"{name} is {float(found):.9g}, outside {float(least):.9g} to {float(most):.9g}"]
