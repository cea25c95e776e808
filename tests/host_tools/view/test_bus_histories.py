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
from mcp_asdf_tools.recording.frame_logs import LogSummary
from mcp_asdf_tools.view import frame_history as frame_history_module
from mcp_asdf_tools.view.frame_history import FrameRecorder, KnownTruth, read_frame_log, record_bus
from mcp_asdf_tools.view.history import History

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
    monkeypatch.setattr(frame_history_module, "STATES_PER_SECOND", 8)
    return bus


def record(bus: Any, seconds: float, true_accuracy: float = 0.9) -> FrameRecorder:
    """Record a bus for some seconds, and return the recorder, which has its history.

    The sensors' true accuracy is known from the command line, as no frame has it.
    """
    recorder = FrameRecorder("a bus", FrameFormat(), KnownTruth(true_accuracy=true_accuracy))
    record_bus(bus, recorder, lambda: bus.now >= seconds)
    return recorder


def test_robots_of_a_bus_are_in_the_order_of_their_first_values(bus: ScriptedBus) -> None:
    """Robot 7 is the first to send, and robot 3 the second."""
    assert record(bus, seconds=0.5).history.description.robots == [7, 3]


def test_the_last_state_of_a_bus_has_the_latest_values_that_each_robot_sent(bus: ScriptedBus) -> None:
    """Robot 7 has sent x = b_hat = 0.5 and x_hat = 0.25, and robot 3 has sent x = b_hat = 0.25, but no x_hat.

    Values are in the order of the robots, 7 and 3. A value that no frame has had is unknown, NAN. The true
    accuracy of the sensors is given, as no frame has it.
    """
    history = record(bus, seconds=0.5, true_accuracy=0.9).history
    *_, last_state = history.states_since().states
    x, x_hat, b_hat, true_accuracy = last_state.values

    assert x.tolist() == [0.5, 0.25]
    assert np.array_equal(x_hat, [0.25, NAN], equal_nan=True)
    assert b_hat.tolist() == [0.5, 0.25]
    assert true_accuracy.tolist() == [0.9, 0.9]


def test_a_robot_has_no_values_in_states_before_its_first_frame_on_the_bus(bus: ScriptedBus) -> None:
    """There is a state every 1/8 s: at 0, 0.125, 0.25 and 0.375 s.

    Robot 3 sends x = 0.25 at 0.3125 s, so it has this x in the last of these four states.
    """
    states = record(bus, seconds=0.4).history.states_since().states
    x_of_robot_3_by_state = []
    for state in states:
        x, _x_hat, _b_hat, _true_accuracy = state.values
        _x_of_robot_7, x_of_robot_3 = x
        x_of_robot_3_by_state.append(x_of_robot_3)

    assert np.array_equal(x_of_robot_3_by_state, [NAN, NAN, NAN, 0.25], equal_nan=True)


def test_a_recorder_of_a_bus_knows_that_a_robot_sent_telemetry(bus: ScriptedBus) -> None:
    """Both robots of this bus send telemetry.

    ``mcp-asdf view`` warns where no robot did, as x and b_hat are unknown then.
    """
    assert record(bus, seconds=0.5).roster.has_telemetry


def test_the_report_on_a_bus_is_made_twice_a_second(bus: ScriptedBus) -> None:
    """The report is made at 0 s, and not again before 0.5 s.

    So it has a row for robot 7, which has been seen 0 s ago, and none for robot 3, which joins at 0.3125 s.
    """
    report = record(bus, seconds=0.4).history.report
    assert report is not None
    (row,) = report["robots"]
    assert row["robot"] == 7
    assert row["seen"] == 0.0


def test_robots_that_were_silent_for_3_s_are_marked_and_have_no_values_but_their_true_accuracy(
    bus: ScriptedBus,
) -> None:
    """The last frame of the bus came at 0.3125 s, and it is recorded for 4.5 s.

    The true accuracy is known from the command line.
    """
    history = record(bus, seconds=4.5, true_accuracy=0.9).history
    *_, last_state = history.states_since().states
    x, x_hat, b_hat, true_accuracy = last_state.values

    assert np.isnan([x, x_hat, b_hat]).all()
    assert true_accuracy.tolist() == [0.9, 0.9]
    assert history.report is not None
    assert [row["silent"] for row in history.report["robots"]] == [True, True]


# --- A log without events -----------------------------------------------------------------------------


def write_log(path: Path, frames: dict[float, can.Message]) -> Path:
    """Write a log as candump does, with the frames by their times."""
    lines = [f"({seconds:.6f}) can0 {format_frame(frame)}\n" for seconds, frame in frames.items()]
    path.write_text("".join(lines))
    return path


def record_log(log: Path) -> FrameRecorder:
    """Record all frames of a log; the user has given a fill ratio of 0.4 and a true accuracy of 0.9."""
    return read_frame_log(log, FrameFormat(), KnownTruth(0.4, 0.9), LogSummary())


@pytest.fixture
def log_history(tmp_path: Path) -> History:
    """The history of a log of 3.5 s: robot 7 sends x_hat = 0.25 at the start, and then nothing more.

    Robot 3 sends telemetry: x = b_hat = 0.25 after 0.25 s, and x = b_hat = 0.5 after 3.5 s.
    """
    frames = {
        1000.0: encode(Estimate(7, x_hat=X_ONE // 4, alpha=1, transfer_id=0)),
        1000.25: encode(Telemetry(3, x=X_ONE // 4, b_hat=B_HAT_ONE // 4, updates=0, transfer_id=0)),
        1003.5: encode(Telemetry(3, x=X_ONE // 2, b_hat=B_HAT_ONE // 2, updates=0, transfer_id=1)),
    }
    return record_log(write_log(tmp_path / "real.log", frames)).history


def values_of_robots_7_and_3(history: History, tick: int) -> tuple[list[float], list[float]]:
    """Return the values of the two robots in one state: x, x_hat, b_hat and true accuracy of each."""
    robot_7, robot_3 = history.states_since().states[tick].values.T.tolist()
    return robot_7, robot_3


def test_the_description_of_a_log_has_its_file_name_its_robots_and_the_fill_ratio(
    log_history: History,
) -> None:
    """Robot 7 is the first to send in real.log. The user has given the fill ratio, 0.4."""
    description = log_history.description
    assert description.title == "real.log"
    assert description.robots == [7, 3]
    assert description.fill_ratio == 0.4


def test_a_log_of_frames_is_shown_with_ten_states_a_second(log_history: History) -> None:
    """The log is 3.5 s long. The states 0 to 35 are from 0 to 3.5 s."""
    states = log_history.states_since().states
    assert [state.tick for state in states] == list(range(35 + 1))


def test_a_robot_has_the_values_of_its_last_telemetry(log_history: History) -> None:
    """Robot 3 sends x = b_hat = 0.25 after 0.25 s, and x = b_hat = 0.5 after 3.5 s, but never an x_hat.

    State 4 is at 0.4 s, and state 35 at 3.5 s. The true accuracy, 0.9, is given by the user.
    """
    _robot_7, robot_3_at_400_ms = values_of_robots_7_and_3(log_history, tick=4)
    x, x_hat, b_hat, true_accuracy = robot_3_at_400_ms
    assert (x, b_hat, true_accuracy) == (0.25, 0.25, 0.9)
    assert np.isnan(x_hat)

    _robot_7, robot_3_at_3500_ms = values_of_robots_7_and_3(log_history, tick=35)
    x, x_hat, b_hat, true_accuracy = robot_3_at_3500_ms
    assert (x, b_hat, true_accuracy) == (0.5, 0.5, 0.9)
    assert np.isnan(x_hat)


def test_a_log_of_frames_has_ended_and_has_a_report_on_its_robots(log_history: History) -> None:
    """The report is the table of robots that a web page shows below the charts.

    Its rows are in the order of the robots' ids, 3 and 7.
    """
    assert log_history.has_ended
    assert log_history.report is not None
    assert [row["robot"] for row in log_history.report["robots"]] == [3, 7]


def test_a_frame_of_a_second_bus_that_stands_late_in_a_log_does_not_set_back_the_time_of_its_robot(
    tmp_path: Path,
) -> None:
    """``candump any`` writes frames of two buses out of order. The last frame of robot 7 is not its newest.

    It was seen at 1003 s, 1 s before the end of the log. If 1000.5 s, in a later line, counted, it would seem
    to have been seen 3.5 s before the end.
    """
    frame_of_7 = encode(Estimate(sender=7, x_hat=0, alpha=1, transfer_id=0))
    frame_of_9 = encode(Estimate(sender=9, x_hat=0, alpha=1, transfer_id=0))
    frames = {1000.0: frame_of_7, 1003.0: frame_of_7, 1000.5: frame_of_7, 1004.0: frame_of_9}
    report = record_log(write_log(tmp_path / "any.log", frames)).history.report
    assert report is not None
    row_of_robot_7, _row_of_robot_9 = report["robots"]
    seconds_since_last_frame = row_of_robot_7["seen"]
    assert seconds_since_last_frame == 1.0


def test_of_a_log_with_frames_of_two_buses_those_of_the_chosen_one_are_shown(tmp_path: Path) -> None:
    """Robot 7 sends on can0, twice, and robot 3 on can3."""
    frame_of_7 = format_frame(encode(Estimate(sender=7, x_hat=0, alpha=1, transfer_id=0)))
    frame_of_3 = format_frame(encode(Estimate(sender=3, x_hat=0, alpha=1, transfer_id=0)))
    log = tmp_path / "any.log"
    log.write_text(f"(1.0) can0 {frame_of_7}\n(1.5) can3 {frame_of_3}\n(2.0) can0 {frame_of_7}\n")
    recorder = read_frame_log(log, FrameFormat(), KnownTruth(), LogSummary(), channel="can0")
    assert recorder.history.description.robots == [7]


def test_a_log_of_eight_months_is_shown_with_a_limited_number_of_states(tmp_path: Path) -> None:
    """Eight months have 20 million seconds. With ten states a second there would be 200 million states.

    There are at most 10,000, and the states at the start and at the end.
    """
    frame = encode(Estimate(sender=7, x_hat=0, alpha=1, transfer_id=0))
    log = write_log(tmp_path / "real.log", {0.0: frame, 20_000_000.0: frame})
    history = record_log(log).history
    assert len(history.states_since().states) <= 10_000 + 2


def test_months_of_a_log_before_its_first_robot_have_no_states(tmp_path: Path) -> None:
    """Eight months after a foreign frame a robot sends an estimate, and another one a second later."""
    foreign_frame = can.Message(arbitration_id=1, is_extended_id=False)
    estimate = encode(Estimate(sender=7, x_hat=0, alpha=1, transfer_id=0))
    frames = {0.0: foreign_frame, 20_000_000.0: estimate, 20_000_001.0: estimate}
    history = record_log(write_log(tmp_path / "real.log", frames)).history
    ticks = [state.tick for state in history.states_since().states]
    assert ticks == list(range(200_000_000, 200_000_010 + 1))


@pytest.mark.parametrize(
    ("log_text", "expected_reason"),
    [
        ("(1.0) can0 123#00\n(2.0) can0 123#00\n", "has no estimate and no telemetry of a robot"),
        (" can0  106BB807   [8]  00 00 40 00 00 80 3F E0\n" * 2, "span 0 s, so they cannot be shown"),
        ("(0) can0 106BB807#000040000080 3FE0\n", "holds no frame"),
    ],
    ids=["no robot", "no times", "no frame"],
)
def test_a_log_without_robots_without_times_or_without_frames_is_refused_with_the_reason(
    log_text: str, expected_reason: str, tmp_path: Path
) -> None:
    """A log of "(1.0) can0 123#00", for example, "has no estimate and no telemetry of a robot"."""
    log = tmp_path / "real.log"
    log.write_text(log_text)
    with pytest.raises(UsageError, match=expected_reason):
        record_log(log)
