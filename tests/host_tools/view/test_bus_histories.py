"""Histories of robots on a bus, and of logs without events: what the frames show."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import can
import numpy as np
import pytest

from mcp_asdf_tools.bus.frames import (
    Estimate,
    FrameFormat,
    Telemetry,
    encode_estimate,
    encode_telemetry,
    format_frame,
)
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.view import bus_recorder
from mcp_asdf_tools.view.bus_recorder import BusRecorder
from mcp_asdf_tools.view.frame_log_history import FrameLogHistory, read_frame_history
from mcp_asdf_tools.view.history import MAX_STATES

NAN = np.nan
HALF_ESTIMATE = Estimate(7, x_hat=1 << 22, alpha=1, transfer_id=0)
"""Robot 7 estimates that half of the floor is black."""


def encode(content: Estimate | Telemetry) -> can.Message:
    if isinstance(content, Estimate):
        return encode_estimate(content, FrameFormat())
    return encode_telemetry(content)


# --- A bus --------------------------------------------------------------------------------------------


class ScriptedBus:
    """A bus on which frames are received at given times; its clock moves while somebody waits for one."""

    def __init__(self, frames: dict[float, can.Message]) -> None:
        self.now = 0.0
        self._frames = dict(frames)

    def recv(self, timeout: float) -> can.Message | None:
        """Return the next frame within ``timeout`` seconds, or None after them."""
        next_time = min(self._frames, default=np.inf)
        if next_time > self.now + timeout:
            self.now = round(self.now + timeout, 9)
            return None
        self.now = next_time
        return self._frames.pop(next_time)


@pytest.fixture
def bus(monkeypatch: pytest.MonkeyPatch) -> ScriptedBus:
    """A bus with robots 7 and 3, of which a history has a state every 1/8 s; frames come between."""
    bus = ScriptedBus(
        {
            0.0: encode(Telemetry(7, 1 << 22, 1 << 23, 0, 0)),  # x = 0.5, b_hat = 0.5
            0.1875: encode(Estimate(7, 1 << 21, 1, 0)),  # x_hat = 0.25
            0.3125: encode(Telemetry(3, 1 << 21, 1 << 22, 0, 0)),  # x = 0.25, b_hat = 0.25
        }
    )
    monkeypatch.setattr(time, "monotonic", lambda: 1000 + bus.now)
    monkeypatch.setattr(bus_recorder, "STATES_PER_SECOND", 8)
    return bus


def record(bus: Any, seconds: float) -> BusRecorder:
    """Record the history of a bus whose robots' sensors have an accuracy of 0.9."""
    recorder = BusRecorder(bus, FrameFormat(), "a bus", true_accuracy=0.9)
    recorder.record(lambda: bus.now >= seconds)
    return recorder


def test_robots_of_a_bus_are_in_the_order_of_their_first_values(bus: ScriptedBus) -> None:
    assert record(bus, 0.5).history.description.robots == [7, 3]


def test_states_of_a_bus_have_what_its_robots_sent_before(bus: ScriptedBus) -> None:
    """Each row is a state, and each column one of two robots; NAN is what the robot has not sent so far."""
    states = record(bus, 0.5).history.states_since().states
    x, x_hat, b_hat, b = np.stack([state.values for state in states], axis=1)

    assert [state.tick for state in states] == [0, 1, 2, 3]
    assert np.array_equal(x, [[0.5, NAN], [0.5, NAN], [0.5, NAN], [0.5, 0.25]], equal_nan=True)
    assert np.array_equal(x_hat, [[NAN, NAN], [NAN, NAN], [0.25, NAN], [0.25, NAN]], equal_nan=True)
    assert np.array_equal(b_hat, [[0.5, NAN], [0.5, NAN], [0.5, NAN], [0.5, 0.25]], equal_nan=True)
    assert np.array_equal(b, [[0.9, NAN], [0.9, NAN], [0.9, NAN], [0.9, 0.9]], equal_nan=True)


def test_each_robot_that_joins_a_bus_makes_open_pages_load_all_states_again(bus: ScriptedBus) -> None:
    """A page that has followed the bus loads all states again when the generation changes."""
    assert record(bus, 0.5).history.generation == 2


def test_a_recorder_knows_whether_there_was_telemetry(bus: ScriptedBus) -> None:
    assert record(bus, 0.5).has_telemetry


def test_a_bus_has_a_report_on_its_robots(bus: ScriptedBus) -> None:
    report = record(bus, 0.5).history.report
    assert report is not None
    assert [(row["robot"], row["seen"]) for row in report["robots"]] == [(7, 0.0)]


def test_robots_that_fall_silent_lose_their_values(bus: ScriptedBus) -> None:
    """After 3 s without a frame; only the true accuracy of their sensors, 0.9, is still known."""
    history = record(bus, 4.5).history
    x, x_hat, b_hat, true_accuracy = history.states_since().states[-1].values

    assert np.isnan([x, x_hat, b_hat]).all()
    assert (true_accuracy == 0.9).all()
    assert history.report is not None
    assert [row["silent"] for row in history.report["robots"]] == [True, True]


# --- A log without events -----------------------------------------------------------------------------


def write_log(path: Path, frames: dict[float, can.Message], comment: str = "") -> Path:
    """Write a log as candump does, with the frames by their times."""
    lines = [f"({seconds:.6f}) can0 {format_frame(frame)}\n" for seconds, frame in frames.items()]
    path.write_text(comment + "".join(lines))
    return path


@pytest.fixture
def frame_history(tmp_path: Path) -> FrameLogHistory:
    """The history of a log of 3.5 s: robot 7 comes first and falls silent, robot 3 sends telemetry."""
    frames = {
        1000.0: encode(Estimate(7, 1 << 21, 1, 0)),  # x_hat = 0.25
        1000.25: encode(Telemetry(3, 1 << 21, 1 << 22, 0, 0)),  # x = 0.25, b_hat = 0.25
        1003.5: encode(Telemetry(3, 1 << 22, 1 << 23, 0, 1)),  # x = 0.5, b_hat = 0.5
    }
    log = write_log(tmp_path / "real.log", frames, comment="# of Tuesday\n")
    return read_frame_history(log, FrameFormat(), fill_ratio=0.4, true_accuracy=0.9)


def test_the_description_of_a_log_has_its_name_and_robots(frame_history: FrameLogHistory) -> None:
    description = frame_history.history.description
    assert description.title == "real.log"
    assert description.robots == [7, 3]
    assert description.fill_ratio == 0.4


def test_a_log_has_ten_states_a_second(frame_history: FrameLogHistory) -> None:
    ticks = [state.tick for state in frame_history.history.states_since().states]
    assert ticks == [*range(37)]


@pytest.mark.parametrize(
    ("tick", "column", "values"),
    [
        (1, 0, [NAN, 0.25, NAN, 0.9]),
        (1, 1, [NAN, NAN, NAN, 0.9]),
        (4, 1, [0.25, NAN, 0.25, 0.9]),
        (36, 0, [NAN, NAN, NAN, 0.9]),
        (36, 1, [0.5, NAN, 0.5, 0.9]),
    ],
    ids=["estimate", "not yet a frame", "telemetry", "silent", "second telemetry"],
)
def test_states_of_a_log_have_what_its_robots_sent_before(
    frame_history: FrameLogHistory, tick: int, column: int, values: list[float]
) -> None:
    """The values of a robot are its x, x_hat, b_hat and b; NAN is what it has not sent, or not for long."""
    state = frame_history.history.states_since().states[tick]
    values_of_robot = state.values[:, column]
    assert np.array_equal(values_of_robot, values, equal_nan=True)


def test_a_log_has_a_report_and_has_ended(frame_history: FrameLogHistory) -> None:
    assert frame_history.history.report is not None
    assert frame_history.history.has_ended


def test_a_log_without_events_tells_of_telemetry_and_of_lines_that_were_left_out(
    frame_history: FrameLogHistory,
) -> None:
    assert frame_history.has_telemetry
    assert frame_history.summary.skipped_lines == 1


def test_a_log_of_months_has_a_limited_number_of_states(tmp_path: Path) -> None:
    frame = encode(HALF_ESTIMATE)
    log = write_log(tmp_path / "real.log", {0.0: frame, 2e7: frame})
    history = read_frame_history(log, FrameFormat()).history
    assert len(history.states_since().states) <= MAX_STATES + 1


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("(1.0) can0 123#00\n(2.0) can0 123#00\n", "has no estimate and no telemetry of a robot"),
        (" can0  106BB807   [8]  00 00 40 00 00 80 3F E0\n" * 2, "span 0 s, so they cannot be shown"),
        ("(0) can0 106BB807#000040000080 3FE0\n", "holds no frame"),
    ],
    ids=["no robot", "no times", "no frame"],
)
def test_a_log_that_cannot_be_shown_is_refused(text: str, reason: str, tmp_path: Path) -> None:
    log = tmp_path / "real.log"
    log.write_text(text)
    with pytest.raises(UsageError, match=reason):
        read_frame_history(log, FrameFormat())
