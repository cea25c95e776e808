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

import numpy as np

from mcp_asdf_tools.common.figures import save_figure
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.results import Trials
from mcp_asdf_tools.studies.peers import (
    MajorityRobot,
    TrimmedMeanRobot,
    WmsrRobot,
    five_liars,
    majority_robots_and_five_liars,
    trimmed_mean_robots_and_five_liars,
    wmsr_robots_and_five_liars,
)
from mcp_asdf_tools.studies.study_program import (
    LATE_ERROR_HEAD,
    MOVING_SWARM,
    last_quarter,
    late_error_text,
    markdown_table,
    parse_arguments,
    plot_errors_of_swarms,
    rows_of_swarms,
    run_rows,
    write_tables,
)

SEED = 4714
"""Seed of all experiments, which no tuning has seen."""

COLOUR_HEAD = "robots that name the right colour, in percent"

DRAWN_SWARMS = ("fully connected, 5 liars", "moving, 5 liars", "moving, 6 flawed")


def resilience_rows() -> dict[str, list[Experiment]]:
    """Return swarms with liars, or with flawed robots, for the rules that remove extreme estimates."""
    liars = _with_liars([wmsr_robots_and_five_liars, trimmed_mean_robots_and_five_liars])
    flawed = _with_flawed_robots([WmsrRobot, TrimmedMeanRobot])
    swarms: dict[str, dict[str, Any]] = {
        "fully connected, 5 liars": liars,
        "moving, 5 liars": {**MOVING_SWARM, **liars},
        "fully connected, 6 flawed": flawed,
        "moving, 6 flawed": {**MOVING_SWARM, **flawed},
    }
    return rows_of_swarms(swarms, steps=4000, trials=6, seed=SEED)


def colour_rows() -> dict[str, list[Experiment]]:
    """Return moving swarms for the question which colour prevails; the answer is black."""
    swarms: dict[str, dict[str, Any]] = {
        "moving, 6 flawed": {**MOVING_SWARM, **_with_flawed_robots([MajorityRobot])},
        "moving, 5 liars": {**MOVING_SWARM, **_with_liars([majority_robots_and_five_liars])},
    }
    return rows_of_swarms(swarms, steps=10_000, trials=6, seed=SEED)


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


def right_text(experiments: Sequence[Trials]) -> str:
    """Format the percentage of answers that are right in the last quarter of a trial, such as "98.1".

    A robot answers that black prevails if its recorded estimate x is above 1/2; that is right if f is, too.
    The percentage is the mean over robots, trials, and the experiments that share a cell.
    """
    right_shares: list[float] = []
    for trials in experiments:
        answers_black = last_quarter(trials.records["x"]) > 0.5  # shape (trials, recorded steps, robots)
        is_mostly_black = trials.experiment.fill_ratio > 0.5
        right_shares.append(np.mean(answers_black == is_mostly_black))
    return f"{100 * np.mean(right_shares):.1f}"


def main() -> None:
    """Run the experiments, or resume them, and write related_work.md and related_work.png into the folder."""
    arguments = parse_arguments(__doc__)
    resilience = run_rows("related_resilience", resilience_rows(), arguments, record=100)
    colour = run_rows("related_colour", colour_rows(), arguments, record=500)
    tables = {
        "late": markdown_table(LATE_ERROR_HEAD, resilience, late_error_text),
        "colour": markdown_table(COLOUR_HEAD, colour, right_text),
    }
    write_tables(arguments.folder / "related_work.md", "Related work", tables)
    save_figure(plot_errors_of_swarms(resilience, DRAWN_SWARMS), arguments.folder / "related_work.png")


if __name__ == "__main__":
    main()
