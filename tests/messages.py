"""Messages of every kind that a bus carries, and their frames with the default formats."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import can
import yaml
from hypothesis import strategies as st

from mcp_asdf.fixed_point import alpha_units, alpha_word_from_units
from mcp_asdf_tools.bus import frames
from mcp_asdf_tools.bus.frame_layout import EVERY_ROBOT, MAX_B_HAT, MIN_B_HAT, Action, Health, Mode
from mcp_asdf_tools.bus.frames import Command, Estimate, FrameFormat, Heartbeat, Telemetry
from support import ROOT

DEFAULT = FrameFormat()
FRAMES = {
    "186BB92A#0000603333F307E5": can.Message(
        arbitration_id=0x186BB92A, data=bytes.fromhex("0000603333F307E5")
    ),
    "042#": can.Message(arbitration_id=0x42, is_extended_id=False),
    "00000042#R": can.Message(arbitration_id=0x42, is_remote_frame=True, dlc=3),
    "E00000088#00": can.Message(arbitration_id=0x88, is_error_frame=True, is_extended_id=False, data=b"\0"),
}
"""Frames by their text, which is candump's."""


class Kind(NamedTuple):
    """A kind of message: its subject, its name, and its codec with the default format."""

    subject: int
    name: str
    encode: Callable[[Any], can.Message]
    decode: Callable[[can.Message], Any]


KINDS: dict[type, Kind] = {
    Estimate: Kind(
        3000,
        "estimate",
        lambda it: frames.encode_estimate(it, DEFAULT),
        lambda frame: frames.decode_estimate(frame, DEFAULT),
    ),
    Heartbeat: Kind(7509, "heartbeat", frames.encode_heartbeat, frames.decode_heartbeat),
    Telemetry: Kind(3001, "telemetry", frames.encode_telemetry, frames.decode_telemetry),
    Command: Kind(3002, "command", frames.encode_command, frames.decode_command),
}


def up_to(high: int, beyond: int, low: int = 0) -> st.SearchStrategy[int]:
    """Numbers ``low`` .. ``high``, or some that are up to ``beyond`` out of this range."""
    legal = st.integers(low, high)
    return legal | st.integers(high, high + beyond) | st.integers(low - min(low, beyond), low)


def drawn(beyond: int = 0) -> st.SearchStrategy[Any]:
    """Messages of every kind, with fields up to ``beyond`` out of range."""
    nodes, transfers, words = up_to(127, beyond), st.integers(0, 31), st.integers(0, 2**32 - 1)
    ratios, codes = up_to(2**23, beyond), st.integers(0, 255)
    alphas = st.builds(lambda word, cut: word >> cut << 8 | word & 0xFF, words, st.integers(8, 32))
    b_hats, targets = up_to(MAX_B_HAT, beyond, MIN_B_HAT), nodes | st.just(EVERY_ROBOT)
    return st.one_of(
        st.builds(Estimate, nodes, ratios, words | alphas, transfers),
        st.builds(Heartbeat, nodes, words, transfers, st.sampled_from(Health), st.sampled_from(Mode), codes),
        st.builds(Telemetry, nodes, ratios, b_hats, codes, transfers),
        st.builds(Command, nodes, words, targets, st.sampled_from(Action), transfers),
    )


def as_decoded(message: Any) -> Any:
    """The message with the smallest shift of alpha, as decoding gives it."""
    if not isinstance(message, Estimate):
        return message
    return Estimate(
        message.sender, message.x_hat, alpha_word_from_units(alpha_units(message.alpha)), message.transfer_id
    )


messages = drawn().map(as_decoded)
estimates = messages.filter(lambda message: isinstance(message, Estimate))


def encoded(message: Any) -> can.Message:
    """The frame of a message of any kind."""
    return KINDS[type(message)].encode(message)


def write_regulated_types(folder: Path, *only: str) -> None:
    """Write OpenCyphal's own types, all or some, which its tools do not bring along, into a folder."""
    layouts = yaml.safe_load((ROOT / "tests/data/uavcan_types.yml").read_text(encoding="utf-8"))
    for name in [each for each in layouts if not only or Path(each).name in only]:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(layouts[name])
