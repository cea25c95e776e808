"""Sensors: the probability that each robot names a tile's colour correctly, step by step."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol, cast

import numpy as np
from numpy.typing import NDArray

from mcp_asdf_tools.common import extensions
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.world.philox import PROBABILITY_ONE
from mcp_asdf_tools.world.settings import WorldSettings

Accuracies = tuple[NDArray[np.float64], NDArray[np.float64]]
"""True accuracies on black and on white tiles, each of shape (steps or 1, robots or 1): an axis of length 1
means that values do not change along it."""


class SensorModel(Protocol):
    """True accuracies over time; an extension in the entry point group ``mcp_asdf.sensors`` makes one.

    An extension that has an attribute ``has_one_accuracy``, true, promises that accuracies are always the
    same on black and on white tiles: trials of moving robots then run in C.
    """

    def advance(self, steps: int) -> Accuracies:
        """Let ``steps`` steps pass, and return the true accuracies in them, 0 .. 1, on black and on white."""


_SensorMaker = Callable[[WorldSettings, int], SensorModel]
"""An extension's entry point, called with the settings and the number of the trial."""


class DriftingSensors:
    """The built-in sensor model: b as ``settings.drift`` changes it, and ``white_offset`` more on white.

    b is the true accuracy, the probability that a sensor names a black tile's colour correctly.
    """

    def __init__(self, settings: WorldSettings, trial: int) -> None:
        """Start before the first step. The trial makes no difference, as in the model nothing is random."""
        self._settings = settings
        self._next_step = 0

    def advance(self, steps: int) -> Accuracies:
        """Let ``steps`` steps pass, and return the accuracies in them on black and on white tiles.

        O(steps), or O(steps robots) where only some robots' sensors drift.
        """
        accuracies_on_black = self._accuracies_on_black(steps)
        self._next_step += steps
        # The lowest accuracy limits a drift on black tiles; on white the offset may lead below it, down to 0.
        offset = self._settings.white_offset
        if offset == 0:
            return accuracies_on_black, accuracies_on_black
        return accuracies_on_black, np.clip(accuracies_on_black + offset, 0.0, 1.0)

    def _accuracies_on_black(self, steps: int) -> NDArray[np.float64]:
        """Return the accuracies on black tiles in the next steps.

        The shape is (1, 1) without a drift, (steps, 1) if all sensors drift, and else (steps, robots).
        """
        settings = self._settings
        if settings.drift == "none":
            return np.full((1, 1), settings.true_accuracy)
        # A column, shape (steps, 1): all drifting sensors have the same accuracy in a step.
        end_step = self._next_step + steps
        step_numbers = np.arange(self._next_step, end_step, dtype=np.float64)[:, np.newaxis]
        # Step 0 has the true accuracy: the drift starts there.
        drifted_accuracies = settings.true_accuracy + settings.drift_rate * step_numbers
        drifted_accuracies = np.clip(drifted_accuracies, settings.lowest_accuracy, 1.0)
        if settings.drifting == settings.robots:
            return drifted_accuracies
        # The robots with the lowest ids drift, and the others keep the accuracy of step 0.
        is_drifting = np.arange(settings.robots) < settings.drifting
        return np.where(is_drifting, drifted_accuracies, settings.true_accuracy)


class CheckedSensors:
    """The sensor model of an extension, whose answers are checked."""

    def __init__(self, model: SensorModel, settings: WorldSettings, has_one_accuracy: bool = False) -> None:
        """Take the model of an extension for robots with these settings.

        ``has_one_accuracy`` is the promise that ``SensorModel`` describes, if the extension makes it.
        """
        self._model = model
        self._settings = settings
        self._has_one_accuracy = has_one_accuracy

    def advance(self, steps: int) -> Accuracies:
        """Let ``steps`` steps pass, and return the model's accuracies in them. O(steps robots).

        Raises UsageError unless they have the shapes of ``Accuracies`` and are 0 to 1, and are the same on
        black and white if the extension promises so.
        """
        unchecked_on_black, unchecked_on_white = self._model.advance(steps)
        on_black = self._check_accuracies(unchecked_on_black, steps)
        on_white = self._check_accuracies(unchecked_on_white, steps)
        # The engine in C has one accuracy for both colours, and would use the wrong one for white in silence.
        if self._has_one_accuracy and not np.array_equal(on_black, on_white):
            raise UsageError(
                f"sensor {self._settings.sensor} gives accuracies on white tiles that differ from those on "
                "black ones; remove has_one_accuracy"
            )
        return on_black, on_white

    def _check_accuracies(self, accuracies: object, steps: int) -> NDArray[np.float64]:
        """Return one of the model's two answers for ``steps`` steps as an array of floats.

        Raises UsageError unless its shape is (steps or 1, robots or 1) and all values are 0 to 1.
        """
        name = self._settings.sensor
        robots = self._settings.robots
        values = np.asarray(accuracies, dtype=np.float64)
        # The number of axes first: an array with one of them has no shape[1].
        has_legal_shape = (
            values.ndim == 2 and values.shape[0] in (1, steps) and values.shape[1] in (1, robots)
        )
        if not has_legal_shape:
            raise UsageError(
                f"sensor {name} gives shape {values.shape}; return ({steps} or 1, {robots} or 1)"
            )
        # NaN fails both comparisons, and is refused with the rest.
        is_in_range = (values >= 0) & (values <= 1)
        if not is_in_range.all():
            raise UsageError(f"sensor {name} gives an accuracy outside 0 to 1; clip it")
        return values


def has_one_accuracy(settings: WorldSettings) -> bool:
    """Return whether the sensors name black and white equally well at any time.

    The built-in ones do without a ``white_offset``; those of an extension do if it promises so by a true
    attribute ``has_one_accuracy``. Raises UsageError if the extension cannot be loaded.
    """
    if not settings.sensor:
        return settings.white_offset == 0
    extension = extensions.load(extensions.SENSORS, settings.sensor)
    return bool(getattr(extension, "has_one_accuracy", False))


def make_sensor_model(settings: WorldSettings, trial: int) -> SensorModel:
    """Return the sensor model of a trial, before its first step.

    That is the built-in one, or the one of the extension that ``settings.sensor`` names, wrapped so that its
    answers are checked. Raises UsageError if the extension cannot be loaded.
    """
    if not settings.sensor:
        return DriftingSensors(settings, trial)
    make_model = cast(_SensorMaker, extensions.load(extensions.SENSORS, settings.sensor))
    model = make_model(settings, trial)
    return CheckedSensors(model, settings, has_one_accuracy=has_one_accuracy(settings))


def black_probabilities_by_colour(accuracies: Accuracies) -> tuple[NDArray[np.uint32], NDArray[np.uint32]]:
    """Return the probability that a robot reports black, on black and on white tiles.

    Both are in units of 2**-31 and have the shapes of the accuracies.
    """
    accuracy_on_black, accuracy_on_white = accuracies
    black_on_black = _to_integer_units(accuracy_on_black)
    # On white a robot reports black by mistake: with the probability that is left.
    black_on_white = np.uint32(PROBABILITY_ONE) - _to_integer_units(accuracy_on_white)
    return black_on_black, black_on_white


def black_probabilities_anywhere(accuracies: Accuracies, fill_ratio: float) -> NDArray[np.uint32]:
    """Return the probability that a robot reports black on a tile that is black with probability f.

    It is f b + (1 - f)(1 - w), the paper's equation 1, where f is the ``fill_ratio``, b the accuracy on black
    and w that on white. It is in units of 2**-31 and has the shape of the accuracies.
    """
    accuracy_on_black, accuracy_on_white = accuracies
    black_and_correct = fill_ratio * accuracy_on_black
    white_and_mistaken = (1 - fill_ratio) * (1 - accuracy_on_white)
    return _to_integer_units(black_and_correct + white_and_mistaken)


def _to_integer_units(probabilities: NDArray[np.float64]) -> NDArray[np.uint32]:
    """Return probabilities in units of 2**-31, rounded to the nearest, as the engine in C takes them."""
    return np.rint(probabilities * PROBABILITY_ONE).astype(np.uint32)
