"""The robust filter in plain equations, where no other test looks.

test_robust_filter.py has what every robot does; the cross-check compares each equation, in exact fractions,
with the firmware in C.
"""

from __future__ import annotations

import random
from fractions import Fraction

import pytest

from mcp_asdf.robust_reference import (
    Observations,
    RobustReference,
    Votes,
    dispersion_after_batch,
    huber_centre,
    huber_step,
    is_supported,
    robust_test_sides,
    spread_around,
    votes_after,
)

ROUNDING = Fraction(1, 2**53)
"""The largest error of one rounding to float64, relative to the result."""

# --- Votes -----------------------------------------------------------------------------------------------


def draw_votes(rng: random.Random) -> Votes[float]:
    """Draw a centre and a spread of votes anywhere in their ranges, and how many votes there were."""
    return Votes(centre=rng.random(), spread=2 ** rng.uniform(-12, -2), count=rng.randrange(513))


def test_votes_in_float64_are_right_to_the_last_bits() -> None:
    """The same function computes both in exact fractions. They differ by one rounding at most."""
    rng = random.Random(23)
    for _ in range(500):
        before = draw_votes(rng)
        vote = rng.choice([0.0, 1.0, before.centre, rng.random()])

        after = votes_after(before, vote)

        exact_before = Votes(Fraction(before.centre), Fraction(before.spread), before.count)
        exact_after = votes_after(exact_before, Fraction(vote))
        assert abs(Fraction(after.centre) - exact_after.centre) <= ROUNDING, (before, vote)
        assert abs(Fraction(after.spread) - exact_after.spread) <= ROUNDING, (before, vote)


# --- Dispersion ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("batch_black_count", "expected_dispersion"),
    [
        (50, 7 / 8 * 2),  # what was to be expected
        (60, 7 / 8 * 2 + 2**2 / 8),  # two standard deviations more
        (100, 7 / 8 * 2 + 12 * 2 / 8),  # ten standard deviations, which count as 12 times the dispersion
    ],
)
def test_a_batch_moves_the_dispersion_by_an_eighth(
    batch_black_count: int, expected_dispersion: float
) -> None:
    """The dispersion says how much more batches of tiles vary than independent ones would; here it is 2.

    Half of 1000 tiles are black. The batch is the last 100 of them, so that their standard deviation is 5.
    The new dispersion has 7/8 of the old one and 1/8 of the batch's squared deviation in variances.
    """
    observations = Observations(n=500, t=1000, dispersion=2.0)
    dispersion = dispersion_after_batch(observations, batch_black_count, batch_count=100)
    assert dispersion == expected_dispersion


# --- The estimates in the slots --------------------------------------------------------------------------


def test_a_step_is_not_divided_if_no_estimate_is_inside_the_spread() -> None:
    """Otherwise it would be divided by the number of estimates inside, which is 0 here.

    The only estimate is two spreads away, and counts as one spread.
    """
    step = huber_step([0.75], centre=0.5, spread=0.125)
    assert step == 0.125


def test_the_centre_of_estimates_in_float64_is_right_to_the_last_bits() -> None:
    """The same function computes it in exact fractions. It may differ by 16 roundings.

    The estimates are those of 5 to 32 neighbours.
    """
    rng = random.Random(23)
    for _ in range(100):
        neighbours = rng.randint(5, 32)
        estimates = [rng.random() for _ in range(neighbours)]
        spread = spread_around(estimates, 0.5)

        centre = huber_centre(estimates, middle=0.5, spread=spread)

        exact_estimates = [Fraction(estimate) for estimate in estimates]
        exact_centre = huber_centre(exact_estimates, middle=Fraction(1, 2), spread=Fraction(spread))
        assert abs(Fraction(centre) - exact_centre) <= 16 * ROUNDING, estimates


# --- The test --------------------------------------------------------------------------------------------


def test_observations_at_the_limit_of_the_test_contradict_nothing() -> None:
    """All tiles of a robot were black, and all five neighbours estimate 0.5, which contradicts 13 tiles.

    With an accuracy of 1/2 the squared deviation is 1/4 for every t, and the limit, 12 / (4 t), equals it for
    12 tiles. Beyond the limit the centre of the contradicting estimates is returned.
    """
    estimates_by_slot = {0: 0.5, 1: 0.5, 2: 0.5, 3: 0.5, 4: 0.5}
    robust = RobustReference(initial_b_hat=0.5, estimates=estimates_by_slot)

    assert robust.find_contradiction(n=12, t=12) is None
    assert robust.find_contradiction(n=13, t=13) == 0.5


def test_the_sides_of_the_test_in_float64_are_right_to_the_last_bits() -> None:
    """The squared deviation is wrong by at most 8 roundings, and its limit by at most 16.

    The same function computes both in exact fractions.
    """
    rng = random.Random(23)
    for _ in range(500):
        dispersion = rng.uniform(1, 256)
        observations = Observations(n=rng.randint(0, 10**6), t=10**6, dispersion=dispersion)
        b_hat = rng.uniform(0.01, 0.99)
        centre = rng.random()
        spread = 2 ** rng.uniform(-12, -2)

        squared_deviation, limit = robust_test_sides(observations, b_hat, centre, spread)

        exact_observations = Observations(observations.n, observations.t, Fraction(dispersion))
        exact_squared_deviation, exact_limit = robust_test_sides(
            exact_observations, Fraction(b_hat), Fraction(centre), Fraction(spread)
        )
        error = abs(Fraction(squared_deviation) - exact_squared_deviation)
        error_of_limit = abs(Fraction(limit) - exact_limit)
        assert error <= 8 * ROUNDING, (observations, b_hat, centre, spread)
        assert error_of_limit <= 16 * ROUNDING * exact_limit, (observations, b_hat, centre, spread)


def test_an_estimate_in_the_middle_does_not_support_the_robot() -> None:
    """The robot observes 3/4 black, by the centre it should observe 1/4, and by the estimate 1/2.

    The estimate would support it if its prediction were nearer to 3/4 than to 1/4.
    """
    observations = Observations(n=3, t=4, dispersion=1.0)
    assert not is_supported(observations, b=0.75, estimates=[0.5], centre=0.0)
