"""A serial adapter of tests: a TCP port that sends lines of slcan, damaged ones among them, and closes."""

from __future__ import annotations

import socket
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress

from mcp_asdf_tools.bus.interfaces import BusChoice

GOOD_LINE = b"T106BB80180000400000803FE0\r"
"""An estimate of robot 1."""

DAMAGED_LINES = (
    *(b"T106BB8\r", b"TZZ\r", b"t\r", b"\xff\r", b"T106BB8018000040000080ZZE0\r", b"T106BB80180000\r"),
    *(b"TFFFFFFFF0\r", b"T-00000010\r", b"tFFF0\r", b"r1239\r", b"t1239112233445566778899\r", b"dZZZ0\r"),
)
"""Lines of which python-can makes an exception, or a frame that no CAN controller sends."""


@contextmanager
def serial_adapter(lines: Sequence[bytes], stays_open: bool = True) -> Iterator[BusChoice]:
    """Send ``lines`` to the first program that connects; yields the bus that it has to join.

    The connection is closed afterwards, at once or when the block is left.
    """
    may_close = threading.Event()
    if not stays_open:
        may_close.set()

    def serve() -> None:
        with suppress(OSError):  # nobody has come, or the program has left
            connection, _ = listener.accept()
            with connection:
                connection.recv(2)  # the command that opens the channel
                connection.sendall(b"".join(lines))
                may_close.wait()

    with socket.create_server(("127.0.0.1", 0)) as listener:
        thread = threading.Thread(target=serve)
        thread.start()
        try:
            channel = f"socket://127.0.0.1:{listener.getsockname()[1]}"
            settings = {"channel": channel, "sleep_after_open": 0, "ignore_config": True}
            yield BusChoice("slcan", settings)
        finally:
            may_close.set()
            listener.shutdown(socket.SHUT_RDWR)
            thread.join()
