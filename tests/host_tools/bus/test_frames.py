"""The frame codec in Python against the codec in C, on any frame at all.

The C has what a robot needs: it encodes estimates, heartbeats and telemetry, and it decodes estimates and
commands.
"""

from __future__ import annotations

import random
import re
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

from mcp_asdf.fixed_point import ALPHA_MAX, alpha_from_word
from mcp_asdf_tools.bus.alpha_words import (
    alpha_word_from_float32_bits,
    float32_bits,
    float32_bits_from_alpha_word,
    float32_value,
)
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
    decode_frame,
    encode_estimate,
    encode_telemetry,
    format_frame,
)
from messages import (
    DEFAULT_FORMAT,
    FRAMES,
    KINDS,
    any_command,
    any_message,
    any_message_of_robots,
    as_decoded,
    decode_as,
    encoded,
)
from robots import ALPHA_ONE
from support import ROOT, draws, require, run

pytestmark = pytest.mark.random

SEED = 20260
DAMAGED_FRAME_COUNT = draws(20_000)
"""Number of damaged frames that are decoded: 20,000 in ``make verify``, and a tenth in ``make test``."""
C_SOURCE = ROOT / "c_ref/src/mcp_asdf_frame.c"
C_HEADER = C_SOURCE.with_suffix(".h").read_text(encoding="utf-8")
C_FORMATS = {Estimate: (3000, 4), Telemetry: (3001, 6)}
"""Default subject and priority by kind; the C takes a heartbeat's priority alone."""
C_HEARTBEAT_PRIORITY = 4

# Examples are the same in every run; a failure prints the example that failed.
fixed_examples = settings(derandomize=True, deadline=None, max_examples=draws(300))


FLAG_STANDARD_ID, FLAG_REMOTE_FRAME, FLAG_ERROR_FRAME, FLAG_FD_FRAME = 1, 2, 4, 8
"""Flags of a frame in C."""


def c_declarations() -> str:
    """Return the declarations of the C header, without comments, preprocessor and what is for C++."""
    text = re.sub(r"/\*.*?\*/", "", C_HEADER, flags=re.DOTALL)
    text = re.sub(r"^#ifdef __cplusplus$.*?^#endif$", "", text, flags=re.DOTALL | re.MULTILINE)
    return re.sub(r"^#.*$", "", text, flags=re.MULTILINE)


class CCodec:
    """The C codec, called from Python.

    Attributes:
        ffi: Makes objects of C.
        library: The codec's functions.
        statuses: Status codes by name, such as "OK" and "ERR_ALPHA".
    """

    def __init__(self, library: Path) -> None:
        self.ffi = FFI()
        self.ffi.cdef(c_declarations())
        self.library = self.ffi.dlopen(str(library))
        status_codes = self.ffi.typeof("mcp_asdf_frame_status_t").relements
        self.statuses = {name.removeprefix("MCP_ASDF_FRAME_"): code for name, code in status_codes.items()}
        self._rejection_names = {code: name.removeprefix("ERR_") for name, code in self.statuses.items()}

    def decode(self, message_type: type, frame: can.Message) -> str | tuple[int, ...]:
        """Return the values of a message in the order of Python's fields, or the name of the rejection."""
        kind = KINDS[message_type]
        c_message = self.ffi.new(f"mcp_asdf_{kind.name}_t *")
        decode_function = getattr(self.library, f"mcp_asdf_decode_{kind.name}")
        status = decode_function(c_message, kind.subject, self._to_c_frame(frame))
        if status != 0:
            return str(self._rejection_names[status])
        values: tuple[int, ...] = tuple(getattr(c_message, member) for member in c_members(message_type))
        return values

    def _to_c_frame(self, frame: can.Message) -> Any:
        c_frame: Any = self.ffi.new("mcp_asdf_frame_t *")
        c_frame.id = frame.arbitration_id
        c_frame.length = len(frame.data)
        # C keeps 8 bytes. After shorter data come bytes of a valid tail, which must not make the frame valid.
        c_frame.data = bytes(frame.data[:8]).ljust(8, b"\xe0")
        c_frame.flags = 0
        if not frame.is_extended_id:
            c_frame.flags |= FLAG_STANDARD_ID
        if frame.is_remote_frame:
            c_frame.flags |= FLAG_REMOTE_FRAME
        if frame.is_error_frame:
            c_frame.flags |= FLAG_ERROR_FRAME
        if frame.is_fd:
            c_frame.flags |= FLAG_FD_FRAME
        return c_frame

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
        encode_function = getattr(self.library, f"mcp_asdf_encode_{name}")
        if encode_function(c_frame, c_format, c_message) != 0:
            return None
        assert (c_frame.flags, c_frame.length) == (0, 8)
        return c_frame.id, bytes(c_frame.data)


def as_number(value: Any) -> Any:
    """Return an enumerated value's number, and any other value as it is."""
    return value.value if isinstance(value, Enum) else value


def c_members(message_type: type) -> list[str]:
    """Return the members of the C struct, in the order of the fields in Python."""
    return ["node" if field.name == "sender" else field.name for field in fields(message_type)]


@pytest.fixture(scope="module")
def c_codec(tmp_path_factory: pytest.TempPathFactory) -> CCodec:
    """The C codec, compiled without warnings."""
    library = tmp_path_factory.mktemp("codec") / "frame.so"
    warnings = ("-std=c99", "-Wall", "-Wextra", "-Werror")
    run(require("cc", "gcc"), *warnings, "-O2", "-shared", "-fPIC", C_SOURCE, "-o", library)
    return CCodec(library)


# The documented example: robot 42, x_hat 1/2, alpha 1, its first broadcast


def test_the_documented_estimate_has_the_documented_identifier_and_bytes() -> None:
    """The example of README and specification: robot 42 estimates 1/2 with a confidence of 1."""
    half = 2**22  # in units of 2**-23
    frame = encode_estimate(Estimate(sender=42, x_hat=half, alpha=ALPHA_ONE, transfer_id=0), DEFAULT_FORMAT)
    x_hat, alpha, tail_byte = "000040", "0000803f", "e0"  # 0x400000 and 0x3f800000, low bytes first
    assert frame.arbitration_id == 0x106BB82A
    assert frame.data.hex() == x_hat + alpha + tail_byte


def test_the_example_frames_of_the_specification_are_what_robots_send() -> None:
    """The page docs/design.md shows two frames as candump prints them: an estimate and telemetry.

    x is in units of 2**-23, and b_hat in units of 2**-24.
    """
    page = (ROOT / "docs/design.md").read_text(encoding="utf-8")
    estimate = Estimate(sender=42, x_hat=int(0.5 * 2**23), alpha=ALPHA_ONE, transfer_id=0)
    estimate_frame = encode_estimate(estimate, DEFAULT_FORMAT)
    b_hat = int(0.95 * 2**24)
    telemetry = Telemetry(sender=42, x=int(0.75 * 2**23), b_hat=b_hat, updates=7, transfer_id=5)
    telemetry_frame = encode_telemetry(telemetry, TELEMETRY_FORMAT)

    assert f"x_hat = 0.5 with alpha = 1.0, first broadcast: `{format_frame(estimate_frame)}`; " in page
    assert f"x = 0.75, b_hat = 0.95, 7 updates, transfer id 5: `{format_frame(telemetry_frame)}`." in page


def text_between(start: str, end: str, page: str) -> str:
    """Return the part of a page behind the first ``start`` and before the next ``end``."""
    _, _, behind_start = page.partition(start)
    between, _, _ = behind_start.partition(end)
    return between


def test_the_specification_lists_the_codes_of_the_header_in_their_order() -> None:
    """A code, such as -23, is a reason to refuse a frame. The C header defines it as in ``= -23``."""
    page = (ROOT / "docs/design.md").read_text(encoding="utf-8")
    section = text_between("### What a receiver refuses\n", "###", page)
    codes_of_section = re.findall(r"-\d\d\b", section)
    codes_of_header = re.findall(r"= (-\d\d)\b", C_HEADER)
    assert codes_of_section == codes_of_header


def test_an_estimate_is_a_classic_data_frame_with_an_extended_identifier_and_its_time() -> None:
    """Extended identifiers have 29 bits. Python-can's ``is_rx`` is true for frames that others sent."""
    estimate = Estimate(sender=42, x_hat=2**22, alpha=ALPHA_ONE, transfer_id=0)
    frame = encode_estimate(estimate, DEFAULT_FORMAT, timestamp=1.5)
    assert frame.is_extended_id
    assert frame.dlc == 8
    assert not (frame.is_fd or frame.is_remote_frame or frame.is_error_frame or frame.is_rx)
    assert frame.timestamp == 1.5


@pytest.mark.parametrize(
    ("subject", "priority", "node", "identifier"), [(3000, 4, 42, 0x106BB82A), (6143, 7, 127, 0x1C77FF7F)]
)
def test_the_identifier_of_a_frame_holds_subject_priority_and_node(
    subject: int, priority: int, node: int, identifier: int
) -> None:
    """It is priority * 2**26 + 0x600000 (two bits that are always 1) + subject * 2**8 + node.

    The subject, here the default and the largest one, is the kind of the message in Cyphal.
    """
    assert FrameFormat(subject, priority).identifier(node) == identifier


@pytest.mark.parametrize(("text_of_candump", "frame"), FRAMES.items(), ids=FRAMES)
def test_a_frame_is_written_as_candump_writes_it(text_of_candump: str, frame: can.Message) -> None:
    """The frames have 11 or 29 bits of identifier, or are a remote frame or an error frame."""
    assert format_frame(frame) == text_of_candump


# Encoders, in Python and in C


def encode_in_python(message: Any) -> tuple[int, bytes] | None:
    """Return identifier and data of the message's frame; None if the message is refused."""
    try:
        frame = encoded(message)
    except ValueError:
        return None
    return frame.arbitration_id, bytes(frame.data)


@settings(fixed_examples, max_examples=draws(800))
@given(any_message_of_robots(beyond=3))
@example(Estimate(sender=127, x_hat=2**23, alpha=ALPHA_MAX, transfer_id=31))
@example(Telemetry(sender=0, x=0, b_hat=MIN_B_HAT, updates=0, transfer_id=0))
def test_c_and_python_encode_the_same_frame_or_both_refuse(c_codec: CCodec, message: Any) -> None:
    """Some values are up to 3 beyond their range, for which both encoders refuse the message.

    Robots send no commands, so C has no encoder for them.
    """
    assert c_codec.encode(message) == encode_in_python(message)


@fixed_examples
@given(any_command(beyond=3))
@example(Command(127, tick=2**32 - 1, target=EVERY_ROBOT, action=Action.SETTLE, transfer_id=31))
def test_a_command_is_encoded_if_and_only_if_its_ids_are_of_robots(command: Command) -> None:
    """Robots have the ids 0 to 127, and as a target every robot has the number 255."""
    is_legal = command.sender <= 127 and (command.target <= 127 or command.target == EVERY_ROBOT)
    assert (encode_in_python(command) is not None) == is_legal


@settings(fixed_examples, max_examples=draws(800))
@given(any_message())
@example(Estimate(sender=127, x_hat=2**23, alpha=ALPHA_MAX, transfer_id=31))
@example(Command(127, tick=2**32 - 1, target=EVERY_ROBOT, action=Action.SETTLE, transfer_id=31))
def test_decoding_returns_what_was_encoded(message: Any) -> None:
    """Only the shift of an estimate's alpha is chosen anew: the smallest for the same value.

    ``as_decoded`` returns the message with that shift.
    """
    frame = encoded(message)
    assert decode_as(type(message), frame) == as_decoded(message)


@fixed_examples
@given(any_message_of_robots())
def test_a_frame_is_decoded_as_the_kind_of_message_that_its_subject_says(message: Any) -> None:
    """``decode_frame`` is not told the kind: an estimate, a heartbeat or telemetry."""
    assert decode_frame(encoded(message), DEFAULT_FORMAT) == as_decoded(message)


@fixed_examples
@given(any_command())
def test_a_command_is_not_taken_for_a_frame_of_a_robot(command: Command) -> None:
    """A command is rejected for its subject, the number of its kind. Robots send no frames of this kind."""
    assert decode_frame(encoded(command), DEFAULT_FORMAT) is Rejection.SUBJECT


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
    """The other values of the message are legal."""
    message_with_illegal_value = replace(message, **{field: value})
    with pytest.raises(ValueError, match=f"{field} is {value}; it must be 0 to "):
        encoded(message_with_illegal_value)


@pytest.mark.parametrize(
    ("field", "value"), [("subject", 6144), ("subject", -1), ("priority", 8), ("priority", -1)]
)
def test_a_format_that_cyphal_forbids_is_refused_by_name(field: str, value: int) -> None:
    """A subject has 13 bits, and a priority has 3. Subjects above 6143 are reserved."""
    with pytest.raises(ValueError, match=f"{field} is {value}; it must be 0 to "):
        FrameFormat(**{field: value})


# Decoders, on any frame

LEGAL_ESTIMATE_FRAME = encoded(Estimate(42, x_hat=2**22, alpha=ALPHA_ONE, transfer_id=5))
LEGAL_FRAMES = (
    LEGAL_ESTIMATE_FRAME,
    encoded(Heartbeat(42, uptime=99, transfer_id=5)),
    encoded(Telemetry(42, x=2**22, b_hat=2**23, updates=7, transfer_id=5)),
    encoded(Command(42, tick=1000, target=17, action=Action.SETTLE, transfer_id=5)),
)


def altered(frame: can.Message, **changes: Any) -> can.Message:
    """Return a copy of the frame with other fields."""
    names = ("arbitration_id", "data", "is_extended_id", "is_remote_frame", "is_error_frame", "is_fd")
    return can.Message(**{name: getattr(frame, name) for name in names} | changes)


def mutated(rng: random.Random) -> can.Message:
    """Return a legal frame with up to three changes: enough to reach every check and the next check."""
    frame = rng.choice(LEGAL_FRAMES)
    for _ in range(rng.randrange(4)):
        frame = altered(frame, **random_change(frame, rng))
    return frame


def random_change(frame: can.Message, rng: random.Random) -> dict[str, Any]:
    """Draw another value of a field of the frame, as a dictionary with one entry."""
    data = bytearray(frame.data)
    if data:
        one_bit, some_bits = 1 << rng.randrange(8), rng.randrange(256)
        data[rng.randrange(len(data))] ^= rng.choice((one_bit, some_bits))
    all_zeros_or_ones = bytes([rng.choice((0, 255))] * 3)
    tail_byte = bytes([rng.choice((0xE0, 0xFF, 0x60))])  # complete with transfer id 0 or 31, or incomplete
    changes: tuple[dict[str, Any], ...] = (
        {"data": data},
        {"data": data[:3] + all_zeros_or_ones + data[6:]},
        {"data": rng.randbytes(7) + tail_byte},
        {"data": rng.randbytes(rng.choice((0, 7, 8, 9, 12, 64)))},
        {"arbitration_id": frame.arbitration_id ^ (1 << rng.randrange(29))},
        {"arbitration_id": rng.randrange(2**29)},
        {rng.choice(("is_remote_frame", "is_error_frame", "is_fd")): True},
        {"is_extended_id": False},
    )
    return rng.choice(changes)


def decode_in_python(message_type: type, frame: can.Message) -> str | tuple[int, ...]:
    """Return the values of a message of this type, or the name of the rejection."""
    message = decode_as(message_type, frame)
    if isinstance(message, Rejection):
        return message.name
    return tuple(as_number(value) for value in astuple(message))


def damaged_frame(number: int) -> can.Message:
    """Return the damaged frame with this number: the same one each time."""
    return mutated(random.Random(f"{SEED}.{number}"))


@pytest.mark.parametrize("message_type", [Estimate, Command])
def test_c_and_python_decode_or_refuse_damaged_frames_alike(c_codec: CCodec, message_type: type) -> None:
    """Both return the same values of a message, or the same reason to refuse the frame.

    Thousands of legal frames are changed at random: their identifier, flags, length or bits of the data.
    """
    for number in range(DAMAGED_FRAME_COUNT):
        frame = damaged_frame(number)
        result_of_c = c_codec.decode(message_type, frame)
        result_of_python = decode_in_python(message_type, frame)
        assert result_of_c == result_of_python, f"replay: damaged_frame({number})"


def test_damaged_frames_are_refused_for_every_reason_and_taken_for_every_kind_of_message() -> None:
    """So the comparison of C and Python reaches everything that a decoder can return."""
    rejections = set()
    decoded_types = set()
    for number in range(DAMAGED_FRAME_COUNT):
        frame = damaged_frame(number)
        for message_type in (Estimate, Heartbeat, Telemetry, Command):
            result = decode_as(message_type, frame)
            if isinstance(result, Rejection):
                rejections.add(result)
            else:
                decoded_types.add(type(result))

    assert rejections == set(Rejection)
    assert decoded_types == {Estimate, Heartbeat, Telemetry, Command}


# Alpha: the firmware's word and binary32


def value_of_word(word: int) -> Fraction:
    """Return the exact value of an alpha word: 24 bits of mantissa, 3 unused bits, 5 bits of shift.

    A mantissa of 1 stands for 2**-24 if the shift is 0.
    """
    mantissa, shift = word >> 8, word % 32
    return Fraction(mantissa << shift, 2**24)


@settings(fixed_examples, max_examples=draws(1000))
@given(st.integers(0, 2**32 - 1) | st.integers(0, 2**24 - 1).map(lambda mantissa: mantissa << 8))
def test_any_confidence_of_a_robot_is_sent_without_rounding(word: int) -> None:
    """A robot has alpha as a word of mantissa and shift, and a frame has it as a float of 32 bits.

    The value is the same in both, and in Python's float, which the tools show.
    """
    bits_in_frame = float32_bits_from_alpha_word(word)
    assert Fraction(float32_value(bits_in_frame)) == value_of_word(word)
    assert Fraction(alpha_from_word(word)) == value_of_word(word)


# design: R16
@settings(fixed_examples, max_examples=draws(1000))
@given(st.integers(0, MAX_FLOAT32_BITS) | st.integers(float32_bits(2.0**-26), float32_bits(2.0**33)))
@example(0)
@example(1)
@example(0x007FFFFF)  # the largest subnormal number
@example(0x00800000)  # the smallest normal number
@example(MAX_FLOAT32_BITS)
@example(float32_bits(2.0**31))
@example(float32_bits(2.0**31) - 1)
@example(float32_bits(2.0**-24))
def test_a_received_confidence_is_rounded_down_to_one_that_a_robot_can_have(bits: int) -> None:
    """Another program may send any float; a robot has multiples of 2**-24 up to a largest one."""
    float_of_frame = float(np.uint32(bits).view(np.float32))  # the same bits, taken as a float
    unit = Fraction(1, 2**24)
    rounded_down = Fraction(float_of_frame) // unit * unit
    word = alpha_word_from_float32_bits(bits)

    assert value_of_word(word) == min(rounded_down, value_of_word(ALPHA_MAX))


# One numbering in Python and in C


def test_reasons_to_refuse_a_frame_have_the_same_numbers_in_c_and_python(c_codec: CCodec) -> None:
    """C has three further errors, for which Python raises UsageError, and the status OK.

    A reason is called ERR_ALPHA, for example, in C, and ALPHA in Python.
    """
    statuses_of_c_alone = {"OK", "ERR_NODE", "ERR_FORMAT", "ERR_HEALTH"}
    numbers_in_python = {f"ERR_{rejection.name}": rejection.value for rejection in Rejection}
    for name, number in c_codec.statuses.items():
        if name not in statuses_of_c_alone:
            assert numbers_in_python[name] == number, name
    assert c_codec.statuses.keys() == numbers_in_python.keys() | statuses_of_c_alone


@pytest.mark.parametrize(
    ("c_enum", "prefix", "python_enum"),
    [("health", "HEALTH_", Health), ("mode", "MODE_", Mode), ("action", "", Action)],
)
def test_health_mode_and_action_have_the_same_numbers_in_c_and_python(
    c_codec: CCodec, c_enum: str, prefix: str, python_enum: type[Enum]
) -> None:
    """These enumerated values are part of a heartbeat or a command.

    C has a prefix before their names, as in MCP_ASDF_MODE_MAINTENANCE.
    """
    numbers_in_c = c_codec.ffi.typeof(f"mcp_asdf_{c_enum}_t").relements
    assert len(numbers_in_c) == len(python_enum)
    for member in python_enum:
        assert numbers_in_c[f"MCP_ASDF_{prefix}{member.name}"] == member.value


@pytest.mark.parametrize(
    ("macro", "frame_format"),
    [("ESTIMATE", DEFAULT_FORMAT), ("TELEMETRY", TELEMETRY_FORMAT), ("COMMAND", COMMAND_FORMAT)],
)
def test_c_and_python_send_by_default_with_the_same_subjects_and_priorities(
    macro: str, frame_format: FrameFormat
) -> None:
    """A line of the C header has both, such as ``#define MCP_ASDF_FORMAT_ESTIMATE {3000, 4}``."""
    subject, priority = frame_format.subject, frame_format.priority
    assert f"\n#define MCP_ASDF_FORMAT_{macro} {{{subject}, {priority}}}" in C_HEADER
