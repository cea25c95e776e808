"""A bus where the kernel has no CAN: C nodes connect by Unix sockets that carry ``struct can_frame``."""

from __future__ import annotations

import select
import socket
import struct
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

import can

from support import PATIENCE

_EXTENDED, _REMOTE, _ERROR = 0x8000_0000, 0x4000_0000, 0x2000_0000
_CLASSIC, _FD = struct.Struct("=IB3x8s"), struct.Struct("=IB3x64s")


def pack(frame: can.Message) -> bytes:
    """The kernel's ``struct can_frame``, or ``struct canfd_frame`` for an FD frame."""
    flags = _EXTENDED * frame.is_extended_id | _REMOTE * frame.is_remote_frame | _ERROR * frame.is_error_frame
    layout = _FD if frame.is_fd else _CLASSIC
    return layout.pack(frame.arbitration_id | flags, frame.dlc, bytes(frame.data))


def unpack(packet: bytes) -> can.Message:
    """The frame in a packet of the kernel's layout."""
    layout = _FD if len(packet) == _FD.size else _CLASSIC
    identifier, length, data = layout.unpack(packet)
    return can.Message(
        arbitration_id=identifier & (0x1FFF_FFFF if identifier & _EXTENDED else 0x7FF),
        is_extended_id=bool(identifier & _EXTENDED),
        is_remote_frame=bool(identifier & _REMOTE),
        is_error_frame=bool(identifier & _ERROR),
        is_fd=layout is _FD,
        dlc=length,
        data=None if identifier & _REMOTE else data[:length],
    )


class Peer:
    """One node's end.

    Attributes:
        told: Frames that it was sent, in order.
        said: Frames that it sent, in order.
        is_gone: Whether it has closed its socket.
    """

    def __init__(self, connection: socket.socket) -> None:
        self.connection = connection
        self.told: list[can.Message] = []
        self.said: list[can.Message] = []
        self.is_gone = False

    def tell(self, frame: can.Message) -> None:
        """Send it a frame."""
        with suppress(BrokenPipeError, ConnectionResetError):  # it has ended; what it said is still to come
            self.connection.send(pack(frame))
            self.told.append(frame)


class UnixBus(can.BusABC):
    """The owner's end, a bus like any other of python-can's: what one node sends goes to all others.

    Frames are passed on while the owner receives.
    """

    def __init__(self, path: Path, **_: Any) -> None:
        """Listen at ``path``."""
        self.peers: list[Peer] = []
        self._listener = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._listener.bind(str(path))
        self._listener.listen(128)
        self.channel_info = f"unix:{path}"
        super().__init__(channel=self.channel_info)

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Send to all nodes."""
        for peer in self.peers:
            peer.tell(msg)

    def accept(self, seconds: float = PATIENCE) -> Peer:
        """The next node that connects. Raises TimeoutError if none does."""
        self._listener.settimeout(seconds)
        connection, _ = self._listener.accept()
        self.peers.append(Peer(connection))
        return self.peers[-1]

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        deadline = time.monotonic() + (PATIENCE if timeout is None else timeout)
        while True:
            present = {peer.connection: peer for peer in self.peers if not peer.is_gone}
            left = max(0.0, deadline - time.monotonic())
            ready = select.select(list(present), [], [], left)[0]
            if not ready:
                return None, False
            frame = self._pass_on(present[ready[0]])
            if frame is not None:
                return frame, False

    def _pass_on(self, peer: Peer) -> can.Message | None:
        try:
            packet = peer.connection.recv(128)
        except ConnectionResetError:  # it left frames of ours unread; its own last ones follow
            packet = peer.connection.recv(128)
        if not packet:
            peer.is_gone = True
            return None
        frame = unpack(packet)
        peer.said.append(frame)
        for other in self.peers:
            if other is not peer:
                other.tell(frame)
        return frame

    def shutdown(self) -> None:
        """Hang up."""
        for peer in self.peers:
            peer.connection.close()
        self._listener.close()
        super().shutdown()
