"""Robot firmwares by name, each with a port for the integers that a frame carries."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from typing import TYPE_CHECKING, Protocol, TypeAlias, cast, runtime_checkable

from mcp_asdf.fixed_point import ONE, alpha_to_word, word_to_alpha
from mcp_asdf.robot import Config, FirmwareError, Robot, Status
from mcp_asdf_tools.common import UsageError, extensions

if TYPE_CHECKING:  # numpy is slow to load, and help needs the names below only
    import numpy as np
    from numpy.typing import NDArray

Words: TypeAlias = "NDArray[np.uint32]"
"""Estimates for a firmware, shape (estimates, 3): sender, x_hat and alpha, as ``bus.frames.Message``."""

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


@runtime_checkable
class Port(Protocol):
    """A robot's side of the bus: the raw integers of a message (units: ``bus.frames.Message``)."""

    @property
    def x_hat_raw(self) -> int:
        """Local estimate to broadcast."""

    @property
    def alpha_raw(self) -> int:
        """Local confidence to broadcast."""

    def receive_all(self, words: Words) -> int:
        """Hand over neighbours' messages in order; returns how many were accepted."""


def port_of(robot: Robot) -> Port:
    """Return ``robot`` itself if it speaks raw integers, else a port that rounds for it."""
    return robot if isinstance(robot, Port) else RoundingPort(robot)


class RoundingPort:
    """The port of a robot that computes in float64: it rounds x_hat to nearest, alpha down as codecs do."""

    def __init__(self, robot: Robot) -> None:
        self._robot = robot

    @property
    def x_hat_raw(self) -> int:
        """Local estimate to broadcast."""
        return round(self._robot.x_hat * ONE)

    @property
    def alpha_raw(self) -> int:
        """Local confidence to broadcast."""
        return alpha_to_word(self._robot.alpha)

    def receive_all(self, words: Words) -> int:
        """Hand over neighbours' messages in order; returns how many were accepted."""
        return sum(self._accepts(*each) for each in words.tolist())

    def _accepts(self, sender: int, x_hat: int, alpha: int) -> bool:
        try:
            return self._robot.receive(sender, x_hat / ONE, word_to_alpha(alpha)) is Status.OK
        except FirmwareError:
            return False
