"""Claims of the paper that follow from its equations, without trials: a function of each claim's name.

Each function returns the comparisons that decide its claim. The symbols are the paper's: f is the share of
black floor, b the accuracy of a sensor, b_hat the accuracy that its robot assumes, and n/t the share of the
robot's readings that are black. From n/t and b_hat the robot computes x_hat, its estimate of f, and alpha,
its confidence in it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from itertools import combinations, pairwise
from math import pi

import numpy as np

from mcp_asdf.reference import local_confidence, local_estimate
from mcp_asdf_tools.studies.cells import FLAWED_ACCURACIES, PAPER_STEPS
from mcp_asdf_tools.studies.verdicts import Comparison, Expectation, exact_comparison


@dataclass(frozen=True)
class PrintedPanel:
    """A panel of the paper's Table I: f and b, and what the table prints for them.

    Attributes:
        f: Share of black floor.
        b: Accuracy of the sensors.
        black_share: n/t as printed.
        estimates: x_hat as printed, by b_hat.
    """

    f: float
    b: float
    black_share: float
    estimates: Mapping[float, float]

    @property
    def exact_black_share(self) -> float:
        """The share of readings that are black, p(z = 1), by equation 1."""
        return self.f * self.b + (1 - self.f) * (1 - self.b)


TABLE_1 = (
    PrintedPanel(f=0.55, b=0.55, black_share=0.505, estimates={0.55: 0.550, 0.75: 0.510, 0.95: 0.506}),
    PrintedPanel(f=0.95, b=0.55, black_share=0.545, estimates={0.55: 0.950, 0.75: 0.590, 0.95: 0.550}),
    PrintedPanel(f=0.55, b=0.95, black_share=0.545, estimates={0.55: 0.950, 0.75: 0.590, 0.95: 0.550}),
    PrintedPanel(f=0.95, b=0.95, black_share=0.905, estimates={0.55: 1.000, 0.75: 1.000, 0.95: 0.950}),
)

BLACK_SHARES = sorted({round(panel.exact_black_share, 9) for panel in TABLE_1})
"""The different n/t of Table I; two panels have the same, but for what float64 rounds."""

OBSERVATIONS = 100_000
"""t of the robots below: enough for n/t to be any share of black readings to five digits."""

HALF_A_PRINTED_DIGIT = 0.000500001
ROUNDING = 1e-9
"""Differences up to this size come from float64."""

WIDEST_B_HAT_PAIR = (0.505, 0.995)
"""Ends of the range of b_hat in the paper's figure 2, as we draw it."""


def _x_hat(black_share: float, b_hat: float) -> float:
    """Return the local estimate (eq. 3) of a robot that has read a share of its OBSERVATIONS as black."""
    return local_estimate(round(black_share * OBSERVATIONS), OBSERVATIONS, b_hat)


def _alpha(black_share: float, b_hat: float) -> float:
    """Return the local confidence (eq. 4) of a robot that has read a share of its OBSERVATIONS as black."""
    return local_confidence(round(black_share * OBSERVATIONS), OBSERVATIONS, b_hat)


def _compare_with_printed_digits(row: str, name: str, value: float, printed: float) -> Comparison:
    """Compare a value with the three digits that the paper prints of it: it must round to them."""
    column = f"{name} less {printed:.3f}"
    difference = _rounded(value - printed)
    return exact_comparison(row, column, difference, Expectation.SAME, HALF_A_PRINTED_DIGIT)


def _compare_with_zero(row: str, column: str, value: float) -> Comparison:
    """Compare a value with 0: the claim is that it is larger, by more than ROUNDING."""
    return exact_comparison(row, column, _rounded(value), Expectation.ABOVE, ROUNDING)


def _rounded(value: float) -> float:
    """Return a value without the last digits, which differ between processors."""
    return round(value, 12)


def table_of_observations() -> list[Comparison]:
    """Compare n/t of each panel, by equation 1, with the digits that the paper's Table I has."""
    comparisons: list[Comparison] = []
    for panel in TABLE_1:
        row = f"f {panel.f:g}, b {panel.b:g}"
        share, printed_share = panel.exact_black_share, panel.black_share
        comparisons.append(_compare_with_printed_digits(row, "p(z = 1)", share, printed_share))
    return comparisons


def table_of_local_estimates() -> list[Comparison]:
    """Compare x_hat of each panel and b_hat, by equation 3, with the digits that Table I has."""
    comparisons: list[Comparison] = []
    for panel in TABLE_1:
        for b_hat, printed_estimate in panel.estimates.items():
            row = f"f {panel.f:g}, b {panel.b:g}, b_hat {b_hat:g}"
            estimate = _x_hat(panel.exact_black_share, b_hat)
            comparisons.append(_compare_with_printed_digits(row, "x_hat", estimate, printed_estimate))
    return comparisons


def confidence_increases_with_b_hat() -> list[Comparison]:
    """Compare alpha at each b_hat from 0.505 to 0.995 with that at the b_hat 0.005 lower, for each n/t."""
    comparisons: list[Comparison] = []
    for black_share in BLACK_SHARES:
        # 99 values of b_hat, 0.005 apart.
        alphas = [_alpha(black_share, b_hat) for b_hat in np.linspace(0.505, 0.995, 99)]
        ratios = [alpha / alpha_before for alpha_before, alpha in pairwise(alphas)]
        column = "least ratio of alpha to that of a b_hat 0.005 lower, less 1"
        comparisons.append(_compare_with_zero(f"n/t {black_share:g}", column, min(ratios) - 1))
    return comparisons


def confidence_grows_a_hundredfold() -> list[Comparison]:
    """Compare the ratio of two alphas with 100, for each pair of the study's b_hat and the widest pair."""
    b_hat_pairs = [*combinations(FLAWED_ACCURACIES, 2), WIDEST_B_HAT_PAIR]
    return _compare_alpha_ratios(b_hat_pairs, claimed_ratio=100)


def underconfident_robots_weigh_less() -> list[Comparison]:
    """Compare the ratio of alpha at b_hat 0.95 to that at 0.55 and at 0.75 with 1."""
    return _compare_alpha_ratios([(0.55, 0.95), (0.75, 0.95)], claimed_ratio=1)


def _compare_alpha_ratios(b_hat_pairs: Iterable[tuple[float, float]], claimed_ratio: int) -> list[Comparison]:
    """Compare ratios of alpha, a robot's confidence, with the ratio that the paper claims.

    A ratio is alpha at the second b_hat of a pair divided by alpha at the first. There is a comparison for
    each pair and each n/t, the share of black readings.
    """
    comparisons: list[Comparison] = []
    for low, high in b_hat_pairs:
        column = f"alpha of b_hat {high:g} over that of {low:g}, less {claimed_ratio}"
        for black_share in BLACK_SHARES:
            ratio = _alpha(black_share, high) / _alpha(black_share, low)
            comparisons.append(_compare_with_zero(f"n/t {black_share:g}", column, ratio - claimed_ratio))
    return comparisons


def low_b_hat_is_volatile() -> list[Comparison]:
    """Compare how far x_hat moves at b_hat 0.55 and 0.95 while n/t goes from 0.505 to 0.515.

    No estimate reaches 0 or 1 in this range, where it would stop moving.
    """
    change_of_low = _x_hat(0.515, b_hat=0.55) - _x_hat(0.505, b_hat=0.55)
    change_of_high = _x_hat(0.515, b_hat=0.95) - _x_hat(0.505, b_hat=0.95)
    column = "change of x_hat: b_hat 0.55 less b_hat 0.95"
    return [_compare_with_zero("n/t 0.505 to 0.515", column, change_of_low - change_of_high)]


def physical_density() -> list[Comparison]:
    """Compare the density of eight robots with a radio range of 0.7 m on the paper's platform with 1.3."""
    robots, radio_range = 8, 0.7
    area = 3.0353 * 3.0226  # in square metres
    density = robots * pi * radio_range**2 / area
    return [exact_comparison("", "D less 1.3", _rounded(density - 1.3), Expectation.SAME, size=0.05)]


def physical_observations() -> list[Comparison]:
    """Compare the ratio of the observations of a simulation to those of 1000 s at 2 Hz with 20."""
    ratio = PAPER_STEPS / (1000 * 2)  # a simulated robot observes in every step
    return [exact_comparison("", "ratio less 20", _rounded(ratio - 20), Expectation.SAME, size=0.5)]


EQUATION_CLAIMS: Mapping[str, Callable[[], list[Comparison]]] = {
    function.__name__: function
    for function in (
        confidence_increases_with_b_hat,
        confidence_grows_a_hundredfold,
        low_b_hat_is_volatile,
        table_of_observations,
        table_of_local_estimates,
        underconfident_robots_weigh_less,
        physical_density,
        physical_observations,
    )
}
"""The claims that equations decide, by name."""
