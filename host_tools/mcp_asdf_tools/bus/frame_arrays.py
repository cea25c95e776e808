"""The codec for many frames at once, for programs that receive what a swarm broadcasts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import can
import numpy as np
from numpy.typing import NDArray

from mcp_asdf.fixed_point import ALPHA_MAX, SHIFT_MAX
from mcp_asdf_tools.bus.alpha_words import (
    FRACTION_BITS,
    FRACTION_MASK,
    IMPLICIT_BIT,
    MANTISSA_BITS,
    MANTISSA_POSITION,
    UNIT_EXPONENT,
)
from mcp_asdf_tools.bus.frame_layout import ESTIMATE, FRAME_BYTES, START_END_TOGGLE, Field
from mcp_asdf_tools.bus.frames import (
    IGNORED_IDENTIFIER_BITS,
    NODE_ID_MASK,
    SUBJECT_SHIFT,
    FrameFormat,
)

_X_HAT, _ALPHA = ESTIMATE.field("x_hat"), ESTIMATE.field("alpha")
_IDENTIFIER_OF_NO_SUBJECT = 0xFFFF_FFFF
"""Stands for the identifier of a frame that cannot hold an estimate: its bits are those of no subject."""
_COMPARED_IDENTIFIER_BITS = 0xFFFF_FFFF & ~IGNORED_IDENTIFIER_BITS


@dataclass(frozen=True)
class EstimateArray:
    """Estimates of many frames; entry i of each array belongs to frame i.

    Attributes:
        rows: Sender, x_hat (unit 2**-23) and alpha (as the firmware's 32 bits) of each frame, shape (frames,
            3), in the layout that a robot's ``receive_all`` takes. Undefined where ``is_estimate`` is false.
        is_estimate: Whether each frame holds an estimate, shape (frames,).
    """

    rows: NDArray[np.uint32]
    is_estimate: NDArray[np.bool_]


def decode_estimates(
    frames: Sequence[can.Message], frame_format: FrameFormat, bit_flips: NDArray[np.uint64]
) -> EstimateArray:
    """Decode the estimates in many frames exactly as ``decode_estimate`` would one by one, in O(frames).

    The result has a row of sender, x_hat and alpha word for each frame, and says which frames are estimates;
    the rows of other frames mean nothing.

    ``bit_flips``, shape (frames,), are the bits of each frame's data that are inverted before decoding;
    bit 0 is the lowest of the first byte.
    """
    identifiers = np.array([_identifier_of_data_frame(frame) for frame in frames], np.uint32)
    all_data = b"".join([_padded_data(frame) for frame in frames])
    # 8 bytes of data are one number, the first byte lowest.
    payloads = np.frombuffer(all_data, "<u8") ^ bit_flips
    x_hat = _extract(_X_HAT, payloads)
    alpha_bits = _extract(_ALPHA, payloads)

    # The checks of ``decode_estimate``: the subject, the tail byte, and the fields in their ranges.
    compared_bits = identifiers & np.uint32(_COMPARED_IDENTIFIER_BITS)
    is_estimate = compared_bits == frame_format.subject << SUBJECT_SHIFT
    is_estimate &= _extract(START_END_TOGGLE, payloads) == START_END_TOGGLE.maximum
    is_estimate &= (x_hat <= _X_HAT.maximum) & (alpha_bits <= _ALPHA.maximum)

    rows = np.empty((len(frames), 3), np.uint32)
    rows[:, 0] = identifiers & np.uint32(NODE_ID_MASK)
    rows[:, 1] = x_hat
    rows[:, 2] = _alpha_words_from_float32_bits(alpha_bits.astype(np.int64))
    return EstimateArray(rows, is_estimate)


def _alpha_words_from_float32_bits(bits: NDArray[np.int64]) -> NDArray[np.int64]:
    """Convert the binary32 bits of finite numbers >= 0 to alpha words, rounded down, all of an array at once.

    An alpha word is the firmware's form of a confidence: a mantissa of 24 bits above a shift of 5 bits. The
    words are those of ``alpha_word_from_float32_bits``, which converts a single number.
    """
    mantissas = (bits & FRACTION_MASK) | IMPLICIT_BIT
    biased_exponents = bits >> FRACTION_BITS  # the only other bit above the fraction, the sign, is 0
    shifts = biased_exponents - UNIT_EXPONENT
    # A word's shift cannot be negative, so the mantissa loses bits instead. After 24 bits nothing of it is
    # left, and NumPy shifts by no more than 63.
    lost_bits = np.clip(-shifts, 0, MANTISSA_BITS)
    kept_mantissas = mantissas >> lost_bits
    alpha_words = (kept_mantissas << MANTISSA_POSITION) | np.maximum(shifts, 0)
    return np.where(shifts <= SHIFT_MAX, alpha_words, ALPHA_MAX)


def _extract(field: Field, payloads: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Return a field's integers from the 64 bits of data of many frames."""
    return (payloads >> np.uint64(field.first_bit)) & np.uint64(field.mask)


def _identifier_of_data_frame(frame: can.Message) -> int:
    """Return the identifier of a classic data frame with a 29-bit identifier and 8 bytes of data.

    No other frame can hold an estimate. For these the result is _IDENTIFIER_OF_NO_SUBJECT, which every later
    comparison with a subject fails.
    """
    is_special = frame.is_error_frame or frame.is_remote_frame or frame.is_fd or not frame.is_extended_id
    if is_special or len(frame.data) != FRAME_BYTES:
        return _IDENTIFIER_OF_NO_SUBJECT
    return frame.arbitration_id


def _padded_data(frame: can.Message) -> bytes:
    """Return a frame's 8 bytes of data, or zeros for a frame of another length, which holds no estimate."""
    return bytes(frame.data) if len(frame.data) == FRAME_BYTES else bytes(FRAME_BYTES)
