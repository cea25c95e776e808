"""The slcan server: python-can's own client, and Cyphal's, reach a bus of this process."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from functools import partial
from typing import Any
from unittest.mock import Mock

import can
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from mcp_asdf_tools.bus.slcan_server import SlcanServer, format_frame_line, parse_frame
from mcp_asdf_tools.common.errors import UsageError
from support import PATIENCE, draws, wait_until

pytestmark = pytest.mark.random

CHANNEL = "slcan test"


def join_bus_of_server() -> can.BusABC:
    """Return a new connection to the bus that the server opens to other programs."""
    return can.Bus(interface="virtual", channel=CHANNEL, ignore_config=True)


@pytest.fixture
def server() -> Iterator[SlcanServer]:
    """A server at a free TCP port; it has ended when the test has."""
    with SlcanServer(join_bus_of_server()) as running:
        yield running
    assert not running._server_thread.is_alive()


FRAME_OF_ROBOT = can.Message(arbitration_id=0x106BB82A, data=bytes.fromhex("0000400000803fe0"))
FRAMES = [
    FRAME_OF_ROBOT,
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
    """The client is a program that uses the server as a serial adapter (slcan) to the bus."""
    with join_bus_of_server() as bus:
        bus.send(frame)
        received_frame = receive(client)
    assert fields_on_the_wire(received_frame) == fields_on_the_wire(frame)


@pytest.mark.parametrize("frame", FRAMES)
def test_the_bus_receives_a_frame_of_python_can_s_client(frame: can.Message, client: can.BusABC) -> None:
    """The client is a program that uses the server as a serial adapter (slcan) to the bus."""
    with join_bus_of_server() as bus:
        client.send(frame)
        received_frame = receive(bus)
    assert fields_on_the_wire(received_frame) == fields_on_the_wire(frame)


@pytest.mark.parametrize(
    "unsupported_frame",
    [can.Message(arbitration_id=1, is_fd=True, data=bytes(12)), can.Message(is_error_frame=True)],
)
def test_a_frame_of_can_fd_and_an_error_frame_are_not_forwarded(
    unsupported_frame: can.Message, client: can.BusABC
) -> None:
    """The lines of slcan have no form for them. The frame sent next is the first that the client receives."""
    next_frame = can.Message(arbitration_id=0x106BB82A, data=b"12345678")
    with join_bus_of_server() as bus:
        bus.send(unsupported_frame)
        bus.send(next_frame)
        received_frame = receive(client)
    assert fields_on_the_wire(received_frame) == fields_on_the_wire(next_frame)


def connect(server: SlcanServer) -> socket.socket:
    """Return a new connection to the server's port."""
    return socket.create_connection(("127.0.0.1", server.port), PATIENCE)


def answers_to(lines: bytes, server: SlcanServer) -> bytes:
    """Return all that the server answers to a program that sends these lines and is done."""
    with connect(server) as program:
        program.sendall(lines)
        program.shutdown(socket.SHUT_WR)
        return b"".join(iter(partial(program.recv, 100), b""))


ANSWER_OK, ANSWER_ERROR = b"\r", b"\a"
SENT_WITH_11_BITS, SENT_WITH_29_BITS = b"z\r", b"Z\r"
"""Answers to a line with a frame, by the length of the frame's identifier."""


@pytest.mark.parametrize(
    ("lines", "answers"),
    [
        (b"S8\rO\r", [ANSWER_OK, ANSWER_OK]),  # S8 is a bit rate
        (b"\rV\rN\rF\r", [ANSWER_OK, b"V1013\r", b"N0001\r", b"F00\r"]),  # version, serial number, flags
        (b"O\rT106BB82A0\rt7FF0\r", [ANSWER_OK, SENT_WITH_29_BITS, SENT_WITH_11_BITS]),
        (b"T106BB82A0\rO\r", [ANSWER_ERROR, ANSWER_OK]),  # the adapter is closed at first
        (b"O\rC\rt1230\r", [ANSWER_OK, ANSWER_OK, ANSWER_ERROR]),
        # No command, and frames with a wrong identifier, number of bytes or digit.
        (b"O\r?\rt12\rt8000\rT200000000\rt1239\rt1231\rt12310\rtxyz0\r", [ANSWER_OK, *8 * [ANSWER_ERROR]]),
        (b"O\r" + 33 * b"x", [ANSWER_OK, ANSWER_ERROR]),  # longer than any line
    ],
)
def test_each_line_has_its_answer_success_or_failure(
    server: SlcanServer, lines: bytes, answers: list[bytes]
) -> None:
    """A line is a command: O opens the adapter, C closes it, t and T send a frame with 11 or 29 bits.

    ``lines`` are those of a program, and ``answers`` has what the server answers to each of them.
    """
    assert answers_to(lines, server) == b"".join(answers)


def test_a_frame_that_the_bus_does_not_take_is_answered_with_a_failure(
    server: SlcanServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A program that was told of success would not send it again.

    The program opens the adapter (O), and then sends a frame without data under the identifier 123 (t1230).
    """
    raise_that_the_bus_is_full = Mock(side_effect=can.CanOperationError("the bus is full"))
    monkeypatch.setattr(server._bus, "send", raise_that_the_bus_is_full)
    assert answers_to(b"O\rt1230\r", server) == ANSWER_OK + ANSWER_ERROR


def test_a_second_program_finds_the_adapter_closed_as_the_first_did(server: SlcanServer) -> None:
    """Neither can send a frame (t1230) before it has opened the adapter (O)."""
    answers_to_first_program = answers_to(b"t1230\rO\rt1230\r", server)
    answers_to_second_program = answers_to(b"t1230\rO\rt1230\r", server)

    assert answers_to_first_program == ANSWER_ERROR + ANSWER_OK + SENT_WITH_11_BITS
    assert answers_to_second_program == answers_to_first_program


def test_a_server_that_closes_ends_its_thread_though_a_program_connects_just_then() -> None:
    """The server closes but still waits for programs, so it has to leave a program that connects now."""
    with SlcanServer(join_bus_of_server()) as server:
        server._is_closing = True  # the first thing that the server does at the end of the block
        with connect(server):
            server._server_thread.join(timeout=PATIENCE)
            assert not server._server_thread.is_alive()


@pytest.fixture
def slow_program(server: SlcanServer) -> Iterator[socket.socket]:
    """A program that has opened the adapter but reads nothing; there is room for few lines that wait."""
    with socket.socket() as program:
        program.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        program.connect(("127.0.0.1", server.port))
        program.sendall(b"O\r")
        wait_until(lambda: server._is_channel_open)
        yield program


def read_to_the_end(program: socket.socket) -> bytes:
    """Return all that a program receives until the server has ended."""
    return b"".join(iter(partial(program.recv, 1 << 20), b""))


def send_until_the_server_drops_frames(frame: can.Message, server: SlcanServer) -> None:
    """Send a frame on the bus, again and again, until the server has counted some that it has dropped."""

    def has_dropped_frames_after_a_thousand_more() -> bool:
        for _ in range(1000):
            bus.send(frame)
        return server.dropped > 0

    with join_bus_of_server() as bus:
        wait_until(has_dropped_frames_after_a_thousand_more)


def test_a_slow_program_loses_whole_frames_and_the_bus_goes_on(
    server: SlcanServer, slow_program: socket.socket
) -> None:
    """The program reads nothing at first, so the server drops and counts frames that find no room.

    What it reads later are complete lines: the answer to its opening of the adapter, and frames.
    """
    send_until_the_server_drops_frames(FRAME_OF_ROBOT, server)
    slow_program.shutdown(socket.SHUT_WR)  # by which the server notices that the program leaves
    text = read_to_the_end(slow_program)

    line_of_frame = format_frame_line(FRAME_OF_ROBOT)
    number_of_lines = text.count(line_of_frame)
    answer_to_opening = ANSWER_OK
    assert text == answer_to_opening + line_of_frame * number_of_lines


@settings(derandomize=True, max_examples=draws(300), deadline=None)
@given(st.binary(max_size=30) | st.from_regex(rb"[tTrR][0-9A-F]{3,12}\Z"))
@example(b"t+120")
@example(b"+1230")
@example(b"t 120")
@example(b"t1231 7 ")
def test_a_line_that_is_read_as_a_frame_is_what_the_server_writes_for_that_frame(line: bytes) -> None:
    """So nothing is read into a wrong line: for most of these random ones ``parse_frame`` returns None.

    Case matters in the first letter, but not in digits, of which the server writes large ones.
    """
    frame = parse_frame(line)
    if frame is not None:
        command = line[:1]
        digits = line[1:]
        assert format_frame_line(frame) == command + digits.upper() + b"\r"


def test_a_port_that_is_in_use_is_refused_by_name_and_the_bus_is_closed(server: SlcanServer) -> None:
    """A second server cannot listen at the port of the first one. It owns the connection that it is given."""
    bus = join_bus_of_server()
    with pytest.raises(UsageError, match=f"cannot serve slcan at port {server.port}: .*another port"):
        SlcanServer(bus, server.port)
    assert bus._is_shutdown


@pytest.mark.parametrize("port", [-1, 65536])
def test_a_number_that_is_no_port_is_refused(port: int) -> None:
    """TCP has ports up to 65535."""
    with pytest.raises(UsageError, match=f"slcan port is {port}; it must be 1 to 65535"):
        SlcanServer(join_bus_of_server(), port)
