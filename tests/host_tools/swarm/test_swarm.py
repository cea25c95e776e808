"""The swarm on a bus is trial 0 of the experiment; what is on the bus, in the results, and trouble."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from fractions import Fraction
from itertools import islice
from typing import Any

import can
import pytest
from can.interfaces import virtual

from host_tools.swarm.swarms import ON_ONE_BUS, content, one_bus, record, small, states
from mcp_asdf.fixed_point import alpha_from_word
from mcp_asdf.robot import FixedPointRobot
from mcp_asdf_tools.bus.frame_layout import Q23_ONE, Rejection
from mcp_asdf_tools.bus.frames import (
    Estimate,
    FrameFormat,
    Heartbeat,
    Telemetry,
    decode_estimate,
    decode_frame,
    decode_telemetry,
    encode_estimate,
)
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.experiments.engine import native
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.robots.firmwares import FIRMWARES
from mcp_asdf_tools.swarm import carrier as connection
from mcp_asdf_tools.swarm.carrier import ExpectingConnection, Wiring
from mcp_asdf_tools.swarm.delivery import SentFrame
from mcp_asdf_tools.swarm.run import run_swarm
from mcp_asdf_tools.swarm.settings import SwarmSettings
from mcp_asdf_tools.swarm.swarm import Swarm
from support import slow
from trials import images_by_message

pytestmark = pytest.mark.usefixtures("private_setup")


COMMON: dict[str, Any] = {"robots": 6, "flawed": "50%", "steps": 250, "filter_period": 20, "seed": 7}
CASES: dict[str, dict[str, Any]] = {
    "fully connected": {},
    "no filter": {"filter": "none"},
    "always, drifting": {"activation": "always", "drift": "linear", "drift_rate": -1e-3},
    "dynamic": {"topology": "dynamic"},
    "dynamic, late, rare broadcasts": {"topology": "dynamic", "latency": 1, "comms_period": 5},
    "dynamic, rare observations": {"topology": "dynamic", "observation_period": 3, "memory": 64},
    "two sensors' accuracies": {"topology": "dynamic", "white_offset": -0.1, "filter": "asdf-minus"},
    "graph": {"topology": "graph", "graph": "0 1; 1 2; 2 > 3; 4 > 0"},
    "late": {"latency": 1},
    "alone": {"robots": 1, "flawed": 0},
    "robust": {"filter": "robust"},
    "robust, late, rare broadcasts": {"filter": "robust", "latency": 1, "comms_period": 5},
    "robust, dynamic": {"filter": "robust", "topology": "dynamic", "robots": 20, "density": 4},
    "robust, dynamic, late, rare broadcasts": {
        **{"filter": "robust", "topology": "dynamic", "robots": 20, "density": 4},
        **{"latency": 1, "comms_period": 5, "observation_period": 2},
    },
    "robust, graph": {"filter": "robust", "topology": "graph", "graph": "3 1; 0 1; 1 2; 2 > 3; 5 1; 4 > 0"},
    "robust, alone": {"filter": "robust", "robots": 1, "flawed": 0},
}


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("firmware", ["native", *slow(["mirror"])])
def test_a_swarm_on_a_bus_is_trial_0_to_the_bit(case: str, firmware: str) -> None:
    """Through frames on a bus, by the engine in C where it can, and message by message in Python."""
    parameters = COMMON | CASES[case] | {"firmware": firmware}
    experiment = Experiment(**parameters, trials=1)
    run, _ = record(SwarmSettings(**parameters))
    assert states(run.nodes) == images_by_message(experiment, 0)
    if not experiment.lacking_in_c:
        assert states(run.nodes) == native.run(experiment, 0, 1).images()


@pytest.mark.parametrize("comms_period", [1, 4])
def test_frames_have_their_turn_their_time_and_their_number(comms_period: int) -> None:
    """In each tick heartbeats if a second is over, then estimates if they are due, by rising id."""
    _, frames = record(small(steps_per_second=25, comms_period=comms_period))
    found: list[tuple[int, type, int, int]] = []
    for frame in frames:
        said = decode_frame(frame, FrameFormat())
        assert isinstance(said, Estimate | Heartbeat) and frame.is_rx
        found.append((round(frame.timestamp * 25), type(said), said.sender, said.transfer_id))
    expected: list[tuple[int, type, int, int]] = []
    for tick in range(60):
        beats = tick % 25 == 0
        expected += [(tick, Heartbeat, robot, tick // 25) for robot in range(5) if beats]
        due = tick % comms_period == comms_period - 1
        expected += [(tick, Estimate, robot, tick // comms_period % 32) for robot in range(5) if due]
    assert found == expected


@pytest.mark.parametrize("firmware", ["native", "mirror"])
def test_all_informed_estimates_are_the_same_to_the_bit(firmware: str) -> None:
    """And equal what exact arithmetic makes of the frames alone (eq. 7, floored)."""
    estimates: list[set[int]] = []

    def note(swarm: Swarm) -> None:
        robots = [node.robot for node in swarm.nodes]
        estimates.append({robot.x_raw for robot in robots if isinstance(robot, FixedPointRobot)})

    outcome, frames = record(small(firmware=firmware, steps=120), hooks=[note])
    assert outcome.results["updates"] > 0
    decoded = [decode_estimate(frame, FrameFormat()) for frame in frames]
    messages = iter([message for message in decoded if isinstance(message, Estimate)])
    for found in estimates:
        in_round = list(islice(messages, 5))
        weights = [Fraction(alpha_from_word(message.alpha)) for message in in_round]
        products = [weight * message.x_hat for weight, message in zip(weights, in_round, strict=True)]
        assert found == {sum(products) // sum(weights) if sum(weights) else Q23_ONE // 2}


@pytest.mark.parametrize("firmware", FIRMWARES)
def test_telemetry_is_every_robots_state_and_changes_nothing(firmware: str) -> None:
    """A frame of each robot every 7 ticks, with what the robots held at that moment."""
    held: list[list[tuple[int, ...]]] = []

    def note(swarm: Swarm) -> None:
        robots = [node.robot for node in swarm.nodes]
        held.append([(int(r.x * Q23_ONE), int(r.b_hat * 2**24), r.counters.updates) for r in robots])

    talkative = small(firmware=firmware, telemetry_period=7)
    with Swarm(talkative, Wiring()) as fresh:
        note(fresh)
    outcome, frames = record(talkative, hooks=[note])
    quiet, _ = record(small(firmware=firmware))
    assert [node.robot.x for node in outcome.nodes] == [node.robot.x for node in quiet.nodes]
    decoded = [(decode_telemetry(frame), frame.timestamp) for frame in frames]
    found = [each for each, _ in decoded if isinstance(each, Telemetry)]
    times = [round(10 * time) for each, time in decoded if isinstance(each, Telemetry)]
    assert [(each.sender, each.transfer_id) for each in found] == [
        (robot, turn % 32) for turn in range(9) for robot in range(5)
    ]
    assert times == [7 * each.transfer_id for each in found]
    for each in found:
        assert (each.x, each.b_hat, each.updates) == held[7 * each.transfer_id][each.sender]
    figures = outcome.results["frames"]
    assert (figures["telemetry_sent"], figures["telemetry_heard"]) == (9 * 5, 9 * 5 * 4)
    assert figures["rejected"] == {}


@pytest.mark.parametrize(
    ("faults", "settings", "reason"),
    [
        ((), {"frames": FrameFormat(3001), "telemetry_period": 1}, "subject 3001 is that of telemetry"),
        ((), {"clock": "none"}, "clock is 'none'; choose lockstep or real-time"),
        ((), {"allow": "0-128"}, "allow is '0-128'; it must be ids 0 to 127"),
        ("loss", {}, "faults is .*; give several in a list"),
        (("loss,robots=4+5",), {}, "names robot 5, but the ids of 5 robots are 0 to 4"),
        (("loss,receivers=5",), {}, "names robot 5, but the ids of 5 robots are 0 to 4"),
    ],
)
def test_settings_that_cannot_be(faults: Any, settings: dict[str, Any], reason: str) -> None:
    right = small("loss,robots=4,receivers=4", frames=FrameFormat(3001), allow="3+0-2+5")
    assert right.allow == "0-3+5"
    with pytest.raises(UsageError, match=reason):
        SwarmSettings(robots=5, faults=faults, **settings)


@pytest.mark.parametrize(("robots", "names"), [(8, "7"), (9, "7, ...")])
def test_lost_frames_end_the_run_with_a_clear_reason(
    robots: int, names: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """From the third round on."""
    usual = virtual.VirtualBus.recv
    monkeypatch.setattr(connection, "FRAME_TIMEOUT", 0.05)
    with Swarm(small(robots=robots), ON_ONE_BUS) as swarm:
        monkeypatch.setattr(
            virtual.VirtualBus, "recv", lambda bus, seconds: usual(bus, seconds) if swarm.ticks < 2 else None
        )
        outcome = run_swarm(swarm)
    frames = ", ".join(f"frame 106BB80{robot}" for robot in range(7))
    told = f"tick 3: the carrier did not hear {frames}, frame 106BB80{names} within 0.05 s on "
    assert outcome.failure is not None and outcome.failure.startswith(told)
    assert outcome.results["steps"] == 2 and not outcome.interrupted


def estimate(sender: int, tick: int) -> SentFrame:
    return SentFrame(encode_estimate(Estimate(sender, 0, tick, tick % 32), FrameFormat()), sender, tick)


def test_a_bus_that_is_never_quiet_does_not_keep_a_robot_listening(monkeypatch: pytest.MonkeyPatch) -> None:
    waits, babble = Counter[bool](), estimate(9, 0).frame

    def receive(timeout: float) -> can.Message:
        waits[timeout > 0] += 1
        assert waits[False] < 10_000, "nothing ends the wait"
        return babble

    with virtual.VirtualBus() as bus:
        connection = ExpectingConnection(bus, "robot 7")
        monkeypatch.setattr(bus, "recv", receive)
        assert connection.receive_expected([estimate(1, 0)], 0.02) == []
        assert connection.missed_count == 1
        assert waits[True] > 0
        assert waits[False] == 4096


Pair = tuple[can.BusABC, ExpectingConnection, list[can.Message]]


@pytest.fixture
def pair() -> Iterator[Pair]:
    """A bus, a connection to it that expects frames, and the frames that it did not expect."""
    unexpected: list[can.Message] = []
    with virtual.VirtualBus("pair") as other, virtual.VirtualBus("pair") as bus:
        yield other, ExpectingConnection(bus, "robot 7", unexpected.append), unexpected


def received(connection: ExpectingConnection, expected: Sequence[SentFrame]) -> list[tuple[int, bytes]]:
    """Identifier and data of the frames that a connection receives within 10 ms."""
    return content([sent_frame.frame for sent_frame in connection.receive_expected(expected, 0.01)])


def test_frames_are_received_in_the_order_in_which_they_were_sent(pair: Pair) -> None:
    bus, connection, _ = pair
    first, second = estimate(1, 0), estimate(2, 0)
    for sent_frame in (second, first):
        bus.send(sent_frame.frame)
    assert received(connection, [first, second]) == content([first.frame, second.frame])


def test_what_is_received_is_what_came_over_the_bus(pair: Pair) -> None:
    bus, connection, _ = pair
    sent_frame = estimate(1, 0)
    bus.send(sent_frame.frame)
    (received_frame,) = connection.receive_expected([sent_frame], 0.01)
    assert received_frame.frame is not sent_frame.frame
    assert received_frame.frame.is_rx


def test_a_late_frame_is_received_with_the_next_ones_and_counted_once(pair: Pair) -> None:
    bus, connection, unexpected = pair
    late, following = estimate(1, 0), estimate(1, 1)
    assert received(connection, [late]) == []
    assert received(connection, []) == []
    for sent_frame in (following, late):
        bus.send(sent_frame.frame)
    assert received(connection, [following]) == content([late.frame, following.frame])
    assert connection.missed_count == 1
    assert unexpected == []


def test_of_frames_that_are_alike_each_is_received_once(pair: Pair) -> None:
    bus, connection, unexpected = pair
    for _ in range(3):
        bus.send(estimate(1, 0).frame)
    assert len(received(connection, [estimate(1, 0), estimate(1, 0)])) == 2
    connection.discard_echoes()
    assert content(unexpected) == content([estimate(1, 0).frame])


def test_a_frame_that_nobody_expects_is_reported(pair: Pair) -> None:
    bus, connection, unexpected = pair
    bus.send(estimate(1, 0).frame)
    for _ in range(2):
        connection.discard_echoes()
    assert content(unexpected) == content([estimate(1, 0).frame])


def test_foreign_traffic_is_counted_and_changes_nothing() -> None:
    """Garbage, and legal messages from outside the swarm or of another round."""
    undisturbed, clean = record(small())
    junk = [
        can.Message(arbitration_id=0x123, is_extended_id=False, data=b"1234"),
        can.Message(arbitration_id=0x106BB82A, is_remote_frame=True, dlc=8),
        can.Message(arbitration_id=0x106BB801, data=b"\xff" * 8),
        can.Message(arbitration_id=0x106BB801, data=b"\0" * 7),
        encode_estimate(Estimate(99, Q23_ONE, 0x4F000000, 5), FrameFormat()),
        encode_estimate(Estimate(1, Q23_ONE, 0x4F000000, 4), FrameFormat()),
        can.Message(arbitration_id=8, is_error_frame=True),
    ]

    def disturb(swarm: Swarm) -> None:
        if swarm.ticks == 5:
            with one_bus() as other:
                for frame in junk:
                    other.send(frame, timeout=1)

    disturbed, frames = record(small(), hooks=[disturb])
    foreign = content(junk)
    assert [each for each in content(frames) if each in foreign] == foreign
    assert [each for each in content(frames) if each not in foreign] == content(clean)
    assert all(frame.is_rx for frame in frames)
    assert states(disturbed.nodes) == states(undisturbed.nodes)
    figures = disturbed.results["frames"]
    assert (figures["strays"], figures["errors_heard"]) == (2 * 5, 5)
    assert figures["id_conflicts"] == {"1": 1}
    reasons = (Rejection.STANDARD_ID, Rejection.REMOTE_FRAME, Rejection.X_HAT, Rejection.LENGTH)
    assert figures["rejected"] == {reason.name: 5 for reason in reasons}


@pytest.mark.parametrize(("seed", "is_low"), [(11, False), (15, True)])
def test_results_are_what_the_robots_hold(seed: int, is_low: bool) -> None:
    outcome, _ = record(small("loss=0.5", seed=seed))
    results = outcome.results
    assert (results["mean_x"] < 0.55) == is_low
    x = [Fraction(node.robot.x) for node in outcome.nodes]
    error = sum(abs(each - Fraction(0.55)) for each in x) / 5
    assert results["mean_x"] == pytest.approx(float(sum(x) / 5), abs=1e-15)
    assert results["mean_error"] == pytest.approx(float(error), abs=1e-15)
    assert results["spread_x"] == float(max(x) - min(x)) > 0
    x_hat = [node.robot.x_hat for node in outcome.nodes]
    assert results["spread_x_hat"] == max(x_hat) - min(x_hat)
    for group, start, b_hat in (
        ("flawed", 0.55, [node.robot.b_hat for node in outcome.nodes[:2]]),
        ("other", 0.95, [node.robot.b_hat for node in outcome.nodes[2:]]),
    ):
        found = results["b_hat"][group]
        assert found["before"] == pytest.approx(start, abs=1e-6)
        assert found["after"] == pytest.approx(sum(b_hat) / len(b_hat), abs=1e-15)
        assert (found["after_min"], found["after_max"]) == (min(b_hat), max(b_hat))
    for name in ("tests", "updates"):
        assert results[name] == sum(vars(node.robot.counters)[name] for node in outcome.nodes) > 0
