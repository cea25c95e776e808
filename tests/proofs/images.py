"""Save and restore: an image is the words that docs/design.md lists (section 10), and a robot restored from
one is the robot that these words say, or the one that was there.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import z3

from proofs.calls import computed, is_robust, numbers, opaque_all
from proofs.formulas import Claim, nothing, returns, same
from proofs.machine import Machine, chosen
from proofs.numbers import Words
from proofs.prove import Contract
from proofs.source import SOURCES, Program

IMAGE = SOURCES / "mcp_asdf_image.c"
MAGIC, MAGIC_OF_ROBUST = (z3.BitVecVal(each, 32) for each in (0x4D435303, 0x4D435383))
ERR_CONFIG, ERR_TABLE, ERR_IMAGE = -1, -2, -8
FILTERS = (0, 1, 2, 3)
"""The filters, of which the last is the robust one. An image is as long as the filter needs, so that each is
proved by itself."""
FIRST = "accuracy.b_hat t n x_hat alpha filter_left"
ROUNDS = """
received.sums.closed.alpha received.sums.closed.alpha_x_low received.sums.closed.alpha_x_high
received.sums.open.alpha received.sums.open.alpha_x_low received.sums.open.alpha_x_high
received.sums.open.x_squared received.sums.open.x received.sums.open.count"""
ROBUST_FILTER = f"""
robust.centre robust.spread robust.initial_b_hat robust.filled_slots robust.batch_t robust.batch_n
robust.votes robust.dispersion robust.turn
{" ".join(f"received.estimates.{slot}" for slot in range(32))}"""
LAST = f"""{" ".join(f"heard.of.{index}" for index in range(16))}
counters.accepted counters.repeated counters.rejected counters.tests counters.updates updated id"""
"""Members between the first word of an image and its checksum, from the lowest bit on: FIRST, ROUNDS or
ROBUST_FILTER, and LAST."""
WORDS_OF_IMAGE, WORDS_OF_ROBUST_IMAGE = 31, 39


def _at(robot: Any, path: str) -> Any:
    for step in path.split("."):
        robot = robot[step]
    return robot


def _with(robot: Any, path: str, value: Any) -> Any:
    step, _, rest = path.partition(".")
    return {**robot, step: _with(robot[step], rest, value) if rest else value}


def _bits_of_member(robot: Any, path: str) -> Any:
    """Return a member as an image has it: the turn of the robust filter in a word of its own."""
    member = _at(robot, path)
    return z3.ZeroExt(24, member) if path == "robust.turn" else member


def image_of(robot: Any, robust: bool) -> Any:
    """Return the bits of a robot's image, the first byte's lowest, for one kind of filter."""
    paths = f"{FIRST} {ROBUST_FILTER if robust else ROUNDS} {LAST}".split()
    members = z3.Concat(*reversed([_bits_of_member(robot, path) for path in paths]))
    words = z3.Concat(members, MAGIC_OF_ROBUST if robust else MAGIC)
    return z3.Concat(checksum(words), words)


def checksum(words: Any) -> Any:
    """Return the checksum of the words of an image before it."""
    value = z3.BitVecVal(0x811C9DC5, 32)
    for low in range(0, words.size(), 32):
        word = z3.Extract(low + 31, low, words)
        value = computed("hash_word", word, value, word)
    return value


def bits_of(image: Any) -> Any:
    return z3.Concat(*reversed(image.values()))


def _saved(after: Any, image: Any, robot: Any, old_image: Any) -> Any:
    """The image is the robot's; without the robust filter the bytes behind it stay."""
    short = 32 * WORDS_OF_IMAGE
    bits, old_bits = bits_of(image), bits_of(old_image)
    behind = z3.Extract(bits.size() - 1, short, bits) == z3.Extract(bits.size() - 1, short, old_bits)
    of_rounds = z3.And(z3.Extract(short - 1, 0, bits) == image_of(robot, robust=False), behind)
    of_robust_filter = bits == image_of(robot, robust=True)
    return z3.And(same(after, robot), z3.If(is_robust(robot["config"]), of_robust_filter, of_rounds))


# design: R29
SAVE = Contract(_saved, cases=("robot.config.filter", FILTERS), instead=opaque_all("hash_word"))


def read_from(bits: Any, robot: Any, config: Any, fresh: Any) -> Any:
    """Return the robot of an image, with all members of ``robot``.

    What its filter does not use, and what follows from b_hat, is a new robot's. A word that is no turn of the
    robust filter becomes 255.
    """

    def read(robust: bool) -> Any:
        result, low = {**robot, "config": config, "accuracy": fresh["accuracy"]}, 32
        result |= {"robust": fresh["robust"], "received": nothing(robot["received"])}
        for path in f"{FIRST} {ROBUST_FILTER if robust else ROUNDS} {LAST}".split():
            size = _bits_of_member(robot, path).size()
            value, low = z3.Extract(low + size - 1, low, bits), low + size
            if path == "robust.turn":
                value = z3.If(z3.ULE(value, 32), z3.Extract(7, 0, value), z3.BitVecVal(255, 8))
            if path != "accuracy.b_hat":
                result = _with(result, path, value)
        return result

    return chosen(is_robust(config), read(robust=True), read(robust=False))


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
    bits = bits_of(image)
    # The id is the upper byte of the last word before the checksum.
    id_in_image = z3.If(is_robust(config), _id_in(bits, WORDS_OF_ROBUST_IMAGE), _id_in(bits, WORDS_OF_IMAGE))
    given = (config, id_in_image, z3.Extract(63, 32, bits))
    of_init = computed("init", status, *given)
    fresh = computed("fresh", {name: each for name, each in robot.items() if name != "config"}, *given)
    fresh = {name: fresh.get(name, config) for name in robot}
    read = read_from(bits, robot, config, fresh)
    possible = computed("is_valid_state", z3.BitVecVal(0, 1), read, fresh) != 0
    is_set_up = z3.And(of_init != ERR_CONFIG, of_init != ERR_TABLE)
    is_accepted = z3.And(is_whole(bits, config), of_init == 0, possible)
    refused = z3.And(status == of_init, same(after, robot))
    found = same(after, chosen(is_accepted, read, robot))
    return z3.If(is_set_up, z3.And(returns(status, (z3.Not(is_accepted), ERR_IMAGE)), found), refused)


def _id_in(bits: Any, words: int) -> Any:
    """Return the id in an image of so many words."""
    return z3.Extract(32 * (words - 1) - 1, 32 * (words - 1) - 8, bits)


def is_whole(bits: Any, config: Any) -> Any:
    """Return that the first and the last word of an image are right."""

    def is_right(words: int, magic: Any) -> Any:
        before_checksum = z3.Extract(32 * (words - 1) - 1, 0, bits)
        last = z3.Extract(32 * words - 1, 32 * (words - 1), bits)
        return z3.And(z3.Extract(31, 0, bits) == magic, last == checksum(before_checksum))

    return z3.If(
        is_robust(config),
        is_right(WORDS_OF_ROBUST_IMAGE, MAGIC_OF_ROBUST),
        is_right(WORDS_OF_IMAGE, MAGIC),
    )


# design: R30, R31
RESTORE = Contract(
    _restored,
    cases=("config.filter", FILTERS),
    instead={**opaque_all("hash_word", "is_valid_state"), "mcp_asdf_init": _init},
)


# design: R29, R30
def of_the_way_back(program: Program) -> Iterator[Claim]:
    """What an image says of a robot whose filter does not use what the image leaves out (I4, I24) is that
    robot."""
    machine = Machine(program, Words)
    robot = machine.seen(machine.unknown_of(program.types["mcp_asdf_t"], "robot"))
    fresh = {name: computed(name, robot[name], robot["accuracy"]["b_hat"]) for name in ("accuracy", "robust")}
    received, is_robust_robot = robot["received"], is_robust(robot["config"])
    # Each filter leaves the memory of the other as it is in a new robot.
    no_sums = same(received["sums"], nothing(received["sums"]))
    no_slots = z3.And(
        same(received["estimates"], nothing(received["estimates"])), same(robot["robust"], fresh["robust"])
    )
    known = [same(robot["accuracy"], fresh["accuracy"]), z3.ULE(robot["robust"]["turn"], 32)]
    for robust in (True, False):
        bits = image_of(robot, robust)
        if not robust:
            # Bytes behind the shorter image may be anything.
            behind = z3.BitVec("behind", 32 * (WORDS_OF_ROBUST_IMAGE - WORDS_OF_IMAGE))
            bits = z3.Concat(behind, bits)
        of_filter = [is_robust_robot, no_sums] if robust else [z3.Not(is_robust_robot), no_slots]
        restored = read_from(bits, robot, robot["config"], fresh)
        yield f"the same robot, robust: {robust}", same(restored, robot), [*known, *of_filter]
        yield f"the image is whole, robust: {robust}", is_whole(bits, robot["config"]), [*known, *of_filter]


CONTRACTS = {"mcp_asdf_save": SAVE, "mcp_asdf_restore": RESTORE}
