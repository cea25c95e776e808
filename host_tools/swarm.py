"""A swarm of robots on one CAN bus, tick by tick in step, with nothing lost.

Every robot runs a firmware of its own and joins the bus with a connection of its own. In one tick all
robots observe, those whose broadcast is due send a frame, each reads its connection until it has heard
every neighbour of this round, and all settle: the latency 0 of the paper's Algorithm 1. Since a tick
ends only when nothing is missing, a run depends on its settings alone, not on the timing of the bus.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass, field
from decimal import Decimal
from enum import Enum
from typing import Any

import can

from firmware_py.robot import (
    B_HAT_MARGIN,
    DEFAULT_FILTER_PERIOD,
    DEFAULT_MEMORY,
    MAX_PERIOD,
    MIN_MEMORY,
    Config,
    Filter,
    Observation,
    Robot,
    Status,
)
from host_tools.errors import UsageError
from host_tools.firmwares import load_firmware, port_of
from host_tools.frames import (
    MAX_B_HAT,
    MIN_B_HAT,
    ONE,
    TELEMETRY,
    FrameFormat,
    Heartbeat,
    Message,
    Rejection,
    Telemetry,
    decode,
    decode_heartbeat,
    decode_telemetry,
    encode,
    encode_heartbeat,
    encode_telemetry,
)
from host_tools.tables import generate
from host_tools.world import FullyConnected, World

MAX_ROBOTS = 126
"""Ids 0 .. 125; Cyphal keeps nodes 126 and 127 for tools."""

TIMEOUT = 2.0
"""Seconds after which a frame that has not come counts as lost."""

_TRANSFERS = 32
_COLOURS = (Observation.WHITE, Observation.BLACK)


class SwarmError(RuntimeError):
    """The swarm cannot go on: the bus lost a frame."""


class Deployment(Enum):
    """Which robots run the filter."""

    PLUS = "plus"
    """All of them: the paper's ASDF+."""
    MINUS = "minus"
    """Only the flawed ones: ASDF-."""
    OFF = "off"
    """None."""


@dataclass(frozen=True)
class Settings:
    """What defines a run; equal settings give equal runs. Raises UsageError if one will not do.

    Attributes:
        robots: N, 1 .. 126, with ids 0 .. N - 1.
        flawed: P, the proportion of robots with a flawed assumed accuracy, 0 .. 1; they are the first
            ``flawed_robots`` ids.
        fill_ratio: f, 0 .. 1.
        true_accuracy: b of every sensor, 0 .. 1; robots that are not flawed assume it.
        flawed_accuracy: b_hat that flawed robots start with, 0 .. 1.
        filter: Which robots re-estimate their b_hat.
        ticks: Length of the run, 1 or more.
        comms_period: Ticks between broadcasts, 1 or more.
        filter_period: Nominal filtering period tau in ticks, a multiple of ``comms_period``.
        omega: Type II error probability, above 0 and at most 0.9.
        memory: Observations at which t and n are halved, even, 64 .. 2**32 - 2.
        seed: Of everything random, 0 or more.
        firmware: Name of the robots' firmware, see ``host_tools.firmwares``.
        frames: Where messages are on the bus.
        ticks_per_second: Of simulated time; heartbeats are sent once a second, 1 or more.
        telemetry_period: Ticks between two telemetry frames of every robot; 0 for none.
    """

    robots: int = 20
    flawed: float = 0.3
    fill_ratio: float = 0.55
    true_accuracy: float = 0.95
    flawed_accuracy: float = 0.55
    filter: Deployment = Deployment.PLUS
    ticks: int = 3500
    comms_period: int = 1
    filter_period: int = DEFAULT_FILTER_PERIOD
    omega: Decimal = Decimal("0.05")
    memory: int = DEFAULT_MEMORY
    seed: int = 1
    firmware: str = "native"
    frames: FrameFormat = field(default_factory=FrameFormat)
    ticks_per_second: int = 10
    telemetry_period: int = 0

    def __post_init__(self) -> None:
        for name, least, most in _RANGES:
            value = getattr(self, name)
            if not least <= value <= most:
                raise UsageError(f"{name.replace('_', '-')} is {value}; it must be {least} to {most}")
        if self.filter_period % self.comms_period:
            raise UsageError(
                f"filter-period is {self.filter_period}; it must be a multiple of comms-period, "
                f"{self.comms_period}"
            )
        if self.memory % 2:
            raise UsageError(f"memory is {self.memory}; it must be even")
        if self.telemetry_period and self.frames.subject == TELEMETRY.subject:
            raise UsageError(
                f"subject {TELEMETRY.subject} is that of telemetry; choose another for estimates"
            )

    @property
    def flawed_robots(self) -> int:
        """How many robots are flawed: P N to the nearest whole number, halves up."""
        return int(self.flawed * self.robots + 0.5)

    def parameters(self) -> dict[str, Any]:
        """The settings as plain values, for JSON."""
        return asdict(self) | {"filter": self.filter.value, "omega": float(self.omega)}


_RANGES: tuple[tuple[str, float, float], ...] = (
    ("robots", 1, MAX_ROBOTS),
    ("flawed", 0, 1),
    ("fill_ratio", 0, 1),
    ("true_accuracy", 0, 1),
    ("flawed_accuracy", 0, 1),
    ("ticks", 1, 10**9),
    ("comms_period", 1, MAX_PERIOD),
    ("filter_period", 1, MAX_PERIOD),
    ("memory", MIN_MEMORY, DEFAULT_MEMORY),
    ("seed", 0, 2**128 - 1),
    ("ticks_per_second", 1, 10**6),
    ("telemetry_period", 0, MAX_PERIOD),
)


@dataclass
class Traffic:
    """What went over the bus, in frames.

    Attributes:
        sent: Messages sent.
        heartbeats_sent: Heartbeats sent.
        telemetry_sent: Telemetry sent.
        delivered: Messages that reached a neighbour's firmware: N - 1 for each sent.
        heartbeats_heard: Heartbeats read by the other robots.
        telemetry_heard: Telemetry read by the other robots, that of other processes' robots included.
        telemetry: The last heard from each sender, by id.
        refused: Delivered messages that the firmware did not accept (repeated or invalid).
        strays: Legal messages that no robot waits for; another program uses the subject.
        collisions: Those among them that a robot heard under its own id, by id: another node has it, too.
        rejected: Other frames that are no message of the swarm's, by reason.
    """

    sent: int = 0
    heartbeats_sent: int = 0
    telemetry_sent: int = 0
    delivered: int = 0
    heartbeats_heard: int = 0
    telemetry_heard: int = 0
    telemetry: dict[int, Telemetry] = field(default_factory=dict)
    refused: int = 0
    strays: int = 0
    collisions: Counter[int] = field(default_factory=Counter)
    rejected: Counter[Rejection] = field(default_factory=Counter)

    def figures(self) -> dict[str, Any]:
        """The counts as plain values, for JSON."""
        counts = {name: value for name, value in vars(self).items() if name != "telemetry"}
        return counts | {
            "collisions": {str(robot_id): n for robot_id, n in sorted(self.collisions.items())},
            "rejected": {reason.name: n for reason, n in self.rejected.items()},
        }


class Node:
    """One robot with its connection to the bus.

    Attributes:
        robot: The firmware.
        id: Robot id and node id.
        is_flawed: Whether the robot started with a flawed assumed accuracy.
        heard: Neighbours heard in the last round.
    """

    def __init__(self, robot: Robot, robot_id: int, is_flawed: bool, bus: can.BusABC) -> None:
        self.robot = robot
        self.id = robot_id
        self.is_flawed = is_flawed
        self.heard = 0
        self._port = port_of(robot)
        self._bus = bus

    def send(self, frame: can.Message) -> can.Message:
        """Put ``frame`` on the bus and return it. Raises can.CanError if the bus does not take it."""
        self._bus.send(frame, timeout=TIMEOUT)
        return frame

    def message(self, transfer: int) -> Message:
        """The robot's broadcast of round number ``transfer``."""
        return Message(self.id, self._port.x_hat_raw, self._port.alpha_raw, transfer % _TRANSFERS)

    def telemetry(self, transfer: int) -> Telemetry:
        """The robot's present state as telemetry number ``transfer``."""
        robot = self.robot
        b_hat = min(max(int(robot.b_hat * 2**24), MIN_B_HAT), MAX_B_HAT)
        updates = robot.counters.updates % 256
        return Telemetry(self.id, int(robot.x * ONE), b_hat, updates, transfer % _TRANSFERS)

    def listen(
        self, senders: Collection[int], transfer: int, frame_format: FrameFormat, traffic: Traffic
    ) -> None:
        """Hand the firmware one message of this round from each of ``senders``, in order of arrival.

        Raises SwarmError if one is missing after TIMEOUT seconds. O(frames on the bus).
        """
        waiting, transfer_id = set(senders), transfer % _TRANSFERS
        receive = self._port.receive_raw
        for frame in _frames_until_none(waiting, self._bus, f"robot {self.id}", "robot {}"):
            message = decode(frame, frame_format)
            if isinstance(message, Rejection):
                _note_other(frame, message, traffic)
            elif message.sender in waiting and message.transfer_id == transfer_id:
                waiting.discard(message.sender)
                status = receive(message.sender, message.x_hat, message.alpha)
                traffic.refused += status != Status.OK
            else:
                traffic.strays += 1
                if message.sender == self.id and frame.is_rx:  # not this connection's own frame, returned
                    traffic.collisions[self.id] += 1
        self.heard = len(senders)
        traffic.delivered += self.heard


class Tap:
    """A connection that hands every frame on the bus to ``take``, as a logging tool would."""

    def __init__(self, bus: can.BusABC, take: Callable[[can.Message], None]) -> None:
        self._bus = bus
        self._take = take

    def follow(self, sent: Sequence[can.Message]) -> None:
        """Take frames until all of ``sent`` have come. Raises SwarmError after TIMEOUT seconds."""
        waiting = {frame.arbitration_id for frame in sent}
        for frame in _frames_until_none(waiting, self._bus, "the log", "frame {:08X}"):
            waiting.discard(frame.arbitration_id)
            self._take(frame)


class Swarm:
    """Robots on a bus. A context manager: leaving it takes them off the bus.

    Attributes:
        settings: What the swarm is made of.
        world: The ground truth.
        nodes: The robots by id.
        traffic: What went over the bus so far.
        ticks: Ticks done.
    """

    def __init__(
        self,
        settings: Settings,
        open_bus: Callable[[], can.BusABC],
        log: Callable[[can.Message], None] | None = None,
    ) -> None:
        """Make the robots and let each join the bus that ``open_bus`` opens.

        With ``log`` one more connection joins and hands over every frame. Raises UsageError if the
        firmware or the bus cannot be had.
        """
        self.settings = settings
        self.traffic = Traffic()
        self.ticks = 0
        self._transfers = 0
        topology = FullyConnected(settings.robots)
        self.world = World(
            settings.fill_ratio, [settings.true_accuracy] * settings.robots, topology, settings.seed
        )
        robots = _make_robots(settings)
        with ExitStack() as connections:
            buses = [connections.enter_context(open_bus()) for _ in robots]
            tap_bus = None if log is None else connections.enter_context(open_bus())
            self._connections = connections.pop_all()
        self.nodes = [
            Node(robot, robot_id, robot_id < settings.flawed_robots, bus)
            for robot_id, (robot, bus) in enumerate(zip(robots, buses, strict=True))
        ]
        self._tap = None if log is None or tap_bus is None else Tap(tap_bus, log)

    def __enter__(self) -> Swarm:
        return self

    def __exit__(self, *_: object) -> None:
        self._connections.close()

    def tick(self) -> None:
        """Let all robots take one step together.

        Raises SwarmError if the bus loses a frame, can.CanError if it takes none; the swarm is then
        halfway through a tick and of no further use. O(robots**2).
        """
        colours = self.world.observe()[0].tolist()
        due = [
            node
            for node, z in zip(self.nodes, colours, strict=True)
            if node.robot.observe(_COLOURS[z]) == Status.DUE
        ]
        sent = self._send_heartbeats() + self._send_telemetry() + self._broadcast(due)
        if self._tap is not None:
            self._tap.follow(sent)
        if due:
            self._exchange({node.id for node in due})
        for node in self.nodes:
            node.robot.settle()
        self.ticks += 1

    def _send_heartbeats(self) -> list[can.Message]:
        """Send a heartbeat from every node on each full second; first, so that rounds end with messages."""
        uptime, fraction = divmod(self.ticks, self.settings.ticks_per_second)
        if fraction:
            return []
        self.traffic.heartbeats_sent += len(self.nodes)
        return [
            node.send(
                encode_heartbeat(Heartbeat(node.id, uptime, uptime % _TRANSFERS), timestamp=self._now())
            )
            for node in self.nodes
        ]

    def _send_telemetry(self) -> list[can.Message]:
        """Send every node's state before this tick's observation, when it is time."""
        period = self.settings.telemetry_period
        if period == 0 or self.ticks % period:
            return []
        transfer, now = self.ticks // period, self._now()
        self.traffic.telemetry_sent += len(self.nodes)
        return [node.send(encode_telemetry(node.telemetry(transfer), timestamp=now)) for node in self.nodes]

    def _broadcast(self, due: Sequence[Node]) -> list[can.Message]:
        frame_format, now = self.settings.frames, self._now()
        self.traffic.sent += len(due)
        return [node.send(encode(node.message(self._transfers), frame_format, now)) for node in due]

    def _exchange(self, senders: set[int]) -> None:
        for node in self.nodes:
            expected = senders.intersection(self.world.topology.neighbours(node.id))
            node.listen(expected, self._transfers, self.settings.frames, self.traffic)
        self._transfers += 1

    def _now(self) -> float:
        """Simulated time, seconds."""
        return self.ticks / self.settings.ticks_per_second


def _make_robots(settings: Settings) -> list[Robot]:
    make = load_firmware(settings.firmware)
    robots = []
    for robot_id in range(settings.robots):
        is_flawed = robot_id < settings.flawed_robots
        filters = settings.filter is Deployment.PLUS or (settings.filter is Deployment.MINUS and is_flawed)
        accuracy = settings.flawed_accuracy if is_flawed else settings.true_accuracy
        b_hat = min(max(accuracy, B_HAT_MARGIN), 1 - B_HAT_MARGIN)
        robots.append(make(_config(settings, filters), robot_id, b_hat))
    return robots


def _config(settings: Settings, filters: bool) -> Config:
    return Config(
        table=generate(settings.omega, max(2, settings.robots - 1)) if filters else None,
        filter=Filter.ADAPTIVE if filters else Filter.OFF,
        comms_period=settings.comms_period,
        filter_period=settings.filter_period,
        memory=settings.memory,
    )


def _note_other(frame: can.Message, reason: Rejection, traffic: Traffic) -> None:
    """Count a frame that is no message: heartbeats and telemetry apart from what else there is."""
    if reason is Rejection.SUBJECT:
        if isinstance(decode_heartbeat(frame), Heartbeat):
            traffic.heartbeats_heard += 1
            return
        telemetry = decode_telemetry(frame)
        if isinstance(telemetry, Telemetry):
            traffic.telemetry_heard += 1
            traffic.telemetry[telemetry.sender] = telemetry
            return
    traffic.rejected[reason] += 1


def _frames_until_none(waiting: set[int], bus: can.BusABC, who: str, what: str) -> Iterator[can.Message]:
    """Yield frames from ``bus`` until whoever takes them has emptied ``waiting``.

    Raises SwarmError after TIMEOUT seconds; ``who`` and ``what`` (of a number that waits) are for people.
    """
    monotonic, recv = time.monotonic, bus.recv
    deadline = monotonic() + TIMEOUT
    while waiting:
        frame = recv(max(0.0, deadline - monotonic()))
        if frame is None:
            missing = ", ".join(what.format(number) for number in sorted(waiting)[:8])
            raise SwarmError(
                f"{who} did not hear {missing}{', ...' * (len(waiting) > 8)} within {TIMEOUT:g} s on "
                f"{bus.channel_info}: the bus loses frames; use a faster bus or fewer robots"
            )
        yield frame
