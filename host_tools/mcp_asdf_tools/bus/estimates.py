"""Estimates in many frames, decoded at once, for programs that hear a whole swarm."""

from __future__ import annotations

from collections.abc import Sequence

import can
import numpy as np
from numpy.typing import NDArray

from mcp_asdf.fixed_point import ALPHA_MAX, SHIFT_MAX
from mcp_asdf_tools.bus.frames import (
    FRACTION,
    FRAME_BYTES,
    IGNORED_BITS,
    IMPLICIT,
    INFINITE_ALPHA,
    NODE_BITS,
    ONE,
    SINGLE_FRAME,
    UNIT_EXPONENT,
    FrameFormat,
)

_ANY_IDENTIFIER = _NO_IDENTIFIER = 0xFFFF_FFFF


def decode_estimates(
    frames: Sequence[can.Message], frame_format: FrameFormat, flips: NDArray[np.uint64]
) -> tuple[NDArray[np.uint32], NDArray[np.bool_]]:
    """Estimates in many frames at once, exactly as ``decode`` of each, with these bits of the data flipped.

    Returns a row of sender, x_hat and alpha for each frame, and whether it holds an estimate; if not, its row
    means nothing. Bit 0 of ``flips``, shape (frames,), is the lowest of the first byte. O(frames).
    """
    identifiers = np.array([_identifier_of_data(frame) for frame in frames], np.uint32)
    data = b"".join([bytes(frame.data) if len(frame.data) == FRAME_BYTES else bytes(8) for frame in frames])
    content = np.frombuffer(data, "<u8") ^ flips
    x_hat, alpha = content & np.uint64(0xFF_FFFF), content >> np.uint64(24) & np.uint64(0xFFFF_FFFF)
    is_estimate = identifiers & np.uint32(_ANY_IDENTIFIER & ~IGNORED_BITS) == frame_format.subject << 8
    is_estimate &= content >> np.uint64(56 + 5) == SINGLE_FRAME >> 5
    is_estimate &= (x_hat <= ONE) & (alpha < INFINITE_ALPHA)
    rows = np.empty((len(frames), 3), np.uint32)
    rows[:, 0] = identifiers & np.uint32(NODE_BITS)
    rows[:, 1] = x_hat
    rows[:, 2] = _words_of(alpha.astype(np.int64))
    return rows, is_estimate


def _identifier_of_data(frame: can.Message) -> int:
    """29-bit identifier of a classic data frame of 8 bytes; _NO_IDENTIFIER for any other frame."""
    is_other = frame.is_error_frame or frame.is_remote_frame or frame.is_fd or not frame.is_extended_id
    return _NO_IDENTIFIER if is_other or len(frame.data) != FRAME_BYTES else frame.arbitration_id


def _words_of(bits: NDArray[np.int64]) -> NDArray[np.int64]:
    """``word_of`` of each."""
    mantissa, shift = bits & FRACTION | IMPLICIT, (bits >> 23) - UNIT_EXPONENT
    lost = np.minimum(np.maximum(-shift, 0), 24)  # all of a mantissa has gone after 24 bits
    return np.where(shift <= SHIFT_MAX, mantissa >> lost << 8 | np.maximum(shift, 0), ALPHA_MAX)
