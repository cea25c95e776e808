"""Helpers of the tests of robots: lists of the implementations, and robots in a certain state."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any

import pytest

from mcp_asdf.mirror import MirrorRobot, accuracy_of, estimate
from mcp_asdf.native import NativeRobot
from mcp_asdf.reference import ReferenceRobot
from mcp_asdf.robot import Config, Filter, FirmwareError, Observation, Robot, Status
from mcp_asdf.table import Table

FixedPoint = MirrorRobot | NativeRobot
FixedPointFirmware = type[MirrorRobot] | type[NativeRobot]
Firmware = FixedPointFirmware | type[ReferenceRobot]

FIXED_POINT_FIRMWARES: tuple[FixedPointFirmware, ...] = (MirrorRobot, NativeRobot)
FIRMWARES: tuple[Firmware, ...] = (MirrorRobot, NativeRobot, ReferenceRobot)

for_every_firmware = pytest.mark.parametrize("firmware", FIRMWARES, ids=lambda kind: kind.__name__)
for_fixed_point_firmwares = pytest.mark.parametrize(
    "firmware", FIXED_POINT_FIRMWARES, ids=lambda kind: kind.__name__
)

OWN_ID = 5
ONE, HALF = 1 << 23, 1 << 22
ALPHA_ONE = 0x80000001
"""The alpha word of 1.0: a mantissa of 2^23 and a shift by 1, in units of 2^-24."""
ALPHA_MIN, ALPHA_MAX = 0x00000100, 0xFFFFFF1F
"""The alpha words of one unit of 2^-24, and of 2^31 - 2^7."""
NO_FILTER = Config(filter=Filter.OFF)
"""Parameters of a robot without a filter, which needs no table."""

ROBUST = Config(filter=Filter.ROBUST, filter_period=1)
"""Parameters of a robot with the robust filter, which runs in every round."""
ROBUST_B_HAT = round(0.95 * 2**32)
"""The b_hat of 0.95 in units of 2**-32."""

TABLE = Table(omega_word=214748365, entries=(9 << 26, 4 << 26, 2 << 26, (1 << 26) + 1))
"""A table with an exact threshold for up to 4 neighbours.

Its thresholds, in units of 2**-26, are 9, 4, 2, and just above 1 for every larger m: they differ clearly.
"""

IMAGE_SIZE = 124
"""Bytes of a saved robot without the robust filter."""


def make_robot(
    firmware: Firmware, config: Config = NO_FILTER, b_hat: float = 0.75, robot_id: int = OWN_ID
) -> Robot:
    """Make a robot that has not observed or received anything."""
    return firmware(config, robot_id, b_hat)


def restore_robot(
    firmware: FixedPointFirmware, config: Config, b_hat: int = 3 << 30, **members: Any
) -> FixedPoint:
    """Make a robot with these members of its state, such as t and n.

    b_hat, in units of 2**-32, has just been re-estimated: x_hat and alpha need not follow from it until the
    next observation.
    """
    mirror = MirrorRobot(config, OWN_ID, 0.75)
    mirror.s = replace(mirror.s, accuracy=accuracy_of(b_hat), updated=1, **members)
    return firmware.restore(config, mirror.save())


def restore_robust_robot(
    firmware: FixedPointFirmware,
    t: int = 0,
    n: int = 0,
    b_hat: int = ROBUST_B_HAT,
    estimates: Sequence[int] = (),
    **members: Any,
) -> FixedPoint:
    """Make a robot with the robust filter, after n black of t observations, and with members of its filter.

    ``b_hat`` is the present accuracy, in units of 2**-32; the initial accuracy is 0.95.
    ``estimates`` are in the slots from 0 on, in units of 2**-16.
    """
    mirror = MirrorRobot(ROBUST, OWN_ID, 0.95)
    mirror.s.t, mirror.s.n, mirror.s.accuracy = t, n, accuracy_of(b_hat)
    if t > 0:
        mirror.s.x_hat, mirror.s.alpha = estimate(t, n, mirror.s.accuracy)
    mirror.s.estimates[: len(estimates)] = estimates
    filter_members = {"filled_slots": 2 ** len(estimates) - 1} | members
    mirror.s.robust = replace(mirror.s.robust, **filter_members)
    return firmware.restore(ROBUST, mirror.save())


def observe_tiles(robot: Robot, black: int, white: int) -> None:
    """Let a robot observe so many black tiles, then so many white ones; no round ends."""
    for z in [Observation.BLACK] * black + [Observation.WHITE] * white:
        robot.observe(z)


def receive_estimates(robot: Robot, *estimates: float) -> None:
    """Let a robot receive estimates with confidence 1, each from another sender."""
    for sender, x_hat in enumerate(estimates, OWN_ID + 1):
        robot.receive(sender, x_hat, 1.0)


def receive_raw_messages(robot: FixedPoint, messages: Iterable[tuple[int, int, int]]) -> None:
    """Let a robot receive raw messages of sender, x_hat and alpha."""
    for sender, x_hat, alpha in messages:
        robot.receive_raw(sender, x_hat, alpha)


def status_of_receive(robot: Robot, sender: int, x_hat: float, alpha: float) -> Status:
    """Let a robot receive a message, and return the status, also if it raises FirmwareError."""
    try:
        status = robot.receive(sender, x_hat, alpha)
    except FirmwareError as error:
        return error.status
    assert status >= Status.OK, "a rejected message raises"
    return status
