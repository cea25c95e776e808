"""Carrier of frames from robot to robot, over python-can buses or inside this process.

``Delivery`` decides which frames each robot hears, and when. The ``Carrier`` brings them there:

- inside this process where no other program can listen;
- over one bus: what robots send is on it, and comes back to the one connection of all. Another program on the
  bus sees the frames sent;
- over a bus for every robot: the carrier reads there what the robot sends, and writes what it hears. Another
  program on that bus sees what this robot sees.

Robots may also run elsewhere, on any of these buses. However frames are carried, a robot hears the same ones
in the same order.
"""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from itertools import groupby

import can
import numpy as np
from numpy.typing import NDArray

from mcp_asdf_tools.bus.frame_arrays import decode_estimates
from mcp_asdf_tools.bus.frame_layout import Rejection
from mcp_asdf_tools.bus.frames import FrameContent, FrameFormat, decode_frame
from mcp_asdf_tools.robots.bus_robot import BusRobot
from mcp_asdf_tools.robots.clock import RealTimeClock
from mcp_asdf_tools.robots.node import FrameTaker
from mcp_asdf_tools.swarm.delivery import Delivery, Paths, SentFrame, content_of

TIMEOUT = 2.0
"""Seconds after which a frame that has not come counts as lost."""

_BATCH = 64
"""Frames sent between two reads: a socket of usual size holds more than 200."""

_MOST_LATE = 4096
"""Frames read once the time is over: the queue counts, but a flood must not keep the swarm listening."""

OpenBus = Callable[[int], can.BusABC]
"""Joins the bus of a robot, by id."""


class SwarmError(RuntimeError):
    """The swarm cannot go on: the bus lost a frame."""


@dataclass(frozen=True)
class Wiring:
    """Assignment of robots to buses.

    Attributes:
        open_bus: Joins the bus of a robot. A connection to one bus for all returns what it sends, unless the
            robots run elsewhere. None for no bus: robots of this process that nothing else hears.
        is_shared: Whether that is one bus for all, else every robot has its own.
        remote: Robots that run elsewhere: all of those on a shared bus, or any that have their own.
        channel: Name of the bus in logs where there is none.
    """

    open_bus: OpenBus | None = None
    is_shared: bool = True
    remote: frozenset[int] = frozenset()
    channel: str = ""


class Connection:
    """Bus connection that tracks the frames it expects.

    Attributes:
        bus: The connection.
        missed: Expected frames that were late or lost so far.
    """

    def __init__(
        self,
        bus: can.BusABC,
        who: str,
        stranger: FrameTaker = lambda frame: None,
        every: FrameTaker | None = None,
    ) -> None:
        """``stranger`` takes each unexpected frame, ``every`` all frames; errors name ``who`` listens."""
        self.bus = bus
        self.missed = 0
        self._who = who
        self._stranger = stranger
        self._every = every
        self._late: list[SentFrame] = []

    def take(self, expected: Sequence[SentFrame], patience: float | None) -> Sequence[SentFrame]:
        """Read until all ``expected`` have come, or for ``patience`` seconds; returns those that have.

        They are in the order given, after late ones of earlier calls. Raises SwarmError if one is missing
        after TIMEOUT seconds and ``patience`` is None. O(frames on the bus).
        """
        wanted = [*self._late, *expected]
        self._late = self._read(wanted, TIMEOUT if patience is None else patience)
        if not self._late:
            return wanted
        if patience is None:
            raise self._error(self._late)
        self.missed += sum(each in expected for each in self._late)
        return [each for each in wanted if each not in self._late]

    def _read(self, wanted: Sequence[SentFrame], seconds: float) -> list[SentFrame]:
        """Read until all ``wanted`` have come or the time is over; returns those that are missing.

        Of frames that are the same those sent last are.
        """
        left, deadline, late = list(wanted), time.monotonic() + seconds, 0
        while left and late < _MOST_LATE:
            seconds = max(0.0, deadline - time.monotonic())
            late += seconds == 0.0
            frame = self.bus.recv(seconds)
            if frame is None:
                break
            self._sort(frame, left)
        return left

    def _sort(self, frame: can.Message, left: list[SentFrame]) -> None:
        """Take a frame off ``left``, or hand over a stranger. It is mostly the first."""
        if self._every is not None:
            self._every(frame)
        for place, each in enumerate(left):
            if each.frame is frame or content_of(each.frame) == content_of(frame):
                del left[place]
                return
        self._stranger(frame)

    def drain(self) -> None:
        """Read a frame that nothing waits for, if one has come, and the echoes of sent ones before it."""
        frame = self.bus.recv(0)
        if frame is not None:
            self._sort(frame, [])

    def _error(self, missing: Sequence[SentFrame]) -> SwarmError:
        names = ", ".join(dict.fromkeys(f"frame {each.frame.arbitration_id:08X}" for each in missing[:8]))
        return SwarmError(
            f"{self._who} did not hear {names}{', ...' * (len(missing) > 8)} within {TIMEOUT:g} s on "
            f"{self.bus.channel_info}: the bus loses frames; use a faster bus or fewer robots"
        )


class Carrier:
    """Carries frames.

    Attributes:
        ends: The carrier's own connection to the bus of each robot, by id; none without a bus.
    """

    def __init__(
        self, robots: Sequence[BusRobot], delivery: Delivery, frames: FrameFormat, clock: RealTimeClock | None
    ) -> None:
        """Carry between these robots, which hear ``frames`` as estimates; without a clock wait for all."""
        self.ends: dict[int, Connection] = {}
        self._robots = robots
        self._delivery = delivery
        self._frames = frames
        self._clock = clock
        self._log: FrameTaker = lambda frame: None
        self._has_own_buses = False
        self._radios: dict[int, Connection] = {}
        self._sent: list[SentFrame] = []
        self._come: list[SentFrame] = []
        self._stack = ExitStack()

    def join(self, wiring: Wiring, log: FrameTaker | None = None) -> None:
        """Join the buses, for the robots here and for the carrier. Fails as ``wiring.open_bus``.

        ``log`` takes every frame that robots send.
        """
        everyone = range(len(self._robots))
        if wiring.open_bus is None:
            self._log = log or self._log
            return
        self._has_own_buses = not wiring.is_shared
        with ExitStack() as stack:
            for members in [everyone] if wiring.is_shared else [[robot] for robot in everyone]:
                first = members[0]
                bus = stack.enter_context(wiring.open_bus(first))
                end = Connection(bus, "the carrier", partial(self._meet, members), log)
                self.ends |= dict.fromkeys(members, end)
                if first not in wiring.remote:
                    own = None if wiring.is_shared else stack.enter_context(wiring.open_bus(first))
                    radio = end if own is None else Connection(own, f"robot {first}")
                    self._radios |= dict.fromkeys(members, radio)
            self._stack = stack.pop_all()

    def _meet(self, robots: Sequence[int], stranger: can.Message) -> None:
        """Let these robots hear a frame from outside the swarm."""
        for robot in robots:
            self._robots[robot].hear_stranger(stranger)

    def send(self, sent: SentFrame) -> None:
        """Let the sender put a frame on its bus; that of a robot elsewhere is there already.

        Raises can.CanError if the bus does not take it, and as ``carry``.
        """
        self._log(sent.frame)
        radio = self._radios.get(sent.sender)
        if radio is not None:
            radio.bus.send(sent.frame, timeout=TIMEOUT)
        self._sent.append(sent)
        if len(self._sent) == _BATCH:
            self._read(sent.tick)
            if radio is not None:
                radio.drain()

    def _read(self, tick: int) -> None:
        """Let the carrier read the frames sent, in order, from all buses of robots that are here."""
        sent, self._sent = self._sent, []
        for end, frames in groupby(sent, self._end_of):
            expected = list(frames)
            self._come += end.take(expected, self._patience(tick)) if end is not None else expected

    def _patience(self, tick: int) -> float | None:
        return None if self._clock is None else self._clock.patience(tick)

    def _end_of(self, sent: SentFrame) -> Connection | None:
        """The connection at which the carrier hears the sender; None where it knows the frame already."""
        return self.ends[sent.sender] if sent.sender in self._radios else None

    def carry(self, tick: int) -> None:
        """Let every robot hear its frames of this tick, after all have sent.

        Raises SwarmError if a bus loses a frame and the clock waits for it.
        """
        self._read(tick)
        come, self._come = self._come, []
        arrivals = self._delivery.arrivals(tick, come)
        if not self._has_own_buses:
            self._hand_over(arrivals)
            return
        for robot, hearer in enumerate(self._robots):
            frames = arrivals.of(robot)
            for start in range(0, len(frames), _BATCH):
                hearer.listen(self._pass_on(robot, frames[start : start + _BATCH], tick))

    def _pass_on(self, robot: int, frames: Sequence[can.Message], tick: int) -> Sequence[can.Message]:
        """Put ``frames`` on the robot's bus; returns what it reads there."""
        radio, end = self._radios.get(robot), self.ends[robot]
        for frame in frames:
            end.bus.send(frame, timeout=TIMEOUT)
        if radio is None:
            return frames
        heard = radio.take([SentFrame(frame, robot, tick) for frame in frames], self._patience(tick))
        if len(frames) == _BATCH:
            end.drain()
        return [each.frame for each in heard]

    def _hand_over(self, arrivals: Paths) -> None:
        """Let each robot receive all of its estimates at once, decoded once for all, and count the rest."""
        sent = [each.frame for each in arrivals.sent]
        decoded = decode_estimates(sent, self._frames, arrivals.flips)
        is_estimate = decoded.is_estimate
        reach = arrivals.reach[is_estimate]
        heard = decoded.rows[is_estimate][reach.T.nonzero()[1]]
        ends = np.count_nonzero(reach, axis=0).cumsum().tolist()
        for robot, start, end in zip(self._robots, [0, *ends], ends, strict=False):
            robot.receive(heard[start:end])
        if not is_estimate.all():
            self._count(arrivals, np.flatnonzero(~is_estimate))

    def _count(self, arrivals: Paths, others: NDArray[np.intp]) -> None:
        """Let each robot count the ``others`` among its frames, those that are no estimates."""
        kinds: dict[Rejection | type, list[tuple[int, FrameContent]]] = defaultdict(list)
        for number in others.tolist():
            content = decode_frame(arrivals.frame(number), self._frames)
            kinds[content if isinstance(content, Rejection) else type(content)].append((number, content))
        for found in kinds.values():
            heard = np.count_nonzero(arrivals.reach[[number for number, _ in found]], axis=0)
            for robot in heard.nonzero()[0].tolist():
                self._robots[robot].count(found[0][1], int(heard[robot]))

    @property
    def missed(self) -> int:
        """Frames that a bus did not bring in time so far."""
        return sum(each.missed for each in {*self._radios.values(), *self.ends.values()})

    def close(self) -> None:
        """Leave the buses."""
        self._stack.close()
