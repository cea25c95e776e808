"""Judging the calls of a scenario by exact rationals and by float64, and collecting a robot's errors.

Everything is computed anew from the robot's state before a call: the sums from the message, the estimates
from t, n and b_hat, the social values from the round's exact sums, the test's decision from those sums and
the true threshold. Values with one right answer must have it to the last bit; the others must keep the limits
of ``exact``, and their errors are collected by region.
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import asdict, dataclass, field
from fractions import Fraction
from typing import Any, NamedTuple

from mcp_asdf.fixed_point import HALF, ONE
from mcp_asdf.reference import (
    Message,
    assumed_accuracy_update,
    informed_estimate,
    local_confidence,
    local_estimate,
)
from mcp_asdf.robot import Filter, Sums
from mcp_asdf.table import FRACTION_BITS
from mcp_asdf_tools.crosscheck.compare import Look, State, Watcher
from mcp_asdf_tools.crosscheck.exact import (
    EPSILON,
    LARGEST_ALPHA,
    THRESHOLD_SCALE,
    alpha_limit,
    b_hat_limit,
    exact_b_hat,
    exact_estimate,
    threshold_limit,
    true_threshold,
    updates,
    x_hat_limit,
)
from mcp_asdf_tools.crosscheck.scenario import Call, Setup, build_table

REGIONS = (
    (2.0**-12, "below 2^-12"),
    (0.02, "2^-12 to 0.02"),
    (0.2, "0.02 to 0.2"),
    (0.9, "0.2 to 0.9"),
    (0.999, "0.9 to 0.999"),
    (math.inf, "0.999 to 1"),
)
"""Upper ends of regions: of |2 b_hat - 1|, or for b_hat itself of |2 x_bar - 1|."""

QUANTITIES = ("x_hat", "alpha", "small alpha", "x", "b_hat")
PLACES = ("inside", "end")
"""Inside the scale, or clamped to one of its ends."""

_COARSE = Fraction(1, 2)
"""An alpha below has fewer than 24 significant bits; its error is given in units of its grid, 2**-24."""
_COUNTER_MASK = 0xFFFF
_HEARD = ("accepted", "repeated", "rejected")
_ESTIMATE = ("t", "n", "x_hat", "alpha")
_OPEN = (
    *("open_alpha", "open_alpha_x_low", "open_alpha_x_high", "open_x_squared", "open_x", "open_count"),
    *("heard_0", "heard_1", "heard_2", "heard_3"),
)
_CLOSED = ("closed_alpha", "closed_alpha_x_low", "closed_alpha_x_high")
_KEPT = {
    "observe": ("id", *_HEARD, *_OPEN, *_CLOSED, "filter_left", "accuracy_b_hat", "tests", "updates"),
    "settle": ("id", *_HEARD, *_ESTIMATE),
    "step": ("id", *_HEARD),
}
"""Words that a call leaves as they are."""
_READ = {
    **{f"{name}()": name for name in (*_ESTIMATE, *_HEARD, "tests", "updates")},
    **{"b_hat()": "accuracy_b_hat", "beta()": "closed_alpha"},
}
"""The word that each function reads."""
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
    """The kind of an error: indices into QUANTITIES, REGIONS and PLACES, so that keys sort."""

    quantity: int
    region: int
    place: int


@dataclass
class Decisions:
    """Hypothesis tests, compared with exact arithmetic and the true threshold.

    Attributes:
        tests: Their number.
        disagreements: Number of those with the other result.
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
    """Judges robots and collects their errors.

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
        old, new = before.state, after.state
        if call.name in ("restore", "damage") and after.image != before.image:
            self._own = None  # x_hat and alpha may now be what no observation gives
        problems = [] if new["holds_invariants()"] else ["the invariants do not hold"]
        problems += _means(new) + _same({name: new[word] for name, word in _READ.items()}, new)
        if call.name == "receive":
            return problems + self._received(call, before, after)
        if after.outcome.startswith("ERR"):
            return problems + _same(old, new)
        if call.name in _KEPT:
            problems += _kept(call, before, after)
        if call.name in ("observe", "step"):
            problems += self._counted(call.numbers[0], old, new) or self._estimated(old["b_hat()"], new)
        if call.name in ("settle", "step"):
            problems += self._settled(before, after)
            self._compare_x(new)
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
        message, region = Message(guess, confidence), region_of(2 * b_hat - 1)
        own = self._own = _Own(x_hat, alpha, message, region, int(x_hat in (0, 1)))

        found = Fraction(state["x_hat"], ONE)
        self._add("x_hat", own, found - x_hat, float(found) - guess)
        problems = _within("x_hat", found - x_hat, x_hat_limit(b_hat))
        found = _alpha(state["alpha"])
        if alpha < _COARSE:
            self._add("small alpha", own, (found - alpha) * 2**24, (float(found) - confidence) * 2**24)
        else:
            self._add("alpha", own, found / alpha - 1, float(found) / confidence - 1)
        return problems + _within("alpha", found - alpha, alpha_limit(n, t, b_hat, alpha))

    def _received(self, call: Call, before: Look, after: Look) -> list[str]:
        """Check the outcome of a message, and the sums, counters and senders that it leaves."""
        (sender, x_hat, alpha), old = call.numbers, before.state
        outcome = _outcome(sender, x_hat, old)
        counter = {"OK": "accepted", "REPEATED": "repeated"}.get(outcome, "rejected")
        expected = dict(old)
        for name in (counter, f"{counter}()"):
            expected[name] = old[name] + 1 & _COUNTER_MASK
        if outcome == "OK":
            expected[f"heard_{sender >> 5}"] |= 1 << (sender & 31)
            for name, value in vars(_message(x_hat, alpha)).items():
                expected[f"open_{name}"] += value
        problems = [] if after.outcome == outcome else [f"receive gives {after.outcome}, not {outcome}"]
        return problems + _same(expected, after.state)

    def _compare_x(self, state: State) -> None:
        """Collect the error of x against an x of the exact own values."""
        weight, total = closed_sums(state)
        own, found = self._own, Fraction(state["x()"], ONE)
        if own is None:
            return
        exact = (own.alpha * own.x_hat + total) / (own.alpha + weight) if own.alpha + weight else own.x_hat
        others = [Message(float(total / weight), float(weight))] if weight else []
        self._add("x", own, found - exact, float(found) - informed_estimate(own.message, others))

    def _add(self, quantity: str, own: _Own, exact: Fraction, reference: float) -> None:
        self._audit.add(Key(QUANTITIES.index(quantity), own.region, own.place), exact, reference)

    def _settled(self, before: Look, after: Look) -> list[str]:
        """Check what closing a round leaves, whether the filter acted rightly, and the new b_hat."""
        old, new = before.state, after.state
        problems: list[str] = []
        for name in _CLOSED:
            problems += _equal(name, new[name], old[name.replace("closed", "open")])
        problems += _same(dict.fromkeys(_OPEN, 0), new)
        runs = old["filter_left"] == 1
        left = self._setup.filter_period if runs else old["filter_left"] - 1
        problems += _equal("filter_left", new["filter_left"], left)
        tested = runs and self._filter_acts(old, new["t"])
        rejects = tested
        if self._setup.filter == Filter.ADAPTIVE:
            problems += _equal("tests", new["tests"], old["tests"] + tested & _COUNTER_MASK)
            if tested:
                rejects, excuse = self._decide(old, new["x_hat"])
                problems += excuse
        return problems + self._updated(rejects, before, after)

    def _filter_acts(self, sums: State, t: int) -> bool:
        """True if the round gives the filter enough to go by."""
        least = 2 if self._setup.filter == Filter.ADAPTIVE else 1
        return t > 0 and sums["open_count"] >= least and self._setup.filter != Filter.OFF

    def _updated(self, rejects: bool, before: Look, after: Look) -> list[str]:
        """Check whether b_hat was re-estimated, if the test ``rejects``, and how."""
        old, new = before.state, after.state
        updated = after.outcome == "UPDATED"
        problems = _equal("updates", new["updates"], old["updates"] + updated & _COUNTER_MASK)
        if not updated:
            problems += _equal("b_hat", new["b_hat()"], old["b_hat()"])
        weight, total = closed_sums(new)
        expected = updates(total / weight) if rejects else False
        if expected is not None and updated != expected:
            problems.append(f"b_hat is {'' if updated else 'not '}re-estimated, wrongly")
        elif updated:
            problems += self._reestimated(new, total / weight)
        return problems

    def _decide(self, sums: State, x_hat: int) -> tuple[bool, list[str]]:
        """Eq. 12 with the table's entry; a problem if the true threshold decides otherwise without excuse."""
        assert self._setup.table is not None
        choice, m = self._setup.table, sums["open_count"]
        table = build_table(choice)
        left = (sums["open_x"] - m * x_hat) ** 2
        spread = m * sums["open_x_squared"] - sums["open_x"] ** 2
        rejects = left << FRACTION_BITS > table.entry(m) * spread
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

    def _reestimated(self, state: State, x_bar: Fraction) -> list[str]:
        """Compare b_hat with eq. 8 of the exact x_bar."""
        n, t, found = state["n"], state["t"], Fraction(state["b_hat()"], 2**32)
        b_hat = exact_b_hat(n, t, x_bar)
        reference = assumed_accuracy_update(n, t, float(x_bar))
        if reference is not None:
            place = int(b_hat in (EPSILON, 1 - EPSILON))
            key = Key(QUANTITIES.index("b_hat"), region_of(2 * x_bar - 1), place)
            self._audit.add(key, found - b_hat, float(found) - reference)
        return _within("b_hat", found - b_hat, b_hat_limit(x_bar))


def region_of(value: Fraction) -> int:
    """The index of the region that |value| is in."""
    return next(index for index, (end, _) in enumerate(REGIONS) if abs(value) < end)


def closed_sums(state: State) -> tuple[Fraction, Fraction]:
    """The sums of alpha and of alpha x_hat over the last closed round."""
    return Fraction(state["closed_alpha"], 2**24), Fraction(_closed_alpha_x(state), 2**47)


def _closed_alpha_x(state: State) -> int:
    return (state["closed_alpha_x_high"] << 32) + state["closed_alpha_x_low"]


def _units(word: int) -> int:
    """The value of an alpha word in units of 2**-24: mantissa 2**shift."""
    return (word >> 8) << word % 32


def _alpha(word: int) -> Fraction:
    return Fraction(_units(word), 2**24)


def _outcome(sender: int, x_hat: int, state: State) -> str:
    """The outcome of a message."""
    if sender > 127 or sender == state["id"]:
        return "ERR_SENDER"
    if x_hat > ONE:
        return "ERR_X_HAT"
    return "REPEATED" if state[f"heard_{sender >> 5}"] >> (sender & 31) & 1 else "OK"


def _message(x_hat: int, alpha: int) -> Sums:
    """The sums of one message."""
    units = _units(alpha)
    if units == 0:
        return Sums()
    high, low = divmod(units, 2**32)
    return Sums(units, low * x_hat, high * x_hat, x_hat**2, x_hat, 1)


def _means(state: State) -> list[str]:
    """Check x_bar and x, which are exact but for their last bit."""
    weight, total = state["closed_alpha"], _closed_alpha_x(state)
    alpha, x_hat = _units(state["alpha"]), state["x_hat"]
    x = (alpha * x_hat + total) // (alpha + weight) if alpha + weight else x_hat
    x_bar = total // weight if weight else HALF
    return _equal("x()", state["x()"], x) + _equal("x_bar()", state["x_bar()"], x_bar)


def _kept(call: Call, before: Look, after: Look) -> list[str]:
    """Check the words that a call leaves alone, and the note that b_hat is newer than x_hat and alpha."""
    old, is_newer = before.state, after.outcome == "UPDATED"
    if call.name == "settle":
        is_newer |= old["updated"] == 1
    return _same({name: old[name] for name in _KEPT[call.name]} | {"updated": int(is_newer)}, after.state)


def _equal(name: str, found: int, expected: int) -> list[str]:
    return [] if found == expected else [f"{name} is {found}, exactly {expected}"]


def _same(expected: State, state: State) -> list[str]:
    return [problem for name, value in expected.items() for problem in _equal(name, state[name], value)]


def _within(name: str, error: Fraction, limit: Fraction) -> list[str]:
    if abs(error) <= limit:
        return []
    return [f"{name} is off by {float(error):.4g}, limit {float(limit):.4g}"]
