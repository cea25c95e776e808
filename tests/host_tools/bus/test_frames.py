"""The frame codec in Python against the codec in C, on any frame at all.

The C has what a robot needs: it encodes estimates, heartbeats and telemetry, and it decodes estimates and
commands.
"""

from __future__ import annotations

import random
import re
from collections import Counter
from copy import copy
from dataclasses import astuple, fields, replace
from enum import Enum
from fractions import Fraction
from pathlib import Path
from typing import Any

import can
import numpy as np
import pytest
from cffi import FFI
from hypothesis import example, given, settings
from hypothesis import strategies as st

from mcp_asdf.fixed_point import ALPHA_MAX, alpha_from_word, alpha_word_from_float
from mcp_asdf_tools.bus.alpha_words import (
    alpha_word_from_float32_bits,
    float32_bits,
    float32_bits_from_alpha_word,
    float32_value,
)
from mcp_asdf_tools.bus.frame_arrays import decode_estimates
from mcp_asdf_tools.bus.frame_layout import (
    EVERY_ROBOT,
    MAX_FLOAT32_BITS,
    MIN_B_HAT,
    Action,
    Health,
    Mode,
    Rejection,
)
from mcp_asdf_tools.bus.frames import (
    COMMAND_FORMAT,
    TELEMETRY_FORMAT,
    Command,
    Estimate,
    FrameFormat,
    Heartbeat,
    Telemetry,
    alpha_float32_bits,
    decode_command,
    decode_estimate,
    decode_frame,
    encode_estimate,
    format_frame,
)
from messages import DEFAULT, FRAMES, KINDS, as_decoded, drawn, encoded
from robots import ALPHA_ONE
from support import ROOT, draws, require, run

pytestmark = pytest.mark.random

ALPHA_UNIT = Fraction(1, 2**24)
SEED = 20260
C_SOURCE = ROOT / "c_ref/src/mcp_asdf_frame.c"
C_HEADER = C_SOURCE.with_suffix(".h").read_text(encoding="utf-8")
C_DECODES = (Estimate, Command)
C_FORMATS = {Estimate: (3000, 4), Telemetry: (3001, 6)}
"""Default subject and priority by kind; the C takes a heartbeat's priority alone."""
C_HEARTBEAT_PRIORITY = 4

# Fixed examples in every run; a failure prints the one that shows it.
fixed_examples = settings(derandomize=True, deadline=None, max_examples=draws(300))


class CCodec:
    """The C codec. What it decodes is a rejection's name, or the message's values in Python's order."""

    def __init__(self, library: Path) -> None:
        self.ffi = FFI()
        declarations = re.sub(r"/\*.*?\*/", "", C_HEADER, flags=re.DOTALL)
        cplusplus = re.compile(r"^#ifdef __cplusplus$.*?^#endif$", re.DOTALL | re.MULTILINE)
        declarations = cplusplus.sub("", declarations)
        self.ffi.cdef(re.sub(r"^#.*$", "", declarations, flags=re.MULTILINE))
        self.library = self.ffi.dlopen(str(library))
        status_codes = self.ffi.typeof("mcp_asdf_frame_status_t").relements
        self.statuses = {name.removeprefix("MCP_ASDF_FRAME_"): code for name, code in status_codes.items()}
        self._rejection_names = {code: name.removeprefix("ERR_") for name, code in self.statuses.items()}

    def decode(self, message_type: type, frame: can.Message) -> str | tuple[int, ...]:
        kind = KINDS[message_type]
        c_frame: Any = self.ffi.new("mcp_asdf_frame_t *")
        c_frame.id, c_frame.length = frame.arbitration_id, len(frame.data)
        c_frame.flags = (
            (not frame.is_extended_id)
            | frame.is_remote_frame * 2
            | frame.is_error_frame * 4
            | frame.is_fd * 8
        )
        c_frame.data = bytes(frame.data[:8]).ljust(8, b"\xe0")
        c_message = self.ffi.new(f"mcp_asdf_{kind.name}_t *")
        decode_function = getattr(self.library, f"mcp_asdf_decode_{kind.name}")
        status = decode_function(c_message, kind.subject, c_frame)
        if status:
            return str(self._rejection_names[status])
        values: tuple[int, ...] = tuple(getattr(c_message, member) for member in c_members(message_type))
        return values

    def encode(self, message: Any) -> tuple[int, bytes] | None:
        """Return identifier and data with the default format; None if the message is refused."""
        name = KINDS[type(message)].name
        c_message = self.ffi.new(f"mcp_asdf_{name}_t *")
        for member, value in zip(c_members(type(message)), astuple(message), strict=True):
            setattr(c_message, member, as_number(value))
        c_format: Any = C_HEARTBEAT_PRIORITY
        if type(message) in C_FORMATS:
            c_format = self.ffi.new("mcp_asdf_frame_format_t *", C_FORMATS[type(message)])
        c_frame = self.ffi.new("mcp_asdf_frame_t *")
        if getattr(self.library, f"mcp_asdf_encode_{name}")(c_frame, c_format, c_message):
            return None
        assert (c_frame.flags, c_frame.length) == (0, 8)
        return c_frame.id, bytes(c_frame.data)


def as_number(value: Any) -> Any:
    return value.value if isinstance(value, Enum) else value


def c_members(message_type: type) -> list[str]:
    """The members of the C struct, in the order of the fields in Python."""
    return ["node" if field.name == "sender" else field.name for field in fields(message_type)]


@pytest.fixture(scope="module")
def c_codec(tmp_path_factory: pytest.TempPathFactory) -> CCodec:
    library = tmp_path_factory.mktemp("codec") / "frame.so"
    warnings = ("-std=c99", "-Wall", "-Wextra", "-Werror")
    run(require("cc", "gcc"), *warnings, "-O2", "-shared", "-fPIC", C_SOURCE, "-o", library)
    return CCodec(library)


# The documented example: robot 42, x_hat 1/2, alpha 1, its first broadcast


def test_the_documented_estimate_has_the_documented_identifier_and_bytes() -> None:
    frame = encode_estimate(Estimate(42, 2**22, ALPHA_ONE, 0), DEFAULT)
    assert (frame.arbitration_id, frame.data.hex()) == (0x106BB82A, "0000400000803fe0")


def test_an_estimate_is_a_classic_data_frame_with_an_extended_identifier() -> None:
    frame = encode_estimate(Estimate(42, 2**22, ALPHA_ONE, 0), DEFAULT, timestamp=1.5)
    assert (frame.timestamp, frame.dlc, frame.is_extended_id, frame.is_rx) == (1.5, 8, True, False)
    assert not (frame.is_fd or frame.is_remote_frame or frame.is_error_frame)


def test_a_format_s_subject_and_priority_are_in_the_identifier() -> None:
    assert FrameFormat(3000, 4).identifier(42) == 0x106BB82A
    assert FrameFormat(6143, 7).identifier(127) == 0x1C77FF7F


@pytest.mark.parametrize("text", FRAMES)
def test_a_frame_is_written_as_candump_writes_it(text: str) -> None:
    assert format_frame(FRAMES[text]) == text


# Encoders, in Python and in C


@settings(fixed_examples, max_examples=draws(1500))
@given(drawn(beyond=3))
@example(Estimate(127, 2**23, ALPHA_MAX, 31))
@example(Telemetry(0, 0, MIN_B_HAT, 0, 0))
def test_c_and_python_encode_the_same_frame_or_both_refuse(c_codec: CCodec, message: Any) -> None:
    if isinstance(message, Command):
        return  # robots send no commands, so the C has no encoder for them
    try:
        frame = encoded(message)
    except ValueError:
        assert c_codec.encode(message) is None
    else:
        assert c_codec.encode(message) == (frame.arbitration_id, bytes(frame.data))


@fixed_examples
@given(drawn(beyond=3))
@example(Command(127, 2**32 - 1, EVERY_ROBOT, Action.SETTLE, 31))
def test_a_command_is_encoded_exactly_if_its_ids_are_of_robots(message: Any) -> None:
    if not isinstance(message, Command):
        return
    is_legal = message.sender <= 127 and (message.target <= 127 or message.target == EVERY_ROBOT)
    try:
        encoded(message)
    except ValueError:
        assert not is_legal
    else:
        assert is_legal


@settings(fixed_examples, max_examples=draws(1500))
@given(drawn())
@example(Estimate(127, 2**23, ALPHA_MAX, 31))
@example(Command(127, 2**32 - 1, EVERY_ROBOT, Action.SETTLE, 31))
def test_decoding_returns_what_was_encoded(message: Any) -> None:
    """Only the shift of an estimate's alpha is chosen anew: the smallest for the same value."""
    frame = encoded(message)
    assert KINDS[type(message)].decode(frame) == as_decoded(message)


@fixed_examples
@given(drawn())
def test_any_frame_is_decoded_by_its_subject(message: Any) -> None:
    """But for commands, which only those decode who obey them."""
    expected = Rejection.SUBJECT if isinstance(message, Command) else as_decoded(message)
    assert decode_frame(encoded(message), DEFAULT) == expected


@pytest.mark.parametrize(
    ("message", "field", "value"),
    [
        (Estimate(0, 0, 0, 0), "alpha", 2**32),
        (Estimate(0, 0, 0, 0), "transfer_id", 32),
        (Estimate(0, 0, 0, 0), "x_hat", -1),
        (Heartbeat(0, 0, 0), "uptime", 2**32),
        (Heartbeat(0, 0, 0), "vendor_status", 256),
        (Telemetry(0, 0, 16, 0, 0), "updates", 256),
        (Command(0, 0, 0, Action.SETTLE, 0), "tick", 2**32),
    ],
)
def test_a_value_that_no_frame_can_hold_is_refused_by_name(message: Any, field: str, value: int) -> None:
    with pytest.raises(ValueError, match=f"{field} is {value}; it must be 0 to "):
        encoded(replace(message, **{field: value}))


@pytest.mark.parametrize(
    ("field", "value"), [("subject", 6144), ("subject", -1), ("priority", 8), ("priority", -1)]
)
def test_a_format_that_cyphal_forbids_is_refused_by_name(field: str, value: int) -> None:
    with pytest.raises(ValueError, match=f"{field} is {value}; it must be 0 to "):
        FrameFormat(**{field: value})


# Decoders, on any frame

LEGAL_FRAMES = (
    encoded(Estimate(42, 2**22, ALPHA_ONE, 5)),
    encoded(Heartbeat(42, 99, 5)),
    encoded(Telemetry(42, 2**22, 2**23, 7, 5)),
    encoded(Command(42, 1000, 17, Action.SETTLE, 5)),
)


def altered(frame: can.Message, **changes: Any) -> can.Message:
    """Return a copy of the frame with other fields."""
    names = ("arbitration_id", "data", "is_extended_id", "is_remote_frame", "is_error_frame", "is_fd")
    return can.Message(**{name: getattr(frame, name) for name in names} | changes)


def mutated(rng: random.Random) -> can.Message:
    """Return a legal frame with up to three changes: enough to reach every check and the one behind it."""
    frame = rng.choice(LEGAL_FRAMES)
    for _ in range(rng.randrange(4)):
        data = bytearray(frame.data)
        if data:
            bits_to_flip = rng.choice((1 << rng.randrange(8), rng.randrange(256)))
            data[rng.randrange(len(data))] ^= bits_to_flip
        changes: tuple[dict[str, Any], ...] = (
            {"data": data},
            {"data": data[:3] + bytes([rng.choice((0, 255))] * 3) + data[6:]},
            {"data": rng.randbytes(7) + bytes([rng.choice((0xE0, 0xFF, 0x60))])},
            {"data": rng.randbytes(rng.choice((0, 7, 8, 9, 12, 64)))},
            {"arbitration_id": frame.arbitration_id ^ 1 << rng.randrange(29)},
            {"arbitration_id": rng.randrange(2**29)},
            {rng.choice(("is_remote_frame", "is_error_frame", "is_fd")): True},
            {"is_extended_id": False},
        )
        frame = altered(frame, **rng.choice(changes))
    return frame


def check_same_verdict(c_codec: CCodec, frame: can.Message) -> list[str]:
    """Assert that C and Python decode a frame alike; return Python's verdict as each kind, as a word."""
    verdicts = []
    for message_type, kind in KINDS.items():
        content = kind.decode(frame)
        if isinstance(content, Rejection):
            result: Any = content.name
            verdicts.append(content.name)
        else:
            result = tuple(map(as_number, astuple(content)))
            verdicts.append(kind.name)
        if message_type in C_DECODES:
            assert c_codec.decode(message_type, frame) == result, (kind.name, frame)
    return verdicts


def test_c_and_python_decode_damaged_frames_alike(c_codec: CCodec) -> None:
    verdicts: Counter[str] = Counter()
    for number in range(draws(20_000)):
        seed = f"{SEED}.{number}"
        try:
            verdicts.update(check_same_verdict(c_codec, mutated(random.Random(seed))))
        except AssertionError as error:
            replay = f"check_same_verdict(c_codec, mutated(random.Random({seed!r})))"
            raise AssertionError(f"replay: {replay}") from error
    all_verdicts = {rejection.name for rejection in Rejection} | {kind.name for kind in KINDS.values()}
    assert set(verdicts) == all_verdicts, "the frames must reach every verdict"


def flipped(frame: can.Message, bit_flips: int) -> can.Message:
    """Return a copy of a frame with these bits of its 8 bytes inverted; other lengths stay as they are."""
    copied = copy(frame)
    if len(frame.data) == 8:
        copied.data = bytearray((int.from_bytes(frame.data, "little") ^ bit_flips).to_bytes(8, "little"))
    return copied


def estimates_at_the_limits() -> list[can.Message]:
    """Return estimate frames whose x_hat and alpha are the last legal and the first illegal ones."""
    limits_of_alpha = (
        0,
        float32_bits(2.0**-24),
        float32_bits(2.0**31) - 1,
        float32_bits(2.0**31),
        MAX_FLOAT32_BITS,
        MAX_FLOAT32_BITS + 1,
    )
    return [
        altered(LEGAL_FRAMES[0], data=(x_hat | alpha << 24 | 0xE0 << 56).to_bytes(8, "little"))
        for x_hat in (2**23, 2**23 + 1)
        for alpha in limits_of_alpha
    ]


def test_many_frames_are_decoded_as_one_by_one() -> None:
    rng = random.Random(SEED)
    frames = estimates_at_the_limits() + [mutated(rng) for _ in range(draws(4000))]
    bit_flips = [rng.choice((0, 0, 1 << rng.randrange(64), rng.getrandbits(64))) for _ in frames]
    decoded = decode_estimates(frames, DEFAULT, np.array(bit_flips, np.uint64))
    assert decoded.rows.shape == (len(frames), 3)
    for index, (frame, flips) in enumerate(zip(frames, bit_flips, strict=True)):
        expected = decode_estimate(flipped(frame, flips), DEFAULT)
        assert decoded.is_estimate[index] == isinstance(expected, Estimate), (index, frame)
        if isinstance(expected, Estimate):
            assert decoded.rows[index].tolist() == [expected.sender, expected.x_hat, expected.alpha]


def test_no_frames_are_decoded_to_no_estimates() -> None:
    decoded = decode_estimates([], DEFAULT, np.zeros(0, np.uint64))
    assert (decoded.rows.shape, decoded.is_estimate.shape) == ((0, 3), (0,))


# Alpha: the firmware's word and binary32


def value_of_word(word: int) -> Fraction:
    return ((word >> 8) << word % 32) * ALPHA_UNIT


@settings(fixed_examples, max_examples=draws(1000))
@given(st.integers(0, 2**32 - 1) | st.integers(0, 2**24 - 1).map(lambda mantissa: mantissa << 8))
def test_every_alpha_word_is_sent_exactly(word: int) -> None:
    bits = float32_bits_from_alpha_word(word)
    assert Fraction(float32_value(bits)) == value_of_word(word) == Fraction(alpha_from_word(word))


def test_the_frame_holds_the_float_of_its_alpha_word() -> None:
    frame = encode_estimate(Estimate(42, 2**22, ALPHA_ONE, 0), DEFAULT)
    assert alpha_float32_bits(frame) == float32_bits(1.0) == 0x3F800000


# design: R16
@settings(fixed_examples, max_examples=draws(1000))
@given(st.integers(0, MAX_FLOAT32_BITS) | st.integers(float32_bits(2.0**-26), float32_bits(2.0**33)))
@example(0)
@example(1)
@example(0x007FFFFF)
@example(0x00800000)
@example(MAX_FLOAT32_BITS)
@example(float32_bits(2.0**31))
@example(float32_bits(2.0**31) - 1)
@example(float32_bits(2.0**-24))
def test_a_float_off_the_grid_is_rounded_down_and_a_large_one_saturates(bits: int) -> None:
    value = Fraction(float(np.uint32(bits).view(np.float32)))
    word = alpha_word_from_float32_bits(bits)
    assert value_of_word(word) == min(value // ALPHA_UNIT * ALPHA_UNIT, value_of_word(ALPHA_MAX))
    assert word == alpha_word_from_float(float(value))


@fixed_examples
@given(st.integers(0, MAX_FLOAT32_BITS))
def test_a_decoded_alpha_word_has_the_firmware_s_form(bits: int) -> None:
    """Its spare bits are 0, and its shift is the smallest, so that equal numbers are equal words."""
    word = alpha_word_from_float32_bits(bits)
    assert word & 0xE0 == 0
    assert word >> 31 == 1 or word % 256 == 0


def test_a_float_becomes_the_nearest_binary32_number_ties_to_even() -> None:
    assert (float32_bits(1 + 2**-24), float32_bits(1 + 3 * 2**-24)) == (0x3F800000, 0x3F800002)


def test_a_float_beyond_binary32_is_an_error() -> None:
    with pytest.raises(OverflowError):
        float32_bits(2.0**128)


# One numbering in Python and in C


def test_rejections_have_the_codes_of_the_c(c_codec: CCodec) -> None:
    without_rejection = {"OK", "ERR_NODE", "ERR_FORMAT", "ERR_HEALTH"}  # Python raises UsageError for these
    c_codes = {name: code for name, code in c_codec.statuses.items() if name not in without_rejection}
    assert c_codes == {f"ERR_{rejection.name}": rejection.value for rejection in Rejection}


@pytest.mark.parametrize(
    ("c_enum", "prefix", "python_enum"),
    [("health", "HEALTH_", Health), ("mode", "MODE_", Mode), ("action", "", Action)],
)
def test_enumerations_have_the_numbers_of_the_c(
    c_codec: CCodec, c_enum: str, prefix: str, python_enum: type[Enum]
) -> None:
    c_numbers = c_codec.ffi.typeof(f"mcp_asdf_{c_enum}_t").relements
    assert c_numbers == {f"MCP_ASDF_{prefix}{member.name}": member.value for member in python_enum}


@pytest.mark.parametrize(
    ("macro", "frame_format"),
    [("ESTIMATE", DEFAULT), ("TELEMETRY", TELEMETRY_FORMAT), ("COMMAND", COMMAND_FORMAT)],
)
def test_default_formats_are_those_of_the_c(macro: str, frame_format: FrameFormat) -> None:
    macros = dict(re.findall(r"^#define MCP_ASDF_(\w+) (.*?)\s*(?:/\*.*)?$", C_HEADER, re.MULTILINE))
    assert macros[f"FORMAT_{macro}"] == f"{{{frame_format.subject}, {frame_format.priority}}}"


def test_a_command_to_every_robot_is_for_any_target(c_codec: CCodec) -> None:
    frame = encoded(Command(42, 7, EVERY_ROBOT, Action.SETTLE, 0))
    command = decode_command(frame)
    assert isinstance(command, Command)
    assert c_codec.decode(Command, frame) == (42, 7, 255, 3, 0)
