"""The pictures of the report: the paper's figures with its numbers and codes, and what it does not show."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from matplotlib.figure import Figure

from mcp_asdf_tools.experiments import (
    E_MAX,
    FILTER_NAMES,
    Experiment,
    Trials,
    arena_plots,
    plots,
    run_trials,
    scatter_plots,
    time_plots,
    trials_in_words,
)
from mcp_asdf_tools.reproduction.study import (
    PART_NAMES,
    PERIODS,
    Cell,
    Part,
    Scale,
    Study,
    cells_of,
    experiment_of,
)
from mcp_asdf_tools.robots import Filtering

FULLY_CONNECTED, DYNAMIC, PHYSICAL = Part
NONE, MINUS, PLUS = Filtering

_TRIAL = 0
"""Which one is drawn over time and space."""

_MOMENT = 1000
"""Step up to which the paths of robots are drawn."""
_INTERVAL = 100
"""Steps between the values of a recorded trial."""


@dataclass(frozen=True)
class Drawn:
    """Everything that a picture may show.

    Attributes:
        study: The results with the first seed.
        scale: How much was run.
    """

    study: Study
    scale: Scale


@dataclass(frozen=True)
class ReportFigure:
    """A picture of the report.

    Attributes:
        name: Name of its file, without a suffix.
        title: What it shows.
        paper: Number of the paper's figure that it follows, empty if there is none.
        parts: Those that it shows.
        draw: Draws it, given the trials in it.
        shown: Whether an experiment is in it; none is where nothing is scored.
        note: How to read it.
    """

    name: str
    title: str
    paper: str
    parts: tuple[Part, ...]
    draw: Callable[[Drawn, Sequence[Trials]], Figure]
    shown: Callable[[Experiment], bool] = lambda experiment: False
    note: str = ""

    def drawn(self, drawn: Drawn) -> Figure:
        """The picture."""
        return self.draw(drawn, self._trials(drawn))

    def caption(self, drawn: Drawn) -> str:
        """Title, number in the paper, how to read it, trials and limits of the scores."""
        paper = f" (the paper's figure {self.paper})" if self.paper else ""
        words = f"{self.title}{paper}."
        if self.note:
            words += f" {self.note[0].upper()}{self.note[1:]}."
        if shown := self._trials(drawn):
            k_max = " and ".join(f"{steps}" for steps in sorted({each.experiment.steps for each in shown}))
            words += f" {trials_in_words(shown)}; K_max = {k_max}, e_max = {E_MAX:g}."
        return words

    def _trials(self, drawn: Drawn) -> list[Trials]:
        """In the order of the filters, so that a series has the same colour in every picture."""
        own = [each for part in self.parts for each in drawn.study.of(part) if self.shown(each.experiment)]
        return sorted(own, key=lambda each: list(Filtering).index(each.experiment.filter))


def _with(*filters: Filtering, shortest: bool = False) -> Callable[[Experiment], bool]:
    """Experiments with these filters, and the shortest period if only that is wanted."""
    return lambda each: (
        each.filter in filters and (not shortest or each.filter is NONE or each.filter_period == PERIODS[0])
    )


def _boxes(part: Part, own: Filtering, paper: str) -> ReportFigure:
    """H without and with a filter; where all are flawed, ASDF- is ASDF+ and not shown twice."""
    chosen = _with(NONE, own)
    return ReportFigure(
        f"{part.value}_{own.value}",
        f"H of {PART_NAMES[part]} swarms without filter and with {FILTER_NAMES[own]}",
        paper,
        (part,),
        lambda drawn, shown: plots.boxes(shown),
        lambda each: chosen(each) and not (own is MINUS and each.flawed == each.robots),
        plots.BOXES,
    )


def _topologies(own: Filtering, paper: str) -> ReportFigure:
    """Dynamic beside fully connected."""

    def name(each: Experiment) -> str:
        return f"{'dynamic' if each.is_dynamic else 'fully connected'}, {FILTER_NAMES[each.filter]}"

    def draw(drawn: Drawn, shown: Sequence[Trials]) -> Figure:
        by_part = sorted(shown, key=lambda each: not each.experiment.is_dynamic)
        return plots.boxes(by_part, name=name)

    return ReportFigure(
        f"topologies_{own.value}",
        f"H in both topologies without filter and with {FILTER_NAMES[own]}, tau = {PERIODS[0]}",
        paper,
        (DYNAMIC, FULLY_CONNECTED),
        draw,
        _with(NONE, own, shortest=True),
        plots.BOXES,
    )


def _scatter(part: Part, paper: str) -> ReportFigure:
    return ReportFigure(
        f"{part.value}_scatter",
        f"Accuracy against convergence of {PART_NAMES[part]} swarms, tau = {PERIODS[0]}",
        paper,
        (part,),
        lambda drawn, shown: scatter_plots.scatter(shown),
        _with(*Filtering, shortest=True),
        f"{scatter_plots.POINTS}. Without flawed robots ASDF- is no filter, where all are flawed it is ASDF+",
    )


def _bands(part: Part) -> ReportFigure:
    chosen = _with(PLUS, shortest=True)
    return ReportFigure(
        f"{part.value}_bands",
        f"b_hat of all robots of {PART_NAMES[part]} swarms with ASDF+, tau = {PERIODS[0]}",
        "",
        (part,),
        lambda drawn, shown: time_plots.bands(shown),
        lambda each: chosen(each) and 0 < each.flawed < each.robots,
        time_plots.BANDS,
    )


def _paths(drawn: Drawn, _: Sequence[Trials]) -> Figure:
    half = next(experiment_of(cell, drawn.scale) for cell in cells_of(PHYSICAL) if cell.percent == 50)
    return arena_plots.trajectories(half, _TRIAL, _MOMENT)


def _series(drawn: Drawn, _: Sequence[Trials]) -> Figure:
    """One trial each of figure 6, run again to record it."""
    cell = Cell(FULLY_CONNECTED, 0.95, 0.55, 0.95, 50)
    wanted = [replace(experiment_of(cell.but(filter=own), drawn.scale), trials=1) for own in (NONE, PLUS)]
    recorded = [run_trials(experiment, _TRIAL, 1, _INTERVAL) for experiment in wanted]
    return time_plots.series_beside(recorded, _TRIAL)


FIGURES = (
    ReportFigure(
        "confidence",
        "Local confidence alpha of an observation against b_hat",
        "2",
        (),
        lambda drawn, shown: plots.confidence(),
    ),
    _boxes(DYNAMIC, MINUS, "3a"),
    _boxes(DYNAMIC, PLUS, "3b"),
    _boxes(FULLY_CONNECTED, MINUS, ""),
    _boxes(FULLY_CONNECTED, PLUS, ""),
    _scatter(DYNAMIC, "4"),
    _scatter(FULLY_CONNECTED, ""),
    _topologies(MINUS, "5a"),
    _topologies(PLUS, "5b"),
    ReportFigure(
        "series",
        "A fully connected trial without filter and one with ASDF+: f = 0.95, b = 0.55, b_hat = 0.95, "
        f"P = 50 %, tau = {PERIODS[0]}",
        "6",
        (FULLY_CONNECTED,),
        _series,
    ),
    ReportFigure(
        "physical_paths",
        f"Paths of the robots across the code in the first {_MOMENT} steps",
        "7",
        (PHYSICAL,),
        _paths,
    ),
    ReportFigure(
        "physical_scores",
        f"H of physical swarms without filter and with {FILTER_NAMES[PLUS]}",
        "8a",
        (PHYSICAL,),
        lambda drawn, shown: plots.strips(shown),
        _with(NONE, PLUS),
        plots.POINTS,
    ),
    _scatter(PHYSICAL, "8b"),
    _bands(FULLY_CONNECTED),
    _bands(DYNAMIC),
)
