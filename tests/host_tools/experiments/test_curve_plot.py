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
    assert_medians,
    assert_panels,
    caption_of,
    legend_of,
    results_of,
    titles_of,
    visible_axes,
)
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.common.figures import COLOURS
from mcp_asdf_tools.experiments.experiment import grid
from mcp_asdf_tools.experiments.plot_panels import median_interval
from mcp_asdf_tools.experiments.plots.curve import MEASURES, plot_curve
from mcp_asdf_tools.experiments.results import Trials

MOVING: dict[str, Any] = {"robots": 6, "steps": 200, "trials": 7, "filter_period": 50, "topology": "dynamic"}

GRAPHS = [[(0, 1)], [(0, 1), (0, 2), (0, 10), (0, 11)], [(a, b) for a in range(4) for b in range(a)]]


# --- Medians and bands -----------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def densities_and_omegas() -> dict[tuple[float, float], Trials]:
    """Run moving swarms of two densities and three omegas, none of them in order."""
    experiments = grid(**MOVING, density=[2.0, 0.5], omega=[0.05, 0.9, 0.02])
    return {
        (experiment.density, float(experiment.omega)): results_of(experiment) for experiment in experiments
    }


@pytest.mark.parametrize("measure", MEASURES)
def test_curves_are_medians_in_their_intervals(
    measure: str, densities_and_omegas: dict[tuple[float, float], Trials]
) -> None:
    (axes,) = plot_curve([*densities_and_omegas.values()], "omega", measure, hue="density").axes
    for line, band, density in zip(axes.lines, axes.collections, (0.5, 2.0), strict=True):
        samples = {
            omega: densities_and_omegas[density, omega].measures()[measure] for omega in (0.02, 0.05, 0.9)
        }
        assert_medians(line, band, samples)


def test_curves_have_a_legend_of_their_values(
    densities_and_omegas: dict[tuple[float, float], Trials],
) -> None:
    figure = plot_curve([*densities_and_omegas.values()], "omega", hue="density")
    assert legend_of(figure) == ["density 0.5", "density 2"]


def test_curves_without_panels_have_one_large_one(
    densities_and_omegas: dict[tuple[float, float], Trials],
) -> None:
    figure = plot_curve([*densities_and_omegas.values()], "omega", hue="density")
    assert_panels(figure, rows=1, columns=1, panel_height=3.8)
    assert (figure.get_supylabel(), caption_of(figure).split()[0]) == ("H", "omega")


@pytest.mark.parametrize(("trials", "rank"), [(5, 1), (6, 1), (30, 10), (100, 40)])
def test_intervals_of_medians_have_the_ranks_that_books_print(trials: int, rank: int) -> None:
    """The interval reaches from the value of this rank to that of the same rank from above."""
    values = np.random.default_rng(trials).permutation(trials).astype(float)
    assert median_interval(values) == (np.median(values), rank - 1, trials - rank)


def test_an_interval_of_equal_values_has_no_width() -> None:
    """28 of the 30 values are 5, so the median and both ends of its interval are 5, too."""
    assert median_interval(np.repeat([0.0, 5, 9], [1, 28, 1])) == (5, 5, 5)


# --- Panels and axes of the user -------------------------------------------------------------------------


@pytest.fixture(scope="module")
def swarms_of_four_sizes() -> list[Trials]:
    """Run 4 to 7 robots with two filters and two shares: 6 without the robust filter, 7 for more trials."""
    varied: dict[str, Any] = {"flawed": [1, 2], "filter": ["none", "robust"], "steps": 60}
    experiments = grid(robots=[4, 5, 6], trials=2, **varied) + grid(robots=7, trials=7, **varied)
    return [
        results_of(experiment)
        for experiment in experiments
        if (experiment.robots, experiment.filter) != (6, "robust")
    ]


@pytest.fixture(scope="module")
def curves_in_panels(swarms_of_four_sizes: list[Trials]) -> Figure:
    return plot_curve(swarms_of_four_sizes, "flawed", hue="filter", facet="robots")


def test_each_value_of_a_facet_has_a_panel(curves_in_panels: Figure) -> None:
    assert titles_of(curves_in_panels) == ["robots 4", "robots 5", "robots 6", "robots 7"]
    assert_panels(curves_in_panels, rows=2, columns=3, panel_height=2.6)


@pytest.mark.parametrize(("panel", "robots", "curves"), [(0, 4, 2), (2, 6, 1), (3, 7, 2)])
def test_a_panel_has_the_curves_of_its_experiments(
    panel: int, robots: int, curves: int, curves_in_panels: Figure, swarms_of_four_sizes: list[Trials]
) -> None:
    drawn = [np.asarray(line.get_ydata()).tolist() for line in curves_in_panels.axes[panel].lines]
    medians = {
        (trials.experiment.filter, trials.experiment.flawed): float(np.median(trials.scores()["H"]))
        for trials in swarms_of_four_sizes
        if trials.experiment.robots == robots
    }
    expected = [[medians[name, 1], medians[name, 2]] for name in ("none", "robust")[:curves]]

    assert drawn == expected


def test_panels_share_a_legend(curves_in_panels: Figure) -> None:
    assert legend_of(curves_in_panels) == ["filter none", "filter robust"]


def test_the_caption_counts_trials_and_says_when_a_band_is_no_interval(curves_in_panels: Figure) -> None:
    assert "2 to 7 trials of each" in caption_of(curves_in_panels)
    assert "bands all trials where there are fewer than 6, else 95 %" in caption_of(curves_in_panels)


def test_one_value_of_a_facet_has_one_large_panel(swarms_of_four_sizes: list[Trials]) -> None:
    figure = plot_curve(swarms_of_four_sizes[:4], "flawed", hue="filter", facet="robots")
    assert titles_of(figure) == ["robots 4"]
    assert_panels(figure, rows=1, columns=1, panel_height=3.8)


def test_a_curve_can_be_of_a_function_in_axes_of_the_user(swarms_of_four_sizes: list[Trials]) -> None:
    def error_of_first_robot(trials: Trials) -> Any:
        return trials.errors[:, 0]

    figure: Any = Figure()
    axes = figure.subfigures().subplots()
    unfiltered = swarms_of_four_sizes[:4:2]
    assert plot_curve(unfiltered, "flawed", y=error_of_first_robot, ax=axes) is figure
    medians = [np.median(trials.errors[:, 0]) for trials in unfiltered]
    assert axes.lines[0].get_ydata().tolist() == medians
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("share of flawed robots", "error_of_first_robot")
    assert axes.get_legend() is None


def test_axes_of_the_user_get_a_legend_of_several_curves(swarms_of_four_sizes: list[Trials]) -> None:
    axes = Figure().subplots()
    plot_curve(swarms_of_four_sizes[:4], "flawed", hue="filter", ax=axes)
    legend = axes.get_legend()

    assert legend is not None
    assert [text.get_text() for text in legend.get_texts()] == ["filter none", "filter robust"]
    assert not legend.get_frame_on()


def test_panels_do_not_go_into_axes_of_the_user(swarms_of_four_sizes: list[Trials]) -> None:
    axes = Figure().subplots()
    with pytest.raises(UsageError, match="give one of them"):
        plot_curve(swarms_of_four_sizes[:4], "flawed", hue="filter", facet="robots", ax=axes)


# --- Parameters ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("x", "values", "positions"),
    [
        ("filter_period", [50, 100, 150], [50, 100, 150]),
        ("flawed", ["0%", "50%", "100%"], [0, 0.5, 1]),
        ("filter", ["none", "asdf-plus"], ["none", "asdf-plus"]),
        (
            "filter",
            ["robust", "asdf-plus", "asdf-minus", "none"],
            ["none", "asdf-minus", "asdf-plus", "robust"],
        ),
    ],
)
def test_any_parameter_can_be_along_the_axis(x: str, values: list[Any], positions: list[Any]) -> None:
    experiments = [results_of(experiment) for experiment in grid(**MOVING | {x: values})]
    (axes,) = plot_curve(experiments, x).axes
    assert np.asarray(axes.lines[0].get_xdata()).tolist() == positions


def test_long_values_stand_side_by_side_with_short_labels() -> None:
    graphs = grid(**{**MOVING, "topology": "graph", "robots": 12}, graph=GRAPHS)
    (axes,) = plot_curve([results_of(experiment) for experiment in graphs], "graph").axes
    assert np.asarray(axes.lines[0].get_xdata()).tolist() == [0, 1, 2]
    labels = [label.get_text() for label in axes.get_xticklabels()]

    assert labels == ["0 1", "0 1; 0 2; 0 10; 0 11", "0 1; 0 2; 0 3; 1 2;  ..."]


def test_curves_of_filters_have_their_colours(results_by_filter: dict[str, Trials]) -> None:
    (axes,) = plot_curve([*results_by_filter.values()], "flawed", hue="filter").axes
    assert [line.get_color() for line in axes.lines] == [GREY, COLOURS[0], COLOURS[1], GREEN]


def with_other_omega(trials: Trials) -> Trials:
    return replace(trials, experiment=replace(trials.experiment, omega=0.1))


def test_a_parameter_without_effect_may_differ(results_by_filter: dict[str, Trials]) -> None:
    """The swarm with the robust filter has another omega, which that filter does not use."""
    experiments = [results_by_filter["asdf-plus"], with_other_omega(results_by_filter["robust"])]
    (axes,) = visible_axes(plot_curve(experiments, "filter"))
    assert len(axes.lines) == 1


def test_a_parameter_that_is_not_shown_may_not_differ(results_by_filter: dict[str, Trials]) -> None:
    """Both filters use omega, so the curve would show the effect of two parameters as that of one."""
    experiments = [results_by_filter["asdf-minus"], with_other_omega(results_by_filter["asdf-plus"])]
    with pytest.raises(UsageError, match="the results differ in omega too"):
        plot_curve(experiments, "filter")


def test_equal_shares_of_swarms_of_two_sizes_do_not_differ() -> None:
    experiments = [
        results_of(replace(SHORT_EXPERIMENT, robots=robots, flawed=flawed, trials=1))
        for robots, flawed in ((4, 2), (8, 4))
    ]
    (axes,) = plot_curve(experiments, "robots").axes

    assert np.asarray(axes.lines[0].get_xdata()).tolist() == [4, 8]
