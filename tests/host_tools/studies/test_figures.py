"""The pictures of the report are the paper's figures: each shows the swarms that the paper's shows."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import pytest

from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.plots import boxes, scatter, series
from mcp_asdf_tools.studies.cells import StudyPart, StudySize, cells_of, experiment_of, users_experiments_of
from mcp_asdf_tools.studies.figures import Picture, draw_pictures
from mcp_asdf_tools.studies.study_results import StudyResults
from paper_figures import rows_by_figure_of_the_paper

SHORT_STUDY = StudySize(trials=2, steps=100)


@dataclass
class ExperimentOnly:
    """An object in place of trials, which has nothing of them but their experiment."""

    experiment: Experiment


class ResultsWithoutTrials(StudyResults):
    """Results of parts of the study that have experiments, but nothing measured."""

    def __init__(self, parts: Collection[StudyPart], firmware: str, own_filter: str | None) -> None:
        own: dict[StudyPart, Any] = {}
        if (firmware, own_filter) != ("native", None):
            for study_part in parts:
                experiments = users_experiments_of(study_part, SHORT_STUDY, firmware, own_filter)
                own[study_part] = [ExperimentOnly(experiment) for experiment in experiments]
        super().__init__({}, own)
        self._parts = [study_part for study_part in StudyPart if study_part in parts]

    @property
    def parts(self) -> list[StudyPart]:
        return self._parts

    def trials_of(self, study_part: StudyPart) -> list[Any]:
        return [ExperimentOnly(experiment) for experiment in papers_experiments_of(study_part)]


@cache
def papers_experiments_of(study_part: StudyPart) -> list[Experiment]:
    return [experiment_of(cell, StudySize()) for cell in cells_of(study_part)]


@dataclass
class DrawnSwarms:
    """What a plot was asked to draw, in place of the drawing.

    Attributes:
        results: The trials of the swarms.
        legend: The names of the swarms in the legend.
        filters: Which robots filter.
        periods: Steps from one filter step to the next.
        percents: Percentages of flawed robots.
        filters_and_percents: Pairs of them that a swarm has.
    """

    results: Sequence[Any]
    legend: set[str]
    filters: set[str]
    periods: set[int]
    percents: set[int]
    filters_and_percents: set[tuple[str, int]]


def record_drawn_swarms(
    results: Sequence[Any], trial: int = 0, series_name: Callable[[Experiment], str] = lambda experiment: ""
) -> DrawnSwarms:
    swarms = [trials.experiment for trials in results]
    percents = [round(100 * swarm.flawed / swarm.robots) for swarm in swarms]
    filters = [swarm.filter for swarm in swarms]
    return DrawnSwarms(
        results=results,
        legend={series_name(swarm) for swarm in swarms},
        filters=set(filters),
        periods={swarm.filter_period for swarm in swarms},
        percents=set(percents),
        filters_and_percents=set(zip(filters, percents, strict=True)),
    )


@cache
def pictures_of(
    *parts: StudyPart, firmware: str = "native", own_filter: str | None = None
) -> dict[str, Picture]:
    """Return the pictures of parts of the study by name; in place of its figure each has DrawnSwarms."""
    results = ResultsWithoutTrials(parts, firmware, own_filter)
    with pytest.MonkeyPatch.context() as patch:
        for module, function in (
            (boxes, "plot_boxes"),
            (scatter, "plot_scatter"),
            (series, "plot_runs"),
        ):
            patch.setattr(module, function, record_drawn_swarms)
        return {picture.name: picture for picture in draw_pictures(results, SHORT_STUDY)}


def swarms_in_picture(name: str, firmware: str = "native", own_filter: str | None = None) -> Any:
    """Return what a picture of the whole study shows, also with a firmware or a filter of the user's."""
    return pictures_of(*StudyPart, firmware=firmware, own_filter=own_filter)[name].figure


# --- The paper's figures ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("parts", "count"),
    [
        ([StudyPart.DYNAMIC], 3),
        ([StudyPart.FULLY_CONNECTED], 4),
        ([StudyPart.PHYSICAL], 2),
        (list(StudyPart), 11),
    ],
)
def test_a_study_of_some_parts_of_the_papers_has_the_pictures_of_these_parts(
    parts: list[StudyPart], count: int
) -> None:
    """Two of the 11 pictures compare fully connected swarms with dynamic ones, so they need both parts."""
    pictures_by_name = pictures_of(*parts)
    assert len(pictures_by_name) == count


def test_titles_of_pictures_have_the_number_of_the_papers_figure_that_docs_reproduce_md_says() -> None:
    """The page has a table. A row names a figure of the paper, and the pictures that are like this figure.

    The title of a picture ends in a text such as "(the paper's figure 3a)". The last row is about all figures
    and is left out.
    """
    rows = rows_by_figure_of_the_paper()
    assert list(rows) == ["3", "4", "5", "6", "8", "all"]
    del rows["all"]
    titles = {f"{picture.name}.png": picture.title for picture in pictures_of(*StudyPart).values()}
    for figure, row in rows.items():
        # Where a figure of the paper has two parts as pictures, these are "a" and "b".
        numbers = [figure] if len(row.pictures) == 1 else [f"{figure}a", f"{figure}b"]
        for file_name, number in zip(row.pictures, numbers, strict=True):
            assert titles[file_name].endswith(f" (the paper's figure {number})")


ALL_PERIODS = {1000, 2000, 4000}
SHORTEST_PERIOD = {1000}


@pytest.mark.parametrize(
    ("name", "filters", "periods", "percents"),
    [
        ("dynamic_asdf-minus", {"none", "asdf-minus"}, ALL_PERIODS, {0, 10, 30, 50}),
        ("dynamic_asdf-plus", {"none", "asdf-plus"}, ALL_PERIODS, {0, 10, 30, 50, 100}),
        ("dynamic_scatter", {"none", "asdf-minus", "asdf-plus"}, SHORTEST_PERIOD, {0, 10, 30, 50, 100}),
        ("topologies_asdf-minus", {"none", "asdf-minus"}, SHORTEST_PERIOD, {0, 10, 30, 50, 100}),
        ("series", {"none", "asdf-plus"}, SHORTEST_PERIOD, {50}),
        ("physical_asdf-plus", {"none", "asdf-plus"}, SHORTEST_PERIOD, {0, 25, 50, 100}),
    ],
)
def test_a_picture_shows_the_filters_periods_and_percentages_of_flawed_robots_of_the_papers_figure(
    name: str, filters: set[str], periods: set[int], percents: set[int]
) -> None:
    """The swarms in the picture have exactly these filters, periods and percentages."""
    swarms = swarms_in_picture(name)

    assert swarms.filters == filters
    assert swarms.periods == periods
    assert swarms.percents == percents


def test_the_legend_names_topology_and_filter_where_a_picture_shows_both_topologies() -> None:
    assert swarms_in_picture("topologies_asdf-plus").legend == {
        "dynamic, no filter",
        "dynamic, ASDF+",
        "fully connected, no filter",
        "fully connected, ASDF+",
    }


@pytest.mark.parametrize("name", ["dynamic_scatter", "topologies_asdf-minus"])
def test_a_picture_also_shows_asdf_minus_where_no_robot_is_flawed_or_all_are(name: str) -> None:
    """The study does not run these twice: ASDF- is no filter at 0 % flawed robots, and ASDF+ at 100 %."""
    swarms = swarms_in_picture(name)
    assert ("asdf-minus", 0) in swarms.filters_and_percents
    assert ("asdf-minus", 100) in swarms.filters_and_percents


def test_trial_0_runs_again_with_recorded_values_to_be_drawn_over_time() -> None:
    """The results of a study have no values over time. One trial is without a filter, one with ASDF+.

    Now they have the estimates x of the robots.
    """
    results_without_filter, results_with_asdf_plus = swarms_in_picture("series").results

    assert results_without_filter.numbers == [0]  # of trials
    assert results_with_asdf_plus.numbers == [0]
    assert "x" in results_without_filter.records
    assert "x" in results_with_asdf_plus.records


def test_the_title_of_a_picture_has_the_name_of_its_filter_with_a_minus_sign() -> None:
    """The filter ASDF- is written with a minus sign instead of a hyphen."""
    pictures_of_whole_study = pictures_of(*StudyPart)
    picture = pictures_of_whole_study["dynamic_asdf-minus"]
    assert picture.title.startswith("H of dynamic swarms without filter and with ASDF\N{MINUS SIGN}")


# --- A firmware or filter of the user's ------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "legend"),
    [
        (
            "dynamic_asdf-minus",
            {
                "no filter",
                "ASDF\N{MINUS SIGN}, filter period 1000",
                "ASDF\N{MINUS SIGN}, filter period 2000",
                "ASDF\N{MINUS SIGN}, filter period 4000",
                "reference, ASDF\N{MINUS SIGN}, filter period 1000",
            },
        ),
        (
            "topologies_asdf-plus",
            {
                "dynamic, no filter",
                "dynamic, ASDF+",
                "dynamic, reference, ASDF+",
                "fully connected, no filter",
                "fully connected, ASDF+",
                "fully connected, reference, ASDF+",
            },
        ),
    ],
)
def test_a_firmware_of_the_user_s_is_drawn_beside_the_filter_of_the_paper_with_which_it_ran(
    name: str, legend: set[str]
) -> None:
    """The legend has "reference, ASDF+" beside "ASDF+", for example. "reference" is the user's firmware."""
    assert swarms_in_picture(name, firmware="reference").legend == legend


@pytest.mark.parametrize(
    ("name", "legend"),
    [
        (
            "topologies_asdf-minus",
            {
                "dynamic, no filter",
                "dynamic, ASDF\N{MINUS SIGN}",
                "dynamic, robust",
                "fully connected, no filter",
                "fully connected, ASDF\N{MINUS SIGN}",
                "fully connected, robust",
            },
        ),
        ("physical_asdf-plus", {"no filter", "ASDF+, filter period 1000", "robust, filter period 1000"}),
    ],
)
def test_a_filter_of_the_user_s_is_drawn_beside_each_of_the_paper_s(name: str, legend: set[str]) -> None:
    """The legend has "robust" beside "no filter" and "ASDF+", for example."""
    assert swarms_in_picture(name, own_filter="robust").legend == legend


def test_a_firmware_of_the_user_s_in_swarms_that_are_all_flawed_is_shown_with_asdf_minus_too() -> None:
    """Where all robots are flawed, ASDF- is ASDF+, so the firmware runs only once, as ASDF+.

    The picture about ASDF- shows these trials as swarms with ASDF-, and none with ASDF+.
    """
    swarms = swarms_in_picture("topologies_asdf-minus", firmware="reference")
    assert ("asdf-minus", 100) in swarms.filters_and_percents
    assert ("asdf-plus", 100) not in swarms.filters_and_percents


@pytest.mark.parametrize(
    ("name", "filters"),
    [
        ("dynamic_scatter_robust", {"robust"}),
        ("dynamic_scatter", {"none", "asdf-minus", "asdf-plus"}),
        ("series", {"none", "asdf-plus", "robust"}),
    ],
)
def test_a_filter_of_the_user_s_has_a_scatter_plot_for_itself_and_a_trial_over_time(
    name: str, filters: set[str]
) -> None:
    """The user's filter is the robust one. The scatter plot of the paper's filters stays without it."""
    assert swarms_in_picture(name, own_filter="robust").filters == filters
