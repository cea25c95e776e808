"""Virtual CAN interfaces, and sockets on them without python-can."""

from __future__ import annotations

import argparse
import itertools
import os
import socket
import struct
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager

import can

from mcp_asdf_tools.bus.interfaces import choose_bus
from support import PATIENCE

_NUMBERS = itertools.count()
FRAME = struct.Struct("=IB3x8s")
"""The kernel's ``struct can_frame``: identifier with flags, length, data."""


def ip(*commands: str) -> None:
    """Let ``ip`` do all commands in one go; fails with what it says."""
    lines = "".join(f"{command}\n" for command in commands)
    done = subprocess.run(["ip", "-batch", "-"], input=lines, capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"{lines}{done.stderr}"


@contextmanager
def interfaces(*names: str) -> Iterator[None]:
    """Virtual CAN interfaces that are there and up inside."""
    ip(*(command for name in names for command in making(name)))
    yield
    ip(*(f"link del dev {name}" for name in names))


def making(name: str) -> tuple[str, str]:
    """Arguments of ``ip`` that make an interface."""
    return f"link add dev {name} type vcan", f"link set {name} mtu 72 up"


class Vcan:
    """A virtual CAN interface of a new name.

    Attributes:
        name: Of the interface.
    """

    def __init__(self) -> None:
        self.name = f"vcan{os.getpid() % 10000}x{next(_NUMBERS)}"

    def add(self) -> None:
        """Make it."""
        ip(*making(self.name))

    def delete(self) -> None:
        """Take it away."""
        ip(f"link del dev {self.name}")

    def set(self, state: str) -> None:
        """Take it ``up`` or ``down``."""
        ip(f"link set {self.name} {state}")

    def bus(self) -> can.BusABC:
        """A connection, as every command opens it."""
        return choose_bus(argparse.Namespace(interface="socketcan", channel=self.name)).open()

    def socket(self, timeout: float = PATIENCE) -> socket.socket:
        """A plain socket."""
        opened = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
        opened.settimeout(timeout)
        opened.bind((self.name,))
        return opened
