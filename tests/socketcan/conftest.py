"""Tests marked ``socketcan`` run where the kernel has CAN; elsewhere test_guest.py runs them in a guest."""

from __future__ import annotations

import os
from collections.abc import Iterator

import pytest

from mcp_asdf_tools.cli import swarm as swarm_command
from mcp_asdf_tools.swarm import carrier, remote_robot
from socketcan.guest import why_not_native
from socketcan.vcan import interfaces
from support import PATIENCE


def pytest_configure(config: pytest.Config) -> None:
    config.addinivalue_line("markers", "socketcan: needs a kernel with CAN")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    ours = [item for item in items if item.get_closest_marker("socketcan")]
    if ours and why_not_native():
        items[:] = [item for item in items if item not in ours]
        config.hook.pytest_deselected(items=ours)


@pytest.fixture(autouse=True, scope="module")
def one_cpu() -> Iterator[None]:
    """Keep the tests and all that they start on one CPU.

    A virtual interface delivers on the sender's CPU, so that of frames from two CPUs receivers may see
    either first. Lockstep needs a bus that keeps the order.
    """
    allowed = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {min(allowed)})
    yield
    os.sched_setaffinity(0, allowed)


@pytest.fixture(autouse=True)
def patient(monkeypatch: pytest.MonkeyPatch) -> None:
    """Give processes the time that they take to start and to answer in an emulator on a busy machine.

    A driver that has waited for half of the time says a command again, which makes another log.
    """
    monkeypatch.setattr(swarm_command, "_STARTING_TIMEOUT", PATIENCE)
    monkeypatch.setattr(remote_robot, "ANSWER_TIMEOUT", PATIENCE)
    monkeypatch.setattr(carrier, "FRAME_TIMEOUT", PATIENCE)


@pytest.fixture
def vcan() -> Iterator[str]:
    """A virtual CAN interface, up."""
    with interfaces(name := f"vcan{os.getpid() % 10000}"):
        yield name
