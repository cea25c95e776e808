"""Phases that put frames and commands to the test, before the filter is of interest."""

from __future__ import annotations

from mcp_asdf.robot import Observation
from mcp_asdf_tools.bus.frames import Action
from mcp_asdf_tools.radio.bench import Bench
from mcp_asdf_tools.radio.odd_frames import (
    DISTANT_NUMBERS,
    STRAY,
    UNUSUAL_COMMANDS,
    UNUSUAL_IDENTIFIERS,
    malformed,
    stray_command,
    unusual_command,
)
from mcp_asdf_tools.radio.rounds import EXTREMES, FOREIGN_ALPHAS, any_content
from mcp_asdf_tools.robots.lockstep import DRIVER_ID

_PATTERN = (None, None, Observation.BLACK, Observation.WHITE, Observation.BLACK, None, Observation.BLACK)
MOST_SKIPPED = 10_000
ALONE_TICKS = 72
"""More than the shortest memory, 64."""
STRAY_REPEATS = 3
SIZES = (2, 3, 5, 10, 30, 33, 64, 126)
"""Messages of growing rounds."""


def alone(bench: Bench) -> None:
    """The controller observes and hears no messages."""
    for tick in range(ALONE_TICKS):
        z = _PATTERN[tick] if tick < len(_PATTERN) else bench.any_observation()
        bench.doing = "no observation" if z is None else f"a {z.name.lower()} tile"
        bench.tick(z)


def messages_and_silence(bench: Bench) -> None:
    """Ticks with a few messages of similar weight, and ticks without any."""
    for _ in range(6):
        bench.avoid_test()
        bench.doing = "a few messages"
        frames = bench.messages({robot: any_content(bench.draw, 3) for robot in bench.others[:3]})
        bench.tick(bench.any_observation(), frames)
        bench.avoid_test()
        bench.doing = "no messages"
        for _ in range(2 if bench.draw.random() < 0.5 else 1):
            bench.tick(bench.any_observation())


def lost_settles(bench: Bench) -> None:
    """Every other *settle* does not come; the next *observe* ends the tick and its round all the same."""
    for _ in range(4):
        bench.avoid_test()
        bench.observe(bench.any_observation())
        bench.doing = "messages in a tick whose settle is lost"
        bench.send(bench.messages([(robot, any_content(bench.draw)) for robot in bench.others[5:8]]))
        bench.leave_open()
        bench.doing = "the tick after one whose settle was lost"
        bench.tick(bench.any_observation())


def stray(bench: Bench) -> None:
    """Commands that must not be obeyed, each kind by itself."""
    other, commands = _another_robot(bench), bench.settings.subjects.commands
    for _ in range(STRAY_REPEATS):
        for name in STRAY:
            bench.avoid_test()
            bench.doing = name
            bench.observe(bench.any_observation())
            usual = bench.command(Action.SETTLE)
            bench.send([stray_command(name, bench.draw, usual, other, commands)])
            bench.send(bench.messages({robot: any_content(bench.draw) for robot in bench.others[:2]}))
            bench.settle()


def _another_robot(bench: Bench) -> int:
    """A robot that is neither the controller nor the node that commands it."""
    return bench.draw.choice([robot for robot in bench.others if robot != DRIVER_ID])


def unusual_commands(bench: Bench) -> None:
    """Commands that differ in what makes no difference.

    After each comes the usual one of the same tick, which changes nothing unless the first was not obeyed:
    then the controller misses an observation, or has a round too many messages.
    """
    commands = bench.settings.subjects.commands
    for name in UNUSUAL_COMMANDS:
        bench.avoid_test(2)  # the last message is one of the next round
        bench.doing = f"commands {name}"
        other = _another_robot(bench)
        observe = bench.command(Action.observing(bench.any_observation()))
        bench.send([unusual_command(name, observe, other, commands)])
        bench.observe(None)
        bench.send(bench.messages({robot: any_content(bench.draw) for robot in bench.others[:2]}))
        settle = unusual_command(name, bench.command(Action.SETTLE), other, commands)
        bench.send([settle, *bench.messages({bench.others[2]: any_content(bench.draw)})])
        bench.settle()
    for name, distance in DISTANT_NUMBERS.items():
        bench.avoid_test()
        bench.doing = name
        bench.observe(bench.any_observation())
        bench.leave_open(distance)
        bench.tick(bench.any_observation())


def unusual_messages(bench: Bench) -> None:
    """Messages whose identifiers differ in what a receiver ignores."""
    for name, change in UNUSUAL_IDENTIFIERS.items():
        bench.avoid_test()
        bench.doing = f"messages {name}"
        frames = bench.messages({robot: any_content(bench.draw) for robot in bench.others[:3]})
        change(frames[0])
        bench.round_of(frames)


def heartbeats(bench: Bench) -> None:
    """Ticks in a row until two heartbeats were due, if they come at all often."""
    bench.doing = "commands in a row"
    bench.skip(min(2 * bench.settings.swarm.steps_per_second + 1, MOST_SKIPPED))


def invalid(bench: Bench) -> None:
    """Frames that are no estimates, each kind by itself, before a valid message of the same sender."""
    for _ in range(2):
        for name in malformed(bench.draw, bench.settings.subjects, 0):
            sender, other = bench.draw.sample(bench.others, 2)
            frame = malformed(bench.draw, bench.settings.subjects, sender)[name]
            bench.avoid_test()
            bench.doing = name
            valid = bench.messages({each: any_content(bench.draw) for each in (sender, other)})
            bench.round_of([frame, *valid])


def every_sender(bench: Bench) -> None:
    """A round for every id."""
    for sender in bench.others:
        bench.avoid_test()
        bench.doing = f"one message, of robot {sender}"
        bench.round(any_content(bench.draw), senders=[sender])


def alike_ids(bench: Bench) -> None:
    """Rounds of two senders whose ids differ in one bit."""
    others = set(bench.others)
    for bit in (1 << place for place in range(7)):
        pairs = [(robot, robot | bit) for robot in others if robot & bit == 0 and robot | bit in others]
        for pair in bench.draw.sample(pairs, 2):
            bench.avoid_test()
            bench.doing = f"messages of the robots {pair[0]} and {pair[1]}"
            bench.round(*(any_content(bench.draw) for _ in pair), senders=pair)


def growing_rounds(bench: Bench) -> None:
    """Rounds of ever more messages."""
    for size in SIZES:
        bench.avoid_test()
        bench.doing = f"a round of {size} messages"
        bench.round(*(any_content(bench.draw) for _ in range(size)))


def extremes(bench: Bench) -> None:
    """Messages at the ends of the ranges, and confidences that no robot of ours sends."""
    for name, contents in EXTREMES.items():
        bench.avoid_test()
        bench.doing = name
        bench.round(*contents)
    for name, bits in FOREIGN_ALPHAS.items():
        bench.avoid_test()
        bench.doing = name
        frames = bench.messages({robot: any_content(bench.draw) for robot in bench.others[:2]})
        frames[0].data[3:7] = bits.to_bytes(4, "little")
        bench.round_of(frames)


def same_sender(bench: Bench) -> None:
    """Several messages of one sender in a round, of which the first counts."""
    for repeats in (1, 2, 5):
        bench.avoid_test()
        bench.doing = "different messages of one sender in a round"
        one, other = bench.draw.sample(bench.others, 2)
        senders = [one, other] + [one] * repeats
        bench.round_of(bench.messages([(robot, any_content(bench.draw)) for robot in senders]))


def own_id(bench: Bench) -> None:
    """Messages under the controller's own id, which it must not count."""
    own = bench.settings.controller.id
    for place in range(4):
        bench.avoid_test()
        bench.doing = f"a message under its own id, {own}"
        frames = bench.messages({robot: any_content(bench.draw) for robot in bench.others[3:6]})
        frames.insert(place, *bench.messages({own: any_content(bench.draw)}))
        bench.round_of(frames)


def between_ticks(bench: Bench) -> None:
    """Messages that come after a *settle*, for the next round."""
    for _ in range(3):
        bench.avoid_test()
        bench.doing = "messages between a settle and the next observe"
        bench.send(bench.messages({robot: any_content(bench.draw) for robot in bench.others[7:10]}))
        bench.round(any_content(bench.draw), senders=bench.others[11:12])
