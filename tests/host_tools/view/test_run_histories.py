"""Histories of swarms: a running swarm, its log and its trial have the same descriptions and states."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
import pytest

from authors_files import FIXED, write_trial
from mcp_asdf_tools.cli.main import main
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.experiments.authors_trials import read_trials
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.result_tables import experiments_in, trials_to_table
from mcp_asdf_tools.experiments.results import Trials
from mcp_asdf_tools.experiments.trials import run_trials
from mcp_asdf_tools.swarm.carrier import Wiring
from mcp_asdf_tools.swarm.run import run_swarm
from mcp_asdf_tools.swarm.settings import SwarmSettings
from mcp_asdf_tools.swarm.swarm import Swarm
from mcp_asdf_tools.view import history as history_module
from mcp_asdf_tools.view import run_description
from mcp_asdf_tools.view.history import History, State
from mcp_asdf_tools.view.page import encode_description
from mcp_asdf_tools.view.swarm_log_history import recompute_swarm_history
from mcp_asdf_tools.view.swarm_recorder import SwarmRecorder
from mcp_asdf_tools.view.trial_history import recompute_trial_history, recorded_trial_history
from mcp_asdf_tools.world.arena import Arena
from support import slow

PARAMETERS: dict[str, Any] = {
    "robots": 7,
    "flawed": "50%",
    "steps": 110,
    "filter": "asdf-minus",
    "filter_period": 50,
    "seed": 3,
}
WORLDS: dict[str, dict[str, Any]] = {
    "dynamic": {"topology": "dynamic", "drift": "linear", "drift_rate": -1e-3},
    "graph": {"topology": "graph", "graph": "0 1; 1 > 2; 3 6"},
    "fully connected": {},
    "robust": {"filter": "robust", "topology": "dynamic", "density": 8, "fill_ratio": 0.95, "flawed": 2},
}


def record_swarm(**parameters: Any) -> History:
    """Run a swarm, and return the history that a recorder makes of it."""
    settings = SwarmSettings(**PARAMETERS | parameters)
    recorder = SwarmRecorder(settings)
    with Swarm(settings, Wiring()) as swarm:
        run_swarm(swarm, [recorder])
    return recorder.history


def write_log(path: Path, **parameters: Any) -> Path:
    """Run the same swarm by the command, with a log."""
    options = [f"--{name.replace('_', '-')}={value}" for name, value in (PARAMETERS | parameters).items()]
    assert main(["swarm", *options, "--log", str(path), "--quiet"]) == 0
    return path


def run_experiment(**parameters: Any) -> Trials:
    """Run two trials of the same swarm, and return them as a table of results has them."""
    experiment = Experiment(**PARAMETERS | parameters, trials=2)
    (trials,) = experiments_in(trials_to_table(run_trials(experiment, 0, 2)))
    return trials


def states_of(history: History) -> list[State]:
    return history.states_since().states


def check_equal_states(actual: list[State], expected: list[State]) -> None:
    """Check that states have equal ticks, values, neighbours and positions."""
    assert [state.tick for state in actual] == [state.tick for state in expected]
    for actual_state, expected_state in zip(actual, expected, strict=True):
        assert np.array_equal(actual_state.values, expected_state.values, equal_nan=True)
        assert np.array_equal(actual_state.neighbours, expected_state.neighbours)
        assert np.array_equal(actual_state.positions, expected_state.positions)  # type: ignore[arg-type]


class Recordings(NamedTuple):
    """One run: recorded as it went, as a log, and as trials of an experiment."""

    live: History
    log: Path
    trials: Trials


QUICK_WORLDS = ("dynamic", "robust")
SLOW_WORLDS = [name for name in WORLDS if name not in QUICK_WORLDS]


@pytest.fixture(scope="module", params=[*QUICK_WORLDS, *slow(SLOW_WORLDS)])
def recordings(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Recordings:
    world = WORLDS[request.param]
    log = write_log(tmp_path_factory.mktemp("log") / "run.log", **world)
    return Recordings(record_swarm(**world), log, run_experiment(**world))


# --- Equal states -------------------------------------------------------------------------------------


def test_a_log_is_shown_with_the_same_states_as_the_running_swarm(recordings: Recordings) -> None:
    logged = states_of(recompute_swarm_history(recordings.log))
    assert [state.tick for state in logged] == [*range(111)]
    check_equal_states(states_of(recordings.live), logged[1:])


def test_a_simulated_trial_is_shown_with_the_same_states_as_the_running_swarm(recordings: Recordings) -> None:
    trial_states = states_of(recompute_trial_history(recordings.trials, trial=0))
    assert [state.tick for state in trial_states] == [*range(111)]
    check_equal_states(states_of(recordings.live), trial_states[1:])


def test_log_and_trial_are_described_on_the_page_as_the_running_swarm_is(recordings: Recordings) -> None:
    live = encode_description(recordings.live.description)
    logged = encode_description(recompute_swarm_history(recordings.log).description)
    trial = encode_description(recompute_trial_history(recordings.trials, trial=0).description)
    assert live == logged == trial


def test_a_recording_has_ended_and_a_running_swarm_has_not(recordings: Recordings) -> None:
    assert recompute_swarm_history(recordings.log).has_ended
    assert recompute_trial_history(recordings.trials, trial=0).has_ended
    assert not recordings.live.has_ended


def test_a_long_recording_has_every_fourth_state(
    recordings: Recordings, monkeypatch: pytest.MonkeyPatch
) -> None:
    """So its page stays small: of 111 states at most 28 are kept here."""
    every_state = states_of(recompute_swarm_history(recordings.log))
    monkeypatch.setattr(history_module, "MAX_STATES", 28)
    check_equal_states(states_of(recompute_swarm_history(recordings.log)), every_state[::4])
    check_equal_states(states_of(recompute_trial_history(recordings.trials, trial=0)), every_state[::4])


def test_estimates_and_accuracies_of_the_compared_swarm_change_by_more_than_a_tenth() -> None:
    """Without changes in x and b_hat, equal states would be no evidence."""
    x, _, b_hat, _ = np.stack(
        [state.values for state in states_of(record_swarm(**WORLDS["dynamic"]))], axis=1
    )

    assert np.ptp(x, axis=0).max() > 0.1
    assert np.ptp(b_hat, axis=0).max() > 0.1


# --- Descriptions -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("parameters", "title"),
    [
        ({"filter": "none"}, "7 robots, 4 flawed, no filter, fully connected, seed 3"),
        ({"filter": "robust"}, "7 robots, 4 flawed, robust, τ = 50, fully connected, seed 3"),
        (
            {"topology": "dynamic", "flawed": 0},
            "7 robots, 0 flawed, ASDF−, τ = 50, dynamic, seed 3",  # noqa: RUF001
        ),
    ],
)
def test_the_title_has_the_main_parameters(parameters: dict[str, Any], title: str) -> None:
    settings = SwarmSettings(**PARAMETERS | parameters)
    assert SwarmRecorder(settings).history.description.title == title


def test_the_title_of_a_later_trial_has_its_number() -> None:
    history = recompute_trial_history(run_experiment(), trial=1)
    assert history.description.title.endswith(", seed 3, trial 1")


def test_the_chart_shows_the_errors_of_the_same_run_without_a_filter() -> None:
    """The chart shows them beside the errors of the run, whose fill ratio is 0.55."""
    description = record_swarm(topology="dynamic", steps=60).description
    unfiltered = record_swarm(topology="dynamic", steps=60, filter="none")
    x = np.stack([state.values[0] for state in states_of(unfiltered)])
    expected = np.round(abs(x - 0.55).mean(axis=1), 5)

    assert description.unfiltered_errors[1:] == expected.tolist()


def test_the_line_of_errors_without_a_filter_has_a_limited_number_of_points(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(run_description, "_MAX_ERROR_POINTS", 4)
    assert len(record_swarm(steps=60).description.unfiltered_errors) == 4


@pytest.mark.parametrize(
    "parameters",
    [{"filter": "none"}, {"faults": ("loss=0.1",)}, {"allow": "0-6"}, {"latency": 1}],
    ids=["no filter", "faults", "allow", "latency"],
)
def test_the_chart_shows_no_errors_without_a_filter_where_they_would_be_no_fair_comparison(
    parameters: dict[str, Any],
) -> None:
    settings = SwarmSettings(**PARAMETERS | parameters)
    assert len(SwarmRecorder(settings).history.description.unfiltered_errors) == 0


def test_a_swarm_of_a_billion_steps_is_not_run_a_second_time_for_its_chart() -> None:
    recorder = SwarmRecorder(SwarmSettings(steps=10**9))
    assert len(recorder.history.description.unfiltered_errors) == 0


@pytest.mark.parametrize(
    ("parameters", "shape"),
    [
        ({"floor": "tiles", "width": 1.0, "height": 0.5}, (50, 100)),
        ({"floor": "tiles", "width": 1.0, "height": 0.5, "tile": 0.0005}, (800, 800)),
        ({"floor": "code"}, None),
    ],
    ids=["a pixel for each tile", "more tiles than pixels", "code"],
)
def test_a_pixel_of_the_floor_is_the_tile_that_robots_observe_there(
    parameters: dict[str, Any], shape: tuple[int, int] | None
) -> None:
    settings = SwarmSettings(robots=3, topology="dynamic", steps=1, **parameters)
    floor = SwarmRecorder(settings).history.description.floor
    assert floor is not None
    assert shape is None or floor.shape == shape
    arena = Arena(settings, 0)
    rows, columns = floor.shape
    width, height = settings.sides
    some_pixels = ((0, 0), (0, columns - 1), (rows - 1, 0), (17, 31))
    for row, column in some_pixels:
        # The centre of the pixel in metres: (0, 0) is the middle of the floor, and y grows upwards.
        x = ((column + 0.5) / columns - 0.5) * width
        y = (0.5 - (row + 0.5) / rows) * height
        assert floor[row, column] == arena.is_black(x, y)


# --- Faults -------------------------------------------------------------------------------------------

CRASH = "crash=1.0,from=20,to=21,robots=2,ticks=15"


@pytest.fixture(scope="module")
def crash_histories(tmp_path_factory: pytest.TempPathFactory) -> tuple[History, History]:
    """Histories of a swarm whose robot 2 is dead for 15 ticks: as it went, and from the log."""
    log = write_log(tmp_path_factory.mktemp("crash") / "run.log", fault=CRASH)
    return record_swarm(faults=(CRASH,)), recompute_swarm_history(log)


def test_a_dead_robot_has_no_values(crash_histories: tuple[History, History]) -> None:
    _, logged = crash_histories
    ticks_without_values = [state.tick for state in states_of(logged) if np.isnan(state.values[:3, 2]).all()]
    assert ticks_without_values == [*range(21, 36)]


def test_robots_that_live_have_values(crash_histories: tuple[History, History]) -> None:
    _, logged = crash_histories
    living_robots = [0, 1, 3, 4, 5, 6]
    assert all(np.isfinite(state.values[:, living_robots]).all() for state in states_of(logged))


def test_a_log_with_a_crash_has_the_states_that_the_swarm_had(
    crash_histories: tuple[History, History],
) -> None:
    live, logged = crash_histories
    check_equal_states(states_of(live), states_of(logged)[1:])


def test_the_description_names_faults_with_their_time(crash_histories: tuple[History, History]) -> None:
    for history in crash_histories:
        assert list(history.description.faults) == [(CRASH, 20, 21)]


# --- A swarm as it goes -------------------------------------------------------------------------------


def test_a_swarm_that_is_viewed_is_slowed_to_its_pace(monkeypatch: pytest.MonkeyPatch) -> None:
    """At 100 steps a second each step has 10 ms. A slow step of 50 ms is not made up for."""
    now = [50.0]
    slept = list[float]()

    def sleep(seconds: float) -> None:
        slept.append(seconds)
        now[0] += seconds

    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    monkeypatch.setattr(time, "sleep", sleep)
    recorder = SwarmRecorder(SwarmSettings(**PARAMETERS | {"steps": 20_000}), pace=100)
    swarm_between_states: Any = SimpleNamespace(ticks=1)
    for seconds_of_work in (0.002, 0.0, 0.05, 0.0):
        recorder(swarm_between_states)
        now[0] += seconds_of_work
    assert slept == pytest.approx([0.0, 0.008, 0.01, 0.0])


@pytest.mark.parametrize("pace", [-1, float("nan")])
def test_a_pace_below_zero_is_refused(pace: float) -> None:
    with pytest.raises(UsageError, match=r"--pace is (-1|nan); give steps a second"):
        SwarmRecorder(SwarmSettings(**PARAMETERS), pace)


# --- Results that do not fit --------------------------------------------------------------------------


def test_results_that_do_not_come_out_again_are_refused() -> None:
    trials = run_experiment()
    changed = replace(trials, errors=trials.errors + 1e-9)
    with pytest.raises(UsageError, match="trial 1 does not come out again"):
        recompute_trial_history(changed, trial=1)


def test_a_trial_that_is_not_among_the_results_is_refused() -> None:
    with pytest.raises(UsageError, match="there is no trial 2; choose one of 0 to 1"):
        recompute_trial_history(run_experiment(), trial=2)


def test_a_trial_of_a_billion_steps_is_refused() -> None:
    trials = run_experiment(robots=2, steps=10, filter="none")
    long_trials = replace(trials, experiment=replace(trials.experiment, steps=10**9))
    with pytest.raises(UsageError, match=r"too long to be run again, .* at most 100000000 steps"):
        recompute_trial_history(long_trials, trial=0)


# --- Trials of another program ------------------------------------------------------------------------


@pytest.fixture
def trials_of_the_authors(tmp_path: Path) -> Trials:
    """A trial of the paper's authors, recorded every 20 of its 60 steps."""
    [trials] = read_trials([write_trial(tmp_path / "trial.json", FIXED, number=2)], sampling_interval=20)
    return trials


def test_a_trial_of_another_program_has_the_states_that_are_recorded(trials_of_the_authors: Trials) -> None:
    """The values of a state are x, x_hat, b_hat and the true accuracy b, each of all robots.

    The first three were recorded every 20 steps; the last follows from the experiment.
    """
    states = states_of(recorded_trial_history(trials_of_the_authors, trial=2))
    assert [state.tick for state in states] == [0, 20, 40, 60]
    for index, name in enumerate(("x", "x_hat", "b_hat")):
        recorded_values = trials_of_the_authors.records[name][0]
        assert np.array_equal([state.values[index] for state in states], recorded_values)

    *_, true_accuracies = states[0].values
    assert (true_accuracies == FIXED.true_accuracy).all()


def test_a_trial_of_another_program_has_neither_places_nor_neighbours(trials_of_the_authors: Trials) -> None:
    history = recorded_trial_history(trials_of_the_authors, trial=2)
    assert history.description.sides is None
    assert all(state.positions is None and not state.neighbours.any() for state in states_of(history))


def test_a_trial_of_another_program_is_named_by_it(trials_of_the_authors: Trials) -> None:
    title = recorded_trial_history(trials_of_the_authors, trial=2).description.title
    assert title.startswith("5 robots, 2 flawed, ")
    assert title.endswith(", trial 2 of NESTLab/sensor-degradation-filter")


def test_a_long_trial_of_another_program_has_some_of_its_states(
    trials_of_the_authors: Trials, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(history_module, "MAX_STATES", 2)
    states = states_of(recorded_trial_history(trials_of_the_authors, trial=2))
    assert [state.tick for state in states] == [0, 40]


def test_a_trial_of_another_program_without_records_is_refused(trials_of_the_authors: Trials) -> None:
    unrecorded = replace(trials_of_the_authors, records={}, sampling_interval=0)
    with pytest.raises(
        UsageError, match=r"nothing is recorded .* run mcp-asdf convert again, without --record 0"
    ):
        recorded_trial_history(unrecorded, trial=2)


def test_a_trial_that_another_program_has_not_run_is_refused(trials_of_the_authors: Trials) -> None:
    with pytest.raises(UsageError, match="there is no trial 0; choose one of 2 to 2"):
        recorded_trial_history(trials_of_the_authors, trial=0)
