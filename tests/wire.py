"""Buses of tests: one without time or threads, whose nodes answer at once, and a node in a thread."""

from __future__ import annotations

import os
import shlex
import threading
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from copy import copy
from types import SimpleNamespace
from typing import Any

import can
import pytest

from mcp_asdf.robot import Config
from mcp_asdf_tools.bus.frames import Heartbeat, encode_heartbeat
from mcp_asdf_tools.cli.main import main
from mcp_asdf_tools.robots import lockstep
from mcp_asdf_tools.robots.node import RobotNode
from mcp_asdf_tools.robots.robot_setup import RobotSetup
from mcp_asdf_tools.tables.thresholds import generate, parse_omega
from support import PATIENCE

TABLE = generate(parse_omega("0.05"), 20)
"""The t-table of the robots: omega is 0.05, for up to 20 neighbours."""

CLOCK: Any = SimpleNamespace(now=0.0, monotonic=lambda: CLOCK.now)
"""Stands in for the module ``time``: its time, ``now``, stands still unless a Wire is waited on in vain."""


@contextmanager
def frozen_clock() -> Iterator[None]:
    """Let commands to robots in lockstep read CLOCK, so that no time passes while they work.

    Timeouts of hundredths of a second are exact then, however busy the machine is. As a decorator it does so
    for a whole test.
    """
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(lockstep, "time", CLOCK)
        yield


class Wire(can.BusABC):
    """The connection of a tool to some nodes, which also receive from each other; all answer at once.

    Attributes:
        nodes: The nodes.
        sent: Frames that the tool has sent, in order.
        frames_of_nodes: Frames that the nodes have sent, in order.
        frames_for_tool: Frames that the tool has not received yet, in order.
    """

    def __init__(self, *nodes: RobotNode) -> None:
        super().__init__(channel="wire")
        self.channel_info = "wire"
        self.nodes = list(nodes)
        self.sent: list[can.Message] = []
        self.frames_of_nodes: list[can.Message] = []
        self.frames_for_tool: deque[can.Message] = deque()
        for node in nodes:
            self.send_from(node, node.start())

    def send_from(self, node: RobotNode, frames: Sequence[can.Message]) -> None:
        """Send frames of a node, and after each one at once the frames with which other nodes answer it."""
        for frame in frames:
            received_frame = copy(frame)
            received_frame.is_rx = True
            self.frames_of_nodes.append(received_frame)
            self.frames_for_tool.append(received_frame)
            for other in self.nodes:
                if other is not node:
                    self.send_from(other, other.receive_frame(frame))

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Send a frame of the tool to all nodes; the tool receives it, too, marked as its own."""
        assert timeout is not None
        self.sent.append(msg)
        self.frames_for_tool.append(msg)
        for node in self.nodes:
            self.send_from(node, node.receive_frame(msg))

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """Return the next frame for the tool, or let CLOCK go on by the timeout and return None."""
        if self.frames_for_tool:
            return self.frames_for_tool.popleft()
        CLOCK.now += (timeout or 0.0) + 1e-6  # some time passes without a timeout, too, so that loops end
        return None

    def __del__(self) -> None:
        """Do nothing: python-can would warn of a bus that is not shut down, but nothing is open."""


class EndlessWire(Wire):
    """A wire on which node 40 sends heartbeats without end."""

    frames = 0
    """Number of heartbeats received so far."""

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """Return another heartbeat, 10 ms later. Fails after 1000, as nothing seems to end the wait."""
        self.frames += 1
        assert self.frames < 1000, "nothing ends the wait"
        CLOCK.now += 0.01
        return encode_heartbeat(Heartbeat(sender=40, uptime=0, transfer_id=0))


def setup_of_robot(robot: int, firmware: str = "native", b_hat: float = 0.8, **config: Any) -> RobotSetup:
    """Return the setup of a robot, which filters every 10 ticks by default, with TABLE.

    ``config`` has other parameters of the firmware, and maybe ``comms_period``: the robot broadcasts in every
    so many ticks. ``filter_period`` is in ticks here; firmware counts rounds, from one broadcast to the next.
    """
    parameters: dict[str, Any] = {"table": TABLE, "filter_period": 10} | config
    comms_period = parameters.pop("comms_period", 1)
    parameters["filter_period"] //= comms_period
    return RobotSetup(robot, firmware, b_hat, Config(**parameters), comms_period)


def make_node(robot: int, firmware: str = "native", b_hat: float = 0.8, **config: Any) -> RobotNode:
    """Return a node in lockstep with the robot of ``setup_of_robot``. A heartbeat comes every 10 ticks."""
    return RobotNode(setup_of_robot(robot, firmware, b_hat, **config))


def join_virtual_bus() -> can.BusABC:
    """Return a new connection to the virtual bus that commands use by default."""
    return can.Bus(interface="virtual", channel="vcan0", ignore_config=True)


@contextmanager
def running_in_thread(work: Callable[[], object]) -> Iterator[None]:
    """Call ``work`` in another thread while the block runs, and wait for it at the end of the block.

    What it raises is raised then.
    """
    errors: list[BaseException] = []

    def keep_error_of_work() -> None:
        try:
            work()
        except BaseException as error:
            errors.append(error)

    thread = threading.Thread(target=keep_error_of_work)
    thread.start()
    try:
        yield
    finally:
        thread.join()
    if errors:
        raise errors[0]


@contextmanager
def node_in_a_thread(options: str) -> Iterator[can.BusABC]:
    """Run ``mcp-asdf node`` with some options in another thread, and yield a connection to its bus.

    The block begins when the node has sent its first frame. The node ends with the block, as its standard
    input does, which is a pipe.
    """
    read_end, write_end = os.pipe()

    def run_node() -> None:
        assert main(["node", *shlex.split(options), "--quiet", "--until-eof"]) == 0

    with join_virtual_bus() as bus, pytest.MonkeyPatch.context() as patch, os.fdopen(read_end) as stdin:
        patch.setattr("sys.stdin", stdin)
        with running_in_thread(run_node):
            try:
                assert bus.recv(PATIENCE) is not None
                yield bus
            finally:
                os.close(write_end)


def radio(options: str) -> int:
    """Run ``mcp-asdf radio`` on the virtual bus, and return its exit code."""
    return main(["radio", "--interface", "virtual", *shlex.split(options)])
