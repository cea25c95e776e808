"""Every form of a line that candump writes gives the frame that was on the bus."""

from __future__ import annotations

import subprocess

import can
import pytest

from mcp_asdf_tools.bus.frames import format_frame
from mcp_asdf_tools.recording.candump_lines import parse_line
from support import require

FRAME = "186BB92A#0000603333F307E5"
"""A frame as candump writes it: identifier and data in hexadecimal digits."""


def parse_frame(line: str) -> can.Message:
    """Return the frame in a line, which must hold one."""
    frame = parse_line(line)
    assert frame is not None
    return frame


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
def test_all_forms_in_which_candump_prints_a_frame_give_the_same_frame(line: str) -> None:
    """In each line the frame was received on vcan0 at 1.5 s. It is no frame of CAN FD."""
    frame = parse_frame(line)
    assert frame.timestamp == 1.5
    assert frame.channel == "vcan0"
    assert format_frame(frame) == "186BB92A#0000603333F307E5"  # identifier and data
    assert frame.is_extended_id
    assert not frame.is_fd


def test_a_line_without_a_time_stamp_has_time_zero() -> None:
    """Candump prints time stamps only if it is asked for them; without one a frame is read as of 0 s."""
    frame = parse_frame("  can1  123   [2]  01 FF")
    assert frame.timestamp == 0.0
    assert frame.channel == "can1"
    assert format_frame(frame) == "123#01FF"


def test_an_identifier_of_three_digits_is_a_standard_one() -> None:
    """A standard identifier has 11 bits; an extended one has 29, and candump writes it in eight digits."""
    assert not parse_frame("(1.5) can1 123#01FF").is_extended_id


@pytest.mark.parametrize("line", ["(1.5) can0 123##3AB T", "(1.5)  can0  TX B E  123  [01]  AB"])
def test_a_can_fd_frame_is_read_as_such(line: str) -> None:
    """The 3 behind ## (or B and E) is its flags, and T says that this computer sent it: both are ignored."""
    frame = parse_frame(line)
    assert frame.is_fd
    assert frame.data == b"\xab"


@pytest.mark.parametrize("line", ["(1.5) can0 123#R5", "(1.5)  can0  123   [5]  remote request"])
def test_a_remote_frame_has_the_length_that_it_asks_for(line: str) -> None:
    """A remote frame has no data. Its length, here 5, is the number of bytes that it asks a node for."""
    frame = parse_frame(line)
    assert frame.is_remote_frame
    assert frame.dlc == 5
    assert len(frame.data) == 0


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
def test_a_line_without_a_complete_and_possible_frame_gives_none(line: str) -> None:
    """The parser returns None, and raises nothing: logs have comments, cut lines and too large numbers."""
    assert parse_line(line) is None


@pytest.mark.parametrize(
    "frame_text",
    [
        "186BB92A#0000603333F307E5",
        "123#",
        "123#R",
        "7FF#R5",
        "123##1001122334455667788990011",
        "20000080#0000000000000000",
    ],
)
def test_a_line_of_a_log_is_read_as_the_same_frame_as_candumps_output_on_a_console(frame_text: str) -> None:
    """The program log2long, which comes with candump, writes a line of a log as the console shows it."""
    log2long = require("log2long", "can-utils")
    log_line = f"(2.500000) can0 {frame_text}"
    result = subprocess.run([log2long], input=f"{log_line}\n", capture_output=True, text=True, check=True)
    console_line = result.stdout

    frame_of_log = parse_frame(log_line)
    frame_of_console = parse_frame(console_line)
    assert frame_of_console.equals(frame_of_log)
