"""A bus served as an slcan adapter (Lawicel's text protocol) on a TCP port.

python-can opens it as ``interface=slcan, channel=socket://HOST:PORT``, and with it every tool that is built
on python-can, such as Cyphal's ``yakut``: so such tools can join a bus that exists only inside this process.
"""

from __future__ import annotations

import select
import socket
import threading
from collections.abc import Iterator
from contextlib import suppress

import can

from mcp_asdf_tools.common.errors import UsageError

HOST = "127.0.0.1"
"""Only programs on this machine can connect, as the protocol asks nobody who they are."""

MAX_PORT = 65535
"""Largest number of a TCP port."""

_OK, _ERROR = b"\r", b"\a"
_MAX_LINE_BYTES = 32
"""No legal line is longer: the line of a frame with 8 bytes and a 29-bit identifier has 26."""
_MAX_BYTES_AT_ONCE = 4096
"""Bytes of lines that are read from a client at once."""
_SEND_TIMEOUT = 1.0
"""Longest time to wait for room on the bus, in seconds."""
_SEND_BUFFER_BYTES = 1 << 16
# Bit rate, time stamps, filters, polling: an adapter accepts them, but they mean nothing on this bus.
_IGNORED_COMMANDS = b"SsYZMmXWA"
# Versions of hardware and firmware, serial number, and status flags, none of which is set.
_ANSWERS = {b"V": b"V1013\r", b"v": b"v0100\r", b"N": b"N0001\r", b"F": b"F00\r"}


class SlcanServer:
    """An slcan adapter for one client at a time. A context manager: leaving it closes port and bus.

    It passes on classic frames only, no CAN FD and no error frames.

    Attributes:
        port: The TCP port it listens at.
        dropped: Number of frames that the client was too slow to take.
    """

    def __init__(self, bus: can.BusABC, port: int = 0) -> None:
        """Listen at ``port`` of this machine, 1 .. 65535, or at a free one if 0.

        ``bus`` is a connection for the server alone, which closes it. Raises UsageError if the port is not
        available.
        """
        self.dropped = 0
        self._bus = bus
        self._client: socket.socket | None = None
        self._is_channel_open = False
        self._is_closing = False
        self._write_lock = threading.Lock()
        # The server owns its connection to the bus, also if it cannot start.
        try:
            self._listener = _listen_at(port)
        except UsageError:
            bus.shutdown()
            raise
        # If ``port`` is 0, the system has chosen a free one.
        self.port: int = self._listener.getsockname()[1]
        # The threads start last, as they use all that is set above. The notifier ends within its timeout.
        self._notifier = can.Notifier(bus, [self._forward_to_client], timeout=0.1)
        self._server_thread = threading.Thread(target=self._serve_clients, daemon=True)
        self._server_thread.start()

    def __enter__(self) -> SlcanServer:
        """Return the server, which has served clients since it was made."""
        return self

    def __exit__(self, *_: object) -> None:
        """Disconnect the client, wait until both threads have ended, and close the port and the bus."""
        self._is_closing = True
        # A thread that blocks in accept() or recv() returns once its socket is shut down.
        for blocking_socket in (self._listener, self._client):
            if blocking_socket is not None:
                with suppress(OSError):  # it may be closed, or not connected, by now
                    blocking_socket.shutdown(socket.SHUT_RDWR)
        self._listener.close()
        self._server_thread.join()
        self._notifier.stop()
        self._bus.shutdown()

    def _serve_clients(self) -> None:
        """Serve one client after the other, until the server is closing."""
        with suppress(OSError):  # accept() fails once the listener is closed
            while not self._is_closing:
                client, _ = self._listener.accept()
                with client, suppress(ConnectionError):
                    self._serve_client(client)
                self._is_channel_open = False
                self._client = None

    def _serve_client(self, client: socket.socket) -> None:
        """Answer each line of a client until it leaves, while frames of the bus are forwarded to it.

        Returns at once if the server is closing. Raises ConnectionError if the connection breaks.
        """
        client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, True)
        client.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SEND_BUFFER_BYTES)
        self._client = client
        # ``__exit__`` may have missed this client, whose socket was not known to it yet.
        if self._is_closing:
            return
        for line in _read_lines(client):
            # The notifier writes frames to the same client: an answer must not cut one of these lines in two.
            answer = self._handle_line(line)
            with self._write_lock:
                client.sendall(answer)

    def _handle_line(self, line: bytes) -> bytes:
        """Obey a client's command, a line without its carriage return, and return the answer.

        The commands open and close the channel, send a frame, and ask for versions. An empty line, and a
        command that means nothing on this bus, are accepted. The answer to a command that is unknown, broken
        or too early is an error.
        """
        command = line[:1]  # empty for an empty line, which has no first byte
        if command in (b"O", b"L", b"C"):  # open, open to listen only, close
            self._is_channel_open = command != b"C"
            return _OK
        if command in (b"t", b"T", b"r", b"R"):  # a data frame or a remote frame to send
            frame = parse_frame(line)
            if frame is None or not self._is_channel_open:
                return _ERROR
            return self._send_on_bus(frame)
        if command in _ANSWERS:
            return _ANSWERS[command]
        is_empty = line == b""
        if is_empty or command in _IGNORED_COMMANDS:
            return _OK
        return _ERROR

    def _send_on_bus(self, frame: can.Message) -> bytes:
        """Send a frame of the client on the bus, and return the protocol's answer.

        That is ``Z`` for a sent frame with a 29-bit identifier and ``z`` for one with 11 bits, each with a
        carriage return; or the error answer, a bell character, if the bus has not taken the frame.
        """
        try:
            self._bus.send(frame, timeout=_SEND_TIMEOUT)
        except can.CanError:
            return _ERROR
        return b"Z\r" if frame.is_extended_id else b"z\r"

    def _forward_to_client(self, frame: can.Message) -> None:
        """Write a frame of the bus to the client, or drop and count it if the client is too slow.

        CAN FD and error frames are left out and not counted, and so are all frames while there is no client
        or its channel is closed.
        """
        client = self._client
        if client is None or not self._is_channel_open or frame.is_fd or frame.is_error_frame:
            return
        with self._write_lock, suppress(OSError, ValueError):  # the client may have left by now
            # A socket that is writable has room for a short line, so that no line is cut in two.
            _, writable, _ = select.select([], [client], [], 0)
            if writable:
                client.sendall(format_frame_line(frame))
            else:
                self.dropped += 1


def _listen_at(port: int) -> socket.socket:
    """Return a socket that listens at a port of this machine. Raises UsageError if that is impossible."""
    if not 0 <= port <= MAX_PORT:
        raise UsageError(f"slcan port is {port}; it must be 1 to {MAX_PORT}, or 0 for a free one")
    try:
        return socket.create_server((HOST, port))
    except OSError as error:
        raise UsageError(f"cannot serve slcan at port {port}: {error}; choose another port") from error


def format_frame_line(frame: can.Message) -> bytes:
    """Return the slcan line of a classic frame, such as ``t1232AABB`` and its end, a carriage return.

    That is the command, the identifier, the number of bytes and the data, all in hexadecimal digits.
    """
    command = "r" if frame.is_remote_frame else "t"
    identifier = f"{frame.arbitration_id:03X}"
    if frame.is_extended_id:
        # A capital letter announces an identifier of 29 bits.
        command = command.upper()
        identifier = f"{frame.arbitration_id:08X}"
    data = "" if frame.is_remote_frame else frame.data.hex().upper()
    return f"{command}{identifier}{frame.dlc}{data}\r".encode()


def parse_frame(line: bytes) -> can.Message | None:
    """Return the frame of an slcan line without its end, or None if the line is malformed.

    A line with another number of bytes than it states is malformed, and so is a remote frame with data.
    """
    if not line.isalnum():  # int() and fromhex() would accept white space and signs
        return None
    command = line[:1]
    is_extended = command.isupper()
    is_remote = command in (b"r", b"R")
    id_digits = 8 if is_extended else 3
    # Behind the command's letter stands the identifier, and behind that one digit, the number of bytes.
    length_index = 1 + id_digits
    data_digits = line[length_index + 1 :].decode("ascii", errors="replace")
    if is_remote and data_digits:  # python-can would drop the data of a remote frame without a word
        return None
    try:
        return can.Message(
            arbitration_id=int(line[1:length_index], 16),
            is_extended_id=is_extended,
            is_remote_frame=is_remote,
            dlc=int(line[length_index : length_index + 1]),
            data=bytes.fromhex(data_digits),
            check=True,
        )
    except ValueError:
        return None


def _read_lines(client: socket.socket) -> Iterator[bytes]:
    """Yield the client's lines without their ends, until it leaves.

    A line that grows beyond all bounds is dropped and yields ``b"?"``, which is no command.
    """
    unfinished_line = b""
    # The client has left once recv() returns no bytes.
    while received_bytes := client.recv(_MAX_BYTES_AT_ONCE):
        # What follows the last end of a line is the beginning of the next one.
        *lines, unfinished_line = (unfinished_line + received_bytes).split(b"\r")
        yield from lines
        if len(unfinished_line) > _MAX_LINE_BYTES:
            yield b"?"
            unfinished_line = b""
