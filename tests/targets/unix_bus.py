"""A bus where the kernel has no CAN: a C node connects by a Unix socket that carries ``struct can_frame``."""

from __future__ import annotations

import socket
from contextlib import suppress
from pathlib import Path

import can
from can.interfaces.socketcan.socketcan import build_can_frame, dissect_can_frame

from support import PATIENCE


class UnixBus(can.BusABC):
    """The owner's end, a bus like any other of python-can, with one node at a time at the other.

    Attributes:
        node: The socket of the present node.
        said: Frames that it sent, in order, but its greeting once.
        greetings: How often it sent that.
    """

    def __init__(self, path: Path) -> None:
        """Listen at ``path``."""
        self._listener = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._listener.bind(str(path))
        self._listener.listen()
        self._listener.settimeout(PATIENCE)
        self.node = socket.socket()
        self.channel_info = f"unix:{path}"
        super().__init__(channel=self.channel_info)

    def accept(self) -> None:
        """Take the next node that connects for the present one. Raises TimeoutError if none does."""
        self.node.close()
        self.node, self.said = self._listener.accept()[0], list[can.Message]()
        self.greetings = 0

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Send to the node."""
        self.node.settimeout(PATIENCE)
        with suppress(BrokenPipeError, ConnectionResetError):  # what it said is still to come
            self.node.send(build_can_frame(msg))

    def hear(self, frames: int) -> None:
        """Listen to so many more frames."""
        end = len(self.said) + frames
        while len(self.said) < end:
            assert self.recv(PATIENCE) is not None

    def hear_out(self) -> None:
        """Listen until the node has ended."""
        with suppress(EOFError):
            while True:
                self.hear(1)

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        """The next frame, a classic data frame with a 29-bit identifier; anything else fails.

        Raises EOFError once the node has ended.
        """
        self.node.settimeout(timeout)
        try:
            packet = self.node.recv(128)
        except (TimeoutError, BlockingIOError):
            return None, False
        except ConnectionResetError:  # it left frames of ours unread; its own last ones follow
            packet = self.node.recv(128)
        if not packet:
            raise EOFError
        assert len(packet) == 16
        identifier, length, _, data = dissect_can_frame(packet)
        assert identifier >> 29 == 0b100
        frame = can.Message(arbitration_id=identifier & 0x1FFF_FFFF, data=data[:length])
        if not self.said or (frame.data == self.said[0].data and len(self.said) == 1):
            self.greetings += 1
            self.said.clear()
        self.said.append(frame)
        return frame, False

    def shutdown(self) -> None:
        """Hang up."""
        self.node.close()
        self._listener.close()
        super().shutdown()
