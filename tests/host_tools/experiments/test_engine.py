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
from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

from mcp_asdf.robot import B_HAT_MARGIN, Config, Filter, FirmwareError, Status
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.experiments import _engine
from mcp_asdf_tools.experiments.engine import native
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.results import QUANTITIES, Trials
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
from support import CORE, ROOT, require, run, slow
from trials import images_by_message

FULLY_CONNECTED = Experiment(
    robots=10, flawed=3, filter="asdf-plus", steps=400, filter_period=100, trials=3, seed=77
)
MOVING = Experiment(
    topology="dynamic",
    robots=9,
    flawed=3,
    filter="asdf-plus",
    density=3,
    steps=220,
    filter_period=50,
    seed=91,
    trials=3,
)
MOVING_WITH_LATENCY = replace(MOVING, latency=1)
FULLY_CONNECTED_ROBUST = replace(FULLY_CONNECTED, filter="robust")
MOVING_ROBUST = replace(MOVING, filter="robust")


# --- The lanes are the firmware to the bit ----------------------------------------------------------------


def differences_between_lanes_and_firmware(experiment: Experiment, trial_numbers: range) -> list[str]:
    """Run trials in lanes and call by call, and return what is not the same to the bit, and how to repeat it.

    In lanes the engine computes many trials or robots at once, in vectors. Call by call it calls the
    firmware's own functions for one robot after the other. Compared are estimates x, accuracies b_hat,
    counters, and the robots' whole states at the end.
    """
    first, trials = trial_numbers.start, len(trial_numbers)
    by_calls = native.run(experiment, first, trials, lanes=False)
    in_lanes = native.run(experiment, first, trials, lanes=True)
    pairs = {"x": (by_calls.x, in_lanes.x), "b_hat": (by_calls.b_hat, in_lanes.b_hat)}
    for name in native.COUNTERS:
        pairs[name] = (by_calls.counters[name], in_lanes.counters[name])
    names = [name for name, arrays in pairs.items() if not np.array_equal(*arrays)]
    if by_calls.images() != in_lanes.images():
        names.append("states at the end")
    replay = f"replay: {experiment.parameters()}, first {first}, trials {trials}"
    return [f"{name}; {replay}" for name in names]


RARE_WHITE: dict[str, Any] = {
    "robots": 3,
    "flawed": 0,
    "fill_ratio": 0.99998,
    "true_accuracy": 1.0,
    "filter": "none",
    "steps": 200_000,
    "filter_period": 200_000,
}
EXTREME_PARAMETERS: dict[str, dict[str, Any]] = {
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
"""Parameters at the ends of their ranges, or in rare combinations, by a name for each."""
EXTREMES_OF_LONG_TRIALS: dict[str, dict[str, Any]] = {
    "confidence at its largest": RARE_WHITE,
    "rare white under a nearly perfect sensor": {**RARE_WHITE, "flawed_accuracy": 1 - 2**-17, "flawed": 3},
    "long": {"robots": 2, "flawed": 1, "fill_ratio": 0.5, "steps": 2**18 + 100, "filter_period": 2**18},
}
EXTREMES_OF_MOVING_ROBOTS: dict[str, dict[str, Any]] = {
    "everybody in range": {"width": 3.0, "height": 2.0, "density": 1.0, "radio_range": 20.0},
    "seldom heard": {"density": 0.05},
    "code": {"floor": "code", "fill_ratio": 0.448},
}


EXTREMES_OF_THE_ROBUST_FILTER: dict[str, dict[str, Any]] = {
    "most votes": {"robots": 40, "steps": 600},
    "a floor that seems to change": {"drift": "linear", "drift_rate": -2e-3},
    "two robots, too few for a test": {"robots": 2, "flawed": 1},
    "nobody to hear": {"robots": 1, "flawed": 1},
}


def varied(experiment: Experiment, changes: Mapping[str, dict[str, Any]]) -> list[Experiment]:
    """Return copies of the experiment, one for each of these changes."""
    return [replace(experiment, **parameters) for parameters in changes.values()]


EXTREMES_OF_CONNECTED_ROBUST = EXTREME_PARAMETERS | EXTREMES_OF_THE_ROBUST_FILTER
EXTREMES_OF_MOVING = EXTREME_PARAMETERS | EXTREMES_OF_MOVING_ROBOTS
EXTREMES_OF_MOVING_ROBUST = EXTREMES_OF_MOVING | EXTREMES_OF_THE_ROBUST_FILTER


@pytest.mark.parametrize(
    "experiment",
    [
        *varied(FULLY_CONNECTED, EXTREME_PARAMETERS),
        *slow(varied(FULLY_CONNECTED, EXTREMES_OF_LONG_TRIALS)),
        *varied(FULLY_CONNECTED_ROBUST, EXTREMES_OF_CONNECTED_ROBUST),
        *varied(MOVING, EXTREMES_OF_MOVING),
        *varied(MOVING_WITH_LATENCY, EXTREMES_OF_MOVING),
        *varied(MOVING_ROBUST, EXTREMES_OF_MOVING_ROBUST),
        *varied(replace(MOVING_ROBUST, latency=1), EXTREMES_OF_MOVING_ROBUST),
    ],
)
def test_robots_computed_at_once_equal_the_firmware_to_the_bit(experiment: Experiment) -> None:
    """Fully connected swarms have a trial in each of 16 lanes: 17 trials are more than run at once.

    Of moving robots each lane has a robot. Trials need not begin with number 0.
    """
    trial_numbers = range(4, 7) if experiment.is_dynamic else range(4, 21)
    assert differences_between_lanes_and_firmware(experiment, trial_numbers) == []


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
                "steps": source.randint(1, 600),
                "seed": source.getrandbits(64),
                **source.choice([{}, world]),
            }
        )


@pytest.mark.parametrize("count", [30, *slow([120])])
def test_random_experiments_computed_at_once_equal_the_firmware_to_the_bit(count: int) -> None:
    """They have values from the whole range of each parameter; about half of the swarms move.

    The 16 lanes hold robots of one trial if these move, and two trials are run. If they do not move, each
    lane holds a trial, and two more trials are run than there are lanes.
    """
    for experiment in random_experiments(seed=20241, count=count):
        trial_count = 2 if experiment.is_dynamic else 16 + 2
        assert differences_between_lanes_and_firmware(experiment, trial_numbers=range(trial_count)) == []


class Mixed(Experiment):
    """Every third robot has no filter, the next one the robust filter, the next one the paper's."""

    def config(self, robot: int) -> Config:
        filters = (Filter.OFF, Filter.ROBUST, Filter.ADAPTIVE)
        return replace(super().config(robot), filter=filters[robot % 3])


MIXED_FILTERS = Mixed(**FULLY_CONNECTED.parameters())


def uses_lanes(experiment: Experiment, sampling_interval: int) -> bool:
    """Return whether the engine calculates the experiment in lanes; an interval of 0 records nothing."""
    call = native.EngineTrials(experiment, first=0, trials=1, sampling_interval=sampling_interval)
    return bool(_engine.lib.mcp_asdf_engine_has_lanes(call.experiment))


@pytest.mark.parametrize(
    ("experiment", "sampling_interval", "are_computed_at_once"),
    [
        *[
            (experiment, 0, True)
            for experiment in (
                FULLY_CONNECTED,
                MOVING_WITH_LATENCY,
                FULLY_CONNECTED_ROBUST,
                replace(MOVING_ROBUST, latency=1),
            )
        ],
        (FULLY_CONNECTED, 10, False),  # values are recorded over time
        (replace(FULLY_CONNECTED, comms_period=2), 0, False),
        (replace(FULLY_CONNECTED, message_bits="16+9"), 0, False),
        (MIXED_FILTERS, 0, False),  # robots have different filters
    ],
)
def test_trials_are_computed_at_once_if_only_their_results_are_wanted_and_lanes_have_all_they_need(
    experiment: Experiment, sampling_interval: int, are_computed_at_once: bool
) -> None:
    """Trials are computed at once in lanes, which lack records over time (a sampling interval above 0)."""
    assert uses_lanes(experiment, sampling_interval) == are_computed_at_once


CORE_FOLDER = CORE.parent
ENGINE_FOLDER = ROOT / "host_tools/mcp_asdf_tools/experiments/engine"
ARENA_FOLDER = ROOT / "host_tools/mcp_asdf_tools/world/arena"
OPTIONS_OF_COMPILER = (
    "-std=gnu99",
    "-O3",
    "-fPIC",
    "-shared",
    "-ffp-contract=off",
    "-fno-trapping-math",
    "-fno-math-errno",
    "-DFOR_EACH_TARGET=",  # one target only, that of -march
)


def build_engine(architecture: str, folder: Path, *more_options: str) -> Any:
    """Build the engine's extension module for the vectors of one architecture, and return it, imported.

    More options of the C compiler may be given.
    """
    glue, module_path = folder / "_engine.c", folder / "_engine.so"
    headers = [CORE_FOLDER / "mcp_asdf.h", CORE_FOLDER / "mcp_asdf_image.h"]
    headers += [ARENA_FOLDER / "arena.h", ENGINE_FOLDER / "engine.h"]
    run(sys.executable, ROOT / "firmware_py/build_native.py", _engine.__name__, glue, *headers)
    sources = [glue, *sorted(ENGINE_FOLDER.glob("*.c")), *sorted(ARENA_FOLDER.glob("*.c"))]
    sources += [CORE_FOLDER / name for name in ("mcp_asdf_image.c", "mcp_asdf_small.c")]
    include_folders = (CORE_FOLDER, ARENA_FOLDER, ENGINE_FOLDER, sysconfig.get_path("include"))
    includes = [f"-I{path}" for path in include_folders]
    options = [*OPTIONS_OF_COMPILER, f"-march={architecture}", *more_options, *includes]
    run(require("gcc", "gcc"), *options, *sources, "-o", module_path, "-lm")
    return import_module_from(module_path)


def import_module_from(path: Path) -> Any:
    """Import the engine's extension module from a file, and return it; the installed one stays as it is."""
    spec = importlib.util.spec_from_file_location(_engine.__name__, path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def processor_has(flag: str) -> bool:
    """Return whether Linux lists a flag of the processor, such as avx2."""
    return flag in Path("/proc/cpuinfo").read_text(encoding="ascii").split()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("architecture", "flag"), [("x86-64", "fpu"), ("x86-64-v3", "avx2"), ("x86-64-v4", "avx512vl")]
)
def test_an_engine_built_for_each_size_of_vectors_equals_the_firmware_to_the_bit(
    architecture: str, flag: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The test skips sizes that the processor lacks; /proc/cpuinfo has a flag for each size.

    An engine that was built for these vectors takes the place of the installed one. It computes experiments
    at the ends of parameters' ranges, with the 17 trials 4 to 20, which are more than the 16 lanes, and
    random experiments.
    """
    if not processor_has(flag):
        pytest.skip(f"this processor has no vectors of {architecture}")
    monkeypatch.setattr(native, "_engine", build_engine(architecture, tmp_path))
    for extreme_parameters in EXTREME_PARAMETERS.values():
        for swarm in (FULLY_CONNECTED, FULLY_CONNECTED_ROBUST, MOVING_WITH_LATENCY):
            experiment = replace(swarm, **extreme_parameters)
            assert differences_between_lanes_and_firmware(experiment, trial_numbers=range(4, 21)) == []
    for experiment in random_experiments(seed=20242, count=60):
        assert differences_between_lanes_and_firmware(experiment, trial_numbers=range(16)) == []


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
def test_robots_move_in_vectors_as_they_do_one_by_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The arena's source in C, compiled without vectors, is the definition of how robots move.

    Robots move 150 steps in 60 random worlds. All arrays of their motions are compared, such as positions.
    """
    worlds = list(random_worlds(seed=20261, count=60))
    motions_in_vectors = [Arena(settings, trial).record(ticks=150) for trial, settings in enumerate(worlds)]
    # From here on ``Arena`` moves robots by this build of its source, one robot after the other.
    monkeypatch.setattr(arena, "_arena", build_engine("x86-64", tmp_path, "-fno-tree-vectorize"))
    for trial, settings in enumerate(worlds):
        motion_in_vectors = motions_in_vectors[trial]
        motion_one_by_one = Arena(settings, trial).record(ticks=150)
        for array_name, expected_array in vars(motion_one_by_one).items():
            array = getattr(motion_in_vectors, array_name)
            assert np.array_equal(array, expected_array), f"replay: {settings}, {trial=}: {array_name}"


# --- The engine is the firmware run message by message -----------------------------------------------------


@pytest.mark.parametrize(
    "experiment",
    [
        FULLY_CONNECTED,
        replace(FULLY_CONNECTED, comms_period=5, filter="asdf-minus", observation_period=3),
        replace(FULLY_CONNECTED, activation="always", memory=64, robots=4),
        replace(FULLY_CONNECTED, sensor=cast(Any, WanderingSensors)),
        replace(FULLY_CONNECTED, robots=1, flawed=0),
        MOVING,
        MOVING_WITH_LATENCY,
        replace(MOVING_WITH_LATENCY, comms_period=5, observation_period=2),
        replace(MOVING_WITH_LATENCY, activation="always", memory=64, robots=4),
        replace(MOVING_WITH_LATENCY, floor="code", fill_ratio=0.448, observation_period=5, speed=0.1),
        FULLY_CONNECTED_ROBUST,
        replace(
            FULLY_CONNECTED_ROBUST,
            fill_ratio=0.95,
            true_accuracy=0.55,
            flawed_accuracy=0.95,
            memory=64,
            comms_period=5,
        ),
        replace(FULLY_CONNECTED_ROBUST, drift="linear", drift_rate=-1e-3, observation_period=2),
        MOVING_ROBUST,
        replace(MOVING_ROBUST, latency=1, comms_period=5, observation_period=2, density=8),
        replace(MIXED_FILTERS, topology="dynamic", density=3, latency=1),
        replace(MOVING_WITH_LATENCY, message_bits="16+9"),
        replace(MIXED_FILTERS, message_bits="2+1"),
    ],
)
def test_robots_of_the_engine_in_c_end_in_the_states_of_robots_in_python(experiment: Experiment) -> None:
    """The engine computes a whole trial at once; robots in Python (the mirror) receive message by message.

    Both compute with the integers of the firmware, so whole states are equal to the bit.
    """
    experiment_in_python = replace(experiment, firmware="mirror")
    states_in_c = native.run(experiment, first=1, trials=1).images()
    states_in_python = images_by_message(experiment_in_python, trial=1)
    assert states_in_c == states_in_python


@pytest.mark.parametrize(
    "experiment",
    [
        FULLY_CONNECTED,
        replace(MOVING_WITH_LATENCY, comms_period=5, observation_period=2),
        MOVING_ROBUST,
        MIXED_FILTERS,
    ],
)
def test_the_engine_in_c_measures_and_records_what_robots_in_python_compute(experiment: Experiment) -> None:
    """Values are recorded every 7 steps. Robots in Python (the mirror) are run message by message.

    Measured are a trial's results, and recorded are the robots' quantities over time.
    """
    experiment_in_python = replace(experiment, firmware="mirror")
    trials_in_c = run_trials(experiment, first=1, trials=1, sampling_interval=7)
    trials_in_python = run_trials(experiment_in_python, first=1, trials=1, sampling_interval=7)

    for result in ("convergence_steps", "errors", "b_hat", "tests", "updates"):
        assert np.array_equal(getattr(trials_in_c, result), getattr(trials_in_python, result)), result
    for quantity in QUANTITIES:
        assert np.array_equal(trials_in_c.records[quantity], trials_in_python.records[quantity]), quantity


def test_a_robot_s_own_estimate_and_confidence_are_not_rounded_with_its_messages() -> None:
    """x_hat, its own estimate, and alpha, its confidence in it, are the same whatever messages have.

    Rounded messages have one bit of each, which is "1+1". There is no filter that would react to them.
    """
    with_exact_messages = replace(FULLY_CONNECTED, filter="none", steps=20)
    with_rounded_messages = replace(with_exact_messages, message_bits="1+1")
    exact = run_trials(with_exact_messages, first=0, trials=1, sampling_interval=1).records
    rounded = run_trials(with_rounded_messages, first=0, trials=1, sampling_interval=1).records

    assert np.array_equal(exact["x_hat"], rounded["x_hat"])
    assert np.array_equal(exact["alpha"], rounded["alpha"])


def test_robots_that_calculate_in_floats_receive_rounded_messages() -> None:
    """Each of two robots receives one estimate, x_bar, which a code of one bit rounds to 0 or 1."""
    two_robots = replace(FULLY_CONNECTED, robots=2, flawed=0, filter="none", steps=20)
    experiment = replace(two_robots, message_bits="1+1", firmware="reference")
    x_bar = run_trials(experiment, first=0, trials=1, sampling_interval=1).records["x_bar"]

    [x_bar_by_step_and_robot] = x_bar.tolist()  # of the only trial
    _x_bar_at_start, *x_bar_after_steps = x_bar_by_step_and_robot
    for x_bar_of_robots in x_bar_after_steps:
        assert set(x_bar_of_robots) <= {0, 1}


@cache
def run_trial_in_floats(experiment: Experiment) -> Trials:
    """Return trial 0 of the reference, which calculates in floats, with values recorded in each step."""
    return run_trials(replace(experiment, firmware="reference"), first=0, trials=1, sampling_interval=1)


@pytest.mark.parametrize(
    "experiment",
    [
        FULLY_CONNECTED,
        MOVING_WITH_LATENCY,
        replace(FULLY_CONNECTED, fill_ratio=0.95, filter="asdf-minus", comms_period=5),
        replace(MOVING_WITH_LATENCY, fill_ratio=0.95, true_accuracy=0.75, activation="always"),
    ],
)
def test_the_reference_in_floats_stays_near_the_firmware_in_every_step(experiment: Experiment) -> None:
    """The firmware computes in integers. In both, each robot tests and re-estimates b_hat equally often."""
    integer_trials = run_trials(experiment, first=0, trials=1, sampling_interval=1)
    float_trials = run_trial_in_floats(experiment)

    assert np.array_equal(integer_trials.updates, float_trials.updates)
    assert np.array_equal(integer_trials.tests, float_trials.tests)
    for name in ("x_hat", "x_bar", "x", "b_hat"):
        assert float_trials.records[name] == pytest.approx(integer_trials.records[name], abs=1e-5), name


@pytest.mark.parametrize(("first", "trials", "sampling_interval"), [(0, 1, 0), (7, 5, 3), (19, 1, 0)])
@pytest.mark.parametrize(
    "experiment", [FULLY_CONNECTED, MOVING_WITH_LATENCY], ids=["fully connected", "moving"]
)
def test_a_trial_has_the_same_results_alone_and_among_others_and_with_recorded_values(
    experiment: Experiment, first: int, trials: int, sampling_interval: int
) -> None:
    """Some of 20 trials are run again, alone. So a sweep may be cut into jobs of any size.

    x and b_hat of these trials are the same to the bit. A sampling interval of 0 records nothing.
    """
    all_trials = native.run(experiment, first=0, trials=20)
    some_trials = native.run(experiment, first=first, trials=trials, sampling_interval=sampling_interval)
    end = first + trials
    assert np.array_equal(some_trials.x, all_trials.x[first:end])
    assert np.array_equal(some_trials.b_hat, all_trials.b_hat[first:end])


# --- Refusals --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("changes", [{"firmware": "mirror"}, {"latency": 1}])
def test_the_engine_in_c_refuses_robots_in_python_and_late_messages_of_fully_connected_swarms(
    changes: dict[str, Any],
) -> None:
    """Robots in Python have the firmware mirror. With a latency of 1, messages arrive a step late."""
    with pytest.raises(UsageError, match="the engine in C lacks this"):
        native.run(replace(FULLY_CONNECTED, **changes), first=0, trials=1)


def test_a_trial_whose_robots_find_no_room_in_their_arena_is_refused() -> None:
    """A corridor 25 cm wide is too narrow for 128 robots. It is refused before a robot moves."""
    corridor = replace(MOVING, robots=128, flawed=0, width=20.0, height=0.25, density=1.0, steps=1)
    with pytest.raises(UsageError, match=r"128 robots found no room in 20\.0 x 0\.25 m"):
        run_trials(corridor, first=0, trials=1)


class ExperimentWithBHatZero(Experiment):
    """An experiment that gives every robot the accuracy 0, which the firmware refuses."""

    def b_hat(self, robot: int) -> float:
        return 0.0


@pytest.mark.parametrize("lanes", [False, True])
def test_the_engine_raises_the_error_of_a_firmware_that_refuses_an_accuracy(lanes: bool) -> None:
    """Robots get the accuracy 0. The engine computes robots one by one or in lanes, many at once."""
    with pytest.raises(FirmwareError, match="ERR_B_HAT"):
        native.run(ExperimentWithBHatZero(steps=10), first=0, trials=1, lanes=lanes)


# --- Robots that lie --------------------------------------------------------------------------------------


def prepare_trial_with_two_liars(experiment: Experiment) -> native.EngineTrials:
    """Prepare a trial in which the last two robots broadcast x_hat 0 with an alpha of 10^6."""
    trial = native.EngineTrials(experiment, first=0, trials=1, sampling_interval=0)
    trial.experiment.liars = 2
    mantissa, shift = 16_000_000, 20  # in units of 2^-24, so alpha is 16 * 10^6 * 2^20 / 2^24 = 10^6
    alpha_word = (mantissa << 8) | shift
    trial.experiment.lie = [0, alpha_word]
    return trial


def estimates_with_two_liars_on_a_bus(experiment: Experiment) -> list[float]:
    """Return x of all robots after the same swarm with the fault ``liar``, in units of 2^-23."""
    fault = parse_fault(f"liar,robots={experiment.robots - 2}-{experiment.robots - 1},x=0,alpha=1e6")
    parameters = dict(experiment.parameters())
    for name in ("trials", "conventions", "message_bits"):  # a swarm on a bus does not have these
        del parameters[name]
    with Swarm(replace(SwarmSettings(**parameters), faults=(fault,)), Wiring()) as swarm:
        run_swarm(swarm, [])
        return [node.robot.x * 2**23 for node in swarm.nodes]


with_liars = pytest.mark.parametrize(
    "experiment", [replace(FULLY_CONNECTED, steps=120, trials=1), replace(MOVING_ROBUST, steps=120, trials=1)]
)


@with_liars
def test_robots_that_lie_have_the_same_effect_in_the_engine_as_on_a_bus(experiment: Experiment) -> None:
    """The last two broadcast that nothing is black, with an alpha of 10^6, which is great confidence.

    The engine computes robots one by one. The estimates x of all robots at the end are compared.
    """
    trial = prepare_trial_with_two_liars(experiment)
    assert trial.execute(lanes=False) is Status.OK  # lanes are of robots computed at once

    [x_by_robot_and_step] = trial.x  # of the only trial
    x_at_end = x_by_robot_and_step[:, -1]
    assert x_at_end.tolist() == estimates_with_two_liars_on_a_bus(experiment)


@with_liars
def test_trials_are_computed_one_by_one_if_robots_lie(experiment: Experiment) -> None:
    """A liar computes with its own true estimate, and the robots around it compute with its lie.

    Lanes, in which many trials or robots are computed at once, have only one estimate of a robot.
    """
    trial = prepare_trial_with_two_liars(experiment)
    experiment_in_c = trial.experiment  # as a struct of C, which the engine's functions take
    assert not _engine.lib.mcp_asdf_engine_has_lanes(experiment_in_c)


# --- More than 128 robots ----------------------------------------------------------------------------------

SWARM_OF_300 = replace(MOVING_WITH_LATENCY, robots=300, flawed=90, steps=150)
LONG_GRAPH = "; ".join(f"{i} {(i + 1) % 2100}; {i} > {(i + 2048) % 2100}" for i in range(2100))
"""A ring in which each robot also sends to the robot 2048 places further on."""
GRAPH_OF_2100 = replace(
    SWARM_OF_300, topology="graph", density=1.0, graph=LONG_GRAPH, robots=2100, flawed=630, steps=60
)
"""Its robots stand in many rows of lanes and receive from others far away in them."""


@pytest.mark.parametrize(
    "experiment",
    [
        SWARM_OF_300,
        replace(SWARM_OF_300, density=6, latency=0, filter="robust"),
        GRAPH_OF_2100,
        replace(GRAPH_OF_2100, latency=0, filter="robust", steps=30),
    ],
    ids=["many", "many, robust", "huge", "huge, robust"],
)
def test_hundreds_of_robots_computed_at_once_equal_the_firmware_to_the_bit(experiment: Experiment) -> None:
    """There are 300 that move, or 2100 in a graph, which take many rows of vectors."""
    assert differences_between_lanes_and_firmware(experiment, trial_numbers=range(1)) == []


def engine_bytes_per_robot(robots: int) -> float:
    """Return the memory that the engine needs for each robot of a trial."""
    experiment = replace(SWARM_OF_300, robots=robots, density=1, steps=10)
    call = native.EngineTrials(experiment, first=0, trials=1, sampling_interval=0)
    return float(_engine.lib.mcp_asdf_engine_bytes(call.experiment)) / robots


def test_memory_of_the_engine_grows_linearly_with_the_robots() -> None:
    """It needs 1000 to 2500 bytes per robot. In a large swarm this is the same number as in a small swarm."""
    bytes_in_small_swarm = engine_bytes_per_robot(robots=2048)
    bytes_in_large_swarm = engine_bytes_per_robot(robots=10_240)
    assert 1000 < bytes_in_large_swarm < 2500
    assert bytes_in_small_swarm == pytest.approx(bytes_in_large_swarm, rel=0.01)
