"""The pictures of the report: the paper's figures of its results, with their numbers and codes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

from matplotlib.figure import Figure

from mcp_asdf_tools.experiments import plots
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.plots import filter_name
from mcp_asdf_tools.experiments.results import Trials
from mcp_asdf_tools.experiments.trials import run_trials
from mcp_asdf_tools.reproduction.study import PART_NAMES, Cell, Part, Scale, Study, experiment_of

FULLY_CONNECTED, DYNAMIC, PHYSICAL = Part
NONE, MINUS, PLUS = "none", "asdf-minus", "asdf-plus"

_INTERVAL = 100
"""Steps between the values of a recorded trial."""


class Picture(NamedTuple):
    """A picture of the report.

    Attributes:
        name: Name of its file, without a suffix.
        title: What it shows, with the number of the paper's figure that it follows.
        figure: The drawing.
    """

    name: str
    title: str
    figure: Figure


def pictures(study: Study, scale: Scale) -> Iterator[Picture]:
    """All pictures of the parts of which there are results."""
    simulated = [part for part in (DYNAMIC, FULLY_CONNECTED) if part in study.parts]
    for part in simulated:
        is_dynamic = part is DYNAMIC
        yield _boxes(study, part, MINUS, "3a" * is_dynamic)
        yield _boxes(study, part, PLUS, "3b" * is_dynamic)
        yield _scatter(study, part, "4" * is_dynamic)
        yield _bands(study, part)
    if len(simulated) == 2:
        yield _topologies(study, MINUS, "5a")
        yield _topologies(study, PLUS, "5b")
    if FULLY_CONNECTED in study.parts:
        yield _series(scale)
    if PHYSICAL in study.parts:
        yield _boxes(study, PHYSICAL, PLUS, "8a")
        yield _scatter(study, PHYSICAL, "8b")


def _of(study: Study, part: Part, *filters: str, shortest: bool = False) -> list[Trials]:
    """Results with these filters, one after the other, and all periods or only the shortest."""
    return [
        each
        for own in filters
        for each in study.of(part)
        if each.experiment.filter == own
        and (own == NONE or not shortest or each.experiment.filter_period == Cell.period)
    ]


def _ends_of_minus(study: Study, part: Part) -> list[Trials]:
    """ASDF- where it is another swarm to the bit: without flawed robots nobody filters, and with flawed ones
    alone all do."""
    return [
        replace(each, experiment=replace(each.experiment, filter="asdf-minus"))
        for own, flawed in ((NONE, 0), (PLUS, 1))
        for each in _of(study, part, own, shortest=True)
        if each.experiment.flawed == flawed * each.experiment.robots
    ]


def _titled(words: str, paper: str) -> str:
    """A title with the number of the paper's figure, if there is one."""
    return f"{words} (the paper's figure {paper})" if paper else words


def _boxes(study: Study, part: Part, own: str, paper: str) -> Picture:
    """H without and with a filter; where all are flawed, ASDF- is ASDF+ and not shown twice."""
    shown = _of(study, part, NONE, own)
    if own == MINUS:
        shown = [each for each in shown if each.experiment.flawed < each.experiment.robots]
    title = f"H of {PART_NAMES[part]} swarms without filter and with {filter_name(shown[-1].experiment)}"
    return Picture(f"{part.value}_{own}", _titled(title, paper), plots.boxes(shown))


def _scatter(study: Study, part: Part, paper: str) -> Picture:
    shown = _of(study, part, NONE, MINUS, PLUS, shortest=True) + _ends_of_minus(study, part)
    title = f"Accuracy against convergence of {PART_NAMES[part]} swarms, tau = {Cell.period}"
    return Picture(f"{part.value}_scatter", _titled(title, paper), plots.scatter(shown))


def _bands(study: Study, part: Part) -> Picture:
    shown = _of(study, part, PLUS, shortest=True)
    shown = [each for each in shown if 0 < each.experiment.flawed < each.experiment.robots]
    title = f"b_hat of all robots of {PART_NAMES[part]} swarms with ASDF+, tau = {Cell.period}"
    return Picture(f"{part.value}_bands", title, plots.bands(shown))


def _topologies(study: Study, own: str, paper: str) -> Picture:
    """Dynamic beside fully connected."""

    def name(each: Experiment) -> str:
        return f"{'dynamic' if each.is_dynamic else 'fully connected'}, {filter_name(each)}"

    parts = (DYNAMIC, FULLY_CONNECTED)
    shown = [each for part in parts for each in _of(study, part, NONE, own, shortest=True)]
    if own == MINUS:
        shown += [each for part in parts for each in _ends_of_minus(study, part)]
    words = f"without filter and with {filter_name(shown[-1].experiment)}, tau = {Cell.period}"
    title = _titled(f"H in both topologies {words}", paper)
    return Picture(f"topologies_{own}", title, plots.boxes(shown, name=name))


def _series(scale: Scale) -> Picture:
    """One trial without and one with a filter, run again to record them."""
    cell = Cell(FULLY_CONNECTED, 0.95, 0.55, 0.95, 50)
    wanted = [experiment_of(cell.but(filter=own), scale) for own in (NONE, PLUS)]
    recorded = [run_trials(experiment, 0, 1, _INTERVAL) for experiment in wanted]
    title = "A trial without filter and one with ASDF+: f = 0.95, b = 0.55, b_hat = 0.95, P = 50 %"
    return Picture("series", _titled(title, "6"), plots.series_beside(recorded, 0))
