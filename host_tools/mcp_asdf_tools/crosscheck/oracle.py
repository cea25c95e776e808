"""Check the calls of a scenario against the paper's equations, in exact fractions, and collect errors.

x_hat and alpha are computed anew from t, n and b_hat. Values that have one right result must have it to the
last bit. The others must keep the bounds of ``bounds``; their errors, also against float64, are collected by
region. What depends on the robot's filter is checked by the functions of ``checked_filters``.
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import asdict, dataclass, replace
from fractions import Fraction
from typing import Any

from mcp_asdf.fixed_point import ONE
from mcp_asdf.reference import PAPER, assumed_accuracy_update, local_confidence, local_estimate
from mcp_asdf_tools.crosscheck.bounds import (
    LARGEST_ALPHA,
    alpha_bounds,
    b_hat_error,
    exact_alpha,
    is_update_expected,
    x_hat_bounds,
)
from mcp_asdf_tools.crosscheck.checked_filters import CHECKED_FILTERS, checked_filter_of
from mcp_asdf_tools.crosscheck.checks import alpha_units, check_bounds, check_whether_updated, is_observation
from mcp_asdf_tools.crosscheck.scenario import Call, CallResult, Setup, State

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
        """Count a value, and keep its errors, without their signs, if they are the largest so far. O(1)."""
        self.samples += 1
        self.exact = max(self.exact, abs(float(exact_error)))
        self.float64 = max(self.float64, abs(float64_error))


class Audit:
    """Checks calls of robots, and collects the errors of their results.

    Attributes:
        errors: Errors by quantity and region.
        tests: Number of hypothesis tests that were checked.
        events: How often each event happened to robots with a filter, by the filter's name in
            CHECKED_FILTERS and by what happened. The paper's filters count none.
    """

    def __init__(self) -> None:
        """Begin without any error, test or event."""
        self.errors = {(quantity, region): Errors() for quantity in QUANTITIES for _, region in REGIONS}
        self.tests = 0
        self.events = {checked.name: Counter[str]() for checked in CHECKED_FILTERS if checked.name}

    def check_call(self, setup: Setup, call: Call, before: CallResult, after: CallResult) -> list[str]:
        """Check a call by the states before and after it, and return a line for each problem.

        After every call the invariants are checked, and what depends on the filter, such as x_bar, x and
        changes of b_hat; and after an observation x_hat and alpha. Errors of results, and events of filters,
        are added to the attributes.
        """
        problems = []
        if not after.state["holds_invariants()"]:
            problems.append("the invariants do not hold")
        if is_observation(call, after):
            problems += self._check_estimate(before.state["b_hat()"], after.state)
        check_call_of_filter = checked_filter_of(setup.filter).check_call
        return problems + check_call_of_filter(self, setup, call, before, after)

    def _check_estimate(self, units_of_b_hat: int, state: State) -> list[str]:
        """Check x_hat and alpha after an observation, and return a line for each that is out of its bounds.

        ``units_of_b_hat`` is b_hat, the accuracy with which they were computed, in units of 2**-32. For the
        report their errors are added to ``errors``, by the range in which |2 b_hat - 1| is, but not the error
        of an alpha below 1/2.
        """
        n, t = state["n"], state["t"]
        b_hat = Fraction(units_of_b_hat, 2**32)
        x_hat = Fraction(state["x_hat"], ONE)
        alpha = Fraction(alpha_units(state["alpha"]), 2**24)
        self._collect_errors_of_estimate(n, t, b_hat, x_hat, alpha)
        problems = check_bounds("x_hat", x_hat, x_hat_bounds(n, t, b_hat))
        problems += check_bounds("alpha", alpha, alpha_bounds(n, t, b_hat))
        return problems

    def _collect_errors_of_estimate(
        self, n: int, t: int, b_hat: Fraction, x_hat: Fraction, alpha: Fraction
    ) -> None:
        """Add the errors of x_hat and alpha, after n black of t observations, to ``errors``.

        They are errors against exact numbers and, as users compare the firmware with it, against float64. An
        alpha below 1/2 is left out.
        """
        region = region_of(2 * b_hat - 1)
        exact_error = x_hat - local_estimate(n, t, b_hat)
        float64_error = float(x_hat) - local_estimate(n, t, float(b_hat))
        self.errors["x_hat", region].add(exact_error, float64_error)
        right_alpha = exact_alpha(n, t, b_hat)
        if right_alpha >= Fraction(1, 2):
            # The firmware has no larger alpha than this; the equation has.
            float64_alpha = min(local_confidence(n, t, float(b_hat)), float(LARGEST_ALPHA))
            exact_error = alpha / right_alpha - 1  # relative
            float64_error = float(alpha) / float64_alpha - 1
            self.errors["alpha", region].add(exact_error, float64_error)

    def check_b_hat(self, state: State, x_bar: Fraction, is_updated: bool) -> list[str]:
        """Return a line if b_hat is wrong after the filter had to re-estimate it from this exact x_bar.

        The filter must also have kept b_hat where x_bar carries no information. The error of a b_hat that was
        re-estimated is collected.
        """
        is_expected = is_update_expected(x_bar)  # None if rounding may decide it
        if not is_updated or is_expected is False:
            # No b_hat was computed, or none must have been: there is no right one to compare with.
            return check_whether_updated(is_updated, is_expected)
        n, t = state["n"], state["t"]
        b_hat = Fraction(state["b_hat()"], 2**32)
        # By rounding the firmware may re-estimate where the exact x_bar carries no information. Without its
        # guard the equation has a result there, too.
        exact_b_hat = assumed_accuracy_update(n, t, x_bar, UNGUARDED)
        assert exact_b_hat is not None
        float64_b_hat = assumed_accuracy_update(n, t, float(x_bar))
        # Next to 1/2 float64 may find x_bar uninformative, and has nothing to compare with.
        if float64_b_hat is not None:
            errors = self.errors["b_hat", region_of(2 * x_bar - 1)]
            errors.add(b_hat - exact_b_hat, float(b_hat) - float64_b_hat)
        largest_error = b_hat_error(x_bar)
        return check_bounds("b_hat", b_hat, (exact_b_hat - largest_error, exact_b_hat + largest_error))

    def as_dict(self) -> dict[str, Any]:
        """Return the errors, the number of tests and the events of each filter as plain data, for JSON.

        Quantities and regions without a value are left out.
        """
        error_rows = []
        for (quantity, region), errors in self.errors.items():
            if errors.samples > 0:
                error_rows.append({"quantity": quantity, "region": region, **asdict(errors)})
        data: dict[str, Any] = {"errors": error_rows, "tests": self.tests}
        for filter_name, events in self.events.items():
            data[filter_name] = dict(events)
        return data


def region_of(value: Fraction) -> str:
    """Return the name of the region, one of REGIONS, in which the absolute value is."""
    # The regions are in ascending order, and the last one has no end.
    names = [name for end, name in REGIONS if abs(value) < end]
    return names[0]
