"""The paper's claims, read from ``claims.toml``, and the comparisons by which trials decide them."""

from __future__ import annotations

import tomllib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any

from mcp_asdf_tools.experiments.experiment import combinations
from mcp_asdf_tools.robots.filters import FILTERS
from mcp_asdf_tools.studies.cells import (
    FILTER_PERIODS,
    FLAWED_ACCURACIES,
    FLAWED_PERCENTS,
    Cell,
    StudyPart,
)
from mcp_asdf_tools.studies.equations import EQUATIONS, ROUNDING
from mcp_asdf_tools.studies.study_results import StudyResults
from mcp_asdf_tools.studies.verdicts import (
    CONFIDENCE,
    Comparison,
    Expectation,
    Scope,
    Verdict,
    count_holding,
    exact_comparison,
    verdict_of,
)

_FILE = tomllib.loads(Path(__file__).with_name("claims.toml").read_text(encoding="utf-8"))

SIZES: Mapping[str, float] = _FILE["sizes"]
"""Smallest difference that counts, by the paper's words."""

LEVELS: Mapping[str, float] = _FILE["levels"]
"""Levels of a score, by the paper's words."""

QUESTIONS: Mapping[str, str] = _FILE["questions"]
"""Questions of a user, by the name of the claim that answers each."""

STRONG_WORDS = ("much", "overwhelming")
"""Sizes that the whole interval must reach, not only the difference."""

IDENTICAL_ROBOTS = "connected_estimates_are_identical"
"""The claim about the robots of one swarm, not about the difference of two swarms."""


@dataclass(frozen=True)
class Contrast:
    """A row of a claim in ``claims.toml``: cells, each compared with another cell or with a level.

    The head of the file describes the attributes, which are its keys; lists make all combinations.

    Attributes:
        expected: What the claim says about the difference: a value of ``Expectation``.
        measure: Name in MEASURES of what is compared.
        than_measure: Measure of the other cell, if it differs.
        size: Smallest difference that counts: a number, or a name in SIZES.
        panels: Names of f and b.
        flawed_accuracies: b_hat of the flawed robots.
        flawed_percents: P.
        filters: Which robots filter.
        filter_periods: tau in steps.
        than: How the other cell differs: attributes of ``Cell``, or the name of such a table.
        level: What is compared with where there is no other cell: a number, or a name in LEVELS.
    """

    expected: str
    measure: str = "H"
    than_measure: str = ""
    size: str | float = "seen"
    panels: str | Sequence[str] = "everywhere"
    flawed_accuracies: float | Sequence[float] = FLAWED_ACCURACIES
    flawed_percents: int | Sequence[int] = (10, 30, 50)
    filters: str | Sequence[str] = "none"
    filter_periods: int | Sequence[int] = FILTER_PERIODS[0]
    than: str | Mapping[str, Any] | None = None
    level: str | float | None = None

    def plan(self, study_part: StudyPart) -> list[PlannedComparison]:
        """List the comparisons about a part of the study, each pair of experiments once."""
        # Different rows of the file may mean the same experiments: see Cell.normal.
        plans = [
            PlannedComparison(self, cell.normal, reference.normal if reference else None)
            for cell in self._cells(study_part)
            for reference in self._references(cell)
        ]
        return list({(plan.cell, plan.reference): plan for plan in plans}.values())

    def _cells(self, study_part: StudyPart) -> list[Cell]:
        """Return all combinations of the contrast's values whose flawed robots are flawed."""
        value_combinations = product(
            _as_list(self.filters),
            _fill_ratios_and_accuracies(self.panels, study_part),
            _as_list(self.flawed_accuracies),
            _as_list(self.flawed_percents),
            _as_list(self.filter_periods),
        )
        return [
            Cell(study_part, fill_ratio, accuracy, flawed_accuracy, percent, filter_name, period)
            for filter_name, (fill_ratio, accuracy), flawed_accuracy, percent, period in value_combinations
            if flawed_accuracy != accuracy
        ]

    def _references(self, cell: Cell) -> list[Cell] | list[None]:
        """Return the cells with which a cell is compared; a list of None where that is a level."""
        if self.than is None:
            return [None]
        if self.than == "next lower P":
            # Which P that is depends on the cell, so no table of changes can say it.
            index = FLAWED_PERCENTS.index(cell.flawed_percent)
            return [replace(cell, flawed_percent=FLAWED_PERCENTS[index - 1])]
        changes = dict(_FILE["than"][self.than] if isinstance(self.than, str) else self.than)
        if "study_part" in changes:
            changes["study_part"] = StudyPart(changes["study_part"])
        # A list among the values stands for several reference cells.
        return [replace(cell, **change) for change in combinations(changes)]

    @property
    def size_in_points(self) -> float:
        """The smallest difference that counts, as a number."""
        return SIZES[self.size] if isinstance(self.size, str) else self.size

    @property
    def level_in_points(self) -> float | None:
        """The level as a number; None where there is none."""
        return LEVELS[self.level] if isinstance(self.level, str) else self.level


def _as_list(value: Any) -> list[Any]:
    """Return a list of the file as it is, and one value as a list of its own."""
    return list(value) if isinstance(value, list | tuple) else [value]


def _fill_ratios_and_accuracies(
    panels: str | Sequence[str], study_part: StudyPart
) -> list[tuple[float, float]]:
    """Return f and b of panels by their names; some names mean other panels in each part of the study."""
    pairs: list[tuple[float, float]] = []
    for name in _as_list(panels):
        panel = _FILE["panels"][name]
        pairs += panel[study_part.value] if isinstance(panel, dict) else panel
    return pairs


@dataclass(frozen=True)
class PlannedComparison:
    """A comparison to be made: of a cell with a reference, or with the contrast's level if that is None."""

    contrast: Contrast
    cell: Cell
    reference: Cell | None

    @property
    def parts(self) -> set[StudyPart]:
        """The parts of the study whose results it needs."""
        return {self.cell.study_part} | ({self.reference.study_part} if self.reference else set())

    def compare(self, study_results: StudyResults, confidence: float) -> Comparison:
        """Compare the cells by their trials, with an interval of the given confidence."""
        contrast = self.contrast
        # Differences are formed resample by resample, so that what both cells have in common cancels.
        difference = study_results.measure(self.cell, contrast.measure)
        if self.reference:
            difference -= study_results.measure(self.reference, contrast.than_measure or contrast.measure)
        elif contrast.level_in_points is not None:
            difference = difference.minus_constant(contrast.level_in_points)
        row, column = self._row_and_column()
        return Comparison(
            row,
            column,
            difference.interval(confidence),
            expectation=Expectation(contrast.expected),
            size=contrast.size_in_points,
            is_strong=contrast.size in STRONG_WORDS,
        )

    def _row_and_column(self) -> tuple[str, str]:
        """Return the row and the column of the claim's table that the comparison belongs to."""
        cell_labels = labels_of(self.cell)
        reference_labels = labels_of(self.reference) if self.reference else cell_labels
        row_names = ("fill_ratio", "true_accuracy", "flawed_accuracy")
        column_names = ["flawed_percent", "filter", "filter_period"]
        # The part of the study is named only where it is what differs.
        if reference_labels["study_part"] != cell_labels["study_part"]:
            column_names.insert(0, "study_part")
        row = ", ".join(cell_labels[name] for name in row_names if name in cell_labels)
        column = self.contrast.measure
        if self.contrast.level_in_points is not None:
            column += f" less {self.contrast.level_in_points:g}"
        column = ", ".join([column, *(cell_labels[name] for name in column_names if name in cell_labels)])
        if self.reference:
            changed = [label for name, label in reference_labels.items() if cell_labels.get(name) != label]
            column += f" less {', '.join(changed)}"
        return row, column


def labels_of(cell: Cell) -> dict[str, str]:
    """Return a label for each attribute of a cell that means something in it."""
    labels = {
        "study_part": cell.study_part.label,
        "fill_ratio": f"f {cell.fill_ratio:g}",
        "true_accuracy": f"b {cell.true_accuracy:g}",
        "flawed_accuracy": f"b_hat {cell.flawed_accuracy:g}",
        "flawed_percent": f"P {cell.flawed_percent} %",
        "filter": FILTERS[cell.filter].term,
        "filter_period": f"tau {cell.filter_period}",
    }
    # A label that means nothing would tell cells apart that are the same experiment.
    if cell.flawed_percent == 0:
        del labels["flawed_accuracy"]
    if cell.filter == "none":
        del labels["filter_period"]
    return labels


@dataclass(frozen=True)
class Claim:
    """A statement of the paper.

    Attributes:
        name: Its key in the file.
        where: Section, and figure or table.
        quote: The paper's own words.
        compared: What is compared, in ours.
        parts: The parts of the study that it is about; None stands for the equations.
        scope: How many comparisons must hold.
        contrasts: What is compared where trials decide.
    """

    name: str
    where: str
    quote: str
    compared: str
    parts: tuple[StudyPart | None, ...]
    scope: Scope
    contrasts: tuple[Contrast, ...]

    def plan(self, study_part: StudyPart) -> list[PlannedComparison]:
        """List all comparisons about a part of the study."""
        return [plan for contrast in self.contrasts for plan in contrast.plan(study_part)]


def _claim_from(name: str, row: Mapping[str, Any]) -> Claim:
    """Make a claim of its table in the file; a contrast with a list of measures stands for one with each."""
    # One row of the file may ask for several measures, to say once which cells are compared.
    contrasts = [
        Contrast(**{**contrast, "measure": measure})
        for contrast in row.get("contrasts", [])
        for measure in _as_list(contrast.get("measure", Contrast.measure))
    ]
    parts = (None,) if name in EQUATIONS else tuple(StudyPart(study_part) for study_part in row["parts"])
    scope = Scope(row.get("scope", "all"))
    return Claim(name, row["where"], row["quote"], row["compared"], parts, scope, tuple(contrasts))


CLAIMS = tuple(_claim_from(name, row) for name, row in _FILE["claims"].items())
"""All claims, in the order in which they stand in the paper."""


@dataclass(frozen=True)
class Decision:
    """What the results say about a claim in a part of the study; the part is None where equations decide."""

    claim: Claim
    study_part: StudyPart | None
    comparisons: tuple[Comparison, ...]

    @property
    def verdict(self) -> Verdict:
        """The verdict that follows from the comparisons."""
        return verdict_of(self.comparisons, self.claim.scope)

    @property
    def part_label(self) -> str:
        """Name of the part for people to read."""
        return self.study_part.label if self.study_part else "equations"

    @property
    def anchor(self) -> str:
        """Target of links to the claim in the report."""
        return f"{self.study_part.value if self.study_part else 'equations'}-{self.claim.name}"

    def count(self, holds: bool | None) -> int:
        """Count the comparisons that hold (True), fail (False) or are open (None)."""
        return count_holding(self.comparisons, holds)


def decide(study_results: StudyResults, claims: Iterable[Claim] = CLAIMS) -> list[Decision]:
    """Decide every claim of whose parts there are results. O(cells RESAMPLES trials)."""
    return [
        Decision(claim, study_part, tuple(_compare(claim, study_part, study_results)))
        for claim in claims
        for study_part in claim.parts
        if parts_needed(claim, study_part) <= set(study_results.parts)
    ]


def parts_needed(claim: Claim, study_part: StudyPart | None) -> set[StudyPart]:
    """Return the parts of the study whose results decide a claim about ``part``; none where equations do."""
    if study_part is None:
        return set()
    return {study_part}.union(*(plan.parts for plan in claim.plan(study_part)))


def _compare(claim: Claim, study_part: StudyPart | None, study_results: StudyResults) -> list[Comparison]:
    """Make all comparisons of a claim, with intervals so wide that all are right together with CONFIDENCE."""
    # Two kinds of claims have no contrasts: those of the equations, and the one about single robots.
    if study_part is None:
        return EQUATIONS[claim.name]()
    if claim.name == IDENTICAL_ROBOTS:
        return _compare_robots(study_part, study_results)
    plans = claim.plan(study_part)
    # Bonferroni's correction: errors of single comparisons add up to 1 - CONFIDENCE at most.
    bonferroni_confidence = 1 - (1 - CONFIDENCE) / len(plans)
    return [plan.compare(study_results, bonferroni_confidence) for plan in plans]


def _compare_robots(study_part: StudyPart, study_results: StudyResults) -> list[Comparison]:
    """Compare the largest K and e of the robots of a trial with the smallest ones, over all cells."""
    return [
        exact_comparison(
            "all cells", f"largest {name} in a trial less the smallest", value, Expectation.SAME, ROUNDING
        )
        for name, value in study_results.largest_differences_between_robots(study_part).items()
    ]
