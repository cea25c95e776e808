"""A robot of the firmware as a shared library, driven by ctypes through the library's symbols alone."""

from __future__ import annotations

import ctypes
import re

from mcp_asdf.robot import Config
from support import HEADER


class CConfig(ctypes.Structure):
    """``mcp_asdf_config_t``."""

    _fields_ = (
        ("table", ctypes.c_void_p),
        ("filter_period", ctypes.c_uint32),
        ("memory", ctypes.c_uint32),
        ("filter", ctypes.c_uint8),
    )


def robot_size() -> int:
    """Return the number of bytes that the header says a robot has at most."""
    text = HEADER.read_text(encoding="utf-8")
    return int(re.findall(r"^#define MCP_ASDF_SIZE_MAX (\d+)", text, re.MULTILINE)[0])


class CtypesRobot:
    """A robot that ctypes steps, without a header.

    Attributes:
        memory: The robot's own memory, which functions of the library take as its address.
    """

    def __init__(self, firmware: ctypes.CDLL, config: Config, robot_id: int, b_hat: float) -> None:
        """Initialise a robot of a loaded library. Fails if the firmware refuses the settings."""
        self._firmware = firmware
        self.memory = (ctypes.c_uint64 * (robot_size() // 8))()
        # The library keeps the addresses of the settings and of the table, so both have to stay.
        words = config.table.words() if config.table else ()
        self._table = (ctypes.c_uint32 * len(words))(*words)
        table_address = ctypes.addressof(self._table) if config.table else None
        self._config = CConfig(table_address, config.filter_period, config.memory, config.filter)
        raw_b_hat = ctypes.c_uint32(round(b_hat * 2**32))
        status = firmware.mcp_asdf_init(self.memory, ctypes.byref(self._config), robot_id, raw_b_hat)
        assert status == 0

    def receive(self, sender: int, x_hat: int, alpha: int) -> None:
        self._firmware.mcp_asdf_receive(self.memory, sender, x_hat, ctypes.c_uint32(alpha))

    def step(self, is_black: bool) -> None:
        """Observe and settle."""
        self._firmware.mcp_asdf_step(self.memory, int(is_black))

    def read(self, name: str, c_type: type[ctypes.c_uint32 | ctypes.c_uint64] = ctypes.c_uint32) -> int:
        """Return what a function such as ``mcp_asdf_x`` returns for the robot."""
        function = self._firmware[f"mcp_asdf_{name}"]
        function.restype = c_type
        return int(function(self.memory))
