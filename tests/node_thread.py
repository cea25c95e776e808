"""Robots in a thread of a test, on the bus inside this process."""

from __future__ import annotations

import os
import shlex
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import can
import pytest

from mcp_asdf_tools.cli.main import main
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
