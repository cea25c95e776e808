"""Virtual CAN interfaces."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from contextlib import contextmanager

import can

from mcp_asdf_tools.bus.interfaces import choose_bus
from support import PATIENCE


def ip(*commands: str) -> None:
    """Run commands of ``ip`` in one go. Fails with what it prints."""
    lines = "".join(f"{command}\n" for command in commands)
    done = subprocess.run(["ip", "-batch", "-"], input=lines, capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"{lines}{done.stderr}"


@contextmanager
def interfaces(*names: str) -> Iterator[None]:
    """Make virtual CAN interfaces that are up while the block runs."""
    ip(*(command for name in names for command in commands_that_make(name)))
    yield
    ip(*(f"link del dev {name}" for name in names))


def commands_that_make(name: str) -> tuple[str, str]:
    """Return the arguments of ``ip`` that make an interface."""
    return f"link add dev {name} type vcan", f"link set {name} mtu 72 up"


def connect(name: str) -> can.BusABC:
    """Return a connection to an interface, as every command opens it."""
    return choose_bus({"interface": "socketcan", "channel": name}).open()


def wait_for_frames(bus: can.BusABC, count: int) -> None:
    """Wait until so many frames have come. Fails if one takes longer than PATIENCE seconds."""
    for _ in range(count):
        assert bus.recv(PATIENCE) is not None
