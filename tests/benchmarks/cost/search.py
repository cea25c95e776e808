"""Looking for the dearest calls: situations are changed, and what does not make a call cheaper is kept."""

from __future__ import annotations

import random
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

from . import runs
from .machines import Cost
from .robots import NEVER, UNITS, Robot

_FIRST = 10
"""Situations of which the dearest is a start."""
_KICK = 2
"""Most changes at once that lead away from a summit."""

_TWICE = 0.3
"""Share of steps with two changes at once."""


@dataclass(frozen=True)
class Goal:
    """A call that is to be expensive.

    Attributes:
        call: What it costs in a situation.
        messages: How many a round may have.
        again: Looks at what was found in other ways, for the calls that make it up.
    """

    call: Callable[[runs.Situation], Cost]
    messages: tuple[int, ...]
    again: Callable[[runs.Situation], None] = lambda _: None


def seek(robot: Robot, starts: int, patience: int, rng: random.Random) -> None:
    """Look for the dearest step, with the filter due or not, test and update, and x; the robot notes them.

    For each of them, and each unit, there are ``starts`` climbs. A climb ends when ``patience`` changes in
    succession have brought nothing.
    """
    search = _Search(rng, patience, list(runs.DEAR))
    for goal in _goals(robot):
        for unit in UNITS:
            for found in search.summits(goal, unit, starts):
                goal.again(found)


def _goals(robot: Robot) -> Iterator[Goal]:
    def quiet(situation: runs.Situation) -> None:
        for messages in runs.NEIGHBOURS:
            robot.step_in(replace(situation, messages=runs.usual_round(messages)), NEVER)
        robot.tick_in(situation, NEVER)

    yield Goal(lambda situation: robot.step_in(situation, NEVER), (0, 1), quiet)
    yield Goal(lambda situation: robot.step_in(situation, 1), (0, 1))
    yield Goal(lambda situation: robot.step_in(situation, 1), (2, 3), lambda found: robot.tick_in(found, 1))
    yield Goal(robot.x_in, (0, 1, 2, 3))


class _Search:
    """Climbs, of which every other one starts anywhere, the rest near situations known to be expensive."""

    def __init__(self, rng: random.Random, patience: int, dear: list[runs.Situation]) -> None:
        self._rng, self._patience, self._dear = rng, patience, dear

    def summits(self, goal: Goal, unit: str, starts: int) -> Iterator[runs.Situation]:
        """Ends of climbs; the highest is then known to be expensive."""
        near, most = list(self._dear), -1
        for number in range(starts):
            count = self._rng.choice(goal.messages)
            firsts = [self._first(count, near if number % 2 else []) for _ in range(_FIRST)]
            found, height = self._climb(firsts, lambda one: int(getattr(goal.call(one), unit)))
            near.append(found)
            if height > most:
                most, highest = height, found
            yield found
        self._dear.append(highest)

    def _first(self, messages: int, near: list[runs.Situation]) -> runs.Situation:
        """Any situation with that many messages, or a few changes away from one of these."""
        new = runs.situation(self._rng, messages)
        if not near:
            return new
        old = self._rng.choice(near)
        changed = old if len(old.messages) == messages else replace(old, messages=new.messages)
        for _ in range(self._rng.randint(0, _KICK)):
            changed = runs.mutated(self._rng, changed)
        return changed

    def _climb(
        self, firsts: list[runs.Situation], cost: Callable[[runs.Situation], int]
    ) -> tuple[runs.Situation, int]:
        """From the dearest of the first situations up; where it ends, and what that costs."""
        worst = max(firsts, key=cost)
        most, vain = cost(worst), 0
        while vain < self._patience:
            changed = runs.mutated(self._rng, worst)
            if self._rng.random() < _TWICE:
                changed = runs.mutated(self._rng, changed)
            value = cost(changed)
            vain = 0 if value > most else vain + 1
            if value >= most:
                worst, most = changed, value
        return worst, most
