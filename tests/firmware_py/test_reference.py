"""The float64 firmware against exact fractions, numpy/scipy and the authors' own numbers."""

from __future__ import annotations

import json
import math
import random
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import stats  # type: ignore[import-untyped]

from mcp_asdf.mirror import MirrorRobot
from mcp_asdf.reference import (
    AUTHORS,
    PAPER,
    UNINFORMATIVE,
    Conventions,
    Crowd,
    Message,
    ReferenceRobot,
    assumed_accuracy_update,
    deviates,
    informed_estimate,
    local_confidence,
    local_estimate,
    rejects,
    social_confidence,
    social_estimate,
    t_score,
    vote,
)
from mcp_asdf.robot import B_HAT_MARGIN, Config, Filter, FirmwareError, Observation, Status
from mcp_asdf_tools.crosscheck.exact import LARGEST_ALPHA, exact_b_hat, exact_estimate, vote_limits
from mcp_asdf_tools.crosscheck.exact import deviates as exact_deviates
from mcp_asdf_tools.tables.thresholds import generate, parse_omega
from robots import OWN_ID, TABLE, hear, status_of_receive, watch

TRACES = Path(__file__).parents[1] / "data" / "traces"
OMEGA = 0.05
ULP = Fraction(1, 2**53)
QUANTITIES = ("x_hat", "alpha", "x_bar", "beta", "x", "b_hat")

# --- The authors' own numbers ------------------------------------------------------------------------


def trace(name: str) -> dict[str, Any]:
    """A recorded run, with its observations by robot and step."""
    data: dict[str, Any] = json.loads((TRACES / f"{name}.json").read_text())
    packed = np.array([list(bytes.fromhex(row)) for row in data["obs_hex"]], dtype=np.uint8)
    return data | {"observations": np.unpackbits(packed, axis=1)}


def setups(data: dict[str, Any]) -> Iterator[tuple[Config, int, float]]:
    """The robots of a run: settings, id and b_hat."""
    size = data["num_robots"]
    for i in range(size):
        flawed = i >= size - data["flawed_count"]
        filters = Filter.ADAPTIVE if flawed or data["mode"] == "asdf_plus" else Filter.OFF
        yield Config(None, filters, data["tau"]), i, data["flawed_b" if flawed else "true_b"]


def check_run(data: dict[str, Any], block: str, robots: Sequence[ReferenceRobot]) -> None:
    """The same run by these robots gives all that was recorded, and no other update."""
    out = data["out"][block]
    for step in range(1, data["steps"] + 1):
        run_step(robots, data["observations"][:, step - 1])
        expected = {name: out[name].get(str(step)) for name in QUANTITIES}
        expected["b_hat"] = out["b_hat_at_filter_steps"].get(str(step), expected["b_hat"])
        for name, values in expected.items():
            found = [getattr(robot, name) for robot in robots]
            assert values is None or found == pytest.approx(values, rel=1e-12, abs=1e-12), (step, name)
    assert sum(robot.counters.updates for robot in robots) == out["filter_updates"]
    assert [robot.n for robot in robots] == data["n_final"], "the observations were decoded wrongly"


def run_step(robots: Sequence[ReferenceRobot], observations: Any) -> None:
    """All observe, all hear all, all settle: fully connected, latency 0."""
    for robot, z in zip(robots, observations, strict=True):
        assert robot.observe(Observation(int(z))) == Status.OK
    for sender, speaker in enumerate(robots):
        for listener in robots:
            if listener is not speaker:
                assert listener.receive(sender, speaker.x_hat, speaker.alpha) == Status.OK
    for robot in robots:
        robot.settle()


def test_observations_come_from_the_seed() -> None:
    """As tests/data/README.md says, so that a trace can be made again."""
    for name in (TRACE_A, TRACE_B):
        data = trace(name)
        draw, shape = np.random.Generator(np.random.PCG64(data["seed"])), data["observations"].shape
        is_black, is_right = (draw.random(shape) < data[each] for each in ("fill_ratio", "true_b"))
        assert np.array_equal(is_black == is_right, data["observations"])


TRACE_A, TRACE_B = "A_f95_b55_flw95x3_plus", "B_f55_b95_flw55x5_minus"
AUTHORS_PAPER_DOF = replace(AUTHORS, lost_degrees=1)


@pytest.mark.parametrize(
    ("name", "block", "conventions"),
    [
        pytest.param(TRACE_A, "m", AUTHORS, id="A-m", marks=pytest.mark.slow),
        pytest.param(TRACE_A, "m-1", AUTHORS_PAPER_DOF, id="A-m-1", marks=pytest.mark.slow),
        pytest.param(TRACE_A, "m-1", PAPER, id="A-m-1-paper"),  # this run meets no edge but the degrees
        pytest.param(TRACE_B, "m", AUTHORS, id="B-m", marks=pytest.mark.slow),
        pytest.param(TRACE_B, "m-1", AUTHORS_PAPER_DOF, id="B-m-1", marks=pytest.mark.slow),
    ],
)
def test_every_value_and_update_of_the_authors_programs(
    name: str, block: str, conventions: Conventions
) -> None:
    data = trace(name)
    robots = [ReferenceRobot(*each, conventions, omega=data["omega"]) for each in setups(data)]
    check_run(data, block, robots)


# --- Equations against exact arithmetic --------------------------------------------------------------


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


SEEDS = pytest.mark.parametrize("seed", range(4))


@SEEDS
def test_local_values_against_fractions(seed: int) -> None:
    rng = random.Random(seed)
    for _ in range(500):
        n, t = draw_counts(rng)
        b = draw_accuracy(rng, n, t)
        w = Fraction(b)
        x_hat, alpha = Fraction(local_estimate(n, t, b)), Fraction(local_confidence(n, t, b))
        exact_x, exact_alpha = exact_estimate(n, t, w)
        assert abs(x_hat - exact_x) <= 4 * ULP / abs(2 * w - 1), (n, t, b)
        # alpha is continuous where eq. 4 changes its case, but has a kink that the rounding of n/t feels
        same_case = [x_hat in (0, 1), x_hat] == [exact_x in (0, 1), exact_x] or 0 < x_hat < 1 > exact_x > 0
        bound = 8 * ULP if same_case else 8 * ULP / min(w, 1 - w)
        assert abs(min(alpha, LARGEST_ALPHA) - exact_alpha) <= bound * exact_alpha, (n, t, b)


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
        assert abs(Fraction(b_hat) - exact_b_hat(n, t, Fraction(x_bar))) <= bound, (n, t, x_bar)


def draw_message(rng: random.Random) -> Message:
    x_hat = rng.choice([0.0, 1.0, rng.random(), rng.random(), rng.random()])
    return Message(x_hat, 2.0 ** rng.uniform(-24, 33))


@SEEDS
def test_social_and_informed_values_against_fractions(seed: int) -> None:
    """Also to the bit in any order, and so the same for robots that all hear each other."""
    rng = random.Random(seed)
    for _ in range(100):
        own, *others = [draw_message(rng) for _ in range(rng.randint(2, 128))]
        beta = sum(Fraction(m.alpha) for m in others)
        moment = sum(Fraction(m.alpha) * Fraction(m.x_hat) for m in others)
        x = (Fraction(own.alpha) * Fraction(own.x_hat) + moment) / (Fraction(own.alpha) + beta)
        assert social_confidence(others) == float(beta)
        assert social_estimate(others) == pytest.approx(float(moment / beta), rel=4 * float(ULP))
        assert informed_estimate(own, others) == pytest.approx(float(x), rel=4 * float(ULP))
        other, *rest = rng.sample([own, *others], len(others) + 1)
        assert informed_estimate(other, rest) == informed_estimate(own, others)


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


@pytest.mark.parametrize("value", [0.0, 0.1, 1 / 3, 0.7, 1.0])
@pytest.mark.parametrize("m", [0, 1, 2, 3, 9, 127])
def test_equal_estimates_have_no_spread(value: float, m: int) -> None:
    """S = 0 exactly, also where naive sums of m equal values are off by a rounding; none for m < 2."""
    assert not rejects(value, [value] * m, OMEGA)
    assert rejects(value, [value] * m, OMEGA, AUTHORS) == (m > 1)
    assert rejects(math.nextafter(value, 0.5), [value] * m, OMEGA) == (m > 1)


# --- Singular points ---------------------------------------------------------------------------------


@pytest.mark.parametrize("b", [0.5, 0.5 + 2**-13 - 2**-40, 0.5 - 2**-13 + 2**-40])
@pytest.mark.parametrize(("n", "t"), [(0, 7), (7, 7), (3, 6), (1, 1000)])
def test_accuracy_around_one_half_says_nothing(b: float, n: int, t: int) -> None:
    assert (local_estimate(n, t, b), local_confidence(n, t, b)) == (0.5, 0.0)
    assert local_confidence(n, t, b, replace(PAPER, zero_confidence=1e-6)) == 1e-6
    assert assumed_accuracy_update(n, t, b) is None
    edge = 0.5 + math.copysign(2**-13, b - 0.5)
    assert (local_estimate(7, 7, edge), local_confidence(7, 7, edge) > 0) == (edge > 0.5, True)
    assert assumed_accuracy_update(n, t, edge) is not None


@pytest.mark.parametrize("conventions", [PAPER, AUTHORS])
def test_before_the_first_observation_nothing_is_known(conventions: Conventions) -> None:
    assert (local_estimate(0, 0, 0.9, conventions), local_confidence(0, 0, 0.9, conventions)) == (0.5, 0.0)
    assert assumed_accuracy_update(0, 0, 0.9, conventions) is None
    assert (social_estimate([]), social_confidence([])) == (0.5, 0.0)
    assert informed_estimate(Message(0.7, 0.0), [Message(0.2, 0.0)]) == 0.7


@pytest.mark.parametrize(("n", "x_hat"), [(0, 0.0), (2, 0.0), (3, 0.5), (4, 1.0), (6, 1.0)])
def test_authors_one_half(n: int, x_hat: float) -> None:
    """Division by zero clamps to 0 or 1; only 0/0 is ours to define."""
    assert (local_estimate(n, 6, 0.5, AUTHORS), local_confidence(n, 6, 0.5, AUTHORS)) == (x_hat, 1e-6)
    assert assumed_accuracy_update(n, 6, 0.5, AUTHORS) == min(max(x_hat, 1e-6), 1 - 1e-6)


def test_accuracy_stays_off_zero_and_one() -> None:
    """A small quotient is clamped by the paper and kept by the authors; eq. 8 at x_bar = 1 is n / t."""
    for conventions, eps in ((PAPER, 2**-20), (AUTHORS, 1e-6)):
        for n, x_bar, at_zero in ((0, 1.0, True), (6, 0.0, True), (6, 1.0, False)):
            assert assumed_accuracy_update(n, 6, x_bar, conventions) == (eps if at_zero else 1 - eps)
    n, t = 1, 2**30
    for count, clamped in ((n, B_HAT_MARGIN), (t - n, 1 - B_HAT_MARGIN)):
        assert assumed_accuracy_update(count, t, 1.0) == clamped
        assert assumed_accuracy_update(count, t, 1.0, AUTHORS) == count / t


@pytest.mark.parametrize(("n", "b"), [(0, 1.0), (5, 0.0), (0, 0.0), (5, 1.0)])
def test_perfect_sensor_has_no_finite_confidence_after_one_colour(n: int, b: float) -> None:
    with pytest.raises(ZeroDivisionError):
        local_confidence(n, 5, b)


SOUND = Message(0.5, 1.0)


@pytest.mark.parametrize(
    ("equation", "arguments"),
    [
        *((local_estimate, counts) for counts in ((5, 3, 0.9), (-1, 3, 0.9), (math.nan, 3, 0.9))),
        (assumed_accuracy_update, (5, 3, 0.9)),
        *((local_confidence, (1, 2, b)) for b in (math.nextafter(0, -1), math.nextafter(1, 2), math.nan)),
        (assumed_accuracy_update, (1, 2, math.nan)),
        *((vote, (Crowd(), 1, x)) for x in (math.nextafter(0, -1), 1.5, math.nan)),
        *(
            (deviates, wrong)
            for wrong in ((5, 3, 0.9, 0.5, 0.1), (1, 2, 1.5, 0.5, 0.1), (1, 2, 0.5, -0.1, 0.1))
        ),
        *((t_score, wrong) for wrong in ((1, OMEGA), (math.nan, OMEGA), (5, 0.0), (5, 1.0), (5, math.nan))),
        *((rejects, (x_hat, [0.5, other], OMEGA)) for x_hat, other in ((math.nan, 0.6), (0.5, math.inf))),
        *((social_estimate, ([SOUND, Message(x, 1.0)],)) for x in (math.nextafter(0, -1), 1.5, math.nan)),
        *((social_confidence, ([SOUND, Message(0.5, a)],)) for a in (-1.0, math.inf, math.nan)),
        (informed_estimate, (Message(2.0, 1.0), [])),
    ],
)
def test_an_equation_outside_its_domain_raises(
    equation: Callable[..., object], arguments: tuple[object, ...]
) -> None:
    with pytest.raises(ValueError, match=r" (is|has) .*(nan|inf|\d)"):
        equation(*arguments)


# --- What only this robot has ------------------------------------------------------------------------


def test_authors_update_at_a_tie() -> None:
    robot = ReferenceRobot(Config(filter_period=1), 0, 0.75, AUTHORS, omega=OMEGA)
    watch(robot, 1, 0)
    hear(robot, 1.0, 1.0, 1.0)
    assert robot.settle() == Status.UPDATED
    assert robot.b_hat == 1 - 1e-6


@pytest.mark.parametrize(("omega", "updated"), [(0.05, True), (0.9, False)])
def test_omega_comes_from_the_table_or_beside_it(omega: float, updated: bool) -> None:
    table = replace(TABLE, omega_word=round(omega * 2**32 - 0.5))
    for config, given in ((Config(table, filter_period=1), None), (Config(filter_period=1), omega)):
        robot = ReferenceRobot(config, 0, 0.75, omega=given)
        watch(robot, 1, 0)  # x_hat = 1; the deviation is 2.5 S, the threshold 1.06 S or 5.5 S
        hear(robot, 0.8, 0.9)
        assert (robot.settle() == Status.UPDATED) == updated
    for wrong in (0.0, -0.1, 0.91, math.nan):
        with pytest.raises(FirmwareError, match="omega is") as error:
            ReferenceRobot(Config(), 0, 0.75, omega=wrong)
        assert error.value.status == Status.ERR_TABLE


# --- The robust filter, which is not the paper's ---------------------------------------------------------


def test_votes_and_decisions_against_fractions() -> None:
    """Gains of every size, clamped and not; counts anywhere and a hair's breadth off the threshold."""
    rng, decisions = random.Random(23), Counter[bool | None]()
    for _ in range(500):
        crowd = Crowd(rng.random(), 2 ** rng.uniform(-12, -2), 0.5, rng.randrange(2**14 + 1))
        said, b = rng.choice([0.0, 1.0, crowd.centre, rng.random()]), rng.uniform(0.01, 0.99)
        after = vote(crowd, 40, said)
        limits = vote_limits(after.votes, *map(Fraction, (crowd.centre, crowd.spread, said)))
        for found, (least, most) in zip((after.centre, after.spread), limits, strict=True):
            assert least - ULP <= Fraction(found) <= most + ULP
        assert after.votes == min(crowd.votes + 1, 2**14) and list(after.voices) == [8]
        assert after.trend == 0.5 + ((said > crowd.centre) - (said < crowd.centre)) / 512
        t, p = 10**6, b * crowd.centre + (1 - b) * (1 - crowd.centre)
        away = math.sqrt(12 * (p * (1 - p) / t + (2 * b - 1) ** 2 * crowd.spread**2))
        n = min(max(round(t * (p + rng.choice([-1, 1]) * rng.uniform(0.99, 1.01) * away)), 0), t)
        exact = exact_deviates(n, t, *map(Fraction, (b, crowd.centre, crowd.spread)))
        decisions[exact] += 1
        assert exact in (None, deviates(n, t, b, crowd.centre, crowd.spread))
    assert min(decisions[True], decisions[False]) > 100
    assert vote(Crowd(), 1, 0.75).spread < 0.25, "one spread away is not beyond"
    assert [vote(Crowd(votes=2**14), 1, 0.5 + far).trend > 0.5 for far in (2**-18, 2**-19)] == [True, False]


# --- A life -----------------------------------------------------------------------------------------------


# design: R3, R7, R9, R35, R36
@pytest.mark.random
@pytest.mark.parametrize("mode", Filter)
def test_a_robot_does_what_the_firmware_does(mode: Filter) -> None:
    """Alone, among two voices, in a crowd that is wrong at first, so b_hat is rejected and may return, and
    while the floor changes; the memory is halved, and messages are repeated, refused or say nothing."""
    rng, config = random.Random(7), Config(generate(parse_omega("0.05"), 30), mode, 50, memory=256)
    both = reference, mirror = ReferenceRobot(config, OWN_ID, 0.9), MirrorRobot(config, OWN_ID, 0.9)
    seen, is_moving = set[tuple[int, int]](), False
    for tick in range(4000):
        fill = 0.3 if tick < 2500 else 0.8
        said = [0.7 if tick < 300 else min(max(rng.gauss(fill, 0.02), 0), 1) for _ in range(5)]
        z = Observation(rng.random() < 0.9 * fill + 0.1 * (1 - fill))
        senders = () if tick < 60 else (1, 33) if tick < 120 else (1, 2, 3, 3, OWN_ID)  # 33 is 1 modulo 32
        for sender, x_hat in zip(senders, said, strict=False):
            message = sender, math.floor(x_hat * 2**23) / 2**23, 0.0 if tick % 50 == 5 else 1.0
            assert len({status_of_receive(robot, *message) for robot in both}) == 1
        assert reference.step(z) == mirror.step(z)
        assert (reference.t, reference.n, reference.counters) == (mirror.t, mirror.n, mirror.counters)
        assert (reference.beta, reference.x_hat) == pytest.approx((mirror.beta, mirror.x_hat), abs=1e-3)
        assert (reference.x, reference.x_bar) == pytest.approx((mirror.x, mirror.x_bar), abs=1e-3)
        assert reference.alpha == pytest.approx(mirror.alpha, rel=1e-3)
        assert reference.b_hat == pytest.approx(mirror.b_hat, abs=5e-3)
        seen.add((reference.counters.tests > 0, round(reference.b_hat, 2) == 0.9))
        is_moving |= reference._crowd.is_moving and reference._crowd.votes < 2**9 and tick > 2500
    if mode == Filter.ROBUST:
        assert is_moving and {(True, False), (True, True)} <= seen and reference.b_hat == 0.9
    assert (reference.counters.updates > 0) == (mode != Filter.OFF)
