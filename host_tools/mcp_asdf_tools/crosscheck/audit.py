"""Collect errors of results against exact fractions and float64, and count what a cross-check's calls do."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import asdict, dataclass, replace
from fractions import Fraction
from typing import Any

from mcp_asdf.reference import PAPER, assumed_accuracy_update, local_confidence, local_estimate
from mcp_asdf_tools.crosscheck.bounds import LARGEST_ALPHA, b_hat_error, exact_alpha, is_update_expected
from mcp_asdf_tools.crosscheck.checks import check_bounds, check_whether_updated
from mcp_asdf_tools.crosscheck.scenario import CallRecord

REGIONS = (
    (2.0**-12, "below 2^-12"),
    (0.02, "2^-12 to 0.02"),
    (0.2, "0.02 to 0.2"),
    (0.9, "0.2 to 0.9"),
    (0.999, "0.9 to 0.999"),
    (math.inf, "0.999 to 1"),
)
"""Upper end and name of each region, in ascending order.

Errors of x_hat and alpha are collected by the region of |2 b_hat - 1|, and errors of b_hat by the region of
|2 x_bar - 1|."""

QUANTITIES = ("x_hat", "alpha", "b_hat")
"""Quantities whose errors are collected. Errors of alpha are relative, and left out for an alpha below 1/2,
which has fewer than 24 bits."""

UNGUARDED = replace(PAPER, guarded=False)
"""The paper's equations, of which eq. 8 has a result even for an x_bar that carries no information.

By rounding the firmware may have an x_bar that does carry some."""


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
    """Collects the errors of results, and what happened, while calls of robots are checked.

    Attributes:
        errors: Errors by quantity and region.
        tests: Number of hypothesis tests that were checked.
        events: How often each event happened to robots with the robust filter, by the event's name.
    """

    def __init__(self) -> None:
        """Begin without any error, test or event."""
        self.errors = {(quantity, region): Errors() for quantity in QUANTITIES for _, region in REGIONS}
        self.tests = 0
        self.events = Counter[str]()

    def collect_error_of_x_hat(self, n: int, t: int, b_hat: Fraction, x_hat: Fraction) -> None:
        """Add the errors of an x_hat that was computed from n black of t observations and from b_hat."""
        exact_error = x_hat - local_estimate(n, t, b_hat)
        float64_error = float(x_hat) - local_estimate(n, t, float(b_hat))
        self.errors["x_hat", region_of(2 * b_hat - 1)].add(exact_error, float64_error)

    def collect_error_of_alpha(self, n: int, t: int, b_hat: Fraction, alpha: Fraction) -> None:
        """Add the relative errors of an alpha that was computed from n black of t observations and b_hat.

        They are left out if the exact alpha is below 1/2.
        """
        right_alpha = exact_alpha(n, t, b_hat)
        if right_alpha < Fraction(1, 2):
            return
        # The firmware has no larger alpha than this; the equation has.
        float64_alpha = min(local_confidence(n, t, float(b_hat)), float(LARGEST_ALPHA))
        exact_error = alpha / right_alpha - 1
        float64_error = float(alpha) / float64_alpha - 1
        self.errors["alpha", region_of(2 * b_hat - 1)].add(exact_error, float64_error)

    def check_b_hat(self, record: CallRecord, x_bar: Fraction) -> list[str]:
        """Return a line if b_hat is wrong after a call that had to re-estimate it from this exact x_bar.

        The call must have kept b_hat where x_bar carries no information. The error of a b_hat that was
        re-estimated is collected.
        """
        is_expected = is_update_expected(x_bar)  # None if rounding may decide it
        if not record.is_updated or is_expected is False:
            # No b_hat was computed, or none must have been: there is no right one to compare with.
            return check_whether_updated(record.is_updated, is_expected)
        n, t = record.new_state["n"], record.new_state["t"]
        b_hat = Fraction(record.new_state["b_hat()"], 2**32)
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
        """Return the errors, the number of tests and the robust filter's events as plain data, for JSON.

        Quantities and regions without a value are left out.
        """
        error_rows = []
        for (quantity, region), errors in self.errors.items():
            if errors.samples > 0:
                error_rows.append({"quantity": quantity, "region": region, **asdict(errors)})
        return {"errors": error_rows, "tests": self.tests, "robust": dict(self.events)}


def region_of(value: Fraction) -> str:
    """Return the name of the region, one of REGIONS, in which the absolute value is."""
    # The regions are in ascending order, and the last one has no end.
    names = [name for end, name in REGIONS if abs(value) < end]
    return names[0]
