"""A bus where the kernel has no CAN: C nodes connect by Unix sockets that carry ``struct can_frame``."""

from __future__ import annotations

import select
import socket
import struct
import time
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

import can

from support import PATIENCE

_EXTENDED, _REMOTE, _ERROR = 0x8000_0000, 0x4000_0000, 0x2000_0000
_CLASSIC, _FD = struct.Struct("=IB3x8s"), struct.Struct("=IB3x64s")


def _pack(frame: can.Message) -> bytes:
    """The kernel's ``struct can_frame``, or ``struct canfd_frame`` for an FD frame."""
    flags = _EXTENDED * frame.is_extended_id | _REMOTE * frame.is_remote_frame | _ERROR * frame.is_error_frame
    layout = _FD if frame.is_fd else _CLASSIC
    return layout.pack(frame.arbitration_id | flags, frame.dlc, bytes(frame.data))


def _unpack(packet: bytes) -> can.Message:
    """The classic data frame with a 29-bit identifier that a node sends; anything else fails."""
    identifier, length, data = _CLASSIC.unpack(packet)
    assert identifier & ~0x1FFF_FFFF == _EXTENDED
    return can.Message(arbitration_id=identifier & 0x1FFF_FFFF, data=data[:length])


@dataclass
class Peer:
    """One node's end.

    Attributes:
        connection: Its socket.
        said: Frames that it sent, in order.
        is_gone: Whether it has closed its socket.
    """

    connection: socket.socket
    said: list[can.Message] = field(default_factory=list)
    is_gone: bool = False


class UnixBus(can.BusABC):
    """The owner's end, a bus like any other of python-can's: what one node sends goes to all others.

    Frames are passed on while the owner receives.
    """

    def __init__(self, path: Path) -> None:
        """Listen at ``path``."""
        self.peers: list[Peer] = []
        self._listener = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._listener.bind(str(path))
        self._listener.listen(128)
        self._listener.settimeout(PATIENCE)
        self.channel_info = f"unix:{path}"
        super().__init__(channel=self.channel_info)

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Send to all nodes."""
        self._pass_on(msg, None)

    def accept(self) -> Peer:
        """The next node that connects. Raises TimeoutError if none does."""
        self.peers.append(Peer(self._listener.accept()[0]))
        return self.peers[-1]

    def hear_out(self, peer: Peer) -> None:
        """Listen until a node has ended."""
        while not peer.is_gone:
            self.recv(0.1)

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        deadline = time.monotonic() + (PATIENCE if timeout is None else timeout)
        while True:
            present = {peer.connection: peer for peer in self.peers if not peer.is_gone}
            ready = select.select(list(present), [], [], max(0.0, deadline - time.monotonic()))[0]
            if not ready:
                return None, False
            frame = self._take(present[ready[0]])
            if frame is not None:
                return frame, False

    def _take(self, peer: Peer) -> can.Message | None:
        try:
            packet = peer.connection.recv(128)
        except ConnectionResetError:  # it left frames of ours unread; its own last ones follow
            packet = peer.connection.recv(128)
        peer.is_gone = not packet
        if peer.is_gone:
            return None
        peer.said.append(_unpack(packet))
        self._pass_on(peer.said[-1], peer)
        return peer.said[-1]

    def _pass_on(self, frame: can.Message, sender: Peer | None) -> None:
        for peer in self.peers:
            if peer is not sender:
                with suppress(BrokenPipeError, ConnectionResetError):  # what it said is still to come
                    peer.connection.send(_pack(frame))

    def shutdown(self) -> None:
        """Hang up."""
        for peer in self.peers:
            peer.connection.close()
        self._listener.close()
        super().shutdown()
