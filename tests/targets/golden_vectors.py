"""Golden vectors: scenarios with the digests that every build of the firmware, on every target, must reach.

    PYTHONPATH=tests python -m targets.golden_vectors --output DIR  # make the files that are in tests/targets
    PYTHONPATH=tests python -m targets.golden_vectors --scenario 6  # what a target prints that differs in it

Scenarios are the cross-check's random ones, which are heavy with edges; the digests are those of
``MirrorRobot``. ``tests/targets/player.c`` plays them on a target.

A file is little-endian: the word MAGIC, how many scenarios follow (2 bytes), and these. A scenario is its
digest (4), filter, kind of table and id (1 each), filter_period, memory and b_hat (4 each), calls, and a 0. A
call is a code and its numbers. A ``restore`` has the number of blocks that it replaces in the image (1), and
these: a block is the index of its first byte (1), its size (1) and its bytes.

A digest covers the status of the making, of every call, and of the end (twice the messages accepted, and 1 if
the invariants hold). After each of these but ``receive`` it covers x, x_bar, the saved image and what b_hat
alone decides, too.
"""

from __future__ import annotations

import argparse
import struct
from functools import cache
from pathlib import Path

from mcp_asdf.image_format import unpack_image
from mcp_asdf.mirror import MirrorRobot
from mcp_asdf.robot import Config, FirmwareError, Status
from mcp_asdf_tools.crosscheck.image_numbers import places_of_numbers
from mcp_asdf_tools.crosscheck.random_scenarios import random_scenario
from mcp_asdf_tools.crosscheck.robust_scenarios import robust_scenario
from mcp_asdf_tools.crosscheck.scenario import (
    CALLS_THAT_REPLACE_ROBOT,
    Call,
    Scenario,
    TableChoice,
    edit_image,
    make_call,
)

HERE = Path(__file__).parent
FILES = {
    "golden_few.bin": (random_scenario, 1, 300, 10_000),
    "golden_many.bin": (random_scenario, 2, 600, 90_000),
    "golden_robust.bin": (robust_scenario, 1, 300, 10_000),
    "golden_robust_more.bin": (robust_scenario, 2, 300, 10_000),
}
"""How the content of a file is made, by the file's name.

That is the function that draws scenarios, its seed, the number of scenarios that are tried, and the most
bytes that the file may have. All files but golden_many have room beside the core in the flash of an
ATmega328P.
"""
MAGIC, MASK = 0x5647434D, 0xFFFFFFFF
TABLES = (None, TableChoice("0.05", 30))
"""Tables by their code in a file: none, or the one with which an image is linked."""

_CODES = ("end", "observe", "step", "settle", "receive", "restore", "damage")
_HEAD, _SCENARIO = struct.Struct("<IH"), struct.Struct("<IBBBIII")
_LAYOUTS = {"observe": "<B", "step": "<B", "settle": "<", "receive": "<BII", "damage": "<BB"}


def mix(digest: int, word: int) -> int:
    """Return a digest into which a further 32-bit word is taken."""
    digest = (digest ^ word) * 0x9E3779B1 & MASK
    return digest ^ digest >> 15


class Player:
    """Plays a scenario on the mirror, as ``player.c`` does on the C.

    Attributes:
        digest: The digest of all that happened.
        lines: What a target prints of the making of the robot, the calls, and the end.
    """

    def __init__(self, scenario: Scenario) -> None:
        self.digest = 0
        self.lines: list[str] = []
        self._robot: MirrorRobot | None = None
        setup = scenario.setup
        config, status = setup.config(), Status.OK
        try:
            self._robot = MirrorRobot(config, setup.robot_id, setup.b_hat / 2**32)
        except FirmwareError as error:
            status = error.status
        self._record(status)
        for call in scenario.calls:
            assert self._robot is not None
            if call.name in CALLS_THAT_REPLACE_ROBOT:
                status = self._restore(config, edit_image(self._robot.save(), call, config.filter))
            else:
                status = make_call(self._robot, call)
            self._record(status, with_state=call.name != "receive")
        status_of_end = 0
        if self._robot is not None:
            status_of_end = 2 * self._robot.counters.accepted + self._robot.holds_invariants()
        self._record(status_of_end)

    def _restore(self, config: Config, image: bytes) -> Status:
        try:
            self._robot = MirrorRobot.restore(config, image)
        except FirmwareError as error:
            return error.status
        return Status.OK

    def _record(self, status: int, with_state: bool = True) -> None:
        """Add a line, and take the status, and maybe the state, into the digest."""
        state = self._digest_of_state()
        self.lines.append(f"call {len(self.lines)} status {status & MASK} state {state}")
        self.digest = mix(self.digest, status & MASK)
        if with_state:
            self.digest = mix(self.digest, state)

    def _digest_of_state(self) -> int:
        robot = self._robot
        if robot is None:
            return 0
        digest = mix(mix(0, robot.x_raw), robot.x_bar_raw)
        accuracy = robot.s.accuracy
        shifts = accuracy.rare_shift << 8 | accuracy.g_shift
        for word in (*unpack_image(robot.save()), accuracy.c, accuracy.common, accuracy.rare, shifts):
            digest = mix(digest, word)
        return digest


@cache
def played(name: str) -> list[tuple[Scenario, bytes]]:
    """Return the scenarios of a file with the bytes that encode them there.

    They are drawn in turn. A scenario is left out if an image lacks its table, or if the file has no room.
    """
    draw_scenario, seed, tried_count, max_bytes = FILES[name]
    chosen: list[tuple[Scenario, bytes]] = []
    room = max_bytes - _HEAD.size
    for number in range(tried_count):
        scenario = _playable(draw_scenario(seed, number))
        is_table_in_images = scenario.setup.table in TABLES
        size = _size_of(scenario)
        if is_table_in_images and size <= room:
            chosen.append((scenario, _encode(scenario)))
            room -= size
    return chosen


def _size_of(scenario: Scenario) -> int:
    """Return how many bytes a scenario takes in a file: those of its head, of its calls and a 0."""
    return _SCENARIO.size + len(_encode_calls(scenario)) + 1


def _playable(scenario: Scenario) -> Scenario:
    """Return the scenario with observations that fit into a byte of the file: larger ones become 255."""
    calls = []
    for call in scenario.calls:
        if call.name in ("observe", "step"):
            [z] = call.numbers
            calls.append(Call(call.name, (min(z, 255),)))
        else:
            calls.append(call)
    return scenario.replace_calls(tuple(calls))


def _encode(scenario: Scenario) -> bytes:
    setup = scenario.setup
    numbers = (setup.robot_id, setup.filter_period, setup.memory, setup.b_hat)
    digest = Player(scenario).digest
    head = _SCENARIO.pack(digest, setup.filter, TABLES.index(setup.table), *numbers)
    return head + _encode_calls(scenario) + b"\0"


def _encode_calls(scenario: Scenario) -> bytes:
    encoded_calls = b""
    for call in scenario.calls:
        encoded_calls += bytes([_CODES.index(call.name)])
        if call.name == "restore":
            encoded_calls += _encode_new_numbers(call, scenario.setup.filter)
        else:
            encoded_calls += struct.pack(_LAYOUTS[call.name], *call.numbers)
    return encoded_calls


def _encode_new_numbers(restore: Call, filter_number: int) -> bytes:
    """Return the numbers of a ``restore`` as a file has them: as blocks of the image that it replaces.

    Numbers that follow each other in the image, which is of a robot with this filter, are one block: so a
    file has room for more scenarios.
    """
    places = places_of_numbers(filter_number)
    new_bytes: dict[int, int] = {}  # by their index in the image
    for name, value in restore.new_numbers:
        place = places[name]
        encoded_number = value.to_bytes(place.stop - place.start, "little")
        new_bytes.update(zip(range(place.start, place.stop), encoded_number, strict=True))
    blocks: list[tuple[int, bytearray]] = []  # the index of the first byte, and all bytes
    for index, byte in sorted(new_bytes.items()):
        if index - 1 not in new_bytes:
            blocks.append((index, bytearray()))
        _start, block = blocks[-1]
        block.append(byte)
    encoded_blocks = b"".join(bytes([start, len(block)]) + block for start, block in blocks)
    return bytes([len(blocks)]) + encoded_blocks


def content_made_anew(name: str) -> bytes:
    """Return the content of a file, made anew."""
    return _HEAD.pack(MAGIC, len(played(name))) + b"".join(written for _, written in played(name))


def scenarios(*names: str) -> list[Scenario]:
    """Return the scenarios of these files, or of all, in the order in which targets play them."""
    return [scenario for name in names or FILES for scenario, _ in played(name)]


def expected_verdict(names: list[str]) -> str:
    """Return the last line that an image prints which has played these files without a difference.

    Among the calls it counts the making of each robot and the check at the end of each scenario.
    """
    played_scenarios = scenarios(*names)
    calls = [call.name for scenario in played_scenarios for call in scenario.calls]
    call_count = len(calls) + 2 * len(played_scenarios)
    tick_count = calls.count("observe") + calls.count("step")
    return f"PASS scenarios {len(played_scenarios)} calls {call_count} ticks {tick_count}"


def main() -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(prog="python -m targets.golden_vectors")
    job = parser.add_mutually_exclusive_group(required=True)
    job.add_argument("--output", metavar="DIR", type=Path, help="write the vectors into this folder")
    numbers = range(len(scenarios()))
    job.add_argument("--scenario", type=int, choices=numbers, metavar="N", help="print its calls as they are")
    args = parser.parse_args()
    if args.output is not None:
        for name in FILES:
            (args.output / name).write_bytes(content_made_anew(name))
    else:
        scenario = scenarios()[args.scenario]
        print(*Player(scenario).lines, f"mcp-asdf crosscheck --replay {scenario}", sep="\n")


if __name__ == "__main__":
    main()
