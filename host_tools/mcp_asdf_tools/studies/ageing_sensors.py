"""Sensors whose accuracy changes in other ways than the built-in sensors', and the rates of all changes.

Each starts at ``true_accuracy`` and stays within ``lowest_accuracy`` and 1. docs/platforms/extending.md
describes how to write such sensors.
"""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri  # type: ignore[import-untyped]

from mcp_asdf_tools.world.philox import SENSOR_STREAM, Stream
from mcp_asdf_tools.world.sensors import Accuracies
from mcp_asdf_tools.world.settings import WorldSettings

DRIFT_RATE = -1e-5
"""Change of the accuracy in one step where all built-in sensors age alike."""

STEPS_BEFORE_LOSS = 20_000
LOSS_AT_ONCE = 0.2

MEAN_RATE = -5e-6
RATE_DEVIATION = 5e-6
"""Mean and standard deviation, over the robots, of an accuracy's change in one step."""

DIFFUSION = 0.001
"""Standard deviation of a wandering accuracy's change in one step."""


class AgeingSensors(ABC):
    """A sensor model whose accuracies, the same on black and on white, a subclass computes."""

    has_one_accuracy = True

    def __init__(self, settings: WorldSettings, trial: int) -> None:
        """Start before the first step of a trial."""
        self._settings = settings
        self._draws = Stream(SENSOR_STREAM, settings.seed, trial, settings.robots)
        self._next_step = 0

    def advance(self, steps: int) -> Accuracies:
        """Return the accuracies in the next steps, which are the same on black and on white tiles.

        They are limited to the range from ``lowest_accuracy`` to 1. As changes count from the start, a limit
        that was reached does not shift later accuracies.
        """
        unlimited = self._settings.true_accuracy + self._changes(steps)
        self._next_step += steps
        accuracies = np.clip(unlimited, self._settings.lowest_accuracy, 1.0)
        return accuracies, accuracies

    @abstractmethod
    def _changes(self, steps: int) -> NDArray[np.float64]:
        """Return the changes of the accuracies since the start, in the next steps, shape (steps, 1 or N)."""

    def _step_numbers(self, steps: int) -> NDArray[np.float64]:
        """Return the numbers of the next steps, counted from 0, shape (steps, 1)."""
        step_numbers = np.arange(self._next_step, self._next_step + steps, dtype=np.float64)
        return step_numbers[:, np.newaxis]

    def _normal_draws(self, steps: int, first_step: int) -> NDArray[np.float64]:
        """Return normally distributed numbers of mean 0 and deviation 1 for the steps from ``first_step`` on.

        Their shape is (steps, N). Calls for the same steps return the same numbers.
        """
        uniforms = self._draws.draw_uniforms(steps, first_step)
        # The inverse of the normal distribution function turns uniform numbers into normal ones.
        draws: NDArray[np.float64] = ndtri(uniforms)
        return draws


class SuddenlyWorseSensors(AgeingSensors):
    """Sensors that all lose accuracy at once, in the middle of the study's runs."""

    def _changes(self, steps: int) -> NDArray[np.float64]:
        """Return no change before the loss, and the whole loss after it, for all robots alike."""
        is_before_loss = self._step_numbers(steps) < STEPS_BEFORE_LOSS
        return np.where(is_before_loss, 0.0, -LOSS_AT_ONCE)


class UnequallyAgeingSensors(AgeingSensors):
    """Sensors that age at rates of their own around a common mean."""

    def _changes(self, steps: int) -> NDArray[np.float64]:
        """Return each robot's rate, times the steps so far.

        The rates follow from the same draws, those of step 0, whenever this is called: a robot keeps its
        rate.
        """
        rates = MEAN_RATE + RATE_DEVIATION * self._normal_draws(1, first_step=0)  # shape (1, N)
        return rates * self._step_numbers(steps)


class WanderingSensors(AgeingSensors):
    """Sensors whose accuracies change at random, each in its own way: a Wiener process of every robot."""

    def __init__(self, settings: WorldSettings, trial: int) -> None:
        """Start at the true accuracy."""
        super().__init__(settings, trial)
        self._last_sums = np.zeros(settings.robots)

    def _changes(self, steps: int) -> NDArray[np.float64]:
        """Return the sums of all random changes so far, for the next steps, shape (steps, N).

        A change has the standard deviation DIFFUSION.
        """
        normal_draws = self._normal_draws(steps, self._next_step)
        if self._next_step == 0:
            normal_draws[0] = 0.0  # the first step has the true accuracy
        # The first row continues the sums of the steps before: the result does not depend on how many steps
        # are taken at once.
        normal_draws[0] += self._last_sums
        sums: NDArray[np.float64] = np.cumsum(normal_draws, axis=0)
        self._last_sums = sums[-1]
        return DIFFUSION * sums
