"""Phases that put frames and commands to the test, before the filter is of interest."""

from __future__ import annotations

from mcp_asdf.robot import Observation
from mcp_asdf_tools.bus import Action
from mcp_asdf_tools.radio.crafted_rounds import EXTREMES, FOREIGN_ALPHAS, any_content
from mcp_asdf_tools.radio.invalid_frames import malformed, stray_commands
from mcp_asdf_tools.radio.stage import Stage
from mcp_asdf_tools.radio.unusual_frames import DISTANT_NUMBERS, UNUSUAL_COMMANDS, UNUSUAL_MESSAGES

_PATTERN = (None, None, Observation.BLACK, Observation.WHITE, Observation.BLACK, None, Observation.BLACK)
MOST_SKIPPED = 10_000
ALONE_TICKS = 72
"""More than the shortest memory, 64."""
STRAY_REPEATS = 3
SIZES = (2, 3, 5, 10, 30, 33, 64, 126)
"""Messages of growing rounds."""


def alone(stage: Stage) -> None:
    """The controller observes and hears no messages."""
    for tick in range(ALONE_TICKS):
        z = _PATTERN[tick] if tick < len(_PATTERN) else any_observation(stage)
        stage.doing = "no observation" if z is None else f"a {z.name.lower()} tile"
        stage.tick(z)


def messages_and_silence(stage: Stage) -> None:
    """Ticks with a few messages of similar weight, and ticks without any."""
    for _ in range(6):
        stage.avoid_test()
        stage.doing = "a few messages"
        frames = stage.messages({robot: any_content(stage.draw, 3) for robot in stage.others[:3]})
        stage.tick(any_observation(stage), frames)
        stage.avoid_test()
        stage.doing = "no messages"
        for _ in range(2 if stage.draw.random() < 0.5 else 1):
            stage.tick(any_observation(stage))


def any_observation(stage: Stage) -> Observation:
    """Black a bit more often than white, so that b_hat can be re-estimated on both sides of 1/2."""
    s = stage.model.firmware.s
    is_black = 5 * s.n < 3 * s.t
    return Observation(is_black if stage.draw.random() < 0.8 else not is_black)


def lost_settles(stage: Stage) -> None:
    """Every other *settle* does not come; the next *observe* ends the tick and its round all the same."""
    for _ in range(4):
        stage.avoid_test()
        stage.observe(any_observation(stage))
        stage.doing = "messages in a tick whose settle is lost"
        stage.send(stage.messages([(robot, any_content(stage.draw)) for robot in stage.others[5:8]]))
        stage.leave_open()
        stage.doing = "the tick after one whose settle was lost"
        stage.tick(any_observation(stage))


def stray(stage: Stage) -> None:
    """Commands that must not be obeyed, each kind by itself."""
    coverage, subjects = stage.model.coverage, stage.settings.subjects
    other = stage.draw.choice(stage.robots)
    for _ in range(STRAY_REPEATS):
        tick = stage.lockstep.tick
        kinds = stray_commands(stage.draw, subjects.commands, coverage.robot, other, tick)
        for name in kinds:
            stage.avoid_test()
            stage.doing = name
            stage.observe(any_observation(stage))
            tick = stage.lockstep.tick
            stage.send([stray_commands(stage.draw, subjects.commands, coverage.robot, other, tick)[name]])
            stage.send(stage.messages({robot: any_content(stage.draw) for robot in stage.others[:2]}))
            stage.settle()
            coverage.commands[name] += 1


def unusual_commands(stage: Stage) -> None:
    """Commands that differ in what makes no difference.

    After each comes the usual one of the same tick, which changes nothing unless the first was not obeyed:
    then the controller misses an observation, or has a round too many messages.
    """
    for name, unusual in UNUSUAL_COMMANDS.items():
        stage.avoid_test(2)  # the last message is one of the next round
        stage.doing = name
        other = stage.draw.choice(stage.robots)
        stage.send([stage.command(Action.observing(any_observation(stage)), unusual, other)])
        stage.observe(None)
        stage.send(stage.messages({robot: any_content(stage.draw) for robot in stage.others[:2]}))
        settle = stage.command(Action.SETTLE, unusual, other)
        stage.send([settle, *stage.messages({stage.others[2]: any_content(stage.draw)})])
        stage.settle()
        stage.model.coverage.unusual[name] += 1
    for name, distance in DISTANT_NUMBERS.items():
        stage.avoid_test()
        stage.doing = name
        stage.observe(any_observation(stage))
        stage.leave_open(distance)
        stage.tick(any_observation(stage))
        stage.model.coverage.unusual[name] += 1


def unusual_messages(stage: Stage) -> None:
    """Messages whose identifiers differ in what a receiver ignores."""
    for name, change in UNUSUAL_MESSAGES.items():
        stage.avoid_test()
        stage.doing = name
        frames = stage.messages({robot: any_content(stage.draw) for robot in stage.others[:3]})
        change(frames[0])
        stage.round_of(frames)
        stage.model.coverage.unusual[name] += 1


def heartbeats(stage: Stage) -> None:
    """Ticks in a row until two heartbeats were due, if they come at all often."""
    stage.doing = "commands in a row"
    stage.skip(min(2 * stage.settings.swarm.steps_per_second + 1, MOST_SKIPPED))


def invalid(stage: Stage) -> None:
    """Frames that are no estimates, each kind by itself, before a valid message of the same sender."""
    for _ in range(2):
        for name in malformed(stage.draw, stage.settings.subjects, 0):
            sender, other = stage.draw.sample(stage.others, 2)
            frame = malformed(stage.draw, stage.settings.subjects, sender)[name]
            stage.avoid_test()
            stage.doing = name
            valid = stage.messages({each: any_content(stage.draw) for each in (sender, other)})
            stage.round_of([frame, *valid])
            stage.model.coverage.invalid[name] += 1


def every_sender(stage: Stage) -> None:
    """A round for every id."""
    for sender in stage.others:
        stage.avoid_test()
        stage.doing = f"one message, of robot {sender}"
        stage.round(any_content(stage.draw), senders=[sender])


def alike_ids(stage: Stage) -> None:
    """Rounds of two senders whose ids differ in one bit."""
    others = set(stage.others)
    for bit in (1 << place for place in range(7)):
        pairs = [(robot, robot | bit) for robot in others if robot & bit == 0 and robot | bit in others]
        for pair in stage.draw.sample(pairs, 2):
            stage.avoid_test()
            stage.doing = f"messages of the robots {pair[0]} and {pair[1]}"
            stage.round(*(any_content(stage.draw) for _ in pair), senders=pair)


def growing_rounds(stage: Stage) -> None:
    """Rounds of ever more messages."""
    for size in SIZES:
        stage.avoid_test()
        stage.doing = f"a round of {size} messages"
        stage.round(*(any_content(stage.draw) for _ in range(size)))


def extremes(stage: Stage) -> None:
    """Messages at the ends of the ranges, and confidences that no robot of ours sends."""
    for name, contents in EXTREMES.items():
        stage.avoid_test()
        stage.doing = name
        stage.round(*contents)
    for name, bits in FOREIGN_ALPHAS.items():
        stage.avoid_test()
        stage.doing = name
        frames = stage.messages({robot: any_content(stage.draw) for robot in stage.others[:2]})
        frames[0].data[3:7] = bits.to_bytes(4, "little")
        stage.round_of(frames)


def same_sender(stage: Stage) -> None:
    """Several messages of one sender in a round, of which the first counts."""
    for repeats in (1, 2, 5):
        stage.avoid_test()
        stage.doing = "different messages of one sender in a round"
        one, other = stage.draw.sample(stage.others, 2)
        senders = [one, other] + [one] * repeats
        stage.round_of(stage.messages([(robot, any_content(stage.draw)) for robot in senders]))


def own_id(stage: Stage) -> None:
    """Messages under the controller's own id, which it must not count."""
    own = stage.model.coverage.robot
    for place in range(4):
        stage.avoid_test()
        stage.doing = f"a message under its own id, {own}"
        frames = stage.messages({robot: any_content(stage.draw) for robot in stage.others[3:6]})
        frames.insert(place, *stage.messages({own: any_content(stage.draw)}))
        stage.round_of(frames)


def between_ticks(stage: Stage) -> None:
    """Messages that come after a *settle*, for the next round."""
    for _ in range(3):
        stage.avoid_test()
        stage.doing = "messages between a settle and the next observe"
        stage.send(stage.messages({robot: any_content(stage.draw) for robot in stage.others[7:10]}))
        stage.round(any_content(stage.draw), senders=stage.others[11:12])
