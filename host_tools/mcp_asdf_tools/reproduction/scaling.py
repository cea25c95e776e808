"""The study of many robots, which is not the paper's: score, error and cost of swarms at one density."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.results import Trials
from mcp_asdf_tools.reproduction.robust import (
    LATE,
    Entry,
    Special,
    Table,
    in_markdown,
    late,
    measures_of,
    table_of,
    with_interval,
    write_page,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FILES = ("scale",)
_ROBOT_STEPS, _FEWEST_STEPS = 1_000_000, 100


def row_of(experiment: Experiment) -> str:
    """How many robots, and how the flawed ones are wrong."""
    is_under = experiment.flawed_accuracy < experiment.true_accuracy
    return f"{experiment.robots:,} robots, {'under' if is_under else 'over'}confident"


@cache
def _seconds(experiment: Experiment) -> float:
    """Processor time of a trial on this machine, the best of three."""
    from mcp_asdf_tools.experiments.engine import native  # noqa: PLC0415 (other parts need not be built)

    starts = []
    for _ in range(4):
        starts.append(time.process_time())
        native.run(experiment, 0, 1)
    return float(np.diff(starts).min())


def cost(trials: Trials) -> NDArray[np.float64]:
    """Processor time in ns for each robot and step, without the start: measured once, the same for all."""
    steps = max(_FEWEST_STEPS, _ROBOT_STEPS // trials.experiment.robots)
    short, long = (_seconds(replace(trials.experiment, steps=count)) for count in (steps, 2 * steps))
    return np.full(len(trials.numbers), 1e9 * (long - short) / steps / trials.experiment.robots)


COSTS = Special(more={"cost": cost})


def lines_of(own: Table) -> str:
    """The table in Markdown."""

    def shown(entry: Entry) -> str:
        h = with_interval(entry.measures["H"], "{:.1f}".format, 0.5)
        return f"{h}, {late(entry)}, {entry.measures['cost'].value:.0f}"

    head = f"H, {LATE}, ns of processor time for each robot and step"
    return in_markdown(own.entries, shown, head)


def picture_of(results: Mapping[str, Sequence[Trials]]) -> Figure:
    """H, late error and cost over the number of robots; a row for each way in which robots are flawed."""
    from mcp_asdf_tools.common.figures import WIDTH, empty_figure  # noqa: PLC0415
    from mcp_asdf_tools.experiments.plots import Measure, curve  # noqa: PLC0415 (matplotlib loads slowly)

    def late_error(trials: Trials) -> NDArray[np.float64]:
        return measures_of(trials)["late"]

    measures: tuple[str | Measure, ...] = ("H", late_error, cost)
    looks: tuple[dict[str, Any], ...] = (
        {"ylabel": "score H", "ylim": (0, 100)},
        {"ylabel": "error of the last quarter", "yscale": "log"},
        {"ylabel": "ns, robot and step", "ylim": (0, None)},
    )
    figure = empty_figure(WIDTH, 4.8)
    for row, name in zip(figure.subplots(2, 3), ("underconfident", "overconfident"), strict=True):
        own = [each for each in results["scale"] if row_of(each.experiment).endswith(name)]
        for axes, measure, look in zip(row, measures, looks, strict=True):
            curve(own, "robots", "filter", measure, ax=axes)
            axes.set(xscale="log", title=name, **look)
    return figure


def write_report(folder: Path, results: Mapping[str, Sequence[Trials]]) -> None:
    """Write ``scale.md`` and ``scale.csv``, and ``scale.svg``, the picture; the costs are measured now."""
    table = table_of("Many robots", results["scale"], row_of, COSTS)
    write_page(folder, "scale", table, lines_of(table), picture_of(results))
