"""The paper's claims, read from ``claims.toml``, and the comparisons by which trials decide them.

A cell is one kind of swarm of the study (see ``cells.Cell``), in the paper's symbols: f, the share of black
floor; b, the accuracy of the sensors; b_hat, the accuracy that a flawed robot wrongly assumes at the start;
P, the percentage of flawed robots; which robots filter; and tau, the steps from one filter step to the next.
A claim has contrasts: rows that compare the scores of cells with those of other cells, or with a level.
"""

from __future__ import annotations

import tomllib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from mcp_asdf_tools.experiments.experiment import combinations
from mcp_asdf_tools.robots.filters import FILTERS
from mcp_asdf_tools.studies.cells import (
    FLAWED_ACCURACIES,
    FLAWED_PERCENTS,
    SHORTEST_FILTER_PERIOD,
    Cell,
    StudyPart,
)
from mcp_asdf_tools.studies.equations import EQUATION_CLAIMS, ROUNDING
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

_CLAIMS_FILE = tomllib.loads(Path(__file__).with_name("claims.toml").read_text(encoding="utf-8"))

SIZES: Mapping[str, float] = _CLAIMS_FILE["sizes"]
"""Smallest difference that counts, in points of a score, by the paper's word, such as "much"."""

LEVELS: Mapping[str, float] = _CLAIMS_FILE["levels"]
"""Levels of a score from 0 to 100, by the paper's word, such as "excellent"."""

QUESTIONS: Mapping[str, str] = _CLAIMS_FILE["questions"]
"""Questions of a user, by the name of the claim that answers each."""

STRONG_WORDS = ("much", "overwhelming")
"""Sizes that the whole interval must reach, not only the difference."""

IDENTICAL_ROBOTS = "connected_estimates_are_identical"
"""The claim about the robots of one swarm, not about the difference of two swarms."""


@dataclass(frozen=True)
class Contrast:
    """A row of a claim in ``claims.toml``: cells, each compared with another cell or with a level.

    The head of the file describes the attributes, which are its keys. An attribute may have a list of values:
    the contrast is then about the cells of all combinations of values.

    Attributes:
        expected: What the claim says about the difference: a value of ``Expectation``.
        measure: Name in MEASURES of what is compared.
        than_measure: Measure of the other cell, if it differs.
        size: Smallest difference that counts: a number, or a name in SIZES.
        panels: Names of pairs of f, the share of black floor, and b, the sensors' accuracy.
        flawed_accuracy: b_hat of the flawed robots, the accuracy that they assume at the start.
        flawed_percent: P, the percentage of robots that are flawed.
        filter: Which robots filter: values of ``Experiment.filter``.
        filter_period: tau, the steps from one filter step to the next.
        than: How the other cell differs: attributes of ``Cell``, or the name of such a table.
        level: What is compared with where there is no other cell: a number, or a name in LEVELS.
    """

    expected: str
    measure: str = "H"
    than_measure: str = ""
    size: str | float = "seen"
    panels: str | Sequence[str] = "everywhere"
    flawed_accuracy: float | Sequence[float] = FLAWED_ACCURACIES
    flawed_percent: int | Sequence[int] = (10, 30, 50)
    filter: str | Sequence[str] = "none"
    filter_period: int | Sequence[int] = SHORTEST_FILTER_PERIOD
    than: str | Mapping[str, Any] | None = None
    level: str | float | None = None

    def plan(self, study_part: StudyPart) -> list[PlannedComparison]:
        """List the comparisons of the contrast's cells in a part of the study, each pair of cells once.

        A cell is a kind of swarm, which is compared with another cell or with a level.
        """
        comparison_of_cells: dict[tuple[Cell, Cell | None], PlannedComparison] = {}
        for cell in self._cells(study_part):
            for reference in self._references(cell):
                # Different values may describe the same experiment, which Cell.normal makes equal.
                normal_reference = None if reference is None else reference.normal
                comparison = PlannedComparison(self, cell.normal, normal_reference)
                # A pair that comes again replaces itself.
                comparison_of_cells[cell.normal, normal_reference] = comparison
        return list(comparison_of_cells.values())

    def _cells(self, study_part: StudyPart) -> list[Cell]:
        """Return a cell of the study's part for every combination of the contrast's values.

        Combinations in which b_hat, the accuracy that flawed robots assume, equals b, the true one, are left
        out: their "flawed" robots would be right.
        """
        values_of_cells = combinations(
            {
                "panels": self._panels(study_part),
                "filter": self.filter,
                "flawed_accuracy": self.flawed_accuracy,
                "flawed_percent": self.flawed_percent,
                "filter_period": self.filter_period,
            }
        )
        cells = [Cell(study_part=study_part, **values) for values in values_of_cells]
        return [cell for cell in cells if cell.flawed_accuracy != cell.true_accuracy]

    def _panels(self, study_part: StudyPart) -> list[dict[str, float]]:
        """Return f, the share of black floor, and b, the sensors' accuracy, of each of the contrast's panels.

        A panel is a plot of the paper's figures. Some names have other panels in each part of the study.
        """
        names = [self.panels] if isinstance(self.panels, str) else self.panels
        panels: list[dict[str, float]] = []
        for name in names:
            pairs = _CLAIMS_FILE["panels"][name]
            if isinstance(pairs, dict):  # which has the pairs by the part of the study
                pairs = pairs[study_part.value]
            panels += [{"fill_ratio": f, "true_accuracy": b} for f, b in pairs]
        return panels

    def _references(self, cell: Cell) -> list[Cell] | list[None]:
        """Return the cells with which a cell is compared: like it, but for what ``than`` changes.

        ``than`` has values of ``Cell``'s attributes, or is the name of such a table; "next lower P" is the
        next smaller percentage of flawed robots. Without ``than`` the cell is compared with the level, or its
        measure with 0: the list is then [None].
        """
        if self.than is None:
            return [None]
        if self.than == "next lower P":
            # Which percentage that is depends on the cell, so no table of changes can describe it.
            percent_index = FLAWED_PERCENTS.index(cell.flawed_percent)
            next_lower_percent = FLAWED_PERCENTS[percent_index - 1]
            return [replace(cell, flawed_percent=next_lower_percent)]
        changes = self.than
        if isinstance(changes, str):
            named_changes = _CLAIMS_FILE["than"]
            changes = named_changes[changes]
        if "study_part" in changes:
            changes = {**changes, "study_part": StudyPart(changes["study_part"])}
        # A list among the values stands for several reference cells.
        return [replace(cell, **change) for change in combinations(changes)]

    @property
    def size_in_points(self) -> float:
        """The smallest difference that counts, as a number in the unit of the measure."""
        if isinstance(self.size, str):
            return SIZES[self.size]
        return self.size

    @property
    def level_in_points(self) -> float | None:
        """The level of a score, from 0 to 100, that cells are compared with; None where there is none."""
        if isinstance(self.level, str):
            return LEVELS[self.level]
        return self.level


@dataclass(frozen=True)
class PlannedComparison:
    """A comparison that results of the study can make.

    Attributes:
        contrast: Says what is measured, and what is expected of the difference.
        cell: The cell that is compared.
        reference: The cell with which it is compared; None if that is the contrast's level, or 0 without one.
    """

    contrast: Contrast
    cell: Cell
    reference: Cell | None

    @property
    def parts(self) -> set[StudyPart]:
        """The parts of the study whose results the comparison needs: of its cell and of its reference."""
        if self.reference is None:
            return {self.cell.study_part}
        return {self.cell.study_part, self.reference.study_part}

    def compare(self, study_results: StudyResults, confidence: float) -> Comparison:
        """Return the difference by the trials, with an interval of this confidence, 0.95 for example.

        It is the measure of the cell less that of the reference, or less the level if there is none; without
        either it is the measure itself. Raises KeyError if ``study_results`` lack one of the two cells.
        """
        contrast = self.contrast
        difference = study_results.measure(self.cell, contrast.measure)
        if self.reference:
            # Subtracted resample by resample, so that what both cells have in common cancels.
            difference -= study_results.measure(self.reference, contrast.than_measure or contrast.measure)
        elif contrast.level_in_points is not None:
            difference = difference.minus_constant(contrast.level_in_points)
        return Comparison(
            row=self._row_label(),
            column=self._column_label(),
            interval=difference.interval(confidence),
            expectation=Expectation(contrast.expected),
            size=contrast.size_in_points,
            is_strong=contrast.size in STRONG_WORDS,
        )

    def _row_label(self) -> str:
        """Return the label of the comparison's row in the report, such as "f 0.95, b 0.55, b_hat 0.95".

        Without flawed robots there is no b_hat.
        """
        cell_labels = labels_of(self.cell)
        attributes = ("fill_ratio", "true_accuracy", "flawed_accuracy")
        return ", ".join(cell_labels[name] for name in attributes if name in cell_labels)

    def _column_label(self) -> str:
        """Return the label of the comparison's column in the report: what is subtracted from what.

        With a reference it ends in the attributes in which this differs: "H, P 30 %, ASDF+, tau 1000 less no
        filter". With a level it begins with the difference: "H less 95, P 30 %, no filter".
        """
        if self.reference is None:
            return self._minuend_label()
        cell_labels = labels_of(self.cell)
        reference_labels = labels_of(self.reference)
        changed_labels = [label for name, label in reference_labels.items() if label != cell_labels.get(name)]
        subtrahend = ", ".join(changed_labels)
        return f"{self._minuend_label()} less {subtrahend}"

    def _minuend_label(self) -> str:
        """Return a label that says what is measured in the cell, such as "H, P 30 %, ASDF+, tau 1000".

        With a level it begins with the difference, such as "H less 95". The part of the study is named only
        where the reference is of another part.
        """
        measured_value = self.contrast.measure
        if self.contrast.level_in_points is not None:
            measured_value += f" less {self.contrast.level_in_points:g}"
        attributes = ["flawed_percent", "filter", "filter_period"]
        if len(self.parts) > 1:
            attributes.insert(0, "study_part")
        cell_labels = labels_of(self.cell)
        shown_labels = [cell_labels[name] for name in attributes if name in cell_labels]
        return ", ".join([measured_value, *shown_labels])


def labels_of(cell: Cell) -> dict[str, str]:
    """Return labels such as "P 30 %" for the attributes of a cell, by the attributes' names.

    Attributes that have no meaning in the cell are left out: b_hat of flawed robots where there are none, and
    tau, the filter's period in steps, where no robot filters.
    """
    labels = {
        "study_part": cell.study_part.label,
        "fill_ratio": f"f {cell.fill_ratio:g}",
        "true_accuracy": f"b {cell.true_accuracy:g}",
        "flawed_accuracy": f"b_hat {cell.flawed_accuracy:g}",
        "flawed_percent": f"P {cell.flawed_percent} %",
        "filter": FILTERS[cell.filter].term,
        "filter_period": f"tau {cell.filter_period}",
    }
    # Such a label would make a difference between cells that are the same experiment.
    if cell.flawed_percent == 0:
        del labels["flawed_accuracy"]
    if cell.filter == "none":
        del labels["filter_period"]
    return labels


@dataclass(frozen=True)
class Claim:
    """A statement of the paper that equations or trials decide.

    Attributes:
        name: Its key in ``claims.toml``.
        where: Where the paper has it: the section, and the figure or table.
        quote: The sentence of the paper.
        compared: What the study compares to decide it, as a sentence for the report.
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
        """List the comparisons of all contrasts in a part of the study, in the order of the file."""
        return [plan for contrast in self.contrasts for plan in contrast.plan(study_part)]


def _claim_from(name: str, row: Mapping[str, Any]) -> Claim:
    """Make the claim called ``name`` from its table in ``claims.toml``."""
    # None stands for the equations, which need no trials.
    parts: tuple[StudyPart | None, ...] = (None,)
    if name not in EQUATION_CLAIMS:
        parts = tuple(StudyPart(part_name) for part_name in row["parts"])
    return Claim(
        name=name,
        where=row["where"],
        quote=row["quote"],
        compared=row["compared"],
        parts=parts,
        scope=Scope(row.get("scope", "all")),
        contrasts=tuple(Contrast(**contrast_row) for contrast_row in row.get("contrasts", [])),
    )


CLAIMS = tuple(_claim_from(name, row) for name, row in _CLAIMS_FILE["claims"].items())
"""All claims, in the order in which they stand in the paper."""


@dataclass(frozen=True)
class Decision:
    """The comparisons that decide a claim in one part of the study, and their verdict.

    Attributes:
        claim: The claim of the paper.
        study_part: The part of the study; None if the paper's equations decide instead of trials.
        comparisons: All comparisons of the claim with these results.
    """

    claim: Claim
    study_part: StudyPart | None
    comparisons: tuple[Comparison, ...]

    @property
    def verdict(self) -> Verdict:
        """The verdict that follows from the comparisons and from how many of them must hold."""
        return verdict_of(self.comparisons, self.claim.scope)

    @property
    def part_label(self) -> str:
        """The name of the part for readers of the report; "equations" if there is no part."""
        if self.study_part is None:
            return "equations"
        return self.study_part.label

    @property
    def anchor(self) -> str:
        """The target of links to the claim in the report: the part and the claim's name, without spaces."""
        part_name = self.study_part.value if self.study_part else "equations"
        return f"{part_name}-{self.claim.name}"

    def count(self, holds: bool | None) -> int:
        """Count the comparisons that hold (True), fail (False) or are open (None)."""
        return count_holding(self.comparisons, holds)


def decide(study_results: StudyResults, claims: Iterable[Claim] = CLAIMS) -> list[Decision]:
    """Return a decision for every claim and each of its parts, in the order of the claims.

    Parts of a claim are left out where ``study_results`` lack a part of the study that the comparisons need.
    O(cells RESAMPLES trials).
    """
    parts_with_results = set(study_results.parts)
    decisions: list[Decision] = []
    for claim in claims:
        for study_part in claim.parts:
            # The user may have run some parts of the study only.
            if parts_needed(claim, study_part).issubset(parts_with_results):
                comparisons = tuple(_compare(claim, study_part, study_results))
                decisions.append(Decision(claim, study_part, comparisons))
    return decisions


def parts_needed(claim: Claim, study_part: StudyPart | None) -> set[StudyPart]:
    """Return the parts of the study whose results decide a claim about one of its parts.

    These are more than that part where the claim compares parts with each other, and none where it has None
    as its part, as equations decide it.
    """
    if study_part is None:
        return set()
    parts = {study_part}
    for plan in claim.plan(study_part):
        parts |= plan.parts
    return parts


def _compare(claim: Claim, study_part: StudyPart | None, study_results: StudyResults) -> list[Comparison]:
    """Make all comparisons of a claim in a part of the study, or of its equations if the part is None.

    The intervals are so wide that, with the probability CONFIDENCE, every one contains its true difference.
    """
    if study_part is None:
        # Two kinds of claims have no contrasts: those of the equations, and the one about single robots.
        return EQUATION_CLAIMS[claim.name]()
    if claim.name == IDENTICAL_ROBOTS:
        return _compare_robots(study_part, study_results)
    plans = claim.plan(study_part)
    # Bonferroni's correction: the error probabilities of the comparisons add up to 1 - CONFIDENCE at most.
    error_probability = (1 - CONFIDENCE) / len(plans)
    bonferroni_confidence = 1 - error_probability
    return [plan.compare(study_results, bonferroni_confidence) for plan in plans]


def _compare_robots(study_part: StudyPart, study_results: StudyResults) -> list[Comparison]:
    """Compare the robots of each trial of a part with each other: one comparison for K, and one for e.

    K is the step at which a robot's estimate has converged, and e its error |x - f| at that step. Each
    comparison has the largest difference between two robots of one trial, and expects it to be 0 but for
    ROUNDING.
    """
    differences = study_results.largest_differences_between_robots(study_part)
    return [
        exact_comparison(
            row="all cells",
            column=f"largest {quantity} in a trial less the smallest",
            value=difference,
            expectation=Expectation.SAME,
            size=ROUNDING,
        )
        for quantity, difference in differences.items()
    ]
