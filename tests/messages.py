"""Messages of every kind that a bus carries, and their frames with the default formats."""

from __future__ import annotations

from typing import Any

import can
from hypothesis import strategies as st

from mcp_asdf.fixed_point import alpha_units, alpha_word
from mcp_asdf_tools.bus import frames
from mcp_asdf_tools.bus.frames import (
    EVERY_ROBOT,
    MAX_B_HAT,
    MIN_B_HAT,
    Action,
    Command,
    FrameFormat,
    Health,
    Heartbeat,
    Message,
    Mode,
    Telemetry,
)

DEFAULT = FrameFormat()

_nodes, _transfers, _words = st.integers(0, 127), st.integers(0, 31), st.integers(0, 2**32 - 1)
_bytes, _ratios = st.integers(0, 255), st.integers(0, 2**23)
_alphas = _words.map(lambda word: alpha_word(alpha_units(word)))
"""Words with the smallest shift, as decoding gives them."""

estimates = st.builds(Message, _nodes, _ratios, _alphas, _transfers)
messages = st.one_of(
    estimates,
    st.builds(Heartbeat, _nodes, _words, _transfers, st.sampled_from(Health), st.sampled_from(Mode), _bytes),
    st.builds(Telemetry, _nodes, _ratios, st.integers(MIN_B_HAT, MAX_B_HAT), _bytes, _transfers),
    st.builds(Command, _nodes, _words, _nodes | st.just(EVERY_ROBOT), st.sampled_from(Action), _transfers),
)


def encoded(message: Any) -> can.Message:
    """The frame of a message of any kind."""
    match message:
        case Message():
            return frames.encode(message, DEFAULT)
        case Heartbeat():
            return frames.encode_heartbeat(message)
        case Telemetry():
            return frames.encode_telemetry(message)
        case _:
            return frames.encode_command(message)
