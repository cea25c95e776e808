"""Claims decided: the comparisons of each, its other readings, and the cells that need more trials."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from mcp_asdf_tools.reproduction.claims import CLAIMS, Claim, Question, Reading
from mcp_asdf_tools.reproduction.study import Cell, Part, Scale, Study
from mcp_asdf_tools.reproduction.verdicts import CONFIDENCE, Finding, Scope, Verdict

FACTORS = {"with sizes halved": 0.5, "with sizes doubled": 2.0}
"""Readings of every claim: its sizes are ours."""


@dataclass(frozen=True)
class Decision:
    """Outcome of a claim for a part.

    Attributes:
        claim: The claim.
        part: About which experiments; None where the equations decide.
        finding: The comparisons.
        readings: Decided verdicts of other readings that differ from its own, by their words.
        unsettled: Cells in comparisons that are open.
    """

    claim: Claim
    part: Part | None
    finding: Finding
    readings: Mapping[str, Verdict]
    unsettled: frozenset[Cell]

    @property
    def anchor(self) -> str:
        """Its place in the report."""
        return f"{self.part.value if self.part else 'equations'}-{self.claim.name}"


Decided = Sequence[Decision]


def needs(reading: Reading, part: Part | None) -> set[Part]:
    """The parts whose results decide a claim."""
    return {cell.part for cell in _cells(reading.questions(part))}


def decide(study: Study, scale: Scale, claims: Iterable[Claim] = CLAIMS) -> Decided:
    """Decide every claim whose parts have been run. O(cells resamples trials)."""
    return [
        _decide(study, scale, claim, part)
        for claim in claims
        for part in claim.parts
        if needs(claim.reading, part) <= study.parts
    ]


def _decide(study: Study, scale: Scale, claim: Claim, part: Part | None) -> Decision:
    questions = claim.reading.questions(part)
    finding = _answers(study, scale, questions, claim.reading.scope)
    others: dict[str, Verdict] = {
        each.words: _answers(study, scale, each.questions(part), each.scope).verdict
        for each in claim.readings
        if needs(each, part) <= study.parts
    }
    if part is not None:
        others |= {words: finding.scaled(factor).verdict for words, factor in FACTORS.items()}
    readings = {
        words: verdict
        for words, verdict in others.items()
        if verdict not in (finding.verdict, Verdict.UNDECIDED)
    }
    pairs = zip(questions, finding.comparisons, strict=True)
    unsettled = _cells(question for question, found in pairs if found.holds is None)
    return Decision(claim, part, finding, readings, frozenset(unsettled))


def _cells(questions: Iterable[Question]) -> set[Cell]:
    return {cell for question in questions for cell in question.cells}


def _answers(study: Study, scale: Scale, questions: Sequence[Question], scope: Scope) -> Finding:
    """The comparisons, with intervals so wide that all together hold with ``CONFIDENCE``.

    Bonferroni's correction, for the comparisons of the claim and for the looks at them as trials are added.
    """
    parts = {cell.part for cell in _cells(questions)}
    looks = max((scale.effort(part).looks for part in parts), default=1)
    confidence = 1 - (1 - CONFIDENCE) / (len(questions) * looks)
    return Finding([question.answer(study, confidence) for question in questions], scope)
