"""The swarm on a bus is trial 0 of the experiment; what is on the bus, in the results, and trouble."""

from __future__ import annotations

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
from mcp_asdf_tools.bus.frame_layout import Q23_ONE
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
from mcp_asdf_tools.swarm.run import SwarmRun, run_swarm
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
def test_a_swarm_on_a_bus_ends_in_the_same_bits_as_the_same_simulated_experiment(
    case: str, firmware: str
) -> None:
    """It is trial 0 of the experiment: by the engine in C where it can, and message by message in Python."""
    parameters = COMMON | CASES[case] | {"firmware": firmware}
    experiment = Experiment(**parameters, trials=1)
    run, _ = record(SwarmSettings(**parameters))
    assert states(run.nodes) == images_by_message(experiment, 0)
    if not experiment.parameter_lacking_in_c:
        assert states(run.nodes) == native.run(experiment, 0, 1).images()


FrameOrder = list[tuple[int, int, int]]
"""Tick, sender and transfer_id of frames, in their order on the bus."""


def record_order(kind: type, comms_period: int) -> FrameOrder:
    """Return the order of the frames of one kind in 60 ticks, of which 25 are a second."""
    _, frames = record(small(steps_per_second=25, comms_period=comms_period))
    order = []
    for frame in frames:
        content_of_frame = decode_frame(frame, FrameFormat())
        if isinstance(content_of_frame, kind):
            assert isinstance(content_of_frame, Estimate | Heartbeat)
            tick = round(frame.timestamp * 25)
            order.append((tick, content_of_frame.sender, content_of_frame.transfer_id))
    return order


def test_robots_send_heartbeats_by_rising_id_when_a_second_begins() -> None:
    """Five robots; 60 ticks of a 25th of a second begin three seconds."""
    expected = [(25 * second, robot, second) for second in range(3) for robot in range(5)]
    assert record_order(Heartbeat, comms_period=1) == expected


def test_robots_broadcast_by_rising_id_in_each_tick() -> None:
    """Broadcasts are numbered modulo 32."""
    expected = [(tick, robot, tick % 32) for tick in range(60) for robot in range(5)]
    assert record_order(Estimate, comms_period=1) == expected


def test_robots_with_a_longer_period_broadcast_in_its_last_tick() -> None:
    """In every fourth of 60 ticks."""
    expected = [(4 * index + 3, robot, index) for index in range(15) for robot in range(5)]
    assert record_order(Estimate, comms_period=4) == expected


def test_frames_are_recorded_as_received_and_heartbeats_come_first() -> None:
    _, frames = record(small())
    assert all(frame.is_rx for frame in frames)
    kinds = [type(decode_frame(frame, FrameFormat())) for frame in frames[:10]]
    assert kinds == [Heartbeat] * 5 + [Estimate] * 5


@pytest.mark.parametrize("firmware", ["native", "mirror"])
def test_each_robot_s_estimate_is_the_weighted_mean_of_all_estimates_on_the_bus(firmware: str) -> None:
    """The mean of x_hat weighted by alpha, the paper's equation 7, computed exactly and rounded to 23 bits.

    All five robots hear each other, so they have the same one.
    """
    estimates_by_round: list[set[int]] = []

    def record_estimates(swarm: Swarm) -> None:
        robots = [node.robot for node in swarm.nodes]
        estimates_by_round.append({robot.x_raw for robot in robots if isinstance(robot, FixedPointRobot)})

    run, frames = record(small(firmware=firmware, steps=120), hooks=[record_estimates])

    assert run.results["updates"] > 0
    decoded = [decode_estimate(frame, FrameFormat()) for frame in frames]
    messages = iter([message for message in decoded if isinstance(message, Estimate)])
    for estimates in estimates_by_round:
        round_messages = list(islice(messages, 5))
        weights = [Fraction(alpha_from_word(message.alpha)) for message in round_messages]
        products = [weight * message.x_hat for weight, message in zip(weights, round_messages, strict=True)]
        expected = sum(products) // sum(weights) if sum(weights) else Q23_ONE // 2
        assert estimates == {expected}


def telemetry_in(frames: Sequence[can.Message]) -> list[tuple[int, Telemetry]]:
    """Return the telemetry among frames, each with its tick."""
    telemetry = []
    for frame in frames:
        content_of_frame = decode_telemetry(frame)
        if isinstance(content_of_frame, Telemetry):
            telemetry.append((round(10 * frame.timestamp), content_of_frame))
    return telemetry


def test_each_robot_sends_telemetry_in_every_telemetry_period() -> None:
    _, frames = record(small(telemetry_period=7))
    order = [(tick, telemetry.sender, telemetry.transfer_id) for tick, telemetry in telemetry_in(frames)]
    assert order == [(7 * index, robot, index) for index in range(9) for robot in range(5)]


@pytest.mark.parametrize("firmware", FIRMWARES)
def test_telemetry_is_the_state_of_the_robot_before_the_tick(firmware: str) -> None:
    """Frames have x in units of 2**-23 and b_hat in units of 2**-24."""
    states_by_tick: list[list[tuple[int, int, int]]] = []

    def record_states(swarm: Swarm) -> None:
        robots = [node.robot for node in swarm.nodes]
        states_by_tick.append(
            [(int(robot.x * 2**23), int(robot.b_hat * 2**24), robot.counters.updates) for robot in robots]
        )

    settings = small(firmware=firmware, telemetry_period=7)
    with Swarm(settings, Wiring()) as new_swarm:
        record_states(new_swarm)  # before tick 0
    _, frames = record(settings, hooks=[record_states])  # after each tick

    for tick, telemetry in telemetry_in(frames):
        x, b_hat, updates = states_by_tick[tick][telemetry.sender]
        assert telemetry.x == x
        assert telemetry.b_hat == b_hat
        assert telemetry.updates == updates


@pytest.mark.parametrize("firmware", FIRMWARES)
def test_telemetry_changes_nothing_for_the_robots(firmware: str) -> None:
    with_telemetry, _ = record(small(firmware=firmware, telemetry_period=7))
    without_telemetry, _ = record(small(firmware=firmware))

    assert [node.robot.x for node in with_telemetry.nodes] == [
        node.robot.x for node in without_telemetry.nodes
    ]


def test_telemetry_is_counted_and_not_rejected() -> None:
    run, _ = record(small(telemetry_period=7))
    figures = run.results["frames"]
    assert (figures["telemetry_sent"], figures["telemetry_heard"]) == (9 * 5, 9 * 5 * 4)
    assert figures["rejected"] == {}


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"frames": FrameFormat(3001), "telemetry_period": 1}, "subject 3001 is that of telemetry"),
        ({"clock": "none"}, "clock is 'none'; choose lockstep or real-time"),
        ({"allow": "0-128"}, "allow is '0-128'; it must be ids 0 to 127"),
        ({"faults": "loss"}, "faults is .*; give several in a list"),
        ({"faults": ("loss,robots=4+5",)}, "names robot 5, but the ids of 5 robots are 0 to 4"),
        ({"faults": ("loss,receivers=5",)}, "names robot 5, but the ids of 5 robots are 0 to 4"),
    ],
)
def test_settings_that_contradict_each_other_are_refused(settings: dict[str, Any], message: str) -> None:
    with pytest.raises(UsageError, match=message):
        SwarmSettings(**{"robots": 5} | settings)


def test_a_fault_may_name_the_last_robot() -> None:
    assert len(small("loss,robots=4,receivers=4").faults) == 1


def test_estimates_may_have_the_subject_of_telemetry_if_none_is_sent() -> None:
    assert small(frames=FrameFormat(3001)).frames == FrameFormat(3001)


def test_allowed_ids_are_in_rising_order() -> None:
    assert small(allow="3+0-2+5").allow == "0-3+5"


@pytest.mark.parametrize(("robots", "names"), [(8, "7"), (9, "7, ...")])
def test_a_bus_that_loses_frames_ends_the_run_with_their_names(
    robots: int, names: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Here it loses all from the third tick on."""
    receive = virtual.VirtualBus.recv
    monkeypatch.setattr(connection, "FRAME_TIMEOUT", 0.05)
    with Swarm(small(robots=robots), ON_ONE_BUS) as swarm:
        monkeypatch.setattr(
            virtual.VirtualBus,
            "recv",
            lambda bus, timeout: receive(bus, timeout) if swarm.ticks < 2 else None,
        )
        run = run_swarm(swarm)
    frames = ", ".join(f"frame 106BB80{robot}" for robot in range(7))
    message = f"tick 3: the carrier did not hear {frames}, frame 106BB80{names} within 0.05 s on "

    assert run.failure is not None
    assert run.failure.startswith(message)
    assert run.results["steps"] == 2
    assert not run.interrupted


def estimate(sender: int, tick: int) -> SentFrame:
    return SentFrame(encode_estimate(Estimate(sender, 0, tick, tick % 32), FrameFormat()), sender, tick)


def test_a_wait_for_frames_ends_on_a_bus_that_is_never_quiet(monkeypatch: pytest.MonkeyPatch) -> None:
    """After its time it still reads what may have waited in a receive buffer."""
    reads_in_time, late_reads = list[float](), list[float]()

    def receive(timeout: float) -> can.Message:
        (reads_in_time if timeout > 0 else late_reads).append(timeout)
        assert len(late_reads) < 10_000, "nothing ends the wait"
        return estimate(9, 0).frame

    with virtual.VirtualBus() as bus:
        connection = ExpectingConnection(bus, "robot 7")
        monkeypatch.setattr(bus, "recv", receive)
        assert connection.receive_expected([estimate(1, 0)], 0.02) == []
    assert connection.missed_count == 1
    assert reads_in_time
    assert len(late_reads) == 4096


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
    """Three come of which two were expected; the third is reported as one that nobody expected."""
    bus, connection, unexpected = pair
    for _ in range(3):
        bus.send(estimate(1, 0).frame)
    assert len(received(connection, [estimate(1, 0), estimate(1, 0)])) == 2
    connection.discard_echoes()

    assert content(unexpected) == content([estimate(1, 0).frame])


def test_a_frame_that_nobody_expects_is_reported(pair: Pair) -> None:
    """Once, and not again when the bus is read again."""
    bus, connection, unexpected = pair
    bus.send(estimate(1, 0).frame)
    for _ in range(2):
        connection.discard_echoes()

    assert content(unexpected) == content([estimate(1, 0).frame])


FOREIGN_FRAMES = [
    can.Message(arbitration_id=0x123, is_extended_id=False, data=b"1234"),
    can.Message(arbitration_id=0x106BB82A, is_remote_frame=True, dlc=8),
    can.Message(arbitration_id=0x106BB801, data=b"\xff" * 8),
    can.Message(arbitration_id=0x106BB801, data=b"\0" * 7),
    encode_estimate(Estimate(99, Q23_ONE, 0x4F000000, 5), FrameFormat()),
    encode_estimate(Estimate(1, Q23_ONE, 0x4F000000, 4), FrameFormat()),
    can.Message(arbitration_id=8, is_error_frame=True),
]
"""Malformed frames, and estimates from outside the swarm, one of them under the id of robot 1."""


def run_with_foreign_frames() -> tuple[SwarmRun, list[can.Message]]:
    """Run a swarm while another program sends these frames after the fifth tick."""

    def send_foreign_frames(swarm: Swarm) -> None:
        if swarm.ticks == 5:
            with one_bus() as other_program:
                for frame in FOREIGN_FRAMES:
                    other_program.send(frame, timeout=1)

    return record(small(), hooks=[send_foreign_frames])


def test_foreign_frames_are_recorded_among_those_of_the_swarm() -> None:
    _, frames = run_with_foreign_frames()
    _, frames_of_swarm = record(small())
    foreign = content(FOREIGN_FRAMES)

    assert [frame for frame in content(frames) if frame in foreign] == foreign
    assert [frame for frame in content(frames) if frame not in foreign] == content(frames_of_swarm)
    assert all(frame.is_rx for frame in frames)


def test_foreign_frames_change_nothing_for_the_robots() -> None:
    disturbed_run, _ = run_with_foreign_frames()
    undisturbed_run, _ = record(small())
    assert states(disturbed_run.nodes) == states(undisturbed_run.nodes)


def test_foreign_frames_are_counted_by_each_robot() -> None:
    run, _ = run_with_foreign_frames()
    figures = run.results["frames"]
    assert (figures["strays"], figures["errors_heard"]) == (2 * 5, 5)
    assert figures["rejected"] == {"STANDARD_ID": 5, "REMOTE_FRAME": 5, "X_HAT": 5, "LENGTH": 5}


def test_an_estimate_of_another_program_under_the_id_of_a_robot_is_a_conflict() -> None:
    run, _ = run_with_foreign_frames()
    assert run.results["frames"]["id_conflicts"] == {"1": 1}


# One seed for a mean above the share of black tiles, and one for a mean below it.
@pytest.mark.parametrize(("seed", "is_low"), [(11, False), (15, True)])
def test_results_have_the_mean_estimate_its_error_and_its_spread(seed: int, is_low: bool) -> None:
    """Five robots estimate a floor with a share of 0.55 black. The expected results are exact fractions.

    With the two seeds the mean estimate is above 0.55 and below it.
    """
    run, _frames = record(small("loss=0.5", seed=seed))
    x = [Fraction(node.robot.x) for node in run.nodes]
    mean_x = sum(x) / 5
    mean_error = sum(abs(estimate - Fraction(0.55)) for estimate in x) / 5
    spread = max(x) - min(x)

    assert (run.results["mean_x"] < 0.55) == is_low
    assert run.results["mean_x"] == pytest.approx(float(mean_x), abs=1e-15)
    assert run.results["mean_error"] == pytest.approx(float(mean_error), abs=1e-15)
    assert run.results["spread_x"] == float(spread) > 0


def test_results_have_the_spread_of_local_estimates() -> None:
    run, _ = record(small("loss=0.5"))
    x_hat = [node.robot.x_hat for node in run.nodes]
    assert run.results["spread_x_hat"] == max(x_hat) - min(x_hat)


@pytest.mark.parametrize(
    ("group", "robots", "b_hat_at_start"), [("flawed", slice(0, 2), 0.55), ("other", slice(2, 5), 0.95)]
)
def test_results_have_b_hat_of_flawed_and_of_other_robots(
    group: str, robots: slice, b_hat_at_start: float
) -> None:
    """b_hat is the accuracy that a robot assumes of its sensor. The first two of five robots are flawed."""
    run, _frames = record(small("loss=0.5"))
    b_hat = [node.robot.b_hat for node in run.nodes[robots]]
    result = run.results["b_hat"][group]

    assert result["before"] == pytest.approx(b_hat_at_start, abs=1e-6)
    assert result["after"] == pytest.approx(sum(b_hat) / len(b_hat), abs=1e-15)
    assert (result["after_min"], result["after_max"]) == (min(b_hat), max(b_hat))


@pytest.mark.parametrize("counter", ["tests", "updates"])
def test_results_have_the_sums_of_the_robots_counters(counter: str) -> None:
    run, _ = record(small("loss=0.5"))
    counts = [vars(node.robot.counters)[counter] for node in run.nodes]
    assert run.results[counter] == sum(counts) > 0
