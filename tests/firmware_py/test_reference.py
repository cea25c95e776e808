"""The equations and the float64 robot, against exact fractions, numpy, scipy and the authors' runs."""

from __future__ import annotations

import json
import math
import random
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats  # type: ignore[import-untyped]

from mcp_asdf.mirror import MirrorRobot
from mcp_asdf.reference import (
    AUTHORS,
    INFORMATIVE_G,
    PAPER,
    Conventions,
    Estimate,
    ReferenceRobot,
    asdf_test_rejects,
    assumed_accuracy_update,
    informed_estimate,
    is_informative,
    local_confidence,
    local_estimate,
    social_confidence,
    social_estimate,
    t_score,
)
from mcp_asdf.robot import B_HAT_MARGIN, Config, Filter, FirmwareError, Observation, Status
from mcp_asdf_tools.tables.thresholds import generate, parse_omega
from robots import OWN_ID, TABLE, observe_tiles, receive_estimates, status_of_receive
from support import draws, slow

TRACES = Path(__file__).parents[1] / "data" / "traces"
ROUNDING = Fraction(1, 2**53)
"""The largest error of one rounding to float64, relative to the result."""
QUANTITIES = ("x_hat", "alpha", "x_bar", "beta", "x", "b_hat")

# --- The authors' own numbers ------------------------------------------------------------------------


def load_trace(name: str) -> dict[str, Any]:
    """Load a recorded run of the authors' programs, with its observations by robot and step."""
    data: dict[str, Any] = json.loads((TRACES / f"{name}.json").read_text())
    packed_bits = np.array([list(bytes.fromhex(row)) for row in data["obs_hex"]], dtype=np.uint8)
    return data | {"observations": np.unpackbits(packed_bits, axis=1)}


def robot_arguments(data: dict[str, Any]) -> Iterator[tuple[Config, int, float]]:
    """Yield config, id and b_hat of each robot of a run."""
    robot_count = data["num_robots"]
    for robot_id in range(robot_count):
        is_flawed = robot_id >= robot_count - data["flawed_count"]
        has_filter = is_flawed or data["mode"] == "asdf_plus"  # and not only the flawed robots
        robot_filter = Filter.ADAPTIVE if has_filter else Filter.OFF
        b_hat = data["flawed_b"] if is_flawed else data["true_b"]
        yield Config(table=None, filter=robot_filter, filter_period=data["tau"]), robot_id, b_hat


def repeat_run_and_compare(
    data: dict[str, Any], block: str, conventions: Conventions, steps: int
) -> list[ReferenceRobot]:
    """Repeat the first steps of a run, and return its robots.

    Wherever the authors' programs recorded a quantity, the robots must have the same values. The block "m"
    was computed with m degrees of freedom of the t-score, the block "m-1" with m - 1.
    """
    recorded = data["out"][block]
    robots = [
        ReferenceRobot(*arguments, conventions, omega=data["omega"]) for arguments in robot_arguments(data)
    ]
    for step in range(1, steps + 1):
        run_step(robots, data["observations"][:, step - 1])
        expected = {name: recorded[name].get(str(step)) for name in QUANTITIES}
        # At the filter's steps b_hat was recorded after the filter.
        expected["b_hat"] = recorded["b_hat_at_filter_steps"].get(str(step), expected["b_hat"])
        for name, recorded_values in expected.items():
            if recorded_values is not None:
                values = [getattr(robot, name) for robot in robots]
                assert values == pytest.approx(recorded_values, rel=1e-12, abs=1e-12), (step, name)
    return robots


def run_step(robots: Sequence[ReferenceRobot], observations: Any) -> None:
    """Let all robots observe, all receive from all others, and all settle: fully connected, latency 0."""
    for robot, z in zip(robots, observations, strict=True):
        assert robot.observe(Observation(int(z))) == Status.OK
    for sender in robots:
        for receiver in robots:
            if receiver is not sender:
                assert receiver.receive(sender.id, sender.x_hat, sender.alpha) == Status.OK
    for robot in robots:
        robot.settle()


TRACE_A, TRACE_B = "A_f95_b55_flw95x3_plus", "B_f55_b95_flw55x5_minus"
AUTHORS_PAPER_DOF = replace(AUTHORS, lost_degrees=1)


@pytest.mark.parametrize("name", [TRACE_A, TRACE_B])
def test_the_seed_of_a_recorded_run_of_the_authors_gives_its_observations_again(name: str) -> None:
    """So the recording can be repeated, as tests/data/README.md says, with numpy's generator.

    It draws the colours of all tiles first, and then which observations are right.
    """
    data = load_trace(name)
    generator = np.random.Generator(np.random.PCG64(data["seed"]))
    robots_and_steps = data["observations"].shape

    is_tile_black = generator.random(robots_and_steps) < data["fill_ratio"]
    is_sensor_right = generator.random(robots_and_steps) < data["true_b"]

    is_tile_observed_black = np.where(is_sensor_right, is_tile_black, ~is_tile_black)
    assert np.array_equal(is_tile_observed_black, data["observations"])


def test_robots_compute_what_the_authors_programs_did_until_the_first_filter() -> None:
    """A recorded run is repeated, and repeat_run_and_compare() asserts that every number is the recorded one.

    The filters run in step 1000. Until step 1001 the paper and the authors' programs agree on everything, as
    far as these have the paper's m - 1 degrees of freedom, as in the block "m-1" of the recording.
    """
    data = load_trace("A_f95_b55_flw95x3_plus")
    assert data["num_robots"] == 10

    robots = repeat_run_and_compare(data, block="m-1", conventions=PAPER, steps=1001)

    assert [robot.counters.tests for robot in robots] == [1] * 10, "the filter of each robot ran once"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "block", "conventions"),
    [
        pytest.param(TRACE_A, "m", AUTHORS, id="A-m"),
        pytest.param(TRACE_A, "m-1", AUTHORS_PAPER_DOF, id="A-m-1"),
        pytest.param(TRACE_A, "m-1", PAPER, id="A-m-1-paper"),
        pytest.param(TRACE_B, "m", AUTHORS, id="B-m"),
        pytest.param(TRACE_B, "m-1", AUTHORS_PAPER_DOF, id="B-m-1"),
    ],
)
def test_robots_compute_every_number_that_the_authors_programs_recorded(
    name: str, block: str, conventions: Conventions
) -> None:
    """repeat_run_and_compare() asserts that in each step all numbers are the recorded ones.

    At the end, updates and black tiles are compared. A recording, here that with this ``name``, has two
    blocks. In one, the t-score has m degrees of freedom, as in the authors' programs; in the other it has
    m - 1, as in the paper. The robots that repeat a block follow its ``conventions``.
    """
    data = load_trace(name)
    recorded_block = data["out"][block]

    robots = repeat_run_and_compare(data, block, conventions, data["steps"])

    update_count = sum(robot.counters.updates for robot in robots)
    black_tile_counts = [robot.n for robot in robots]
    assert update_count == recorded_block["filter_updates"]
    assert black_tile_counts == data["n_final"], "the observations were decoded wrongly"


# --- Exact equations ---------------------------------------------------------------------------------

accuracies = st.fractions(Fraction(1, 2**20), 1 - Fraction(1, 2**20), max_denominator=2**32).filter(
    is_informative
)
counts = st.integers(1, 2**31).flatmap(lambda t: st.tuples(st.integers(0, t), st.just(t)))
exactly = settings(deadline=None, database=None, derandomize=True, max_examples=draws(200))


@pytest.mark.random
@exactly
@given(counts, accuracies)
def test_a_robot_s_estimate_is_the_likeliest_share_of_black(n_and_t: tuple[int, int], b: Fraction) -> None:
    """The robot has seen n black of t tiles, by a sensor that is right with probability b.

    At the maximum of the likelihood its slope is 0, unless the maximum is at an end of the range.
    """
    n, t = n_and_t

    x_hat = local_estimate(n, t, b)

    probability_of_black = b * x_hat + (1 - b) * (1 - x_hat)
    # The slope of the log-likelihood, but for a positive factor.
    slope = (n - t * probability_of_black) * (2 * b - 1)
    if x_hat == 0:
        assert slope <= 0
    elif x_hat == 1:
        assert slope >= 0
    else:
        assert slope == 0


@pytest.mark.random
@exactly
@given(counts, accuracies)
def test_a_robot_s_confidence_is_equation_4_as_the_paper_prints_it(
    n_and_t: tuple[int, int], b: Fraction
) -> None:
    """The code has shorter formulas, which must give the same fraction in all three cases of x_hat.

    n of t observations were black, and the sensor's accuracy is b.
    """
    n, t = n_and_t
    white_count = t - n
    d = 2 * b - 1
    x_hat = local_estimate(n, t, b)
    if x_hat == 0:
        printed_equation = d**2 * (t * b**2 - d * white_count) / (b**2 * (b - 1) ** 2)
    elif x_hat == 1:
        printed_equation = d**2 * (t * b**2 - d * n) / (b**2 * (b - 1) ** 2)
    else:
        printed_equation = d**2 * Fraction(t**3, n * white_count)

    assert local_confidence(n, t, b) == printed_equation


@pytest.mark.random
@exactly
@given(counts, accuracies)
def test_a_robot_whose_neighbours_agree_with_it_computes_the_accuracy_that_it_has(
    n_and_t: tuple[int, int], b: Fraction
) -> None:
    """A robot computes an estimate from its accuracy b, and in an update an accuracy from an estimate.

    Both take n black of t observations. So an update by the robot's own estimate gives b again. There are two
    exceptions: an estimate that was cut off at 0 or 1, and one next to 1/2, which says nothing about sensors.
    """
    n, t = n_and_t
    own_estimate = local_estimate(n, t, b)
    neighbours_estimate = own_estimate

    is_cut_off = own_estimate <= 0 or own_estimate >= 1
    if not is_cut_off and is_informative(neighbours_estimate):
        assert assumed_accuracy_update(n, t, neighbours_estimate) == b


HALF, THREE_QUARTERS = Fraction(1, 2), Fraction(3, 4)


@pytest.mark.parametrize(
    ("equation", "arguments", "expected"),
    [
        # Counts are n and t; then comes an accuracy, or what the neighbours estimate.
        (local_estimate, (1, 2, THREE_QUARTERS), HALF),
        (local_estimate, (1, 2, HALF), HALF),
        (local_confidence, (0, 0, THREE_QUARTERS), 0),
        (local_confidence, (1, 2, HALF), 0),
        (assumed_accuracy_update, (0, 2, THREE_QUARTERS), Fraction(1, 2**20)),
        (social_estimate, ([Estimate(THREE_QUARTERS, HALF)],), THREE_QUARTERS),
        (social_confidence, ([Estimate(THREE_QUARTERS, HALF)],), HALF),
        (informed_estimate, (Estimate(THREE_QUARTERS, HALF), []), THREE_QUARTERS),
    ],
)
def test_equations_give_fractions_for_fractions(
    equation: Callable[..., object], arguments: tuple[object, ...], expected: Fraction
) -> None:
    """So the same functions give exact results, with which those in floats and the firmware's are compared.

    ``equation`` is a function for an equation of the paper, whose result for the arguments is known.
    """
    result = equation(*arguments)

    assert result == expected
    assert type(result) is Fraction


# --- Equations in float64 against exact ones ---------------------------------------------------------


def draw_counts(rng: random.Random) -> tuple[int, int]:
    """Draw n and t > 0; t of any magnitude, n often 0 or t."""
    t = max(1, int(2 ** rng.uniform(0, 31)) - 1)
    return rng.choice([0, t, rng.randint(0, t), rng.randint(0, t)]), t


def draw_accuracy(rng: random.Random, n: int, t: int) -> float:
    """Draw an informative accuracy: anywhere, near an end of its range, or where eq. 3 changes its case."""
    near_half = 0.5 + 2 ** rng.uniform(-13, -2)
    near_end = 2 ** rng.uniform(-20, -1)
    edge_of_case = min(max(n / t, B_HAT_MARGIN), 1 - B_HAT_MARGIN)
    b = rng.choice([rng.uniform(0.1, 0.9), near_half, near_end, edge_of_case])
    if not is_informative(b):
        b = 0.75
    return rng.choice([b, 1 - b])


def draw_estimate(rng: random.Random) -> Estimate[float]:
    """Draw an estimate of any magnitude of confidence, with an x_hat that is often 0 or 1."""
    x_hat = rng.choice([0.0, 1.0, rng.random(), rng.random(), rng.random()])
    return Estimate(x_hat, 2.0 ** rng.uniform(-24, 33))


four_seeds = pytest.mark.parametrize("seed", range(4))


@four_seeds
def test_estimates_in_float64_are_right_to_the_last_bits(seed: int) -> None:
    """The same function computes them in exact fractions. They differ by four roundings at most.

    n of t tiles were black, and b is the accuracy. The function divides by 2 b - 1. Only where that is small,
    the errors may be larger.
    """
    rng = random.Random(seed)
    for _ in range(500):
        n, t = draw_counts(rng)
        b = draw_accuracy(rng, n, t)

        x_hat = local_estimate(n, t, b)
        exact_x_hat = local_estimate(n, t, Fraction(b))

        largest_error = 4 * ROUNDING / abs(2 * Fraction(b) - 1)
        assert abs(Fraction(x_hat) - exact_x_hat) <= largest_error, (n, t, b)


def case_of_eq_4(x_hat: float | Fraction) -> str:
    """Return which of the three cases of eq. 4, the confidence alpha, an estimate belongs to."""
    if x_hat == 0:
        return "all white"
    return "all black" if x_hat == 1 else "between"


@four_seeds
def test_confidences_in_float64_are_right_to_the_last_bits(seed: int) -> None:
    """The same function computes them in exact fractions. They differ by eight roundings at most.

    An error may be larger where the rounding of n / t leads to another case of eq. 4: alpha has a kink there.
    """
    rng = random.Random(seed)
    for _ in range(500):
        n, t = draw_counts(rng)
        b = draw_accuracy(rng, n, t)
        exact_b = Fraction(b)

        alpha = local_confidence(n, t, b)
        exact_alpha = local_confidence(n, t, exact_b)

        largest_relative_error = 8 * ROUNDING
        float_case = case_of_eq_4(local_estimate(n, t, b))
        exact_case = case_of_eq_4(local_estimate(n, t, exact_b))
        if float_case != exact_case:
            largest_relative_error /= min(exact_b, 1 - exact_b)
        assert abs(Fraction(alpha) - exact_alpha) <= largest_relative_error * exact_alpha, (n, t, b)


def draw_informative_x_bar(rng: random.Random) -> float:
    """Draw what neighbours estimate: anywhere, at an end of the range, or as near to a half as allowed."""
    distance_from_half = 2 ** rng.uniform(-13, -1)
    x_bar = rng.choice([rng.random(), 0.5 + distance_from_half, 0.5 - distance_from_half, 0.0, 1.0])
    return x_bar if abs(2 * x_bar - 1) >= INFORMATIVE_G else 0.75


@four_seeds
def test_updated_accuracies_in_float64_are_right_to_the_last_bits(seed: int) -> None:
    """The same function computes them in exact fractions, from which they differ by four roundings at most.

    x_bar is what the neighbours estimate. Near a half the errors may be larger: 2 x_bar - 1 is small there.
    """
    rng = random.Random(seed)
    for _ in range(500):
        n, t = draw_counts(rng)
        x_bar = draw_informative_x_bar(rng)

        b_hat = assumed_accuracy_update(n, t, x_bar)
        exact_b_hat = assumed_accuracy_update(n, t, Fraction(x_bar))

        assert b_hat is not None
        assert exact_b_hat is not None
        largest_error = 4 * ROUNDING / abs(2 * Fraction(x_bar) - 1)
        assert abs(Fraction(b_hat) - exact_b_hat) <= largest_error, (n, t, x_bar)


def exact_mean(estimates: Sequence[Estimate[float]]) -> Fraction:
    """Return the mean of estimates, weighted by their confidences, as an exact fraction."""
    weighted_sum = sum(Fraction(estimate.alpha) * Fraction(estimate.x_hat) for estimate in estimates)
    return Fraction(weighted_sum) / sum(Fraction(estimate.alpha) for estimate in estimates)


def draw_estimates(rng: random.Random) -> list[Estimate[float]]:
    """Draw 2 to 128 estimates, as many as a swarm can have robots."""
    return [draw_estimate(rng) for _ in range(rng.randint(2, 128))]


def test_means_of_estimates_in_float64_are_right_to_the_last_bits() -> None:
    """The social estimate is the mean of the neighbours'. The informed estimate adds the robot's own.

    Both are weighted by confidence.
    """
    rng = random.Random(0)
    for _ in range(100):
        own, *others = draw_estimates(rng)

        social = social_estimate(others)
        informed = informed_estimate(own, others)

        four_roundings = 4 * float(ROUNDING)
        assert social == pytest.approx(float(exact_mean(others)), rel=four_roundings)
        assert informed == pytest.approx(float(exact_mean([own, *others])), rel=four_roundings)


def test_the_neighbours_confidence_is_the_rounded_sum_of_their_confidences() -> None:
    """The sum is rounded once. If each addition were rounded, the error could be up to 128 roundings."""
    rng = random.Random(0)
    for _ in range(100):
        estimates = draw_estimates(rng)
        exact_sum = sum(Fraction(estimate.alpha) for estimate in estimates)
        assert social_confidence(estimates) == float(exact_sum)


# --- The hypothesis test -----------------------------------------------------------------------------


@pytest.mark.parametrize("omega", [1e-6, 0.05, 0.9])
@pytest.mark.parametrize("m", [2, 3, 4, 127])
def test_t_scores_are_those_of_scipy_and_the_authors_have_one_degree_of_freedom_more(
    m: int, omega: float
) -> None:
    """m is the number of neighbours, omega the probability between -t and t; half of the rest is above t.

    scipy computes the t above which there is a given probability.
    """
    probability_above = (1 - omega) / 2
    paper_t = t_score(m, omega)
    authors_t = t_score(m, omega, conventions=AUTHORS)
    assert paper_t == pytest.approx(stats.t.isf(probability_above, df=m - 1), rel=1e-9)
    assert authors_t == pytest.approx(stats.t.isf(probability_above, df=m), rel=1e-9)


def tolerated_distance(neighbours: Sequence[float], omega: float) -> float:
    """Return by how much an estimate may be off the mean of the neighbours' (eq. 12), computed with scipy."""
    m = len(neighbours)
    probability_above = (1 - omega) / 2
    t = stats.t.ppf(1 - probability_above, df=m - 1)
    return float((t / np.sqrt(m) + 1) * np.std(neighbours, ddof=1))


@pytest.mark.parametrize("omega", [0.05, 0.25, 0.9])
@pytest.mark.parametrize("side", [-1, 1], ids=["below", "above"])
def test_the_paper_s_test_rejects_an_estimate_just_beyond_the_distance_that_scipy_gives(
    omega: float, side: int
) -> None:
    """The test does not reject one just within that distance. The neighbours' estimates are random.

    ``side`` is 1 for estimates above their mean, and -1 for estimates below it.
    """
    rng = random.Random(0)
    for _ in range(100):
        neighbours = [rng.gauss(0.5, 0.1) for _ in range(rng.randint(2, 127))]
        mean = float(np.mean(neighbours))
        distance = tolerated_distance(neighbours, omega)
        just_within = mean + side * distance * (1 - 1e-9)
        just_beyond = mean + side * distance * (1 + 1e-9)

        assert not asdf_test_rejects(just_within, neighbours, omega), neighbours
        assert asdf_test_rejects(just_beyond, neighbours, omega), neighbours


@pytest.mark.parametrize("value", [0.0, 0.1, 1 / 3, 0.7, 1.0])
@pytest.mark.parametrize("m", [2, 3, 9, 127])
def test_an_estimate_that_differs_in_its_last_bit_from_equal_ones_is_rejected(value: float, m: int) -> None:
    """m equal estimates have no spread, so no deviation is tolerated. A naive sum would be slightly wrong.

    The authors' programs, unlike the paper, reject an estimate at the very limit, too.
    """
    equal_estimates = [value] * m
    next_float = math.nextafter(value, 0.5)  # towards 0.5, so that it stays within 0 and 1

    assert asdf_test_rejects(next_float, equal_estimates, omega=0.05)
    assert not asdf_test_rejects(value, equal_estimates, omega=0.05)
    assert asdf_test_rejects(value, equal_estimates, omega=0.05, conventions=AUTHORS)


@pytest.mark.parametrize("conventions", [PAPER, AUTHORS])
@pytest.mark.parametrize("neighbours", [[], [0.9]])
def test_fewer_than_two_messages_reject_nothing(neighbours: list[float], conventions: Conventions) -> None:
    """There is no neighbour, or one that estimates 0.9: without a spread the test has no limit."""
    own_estimate = 0.1
    assert not asdf_test_rejects(own_estimate, neighbours, omega=0.05, conventions=conventions)


# --- Singular points ---------------------------------------------------------------------------------


NEARLY_HALF = [0.5, 0.5 + 2**-13 - 2**-40, 0.5 - 2**-13 + 2**-40]
"""Probabilities that are too near to a half to say anything: the limit is 2**-13 away."""


@pytest.mark.parametrize("b", NEARLY_HALF)
@pytest.mark.parametrize(("n", "t"), [(0, 7), (7, 7), (1, 1000)])
def test_a_sensor_that_guesses_gives_an_estimate_of_a_half_without_confidence(
    b: float, n: int, t: int
) -> None:
    """The sensor is right with probability b, so near to 1/2 that it says nothing. n of t tiles were black.

    The authors' programs have a small confidence in place of 0.
    """
    assert local_estimate(n, t, b) == 0.5
    assert local_confidence(n, t, b) == 0.0

    like_authors = replace(PAPER, zero_confidence=1e-6)
    assert local_confidence(n, t, b, like_authors) == 1e-6


@pytest.mark.parametrize("x_bar", NEARLY_HALF)
def test_neighbours_that_estimate_a_half_say_nothing_about_a_robot_s_accuracy(x_bar: float) -> None:
    """Where half of the tiles are black, good and bad sensors see the same.

    The mean x_bar of the neighbours' estimates is 1/2, or less than 2**-13 off.
    """
    assert assumed_accuracy_update(n=7, t=7, x_bar=x_bar) is None


@pytest.mark.parametrize(("b", "x_hat"), [(0.5 + 2**-13, 1.0), (0.5 - 2**-13, 0.0)])
def test_an_accuracy_at_a_distance_of_2_to_the_minus_13_from_a_half_carries_information(
    b: float, x_hat: float
) -> None:
    """A sensor that sees black alone means that all is black, or white if it is more often wrong than right.

    So the estimate x_hat is 1 or 0. What the neighbours estimate, x_bar, carries information from the same
    distance on.
    """
    assert local_estimate(n=7, t=7, b=b) == x_hat
    assert local_confidence(n=7, t=7, b=b) > 0
    x_bar = b
    assert assumed_accuracy_update(n=7, t=7, x_bar=x_bar) is not None


@pytest.mark.parametrize("conventions", [PAPER, AUTHORS])
def test_before_the_first_observation_a_robot_guesses_a_half_without_confidence(
    conventions: Conventions,
) -> None:
    """It does not change its accuracy either, for any estimates of its neighbours, here 0.9."""
    assert local_estimate(n=0, t=0, b=0.9, conventions=conventions) == 0.5
    assert local_confidence(n=0, t=0, b=0.9, conventions=conventions) == 0.0
    assert assumed_accuracy_update(n=0, t=0, x_bar=0.9, conventions=conventions) is None


def test_without_neighbours_their_estimate_is_a_half_and_their_confidence_0() -> None:
    assert social_estimate([]) == 0.5
    assert repr(social_confidence([])) == "0.0", "a float, not the 0 of an empty sum"


def test_where_nobody_has_confidence_a_robot_believes_its_own_estimate() -> None:
    """The mean of all estimates, weighted by their confidences alpha, would be 0 by 0."""
    own_estimate = Estimate(x_hat=0.7, alpha=0.0)
    neighbours_estimate = Estimate(x_hat=0.2, alpha=0.0)
    assert informed_estimate(own_estimate, [neighbours_estimate]) == 0.7


@pytest.mark.parametrize(
    ("n", "expected_x_hat", "expected_b_hat"),
    [(0, 0.0, 1e-6), (2, 0.0, 1e-6), (3, 0.5, 0.5), (4, 1.0, 1 - 1e-6), (6, 1.0, 1 - 1e-6)],
)
def test_the_authors_programs_limit_the_results_of_divisions_by_zero(
    n: int, expected_x_hat: float, expected_b_hat: float
) -> None:
    """n of 6 tiles are black. The sensor is right in half of the cases, and the neighbours estimate a half.

    More than 3 black tiles give 1, and fewer give 0, from which accuracies and confidences keep off by 1e-6.
    Just 3 of them lead to 0 by 0, which gives a half.
    """
    assert local_estimate(n, t=6, b=0.5, conventions=AUTHORS) == expected_x_hat
    assert local_confidence(n, t=6, b=0.5, conventions=AUTHORS) == 1e-6
    assert assumed_accuracy_update(n, t=6, x_bar=0.5, conventions=AUTHORS) == expected_b_hat


@pytest.mark.parametrize(("conventions", "margin"), [(PAPER, 2**-20), (AUTHORS, 1e-6)])
def test_an_updated_accuracy_stays_off_zero_and_one(conventions: Conventions, margin: float) -> None:
    """A robot that always sees what its neighbours say would have an accuracy of 1, or else of 0.

    Here all neighbours say that every tile is black. Its accuracy is off 1 or 0 by ``margin``.
    """
    always_right = assumed_accuracy_update(n=6, t=6, x_bar=1.0, conventions=conventions)
    always_wrong = assumed_accuracy_update(n=0, t=6, x_bar=1.0, conventions=conventions)
    assert always_right == 1 - margin
    assert always_wrong == margin


@pytest.mark.parametrize(("conventions", "margin"), [(PAPER, 2**-20), (AUTHORS, 2**-30)])
def test_only_the_authors_robots_may_assume_an_accuracy_next_to_0_or_1(
    conventions: Conventions, margin: float
) -> None:
    """Where all neighbours say that all is black, x_bar = 1, eq. 8 gives the share of black observations.

    Here one of 2**30 is black, or white. The robots of the paper keep off 0 and 1 by 2**-20.
    """
    t = 2**30
    nearly_0 = assumed_accuracy_update(n=1, t=t, x_bar=1.0, conventions=conventions)
    nearly_1 = assumed_accuracy_update(n=t - 1, t=t, x_bar=1.0, conventions=conventions)

    assert nearly_0 == margin
    assert nearly_1 == 1 - margin


@pytest.mark.parametrize(("n", "b"), [(0, 1.0), (5, 0.0), (0, 0.0), (5, 1.0)])
def test_a_perfect_sensor_has_no_finite_confidence_after_one_colour(n: int, b: float) -> None:
    """The sensor is always right or wrong, b = 1 or 0, and n of 5 tiles, all or none, are black.

    There eq. 4 divides by 0.
    """
    with pytest.raises(ZeroDivisionError):
        local_confidence(n, t=5, b=b)


BELOW_0 = math.nextafter(0, -1)
ABOVE_1 = math.nextafter(1, 2)
VALID = Estimate(0.5, 1.0)
OMEGA = 0.05


@pytest.mark.parametrize(
    ("equation", "arguments"),
    [
        (local_estimate, (5, 3, 0.9)),
        (local_estimate, (-1, 3, 0.9)),
        (local_estimate, (math.nan, 3, 0.9)),
        (local_confidence, (1, 2, BELOW_0)),
        (local_confidence, (1, 2, ABOVE_1)),
        (local_confidence, (1, 2, math.nan)),
        (assumed_accuracy_update, (5, 3, 0.9)),
        (assumed_accuracy_update, (1, 2, math.nan)),
        (social_estimate, ([VALID, Estimate(BELOW_0, 1.0)],)),
        (social_estimate, ([VALID, Estimate(1.5, 1.0)],)),
        (social_estimate, ([VALID, Estimate(math.nan, 1.0)],)),
        (social_confidence, ([VALID, Estimate(0.5, -1.0)],)),
        (social_confidence, ([VALID, Estimate(0.5, math.inf)],)),
        (social_confidence, ([VALID, Estimate(0.5, math.nan)],)),
        (informed_estimate, (Estimate(2.0, 1.0), [])),
        (t_score, (1, OMEGA)),
        (t_score, (math.nan, OMEGA)),
        (t_score, (5, 0.0)),
        (t_score, (5, 1.0)),
        (t_score, (5, math.nan)),
        (asdf_test_rejects, (math.nan, [0.5, 0.6], OMEGA)),
        (asdf_test_rejects, (0.5, [0.5, math.inf], OMEGA)),
    ],
)
def test_an_equation_outside_its_domain_raises_and_names_the_value(
    equation: Callable[..., object], arguments: tuple[object, ...]
) -> None:
    """``equation`` is a function for an equation of the paper, and an argument is impossible.

    For 5 black of 3 tiles the message is "n is 5 and t 3; counts are 0 <= n <= t". Others name nan or inf.
    """
    with pytest.raises(ValueError, match=r" (is|has) .*(nan|inf|\d)"):
        equation(*arguments)


# --- What only this robot has ------------------------------------------------------------------------


def test_the_authors_robots_update_where_a_deviation_equals_its_limit() -> None:
    """Where all neighbours agree with a robot both are 0. The paper's robots keep their accuracy there.

    The robot sees black alone, and so do the others. So its accuracy comes as near to 1 as the authors'
    programs allow.
    """
    config = Config(filter=Filter.ADAPTIVE, filter_period=1)
    robot = ReferenceRobot(config, OWN_ID, b_hat=0.75, conventions=AUTHORS, omega=0.05)
    observe_tiles(robot, black=1, white=0)
    receive_estimates(robot, 1.0, 1.0, 1.0)

    status = robot.settle()  # ends the round, in which the filter runs

    assert status == Status.UPDATED
    assert robot.b_hat == 1 - 1e-6


@pytest.mark.parametrize(("omega", "expected_status"), [(0.05, Status.UPDATED), (0.9, Status.OK)])
@pytest.mark.parametrize("is_in_table", [True, False])
def test_omega_comes_from_the_table_or_is_given_beside_it(
    is_in_table: bool, omega: float, expected_status: Status
) -> None:
    """omega decides how much a robot may deviate from its neighbours before it updates its accuracy.

    The neighbours' mean is 0.85, and the robot's own estimate, 1, is 2.1 standard deviations above it. By
    eq. 12 that is beyond the limit for the omega 0.05, 1.06 of them, and within that for 0.9, 5.5 of them.
    """
    if is_in_table:
        omega_word = int(omega * 2**32)  # a table has omega in units of 2**-32
        config = Config(replace(TABLE, omega_word=omega_word), filter_period=1)
        robot = ReferenceRobot(config, OWN_ID, b_hat=0.75)
    else:
        robot = ReferenceRobot(Config(filter_period=1), OWN_ID, b_hat=0.75, omega=omega)
    observe_tiles(robot, black=1, white=0)
    receive_estimates(robot, 0.8, 0.9)

    status = robot.settle()  # ends the round, in which the filter runs

    assert status == expected_status


def test_a_missing_scipy_is_noticed_when_the_robot_is_made(monkeypatch: pytest.MonkeyPatch) -> None:
    """The error is not raised an hour later, when the robot's filter needs scipy for the first time."""
    monkeypatch.setitem(sys.modules, "scipy.special", None)  # importing it fails from here on
    t_score.cache_clear()  # so that no t-score of an earlier test makes scipy needless

    with pytest.raises(ImportError):
        ReferenceRobot(Config(TABLE), OWN_ID, b_hat=0.75)


@pytest.mark.parametrize("omega", [0.0, -0.1, 0.91, math.nan])
def test_an_omega_out_of_range_is_refused(omega: float) -> None:
    """omega is a probability of the hypothesis test: above 0 and at most 0.9."""
    with pytest.raises(FirmwareError, match="omega is") as error:
        ReferenceRobot(Config(), OWN_ID, b_hat=0.75, omega=omega)
    assert error.value.status == Status.ERR_TABLE  # as in the firmware, which has omega in the table


# --- Whole lives -----------------------------------------------------------------------------------------


@dataclass
class Tick:
    """Inputs of both robots in a tick: an observation, and messages that all have the same alpha."""

    z: Observation
    x_hat_by_sender: list[tuple[int, float]]
    alpha: float


def draw_life() -> Iterator[Tick]:
    """Draw 2500 ticks of a robot with an accuracy of 0.9.

    It is alone, then among two senders whose ids are equal modulo 32, then among ten that are wrong at
    first, so that b_hat is rejected and may return. After 1500 ticks the floor changes. Messages are
    repeated, have the robot's own id, or no confidence.
    """
    rng = random.Random(7)
    for tick in range(2500):
        fill_ratio = 0.3 if tick < 1500 else 0.8
        probability_of_black = 0.9 * fill_ratio + 0.1 * (1 - fill_ratio)
        z = Observation(rng.random() < probability_of_black)
        if tick < 60:
            senders = []
        elif tick < 120:
            senders = [1, 33]
        else:
            senders = [rng.randrange(1, 4), rng.randrange(30, 37), rng.randrange(30, 37), 3, OWN_ID]
        messages = []
        for sender in senders:
            x_hat = 0.7  # wrong
            if tick >= 300:
                x_hat = min(max(rng.gauss(fill_ratio, 0.02), 0), 1)
            messages.append((sender, math.floor(x_hat * 2**23) / 2**23))  # in units that the firmware has
        yield Tick(z, messages, alpha=0.0 if tick % 50 == 5 else 1.0)


def assert_same_values(reference: ReferenceRobot, mirror: MirrorRobot) -> None:
    """Assert that two robots have the same counts, and estimates that differ by roundings."""
    assert (reference.t, reference.n, reference.counters) == (mirror.t, mirror.n, mirror.counters)
    assert (reference.beta, reference.x_hat) == pytest.approx((mirror.beta, mirror.x_hat), abs=1e-3)
    assert (reference.x, reference.x_bar) == pytest.approx((mirror.x, mirror.x_bar), abs=1e-3)
    assert reference.alpha == pytest.approx(mirror.alpha, rel=1e-3)
    assert reference.b_hat == pytest.approx(mirror.b_hat, abs=5e-3)


# design: R3, R7, R9, R35, R36
@pytest.mark.random
@pytest.mark.parametrize("mode", [Filter.ADAPTIVE, Filter.ROBUST, *slow([Filter.OFF, Filter.ALWAYS])])
def test_the_equations_in_float64_and_the_firmware_give_the_same_robot(mode: Filter) -> None:
    """Both get the same observations and messages through 2500 ticks, and are compared in each tick.

    The robot in float64 computes the paper's equations as they stand. MirrorRobot computes the integers of
    the firmware. In this time the filter has to change the accuracy, unless it is off, or little is compared.
    """
    table = generate(parse_omega("0.05"), 30)  # for up to 30 neighbours
    config = Config(table, mode, filter_period=50, memory=256)
    float_robot = ReferenceRobot(config, OWN_ID, b_hat=0.9)
    integer_robot = MirrorRobot(config, OWN_ID, b_hat=0.9)

    for tick in draw_life():
        for sender, x_hat in tick.x_hat_by_sender:
            status = status_of_receive(float_robot, sender, x_hat, tick.alpha)
            assert status == status_of_receive(integer_robot, sender, x_hat, tick.alpha)
        assert float_robot.step(tick.z) == integer_robot.step(tick.z)
        assert_same_values(float_robot, integer_robot)

    has_changed_accuracy = float_robot.counters.updates > 0
    assert has_changed_accuracy == (mode != Filter.OFF)
