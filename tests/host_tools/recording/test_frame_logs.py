"""Logs in the formats of candump and python-can are read, and what is wrong with one is named."""

from __future__ import annotations

from pathlib import Path

import can
import pytest

from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.recording import frame_logs
from mcp_asdf_tools.recording.frame_logs import LogSummary, read_log

FRAME = "186BB92A#0000603333F307E5"


def read_times(log: Path, summary: LogSummary | None = None) -> list[float]:
    """Return the times of all frames in a log."""
    return [frame.timestamp for frame in read_log(log, None, summary)]


def write_odd_log(log: Path) -> None:
    """Write a log with a byte order mark, two frames, an empty line, a comment and a line that was cut."""
    log.write_text(
        f"\ufeff(1.0) vcan0 {FRAME}\n\n# a break\n(2.0) vcan1 {FRAME}\n(3.0) vcan0 186BB9", encoding="utf-8"
    )


def test_frames_are_read_around_lines_that_are_no_frames(tmp_path: Path) -> None:
    write_odd_log(tmp_path / "run.log")
    assert read_times(tmp_path / "run.log") == [1.0, 2.0]


def test_the_summary_counts_the_frames_of_each_channel(tmp_path: Path) -> None:
    summary = LogSummary()
    write_odd_log(tmp_path / "run.log")
    read_times(tmp_path / "run.log", summary)

    assert summary.channels == {"vcan0": 1, "vcan1": 1}
    assert summary.channel_names == "vcan0 and vcan1"


def test_the_summary_warns_of_lines_that_are_no_frames(tmp_path: Path) -> None:
    summary = LogSummary()
    write_odd_log(tmp_path / "run.log")
    read_times(tmp_path / "run.log", summary)
    assert summary.warning == "2 lines are no frames and were left out; the first is line 3, '# a break'"


def test_the_summary_names_the_only_line_that_is_no_frame(tmp_path: Path) -> None:
    log, summary = tmp_path / "run.log", LogSummary()
    log.write_bytes(b"(1.0) vcan0 123#00\n\xff\xfe\n")
    assert read_times(log, summary) == [1.0]
    assert summary.warning == r"line 2, '\\xff\\xfe', is no frame and was left out"


def test_a_log_without_frames_is_refused_with_its_first_line(tmp_path: Path) -> None:
    log = tmp_path / "run.log"
    log.write_text("timestamp,arbitration_id\n1.0,0x123\n")
    message = "holds no frame: line 1, 'timestamp,arbitration_id', is none of candump's; does its suffix"

    with pytest.raises(UsageError, match=message):
        read_times(log)


def test_a_missing_log_is_refused_and_not_created(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"cannot read the log .*absent\.db: No such file"):
        read_times(tmp_path / "absent.db")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("suffix", [".asc", ".csv", ".trc"])
def test_a_malformed_line_of_another_format_is_named(suffix: str, tmp_path: Path) -> None:
    log = tmp_path / f"run{suffix}"
    with can.Logger(log) as write_frame:
        write_frame(can.Message(timestamp=1.0, arbitration_id=0x123, data=b"\1"))
    lines = log.read_text().replace("End TriggerBlock\n", "").splitlines()
    malformed_line = lines[-1].replace("123", "xyz")
    log.write_text("\n".join([*lines, malformed_line]))
    shown_line = " ".join(malformed_line.split())

    with pytest.raises(UsageError) as caught:
        read_times(log)
    assert f"is malformed in line {len(lines) + 1}, '{shown_line}'" in str(caught.value)


def test_a_log_in_mf4_is_refused_with_the_package_that_would_read_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(frame_logs, "find_spec", lambda _: None)
    log = tmp_path / "run.mf4"
    log.write_bytes(b"MDF     4.10    ")
    message = r"run\.mf4 the package asammdf is needed, which is not installed; run: pip install asammdf"

    with pytest.raises(UsageError, match=message):
        read_times(log)


def test_a_line_of_a_million_characters_is_skipped(tmp_path: Path) -> None:
    """No frame has such a line, and a log of garbage must not fill the memory."""
    log, summary = tmp_path / "run.log", LogSummary()
    log.write_text(f"(1.0) vcan0 123#{'0' * 1_000_000}\n(2.0) vcan0 123#00\n")
    assert read_times(log, summary) == [2.0]
    assert summary.skipped_lines == 1


def test_a_line_of_sixty_characters_is_shown_completely(tmp_path: Path) -> None:
    log, summary = tmp_path / "run.log", LogSummary()
    log.write_text(f"{'x' * 60}\n(2.0) vcan0 123#00\n")
    read_times(log, summary)
    assert summary.first_skipped == f"line 1, '{'x' * 60}'"


def test_only_the_beginning_of_a_long_line_is_shown(tmp_path: Path) -> None:
    log, summary = tmp_path / "run.log", LogSummary()
    log.write_text(f"(1.0) vcan0 123#{'0' * 1_000_000}\n(2.0) vcan0 123#00\n")
    read_times(log, summary)
    first_60_characters = f"(1.0) vcan0 123#{'0' * 44}"
    assert summary.first_skipped == f"line 1, '{first_60_characters}...'"


THREE_LINES = b"(1.0) vcan0 123#0011\n(2.0) vcan0 123#0022\n(3.0) vcan0 123#0033\n"
FIRST_LINE_LENGTH = THREE_LINES.index(b"\n") + 1


def test_the_log_of_a_killed_run_is_read_up_to_its_last_complete_line(tmp_path: Path) -> None:
    """Its name ends in ``.part``. It is cut after each of its bytes from the first complete line on."""
    part = tmp_path / "run.log.part"
    for size in range(FIRST_LINE_LENGTH, len(THREE_LINES) + 1):
        part.write_bytes(THREE_LINES[:size])
        complete_lines = THREE_LINES[:size].count(b"\n")
        assert read_times(part) == [1.0, 2.0, 3.0][:complete_lines], f"cut after {size} bytes"


def test_the_log_of_a_killed_run_without_a_complete_line_is_refused(tmp_path: Path) -> None:
    """Its name ends in ``.part``, and it is cut after each byte of the first line."""
    part = tmp_path / "run.log.part"
    for size in range(1, FIRST_LINE_LENGTH):
        part.write_bytes(THREE_LINES[:size])
        with pytest.raises(UsageError, match="holds no frame"):
            read_times(part)
