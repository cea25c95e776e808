"""Frames on their way from robot to robot."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import can

Key = tuple[int, bytes, bool]
"""Identity of a frame: identifier, data, and whether it is an error frame."""


@dataclass(frozen=True)
class SentFrame:
    """A frame that has got onto the bus.

    Attributes:
        frame: As it is there.
        sender: The node that has sent it, which may differ from the id in the frame.
        tick: When.
        number: Frames with its identifier that the node has sent before in this tick.
    """

    frame: can.Message
    sender: int
    tick: int
    number: int = 0

    @cached_property
    def key(self) -> Key:
        """Identity of the frame, which must not change any more."""
        return self.frame.arbitration_id, bytes(self.frame.data), self.frame.is_error_frame
