"""What the tests of the robots share: which there are, how to make them, and images of our choice."""

from __future__ import annotations

import struct
from collections.abc import Iterable

import pytest

from firmware_py.mirror import MirrorRobot
from firmware_py.native import NativeRobot
from firmware_py.reference import ReferenceRobot
from firmware_py.robot import Config, Filter, Observation, Robot
from firmware_py.table import Table, checksum

FixedPoint = MirrorRobot | NativeRobot
FixedPointType = type[MirrorRobot] | type[NativeRobot]
AnyType = FixedPointType | type[ReferenceRobot]

FIXED_POINT: tuple[FixedPointType, ...] = (MirrorRobot, NativeRobot)
EVERY: tuple[AnyType, ...] = (MirrorRobot, NativeRobot, ReferenceRobot)

of_every_kind = pytest.mark.parametrize("kind", EVERY, ids=lambda kind: kind.__name__)
of_fixed_point = pytest.mark.parametrize("kind", FIXED_POINT, ids=lambda kind: kind.__name__)

OWN_ID = 5
ONE, HALF = 1 << 23, 1 << 22
ALPHA_ONE = 0x3F800000
PLAIN = Config(filter=Filter.OFF)
"""No filter, so no table."""

TABLE = Table(omega_word=214748365, fraction_bits=28, entries=(9 << 28, 4 << 28, 2 << 28, (1 << 28) + 1))
"""q = 4, entries 9, 4, 2 and just above 1 for every larger m: easy to tell from each other."""

LAYOUT = {
    **dict.fromkeys(("magic", "t", "n", "b_hat", "x_hat", "alpha", "settled_x_hat", "settled_alpha"), 32),
    **dict.fromkeys(("closed_alpha", "closed_alpha_x_low", "closed_alpha_x_high"), 64),
    **dict.fromkeys(("open_alpha", "open_alpha_x_low", "open_alpha_x_high", "open_x_squared"), 64),
    **dict.fromkeys(("open_x", "open_count", "heard_0", "heard_1", "heard_2", "heard_3"), 32),
    **dict.fromkeys(("comms_left", "filter_left"), 32),
    **dict.fromkeys(("accepted", "repeated", "rejected", "tests", "updates"), 16),
    **dict.fromkeys(("silent", "id"), 8),
}
"""Fields of an image and their bits in order, little-endian; a checksum follows (docs/design.md)."""

IMAGE_SIZE = sum(LAYOUT.values()) // 8 + 4


def unpack(image: bytes) -> dict[str, int]:
    """An image's fields by name."""
    whole, fields = int.from_bytes(image[:-4], "little"), {}
    for name, bits in LAYOUT.items():
        fields[name], whole = whole & (1 << bits) - 1, whole >> bits
    return fields


def pack(fields: dict[str, int]) -> bytes:
    """The image of fields by name, with the checksum that belongs to it."""
    whole, at = 0, 0
    for name, bits in LAYOUT.items():
        assert 0 <= fields[name] < 1 << bits, (name, fields[name])
        whole, at = whole | fields[name] << at, at + bits
    body = whole.to_bytes(at // 8, "little")
    return body + struct.pack("<I", checksum(struct.unpack(f"<{at // 32}I", body)))


def rewritten(image: bytes, **fields: int) -> bytes:
    """An image with some fields changed."""
    return pack({**unpack(image), **fields})


def robot_at(kind: FixedPointType, config: Config = PLAIN, **fields: int) -> FixedPoint:
    """A robot in a state of our choice: a new one's image with other fields, restored."""
    fresh = kind(config, fields.pop("id", OWN_ID), 0.75)
    return kind.restore(config, rewritten(fresh.save(), **fields))


def new(kind: AnyType, config: Config = PLAIN, b_hat: float = 0.75) -> Robot:
    """A robot without a past."""
    return kind(config, OWN_ID, b_hat)


def receive_all(robot: FixedPoint, messages: Iterable[tuple[int, int, int]]) -> None:
    """Messages of (sender, x_hat, alpha), raw."""
    for message in messages:
        robot.receive_raw(*message)


def watch(robot: Robot, black: int, white: int) -> None:
    """Whole ticks, first all black ones."""
    for z in [Observation.BLACK] * black + [Observation.WHITE] * white:
        robot.step(z)
