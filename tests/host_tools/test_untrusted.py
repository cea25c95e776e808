"""Whatever stands in a file, a line or a frame, it is read or refused in one clear line."""

from __future__ import annotations

import gzip
import re
import resource
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from decimal import Decimal
from functools import cache, partial
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import can
import numpy as np
import pyarrow as pa  # type: ignore[import-untyped]
import pyarrow.parquet as pq  # type: ignore[import-untyped]
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from mcp_asdf_tools.bus.frames import Estimate, FrameFormat, encode_estimate
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.crosscheck.scenario import parse_scenario
from mcp_asdf_tools.experiments import experiment_files
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.experiment_files import STUDIES, read_experiments
from mcp_asdf_tools.experiments.result_files import read_table, stream_experiments
from mcp_asdf_tools.experiments.result_tables import experiments_in, read_metadata, trials_to_table
from mcp_asdf_tools.experiments.trials import run_trials
from mcp_asdf_tools.recording.events import EventsHeader, EventsReader
from mcp_asdf_tools.recording.frame_logs import read_log
from mcp_asdf_tools.swarm.fault_injection.parsing import parse_fault
from mcp_asdf_tools.tables.table_files import check_file, format_c_source, format_json
from mcp_asdf_tools.world.graph import parse_graph
from support import PATIENCE, draws, slow
from wire import record

TABLE = (Decimal("0.05"), 4)
LOGS = (".log", ".asc", ".trc", ".blf")


pytestmark = pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
"""Readers of python-can that refuse a file leave closing it to the garbage collector."""


class Parser(NamedTuple):
    """One way in for what others have written: a reader of files with a suffix, and what it takes."""

    suffix: str
    read: Callable[[Path], object]
    sound: Callable[[], bytes]


def read_events(path: Path) -> list[object]:
    with EventsReader(path) as reader:
        return list(reader.entries())


def events() -> bytes:
    header = EventsHeader((record(0, "native", 0.95), record(7, "mirror")), 5, FrameFormat(17, 2), {"a": 1})
    lines = '[0,1,[7,5000,2147483649],3]\n"186BB92A#0000603333F307E5"\n'
    return (header.to_line() + lines).encode()


def log(suffix: str) -> bytes:
    """A log as python-can writes it."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / f"run{suffix}"
        with can.Logger(path) as take:
            for sender in range(5):
                take(encode_estimate(Estimate(sender, 0x200000, 0x80000001, 3), FrameFormat(), sender * 0.1))
        return path.read_bytes()


def results() -> bytes:
    """A file of two experiments in the present format, one recorded value in ten."""
    held = BytesIO()
    pq.write_table(sound_results(), held)
    return held.getvalue()


@cache
def sound_results() -> pa.Table:
    short = Experiment(robots=4, flawed=1, filter="asdf-plus", steps=30, filter_period=10, trials=2)
    both = (short, replace(short, filter="robust"))
    return pa.concat_tables([trials_to_table(run_trials(each, 0, 2, sampling_interval=10)) for each in both])


def read_results(path: Path) -> object:
    """All that commands take from results."""
    table = read_table(path)
    at_once = [[*trials.scores().values()] for trials in experiments_in(table)]
    assert np.array_equal(at_once, [[*trials.scores().values()] for trials in stream_experiments(path)])
    return read_metadata(table)["versions"]


def read_logged(path: Path) -> list[object]:
    return list(read_log(path))


def reader_of_text(read: Callable[[str], object]) -> Callable[[Path], object]:
    return lambda path: read(path.read_text("latin-1"))


SCENARIO = b"table:0.05:30,robot:5:4080218931:1000:64:0,step:1,settle"
PARSERS = {
    "table in JSON": Parser(".json", check_file, lambda: format_json(*TABLE).encode()),
    "table in C": Parser(".c", check_file, lambda: format_c_source(*TABLE).encode()),
    **{f"log {each}": Parser(each, read_logged, partial(log, each)) for each in LOGS},
    "log .log.gz": Parser(".log.gz", read_logged, lambda: gzip.compress(log(".log"), mtime=0)),
    "events": Parser(".events", read_events, events),
    "compressed events": Parser(".events", read_events, lambda: gzip.compress(events(), mtime=0)),
    "TOML": Parser(".toml", read_experiments, (STUDIES / "physical.toml").read_bytes),
    "results": Parser(".parquet", read_results, results),
    "graph": Parser(".txt", parse_graph, lambda: b"3 5\n3 > 7 # one way\n"),
    "fault": Parser(".txt", reader_of_text(parse_fault), lambda: b"delay=0.5,ticks=3,from=9,robots=0+3-5"),
    "scenario": Parser(".txt", reader_of_text(parse_scenario), lambda: SCENARIO),
}

SIGNS = [bytes([each]) for each in b"\0\xff\r\n \"'[{]},:#-"]
WORDS = (
    b"/* */ nan inf 1e999999999 -1 1e-999999999 0x 1_0 true null \xc3\xa9 [[grid]] ? \xff\xff\xff\x7f".split()
)
DEEP = [b"9" * 5000, *(each * 3000 for each in (b"[", b"{", b"- ")), b"&a [*a, *a]"]
HOSTILE = [b"", *SIGNS, *WORDS, *DEEP]
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


@pytest.mark.random
@pytest.mark.parametrize("name", PARSERS)
def test_what_is_sound_is_read_and_what_is_not_is_refused_in_a_line(name: str, tmp_path: Path) -> None:
    parser = PARSERS[name]
    path, sound = tmp_path / f"file{parser.suffix}", parser.sound()
    assert try_to_read(parser, path, sound) == ""

    @settings(max_examples=draws(120), deadline=None, suppress_health_check=list(HealthCheck), database=None)
    @given(st.one_of(damaged(sound), st.binary(max_size=40)))
    def always(data: bytes) -> None:
        try_to_read(parser, path, data)

    always()


# ---- Results that look like ours ----


@pytest.mark.parametrize(("right", "wrong"), [(b"robots", b"\xffobots"), (b"mcp-asdf", b"mcp-asdg")])
def test_results_whose_two_schemas_differ_are_read_or_refused(
    right: bytes, wrong: bytes, tmp_path: Path
) -> None:
    """A file has one for Parquet and one for Arrow, in base64; other names do not all read as text."""
    data = results().replace(right, wrong)
    said = try_to_read(PARSERS["results"], tmp_path / "run.parquet", data)
    assert (said != "") == (right == b"robots")


# ---- What has no end, or too much of everything ----


@pytest.mark.parametrize("stamp", ["nan", "inf", "1e308", "-1e300"])
def test_a_frame_has_a_time(stamp: str, tmp_path: Path) -> None:
    said = try_to_read(PARSERS["log .log"], tmp_path / "run.log", f"({stamp}) vcan0 186BB92A#00\n".encode())
    assert f"holds no frame: line 1, '({stamp}) vcan0 186BB92A#00', is none of candump's" in said


def limited() -> None:
    """Memory of this test's child process."""
    resource.setrlimit(resource.RLIMIT_AS, (2**32, 2**32))


@pytest.mark.parametrize("case", ["device as table", *slow(["device as graph", "200,000 grids"])])
def test_too_much_is_refused_soon(case: str, tmp_path: Path) -> None:
    """By the command, in bounded memory."""
    grid, endless = tmp_path / "grid.toml", "/dev/zero"
    words = ["sweep", str(grid), "--output", str(tmp_path / "run.parquet")]
    if case == "device as graph":
        words = ["swarm", "--topology", "graph", "--graph", endless]
    elif case == "device as table":
        (tmp_path / "endless.c").symlink_to(endless)
        words = ["table", "--check", str(tmp_path / "endless.c")]
    else:
        grid.write_text("steps = 9\n" + "[[grid]]\n" * 200_000)
    command = [sys.executable, "-m", "mcp_asdf_tools.cli.main", *words]
    done = subprocess.run(
        command, capture_output=True, text=True, preexec_fn=limited, timeout=PATIENCE, check=False
    )
    assert done.returncode == 2, done.stderr
    assert re.search("than 16777216 bytes|than 100000 experiments", done.stderr)
    assert done.stderr.count("\n") == 2


def test_all_grids_of_a_file_count(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(experiment_files, "MAX_EXPERIMENTS", 5)
    (tmp_path / "grid.toml").write_text("seed = [1, 2, 3]\n[[grid]]\n[[grid]]\nrobots = 5\n")
    with pytest.raises(UsageError, match=r"grid.toml makes more than 5 experiments; give fewer"):
        read_experiments(tmp_path / "grid.toml")
