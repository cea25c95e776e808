"""The float64 firmware against exact fractions, likelihoods, numpy/scipy and the authors' own numbers."""

from __future__ import annotations

import json
import math
import random
from collections.abc import Callable, Iterator
from dataclasses import replace
from fractions import Fraction
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import stats  # type: ignore[import-untyped]

from mcp_asdf.native import NativeRobot
from mcp_asdf.reference import (
    ALGORITHM_1,
    AUTHORS,
    PAPER,
    UNINFORMATIVE,
    Conventions,
    Message,
    ReferenceRobot,
    assumed_accuracy_update,
    informed_estimate,
    local_confidence,
    local_estimate,
    rejects,
    social_confidence,
    social_estimate,
    t_score,
)
from mcp_asdf.robot import (
    B_HAT_MARGIN,
    Config,
    Counters,
    Filter,
    FirmwareError,
    Observation,
    Robot,
    Status,
)
from mcp_asdf.table import Table
from mcp_asdf_tools.tables.thresholds import generate, parse_omega
from robots import status_of_receive

TRACES = Path(__file__).parents[1] / "data" / "traces"
OMEGA = 0.05
ULP = Fraction(1, 2**53)
WHITE, BLACK = Observation.WHITE, Observation.BLACK
LARGEST_BINARY32 = (2 - 2.0**-23) * 2.0**127
QUANTITIES = ("x_hat", "alpha", "x_bar", "beta", "x", "b_hat")


def make_robot(
    b_hat: float = 0.75, conventions: Conventions = PAPER, *, robot_id: int = 0, **settings: Any
) -> ReferenceRobot:
    return ReferenceRobot(Config(**settings), robot_id, b_hat, conventions, omega=OMEGA)


def watch(robot: Robot, black: int, white: int) -> None:
    for z in [BLACK] * black + [WHITE] * white:
        robot.observe(z)


def view(robot: Robot) -> tuple[object, ...]:
    return (robot.t, robot.n, *(getattr(robot, name) for name in QUANTITIES), robot.counters)


# --- The authors' own numbers ------------------------------------------------------------------------


class Trace:
    """A recorded run, and the same run by ReferenceRobots."""

    def __init__(self, name: str) -> None:
        self.data: dict[str, Any] = json.loads((TRACES / f"{name}.json").read_text())
        packed = np.array([list(bytes.fromhex(row)) for row in self.data["obs_hex"]], dtype=np.uint8)
        self.observations = np.unpackbits(packed, axis=1)

    def robots(self, conventions: Conventions) -> list[Robot]:
        omega = self.data["omega"]
        return [ReferenceRobot(*each, conventions, omega=omega) for each in self._setups(None)]

    def firmware(self) -> list[Robot]:
        table = generate(parse_omega(str(self.data["omega"])), self.data["num_robots"] - 1)
        return [NativeRobot(*each) for each in self._setups(table)]

    def _setups(self, table: Table | None) -> Iterator[tuple[Config, int, float]]:
        size, tau, data = self.data["num_robots"], self.data["tau"], self.data
        for i in range(size):
            flawed = i >= size - data["flawed_count"]
            filters = Filter.ADAPTIVE if flawed or data["mode"] == "asdf_plus" else Filter.OFF
            yield Config(table, filters, filter_period=tau), i, data["flawed_b" if flawed else "true_b"]

    def mismatches(self, block: str, conventions: Conventions) -> list[str]:
        """Run all steps; say where a value differs by more than 1e-12 of it (of 1 below 1)."""
        robots, out, found = self.robots(conventions), self.data["out"][block], []
        for step in range(1, self.data["steps"] + 1):
            run_step(robots, self.observations[:, step - 1])
            expected = {name: out[name].get(str(step), []) for name in QUANTITIES}
            expected["b_hat"] = out["b_hat_at_filter_steps"].get(str(step), expected["b_hat"])
            for name, values in expected.items():
                for robot, value in zip(robots, values, strict=bool(values)):
                    ours = getattr(robot, name)
                    if not abs(ours - value) <= 1e-12 * max(1.0, abs(value)):
                        found.append(f"step {step}: {name} is {ours}, not {value}")
        updates = sum(robot.counters.updates for robot in robots)
        if updates != out["filter_updates"]:
            found.append(f"{updates} updates, not {out['filter_updates']}")
        if [robot.n for robot in robots] != self.data["n_final"]:
            found.append("the observations were decoded wrongly")
        return found


def run_step(robots: list[Robot], observations: Any) -> None:
    """All observe, all hear all, all settle: fully connected, latency 0."""
    for robot, z in zip(robots, observations, strict=True):
        assert robot.observe(Observation(int(z))) == Status.OK
    for sender, speaker in enumerate(robots):
        for listener in robots:
            if listener is not speaker:
                assert listener.receive(sender, speaker.x_hat, speaker.alpha) == Status.OK
    for robot in robots:
        robot.settle()


TRACE_A, TRACE_B = "A_f95_b55_flw95x3_plus", "B_f55_b95_flw55x5_minus"
AUTHORS_PAPER_DOF = replace(AUTHORS, lost_degrees=1)


@pytest.mark.parametrize(
    ("name", "block", "conventions"),
    [
        pytest.param(TRACE_A, "m", AUTHORS, id="A-m", marks=pytest.mark.slow),
        pytest.param(TRACE_A, "m-1", AUTHORS_PAPER_DOF, id="A-m-1", marks=pytest.mark.slow),
        pytest.param(TRACE_A, "m-1", PAPER, id="A-m-1-paper"),  # this run meets no edge but the degrees
        pytest.param(TRACE_B, "m", AUTHORS, id="B-m"),
        pytest.param(TRACE_B, "m-1", AUTHORS_PAPER_DOF, id="B-m-1", marks=pytest.mark.slow),
    ],
)
def test_every_value_and_update_of_the_authors_programs(
    name: str, block: str, conventions: Conventions
) -> None:
    assert Trace(name).mismatches(block, conventions) == []


@pytest.mark.parametrize("name", [TRACE_B, pytest.param(TRACE_A, marks=pytest.mark.slow)])
def test_the_firmware_stays_within_its_error_of_the_authors_values(name: str) -> None:
    """Where |2 b_hat - 1| is 0.1 and more. No decision differs in these runs. Each of the six updates may add
    one rounding of x_hat, 2**-23, to those that come back through x_bar and b_hat; b_hat carries them times
    |2 b_hat - 1| / |2 x_bar - 1|, here up to 7, and alpha four times that of b_hat over |2 b_hat - 1|."""
    trace = Trace(name)
    out, robots = trace.data["out"]["m-1"], trace.firmware()
    limits = {"x": 7e-7, "x_hat": 7e-7, "x_bar": 7e-7, "b_hat": 2e-6, "alpha": 1e-5}
    compared = 0
    for step in range(1, trace.data["steps"] + 1):
        run_step(robots, trace.observations[:, step - 1])
        for quantity, limit in limits.items():
            for robot, value in zip(robots, out[quantity].get(str(step), []), strict=False):
                compared += 1
                error = abs(getattr(robot, quantity) - value)
                assert error <= limit * max(1.0, abs(value)), f"step {step}: {quantity} of robot {robot}"
    assert compared >= 5 * len(robots) * 6
    assert sum(robot.counters.updates for robot in robots) == out["filter_updates"]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "block", "conventions"),
    [
        pytest.param(TRACE_A, "m-1", AUTHORS, id="degrees-of-freedom"),
        pytest.param(TRACE_B, "m-1", PAPER, id="clamp"),
    ],
)
def test_a_trace_tells_the_conventions_apart(name: str, block: str, conventions: Conventions) -> None:
    assert Trace(name).mismatches(block, conventions)


@pytest.mark.parametrize(("block", "conventions"), [("m", AUTHORS), ("m-1", PAPER)])
def test_t_score_of_the_traces(block: str, conventions: Conventions) -> None:
    out = Trace(TRACE_A).data["out"][block]
    assert t_score(9, OMEGA, conventions) == pytest.approx(out["tscore"], rel=1e-13)


# --- Equations against exact arithmetic --------------------------------------------------------------


def exact_estimate(n: int, t: int, b: Fraction, w: Fraction) -> Fraction:
    """Eq. 3 as printed, with accuracies of its own for both colours."""
    quotient = (Fraction(n, t) + w - 1) / (b + w - 1)
    if quotient <= 0:
        return Fraction(0)
    if quotient >= 1:
        return Fraction(1)
    return quotient


def exact_confidence(n: int, t: int, b: Fraction, w: Fraction) -> Fraction:
    """Eq. 4 as printed."""
    d = (b + w - 1) ** 2
    x_hat = exact_estimate(n, t, b, w)
    if x_hat == 0:
        return d * (t * w**2 - (2 * w - 1) * (t - n)) / (w**2 * (w - 1) ** 2)
    if x_hat == 1:
        return d * (t * b**2 - (2 * b - 1) * n) / (b**2 * (b - 1) ** 2)
    return d * t**3 / (n * (t - n))


def exact_accuracy(n: int, t: int, x_bar: Fraction) -> Fraction:
    """Eq. 8 as printed, kept in [eps, 1 - eps]."""
    quotient = (Fraction(n, t) + x_bar - 1) / (2 * x_bar - 1)
    eps = Fraction(1, 2**20)
    return max(eps, min(quotient, 1 - eps))


def draw_counts(rng: random.Random) -> tuple[int, int]:
    t = max(1, int(2 ** rng.uniform(0, 31)) - 1)
    return rng.choice([0, t, rng.randint(0, t), rng.randint(0, t)]), t


def draw_accuracy(rng: random.Random, n: int, t: int) -> float:
    """An accuracy that says something: anywhere, near an edge of its range, or at an edge of eq. 3."""
    gap = 2 ** rng.uniform(-12, -1)
    near_end = 2 ** rng.uniform(-20, -1)
    edge = min(max(n / t, B_HAT_MARGIN), 1 - B_HAT_MARGIN)
    b = rng.choice([rng.uniform(0.1, 0.9), 0.5 + gap / 2, near_end, edge])
    b = b if abs(2 * b - 1) >= UNINFORMATIVE else 0.75
    return rng.choice([b, 1 - b])


SEEDS = pytest.mark.parametrize("seed", range(8))


@SEEDS
def test_local_estimate_and_confidence_against_fractions(seed: int) -> None:
    rng = random.Random(seed)
    for _ in range(500):
        n, t = draw_counts(rng)
        b = draw_accuracy(rng, n, t)
        w = Fraction(b)
        x_hat, alpha = Fraction(local_estimate(n, t, b)), Fraction(local_confidence(n, t, b))
        exact_x, exact_alpha = exact_estimate(n, t, w, w), exact_confidence(n, t, w, w)
        assert abs(x_hat - exact_x) <= 4 * ULP / abs(2 * w - 1), (n, t, b)
        # alpha is continuous where eq. 4 changes its case, but has a kink that the rounding of n/t feels
        same_case = [x_hat in (0, 1), x_hat] == [exact_x in (0, 1), exact_x] or 0 < x_hat < 1 > exact_x > 0
        bound = 8 * ULP if same_case else 8 * ULP / min(w, 1 - w)
        assert abs(alpha - exact_alpha) <= bound * exact_alpha, (n, t, b)


@SEEDS
def test_confidence_is_the_observed_fisher_information(seed: int) -> None:
    """-d2/df2 ln p at f = x_hat, p the probability of black: one formula behind the cases of eq. 4."""
    rng = random.Random(seed)
    for _ in range(300):
        n, t = draw_counts(rng)
        b = rng.choice([rng.uniform(0.51, 0.999), rng.uniform(0.001, 0.49)])
        w = Fraction(b)
        f = exact_estimate(n, t, w, w)
        p = w * f + (1 - w) * (1 - f)
        information = (2 * w - 1) ** 2 * (n / p**2 + (t - n) / (1 - p) ** 2)
        assert local_confidence(n, t, b) == pytest.approx(float(information), rel=1e-12), (n, t, b)


@SEEDS
def test_local_estimate_maximises_the_likelihood(seed: int) -> None:
    rng = random.Random(seed)
    for _ in range(50):
        t = rng.randint(1, 500)
        n = rng.randint(0, t)
        b = rng.choice([rng.uniform(0.55, 0.99), rng.uniform(0.01, 0.45)])

        def log_likelihood(f: float, n: int = n, t: int = t, b: float = b) -> float:
            p = b * f + (1 - b) * (1 - f)
            return n * math.log(p) + (t - n) * math.log(1 - p)

        best = log_likelihood(local_estimate(n, t, b))
        assert best >= max(log_likelihood(i / 200) for i in range(201)) - 1e-9, (n, t, b)


@SEEDS
def test_accuracy_update_against_fractions(seed: int) -> None:
    rng = random.Random(seed)
    for _ in range(500):
        n, t = draw_counts(rng)
        gap = rng.choice([-1, 1]) * 2 ** rng.uniform(-13, -1)
        x_bar = rng.choice([rng.random(), 0.5 + gap, 0.0, 1.0])
        b_hat = assumed_accuracy_update(n, t, x_bar)
        if abs(2 * x_bar - 1) < UNINFORMATIVE:
            assert b_hat is None
            continue
        assert b_hat is not None and B_HAT_MARGIN <= b_hat <= 1 - B_HAT_MARGIN
        bound = 4 * ULP / abs(2 * Fraction(x_bar) - 1)
        assert abs(Fraction(b_hat) - exact_accuracy(n, t, Fraction(x_bar))) <= bound, (n, t, x_bar)


@SEEDS
def test_accuracy_update_makes_the_social_estimate_the_local_one(seed: int) -> None:
    rng = random.Random(seed)
    for _ in range(200):
        x_bar, b = rng.choice([rng.uniform(0, 0.4), rng.uniform(0.6, 1)]), rng.uniform(0.6, 0.99)
        n, t = round((b * x_bar + (1 - b) * (1 - x_bar)) * 10**6), 10**6
        b_hat = assumed_accuracy_update(n, t, x_bar)
        assert b_hat is not None
        assert local_estimate(n, t, b_hat) == pytest.approx(x_bar, abs=1e-12), (x_bar, b)


@SEEDS
def test_inverted_sensor_is_the_same_robot(seed: int) -> None:
    rng = random.Random(seed)
    for _ in range(300):
        n, t = draw_counts(rng)
        b = rng.randint(1, 2**20 - 1) / 2**20  # 1 - b is exact
        tolerance = 1e-15 / max(abs(2 * b - 1), UNINFORMATIVE)
        assert local_estimate(n, t, b) == pytest.approx(local_estimate(t - n, t, 1 - b), abs=tolerance)
        assert local_confidence(n, t, b) == pytest.approx(local_confidence(t - n, t, 1 - b), rel=1e-9)


@SEEDS
def test_social_and_informed_values_against_fractions(seed: int) -> None:
    rng = random.Random(seed)
    for _ in range(100):
        own, *others = [draw_message(rng) for _ in range(rng.randint(2, 128))]
        beta = sum(Fraction(m.alpha) for m in others)
        moment = sum(Fraction(m.alpha) * Fraction(m.x_hat) for m in others)
        x = (Fraction(own.alpha) * Fraction(own.x_hat) + moment) / (Fraction(own.alpha) + beta)
        assert social_confidence(others) == float(beta)
        assert social_estimate(others) == pytest.approx(float(moment / beta), rel=4 * float(ULP))
        assert informed_estimate(own, others) == pytest.approx(float(x), rel=4 * float(ULP))


@SEEDS
def test_means_stay_within_what_was_said_whatever_its_weight(seed: int) -> None:
    """Weights and estimates from float64's least to its largest, where products leave its range."""
    rng = random.Random(seed)
    for _ in range(300):
        messages = [draw_extreme_message(rng) for _ in range(rng.randint(1, 6))]
        weight = sum(Fraction(m.alpha) for m in messages)
        mean = Fraction(sum(Fraction(m.alpha) * Fraction(m.x_hat) for m in messages) / weight)
        bound: Fraction = 4 * ULP * mean + Fraction(5e-324)
        for found in (social_estimate(messages), informed_estimate(messages[0], messages[1:])):
            assert abs(Fraction(found) - mean) <= bound, messages
            assert found <= 1


def draw_extreme_message(rng: random.Random) -> Message:
    x_hat = rng.choice([0.0, 1.0, 5e-324, rng.random(), 2.0 ** rng.uniform(-1074, 0)])
    return Message(x_hat, rng.choice([5e-324, 1.7e308, 2.0 ** rng.uniform(-1074, 1023)]))


@pytest.mark.parametrize("alpha", [5e-324, 1e-323, 1e-310, 2.0**-1022, 1e-160, LARGEST_BINARY32])
def test_equal_messages_have_their_mean(alpha: float) -> None:
    robot = make_robot(filter=Filter.OFF)
    hear(robot, 0.6, 0.6, alpha=alpha)
    robot.settle()
    assert (robot.x_bar, robot.x, robot.beta) == (0.6, 0.6, 2 * alpha)


def draw_message(rng: random.Random) -> Message:
    x_hat = rng.choice([0.0, 1.0, rng.random(), rng.random(), rng.random()])
    return Message(x_hat, 2.0 ** rng.uniform(-24, 33))


@pytest.mark.parametrize(
    ("f", "b", "black_of_1000", "shift", "printed"),
    [
        (0.55, 0.55, 505, 0.0, 0.550),
        (0.55, 0.55, 505, 0.2, 0.510),
        (0.55, 0.55, 505, 0.4, 0.506),
        (0.55, 0.95, 545, 0.0, 0.550),
        (0.55, 0.95, 545, -0.2, 0.590),
        (0.55, 0.95, 545, -0.4, 0.950),
        (0.95, 0.55, 545, 0.0, 0.950),
        (0.95, 0.55, 545, 0.2, 0.590),
        (0.95, 0.55, 545, 0.4, 0.550),
        (0.95, 0.95, 905, 0.0, 0.950),
        (0.95, 0.95, 905, -0.2, 1.000),
        (0.95, 0.95, 905, -0.4, 1.000),
    ],
)
def test_table_1_of_the_paper(f: float, b: float, black_of_1000: int, shift: float, printed: float) -> None:
    assert b * f + (1 - b) * (1 - f) == pytest.approx(black_of_1000 / 1000)  # eq. 1
    assert round(local_estimate(black_of_1000, 1000, b + shift), 3) == printed


# --- The hypothesis test -----------------------------------------------------------------------------


@pytest.mark.parametrize("omega", [1e-6, 0.05, 0.25, 0.9])
def test_t_score_closed_forms_and_scipy(omega: float) -> None:
    assert t_score(2, omega) == pytest.approx(math.tan(math.pi * omega / 2), rel=1e-9)
    assert t_score(3, omega) == pytest.approx(omega * math.sqrt(2 / (1 - omega**2)), rel=1e-9)
    for m in range(2, 128):
        assert t_score(m, omega) == pytest.approx(stats.t.isf((1 - omega) / 2, m - 1), rel=1e-9)
        assert t_score(m, omega, AUTHORS) == pytest.approx(stats.t.isf((1 - omega) / 2, m), rel=1e-9)


@SEEDS
def test_decision_against_numpy_and_scipy(seed: int) -> None:
    """Random samples, with the own estimate anywhere and a hair's breadth off the threshold."""
    rng = random.Random(seed)
    for _ in range(100):
        sample = [rng.gauss(0.5, 0.1) for _ in range(rng.randint(2, 127))]
        omega, m = rng.choice([0.05, 0.1, 0.25, 0.9]), len(sample)
        quantile = stats.t.ppf(1 - (1 - omega) / 2, m - 1)
        interval = (quantile / np.sqrt(m) + 1) * np.std(sample, ddof=1)
        offset = interval * rng.choice([1 - 1e-9, 1 + 1e-9, rng.uniform(0, 2)])
        x_hat = float(np.mean(sample) + rng.choice([-1, 1]) * offset)
        assert rejects(x_hat, sample, omega) == (offset > interval), (x_hat, sample, omega)


def test_no_neighbour_or_one_never_rejects() -> None:
    for conventions in (PAPER, AUTHORS):
        assert not rejects(0.0, [], OMEGA, conventions)
        assert not rejects(0.0, [1.0], OMEGA, conventions)


@pytest.mark.parametrize("value", [0.0, 0.1, 1 / 3, 0.7, 1.0])
@pytest.mark.parametrize("m", [2, 3, 9, 127])
def test_equal_estimates_have_no_spread(value: float, m: int) -> None:
    """S = 0 exactly, also where naive sums of m equal values are off by a rounding."""
    assert not rejects(value, [value] * m, OMEGA)
    assert rejects(value, [value] * m, OMEGA, AUTHORS)
    assert rejects(math.nextafter(value, 0.5), [value] * m, OMEGA)


# --- Singular points ---------------------------------------------------------------------------------


@pytest.mark.parametrize("conventions", [PAPER, AUTHORS, ALGORITHM_1])
def test_before_the_first_observation(conventions: Conventions) -> None:
    robot = make_robot(0.9, conventions)
    assert view(robot) == (0, 0, 0.5, 0.0, 0.5, 0.0, 0.5, 0.9, Counters())
    assert robot.settle() == Status.OK
    assert view(robot) == (0, 0, 0.5, 0.0, 0.5, 0.0, 0.5, 0.9, Counters())
    assert assumed_accuracy_update(0, 0, 0.9, conventions) is None


@pytest.mark.parametrize("b", [0.5, 0.5 + 2**-13 - 2**-40, 0.5 - 2**-13 + 2**-40])
@pytest.mark.parametrize(("n", "t"), [(0, 7), (7, 7), (3, 6), (1, 1000)])
def test_accuracy_around_one_half_says_nothing(b: float, n: int, t: int) -> None:
    assert (local_estimate(n, t, b), local_confidence(n, t, b)) == (0.5, 0.0)
    assert local_confidence(n, t, b, replace(PAPER, zero_confidence=1e-6)) == 1e-6


@pytest.mark.parametrize("b", [0.5 + 2**-13, 0.5 - 2**-13])
def test_accuracy_at_the_edge_of_saying_nothing(b: float) -> None:
    assert local_estimate(1, 1, b) == (b > 0.5)
    assert local_confidence(1, 1, b) > 0


@pytest.mark.parametrize(("n", "x_hat"), [(0, 0.0), (2, 0.0), (3, 0.5), (4, 1.0), (6, 1.0)])
def test_authors_accuracy_one_half(n: int, x_hat: float) -> None:
    """Division by zero clamps to 0 or 1; only 0/0 is ours to define."""
    assert (local_estimate(n, 6, 0.5, AUTHORS), local_confidence(n, 6, 0.5, AUTHORS)) == (x_hat, 1e-6)


@pytest.mark.parametrize(("n", "b_hat"), [(0, 1e-6), (2, 1e-6), (3, 0.5), (4, 1 - 1e-6), (6, 1 - 1e-6)])
def test_authors_social_estimate_one_half(n: int, b_hat: float) -> None:
    assert assumed_accuracy_update(n, 6, 0.5, AUTHORS) == b_hat


def test_social_estimate_around_one_half_gives_no_update() -> None:
    for n in range(7):
        for off in (0.0, 2**-53, 2**-24, 2**-13 - 2**-53):
            assert assumed_accuracy_update(n, 6, 0.5 + off) is None
            assert assumed_accuracy_update(n, 6, 0.5 - off) is None
        for off in (2**-13, 2**-13 + 2**-53):
            assert assumed_accuracy_update(n, 6, 0.5 + off) is not None
            assert assumed_accuracy_update(n, 6, 0.5 - off) is not None


@pytest.mark.parametrize(("n", "x_bar", "at_zero"), [(0, 1.0, True), (6, 0.0, True), (6, 1.0, False)])
def test_accuracy_stays_off_zero_and_one(n: int, x_bar: float, at_zero: bool) -> None:
    for conventions, eps in ((PAPER, 2**-20), (AUTHORS, 1e-6)):
        expected = eps if at_zero else 1 - eps
        assert assumed_accuracy_update(n, 6, x_bar, conventions) == expected


def test_small_quotient_is_clamped_by_the_paper_and_kept_by_the_authors() -> None:
    n, t = 1, 2**30  # eq. 8 at x_bar = 1 is n/t
    assert assumed_accuracy_update(n, t, 1.0) == B_HAT_MARGIN
    assert assumed_accuracy_update(n, t, 1.0, AUTHORS) == n / t
    assert assumed_accuracy_update(t - n, t, 1.0) == 1 - B_HAT_MARGIN
    assert assumed_accuracy_update(t - n, t, 1.0, AUTHORS) == 1 - n / t


@pytest.mark.parametrize("b", [B_HAT_MARGIN, 1 - B_HAT_MARGIN, 0.3, 0.8])
@pytest.mark.parametrize("t", [1, 1000, 2**31 - 1])
def test_one_colour_only(b: float, t: int) -> None:
    """n = 0 and n = t, where t^3 / (n (t - n)) would divide by zero."""
    w = Fraction(b)
    for n in (0, t):
        assert local_estimate(n, t, b) == (n == t) ^ (b < 0.5)
        assert local_confidence(n, t, b) == pytest.approx(float(exact_confidence(n, t, w, w)), rel=1e-14)


@pytest.mark.parametrize(("n", "b"), [(0, 1.0), (5, 0.0), (0, 0.0), (5, 1.0)])
def test_perfect_sensor_has_no_finite_confidence_after_one_colour(n: int, b: float) -> None:
    with pytest.raises(ZeroDivisionError):
        local_confidence(n, 5, b)


NO_COUNTS = [(5, 3), (-1, 3), (0, -1), (-2, -1), (math.nan, 3), (1, math.nan)]
NO_SHARES = [-0.1, math.nextafter(0, -1), math.nextafter(1, 2), 2.0, math.nan, math.inf, -math.inf]
NO_MESSAGES = [
    *(Message(x_hat, 1.0) for x_hat in NO_SHARES),
    *(Message(0.5, alpha) for alpha in (-1.0, -5e-324, math.nan, math.inf, -math.inf)),
]
SAID = Message(0.5, 1.0)


@pytest.mark.parametrize("conventions", [PAPER, AUTHORS])
@pytest.mark.parametrize(
    ("equation", "arguments"),
    [
        *((local_estimate, (*counts, 0.9)) for counts in NO_COUNTS),
        *((local_confidence, (*counts, 0.9)) for counts in NO_COUNTS),
        *((assumed_accuracy_update, (*counts, 0.9)) for counts in NO_COUNTS),
        *((local_estimate, (n, t, b)) for n, t in ((1, 2), (0, 0)) for b in NO_SHARES),
        *((local_confidence, (n, t, b)) for n, t in ((1, 2), (0, 0)) for b in NO_SHARES),
        *((assumed_accuracy_update, (n, t, x_bar)) for n, t in ((1, 2), (0, 0)) for x_bar in NO_SHARES),
        *((t_score, (m, OMEGA)) for m in (1, 0, -3, math.nan)),
        *((t_score, (5, omega)) for omega in (0.0, 1.0, -0.1, 1.1, math.nan, math.inf)),
        *((rejects, (x_hat, [0.5, 0.6], OMEGA)) for x_hat in (math.nan, math.inf, -math.inf)),
        *((rejects, (0.5, [0.5, x_hat], OMEGA)) for x_hat in (math.nan, math.inf, -math.inf)),
        *((rejects, (0.5, [0.5, 0.6], omega)) for omega in (0.0, 1.0, math.nan)),
    ],
)
def test_an_equation_outside_its_domain_raises(
    equation: Callable[..., object], arguments: tuple[object, ...], conventions: Conventions
) -> None:
    with pytest.raises(ValueError, match=r" is .*(nan|inf|\d)"):
        equation(*arguments, conventions)


@pytest.mark.parametrize("message", NO_MESSAGES)
def test_means_of_what_is_no_message_raise(message: Message) -> None:
    for messages in ([message], [SAID, message], [message, SAID]):
        with pytest.raises(ValueError, match="a message has"):
            social_estimate(messages)
        with pytest.raises(ValueError, match="a message has"):
            social_confidence(messages)
        with pytest.raises(ValueError, match="a message has"):
            informed_estimate(SAID, messages)
        with pytest.raises(ValueError, match="a message has"):
            informed_estimate(messages[0], messages[1:])


def test_confidences_that_float64_cannot_add() -> None:
    messages = [Message(0.25, 1.7e308), Message(0.75, 1.7e308)]
    assert social_estimate(messages) == informed_estimate(messages[0], messages[1:]) == 0.5
    with pytest.raises(OverflowError):
        social_confidence(messages)


def test_no_confidence_anywhere_leaves_the_local_estimate() -> None:
    assert informed_estimate(Message(0.7, 0.0), []) == 0.7
    assert informed_estimate(Message(0.7, 0.0), [Message(0.2, 0.0)]) == 0.7
    assert (social_estimate([]), social_confidence([])) == (0.5, 0.0)


# --- The robot: rounds -------------------------------------------------------------------------------


def test_is_a_robot() -> None:
    robot: Robot = make_robot()
    assert isinstance(robot, Robot)


@SEEDS
def test_message_order_does_not_matter(seed: int) -> None:
    """To the bit, and so the informed estimates of a fully connected swarm are equal."""
    rng = random.Random(seed)
    robots: list[Robot] = [make_robot(rng.uniform(0.55, 0.95), robot_id=i, filter_period=5) for i in range(7)]
    shuffled: list[Robot] = [
        make_robot(robot.b_hat, robot_id=i, filter_period=5) for i, robot in enumerate(robots)
    ]
    for _ in range(60):
        observations = [rng.random() < 0.6 for _ in robots]
        run_step(robots, observations)
        for robot, z in zip(shuffled, observations, strict=True):
            robot.observe(Observation(z))
        said = [(i, robot.x_hat, robot.alpha) for i, robot in enumerate(shuffled)]
        for i, robot in enumerate(shuffled):
            for message in rng.sample(said, len(said)):
                expected = Status.ERR_SENDER if message[0] == i else Status.OK
                assert status_of_receive(robot, *message) == expected
            robot.settle()
        assert [view(r)[:-1] for r in shuffled] == [view(r)[:-1] for r in robots]
        assert len({robot.x for robot in robots}) == 1
    assert sum(robot.counters.updates for robot in robots) > 0


def test_a_round_is_the_receivers_own() -> None:
    robot = make_robot(filter=Filter.OFF)
    robot.receive(1, 0.25, 2.0)
    assert robot.beta == 0.0  # the round is open
    robot.step(BLACK)
    assert (robot.x_bar, robot.beta) == (0.25, 2.0)
    robot.receive(1, 0.75, 4.0)  # after settle: into the next round
    assert (robot.x_bar, robot.beta) == (0.25, 2.0)
    robot.step(BLACK)
    assert (robot.x_bar, robot.beta) == (0.75, 4.0)
    robot.step(BLACK)
    assert (robot.x_bar, robot.beta, robot.x) == (0.5, 0.0, robot.x_hat)


def test_first_message_of_a_sender_in_a_round_counts() -> None:
    robot = make_robot(filter=Filter.OFF)
    assert robot.receive(1, 0.25, 2.0) == Status.OK
    assert robot.receive(1, 0.75, 9.0) == Status.REPEATED
    assert robot.receive(2, 0.75, 2.0) == Status.OK
    robot.step(BLACK)
    assert (robot.x_bar, robot.beta) == (0.5, 4.0)
    assert robot.receive(1, 0.75, 9.0) == Status.OK  # a new round
    assert robot.counters == Counters(accepted=3, repeated=1)


def test_message_without_confidence_says_nothing_but_is_heard() -> None:
    robot = make_robot(filter_period=1)
    assert robot.receive(1, 1.0, 0.0) == Status.OK
    assert robot.receive(1, 1.0, 5.0) == Status.REPEATED
    robot.receive(2, 1.0, 3.0)
    robot.step(WHITE)
    assert (robot.x_bar, robot.beta) == (1.0, 3.0)
    assert robot.counters == Counters(accepted=2, repeated=1)  # m = 1: no test


@pytest.mark.parametrize(
    ("sender", "x_hat", "alpha"), [(0, 0.0, 0.0), (127, 1.0, LARGEST_BINARY32), (1, -0.0, 5e-324)]
)
def test_extreme_valid_messages(sender: int, x_hat: float, alpha: float) -> None:
    robot = make_robot(robot_id=3)
    assert robot.receive(sender, x_hat, alpha) == Status.OK
    for other in {*range(128)} - {3, sender}:
        assert robot.receive(other, x_hat, alpha) == Status.OK
    robot.step(BLACK)
    assert 0 <= robot.x <= 1 and math.isfinite(robot.beta)


def test_counters_wrap() -> None:
    robot = make_robot()
    for _ in range(65536 + 3):
        assert status_of_receive(robot, 0, 0.5, 1.0) == Status.ERR_SENDER
    assert robot.counters == Counters(rejected=3)


def test_stale_social_values_only_in_algorithm_1() -> None:
    robots = [make_robot(0.75, conventions, filter_period=1) for conventions in (PAPER, ALGORITHM_1)]
    for robot in robots:
        robot.receive(1, 0.0, 2.0)
        robot.receive(2, 0.0, 2.0)
        robot.settle()
        robot.step(BLACK)
    paper, stale = robots
    assert (paper.x_bar, paper.beta, paper.x, paper.counters.tests) == (0.5, 0.0, paper.x_hat, 0)
    assert (stale.x_bar, stale.beta, stale.counters.tests, stale.counters.updates) == (0.0, 4.0, 1, 1)
    assert stale.x == stale.alpha / (stale.alpha + 4.0)


# --- The robot: observations and memory ---------------------------------------------------------------


def test_a_round_without_an_observation_changes_no_local_value() -> None:
    robot = make_robot(filter=Filter.ALWAYS, filter_period=3)
    watch(robot, black=1, white=1)
    before = (robot.t, robot.n, robot.x_hat, robot.alpha)
    assert [robot.settle() for _ in range(2)] == [Status.OK, Status.OK]
    assert (robot.t, robot.n, robot.x_hat, robot.alpha) == before
    hear(robot, 0.9)
    assert robot.settle() == Status.UPDATED  # the third round


@pytest.mark.parametrize("z", [-1, 2, 3, 2**40])
def test_invalid_observation_changes_nothing(z: Any) -> None:
    robot = make_robot(filter_period=2)
    robot.receive(1, 0.25, 1.0)
    robot.observe(BLACK)
    before = view(robot)
    assert robot.step(z) == robot.observe(z) == Status.ERR_OBSERVATION
    assert view(robot) == before  # the round is still open
    robot.settle()
    assert robot.beta == 1.0


@pytest.mark.parametrize(
    ("black", "halved"), [(0, 0), (1, 0), (25, 12), (26, 13), (27, 14), (29, 14), (63, 32), (64, 32)]
)
def test_memory_halves_to_even(black: int, halved: int) -> None:
    robot = make_robot(memory=64)
    counts = []
    for i in range(64):
        robot.observe(BLACK if i < black else WHITE)
        counts.append((robot.t, robot.n))
    assert counts[:63] == [(i, min(i, black)) for i in range(1, 64)]
    assert counts[63] == (32, halved)
    assert robot.x_hat == local_estimate(halved, 32, 0.75)  # halved before estimating
    assert robot.alpha == local_confidence(halved, 32, 0.75)
    watch(robot, black=0, white=32)
    assert robot.t == 32


@SEEDS
def test_halving_keeps_n_within_t(seed: int) -> None:
    rng = random.Random(seed)
    robot = make_robot(memory=rng.choice([64, 68, 100]))
    p = rng.choice([0.0, 0.3, 0.99, 1.0])
    for _ in range(500):
        robot.step(BLACK if rng.random() < p else WHITE)
        assert 0 <= robot.n <= robot.t < 100 and 0 <= robot.x <= 1


# --- The robot: filter -------------------------------------------------------------------------------


def hear(robot: Robot, *x_hats: float, alpha: float = 1.0) -> None:
    for sender, x_hat in enumerate(x_hats, start=1):
        robot.receive(sender, x_hat, alpha)


def test_update_shows_at_the_next_observation() -> None:
    robot = make_robot(0.75, filter_period=1)
    watch(robot, black=3, white=1)
    hear(robot, 0.9, 0.9)
    assert robot.settle() == Status.UPDATED
    updated = assumed_accuracy_update(3, 4, 0.9)
    assert updated is not None
    assert (robot.b_hat, robot.x_hat) == (updated, local_estimate(3, 4, 0.75))
    robot.settle()
    assert robot.x_hat == local_estimate(3, 4, 0.75)
    robot.observe(BLACK)
    assert (robot.x_hat, robot.alpha) == (local_estimate(4, 5, updated), local_confidence(4, 5, updated))


@pytest.mark.parametrize(
    ("mode", "neighbours", "tests", "updates"),
    [
        (Filter.ADAPTIVE, (), 0, 0),
        (Filter.ADAPTIVE, (0.9,), 0, 0),
        (Filter.ADAPTIVE, (0.9, 0.9), 1, 1),
        (Filter.ADAPTIVE, (1.0, 1.0, 1.0), 1, 0),  # S = 0, equal to the own estimate
        (Filter.ADAPTIVE, (0.5, 0.5), 1, 0),  # rejected, but x_bar = 1/2
        (Filter.ALWAYS, (), 0, 0),
        (Filter.ALWAYS, (0.9,), 0, 1),
        (Filter.ALWAYS, (0.25, 0.75), 0, 0),  # x_bar = 1/2
        (Filter.ALWAYS, (0.25, 0.7502), 0, 0),  # and as near to it as says nothing
        (Filter.ALWAYS, (0.25, 0.7503), 0, 1),
        (Filter.ALWAYS, (1.0, 1.0, 1.0), 0, 1),
        (Filter.OFF, (0.1, 0.1, 0.1), 0, 0),
    ],
)
def test_when_the_filter_updates(
    mode: Filter, neighbours: tuple[float, ...], tests: int, updates: int
) -> None:
    robot = make_robot(0.75, filter=mode, filter_period=1)
    watch(robot, black=4, white=0)  # x_hat = 1
    hear(robot, *neighbours)
    assert robot.settle() == (Status.UPDATED if updates else Status.OK)
    assert (robot.b_hat != 0.75) == bool(updates)
    assert robot.counters == Counters(accepted=len(neighbours), tests=tests, updates=updates)


def test_authors_update_at_a_tie() -> None:
    robot = make_robot(0.75, AUTHORS, filter_period=1)
    robot.observe(BLACK)
    hear(robot, 1.0, 1.0, 1.0)
    assert robot.settle() == Status.UPDATED
    assert robot.b_hat == 1 - 1e-6


@pytest.mark.parametrize("conventions", [PAPER, AUTHORS, ALGORITHM_1])
@pytest.mark.parametrize("mode", [Filter.ADAPTIVE, Filter.ALWAYS])
def test_no_update_without_observations_or_neighbours(conventions: Conventions, mode: Filter) -> None:
    robot = make_robot(0.75, conventions, filter=mode, filter_period=1)
    hear(robot, 0.1, 0.1)
    robot.settle()
    assert robot.counters == Counters(accepted=2)  # t = 0: not even a test
    alone = make_robot(0.75, conventions, filter=mode, filter_period=1)
    for _ in range(5):
        watch(alone, black=1, white=1)
        assert alone.settle() == Status.OK
    assert alone.counters == Counters()


@pytest.mark.parametrize("conventions", [PAPER, AUTHORS])
@pytest.mark.parametrize("x_bar", [0.875, 0.9])
def test_accuracy_one_half_follows_from_an_update_and_is_survived(
    conventions: Conventions, x_bar: float
) -> None:
    """n/t = 1/2 gives b_hat = 1/2, but for rounding: the case that ends in NaN in plain doubles."""
    robot = make_robot(0.75, conventions, filter=Filter.ALWAYS, filter_period=4)
    watch(robot, black=2, white=2)
    for _ in range(4):
        hear(robot, x_bar)
        status = robot.settle()
    assert status == Status.UPDATED
    assert abs(robot.b_hat - 0.5) <= 2**-52 and (robot.b_hat == 0.5 or x_bar == 0.9)
    for z in (BLACK, WHITE, BLACK):
        robot.observe(z)
        hear(robot, x_bar)
        robot.settle()
        assert robot.alpha <= conventions.zero_confidence
        assert robot.x == pytest.approx(x_bar, abs=1e-6)


@pytest.mark.parametrize("period", [1, 2, 3, 5, 20])
@pytest.mark.parametrize("start", [0, 7])
def test_filter_period_counts_rounds(period: int, start: int) -> None:
    """Those before the first observation, too, in which there is nothing to update."""
    robot = make_robot(filter=Filter.ALWAYS, filter_period=period)
    updated = []
    for number in range(1, 61):
        if number > start:
            watch(robot, black=number % 3, white=1)
        hear(robot, 0.9)
        if robot.settle() == Status.UPDATED:
            updated.append(number)
    assert updated == [number for number in range(period, 61, period) if number > start]


def test_x_is_of_the_own_estimate_now_and_the_last_closed_round() -> None:
    robot = make_robot()
    xs = []
    for tick, z in enumerate((BLACK, WHITE, BLACK, BLACK, WHITE, BLACK), start=1):
        robot.observe(z)
        robot.receive(1, 0.125, 2.0 * tick)
        if tick % 3 == 0:
            robot.settle()
        beta = 2.0 if tick in (3, 4, 5) else 8.0 if tick == 6 else 0.0
        assert robot.beta == beta  # the first message of a round counts: those of ticks 1 and 4
        expected = (robot.alpha * robot.x_hat + beta * 0.125) / (robot.alpha + beta)
        assert robot.x == pytest.approx(expected, rel=1e-15)
        xs.append(robot.x)
    assert all(left != right for left, right in pairwise(xs[2:5]))


# --- Making a robot ----------------------------------------------------------------------------------

ENTRIES = tuple(round(2**26 * (1 + 1 / m)) for m in range(2, 9))
GOOD_TABLE = Table(omega_word=round(OMEGA * 2**32), entries=ENTRIES)


@pytest.mark.parametrize("omega", [0.0, -0.1, 0.91, math.nan])
def test_omega_out_of_range(omega: float) -> None:
    with pytest.raises(FirmwareError, match="omega is") as error:
        ReferenceRobot(Config(), 0, 0.75, omega=omega)
    assert error.value.status == Status.ERR_TABLE


@pytest.mark.parametrize(("omega", "updated"), [(0.05, True), (0.9, False)])
def test_omega_comes_from_the_table_and_its_entries_do_not_matter(omega: float, updated: bool) -> None:
    table = replace(GOOD_TABLE, omega_word=round(omega * 2**32 - 0.5))
    for entries in (ENTRIES, tuple(2 * entry for entry in ENTRIES)):
        robot = ReferenceRobot(Config(replace(table, entries=entries), filter_period=1), 0, 0.75)
        robot.observe(BLACK)  # x_hat = 1; the deviation is 2.5 S, the threshold 1.06 S or 5.5 S
        hear(robot, 0.8, 0.9)
        assert (robot.settle() == Status.UPDATED) == updated
