"""The C node on a real CAN bus of the Linux kernel, beside others, and what a bus may do to it."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import can
import pytest

from mcp_asdf_tools.bus.frames import Command, Estimate, FrameFormat, decode_command, encode_estimate
from mcp_asdf_tools.robots.lockstep import DRIVER_ID
from robots import ALPHA_ONE
from socketcan.candump import Candump
from socketcan.vcan import commands_that_make, connect, interfaces, ip, wait_for_frames
from support import PATIENCE
from targets.c_node import (
    CORTEX_A8,
    PLAIN_BUILD,
    CNode,
    NodeBuild,
    StartNode,
    assert_same_run,
    candump_lines,
    node_command,
    python_node,
    run_lockstep,
)

pytestmark = pytest.mark.socketcan

NODE_BITS = 0x7F
"""Bits of an identifier that hold the id of the sender."""


# ---- Robots together ----

TICKS = 25
FILTER_PERIOD = 5
B_HATS = (0.55, 0.95, 0.75)
"""Initial assumed accuracies of the robots 0, 1 and 2."""


@dataclass
class ThreeNodes:
    """What three C nodes did in 25 ticks on one bus.

    Attributes:
        kind: Build of robot 0; all other robots run the plain build.
        summaries: What each node prints at its end, by the robot's id.
        frames: All frames on the bus, as candump has recorded them.
        frames_of_robots: Those of the robots, as python-can has received them.
    """

    kind: NodeBuild
    summaries: list[dict[str, Any]]
    frames: list[can.Message]
    frames_of_robots: list[can.Message]


@pytest.fixture(scope="module", params=[PLAIN_BUILD, CORTEX_A8], ids=lambda kind: kind.name)
def three_nodes(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> ThreeNodes:
    """Three C nodes on one bus in lockstep. Robots 1 and 2 run the plain build, robot 0 either build."""
    kind: NodeBuild = request.param
    vcan = f"three{os.getpid() % 10000}"
    options = ("--lockstep", "--filter-period", FILTER_PERIOD, "--steps", TICKS)
    with (
        interfaces(vcan),
        Candump(vcan, tmp_path_factory.mktemp("candump")) as candump,
        connect(vcan) as bus,
        ExitStack() as running,
    ):
        nodes = []
        for robot, b_hat in enumerate(B_HATS):
            command = node_command(kind if robot == 0 else PLAIN_BUILD, tmp_path_factory)
            node = CNode(command, vcan, robot, *options, "--b-hat", b_hat)
            nodes.append(running.enter_context(node))
        frames_of_robots = run_lockstep(bus, robots=range(3), ticks=TICKS, seed=5)
        return ThreeNodes(kind, [node.summary() for node in nodes], candump.frames(), frames_of_robots)


@pytest.mark.parametrize("robot", range(3))
def test_a_c_node_has_the_bits_of_a_python_node_that_receives_the_same(
    robot: int, three_nodes: ThreeNodes
) -> None:
    """Three C nodes have run for 25 ticks, and heard each other in each tick.

    At the start they assumed the accuracies B_HATS: 0.55, 0.95 and 0.75. The robot's frames and its final
    state are compared with those of a Python node.
    """
    summary = three_nodes.summaries[robot]
    expected_node = python_node(robot, B_HATS[robot], filter_period=FILTER_PERIOD)
    assert_same_run(three_nodes.frames, summary, expected_node)
    ticks, neighbours = 25, 2
    assert summary["heard"] == neighbours * ticks
    if robot == 0:  # whose accuracy is the least right at the start
        assert summary["updates"] > 0, "of its accuracy"


def test_candump_and_python_can_receive_the_same_frames_of_robots(three_nodes: ThreeNodes) -> None:
    """The other frames on the bus are the commands of python-can's program, which drives the robots."""
    frames_from_candump = []
    for frame in three_nodes.frames:
        sender = frame.arbitration_id & NODE_BITS
        if sender != DRIVER_ID:
            frames_from_candump.append(frame)
    assert candump_lines(frames_from_candump) == candump_lines(three_nodes.frames_of_robots)


def test_a_node_receives_only_what_it_needs_or_counts_the_others(three_nodes: ThreeNodes) -> None:
    """A node needs commands and the estimates of other robots, up to the last command to itself.

    For the plain build the kernel filters. The emulator of the other build knows no filters of the kernel, so
    there the node does it.
    """
    summary, *_summaries_of_others = three_nodes.summaries
    needed_frames = [frame for frame in three_nodes.frames if is_needed_by_robot_0(frame)]
    while not is_command_to_robot_0(needed_frames[-1]):
        needed_frames.pop()  # it came after the last command, with which the node ended

    assert summary["received"] - summary["others"] == len(needed_frames)
    if three_nodes.kind is PLAIN_BUILD:
        assert (summary["filtered_by"], summary["others"]) == ("kernel", 0)
    else:
        assert summary["filtered_by"] == "node"


def is_needed_by_robot_0(frame: can.Message) -> bool:
    """Return whether a frame is an estimate of another robot than 0, or a command."""
    estimates, commands = 3000, 3002
    subject, sender = frame.arbitration_id >> 8 & 0x1FFF, frame.arbitration_id & NODE_BITS
    return subject == commands or (subject == estimates and sender != 0)


def is_command_to_robot_0(frame: can.Message) -> bool:
    """Return whether a frame is a command to robot 0."""
    command = decode_command(frame)
    return isinstance(command, Command) and command.target == 0


# ---- What the kernel is asked for ----


ESTIMATE_OF_ROBOT_3 = encode_estimate(Estimate(3, 2**22, ALPHA_ONE, 0), FrameFormat())


@pytest.fixture
def start(vcan: str, tmp_path: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[StartNode]:
    """Function that starts robot 0, whose sensor sees black, as a C node; it is stopped after the test."""
    sensor = tmp_path / "value"
    sensor.write_text("1", encoding="ascii")
    command = node_command(PLAIN_BUILD, tmp_path_factory)
    with ExitStack() as running:

        def start_node(*options: object) -> CNode:
            return running.enter_context(CNode(command, vcan, 0, "--sensor", sensor, *options))

        yield start_node


def test_a_node_counts_the_frames_that_its_receive_buffer_has_no_room_for(
    start: StartNode, vcan: str
) -> None:
    """While the node is stopped 500 frames come. The kernel reports those that are lost with the next one.

    So one more frame is sent when the node goes on. Its buffer has 4096 bytes.
    """
    node = start("--receive-buffer", 4096)
    with connect(vcan) as bus:
        wait_for_frames(bus, 1)  # of the node, which has started
        node.process.send_signal(signal.SIGSTOP)
        for _ in range(500):
            bus.send(ESTIMATE_OF_ROBOT_3, timeout=PATIENCE)
        node.process.send_signal(signal.SIGCONT)
        wait_for_frames(bus, 3)  # the node goes on
        bus.send(ESTIMATE_OF_ROBOT_3, timeout=PATIENCE)
        wait_for_frames(bus, 3)
    summary = node.stop()

    frames_sent_to_it = 500 + 1
    assert summary["overflowed"] > 400
    assert summary["overflowed"] + summary["heard"] == frames_sent_to_it
    assert summary["received"] == summary["heard"]


# ---- Faults ----


ABSENCE_SECONDS = 3.0
"""The time of 150 ticks of the node. On a busy machine an emulated guest skips some of them."""


@pytest.mark.parametrize("does_vanish", [False, True])
def test_a_node_goes_on_when_its_interface_has_gone_and_come_back(
    does_vanish: bool, start: StartNode, vcan: str
) -> None:
    """The interface is down for three seconds, or is deleted and made again.

    The node ticks on meanwhile, and afterwards sends and hears again.
    """
    node = start("--steps-per-second", 50)
    with connect(vcan) as bus:
        wait_for_frames(bus, 5)
    ip(f"link del dev {vcan}" if does_vanish else f"link set {vcan} down")
    time.sleep(ABSENCE_SECONDS)
    ip(*(commands_that_make(vcan) if does_vanish else [f"link set {vcan} up"]))
    with connect(vcan) as bus:
        wait_for_frames(bus, 5)
        bus.send(ESTIMATE_OF_ROBOT_3, timeout=PATIENCE)
        wait_for_frames(bus, 5)
    summary = node.stop()

    assert summary["downs"] == 1
    assert summary["heard"] == 1, "the estimate that is sent when the interface is there again"
    assert summary["unsent"] > 0, "frames meanwhile"
    assert summary["t"] == summary["ticks"], "an observation in each tick"
    assert summary["ticks"] >= 20
