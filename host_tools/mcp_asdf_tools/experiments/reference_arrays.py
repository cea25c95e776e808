"""The reference firmware in whole arrays, for studies that ``ReferenceRobot`` is too slow for: 150 times.

Between two filter steps no b_hat changes, so every local estimate is a function of counts that are known in
advance. x_hat, alpha, b_hat and all decisions are those of ``mcp_asdf.reference.ReferenceRobot`` to the
bit, since its functions decide; x is formed from sums that are rounded in another order, which shows in the
last few bits.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mcp_asdf.reference import (
    AUTHORS,
    PAPER,
    UNINFORMATIVE,
    Conventions,
    Message,
    assumed_accuracy_update,
    rejects,
    social_estimate,
)
from mcp_asdf.robot import Filter
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.world.world import Scene, World

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

_MOST_STEPS = 1 << 11
"""At once, which bounds the memory."""


class _Said(NamedTuple):
    """Messages of robots in some steps, shape (steps, N)."""

    x_hat: Floats
    alpha: Floats


def conventions_of(experiment: Experiment) -> Conventions:
    """The reading of the equations that an experiment asks for."""
    return AUTHORS if experiment.conventions == "authors" else PAPER


def can_run(experiment: Experiment) -> bool:
    """True if ``run`` can do all that an experiment asks for: broadcasts in every step, and no forgetting."""
    is_plain = experiment.comms_period == 1 and experiment.memory > experiment.steps
    return experiment.firmware == "reference" and is_plain


def run(experiment: Experiment, trial: int) -> tuple[Floats, Floats, Integers, Integers]:
    """One trial that ``can_run`` allows: x of each robot in steps 0 .. T, shape (N, T + 1); b_hat after each
    filter step, shape (T // filter_period, N); tests and updates of each robot, shape (N,).

    Raises UsageError as ``World``. O(steps N^2).
    """
    world, swarm = World(experiment, trial), _Swarm(experiment)
    x, b_hat = np.full((experiment.robots, experiment.steps + 1), 0.5), []
    step, period = 0, experiment.filter_period
    while step < experiment.steps:
        stop = min(experiment.steps, step + _MOST_STEPS, (step // period + 1) * period)
        x[:, step + 1 : stop + 1] = swarm.advance(world.advance(stop - step)).T
        if stop % period == 0:
            swarm.filter()
            b_hat.append(swarm.b_hat.copy())
        step = stop
    return x, np.reshape(b_hat, (-1, experiment.robots)), swarm.tests, swarm.updates


class _Swarm:
    """All robots of a trial."""

    def __init__(self, experiment: Experiment) -> None:
        count = experiment.robots
        self.b_hat = np.array([experiment.b_hat(robot) for robot in range(count)])
        self.tests, self.updates = np.zeros(count, np.int64), np.zeros(count, np.int64)
        self._filters = [experiment.config(robot).filter for robot in range(count)]
        self._omega, self._late = float(experiment.omega), experiment.latency > 0
        self._conventions = conventions_of(experiment)
        self._t, self._n = 0, np.zeros(count, np.int64)
        self._said = _Said(np.full((1, count), 0.5), np.zeros((1, count)))
        self._rounds: list[list[Message]] = []

    def advance(self, scene: Scene) -> Floats:
        """x of each robot in some steps without a filter step, but for the last; shape (steps, N)."""
        t = self._t + np.cumsum(scene.observes)
        n = self._n + np.cumsum(scene.black & scene.observes[:, np.newaxis], axis=0)
        own = _estimates(t[:, np.newaxis], n, self.b_hat, self._conventions)
        before = int(scene.observes.argmax()) if scene.observes.any() else len(own.x_hat)
        for values, last in zip(own, self._said, strict=True):
            values[:before] = last  # until a robot observes again its values stay
        past = _Said(*(np.vstack([last, values[:-1]]) for last, values in zip(self._said, own, strict=True)))
        spoken = past if self._late else own
        self._t, self._n = int(t[-1]), n[-1]
        self._said = _Said(own.x_hat[-1:], own.alpha[-1:])
        self._rounds = _rounds(spoken, scene.hears[-1])
        return _informed(own, spoken, scene.hears)

    def filter(self) -> None:
        """Re-estimate b_hat of the robots whose time it is, in the last step that was taken."""
        for robot, messages in enumerate(self._rounds):
            if not self._is_activated(robot, messages):
                continue
            n, x_bar = int(self._n[robot]), social_estimate(messages)
            b_hat = assumed_accuracy_update(n, self._t, x_bar, self._conventions)
            if b_hat is not None:
                self.b_hat[robot] = b_hat
                self.updates[robot] += 1

    def _is_activated(self, robot: int, messages: list[Message]) -> bool:
        if self._filters[robot] == Filter.OFF or self._t == 0:
            return False
        if self._filters[robot] == Filter.ALWAYS:
            return bool(messages)
        self.tests[robot] += len(messages) >= 2
        neighbours = [message.x_hat for message in messages]
        return rejects(float(self._said.x_hat[0, robot]), neighbours, self._omega, self._conventions)


def _estimates(t: Integers, n: Integers, b_hat: Floats, conventions: Conventions) -> _Said:
    """``local_estimate`` and ``local_confidence`` of each element, with the same operations."""
    squares = [np.array([value**2 for value in values]) for values in (2 * b_hat - 1, 1 - b_hat, b_hat)]
    d, wrong, right = squares
    with np.errstate(divide="ignore", invalid="ignore"):
        x_hat = np.clip((n / t + b_hat - 1) / (2 * b_hat - 1), 0.0, 1.0)
        x_hat[np.isnan(x_hat)] = 0.5  # 0 / 0
        at_0 = d * (n / wrong + (t - n) / right)
        at_1 = d * ((t - n) / wrong + n / right)
        inside = d * t**3 / (n * (t - n))
    alpha = np.select([x_hat == 0, x_hat == 1], [at_0, at_1], inside)
    alpha[alpha == 0] = conventions.zero_confidence
    if conventions.guarded:
        silent = np.abs(2 * b_hat - 1) < UNINFORMATIVE
        x_hat[:, silent], alpha[:, silent] = 0.5, conventions.zero_confidence
    alpha[t[:, 0] == 0] = 0.0
    return _Said(x_hat, alpha)


def _informed(own: _Said, spoken: _Said, hears: NDArray[np.bool_]) -> Floats:
    """x (eq. 7) of each robot in each step."""
    terms = np.stack([spoken.alpha, spoken.alpha * spoken.x_hat], axis=2)
    social = hears.astype(np.float64) @ terms
    weight = own.alpha + social[..., 0]
    weighted = own.alpha * own.x_hat + social[..., 1]
    return np.divide(weighted, weight, out=own.x_hat.copy(), where=weight > 0)


def _rounds(spoken: _Said, hears: NDArray[np.bool_]) -> list[list[Message]]:
    """The messages that each robot hears in the last of some steps, without those that have no weight."""
    said = [
        Message(float(x_hat), float(alpha)) for x_hat, alpha in zip(*(v[-1] for v in spoken), strict=True)
    ]
    return [[said[j] for j in np.flatnonzero(row) if said[j].alpha > 0] for row in hears]
