"""Robots in a world: how many are flawed, which of them filter, and with which settings."""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from decimal import Decimal
from typing import Any, Literal

from mcp_asdf.robot import (
    B_HAT_MARGIN,
    DEFAULT_FILTER_PERIOD,
    DEFAULT_MEMORY,
    MAX_ID,
    MIN_MEMORY,
    Config,
    Filter,
)
from mcp_asdf_tools.common.parameters import ParameterError, parameter, parameters_of, value_of
from mcp_asdf_tools.robots.firmwares import firmware_names
from mcp_asdf_tools.robots.record import RobotRecord
from mcp_asdf_tools.tables.thresholds import generate, parse_omega
from mcp_asdf_tools.world.settings import MAX_PERIOD, WorldSettings

Filtering = Literal["none", "asdf-minus", "asdf-plus", "robust"]
"""Robots that re-estimate their assumed accuracy: none, the flawed ones (the paper's ASDF-), all (ASDF+), or
all by the robust filter, which is not the paper's."""

FILTER_NAMES: dict[Filtering, str] = {
    "none": "no filter",
    "asdf-minus": "ASDF-",
    "asdf-plus": "ASDF+",
    "robust": "robust",
}
"""Names in ASCII, the first three the paper's."""
TYPESET_FILTER_NAMES = {key: name.replace("-", "\N{MINUS SIGN}") for key, name in FILTER_NAMES.items()}
"""The same for pictures and pages."""

FILTER_MEANINGS: dict[Filtering, str] = {
    "none": "no robot recalibrates",
    "asdf-minus": "the flawed robots do, by the paper's filter: for when one knows which they may be",
    "asdf-plus": "all robots do, by the paper's filter, which may spoil healthy ones",
    "robust": "all robots do, by this project's own filter: for when fewer than two in five may be wrong",
}
"""A line on each."""

_FILTER_DESCRIPTIONS: dict[Filtering, str] = {
    "none": "no filter: no robot recalibrates",
    "asdf-minus": "ASDF-: only the flawed robots recalibrate",
    "asdf-plus": "ASDF+: all robots recalibrate",
    "robust": "robust: all robots recalibrate, by this project's own filter",
}
_ALWAYS_ACTIVE = ", in every filter step without a test"
_DESCRIPTIONS_OF_ONE = {
    Filter.OFF: "no filter: the robot does not recalibrate",
    Filter.ADAPTIVE: "ASDF: the robot recalibrates, by the paper's filter",
    Filter.ALWAYS: f"ASDF: the robot recalibrates, by the paper's filter{_ALWAYS_ACTIVE}",
    Filter.ROBUST: "robust: the robot recalibrates, by this project's own filter",
}

Activation = Literal["adaptive", "always"]
"""When a robot re-estimates, every ``filter_period`` steps: if the test rejects (eq. 12), or always."""

Drifting = Literal["all", "flawed"]
"""Robots whose sensors drift."""


@dataclass(frozen=True, kw_only=True)
class Population(WorldSettings):
    """N robots, of which the first ``flawed`` assume a wrong accuracy, and the world around them.

    ``flawed`` is a count if it is an int or a text of digits (``6``), a share of N if it is a float or a text
    with a point or a percent sign (``0.3``, ``30%``); a share becomes the nearest count, halves up.
    """

    flawed: Any = parameter("flawed robots: a count (6) or a share (30%, 0.3)", default="30%")
    flawed_accuracy: float = parameter("b_hat that flawed robots assume at the start", 0, 1, default=0.55)
    unflawed_accuracy: float = parameter(
        "b_hat that unflawed robots assume at the start; 0: the true accuracy", 0, 1, default=0.0
    )
    drift_of: Drifting = parameter("robots whose sensors drift", default="all")
    filter: Filtering = parameter(
        "which robots recalibrate; robust: all, by a filter that is not the paper's", default="asdf-minus"
    )
    activation: Activation = parameter("recalibrate if the test rejects, or always", default="adaptive")
    comms_period: int = parameter("steps between broadcasts", 1, MAX_PERIOD, default=1)
    filter_period: int = parameter(
        "nominal filtering period tau in steps, a multiple of comms_period",
        1,
        MAX_PERIOD,
        default=DEFAULT_FILTER_PERIOD,
    )
    omega: Any = parameter("type II error probability of the test, up to 0.9", default=Decimal("0.05"))
    memory: int = parameter(
        "forgetting: halve t and n at this many observations, a multiple of 4",
        MIN_MEMORY,
        2**31,
        default=DEFAULT_MEMORY,
    )
    latency: int = parameter("steps that a message takes", 0, 1, default=0)
    firmware: str = parameter("firmware of the robots", default="native", choices=firmware_names())

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "flawed", flawed_count(self.flawed, self.robots))
        with value_of("omega"):
            object.__setattr__(self, "omega", parse_omega(str(self.omega)))
        if self.filter_period % self.comms_period:
            raise ParameterError(
                "filter_period",
                f"filter_period is {self.filter_period}; it must be a multiple of comms_period, "
                f"{self.comms_period}",
            )
        if self.drift_of != "all" and self.drift == "none":
            raise ParameterError("drift_of", f"drift_of is {self.drift_of} but drift is none; choose a drift")
        if self.memory % 4:
            raise ParameterError("memory", f"memory is {self.memory}; it must be a multiple of 4")

    def unused_parameters(self) -> dict[str, str]:
        """Parameters without effect here, with the reason."""
        return self._unused_of_drift() | self._unused_of_filter()

    def _unused_of_drift(self) -> dict[str, str]:
        """Parameters of drifts that this kind of drift does not have."""
        reason = f"drift is {self.drift}"
        unused = {} if self.drift == "stepped" else {"drift_period": reason}
        if self.drift != "wiener":
            unused["drift_diffusion"] = reason
        if self.drift == "none":
            unused["lowest_accuracy"] = reason
        return unused

    def _unused_of_filter(self) -> dict[str, str]:
        """Parameters of filters that this filter does not have."""
        if self.filter == "none":
            return dict.fromkeys(("omega", "activation"), "filter is none")
        if self.filter == "robust":
            return dict.fromkeys(("omega", "activation"), "filter is robust, with a test of its own")
        if self.activation == "always":
            return {"omega": "activation is always, without a test"}
        return {}

    @property
    def drifting(self) -> int:
        """How many of the first robots have sensors that drift."""
        return self.flawed if self.drift_of == "flawed" else self.robots

    @property
    def filter_name(self) -> str:
        """The paper's name of who filters, or robust, in ASCII."""
        return FILTER_NAMES[self.filter]

    @property
    def filter_description(self) -> str:
        """The filter for reports, in ASCII: its name, and which robots recalibrate."""
        description = _FILTER_DESCRIPTIONS[self.filter]
        is_untested = self.filter in ("asdf-minus", "asdf-plus") and self.activation == "always"
        return description + _ALWAYS_ACTIVE if is_untested else description

    def is_flawed(self, robot: int) -> bool:
        """True if a robot is among the flawed."""
        return bool(robot < self.flawed)

    def filters(self, robot: int) -> bool:
        """True if a robot re-estimates its accuracy."""
        if self.filter == "asdf-minus":
            return self.is_flawed(robot)
        return self.filter != "none"

    def b_hat(self, robot: int) -> float:
        """Assumed accuracy of a robot at the start, within the firmware's [2**-20, 1 - 2**-20]."""
        correct = self.unflawed_accuracy or self.true_accuracy
        accuracy = self.flawed_accuracy if self.is_flawed(robot) else correct
        return min(max(accuracy, B_HAT_MARGIN), 1 - B_HAT_MARGIN)

    def config(self, robot: int) -> Config:
        """Settings of a robot's firmware. The table covers N - 1 neighbours, 127 at most."""
        kind = Filter.OFF
        if self.filter == "robust":
            kind = Filter.ROBUST
        elif self.filters(robot):
            kind = Filter.ADAPTIVE if self.activation == "adaptive" else Filter.ALWAYS
        neighbours = min(max(2, self.robots - 1), MAX_ID)
        table = generate(self.omega, neighbours) if kind is Filter.ADAPTIVE else None
        return Config(table, kind, self.filter_period // self.comms_period, self.memory)

    def record(self, robot: int) -> RobotRecord:
        """How a robot starts."""
        return RobotRecord(robot, self.firmware, self.b_hat(robot), self.config(robot), self.comms_period)

    def parameters(self) -> dict[str, Any]:
        """All parameters as plain numbers and words, which the class takes back."""
        return {name: _plain(getattr(self, name)) for name in parameters_of(type(self))}


def _plain(value: Any) -> Any:
    if isinstance(value, Decimal):
        return float(value)
    return value if isinstance(value, int | float) else str(value)


def describe_filters(records: Sequence[RobotRecord]) -> str:
    """Describe for reports which of these robots recalibrate, and by which filter, in ASCII.

    A single robot has "ASDF", since only a swarm can have ASDF- or ASDF+.
    """
    if len(records) == 1:
        return _DESCRIPTIONS_OF_ONE[records[0].config.filter]
    filters = {record.config.filter for record in records}
    if filters == {Filter.OFF}:
        return _FILTER_DESCRIPTIONS["none"]
    if filters == {Filter.ROBUST}:
        return _FILTER_DESCRIPTIONS["robust"]
    if Filter.ROBUST in filters:
        names = sorted(kind.name.lower() for kind in filters)
        return f"mixed: robots with the filters {', '.join(names)}"
    description = _FILTER_DESCRIPTIONS["asdf-minus" if Filter.OFF in filters else "asdf-plus"]
    return description + _ALWAYS_ACTIVE if Filter.ALWAYS in filters else description


def flawed_count(given: Any, robots: int) -> int:
    """A count or share of ``robots`` as a count. Raises ParameterError if it is neither, or out of range."""
    text, count = str(given), -1
    if text.isascii() and text.isdigit():
        count = int(text)
    else:
        with suppress(ValueError):
            share = float(text.removesuffix("%")) / (100 if text.endswith("%") else 1)
            count = math.floor(share * robots + 0.5) if 0 <= share <= 1 else -1
    if not 0 <= count <= robots:
        raise ParameterError(
            "flawed", f"flawed is {given!r}; give a count, 0 to {robots}, or a share such as '30%' or 0.3"
        )
    return count
