"""The roster of a bus: what the tables of its web page show of each robot, from the robot's frames."""

from __future__ import annotations

from typing import Any

import can
import numpy as np
import pytest

from mcp_asdf.fixed_point import alpha_word_from_float
from mcp_asdf_tools.bus.frame_layout import Health, Mode, Rejection
from mcp_asdf_tools.bus.frames import Estimate, FrameFormat, Heartbeat, Telemetry, encode_estimate
from mcp_asdf_tools.robots.suspicion import Suspicion
from mcp_asdf_tools.view.roster import Roster
from wire import make_node

FRAME = can.Message()
"""Any frame: of a frame that is not rejected, a roster takes the content alone."""


X_ONE, B_HAT_ONE = 2**23, 2**24
"""What stands for 1 in the x or x_hat of a frame, and in its b_hat."""


class RosterOfRobot3(Roster):
    """A roster that receives frames of robot 3, or of another robot."""

    def receive_estimate(
        self, transfer_id: int, now: float, robot: int = 3, x_hat: float = 0.0, alpha: float = 0.0
    ) -> None:
        """Receive the frame of an estimate at the time ``now``."""
        estimate = Estimate(robot, round(x_hat * X_ONE), alpha_word_from_float(alpha), transfer_id)
        self.receive(FRAME, estimate, now)

    def receive_heartbeat(
        self,
        uptime: int,
        transfer_id: int,
        now: float = 0.0,
        health: Health = Health.NOMINAL,
        mode: Mode = Mode.OPERATIONAL,
    ) -> None:
        """Receive a heartbeat of robot 3 at the time ``now``."""
        self.receive(FRAME, Heartbeat(3, uptime, transfer_id, health, mode), now)

    def receive_telemetry(
        self, transfer_id: int, now: float, x: float = 0.0, b_hat: float = 0.5, updates: int = 0
    ) -> None:
        """Receive telemetry of robot 3 at the time ``now``."""
        telemetry = Telemetry(3, round(x * X_ONE), round(b_hat * B_HAT_ONE), updates, transfer_id)
        self.receive(FRAME, telemetry, now)

    def row(self, now: float, robot: int = 3) -> dict[str, Any]:
        """Return the row of a robot in a report."""
        rows = self.report(now)["robots"]
        return next(row for row in rows if row["robot"] == robot)


@pytest.fixture
def roster() -> RosterOfRobot3:
    return RosterOfRobot3()


# --- Lost frames --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("transfer_ids", "expected_loss"),
    [
        ([5, 7], 1 / 3),
        ([5, 6, 7], 0),
        ([30, 31, 0, 1], 0),
        ([30, 1], 2 / 4),  # 31 and 0 are missing
        ([7, 7, 8], 0),  # one comes twice
        ([8, 7], 30 / 32),  # 9 to 31 and 0 to 6 are missing
    ],
)
def test_missing_transfer_ids_between_two_others_are_lost_frames(
    roster: RosterOfRobot3, transfer_ids: list[int], expected_loss: float
) -> None:
    """A robot numbers its frames from 0 to 31 and then from 0 again. Loss is the share of missing ones.

    After the numbers 5 and 7, for example, one of three frames is missing, number 6: a loss of 1 / 3.
    """
    for transfer_id in transfer_ids:
        roster.receive_estimate(transfer_id, now=0.0)
    assert roster.row(now=1.0)["loss"] == expected_loss


def test_estimates_heartbeats_and_telemetry_are_numbered_separately(roster: RosterOfRobot3) -> None:
    """Nothing is lost of the estimates with the numbers 9 and 10.

    Between them come a heartbeat with the number 2 and telemetry with the number 30.
    """
    roster.receive_estimate(transfer_id=9, now=0.0)
    roster.receive_heartbeat(uptime=100, transfer_id=2)
    roster.receive_telemetry(transfer_id=30, now=0.0)
    roster.receive_estimate(transfer_id=10, now=0.0)

    assert roster.row(now=1.0)["loss"] == 0


def test_frames_of_two_robots_are_numbered_separately(roster: RosterOfRobot3) -> None:
    """Robot 3 has lost nothing: number 20 between its numbers 9 and 10 is of robot 2."""
    roster.receive_estimate(transfer_id=9, now=0.0, robot=3)
    roster.receive_estimate(transfer_id=20, now=0.0, robot=2)
    roster.receive_estimate(transfer_id=10, now=0.0, robot=3)
    assert roster.row(now=1.0, robot=3)["loss"] == 0


@pytest.mark.parametrize(("silence", "expected_loss"), [(2.99, 9 / 11), (3.0, 0)])
def test_missing_transfer_ids_after_a_silence_of_3_s_are_no_loss(
    roster: RosterOfRobot3, silence: float, expected_loss: float
) -> None:
    """The robot may have sent any number of frames meanwhile.

    After 2.99 s the nine frames between the numbers 10 and 20 are lost, of eleven with these two: 9 / 11.
    """
    roster.receive_estimate(transfer_id=10, now=1.0)
    roster.receive_estimate(transfer_id=20, now=1.0 + silence)
    assert roster.row(now=4.0)["loss"] == expected_loss


# --- Rates and silence --------------------------------------------------------------------------------


@pytest.fixture
def roster_after_ten_seconds(roster: RosterOfRobot3) -> RosterOfRobot3:
    """Robot 3 has sent ten estimates a second, from 50 s to 59.9 s."""
    for tick in range(100):
        roster.receive_estimate(transfer_id=tick % 32, now=50 + tick / 10)
    return roster


@pytest.mark.parametrize(("frames", "now", "expected_rate"), [(2, 50.1, 2 / 1.0), (21, 52.0, 21 / 2.0)])
def test_the_rate_of_a_new_robot_is_that_since_its_first_frame(
    frames: int, now: float, expected_rate: float, roster: RosterOfRobot3
) -> None:
    """The rate is the number of frames / the seconds since the first frame, but at least one second.

    The robot sends a frame every tenth of a second, from 50 s on. At 52 s it has sent 21: 21 / 2.0 s.
    """
    for tick in range(frames):
        roster.receive_estimate(transfer_id=tick, now=50 + tick / 10)
    assert roster.row(now)["rate"] == expected_rate


def test_the_rate_of_a_robot_is_its_rate_in_the_last_five_seconds(
    roster_after_ten_seconds: RosterOfRobot3,
) -> None:
    """The robot has sent ten frames a second from 50 s to 59.9 s. The rate is in frames a second.

    At 62.9 s only the frames since 57.9 s count. They are 20 or 21, as times are rounded.
    """
    assert roster_after_ten_seconds.row(now=59.9)["rate"] == 10.0
    assert roster_after_ten_seconds.row(now=62.9)["rate"] in (20 / 5, 21 / 5)
    assert roster_after_ten_seconds.row(now=70.0)["rate"] == 0


@pytest.mark.parametrize(("now", "is_silent"), [(62.89, False), (62.9, True)])
def test_a_robot_is_silent_three_seconds_after_its_last_frame(
    roster_after_ten_seconds: RosterOfRobot3, now: float, is_silent: bool
) -> None:
    """The robot has sent its last frame at 59.9 s, so it is silent from 62.9 s on."""
    assert roster_after_ten_seconds.row(now)["silent"] == is_silent


def test_the_table_shows_how_many_seconds_ago_a_robot_was_seen(
    roster_after_ten_seconds: RosterOfRobot3,
) -> None:
    """The robot has sent its last frame at 59.9 s, which is 3 s before 62.9 s."""
    assert roster_after_ten_seconds.row(now=62.9)["seen"] == 3.0


# --- Jumps of alpha -----------------------------------------------------------------------------------


@pytest.mark.parametrize(("next_alpha", "expected_jumps"), [(200, 1), (199, 0)])
def test_an_alpha_that_doubles_after_32_estimates_is_a_jump_in_the_table_as_in_a_robot(
    roster: RosterOfRobot3, next_alpha: int, expected_jumps: int
) -> None:
    """A robot sends its confidence alpha with each estimate. Tables and robots count its suspicious jumps.

    Robot 3 sends alpha = 100 32 times, and then the next one. Robot 5 receives the same estimates as the
    table.
    """
    robot_5 = make_node(5)
    for tick, alpha in enumerate([100] * 32 + [next_alpha]):
        alpha_word = alpha << 8  # the lowest 8 bits of an alpha word are its shift, 0 here
        estimate = Estimate(sender=3, x_hat=0, alpha=alpha_word, transfer_id=tick % 32)
        frame = encode_estimate(estimate, FrameFormat())
        roster.receive(frame, estimate, now=0.0)
        robot_5.receive_frame(frame)

    assert roster.row(now=0.0, robot=3)["jumps"] == expected_jumps
    assert robot_5.reception.events[Suspicion.JUMP, 3] == expected_jumps


# --- States and values --------------------------------------------------------------------------------


def test_the_table_shows_health_and_mode_of_a_robot_s_last_heartbeat(roster: RosterOfRobot3) -> None:
    """A robot sends a heartbeat that is nominal and operational, then one with another health and mode."""
    roster.receive_heartbeat(uptime=100, transfer_id=2)
    roster.receive_heartbeat(uptime=101, transfer_id=3, health=Health.ADVISORY, mode=Mode.MAINTENANCE)
    row = roster.row(now=0.0)
    assert row["health"] == "advisory"
    assert row["mode"] == "maintenance"


def test_the_table_shows_the_values_of_a_robot_s_last_telemetry(roster: RosterOfRobot3) -> None:
    """The values are the estimate x, the estimated accuracy b_hat and the number of updates of b_hat."""
    roster.receive_telemetry(transfer_id=0, now=0.0, x=0.5, b_hat=0.9, updates=6)
    roster.receive_telemetry(transfer_id=1, now=0.0, x=0.25, b_hat=0.75, updates=7)
    row = roster.row(now=0.0)
    assert row["x"] == 0.25
    assert row["b_hat"] == 0.75
    assert row["updates"] == 7


def test_a_robot_that_has_only_sent_an_estimate_has_unknown_state_and_values(roster: RosterOfRobot3) -> None:
    """State and values come with heartbeats and telemetry. None stands for unknown."""
    roster.receive_estimate(transfer_id=0, now=0.0)
    row = roster.row(now=0.0)
    for name in ("health", "mode", "x", "b_hat", "updates"):
        assert row[name] is None, name


def test_a_robot_that_was_silent_has_unknown_values_until_it_sends_them_again(roster: RosterOfRobot3) -> None:
    """It sends all of its values, and after a silence of 5 s only a heartbeat."""
    roster.receive_estimate(transfer_id=0, now=0.0, x_hat=0.75)
    roster.receive_telemetry(transfer_id=0, now=0.0, x=0.5)
    roster.receive_heartbeat(uptime=5, transfer_id=5, now=5.0)
    x, x_hat, b_hat = roster.robots[3].values(now=5.0)
    assert np.isnan([x, x_hat, b_hat]).all()


def test_robots_are_in_the_table_in_the_order_of_their_ids(roster: RosterOfRobot3) -> None:
    """They send their first frames in the order 9, 2, 5."""
    for robot in (9, 2, 5):
        roster.receive_estimate(transfer_id=0, now=0.0, robot=robot)
    rows = roster.report(now=0.0)["robots"]
    assert [row["robot"] for row in rows] == [2, 5, 9]


# --- Conflicts of ids ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("uptimes_and_transfer_ids", "expected_conflicts"),
    [
        ([(1, 1), (2, 2), (4, 4), (5, 5)], 0),
        ([(100, 4), (0, 0), (1, 1), (2, 2)], 0),
        ([(0, 0), (1, 1), (0, 0), (1, 1), (0, 0)], 0),
        ([(100, 4), (5, 5), (101, 5), (6, 6), (102, 6)], 2),
        ([(100, 4), (0, 0), (102, 5)], 0),
        ([(7, 7), (7, 7), (8, 8), (8, 8)], 2),
    ],
    ids=["one node", "a restart", "restarts in a row", "two nodes", "a continuation by chance", "in step"],
)
def test_heartbeats_of_two_robots_with_one_id_are_conflicts_and_those_of_a_restarted_one_are_not(
    roster: RosterOfRobot3, uptimes_and_transfer_ids: list[tuple[int, int]], expected_conflicts: int
) -> None:
    """Heartbeats of a robot count its seconds (uptime) and its heartbeats (transfer id) up together.

    A restarted robot counts from 0 again. So a heartbeat is a conflict if it comes twice, or if it continues
    the count from before a restart: of the uptimes 100, 5, 101, 6 and 102 the two are 101 and 102.
    """
    for uptime, transfer_id in uptimes_and_transfer_ids:
        roster.receive_heartbeat(uptime, transfer_id)
    assert roster.row(now=0.0)["conflicts"] == expected_conflicts


# --- The list of frames -------------------------------------------------------------------------------


def frames_in_next_report(roster: Roster) -> list[list[Any]]:
    """Make a report, and return its list of frames, each a list of time, sender and content."""
    frames: list[list[Any]] = roster.report(0.0)["frames"]
    return frames


def test_a_frame_is_listed_with_its_time_its_sender_and_what_it_holds(roster: RosterOfRobot3) -> None:
    """Robot 3 sends frames of three kinds: an estimate, a heartbeat and telemetry."""
    roster.receive_estimate(transfer_id=8, now=1.0, x_hat=0.5, alpha=0.25)
    roster.receive_heartbeat(uptime=100, transfer_id=2, now=250.0, mode=Mode.MAINTENANCE)
    roster.receive_telemetry(transfer_id=30, now=251.0, x=0.25, b_hat=0.75, updates=7)
    assert frames_in_next_report(roster) == [
        [1.0, 3, "estimate 8: x_hat 0.5000, alpha 0.25"],
        [250.0, 3, "heartbeat 2: nominal, maintenance, up 100 s"],
        [251.0, 3, "telemetry 30: x 0.2500, b_hat 0.7500, updates 7"],
    ]


def test_a_rejected_frame_is_listed_with_the_reason_and_without_a_sender(roster: RosterOfRobot3) -> None:
    """Robots send frames with extended identifiers, so one with a standard identifier, 0x123, is rejected.

    None stands in place of the sender.
    """
    frame = can.Message(arbitration_id=0x123, is_extended_id=False, data=b"\1")
    roster.receive(frame, Rejection.STANDARD_ID, now=252.0)
    assert frames_in_next_report(roster) == [[252.0, None, "refused, standard id: 123#01"]]


def test_a_report_on_5000_frames_lists_the_last_4000(roster: RosterOfRobot3) -> None:
    """The frames come at 0, 1, 2, ... 4999 seconds."""
    for tick in range(5000):
        roster.receive_estimate(transfer_id=tick % 32, now=float(tick))
    times = [time for time, _robot, _text in frames_in_next_report(roster)]
    assert times == list(range(1000, 5000))


def test_a_frame_that_was_in_a_report_is_not_in_the_next_one(roster: RosterOfRobot3) -> None:
    """A web page gets each report, and appends the frames to its list."""
    roster.receive_estimate(transfer_id=8, now=1.0)
    assert len(frames_in_next_report(roster)) == 1
    assert frames_in_next_report(roster) == []
