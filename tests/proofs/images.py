"""Save and restore: an image is the words that docs/design.md lists (section 10), and a robot restored from
one is the robot that these words say, or the one that was there.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import reduce
from typing import Any

import z3

from proofs.arithmetic import EXACT
from proofs.calls import computed, numbers, opaque_all
from proofs.formulas import Claim, returns, same
from proofs.machine import Machine, chosen
from proofs.numbers import Words
from proofs.prove import Contract
from proofs.source import SOURCES, Program

IMAGE = SOURCES / "mcp_asdf_image.c"
MAGIC = {False: 0x4D435302, True: 0x4D435382}
ERR_CONFIG, ERR_TABLE, ERR_IMAGE = -1, -2, -8
Image = list[Any]
"""The 31 words, of an image or for one."""

WORDS = ("b_hat", "t", "n", "x_hat", "alpha", "filter_left")


def word(value: int) -> Any:
    return z3.BitVecVal(value, 32)


def is_robust(config: Any) -> Any:
    return config["filter"] == 3


def doubles(robot: Any) -> list[Any]:
    closed, opened = robot["closed"], robot["open"]
    return [*(closed[name] for name in closed), *(opened[name] for name in (*closed, "x_squared"))]


def said_by(robot: Any) -> Image:
    """What an image of the robot consists of."""
    crowd, counters, heard = robot["crowd"], robot["counters"], list(robot["heard"]["of"].values())
    halves = [half(each) for each in doubles(robot) for half in (EXACT["low_word"], EXACT["high_word"])]
    rounds = [*halves, robot["open"]["x"], robot["open"]["count"]]
    of_crowd = [*(crowd[name] for name in ("centre", "spread", "voices", "first"))]
    of_crowd += [z3.Concat(crowd["trend"], crowd["votes"]), *[word(0)] * 11]
    is_crowd = is_robust(robot["config"])
    said = [
        z3.If(is_crowd, word(MAGIC[True]), word(MAGIC[False])),
        *(robot["accuracy"]["b_hat"], *(robot[name] for name in WORDS[1:])),
        *(z3.If(is_crowd, *both) for both in zip(of_crowd, rounds, strict=True)),
        *(z3.Concat(*reversed(heard[at : at + 4])) for at in range(0, 16, 4)),
        z3.Concat(counters["repeated"], counters["accepted"]),
        z3.Concat(counters["tests"], counters["rejected"]),
        z3.Concat(robot["id"], robot["updated"], counters["updates"]),
    ]
    return [*said, checksum(said)]


def checksum(said: Image) -> Any:
    return reduce(lambda hash_, each: computed("hash_word", each, hash_, each), said, word(0x811C9DC5))


def words_of(image: Any) -> Image:
    """Of its bytes, the lowest first."""
    held = list(image.values())
    return [z3.Concat(*reversed(held[at : at + 4])) for at in range(0, len(held), 4)]


def _saved(after: Any, image: Any, robot: Any, _: Any) -> Any:
    is_said = (found == each for found, each in zip(words_of(image), said_by(robot), strict=True))
    return z3.And(same(after, robot), *is_said)


SAVE = Contract(_saved, instead=opaque_all("hash_word"))


def read_from(said: Image, robot: Any, config: Any, fresh: Any) -> Any:
    """The robot of an image's words, with all members of one; what its filter does not use, and what follows
    from b_hat, is a new robot's."""
    members, rounds = dict(zip(WORDS, said[1:7], strict=True)), said[7:23]
    long = [z3.Concat(rounds[at + 1], rounds[at]) for at in range(0, 14, 2)]
    sums = {
        "closed": dict(zip(robot["closed"], long[:3], strict=True)),
        "open": dict(zip(robot["open"], [*long[3:], *rounds[14:]], strict=True)),
    }
    crowd = dict(zip(("centre", "spread", "voices", "first"), rounds, strict=False))
    crowd |= {"votes": _half(rounds[4], 0), "trend": _half(rounds[4], 16)}
    crowd["spread"] = z3.If(z3.And([each == 0 for each in rounds[5:]]), crowd["spread"], word(0))
    is_crowd, last = is_robust(config), said[29]
    halves = {"accepted": said[27], "rejected": said[28]}
    read = {
        **members,
        "accuracy": fresh["accuracy"],
        "config": config,
        "heard": {"of": {str(at): _byte(said[23 + at // 4], 8 * (at % 4)) for at in range(16)}},
        "counters": {
            **{name: _half(each, 0) for name, each in {**halves, "updates": last}.items()},
            **{name: _half(halves[of], 16) for name, of in (("repeated", "accepted"), ("tests", "rejected"))},
        },
        **{name: chosen(is_crowd, nothing(each), each) for name, each in sums.items()},
        "crowd": chosen(is_crowd, {name: crowd[name] for name in robot["crowd"]}, fresh["crowd"]),
        "updated": _byte(last, 16),
        "id": _byte(last, 24),
    }
    read["counters"] = {name: read["counters"][name] for name in robot["counters"]}
    return {name: read[name] for name in robot}


def nothing(value: Any) -> Any:
    return {name: z3.BitVecVal(0, each.size()) for name, each in value.items()}


def _half(of: Any, low: int) -> Any:
    return z3.Extract(low + 15, low, of)


def _byte(of: Any, low: int) -> Any:
    return z3.Extract(low + 7, low, of)


def _init(machine: Machine, fresh: Any, config: Any, *given: Any) -> Any:
    """mcp_asdf_init() makes some robot of what it is given."""
    declared = machine.program.parameters("mcp_asdf_init")[0].type.type
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
    said = words_of(image)
    given = (config, _byte(said[29], 24), said[1])
    of_init = computed("init", status, *given)
    fresh = computed("fresh", {name: each for name, each in robot.items() if name != "config"}, *given)
    read = read_from(said, robot, config, fresh)
    fresh = {name: fresh.get(name, config) for name in robot}
    is_whole = z3.And(
        said[0] == z3.If(is_robust(config), word(MAGIC[True]), word(MAGIC[False])),
        said[30] == checksum(said[:30]),
    )
    possible = computed("state_possible", z3.BitVecVal(0, 1), read, fresh) != 0
    is_set_up = z3.And(of_init != ERR_CONFIG, of_init != ERR_TABLE)
    is_accepted = z3.And(is_whole, of_init == 0, possible)
    return z3.And(
        z3.Implies(z3.Not(is_set_up), z3.And(status == of_init, same(after, robot))),
        z3.Implies(
            is_set_up,
            z3.And(
                returns(status, (z3.Not(is_accepted), ERR_IMAGE)),
                same(after, chosen(is_accepted, read, robot)),
            ),
        ),
    )


RESTORE = Contract(_restored, instead={**opaque_all("hash_word", "state_possible"), "mcp_asdf_init": _init})


def of_the_way_back(program: Program) -> Iterator[Claim]:
    """What an image says of a robot whose filter does not use what the image leaves out (I4, I24) is that
    robot."""
    machine = Machine(program, Words)
    robot = machine.seen(machine.unknown_of(program.types["mcp_asdf_t"], "robot"))
    fresh = {name: computed(name, robot[name], robot["accuracy"]["b_hat"]) for name in ("accuracy", "crowd")}
    is_crowd, said = is_robust(robot["config"]), said_by(robot)
    unused = [same(robot[name], nothing(robot[name])) for name in ("open", "closed")]
    known = [same(robot["accuracy"], fresh["accuracy"])]
    known.append(z3.If(is_crowd, z3.And(unused), same(robot["crowd"], fresh["crowd"])))
    yield "the same robot", same(read_from(said, robot, robot["config"], fresh), robot), known
    yield "its first word", said[0] == z3.If(is_crowd, word(MAGIC[True]), word(MAGIC[False])), known
    yield "its last word", said[30] == checksum(said[:30]), known


CONTRACTS = {"mcp_asdf_save": SAVE, "mcp_asdf_restore": RESTORE}
