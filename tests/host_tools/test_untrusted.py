"""Whatever stands in a file, a line or a frame, it is read or refused in one clear line, in linear time."""

from __future__ import annotations

import gc
import gzip
import subprocess
import time
import tracemalloc
from collections.abc import Callable
from dataclasses import dataclass
from decimal import Decimal
from io import BytesIO, StringIO
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory

import can
import pyarrow as pa  # type: ignore[import-untyped]
import pyarrow.parquet as pq  # type: ignore[import-untyped]
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from intelhex import IntelHex  # type: ignore[import-untyped]

from mcp_asdf_tools.bus.frames import (
    Command,
    FrameFormat,
    Message,
    Rejection,
    Telemetry,
    decode,
    decode_command,
    decode_telemetry,
    encode,
)
from mcp_asdf_tools.bus.slcan_server import frame_of, line_of
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.crosscheck.scenario import parse_scenario
from mcp_asdf_tools.experiments.experiment_files import STUDIES, read_experiments
from mcp_asdf_tools.experiments.results import experiments_in, read_table
from mcp_asdf_tools.recording.frame_logs import read_log
from mcp_asdf_tools.recording.input_log import InputLogHeader, InputLogReader
from mcp_asdf_tools.swarm.fault_spec import parse_fault
from mcp_asdf_tools.tables.image_scan import verify_image
from mcp_asdf_tools.tables.table_files import c_text, check_file, json_text
from mcp_asdf_tools.tables.thresholds import generate
from mcp_asdf_tools.world.topology import graph_of
from support import ROOT
from wire import record

TABLE = (Decimal("0.05"), 4)


pytestmark = pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
"""Readers of python-can that refuse a file leave closing it to the garbage collector."""


@dataclass(frozen=True)
class Parser:
    """One way in for what others have written.

    Attributes:
        suffix: Of its files.
        read: All of it; raises UsageError.
        sound: Contents that it takes.
        length: Bytes of a text that takes some time to read.
    """

    suffix: str
    read: Callable[[Path], object]
    sound: Callable[[], bytes]
    length: int = 120_000


def read_input_log(path: Path) -> list[object]:
    with InputLogReader(path) as reader:
        return list(reader.lines())


def input_log() -> bytes:
    header = InputLogHeader((record(0, "native", 0.95), record(7, "mirror")), 5, FrameFormat(17, 2), {"a": 1})
    events = '[0,1,[7,5000,2147483649],3]\n"186BB92A#0000603333F307E5"\n'
    return (header.line() + events).encode()


def log(suffix: str) -> Callable[[], bytes]:
    """A log as python-can writes it."""

    def write() -> bytes:
        with TemporaryDirectory() as folder:
            path = Path(folder) / f"run{suffix}"
            with can.Logger(path) as take:
                for sender in range(5):
                    take(encode(Message(sender, 0x200000, 0x80000001, 3), FrameFormat(), sender * 0.1))
            return path.read_bytes()

    return write


def results() -> bytes:
    held = BytesIO()
    pq.write_table(pa.table({"seed": [1]}).replace_schema_metadata({b"mcp-asdf": b'{"format": 1}'}), held)
    return held.getvalue()


def firmware() -> bytes:
    """An ELF file with a table in it, as a compiler makes one."""
    with TemporaryDirectory() as folder:
        made = Path(folder) / "t.o"
        source = ROOT / "tables/t_table_omega05_q30.c"
        subprocess.run(("gcc", "-c", f"-I{ROOT}/c_ref/src", source, "-o", made), check=True)
        return made.read_bytes()


def intel_hex() -> bytes:
    image, text = IntelHex(), StringIO()
    image.puts(0x8000, b"".join(word.to_bytes(4, "little") for word in generate(*TABLE).words()))
    image.write_hex_file(text)
    return text.getvalue().encode("ascii")


PARSERS = {
    "table in JSON": Parser(".json", check_file, lambda: json_text(*TABLE).encode()),
    "table in C": Parser(".c", check_file, lambda: c_text(*TABLE).encode()),
    "ELF": Parser(".elf", verify_image, firmware),
    "Intel HEX": Parser(".hex", verify_image, intel_hex),
    "binary image": Parser(
        ".bin", verify_image, lambda: b"".join(w.to_bytes(4, "big") for w in generate(*TABLE).words())
    ),
    **{
        f"log {each}": Parser(each, lambda path: list(read_log(path)), log(each))
        for each in (".log", ".asc", ".csv", ".trc", ".blf")
    },
    "log .log.gz": Parser(
        ".log.gz", lambda path: list(read_log(path)), lambda: gzip.compress(log(".log")(), mtime=0)
    ),
    "input_log": Parser(".events", read_input_log, input_log),
    "TOML": Parser(".toml", read_experiments, (STUDIES / "physical.toml").read_bytes, 8000),
    "results": Parser(".parquet", lambda path: experiments_in(read_table(path)), results),
    "graph": Parser(".txt", graph_of, lambda: b"3 5\n3 > 7 # one way\n"),
    "fault": Parser(
        ".txt",
        lambda path: parse_fault(path.read_text("latin-1")),
        lambda: b"delay=0.5,ticks=3,from=100,robots=0+3-5",
    ),
    "scenario": Parser(
        ".txt",
        lambda path: parse_scenario(path.read_text("latin-1")),
        lambda: b"table:0.05:30:3:9,robot:5:4080218931:1000:64:0,step:1,settle",
    ),
}

HOSTILE = [
    *(
        b"",
        b"\0",
        b"\xff",
        b"\r",
        b"\n",
        b" ",
        b'"',
        b"'",
        b"[",
        b"{",
        b"]",
        b"}",
        b",",
        b":",
        b"#",
        b"-",
        b"/*",
        b"*/",
    ),
    *(
        b"nan",
        b"inf",
        b"1e999999999",
        b"-1",
        b"1e-999999999",
        b"9" * 5000,
        b"0x",
        b"1_0",
        b"true",
        b"null",
        b"\xc3\xa9",
    ),
    *(
        b"[" * 3000,
        b"{" * 3000,
        b"- " * 3000,
        b"&a [*a, *a]",
        b"? ",
        b"[[grid]]\n",
        b"\x80\0\0\0",
        b"\xff\xff\xff\x7f",
    ),
]
"""Values that stand where they should not."""


@st.composite
def damaged(draw: st.DrawFn, sound: bytes) -> bytes:
    """Sound contents with some pieces gone, doubled or replaced."""
    data = sound
    for _ in range(draw(st.integers(1, 4))):
        begin = draw(st.integers(0, len(data)))
        end = min(len(data), begin + draw(st.integers(0, 12)))
        piece = draw(st.one_of(st.sampled_from(HOSTILE), st.binary(max_size=6), st.just(data[begin:end] * 2)))
        data = data[:begin] + piece + data[end:]
    return data


def try_to_read(parser: Parser, path: Path, data: bytes) -> str:
    """The refusal, or nothing; fails if it is not one clear line."""
    path.write_bytes(data)
    try:
        parser.read(path)
    except UsageError as error:
        said = str(error)
        assert said and said.isprintable() and len(said) < 1000, said
        return said
    return ""


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("untrusted") / "file"


def hold(name: str, file: Path, examples: int) -> None:
    parser = PARSERS[name]
    path, sound = file.with_suffix(parser.suffix), parser.sound()

    @settings(max_examples=examples, deadline=None, suppress_health_check=list(HealthCheck), database=None)
    @given(st.one_of(damaged(sound), st.binary(max_size=40)))
    def always(data: bytes) -> None:
        try_to_read(parser, path, data)

    always()


@pytest.mark.parametrize("name", PARSERS)
def test_what_is_sound_is_read(name: str, file: Path) -> None:
    said = try_to_read(PARSERS[name], file.with_suffix(PARSERS[name].suffix), PARSERS[name].sound())
    assert said == "" or name == "results"


@pytest.mark.parametrize("name", PARSERS)
def test_what_is_not_is_refused_in_a_line(name: str, file: Path) -> None:
    hold(name, file, 15)


@pytest.mark.slow
@pytest.mark.parametrize("name", PARSERS)
def test_what_is_not_is_refused_in_a_line_many_times(name: str, file: Path) -> None:
    hold(name, file, 500)


PATTERNS = [
    *(piece for piece in HOSTILE if len(piece) in range(1, 20)),
    *(
        b"/* ",
        b"0x1 ",
        b"3 5\n",
        b"a = 1\n",
        b"a: 1\n",
        b"a = [",
        b"- a\n",
        b":00000001FF\r\n",
        b"[0,1]\n",
        b"step:1,",
    ),
    b"const uint32_t mcp_asdf_t_table_omega05_q30[33] MCP_ASDF_ROM = {",
    b"(0.000000) vcan0 106BB82A#0000400000803FE0\n",
]
"""Lines that a file may consist of for a long time."""
FACTOR = 16


@pytest.mark.slow
@pytest.mark.parametrize("name", PARSERS)
def test_time_and_memory_grow_with_the_length(name: str, file: Path) -> None:
    parser = PARSERS[name]
    path, sound = file.with_suffix(parser.suffix), parser.sound()
    for pattern, begin in product(PATTERNS, (b"", sound)):
        assert grows_with_the_length(parser, path, begin, pattern), pattern


def grows_with_the_length(parser: Parser, path: Path, begin: bytes, pattern: bytes) -> bool:
    """Compare two lengths, one 16 times the other; what grows as the square is 256 times more.

    Of time, 64 times is taken: another process can slow a reading down, but not in each of three comparisons.
    """
    short, long = (
        begin + pattern * (size // len(pattern)) for size in (parser.length // FACTOR, parser.length)
    )
    if memory(parser, path, long) > max(20e6, 2 * FACTOR * memory(parser, path, short)):
        return False
    return any(
        seconds(parser, path, long) < max(0.2, 4 * FACTOR * seconds(parser, path, short)) for _ in range(3)
    )


def memory(parser: Parser, path: Path, data: bytes) -> int:
    """Most bytes that reading takes."""
    tracemalloc.start()
    try:
        try_to_read(parser, path, data)
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def seconds(parser: Parser, path: Path, data: bytes) -> float:
    """Processor time of reading; collecting garbage takes as long as there are objects in the process."""
    gc.disable()
    begin = time.process_time()
    try:
        try_to_read(parser, path, data)
        return time.process_time() - begin
    finally:
        gc.enable()


# ---- What needs no file ----


@given(st.binary(max_size=30), st.integers(0, 2**29 - 1), st.integers(0, 8))
@example(b"\t", 0, 5)
@example(b"+", 0, 5)
def test_lines_of_frames_are_read_or_not(noise: bytes, identifier: int, length: int) -> None:
    """Each frame that is taken is written again in the same letters."""
    sound = line_of(can.Message(arbitration_id=identifier, data=bytes(length)))[:-1]
    for line in (
        noise,
        sound,
        sound[: length + 3] + noise[:1] + sound[length + 4 :],
        b"T" + noise,
        b"r" + noise,
    ):
        frame = frame_of(line)
        assert frame is None or line_of(frame)[:-1].upper() == line.upper()


@given(st.integers(0, 2**29 - 1), st.binary(max_size=64), st.tuples(*[st.booleans()] * 4))
def test_any_frame_is_a_message_or_has_a_reason(
    identifier: int, data: bytes, flags: tuple[bool, ...]
) -> None:
    is_extended, is_remote, is_error, is_fd = flags
    frame = can.Message(
        arbitration_id=identifier % (1 << 29 if is_extended else 1 << 11),
        data=None if is_remote else data,
        is_extended_id=is_extended,
        is_remote_frame=is_remote,
        is_error_frame=is_error,
        is_fd=is_fd and not is_remote,
    )
    for read in (
        lambda: decode(frame, FrameFormat()),
        lambda: decode_command(frame),
        lambda: decode_telemetry(frame),
    ):
        assert isinstance(read(), Message | Command | Telemetry | Rejection)


def test_a_refusal_is_one_line_that_can_be_printed() -> None:
    said = str(UsageError("cannot read a\n  file: \x1b[2J\ud800" + "9" * 5000 + "; fix it"))
    assert said.startswith("cannot read a file: \\x1b[2J\\ud800999") and said.endswith("999; fix it")
    assert said.isprintable() and len(said) < 1000
