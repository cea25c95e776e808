"""Whole swarms on a real CAN bus of the Linux kernel."""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from mcp_asdf_tools.cli.main import main
from mcp_asdf_tools.recording.frame_logs import read_log
from socketcan.candump import Candump, listeners
from socketcan.vcan import interfaces
from support import wait_until
from targets.c_node import PLAIN_BUILD, CNode, candump_lines, node_command

pytestmark = pytest.mark.socketcan


PERIODS = ("--filter-period", "4", "--telemetry-period", "4")
FAULTS = ("--fault=loss=0.2", "--fault=delay=0.2", "--fault=corrupt=0.1", "--fault=liar=0.1")
SWARM = ("swarm", "--robots", "20", "--steps", "5", *PERIODS, *FAULTS, "--quiet")


@pytest.fixture(scope="module")
def simulated(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """The log of the swarm without a bus."""
    return logged(tmp_path_factory.mktemp("simulated"))


def logged(folder: Path, *bus: str) -> list[str]:
    """The swarm's log on a bus."""
    assert main([*SWARM, *bus, "--log", str(folder / "run.log")]) == 0
    return candump_lines(read_log(folder / "run.log"))


def test_twenty_robots_on_one_interface_leave_the_log_that_candump_and_any_bus_have(
    vcan: str, tmp_path: Path, simulated: list[str]
) -> None:
    with Candump(vcan, tmp_path) as candump:
        real = logged(tmp_path, "--interface", "socketcan", "--channel", vcan)
        told = candump_lines(candump.frames())
    assert told == real == simulated
    assert len(told) == 20 * (5 + 1 + 2)


def test_the_c_node_is_a_robot_of_an_emulated_swarm(
    tmp_path: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    settings = ("swarm", "--robots", "4", "--steps", "12", "--filter-period", "4", "--quiet", "--log")
    real, one, name = tmp_path / "real.log", tmp_path / "one.log", f"v{os.getpid()}d"
    bus = ("--interface", "socketcan", "--channel", f"{name}{{robot}}", "--device", f"0=socketcan:{name}0")
    with interfaces(*(f"{name}{robot}" for robot in range(4))):
        command = node_command(PLAIN_BUILD, tmp_path_factory)
        flawed = ("--lockstep", "--filter-period", 4, "--b-hat", 0.55)
        with ThreadPoolExecutor() as pool:
            starting = pool.submit(start_when_heard, command, f"{name}0", *flawed)
            assert main([*settings, str(real), *bus]) == 0
            with starting.result() as node:
                assert node.stop()["updates"] > 0
    assert main([*settings, str(one), "--interface", "virtual"]) == 0
    assert estimates(real) == estimates(one)


def start_when_heard(command: list[str], interface: str, *options: object) -> CNode:
    """Start robot 0 when somebody waits for its first heartbeat."""
    wait_until(lambda: listeners(interface) > 0)
    return CNode(command, interface, 0, *options)


def estimates(log: Path) -> list[str]:
    """The broadcasts of a log, sorted."""
    return sorted(line for line in candump_lines(read_log(log)) if line.startswith("106BB8"))
