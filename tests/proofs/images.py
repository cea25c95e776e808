"""Save and restore: an image is the words that docs/design.md lists (section 10), and a robot restored from
one is the robot that these words say, or the one that was there.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import z3

from proofs.calls import computed, is_robust, numbers, opaque_all
from proofs.formulas import Claim, returns, same
from proofs.machine import Machine, chosen
from proofs.numbers import Words
from proofs.prove import Contract
from proofs.source import SOURCES, Program

IMAGE = SOURCES / "mcp_asdf_image.c"
MAGIC, MAGIC_OF_ROBUST = (z3.BitVecVal(each, 32) for each in (0x4D435302, 0x4D435382))
ERR_CONFIG, ERR_TABLE, ERR_IMAGE = -1, -2, -8
FIRST = "accuracy.b_hat t n x_hat alpha filter_left"
ROUNDS = """closed.alpha closed.alpha_x_low closed.alpha_x_high
open.alpha open.alpha_x_low open.alpha_x_high open.x_squared open.x open.count"""
CROWD = "crowd.centre crowd.spread crowd.voices crowd.first crowd.votes crowd.trend"
LAST = f"""{" ".join(f"heard.of.{index}" for index in range(16))}
counters.accepted counters.repeated counters.rejected counters.tests counters.updates updated id"""
"""What stands between first word and checksum, from the lowest bit on. A crowd and zeros are as long as both
rounds."""
ZEROS = z3.BitVecVal(0, 11 * 32)


def _at(robot: Any, path: str) -> Any:
    for step in path.split("."):
        robot = robot[step]
    return robot


def _with(robot: Any, path: str, value: Any) -> Any:
    step, _, rest = path.partition(".")
    return {**robot, step: _with(robot[step], rest, value) if rest else value}


def _said(robot: Any, *paths: str) -> list[Any]:
    return [_at(robot, path) for part in paths for path in part.split()]


def said_by(robot: Any) -> Any:
    """The bits of the robot's image, the first byte's lowest."""
    of_rounds = _said(robot, FIRST, ROUNDS, LAST)
    of_crowd = [*_said(robot, FIRST, CROWD), ZEROS, *_said(robot, LAST)]
    rounds, crowd = (z3.Concat(*reversed(each)) for each in (of_rounds, of_crowd))
    is_crowd = is_robust(robot["config"])
    said = z3.If(is_crowd, z3.Concat(crowd, MAGIC_OF_ROBUST), z3.Concat(rounds, MAGIC))
    return z3.Concat(checksum(said), said)


def checksum(said: Any) -> Any:
    """Of the words before the last."""
    found = z3.BitVecVal(0x811C9DC5, 32)
    for low in range(0, 30 * 32, 32):
        each = z3.Extract(low + 31, low, said)
        found = computed("hash_word", each, found, each)
    return found


def bits_of(image: Any) -> Any:
    return z3.Concat(*reversed(image.values()))


def _saved(after: Any, image: Any, robot: Any, _: Any) -> Any:
    return z3.And(same(after, robot), bits_of(image) == said_by(robot))


# design: R29
SAVE = Contract(_saved, instead=opaque_all("hash_word"))


def read_from(said: Any, robot: Any, config: Any, fresh: Any) -> Any:
    """The robot of an image, with all members of one; what its filter does not use, and what follows from
    b_hat, is a new robot's. A crowd with more than zeros behind it has no spread."""

    def read(paths: str) -> Any:
        found, low = {**robot, "config": config, **{name: fresh[name] for name in ("accuracy", "crowd")}}, 32
        found |= {name: nothing(robot[name]) for name in ("open", "closed")}
        for path in paths.split():
            size = 11 * 32 if path == "zeros" else _at(robot, path).size()
            bits, low = z3.Extract(low + size - 1, low, said), low + size
            if path == "zeros":
                spread = found["crowd"]["spread"]
                found = _with(found, "crowd.spread", z3.If(bits == 0, spread, z3.BitVecVal(0, 32)))
            elif path != "accuracy.b_hat":
                found = _with(found, path, bits)
        return found

    return chosen(is_robust(config), read(f"{FIRST} {CROWD} zeros {LAST}"), read(f"{FIRST} {ROUNDS} {LAST}"))


def nothing(value: Any) -> Any:
    return {name: z3.BitVecVal(0, each.size()) for name, each in value.items()}


def _init(machine: Machine, fresh: Any, config: Any, *given: Any) -> Any:
    """mcp_asdf_init() makes some robot of what it is given."""
    declared = machine.program.heads["mcp_asdf_init"].args.params[0].type.type
    like, seen = machine.unknown_of(declared, "fresh"), [machine.seen(each) for each in (config, *given)]
    members = {name: each for name, each in like.items() if name != "config"}
    made = numbers(members, computed("fresh", machine.seen(members), *seen))
    machine.store(fresh, {name: made.get(name, config) for name in like})
    status = machine.unknown("status", machine.int)
    return numbers(status, computed("init", status.term, *seen))


def _restored(status: Any, after: Any, *of: Any) -> Any:
    """The errors of init for the configuration come first, then those of the image; then the robot is that of
    the image."""
    _, _, robot, config, image = of
    said = bits_of(image)
    given = (config, z3.Extract(30 * 32 - 1, 30 * 32 - 8, said), z3.Extract(63, 32, said))
    of_init = computed("init", status, *given)
    fresh = computed("fresh", {name: each for name, each in robot.items() if name != "config"}, *given)
    fresh = {name: fresh.get(name, config) for name in robot}
    read = read_from(said, robot, config, fresh)
    possible = computed("is_valid_state", z3.BitVecVal(0, 1), read, fresh) != 0
    is_set_up = z3.And(of_init != ERR_CONFIG, of_init != ERR_TABLE)
    is_accepted = z3.And(is_whole(said, config), of_init == 0, possible)
    refused = z3.And(status == of_init, same(after, robot))
    found = same(after, chosen(is_accepted, read, robot))
    return z3.If(is_set_up, z3.And(returns(status, (z3.Not(is_accepted), ERR_IMAGE)), found), refused)


def is_whole(said: Any, config: Any) -> Any:
    """The first and the last word are right."""
    first, last = z3.Extract(31, 0, said), z3.Extract(31 * 32 - 1, 30 * 32, said)
    return z3.And(first == z3.If(is_robust(config), MAGIC_OF_ROBUST, MAGIC), last == checksum(said))


# design: R30, R31
RESTORE = Contract(_restored, instead={**opaque_all("hash_word", "is_valid_state"), "mcp_asdf_init": _init})


# design: R29, R30
def of_the_way_back(program: Program) -> Iterator[Claim]:
    """What an image says of a robot whose filter does not use what the image leaves out (I4, I24) is that
    robot."""
    machine = Machine(program, Words)
    robot = machine.seen(machine.unknown_of(program.types["mcp_asdf_t"], "robot"))
    fresh = {name: computed(name, robot[name], robot["accuracy"]["b_hat"]) for name in ("accuracy", "crowd")}
    unused = [same(robot[name], nothing(robot[name])) for name in ("open", "closed")]
    of_filter = z3.If(is_robust(robot["config"]), z3.And(unused), same(robot["crowd"], fresh["crowd"]))
    known, said = [same(robot["accuracy"], fresh["accuracy"]), of_filter], said_by(robot)
    yield "the same robot", same(read_from(said, robot, robot["config"], fresh), robot), known
    yield "the image is whole", is_whole(said, robot["config"]), known


CONTRACTS = {"mcp_asdf_save": SAVE, "mcp_asdf_restore": RESTORE}
