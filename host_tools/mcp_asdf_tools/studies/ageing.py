"""Sensors that age, which the paper leaves open: the error at the end, and over time.

``python -m mcp_asdf_tools.studies.ageing FOLDER`` writes ``ageing.md`` and ``ageing.png`` for docs/ageing.md.
"""

from __future__ import annotations

from collections.abc import Sequence

from matplotlib.figure import Figure

import mcp_asdf_tools as m
from mcp_asdf_tools.common.figures import save_figure
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.results import Trials
from mcp_asdf_tools.experiments.time_plots import plot_errors_over_time
from mcp_asdf_tools.studies.ageing_sensors import (
    SuddenlyWorseSensors,
    UnequallyAgeingSensors,
    WanderingSensors,
)
from mcp_asdf_tools.studies.error_tables import (
    late_error_text,
    markdown_table,
    parse_arguments,
    run_experiments,
    write_tables,
)
from mcp_asdf_tools.studies.peers import (
    AgeingBayesCpfRobot,
    KnownSensors,
    KnownWanderingSensors,
    MeanAccuracyRobot,
    OracleRobot,
    column_label,
)

LONGEST_MEMORY = 2**31
SHORT_MEMORY = 4096
HEAD = "error of the last quarter (95 % interval)"


def ageing_experiments() -> list[Experiment]:
    """Return the study's experiments: sensors that age in six ways, and robots that are right at first."""
    common = {
        "topology": "dynamic",
        "latency": 1,
        "fill_ratio": [0.55, 0.75, 0.95],
        "flawed_accuracy": 0.95,
        "memory": [LONGEST_MEMORY, SHORT_MEMORY],
        "steps": 40_000,
        "trials": 30,
        "seed": 90125,  # which no tuning has seen
    }
    all_robots = m.grid(
        **common,
        flawed="0%",
        filter=["none", "asdf-plus", "robust"],
        sensors=[
            {"drift": "none"},
            {"drift": "linear", "drift_rate": -1e-5},
            {"sensor": SuddenlyWorseSensors},
            {"sensor": UnequallyAgeingSensors},
            {"sensor": WanderingSensors},
        ],
    )
    some_robots = m.grid(
        **common,
        flawed="30%",
        filter=["none", "asdf-minus", "asdf-plus", "robust"],
        drift="linear",
        drift_rate=-1e-5,
        drift_of="flawed",
    )
    return [*all_robots, *some_robots]


def peer_experiments() -> list[Experiment]:
    """Return experiments with robots that know how their sensors age."""
    return m.grid(
        topology="dynamic",
        latency=1,
        fill_ratio=0.75,
        flawed_accuracy=0.95,
        flawed="0%",
        memory=[LONGEST_MEMORY, SHORT_MEMORY],
        steps=40_000,
        trials=4,
        seed=90126,
        sensors=[
            {"sensor": KnownSensors, "drift": "linear", "drift_rate": -1e-5},  # all alike, all the time
            {"sensor": KnownWanderingSensors},  # each in its own way
        ],
        peers=[
            {"firmware": [OracleRobot, MeanAccuracyRobot], "filter": "none"},
            {"firmware": AgeingBayesCpfRobot, "filter": "asdf-plus"},
        ],
    )


def way_of_ageing(experiment: Experiment) -> str:
    """Return in words how the sensors of an experiment age."""
    if experiment.drift_of == "flawed":
        return f"{experiment.flawed} of {experiment.robots} age alike"
    if experiment.drift == "linear":
        return "all age alike"
    match experiment.sensor.rpartition(".")[2]:
        case SuddenlyWorseSensors.__name__:
            return "all age at once"
        case UnequallyAgeingSensors.__name__:
            return "all age, some faster"
        case WanderingSensors.__name__ | KnownWanderingSensors.__name__:
            return "each ages in its own way"
        case _:
            return "none ages"


def row_label(experiment: Experiment) -> str:
    """Return how the sensors age, and how long the robots' memory is."""
    memory = "longest" if experiment.memory == LONGEST_MEMORY else "short"
    return f"{way_of_ageing(experiment)}, {memory} memory"


def late_error_table(experiments: Sequence[Trials]) -> str:
    """Return the table of late errors: a row for each way to age and memory, a column for each filter."""
    return markdown_table(HEAD, experiments, row_label, column_label, late_error_text)


def draw_errors(experiments: Sequence[Trials]) -> Figure:
    """Draw the error over time of robots with the longest memory: a panel for each way to age."""
    panels: dict[str, list[Trials]] = {}
    for trials in experiments:
        if trials.experiment.memory == LONGEST_MEMORY:
            panels.setdefault(way_of_ageing(trials.experiment), []).append(trials)
    return plot_errors_over_time(panels)


def main() -> None:
    """Run the experiments and write table and picture."""
    arguments = parse_arguments(__doc__)
    ageing = run_experiments("ageing", ageing_experiments(), arguments)
    peers = run_experiments("ageing_peers", peer_experiments(), arguments)
    tables = {"filters": late_error_table(ageing), "peers": late_error_table(peers)}
    write_tables(arguments.folder / "ageing.md", "Sensors that age", tables)
    save_figure(draw_errors(ageing), arguments.folder / "ageing.png")


if __name__ == "__main__":
    main()
