"""Logs in the formats of candump and python-can are read, and what is wrong with one is named."""

from __future__ import annotations

from pathlib import Path
from unittest.mock import Mock

import can
import pytest

from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.recording import frame_logs
from mcp_asdf_tools.recording.frame_logs import LogSummary, read_log

FRAME = "186BB92A#0000603333F307E5"
"""A frame as candump writes it: identifier and data in hexadecimal digits."""


def read_times(log: Path, summary: LogSummary | None = None) -> list[float]:
    """Return the times of all frames in a log."""
    return [frame.timestamp for frame in read_log(log, None, summary)]


@pytest.fixture
def odd_log(tmp_path: Path) -> Path:
    """A log with a byte order mark, two frames, an empty line, a comment in line 3 and a cut line."""
    log = tmp_path / "run.log"
    log.write_text(
        f"\ufeff(1.0) vcan0 {FRAME}\n\n# a break\n(2.0) vcan1 {FRAME}\n(3.0) vcan0 186BB9", encoding="utf-8"
    )
    return log


def test_frames_are_read_around_lines_that_are_no_frames(odd_log: Path) -> None:
    """The log has frames at 1 s and 2 s, between them a comment, and behind them a line that was cut."""
    assert read_times(odd_log) == [1.0, 2.0]


def test_the_summary_counts_the_frames_of_each_channel_and_warns_of_lines_that_are_no_frames(
    odd_log: Path,
) -> None:
    """The log has a frame of vcan0, a frame of vcan1, a comment in line 3 and a line that was cut.

    Empty lines are not counted. The summary is filled while the frames are read.
    """
    summary = LogSummary()
    read_times(odd_log, summary)

    assert summary.channels == {"vcan0": 1, "vcan1": 1}
    assert summary.channel_names == "vcan0 and vcan1"
    assert summary.warning == "2 lines are no frames and were left out; the first is line 3, '# a break'"


def test_the_summary_names_the_only_line_that_is_no_frame(tmp_path: Path) -> None:
    """Line 2 has two bytes that are no UTF-8 and are shown as escapes. The frame of line 1 is read.

    The summary is filled while the frames are read.
    """
    log = tmp_path / "run.log"
    log.write_bytes(b"(1.0) vcan0 123#00\n\xff\xfe\n")
    summary = LogSummary()

    assert read_times(log, summary) == [1.0]
    assert summary.warning == r"line 2, '\\xff\\xfe', is no frame and was left out"


def test_a_log_without_frames_is_refused_with_its_first_line(tmp_path: Path) -> None:
    """The suffix .log stands for candump's format, but the contents are a table in CSV.

    The error quotes the first line, and asks if the suffix is right.
    """
    log = tmp_path / "run.log"
    log.write_text("timestamp,arbitration_id\n1.0,0x123\n")
    message = "holds no frame: line 1, 'timestamp,arbitration_id', is none of candump's; does its suffix"

    with pytest.raises(UsageError, match=message):
        read_times(log)


def test_a_missing_log_is_refused_and_not_created(tmp_path: Path) -> None:
    """Python-can's reader of .db files, which are databases, would make an empty one."""
    with pytest.raises(UsageError, match=r"cannot read the log .*absent\.db: No such file"):
        read_times(tmp_path / "absent.db")
    assert list(tmp_path.iterdir()) == []


def lines_of_log_of_one_frame(log: Path) -> list[str]:
    """Let python-can write a log of one frame, 123#01; return its lines, the last of which has the frame."""
    with can.Logger(log) as write_frame:
        write_frame(can.Message(timestamp=1.0, arbitration_id=0x123, data=b"\1"))
    return log.read_text().removesuffix("End TriggerBlock\n").splitlines()  # an .asc file has this end


@pytest.mark.parametrize("suffix", [".asc", ".csv", ".trc"])
def test_a_malformed_line_of_another_format_is_refused_with_its_number(suffix: str, tmp_path: Path) -> None:
    """The last line of a log repeats the line before, but has "xyz" in place of the identifier, 123."""
    log = tmp_path / f"run{suffix}"
    lines = lines_of_log_of_one_frame(log)
    *_, last_line = lines
    malformed_line = last_line.replace("123", "xyz")
    lines.append(malformed_line)
    log.write_text("\n".join(lines))

    with pytest.raises(UsageError) as caught:
        read_times(log)
    line_number = len(lines)
    shown_line = " ".join(malformed_line.split())  # white space is shortened to single spaces
    assert f"is malformed in line {line_number}, '{shown_line}'" in str(caught.value)


def test_a_log_in_mf4_is_refused_with_the_package_that_would_read_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The package is not part of the tools; here it counts as not installed, whether it is or not.

    ``find_spec`` looks for a package, and returns None if there is none. MDF begins each file in MF4.
    """
    find_no_package = Mock(return_value=None)
    monkeypatch.setattr(frame_logs, "find_spec", find_no_package)
    log = tmp_path / "run.mf4"
    log.write_bytes(b"MDF     4.10    ")
    message = r"run\.mf4 the package asammdf is needed, which is not installed; run: pip install asammdf"

    with pytest.raises(UsageError, match=message):
        read_times(log)


def test_a_line_of_a_million_characters_is_skipped(tmp_path: Path) -> None:
    """No frame has such a line, and a log of garbage must not fill the memory.

    The frame in the next line is read. The summary is filled while the frames are read.
    """
    log = tmp_path / "run.log"
    line_of_a_million_characters = f"(1.0) vcan0 123#{'0' * 1_000_000}"
    log.write_text(f"{line_of_a_million_characters}\n(2.0) vcan0 123#00\n")
    summary = LogSummary()

    assert read_times(log, summary) == [2.0]
    assert summary.skipped_lines == 1


@pytest.mark.parametrize(
    ("line", "shown_line"), [("x" * 60, "x" * 60), ("x" * 61, "x" * 60 + "...")], ids=["60", "61"]
)
def test_of_a_line_of_more_than_60_characters_the_first_60_are_shown(
    line: str, shown_line: str, tmp_path: Path
) -> None:
    """The line is no frame, and the summary of the log quotes it; it is filled while frames are read.

    The frame in the second line is there because a log without frames is refused.
    """
    log = tmp_path / "run.log"
    log.write_text(f"{line}\n(2.0) vcan0 123#00\n")
    summary = LogSummary()
    read_times(log, summary)
    assert summary.first_skipped == f"line 1, '{shown_line}'"


@pytest.mark.parametrize(
    "cut_line", ["", "(", "(3.0) vcan0 123", "(3.0) vcan0 123#00", "(3.0) vcan0 123#0033"]
)
def test_the_log_of_a_killed_run_is_read_up_to_its_last_complete_line(cut_line: str, tmp_path: Path) -> None:
    """Its name ends in ``.part``. A last line without an end may be cut, even if it looks like a frame."""
    part = tmp_path / "run.log.part"
    part.write_text(f"(1.0) vcan0 123#0011\n(2.0) vcan0 123#0022\n{cut_line}")
    assert read_times(part) == [1.0, 2.0]


@pytest.mark.parametrize("cut_line", ["(1.0) vcan0 123", "(1.0) vcan0 123#0011"])
def test_the_log_of_a_killed_run_without_a_complete_line_is_refused(cut_line: str, tmp_path: Path) -> None:
    """Its only line has no end, so it may be cut, even if it looks like a frame. No frame is left."""
    part = tmp_path / "run.log.part"
    part.write_text(cut_line)
    with pytest.raises(UsageError, match="holds no frame"):
        read_times(part)
