"""Experiments in the moving world: settings, floors, the engine's two ways and the firmware run in Python."""

from __future__ import annotations

import random
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest

from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.common.parameters import ParameterError
from mcp_asdf_tools.experiments.engine import native
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.experiment_files import read_experiments
from mcp_asdf_tools.experiments.results import experiments_in, read_table
from mcp_asdf_tools.experiments.sweep import Store, run_sweep
from mcp_asdf_tools.experiments.trials import run_trials
from mcp_asdf_tools.robots.population import Activation, Filtering
from mcp_asdf_tools.world import _arena
from mcp_asdf_tools.world.arena import Arena, config_values
from mcp_asdf_tools.world.floor_code import CODE_MODULES, code
from trials import check_that_the_engine_is_the_mirror

SHORT = Experiment(topology="dynamic", robots=9, flawed=3, density=3, steps=330, filter_period=50, seed=91)
LATE = replace(SHORT, latency=1)
PAIR = replace(SHORT, robots=2, flawed=1, width=2.0, height=1.5, density=1.0, radio_range=10.0)
"""Two robots that hear each other in every step: no other robot stands between them."""


# --- Settings --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("changes", "key", "words"),
    [
        ({"latency": 2}, "latency", "0 to 1"),
        ({"density": 0}, "density", "density is 0"),
        ({"density": float("nan")}, "density", "density is nan"),
        ({"density": 60}, "density", "9 robots of 0.1408 m are too many for 0.4"),
        ({"density": 1e-6, "radio_range": 100.0}, "density", "may be up to 1000 m"),
        ({"width": 3.0}, "density", "give one of them"),
        ({"width": 3.0, "density": 1}, "height", "give width and height"),
        ({"height": 3.0, "density": 1}, "width", "give width and height"),
        ({"width": 0.14, "height": 9.0, "density": 1}, "width", "too many"),
        ({"speed": 0.0}, "speed", "1e-06 to 0.814"),
        ({"speed": 0.9}, "speed", "1e-06 to 0.814"),
        ({"speed": 0.8, "steps_per_second": 9}, "steps_per_second", "must be 10 or more"),
        ({"tile": 1e-5}, "tile", "at most 100000"),
        ({"floor": "code", "tile": 0.02}, "tile", "without tiles"),
        ({"floor": "code", "fill_ratio": 0.44801}, "fill_ratio", "multiple of 0.0001"),
        ({"floor": "code", "fill_ratio": 0.99}, "fill_ratio", "can have"),
        ({"observation_period": 0}, "observation_period", "1 to"),
        ({"topology": "fully-connected"}, "density", "choose topology dynamic"),
    ],
)
def test_an_impossible_world_is_named(changes: dict[str, Any], key: str, words: str) -> None:
    with pytest.raises(ParameterError, match=words) as error:
        Experiment.from_parameters({**SHORT.parameters(), **changes})
    assert error.value.key == key


def test_the_density_makes_the_square() -> None:
    paper = Experiment(topology="dynamic", robots=20)
    assert paper.sides == pytest.approx((5.5486, 5.5486), abs=1e-4)
    assert replace(paper, density=1.0, width=3.0, height=2.0).sides == (3.0, 2.0)


def test_every_setting_reaches_the_arena() -> None:
    experiment = replace(
        PAIR, speed=0.1, radio_range=0.5, tile=0.02, steps_per_second=20, width=3.0353, height=3.0226
    )
    values, _ = config_values(experiment, 0, _arena.ffi)
    del values["seed"]
    assert values == {
        **{"width": 3.0353, "height": 3.0226, "speed": 0.1, "range": 0.5, "tick": 1 / 20, "robots": 2},
        **{"tile": 0.02, "fill_ratio": 0.55},
    }


def test_a_tick_is_as_long_as_said() -> None:
    """Free robots go as far in a second whatever a tick is."""
    moved = {}
    for rate in (5, 10, 40):
        arena = Arena(replace(PAIR, speed=0.1, width=50.0, height=50.0, steps_per_second=rate), 0)
        start = arena.positions
        arena.step(10 * rate)
        moved[rate] = np.linalg.norm(arena.positions - start, axis=1)
    assert moved[5] == pytest.approx([1.0, 1.0], abs=0.02)
    assert moved[40] == pytest.approx(moved[10], abs=0.01)


def test_trials_of_one_seed_see_the_same_motion() -> None:
    first = Arena(SHORT, 3)
    second = Arena(replace(SHORT, true_accuracy=0.6, filter="none"), 3)
    assert np.array_equal(first.positions, second.positions)
    for other in (Arena(SHORT, 4), Arena(replace(SHORT, seed=92), 3)):
        assert not np.array_equal(first.positions, other.positions)


# --- Floors ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("fill_ratio", [0.448, 0.1, 0.5, 0.5001, 0.8])
def test_a_code_has_exactly_its_share_of_black(fill_ratio: float) -> None:
    pattern = code(fill_ratio)
    assert pattern.shape == (CODE_MODULES, CODE_MODULES)
    assert pattern.sum() == round(fill_ratio * CODE_MODULES**2)
    assert not pattern[34:66, 34:66].any(), "the logo is white"
    for corner in (pattern[:7, :7], pattern[:7, -7:], pattern[-7:, :7]):
        assert corner.sum() == 33, "a finder pattern: 24 in its frame, 9 in its middle"
    for line in (pattern[6, 8:92], pattern[8:92, 6]):
        assert (line == (np.arange(84) % 2 == 0)).all(), "a timing line"


def test_what_robots_meet_on_the_code_is_its_share() -> None:
    """But for 0.01: robots come to the white logo more often than to the border."""
    (experiment, *_) = read_experiments(Path("physical"))
    shares = [Arena(experiment, trial).record(10_000).black.mean() for trial in range(20)]
    assert abs(np.mean(shares) - 0.448) < 0.01


# --- The engine's two ways and the mirror -----------------------------------------------------------------


def assert_equal_to_the_bit(experiment: Experiment, first: int, trials: int) -> native.EngineResults:
    plain = native.run(experiment, first, trials, lanes=False)
    lanes = native.run(experiment, first, trials, lanes=True)
    replay = f"replay: {experiment.parameters()}, first {first}, trials {trials}"
    assert np.array_equal(plain.x, lanes.x), replay
    assert np.array_equal(plain.b_hat, lanes.b_hat), replay
    assert plain.images() == lanes.images(), replay
    return plain


EDGES = {
    "paper": replace(SHORT, robots=20, density=1.0, flawed=6),
    "one robot": replace(SHORT, robots=1, flawed=1),
    "eight robots fill their lanes": replace(SHORT, robots=8),
    "128 robots": replace(SHORT, robots=128, flawed=40, steps=60, density=10.0),
    "everybody in range": replace(SHORT, width=3.0, height=2.0, density=1.0, radio_range=20.0),
    "no filter": replace(SHORT, filter="none"),
    "filter without a test": replace(SHORT, activation="always"),
    "filter every step": replace(SHORT, filter_period=1, steps=60),
    "longer period than the trial": replace(SHORT, filter_period=1000),
    "one step": replace(SHORT, steps=1),
    "only black": replace(SHORT, fill_ratio=1.0, true_accuracy=1.0),
    "uninformative sensors": replace(SHORT, flawed_accuracy=0.5, flawed=9),
    "inverted sensors": replace(SHORT, flawed_accuracy=0.2, true_accuracy=0.1),
    "memory forgets": replace(SHORT, memory=64),
    "memory and rare observations": replace(SHORT, memory=64, observation_period=3, filter_period=51),
    "rare observations": replace(SHORT, observation_period=7),
    "no observation": replace(SHORT, observation_period=400),
    "seldom heard": replace(SHORT, density=0.05),
    "code": replace(SHORT, floor="code", fill_ratio=0.448),
    "stepped drift": replace(SHORT, drift="stepped", drift_rate=-1e-3, drift_period=40),
    "drift of each robot's own": replace(SHORT, drift="wiener", drift_diffusion=0.01),
}


@pytest.mark.parametrize("latency", [0, 1])
@pytest.mark.parametrize("name", EDGES)
def test_lanes_equal_the_firmware_at_the_edges(name: str, latency: int) -> None:
    assert_equal_to_the_bit(replace(EDGES[name], latency=latency), first=4, trials=2)


def random_worlds(seed: int, count: int) -> Iterator[Experiment]:
    source = random.Random(seed)
    for _ in range(count):
        robots = source.choice([1, 2, 3, 8, 10, 20, 40])
        accuracies = [0.0, 0.05, 0.5, 0.55, 0.95, 1.0, source.random()]
        yield Experiment(
            topology="dynamic",
            robots=robots,
            flawed=source.randint(0, robots),
            fill_ratio=source.choice([0.0, 0.5, 0.55, 1.0, source.random()]),
            true_accuracy=source.choice(accuracies),
            flawed_accuracy=source.choice(accuracies),
            filter=source.choice(list(get_args(Filtering))),
            activation=source.choice(list(get_args(Activation))),
            filter_period=source.choice([3, 10, 97, 250]),
            memory=source.choice([64, 500, 2**31]),
            density=source.choice([0.3, 1.0, 5.0]),
            speed=source.choice([0.05, 0.1414, 0.5]),
            steps_per_second=source.choice([10, 12]),
            observation_period=source.choice([1, 1, 2, 5]),
            latency=source.choice([0, 1]),
            steps=source.randint(1, 700),
            seed=source.getrandbits(64),
        )


def test_lanes_equal_the_firmware_in_random_worlds() -> None:
    for experiment in random_worlds(20261, 60):
        assert_equal_to_the_bit(experiment, first=0, trials=2)


@pytest.mark.parametrize(
    "experiment",
    [
        SHORT,
        LATE,
        replace(SHORT, comms_period=5, filter="asdf-minus"),
        replace(LATE, comms_period=5, observation_period=2),
        replace(LATE, activation="always", memory=64, robots=4),
        replace(LATE, drift="wiener", drift_diffusion=0.02, drift_rate=-1e-4),
        replace(LATE, floor="code", fill_ratio=0.448, observation_period=5, speed=0.1),
        replace(SHORT, robots=1, flawed=0),
    ],
)
def test_engine_equals_the_mirror(experiment: Experiment) -> None:
    check_that_the_engine_is_the_mirror(experiment)


def test_recording_changes_nothing() -> None:
    for experiment in (SHORT, LATE):
        plain, recorded = run_trials(experiment, 0, 2), run_trials(experiment, 0, 2, sampling_interval=3)
        assert np.array_equal(plain.errors, recorded.errors)
        assert np.array_equal(plain.b_hat, recorded.b_hat)


def test_a_trial_does_not_depend_on_the_others() -> None:
    whole = native.run(LATE, 0, 5)
    for first, trials in ((0, 1), (2, 3)):
        part = native.run(LATE, first, trials)
        assert np.array_equal(part.x, whole.x[first : first + trials])


def test_an_arena_without_room_says_so() -> None:
    """A corridor that is hardly wider than a robot: its area is enough, but no robot can pass."""
    corridor = replace(SHORT, robots=128, flawed=0, width=20.0, height=0.25, density=1.0, steps=1)
    with pytest.raises(UsageError, match="found no room"):
        run_trials(corridor, 0, 1)


def test_results_hold_the_world_and_sweeps_go_on(tmp_path: Path) -> None:
    experiments = [
        replace(SHORT, trials=5, seed=2),
        replace(PAIR, trials=5, floor="code", fill_ratio=0.448),
    ]
    output = tmp_path / "moving.parquet"
    first = run_sweep(Store(output, [replace(each, trials=2) for each in experiments]), 1)
    assert len(first) == 4
    table = run_sweep(Store(output, experiments), 1)
    found = experiments_in(read_table(output))
    assert [trials.experiment for trials in found] == experiments
    for trials in found:
        alone = run_trials(trials.experiment, 0, 5)
        assert np.array_equal(trials.convergence_steps, alone.convergence_steps)
        assert np.array_equal(trials.b_hat, alone.b_hat)
    assert len(table) == 10


# --- What the world does ---------------------------------------------------------------------------------


def records_of(experiment: Experiment) -> dict[str, Any]:
    """Values by quantity, shape (T + 1, N), of one trial."""
    records = run_trials(experiment, 0, 1, sampling_interval=1).records
    return {name: values[0] for name, values in records.items()}


def test_two_robots_hear_each_other_at_once_or_a_step_late() -> None:
    """x is the mean of the own estimate and the other's, of this step or of the step before (eq. 7)."""
    for latency in (0, 1):
        seen = records_of(replace(PAIR, latency=latency, filter="none"))
        own_x, own_alpha = seen["x_hat"], seen["alpha"]
        past = slice(0, -1) if latency else slice(1, None)
        other_x, other_alpha = own_x[past, ::-1], own_alpha[past, ::-1]
        own_x, own_alpha = own_x[1:], own_alpha[1:]
        weight = own_alpha + other_alpha
        expected = (own_alpha * own_x + other_alpha * other_x) / np.where(weight == 0, 1, weight)
        assert np.abs(seen["x"][1:] - np.where(weight == 0, 0.5, expected)).max() < 1e-6
        assert np.abs(seen["beta"][1:] - other_alpha).max() < 1e-6


def test_only_links_of_the_step_carry_messages() -> None:
    experiment = replace(LATE, filter="none", robots=6, flawed=2, density=1.5)
    seen, arena = records_of(experiment), Arena(experiment, 0)
    heard = 0
    for step in range(1, experiment.steps + 1):
        arena.step()
        for robot in range(experiment.robots):
            near = sorted({*arena.links[(arena.links == robot).any(axis=1)].ravel().tolist()} - {robot})
            assert seen["beta"][step, robot] == pytest.approx(seen["alpha"][step - 1, near].sum(), rel=1e-6)
            heard += len(near)
    assert heard > 100, "otherwise nothing was tested"


def test_perfect_sensors_name_the_floor_and_inverted_ones_the_other_colour() -> None:
    for accuracy in (1.0, 0.0):
        experiment = replace(SHORT, true_accuracy=accuracy, lowest_accuracy=0.0, filter="none")
        floor = Arena(experiment, 0).record(experiment.steps).black
        blacks = np.diff(records_of(experiment)["n"], axis=0)
        assert np.array_equal(blacks, floor if accuracy else 1 - floor)


def test_a_sensor_errs_as_often_as_it_should() -> None:
    experiment = replace(SHORT, true_accuracy=0.8, filter="none", steps=3000, robots=20)
    floor = Arena(experiment, 0).record(experiment.steps).black
    right = np.diff(records_of(experiment)["n"], axis=0) == floor
    for colour in (0, 1):
        share = right[floor == colour]
        assert abs(share.mean() - 0.8) < 4 * (0.16 / share.size) ** 0.5


def test_a_drifting_sensor_errs_more_and_more() -> None:
    experiment = replace(SHORT, drift="linear", drift_rate=-1.5e-4, filter="none", steps=3000, robots=20)
    floor = Arena(experiment, 0).record(experiment.steps).black
    right = np.diff(records_of(experiment)["n"], axis=0) == floor
    for part, accuracy in ((slice(0, 600), 0.905), (slice(2400, 3000), 0.545)):
        share = right[part]
        assert abs(share.mean() - accuracy) < 4 * (0.25 / share.size) ** 0.5


def test_observations_come_as_often_as_asked() -> None:
    seen = records_of(replace(SHORT, observation_period=5))
    steps = np.arange(SHORT.steps + 1)
    assert np.array_equal(seen["t"], np.repeat(steps[:, None] // 5, 9, axis=1))


def test_float64_follows_the_firmware() -> None:
    own = run_trials(LATE, 0, 1, sampling_interval=1)
    other = run_trials(replace(LATE, firmware="reference"), 0, 1, sampling_interval=1)
    assert np.array_equal(own.updates, other.updates)
    for name in ("x_hat", "x_bar", "x", "b_hat"):
        assert np.abs(own.records[name] - other.records[name]).max() < 1e-5, name
