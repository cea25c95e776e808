"""Robot firmwares by name."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from typing import cast

from mcp_asdf.robot import Config, Robot
from mcp_asdf_tools.common import extensions
from mcp_asdf_tools.common.errors import UsageError

RobotMaker = Callable[[Config, int, float], Robot]
"""Makes a robot from a config, a robot id and an initial assumed accuracy."""

FIRMWARES = {
    "native": ("mcp_asdf.native", "NativeRobot"),
    "mirror": ("mcp_asdf.mirror", "MirrorRobot"),
    "reference": ("mcp_asdf.reference", "ReferenceRobot"),
}


def firmware_names() -> extensions.Names:
    """Names of the firmwares that come with the project, then of installed extensions."""
    return extensions.Names(FIRMWARES, extensions.FIRMWARES)


def load_firmware(name: str) -> RobotMaker:
    """The class of the firmware called ``name``.

    Raises UsageError if there is no such firmware, it has not been built, or it cannot be imported.
    """
    if name not in FIRMWARES:
        if name not in firmware_names():
            raise UsageError(f"firmware is {name!r}; choose one of {', '.join(firmware_names())}")
        return cast(RobotMaker, extensions.load(extensions.FIRMWARES, name))
    module, class_name = FIRMWARES[name]
    try:
        return cast(RobotMaker, getattr(import_module(module), class_name))
    except ImportError as error:
        raise UsageError(
            f"firmware {name} cannot be loaded ({error}); build it with 'pip install .' or choose mirror"
        ) from error
