"""``import mcp_asdf_tools``: what it offers is small, loads late and agrees with the rooms behind it."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import replace
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
from mcp_asdf_tools.experiments.trials import run_trials
from support import ROOT, run

SHORT = m.Experiment(robots=4, filter="asdf-plus", steps=120, filter_period=20, trials=3, flawed=1)
SETTINGS = m.SwarmSettings(
    robots=4, filter="asdf-plus", steps=60, filter_period=20, flawed=1, faults=("loss=0.2",)
)


def test_the_page_has_every_name() -> None:
    page = (ROOT / "docs/library.md").read_text(encoding="utf-8")
    for name in m.__all__:
        assert f"m.{name}" in page or f"`{name}`" in page, name
        assert getattr(m, name).__doc__


def test_a_name_that_the_library_does_not_have_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="module mcp_asdf_tools has no attribute emulat"):
        _ = m.emulat


def test_a_star_imports_every_name_of_the_library() -> None:
    names: dict[str, object] = {}
    exec("from mcp_asdf_tools import *", names)
    assert {*m.__all__} <= names.keys()


def test_importing_loads_no_plotting_and_no_tables() -> None:
    check = "assert not {'matplotlib', 'pyarrow'} & {*sys.modules}"
    run(sys.executable, "-c", f"import sys, mcp_asdf_tools as m; m.Experiment; {check}")


def test_an_experiment_gives_the_table_of_its_trials_and_the_same_call_resumes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    expected, output = trials_to_table(run_trials(SHORT, 0, 3)), tmp_path / "grid.parquet"
    assert m.simulate(SHORT).equals(expected)
    assert m.simulate([SHORT], output, workers=2).equals(expected)
    assert m.score(m.read_table(output)).equals(expected)
    assert isinstance(m.plot_boxes(m.read_table(output)), Figure)
    monkeypatch.setattr("mcp_asdf_tools.experiments.sweep.jobs_of", lambda store: iter([]))
    assert m.simulate(SHORT, str(output)).equals(expected), "nothing was left to run"
    with pytest.raises(m.UsageError, match="results of other experiments"):
        m.simulate(m.grid(robots=3, steps=50, trials=1), output)


def test_a_swarm_on_a_channel_is_heard_and_ends_in_the_same_bits() -> None:
    with m.start_swarm(SETTINGS) as alone, m.start_swarm(SETTINGS, "library test") as heard:
        with can.Bus("library test", "virtual") as other:
            for _ in range(SETTINGS.steps):
                alone.tick()
                heard.tick()
            frame = other.recv(0)
            assert frame is not None and frame.timestamp < 1, "simulated time"
        robots, others = ([cast(Any, node.robot) for node in swarm.nodes] for swarm in (alone, heard))
        assert [each.save() for each in robots] == [each.save() for each in others]
        whole = m.emulate(SETTINGS)
        assert [each["x"] for each in whole.results["robots"]] == [each.x for each in robots]


# --- Objects in place of names ---


class Undirected:
    """What networkx calls a graph, as far as it is asked."""

    def __init__(self, edges: list[Any], directed: bool = False) -> None:
        self.edges, self.is_directed = lambda: edges, lambda: directed


def test_a_graph_may_be_any_of_its_usual_objects() -> None:
    hears = np.zeros((4, 4), np.bool_)
    hears[1, 0] = hears[0, 1] = hears[2, 1] = True  # 2 hears 1, who does not hear 2
    pairs = [(0, 1), (np.int64(1), 2)]
    for given, edges in (
        (pairs, "0 1; 1 2"),
        (np.array(pairs), "0 1; 1 2"),
        (Undirected(pairs), "0 1; 1 2"),
        (Undirected(pairs, directed=True), "0 > 1; 1 > 2"),
        (hears, "0 1; 1 > 2"),
    ):
        assert str(replace(SHORT, topology="graph", graph=given).graph) == edges
    for wrong in (5, [(0, 1, 2)], [("a", "b")], np.ones((2, 3), np.bool_), [(0, 200)]):
        with pytest.raises(m.UsageError):
            replace(SHORT, topology="graph", graph=wrong)


@pytest.mark.parametrize("first_kind", [MirrorRobot, ReferenceRobot])
def test_an_extension_may_mix_robots_with_and_without_raw_values(first_kind: Any) -> None:
    def mix(config: Config, robot_id: int, b_hat: float) -> Any:
        other_kind = ReferenceRobot if first_kind is MirrorRobot else MirrorRobot
        make = other_kind if robot_id % 2 else first_kind
        return make(config, robot_id, b_hat)

    firmware: Any = mix
    experiment = replace(SHORT, trials=1, firmware=firmware)
    (trials,) = m.experiments_in(m.simulate(experiment))
    (native_trials,) = m.experiments_in(m.simulate(replace(SHORT, trials=1)))
    assert np.allclose(trials.b_hat, native_trials.b_hat, atol=1e-4)
    settings = replace(SETTINGS, firmware=firmware, faults=())
    assert m.emulate(settings).results["mean_error"] == pytest.approx(
        m.emulate(replace(SETTINGS, faults=())).results["mean_error"], abs=1e-4
    )


@pytest.mark.parametrize("run", [m.simulate, m.emulate])
def test_an_extension_whose_robots_lack_something_is_refused(run: Any) -> None:
    def incomplete(config: Config, robot_id: int, b_hat: float) -> Any:
        return SimpleNamespace(id=robot_id, observe=print, settle=print)

    settings: Any = SHORT if run is m.simulate else SETTINGS
    with pytest.raises(UsageError, match=r"SimpleNamespace without alpha, b_hat, beta, .* x_hat"):
        run(replace(settings, firmware=incomplete))


def test_an_extension_with_some_of_the_raw_values_is_refused() -> None:
    class HalfRaw(ReferenceRobot):
        def receive_all(self, messages: Any) -> int:
            return len(messages)

    settings = replace(SETTINGS, firmware=cast(Any, HalfRaw))
    with pytest.raises(UsageError, match=r"a HalfRaw without alpha_raw, .*give it all that mcp_asdf.Fixed"):
        m.emulate(settings)


class DataSheetRobot(ReferenceRobot):
    """A robot that takes the accuracy of the data sheet where the test rejects."""

    def reestimate_b_hat(self) -> float | None:
        return 0.95


def always(accuracy: float) -> Any:
    class Always(ReferenceRobot):
        def reestimate_b_hat(self) -> float | None:
            return accuracy

    return Always


def test_objects_of_this_process_stand_for_extensions() -> None:
    """Two that are called alike are told apart."""
    low, high = always(0.7), always(0.9)
    common = replace(SHORT, trials=1, activation="always")
    experiments = [replace(common, firmware=each) for each in (low, high, low)]
    assert experiments[0] == experiments[2] != experiments[1]
    for experiment, accuracy in zip(experiments, (0.7, 0.9, 0.7), strict=True):
        (trials,) = m.experiments_in(m.simulate(experiment))
        assert trials.experiment == experiment and np.all(trials.b_hat[0, -1] == accuracy)

    def dazzled(settings: object, trial: int) -> object:
        return SimpleNamespace(advance=lambda steps: (np.ones((1, 1)), np.zeros((1, 1))))

    given: Any = {"sensor": dazzled}
    blind = replace(SHORT, **given)
    assert blind.sensor.endswith("dazzled") and len(m.simulate(blind)) == 3


def test_objects_that_are_called_alike_are_refused_in_one_table() -> None:
    experiments = [replace(SHORT, firmware=always(accuracy)) for accuracy in (0.7, 0.9)]
    with pytest.raises(UsageError, match=r"two objects are called .*Always; give them different names"):
        m.simulate(experiments)


def test_an_object_that_workers_cannot_import_is_refused() -> None:
    with pytest.raises(UsageError, match=r"Always cannot be sent to worker processes: .*take one worker"):
        m.simulate(replace(SHORT, firmware=always(0.7)), workers=2)


def test_a_class_of_a_notebook_is_refused_for_workers(monkeypatch: pytest.MonkeyPatch) -> None:
    class OfNotebook(ReferenceRobot):
        pass

    OfNotebook.__module__, OfNotebook.__qualname__ = "__main__", "OfNotebook"
    monkeypatch.setattr(sys.modules["__main__"], "OfNotebook", OfNotebook, raising=False)
    monkeypatch.delattr(sys.modules["__main__"], "__file__", raising=False)
    with pytest.raises(UsageError, match="OfNotebook exists in this session only"):
        m.simulate(replace(SHORT, firmware=cast(Any, OfNotebook)), workers=2)


def test_a_class_of_a_module_is_sent_to_workers() -> None:
    experiment = replace(SHORT, firmware=cast(Any, ReferenceRobot))
    assert m.simulate(experiment, workers=2).equals(m.simulate(experiment))


def test_results_of_an_extension_that_is_not_installed_can_be_read_but_not_run() -> None:
    (trials,) = m.experiments_in(m.simulate(replace(SHORT, firmware=cast(Any, DataSheetRobot))))
    assert trials.experiment.firmware.endswith("test_library.DataSheetRobot")
    with pytest.raises(UsageError, match=r"no extension '.*DataSheetRobot' is installed"):
        m.simulate(trials.experiment)


@pytest.mark.parametrize(
    "wrong",
    [
        lambda m, table: m.grid(robot=3),
        lambda m, table: m.Experiment(firmware=7),
        lambda m, table: m.simulate([7]),
        lambda m, table: m.simulate(SHORT, workers=0),
        lambda m, table: m.simulate(SHORT, record=SHORT.steps + 1),
        lambda m, table: m.simulate(SHORT, record=-1),
        lambda m, table: m.plot_boxes([]),
        lambda m, table: m.plot_curve(table, "flawed", lambda trials: [1.0]),
        lambda m, table: m.plot_boxes(table, where={"filtr": "none"}),
        lambda m, table: m.show(table, trial=99),
        lambda m, table: m.show(SHORT, where={"robots": 99}, trial=-1),
        lambda m, table: m.read_experiments("none.toml"),
    ],
)
def test_a_wrong_argument_is_one_kind_of_error(wrong: Callable[[Any, Any], object]) -> None:
    """Without types, as in a notebook."""
    with pytest.raises(m.UsageError):
        wrong(m, m.simulate(SHORT, record=SHORT.steps))


# --- Pictures ---


def test_a_legend_has_the_columns_that_fit() -> None:
    for letters, count, columns in ((1, 8, 6), (12, 8, 3), (20, 8, 2), (28, 8, 1), (200, 8, 1), (1, 2, 2)):
        figure = empty_figure(6, 3)
        add_legend(figure, [Line2D([], [], label="m" * letters) for _ in range(count)])
        assert [each._ncols for each in cast(list[Any], figure.legends)] == [columns]


def test_a_curve_is_of_the_chosen_and_goes_into_axes_of_ones_own() -> None:
    table = m.simulate(m.grid(flawed=[1, 2], filter=["none", "asdf-plus"], robots=4, steps=60, trials=2))
    figure, where = Figure(), {"filter": "none"}
    drawn = m.plot_curve(
        table, "flawed", lambda trials: trials.errors[:, 0], where=where, ax=figure.subplots()
    )
    assert drawn is figure and len(figure.axes[0].lines) == 1
    both: Any = m.plot_curve(table, "flawed", facet="filter")
    first = both.axes[0]  # light lines behind the curves, small figures and no frame
    assert first.get_axisbelow() and first.yaxis.get_gridlines()[0].get_visible()
    assert first.yaxis.get_ticklabels()[0].get_fontsize() == 8 and not first.spines["top"].get_visible()
    shown = both._repr_png_()  # by a notebook, 150 pixels an inch
    assert shown[:4] == b"\x89PNG" and int.from_bytes(shown[16:20], "big") == 150 * both.get_figwidth()
    assert [each.get_title() for each in both.axes] == ["filter none", "filter asdf-plus"]
