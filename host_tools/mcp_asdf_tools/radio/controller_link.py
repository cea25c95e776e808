"""A controller and its model side by side: both get the same frames, and their answers are compared.

The controller is driven in lockstep by command frames on the bus. The model, the firmware's mirror as a node,
is given the very frames that go over the bus. Whenever a tick is settled, all frames that the two have sent
since are compared.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import can

from mcp_asdf.mirror import MirrorRobot
from mcp_asdf.robot import Observation
from mcp_asdf_tools.bus.frame_layout import EVERY_ROBOT
from mcp_asdf_tools.bus.frames import Command, Estimate, decode_command, decode_estimate, sender_of
from mcp_asdf_tools.radio.comparison import Comparison, Difference, is_from
from mcp_asdf_tools.radio.neighbourhood import RadioSettings
from mcp_asdf_tools.robots.bus_robot import Recorder
from mcp_asdf_tools.robots.lockstep import Lockstep
from mcp_asdf_tools.robots.node import RobotNode, send_all

_SEND_TIMEOUT = 2.0
"""Seconds after which a bus that takes no frame counts as failed."""
_LATE_FRAMES_SECONDS = 0.1
"""Seconds to listen for more frames after the controller's last answer."""


class ControllerDiffers(Exception):  # noqa: N818 (an outcome, no error)
    """The controller has sent other frames than the model. The text of the exception describes how."""


class BusDisturbed(Exception):  # noqa: N818 (an outcome, no error)
    """Another node, named in the message, sends what the controller acts on and the model does not get."""


@dataclass
class BenchOptions:
    """Connection to a controller, and how its verification is run.

    Attributes:
        bus: Connection to the controller.
        ticks: Ticks of a phase among emulated neighbours, unless two rounds are longer.
        timeout: Seconds that the controller has to answer.
        wait: Seconds to wait for the heartbeat with which it starts; None to begin at once.
        recorder: Takes the controller's events; None if they are not recorded.
        log: Called with every frame, sent and received.
        progress: Called after each settled tick with the number of ticks so far.
        should_stop: Called before each tick, and between ticks while the controller is waited for. If it
            returns True, the verification ends.
    """

    bus: can.BusABC
    ticks: int
    timeout: float
    wait: float | None = None
    recorder: Recorder | None = None
    log: Callable[[can.Message], None] = lambda frame: None
    progress: Callable[[int], None] = lambda ticks: None
    should_stop: Callable[[], bool] = lambda: False


class ControllerLink:
    """Connection to a controller that has just started, with its model beside it.

    A tick is ``observe``, ``send`` for the frames of others, and ``settle_and_compare``.

    Attributes:
        settings: The controller, its neighbours, and the formats of the frames.
        options: The connection, time limits and callbacks.
        setup: Initial state of the controller.
        config: Configuration of the controller's firmware.
        model_robot: The mirror robot that the controller's firmware must equal, bit for bit.
        model_node: The node around ``model_robot``; it returns the frames that the controller must send.
        comparison: Comparison of the controller's frames with the model's, with the number of equal ones.
        lockstep: Sends the commands of each tick and waits for the controller's answers.
        tick_index: Index of the tick that was begun last by ``observe``, from 0.
    """

    def __init__(self, settings: RadioSettings, options: BenchOptions) -> None:
        """Start the model. Nothing is sent to the controller yet."""
        self.settings = settings
        self.options = options
        self.setup = settings.controller
        self.config = self.setup.config
        self.model_robot = MirrorRobot(self.config, self.setup.id, self.setup.b_hat)
        self.model_node = RobotNode(
            self.setup,
            settings.subjects,
            settings.swarm.steps_per_second,
            options.recorder,
            make=lambda: self.model_robot,
        )
        (first_heartbeat,) = self.model_node.start()
        self.comparison = Comparison(settings.subjects, first_heartbeat)
        self.lockstep = Lockstep(
            options.bus,
            settings.subjects,
            options.timeout,
            on_frame=self._handle_frame,
            check=self._check_stop,
        )
        self.tick_index = 0
        self._tick_numbers_skipped = 0
        # Frames that the controller and its model have sent since the last comparison.
        self._received_frames: list[can.Message] = []
        self._expected_frames: list[can.Message] = []

    @property
    def ticks(self) -> int:
        """Number of ticks that have ended, with or without a settle."""
        return self.lockstep.tick - self._tick_numbers_skipped

    # --- One tick ---

    def observe(self, observation: Observation | None) -> None:
        """Begin a tick with this observation, or none, and wait for the controller's broadcast if one is due.

        ``tick_index`` is the index of this tick from now on.
        Raises LockstepError if the broadcast does not come, and KeyboardInterrupt if asked to stop.
        """
        self._check_stop()
        self.tick_index = self.ticks
        must_broadcast = self._send_observe_command(observation)
        if must_broadcast:
            self.lockstep.wait_for_estimates({self.setup.id})  # waits for the controller's estimate

    def _send_observe_command(self, observation: Observation | None) -> bool:
        """Command an observation, or none, and return whether the controller must broadcast in this tick.

        It must if its model does.
        """
        broadcasts_before = self.model_node.sent.estimates
        # Lockstep passes the command to _handle_frame, by which the model gets it and answers at once.
        self.lockstep.observe({self.setup.id: observation})
        return self.model_node.sent.estimates != broadcasts_before

    def send(self, frames: Sequence[can.Message]) -> None:
        """Send frames to the controller and to the model, in order.

        Raises ``can.CanError`` if the bus takes no frame for 2 seconds, or fails.
        """
        send_all(self.options.bus, frames, _SEND_TIMEOUT)
        # The bus does not return them; here they are handled as frames that were sent.
        for frame in frames:
            self._handle_frame(frame)

    def settle_and_compare(self) -> None:
        """Command the end of the tick, and compare all frames of controller and model since the last time.

        Raises LockstepError if the controller does not answer, and ControllerDiffers if its frames differ.
        """
        self.lockstep.settle({self.setup.id})
        self.compare()
        self.options.progress(self.ticks)

    def skip_settle(self, distance: int = 1) -> None:
        """Send no settle command in this tick, as if it were lost: the next observe command ends the tick.

        The controller may report this in its health. The number of the next tick is ``distance`` higher, or
        lower if that is negative.
        """
        self.lockstep.skip_settle(distance)
        self._tick_numbers_skipped += distance - 1  # the number of the next tick is usually 1 higher
        self.comparison.is_advisory_allowed = True

    def _check_stop(self) -> None:
        """Raise KeyboardInterrupt if the caller wants the verification to stop, but not within a tick."""
        is_between_ticks = self.model_node.is_settled
        if is_between_ticks and self.options.should_stop():
            raise KeyboardInterrupt

    # --- Comparison ---

    def compare(self) -> None:
        """Compare all frames since the last comparison, and raise ControllerDiffers if they are not equal."""
        difference = self.pop_difference()
        if difference is not None:
            raise ControllerDiffers(str(difference))

    def pop_difference(self) -> Difference | None:
        """Return the first difference among the frames since the last comparison, and forget these frames.

        Returns None if all are equal.
        """
        received, expected = self._received_frames, self._expected_frames
        self._received_frames, self._expected_frames = [], []
        return self.comparison.check(received, expected)

    def compare_late_frames(self) -> None:
        """Receive for another 0.1 seconds, and raise ControllerDiffers if the controller sends anything.

        It has sent its last answer before, so that the model sends nothing in this time.
        """
        end = time.monotonic() + _LATE_FRAMES_SECONDS
        frame = self.options.bus.recv(_LATE_FRAMES_SECONDS)
        while frame is not None:
            # Some interfaces also return the frames that this program has sent.
            if frame.is_rx:
                self._handle_frame(frame)
            # Other nodes may send without a pause, so that recv never returns None.
            seconds_left = end - time.monotonic()
            frame = self.options.bus.recv(seconds_left) if seconds_left >= 0 else None
        self.compare()

    # --- Frames on the bus ---

    def _handle_frame(self, frame: can.Message) -> None:
        """Log a frame, and keep it for the comparison if the controller has sent it.

        A frame that was sent to the controller goes to the model, too, whose answers are kept as expected
        ones. Raises BusDisturbed for a frame of another node on which the controller acts.
        """
        is_sent_to_controller = not frame.is_rx  # is_rx marks frames that were received from the bus
        if is_sent_to_controller:
            frame.timestamp = time.time()
            self._expected_frames += self.model_node.receive_frame(frame)
            self.options.log(frame)
            return
        self.options.log(frame)
        if is_from(frame, self.setup.id):
            self._received_frames.append(frame)
        else:
            self._check_other_node(frame)

    def _check_other_node(self, frame: can.Message) -> None:
        """Raise BusDisturbed if a frame of another node is an estimate, or a command for the controller."""
        subjects = self.settings.subjects
        command = decode_command(frame, subjects.commands)
        if isinstance(command, Command) and command.target in (self.setup.id, EVERY_ROBOT):
            kind = "commands"
        elif isinstance(decode_estimate(frame, subjects.estimates), Estimate):
            kind = "estimates"
        else:
            return
        raise BusDisturbed(
            f"node {sender_of(frame)} sends {kind} on this bus, too, and the "
            "controller hears them: take it off the bus, or give it other subjects"
        )
