"""The C engine: trials in lanes, call by call, and message by message in Python have the same bits.

In lanes the engine calculates many trials or robots at once, one in each lane of the processor's vectors.
Call by call it calls the firmware for each robot.
"""

from __future__ import annotations

import importlib.util
import math
import random
import sys
import sysconfig
from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

from golden import assert_equals_golden_file
from mcp_asdf.native import NativeRobot
from mcp_asdf.robot import B_HAT_MARGIN, Config, Filter, FirmwareError, Observation, Status
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.experiments import _engine
from mcp_asdf_tools.experiments.engine import native
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.results import Trials
from mcp_asdf_tools.experiments.trials import run_trials
from mcp_asdf_tools.studies.ageing_sensors import UnequallyAgeingSensors, WanderingSensors
from mcp_asdf_tools.swarm.carrier import Wiring
from mcp_asdf_tools.swarm.fault_injection.parsing import parse_fault
from mcp_asdf_tools.swarm.run import run_swarm
from mcp_asdf_tools.swarm.settings import SwarmSettings
from mcp_asdf_tools.swarm.swarm import Swarm
from mcp_asdf_tools.world import arena
from mcp_asdf_tools.world.arena import Arena
from mcp_asdf_tools.world.settings import WorldSettings
from mcp_asdf_tools.world.world import World
from support import CORE, ROOT, require, run, slow
from trials import check_that_the_engine_is_the_mirror

SHORT = Experiment(robots=10, flawed=3, filter="asdf-plus", steps=700, filter_period=100, trials=3, seed=77)
MOVING = Experiment(
    topology="dynamic",
    robots=9,
    flawed=3,
    filter="asdf-plus",
    density=3,
    steps=330,
    filter_period=50,
    seed=91,
    trials=3,
)
LATE = replace(MOVING, latency=1)
ROBUST = replace(SHORT, filter="robust")
ROBUST_MOVING = replace(MOVING, filter="robust")


# --- The lanes are the firmware to the bit ----------------------------------------------------------------


def assert_equal_to_the_bit(experiment: Experiment, first: int, trials: int) -> None:
    """Check that trials have the same results, counters and final states in lanes and call by call."""
    by_calls = native.run(experiment, first, trials, lanes=False)
    in_lanes = native.run(experiment, first, trials, lanes=True)
    replay = f"replay: {experiment.parameters()}, first {first}, trials {trials}"
    assert np.array_equal(by_calls.x, in_lanes.x), replay
    assert np.array_equal(by_calls.b_hat, in_lanes.b_hat), replay
    for name in native.COUNTERS:
        assert np.array_equal(by_calls.counters[name], in_lanes.counters[name]), replay
    assert by_calls.images() == in_lanes.images(), replay


RARE_WHITE: dict[str, Any] = {
    "robots": 3,
    "flawed": 0,
    "fill_ratio": 0.99998,
    "true_accuracy": 1.0,
    "filter": "none",
    "steps": 200_000,
    "filter_period": 200_000,
}
EDGES: dict[str, dict[str, Any]] = {
    "128 robots": {"robots": 128, "flawed": 40, "steps": 60},
    "only black": {"fill_ratio": 1.0, "true_accuracy": 1.0},
    "barely informative": {"flawed_accuracy": 0.5 + 2**-13},
    "accuracies at their ends": {"flawed_accuracy": 0.0, "true_accuracy": 1.0, "fill_ratio": 0.9},
    "low accuracy at its end": {"true_accuracy": 0.0, "flawed_accuracy": B_HAT_MARGIN},
    "memory ends a period": {"memory": 200},
    "filter every step": {"filter_period": 1, "steps": 60},
    "one step": {"steps": 1},
    "no observation": {"observation_period": 900},
    "linear drift": {"drift": "linear", "drift_rate": -5e-4},
    "sensors that age each in its own way": {"sensor": WanderingSensors},
    "sensors that age at rates of their own": {"sensor": UnequallyAgeingSensors},
}
LONG_EDGES: dict[str, dict[str, Any]] = {
    "confidence at its largest": RARE_WHITE,
    "rare white under a nearly perfect sensor": {**RARE_WHITE, "flawed_accuracy": 1 - 2**-17, "flawed": 3},
    "long": {"robots": 2, "flawed": 1, "fill_ratio": 0.5, "steps": 2**18 + 100, "filter_period": 2**18},
}
MOVING_EDGES: dict[str, dict[str, Any]] = {
    "everybody in range": {"width": 3.0, "height": 2.0, "density": 1.0, "radio_range": 20.0},
    "seldom heard": {"density": 0.05},
    "code": {"floor": "code", "fill_ratio": 0.448},
}


ROBUST_EDGES: dict[str, dict[str, Any]] = {
    "most votes": {"robots": 40, "steps": 600},
    "a floor that seems to change": {"drift": "linear", "drift_rate": -2e-3},
    "two robots, too few for a test": {"robots": 2, "flawed": 1},
    "nobody to hear": {"robots": 1, "flawed": 1},
}


TRIALS_BEYOND_LANES = 17
"""One more than the 16 lanes, in which trials of robots that do not move are calculated."""
MOVING_TRIALS = 10

# Lanes are the engine's fast way: it computes many trials or robots at once, in vectors. Each test compares
# their results with those of the firmware's own functions, called for one robot after the other.
in_every_edge = pytest.mark.parametrize("changes", EDGES.values(), ids=EDGES)
in_every_moving_edge = pytest.mark.parametrize(
    "changes", [*EDGES.values(), *MOVING_EDGES.values()], ids=[*EDGES, *MOVING_EDGES]
)
in_every_robust_edge = pytest.mark.parametrize("changes", ROBUST_EDGES.values(), ids=ROBUST_EDGES)
with_every_latency = pytest.mark.parametrize("latency", [0, 1])


@in_every_edge
def test_many_trials_computed_at_once_equal_the_firmware_to_the_bit(changes: dict[str, Any]) -> None:
    """For parameters at the ends of their ranges. The firmware is called for one robot after the other."""
    assert_equal_to_the_bit(replace(SHORT, **changes), first=4, trials=TRIALS_BEYOND_LANES)


@pytest.mark.slow
@pytest.mark.parametrize("changes", LONG_EDGES.values(), ids=LONG_EDGES)
def test_long_trials_computed_at_once_equal_the_firmware_to_the_bit(changes: dict[str, Any]) -> None:
    assert_equal_to_the_bit(replace(SHORT, **changes), first=4, trials=TRIALS_BEYOND_LANES)


@with_every_latency
@in_every_moving_edge
def test_moving_robots_computed_at_once_equal_the_firmware_to_the_bit(
    changes: dict[str, Any], latency: int
) -> None:
    experiment = replace(MOVING, **changes, latency=latency)
    assert_equal_to_the_bit(experiment, first=4, trials=MOVING_TRIALS)


@in_every_edge
def test_trials_with_the_robust_filter_computed_at_once_equal_the_firmware_to_the_bit(
    changes: dict[str, Any],
) -> None:
    assert_equal_to_the_bit(replace(ROBUST, **changes), first=4, trials=TRIALS_BEYOND_LANES)


@in_every_robust_edge
def test_extreme_swarms_with_the_robust_filter_computed_at_once_equal_the_firmware_to_the_bit(
    changes: dict[str, Any],
) -> None:
    """The swarms have one robot, two, forty, or robots whose sensors age."""
    assert_equal_to_the_bit(replace(ROBUST, **changes), first=4, trials=TRIALS_BEYOND_LANES)


@with_every_latency
@in_every_moving_edge
def test_moving_robots_with_the_robust_filter_computed_at_once_equal_the_firmware_to_the_bit(
    changes: dict[str, Any], latency: int
) -> None:
    experiment = replace(ROBUST_MOVING, **changes, latency=latency)
    assert_equal_to_the_bit(experiment, first=4, trials=MOVING_TRIALS)


@with_every_latency
@in_every_robust_edge
def test_extreme_moving_swarms_with_the_robust_filter_equal_the_firmware_to_the_bit(
    changes: dict[str, Any], latency: int
) -> None:
    """The swarms have one robot, two, forty, or robots whose sensors age. All are computed at once."""
    experiment = replace(ROBUST_MOVING, **changes, latency=latency)
    assert_equal_to_the_bit(experiment, first=4, trials=MOVING_TRIALS)


def random_experiments(seed: int, count: int) -> Iterator[Experiment]:
    """Yield experiments with values from the whole range of each parameter, about half of them moving."""
    source = random.Random(seed)
    for _ in range(count):
        robots = source.choice([1, 2, 3, 8, 10, 20, 40])
        accuracies = [0.0, 0.05, 0.5, 0.55, 0.95, 0.99999, 1.0, source.random(), source.random()]
        world: dict[str, Any] = {
            "topology": "dynamic",
            "density": source.choice([0.3, 1.0, 5.0]),
            "speed": source.choice([0.05, 0.1414, 0.5]),
            "steps_per_second": source.choice([10, 12]),
            "latency": source.choice([0, 1]),
        }
        yield Experiment(
            **{
                "robots": robots,
                "flawed": source.randint(0, robots),
                "fill_ratio": source.choice([0.0, 0.5, 0.55, 0.95, 1.0, source.random()]),
                "true_accuracy": source.choice(accuracies),
                "flawed_accuracy": source.choice(accuracies),
                "filter": source.choice(["none", "asdf-minus", "asdf-plus", "robust"]),
                "activation": source.choice(["adaptive", "always"]),
                "filter_period": source.choice([3, 10, 97, 250]),
                "observation_period": source.choice([1, 1, 2, 5]),
                "omega": source.choice([0.05, 0.25, 0.9]),
                "memory": source.choice([64, 500, 2**31]),
                "steps": source.randint(1, 1000),
                "seed": source.getrandbits(64),
                **source.choice([{}, world]),
            }
        )


@pytest.mark.parametrize("count", [30, *slow([120])])
def test_random_experiments_computed_at_once_equal_the_firmware_to_the_bit(count: int) -> None:
    for experiment in random_experiments(20241, count):
        assert_equal_to_the_bit(experiment, first=0, trials=2 if experiment.is_dynamic else 18)


class Mixed(Experiment):
    """Every third robot has no filter, the next one the robust filter, the next one the paper's."""

    def config(self, robot: int) -> Config:
        filters = (Filter.OFF, Filter.ROBUST, Filter.ADAPTIVE)
        return replace(super().config(robot), filter=filters[robot % 3])


MIXED = Mixed(**SHORT.parameters())


def has_lanes(experiment: Experiment, sampling_interval: int = 0) -> bool:
    """Return whether the engine calculates the experiment in lanes; an interval of 0 records nothing."""
    call = native.EngineTrials(experiment, 0, 1, sampling_interval)
    return bool(_engine.lib.mcp_asdf_engine_has_lanes(call.experiment))


@pytest.mark.parametrize("experiment", [SHORT, LATE, ROBUST, replace(ROBUST_MOVING, latency=1)])
def test_trials_are_computed_at_once_if_only_their_results_are_wanted(experiment: Experiment) -> None:
    assert has_lanes(experiment)


def test_trials_are_computed_one_by_one_if_values_are_recorded() -> None:
    assert not has_lanes(SHORT, sampling_interval=10)


def test_trials_are_computed_one_by_one_if_robots_do_not_broadcast_in_every_step() -> None:
    assert not has_lanes(replace(SHORT, comms_period=2))


def test_trials_are_computed_one_by_one_if_messages_are_rounded() -> None:
    assert not has_lanes(replace(SHORT, message_bits="16+9"))


def test_trials_are_computed_one_by_one_if_robots_have_different_filters() -> None:
    assert not has_lanes(MIXED)


def engine_for(architecture: str, folder: Path, *more: str) -> Any:
    """Build the engine's extension module for the vectors of one architecture, and return it, imported."""
    tools = ROOT / "host_tools/mcp_asdf_tools"
    arena, engine, core = tools / "world/arena", tools / "experiments/engine", CORE.parent
    glue, module = folder / "_engine.c", folder / "_engine.so"
    headers = (core / "mcp_asdf.h", core / "mcp_asdf_image.h", arena / "arena.h", engine / "engine.h")
    run(sys.executable, ROOT / "firmware_py/build_native.py", _engine.__name__, glue, *headers)
    includes = [f"-I{path}" for path in (core, arena, engine, sysconfig.get_path("include"))]
    options_of_core = (core / "mcp_asdf_image.c", core / "mcp_asdf_small.c")
    sources = (glue, *sorted(engine.glob("*.c")), *sorted(arena.glob("*.c")), *options_of_core)
    floats = ("-ffp-contract=off", "-fno-trapping-math", "-fno-math-errno")
    options = ("-std=gnu99", "-O3", "-fPIC", "-shared", *floats)
    target = ("-DFOR_EACH_TARGET=", f"-march={architecture}")
    run(require("gcc", "gcc"), *options, *more, *target, *includes, *sources, "-o", module, "-lm")
    spec = importlib.util.spec_from_file_location(_engine.__name__, module)
    assert spec is not None and spec.loader is not None
    built_module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(built_module)
    return built_module


def processor_has(flag: str) -> bool:
    """Return whether Linux lists a flag of the processor, such as avx2."""
    return flag in Path("/proc/cpuinfo").read_text(encoding="ascii").split()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("architecture", "flag"), [("x86-64", "fpu"), ("x86-64-v3", "avx2"), ("x86-64-v4", "avx512vl")]
)
def test_vectors_of_every_size_of_a_processor_equal_the_firmware_to_the_bit(
    architecture: str, flag: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if not processor_has(flag):
        pytest.skip(f"this processor has no vectors of {architecture}")
    monkeypatch.setattr(native, "_engine", engine_for(architecture, tmp_path))
    for changes in EDGES.values():
        assert_equal_to_the_bit(replace(SHORT, **changes), first=4, trials=17)
        assert_equal_to_the_bit(replace(LATE, **changes), first=4, trials=2)
        assert_equal_to_the_bit(replace(ROBUST, **changes), first=4, trials=17)
    for experiment in random_experiments(20242, 60):
        assert_equal_to_the_bit(experiment, first=0, trials=16)


def random_worlds(seed: int, count: int) -> Iterator[WorldSettings]:
    """Yield worlds of 1 to 127 robots, in a crowd or far apart, on floors of tiles or of an image."""
    source = random.Random(seed)
    floors: list[dict[str, Any]] = [{"fill_ratio": 0.4, "tile": 0.02}, {"fill_ratio": 0.448, "floor": "code"}]
    for _ in range(count):
        robots = source.choice([1, 2, 7, 8, 9, 31, 32, 33, 64, 65, 100, 127])
        side = 0.5 + math.sqrt(robots * source.choice([0.06, 0.3, 1.5]))
        yield WorldSettings(
            topology="dynamic",
            robots=robots,
            width=side * source.uniform(1, 1.3),
            height=side,
            speed=source.choice([0.05, 0.1414, 0.8]),
            radio_range=source.choice([0.2, 0.7, 20.0]),
            **source.choice(floors),
        )


@pytest.mark.slow
def test_robots_move_in_vectors_as_one_by_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The arena's source, compiled without vectors, is the definition."""
    worlds = list(random_worlds(20261, 60))
    motions = [Arena(settings, trial).record(150) for trial, settings in enumerate(worlds)]
    monkeypatch.setattr(arena, "_arena", engine_for("x86-64", tmp_path, "-fno-tree-vectorize"))
    for trial, (settings, motion) in enumerate(zip(worlds, motions, strict=True)):
        motion_without_vectors = Arena(settings, trial).record(150)
        for name, expected in vars(motion_without_vectors).items():
            replay = f"replay: {settings}, trial {trial}: {name}"
            assert np.array_equal(getattr(motion, name), expected), replay


# --- The engine is the firmware run message by message -----------------------------------------------------


@pytest.mark.parametrize(
    "experiment",
    [
        SHORT,
        replace(SHORT, comms_period=5, filter="asdf-minus", observation_period=3),
        replace(SHORT, activation="always", memory=64, robots=4),
        replace(SHORT, sensor=cast(Any, WanderingSensors)),
        replace(SHORT, robots=1, flawed=0),
        MOVING,
        LATE,
        replace(MOVING, comms_period=5, filter="asdf-minus"),
        replace(LATE, comms_period=5, observation_period=2),
        replace(LATE, activation="always", memory=64, robots=4),
        replace(LATE, floor="code", fill_ratio=0.448, observation_period=5, speed=0.1),
        ROBUST,
        replace(ROBUST, fill_ratio=0.95, true_accuracy=0.55, flawed_accuracy=0.95, memory=64, comms_period=5),
        replace(ROBUST, drift="linear", drift_rate=-1e-3, observation_period=2),
        ROBUST_MOVING,
        replace(ROBUST_MOVING, latency=1, density=8),
        replace(ROBUST_MOVING, latency=1, comms_period=5, observation_period=2),
        MIXED,
        replace(MIXED, topology="dynamic", density=3, latency=1),
        replace(SHORT, message_bits="7+4"),
        replace(LATE, message_bits="16+9"),
        replace(MIXED, message_bits="2+1"),
    ],
)
def test_the_fast_engine_in_c_computes_what_robots_in_python_do_message_by_message(
    experiment: Experiment,
) -> None:
    """The engine simulates a whole experiment at once; the robots in Python send and receive each message.

    Both compute with the integers of the firmware, so all results are equal, bit for bit.
    """
    check_that_the_engine_is_the_mirror(experiment)


@pytest.mark.parametrize("experiment", [SHORT, LATE, ROBUST_MOVING])
def test_messages_of_the_most_bits_change_estimates_by_less_than_a_hundred_thousandth(
    experiment: Experiment,
) -> None:
    exact_x = run_trials(experiment, 0, 1, sampling_interval=10).records["x"]
    rounded_x = run_trials(replace(experiment, message_bits="23+25"), 0, 1, sampling_interval=10).records["x"]
    assert np.abs(exact_x - rounded_x).max() < 1e-5


def test_messages_of_three_bits_change_estimates_by_more_than_a_tenth() -> None:
    exact_x = run_trials(LATE, 0, 1, sampling_interval=10).records["x"]
    rounded_x = run_trials(replace(LATE, message_bits="2+1"), 0, 1, sampling_interval=10).records["x"]
    assert np.abs(exact_x - rounded_x).max() > 0.1


def test_robots_round_what_they_send_and_not_their_own_estimates() -> None:
    experiment = replace(SHORT, message_bits="1+1", filter="none", steps=20)
    exact = run_trials(replace(experiment, message_bits="exact"), 0, 1, sampling_interval=1).records
    rounded = run_trials(experiment, 0, 1, sampling_interval=1).records

    assert np.array_equal(exact["x_hat"], rounded["x_hat"])
    assert np.array_equal(exact["alpha"], rounded["alpha"])


def test_robots_that_calculate_in_floats_receive_rounded_messages() -> None:
    """Each of two robots receives one estimate, rounded by a code of one bit to 0 or 1: its x_bar."""
    two_robots = replace(SHORT, robots=2, flawed=0, filter="none", steps=20)
    experiment = replace(two_robots, message_bits="1+1", firmware="reference")
    x_bar = run_trials(experiment, 0, 1, sampling_interval=1).records["x_bar"]
    assert set(np.unique(x_bar[:, 1:])) <= {0.0, 1.0}, "the codes of one bit"


@cache
def reference_trial(experiment: Experiment) -> Trials:
    """Return trial 0 of the reference, which calculates in floats, with values recorded in each step."""
    return run_trials(replace(experiment, firmware="reference"), 0, 1, sampling_interval=1)


@pytest.mark.parametrize(
    "experiment",
    [
        SHORT,
        LATE,
        replace(SHORT, fill_ratio=0.95, filter="asdf-minus", comms_period=5),
        replace(LATE, fill_ratio=0.95, true_accuracy=0.75, activation="always"),
    ],
)
def test_the_reference_in_floats_follows_the_firmware_step_by_step(experiment: Experiment) -> None:
    native_trials = run_trials(experiment, 0, 1, sampling_interval=1)
    reference_trials = reference_trial(experiment)
    assert np.array_equal(native_trials.updates, reference_trials.updates)
    assert np.array_equal(native_trials.tests, reference_trials.tests)
    for name in ("x_hat", "x_bar", "x", "b_hat"):
        deviation = np.abs(native_trials.records[name] - reference_trials.records[name]).max()
        assert deviation < 1e-5, name


def b_hat_by_the_authors(experiment: Experiment) -> Any:
    """Return b_hat in trial 0 of the reference by the conventions of the paper's authors."""
    return run_trials(replace(experiment, firmware="reference", conventions="authors"), 0, 1).b_hat


@pytest.mark.parametrize(
    "experiment", [SHORT, LATE, replace(SHORT, fill_ratio=0.95, filter="asdf-minus", comms_period=5)]
)
def test_the_conventions_of_the_paper_s_authors_change_when_robots_recalibrate(
    experiment: Experiment,
) -> None:
    """Their programs take the threshold of the test for another number of messages."""
    assert not np.array_equal(b_hat_by_the_authors(experiment), reference_trial(experiment).b_hat)


def test_the_conventions_of_the_paper_s_authors_change_nothing_without_the_test() -> None:
    experiment = replace(LATE, fill_ratio=0.95, true_accuracy=0.75, activation="always")
    assert np.array_equal(b_hat_by_the_authors(experiment), reference_trial(experiment).b_hat)


@pytest.mark.parametrize(("first", "trials", "sampling_interval"), [(0, 1, 0), (7, 5, 3), (19, 1, 0)])
@pytest.mark.parametrize("experiment", [SHORT, LATE], ids=["fully connected", "moving"])
def test_a_trial_is_the_same_alone_and_among_others_and_with_recorded_values(
    experiment: Experiment, first: int, trials: int, sampling_interval: int
) -> None:
    """So a sweep may be cut into jobs of any size."""
    all_trials = native.run(experiment, 0, 20)
    some_trials = native.run(experiment, first, trials, sampling_interval)
    assert np.array_equal(some_trials.x, all_trials.x[first : first + trials])
    assert np.array_equal(some_trials.b_hat, all_trials.b_hat[first : first + trials])


# --- Refusals --------------------------------------------------------------------------------------------


def test_the_engine_refuses_robots_of_python() -> None:
    with pytest.raises(UsageError, match="the engine in C lacks this"):
        native.run(replace(SHORT, firmware="mirror"), 0, 1)


def test_the_engine_refuses_latency_in_fully_connected_swarms() -> None:
    with pytest.raises(UsageError, match="the engine in C lacks this"):
        native.run(replace(SHORT, latency=1), 0, 1)


def test_a_trial_whose_robots_find_no_room_is_refused() -> None:
    corridor = replace(MOVING, robots=128, flawed=0, width=20.0, height=0.25, density=1.0, steps=1)
    with pytest.raises(UsageError, match=r"128 robots found no room in 20.0 x 0.25 m"):
        run_trials(corridor, 0, 1)


class ExperimentWithIllegalBHat(Experiment):
    """Gives every robot an accuracy that the firmware refuses."""

    def b_hat(self, robot: int) -> float:
        return 0.0


@pytest.mark.parametrize("lanes", [False, True])
def test_an_accuracy_that_the_firmware_refuses_is_an_error_of_the_engine(lanes: bool) -> None:
    with pytest.raises(FirmwareError, match="ERR_B_HAT"):
        native.run(ExperimentWithIllegalBHat(steps=10), 0, 1, lanes=lanes)


# --- Robots that lie --------------------------------------------------------------------------------------


def call_with_two_liars(experiment: Experiment) -> native.EngineTrials:
    """Return a call of the engine in which the last two robots broadcast x_hat 0 with an alpha of 10^6."""
    call = native.EngineTrials(experiment, 0, 1, 0)
    call.experiment.liars = 2
    alpha_word = (16_000_000 << 8) | 20  # mantissa 16 * 10^6 and shift 20, in units of 2^-24: 10^6
    call.experiment.lie = [0, alpha_word]
    return call


def estimates_with_two_liars_on_a_bus(experiment: Experiment) -> list[float]:
    """Return x of all robots after the same swarm with the fault ``liar``, in units of 2^-23."""
    fault = parse_fault(f"liar,robots={experiment.robots - 2}-{experiment.robots - 1},x=0,alpha=1e6")
    parameters = dict(experiment.parameters())
    for name in ("trials", "conventions", "message_bits"):  # a swarm on a bus does not have these
        del parameters[name]
    with Swarm(replace(SwarmSettings(**parameters), faults=(fault,)), Wiring()) as swarm:
        run_swarm(swarm, [])
        return [node.robot.x * 2**23 for node in swarm.nodes]


SHORT_WITH_LIARS = replace(SHORT, steps=120, trials=1)
ROBUST_MOVING_WITH_LIARS = replace(ROBUST_MOVING, steps=120, trials=1)
with_liars = pytest.mark.parametrize("experiment", [SHORT_WITH_LIARS, ROBUST_MOVING_WITH_LIARS])


@with_liars
def test_robots_that_lie_have_the_same_effect_in_the_engine_as_on_a_bus(experiment: Experiment) -> None:
    """The last two broadcast that nothing is black, with an alpha of 10^6."""
    call = call_with_two_liars(experiment)
    assert call.execute(lanes=False) is Status.OK
    x_at_end = call.x[0, :, -1]  # of trial 0, by robot
    assert x_at_end.tolist() == estimates_with_two_liars_on_a_bus(experiment)


@with_liars
def test_trials_are_computed_one_by_one_if_robots_lie(experiment: Experiment) -> None:
    """A liar receives other estimates than the robots around it, as it knows the truth about itself."""
    assert not _engine.lib.mcp_asdf_engine_has_lanes(call_with_two_liars(experiment).experiment)


# --- More than 128 robots ----------------------------------------------------------------------------------

MANY = replace(LATE, robots=300, flawed=90, steps=150)
LONG_GRAPH = "; ".join(f"{i} {(i + 1) % 2100}; {i} > {(i + 2048) % 2100}" for i in range(2100))
"""A ring in which each robot also sends to the one 2048 places further on."""
HUGE = replace(MANY, topology="graph", density=1.0, graph=LONG_GRAPH, robots=2100, flawed=630, steps=60)
"""Its robots stand in many rows of lanes and receive from others far away in them."""


@pytest.mark.parametrize(
    "experiment",
    [
        MANY,
        replace(MANY, density=6, latency=0, filter="robust"),
        HUGE,
        replace(HUGE, latency=0, filter="robust", steps=30),
    ],
    ids=["many", "many, robust", "huge", "huge, robust"],
)
def test_hundreds_of_robots_computed_at_once_equal_the_firmware_to_the_bit(experiment: Experiment) -> None:
    assert_equal_to_the_bit(experiment, first=0, trials=1)


@pytest.mark.parametrize("filter_name", ["robust", "asdf-plus"])
def test_the_results_of_127_robots_are_the_same_bits_in_every_version(filter_name: Any) -> None:
    experiment = replace(LATE, robots=127, flawed=38, density=1, steps=600, filter_period=100, seed=5)
    trials = native.run(replace(experiment, filter=filter_name), 0, 1)
    images = trials.images()
    final_states = [
        f"robot {robot}: b_hat {trials.b_hat[0, -1, robot]}, image {images[robot].hex()}"
        for robot in range(0, 127, 6)
    ]
    assert_equals_golden_file(f"engine_{filter_name}.txt", final_states)


def run_with_ids_that_differ(experiment: Experiment) -> list[NativeRobot]:
    """Run 60 steps of trial 0 with robots that know their neighbours by different ids, and return the robots.

    The ids are those of the experiment modulo 32, which is all that votes look at, and above them a number
    that differs among the neighbours of a robot.
    """
    robot_indices = range(experiment.robots)
    robots = [NativeRobot(experiment.config(i), i % 32, experiment.b_hat(i)) for i in robot_indices]
    links = experiment.graph.links
    senders = [sorted(sender for sender, receiver in links if receiver == i) for i in robot_indices]
    for is_black in World(experiment).advance(60).black.tolist():
        for robot, observation in zip(robots, is_black, strict=True):
            robot.observe(Observation(observation))
        broadcasts = [(robot.x_hat_raw, robot.alpha_raw) for robot in robots]
        for robot, senders_of_robot in zip(robots, senders, strict=True):
            for neighbour_index, sender in enumerate(senders_of_robot):
                x_hat, alpha = broadcasts[sender]
                sender_id = 32 * (neighbour_index % 3 + 1) + sender % 32
                robot.receive_raw(sender_id, x_hat, alpha)
            robot.settle()
    return robots


@pytest.mark.parametrize("filter_name", ["asdf-plus", "robust"])
def test_robots_with_the_same_id_of_7_bits_are_different_neighbours_in_a_graph(filter_name: Any) -> None:
    """Robots 0, 128 and 256, whose ids of 7 bits are all 0, receive from each other."""
    triangle = ["0 128", "128 256", "0 256"]
    chain = [f"{i} {i + 1}; {i} > {i + 3}" for i in range(257)]
    experiment = replace(
        HUGE,
        graph="; ".join(triangle + chain),
        robots=260,
        flawed=80,
        latency=0,
        filter=filter_name,
        steps=60,
        filter_period=20,
    )
    robots = run_with_ids_that_differ(experiment)
    trials = run_trials(experiment, 0, 1, sampling_interval=60)

    assert trials.records["x"][0, -1].tolist() == [robot.x for robot in robots]
    assert trials.b_hat[0, -1].tolist() == [robot.b_hat for robot in robots]


def engine_bytes_per_robot(robots: int) -> float:
    """Return the memory that the engine needs for each robot of a trial."""
    experiment = replace(MANY, robots=robots, density=1, steps=10)
    call = native.EngineTrials(experiment, 0, 1, 0)
    return float(_engine.lib.mcp_asdf_engine_bytes(call.experiment)) / robots


def test_memory_of_the_engine_grows_linearly_with_the_robots() -> None:
    assert 1000 < engine_bytes_per_robot(10_240) < 2500
    assert engine_bytes_per_robot(2048) == pytest.approx(engine_bytes_per_robot(10_240), rel=0.01)
