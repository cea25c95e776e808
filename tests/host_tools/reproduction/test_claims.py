"""Every claim of the paper: results made up so that it holds, and so that it does not."""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Collection, Iterable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from mcp_asdf_tools.reproduction import equations, resampling
from mcp_asdf_tools.reproduction.claims import _FILE, CLAIMS, QUESTIONS, Claim, Contrast, Question
from mcp_asdf_tools.reproduction.decisions import Decision, decide, needs
from mcp_asdf_tools.reproduction.resampling import Sample, interval
from mcp_asdf_tools.reproduction.study import MEASURES, PAPER, Cell, Part, Scale, Study, cells_of
from mcp_asdf_tools.reproduction.verdicts import Verdict
from mcp_asdf_tools.robots.population import Filtering

FULL, DYNAMIC, PHYSICAL = Part
NONE, MINUS, PLUS = Filtering
TRIALS = 30
CELLS = {cell for part in Part for cell in cells_of(part)}

Level = Callable[[Cell, str], float | tuple[float, float]]
"""The median of a cell and a measure, or median and interquartile range."""


@pytest.fixture(autouse=True)
def few_resamples(monkeypatch: pytest.MonkeyPatch) -> None:
    """The results made up here are far from any limit."""
    monkeypatch.setattr(resampling, "RESAMPLES", 100)


class MadeUp(Study):
    """Results that are as one likes. A cell that the study has not is asked for in vain."""

    def __init__(self, level: Level, parts: Collection[Part] = tuple(Part)) -> None:
        super().__init__({})
        self._level = level
        self._run = parts

    @property
    def parts(self) -> set[Part]:
        return set(self._run)

    def count(self, cells: Iterable[Cell]) -> int:
        return TRIALS

    def sample(self, cell: Cell, measure: str) -> Sample:
        assert cell.normal in CELLS
        assert cell.part in self._run
        assert measure in MEASURES
        level = self._level(cell.normal, measure)
        median, spread = level if isinstance(level, tuple) else (level, 0.01)
        noise = np.random.default_rng(cell.normal.percent).permutation(TRIALS)
        return median + spread * 2 * (noise / (TRIALS - 1) - 0.5)


# --- Every claim -----------------------------------------------------------------------------------------


def by(level: Callable[[Cell], float]) -> Level:
    return lambda cell, measure: level(cell)


def planted(expression: str) -> Level:
    """A level by an expression of the file."""
    code = compile(expression, "planted.toml", "eval")

    def level(cell: Cell, measure: str) -> float | tuple[float, float]:
        names = {
            "f": cell.fill_ratio,
            "b": cell.true_accuracy,
            "b_hat": cell.flawed_accuracy,
            "P": cell.percent,
        }
        words = {"filter": cell.filter.value, "part": cell.part.value, "measure": measure}
        found: float | tuple[float, float] = eval(code, {**names, **words, "tau": cell.period})
        return found

    return level


PLANTED = tomllib.loads(Path(__file__).with_name("planted.toml").read_text(encoding="utf-8"))
FACTS = {claim.name for claim in CLAIMS if any(each.fact for each in claim.reading.contrasts)}
"""Claims with tests of their own."""

NAMED = [
    pytest.param(claim, part, id=f"{claim.name}-{part and part.value}")
    for claim in CLAIMS
    if claim.name not in FACTS
    for part in claim.parts
]


def decided(study: Study, name: str, part: Part | None = None, scale: Scale = PAPER) -> Decision:
    claims = [claim for claim in CLAIMS if claim.name == name]
    (found,) = [each for each in decide(study, scale, claims) if each.part in (part, None)]
    return found


@pytest.mark.parametrize(("claim", "part"), NAMED)
def test_a_claim_agrees_and_disagrees(claim: Claim, part: Part) -> None:
    for words, verdict in zip(PLANTED[claim.name], (Verdict.AGREE, Verdict.DISAGREE), strict=True):
        # What is not among the needs may not have been run.
        found = decided(MadeUp(planted(words), needs(claim.reading, part)), claim.name, part).finding
        shown = "\n".join(f"{each.label}: {each.estimate} {each.holds}" for each in found.comparisons)
        assert found.verdict is verdict, shown


# --- The file ----------------------------------------------------------------------------------------


def test_the_file_is_whole() -> None:
    """Each claim asks for cells that the study has, once; its part among them, and every name is known."""
    assert set(QUESTIONS) <= {claim.name for claim in CLAIMS}
    assert {*PLANTED, *FACTS} == {claim.name for claim in CLAIMS}
    assert sum(len(claim.parts) for claim in CLAIMS) == 95
    for claim in CLAIMS:
        assert claim.words.strip() == claim.words
        assert claim.where
        assert claim.compared
        for part, reading in (
            (part, each) for part in claim.parts for each in (claim.reading, *claim.readings)
        ):
            questions = reading.questions(part)
            assert all(cell in CELLS for question in questions for cell in question.cells), claim.name
            assert part is None or part in needs(reading, part)
            drawn = {(each.place, each.expectation, each.size) for each in questions}
            assert len(drawn) == len(questions) > 0, claim.name


def test_unknown_keys_and_names_are_refused() -> None:
    with pytest.raises(TypeError, match="percentages"):
        Contrast(expected="above", percentages=[10])  # type: ignore[call-arg]
    for wrong in ({"expected": "higher"}, {"size": "huge"}, {"panels": "left"}, {"than": "better"}):
        with pytest.raises((KeyError, ValueError)):
            Contrast(**{"expected": "above", "than": "no filter", **wrong}).questions(DYNAMIC)  # type: ignore[arg-type]


def test_sizes_and_levels_are_those_of_the_words() -> None:
    assert _FILE["sizes"] == {
        "seen": 2,
        "similar": 5,
        "much": 10,
        "overwhelming": 20,
        "weak correlation": 0.2,
        "corrupted": 0.05,
    }
    assert _FILE["levels"] == {"almost perfect": 95, "excellent": 90, "quite high": 80, "poor": 50}


# --- The rules ---------------------------------------------------------------------------------------


def asked(**row: Any) -> list[Question]:
    return Contrast(**row).questions(DYNAMIC)


def test_cells_are_all_combinations_that_are_flawed() -> None:
    questions = asked(
        expected="above", panels="over_clear", percents=[10, 30], filters="asdf-plus", than="no filter"
    )
    pairs = [question.cells for question in questions]
    assert pairs == [
        (Cell(DYNAMIC, 0.95, 0.55, b_hat, percent, PLUS), Cell(DYNAMIC, 0.95, 0.55, b_hat, percent, NONE))
        for b_hat in (0.75, 0.95)
        for percent in (10, 30)
    ]
    assert questions[0].place.row == "f 0.95, b 0.55, b_hat 0.75"
    assert questions[0].place.column == "H, P 10 %, ASDF+, tau 1000 less no filter"


def test_differences_are_the_first_less_the_second() -> None:
    """With different summaries, levels, and as losses."""
    study = MadeUp(by(lambda cell: {NONE: 60, MINUS: 75, PLUS: 80}[cell.filter] - 0.1 * cell.percent))
    rows: list[tuple[dict[str, Any], float]] = [
        ({"filters": "asdf-plus", "than": "no filter"}, 20),
        ({"filters": "asdf-plus", "than": "asdf-minus"}, 5),
        ({"filters": "asdf-minus", "than": "flawless"}, 12),
        ({"level": "quite high"}, -23),
        ({"level": 50.0}, 7),
        ({"filters": "asdf-minus", "than": {"filter": "none"}, "loss_from": 10}, 0),
        ({"than": {"percent": 50}, "loss_from": 10}, -2),
    ]
    for row, expected in rows:
        for question in asked(expected="above", panels="over_clear", percents=30, **row):
            assert question.answer(study, 0.9).estimate.value == pytest.approx(expected, abs=0.02), row


def test_trends_go_step_by_step_and_as_a_whole() -> None:
    for expected, step, whole in (("rises", "not below", "above"), ("falls", "not above", "below")):
        questions = asked(expected=expected, panels="over_clear", b_hats=0.95, percents=[10, 30, 50])
        found = [(*(cell.percent for cell in each.cells), each.expectation.value) for each in questions]
        assert found == [(30, 10, step), (50, 30, step), (50, 10, whole)]


def test_other_readings_are_shown_where_they_differ() -> None:
    """A lead of 4 points is no remarkable improvement, but one; 8 would be one with half the size."""
    for lead, more in ((4, {}), (8, {"with sizes halved": Verdict.AGREE})):
        level = by(lambda cell, lead=lead: 50 + lead * (cell.filter is MINUS))  # type: ignore[misc]
        found = decided(MadeUp(level), "minus_improves_remarkably", DYNAMIC)
        assert found.finding.verdict is Verdict.DISAGREE
        assert found.readings == {"any improvement": Verdict.AGREE, **more}


def test_intervals_allow_for_comparisons_and_looks(monkeypatch: pytest.MonkeyPatch) -> None:
    """Bonferroni's correction: 24 comparisons, looked at once or three times."""
    monkeypatch.setattr(resampling, "RESAMPLES", 4000)
    study = MadeUp(planted("(70, 8)"))
    for scale, looks in ((PAPER, 1), (Scale(), 3)):
        found = decided(study, "flawed_robots_harm", DYNAMIC, scale).finding.comparisons[0]
        after, before = (
            study.summarized(Cell(DYNAMIC, 0.95, 0.55, 0.75, percent), "H", resampling.MEDIAN, TRIALS)
            for percent in (10, 0)
        )
        wanted = interval(after.value - before.value, after.again - before.again, 1 - 0.05 / (24 * looks))
        assert tuple(found.estimate) == pytest.approx(tuple(wanted))


def test_open_comparisons_name_their_cells() -> None:
    def uneven(cell: Cell, measure: str) -> tuple[float, float]:
        is_open = (cell.filter, cell.percent, cell.fill_ratio, cell.true_accuracy) == (MINUS, 30, 0.95, 0.95)
        return (61 if is_open else 90 if cell.filter is MINUS else 50), 60 if is_open else 0.01

    found = decided(MadeUp(uneven), "minus_improves_remarkably", DYNAMIC)
    assert found.finding.count(None) == 2
    assert found.unsettled == {
        Cell(DYNAMIC, 0.95, 0.95, b_hat, 30, some) for b_hat in (0.55, 0.75) for some in (NONE, MINUS)
    }


# --- Facts -------------------------------------------------------------------------------------------


FLAT = planted("70")


def values_of(name: str) -> list[float]:
    return [each.estimate.value for each in decided(MadeUp(FLAT), name).finding.comparisons]


def test_facts_follow_from_the_equations() -> None:
    """A table printed to three digits, ratios of 81 and more, a slope of 1 / (2 b_hat - 1), and section V."""
    for name, count in (("table_of_observations", 4), ("table_of_local_estimates", 12)):
        assert len(values_of(name)) == count
        assert max(map(abs, values_of(name))) <= 0.0005 + 1e-9
    growth = values_of("confidence_increases_with_b_hat")
    assert growth == pytest.approx([(0.99 / 0.98) ** 2 - 1] * 3, rel=1e-2)
    ratios = values_of("confidence_grows_a_hundredfold")
    assert ratios[:3] == pytest.approx([25 - 100, 25 - 100, ratios[2]])
    assert ratios[3:5] == pytest.approx([81 - 100] * 2)
    assert min(ratios) == pytest.approx(0.81 / 0.25 - 100)
    assert max(ratios) > 28_000
    assert values_of("low_b_hat_is_volatile") == pytest.approx([0.01 / 0.1 - 0.01 / 0.9])
    assert values_of("physical_density") == pytest.approx([1.3423 - 1.3], abs=1e-4)
    assert values_of("physical_observations") == [0]
    found = decided(MadeUp(FLAT), "confidence_grows_a_hundredfold")
    assert found.finding.verdict is Verdict.MIXED
    assert found.readings == {"some pair, such as 0.505 and 0.995": Verdict.AGREE}


@pytest.mark.parametrize(
    ("name", "equation", "wrong"),
    [
        ("table_of_observations", "_seen_black", lambda f, b: 0.7),
        ("table_of_local_estimates", "local_estimate", lambda n, t, b: 0.7),
        ("low_b_hat_is_volatile", "local_estimate", lambda n, t, b: n / t * b),
        ("confidence_increases_with_b_hat", "local_confidence", lambda n, t, b: 1 - b),
        ("confidence_grows_a_hundredfold", "local_confidence", lambda n, t, b: b),
    ],
)
def test_other_equations_disagree(
    name: str, equation: str, wrong: Callable[..., float], monkeypatch: pytest.MonkeyPatch
) -> None:
    assert decided(MadeUp(FLAT), name).finding.verdict is not Verdict.DISAGREE
    monkeypatch.setattr(equations, equation, wrong)
    assert decided(MadeUp(FLAT), name).finding.verdict is Verdict.DISAGREE


@pytest.mark.parametrize("spread", [0, 1])
def test_identical_estimates_are_identical(spread: int, monkeypatch: pytest.MonkeyPatch) -> None:
    convergence_steps, errors = np.full((3, 4), 100), np.full((3, 4), 0.25)
    convergence_steps[2, 1] += spread
    errors[0, 3] += 1e-6 * spread
    study = MadeUp(FLAT)
    trials = SimpleNamespace(convergence_steps=convergence_steps, errors=errors)
    monkeypatch.setattr(study, "of", lambda part: [trials])
    found = decided(study, "connected_estimates_are_identical", FULL).finding
    assert found.verdict is (Verdict.DISAGREE if spread else Verdict.AGREE)


def test_corruption_is_that_of_the_robots_that_were_right() -> None:
    b_hat = np.array([[[0.9, 0.9, 0.5, 0.5]] * 2 + [[0.1, 0.2, 0.6, 0.8]]])
    trials: Any = SimpleNamespace(b_hat=b_hat, experiment=SimpleNamespace(flawed=2))
    assert MEASURES["b_hat"](trials, None) == pytest.approx([0.7])  # type: ignore[arg-type]
