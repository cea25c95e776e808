"""Tests marked ``socketcan`` run on a kernel with CAN: this machine's, or else one guest's for all of them.

In the second case each test's report is that of the same test in the guest.
"""

from __future__ import annotations

import os
from collections.abc import Iterator

import pytest

from mcp_asdf_tools.cli import swarm as swarm_command
from mcp_asdf_tools.swarm import carrier, remote_robot
from socketcan.guest import why_not_native
from socketcan.relay import REPORTS, Reporter, reports_of
from socketcan.vcan import Vcan, interfaces
from support import PATIENCE


def pytest_configure(config: pytest.Config) -> None:
    config.addinivalue_line("markers", "socketcan: needs a kernel with CAN, and gets one")
    if REPORTS in os.environ:
        config.pluginmanager.register(Reporter(config, os.environ[REPORTS]))


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Before ``-m`` chooses among them: a guest takes minutes, this machine's kernel seconds."""
    ours = [item for item in items if item.get_closest_marker("socketcan")]
    if ours and REPORTS not in os.environ and why_not_native():
        for item in ours:
            item.add_marker(pytest.mark.slow)


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_protocol(item: pytest.Item, nextitem: pytest.Item | None) -> bool | None:
    if item.get_closest_marker("socketcan") is None or REPORTS in os.environ or not why_not_native():
        return None
    item.ihook.pytest_runtest_logstart(nodeid=item.nodeid, location=item.location)
    for report in reports_of(item):
        item.ihook.pytest_runtest_logreport(report=report)
    item.ihook.pytest_runtest_logfinish(nodeid=item.nodeid, location=item.location)
    # The test before left standing what it shares with this one, which the next may not need.
    item.session._setupstate.teardown_exact(nextitem)
    return True


@pytest.fixture(autouse=True)
def one_cpu() -> Iterator[None]:
    """Keep the test and all that it starts on one CPU.

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
    monkeypatch.setattr(carrier, "TIMEOUT", PATIENCE)


@pytest.fixture
def vcan() -> Iterator[Vcan]:
    """A virtual CAN interface of the test's own, up."""
    interface = Vcan()
    with interfaces(interface.name):
        yield interface
