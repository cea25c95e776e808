"""Robot firmwares by name."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from importlib import import_module
from typing import Any, cast

from mcp_asdf.robot import Config, FixedPointRobot, Robot
from mcp_asdf_tools.common import extensions
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.common.extras import install_instruction

RobotMaker = Callable[[Config, int, float], Robot]
"""Makes a robot from its settings, its id and b_hat, the accuracy that it assumes of its sensor at first."""

FIRMWARES = {
    "native": ("mcp_asdf.native", "NativeRobot"),
    "mirror": ("mcp_asdf.mirror", "MirrorRobot"),
    "reference": ("mcp_asdf.reference", "ReferenceRobot"),
}
"""Module and class of each firmware that comes with the project, by name."""


_MEMBERS: dict[type[Any], list[str]] = {
    kind: sorted(name for name in dir(kind) if not name.startswith("_")) for kind in (Robot, FixedPointRobot)
}
"""Names of the public members that each kind of robot must have."""


def firmware_names() -> extensions.Names:
    """Return the names of the firmwares that come with the project, then of installed extensions."""
    return extensions.Names(FIRMWARES, extensions.FIRMWARES)


def _make_by_extension(
    name: str, make: Callable[..., Any], config: Config, robot_id: int, b_hat: float
) -> Robot:
    """Call an extension's ``make``, and return its robot if that has all members of a robot.

    A robot with ``receive_all``, which takes estimates as integers, needs the members of
    ``mcp_asdf.FixedPointRobot``, any other those of ``mcp_asdf.Robot``. Raises UsageError, naming the missing
    members.
    """
    robot = make(config, robot_id, b_hat)
    # Checked now, and by name: a member that is missing would end a run in the middle.
    kind = FixedPointRobot if hasattr(robot, "receive_all") else Robot
    missing_members = [member for member in _MEMBERS[kind] if not hasattr(robot, member)]
    if missing_members:
        raise UsageError(
            f"the firmware {name} made a {type(robot).__name__} without {', '.join(missing_members)}; "
            f"give it all that mcp_asdf.{kind.__name__} has"
        )
    return cast(Robot, robot)


def load_firmware(name: str) -> RobotMaker:
    """Return the class of the firmware called ``name``, or the maker that an installed extension has.

    Raises UsageError if there is no such firmware, it has not been built, or it cannot be imported.
    """
    if name not in FIRMWARES:
        if name not in firmware_names():
            raise UsageError(f"firmware is {name!r}; choose one of {', '.join(firmware_names())}")
        extension = extensions.load(extensions.FIRMWARES, name)
        return partial(_make_by_extension, name, extension)
    module_name, class_name = FIRMWARES[name]
    # Imported only now: the native firmware may not have been built, and the others do not need it.
    try:
        module = import_module(module_name)
        return cast(RobotMaker, getattr(module, class_name))
    except ImportError as error:
        raise UsageError(
            f"firmware {name} cannot be loaded ({error}); choose mirror, or to build {name}, "
            f"{install_instruction()}"
        ) from error
