"""Experiments in the moving world: settings, floors, the engine's two ways and the firmware run in Python."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mcp_asdf_tools.common.parameters import ParameterError
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.experiment_files import read_experiments
from mcp_asdf_tools.experiments.results import experiments_in, read_table
from mcp_asdf_tools.experiments.sweep import Store, run_sweep
from mcp_asdf_tools.experiments.trials import run_trials
from mcp_asdf_tools.world import _arena
from mcp_asdf_tools.world.arena import Arena, config_values
from mcp_asdf_tools.world.floor_code import CODE_MODULES, code

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
