"""Transport of frames from robot to robot, over python-can buses or inside this process.

A ``DeliveryQueue`` decides which robot receives which frame, and when. The ``Carrier`` gets the frames there
in one of three ways:

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
from collections import defaultdict, deque
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import partial
from itertools import groupby

import can
import numpy as np
from numpy.typing import NDArray

from mcp_asdf_tools.bus.frames import Estimate, FrameContent, FrameFormat, decode_frame
from mcp_asdf_tools.robots.bus_robot import BusRobot, EstimateRows, estimate_rows
from mcp_asdf_tools.robots.clock import RealTimeClock
from mcp_asdf_tools.robots.node import FrameTaker, send_all
from mcp_asdf_tools.swarm.delivery import Deliveries, DeliveryQueue, ReceiverMask, SentFrame

FRAME_TIMEOUT = 2.0
"""Seconds after which a frame that has not arrived counts as lost."""

_BATCH_SIZE = 64
"""Frames sent between two reads: a socket of usual size holds more than 200."""

_MAX_READS_AFTER_DEADLINE = 4096
"""Frames that are read after a deadline. They arrived in time, and waited in the receive buffer only because
this process was slow; but a flood that keeps filling the buffer must not hold up the swarm."""

_MAX_FRAMES_IN_ERROR = 8
"""Missing frames that an error names."""

OpenBus = Callable[[int], can.BusABC]
"""Opens a connection to the bus of a robot, by id."""


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
        """Frames that earlier calls have missed. They may still arrive."""

    def receive_expected(self, expected: Sequence[SentFrame], timeout: float | None) -> list[SentFrame]:
        """Read until all expected and overdue frames have arrived, and return them as they were received.

        Overdue frames come first, then the others in the order of ``expected``, whatever the order in which
        they arrive. Frames that do not arrive in time count as missed, and are overdue in the next call.

        Args:
            expected: The frames to wait for.
            timeout: Seconds to wait; None if no frame may be missing.

        Raises:
            SwarmError: If ``timeout`` is None, and a frame is missing after FRAME_TIMEOUT seconds.
        """
        awaited = [*self._overdue, *expected]
        seconds = FRAME_TIMEOUT if timeout is None else timeout
        received = self._read_awaited(awaited, seconds)
        missing = [sent_frame for index, sent_frame in enumerate(awaited) if index not in received]
        # In lockstep every frame has to arrive, since the run could not be repeated otherwise.
        if missing and timeout is None:
            raise self._loss_error(missing)
        # An earlier call has counted the overdue frames, which are the first of those awaited.
        for index in range(len(self._overdue), len(awaited)):
            if index not in received:
                self.missed_count += 1
        self._overdue = missing
        return [received[index] for index in sorted(received)]

    def _read_awaited(self, awaited: Sequence[SentFrame], seconds: float) -> dict[int, SentFrame]:
        """Read until all awaited frames have arrived, or the time is over.

        Returns those that have arrived, with the frame as it was received, by their index in ``awaited``.
        Others that arrive meanwhile are reported as unexpected. Of frames that are alike, those sent first
        count as received first.
        """
        received: dict[int, SentFrame] = {}
        if not awaited:  # nothing is read then
            return received
        missing_indices = _indices_by_content(awaited)
        for frame in self._frames_within(seconds):
            # get() does not add an entry for a frame that nobody expects, of which there may be many.
            indices = missing_indices.get(_identifier_and_data(frame))
            if not indices:
                self._on_unexpected(frame)
                continue
            index = indices.popleft()
            received[index] = replace(awaited[index], frame=frame)
            if len(received) == len(awaited):
                break
        return received

    def _frames_within(self, seconds: float) -> Iterator[can.Message]:
        """Yield frames as they arrive, until the time is over.

        Then up to _MAX_READS_AFTER_DEADLINE frames that wait in the receive buffer are still read.
        """
        deadline = time.monotonic() + seconds
        reads_after_deadline = 0
        while reads_after_deadline < _MAX_READS_AFTER_DEADLINE:
            seconds_left = max(0.0, deadline - time.monotonic())
            if seconds_left == 0.0:
                reads_after_deadline += 1
            frame = self._read_frame(seconds_left)
            if frame is None:
                return
            yield frame

    def discard_echoes(self) -> None:
        """Empty the receive buffer, which echoes of frames sent here have filled, while nothing is expected.

        If there is another frame behind the echoes, it is reported as unexpected.
        """
        # One read is enough: it skips all echoes that are ahead of another frame or of the buffer's end.
        frame = self._read_frame(timeout=0)
        if frame is not None:
            self._on_unexpected(frame)

    def _read_frame(self, timeout: float) -> can.Message | None:
        """Return the next frame, reported to ``on_frame``; None if there is none in time."""
        frame = self.bus.recv(timeout)
        if frame is not None:
            self._on_frame(frame)
        return frame

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


def _identifier_and_data(frame: can.Message) -> tuple[int, bytes]:
    """Return the identifier and the data: a bus preserves both, and they tell frames apart."""
    return frame.arbitration_id, bytes(frame.data)


def _indices_by_content(sent_frames: Sequence[SentFrame]) -> defaultdict[tuple[int, bytes], deque[int]]:
    """Return the indices of frames, in rising order, by the identifier and data that they have."""
    indices: defaultdict[tuple[int, bytes], deque[int]] = defaultdict(deque)
    for index, sent_frame in enumerate(sent_frames):
        indices[_identifier_and_data(sent_frame.frame)].append(index)
    return indices


class Carrier:
    """Transport of the frames of a swarm: in each tick ``send`` for every frame, then ``deliver``.

    Attributes:
        bus_connections: The connection over which the carrier reads and writes on the bus of each robot, by
            robot id. On a shared bus it is the same one for all robots. Empty without a bus.
    """

    def __init__(
        self,
        robots: Iterable[BusRobot],
        delivery_queue: DeliveryQueue,
        frame_format: FrameFormat,
        clock: RealTimeClock | None,
    ) -> None:
        """Create a carrier without a bus.

        Args:
            robots: The robots between which it carries frames, by rising id.
            delivery_queue: Decides which robot receives which frame, and when.
            frame_format: Format of the robots' estimates.
            clock: Limits how long a tick waits for frames; without a clock it waits for all of them.
        """
        self.bus_connections: dict[int, ExpectingConnection] = {}
        self._robots = {robot.id: robot for robot in robots}
        self._delivery_queue = delivery_queue
        self._frame_format = frame_format
        self._clock = clock
        self._on_frame_without_bus: FrameTaker = lambda frame: None
        """Called with every frame that is sent; with a bus it does nothing."""
        self._has_bus_per_robot = False
        self._robot_connections: dict[int, ExpectingConnection] = {}
        """The connections of robots in this process, by id: on a shared bus the carrier's."""
        self._frames_to_read_back: list[SentFrame] = []
        """Frames of this tick that are on their buses, and that the carrier has not read yet."""
        self._frames_read_back: list[SentFrame] = []
        """Frames of this tick that the carrier has read."""
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
        try:
            if wiring.is_shared:
                are_robots_remote = len(wiring.remote) > 0  # on a shared bus all of them are, or none
                self._join_shared_bus(wiring.open_bus, are_robots_remote, on_frame)
            else:
                self._join_bus_of_each_robot(wiring.open_bus, wiring.remote, on_frame)
        except BaseException:
            self.close()  # the buses that were opened before another could not be
            raise

    def _join_shared_bus(self, open_bus: OpenBus, are_robots_remote: bool, on_frame: FrameTaker) -> None:
        """Open the carrier's connection to the bus of all robots, over which those in this process send."""
        robots = list(self._robots)
        any_robot = robots[0]  # all have the same bus
        bus = self._open_buses.enter_context(open_bus(any_robot))
        carrier_connection = self._connect_carrier(robots, bus, on_frame)
        for robot in robots:
            self.bus_connections[robot] = carrier_connection
            # A robot in this process sends and reads over the same connection.
            if not are_robots_remote:
                self._robot_connections[robot] = carrier_connection

    def _join_bus_of_each_robot(
        self, open_bus: OpenBus, remote_robots: Collection[int], on_frame: FrameTaker
    ) -> None:
        """Open the carrier's connection to the bus of each robot, and that of each robot in this process."""
        for robot in self._robots:
            bus_of_carrier = self._open_buses.enter_context(open_bus(robot))
            self.bus_connections[robot] = self._connect_carrier([robot], bus_of_carrier, on_frame)
            if robot not in remote_robots:
                bus_of_robot = self._open_buses.enter_context(open_bus(robot))
                self._robot_connections[robot] = ExpectingConnection(bus_of_robot, f"robot {robot}")

    def _connect_carrier(
        self, robots: Sequence[int], bus: can.BusABC, on_frame: FrameTaker
    ) -> ExpectingConnection:
        """Return the carrier's connection to the bus of ``robots``, which count other nodes' frames there.

        ``on_frame`` is called with every frame that the carrier reads there.
        """
        on_unexpected = partial(self._count_foreign_frame, robots)
        return ExpectingConnection(bus, "the carrier", on_unexpected, on_frame)

    def _count_foreign_frame(self, robots: Sequence[int], frame: can.Message) -> None:
        """Let robots count a frame from outside the swarm."""
        for robot in robots:
            self._robots[robot].count_foreign_frame(frame)

    def send(self, sent_frame: SentFrame) -> None:
        """Put a frame on the bus of its sender, unless the sender is remote and has done so itself.

        Each time that _BATCH_SIZE frames are on the buses, the carrier reads them back, before receive
        buffers overflow; ``deliver`` reads the others. Raises can.CanError if the bus does not take the
        frame, and SwarmError if a frame is lost in a swarm without a clock, where none may be missing.
        """
        # With a bus this does nothing: a frame on a bus is reported when the carrier reads it.
        self._on_frame_without_bus(sent_frame.frame)
        # There is no connection without a bus, and none for a remote sender.
        robot_connection = self._robot_connections.get(sent_frame.sender)
        if robot_connection is not None:
            send_all(robot_connection.bus, [sent_frame.frame], FRAME_TIMEOUT)
        self._frames_to_read_back.append(sent_frame)
        if len(self._frames_to_read_back) == _BATCH_SIZE:
            self._read_back(sent_frame.tick)  # which empties ``_frames_to_read_back``
            if robot_connection is not None:
                # What the robot sent may fill the receive buffer of its own connection, too.
                robot_connection.discard_echoes()

    def _read_back(self, tick: int) -> None:
        """Read the frames that are on the buses, and keep them in the order in which they were sent.

        The attribute ``_frames_read_back`` gets them. Frames that are late are left out, and follow in a
        later call. Raises SwarmError if a frame is lost in a swarm without a clock, where none may be
        missing.
        """
        frames_to_read_back = self._frames_to_read_back
        self._frames_to_read_back = []
        # Frames that follow each other on one bus are awaited together; the order of all frames is kept.
        for connection, frames in groupby(frames_to_read_back, self._connection_to_read):
            if connection is None:
                self._frames_read_back += frames  # there is nothing to read: these count as read
            else:
                self._frames_read_back += connection.receive_expected(list(frames), self._timeout(tick))

    def _connection_to_read(self, sent_frame: SentFrame) -> ExpectingConnection | None:
        """Return where the carrier has to read a frame; None without a bus, or if it has read it already."""
        is_sent_from_here = sent_frame.sender in self._robot_connections
        if not is_sent_from_here:
            # There is no bus, or the sender is remote: then its driver has read the frame already.
            return None
        return self.bus_connections[sent_frame.sender]

    def _timeout(self, tick: int) -> float | None:
        """Return how many seconds to wait for frames of this tick; None if all must arrive."""
        return None if self._clock is None else self._clock.seconds_left_to_receive(tick)

    def deliver(self, tick: int) -> Deliveries:
        """Let each robot receive its frames of this tick, after all have been sent; returns the deliveries.

        Which frames these are decides the delivery queue. A robot with a bus of its own receives them there,
        other robots get them inside this process. Raises can.CanError if a bus does not take a frame, and
        SwarmError if a frame is lost in a swarm without a clock, where none may be missing.
        """
        self._read_back(tick)
        # Now all frames of this tick are read back: some were by ``send``, and this has read the others.
        frames_of_tick = self._frames_read_back
        self._frames_read_back = []
        deliveries = self._delivery_queue.deliver(tick, frames_of_tick)
        if self._has_bus_per_robot:
            self._deliver_over_buses(deliveries, tick)
        else:
            self._deliver_in_process(deliveries)
        return deliveries

    def _deliver_over_buses(self, deliveries: Deliveries, tick: int) -> None:
        """Pass to each robot the frames that it receives in this tick, over a bus of its own.

        Raises can.CanError and SwarmError as ``deliver`` says.
        """
        for robot_id, robot in self._robots.items():
            sent_frames = deliveries.frames_for(robot_id)
            # In batches, so that the frames for one robot fit into the receive buffer of its connection.
            for start in range(0, len(sent_frames), _BATCH_SIZE):
                batch = sent_frames[start : start + _BATCH_SIZE]
                received = self._pass_over_bus(robot_id, batch, tick)
                robot.receive_frames([sent_frame.frame for sent_frame in received])

    def _pass_over_bus(self, robot: int, batch: Sequence[SentFrame], tick: int) -> Sequence[SentFrame]:
        """Write frames on the bus of a robot, and return those that the robot's connection reads there.

        Late ones are missing, and follow in a later call. A remote robot reads for itself: for its
        counterpart in this process the whole batch is returned. After a full batch the carrier's receive
        buffer is emptied of the echoes of these frames. Raises can.CanError if the bus does not take a frame,
        and SwarmError if a frame is lost in a swarm without a clock, where none may be missing.
        """
        carrier_connection = self.bus_connections[robot]
        frames = [sent_frame.frame for sent_frame in batch]
        send_all(carrier_connection.bus, frames, FRAME_TIMEOUT)
        robot_connection = self._robot_connections.get(robot)
        if robot_connection is None:  # the robot is remote
            return batch
        received = robot_connection.receive_expected(batch, self._timeout(tick))
        is_full_batch = len(batch) == _BATCH_SIZE
        if is_full_batch:
            # Fewer echoes do no harm: the carrier skips them when it reads there next.
            carrier_connection.discard_echoes()
        return received

    def _deliver_in_process(self, deliveries: Deliveries) -> None:
        """Hand each robot its estimates in one array, and then let it count its other frames.

        A frame is decoded once, however many robots receive it.
        """
        contents = [
            decode_frame(sent_frame.frame, self._frame_format) for sent_frame in deliveries.sent_frames
        ]
        is_estimate = np.array([isinstance(content, Estimate) for content in contents], np.bool_)
        self._hand_over_estimates(estimate_rows(contents), deliveries.receivers[is_estimate])
        # The others, such as heartbeats, are few, so that they are handed over one by one.
        indices_of_others = np.flatnonzero(~is_estimate).tolist()
        for index in indices_of_others:
            self._count_content(contents[index], deliveries.receivers[index])

    def _hand_over_estimates(self, estimates: EstimateRows, receivers: ReceiverMask) -> None:
        """Let each robot receive its estimates; row k of ``receivers`` says which robots get estimate k."""
        for robot in self._robots.values():
            is_received = receivers[:, robot.id]
            robot.receive_all(estimates[is_received])

    def _count_content(self, content: FrameContent, is_receiver: NDArray[np.bool_]) -> None:
        """Let the receivers of a frame count its content.

        Robot i is a receiver if entry i of ``is_receiver`` is true.
        """
        is_receiver_by_id = is_receiver.tolist()  # which takes less time than to index the array
        for robot in self._robots.values():
            if is_receiver_by_id[robot.id]:
                robot.count_content(content)

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
