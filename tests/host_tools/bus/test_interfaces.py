"""Malformed data on a bus is one invalid frame to its robots; every bus has a name."""

from __future__ import annotations

import json
import random
import shlex
import socket
import struct
import threading
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import can
import msgpack  # type: ignore[import-untyped]
import pytest

from mcp_asdf_tools.bus.frames import FrameFormat, Message, Rejection, decode, encode
from mcp_asdf_tools.bus.interfaces import BusChoice, WithoutEcho
from mcp_asdf_tools.cli.main import main
from mcp_asdf_tools.recording.frame_logs import read_log
from mcp_asdf_tools.robots.node import filters_for
from multicast import multicast
from robots import ALPHA_ONE

GROUP = 30


@contextmanager
def stranger(choice: BusChoice) -> Iterator[socket.socket]:
    """A program that can send any datagram to a group."""
    address = (str(choice.channel), 43200 + int(str(choice.channel).rpartition(".")[2]))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sending:
        sending.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, struct.pack("@I", 0))
        sending.connect(address)
        yield sending


def packed(**changes: Any) -> bytes:
    """A frame as python-can sends it, with some members changed."""
    frame = encode(Message(7, 1, ALPHA_ONE, 3), FrameFormat())
    names = "timestamp arbitration_id is_extended_id is_remote_frame is_error_frame channel dlc is_fd"
    plain = {name: getattr(frame, name) for name in names.split()} | {"data": bytes(frame.data)}
    return bytes(msgpack.packb({**plain, **changes}))


MALFORMED = [
    b"",
    b"\xc1",
    b"GET / HTTP/1.1\r\n\r\n",
    b"\x00" * 2000,
    msgpack.packb(5),
    msgpack.packb({}.fromkeys(["arbitration_id"])),
    packed(unknown=1),
    packed(dlc=9),
    packed(dlc=-1),
    packed(dlc=7.0, data=b"1234567"),
    packed(arbitration_id=2**29),
    packed(arbitration_id=1.5),
    packed(arbitration_id="7"),
    packed(data="text"),
    packed(data=None),
    packed()[:-3],
]


def test_a_malformed_datagram_is_one_damaged_frame() -> None:
    choice = multicast(GROUP)
    good = packed()
    with choice.open() as bus, stranger(choice) as sending:
        bus.set_filters(filters_for(FrameFormat()))
        for data in MALFORMED:
            sending.send(data)
            frame = bus.recv(2)
            assert frame is not None, data
            assert decode(frame, FrameFormat()) is Rejection.ERROR_FRAME, data
            sending.send(good)  # what follows is heard
            frame = bus.recv(2)
            assert frame is not None
            assert decode(frame, FrameFormat()) == Message(7, 1, ALPHA_ONE, 3)
        assert bus.recv(0) is None


@pytest.mark.parametrize("seed", range(3))
def test_no_datagram_breaks_the_bus(seed: int) -> None:
    choice, draw = multicast(GROUP), random.Random(seed)
    values = [None, True, -1, 2**63, 1e300, float("nan"), "x y", b"\xff" * 70, [1], {"a": 1}, 3]
    names = [
        "arbitration_id",
        "dlc",
        "data",
        "channel",
        "is_fd",
        "is_extended_id",
        "timestamp",
        "is_rx",
        "is_x",
    ]
    with choice.open() as bus, stranger(choice) as sending:
        for _ in range(200):
            spoiled = draw.sample(names, draw.randrange(1, 4))
            data = packed(**{name: draw.choice(values) for name in spoiled})
            sending.send(data[: draw.randrange(len(data))] if draw.random() < 0.2 else data)
            frame = bus.recv(2)
            if frame is not None:  # python-can leaves out some that it can read
                decode(frame, FrameFormat())
                assert frame.channel == choice.channel, f"replay: random.Random({seed})"


def test_robots_count_it_and_go_on(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A swarm, while a stranger sends what is no frame."""
    choice, log, done = multicast(GROUP), tmp_path / "run.log", threading.Event()

    def disturb() -> None:
        with stranger(choice) as sending:
            while not done.wait(0.002):
                sending.send(b"what is no frame")

    thread = threading.Thread(target=disturb)
    thread.start()
    try:
        options = f"swarm --robots 3 --steps 50 --json --log {log} {shlex.join(choice.arguments())}"
        assert main(shlex.split(options)) == 0
    finally:
        done.set()
        thread.join()
    results = json.loads(capsys.readouterr().out)["results"]
    assert results["steps"] == 50
    damaged = sum(frame.is_error_frame for frame in read_log(log))
    assert damaged > 0
    assert results["frames"]["errors_heard"] == 3 * damaged
    assert main(["replay", str(log)]) == 0
    channels = {line.split()[1] for line in log.read_text().splitlines()}
    assert channels == {choice.channel}


class Echoing(can.BusABC):
    """A connection to a bus of which everybody gets every frame, the sender too."""

    def __init__(self, everybody: list[Echoing]) -> None:
        super().__init__(channel="echo")
        self.channel_info = "echo"
        self._waiting: deque[can.Message] = deque()
        self.everybody = everybody
        everybody.append(self)

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        for each in self.everybody:
            each._waiting.append(msg)

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        return (self._waiting.popleft() if self._waiting else None), False

    def fileno(self) -> int:
        return 99


def test_no_node_hears_itself_on_a_bus_that_echoes() -> None:
    everybody: list[Echoing] = []
    connections = [WithoutEcho(Echoing(everybody)) for _ in range(3)]
    draw, heard, due = random.Random(2), [[], [], []], [[], [], []]  # type: ignore[var-annotated]
    for _ in range(2000):
        place = draw.randrange(3)
        if draw.random() < 0.5:
            # Contents come again and again, also from others at the same time.
            frame = can.Message(arbitration_id=draw.randrange(2), data=bytes([draw.randrange(2)]))
            connections[place].send(frame, timeout=1)
            for other in {0, 1, 2} - {place}:
                due[other].append((frame.arbitration_id, bytes(frame.data)))
        frame_or_none = connections[place].recv(0)
        if frame_or_none is not None:
            heard[place].append((frame_or_none.arbitration_id, bytes(frame_or_none.data)))
    for place, connection in enumerate(connections):
        heard[place] += [(f.arbitration_id, bytes(f.data)) for f in iter(lambda: connection.recv(0), None)]  # noqa: B023
        assert sorted(heard[place]) == sorted(due[place]), "replay: random.Random(2)"
        assert connection.fileno() == 99
        connection.shutdown()
