"""Golden vectors: scenarios with the digests that every build of the firmware, on every target, must reach.

    PYTHONPATH=tests python -m targets.golden_vectors --output DIR  # make the files that are in tests/targets
    PYTHONPATH=tests python -m targets.golden_vectors --explain LOG # which call differed on a target?

Scenarios are the cross-check's random ones, which are heavy with edges; the digests are those of
``MirrorRobot``. ``tests/targets/player.c`` plays them on a target.

A file is little-endian: the word MAGIC, how many scenarios follow (2 bytes), and these. A scenario is its
digest (4), filter, kind of table and id (1 each), filter_period, memory and b_hat (4 each), calls, and a 0. A
call is a code and its numbers; ``restore`` has the number of its pairs, each an index (1) and a word (4).

A digest covers the status of the making, of every call, and of the end (twice the messages accepted, and 1 if
the invariants hold). After each of these but ``receive`` it covers x, x_bar, the saved image and what b_hat
alone decides, too.
"""

from __future__ import annotations

import argparse
import re
import struct
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path

from mcp_asdf.mirror import MirrorRobot
from mcp_asdf.robot import FirmwareError, Status
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.common.files import write_atomically
from mcp_asdf_tools.crosscheck.random_scenarios import random_scenario
from mcp_asdf_tools.crosscheck.scenario import (
    IMAGE,
    REPLACING,
    Call,
    Scenario,
    Setup,
    TableChoice,
    edited_image,
    perform,
)

HERE = Path(__file__).parent
FILES = {"golden_few.bin": (1, 300, 14_500), "golden_many.bin": (2, 600, 90_000)}
"""Seed of each, how many scenarios are tried, and its bytes; an ATmega328P's flash holds the first alone."""
MAGIC, MASK = 0x5647434D, 0xFFFFFFFF
TABLES = (None, TableChoice("0.05", 30))
"""By their codes; an image has one table."""

_CODES = ("end", "observe", "step", "settle", "receive", "restore", "damage")
_HEAD, _SCENARIO = struct.Struct("<IH"), struct.Struct("<IBBBIII")
_BYTE, _PAIR = struct.Struct("<B"), struct.Struct("<BI")
_LAYOUTS = {
    **{"observe": _BYTE, "step": _BYTE, "settle": struct.Struct("<")},
    **{"receive": struct.Struct("<BII"), "damage": struct.Struct("<BB")},
}
_FAILURE = re.compile(r"scenario (\d+) expected (\d+) found (\d+)")
_CALL = re.compile(r"call \d+ status (\d+) state (\d+)")
Outcome = tuple[int, int]
"""Effect of a call: its status modulo 2**32, and a digest of the robot afterwards (0 without one)."""


@dataclass(frozen=True)
class Golden:
    """A scenario and its digest."""

    scenario: Scenario
    digest: int


def mix(digest: int, word: int) -> int:
    """Take a 32-bit word into a digest."""
    digest = (digest ^ word) * 0x9E3779B1 & MASK
    return digest ^ digest >> 15


class Player:
    """Plays a scenario on the mirror, as ``player.c`` does on the C.

    Attributes:
        digest: Of all so far.
    """

    def __init__(self) -> None:
        self.digest = 0
        self._robot: MirrorRobot | None = None

    def play(self, scenario: Scenario) -> Iterator[tuple[str, Outcome]]:
        """Each step as text, with its outcome: the making of the robot, the calls, and the end."""
        setup = scenario.setup
        config, made = setup.config(), Status.OK
        try:
            self._robot = MirrorRobot(config, setup.robot_id, setup.b_hat / 2**32)
        except FirmwareError as error:
            made = error.status
        yield str(setup), self._note(made)
        for call in scenario.calls:
            assert self._robot is not None
            if call.name in REPLACING:
                status = self._restore(config, edited_image(self._robot.save(), call))
            else:
                status = perform(self._robot, call)
            yield str(call), self._note(status, whole=call.name != "receive")
        robot = self._robot
        end = 0 if robot is None else 2 * robot.counters.accepted + robot.holds_invariants()
        yield "end", self._note(end)

    def _restore(self, config: object, image: bytes) -> Status:
        try:
            self._robot = MirrorRobot.restore(config, image)  # type: ignore[arg-type]
        except FirmwareError as error:
            return error.status
        return Status.OK

    def _note(self, status: int, whole: bool = True) -> Outcome:
        state = self._state()
        self.digest = mix(self.digest, status & MASK)
        if whole:
            self.digest = mix(self.digest, state)
        return status & MASK, state

    def _state(self) -> int:
        robot = self._robot
        if robot is None:
            return 0
        digest = mix(mix(0, robot.x_raw), robot.x_bar_raw)
        accuracy = robot.s.accuracy
        shifts = accuracy.rare_shift << 8 | accuracy.g_shift
        for word in (*IMAGE.unpack(robot.save()), accuracy.c, accuracy.common, accuracy.rare, shifts):
            digest = mix(digest, word)
        return digest


def digest_of(scenario: Scenario) -> int:
    """The digest that every target must reach at the end of the scenario."""
    player = Player()
    for _ in player.play(scenario):
        pass
    return player.digest


# ---- Files ----


def make(seed: int, tried: int, most: int) -> bytes:
    """A file of random scenarios that an image can play, as far as they have room."""
    chosen, size = list[bytes](), _HEAD.size
    for scenario in (_playable(random_scenario(seed, number)) for number in range(tried)):
        written = b"" if scenario is None else _encode(Golden(scenario, digest_of(scenario)))
        if written and size + len(written) <= most:
            chosen.append(written)
            size += len(written)
    return _HEAD.pack(MAGIC, len(chosen)) + b"".join(chosen)


def _playable(scenario: Scenario) -> Scenario | None:
    """The scenario with observations of a byte; None if it needs a table that an image does not have."""
    calls = tuple(
        Call(call.name, (min(call.numbers[0], 255),)) if call.name in ("observe", "step") else call
        for call in scenario.calls
    )
    return scenario.with_calls(calls) if scenario.setup.table in TABLES else None


def _encode(golden: Golden) -> bytes:
    setup = golden.scenario.setup
    numbers = (setup.robot_id, setup.filter_period, setup.memory, setup.b_hat)
    head = _SCENARIO.pack(golden.digest, setup.filter, TABLES.index(setup.table), *numbers)
    return head + b"".join(map(_encode_call, golden.scenario.calls)) + b"\0"


def _encode_call(call: Call) -> bytes:
    code = bytes([_CODES.index(call.name)])
    if call.name == "restore":
        return code + bytes([len(call.pairs)]) + b"".join(_PAIR.pack(*pair) for pair in call.pairs)
    return code + _LAYOUTS[call.name].pack(*call.numbers)


def load(*names: str) -> list[Golden]:
    """The committed vectors in these files, or in all, in the order in which targets play them."""
    return [golden for name in names or FILES for golden in _decode((HERE / name).read_bytes())]


def _decode(data: bytes) -> Iterator[Golden]:
    magic, left = _HEAD.unpack_from(data)
    assert magic == MAGIC
    at = _HEAD.size

    def take(layout: struct.Struct) -> tuple[int, ...]:
        nonlocal at
        at += layout.size
        return layout.unpack_from(data, at - layout.size)

    for _ in range(left):
        digest, mode, table, robot_id, *numbers = take(_SCENARIO)
        calls = list[Call]()
        while (name := _CODES[take(_BYTE)[0]]) != "end":
            if name == "restore":
                pairs = [take(_PAIR) for _ in range(take(_BYTE)[0])]
                calls.append(Call(name, tuple(number for pair in pairs for number in pair)))
            else:
                calls.append(Call(name, take(_LAYOUTS[name])))
        period, memory, b_hat = numbers
        setup = Setup(TABLES[table], mode, period, memory, robot_id, b_hat)
        yield Golden(Scenario(setup, tuple(calls)), digest)


def explain(printed: str, played: Sequence[Golden]) -> str:
    """The first call of ``played`` on which a target differed, from what it printed; and the line with which
    the cross-check plays the scenario.

    Raises UsageError if it printed no difference.
    """
    failure = _FAILURE.search(printed)
    if failure is None or int(failure[1]) >= len(played):
        raise UsageError("there is no line 'scenario ... expected ... found ...' of these vectors in it")
    scenario = played[int(failure[1])].scenario
    lines = [(int(status), int(state)) for status, state in _CALL.findall(printed, failure.end())]
    told = "every call agrees; are the vectors of the image old?"
    for index, (pair, found) in enumerate(zip_longest(Player().play(scenario), lines)):
        if pair is None or pair[1] != found:
            what, expected = pair or ("nothing", None)
            told = f"call {index}, {what}:\n  expected {_told(expected)}\n  found    {_told(found)}"
            break
    return f"scenario {failure[1]}, {told}\nmcp-asdf crosscheck --replay {scenario}"


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
            for name, how in FILES.items():
                write_atomically(args.output / name, make(*how))
        else:
            print(explain(args.explain.read_text(errors="replace"), load()))
    except (UsageError, OSError) as error:
        print(f"{parser.prog}: error: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
