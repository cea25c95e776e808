"""Self-calibration by two readings of each tile, and where it fails: the error at the end, and over time.

``python -m mcp_asdf_tools.studies.two_readings FOLDER`` writes ``two_readings.md`` and ``two_readings.png``
for docs/internals/two_readings.md.

Each robot estimates f, the share of black floor, as x. b is the accuracy of its sensor, and b_hat the one
that it assumes; a flawed robot starts with a wrong b_hat. All robots broadcast once for each tile.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from mcp_asdf_tools.common.figures import save_figure
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.results import Trials
from mcp_asdf_tools.studies.reading_pairs import (
    READINGS_OF_TILE,
    HalfRepeated,
    IndependentReadings,
    TenthRepeated,
    TwoReadingsRobot,
)
from mcp_asdf_tools.studies.study_program import (
    LATE_ERROR_HEAD,
    MOVING_SWARM,
    late_error_text,
    markdown_table,
    parse_arguments,
    plot_errors_of_swarms,
    rows_of_swarms,
    run_rows,
    write_tables,
)

HARM_HEAD = "healthy robots harmed, in percent"

SWARMS: dict[str, dict[str, Any]] = {
    "none flawed": {"flawed": "0%", "sensor": IndependentReadings},
    "half flawed": {"flawed": "50%", "sensor": IndependentReadings},
    "all flawed": {"flawed": "100%", "sensor": IndependentReadings},
    "none flawed, tenth repeated": {"flawed": "0%", "sensor": TenthRepeated},
    "none flawed, half repeated": {"flawed": "0%", "sensor": HalfRepeated},
}
"""Shares of flawed robots, and of second readings that are the first once more, by the labels of rows."""

DRAWN_SWARMS = ("half flawed", "all flawed", "none flawed, half repeated")


def two_readings_rows() -> dict[str, list[Experiment]]:
    """Return the experiments of each row by its label: SWARMS with one kind of flawed robots.

    In each row, robots with two readings stand beside robots with the usual filters, which read each tile
    once.
    """
    robots_and_filters: list[dict[str, Any]] = [
        # The usual filters use one of the readings of a tile, as they observe in every second step.
        {"filter": ["none", "asdf-minus", "robust"], "observation_period": READINGS_OF_TILE},
        {"firmware": TwoReadingsRobot, "filter": "robust"},
    ]
    return rows_of_swarms(
        SWARMS,
        **MOVING_SWARM,
        robots_and_filters=robots_and_filters,
        # A step is a reading here. So all times, which count steps, are multiplied by the readings of a tile.
        comms_period=READINGS_OF_TILE,
        filter_period=READINGS_OF_TILE * 1000,
        steps=READINGS_OF_TILE * 10_000,
        trials=6,
        seed=4715,  # which no tuning has seen
    )


def harm_text(experiments: Sequence[Trials]) -> str:
    """Format the percentage of healthy robots that a filter harmed, such as "12.5"; empty if all are flawed.

    A robot is harmed if its b_hat ends far from where it began. The percentage is the mean over all trials.
    """
    is_harmed = np.concatenate([trials.find_harmed_robots() for trials in experiments])
    # The shape is (trials, healthy robots), so it is empty if no robot is healthy.
    return f"{100 * is_harmed.mean():.1f}" if is_harmed.size else ""


def main() -> None:
    """Run the experiments, or resume them, and write two_readings.md and two_readings.png into the folder."""
    arguments = parse_arguments(__doc__)
    rows = run_rows("two_readings", two_readings_rows(), arguments, record=500)
    tables = {
        "errors": markdown_table(LATE_ERROR_HEAD, rows, late_error_text),
        "harm": markdown_table(HARM_HEAD, rows, harm_text),
    }
    write_tables(arguments.folder / "two_readings.md", "Two readings of a tile", tables)
    save_figure(plot_errors_of_swarms(rows, DRAWN_SWARMS), arguments.folder / "two_readings.png")


if __name__ == "__main__":
    main()
