"""The C engine: its draws, its two ways to run trials, and the firmware run message by message in Python."""

from __future__ import annotations

import platform
import random
import re
from collections.abc import Iterator
from dataclasses import replace
from decimal import Decimal
from pathlib import Path
from typing import get_args

import numpy as np
import pytest

from mcp_asdf.robot import B_HAT_MARGIN, FirmwareError
from mcp_asdf_tools.experiments import _engine
from mcp_asdf_tools.experiments.engine import native
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.trials import run_trials
from mcp_asdf_tools.robots.population import Activation, Filtering
from mcp_asdf_tools.world import philox
from mcp_asdf_tools.world.world import World
from support import CORE, ROOT, require, run
from trials import check_that_the_engine_is_the_mirror

SHORT = Experiment(robots=10, flawed=3, steps=700, filter_period=100, trials=3, seed=77)

# Random123's own known answers: counter, key, words.
KNOWN = [
    ((0, 0, 0, 0), (0, 0), (0x6627E8D5, 0xE169C58D, 0xBC57AC4C, 0x9B00DBD8)),
    ((0xFFFFFFFF,) * 4, (0xFFFFFFFF,) * 2, (0x408F276D, 0x41C83B0E, 0xA20BC7C6, 0x6D5451FD)),
    (
        (0x243F6A88, 0x85A308D3, 0x13198A2E, 0x03707344),
        (0xA4093822, 0x299F31D0),
        (0xD16CFE09, 0x94FDCCEB, 0x5001E420, 0x24126EA1),
    ),
]


# --- Draws -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("counter", "key", "expected"), KNOWN)
def test_philox_gives_the_published_words(
    counter: tuple[int, ...], key: tuple[int, int], expected: tuple[int, ...]
) -> None:
    ffi, lib = _engine.ffi, _engine.lib
    words = ffi.new("uint32_t[4]")
    lib.mcp_asdf_engine_philox(list(counter), list(key), words)
    assert tuple(words) == expected
    c0, c1, c2, c3 = (np.array([word], np.uint64) for word in counter)
    assert tuple(int(word[0]) for word in philox.philox((c0, c1, c2, c3), key)) == expected


def test_a_draw_depends_on_seed_trial_robot_and_step_alone() -> None:
    whole = philox.Stream(0, 5, 2, robots=7).words(50)
    assert np.array_equal(philox.Stream(0, 5, 2, robots=3).words(21), whole[:21, :3])
    assert np.array_equal(philox.Stream(0, 5, 2, robots=3).words(29, first=21), whole[21:, :3])
    for other in ((0, 6, 2), (0, 5, 3), (1, 5, 2)):
        assert (philox.Stream(*other, robots=7).words(50) == whole).mean() < 0.01
    assert len(np.unique(whole)) == whole.size


def test_the_upper_half_of_a_seed_counts() -> None:
    assert (philox.Stream(0, 1, 0, 4).words(40) == philox.Stream(0, 1 + 2**32, 0, 4).words(40)).mean() < 0.01


@pytest.mark.parametrize("colour", [0.0, 1.0])
def test_certain_observations_are_certain(colour: float) -> None:
    world = World(Experiment(fill_ratio=colour, true_accuracy=1.0, steps=4000), 0)
    assert world.advance(4000).black.mean() == colour


def test_observations_are_as_probable_as_asked() -> None:
    seen = World(Experiment(robots=4, steps=100_000, seed=9), 0).advance(100_000).black
    deviation = (0.545 * 0.455 / seen.size) ** 0.5
    assert abs(seen.mean() - 0.545) < 4 * deviation
    shifted = np.corrcoef(seen[1:].ravel(), seen[:-1].ravel())[0, 1]
    across = np.corrcoef(seen[:, 0], seen[:, 1])[0, 1]
    assert abs(shifted) < 4 / seen.size**0.5
    assert abs(across) < 4 / len(seen) ** 0.5


# --- The lanes are the firmware to the bit ----------------------------------------------------------------


def assert_equal_to_the_bit(experiment: Experiment, first: int, trials: int) -> native.EngineResults:
    plain = native.run(experiment, first, trials, lanes=False)
    lanes = native.run(experiment, first, trials, lanes=True)
    replay = f"replay: {experiment.parameters()}, first {first}, trials {trials}"
    assert np.array_equal(plain.x, lanes.x), replay
    assert np.array_equal(plain.b_hat, lanes.b_hat), replay
    for name in native.COUNTERS:
        assert np.array_equal(plain.counters[name], lanes.counters[name]), replay
    assert plain.images() == lanes.images(), replay
    return plain


RARE = Experiment(
    robots=3,
    flawed=0,
    fill_ratio=0.99999,
    true_accuracy=1.0,
    filter="none",
    steps=200_000,
    filter_period=200_000,
)
EDGES = {
    "one robot": replace(SHORT, robots=1, flawed=1),
    "two robots": replace(SHORT, robots=2, flawed=1),
    "128 robots": replace(SHORT, robots=128, flawed=40, steps=210),
    "no filter": replace(SHORT, filter="none"),
    "only flawed robots filter": replace(SHORT, filter="asdf-minus"),
    "filter without a test": replace(SHORT, activation="always"),
    "only black": replace(SHORT, fill_ratio=1.0, true_accuracy=1.0),
    "only white": replace(SHORT, fill_ratio=0.0, true_accuracy=1.0),
    "uninformative sensor": replace(SHORT, flawed_accuracy=0.5),
    "all uninformative": replace(SHORT, flawed_accuracy=0.5, flawed=10),
    "barely informative": replace(SHORT, flawed_accuracy=0.5 + 2**-13),
    "inverted sensor": replace(SHORT, flawed_accuracy=0.2),
    "accuracies at their ends": replace(SHORT, flawed_accuracy=0.0, true_accuracy=1.0, fill_ratio=0.9),
    "low accuracy at its end": replace(SHORT, true_accuracy=0.0, flawed_accuracy=B_HAT_MARGIN),
    "memory forgets": replace(SHORT, memory=64),
    "memory ends a period": replace(SHORT, memory=200),
    "filter every step": replace(SHORT, filter_period=1, steps=90),
    "longer period than the trial": replace(SHORT, filter_period=1000),
    "one step": replace(SHORT, steps=1),
    "confidence at its largest": replace(RARE, true_accuracy=1.0, fill_ratio=0.99998),
    "rare white under a nearly perfect sensor": replace(RARE, flawed_accuracy=1 - 2**-17, flawed=3),
    "linear drift": replace(SHORT, drift="linear", drift_rate=-5e-4),
    "stepped drift": replace(SHORT, drift="stepped", drift_rate=-5e-4, drift_period=150),
}


@pytest.mark.parametrize("name", EDGES)
@pytest.mark.parametrize("trials", [1, 17])
def test_lanes_equal_the_firmware_at_the_edges(name: str, trials: int) -> None:
    assert_equal_to_the_bit(EDGES[name], first=4, trials=trials)


def random_experiments(seed: int, count: int) -> Iterator[Experiment]:
    source = random.Random(seed)
    for _ in range(count):
        robots = source.choice([1, 2, 3, 5, 10, 20, 40])
        accuracies = [0.0, 0.05, 0.5, 0.55, 0.75, 0.95, 0.99999, 1.0, source.random(), source.random()]
        yield Experiment(
            robots=robots,
            flawed=source.randint(0, robots),
            fill_ratio=source.choice([0.0, 0.5, 0.55, 0.95, 1.0, source.random()]),
            true_accuracy=source.choice(accuracies),
            flawed_accuracy=source.choice(accuracies),
            filter=source.choice(list(get_args(Filtering))),
            activation=source.choice(list(get_args(Activation))),
            filter_period=source.choice([3, 10, 97, 250]),
            omega=Decimal(source.choice(["0.05", "0.25", "0.9"])),
            memory=source.choice([64, 500, 2**31]),
            steps=source.randint(1, 1500),
            seed=source.getrandbits(64),
        )


def test_lanes_equal_the_firmware_in_random_experiments() -> None:
    for experiment in random_experiments(20241, 60):
        assert_equal_to_the_bit(experiment, first=0, trials=18)


def test_lanes_are_exact_in_long_trials() -> None:
    experiment = Experiment(robots=2, flawed=1, fill_ratio=0.5, steps=2**18 + 100, filter_period=2**18)
    assert_equal_to_the_bit(experiment, first=0, trials=16)


@pytest.mark.parametrize(
    ("experiment", "expected"),
    [
        (SHORT, True),
        (replace(SHORT, comms_period=2), False),
        (replace(SHORT, drift="wiener"), False),
        (replace(SHORT, steps=10**8), True),
    ],
)
def test_lanes_are_used_only_where_trials_are_alike(experiment: Experiment, expected: bool) -> None:
    call = native._Call(experiment, 0, 1, 0)
    assert _engine.lib.mcp_asdf_engine_has_lanes(call.experiment) is expected
    assert not _engine.lib.mcp_asdf_engine_has_lanes(native._Call(experiment, 0, 1, 10).experiment)


# --- The engine is the firmware run message by message -----------------------------------------------------


@pytest.mark.parametrize(
    "experiment",
    [
        SHORT,
        replace(SHORT, comms_period=5, filter="asdf-minus"),
        replace(SHORT, activation="always", memory=64, robots=4),
        replace(SHORT, drift="wiener", drift_diffusion=0.02, drift_rate=-1e-4),
        replace(SHORT, robots=1, flawed=0),
    ],
)
def test_engine_equals_the_mirror(experiment: Experiment) -> None:
    check_that_the_engine_is_the_mirror(experiment)


def test_all_robots_have_the_same_informed_estimate_to_the_bit() -> None:
    records = native.run(SHORT, 0, 4, sampling_interval=1)
    assert (records.records["x"] == records.records["x"][..., :1]).all()
    assert np.array_equal(records.records["x"][..., 0], records.x[:, 0, 1:])
    assert (records.x[:, 0, 0] == 2**22).all()


def test_robots_differ_where_they_broadcast_seldom() -> None:
    seldom = native.run(replace(SHORT, comms_period=10), 0, 2)
    assert seldom.x.shape == (2, 10, 701)
    assert (seldom.x[:, 0] != seldom.x[:, 9]).any()


def test_a_trial_does_not_depend_on_the_others() -> None:
    whole = native.run(SHORT, 0, 20)
    for first, trials in ((0, 1), (7, 5), (19, 1)):
        part = native.run(SHORT, first, trials)
        assert np.array_equal(part.x, whole.x[first : first + trials])
        assert np.array_equal(part.b_hat, whole.b_hat[first : first + trials])


def test_float64_follows_the_firmware() -> None:
    own = run_trials(SHORT, 0, 1, sampling_interval=1)
    other = run_trials(replace(SHORT, firmware="reference"), 0, 1, sampling_interval=1)
    assert np.array_equal(own.updates, other.updates)
    for name in ("x_hat", "x_bar", "x", "b_hat"):
        assert np.abs(own.records[name] - other.records[name]).max() < 1e-5, name


def test_settings_that_robots_must_share_are_checked() -> None:
    call = native._Call(SHORT, 0, 1, 0)
    outcome = native._allocate(SHORT, 1, 0)
    for name, value in (("robots", 0), ("robots", 129), ("steps", 0)):
        before = getattr(call.experiment, name)
        setattr(call.experiment, name, value)
        for function in ("mcp_asdf_engine_run", "mcp_asdf_engine_run_lanes"):
            assert getattr(_engine.lib, function)(call.experiment, native._pointers(outcome)) == -1
        setattr(call.experiment, name, before)


def test_a_refusal_of_the_firmware_is_told() -> None:
    class Refused(Experiment):
        def b_hat(self, robot: int) -> float:
            return 0.0

    for lanes in (False, True):
        with pytest.raises(FirmwareError, match="ERR_B_HAT"):
            native.run(Refused(steps=10), 0, 1, lanes=lanes)


# --- The lanes of lanes.c, apart from the engine ------------------------------------------------------------

LANES = ROOT / "host_tools/mcp_asdf_tools/experiments/engine/lanes.c"
LANES_BUILD = (
    "-std=c99",
    "-O3",
    "-fno-trapping-math",  # as CMakeLists.txt has it
    "-DFOR_EACH_TARGET=",
    f"-I{LANES.parent}",
    f"-I{LANES.parents[2] / 'world/arena'}",
    f"-I{CORE.parent}",
)
VECTOR_BYTES = {"x86-64-v3": 32, "x86-64-v4": 64}


def compiler_of_vectors() -> str:
    if platform.machine() != "x86_64":
        pytest.skip("lanes are vectors on x86-64 only")
    return require("gcc", "gcc")


def can_run(architecture: str) -> bool:
    """True if this processor has the vectors of an architecture."""
    needed = {"x86-64-v3": "avx2", "x86-64-v4": "avx512vl"}.get(architecture, "fpu")
    return f" {needed} " in Path("/proc/cpuinfo").read_text(encoding="ascii").replace("\n", " ")


@pytest.mark.slow
@pytest.mark.parametrize("architecture", ["x86-64", *VECTOR_BYTES])
def test_lanes_of_every_vector_size_are_the_firmware_to_the_bit(architecture: str, tmp_path: Path) -> None:
    gcc, program = compiler_of_vectors(), tmp_path / "lanes_check"
    if not can_run(architecture):
        pytest.skip(f"this processor has no vectors of {architecture}")
    sources = (Path(__file__).with_name("lanes_check.c"), LANES)
    run(gcc, f"-march={architecture}", *LANES_BUILD, *sources, "-o", program)
    run(program)


def lines_of_loops(source: Path, function: str) -> list[int]:
    """Where the loops over lanes of a function stand."""
    lines = source.read_text(encoding="utf-8").splitlines()
    first = next(i for i, line in enumerate(lines) if re.match(rf"\w.*\b{function}\(", line))
    last = lines.index("}", first)
    return [i + 1 for i in range(first, last) if re.match(r" +for \(uint32_t [lj] = [01];", lines[i])]


def first_sizes(source: Path, architecture: str, tmp_path: Path) -> dict[int, int]:
    """By line, how many turns of a loop gcc does at once as its first choice, if it makes a vector loop."""
    details = tmp_path / "vectors.txt"
    options = (f"-march={architecture}", *LANES_BUILD, f"-fdump-tree-vect-details={details}", "-c")
    run(compiler_of_vectors(), *options, source, "-o", tmp_path / "object.o")
    done: dict[int, int] = {}
    tried: dict[int, int] = {}
    for line in details.read_text(encoding="utf-8").splitlines():
        if found := re.match(rf".*{source.name}:(\d+):\d+: note: +vectorization factor = (\d+)", line):
            tried.setdefault(int(found[1]), int(found[2]))
        if found := re.match(rf".*{source.name}:(\d+):\d+: optimized: loop vectorized", line):
            done[int(found[1])] = tried[int(found[1])]
    return done


@pytest.mark.slow
@pytest.mark.parametrize("architecture", VECTOR_BYTES)
@pytest.mark.parametrize(
    ("file", "words"),
    [
        ("lanes.c", {"lanes_observe": 1, "lanes_say": 1, "lanes_inform": 1}),
        ("fully_connected.c", {"draw": 1, "add_up": 2}),
        ("moving.c", {"moving_draw": 1}),
    ],
)
def test_loops_over_lanes_are_made_of_whole_vectors(
    file: str, words: dict[str, int], architecture: str, tmp_path: Path
) -> None:
    """One branch, table or byte more in the core loses this, and only the time of a trial shows it.

    ``words`` are the 32-bit words of an element, of which a turn of the loop takes as many as fill a vector.
    """
    source = LANES.with_name(file)
    sizes = first_sizes(source, architecture, tmp_path)
    for function, size in words.items():
        found = {sizes[line] for line in lines_of_loops(source, function) if line in sizes}
        assert found == {VECTOR_BYTES[architecture] // (4 * size)}, function
