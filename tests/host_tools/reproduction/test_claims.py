"""Every claim of the paper: results made up so that it holds, and so that it does not."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Collection
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from mcp_asdf_tools.reproduction import report, resampling
from mcp_asdf_tools.reproduction.claims import CLAIMS, LEVELS, QUESTIONS, SIZES, Claim, Contrast, Question
from mcp_asdf_tools.reproduction.decisions import Decision, decide, needs
from mcp_asdf_tools.reproduction.resampling import Sample, interval
from mcp_asdf_tools.reproduction.study import MEASURES, PAPER, Cell, Part, Scale, Study, cells_of, corruption
from mcp_asdf_tools.reproduction.verdicts import Verdict

FULL, DYNAMIC, PHYSICAL = Part
NONE = "none"
MINUS = "asdf-minus"
PLUS = "asdf-plus"
TRIALS = 30
PLACE = r"(abstract|[IV]+(-[A-E])?|)(, )?(figure \d[ab]?|table I|)"
CELLS = {cell for part in Part for cell in cells_of(part)}


@pytest.fixture(autouse=True)
def few_resamples(monkeypatch: pytest.MonkeyPatch) -> None:
    """The results made up here are far from any limit."""
    monkeypatch.setattr(resampling, "RESAMPLES", 100)


class MadeUp(Study):
    """Results by an expression, as ``planted.toml`` has them."""

    def __init__(self, expression: str, parts: Collection[Part] = tuple(Part)) -> None:
        super().__init__({})
        self._level = compile(expression, "planted.toml", "eval")
        self._run = parts

    @property
    def parts(self) -> set[Part]:
        return set(self._run)

    def trials(self, cell: Cell) -> Any:
        return SimpleNamespace(numbers=range(TRIALS))

    def sample(self, cell: Cell, measure: str) -> Sample:
        cell = cell.normal
        assert cell in CELLS
        assert cell.part in self._run
        assert measure in MEASURES
        names: dict[str, Any] = {"f": cell.fill_ratio, "b": cell.true_accuracy, "b_hat": cell.flawed_accuracy}
        names |= {"P": cell.percent, "filter": cell.filter, "tau": cell.period}
        level = eval(self._level, {**names, "part": cell.part.value, "measure": measure})
        median, spread = level if isinstance(level, tuple) else (level, 0.01)
        noise = np.random.default_rng(cell.percent).permutation(TRIALS) / (TRIALS - 1) - 0.5
        return np.asarray(median + 2 * spread * noise)


def decided(study: Study, name: str, part: Part | None = None, scale: Scale = PAPER) -> Decision:
    claims = [claim for claim in CLAIMS if claim.name == name]
    (found,) = [each for each in decide(study, scale, claims) if each.part in (part, None)]
    return found


# --- Every claim -----------------------------------------------------------------------------------------

PLANTED = tomllib.loads(Path(__file__).with_name("planted.toml").read_text(encoding="utf-8"))
FACTS = {claim.name for claim in CLAIMS if any(each.fact for each in claim.reading.contrasts)}
"""Claims with tests of their own."""

NAMED = [
    pytest.param(claim, part, id=f"{claim.name}-{part and part.value}")
    for claim in CLAIMS
    if claim.name not in FACTS
    for part in claim.parts
]


@pytest.mark.parametrize(("claim", "part"), NAMED)
def test_a_claim_agrees_and_disagrees(claim: Claim, part: Part) -> None:
    for expression, verdict in zip(PLANTED[claim.name], (Verdict.AGREE, Verdict.DISAGREE), strict=True):
        # What is not among the needs may not have been run.
        found = decided(MadeUp(expression, needs(claim.reading, part)), claim.name, part).finding
        shown = "\n".join(f"{each.label}: {each.estimate} {each.holds}" for each in found.comparisons)
        assert found.verdict is verdict, shown


def test_the_file_is_whole() -> None:
    """Each claim asks for cells that the study has, once; its part among them, and every name is known."""
    assert set(QUESTIONS) <= {claim.name for claim in CLAIMS} == {*PLANTED, *FACTS}
    assert sum(len(claim.parts) for claim in CLAIMS) == 110
    assert list(SIZES.values()) == [2, 5, 10, 20, 0.2, 0.05]
    assert LEVELS == {"almost perfect": 95, "excellent": 90, "quite high": 80, "poor": 50}
    for claim, part in ((each, part) for each in CLAIMS for part in each.parts):
        assert claim.words.strip() == claim.words != ""
        assert not re.search(r"[.?!] [A-Z]", claim.words.replace("[...]", "")), "of one sentence"
        assert re.fullmatch(PLACE, claim.where), "one section, and one figure or table"
        for reading in (claim.reading, *claim.readings):
            questions = reading.questions(part)
            assert all(cell in CELLS for question in questions for cell in question.cells), claim.name
            assert part is None or part in needs(reading, part)
            shown = {(each.place, each.expectation, each.size) for each in questions}
            assert len(shown) == len(questions) > 0, claim.name


# --- The rules -------------------------------------------------------------------------------------------


def asked(**row: Any) -> list[Question]:
    return Contrast(**{"expected": "above", "panels": "over_clear", **row}).questions(DYNAMIC)


def test_cells_are_all_combinations_that_are_flawed() -> None:
    questions = asked(percents=[10, 30], filters="asdf-plus", than="no filter")
    assert [question.cells for question in questions] == [
        tuple(Cell(DYNAMIC, 0.95, 0.55, b_hat, percent, some) for some in (PLUS, NONE))
        for b_hat in (0.75, 0.95)
        for percent in (10, 30)
    ]
    (loss,) = asked(percents=30, b_hats=0.75, than={"percent": 50}, loss_from=10)
    assert loss.place.column.startswith("loss of H from P 10 %")
    assert questions[0].place.row == "f 0.95, b 0.55, b_hat 0.75"
    assert questions[0].place.column == "H, P 10 %, ASDF+, tau 1000 less no filter"
    (level,) = asked(percents=0, b_hats=0.75, level="excellent")
    assert level.place == ("f 0.95, b 0.55", "H less 90, P 0 %, no filter")


@pytest.mark.parametrize(
    ("row", "expected"),
    [
        ({"filters": "asdf-plus", "than": "no filter"}, 20),
        ({"filters": "asdf-plus", "than": "asdf-minus"}, 5),
        ({"filters": "asdf-minus", "than": "flawless"}, 12),
        ({"level": "quite high"}, -23),
        ({"level": 50.0}, 7),
        ({"than": {"percent": 50}, "loss_from": 10}, -2),
        ({"than": "fully connected"}, -4),
        ({"summary": "spread", "filters": "asdf-plus", "than": "no filter"}, 1),
        ({"than_summary": "best of 30", "than": {"percent": 50}}, 2 - 0.955),
    ],
)
def test_differences_are_the_first_less_the_second(row: dict[str, Any], expected: float) -> None:
    """With summaries, levels, and as losses; for every cell."""
    level = "{'none': 60, 'asdf-minus': 75, 'asdf-plus': 80}[filter] - P / 10 + 4 * (part != 'dynamic')"
    study = MadeUp(f"({level}, 1 + (filter == 'asdf-plus'))")
    for question in asked(percents=30, **row):
        assert question.answer(study, 0.9).estimate.value == pytest.approx(expected, abs=0.02)


def test_trends_go_step_by_step_and_as_a_whole() -> None:
    for expected, step, whole in (("rises", "not below", "above"), ("falls", "not above", "below")):
        questions = asked(expected=expected, b_hats=0.95, percents=[10, 30, 50])
        found = [(*(cell.percent for cell in each.cells), each.expectation.value) for each in questions]
        assert found == [(30, 10, step), (50, 30, step), (50, 10, whole)]


def test_other_readings_are_shown_where_they_differ() -> None:
    """A lead of 4 points is no remarkable improvement, but one; 8 would be one with half the size."""
    for lead, more in ((4, {}), (8, {"with sizes halved": Verdict.AGREE})):
        study = MadeUp(f"50 + {lead} * (filter == 'asdf-minus')", [DYNAMIC])
        found = decided(study, "minus_improves_remarkably", DYNAMIC)
        assert found.finding.verdict is Verdict.DISAGREE
        assert found.readings == {"any improvement": Verdict.AGREE, **more}


def test_intervals_allow_for_comparisons_and_looks(monkeypatch: pytest.MonkeyPatch) -> None:
    """Bonferroni's correction: 24 comparisons, looked at once or three times; of trials that both have."""
    monkeypatch.setattr(resampling, "RESAMPLES", 4000)
    study = MadeUp("(70, 8)")
    few = {0: TRIALS // 2}
    monkeypatch.setattr(
        study, "trials", lambda cell: SimpleNamespace(numbers=[0] * few.get(cell.percent, TRIALS))
    )
    for scale, looks in ((PAPER, 1), (Scale(), 3)):
        found = decided(study, "flawed_robots_harm", DYNAMIC, scale).finding.comparisons[0]
        after, before = (
            study.summarized(Cell(DYNAMIC, 0.95, 0.55, 0.75, percent), "H", resampling.MEDIAN, TRIALS // 2)
            for percent in (10, 0)
        )
        wanted = interval(after.value - before.value, after.again - before.again, 1 - 0.05 / (24 * looks))
        assert tuple(found.estimate) == pytest.approx(tuple(wanted))


def test_two_groups_of_trials_have_a_share_beside_the_median() -> None:
    """Where half of them are good and half bad."""
    half = np.repeat([0.0, 1.0], TRIALS // 2)
    study = MadeUp("70")
    study.sample = lambda cell, measure: 40 * half + (cell.filter == PLUS)  # type: ignore[method-assign]
    (found,) = (
        each.answer(study, 0.9) for each in asked(b_hats=0.75, percents=30, filters=PLUS, than="no filter")
    )
    assert found.share == 1 and report.in_words(found).endswith(", more in 100 %")
    assert [
        each.answer(MadeUp("70"), 0.9).share for each in asked(b_hats=0.75, percents=30, than="flawless")
    ] == [None]


def test_strong_words_bound_the_interval() -> None:
    strong = asked(size="much", than="flawless", percents=30, b_hats=0.75)
    weak = asked(size=10, than="flawless", percents=30, b_hats=0.75)
    study = MadeUp("(90, 5) if P else (79, 5)")
    assert [each.answer(study, 0.99).holds for each in (*strong, *weak)] == [None, True]


def test_open_comparisons_name_their_cells() -> None:
    uncertain = "(f, b, P, filter) == (0.95, 0.95, 30, 'asdf-minus')"
    study = MadeUp(f"(61, 60) if {uncertain} else 90 if filter == 'asdf-minus' else 50")
    found = decided(study, "minus_improves_remarkably", DYNAMIC)
    assert found.finding.count(None) == 2
    assert found.unsettled == {
        Cell(DYNAMIC, 0.95, 0.95, b_hat, 30, some) for b_hat in (0.55, 0.75) for some in (NONE, MINUS)
    }


# --- Facts -----------------------------------------------------------------------------------------------


def values_of(name: str) -> list[float]:
    return [each.estimate.value for each in decided(MadeUp("70"), name).finding.comparisons]


def test_facts_follow_from_the_equations() -> None:
    """A table printed to three digits, ratios of 81 and more, a slope of 1 / (2 b_hat - 1), and section V."""
    for name, count in (("table_of_observations", 4), ("table_of_local_estimates", 12)):
        assert len(values_of(name)) == count
        assert max(map(abs, values_of(name))) <= 0.0005 + 1e-9
    growth = values_of("confidence_increases_with_b_hat")
    assert growth == pytest.approx([(0.99 / 0.98) ** 2 - 1] * 3, rel=1e-2)
    ratios = values_of("confidence_grows_a_hundredfold")
    assert ratios[:2] + ratios[3:5] == pytest.approx([25 - 100, 25 - 100, 81 - 100, 81 - 100])
    assert min(ratios) == pytest.approx(0.81 / 0.25 - 100)
    assert values_of("low_b_hat_is_volatile") == pytest.approx([0.01 / 0.1 - 0.01 / 0.9])
    assert values_of("physical_density") == pytest.approx([1.3423 - 1.3], abs=1e-4)
    assert values_of("physical_observations") == [0]
    findings = [decided(MadeUp("70"), name) for name in sorted(FACTS - {"connected_estimates_are_identical"})]
    mixed = [each for each in findings if each.finding.verdict is not Verdict.AGREE]
    assert [(each.claim.name, each.finding.count(True), each.finding.count(False)) for each in mixed] == [
        ("confidence_grows_a_hundredfold", 4, 8)
    ]
    assert mixed[0].readings == {"some pair, such as 0.505 and 0.995": Verdict.AGREE}


@pytest.mark.parametrize("spread", [0, 1])
def test_identical_estimates_are_identical(spread: int, monkeypatch: pytest.MonkeyPatch) -> None:
    convergence_steps, errors = np.full((3, 4), 100), np.full((3, 4), 0.25)
    convergence_steps[2, 1] += spread
    errors[0, 3] += 1e-6 * spread
    trials = SimpleNamespace(convergence_steps=convergence_steps, errors=errors)
    study = MadeUp("70")
    monkeypatch.setattr(study, "of", lambda part: [trials])
    found = decided(study, "connected_estimates_are_identical", FULL).finding
    assert found.verdict is (Verdict.DISAGREE if spread else Verdict.AGREE)


def test_corruption_is_that_of_the_robots_that_were_right() -> None:
    b_hat = np.array([[[0.9, 0.9, 0.5, 0.5]] * 2 + [[0.1, 0.2, 0.6, 0.8]]])
    trials: Any = SimpleNamespace(b_hat=b_hat, experiment=SimpleNamespace(flawed=2))
    assert corruption(trials) == pytest.approx([0.7])
