"""The paper's figures, drawn from the results of the study.

The symbols are the paper's. Each robot estimates f, the share of black floor, as x, and b_hat is the accuracy
that it assumes for its sensor, whose true accuracy is b. A flawed robot starts with a wrong b_hat; P is the
percentage of flawed robots in a swarm. With a filter, robots correct their b_hat every tau steps: with ASDF-
only the flawed robots do, with ASDF+ all do. h_e is a trial's score for accuracy, h_K its score for speed of
convergence, and H their mean, each from 0 to 100.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

from matplotlib.figure import Figure

from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.plots import boxes, scatter, series
from mcp_asdf_tools.experiments.results import Trials
from mcp_asdf_tools.experiments.trials import run_trials
from mcp_asdf_tools.robots.filters import FILTERS
from mcp_asdf_tools.studies.cells import (
    PAPERS_FIRMWARE,
    SHORTEST_FILTER_PERIOD,
    Cell,
    StudyPart,
    StudySize,
    cell_of,
    experiment_of,
)
from mcp_asdf_tools.studies.study_results import StudyResults

NO_FILTER: str = "none"
ASDF_MINUS: str = "asdf-minus"
ASDF_PLUS: str = "asdf-plus"
"""Values of ``Experiment.filter``: no robot filters, only the flawed robots do, or all do."""

PAPER_FIGURES = {
    "dynamic_asdf-minus": "3a",
    "dynamic_asdf-plus": "3b",
    "dynamic_scatter": "4",
    "topologies_asdf-minus": "5a",
    "topologies_asdf-plus": "5b",
    "series": "6",
    "physical_asdf-plus": "8a",
    "physical_scatter": "8b",
}
"""Numbers of the paper's figures, by the name of the picture that shows the same."""

SERIES_CELL = Cell(
    study_part=StudyPart.FULLY_CONNECTED,
    fill_ratio=0.95,
    true_accuracy=0.55,
    flawed_accuracy=0.95,
    flawed_percent=50,
    filter=NO_FILTER,
)
"""The swarm of which the paper's figure 6 shows a trial, without a filter."""

SERIES_TRIAL = 0
"""Number of the trial of this swarm that the picture shows."""

SERIES_SAMPLING_INTERVAL = 100
"""Steps between two values of a robot in the picture of single trials."""


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


def _make_picture(name: str, title: str, figure: Figure) -> Picture:
    """Return a picture, with the number of the paper's figure added to its title if it has one."""
    if name in PAPER_FIGURES:
        title += f" (the paper's figure {PAPER_FIGURES[name]})"
    return Picture(name, title, figure)


def _trials_of_users_filter(
    study_results: StudyResults, study_part: StudyPart, filter_name: str
) -> list[Trials]:
    """Return the trials of the user's firmware or filter that stand beside the paper's filter in a picture.

    ``filter_name`` is the paper's filter, ASDF- or ASDF+. A filter of the user's stands beside either, a
    firmware of the user's only beside the filter that it ran with.
    """
    selected: list[Trials] = []
    for trials in study_results.users_trials_of(study_part):
        is_users_filter = trials.experiment.filter not in (ASDF_MINUS, ASDF_PLUS)
        if is_users_filter:
            selected.append(trials)
        elif _counts_as(trials.experiment, study_part, filter_name):
            selected.append(_with_filter(trials, filter_name))
    return selected


def _counts_as(experiment: Experiment, study_part: StudyPart, filter_name: str) -> bool:
    """Return whether an experiment of a part has a filter, or would have the same results with it.

    With ASDF- only flawed robots filter. So it is no filter where no robot is flawed, and it is ASDF+ where
    all are: the study has run these swarms once, under the name that ``Cell.normal`` chooses.
    """
    cell = cell_of(study_part, experiment)
    return replace(cell, filter=filter_name).normal == cell


def _with_filter(trials: Trials, filter_name: str) -> Trials:
    """Return trials with another filter in their experiment, with which they would have the same results."""
    return replace(trials, experiment=replace(trials.experiment, filter=filter_name))


def _name_in_words(experiment: Experiment) -> str:
    """Return the name of an experiment's filter, with a firmware of the user's, such as "beta, ASDF+"."""
    term = experiment.swarm_filter.typeset_term
    if experiment.firmware == PAPERS_FIRMWARE:
        return term
    return f"{experiment.firmware}, {term}"


def draw_pictures(study_results: StudyResults, study_size: StudySize) -> Iterator[Picture]:
    """Draw the pictures of all parts of the study that have results, one after the other.

    A picture of two parts is drawn only if both have results. The picture of single trials needs values over
    time, which the results do not have: for this picture a few trials of ``study_size.steps`` run again.
    """
    parts = study_results.parts
    for study_part in (StudyPart.DYNAMIC, StudyPart.FULLY_CONNECTED):
        if study_part in parts:
            yield _draw_score_boxes(study_results, study_part, ASDF_MINUS)
            yield _draw_score_boxes(study_results, study_part, ASDF_PLUS)
            yield from _draw_score_scatters(study_results, study_part)
    if StudyPart.DYNAMIC in parts and StudyPart.FULLY_CONNECTED in parts:
        yield _draw_boxes_by_topology(study_results, ASDF_MINUS)
        yield _draw_boxes_by_topology(study_results, ASDF_PLUS)
    if StudyPart.FULLY_CONNECTED in parts:
        yield _draw_single_trials(study_results, study_size)
    # Of physical robots the paper has only boxes and scatters, figures 8a and 8b.
    if StudyPart.PHYSICAL in parts:
        yield _draw_score_boxes(study_results, StudyPart.PHYSICAL, ASDF_PLUS)
        yield from _draw_score_scatters(study_results, StudyPart.PHYSICAL)


def _select_by_filter(
    study_results: StudyResults, study_part: StudyPart, filter_names: Sequence[str]
) -> list[Trials]:
    """Return the trials of a part's experiments with these filters, in the order of ``filter_names``."""
    trials_of_part = study_results.trials_of(study_part)
    selected: list[Trials] = []
    for filter_name in filter_names:
        selected += [trials for trials in trials_of_part if trials.experiment.filter == filter_name]
    return selected


def _select_with_shortest_period(
    study_results: StudyResults, study_part: StudyPart, filter_names: Sequence[str]
) -> list[Trials]:
    """Return the trials of a part's experiments that count as ones with a filter of ``filter_names``.

    ``_counts_as`` decides that. Experiments with a longer filter period than the shortest are left out.
    """
    selected: list[Trials] = []
    for filter_name in filter_names:
        for trials in study_results.trials_of(study_part):
            # Experiments without a filter state the shortest period, too.
            has_shortest_period = trials.experiment.filter_period == SHORTEST_FILTER_PERIOD
            if has_shortest_period and _counts_as(trials.experiment, study_part, filter_name):
                selected.append(_with_filter(trials, filter_name))
    return selected


def _all_flawed(experiment: Experiment) -> bool:
    """Return whether all robots of an experiment are flawed."""
    return bool(experiment.flawed == experiment.robots)


def _draw_score_boxes(study_results: StudyResults, study_part: StudyPart, filter_name: str) -> Picture:
    """Draw box plots of H, a trial's score from 0 to 100, of a part's swarms without and with a filter.

    A box shows the trials of one experiment; there are boxes of the user's firmware or filter, too. With
    ASDF- swarms of which all robots are flawed are left out.
    """
    experiments = _select_by_filter(study_results, study_part, [NO_FILTER, filter_name])
    users_trials = _trials_of_users_filter(study_results, study_part, filter_name)
    if filter_name == ASDF_MINUS:
        # Where all robots are flawed, ASDF- is ASDF+, whose picture shows these swarms.
        experiments = [trials for trials in experiments if not _all_flawed(trials.experiment)]
        users_trials = [trials for trials in users_trials if not _all_flawed(trials.experiment)]
    return _make_picture(
        name=f"{study_part.value}_{filter_name}",
        title=f"H of {study_part.label} swarms without filter and with {FILTERS[filter_name].typeset_term}",
        figure=boxes.plot_boxes([*experiments, *users_trials], series_name=_filter_and_period),
    )


def _filter_and_period(experiment: Experiment) -> str:
    """Return the legend's label of an experiment by its filter, such as "ASDF+, filter period 1000".

    Without a filter it has no period.
    """
    name = _name_in_words(experiment)
    if not experiment.swarm_filter.is_on:
        return name
    return f"{name}, filter period {experiment.filter_period}"


def _draw_score_scatters(study_results: StudyResults, study_part: StudyPart) -> Iterator[Picture]:
    """Draw h_e, a trial's score for accuracy, against h_K, its score for speed, of all trials of a part.

    It shows swarms without a filter, and with ASDF- and ASDF+ where their period tau is the shortest one. A
    firmware or filter of the user's has a picture for itself, since both would not fit.
    """
    experiments = _select_with_shortest_period(study_results, study_part, [NO_FILTER, ASDF_MINUS, ASDF_PLUS])
    yield _make_picture(
        name=f"{study_part.value}_scatter",
        title=f"Accuracy against convergence of {study_part.label} swarms, tau = {SHORTEST_FILTER_PERIOD}",
        figure=scatter.plot_scatter(experiments),
    )
    users_trials = study_results.users_trials_of(study_part)
    if users_trials:
        users_name = study_results.users_name
        yield _make_picture(
            name=f"{study_part.value}_scatter_{users_name}",
            title=f"The same with {users_name}",
            figure=scatter.plot_scatter(users_trials),
        )


def _draw_boxes_by_topology(study_results: StudyResults, filter_name: str) -> Picture:
    """Draw box plots of H, a trial's score from 0 to 100, of dynamic swarms beside fully connected ones.

    In a dynamic swarm robots move and reach only those nearby. Both kinds are shown without a filter and with
    this filter, whose period tau is the shortest one.
    """
    experiments: list[Trials] = []
    for study_part in (StudyPart.DYNAMIC, StudyPart.FULLY_CONNECTED):
        experiments += _select_with_shortest_period(study_results, study_part, [NO_FILTER, filter_name])
        experiments += _trials_of_users_filter(study_results, study_part, filter_name)
    filters_shown = f"without filter and with {FILTERS[filter_name].typeset_term}"
    return _make_picture(
        name=f"topologies_{filter_name}",
        title=f"H in both topologies {filters_shown}, tau = {SHORTEST_FILTER_PERIOD}",
        figure=boxes.plot_boxes(experiments, series_name=_topology_and_filter),
    )


def _topology_and_filter(experiment: Experiment) -> str:
    """Return the legend's label of an experiment by its topology and filter, such as "dynamic, ASDF+"."""
    topology = "dynamic" if experiment.is_dynamic else "fully connected"
    return f"{topology}, {_name_in_words(experiment)}"


def _draw_single_trials(study_results: StudyResults, study_size: StudySize) -> Picture:
    """Draw what each robot estimates and assumes over time, in one trial without a filter and one with ASDF+.

    With a firmware or filter of the user's there is one with that, too. All are trial SERIES_TRIAL of the
    swarm of SERIES_CELL. They are run again here with the steps and the seed of ``study_size``,
    and recorded every SERIES_SAMPLING_INTERVAL steps.
    """
    experiments = [
        experiment_of(SERIES_CELL, study_size),
        experiment_of(replace(SERIES_CELL, filter=ASDF_PLUS), study_size),
        *_users_experiments_of_series(study_results),
    ]
    # The study keeps no values over time, but a trial that is run again gives the same values.
    recorded = [
        run_trials(experiment, SERIES_TRIAL, trials=1, sampling_interval=SERIES_SAMPLING_INTERVAL)
        for experiment in experiments
    ]
    return _make_picture(
        name="series",
        title="A trial without filter and one with ASDF+: f = 0.95, b = 0.55, b_hat = 0.95, P = 50 %",
        figure=series.plot_runs(recorded, SERIES_TRIAL),
    )


def _users_experiments_of_series(study_results: StudyResults) -> list[Experiment]:
    """Return the experiments of the user's firmware or filter with the swarm of SERIES_CELL, if any."""
    users_trials = _trials_of_users_filter(study_results, SERIES_CELL.study_part, ASDF_PLUS)
    experiments = []
    for trials in users_trials:
        cell = cell_of(SERIES_CELL.study_part, trials.experiment)
        # SERIES_CELL has no filter, so swarms are compared with it without theirs.
        is_swarm_of_series = replace(cell, filter=NO_FILTER) == SERIES_CELL
        if is_swarm_of_series:
            experiments.append(trials.experiment)
    return experiments
