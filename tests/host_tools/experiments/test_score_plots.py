"""Boxes and points of scores: their artists are compared with the trials' numbers."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

from host_tools.experiments.drawn_figures import (
    GREEN,
    GREY,
    SHORT_EXPERIMENT,
    assert_panels,
    caption_of,
    legend_of,
    results_of,
    titles_of,
    visible_axes,
)
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.common.figures import COLOURS, INK
from mcp_asdf_tools.experiments.plot_panels import colours_of_filters
from mcp_asdf_tools.experiments.plots.boxes import plot_boxes
from mcp_asdf_tools.experiments.plots.curve import plot_curve
from mcp_asdf_tools.experiments.plots.scatter import plot_scatter
from mcp_asdf_tools.experiments.results import Trials
from mcp_asdf_tools.experiments.scores import Limits

LIMITS = Limits(200, 0.4)
FLAWED_AND_ACCURACIES = ((0, 0.95), (2, 0.55), (2, 0.75), (4, 0.55))
FILTERS_AND_PERIODS: tuple[tuple[str, int], ...] = (("none", 100), ("asdf-plus", 100), ("asdf-plus", 150))

SERIES_COUNT = 3
BOX_WIDTH = 0.86 / SERIES_COUNT


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
    return plot_boxes(results, limits=LIMITS)


def points_by_position(axes: Axes) -> list[tuple[np.ndarray, np.ndarray, str]]:
    """Return x, y and colour of each box's points, from left to right."""
    points = [
        (np.asarray(line.get_xdata()), np.asarray(line.get_ydata()), str(line.get_color()))
        for line in axes.lines
        if line.get_marker() == "." and not line.get_markeredgewidth()
    ]
    return sorted(points, key=lambda box: float(box[0].mean()))


def trials_by_position(results: list[Trials], fill_ratio: float) -> list[Trials]:
    """Return the experiments of a panel from left to right: by flawed robots, offset of b_hat and series."""
    panel = [trials for trials in results if trials.experiment.fill_ratio == fill_ratio]
    return sorted(panel, key=lambda trials: (trials.experiment.flawed, trials.experiment.flawed_accuracy))


def test_boxes_have_a_panel_for_each_fill_ratio(boxes: Figure) -> None:
    assert titles_of(boxes) == ["$f = 0.55$, $b = 0.95$", "$f = 0.95$, $b = 0.95$"]
    assert_panels(boxes, rows=2, columns=1, panel_height=2.6)


def test_boxes_have_a_legend_of_filters_and_what_else_differs(boxes: Figure) -> None:
    assert legend_of(boxes) == ["no filter", "ASDF+, filter period 100", "ASDF+, filter period 150"]


def test_boxes_can_have_series_of_other_names(results: list[Trials]) -> None:
    assert legend_of(plot_boxes(results, series_name=lambda experiment: "all of them")) == ["all of them"]


@pytest.mark.parametrize(("panel", "fill_ratio"), [(0, 0.55), (1, 0.95)])
def test_points_of_a_box_are_the_scores_of_its_trials(
    panel: int, fill_ratio: float, boxes: Figure, results: list[Trials]
) -> None:
    drawn_scores = [y.tolist() for _, y, _ in points_by_position(boxes.axes[panel])]
    scores = [trials.scores(LIMITS)["H"].tolist() for trials in trials_by_position(results, fill_ratio)]
    assert drawn_scores == scores


def test_boxes_of_a_slot_stand_side_by_side(boxes: Figure) -> None:
    for box_index, (x, _, _) in enumerate(points_by_position(boxes.axes[0])):
        slot, series_index = divmod(box_index, SERIES_COUNT)
        assert x.mean() == pytest.approx(slot + (series_index - 1) * BOX_WIDTH, abs=0.05)


def test_points_are_spread_over_the_width_of_their_box(boxes: Figure) -> None:
    for x, _, _ in points_by_position(boxes.axes[0]):
        assert len(set(x)) == len(x)
        assert 0.1 < np.ptp(x) < BOX_WIDTH


def test_boxes_are_grey_without_a_filter_and_else_in_the_colour_of_their_series(boxes: Figure) -> None:
    colours = [colour for _, _, colour in points_by_position(boxes.axes[0])]
    assert colours == [GREY, COLOURS[0], COLOURS[1]] * len(FLAWED_AND_ACCURACIES)


def test_a_box_has_a_line_at_the_median(boxes: Figure, results: list[Trials]) -> None:
    heights = [
        set(np.asarray(line.get_ydata()).tolist()) for line in boxes.axes[0].lines if line.get_color() == INK
    ]
    medians = [{float(np.median(trials.scores(LIMITS)["H"]))} for trials in trials_by_position(results, 0.55)]

    assert sorted(map(sorted, heights)) == sorted(map(sorted, medians))


def test_no_box_is_drawn_twice(boxes: Figure) -> None:
    lines_of_box = 6  # edge, median, two whiskers and two caps; and its points
    assert len(boxes.axes[0].lines) == (lines_of_box + 1) * SERIES_COUNT * len(FLAWED_AND_ACCURACIES)


def test_boxes_are_labelled_by_offset_of_b_hat_and_share_of_flawed_robots(boxes: Figure) -> None:
    labels = [label.get_text() for label in boxes.axes[0].get_xticklabels()]
    assert labels == ["+0\n0%", "-0.4\n50%", "-0.2\n50%", "-0.4\n100%"]


def test_each_panel_of_boxes_shows_scores_from_0_to_100_with_a_margin_above(boxes: Figure) -> None:
    margin = 3
    assert {axes.get_ylim() for axes in boxes.axes} == {(0, 100 + margin)}


def test_each_panel_of_boxes_shows_four_slots_around_0_to_3(boxes: Figure) -> None:
    last_slot = len(FLAWED_AND_ACCURACIES) - 1
    assert {axes.get_xlim() for axes in boxes.axes} == {(-0.5, last_slot + 0.5)}


def test_the_score_and_the_labels_of_slots_are_named_beside_the_boxes(boxes: Figure) -> None:
    assert boxes.get_supylabel() == "score $H$"
    assert caption_of(boxes).startswith(r"$\hat{b} - b$ of flawed robots")


def test_the_caption_has_what_all_experiments_have_in_common(boxes: Figure) -> None:
    common = "robots 4, topology fully-connected, steps 300, seed 1, omega 0.05, 5 trials of each experiment"
    assert common in caption_of(boxes)


def test_the_caption_has_the_limits_and_explains_the_marks(boxes: Figure) -> None:
    assert "$K_{max}$ = 200, $e_{max}$ = 0.4; a point is a trial" in caption_of(boxes)


# --- Points ----------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def scatter(results: list[Trials]) -> Figure:
    """Draw the scores of underconfident swarms, and of one that is overconfident."""
    overconfident = results_of(replace(SHORT_EXPERIMENT, flawed=2, true_accuracy=0.55, flawed_accuracy=0.95))
    return plot_scatter([*results, overconfident], limits=LIMITS)


def panel_titled(figure: Figure, title: str) -> Axes:
    (axes,) = [axes for axes in figure.axes if axes.get_title() == title]
    return axes


def test_points_have_a_row_for_each_series_and_f_and_a_column_for_each_p(scatter: Figure) -> None:
    assert_panels(scatter, rows=SERIES_COUNT * 2, columns=3, panel_height=1.7)
    assert titles_of(scatter)[:4] == [
        "no filter\n$f = 0.55$, $P$ = 0%",
        "no filter\n$f = 0.55$, $P$ = 50%",
        "no filter\n$f = 0.55$, $P$ = 100%",
        "no filter\n$f = 0.95$, $P$ = 0%",
    ]


@pytest.mark.parametrize(("flawed", "percent", "count"), [(0, 0, 1), (2, 50, 2), (4, 100, 1)])
def test_points_are_the_two_scores_of_the_trials(
    flawed: int, percent: int, count: int, scatter: Figure, results: list[Trials]
) -> None:
    axes = panel_titled(scatter, f"no filter\n$f = 0.95$, $P$ = {percent}%")
    drawn = [np.asarray(line.get_xydata()).tolist() for line in axes.lines]
    panel = [
        trials
        for trials in results
        if (trials.experiment.fill_ratio, trials.experiment.filter) == (0.95, "none")
        and trials.experiment.flawed == flawed
    ]
    scores = [trials.scores(LIMITS) for trials in panel]

    assert drawn == [np.stack([score["h_K"], score["h_e"]], axis=1).tolist() for score in scores]
    assert len(drawn) == count


def test_underconfident_swarms_are_red_and_overconfident_ones_blue(scatter: Figure) -> None:
    lines = panel_titled(scatter, "no filter\n$f = 0.55$, $P$ = 50%").lines
    is_red = [to_rgb(line.get_color())[0] > to_rgb(line.get_color())[2] for line in lines]
    assert is_red == [True, True, False]


def test_points_are_darker_the_farther_b_hat_is_off(scatter: Figure) -> None:
    far, near, _overconfident = panel_titled(scatter, "no filter\n$f = 0.55$, $P$ = 50%").lines
    assert sum(to_rgb(far.get_color())) < sum(to_rgb(near.get_color()))


def test_each_true_accuracy_has_a_marker(scatter: Figure) -> None:
    far, near, overconfident = panel_titled(scatter, "no filter\n$f = 0.55$, $P$ = 50%").lines
    assert far.get_marker() == near.get_marker() != overconfident.get_marker()


def test_points_without_flawed_robots_are_black(scatter: Figure) -> None:
    (line,) = panel_titled(scatter, "no filter\n$f = 0.55$, $P$ = 0%").lines
    assert line.get_color() == INK


def test_points_have_the_axes_of_scores(scatter: Figure) -> None:
    limits = {(axes.get_xlim(), axes.get_ylim()) for axes in visible_axes(scatter)}
    assert limits == {((-4, 104), (-4, 104))}


def test_the_legend_of_points_has_b_and_b_hat(scatter: Figure) -> None:
    assert legend_of(scatter) == [
        r"$b$ = 0.55, $\hat{b}$ = 0.95",
        r"$b$ = 0.95, $\hat{b}$ = 0.55",
        r"$b$ = 0.95, $\hat{b}$ = 0.75",
        "$b$ = 0.95, none flawed",
    ]


# --- Series and what fits --------------------------------------------------------------------------------


def with_parameters(trials: Trials, **parameters: Any) -> Trials:
    """Return the results as those of another experiment."""
    return replace(trials, experiment=replace(trials.experiment, **parameters))


@pytest.mark.parametrize(
    "plot", [plot_boxes, plot_scatter, lambda experiments: plot_curve(experiments, "omega", hue="seed")]
)
def test_nine_series_do_not_fit_a_picture(plot: Any, results: list[Trials]) -> None:
    experiments = [with_parameters(results[0], seed=seed) for seed in range(9)]
    with pytest.raises(UsageError, match="with 9 series do not fit a picture"):
        plot(experiments)


def test_eight_series_fit_a_picture(results: list[Trials]) -> None:
    experiments = [with_parameters(results[0], seed=seed) for seed in range(8)]
    assert len(legend_of(plot_boxes(experiments))) == 8


@pytest.mark.slow
def test_32_panels_fit_a_picture_and_33_do_not(results: list[Trials]) -> None:
    experiments = [with_parameters(results[0], fill_ratio=index / 40) for index in range(33)]
    assert len(plot_boxes(experiments[:32]).axes) == 32
    with pytest.raises(UsageError, match="33 panels"):
        plot_boxes(experiments)


def test_series_are_in_the_order_of_filters(results_by_filter: dict[str, Trials]) -> None:
    figure = plot_boxes([*results_by_filter.values()])
    assert legend_of(figure) == ["no filter", "ASDF\N{MINUS SIGN}", "ASDF+", "robust"]


def test_a_filter_has_its_colour_once(results_by_filter: dict[str, Trials]) -> None:
    robust = results_by_filter["robust"]
    figure = plot_boxes([with_parameters(robust, filter_period=50), *results_by_filter.values()])
    colours = [handle.get_color() for handle in figure.legends[0].get_lines()]

    assert legend_of(figure)[-2:] == ["robust, filter period 50", "robust, filter period 100"]
    assert colours == [GREY, COLOURS[0], COLOURS[1], GREEN, COLOURS[3]]


def test_series_of_one_filter_can_be_told_apart_by_colour() -> None:
    colours = colours_of_filters(["none", "none", "asdf-plus", "robust", "robust"])
    assert (colours[0], colours[3]) == (GREY, GREEN)
    assert len(set(colours)) == 5


def test_the_caption_leaves_out_parameters_that_no_filter_uses(results_by_filter: dict[str, Trials]) -> None:
    assert "omega 0.05" in caption_of(plot_boxes([*results_by_filter.values()]))
    without_omega = [results_by_filter["robust"], results_by_filter["none"]]
    assert "omega" not in caption_of(plot_boxes(without_omega))
