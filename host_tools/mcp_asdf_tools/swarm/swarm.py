"""A swarm of robots on CAN buses, tick by tick.

Every robot runs a firmware of its own and joins the bus with a connection of its own. In one tick all
robots observe, those whose broadcast is due send a frame, all hear what the medium carries to them, and all
settle: the latency 0 of the paper's Algorithm 1. In lockstep a tick ends only when nothing is missing that
the faults have not taken away, so that a run depends on its settings alone, not on the timing of the bus.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import can

from mcp_asdf.robot import Observation
from mcp_asdf_tools.bus import Message, alpha_bits
from mcp_asdf_tools.recording import SidecarWriter
from mcp_asdf_tools.robots import BusRobot, Decoder, FrameTaker, RobotRecord, make_clock
from mcp_asdf_tools.swarm.air import Air
from mcp_asdf_tools.swarm.faults import Faults, SentFrame
from mcp_asdf_tools.swarm.in_process import InProcess
from mcp_asdf_tools.swarm.medium import ChannelPerRobot, Medium, RemoteBus, SharedBus, Wiring
from mcp_asdf_tools.swarm.remote_robot import Driver, RemoteNode, check_remote
from mcp_asdf_tools.swarm.settings import SwarmSettings
from mcp_asdf_tools.swarm.traffic import Traffic
from mcp_asdf_tools.world import World

SwarmRobot = BusRobot | RemoteNode
"""A robot of a swarm, here or elsewhere."""


class Swarm:
    """Robots on a bus. A context manager: leaving it takes them off the bus.

    Attributes:
        settings: Its parameters.
        world: The ground truth.
        nodes: The robots by id.
        faults: The faults between them.
        clock: The clock that ends ticks.
        traffic: Frames on the bus so far.
        ticks: Ticks done.
    """

    def __init__(
        self,
        settings: SwarmSettings,
        wiring: Wiring,
        log: FrameTaker | None = None,
        sidecar: SidecarWriter | None = None,
    ) -> None:
        """Make the robots and let each join its bus.

        ``log`` takes every frame that robots send, ``sidecar`` the events of each. If some run elsewhere,
        call ``wait_until_up`` before the first tick. Raises UsageError if the firmware or the bus is not
        available, or the settings are impossible for robots elsewhere.
        """
        self.settings = settings
        self.ticks = 0
        self.world = World(settings)
        self.faults = Faults(settings.faults, settings.seed, settings.frames)
        self.clock = make_clock(settings.clock, settings.steps_per_second)
        self._sidecar = sidecar
        self._decode = Decoder(settings.frames)
        self.nodes: list[SwarmRobot] = [
            _robot_of(record, record.id in wiring.remote, self._decode, sidecar)
            for record in settings.records()
        ]
        self._here = [node for node in self.nodes if isinstance(node, BusRobot)]
        self.traffic = Traffic([node.reception for node in self.nodes])
        self._air = Air(self.world, self.faults, settings.latency)
        taker = None if log is None else _as_received(log, wiring)
        self._medium, self._drivers = self._connect(wiring, taker)

    def _connect(self, wiring: Wiring, log: FrameTaker | None) -> tuple[Medium, list[Driver]]:
        """Medium of the frames, and drivers of remote robots."""
        check_remote(self.settings, wiring)
        if wiring.open_bus is None:
            return InProcess(self._here, self._air, self._decode, log), []
        frames = self.settings.frames
        away = [node for node in self.nodes if isinstance(node, RemoteNode)]
        if not wiring.is_shared:
            channels = ChannelPerRobot(self.nodes, self._air, wiring, self.clock, log)
            return channels, [Driver(channels.ends[n.id].bus, [n], frames, log) for n in away]
        if away:
            remote = RemoteBus(self.nodes, self._air, wiring)
            return remote, [Driver(remote.end, away, frames, log)]
        return SharedBus(self.nodes, self._air, wiring, self.clock, log), []

    def __enter__(self) -> Swarm:
        return self

    def __exit__(self, *_: object) -> None:
        self._medium.__exit__()

    def wait_until_up(self, timeout: float, check: Callable[[], None] = lambda: None) -> None:
        """Return when all remote robots are there.

        ``check`` is called while waiting for them, now and later; it may raise an error that ends the wait.
        Raises LockstepError, naming missing robots, after ``timeout`` seconds.
        """
        for driver in self._drivers:
            driver.wait_until_up(timeout, check)

    def tick(self) -> None:
        """Let all robots take one step together.

        Raises SwarmError if the bus loses a frame in lockstep, LockstepError if a remote robot does not
        answer, can.CanError if the bus takes no frame; the swarm is then halfway through a tick and
        unusable. O(robots**2).
        """
        self.clock.begin(self.ticks)
        seen = self.world.step()
        alive = [node for node in self._here if self.faults.survives(node, self.ticks)]
        frames: list[tuple[SwarmRobot, can.Message]] = [*self._reports(alive)]
        frames += self._estimates(alive, seen)
        frames += self._commanded(seen)
        sent = [each for node, frame in frames for each in self._send(node, frame)]
        if self.faults.babbles:
            sent += [each for node in self.nodes if node.is_alive for each in self._babble(node)]
        self._medium.carry(self.ticks)
        for node in alive:
            node.settle()
        for driver in self._drivers:
            driver.settle(driver.nodes)
        self.ticks += 1
        self._count(sent)

    def _commanded(self, seen: Sequence[Observation | None]) -> Iterator[tuple[RemoteNode, can.Message]]:
        """Let remote robots observe; yields what they send."""
        for driver in self._drivers:
            for node, frame in driver.observe({robot: seen[robot] for robot in driver.nodes}):
                is_estimate = isinstance(self._decode(frame), Message)
                self.traffic.sent += is_estimate
                self.traffic.heartbeats_sent += not is_estimate
                yield node, frame

    def _reports(self, alive: list[BusRobot]) -> Iterator[tuple[BusRobot, can.Message]]:
        """Heartbeats, then telemetry of the state before this tick."""
        now = self._now
        period = self.settings.telemetry_period
        if self.ticks % self.settings.steps_per_second == 0:
            self.traffic.heartbeats_sent += len(alive)
            yield from ((node, node.heartbeat(now)) for node in alive)
        if period and self.ticks % period == 0:
            self.traffic.telemetry_sent += len(alive)
            yield from ((node, node.telemetry(now)) for node in alive)

    def _estimates(
        self, alive: list[BusRobot], seen: Sequence[Observation | None]
    ) -> list[tuple[BusRobot, can.Message]]:
        """Let robots observe; returns the estimates due. They follow frames that no robot waits for."""
        now = self._now
        due = [(node, frame) for node in alive for frame in node.observe(seen[node.id], now)]
        self.traffic.sent += len(due)
        return due

    def _send(self, node: SwarmRobot, frame: can.Message, is_own: bool = True) -> list[SentFrame]:
        """Let a robot send the frames that the faults make of one, its own or one that it babbles."""
        leaving = self.faults.leave(frame, node.id, self.ticks)
        # A frame of a robot elsewhere is on its bus already, unchanged by faults.
        if self._sidecar is not None and isinstance(node, BusRobot):
            _note_fate(self._sidecar, node.id, frame if is_own else None, leaving, self._decode)
        for sent in leaving:
            self._medium.send(sent)
        return leaving

    def _babble(self, node: SwarmRobot) -> list[SentFrame]:
        frames = self.faults.babble(node.id, self.ticks, self._now)
        return [sent for frame in frames for sent in self._send(node, frame, is_own=False)]

    @property
    def _now(self) -> float:
        """Simulated time, seconds."""
        return self.ticks / self.settings.steps_per_second

    def _count(self, sent: list[SentFrame]) -> None:
        traffic = self.traffic
        traffic.add([each.frame for each in sent])
        traffic.in_range, traffic.arrived = self._air.in_range, self._air.arrived
        traffic.missed = self._medium.missed


def _robot_of(
    record: RobotRecord, is_remote: bool, decoder: Decoder, sidecar: SidecarWriter | None
) -> SwarmRobot:
    recorder = None if sidecar is None else sidecar.robots[record.id]
    if is_remote:
        return RemoteNode(record, decoder, recorder)
    return BusRobot(record.id, record.make, decoder, recorder)


def _as_received(log: FrameTaker, wiring: Wiring) -> FrameTaker:
    """Mark frames as received: SocketCAN marks those from this computer as sent."""

    def take(frame: can.Message) -> None:
        frame.is_rx = True
        if wiring.open_bus is None:
            frame.channel = wiring.channel
        log(frame)

    return take


def _note_fate(
    sidecar: SidecarWriter,
    robot: int,
    frame: can.Message | None,
    leaving: Sequence[SentFrame],
    decode: Decoder,
) -> None:
    """Record how the frames ``leaving`` the robot differ from its own ``frame``, None if it babbles."""
    if [sent.frame for sent in leaving] == [frame]:
        return
    own = None if frame is None else decode(frame)
    is_heard = False
    for sent in leaving:
        said = decode(sent.frame)
        if isinstance(own, Message) and isinstance(said, Message) and said.sender == robot:
            is_heard = True
            if frame is not None and sent.frame.data != frame.data:
                sidecar.robots[robot].falsified(said.x_hat, alpha_bits(sent.frame))
        elif sent.frame is not frame:
            sidecar.injected(sent.frame)
    if isinstance(own, Message) and not is_heard:
        sidecar.robots[robot].silent()
