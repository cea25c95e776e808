"""An experiment: a swarm, its sensors and its world, to be run many times.

Words and letters are the paper's; ``simulation`` runs experiments, ``experiment_files``
reads them.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, fields
from decimal import Decimal
from enum import Enum
from typing import Any

from mcp_asdf.robot import B_HAT_MARGIN, DEFAULT_FILTER_PERIOD, DEFAULT_MEMORY, Config, Filter
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.experiments.parameters import Activation, Convention, Drift, Floor, Mode, Topology
from mcp_asdf_tools.experiments.validation import ExperimentError, check
from mcp_asdf_tools.tables.thresholds import generate, parse_omega

__all__ = [
    "Activation",
    "Convention",
    "Drift",
    "Experiment",
    "ExperimentError",
    "Floor",
    "Mode",
    "Topology",
]


@dataclass(frozen=True)
class Experiment:
    """A definition; equal ones give equal results. Raises UsageError for a value out of range.

    Attributes:
        topology: Which robots hear each other. ``density`` to ``latency`` are for DYNAMIC only.
        robots: N, 1 .. 128.
        flawed: How many robots, the first ones, have a flawed assumed accuracy, 0 .. N.
        fill_ratio: f, 0 .. 1.
        true_accuracy: b of all sensors, 0 .. 1; robots that are not flawed assume it.
        flawed_accuracy: b_hat that flawed robots assume at the start, 0 .. 1.
        mode: Which robots re-estimate it.
        activation: Whether they test first.
        filter_period: Nominal filtering period tau in steps, a multiple of ``comms_period``.
        comms_period: Steps between broadcasts, which close a round; the firmware counts periods in rounds.
        omega: Type II error probability of the test, above 0 and at most 0.9.
        memory: Observations at which t and n are halved, a multiple of 4, 64 .. 2**31.
        drift: How the true accuracy changes.
        drift_rate: Per step.
        drift_period: Steps between the steps of STEPPED, 1 or more.
        drift_diffusion: Standard deviation of WIENER's change in one step, 0 or more.
        lowest_accuracy: Below which no drift takes the true accuracy, 0 .. b. It does not rise above 1
            either.
        density: Swarm density D = N pi r^2 / L^2, from which the side L of a square arena follows.
        width: Side of a rectangular arena along x in metres, which replaces the density; 0 for none.
        height: Side along y; 0 if and only if ``width`` is.
        speed: Limit of a wheel in m/s, above 0, at most 0.814.
        radio_range: Distance r of centres below which two robots hear each other, metres.
        floor: What the robots stand on.
        tile: Side of a tile in metres.
        picture: Path of the picture of a PICTURE floor; ``fill_ratio`` has to be its share of black.
        picture_sha256: Of the picture's file; filled in if empty, so that results record the floor.
        ticks_per_second: Steps per second.
        observation_period: Steps between observations.
        latency: Steps that a message takes: 0, or 1, when it reaches robots that are near in the next step.
        steps: Length of a trial.
        trials: How many.
        seed: Of everything random, 0 .. 2**64 - 1. Trial i of two experiments with one seed sees the same
            draws, and the same motion if the arena is the same.
        firmware: Name of the robots' firmware, see ``mcp_asdf_tools.robots.firmwares``.
        conventions: Of the reference firmware.
    """

    topology: Topology = Topology.FULLY_CONNECTED
    robots: int = 10
    flawed: int = 3
    fill_ratio: float = 0.55
    true_accuracy: float = 0.95
    flawed_accuracy: float = 0.55
    mode: Mode = Mode.ASDF_PLUS
    activation: Activation = Activation.ADAPTIVE
    filter_period: int = DEFAULT_FILTER_PERIOD
    comms_period: int = 1
    omega: Decimal = Decimal("0.05")
    memory: int = DEFAULT_MEMORY
    drift: Drift = Drift.NONE
    drift_rate: float = 0.0
    drift_period: int = 1000
    drift_diffusion: float = 0.0
    lowest_accuracy: float = 0.5
    density: float = 1.0
    width: float = 0.0
    height: float = 0.0
    speed: float = 0.1414
    radio_range: float = 0.7
    floor: Floor = Floor.TILES
    tile: float = 0.01
    picture: str = ""
    picture_sha256: str = ""
    ticks_per_second: int = 10
    observation_period: int = 1
    latency: int = 0
    steps: int = 40_000
    trials: int = 30
    seed: int = 1
    firmware: str = "native"
    conventions: Convention = Convention.PAPER

    def __post_init__(self) -> None:
        check(self)
        for name, value in vars(self).items():
            if isinstance(_FIELDS[name].default, float):
                object.__setattr__(self, name, float(value))  # so that equal ones are written alike
        try:
            object.__setattr__(self, "omega", parse_omega(str(self.omega)))
        except UsageError as error:
            raise ExperimentError("omega", str(error)) from None

    def config(self, robot: int) -> Config:
        """The firmware settings of a robot, 0 .. N - 1. The table covers N - 1 neighbours."""
        filters = self.mode is Mode.ASDF_PLUS or (self.mode is Mode.ASDF_MINUS and robot < self.flawed)
        adaptive = filters and self.activation is Activation.ADAPTIVE
        kind = Filter.ADAPTIVE if adaptive else Filter.ALWAYS if filters else Filter.OFF
        table = generate(self.omega, max(2, self.robots - 1)) if adaptive else None
        return Config(table, kind, self.filter_period // self.comms_period, self.memory)

    def b_hat(self, robot: int) -> float:
        """A robot's assumed accuracy at the start, kept within the firmware's [2**-20, 1 - 2**-20]."""
        accuracy = self.flawed_accuracy if robot < self.flawed else self.true_accuracy
        return min(max(accuracy, B_HAT_MARGIN), 1 - B_HAT_MARGIN)

    @property
    def is_dynamic(self) -> bool:
        """Whether the robots move."""
        return self.topology is Topology.DYNAMIC

    @property
    def sides(self) -> tuple[float, float]:
        """Width and height of the arena in metres."""
        if self.width:
            return self.width, self.height
        side = self.radio_range * math.sqrt(self.robots * math.pi / self.density)
        return side, side

    def parameters(self) -> dict[str, Any]:
        """The values as plain numbers and words, which ``from_parameters`` takes back."""
        return {name: _plain(value) for name, value in asdict(self).items()}

    @classmethod
    def from_parameters(cls, parameters: dict[str, Any]) -> Experiment:
        """An experiment of plain values; keys left out have their defaults.

        Raises ExperimentError for an unknown key or a value out of range.
        """
        return cls(**{key: _typed(key, value) for key, value in parameters.items()})


_FIELDS = {field.name: field for field in fields(Experiment)}
_WORDS: dict[str, type[Enum]] = {
    name: type(field.default) for name, field in _FIELDS.items() if isinstance(field.default, Enum)
}


def _plain(value: Any) -> Any:
    if isinstance(value, Enum):
        return value.value
    return float(value) if isinstance(value, Decimal) else value


def _typed(key: str, value: Any) -> Any:
    """``value`` as the attribute ``key`` holds it. Whole numbers may be written as floats."""
    if key not in _FIELDS:
        raise ExperimentError(key, f"unknown key {key!r}; known are {', '.join(_FIELDS)}")
    default = _FIELDS[key].default
    if isinstance(default, Enum):
        return _word(key, value)
    is_number = isinstance(value, int | float | Decimal) and not isinstance(value, bool)
    if isinstance(default, str) != isinstance(value, str) or not (is_number or isinstance(value, str)):
        raise ExperimentError(
            key, f"{key} is {value!r}; give {'a word' if isinstance(default, str) else 'a number'}"
        )
    if isinstance(default, int) and value % 1 != 0:  # also infinite and not a number
        raise ExperimentError(key, f"{key} is {value}; it must be a whole number")
    return Decimal(str(value)) if isinstance(default, Decimal) else type(default)(value)


def _word(key: str, value: Any) -> Enum:
    try:
        return _WORDS[key](value)
    except ValueError:
        choices = ", ".join(str(member.value) for member in _WORDS[key])
        raise ExperimentError(key, f"{key} is {value!r}; choose one of {choices}") from None
