"""The paper's figures, drawn from the results of the study."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

from matplotlib.figure import Figure

from mcp_asdf_tools.experiments import score_plots, time_plots
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.results import Trials
from mcp_asdf_tools.experiments.trials import run_trials
from mcp_asdf_tools.robots.filters import FILTERS
from mcp_asdf_tools.studies.cells import FILTER_PERIODS, Cell, StudyPart, StudySize, experiment_of
from mcp_asdf_tools.studies.study_results import StudyResults

NONE: str = "none"
MINUS: str = "asdf-minus"
PLUS: str = "asdf-plus"

SHORTEST_PERIOD = FILTER_PERIODS[0]
SERIES_CELL = Cell(StudyPart.FULLY_CONNECTED, 0.95, 0.55, 0.95, 50)
SERIES_SAMPLING_INTERVAL = 100


@dataclass(frozen=True)
class Picture:
    """A picture of the report.

    Attributes:
        name: Name of its file, without a suffix.
        title: What it shows, with the number of the paper's figure if it follows one.
        figure: The drawing.
    """

    name: str
    title: str
    figure: Figure


def draw_pictures(study_results: StudyResults, study_size: StudySize) -> Iterator[Picture]:
    """Draw all pictures of the parts of which there are results; that of single trials runs two again."""
    if StudyPart.DYNAMIC in study_results.parts:
        yield _draw_boxes(study_results, StudyPart.DYNAMIC, MINUS, "3a")
        yield _draw_boxes(study_results, StudyPart.DYNAMIC, PLUS, "3b")
        yield _draw_scatter(study_results, StudyPart.DYNAMIC, "4")
        yield _draw_bands(study_results, StudyPart.DYNAMIC)
    if StudyPart.FULLY_CONNECTED in study_results.parts:
        yield _draw_boxes(study_results, StudyPart.FULLY_CONNECTED, MINUS)
        yield _draw_boxes(study_results, StudyPart.FULLY_CONNECTED, PLUS)
        yield _draw_scatter(study_results, StudyPart.FULLY_CONNECTED)
        yield _draw_bands(study_results, StudyPart.FULLY_CONNECTED)
    if {StudyPart.DYNAMIC, StudyPart.FULLY_CONNECTED} <= set(study_results.parts):
        yield _draw_topologies(study_results, MINUS, "5a")
        yield _draw_topologies(study_results, PLUS, "5b")
    if StudyPart.FULLY_CONNECTED in study_results.parts:
        yield _draw_series(study_size)
    if StudyPart.PHYSICAL in study_results.parts:
        yield _draw_boxes(study_results, StudyPart.PHYSICAL, PLUS, "8a")
        yield _draw_scatter(study_results, StudyPart.PHYSICAL, "8b")


def _trials_with(study_results: StudyResults, study_part: StudyPart, *filters: str) -> list[Trials]:
    """Return the trials of a part with any of these filters, filter by filter."""
    return [
        trials
        for filter_name in filters
        for trials in study_results.trials_of(study_part)
        if trials.experiment.filter == filter_name
    ]


def _with_shortest_period(experiments: list[Trials]) -> list[Trials]:
    """Keep the experiments with the shortest filtering period, and those without a filter."""
    return [
        trials
        for trials in experiments
        if trials.experiment.filter == NONE or trials.experiment.filter_period == SHORTEST_PERIOD
    ]


def _ends_of_asdf_minus(study_results: StudyResults, study_part: StudyPart) -> list[Trials]:
    """Return the experiments with ASDF- where no robot is flawed, and where all are.

    They have been run under other names: without flawed robots nobody filters, with flawed ones alone all do.
    """
    unfiltered = _trials_with(study_results, study_part, NONE)
    filtered = _with_shortest_period(_trials_with(study_results, study_part, PLUS))
    ends = [trials for trials in unfiltered if trials.experiment.flawed == 0]
    ends += [trials for trials in filtered if trials.experiment.flawed == trials.experiment.robots]
    return [replace(trials, experiment=replace(trials.experiment, filter=MINUS)) for trials in ends]


def _number_of_paper(number: str) -> str:
    """Return the end of a title that follows a figure of the paper; empty if it follows none."""
    return f" (the paper's figure {number})" if number else ""


def _draw_boxes(
    study_results: StudyResults, study_part: StudyPart, filter_name: str, number: str = ""
) -> Picture:
    """Draw H without and with a filter."""
    experiments = _trials_with(study_results, study_part, NONE, filter_name)
    if filter_name == MINUS:
        # Where all robots are flawed ASDF- is ASDF+, which has a picture of its own.
        experiments = [
            trials for trials in experiments if trials.experiment.flawed < trials.experiment.robots
        ]
    title = f"H of {study_part.label} swarms without filter and with {FILTERS[filter_name].typeset_term}"
    name = f"{study_part.value}_{filter_name}"
    return Picture(name, title + _number_of_paper(number), score_plots.plot_boxes(experiments))


def _draw_scatter(study_results: StudyResults, study_part: StudyPart, number: str = "") -> Picture:
    """Draw h_e against h_K of all filters, with the shortest filtering period."""
    experiments = _with_shortest_period(_trials_with(study_results, study_part, NONE, MINUS, PLUS))
    experiments += _ends_of_asdf_minus(study_results, study_part)
    title = f"Accuracy against convergence of {study_part.label} swarms, tau = {SHORTEST_PERIOD}"
    return Picture(
        f"{study_part.value}_scatter", title + _number_of_paper(number), score_plots.plot_scatter(experiments)
    )


def _draw_bands(study_results: StudyResults, study_part: StudyPart) -> Picture:
    """Draw b_hat over time in swarms of which some robots are flawed and all filter."""
    experiments = [
        trials
        for trials in _with_shortest_period(_trials_with(study_results, study_part, PLUS))
        if 0 < trials.experiment.flawed < trials.experiment.robots
    ]
    title = f"b_hat of all robots of {study_part.label} swarms with ASDF+, tau = {SHORTEST_PERIOD}"
    return Picture(f"{study_part.value}_bands", title, time_plots.plot_accuracy_bands(experiments))


def _draw_topologies(study_results: StudyResults, filter_name: str, number: str) -> Picture:
    """Draw H of dynamic swarms beside that of fully connected ones, without and with a filter."""
    experiments: list[Trials] = []
    for study_part in (StudyPart.DYNAMIC, StudyPart.FULLY_CONNECTED):
        experiments += _with_shortest_period(_trials_with(study_results, study_part, NONE, filter_name))
        if filter_name == MINUS:
            experiments += _ends_of_asdf_minus(study_results, study_part)

    def series_name(experiment: Experiment) -> str:
        topology = "dynamic" if experiment.is_dynamic else "fully connected"
        return f"{topology}, {experiment.swarm_filter.typeset_term}"

    with_filter = f"without filter and with {FILTERS[filter_name].typeset_term}, tau = {SHORTEST_PERIOD}"
    title = f"H in both topologies {with_filter}{_number_of_paper(number)}"
    return Picture(
        f"topologies_{filter_name}", title, score_plots.plot_boxes(experiments, series_name=series_name)
    )


def _draw_series(study_size: StudySize) -> Picture:
    """Run one trial without and one with a filter again, recorded, and draw their values over time."""
    # The study keeps no values over time, but trials are reproducible: two are enough to record again.
    unfiltered = experiment_of(SERIES_CELL, study_size)
    filtered = experiment_of(replace(SERIES_CELL, filter=PLUS), study_size)
    recorded = [run_trials(e, 0, 1, SERIES_SAMPLING_INTERVAL) for e in (unfiltered, filtered)]
    title = "A trial without filter and one with ASDF+: f = 0.95, b = 0.55, b_hat = 0.95, P = 50 %"
    return Picture("series", title + _number_of_paper("6"), time_plots.plot_series(recorded, 0))
