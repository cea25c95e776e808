"""Sensors that age, which the paper leaves open: the error at the end, and over time.

``python -m mcp_asdf_tools.studies.ageing FOLDER`` writes ``ageing.md`` and ``ageing.png``, which are for
docs/internals/ageing.md.

Each robot estimates f, the share of black floor, as x. Its late error is the mean of |x - f| over the last
quarter of a trial. b is the accuracy of a robot's sensor, which ageing changes, and b_hat the accuracy that
the robot assumes.
"""

from __future__ import annotations

from typing import Any

from matplotlib.figure import Figure

import mcp_asdf_tools as m
from mcp_asdf_tools.common.figures import save_figure
from mcp_asdf_tools.experiments.error_plot import plot_errors_over_time
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.studies.ageing_sensors import (
    DRIFT_RATE,
    SuddenlyWorseSensors,
    UnequallyAgeingSensors,
    WanderingSensors,
)
from mcp_asdf_tools.studies.peers import (
    DriftingBayesCpfRobot,
    KnownAccuracyRobot,
    KnownMeanAccuracyRobot,
    WanderingBayesCpfRobot,
    column_label,
)
from mcp_asdf_tools.studies.study_program import (
    ALL_FILTERS,
    FILTERS_OF_HEALTHY_SWARMS,
    LATE_ERROR_HEAD,
    MOVING_SWARM,
    Rows,
    late_error_text,
    markdown_table,
    parse_arguments,
    run_rows,
    write_tables,
)

LONGEST_MEMORY = ", longest memory"
MEMORIES = {LONGEST_MEMORY: 2**31, ", short memory": 4096}
"""Values of ``Experiment.memory``: at so many observations a robot halves its counts, to forget old ones."""

HEALTHY_SWARM: dict[str, Any] = {"flawed": "0%", "filter": FILTERS_OF_HEALTHY_SWARMS}
STEADY_DRIFT: dict[str, Any] = {"drift": "linear", "drift_rate": DRIFT_RATE}

KINDS_OF_AGEING: dict[str, dict[str, Any]] = {
    "none ages": HEALTHY_SWARM,
    "all age alike": {**HEALTHY_SWARM, **STEADY_DRIFT},
    "all age at once": {**HEALTHY_SWARM, "sensor": SuddenlyWorseSensors},
    "all age, some faster": {**HEALTHY_SWARM, "sensor": UnequallyAgeingSensors},
    "each ages in its own way": {**HEALTHY_SWARM, "sensor": WanderingSensors},
    "six age alike": {**STEADY_DRIFT, "flawed": 6, "drift_of": "flawed", "filter": ALL_FILTERS},
}
"""Parameters of the swarms by how their sensors age; 20 robots have the right b_hat at first."""

PEERS_BY_KIND: dict[str, list[dict[str, Any]]] = {
    "all age alike": [
        {"firmware": [KnownAccuracyRobot, KnownMeanAccuracyRobot], "filter": "none"},
        {"firmware": DriftingBayesCpfRobot, "filter": "asdf-plus"},
    ],
    "each ages in its own way": [{"firmware": WanderingBayesCpfRobot, "filter": "asdf-plus"}],
}
"""Robots that, unlike the firmware, know how their sensors age, by the kind of ageing."""


def ageing_rows() -> dict[str, list[Experiment]]:
    """Return the experiments of each row by its label: a kind of ageing, with the longest or a short memory.

    Each row has three shares of black floor, and the filters that its KINDS_OF_AGEING names.
    """
    rows: dict[str, list[Experiment]] = {}
    for kind, parameters in KINDS_OF_AGEING.items():
        for memory_label, memory in MEMORIES.items():
            rows[kind + memory_label] = m.grid(
                **MOVING_SWARM,
                **parameters,
                flawed_accuracy=0.95,
                fill_ratio=[0.55, 0.75, 0.95],
                memory=memory,
                steps=40_000,
                trials=30,
                seed=90125,  # which no tuning has seen
            )
    return rows


def peer_rows() -> dict[str, list[Experiment]]:
    """Return the experiments of each row, by its label. A row has sensors with one kind of ageing.

    Its robots know how their sensors age, and have the longest memory.
    """
    rows: dict[str, list[Experiment]] = {}
    for kind, peers in PEERS_BY_KIND.items():
        # Each of the peers has a filter, which replaces any filter here.
        parameters = {**MOVING_SWARM, **KINDS_OF_AGEING[kind], "filter": "none"}
        rows[kind + LONGEST_MEMORY] = m.grid(
            **parameters,
            flawed_accuracy=0.95,
            fill_ratio=0.75,
            memory=MEMORIES[LONGEST_MEMORY],
            steps=40_000,
            trials=4,
            seed=90126,
            peers=peers,
        )
    return rows


def draw_errors(rows: Rows) -> Figure:
    """Draw |x - f|, the error of the robots' estimates, over time: a panel for each kind of ageing.

    Experiments whose robots do not have the longest memory are left out.
    """
    panels = {
        label.removesuffix(LONGEST_MEMORY): experiments
        for label, experiments in rows.items()
        if label.endswith(LONGEST_MEMORY)
    }
    return plot_errors_over_time(panels, column_label)


def main() -> None:
    """Run the study's experiments, or resume them, and write ageing.md and ageing.png into the folder."""
    arguments = parse_arguments(__doc__)
    ageing = run_rows("ageing", ageing_rows(), arguments)
    peers = run_rows("ageing_peers", peer_rows(), arguments)
    tables = {
        "filters": markdown_table(LATE_ERROR_HEAD, ageing, late_error_text),
        "peers": markdown_table(LATE_ERROR_HEAD, peers, late_error_text),
    }
    write_tables(arguments.folder / "ageing.md", "Sensors that age", tables)
    save_figure(draw_errors(ageing), arguments.folder / "ageing.png")


if __name__ == "__main__":
    main()
