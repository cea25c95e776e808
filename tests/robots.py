"""Shared by the tests of robots: which there are, how to make them, and images of our choice."""

from __future__ import annotations

from collections.abc import Iterable

import pytest

from mcp_asdf.mirror import MirrorRobot
from mcp_asdf.native import NativeRobot
from mcp_asdf.reference import ReferenceRobot
from mcp_asdf.robot import Config, Filter, FirmwareError, Observation, Robot, Status
from mcp_asdf.table import Table
from mcp_asdf_tools.crosscheck.scenario import Call, edited_image

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

IMAGE_SIZE = 124
WORDS = {"b_hat": 1, "t": 2, "n": 3, "filter_left": 6}
"""Places in an image (docs/design.md)."""


def robot_at(kind: FixedPointType, config: Config = PLAIN, **fields: int) -> FixedPoint:
    """A robot in a state of our choice: a new one's image with other words, restored. With observations it is
    one whose b_hat has just been re-estimated: x_hat and alpha may be anything until the next."""
    words = {WORDS[name]: value for name, value in fields.items()}
    words[29] = OWN_ID << 24 | (fields.get("t", 0) > 0) << 16
    call = Call("restore", tuple(number for word in words.items() for number in word))
    return kind.restore(config, edited_image(kind(config, OWN_ID, 0.75).save(), call))


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
