"""Check robots' logs: does the mirror of the firmware compute the same bits from the same input?

    python3 check_log.py logs/*.csv

The controller writes these logs into the log_folder that swarm.argos names, and robot_log.h describes them.
The mirror is part of the Python package mcp_asdf. Exit code: 0 all bits are equal, 1 some differ, 2 a log
cannot be checked.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

from mcp_asdf import Config, Filter, MirrorRobot, Observation, Status, Table

B_HAT_UNITS = 2**32


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

    def count_call(self, word: str, results: list[int]) -> None:
        """Count a call of the log that the mirror has reproduced with these results."""
        if word == "receive":
            self.messages += 1
        elif word == "settle":
            self.ticks += 1
            status = results[-1]
            self.updates += status == Status.UPDATED

    def __str__(self) -> str:
        """Return the verdict as a line of text."""
        if self.difference is not None:
            return self.difference
        counts = f"{self.ticks} ticks, {self.messages} messages, {self.updates} updates of b_hat"
        return f"{counts}: all bits are equal"


def main(paths: list[str]) -> int:
    """Check logs, print a line on each, and return the exit code."""
    if not paths:
        print("usage: python3 check_log.py LOG.csv ...", file=sys.stderr)
        return 2
    exit_code = 0
    for path in paths:
        try:
            verdict = check_log(Path(path))
        except (OSError, ValueError) as error:
            print(f"{path}: cannot be checked: {error}", file=sys.stderr)
            exit_code = 2
            continue
        print(f"{path}: {verdict}")
        if verdict.difference is not None:
            exit_code = max(exit_code, 1)
    return exit_code


def check_log(path: Path) -> Verdict:
    """Play a log to the mirror up to the first difference.

    Raises OSError if the log cannot be read, and ValueError if it is not the log of a robot.
    """
    lines = [line.split(",") for line in path.read_text(encoding="ascii").splitlines()]
    has_table = len(lines) > 1 and lines[1][0] == "table"
    start_line_count = 2 if has_table else 1
    robot = start_robot(lines[:start_line_count])
    verdict = Verdict()
    for line_number, (word, *fields) in enumerate(lines[start_line_count:], start=start_line_count + 1):
        try:
            logged_results, computed_results = play_call(robot, word, [int(field) for field in fields])
        except ValueError as error:
            raise ValueError(f"line {line_number} is no call that a robot can log: {error}") from error
        if computed_results != logged_results:
            verdict.difference = (
                f"line {line_number} in tick {verdict.ticks + 1} differs: {word} gave {logged_results}, "
                f"and in the mirror {computed_results}"
            )
            break
        verdict.count_call(word, computed_results)
    return verdict


def start_robot(lines: list[list[str]]) -> MirrorRobot:
    """Return a mirror with the start that the first lines of a log state: settings, and perhaps a table.

    Raises ValueError if they state no start, or one that the firmware refuses.
    """
    try:
        start_line, *table_lines = lines
        word, *settings = start_line
        if word != "start":
            raise ValueError(f"the log begins with {word!r}")
        robot_id, b_hat, filter_number, filter_period, memory = map(int, settings)
        table = parse_table(table_lines[0]) if table_lines else None
        config = Config(table, Filter(filter_number), filter_period, memory)
        return MirrorRobot(config, robot_id, b_hat / B_HAT_UNITS)
    except ValueError as error:
        raise ValueError(f"no robot can start so: {error}; see robot_log.h") from error


def parse_table(line: list[str]) -> Table:
    """Return the table in a line ``table,WORD,...``. Raises ValueError if the words are no table."""
    _word, *table_words = line
    return Table.from_words([int(table_word) for table_word in table_words])


def play_call(robot: MirrorRobot, word: str, numbers: list[int]) -> tuple[list[int], list[int]]:
    """Make the call of a line to the mirror, and return its results: those logged, and those of the mirror.

    Raises ValueError for a line that is no call.
    """
    if word == "observe":
        [colour] = numbers
        robot.observe(Observation(colour))
        return [], []
    if word == "receive":
        sender, x_hat, alpha, logged_status = numbers
        return [logged_status], [int(robot.receive_raw(sender, x_hat, alpha))]
    if word == "settle":
        _x, _x_hat, _alpha, _b_hat, _status = numbers  # a line that was cut has fewer
        status = robot.settle()
        return numbers, [robot.x_raw, robot.x_hat_raw, robot.alpha_raw, robot.b_hat_raw, int(status)]
    raise ValueError(f"it begins with {word!r}")


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
