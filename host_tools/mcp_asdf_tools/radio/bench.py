"""Test bench: controller and model side by side on one bus, and what a phase can let happen to both.

The controller is driven in lockstep by command frames; the model, the firmware's mirror as a node, is given
the very frames that go over the bus. Whenever a tick is settled, all frames that the two have sent since are
compared.
"""

from __future__ import annotations

import random
import time
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import can

from mcp_asdf.robot import MAX_ID, Filter, Observation
from mcp_asdf_tools.bus.frame_layout import EVERY_ROBOT, TRANSFER_IDS, Action
from mcp_asdf_tools.bus.frames import (
    NODE_ID_MASK,
    Command,
    Estimate,
    Telemetry,
    decode_command,
    decode_estimate,
    decode_telemetry,
    encode_estimate,
)
from mcp_asdf_tools.radio.comparison import Comparison, Difference, is_from
from mcp_asdf_tools.radio.neighbourhood import Neighbourhood, RadioSettings
from mcp_asdf_tools.radio.rounds import Content, Situation
from mcp_asdf_tools.radio.suspects import FollowedRobot, Lineup
from mcp_asdf_tools.robots.bus_robot import Recorder
from mcp_asdf_tools.robots.lockstep import DRIVER_ID, Lockstep
from mcp_asdf_tools.robots.node import RobotNode, send_all

SEND_TIMEOUT = 2.0
BURST = 16
"""Ticks of which only the last is settled, where many pass in a row: so many commands must a controller be
able to take at the bus's own speed."""
_AFTERMATH = 0.1
"""Seconds to listen after the last answer."""


class Differs(Exception):  # noqa: N818 (an outcome, no error)
    """The controller differs from the model."""

    def __init__(self, difference: Difference, mistakes: Sequence[str] = ()) -> None:
        """Take the difference, and what controllers do that would have sent the same telemetry."""
        also = f"; so would answer a controller that {', or one that '.join(mistakes)}" if mistakes else ""
        super().__init__(f"{difference}{also}")
        self.difference = difference


class Disturbed(Exception):  # noqa: N818 (an outcome, no error)
    """The controller heard another node, which the message names: the model cannot follow any more."""


@dataclass
class BenchOptions:
    """Connection to a controller and how its test is run.

    Attributes:
        bus: Connection to the controller.
        ticks: Ticks of a phase among emulated neighbours, unless two rounds are longer.
        timeout: Seconds that the controller has to answer.
        wait: Seconds to wait for the heartbeat with which it starts; None to begin at once.
        recorder: Takes the controller's events; None if they are not recorded.
        log: Takes all frames, sent and heard.
        progress: Called after each settled tick with the number of ticks done.
        should_stop: Checked before each tick, and while the controller is waited for between ticks.
    """

    bus: can.BusABC
    ticks: int
    timeout: float
    wait: float | None = None
    recorder: Recorder | None = None
    log: Callable[[can.Message], None] = lambda frame: None
    progress: Callable[[int], None] = lambda ticks: None
    should_stop: Callable[[], bool] = lambda: False


class Bench:
    """A controller that has just started, and its model.

    Attributes:
        settings: The surroundings.
        record: How the controller starts.
        config: Its configuration.
        options: Connection, time limits and observers.
        firmware: The firmware that the controller must equal, bit for bit.
        lineup: Models with a mistake that no frame has told apart from the firmware.
        model: The node around it, which says what the controller must say.
        neighbours: Emulated robots around the controller, for phases that want them.
        draw: Random numbers, the same in every run with this seed.
        doing: What is done at present, in words.
        place: Number of ticks before the last that was settled or is to be.
        missed: What could not be put to the test, in words.
        comparison: The frames compared so far.
    """

    def __init__(self, settings: RadioSettings, options: BenchOptions) -> None:
        own, subjects = settings.controller, settings.subjects
        self.settings, self.record, self.options = settings, own, options
        self.config = own.config
        self.firmware = FollowedRobot(own.config, own.id, own.b_hat)
        self.lineup = self.firmware.lineup = Lineup.beside(self.firmware, own)
        self.model = RobotNode(
            own, subjects, settings.swarm.steps_per_second, options.recorder, lambda: self.firmware
        )
        self.neighbours = Neighbourhood(settings)
        self.draw = random.Random(settings.swarm.seed)
        self.doing = ""
        self.place = self._skipped = 0
        self.missed: list[str] = []
        (greeting,) = self.model.start()
        self.comparison = Comparison(subjects, greeting)
        self.lockstep = Lockstep(
            options.bus, subjects, options.timeout, watch=self._note, check=self._check_stop
        )
        self._id = own.id
        self._said: list[can.Message] = []
        self._expected: list[can.Message] = []
        self._numbers: Counter[int] = Counter()

    # --- The controller's situation ---

    @property
    def others(self) -> list[int]:
        """Ids that messages can have: all but the controller's."""
        return [robot for robot in range(MAX_ID + 1) if robot != self._id]

    @property
    def ticks(self) -> int:
        """Ticks ended, settled or not."""
        return self.lockstep.tick - self._skipped

    @property
    def situation(self) -> Situation:
        """The controller's state, for which rounds are crafted."""
        s, is_adaptive = self.firmware.s, self.config.filter is Filter.ADAPTIVE
        return Situation(s.t, s.n, s.x_hat, self.config.table if is_adaptive else None)

    def any_observation(self) -> Observation:
        """Black a bit more often than white, so that b_hat can be re-estimated on both sides of 1/2."""
        s = self.firmware.s
        is_black = 5 * s.n < 3 * s.t
        return Observation(is_black if self.draw.random() < 0.8 else not is_black)

    # --- One tick ---

    def observe(self, z: Observation | None) -> None:
        """Begin a tick, and hear the broadcast if it is due."""
        self._check_stop()
        self.place = self.ticks
        if self._begin_tick(z):
            self.lockstep.estimates({self._id})

    def _begin_tick(self, z: Observation | None) -> bool:
        """Command an observation; returns whether a broadcast is due."""
        broadcasts = self.model.sent.estimates
        self.lockstep.observe({self._id: z})
        is_due = self.model.sent.estimates != broadcasts
        if is_due:
            self.lineup.note_broadcast(self.firmware)
        return is_due

    def send(self, frames: Sequence[can.Message]) -> None:
        """Let the controller and the model hear frames, in order."""
        send_all(self.options.bus, frames, SEND_TIMEOUT)
        for frame in frames:
            self._note(frame)

    def settle(self) -> None:
        """End the tick, and compare. Raises Differs."""
        self.lockstep.settle({self._id})
        self.compare()
        self.options.progress(self.ticks)

    def leave_open(self, distance: int = 1) -> None:
        """End the tick as if its settle were lost; the controller may complain about it from now on.

        The number of the next tick is so much higher, or lower.
        """
        self.lockstep.leave_open(distance)
        self._skipped += distance - 1
        self.comparison.is_advisory_allowed = True

    def tick(self, z: Observation | None = None, frames: Sequence[can.Message] = ()) -> None:
        """A whole tick, in which these frames come."""
        self.observe(z)
        self.send(frames)
        self.settle()

    def tick_among_neighbours(self) -> None:
        """A tick in which emulated neighbours hear the controller, and it hears them."""
        self.observe(self.neighbours.begin())
        self.send(self.neighbours.finish(list(self._said)))
        self.settle()

    # --- Many ticks ---

    def skip(self, ticks: int, observe: Callable[[], Observation | None] = lambda: None) -> None:
        """Let ticks pass quickly: in bursts of which only the last tick is settled."""
        while ticks > 0:
            burst = min(ticks, BURST)
            for _ in range(burst - 1):
                self._begin_tick(observe())
                self.leave_open()
            self.tick(observe())
            ticks -= burst

    def command(self, action: Action) -> Command:
        """A command of this tick for the controller."""
        return Command(DRIVER_ID, self.lockstep.tick, self._id, action, self.draw.randrange(TRANSFER_IDS))

    def round(self, *contents: Content, senders: Sequence[int] | None = None) -> None:
        """A whole round with these messages, of random neighbours unless ``senders`` are given."""
        chosen = self.draw.sample(self.others, len(contents)) if senders is None else senders
        self.round_of(self.messages(dict(zip(chosen, contents, strict=True))))

    def round_of(self, frames: Sequence[can.Message]) -> None:
        """A whole round in which these frames come, in its first tick and in its last."""
        period = self.record.comms_period
        self.skip(-self.model.ticks % period)
        half = len(frames) // 2
        if period > 1:
            self.tick(None, frames[:half])
            self.skip(period - 2)
        self.tick(None, frames if period == 1 else frames[half:])

    def messages(self, contents: dict[int, Content] | Iterable[tuple[int, Content]]) -> list[can.Message]:
        """Frames of estimates by their senders, numbered as each sender does."""
        pairs = contents.items() if isinstance(contents, dict) else contents
        return [self._message(sender, *content) for sender, content in pairs]

    def _message(self, sender: int, x_hat: int, alpha: int) -> can.Message:
        self._numbers[sender] += 1
        message = Estimate(sender, x_hat, alpha, (self._numbers[sender] - 1) % TRANSFER_IDS)
        return encode_estimate(message, self.settings.subjects.estimates)

    # --- The filter's rounds ---

    def to_test(self, observe: Callable[[], Observation | None] = lambda: None, before: int = 0) -> None:
        """Let ticks pass until the round of the next test begins, or ``before`` rounds earlier."""
        period = self.record.filter_period
        round_begins = period - (1 + before) * self.record.comms_period
        self.skip((round_begins - self.model.ticks) % period, observe)

    def avoid_test(self, doing: str, rounds: int = 1) -> None:
        """Begin with ``doing`` after rounds without messages if one of the next ``rounds`` has a test, unless
        all have."""
        config = self.config
        if config.filter is not Filter.OFF and config.filter_period > 1:
            for number in range(rounds, 0, -1):
                if (self.model.ticks + number * self.record.comms_period) % self.record.filter_period == 0:
                    self.round()
        self.doing = doing

    # --- Comparing ---

    def compare(self) -> None:
        """Compare all frames since the last comparison. Raises Differs.

        If they are equal, what has shown in them is no mistake of the controller, and leaves the lineup.
        """
        telemetry = self._telemetry_fields()
        difference = self.take_difference()
        if difference is not None:
            raise Differs(difference, self.lineup.answers_like(telemetry, self.firmware))
        self.lineup.drop_different(self.firmware)

    def _telemetry_fields(self) -> tuple[int, int, int] | None:
        """Return x, b_hat and updates of the controller's last telemetry; None if none has come."""
        for frame in reversed(self._said):
            telemetry = decode_telemetry(frame, self.settings.subjects.telemetry)
            if isinstance(telemetry, Telemetry):
                return telemetry.x, telemetry.b_hat, telemetry.updates
        return None

    def take_difference(self) -> Difference | None:
        """Return the first difference among the frames since the last comparison, and forget these frames.

        Returns None if all are equal.
        """
        said, expected = self._said, self._expected
        self._said, self._expected = [], []
        return self.comparison.check(said, expected)

    def listen_on(self) -> None:
        """Check that nothing comes after the last answer. Raises Differs."""
        end = time.monotonic() + _AFTERMATH
        while (frame := self.options.bus.recv(max(0.0, end - time.monotonic()))) is not None:
            if frame.is_rx:
                self._note(frame)
            if time.monotonic() > end:
                break
        self.compare()

    def _check_stop(self) -> None:
        """Raises KeyboardInterrupt if asked to stop, but not within a tick."""
        if self.model.is_settled and self.options.should_stop():
            raise KeyboardInterrupt

    def _note(self, frame: can.Message) -> None:
        """Take a frame on the bus, in either direction; the model hears those sent to the controller."""
        if not frame.is_rx:
            frame.timestamp = time.time()
            self._expected += self.model.hear(frame)
        self.options.log(frame)
        if frame.is_rx and is_from(frame, self._id):
            self._said.append(frame)
        elif frame.is_rx:
            self._check_disturbance(frame)

    def _check_disturbance(self, frame: can.Message) -> None:
        """Raises Disturbed if the controller heeds another node's frame."""
        subjects = self.settings.subjects
        command = decode_command(frame, subjects.commands)
        is_obeyed = isinstance(command, Command) and command.target in (self._id, EVERY_ROBOT)
        if is_obeyed or isinstance(decode_estimate(frame, subjects.estimates), Estimate):
            kind = "commands" if is_obeyed else "estimates"
            raise Disturbed(
                f"node {frame.arbitration_id & NODE_ID_MASK} sends {kind} on this bus, too, and the "
                "controller hears them: take it off the bus, or give it other subjects"
            )
