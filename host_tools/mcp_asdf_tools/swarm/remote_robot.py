"""Robots of a swarm that run elsewhere, in a process or a controller of their own, driven in lockstep.

A robot's half here follows its state from its frames (``RemoteFirmware``). ``Driver`` commands those on one
bus.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from typing import cast

import can

from mcp_asdf.robot import Counters, Observation, Robot
from mcp_asdf_tools.bus.frame_layout import MAX_NODE_ID, Q23_ONE
from mcp_asdf_tools.bus.frames import Estimate, FrameFormat, Telemetry, decode_estimate, decode_telemetry
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.robots.bus_robot import BusRobot, Recorder, Words
from mcp_asdf_tools.robots.lockstep import DRIVER_ID, Lockstep
from mcp_asdf_tools.robots.node import Subjects
from mcp_asdf_tools.robots.record import RobotRecord
from mcp_asdf_tools.swarm.carrier import Wiring
from mcp_asdf_tools.swarm.fault_spec import FaultKind
from mcp_asdf_tools.swarm.settings import MAX_ROBOTS_AND_TOOLS, SwarmSettings

ANSWER_TIMEOUT = 10.0
"""Seconds that a robot has to answer."""


def check_remote(settings: SwarmSettings, wiring: Wiring) -> None:
    """Raises UsageError if a swarm with these remote robots is impossible."""
    remote = wiring.remote
    if not remote:
        return
    if settings.robots > MAX_ROBOTS_AND_TOOLS:
        raise UsageError(
            f"robots is {settings.robots}; with robots elsewhere take at most {MAX_ROBOTS_AND_TOOLS}, since "
            f"id {DRIVER_ID} commands them"
        )
    if not set(remote) <= set(range(settings.robots)):
        raise UsageError(f"robot {max(remote)} is to run elsewhere, but ids are 0 to {settings.robots - 1}")
    Subjects(estimates=settings.frames)
    for fault in settings.faults:
        if fault.kind is FaultKind.CRASH and not set(remote).isdisjoint(fault.robots or remote):
            raise UsageError(
                f"fault {fault} cannot affect robots that run elsewhere; name others, or use busoff"
            )
    if not wiring.is_shared:
        return
    if set(remote) != set(range(settings.robots)):
        raise UsageError(f"robots here and elsewhere need a bus each: {EACH_A_BUS}")
    is_plain = settings.topology == "fully-connected" and settings.latency == 0
    if settings.faults or not is_plain:
        raise UsageError(
            f"robots elsewhere on one bus all hear each other; for faults, latency or a topology {EACH_A_BUS}"
        )


EACH_A_BUS = "write {robot} where the id stands in the channel, such as --channel 'vcan{robot}'"


class RemoteFirmware:
    """State of a robot elsewhere, as far as commands and its frames reveal it. b_hat has 24 bits, x 23.

    It takes the place of a firmware in the robot's half here.

    Attributes:
        id: Robot id.
        t: Observations commanded.
        b_hat: Assumed accuracy.
        x: Informed estimate.
        x_hat: Local estimate of the last broadcast.
        counters: Only that of updates is known.
    """

    def __init__(self, record: RobotRecord) -> None:
        self.id = record.id
        self.t = 0
        self.b_hat = record.b_hat
        self.x = self.x_hat = 0.5
        self.counters = Counters()

    def observe(self, z: Observation) -> None:
        """The robot was commanded to observe."""
        self.t += 1

    def receive_all(self, words: Words) -> int:
        """The robot hears these by itself."""
        return len(words)

    def settle(self) -> None:
        """The robot was commanded to settle."""

    def take_estimate(self, message: Estimate) -> None:
        """Note the robot's broadcast."""
        self.x_hat = message.x_hat / Q23_ONE

    def take_telemetry(self, telemetry: Telemetry) -> None:
        """Note the robot's answer to a *settle*."""
        self.x, self.b_hat = telemetry.x / Q23_ONE, telemetry.b_hat / 2**24
        # Telemetry has 8 bits of the count, and comes after every tick.
        updates = self.counters.updates
        self.counters = Counters(updates=updates + (telemetry.updates - updates) % 256)


def remote_robot(record: RobotRecord, frames: FrameFormat, recorder: Recorder | None = None) -> BusRobot:
    """The half here of a robot whose firmware runs elsewhere; ``recorder`` takes its events."""
    return BusRobot(record, frames, recorder, make=lambda: cast(Robot, RemoteFirmware(record)))


class Driver:
    """Commands the robots on one bus.

    Attributes:
        nodes: Their local halves, by id.
    """

    def __init__(
        self,
        bus: can.BusABC,
        nodes: Sequence[BusRobot],
        frames: FrameFormat,
        log: Callable[[can.Message], None] | None = None,
        in_turn: bool = False,
    ) -> None:
        """Prepare; ``log`` takes every frame that comes over ``bus``, which is left open at the end.

        ``in_turn``: a robot is not commanded to observe before those of lower ids have sent their estimates,
        since with the robust filter the order of messages matters.
        """
        self.nodes = {node.id: node for node in nodes}
        self._frames = frames
        self._log = log
        self._in_turn = in_turn
        self._check: Callable[[], None] = lambda: None
        self._held: list[can.Message] = []
        self._estimates: dict[int, can.Message] = {}
        self._lockstep = Lockstep(
            bus, Subjects(estimates=frames), ANSWER_TIMEOUT, watch=self._see, check=self._look_after
        )

    def wait_until_up(self, timeout: float, check: Callable[[], None]) -> None:
        """Return when all robots have sent a heartbeat.

        From now on ``check`` is called while waiting; it may raise an error that ends it. Raises
        LockstepError after ``timeout`` seconds.
        """
        self._check = check
        self._lockstep.wait_until_up(self.nodes, timeout)

    def observe(self, observations: Mapping[int, Observation | None]) -> list[tuple[BusRobot, can.Message]]:
        """Let robots observe, by id; returns the frames that they send in this tick, by rising id.

        Other frames than estimates count in the next tick, since their time is unpredictable.
        Raises as ``Lockstep``.
        """
        self._estimates = {}
        sent, self._held = self._held, []
        turns = [{robot: observations[robot]} for robot in sorted(observations)]
        for turn in turns if self._in_turn else [observations]:
            self._lockstep.observe(turn)
            due = [robot for robot, z in turn.items() if self.nodes[robot].begin(z)]
            for robot, message in self._lockstep.estimates(due).items():
                self._firmware(robot).take_estimate(message)
        return [(self.nodes[_sender(f)], f) for f in sent] + [
            (self.nodes[robot], frame) for robot, frame in sorted(self._estimates.items())
        ]

    def settle(self, robots: Collection[int]) -> None:
        """Let ``robots`` settle. Raises as ``Lockstep``."""
        for robot, telemetry in self._lockstep.settle(robots).items():
            self._firmware(robot).take_telemetry(telemetry)
            self.nodes[robot].end()
        self._held.sort(key=_sender)

    def _look_after(self) -> None:
        self._check()

    def _firmware(self, robot: int) -> RemoteFirmware:
        firmware = self.nodes[robot].robot
        assert isinstance(firmware, RemoteFirmware)
        return firmware

    def _see(self, frame: can.Message) -> None:
        """Keep the robots' frames except their answers."""
        if self._log is not None:
            self._log(frame)
        if frame.is_error_frame:  # its identifier describes the error, and is none of a robot's
            for node in self.nodes.values():
                node.hear_stranger(frame)
            return
        if _sender(frame) not in self.nodes or isinstance(decode_telemetry(frame), Telemetry):
            return
        if isinstance(decode_estimate(frame, self._frames), Estimate):
            self._estimates.setdefault(_sender(frame), frame)
        else:
            self._held.append(frame)


def _sender(frame: can.Message) -> int:
    return frame.arbitration_id & MAX_NODE_ID
