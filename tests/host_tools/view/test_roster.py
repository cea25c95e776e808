"""The roster of a bus: what the page's table and list show of each robot, from its frames."""

from __future__ import annotations

from typing import Any

import can
import pytest

from mcp_asdf_tools.bus.frame_layout import Health, Mode, Rejection
from mcp_asdf_tools.bus.frames import Estimate, FrameFormat, Heartbeat, Telemetry, encode_estimate
from mcp_asdf_tools.robots.suspicion import Suspicion
from mcp_asdf_tools.view.roster import Roster
from wire import node

FRAME = can.Message()
"""Any frame: of a frame that is not rejected, a roster takes the content alone."""


class RosterOfRobot3(Roster):
    """A roster that receives frames of robot 3, or of another one."""

    def receive_estimate(self, transfer_id: int, now: float, robot: int = 3) -> None:
        self.receive(FRAME, Estimate(robot, 1 << 22, 1 << 30, transfer_id), now)

    def receive_heartbeat(
        self, uptime: int, transfer_id: int, now: float = 0.0, health: Health = Health.NOMINAL
    ) -> None:
        self.receive(FRAME, Heartbeat(3, uptime, transfer_id, health, Mode.MAINTENANCE), now)

    def receive_telemetry(self, now: float) -> None:
        """x = 0.25, b_hat = 0.75 and 7 updates."""
        self.receive(FRAME, Telemetry(3, 1 << 21, 3 << 22, 7, 30), now)

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
        ([5, 6, 7], 0),
        ([30, 31, 0, 1], 0),
        ([5, 7], 1 / 3),
        ([30, 1], 2 / 4),
        ([7, 7, 8], 0),
        ([8, 7], 30 / 32),
    ],
    ids=["none", "none at 32", "one", "two at 32", "received twice", "a gap of 30"],
)
def test_loss_is_counted_by_gaps_of_transfer_ids_modulo_32(
    roster: RosterOfRobot3, transfer_ids: list[int], loss: float
) -> None:
    """A robot numbers its frames from 0 to 31 and then from 0 again; loss is the share of missing numbers."""
    for transfer_id in transfer_ids:
        roster.receive_estimate(transfer_id, now=0.0)
    assert roster.row(now=1.0)["loss"] == loss


def test_each_kind_of_frame_has_transfer_ids_of_its_own(roster: RosterOfRobot3) -> None:
    roster.receive_estimate(9, now=0.0)
    roster.receive_heartbeat(100, transfer_id=2)
    roster.receive_telemetry(now=0.0)
    roster.receive_estimate(10, now=0.0)

    assert roster.row(now=1.0)["loss"] == 0


def test_each_robot_has_transfer_ids_of_its_own(roster: RosterOfRobot3) -> None:
    roster.receive_estimate(9, now=0.0)
    roster.receive_estimate(20, now=0.0, robot=2)
    roster.receive_estimate(10, now=0.0)
    assert roster.row(now=1.0)["loss"] == 0


@pytest.mark.parametrize(("silence", "loss"), [(2.99, 9 / 11), (3.0, 0)])
def test_a_gap_after_a_silence_of_3_s_counts_no_loss(
    roster: RosterOfRobot3, silence: float, loss: float
) -> None:
    """The robot may have sent any number of frames meanwhile."""
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


def test_the_rate_of_a_robot_that_has_just_begun_is_over_one_second(roster: RosterOfRobot3) -> None:
    roster.receive_estimate(0, now=50.0)
    roster.receive_estimate(1, now=50.1)
    assert roster.row(now=50.1)["rate"] == 2.0


def test_a_rate_is_over_the_time_since_the_first_frame(roster: RosterOfRobot3) -> None:
    for tick in range(21):
        roster.receive_estimate(tick, now=50 + tick / 10)
    assert roster.row(now=52.0)["rate"] == 21 / 2.0


def test_a_rate_is_over_5_s_at_most(regular_roster: RosterOfRobot3) -> None:
    assert regular_roster.row(now=59.9)["rate"] == 10.0
    # Of the last 5 s before 62.9 s the robot has sent for 2 s: 20 or 21 frames.
    assert regular_roster.row(now=62.9)["rate"] == pytest.approx(4.0, abs=0.21)
    assert regular_roster.row(now=70.0)["rate"] == 0


@pytest.mark.parametrize(("now", "is_silent"), [(62.89, False), (62.9, True)])
def test_a_robot_is_silent_after_3_s(regular_roster: RosterOfRobot3, now: float, is_silent: bool) -> None:
    assert regular_roster.row(now)["silent"] == is_silent


def test_a_row_says_how_long_ago_a_robot_was_seen(regular_roster: RosterOfRobot3) -> None:
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
def test_the_page_counts_the_jumps_that_a_node_counts(
    roster: RosterOfRobot3, alphas: list[int], jumps: int
) -> None:
    """A jump is a confidence alpha that is suddenly twice as large, from the 33rd estimate of a sender on."""
    listener = node(5)
    for tick, alpha in enumerate(alphas):
        estimate = Estimate(3, 1 << 22, alpha << 8, tick % 32)
        roster.receive(FRAME, estimate, 0.0)
        listener.receive_frame(encode_estimate(estimate, FrameFormat()))

    assert listener.reception.events[Suspicion.JUMP, 3] == jumps
    assert roster.row(now=0.0)["jumps"] == jumps


# --- States and values --------------------------------------------------------------------------------


def test_health_and_mode_are_those_of_the_last_heartbeat(roster: RosterOfRobot3) -> None:
    roster.receive_heartbeat(100, transfer_id=2, health=Health.ADVISORY)
    row = roster.row(now=0.0)
    assert (row["health"], row["mode"]) == ("advisory", "maintenance")


def test_values_are_those_of_the_last_telemetry(roster: RosterOfRobot3) -> None:
    roster.receive_telemetry(now=0.0)
    row = roster.row(now=0.0)
    assert row["x"] == 0.25
    assert row["b_hat"] == 0.75
    assert row["updates"] == 7


@pytest.mark.parametrize("name", ["health", "mode", "x", "b_hat", "updates"])
def test_what_no_frame_has_shown_is_unknown(roster: RosterOfRobot3, name: str) -> None:
    roster.receive_estimate(0, now=0.0)
    assert roster.row(now=0.0)[name] is None


def test_rows_are_in_the_order_of_the_ids(roster: RosterOfRobot3) -> None:
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
def test_two_nodes_with_one_id_are_distinguished_from_one_that_restarts(
    roster: RosterOfRobot3, uptimes_and_transfer_ids: list[tuple[int, int]], conflicts: int
) -> None:
    """Heartbeats of one node count its seconds (uptime) and its heartbeats (transfer id) up together.

    A restarted node counts from 0 again. A heartbeat that comes twice, or that continues not the latest one
    but the one before it, is a conflict: a second node sends under this id.
    """
    for uptime, transfer_id in uptimes_and_transfer_ids:
        roster.receive_heartbeat(uptime, transfer_id)
    assert roster.row(now=0.0)["conflicts"] == conflicts


# --- The list of frames -------------------------------------------------------------------------------


def list_frames(roster: Roster) -> list[list[Any]]:
    """Return the frames of a report."""
    frames: list[list[Any]] = roster.report(0.0)["frames"]
    return frames


def test_an_estimate_is_listed_with_its_values(roster: RosterOfRobot3) -> None:
    roster.receive_estimate(8, now=1.0)
    assert list_frames(roster) == [[1.0, 3, "estimate 8: x_hat 0.5000, alpha 0.25"]]


def test_a_heartbeat_is_listed_with_its_state(roster: RosterOfRobot3) -> None:
    roster.receive_heartbeat(100, transfer_id=2, now=250.0)
    assert list_frames(roster) == [[250.0, 3, "heartbeat 2: nominal, maintenance, up 100 s"]]


def test_telemetry_is_listed_with_its_values(roster: RosterOfRobot3) -> None:
    roster.receive_telemetry(now=251.0)
    assert list_frames(roster) == [[251.0, 3, "telemetry 30: x 0.2500, b_hat 0.7500, updates 7"]]


def test_a_rejected_frame_is_listed_with_the_reason_and_without_a_sender(roster: RosterOfRobot3) -> None:
    frame = can.Message(arbitration_id=0x123, is_extended_id=False, data=b"\1")
    roster.receive(frame, Rejection.STANDARD_ID, 252.0)
    assert list_frames(roster) == [[252.0, None, "refused, standard id: 123#01"]]


def test_a_report_lists_the_last_4000_frames(roster: RosterOfRobot3) -> None:
    for tick in range(5000):
        roster.receive_estimate(tick % 32, now=tick / 1000)
    seconds = [frame[0] for frame in list_frames(roster)]
    assert seconds == [tick / 1000 for tick in range(1000, 5000)]


def test_each_frame_is_in_one_report(roster: RosterOfRobot3) -> None:
    roster.receive_estimate(8, now=1.0)
    assert len(list_frames(roster)) == 1
    assert list_frames(roster) == []
