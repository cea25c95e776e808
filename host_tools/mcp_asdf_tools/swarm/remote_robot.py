"""Robots of a swarm whose firmware runs in another process or on a controller, driven in lockstep.

In this process a remote robot has a half, whose state follows from commands and from the frames that the
robot sends (``RemoteFirmware``). A ``Driver`` commands the remote robots on one bus.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence

import can

from mcp_asdf.robot import Counters, Observation
from mcp_asdf_tools.bus.frame_layout import B_HAT_UNITS, Q23_ONE, UPDATE_COUNT_MODULUS, Rejection
from mcp_asdf_tools.bus.frames import (
    Estimate,
    FrameFormat,
    Telemetry,
    decode_estimate,
    decode_telemetry,
    sender_of,
)
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.robots.bus_robot import BusRobot, EstimateRows
from mcp_asdf_tools.robots.lockstep import DRIVER_ID, Lockstep
from mcp_asdf_tools.robots.node import FrameTaker, Subjects
from mcp_asdf_tools.robots.robot_setup import RobotSetup
from mcp_asdf_tools.swarm.carrier import Wiring
from mcp_asdf_tools.swarm.fault_injection.kinds import Crash
from mcp_asdf_tools.swarm.settings import MAX_ROBOTS_AND_TOOLS, SwarmSettings

ANSWER_TIMEOUT = 10.0
"""Seconds that a robot has to answer."""

_HOW_TO_HAVE_A_BUS_EACH = "write {robot} where the id stands in the channel, such as --channel 'vcan{robot}'"


def check_remote(settings: SwarmSettings, wiring: Wiring) -> None:
    """Check that a swarm with these settings can have the remote robots of ``wiring``, if there are any.

    Remote robots run in other programs, and a driver commands them over the bus. Raises UsageError

    - if there are so many robots that no id is left for the driver,
    - if a remote robot's id is none of the swarm's,
    - if the estimates have the subject of commands or of telemetry,
    - if a fault would crash a remote robot, which is beyond this program's reach, or
    - if the robots share a bus, but a setting needs a bus for each (`_check_remote_on_shared_bus`).
    """
    remote = wiring.remote
    if not remote:
        return
    if settings.robots > MAX_ROBOTS_AND_TOOLS:
        raise UsageError(
            f"robots is {settings.robots}; with robots elsewhere take at most {MAX_ROBOTS_AND_TOOLS}, since "
            f"id {DRIVER_ID} commands them"
        )
    all_robots = set(range(settings.robots))
    if not remote <= all_robots:
        raise UsageError(f"robot {max(remote)} is to run elsewhere, but ids are 0 to {settings.robots - 1}")
    # The driver needs subjects for commands and telemetry, too. The class refuses equal ones.
    Subjects(estimates=settings.frames)
    for fault in settings.faults:
        affected_robots = fault.robots or all_robots  # a fault without robots affects all
        if isinstance(fault, Crash) and not remote.isdisjoint(affected_robots):
            raise UsageError(
                f"fault {fault} cannot affect robots that run elsewhere; name others, or use busoff"
            )
    if wiring.is_shared:
        _check_remote_on_shared_bus(settings, is_every_robot_remote=remote == all_robots)


def _check_remote_on_shared_bus(settings: SwarmSettings, *, is_every_robot_remote: bool) -> None:
    """Check that remote robots can share one bus, on which all of them receive all frames at once.

    Raises UsageError if some robots are not remote, or if faults, latency or the topology would have to keep
    a frame from a robot.
    """
    if not is_every_robot_remote:
        raise UsageError(f"robots here and elsewhere need a bus each: {_HOW_TO_HAVE_A_BUS_EACH}")
    # On one bus every frame reaches every robot at once, and nothing can keep it from one.
    has_faults = len(settings.faults) > 0
    if has_faults or settings.latency > 0 or settings.topology != "fully-connected":
        raise UsageError(
            "robots elsewhere on one bus all hear each other; for faults, latency or a topology "
            f"{_HOW_TO_HAVE_A_BUS_EACH}"
        )


class RemoteFirmware:
    """State of a remote robot as far as its commands and frames reveal it, in place of a firmware.

    It has all that a ``BusRobot`` uses of a firmware, so that a ``BusRobot`` made with it can count the ticks
    and frames of the remote robot. b_hat is known to 24 bits and x to 23, as telemetry has them.

    Attributes:
        id: Robot id.
        t: Number of observations that it was commanded to make.
        b_hat: Assumed accuracy.
        x: Informed estimate.
        x_hat: Local estimate, as of the last broadcast.
        counters: Diagnostics, of which only the number of updates is known.
    """

    def __init__(self, setup: RobotSetup) -> None:
        """Begin with what is known of a robot before its first frame: the setup that it was started with."""
        self.id = setup.id
        self.t = 0
        self.b_hat = setup.b_hat
        # Without observations and neighbours a robot takes half of the tiles for black.
        self.x = 0.5
        self.x_hat = 0.5
        self.counters = Counters()

    def observe(self, z: Observation) -> None:
        """Count an observation that the robot was commanded to make, whatever its colour."""
        self.t += 1

    def receive_all(self, estimates: EstimateRows) -> int:
        """Return the number of estimates, as if the robot accepted all. It gets them where it runs."""
        return len(estimates)

    def settle(self) -> None:
        """Do nothing: the robot was commanded to settle."""

    def update_from_estimate(self, estimate: Estimate) -> None:
        """Take x_hat, the robot's local estimate, from its broadcast."""
        self.x_hat = estimate.x_hat / Q23_ONE

    def update_from_telemetry(self, telemetry: Telemetry) -> None:
        """Take x, b_hat and the number of updates from the robot's answer to *settle*.

        Call this in every tick: the number of updates in telemetry wraps.
        """
        self.x = telemetry.x / Q23_ONE
        self.b_hat = telemetry.b_hat / B_HAT_UNITS
        # Telemetry has the lowest 8 bits of the number of updates. That suffices as it comes in every tick.
        updates = self.counters.updates
        new_updates = (telemetry.updates - updates) % UPDATE_COUNT_MODULUS
        self.counters = Counters(updates=updates + new_updates)


class Driver:
    """Commands the remote robots on one bus, tick by tick: ``observe``, then ``settle``.

    Attributes:
        nodes: The halves of the robots in this process, by id.
    """

    def __init__(
        self,
        bus: can.BusABC,
        nodes: Sequence[BusRobot],
        frame_format: FrameFormat,
        on_frame: FrameTaker = lambda frame: None,
        order_matters: bool = False,
    ) -> None:
        """Prepare to command robots; nothing is sent yet.

        Args:
            bus: A connection to their bus, which is left open at the end.
            nodes: The robots' counterparts in this process.
            frame_format: Format of their estimates.
            on_frame: Called with every frame that comes over the bus, and with every command.
            order_matters: Whether robots have to broadcast by rising id, as the robust filter needs it. A
                robot is commanded to observe only when those of lower ids have broadcast.
        """
        self.nodes = {node.id: node for node in nodes}
        self._frame_format = frame_format
        self._on_frame = on_frame
        self._order_matters = order_matters
        self._frames_for_next_tick: list[can.Message] = []
        """Frames of the robots that are neither estimates nor answers to commands."""
        self._estimate_frames: dict[int, can.Message] = {}
        """Frames of the estimates of this tick, by sender."""
        self._lockstep = Lockstep(
            bus,
            Subjects(estimates=frame_format),
            ANSWER_TIMEOUT,
            on_frame=self._handle_frame,
        )

    def wait_until_up(self, timeout: float, check: Callable[[], None]) -> None:
        """Wait until all robots have sent a heartbeat.

        ``check`` is called during this wait and all later ones; it may raise an error that ends them. Raises
        LockstepError after ``timeout`` seconds.
        """
        self._lockstep.check = check
        self._lockstep.wait_until_up(self.nodes, timeout)

    def observe(self, observations: Mapping[int, Observation | None]) -> list[tuple[BusRobot, can.Message]]:
        """Let robots observe, by id, and return the frames that count as sent in this tick, with the sender.

        These are first all frames of the last tick but estimates and telemetry, since it is unpredictable
        when such frames come, and then the estimates of this tick, by rising id. Raises UsageError if a robot
        has the driver's id, LockstepError if a robot does not broadcast in time, and can.CanError if the bus
        does not take the commands.
        """
        other_frames = self._frames_for_next_tick
        self._frames_for_next_tick = []
        self._estimate_frames = {}
        if self._order_matters:
            # Each robot costs a wait of its own, so this is only for a filter that needs the order.
            for robot in sorted(observations):
                self._observe_at_once({robot: observations[robot]})
        else:
            self._observe_at_once(observations)
        estimate_frames = [self._estimate_frames[robot] for robot in sorted(self._estimate_frames)]
        return [(self.nodes[sender_of(frame)], frame) for frame in other_frames + estimate_frames]

    def _observe_at_once(self, observations: Mapping[int, Observation | None]) -> None:
        """Command robots to observe, and wait for the estimates of those that broadcast in this tick.

        Their counterparts in this process observe, too, and take x_hat from the estimates. Raises UsageError
        if a robot has the driver's id, LockstepError if one does not broadcast in time, and can.CanError if
        the bus does not take the commands.
        """
        self._lockstep.observe(observations)
        broadcasting_robots = []
        for robot, observation in observations.items():
            # The counterpart in this process counts the robot's ticks, so it knows when a broadcast is due.
            is_broadcast_due = self.nodes[robot].observe(observation)
            if is_broadcast_due:
                broadcasting_robots.append(robot)
        for robot, estimate in self._lockstep.wait_for_estimates(broadcasting_robots).items():
            self._firmware(robot).update_from_estimate(estimate)

    def settle(self, robots: Collection[int]) -> None:
        """Command ``robots`` to settle: to end the tick. Their telemetry updates what is known of them.

        Raises LockstepError if one does not answer in turn, can.CanError if the bus does not take the
        commands.
        """
        for robot, telemetry in self._lockstep.settle(robots).items():
            self._firmware(robot).update_from_telemetry(telemetry)
            self.nodes[robot].settle()
        # Frames of different robots come in any order: sorted, a run does not depend on it.
        self._frames_for_next_tick.sort(key=sender_of)

    def _firmware(self, robot: int) -> RemoteFirmware:
        """Return the known state of a robot."""
        firmware = self.nodes[robot].robot
        assert isinstance(firmware, RemoteFirmware)
        return firmware

    def _handle_frame(self, frame: can.Message) -> None:
        """Report a frame on the bus to ``on_frame``, and keep it if one of the robots sent it.

        An estimate is kept for this tick, the first of each robot only; telemetry is not, since it is the
        answer to *settle*; any other frame is kept for the next tick. An error frame is counted by all
        robots.
        """
        self._on_frame(frame)
        if frame.is_error_frame:  # its identifier describes the error, and has no sender
            for node in self.nodes.values():
                node.count_content(Rejection.ERROR_FRAME)
            return
        sender = sender_of(frame)
        if sender not in self.nodes or isinstance(decode_telemetry(frame), Telemetry):
            return
        if isinstance(decode_estimate(frame, self._frame_format), Estimate):
            self._estimate_frames.setdefault(sender, frame)  # keeps the first
        else:
            self._frames_for_next_tick.append(frame)
