"""The frame codec against the codec in C, on any frame at all.

The C has what a robot needs: it encodes estimates, heartbeats, telemetry; decodes estimates, commands.
"""

from __future__ import annotations

import random
import re
from collections import Counter
from copy import copy
from dataclasses import astuple, fields, replace
from enum import Enum
from fractions import Fraction
from itertools import product
from pathlib import Path
from typing import Any

import can
import numpy as np
import pytest
from cffi import FFI
from hypothesis import example, given, settings
from hypothesis import strategies as st

from mcp_asdf.fixed_point import ALPHA_MAX, alpha_from_word, alpha_word_from_float
from mcp_asdf_tools.bus import frames
from mcp_asdf_tools.bus.estimates import decode_estimates
from mcp_asdf_tools.bus.frames import (
    Action,
    Command,
    FrameFormat,
    Health,
    Heartbeat,
    Message,
    Mode,
    Rejection,
    Telemetry,
    alpha_bits,
    binary32_of,
    bits_of,
    decode,
    decode_any,
    encode,
    float_of,
    word_of,
)
from messages import DEFAULT, FRAMES, KINDS, as_decoded, drawn, encoded
from robots import ALPHA_ONE
from support import ROOT, draws, require, run

pytestmark = pytest.mark.random

LARGEST_BITS = 0x7F7FFFFF
UNIT = Fraction(1, 2**24)
SEED = 20260
SOURCE = ROOT / "c_ref/src/mcp_asdf_frame.c"
HEADER = SOURCE.with_suffix(".h").read_text(encoding="utf-8")

# Fixed examples in every run; a failure prints the one that shows it.
fixed = settings(derandomize=True, deadline=None, max_examples=draws(300))


def plain(value: Any) -> Any:
    return value.value if isinstance(value, Enum) else value


class Codec:
    """The C codec. A result is a rejection's name, or the values of a message in Python's order."""

    def __init__(self, library: Path) -> None:
        self.ffi = FFI()
        text = re.sub(r"/\*.*?\*/", "", HEADER, flags=re.DOTALL)
        text = re.sub(r"^#ifdef __cplusplus$.*?^#endif$", "", text, flags=re.DOTALL | re.MULTILINE)
        self.ffi.cdef(re.sub(r"^#.*$", "", text, flags=re.MULTILINE))
        self.lib = self.ffi.dlopen(str(library))
        status = self.ffi.typeof("mcp_asdf_frame_status_t")
        self.statuses = {name.removeprefix("MCP_ASDF_FRAME_"): n for name, n in status.relements.items()}
        self._name_of = {code: name.removeprefix("ERR_") for name, code in self.statuses.items()}

    def decode(self, kind: type, frame: can.Message) -> str | tuple[int, ...]:
        subject, name, *_ = KINDS[kind]
        flags = frame.is_remote_frame * 2 | frame.is_error_frame * 4 | frame.is_fd * 8
        c_frame: Any = self.ffi.new("mcp_asdf_frame_t *")
        c_frame.id, c_frame.flags = frame.arbitration_id, flags | (not frame.is_extended_id)
        c_frame.length, c_frame.data = len(frame.data), bytes(frame.data[:8]).ljust(8, b"\xe0")
        message = self.ffi.new(f"mcp_asdf_{name}_t *")
        status = getattr(self.lib, f"mcp_asdf_decode_{name}")(message, subject, c_frame)
        return self._name_of[status] if status else tuple(getattr(message, m) for m in members(kind))

    def encode(self, message: Any) -> tuple[int, bytes] | None:
        """Identifier and data with the default format; None if the message is refused."""
        name, frame = KINDS[type(message)].name, self.ffi.new("mcp_asdf_frame_t *")
        c_message = self.ffi.new(f"mcp_asdf_{name}_t *")
        for member, value in zip(members(type(message)), astuple(message), strict=True):
            setattr(c_message, member, plain(value))
        usual = {Message: (3000, 4), Telemetry: (3001, 6)}.get(type(message))
        where = 4 if usual is None else self.ffi.new("mcp_asdf_frame_format_t *", usual)
        if getattr(self.lib, f"mcp_asdf_encode_{name}")(frame, where, c_message):
            return None
        assert (frame.flags, frame.length) == (0, 8)
        return frame.id, bytes(frame.data)


def members(kind: type) -> list[str]:
    return ["node" if item.name == "sender" else item.name for item in fields(kind)]


@pytest.fixture(scope="module")
def codec(tmp_path_factory: pytest.TempPathFactory) -> Codec:
    library = tmp_path_factory.mktemp("codec") / "frame.so"
    warnings = ("-std=c99", "-Wall", "-Wextra", "-Werror")
    run(require("cc", "gcc"), *warnings, "-O2", "-shared", "-fPIC", SOURCE, "-o", library)
    return Codec(library)


def test_the_documented_example() -> None:
    """Robot 42, x_hat 1/2, alpha 1, first transfer."""
    frame = encode(Message(42, 2**22, ALPHA_ONE, 0), DEFAULT, timestamp=1.5)
    assert (frame.arbitration_id, frame.data.hex()) == (0x106BB82A, "0000400000803fe0")
    assert (frame.timestamp, frame.dlc, frame.is_extended_id, frame.is_rx) == (1.5, 8, True, False)
    assert not (frame.is_fd or frame.is_remote_frame or frame.is_error_frame)
    assert frame.arbitration_id == FrameFormat(3000, 4).identifier(42)
    assert FrameFormat(6143, 7).identifier(127) == 0x1C77FF7F
    assert {frames.frame_as_text(frame): frame for frame in FRAMES.values()} == FRAMES


# Both ways, and the same in C


def value_of(word: int) -> Fraction:
    """The value of an alpha word."""
    return ((word >> 8) << word % 32) * UNIT


@settings(fixed, max_examples=draws(1500))
@given(drawn(beyond=3))
@example(Message(127, 2**23, ALPHA_MAX, 31))
@example(Telemetry(0, 0, frames.MIN_B_HAT, 0, 0))
@example(Command(127, 2**32 - 1, frames.EVERY_ROBOT, Action.SETTLE, 31))
def test_encoders_make_the_same_frames_and_refuse_the_same(codec: Codec, message: Any) -> None:
    """And decoding undoes encoding, but for the choice of alpha's shift."""
    try:
        frame = encoded(message)
    except ValueError:
        is_legal = is_legal_command(message) if isinstance(message, Command) else codec.encode(message)
        assert not is_legal
        return
    if isinstance(message, Command):
        assert is_legal_command(message)
    else:
        assert codec.encode(message) == (frame.arbitration_id, bytes(frame.data))
    if isinstance(message, Message):
        bits, word = alpha_bits(frame), message.alpha
        assert bits == binary32_of(word) == bits_of(float_of(bits))
        assert Fraction(float_of(bits)) == value_of(word) == Fraction(alpha_from_word(word))
    assert KINDS[type(message)].decode(frame) == decode_any_kind(frame) == as_decoded(message)


def is_legal_command(message: Command) -> bool:
    return message.sender <= 127 and (message.target <= 127 or message.target == frames.EVERY_ROBOT)


def decode_any_kind(frame: can.Message) -> Any:
    """By what it holds; ``decode_any`` leaves commands to those who obey them."""
    found = decode_any(frame, DEFAULT)
    return frames.decode_command(frame) if found is Rejection.SUBJECT else found


def test_what_c_cannot_hold_is_refused() -> None:
    refused: list[tuple[Any, str, int]] = [
        (Message(0, 0, 0, 0), "alpha", 2**32),
        (Message(0, 0, 0, 0), "transfer_id", 32),
        (Message(0, 0, 0, 0), "x_hat", -1),
        (Heartbeat(0, 0, 0), "uptime", 2**32),
        (Heartbeat(0, 0, 0), "vendor_status", 256),
        (Telemetry(0, 0, 16, 0, 0), "updates", 256),
        (Command(0, 0, 0, Action.SETTLE, 0), "tick", 2**32),
    ]
    for message, name, value in refused:
        with pytest.raises(ValueError, match=f"{name} is {value}; it must be 0 to "):
            encoded(replace(message, **{name: value}))
    for wrong in ({"subject": 6144}, {"subject": -1}, {"priority": 8}, {"priority": -1}):
        ((name, value),) = wrong.items()
        with pytest.raises(ValueError, match=f"{name} is {value}; it must be 0 to "):
            FrameFormat(**wrong)


LEGAL = (
    encoded(Message(42, 2**22, ALPHA_ONE, 5)),
    encoded(Heartbeat(42, 99, 5)),
    encoded(Telemetry(42, 2**22, 2**23, 7, 5)),
    encoded(Command(42, 1000, 17, Action.SETTLE, 5)),
)


def altered(frame: can.Message, **changes: Any) -> can.Message:
    """A copy of the frame with other fields."""
    names = ("arbitration_id", "data", "is_extended_id", "is_remote_frame", "is_error_frame", "is_fd")
    return can.Message(**{name: getattr(frame, name) for name in names} | changes)


def mutated(choose: random.Random) -> can.Message:
    """A legal frame with up to three things changed: enough to reach every check and the one behind it."""
    frame = choose.choice(LEGAL)
    for _ in range(choose.randrange(4)):
        data = bytearray(frame.data)
        if data:
            flip = choose.choice((1 << choose.randrange(8), choose.randrange(256)))
            data[choose.randrange(len(data))] ^= flip
        changes: tuple[dict[str, Any], ...] = (
            {"data": data},
            {"data": data[:3] + bytes([choose.choice((0, 255))] * 3) + data[6:]},
            {"data": choose.randbytes(7) + bytes([choose.choice((0xE0, 0xFF, 0x60))])},
            {"data": choose.randbytes(choose.choice((0, 7, 8, 9, 12, 64)))},
            {"arbitration_id": frame.arbitration_id ^ 1 << choose.randrange(29)},
            {"arbitration_id": choose.randrange(2**29)},
            {choose.choice(("is_remote_frame", "is_error_frame", "is_fd")): True},
            {"is_extended_id": False},
        )
        frame = altered(frame, **choose.choice(changes))
    return frame


def agrees(codec: Codec, frame: can.Message) -> list[str]:
    """C and Python say the same of a frame; returns what Python says of it as each kind."""
    seen = []
    for kind, (_, name, _, decode_kind) in KINDS.items():
        found = decode_kind(frame)
        result = found.name if isinstance(found, Rejection) else tuple(map(plain, astuple(found)))
        if kind in (Message, Command):
            assert codec.decode(kind, frame) == result, (name, frame)
        seen.append(result if isinstance(result, str) else name)
    return seen


def test_random_mutations_of_legal_frames(codec: Codec) -> None:
    seen: Counter[str] = Counter()
    for number in range(draws(20_000)):
        seed = f"{SEED}.{number}"
        try:
            seen.update(agrees(codec, mutated(random.Random(seed))))
        except AssertionError as error:
            raise AssertionError(f"replay: agrees(codec, mutated(random.Random({seed!r})))") from error
    # Every verdict came up, so none was compared in words only.
    assert set(seen) == {rejection.name for rejection in Rejection} | {kind.name for kind in KINDS.values()}


def test_many_frames_are_decoded_at_once_as_each_is() -> None:
    """Those without 8 bytes are never estimates, whatever is flipped."""
    draw = random.Random(SEED)
    arrivals = [mutated(draw) for _ in range(draws(4000))]
    flips = [draw.choice((0, 0, 1 << draw.randrange(64), draw.getrandbits(64))) for _ in arrivals]
    ends = (0, bits_of(2.0**-24), bits_of(2.0**31) - 1, bits_of(2.0**31), LARGEST_BITS, frames.INFINITE_ALPHA)
    for x_hat, bits in product((2**23, 2**23 + 1), ends):
        arrivals.append(altered(LEGAL[0], data=(x_hat | bits << 24 | 0xE0 << 56).to_bytes(8, "little")))
        flips.append(0)
    rows, is_estimate = decode_estimates(arrivals, DEFAULT, np.array(flips, np.uint64))
    assert rows.shape == (len(arrivals), 3)
    found = zip(arrivals, flips, is_estimate.tolist(), rows.tolist(), strict=True)
    for frame, flip, is_one, row in found:
        came = copy(frame)
        if len(frame.data) == 8:
            came.data = bytearray((int.from_bytes(frame.data, "little") ^ flip).to_bytes(8, "little"))
        one = decode(came, DEFAULT)
        assert is_one == isinstance(one, Message), f"random.Random({SEED})"
        if isinstance(one, Message):
            assert row == [one.sender, one.x_hat, one.alpha]


# Alpha: the firmware's word and binary32


# design: R16
@settings(fixed, max_examples=draws(1000))
@given(st.one_of(st.integers(0, LARGEST_BITS), st.integers(bits_of(2.0**-26), bits_of(2.0**33))))
@example(0)
@example(1)
@example(0x007FFFFF)
@example(0x00800000)
@example(LARGEST_BITS)
@example(bits_of(2.0**31))
@example(bits_of(2.0**31) - 1)
@example(bits_of(2.0**-24))
def test_a_binary32_number_is_rounded_down_to_the_grid_or_saturated(bits: int) -> None:
    value = Fraction(float(np.uint32(bits).view(np.float32)))
    word = word_of(bits)
    assert value_of(word) == min(value // UNIT * UNIT, value_of(ALPHA_MAX))
    assert word & 0xE0 == 0, "spare bits"
    assert word >> 31 == 1 or word % 256 == 0, "the smallest shift, as the firmware forms it"
    assert word == alpha_word_from_float(float(value))


def test_bits_of_rounds_to_nearest_even_and_refuses_what_is_too_large() -> None:
    assert (bits_of(1 + 2**-24), bits_of(1 + 3 * 2**-24)) == (0x3F800000, 0x3F800002)
    with pytest.raises(OverflowError):
        bits_of(2.0**128)


# One numbering in Python and in C


def test_constants_are_the_same(codec: Codec) -> None:
    only_c = {"OK", "ERR_NODE", "ERR_FORMAT", "ERR_HEALTH"}  # Python raises UsageError for these
    expected = {f"ERR_{rejection.name}": rejection.value for rejection in Rejection}
    assert {name: n for name, n in codec.statuses.items() if name not in only_c} == expected
    for enum, prefix, python in (
        ("health", "HEALTH_", Health),
        ("mode", "MODE_", Mode),
        ("action", "", Action),
    ):
        numbers = codec.ffi.typeof(f"mcp_asdf_{enum}_t").relements
        assert numbers == {f"MCP_ASDF_{prefix}{member.name}": member.value for member in python}
    macros = dict(re.findall(r"^#define MCP_ASDF_(\w+) (.*?)\s*(?:/\*.*)?$", HEADER, re.MULTILINE))
    for name, usual in (("ESTIMATE", DEFAULT), ("TELEMETRY", frames.TELEMETRY), ("COMMAND", frames.COMMANDS)):
        assert macros[f"FORMAT_{name}"] == f"{{{usual.subject}, {usual.priority}}}"
