"""Robots in a world: how many are flawed, which of them filter, and with which settings."""

from __future__ import annotations

import math
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
from mcp_asdf.table import MIN_Q, Table
from mcp_asdf_tools.common.parameters import ParameterError, naming_parameter, parameter, parameters_of
from mcp_asdf_tools.robots.filters import FILTERS, Activation, SwarmFilter
from mcp_asdf_tools.robots.firmwares import firmware_names
from mcp_asdf_tools.robots.robot_setup import RobotSetup
from mcp_asdf_tools.world.settings import MAX_PERIOD, WorldSettings

Drifting = Literal["all", "flawed"]
"""Robots whose sensors drift."""


@dataclass(frozen=True, kw_only=True)
class Population(WorldSettings):
    """N robots, of which the first ``flawed`` assume a wrong accuracy, and the world around them.

    ``flawed`` is a count if it is an int or a text of digits (``6``), a share of N if it is a float or a text
    with a point or a percent sign (``0.3``, ``30%``); a share becomes the nearest count, halves up.
    """

    flawed: Any = parameter("robots that misjudge their sensor: a count (6) or a share (30%)", default="30%")
    flawed_accuracy: float = parameter(
        "accuracy that flawed robots assume at the start (b_hat)", 0, 1, default=0.55
    )
    unflawed_accuracy: float = parameter(
        "accuracy that the other robots assume at the start; 0: the true one", 0, 1, default=0.0
    )
    drift_of: Drifting = parameter("robots whose sensors drift", default="all")
    filter: str = parameter(
        "which robots recalibrate, and how",
        default="asdf-minus",
        choices=tuple(FILTERS),
    )
    activation: Activation = parameter("recalibrate only if the test rejects, or always", default="adaptive")
    comms_period: int = parameter("steps between two broadcasts", 1, MAX_PERIOD, default=1)
    filter_period: int = parameter(
        "steps between two tests of the filter (tau), a multiple of comms_period",
        1,
        MAX_PERIOD,
        default=DEFAULT_FILTER_PERIOD,
    )
    omega: Any = parameter(
        "type II error probability of the test, up to 0.9 (omega)", default=Decimal("0.05")
    )
    memory: int = parameter(
        "observations at which a robot halves its counts (forgetting), a multiple of 4",
        MIN_MEMORY,
        2**31,
        default=DEFAULT_MEMORY,
    )
    latency: int = parameter("steps that a message takes", 0, 1, default=0)
    firmware: str = parameter("firmware of the robots", default="native", choices=firmware_names())

    def __post_init__(self) -> None:
        """Check the parameters, and replace ``flawed`` by a count and ``omega`` by a Decimal.

        Beside the range of each, ``filter_period`` must be a multiple of ``comms_period``, ``memory`` a
        multiple of 4, and a choice of drifting robots needs a drift.
        Raises ParameterError, which names the wrong parameter.
        """
        from mcp_asdf_tools.tables.thresholds import parse_omega  # noqa: PLC0415 (mpmath loads slowly)

        # The base class first, which checks the number of robots that a share refers to. The class is frozen,
        # so that a plain assignment would be refused.
        super().__post_init__()
        object.__setattr__(self, "flawed", flawed_count(self.flawed, self.robots))
        with naming_parameter("omega"):
            object.__setattr__(self, "omega", parse_omega(str(self.omega)))
        if self.filter_period % self.comms_period != 0:
            raise ParameterError(
                "filter_period",
                f"filter_period is {self.filter_period}; it must be a multiple of comms_period, "
                f"{self.comms_period}",
            )
        if self.drift_of != "all" and self.drift == "none":
            raise ParameterError("drift_of", f"drift_of is {self.drift_of} but drift is none; choose a drift")
        # The firmware asks for that; ``mcp_asdf.robot.check_settings`` has the reason.
        if self.memory % 4 != 0:
            raise ParameterError("memory", f"memory is {self.memory}; it must be a multiple of 4")

    def unused_parameters(self) -> dict[str, str]:
        """Return the parameters that have no effect in this population: the reason, a text, by their name."""
        unused_parameters = self.swarm_filter.unused_parameters_with(self.activation)
        if self.drift == "none":
            return {"lowest_accuracy": "drift is none"} | unused_parameters
        return unused_parameters

    @property
    def drifting(self) -> int:
        """Number of robots whose sensors drift; they are the first by id."""
        return self.flawed if self.drift_of == "flawed" else self.robots

    @property
    def swarm_filter(self) -> SwarmFilter:
        """The filter that ``filter`` names."""
        return FILTERS[self.filter]

    @property
    def filter_description(self) -> str:
        """The filter for reports, in ASCII: its name, and which robots recalibrate."""
        return self.swarm_filter.describe(self.activation)

    def is_flawed(self, robot: int) -> bool:
        """Return whether a robot, by id, is among the flawed, which assume a wrong accuracy at the start."""
        return bool(robot < self.flawed)

    def b_hat(self, robot: int) -> float:
        """Return the accuracy that a robot assumes at the start, limited to 2**-20 and 1 - 2**-20.

        These are the firmware's limits.
        """
        if self.is_flawed(robot):
            accuracy = self.flawed_accuracy
        else:
            # 0 is the parameter's way to ask for the true accuracy.
            accuracy = self.unflawed_accuracy or self.true_accuracy
        return min(max(accuracy, B_HAT_MARGIN), 1 - B_HAT_MARGIN)

    def config(self, robot: int) -> Config:
        """Return the settings of a robot's firmware."""
        firmware_filter = self.swarm_filter.firmware_filter_of(self.is_flawed(robot), self.activation)
        # The firmware counts rounds, of comms_period steps each, where the paper's tau counts steps.
        rounds_between_tests = self.filter_period // self.comms_period
        return Config(self._table_for(firmware_filter), firmware_filter, rounds_between_tests, self.memory)

    def _table_for(self, firmware_filter: Filter) -> Table | None:
        """Return the t-table, the thresholds of the adaptive filter's test; None for another filter.

        It has exact entries for up to N - 1 neighbours, but for MIN_Q (2) at least and 127 at most.
        """
        from mcp_asdf_tools.tables.thresholds import generate  # noqa: PLC0415 (mpmath loads slowly)

        if firmware_filter is not Filter.ADAPTIVE:
            return None
        neighbours = min(max(self.robots - 1, MIN_Q), MAX_ID)
        return generate(self.omega, neighbours)

    def setup_of(self, robot: int) -> RobotSetup:
        """Return how a robot starts."""
        return RobotSetup(robot, self.firmware, self.b_hat(robot), self.config(robot), self.comms_period)

    def parameters(self) -> dict[str, Any]:
        """Return all parameters by name as numbers and texts, from which the class can be made again."""
        return {name: _plain(getattr(self, name)) for name in parameters_of(type(self))}


def _plain(value: Any) -> Any:
    """Return a parameter's value as a number or a text: a Decimal as a float, other objects as their text.

    The nine decimal places of omega survive in a float, and JSON has no decimals.
    """
    if isinstance(value, Decimal):
        return float(value)
    if isinstance(value, int | float):
        return value
    return str(value)


def flawed_count(count_or_share: Any, robots: int) -> int:
    """Return the number of flawed robots that a count such as 6, or a share such as 0.3 or 30%, stands for.

    Digits alone are a count: 1 is one robot, but 1.0 and 100% are all of them. A share of ``robots`` becomes
    the nearest count, halves up. Raises ParameterError if the value is neither a count nor a share, or out of
    range.
    """
    flawed_text = str(count_or_share)
    error = ParameterError(
        "flawed",
        f"flawed is {count_or_share!r}; give a count, 0 to {robots}, or a share such as '30%' or 0.3",
    )
    if flawed_text.isascii() and flawed_text.isdigit():
        count = int(flawed_text)
        if count > robots:
            raise error
        return count
    share = _parse_share(flawed_text)
    if not 0 <= share <= 1:  # this refuses NaN, too
        raise error
    return math.floor(share * robots + 0.5)


def _parse_share(share_text: str) -> float:
    """Return the number that a text such as ``0.3`` or ``30%`` stands for; NaN if it stands for none."""
    divisor = 100 if share_text.endswith("%") else 1
    number_text = share_text.removesuffix("%")
    try:
        return float(number_text) / divisor
    except ValueError:
        return math.nan
