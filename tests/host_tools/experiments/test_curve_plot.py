"""Curves of a measure over a parameter: their artists are compared with the trials' numbers."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

from host_tools.experiments.drawn_figures import (
    GREEN,
    GREY,
    SHORT_EXPERIMENT,
    Layout,
    assert_line_has_medians_in_band,
    caption_of,
    layout_of,
    legend_of,
    results_of,
    titles_of,
    visible_axes,
    x_values_of,
    y_values_of,
)
from mcp_asdf_tools.common.figures import COLOURS
from mcp_asdf_tools.experiments.experiment import grid
from mcp_asdf_tools.experiments.plot_panels import median_interval
from mcp_asdf_tools.experiments.plots.curve import MEASURES, plot_curve
from mcp_asdf_tools.experiments.results import Trials

SIX_MOVING_ROBOTS: dict[str, Any] = {
    "robots": 6,
    "steps": 200,
    "trials": 7,
    "filter_period": 50,
    "topology": "dynamic",
}


# --- Medians and bands -----------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def trials_by_density_and_omega() -> dict[tuple[float, float], Trials]:
    """Run moving swarms of two densities and three omegas, none of them in order."""
    experiments = grid(**SIX_MOVING_ROBOTS, density=[2.0, 0.5], omega=[0.05, 0.9, 0.02])
    return {
        (experiment.density, float(experiment.omega)): results_of(experiment) for experiment in experiments
    }


@pytest.mark.parametrize("measure", MEASURES)
def test_each_curve_goes_through_the_medians_of_trials_in_a_band_of_their_intervals(
    measure: str, trials_by_density_and_omega: dict[tuple[float, float], Trials]
) -> None:
    """There is a curve for each density over the three values of omega.

    The band of a curve reaches at each omega over the 95 % interval of the median there.
    """
    all_trials = [*trials_by_density_and_omega.values()]
    (axes,) = plot_curve(all_trials, x="omega", y=measure, hue="density").axes
    lines = axes.lines
    bands = axes.collections

    # Both are ascending, as they are drawn.
    densities = (0.5, 2.0)
    omegas = (0.02, 0.05, 0.9)
    for line, band, density in zip(lines, bands, densities, strict=True):
        samples_by_omega = {}
        for omega in omegas:
            trials = trials_by_density_and_omega[density, omega]
            samples_by_omega[omega] = trials.measures()[measure]  # a value of each trial
        assert_line_has_medians_in_band(line, band, samples_by_omega)


def test_curves_are_drawn_into_one_large_panel_with_the_score_over_the_parameter(
    trials_by_density_and_omega: dict[tuple[float, float], Trials],
) -> None:
    """The two curves are those of the two densities, over omega. Sizes of panels are in inches.

    The label along the y axis is the score, H. The label along the x axis, omega, begins the caption.
    """
    all_trials = [*trials_by_density_and_omega.values()]
    figure = plot_curve(all_trials, x="omega", hue="density")

    assert layout_of(figure) == Layout(rows=1, columns=1, width=6.3, panel_height=3.8)
    assert legend_of(figure) == ["density 0.5", "density 2"]
    assert figure.get_supylabel() == "H"
    assert caption_of(figure).startswith("omega ")


@pytest.mark.parametrize(("value_count", "printed_rank"), [(5, 1), (6, 1), (30, 10), (100, 40)])
def test_the_95_percent_interval_of_a_median_has_the_ranks_that_statistics_books_print(
    value_count: int, printed_rank: int
) -> None:
    """Its ends are the value with this rank from below and the value with the same rank from above.

    Values are 0, 1, 2 and so on in random order, so the smallest one, which has rank 1, is 0.
    """
    values = np.random.default_rng(seed=1).permutation(value_count).astype(float)
    median, lower_end, upper_end = median_interval(values)

    assert median == np.median(values)
    assert lower_end == printed_rank - 1
    assert upper_end == value_count - printed_rank


def test_the_interval_of_a_median_has_no_width_where_nearly_all_values_are_equal() -> None:
    """28 of the 30 values are 5, so the median and both ends of its interval are 5, too."""
    values = np.array([0.0, *[5.0] * 28, 9.0])
    median, lower_end, upper_end = median_interval(values)
    assert (median, lower_end, upper_end) == (5, 5, 5)


# --- Panels and axes of the user -------------------------------------------------------------------------


@pytest.fixture(scope="module")
def swarms_of_four_sizes() -> list[Trials]:
    """Run swarms of 4 to 7 robots with two filters. In each swarm 1 or 2 robots are flawed.

    Swarms of 6 robots are not run with the robust filter. Swarms of 7 have 7 trials, the others 2.
    """
    varied: dict[str, Any] = {"flawed": [1, 2], "filter": ["none", "robust"], "steps": 60}
    experiments = grid(robots=[4, 5, 6], trials=2, **varied) + grid(robots=7, trials=7, **varied)
    return [
        results_of(experiment)
        for experiment in experiments
        if (experiment.robots, experiment.filter) != (6, "robust")
    ]


@pytest.fixture(scope="module")
def swarms_of_four_robots(swarms_of_four_sizes: list[Trials]) -> list[Trials]:
    """The four of these swarms that have 4 robots: two filters with 1 and with 2 flawed robots."""
    return [trials for trials in swarms_of_four_sizes if trials.experiment.robots == 4]


@pytest.fixture(scope="module")
def curves_in_panels(swarms_of_four_sizes: list[Trials]) -> Figure:
    return plot_curve(swarms_of_four_sizes, x="flawed", hue="filter", facet="robots")


def test_curves_have_a_panel_for_each_value_of_the_parameter_given_as_facet(curves_in_panels: Figure) -> None:
    """The parameter is the number of robots. A row has three panels, so the fourth is in a second row."""
    assert titles_of(curves_in_panels) == ["robots 4", "robots 5", "robots 6", "robots 7"]
    assert layout_of(curves_in_panels) == Layout(rows=2, columns=3, width=9, panel_height=2.6)


def median_score(swarms: list[Trials], robots: int, filter_name: str, flawed: int) -> Any:
    """Return the median of H over the trials of the only swarm that has these parameters."""
    (scores_of_trials,) = [
        trials.scores()["H"]
        for trials in swarms
        if trials.experiment.robots == robots
        and trials.experiment.filter == filter_name
        and trials.experiment.flawed == flawed
    ]
    return np.median(scores_of_trials)


@pytest.mark.parametrize(
    ("panel", "robots", "filters"), [(0, 4, ["none", "robust"]), (2, 6, ["none"]), (3, 7, ["none", "robust"])]
)
def test_a_panel_has_a_curve_of_median_scores_for_each_filter_that_its_swarms_have(
    panel: int, robots: int, filters: list[str], curves_in_panels: Figure, swarms_of_four_sizes: list[Trials]
) -> None:
    """A curve has two points: the medians of H with one and with two flawed robots.

    Swarms have 4 to 7 robots, one number in each panel. Those of 6 have not run with the robust filter.
    """
    lines = curves_in_panels.axes[panel].lines
    for line, filter_name in zip(lines, filters, strict=True):
        assert y_values_of(line) == [
            median_score(swarms_of_four_sizes, robots, filter_name, flawed=1),
            median_score(swarms_of_four_sizes, robots, filter_name, flawed=2),
        ]


def test_all_panels_of_a_picture_share_their_y_axis_and_have_no_line_above(curves_in_panels: Figure) -> None:
    """The lines around a panel are called spines."""
    first_axes, *other_axes = visible_axes(curves_in_panels)
    for axes in other_axes:
        assert axes.get_shared_y_axes().joined(axes, first_axes)
    for axes in (first_axes, *other_axes):
        assert not axes.spines["top"].get_visible()


def test_all_panels_of_curves_share_one_legend_and_bands_have_no_edges(curves_in_panels: Figure) -> None:
    """An edge would have a colour."""
    assert legend_of(curves_in_panels) == ["filter none", "filter robust"]

    [first_band, *_] = curves_in_panels.axes[0].collections
    colours_of_edges: Any = first_band.get_edgecolor()
    assert len(colours_of_edges) == 0


def test_the_caption_of_curves_counts_trials_and_says_where_bands_are_no_intervals(
    curves_in_panels: Figure,
) -> None:
    """Swarms of 7 robots have 7 trials, and others 2. Fewer than 6 have no 95 % interval of their median."""
    assert "2 to 7 trials of each" in caption_of(curves_in_panels)
    assert "bands all trials where there are fewer than 6, else 95 %" in caption_of(curves_in_panels)


def test_a_facet_with_a_single_value_gives_one_large_panel(swarms_of_four_robots: list[Trials]) -> None:
    """The facet is the number of robots, which is the same in all of these swarms."""
    figure = plot_curve(swarms_of_four_robots, x="flawed", hue="filter", facet="robots")
    assert titles_of(figure) == ["robots 4"]
    assert layout_of(figure) == Layout(rows=1, columns=1, width=6.3, panel_height=3.8)


def error_of_first_robot(trials: Trials) -> Any:
    """Return a value of each trial, as a user's own function may."""
    return trials.errors[:, 0]  # errors are by trial and robot


@pytest.fixture(scope="module")
def unfiltered_swarms(swarms_of_four_robots: list[Trials]) -> list[Trials]:
    """Two swarms of 4 robots without a filter: 1 and 2 of them are flawed, and they have two trials each."""
    return [trials for trials in swarms_of_four_robots if trials.experiment.filter == "none"]


def test_a_curve_can_be_of_a_function_of_the_user(unfiltered_swarms: list[Trials]) -> None:
    """The function gives a value of each trial, here an error. The curve goes through the swarms' medians."""
    (axes,) = plot_curve(unfiltered_swarms, x="flawed", y=error_of_first_robot).axes
    (line,) = axes.lines

    medians = [np.median(error_of_first_robot(trials)) for trials in unfiltered_swarms]
    assert y_values_of(line) == medians


def test_a_curve_can_be_drawn_into_axes_of_the_user(unfiltered_swarms: list[Trials]) -> None:
    """The user's axes are in a part of a figure. They get labels, but no legend, as there is one curve.

    The whole figure is returned.
    """
    figure: Any = Figure()
    part_of_figure = figure.subfigures()
    axes = part_of_figure.subplots()

    returned_figure = plot_curve(unfiltered_swarms, x="flawed", y=error_of_first_robot, ax=axes)

    assert returned_figure is figure
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("share of flawed robots", "error_of_first_robot")
    assert axes.get_legend() is None
    assert not axes.spines["top"].get_visible()  # as in all pictures


def test_axes_of_the_user_get_a_legend_if_several_curves_are_drawn(
    swarms_of_four_robots: list[Trials],
) -> None:
    """There are two curves, without a filter and with the robust one."""
    axes = Figure().subplots()
    plot_curve(swarms_of_four_robots, x="flawed", hue="filter", ax=axes)
    legend = axes.get_legend()

    assert legend is not None
    assert [text.get_text() for text in legend.get_texts()] == ["filter none", "filter robust"]
    assert not legend.get_frame_on()


# --- Parameters ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("parameter", "values", "expected_positions"),
    [
        ("filter_period", [50, 100, 150], [50, 100, 150]),
        ("flawed", ["0%", "50%", "100%"], [0, 0.5, 1]),
        (
            "filter",
            ["robust", "asdf-plus", "asdf-minus", "none"],
            ["none", "asdf-minus", "asdf-plus", "robust"],
        ),
    ],
)
def test_numbers_shares_and_names_can_be_along_the_x_axis(
    parameter: str, values: list[Any], expected_positions: list[Any]
) -> None:
    """There is an experiment for each value. Flawed robots stand at their share, from 0 to 1.

    Names of filters stand in their usual order, whatever the order of the experiments.
    """
    experiments = grid(**SIX_MOVING_ROBOTS | {parameter: values})
    (axes,) = plot_curve([results_of(experiment) for experiment in experiments], x=parameter).axes
    (line,) = axes.lines
    assert x_values_of(line) == expected_positions


def test_graphs_stand_side_by_side_on_the_x_axis_with_shortened_labels() -> None:
    """A label has the pairs of connected robots, as many as fit."""
    complete_graph_of_four = [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)]
    graphs = [[(0, 1)], [(0, 1), (0, 2), (0, 10), (0, 11)], complete_graph_of_four]
    experiments = grid(robots=12, steps=200, filter_period=50, trials=7, topology="graph", graph=graphs)
    (axes,) = plot_curve([results_of(experiment) for experiment in experiments], x="graph").axes
    (line,) = axes.lines
    labels = [label.get_text() for label in axes.get_xticklabels()]

    assert x_values_of(line) == [0, 1, 2]
    assert labels == ["0 1", "0 1; 0 2; 0 10; 0 11", "0 1; 0 2; 0 3; 1 2;  ..."]


def test_curves_of_the_four_filters_have_the_colours_of_all_pictures(
    results_by_filter: dict[str, Trials],
) -> None:
    """The order of the filters is: none (grey), ASDF-, ASDF+ and the robust filter (green)."""
    (axes,) = plot_curve([*results_by_filter.values()], x="flawed", hue="filter").axes
    asdf_minus_colour, asdf_plus_colour, *_other_colours = COLOURS
    assert [line.get_color() for line in axes.lines] == [GREY, asdf_minus_colour, asdf_plus_colour, GREEN]


def with_omega(trials: Trials, omega: float) -> Trials:
    """Return the results as if the experiment had this omega."""
    return replace(trials, experiment=replace(trials.experiment, omega=omega))


def test_a_curve_may_be_of_swarms_that_differ_in_a_parameter_without_effect(
    results_by_filter: dict[str, Trials],
) -> None:
    """The swarm with the robust filter has another omega, which that filter does not use.

    So results that differ in it are not refused. The curve has a point for each of the two filters.
    """
    asdf_plus = with_omega(results_by_filter["asdf-plus"], 0.05)
    robust = with_omega(results_by_filter["robust"], 0.1)
    (axes,) = visible_axes(plot_curve([asdf_plus, robust], x="filter"))
    (line,) = axes.lines
    assert len(y_values_of(line)) == 2


def test_swarms_of_two_sizes_with_the_same_share_of_flawed_robots_can_be_on_one_curve() -> None:
    """2 of 4 and 4 of 8 robots are flawed: these numbers differ, and the shares do not."""
    small_swarm = replace(SHORT_EXPERIMENT, robots=4, flawed=2, trials=1)
    large_swarm = replace(SHORT_EXPERIMENT, robots=8, flawed=4, trials=1)
    (axes,) = plot_curve([results_of(small_swarm), results_of(large_swarm)], x="robots").axes
    (line,) = axes.lines
    assert x_values_of(line) == [4, 8]
