"""Rules from related work beside the project's filters: resilient consensus, and a vote on one colour.

``python -m mcp_asdf_tools.studies.related_work FOLDER`` writes ``related_work.md`` and ``related_work.png``
for docs/internals/related_work.md.

Each robot estimates f, the share of black floor, as x. b is the accuracy of its sensor, and b_hat the one
that it assumes; a flawed robot starts with a wrong b_hat. Liars say that no tile is black, and are not
counted in any number.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from matplotlib.figure import Figure

import mcp_asdf_tools as m
from mcp_asdf_tools.common.figures import save_figure
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.results import Trials
from mcp_asdf_tools.studies.bootstrap import Sample, resample_mean
from mcp_asdf_tools.studies.peers import (
    MajorityRobot,
    TrimmedMeanRobot,
    WmsrRobot,
    five_liars,
    majority_robots_and_five_liars,
    trimmed_mean_robots_and_five_liars,
    wmsr_robots_and_five_liars,
)
from mcp_asdf_tools.studies.robust_filter import without_liars
from mcp_asdf_tools.studies.study_program import (
    MOVING_SWARM,
    PARAMETERS_BY_FLAW,
    PLAIN_NOTE,
    Rows,
    format_tenths,
    late_estimates,
    markdown_table,
    mean_over_experiments,
    parse_arguments,
    plain_error_text,
    plot_errors_of_swarms,
    run_rows,
    write_tables,
)

EARLY_HEAD = "error of the first quarter"
LATE_HEAD = "error of the last quarter"
COLOUR_HEAD = "robots that name the right colour, in percent"

DRAWN_SWARMS = ("fully connected, 5 liars", "moving, 5 liars", "moving, 6 flawed")

DENSE_SWARM: dict[str, Any] = {**MOVING_SWARM, "density": 12.0}
"""Parameters of moving swarms whose robots receive from about twelve others at a time."""


def resilience_rows() -> dict[str, list[Experiment]]:
    """Return swarms with liars, or with flawed robots, for the rules that remove extreme estimates."""
    liars = _with_liars([wmsr_robots_and_five_liars, trimmed_mean_robots_and_five_liars])
    flawed = _with_flawed_robots([WmsrRobot, TrimmedMeanRobot])
    swarms: dict[str, dict[str, Any]] = {
        "fully connected, 5 liars": liars,
        "moving, dense, 5 liars": {**DENSE_SWARM, **liars},
        "moving, 5 liars": {**MOVING_SWARM, **liars},
        "fully connected, 6 flawed": flawed,
        "moving, 6 flawed": {**MOVING_SWARM, **flawed},
    }
    return _rows_of_swarms(swarms, steps=4000)


def colour_rows() -> dict[str, list[Experiment]]:
    """Return moving swarms for the question which colour prevails; the answer is black."""
    swarms: dict[str, dict[str, Any]] = {
        "moving, 6 flawed": {**MOVING_SWARM, **_with_flawed_robots([MajorityRobot])},
        "moving, 5 liars": {**MOVING_SWARM, **_with_liars([majority_robots_and_five_liars])},
    }
    return _rows_of_swarms(swarms, steps=10_000)


def _with_liars(firmwares: list[Any]) -> dict[str, Any]:
    """Return parameters of swarms with five liars and without flawed robots.

    All robots of a swarm have one of the given firmwares, whose rules need no filter, or the project's own
    firmware, without a filter and with the robust one.
    """
    # The experiments have the parameters of either table; its key in the result may be any name.
    own_robots = {"firmware": five_liars, "filter": ["none", "robust"]}
    compared_robots = {"firmware": firmwares, "filter": "none"}
    return {"flawed": 0, "robots_and_filters": [own_robots, compared_robots]}


def _with_flawed_robots(firmwares: list[Any]) -> dict[str, Any]:
    """Return parameters of swarms of which 30 % are flawed, and none lies.

    All robots of a swarm have one of the given firmwares, whose rules need no filter, or the project's own
    firmware, without a filter, with ASDF- and with the robust filter.
    """
    # The experiments have the parameters of either table; its key in the result may be any name.
    own_robots = {"filter": ["none", "asdf-minus", "robust"]}
    compared_robots = {"firmware": firmwares, "filter": "none"}
    return {"flawed": "30%", "robots_and_filters": [own_robots, compared_robots]}


def _rows_of_swarms(swarms: dict[str, dict[str, Any]], steps: int) -> dict[str, list[Experiment]]:
    """Return the experiments of each swarm, with both kinds of flaws, by labels that end in that kind."""
    rows: dict[str, list[Experiment]] = {}
    for label, swarm in swarms.items():
        for flaw, flaw_parameters in PARAMETERS_BY_FLAW.items():
            rows[f"{label}, {flaw}"] = m.grid(
                **swarm,
                **flaw_parameters,
                steps=steps,
                trials=6,
                seed=4714,  # which no tuning has seen
            )
    return rows


def early_errors(trials: Trials) -> Sample:
    """Return the mean of |x - f| of each trial over its first quarter and over its robots.

    x is a robot's recorded estimate, f the share of black floor. Step 0, before all readings, is left out.
    """
    x = trials.records["x"]  # shape (trials, recorded steps, robots)
    recorded_steps = x.shape[1] - 1  # without step 0
    quarter_length = max(1, recorded_steps // 4)
    early_x = x[:, 1 : 1 + quarter_length, :]
    errors: Sample = abs(early_x - trials.experiment.fill_ratio).mean(axis=(1, 2))  # over steps and robots
    return errors


def early_error_text(experiments: Sequence[Trials]) -> str:
    """Format the early error of experiments that share a cell of a table, such as "0.012"."""
    return plain_error_text(experiments, early_errors)


def right_percents(trials: Trials) -> Sample:
    """Return for each trial the percentage of answers that are right in its last quarter.

    A robot answers that black prevails if its recorded estimate x is above 1/2; that is right if f is, too.
    """
    answers_black = late_estimates(trials) > 0.5  # shape (trials, recorded steps, robots)
    is_mostly_black = trials.experiment.fill_ratio > 0.5
    is_right = answers_black == is_mostly_black
    percents: Sample = 100 * is_right.mean(axis=(1, 2))  # over recorded steps and robots
    return percents


def right_text(experiments: Sequence[Trials]) -> str:
    """Format the percentage of right answers of experiments that share a cell, such as "98.1"."""
    right_percent = mean_over_experiments(right_percents, experiments, resample_mean)
    return format_tenths(right_percent.value)


def draw_errors(rows: Rows) -> Figure:
    """Draw the error of the estimates over time in DRAWN_SWARMS: a line for each filter or rule."""
    return plot_errors_of_swarms(rows, DRAWN_SWARMS)


def main() -> None:
    """Run the experiments, or resume them, and write related_work.md and related_work.png into the folder."""
    arguments = parse_arguments(__doc__)
    all_resilience = run_rows("related_resilience", resilience_rows(), arguments, record=100)
    all_colour = run_rows("related_colour", colour_rows(), arguments, record=500)
    resilience = without_liars(all_resilience)
    tables = {
        "early": markdown_table(EARLY_HEAD, resilience, early_error_text),
        "late": markdown_table(LATE_HEAD, resilience, plain_error_text),
        "colour": markdown_table(COLOUR_HEAD, without_liars(all_colour), right_text),
    }
    write_tables(arguments.folder / "related_work.md", "Related work", tables, PLAIN_NOTE)
    save_figure(draw_errors(resilience), arguments.folder / "related_work.png")


if __name__ == "__main__":
    main()
