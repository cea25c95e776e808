"""The words in which the paper's claims are written down: sets of cells, what is asked of them, sizes."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np

from mcp_asdf_tools.reproduction.resampling import (
    MEDIAN,
    SPREAD,
    Summary,
    exactly,
    interval,
    rank_correlation,
)
from mcp_asdf_tools.reproduction.study import (
    FLAWED_ACCURACIES,
    H_E,
    H_K,
    PART_NAMES,
    Cell,
    H,
    Measure,
    Part,
    Study,
    cells_of,
)
from mcp_asdf_tools.reproduction.verdicts import Comparison, Expectation, Place, Scope
from mcp_asdf_tools.robots import Filtering

FULLY_CONNECTED, DYNAMIC, PHYSICAL = Part
BOTH = (DYNAMIC, FULLY_CONNECTED)
NONE, MINUS, PLUS = Filtering

# --- Sizes: one scale for all claims, in points of a score of 0 to 100 -----------------------------------

SEEN = 2.0
"""From which a difference counts: "better", "worse", "maintains"; less cannot be seen in the paper's
figures."""
SIMILAR = 5.0
"""Up to which scores are "similar", "comparable", "close", "largely the same", "not discernible"."""
MUCH = 10.0
"""From which a difference is "much", "substantial", "significant", "remarkable", "drastic"; up to which it is
"slight", "minor" or "moderate"."""
OVERWHELMING = 20.0

EXCELLENT, QUITE_HIGH, ALMOST_PERFECT, POOR = 90, 80, 95, 50
"""Levels of a score."""

# --- Cells -----------------------------------------------------------------------------------------------

Panel = tuple[float, float]
"""f and b of one plot of the paper's figures."""

OVER_AMBIGUOUS: Panel = (0.55, 0.55)
"""Flawed robots are overconfident, the environment is ambiguous; in the figures' order: top left."""
UNDER_AMBIGUOUS: Panel = (0.55, 0.95)
OVER_CLEAR: Panel = (0.95, 0.55)
UNDER_CLEAR: Panel = (0.95, 0.95)

OVER = (OVER_AMBIGUOUS, OVER_CLEAR)
UNDER = (UNDER_AMBIGUOUS, UNDER_CLEAR)
EVERYWHERE = (*OVER, *UNDER)
HARD = (OVER_CLEAR, *UNDER)
"""Where f = b = 0.55 does not make everything easy."""

PARTLY = (10, 30, 50)
"""P in percent of partially flawed swarms."""
UP_TO_HALF = (0, *PARTLY)

Pair = tuple[Cell, Cell]


def cells(
    part: Part,
    panels: Iterable[Panel] = EVERYWHERE,
    percents: Iterable[int] = PARTLY,
    filter: Filtering = NONE,
    periods: Iterable[int] = (1000,),
) -> list[Cell]:
    """The cells of a part in these panels, with every flawed accuracy that is flawed there."""
    percents, periods = tuple(percents), tuple(periods)
    return [
        Cell(part, f, b, b_hat, percent, filter, period)
        for f, b in panels
        for b_hat in FLAWED_ACCURACIES
        if b_hat != b
        for percent in percents
        for period in periods
    ]


def physical_cells(*filters: Filtering) -> list[Cell]:
    """The cells of the physical experiment with these filters."""
    return [cell for cell in cells_of(PHYSICAL) if cell.filter in filters]


def versus(each: Iterable[Cell], other: Filtering) -> list[Pair]:
    """Each cell and the same with another filter."""
    return [(cell, cell.but(filter=other)) for cell in each]


def versus_flawless(each: Iterable[Cell]) -> list[Pair]:
    """Each cell and a swarm without flawed robots and without filter."""
    return [(cell, cell.but(percent=0, filter=NONE)) for cell in each]


def versus_dynamic(each: Iterable[Cell]) -> list[Pair]:
    """Each cell and the same in the dynamic topology."""
    return [(cell, cell.but(part=DYNAMIC)) for cell in each]


def versus_period(each: Iterable[Cell], period: int) -> list[Pair]:
    """Each cell and the same with another filtering period."""
    return [(cell, cell.but(period=period)) for cell in each]


def versus_percent(each: Iterable[Cell], *percents: int) -> list[Pair]:
    """Each cell and the same with other proportions of flawed robots."""
    return [(cell, cell.but(percent=percent)) for cell in each for percent in percents]


# --- Questions -------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Expected:
    """Expected result of comparisons.

    Attributes:
        expectation: The direction.
        measure: What is compared.
        size: From which a difference counts, in the measure's unit.
        summary: What stands for the trials of the first cell.
        other: What stands for those of the second; None for the same.
    """

    expectation: Expectation
    measure: Measure = H
    size: float = SEEN
    summary: Summary = MEDIAN
    other: Summary | None = None

    def of(self, measure: Measure) -> Expected:
        """The same of another measure."""
        return replace(self, measure=measure)

    def by(self, size: float) -> Expected:
        """The same with another size."""
        return replace(self, size=size)

    def in_spread(self) -> Expected:
        """The same of the interquartile range over the trials."""
        return replace(self, summary=SPREAD)

    def versus(self, summary: Summary) -> Expected:
        """The same with another summary of the second cell."""
        return replace(self, other=summary)


ABOVE, BELOW, SAME, NOT_ABOVE, NOT_BELOW = map(Expected, Expectation)


@dataclass(frozen=True)
class Difference:
    """Question for the sum of some cells' values less that of others, or less a level."""

    expected: Expected
    place: Place
    plus: tuple[Cell, ...]
    minus: tuple[Cell, ...] = ()
    level: float = 0.0

    @property
    def cells(self) -> tuple[Cell, ...]:
        """The cells that answer it."""
        return (*self.plus, *self.minus)

    def answer(self, study: Study, confidence: float) -> Comparison:
        """The comparison, from the trials that all cells have."""
        expected, count = self.expected, study.count(self.cells)
        first, second = expected.summary, expected.other or expected.summary
        plus = [study.summarized(cell, expected.measure, first, count) for cell in self.plus]
        minus = [study.summarized(cell, expected.measure, second, count) for cell in self.minus]
        value = sum(one.value for one in plus) - sum(one.value for one in minus) - self.level
        again = np.sum([one.again for one in plus], axis=0) - self.level
        again -= np.sum([one.again for one in minus], axis=0)
        found = interval(value, again, confidence)
        return Comparison(self.place, found, expected.expectation, expected.size)


WEAK_CORRELATION = 0.2
"""Up to which it counts for nothing."""


@dataclass(frozen=True)
class Correlation:
    """Question for the rank correlation of h_K and h_e over a cell's trials."""

    expectation: Expectation
    cell: Cell

    @property
    def cells(self) -> tuple[Cell, ...]:
        """The cell that answers it."""
        return (self.cell,)

    def answer(self, study: Study, confidence: float) -> Comparison:
        """The comparison."""
        speed, accuracy = (study.sample(self.cell, measure) for measure in (H_K, H_E))
        place = _place([self.cell], ["rank correlation of h_K and h_e"])
        found = rank_correlation(speed, accuracy, confidence)
        return Comparison(place, found, self.expectation, WEAK_CORRELATION)


@dataclass(frozen=True)
class Fact:
    """Question whose answer is not subject to chance."""

    expectation: Expectation
    place: Place
    size: float
    value: Callable[[Study], float]
    cells: tuple[Cell, ...] = field(default=())

    def answer(self, study: Study, confidence: float) -> Comparison:
        """The comparison."""
        return Comparison(self.place, exactly(self.value(study)), self.expectation, self.size)


def fact(expected: Expected, row: str, column: str, value: float) -> Fact:
    """A number that follows from the equations and what is expected of it."""
    rounded = round(value, 12)  # without what doubles add
    return Fact(expected.expectation, Place(row, column), expected.size, lambda study: rounded)


Question = Difference | Correlation | Fact


def compare(expected: Expected, pairs: Iterable[Pair]) -> list[Question]:
    """Of each pair, the first less the second."""
    name = f"{'spread of ' if expected.summary is SPREAD else ''}{expected.measure.name}"
    distinct = dict.fromkeys((left.normal, right.normal) for left, right in pairs)
    return [
        Difference(expected, _place([left, right], [name]), (left,), (right,)) for left, right in distinct
    ]


def against(expected: Expected, each: Iterable[Cell], level: float) -> list[Question]:
    """Of each cell, its value less ``level``."""
    distinct = dict.fromkeys(cell.normal for cell in each)
    name = f"{expected.measure.name} less {level:g}"
    return [Difference(expected, _place([cell], [name]), (cell,), level=level) for cell in distinct]


def rises(each: Sequence[Cell], percents: Sequence[int], measure: Measure = H) -> list[Question]:
    """That each cell's value grows with P: nowhere falls, and ends above where it began."""
    return _follows(_paths(each, percents), NOT_BELOW.of(measure), ABOVE.of(measure))


def falls(each: Sequence[Cell], percents: Sequence[int], measure: Measure = H) -> list[Question]:
    """That each cell's value falls with P: nowhere grows, and ends below where it began."""
    return _follows(_paths(each, percents), NOT_ABOVE.of(measure), BELOW.of(measure))


def _paths(each: Sequence[Cell], percents: Sequence[int]) -> list[list[Cell]]:
    return [[cell.but(percent=percent) for percent in percents] for cell in each]


def _follows(paths: list[list[Cell]], step: Expected, whole: Expected) -> list[Question]:
    steps = [(after, before) for path in paths for before, after in pairwise(path)]
    return [*compare(step, steps), *compare(whole, [(path[-1], path[0]) for path in paths])]


# --- Words -----------------------------------------------------------------------------------------------

FILTER_NAMES = {NONE: "no filter", MINUS: "ASDF-", PLUS: "ASDF+"}


def _place(each: Sequence[Cell], words: Sequence[str]) -> Place:
    """Row: f, b and b_hat of the first cell. Column: what else it is, and how the second differs."""
    first, *others = [_words(cell) for cell in each]
    row = ", ".join(
        first[name] for name in ("fill_ratio", "true_accuracy", "flawed_accuracy") if name in first
    )
    rest = [first[name] for name in ("part", "percent", "filter", "period") if name in first]
    column = ", ".join([*words, *rest[1:]])
    for other in others:
        if other["part"] != first["part"]:
            column = ", ".join([*words, *rest])
        less = [word for name, word in other.items() if first.get(name) != word]
        column += f" less {', '.join(less)}"
    return Place(row, column)


def _words(cell: Cell) -> dict[str, str]:
    """Attributes of a cell."""
    words = {
        "part": PART_NAMES[cell.part],
        "fill_ratio": f"f {cell.fill_ratio:g}",
        "true_accuracy": f"b {cell.true_accuracy:g}",
        "flawed_accuracy": f"b_hat {cell.flawed_accuracy:g}",
        "percent": f"P {cell.percent} %",
        "filter": FILTER_NAMES[cell.filter],
        "period": f"tau {cell.period}",
    }
    meaningless = {"flawed_accuracy": cell.percent == 0, "period": cell.filter is NONE}
    return {name: word for name, word in words.items() if not meaningless.get(name)}


# --- Claims ----------------------------------------------------------------------------------------------

Ask = Callable[[Part], Sequence[Question]]
"""The questions that decide a claim about a part."""


@dataclass(frozen=True)
class Reading:
    """Another way to read a claim."""

    words: str
    ask: Ask
    scope: Scope = Scope.ALL


@dataclass(frozen=True)
class Claim:
    """A statement of the paper.

    Attributes:
        name: Of it.
        where: Section, and figure or table.
        words: The paper's own.
        compared: What is compared, in ours.
        ask: The questions that decide it.
        parts: About which experiments; none where the equations decide.
        scope: How many comparisons must hold, by its words.
        readings: Other ways to read it.
    """

    name: str
    where: str
    words: str
    compared: str
    ask: Ask
    parts: tuple[Part, ...] = ()
    scope: Scope = Scope.ALL
    readings: tuple[Reading, ...] = ()
