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
    Special,
    Table,
    late,
    measures_of,
    table_of,
    with_interval,
    write_page,
)
from mcp_asdf_tools.robots.population import FILTER_NAMES, Filtering

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FILES = ("scale",)
HEAD = "H, error of the last quarter"
COST_HEAD = "processor time for each robot and step, ns"
Costs = Mapping[tuple[int, Filtering], float]
"""Processor time by number of robots and filter, in ns for each robot and step."""


def is_underconfident(experiment: Experiment) -> bool:
    """Whether flawed robots think their sensors worse than they are."""
    return experiment.flawed_accuracy < experiment.true_accuracy


def row_of(robots: int) -> str:
    """The row of swarms of this size."""
    return f"{robots:,} robots"


def column_of(experiment: Experiment) -> str:
    """The filter, and the robots that are flawed."""
    world = "underconfident" if is_underconfident(experiment) else "overconfident"
    return f"{FILTER_NAMES[experiment.filter]}, {world}"


def late_error(trials: Trials) -> NDArray[np.float64]:
    """The mean error of the last quarter of each trial."""
    return measures_of(trials)["late"]


_ROBOT_STEPS = 1_000_000
_FEWEST_STEPS = 100


def costs_of(experiments: Sequence[Experiment]) -> dict[tuple[int, Filtering], float]:
    """Measure the costs on this machine, without the start of a trial; the best of three counts."""
    from mcp_asdf_tools.experiments.engine import native  # noqa: PLC0415 (other parts need not be built)

    def seconds(experiment: Experiment, steps: int) -> float:
        start = time.process_time()
        native.run(replace(experiment, steps=steps), 0, 1)
        return time.process_time() - start

    costs = dict[tuple[int, Filtering], float]()
    for each in experiments:
        steps = max(_FEWEST_STEPS, _ROBOT_STEPS // each.robots)
        spent = min(seconds(each, 2 * steps) for _ in range(3)) - min(seconds(each, steps) for _ in range(3))
        costs[each.robots, each.filter] = 1e9 * spent / steps / each.robots
    return costs


def picture_of(results: Sequence[Trials], costs: Costs) -> Figure:
    """H and late error over the number of robots, a row for each kind of flawed robots; and the cost."""
    from mcp_asdf_tools.common.figures import SMALL, WIDTH, clean, empty_figure  # noqa: PLC0415
    from mcp_asdf_tools.experiments.plots import curve, filter_colours  # noqa: PLC0415 (matplotlib loads slowly)

    figure = empty_figure(WIDTH, 4.6)
    panels = figure.subplot_mosaic([["under H", "under e", "cost"], ["over H", "over e", "cost"]])
    for name in ("under", "over"):
        own = [each for each in results if is_underconfident(each.experiment) is (name == "under")]
        curve(own, "robots", "filter", ax=panels[f"{name} H"])
        curve(own, "robots", "filter", late_error, ax=panels[f"{name} e"])
        panels[f"{name} H"].set_title(f"{name}confident", fontsize=SMALL, loc="left")
        panels[f"{name} e"].set(yscale="log", ylabel="error of the last quarter")
    filters = list(dict.fromkeys(each for _, each in costs))
    for each, colour in zip(filters, filter_colours(filters), strict=True):
        places = sorted(robots for robots, of in costs if of == each)
        panels["cost"].plot(places, [costs[robots, each] for robots in places], "o-", color=colour)
    panels["cost"].set(xlabel="number of robots", ylabel="ns for each robot and step", ylim=(0, None))
    for axes in figure.axes:
        axes.set_xscale("log")
        clean(axes)
    return figure


def tables_of(results: Sequence[Trials], costs: Costs) -> dict[str, Table]:
    """What came out, and what it cost, by the words of their marks in the docs."""
    cost = {
        (row_of(robots), FILTER_NAMES[each]): Entry(1, {"cost": Estimate(ns, ns, ns)})
        for (robots, each), ns in costs.items()
    }
    scores = table_of("Many robots", results, lambda each: row_of(each.robots), Special(column=column_of))
    return {"scale": scores, "cost": Table("Cost", cost)}


def lines_of(tables: Mapping[str, Table]) -> dict[str, str]:
    """The tables in Markdown."""

    def scores(entry: Entry) -> str:
        return f"{with_interval(entry.measures['H'], '{:.1f}'.format, 0.5)}, {late(entry)}"

    return {
        "scale": tables["scale"].lines(scores, HEAD),
        "cost": tables["cost"].lines(lambda entry: f"{entry.measures['cost'].value:.0f}", COST_HEAD),
    }


def write_report(folder: Path, results: Mapping[str, Sequence[Trials]]) -> None:
    """Write ``scale.md`` and ``scale.csv``, and ``scale.svg``, the picture; the costs are measured now."""
    (own,) = (results[name] for name in FILES)
    costs = costs_of([each.experiment for each in own if is_underconfident(each.experiment)])
    tables = tables_of(own, costs)
    text = "\n\n".join(lines_of(tables).values())
    write_page(folder, "scale", [*tables.values()], text, picture_of(own, costs))
