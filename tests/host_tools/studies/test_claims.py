"""Every claim of the paper with planted results: such that it holds, and such that it does not."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from host_tools.studies.conftest import STUDY_CELLS, PlantedResults
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
from mcp_asdf_tools.studies.equations import EQUATIONS
from mcp_asdf_tools.studies.study_results import MEASURES, StudyResults, final_b_hat_of_healthy_robots
from mcp_asdf_tools.studies.verdicts import Expectation, Verdict

pytestmark = pytest.mark.usefixtures("few_resamples")

PLANTED: dict[str, list[str]] = tomllib.loads(
    Path(__file__).with_name("planted.toml").read_text(encoding="utf-8")
)
"""For each claim an expression by which it agrees, and one by which it disagrees."""

PLACE_IN_PAPER = r"(abstract|[IV]+(-[A-E])?|)(, )?(figure \d[ab]?|table I|)"


def decide_one(study_results: StudyResults, claim: Claim, study_part: StudyPart | None) -> Decision:
    (decision,) = [
        decision for decision in decide(study_results, [claim]) if decision.study_part is study_part
    ]
    return decision


def claim_named(name: str) -> Claim:
    (claim,) = [claim for claim in CLAIMS if claim.name == name]
    return claim


# --- Every claim -----------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(
    ("claim", "study_part"),
    [
        pytest.param(claim, study_part, id=f"{claim.name}-{study_part.value}")
        for claim in CLAIMS
        if claim.name != IDENTICAL_ROBOTS
        for study_part in claim.parts
        if study_part is not None
    ],
)
@pytest.mark.parametrize(("index", "verdict"), [(0, Verdict.AGREE), (1, Verdict.DISAGREE)])
def test_a_claim_of_the_paper_agrees_or_disagrees_as_planted_results_do(
    claim: Claim, study_part: StudyPart, index: int, verdict: Verdict
) -> None:
    """PLANTED has two expressions for each claim: results that agree with it, and results that do not."""
    study_results = PlantedResults(PLANTED[claim.name][index], parts_needed(claim, study_part))
    decision = decide_one(study_results, claim, study_part)
    shown = [f"{each.label}: {each.interval} {each.holds}" for each in decision.comparisons]
    assert decision.verdict is verdict, "\n".join(shown)


def test_every_claim_has_planted_results_or_a_function() -> None:
    assert {claim.name for claim in CLAIMS} == {*PLANTED, *EQUATIONS, IDENTICAL_ROBOTS}


def test_the_paper_has_97_claims_about_110_parts() -> None:
    assert len(CLAIMS) == 97
    assert sum(len(claim.parts) for claim in CLAIMS) == 110


def test_each_question_of_a_user_is_about_a_claim_that_exists() -> None:
    assert set(QUESTIONS) <= {claim.name for claim in CLAIMS}


def test_sizes_and_levels_are_those_of_the_page() -> None:
    assert list(SIZES.values()) == [2, 5, 10, 20, 0.2, 0.05]
    assert LEVELS == {"almost perfect": 95, "excellent": 90, "quite high": 80, "poor": 50}


@pytest.mark.parametrize("claim", CLAIMS, ids=lambda claim: claim.name)
def test_a_claim_quotes_one_sentence_of_one_place(claim: Claim) -> None:
    assert claim.quote.strip() == claim.quote != ""
    assert not re.search(r"[.?!] [A-Z]", claim.quote.replace("[...]", ""))
    assert re.fullmatch(PLACE_IN_PAPER, claim.where)


PLANS = [
    pytest.param(claim.plan(study_part), study_part, id=f"{claim.name}-{study_part.value}")
    for claim in CLAIMS
    if claim.contrasts
    for study_part in claim.parts
    if study_part is not None
]


@pytest.mark.parametrize(("plans", "study_part"), PLANS)
def test_a_claim_compares_experiments_that_the_study_runs_and_each_pair_once(
    plans: list[PlannedComparison], study_part: StudyPart
) -> None:
    cells = {plan.cell for plan in plans} | {plan.reference for plan in plans if plan.reference}
    assert cells <= STUDY_CELLS
    assert study_part in {cell.study_part for cell in cells}
    questions = {(plan.cell, plan.reference, plan.contrast.measure, plan.contrast.expected) for plan in plans}

    assert len(questions) == len(plans) > 0


@pytest.mark.parametrize(("plans", "study_part"), PLANS)
def test_comparisons_in_claims_toml_are_of_measures_and_expectations_that_exist(
    plans: list[PlannedComparison], study_part: StudyPart
) -> None:
    """A misspelt word of the file would be a comparison that nobody makes."""
    known_expectations = {expectation.value for expectation in Expectation}
    for plan in plans:
        assert plan.contrast.measure in MEASURES
        assert plan.contrast.expected in known_expectations


@pytest.mark.parametrize(("plans", "study_part"), PLANS)
def test_differences_that_count_in_claims_toml_are_above_0(
    plans: list[PlannedComparison], study_part: StudyPart
) -> None:
    for plan in plans:
        assert plan.contrast.size_in_points > 0


# --- Contrasts -------------------------------------------------------------------------------------------


def plan(**row: Any) -> list[PlannedComparison]:
    """Plan a contrast of dynamic swarms with f = 0.95 and b = 0.55."""
    return Contrast(**{"expected": "above", "panels": "over_clear", **row}).plan(StudyPart.DYNAMIC)


def test_lists_in_a_comparison_make_all_their_combinations() -> None:
    plans = plan(flawed_percents=[10, 30], filters="asdf-plus", than="no filter")
    pairs = [(plan.cell, plan.reference) for plan in plans]

    assert pairs == [
        (
            Cell(StudyPart.DYNAMIC, 0.95, 0.55, b_hat, percent, "asdf-plus"),
            Cell(StudyPart.DYNAMIC, 0.95, 0.55, b_hat, percent, "none"),
        )
        for b_hat in (0.75, 0.95)  # 0.55 is right
        for percent in (10, 30)
    ]


def test_two_names_of_the_same_experiment_are_compared_once() -> None:
    """Without flawed robots their accuracies of 0.75 and 0.95 make no difference."""
    assert len(plan(flawed_percents=0, filters="asdf-plus", than="no filter")) == 1


def test_the_next_lower_share_of_flawed_robots_is_the_next_that_the_study_runs() -> None:
    """P is the percentage of flawed robots. Each cell of the study is compared with a reference cell."""
    plans = plan(flawed_percents=[10, 30, 50, 100], flawed_accuracies=0.95, than="next lower P")
    percents_and_those_of_references = [
        (plan.cell.flawed_percent, plan.reference and plan.reference.flawed_percent) for plan in plans
    ]

    assert percents_and_those_of_references == [(10, 0), (30, 10), (50, 30), (100, 50)]


@pytest.mark.parametrize(
    ("row", "expected"),
    [
        ({"filters": "asdf-plus", "than": "no filter"}, 20),
        ({"filters": "asdf-plus", "than": "asdf-minus"}, 5),
        ({"filters": "asdf-minus", "than": "flawless"}, 12),
        ({"level": "quite high"}, -23),
        ({"level": 50.0}, 7),
        ({}, 57),
        ({"measure": "loss of H", "than": {"flawed_percent": 50}}, -2),
        ({"than": "fully connected"}, -4),
        ({"measure": "spread of H", "filters": "asdf-plus", "than": "no filter"}, 1),
        ({"than_measure": "best H of 30", "than": {"flawed_percent": 50}}, 2 - 0.955),
    ],
)
def test_a_comparison_is_the_first_cell_less_the_other(row: dict[str, Any], expected: float) -> None:
    median = "{'none': 60, 'asdf-minus': 75, 'asdf-plus': 80}[filter] - P / 10 + 4 * (part != 'dynamic')"
    study_results = PlantedResults(f"({median}, 1 + (filter == 'asdf-plus'))")
    values = [plan.compare(study_results, 0.9).interval.value for plan in plan(flawed_percents=30, **row)]
    assert values == pytest.approx([expected] * len(values), abs=0.02)


@pytest.mark.parametrize(
    ("row", "place"),
    [
        (
            {"filters": "asdf-plus", "than": "no filter"},
            ("f 0.95, b 0.55, b_hat 0.75", "H, P 10 %, ASDF+, tau 1000 less no filter"),
        ),
        (
            {"flawed_percents": 0, "level": "excellent"},
            ("f 0.95, b 0.55", "H less 90, P 0 %, no filter"),
        ),
        (
            {"than": "fully connected"},
            ("f 0.95, b 0.55, b_hat 0.75", "H, dynamic, P 10 %, no filter less fully connected"),
        ),
    ],
)
def test_a_comparison_is_labelled_by_what_differs(row: dict[str, Any], place: tuple[str, str]) -> None:
    (only_plan,) = plan(**{"flawed_percents": 10, "flawed_accuracies": 0.75, **row})
    comparison = only_plan.compare(PlantedResults("70"), 0.9)
    assert (comparison.row, comparison.column) == place


@pytest.mark.parametrize(("size", "is_strong"), [("much", True), (10, False), ("similar", False)])
def test_much_is_a_strong_word(size: str | float, is_strong: bool) -> None:
    (only_plan,) = plan(size=size, than="flawless", flawed_percents=30, flawed_accuracies=0.75)
    assert only_plan.compare(PlantedResults("70"), 0.9).is_strong is is_strong


# --- Decisions -------------------------------------------------------------------------------------------


def test_intervals_allow_for_the_number_of_comparisons() -> None:
    study_results = PlantedResults("(70, 8)")
    decision = decide_one(study_results, claim_named("flawed_robots_harm"), StudyPart.DYNAMIC)
    first_plan = claim_named("flawed_robots_harm").plan(StudyPart.DYNAMIC)[0]
    error_probability = 0.05 / 24  # of each of 24 comparisons, so that it is 0.05 for all together
    assert len(decision.comparisons) == 24
    assert (
        decision.comparisons[0].interval == first_plan.compare(study_results, 1 - error_probability).interval
    )


def test_a_claim_is_left_out_where_a_part_that_it_needs_has_not_been_run() -> None:
    claim = claim_named("connected_overconfident_score_higher")  # compares with the dynamic swarm
    assert decide(PlantedResults("70", [StudyPart.FULLY_CONNECTED]), [claim]) == []


@pytest.mark.parametrize(("excess", "verdict"), [(0, Verdict.AGREE), (1, Verdict.DISAGREE)])
def test_robots_of_a_connected_swarm_are_compared_with_each_other(
    excess: int, verdict: Verdict, monkeypatch: pytest.MonkeyPatch
) -> None:
    convergence_steps, errors = np.full((3, 4), 100), np.full((3, 4), 0.25)
    convergence_steps[2, 1] += excess
    errors[0, 3] += 1e-6 * excess
    trials = SimpleNamespace(convergence_steps=convergence_steps, errors=errors)
    study_results = PlantedResults("70")
    monkeypatch.setattr(study_results, "trials_of", lambda study_part: [trials])
    decision = decide_one(study_results, claim_named(IDENTICAL_ROBOTS), StudyPart.FULLY_CONNECTED)

    assert decision.verdict is verdict


def test_the_final_b_hat_is_that_of_the_robots_that_started_with_the_right_one() -> None:
    b_hat = np.array([[[0.9, 0.9, 0.5, 0.5], [0.1, 0.2, 0.6, 0.8]]])
    trials: Any = SimpleNamespace(b_hat=b_hat, experiment=SimpleNamespace(flawed=2))
    assert final_b_hat_of_healthy_robots(trials) == pytest.approx([0.7])
