"""What a sidecar is told of a robot's frames that did not go out as the robot meant them."""

from __future__ import annotations

from collections.abc import Sequence

import can

from mcp_asdf_tools.bus.frames import FrameFormat, Message, alpha_bits, decode
from mcp_asdf_tools.recording.sidecar import SidecarWriter
from mcp_asdf_tools.swarm.faults import Sent


def note_fate(
    sidecar: SidecarWriter,
    robot: int,
    frame: can.Message | None,
    leaving: Sequence[Sent],
    frames: FrameFormat,
) -> None:
    """Tell ``sidecar`` what differs between ``frame``, which the robot would send, and what leaves it.

    None is what a babbling node would send.
    """
    own = None if frame is None else decode(frame, frames)
    is_heard = False
    for sent in leaving:
        said = decode(sent.frame, frames)
        if isinstance(own, Message) and isinstance(said, Message) and said.sender == robot:
            is_heard = True
            if frame is not None and sent.frame.data != frame.data:
                sidecar.robots[robot].falsified(said.x_hat, alpha_bits(sent.frame))
        elif sent.frame is not frame:
            sidecar.injected(sent.frame)
    if isinstance(own, Message) and not is_heard:
        sidecar.robots[robot].silent()
