"""Pictures over time: errors of swarms, assumed accuracies, and single trials beside their records."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from host_tools.experiments.drawn_figures import (
    GREEN,
    GREY,
    SHORT_EXPERIMENT,
    Layout,
    assert_line_has_medians_in_band,
    band_edges,
    caption_of,
    layout_of,
    legend_of,
    results_of,
    titles_of,
    visible_axes,
)
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.common.figures import FLAWED, INK, OTHER
from mcp_asdf_tools.experiments.error_plot import plot_errors_over_time
from mcp_asdf_tools.experiments.plots.bands import plot_bands
from mcp_asdf_tools.experiments.plots.series import plot_runs, plot_series
from mcp_asdf_tools.experiments.results import Trials

# --- Errors of swarms ------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def recorded_swarms() -> dict[str, list[Trials]]:
    """Run swarms on two floors with each of two filters, recorded every 50 of 290 steps: lists by filter."""
    common = replace(SHORT_EXPERIMENT, flawed=2, steps=290, trials=6)
    return {
        name: [
            results_of(replace(common, filter=name, fill_ratio=fill_ratio), sampling_interval=50)
            for fill_ratio in (0.55, 0.95)
        ]
        for name in ("none", "robust")
    }


@pytest.fixture(scope="module")
def errors_over_time(recorded_swarms: dict[str, list[Trials]]) -> Figure:
    """Draw panels with both filters, with one of them, and with a single experiment."""
    unfiltered, robust = recorded_swarms["none"], recorded_swarms["robust"]
    panels = {
        "both": [*unfiltered, *robust],
        "none": unfiltered,
        "robust": robust,
        "one experiment": unfiltered[:1],
    }
    return plot_errors_over_time(panels)


def test_errors_of_all_experiments_to_which_the_user_gives_one_name_are_in_one_line(
    recorded_swarms: dict[str, list[Trials]],
) -> None:
    """There are two filters for each of two fill ratios, and ``series_name`` names the fill ratio alone."""
    panels = {"both": [*recorded_swarms["none"], *recorded_swarms["robust"]]}
    figure = plot_errors_over_time(panels, series_name=lambda experiment: f"f = {experiment.fill_ratio}")
    assert len(figure.axes[0].lines) == 2
    assert legend_of(figure) == ["f = 0.55", "f = 0.95"]


def test_errors_over_time_have_a_panel_for_each_title_that_the_user_gives(errors_over_time: Figure) -> None:
    """Errors have a logarithmic axis."""
    assert titles_of(errors_over_time) == ["both", "none", "robust", "one experiment"]
    assert layout_of(errors_over_time) == Layout(rows=2, columns=3, width=9, panel_height=1.9)
    assert {axes.get_yscale() for axes in visible_axes(errors_over_time)} == {"log"}
    assert "bands their 95 % intervals" in caption_of(errors_over_time)


def mean_errors_by_step(experiments: list[Trials]) -> dict[float, NDArray[np.float64]]:
    """Return the swarm's mean |x - f| in each trial of all experiments, by the recorded step."""
    robot_axis = 2  # records have the axes trial, step and robot
    mean_errors = np.concatenate(
        [abs(trials.records["x"] - trials.experiment.fill_ratio).mean(robot_axis) for trials in experiments]
    )
    recorded_steps = range(0, 290, 50)  # 0, 50 and so on to 250
    errors_by_step = mean_errors.T  # a row for each step in place of each trial
    return {float(step): errors for step, errors in zip(recorded_steps, errors_by_step, strict=True)}


@pytest.mark.parametrize(("line_index", "filter_name"), [(0, "none"), (1, "robust")])
def test_the_line_of_a_filter_has_the_median_over_trials_of_the_swarm_s_mean_error(
    line_index: int, filter_name: str, errors_over_time: Figure, recorded_swarms: dict[str, list[Trials]]
) -> None:
    """It lies in a band of the medians' 95 % intervals. Trials of both floors count."""
    axes = errors_over_time.axes[0]
    samples_by_step = mean_errors_by_step(recorded_swarms[filter_name])
    line, band = axes.lines[line_index], axes.collections[line_index]
    assert_line_has_medians_in_band(line, band, samples_by_step)


def test_errors_over_time_have_the_colours_of_their_filters(errors_over_time: Figure) -> None:
    """A filter alone in a panel has the same colour as beside a second filter."""
    both, _, robust, _ = visible_axes(errors_over_time)
    assert [line.get_color() for line in both.lines] == [GREY, GREEN]
    assert [line.get_color() for line in robust.lines] == [GREEN]
    assert legend_of(errors_over_time) == ["no filter", "robust"]


# --- Assumed accuracies ----------------------------------------------------------------------------------


FLAWED_ROBOTS, HEALTHY_ROBOTS = slice(0, 2), slice(2, 4)
"""Robots of ``half_flawed``, along the last axis of its b_hat; the other two are trial and filter step."""


@pytest.fixture(scope="module")
def half_flawed() -> Trials:
    """Run four robots. The first two are flawed: they assume an accuracy of 0.55 instead of 0.95."""
    return results_of(replace(SHORT_EXPERIMENT, flawed=2, flawed_accuracy=0.55, filter="asdf-plus"))


@pytest.fixture(scope="module")
def bands_figure(half_flawed: Trials) -> Figure:
    """Draw the same results in five panels."""
    return plot_bands([half_flawed] * 5)


def test_a_panel_of_assumed_accuracies_has_the_medians_of_flawed_and_of_healthy_robots(
    bands_figure: Figure, half_flawed: Trials
) -> None:
    """The filter ran in the steps 100, 200 and 300. Medians are over all trials and robots of a kind."""
    flawed_line, healthy_line, _true_accuracy = bands_figure.axes[0].lines
    trial_axis, robot_axis = 0, 2
    flawed_medians = np.median(half_flawed.b_hat[:, :, FLAWED_ROBOTS], axis=(trial_axis, robot_axis))
    healthy_medians = np.median(half_flawed.b_hat[:, :, HEALTHY_ROBOTS], axis=(trial_axis, robot_axis))

    assert np.asarray(flawed_line.get_xdata()).tolist() == [100, 200, 300]
    assert np.asarray(flawed_line.get_ydata()).tolist() == flawed_medians.tolist()
    assert np.asarray(healthy_line.get_ydata()).tolist() == healthy_medians.tolist()


def test_flawed_and_healthy_robots_have_different_colours_and_the_true_accuracy_a_dashed_line(
    bands_figure: Figure,
) -> None:
    flawed_line, healthy_line, true_accuracy = bands_figure.axes[0].lines
    assert (flawed_line.get_color(), healthy_line.get_color()) == (FLAWED, OTHER)
    assert (true_accuracy.get_color(), true_accuracy.get_linestyle()) == (INK, "--")
    assert set(np.asarray(true_accuracy.get_ydata()).tolist()) == {0.95}


@pytest.mark.parametrize(("filter_step", "step"), [(0, 100), (1, 200), (2, 300)])
def test_the_band_of_flawed_robots_holds_the_middle_90_percent_of_what_they_assume(
    filter_step: int, step: int, bands_figure: Figure, half_flawed: Trials
) -> None:
    """It reaches from the 5th to the 95th percentile of b_hat of these robots in all trials."""
    flawed_band, _healthy_band = bands_figure.axes[0].collections
    percentiles = np.percentile(half_flawed.b_hat[:, filter_step, FLAWED_ROBOTS], [5, 95])
    assert band_edges(flawed_band, step) == pytest.approx(percentiles)


def first_title_of(figure: Figure) -> str:
    """Return the title of a figure's first panel, in one line."""
    first_title, *_ = titles_of(figure)
    return first_title.replace("\n", " ")


def test_a_title_of_assumed_accuracies_has_parameters_and_the_share_of_healthy_robots_that_end_wrong(
    bands_figure: Figure, half_flawed: Trials
) -> None:
    r"""Parameters are f, the true accuracy b, the \hat{b} that flawed robots assume, and their share P.

    Wrong is more than 0.05 from the true accuracy, 0.95, which healthy robots assume at first.
    """
    last_filter_step = -1
    b_hat_at_end = half_flawed.b_hat[:, last_filter_step, HEALTHY_ROBOTS]
    share = np.mean(abs(b_hat_at_end - 0.95) > 0.05)

    title = first_title_of(bands_figure)
    assert title.startswith(r"$f$ = 0.55, $b$ = 0.95, $\hat{b}$ = 0.55, $P$ = 50% ")
    assert title.endswith(f" more than 0.05 off: {share:.0%} of healthy robots")


def test_healthy_robots_are_off_if_they_end_far_from_what_they_assumed_at_first(half_flawed: Trials) -> None:
    """They assume 0.8 at first and 0.84 in the end, which is less than 0.05 from 0.8, but not from 0.95."""
    experiment = replace(half_flawed.experiment, unflawed_accuracy=0.8)
    b_hat = half_flawed.b_hat.copy()
    last_filter_step = -1
    b_hat[:, last_filter_step, HEALTHY_ROBOTS] = 0.84
    figure = plot_bands([replace(half_flawed, experiment=experiment, b_hat=b_hat)])

    assert first_title_of(figure).endswith("off: 0% of healthy robots")


def test_five_experiments_have_a_row_of_three_panels_of_bands_and_one_of_two(bands_figure: Figure) -> None:
    """The sixth place is empty."""
    assert [axes.axison for axes in bands_figure.axes] == [True] * 5 + [False]
    assert layout_of(bands_figure) == Layout(rows=2, columns=3, width=9, panel_height=2.1)


def test_four_experiments_have_two_rows_of_two_panels_of_bands(half_flawed: Trials) -> None:
    assert layout_of(plot_bands([half_flawed] * 4)) == Layout(rows=2, columns=2, width=9, panel_height=2.1)


def test_a_swarm_without_healthy_robots_has_one_band_and_a_dash_for_their_share(half_flawed: Trials) -> None:
    figure = plot_bands([results_of(replace(half_flawed.experiment, flawed=4))])
    assert len(figure.axes[0].collections) == 1
    assert first_title_of(figure).endswith("off: -")


def test_panels_of_bands_begin_with_the_name_of_their_filter_and_are_ordered_by_it(
    half_flawed: Trials,
) -> None:
    """The swarm without a filter is given last and drawn first."""
    unfiltered = results_of(replace(half_flawed.experiment, filter="none"))
    first_title, second_title = titles_of(plot_bands([half_flawed, unfiltered]))
    assert first_title.startswith("no filter\n")
    assert second_title.startswith("ASDF+\n")


def test_titles_of_bands_have_the_filter_period_where_it_differs_and_has_an_effect(
    half_flawed: Trials,
) -> None:
    """Without a filter the period has no effect. Parameters stand in the second line of a title."""
    unfiltered = results_of(replace(half_flawed.experiment, filter="none"))
    other_period = results_of(replace(half_flawed.experiment, filter_period=150))
    titles = titles_of(plot_bands([unfiltered, half_flawed, other_period]))
    parameters = []
    for title in titles:
        _first_line, second_line, *_ = title.split("\n")
        parameters.append(second_line)

    unfiltered_parameters, parameters_of_period_100, parameters_of_period_150 = parameters
    assert unfiltered_parameters.startswith("$f$ = 0.55,")
    assert parameters_of_period_100.startswith("filter period 100,")
    assert parameters_of_period_150.startswith("filter period 150,")


def test_bands_of_trials_in_which_no_filter_has_run_are_refused(half_flawed: Trials) -> None:
    """Bands are drawn where robots run their filter; with a period of 1000 none does in 300 steps."""
    without_filter_step = results_of(replace(SHORT_EXPERIMENT, filter_period=1000))
    with pytest.raises(UsageError, match="these trials have no filter step"):
        plot_bands([half_flawed, without_filter_step])


# --- One trial -------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def recorded_runs() -> list[Trials]:
    """Run a trial of 292 steps that is recorded every 2 steps, and one of 200 steps every 30."""
    experiment = replace(SHORT_EXPERIMENT, flawed=1, trials=1, steps=292)
    unfiltered = results_of(experiment, sampling_interval=2)
    filtered = results_of(replace(experiment, filter="asdf-plus", steps=200), sampling_interval=30)
    return [unfiltered, filtered]


@pytest.fixture(scope="module")
def runs_figure(recorded_runs: list[Trials]) -> Figure:
    """Draw the two runs in two columns, with a row of panels for b_hat, x_hat and x."""
    return plot_runs(recorded_runs, trial_number=0)


def panel_of(figure: Figure, row: int, column: int) -> Axes:
    """Return a panel of the picture of two runs: rows are quantities, and columns runs."""
    return figure.axes[2 * row + column]


@pytest.mark.parametrize(("run", "recorded_steps"), [(0, range(0, 293, 2)), (1, range(0, 200, 30))])
@pytest.mark.parametrize("row", [0, 1, 2])
def test_a_panel_of_a_trial_has_a_line_of_what_was_recorded_of_each_robot(
    run: int, recorded_steps: range, row: int, runs_figure: Figure, recorded_runs: list[Trials]
) -> None:
    """The lines of four robots are drawn from the last robot to the first."""
    *robot_lines, _true_value = panel_of(runs_figure, row, run).lines
    quantity = ("b_hat", "x_hat", "x")[row]  # as the rows are drawn
    [values_by_step] = recorded_runs[run].records[quantity]  # of the only trial, by step and robot

    for robot, line in zip((3, 2, 1, 0), robot_lines, strict=True):
        assert np.asarray(line.get_xdata()).tolist() == [*recorded_steps]
        assert np.asarray(line.get_ydata()).tolist() == values_by_step[:, robot].tolist()


def test_lines_of_flawed_robots_lie_on_top_of_those_of_healthy_ones(runs_figure: Figure) -> None:
    """A panel has three healthy robots, a flawed one, and the true value; what is drawn later lies on top."""
    for axes in runs_figure.axes:
        assert [line.get_color() for line in axes.lines] == [OTHER] * 3 + [FLAWED, INK]


@pytest.mark.parametrize(("row", "letter", "true_value"), [(0, "b", 0.95), (1, "f", 0.55), (2, "f", 0.55)])
def test_a_panel_of_a_trial_has_a_line_at_the_true_value_and_its_letter_at_the_right(
    row: int, letter: str, true_value: float, runs_figure: Figure
) -> None:
    """The true value of assumed accuracies is the accuracy b. For estimates it is the fill ratio f."""
    axes = panel_of(runs_figure, row, column=1)
    *_robot_lines, true_line = axes.lines
    assert np.asarray(true_line.get_ydata()).tolist() == [true_value, true_value]

    (text,) = axes.texts
    right_edge = 1
    assert text.get_text().strip() == f"{letter} = {true_value}"
    assert text.get_position() == (right_edge, true_value)


def test_all_panels_of_trials_have_the_time_axis_of_the_longest_one(runs_figure: Figure) -> None:
    assert {axes.get_xlim() for axes in runs_figure.axes} == {(0, 292)}


@pytest.mark.parametrize(
    ("row", "quantity", "true_value"), [(0, "b_hat", 0.95), (1, "x_hat", 0.55), (2, "x", 0.55)]
)
def test_an_axis_of_recorded_values_has_room_for_all_but_those_of_the_first_moments(
    row: int, quantity: str, true_value: float, runs_figure: Figure, recorded_runs: list[Trials]
) -> None:
    """It reaches over the values of both runs and the true one, and a margin of 6 % of their range or 0.01.

    The values of the first moments do not count, as they may be far outside.
    """
    [first_run], [second_run] = [trials.records[quantity] for trials in recorded_runs]
    first_moments = 2  # a fiftieth of the first run's 147 samples; the second run has too few
    values = [*first_run[first_moments:].ravel(), *second_run.ravel(), true_value]
    margin = max(0.06 * np.ptp(values), 0.01)
    limits = pytest.approx((min(values) - margin, max(values) + margin))

    assert panel_of(runs_figure, row, column=0).get_ylim() == limits
    assert panel_of(runs_figure, row, column=1).get_ylim() == limits


def test_assumed_accuracies_are_drawn_as_steps_and_estimates_as_curves(runs_figure: Figure) -> None:
    """An accuracy that a robot assumes changes only when its filter runs."""
    styles = [panel_of(runs_figure, row, column=0).lines[0].get_drawstyle() for row in range(3)]
    assert styles == ["steps-post", "default", "default"]


def test_the_upper_panel_of_a_trial_has_filter_swarm_and_trial_as_its_title(runs_figure: Figure) -> None:
    swarm = "4 robots, 1 flawed,\nfully-connected, seed 1, trial 0"
    upper_left, upper_right, *other_titles = [axes.get_title("left") for axes in runs_figure.axes]

    assert upper_left == f"no filter: {swarm}"
    assert upper_right == f"ASDF+, $\\tau$ = 100: {swarm}"
    assert other_titles == ["", "", "", ""]


def test_axes_of_trials_are_named_on_the_left_and_at_the_bottom_and_lines_in_the_legend(
    runs_figure: Figure,
) -> None:
    """There are three rows of two panels. A symbol, such as b_hat, follows each name on the left."""
    y_labels = [axes.get_ylabel().partition(" $")[0] for axes in runs_figure.axes]
    assert y_labels == ["assumed accuracy", "", "local estimate", "", "informed estimate", ""]
    assert [axes.get_xlabel() for axes in runs_figure.axes] == ["", "", "", "", "step", "step"]
    assert legend_of(runs_figure) == ["flawed robots", "healthy robots", "true value"]


def test_a_single_trial_is_drawn_in_three_panels_and_one_that_was_not_run_is_refused(
    recorded_runs: list[Trials],
) -> None:
    first_run, _ = recorded_runs
    assert len(plot_series([first_run]).axes) == 3
    with pytest.raises(UsageError, match=r"there is no trial 1; choose one of 0 to 0"):
        plot_series([first_run], trial=1)
