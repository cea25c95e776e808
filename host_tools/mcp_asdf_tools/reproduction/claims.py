"""The paper's claims, read from ``claims.toml``, and the comparisons that each asks for."""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise, product
from pathlib import Path
from typing import Any

import numpy as np

from mcp_asdf_tools.reproduction.equations import FACTS
from mcp_asdf_tools.reproduction.resampling import (
    BEST_OF_30,
    MEDIAN,
    SPREAD,
    Estimate,
    exactly,
    interval,
    rank_correlation,
)
from mcp_asdf_tools.reproduction.study import (
    FLAWED_ACCURACIES,
    PAPER,
    PART_NAMES,
    PERIODS,
    Cell,
    Part,
    Study,
    cells_of,
    experiment_of,
)
from mcp_asdf_tools.reproduction.verdicts import Comparison, Expectation, Place, Scope

_FILE = tomllib.loads(Path(__file__).with_name("claims.toml").read_text(encoding="utf-8"))

SIZES: Mapping[str, float] = _FILE["sizes"]
"""From which a difference counts, by the paper's words."""
LEVELS: Mapping[str, float] = _FILE["levels"]
"""Levels of a score, by the paper's words."""
QUESTIONS: Mapping[str, str] = _FILE["questions"]
"""Questions of a user, by the claim that answers them."""

_SUMMARIES = {"median": MEDIAN, "spread": SPREAD, "best of 30": BEST_OF_30}
_TRENDS = {"rises": ("not below", "above"), "falls": ("not above", "below")}
"""Expectation from each P to the next, and from the first to the last."""
_STRONG = ("much", "overwhelming")
"""Sizes of which the interval is to be, not only the difference."""
_ROBOTS = "differences between robots"
_CORRELATION = "rank correlation"

Names = str | float | Sequence[Any]
"""One value or several."""

Pair = tuple[Cell, Cell]

Estimating = Callable[[Study, float], Estimate]
"""A number by a study, with an interval of some confidence."""


@dataclass(frozen=True)
class Question:
    """One comparison to be made.

    Attributes:
        place: Which cells are compared, in words.
        expectation: The claimed direction.
        size: From which a difference counts, in the measure's unit.
        cells: Those that answer it, in their normal form.
        estimate: The difference.
        is_strong: True if the interval must be beyond the size.
        measure: What two cells are compared in, or empty.
    """

    place: Place
    expectation: Expectation
    size: float
    cells: tuple[Cell, ...]
    estimate: Estimating
    is_strong: bool = False
    measure: str = ""

    def answer(self, study: Study, confidence: float) -> Comparison:
        """The comparison, from the trials that all cells have."""
        share = study.share_of_better(self.cells, self.measure) if self.measure else None
        estimate = self.estimate(study, confidence)
        return Comparison(self.place, estimate, self.expectation, self.size, self.is_strong, share)


@dataclass(frozen=True)
class Contrast:
    """A row of a claim: comparisons of some cells with others or with a level.

    The head of ``claims.toml`` says what the attributes mean, which are its keys.
    """

    expected: str
    measure: str = "H"
    summary: str = "median"
    than_summary: str = ""
    size: str | float = "seen"
    part: str = ""
    panels: Names = "everywhere"
    b_hats: Names = FLAWED_ACCURACIES
    percents: Names = (10, 30, 50)
    filters: Names = "none"
    periods: Names = PERIODS[0]
    than: str | Mapping[str, Any] = field(default_factory=dict)
    level: str | float = 0.0
    loss_from: int | None = None
    fact: str = ""

    def questions(self, part: Part) -> list[Question]:
        """The comparisons about a part of the study, each once."""
        if self.fact:
            return list(self._facts(part))
        cells = self._cells(Part(self.part) if self.part else part)
        if self.expected in _TRENDS:
            return self._trend(cells)
        if self.than:
            pairs = [(cell, cell.but(**each)) for cell in cells for each in _changes(self.than)]
            return self._compared(self.expected, pairs)
        ask = self._correlation if self.measure == _CORRELATION else self._against_level
        return [ask(cell) for cell in dict.fromkeys(cell.normal for cell in cells)]

    def _cells(self, part: Part) -> list[Cell]:
        named = [_FILE["panels"][name] for name in _listed(self.panels)]
        panels = [panel for own in named for panel in (own[part.value] if isinstance(own, dict) else own)]
        axes = (self.filters, panels, self.b_hats, self.percents, self.periods)
        return [
            Cell(part, f, b, b_hat, percent, name, period)
            for name, (f, b), b_hat, percent, period in product(*map(_listed, axes))
            if b_hat != b
        ]

    def _facts(self, part: Part) -> Iterable[Question]:
        if self.fact == _ROBOTS:
            for letter, name in (("K", "convergence_steps"), ("e", "errors")):
                place = Place("all cells", f"largest {letter} in a trial less the smallest")
                yield self._asked(place, cells_of(part)[:1], _largest_difference(part, name))
        else:
            for row, column, value in FACTS[self.fact]():
                estimate = exactly(round(value, 12))  # without what doubles add
                yield self._asked(Place(row, column), (), lambda *_, estimate=estimate: estimate)

    def _asked(
        self, place: Place, cells: Sequence[Cell], estimate: Estimating, expected: str = ""
    ) -> Question:
        size = SIZES[self.size] if isinstance(self.size, str) else self.size
        is_of_medians = len(cells) == 2 and self.summary == "median" and not self.than_summary
        measure, expectation = self.measure if is_of_medians else "", Expectation(expected or self.expected)
        return Question(place, expectation, size, tuple(cells), estimate, self.size in _STRONG, measure)

    def _trend(self, cells: Sequence[Cell]) -> list[Question]:
        step, whole = _TRENDS[self.expected]
        percents = _listed(self.percents)
        starts = [cell for cell in cells if cell.percent == percents[0]]
        paths = [[cell.but(percent=percent) for percent in percents] for cell in starts]
        steps = [(after, before) for path in paths for before, after in pairwise(path)]
        return [
            *self._compared(step, steps),
            *self._compared(whole, [(path[-1], path[0]) for path in paths]),
        ]

    def _correlation(self, cell: Cell) -> Question:
        def estimate(study: Study, confidence: float) -> Estimate:
            speed, accuracy = (study.sample(cell, measure) for measure in ("h_K", "h_e"))
            return rank_correlation(speed, accuracy, confidence)

        return self._asked(_place([cell], "rank correlation of h_K and h_e"), [cell], estimate)

    def _against_level(self, cell: Cell) -> Question:
        level = LEVELS[self.level] if isinstance(self.level, str) else self.level
        place = _place([cell], f"{self.measure} less {level:g}")
        return self._asked(place, [cell], self._difference([cell], [], level))

    def _compared(self, expected: str, pairs: Iterable[Pair]) -> list[Question]:
        """The first of each pair less the second."""
        distinct = dict.fromkeys((left.normal, right.normal) for left, right in pairs)
        return [self._pair(expected, left, right) for left, right in distinct]

    def _pair(self, expected: str, left: Cell, right: Cell) -> Question:
        words = f"{'spread of ' if self.summary == 'spread' else ''}{self.measure}"
        plus, minus = [left], [right]
        if self.loss_from is not None:
            words = f"loss of {self.measure} from P {self.loss_from} %"
            before, other = (cell.but(percent=self.loss_from).normal for cell in (left, right))
            plus, minus = [before, right], [left, other]
        difference = self._difference(plus, minus)
        return self._asked(_place([left, right], words), [*plus, *minus], difference, expected)

    def _difference(self, plus: Sequence[Cell], minus: Sequence[Cell], level: float = 0.0) -> Estimating:
        """The sum of some cells' values less that of others, or less a level."""
        first, second = _SUMMARIES[self.summary], _SUMMARIES[self.than_summary or self.summary]

        def estimate(study: Study, confidence: float) -> Estimate:
            count = study.count([*plus, *minus])
            ours = [study.summarized(cell, self.measure, first, count) for cell in plus]
            others = [study.summarized(cell, self.measure, second, count) for cell in minus]
            value = sum(one.value for one in ours) - sum(one.value for one in others) - level
            again = np.sum([one.again for one in ours], axis=0) - level
            again -= np.sum([one.again for one in others], axis=0)
            return interval(value, again, confidence)

        return estimate


def _listed(names: Names) -> list[Any]:
    return [names] if isinstance(names, str | float | int) else list(names)


def _changes(than: str | Mapping[str, Any]) -> list[dict[str, Any]]:
    """How the second cells differ: every combination of the values of its keys."""
    given = _FILE["than"][than] if isinstance(than, str) else than
    kinds: dict[str, Callable[[Any], Any]] = {"part": Part}
    values = [[kinds.get(key, lambda value: value)(each) for each in _listed(v)] for key, v in given.items()]
    return [dict(zip(given, each, strict=True)) for each in product(*values)]


def _largest_difference(part: Part, name: str) -> Estimating:
    def estimate(study: Study, _: float) -> Estimate:
        return exactly(max(float(np.ptp(getattr(each, name), axis=1).max()) for each in study.of(part)))

    return estimate


# --- Words -----------------------------------------------------------------------------------------------


def _place(cells: Sequence[Cell], words: str) -> Place:
    """Row: f, b and b_hat of the first cell. Column: what else it is, and how the second differs."""
    first, *others = [_words_of(cell) for cell in cells]
    place = ("fill_ratio", "true_accuracy", "flawed_accuracy")
    row = ", ".join(first[name] for name in place if name in first)
    names = ["percent", "filter", "period"]
    if any(other["part"] != first["part"] for other in others):
        names = ["part", *names]
    column = ", ".join([words, *(first[name] for name in names if name in first)])
    for other in others:
        column += f" less {', '.join(word for name, word in other.items() if first.get(name) != word)}"
    return Place(row, column)


def _words_of(cell: Cell) -> dict[str, str]:
    """Attributes of a cell that mean something in it."""
    words = {
        "part": PART_NAMES[cell.part],
        "fill_ratio": f"f {cell.fill_ratio:g}",
        "true_accuracy": f"b {cell.true_accuracy:g}",
        "flawed_accuracy": f"b_hat {cell.flawed_accuracy:g}",
        "percent": f"P {cell.percent} %",
        "filter": experiment_of(cell, PAPER).filter_name,
        "period": f"tau {cell.period}",
    }
    meaningless = {"flawed_accuracy": cell.percent == 0, "period": cell.filter == "none"}
    return {name: word for name, word in words.items() if not meaningless.get(name)}


# --- Claims ----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Reading:
    """What decides a claim as it stands, or read in another way.

    Attributes:
        words: How it is read; empty as it stands.
        contrasts: What is compared.
        scope: How many comparisons must hold.
    """

    words: str
    contrasts: tuple[Contrast, ...]
    scope: Scope

    def questions(self, part: Part | None) -> list[Question]:
        """The comparisons about a part of the study; the equations need none."""
        about = part or Part.FULLY_CONNECTED
        return [question for contrast in self.contrasts for question in contrast.questions(about)]


@dataclass(frozen=True)
class Claim:
    """A statement of the paper.

    Attributes:
        name: Its key in the file.
        where: Section, and figure or table.
        words: The paper's own.
        compared: What is compared, in ours.
        reading: What decides it.
        readings: Other ways to read it.
        parts: Which experiments it is about; None stands for the equations.
    """

    name: str
    where: str
    words: str
    compared: str
    reading: Reading
    readings: tuple[Reading, ...]
    parts: tuple[Part | None, ...]


def _reading(row: Mapping[str, Any], words: str) -> Reading:
    contrasts = [
        Contrast(**{**each, "measure": measure})
        for each in row["contrasts"]
        for measure in _listed(each.get("measure", Contrast.measure))
    ]
    return Reading(words, tuple(contrasts), Scope(row.get("scope", "all")))


def _claim(name: str, row: Mapping[str, Any]) -> Claim:
    return Claim(
        name,
        row["where"],
        row["words"],
        row["compared"],
        _reading(row, ""),
        tuple(_reading(each, each["words"]) for each in row.get("readings", ())),
        tuple(map(Part, row["parts"])) if "parts" in row else (None,),
    )


CLAIMS = tuple(_claim(name, row) for name, row in _FILE["claims"].items())
"""In the order in which they stand in the paper."""
