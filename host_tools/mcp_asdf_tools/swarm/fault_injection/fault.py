"""What all kinds of faults have in common: rate and schedule, and the points at which they act."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, ClassVar

from mcp_asdf_tools.common.parameters import parameter
from mcp_asdf_tools.robots.robot_setup import format_ids

if TYPE_CHECKING:
    import can

    from mcp_asdf_tools.swarm.delivery import Deliveries, SentFrame
    from mcp_asdf_tools.swarm.fault_injection.fault_run import FaultRun

MAX_TICK = 2**32 - 1

OPTION_OF_FIELD = {"start": "from", "stop": "to"}
"""Options of a fault's text whose names differ from the field's: ``from`` is a word of Python."""


@dataclass(frozen=True)
class Outage:
    """State of a node in a tick in which a fault keeps it off the bus.

    Attributes:
        stops_robot: Whether the robot is dead, too. Otherwise it goes on, and only its bus is cut.
        loses_state: Whether a dead robot starts anew when it rejoins.
    """

    stops_robot: bool
    loses_state: bool = False


@dataclass(frozen=True, kw_only=True)
class Fault:
    """A configured disturbance of nodes or frames; each kind is a subclass.

    A fault never changes. What it needs to remember in a run is in its ``FaultRun``. A kind overrides one or
    two of the methods ``on_tick``, ``extra_frames``, ``on_send`` and ``on_delivery``, which do nothing here.

    Attributes:
        rate: Probability of a hit at each occasion: a tick of a node, or a frame, or a frame at a receiver.
        start: First tick in which it is active.
        stop: First tick in which it is not active any more; None if it does not end.
        robots: Nodes that it affects, or the senders of the frames, under any id they use; None for all.
        name: Name of the kind in texts.
        summary: What one hit does, for the help.
        sends_before_others: Whether ``extra_frames`` precede all other frames of a tick, or follow them.
    """

    name: ClassVar[str]
    summary: ClassVar[str]
    sends_before_others: ClassVar[bool] = False

    rate: float = parameter("probability at each occasion", 0, 1, default=1.0)
    start: int = parameter("first tick", 0, MAX_TICK, default=0)
    stop: int | None = parameter("first tick after, if it ends", 0, MAX_TICK, default=None)
    robots: frozenset[int] | None = None

    @property
    def named_robots(self) -> frozenset[int]:
        """Ids of all nodes that the options name; empty for a fault of all nodes."""
        return self.robots or frozenset()

    def check(self) -> None:
        """Raise UsageError if an option is missing that the kind of fault needs."""

    def on_tick(self, node: int, tick: int, run: FaultRun) -> Outage | None:
        """Return how the fault keeps ``node`` off the bus in this tick; None if it does not.

        Called once for each node and tick, with rising ticks.
        """
        return None

    def extra_frames(self, node: int, tick: int, timestamp: float, run: FaultRun) -> list[can.Message]:
        """Return frames that ``node`` sends in this tick besides its own, stamped ``timestamp`` (seconds).

        Called once for each tick and node that is on the bus.
        """
        return []

    def on_send(self, sent_frame: SentFrame, run: FaultRun) -> SentFrame:
        """Return the frame that gets onto the bus in place of ``sent_frame``, or ``sent_frame`` itself.

        Called once for each frame, in the order in which they are sent.
        """
        return sent_frame

    def on_delivery(self, deliveries: Deliveries, run: FaultRun) -> list[Deliveries]:
        """Return the deliveries that take the place of ``deliveries``."""
        return [deliveries]

    def is_active(self, tick: int, node: int) -> bool:
        """Return whether the fault may hit ``node`` in this tick.

        It may from tick ``start`` on and before tick ``stop``, if ``robots`` has the node. None as ``stop``
        stands for no end, and None as ``robots`` for all nodes.
        """
        has_ended = self.stop is not None and tick >= self.stop
        is_affected = self.robots is None or node in self.robots
        return tick >= self.start and not has_ended and is_affected

    @classmethod
    def own_options(cls) -> list[str]:
        """Return the names of the options that this kind has besides those of all faults."""
        common_options = {option_field.name for option_field in fields(Fault)}
        all_options = [option_field.name for option_field in fields(cls)]
        return [option for option in all_options if option not in common_options]

    def __str__(self) -> str:
        """Return the text that ``parse_fault`` reads back: the rate, and all options but the defaults.

        The rate is written by repr(), which has all the digits of a float that the same fault needs.
        """
        option_texts = [f"{self.name}={self.rate!r}"]
        for option_field in fields(self):
            value = getattr(self, option_field.name)
            if option_field.name != "rate" and value != option_field.default:
                option = OPTION_OF_FIELD.get(option_field.name, option_field.name)
                option_texts.append(f"{option}={_option_text(value)}")
        return ",".join(option_texts)


def _option_text(value: object) -> str:
    """Return the value of an option as a fault's text has it.

    A set of ids becomes a text such as ``0+3-5``, a text stays as it is, and a number gets all its digits.
    """
    if isinstance(value, frozenset):
        return format_ids(value)
    return value if isinstance(value, str) else repr(value)
