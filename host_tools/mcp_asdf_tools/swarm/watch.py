"""The course of a run in figures: mean errors with and without the filter, and recalibrations."""

from __future__ import annotations

from collections.abc import Iterator
from statistics import fmean
from typing import NamedTuple

from mcp_asdf_tools.swarm.swarm import Companion, Swarm

_MOST_ERRORS = 400
"""About as many as a terminal can show."""
_NOTABLE = 0.002
"""Change of b_hat below which nothing is said: a robot that is right and tests again."""


class Recalibration(NamedTuple):
    """Change of a robot's b_hat.

    Attributes:
        tick: Ticks done when it was seen.
        robot: Id.
        before: b_hat until then.
        after: b_hat from then on.
    """

    tick: int
    robot: int
    before: float
    after: float


class Watch:
    """Hook that notes the course of a run.

    Attributes:
        errors: Mean |x - f| over the robots, every few ticks.
        errors_without: The same of the swarm without the filter, if one is run along.
        recalibrations: In order.
    """

    def __init__(self, companion: Companion | None = None) -> None:
        self.errors: list[float] = []
        self.errors_without: list[float] = []
        self.recalibrations: list[Recalibration] = []
        self._companion = companion
        self._b_hat: list[float] = []

    def __call__(self, swarm: Swarm) -> None:
        """Note the present state. O(robots), in most ticks O(1)."""
        settings = swarm.settings
        is_due = swarm.ticks % -(-settings.steps // _MOST_ERRORS) == 0
        # Robots that never crash test together, so that nothing is to be seen in between.
        if is_due or settings.faults or swarm.ticks % settings.filter_period == 0:
            self.recalibrations += self._changes(swarm)
        if is_due:
            self.errors.append(mean_error(swarm))
            if self._companion is not None:
                self.errors_without.append(mean_error(self._companion.swarm))

    def _changes(self, swarm: Swarm) -> Iterator[Recalibration]:
        now = [node.robot.b_hat for node in swarm.nodes]
        before = self._b_hat or [swarm.settings.b_hat(node.id) for node in swarm.nodes]
        self._b_hat = now
        if now != before:
            for robot, (old, new) in enumerate(zip(before, now, strict=True)):
                if abs(new - old) > _NOTABLE:
                    yield Recalibration(swarm.ticks, robot, old, new)


def mean_error(swarm: Swarm) -> float:
    """Mean |x - f| over the robots at present."""
    return fmean(abs(node.robot.x - swarm.settings.fill_ratio) for node in swarm.nodes)
