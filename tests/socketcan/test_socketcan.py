"""The C node on a real CAN bus of the Linux kernel, beside others, and what a bus may do to it."""

from __future__ import annotations

import signal
import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import can
import pytest

from mcp_asdf_tools.bus.frames import Command, Estimate, FrameFormat, decode_command, encode_estimate
from mcp_asdf_tools.robots.lockstep import DRIVER_ID
from robots import ALPHA_ONE
from socketcan.candump import Candump
from socketcan.vcan import connect, ip, making
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


@pytest.fixture
def start(vcan: str, tmp_path_factory: pytest.TempPathFactory) -> Iterator[StartNode]:
    """Starts C nodes on the interface, and stops those that are left."""
    with ExitStack() as started:

        def start_node(robot_id: int, *options: object, kind: NodeBuild = PLAIN_BUILD) -> CNode:
            return started.enter_context(
                CNode(node_command(kind, tmp_path_factory), vcan, robot_id, *options)
            )

        yield start_node


# ---- Robots together ----


@pytest.mark.parametrize("kind", [PLAIN_BUILD, CORTEX_A8], ids=lambda kind: kind.name)
def test_c_nodes_have_the_bits_of_python_nodes_that_hear_the_same(
    kind: NodeBuild, start: StartNode, vcan: str, tmp_path: Path
) -> None:
    ticks, options = 25, ("--lockstep", "--filter-period", 5, "--steps", 25, "--b-hat")
    nodes = {0: (0.55, kind), 1: (0.95, PLAIN_BUILD), 2: (0.75, PLAIN_BUILD)}
    with Candump(vcan, tmp_path) as candump, connect(vcan) as bus:
        started = [start(robot, *options, b_hat, kind=kind) for robot, (b_hat, kind) in nodes.items()]
        seen = run_lockstep(bus, nodes, ticks, seed=5)
        figures = [node.summary() for node in started]
        log = candump.frames()
    for robot, (b_hat, _) in nodes.items():
        expected = python_node(robot, b_hat, filter_period=5)
        assert_same_run(log, figures[robot], expected)
        assert figures[robot]["heard"] == 2 * ticks
    assert figures[0]["updates"] > 0
    by_others = [frame for frame in log if frame.arbitration_id & NODE_BITS != DRIVER_ID]
    assert candump_lines(by_others) == candump_lines(seen), "candump and python-can saw the same"
    needed = [frame for frame in log if is_needed(frame)]
    last = max(number for number, frame in enumerate(needed) if is_command_to(0, frame))
    assert figures[0]["filtered_by"] == ("kernel" if kind is PLAIN_BUILD else "node")
    assert figures[0]["received"] - figures[0]["others"] == last + 1
    assert figures[0]["others"] == 0 or kind is CORTEX_A8


def is_needed(frame: can.Message) -> bool:
    """True for estimates of other robots than 0, and for commands."""
    subject, sender = frame.arbitration_id >> 8 & 0x1FFF, frame.arbitration_id & NODE_BITS
    return subject == 3002 or (subject == 3000 and sender != 0)


def is_command_to(robot: int, frame: can.Message) -> bool:
    command = decode_command(frame)
    return isinstance(command, Command) and command.target == robot


# ---- What the kernel is asked for ----


ESTIMATE = encode_estimate(Estimate(3, 2**22, ALPHA_ONE, 0), FrameFormat())


@pytest.fixture
def sensor(tmp_path: Path) -> Path:
    """A sensor that sees black."""
    (tmp_path / "value").write_text("1", encoding="ascii")
    return tmp_path / "value"


def test_frames_that_overflow_the_receive_buffer_are_counted(
    start: StartNode, sensor: Path, vcan: str
) -> None:
    node = start(0, "--sensor", sensor, "--receive-buffer", 4096)
    with connect(vcan) as bus:
        assert bus.recv(PATIENCE) is not None
        node.process.send_signal(signal.SIGSTOP)
        for _ in range(500):
            bus.send(ESTIMATE, timeout=PATIENCE)
        node.process.send_signal(signal.SIGCONT)
        wait_for(bus, 3)
        bus.send(ESTIMATE, timeout=PATIENCE)  # the kernel reports lost frames with the next one
        wait_for(bus, 3)
    figures = node.stop()
    assert figures["overflowed"] > 400
    assert figures["overflowed"] + figures["heard"] == 501
    assert figures["received"] == figures["heard"]


def wait_for(bus: can.BusABC, frames: int) -> None:
    for _ in range(frames):
        assert bus.recv(PATIENCE) is not None


# ---- Faults ----


_ABSENCE = 3.0
"""Seconds: 150 ticks of the node, of which an emulated guest on a busy machine leaves some."""


@pytest.mark.parametrize("does_vanish", [False, True])
def test_an_interface_may_go_and_come_back(
    does_vanish: bool, start: StartNode, sensor: Path, vcan: str
) -> None:
    """The node ticks on meanwhile, and afterwards sends and hears again."""
    node = start(0, "--sensor", sensor, "--steps-per-second", 50)
    with connect(vcan) as bus:
        wait_for(bus, 5)
    ip(f"link del dev {vcan}" if does_vanish else f"link set {vcan} down")
    time.sleep(_ABSENCE)
    ip(*(making(vcan) if does_vanish else [f"link set {vcan} up"]))
    with connect(vcan) as bus:
        wait_for(bus, 5)
        bus.send(ESTIMATE, timeout=PATIENCE)
        wait_for(bus, 5)
    figures = node.stop()
    assert figures["downs"] == 1
    assert figures["unsent"] > 0
    assert figures["heard"] == 1
    assert figures["t"] == figures["ticks"] >= 20
