"""Each parameter has an effect, and pictures and tables keep experiments apart that differ in it alone.

Other tests draw and read results in which only some parameters vary, and would not notice another one.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import pyarrow as pa  # type: ignore[import-untyped]
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from host_tools.experiments.drawn_figures import results_of, titles_of
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.plots.bands import plot_bands
from mcp_asdf_tools.experiments.plots.boxes import plot_boxes
from mcp_asdf_tools.experiments.plots.curve import plot_curve
from mcp_asdf_tools.experiments.plots.scatter import plot_scatter
from mcp_asdf_tools.experiments.result_files import stream_experiments
from mcp_asdf_tools.experiments.result_tables import trials_to_table
from mcp_asdf_tools.experiments.results import PARAMETER_NAMES, QUANTITIES, Trials
from support import slow

SHORT_SWARM: dict[str, Any] = {
    "robots": 4,
    "flawed": 2,
    "filter": "asdf-plus",
    "topology": "dynamic",
    "density": 4.0,
    "filter_period": 20,
    "steps": 160,
    "trials": 3,
}


@dataclass(frozen=True)
class Pair:
    """Two values of a parameter, and what else has to be given so that the parameter has an effect."""

    first_value: Any
    second_value: Any
    others: dict[str, Any]


def pair(first_value: Any, second_value: Any, **others: Any) -> Pair:
    return Pair(first_value, second_value, others)


PAIRS = {
    "robots": pair(4, 6, flawed="50%"),
    "topology": pair("dynamic", "fully-connected", density=1.0),
    "graph": pair("0 1; 1 2; 2 3", "0 1; 2 3", topology="graph", density=1.0),
    "fill_ratio": pair(0.55, 0.75),
    "true_accuracy": pair(0.95, 0.85),
    "white_offset": pair(0.0, -0.1),
    "drift": pair("none", "linear"),
    "drift_rate": pair(-0.001, -0.002, drift="linear"),
    "lowest_accuracy": pair(0.5, 0.75, drift="linear", drift_rate=-0.01),
    "density": pair(1.0, 2.0),
    "width": pair(2.0, 3.0, height=2.0, density=1.0),
    "height": pair(2.0, 3.0, width=2.0, density=1.0),
    "speed": pair(0.1414, 0.07),
    "radio_range": pair(0.7, 0.5, width=2.0, height=2.0, density=1.0),
    "floor": pair("tiles", "code", fill_ratio=0.55),
    "tile": pair(0.01, 0.1),
    "steps_per_second": pair(10, 20),
    "observation_period": pair(1, 2),
    "steps": pair(160, 180),
    "seed": pair(1, 2),
    "flawed": pair(1, 2),
    "flawed_accuracy": pair(0.55, 0.75),
    "unflawed_accuracy": pair(0.0, 0.9),
    "drift_of": pair("all", "flawed", drift="linear", drift_rate=-0.001),
    "filter": pair("asdf-plus", "asdf-minus"),
    "activation": pair("adaptive", "always"),
    "comms_period": pair(1, 2),
    "filter_period": pair(20, 40),
    "omega": pair(0.05, 0.5),
    "memory": pair(2**31, 64),
    "latency": pair(0, 1),
    "firmware": pair("native", "mirror"),
    "trials": pair(3, 4),
    "conventions": pair("paper", "authors", firmware="reference"),
    "message_bits": pair("exact", "7+4"),
}
"""Two values of each parameter; of ``sensor`` there is one where no extension is installed."""

WITHOUT_EFFECT = {
    "drift": "without a rate of its own no accuracy changes",
    "firmware": "the mirror computes the same bits",
    "trials": "a trial does not depend on how many there are",
}
"""Parameters whose two values give the same results of a trial, and why."""


@cache
def run_two_that_differ_in(parameter: str) -> list[Trials]:
    """Run two experiments of three trials that differ in this parameter alone, and return their results."""
    pair_of_values = PAIRS[parameter]
    common = SHORT_SWARM | pair_of_values.others
    return [
        results_of(Experiment(**common | {parameter: value}), sampling_interval=1)
        for value in (pair_of_values.first_value, pair_of_values.second_value)
    ]


def test_every_parameter_of_an_experiment_has_two_values_in_these_tests() -> None:
    """The exception is ``sensor``, which has only one value where no extension is installed."""
    parameters_with_two_values = set(PAIRS)
    assert set(PARAMETER_NAMES) - parameters_with_two_values == {"sensor"}
    assert parameters_with_two_values - set(PARAMETER_NAMES) == set()


def robots_computed_the_same(first: Trials, second: Trials) -> bool:
    """Return whether all robots have had the same values in the trials that both experiments have."""
    count = min(len(first.numbers), len(second.numbers))
    return all(
        np.array_equal(first.records[name][:count], second.records[name][:count]) for name in QUANTITIES
    )


@pytest.mark.parametrize("parameter", [name for name in PAIRS if name not in WITHOUT_EFFECT])
def test_another_value_of_a_parameter_changes_what_the_robots_compute(parameter: str) -> None:
    """Two experiments are run that differ in this parameter alone."""
    first, second = run_two_that_differ_in(parameter)
    assert not robots_computed_the_same(first, second)


@pytest.mark.parametrize("parameter", WITHOUT_EFFECT)
def test_another_value_of_a_parameter_without_effect_changes_nothing_that_robots_compute(
    parameter: str,
) -> None:
    """These are drift without a rate, the firmware in C or in Python, and the number of trials."""
    first, second = run_two_that_differ_in(parameter)
    assert robots_computed_the_same(first, second)


@pytest.mark.parametrize("parameter", PAIRS)
def test_a_table_of_results_keeps_experiments_apart_that_differ_in_one_parameter(parameter: str) -> None:
    """The results of two such experiments are joined to one table, and read from it as two experiments."""
    first, second = run_two_that_differ_in(parameter)
    table = pa.concat_tables([trials_to_table(first), trials_to_table(second)])
    first_from_table, second_from_table = stream_experiments(table)

    assert first_from_table.experiment == first.experiment
    assert second_from_table.experiment == second.experiment


# --- Pictures --------------------------------------------------------------------------------------------

DRAWN_QUICKLY = ("true_accuracy", "flawed_accuracy", "omega")
"""Two parameters that pictures show in ways of their own, and one that they show as all others."""
DRAWN = [name for name in PAIRS if name != "trials"]  # more trials of one experiment may be drawn together
DRAWN_CASES = [*DRAWN_QUICKLY, *slow(name for name in DRAWN if name not in DRAWN_QUICKLY)]


@pytest.mark.parametrize("parameter", DRAWN)
def test_a_curve_of_experiments_that_differ_in_a_parameter_not_shown_is_refused(parameter: str) -> None:
    """The curve would show its effect as if it were that of the parameter along the x axis."""
    # It is a parameter that is the same in both experiments.
    parameter_on_x_axis = "seed" if parameter == "comms_period" else "comms_period"
    with pytest.raises(UsageError, match=f"the results differ in {parameter} too"):
        plot_curve(run_two_that_differ_in(parameter), x=parameter_on_x_axis)


@pytest.mark.parametrize("parameter", DRAWN_CASES)
def test_a_curve_over_a_parameter_has_a_point_at_the_median_error_for_each_value(parameter: str) -> None:
    """The error of a trial is called e. There are two values, and the curve may go up or down."""
    first, second = run_two_that_differ_in(parameter)
    (axes,) = plot_curve([first, second], x=parameter, y="e").axes
    (line,) = axes.lines

    heights = np.asarray(line.get_ydata())
    medians = [np.median(first.measures()["e"]), np.median(second.measures()["e"])]
    assert sorted(heights) == sorted(medians)


@dataclass(frozen=True)
class Points:
    """Points of an experiment's trials in a picture, with all that sets them apart from other experiments."""

    axes: Axes
    colour: Any
    marker: Any
    mean_x: float
    count: int


def points_in(figure: Figure, marker: str | None = None) -> list[Points]:
    """Return the groups of points in all panels; with a marker, only those that have it."""
    groups = []
    for axes in figure.axes:
        for line in axes.lines:
            if marker is None or line.get_marker() == marker:
                x = np.asarray(line.get_xdata())
                groups.append(Points(axes, line.get_color(), line.get_marker(), float(x.mean()), len(x)))
    return groups


@pytest.mark.parametrize("parameter", DRAWN_CASES)
def test_boxes_of_experiments_that_differ_in_one_parameter_can_be_told_apart(parameter: str) -> None:
    """They are in two panels, in two colours, or side by side. A box has a dot for each of three trials."""
    figure = plot_boxes(run_two_that_differ_in(parameter))
    first_box, second_box = points_in(figure, marker=".")

    assert (first_box.count, second_box.count) == (3, 3)
    are_in_two_panels = first_box.axes != second_box.axes
    have_two_colours = first_box.colour != second_box.colour
    are_side_by_side = abs(first_box.mean_x - second_box.mean_x) > 0.01
    assert are_in_two_panels or have_two_colours or are_side_by_side


@pytest.mark.parametrize("parameter", DRAWN_CASES)
def test_points_of_experiments_that_differ_in_one_parameter_can_be_told_apart(parameter: str) -> None:
    """They are in two panels, in two colours, or have two markers. Each of three trials is a point."""
    first, second = points_in(plot_scatter(run_two_that_differ_in(parameter)))

    assert (first.count, second.count) == (3, 3)
    are_in_two_panels = first.axes != second.axes
    have_two_colours = first.colour != second.colour
    have_two_markers = first.marker != second.marker
    assert are_in_two_panels or have_two_colours or have_two_markers


@pytest.mark.parametrize("parameter", DRAWN_CASES)
def test_bands_of_experiments_that_differ_in_one_parameter_have_different_titles(parameter: str) -> None:
    """Their last lines, which say how many robots have been harmed, are left out: they may differ anyway."""
    first_title, second_title = titles_of(plot_bands(run_two_that_differ_in(parameter)))
    *first_lines, _last_line = first_title.splitlines()
    *second_lines, _last_line = second_title.splitlines()
    assert first_lines != second_lines
