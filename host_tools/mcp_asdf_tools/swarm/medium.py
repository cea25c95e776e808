"""Media that carry frames from robot to robot over python-can buses.

``Air`` decides which frames each robot hears, and when. A medium passes them over real connections:

- ``SharedBus``: all robots are on one bus, which hands every frame to all of them, and each robot's radio
  passes those that the air lets through. Another program on the bus sees the frames sent.
- ``RemoteBus``: the same with robots that are not in this process.
- ``ChannelPerRobot``: every robot has a bus to itself, with the medium at its other end, which reads the
  robot's frames and writes those that it hears. Another program on that bus sees what this robot sees.

- ``InProcess``, in a module of its own, hands frames over without a bus.

With each of them a robot hears the same frames in the same order.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Protocol

import can
import numpy as np
from numpy.typing import NDArray

from mcp_asdf_tools.robots import Clock, FrameTaker
from mcp_asdf_tools.swarm.air import Air, Hearer
from mcp_asdf_tools.swarm.connection import Connection
from mcp_asdf_tools.swarm.faults import SentFrame

OpenBus = Callable[[int], can.BusABC]
"""Joins the bus of a robot, by id."""


@dataclass(frozen=True)
class Wiring:
    """Assignment of robots to buses.

    Attributes:
        open_bus: Joins the bus of a robot. None for no bus: robots of this process that nothing else hears.
        is_shared: Whether that is one bus for all, else every robot has its own.
        remote: Robots that run elsewhere: all of those on a shared bus, or any that have their own.
        channel: Name of the bus in logs where there is none.
    """

    open_bus: OpenBus | None = None
    is_shared: bool = True
    remote: frozenset[int] = frozenset()
    channel: str = ""

    def join(self, robot: int) -> can.BusABC:
        """A connection to the bus of a robot. Fails if there is no bus."""
        assert self.open_bus is not None
        return self.open_bus(robot)


class Medium(Protocol):
    """Carries frames. A context manager: leaving it closes the buses."""

    def send(self, sent: SentFrame) -> None:
        """Let the sender put a frame on its bus. Raises can.CanError if the bus does not take it."""

    def carry(self, tick: int) -> None:
        """Let every robot hear its frames of this tick, after all have sent.

        Raises SwarmError if a bus loses a frame and the clock waits for it. ``send`` may raise it, too.
        """

    @property
    def missed(self) -> int:
        """Frames that a bus did not bring in time so far."""

    def __enter__(self) -> Medium: ...

    def __exit__(self, *_: object) -> None: ...


class SharedBus:
    """All robots on one bus. O(robots) a frame."""

    def __init__(
        self, hearers: Sequence[Hearer], air: Air, wiring: Wiring, clock: Clock, log: FrameTaker | None
    ) -> None:
        """Let every robot join. With ``log`` one more connection does, and hands over every frame."""
        self._hearers = hearers
        self._air = air
        self._clock = clock
        with ExitStack() as stack:
            buses = [stack.enter_context(wiring.join(robot)) for robot in range(len(hearers))]
            log_bus = None if log is None else stack.enter_context(wiring.join(0))
            self._stack = stack.pop_all()
        self._radios = [
            Connection(bus, f"robot {robot}", "robot {0.sender}", hearer.hear_stranger)
            for robot, (bus, hearer) in enumerate(zip(buses, hearers, strict=True))
        ]
        self._logs = [] if log_bus is None else [Connection(log_bus, "the log", _FRAME, every=log)]
        self._come: list[list[SentFrame]] = [[] for _ in hearers]
        self._sent: list[SentFrame] = []
        self._unread: list[SentFrame] = []

    def send(self, sent: SentFrame) -> None:
        """Let the sender put a frame on the bus."""
        self._radios[sent.sender].send(sent.frame)
        self._sent.append(sent)
        self._unread.append(sent)
        if len(self._unread) == _BATCH:
            self._read(sent.tick)

    def _read(self, tick: int) -> None:
        """Let every robot read the frames sent."""
        unread, self._unread = self._unread, []
        for inbox in self._logs:
            inbox.take(unread, self._clock.patience(tick))
        for robot, (radio, come) in enumerate(zip(self._radios, self._come, strict=True)):
            others = [each for each in unread if each.sender != robot]
            come.extend(radio.take(others, self._clock.patience(tick)))

    def carry(self, tick: int) -> None:
        """Let every robot hear those frames that the air lets through."""
        self._read(tick)
        sent, self._sent = self._sent, []
        arrivals = self._air.arrivals(tick, *_together(sent, self._come))
        for robot, (hearer, come) in enumerate(zip(self._hearers, self._come, strict=True)):
            hearer.hear(*arrivals.of(robot))
            come.clear()

    @property
    def missed(self) -> int:
        """Frames that the bus did not bring in time so far."""
        return sum(each.missed for each in self._radios)

    def __enter__(self) -> SharedBus:
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()


class RemoteBus:
    """Robots that are all elsewhere and on one bus, where they hear each other directly.

    Attributes:
        end: The connection that commands them.
    """

    missed = 0

    def __init__(self, hearers: Sequence[Hearer], air: Air, wiring: Wiring) -> None:
        self.end = wiring.join(0)
        self._hearers = hearers
        self._air = air
        self._sent: list[SentFrame] = []

    def send(self, sent: SentFrame) -> None:
        """Note a frame that is on the bus already."""
        self._sent.append(sent)

    def carry(self, tick: int) -> None:
        """Pass each robot's local half the frames that the robot hears."""
        sent, self._sent = self._sent, []
        arrivals = self._air.arrivals(tick, sent)
        for robot, hearer in enumerate(self._hearers):
            hearer.hear(*arrivals.of(robot))

    def __enter__(self) -> RemoteBus:
        return self

    def __exit__(self, *_: object) -> None:
        self.end.shutdown()


class ChannelPerRobot:
    """A bus for every robot, and the medium between them. O(robots) a frame.

    Attributes:
        ends: The medium's connection to each robot's bus, by id.
    """

    def __init__(
        self, hearers: Sequence[Hearer], air: Air, wiring: Wiring, clock: Clock, log: FrameTaker | None
    ) -> None:
        """Let the medium join every robot's bus, and local robots their own.

        ``log`` takes the frames of those.
        """
        self._hearers = hearers
        self._air = air
        self._clock = clock
        with ExitStack() as stack:
            join = wiring.join
            ends = [stack.enter_context(join(robot)) for robot in range(len(hearers))]
            here = [robot for robot in range(len(hearers)) if robot not in wiring.remote]
            radios = [stack.enter_context(join(robot)) for robot in here]
            self._stack = stack.pop_all()
        self.ends = [Connection(end, "the medium", "robot {0.sender}", every=log) for end in ends]
        self._radios = {
            robot: Connection(bus, f"robot {robot}", _FRAME, hearers[robot].hear_stranger)
            for robot, bus in zip(here, radios, strict=True)
        }
        self._come: list[SentFrame] = []

    def send(self, sent: SentFrame) -> None:
        """Let a local sender put a frame on its bus, and read the frame there."""
        radio = self._radios.get(sent.sender)
        if radio is None:
            self._come.append(sent)
            return
        radio.send(sent.frame)
        self._come += self.ends[sent.sender].take([sent], self._clock.patience(sent.tick))
        if len(self._come) % _BATCH == 0:
            radio.drain(_BATCH)

    def carry(self, tick: int) -> None:
        """Write on each robot's bus the frames that the air lets through, and let it read them."""
        come, self._come = self._come, []
        arrivals = self._air.arrivals(tick, come)
        for robot, hearer in enumerate(self._hearers):
            frames = arrivals.of(robot)
            for start in range(0, len(frames), _BATCH):
                hearer.hear(*self._pass_on(robot, frames[start : start + _BATCH], tick))

    def _pass_on(self, robot: int, frames: Sequence[can.Message], tick: int) -> Sequence[can.Message]:
        """Put ``frames`` on the robot's bus; returns what it reads there."""
        radio, end = self._radios.get(robot), self.ends[robot]
        if radio is None:
            # An error frame is a driver's report: it cannot be sent on a real bus.
            frames = [frame for frame in frames if not frame.is_error_frame]
        for frame in frames:
            end.send(frame)
        if radio is None:
            return frames
        carried = [SentFrame(frame, robot, tick) for frame in frames]
        heard = radio.take(carried, self._clock.patience(tick))
        if len(frames) == _BATCH:
            end.drain(_BATCH)
        return [each.frame for each in heard]

    @property
    def missed(self) -> int:
        """Frames that the buses did not bring in time so far."""
        return sum(each.missed for each in [*self._radios.values(), *self.ends])

    def __enter__(self) -> ChannelPerRobot:
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()


def _together(
    sent: Sequence[SentFrame], come: Sequence[Sequence[SentFrame]]
) -> tuple[list[SentFrame], NDArray[np.bool_]]:
    """Frames of earlier ticks that came at last, then those ``sent``; and whether one came at a robot."""
    in_time = {id(each) for each in sent}
    late = {id(each): each for frames in come for each in frames if id(each) not in in_time}
    frames = [*late.values(), *sent]
    places = {id(each): place for place, each in enumerate(frames)}
    came = np.zeros((len(frames), len(come)), np.bool_)
    for robot, each in enumerate(come):
        came[[places[id(frame)] for frame in each], robot] = True
    return frames, came


_FRAME = "frame {0.frame.arbitration_id:08X}"

_BATCH = 64
"""Frames sent between two reads: a socket of usual size holds more than 200."""
