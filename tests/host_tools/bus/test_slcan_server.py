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


def fields_on_the_wire(frame: can.Message) -> tuple[Any, ...]:
    """Return what slcan carries of a frame."""
    flags = (frame.is_extended_id, frame.is_remote_frame, frame.is_fd, frame.is_error_frame)
    return (frame.arbitration_id, *flags, frame.dlc, bytes(frame.data))


def receive(bus: can.BusABC) -> can.Message:
    """Return the next frame. python-can's slcan ends a wait early when the adapter answers."""
    for _ in range(int(PATIENCE * 10)):
        frame = bus.recv(0.1)
        if frame is not None:
            return frame
    raise AssertionError("no frame came")


@pytest.fixture
def client(server: SlcanServer) -> Iterator[can.BusABC]:
    """python-can's own client of the server."""
    pytest.importorskip("serial", reason="pyserial, which python-can's slcan needs, is not installed")
    channel = f"socket://127.0.0.1:{server.port}"
    with can.Bus(interface="slcan", channel=channel, sleep_after_open=0, ignore_config=True) as program:
        wait_until(lambda: server._is_channel_open)
        yield program


@pytest.mark.parametrize("frame", FRAMES)
def test_python_can_s_client_receives_a_frame_of_the_bus(frame: can.Message, client: can.BusABC) -> None:
    with join() as bus:
        bus.send(frame)
        assert fields_on_the_wire(receive(client)) == fields_on_the_wire(frame)


@pytest.mark.parametrize("frame", FRAMES)
def test_the_bus_receives_a_frame_of_python_can_s_client(frame: can.Message, client: can.BusABC) -> None:
    with join() as bus:
        client.send(frame)
        assert fields_on_the_wire(receive(bus)) == fields_on_the_wire(frame)


@pytest.mark.parametrize(
    "frame", [can.Message(arbitration_id=1, is_fd=True, data=bytes(12)), can.Message(is_error_frame=True)]
)
def test_frames_that_slcan_does_not_have_stay_on_the_bus(frame: can.Message, client: can.BusABC) -> None:
    """The next frame is the first that the client receives."""
    with join() as bus:
        bus.send(frame)
        bus.send(FRAMES[0])
        assert fields_on_the_wire(receive(client)) == fields_on_the_wire(FRAMES[0])


def connect(server: SlcanServer) -> socket.socket:
    return socket.create_connection(("127.0.0.1", server.port), PATIENCE)


def answers_to(lines: bytes, server: SlcanServer) -> bytes:
    """Return all that the server answers to a program that sends these lines and is done."""
    with connect(server) as program:
        program.sendall(lines)
        program.shutdown(socket.SHUT_WR)
        return b"".join(iter(partial(program.recv, 100), b""))


@pytest.mark.parametrize(
    ("lines", "answers"),
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
def test_each_line_has_its_answer_success_or_failure(
    server: SlcanServer, lines: bytes, answers: bytes
) -> None:
    assert answers_to(lines, server) == answers


def test_a_second_program_finds_the_adapter_as_the_first_did(server: SlcanServer) -> None:
    for _ in range(2):
        assert answers_to(b"t1230\rO\rt1230\r", server) == b"\a\r" + b"z\r"


def test_a_program_that_connects_while_the_server_closes_does_not_keep_it_open() -> None:
    with SlcanServer(join()) as server:
        server._is_closing = True
        with connect(server):
            server._server_thread.join(PATIENCE)
            assert not server._server_thread.is_alive()


def test_a_slow_program_loses_whole_frames_and_the_bus_goes_on(server: SlcanServer) -> None:
    with join() as bus, socket.socket() as program:
        program.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        program.connect(("127.0.0.1", server.port))
        program.sendall(b"O\r")
        wait_until(lambda: server._is_channel_open)

        def has_dropped_frames() -> bool:
            for _ in range(1000):
                bus.send(FRAMES[0])
            return server.dropped > 0

        wait_until(has_dropped_frames)
        program.settimeout(0.5)
        text = b""
        with suppress(TimeoutError):
            while True:
                text += program.recv(1 << 20)
    lines = set(text.removeprefix(b"\r").split(b"\r"))
    assert lines == {format_frame_line(FRAMES[0]).removesuffix(b"\r"), b""}


@settings(derandomize=True, max_examples=draws(300), deadline=None)
@given(st.binary(max_size=30) | st.from_regex(rb"[tTrR][0-9A-F]{3,12}\Z"))
@example(b"t+120")
@example(b"+1230")
@example(b"t 120")
@example(b"t1231 7 ")
def test_any_line_is_a_frame_or_none(line: bytes) -> None:
    """A line that is read as a frame is what the server would write for it; all others are refused."""
    frame = parse_frame(line)
    if frame is not None:
        assert format_frame_line(frame)[:-1] == line[:1] + line[1:].upper()


def test_a_port_that_is_in_use_is_refused_by_name(server: SlcanServer) -> None:
    with pytest.raises(UsageError, match=f"cannot serve slcan at port {server.port}: .*another port"):
        SlcanServer(join(), server.port)


def test_a_server_that_cannot_listen_closes_its_bus(server: SlcanServer) -> None:
    bus = join()
    with pytest.raises(UsageError):
        SlcanServer(bus, server.port)
    assert bus._is_shutdown


@pytest.mark.parametrize("port", [-1, 65536])
def test_a_number_that_is_no_port_is_refused(port: int) -> None:
    with pytest.raises(UsageError, match=f"slcan port is {port}; it must be 1 to 65535"):
        SlcanServer(join(), port)
