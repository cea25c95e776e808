"""Messages of every kind that a bus carries, and their frames with the default formats."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
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

DEFAULT_FORMAT = FrameFormat()
FRAMES = {
    "186BB92A#0000603333F307E5": can.Message(
        arbitration_id=0x186BB92A, data=bytes.fromhex("0000603333F307E5")
    ),
    "042#": can.Message(arbitration_id=0x42, is_extended_id=False),
    "00000042#R": can.Message(arbitration_id=0x42, is_remote_frame=True, dlc=3),
    "E00000088#00": can.Message(arbitration_id=0x88, is_error_frame=True, is_extended_id=False, data=b"\0"),
}
"""Frames by the text that candump writes for them."""


class Kind(NamedTuple):
    """A kind of message, and how its frames are encoded and decoded with the default format.

    Attributes:
        subject: Number by which receivers know the kind; it is part of a frame's identifier.
        name: Name as C's functions have it.
        encode: Returns the frame of a message.
        decode: Returns the message that a frame holds, or a rejection.
    """

    subject: int
    name: str
    encode: Callable[[Any], can.Message]
    decode: Callable[[can.Message], Any]


KINDS: dict[type, Kind] = {
    Estimate: Kind(
        3000,
        "estimate",
        lambda estimate: frames.encode_estimate(estimate, DEFAULT_FORMAT),
        lambda frame: frames.decode_estimate(frame, DEFAULT_FORMAT),
    ),
    Heartbeat: Kind(7509, "heartbeat", frames.encode_heartbeat, frames.decode_heartbeat),
    Telemetry: Kind(3001, "telemetry", frames.encode_telemetry, frames.decode_telemetry),
    Command: Kind(3002, "command", frames.encode_command, frames.decode_command),
}


def numbers(minimum: int, maximum: int, beyond: int = 0) -> st.SearchStrategy[int]:
    """Draw numbers from a range, or some that are up to ``beyond`` out of it, but not below 0."""
    lowest = max(minimum - beyond, 0)
    return (
        st.integers(minimum, maximum) | st.integers(maximum, maximum + beyond) | st.integers(lowest, minimum)
    )


def node_ids(beyond: int = 0) -> st.SearchStrategy[int]:
    """Draw ids of nodes, or some that are up to ``beyond`` above the largest."""
    return numbers(0, 127, beyond)


TRANSFER_IDS = st.integers(0, 31)
BYTES = st.integers(0, 255)
WORDS = st.integers(0, 2**32 - 1)


def shortened_alpha(word: int, bits_lost: int) -> int:
    """Return an alpha word with the shift of ``word``, its 8 low bits, but a mantissa of fewer bits."""
    mantissa, shift = word >> bits_lost, word & 0xFF
    return (mantissa << 8) | shift


ALPHA_WORDS = WORDS | st.builds(shortened_alpha, WORDS, st.integers(8, 32))


def any_estimate(beyond: int = 0) -> st.SearchStrategy[Estimate]:
    """Draw estimates, whose sender and x_hat may be up to ``beyond`` out of their ranges."""
    return st.builds(Estimate, node_ids(beyond), numbers(0, 2**23, beyond), ALPHA_WORDS, TRANSFER_IDS)


def any_heartbeat(beyond: int = 0) -> st.SearchStrategy[Heartbeat]:
    """Draw heartbeats, whose sender may be up to ``beyond`` out of its range."""
    healths, modes = st.sampled_from(Health), st.sampled_from(Mode)
    return st.builds(Heartbeat, node_ids(beyond), WORDS, TRANSFER_IDS, healths, modes, BYTES)


def any_telemetry(beyond: int = 0) -> st.SearchStrategy[Telemetry]:
    """Draw telemetry, whose sender, x and b_hat may be up to ``beyond`` out of their ranges."""
    ratios, accuracies = numbers(0, 2**23, beyond), numbers(MIN_B_HAT, MAX_B_HAT, beyond)
    return st.builds(Telemetry, node_ids(beyond), ratios, accuracies, BYTES, TRANSFER_IDS)


def any_command(beyond: int = 0) -> st.SearchStrategy[Command]:
    """Draw commands, whose sender and target may be up to ``beyond`` out of their ranges."""
    targets = node_ids(beyond) | st.just(EVERY_ROBOT)
    return st.builds(Command, node_ids(beyond), WORDS, targets, st.sampled_from(Action), TRANSFER_IDS)


def any_message_of_robots(beyond: int = 0) -> st.SearchStrategy[Any]:
    """Draw messages of the kinds that robots send, with fields up to ``beyond`` out of range."""
    return any_estimate(beyond) | any_heartbeat(beyond) | any_telemetry(beyond)


def any_message(beyond: int = 0) -> st.SearchStrategy[Any]:
    """Draw messages of every kind, with fields up to ``beyond`` out of range."""
    return any_message_of_robots(beyond) | any_command(beyond)


def as_decoded(message: Any) -> Any:
    """Return the message that decoding gives: an estimate has the smallest shift for its alpha."""
    if not isinstance(message, Estimate):
        return message
    return replace(message, alpha=alpha_word_from_units(alpha_units(message.alpha)))


messages = any_message().map(as_decoded)
"""Legal messages of every kind, as decoding gives them."""
estimates = any_estimate().map(as_decoded)


def encoded(message: Any) -> can.Message:
    """Return the frame of a message of any kind. Raises ValueError for a field out of its range."""
    return KINDS[type(message)].encode(message)


def decode_as(message_type: type, frame: can.Message) -> Any:
    """Return the message of a kind that a frame holds, or the reason why it holds none of this kind."""
    return KINDS[message_type].decode(frame)


def write_regulated_types(folder: Path, *file_names: str) -> None:
    """Write definitions of OpenCyphal's own types, which its tools do not bring along, into a folder.

    All are written, or those with these file names, such as ``Health.1.0.dsdl``.
    """
    definitions = yaml.safe_load((ROOT / "tests/data/uavcan_types.yml").read_text(encoding="utf-8"))
    for path, definition in definitions.items():
        if not file_names or Path(path).name in file_names:
            (folder / path).parent.mkdir(parents=True, exist_ok=True)
            (folder / path).write_text(definition)


IdentifierAndData = tuple[int, bytes]


def identifier_and_data(frame: can.Message) -> IdentifierAndData:
    """Return what a frame has on the bus, without time and place."""
    return frame.arbitration_id, bytes(frame.data)
