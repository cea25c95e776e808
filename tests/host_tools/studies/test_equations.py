"""Claims of the paper that its equations decide."""

from __future__ import annotations

import pytest

from mcp_asdf_tools.studies.equations import EQUATIONS
from mcp_asdf_tools.studies.verdicts import count_holding


def values_of(claim: str) -> list[float]:
    return [comparison.interval.value for comparison in EQUATIONS[claim]()]


@pytest.mark.parametrize(("claim", "count"), [("table_of_observations", 4), ("table_of_local_estimates", 12)])
def test_table_1_is_right_to_its_printed_digits(claim: str, count: int) -> None:
    differences = values_of(claim)
    assert len(differences) == count
    assert max(abs(difference) for difference in differences) <= 0.0005 + 1e-9


def test_confidence_grows_least_at_the_largest_b_hat() -> None:
    assert values_of("confidence_increases_with_b_hat") == pytest.approx(
        [(0.99 / 0.98) ** 2 - 1] * 3, rel=1e-2
    )


def test_confidence_of_0_95_is_81_times_that_of_0_55() -> None:
    excess_over_100 = values_of("confidence_grows_a_hundredfold")
    # alpha grows with (2 b_hat - 1)^2, which is 0.9^2 at 0.95, 0.1^2 at 0.55 and 0.5^2 at 0.75.
    ratios_of_095_to_055 = excess_over_100[3:5]
    assert ratios_of_095_to_055 == pytest.approx([81 - 100, 81 - 100])
    assert min(excess_over_100) == pytest.approx(0.81 / 0.25 - 100)


def test_the_slope_of_x_hat_is_one_over_twice_b_hat_less_one() -> None:
    assert values_of("low_b_hat_is_volatile") == pytest.approx([0.01 / 0.1 - 0.01 / 0.9])


def test_density_and_observations_of_the_physical_experiment_are_those_of_the_paper() -> None:
    assert values_of("physical_density") == pytest.approx([1.3423 - 1.3], abs=1e-4)
    assert values_of("physical_observations") == [0]


def test_all_claims_but_the_hundredfold_confidence_hold() -> None:
    failing = {claim: count_holding(compare(), False) for claim, compare in EQUATIONS.items()}
    assert {claim: count for claim, count in failing.items() if count} == {
        "confidence_grows_a_hundredfold": 8
    }
