"""Check robots' logs: does the mirror of the firmware compute the same bits from the same input?

    python3 check_log.py logs/*.csv

The controller writes these logs into the log_folder that swarm.argos names, and robot_log.h describes them.
The mirror is part of the Python package mcp_asdf. Exit code: 0 all bits are equal, 1 some differ, 2 a log
cannot be checked.
"""

from __future__ import annotations

import re
import sys
from dataclasses import dataclass
from pathlib import Path

from mcp_asdf import Config, Filter, FirmwareError, MirrorRobot, Observation, Status, Table, TableError

INPUT_COUNTS = {"observe": 1, "receive": 3, "settle": 0}
"""How many numbers of a line of this kind were input to the firmware; all others are its results."""
RESULT_COUNTS = {"observe": 0, "receive": 1, "settle": 5}
START_NUMBERS = 5
WHOLE_NUMBER = re.compile(r"-?[0-9]{1,10}")
MAX_WORD = 2**32 - 1
B_HAT_UNITS = 2**32


class LogError(Exception):
    """A log that cannot be checked; the message says why."""


@dataclass(frozen=True)
class LogLine:
    """A line of a log.

    Attributes:
        number: Its number, from 1.
        word: The kind of line, such as "observe".
        numbers: All whole numbers behind the word.
    """

    number: int
    word: str
    numbers: tuple[int, ...]


@dataclass
class Verdict:
    """What a check found out.

    Attributes:
        ticks: Ticks that were computed again.
        messages: Messages in them that the robot received.
        updates: Re-estimates of b_hat in them.
        difference: The first line that the mirror does not reproduce, and how; None if there is none.
    """

    ticks: int = 0
    messages: int = 0
    updates: int = 0
    difference: str | None = None


def main(paths: list[str]) -> int:
    """Check logs, print a line on each, and return the exit code."""
    if not paths:
        print("usage: python3 check_log.py LOG.csv ...", file=sys.stderr)
        return 2
    exit_code = 0
    for path in paths:
        try:
            verdict = check_log(Path(path))
        except LogError as error:
            print(f"{path}: cannot be checked: {error}", file=sys.stderr)
            exit_code = 2
            continue
        print(f"{path}: {describe(verdict)}")
        if verdict.difference is not None:
            exit_code = max(exit_code, 1)
    return exit_code


def describe(verdict: Verdict) -> str:
    """Return a verdict as a line of text."""
    if verdict.difference is not None:
        return verdict.difference
    counts = f"{verdict.ticks} ticks, {verdict.messages} messages, {verdict.updates} updates of b_hat"
    return f"{counts}: all bits are equal"


def check_log(path: Path) -> Verdict:
    """Play a log to the mirror up to the first difference. Raises LogError if the log is damaged."""
    lines = read_lines(path)
    robot, lines_of_calls = start_robot(lines)
    verdict = Verdict()
    for line in lines_of_calls:
        input_count = INPUT_COUNTS[line.word]
        logged_results = line.numbers[input_count:]
        computed_results = play_call(robot, line.word, line.numbers[:input_count])
        if computed_results != logged_results:
            logged_text = ",".join(str(number) for number in logged_results)
            computed_text = ",".join(str(number) for number in computed_results)
            verdict.difference = (
                f"line {line.number} in tick {verdict.ticks + 1} differs: {line.word} gave {logged_text}, "
                f"and in the mirror {computed_text}"
            )
            break
        if line.word == "receive":
            verdict.messages += 1
        elif line.word == "settle":
            verdict.ticks += 1
            status = computed_results[-1]
            verdict.updates += status == Status.UPDATED
    return verdict


def play_call(robot: MirrorRobot, word: str, inputs: tuple[int, ...]) -> tuple[int, ...]:
    """Make the call of a line to the mirror, and return the results that the line should have."""
    if word == "observe":
        robot.observe(Observation(inputs[0]))
        return ()
    if word == "receive":
        sender, x_hat, alpha = inputs
        return (int(robot.receive_raw(sender, x_hat, alpha)),)
    status = robot.settle()
    return (robot.x_raw, robot.x_hat_raw, robot.alpha_raw, robot.b_hat_raw, int(status))


def start_robot(lines: list[LogLine]) -> tuple[MirrorRobot, list[LogLine]]:
    """Return a mirror with the start that a log states, and the lines of the calls that follow.

    Raises LogError if the log states no start, or one that the firmware refuses.
    """
    if not lines or lines[0].word != "start" or len(lines[0].numbers) != START_NUMBERS:
        raise LogError(f"its first line must be start with {START_NUMBERS} numbers; see robot_log.h")
    robot_id, b_hat, filter_number, filter_period, memory = lines[0].numbers
    has_table = len(lines) > 1 and lines[1].word == "table"
    try:
        table = Table.from_words(lines[1].numbers) if has_table else None
        config = Config(table, Filter(filter_number), filter_period, memory)
        robot = MirrorRobot(config, robot_id, b_hat / B_HAT_UNITS)
    except (ValueError, TableError, FirmwareError) as error:
        raise LogError(f"no robot can start so: {error}") from error
    lines_of_calls = lines[2:] if has_table else lines[1:]
    for line in lines_of_calls:
        check_call(line)
    return robot, lines_of_calls


def check_call(line: LogLine) -> None:
    """Raise LogError unless a line is that of a call, with as many numbers as it must have."""
    if line.word not in INPUT_COUNTS:
        raise LogError(f"line {line.number} begins with {line.word!r}, not with {', '.join(INPUT_COUNTS)}")
    expected_count = INPUT_COUNTS[line.word] + RESULT_COUNTS[line.word]
    if len(line.numbers) != expected_count:
        raise LogError(f"line {line.number} has {len(line.numbers)} numbers, not {expected_count}")
    inputs = line.numbers[: INPUT_COUNTS[line.word]]
    largest_input = 1 if line.word == "observe" else MAX_WORD
    for number in inputs:
        if not 0 <= number <= largest_input:
            raise LogError(f"line {line.number} has the input {number}, not 0 to {largest_input}")


def read_lines(path: Path) -> list[LogLine]:
    """Return the lines of a log. Raises LogError if it cannot be read or has other lines than a log has."""
    try:
        text = path.read_text(encoding="ascii")
    except OSError as error:
        raise LogError(error.strerror or str(error)) from error
    except UnicodeDecodeError as error:
        raise LogError(f"byte {error.start} is no text") from error
    lines = []
    for line_number, line in enumerate(text.splitlines(), start=1):
        word, *fields = line.split(",")
        for field in fields:
            if not WHOLE_NUMBER.fullmatch(field):
                raise LogError(f"line {line_number} has {field[:20]!r} where a whole number must be")
        lines.append(LogLine(line_number, word, tuple(int(field) for field in fields)))
    return lines


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
