"""Phases that put frames and commands to the test, before the filter is of interest.

A tick of the controller begins with an *observe* command and ends with a *settle* command. The estimates that
it receives from one of its broadcasts to the next make up a round.

A phase only sends, and checks nothing itself: the bench gives the same to a model of the controller, and
compares every frame that the controller sends with that of the model. Most phases choose rounds in which the
filter does not test, so that a difference comes from what they send. Senders such as ``other_ids[5:8]`` are
any three robots but the controller.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from random import Random
from typing import Literal

import can

from mcp_asdf.robot import MAX_ID, Observation
from mcp_asdf_tools.bus.frame_layout import EVERY_ROBOT, Q23_ONE, Action
from mcp_asdf_tools.bus.frames import (
    MAX_PRIORITY,
    NODE_ID_MASK,
    PRIORITY_SHIFT,
    Command,
    Heartbeat,
    Telemetry,
    encode_command,
    encode_heartbeat,
    encode_telemetry,
)
from mcp_asdf_tools.crosscheck.crafted_rounds import (
    ALPHA_LEAST,
    EXTREME_ROUNDS,
    NeighbourEstimate,
    draw_distant_estimates,
    draw_estimate,
)
from mcp_asdf_tools.radio.bench import Bench
from mcp_asdf_tools.robots.filters import filter_of_one_robot
from mcp_asdf_tools.robots.lockstep import DRIVER_ID

_MAX_SKIPPED_TICKS = 10_000
"""Ticks that a phase skips at most to reach a heartbeat, or the filter's first test."""
_ALONE_TICKS = 72
"""Ticks of observations without messages: more than the shortest memory, 64."""
_STRAY_REPEATS = 3
"""Number of times that each kind of stray command is sent."""
_TARGET_BYTE_OF_COMMAND, _SPARE_BYTE_OF_COMMAND = 4, 6
"""Index of the byte of a command's data that has the target, and of the byte that has no meaning."""
_ROUND_SIZES = (2, 3, 5, 10, 30, 33, 64, 126)
"""Numbers of estimates in rounds, up to all other robots."""
_SMALLEST_B_HAT, _HALF_B_HAT = 2**4, 2**23
"""Smallest b_hat, 2**-20, and 1/2, in the units of telemetry, 2**-24."""
_TAIL_BYTE = 7
"""Index of the last byte of a frame's data, in which Cyphal marks the beginning and the end of a transfer."""
_CROWDED_REPEATS = 4
"""Messages of each sender but the last one in the tick with most messages."""
CROWDED_MESSAGES = _CROWDED_REPEATS * (MAX_ID - 1) + 1
"""Messages of that tick."""

# --- Frames that are no estimates ---

ChangeFrame = Callable[[can.Message, Random], None]
"""Changes a frame in place, and draws what is arbitrary about the change."""


def _write_number(
    frame: can.Message, rng: Random, *, numbers: Sequence[int], first_byte: int, length: int = 1
) -> None:
    """Draw one of these numbers, and write it into a frame's data.

    It is written into ``length`` bytes from ``first_byte`` on, the lowest one first.
    """
    number = rng.choice(numbers)
    frame.data[first_byte : first_byte + length] = number.to_bytes(length, "little")


def _clear_tail_bit(frame: can.Message, rng: Random, *, bit: int) -> None:
    """Clear a bit of a frame's tail byte, which is the last byte of its data."""
    frame.data[_TAIL_BYTE] &= ~(1 << bit)


def _flip_identifier_bit(frame: can.Message, rng: Random, *, bit: int) -> None:
    """Flip a bit of a frame's identifier."""
    frame.arbitration_id ^= 1 << bit


def _write_identifier_bits(frame: can.Message, rng: Random, *, mask: int, value: int) -> None:
    """Give the bits of ``mask`` in a frame's identifier the values that they have in ``value``."""
    frame.arbitration_id = (frame.arbitration_id & ~mask) | value


def _cut_data(frame: can.Message, rng: Random, *, min_length: int, max_length: int) -> None:
    """Draw a length from ``min_length`` to ``max_length`` bytes, and cut a frame's data to it."""
    frame.dlc = rng.randint(min_length, max_length)
    frame.data = frame.data[: frame.dlc]


def _use_short_identifier(frame: can.Message, rng: Random) -> None:
    """Give a frame an identifier of 11 bits."""
    frame.is_extended_id = False
    frame.arbitration_id &= 0x7FF  # the lowest 11 bits


def _make_remote(frame: can.Message, rng: Random) -> None:
    """Turn a frame into a remote frame, which asks for data."""
    frame.is_remote_frame = True
    frame.data = bytearray()


_write_x_hat = partial(_write_number, first_byte=0, length=3)
"""Writes an x_hat into an estimate, in units of 2**-23."""
_write_alpha = partial(_write_number, first_byte=3, length=4)
"""Writes a confidence into an estimate, as the bits of a binary32 number."""

MALFORMED: dict[str, ChangeFrame] = {
    "an 11-bit identifier": _use_short_identifier,
    "a remote frame": _make_remote,
    "7 bytes": partial(_cut_data, min_length=7, max_length=7),
    "fewer than 7 bytes": partial(_cut_data, min_length=0, max_length=6),
    "no single-frame tail byte": partial(_write_number, first_byte=_TAIL_BYTE, numbers=range(0xE0)),
    "a tail byte without the start bit": partial(_clear_tail_bit, bit=7),
    "a tail byte without the end bit": partial(_clear_tail_bit, bit=6),
    "a tail byte without the toggle bit": partial(_clear_tail_bit, bit=5),
    "x_hat above 1": partial(_write_x_hat, numbers=range(Q23_ONE + 2, 2**24)),
    "x_hat one unit above 1": partial(_write_x_hat, numbers=[Q23_ONE + 1]),
    "alpha infinite": partial(_write_alpha, numbers=[0x7F80_0000]),
    "alpha not a number": partial(_write_alpha, numbers=range(0x7F80_0001, 0x8000_0000)),
    "alpha -0": partial(_write_alpha, numbers=[0x8000_0000]),
    "alpha negative": partial(_write_alpha, numbers=range(0x8000_0001, 2**32)),
    "a service transfer": partial(_flip_identifier_bit, bit=25),
    "an anonymous sender": partial(_flip_identifier_bit, bit=24),
    "reserved bit 23 set": partial(_flip_identifier_bit, bit=23),
    "reserved bit 7 set": partial(_flip_identifier_bit, bit=7),
    "another subject": partial(_flip_identifier_bit, bit=20),
    "another subject of the same upper bits": partial(_flip_identifier_bit, bit=12),
    "another subject of the same lower bits": partial(_flip_identifier_bit, bit=16),
}
"""Ways for a frame not to be an estimate, each by itself."""

FOREIGN_ALPHAS = {
    "a confidence above the largest": 0x7F7F_FFFF,
    "a confidence between two multiples of 2^-24": 0x3380_0001,  # just above 2^-24
    "a confidence nearer to the next multiple of 2^-24": 0x33E0_0000,  # 1.75 times 2^-24
    "a subnormal confidence": 0x0000_0001,
}
"""Confidences that an alpha word cannot hold, as binary32 bits: a receiver must round or limit them."""


# --- Bits and commands that are unusual ---

_PRIORITY_MASK = MAX_PRIORITY << PRIORITY_SHIFT
UNUSUAL_IDENTIFIERS: dict[str, ChangeFrame] = {
    **{
        f"with priority {priority}": partial(
            _write_identifier_bits, mask=_PRIORITY_MASK, value=priority << PRIORITY_SHIFT
        )
        for priority in range(MAX_PRIORITY + 1)
    },
    "with identifier bits 22 and 21 clear": partial(_write_identifier_bits, mask=0b11 << 21, value=0),
}
"""Identifiers of any priority, and with the two reserved bits clear that senders set, by name."""


@dataclass(frozen=True)
class StrayCommand:
    """A command that a robot must not obey between *observe* and *settle* of a tick.

    Attributes:
        target: The robot that is tested, another robot, or all.
        tick: The tick that is open, the last one before it, or a later one.
        action: What is commanded.
    """

    target: Literal["robot", "other", "all"]
    tick: Literal["open", "last", "later"]
    action: Action


STRAY_COMMANDS = {
    "an observe of the open tick": StrayCommand("robot", "open", Action.OBSERVE_WHITE),
    "an observe of the open tick, for all": StrayCommand("all", "open", Action.OBSERVE_BLACK),
    "a settle of a later tick": StrayCommand("robot", "later", Action.SETTLE),
    "a settle of the last tick, for all": StrayCommand("all", "last", Action.SETTLE),
    "a settle for another robot": StrayCommand("other", "open", Action.SETTLE),
    "an observe for another robot": StrayCommand("other", "later", Action.OBSERVE_WHITE),
}


# --- The phases ---


def receive_before_observing(bench: Bench) -> None:
    """Send estimates to a controller that has observed nothing, and let its filter test before it has.

    Its answer x is then the mean of what it receives alone, and the test must change nothing. The bench
    compares its frames with the model's. The test is left out if its round is too far away.
    """
    bench.activity = "no observation"
    bench.play_tick(None)
    # The robust filter, for which the order of messages matters, keeps estimates beyond their round: it gets
    # its first ones in a phase of its own, and no estimates here.
    keeps_estimates = filter_of_one_robot(bench.config.filter).order_matters
    if not keeps_estimates:
        receive_extremes(bench)
    if bench.setup.filter_period <= _MAX_SKIPPED_TICKS:
        bench.activity = "commands in a row"
        estimates = [] if keeps_estimates else draw_distant_estimates(bench.robot_state, bench.rng)
        bench.play_test_round("a test before the first observation", estimates)


def observe_alone(bench: Bench) -> None:
    """Let the controller observe white tiles alone, and send it no estimates.

    So its x_hat is 0, or 1 for a b_hat below 1/2. In each ninth tick it has no observation.
    """
    for tick in range(_ALONE_TICKS):
        is_ninth = tick % 9 == 8
        if is_ninth:
            bench.activity = "no observation"
            bench.play_tick(None)
        else:
            bench.activity = "white tiles"
            bench.play_tick(Observation.WHITE)


def observe_first_black(bench: Bench) -> None:
    """Let the controller observe its first black tiles, so few that x_hat stays near the end of its range.

    It observes black whenever its x_hat is that of white tiles alone, and otherwise mostly white.
    """
    bench.activity = "the first black tiles"
    x_hat_of_white = bench.model_state.x_hat
    for _ in range(_ALONE_TICKS):
        is_at_end_of_range = bench.model_state.x_hat == x_hat_of_white
        is_black = is_at_end_of_range or bench.rng.random() < 0.3
        bench.play_tick(Observation(is_black))


def receive_and_wait(bench: Bench) -> None:
    """Play a tick with three estimates of similar confidence, and then one or two ticks without estimates.

    This is done six times, and the controller observes in these ticks.
    """
    for _ in range(6):
        bench.wait_for_round_without_test()
        bench.activity = "a few messages"
        estimates = [draw_estimate(bench.rng, max_shift=3) for _ in range(3)]
        bench.play_tick(bench.draw_observation(), bench.encode_estimates(estimates))
        bench.wait_for_round_without_test()
        bench.activity = "no messages"
        silent_ticks = 2 if bench.rng.random() < 0.5 else 1
        for _ in range(silent_ticks):
            bench.play_tick(bench.draw_observation())


def lose_settles(bench: Bench) -> None:
    """Leave out a *settle* four times: the next *observe* must end the tick and its round all the same."""
    for _ in range(4):
        bench.wait_for_round_without_test()
        bench.activity = "messages in a tick whose settle is lost"
        bench.observe(bench.draw_observation())
        _send_random_estimates(bench, bench.other_ids[5:8])
        bench.skip_settle()
        bench.activity = "the tick after one whose settle was lost"
        bench.play_tick(bench.draw_observation())


def send_stray_commands(bench: Bench) -> None:
    """Send commands that must not be obeyed: of another tick, for another robot, or a second observe.

    Each kind is sent three times, by itself, between the *observe* and the *settle* of a tick. After it come
    two estimates. A controller that has obeyed it counts an observation too many, or the estimates in the
    wrong round, and so differs from the model.
    """
    for _ in range(_STRAY_REPEATS):
        for name, stray in STRAY_COMMANDS.items():
            bench.wait_for_round_without_test()
            bench.activity = name
            bench.observe(bench.draw_observation())
            stray_command = _make_stray_command(bench, stray)
            bench.send([_encode(bench, stray_command)])
            _send_random_estimates(bench, bench.other_ids[:2])
            bench.settle_and_compare()


def _make_stray_command(bench: Bench, stray: StrayCommand) -> Command:
    """Return the described command, sent by a robot that is drawn, in the tick that is open on the bench."""
    command = bench.make_command(stray.action)
    other_robot = _draw_other_robot(bench)
    target_by_name = {"robot": command.target, "other": other_robot, "all": EVERY_ROBOT}
    open_tick = command.tick
    later_tick = open_tick + 1 + bench.rng.randrange(1000)
    tick_by_name = {"open": open_tick, "later": later_tick, "last": open_tick - 1}
    # Numbers of ticks have 32 bits, and 0 follows the largest.
    tick = tick_by_name[stray.tick] % 2**32
    return replace(command, sender=other_robot, tick=tick, target=target_by_name[stray.target])


def send_unusual_commands(bench: Bench) -> None:
    """Send commands that are unusual, one kind after the other, but that the controller must obey.

    They are for every robot, of another node, with a spare byte that is not 0, or with identifier bits that
    must be ignored. After each of them the usual command of the same tick follows. A controller that has
    obeyed the unusual command ignores the usual one as a repetition. A controller that has not obeyed it
    misses an observation, or counts a message in the wrong round. At the end the number of the tick jumps up
    and down, by up to 2**31.
    """
    for name, change_command in _unusual_commands(bench).items():
        # Two rounds, because the last message comes after the settle and is one of the next round.
        bench.wait_for_round_without_test(rounds=2)
        bench.activity = f"commands {name}"
        observe_action = Action.to_observe(bench.draw_observation())
        _send_changed_command(bench, observe_action, change_command)
        bench.observe(None)  # the usual command, which must not undo the observation
        _send_random_estimates(bench, bench.other_ids[:2])
        _send_changed_command(bench, Action.SETTLE, change_command)
        _send_random_estimates(bench, bench.other_ids[2:3])
        bench.settle_and_compare()
    _let_tick_number_jump(bench)


def _send_changed_command(bench: Bench, action: Action, change_command: ChangeFrame) -> None:
    """Send the controller a command with this action, whose frame has been changed."""
    frame = _encode(bench, bench.make_command(action))
    change_command(frame, bench.rng)
    bench.send([frame])


def _unusual_commands(bench: Bench) -> dict[str, ChangeFrame]:
    """Return functions by name. Each makes a command unusual in such a way that it must still be obeyed.

    One of them lets a command come from another node, which is drawn here.
    """
    write_target = partial(_write_number, first_byte=_TARGET_BYTE_OF_COMMAND)
    write_spare_byte = partial(_write_number, first_byte=_SPARE_BYTE_OF_COMMAND)
    other_node = _draw_other_robot(bench)
    return {
        "for every robot": partial(write_target, numbers=[EVERY_ROBOT]),
        "of another node": partial(_write_identifier_bits, mask=NODE_ID_MASK, value=other_node),
        "whose spare byte is not 0": partial(write_spare_byte, numbers=range(1, 2**8)),
        **UNUSUAL_IDENTIFIERS,
    }


def _let_tick_number_jump(bench: Bench) -> None:
    """Let the number of the tick jump up and down by about 2**8, 2**16, 2**24 and 2**31.

    A controller may keep too few bits of it. The settle command before each jump is left out.
    """
    for bit in (8, 16, 24, 31):
        distance_up = 2**bit
        distance_down = 1 - distance_up  # to the number that would have come without both jumps
        for direction, distance in (("higher", distance_up), ("lower", distance_down)):
            bench.wait_for_round_without_test()
            bench.activity = f"an observe of a number {direction} by about 2^{bit} than that of the open tick"
            bench.observe(bench.draw_observation())
            bench.skip_settle(distance)
            bench.play_tick(bench.draw_observation())


def receive_unusual_identifiers(bench: Bench) -> None:
    """Send estimates of every priority, and with reserved bits clear, which the controller must count."""
    for name, change_identifier in UNUSUAL_IDENTIFIERS.items():
        frames = _encode_random_estimates(bench, bench.other_ids[:3])
        change_identifier(frames[0], bench.rng)
        bench.play_round_of_frames(f"messages {name}", frames)


def wait_for_heartbeats(bench: Bench) -> None:
    """Let ticks pass, at most 10,000, in which the controller must send two heartbeats, one each second."""
    bench.activity = "commands in a row"
    ticks = 2 * bench.settings.swarm.steps_per_second + 1
    bench.skip_ticks(min(ticks, _MAX_SKIPPED_TICKS))


def receive_malformed(bench: Bench) -> None:
    """Play rounds in which a frame that is no estimate comes before an estimate of the same sender.

    The controller must ignore the first frame, and count the second one. If it counts the first, it takes the
    second for a repetition. Each kind of such frames is sent twice, with other random content. At the end
    telemetry and heartbeats of other robots take the place of such frames.
    """
    for _ in range(2):
        for name, change_frame in MALFORMED.items():
            sender, other_sender = bench.rng.sample(bench.other_ids, 2)
            frames = _encode_random_estimates(bench, [sender, sender, other_sender])
            change_frame(frames[0], bench.rng)  # which changes the frame itself
            bench.play_round_of_frames(name, frames)
    _send_telemetry_and_heartbeats(bench)


def _send_telemetry_and_heartbeats(bench: Bench) -> None:
    """Play three rounds in which another robot sends telemetry and a heartbeat, and then an estimate.

    The controller must count the estimate alone: robots send the other two for those who watch the swarm.
    """
    for sender in bench.rng.sample(bench.other_ids, 3):
        telemetry = _draw_telemetry(sender, bench.rng)
        heartbeat = Heartbeat(sender, uptime=bench.rng.randrange(2**32), transfer_id=0)
        frames = [
            encode_telemetry(telemetry, bench.settings.subjects.telemetry),
            encode_heartbeat(heartbeat),
            *_encode_random_estimates(bench, [sender]),
        ]
        bench.play_round_of_frames("telemetry and a heartbeat of another robot", frames)


def _draw_telemetry(sender: int, rng: Random) -> Telemetry:
    """Draw telemetry with any legal values, the first of its sender."""
    return Telemetry(
        sender,
        x=rng.randint(0, Q23_ONE),
        updates=rng.randrange(256),
        b_hat=rng.randint(_SMALLEST_B_HAT, _HALF_B_HAT),
        transfer_id=0,
    )


def receive_from_every_sender(bench: Bench) -> None:
    """Play a round for every other id, in which the controller receives one estimate of this sender."""
    for sender in bench.other_ids:
        bench.play_round(f"one message, of robot {sender}", [draw_estimate(bench.rng)], [sender])


def receive_from_alike_ids(bench: Bench) -> None:
    """Play rounds of two senders whose ids differ in one bit. Each of the 7 bits of an id gets two rounds.

    A controller that leaves out this bit takes the second estimate for a repetition of the first.
    """
    for bit_index in range(MAX_ID.bit_length()):
        pairs = _pairs_of_ids_that_differ_in(1 << bit_index, bench.other_ids)
        for senders in bench.rng.sample(pairs, 2):
            estimates = [draw_estimate(bench.rng), draw_estimate(bench.rng)]
            bench.play_round(f"messages of the robots {senders[0]} and {senders[1]}", estimates, senders)


def _pairs_of_ids_that_differ_in(bit: int, ids: list[int]) -> list[tuple[int, int]]:
    """Return all pairs of these ids that differ in nothing but this bit, a power of 2. The first lacks it."""
    ids_without_bit = [robot for robot in ids if robot & bit == 0]
    return [(robot, robot | bit) for robot in ids_without_bit if robot | bit in ids]


def receive_growing_rounds(bench: Bench) -> None:
    """Play rounds of 2 to 126 estimates, each round larger than the one before."""
    for size in _ROUND_SIZES:
        estimates = [draw_estimate(bench.rng) for _ in range(size)]
        bench.play_round(f"a round of {size} messages", estimates)


def receive_crowded_tick(bench: Bench) -> None:
    """Send hundreds of estimates in a tick, four per sender. The last sender sends one, which must count."""
    *first_senders, last_sender = bench.other_ids
    bench.skip_to_round()
    bench.wait_for_round_without_test()
    bench.activity = f"a tick with {CROWDED_MESSAGES} messages"
    senders = first_senders * _CROWDED_REPEATS + [last_sender]
    bench.play_tick(bench.draw_observation(), _encode_random_estimates(bench, senders))
    bench.skip_to_round()  # plays the rest of the round


def receive_extremes(bench: Bench) -> None:
    """Play rounds of estimates at the ends of their ranges, and of confidences that robots never send."""
    for name, estimates in EXTREME_ROUNDS.items():
        bench.play_round(name, estimates)
    for name, alpha_bits in FOREIGN_ALPHAS.items():
        _play_round_with_foreign_alpha(bench, name, alpha_bits)


def _play_round_with_foreign_alpha(bench: Bench, activity: str, alpha_bits: int) -> None:
    """Play a round of two estimates, one of this confidence, and the other of the smallest one.

    ``alpha_bits`` is a legal binary32 number that the firmware cannot hold exactly, and must round or limit.
    """
    estimates = [NeighbourEstimate(draw_estimate(bench.rng).x_hat, ALPHA_LEAST) for _ in range(2)]
    frames = bench.encode_estimates(estimates)
    # Written into the frame, as NeighbourEstimate cannot hold such an alpha.
    _write_alpha(frames[0], bench.rng, numbers=[alpha_bits])
    bench.play_round_of_frames(activity, frames)


def receive_repeated_sender(bench: Bench) -> None:
    """Send two, three and six estimates of one sender in a round: only the first must count.

    After the first comes an estimate of another sender, which must count, too.
    """
    for repeats in (1, 2, 5):
        repeating_sender, other_sender = bench.rng.sample(bench.other_ids, 2)
        senders = [repeating_sender, other_sender] + [repeating_sender] * repeats
        frames = _encode_random_estimates(bench, senders)
        bench.play_round_of_frames("different messages of one sender in a round", frames)


def receive_own_id(bench: Bench) -> None:
    """Send estimates under the controller's own id, which it must not count.

    In four rounds one comes before, between and after the estimates of three other robots.
    """
    for index in range(4):  # index of the estimate under the own id among the four
        senders = bench.other_ids[3:6]
        senders.insert(index, bench.setup.id)
        frames = _encode_random_estimates(bench, senders)
        bench.play_round_of_frames(f"a message under its own id, {bench.setup.id}", frames)


def receive_between_ticks(bench: Bench) -> None:
    """Send estimates between a *settle* and the next *observe*, and play the round that follows.

    The *settle* has ended a round, so the controller must count these estimates in the next round, together
    with the estimate of a fourth robot, which comes after the *observe*. This is done three times.
    """
    for _ in range(3):
        bench.skip_to_round()
        bench.wait_for_round_without_test()
        bench.activity = "messages between a settle and the next observe"
        # Any four robots: a second estimate of one of them would be ignored.
        early_senders = bench.other_ids[7:10]
        late_sender = bench.other_ids[11]
        _send_random_estimates(bench, early_senders)
        bench.play_round(bench.activity, [draw_estimate(bench.rng)], [late_sender])


# --- Steps ---


def _encode_random_estimates(bench: Bench, senders: list[int]) -> list[can.Message]:
    """Draw an estimate for each of these senders, and return the frames. A sender may be named repeatedly."""
    estimates = [draw_estimate(bench.rng) for _ in senders]
    return bench.encode_estimates(estimates, senders)


def _send_random_estimates(bench: Bench, senders: list[int]) -> None:
    """Draw an estimate for each of these senders, and send them to the controller in the present tick."""
    bench.send(_encode_random_estimates(bench, senders))


def _draw_other_robot(bench: Bench) -> int:
    """Draw the id of a robot that is neither the controller nor the node that commands it."""
    ids = [robot for robot in bench.other_ids if robot != DRIVER_ID]
    return bench.rng.choice(ids)


def _encode(bench: Bench, command: Command) -> can.Message:
    """Return the frame of a command under the controller's subject."""
    return encode_command(command, bench.settings.subjects.commands)
