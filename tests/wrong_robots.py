"""Controllers that are wrong, each in one way, with the phase that finds it.

Most are mistakes that one makes when porting the firmware or writing a node from docs/frame.md.
"""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import can

from crosschecks import mirror_with
from mcp_asdf.fixed_point import ONE
from mcp_asdf.mirror import MirrorRobot
from mcp_asdf.robot import Filter, Observation
from mcp_asdf.table import Table
from mcp_asdf_tools.bus.alpha_words import alpha_word_from_float32_bits, float32_bits, float32_value
from mcp_asdf_tools.bus.frame_layout import EVERY_ROBOT, Action, Rejection
from mcp_asdf_tools.bus.frames import (
    Command,
    Estimate,
    FrameFormat,
    alpha_float32_bits,
    decode_command,
    decode_estimate,
)
from mcp_asdf_tools.radio.neighbourhood import RadioSettings, choose_ids
from mcp_asdf_tools.robots.lockstep import DRIVER_ID
from mcp_asdf_tools.robots.node import RobotNode, Subjects
from mcp_asdf_tools.robots.robot_setup import RobotSetup
from mcp_asdf_tools.swarm.fault_injection.parsing import parse_fault
from mcp_asdf_tools.swarm.settings import SwarmSettings
from mcp_asdf_tools.tables.thresholds import generate, parse_omega
from wire import record

ID, B_HAT = 3, 0.55
DEFAULT: dict[str, Any] = {"b_hat": 0.95, "filter_period": 1000, "table": generate(parse_omega("0.05"), 127)}
"""What a controller has that is set up by the defaults."""
Act = Callable[..., Any]
"""What a method does instead: it takes the object, the right method and the arguments."""


def right(**config: Any) -> RobotSetup:
    """The controller as the verification is told that it is."""
    return record(**{"robot": ID, "firmware": "mirror", "b_hat": B_HAT, **config})


def surroundings(controller: RobotSetup | None = None, faults: str = "", **world: Any) -> RadioSettings:
    """A controller, robot 3, among robots 0, 1, 2 and 4."""
    own = controller or right()
    neighbours = tuple(replace(own, id=robot, b_hat=0.95) for robot in choose_ids(own.id, 4))
    swarm = SwarmSettings(robots=5, **{"seed": 6} | world)
    return RadioSettings(own, neighbours, swarm, Subjects(), tuple(map(parse_fault, faults.split())))


def _replaced(kind: type, acts: dict[str, Act]) -> type:
    """A class of which some methods do something else."""

    def method(name: str, act: Act) -> Act:
        return lambda self, *args: act(self, partial(getattr(kind, name), self), *args)

    return type("Wrong", (kind,), {name: method(name, act) for name, act in acts.items()})


@dataclass(frozen=True)
class Wrong:
    """A wrong controller: the phase that finds it by default, and how to make it, with this configuration on
    top of another."""

    phase: str
    config: dict[str, Any]
    make: Callable[[dict[str, Any]], RobotNode]


def set_up(
    phase: str,
    config: dict[str, Any] | None = None,
    kind: type = RobotNode,
    firmware: Callable[..., Any] = MirrorRobot,
    **actual: Any,
) -> Wrong:
    """A controller that is set up otherwise than said, which is ``config``."""
    said = config or {}

    def make(others: dict[str, Any]) -> RobotNode:
        settings = {"robot": ID, **others, **said, **actual}
        own = record(firmware="mirror", **settings)
        return kind(own, make=lambda: firmware(own.config, own.id, own.b_hat))  # type: ignore[no-any-return]

    return Wrong(phase, said, make)


def firmware(phase: str, *changes: str, config: dict[str, Any] | None = None) -> Wrong:
    """A controller whose firmware is the mirror with other text in some places."""

    def make(*arguments: Any) -> Any:
        return mirror_with(*changes)(*arguments)

    return set_up(phase, config, firmware=make)


VOTES: dict[str, Any] = {"filter": Filter.ROBUST, "table": None}


def robust(phase: str, *changes: str) -> Wrong:
    """The same with the robust filter."""
    return firmware(phase, *changes, config=VOTES)


ALWAYS: dict[str, Any] = {"filter": Filter.ALWAYS, "table": None}


def always(phase: str, *changes: str) -> Wrong:
    """A controller that re-estimates without a test, with other text in some places of its firmware."""
    return firmware(phase, *changes, config=ALWAYS)


def robust_in_floats(phase: str, number_format: str) -> Wrong:
    """A controller whose robust filter tests in floating point: ``number_format`` is that of ``struct``."""
    return robust(
        phase,
        f"""def {{robust_test_rejects => robust_test_rejects(crowd, t, n):
    def fit(value):
        return struct.unpack({number_format!r}, struct.pack({number_format!r}, value))[0]
    r, b_hat, spread = fit(crowd.centre / 2**30), fit(crowd.first / 2**32), fit(crowd.spread / 2**30)
    p = fit(fit(b_hat * r) + fit(fit(1 - b_hat) * fit(1 - r)))
    seen = fit(n / t)
    variance = max(fit(seen * fit(1 - seen)), fit(p * fit(1 - p)))
    g_spread = fit(fit(fit(2 * b_hat) - 1) * spread)
    limit = fit(12 * fit(fit(variance / t) + fit(g_spread * g_spread)))
    return fit(fit(seen - p) * fit(seen - p)) > limit

def deviates_in_integers}}(crowd: Crowd, t""",
    )


def takes_messages(most: int) -> Act:
    """Takes no more than so many estimates in a tick."""

    def hear(node: Any, right: Act, frame: can.Message) -> Any:
        if not is_estimate(frame):
            return right(frame)
        tick, count = vars(node).get("taken", (None, 0))
        count = count + 1 if tick == node.ticks else 1
        node.taken = node.ticks, count
        return right(frame) if count <= most else []

    return hear


def node(phase: str, **acts: Act) -> Wrong:
    """A controller whose node has other methods."""
    return set_up(phase, kind=_replaced(RobotNode, acts))


WRONG: dict[str, Wrong] = {}
"""Wrong controllers, by what is wrong with them."""


def wrong(method: str, phase: str, name: str) -> Callable[[Act], Act]:
    """Adds a controller whose node does in one ``method`` what is decorated."""

    def add(act: Act) -> Act:
        WRONG[name] = node(phase, **{method: act})
        return act

    return add


def given(change: Callable[[Any], object]) -> Act:
    """Takes something else for what is given."""
    return lambda self, right, each: right(change(each))


def table_wrong_at(m: int) -> Table:
    """The t-table with one entry that is a thousandth too large, if k stays above the next."""
    right = DEFAULT["table"]
    entries = [entry + (entry >> 10) * (each == m) for each, entry in enumerate(right.entries, 2)]
    return Table(right.omega_word, tuple(entries))


# --- Wrong frames ---


def change(**values: Callable[[Any], object]) -> Callable[[can.Message], None]:
    """Changes members of a frame."""

    def spoil(frame: can.Message) -> None:
        for name, value in values.items():
            setattr(frame, name, value(getattr(frame, name)))

    return spoil


def flip(bits: int) -> Callable[[can.Message], None]:
    """Flips identifier bits."""
    return change(arbitration_id=lambda identifier: identifier ^ bits)


def put(place: int, value: Callable[[int], int]) -> Callable[[can.Message], None]:
    """Changes a byte."""
    return change(data=lambda data: data[:place] + bytes([value(data[place]) & 0xFF]) + data[place + 1 :])


def as_subject(mask: int) -> Callable[[can.Message], None]:
    """Makes an estimate of a frame whose subject has these bits of that of estimates."""
    return change(
        arbitration_id=lambda identifier: (
            identifier if (identifier >> 8 ^ 3000) & mask else identifier & ~(0x1FFF << 8) | 3000 << 8
        )
    )


# --- Wrong nodes: what they hear ---


@wrong("_follow_command", "nothing seen", "a buffer of 4 commands")
def _(node: Any, right: Act, command: Command) -> list[can.Message]:
    node.waiting = 0 if command.action is Action.SETTLE else getattr(node, "waiting", 0) + 1
    return right(command) if node.waiting <= 4 else []


@wrong("_receive", "among neighbours", "drops older transfer ids")
def _(node: Any, right: Act, message: Estimate) -> None:
    last, number = vars(node).setdefault("last", {}), message.transfer_id
    if (number - last.get(message.sender, number - 1)) % 32 < 16:
        last[message.sender] = number
        right(message)


def is_estimate(frame: can.Message) -> bool:
    """True for a legal one."""
    return isinstance(decode_estimate(frame, FrameFormat()), Estimate)


def drops(is_dropped: Callable[[Any], bool]) -> Act:
    """Does not take these frames, or these commands."""
    return lambda node, right, each: [] if is_dropped(each) else right(each)


def compares(subject: int, bits: int) -> Act:
    """Takes frames of a kind with no other than the usual ones of these identifier bits."""
    usual = {3000: 4 << 26 | 3 << 21, 3002: 3 << 26 | 3 << 21}[subject]
    return drops(
        lambda frame: (
            frame.arbitration_id >> 8 & 0x1FFF == subject and bool((frame.arbitration_id ^ usual) & bits)
        )
    )


def reads(reason: Rejection, mend: Callable[[can.Message], object]) -> Act:
    """Takes frames that are to be rejected for a reason as if they were mended: a check was left out."""

    def hear(node: Any, right: Act, frame: can.Message) -> Any:
        if decode_estimate(frame, FrameFormat()) is reason:
            frame = copy(frame)
            frame.data = bytearray(frame.data)
            mend(frame)
        return right(frame)

    return hear


def accepts(reason: Rejection) -> Act:
    """Reads an estimate out of anything that is to be rejected for a reason."""

    def hear(node: Any, right: Act, frame: can.Message) -> Any:
        if decode_estimate(frame, FrameFormat()) is not reason:
            return right(frame)
        content = int.from_bytes(frame.data.ljust(8, b"\0"), "little")
        alpha = alpha_word_from_float32_bits(min(content >> 24 & 0x7FFF_FFFF, 0x7F7F_FFFF))
        node.robot.receive_raw(frame.arbitration_id & 0x7F, min(content & 0xFF_FFFF, ONE), alpha)
        return []

    return hear


def to_nearest(frame: can.Message) -> can.Message:
    """An estimate whose alpha is the nearest multiple of 2^-24."""
    if not is_estimate(frame) or (value := float32_value(alpha_float32_bits(frame))) > 1:
        return frame
    rounded = copy(frame)
    rounded.data = (
        frame.data[:3] + float32_bits(round(value * 2**24) / 2**24).to_bytes(4, "little") + frame.data[7:]
    )
    return rounded


# --- Wrong nodes: commands ---


@wrong("_follow_command", "stray commands", "settles in any tick")
def _(node: Any, right: Act, command: Command) -> Any:
    if command.action is Action.SETTLE and command.target in (ID, EVERY_ROBOT):
        node._tick_of_command = command.tick
    return right(command)


@wrong("_follow_command", "nothing seen", "stays in a tick")
def _(node: Any, right: Act, command: Command) -> Any:
    return [] if not node.is_settled and command.tick != node._tick_of_command else right(command)


def has_run(node: Any, right: Act) -> Any:
    """Does a tick of its own before it starts."""
    node.observe(Observation.BLACK)
    node.settle()
    return right()


# --- Wrong nodes: the wire ---


def sends(subject: int, spoil: Callable[[can.Message], list[can.Message] | object]) -> Wrong:
    """A controller that sends the frames that ``spoil`` returns for each of a subject, or else changes it."""

    def spoiled(node: Any, right: Act, *args: Any) -> list[can.Message]:
        sent: list[can.Message] = []
        for frame in right(*args):
            instead = spoil(frame) if frame.arbitration_id >> 8 & 0x1FFF == subject else None
            sent += instead if isinstance(instead, list) else [frame]
        return sent

    return node("nothing seen", observe=spoiled, settle=spoiled)


def numbers_of(bits: int) -> Wrong:
    """A controller that keeps so many bits of the number of a tick."""
    return node(
        "unusual commands",
        _follow_command=given(lambda command: replace(command, tick=command.tick % 2**bits)),
    )


HALVED, SLOW = {"memory": 512}, {"comms_period": 5}

WRONG |= {
    # How it is set up
    "another b_hat": set_up("nothing seen", b_hat=0.56),
    "broadcasts in every tick": set_up("nothing seen", SLOW, comms_period=1),
    "another id": set_up("nothing seen", robot=4),
    "has run before": node("nothing seen", start=has_run),
    "another filter period": set_up("all white", filter_period=9),
    "filters always": set_up("rounds without a test", filter=Filter.ALWAYS),
    "filters though it should not": set_up(
        "no filter", {"filter": Filter.OFF, "table": None}, filter=Filter.ALWAYS
    ),
    "memory 8192": set_up("threshold of 10 messages", memory=8192),
    "memory 64": set_up("alone", memory=64),
    "t-table of omega 0.04": set_up("threshold of 2 messages", table=generate(parse_omega("0.04"), 127)),
    **{
        f"threshold of {m} messages wrong": set_up(f"threshold of {m} messages", table=table_wrong_at(m))
        for m in (2, 3, 5, 10)
    },
    "threshold of many messages wrong": set_up("threshold of 30 messages", table=table_wrong_at(30)),
    # The method
    "rejects its own estimate": firmware("own estimate", "return {diff => difference == 0 or diff}erence *"),
    "tests its informed estimate": firmware("all white", "s.open, {s.x_hat => self.x_raw})"),
    "tests one message": firmware(
        "rounds without a test",
        "= {2 => 1} if config.filter ==",
        "if {not => s.open.count > 1 and not} asdf_test_rejects",
    ),
    "never updates": firmware("all white", "return {reestimate(s.t, s.n, round_mean(s.closed)) => None}"),
    "x_bar not weighted in eq. 8": firmware(
        "few observations", "s.n, round_mean({s.closed => Closed(s.open.count << 24, s.open.x << 24)}))"
    ),
    "eq. 8 in float32": firmware("few observations", "min(max({b_hat => b_hat >> 10 << 10}, B_HAT_MIN)"),
    "b_hat clamped elsewhere": firmware(
        "all white", "max(b_hat, {B_HAT_MIN), B_HAT_MAX => 42950), 2**32 - 42950})"
    ),
    "updates at x_bar = 1/2": firmware("re-estimates", "INFORMATIVE_G:\n        return {None => B_HAT_MAX}"),
    "a re-estimate changes x_hat at once": firmware(
        "all white", "s.updated = 1{ => ; s.x_hat, s.alpha = estimate(s.t, s.n, s.accuracy)}"
    ),
    "divides by 2 b - 1 = 0": firmware("no information", "return {HALF => ONE}, 0"),
    "keeps x_bar in silence": firmware("nothing seen", "{ => if s.open.count: }s.closed = Closed(s."),
    "a bitmap of 32 senders": firmware("few observations", "word_index = {sender >> 5 => 0}"),
    "does not hear robot 127": firmware("every sender", "0 <= sender {<= => <} MAX_ID"),
    "at most 100 messages": firmware("growing rounds", "status != Status.OK{ =>  or s.open.count > 99}:"),
    "takes the last message of a sender": firmware(
        "same sender",
        "def {_receive => _receive(self, *message: int) -> Status:\n        "
        "vars(self).setdefault('kept', {})[message[0]] = message; return Status.OK\n\n    "
        'def _take}(self, sender: int, x_hat: int, alpha: int) -> Status:\n        """Add',
        "is_updated = False{ => ; [self._take(*m) for m in vars(self).pop('kept', {}).values()]}",
    ),
    "loses low bits of alpha": firmware("nothing seen", "units = alpha_units(alpha){ =>  >> 8 << 8}"),
    "takes alpha = 0 for a little": firmware("nothing seen", "s.open, x_hat, alpha{ =>  or 0x100})"),
    "colours exchanged": firmware("alone", "colour = {index(z) => 1 - index(z)}"),
    "rounds x_hat up": firmware("first black tiles", "s.updated = 0{ => ; s.x_hat += 0 < s.x_hat < HALF}"),
    "alpha of 20 bits": firmware("alone", "s.updated = 0{ => ; s.alpha &= 0xFFFF_F01F}"),
    "halves down": firmware("stray commands", "s.n = {round(s.n / 2) => s.n // 2}", config=HALVED),
    "halves up": firmware(
        "threshold of 3 messages", "s.n = {round(s.n / 2) => (s.n + 1) // 2}", config=HALVED
    ),
    "broadcasts x": firmware("nothing seen", "return {self.s.x_hat => self.x_raw}\n"),
    # Ends of ranges
    "x_hat at least 0.01": firmware("alone", "is_mirrored else {x_hat => max(x_hat, ONE // 100)}, alpha"),
    "x_hat wrong below 0.2": firmware(
        "first black tiles", "mirrored else {x_hat => x_hat ^ (0 < x_hat < ONE // 5)}, alpha"
    ),
    "alpha wrong without a black tile": firmware(
        "alone", "from_mantissa({mantissa => mantissa ^ (n == 0)}, exp"
    ),
    "alpha wrong where x_hat is clamped": firmware(
        "no information", "accuracy.rare + {(weight => 0 * (weight} >> acc"
    ),
    "alpha wrong there after 100 tiles": firmware(
        "all white", "at_end(accuracy, {t => t ^ (t > 100)}, rare_count)"
    ),
    "alpha of one significant bit below 1/2": firmware(
        "no information", "{(mantissa >> -exponent) => 1} << 8"
    ),
    "knows nothing below 2^-10": firmware("no information", "INFORMATIVE_G = 1 << {20 => 22}"),
    "senders stay heard after an update": firmware(
        "all white", "s.heard = {[0, 0, 0, 0] => s.heard if is_updated else [0, 0, 0, 0]}"
    ),
    "senders stay heard after a test": firmware(
        "all white",
        "s.heard = {[0, 0, 0, 0] => s.heard if s.filter_left == self.config.filter_period else [0, 0, 0, 0]}",
    ),
    "messages stay after an update": firmware(
        "all white", "s.open = {Sums() => s.open if is_updated else Sums()}"
    ),
    "re-estimates before it has observed": firmware("nothing seen", "if {s.t == 0 => False}:\n"),
    "no re-estimate without a black tile": firmware("all white", "if {s.t == 0 => s.n == 0}:\n"),
    "x_bar of 1 is 0": firmware(
        "estimates of 0 and 1", "{x_bar < => (x_bar := x_bar * (x_bar < MAX_WORD - 9)) <} Q32_HALF:"
    ),
    "sums of alpha up to 2^45 in eq. 8": firmware(
        "all white", "alpha_x, {closed.alpha => min(closed.alpha, 1 << 45)} *"
    ),
    "sums of alpha from 2^32 in eq. 8": firmware(
        "few observations", "alpha_x, {closed.alpha => max(closed.alpha, 1 << 32)} *"
    ),
    "a square of 54 bits": firmware(
        "threshold of 126 messages", "return {difference => (1 << 54) - 1 & difference} * difference >"
    ),
    "a spread of 56 bits": firmware("large sums", "sum_x_squared - sum_x * sum_x{ =>  & (1 << 56) - 1}"),
    "b_hat wrong for t below 500": firmware(
        "few observations", "return reestimate(s.t, s.n{ =>  + (s.t < 500)}, round_mean("
    ),
    "b_hat wrong for t from 100 to 500": firmware(
        "few observations", "return reestimate(s.t, s.n{ =>  + (100 < s.t < 500)}, round_mean("
    ),
    "eq. 8 wrong for sums of alpha below 1": firmware(
        "threshold of 30 messages",
        "return q32_quotient(closed.alpha_x{ =>  + ((closed.alpha < 1 << 24) << 22)}, closed.alpha * ONE)",
    ),
    "eq. 8 never shifts up": firmware(
        "no information",
        "denominator.bit_length() - 32{ => \n    if shift < 0:\n"
        "        return (numerator << 16) // denominator << 16}",
    ),
    "t of 14 bits in eq. 8": firmware(
        "re-estimates", "return reestimate(s.t{ =>  % (1 << 14)}, s.n, round_mean("
    ),
    "an update counter of 5 bits": firmware("many updates", "(s.updates + 1) & {COUNTER_MASK => 31}"),
    "tests in float64": firmware(
        "threshold of 126 messages",
        "return {difference * difference => float(difference) * difference} > limit",
        "limit = {(table.entry(m) * scaled_variance) >> FRACTION_BITS => "
        "table.entry(m) / 2**FRACTION_BITS * float(scaled_variance)}",
    ),
    "thresholds of 23 fraction bits": firmware(
        "threshold of 3 messages", "{table.entry(m) => (table.entry(m) & ~7)} * scaled_variance"
    ),
    "tests though it should not": set_up(
        "re-estimates without a test", ALWAYS, filter=Filter.ADAPTIVE, table=DEFAULT["table"]
    ),
    "needs two messages without a test": always(
        "re-estimates without a test", "messages_needed = 2 if config.filter == Filter.ADAPTIVE else {1 => 2}"
    ),
    **{
        f"{most} messages in a tick": node("a crowded tick", receive_frame=takes_messages(most))
        for most in (200, 256, 500)
    },
    # The robust filter: votes
    "takes a large alpha for two votes": robust(
        "few voices",
        "8:{ => \n            if alpha_units(alpha) > 1 << 40: update_crowd(s.crowd, sender, x_hat)}",
    ),
    "takes alpha = 0 for a vote": robust("few voices", "{elif alpha >> 8 => else}:"),
    "votes for repeated senders": robust(
        "same sender", "            { => update_crowd(s.crowd, sender, x_hat); }return Status.REPEATED"
    ),
    "does not clamp": robust("few voices", "{min(distance, crowd.spread) => distance} >> gain_shift"),
    "clamps at 2 s": robust("few voices", "min(distance, { => 2 * }crowd.spread) >> gain_shift"),
    "constant gain": robust(
        "few voices", "gain_shift = {max(crowd.votes, VOTES_OF_MAX_GAIN).bit_length() - 3 => 3}"
    ),
    "gain without end": robust("many votes", "VOTES_MAX = 1 << {14 => 15}"),
    "starts at the first vote": robust(
        "few voices",
        "position = q30_from_q23(x_hat){ => ; crowd.centre = crowd.centre if crowd.votes > 1 else position}",
    ),
    "s never shrinks": robust("few voices", "> crowd.spread else {-spread_step => 0}"),
    "s grows at equality": robust("few voices", "distance {> => >=} crowd.spread else -spread_step"),
    "s without a floor": robust(
        "test of the least spread", "{max(new_spread, SPREAD_MIN) => new_spread}, SPREAD"
    ),
    "s without a ceiling": robust("few voices", "max(new_spread, SPREAD_MIN), SPREAD_MAX{ =>  << 9})"),
    "sends its centre as x_hat": robust("few voices", "return {self.s.x_hat => self.x_raw}\n"),
    "x of the last round": robust(
        "few voices",
        "{if self.config.filter != Filter.ROBUST => if True}:",
        "elif { => True or }alpha",
        "if {self.config.filter == Filter.ROBUST => False}:\n            return",
    ),
    "x is 1/2 before the first vote": robust("alone", "estimate({self.s.x_hat => HALF}, self"),
    # Its test
    "takes votes for voices": robust("few voices", "if crowd.{voices.bit_count() => votes} < SENDERS_MIN:"),
    "voices modulo 128": robust("few voices", "1 << {(sender & 31) => sender}\n    crowd"),
    "two voices are enough": robust("few voices", "SENDERS_MIN = {3 => 2}"),
    "three voices are too few": robust("few voices", "SENDERS_MIN = {3 => 4}"),
    "rejects at 3 sigma": robust("test of a moderate spread", "SIGMAS_SQUARED = {12 => 9}"),
    "forgets the spread in its test": robust("test of a moderate spread", "{(g_spread * g_spread) => 0}"),
    "variance of the prediction alone": robust(
        "test of a moderate spread", "for share in ({observed_share, predicted_share => predicted_share,}))"
    ),
    "variance of the count alone": robust(
        "test of the least spread", "for share in (observed_share,{ predicted_share => })"
    ),
    "eq. 8 from its own estimate": robust("few voices", "s.n, {crowd_fill_ratio(crowd) => s.x_hat << 9})"),
    "tests the present b_hat": robust(
        "moving up", 'robust_test_rejects({crowd => Crowd(**vars(crowd) | {"first": s.accuracy.b_hat})}, s.t'
    ),
    "no way back": robust("moving up", "return None if is_initial else {crowd.first => None}"),
    # A crowd that moves
    "does not see that the crowd moves": robust("few voices", "if {crowd.is_moving => False}:"),
    "tests while the crowd moves": robust(
        "limits of the trend", "votes >>= 1\n            {return None => pass}"
    ),
    "keeps its gain when the crowd moves": robust("few voices", "votes >>= {1 => 0}\n"),
    "sees only a crowd that moves up": robust(
        "few voices", "not {TREND_MOVING_DOWN <= self => self}.trend < TREND"
    ),
    "a trend of 512 moves": robust(
        "few voices",
        "TREND_SHIFT = {8 => 9}",
        "TREND_STEP_UP = {255 => 127}",
        "TREND_STEP_EVEN = {128 => 64}",
    ),
    "halves below the floor": robust(
        "few voices", "if crowd.votes {>= 2 * VOTES_MIN_WHILE_MOVING => >= VOTES_MIN_WHILE_MOVING}:"
    ),
    "does not halve to the floor": robust(
        "few voices", "if crowd.votes {>= => >} 2 * VOTES_MIN_WHILE_MOVING:"
    ),
    "halves from 511 votes on": robust(
        "moving up", "if crowd.votes >= 2 * VOTES_MIN_WHILE_MOVING{ =>  - 1}:"
    ),
    "halves by rounding up": robust("moving down", "crowd.votes {>>= 1 => = crowd.votes + 1 >> 1}"),
    "throws the trend back": robust("few voices", "crowd.votes >>= 1{ => ; crowd.trend = 1 << 15}"),
    "halves only with three voices": robust(
        "few voices",
        "s, crowd = self.s, self.s.crowd\n        if {crowd.is_moving => "
        "crowd.voices.bit_count() < 3:\n            return None\n        if crowd.is_moving}:",
    ),
    "voices modulo 16": robust("few voices", "crowd.voices |= 1 << (sender & {31 => 15})"),
    "voices of 31 bits": robust(
        "few voices", "crowd.voices |= {1 << (sender & 31) => (1 << (sender & 31)) & 0x7FFF_FFFF}"
    ),
    "a trend of 2^13 moves": robust("limits of the trend", "TREND_MOVING_DOWN {<= => <} self.trend"),
    "a trend of 2^13 - 1 stays": robust(
        "limits of the trend", "TREND_MOVING_DOWN = {1 << 13 => (1 << 13) - 1}"
    ),
    "a trend of 7/8 - 2^-16 moves": robust(
        "limits of the trend", "TREND_MOVING_UP = {7 << 13 => (7 << 13) - 1}"
    ),
    "a trend of 7/8 stays": robust("limits of the trend", "self.trend {< => <=} TREND_MOVING_UP"),
    "r uninformative from 2^-11 on": robust(
        "centre at 1/2", "minus_one < {INFORMATIVE_G => INFORMATIVE_G << 1}:"
    ),
    "r uninformative to 2^-13": robust("centre at 1/2", "minus_one < {INFORMATIVE_G => INFORMATIVE_G >> 1}:"),
    "r uninformative at 2^-12": robust("centre at 1/2", "minus_one {< => <=} INFORMATIVE_G:"),
    "robust test in float32": robust_in_floats("test of the least spread", "<f"),
    "robust test in float64": robust_in_floats("test of the least spread", "<d"),
    **{
        f"{what} of 23 bits": robust("test of the least spread", f"{place}{{ =>  >> 9 << 9}}")
        for what, place in (
            ("n/t", "observed_share = q32_quotient(n, t)"),
            ("r", "fill_ratio = crowd_fill_ratio(crowd)"),
            ("p", "predicted_share = black_seen_as_black + white_seen_as_black"),
        )
    },
    "t of 14 bits in the test": robust(
        "test of the least spread", "return multiply_high({t => t % (1 << 14)}, difference_squared"
    ),
    "an update counter of 5 bits, robust": robust(
        "many rejections", "(s.updates + 1) & {COUNTER_MASK => 31}"
    ),
    # What it hears
    "compares the priority of estimates": node("unusual identifiers", receive_frame=compares(3000, 7 << 26)),
    "compares ignored bits of estimates": node("unusual identifiers", receive_frame=compares(3000, 3 << 21)),
    "refuses large alphas": node(
        "nothing seen",
        receive_frame=drops(
            lambda frame: is_estimate(frame) and alpha_float32_bits(frame) >= float32_bits(2.0**31)
        ),
    ),
    "rounds foreign alphas": node("nothing seen", receive_frame=given(to_nearest)),
    "hears itself": node(
        "its own id", _receive=given(lambda each: replace(each, sender=99) if each.sender == ID else each)
    ),
    "deaf between ticks": node(
        "between ticks", _receive=lambda node, right, message: None if node.is_settled else right(message)
    ),
    **{
        f"accepts frames with {reason.name}": node("invalid frames", receive_frame=accepts(reason))
        for reason in Rejection
        if Rejection.STANDARD_ID.value >= reason.value >= Rejection.RESERVED_BITS.value
        or reason in (Rejection.REMOTE_FRAME, Rejection.LENGTH, Rejection.ALPHA)
    },
    **{
        name: node("invalid frames", receive_frame=reads(reason, mend))
        for name, reason, mend in (
            ("does not look at the start bit", Rejection.MULTI_FRAME, put(7, lambda byte: byte | 1 << 7)),
            ("does not look at the end bit", Rejection.MULTI_FRAME, put(7, lambda byte: byte | 1 << 6)),
            ("does not look at the toggle bit", Rejection.MULTI_FRAME, put(7, lambda byte: byte | 1 << 5)),
            ("x_hat one unit too large", Rejection.X_HAT, put(0, lambda byte: byte - (byte == 1))),
            ("subjects of 8 bits", Rejection.SUBJECT, as_subject(0xFF)),
            ("leaves out bit 4 of subjects", Rejection.SUBJECT, as_subject(0x1FEF)),
            ("leaves out bit 8 of subjects", Rejection.SUBJECT, as_subject(0x1EFF)),
        )
    },
    # Commands
    "takes no observation for white": node(
        "nothing seen", observe=given(lambda z: Observation.WHITE if z is None else z)
    ),
    "answers late": node(
        "nothing seen", observe=lambda node, right, z: ([] if node.is_settled else node.settle()) + right(z)
    ),
    "obeys others": node(
        "stray commands", _follow_command=given(lambda command: replace(command, target=ID))
    ),
    "ignores settles for every robot": node(
        "unusual commands",
        _follow_command=drops(
            lambda command: command.target == EVERY_ROBOT and command.action is Action.SETTLE
        ),
    ),
    "obeys one node": node(
        "unusual commands", _follow_command=drops(lambda command: command.sender != DRIVER_ID)
    ),
    "checks the spare byte": node(
        "unusual commands",
        receive_frame=drops(lambda frame: isinstance(decode_command(frame), Command) and frame.data[6] != 0),
    ),
    "compares the priority of commands": node("unusual commands", receive_frame=compares(3002, 7 << 26)),
    "compares ignored bits of commands": node("unusual commands", receive_frame=compares(3002, 3 << 21)),
    "numbers of 8 bits": numbers_of(8),
    "numbers of 31 bits": numbers_of(31),
    "ignores older numbers": node(
        "unusual commands",
        _follow_command=lambda node, right, each: (
            [] if each.tick < (node._tick_of_command or 0) else right(each)
        ),
    ),
    "estimate before heartbeat": node("nothing seen", observe=lambda node, right, z: right(z)[::-1]),
    "hangs": node(
        "nothing seen", receive_frame=lambda node, right, frame: right(frame) if node.ticks < 200 else []
    ),
    # The wire
    "another priority": sends(3000, flip(1 << 26)),
    "another priority of telemetry": sends(3001, flip(1 << 27)),
    "another priority of heartbeats": sends(7509, flip(1 << 28)),
    "bit 23 set": sends(3000, flip(1 << 23)),
    "bit 7 set": sends(3001, flip(1 << 7)),
    "CAN FD": sends(3000, change(is_fd=lambda is_fd: True)),
    "7 bytes": sends(3001, change(data=lambda data: data[:7])),
    "another tail": sends(3000, put(7, lambda byte: byte & 0x3F)),
    "transfer ids modulo 16": sends(3000, put(7, lambda byte: byte & 0xEF)),
    "another transfer id of telemetry": sends(3001, put(7, lambda byte: byte ^ 1)),
    "transfer ids stand still": sends(7509, put(7, lambda byte: 0xE0)),
    "x rounded in telemetry": sends(3001, put(0, lambda byte: byte ^ 1)),
    "b_hat cut in telemetry": sends(3001, put(3, lambda byte: byte + 1)),
    "another subject of telemetry": sends(3001, flip(1 << 11)),
    "says it twice": sends(3000, lambda frame: [frame, frame]),
    "no heartbeats": sends(7509, lambda frame: []),
    "uptime in ticks": sends(7509, put(0, lambda byte: 10 * byte)),
    "health caution": sends(7509, put(4, lambda byte: byte | 2)),
    "mode maintenance": sends(7509, put(5, lambda byte: byte | 2)),
    "heartbeats twice as often": node(
        "nothing seen",
        observe=lambda node, right, z: (node.start() if node.ticks % 10 == 5 else []) + right(z),
    ),
}
