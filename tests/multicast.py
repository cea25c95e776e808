"""A bus for several processes of this machine."""

from __future__ import annotations

import argparse

import can
import pytest

from mcp_asdf_tools.bus.interfaces import BusChoice, add_arguments, choose_bus
from mcp_asdf_tools.common.errors import UsageError


def multicast(group: int) -> BusChoice:
    """Bus number ``group`` of this machine; each test has one of its own. Skips the test if there is none."""
    parser = argparse.ArgumentParser()
    add_arguments(parser)
    port = 43200 + group
    words = ["--interface=udp_multicast", f"--channel=239.74.163.{group}", "--bus-kwargs", f"port={port}"]
    choice = choose_bus(parser.parse_args(words))
    if not _works(choice):
        pytest.skip("IP multicast does not reach other processes of this machine")
    return choice


def _works(choice: BusChoice) -> bool:
    """True if a frame gets from one connection to another."""
    try:
        with choice.open() as one, choice.open() as other:
            one.send(can.Message(arbitration_id=1), timeout=1)
            return other.recv(2) is not None
    except (UsageError, can.CanError):
        return False
