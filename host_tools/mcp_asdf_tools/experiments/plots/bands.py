"""Accuracies that all robots of all trials assume, over time."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.common.figures import INK, SMALL
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.plot_labels import (
    ALWAYS_SHOWN_PARAMETERS,
    filter_name,
    flawed_share,
    has_effect,
    make_caption,
    parameter_with_value,
    sorted_by_filter,
    varying_parameters,
)
from mcp_asdf_tools.experiments.plot_panels import (
    COLOUR_OF_FLAWED_ROBOTS,
    COLOUR_OF_HEALTHY_ROBOTS,
    Results,
    create_panels,
    draw_band,
    experiments_to_plot,
    label_figure,
    legend_handle,
)
from mcp_asdf_tools.experiments.results import HARM_LIMIT, Trials
from mcp_asdf_tools.experiments.scores import PAPER_LIMITS

_MEDIAN_AND_BAND_PERCENTILES = (50, 5, 95)
"""Percentiles of the line, the lower and the upper edge of a band."""

_TRIAL_AXIS, _ROBOT_AXIS = 0, 2
"""Axes of ``Trials.b_hat``, whose shape is (trials, filter steps, robots)."""

_MEANING_OF_MARKS = "lines are medians over robots and trials, bands the middle 90 %"

_LEGEND = {"flawed": COLOUR_OF_FLAWED_ROBOTS, "healthy": COLOUR_OF_HEALTHY_ROBOTS, "true": INK}
"""Colours of the lines in a panel, by their labels in the legend."""

_TITLE_WIDTH = 56
"""Characters in a line of a title. Those of formulas, which are drawn shorter, count in full."""


def plot_bands(results: Results, *, where: Mapping[str, Any] | None = None) -> Figure:
    """Plot b_hat over time: its median over all robots and trials, and a band with the middle 90 %.

    b_hat is the accuracy that a robot assumes of its sensor; it is drawn after each filter step. Each
    experiment has a panel, and panels are in the order of their filters. A title ends with the share of
    healthy robots that their filter has harmed: whose b_hat ends more than HARM_LIMIT from its first value.
    ``where`` chooses experiments by their parameters. Raises UsageError if no experiment is left, if there
    are more panels than fit a picture, and for trials that are too short for a filter step.
    """
    experiments = sorted_by_filter(experiments_to_plot(results, where))
    if any(trials.experiment.steps < trials.experiment.filter_period for trials in experiments):
        raise UsageError("these trials have no filter step; run more steps, or a shorter filter_period")
    max_columns = 2 if len(experiments) == 4 else 3  # four make a square
    figure, panels = create_panels(len(experiments), panel_height=2.1, max_columns=max_columns)
    for axes, trials, title in zip(panels, experiments, _panel_titles(experiments), strict=True):
        _draw_accuracy_bands(axes, trials)
        axes.set_title(title, fontsize=SMALL)
    caption = make_caption(experiments, _MEANING_OF_MARKS, PAPER_LIMITS)
    handles = [legend_handle(label, colour, marker="", line="-") for label, colour in _LEGEND.items()]
    return label_figure(figure, "step", r"assumed accuracy $\hat{b}$", caption, handles)


def _panel_titles(experiments: Sequence[Trials]) -> list[str]:
    """Return a title for each experiment: the parameters in which experiments differ, then f, b, b_hat and P.

    These letters are the paper's: f is the share of black tiles, b the true accuracy of a sensor, b_hat the
    accuracy that flawed robots assume at first, and P the share of flawed robots. f, b, b_hat and P, which
    every title has, are not named among the differences, too. If experiments have different filters, a title
    begins with a line that names the filter; the last line is the share of harmed robots.
    """
    varying_names = varying_parameters(experiments, excluded=ALWAYS_SHOWN_PARAMETERS)
    has_several_filters = len({trials.experiment.filter for trials in experiments}) > 1
    titles = []
    for trials in experiments:
        lines = _title_lines(trials.experiment, varying_names)
        if has_several_filters:
            lines.insert(0, filter_name(trials.experiment))
        lines.append(_describe_harmed(trials))
        titles.append("\n".join(lines))
    return titles


def _title_lines(experiment: Experiment, varying_names: Sequence[str]) -> list[str]:
    """Return the varying parameters that have an effect in the experiment, then f, b, b_hat and P.

    The text is wrapped into lines of up to _TITLE_WIDTH characters. Symbols are formulas as matplotlib draws
    them, such as "$f$ = 0.55".
    """
    values = [
        parameter_with_value(parameter_name, experiment.parameters()[parameter_name])
        for parameter_name in varying_names
        if has_effect(experiment, parameter_name)
    ]
    values.append(f"$f$ = {experiment.fill_ratio:g}")
    values.append(f"$b$ = {experiment.true_accuracy:g}")
    values.append(rf"$\hat{{b}}$ = {experiment.flawed_accuracy:g}")
    values.append(f"$P$ = {flawed_share(experiment):.0%}")
    # A symbol and its value stay on one line.
    title_text = ", ".join(values).replace(" = ", "\N{NO-BREAK SPACE}=\N{NO-BREAK SPACE}")
    return textwrap.wrap(title_text, _TITLE_WIDTH)


def _draw_accuracy_bands(axes: Axes, trials: Trials) -> None:
    """Draw the median and the middle 90 % of b_hat over time, and the true accuracy as a dashed line.

    Flawed and healthy robots have a band each, over all trials and all robots of that kind; a kind without
    robots has none.
    """
    experiment = trials.experiment
    flawed, healthy = np.split(trials.b_hat, [experiment.flawed], axis=_ROBOT_AXIS)  # the flawed come first
    _trials, filter_step_count, _robots = trials.b_hat.shape
    # The first filter step is at step filter_period, not at step 0.
    steps = experiment.filter_period * np.arange(1, filter_step_count + 1)
    for colour, b_hat in ((COLOUR_OF_FLAWED_ROBOTS, flawed), (COLOUR_OF_HEALTHY_ROBOTS, healthy)):
        if b_hat.size:
            band = np.percentile(b_hat, _MEDIAN_AND_BAND_PERCENTILES, axis=(_TRIAL_AXIS, _ROBOT_AXIS))
            draw_band(axes, steps, band, colour)
    axes.axhline(experiment.true_accuracy, color=INK, linewidth=1.2, linestyle="--")


def _describe_harmed(trials: Trials) -> str:
    """Return a line for a title such as "more than 0.05 off: 12% of healthy robots".

    That is the share of the healthy robots of all trials that their filter has harmed. It is "-" if there are
    no healthy robots.
    """
    is_harmed = trials.find_harmed_robots()
    share = f"{is_harmed.mean():.0%} of healthy robots" if is_harmed.size else "-"
    return f"more than {HARM_LIMIT} off: {share}"
