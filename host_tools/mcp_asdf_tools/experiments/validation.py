"""Checks of an experiment's values; their messages name the value, the range and the fix."""

from __future__ import annotations

import math
from dataclasses import fields
from enum import Enum
from typing import TYPE_CHECKING, Any

import numpy as np

from mcp_asdf.robot import DEFAULT_MEMORY, MIN_MEMORY
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.experiments.parameters import Convention, Drift, Floor
from mcp_asdf_tools.robots.firmwares import FIRMWARES
from mcp_asdf_tools.world import floor_images

if TYPE_CHECKING:
    from mcp_asdf_tools.experiments.experiment import Experiment

MAX_ROBOTS = 128
MAX_STEPS = 10**8
MAX_TRIALS = 10**6
MAX_PERIOD = 2**32 - 1
"""Steps."""
MAX_SIDE = 1000.0

_BODY_DIAMETER = 0.1408
_WHEEL_DISTANCE = 0.1054
_MOST_CROWDED = 0.4
"""Share of the floor that bodies may cover: where they are put at random there is room up to about 0.5."""
_LARGEST_TURN = 1.6
"""Radians in a step, which the arena can follow."""
_MOST_TILES = 100_000
"""Along a side."""
_SAME_SHARE = 1e-6


class ExperimentError(UsageError):
    """A value that cannot be; ``key`` is the attribute of Experiment that has to change."""

    def __init__(self, key: str, message: str) -> None:
        super().__init__(message)
        self.key = key


_RANGES: tuple[tuple[str, float, float], ...] = (
    ("robots", 1, MAX_ROBOTS),
    ("fill_ratio", 0, 1),
    ("true_accuracy", 0, 1),
    ("flawed_accuracy", 0, 1),
    ("filter_period", 1, MAX_PERIOD),
    ("comms_period", 1, MAX_PERIOD),
    ("memory", MIN_MEMORY, DEFAULT_MEMORY),
    ("drift_rate", -1, 1),
    ("drift_period", 1, MAX_PERIOD),
    ("drift_diffusion", 0, 1),
    ("lowest_accuracy", 0, 1),
    ("density", 1e-6, 1e6),
    ("width", 0, MAX_SIDE),
    ("height", 0, MAX_SIDE),
    ("speed", 1e-6, 0.814),
    ("radio_range", 1e-3, MAX_SIDE),
    ("tile", 1e-6, MAX_SIDE),
    ("ticks_per_second", 1, 1000),
    ("observation_period", 1, MAX_PERIOD),
    ("latency", 0, 1),
    ("steps", 1, MAX_STEPS),
    ("trials", 1, MAX_TRIALS),
    ("seed", 0, 2**64 - 1),
)


def check(experiment: Experiment) -> None:
    """Raises ExperimentError for the first value out of range. Notes the digest of a new picture."""
    for name, least, most in _RANGES:
        value = getattr(experiment, name)
        if not least <= value <= most:
            raise ExperimentError(name, f"{name} is {value}; it must be {least} to {most}")
    for each in (_check_periods, _check_firmware, _check_drift, _check_topology):
        each(experiment)
    if experiment.is_dynamic:
        _check_sides(experiment)
        _check_arena(experiment)
        _check_floor(experiment)


def _default(experiment: Experiment, name: str) -> Any:
    return next(field.default for field in fields(experiment) if field.name == name)


def _check_periods(experiment: Experiment) -> None:
    if not 0 <= experiment.flawed <= experiment.robots:
        message = f"flawed is {experiment.flawed}; it must be 0 to robots, {experiment.robots}"
        raise ExperimentError("flawed", message)
    if experiment.filter_period % experiment.comms_period:
        tau, comms = experiment.filter_period, experiment.comms_period
        message = f"filter_period is {tau}; it must be a multiple of comms_period, {comms}"
        raise ExperimentError("filter_period", message)
    if experiment.memory % 4:
        message = f"memory is {experiment.memory}; it must be a multiple of 4"
        raise ExperimentError("memory", message)


def _check_firmware(experiment: Experiment) -> None:
    if experiment.firmware not in FIRMWARES:
        message = f"firmware is {experiment.firmware!r}; choose one of {', '.join(FIRMWARES)}"
        raise ExperimentError("firmware", message)
    if experiment.conventions is Convention.AUTHORS and experiment.firmware != "reference":
        message = (
            f"firmware {experiment.firmware} has no conventions of the authors; choose firmware reference"
        )
        raise ExperimentError("conventions", message)


def _check_drift(experiment: Experiment) -> None:
    if experiment.drift is Drift.NONE:
        for name in ("drift_rate", "drift_diffusion"):
            if getattr(experiment, name):
                raise ExperimentError(
                    name, f"{name} is {getattr(experiment, name)} but drift is none; choose a drift"
                )
    elif experiment.lowest_accuracy > experiment.true_accuracy:
        lowest, start = experiment.lowest_accuracy, experiment.true_accuracy
        message = f"lowest_accuracy is {lowest}; it must be at most true_accuracy, {start}"
        raise ExperimentError("lowest_accuracy", message)


_OF_ARENA = (
    "density",
    "width",
    "height",
    "speed",
    "radio_range",
    "floor",
    "tile",
    "picture",
    "picture_sha256",
    "ticks_per_second",
    "observation_period",
    "latency",
)


def _check_topology(experiment: Experiment) -> None:
    """Settings of a moving world are given to no other."""
    for name in () if experiment.is_dynamic else _OF_ARENA:
        value = getattr(experiment, name)
        if value != _default(experiment, name):
            said = value.value if isinstance(value, Enum) else value
            message = f"{name} is {said} but robots do not move; choose topology dynamic"
            raise ExperimentError(name, message)


def _check_sides(experiment: Experiment) -> None:
    if experiment.width and experiment.density != _default(experiment, "density"):
        raise ExperimentError("density", "density and width say how large the arena is; give one of them")
    if (experiment.width == 0) != (experiment.height == 0):
        message = (
            f"the arena is {experiment.width} x {experiment.height} m; give width and height, or neither"
        )
        raise ExperimentError("width" if experiment.width == 0 else "height", message)


def _check_arena(experiment: Experiment) -> None:
    width, height = experiment.sides
    size = f"{width:.4g} x {height:.4g} m"
    key = "width" if experiment.width else "density"
    bodies = experiment.robots * math.pi * (_BODY_DIAMETER / 2) ** 2
    if min(width, height) <= _BODY_DIAMETER or bodies > _MOST_CROWDED * width * height:
        message = (
            f"{experiment.robots} robots of {_BODY_DIAMETER} m are too many for {size}; take a larger arena"
        )
        raise ExperimentError(key, message)
    if max(width, height) > MAX_SIDE:
        raise ExperimentError(key, f"the arena is {size}; its sides may be up to {MAX_SIDE:g} m")
    if experiment.tile * _MOST_TILES < max(width, height):
        message = f"tile is {experiment.tile}; choose one with at most {_MOST_TILES} along {size}"
        raise ExperimentError("tile", message)
    if 2 * experiment.speed / _WHEEL_DISTANCE > _LARGEST_TURN * experiment.ticks_per_second:
        least = math.ceil(2 * experiment.speed / _WHEEL_DISTANCE / _LARGEST_TURN)
        message = (
            f"ticks_per_second is {experiment.ticks_per_second}; at this speed it must be {least} or more"
        )
        raise ExperimentError("ticks_per_second", message)


def _check_floor(experiment: Experiment) -> None:
    floor, path = experiment.floor, experiment.picture
    if (floor is Floor.PICTURE) != bool(path):
        message = "floor is picture but there is none; give its path" if not path else "choose floor picture"
        raise ExperimentError("picture", f"picture is {path!r}: {message}")
    if floor is not Floor.TILES and experiment.tile != _default(experiment, "tile"):
        raise ExperimentError("tile", f"tile is {experiment.tile} but floor is {floor.value}, without tiles")
    try:
        if floor is Floor.CODE:
            floor_images.code(experiment.fill_ratio)
        if floor is Floor.PICTURE and not experiment.picture_sha256:
            _take_picture(experiment, floor_images.read_picture(path))
    except ExperimentError:
        raise
    except UsageError as error:
        key = "picture" if floor is Floor.PICTURE else "fill_ratio"
        raise ExperimentError(key, str(error)) from error


def _take_picture(experiment: Experiment, image: floor_images.ImageFile) -> None:
    """Note which picture it is, and that errors are relative to its fill ratio."""
    share = float(image.pixels.mean(dtype=np.float64))
    if abs(share - experiment.fill_ratio) > _SAME_SHARE:
        message = (
            f"fill_ratio is {experiment.fill_ratio}; of {experiment.picture} {share:.9g} is black: give that"
        )
        raise ExperimentError("fill_ratio", message)
    object.__setattr__(experiment, "picture_sha256", image.sha256)


MAX_EXPERIMENTS = 100_000
