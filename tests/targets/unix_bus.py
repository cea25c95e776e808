"""A bus where the kernel has no CAN: a C node connects by a Unix socket that carries ``struct can_frame``."""

from __future__ import annotations

import socket
from contextlib import suppress
from pathlib import Path

import can
from can.interfaces.socketcan.socketcan import build_can_frame, dissect_can_frame

from support import PATIENCE

PACKET_ROOM = 128
"""The number of bytes that are read of a packet at most: more than any frame has."""


def unpack_frame(packet: bytes) -> can.Message:
    """Return the frame in a packet of a node; fails unless it is a classic data frame with 29 bits."""
    assert len(packet) == 16, "a struct can_frame; a frame of CAN FD is longer"
    identifier, length, _, data = dissect_can_frame(packet)
    assert identifier >> 29 == 0b100, "29 bits, no remote frame and no error frame"
    return can.Message(arbitration_id=identifier & 0x1FFF_FFFF, data=data[:length])


class UnixBus(can.BusABC):
    """A bus of python-can with one C node at a time at its other end.

    A node greets with its first heartbeat, which it repeats until it is commanded.

    Attributes:
        node: The socket of the present node.
        received_frames: Frames that it has sent, in order. Its greeting is there once.
        greeting_count: How often it has sent its greeting.
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

    def accept_node(self) -> None:
        """Wait until the next node connects; it is the present one then. Raises TimeoutError if none does."""
        self.node.close()
        self.node, _ = self._listener.accept()
        self.received_frames: list[can.Message] = []
        self.greeting_count = 0

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Send to the node."""
        self.node.settimeout(PATIENCE)
        with suppress(BrokenPipeError, ConnectionResetError):  # its last frames can still be received
            self.node.send(build_can_frame(msg))

    def receive_frames(self, count: int) -> None:
        """Wait for so many more frames."""
        expected_count = len(self.received_frames) + count
        while len(self.received_frames) < expected_count:
            assert self.recv(PATIENCE) is not None

    def receive_until_node_ends(self) -> None:
        """Receive frames until the node has ended."""
        with suppress(EOFError):
            while True:
                self.receive_frames(1)

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        """Return the next frame, a classic data frame with a 29-bit identifier; anything else fails.

        Raises EOFError once the node has ended.
        """
        self.node.settimeout(timeout)
        try:
            packet = self.node.recv(PACKET_ROOM)
        except (TimeoutError, BlockingIOError):
            return None, False
        except ConnectionResetError:  # it left frames of ours unread; its own last ones follow
            packet = self.node.recv(PACKET_ROOM)
        if not packet:
            raise EOFError
        frame = unpack_frame(packet)
        is_first = not self.received_frames
        is_repeated_greeting = len(self.received_frames) == 1 and frame.data == self.received_frames[0].data
        if is_first or is_repeated_greeting:
            self.greeting_count += 1
            self.received_frames.clear()
        self.received_frames.append(frame)
        return frame, False

    def shutdown(self) -> None:
        """Hang up."""
        self.node.close()
        self._listener.close()
        super().shutdown()
