"""Swarms of 20 to 10,000 robots at one density: score, error and cost of a robot's step.

``python -m mcp_asdf_tools.studies.swarm_sizes FOLDER`` writes ``scale.md`` and ``scale.png``, which no
page shows. The costs are measured on this machine each time.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from time import process_time

import numpy as np
from matplotlib.figure import Figure

import mcp_asdf_tools as m
from mcp_asdf_tools.common.figures import WIDTH, empty_figure, save_figure
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.results import Trials
from mcp_asdf_tools.experiments.trials import run_trials
from mcp_asdf_tools.studies.bootstrap import Sample
from mcp_asdf_tools.studies.study_program import (
    MOVING_SWARM,
    PARAMETERS_BY_FLAW,
    Measure,
    Rows,
    late_error_text,
    late_errors,
    markdown_table,
    mean_over_experiments,
    parse_arguments,
    run_rows,
    score_text,
    write_tables,
)

TRIALS_BY_SIZE = {20: 12, 100: 12, 300: 12, 1000: 12, 3000: 3, 10_000: 3}
"""Trials by the number of robots: a few trials of many robots show as much as many of a few."""

TIMED_ROBOT_STEPS = 1_000_000
FEWEST_TIMED_STEPS = 100

TABLE_HEAD = "H, error of the last quarter, ns of processor time for each robot and step"


def size_rows() -> dict[str, list[Experiment]]:
    """Return the experiments of each row of the table by its label, such as "20 robots, underconfident".

    A row has moving swarms of one of six sizes, without a filter and with the robust one. 30 % of the robots
    are flawed.
    """
    rows: dict[str, list[Experiment]] = {}
    for flaw, flaw_parameters in PARAMETERS_BY_FLAW.items():
        for robots, trials in TRIALS_BY_SIZE.items():
            rows[f"{robots:,} robots, {flaw}"] = m.grid(
                **MOVING_SWARM,
                **flaw_parameters,
                robots=robots,
                flawed="30%",
                filter=["none", "robust"],
                steps=10_000,
                trials=trials,
                seed=65536,  # which no tuning has seen
            )
    return rows


@cache
def processor_seconds(experiment: Experiment) -> float:
    """Return the processor time of one trial on this machine in seconds, the shortest of three measurements.

    The trial runs four times: the first one, which also loads what trials need, is not measured. For equal
    experiments this is done once.
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

    It is the difference of two trials, one with twice as many steps, divided by steps and robots. The result
    is a sample with the same number for each trial, as tables and curves take samples.
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


def size_text(experiments: Sequence[Trials]) -> str:
    """Format H, late error and processor time of experiments that share a cell: "95.1, 0.012, 250".

    H is the paper's score from 0 to 100, and the late error the mean of |x - f| over the last quarter of a
    trial: of the estimates x of f, the share of black floor. The processor time is that of ``step_cost``.
    """
    cost = mean_over_experiments(step_cost, experiments).value
    return f"{score_text(experiments)}, {late_error_text(experiments)}, {cost:.0f}"


def draw_sizes(rows: Rows) -> Figure:
    """Draw H, late error and processor time over the number of robots, a curve for each filter.

    ``rows`` has the results of the trials, as lists by a row's label. The first row of panels has the swarms
    with underconfident robots, the second one those with overconfident ones. The columns have the score H
    from 0 to 100, the error in the last quarter of a trial, and the nanoseconds of a robot's step, which are
    measured while this function runs.
    """
    experiments = [trials for experiments_of_row in rows.values() for trials in experiments_of_row]
    figure = empty_figure(WIDTH, 4.8)
    rows_of_axes = figure.subplots(nrows=len(PARAMETERS_BY_FLAW), ncols=3)
    measures: tuple[str | Measure, ...] = ("H", late_errors, step_cost)
    for (flaw, flaw_parameters), axes_of_row in zip(PARAMETERS_BY_FLAW.items(), rows_of_axes, strict=True):
        for axes, measure in zip(axes_of_row, measures, strict=True):
            m.plot_curve(experiments, "robots", measure, hue="filter", where=flaw_parameters, ax=axes)
            # Sizes go from 20 to 10,000 robots.
            axes.set(xscale="log", title=flaw)
        score_axes, error_axes, cost_axes = axes_of_row
        score_axes.set(ylabel="score H", ylim=(0, 100))
        # Errors of the filters differ by more than a factor of ten.
        error_axes.set(ylabel="error of the last quarter", yscale="log")
        cost_axes.set(ylabel="ns, robot and step", ylim=(0, None))
    return figure


def main() -> None:
    """Run experiments of growing swarms, or resume them, and write scale.md and scale.png into the folder.

    ``size_rows`` lists the experiments; the folder is an argument of the command line.
    """
    arguments = parse_arguments(__doc__)
    rows = run_rows("scale", size_rows(), arguments)
    tables = {"scale": markdown_table(TABLE_HEAD, rows, size_text)}
    write_tables(arguments.folder / "scale.md", "Many robots", tables)
    save_figure(draw_sizes(rows), arguments.folder / "scale.png")


if __name__ == "__main__":
    main()
