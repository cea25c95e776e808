"""The roster of a bus: what the tables of its web page show of each robot, from the robot's frames."""

from __future__ import annotations

from typing import Any

import can
import pytest

from mcp_asdf.fixed_point import alpha_word_from_float
from mcp_asdf_tools.bus.frame_layout import Health, Mode, Rejection
from mcp_asdf_tools.bus.frames import Estimate, FrameFormat, Heartbeat, Telemetry, encode_estimate
from mcp_asdf_tools.robots.suspicion import Suspicion
from mcp_asdf_tools.view.roster import Roster
from wire import node

FRAME = can.Message()
"""Any frame: of a frame that is not rejected, a roster takes the content alone."""


X_ONE, B_HAT_ONE = 2**23, 2**24
"""What stands for 1 in the x or x_hat of a frame, and in its b_hat."""


class RosterOfRobot3(Roster):
    """A roster that receives frames of robot 3, or of another robot."""

    def receive_estimate(self, transfer_id: int, now: float, robot: int = 3) -> None:
        """x_hat = 0.5 and alpha = 0.25."""
        alpha = alpha_word_from_float(0.25)
        self.receive(FRAME, Estimate(robot, x_hat=X_ONE // 2, alpha=alpha, transfer_id=transfer_id), now)

    def receive_heartbeat(
        self, uptime: int, transfer_id: int, now: float = 0.0, health: Health = Health.NOMINAL
    ) -> None:
        self.receive(FRAME, Heartbeat(3, uptime, transfer_id, health, Mode.MAINTENANCE), now)

    def receive_telemetry(self, now: float) -> None:
        """x = 0.25, b_hat = 0.75 and 7 updates."""
        x, b_hat = X_ONE // 4, 3 * B_HAT_ONE // 4
        self.receive(FRAME, Telemetry(3, x, b_hat, updates=7, transfer_id=30), now)

    def row(self, now: float, robot: int = 3) -> dict[str, Any]:
        """Return the row of a robot in a report."""
        rows = self.report(now)["robots"]
        return next(row for row in rows if row["robot"] == robot)


@pytest.fixture
def roster() -> RosterOfRobot3:
    return RosterOfRobot3()


# --- Lost frames --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("transfer_ids", "loss"),
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
    roster: RosterOfRobot3, transfer_ids: list[int], loss: float
) -> None:
    """A robot numbers its frames from 0 to 31 and then from 0 again. Loss is the share of missing ones."""
    for transfer_id in transfer_ids:
        roster.receive_estimate(transfer_id, now=0.0)
    assert roster.row(now=1.0)["loss"] == loss


def test_estimates_heartbeats_and_telemetry_are_numbered_separately(roster: RosterOfRobot3) -> None:
    """Nothing is lost: the heartbeat's number 2 lies between the estimates with the numbers 9 and 10."""
    roster.receive_estimate(9, now=0.0)
    roster.receive_heartbeat(100, transfer_id=2)
    roster.receive_telemetry(now=0.0)
    roster.receive_estimate(10, now=0.0)

    assert roster.row(now=1.0)["loss"] == 0


def test_frames_of_two_robots_are_numbered_separately(roster: RosterOfRobot3) -> None:
    """Robot 3 has lost nothing: number 20 between its numbers 9 and 10 is of robot 2."""
    roster.receive_estimate(9, now=0.0)
    roster.receive_estimate(20, now=0.0, robot=2)
    roster.receive_estimate(10, now=0.0)
    assert roster.row(now=1.0)["loss"] == 0


@pytest.mark.parametrize(("silence", "loss"), [(2.99, 9 / 11), (3.0, 0)])
def test_missing_transfer_ids_after_a_silence_of_3_s_are_no_loss(
    roster: RosterOfRobot3, silence: float, loss: float
) -> None:
    """The robot may have sent any number of frames meanwhile.

    After 2.99 s the nine frames between the numbers 10 and 20 are lost, of eleven with these two.
    """
    roster.receive_estimate(10, now=1.0)
    roster.receive_estimate(20, now=1.0 + silence)
    assert roster.row(now=4.0)["loss"] == loss


# --- Rates and silence --------------------------------------------------------------------------------


@pytest.fixture
def regular_roster(roster: RosterOfRobot3) -> RosterOfRobot3:
    """Robot 3 has sent ten estimates a second, from 50 s to 59.9 s."""
    for tick in range(100):
        roster.receive_estimate(tick % 32, now=50 + tick / 10)
    return roster


@pytest.mark.parametrize(("frames", "now", "rate"), [(2, 50.1, 2 / 1.0), (21, 52.0, 21 / 2.0)])
def test_the_rate_of_a_new_robot_is_that_since_its_first_frame(
    frames: int, now: float, rate: float, roster: RosterOfRobot3
) -> None:
    """The rate is the number of frames / the seconds since the first frame, but at least one second.

    The robot sends a frame every tenth of a second, from 50 s on.
    """
    for tick in range(frames):
        roster.receive_estimate(tick, now=50 + tick / 10)
    assert roster.row(now)["rate"] == rate


def test_the_rate_of_a_robot_is_its_rate_in_the_last_five_seconds(regular_roster: RosterOfRobot3) -> None:
    """It sends ten frames a second until 59.9 s. At 62.9 s it has sent 20 or 21 frames in the last five."""
    assert regular_roster.row(now=59.9)["rate"] == 10.0
    assert regular_roster.row(now=62.9)["rate"] in (20 / 5, 21 / 5)
    assert regular_roster.row(now=70.0)["rate"] == 0


@pytest.mark.parametrize(("now", "is_silent"), [(62.89, False), (62.9, True)])
def test_a_robot_is_silent_three_seconds_after_its_last_frame(
    regular_roster: RosterOfRobot3, now: float, is_silent: bool
) -> None:
    """It sends its last frame at 59.9 s, so it is silent from 62.9 s on."""
    assert regular_roster.row(now)["silent"] == is_silent


def test_the_table_shows_how_many_seconds_ago_a_robot_was_seen(regular_roster: RosterOfRobot3) -> None:
    """It sends its last frame at 59.9 s, which is 3 s before 62.9 s."""
    assert regular_roster.row(now=62.9)["seen"] == 3.0


# --- Jumps of alpha -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("alphas", "jumps"),
    [
        ([100] * 32 + [200], 1),
        ([100] * 32 + [199], 0),
        ([100] * 31 + [200], 0),
        ([100] * 33 + [50], 0),
        ([100] * 33 + [50] * 32 + [100], 0),
        ([100] * 33 + [50] * 33 + [100], 1),
    ],
    ids=["doubled", "less than doubled", "too early", "halved", "anew, too early", "anew, doubled"],
)
def test_an_alpha_that_doubles_after_32_estimates_is_a_jump_in_the_table_as_in_a_robot(
    roster: RosterOfRobot3, alphas: list[int], jumps: int
) -> None:
    """A robot sends its confidence alpha with each estimate. Tables and robots count its suspicious jumps.

    For example, 32 times 100 and then 200 is a jump, while 31 times 100 and then 200 comes too early.
    """
    listening_robot = node(5)
    for tick, alpha in enumerate(alphas):
        # The mantissa of alpha stands above the lowest 8 bits of its word.
        estimate = Estimate(sender=3, x_hat=X_ONE // 2, alpha=alpha << 8, transfer_id=tick % 32)
        roster.receive(FRAME, estimate, now=0.0)
        listening_robot.receive_frame(encode_estimate(estimate, FrameFormat()))

    assert roster.row(now=0.0)["jumps"] == jumps
    assert listening_robot.reception.events[Suspicion.JUMP, 3] == jumps


# --- States and values --------------------------------------------------------------------------------


def test_the_table_shows_health_and_mode_of_a_robot_s_last_heartbeat(roster: RosterOfRobot3) -> None:
    """The heartbeats of this roster have the mode "maintenance"."""
    roster.receive_heartbeat(100, transfer_id=2, health=Health.ADVISORY)
    row = roster.row(now=0.0)
    assert (row["health"], row["mode"]) == ("advisory", "maintenance")


def test_the_table_shows_the_values_of_a_robot_s_last_telemetry(roster: RosterOfRobot3) -> None:
    """Telemetry of this roster has x = 0.25, b_hat = 0.75 and 7 updates."""
    roster.receive_telemetry(now=0.0)
    row = roster.row(now=0.0)
    assert row["x"] == 0.25
    assert row["b_hat"] == 0.75
    assert row["updates"] == 7


def test_a_robot_that_has_only_sent_an_estimate_has_unknown_state_and_values(roster: RosterOfRobot3) -> None:
    """State and values come with heartbeats and telemetry. None stands for unknown."""
    roster.receive_estimate(0, now=0.0)
    row = roster.row(now=0.0)
    for name in ("health", "mode", "x", "b_hat", "updates"):
        assert row[name] is None, name


def test_robots_are_in_the_table_in_the_order_of_their_ids(roster: RosterOfRobot3) -> None:
    """They send their first frames in the order 9, 2, 5."""
    for robot in (9, 2, 5):
        roster.receive_estimate(0, now=0.0, robot=robot)
    assert [row["robot"] for row in roster.report(0.0)["robots"]] == [2, 5, 9]


# --- Conflicts of ids ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("uptimes_and_transfer_ids", "conflicts"),
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
    roster: RosterOfRobot3, uptimes_and_transfer_ids: list[tuple[int, int]], conflicts: int
) -> None:
    """Heartbeats of a robot count its seconds (uptime) and its heartbeats (transfer id) up together.

    A restarted robot counts from 0 again. A heartbeat that comes twice, or that continues not the latest one
    but the one before it, is a conflict. For example, with uptimes of 100, 5, 101, 6 and 102 two are.
    """
    for uptime, transfer_id in uptimes_and_transfer_ids:
        roster.receive_heartbeat(uptime, transfer_id)
    assert roster.row(now=0.0)["conflicts"] == conflicts


# --- The list of frames -------------------------------------------------------------------------------


def list_frames(roster: Roster) -> list[list[Any]]:
    """Return the frames of a report."""
    frames: list[list[Any]] = roster.report(0.0)["frames"]
    return frames


def test_a_frame_is_listed_with_its_time_its_sender_and_what_it_holds(roster: RosterOfRobot3) -> None:
    """Robot 3 sends frames of three kinds, with an x_hat of 0.5 and an x of 0.25."""
    roster.receive_estimate(8, now=1.0)
    roster.receive_heartbeat(uptime=100, transfer_id=2, now=250.0)
    roster.receive_telemetry(now=251.0)
    assert list_frames(roster) == [
        [1.0, 3, "estimate 8: x_hat 0.5000, alpha 0.25"],
        [250.0, 3, "heartbeat 2: nominal, maintenance, up 100 s"],
        [251.0, 3, "telemetry 30: x 0.2500, b_hat 0.7500, updates 7"],
    ]


def test_a_rejected_frame_is_listed_with_the_reason_and_without_a_sender(roster: RosterOfRobot3) -> None:
    """Robots send frames with extended identifiers, so one with a standard identifier, 0x123, is rejected."""
    frame = can.Message(arbitration_id=0x123, is_extended_id=False, data=b"\1")
    roster.receive(frame, Rejection.STANDARD_ID, now=252.0)
    assert list_frames(roster) == [[252.0, None, "refused, standard id: 123#01"]]


def test_a_report_on_5000_frames_lists_the_last_4000(roster: RosterOfRobot3) -> None:
    """The frames come at 0, 1, 2, ... 4999 seconds."""
    for tick in range(5000):
        roster.receive_estimate(tick % 32, now=float(tick))
    times = [time for time, _robot, _text in list_frames(roster)]
    assert times == list(range(1000, 5000))


def test_a_frame_that_was_in_a_report_is_not_in_the_next_one(roster: RosterOfRobot3) -> None:
    roster.receive_estimate(8, now=1.0)
    assert len(list_frames(roster)) == 1
    assert list_frames(roster) == []
