"""An experiment: a swarm, its sensors and its world, to be run many times.

Words and letters are the paper's; ``host_tools.simulation`` runs experiments, ``host_tools.experiment_files``
reads them.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, fields
from decimal import Decimal
from enum import Enum
from typing import Any

from firmware_py.robot import (
    B_HAT_MARGIN,
    DEFAULT_FILTER_PERIOD,
    DEFAULT_MEMORY,
    MAX_PERIOD,
    MIN_MEMORY,
    Config,
    Filter,
)
from host_tools.errors import UsageError
from host_tools.firmwares import FIRMWARES
from host_tools.tables import generate, parse_omega

MAX_ROBOTS = 128
MAX_STEPS = 10**8
MAX_TRIALS = 10**6


class Topology(Enum):
    """Who hears whom."""

    FULLY_CONNECTED = "fully_connected"
    """Every robot hears every other, in the same tick."""


class Mode(Enum):
    """Which robots re-estimate their assumed accuracy."""

    NONE = "none"
    ASDF_MINUS = "asdf_minus"
    """Only the flawed ones."""
    ASDF_PLUS = "asdf_plus"
    """All."""


class Activation(Enum):
    """When they do, every ``filter_period`` steps."""

    ADAPTIVE = "adaptive"
    """If the hypothesis test rejects (eq. 12)."""
    ALWAYS = "always"
    """Without a test."""


class Convention(Enum):
    """Whose reading of the equations the reference firmware follows; see ``firmware_py.reference``."""

    PAPER = "paper"
    AUTHORS = "authors"


class Drift(Enum):
    """How the true accuracy changes, from b at the first step; ``k`` counts steps from 0."""

    NONE = "none"
    LINEAR = "linear"
    """b + drift_rate k."""
    STEPPED = "stepped"
    """b + drift_rate k, with k rounded down to a multiple of drift_period."""
    WIENER = "wiener"
    """b + drift_rate k + drift_diffusion W(k): a Wiener process with drift of its own for every robot."""

    @property
    def is_random(self) -> bool:
        """Whether trials differ in it."""
        return self is Drift.WIENER


@dataclass(frozen=True)
class Experiment:
    """What defines an experiment; equal experiments give equal results. Raises UsageError if a value will not
    do.

    Attributes:
        topology: Who hears whom.
        robots: N, 1 .. 128.
        flawed: How many robots, the first ones, have a flawed assumed accuracy, 0 .. N.
        fill_ratio: f, 0 .. 1.
        true_accuracy: b of all sensors, 0 .. 1; robots that are not flawed assume it.
        flawed_accuracy: b_hat that flawed robots assume at the start, 0 .. 1.
        mode: Which robots re-estimate it.
        activation: Whether they test first.
        filter_period: Nominal filtering period tau in steps, a multiple of ``comms_period``.
        comms_period: Steps between broadcasts.
        omega: Type II error probability of the test, above 0 and at most 0.9.
        memory: Observations at which t and n are halved, even, 64 .. 2**32 - 2.
        drift: How the true accuracy changes.
        drift_rate: Per step.
        drift_period: Steps between the steps of STEPPED, 1 or more.
        drift_diffusion: Standard deviation of WIENER's change in one step, 0 or more.
        lowest_accuracy: Below which no drift takes the true accuracy, 0 .. b. It does not rise above 1
            either.
        steps: Length of a trial.
        trials: How many.
        seed: Of everything random, 0 .. 2**64 - 1. Trial i of two experiments with one seed sees the same
            draws.
        firmware: Name of the robots' firmware, see ``host_tools.firmwares``.
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
    steps: int = 40_000
    trials: int = 30
    seed: int = 1
    firmware: str = "native"
    conventions: Convention = Convention.PAPER

    def __post_init__(self) -> None:
        for name, least, most in _RANGES:
            value = getattr(self, name)
            if not least <= value <= most:
                raise ExperimentError(name, f"{name} is {value}; it must be {least} to {most}")
        for check in (_check_periods, _check_firmware, _check_drift):
            check(self)
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
        return Config(table, kind, self.comms_period, self.filter_period, self.memory)

    def b_hat(self, robot: int) -> float:
        """What a robot assumes at the start, kept within the firmware's [2**-20, 1 - 2**-20]."""
        accuracy = self.flawed_accuracy if robot < self.flawed else self.true_accuracy
        return min(max(accuracy, B_HAT_MARGIN), 1 - B_HAT_MARGIN)

    def parameters(self) -> dict[str, Any]:
        """The values as plain numbers and words, which ``from_parameters`` takes back."""
        return {name: _plain(value) for name, value in asdict(self).items()}

    @classmethod
    def from_parameters(cls, parameters: dict[str, Any]) -> Experiment:
        """An experiment of plain values; keys left out have their defaults.

        Raises ExperimentError for a key that is none and a value that will not do.
        """
        return cls(**{key: _typed(key, value) for key, value in parameters.items()})


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
    ("steps", 1, MAX_STEPS),
    ("trials", 1, MAX_TRIALS),
    ("seed", 0, 2**64 - 1),
)

_FIELDS = {field.name: field for field in fields(Experiment)}
_WORDS: dict[str, type[Enum]] = {
    name: type(field.default) for name, field in _FIELDS.items() if isinstance(field.default, Enum)
}


def _check_periods(experiment: Experiment) -> None:
    if not 0 <= experiment.flawed <= experiment.robots:
        message = f"flawed is {experiment.flawed}; it must be 0 to robots, {experiment.robots}"
        raise ExperimentError("flawed", message)
    if experiment.filter_period % experiment.comms_period:
        tau, comms = experiment.filter_period, experiment.comms_period
        message = f"filter_period is {tau}; it must be a multiple of comms_period, {comms}"
        raise ExperimentError("filter_period", message)
    if experiment.memory % 2:
        raise ExperimentError("memory", f"memory is {experiment.memory}; it must be even")


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
