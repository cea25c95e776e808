"""Transport of frames from robot to robot, over python-can buses or inside this process.

A ``DeliveryQueue`` decides which robot receives which frame, and when. The ``Carrier`` takes the frames of a
tick from their senders, and gets them to their receivers, in one of three ways:

- Inside this process, where no other program can listen.
- Over one bus for all robots. The carrier reads back from the bus what robots send. Another program on the
  bus sees the frames sent.
- Over a bus for each robot. The carrier reads there what the robot sends, and writes there what the robot
  receives. Another program on that bus sees what this robot sees.

On any of these buses robots may also be remote. However frames are carried, a robot receives the same ones in
the same order.
"""

from __future__ import annotations

import time
from collections import Counter, defaultdict, deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import partial
from itertools import groupby

import can
import numpy as np
from numpy.typing import NDArray

from mcp_asdf_tools.bus.frames import Estimate, FrameContent, FrameFormat, decode_frame
from mcp_asdf_tools.robots.bus_robot import BusRobot, estimate_rows
from mcp_asdf_tools.robots.clock import RealTimeClock
from mcp_asdf_tools.robots.node import FrameTaker, send_all
from mcp_asdf_tools.swarm.delivery import Deliveries, FrameKey, SentFrame, key_of

FRAME_TIMEOUT = 2.0
"""Seconds after which a frame that has not arrived counts as lost."""

_BATCH_SIZE = 64
"""Frames sent between two reads: a socket of usual size holds more than 200."""

_MAX_READS_AFTER_DEADLINE = 4096
"""Frames that are read after a deadline. They arrived in time, and waited in the receive buffer only because
this process was slow; but a flood that keeps filling the buffer must not hold up the swarm."""

_MAX_OVERDUE_FRAMES = 1024
"""Missed frames that may still arrive. On a bus that loses frames for days, older ones must not fill the
memory; a frame that comes after so many others have been lost is reported as unexpected."""

_MAX_FRAMES_IN_ERROR = 8
"""Missing frames that an error names."""

OpenBus = Callable[[int], can.BusABC]
"""Opens a connection to the bus of a robot, by id."""

ArrivedFrames = defaultdict[FrameKey, deque[can.Message]]
"""Frames that have arrived and were expected, in the order of their arrival, by identifier and data."""


class SwarmError(RuntimeError):
    """The swarm cannot go on, because the bus has lost a frame."""


@dataclass(frozen=True)
class Wiring:
    """Which robots are on which bus.

    Attributes:
        open_bus: Opens a connection to the bus of a robot. On a shared bus the connection returns what it
            sends, unless the robots are remote. None if there is no bus.
        is_shared: Whether all robots share one bus. Otherwise each has its own.
        remote: Remote robots: all robots on a shared bus, or any of those that have their own.
    """

    open_bus: OpenBus | None = None
    is_shared: bool = True
    remote: frozenset[int] = frozenset()


class ExpectingConnection:
    """Bus connection that waits for frames which are known to be on their way.

    Attributes:
        bus: The python-can bus.
        missed_count: Expected frames that were late or lost so far.
    """

    def __init__(
        self,
        bus: can.BusABC,
        listener: str,
        on_unexpected: FrameTaker = lambda frame: None,
        on_frame: FrameTaker = lambda frame: None,
    ) -> None:
        """Wrap a bus.

        Args:
            bus: The python-can bus.
            listener: Who reads from it, for errors.
            on_unexpected: Called with each frame that was not expected.
            on_frame: Called with every frame, before ``on_unexpected``.
        """
        self.bus = bus
        self.missed_count = 0
        self._listener = listener
        self._on_unexpected = on_unexpected
        self._on_frame = on_frame
        self._overdue: list[SentFrame] = []
        """The last _MAX_OVERDUE_FRAMES frames that earlier calls have missed. They may still arrive."""

    def receive_expected(self, expected: Sequence[SentFrame], timeout: float | None) -> list[SentFrame]:
        """Read until all expected frames have arrived, and return them as they were received.

        They come in the order of ``expected``, whatever the order in which they arrive; of frames that are
        alike, those sent first count as received first. Frames that do not arrive in time count as missed,
        and are overdue in later calls: these return them first, if they arrive meanwhile, but do not wait for
        them. Frames that are neither expected nor overdue are reported as unexpected.

        Args:
            expected: The frames to wait for; none to read only what has arrived, with a timeout of 0.
            timeout: Seconds to wait; None if no frame may be missing.

        Raises:
            SwarmError: If ``timeout`` is None, and a frame is missing after FRAME_TIMEOUT seconds.
        """
        missing_overdue = _count_keys(self._overdue)
        missing_expected = _count_keys(expected)
        arrived: ArrivedFrames = defaultdict(deque)
        for frame in self._frames_within(FRAME_TIMEOUT if timeout is None else timeout):
            key = key_of(frame)
            if missing_overdue[key] > 0:
                missing_overdue[key] -= 1
            elif missing_expected[key] > 0:
                missing_expected[key] -= 1
            else:
                self._on_unexpected(frame)
                continue
            arrived[key].append(frame)
            # An overdue frame may be lost for ever: to wait for it would hold up every later tick.
            if expected and missing_expected.total() == 0:
                break

        late, still_overdue = _split_by_arrival(self._overdue, arrived)
        received, missing = _split_by_arrival(expected, arrived)
        self._overdue = [*still_overdue, *missing][-_MAX_OVERDUE_FRAMES:]
        self.missed_count += len(missing)
        # In lockstep every frame has to arrive, since the run could not be repeated otherwise.
        if missing and timeout is None:
            raise self._loss_error(missing)
        return [*late, *received]

    def _frames_within(self, seconds: float) -> Iterator[can.Message]:
        """Report frames to ``on_frame`` and yield them as they arrive, until the time is over.

        Then up to _MAX_READS_AFTER_DEADLINE frames that wait in the receive buffer are still read.
        """
        deadline = time.monotonic() + seconds
        reads_after_deadline = 0
        while reads_after_deadline < _MAX_READS_AFTER_DEADLINE:
            seconds_left = max(0.0, deadline - time.monotonic())
            if seconds_left == 0.0:
                reads_after_deadline += 1
            frame = self.bus.recv(seconds_left)
            if frame is None:
                return
            self._on_frame(frame)
            yield frame

    def discard_echoes(self) -> None:
        """Empty the receive buffer, which echoes of frames sent here have filled, while nothing is expected.

        If there is another frame behind the echoes, it is reported as unexpected.
        """
        # One read is enough: it skips all echoes that are ahead of another frame or of the buffer's end.
        frame = next(self._frames_within(0), None)
        if frame is not None:
            self._on_unexpected(frame)

    def _loss_error(self, missing: Sequence[SentFrame]) -> SwarmError:
        """Return an error that names some of the missing frames, each identifier once."""
        names: list[str] = []
        for sent_frame in missing[:_MAX_FRAMES_IN_ERROR]:
            name = f"frame {sent_frame.frame.arbitration_id:08X}"
            # Several frames of one robot have one identifier.
            if name not in names:
                names.append(name)
        if len(missing) > _MAX_FRAMES_IN_ERROR:
            names.append("...")
        return SwarmError(
            f"{self._listener} did not hear {', '.join(names)} within {FRAME_TIMEOUT:g} s on "
            f"{self.bus.channel_info}: the bus loses frames; use a faster bus or fewer robots"
        )


def _count_keys(sent_frames: Iterable[SentFrame]) -> Counter[FrameKey]:
    """Return how many of the frames have each identifier and data."""
    return Counter(sent_frame.key for sent_frame in sent_frames)


def _split_by_arrival(
    sent_frames: Sequence[SentFrame], arrived: ArrivedFrames
) -> tuple[list[SentFrame], list[SentFrame]]:
    """Return the frames that have arrived, as they were received, and those that have not; both in order.

    Frames that have arrived are taken out of ``arrived``. Of frames that are alike, the first count as those
    that have arrived.
    """
    received: list[SentFrame] = []
    missing: list[SentFrame] = []
    for sent_frame in sent_frames:
        frames = arrived.get(sent_frame.key)  # which adds no entry for a frame that has not arrived
        if frames:
            received.append(replace(sent_frame, frame=frames.popleft()))
        else:
            missing.append(sent_frame)
    return received, missing


class Carrier:
    """Transport of the frames of a swarm: in each tick ``send``, then ``deliver``.

    Attributes:
        bus_connections: The connection over which the carrier reads and writes on the bus of each robot, by
            robot id. On a shared bus it is the same one for all robots. Empty without a bus.
    """

    def __init__(
        self, robots: Iterable[BusRobot], frame_format: FrameFormat, clock: RealTimeClock | None
    ) -> None:
        """Create a carrier without a bus.

        Args:
            robots: The robots between which it carries frames, by rising id.
            frame_format: Format of the robots' estimates.
            clock: Limits how long a tick waits for frames; without a clock it waits for all of them.
        """
        self.bus_connections: dict[int, ExpectingConnection] = {}
        self._robots = {robot.id: robot for robot in robots}
        self._frame_format = frame_format
        self._clock = clock
        self._on_frame_without_bus: FrameTaker = lambda frame: None
        """Called with every frame that is sent; with a bus it does nothing."""
        self._has_bus_per_robot = False
        self._robot_connections: dict[int, ExpectingConnection] = {}
        """The connections of robots in this process, by id: on a shared bus the carrier's."""
        self._open_buses = ExitStack()

    def join(self, wiring: Wiring, on_frame: FrameTaker) -> None:
        """Open the buses of ``wiring``, which may be one for all robots, one for each, or none.

        The carrier gets a connection to each bus. A robot in this process gets a second connection to a bus
        of its own, and sends over the carrier's connection on a shared bus. A remote robot is connected where
        it runs.

        ``on_frame`` is called with every frame that a robot sends: without a bus when it is sent, otherwise
        when the carrier reads it. Raises what ``wiring.open_bus`` raises; no bus is left open then.
        """
        if wiring.open_bus is None:
            self._on_frame_without_bus = on_frame
            return
        self._has_bus_per_robot = not wiring.is_shared
        robots = list(self._robots)
        robots_by_bus = [robots] if wiring.is_shared else [[robot] for robot in robots]
        try:
            for robots_of_bus in robots_by_bus:
                carrier_connection = self._connect_carrier(robots_of_bus, wiring.open_bus, on_frame)
                self.bus_connections |= dict.fromkeys(robots_of_bus, carrier_connection)
            for robot in robots:
                if robot not in wiring.remote:
                    self._robot_connections[robot] = self._connect_robot(robot, wiring.open_bus)
        except BaseException:
            self.close()  # the buses that were opened before another could not be
            raise

    def _connect_carrier(
        self, robots: Sequence[int], open_bus: OpenBus, on_frame: FrameTaker
    ) -> ExpectingConnection:
        """Return the carrier's connection to the bus of ``robots``, which count other nodes' frames there.

        ``on_frame`` is called with every frame that the carrier reads there.
        """
        any_robot = robots[0]  # all of them have the same bus
        bus = self._open_buses.enter_context(open_bus(any_robot))
        on_unexpected = partial(self._count_foreign_frame, robots)
        return ExpectingConnection(bus, "the carrier", on_unexpected, on_frame)

    def _connect_robot(self, robot: int, open_bus: OpenBus) -> ExpectingConnection:
        """Return the connection of a robot in this process, which is the carrier's on a shared bus."""
        if not self._has_bus_per_robot:
            return self.bus_connections[robot]
        bus = self._open_buses.enter_context(open_bus(robot))
        return ExpectingConnection(bus, f"robot {robot}")

    def _count_foreign_frame(self, robots: Sequence[int], frame: can.Message) -> None:
        """Let robots count a frame from outside the swarm."""
        content = decode_frame(frame, self._frame_format)
        for robot in robots:
            self._robots[robot].count_foreign_content(content)

    def send(self, sent_frames: Iterable[SentFrame], tick: int) -> list[SentFrame]:
        """Put the frames of a tick on the buses of their senders, and return them as the carrier reads them.

        They keep their order. Late ones are missing, and follow in a later call. A remote sender has sent its
        frames itself, and its driver has read them: they are returned as they are, as all frames are without
        a bus. Raises can.CanError if a bus does not take a frame, and SwarmError if a frame is lost in a
        swarm without a clock, where none may be missing.
        """
        frames_on_buses: list[SentFrame] = []
        # Frames that follow each other on one bus are sent together; the order of all frames is kept.
        for robot_connection, group in groupby(sent_frames, self._connection_of_sender):
            frames = list(group)
            if robot_connection is not None:
                carrier_connection = self.bus_connections[frames[0].sender]
                frames = self._pass_over_bus(frames, robot_connection, carrier_connection, tick)
            else:
                for sent_frame in frames:
                    self._on_frame_without_bus(sent_frame.frame)
            frames_on_buses += frames
        return frames_on_buses

    def _connection_of_sender(self, sent_frame: SentFrame) -> ExpectingConnection | None:
        """Return the connection of the robot that sends a frame; None without a bus, and if it is remote."""
        return self._robot_connections.get(sent_frame.sender)

    def _pass_over_bus(
        self,
        sent_frames: Sequence[SentFrame],
        source: ExpectingConnection,
        target: ExpectingConnection,
        tick: int,
    ) -> list[SentFrame]:
        """Write frames over one connection to a bus, and return those that are read over another one.

        Late ones are missing, and follow in a later call. Both connections may be the same. Raises
        can.CanError if the bus does not take a frame, and SwarmError if a frame is lost in a swarm without a
        clock, where none may be missing.
        """
        received: list[SentFrame] = []
        # The frames are sent in batches that fit into receive buffers.
        for start in range(0, len(sent_frames), _BATCH_SIZE):
            batch = sent_frames[start : start + _BATCH_SIZE]
            send_all(source.bus, [sent_frame.frame for sent_frame in batch], FRAME_TIMEOUT)
            timeout = None if self._clock is None else self._clock.seconds_left_to_receive(tick)
            received += target.receive_expected(batch, timeout)
            if len(batch) == _BATCH_SIZE:
                # Fewer echoes do no harm in the buffer of the source, which skips them when it reads next.
                source.discard_echoes()
        return received

    def deliver(self, deliveries: Deliveries, tick: int) -> None:
        """Let each robot receive its frames of this tick: its estimates in one array, then its other frames.

        A robot with a bus of its own receives them there, and late ones in a later call. Other robots get
        them inside this process, where a frame is decoded once, however many robots receive it. Raises
        can.CanError if a bus does not take a frame, and SwarmError if a frame is lost in a swarm without a
        clock, where none may be missing.
        """
        if self._has_bus_per_robot:
            self._deliver_over_buses(deliveries, tick)
            return
        contents = [
            decode_frame(sent_frame.frame, self._frame_format) for sent_frame in deliveries.sent_frames
        ]
        is_estimate = np.array([isinstance(content, Estimate) for content in contents], np.bool_)
        estimates = estimate_rows(contents)
        receivers_of_estimates = deliveries.receivers[is_estimate]
        for robot in self._robots.values():
            robot.receive_all(estimates[receivers_of_estimates[:, robot.id]])
        # The others, such as heartbeats, are few, so that they are handed over one by one.
        for content, is_receiver in zip(contents, deliveries.receivers, strict=True):
            if not isinstance(content, Estimate):
                self._count_content(content, is_receiver)

    def _count_content(self, content: FrameContent, is_receiver: NDArray[np.bool_]) -> None:
        """Let the receivers of a frame count its content.

        Robot i is a receiver if entry i of ``is_receiver`` is true.
        """
        is_receiver_by_id = is_receiver.tolist()  # which takes less time than to index the array
        for robot in self._robots.values():
            if is_receiver_by_id[robot.id]:
                robot.count_content(content)

    def _deliver_over_buses(self, deliveries: Deliveries, tick: int) -> None:
        """Let each robot receive its frames of this tick over its own bus. Raises what ``deliver`` raises."""
        for robot_id, robot in self._robots.items():
            frames = deliveries.frames_for(robot_id)
            carrier_connection = self.bus_connections[robot_id]
            robot_connection = self._robot_connections.get(robot_id)
            if robot_connection is None:
                # A remote robot reads for itself: its counterpart in this process gets what was sent.
                send_all(carrier_connection.bus, [sent_frame.frame for sent_frame in frames], FRAME_TIMEOUT)
            elif frames:
                frames = self._pass_over_bus(frames, carrier_connection, robot_connection, tick)
            else:
                # Echoes of what the robot has sent must not fill its receive buffer while it hears nobody.
                frames = robot_connection.receive_expected([], timeout=0)
            robot.receive_frames([sent_frame.frame for sent_frame in frames])

    @property
    def missed_count(self) -> int:
        """Frames so far that a bus did not carry in time.

        On a shared bus all robots have the same connection, which counts once.
        """
        connections = {*self._robot_connections.values(), *self.bus_connections.values()}
        return sum(connection.missed_count for connection in connections)

    def close(self) -> None:
        """Close all buses."""
        self._open_buses.close()
