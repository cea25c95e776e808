"""The slcan server: python-can's own client, and Cyphal's, reach a bus of this process."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from contextlib import suppress
from functools import partial
from typing import Any

import can
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from mcp_asdf_tools.bus.slcan_server import SlcanServer, format_frame_line, parse_frame
from mcp_asdf_tools.common.errors import UsageError
from support import PATIENCE, draws, wait_until

pytestmark = pytest.mark.random

CHANNEL = "slcan test"


def join() -> can.BusABC:
    return can.Bus(interface="virtual", channel=CHANNEL, ignore_config=True)


@pytest.fixture
def server() -> Iterator[SlcanServer]:
    with SlcanServer(join()) as running:
        yield running
    assert not running._server_thread.is_alive()


FRAMES = [
    can.Message(arbitration_id=0x106BB82A, data=bytes.fromhex("0000400000803fe0")),
    can.Message(arbitration_id=0x1FFFFFFF, data=b""),
    can.Message(arbitration_id=0x7FF, is_extended_id=False, data=b"\r\a\0"),
    can.Message(arbitration_id=0, is_extended_id=False, data=b"12345678"),
    can.Message(arbitration_id=0x123, is_remote_frame=True, dlc=8),
    can.Message(arbitration_id=0x123, is_extended_id=False, is_remote_frame=True, dlc=0),
]


def essence(frame: can.Message) -> tuple[Any, ...]:
    flags = (frame.is_extended_id, frame.is_remote_frame, frame.is_fd, frame.is_error_frame)
    return (frame.arbitration_id, *flags, frame.dlc, bytes(frame.data))


def received(bus: can.BusABC) -> can.Message:
    """The next frame; python-can's slcan ends a wait early on an answer of the adapter."""
    return next(frame for _ in range(int(PATIENCE * 10)) if (frame := bus.recv(0.1)) is not None)


def test_python_can_s_client_reads_and_writes(server: SlcanServer) -> None:
    pytest.importorskip("serial", reason="pyserial, which python-can's slcan needs, is not installed")
    where = f"socket://127.0.0.1:{server.port}"
    client = can.Bus(interface="slcan", channel=where, sleep_after_open=0, ignore_config=True)
    with join() as bus, client as program:
        wait_until(lambda: server._is_channel_open)
        bus.send(can.Message(arbitration_id=1, is_fd=True, data=bytes(12)))  # stays where it is
        bus.send(can.Message(is_error_frame=True))
        for frame in FRAMES:
            bus.send(frame)
            assert essence(received(program)) == essence(frame)
            program.send(frame)
            assert essence(received(bus)) == essence(frame)
    assert server.dropped == 0


def raw(server: SlcanServer) -> socket.socket:
    return socket.create_connection(("127.0.0.1", server.port), PATIENCE)


@pytest.mark.parametrize(
    ("asked", "answer"),
    [
        (b"S8\rO\r", b"\r\r"),
        (b"\rV\rN\rF\r", b"\rV1013\rN0001\rF00\r"),
        (b"O\rT106BB82A0\rt7FF0\r", b"\rZ\rz\r"),
        (b"T106BB82A0\rO\r", b"\a\r"),  # the adapter is closed at first
        (b"O\rC\rt1230\r", b"\r\r\a"),
        (b"O\r?\rt12\rt8000\rT200000000\rt1239\rt1231\rt12310\rtxyz0\r", b"\r" + 8 * b"\a"),
        (b"O\r" + 33 * b"x", b"\r\a"),
    ],
)
def test_every_line_has_its_answer(server: SlcanServer, asked: bytes, answer: bytes) -> None:
    for _ in range(2):  # also for the next program
        with raw(server) as program:
            program.sendall(asked)
            program.shutdown(socket.SHUT_WR)
            assert b"".join(iter(partial(program.recv, 100), b"")) == answer


def test_a_program_that_comes_while_the_server_closes_does_not_keep_it() -> None:
    with SlcanServer(join()) as server:
        server._is_closing = True
        with raw(server):
            server._server_thread.join(PATIENCE)
            assert not server._server_thread.is_alive()


def test_a_slow_program_loses_whole_frames_and_stops_no_other(server: SlcanServer) -> None:
    with join() as bus, socket.socket() as program:
        program.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        program.connect(("127.0.0.1", server.port))
        program.sendall(b"O\r")
        wait_until(lambda: server._is_channel_open)

        def flood() -> bool:
            for _ in range(1000):
                bus.send(FRAMES[0])
            return server.dropped > 0

        wait_until(flood)
        program.settimeout(0.5)
        text = b""
        with suppress(TimeoutError):
            while True:
                text += program.recv(1 << 20)
    assert server.dropped > 0
    assert set(text.removeprefix(b"\r").split(b"\r")) == {format_frame_line(FRAMES[0])[:-1], b""}


@settings(derandomize=True, max_examples=draws(300), deadline=None)
@given(st.binary(max_size=30) | st.from_regex(rb"[tTrR][0-9A-F]{3,12}\Z"))
@example(b"t+120")
@example(b"+1230")
@example(b"t 120")
@example(b"t1231 7 ")
def test_any_line_is_a_frame_or_none(line: bytes) -> None:
    frame = parse_frame(line)
    if frame is not None:
        assert format_frame_line(frame)[:-1] == line[:1] + line[1:].upper()


def test_a_taken_port_is_named(server: SlcanServer) -> None:
    refused = join()
    with pytest.raises(UsageError, match=f"cannot serve slcan at port {server.port}: .*another port"):
        SlcanServer(refused, server.port)
    assert refused._is_shutdown, "a refused server left its bus open"
    for port in (-1, 65536):
        with pytest.raises(UsageError, match=f"slcan port is {port}; it must be 1 to 65535"):
            SlcanServer(join(), port)
