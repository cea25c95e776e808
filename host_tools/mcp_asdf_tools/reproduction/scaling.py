"""The study of many robots, which is not the paper's: score, error and cost of swarms at one density."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.results import Trials
from mcp_asdf_tools.reproduction.resampling import Estimate
from mcp_asdf_tools.reproduction.robust import (
    Entry,
    Table,
    late,
    measures_of,
    table_of,
    with_interval,
    write_page,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FILES = ("scale",)
HEAD = "H, error of the last quarter, ns of processor time for each robot and step"
Costs = Mapping[tuple[str, str], float]
"""Processor time by row and filter, in ns for each robot and step."""

_ROBOT_STEPS = 1_000_000
_FEWEST_STEPS = 100


def row_of(experiment: Experiment) -> str:
    """How many robots, and how the flawed ones are wrong."""
    is_under = experiment.flawed_accuracy < experiment.true_accuracy
    return f"{experiment.robots:,} robots, {'under' if is_under else 'over'}confident"


def cost_of(experiment: Experiment) -> float:
    """Processor time on this machine, in ns for each robot and step after the start; the best of three."""
    from mcp_asdf_tools.experiments.engine import native  # noqa: PLC0415 (other parts need not be built)

    def seconds(count: int) -> float:
        start = time.process_time()
        native.run(replace(experiment, steps=count), 0, 1)
        return time.process_time() - start

    steps = max(_FEWEST_STEPS, _ROBOT_STEPS // experiment.robots)
    spent = min(seconds(2 * steps) for _ in range(3)) - min(seconds(steps) for _ in range(3))
    return 1e9 * spent / steps / experiment.robots


def costs_of(results: Sequence[Trials]) -> Costs:
    """What the robots of each experiment cost."""
    own = [each.experiment for each in results]
    return {(row_of(each), each.filter_name): cost_of(each) for each in own}


def scores_of(results: Sequence[Trials], costs: Costs) -> Table:
    """Scores, errors and costs."""
    scores = table_of("Many robots", results, row_of)
    entries = {
        place: Entry(each.trials, {**each.measures, "cost": Estimate(*[costs[place]] * 3)})
        for place, each in scores.entries.items()
    }
    return Table(scores.title, entries)


def shown(entry: Entry) -> str:
    """What HEAD says."""
    h = with_interval(entry.measures["H"], "{:.1f}".format, 0.5)
    return f"{h}, {late(entry)}, {entry.measures['cost'].value:.0f}"


def picture_of(results: Sequence[Trials], costs: Costs) -> Figure:
    """H, late error and cost over the number of robots; a row for each way in which robots are flawed."""
    from mcp_asdf_tools.common.figures import WIDTH, empty_figure  # noqa: PLC0415
    from mcp_asdf_tools.experiments.plots import Measure, curve  # noqa: PLC0415 (matplotlib loads slowly)

    def late_error(trials: Trials) -> NDArray[np.float64]:
        return measures_of(trials)["late"]

    def cost(trials: Trials) -> NDArray[np.float64]:
        place = row_of(trials.experiment), trials.experiment.filter_name
        return np.full(len(trials.numbers), costs[place])

    measures: tuple[str | Measure, ...] = ("H", late_error, cost)
    figure = empty_figure(WIDTH, 4.8)
    for row, name in zip(figure.subplots(2, 3), ("underconfident", "overconfident"), strict=True):
        own = [each for each in results if row_of(each.experiment).endswith(name)]
        for axes, measure in zip(row, measures, strict=True):
            curve(own, "robots", "filter", measure, ax=axes)
            axes.set(xscale="log", yscale="log" if measure is late_error else "linear", title=name)
        row[0].set(ylabel="score H", ylim=(0, 100))
        row[1].set_ylabel("error of the last quarter")
        row[2].set(ylabel="ns, robot and step", ylim=(0, None))
    return figure


def write_report(folder: Path, results: Mapping[str, Sequence[Trials]]) -> None:
    """Write ``scale.md`` and ``scale.csv``, and ``scale.svg``, the picture; the costs are measured now."""
    (own,) = (results[name] for name in FILES)
    costs = costs_of(own)
    table = scores_of(own, costs)
    write_page(folder, "scale", table, table.lines(shown, HEAD), picture_of(own, costs))
