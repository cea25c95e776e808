"""Sensors that age, which the paper leaves open: the error at the end, and over time.

``python -m mcp_asdf_tools.studies.ageing FOLDER`` writes ``ageing.md`` and ``ageing.png`` for docs/ageing.md.

Each robot estimates f, the share of black floor, as x. Its late error is the mean of |x - f| over the last
quarter of a trial. b is the accuracy of a robot's sensor, which ageing changes, and b_hat the accuracy that
the robot assumes.
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
"""Values of ``Experiment.memory``: at so many observations a robot halves its counts, to forget old ones."""

TABLE_HEAD = "error of the last quarter (95 % interval)"


def ageing_experiments() -> list[Experiment]:
    """Return experiments with robots that assume the right accuracy at first, while their sensors age.

    All sensors of a swarm age in one of five ways, none among them, or only those of the flawed robots do.
    Each way is combined with each f, each memory and each filter, of which "none" is one.
    """
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
    """Return experiments with robot classes that, unlike the firmware, know how their sensors age.

    All sensors of a swarm age alike, or every sensor's accuracy wanders at random.
    """
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


def ageing_label(experiment: Experiment) -> str:
    """Return how the sensors of an experiment age, such as "all age alike" or "6 of 20 age alike"."""
    if experiment.drift_of == "flawed":
        return f"{experiment.flawed} of {experiment.robots} age alike"
    if experiment.drift == "linear":
        return "all age alike"
    sensor_class = experiment.sensor.rpartition(".")[2]
    match sensor_class:
        case SuddenlyWorseSensors.__name__:
            return "all age at once"
        case UnequallyAgeingSensors.__name__:
            return "all age, some faster"
        case WanderingSensors.__name__ | KnownWanderingSensors.__name__:
            return "each ages in its own way"
        case _:
            return "none ages"


def row_label(experiment: Experiment) -> str:
    """Return the row label of an experiment, such as "all age alike, short memory"."""
    memory = "longest" if experiment.memory == LONGEST_MEMORY else "short"
    return f"{ageing_label(experiment)}, {memory} memory"


def late_error_table(experiments: Sequence[Trials]) -> str:
    """Return a Markdown table of the mean |x - f| in the last quarter of trials, with 95 % intervals.

    It has a row for each way to age and each memory, and a column for each filter.
    """
    return markdown_table(TABLE_HEAD, experiments, row_label, column_label, late_error_text)


def draw_errors(experiments: Sequence[Trials]) -> Figure:
    """Draw |x - f|, the error of the robots' estimates, over time: a panel for each way to age.

    Experiments whose robots do not have the longest memory are left out.
    """
    experiments_by_panel: dict[str, list[Trials]] = {}
    for trials in experiments:
        if trials.experiment.memory == LONGEST_MEMORY:
            panel = ageing_label(trials.experiment)
            experiments_by_panel.setdefault(panel, []).append(trials)
    return plot_errors_over_time(experiments_by_panel)


def main() -> None:
    """Run the study's experiments, or resume them, and write ageing.md and ageing.png into the folder."""
    arguments = parse_arguments(__doc__)
    ageing = run_experiments("ageing", ageing_experiments(), arguments)
    peers = run_experiments("ageing_peers", peer_experiments(), arguments)
    tables = {"filters": late_error_table(ageing), "peers": late_error_table(peers)}
    write_tables(arguments.folder / "ageing.md", "Sensors that age", tables)
    save_figure(draw_errors(ageing), arguments.folder / "ageing.png")


if __name__ == "__main__":
    main()
