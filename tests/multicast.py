"""A bus for several processes of this machine."""

from __future__ import annotations

from typing import Any

import can
import pytest

from mcp_asdf_tools.bus.interfaces import BusChoice


def multicast(group: int) -> BusChoice:
    """Return bus number ``group`` of this machine, or skip the test if it has none. Each test has its own."""
    settings = {"hop_limit": 0, "channel": f"239.74.163.{group}", "port": 43200 + group}
    choice = BusChoice("udp_multicast", settings)
    if not _works(choice):
        pytest.skip("IP multicast does not reach other processes of this machine")
    return choice


def _works(choice: BusChoice) -> bool:
    """Return whether a frame gets from one connection of python-can's to another."""
    settings: Any = {"interface": choice.interface, "ignore_config": True, **choice.settings}
    try:
        with can.Bus(**settings) as one, can.Bus(**settings) as other:
            one.send(can.Message(arbitration_id=1), timeout=1)
            return other.recv(2) is not None
    except (can.CanError, OSError):
        return False
