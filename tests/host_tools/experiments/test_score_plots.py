"""Boxes and points of scores: their artists are compared with the trials' numbers."""

from __future__ import annotations

from dataclasses import dataclass, replace
from statistics import mean, median
from typing import Any

import pytest
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

from host_tools.experiments.drawn_figures import (
    GREEN,
    GREY,
    SHORT_EXPERIMENT,
    Layout,
    caption_of,
    layout_of,
    legend_of,
    results_of,
    titles_of,
    visible_axes,
    x_values_of,
    y_values_of,
)
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.common.figures import COLOURS, INK
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.plots.boxes import plot_boxes
from mcp_asdf_tools.experiments.plots.curve import plot_curve
from mcp_asdf_tools.experiments.plots.scatter import plot_scatter
from mcp_asdf_tools.experiments.results import Trials, select_experiments
from mcp_asdf_tools.experiments.scores import Limits
from mcp_asdf_tools.experiments.trials import run_trials

LIMITS_OF_SCORES = Limits(k_max=200, e_max=0.4)
FLAWED_AND_ACCURACIES = ((0, 0.95), (2, 0.55), (2, 0.75), (4, 0.55))
"""How many of 4 robots are flawed, and the accuracy that these assume, where 0.95 is true."""
FILTERS_AND_PERIODS: tuple[tuple[str, int], ...] = (("none", 100), ("asdf-plus", 100), ("asdf-plus", 150))


@pytest.fixture(scope="module")
def results() -> list[Trials]:
    """Run two fill ratios, four kinds of flawed robots, and three filters: 24 experiments of five trials."""
    return [
        results_of(
            replace(
                SHORT_EXPERIMENT,
                flawed=flawed,
                fill_ratio=fill_ratio,
                flawed_accuracy=flawed_accuracy,
                filter=filter_name,
                filter_period=period,
            )
        )
        for fill_ratio in (0.55, 0.95)
        for flawed, flawed_accuracy in FLAWED_AND_ACCURACIES
        for filter_name, period in FILTERS_AND_PERIODS
    ]


# --- Boxes -----------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def boxes(results: list[Trials]) -> Figure:
    return plot_boxes(results, limits=LIMITS_OF_SCORES)


@dataclass(frozen=True)
class BoxPoints:
    """The points of a box, one for each trial: where they are drawn, and in which colour."""

    x: list[float]
    scores: list[float]
    colour: str


def points_of_boxes(axes: Axes) -> list[BoxPoints]:
    """Return the points of each box of a panel, which are dots without an edge, from left to right."""
    boxes = []
    for line in axes.lines:
        if line.get_marker() == "." and not line.get_markeredgewidth():
            boxes.append(BoxPoints(x_values_of(line), y_values_of(line), str(line.get_color())))
    return sorted(boxes, key=lambda box: mean(box.x))


def expected_scores_of_boxes(results: list[Trials], fill_ratio: float) -> list[list[float]]:
    """Return H of the trials of each experiment with a fill ratio, in the order of boxes from left to right.

    Boxes are ordered by flawed robots and what these assume, and then by filter as the experiments are.
    """
    panel = [trials for trials in results if trials.experiment.fill_ratio == fill_ratio]
    panel.sort(key=lambda trials: (trials.experiment.flawed, trials.experiment.flawed_accuracy))
    return [trials.scores(LIMITS_OF_SCORES)["H"].tolist() for trials in panel]


def test_boxes_of_scores_have_a_panel_for_each_fill_ratio(boxes: Figure) -> None:
    """A title has the fill ratio, f, and the true accuracy of the sensors, b."""
    assert titles_of(boxes) == ["$f = 0.55$, $b = 0.95$", "$f = 0.95$, $b = 0.95$"]
    assert layout_of(boxes) == Layout(rows=2, columns=1, width=6.3, panel_height=2.6)


def test_the_legend_of_boxes_has_filters_and_periods_where_these_differ(boxes: Figure) -> None:
    assert legend_of(boxes) == ["no filter", "ASDF+, filter period 100", "ASDF+, filter period 150"]


def name_by_robot_count(experiment: Experiment) -> str:
    """Return the name of an experiment's series, as a user's own function may."""
    return f"{experiment.robots} robots"


def test_a_user_can_give_the_series_of_boxes_other_names(unfiltered: Trials) -> None:
    """The user gives a function that names the series of an experiment, here one of four robots."""
    figure = plot_boxes([unfiltered], series_name=name_by_robot_count)
    assert legend_of(figure) == ["4 robots"]


@pytest.mark.parametrize(("panel", "fill_ratio"), [(0, 0.55), (1, 0.95)])
def test_the_points_of_each_box_are_the_scores_of_its_five_trials(
    panel: int, fill_ratio: float, boxes: Figure, results: list[Trials]
) -> None:
    """There is a panel for each fill ratio. Boxes are ordered by flawed robots, and then by filter."""
    drawn_scores = [box.scores for box in points_of_boxes(boxes.axes[panel])]
    assert drawn_scores == expected_scores_of_boxes(results, fill_ratio)


def test_the_three_boxes_of_one_kind_of_swarm_stand_side_by_side(boxes: Figure) -> None:
    """Kinds of swarms stand at 0, 1, 2 and 3. Boxes of filters are to the left, there, and to the right.

    The points are spread at random around the middle of their box.
    """
    box_width = 0.86 / 3  # three boxes are 0.86 wide together
    expected_middles = []
    for kind_of_swarm in (0, 1, 2, 3):
        expected_middles += [kind_of_swarm - box_width, kind_of_swarm, kind_of_swarm + box_width]

    means_of_points = [mean(box.x) for box in points_of_boxes(boxes.axes[0])]
    assert means_of_points == pytest.approx(expected_middles, abs=0.05)


def test_no_two_points_of_a_box_lie_in_one_column_and_all_are_within_its_width(boxes: Figure) -> None:
    """Two points at the same place along the x axis could hide each other: then a trial could not be seen."""
    box_width = 0.86 / 3  # three boxes are 0.86 wide together
    for box in points_of_boxes(boxes.axes[0]):
        assert len(set(box.x)) == len(box.x)
        width_of_points = max(box.x) - min(box.x)
        assert 0.1 < width_of_points < box_width


def test_boxes_are_grey_without_a_filter_and_else_in_the_colour_of_their_series(boxes: Figure) -> None:
    """For each of four kinds of swarms there are boxes without a filter and with ASDF+ of two periods."""
    colours = [box.colour for box in points_of_boxes(boxes.axes[0])]
    colour_of_first_period, colour_of_second_period, *_other_colours = COLOURS
    assert colours == [GREY, colour_of_first_period, colour_of_second_period] * 4


def test_each_box_has_a_horizontal_line_at_the_median_of_its_scores(
    boxes: Figure, results: list[Trials]
) -> None:
    """The lines at medians are drawn in black, INK; each has a left and a right end at one height.

    The first panel has the swarms on a floor of which 55 % are black.
    """
    heights = []
    for line in boxes.axes[0].lines:
        if line.get_color() == INK:
            height_of_left_end, height_of_right_end = y_values_of(line)
            assert height_of_left_end == height_of_right_end
            heights.append(height_of_left_end)

    medians = [median(scores) for scores in expected_scores_of_boxes(results, fill_ratio=0.55)]
    assert sorted(heights) == sorted(medians)


def test_boxes_are_labelled_by_how_wrong_flawed_robots_are_and_how_many_there_are(boxes: Figure) -> None:
    """Flawed robots assume the accuracy 0.95, 0.55 or 0.75, and 0.95 is true. There are 0, 2 or 4 of 4."""
    labels = [label.get_text() for label in boxes.axes[0].get_xticklabels()]
    assert labels == ["+0\n0%", "-0.4\n50%", "-0.2\n50%", "-0.4\n100%"]


def test_each_panel_of_boxes_shows_scores_from_0_to_100_of_its_four_kinds_of_swarms(boxes: Figure) -> None:
    """There is a margin above. Kinds of swarms stand at 0, 1, 2 and 3, with half a unit at either end."""
    for axes in boxes.axes:
        assert axes.get_ylim() == (0, 103)
        assert axes.get_xlim() == (-0.5, 3.5)


def test_the_caption_of_boxes_has_the_meaning_of_labels_common_parameters_and_limits_of_scores(
    boxes: Figure,
) -> None:
    """Scores are relative to limits, which were given: 200 steps until convergence and an error of 0.4."""
    caption = caption_of(boxes)
    assert boxes.get_supylabel() == "score $H$"
    assert caption.startswith(r"$\hat{b} - b$ of flawed robots")
    common = "robots 4, topology fully-connected, steps 300, seed 1, omega 0.05, 5 trials of each experiment"
    assert common in caption
    assert "$K_{max}$ = 200, $e_{max}$ = 0.4; a point is a trial" in caption


# --- Points ----------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def scatter(results: list[Trials]) -> Figure:
    """Draw the scores of underconfident swarms, and of one that is overconfident."""
    overconfident = results_of(replace(SHORT_EXPERIMENT, flawed=2, true_accuracy=0.55, flawed_accuracy=0.95))
    return plot_scatter([*results, overconfident], limits=LIMITS_OF_SCORES)


def panel_titled(figure: Figure, title: str) -> Axes:
    """Return the panel of a figure that has this title."""
    (axes,) = [axes for axes in figure.axes if axes.get_title() == title]
    return axes


@pytest.fixture(scope="module")
def half_flawed_panel(scatter: Figure) -> Axes:
    """The panel of swarms without a filter in which half of the robots are flawed, on a floor 55 % black.

    It has the points of three experiments: flawed robots assume 0.55 or 0.75 where 0.95 is true, so they are
    underconfident; or 0.95 where 0.55 is true, so they are overconfident.
    """
    return panel_titled(scatter, "no filter\n$f = 0.55$, $P$ = 50%")


def test_points_of_scores_have_a_row_for_each_filter_and_floor_and_a_column_for_each_share(
    scatter: Figure,
) -> None:
    """f is the fill ratio of the floor, and P the share of flawed robots. These are the first four titles."""
    filters = 3
    fill_ratios = 2
    shares = 3
    assert layout_of(scatter) == Layout(rows=filters * fill_ratios, columns=shares, width=9, panel_height=1.7)
    assert titles_of(scatter)[:4] == [
        "no filter\n$f = 0.55$, $P$ = 0%",
        "no filter\n$f = 0.55$, $P$ = 50%",
        "no filter\n$f = 0.55$, $P$ = 100%",
        "no filter\n$f = 0.95$, $P$ = 0%",
    ]


@pytest.mark.parametrize(("flawed", "percent", "experiment_count"), [(0, 0, 1), (2, 50, 2), (4, 100, 1)])
def test_points_are_the_scores_for_convergence_and_error_of_the_trials_of_a_panel(
    flawed: int, percent: int, experiment_count: int, scatter: Figure, results: list[Trials]
) -> None:
    """Panels are of swarms without a filter in which 0, 2 or 4 of 4 robots are flawed.

    With 2 there are two experiments, since flawed robots assume one of two accuracies. Along the x axis is
    h_K, the score for convergence, and along the y axis h_e, the score for the error.
    """
    panel = panel_titled(scatter, f"no filter\n$f = 0.95$, $P$ = {percent}%")
    panel_parameters = {"filter": "none", "fill_ratio": 0.95, "flawed": flawed}
    experiments_of_panel = select_experiments(results, panel_parameters)
    assert len(experiments_of_panel) == experiment_count

    for line, trials in zip(panel.lines, experiments_of_panel, strict=True):
        scores = trials.scores(LIMITS_OF_SCORES)  # those of the picture
        assert x_values_of(line) == scores["h_K"].tolist()
        assert y_values_of(line) == scores["h_e"].tolist()


def test_points_of_underconfident_swarms_are_red_and_those_of_overconfident_ones_blue(
    half_flawed_panel: Axes,
) -> None:
    """Underconfident robots assume that their sensors are worse than they are; two of three swarms are so."""
    is_redder_than_blue = []
    for line in half_flawed_panel.lines:
        red, _green, blue = to_rgb(line.get_color())
        is_redder_than_blue.append(red > blue)

    underconfident, also_underconfident, overconfident = is_redder_than_blue
    assert underconfident
    assert also_underconfident
    assert not overconfident


def test_points_are_darker_the_farther_the_assumed_accuracy_is_from_the_true_one(
    half_flawed_panel: Axes,
) -> None:
    """0.55 is far from the true accuracy of 0.95, and 0.75 is near."""
    far, near, _overconfident = half_flawed_panel.lines
    brightness_of_far = sum(to_rgb(far.get_color()))  # of red, green and blue
    brightness_of_near = sum(to_rgb(near.get_color()))
    assert brightness_of_far < brightness_of_near


def test_points_have_one_marker_for_each_true_accuracy(half_flawed_panel: Axes) -> None:
    """The true accuracy is 0.95 in the first two experiments, and 0.55 in the overconfident one."""
    far, near, overconfident = half_flawed_panel.lines
    assert far.get_marker() == near.get_marker()
    assert far.get_marker() != overconfident.get_marker()


def test_points_of_swarms_without_flawed_robots_are_black(scatter: Figure) -> None:
    """INK is the black of all pictures."""
    (line,) = panel_titled(scatter, "no filter\n$f = 0.55$, $P$ = 0%").lines
    assert line.get_color() == INK


def test_both_axes_of_points_show_scores_from_0_to_100_with_a_margin(scatter: Figure) -> None:
    for axes in visible_axes(scatter):
        assert axes.get_xlim() == (-4, 104)
        assert axes.get_ylim() == (-4, 104)


def test_the_legend_of_points_has_the_true_and_the_assumed_accuracy_of_flawed_robots(scatter: Figure) -> None:
    r"""The legend calls these accuracies b and \hat{b}."""
    assert legend_of(scatter) == [
        r"$b$ = 0.55, $\hat{b}$ = 0.95",
        r"$b$ = 0.95, $\hat{b}$ = 0.55",
        r"$b$ = 0.95, $\hat{b}$ = 0.75",
        "$b$ = 0.95, none flawed",
    ]


# --- Series and what fits --------------------------------------------------------------------------------


def with_parameters(trials: Trials, **parameters: Any) -> Trials:
    """Return the results as if they were of an experiment with other parameters."""
    return replace(trials, experiment=replace(trials.experiment, **parameters))


@pytest.fixture(scope="module")
def unfiltered(results: list[Trials]) -> Trials:
    """Results of one experiment without a filter."""
    return results[0]


def plot_curves_by_seed(experiments: list[Trials]) -> Figure:
    """Draw a curve for each seed."""
    return plot_curve(experiments, x="omega", hue="seed")


@pytest.mark.parametrize("plot", [plot_boxes, plot_scatter, plot_curves_by_seed])
@pytest.mark.parametrize("count", [9, 20])
def test_more_than_eight_series_are_too_many_for_a_picture_and_are_refused(
    plot: Any, count: int, unfiltered: Trials
) -> None:
    """There are eight colours."""
    experiments = [with_parameters(unfiltered, seed=seed) for seed in range(count)]
    with pytest.raises(UsageError, match=f"with {count} series do not fit a picture"):
        plot(experiments)


def test_eight_series_fit_a_picture(unfiltered: Trials) -> None:
    experiments = [with_parameters(unfiltered, seed=seed) for seed in range(8)]
    assert len(legend_of(plot_boxes(experiments))) == 8


def test_33_panels_are_too_many_for_a_picture_and_are_refused(unfiltered: Trials) -> None:
    """Every fill ratio, 0, 1/40, 2/40 and so on, has a panel of its own."""
    experiments = [with_parameters(unfiltered, fill_ratio=index / 40) for index in range(33)]
    with pytest.raises(UsageError, match="33 panels"):
        plot_boxes(experiments)


@pytest.mark.slow
def test_32_panels_fit_a_picture(unfiltered: Trials) -> None:
    """Every fill ratio, 0, 1/40, 2/40 and so on, has a panel of its own."""
    experiments = [with_parameters(unfiltered, fill_ratio=index / 40) for index in range(32)]
    assert len(plot_boxes(experiments).axes) == 32


def test_the_legend_has_filters_in_their_usual_order_for_any_order_of_the_experiments(
    results_by_filter: dict[str, Trials],
) -> None:
    """The results are of one experiment with each filter, the last filter first."""
    figure = plot_boxes([*results_by_filter.values()])
    assert legend_of(figure) == ["no filter", "ASDF\N{MINUS SIGN}", "ASDF+", "robust"]


def test_a_second_series_of_the_robust_filter_gets_a_colour_that_no_filter_has(
    results_by_filter: dict[str, Trials],
) -> None:
    """GREEN is the robust filter's colour. Its series with the shorter filter period gets it."""
    second_robust = with_parameters(results_by_filter["robust"], filter_period=50)
    figure = plot_boxes([second_robust, *results_by_filter.values()])
    *_other_filters, shorter_period, longer_period = legend_of(figure)
    assert (shorter_period, longer_period) == ("robust, filter period 50", "robust, filter period 100")

    (legend,) = figure.legends
    colours = [handle.get_color() for handle in legend.get_lines()]
    asdf_minus_colour, asdf_plus_colour, _robust_colour, further_colour, *_ = COLOURS
    assert colours == [GREY, asdf_minus_colour, asdf_plus_colour, GREEN, further_colour]


def test_the_caption_has_the_limits_of_convergence_of_all_swarms() -> None:
    """By default K_max is the number of steps, which is 100 in one swarm and 200 in the other."""
    swarms = []
    for steps in (100, 200):
        swarms.append(run_trials(Experiment(robots=4, steps=steps, filter_period=50), first=0, trials=2))
    assert "$K_{max}$ = 100 and 200, " in caption_of(plot_boxes(swarms))


def test_the_caption_has_omega_only_if_a_filter_uses_it(results_by_filter: dict[str, Trials]) -> None:
    """The paper's filters use it, and the robust one does not."""
    with_asdf = [results_by_filter["asdf-plus"], results_by_filter["robust"]]
    without_asdf = [results_by_filter["none"], results_by_filter["robust"]]

    assert "omega 0.05" in caption_of(plot_boxes(with_asdf))
    assert "omega" not in caption_of(plot_boxes(without_asdf))
