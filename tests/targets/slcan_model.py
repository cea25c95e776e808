"""A robot that speaks slcan: c_ref/ports/slcan once more, in Python.

The server of the tools reads lines and the robot is ``robots.node.RobotNode`` with the mirror, so nothing
is shared with the C but the documents.
"""

from __future__ import annotations

import re
from collections.abc import Callable

from mcp_asdf_tools.bus.frames import Heartbeat, decode_heartbeat
from mcp_asdf_tools.bus.slcan_server import frame_of, line_of
from mcp_asdf_tools.robots.node import RobotNode

GREETING = b"\r"
_LONGEST = 26
_COMMAND = re.compile(rb"|[OCVNF]|S.|s....", re.DOTALL)


class Model:
    """The program at the other end of the serial line.

    Attributes:
        node: The robot.
        dropped: Lines that were neither a frame nor a command.
        is_open: Whether the bus is.
    """

    def __init__(self, make_node: Callable[[], RobotNode]) -> None:
        """``make_node`` makes the robot as it is when it is switched on."""
        self.node = make_node()
        self.dropped = 0
        self.is_open = False
        self._make_node = make_node
        self._line = b""

    def take(self, text: bytes) -> bytes:
        """The program's answer to ``text``."""
        sent = b""
        for piece in re.findall(rb"[^\r\a]*[\r\a]|[^\r\a]+", text):
            self._line += piece
            if piece[-1:] in (b"\r", b"\a"):
                line, end, self._line = self._line[:-1], self._line[-1:], b""
                sent += self._line_ended(line) if end == b"\r" else self._drop()
        return sent

    def _line_ended(self, line: bytes) -> bytes:
        is_frame = line[:1] in (b"t", b"T", b"r", b"R") and frame_of(line) is not None
        if not is_frame and (len(line) > _LONGEST or _COMMAND.fullmatch(line) is None):
            return self._drop()
        return self._frame(line) if is_frame else self._command(line[:1])

    def _frame(self, line: bytes) -> bytes:
        if not self.is_open:
            return b"\a"
        is_unwell = self.dropped > 0 or self.node.unsettled > 0
        frame = frame_of(line)
        assert frame is not None
        answers = self.node.hear(frame)
        for answer in answers:
            if isinstance(decode_heartbeat(answer), Heartbeat):
                answer.data[4] = is_unwell  # health: advisory
        return (b"Z\r" if frame.is_extended_id else b"z\r") + b"".join(map(line_of, answers))

    def _command(self, command: bytes) -> bytes:
        flags = b"F%02X\r" % (8 * (self.dropped > 0))
        answer = {b"V": b"V1001\r", b"N": b"NASDF\r", b"F": flags}.get(command, b"\r")
        if command == b"O":
            return answer + self._start()
        self.is_open &= command != b"C"
        return answer

    def _start(self) -> bytes:
        self.is_open = True
        self.node = self._make_node()
        return b"".join(map(line_of, self.node.start()))

    def _drop(self) -> bytes:
        self.dropped += 1
        return b"\a"
