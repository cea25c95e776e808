"""The pictures of the report: the paper's figures with its numbers and codes, and what it does not show."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple, get_args

from matplotlib.figure import Figure

from mcp_asdf_tools.experiments import plots, time_plots
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.plots import trials_in_words
from mcp_asdf_tools.experiments.results import Trials
from mcp_asdf_tools.experiments.scores import E_MAX
from mcp_asdf_tools.experiments.trials import run_trials
from mcp_asdf_tools.reproduction.study import PART_NAMES, Cell, Part, Scale, Study, cells_of, experiment_of
from mcp_asdf_tools.robots.population import TYPESET_FILTER_NAMES, Filtering

FULLY_CONNECTED, DYNAMIC, PHYSICAL = Part
NONE: Filtering = "none"
MINUS: Filtering = "asdf-minus"
PLUS: Filtering = "asdf-plus"

_MOMENT = 1000
"""Step up to which the paths of robots are drawn."""
_INTERVAL = 100
"""Steps between the values of a recorded trial."""


class Picture(NamedTuple):
    """A picture of the report.

    Attributes:
        name: Name of its file, without a suffix.
        title: What it shows, with the number of the paper's figure that it follows.
        note: How to read it, trials, and limits of the scores.
        figure: The drawing.
    """

    name: str
    title: str
    note: str
    figure: Figure


def pictures(study: Study, scale: Scale) -> Iterator[Picture]:
    """All pictures of the parts of which there are results."""
    title = "Local confidence alpha of an observation against b_hat (the paper's figure 2)"
    yield Picture("confidence", title, "", plots.confidence())
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
        yield _paths(scale)
        shown = _of(study, PHYSICAL, NONE, PLUS)
        title = f"H of physical swarms without filter and with {TYPESET_FILTER_NAMES[PLUS]}"
        yield _scored("physical_scores", _titled(title, "8a"), shown, plots.boxes, plots.BOXES)
        yield _scatter(study, PHYSICAL, "8b")


def _of(study: Study, part: Part, *filters: Filtering, shortest: bool = False) -> list[Trials]:
    """Results with these filters, one after the other, and all periods or only the shortest."""
    return [
        each
        for own in filters
        for each in study.of(part)
        if each.experiment.filter == own
        and (own == NONE or not shortest or each.experiment.filter_period == Cell.period)
    ]


def _titled(words: str, paper: str) -> str:
    """A title with the number of the paper's figure, if there is one."""
    return f"{words} (the paper's figure {paper})" if paper else words


def _scored(
    name: str, title: str, shown: Sequence[Trials], draw: Callable[[Sequence[Trials]], Figure], marks: str
) -> Picture:
    """A picture of scores; ``marks`` says what is drawn."""
    k_max = " and ".join(f"{steps}" for steps in sorted({each.experiment.steps for each in shown}))
    note = f"{marks[0].upper()}{marks[1:]}. {trials_in_words(shown)}; K_max = {k_max}, e_max = {E_MAX:g}."
    return Picture(name, title, note, draw(shown))


def _boxes(study: Study, part: Part, own: Filtering, paper: str) -> Picture:
    """H without and with a filter; where all are flawed, ASDF- is ASDF+ and not shown twice."""
    shown = _of(study, part, NONE, own)
    if own == MINUS:
        shown = [each for each in shown if each.experiment.flawed < each.experiment.robots]
    title = f"H of {PART_NAMES[part]} swarms without filter and with {TYPESET_FILTER_NAMES[own]}"
    return _scored(f"{part.value}_{own}", _titled(title, paper), shown, plots.boxes, plots.BOXES)


def _scatter(study: Study, part: Part, paper: str) -> Picture:
    title = f"Accuracy against convergence of {PART_NAMES[part]} swarms, tau = {Cell.period}"
    marks = plots.SCATTER
    marks += ". Without flawed robots ASDF- is no filter, where all are flawed it is ASDF+"
    shown = _of(study, part, *get_args(Filtering), shortest=True)
    return _scored(f"{part.value}_scatter", _titled(title, paper), shown, plots.scatter, marks)


def _bands(study: Study, part: Part) -> Picture:
    title = f"b_hat of all robots of {PART_NAMES[part]} swarms with ASDF+, tau = {Cell.period}"
    shown = _of(study, part, PLUS, shortest=True)
    shown = [each for each in shown if 0 < each.experiment.flawed < each.experiment.robots]
    return _scored(f"{part.value}_bands", title, shown, time_plots.bands, time_plots.BANDS)


def _topologies(study: Study, own: Filtering, paper: str) -> Picture:
    """Dynamic beside fully connected."""

    def name(each: Experiment) -> str:
        return f"{'dynamic' if each.is_dynamic else 'fully connected'}, {TYPESET_FILTER_NAMES[each.filter]}"

    def draw(shown: Sequence[Trials]) -> Figure:
        return plots.boxes(shown, name=name)

    title = f"H in both topologies without filter and with {TYPESET_FILTER_NAMES[own]}, tau = {Cell.period}"
    parts = (DYNAMIC, FULLY_CONNECTED)
    shown = [each for part in parts for each in _of(study, part, NONE, own, shortest=True)]
    return _scored(f"topologies_{own}", _titled(title, paper), shown, draw, plots.BOXES)


def _series(scale: Scale) -> Picture:
    """One trial without and one with a filter, run again to record them."""
    cell = Cell(FULLY_CONNECTED, 0.95, 0.55, 0.95, 50)
    wanted = [replace(experiment_of(cell.but(filter=own), scale), trials=1) for own in (NONE, PLUS)]
    recorded = [run_trials(experiment, 0, 1, _INTERVAL) for experiment in wanted]
    title = "A fully connected trial without filter and one with ASDF+ (the paper's figure 6)"
    note = f"f = 0.95, b = 0.55, b_hat = 0.95, P = 50 %, tau = {Cell.period}."
    return Picture("series", title, note, time_plots.series_beside(recorded, 0))


def _paths(scale: Scale) -> Picture:
    half = next(experiment_of(cell, scale) for cell in cells_of(PHYSICAL) if cell.percent == 50)
    title = f"Paths of the robots across the code in the first {_MOMENT} steps (the paper's figure 7)"
    return Picture("physical_paths", title, "", time_plots.trajectories(half, 0, _MOMENT))
