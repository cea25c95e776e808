"""Claims of the paper that its equations decide."""

from __future__ import annotations

import math

import pytest

from mcp_asdf_tools.studies.equations import EQUATION_CLAIMS
from mcp_asdf_tools.studies.verdicts import count_holding


def differences_from_claim(claim: str) -> list[float]:
    """Return what the equations give for each comparison of a claim, less the number that the claim says."""
    return [comparison.interval.value for comparison in EQUATION_CLAIMS[claim]()]


@pytest.mark.parametrize(("claim", "count"), [("table_of_observations", 4), ("table_of_local_estimates", 12)])
def test_all_numbers_of_the_papers_table_1_are_right_to_their_three_printed_digits(
    claim: str, count: int
) -> None:
    """The results of the equations differ from each number of the table by at most half of its last digit."""
    differences = differences_from_claim(claim)

    assert len(differences) == count
    rounding_error = 1e-9
    half_of_last_digit = 0.0005 + rounding_error
    for difference in differences:
        assert abs(difference) <= half_of_last_digit


def test_confidence_grows_least_at_the_largest_assumed_accuracy() -> None:
    """The confidence alpha grows with (2 b_hat - 1)^2. The claim is that it always grows.

    Between values of b_hat that are 0.005 apart, the growth is least at the end, from 0.99 to 0.995. It is
    the same for three shares of black readings.
    """
    least_growths = differences_from_claim("confidence_increases_with_b_hat")

    growth_at_the_end = (0.99 / 0.98) ** 2 - 1  # as 2 b_hat - 1 grows from 0.98 to 0.99
    assert least_growths == pytest.approx([growth_at_the_end] * 3, rel=1e-2)


@pytest.mark.parametrize("black_share", ["0.505", "0.545"])
def test_confidence_grows_only_81_fold_from_an_assumed_accuracy_of_0_55_to_0_95(black_share: str) -> None:
    """The paper says "a hundredfold". Confidence grows with (2 b_hat - 1)^2, the square of 0.1, 0.5 or 0.9.

    From 0.75 to 0.95 it grows even less. n/t is the share of a robot's readings that are black.
    """
    comparisons = EQUATION_CLAIMS["confidence_grows_a_hundredfold"]()
    differences = {comparison.label: comparison.interval.value for comparison in comparisons}
    from_055_to_095 = differences[f"n/t {black_share}: alpha of b_hat 0.95 over that of 0.55, less 100"]
    from_075_to_095 = differences[f"n/t {black_share}: alpha of b_hat 0.95 over that of 0.75, less 100"]

    assert from_055_to_095 == pytest.approx(0.9**2 / 0.1**2 - 100)
    assert from_075_to_095 == pytest.approx(0.9**2 / 0.5**2 - 100)


def test_an_estimate_moves_more_at_an_assumed_accuracy_of_0_55_than_at_0_95() -> None:
    """If the share of black readings grows by 0.01, the estimate does by 0.01 / (2 b_hat - 1)."""
    movement_at_055 = 0.01 / 0.1
    movement_at_095 = 0.01 / 0.9
    assert differences_from_claim("low_b_hat_is_volatile") == pytest.approx(
        [movement_at_055 - movement_at_095]
    )


def test_the_density_of_the_physical_experiment_is_1_34_where_the_paper_says_1_3() -> None:
    """Density is 8 robots x the area within radio range / the floor's area. The radio range is 0.7 m."""
    density = 8 * math.pi * 0.7**2 / (3.0353 * 3.0226)
    assert density == pytest.approx(1.34, abs=0.005)
    assert differences_from_claim("physical_density") == pytest.approx([density - 1.3], abs=1e-4)


def test_the_physical_experiment_has_a_twentieth_of_the_observations_as_the_paper_says() -> None:
    """40,000 observations of a simulated robot are 20 times as many as two in a second for 1000 seconds."""
    ratio = 40_000 / (2 * 1000)
    assert differences_from_claim("physical_observations") == [ratio - 20]


def test_all_claims_that_equations_decide_hold_but_that_confidence_grows_a_hundredfold() -> None:
    failing_claims = set()
    for claim, compare in EQUATION_CLAIMS.items():
        failing_comparisons = count_holding(compare(), holds=False)
        if failing_comparisons > 0:
            failing_claims.add(claim)

    assert failing_claims == {"confidence_grows_a_hundredfold"}


def test_eight_of_twelve_ratios_of_confidence_are_not_a_hundredfold() -> None:
    """Four pairs of assumed accuracies are compared for three shares of black readings."""
    comparisons = EQUATION_CLAIMS["confidence_grows_a_hundredfold"]()
    failing_comparisons = count_holding(comparisons, holds=False)
    assert len(comparisons) == 4 * 3
    assert failing_comparisons == 8
