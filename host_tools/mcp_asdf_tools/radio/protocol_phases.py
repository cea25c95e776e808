"""Phases that put frames and commands to the test, before the filter is of interest."""

from __future__ import annotations

import random
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import can

from mcp_asdf.robot import MAX_ID, Filter, Observation
from mcp_asdf_tools.bus.frame_layout import EVERY_ROBOT, Q23_ONE, Action
from mcp_asdf_tools.bus.frames import (
    Command,
    Heartbeat,
    Telemetry,
    encode_command,
    encode_heartbeat,
    encode_telemetry,
)
from mcp_asdf_tools.radio.bench import Bench
from mcp_asdf_tools.radio.rounds import EXTREMES, FOREIGN_ALPHAS, any_content, far_away
from mcp_asdf_tools.robots.lockstep import DRIVER_ID

MOST_SKIPPED = 10_000
ALONE_TICKS = 72
"""More than the shortest memory, 64."""
STRAY_REPEATS = 3
SIZES = (2, 3, 5, 10, 30, 33, 64, 126)
"""Messages of growing rounds."""
CROWDED_REPEATS = 4
"""Messages of each sender but the last one in the tick with most messages."""
CROWDED_MESSAGES = CROWDED_REPEATS * (MAX_ID - 1) + 1
"""Messages of that tick."""


Change = Callable[[can.Message], object]
"""Change of a frame in place."""
Spoil = Callable[[can.Message, random.Random], object]
"""Change of an estimate that makes it none."""


def _put(frame: can.Message, place: int, content: bytes) -> None:
    frame.data[place : place + len(content)] = content


def _between(place: int, length: int, low: int, high: int) -> Spoil:
    """Puts any number of the range there."""
    return lambda frame, draw: _put(frame, place, draw.randint(low, high).to_bytes(length, "little"))


def _clear(bit: int, frame: can.Message, draw: random.Random) -> None:
    frame.data[7] &= ~(1 << bit)


def _flip(bit: int, frame: can.Message, draw: random.Random) -> None:
    frame.arbitration_id ^= 1 << bit


def _standard(frame: can.Message, draw: random.Random) -> None:
    frame.is_extended_id = False
    frame.arbitration_id &= 0x7FF


def _remote(frame: can.Message, draw: random.Random) -> None:
    frame.is_remote_frame = True
    frame.data = bytearray()


def _shorten(least: int, most: int) -> Spoil:
    def spoil(frame: can.Message, draw: random.Random) -> None:
        frame.dlc = draw.randint(least, most)
        frame.data = frame.data[: frame.dlc]

    return spoil


MALFORMED: dict[str, Spoil] = {
    "an 11-bit identifier": _standard,
    "a remote frame": _remote,
    "7 bytes": _shorten(7, 7),
    "fewer than 7 bytes": _shorten(0, 6),
    "no single-frame tail byte": _between(7, 1, 0, 0xDF),
    "a tail byte without the start bit": partial(_clear, 7),
    "a tail byte without the end bit": partial(_clear, 6),
    "a tail byte without the toggle bit": partial(_clear, 5),
    "x_hat above 1": _between(0, 3, Q23_ONE + 2, 0xFF_FFFF),
    "x_hat one unit above 1": _between(0, 3, Q23_ONE + 1, Q23_ONE + 1),
    "alpha infinite": _between(3, 4, 0x7F80_0000, 0x7F80_0000),
    "alpha not a number": _between(3, 4, 0x7F80_0001, 0x7FFF_FFFF),
    "alpha -0": _between(3, 4, 0x8000_0000, 0x8000_0000),
    "alpha negative": _between(3, 4, 0x8000_0001, 0xFFFF_FFFF),
    "a service transfer": partial(_flip, 25),
    "an anonymous sender": partial(_flip, 24),
    "reserved bit 23 set": partial(_flip, 23),
    "reserved bit 7 set": partial(_flip, 7),
    "another subject": partial(_flip, 20),
    "another subject of the same upper bits": partial(_flip, 12),
    "another subject of the same lower bits": partial(_flip, 16),
}
"""Ways not to be an estimate, each by itself."""


def _with_bits(mask: int, bits: int, frame: can.Message) -> None:
    """Put these bits of the identifier there."""
    frame.arbitration_id = frame.arbitration_id & ~mask | bits


UNUSUAL_IDENTIFIERS: dict[str, Change] = {
    **{f"with priority {priority}": partial(_with_bits, 7 << 26, priority << 26) for priority in range(8)},
    "with identifier bits 22 and 21 clear": partial(_with_bits, 3 << 21, 0),
}
"""Changes of an identifier that make no difference."""

UNUSUAL_COMMANDS: dict[str, Change] = {
    "for every robot": lambda frame: None,
    "of another node": lambda frame: None,
    "whose spare byte is not 0": lambda frame: _put(frame, 6, b"\xff"),
    **UNUSUAL_IDENTIFIERS,
}
"""Differences of a command that make none to the robot; the first two are its sender and its target."""


def nothing_seen(bench: Bench) -> None:
    """Messages for a robot that has observed nothing: x is their mean alone, and the test comes early."""
    bench.activity = "no observation"
    bench.play_tick(None)
    is_robust = bench.config.filter is Filter.ROBUST
    if not is_robust:
        extremes(bench)
    if bench.setup.filter_period <= MOST_SKIPPED:
        bench.activity = "commands in a row"
        bench.skip_to_test_round()
        bench.activity = "a test before the first observation"
        bench.play_round(*([] if is_robust else far_away(bench.situation, bench.draw)))


def alone(bench: Bench) -> None:
    """The controller hears no messages, and all tiles are white: x_hat is 0, or 1 for b_hat below 1/2."""
    for tick in range(ALONE_TICKS):
        z = None if tick % 9 == 8 else Observation.WHITE
        bench.activity = "no observation" if z is None else "white tiles"
        bench.play_tick(z)


def first_black_tiles(bench: Bench) -> None:
    """Black tiles while x_hat is that of white ones alone, else white: small estimates, and their clamp."""
    bench.activity = "the first black tiles"
    white = bench.firmware.s.x_hat
    for _ in range(ALONE_TICKS):
        bench.play_tick(Observation(bench.firmware.s.x_hat == white or bench.draw.random() < 0.3))


def messages_and_silence(bench: Bench) -> None:
    """Ticks with a few messages of similar weight, and ticks without any."""
    for _ in range(6):
        bench.avoid_test("a few messages")
        frames = bench.encode_estimates({robot: any_content(bench.draw, 3) for robot in bench.other_ids[:3]})
        bench.play_tick(bench.draw_observation(), frames)
        bench.avoid_test("no messages")
        for _ in range(2 if bench.draw.random() < 0.5 else 1):
            bench.play_tick(bench.draw_observation())


def lost_settles(bench: Bench) -> None:
    """Every other *settle* does not come; the next *observe* ends the tick and its round all the same."""
    for _ in range(4):
        bench.avoid_test("messages in a tick whose settle is lost")
        bench.observe(bench.draw_observation())
        bench.send(
            bench.encode_estimates([(robot, any_content(bench.draw)) for robot in bench.other_ids[5:8]])
        )
        bench.leave_open()
        bench.activity = "the tick after one whose settle was lost"
        bench.play_tick(bench.draw_observation())


STRAY = {
    "an observe of the open tick": ("robot", "open", Action.OBSERVE_WHITE),
    "an observe of the open tick, for all": ("all", "open", Action.OBSERVE_BLACK),
    "a settle of a later tick": ("robot", "later", Action.SETTLE),
    "a settle of the last tick, for all": ("all", "last", Action.SETTLE),
    "a settle for another robot": ("other", "open", Action.SETTLE),
    "an observe for another robot": ("other", "later", Action.OBSERVE_WHITE),
}
"""Commands not to be obeyed between *observe* and *settle* of a tick: target, tick and action."""


def stray(bench: Bench) -> None:
    """Commands that must not be obeyed, each kind by itself."""
    for _ in range(STRAY_REPEATS):
        for name, (target, when, action) in STRAY.items():
            bench.avoid_test(name)
            bench.observe(bench.draw_observation())
            usual, other = bench.make_command(action), _another_robot(bench)
            targets = {"robot": usual.target, "other": other, "all": EVERY_ROBOT}
            later = usual.tick + 1 + bench.draw.randrange(1000)
            tick = {"open": usual.tick, "later": later, "last": usual.tick - 1}[when] % 2**32
            _send(bench, replace(usual, sender=other, tick=tick, target=targets[target]))
            bench.send(
                bench.encode_estimates({robot: any_content(bench.draw) for robot in bench.other_ids[:2]})
            )
            bench.settle()


def _another_robot(bench: Bench) -> int:
    """A robot that is neither the controller nor the node that commands it."""
    return bench.draw.choice([robot for robot in bench.other_ids if robot != DRIVER_ID])


def _send(bench: Bench, command: Command, change: Change = lambda frame: None) -> None:
    frame = encode_command(command, bench.settings.subjects.commands)
    change(frame)
    bench.send([frame])


def unusual_commands(bench: Bench) -> None:
    """Commands that differ in what makes no difference.

    After each comes the usual one of the same tick, which changes nothing unless the first was not obeyed:
    then the controller misses an observation, or has a round too many messages.
    """
    for name, change in UNUSUAL_COMMANDS.items():
        bench.avoid_test(f"commands {name}", rounds=2)  # the last message is one of the next round
        other: dict[str, Any] = {"sender": _another_robot(bench)} if name == "of another node" else {}
        other |= {"target": EVERY_ROBOT} if name == "for every robot" else {}
        _send(
            bench, replace(bench.make_command(Action.to_observe(bench.draw_observation())), **other), change
        )
        bench.observe(None)
        bench.send(bench.encode_estimates({robot: any_content(bench.draw) for robot in bench.other_ids[:2]}))
        _send(bench, replace(bench.make_command(Action.SETTLE), **other), change)
        bench.send(bench.encode_estimates({bench.other_ids[2]: any_content(bench.draw)}))
        bench.settle()
    for bit in (8, 16, 24, 31):
        for later, distance in (("higher", 1 << bit), ("lower", 1 - (1 << bit))):
            bench.avoid_test(f"an observe of a number {later} by about 2^{bit} than that of the open tick")
            bench.observe(bench.draw_observation())
            bench.leave_open(distance)
            bench.play_tick(bench.draw_observation())


def unusual_messages(bench: Bench) -> None:
    """Messages whose identifiers differ in what a receiver ignores."""
    for name, change in UNUSUAL_IDENTIFIERS.items():
        bench.avoid_test(f"messages {name}")
        frames = bench.encode_estimates({robot: any_content(bench.draw) for robot in bench.other_ids[:3]})
        change(frames[0])
        bench.play_round_of_frames(frames)


def heartbeats(bench: Bench) -> None:
    """Ticks in a row until two heartbeats were due, if they come at all often."""
    bench.activity = "commands in a row"
    bench.skip_ticks(min(2 * bench.settings.swarm.steps_per_second + 1, MOST_SKIPPED))


def invalid(bench: Bench) -> None:
    """Frames that are no estimates, each kind by itself, before a valid message of the same sender."""
    for _ in range(2):
        for name, spoil in MALFORMED.items():
            bench.avoid_test(name)
            pair = bench.draw.sample(bench.other_ids, 2)
            frames = bench.encode_estimates([(pair[0], any_content(bench.draw))])
            spoil(frames[0], bench.draw)
            bench.play_round_of_frames(
                frames + bench.encode_estimates({each: any_content(bench.draw) for each in pair})
            )
    _other_kinds(bench)


def _other_kinds(bench: Bench) -> None:
    """Messages of other kinds, which are no estimates either."""
    subjects, draw = bench.settings.subjects, bench.draw
    for sender in draw.sample(bench.other_ids, 3):
        bench.avoid_test("telemetry and a heartbeat of another robot")
        telemetry = Telemetry(
            sender, draw.randint(0, Q23_ONE), draw.randint(16, 1 << 23), draw.randrange(256), 0
        )
        beat = encode_heartbeat(Heartbeat(sender, draw.randrange(1 << 32), 0))
        frames = [encode_telemetry(telemetry, subjects.telemetry), beat]
        bench.play_round_of_frames(frames + bench.encode_estimates({sender: any_content(draw)}))


def every_sender(bench: Bench) -> None:
    """A round for every id."""
    for sender in bench.other_ids:
        bench.avoid_test(f"one message, of robot {sender}")
        bench.play_round(any_content(bench.draw), senders=[sender])


def alike_ids(bench: Bench) -> None:
    """Rounds of two senders whose ids differ in one bit."""
    others = set(bench.other_ids)
    for bit in (1 << place for place in range(7)):
        pairs = [(robot, robot | bit) for robot in others if robot & bit == 0 and robot | bit in others]
        for pair in bench.draw.sample(pairs, 2):
            bench.avoid_test(f"messages of the robots {pair[0]} and {pair[1]}")
            bench.play_round(*(any_content(bench.draw) for _ in pair), senders=pair)


def growing_rounds(bench: Bench) -> None:
    """Rounds of ever more messages."""
    for size in SIZES:
        bench.avoid_test(f"a round of {size} messages")
        bench.play_round(*(any_content(bench.draw) for _ in range(size)))


def crowded_tick(bench: Bench) -> None:
    """Send hundreds of messages in a tick, most of them repeated ones; the last counts: its sender is new."""
    *senders, last_sender = bench.other_ids
    bench.avoid_test(f"a tick with {CROWDED_MESSAGES} messages")
    sequence = senders * CROWDED_REPEATS + [last_sender]
    frames = bench.encode_estimates([(sender, any_content(bench.draw)) for sender in sequence])
    bench.skip_ticks(-bench.model.ticks % bench.setup.comms_period)
    bench.play_tick(bench.draw_observation(), frames)
    bench.skip_ticks(-bench.model.ticks % bench.setup.comms_period)


def extremes(bench: Bench) -> None:
    """Messages at the ends of the ranges, and confidences that no robot of ours sends."""
    for name, contents in EXTREMES.items():
        bench.avoid_test(name)
        bench.play_round(*contents)
    for name, bits in FOREIGN_ALPHAS.items():
        bench.avoid_test(name)
        frames = bench.encode_estimates(
            {robot: (any_content(bench.draw)[0], 0x100) for robot in bench.other_ids[:2]}
        )
        frames[0].data[3:7] = bits.to_bytes(4, "little")
        bench.play_round_of_frames(frames)


def same_sender(bench: Bench) -> None:
    """Several messages of one sender in a round, of which the first counts."""
    for repeats in (1, 2, 5):
        bench.avoid_test("different messages of one sender in a round")
        one, other = bench.draw.sample(bench.other_ids, 2)
        senders = [one, other] + [one] * repeats
        bench.play_round_of_frames(
            bench.encode_estimates([(robot, any_content(bench.draw)) for robot in senders])
        )


def own_id(bench: Bench) -> None:
    """Messages under the controller's own id, which it must not count."""
    own = bench.settings.controller.id
    for place in range(4):
        bench.avoid_test(f"a message under its own id, {own}")
        frames = bench.encode_estimates({robot: any_content(bench.draw) for robot in bench.other_ids[3:6]})
        frames.insert(place, *bench.encode_estimates({own: any_content(bench.draw)}))
        bench.play_round_of_frames(frames)


def between_ticks(bench: Bench) -> None:
    """Messages that come after a *settle*, for the next round."""
    for _ in range(3):
        bench.avoid_test("messages between a settle and the next observe")
        bench.send(
            bench.encode_estimates({robot: any_content(bench.draw) for robot in bench.other_ids[7:10]})
        )
        bench.play_round(any_content(bench.draw), senders=bench.other_ids[11:12])
