"""The words in which the paper's claims are written down: sets of cells, comparisons, the list of claims."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from typing import Any, Protocol

import numpy as np

from mcp_asdf_tools.reproduction.study import (
    FLAWED_ACCURACIES,
    PART_NAMES,
    Cell,
    H,
    Measure,
    Part,
    Study,
    cells_of,
)
from mcp_asdf_tools.reproduction.verdicts import MARGIN, Comparison, Expectation, Finding, Summary, estimate
from mcp_asdf_tools.robots import Filtering

FULLY_CONNECTED, DYNAMIC, PHYSICAL = Part
BOTH = (DYNAMIC, FULLY_CONNECTED)
NONE, MINUS, PLUS = Filtering

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

Pair = tuple[Cell, Cell]


# --- Claims ----------------------------------------------------------------------------------------------


class Decide(Protocol):
    """Decides a claim about ``part``."""

    __name__: str

    def __call__(self, study: Study, part: Part) -> Finding:
        """Outcome."""


@dataclass(frozen=True)
class Claim:
    """A statement of the paper about one part of its study.

    Attributes:
        name: Of the function that decides it.
        section: Of the paper.
        text: What it says.
        part: About which experiments; None where the equations alone decide.
        needs: The parts whose results decide it.
        decide: Decides it, given results of these parts.
    """

    name: str
    section: str
    text: str
    part: Part | None
    needs: frozenset[Part]
    decide: Callable[[Study], Finding]


CLAIMS: list[Claim] = []
"""In the order in which they stand in the paper."""


def claim(section: str, *parts: Part, beside: Sequence[Part] = ()) -> Callable[[Decide], Decide]:
    """Enter a function into CLAIMS for each of ``parts``; its docstring is the claim."""

    def enter(decide: Decide) -> Decide:
        for part in parts:
            needs = frozenset({part, *beside})
            about = partial(decide, part=part)
            CLAIMS.append(Claim(decide.__name__, section, _text_of(decide), part, needs, about))
        return decide

    return enter


def equation(section: str) -> Callable[[Callable[[], Finding]], Callable[[], Finding]]:
    """Enter a function into CLAIMS that needs no results."""

    def enter(decide: Callable[[], Finding]) -> Callable[[], Finding]:
        name, text = decide.__name__, _text_of(decide)
        CLAIMS.append(Claim(name, section, text, None, frozenset(), lambda study: decide()))
        return decide

    return enter


def _text_of(decide: Callable[..., Finding]) -> str:
    return " ".join((decide.__doc__ or "").split())


# --- Cells -----------------------------------------------------------------------------------------------


def cells(
    part: Part,
    panels: Iterable[Panel] = EVERYWHERE,
    percents: Iterable[int] = PARTLY,
    mode: Filtering = NONE,
    periods: Iterable[int] = (1000,),
) -> list[Cell]:
    """The cells of a part in these panels, with every flawed accuracy that is flawed there."""
    percents, periods = tuple(percents), tuple(periods)
    return [
        Cell(part, f, b, b_hat, percent, mode, period)
        for f, b in panels
        for b_hat in FLAWED_ACCURACIES
        if b_hat != b
        for percent in percents
        for period in periods
    ]


def physical_cells(mode: Filtering = NONE) -> list[Cell]:
    """The cells of the physical experiment with this filter."""
    return [cell for cell in cells_of(PHYSICAL) if cell.mode is mode]


# --- Comparisons -----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Expected:
    """Expected result of comparisons.

    Attributes:
        expectation: The direction.
        measure: What is compared.
        margin: Size from which a difference counts, in the measure's unit.
        summary: What stands for a cell's trials.
    """

    expectation: Expectation
    measure: Measure = H
    margin: float = MARGIN
    summary: Summary = np.median

    def of(self, measure: Measure) -> Expected:
        """The same of another measure."""
        return replace(self, measure=measure)

    def by(self, margin: float) -> Expected:
        """The same with another margin."""
        return replace(self, margin=margin)

    def in_spread(self, margin: float) -> Expected:
        """The same of the interquartile range over the trials."""
        return replace(self, summary=spread, margin=margin)


ABOVE, BELOW, SAME, NOT_ABOVE, NOT_BELOW = map(Expected, Expectation)


def spread(values: Any, axis: int = -1) -> Any:
    """The interquartile range along an axis."""
    upper, lower = np.percentile(values, [75, 25], axis=axis)
    return upper - lower


def compare(study: Study, expected: Expected, pairs: Iterable[Pair]) -> list[Comparison]:
    """Of each pair, the first less the second."""
    name = f"{'spread of ' if expected.summary is spread else ''}{expected.measure.name}"
    comparisons = []
    for left, right in dict.fromkeys((left.normal, right.normal) for left, right in pairs):
        samples = [[study.sample(cell, expected.measure)] for cell in (left, right)]
        difference = estimate(samples[0], samples[1], expected.summary)
        label = f"{name}, {_difference(left, right)}"
        comparisons.append(Comparison(label, difference, expected.expectation, expected.margin))
    return comparisons


def against(study: Study, expected: Expected, each: Iterable[Cell], level: float) -> list[Comparison]:
    """Of each cell, its value less ``level``."""
    comparisons = []
    for cell in dict.fromkeys(cell.normal for cell in each):
        sample = study.sample(cell, expected.measure)
        difference = estimate([sample], [np.full_like(sample, level)], expected.summary)
        label = f"{expected.measure.name}, {words_of(cell)}: less {level:.4g}"
        comparisons.append(Comparison(label, difference, expected.expectation, expected.margin))
    return comparisons


def versus(each: Iterable[Cell], mode: Filtering) -> list[Pair]:
    """Each cell and the same with another filter."""
    return [(cell, cell.but(mode=mode)) for cell in each]


def versus_flawless(each: Iterable[Cell]) -> list[Pair]:
    """Each cell and a swarm without flawed robots and without filter."""
    return [(cell, cell.but(percent=0, mode=NONE)) for cell in each]


def versus_dynamic(each: Iterable[Cell]) -> list[Pair]:
    """Each cell and the same in the dynamic topology."""
    return [(cell, cell.but(part=DYNAMIC)) for cell in each]


def rises(
    study: Study, each: Sequence[Cell], percents: Sequence[int], measure: Measure = H
) -> list[Comparison]:
    """That each cell's value grows with P: nowhere falls, and ends above where it began."""
    return _follows(study, _paths(each, percents), NOT_BELOW.of(measure), ABOVE.of(measure))


def falls(
    study: Study, each: Sequence[Cell], percents: Sequence[int], measure: Measure = H
) -> list[Comparison]:
    """That each cell's value falls with P: nowhere grows, and ends below where it began."""
    return _follows(study, _paths(each, percents), NOT_ABOVE.of(measure), BELOW.of(measure))


def _paths(each: Sequence[Cell], percents: Sequence[int]) -> list[list[Cell]]:
    return [[cell.but(percent=percent) for percent in percents] for cell in each]


def _follows(study: Study, paths: list[list[Cell]], step: Expected, whole: Expected) -> list[Comparison]:
    steps = [(after, before) for path in paths for before, after in pairwise(path)]
    return [*compare(study, step, steps), *compare(study, whole, [(path[-1], path[0]) for path in paths])]


# --- Words -----------------------------------------------------------------------------------------------


MODE_NAMES = {NONE: "no filter", MINUS: "ASDF-", PLUS: "ASDF+"}


def words_of(cell: Cell) -> str:
    """A cell in words, but for its part."""
    return ", ".join(word for name, word in _words(cell).items() if name != "part")


def _words(cell: Cell) -> dict[str, str]:
    """Attributes of a cell."""
    words = {
        "part": PART_NAMES[cell.part],
        "fill_ratio": f"f {cell.fill_ratio:g}",
        "true_accuracy": f"b {cell.true_accuracy:g}",
        "flawed_accuracy": f"b_hat {cell.flawed_accuracy:g}",
        "percent": f"P {cell.percent} %",
        "mode": MODE_NAMES[cell.mode],
        "period": f"tau {cell.period}",
    }
    meaningless = {"flawed_accuracy": cell.percent == 0, "period": cell.mode is NONE}
    return {name: word for name, word in words.items() if not meaningless.get(name)}


def _difference(left: Cell, right: Cell) -> str:
    """Attributes that two cells share, and those in which they differ."""
    one, other = _words(left), _words(right)
    common = {name for name, word in one.items() if other.get(name) == word}
    shared = [word for name, word in one.items() if name in common - {"part"}]
    own = [[word for name, word in words.items() if name not in common] for words in (one, other)]
    return f"{', '.join(shared)}: {', '.join(own[0])} less {', '.join(own[1])}"
