"""The pictures of the report are the paper's figures: each shows the swarms that the paper's shows."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from typing import Any

import pytest

from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.plots import bands, boxes, scatter, series
from mcp_asdf_tools.studies.cells import StudyPart, StudySize, cells_of, experiment_of
from mcp_asdf_tools.studies.figures import draw_pictures
from mcp_asdf_tools.studies.study_results import StudyResults
from support import slow


class ResultsWithoutTrials(StudyResults):
    """Results of parts of the study that have experiments, but nothing measured."""

    def __init__(self, parts: Collection[StudyPart]) -> None:
        super().__init__({})
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


def pictures_of(*parts: StudyPart) -> dict[str, Any]:
    study_size = StudySize(2, 4000)
    return {picture.name: picture for picture in draw_pictures(ResultsWithoutTrials(parts), study_size)}


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


def test_single_trials_are_run_again_with_records(monkeypatch: pytest.MonkeyPatch) -> None:
    recorded: list[Any] = []
    monkeypatch.setattr(series, "plot_runs", lambda runs, trial: recorded.extend(runs))
    pictures_of(StudyPart.FULLY_CONNECTED)
    assert [sorted(trials.records) for trials in recorded] == [sorted(recorded[0].records)] * 2
    assert [trials.numbers for trials in recorded] == [[0], [0]]


def test_the_title_has_the_filters_typeset_name() -> None:
    title = pictures_of(StudyPart.DYNAMIC)["dynamic_asdf-minus"].title
    assert title.startswith("H of dynamic swarms without filter and with ASDF\N{MINUS SIGN}")
