"""Controllers that are wrong, each in one way, with the phase that finds it.

Most are mistakes that one makes when porting the firmware or writing a node from docs/design.md.
"""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import can

from crosschecks import FAULTS, changed_sources, mirror_with
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
from mcp_asdf_tools.robots.bus_robot import EstimateRows
from mcp_asdf_tools.robots.lockstep import DRIVER_ID
from mcp_asdf_tools.robots.node import RobotNode, Subjects
from mcp_asdf_tools.robots.robot_setup import RobotSetup
from mcp_asdf_tools.swarm.fault_injection.parsing import parse_fault
from mcp_asdf_tools.swarm.settings import SwarmSettings
from mcp_asdf_tools.tables.thresholds import generate, parse_omega
from wire import setup_of_robot

ID = 3
"""Id of the controller that is verified."""
B_HAT = 0.55
"""b_hat, the accuracy that the controller assumes of its sensor at its start."""

DEFAULT_CONFIG: dict[str, Any] = {
    "b_hat": 0.95,
    "filter_period": 1000,
    "table": generate(parse_omega("0.05"), 127),
}
"""The configuration of a controller that is set up by the defaults."""
ROBUST_FILTER: dict[str, Any] = {"filter": Filter.ROBUST, "table": None}
"""The robust filter, in which the latest estimate of each neighbour votes."""
FILTER_WITHOUT_TEST: dict[str, Any] = {"filter": Filter.ALWAYS, "table": None}
"""Re-estimates of b_hat without a test."""
HALVED = {"memory": 512}
"""A memory that a run fills, so that the counts are halved."""
SLOW = {"comms_period": 5}
"""Rounds of several ticks."""

ESTIMATES, TELEMETRY, COMMANDS, HEARTBEATS = 3000, 3001, 3002, 7509
"""Subjects of frames."""
USUAL_BITS = {ESTIMATES: 4 << 26 | 3 << 21, COMMANDS: 3 << 26 | 3 << 21}
"""Priority and reserved bits of the identifiers that nodes usually send, by subject."""

Override = Callable[..., Any]
"""A function that replaces a method of the node. Its arguments are the node, the right method, and what the
method was called with."""


def right_setup(**config: Any) -> RobotSetup:
    """Return the setup of the controller, as the verification knows it."""
    return setup_of_robot(**{"robot": ID, "firmware": "mirror", "b_hat": B_HAT, **config})


def settings_with_four_neighbours(
    controller: RobotSetup | None = None, faults: str = "", **world: Any
) -> RadioSettings:
    """Return settings of a controller, by default robot 3, among four neighbours, robots 0, 1, 2 and 4."""
    setup = controller or right_setup()
    neighbours = tuple(replace(setup, id=robot, b_hat=0.95) for robot in choose_ids(setup.id, 4))
    swarm = SwarmSettings(robots=5, **{"seed": 6} | world)
    return RadioSettings(setup, neighbours, swarm, Subjects(), tuple(map(parse_fault, faults.split())))


# --- Kinds of wrong controllers ---


@dataclass(frozen=True)
class Wrong:
    """A wrong controller.

    Attributes:
        phase: The phase that finds it with the configuration DEFAULT_CONFIG.
        config: What its configuration must be, beside that, for the mistake to show.
        make: Makes the controller, with ``config`` on top of another configuration.
    """

    phase: str
    config: dict[str, Any]
    make: Callable[[dict[str, Any]], RobotNode]


def with_setup(
    phase: str,
    config: dict[str, Any] | None = None,
    node_class: type = RobotNode,
    firmware: Callable[..., Any] = MirrorRobot,
    **actual_config: Any,
) -> Wrong:
    """Return a controller whose setup differs in ``actual_config`` from what the verification knows.

    The verification knows ``config``.
    """
    known_config = config or {}

    def make(other_config: dict[str, Any]) -> RobotNode:
        settings = {"robot": ID, "firmware": "mirror", **other_config, **known_config, **actual_config}
        setup = setup_of_robot(**settings)
        node: RobotNode = node_class(setup, make=lambda: firmware(setup.config, setup.id, setup.b_hat))
        return node

    return Wrong(phase, known_config, make)


def with_firmware(phase: str, *changes: str, config: dict[str, Any] | None = None) -> Wrong:
    """Return a controller whose firmware is the mirror with changes as ``mirror_with`` reads them."""
    changed_sources(*changes)  # fails at once if the mirror has no such place any more, not in a slow test

    def make(*arguments: Any) -> Any:
        return mirror_with(*changes)(*arguments)

    return with_setup(phase, config, firmware=make)


def with_robust_firmware(phase: str, *changes: str) -> Wrong:
    """Return a controller with the robust filter and changes in its firmware."""
    return with_firmware(phase, *changes, config=ROBUST_FILTER)


def with_robust_test_in_float32(phase: str) -> Wrong:
    """Return a controller whose robust filter tests in float32."""
    return with_robust_firmware(
        phase,
        """        {is_rejected = robust_test_rejects(robust, s.t, s.n, centre, spread) => def fit(value):
            return struct.unpack('<f', struct.pack('<f', value))[0]
        t, n = s.t, s.n
        b_hat, r = fit(robust.initial_b_hat / 2**32), fit(centre / 2**24)
        p = fit(fit(b_hat * r) + fit(fit(1 - b_hat) * fit(1 - r)))
        share = fit(n / t)
        variance = max(fit(share * fit(1 - share)), fit(p * fit(1 - p)))
        dispersed_variance = fit(robust.dispersion / 2**8 * variance)
        g_spread = fit(fit(fit(2 * b_hat) - 1) * fit(spread / 2**24))
        limit = fit(12 * fit(fit(dispersed_variance / t) + fit(g_spread * g_spread)))
        is_rejected = fit(fit(share - p) * fit(share - p)) > limit}
        if is_rejected""",
    )


def with_node(phase: str, **overrides: Override) -> Wrong:
    """Return a controller whose node has other methods, by their names."""

    def method(name: str, override: Override) -> Override:
        return lambda self, *args: override(self, partial(getattr(RobotNode, name), self), *args)

    methods = {name: method(name, override) for name, override in overrides.items()}
    return with_setup(phase, node_class=type("WrongNode", (RobotNode,), methods))


def with_sent_frames(
    subject: int, change_frame: Callable[[can.Message], list[can.Message] | object]
) -> Wrong:
    """Return a controller that sends wrong frames of one subject.

    ``change_frame`` returns a list of frames to send instead of a frame, or else it changes that frame.
    """

    def send_wrongly(node: Any, usual: Override, *args: Any) -> list[can.Message]:
        sent_frames: list[can.Message] = []
        for frame in usual(*args):
            replacement = change_frame(frame) if subject_of(frame) == subject else None
            sent_frames += replacement if isinstance(replacement, list) else [frame]
        return sent_frames

    return with_node("nothing seen", begin_tick=send_wrongly, end_tick=send_wrongly)


def with_tick_numbers_of(bits: int) -> Wrong:
    """Return a controller that keeps so many bits of the number of a tick."""
    return with_node(
        "unusual commands",
        _follow_command=with_changed_argument(lambda command: replace(command, tick=command.tick % 2**bits)),
    )


def table_wrong_at(m: int) -> Table:
    """Return the default t-table with the entry for m a thousandth too large, if it stays above the next."""
    right_table = DEFAULT_CONFIG["table"]
    entries = list(right_table.entries)
    entries[m - 2] += entries[m - 2] >> 10
    return Table(right_table.omega_word, tuple(entries))


# --- Overrides of any method ---


def with_changed_argument(change: Callable[[Any], object]) -> Override:
    """Return an override that calls the right method with another argument."""
    return lambda node, usual, argument: usual(change(argument))


def ignoring(is_ignored: Callable[[Any], bool]) -> Override:
    """Return an override that does not take some frames, or commands."""
    return lambda node, usual, argument: [] if is_ignored(argument) else usual(argument)


# --- Overrides of receive_frame ---


def subject_of(frame: can.Message) -> int:
    """Return the subject in a frame's identifier."""
    return frame.arbitration_id >> 8 & 0x1FFF


def is_estimate(frame: can.Message) -> bool:
    """Return whether a frame is a legal estimate."""
    return isinstance(decode_estimate(frame, FrameFormat()), Estimate)


def ignoring_unusual_bits(subject: int, mask: int) -> Override:
    """Return an override that takes frames of a subject only if these identifier bits are the usual ones."""

    def is_unusual(frame: can.Message) -> bool:
        return subject_of(frame) == subject and bool((frame.arbitration_id ^ USUAL_BITS[subject]) & mask)

    return ignoring(is_unusual)


def taking_at_most(max_estimates: int) -> Override:
    """Return an override that takes no more than so many estimates in a tick."""

    def receive_frame(node: Any, usual: Override, frame: can.Message) -> Any:
        if not is_estimate(frame):
            return usual(frame)
        last_tick, count = vars(node).get("taken", (None, 0))
        count = count + 1 if last_tick == node.ticks else 1
        node.taken = node.ticks, count
        return usual(frame) if count <= max_estimates else []

    return receive_frame


def without_check(reason: Rejection, mend: Callable[[can.Message], object]) -> Wrong:
    """Return a controller that mends frames before it takes them if they must be rejected for this reason."""

    def receive_frame(node: Any, usual: Override, frame: can.Message) -> Any:
        if decode_estimate(frame, FrameFormat()) is reason:
            frame = copy(frame)
            frame.data = bytearray(frame.data)
            mend(frame)
        return usual(frame)

    return with_node("invalid frames", receive_frame=receive_frame)


def accepting(reason: Rejection) -> Override:
    """Return an override that reads an estimate out of all that must be rejected for this reason."""

    def receive_frame(node: Any, usual: Override, frame: can.Message) -> Any:
        if decode_estimate(frame, FrameFormat()) is not reason:
            return usual(frame)
        data = int.from_bytes(frame.data.ljust(8, b"\0"), "little")
        x_hat = min(data & 0xFF_FFFF, ONE)
        alpha_bits = min(data >> 24 & 0x7FFF_FFFF, 0x7F7F_FFFF)
        sender = frame.arbitration_id & 0x7F
        node.robot.receive_raw(sender, x_hat, alpha_word_from_float32_bits(alpha_bits))
        return []

    return receive_frame


def round_alpha_to_nearest(frame: can.Message) -> can.Message:
    """Return an estimate with alpha as the nearest multiple of 2^-24; other frames as they are."""
    if not is_estimate(frame) or float32_value(alpha_float32_bits(frame)) > 1:
        return frame
    alpha = round(float32_value(alpha_float32_bits(frame)) * 2**24) / 2**24
    rounded_frame = copy(frame)
    rounded_frame.data = frame.data[:3] + float32_bits(alpha).to_bytes(4, "little") + frame.data[7:]
    return rounded_frame


# --- Overrides of other methods ---


def drop_older_transfer_ids(node: Any, usual: Override, frame: can.Message) -> object:
    """Take an estimate only if its transfer_id follows the sender's last one, modulo 32."""
    estimate = decode_estimate(frame, node.subjects.estimates)
    if not isinstance(estimate, Estimate):
        return usual(frame)
    last_ids = vars(node).setdefault("last_ids", {})
    last_id = last_ids.get(estimate.sender, estimate.transfer_id - 1)
    if (estimate.transfer_id - last_id) % 32 >= 16:
        return []
    last_ids[estimate.sender] = estimate.transfer_id
    return usual(frame)


def replace_own_id_by_99(estimates: EstimateRows) -> EstimateRows:
    """Return estimates in which 99 stands for the robot's own id, whose estimates it must refuse."""
    changed_estimates = estimates.copy()
    senders = changed_estimates[:, 0]
    senders[senders == ID] = 99
    return changed_estimates


def buffer_4_commands(node: Any, usual: Override, command: Command) -> list[can.Message]:
    """Lose commands after the fourth since a settle."""
    waiting = getattr(node, "waiting", 0) + 1
    node.waiting = 0 if command.action is Action.SETTLE else waiting
    return usual(command) if node.waiting <= 4 else []


def settle_in_any_tick(node: Any, usual: Override, command: Command) -> Any:
    """Follow a settle command of another tick, too."""
    if command.action is Action.SETTLE and command.target in (ID, EVERY_ROBOT):
        node._tick_of_command = command.tick
    return usual(command)


def stay_in_tick(node: Any, usual: Override, command: Command) -> Any:
    """Ignore commands of other ticks until a tick is settled."""
    return [] if not node.is_settled and command.tick != node._tick_of_command else usual(command)


def tick_before_start(node: Any, usual: Override) -> Any:
    """Make a tick before the start."""
    node.begin_tick(Observation.BLACK)
    node.end_tick()
    return usual()


# --- Changes of frames ---


def change(**changes: Callable[[Any], object]) -> Callable[[can.Message], None]:
    """Return a change of some members of a frame, by their names."""

    def change_frame(frame: can.Message) -> None:
        for name, changed in changes.items():
            setattr(frame, name, changed(getattr(frame, name)))

    return change_frame


def flip_identifier(bits: int) -> Callable[[can.Message], None]:
    """Return a change that flips identifier bits."""
    return change(arbitration_id=lambda identifier: identifier ^ bits)


def change_byte(index: int, changed: Callable[[int], int]) -> Callable[[can.Message], None]:
    """Return a change of one byte. Only the low 8 bits of its new value count."""

    def change_data(data: bytearray) -> bytearray:
        return data[:index] + bytearray([changed(data[index]) & 0xFF]) + data[index + 1 :]

    return change(data=change_data)


def as_estimate_if_equal_in(mask: int) -> Callable[[can.Message], None]:
    """Return a change that gives a frame the subject of estimates if its own equals that in these bits."""

    def change_identifier(identifier: int) -> int:
        is_different = (identifier >> 8 ^ ESTIMATES) & mask
        return identifier if is_different else identifier & ~(0x1FFF << 8) | ESTIMATES << 8

    return change(arbitration_id=change_identifier)


# --- The wrong controllers ---

UPDATE_COUNTER_OF_5_BITS = "s.updates = {next_count(s.updates) => (s.updates + 1) & 31}"
"""A change of the mirror, whose counter of updates then wraps after 31."""
ROBUST_FAULTS_BY_PHASE: dict[str, tuple[str, ...]] = {
    "first estimates": (
        "slot: ids up to 31",
        "slot: ids modulo 16",
        "slot: the next one",
        "slot: without confidence",
        "slot: first estimate of a sender",
        "vote: every message",
        "vote: the turn stays",
        "vote: the turn does not go back to 0",
        "vote: gain",
        "vote: the first is the centre",
        "vote: clamp",
        "vote: clamp at two spreads",
        "vote: spread",
        "vote: the spread never shrinks",
        "vote: largest spread",
        "vote: order",
        "vote: own estimate",
        "broadcast: the centre of the votes",
    ),
    "threshold of few estimates": (
        "slot: rounding",
        "batch: begins anew",
        "batch: begins too early",
        "dispersion: weight",
        "dispersion: smallest",
        "dispersion: none",
        "table: median",
        "table: smallest spread",
        "table: no steps",
        "table: mean of all estimates",
        "robust test: centre of the votes",
        "robust test: spread of the votes",
        "robust test: three sigmas",
        "robust test: no spread",
        "robust test: variance of the count alone",
        "robust test: tests the present b_hat",
        "precision: n/t of 23 bits",
        "precision: p of 23 bits",
        "robust test: sigmas",
        "robust test: sigmas of the centre",
        "robust test: variance",
        "robust test: dispersion",
        "robust: present b_hat is the initial one",
        "robust: way back",
    ),
    "extreme messages": ("slot: 1.0 wraps",),
    "test of few estimates": (
        "slot: average of a sender",
        "vote: not in the round of a test",
        "vote: constant gain",
        "vote: smallest gain 1/256",
        "vote: smallest gain 1/64",
        "table: four estimates",
        "table: five estimates are too few",
        "robust: eq. 8 from its own estimate",
        "robust: eq. 8 from the centre of the votes",
    ),
    "no confidence of its own": ("vote: own estimate without confidence",),
    "test of a wide spread": ("dispersion: outlier",),
    "supporters": (
        "vote: smallest spread",
        "supporters: none",
        "supporters: half",
        "supporters: two fifths",
    ),
}
"""Names of faults of the robust filter, as in ``crosschecks.FAULTS``, by the phase that finds them."""

WRONG: dict[str, Wrong] = {
    "a buffer of 4 commands": with_node("nothing seen", _follow_command=buffer_4_commands),
    "drops older transfer ids": with_node("among neighbours", receive_frame=drop_older_transfer_ids),
    "settles in any tick": with_node("stray commands", _follow_command=settle_in_any_tick),
    "stays in a tick": with_node("nothing seen", _follow_command=stay_in_tick),
    # How it is set up
    "another b_hat": with_setup("nothing seen", b_hat=0.56),
    "broadcasts in every tick": with_setup("nothing seen", SLOW, comms_period=1),
    "another id": with_setup("nothing seen", robot=4),
    "has run before": with_node("nothing seen", start=tick_before_start),
    "another filter period": with_setup("all white", filter_period=9),
    "filters always": with_setup("rounds without a test", filter=Filter.ALWAYS),
    "filters though it should not": with_setup(
        "no filter", {"filter": Filter.OFF, "table": None}, filter=Filter.ALWAYS
    ),
    "memory 8192": with_setup("large sums", memory=8192),
    "memory 64": with_setup("alone", memory=64),
    "t-table of omega 0.04": with_setup("threshold of 2 messages", table=generate(parse_omega("0.04"), 127)),
    **{
        f"threshold of {m} messages wrong": with_setup(f"threshold of {m} messages", table=table_wrong_at(m))
        for m in (2, 3, 5, 10)
    },
    "threshold of many messages wrong": with_setup("threshold of 30 messages", table=table_wrong_at(30)),
    # The method
    "rejects its own estimate": with_firmware(
        "own estimate", "return {diff => difference == 0 or diff}erence *"
    ),
    "tests its informed estimate": with_firmware("no information", "ending_round, {s.x_hat => self.x_raw})"),
    "tests one message": with_firmware(
        "rounds without a test",
        "= {2 => 1} if config.filter ==",
        "if {not => s.open.count > 1 and not} asdf_test_rejects",
    ),
    "never updates": with_firmware("all white", "return {reestimate(s.t, s.n, x_bar) => None}"),
    "x_bar not weighted in eq. 8": with_firmware(
        "few observations", "x_bar = round_mean({s.closed => Closed(s.open.count << 24, s.open.x << 24)})"
    ),
    "eq. 8 in float32": with_firmware("few observations", "min(max({b_hat => b_hat >> 10 << 10}, B_HAT_MIN)"),
    "b_hat clamped elsewhere": with_firmware(
        "all white", "max(b_hat, {B_HAT_MIN), B_HAT_MAX => 42950), 2**32 - 42950})"
    ),
    "updates at x_bar = 1/2": with_firmware(
        "re-estimates", "INFORMATIVE_G:\n        return {None => B_HAT_MAX}"
    ),
    "a re-estimate changes x_hat at once": with_firmware(
        "all white", "s.updated = 1{ => ; s.x_hat, s.alpha = estimate(s.t, s.n, s.accuracy)}"
    ),
    "divides by 2 b - 1 = 0": with_firmware("no information", "return {HALF => ONE}, 0"),
    "keeps x_bar in silence": with_firmware("nothing seen", "{ => if s.open.count: }s.closed = Closed(s."),
    "a bitmap of 32 senders": with_firmware("alike ids", "return {word_index => 0}, 1 << bit"),
    "does not hear robot 127": with_firmware("every sender", "0 <= sender {<= => <} MAX_ID"),
    "at most 100 messages": with_firmware(
        "growing rounds", "status != Status.OK{ =>  or s.open.count > 99}:"
    ),
    "takes the last message of a sender": with_firmware(
        "same sender",
        "def {_receive => _receive(self, *message: int) -> Status:\n        "
        "vars(self).setdefault('kept', {})[message[0]] = message; return Status.OK\n\n    "
        'def _take}(self, sender: int, x_hat: int, alpha: int) -> Status:\n        """Add',
        "is_updated = False{ => ; [self._take(*m) for m in vars(self).pop('kept', {}).values()]}",
    ),
    "loses low bits of alpha": with_firmware("nothing seen", "units = alpha_units(alpha){ =>  >> 8 << 8}"),
    "takes alpha = 0 for a little": with_firmware("nothing seen", "s.open, x_hat, alpha{ =>  or 0x100})"),
    "colours exchanged": with_firmware("alone", "colour = {operator.index(z) => 1 - operator.index(z)}"),
    "rounds x_hat up": with_firmware(
        "first black tiles", "s.updated = 0{ => ; s.x_hat += 0 < s.x_hat < HALF}"
    ),
    "alpha of 20 bits": with_firmware("alone", "s.updated = 0{ => ; s.alpha &= 0xFFFF_F01F}"),
    "halves down": with_firmware("rounds without a test", FAULTS["halving: ties to even"], config=HALVED),
    "halves up": with_firmware(
        "rounds without a test", "s.n = {round(s.n / 2) => (s.n + 1) // 2}", config=HALVED
    ),
    "broadcasts x": with_firmware("nothing seen", "return {self.s.x_hat => self.x_raw}\n"),
    # Ends of ranges
    "x_hat at least 0.01": with_firmware(
        "alone", "is_mirrored else {x_hat_of_rarer => max(x_hat_of_rarer, ONE // 100)}\n"
    ),
    "x_hat wrong below 0.2": with_firmware(
        "first black tiles",
        "mirrored else {x_hat_of_rarer => x_hat_of_rarer ^ (0 < x_hat_of_rarer < ONE // 5)}\n",
    ),
    "alpha wrong without a black tile": with_firmware(
        "alone", "return x_hat, alpha_word_from_units(alpha){ =>  ^ (n == 0) << 8}"
    ),
    "alpha wrong where x_hat is clamped": with_firmware(
        "stray commands", "shorter_common_term = {common_term => 0 * common_term} >> acc"
    ),
    "alpha wrong there after 100 tiles": with_firmware(
        "all white", "at_end(accuracy, {t => t ^ (t > 100)}, rare_count)"
    ),
    "alpha of one significant bit below 1/2": with_firmware(
        "no information",
        "alpha_word_from_units({alpha => alpha if alpha >= 1 << 23 else 1})\n\n\ndef estimate_of",
    ),
    "knows nothing below 2^-10": with_firmware("no information", "INFORMATIVE_G = 1 << {20 => 22}"),
    "senders stay heard after an update": with_firmware(
        "all white", "s.heard = {[0, 0, 0, 0] => s.heard if is_updated else [0, 0, 0, 0]}"
    ),
    "senders stay heard after a test": with_firmware(
        "all white",
        "s.heard = {[0, 0, 0, 0] => s.heard if s.filter_left == self.config.filter_period else [0, 0, 0, 0]}",
    ),
    "messages stay after an update": with_firmware(
        "all white", "s.open = {Sums() => s.open if is_updated else Sums()}"
    ),
    "re-estimates before it has observed": with_firmware("nothing seen", "if {s.t == 0 => False}:\n"),
    "no re-estimate without a black tile": with_firmware("all white", "if {s.t == 0 => s.n == 0}:\n"),
    "x_bar of 1 is 0": with_firmware(
        "estimates of 0 and 1", "{x_bar < => (x_bar := x_bar * (x_bar < MAX_WORD - 9)) <} Q32_HALF:"
    ),
    "sums of alpha up to 2^45 in eq. 8": with_firmware(
        "all white", "alpha_x, {closed.alpha => min(closed.alpha, 1 << 45)} *"
    ),
    "sums of alpha from 2^32 in eq. 8": with_firmware(
        "few observations", "alpha_x, {closed.alpha => max(closed.alpha, 1 << 32)} *"
    ),
    "a square of 54 bits": with_firmware(
        "threshold of 126 messages", "return {difference => (1 << 54) - 1 & difference} * difference >"
    ),
    "a spread of 56 bits": with_firmware(
        "threshold of 126 messages", "sum_x_squared - sum_x * sum_x{ =>  & (1 << 56) - 1}"
    ),
    "b_hat wrong for t below 500": with_firmware(
        "few observations", "return reestimate(s.t, s.n{ =>  + (s.t < 500)}, x_bar)"
    ),
    "b_hat wrong for t from 100 to 500": with_firmware(
        "few observations", "return reestimate(s.t, s.n{ =>  + (100 < s.t < 500)}, x_bar)"
    ),
    "eq. 8 wrong for sums of alpha below 1": with_firmware(
        "few observations",
        "return q32_quotient(closed.alpha_x{ =>  + ((closed.alpha < 1 << 24) << 22)}, closed.alpha * ONE)",
    ),
    "eq. 8 never shifts up": with_firmware(
        "few observations",
        "dropped_bits = denominator.bit_length(){ => \n    if dropped_bits < 32:\n"
        "        return (numerator << 16) // denominator << 16}",
    ),
    "t of 14 bits in eq. 8": with_firmware(
        "estimates of 0 and 1", "return reestimate(s.t{ =>  % (1 << 14)}, s.n, x_bar)"
    ),
    "an update counter of 5 bits": with_firmware("many updates", UPDATE_COUNTER_OF_5_BITS),
    "tests in float64": with_firmware(
        "threshold of 126 messages",
        "return {difference * difference => float(difference) * difference} > limit",
        "limit = {(table.entry(m) * scaled_variance) >> FRACTION_BITS => "
        "table.entry(m) / 2**FRACTION_BITS * float(scaled_variance)}",
    ),
    "thresholds of 23 fraction bits": with_firmware(
        "threshold of 3 messages", "{table.entry(m) => (table.entry(m) & ~7)} * scaled_variance"
    ),
    "tests though it should not": with_setup(
        "re-estimates without a test",
        FILTER_WITHOUT_TEST,
        filter=Filter.ADAPTIVE,
        table=DEFAULT_CONFIG["table"],
    ),
    "needs two messages without a test": with_firmware(
        "re-estimates without a test",
        "messages_needed = 2 if config.filter == Filter.ADAPTIVE else {1 => 2}",
        config=FILTER_WITHOUT_TEST,
    ),
    **{
        f"{most} messages in a tick": with_node("a crowded tick", receive_frame=taking_at_most(most))
        for most in (200, 256, 500)
    },
    # The robust filter
    **{
        fault: with_robust_firmware(phase, FAULTS[fault])
        for phase, faults in ROBUST_FAULTS_BY_PHASE.items()
        for fault in faults
    },
    "keeps later estimates of a sender in a round": with_robust_firmware(
        "its own id",
        "            { => keep_estimate(s.robust, s.estimates, sender, x_hat); }return Status.REPEATED",
    ),
    "x is 1/2 before the first vote": with_robust_firmware(
        "alone", "self._centre_of_votes({self.s.x_hat => HALF})"
    ),
    "the batch goes on at a halving": with_firmware(
        "test of a wide spread",
        FAULTS["batch: halving"],
        config=ROBUST_FILTER | HALVED | {"b_hat": B_HAT, "filter_period": 50},
    ),
    "spread without a ceiling in the test": with_firmware(
        "estimates far apart",
        FAULTS["table: largest spread"],
        config=ROBUST_FILTER | {"b_hat": B_HAT},
    ),
    "robust test in float32": with_robust_test_in_float32("threshold of few estimates"),
    "variance of the prediction alone": with_robust_firmware(
        "threshold of few estimates", "variance = max({variance_of_observation(share) => 0},"
    ),
    "t of 14 bits in the test": with_robust_firmware(
        "test of the least spread", "left_side = q32_from_q64({t => t % (1 << 14)} * excess)"
    ),
    "a centre is uninformative up to 2^-11": with_robust_firmware(
        "estimates of 1/2", "minus_one < {INFORMATIVE_G => INFORMATIVE_G << 1}:"
    ),
    "a centre is uninformative up to 2^-13": with_robust_firmware(
        "estimates of 1/2", "minus_one < {INFORMATIVE_G => INFORMATIVE_G >> 1}:"
    ),
    "a centre is uninformative at 2^-12": with_robust_firmware(
        "estimates of 1/2", "minus_one {< => <=} INFORMATIVE_G:"
    ),
    "an update counter of 5 bits, robust": with_robust_firmware("long run", UPDATE_COUNTER_OF_5_BITS),
    # What it hears
    "compares the priority of estimates": with_node(
        "unusual identifiers", receive_frame=ignoring_unusual_bits(ESTIMATES, 7 << 26)
    ),
    "compares ignored bits of estimates": with_node(
        "unusual identifiers", receive_frame=ignoring_unusual_bits(ESTIMATES, 3 << 21)
    ),
    "refuses large alphas": with_node(
        "nothing seen",
        receive_frame=ignoring(
            lambda frame: is_estimate(frame) and alpha_float32_bits(frame) >= float32_bits(2.0**31)
        ),
    ),
    "rounds foreign alphas": with_node(
        "nothing seen", receive_frame=with_changed_argument(round_alpha_to_nearest)
    ),
    "hears itself": with_node("its own id", receive_all=with_changed_argument(replace_own_id_by_99)),
    "deaf between ticks": with_node(
        "between ticks", receive_all=lambda node, usual, rows: None if node.is_settled else usual(rows)
    ),
    **{
        f"accepts frames with {reason.name}": with_node("invalid frames", receive_frame=accepting(reason))
        for reason in Rejection
        if Rejection.STANDARD_ID.value >= reason.value >= Rejection.RESERVED_BITS.value
        or reason in (Rejection.REMOTE_FRAME, Rejection.LENGTH, Rejection.ALPHA)
    },
    "does not look at the start bit": without_check(
        Rejection.MULTI_FRAME, change_byte(7, lambda byte: byte | 1 << 7)
    ),
    "does not look at the end bit": without_check(
        Rejection.MULTI_FRAME, change_byte(7, lambda byte: byte | 1 << 6)
    ),
    "does not look at the toggle bit": without_check(
        Rejection.MULTI_FRAME, change_byte(7, lambda byte: byte | 1 << 5)
    ),
    "x_hat one unit too large": without_check(
        Rejection.X_HAT, change_byte(0, lambda byte: 0 if byte == 1 else byte)
    ),
    "subjects of 8 bits": without_check(Rejection.SUBJECT, as_estimate_if_equal_in(0xFF)),
    "leaves out bit 4 of subjects": without_check(Rejection.SUBJECT, as_estimate_if_equal_in(0x1FEF)),
    "leaves out bit 8 of subjects": without_check(Rejection.SUBJECT, as_estimate_if_equal_in(0x1EFF)),
    # Commands
    "takes no observation for white": with_node(
        "nothing seen", begin_tick=with_changed_argument(lambda z: Observation.WHITE if z is None else z)
    ),
    "answers late": with_node(
        "nothing seen",
        begin_tick=lambda node, usual, z: ([] if node.is_settled else node.end_tick()) + usual(z),
    ),
    "obeys others": with_node(
        "stray commands", _follow_command=with_changed_argument(lambda command: replace(command, target=ID))
    ),
    "ignores settles for every robot": with_node(
        "unusual commands",
        _follow_command=ignoring(
            lambda command: command.target == EVERY_ROBOT and command.action is Action.SETTLE
        ),
    ),
    "obeys one node": with_node(
        "unusual commands", _follow_command=ignoring(lambda command: command.sender != DRIVER_ID)
    ),
    "checks the spare byte": with_node(
        "unusual commands",
        receive_frame=ignoring(
            lambda frame: isinstance(decode_command(frame), Command) and frame.data[6] != 0
        ),
    ),
    "compares the priority of commands": with_node(
        "unusual commands", receive_frame=ignoring_unusual_bits(COMMANDS, 7 << 26)
    ),
    "compares ignored bits of commands": with_node(
        "unusual commands", receive_frame=ignoring_unusual_bits(COMMANDS, 3 << 21)
    ),
    "numbers of 8 bits": with_tick_numbers_of(8),
    "numbers of 31 bits": with_tick_numbers_of(31),
    "ignores older numbers": with_node(
        "unusual commands",
        _follow_command=lambda node, usual, command: (
            [] if command.tick < (node._tick_of_command or 0) else usual(command)
        ),
    ),
    "estimate before heartbeat": with_node("nothing seen", begin_tick=lambda node, usual, z: usual(z)[::-1]),
    "hangs": with_node(
        "nothing seen", receive_frame=lambda node, usual, frame: usual(frame) if node.ticks < 200 else []
    ),
    # The wire
    "another priority": with_sent_frames(ESTIMATES, flip_identifier(1 << 26)),
    "another priority of telemetry": with_sent_frames(TELEMETRY, flip_identifier(1 << 27)),
    "another priority of heartbeats": with_sent_frames(HEARTBEATS, flip_identifier(1 << 28)),
    "bit 23 set": with_sent_frames(ESTIMATES, flip_identifier(1 << 23)),
    "bit 7 set": with_sent_frames(TELEMETRY, flip_identifier(1 << 7)),
    "CAN FD": with_sent_frames(ESTIMATES, change(is_fd=lambda is_fd: True)),
    "7 bytes": with_sent_frames(TELEMETRY, change(data=lambda data: data[:7])),
    "another tail": with_sent_frames(ESTIMATES, change_byte(7, lambda byte: byte & 0x3F)),
    "transfer ids modulo 16": with_sent_frames(ESTIMATES, change_byte(7, lambda byte: byte & 0xEF)),
    "another transfer id of telemetry": with_sent_frames(TELEMETRY, change_byte(7, lambda byte: byte ^ 1)),
    "transfer ids stand still": with_sent_frames(HEARTBEATS, change_byte(7, lambda byte: 0xE0)),
    "x rounded in telemetry": with_sent_frames(TELEMETRY, change_byte(0, lambda byte: byte ^ 1)),
    "b_hat cut in telemetry": with_sent_frames(TELEMETRY, change_byte(3, lambda byte: byte + 1)),
    "another subject of telemetry": with_sent_frames(TELEMETRY, flip_identifier(1 << 11)),
    "says it twice": with_sent_frames(ESTIMATES, lambda frame: [frame, frame]),
    "no heartbeats": with_sent_frames(HEARTBEATS, lambda frame: []),
    "uptime in ticks": with_sent_frames(HEARTBEATS, change_byte(0, lambda byte: 10 * byte)),
    "health caution": with_sent_frames(HEARTBEATS, change_byte(4, lambda byte: byte | 2)),
    "mode maintenance": with_sent_frames(HEARTBEATS, change_byte(5, lambda byte: byte | 2)),
    "heartbeats twice as often": with_node(
        "nothing seen",
        begin_tick=lambda node, usual, z: (node.start() if node.ticks % 10 == 5 else []) + usual(z),
    ),
}
