"""A robot that speaks slcan, byte by byte: c_ref/ports/slcan once more, in Python.

Text is matched with regular expressions and the robot is ``robots.node.RobotNode`` with the mirror, so
that nothing is shared with the C but the documents.
"""

from __future__ import annotations

import re
from collections.abc import Callable

import can

from mcp_asdf_tools.bus.frames import Heartbeat, decode_heartbeat
from mcp_asdf_tools.bus.slcan_server import line_of
from mcp_asdf_tools.robots.node import RobotNode

OPENING = b"\r\rC\rS8\rO\r"
LONGEST = 26
_SHORT, _LONG = rb"([0-7][0-9A-F]{2})", rb"([01][0-9A-F]{7})"
_FRAMES = {
    # kind: the line's form, whether the identifier is long, whether it is a remote frame
    b"t": (re.compile(rb"t" + _SHORT + rb"([0-8])((?:[0-9A-F]{2})*)", re.IGNORECASE), False, False),
    b"T": (re.compile(rb"T" + _LONG + rb"([0-8])((?:[0-9A-F]{2})*)", re.IGNORECASE), True, False),
    b"r": (re.compile(rb"r" + _SHORT + rb"([0-8])()", re.IGNORECASE), False, True),
    b"R": (re.compile(rb"R" + _LONG + rb"([0-8])()", re.IGNORECASE), True, True),
}
_COMMAND = re.compile(rb"|[OCVNFzZ]|S.|s....", re.DOTALL)


def frame_in(line: bytes) -> can.Message | None:
    """The frame of a line without its end; None if it is none."""
    form, is_long, is_remote = _FRAMES.get(line[:1], (re.compile(rb"(?!)"), False, False))
    match = form.fullmatch(line)
    if match is None:
        return None
    data, length = bytes.fromhex(match[3].decode()), int(match[2])
    if len(data) != (0 if is_remote else length):
        return None
    return can.Message(
        arbitration_id=int(match[1], 16),
        is_extended_id=is_long,
        is_remote_frame=is_remote,
        dlc=length,
        data=data,
    )


class Model:
    """The program at the other end of the serial line.

    Attributes:
        node: The robot.
        dropped: Lines that were neither a frame nor a command.
        refused: Lines that an adapter refused.
        is_adapter: Whether a host has spoken.
        is_open: Whether the bus is.
    """

    def __init__(self, make_node: Callable[[], RobotNode]) -> None:
        """``make_node`` makes the robot as it is when it is switched on."""
        self.node = make_node()
        self.dropped = self.refused = 0
        self.is_adapter = self.is_open = False
        self._make_node = make_node
        self._line = b""

    def take(self, text: bytes) -> bytes:
        """The program's answer to ``text``."""
        sent = b""
        for piece in re.findall(rb"[^\r\a]*[\r\a]|[^\r\a]+", text):
            self._line += piece
            if piece[-1:] in (b"\r", b"\a"):
                line, end, self._line = self._line[:-1], self._line[-1:], b""
                sent += self._line_ended(line) if end == b"\r" else self._bell(line)
        return sent

    def _bell(self, line: bytes) -> bytes:
        if line or self.is_adapter:
            return self._drop()
        self.refused += 1
        return b""

    def _line_ended(self, line: bytes) -> bytes:
        frame = frame_in(line)
        if frame is not None:
            return self._frame(frame)
        if len(line) > LONGEST or _COMMAND.fullmatch(line) is None:
            return self._drop()
        return self._command(line[:1])

    def _frame(self, frame: can.Message) -> bytes:
        if not self.is_open:
            return self._answer(b"\a")
        is_unwell = self.dropped > 0 or self.refused > 0 or self.node.unsettled > 0
        answers = self.node.hear(frame)
        for answer in answers:
            if isinstance(decode_heartbeat(answer), Heartbeat):
                answer.data[4] = is_unwell  # health: advisory
        return self._answer(b"Z\r" if frame.is_extended_id else b"z\r") + b"".join(map(line_of, answers))

    def _command(self, command: bytes) -> bytes:
        if command and command in b"OSsVN":
            self.is_open &= self.is_adapter
            self.is_adapter = True
        answer = {b"V": b"V1001\r", b"N": b"NASDF\r", b"F": self._flags()}.get(command, b"\r")
        if command in (b"z", b"Z"):
            return b""
        if command == b"C":
            self.is_open &= not self.is_adapter
        if command == b"O" or (command == b"" and not self.is_adapter and not self.is_open):
            return self._answer(answer) + self._start()
        return self._answer(answer)

    def _flags(self) -> bytes:
        return b"F%02X\r" % (8 * (self.dropped > 0) + 2 * (self.refused > 0))

    def _start(self) -> bytes:
        self.is_open = True
        self.node = self._make_node()
        return b"".join(map(line_of, self.node.start()))

    def _drop(self) -> bytes:
        self.dropped += 1
        return self._answer(b"\a")

    def _answer(self, text: bytes) -> bytes:
        return text if self.is_adapter else b""
