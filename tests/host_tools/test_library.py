"""``import mcp_asdf_tools``: what it offers is small, loads late and agrees with the rooms behind it."""

from __future__ import annotations

import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import can
import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

import mcp_asdf_tools
from mcp_asdf.mirror import MirrorRobot
from mcp_asdf.reference import ReferenceRobot
from mcp_asdf.robot import Config
from mcp_asdf_tools import (
    Experiment,
    SwarmSettings,
    UsageError,
    emulate,
    experiments_in,
    grid,
    plot_boxes,
    plot_curve,
    read_table,
    score,
    simulate,
    start_swarm,
)
from mcp_asdf_tools.common.figures import add_legend, empty_figure
from mcp_asdf_tools.experiments.result_tables import trials_to_table
from mcp_asdf_tools.experiments.results import Trials
from mcp_asdf_tools.experiments.trials import run_trials
from mcp_asdf_tools.swarm.swarm import Swarm
from support import ROOT, run

UNTYPED: Any = mcp_asdf_tools
"""The library without its types, as in a notebook: type checkers let wrong arguments pass."""


FOUR_ROBOTS: dict[str, Any] = {"robots": 4, "flawed": 1, "filter": "asdf-plus", "filter_period": 20}


def small_experiment(**changes: Any) -> Experiment:
    """Return an experiment of 120 steps with a flawed robot among four; ``changes`` replace parameters."""
    return Experiment(**FOUR_ROBOTS | {"steps": 120, "trials": 3} | changes)


def small_swarm(**changes: Any) -> SwarmSettings:
    """Return settings of a swarm that runs 60 steps, like ``small_experiment``."""
    return SwarmSettings(**FOUR_ROBOTS | {"steps": 60} | changes)


def simulate_one(experiment: Experiment) -> Trials:
    """Run the trials of an experiment, and return them instead of the table that has them."""
    all_trials = list(experiments_in(simulate(experiment)))
    assert len(all_trials) == 1, "a table of one experiment has the trials of one"
    return all_trials[0]


# --- Names -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", mcp_asdf_tools.__all__)
def test_every_name_of_the_library_is_on_its_page_and_has_a_docstring(name: str) -> None:
    """The page is docs/api.md, and ``m`` is the library in its examples."""
    page = (ROOT / "docs/api.md").read_text(encoding="utf-8")
    assert f"m.{name}" in page or f"`{name}`" in page
    assert getattr(mcp_asdf_tools, name).__doc__


def test_a_name_that_the_library_does_not_have_raises_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="module mcp_asdf_tools has no attribute emulat"):
        _ = mcp_asdf_tools.emulat


def test_import_star_imports_every_name_of_the_library() -> None:
    """The names are loaded when they are first used, which ``from mcp_asdf_tools import *`` must cause."""
    names: dict[str, object] = {}
    exec("from mcp_asdf_tools import *", names)
    assert set(mcp_asdf_tools.__all__) <= names.keys()


def test_importing_the_library_loads_neither_matplotlib_nor_pyarrow() -> None:
    """A new Python imports the library and uses one of its names."""
    program = (
        "import sys, mcp_asdf_tools as m\n"
        "m.Experiment\n"
        "assert 'matplotlib' not in sys.modules\n"
        "assert 'pyarrow' not in sys.modules\n"
    )
    run(sys.executable, "-c", program)


# --- Experiments and their results -----------------------------------------------------------------------


@pytest.fixture(scope="module")
def expected_table() -> Any:
    """The table of the small experiment's three trials, made without the library."""
    return trials_to_table(run_trials(small_experiment(), first=0, trials=3))


@pytest.fixture(scope="module")
def results_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A file with the results of the small experiment."""
    path = tmp_path_factory.mktemp("results") / "grid.parquet"
    simulate(small_experiment(), path)
    return path


def test_simulate_returns_the_table_of_an_experiment_s_trials(expected_table: Any) -> None:
    """The expected table is made by other functions, which the library calls, too."""
    assert simulate(small_experiment()).equals(expected_table)


@pytest.mark.slow
def test_simulate_returns_the_same_table_with_a_file_and_two_worker_processes(
    expected_table: Any, tmp_path: Path
) -> None:
    """The table also has the trials in the same order."""
    table = simulate([small_experiment()], tmp_path / "grid.parquet", workers=2)
    assert table.equals(expected_table)


def test_results_that_are_read_from_a_file_and_scored_again_are_the_same_table(
    expected_table: Any, results_file: Path
) -> None:
    """A table of results has the scores already, and the file was written by ``simulate``."""
    assert score(read_table(results_file)).equals(expected_table)


def test_results_that_were_read_can_be_plotted(results_file: Path) -> None:
    assert isinstance(plot_boxes(read_table(results_file)), Figure)


def test_simulate_takes_trials_that_are_in_its_file_already_from_there(
    expected_table: Any, results_file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """No trial can be run here, since there are no jobs, so all that is returned must come from the file."""
    monkeypatch.setattr("mcp_asdf_tools.experiments.sweep.jobs_of", lambda store: iter([]))
    assert simulate(small_experiment(), str(results_file)).equals(expected_table)


def test_simulate_refuses_a_file_with_results_of_other_experiments(results_file: Path) -> None:
    """The file has results of the small experiment. A UsageError says so."""
    with pytest.raises(UsageError, match="results of other experiments"):
        simulate(grid(robots=3, steps=50, trials=1), results_file)


# --- Swarms ----------------------------------------------------------------------------------------------


def run_to_end(swarm: Swarm) -> None:
    """Let a swarm of 60 steps take them all."""
    for _ in range(60):
        swarm.tick()


def images_of_robots(swarm: Swarm) -> list[bytes]:
    """Return the states of a swarm's robots. All robots have fixed-point firmware."""
    return [cast(Any, node.robot).save() for node in swarm.nodes]


def test_a_program_that_listens_on_a_swarm_s_channel_gets_frames_with_simulated_times() -> None:
    """The time of a simulated swarm begins at 0. The clock's time, in seconds since 1970, is much later."""
    with start_swarm(small_swarm(), "times") as swarm, can.Bus("times", "virtual") as listener:
        swarm.tick()
        frame = listener.recv(timeout=0)

    assert frame is not None
    assert frame.timestamp < 1


def test_robots_whose_frames_are_published_on_a_channel_end_in_the_same_state_as_without_it() -> None:
    """Other programs may listen on the channel. A fifth of the frames are lost, at random but repeatably."""
    settings = small_swarm(faults=("loss=0.2",))
    with start_swarm(settings) as swarm, start_swarm(settings, "a channel") as swarm_on_channel:
        run_to_end(swarm)
        run_to_end(swarm_on_channel)
        assert images_of_robots(swarm) == images_of_robots(swarm_on_channel)


def test_emulate_reports_the_estimate_x_of_each_robot_at_the_end() -> None:
    """The same swarm is also run tick by tick. A fifth of the frames are lost, at random but repeatably."""
    settings = small_swarm(faults=("loss=0.2",))
    with start_swarm(settings) as swarm:
        run_to_end(swarm)
        estimates = [node.robot.x for node in swarm.nodes]
    reported_robots = emulate(settings).results["robots"]

    assert [robot["x"] for robot in reported_robots] == estimates


def test_ctrl_c_ends_a_swarm_of_emulate_early_and_its_results_are_kept(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Ctrl-C comes in the fourth step, so three are done. In a notebook only Ctrl-C can end a run early."""
    take_step = Swarm.tick

    def take_step_unless_interrupted(swarm: Swarm) -> None:
        if swarm.ticks == 3:
            raise KeyboardInterrupt
        take_step(swarm)

    monkeypatch.setattr(Swarm, "tick", take_step_unless_interrupted)
    try:
        swarm_run = emulate(small_swarm())
    except KeyboardInterrupt:
        pytest.fail("it left the function, and would end the tests")

    assert swarm_run.interrupted
    assert swarm_run.results["steps"] == 3


# --- Objects in place of names: graphs -------------------------------------------------------------------


class GraphOfNetworkx:
    """Has the two methods of a graph of networkx that the library calls."""

    def __init__(self, edges: list[tuple[int, int]], directed: bool) -> None:
        self._edges = edges
        self._directed = directed

    def edges(self) -> list[tuple[int, int]]:
        return self._edges

    def is_directed(self) -> bool:
        return self._directed


NEIGHBOUR_MATRIX = np.array(
    [
        [False, True, False, False],  # robot 0 receives from robot 1
        [True, False, False, False],  # robot 1 receives from robot 0
        [False, True, False, False],  # robot 2 receives from robot 1, which does not receive from it
        [False, False, False, False],
    ]
)


@pytest.mark.parametrize(
    ("graph", "edges"),
    [
        ([(0, 1), (1, 2)], "0 1; 1 2"),
        ([(0, 1), (np.int64(1), 2)], "0 1; 1 2"),
        (np.array([(0, 1), (1, 2)]), "0 1; 1 2"),
        (GraphOfNetworkx([(0, 1), (1, 2)], directed=False), "0 1; 1 2"),
        (GraphOfNetworkx([(0, 1), (1, 2)], directed=True), "0 > 1; 1 > 2"),
        (NEIGHBOUR_MATRIX, "0 1; 1 > 2"),
    ],
    ids=["pairs", "numpy integers", "array of pairs", "undirected", "directed", "matrix"],
)
def test_a_graph_may_be_given_as_pairs_as_arrays_or_as_an_object_of_networkx(graph: Any, edges: str) -> None:
    """The pairs ``[(0, 1), (1, 2)]``, for example, become the text "0 1; 1 2".

    "0 > 1" is a link of one direction.
    """
    assert str(small_experiment(topology="graph", graph=graph).graph) == edges


@pytest.mark.parametrize(
    "graph",
    [5, [(0, 1, 2)], [("a", "b")], np.ones((2, 3), np.bool_), [(0, 200)]],
    ids=["number", "triple", "letters", "matrix that is not square", "id of no robot"],
)
def test_an_object_that_is_no_graph_of_four_robots_is_refused(graph: Any) -> None:
    """The number 5, or a link to robot 200, for example, raises a UsageError."""
    with pytest.raises(UsageError):
        small_experiment(topology="graph", graph=graph)


# --- Objects in place of names: firmwares ----------------------------------------------------------------


def make_mirror_for_even_ids(config: Config, robot_id: int, b_hat: float) -> Any:
    """Return a robot with raw values, which are the integers of the firmware, or without for odd ids."""
    if robot_id % 2 == 0:
        return MirrorRobot(config, robot_id, b_hat)
    return ReferenceRobot(config, robot_id, b_hat)


def make_mirror_for_odd_ids(config: Config, robot_id: int, b_hat: float) -> Any:
    """Return a robot without raw values, which calculates with floats, or with them for odd ids."""
    if robot_id % 2 == 0:
        return ReferenceRobot(config, robot_id, b_hat)
    return MirrorRobot(config, robot_id, b_hat)


in_either_order = pytest.mark.parametrize("firmware", [make_mirror_for_even_ids, make_mirror_for_odd_ids])


@in_either_order
def test_robots_of_integers_and_of_floats_in_one_simulated_swarm_get_the_accuracies_of_native_ones(
    firmware: Any,
) -> None:
    """Every second robot calculates with the firmware's integers, and the others with floats."""
    mixed = simulate_one(small_experiment(trials=1, firmware=firmware))
    native = simulate_one(small_experiment(trials=1))
    assert mixed.b_hat == pytest.approx(native.b_hat, abs=1e-4)  # integers and floats differ by less


@in_either_order
def test_robots_of_integers_and_of_floats_on_one_bus_have_the_mean_error_of_native_ones(
    firmware: Any,
) -> None:
    """Every second robot calculates with the firmware's integers, and the others with floats."""
    mixed = emulate(small_swarm(firmware=firmware)).results["mean_error"]
    native = emulate(small_swarm()).results["mean_error"]
    assert mixed == pytest.approx(native, abs=1e-4)  # integers and floats differ by less


def make_robot_without_estimates(config: Config, robot_id: int, b_hat: float) -> Any:
    """Return an object that can observe and settle, but has neither estimates nor accuracies."""
    return SimpleNamespace(id=robot_id, observe=lambda z: None, settle=lambda: None)


def test_simulate_and_emulate_refuse_robots_that_lack_attributes_and_name_these() -> None:
    """The robots can observe and settle, but have no estimates."""
    message = r"SimpleNamespace without alpha, b_hat, beta, .* x_hat"
    with pytest.raises(UsageError, match=message):
        simulate(small_experiment(firmware=make_robot_without_estimates))
    with pytest.raises(UsageError, match=message):
        emulate(small_swarm(firmware=make_robot_without_estimates))


class RobotWithOneRawMethod(ReferenceRobot):
    """Has one of the attributes that robots with raw values have, and lacks the others."""

    def receive_all(self, messages: Any) -> int:
        return len(messages)


def test_a_robot_that_has_one_method_of_fixed_point_robots_but_not_the_others_is_refused() -> None:
    """It has the method ``receive_all``, but not, for example, the attribute ``alpha_raw``."""
    settings = small_swarm(firmware=RobotWithOneRawMethod)
    with pytest.raises(UsageError, match="a RobotWithOneRawMethod without alpha_raw, "):
        emulate(settings)


class DataSheetRobot(ReferenceRobot):
    """A robot that takes the accuracy of the data sheet where the test rejects."""

    def reestimate_b_hat(self) -> float | None:
        return 0.95


def robot_class_with_b_hat(accuracy: float) -> Any:
    """Return a class of robots that assume this accuracy once they filter.

    All such classes are called RobotOfOneAccuracy, and none can be imported, as they are made in a function.
    """

    class RobotOfOneAccuracy(ReferenceRobot):
        def reestimate_b_hat(self) -> float | None:
            return accuracy

    return RobotOfOneAccuracy


def final_accuracies(experiment: Experiment) -> Any:
    """Run the only trial of an experiment, and return b_hat of its four robots at the end."""
    [b_hat_by_filter_step] = simulate_one(experiment).b_hat
    return b_hat_by_filter_step[-1].tolist()


def test_an_experiment_can_have_a_robot_class_of_the_user_as_its_firmware() -> None:
    """The class assumes an accuracy of 0.7 as soon as it filters, and the other parameters make it filter."""
    experiment = small_experiment(trials=1, activation="always", firmware=robot_class_with_b_hat(0.7))
    assert final_accuracies(experiment) == [0.7, 0.7, 0.7, 0.7]


def test_experiments_with_different_robot_classes_of_one_name_are_different() -> None:
    """Both classes are called RobotOfOneAccuracy."""
    low, high = robot_class_with_b_hat(0.7), robot_class_with_b_hat(0.9)
    assert small_experiment(firmware=low) != small_experiment(firmware=high)
    assert small_experiment(firmware=low) == small_experiment(firmware=low)


def test_two_experiments_with_robot_classes_of_one_name_are_each_run_with_their_own_class() -> None:
    """Both classes are called RobotOfOneAccuracy; one assumes an accuracy of 0.7, and the other of 0.9."""
    low, high = robot_class_with_b_hat(0.7), robot_class_with_b_hat(0.9)
    first = small_experiment(trials=1, activation="always", firmware=low)
    second = small_experiment(trials=1, activation="always", firmware=high)

    assert final_accuracies(second) == [0.9, 0.9, 0.9, 0.9]
    assert final_accuracies(first) == [0.7, 0.7, 0.7, 0.7]


def make_sensors_that_see_black(settings: object, trial: int) -> Any:
    """Return sensors that always read black: right on every black tile, and wrong on every white one."""
    accuracy_on_black, accuracy_on_white = np.ones((1, 1)), np.zeros((1, 1))
    return SimpleNamespace(advance=lambda steps: (accuracy_on_black, accuracy_on_white))


def test_an_experiment_can_have_sensors_that_a_function_of_the_user_makes() -> None:
    """These sensors always read black, so at the end robots estimate that 100 % of the tiles are black.

    In fact 55 % are.
    """
    experiment = small_experiment(trials=1, filter="none", sensor=make_sensors_that_see_black)
    assert experiment.sensor.endswith("make_sensors_that_see_black")
    [errors_of_robots] = simulate_one(experiment).errors  # of the only trial
    estimate, fill_ratio = 1.0, 0.55
    assert errors_of_robots == pytest.approx(estimate - fill_ratio)


def test_two_experiments_with_robot_classes_of_one_name_are_refused_in_one_table() -> None:
    """A table has only the name of an experiment's firmware, so it could not tell the two apart."""
    low, high = robot_class_with_b_hat(0.7), robot_class_with_b_hat(0.9)
    experiments = [small_experiment(firmware=low), small_experiment(firmware=high)]
    message = r"two objects are called .*RobotOfOneAccuracy; give them different names"

    with pytest.raises(UsageError, match=message):
        simulate(experiments)


def test_a_robot_class_inside_a_function_is_refused_with_two_worker_processes() -> None:
    """The error says to take one worker: other processes cannot find the class in its module."""
    experiment = small_experiment(firmware=robot_class_with_b_hat(0.7))
    message = r"RobotOfOneAccuracy cannot be sent to worker processes: .*take one worker"
    with pytest.raises(UsageError, match=message):
        simulate(experiment, workers=2)


@pytest.fixture
def class_of_notebook(monkeypatch: pytest.MonkeyPatch) -> Any:
    """A robot class as if it had been defined in a notebook: of the module __main__, which has no file."""

    class ClassOfNotebook(ReferenceRobot):
        pass

    ClassOfNotebook.__module__ = "__main__"
    ClassOfNotebook.__qualname__ = "ClassOfNotebook"
    monkeypatch.setattr(sys.modules["__main__"], "ClassOfNotebook", ClassOfNotebook, raising=False)
    monkeypatch.delattr(sys.modules["__main__"], "__file__", raising=False)
    return ClassOfNotebook


def test_a_robot_class_of_a_notebook_is_refused_with_two_worker_processes(class_of_notebook: Any) -> None:
    """Worker processes would have to import it, and cannot import a notebook. A UsageError says so."""
    experiment = small_experiment(firmware=class_of_notebook)
    with pytest.raises(UsageError, match="ClassOfNotebook exists in this session only"):
        simulate(experiment, workers=2)


@pytest.mark.slow
def test_two_worker_processes_run_a_robot_class_of_a_module_with_the_results_of_one_process() -> None:
    """Worker processes import the class from its module."""
    experiment = small_experiment(firmware=ReferenceRobot)
    assert simulate(experiment, workers=2).equals(simulate(experiment))


def test_an_experiment_whose_robot_class_is_not_installed_can_be_read_but_not_run_from_its_results() -> None:
    """The table has only the name of the class, by which no installed extension is found."""
    experiment_in_table = simulate_one(small_experiment(firmware=DataSheetRobot)).experiment
    assert experiment_in_table.firmware.endswith("test_library.DataSheetRobot")
    with pytest.raises(UsageError, match=r"no extension '.*DataSheetRobot' is installed"):
        simulate(experiment_in_table)


# --- Wrong arguments are one kind of error ---------------------------------------------------------------


@pytest.mark.parametrize(
    ("function", "arguments", "options"),
    [
        ("grid", [], {"robot": 3}),  # which is called robots
        ("Experiment", [], {"firmware": 7}),
        ("simulate", [[7]], {}),  # a number as experiment
        ("simulate", [[]], {}),  # no experiment
        ("simulate", [small_experiment()], {"workers": 0}),
        ("simulate", [small_experiment()], {"record": 121}),  # of 120 steps
        ("simulate", [small_experiment()], {"record": -1}),
        ("read_experiments", ["none.toml"], {}),  # which does not exist
    ],
)
def test_wrong_arguments_of_the_library_raise_a_usage_error(
    function: str, arguments: list[Any], options: dict[str, Any]
) -> None:
    """A program can show its text to a user; Python's own errors, such as FileNotFoundError, are others."""
    with pytest.raises(UsageError):
        getattr(UNTYPED, function)(*arguments, **options)


# --- Pictures --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("label_length", "entries", "columns"),
    [(1, 8, 6), (12, 8, 3), (20, 8, 2), (28, 8, 1), (200, 8, 1), (1, 2, 2)],
)
def test_a_legend_below_a_figure_has_as_many_columns_as_fit_its_width(
    label_length: int, entries: int, columns: int
) -> None:
    """The figure is six inches wide: three of eight labels of 12 letters fit into a line, or one of 28."""
    figure = empty_figure(6, 3)
    add_legend(figure, [Line2D([], [], label="m" * label_length) for _ in range(entries)])
    (legend,) = figure.legends
    assert cast(Any, legend)._ncols == columns


@pytest.fixture(scope="module")
def grid_table() -> Any:
    """The table of four experiments: with one and two flawed robots, without a filter and with one."""
    return simulate(grid(flawed=[1, 2], filter=["none", "asdf-plus"], robots=4, steps=60, trials=2))


def error_of_first_robot(trials: Trials) -> Any:
    """Return a value of each trial: the error of its robot 0."""
    return trials.errors[:, 0]  # errors are by trial and robot


def test_plot_curve_draws_one_line_for_the_experiments_without_a_filter(grid_table: Any) -> None:
    """Half of the four experiments have a filter, and the others are chosen."""
    figure = plot_curve(grid_table, "flawed", error_of_first_robot, where={"filter": "none"})
    (axes,) = figure.axes
    assert len(axes.lines) == 1


@pytest.fixture(scope="module")
def figure_of_facets(grid_table: Any) -> Any:
    """A figure of curves with axes for each filter."""
    return plot_curve(grid_table, "flawed", facet="filter")


def test_a_notebook_shows_a_figure_with_150_pixels_an_inch(figure_of_facets: Any) -> None:
    """It shows the PNG file that ``_repr_png_`` returns, which has its width in the bytes 16 to 19."""
    picture = figure_of_facets._repr_png_()
    bytes_of_width = picture[16:20]
    width_in_pixels = int.from_bytes(bytes_of_width, "big")
    assert picture.startswith(b"\x89PNG")
    assert width_in_pixels == 150 * figure_of_facets.get_figwidth()
