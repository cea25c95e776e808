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

import mcp_asdf_tools as m
from mcp_asdf.mirror import MirrorRobot
from mcp_asdf.reference import ReferenceRobot
from mcp_asdf.robot import Config
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.common.figures import add_legend, empty_figure
from mcp_asdf_tools.experiments.result_tables import trials_to_table
from mcp_asdf_tools.experiments.results import Trials
from mcp_asdf_tools.experiments.trials import run_trials
from mcp_asdf_tools.swarm.swarm import Swarm
from support import ROOT, run

UNTYPED: Any = m
"""The library without its types, as in a notebook: type checkers let wrong arguments pass."""


def small_experiment(**changes: Any) -> m.Experiment:
    """Return an experiment of 120 steps with a flawed robot among four; ``changes`` replace parameters."""
    parameters: dict[str, Any] = {
        "robots": 4,
        "flawed": 1,
        "filter": "asdf-plus",
        "filter_period": 20,
        "steps": 120,
        "trials": 3,
    }
    return m.Experiment(**parameters | changes)


def small_swarm(**changes: Any) -> m.SwarmSettings:
    """Return settings of a swarm that runs 60 steps, like ``small_experiment``."""
    parameters: dict[str, Any] = {
        "robots": 4,
        "flawed": 1,
        "filter": "asdf-plus",
        "filter_period": 20,
        "steps": 60,
    }
    return m.SwarmSettings(**parameters | changes)


def simulate_one(experiment: m.Experiment) -> Trials:
    """Run the trials of an experiment, and return them instead of the table that has them."""
    all_trials = list(m.experiments_in(m.simulate(experiment)))
    assert len(all_trials) == 1, "a table of one experiment has the trials of one"
    return all_trials[0]


# --- Names -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", m.__all__)
def test_every_name_of_the_library_is_on_its_page_and_has_a_docstring(name: str) -> None:
    page = (ROOT / "docs/api.md").read_text(encoding="utf-8")
    assert f"m.{name}" in page or f"`{name}`" in page
    assert getattr(m, name).__doc__


def test_a_name_that_the_library_does_not_have_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="module mcp_asdf_tools has no attribute emulat"):
        _ = m.emulat


def test_a_star_imports_every_name_of_the_library() -> None:
    names: dict[str, object] = {}
    exec("from mcp_asdf_tools import *", names)
    assert set(m.__all__) <= names.keys()


def test_importing_the_library_loads_neither_matplotlib_nor_pyarrow() -> None:
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
    m.simulate(small_experiment(), path)
    return path


def test_simulate_returns_the_table_of_an_experiment_s_trials(expected_table: Any) -> None:
    assert m.simulate(small_experiment()).equals(expected_table)


def test_simulate_returns_the_same_table_with_a_file_and_worker_processes(
    expected_table: Any, tmp_path: Path
) -> None:
    table = m.simulate([small_experiment()], tmp_path / "grid.parquet", workers=2)
    assert table.equals(expected_table)


def test_results_are_read_and_scored_without_change(expected_table: Any, results_file: Path) -> None:
    assert m.score(m.read_table(results_file)).equals(expected_table)


def test_results_that_were_read_can_be_plotted(results_file: Path) -> None:
    assert isinstance(m.plot_boxes(m.read_table(results_file)), Figure)


def test_simulate_takes_finished_trials_from_the_file(
    expected_table: Any, results_file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without jobs no trial can be run, so all that is returned must come from the file."""
    monkeypatch.setattr("mcp_asdf_tools.experiments.sweep.jobs_of", lambda store: iter([]))
    assert m.simulate(small_experiment(), str(results_file)).equals(expected_table)


def test_simulate_refuses_a_file_with_results_of_other_experiments(results_file: Path) -> None:
    with pytest.raises(m.UsageError, match="results of other experiments"):
        m.simulate(m.grid(robots=3, steps=50, trials=1), results_file)


# --- Swarms ----------------------------------------------------------------------------------------------


def run_to_end(swarm: Swarm) -> None:
    """Let a swarm of 60 steps take them all."""
    for _ in range(60):
        swarm.tick()


def images_of_robots(swarm: Swarm) -> list[bytes]:
    """Return the states of a swarm's robots, all of which have fixed-point firmware."""
    return [cast(Any, node.robot).save() for node in swarm.nodes]


def test_a_program_that_listens_on_a_swarm_s_channel_gets_frames_with_simulated_times() -> None:
    """The time of a simulated swarm begins at 0. The clock's time, in seconds since 1970, is much later."""
    with m.start_swarm(small_swarm(), "times") as swarm, can.Bus("times", "virtual") as listener:
        swarm.tick()
        frame = listener.recv(timeout=0)

    assert frame is not None
    assert frame.timestamp < 1


def test_a_swarm_on_a_channel_ends_in_the_same_bits_as_one_without() -> None:
    settings = small_swarm(faults=("loss=0.2",))
    with m.start_swarm(settings) as swarm, m.start_swarm(settings, "same bits") as swarm_on_channel:
        run_to_end(swarm)
        run_to_end(swarm_on_channel)
        assert images_of_robots(swarm) == images_of_robots(swarm_on_channel)


def test_emulate_reports_the_estimates_at_the_end_of_the_swarm() -> None:
    settings = small_swarm(faults=("loss=0.2",))
    with m.start_swarm(settings) as swarm:
        run_to_end(swarm)
        estimates = [node.robot.x for node in swarm.nodes]
    rows = m.emulate(settings).results["robots"]

    assert [row["x"] for row in rows] == estimates


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
def test_a_graph_may_be_any_of_its_usual_objects(graph: Any, edges: str) -> None:
    assert str(small_experiment(topology="graph", graph=graph).graph) == edges


@pytest.mark.parametrize(
    "graph",
    [5, [(0, 1, 2)], [("a", "b")], np.ones((2, 3), np.bool_), [(0, 200)]],
    ids=["number", "triple", "letters", "matrix that is not square", "id of no robot"],
)
def test_an_object_that_is_no_graph_of_the_swarm_is_refused(graph: Any) -> None:
    with pytest.raises(m.UsageError):
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


MAX_ERROR_OF_FIRMWARE = 1e-4
"""Fixed point and floats differ by less than this in so short a run."""
in_either_order = pytest.mark.parametrize("firmware", [make_mirror_for_even_ids, make_mirror_for_odd_ids])


@in_either_order
def test_a_simulated_swarm_may_mix_robots_of_integers_and_of_floats(firmware: Any) -> None:
    mixed = simulate_one(small_experiment(trials=1, firmware=firmware))
    native = simulate_one(small_experiment(trials=1))
    assert np.allclose(mixed.b_hat, native.b_hat, atol=MAX_ERROR_OF_FIRMWARE)


@in_either_order
def test_a_swarm_on_a_bus_may_mix_robots_of_integers_and_of_floats(firmware: Any) -> None:
    mixed = m.emulate(small_swarm(firmware=firmware)).results["mean_error"]
    native = m.emulate(small_swarm()).results["mean_error"]
    assert mixed == pytest.approx(native, abs=MAX_ERROR_OF_FIRMWARE)


def make_robot_without_estimates(config: Config, robot_id: int, b_hat: float) -> Any:
    """Return an object that can observe and settle, but has neither estimates nor accuracies."""
    return SimpleNamespace(id=robot_id, observe=lambda z: None, settle=lambda: None)


MISSING_ATTRIBUTES = "SimpleNamespace without alpha, b_hat, beta, .* x_hat"


def test_simulate_refuses_robots_that_lack_attributes() -> None:
    experiment = small_experiment(firmware=make_robot_without_estimates)
    with pytest.raises(UsageError, match=MISSING_ATTRIBUTES):
        m.simulate(experiment)


def test_emulate_refuses_robots_that_lack_attributes() -> None:
    settings = small_swarm(firmware=make_robot_without_estimates)
    with pytest.raises(UsageError, match=MISSING_ATTRIBUTES):
        m.emulate(settings)


class RobotWithOneRawMethod(ReferenceRobot):
    """Has one of the attributes that robots with raw values have, and lacks the others."""

    def receive_all(self, messages: Any) -> int:
        return len(messages)


def test_a_robot_with_some_of_the_raw_values_is_refused() -> None:
    settings = small_swarm(firmware=RobotWithOneRawMethod)
    message = r"a RobotWithOneRawMethod without alpha_raw, .*give it all that mcp_asdf.Fixed"
    with pytest.raises(UsageError, match=message):
        m.emulate(settings)


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


@pytest.mark.parametrize("accuracy", [0.7, 0.9])
def test_a_class_of_the_user_s_can_be_the_firmware_of_an_experiment(accuracy: float) -> None:
    """A user may give a class of their own as the firmware; here it assumes one accuracy once it filters."""
    firmware = robot_class_with_b_hat(accuracy)
    experiment = small_experiment(trials=1, activation="always", firmware=firmware)
    trials = simulate_one(experiment)

    assert trials.experiment == experiment
    assert trials.b_hat[0, -1].tolist() == [accuracy] * 4


def test_experiments_with_different_firmware_classes_of_one_name_are_different() -> None:
    """Both classes are called RobotOfOneAccuracy."""
    low, high = robot_class_with_b_hat(0.7), robot_class_with_b_hat(0.9)
    assert small_experiment(firmware=low) != small_experiment(firmware=high)
    assert small_experiment(firmware=low) == small_experiment(firmware=low)


def test_an_experiment_runs_its_own_firmware_class_after_another_of_the_same_name_was_given() -> None:
    low, high = robot_class_with_b_hat(0.7), robot_class_with_b_hat(0.9)
    first, second = [
        small_experiment(trials=1, activation="always", firmware=firmware) for firmware in (low, high)
    ]

    assert simulate_one(second).b_hat[0, -1].tolist() == [0.9] * 4
    assert simulate_one(first).b_hat[0, -1].tolist() == [0.7] * 4


def make_sensors_that_see_black(settings: object, trial: int) -> Any:
    """Return sensors that always read black: right on every black tile, and wrong on every white one."""
    accuracy_on_black, accuracy_on_white = np.ones((1, 1)), np.zeros((1, 1))
    return SimpleNamespace(advance=lambda steps: (accuracy_on_black, accuracy_on_white))


def test_a_function_of_the_user_s_can_make_the_sensors_of_an_experiment() -> None:
    experiment = small_experiment(trials=3, sensor=make_sensors_that_see_black)
    assert experiment.sensor.endswith("make_sensors_that_see_black")
    assert len(m.simulate(experiment)) == 3


def test_two_classes_of_one_name_are_refused_in_one_table() -> None:
    """A table has only the name of an experiment's firmware, so it could not tell the two apart."""
    experiments = [
        small_experiment(firmware=robot_class_with_b_hat(0.7)),
        small_experiment(firmware=robot_class_with_b_hat(0.9)),
    ]
    message = r"two objects are called .*RobotOfOneAccuracy; give them different names"

    with pytest.raises(UsageError, match=message):
        m.simulate(experiments)


def test_a_firmware_class_that_workers_cannot_import_is_refused() -> None:
    """A class inside a function is no attribute of its module, so other processes cannot find it there."""
    experiment = small_experiment(firmware=robot_class_with_b_hat(0.7))
    message = r"RobotOfOneAccuracy cannot be sent to worker processes: .*take one worker"
    with pytest.raises(UsageError, match=message):
        m.simulate(experiment, workers=2)


def test_a_class_of_a_notebook_is_refused_for_workers(monkeypatch: pytest.MonkeyPatch) -> None:
    """Worker processes would have to import it, and a notebook is no module that can be imported."""

    class ClassOfNotebook(ReferenceRobot):
        pass

    # A notebook's classes are attributes of __main__, which has no file that workers could import.
    ClassOfNotebook.__module__ = "__main__"
    ClassOfNotebook.__qualname__ = "ClassOfNotebook"
    monkeypatch.setattr(sys.modules["__main__"], "ClassOfNotebook", ClassOfNotebook, raising=False)
    monkeypatch.delattr(sys.modules["__main__"], "__file__", raising=False)
    experiment = small_experiment(firmware=ClassOfNotebook)
    with pytest.raises(UsageError, match="ClassOfNotebook exists in this session only"):
        m.simulate(experiment, workers=2)


@pytest.mark.slow
def test_a_class_of_a_module_is_sent_to_workers() -> None:
    """Two worker processes run its trials, with the results that this process computes alone."""
    experiment = small_experiment(firmware=ReferenceRobot)
    assert m.simulate(experiment, workers=2).equals(m.simulate(experiment))


@pytest.fixture(scope="module")
def trials_of_extension() -> Trials:
    """Trials of a class that is no installed extension, as they are read from a table."""
    return simulate_one(small_experiment(firmware=DataSheetRobot))


def test_results_of_an_extension_that_is_not_installed_can_be_read(trials_of_extension: Trials) -> None:
    assert trials_of_extension.experiment.firmware.endswith("test_library.DataSheetRobot")


def test_an_experiment_of_an_extension_that_is_not_installed_cannot_be_run(
    trials_of_extension: Trials,
) -> None:
    with pytest.raises(UsageError, match=r"no extension '.*DataSheetRobot' is installed"):
        m.simulate(trials_of_extension.experiment)


# --- Wrong arguments are one kind of error ---------------------------------------------------------------


@pytest.fixture(scope="module")
def recorded_table() -> Any:
    """The table of the small experiment, with values recorded at its last step, 120."""
    return m.simulate(small_experiment(), record=120)


def test_grid_refuses_an_unknown_parameter() -> None:
    with pytest.raises(m.UsageError):
        UNTYPED.grid(robot=3)


def test_an_experiment_refuses_a_number_as_firmware() -> None:
    with pytest.raises(m.UsageError):
        UNTYPED.Experiment(firmware=7)


def test_simulate_refuses_a_number_as_experiment() -> None:
    with pytest.raises(m.UsageError):
        UNTYPED.simulate([7])


@pytest.mark.parametrize("options", [{"workers": 0}, {"record": 121}, {"record": -1}], ids=str)
def test_simulate_refuses_an_option_out_of_its_range(options: dict[str, int]) -> None:
    """The experiment has 120 steps, so none can be recorded every 121."""
    with pytest.raises(m.UsageError):
        UNTYPED.simulate(small_experiment(), **options)


def test_plot_boxes_refuses_an_empty_list() -> None:
    with pytest.raises(m.UsageError):
        UNTYPED.plot_boxes([])


def test_plot_boxes_refuses_an_unknown_parameter_to_choose_by(recorded_table: Any) -> None:
    with pytest.raises(m.UsageError):
        UNTYPED.plot_boxes(recorded_table, where={"filtr": "none"})


def test_plot_curve_refuses_a_function_that_returns_one_value_for_three_trials(recorded_table: Any) -> None:
    with pytest.raises(m.UsageError):
        UNTYPED.plot_curve(recorded_table, "flawed", lambda trials: [1.0])


def test_show_refuses_a_trial_that_the_table_does_not_have(recorded_table: Any) -> None:
    with pytest.raises(m.UsageError):
        UNTYPED.show(recorded_table, trial=99)


def test_show_refuses_a_negative_trial() -> None:
    with pytest.raises(m.UsageError):
        UNTYPED.show(small_experiment(), where={"robots": 99}, trial=-1)


def test_read_experiments_refuses_a_file_that_does_not_exist() -> None:
    with pytest.raises(m.UsageError):
        UNTYPED.read_experiments("none.toml")


# --- Pictures --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("label_length", "entries", "columns"),
    [(1, 8, 6), (12, 8, 3), (20, 8, 2), (28, 8, 1), (200, 8, 1), (1, 2, 2)],
)
def test_a_legend_has_as_many_columns_as_fit(label_length: int, entries: int, columns: int) -> None:
    figure = empty_figure(6, 3)
    add_legend(figure, [Line2D([], [], label="m" * label_length) for _ in range(entries)])
    assert len(figure.legends) == 1
    assert cast(Any, figure.legends[0])._ncols == columns


@pytest.fixture(scope="module")
def grid_table() -> Any:
    """The table of four experiments: with one and two flawed robots, without a filter and with one."""
    return m.simulate(m.grid(flawed=[1, 2], filter=["none", "asdf-plus"], robots=4, steps=60, trials=2))


def test_a_curve_is_of_the_chosen_experiments_and_drawn_into_the_caller_s_axes(grid_table: Any) -> None:
    figure = Figure()
    returned_figure = m.plot_curve(
        grid_table,
        "flawed",
        lambda trials: trials.errors[:, 0],
        where={"filter": "none"},
        ax=figure.subplots(),
    )

    assert returned_figure is figure
    assert len(figure.axes[0].lines) == 1


@pytest.fixture(scope="module")
def figure_of_facets(grid_table: Any) -> Any:
    """A figure of curves with axes for each filter."""
    return m.plot_curve(grid_table, "flawed", facet="filter")


def test_facets_are_titled_with_their_parameter(figure_of_facets: Any) -> None:
    titles = [axes.get_title() for axes in figure_of_facets.axes]
    assert titles == ["filter none", "filter asdf-plus"]


def test_a_plot_has_grid_lines_behind_its_curves(figure_of_facets: Any) -> None:
    axes = figure_of_facets.axes[0]
    assert axes.get_axisbelow()
    assert axes.yaxis.get_gridlines()[0].get_visible()


def test_a_plot_has_small_figures_and_no_frame(figure_of_facets: Any) -> None:
    axes = figure_of_facets.axes[0]
    assert axes.yaxis.get_ticklabels()[0].get_fontsize() == 8
    assert not axes.spines["top"].get_visible()


def test_a_notebook_shows_a_figure_with_150_pixels_an_inch(figure_of_facets: Any) -> None:
    picture = figure_of_facets._repr_png_()
    width_in_pixels = int.from_bytes(picture[16:20], "big")  # the first value of the header of a PNG
    assert picture.startswith(b"\x89PNG")
    assert width_in_pixels == 150 * figure_of_facets.get_figwidth()
