"""Check the calls of a scenario against the paper's equations, in exact fractions, and collect errors.

x_hat and alpha are computed anew from t, n and b_hat; the social values, the test and b_hat from the sums of
the round. Values that have one right result must have it to the last bit. The others must keep the bounds of
``bounds``; their errors, also against float64, are collected by region. ``robust_oracle`` checks what is the
robust filter's alone.
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import asdict, dataclass, replace
from fractions import Fraction
from typing import Any

from mcp_asdf.fixed_point import HALF, ONE
from mcp_asdf.reference import (
    COUNTER_MODULUS,
    PAPER,
    assumed_accuracy_update,
    local_confidence,
    local_estimate,
)
from mcp_asdf.robot import Filter
from mcp_asdf.table import FRACTION_BITS
from mcp_asdf_tools.crosscheck.bounds import (
    LARGEST_ALPHA,
    alpha_bounds,
    b_hat_error,
    exact_alpha,
    is_update_expected,
    x_hat_bounds,
)
from mcp_asdf_tools.crosscheck.checks import check_bounds, check_exact, check_update, is_filter_run
from mcp_asdf_tools.crosscheck.compare import CallResult, State
from mcp_asdf_tools.crosscheck.robust_oracle import Decision, check_memory, expected_filter_run
from mcp_asdf_tools.crosscheck.scenario import Call, Setup

REGIONS = (
    (2.0**-12, "below 2^-12"),
    (0.02, "2^-12 to 0.02"),
    (0.2, "0.02 to 0.2"),
    (0.9, "0.2 to 0.9"),
    (0.999, "0.9 to 0.999"),
    (math.inf, "0.999 to 1"),
)
"""Upper ends and names of regions: of |2 b_hat - 1|, or for errors of b_hat of |2 x_bar - 1|."""

QUANTITIES = ("x_hat", "alpha", "b_hat")
"""Quantities whose errors are collected. Errors of alpha are relative, and left out for an alpha below 1/2,
which has fewer than 24 bits."""

UNGUARDED = replace(PAPER, guarded=False)
"""Eq. 8 also for an x_bar that carries no information: rounding may give the firmware one that does."""


@dataclass
class Errors:
    """Number of errors, and the largest one against exact fractions and against float64."""

    samples: int = 0
    exact: float = 0.0
    float64: float = 0.0

    def add(self, exact_error: Fraction, float64_error: float) -> None:
        """Add the error of one value. O(1)."""
        self.samples += 1
        self.exact = max(self.exact, abs(float(exact_error)))
        self.float64 = max(self.float64, abs(float64_error))


class Audit:
    """Checks calls of robots, and collects the errors of their results.

    Attributes:
        errors: Errors by quantity and region.
        tests: Number of hypothesis tests that were checked.
        robust: How often each of these happened to a robot with the robust filter:
            vote, own vote: An estimate in a slot was a vote, or the robot's own estimate.
            too few, accepted, supported, rejected, undecided: What its filter had to decide; see `Decision`.
            returned: b_hat became the initial one again.
    """

    def __init__(self) -> None:
        self.errors = {(quantity, region): Errors() for quantity in QUANTITIES for _, region in REGIONS}
        self.tests = 0
        self.robust = Counter[str]()

    def check_call(self, setup: Setup, call: Call, before: CallResult, after: CallResult) -> list[str]:
        """Check a call by the states before and after it, and return a line for each problem.

        After every call the invariants, x_bar and x are checked, and what the robust filter remembers; after
        an observation x_hat and alpha; and after the end of a round what the filter has done to b_hat. Errors
        of results, and events of the robust filter, are added to the attributes.
        """
        old_state, new_state = before.state, after.state
        is_robust = setup.filter == Filter.ROBUST
        is_error = after.outcome.startswith("ERR")
        problems = [] if new_state["holds_invariants()"] else ["the invariants do not hold"]
        problems += _check_means(new_state, is_robust)
        if is_robust:
            problems += check_memory(call, before, after, self.robust)
        if call.name in ("observe", "step") and not is_error:
            problems += self._check_estimate(old_state["b_hat()"], new_state)
        if call.name in ("settle", "step") and not is_error:
            check_filter = self._check_robust_filter if is_robust else self._check_asdf_filter
            problems += check_filter(setup, old_state, new_state, after.outcome == "UPDATED")
        return problems

    def _check_estimate(self, units_of_b_hat: int, state: State) -> list[str]:
        """Collect the errors of x_hat and alpha after an observation, and return a line for each wrong one.

        ``units_of_b_hat`` is b_hat, the accuracy with which they were computed, in units of 2**-32.
        """
        n, t = state["n"], state["t"]
        b_hat = Fraction(units_of_b_hat, 2**32)
        x_hat = Fraction(state["x_hat"], ONE)
        alpha = Fraction(_alpha_units(state["alpha"]), 2**24)
        region = region_of(2 * b_hat - 1)

        # Against float64, too, with which users compare the firmware.
        exact_error = x_hat - local_estimate(n, t, b_hat)
        self.errors["x_hat", region].add(exact_error, float(x_hat) - local_estimate(n, t, float(b_hat)))
        exact = exact_alpha(n, t, b_hat)
        if exact >= Fraction(1, 2):
            float64_alpha = min(local_confidence(n, t, float(b_hat)), float(LARGEST_ALPHA))
            self.errors["alpha", region].add(alpha / exact - 1, float(alpha) / float64_alpha - 1)
        problems = check_bounds("x_hat", x_hat, x_hat_bounds(n, t, b_hat))
        return problems + check_bounds("alpha", alpha, alpha_bounds(n, t, b_hat))

    def _check_asdf_filter(
        self, setup: Setup, old_state: State, new_state: State, is_updated: bool
    ) -> list[str]:
        """Return a line for each problem of the paper's filter at the end of a round.

        It must have re-estimated b_hat if its test (eq. 12) rejects, and not otherwise, and the result must
        be right (eq. 8).
        """
        m = old_state["open_count"]
        is_adaptive = setup.filter == Filter.ADAPTIVE
        is_run = setup.filter != Filter.OFF and is_filter_run(old_state, new_state)
        # The test needs a variance, and so two messages.
        messages_needed = 2 if is_adaptive else 1
        if not is_run or m < messages_needed:
            return check_update(is_updated, expected=False)
        if is_adaptive:
            assert setup.table is not None
            self.tests += 1
            # Eq. 12 squared and multiplied out, which whole numbers decide exactly. Equality is no rejection.
            difference_squared = (old_state["open_x"] - m * new_state["x_hat"]) ** 2
            scaled_variance = m * old_state["open_x_squared"] - old_state["open_x"] ** 2
            # The threshold has FRACTION_BITS bits after the point, so the other side gets as many.
            threshold = setup.table.build().entry(m)
            scaled_difference_squared = difference_squared << FRACTION_BITS
            is_rejected = scaled_difference_squared > threshold * scaled_variance
            if not is_rejected:
                return check_update(is_updated, expected=False)
        x_bar = Fraction(_closed_alpha_x(new_state), new_state["closed_alpha"] * ONE)
        return self._check_b_hat(new_state, x_bar, is_updated)

    def _check_robust_filter(
        self, _: Setup, old_state: State, new_state: State, is_updated: bool
    ) -> list[str]:
        """Return a line for each problem of the robust filter at the end of a round.

        It must have changed b_hat if, and only if, what it decides in this state takes that; and the result
        must be right. ``Audit.robust`` counts what was decided. The setup is not needed.
        """
        if not is_filter_run(old_state, new_state):
            return _check_no_test(old_state, new_state, is_updated)
        run = expected_filter_run(new_state)
        self.robust[run.decision.value] += 1
        if run.decision is Decision.TOO_FEW:
            return _check_no_test(old_state, new_state, is_updated)
        self.tests += 1
        problems = check_exact(new_state, {"tests": (old_state["tests"] + 1) % COUNTER_MODULUS})
        if run.decision is Decision.UNDECIDED:
            return problems
        if run.decision is Decision.REJECTED:
            assert run.centre is not None
            return problems + self._check_b_hat(new_state, run.centre, is_updated)
        initial_b_hat = new_state["robust_initial_b_hat"]
        is_return = old_state["b_hat()"] != initial_b_hat
        if is_return:
            self.robust["returned"] += 1
        problems += check_exact(new_state, {"b_hat()": initial_b_hat})
        return problems + check_update(is_updated, expected=is_return)

    def _check_b_hat(self, state: State, x_bar: Fraction, is_updated: bool) -> list[str]:
        """Return a line if b_hat is wrong after the filter had to re-estimate it from this exact x_bar.

        The filter must also have kept b_hat where x_bar carries no information. The error of b_hat is
        collected.
        """
        is_expected = is_update_expected(x_bar)
        if not is_updated or is_expected is False:
            return check_update(is_updated, is_expected)
        n, t = state["n"], state["t"]
        b_hat = Fraction(state["b_hat()"], 2**32)
        exact = assumed_accuracy_update(n, t, x_bar, UNGUARDED)
        assert exact is not None
        float64_b_hat = assumed_accuracy_update(n, t, float(x_bar))
        # Next to 1/2 float64 may find x_bar uninformative, and has nothing to compare with.
        if float64_b_hat is not None:
            errors = self.errors["b_hat", region_of(2 * x_bar - 1)]
            errors.add(b_hat - exact, float(b_hat) - float64_b_hat)
        largest_error = b_hat_error(x_bar)
        return check_bounds("b_hat", b_hat, (exact - largest_error, exact + largest_error))

    def as_dict(self) -> dict[str, Any]:
        """Return the errors, the number of tests and the events of the robust filter as plain data, for JSON.

        Quantities and regions without a value are left out.
        """
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
    """Return the name of the region, one of REGIONS, in which the absolute value is."""
    return next(name for end, name in REGIONS if abs(value) < end)


def _alpha_units(word: int) -> int:
    """Return the confidence for which an alpha word stands, in units of 2**-24: mantissa * 2**shift."""
    mantissa = word >> 8  # bits 8 to 31
    shift = word % 32  # bits 0 to 4
    return mantissa << shift


def _closed_alpha_x(state: State) -> int:
    """Return the sum of alpha x_hat of the last closed round."""
    return (state["closed_alpha_x_high"] << 32) + state["closed_alpha_x_low"]


def _check_no_test(old_state: State, new_state: State, is_updated: bool) -> list[str]:
    """Return a line for each sign of a test or of an update of b_hat, where there must be neither."""
    problems = check_exact(new_state, {"b_hat()": old_state["b_hat()"], "tests": old_state["tests"]})
    return problems + check_update(is_updated, expected=False)


def _check_means(state: State, is_robust: bool) -> list[str]:
    """Return what is wrong with x_bar and x, a line each. Both are quotients of integers, rounded down.

    x_bar is the mean of the neighbours' x_hat, weighted by their alpha, and x that mean with the robot's own
    x_hat among them. With the robust filter both are the centre of the votes, and beta must be 0. Without any
    message, or vote, x_bar is 1/2 and x is the robot's own x_hat.
    """
    if is_robust:
        centre = state["robust_centre"] * ONE // 2**30  # from units of 2**-30 to 2**-23
        has_votes = state["robust_votes"] > 0
        x = centre if has_votes else state["x_hat"]
        x_bar = centre if has_votes else HALF
        return check_exact(state, {"x()": x, "x_bar()": x_bar, "beta()": 0})
    # Sums over the messages of the last closed round: of alpha, which is called beta, and of alpha x_hat
    beta, alpha_x = state["closed_alpha"], _closed_alpha_x(state)
    # The robot's own. Each alpha is in units of 2**-24, each x_hat in units of 2**-23.
    alpha, x_hat = _alpha_units(state["alpha"]), state["x_hat"]
    x = (alpha * x_hat + alpha_x) // (alpha + beta) if alpha + beta > 0 else x_hat
    x_bar = alpha_x // beta if beta > 0 else HALF
    return check_exact(state, {"x()": x, "x_bar()": x_bar})
