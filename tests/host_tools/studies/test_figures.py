"""The pictures of the report are the paper's figures: each shows the swarms that the paper's shows."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from typing import Any

import pytest

from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.plots import bands, boxes, scatter, series
from mcp_asdf_tools.studies.cells import StudyPart, StudySize, cells_of, experiment_of, own_experiments_of
from mcp_asdf_tools.studies.figures import draw_pictures
from mcp_asdf_tools.studies.study_results import StudyResults
from support import slow


class ResultsWithoutTrials(StudyResults):
    """Results of parts of the study that have experiments, but nothing measured."""

    def __init__(self, parts: Collection[StudyPart], firmware: str, own_filter: str | None) -> None:
        own: dict[StudyPart, Any] = {}
        if (firmware, own_filter) != ("native", None):
            for study_part in parts:
                experiments = own_experiments_of(study_part, StudySize(2, 4000), firmware, own_filter)
                own[study_part] = [ExperimentOnly(experiment) for experiment in experiments]
        super().__init__({}, own)
        self._parts = [study_part for study_part in StudyPart if study_part in parts]

    @property
    def parts(self) -> list[StudyPart]:
        return self._parts

    def trials_of(self, study_part: StudyPart) -> list[Any]:
        return [ExperimentOnly(experiment_of(cell, StudySize())) for cell in cells_of(study_part)]


@dataclass
class ExperimentOnly:
    """Stands for the trials of an experiment."""

    experiment: Experiment


@dataclass
class DrawnSwarms:
    """The parameters of the swarms that a plot was asked to draw, in place of the picture."""

    filters: set[str]
    periods: set[int]
    percents: set[int]
    names: set[str]
    filters_and_percents: set[tuple[str, int]]


def record_drawn_swarms(
    experiments: Sequence[Any],
    trial: int = 0,
    series_name: Callable[[Experiment], str] = lambda experiment: "",
) -> DrawnSwarms:
    swarms = [trials.experiment for trials in experiments]
    percents = [round(100 * swarm.flawed / swarm.robots) for swarm in swarms]
    filters = [swarm.filter for swarm in swarms]
    return DrawnSwarms(
        set(filters),
        {swarm.filter_period for swarm in swarms},
        set(percents),
        {series_name(swarm) for swarm in swarms},
        set(zip(filters, percents, strict=True)),
    )


@pytest.fixture(autouse=True)
def plots_that_record_swarms(monkeypatch: pytest.MonkeyPatch) -> None:
    for module, function in (
        (boxes, "plot_boxes"),
        (scatter, "plot_scatter"),
        (bands, "plot_bands"),
        (series, "plot_runs"),
    ):
        monkeypatch.setattr(module, function, record_drawn_swarms)


def pictures_of(*parts: StudyPart, firmware: str = "native", own_filter: str | None = None) -> dict[str, Any]:
    results = ResultsWithoutTrials(parts, firmware, own_filter)
    return {picture.name: picture for picture in draw_pictures(results, StudySize(2, 4000))}


@pytest.mark.parametrize(
    ("parts", "count"),
    [
        ([StudyPart.DYNAMIC], 4),
        ([StudyPart.FULLY_CONNECTED], 5),
        ([StudyPart.PHYSICAL], 2),
        (list(StudyPart), 13),
    ],
)
def test_pictures_are_of_the_parts_that_were_run(parts: list[StudyPart], count: int) -> None:
    assert len(pictures_of(*parts)) == count


def test_titles_have_the_numbers_of_the_papers_figures() -> None:
    numbers = {
        name: re.findall(r"figure (\w+)\)$", picture.title)
        for name, picture in pictures_of(*StudyPart).items()
    }

    assert {name: number[0] for name, number in numbers.items() if number} == {
        "dynamic_asdf-minus": "3a",
        "dynamic_asdf-plus": "3b",
        "dynamic_scatter": "4",
        "topologies_asdf-minus": "5a",
        "topologies_asdf-plus": "5b",
        "series": "6",
        "physical_asdf-plus": "8a",
        "physical_scatter": "8b",
    }


ANY_PERIOD = {1000, 2000, 4000}
SHORTEST = {1000}


@pytest.mark.parametrize(
    ("name", "filters", "periods", "percents"),
    [
        ("dynamic_asdf-minus", {"none", "asdf-minus"}, ANY_PERIOD, {0, 10, 30, 50}),
        ("fully_connected_bands", {"asdf-plus"}, SHORTEST, {10, 30, 50}),
        *slow(
            [
                ("dynamic_asdf-plus", {"none", "asdf-plus"}, ANY_PERIOD, {0, 10, 30, 50, 100}),
                ("dynamic_scatter", {"none", "asdf-minus", "asdf-plus"}, SHORTEST, {0, 10, 30, 50, 100}),
                ("topologies_asdf-minus", {"none", "asdf-minus"}, SHORTEST, {0, 10, 30, 50, 100}),
                ("series", {"none", "asdf-plus"}, SHORTEST, {50}),
                ("physical_asdf-plus", {"none", "asdf-plus"}, SHORTEST, {0, 25, 50, 100}),
            ]
        ),
    ],
)
def test_a_picture_shows_the_swarms_of_the_papers_figure(
    name: str, filters: set[str], periods: set[int], percents: set[int]
) -> None:
    drawn = pictures_of(*StudyPart)[name].figure
    assert (drawn.filters, drawn.periods, drawn.percents) == (filters, periods, percents)


def test_topologies_and_filters_are_named_in_the_legend() -> None:
    assert pictures_of(*StudyPart)["topologies_asdf-plus"].figure.names == {
        "dynamic, no filter",
        "dynamic, ASDF+",
        "fully connected, no filter",
        "fully connected, ASDF+",
    }


@pytest.mark.parametrize("name", ["dynamic_scatter", *slow(["topologies_asdf-minus"])])
def test_asdf_minus_is_also_shown_where_it_is_another_filter(name: str) -> None:
    drawn = pictures_of(*StudyPart)[name].figure
    assert {("asdf-minus", 0), ("asdf-minus", 100)} <= drawn.filters_and_percents


def test_trials_drawn_over_time_are_run_again_with_recorded_values(monkeypatch: pytest.MonkeyPatch) -> None:
    """The results of a study have no values over time. Trial 0 is drawn without a filter, and with ASDF+."""
    recorded: list[Any] = []
    monkeypatch.setattr(series, "plot_runs", lambda runs, trial: recorded.extend(runs))
    pictures_of(StudyPart.FULLY_CONNECTED)

    without_filter, with_filter = recorded
    assert sorted(without_filter.records) == sorted(with_filter.records)
    assert without_filter.numbers == with_filter.numbers == [0]


def test_the_title_has_the_filters_typeset_name() -> None:
    title = pictures_of(StudyPart.DYNAMIC)["dynamic_asdf-minus"].title
    assert title.startswith("H of dynamic swarms without filter and with ASDF\N{MINUS SIGN}")


# --- A firmware or filter of the user's ------------------------------------------------------------------

NO_FILTER, MINUS, PLUS = "no filter", "ASDF\N{MINUS SIGN}", "ASDF+"


@pytest.mark.parametrize(
    ("name", "own_filter", "names"),
    [
        *slow(
            [
                (
                    "dynamic_asdf-minus",
                    None,
                    {
                        NO_FILTER,
                        *(f"{MINUS}, filter period {period}" for period in ANY_PERIOD),
                        f"reference, {MINUS}, filter period 1000",
                    },
                ),
                (
                    "topologies_asdf-plus",
                    None,
                    {
                        f"{topology}, {name}"
                        for topology in ("dynamic", "fully connected")
                        for name in (NO_FILTER, PLUS, f"reference, {PLUS}")
                    },
                ),
                (
                    "topologies_asdf-minus",
                    "robust",
                    {
                        f"{topology}, {name}"
                        for topology in ("dynamic", "fully connected")
                        for name in (NO_FILTER, MINUS, "robust")
                    },
                ),
            ]
        ),
        (
            "physical_asdf-plus",
            "robust",
            {NO_FILTER, f"{PLUS}, filter period 1000", "robust, filter period 1000"},
        ),
    ],
)
def test_the_users_filter_stands_beside_the_papers(
    name: str, own_filter: str | None, names: set[str]
) -> None:
    firmware = "reference" if own_filter is None else "native"
    assert pictures_of(*StudyPart, firmware=firmware, own_filter=own_filter)[name].figure.names == names


@pytest.mark.slow
def test_a_firmware_where_all_are_flawed_is_shown_with_asdf_minus_too() -> None:
    drawn = pictures_of(*StudyPart, firmware="reference")["topologies_asdf-minus"].figure
    assert ("asdf-minus", 100) in drawn.filters_and_percents
    assert ("asdf-plus", 100) not in drawn.filters_and_percents


def test_the_users_filter_has_points_and_a_trial_for_itself() -> None:
    pictures = pictures_of(*StudyPart, own_filter="robust")
    assert pictures["dynamic_scatter_robust"].figure.filters == {"robust"}
    assert pictures["dynamic_scatter"].figure.filters == {"none", "asdf-minus", "asdf-plus"}
    assert pictures["series"].figure.filters == {"none", "asdf-plus", "robust"}
