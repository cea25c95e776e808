"""Swarms of 20 to 10,000 robots at one density: score, error and cost of a robot's step.

``python -m mcp_asdf_tools.studies.swarm_sizes FOLDER`` writes ``scale.md`` and ``scale.png`` for
docs/robust.md. The costs are measured on this machine each time.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from time import process_time

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import mcp_asdf_tools as m
from mcp_asdf_tools.common.figures import WIDTH, empty_figure, save_figure
from mcp_asdf_tools.experiments.curve_plot import plot_curve
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.results import Trials
from mcp_asdf_tools.experiments.trials import run_trials
from mcp_asdf_tools.studies.bootstrap import Sample
from mcp_asdf_tools.studies.error_tables import (
    Measure,
    is_overconfident,
    late_error_text,
    late_errors,
    markdown_table,
    mean_of_medians,
    parse_arguments,
    run_experiments,
    score_text,
    write_tables,
)
from mcp_asdf_tools.studies.peers import column_label

TIMED_ROBOT_STEPS = 1_000_000
FEWEST_TIMED_STEPS = 100


@cache
def processor_seconds(experiment: Experiment) -> float:
    """Return the processor time of one trial on this machine in seconds, the shortest of three measurements.

    The trial runs four times: the first one, which also loads what trials need, is not measured.
    """
    run_trials(experiment, first=0, trials=1)
    measurements = []
    for _ in range(3):
        start = process_time()
        run_trials(experiment, first=0, trials=1)
        measurements.append(process_time() - start)
    return min(measurements)


def step_cost(trials: Trials) -> Sample:
    """Return the processor time of one step of one robot, in ns, measured on this machine now.

    The result is a sample with the same number for each trial, as tables and curves take samples.
    """
    robots = trials.experiment.robots
    # Small swarms take more steps, so that every measurement is long enough for the clock.
    steps = max(FEWEST_TIMED_STEPS, TIMED_ROBOT_STEPS // robots)
    short_trial = replace(trials.experiment, steps=steps)
    long_trial = replace(trials.experiment, steps=2 * steps)
    # The difference of two trials leaves out what each costs before its first step.
    seconds = processor_seconds(long_trial) - processor_seconds(short_trial)
    nanoseconds_per_robot_step = 1e9 * seconds / steps / robots
    return np.full(len(trials.numbers), nanoseconds_per_robot_step)


def row_label(experiment: Experiment) -> str:
    """Return the row label of an experiment, such as "1,000 robots, overconfident"."""
    return f"{experiment.robots:,} robots, {confidence_label(experiment)}"


def confidence_label(experiment: Experiment) -> str:
    """Return whether flawed robots assume a too high or a too low sensor accuracy, as a word for labels.

    The words are "overconfident" and "underconfident".
    """
    return "overconfident" if is_overconfident(experiment) else "underconfident"


def size_table(experiments: Sequence[Trials]) -> str:
    """Return a Markdown table of H, late error and processor time: a column for each filter.

    It has a row for each number of robots and kind of flaw. H is the paper's score from 0 to 100, and the
    late error the mean of |x - f| over the last quarter of a trial: of the estimates x of f, the share of
    black floor.
    """

    def cell_text(group: Sequence[Trials]) -> str:
        """Format the three numbers of experiments that share a cell, such as "95.1, 0.012, 250"."""
        cost = mean_of_medians(step_cost, group).value
        return f"{score_text(group)}, {late_error_text(group)}, {cost:.0f}"

    head = "H, error of the last quarter, ns of processor time for each robot and step"
    return markdown_table(head, experiments, row_label, column_label, cell_text)


def draw_sizes(experiments: Sequence[Trials]) -> Figure:
    """Draw H, late error and processor time over the number of robots, a curve for each filter.

    The first row of panels has the underconfident swarms, the second one the overconfident ones. H and late
    error are as in ``size_table``; the processor time is measured while this function runs.
    """
    figure = empty_figure(WIDTH, 4.8)
    rows_of_axes = figure.subplots(nrows=2, ncols=3)
    for axes_of_row, label in zip(rows_of_axes, ("underconfident", "overconfident"), strict=True):
        group = [trials for trials in experiments if confidence_label(trials.experiment) == label]
        score_axes, error_axes, cost_axes = axes_of_row
        _draw_curve(score_axes, group, "H", label)
        score_axes.set(ylabel="score H", ylim=(0, 100))
        # Errors of the filters differ by more than a factor of ten.
        _draw_curve(error_axes, group, late_errors, label)
        error_axes.set(ylabel="error of the last quarter", yscale="log")
        _draw_curve(cost_axes, group, step_cost, label)
        cost_axes.set(ylabel="ns, robot and step", ylim=(0, None))
    return figure


def _draw_curve(axes: Axes, experiments: Sequence[Trials], measure: str | Measure, title: str) -> None:
    """Draw a measure over the number of robots, on a logarithmic scale, with a curve for each filter.

    ``measure`` is the name of a score, or a function that returns a value for each trial.
    """
    plot_curve(experiments, "robots", "filter", measure, ax=axes)
    axes.set(xscale="log", title=title)


def main() -> None:
    """Run the study's experiments, or resume them, and write scale.md and scale.png into the folder."""
    arguments = parse_arguments(__doc__)
    experiments = run_experiments("scale", m.read_experiments("scale"), arguments)
    write_tables(arguments.folder / "scale.md", "Many robots", {"scale": size_table(experiments)})
    save_figure(draw_sizes(experiments), arguments.folder / "scale.png")


if __name__ == "__main__":
    main()
