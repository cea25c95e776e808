"""Pictures over time: errors of swarms, assumed accuracies, and single trials beside their records."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from host_tools.experiments.drawn_figures import (
    GREEN,
    GREY,
    SHORT_EXPERIMENT,
    assert_medians,
    assert_panels,
    band_edges,
    caption_of,
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
    """Run two fill ratios for each of two filters, recorded every 50 of 290 steps."""
    common = replace(SHORT_EXPERIMENT, flawed=2, steps=290, trials=6)
    return {
        name: [results_of(replace(common, filter=name, fill_ratio=f), 50) for f in (0.55, 0.95)]
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


def test_errors_of_experiments_with_one_name_share_a_line(recorded_swarms: dict[str, list[Trials]]) -> None:
    """There are two filters for each of two fill ratios, and ``series_name`` names the fill ratio alone."""
    panels = {"both": [*recorded_swarms["none"], *recorded_swarms["robust"]]}
    figure = plot_errors_over_time(panels, series_name=lambda experiment: f"f = {experiment.fill_ratio}")
    assert len(figure.axes[0].lines) == 2
    assert legend_of(figure) == ["f = 0.55", "f = 0.95"]


def test_errors_have_a_panel_for_each_title(errors_over_time: Figure) -> None:
    assert titles_of(errors_over_time) == ["both", "none", "robust", "one experiment"]
    assert_panels(errors_over_time, rows=2, columns=3, panel_height=1.9)


@pytest.mark.parametrize(("line_index", "filter_name"), [(0, "none"), (1, "robust")])
def test_errors_are_medians_of_the_swarms_means_at_the_recorded_steps(
    line_index: int,
    filter_name: str,
    errors_over_time: Figure,
    recorded_swarms: dict[str, list[Trials]],
) -> None:
    axes = errors_over_time.axes[0]
    robot_axis = 2
    mean_errors = np.concatenate(
        [
            abs(trials.records["x"] - trials.experiment.fill_ratio).mean(robot_axis)
            for trials in recorded_swarms[filter_name]
        ]
    )
    samples = {float(step): errors for step, errors in zip(range(0, 290, 50), mean_errors.T, strict=True)}
    assert_medians(axes.lines[line_index], axes.collections[line_index], samples)


def test_errors_are_drawn_in_the_colours_of_their_filters(errors_over_time: Figure) -> None:
    both, _, robust, _ = visible_axes(errors_over_time)
    assert [line.get_color() for line in both.lines] == [GREY, GREEN]
    assert [line.get_color() for line in robust.lines] == [GREEN]
    assert legend_of(errors_over_time) == ["no filter", "robust"]


def test_errors_have_a_logarithmic_axis_and_a_caption(errors_over_time: Figure) -> None:
    assert {axes.get_yscale() for axes in visible_axes(errors_over_time)} == {"log"}
    assert "bands their 95 % intervals" in caption_of(errors_over_time)


# --- Assumed accuracies ----------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def half_flawed() -> Trials:
    return results_of(replace(SHORT_EXPERIMENT, flawed=2, flawed_accuracy=0.55, filter="asdf-plus"))


@pytest.fixture(scope="module")
def five_bands(half_flawed: Trials) -> Figure:
    return plot_bands([half_flawed] * 5)


def test_lines_are_medians_of_flawed_and_of_healthy_robots(five_bands: Figure, half_flawed: Trials) -> None:
    """Of four robots the first two are flawed; b_hat is by trial, filter step and robot."""
    flawed_line, healthy_line, _ = five_bands.axes[0].lines
    flawed_medians = np.median(half_flawed.b_hat[:, :, :2], axis=(0, 2))
    healthy_medians = np.median(half_flawed.b_hat[:, :, 2:], axis=(0, 2))

    assert (flawed_line.get_color(), healthy_line.get_color()) == (FLAWED, OTHER)
    assert np.asarray(flawed_line.get_xdata()).tolist() == [100, 200, 300]
    assert np.asarray(flawed_line.get_ydata()).tolist() == flawed_medians.tolist()
    assert np.asarray(healthy_line.get_ydata()).tolist() == healthy_medians.tolist()


def test_a_dashed_line_is_the_true_accuracy(five_bands: Figure) -> None:
    true_line = five_bands.axes[0].lines[2]
    assert set(np.asarray(true_line.get_ydata()).tolist()) == {0.95}
    assert (true_line.get_color(), true_line.get_linestyle()) == (INK, "--")


@pytest.mark.parametrize(("filter_step", "step"), [(0, 100), (1, 200), (2, 300)])
def test_bands_hold_the_middle_90_percent_of_all_robots(
    filter_step: int, step: int, five_bands: Figure, half_flawed: Trials
) -> None:
    flawed_band = five_bands.axes[0].collections[0]
    percentiles = np.percentile(half_flawed.b_hat[:, filter_step, :2], [5, 95])
    assert band_edges(flawed_band, step) == pytest.approx(percentiles)


def test_titles_of_bands_have_parameters_and_the_share_of_healthy_robots_that_end_wrong(
    five_bands: Figure, half_flawed: Trials
) -> None:
    """Robots 2 and 3 of four are healthy, with a true accuracy of 0.95; b_hat is by trial, step and robot."""
    b_hat_at_end = half_flawed.b_hat[:, -1, 2:]
    share = np.mean(abs(b_hat_at_end - 0.95) > 0.05)
    parameters = r"$f$ = 0.55, $b$ = 0.95, $\hat{b}$ = 0.55, $P$ = 50%"

    title = titles_of(five_bands)[0].replace("\n", " ")
    assert title == f"{parameters} more than 0.05 off: {share:.0%} of healthy robots"


def test_healthy_robots_count_as_harmed_by_how_far_they_are_from_what_they_assumed_at_first(
    half_flawed: Trials,
) -> None:
    """Healthy robots assume 0.8 at first, and 0.84 in the end, which is not the true 0.95."""
    experiment = replace(half_flawed.experiment, unflawed_accuracy=0.8)
    b_hat = half_flawed.b_hat.copy()
    b_hat[:, -1, 2:] = 0.84
    figure = plot_bands([replace(half_flawed, experiment=experiment, b_hat=b_hat)])

    assert titles_of(figure)[0].endswith("off: 0% of healthy robots")


def test_five_bands_have_a_row_of_three_and_one_of_two(five_bands: Figure) -> None:
    assert [axes.axison for axes in five_bands.axes] == [True] * 5 + [False]
    assert_panels(five_bands, rows=2, columns=3, panel_height=2.1)


def test_four_bands_are_a_square(half_flawed: Trials) -> None:
    assert_panels(plot_bands([half_flawed] * 4), rows=2, columns=2, panel_height=2.1)


def test_a_swarm_without_healthy_robots_has_one_band_and_no_share(half_flawed: Trials) -> None:
    figure = plot_bands([results_of(replace(half_flawed.experiment, flawed=4))])
    assert len(figure.axes[0].collections) == 1
    assert titles_of(figure)[0].endswith("off: -")


def test_bands_of_several_filters_are_ordered_and_named(half_flawed: Trials) -> None:
    unfiltered = results_of(replace(half_flawed.experiment, filter="none"))
    titles = titles_of(plot_bands([half_flawed, unfiltered]))
    assert [title.split("\n")[0] for title in titles] == ["no filter", "ASDF+"]


def test_bands_name_parameters_that_have_an_effect(half_flawed: Trials) -> None:
    unfiltered = results_of(replace(half_flawed.experiment, filter="none"))
    other_period = results_of(replace(half_flawed.experiment, filter_period=150))
    titles = titles_of(plot_bands([unfiltered, half_flawed, other_period]))
    named = [title.split("\n")[1].split(",")[0] for title in titles]

    assert named == ["$f$ = 0.55", "filter period 100", "filter period 150"]


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
    return [results_of(experiment, 2), results_of(replace(experiment, filter="asdf-plus", steps=200), 30)]


@pytest.fixture(scope="module")
def series(recorded_runs: list[Trials]) -> Figure:
    return plot_runs(recorded_runs, 0)


def panel_of(figure: Figure, row: int, column: int) -> Axes:
    """Return a panel of the picture of two runs: rows are quantities, and columns runs."""
    return figure.axes[2 * row + column]


@pytest.mark.parametrize("run", [0, 1])
@pytest.mark.parametrize(("row", "quantity"), [(0, "b_hat"), (1, "x_hat"), (2, "x")])
def test_series_show_the_records_of_every_robot(
    row: int, quantity: str, run: int, series: Figure, recorded_runs: list[Trials]
) -> None:
    lines = panel_of(series, row, run).lines
    drawn = np.array([line.get_ydata() for line in lines[:4]])
    last_robot_first = recorded_runs[run].records[quantity][0].T[::-1]

    assert drawn.tolist() == last_robot_first.tolist()
    assert np.asarray(lines[0].get_xdata()).tolist() == [
        *(range(0, 293, 2) if run == 0 else range(0, 200, 30))
    ]


def test_flawed_robots_lie_on_top_of_healthy_ones(series: Figure) -> None:
    """In each panel: three healthy robots, one flawed one, and the true value.

    What is drawn later lies on top.
    """
    for axes in series.axes:
        assert [line.get_color() for line in axes.lines] == [OTHER] * 3 + [FLAWED, INK]


@pytest.mark.parametrize(("row", "text"), [(0, "b = 0.95"), (1, "f = 0.55"), (2, "f = 0.55")])
def test_series_show_the_true_value_with_its_letter(row: int, text: str, series: Figure) -> None:
    axes = panel_of(series, row, 1)
    true_value = float(text.split(" = ")[1])

    assert np.asarray(axes.lines[4].get_ydata()).tolist() == [true_value] * 2
    assert axes.texts[0].get_text().strip() == text
    assert axes.texts[0].get_position() == (1, true_value)


def test_series_have_the_time_axis_of_the_longest_run(series: Figure) -> None:
    assert {axes.get_xlim() for axes in series.axes} == {(0, 292)}


@pytest.mark.parametrize(
    ("row", "quantity", "truth"), [(0, "b_hat", 0.95), (1, "x_hat", 0.55), (2, "x", 0.55)]
)
def test_series_have_room_for_all_but_the_first_moments(
    row: int, quantity: str, truth: float, series: Figure, recorded_runs: list[Trials]
) -> None:
    """An axis holds all values and the true one, with a margin; the first moments may be far outside."""
    first_moments = 2  # a fiftieth of the first run's 147 samples; the second run has too few
    first, second = (trials.records[quantity][0] for trials in recorded_runs)
    values = np.concatenate([first[first_moments:], second, [[truth] * 4]])
    margin = max(0.06 * np.ptp(values), 0.01)
    limits = pytest.approx((values.min() - margin, values.max() + margin))

    assert [panel_of(series, row, run).get_ylim() for run in (0, 1)] == [limits, limits]


def test_assumed_accuracies_are_drawn_in_steps(series: Figure) -> None:
    styles = [panel_of(series, row, 0).lines[0].get_drawstyle() for row in range(3)]
    assert styles == ["steps-post", "default", "default"]


def test_titles_of_series_name_filter_swarm_and_trial(series: Figure) -> None:
    swarm = "4 robots, 1 flawed,\nfully-connected, seed 1, trial 0"
    titles = [axes.get_title("left") for axes in series.axes]
    assert titles == [f"no filter: {swarm}", f"ASDF+, $\\tau$ = 100: {swarm}", "", "", "", ""]


def test_axes_of_series_are_named_on_the_left_and_at_the_bottom(series: Figure) -> None:
    y_labels = [axes.get_ylabel().split(" $")[0] for axes in series.axes]
    assert y_labels == ["assumed accuracy", "", "local estimate", "", "informed estimate", ""]
    assert [axes.get_xlabel() for axes in series.axes] == ["", "", "", "", "step", "step"]


def test_the_legend_of_series_tells_robots_apart(series: Figure) -> None:
    assert legend_of(series) == ["flawed robots", "healthy robots", "true value"]


def test_a_single_run_can_be_drawn(recorded_runs: list[Trials]) -> None:
    assert len(plot_series(recorded_runs[:1]).axes) == 3


def test_a_trial_that_was_not_run_cannot_be_drawn(recorded_runs: list[Trials]) -> None:
    with pytest.raises(UsageError, match=r"there is no trial 1; choose one of 0 \.\. 0"):
        plot_series(recorded_runs[:1], trial=1)
