"""Controllers that are wrong, each in one way, with the phase that finds it.

Most are mistakes that one makes when porting the firmware or writing a node from docs/frame.md.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from typing import Any, cast

import can
from mpmath import mp  # type: ignore[import-untyped]

from mcp_asdf.fixed_point import B_HAT_MAX, B_HAT_MIN, HALF, ONE, alpha_units, alpha_word
from mcp_asdf.mirror import MirrorRobot, accuracy_of, estimate, reestimate, rejects
from mcp_asdf.robot import Filter, Observation, Status
from mcp_asdf.table import FRACTION_BITS, Table
from mcp_asdf_tools.bus.frames import (
    COMMANDS,
    EVERY_ROBOT,
    Action,
    Command,
    FrameFormat,
    Message,
    Rejection,
    alpha_bits,
    bits_of,
    decode,
    decode_command,
    word_of,
)
from mcp_asdf_tools.robots.lockstep import DRIVER_ID
from mcp_asdf_tools.robots.node import NodeSettings, RobotNode
from mcp_asdf_tools.robots.record import RobotRecord
from mcp_asdf_tools.robots.rounds import TickedRobot
from mcp_asdf_tools.tables.thresholds import _t_score, generate, parse_omega
from wire import TABLE, record

ID, B_HAT = 3, 0.55
Frames = list[can.Message]


def right(**config: Any) -> RobotRecord:
    """The controller as the verification is told that it is."""
    return record(ID, "mirror", B_HAT, **config)


@dataclass(frozen=True)
class Wrong:
    """A wrong controller.

    Attributes:
        phase: Phase that finds it.
        node: Its node.
        firmware: Its firmware.
        config: Its settings where they differ from the default.
        actual: Settings that it really has, other than said.
        robot: Its id, if another than said.
    """

    phase: str
    node: type[RobotNode] = RobotNode
    firmware: type[MirrorRobot] = MirrorRobot
    config: dict[str, Any] = field(default_factory=dict)
    actual: dict[str, Any] = field(default_factory=dict)
    robot: int = ID
    b_hat: float = B_HAT
    prepare: Callable[[RobotNode], object] = lambda node: None

    def make(self) -> RobotNode:
        """The controller."""
        own = record(self.robot, "mirror", self.b_hat, **{**self.config, **self.actual}).config
        robot = self.firmware(own.in_rounds(), self.robot, self.b_hat)
        node = self.node(TickedRobot(robot, own.comms_period), NodeSettings(self.robot))
        self.prepare(node)
        return node


# --- Wrong firmwares: the method ---


class Hooked(MirrorRobot):
    """The right filter, in parts that others replace."""

    def decides(self) -> bool:
        """The test (eq. 12)."""
        assert self.config.table is not None
        return rejects(self.config.table, self.s.open, self.s.x_hat)

    def new_b_hat(self) -> int | None:
        """Eq. 8."""
        return reestimate(self.s.t, self.s.n, self.s.closed)

    def least(self) -> int:
        """The fewest messages of a test."""
        return 2

    def _filter(self) -> bool:
        s = self.s
        if s.t == 0 or s.open.count < self.least() or not self.decides():
            return False
        b_hat = self.new_b_hat()
        if b_hat is None:
            return False
        s.accuracy = accuracy_of(b_hat)
        s.updates, s.updated = s.updates + 1, 1
        return True


def eq_8(wrong: Callable[[int | None], int | None]) -> type[Hooked]:
    """A firmware that makes something else of the right new b_hat; None is none."""

    def new_b_hat(self: Hooked) -> int | None:
        return wrong(Hooked.new_b_hat(self))

    return type("WrongEq8", (Hooked,), {"new_b_hat": new_b_hat})


def always(name: str, result: object) -> type[Hooked]:
    """A firmware of which one part has always the same result."""
    return type("Always", (Hooked,), {name: lambda self: result})


def hearing(
    wrong: Callable[[MirrorRobot, int, int, int], tuple[int, int, int] | None],
) -> type[MirrorRobot]:
    """A firmware that hears another message than the one received, or none."""

    def receive(self: MirrorRobot, *message: int) -> Status:
        heard = wrong(self, *message)
        return Status.ERR_SENDER if heard is None else MirrorRobot._receive(self, *heard)

    return type("WrongEar", (MirrorRobot,), {"_receive": receive})


def at_most(most: int) -> type[MirrorRobot]:
    """A firmware with room for so many messages in a round."""
    return hearing(lambda robot, *message: message if robot.s.open.count < most else None)


def below(bound: int) -> type[MirrorRobot]:
    """A firmware that hears robots with smaller ids only."""
    return hearing(lambda robot, *message: message if message[0] < bound else None)


def with_alpha(wrong: Callable[[int], int]) -> type[MirrorRobot]:
    """A firmware that takes other confidences for those received."""
    return hearing(lambda robot, sender, x_hat, alpha: (sender, x_hat, wrong(alpha)))


class TestsOneMessage(Hooked):
    def least(self) -> int:
        return 1

    def decides(self) -> bool:
        return self.s.open.count == 1 or super().decides()


class VarianceOverM(Hooked):
    def decides(self) -> bool:
        m, open_ = self.s.open.count, self.s.open
        assert self.config.table is not None
        difference = open_.x - m * self.s.x_hat
        spread = m * open_.x_squared - open_.x**2
        return difference**2 * m > (self.config.table.entry(m) * spread * (m - 1)) >> FRACTION_BITS


class NotStrict(Hooked):
    def decides(self) -> bool:
        m, open_ = self.s.open.count, self.s.open
        assert self.config.table is not None
        spread = m * open_.x_squared - open_.x**2
        return (open_.x - m * self.s.x_hat) ** 2 >= self.config.table.entry(m) * spread >> FRACTION_BITS


class TestsInformed(Hooked):
    """Compares its neighbours with x instead of x_hat."""

    def decides(self) -> bool:
        assert self.config.table is not None
        return rejects(self.config.table, self.s.open, self.x_raw)


class TestsThoseWithoutConfidence(MirrorRobot):
    """Takes messages with alpha = 0 into m and the sums of the test."""

    def _receive(self, sender: int, x_hat: int, alpha: int) -> Status:
        status = super()._receive(sender, x_hat, alpha)
        if status == Status.OK and alpha_units(alpha) == 0:
            open_ = self.s.open
            open_.x, open_.x_squared, open_.count = (
                open_.x + x_hat,
                open_.x_squared + x_hat**2,
                open_.count + 1,
            )
        return status


class UnweightedMean(Hooked):
    def new_b_hat(self) -> int | None:
        s, open_ = self.s, self.s.open
        closed = type(s.closed)(open_.count << 24, open_.x << 24 & 0xFFFFFFFF, open_.x << 24 >> 32)
        return reestimate(s.t, s.n, closed)


class AppliesAtOnce(Hooked):
    def _filter(self) -> bool:
        is_updated = super()._filter()
        if is_updated:
            self.s.x_hat, self.s.alpha = estimate(self.s.t, self.s.n, self.s.accuracy)
        return is_updated


class NeverAppliesHalf(MirrorRobot):
    """Divides by 2 b - 1 although it is nearly 0."""

    def observe(self, z: Observation) -> Status:
        status = super().observe(z)
        if self.s.alpha == 0:
            self.s.x_hat = ONE
        return status


class FiltersEveryRound(MirrorRobot):
    def settle(self) -> Status:
        self.s.filter_left = 1
        return super().settle()


class FirstTestLate(MirrorRobot):
    def __init__(self, *args: Any) -> None:
        super().__init__(*args)
        self.s.filter_left += 1


class KeepsTheRound(MirrorRobot):
    """Forgets to empty the open round when nothing new has come."""

    def settle(self) -> Status:
        is_silent = self.s.open.count == 0
        kept = vars(self.s.closed).copy()
        status = super().settle()
        if is_silent:
            vars(self.s.closed).update(kept)
        return status


class NeverEmpties(MirrorRobot):
    def settle(self) -> Status:
        kept = self.s.open
        status = super().settle()
        self.s.open = kept
        return status


class Bitmap(MirrorRobot):
    """Of 32 bits, for 128 senders."""

    def _receive(self, sender: int, x_hat: int, alpha: int) -> Status:
        if self.s.heard[0] >> sender % 32 & 1:
            return Status.REPEATED
        status = super()._receive(sender, x_hat, alpha)
        self.s.heard[0] |= 1 << sender % 32
        return status


class LastCounts(MirrorRobot):
    """Takes the last message of a sender instead of the first."""

    def __init__(self, *args: Any) -> None:
        super().__init__(*args)
        self.kept: dict[int, tuple[int, int]] = {}

    def _receive(self, sender: int, x_hat: int, alpha: int) -> Status:
        if sender != self.id and x_hat <= ONE:
            self.kept[sender] = x_hat, alpha
        return Status.OK

    def settle(self) -> Status:
        for sender, content in self.kept.items():
            super()._receive(sender, *content)
        self.kept = {}
        return super().settle()


class ColoursExchanged(MirrorRobot):
    def observe(self, z: Observation) -> Status:
        return super().observe(Observation(1 - z))


class RoundsXHat(MirrorRobot):
    """To nearest instead of down."""

    def observe(self, z: Observation) -> Status:
        status = super().observe(z)
        self.s.x_hat = min(self.s.x_hat + (0 < self.s.x_hat < HALF), ONE)
        return status


class TruncatesAlpha(MirrorRobot):
    def observe(self, z: Observation) -> Status:
        status = super().observe(z)
        self.s.alpha &= 0xFFFF_F01F
        return status


class BroadcastsX(MirrorRobot):
    """The informed estimate instead of its own."""

    @property
    def x_hat_raw(self) -> int:
        return self.x_raw


def halving(half: Callable[[int], int]) -> type[MirrorRobot]:
    """A firmware that rounds n otherwise when it halves."""

    def observe(self: MirrorRobot, z: Observation) -> Status:
        t, n = self.s.t, self.s.n + z
        status = MirrorRobot.observe(self, z)
        if self.s.t < t:
            self.s.n = half(n)
            self.s.x_hat, self.s.alpha = estimate(self.s.t, self.s.n, self.s.accuracy)
        return status

    return type("Halves", (MirrorRobot,), {"observe": observe})


# --- Wrong nodes: what they hear ---


class HearsItself(RobotNode):
    def _receive(self, message: Message) -> None:
        super()._receive(replace(message, sender=99) if message.sender == ID else message)


class ForgetsAfterAConflict(RobotNode):
    def _receive(self, message: Message) -> None:
        if message.sender == ID:
            self._ticked = right().make()
        super()._receive(message)


class StopsListening(RobotNode):
    """As with a receive buffer that is too small."""

    room = 60

    def hear(self, frame: can.Message) -> Frames:
        self.room -= 1
        is_command = frame.arbitration_id >> 8 & 0x1FFF == 3002
        answers = super().hear(frame) if self.room > 0 or is_command else []
        self.room = 60 if answers else self.room
        return answers


class DropsCommandsInARow(RobotNode):
    """As with a buffer for four commands, emptied when it has time."""

    def __init__(self, *args: Any) -> None:
        super().__init__(*args)
        self.waiting = 0

    def _obey(self, command: Command) -> Frames:
        self.waiting = 0 if command.action is Action.SETTLE else self.waiting + 1
        return super()._obey(command) if self.waiting <= 4 else []


class DeafBetweenTicks(RobotNode):
    def _receive(self, message: Message) -> None:
        if not self.is_settled:
            super()._receive(message)


class LateCountsNow(RobotNode):
    """Takes messages after a settle for the round that is over."""

    def _receive(self, message: Message) -> None:
        if not self.is_settled:
            super()._receive(message)
        else:
            s = self.robot.s  # type: ignore[attr-defined]
            s.closed.alpha += alpha_units(message.alpha)


class RefusesLargeAlphas(RobotNode):
    """Instead of taking them for the largest."""

    def hear(self, frame: can.Message) -> Frames:
        is_estimate = isinstance(decode(frame, FrameFormat()), Message)
        return [] if is_estimate and alpha_bits(frame) >= bits_of(2.0**31) else super().hear(frame)


class DropsOlderTransfers(RobotNode):
    """Takes a smaller transfer id for an old message, like a stack that removes duplicates."""

    def __init__(self, *args: Any) -> None:
        super().__init__(*args)
        self.last: dict[int, int] = {}

    def _receive(self, message: Message) -> None:
        sender, number = message.sender, message.transfer_id
        if (number - self.last.get(sender, number - 1)) % 32 < 16:
            self.last[sender] = number
            super()._receive(message)


class ReadsWhat(RobotNode):
    """Reads an estimate out of frames that its codec should reject, as a check was left out."""

    def hear(self, frame: can.Message) -> Frames:
        return super().hear(self.mended(frame))

    def mended(self, frame: can.Message) -> can.Message:
        """The frame as a right codec must see it to take what this one takes."""
        raise NotImplementedError


def reading(mend: Callable[[can.Message], None], reason: Rejection) -> type[ReadsWhat]:
    """A node that reads frames which are rejected for a reason as if they were mended."""

    def mended(self: ReadsWhat, frame: can.Message) -> can.Message:
        if decode(frame, FrameFormat()) is not reason:
            return frame
        other = copy(frame)
        other.data = bytearray(frame.data)
        mend(other)
        return other

    return type("Reading", (ReadsWhat,), {"mended": mended})


def set_tail(bit: int) -> Callable[[can.Message], None]:
    """Sets a bit of the tail byte."""

    def mend(frame: can.Message) -> None:
        frame.data[7] |= bit

    return mend


def lengthen(frame: can.Message) -> None:
    """Add the tail byte that is missing."""
    if len(frame.data) == 7:
        frame.data, frame.dlc = frame.data + b"\xe0", 8


def lower_x_hat(frame: can.Message) -> None:
    """Take an estimate one unit above 1 for 1."""
    if frame.data[:3] == b"\x01\x00\x80":
        frame.data[0] = 0


def as_subject(mask: int) -> Callable[[can.Message], None]:
    """Compares these bits of the subject alone."""

    def mend(frame: can.Message) -> None:
        if (frame.arbitration_id >> 8 & 0x1FFF ^ 3000) & mask == 0:
            frame.arbitration_id = frame.arbitration_id & ~(0x1FFF << 8) | 3000 << 8

    return mend


class Lenient(RobotNode):
    """Reads an estimate out of anything with 8 bytes that it should reject for these reasons."""

    reasons: tuple[Rejection, ...] = ()

    def hear(self, frame: can.Message) -> Frames:
        if decode(frame, FrameFormat()) not in self.reasons:
            return super().hear(frame)
        content = int.from_bytes(frame.data.ljust(8, b"\0"), "little")
        alpha = word_of(min(content >> 24 & 0x7FFF_FFFF, 0x7F7F_FFFF))
        x_hat = min(content & 0xFF_FFFF, ONE)
        cast(MirrorRobot, self.robot).receive_raw(frame.arbitration_id & 0x7F, x_hat, alpha)
        return []


def accepting(reason: Rejection) -> type[Lenient]:
    """A node whose codec lets through what it should reject for this reason."""
    return type("Accepting", (Lenient,), {"reasons": (reason,)})


# --- Wrong nodes: commands ---


class SettlesInAnyTick(RobotNode):
    def _obey(self, command: Command) -> Frames:
        if command.action is Action.SETTLE and command.target in (ID, EVERY_ROBOT):
            self._tick_of_command = command.tick
        return super()._obey(command)


class StaysInATick(RobotNode):
    """Waits for the settle of the open tick, ignoring everything else."""

    def _obey(self, command: Command) -> Frames:
        is_stuck = not self.is_settled and command.tick != self._tick_of_command
        return [] if is_stuck else super()._obey(command)


class AnswersLate(RobotNode):
    """Answers a settle that has not come."""

    def observe(self, z: Observation | None) -> Frames:
        return ([] if self.is_settled else self.settle()) + super().observe(z)


class ForgetsARound(RobotNode):
    """Begins the next tick without ending the last."""

    def observe(self, z: Observation | None) -> Frames:
        self.is_settled = True
        return super().observe(z)


class ObeysOthers(RobotNode):
    def _obey(self, command: Command) -> Frames:
        return super()._obey(Command(command.sender, command.tick, ID, command.action, 0))


class ObservesTwice(RobotNode):
    def _obey(self, command: Command) -> Frames:
        is_repeated = not self.is_settled and command.tick == self._tick_of_command
        if is_repeated and command.action is not Action.SETTLE and command.target == ID:
            self._ticked.observe(command.action.observation)
        return super()._obey(command)


class IgnoresCommandsForAll(RobotNode):
    action: tuple[Action, ...] = tuple(Action)

    def _obey(self, command: Command) -> Frames:
        is_ignored = command.target == EVERY_ROBOT and command.action in self.action
        return [] if is_ignored else super()._obey(command)


class IgnoresSettlesForAll(IgnoresCommandsForAll):
    action = (Action.SETTLE,)


class ObeysOneNode(RobotNode):
    def _obey(self, command: Command) -> Frames:
        return super()._obey(command) if command.sender == DRIVER_ID else []


class ChecksTheSpareByte(RobotNode):
    def hear(self, frame: can.Message) -> Frames:
        is_command = not isinstance(decode_command(frame, COMMANDS), Rejection)
        return [] if is_command and frame.data[6] else super().hear(frame)


class ComparesIdentifiers(RobotNode):
    """Takes frames of a kind with no other than the usual bits of the identifier."""

    subject, bits = 0, 0

    def hear(self, frame: can.Message) -> Frames:
        usual = {3000: 4 << 26 | 3 << 21, 3002: 3 << 26 | 3 << 21}[self.subject]
        is_meant = frame.arbitration_id >> 8 & 0x1FFF == self.subject
        return [] if is_meant and (frame.arbitration_id ^ usual) & self.bits else super().hear(frame)


def comparing(subject: int, bits: int) -> type[ComparesIdentifiers]:
    """A node that compares these bits, too, in the identifiers of a kind."""
    return type("Comparing", (ComparesIdentifiers,), {"subject": subject, "bits": bits})


def numbers_of(bits: int) -> type[RobotNode]:
    """A node that keeps so many bits of the number of a tick."""

    def obey(self: RobotNode, command: Command) -> Frames:
        return RobotNode._obey(self, replace(command, tick=command.tick % 2**bits))

    return type("ShortNumbers", (RobotNode,), {"_obey": obey})


class CountsNothingAsWhite(RobotNode):
    def observe(self, z: Observation | None) -> Frames:
        return super().observe(Observation.WHITE if z is None else z)


class Hangs(RobotNode):
    def hear(self, frame: can.Message) -> Frames:
        return super().hear(frame) if self.ticks < 200 else []


class ClosesEveryTick(RobotNode):
    def settle(self) -> Frames:
        self.robot.settle()
        return super().settle()


# --- Wrong nodes: the wire ---


class Spoils(RobotNode):
    """Spoils every frame of a kind that it sends."""

    subject = 3000

    def spoil(self, frame: can.Message) -> Sequence[can.Message]:
        """Frames that are sent instead."""
        raise NotImplementedError

    def spoiled(self, frames: Sequence[can.Message]) -> Frames:
        """Frames of the subject spoiled, others as they are."""
        sent: Frames = []
        for frame in frames:
            sent += self.spoil(frame) if frame.arbitration_id >> 8 & 0x1FFF == self.subject else [frame]
        return sent

    def observe(self, z: Observation | None) -> Frames:
        return self.spoiled(super().observe(z))

    def settle(self) -> Frames:
        return self.spoiled(super().settle())


def spoiling(subject: int, spoil: Callable[[can.Message], Sequence[can.Message] | None]) -> type[Spoils]:
    """A node that sends what ``spoil`` makes of a subject's frames; None is the frame itself, changed."""

    def instead(self: Spoils, frame: can.Message) -> Sequence[can.Message]:
        frames = spoil(frame)
        return [frame] if frames is None else frames

    return type("Spoiling", (Spoils,), {"subject": subject, "spoil": instead})


def flip(bits: int) -> Callable[[can.Message], None]:
    """Flips identifier bits."""

    def spoil(frame: can.Message) -> None:
        frame.arbitration_id ^= bits

    return spoil


def put(place: int, value: Callable[[int], int]) -> Callable[[can.Message], None]:
    """Changes a byte."""

    def spoil(frame: can.Message) -> None:
        frame.data[place] = value(frame.data[place]) & 0xFF

    return spoil


def more_of_alpha(frame: can.Message) -> None:
    """As the firmware has it before it is rounded to the grid."""
    frame.data[3] |= alpha_bits(frame) < bits_of(0.25)


def shorten(frame: can.Message) -> None:
    """Send 7 bytes."""
    frame.data, frame.dlc = frame.data[:7], 7


def as_fd(frame: can.Message) -> None:
    """Send a CAN FD frame."""
    frame.is_fd = True


def standard(frame: can.Message) -> None:
    """Send an 11-bit identifier."""
    frame.is_extended_id, frame.arbitration_id = False, frame.arbitration_id & 0x7FF


class OneCountForAll(RobotNode):
    """Transfer ids count the frames of all kinds."""

    def settle(self) -> Frames:
        self.sent.telemetry = self.sent.estimates
        frames = super().settle()
        self.sent.estimates += 1
        return frames


class HeartbeatTwiceAsOften(RobotNode):
    def observe(self, z: Observation | None) -> Frames:
        return (self.start() if self.ticks % 10 == 5 else []) + super().observe(z)


class HeartbeatLate(RobotNode):
    """In the tick after the one in which it is due."""

    def __init__(self, *args: Any) -> None:
        super().__init__(*args)
        self.due: Frames = []

    def observe(self, z: Observation | None) -> Frames:
        *heartbeats, estimate_ = super().observe(z)
        late, self.due = self.due, heartbeats
        return [*late, estimate_]


# --- The table ---


def table_with(freedom: Callable[[int], int]) -> Table:
    """The t-table with other degrees of freedom."""
    with mp.workdps(40):
        entries = [
            round(
                (_t_score(mp.mpf("0.05"), freedom(m), mp.mpf(0)) / mp.sqrt(m) + 1) ** 2 * m / (m - 1) * 2**26
            )
            for m in range(2, 21)
        ]
    return Table(TABLE.omega_word, (*entries, TABLE.entries[-1]))


def _has_run(node: RobotNode) -> None:
    node.observe(Observation.BLACK)
    node.settle()


WRONG: dict[str, Wrong] = {
    # How it is set up
    "another b_hat": Wrong("alone", b_hat=0.56),
    "another broadcast period": Wrong("alone", actual={"comms_period": 2}),
    "broadcasts in every tick": Wrong(
        "alone",
        config={"comms_period": 5},
        actual={"comms_period": 1},
    ),
    "another id": Wrong("alone", robot=4),
    "has run before": Wrong("alone", prepare=_has_run),
    "another filter period": Wrong("", actual={"filter_period": 9}),
    "filters always": Wrong("rounds without a test", actual={"filter": Filter.ALWAYS}),
    "never filters": Wrong("no information", actual={"filter": Filter.OFF}),
    "filters though it should not": Wrong(
        "",
        config={"filter": Filter.OFF, "table": None, "filter_period": 1},
        actual={"filter": Filter.ALWAYS},
    ),
    "memory 8192": Wrong("long run", actual={"memory": 8192}),
    "memory 64": Wrong("alone", actual={"memory": 64}),
    "t-table of omega 0.25": Wrong(
        "threshold of 2 messages", actual={"table": generate(parse_omega("0.25"), 20)}
    ),
    "t-table of omega 0.04": Wrong(
        "threshold of 2 messages", actual={"table": generate(parse_omega("0.04"), 20)}
    ),
    "t-table of q = 9": Wrong("threshold of 10 messages", actual={"table": generate(parse_omega("0.05"), 9)}),
    "t-table with m degrees of freedom": Wrong(
        "threshold of 2 messages", actual={"table": table_with(lambda m: m)}
    ),
    "t-table with m - 2 degrees of freedom": Wrong(
        "threshold of 2 messages",
        actual={"table": table_with(lambda m: max(m - 2, 1) if m > 2 else 3)},
    ),
    # The method
    "variance over m": Wrong("threshold of 2 messages", firmware=VarianceOverM),
    ">= instead of >": Wrong("own estimate", firmware=NotStrict),
    "tests its informed estimate": Wrong("", firmware=TestsInformed),
    "tests one message": Wrong("rounds without a test", firmware=TestsOneMessage),
    "counts messages without confidence into m": Wrong(
        "rounds without a test", firmware=TestsThoseWithoutConfidence
    ),
    "never updates": Wrong("no information", firmware=always("new_b_hat", None)),
    "never rejects": Wrong("no information", firmware=always("decides", False)),
    "always rejects": Wrong("threshold of 2 messages", firmware=always("decides", True)),
    "b_hat is the maximum": Wrong("no information", firmware=eq_8(lambda right: B_HAT_MAX)),
    "eq. 8 wrong by 0.1 %": Wrong(
        "no information", firmware=eq_8(lambda right: right and min(right + right // 1000, B_HAT_MAX))
    ),
    "eq. 8 in float32": Wrong(
        "no information", firmware=eq_8(lambda right: right and max(right >> 10 << 10, B_HAT_MIN))
    ),
    "b_hat never below 1/2": Wrong(
        "no information", firmware=eq_8(lambda right: right and max(right, 1 << 31))
    ),
    "b_hat clamped elsewhere": Wrong(
        "threshold of 5 messages",
        firmware=eq_8(lambda right: right and min(max(right, 42950), 2**32 - 42950)),
    ),
    "x_bar not weighted in eq. 8": Wrong("threshold of 2 messages", firmware=UnweightedMean),
    "updates at x_bar = 1/2": Wrong(
        "re-estimates", firmware=eq_8(lambda right: B_HAT_MAX if right is None else right)
    ),
    "a re-estimate changes x_hat at once": Wrong("no information", firmware=AppliesAtOnce),
    "divides by 2 b - 1 = 0": Wrong("no information", firmware=NeverAppliesHalf),
    "filters every round": Wrong("", firmware=FiltersEveryRound),
    "first test a round late": Wrong("", firmware=FirstTestLate),
    "keeps x_bar in silence": Wrong("messages and silence", firmware=KeepsTheRound),
    "never empties the round": Wrong("messages and silence", firmware=NeverEmpties),
    "hears ids below 8 only": Wrong("every sender", firmware=below(8)),
    "hears ids below 100 only": Wrong("every sender", firmware=below(100)),
    "does not hear robot 127": Wrong("every sender", firmware=below(127)),
    "compares the priority of estimates": Wrong("unusual identifiers", node=comparing(3000, 7 << 26)),
    "compares ignored bits of estimates": Wrong("unusual identifiers", node=comparing(3000, 3 << 21)),
    "a bitmap of 32 senders": Wrong("alike ids", firmware=Bitmap),
    "at most 5 messages": Wrong("growing rounds", firmware=at_most(5)),
    "at most 100 messages": Wrong("growing rounds", firmware=at_most(100)),
    "takes the last message of a sender": Wrong("same sender", firmware=LastCounts),
    "saturates alpha at 2^20": Wrong(
        "extreme messages", firmware=with_alpha(lambda alpha: alpha_word(min(alpha_units(alpha), 1 << 44)))
    ),
    "loses low bits of alpha": Wrong(
        "messages and silence", firmware=with_alpha(lambda alpha: alpha_word(alpha_units(alpha) >> 8 << 8))
    ),
    "takes alpha = 0 for a little": Wrong(
        "extreme messages", firmware=with_alpha(lambda alpha: alpha or 0x100)
    ),
    "all neighbours count alike": Wrong(
        "messages and silence", firmware=with_alpha(lambda alpha: 0x80000001)
    ),
    "colours exchanged": Wrong("alone", firmware=ColoursExchanged),
    "rounds x_hat up": Wrong("", firmware=RoundsXHat),
    "alpha of 20 bits": Wrong("alone", firmware=TruncatesAlpha),
    "halves down": Wrong("halvings", firmware=halving(lambda n: n >> 1), config={"memory": 512}),
    "halves up": Wrong("halvings", firmware=halving(lambda n: n + 1 >> 1), config={"memory": 512}),
    "broadcasts x": Wrong("messages and silence", firmware=BroadcastsX),
    # What it hears
    "refuses large alphas": Wrong("extreme messages", node=RefusesLargeAlphas),
    "drops older transfer ids": Wrong("among neighbours", node=DropsOlderTransfers),
    "hears itself": Wrong("its own id", node=HearsItself),
    "restarts after a conflict": Wrong("its own id", node=ForgetsAfterAConflict),
    "a receive buffer of 60 frames": Wrong("growing rounds", node=StopsListening),
    "a buffer of 4 commands": Wrong("heartbeats", node=DropsCommandsInARow),
    "deaf between ticks": Wrong("between ticks", node=DeafBetweenTicks),
    "late messages count at once": Wrong("between ticks", node=LateCountsNow),
    **{
        f"accepts {doing}": Wrong("invalid frames", node=accepting(reason))
        for reason, doing in (
            (Rejection.X_HAT, "x_hat above 1"),
            (Rejection.ALPHA, "alpha"),
            (Rejection.LENGTH, "7 bytes"),
            (Rejection.MULTI_FRAME, "no single-frame tail byte"),
            (Rejection.REMOTE_FRAME, "a remote frame"),
            (Rejection.STANDARD_ID, "an 11-bit identifier"),
            (Rejection.SERVICE, "a service transfer"),
            (Rejection.ANONYMOUS, "an anonymous sender"),
            (Rejection.RESERVED_BITS, "reserved bit"),
        )
    },
    "does not look at the start bit": Wrong(
        "invalid frames", node=reading(set_tail(1 << 7), Rejection.MULTI_FRAME)
    ),
    "does not look at the end bit": Wrong(
        "invalid frames", node=reading(set_tail(1 << 6), Rejection.MULTI_FRAME)
    ),
    "does not look at the toggle bit": Wrong(
        "invalid frames", node=reading(set_tail(1 << 5), Rejection.MULTI_FRAME)
    ),
    "takes 7 bytes": Wrong("invalid frames", node=reading(lengthen, Rejection.LENGTH)),
    "x_hat one unit too large": Wrong("invalid frames", node=reading(lower_x_hat, Rejection.X_HAT)),
    "subjects of 8 bits": Wrong("invalid frames", node=reading(as_subject(0xFF), Rejection.SUBJECT)),
    "leaves out bit 4 of subjects": Wrong(
        "invalid frames", node=reading(as_subject(0x1FEF), Rejection.SUBJECT)
    ),
    "leaves out bit 8 of subjects": Wrong(
        "invalid frames", node=reading(as_subject(0x1EFF), Rejection.SUBJECT)
    ),
    # Commands
    "takes no observation for white": Wrong("alone", node=CountsNothingAsWhite),
    "stays in a tick": Wrong("lost commands", node=StaysInATick),
    "answers late": Wrong("lost commands", node=AnswersLate),
    "forgets a round": Wrong("lost commands", node=ForgetsARound),
    "settles in any tick": Wrong("stray commands", node=SettlesInAnyTick),
    "obeys others": Wrong("stray commands", node=ObeysOthers),
    "ignores commands for every robot": Wrong("unusual commands", node=IgnoresCommandsForAll),
    "ignores settles for every robot": Wrong("unusual commands", node=IgnoresSettlesForAll),
    "obeys one node": Wrong("unusual commands", node=ObeysOneNode),
    "checks the spare byte": Wrong("unusual commands", node=ChecksTheSpareByte),
    "compares the priority of commands": Wrong("unusual commands", node=comparing(3002, 7 << 26)),
    "compares ignored bits of commands": Wrong("unusual commands", node=comparing(3002, 3 << 21)),
    "numbers of 8 bits": Wrong("unusual commands", node=numbers_of(8)),
    "numbers of 16 bits": Wrong("unusual commands", node=numbers_of(16)),
    "numbers of 31 bits": Wrong("unusual commands", node=numbers_of(31)),
    "observes twice": Wrong("stray commands", node=ObservesTwice),
    "hangs": Wrong("every sender", node=Hangs),
    "closes a round in every tick": Wrong(
        "messages and silence", node=ClosesEveryTick, config={"comms_period": 5}
    ),
    # The wire
    "another priority": Wrong("alone", node=spoiling(3000, flip(1 << 26))),
    "another priority of telemetry": Wrong("alone", node=spoiling(3001, flip(1 << 27))),
    "another priority of heartbeats": Wrong("alone", node=spoiling(7509, flip(1 << 28))),
    "bits 21 and 22 not set": Wrong("alone", node=spoiling(3000, flip(3 << 21))),
    "bit 23 set": Wrong("alone", node=spoiling(3000, flip(1 << 23))),
    "bit 7 set": Wrong("alone", node=spoiling(3001, flip(1 << 7))),
    "a service": Wrong("alone", node=spoiling(3000, flip(1 << 25))),
    "11-bit identifiers": Wrong("alone", node=spoiling(3000, standard)),
    "CAN FD": Wrong("alone", node=spoiling(3000, as_fd)),
    "7 bytes": Wrong("alone", node=spoiling(3001, shorten)),
    "another tail": Wrong("alone", node=spoiling(3000, put(7, lambda byte: byte & 0x3F))),
    "transfer ids modulo 16": Wrong("alone", node=spoiling(3000, put(7, lambda byte: byte & 0xEF))),
    "transfer ids stand still": Wrong("alone", node=spoiling(7509, put(7, lambda byte: 0xE0))),
    "one count of transfer ids": Wrong("alone", node=OneCountForAll),
    "x rounded in telemetry": Wrong("alone", node=spoiling(3001, put(0, lambda b: b ^ 1))),
    "b_hat cut in telemetry": Wrong("alone", node=spoiling(3001, put(3, lambda byte: byte + 1))),
    "more of alpha": Wrong("alone", node=spoiling(3000, more_of_alpha)),
    "another subject of telemetry": Wrong("alone", node=spoiling(3001, flip(1 << 11))),
    "says it twice": Wrong("alone", node=spoiling(3000, lambda frame: [frame, frame])),
    "answers twice": Wrong("alone", node=spoiling(3001, lambda frame: [frame, frame])),
    "no heartbeats": Wrong("alone", node=spoiling(7509, lambda frame: [])),
    "uptime in ticks": Wrong("alone", node=spoiling(7509, put(0, lambda byte: 10 * byte))),
    "health caution": Wrong("alone", node=spoiling(7509, put(4, lambda byte: byte | 2))),
    "mode maintenance": Wrong("alone", node=spoiling(7509, put(5, lambda byte: byte | 2))),
    "heartbeats twice as often": Wrong("alone", node=HeartbeatTwiceAsOften),
    "heartbeats a tick late": Wrong("alone", node=HeartbeatLate),
}
"""Wrong controllers, by what is wrong with them."""
