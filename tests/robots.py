"""Shared by the tests of robots: which there are, how to make them, and images of our choice."""

from __future__ import annotations

import struct
from collections.abc import Iterable

import pytest

from mcp_asdf.mirror import MirrorRobot
from mcp_asdf.native import NativeRobot
from mcp_asdf.reference import ReferenceRobot
from mcp_asdf.robot import Config, Filter, FirmwareError, Observation, Robot, Status
from mcp_asdf.table import Table, checksum

FixedPoint = MirrorRobot | NativeRobot
FixedPointType = type[MirrorRobot] | type[NativeRobot]
AnyType = FixedPointType | type[ReferenceRobot]

FIXED_POINT: tuple[FixedPointType, ...] = (MirrorRobot, NativeRobot)
EVERY: tuple[AnyType, ...] = (MirrorRobot, NativeRobot, ReferenceRobot)

of_every_kind = pytest.mark.parametrize("kind", EVERY, ids=lambda kind: kind.__name__)
of_fixed_point = pytest.mark.parametrize("kind", FIXED_POINT, ids=lambda kind: kind.__name__)

OWN_ID = 5
ONE, HALF = 1 << 23, 1 << 22
ALPHA_ONE = 0x80000001
"""1.0: a mantissa of 2^23 and a shift by 1, in units of 2^-24."""
ALPHA_LEAST, ALPHA_MOST = 0x00000100, 0xFFFFFF1F
"""One unit of 2^-24, and 2^31 - 2^7."""
PLAIN = Config(filter=Filter.OFF)
"""No filter, so no table."""

TABLE = Table(omega_word=214748365, entries=(9 << 26, 4 << 26, 2 << 26, (1 << 26) + 1))
"""q = 4, entries 9, 4, 2 and just above 1 for every larger m: easy to tell from each other."""

LAYOUT = {
    **dict.fromkeys(("magic", "b_hat", "t", "n", "x_hat", "alpha", "filter_left"), "I"),
    **dict.fromkeys(("closed_alpha", "closed_alpha_x_low", "closed_alpha_x_high"), "Q"),
    **dict.fromkeys(("open_alpha", "open_alpha_x_low", "open_alpha_x_high", "open_x_squared"), "Q"),
    **dict.fromkeys(("open_x", "open_count", "heard_0", "heard_1", "heard_2", "heard_3"), "I"),
    **dict.fromkeys(("accepted", "repeated", "rejected", "tests", "updates"), "H"),
    **dict.fromkeys(("updated", "id"), "B"),
}
"""Fields of an image in order, as struct writes them; a checksum follows (docs/design.md)."""

CROWD = {
    **dict.fromkeys(("crowd_centre", "crowd_spread", "crowd_voices", "crowd_first"), "I"),
    **dict.fromkeys(("crowd_votes", "crowd_trend"), "H"),
    **dict.fromkeys((f"nothing_{number}" for number in range(11)), "I"),
}
"""What stands in place of the two rounds with the robust filter."""

ROBUST_BIT = 0x80
"""Of the magic: with the robust filter."""

IMAGE_SIZE = struct.calcsize("<" + "".join(LAYOUT.values())) + 4


def layout_of(magic: int) -> dict[str, str]:
    """Fields of the image that begins so."""
    if not magic & ROBUST_BIT:
        return LAYOUT
    whole = [(name, code) for name, code in LAYOUT.items() if not name.startswith(("closed", "open"))]
    at = [name for name, _ in whole].index("heard_0")
    return dict([*whole[:at], *CROWD.items(), *whole[at:]])


def unpack(image: bytes) -> dict[str, int]:
    """An image's fields by name."""
    layout = layout_of(image[0])
    return dict(zip(layout, struct.unpack("<" + "".join(layout.values()), image[:-4]), strict=True))


def pack(fields: dict[str, int]) -> bytes:
    """The image of fields by name, with the checksum that belongs to it."""
    layout = layout_of(fields["magic"])
    body = struct.pack("<" + "".join(layout.values()), *map(fields.__getitem__, layout))
    return body + struct.pack("<I", checksum([word for (word,) in struct.iter_unpack("<I", body)]))


def rewritten(image: bytes, **fields: int) -> bytes:
    """An image with some fields changed."""
    return pack({**unpack(image), **fields})


def robot_at(kind: FixedPointType, config: Config = PLAIN, **fields: int) -> FixedPoint:
    """A robot in a state of our choice: a new one's image with other fields, restored. With observations it
    is one whose b_hat has just been re-estimated: x_hat and alpha may be anything until the next."""
    fresh = kind(config, fields.pop("id", OWN_ID), 0.75)
    fields.setdefault("updated", int(fields.get("t", 0) > 0))
    return kind.restore(config, rewritten(fresh.save(), **fields))


def new(kind: AnyType, config: Config = PLAIN, b_hat: float = 0.75, robot_id: int = OWN_ID) -> Robot:
    """A robot without a past."""
    return kind(config, robot_id, b_hat)


def hear(robot: Robot, *estimates: float, alpha: float = 1.0) -> None:
    """Messages of these estimates, all of one confidence."""
    for sender, x_hat in enumerate(estimates, OWN_ID + 1):
        robot.receive(sender, x_hat, alpha)


def status_of_receive(robot: Robot, sender: int, x_hat: float, alpha: float) -> Status:
    """The status with which a message is taken or refused."""
    try:
        status = robot.receive(sender, x_hat, alpha)
    except FirmwareError as error:
        return error.status
    assert status >= Status.OK, "a refused message raises"
    return status


def receive_all(robot: FixedPoint, messages: Iterable[tuple[int, int, int]]) -> None:
    """Messages of (sender, x_hat, alpha), raw."""
    for message in messages:
        robot.receive_raw(*message)


def watch(robot: Robot, black: int, white: int) -> None:
    """Observations, first all black ones; no round ends."""
    for z in [Observation.BLACK] * black + [Observation.WHITE] * white:
        robot.observe(z)
