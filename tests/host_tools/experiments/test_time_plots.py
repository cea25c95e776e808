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
    x_values_of,
    y_values_of,
)
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.common.figures import INK
from mcp_asdf_tools.experiments import plot_labels
from mcp_asdf_tools.experiments.error_plot import plot_errors_over_time
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.plot_panels import COLOUR_OF_FLAWED_ROBOTS, COLOUR_OF_HEALTHY_ROBOTS
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
    return plot_errors_over_time(panels, series_name=plot_labels.filter_name)


def name_by_fill_ratio(experiment: Experiment) -> str:
    """Return the name of the line of an experiment, as a user's own function may."""
    return f"f = {experiment.fill_ratio}"


def test_errors_of_all_experiments_to_which_the_user_gives_one_name_are_in_one_line(
    recorded_swarms: dict[str, list[Trials]],
) -> None:
    """There are two filters for each of two fill ratios, and ``series_name`` names the fill ratio alone."""
    panels = {"both": [*recorded_swarms["none"], *recorded_swarms["robust"]]}
    figure = plot_errors_over_time(panels, series_name=name_by_fill_ratio)
    (axes,) = visible_axes(figure)
    assert len(axes.lines) == 2
    assert legend_of(figure) == ["f = 0.55", "f = 0.95"]


def test_errors_over_time_have_a_panel_for_each_title_that_the_user_gives(errors_over_time: Figure) -> None:
    """There are four, so the last one is in a second row. Errors have a logarithmic axis."""
    assert titles_of(errors_over_time) == ["both", "none", "robust", "one experiment"]
    assert layout_of(errors_over_time) == Layout(rows=2, columns=3, width=9, panel_height=1.9)
    assert [axes.get_yscale() for axes in visible_axes(errors_over_time)] == ["log"] * 4
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
    """It lies in a band of the medians' 95 % intervals. Trials of both floors count.

    The first panel has a line and a band for each of the two filters.
    """
    panel_of_both_filters = errors_over_time.axes[0]
    line = panel_of_both_filters.lines[line_index]
    band = panel_of_both_filters.collections[line_index]
    samples_by_step = mean_errors_by_step(recorded_swarms[filter_name])
    assert_line_has_medians_in_band(line, band, samples_by_step)


def test_errors_over_time_have_the_colours_of_their_filters(errors_over_time: Figure) -> None:
    """A filter alone in a panel has the same colour as beside a second filter."""
    panel_of_both_filters, _unfiltered_panel, robust_panel, _ = visible_axes(errors_over_time)
    assert [line.get_color() for line in panel_of_both_filters.lines] == [GREY, GREEN]
    assert [line.get_color() for line in robust_panel.lines] == [GREEN]
    assert legend_of(errors_over_time) == ["no filter", "robust"]


# --- Assumed accuracies ----------------------------------------------------------------------------------


def b_hat_after(filter_step: int, trials: Trials, robots: list[int]) -> NDArray[np.float64]:
    """Return what some robots assume after a filter step, in all trials; the first filter step is 0."""
    b_hat: NDArray[np.float64] = trials.b_hat[:, filter_step, robots].ravel()  # by trial, step and robot
    return b_hat


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
    """The filter ran in the steps 100, 200 and 300. Medians are over all trials and robots of a kind.

    Robots 0 and 1 are flawed, and 2 and 3 healthy.
    """
    flawed_line, healthy_line, _true_accuracy = bands_figure.axes[0].lines
    flawed_medians = []
    healthy_medians = []
    for filter_step in (0, 1, 2):
        flawed_medians.append(np.median(b_hat_after(filter_step, half_flawed, robots=[0, 1])))
        healthy_medians.append(np.median(b_hat_after(filter_step, half_flawed, robots=[2, 3])))

    assert x_values_of(flawed_line) == x_values_of(healthy_line) == [100, 200, 300]
    assert y_values_of(flawed_line) == flawed_medians
    assert y_values_of(healthy_line) == healthy_medians


def test_flawed_and_healthy_robots_have_different_colours_and_the_true_accuracy_a_dashed_line(
    bands_figure: Figure,
) -> None:
    """The true accuracy is 0.95 in all steps. INK is the black of all pictures."""
    flawed_line, healthy_line, true_line = bands_figure.axes[0].lines
    assert flawed_line.get_color() == COLOUR_OF_FLAWED_ROBOTS
    assert healthy_line.get_color() == COLOUR_OF_HEALTHY_ROBOTS
    assert COLOUR_OF_FLAWED_ROBOTS != COLOUR_OF_HEALTHY_ROBOTS
    assert (true_line.get_color(), true_line.get_linestyle()) == (INK, "--")
    assert set(y_values_of(true_line)) == {0.95}


@pytest.mark.parametrize(("filter_step", "step"), [(0, 100), (1, 200), (2, 300)])
def test_the_band_of_flawed_robots_holds_the_middle_90_percent_of_what_they_assume(
    filter_step: int, step: int, bands_figure: Figure, half_flawed: Trials
) -> None:
    """It reaches from the 5th to the 95th percentile of b_hat of robots 0 and 1, the flawed ones.

    All trials count. The filter ran in the steps 100, 200 and 300.
    """
    flawed_band, _healthy_band = bands_figure.axes[0].collections
    b_hat = b_hat_after(filter_step, half_flawed, robots=[0, 1])
    lower_edge, upper_edge = band_edges(flawed_band, step)
    assert lower_edge == pytest.approx(np.percentile(b_hat, 5))
    assert upper_edge == pytest.approx(np.percentile(b_hat, 95))


def first_title_of(figure: Figure) -> str:
    """Return the title of a figure's first panel, in one line."""
    first_title, *_ = titles_of(figure)
    return first_title.replace("\n", " ")


def test_a_title_of_assumed_accuracies_has_parameters_and_the_share_of_healthy_robots_that_end_wrong(
    bands_figure: Figure, half_flawed: Trials
) -> None:
    r"""Parameters are f, the true accuracy b, the \hat{b} that flawed robots assume, and their share P.

    Wrong is more than 0.05 from the true accuracy, 0.95, which healthy robots, 2 and 3, assume at first.
    """
    last_filter_step = 2  # of three
    b_hat_at_end = b_hat_after(last_filter_step, half_flawed, robots=[2, 3])
    ends_wrong = abs(b_hat_at_end - 0.95) > 0.05
    share = ends_wrong.mean()

    title = first_title_of(bands_figure)
    assert title.startswith(r"$f$ = 0.55, $b$ = 0.95, $\hat{b}$ = 0.55, $P$ = 50% ")
    assert title.endswith(f" more than 0.05 off: {share:.0%} of healthy robots")


def test_healthy_robots_are_off_if_they_end_far_from_what_they_assumed_at_first(half_flawed: Trials) -> None:
    """They assume 0.8 at first and 0.84 in the end, which is less than 0.05 from 0.8, but not from 0.95."""
    experiment = replace(half_flawed.experiment, unflawed_accuracy=0.8)
    healthy_robots = [2, 3]
    last_filter_step = 2  # of three
    b_hat = half_flawed.b_hat.copy()  # by trial, filter step and robot
    b_hat[:, last_filter_step, healthy_robots] = 0.84
    figure = plot_bands([replace(half_flawed, experiment=experiment, b_hat=b_hat)])

    assert first_title_of(figure).endswith("off: 0% of healthy robots")


def test_five_experiments_have_a_row_of_three_panels_of_bands_and_one_of_two(bands_figure: Figure) -> None:
    """The sixth place is empty."""
    assert layout_of(bands_figure) == Layout(rows=2, columns=3, width=9, panel_height=2.1)
    is_drawn = [axes.axison for axes in bands_figure.axes]  # off at an empty place
    assert is_drawn == [True, True, True, True, True, False]


def test_four_experiments_have_two_rows_of_two_panels_of_bands(half_flawed: Trials) -> None:
    assert layout_of(plot_bands([half_flawed] * 4)) == Layout(rows=2, columns=2, width=9, panel_height=2.1)


def test_a_swarm_without_healthy_robots_has_one_band_and_a_dash_for_their_share(half_flawed: Trials) -> None:
    """All four robots are flawed."""
    figure = plot_bands([results_of(replace(half_flawed.experiment, flawed=4))])
    (axes,) = visible_axes(figure)
    bands = axes.collections
    assert len(bands) == 1
    assert first_title_of(figure).endswith("off: -")


def test_titles_of_bands_have_the_filter_period_where_it_differs_and_has_an_effect(
    half_flawed: Trials,
) -> None:
    """Without a filter the period has no effect. Parameters stand in the second line of a title.

    The swarm without a filter is given last and drawn first, as panels are ordered by their filter.
    """
    unfiltered = results_of(replace(half_flawed.experiment, filter="none"))
    other_period = results_of(replace(half_flawed.experiment, filter_period=150))
    titles = titles_of(plot_bands([half_flawed, other_period, unfiltered]))
    unfiltered_title, title_of_period_100, title_of_period_150 = titles

    assert unfiltered_title.startswith("no filter\n$f$ = 0.55,")
    assert title_of_period_100.startswith("ASDF+\nfilter period 100,")
    assert title_of_period_150.startswith("ASDF+\nfilter period 150,")


def test_bands_of_trials_in_which_no_filter_has_run_are_refused(half_flawed: Trials) -> None:
    """Bands are drawn where robots run their filter; with a period of 1000 none does in 300 steps."""
    experiment_of_300_steps = replace(half_flawed.experiment, steps=300, filter_period=1000)
    without_filter_step = results_of(experiment_of_300_steps)
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


def panel_of(figure: Figure, quantity: str, run: int) -> Axes:
    """Return the panel of a quantity of a run, 0 or 1, in the picture of two runs."""
    columns = 2  # a column for each run, and a row for each quantity
    row = ("b_hat", "x_hat", "x").index(quantity)
    return figure.axes[columns * row + run]


@pytest.mark.parametrize(("run", "recorded_steps"), [(0, range(0, 293, 2)), (1, range(0, 200, 30))])
@pytest.mark.parametrize("quantity", ["b_hat", "x_hat", "x"])
def test_a_panel_of_a_trial_has_a_line_of_what_was_recorded_of_each_robot(
    run: int, recorded_steps: range, quantity: str, runs_figure: Figure, recorded_runs: list[Trials]
) -> None:
    """The lines of four robots are drawn from the last robot to the first.

    The picture has a column of panels for each of two runs, and a row for each of three quantities.
    """
    [values_by_step_and_robot] = recorded_runs[run].records[quantity]  # of the only trial
    *robot_lines, _true_value = panel_of(runs_figure, quantity, run).lines

    for robot, line in zip((3, 2, 1, 0), robot_lines, strict=True):
        assert x_values_of(line) == list(recorded_steps)
        assert y_values_of(line) == values_by_step_and_robot[:, robot].tolist()


def test_lines_of_flawed_robots_lie_on_top_of_those_of_healthy_ones(runs_figure: Figure) -> None:
    """A panel has three healthy robots, a flawed one, and the true value; what is drawn later lies on top."""
    colours_of_healthy_robots = [COLOUR_OF_HEALTHY_ROBOTS] * 3
    for axes in runs_figure.axes:
        colours = [line.get_color() for line in axes.lines]
        assert colours == [*colours_of_healthy_robots, COLOUR_OF_FLAWED_ROBOTS, INK]


@pytest.mark.parametrize(
    ("quantity", "letter", "true_value"), [("b_hat", "b", 0.95), ("x_hat", "f", 0.55), ("x", "f", 0.55)]
)
def test_a_panel_of_a_trial_has_a_line_at_the_true_value_and_its_letter_at_the_right(
    quantity: str, letter: str, true_value: float, runs_figure: Figure
) -> None:
    """The true value of assumed accuracies is the accuracy b. For estimates it is the fill ratio f."""
    axes = panel_of(runs_figure, quantity, run=1)
    *_robot_lines, true_line = axes.lines
    height_of_left_end, height_of_right_end = y_values_of(true_line)
    assert height_of_left_end == height_of_right_end == true_value

    (text,) = axes.texts
    right_edge = 1
    assert text.get_text().strip() == f"{letter} = {true_value}"
    assert text.get_position() == (right_edge, true_value)


def test_all_panels_of_trials_have_the_time_axis_of_the_longest_one(runs_figure: Figure) -> None:
    """The two trials have 292 and 200 steps. There are three panels of each."""
    assert [axes.get_xlim() for axes in runs_figure.axes] == [(0, 292)] * 6


@pytest.mark.parametrize(("quantity", "true_value"), [("b_hat", 0.95), ("x_hat", 0.55), ("x", 0.55)])
def test_an_axis_of_recorded_values_has_room_for_all_but_those_of_the_first_moments(
    quantity: str, true_value: float, runs_figure: Figure, recorded_runs: list[Trials]
) -> None:
    """It reaches over the values of both runs and the true one, and a margin of 6 % of their range or 0.01.

    The values of the first moments do not count, as they may be far outside.
    """
    first_run, second_run = recorded_runs
    [values_of_first_run] = first_run.records[quantity]  # of its only trial, by step and robot
    [values_of_second_run] = second_run.records[quantity]
    # A fiftieth of a run's recorded steps are its first moments: 2 of 147, and none of the second run's 7.
    values_after_first_moments = values_of_first_run[2:]
    values = [*values_after_first_moments.ravel(), *values_of_second_run.ravel(), true_value]
    margin = max(0.06 * (max(values) - min(values)), 0.01)
    expected_limits = pytest.approx((min(values) - margin, max(values) + margin))

    assert panel_of(runs_figure, quantity, run=0).get_ylim() == expected_limits
    assert panel_of(runs_figure, quantity, run=1).get_ylim() == expected_limits


def test_assumed_accuracies_are_drawn_as_steps_and_estimates_as_curves(runs_figure: Figure) -> None:
    """An accuracy that a robot assumes changes only when its filter runs."""
    b_hat_line, *_ = panel_of(runs_figure, "b_hat", run=0).lines
    x_hat_line, *_ = panel_of(runs_figure, "x_hat", run=0).lines
    x_line, *_ = panel_of(runs_figure, "x", run=0).lines
    assert b_hat_line.get_drawstyle() == "steps-post"
    assert x_hat_line.get_drawstyle() == "default"
    assert x_line.get_drawstyle() == "default"


def test_the_upper_panel_of_a_trial_has_filter_swarm_and_trial_as_its_title(runs_figure: Figure) -> None:
    """There are three panels of each of two trials. With ASDF+ tau, the filter period, stands there, too."""
    swarm_and_trial = "4 robots, 1 flawed,\nfully-connected, seed 1, trial 0"
    upper_left, upper_right, *other_titles = [axes.get_title("left") for axes in runs_figure.axes]

    assert upper_left == f"no filter: {swarm_and_trial}"
    assert upper_right == f"ASDF+, $\\tau$ = 100: {swarm_and_trial}"
    assert other_titles == ["", "", "", ""]


def test_axes_of_trials_are_named_on_the_left_and_at_the_bottom_and_lines_in_the_legend(
    runs_figure: Figure,
) -> None:
    """There are three rows of panels, in which a left one is followed by a right one."""
    y_labels = [axes.get_ylabel() for axes in runs_figure.axes]
    labels_on_the_left = y_labels[0::2]
    labels_on_the_right = y_labels[1::2]
    assert labels_on_the_left == [
        r"assumed accuracy $\hat{b}$",
        r"local estimate $\hat{x}$",
        "informed estimate $x$",
    ]
    assert labels_on_the_right == ["", "", ""]
    assert [axes.get_xlabel() for axes in runs_figure.axes] == ["", "", "", "", "step", "step"]
    assert legend_of(runs_figure) == ["flawed robots", "healthy robots", "true value"]


def test_a_single_trial_is_drawn_in_three_panels_and_one_that_was_not_run_is_refused(
    recorded_runs: list[Trials],
) -> None:
    """There is only trial 0."""
    run_of_one_trial, _ = recorded_runs
    assert len(plot_series([run_of_one_trial]).axes) == 3
    with pytest.raises(UsageError, match=r"there is no trial 1; choose one of 0 to 0"):
        plot_series([run_of_one_trial], trial=1)
