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


CLOCK: Any = SimpleNamespace(now=0.0, monotonic=lambda: CLOCK.now)
"""Time that stands still unless somebody waits."""


@contextmanager
def still() -> Iterator[None]:
    """Let no time pass for those who command robots on a Wire but while they wait for it in vain.

    So limits of hundredths of a second are exact, however busy the machine. Decorates tests, too.
    """
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(lockstep, "time", CLOCK)
        yield


class Wire(can.BusABC):
    """The connection of a tool to some nodes, which also hear each other.

    Attributes:
        sent: What the tool has sent.
        told: What nodes have sent.
    """

    def __init__(self, *nodes: RobotNode) -> None:
        super().__init__(channel="wire")
        self.channel_info = "wire"
        self.nodes = list(nodes)
        self.sent: list[can.Message] = []
        self.told: list[can.Message] = []
        self._waiting: deque[can.Message] = deque()
        for node in nodes:
            self.say(node, node.start())

    def say(self, node: RobotNode, frames: Sequence[can.Message]) -> None:
        """Let a node put frames on the wire."""
        for frame in frames:
            arriving = copy(frame)
            arriving.is_rx = True
            self.told.append(arriving)
            self._waiting.append(arriving)
            for other in self.nodes:
                if other is not node:
                    self.say(other, other.receive_frame(frame))

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Let all nodes hear a frame of the tool, and return it to the tool, marked as its own."""
        assert timeout is not None
        self.sent.append(msg)
        self._waiting.append(msg)
        for node in self.nodes:
            self.say(node, node.receive_frame(msg))

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """The next frame, at once; if none is on its way, the time of ``still`` has passed in vain."""
        if self._waiting:
            return self._waiting.popleft()
        CLOCK.now += (timeout or 0.0) + 1e-6  # looking takes time, too
        return None

    def __del__(self) -> None:
        """Nothing to close."""


class EndlessWire(Wire):
    """A wire on which another node talks without end. Fails if nothing stops the listening."""

    frames = 0

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """Another heartbeat."""
        self.frames += 1
        assert self.frames < 1000, "nothing ends the wait"
        CLOCK.now += 0.01
        return encode_heartbeat(Heartbeat(40, 0, 0))


def record(robot: int, firmware: str = "native", b_hat: float = 0.8, **config: Any) -> RobotSetup:
    """Initial state of a robot; by default it filters every 10 ticks."""
    usual: dict[str, Any] = {"table": TABLE, "filter_period": 10, "comms_period": 1} | config
    comms_period = usual.pop("comms_period")
    usual["filter_period"] //= comms_period
    return RobotSetup(robot, firmware, b_hat, Config(**usual), comms_period)


def node(robot: int, firmware: str = "native", b_hat: float = 0.8, **config: Any) -> RobotNode:
    """A node in lockstep with a heartbeat every 10 ticks."""
    return RobotNode(record(robot, firmware, b_hat, **config))


def join() -> can.BusABC:
    """Join the bus that commands use by default."""
    return can.Bus(interface="virtual", channel="vcan0", ignore_config=True)


@contextmanager
def meanwhile(work: Callable[[], object]) -> Iterator[None]:
    """Do ``work`` in another thread; what it raises is raised here at the end."""
    raised: list[BaseException] = []

    def guarded() -> None:
        try:
            work()
        except BaseException as error:
            raised.append(error)

    thread = threading.Thread(target=guarded)
    thread.start()
    try:
        yield
    finally:
        thread.join()
    if raised:
        raise raised[0]


@contextmanager
def node_in_a_thread(options: str) -> Iterator[can.BusABC]:
    """A node that obeys commands, up before the block begins; it ends with the block, which gets its bus."""
    reading, writing = os.pipe()

    def run() -> None:
        assert main(["node", *shlex.split(options), "--quiet", "--until-eof"]) == 0

    with join() as bus, pytest.MonkeyPatch.context() as patch, os.fdopen(reading) as stdin:
        patch.setattr("sys.stdin", stdin)
        with meanwhile(run):
            try:
                assert bus.recv(PATIENCE) is not None
                yield bus
            finally:
                os.close(writing)
