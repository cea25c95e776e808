"""Golden vectors: scenarios with the digests that every build of the firmware, on every target, must reach.

    PYTHONPATH=tests python -m targets.golden_vectors --output DIR  # make the files that are in tests/targets
    PYTHONPATH=tests python -m targets.golden_vectors --explain LOG # which call differed on a target?

The expected digests are those of ``MirrorRobot``. ``tests/targets/player.c`` plays the same scenarios on a
target; ``docs/targets.md`` has the format of the file and what a digest covers. Scenarios are written as the
cross-check writes them (``crosscheck.scenario``), and long ones as *crowds* and *runs* (``golden_runs``).
"""

from __future__ import annotations

import argparse
import re
import struct
import sys
from collections.abc import Iterator, Sequence
from dataclasses import astuple
from itertools import zip_longest
from pathlib import Path

from mcp_asdf.mirror import MirrorRobot
from mcp_asdf.robot import FirmwareError, Status
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.common.files import write_atomically
from mcp_asdf_tools.crosscheck.scenario import IMAGE, REPLACING, Call, Setup, edited_image, perform
from targets.golden_runs import MASK, SPOILT_TABLE, Crowd, GoldenScenario, Run
from targets.golden_scenarios import edge_scenarios, run_scenarios

MAGIC = 0x5647434D

_CODES = {"observe": 1, "step": 2, "settle": 3, "receive": 4, "restore": 5, "damage": 6}
_LAYOUTS = {"observe": "<B", "step": "<B", "settle": "<", "receive": "<BII", "damage": "<BB"}
_CROWD, _CROWD_CODE = struct.Struct("<BBBIII"), 7
_RUN, _RUN_CODE = struct.Struct("<BIHBBBBI"), 8
_FAILURE = re.compile(r"scenario (\d+) expected (\d+) found (\d+)")
_CALL = re.compile(r"call \d+ status (\d+) state (\d+)")


def mix(digest: int, word: int) -> int:
    """Take a 32-bit word into a digest."""
    digest = (digest ^ word) * 0x9E3779B1 & MASK
    return digest ^ digest >> 15


Outcome = tuple[int, int]
"""Effect of a call: its status modulo 2**32, and a digest of the robot afterwards (0 without one)."""


class Player:
    """Plays a scenario on the mirror, as ``player.c`` does on the C.

    Attributes:
        made: What the making of the robot reported.
        robot: The robot; None if it could not be made.
        digest: Of all calls so far, the robot's making included.
    """

    def __init__(self, setup: Setup) -> None:
        self._config = setup.config()
        self.robot: MirrorRobot | None = None
        self.made = Status.OK
        self.digest = 0
        try:
            self.robot = MirrorRobot(self._config, setup.robot_id, setup.b_hat / 2**32)
        except FirmwareError as error:
            self.made = error.status
        self._note(self.made, whole=True)

    def apply(self, call: Call) -> Status:
        """Make a call and take its outcome into the digest."""
        status = self._dispatch(call)
        self._note(status, whole=call.name != "receive")
        return status

    def finish(self) -> int:
        """Take the scenario's end into the digest: messages accepted, and whether the invariants hold."""
        robot = self.robot
        outcome = 0 if robot is None else 2 * robot.counters.accepted + robot.holds_invariants()
        self._note(outcome, whole=True)
        return outcome

    def look(self, status: int) -> Outcome:
        """All that can be seen of the robot now, after a call with this status."""
        return status & MASK, self._hash_of_state()

    def _note(self, status: int, whole: bool) -> None:
        self.digest = mix(self.digest, status & MASK)
        if whole:
            self.digest = mix(self.digest, self._hash_of_state())

    def _hash_of_state(self) -> int:
        robot = self.robot
        if robot is None:
            return 0
        digest = mix(mix(0, robot.x_raw), robot.x_bar_raw)
        accuracy = robot.s.accuracy
        shifts = accuracy.rare_shift << 8 | accuracy.g_shift
        for word in (*IMAGE.unpack(robot.save()), accuracy.c, accuracy.common, accuracy.rare, shifts):
            digest = mix(digest, word)
        return digest

    def _dispatch(self, call: Call) -> Status:
        assert self.robot is not None
        if call.name not in REPLACING:
            return perform(self.robot, call)
        return self._restore(edited_image(self.robot.save(), call))

    def _restore(self, image: bytes) -> Status:
        try:
            self.robot = MirrorRobot.restore(self._config, image)
        except FirmwareError as error:
            return error.status
        return Status.OK


def encode(played: Sequence[GoldenScenario]) -> bytes:
    """A file of golden vectors."""
    return struct.pack("<IH", MAGIC, len(played)) + b"".join(map(_encode_scenario, played))


def _encode_scenario(scenario: GoldenScenario) -> bytes:
    setup = scenario.setup
    table = 0 if setup.table is None else 2 if setup.table is SPOILT_TABLE else 1
    numbers = (setup.filter_period, setup.memory, setup.b_hat)
    head = struct.pack("<IBBBIII", digest(scenario), setup.filter, table, setup.robot_id, *numbers)
    return head + b"".join(map(_encode_item, scenario.items)) + b"\0"


def _encode_item(item: Call | Crowd | Run) -> bytes:
    if isinstance(item, Run):
        return _RUN.pack(_RUN_CODE, *astuple(item))
    if isinstance(item, Crowd):
        return _CROWD.pack(_CROWD_CODE, *astuple(item))
    code = bytes([_CODES[item.name]])
    if item.name == "restore":
        return code + bytes([len(item.pairs)]) + b"".join(struct.pack("<BI", *pair) for pair in item.pairs)
    return code + struct.pack(_LAYOUTS[item.name], *item.numbers)


def golden_vectors() -> dict[str, bytes]:
    """The files that the project commits, by name, in the order in which targets play them. Takes seconds."""
    return {"golden_edges.bin": encode(edge_scenarios()), "golden_runs.bin": encode(run_scenarios())}


def digest(scenario: GoldenScenario) -> int:
    """The digest that every target must reach at the end of the scenario."""
    player = Player(scenario.setup)
    for call in scenario.calls():
        player.apply(call)
    player.finish()
    return player.digest


def outcomes(scenario: GoldenScenario) -> Iterator[tuple[str, Outcome]]:
    """Calls as text, each with its expected outcome; the first is the making of the robot."""
    player = Player(scenario.setup)
    yield str(scenario.setup), player.look(player.made)
    for call in scenario.calls():
        yield str(call), player.look(player.apply(call))
    yield "end", player.look(player.finish())


def explain(printed: str, played: Sequence[GoldenScenario]) -> str:
    """The first call of ``played`` on which a target differed, from what it printed.

    Raises UsageError if it printed no difference.
    """
    failure = _FAILURE.search(printed)
    if failure is None or int(failure[1]) >= len(played):
        raise UsageError("there is no line 'scenario ... expected ... found ...' of these vectors in it")
    number = int(failure[1])
    title = f"scenario {number} ({played[number].name})"
    lines = [(int(status), int(state)) for status, state in _CALL.findall(printed, failure.end())]
    for index, (pair, found) in enumerate(zip_longest(outcomes(played[number]), lines)):
        if pair is None or pair[1] != found:
            what, expected = pair or ("nothing", None)
            return f"{title}, call {index}, {what}:\n  expected {_told(expected)}\n  found    {_told(found)}"
    return f"{title}: every call agrees; are the vectors of the image old?"


def _told(outcome: Outcome | None) -> str:
    return "nothing" if outcome is None else f"status {outcome[0]} state {outcome[1]:#010x}"


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit code: 0 done, 2 bad usage."""
    parser = argparse.ArgumentParser(prog="python -m targets.golden_vectors")
    job = parser.add_mutually_exclusive_group(required=True)
    job.add_argument("--output", metavar="DIR", type=Path, help="write the vectors into this folder")
    job.add_argument(
        "--explain", metavar="LOG", type=Path, help="name the first call that a target got wrong"
    )
    args = parser.parse_args(arguments)
    try:
        if args.output is not None:
            for name, data in golden_vectors().items():
                write_atomically(args.output / name, data)
        else:
            print(explain(args.explain.read_text(errors="replace"), edge_scenarios() + run_scenarios()))
    except (UsageError, OSError) as error:
        print(f"{parser.prog}: error: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
