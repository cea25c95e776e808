"""Claims of the paper that its equations decide."""

from __future__ import annotations

import math

import pytest

from mcp_asdf_tools.studies.equations import EQUATIONS
from mcp_asdf_tools.studies.verdicts import count_holding


def differences_of(claim: str) -> list[float]:
    """Return what the equations give for each comparison of a claim, less what the claim says."""
    return [comparison.interval.value for comparison in EQUATIONS[claim]()]


@pytest.mark.parametrize(("claim", "count"), [("table_of_observations", 4), ("table_of_local_estimates", 12)])
def test_all_numbers_of_the_papers_table_1_are_right_to_their_three_printed_digits(
    claim: str, count: int
) -> None:
    """The results of the equations differ from each number of the table by at most half of its last digit."""
    differences = differences_of(claim)

    assert len(differences) == count
    half_of_last_digit = 0.0005 + 1e-9
    assert max(differences) <= half_of_last_digit
    assert min(differences) >= -half_of_last_digit


def test_confidence_grows_least_at_the_largest_assumed_accuracy() -> None:
    """The confidence alpha grows with (2 b_hat - 1)^2, so from b_hat = 0.99 to 0.995 by (0.99 / 0.98)^2."""
    least_growths = differences_of("confidence_increases_with_b_hat")
    assert least_growths == pytest.approx([(0.99 / 0.98) ** 2 - 1] * 3, rel=1e-2)


@pytest.mark.parametrize("black_share", ["0.505", "0.545"])
def test_confidence_grows_only_81_fold_from_an_assumed_accuracy_of_0_55_to_0_95(black_share: str) -> None:
    """The paper says "a hundredfold". Confidence grows with (2 b_hat - 1)^2, the square of 0.1, 0.5 or 0.9.

    n/t is the share of a robot's readings that are black.
    """
    differences = {
        comparison.label: comparison.interval.value
        for comparison in EQUATIONS["confidence_grows_a_hundredfold"]()
    }
    from_055_to_095 = differences[f"n/t {black_share}: alpha of b_hat 0.95 over that of 0.55, less 100"]
    from_075_to_095 = differences[f"n/t {black_share}: alpha of b_hat 0.95 over that of 0.75, less 100"]

    assert from_055_to_095 == pytest.approx(0.9**2 / 0.1**2 - 100)
    assert from_075_to_095 == pytest.approx(0.9**2 / 0.5**2 - 100)


def test_an_estimate_moves_more_at_an_assumed_accuracy_of_0_55_than_at_0_95() -> None:
    """If the share of black readings grows by 0.01, the estimate does by 0.01 / (2 b_hat - 1)."""
    assert differences_of("low_b_hat_is_volatile") == pytest.approx([0.01 / 0.1 - 0.01 / 0.9])


def test_the_density_of_the_physical_experiment_is_1_34_where_the_paper_says_1_3() -> None:
    """Density is 8 robots x the area within radio range / the floor's area. The radio range is 0.7 m."""
    density = 8 * math.pi * 0.7**2 / (3.0353 * 3.0226)
    assert differences_of("physical_density") == pytest.approx([density - 1.3], abs=1e-4)


def test_the_physical_experiment_has_a_twentieth_of_the_observations_as_the_paper_says() -> None:
    assert differences_of("physical_observations") == [0]


def test_all_claims_that_equations_decide_hold_but_that_confidence_grows_a_hundredfold() -> None:
    failing_claims = {claim for claim, compare in EQUATIONS.items() if count_holding(compare(), False) > 0}
    assert failing_claims == {"confidence_grows_a_hundredfold"}


def test_eight_of_twelve_ratios_of_confidence_are_not_a_hundredfold() -> None:
    comparisons = EQUATIONS["confidence_grows_a_hundredfold"]()
    assert count_holding(comparisons, False) == 8
    assert len(comparisons) == 12
