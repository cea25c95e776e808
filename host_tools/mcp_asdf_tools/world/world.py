"""The world of a trial, for firmware in Python: observations, and which robots hear each other."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.world.philox import CERTAIN, OBSERVATIONS, words
from mcp_asdf_tools.world.sensors import black_probabilities


@dataclass(frozen=True, eq=False)
class Scene:
    """Some steps in a row.

    Attributes:
        black: Whether a sensor sees black, shape (steps, N).
        observes: Whether robots observe in a step, shape (steps,).
        hears: Whether robot i and robot j hear each other, shape (steps, N, N).
    """

    black: NDArray[np.bool_]
    observes: NDArray[np.bool_]
    hears: NDArray[np.bool_]


class TrialWorld:
    """The world of one trial, step by step the same as in the C engine."""

    def __init__(self, experiment: Experiment, trial: int) -> None:
        """Stand before the first step. Raises UsageError if the experiment's arena cannot be. O(steps N)."""
        self._experiment, self._step = experiment, 0
        shape = (experiment.steps, experiment.robots)
        self._draws = words(experiment.seed, trial, shape[1], shape[0], OBSERVATIONS) >> np.uint32(1)
        self._limits = np.broadcast_to(black_probabilities(experiment, trial), shape)
        self._arena = None
        if experiment.is_dynamic:
            # Imported here, so that robots that do not move run where no arena has been built.
            from mcp_asdf_tools.world.arenas import make_arena  # noqa: PLC0415

            self._arena = make_arena(experiment, trial)

    def advance(self, steps: int) -> Scene:
        """The next ``steps`` steps; there must be as many. O(steps N^2)."""
        robots = self._experiment.robots
        part = slice(self._step, self._step + steps)
        limits = self._limits[part]
        hears = np.broadcast_to(~np.eye(robots, dtype=np.bool_), (steps, robots, robots))
        if self._arena is not None:
            motion = self._arena.record(steps)
            limits = np.where(motion.black, limits, CERTAIN - limits)
            hears = motion.adjacency
        numbers = np.arange(part.start, part.stop) + 1
        self._step = part.stop
        observes = numbers % self._experiment.observation_period == 0
        return Scene(self._draws[part] < limits, observes, hears)
