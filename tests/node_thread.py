"""Robots in a thread of a test, on the bus inside this process: by commands, or by a clock of their own."""

from __future__ import annotations

import os
import shlex
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

import can
import pytest

from mcp_asdf.robot import Observation
from mcp_asdf_tools.bus.frames import FrameFormat
from mcp_asdf_tools.cli.main import main
from mcp_asdf_tools.robots.bus_robot import BusRobot
from mcp_asdf_tools.robots.clock import RealTimeClock
from mcp_asdf_tools.robots.node import BusLink, Stopped
from mcp_asdf_tools.robots.record import RobotRecord
from support import PATIENCE


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


def live(robot: BusRobot, link: BusLink, rate: float, heard: Callable[[can.Message], None]) -> None:
    """Let a robot take ``rate`` ticks a second until its link is asked to stop; it sees white and black."""

    def listen(seconds: float) -> None:
        frame = link.receive(seconds)
        if frame is not None:
            heard(frame)
            robot.listen([frame])

    clock = RealTimeClock(rate, sleep=listen)
    with suppress(Stopped):
        while True:
            clock.begin(robot.ticks)
            link.catch_up(lambda frame: robot.listen([frame]))
            if robot.ticks:
                robot.end()
            for frame in [robot.heartbeat(0), *robot.broadcast(Observation(robot.ticks % 2), 0)]:
                link.send(frame)


@contextmanager
def live_robot(record: RobotRecord, rate: float) -> Iterator[list[can.Message]]:
    """A robot with a clock of its own, up before the block begins; yields the frames that it hears."""
    frames: list[can.Message] = []
    is_over = threading.Event()
    with join() as bus, join() as own:
        link = BusLink(own, is_over.is_set)
        robot = BusRobot(record, FrameFormat())
        with meanwhile(lambda: live(robot, link, rate, frames.append)):
            try:
                assert bus.recv(PATIENCE) is not None
                yield frames
            finally:
                is_over.set()


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
