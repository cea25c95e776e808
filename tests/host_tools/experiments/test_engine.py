"""The C engine: trials in lanes, call by call, and message by message in Python have the same bits."""

from __future__ import annotations

import hashlib
import importlib.util
import math
import random
import sys
import sysconfig
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

from mcp_asdf.native import NativeRobot
from mcp_asdf.robot import B_HAT_MARGIN, Config, Filter, FirmwareError, Observation, Status
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.experiments import _engine
from mcp_asdf_tools.experiments.engine import native
from mcp_asdf_tools.experiments.experiment import Experiment
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
BOTH = pytest.mark.parametrize("experiment", [SHORT, LATE])


# --- The lanes are the firmware to the bit ----------------------------------------------------------------


def assert_equal_to_the_bit(experiment: Experiment, first: int, trials: int) -> None:
    plain = native.run(experiment, first, trials, lanes=False)
    lanes = native.run(experiment, first, trials, lanes=True)
    replay = f"replay: {experiment.parameters()}, first {first}, trials {trials}"
    assert np.array_equal(plain.x, lanes.x), replay
    assert np.array_equal(plain.b_hat, lanes.b_hat), replay
    for name in native.COUNTERS:
        assert np.array_equal(plain.counters[name], lanes.counters[name]), replay
    assert plain.images() == lanes.images(), replay


RARE: dict[str, Any] = {
    **{"robots": 3, "flawed": 0, "fill_ratio": 0.99998, "true_accuracy": 1.0, "filter": "none"},
    **{"steps": 200_000, "filter_period": 200_000},
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
FULL_EDGES: dict[str, dict[str, Any]] = {
    "confidence at its largest": RARE,
    "rare white under a nearly perfect sensor": {**RARE, "flawed_accuracy": 1 - 2**-17, "flawed": 3},
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


@pytest.mark.parametrize(
    ("base", "changes"),
    [(SHORT, each) for each in EDGES.values()]
    + slow((SHORT, each) for each in FULL_EDGES.values())
    + [(replace(MOVING, latency=late), each) for late in (0, 1) for each in (EDGES | MOVING_EDGES).values()]
    + [(ROBUST, each) for each in (EDGES | ROBUST_EDGES).values()]
    + [
        (replace(ROBUST_MOVING, latency=late), each)
        for late in (0, 1)
        for each in (EDGES | MOVING_EDGES | ROBUST_EDGES).values()
    ],
)
def test_lanes_equal_the_firmware_at_the_edges(base: Experiment, changes: dict[str, Any]) -> None:
    """Which random experiments do not reach; trials fill their lanes once and a bit."""
    assert_equal_to_the_bit(replace(base, **changes), first=4, trials=10 if base.is_dynamic else 17)


def random_experiments(seed: int, count: int) -> Iterator[Experiment]:
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
def test_lanes_equal_the_firmware_in_random_experiments(count: int) -> None:
    for experiment in random_experiments(20241, count):
        assert_equal_to_the_bit(experiment, first=0, trials=2 if experiment.is_dynamic else 18)


class Mixed(Experiment):
    """Every third robot has no filter, the next one the robust filter, the next one the paper's."""

    def config(self, robot: int) -> Config:
        filters = (Filter.OFF, Filter.ROBUST, Filter.ADAPTIVE)
        return replace(super().config(robot), filter=filters[robot % 3])


MIXED = Mixed(**SHORT.parameters())


def test_lanes_are_used_unless_robots_are_recorded_or_broadcast_seldom_or_differ() -> None:
    for experiment, interval, expected in (
        (SHORT, 0, True),
        (LATE, 0, True),
        (SHORT, 10, False),
        (replace(SHORT, comms_period=2), 0, False),
        (ROBUST, 0, True),
        (replace(ROBUST_MOVING, latency=1), 0, True),
        (MIXED, 0, False),
    ):
        call = native.EngineTrials(experiment, 0, 1, interval)
        assert _engine.lib.mcp_asdf_engine_has_lanes(call.experiment) is expected


def engine_for(architecture: str, folder: Path, *more: str) -> Any:
    """The extension module of the engine, built with vectors of one architecture."""
    tools = ROOT / "host_tools/mcp_asdf_tools"
    arena, engine, core = tools / "world/arena", tools / "experiments/engine", CORE.parent
    glue, module = folder / "_engine.c", folder / "_engine.so"
    headers = (core / "mcp_asdf.h", core / "mcp_asdf_image.h", arena / "arena.h", engine / "engine.h")
    run(sys.executable, ROOT / "firmware_py/build_native.py", _engine.__name__, glue, *headers)
    includes = [f"-I{path}" for path in (core, arena, engine, sysconfig.get_path("include"))]
    sources = (glue, *sorted(engine.glob("*.c")), *sorted(arena.glob("*.c")), core / "mcp_asdf_image.c")
    floats = ("-ffp-contract=off", "-fno-trapping-math", "-fno-math-errno")
    options = ("-std=gnu99", "-O3", "-fPIC", "-shared", *floats)
    target = ("-DFOR_EACH_TARGET=", f"-march={architecture}")
    run(require("gcc", "gcc"), *options, *more, *target, *includes, *sources, "-o", module, "-lm")
    spec = importlib.util.spec_from_file_location(_engine.__name__, module)
    assert spec is not None and spec.loader is not None
    loaded = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(loaded)
    return loaded


@pytest.mark.slow
@pytest.mark.parametrize("architecture", ["x86-64", "x86-64-v3", "x86-64-v4"])
def test_lanes_of_every_vector_size_are_the_firmware_to_the_bit(
    architecture: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    flag = {"x86-64-v3": "avx2", "x86-64-v4": "avx512vl"}.get(architecture, "fpu")
    if f" {flag} " not in Path("/proc/cpuinfo").read_text(encoding="ascii").replace("\n", " "):
        pytest.skip(f"this processor has no vectors of {architecture}")
    monkeypatch.setattr(native, "_engine", engine_for(architecture, tmp_path))
    for changes in EDGES.values():
        assert_equal_to_the_bit(replace(SHORT, **changes), first=4, trials=17)
        assert_equal_to_the_bit(replace(LATE, **changes), first=4, trials=2)
        assert_equal_to_the_bit(replace(ROBUST, **changes), first=4, trials=17)
    for experiment in random_experiments(20242, 60):
        assert_equal_to_the_bit(experiment, first=0, trials=16)


def random_worlds(seed: int, count: int) -> Iterator[WorldSettings]:
    """From one robot to 127, walls from everywhere to far away, floors of tiles and of an image."""
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
    """The arena's text, compiled without a vector, is the definition."""
    worlds = [*random_worlds(20261, 60)]
    found = [vars(Arena(settings, trial).record(150)) for trial, settings in enumerate(worlds)]
    monkeypatch.setattr(arena, "_arena", engine_for("x86-64", tmp_path, "-fno-tree-vectorize"))
    for trial, (settings, motion) in enumerate(zip(worlds, found, strict=True)):
        for name, expected in vars(Arena(settings, trial).record(150)).items():
            assert np.array_equal(motion[name], expected), f"replay: {settings}, trial {trial}: {name}"


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
    ],
)
def test_engine_equals_the_mirror(experiment: Experiment) -> None:
    check_that_the_engine_is_the_mirror(experiment)


@pytest.mark.parametrize(
    "experiment",
    [
        SHORT,
        LATE,
        replace(SHORT, fill_ratio=0.95, filter="asdf-minus", comms_period=5),
        replace(LATE, fill_ratio=0.95, true_accuracy=0.75, activation="always"),
    ],
)
def test_float64_follows_the_firmware(experiment: Experiment) -> None:
    """In every step, on the same draws."""
    own = run_trials(experiment, 0, 1, sampling_interval=1)
    other = run_trials(replace(experiment, firmware="reference"), 0, 1, sampling_interval=1)
    assert np.array_equal(own.updates, other.updates)
    assert np.array_equal(own.tests, other.tests)
    for name in ("x_hat", "x_bar", "x", "b_hat"):
        assert np.abs(own.records[name] - other.records[name]).max() < 1e-5, name
    authors = run_trials(replace(experiment, firmware="reference", conventions="authors"), 0, 1)
    assert np.array_equal(authors.b_hat, other.b_hat) == (experiment.activation == "always")


@BOTH
def test_a_trial_depends_neither_on_the_others_nor_on_records(experiment: Experiment) -> None:
    whole = native.run(experiment, 0, 20)
    for first, trials, interval in ((0, 1, 0), (7, 5, 3), (19, 1, 0)):
        part = native.run(experiment, first, trials, interval)
        assert np.array_equal(part.x, whole.x[first : first + trials])
        assert np.array_equal(part.b_hat, whole.b_hat[first : first + trials])


# --- Refusals --------------------------------------------------------------------------------------------


def test_what_it_cannot_run_is_refused() -> None:
    for experiment in (replace(SHORT, firmware="mirror"), replace(SHORT, latency=1)):
        with pytest.raises(UsageError, match="the engine in C lacks this"):
            native.run(experiment, 0, 1)
    corridor = replace(MOVING, robots=128, flawed=0, width=20.0, height=0.25, density=1.0, steps=1)
    with pytest.raises(UsageError, match=r"128 robots found no room in 20.0 x 0.25 m"):
        run_trials(corridor, 0, 1)


@pytest.mark.parametrize("lanes", [False, True])
def test_a_refusal_of_the_firmware_is_told(lanes: bool) -> None:
    class Refused(Experiment):
        def b_hat(self, robot: int) -> float:
            return 0.0

    with pytest.raises(FirmwareError, match="ERR_B_HAT"):
        native.run(Refused(steps=10), 0, 1, lanes=lanes)


@pytest.mark.parametrize("experiment", [SHORT, ROBUST_MOVING], ids=["ASDF+", "robust, moving"])
def test_liars_say_what_they_say_on_a_bus(experiment: Experiment) -> None:
    """They have no lanes and, as each hears the truth about itself alone, an x of their own."""
    experiment = replace(experiment, steps=120, trials=1)
    engine, call = _engine.lib, native.EngineTrials(experiment, 0, 1, 0)
    call.experiment.liars, call.experiment.lie = 2, [0, 16_000_000 << 8 | 20]  # alpha 10^6
    assert not engine.mcp_asdf_engine_has_lanes(call.experiment)
    assert call.execute(lanes=False) is Status.OK
    fault = parse_fault(f"liar,robots={experiment.robots - 2}-{experiment.robots - 1},x=0,alpha=1e6")
    plain = experiment.parameters()
    kept = {name: plain[name] for name in plain if name not in ("trials", "conventions")}
    with Swarm(replace(SwarmSettings(**kept), faults=(fault,)), Wiring()) as swarm:
        run_swarm(swarm, [])
        assert call.x[0, :, -1].tolist() == [node.robot.x * 2**23 for node in swarm.nodes]


# --- More than 128 robots ----------------------------------------------------------------------------------

MANY = replace(LATE, robots=300, flawed=90, steps=150)
LONG_GRAPH = "; ".join(f"{i} {(i + 1) % 2100}; {i} > {(i + 2048) % 2100}" for i in range(2100))
HUGE = replace(MANY, topology="graph", density=1.0, graph=LONG_GRAPH, robots=2100, flawed=630, steps=60)
"""Its robots stand in many rows of lanes and hear others far away in them."""


def test_lanes_of_many_robots_equal_the_firmware() -> None:
    for experiment in (MANY, replace(MANY, density=6, latency=0, filter="robust"), HUGE):
        assert_equal_to_the_bit(experiment, first=0, trials=1)
    assert_equal_to_the_bit(replace(HUGE, latency=0, filter="robust", steps=30), first=0, trials=1)


def digest_of(experiment: Experiment) -> str:
    found = native.run(experiment, 0, 1)
    values = (found.x.astype("<u4").tobytes(), found.b_hat.astype("<u4").tobytes(), *found.images())
    return hashlib.sha256(b"".join(values)).hexdigest()[:16]


def test_127_robots_have_the_bits_that_they_had_when_there_were_no_more() -> None:
    own = replace(LATE, robots=127, flawed=38, density=1, steps=600, filter_period=100, seed=5)
    assert digest_of(replace(own, filter="robust")) == "60640553d2f44490"
    assert digest_of(replace(own, filter="asdf-plus")) == "e2c30e5f56d3501e"


@pytest.mark.parametrize("filtering", ["asdf-plus", "robust"])
def test_many_robots_in_a_graph_are_firmwares_whose_neighbours_have_ids_of_their_own(filtering: Any) -> None:
    """Robots 0, 128 and 256 hear each other, whose ids of 7 bits are one. Firmware that is alone with its
    neighbours knows them by ids that differ, and are the same modulo 32, which is all that votes look at."""
    edges = "; ".join(["0 128; 128 256; 0 256", *(f"{i} {i + 1}; {i} > {i + 3}" for i in range(257))])
    graph: dict[str, Any] = {"graph": edges, "robots": 260, "flawed": 80, "latency": 0}
    experiment = replace(HUGE, **graph, filter=filtering, steps=60, filter_period=20)
    robots = [NativeRobot(experiment.config(j), j % 32, experiment.b_hat(j)) for j in range(260)]
    heard = {j: sorted(a for a, b in experiment.graph.links if b == j) for j in range(260)}
    scene = World(experiment).advance(60)
    for black in scene.black.tolist():
        for robot, seen in zip(robots, black, strict=True):
            robot.observe(Observation(seen))
        said = [(robot.x_hat_raw, robot.alpha_raw) for robot in robots]
        for j, robot in enumerate(robots):
            for place, sender in enumerate(heard[j]):
                robot.receive_raw(sender % 32 + 32 * (place % 3 + 1), *said[sender])
            robot.settle()
    found = run_trials(experiment, 0, 1, sampling_interval=60)
    assert found.records["x"][0, -1].tolist() == [robot.x for robot in robots]
    assert found.b_hat[0, -1].tolist() == [robot.b_hat for robot in robots]


def test_memory_of_the_engine_grows_linearly_with_the_robots() -> None:
    few, many = (
        _engine.lib.mcp_asdf_engine_bytes(native.EngineTrials(experiment, 0, 1, 0).experiment)
        / experiment.robots
        for experiment in (replace(MANY, robots=robots, density=1, steps=10) for robots in (2048, 10_240))
    )
    assert 1000 < many < 2500 and few == pytest.approx(many, rel=0.01)
