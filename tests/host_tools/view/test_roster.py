"""What a page says of each robot of a bus, from frames made by hand."""

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


class Heard(Roster):
    """A roster that hears what robots say."""

    def estimate(self, transfer_id: int, now: float, alpha: int = 1 << 30, robot: int = 3) -> None:
        self.receive(FRAME, Estimate(robot, 1 << 22, alpha, transfer_id), now)

    def beat(self, uptime: int, transfer_id: int, now: float = 0.0, health: Health = Health.NOMINAL) -> None:
        self.receive(FRAME, Heartbeat(3, uptime, transfer_id, health, Mode.MAINTENANCE), now)

    def tell(self, now: float) -> None:
        self.receive(FRAME, Telemetry(3, 1 << 21, 3 << 22, 7, 30), now)

    def row(self, now: float, place: int = 0) -> dict[str, Any]:
        return dict(self.report(now)["robots"][place])


LOST = {"5 6 7": 0, "30 31 0 1": 0, "5 7": 1, "30 1": 2, "7 7 8": 0, "8 7": 30}
"""By the transfer ids that came."""


@pytest.mark.parametrize(("came", "lost"), LOST.items())
def test_loss_is_counted_by_gaps_of_transfer_ids_modulo_32(came: str, lost: int) -> None:
    heard, transfer_ids = Heard(), came.split()
    for place, each in enumerate(transfer_ids):
        heard.estimate(int(each), 0.1 * place)
    assert heard.row(1.0)["loss"] == lost / (lost + len(transfer_ids))


def test_each_kind_of_frame_has_transfer_ids_of_its_own_and_silence_ends_a_series() -> None:
    heard = Heard()
    heard.estimate(9, 0.0)
    heard.beat(100, 2, 0.0)
    heard.tell(0.0)
    heard.estimate(10, 1.0)
    heard.estimate(11, 1.0, robot=2)
    assert [heard.row(1.0, place)["loss"] for place in (0, 1)] == [0, 0]
    heard.estimate(20, 3.99)
    assert heard.row(4.0)["loss"] == 0 and heard.row(4.0, 1)["loss"] == 9 / (9 + 5)
    heard.estimate(1, 6.99)  # 3 s of silence: it may have sent any number of frames
    assert heard.row(7.0, 1)["loss"] == 9 / (9 + 6)


def test_a_rate_is_that_of_the_last_seconds_and_ends_with_silence() -> None:
    heard = Heard()
    for tick in range(100):
        heard.estimate(tick % 32, 50 + tick / 10)
        assert heard.row(50 + tick / 10)["rate"] == round((tick + 1) / max(tick / 10, 1), 1) or tick >= 50
    assert heard.row(59.9)["rate"] == 10.0 and not heard.row(62.89)["silent"]
    row = heard.row(62.9)
    assert row["rate"] == pytest.approx(4.0, abs=0.21) and row["silent"] and row["seen"] == 3.0
    assert heard.row(70.0)["rate"] == 0


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
def test_the_page_counts_the_jumps_that_a_node_counts(alphas: list[int], jumps: int) -> None:
    heard, listener = Heard(), node(5)
    for tick, alpha in enumerate(alphas):
        estimate = Estimate(3, 1 << 22, alpha << 8, tick % 32)
        heard.receive(FRAME, estimate, 0.0)
        listener.receive_frame(encode_estimate(estimate, FrameFormat()))
    assert heard.row(0.0)["jumps"] == listener.reception.events[Suspicion.JUMP, 3] == jumps


def test_states_and_values_are_what_the_frames_say() -> None:
    heard = Heard()
    heard.estimate(0, 0.0)
    assert {heard.row(0.0)[name] for name in ("health", "mode", "x", "b_hat", "updates")} == {None}
    heard.beat(100, 2, health=Health.ADVISORY)
    heard.tell(0.5)
    row = heard.row(1.0)
    assert (row["health"], row["mode"], row["seen"]) == ("advisory", "maintenance", 0.5)
    assert (row["x"], row["b_hat"], row["updates"]) == (0.25, 0.75, 7)


@pytest.mark.parametrize(
    ("beats", "conflicts"),
    [
        ([(1, 1), (2, 2), (4, 4), (5, 5)], 0),
        ([(100, 4), (0, 0), (1, 1), (2, 2)], 0),
        ([(0, 0), (1, 1), (0, 0), (1, 1), (0, 0)], 0),
        ([(100, 4), (5, 5), (101, 5), (6, 6), (102, 6)], 2),
        ([(100, 4), (0, 0), (102, 5)], 0),
        ([(7, 7), (7, 7), (8, 8), (8, 8)], 2),
    ],
    ids=["one", "restart", "boot loop", "another", "by chance", "started together"],
)
def test_two_nodes_with_one_id_are_told_from_one_that_restarts(
    beats: list[tuple[int, int]], conflicts: int
) -> None:
    heard = Heard()
    for uptime, transfer_id in beats:
        heard.beat(uptime, transfer_id)
    assert heard.row(0.0)["conflicts"] == conflicts


def test_frames_are_told_in_words_each_once() -> None:
    heard = Heard()
    for tick in range(5000):
        heard.estimate(tick % 32, tick / 1000)
    frames = heard.report(5.0)["frames"]
    assert [each[0] for each in frames] == [tick / 1000 for tick in range(1000, 5000)]
    assert frames[0] == [1.0, 3, "estimate 8: x_hat 0.5000, alpha 0.25"]
    heard.beat(100, 2, 250.0)
    heard.tell(251.0)
    frame = can.Message(arbitration_id=0x123, is_extended_id=False, data=b"\1")
    heard.receive(frame, Rejection.STANDARD_ID, 252.0)
    assert [each[1:] for each in heard.report(252.0)["frames"]] == [
        [3, "heartbeat 2: nominal, maintenance, up 100 s"],
        [3, "telemetry 30: x 0.2500, b_hat 0.7500, updates 7"],
        [None, "refused, standard id: 123#01"],
    ]
    assert heard.report(253.0)["frames"] == []
