"""Readers of files and texts that others have written read anything, or refuse it in one clear line."""

from __future__ import annotations

import gzip
import json
import resource
from collections.abc import Callable, Iterator
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

from authors_files import FIXED, trial_content
from events_files import read_entries
from mcp_asdf_tools.bus.frames import Estimate, FrameFormat, encode_estimate
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.crosscheck.scenario import parse_scenario
from mcp_asdf_tools.experiments import experiment_files
from mcp_asdf_tools.experiments.authors_trials import read_trials
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.experiment_files import SHIPPED_STUDIES, read_experiments
from mcp_asdf_tools.experiments.result_files import read_table, stream_experiments
from mcp_asdf_tools.experiments.result_tables import read_metadata, trials_to_table
from mcp_asdf_tools.experiments.trials import run_trials
from mcp_asdf_tools.recording.events import EventsHeader
from mcp_asdf_tools.recording.frame_logs import read_log
from mcp_asdf_tools.swarm.fault_injection.parsing import parse_fault
from mcp_asdf_tools.tables.table_files import check_file, format_c_source, format_json
from mcp_asdf_tools.world.graph import parse_graph
from support import draws
from wire import setup_of_robot

OMEGA, NEIGHBOURS = Decimal("0.05"), 4
"""What the valid table is for."""
LOG_SUFFIXES = (".log", ".asc", ".trc", ".blf")
FORMAT_5_FILE = Path(__file__).with_name("experiments") / "results_format_5.parquet"


pytestmark = pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
"""Readers of python-can that refuse a file leave closing it to the garbage collector."""


class Parser(NamedTuple):
    """A reader of something that others have written.

    Attributes:
        suffix: Suffix of the files that it reads.
        read: Reads a file.
        make_valid: Returns the content of a valid file.
    """

    suffix: str
    read: Callable[[Path], object]
    make_valid: Callable[[], bytes]


def valid_events() -> bytes:
    """Return a file of events with a line of each kind, without compression."""
    robots = (setup_of_robot(0, "native", b_hat=0.95), setup_of_robot(7, "mirror"))
    header = EventsHeader(robots, seed=5, frames=FrameFormat(subject=17, priority=2), parameters={"a": 1})
    line_of_robot_0 = "[0,1,[7,5000,2147483649],3]\n"
    line_of_frame = '"186BB92A#0000603333F307E5"\n'
    return (header.to_line() + line_of_robot_0 + line_of_frame).encode()


def valid_log(suffix: str) -> bytes:
    """Return a log of five estimates as python-can writes it in the format of a suffix."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / f"run{suffix}"
        with can.Logger(path) as write_frame:
            for sender in range(5):
                estimate = Estimate(sender, x_hat=0x200000, alpha=0x80000001, transfer_id=3)
                write_frame(encode_estimate(estimate, FrameFormat(), timestamp=sender * 0.1))
        return path.read_bytes()


def valid_results() -> bytes:
    """Return a file of results with two experiments."""
    file = BytesIO()
    pq.write_table(valid_results_table(), file)
    return file.getvalue()


@cache
def valid_results_table() -> pa.Table:
    """Return a table of results with two experiments, whose values are recorded every 10 steps."""
    first = Experiment(robots=4, flawed=1, filter="asdf-plus", steps=30, filter_period=10, trials=2)
    second = replace(first, filter="robust")
    tables = [
        trials_to_table(run_trials(experiment, first=0, trials=2, sampling_interval=10))
        for experiment in (first, second)
    ]
    return pa.concat_tables(tables)


def read_results(path: Path) -> object:
    """Read all that commands need of results, and return the versions of the software.

    The trials are read from a table of the whole file, and from the file experiment by experiment. They must
    have the same scores.
    """
    table = read_table(path)
    scores_of_table = [trials.scores() for trials in stream_experiments(table)]
    scores_of_file = [trials.scores() for trials in stream_experiments(path)]
    for scores, scores_of_stream in zip(scores_of_table, scores_of_file, strict=True):
        assert scores.keys() == scores_of_stream.keys()
        for name in scores:
            assert np.array_equal(scores[name], scores_of_stream[name]), name
    return read_metadata(table)["versions"]


def valid_authors_trial() -> bytes:
    """Return a trial file of the paper's authors."""
    experiment = replace(FIXED, steps=6, filter_period=2)
    return json.dumps(trial_content(experiment, number=0)).encode()


def read_authors_trial(path: Path) -> object:
    """Read a trial file of the paper's authors, and score its trial."""
    return [trials.scores() for trials in read_trials([path], sampling_interval=1)]


def read_frames(path: Path) -> list[object]:
    """Return all frames of a log."""
    return list(read_log(path))


def reader_of_text(read: Callable[[str], object]) -> Callable[[Path], object]:
    """Return a reader of files for a parser of texts."""
    return lambda path: read(path.read_text("latin-1"))


VALID_SCENARIO = b"table:0.05:30,robot:5:4080218931:1000:64:0,step:1,settle"
PARSERS = {
    "table in JSON": Parser(".json", check_file, lambda: format_json(OMEGA, NEIGHBOURS).encode()),
    "table in C": Parser(".c", check_file, lambda: format_c_source(OMEGA, NEIGHBOURS).encode()),
    **{f"log {suffix}": Parser(suffix, read_frames, partial(valid_log, suffix)) for suffix in LOG_SUFFIXES},
    "log .log.gz": Parser(".log.gz", read_frames, lambda: gzip.compress(valid_log(".log"), mtime=0)),
    "events": Parser(".events", read_entries, valid_events),
    "compressed events": Parser(".events", read_entries, lambda: gzip.compress(valid_events(), mtime=0)),
    "TOML": Parser(".toml", read_experiments, (SHIPPED_STUDIES / "physical.toml").read_bytes),
    "results": Parser(".parquet", read_results, valid_results),
    "results in format 5": Parser(".parquet", read_results, FORMAT_5_FILE.read_bytes),
    "authors' trial": Parser(".json", read_authors_trial, valid_authors_trial),
    "graph": Parser(".txt", parse_graph, lambda: b"3 5\n3 > 7 # one way\n"),
    "fault": Parser(".txt", reader_of_text(parse_fault), lambda: b"delay=0.5,ticks=3,from=9,robots=0+3-5"),
    "scenario": Parser(".txt", reader_of_text(parse_scenario), lambda: VALID_SCENARIO),
}

SIGNS = [bytes([byte]) for byte in b"\0\xff\r\n \"'[{]},:#-"]
WORDS = (
    b"/* */ nan inf 1e999999999 -1 1e-999999999 0x 1_0 true null \xc3\xa9 [[grid]] ? \xff\xff\xff\x7f".split()
)
LONG_OR_NESTED = [b"9" * 5000, b"[" * 3000, b"{" * 3000, b"- " * 3000, b"&a [*a, *a]"]
HOSTILE_PIECES = [b"", *SIGNS, *WORDS, *LONG_OR_NESTED]
"""Bytes that may break a reader wherever they stand."""


@st.composite
def damaged(draw: st.DrawFn, valid_data: bytes) -> bytes:
    """Draw valid data with one to four pieces of it deleted, doubled or replaced."""
    data = valid_data
    for _ in range(draw(st.integers(1, 4))):
        start = draw(st.integers(0, len(data)))
        stop = min(len(data), start + draw(st.integers(0, 12)))
        doubled_piece = data[start:stop] * 2
        new_piece = draw(
            st.one_of(st.sampled_from(HOSTILE_PIECES), st.binary(max_size=6), st.just(doubled_piece))
        )
        data = data[:start] + new_piece + data[stop:]
    return data


def read_or_refuse(parser: Parser, path: Path, data: bytes) -> str | None:
    """Write data to a file and read it; return the message of a refusal, or None if it is read.

    A refusal is a UsageError; other errors are raised.
    """
    path.write_bytes(data)
    try:
        parser.read(path)
    except UsageError as error:
        return str(error)
    return None


def is_one_short_line(message: str) -> bool:
    """Return whether a message has 1 to 999 characters and no line end or control character."""
    return message.isprintable() and 0 < len(message) < 1000


@pytest.mark.parametrize("name", PARSERS)
def test_a_valid_file_of_every_format_is_read(name: str, tmp_path: Path) -> None:
    """A table, a log, results and a file of experiments, among others, are read without an error."""
    parser = PARSERS[name]
    refusal = read_or_refuse(parser, tmp_path / f"file{parser.suffix}", parser.make_valid())
    assert refusal is None


SOME_DAMAGES = settings(
    max_examples=draws(120), deadline=None, suppress_health_check=list(HealthCheck), database=None
)


@pytest.mark.random
@pytest.mark.parametrize("name", PARSERS)
def test_a_file_with_random_damage_is_read_or_refused_in_one_short_line(name: str, tmp_path: Path) -> None:
    """Files of every format are tried, for example a table, a log, results or a file of experiments.

    A refusal is a UsageError; any other error fails the test.
    """
    parser = PARSERS[name]
    path = tmp_path / f"file{parser.suffix}"

    @SOME_DAMAGES
    @given(st.one_of(damaged(parser.make_valid()), st.binary(max_size=40)))
    def read_damaged_file(data: bytes) -> None:
        refusal = read_or_refuse(parser, path, data)
        assert refusal is None or is_one_short_line(refusal)

    read_damaged_file()


# --- Results whose two schemas differ -----------------------------------------------------------------


def test_results_with_a_column_whose_name_is_no_text_are_refused(tmp_path: Path) -> None:
    """A file of results names its columns in two schemas. Only one schema is changed."""
    data = valid_results().replace(b"robots", b"\xffobots")
    refusal = read_or_refuse(PARSERS["results"], tmp_path / "run.parquet", data)
    assert refusal is not None
    assert refusal.startswith(f"cannot read {tmp_path / 'run.parquet'}: ")
    assert is_one_short_line(refusal)


def test_results_that_lack_the_metadata_of_parquet_are_read_by_the_metadata_of_arrow(tmp_path: Path) -> None:
    """A file of results has two schemas, each with metadata called "mcp-asdf". Only Parquet's are renamed."""
    data = valid_results().replace(b"mcp-asdf", b"mcp-asdg")
    assert read_or_refuse(PARSERS["results"], tmp_path / "run.parquet", data) is None


# --- Values and files without an end ------------------------------------------------------------------


@pytest.mark.parametrize("time", ["nan", "inf", "1e308", "-1e300"])
def test_a_line_of_a_log_with_an_impossible_time_holds_no_frame(time: str, tmp_path: Path) -> None:
    """A line of a log has a time in seconds, a bus and a frame; "nan" and "1e308" are impossible times."""
    line = f"({time}) vcan0 186BB92A#00"
    refusal = read_or_refuse(PARSERS["log .log"], tmp_path / "run.log", f"{line}\n".encode())
    assert refusal is not None
    assert f"holds no frame: line 1, '{line}', is none of candump's" in refusal


@pytest.fixture
def limited_memory() -> Iterator[None]:
    """Let this process have 4 GiB more than it has by now, so that reading without an end fails soon."""
    pages_in_use = int(Path("/proc/self/statm").read_text().split(maxsplit=1)[0])
    limit, hard_limit = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (pages_in_use * resource.getpagesize() + 2**32, hard_limit))
    yield
    resource.setrlimit(resource.RLIMIT_AS, (limit, hard_limit))


@pytest.mark.usefixtures("limited_memory")
def test_a_device_without_an_end_is_refused_as_a_graph() -> None:
    """Linux's device /dev/zero has zeros without an end. Reading is given up after 16777216 bytes, 16 MiB."""
    with pytest.raises(UsageError, match="than 16777216 bytes"):
        Experiment(topology="graph", graph=Path("/dev/zero"))


@pytest.mark.usefixtures("limited_memory")
def test_a_link_to_a_device_without_an_end_is_refused_as_a_table(tmp_path: Path) -> None:
    """Linux's device /dev/zero has zeros without an end. Reading is given up after 16777216 bytes, 16 MiB."""
    link = tmp_path / "endless.c"
    link.symlink_to("/dev/zero")
    with pytest.raises(UsageError, match="than 16777216 bytes"):
        check_file(link)


@pytest.mark.slow
@pytest.mark.usefixtures("limited_memory")
def test_a_file_with_100001_grids_of_one_experiment_each_is_refused(tmp_path: Path) -> None:
    """A file may make at most 100,000 experiments, which the error says."""
    grid = tmp_path / "grid.toml"
    grid.write_text("steps = 9\n" + "[[grid]]\n" * 100_001)
    with pytest.raises(UsageError, match="more than 100000 experiments"):
        read_experiments(grid)


def test_a_file_whose_grids_together_make_more_experiments_than_are_allowed_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two grids of three seeds make six experiments, where five are allowed here. The error says so."""
    monkeypatch.setattr(experiment_files, "MAX_EXPERIMENTS", 5)
    (tmp_path / "grid.toml").write_text("seed = [1, 2, 3]\n[[grid]]\n[[grid]]\nrobots = 5\n")
    with pytest.raises(UsageError, match=r"grid.toml makes more than 5 experiments; give fewer"):
        read_experiments(tmp_path / "grid.toml")
