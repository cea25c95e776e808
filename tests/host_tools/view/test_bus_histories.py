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
from mcp_asdf_tools.view.history import MAX_STATES, History

NAN = np.nan
X_ONE, B_HAT_ONE = 1 << 23, 1 << 24
"""What stands for 1 in the x or x_hat of a frame, and in its b_hat."""


def encode(content: Estimate | Telemetry) -> can.Message:
    """Return the frame in which a robot broadcasts an estimate or telemetry."""
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
    """A bus with robots 7 and 3. Its history has a state every 1/8 s, and frames come between.

    Robot 7 sends x = b_hat = 0.5 at 0 s and x_hat = 0.25 at 0.1875 s; robot 3 sends x = b_hat = 0.25 at
    0.3125 s.
    """
    bus = ScriptedBus(
        {
            0.0: encode(Telemetry(7, x=X_ONE // 2, b_hat=B_HAT_ONE // 2, updates=0, transfer_id=0)),
            0.1875: encode(Estimate(7, x_hat=X_ONE // 4, alpha=1, transfer_id=0)),
            0.3125: encode(Telemetry(3, x=X_ONE // 4, b_hat=B_HAT_ONE // 4, updates=0, transfer_id=0)),
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
    """Robot 7 is the first to send, and robot 3 the second."""
    assert record(bus, seconds=0.5).history.description.robots == [7, 3]


def test_the_last_state_of_a_bus_has_the_latest_values_that_each_robot_sent(bus: ScriptedBus) -> None:
    """Robot 7 has sent x = b_hat = 0.5 and x_hat = 0.25, and robot 3 has sent x = b_hat = 0.25, but no x_hat.

    The true accuracy is 0.9. A value that no frame has had is unknown, NAN.
    """
    *_, last_state = record(bus, seconds=0.5).history.states_since().states
    x, x_hat, b_hat, true_accuracy = last_state.values

    assert x.tolist() == [0.5, 0.25]
    assert np.array_equal(x_hat, [0.25, NAN], equal_nan=True)
    assert b_hat.tolist() == [0.5, 0.25]
    assert true_accuracy.tolist() == [0.9, 0.9]


def test_a_robot_has_no_values_in_states_before_its_first_frame_on_the_bus(bus: ScriptedBus) -> None:
    """There is a state every 1/8 s.

    Robot 3 sends at 0.3125 s, so it has x = 0.25 in the last of four states.
    """
    states = record(bus, seconds=0.5).history.states_since().states
    x_of_robot_3_by_state = []
    for state in states:
        x, _x_hat, _b_hat, _true_accuracy = state.values
        _x_of_robot_7, x_of_robot_3 = x
        x_of_robot_3_by_state.append(x_of_robot_3)

    assert np.array_equal(x_of_robot_3_by_state, [NAN, NAN, NAN, 0.25], equal_nan=True)


def test_each_of_two_robots_that_join_a_bus_makes_open_pages_load_all_states_again(bus: ScriptedBus) -> None:
    """A web page that shows the bus loads all states again when the history's generation changes."""
    assert record(bus, seconds=0.5).history.generation == 2


def test_a_recorder_of_a_bus_knows_that_a_robot_sent_telemetry(bus: ScriptedBus) -> None:
    """``mcp-asdf view`` warns where no robot did, as x and b_hat are unknown then."""
    assert record(bus, seconds=0.5).has_telemetry


def test_the_report_on_a_bus_has_a_row_for_each_robot_once_a_second(bus: ScriptedBus) -> None:
    """The report is made at 0 s, when robot 7 has just been seen, and not again before 1 s."""
    report = record(bus, seconds=0.5).history.report
    assert report is not None
    (row,) = report["robots"]
    assert (row["robot"], row["seen"]) == (7, 0.0)


def test_robots_that_were_silent_for_3_s_are_marked_and_have_no_values_but_their_true_accuracy(
    bus: ScriptedBus,
) -> None:
    """The last frame of the bus came at 0.3125 s. The accuracy, 0.9, is known from the command line."""
    history = record(bus, seconds=4.5).history
    *_, last_state = history.states_since().states
    x, x_hat, b_hat, true_accuracy = last_state.values

    assert np.isnan([x, x_hat, b_hat]).all()
    assert true_accuracy.tolist() == [0.9, 0.9]
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
    """The history of a log of 3.5 s: robot 7 sends x_hat = 0.25 at the start, and then nothing more.

    Robot 3 sends telemetry: x = b_hat = 0.25 after 0.25 s, and x = b_hat = 0.5 after 3.5 s.
    """
    frames = {
        1000.0: encode(Estimate(7, x_hat=X_ONE // 4, alpha=1, transfer_id=0)),
        1000.25: encode(Telemetry(3, x=X_ONE // 4, b_hat=B_HAT_ONE // 4, updates=0, transfer_id=0)),
        1003.5: encode(Telemetry(3, x=X_ONE // 2, b_hat=B_HAT_ONE // 2, updates=0, transfer_id=1)),
    }
    log = write_log(tmp_path / "real.log", frames, comment="# of Tuesday\n")
    return read_frame_history(log, FrameFormat(), fill_ratio=0.4, true_accuracy=0.9)


def values_in(history: History, tick: int) -> tuple[list[float], list[float]]:
    """Return the values of each of two robots in one state: x, x_hat, b_hat and true accuracy."""
    first_robot, second_robot = history.states_since().states[tick].values.T.tolist()
    return first_robot, second_robot


def test_the_description_of_a_log_has_its_file_name_and_robots(frame_history: FrameLogHistory) -> None:
    """Robot 7 is the first to send, and the user has given the fill ratio, 0.4."""
    description = frame_history.history.description
    assert description.title == "real.log"
    assert description.robots == [7, 3]
    assert description.fill_ratio == 0.4


def test_a_log_of_frames_is_shown_with_ten_states_a_second(frame_history: FrameLogHistory) -> None:
    """The log is 3.5 s long. The states 0 to 35 are from 0 to 3.5 s, and one follows its last frame."""
    states = frame_history.history.states_since().states
    assert [state.tick for state in states] == list(range(37))


def test_a_robot_has_the_values_of_its_last_telemetry(frame_history: FrameLogHistory) -> None:
    """Robot 3 sends x = b_hat = 0.25 after 0.25 s, and 0.5 after 3.5 s.

    Values are x, x_hat, b_hat and accuracy.
    """
    _, robot_3_after_first = values_in(frame_history.history, tick=4)
    _, robot_3_after_second = values_in(frame_history.history, tick=36)
    assert np.array_equal(robot_3_after_first, [0.25, NAN, 0.25, 0.9], equal_nan=True)
    assert np.array_equal(robot_3_after_second, [0.5, NAN, 0.5, 0.9], equal_nan=True)


def test_a_robot_of_a_log_that_was_silent_for_3_s_has_no_values(frame_history: FrameLogHistory) -> None:
    """Robot 7 sent its only estimate 3.6 s before; the true accuracy, 0.9, is known without frames."""
    robot_7, _ = values_in(frame_history.history, tick=36)
    assert np.array_equal(robot_7, [NAN, NAN, NAN, 0.9], equal_nan=True)


def test_a_log_of_frames_has_ended_and_has_a_report_on_its_robots(frame_history: FrameLogHistory) -> None:
    """The report is the table of robots that a web page shows below the charts."""
    assert frame_history.history.report is not None
    assert frame_history.history.has_ended


def test_a_reader_of_a_log_knows_of_telemetry_and_of_lines_that_hold_no_frame(
    frame_history: FrameLogHistory,
) -> None:
    """The log begins with a comment, "# of Tuesday"; two robots' frames follow, some of telemetry."""
    assert frame_history.has_telemetry
    assert frame_history.summary.skipped_lines == 1


def test_a_frame_of_a_second_bus_that_stands_late_in_a_log_does_not_set_back_the_time_of_its_robot(
    tmp_path: Path,
) -> None:
    """``candump any`` writes frames of two buses out of order. The log's last frame is not the newest.

    Robot 7 would otherwise seem to have sent its last frame 2.5 s before the end of the log.
    """
    frame = encode(Estimate(7, x_hat=X_ONE // 2, alpha=1, transfer_id=0))
    log = write_log(tmp_path / "any.log", {1000.0: frame, 1003.0: frame, 1000.5: frame})
    report = read_frame_history(log, FrameFormat()).history.report
    assert report is not None
    (row,) = report["robots"]
    assert row["seen"] == 0.0


def test_a_log_of_eight_months_is_shown_with_a_limited_number_of_states(tmp_path: Path) -> None:
    """With ten states a second there would be 200 million of them."""
    frame = encode(Estimate(7, x_hat=X_ONE // 2, alpha=1, transfer_id=0))
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
def test_a_log_without_robots_without_times_or_without_frames_is_refused_with_the_reason(
    text: str, reason: str, tmp_path: Path
) -> None:
    """For example "(1.0) can0 123#00", a frame of no robot: "has no estimate and no telemetry of a robot"."""
    log = tmp_path / "real.log"
    log.write_text(text)
    with pytest.raises(UsageError, match=reason):
        read_frame_history(log, FrameFormat())
