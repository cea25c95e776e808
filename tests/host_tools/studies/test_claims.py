"""Every claim of the paper with planted results: such that it holds, and such that it does not."""

from __future__ import annotations

import re
import tomllib
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from host_tools.studies.conftest import STUDY_CELLS, PlantedResults, two_trials_with
from mcp_asdf_tools.studies.cells import Cell, StudyPart
from mcp_asdf_tools.studies.claims import (
    CLAIMS,
    IDENTICAL_ROBOTS,
    LEVELS,
    QUESTIONS,
    SIZES,
    Claim,
    Contrast,
    Decision,
    PlannedComparison,
    decide,
    parts_needed,
)
from mcp_asdf_tools.studies.equations import EQUATION_CLAIMS
from mcp_asdf_tools.studies.study_results import StudyResults
from mcp_asdf_tools.studies.verdicts import Verdict

pytestmark = pytest.mark.usefixtures("few_resamples")

PLANTED_EXPRESSIONS: dict[str, list[str]] = tomllib.loads(
    Path(__file__).with_name("planted.toml").read_text(encoding="utf-8")
)
"""For each claim an expression by which it agrees, and one by which it disagrees."""


def decide_claim(study_results: StudyResults, claim: Claim, study_part: StudyPart | None) -> Decision:
    """Return the decision on a claim about one part of the study."""
    (decision,) = [
        decision for decision in decide(study_results, [claim]) if decision.study_part is study_part
    ]
    return decision


def claim_named(name: str) -> Claim:
    (claim,) = [claim for claim in CLAIMS if claim.name == name]
    return claim


# --- Every claim -----------------------------------------------------------------------------------------


QUICK_CLAIMS = (
    "flawed_robots_harm",
    "plus_spreads_wider",
    "connected_overconfident_score_higher",
    "short_runs_are_accurate",
)
"""Claims about a score, about its spread, about two parts of the study, and about a level."""


@pytest.mark.parametrize(
    ("claim", "study_part"),
    [
        pytest.param(
            claim,
            study_part,
            id=f"{claim.name}-{study_part.value}",
            marks=() if claim.name in QUICK_CLAIMS else pytest.mark.slow,
        )
        for claim in CLAIMS
        if claim.name != IDENTICAL_ROBOTS
        for study_part in claim.parts
        if study_part is not None
    ],
)
def test_a_claim_of_the_paper_agrees_and_disagrees_with_the_results_planted_for_that(
    claim: Claim, study_part: StudyPart
) -> None:
    """In planted.toml a claim has two expressions: results that agree with it, and results that do not.

    With the expression "90 - P / 2", for example, the score of a swarm falls with P, the percentage of its
    robots that are flawed. Only the parts of the study that a claim needs have results.
    """
    parts = parts_needed(claim, study_part)
    agreeing_expression, disagreeing_expression = PLANTED_EXPRESSIONS[claim.name]

    agreement = decide_claim(PlantedResults(agreeing_expression, parts), claim, study_part)
    disagreement = decide_claim(PlantedResults(disagreeing_expression, parts), claim, study_part)

    assert agreement.verdict is Verdict.AGREE, agreement.comparisons
    assert disagreement.verdict is Verdict.DISAGREE, disagreement.comparisons


def test_every_claim_is_tested_with_planted_results_or_decided_by_equations_or_about_single_robots() -> None:
    claims_with_planted_results = set(PLANTED_EXPRESSIONS)
    claims_that_equations_decide = set(EQUATION_CLAIMS)
    claims_about_single_robots = {IDENTICAL_ROBOTS}

    names_of_all_claims = {claim.name for claim in CLAIMS}
    assert names_of_all_claims == (
        claims_with_planted_results | claims_that_equations_decide | claims_about_single_robots
    )


def test_the_paper_has_97_claims_that_are_about_110_parts_of_the_study() -> None:
    """Most claims are about one part, and some about two: about fully connected and about dynamic swarms.

    Each gets a verdict for each of its parts, so the page about the study counts 110 claims.
    """
    assert len(CLAIMS) == 97
    assert sum(len(claim.parts) for claim in CLAIMS) == 110


def test_each_question_of_a_user_is_answered_by_a_claim_that_exists() -> None:
    """The report answers questions such as "Do flawed robots harm a swarm?" by the verdict on a claim."""
    names_of_answering_claims = QUESTIONS.keys()
    assert names_of_answering_claims <= {claim.name for claim in CLAIMS}


def test_the_papers_words_for_sizes_and_levels_stand_for_these_numbers() -> None:
    """Sizes are the smallest differences that count: of scores, of a rank correlation, and of b_hat.

    A level is a score from 0 to 100. The page about the study explains these choices.
    """
    assert SIZES == {
        "seen": 2,
        "similar": 5,
        "much": 10,
        "overwhelming": 20,
        "weak correlation": 0.2,
        "corrupted": 0.05,
    }
    assert LEVELS == {"almost perfect": 95, "excellent": 90, "quite high": 80, "poor": 50}


def test_each_claim_quotes_one_sentence_of_the_paper() -> None:
    """Dots in brackets stand for what is left out of a sentence."""
    for claim in CLAIMS:
        assert claim.quote != ""
        assert claim.quote.strip() == claim.quote
        quote_without_dots = claim.quote.replace("[...]", "")
        start_of_a_second_sentence = re.search(r"[.?!] [A-Z]", quote_without_dots)
        assert start_of_a_second_sentence is None, claim.name


def test_each_claim_says_in_which_section_figure_or_table_the_paper_has_it() -> None:
    """Examples are "III-A", "abstract", "V, figure 3a" and "table I"."""
    section = r"(abstract|[IV]+(-[A-E])?)?"
    figure_or_table = r"(figure \d[ab]?|table I)?"
    for claim in CLAIMS:
        assert claim.where != ""
        assert re.fullmatch(f"{section}(, )?{figure_or_table}", claim.where), claim.name


class PlansOfClaim(NamedTuple):
    """The comparisons by which a claim about a part of the study is decided."""

    claim_name: str
    study_part: StudyPart
    comparisons: list[PlannedComparison]


PLANS_OF_CLAIMS = [
    PlansOfClaim(claim.name, study_part, claim.plan(study_part))
    for claim in CLAIMS
    if claim.contrasts
    for study_part in claim.parts
    if study_part is not None
]


def test_claims_compare_only_cells_that_the_study_runs_and_some_of_their_own_part() -> None:
    """A cell is a kind of swarm in a part of the study; a reference is the cell that it is compared with."""
    for _claim_name, study_part, comparisons in PLANS_OF_CLAIMS:
        cells = {comparison.cell for comparison in comparisons}
        references = {comparison.reference for comparison in comparisons if comparison.reference is not None}
        compared_cells = cells | references

        assert compared_cells <= STUDY_CELLS
        assert study_part in {cell.study_part for cell in compared_cells}


def test_no_claim_makes_the_same_comparison_twice() -> None:
    """A comparison is told from others by both swarms, by what is measured and by what is expected."""
    for claim_name, _study_part, comparisons in PLANS_OF_CLAIMS:
        different_comparisons = set()
        for comparison in comparisons:
            contrast = comparison.contrast
            different_comparisons.add(
                (comparison.cell, comparison.reference, contrast.measure, contrast.expected)
            )
        assert comparisons != [], claim_name
        assert len(different_comparisons) == len(comparisons), claim_name


def test_every_comparison_in_claims_toml_is_of_a_measure_that_results_have() -> None:
    """A misspelt word of the file would otherwise end a study after all of its trials.

    Of several comparisons of the same measures one is tried, with the same score for all swarms. Results
    raise an error for a measure that they do not have.
    """
    results = PlantedResults("70")
    tried_measures = set()
    for _claim_name, _study_part, comparisons in PLANS_OF_CLAIMS:
        for comparison in comparisons:
            measures = (comparison.contrast.measure, comparison.contrast.than_measure)
            if measures in tried_measures:
                continue
            tried_measures.add(measures)
            difference = comparison.compare(results, confidence=0.9).interval.value
            assert np.isfinite(difference), measures


# --- Contrasts -------------------------------------------------------------------------------------------


def plan_comparisons(**row: Any) -> list[PlannedComparison]:
    """List the comparisons that a row of claims.toml makes in dynamic swarms with f = 0.95 and b = 0.55.

    ``row`` selects the swarms of ``cell``, and ``than`` the swarms of ``reference``. Each comparison has
    a cell. The reference may be missing.
    """
    contrast = Contrast(**{"expected": "above", "panels": "over_clear", **row})
    return contrast.plan(StudyPart.DYNAMIC)


def test_lists_in_a_row_of_a_claim_make_all_combinations_each_with_the_reference_of_the_row() -> None:
    """The row compares ASDF+ with no filter for two accuracies b_hat and two percentages of flawed robots.

    "no filter" is the filter "none" of a swarm.
    """
    comparisons = plan_comparisons(
        flawed_accuracy=[0.75, 0.95], flawed_percent=[10, 30], filter="asdf-plus", than="no filter"
    )

    cells = [comparison.cell for comparison in comparisons]
    accuracies_and_percents = [(cell.flawed_accuracy, cell.flawed_percent) for cell in cells]
    assert accuracies_and_percents == [(0.75, 10), (0.75, 30), (0.95, 10), (0.95, 30)]
    assert {cell.filter for cell in cells} == {"asdf-plus"}
    assert [comparison.reference for comparison in comparisons] == [
        replace(cell, filter="none") for cell in cells
    ]


def test_two_names_of_the_same_experiment_are_compared_once() -> None:
    """Without flawed robots it makes no difference whether these would assume 0.75 or 0.95."""
    comparisons = plan_comparisons(
        flawed_accuracy=[0.75, 0.95], flawed_percent=0, filter="asdf-plus", than="no filter"
    )
    assert len(comparisons) == 1


def test_next_lower_p_is_the_next_lower_percentage_of_flawed_robots_that_the_study_runs() -> None:
    """A row that says "next lower P" compares a swarm with one that has this percentage of flawed robots."""
    comparisons = plan_comparisons(
        flawed_accuracy=0.95, flawed_percent=[10, 30, 50, 100], than="next lower P"
    )

    percents_of_cell_and_reference = []
    for comparison in comparisons:
        assert comparison.reference is not None
        percents_of_cell_and_reference.append(
            (comparison.cell.flawed_percent, comparison.reference.flawed_percent)
        )
    assert percents_of_cell_and_reference == [(10, 0), (30, 10), (50, 30), (100, 50)]


@pytest.mark.parametrize(
    ("row", "expected_difference"),
    [
        ({"filter": "asdf-plus", "than": "no filter"}, 77 - 57),
        ({"filter": "asdf-plus", "than": "asdf-minus"}, 77 - 72),
        ({"filter": "asdf-minus", "than": "flawless"}, 72 - 60),
        ({"level": "quite high"}, 57 - 80),
        ({"level": 50.0}, 57 - 50),
        ({}, 57),
        ({"than": "fully connected"}, 57 - 61),
        # A loss is how much higher H is without flawed robots.
        ({"measure": "loss of H", "than": {"flawed_percent": 50}}, 3 - 5),
    ],
)
def test_a_comparison_is_the_measure_of_the_first_cell_less_the_measure_of_the_second(
    row: dict[str, Any], expected_difference: float
) -> None:
    """With 30 % flawed robots H is 57 without a filter, 72 with ASDF- and 77 with ASDF+.

    H is 3 higher without flawed robots ("flawless"), 2 lower with 50 % of them, and 4 higher in fully
    connected swarms than in dynamic ones. H is compared with a level if the row has one; "quite high" is 80.
    """
    # This is evaluated for each swarm, by its filter, its percentage P and its part of the study.
    expression_of_h = (
        "{'none': 57, 'asdf-minus': 72, 'asdf-plus': 77}[filter]"
        " + {0: 3, 30: 0, 50: -2}[P]"
        " + {'dynamic': 0, 'fully_connected': 4}[part]"
    )

    [planned_comparison] = plan_comparisons(flawed_percent=30, flawed_accuracy=0.75, **row)
    comparison = planned_comparison.compare(PlantedResults(expression_of_h), confidence=0.9)

    # The trials of a planted swarm scatter by 0.01.
    assert comparison.interval.value == pytest.approx(expected_difference, abs=0.02)


@pytest.mark.parametrize(
    ("row", "expected_difference"),
    [
        ({"measure": "spread of H", "filter": "asdf-plus", "than": "no filter"}, 2 - 1),
        # The best of 30 trials exceeds this quantile in half of all cases. H spreads evenly from 69 to 71.
        ({"than_measure": "best H of 30", "than": {"flawed_percent": 30}}, 70 - (69 + 2 * 0.5 ** (1 / 30))),
    ],
)
def test_a_comparison_can_be_of_how_trials_spread_or_with_the_best_of_them(
    row: dict[str, Any], expected_difference: float
) -> None:
    """H spreads evenly from 69 to 71 with no filter, and from 68 to 72 with ASDF+. Its median is 70.

    The spread of H is the range of the middle half of the trials: 1 with no filter, and 2 with ASDF+.
    """
    results = PlantedResults("(70, 2 if filter == 'asdf-plus' else 1)")  # median, and distance of both ends

    [planned_comparison] = plan_comparisons(flawed_percent=30, flawed_accuracy=0.75, **row)
    comparison = planned_comparison.compare(results, confidence=0.9)

    assert comparison.interval.value == pytest.approx(expected_difference, abs=0.02)


@pytest.mark.parametrize(
    ("row", "row_label", "column_label"),
    [
        (
            {"filter": "asdf-plus", "than": "no filter"},
            "f 0.95, b 0.55, b_hat 0.75",
            "H, P 10 %, ASDF+, tau 1000 less no filter",
        ),
        ({"flawed_percent": 0, "level": "excellent"}, "f 0.95, b 0.55", "H less 90, P 0 %, no filter"),
        (
            {"than": "fully connected"},
            "f 0.95, b 0.55, b_hat 0.75",
            "H, dynamic, P 10 %, no filter less fully connected",
        ),
    ],
)
def test_a_comparison_is_labelled_by_its_swarm_and_by_what_is_subtracted_from_what(
    row: dict[str, Any], row_label: str, column_label: str
) -> None:
    """A table's row names the swarm. Its column names the measure, and after "less" what is subtracted.

    All swarms have f = 0.95 and b = 0.55. Unless the row says otherwise, 10 % of the robots are flawed, and
    assume a b_hat of 0.75.
    """
    row_with_flawed_robots = {"flawed_percent": 10, "flawed_accuracy": 0.75, **row}
    [planned_comparison] = plan_comparisons(**row_with_flawed_robots)
    any_results = PlantedResults("70")  # all swarms have the same score
    comparison = planned_comparison.compare(any_results, confidence=0.9)

    assert comparison.row == row_label
    assert comparison.column == column_label


@pytest.mark.parametrize(("size", "is_strong"), [("much", True), (10, False), ("similar", False)])
def test_a_comparison_is_strong_only_where_the_paper_says_much(size: str | float, is_strong: bool) -> None:
    """The whole interval of a strong comparison must reach the size, 10 for "much", and not only its middle.

    The size 10 alone, or a weak word, does not make a comparison strong.
    """
    [planned_comparison] = plan_comparisons(
        size=size, than="flawless", flawed_percent=30, flawed_accuracy=0.75
    )
    any_results = PlantedResults("70")  # all swarms have the same score
    comparison = planned_comparison.compare(any_results, confidence=0.9)
    assert comparison.is_strong is is_strong


# --- Decisions -------------------------------------------------------------------------------------------


def test_the_intervals_of_24_comparisons_are_so_wide_that_all_together_are_right_with_95_percent() -> None:
    """So each of the 24 may be wrong with only a 24th of 5 percent. The first one is checked."""
    results = PlantedResults("(70, 8)")  # the median of all swarms, and the distance of their extreme trials
    claim_with_24_comparisons = claim_named("flawed_robots_harm")

    decision = decide_claim(results, claim_with_24_comparisons, StudyPart.DYNAMIC)

    assert len(decision.comparisons) == 24
    first_planned_comparison, *_ = claim_with_24_comparisons.plan(StudyPart.DYNAMIC)
    first_comparison, *_ = decision.comparisons
    expected_comparison = first_planned_comparison.compare(results, confidence=1 - 0.05 / 24)
    assert first_comparison.interval == expected_comparison.interval


def test_a_claim_is_left_out_where_a_part_of_the_study_that_it_needs_has_not_been_run() -> None:
    """The claim compares fully connected swarms with dynamic ones, and no dynamic swarm has been run."""
    claim_about_both_parts = claim_named("connected_overconfident_score_higher")
    results_of_one_part = PlantedResults("70", parts=[StudyPart.FULLY_CONNECTED])
    assert decide(results_of_one_part, [claim_about_both_parts]) == []


@pytest.mark.parametrize(
    ("step_of_last_robot", "error_of_last_robot", "verdict"),
    [(100, 0.25, Verdict.AGREE), (101, 0.25, Verdict.MIXED), (101, 0.251, Verdict.DISAGREE)],
)
def test_robots_of_a_connected_swarm_must_converge_in_the_same_step_with_the_same_error(
    step_of_last_robot: int, error_of_last_robot: float, verdict: Verdict
) -> None:
    """In a trial three robots converge at step 100 with an error of 0.25. The fourth may differ.

    The claim is that steps and errors are the same. It agrees if they are, is mixed if only the steps or only
    the errors are the same, and disagrees if both differ.
    """
    cell = Cell(
        StudyPart.FULLY_CONNECTED,
        fill_ratio=0.95,
        true_accuracy=0.55,
        flawed_accuracy=0.95,
        flawed_percent=30,
    )
    trial = replace(
        two_trials_with(robots=4),
        convergence_steps=np.array([[100, 100, 100, step_of_last_robot]]),
        errors=np.array([[0.25, 0.25, 0.25, error_of_last_robot]]),
    )

    claim_of_identical_robots = claim_named("connected_estimates_are_identical")
    decision = decide_claim(StudyResults({cell: trial}), claim_of_identical_robots, StudyPart.FULLY_CONNECTED)

    assert decision.verdict is verdict
