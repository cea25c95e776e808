"""The frame codec against independent decoders, and against everything a bus can deliver."""

from __future__ import annotations

import struct
from dataclasses import replace
from typing import Any

import can
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from host_tools.frames import (
    FrameFormat,
    Health,
    Heartbeat,
    Message,
    Mode,
    Rejection,
    bits_of,
    decode,
    decode_heartbeat,
    encode,
    encode_heartbeat,
    float_of,
)

DEFAULT = FrameFormat()
LARGEST_ALPHA = 0x7F7FFFFF

# Fixed examples in every run; a failure prints the one that shows it.
fixed = settings(derandomize=True, deadline=None, max_examples=300)

formats = st.builds(FrameFormat, subject=st.integers(0, 6143), priority=st.integers(0, 7))
messages = st.builds(
    Message,
    sender=st.integers(0, 127),
    x_hat=st.integers(0, 2**23),
    alpha=st.integers(0, LARGEST_ALPHA),
    transfer_id=st.integers(0, 31),
)
heartbeats = st.builds(
    Heartbeat,
    sender=st.integers(0, 127),
    uptime=st.integers(0, 2**32 - 1),
    transfer_id=st.integers(0, 31),
    health=st.sampled_from(Health),
    mode=st.sampled_from(Mode),
    vendor_status=st.integers(0, 255),
)
SMALLEST = Message(0, 0, 0, 0)
LARGEST = Message(127, 2**23, LARGEST_ALPHA, 31)


def legal_frame() -> can.Message:
    """A frame that decodes, made by hand: robot 42, x_hat 1/2, alpha 1, first transfer."""
    return can.Message(arbitration_id=0x106BB82A, is_extended_id=True, data=bytes.fromhex("0000400000803fe0"))


def test_the_documented_example() -> None:
    message = Message(sender=42, x_hat=2**22, alpha=0x3F800000, transfer_id=0)
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
    assert decode(encode(message, frame_format), frame_format) == message


@fixed
@given(messages, formats)
@example(SMALLEST, FrameFormat(0, 0))
@example(LARGEST, FrameFormat(6143, 7))
def test_struct_and_numpy_read_the_same(message: Message, frame_format: FrameFormat) -> None:
    frame = encode(message, frame_format)
    low, high, alpha, tail = struct.unpack("<HBfB", frame.data)
    assert (low + 65536 * high, tail - 0xE0) == (message.x_hat, message.transfer_id)
    assert float_of(message.alpha) == alpha
    assert np.frombuffer(frame.data, dtype="<f4", count=1, offset=3)[0] == np.float32(alpha)
    fields = f"{frame.arbitration_id:029b}"
    assert fields == f"{frame_format.priority:03b}00011{frame_format.subject:013b}0{message.sender:07b}"


@fixed
@given(heartbeats, st.integers(0, 7))
@example(Heartbeat(0, 0, 0), 0)
@example(Heartbeat(127, 2**32 - 1, 31, Health.WARNING, Mode.SOFTWARE_UPDATE, 255), 7)
def test_heartbeats(heartbeat: Heartbeat, priority: int) -> None:
    frame = encode_heartbeat(heartbeat, priority)
    assert decode_heartbeat(frame) == heartbeat
    expected = (heartbeat.uptime, heartbeat.health.value, heartbeat.mode.value, heartbeat.vendor_status)
    assert struct.unpack("<IBBBB", frame.data) == (*expected, 0xE0 + heartbeat.transfer_id)
    assert f"{frame.arbitration_id:029b}" == f"{priority:03b}00011{7509:013b}0{heartbeat.sender:07b}"


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


def test_no_rejection_is_untested() -> None:
    tested = {reason for _, reason in REJECTED.values()}
    of_other_kinds = {Rejection.MODE, Rejection.X, Rejection.B_HAT, Rejection.TARGET, Rejection.ACTION}
    assert tested == set(Rejection) - of_other_kinds


@pytest.mark.parametrize("mode", range(256))
def test_a_heartbeat_with_an_unknown_mode_is_refused(mode: int) -> None:
    frame = encode_heartbeat(Heartbeat(5, 99, 7))
    frame.data[5] = mode
    known = Heartbeat(5, 99, 7, mode=Mode(mode % 8)) if mode % 8 <= 3 else Rejection.MODE
    assert decode_heartbeat(frame) == known


def test_the_spare_bits_of_health_are_ignored() -> None:
    frame = encode_heartbeat(Heartbeat(5, 99, 7, health=Health.CAUTION))
    frame.data[4] |= 0xFC
    assert decode_heartbeat(frame) == Heartbeat(5, 99, 7, health=Health.CAUTION)


def test_a_heartbeat_is_no_estimate_and_an_estimate_no_heartbeat() -> None:
    assert decode(encode_heartbeat(Heartbeat(5, 99, 7)), DEFAULT) is Rejection.SUBJECT
    assert decode_heartbeat(legal_frame()) is Rejection.SUBJECT


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


def agrees(frame: can.Message) -> None:
    """The decoder accepts what the text calls legal, and nothing of it is lost or made up."""
    result = decode(frame, DEFAULT)
    assert isinstance(result, Message) == is_legal_by_the_text(frame, DEFAULT.subject)
    if isinstance(result, Message):
        again = encode(result, FrameFormat(DEFAULT.subject, frame.arbitration_id >> 26))
        assert again.data == frame.data
        assert again.arbitration_id == frame.arbitration_id | 3 << 21
    decode_heartbeat(frame)  # must not raise either


@fixed
@given(messages)
@example(SMALLEST)
@example(LARGEST)
@example(Message(3, 2**23 - 1, 0x007FFFFF, 31))
def test_any_single_corrupted_bit(message: Message) -> None:
    frame = encode(message, DEFAULT)
    for bit in range(29):
        agrees(changed(frame.data.hex(), arbitration_id=frame.arbitration_id ^ 1 << bit))
    for bit in range(64):
        data = (int.from_bytes(frame.data, "little") ^ 1 << bit).to_bytes(8, "little")
        agrees(changed(data.hex(), arbitration_id=frame.arbitration_id))
    for flag in ("is_error_frame", "is_remote_frame", "is_fd", "is_extended_id"):
        agrees(changed(frame.data.hex(), **{flag: not getattr(frame, flag)}))


@fixed
@given(
    st.builds(
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
)
def test_anything_a_bus_can_deliver(frame: can.Message) -> None:
    agrees(frame)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("sender", -1),
        ("sender", 128),
        ("x_hat", -1),
        ("x_hat", 2**23 + 1),
        ("alpha", -1),
        ("alpha", 0x7F800000),
        ("alpha", 0x80000000),
        ("transfer_id", -1),
        ("transfer_id", 32),
    ],
)
def test_an_illegal_message_is_never_encoded(name: str, value: int) -> None:
    message = replace(LARGEST, **{name: value})
    with pytest.raises(ValueError, match=f"{name} is {value}"):
        encode(message, DEFAULT)


@pytest.mark.parametrize(
    ("name", "value"),
    [("sender", 128), ("uptime", 2**32), ("uptime", -1), ("transfer_id", 32), ("vendor_status", 256)],
)
def test_an_illegal_heartbeat_is_never_encoded(name: str, value: Any) -> None:
    heartbeat = replace(Heartbeat(1, 2, 3), **{name: value})
    with pytest.raises(ValueError, match=f"{name} is {value}"):
        encode_heartbeat(heartbeat)


def test_an_illegal_heartbeat_priority_is_refused() -> None:
    with pytest.raises(ValueError, match="priority is 8"):
        encode_heartbeat(Heartbeat(1, 2, 3), priority=8)


@pytest.mark.parametrize(
    ("name", "value"), [("subject", -1), ("subject", 6144), ("priority", 8), ("priority", -1)]
)
def test_an_illegal_format_cannot_be_made(name: str, value: int) -> None:
    with pytest.raises(ValueError, match=f"{name} is {value}"):
        replace(DEFAULT, **{name: value})


@fixed
@given(st.integers(0, LARGEST_ALPHA))
@example(0)
@example(1)
@example(LARGEST_ALPHA)
def test_floats_and_bits(bits: int) -> None:
    value = float_of(bits)
    assert value == float(np.uint32(bits).view(np.float32))
    assert bits_of(value) == bits


def test_bits_of_rounds_to_nearest_even_and_refuses_what_is_too_large() -> None:
    assert bits_of(1 + 2**-24) == 0x3F800000
    assert bits_of(1 + 3 * 2**-24) == 0x3F800002
    with pytest.raises(OverflowError):
        bits_of(2.0**128)
