"""The pictures of the report: the paper's figures with its numbers and codes, and what it does not show."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from matplotlib.figure import Figure

from mcp_asdf_tools.experiments import (
    E_MAX,
    FILTER_NAMES,
    Experiment,
    Trials,
    arena_plots,
    plots,
    scatter_plots,
    time_plots,
    trials_in_words,
)
from mcp_asdf_tools.reproduction.comparisons import (
    BOTH,
    DYNAMIC,
    FULLY_CONNECTED,
    MINUS,
    NONE,
    OVER_AMBIGUOUS,
    PARTLY,
    PHYSICAL,
    PLUS,
    cells,
)
from mcp_asdf_tools.reproduction.study import (
    PART_NAMES,
    PERIODS,
    Part,
    Scale,
    Study,
    cells_of,
    experiment_of,
)
from mcp_asdf_tools.robots import Filtering

_TRIAL = 0
"""Which one is drawn over time and space."""

_MOMENT = 1000
"""Step at which moving robots are drawn."""


@dataclass(frozen=True)
class Drawn:
    """Everything that a picture may show.

    Attributes:
        study: The results with the first seed.
        series: Trials recorded over time, without a filter and with ASDF+.
        scale: How much was run.
    """

    study: Study
    series: Sequence[Trials]
    scale: Scale


@dataclass(frozen=True)
class ReportFigure:
    """A picture of the report.

    Attributes:
        name: Of its file.
        title: What it shows.
        paper: Number of the paper's figure that it follows, empty if there is none.
        needs: The parts it shows.
        draw: Draws it.
        shown: The results in it; none where nothing is scored.
        note: How to read it.
    """

    name: str
    title: str
    paper: str
    needs: frozenset[Part]
    draw: Callable[[Drawn], Figure]
    shown: Callable[[Drawn], Sequence[Trials]] = lambda drawn: []
    note: str = ""

    def caption(self, drawn: Drawn) -> str:
        """Title, number in the paper, how to read it, trials and limits of the scores."""
        paper = f" (the paper's figure {self.paper})" if self.paper else ""
        words = [f"{self.title}{paper}.", self.note, _trials_in_words(self.shown(drawn))]
        return " ".join(filter(None, words))


def _trials_in_words(shown: Sequence[Trials]) -> str:
    if not shown:
        return ""
    k_max = " and ".join(f"{steps}" for steps in sorted({trials.experiment.steps for trials in shown}))
    return f"{trials_in_words(shown)}; K_max = {k_max}, e_max = {E_MAX:g}."


def _sentence(words: str) -> str:
    return words[0].upper() + words[1:]


_WHISKERS = f"{_sentence(plots.BOXES)}."


def _of(part: Part, filters: Sequence[Filtering], *periods: int) -> Callable[[Drawn], list[Trials]]:
    """Results of a part with these filters, and periods if any are given."""

    def chosen(drawn: Drawn) -> list[Trials]:
        return [
            each
            for some in filters
            for each in drawn.study.of(part)
            if each.experiment.filter is some
            and (some is NONE or not periods or each.experiment.filter_period in periods)
        ]

    return chosen


def _boxes(part: Part, own: Filtering, paper: str) -> ReportFigure:
    """H without and with a filter; where all are flawed, ASDF- is ASDF+ and not shown twice."""
    every = _of(part, (NONE, own))

    def shown(drawn: Drawn) -> list[Trials]:
        all_are_flawed = own is MINUS
        return [
            each
            for each in every(drawn)
            if not (all_are_flawed and each.experiment.flawed == each.experiment.robots)
        ]

    return ReportFigure(
        f"{part.value}_{own.value}",
        f"H of {PART_NAMES[part]} swarms without filter and with {FILTER_NAMES[own]}",
        paper,
        frozenset({part}),
        lambda drawn: plots.boxes(shown(drawn)),
        shown,
        _WHISKERS,
    )


_POINTS = _sentence(plots.POINTS)


def _physical_scores() -> ReportFigure:
    shown = _of(PHYSICAL, (NONE, PLUS))
    return ReportFigure(
        "physical_scores",
        f"H of physical swarms without filter and with {FILTER_NAMES[PLUS]}",
        "8a",
        frozenset({PHYSICAL}),
        lambda drawn: plots.strips(shown(drawn)),
        shown,
        f"{_POINTS}.",
    )


def _strips(part: Part) -> ReportFigure:
    every = _of(part, tuple(Filtering), PERIODS[0])

    def shown(drawn: Drawn) -> list[Trials]:
        return [
            each
            for each in every(drawn)
            if (each.experiment.fill_ratio, each.experiment.true_accuracy) == OVER_AMBIGUOUS
        ]

    return ReportFigure(
        f"{part.value}_strips",
        f"H of every trial of {PART_NAMES[part]} swarms where f = b = 0.55, tau = {PERIODS[0]}",
        "",
        frozenset({part}),
        lambda drawn: plots.strips(shown(drawn)),
        shown,
        f"{_POINTS}: where trials fall into two groups the median may be in neither.",
    )


def _points(part: Part, paper: str) -> ReportFigure:
    shown = _of(part, tuple(Filtering), PERIODS[0])
    return ReportFigure(
        f"{part.value}_scatter",
        f"Accuracy against convergence of {PART_NAMES[part]} swarms, tau = {PERIODS[0]}",
        paper,
        frozenset({part}),
        lambda drawn: scatter_plots.scatter(shown(drawn)),
        shown,
        f"{_sentence(scatter_plots.POINTS)}. Without flawed robots ASDF- is no filter, where all are flawed "
        "it is ASDF+.",
    )


def _topologies(own: Filtering, paper: str) -> ReportFigure:
    """Dynamic beside fully connected."""

    def name(experiment: Experiment) -> str:
        return (
            f"{'dynamic' if experiment.is_dynamic else 'fully connected'}, {FILTER_NAMES[experiment.filter]}"
        )

    def shown(drawn: Drawn) -> list[Trials]:
        return [each for part in BOTH for each in _of(part, (NONE, own), PERIODS[0])(drawn)]

    return ReportFigure(
        f"topologies_{own.value}",
        f"H in both topologies without filter and with {FILTER_NAMES[own]}, tau = {PERIODS[0]}",
        paper,
        frozenset(BOTH),
        lambda drawn: plots.boxes(shown(drawn), name=name),
        shown,
        _WHISKERS,
    )


def _bands(part: Part) -> ReportFigure:
    def shown(drawn: Drawn) -> list[Trials]:
        return [drawn.study.trials(cell) for cell in cells(part, percents=PARTLY, filter=PLUS)]

    return ReportFigure(
        f"{part.value}_bands",
        f"b_hat of all robots of {PART_NAMES[part]} swarms with ASDF+, tau = {PERIODS[0]}",
        "",
        frozenset({part}),
        lambda drawn: time_plots.bands(shown(drawn)),
        shown,
        f"{_sentence(time_plots.BANDS)}.",
    )


def _paths(drawn: Drawn) -> Figure:
    return arena_plots.trajectories(_half_flawed(PHYSICAL, drawn.scale), _TRIAL, _MOMENT)


def _network(drawn: Drawn) -> Figure:
    return arena_plots.network(_half_flawed(DYNAMIC, drawn.scale), _TRIAL, _MOMENT)


def _half_flawed(part: Part, scale: Scale) -> Experiment:
    """An experiment of a part with half of the robots flawed."""
    return next(experiment_of(cell, scale) for cell in cells_of(part) if cell.percent == 50)


FIGURES = (
    ReportFigure(
        "confidence",
        "Local confidence alpha of an observation against b_hat",
        "2",
        frozenset(),
        lambda drawn: plots.confidence(),
    ),
    _boxes(DYNAMIC, MINUS, "3a"),
    _boxes(DYNAMIC, PLUS, "3b"),
    _boxes(FULLY_CONNECTED, MINUS, ""),
    _boxes(FULLY_CONNECTED, PLUS, ""),
    _points(DYNAMIC, "4"),
    _points(FULLY_CONNECTED, ""),
    _topologies(MINUS, "5a"),
    _topologies(PLUS, "5b"),
    ReportFigure(
        "series",
        "A fully connected trial without filter and one with ASDF+: f = 0.95, b = 0.55, b_hat = 0.95, P = 50 "
        "%, "
        f"tau = {PERIODS[0]}",
        "6",
        frozenset({FULLY_CONNECTED}),
        lambda drawn: time_plots.series_beside(drawn.series, _TRIAL),
    ),
    ReportFigure(
        "physical_paths",
        f"Paths of the robots across the code in the first {_MOMENT} steps",
        "7",
        frozenset({PHYSICAL}),
        _paths,
    ),
    _physical_scores(),
    _points(PHYSICAL, "8b"),
    _strips(FULLY_CONNECTED),
    _strips(DYNAMIC),
    _bands(FULLY_CONNECTED),
    _bands(DYNAMIC),
    ReportFigure(
        "dynamic_network",
        f"Who hears whom at step {_MOMENT}",
        "",
        frozenset({DYNAMIC}),
        _network,
    ),
)
