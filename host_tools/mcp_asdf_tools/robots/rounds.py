"""Control ticks of a robot: when it broadcasts, and when its firmware closes a round.

The firmware counts rounds and leaves their length to its caller. Here a round has ``comms_period`` ticks: in
the last of them the robot broadcasts, and at the end of that tick the firmware settles. ``c_ref/ports/node``
does the same in C.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol, TypeAlias, runtime_checkable

from mcp_asdf.fixed_point import ONE, alpha_to_word, word_to_alpha
from mcp_asdf.robot import (
    DEFAULT_FILTER_PERIOD,
    DEFAULT_MEMORY,
    Config,
    Counters,
    Filter,
    FirmwareError,
    Observation,
    Robot,
    Status,
)
from mcp_asdf.table import Table

if TYPE_CHECKING:  # numpy is slow to load, and help needs the settings only
    import numpy as np
    from numpy.typing import NDArray

MAX_PERIOD = 2**32 - 1
"""Control ticks."""

_COUNTER_MODULUS = 2**16
_TICKS_BETWEEN_COUNTS = 64
"""Few enough for 1000 messages a tick: a counter must not gain 2**16 unseen."""


Words: TypeAlias = "NDArray[np.uint32]"
"""Estimates for a firmware, shape (estimates, 3): sender, x_hat and alpha, as ``bus.frames.Message``."""


@dataclass(frozen=True)
class TickConfig:
    """The firmware's settings with periods in control ticks.

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


@runtime_checkable
class Port(Protocol):
    """A robot's side of the bus: the raw integers of a message (units: ``bus.frames.Message``)."""

    @property
    def x_hat_raw(self) -> int:
        """Local estimate to broadcast."""

    @property
    def alpha_raw(self) -> int:
        """Local confidence to broadcast."""

    def receive_all(self, words: Words) -> int:
        """Hand over neighbours' messages in order; returns how many were accepted."""


def port_of(robot: Robot) -> Port:
    """Return ``robot`` itself if it speaks raw integers, else a port that rounds for it."""
    return robot if isinstance(robot, Port) else RoundingPort(robot)


class RoundingPort:
    """The port of a robot that computes in float64: it rounds x_hat to nearest, alpha down as codecs do."""

    def __init__(self, robot: Robot) -> None:
        self._robot = robot

    @property
    def x_hat_raw(self) -> int:
        """Local estimate to broadcast."""
        return round(self._robot.x_hat * ONE)

    @property
    def alpha_raw(self) -> int:
        """Local confidence to broadcast."""
        return alpha_to_word(self._robot.alpha)

    def receive_all(self, words: Words) -> int:
        """Hand over neighbours' messages in order; returns how many were accepted."""
        return sum(self._accepts(*each) for each in words.tolist())

    def _accepts(self, sender: int, x_hat: int, alpha: int) -> bool:
        try:
            return self._robot.receive(sender, x_hat / ONE, word_to_alpha(alpha)) is Status.OK
        except FirmwareError:
            return False
