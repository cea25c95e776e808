"""Every claim of the paper: results made up so that it holds, and so that it does not."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from mcp_asdf_tools.reproduction import resampling
from mcp_asdf_tools.reproduction.claims import CLAIMS, factors
from mcp_asdf_tools.reproduction.claims.asdf_plus import CORRUPTION
from mcp_asdf_tools.reproduction.comparisons import Claim
from mcp_asdf_tools.reproduction.decisions import Decision, abouts, decide, needs
from mcp_asdf_tools.reproduction.resampling import Sample
from mcp_asdf_tools.reproduction.study import PAPER, Cell, Measure, Part, Scale, Study, cells_of
from mcp_asdf_tools.reproduction.verdicts import Verdict
from mcp_asdf_tools.robots.population import Filtering

FULL, DYNAMIC, PHYSICAL = Part
NONE, MINUS, PLUS = Filtering

Level = Callable[[Cell, str], float | tuple[float, float]]
"""The median of a cell and a measure, or median and interquartile range."""

TRIALS = 30
CELLS = {cell for part in Part for cell in cells_of(part)}


@pytest.fixture(autouse=True)
def few_resamples(monkeypatch: pytest.MonkeyPatch) -> None:
    """The results made up here are far from any limit."""
    monkeypatch.setattr(resampling, "RESAMPLES", 100)


class MadeUp(Study):
    """Results that are as one likes."""

    def __init__(self, level: Level, parts: Collection[Part] = tuple(Part)) -> None:
        super().__init__({})
        self._level = level
        self._run = parts

    @property
    def parts(self) -> set[Part]:
        return set(self._run)

    def count(self, cells: Iterable[Cell]) -> int:
        return TRIALS

    def sample(self, cell: Cell, measure: Measure) -> Sample:
        assert cell.normal in CELLS
        assert cell.part in self._run
        level = self._level(cell.normal, measure.name)
        median, spread = level if isinstance(level, tuple) else (level, 0.01)
        noise = np.random.default_rng(cell.normal.percent).permutation(TRIALS)
        return median + spread * 2 * (noise / (TRIALS - 1) - 0.5)


def flat(cell: Cell, measure: str) -> float:
    return 70


def rising(cell: Cell, measure: str) -> float:
    return 40 + 0.5 * cell.percent


def falling(cell: Cell, measure: str) -> float:
    return 90 - 0.5 * cell.percent


def leading(**wanted: Any) -> Level:
    """Cells that are as wanted score higher."""
    return lambda cell, measure: 90 if all(getattr(cell, k) == v for k, v in wanted.items()) else 50


def trailing(**wanted: Any) -> Level:
    """Cells that are as wanted score lower."""
    return lambda cell, measure: 50 if all(getattr(cell, k) == v for k, v in wanted.items()) else 90


def each(**levels: Level) -> Level:
    """A level for each measure."""
    return lambda cell, measure: levels[measure](cell, measure)


def constant(value: float) -> Level:
    return lambda cell, measure: value


def where_clear(here: Level, elsewhere: Level) -> Level:
    """One where f = 0.95, another where f = 0.55."""
    return lambda cell, measure: (here if cell.fill_ratio == 0.95 else elsewhere)(cell, measure)


def spreading(is_wide: Callable[[Cell], bool]) -> Level:
    return lambda cell, measure: (70, 8 if is_wide(cell) else 1)


def is_over_clear(cell: Cell) -> bool:
    return (cell.fill_ratio, cell.true_accuracy) == (0.95, 0.55)


def speed_for_accuracy(cell: Cell, measure: str) -> float:
    if measure == "h_K":
        return 50 + 0.4 * cell.percent
    return 98 if not cell.percent else 80 if cell.fill_ratio == 0.55 else 40


def accuracy_for_speed(cell: Cell, measure: str) -> float:
    if measure == "h_K":
        return 50 - 0.4 * cell.percent
    return 50 if not cell.percent else 60 if cell.fill_ratio == 0.55 else 80


CASES: dict[str, tuple[Level, Level]] = {
    "environment_improves_accuracy": (
        lambda cell, _: 95 if cell.fill_ratio == cell.true_accuracy else 60,
        lambda cell, _: 60 if cell.fill_ratio == cell.true_accuracy else 95,
    ),
    "environment_improves_convergence": (
        lambda cell, _: 95 if cell.fill_ratio == cell.true_accuracy else 60,
        lambda cell, _: 60 if cell.fill_ratio == cell.true_accuracy else 95,
    ),
    "low_b_hat_is_slow": (
        lambda cell, _: 90 * cell.flawed_accuracy,
        lambda cell, _: 90 * (1 - cell.flawed_accuracy),
    ),
    "short_periods_are_better": (
        lambda cell, _: 90 - cell.period / 100,
        lambda cell, _: 40 + cell.period / 100,
    ),
    "flawed_robots_harm": (falling, rising),
    "flawed_robots_harm_substantially": (lambda cell, _: 95 - 1.5 * cell.percent, flat),
    "overconfident_robots_help_where_easy": (rising, falling),
    "underconfident_swarms_may_thrive": (leading(percent=100), falling),
    "any_flawed_robots_help_where_easy": (trailing(percent=0), leading(percent=0)),
    "speed_costs_little_accuracy_where_easy": (
        each(h_K=trailing(percent=0), h_e=lambda cell, _: 92 if cell.percent else 98),
        each(h_K=leading(percent=0), h_e=leading(percent=0)),
    ),
    "overconfident_swarms_trade_accuracy_for_speed": (speed_for_accuracy, accuracy_for_speed),
    "entirely_flawed_swarms_do_better": (leading(percent=100), trailing(percent=100)),
    "entirely_underconfident_swarms_are_volatile": (trailing(percent=100), leading(percent=100)),
    "symmetric_errors_differ_in_speed": (
        each(h_K=leading(fill_ratio=0.95), h_e=flat, H=leading(fill_ratio=0.95)),
        each(h_K=flat, h_e=leading(fill_ratio=0.95), H=trailing(fill_ratio=0.95)),
    ),
    "saturated_estimates_converge_fast": (leading(percent=100), trailing(percent=100)),
    "saturated_estimates_coincide": (flat, leading(flawed_accuracy=0.75)),
    "connected_overconfident_score_higher": (leading(part=FULL), leading(part=DYNAMIC)),
    "connected_overconfident_rise_where_easy": (rising, falling),
    "connected_overconfident_fall_where_clear": (falling, rising),
    "connected_underconfident_outdo_dynamic": (
        leading(part=FULL),
        lambda cell, _: 75 if cell.part is FULL else 70,
    ),
    "connected_underconfident_do_no_harm": (flat, falling),
    "connected_underconfident_fail_together": (trailing(percent=100), flat),
    "localized_swarms_decline_more": (
        lambda cell, _: 90 - cell.percent * (0.9 if cell.part is DYNAMIC else 0.1),
        lambda cell, _: 90 - cell.percent * (0.1 if cell.part is DYNAMIC else 0.9),
    ),
    "minus_improves_remarkably": (leading(filter=MINUS), trailing(filter=MINUS)),
    "minus_prevents_decline_in_some_cases": (
        lambda cell, _: (
            90 if not cell.percent or (is_over_clear(cell) and cell.flawed_accuracy == 0.95) else 50
        ),
        falling,
    ),
    "minus_keeps_overconfident_flawless": (flat, falling),
    "minus_keeps_few_underconfident_flawless": (
        lambda cell, _: 90 if cell.percent <= 10 else 60,
        lambda cell, _: 60 if cell.percent == 10 else 90,
    ),
    "minus_weakens_with_period": (
        lambda cell, _: 90 - cell.period / 100,
        lambda cell, _: 40 + cell.period / 100,
    ),
    "minus_improves_at_any_period": (leading(filter=MINUS), trailing(filter=MINUS)),
    "minus_at_long_periods_is_no_filter": (flat, leading(filter=MINUS)),
    "minus_holds_the_level_where_easy": (flat, falling),
    "minus_slows_where_easy": (
        each(h_K=trailing(filter=MINUS), H=lambda cell, _: 40 + cell.period / 100),
        each(h_K=leading(filter=MINUS), H=lambda cell, _: 90 - cell.period / 100),
    ),
    "minus_gains_from_connection": (leading(part=FULL), trailing(part=FULL)),
    "dynamic_minus_fares_quite_well": (constant(90), constant(60)),
    "underconfident_connected_are_almost_perfect": (constant(99), constant(80)),
    "connected_minus_follows_dynamic_trends": (
        where_clear(leading(filter=MINUS), trailing(filter=MINUS)),
        where_clear(trailing(filter=MINUS), leading(filter=MINUS)),
    ),
    "minus_outperforms_the_baseline": (leading(filter=MINUS), flat),
    "plus_spreads_wider": (
        spreading(lambda cell: cell.filter is PLUS),
        spreading(lambda cell: cell.filter is MINUS),
    ),
    "plus_improves_significantly": (leading(filter=PLUS), trailing(filter=PLUS)),
    "plus_is_moderately_worse_than_minus": (trailing(filter=PLUS), flat),
    "plus_is_inferior_to_minus_at_half": (trailing(filter=PLUS), leading(filter=PLUS)),
    "plus_beats_the_best_minus_where_easy": (leading(filter=PLUS), flat),
    "plus_gains_speed_where_easy": (
        each(h_K=leading(filter=PLUS), h_e=lambda cell, _: 92 if cell.filter is PLUS else 98),
        each(h_K=trailing(filter=PLUS), h_e=trailing(filter=PLUS)),
    ),
    "plus_rises_where_easy": (rising, falling),
    "plus_improves_at_any_period": (leading(filter=PLUS), flat),
    "plus_does_not_improve_the_exception": (flat, leading(filter=PLUS)),
    "only_overconfident_trade_off_at_half": (
        lambda cell, measure: (70, -5 if measure == "h_e" and is_over_clear(cell) else 5),
        lambda cell, measure: (70, -5 if measure == "h_e" and not is_over_clear(cell) else 5),
    ),
    "filters_do_not_help_entirely_flawed_swarms": (trailing(filter=PLUS), leading(filter=PLUS)),
    "filters_mostly_harm_entirely_flawed_swarms": (trailing(filter=PLUS), flat),
    "entirely_flawed_swarms_lose_speed_only": (flat, trailing(filter=PLUS)),
    "filters_are_accurate": (constant(97), constant(60)),
    "overconfident_plus_loses_accuracy": (trailing(filter=PLUS), flat),
    "plus_gains_from_connection": (leading(part=FULL), flat),
    "plus_does_not_improve_overconfident": (flat, leading(filter=PLUS)),
    "plus_improves_few_overconfident": (leading(filter=PLUS), trailing(filter=PLUS)),
    "few_overconfident_settle_late": (rising, falling),
    "overconfident_robots_corrupt_correct_ones": (
        lambda cell, measure: 0.9 if measure == CORRUPTION.name else falling(cell, measure),
        lambda cell, measure: 0.55 if measure == CORRUPTION.name else 90,
    ),
    "few_overconfident_do_not_mislead": (leading(filter=PLUS), flat),
    "plus_is_similar_to_minus": (flat, leading(filter=PLUS)),
    "plus_is_worse_than_minus_where_clear": (trailing(filter=PLUS), flat),
    "minus_still_improves_where_clear": (leading(filter=MINUS), flat),
    "plus_improves_overconfident_swarms": (leading(filter=PLUS), flat),
    "filters_can_improve_underconfident_swarms": (trailing(filter=NONE), flat),
    "dynamic_plus_comes_close": (lambda cell, _: 95 if cell.part is FULL else 92, leading(part=FULL)),
    "dynamic_plus_spreads_wider": (
        spreading(lambda cell: cell.part is DYNAMIC),
        spreading(lambda cell: cell.part is FULL),
    ),
    "overconfident_are_accurate_where_easy": (constant(90), constant(60)),
    "filters_make_the_decline_milder": (trailing(filter=NONE), flat),
    "filters_retain_the_level_somewhere": (flat, falling),
    "short_runs_are_comparable_with_and_without_filter": (flat, leading(filter=PLUS)),
    "plus_has_no_effect_in_short_runs": (flat, leading(filter=PLUS)),
    "plus_speeds_up_the_exception": (
        each(h_K=leading(filter=PLUS), h_e=flat),
        each(h_K=flat, h_e=trailing(filter=PLUS)),
    ),
    "short_runs_are_accurate": (constant(90), constant(60)),
    "short_runs_converge_poorly": (constant(20), constant(80)),
    "short_runs_do_not_depend_on_p": (flat, falling),
    "longer_runs_converge_better": (leading(part=DYNAMIC), leading(part=PHYSICAL)),
    "plus_does_no_harm_in_short_runs": (flat, trailing(filter=PLUS)),
}

OTHERWISE = {
    "table_of_observations",
    "table_of_local_estimates",
    "confidence_increases_with_b_hat",
    "confidence_grows_a_hundredfold",
    "low_b_hat_is_volatile",
    "physical_density",
    "physical_observations",
    "connected_estimates_are_identical",
}
"""Claims with tests of their own."""

NAMED = [
    pytest.param(claim, part, id=f"{claim.name}-{part and part.value}")
    for claim in CLAIMS
    for part in abouts(claim)
]


def decided(study: Study, name: str, part: Part | None = None, scale: Scale = PAPER) -> Decision:
    claims = [claim for claim in CLAIMS if claim.name == name]
    (found,) = [each for each in decide(study, scale, claims) if each.part in (part, None)]
    return found


def test_every_claim_is_tested() -> None:
    assert {claim.name for claim in CLAIMS} == {*CASES, *OTHERWISE}
    assert len({claim.name for claim in CLAIMS}) == len(CLAIMS)


@pytest.mark.parametrize(("claim", "part"), NAMED)
def test_a_claim_agrees_and_disagrees(claim: Claim, part: Part | None) -> None:
    if claim.name in OTHERWISE:
        return
    for level, verdict in zip(CASES[claim.name], (Verdict.AGREE, Verdict.DISAGREE), strict=True):
        # What is not among the needs may not have been run.
        found = decided(MadeUp(level, needs(claim, part)), claim.name, part).finding
        shown = "\n".join(f"{each.label}: {each.estimate} {each.holds}" for each in found.comparisons)
        assert found.verdict is verdict, shown


@pytest.mark.parametrize(("claim", "part"), NAMED)
def test_a_claim_says_what_and_where(claim: Claim, part: Part | None) -> None:
    assert claim.where.split(",")[0].split("-")[0] in ("III", "IV", "V", "VI") or "figure" in claim.where
    assert claim.words
    assert claim.compared
    assert part is None or part in needs(claim, part)
    if claim.name not in OTHERWISE:
        comparisons = decided(MadeUp(flat), claim.name, part).finding.comparisons
        places = {(each.place, each.expectation, each.size) for each in comparisons}
        assert len(places) == len(comparisons), "cells would be drawn on top of each other"


def test_other_readings_are_shown_where_they_differ() -> None:
    """A lead of 4 points is no remarkable improvement, but one."""
    found = decided(
        MadeUp(lambda cell, _: 54 if cell.filter is MINUS else 50), "minus_improves_remarkably", DYNAMIC
    )
    assert found.finding.verdict is Verdict.DISAGREE
    assert found.readings == {"any improvement": Verdict.AGREE}
    found = decided(
        MadeUp(lambda cell, _: 58 if cell.filter is MINUS else 50), "minus_improves_remarkably", DYNAMIC
    )
    assert found.readings == {"any improvement": Verdict.AGREE, "with sizes halved": Verdict.AGREE}


def test_intervals_allow_for_comparisons_and_looks(monkeypatch: pytest.MonkeyPatch) -> None:
    """More looks at the trials make wider intervals."""

    def widths(scale: Scale) -> list[float]:
        level = spreading(lambda cell: True)
        found = decided(MadeUp(level), "flawed_robots_harm", DYNAMIC, scale).finding
        return [each.estimate.high - each.estimate.low for each in found.comparisons]

    monkeypatch.setattr(resampling, "RESAMPLES", 4000)
    once, often = widths(PAPER), widths(Scale())
    assert Scale().effort(DYNAMIC).looks == 3
    assert all(one <= more for one, more in zip(once, often, strict=True))
    assert sum(once) < sum(often)


def test_open_comparisons_name_their_cells() -> None:
    def uneven(cell: Cell, measure: str) -> tuple[float, float]:
        is_open = (
            cell.filter is MINUS and cell.percent == 30 and cell.fill_ratio == cell.true_accuracy == 0.95
        )
        return (61 if is_open else 90 if cell.filter is MINUS else 50), 60 if is_open else 0.01

    found = decided(MadeUp(uneven), "minus_improves_remarkably", DYNAMIC)
    assert found.finding.count(None) == 2
    assert {cell.percent for cell in found.unsettled} == {30}
    assert len(found.unsettled) == 4


def test_the_tables_of_the_paper_are_met(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, rows in (("table_of_observations", 4), ("table_of_local_estimates", 12)):
        found = decided(MadeUp(flat), name).finding
        assert len(found.comparisons) == rows
        assert found.verdict is Verdict.AGREE
    monkeypatch.setattr(factors, "local_estimate", lambda n, t, b: 0.7)
    assert decided(MadeUp(flat), "table_of_local_estimates").finding.verdict is Verdict.DISAGREE
    monkeypatch.setattr(factors, "_seen_black", lambda f, b: 0.7)
    assert decided(MadeUp(flat), "table_of_observations").finding.verdict is Verdict.DISAGREE


def test_confidences_are_compared(monkeypatch: pytest.MonkeyPatch) -> None:
    """(2 0.95 - 1)^2 / (2 0.55 - 1)^2 = 81 while no estimate is saturated; the range is that of the pairs."""
    name = "confidence_grows_a_hundredfold"
    found = decided(MadeUp(flat), name)
    assert len(found.finding.comparisons) == 12
    middle = [each.estimate.value for each in found.finding.comparisons[3:6]]
    assert middle[:2] == pytest.approx([-19, -19])
    assert middle[2] > 0
    values = [each.estimate.value + 100 for each in found.finding.comparisons]
    assert min(values) == pytest.approx(0.81 / 0.25, rel=1e-6)  # 3.24 times
    assert max(values) > 28_000
    assert found.finding.verdict is Verdict.MIXED
    assert found.readings["some pair, such as 0.505 and 0.995"] is Verdict.AGREE
    monkeypatch.setattr(factors, "local_confidence", lambda n, t, b: 10 ** (20 * b))
    assert decided(MadeUp(flat), name).finding.verdict is Verdict.AGREE
    monkeypatch.setattr(factors, "local_confidence", lambda n, t, b: b)
    assert decided(MadeUp(flat), name).finding.verdict is Verdict.DISAGREE


def test_confidence_and_volatility_follow_b_hat(monkeypatch: pytest.MonkeyPatch) -> None:
    """x_hat moves by 0.01 / (2 b_hat - 1) while n/t moves by 0.01."""
    assert decided(MadeUp(flat), "confidence_increases_with_b_hat").finding.verdict is Verdict.AGREE
    (slope,) = decided(MadeUp(flat), "low_b_hat_is_volatile").finding.comparisons
    assert slope.estimate.value == pytest.approx(0.01 / 0.1 - 0.01 / 0.9)
    monkeypatch.setattr(factors, "local_confidence", lambda n, t, b: 1 - b)
    assert decided(MadeUp(flat), "confidence_increases_with_b_hat").finding.verdict is Verdict.DISAGREE


def test_the_physical_numbers_are_the_papers() -> None:
    (density,) = decided(MadeUp(flat), "physical_density").finding.comparisons
    assert density.estimate.value == pytest.approx(1.3423 - 1.3, abs=1e-4)
    assert density.holds
    (ratio,) = decided(MadeUp(flat), "physical_observations").finding.comparisons
    assert ratio.estimate.value == 0


@pytest.mark.parametrize("spread", [0, 1])
def test_identical_estimates_are_identical(spread: int, monkeypatch: pytest.MonkeyPatch) -> None:
    convergence_steps, errors = np.full((3, 4), 100), np.full((3, 4), 0.25)
    convergence_steps[2, 1] += spread
    errors[0, 3] += 1e-6 * spread
    study = MadeUp(flat)
    monkeypatch.setattr(
        study, "of", lambda part: [SimpleNamespace(convergence_steps=convergence_steps, errors=errors)]
    )
    found = decided(study, "connected_estimates_are_identical", FULL).finding
    assert found.verdict is (Verdict.DISAGREE if spread else Verdict.AGREE)


def test_corruption_is_that_of_the_robots_that_were_right() -> None:
    b_hat = np.array([[[0.9, 0.9, 0.5, 0.5]] * 2 + [[0.1, 0.2, 0.6, 0.8]]])
    trials: Any = SimpleNamespace(b_hat=b_hat, experiment=SimpleNamespace(flawed=2))
    assert CORRUPTION.of(trials, None) == pytest.approx([0.7])  # type: ignore[arg-type]
