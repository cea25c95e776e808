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
OMEGA = 0.05
ULP = Fraction(1, 2**53)
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
        has_filter = is_flawed or data["mode"] == "asdf_plus"
        config = Config(None, Filter.ADAPTIVE if has_filter else Filter.OFF, data["tau"])
        yield config, robot_id, data["flawed_b" if is_flawed else "true_b"]


def repeat_run(
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
        for name, values in expected.items():
            results = [getattr(robot, name) for robot in robots]
            assert values is None or results == pytest.approx(values, rel=1e-12, abs=1e-12), (step, name)
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
def test_what_robots_observe_in_a_recorded_run_of_the_authors_follows_from_its_seed(name: str) -> None:
    """So the recording can be made again, as tests/data/README.md says."""
    data = load_trace(name)
    generator = np.random.Generator(np.random.PCG64(data["seed"]))
    shape = data["observations"].shape

    is_tile_black = generator.random(shape) < data["fill_ratio"]
    is_sensor_right = generator.random(shape) < data["true_b"]

    assert np.array_equal(is_tile_black == is_sensor_right, data["observations"])


def test_robots_compute_what_the_authors_programs_did_until_the_first_filter() -> None:
    """It runs after 1000 steps, in each of ten robots. Until then paper and programs agree on everything."""
    data = load_trace(TRACE_A)

    robots = repeat_run(data, "m-1", PAPER, steps=1001)

    assert [robot.counters.tests for robot in robots if robot.counters.tests > 0] == [1] * 10


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
    """``repeat_run`` compares them in each step. In the end updates and black tiles are counted, too.

    ``block`` is the part of the recording that was made with m or m - 1 degrees of freedom.
    """
    data = load_trace(name)

    robots = repeat_run(data, block, conventions, data["steps"])

    assert sum(robot.counters.updates for robot in robots) == data["out"][block]["filter_updates"]
    assert [robot.n for robot in robots] == data["n_final"], "the observations were decoded wrongly"


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
    """After n black of t observations by a sensor that is right with probability b.

    Where the likelihood is largest its slope is 0, or it falls from the end of the range on.
    """
    n, t = n_and_t

    x_hat = local_estimate(n, t, b)

    probability_of_black = b * x_hat + (1 - b) * (1 - x_hat)
    slope = (n - t * probability_of_black) * (2 * b - 1)  # of the log-likelihood, up to a positive factor
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
    """The code has a shorter form. n of t observations were black, and the sensor's accuracy is b."""
    n, t = n_and_t
    d = 2 * b - 1
    x_hat = local_estimate(n, t, b)
    if x_hat == 0:
        printed = d**2 * (t * b**2 - d * (t - n)) / (b**2 * (b - 1) ** 2)
    elif x_hat == 1:
        printed = d**2 * (t * b**2 - d * n) / (b**2 * (b - 1) ** 2)
    else:
        printed = d**2 * Fraction(t**3, n * (t - n))

    assert local_confidence(n, t, b) == printed


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
    ("equation", "arguments", "result"),
    [
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
    equation: Callable[..., object], arguments: tuple[object, ...], result: Fraction
) -> None:
    given = equation(*arguments)

    assert given == result
    assert type(given) is Fraction


# --- Equations in float64 against exact ones ---------------------------------------------------------


def draw_counts(rng: random.Random) -> tuple[int, int]:
    """Draw n and t > 0; t of any magnitude, n often 0 or t."""
    t = max(1, int(2 ** rng.uniform(0, 31)) - 1)
    return rng.choice([0, t, rng.randint(0, t), rng.randint(0, t)]), t


def draw_accuracy(rng: random.Random, n: int, t: int) -> float:
    """Draw an informative accuracy: anywhere, near an end of its range, or where eq. 3 changes its case."""
    gap = 2 ** rng.uniform(-12, -1)
    near_end = 2 ** rng.uniform(-20, -1)
    edge = min(max(n / t, B_HAT_MARGIN), 1 - B_HAT_MARGIN)
    b = rng.choice([rng.uniform(0.1, 0.9), 0.5 + gap / 2, near_end, edge])
    b = b if is_informative(b) else 0.75
    return rng.choice([b, 1 - b])


def draw_estimate(rng: random.Random) -> Estimate[float]:
    """Draw an estimate of any magnitude of confidence, with an x_hat that is often 0 or 1."""
    x_hat = rng.choice([0.0, 1.0, rng.random(), rng.random(), rng.random()])
    return Estimate(x_hat, 2.0 ** rng.uniform(-24, 33))


four_seeds = pytest.mark.parametrize("seed", range(4))


@four_seeds
def test_estimates_in_float64_are_right_to_the_last_bits(seed: int) -> None:
    """The same function computes them in exact fractions."""
    rng = random.Random(seed)
    for _ in range(500):
        n, t = draw_counts(rng)
        b = draw_accuracy(rng, n, t)

        error = Fraction(local_estimate(n, t, b)) - local_estimate(n, t, Fraction(b))

        assert abs(error) <= 4 * ULP / abs(2 * Fraction(b) - 1), (n, t, b)


def case_of_eq_4(x_hat: float | Fraction) -> str:
    """Return which of the three cases of eq. 4, the confidence alpha, an estimate belongs to."""
    if x_hat == 0:
        return "all white"
    return "all black" if x_hat == 1 else "between"


@four_seeds
def test_confidences_in_float64_are_right_to_the_last_bits(seed: int) -> None:
    """The same function computes them in exact fractions.

    alpha is continuous where eq. 4 changes its case, but has a kink that the rounding of n / t feels.
    """
    rng = random.Random(seed)
    for _ in range(500):
        n, t = draw_counts(rng)
        b = draw_accuracy(rng, n, t)
        exact_b = Fraction(b)

        alpha, exact_alpha = local_confidence(n, t, b), local_confidence(n, t, exact_b)

        largest_error = 8 * ULP
        if case_of_eq_4(local_estimate(n, t, b)) != case_of_eq_4(local_estimate(n, t, exact_b)):
            largest_error /= min(exact_b, 1 - exact_b)
        assert abs(Fraction(alpha) - exact_alpha) <= largest_error * exact_alpha, (n, t, b)


@four_seeds
def test_updated_accuracies_in_float64_are_right_to_the_last_bits(seed: int) -> None:
    """The same function computes them in exact fractions; x_bar is what the neighbours estimate."""
    rng = random.Random(seed)
    for _ in range(500):
        n, t = draw_counts(rng)
        distance_from_half = rng.choice([-1, 1]) * 2 ** rng.uniform(-13, -1)
        x_bar = rng.choice([rng.random(), 0.5 + distance_from_half, 0.0, 1.0])

        b_hat = assumed_accuracy_update(n, t, x_bar)
        exact_b_hat = assumed_accuracy_update(n, t, Fraction(x_bar))

        if abs(2 * x_bar - 1) < INFORMATIVE_G:
            assert b_hat is None, "too near to a half"
            continue
        assert b_hat is not None and exact_b_hat is not None
        assert B_HAT_MARGIN <= b_hat <= 1 - B_HAT_MARGIN
        assert abs(Fraction(b_hat) - exact_b_hat) <= 4 * ULP / abs(2 * Fraction(x_bar) - 1), (n, t, x_bar)


@four_seeds
def test_means_of_estimates_in_float64_are_right_to_the_last_bits(seed: int) -> None:
    """The social estimate is the mean of the neighbours' alone, the informed one has the robot's own, too.

    Both are weighted by confidence.
    """
    rng = random.Random(seed)
    for _ in range(100):
        own_estimate, *estimates = [draw_estimate(rng) for _ in range(rng.randint(2, 128))]
        total_alpha = sum(Fraction(alpha) for _, alpha in estimates)
        total_alpha_x = sum(Fraction(alpha) * Fraction(x_hat) for x_hat, alpha in estimates)
        own_x_hat, own_alpha = Fraction(own_estimate.x_hat), Fraction(own_estimate.alpha)
        exact_social = total_alpha_x / total_alpha
        exact_informed = (own_alpha * own_x_hat + total_alpha_x) / (own_alpha + total_alpha)

        assert social_confidence(estimates) == float(total_alpha)
        assert social_estimate(estimates) == pytest.approx(float(exact_social), rel=4 * float(ULP))
        assert informed_estimate(own_estimate, estimates) == pytest.approx(
            float(exact_informed), rel=4 * float(ULP)
        )


def test_robots_that_all_hear_each_other_believe_the_same_to_the_last_bit() -> None:
    """Whichever of the estimates is their own, and in whatever order they hear the others."""
    rng = random.Random(0)
    for _ in range(100):
        estimates = [draw_estimate(rng) for _ in range(rng.randint(2, 128))]
        own, *others = estimates
        own_of_another, *others_of_another = rng.sample(estimates, len(estimates))

        assert informed_estimate(own, others) == informed_estimate(own_of_another, others_of_another)


# --- The hypothesis test -----------------------------------------------------------------------------


@pytest.mark.parametrize("omega", [1e-6, 0.05, 0.25, 0.9])
def test_t_scores_of_one_and_two_degrees_of_freedom_have_closed_forms(omega: float) -> None:
    assert t_score(2, omega) == pytest.approx(math.tan(math.pi * omega / 2), rel=1e-9)
    assert t_score(3, omega) == pytest.approx(omega * math.sqrt(2 / (1 - omega**2)), rel=1e-9)


@pytest.mark.parametrize("omega", [1e-6, 0.05, 0.25, 0.9])
def test_t_scores_are_quantiles_of_scipy_and_the_authors_have_one_more_degree(omega: float) -> None:
    for m in range(2, 128):
        assert t_score(m, omega) == pytest.approx(stats.t.isf((1 - omega) / 2, m - 1), rel=1e-9)
        assert t_score(m, omega, AUTHORS) == pytest.approx(stats.t.isf((1 - omega) / 2, m), rel=1e-9)


@four_seeds
def test_the_paper_s_test_rejects_an_estimate_beyond_the_interval_that_scipy_gives(seed: int) -> None:
    """For random neighbours, and an own estimate anywhere or a hair's breadth off the end of the interval."""
    rng = random.Random(seed)
    for _ in range(100):
        neighbours = [rng.gauss(0.5, 0.1) for _ in range(rng.randint(2, 127))]
        omega, m = rng.choice([0.05, 0.1, 0.25, 0.9]), len(neighbours)
        quantile = stats.t.ppf(1 - (1 - omega) / 2, m - 1)
        interval = (quantile / np.sqrt(m) + 1) * np.std(neighbours, ddof=1)
        distance = interval * rng.choice([1 - 1e-9, 1 + 1e-9, rng.uniform(0, 2)])
        x_hat = float(np.mean(neighbours) + rng.choice([-1, 1]) * distance)

        rejects = asdf_test_rejects(x_hat, neighbours, omega)

        assert rejects == (distance > interval), (x_hat, neighbours, omega)


@pytest.mark.parametrize("value", [0.0, 0.1, 1 / 3, 0.7, 1.0])
@pytest.mark.parametrize("m", [2, 3, 9, 127])
def test_equal_estimates_have_no_spread(value: float, m: int) -> None:
    """Naive sums of m equal values would be off by a rounding."""
    assert not asdf_test_rejects(value, [value] * m, OMEGA)
    assert asdf_test_rejects(value, [value] * m, OMEGA, AUTHORS), "they update at equality"
    assert asdf_test_rejects(math.nextafter(value, 0.5), [value] * m, OMEGA)


@pytest.mark.parametrize("conventions", [PAPER, AUTHORS])
@pytest.mark.parametrize("neighbours", [[], [0.9]])
def test_fewer_than_two_messages_reject_nothing(neighbours: list[float], conventions: Conventions) -> None:
    assert not asdf_test_rejects(0.1, neighbours, OMEGA, conventions)


# --- Singular points ---------------------------------------------------------------------------------


@pytest.mark.parametrize("b", [0.5, 0.5 + 2**-13 - 2**-40, 0.5 - 2**-13 + 2**-40])
@pytest.mark.parametrize(("n", "t"), [(0, 7), (7, 7), (3, 6), (1, 1000)])
def test_an_accuracy_near_one_half_carries_no_information(b: float, n: int, t: int) -> None:
    assert (local_estimate(n, t, b), local_confidence(n, t, b)) == (0.5, 0.0)
    assert local_confidence(n, t, b, replace(PAPER, zero_confidence=1e-6)) == 1e-6
    assert assumed_accuracy_update(n, t, b) is None


@pytest.mark.parametrize(("b", "x_hat"), [(0.5 + 2**-13, 1.0), (0.5 - 2**-13, 0.0)])
def test_an_accuracy_at_the_limit_carries_information(b: float, x_hat: float) -> None:
    assert local_estimate(7, 7, b) == x_hat
    assert local_confidence(7, 7, b) > 0
    assert assumed_accuracy_update(7, 7, b) is not None


@pytest.mark.parametrize("conventions", [PAPER, AUTHORS])
def test_before_the_first_observation_nothing_is_known(conventions: Conventions) -> None:
    assert (local_estimate(0, 0, 0.9, conventions), local_confidence(0, 0, 0.9, conventions)) == (0.5, 0.0)
    assert assumed_accuracy_update(0, 0, 0.9, conventions) is None


def test_the_confidence_of_no_neighbours_is_a_float() -> None:
    assert repr(social_confidence([])) == "0.0"


def test_without_confidence_the_informed_estimate_is_the_own_one() -> None:
    assert (social_estimate([]), social_confidence([])) == (0.5, 0.0)
    assert informed_estimate(Estimate(0.7, 0.0), [Estimate(0.2, 0.0)]) == 0.7


@pytest.mark.parametrize(("n", "x_hat"), [(0, 0.0), (2, 0.0), (3, 0.5), (4, 1.0), (6, 1.0)])
def test_the_authors_clamp_divisions_by_zero_and_only_0_by_0_is_one_half(n: int, x_hat: float) -> None:
    assert (local_estimate(n, 6, 0.5, AUTHORS), local_confidence(n, 6, 0.5, AUTHORS)) == (x_hat, 1e-6)
    assert assumed_accuracy_update(n, 6, 0.5, AUTHORS) == min(max(x_hat, 1e-6), 1 - 1e-6)


@pytest.mark.parametrize(("conventions", "margin"), [(PAPER, 2**-20), (AUTHORS, 1e-6)])
def test_an_updated_accuracy_stays_off_zero_and_one(conventions: Conventions, margin: float) -> None:
    assert assumed_accuracy_update(0, 6, 1.0, conventions) == margin
    assert assumed_accuracy_update(6, 6, 0.0, conventions) == margin
    assert assumed_accuracy_update(6, 6, 1.0, conventions) == 1 - margin


@pytest.mark.parametrize("conventions", [PAPER, AUTHORS])
def test_only_the_authors_robots_may_assume_an_accuracy_next_to_0_or_1(conventions: Conventions) -> None:
    """Where all neighbours say that all is black, eq. 8 gives the share of black observations."""
    rare, t = 1, 2**30

    nearly_0 = assumed_accuracy_update(rare, t, 1.0, conventions)
    nearly_1 = assumed_accuracy_update(t - rare, t, 1.0, conventions)

    if conventions == PAPER:
        assert (nearly_0, nearly_1) == (B_HAT_MARGIN, 1 - B_HAT_MARGIN)
    else:
        assert (nearly_0, nearly_1) == (rare / t, (t - rare) / t)


@pytest.mark.parametrize(("n", "b"), [(0, 1.0), (5, 0.0), (0, 0.0), (5, 1.0)])
def test_a_perfect_sensor_has_no_finite_confidence_after_one_colour(n: int, b: float) -> None:
    with pytest.raises(ZeroDivisionError):
        local_confidence(n, 5, b)


BELOW_0 = math.nextafter(0, -1)
ABOVE_1 = math.nextafter(1, 2)
VALID = Estimate(0.5, 1.0)


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
    with pytest.raises(ValueError, match=r" (is|has) .*(nan|inf|\d)"):
        equation(*arguments)


# --- What only this robot has ------------------------------------------------------------------------


def test_the_authors_robots_update_where_a_deviation_equals_its_limit() -> None:
    """Where all neighbours agree with a robot both are 0. The paper's robots keep their accuracy there.

    The accuracy comes as near to 1 as the authors' programs allow.
    """
    robot = ReferenceRobot(Config(filter_period=1), 0, 0.75, AUTHORS, omega=OMEGA)
    observe_tiles(robot, black=1, white=0)
    receive_estimates(robot, 1.0, 1.0, 1.0)

    assert robot.settle() == Status.UPDATED

    assert robot.b_hat == 1 - 1e-6


@pytest.mark.parametrize(("omega", "status"), [(0.05, Status.UPDATED), (0.9, Status.OK)])
@pytest.mark.parametrize("is_in_table", [True, False])
def test_omega_comes_from_the_table_or_is_given_beside_it(
    is_in_table: bool, omega: float, status: Status
) -> None:
    """omega decides how much a robot may deviate from its neighbours before it updates its accuracy.

    This one deviates by 2.5 of their standard deviations; the limit is 1.06 of them, or 5.5 for omega = 0.9.
    """
    if is_in_table:
        table = replace(TABLE, omega_word=round(omega * 2**32 - 0.5))
        robot = ReferenceRobot(Config(table, filter_period=1), 0, 0.75)
    else:
        robot = ReferenceRobot(Config(filter_period=1), 0, 0.75, omega=omega)
    observe_tiles(robot, black=1, white=0)  # the robot's own estimate is 1
    receive_estimates(robot, 0.8, 0.9)

    assert robot.settle() == status


def test_a_missing_scipy_is_noticed_when_the_robot_is_made(monkeypatch: pytest.MonkeyPatch) -> None:
    """And not an hour later, when its filter needs it for the first time."""
    monkeypatch.setitem(sys.modules, "scipy.special", None)  # importing it fails from here on
    t_score.cache_clear()

    with pytest.raises(ImportError):
        ReferenceRobot(Config(TABLE), OWN_ID, 0.75)


@pytest.mark.parametrize("omega", [0.0, -0.1, 0.91, math.nan])
def test_an_omega_out_of_range_is_refused(omega: float) -> None:
    with pytest.raises(FirmwareError, match="omega is") as error:
        ReferenceRobot(Config(), 0, 0.75, omega=omega)
    assert error.value.status == Status.ERR_TABLE


# --- Whole lives -----------------------------------------------------------------------------------------


@dataclass
class Tick:
    """Inputs of both robots in a tick: an observation, and messages that all have the same alpha."""

    z: Observation
    x_hat_by_sender: list[tuple[int, float]]
    alpha: float


def draw_life() -> Iterator[Tick]:
    """Draw 4000 ticks of a robot with an accuracy of 0.9.

    It is alone, then among two senders whose ids are equal modulo 32, then among ten that are wrong at
    first, so that b_hat is rejected and may return. After 2500 ticks the floor changes. Messages are
    repeated, have the robot's own id, or no confidence.
    """
    rng = random.Random(7)
    for tick in range(4000):
        fill_ratio = 0.3 if tick < 2500 else 0.8
        x_hats = [0.7 if tick < 300 else min(max(rng.gauss(fill_ratio, 0.02), 0), 1) for _ in range(5)]
        z = Observation(rng.random() < 0.9 * fill_ratio + 0.1 * (1 - fill_ratio))
        late_senders = (rng.randrange(1, 4), rng.randrange(30, 37), rng.randrange(30, 37), 3, OWN_ID)
        senders = () if tick < 60 else (1, 33) if tick < 120 else late_senders
        on_grid = [math.floor(x_hat * 2**23) / 2**23 for x_hat in x_hats]
        alpha = 0.0 if tick % 50 == 5 else 1.0
        yield Tick(z, list(zip(senders, on_grid, strict=False)), alpha)


def check_same_values(reference: ReferenceRobot, mirror: MirrorRobot) -> None:
    """Check that two robots have the same counts, and estimates that differ by roundings."""
    assert (reference.t, reference.n, reference.counters) == (mirror.t, mirror.n, mirror.counters)
    assert (reference.beta, reference.x_hat) == pytest.approx((mirror.beta, mirror.x_hat), abs=1e-3)
    assert (reference.x, reference.x_bar) == pytest.approx((mirror.x, mirror.x_bar), abs=1e-3)
    assert reference.alpha == pytest.approx(mirror.alpha, rel=1e-3)
    assert reference.b_hat == pytest.approx(mirror.b_hat, abs=5e-3)


# design: R3, R7, R9, R35, R36
@pytest.mark.random
@pytest.mark.parametrize("mode", [Filter.ADAPTIVE, Filter.ROBUST, *slow([Filter.OFF, Filter.ALWAYS])])
def test_the_equations_in_float64_and_the_firmware_give_the_same_robot(mode: Filter) -> None:
    """Through 4000 ticks, in which its filter finds another accuracy.

    The robot in float64 computes the paper's equations as they stand, and the other one, MirrorRobot, the
    integers of the firmware. With the robust filter the accuracy of the start, 0.9, comes back in the end.
    """
    config = Config(generate(parse_omega("0.05"), 30), mode, 50, memory=256)
    float_robot = ReferenceRobot(config, OWN_ID, b_hat=0.9)
    integer_robot = MirrorRobot(config, OWN_ID, b_hat=0.9)

    accuracies_after_tests = set[float]()
    for tick in draw_life():
        for sender, x_hat in tick.x_hat_by_sender:
            status = status_of_receive(float_robot, sender, x_hat, tick.alpha)
            assert status == status_of_receive(integer_robot, sender, x_hat, tick.alpha)
        assert float_robot.step(tick.z) == integer_robot.step(tick.z)
        check_same_values(float_robot, integer_robot)
        if float_robot.counters.tests > 0:
            accuracies_after_tests.add(round(float_robot.b_hat, 2))

    assert (float_robot.counters.updates > 0) == (mode != Filter.OFF)
    if mode == Filter.ROBUST:
        assert 0.9 in accuracies_after_tests
        assert len(accuracies_after_tests) > 1
        assert float_robot.b_hat == 0.9
