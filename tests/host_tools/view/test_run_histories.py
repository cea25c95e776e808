"""Histories of swarms: a running swarm, its log and its trial have the same descriptions and states."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray

from authors_files import FIXED, write_trial
from mcp_asdf_tools.cli.main import main
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.experiments.authors_trials import read_trials
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.result_files import stream_experiments
from mcp_asdf_tools.experiments.result_tables import trials_to_table
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
from mcp_asdf_tools.view.run_histories import (
    SwarmRecorder,
    recompute_swarm_history,
    recompute_trial_history,
    recorded_trial_history,
    run_trial_history,
)
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


def swarm_settings(**changes: Any) -> SwarmSettings:
    """Return the settings of a swarm with PARAMETERS, some of them changed."""
    return SwarmSettings(**PARAMETERS | changes)


def record_swarm(**parameters: Any) -> History:
    """Run a swarm, and return the history that a recorder makes of it."""
    settings = swarm_settings(**parameters)
    recorder = SwarmRecorder(settings)
    with Swarm(settings, Wiring()) as swarm:
        run_swarm(swarm, [recorder])
    return recorder.history


def write_log(path: Path, **parameters: Any) -> Path:
    """Run the same swarm by the command, with a log, and return the log's path."""
    options = [f"--{name.replace('_', '-')}={value}" for name, value in (PARAMETERS | parameters).items()]
    assert main(["swarm", *options, "--log", str(path), "--quiet"]) == 0
    return path


def run_experiment(**parameters: Any) -> Trials:
    """Run two trials of the same swarm, and return them as a table of results has them."""
    experiment = Experiment(**PARAMETERS | parameters, trials=2)
    (trials,) = stream_experiments(trials_to_table(run_trials(experiment, first=0, trials=2)))
    return trials


def states_of(history: History) -> list[State]:
    return history.states_since().states


def ticks_of(history: History) -> list[int]:
    return [state.tick for state in states_of(history)]


def are_equal(first: State, second: State) -> bool:
    """Return whether two states have equal ticks, values, links and positions."""
    return (
        first.tick == second.tick
        and np.array_equal(first.values, second.values, equal_nan=True)
        and np.array_equal(first.links, second.links)
        and np.array_equal(first.positions, second.positions)  # type: ignore[arg-type]
    )


def differing_ticks(actual: list[State], expected: list[State]) -> list[int]:
    """Return the ticks of states that differ from the expected states; fails if their numbers differ."""
    pairs = zip(actual, expected, strict=True)
    return [expected_state.tick for state, expected_state in pairs if not are_equal(state, expected_state)]


class Recordings(NamedTuple):
    """One run: recorded as it went, as a log, and as trials of an experiment."""

    live: History
    log: Path
    trials: Trials


QUICK_WORLDS = ("dynamic", "robust")
SLOW_WORLDS = [name for name in WORLDS if name not in QUICK_WORLDS]


@pytest.fixture(scope="module", params=[*QUICK_WORLDS, *slow(SLOW_WORLDS)])
def recordings(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Recordings:
    """One run of 110 steps of seven robots, in three forms."""
    world = WORLDS[request.param]
    log = write_log(tmp_path_factory.mktemp("log") / "run.log", **world)
    return Recordings(record_swarm(**world), log, run_experiment(**world))


# --- Equal states -------------------------------------------------------------------------------------


def test_a_log_and_a_trial_are_shown_with_the_states_and_the_title_of_the_running_swarm(
    recordings: Recordings,
) -> None:
    """Log and trial have a state before the first step, too. The running swarm has one after each step.

    Title and parameters are compared in JSON, as the web page of the swarm gets them.
    """
    history_of_log = recompute_swarm_history(recordings.log)
    history_of_trial = recompute_trial_history(recordings.trials, trial=0)
    history_of_swarm = recordings.live
    assert ticks_of(history_of_swarm) == list(range(1, 110 + 1))

    for history in (history_of_log, history_of_trial):
        initial_state, *states_after_steps = states_of(history)
        assert initial_state.tick == 0
        assert differing_ticks(states_after_steps, states_of(history_of_swarm)) == []
        assert encode_description(history.description) == encode_description(history_of_swarm.description)


def test_a_long_trial_and_a_long_log_are_shown_with_every_fourth_state(
    crash_log: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """So the web page stays small: of 111 states, at most 28 are kept here. The real limit is 10,000.

    Both histories are first made with all states, and then again with the limit.
    """
    trials = run_experiment()
    all_states_of_trial = states_of(recompute_trial_history(trials, trial=0))
    all_states_of_log = states_of(recompute_swarm_history(crash_log))
    monkeypatch.setattr(history_module, "MAX_STATES", 28)

    kept_states_of_trial = states_of(recompute_trial_history(trials, trial=0))
    kept_states_of_log = states_of(recompute_swarm_history(crash_log))
    assert differing_ticks(kept_states_of_trial, all_states_of_trial[::4]) == []
    assert differing_ticks(kept_states_of_log, all_states_of_log[::4]) == []


def test_links_between_more_robots_than_fit_a_bus_are_pairs_of_receiver_and_sender() -> None:
    """A bus has ids for 128 robots. A trial may have more, here 140 robots that move for 40 steps.

    In every step, the trial's arena has a matrix: it says whether a robot (row) receives another (column).
    """
    experiment = Experiment(topology="dynamic", robots=140, steps=40, trials=1)
    trials = run_trials(experiment, first=0, trials=1)
    *_, last_state = states_of(recompute_trial_history(trials, trial=0))

    *_, last_matrix = Arena(experiment).record(experiment.steps).adjacency
    pairs_of_receiver_and_sender = np.argwhere(last_matrix)
    assert last_state.links.tolist() == pairs_of_receiver_and_sender.tolist()
    assert len(last_state.links) > 0


# --- Descriptions -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("changed_parameters", "expected_title"),
    [
        ({"flawed": "50%", "filter": "none"}, "7 robots, 4 flawed, no filter, fully connected, seed 3"),
        ({"flawed": 4, "filter": "robust"}, "7 robots, 4 flawed, robust, τ = 50, fully connected, seed 3"),
        (
            {"flawed": 0, "topology": "dynamic"},
            "7 robots, 0 flawed, ASDF−, τ = 50, dynamic, seed 3",  # noqa: RUF001
        ),
    ],
)
def test_the_title_of_a_swarm_has_robots_filter_topology_and_seed(
    changed_parameters: dict[str, Any], expected_title: str
) -> None:
    """With no filter it is "7 robots, 4 flawed, no filter, fully connected, seed 3", for example.

    A share of flawed robots, such as 50 %, is shown as their number: half of 7 is rounded to 4.
    """
    settings = swarm_settings(robots=7, seed=3, **changed_parameters)
    assert SwarmRecorder(settings).history.description.title == expected_title


def test_the_filter_has_a_name_for_programs_and_one_for_readers() -> None:
    """Pages and pictures have a minus sign where programs, and the command line, have "minus"."""
    description = SwarmRecorder(swarm_settings(filter="asdf-minus")).history.description
    assert description.filter == "asdf-minus"
    assert description.filter_term == "ASDF\N{MINUS SIGN}"


def test_the_title_of_a_trial_but_the_first_ends_with_its_number() -> None:
    """The second trial of an experiment with seed 3 is trial 1."""
    history = recompute_trial_history(run_experiment(), trial=1)
    assert history.description.title.endswith(", seed 3, trial 1")


def largest_change(values_by_state: list[NDArray[np.float64]]) -> float:
    """Return the largest difference between two values of the same robot in any states."""
    values = np.array(values_by_state)
    changes_of_robots = values.max(axis=0) - values.min(axis=0)
    return float(changes_of_robots.max())


def test_robots_estimates_and_accuracies_change_by_more_than_a_tenth_in_the_compared_swarm() -> None:
    """Without changes in x and b_hat, equal states of log, trial and swarm would be no evidence.

    In the compared swarm robots move, and the accuracies of their sensors drift.
    """
    history = record_swarm(topology="dynamic", drift="linear", drift_rate=-1e-3)
    x_by_state, b_hat_by_state = [], []
    for state in states_of(history):
        x, _x_hat, b_hat, _true_accuracy = state.values
        x_by_state.append(x)
        b_hat_by_state.append(b_hat)

    assert largest_change(x_by_state) > 0.1
    assert largest_change(b_hat_by_state) > 0.1


def test_the_chart_of_errors_also_has_the_errors_of_the_same_trial_without_a_filter() -> None:
    """An error is the distance of a robot's estimate x from the fill ratio; the chart has their means.

    Trial 1 has other random numbers than trial 0. It is also run without a filter here, for comparison. The
    robots move, so that their estimates differ. The chart has five decimal places.
    """
    parameters = PARAMETERS | {"filter": "asdf-minus", "steps": 60, "topology": "dynamic"}
    experiment = Experiment(**parameters, trials=2)
    errors_in_chart = run_trial_history(experiment, trial=1).description.unfiltered_errors

    trial_without_filter = run_trial_history(replace(experiment, filter="none"), trial=1)
    mean_errors = []
    for state in states_of(trial_without_filter):
        x, _x_hat, _b_hat, _true_accuracy = state.values
        mean_errors.append(abs(x - experiment.fill_ratio).mean())
    assert errors_in_chart == np.round(mean_errors, 5).tolist()


def test_the_line_of_errors_without_a_filter_has_a_limited_number_of_points(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The limit is four points here, for a swarm of 60 steps."""
    monkeypatch.setattr(run_description, "_MAX_ERROR_POINTS", 4)
    assert len(record_swarm(steps=60).description.unfiltered_errors) == 4


@pytest.mark.parametrize(
    "changed_parameters",
    [{"filter": "none"}, {"faults": ("loss=0.1",)}, {"allow": "0-6"}, {"latency": 1}, {"steps": 10**9}],
    ids=["no filter", "faults", "allow", "latency", "would take hours"],
)
def test_the_chart_lacks_errors_without_a_filter_where_they_would_be_no_fair_comparison_or_take_long(
    changed_parameters: dict[str, Any],
) -> None:
    """Errors without a filter are simulated without faults, latency and allowed ids.

    So they are left out for a swarm with one of these, for one that has no filter itself, and for one of a
    billion steps.
    """
    settings = swarm_settings(**changed_parameters)
    assert len(SwarmRecorder(settings).history.description.unfiltered_errors) == 0


def centre_of_pixel(floor: NDArray[np.bool_], row: int, column: int, settings: SwarmSettings) -> Any:
    """Return x and y of a pixel's centre in metres from the middle of the floor; y grows upwards."""
    rows, columns = floor.shape
    width, height = settings.sides
    x = ((column + 0.5) / columns - 0.5) * width
    y = (0.5 - (row + 0.5) / rows) * height
    return x, y


@pytest.mark.parametrize(
    "parameters",
    [
        {"floor": "tiles", "width": 1.0, "height": 0.5},
        {"floor": "tiles", "width": 1.0, "height": 0.5, "tile": 0.0005},
        {"floor": "code"},
    ],
    ids=["a pixel for each tile", "more tiles than pixels", "code"],
)
def test_a_pixel_of_the_drawn_floor_is_black_where_a_robot_would_observe_black(
    parameters: dict[str, Any],
) -> None:
    """Four pixels are compared with the arena at their centres: three in corners, and one inside."""
    settings = SwarmSettings(robots=3, topology="dynamic", steps=1, **parameters)
    floor = SwarmRecorder(settings).history.description.floor
    assert floor is not None
    arena = Arena(settings, trial=0)
    rows, columns = floor.shape
    corners = [(0, 0), (0, columns - 1), (rows - 1, 0)]
    inside = (17, 31)

    for row, column in [*corners, inside]:
        x, y = centre_of_pixel(floor, row, column, settings)
        assert floor[row, column] == arena.is_black(x, y)


@pytest.mark.parametrize(
    ("side_of_tile", "expected_rows_and_columns"), [(0.01, (50, 100)), (0.0005, (800, 800))]
)
def test_the_drawn_floor_has_a_pixel_for_each_tile_but_no_more_than_800_a_side(
    side_of_tile: float, expected_rows_and_columns: tuple[int, int]
) -> None:
    """The floor is half a metre high and one metre wide; tiles are squares of one centimetre or half a mm.

    So it has 50 rows of 100 tiles, or 1000 rows of 2000 tiles, which are too many.
    """
    settings = SwarmSettings(
        robots=3, steps=1, topology="dynamic", floor="tiles", width=1.0, height=0.5, tile=side_of_tile
    )
    floor = SwarmRecorder(settings).history.description.floor
    assert floor is not None
    assert floor.shape == expected_rows_and_columns


# --- Faults -------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def crash_log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The log of a swarm of 110 steps whose robot 2 crashes in step 21 and is dead for 15 steps."""
    log = tmp_path_factory.mktemp("crash") / "run.log"
    return write_log(log, fault="crash=1.0,from=20,to=21,robots=2,ticks=15")


def test_a_robot_has_no_estimates_in_the_15_steps_in_which_it_is_dead(crash_log: Path) -> None:
    """Robot 2 of seven crashes in step 21 of the log. Only the true accuracy of its sensor remains known.

    The other robots have all values in all steps.
    """
    steps_without_estimates = []
    for state in states_of(recompute_swarm_history(crash_log)):
        values_by_robot = state.values.T
        x, x_hat, b_hat, _true_accuracy = values_by_robot[2]  # of robot 2
        if np.isnan([x, x_hat, b_hat]).all():
            steps_without_estimates.append(state.tick)
        values_of_other_robots = np.delete(values_by_robot, 2, axis=0)
        assert np.isfinite(values_of_other_robots).all()

    assert steps_without_estimates == list(range(21, 21 + 15))


def test_a_log_with_a_crash_is_shown_with_the_states_that_the_running_swarm_had(crash_log: Path) -> None:
    """In both, robot 2 crashes in step 21, which is tick 20 in the text of a fault, counted from 0.

    The log has a state before the first step as well.
    """
    running_swarm = record_swarm(faults=("crash=1.0,from=20,to=21,robots=2,ticks=15",))
    _initial_state, *states_of_log = states_of(recompute_swarm_history(crash_log))
    assert differing_ticks(states_of_log, states_of(running_swarm)) == []


def test_a_log_and_a_running_swarm_have_a_fault_with_its_first_and_last_step(crash_log: Path) -> None:
    """A fault is shown as its text, the step from which it may occur, and the step in which it ends."""
    history_of_log = recompute_swarm_history(crash_log)
    history_of_swarm = record_swarm(faults=("crash=1.0,from=20,to=21,robots=2,ticks=15",))
    expected_faults = [("crash=1.0,from=20,to=21,robots=2,ticks=15", 20, 21)]
    assert list(history_of_log.description.faults) == expected_faults
    assert list(history_of_swarm.description.faults) == expected_faults


def test_histories_of_logs_and_trials_have_ended_and_that_of_a_running_swarm_has_not(crash_log: Path) -> None:
    """A web page waits for further states of a history that has not ended."""
    assert recompute_swarm_history(crash_log).has_ended
    assert recompute_trial_history(run_experiment(), trial=0).has_ended
    assert not record_swarm(steps=10).has_ended


# --- A swarm as it runs -------------------------------------------------------------------------------


class FakeClock:
    """A clock that only moves when somebody sleeps, or when a test adds the time of some work."""

    def __init__(self) -> None:
        self.now = 50.0
        self.sleeps: list[float] = []

    def sleep(self, seconds: float) -> None:
        self.sleeps.append(seconds)
        self.now += seconds


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> FakeClock:
    """A clock that replaces the recorder's clock."""
    clock = FakeClock()
    monkeypatch.setattr(time, "monotonic", lambda: clock.now)
    monkeypatch.setattr(time, "sleep", clock.sleep)
    return clock


def test_a_swarm_of_100_steps_a_second_sleeps_in_each_step_until_10_ms_have_passed(clock: FakeClock) -> None:
    """The recorder is called after each step, and sleeps for what is missing of 10 ms since its last call.

    The work of steps between its calls takes 2 ms, no time and 50 ms. The 40 ms too many are not made up for.
    Of 20,000 steps only every second one has a state, so nothing is recorded of a swarm after one step.
    """
    recorder = SwarmRecorder(swarm_settings(steps=20_000), pace=100)
    swarm_after_step: Any = SimpleNamespace(ticks=1)
    recorder(swarm_after_step)
    for seconds_of_work in (0.002, 0.0, 0.05):
        clock.now += seconds_of_work
        recorder(swarm_after_step)

    first_sleep, sleep_after_2_ms, sleep_after_no_time, sleep_after_50_ms = clock.sleeps
    assert first_sleep == 0
    assert sleep_after_2_ms == pytest.approx(0.010 - 0.002)
    assert sleep_after_no_time == pytest.approx(0.010)
    assert sleep_after_50_ms == 0


@pytest.mark.parametrize("pace", [-1, float("nan")])
def test_a_pace_that_is_negative_or_no_number_is_refused(pace: float) -> None:
    """The pace is the number of steps a second at which a viewed swarm runs."""
    with pytest.raises(UsageError, match=f"--pace is {pace}; give steps a second"):
        SwarmRecorder(swarm_settings(), pace)


# --- Results that do not fit --------------------------------------------------------------------------


def test_a_trial_whose_simulation_has_other_errors_than_the_results_is_not_shown() -> None:
    """Results hold no states, so the trial is simulated again. Its errors must be equal to the last bit."""
    trials = run_experiment()
    trials_with_other_errors = replace(trials, errors=trials.errors + 1e-9)
    with pytest.raises(UsageError, match="trial 1 does not come out again"):
        recompute_trial_history(trials_with_other_errors, trial=1)


def test_a_trial_that_is_not_among_the_results_is_refused(trials_of_the_authors: Trials) -> None:
    """The error offers the trials that there are: 0 and 1 of an experiment, and 2 alone of the authors."""
    two_trials = run_experiment()
    with pytest.raises(UsageError, match="there is no trial 2; choose one of 0 to 1"):
        recompute_trial_history(two_trials, trial=2)
    with pytest.raises(UsageError, match="there is no trial 0; choose one of 2 to 2"):
        recorded_trial_history(trials_of_the_authors, trial=0)


def test_a_trial_of_a_billion_steps_is_not_simulated_again_to_be_shown() -> None:
    """A UsageError says that trials of at most 100 million steps are.

    Results of ten steps are changed, so that they claim to have a billion.
    """
    trials = run_experiment(robots=2, steps=10, filter="none")
    experiment_of_a_billion_steps = replace(trials.experiment, steps=10**9)
    long_trials = replace(trials, experiment=experiment_of_a_billion_steps)
    with pytest.raises(UsageError, match=r"too long to be run for a view; .* at most 100000000 steps"):
        recompute_trial_history(long_trials, trial=0)


# --- Trials of another program ------------------------------------------------------------------------


@pytest.fixture
def trials_of_the_authors(tmp_path: Path) -> Trials:
    """A trial of the paper's authors, recorded every 20 of its 60 steps."""
    [trials] = read_trials([write_trial(tmp_path / "trial.json", FIXED, number=2)], sampling_interval=20)
    return trials


@pytest.fixture
def authors_history(trials_of_the_authors: Trials) -> History:
    """The history of the authors' trial, whose number is 2."""
    return recorded_trial_history(trials_of_the_authors, trial=2)


def test_a_state_of_the_authors_trial_has_the_recorded_values_of_all_robots(
    trials_of_the_authors: Trials, authors_history: History
) -> None:
    """The file of the trial has x, x_hat and b_hat of each robot at steps; the last state is compared.

    The true accuracy, 0.95, is a parameter of the experiment.
    """
    *_, last_state = states_of(authors_history)
    x, x_hat, b_hat, true_accuracy = last_state.values

    for name, values_of_robots in (("x", x), ("x_hat", x_hat), ("b_hat", b_hat)):
        (records_of_only_trial,) = trials_of_the_authors.records[name]
        *_, record_of_last_step = records_of_only_trial
        assert np.array_equal(values_of_robots, record_of_last_step), name
    assert (true_accuracy == 0.95).all()


def test_the_history_of_an_authors_trial_has_a_state_for_each_recorded_step(authors_history: History) -> None:
    """Every 20th of the 60 steps of the trial is recorded, and so is its start."""
    assert ticks_of(authors_history) == [0, 20, 40, 60]


def test_an_authors_trial_is_shown_without_an_arena_without_positions_and_without_links(
    authors_history: History,
) -> None:
    """Their files do not record where robots are, nor which of them receive each other."""
    assert authors_history.description.sides is None
    for state in states_of(authors_history):
        assert state.positions is None
        assert len(state.links) == 0


def test_the_title_of_an_authors_trial_names_their_program_by_its_repository(
    authors_history: History,
) -> None:
    """Two of the five robots of the trial with number 2 are flawed."""
    title = authors_history.description.title
    assert title.startswith("5 robots, 2 flawed, ")
    assert title.endswith(", trial 2 of NESTLab/sensor-degradation-filter")


def test_a_long_trial_of_the_paper_s_authors_is_shown_with_every_second_recorded_state(
    trials_of_the_authors: Trials, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The states 0, 20, 40 and 60 are recorded, and at most two are shown here. The real limit is 10,000."""
    monkeypatch.setattr(history_module, "MAX_STATES", 2)
    history = recorded_trial_history(trials_of_the_authors, trial=2)
    assert ticks_of(history) == [0, 40]


def test_a_trial_of_the_paper_s_authors_that_was_converted_without_records_cannot_be_shown(
    trials_of_the_authors: Trials,
) -> None:
    """The error says by which command the trial can be converted again with its values."""
    trials_without_records = replace(trials_of_the_authors, records={}, sampling_interval=0)
    message = r"nothing is recorded .* run mcp-asdf convert again, without --record 0"
    with pytest.raises(UsageError, match=message):
        recorded_trial_history(trials_without_records, trial=2)
