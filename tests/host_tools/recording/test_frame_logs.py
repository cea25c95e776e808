"""Logs that other programs have written are read as far as they hold frames."""

from __future__ import annotations

import subprocess
from pathlib import Path

import can
import pytest

from mcp_asdf_tools.bus.frames import format_frame
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.recording import frame_logs
from mcp_asdf_tools.recording.candump_lines import parse_line
from mcp_asdf_tools.recording.frame_logs import LogSummary, read_log
from support import require

FRAME = "186BB92A#0000603333F307E5"


@pytest.mark.parametrize(
    "line",
    [
        f"(1.5) vcan0 {FRAME}",
        f"(0000000001.500000) vcan0 {FRAME} R\n",
        f"(1.5)   vcan0 {FRAME.lower()}\r\n",
        f"(1.5) vcan0 {FRAME}_B",
        "(1.5) vcan0 186BB92A#00.00.60.33.33.F3.07.E5",
        f"(1970-01-01 00:00:01.500000) vcan0 {FRAME}",
        " (0000000001.500000)  vcan0  186BB92A   [8]  00 00 60 33 33 F3 07 E5",
        " (1970-01-01 00:00:01.500000)  vcan0  RX - -  186BB92A   [8]  00 00 60 33 33 F3 07 E5",
        "(1.5)  vcan0  186BB92A   {B}  00 00 60 33 33 F3 07 E5   '..`33...'",
        " \x1b[31m(1.5)  vcan0  186BB92A   [8]  00 00 60 33 33 F3 07 E5\x1b[0m",
    ],
)
def test_all_forms_of_candump_give_the_same_frame(line: str) -> None:
    frame = parse_line(line)
    assert frame is not None
    assert (frame.timestamp, frame.channel, format_frame(frame)) == (1.5, "vcan0", FRAME)
    assert frame.is_extended_id and frame.is_rx and not frame.is_fd


def test_a_console_line_without_a_time_is_of_time_zero() -> None:
    frame = parse_line("  can1  123   [2]  01 FF")
    assert frame is not None
    assert (frame.timestamp, frame.channel, format_frame(frame)) == (0.0, "can1", "123#01FF")
    assert not frame.is_extended_id


@pytest.mark.parametrize(
    "line",
    [
        "",
        "# recorded in the laboratory",
        "DROPCOUNT: dropped 3 CAN frames on 'can0' socket (total drops 3)",
        "\tcontroller-problem{rx-error-passive}",
        "(1.5) vcan0",
        "(1.5) vcan0 186BB92A#000",
        "(1.5) vcan0 186BB92A#0000603333F307E500",
        "(1.5) vcan0 186BB92A#xyz",
        "(1.5) vcan0 800#00",
        "(yesterday) vcan0 123#00",
        "(1.5)  vcan0  123   [3]  01 FF",
        "(1.5)  vcan0  123   [1]  00000001",
        f"(1.5) {'v' * 5000} 123#00",
    ],
)
def test_other_lines_are_no_frames(line: str) -> None:
    assert parse_line(line) is None


@pytest.mark.parametrize(
    "text",
    ["186BB92A#0000603333F307E5", "123#", "123#R", "7FF#R5", "123##1001122334455667788990011", "20000080#"],
)
def test_candump_s_tools_mean_the_same_frame_by_their_long_form(text: str) -> None:
    """``log2long`` makes the console form of a line of a log."""
    program = require("log2long", "can-utils")
    line = f"(2.500000) can0 {text}{'' if '#R' in text or '##' in text else '00' * (text == '20000080#') * 8}"
    done = subprocess.run([program], input=f"{line}\n", capture_output=True, text=True, check=True)
    short_form, long_form = parse_line(line), parse_line(done.stdout)
    assert short_form is not None and long_form is not None
    # The long form does not have the bit-rate switch of CAN FD.
    long_form.bitrate_switch = short_form.bitrate_switch
    assert long_form.equals(short_form, timestamp_delta=None)


def test_a_log_is_read_around_lines_that_are_no_frames(tmp_path: Path) -> None:
    log, summary = tmp_path / "run.log", LogSummary()
    log.write_text(
        f"\ufeff(1.0) vcan0 {FRAME}\n\n# a break\n(2.0) vcan1 {FRAME}\n(3.0) vcan0 186BB9", "utf-8"
    )
    assert [frame.timestamp for frame in read_log(log, None, summary)] == [1.0, 2.0]
    assert summary.channels == {"vcan0": 1, "vcan1": 1}
    assert summary.warning == "2 lines are no frames and were left out; the first is line 3, '# a break'"


def test_one_odd_line_is_named_by_itself(tmp_path: Path) -> None:
    log, summary = tmp_path / "run.log", LogSummary()
    log.write_bytes(b"(1.0) vcan0 123#00\n\xff\xfe\n")
    assert len([*read_log(log, None, summary)]) == 1
    assert summary.warning == r"line 2, '\\xff\\xfe', is no frame and was left out"


def test_a_log_without_frames_is_refused_with_its_first_line(tmp_path: Path) -> None:
    log = tmp_path / "run.log"
    log.write_text("timestamp,arbitration_id\n1.0,0x123\n")
    told = "holds no frame: line 1, 'timestamp,arbitration_id', is none of candump's; does its suffix"
    with pytest.raises(UsageError, match=told):
        [*read_log(log)]


@pytest.mark.parametrize("suffix", [".asc", ".csv", ".trc"])
def test_a_malformed_line_of_another_format_is_named(suffix: str, tmp_path: Path) -> None:
    log = tmp_path / f"run{suffix}"
    with can.Logger(log) as write:
        write(can.Message(timestamp=1.0, arbitration_id=0x123, data=b"\1"))
    lines = log.read_text().replace("End TriggerBlock\n", "").splitlines()
    odd_line = lines[-1].replace("123", "xyz")
    log.write_text("\n".join([*lines, odd_line]))
    with pytest.raises(UsageError) as caught:
        [*read_log(log)]
    assert f"is malformed in line {len(lines) + 1}, '{' '.join(odd_line.split())}'" in str(caught.value)
    assert "Error" not in str(caught.value)


def test_a_log_in_mf4_names_the_package_that_reads_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(frame_logs, "find_spec", lambda _: None)
    log = tmp_path / "run.mf4"
    log.write_bytes(b"MDF     4.10    ")
    told = (
        r"to read .*run\.mf4 the package asammdf is needed, which is not installed; run: pip install asammdf"
    )
    with pytest.raises(UsageError, match=told):
        [*read_log(log)]


def test_a_line_without_an_end_takes_no_memory(tmp_path: Path) -> None:
    log, summary = tmp_path / "run.log", LogSummary()
    log.write_text(f"(1.0) vcan0 123#{'0' * 1_000_000}\n(2.0) vcan0 123#00\n")
    assert [frame.timestamp for frame in read_log(log, None, summary)] == [2.0]
    assert (summary.skipped_lines, len(summary.first_skipped or "")) == (1, 73)
