"""Control ticks of a robot: when it broadcasts, and when its firmware closes a round.

The firmware counts rounds and leaves their length to its caller. Here a round has ``comms_period`` ticks: in
the last of them the robot broadcasts, and at the end of that tick the firmware settles. ``c_ref/ports/node``
does the same in C.
"""

from __future__ import annotations

from dataclasses import dataclass

from mcp_asdf.robot import (
    DEFAULT_FILTER_PERIOD,
    DEFAULT_MEMORY,
    Config,
    Counters,
    Filter,
    Observation,
    Robot,
)
from mcp_asdf.table import Table
from mcp_asdf_tools.common import UsageError, check_types
from mcp_asdf_tools.robots.firmwares import port_of

MAX_PERIOD = 2**32 - 1
"""Control ticks."""

_COUNTER_MODULUS = 2**16
_TICKS_BETWEEN_COUNTS = 64
"""Few enough for 1000 messages a tick: a counter must not gain 2**16 unseen."""


@dataclass(frozen=True)
class TickConfig:
    """The firmware's settings with periods in control ticks. Raises UsageError if the periods do not fit.

    Attributes:
        table: As in ``mcp_asdf.robot.Config``.
        filter: As there.
        comms_period: Ticks between broadcasts, 1 .. 2**32 - 1.
        filter_period: Nominal filtering period tau in ticks, a multiple of ``comms_period`` up to 2**32 - 1.
        memory: As there.
    """

    table: Table | None = None
    filter: Filter = Filter.ADAPTIVE
    comms_period: int = 1
    filter_period: int = DEFAULT_FILTER_PERIOD
    memory: int = DEFAULT_MEMORY

    def __post_init__(self) -> None:
        check_types(self)
        comms, tau = self.comms_period, self.filter_period
        if not 1 <= comms <= MAX_PERIOD:
            raise UsageError(f"comms_period is {comms}; choose 1 .. {MAX_PERIOD}")
        if not 1 <= tau <= MAX_PERIOD or tau % comms:
            raise UsageError(
                f"filter_period is {tau}; choose a multiple of comms_period {comms} up to {MAX_PERIOD}"
            )

    def in_rounds(self) -> Config:
        """The same for the firmware."""
        return Config(self.table, self.filter, self.filter_period // self.comms_period, self.memory)


class TickedRobot:
    """A firmware that is driven tick by tick.

    Attributes:
        robot: The firmware.
        port: The firmware's side of the bus.
        receive_all: Hands over neighbours' messages, see ``mcp_asdf.robot.FixedPointRobot``.
    """

    def __init__(self, robot: Robot, comms_period: int = 1) -> None:
        """Drive a robot that has done nothing yet and broadcasts every ``comms_period`` ticks, 1 or more."""
        self.robot = robot
        self.port = port_of(robot)
        self.receive_all = self.port.receive_all
        self._comms_period = self._left = comms_period
        self._ticks = 0
        self._counted = robot.counters

    def observe(self, z: Observation | None) -> bool:
        """Begin a tick, with an observation or without; returns whether the broadcast is due.

        It stays due until a tick has ended.
        """
        if z is not None:
            self.robot.observe(z)
        self._left = max(self._left - 1, 0)
        return self._left == 0

    def settle(self) -> None:
        """End the tick, and its round if that is due."""
        if self._left == 0:
            self._left = self._comms_period
            self.robot.settle()
        self._ticks += 1
        if self._ticks % _TICKS_BETWEEN_COUNTS == 0:
            self._count()

    @property
    def counters(self) -> Counters:
        """The firmware's diagnostics, in numbers that do not wrap."""
        self._count()
        return self._counted

    def _count(self) -> None:
        """Add the gains of the firmware's counters."""
        found, known = vars(self.robot.counters), vars(self._counted)
        self._counted = Counters(
            **{name: count + (found[name] - count) % _COUNTER_MODULUS for name, count in known.items()}
        )
