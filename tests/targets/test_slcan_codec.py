"""The slcan codec in C and python-can understand each other, and no text breaks it."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import can
import pytest
from cffi import FFI
from hypothesis import example, given, settings
from hypothesis import strategies as st

from mcp_asdf_tools.bus.slcan_server import line_of
from support import ROOT, draws, require, run
from targets.slcan_model import LONGEST, frame_in

pytestmark = pytest.mark.random

SLCAN = ROOT / "c_ref/ports/slcan"
CORE = ROOT / "c_ref/src"
SEED = 20261121
STANDARD, REMOTE, ERROR, FD = 1, 2, 4, 8

fixed = settings(derandomize=True, deadline=None, max_examples=draws(300))


class Codec:
    """slcan.c, built to stop at undefined behaviour."""

    def __init__(self, folder: Path) -> None:
        library = folder / "slcan.so"
        flags = [
            "-std=c99",
            "-O1",
            "-shared",
            "-fPIC",
            "-fsanitize=undefined",
            "-fsanitize-undefined-trap-on-error",
        ]
        run(require("gcc", "gcc"), *flags, f"-I{CORE}", SLCAN / "slcan.c", "-o", library)
        self.ffi = FFI()
        self.ffi.cdef(
            "typedef struct { uint32_t id; uint8_t flags, length; uint8_t data[8]; } mcp_asdf_frame_t;"
            "uint8_t slcan_write(char line[], const mcp_asdf_frame_t *frame);"
            "bool slcan_read(mcp_asdf_frame_t *frame, const char *line, uint8_t length);"
        )
        self._lib: Any = self.ffi.dlopen(str(library))

    def write(self, frame: can.Message) -> bytes:
        flags = STANDARD * (not frame.is_extended_id) | REMOTE * frame.is_remote_frame
        return self.write_raw(frame.arbitration_id, flags, frame.dlc, bytes(frame.data))

    def write_raw(self, identifier: int, flags: int, length: int, data: bytes) -> bytes:
        frame = self.ffi.new("mcp_asdf_frame_t *", [identifier, flags, length, data.ljust(8, b"\x55")])
        line = self.ffi.new(f"char[{LONGEST + 1}]", b"#" * (LONGEST + 1))
        size = self._lib.slcan_write(line, frame)
        rest = self.ffi.buffer(line)[size:]
        assert rest == b"#" * len(rest), "it wrote more than it says"
        return bytes(self.ffi.buffer(line)[:size])

    def read(self, line: bytes) -> can.Message | None:
        """The frame of a line; the text stands at the end of its memory, and in front of other digits."""
        before = [0xDEADBEEF, 0xA5, 0xA6, bytes(range(8))]
        frame: Any = self.ffi.new("mcp_asdf_frame_t *", before)
        text = self.ffi.new(f"char[{len(line) + 16}]", line + b"0" * 16)
        if not self._lib.slcan_read(frame, text, len(line)):
            assert [frame.id, frame.flags, frame.length, bytes(frame.data)] == before, (
                "a refused line left traces"
            )
            return None
        assert frame.flags & ~(STANDARD | REMOTE) == 0
        is_remote = bool(frame.flags & REMOTE)
        return can.Message(
            arbitration_id=frame.id,
            is_extended_id=not frame.flags & STANDARD,
            is_remote_frame=is_remote,
            dlc=frame.length,
            data=b"" if is_remote else bytes(frame.data)[: frame.length],
            check=True,
        )


@pytest.fixture(scope="module")
def codec(tmp_path_factory: pytest.TempPathFactory) -> Codec:
    return Codec(tmp_path_factory.mktemp("slcan"))


@pytest.fixture(scope="module")
def looped() -> Iterator[can.BusABC]:
    """python-can's slcan with its serial line bent back: tests read what it sends and write what it reads."""
    pytest.importorskip("serial", reason="pyserial, which python-can's slcan needs, is not installed")
    with can.Bus(
        interface="slcan", channel="loop://", sleep_after_open=0, timeout=5, ignore_config=True
    ) as bus:
        assert line_on(bus) == b"O"
        yield bus


def line_on(bus: Any) -> bytes:
    text: bytes = bus.serialPortOrig.read_until(b"\r")
    assert text.endswith(b"\r")
    return text[:-1]


@st.composite
def frames(draw: st.DrawFn) -> can.Message:
    is_long, is_remote = draw(st.booleans()), draw(st.booleans())
    data = draw(st.binary(max_size=8))
    return can.Message(
        arbitration_id=draw(st.integers(0, 0x1FFFFFFF if is_long else 0x7FF)),
        is_extended_id=is_long,
        is_remote_frame=is_remote,
        dlc=len(data),
        data=None if is_remote else data,
    )


def essence(frame: can.Message | None) -> tuple[Any, ...] | None:
    if frame is None:
        return None
    kind = (frame.is_extended_id, frame.is_remote_frame, frame.is_fd, frame.is_error_frame)
    return (frame.arbitration_id, *kind, frame.dlc, bytes(frame.data))


@fixed
@given(frames())
@example(can.Message(arbitration_id=0x106BB82A, data=bytes.fromhex("0000400000803fe0")))
@example(can.Message(arbitration_id=0x1FFFFFFF, data=b"\xff" * 8))
@example(can.Message(arbitration_id=0, is_extended_id=False))
def test_python_can_and_the_codec_understand_each_other(
    codec: Codec, looped: Any, frame: can.Message
) -> None:
    looped.send(frame)
    text = line_on(looped)
    assert codec.write(frame) == text
    assert essence(codec.read(text)) == essence(frame)
    looped.serialPortOrig.write(codec.write(frame) + b"\r")
    assert essence(looped.recv(1)) == essence(frame)


@pytest.mark.parametrize(
    ("identifier", "flags", "length"),
    [
        (1, FD, 8),
        (1, ERROR, 8),
        (1, 0, 9),
        (1, 0, 255),
        (1 << 29, 0, 0),
        (0x800, STANDARD, 0),
        (1, REMOTE, 9),
    ],
)
def test_what_has_no_line_is_not_written(codec: Codec, identifier: int, flags: int, length: int) -> None:
    assert codec.write_raw(identifier, flags, length, b"") == b""


# Lines, and lines with something wrong at one place, which is where a parser may go wrong.
near_lines = st.from_regex(rb"\A[tTrR][0-9a-fA-F]{2,10}[0-9][0-9A-F]{0,18}\Z") | st.builds(
    lambda frame, at, byte: bytes(
        (*(text := line_of(frame)[:-1])[: at % len(text)], byte, *text[at % len(text) + 1 :])
    ),
    frames(),
    st.integers(0, 25),
    st.integers(0, 255),
)


@fixed
@example(b"t1239" + b"0" * 18)
@example(b"t1238" + b"0" * 18)
@example(b"T200000000")
@example(b"t8000")
@example(b"t7fF2abCd")
@given(near_lines | st.binary(max_size=40))
def test_any_text_is_the_frame_that_the_grammar_says_or_none(codec: Codec, text: bytes) -> None:
    assert essence(codec.read(text)) == essence(frame_in(text))
