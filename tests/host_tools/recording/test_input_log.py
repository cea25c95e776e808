"""An input log returns the events written to it; a malformed one is refused with its line."""

from __future__ import annotations

import json
from decimal import Decimal
from pathlib import Path
from typing import Any

import can
import numpy as np
import pytest

from input_logs import input_log_in
from mcp_asdf.robot import Filter, Observation
from mcp_asdf.table import Table
from mcp_asdf_tools.bus.frames import FrameFormat
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.recording.input_log import InputLogHeader, InputLogReader, InputLogWriter
from mcp_asdf_tools.robots.record import RobotRecord, TickConfig
from mcp_asdf_tools.tables.thresholds import generate
from wire import record

RECORDS = (
    record(0, "native", 0.1 + 0.2),
    record(7, "mirror", filter=Filter.ALWAYS, comms_period=5, memory=64),
    RobotRecord(127, "reference", 0.95, TickConfig(None, Filter.OFF, filter_period=3)),
    RobotRecord(3, "native", 2.0**-20, TickConfig(generate(Decimal("0.123456789"), 2))),
)
HEADER = InputLogHeader(RECORDS, 5, FrameFormat(17, 2), {"fill_ratio": 0.55, "faults": ["loss=0.5"]})


FRAMES = {
    "186BB92A#0000603333F307E5": can.Message(
        arbitration_id=0x186BB92A, data=bytes.fromhex("0000603333F307E5")
    ),
    "042#": can.Message(arbitration_id=0x42, is_extended_id=False),
    "00000042#R": can.Message(arbitration_id=0x42, is_remote_frame=True, dlc=3),
    "E00000088#00": can.Message(arbitration_id=0x88, is_error_frame=True, data=bytes(1)),
}
"""Frames by their text, which is candump's."""


def read(path: Path) -> tuple[InputLogHeader, list[Any]]:
    with InputLogReader(path) as reader:
        return reader.header, list(reader.lines())


def test_what_is_written_comes_back(tmp_path: Path) -> None:
    """Frames are written as candump does."""
    with input_log_in(tmp_path / "x", HEADER) as writer:
        writer.robots[7].observe(Observation.BLACK)
        writer.robots[7].receive(np.array([[3, 2**23, 2**32 - 1], [127, 0, 0]], np.uint32))
        for frame in FRAMES.values():
            writer.injected(frame)
        writer.robots[127].restart()
        writer.robots[7].settle()
        writer.robots[7].observe(None)
        writer.robots[7].falsified(5, 2**31)
        writer.robots[7].silent()
    events = (
        (7, [1, [3, 2**23, 2**32 - 1], [127, 0, 0], 3]),
        (7, [2, [5, 2**31], "silent"]),
        (127, ["restart"]),
    )
    assert read(tmp_path / "x") == (HEADER, [*FRAMES, *events])


def spoiled(**changes: Any) -> str:
    """A header with changes, of the first robot if they name something of robots."""
    plain = json.loads(HEADER.line())
    for name, value in changes.items():
        target = plain if name in plain else plain["robots"][0]
        target[name] = value
    return json.dumps(plain)


GOOD = HEADER.line().rstrip()
BAD = {
    "": 'line 1: "format": "mcp-asdf events" is missing',
    "\n": "line 1: not JSON",
    "{}": 'line 1: "format": "mcp-asdf events" is missing',
    "(1.0) vcan0 1#00": "line 1: not JSON",
    "[" * 100_000: "line 1: not JSON",
    spoiled(version=1): "line 1: the format is version 1, and version 2 is read here; replay",
    spoiled(version=3): "line 1: the format is version 3, and version 2 is read here",
    spoiled(robots=5): "line 1: ",
    spoiled(frames={"subject": 6144, "priority": 4}): "line 1: subject is 6144",
    spoiled(filter="sometimes"): "line 1: filter is 'sometimes'; it must be one of adaptive, always, off",
    spoiled(comms_period="1"): "line 1: ",
    spoiled(table={"omega": "x", "q": 20, "checksum": 1}): "line 1: ",
    spoiled(table={"omega": "0.05", "q": 20}): "line 1: 'checksum' is missing",
    GOOD + "\n[0,1": "line 2: not JSON",
    GOOD + "\n\n": "line 2: not JSON",
    GOOD + "\n[0,1,3]\n{}": "line 3: neither a robot with its events nor a frame",
    GOOD + "\n[]": "line 2: neither a robot",
    GOOD + "\n[5,1]": "line 2: robot 5 is not in the first line",
    GOOD + "\n[0,4]": "line 2: 4 is no event",
    GOOD + "\n[0,-1]": "line 2: -1 is no event",
    GOOD + "\n[0,1.0]": "line 2: 1.0 is no event",
    GOOD + "\n[0,[1]]": "line 2: [1] is no event",
    GOOD + "\n[0,[1,2,-3]]": "line 2: [1, 2, -3] is no event",
    GOOD + "\n[0,[1,2,4294967296]]": "line 2: [1, 2, 4294967296] is no event",
    GOOD + '\n[0,"lost"]': "line 2: 'lost' is no event",
}


@pytest.mark.parametrize("text", BAD, ids=lambda text: BAD[text][:60])
def test_what_is_no_input_log(text: str, tmp_path: Path) -> None:
    (tmp_path / "x").write_text(text)
    with pytest.raises(UsageError) as error:
        read(tmp_path / "x")
    assert f"{tmp_path / 'x'}, {BAD[text]}" in str(error.value)


def test_what_cannot_be_read(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"cannot read .*: No such file"):
        InputLogReader(tmp_path / "x")
    (tmp_path / "x").write_bytes(b"\xff\xfe")
    with pytest.raises(UsageError, match="line 1: not JSON"):
        InputLogReader(tmp_path / "x")
    with pytest.raises(UsageError, match=r"two robots have one id among \[1, 1\]"):
        InputLogWriter(InputLogHeader([record(1), record(1)], 1, FrameFormat()), print)
    own = Table(3, RECORDS[0].config.table.entries if RECORDS[0].config.table else ())
    with pytest.raises(UsageError, match=r"omega is .*make one with mcp-asdf table"):
        RobotRecord(1, "mirror", 0.9, TickConfig(own)).plain()
