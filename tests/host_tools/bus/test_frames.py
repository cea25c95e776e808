"""The frame codec against independent decoders, and against everything a bus can deliver."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from copy import copy
from dataclasses import replace
from fractions import Fraction

import can
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from mcp_asdf.fixed_point import ALPHA_MAX, alpha_to_word, word_to_alpha
from mcp_asdf_tools.bus.estimates import decode_estimates
from mcp_asdf_tools.bus.frames import (
    Action,
    Command,
    FrameFormat,
    Heartbeat,
    Message,
    Rejection,
    Telemetry,
    alpha_bits,
    binary32_of,
    bits_of,
    decode,
    decode_any,
    decode_heartbeat,
    encode,
    encode_command,
    encode_heartbeat,
    encode_telemetry,
    word_of,
)
from robots import ALPHA_ONE
from support import draws

pytestmark = pytest.mark.random

DEFAULT = FrameFormat()
LARGEST_BITS = 0x7F7FFFFF
UNIT = Fraction(1, 2**24)

# Fixed examples in every run; a failure prints the one that shows it.
fixed = settings(derandomize=True, deadline=None, max_examples=draws(300))

words = st.one_of(
    st.integers(0, 2**32 - 1),
    st.builds(lambda bits, shift: (1 << bits) - 1 << 8 | shift, *[st.integers(0, 24)] * 2),
)
"""Of alpha: any, and some with few bits."""
formats = st.builds(FrameFormat, subject=st.integers(0, 6143), priority=st.integers(0, 7))
messages = st.builds(
    Message,
    sender=st.integers(0, 127),
    x_hat=st.integers(0, 2**23),
    alpha=words,
    transfer_id=st.integers(0, 31),
)
SMALLEST = Message(0, 0, 0, 0)
LARGEST = Message(127, 2**23, ALPHA_MAX, 31)


def value_of(word: int) -> Fraction:
    """The value of an alpha word."""
    return ((word >> 8) << word % 32) * UNIT


def is_normal(word: int) -> bool:
    """True if the word has the smallest shift, as the firmware forms it."""
    return word & 0xE0 == 0 and (word >> 31 == 1 or word % 256 == 0)


def legal_frame() -> can.Message:
    """A frame that decodes, made by hand: robot 42, x_hat 1/2, alpha 1, first transfer."""
    return can.Message(arbitration_id=0x106BB82A, is_extended_id=True, data=bytes.fromhex("0000400000803fe0"))


def test_the_documented_example() -> None:
    message = Message(sender=42, x_hat=2**22, alpha=ALPHA_ONE, transfer_id=0)
    assert decode(legal_frame(), DEFAULT) == message
    frame = encode(message, DEFAULT, timestamp=1.5)
    assert frame.arbitration_id == 0x106BB82A
    assert frame.data == legal_frame().data
    assert (frame.timestamp, frame.dlc, frame.is_extended_id) == (1.5, 8, True)
    assert not (frame.is_fd or frame.is_remote_frame or frame.is_error_frame)


@fixed
@given(messages, formats)
@example(SMALLEST, FrameFormat(0, 0))
@example(LARGEST, FrameFormat(6143, 7))
def test_decode_undoes_encode(message: Message, frame_format: FrameFormat) -> None:
    """But for the choice of alpha's shift."""
    found = decode(encode(message, frame_format), frame_format)
    assert isinstance(found, Message)
    assert replace(found, alpha=message.alpha) == message
    assert value_of(found.alpha) == value_of(message.alpha)
    assert is_normal(found.alpha)
    if is_normal(message.alpha):
        assert found == message


def changed(data: str = "0000400000803fe0", **fields: object) -> can.Message:
    """The legal frame with other data or other fields."""
    frame = legal_frame()
    frame.data = bytearray.fromhex(data)
    for name, value in fields.items():
        setattr(frame, name, value)
    return frame


REJECTED = {
    "error frame": (changed(is_error_frame=True), Rejection.ERROR_FRAME),
    "remote frame": (changed(is_remote_frame=True), Rejection.REMOTE_FRAME),
    "remote frame without data": (changed(data="", is_remote_frame=True), Rejection.REMOTE_FRAME),
    "FD frame": (changed(is_fd=True), Rejection.FD_FRAME),
    "standard identifier": (changed(is_extended_id=False, arbitration_id=0x42A), Rejection.STANDARD_ID),
    "service": (changed(arbitration_id=0x106BB82A | 1 << 25), Rejection.SERVICE),
    "anonymous": (changed(arbitration_id=0x106BB82A | 1 << 24), Rejection.ANONYMOUS),
    "reserved bit 23": (changed(arbitration_id=0x106BB82A | 1 << 23), Rejection.RESERVED_BITS),
    "reserved bit 7": (changed(arbitration_id=0x106BB82A | 1 << 7), Rejection.RESERVED_BITS),
    "next subject": (changed(arbitration_id=0x106BB92A), Rejection.SUBJECT),
    "no data": (changed(data=""), Rejection.LENGTH),
    "7 bytes": (changed(data="0000400000803f"), Rejection.LENGTH),
    "a short frame that ends in a tail byte": (changed(data="0000e0"), Rejection.LENGTH),
    "9 bytes": (changed(data="0000400000803fe0e0"), Rejection.LENGTH),
    "start bit clear": (changed(data="0000400000803f60"), Rejection.MULTI_FRAME),
    "end bit clear": (changed(data="0000400000803fa0"), Rejection.MULTI_FRAME),
    "toggle bit clear (Cyphal's predecessor)": (changed(data="0000400000803fc0"), Rejection.MULTI_FRAME),
    "x_hat just above 1": (changed(data="0100800000803fe0"), Rejection.X_HAT),
    "x_hat all ones": (changed(data="ffffff0000803fe0"), Rejection.X_HAT),
    "alpha -0": (changed(data="00004000000080e0"), Rejection.ALPHA),
    "alpha -1": (changed(data="000040000080bfe0"), Rejection.ALPHA),
    "alpha infinite": (changed(data="0000400000807fe0"), Rejection.ALPHA),
    "alpha -infinite": (changed(data="000040000080ffe0"), Rejection.ALPHA),
    "alpha quiet NaN": (changed(data="0000400000c07fe0"), Rejection.ALPHA),
    "alpha signalling NaN": (changed(data="0000400100807fe0"), Rejection.ALPHA),
}


@pytest.mark.parametrize("name", REJECTED)
def test_every_rejection(name: str) -> None:
    frame, reason = REJECTED[name]
    assert decode(frame, DEFAULT) is reason


def test_any_frame_is_told_by_what_it_holds() -> None:
    estimate, beat, told = Message(5, 9, ALPHA_ONE, 7), Heartbeat(5, 99, 7), Telemetry(5, 3, 1 << 20, 2, 7)
    order = encode_command(Command(5, 1, 2, Action.SETTLE, 7))
    assert decode_any(encode(estimate, DEFAULT), DEFAULT) == estimate
    assert decode_any(encode_heartbeat(beat), DEFAULT) == beat
    assert decode_any(encode_telemetry(told), DEFAULT) == told
    assert decode_any(order, DEFAULT) is Rejection.SUBJECT
    assert decode_any(changed(data=""), DEFAULT) is Rejection.LENGTH


def is_legal_by_the_text(frame: can.Message, subject: int) -> bool:
    """The rules of docs/frame.md once more, written with text and floats instead of masks."""
    if frame.is_error_frame or frame.is_remote_frame or frame.is_fd or not frame.is_extended_id:
        return False
    bits = f"{frame.arbitration_id:029b}"
    if (bits[3:6], bits[8:21], bits[21]) != ("000", f"{subject:013b}", "0") or len(frame.data) != 8:
        return False
    alpha = struct.unpack("<f", frame.data[3:7])[0]
    alpha_is_legal = np.isfinite(alpha) and not np.signbit(alpha)
    x_is_legal = int.from_bytes(frame.data[:3], "little") / 2**23 <= 1
    return bool(alpha_is_legal and x_is_legal and f"{frame.data[7]:08b}".startswith("111"))


def agree_at_once(frames: Sequence[can.Message], flips: NDArray[np.uint64]) -> None:
    """Many frames are decoded as each is. Those without 8 bytes are never estimates, whatever is flipped."""
    rows, is_estimate = decode_estimates(frames, DEFAULT, flips)
    assert rows.shape == (len(frames), 3)
    found = zip(frames, flips.tolist(), is_estimate.tolist(), rows.tolist(), strict=True)
    for frame, flip, is_one, row in found:
        came = copy(frame)
        if len(frame.data) == 8:
            came.data = bytearray((int.from_bytes(frame.data, "little") ^ flip).to_bytes(8, "little"))
        one = decode(came, DEFAULT)
        assert is_one == isinstance(one, Message)
        if isinstance(one, Message):
            assert row == [one.sender, one.x_hat, one.alpha]


def agrees(frame: can.Message) -> None:
    """The decoder accepts what the text calls legal, and nothing of it is lost or made up."""
    result = decode(frame, DEFAULT)
    assert isinstance(result, Message) == is_legal_by_the_text(frame, DEFAULT.subject)
    agree_at_once([frame], np.zeros(1, np.uint64))
    if isinstance(result, Message):
        again = encode(result, FrameFormat(DEFAULT.subject, frame.arbitration_id >> 26))
        assert again.arbitration_id == frame.arbitration_id | 3 << 21
        assert (again.data[:3], again.data[7]) == (frame.data[:3], frame.data[7])
        said, kept = (struct.unpack("<f", each.data[3:7])[0] for each in (frame, again))
        assert kept == min(float(np.floor(said * 2.0**24)) * 2.0**-24, 2.0**31 - 2.0**7)
    decode_heartbeat(frame)  # must not raise either


any_frames = st.builds(
    can.Message,
    arbitration_id=st.one_of(
        st.integers(0, 2**29 - 1), st.integers(0, 2**29 - 1).map(lambda n: n & 0x1CFF80FF | 0xBB800)
    ),
    data=st.one_of(
        st.binary(max_size=64), st.binary(min_size=7, max_size=7).map(lambda data: data + b"\xe3")
    ),
    is_extended_id=st.booleans(),
    is_remote_frame=st.booleans(),
    is_error_frame=st.booleans(),
    is_fd=st.booleans(),
)


@fixed
@given(any_frames)
def test_anything_a_bus_can_deliver(frame: can.Message) -> None:
    agrees(frame)


some_frames = any_frames | messages.map(lambda message: encode(message, DEFAULT))


@fixed
@given(st.lists(st.tuples(some_frames, st.just(0) | st.integers(0, 2**64 - 1)), max_size=8))
@example([(legal_frame(), 0), (legal_frame(), 1 << 55), (legal_frame(), 1)])
def test_many_frames_at_once(arrivals: list[tuple[can.Message, int]]) -> None:
    agree_at_once([frame for frame, _ in arrivals], np.array([flips for _, flips in arrivals], np.uint64))


# Alpha: the firmware's word and binary32


@fixed
@given(words)
@example(0)
@example(ALPHA_MAX)
@example(0x100)
@example(0x1FF)
@example(0xE0)
def test_every_word_is_a_binary32_number(word: int) -> None:
    bits = binary32_of(word)
    assert (
        Fraction(float(np.uint32(bits).view(np.float32))) == value_of(word) == Fraction(word_to_alpha(word))
    )
    again = word_of(bits)
    assert value_of(again) == value_of(word)
    assert is_normal(again)
    assert binary32_of(again) == bits


@settings(fixed, max_examples=draws(2000))
@given(st.one_of(st.integers(0, LARGEST_BITS), st.integers(bits_of(2.0**-26), bits_of(2.0**33))))
@example(0)
@example(1)
@example(0x007FFFFF)
@example(0x00800000)
@example(LARGEST_BITS)
def test_a_binary32_number_is_rounded_down_to_the_grid_or_saturated(bits: int) -> None:
    value = Fraction(float(np.uint32(bits).view(np.float32)))
    word = word_of(bits)
    assert value_of(word) == min(value // UNIT * UNIT, value_of(ALPHA_MAX))
    assert is_normal(word)
    assert word == alpha_to_word(float(value))


@pytest.mark.parametrize(
    ("value", "word"),
    [
        (2.0**-24, 0x100),
        (2.0**-24 * (1 - 2.0**-24), 0),
        (2.0**-149, 0),
        (3 * 2.0**-25, 0x100),
        (0.5 - 2.0**-25, 0x7FFFFF00),
        (1 - 2.0**-24, 0xFFFFFF00),
        (1.0, ALPHA_ONE),
        (2.0**31 - 2**8, 0xFFFFFE1F),
        (2.0**31 - 2**7, ALPHA_MAX),
        (2.0**31, ALPHA_MAX),
        (2.0**32, ALPHA_MAX),
        ((2 - 2.0**-23) * 2.0**127, ALPHA_MAX),
    ],
)
def test_the_edges_of_the_grid(value: float, word: int) -> None:
    frame = encode(LARGEST, DEFAULT)
    struct.pack_into("<f", frame.data, 3, value)
    message = decode(frame, DEFAULT)
    assert isinstance(message, Message)
    assert message.alpha == word
    assert alpha_bits(frame) == bits_of(value)


def test_bits_of_rounds_to_nearest_even_and_refuses_what_is_too_large() -> None:
    assert bits_of(1 + 2**-24) == 0x3F800000
    assert bits_of(1 + 3 * 2**-24) == 0x3F800002
    with pytest.raises(OverflowError):
        bits_of(2.0**128)
