"""Sensors: the probability that each robot sees a tile's colour correctly, step by step."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol, cast

import numpy as np
from numpy.typing import NDArray

from mcp_asdf_tools.common import extensions
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.world.philox import CERTAIN, MOVES, Stream
from mcp_asdf_tools.world.settings import WorldSettings

Accuracies = tuple[NDArray[np.float64], NDArray[np.float64]]
"""True accuracies on black and on white tiles, each of shape (steps or 1, robots or 1): an axis of length 1
means that values do not change along it."""


class SensorModel(Protocol):
    """True accuracies over time; an extension in the entry point group ``mcp_asdf.sensors`` makes one."""

    def advance(self, steps: int) -> Accuracies:
        """Accuracies in the next steps, 0 .. 1."""


class DriftingSensors:
    """The built-in model: b as ``settings.drift`` moves it, on white tiles ``white_offset`` more."""

    def __init__(self, settings: WorldSettings, trial: int) -> None:
        self._settings = settings
        self._moves = Stream(MOVES, settings.seed, trial, settings.robots)
        self._step = 0
        self._wiener = np.zeros(settings.robots)

    def advance(self, steps: int) -> Accuracies:
        """The next steps. O(steps) or, where robots differ, O(steps robots)."""
        black = self._black(steps)
        self._step += steps
        offset = self._settings.white_offset
        return black, np.clip(black + offset, 0.0, 1.0) if offset else black

    def _black(self, steps: int) -> NDArray[np.float64]:
        settings = self._settings
        if settings.drift == "none":
            return np.full((1, 1), settings.true_accuracy)
        step = np.arange(self._step, self._step + steps, dtype=np.float64)[:, np.newaxis]
        if settings.drift == "stepped":
            step -= step % settings.drift_period
        path = settings.true_accuracy + self._rates() * step
        if settings.drift == "wiener":
            path = path + settings.drift_diffusion * self._wiener_paths(steps)
        path = np.clip(path, settings.lowest_accuracy, 1.0)
        if settings.drifting == settings.robots:
            return path
        return np.where(np.arange(settings.robots) < settings.drifting, path, settings.true_accuracy)

    def _rates(self) -> NDArray[np.float64]:
        """Change per step, shape (1, 1) or, where robots differ, (1, robots): step 0 has no other use for its
        draws."""
        settings = self._settings
        common = np.full((1, 1), settings.drift_rate)
        return common + settings.drift_spread * self._normals(1, 0) if settings.drift_spread else common

    def _normals(self, steps: int, first: int) -> NDArray[np.float64]:
        from scipy.special import ndtri  # type: ignore[import-untyped] # noqa: PLC0415 (loads slowly)

        return cast(NDArray[np.float64], ndtri(self._moves.uniforms(steps, first)))

    def _wiener_paths(self, steps: int) -> NDArray[np.float64]:
        """Standard Wiener processes, 0 in the first step of all, shape (steps, robots)."""
        moves = self._normals(steps, self._step)
        if self._step == 0:
            moves[0] = 0.0
        moves[0] += self._wiener
        paths: NDArray[np.float64] = np.cumsum(moves, axis=0)
        self._wiener = paths[-1]
        return paths


class CheckedSensors:
    """The sensors of an extension, whose answers are checked."""

    def __init__(self, model: SensorModel, settings: WorldSettings) -> None:
        self._model, self._settings = model, settings

    def advance(self, steps: int) -> Accuracies:
        """The next steps. Raises UsageError unless they are what ``SensorModel`` says. O(steps N)."""
        name, robots = self._settings.sensor, self._settings.robots
        black, white = (np.asarray(each, dtype=np.float64) for each in self._model.advance(steps))
        for values in (black, white):
            if values.ndim != 2 or values.shape[0] not in (1, steps) or values.shape[1] not in (1, robots):
                raise UsageError(
                    f"sensor {name} gives shape {values.shape}; return ({steps} or 1, {robots} or 1)"
                )
            if not ((values >= 0) & (values <= 1)).all():
                raise UsageError(f"sensor {name} gives an accuracy outside 0 to 1; clip it")
        return black, white


def sensor_model(settings: WorldSettings, trial: int) -> SensorModel:
    """The sensors that settings ask for. Raises UsageError if their extension cannot be loaded."""
    if not settings.sensor:
        return DriftingSensors(settings, trial)
    make = cast(
        Callable[[WorldSettings, int], SensorModel], extensions.load(extensions.SENSORS, settings.sensor)
    )
    return CheckedSensors(make(settings, trial), settings)


def black_probabilities(
    accuracies: Accuracies, fill_ratio: float | None
) -> tuple[NDArray[np.uint32], NDArray[np.uint32]]:
    """p(z = 1) on black and on white tiles, in units of 2**-31, shapes as the accuracies.

    With a ``fill_ratio`` f the colour below is part of the chance: both are f b + (1 - f)(1 - w) (eq. 1).
    """
    b, w = accuracies
    if fill_ratio is not None:
        both = _in_units(fill_ratio * b + (1 - fill_ratio) * (1 - w))
        return both, both
    return _in_units(b), np.uint32(CERTAIN) - _in_units(w)


def _in_units(probabilities: NDArray[np.float64]) -> NDArray[np.uint32]:
    return np.rint(probabilities * CERTAIN).astype(np.uint32)
