"""A swarm of robots that take each tick together, on CAN buses or inside this process.

In one tick all robots observe, those whose round is over broadcast, all receive what the carrier brings them,
and all settle: the paper's Algorithm 1 with latency 0. Most robots are emulated here. Remote ones run in
other programs, driven by commands over their bus. One robot may be external: this class does not drive it,
and its frames come from outside, by whoever calls this class. To settle is to end a tick and, in the last
tick of a round, to use the estimates that were received in the round.

In lockstep a tick ends only when every frame has arrived that no fault has taken away. A run then depends on
its settings alone, not on the timing of a bus.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import cast

import can
import numpy as np
from numpy.typing import NDArray

from mcp_asdf.robot import MAX_ID, Observation, Robot
from mcp_asdf_tools.bus.frames import Estimate, alpha_float32_bits, decode_estimate
from mcp_asdf_tools.recording.events import EventsWriter
from mcp_asdf_tools.robots.bus_robot import BusRobot, Recorder
from mcp_asdf_tools.robots.clock import RealTimeClock
from mcp_asdf_tools.robots.node import FrameTaker
from mcp_asdf_tools.robots.robot_setup import RobotSetup
from mcp_asdf_tools.swarm.carrier import Carrier, Wiring
from mcp_asdf_tools.swarm.delivery import DeliveryQueue, SentFrame
from mcp_asdf_tools.swarm.fault_injection.fault import Fault
from mcp_asdf_tools.swarm.fault_injection.faults import Faults
from mcp_asdf_tools.swarm.remote_robot import Driver, RemoteFirmware, check_remote
from mcp_asdf_tools.swarm.settings import SwarmSettings
from mcp_asdf_tools.swarm.traffic import Traffic
from mcp_asdf_tools.world.world import SteppedWorld

RobotFrame = tuple[BusRobot, can.Message]
"""A robot and a frame that it sends."""


@dataclass(frozen=True)
class Members:
    """Robots of a swarm, and the faults between them.

    Attributes:
        setups: Initial state of each robot.
        faults: The faults, in the order in which they act.
        external_robot: Id of the robot whose frames are passed to ``Swarm.finish_tick``; None for none.
    """

    setups: Sequence[RobotSetup]
    faults: Sequence[Fault]
    external_robot: int | None = None


class Swarm:
    """Robots in a common world. A context manager: leaving it closes their buses.

    Attributes:
        settings: Parameters of the swarm.
        world: The floor, the sensors and who is in range of whom.
        nodes: The robots by rising id, all but an external one; of remote ones the halves in this process.
        remote_robots: Ids of the remote robots.
        faults: The faults of robots and links.
        clock: The clock that ends ticks; None in lockstep.
        traffic: Counts of the frames so far.
        ticks: Number of ticks done.
        b_hat_at_start: Assumed accuracy of each robot at the start.
    """

    def __init__(
        self,
        settings: SwarmSettings,
        wiring: Wiring,
        on_frame: FrameTaker | None = None,
        events_writer: EventsWriter | None = None,
        members: Members | None = None,
    ) -> None:
        """Create the robots and open their buses.

        If robots are remote, call ``wait_until_up`` before the first tick.

        Args:
            settings: Parameters of the swarm.
            wiring: Which robots are on which bus.
            on_frame: Called with every frame that a robot sends.
            events_writer: Takes the events of each robot.
            members: Robots and faults in place of those of the settings.

        Raises:
            UsageError: If the firmware or the bus is not available, or the settings are impossible for remote
                robots.
        """
        check_remote(settings, wiring)
        self.settings = settings
        self.ticks = 0

        # The world, the faults and the clock
        self.world = SteppedWorld(settings)
        members = members or Members(settings.robot_setups(), settings.faults)
        self.faults = Faults(members.faults, settings.seed, settings.frames)
        is_lockstep = settings.clock == "lockstep"
        self.clock = None if is_lockstep else RealTimeClock(settings.steps_per_second)
        self._events_writer = events_writer
        self.remote_robots = wiring.remote
        self._external_robot = members.external_robot

        # The robots. The world counts them from 0 by rising id, whatever their ids are.
        setups = sorted(members.setups, key=lambda setup: setup.id)
        self._ids = [setup.id for setup in setups]
        self.nodes = [self._create_robot(setup) for setup in setups if setup.id != self._external_robot]
        self._local_nodes = [node for node in self.nodes if node.id not in self.remote_robots]
        self.b_hat_at_start = [node.robot.b_hat for node in self.nodes]

        self._alive_nodes: list[BusRobot] = []
        """The local robots that take part in the present tick."""
        self._sent_frames: list[SentFrame] = []
        """Frames that robots send in the present tick, after the faults of their senders."""
        self.traffic = Traffic([node.reception for node in self.nodes])

        # The transport of frames
        self._delivery_queue = DeliveryQueue(
            self._current_neighbours, self.faults.on_delivery, settings.latency
        )
        self._carrier = Carrier(self.nodes, settings.frames, self.clock)
        self._drivers = self._open_buses(wiring, on_frame)

    def _open_buses(self, wiring: Wiring, on_frame: FrameTaker | None) -> list[Driver]:
        """Open the buses of ``wiring``, and return the drivers of remote robots, one for each bus.

        ``on_frame``, if it is not None, is called with every frame, which is marked as received before that.
        """
        # Without ``on_frame`` frames stay unmarked. The command radio puts them on another bus, which may
        # return them; a marked one would then count as a frame of another node.
        report_frame = _ignore_frame if on_frame is None else partial(_report_as_received, on_frame)
        # The drivers command over connections that the carrier opens.
        self._carrier.join(wiring, report_frame)
        return self._create_drivers(wiring, report_frame)

    def _create_robot(self, setup: RobotSetup) -> BusRobot:
        """Create a robot that starts as ``setup`` says or, if it is remote, its counterpart in this process.

        The counterpart counts the ticks and frames of a robot that runs in another program.
        """
        recorder: Recorder | None = None
        if self._events_writer is not None:
            recorder = self._events_writer.recorders.get(setup.id)
        make_firmware: Callable[[], Robot] | None = None
        if setup.id in self.remote_robots:
            make_firmware = cast(Callable[[], Robot], partial(RemoteFirmware, setup))
        return BusRobot(setup, self.settings.frames, recorder, make_firmware=make_firmware)

    def _create_drivers(self, wiring: Wiring, on_frame: FrameTaker) -> list[Driver]:
        """Create the drivers of remote robots, one for each bus.

        ``on_frame`` is called with every frame on these buses, commands included.
        """
        remote_nodes = [node for node in self.nodes if node.id in wiring.remote]
        if not remote_nodes:
            return []
        # Each remote robot has a bus of its own, unless one is shared by all.
        nodes_by_bus = [remote_nodes] if wiring.is_shared else [[node] for node in remote_nodes]
        order_matters = self.settings.swarm_filter.order_matters
        drivers = []
        for nodes in nodes_by_bus:
            any_node = nodes[0]
            bus = self._carrier.bus_connections[any_node.id].bus
            drivers.append(Driver(bus, nodes, self.settings.frames, on_frame, order_matters))
        return drivers

    def __enter__(self) -> Swarm:
        """Return the swarm, whose buses are open since it was made."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close all buses."""
        self._carrier.close()

    def wait_until_up(self, timeout: float, check: Callable[[], None] = lambda: None) -> None:
        """Wait until all remote robots have sent a heartbeat.

        ``check`` is called during this wait and all later ones; it may raise an error that ends them. Raises
        LockstepError, naming the missing robots, after ``timeout`` seconds.
        """
        for driver in self._drivers:
            driver.wait_until_up(timeout, check)

    def tick(self) -> None:
        """Let all robots take one step together: observe, send, receive and settle. None may be external.

        Raises SwarmError if the bus loses a frame in lockstep, LockstepError if a remote robot does not
        answer, and can.CanError if the bus does not take a frame. The swarm cannot go on after these.
        """
        self.begin_tick()
        self.finish_tick()

    def begin_tick(self) -> dict[int, Observation | None]:
        """Let all robots observe and broadcast, and return the observations of this tick by id.

        An external robot, whose frames come from outside, has its observation in the result but does not send
        here. An observation is None if the robot has none in this tick. Faults may crash robots, and drop,
        change or add frames. The frames wait for ``finish_tick``; only remote robots send theirs now. Raises
        LockstepError if a remote robot does not answer, and can.CanError if the bus does not take the
        commands. The swarm cannot go on after these.
        """
        if self.clock is not None:
            self.clock.wait_for_tick(self.ticks)
        observations = dict(zip(self._ids, self.world.step(), strict=True))
        self._begin_outages()
        # Telemetry has the state before this tick, so that it is made before robots observe.
        reports = self._make_reports()
        estimates = self._observe_locally(observations) + self._observe_remotely(observations)
        # To the robust filter the order of estimates matters: by rising id, wherever the robots run.
        estimates.sort(key=_sender_id)

        self._sent_frames = []
        self._send_extra_frames(before_others=True)
        for node, frame in [*reports, *estimates]:
            self._send(node, frame)
        self._send_extra_frames(before_others=False)
        return observations

    def finish_tick(self, external_frames: Sequence[can.Message] = ()) -> list[can.Message]:
        """Let all robots send, receive and end the tick; return the frames that an external robot receives.

        The result is empty if no robot is external. ``external_frames`` are those that it has sent. Traffic
        is counted. Raises SwarmError if the bus loses a frame in lockstep, LockstepError if a remote robot
        does not answer, and can.CanError if the bus does not take a frame. O(robots**2).
        """
        sent_frames = [*self._sent_frames, *self._frames_of_external_robot(external_frames)]
        # The frames go over the buses of their senders, if there are any, and are read back from them.
        frames_on_buses = self._carrier.send(sent_frames, self.ticks)
        # The queue says who receives which frame in this tick. Latency and faults keep some for later ticks.
        deliveries = self._delivery_queue.deliver(self.ticks, frames_on_buses)
        self._carrier.deliver(deliveries, self.ticks)  # robots that have a bus each receive over theirs
        self._settle()
        self.ticks += 1
        self._count_traffic()
        if self._external_robot is None:
            return []
        return [sent_frame.frame for sent_frame in deliveries.frames_for(self._external_robot)]

    def _frames_of_external_robot(self, frames: Sequence[can.Message]) -> list[SentFrame]:
        """Return frames that the external robot has sent in this tick, each with its sender and its number.

        They have been on a bus, so that faults of senders cannot change them any more.
        """
        if not frames:
            return []
        assert self._external_robot is not None  # nobody else has external frames
        # Faults of links draw random words by the repetition, so each frame needs a repetition of its own.
        return [
            SentFrame(frame, self._external_robot, self.ticks, repetition=index)
            for index, frame in enumerate(frames)
        ]

    def _settle(self) -> None:
        """Let the robots that take part in the tick end it. Raises errors as ``finish_tick`` says."""
        for node in self._alive_nodes:
            node.settle()
        for driver in self._drivers:
            driver.settle(driver.nodes)

    def _count_traffic(self) -> None:
        """Count the frames of this tick, and take over the counts of the queue and the carrier so far."""
        self.traffic.add([sent_frame.frame for sent_frame in self._sent_frames])
        self.traffic.in_range = self._delivery_queue.in_range_count
        self.traffic.arrived = self._delivery_queue.delivered_count
        self.traffic.missed = self._carrier.missed_count

    def _begin_outages(self) -> None:
        """Let the faults decide which robots are off the bus in this tick; crash and rejoin local robots.

        Local robots that are alive after that take part in the tick.
        """
        self.faults.begin_tick(self.ticks, self._ids)
        for node in self._local_nodes:
            self._crash_or_rejoin(node)
        self._alive_nodes = [node for node in self._local_nodes if node.is_alive]

    def _crash_or_rejoin(self, node: BusRobot) -> None:
        """Let a robot crash or rejoin if the faults require it in this tick."""
        outage = self.faults.robot_outage(node.id)
        if outage is None and not node.is_alive:
            node.rejoin()
        elif outage is not None and node.is_alive:
            node.crash(loses_state=outage.loses_state)

    def _make_reports(self) -> list[RobotFrame]:
        """Return heartbeats of this tick, then telemetry of the state before it, and count both as sent.

        Heartbeats are due once a second of simulated time, telemetry every ``telemetry_period`` ticks.
        """
        reports: list[RobotFrame] = []
        for node in self._alive_nodes:
            if node.is_heartbeat_due(self.settings.steps_per_second):
                self.traffic.heartbeats_sent += 1
                reports.append((node, node.heartbeat(self._now)))
        period = self.settings.telemetry_period
        # A period of 0 stands for no telemetry.
        if period and self.ticks % period == 0:
            for node in self._alive_nodes:
                self.traffic.telemetry_sent += 1
                reports.append((node, node.telemetry(self._now)))
        return reports

    def _observe_locally(self, observations: Mapping[int, Observation | None]) -> list[RobotFrame]:
        """Let the robots in this process observe; return the estimates of those that broadcast in this tick.

        The estimates count as sent.
        """
        estimates: list[RobotFrame] = []
        for node in self._alive_nodes:
            is_broadcast_due = node.observe(observations[node.id])
            if is_broadcast_due:
                self.traffic.sent += 1
                estimates.append((node, node.broadcast(self._now)))
        return estimates

    def _observe_remotely(self, observations: Mapping[int, Observation | None]) -> list[RobotFrame]:
        """Command the remote robots to observe, and return what they send: estimates and heartbeats.

        Both count as sent. Raises LockstepError if a robot does not broadcast in time, and can.CanError if
        the bus does not take the commands.
        """
        robot_frames: list[RobotFrame] = []
        for driver in self._drivers:
            robot_frames += driver.observe({robot: observations[robot] for robot in driver.nodes})
        for _node, frame in robot_frames:
            if self._is_estimate(frame):
                self.traffic.sent += 1
            else:
                # The driver leaves out telemetry, and by docs/design.md a robot sends nothing else.
                self.traffic.heartbeats_sent += 1
        return robot_frames

    def _is_estimate(self, frame: can.Message) -> bool:
        """Return whether a frame holds a legal estimate."""
        return isinstance(decode_estimate(frame, self.settings.frames), Estimate)

    def _send(self, node: BusRobot, frame: can.Message) -> None:
        """Send a robot's frame as the faults of its sender let it, and record what they have changed.

        The faults may drop the frame, or replace it by another.
        """
        sent_frame = self.faults.on_send(frame, node.id)  # None if a fault has dropped it
        # A remote robot's frame is on its bus already, unchanged by faults: its events have no change.
        if self._events_writer is not None and node.id not in self.remote_robots:
            self._record_changes(self._events_writer, node.id, frame, sent_frame)
        if sent_frame is not None:
            self._sent_frames.append(sent_frame)

    def _record_changes(
        self, events_writer: EventsWriter, robot: int, frame: can.Message, sent_frame: SentFrame | None
    ) -> None:
        """Record how ``sent_frame``, None if nothing was sent, differs from the robot's own ``frame``.

        An event of the robot says that its estimate was falsified, or that it was not sent. A frame that was
        sent under another id is recorded as injected.
        """
        recorder = events_writer.recorders[robot]
        is_own_frame_missing = sent_frame is None or not sent_frame.is_under_own_id
        # A replay makes the robot's own estimates again, so it has to know which of them the log lacks.
        if is_own_frame_missing and self._is_estimate(frame):
            recorder.record_silence()
        if sent_frame is None:
            return
        if not sent_frame.is_under_own_id:
            events_writer.record_injected_frame(sent_frame.frame)
        elif sent_frame.is_falsified:
            false_estimate = decode_estimate(sent_frame.frame, self.settings.frames)
            assert isinstance(false_estimate, Estimate)  # faults falsify nothing else
            recorder.record_false_values(false_estimate.x_hat, alpha_float32_bits(sent_frame.frame))

    def _send_extra_frames(self, *, before_others: bool) -> None:
        """Send the frames that faulty robots send besides their own, before or after those of all robots.

        They are recorded as frames that a fault has injected, and count as frames of this tick.
        """
        for node in self.nodes:
            for frame in self.faults.extra_frames(node.id, self._now, before_others=before_others):
                # Other faults change these frames, too.
                sent_frame = self.faults.on_send(frame, node.id)
                if sent_frame is None:
                    continue
                if self._events_writer is not None and node.id not in self.remote_robots:
                    self._events_writer.record_injected_frame(sent_frame.frame)
                self._sent_frames.append(sent_frame)

    def _current_neighbours(self) -> NDArray[np.bool_]:
        """Return a matrix whose entry (i, j) is whether robot i receives from robot j at present, by ids."""
        neighbours = self.world.current_neighbours
        has_ids_from_zero = self._ids == list(range(len(self._ids)))
        if has_ids_from_zero:
            return neighbours
        # The world counts robots from 0: move its rows and columns to the robots' ids, in a matrix for all
        # possible ids.
        neighbours_by_id = np.zeros((MAX_ID + 1, MAX_ID + 1), np.bool_)
        neighbours_by_id[np.ix_(self._ids, self._ids)] = neighbours
        return neighbours_by_id

    @property
    def _now(self) -> float:
        """Simulated time, seconds."""
        return self.ticks / self.settings.steps_per_second


def _sender_id(robot_frame: RobotFrame) -> int:
    """Return the id of the robot that sends a frame."""
    robot, _ = robot_frame
    return robot.id


def _report_as_received(on_frame: FrameTaker, frame: can.Message) -> None:
    """Mark a frame as received, and call ``on_frame`` with it."""
    frame.is_rx = True  # Without a bus a frame has only been sent, as have commands to remote robots.
    on_frame(frame)


def _ignore_frame(frame: can.Message) -> None:
    """Do nothing with a frame."""
