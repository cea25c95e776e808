"""The pictures of the report, after the paper's."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from matplotlib.figure import Figure

from mcp_asdf_tools.experiments import (
    MODE_NAMES,
    Experiment,
    Trials,
    arena_plots,
    experiments_in,
    plots,
    run_trials,
    table_of,
)
from mcp_asdf_tools.reproduction.comparisons import DYNAMIC, FULLY_CONNECTED, MINUS, NONE, PHYSICAL, PLUS
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

_TRIAL = 0
"""Which one is drawn over time and space."""

_POINTS = 400
"""Of a series."""


@dataclass(frozen=True)
class ReportFigure:
    """A picture of the report: its file's name, what to say below it, the parts it needs, how it is drawn."""

    name: str
    caption: str
    needs: frozenset[Part]
    draw: Callable[[Study, Scale], Figure]


def _boxes(part: Part, mode: Filtering) -> ReportFigure:
    """H without and with a filter, as figure 4; where all are flawed, ASDF- is ASDF+ and not shown twice."""

    def draw(study: Study, scale: Scale) -> Figure:
        shown = _of_modes(study, part, (NONE, mode))
        if mode is MINUS:
            shown = [each for each in shown if each.experiment.flawed < each.experiment.robots]
        return plots.boxes(shown)

    caption = f"H of {PART_NAMES[part]} swarms without filter and with {MODE_NAMES[mode]} (paper: figure 4)."
    return ReportFigure(f"{part.value}_{mode.value}", caption, frozenset({part}), draw)


def _points(part: Part) -> ReportFigure:
    """h_e against h_K, as figure 5."""

    def draw(study: Study, scale: Scale) -> Figure:
        shown = [each for each in study.of(part) if each.experiment.filter_period == PERIODS[0]]
        return plots.scatter(shown)

    words = f"Accuracy against convergence of {PART_NAMES[part]} swarms, tau = {PERIODS[0]}"
    caption = f"{words} (paper: figure 5)."
    return ReportFigure(f"{part.value}_scatter", caption, frozenset({part}), draw)


def _topologies(mode: Filtering) -> ReportFigure:
    """Dynamic beside fully connected, as figure 6."""

    def name(experiment: Experiment) -> str:
        return f"{'dynamic' if experiment.is_dynamic else 'fully connected'}, {MODE_NAMES[experiment.filter]}"

    def draw(study: Study, scale: Scale) -> Figure:
        shown = [
            each
            for part in (DYNAMIC, FULLY_CONNECTED)
            for each in _of_modes(study, part, (NONE, mode))
            if each.experiment.filter_period == PERIODS[0]
        ]
        return plots.boxes(shown, name=name)

    words = f"H in both topologies without filter and with {MODE_NAMES[mode]}, tau = {PERIODS[0]}"
    caption = f"{words} (paper: figure 6)."
    return ReportFigure(f"topologies_{mode.value}", caption, frozenset({DYNAMIC, FULLY_CONNECTED}), draw)


def _of_modes(study: Study, part: Part, modes: Sequence[Filtering]) -> list[Trials]:
    return [each for mode in modes for each in study.of(part) if each.experiment.filter is mode]


def _series(study: Study, scale: Scale) -> Figure:
    cell = Cell(FULLY_CONNECTED, 0.95, 0.55, 0.95, 50)
    runs = [_recorded(experiment_of(cell.but(mode=mode), scale)) for mode in (NONE, PLUS)]
    return plots.series_beside(runs, _TRIAL)


def _recorded(experiment: Experiment) -> Trials:
    """The drawn trial once more, with its values over time."""
    sampling_interval = max(1, experiment.steps // _POINTS)
    measured = run_trials(experiment, _TRIAL, 1, sampling_interval)
    (trials,) = experiments_in(table_of(replace(experiment, trials=1), measured, sampling_interval))
    return trials


def _paths(study: Study, scale: Scale) -> Figure:
    return arena_plots.trajectories(_half_flawed(PHYSICAL, scale), _TRIAL, min(1000, scale.steps))


def _network(study: Study, scale: Scale) -> Figure:
    return arena_plots.network(_half_flawed(DYNAMIC, scale), _TRIAL, min(1000, scale.steps))


def _half_flawed(part: Part, scale: Scale) -> Experiment:
    """An experiment of a part with half of the robots flawed."""
    return next(experiment_of(cell, scale) for cell in cells_of(part) if cell.percent == 50)


FIGURES = [
    *(_boxes(part, mode) for part in (FULLY_CONNECTED, DYNAMIC) for mode in (MINUS, PLUS)),
    _points(FULLY_CONNECTED),
    _points(DYNAMIC),
    _topologies(MINUS),
    _topologies(PLUS),
    ReportFigure(
        "fully_connected_series",
        "A trial without filter and one with ASDF+: f = 0.95, b = 0.55, b_hat = 0.95, P = 50 %, tau = 1000 "
        "(paper: figure 7).",
        frozenset({FULLY_CONNECTED}),
        _series,
    ),
    ReportFigure("dynamic_network", "Who hears whom at one moment.", frozenset({DYNAMIC}), _network),
    _boxes(PHYSICAL, PLUS),
    _points(PHYSICAL),
    ReportFigure("physical_paths", "The robots' first paths across the code.", frozenset({PHYSICAL}), _paths),
]
