"""The C node on a real CAN bus of the Linux kernel, beside Python nodes, and what a bus may do to it."""

from __future__ import annotations

import signal
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import can
import pytest

from mcp_asdf_tools.bus.frames import (
    Command,
    FrameFormat,
    Message,
    decode_command,
    encode,
)
from mcp_asdf_tools.cli.main import main
from mcp_asdf_tools.robots.lockstep import DRIVER_ID, Lockstep
from robots import ALPHA_ONE
from socketcan.candump import Candump
from socketcan.robots import PythonNode
from socketcan.vcan import Vcan
from support import PATIENCE
from targets.c_node import (
    CORTEX_A8,
    PLAIN,
    CNode,
    Kind,
    Start,
    assert_same_robot,
    built,
    content,
    drive,
    twin,
)

pytestmark = pytest.mark.socketcan

NODE_BITS, EXTENDED = 0x7F, 0x8000_0000


@pytest.fixture(scope="module")
def build(tmp_path_factory: pytest.TempPathFactory) -> Callable[[Kind], list[str]]:
    return lambda kind: built(kind, tmp_path_factory)


@pytest.fixture
def start(build: Callable[[Kind], list[str]], vcan: Vcan) -> Iterator[Start]:
    """Starts C nodes on the interface, and stops those that are left."""
    started: list[CNode] = []

    def start_node(robot_id: int, *options: object, kind: Kind = PLAIN, **streams: Any) -> CNode:
        started.append(CNode(build(kind), vcan.name, robot_id, *options, **streams))
        return started[-1]

    yield start_node
    for node in started:
        node.__exit__()


# ---- Robots together ----


@pytest.mark.parametrize("kind", [PLAIN, CORTEX_A8], ids=lambda kind: kind.name)
def test_a_c_node_has_the_bits_of_a_python_node_that_hears_the_same(
    kind: Kind, start: Start, vcan: Vcan, tmp_path: Path
) -> None:
    ticks = 25
    others = (PythonNode(vcan, 1, 0.95, filter_period=5), PythonNode(vcan, 2, 0.75, filter_period=5))
    with Candump(vcan, tmp_path) as candump, vcan.bus() as bus, others[0], others[1]:
        node = start(0, "--lockstep", "--b-hat", 0.55, "--filter-period", 5, "--steps", ticks, kind=kind)
        seen = drive(bus, range(3), ticks, seed=5)
        figures = node.summary()
        log = candump.frames()
    expected = twin(0, 0.55, filter_period=5)
    told = [frame for frame in log if frame.arbitration_id & NODE_BITS != 0]
    answers = expected.start() + [answer for frame in told for answer in expected.hear(frame)]
    assert content(answers) == content(frame for frame in log if frame.arbitration_id & NODE_BITS == 0)
    assert_same_robot(figures, expected)
    assert figures["updates"] > 0 and figures["heard"] == 2 * ticks
    by_others = [frame for frame in log if frame.arbitration_id & NODE_BITS != DRIVER_ID]
    assert content(by_others) == content(seen), "candump and python-can saw the same"
    needed = [frame for frame in log if is_needed(frame)]
    last = max(number for number, frame in enumerate(needed) if is_command_to(0, frame))
    needed = needed[: last + 1]
    if kind is PLAIN:
        assert (figures["filtered_by"], figures["received"], figures["others"]) == ("kernel", len(needed), 0)
    else:
        assert figures["filtered_by"] == "node"
        assert figures["received"] - figures["others"] == len(needed)


def test_the_verdict_on_the_c_node_is_good(start: Start, vcan: Vcan, tmp_path: Path) -> None:
    report = tmp_path / "report.json"
    with vcan.bus() as bus:
        start(3, "--lockstep", "--b-hat", 0.75, "--filter-period", 4)
        Lockstep(bus).wait_until_up([3], PATIENCE)
    robot = ("--id", "3", "--b-hat", "0.75", "--filter-period", "4")
    run = ("--robots", "3", "--steps", "20", "--timeout", str(PATIENCE), "--report", str(report))
    assert main(["radio", "--verify", *robot, *run, "--interface", "socketcan", "--channel", vcan.name]) == 0
    assert report.exists()


def is_needed(frame: can.Message) -> bool:
    """True for estimates of other robots than 0, and for commands."""
    subject, sender = frame.arbitration_id >> 8 & 0x1FFF, frame.arbitration_id & NODE_BITS
    return subject == 3002 or (subject == 3000 and sender != 0)


def is_command_to(robot: int, frame: can.Message) -> bool:
    command = decode_command(frame)
    return isinstance(command, Command) and command.target == robot


# ---- What the kernel is asked for ----


def test_frames_that_overflow_the_receive_buffer_are_counted(
    start: Start, vcan: Vcan, tmp_path: Path
) -> None:
    sensor = tmp_path / "value"
    sensor.write_text("1", encoding="ascii")
    node = start(0, "--sensor", sensor, "--receive-buffer", 4096)
    estimate = encode(Message(3, 2**22, ALPHA_ONE, 0), FrameFormat())
    with vcan.bus() as bus:
        assert bus.recv(PATIENCE) is not None
        node.process.send_signal(signal.SIGSTOP)
        for _ in range(500):
            bus.send(estimate, timeout=PATIENCE)
        node.process.send_signal(signal.SIGCONT)
        wait_for(bus, 3)
        bus.send(estimate, timeout=PATIENCE)  # the kernel reports lost frames with the next one
        wait_for(bus, 3)
    figures = node.stop()
    assert figures["overflowed"] > 400
    assert figures["overflowed"] + figures["heard"] == 501
    assert figures["received"] == figures["heard"]


def wait_for(bus: can.BusABC, frames: int) -> None:
    for _ in range(frames):
        assert bus.recv(PATIENCE) is not None


# ---- Faults ----


def test_an_interface_may_go_down_and_up(start: Start, vcan: Vcan, tmp_path: Path) -> None:
    check_interruption(start, vcan, tmp_path, lambda: vcan.set("down"), lambda: vcan.set("up"))


def test_an_interface_may_vanish_and_come_back(start: Start, vcan: Vcan, tmp_path: Path) -> None:
    check_interruption(start, vcan, tmp_path, vcan.delete, vcan.add)


_ABSENCE = 3.0
"""Seconds: 150 ticks of the node, of which an emulated guest on a busy machine leaves some."""


def check_interruption(
    start: Start, vcan: Vcan, folder: Path, begin: Callable[[], None], end: Callable[[], None]
) -> None:
    """The node ticks on meanwhile, and afterwards sends and hears again."""
    sensor = folder / "value"
    sensor.write_text("1", encoding="ascii")
    node = start(0, "--sensor", sensor, "--steps-per-second", 50)
    with vcan.bus() as bus:
        wait_for(bus, 5)
    begin()
    time.sleep(_ABSENCE)
    end()
    with vcan.bus() as bus:
        wait_for(bus, 5)
        bus.send(encode(Message(3, 2**22, ALPHA_ONE, 0), FrameFormat()), timeout=PATIENCE)
        wait_for(bus, 5)
    figures = node.stop()
    assert figures["downs"] == 1
    assert figures["unsent"] > 0
    assert figures["heard"] == 1
    assert figures["t"] == figures["ticks"] >= 20
