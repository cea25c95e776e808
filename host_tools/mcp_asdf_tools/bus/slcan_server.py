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

_OK, _ERROR = b"\r", b"\a"
_LONGEST_LINE = 32
_TIMEOUT = 1.0
_BUFFER_BYTES = 1 << 16
# Bit rate, time stamps, filters, polling: accepted, without effect here.
_SETTINGS = b"SsYZMmXWA"
_ANSWERS = {b"V": b"V1013\r", b"v": b"v0100\r", b"N": b"N0001\r", b"F": b"F00\r"}


class SlcanServer:
    """An adapter for one program at a time. A context manager: leaving it closes port and bus.

    Classic frames only: FD and error frames are not passed on.

    Attributes:
        port: The TCP port it listens at.
        dropped: Frames that the program was too slow to take.
    """

    def __init__(self, bus: can.BusABC, port: int = 0) -> None:
        """Listen at ``port`` of this machine, 1 .. 65535, or at a free one if 0.

        ``bus`` is a connection of the server's own. Raises UsageError if the port is not available.
        """
        self.dropped = 0
        self._bus = bus
        self._program: socket.socket | None = None
        self._is_open = self._is_closing = False
        self._writing = threading.Lock()
        try:
            self._listener = _listener_at(port)
        except UsageError:
            bus.shutdown()
            raise
        self.port: int = self._listener.getsockname()[1]
        self._notifier = can.Notifier(bus, [self._pass_on], timeout=0.1)
        self._server = threading.Thread(target=self._serve, daemon=True)
        self._server.start()

    def __enter__(self) -> SlcanServer:
        return self

    def __exit__(self, *_: object) -> None:
        self._is_closing = True
        for end in (self._listener, self._program):
            if end is not None:
                with suppress(OSError):  # it may be closed, or not connected, by now
                    end.shutdown(socket.SHUT_RDWR)
        self._listener.close()
        self._server.join()
        self._notifier.stop()
        self._bus.shutdown()

    def _serve(self) -> None:
        with suppress(OSError):  # the listener was closed
            while True:
                program, _ = self._listener.accept()
                with program, suppress(ConnectionError):
                    program.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, True)
                    program.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _BUFFER_BYTES)
                    self._program = program
                    if self._is_closing:
                        return
                    self._talk(program)
                self._is_open, self._program = False, None

    def _talk(self, program: socket.socket) -> None:
        for line in _lines(program):
            answer = self._obey(line)
            with self._writing:
                program.sendall(answer)

    def _obey(self, line: bytes) -> bytes:
        """Do what a line asks for; returns the answer."""
        command = line[:1]
        if command in (b"O", b"L", b"C"):
            self._is_open = command != b"C"
            return _OK
        if command in (b"t", b"T", b"r", b"R"):
            frame = frame_of(line)
            return _ERROR if frame is None or not self._is_open else self._send(frame)
        return _ANSWERS.get(command, _OK if command in _SETTINGS or not line else _ERROR)

    def _send(self, frame: can.Message) -> bytes:
        try:
            self._bus.send(frame, timeout=_TIMEOUT)
        except can.CanError:
            return _ERROR
        return b"Z\r" if frame.is_extended_id else b"z\r"

    def _pass_on(self, frame: can.Message) -> None:
        program = self._program
        if program is None or not self._is_open or frame.is_fd or frame.is_error_frame:
            return
        # A writable socket has room for a short line: a slow program loses whole frames only.
        with self._writing, suppress(OSError, ValueError):  # the program may have left by now
            if select.select([], [program], [], 0)[1]:
                program.sendall(line_of(frame))
            else:
                self.dropped += 1


def _listener_at(port: int) -> socket.socket:
    if not 0 <= port <= 65535:
        raise UsageError(f"slcan port is {port}; it must be 1 to 65535, or 0 for a free one")
    try:
        return socket.create_server((HOST, port))
    except OSError as error:
        raise UsageError(f"cannot serve slcan at port {port}: {error}; choose another port") from error


def line_of(frame: can.Message) -> bytes:
    """A classic frame as a line."""
    kind = "r" if frame.is_remote_frame else "t"
    identifier = f"{frame.arbitration_id:03X}"
    if frame.is_extended_id:
        kind, identifier = kind.upper(), f"{frame.arbitration_id:08X}"
    data = "" if frame.is_remote_frame else frame.data.hex().upper()
    return f"{kind}{identifier}{frame.dlc}{data}\r".encode()


def frame_of(line: bytes) -> can.Message | None:
    """The frame of a line without its end; None if the line is malformed."""
    kind, digits = line[:1], 8 if line[:1].isupper() else 3
    if not line.isalnum():  # int() and fromhex() would take white space and signs
        return None
    try:
        identifier, length = int(line[1 : 1 + digits], 16), int(line[1 + digits : 2 + digits])
        data = bytes.fromhex(line[2 + digits :].decode("ascii"))
        return can.Message(
            arbitration_id=identifier,
            is_extended_id=digits == 8,
            is_remote_frame=kind in (b"r", b"R"),
            dlc=length,
            data=data,
            check=True,
        )
    except ValueError:
        return None


def _lines(program: socket.socket) -> Iterator[bytes]:
    """Lines without their ends, until the program leaves; an endless one counts as malformed."""
    rest = b""
    while received := program.recv(4096):
        *lines, rest = (rest + received).split(b"\r")
        yield from lines
        if len(rest) > _LONGEST_LINE:
            yield b"?"
            rest = b""
