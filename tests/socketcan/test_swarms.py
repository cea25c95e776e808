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
def log_of_simulation(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """The log of the swarm without a bus, as candump writes it."""
    return run_swarm_with_log(tmp_path_factory.mktemp("simulated"))


def run_swarm_with_log(folder: Path, *bus: str) -> list[str]:
    """Run the swarm on a bus, and return the frames in its log as candump writes them."""
    assert main([*SWARM, *bus, "--log", str(folder / "run.log")]) == 0
    return candump_lines(read_log(folder / "run.log"))


def test_twenty_robots_on_one_interface_leave_the_log_that_candump_and_any_bus_have(
    vcan: str, tmp_path: Path, log_of_simulation: list[str]
) -> None:
    """The swarm has link faults and liars. They are the same on every bus, and in a simulation without one.

    In five steps each robot sends five estimates, a heartbeat and telemetry in every fourth step.
    """
    with Candump(vcan, tmp_path) as candump:
        log_of_swarm = run_swarm_with_log(tmp_path, "--interface", "socketcan", "--channel", vcan)
        log_of_candump = candump_lines(candump.frames())

    assert log_of_swarm == log_of_simulation
    assert log_of_candump == log_of_simulation
    estimates, heartbeats, telemetry = 5, 1, 2  # of a robot
    assert len(log_of_simulation) == 20 * (estimates + heartbeats + telemetry)


SMALL_SWARM = ("swarm", "--robots", "4", "--steps", "12", "--filter-period", "4", "--quiet")


def test_a_swarm_with_a_c_node_as_robot_0_sends_the_estimates_of_an_emulated_swarm(
    tmp_path: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """Each robot has an interface of its own. The swarm leaves robot 0's interface to a C node.

    The C node is started in a thread, when the swarm waits for it. The emulated swarm needs no C node.
    """
    log, log_of_emulation = tmp_path / "run.log", tmp_path / "emulation.log"
    name = f"v{os.getpid()}d"
    bus = ("--interface", "socketcan", "--channel", f"{name}{{robot}}", "--device", f"0=socketcan:{name}0")
    command = node_command(PLAIN_BUILD, tmp_path_factory)
    with interfaces(*(f"{name}{robot}" for robot in range(4))), ThreadPoolExecutor() as pool:
        starting = pool.submit(start_when_awaited, command, f"{name}0")
        assert main([*SMALL_SWARM, *bus, "--log", str(log)]) == 0
        with starting.result() as node:
            summary = node.stop()
    assert summary["updates"] > 0, "of the accuracy of the C node"

    assert main([*SMALL_SWARM, "--interface", "virtual", "--log", str(log_of_emulation)]) == 0
    assert sorted_estimates(log) == sorted_estimates(log_of_emulation)


def start_when_awaited(command: list[str], interface: str) -> CNode:
    """Start robot 0, which is flawed, when the swarm waits for its first heartbeat."""
    wait_until(lambda: listeners(interface) > 0)
    return CNode(command, interface, 0, "--lockstep", "--filter-period", 4, "--b-hat", 0.55)


def sorted_estimates(log: Path) -> list[str]:
    """Return the frames with estimates in a log as candump writes them, sorted."""
    return sorted(line for line in candump_lines(read_log(log)) if line.startswith("106BB8"))
