"""The swarm on a bus is trial 0 of the experiment; what is on the bus, in the results, and trouble."""

from __future__ import annotations

import errno
import time
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import can
import pytest
from can.interfaces import virtual

from host_tools.swarm.swarms import (
    ON_ONE_BUS,
    identifiers_and_data,
    one_bus,
    run_and_record,
    saved_robots,
    small_swarm,
)
from mcp_asdf.robot import Robot
from mcp_asdf_tools.bus.frame_layout import Q23_ONE
from mcp_asdf_tools.bus.frames import (
    Estimate,
    FrameFormat,
    Heartbeat,
    Telemetry,
    decode_frame,
    decode_telemetry,
    encode_estimate,
)
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.experiments.engine import native
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.swarm import carrier
from mcp_asdf_tools.swarm.carrier import ExpectingConnection, Wiring
from mcp_asdf_tools.swarm.delivery import SentFrame
from mcp_asdf_tools.swarm.run import SwarmRun, run_swarm
from mcp_asdf_tools.swarm.settings import SwarmSettings
from mcp_asdf_tools.swarm.swarm import Swarm
from support import slow
from trials import images_by_message

pytestmark = pytest.mark.usefixtures("private_setup")


CASES: dict[str, dict[str, Any]] = {
    "fully connected": {},
    "no filter": {"filter": "none"},
    "always, drifting": {"activation": "always", "drift": "linear", "drift_rate": -1e-3},
    "dynamic": {"topology": "dynamic"},
    "dynamic, late, rare broadcasts": {"topology": "dynamic", "latency": 1, "comms_period": 5},
    "dynamic, rare observations": {"topology": "dynamic", "observation_period": 3, "memory": 64},
    "two sensors' accuracies": {"topology": "dynamic", "white_offset": -0.1, "filter": "asdf-minus"},
    "graph": {"topology": "graph", "graph": "0 1; 1 2; 2 > 3; 4 > 0"},
    "alone": {"robots": 1, "flawed": 0},
    "robust": {"filter": "robust"},
    "robust, dynamic, late, rare broadcasts": {
        **{"filter": "robust", "topology": "dynamic", "robots": 12, "density": 4},
        **{"latency": 1, "comms_period": 5, "observation_period": 2},
    },
    "robust, graph": {"filter": "robust", "topology": "graph", "graph": "3 1; 0 1; 1 2; 2 > 3; 5 1; 4 > 0"},
    "robust, alone": {"filter": "robust", "robots": 1, "flawed": 0},
}


@pytest.mark.parametrize("changes", CASES.values(), ids=CASES)
@pytest.mark.parametrize("firmware", ["native", *slow(["mirror"])])
def test_a_swarm_on_a_bus_ends_in_the_same_bits_as_the_same_simulated_experiment(
    changes: dict[str, Any], firmware: str
) -> None:
    """The saved states equal trial 0 of the experiment, computed message by message in Python.

    The engine in C computes it, too, unless it lacks one of the parameters.
    """
    usual_parameters = {"robots": 6, "flawed": "50%", "steps": 250, "filter_period": 20, "seed": 7}
    parameters: dict[str, Any] = usual_parameters | changes | {"firmware": firmware}
    experiment = Experiment(**parameters, trials=1)
    run, _frames = run_and_record(SwarmSettings(**parameters))
    states_on_the_bus = saved_robots(run.nodes)

    states_in_python = images_by_message(experiment, trial=0)
    assert states_on_the_bus == states_in_python
    if not experiment.parameter_lacking_in_c:
        states_in_c = native.run(experiment, first=0, trials=1).images()
        assert states_on_the_bus == states_in_c


@pytest.mark.parametrize(
    ("kind", "comms_period", "expected_ticks"),
    [
        (Heartbeat, 1, [0, 25, 50]),  # the ticks in which a second begins
        (Estimate, 1, range(60)),
        (Estimate, 4, range(3, 60, 4)),  # the last tick of each period
    ],
)
def test_robots_send_heartbeats_and_estimates_by_rising_id_in_their_ticks(
    kind: type[Heartbeat | Estimate], comms_period: int, expected_ticks: Sequence[int]
) -> None:
    """Five robots run for 60 ticks, at 25 ticks a second. They number their frames modulo 32.

    ``comms_period`` is the number of ticks from one estimate of a robot to its next.
    """
    settings = small_swarm(robots=5, steps=60, steps_per_second=25, comms_period=comms_period)
    _run, frames = run_and_record(settings)

    ticks_senders_and_numbers = []
    for frame in frames:
        content = decode_frame(frame, FrameFormat())
        if isinstance(content, kind):
            tick = round(frame.timestamp * 25)  # a second has 25 ticks
            ticks_senders_and_numbers.append((tick, content.sender, content.transfer_id))

    expected = []
    for number, tick in enumerate(expected_ticks):
        for robot in range(5):
            expected.append((tick, robot, number % 32))
    assert ticks_senders_and_numbers == expected


def test_heartbeats_come_before_the_estimates_of_a_tick() -> None:
    """The five heartbeats of a tick are sent before its five estimates. All are recorded as received."""
    _run, frames = run_and_record(small_swarm(robots=5, steps=1))
    kinds = [type(decode_frame(frame, FrameFormat())) for frame in frames]
    assert kinds == [Heartbeat] * 5 + [Estimate] * 5
    assert all(frame.is_rx for frame in frames)


def telemetry_in(frames: Sequence[can.Message]) -> list[tuple[int, Telemetry]]:
    """Return the telemetry among frames, each with its tick."""
    telemetry = []
    for frame in frames:
        content_of_frame = decode_telemetry(frame)
        if isinstance(content_of_frame, Telemetry):
            tick = round(10 * frame.timestamp)  # a second has 10 ticks
            telemetry.append((tick, content_of_frame))
    return telemetry


def test_each_robot_sends_telemetry_in_every_telemetry_period() -> None:
    """Five robots run for 60 ticks and send telemetry in ticks 0, 7, 14 and so on to 56.

    A frame is described by its tick, its sender and its number.
    """
    _run, frames = run_and_record(small_swarm(robots=5, steps=60, telemetry_period=7))
    sent_telemetry = []
    for tick, telemetry in telemetry_in(frames):
        sent_telemetry.append((tick, telemetry.sender, telemetry.transfer_id))

    expected_telemetry = []
    for number in range(9):
        for robot in range(5):
            expected_telemetry.append((7 * number, robot, number))
    assert sent_telemetry == expected_telemetry


@pytest.mark.parametrize("firmware", ["native", "reference"])
def test_telemetry_is_the_state_of_the_robot_before_the_tick(firmware: str) -> None:
    """A robot reports its estimate x, its assumed accuracy b_hat, and how often it has re-estimated b_hat.

    The states of all robots are recorded before the first of 36 ticks, and after each.
    """
    states_before_tick: list[list[ReportedState]] = []  # by tick and robot

    def record_states(swarm: Swarm) -> None:
        states_before_tick.append([state_to_report(node.robot) for node in swarm.nodes])

    settings = small_swarm(firmware=firmware, telemetry_period=7, steps=36)
    with Swarm(settings, Wiring()) as new_swarm:
        record_states(new_swarm)  # those before tick 0
    _run, frames = run_and_record(settings, hooks=[record_states])  # after tick 0, 1 and so on

    for tick, telemetry in telemetry_in(frames):
        reported_state = ReportedState(telemetry.x, telemetry.b_hat, telemetry.updates)
        assert reported_state == states_before_tick[tick][telemetry.sender]


class ReportedState(NamedTuple):
    """What telemetry says of a robot: x in units of 2**-23, b_hat in units of 2**-24, and its updates."""

    x: int
    b_hat: int
    updates: int


def state_to_report(robot: Robot) -> ReportedState:
    """Return what telemetry has to say of a robot."""
    return ReportedState(int(robot.x * 2**23), int(robot.b_hat * 2**24), robot.counters.updates)


def test_telemetry_is_counted_and_not_rejected() -> None:
    """Five robots send it in 9 of 60 ticks. Each robot counts the frames of the four others."""
    run, _frames = run_and_record(small_swarm(robots=5, steps=60, telemetry_period=7))
    frame_counts = run.results["frames"]
    assert frame_counts["telemetry_sent"] == 9 * 5
    assert frame_counts["telemetry_heard"] == 9 * 5 * 4
    assert frame_counts["rejected"] == {}


@pytest.mark.parametrize(
    ("changes", "expected_message"),
    [
        ({"frames": FrameFormat(3001), "telemetry_period": 1}, "subject 3001 is that of telemetry"),
        ({"clock": "none"}, "clock is 'none'; choose lockstep or real-time"),
        ({"allow": "0-128"}, "allow is '0-128'; it must be ids 0 to 127"),
        ({"faults": "loss"}, "faults is .*; give several in a list"),
        ({"faults": ("loss,robots=4+5",)}, "names robot 5, but the ids of 5 robots are 0 to 4"),
        ({"faults": ("loss,receivers=5",)}, "names robot 5, but the ids of 5 robots are 0 to 4"),
    ],
)
def test_settings_of_a_swarm_that_contradict_each_other_are_refused(
    changes: dict[str, Any], expected_message: str
) -> None:
    """The settings are of five robots, whose ids are 0 to 4."""
    parameters: dict[str, Any] = {"robots": 5} | changes
    with pytest.raises(UsageError, match=expected_message):
        SwarmSettings(**parameters)


def test_a_fault_may_name_the_last_robot_of_the_swarm() -> None:
    """There are five robots, so the last one is robot 4; settings that name another are refused."""
    settings = small_swarm("loss,robots=4,receivers=4", robots=5)
    [fault] = settings.faults
    assert str(fault) == "loss=1.0,robots=4,receivers=4"  # the rate is 1.0 by default


def test_estimates_may_have_the_subject_of_telemetry_if_none_is_sent() -> None:
    """The subject in a frame's identifier says what the frame contains; telemetry has the subject 3001.

    By default robots send no telemetry, so no error is raised.
    """
    estimates_with_subject_3001 = FrameFormat(subject=3001)
    assert small_swarm(frames=estimates_with_subject_3001).frames == estimates_with_subject_3001


def test_allowed_ids_are_in_rising_order() -> None:
    """They are written as single ids and ranges, such as 0-3."""
    assert small_swarm(allow="3+0-2+5").allow == "0-3+5"


def run_that_loses_all_frames_after_tick_2(robots: int, monkeypatch: pytest.MonkeyPatch) -> SwarmRun:
    """Run a swarm on a bus from which nothing can be read any more from the third tick on.

    It waits for its frames for 0.05 s.
    """
    receive = virtual.VirtualBus.recv
    monkeypatch.setattr(carrier, "FRAME_TIMEOUT", 0.05)
    with Swarm(small_swarm(robots=robots), ON_ONE_BUS) as swarm:

        def receive_in_two_ticks(bus: virtual.VirtualBus, timeout: float | None) -> can.Message | None:
            return receive(bus, timeout) if swarm.ticks < 2 else None

        monkeypatch.setattr(virtual.VirtualBus, "recv", receive_in_two_ticks)
        return run_swarm(swarm)


def test_a_bus_that_loses_frames_ends_the_run_and_their_identifiers_are_reported(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The failure names tick 3 and the three lost frames. Their identifiers end in the robots' ids.

    The run ends after two whole ticks, and is not marked as interrupted, which only a user can do.
    """
    run = run_that_loses_all_frames_after_tick_2(robots=3, monkeypatch=monkeypatch)
    lost_frames = "frame 106BB800, frame 106BB801, frame 106BB802"
    assert run.failure is not None
    assert run.failure.startswith(f"tick 3: the carrier did not hear {lost_frames} within 0.05 s on ")
    assert run.results["steps"] == 2
    assert not run.interrupted


@pytest.mark.parametrize(
    ("robots", "expected_end_of_list"), [(8, "frame 106BB807"), (9, "frame 106BB807, ...")]
)
def test_of_more_than_eight_lost_frames_eight_are_reported(
    robots: int, expected_end_of_list: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each robot loses one frame, whose identifier ends in its id. Of nine the list has eight and "..."."""
    run = run_that_loses_all_frames_after_tick_2(robots, monkeypatch)
    assert run.failure is not None
    assert f"frame 106BB806, {expected_end_of_list} within" in run.failure


class BusWithFullQueue(virtual.VirtualBus):
    """A virtual bus whose queue is full whenever a frame is sent for the first time."""

    is_full = False

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Send a frame, or raise what SocketCAN raises if the queue is full."""
        self.is_full = not self.is_full
        if self.is_full:
            raise can.CanOperationError("No buffer space available", errno.ENOBUFS)
        super().send(msg, timeout)


@pytest.mark.parametrize("is_shared", [True, False])
def test_a_swarm_on_a_slow_bus_sends_its_frames_when_the_queue_has_room(is_shared: bool) -> None:
    """The run is that on a bus that takes each frame at once. Robots share a bus, or have one each."""

    def join_slow_bus(robot: int) -> can.BusABC:
        name = "slow" if is_shared else f"slow, of {robot}"
        return BusWithFullQueue(name, receive_own_messages=is_shared, preserve_timestamps=True)

    slow_run, slow_frames = run_and_record(small_swarm(steps=20), Wiring(join_slow_bus, is_shared))
    run, frames = run_and_record(small_swarm(steps=20))
    assert identifiers_and_data(slow_frames) == identifiers_and_data(frames)
    assert saved_robots(slow_run.nodes) == saved_robots(run.nodes)


def sent_estimate(sender: int, tick: int) -> SentFrame:
    """Return an estimate that a robot has sent in a tick. Those of different ticks differ."""
    return SentFrame(
        encode_estimate(Estimate(sender, x_hat=0, alpha=tick, transfer_id=tick % 32), FrameFormat()),
        sender,
        tick,
    )


def test_a_wait_for_frames_ends_on_a_bus_that_is_never_quiet(monkeypatch: pytest.MonkeyPatch) -> None:
    """A frame of robot 1 is expected for 0.02 s, but the bus has frames of robot 9 whenever it is read.

    The frame counts as missed. After 0.02 s the connection still reads, without waiting, 4096 frames that a
    buffer may have kept.
    """
    timeouts: list[float] = []

    def receive_from_robot_9(timeout: float) -> can.Message:
        timeouts.append(timeout)
        assert timeouts.count(0) < 10_000, "nothing ends the wait"
        return sent_estimate(sender=9, tick=0).frame

    frame_of_robot_1 = sent_estimate(sender=1, tick=0)
    with virtual.VirtualBus() as bus:
        connection = ExpectingConnection(bus, listener="robot 7")
        monkeypatch.setattr(bus, "recv", receive_from_robot_9)
        received_frames = connection.receive_expected([frame_of_robot_1], timeout=0.02)

    assert received_frames == []
    assert connection.missed_count == 1
    assert max(timeouts) > 0
    reads_without_waiting = timeouts.count(0)
    assert reads_without_waiting == 4096


BusAndConnection = tuple[can.BusABC, ExpectingConnection, list[can.Message]]


@pytest.fixture
def bus_and_connection() -> Iterator[BusAndConnection]:
    """A bus, a connection to it that expects frames, and the frames that it did not expect."""
    unexpected_frames: list[can.Message] = []
    with virtual.VirtualBus("pair") as bus, virtual.VirtualBus("pair") as bus_of_connection:
        connection = ExpectingConnection(bus_of_connection, "robot 7", unexpected_frames.append)
        yield bus, connection, unexpected_frames


def receive_within_10_ms(
    connection: ExpectingConnection, expected: Sequence[SentFrame]
) -> list[tuple[int, bytes]]:
    """Return identifier and data of each expected frame that a connection receives within 10 ms."""
    received_frames = connection.receive_expected(expected, timeout=0.01)
    return identifiers_and_data([sent_frame.frame for sent_frame in received_frames])


def test_frames_are_received_in_the_order_in_which_they_are_expected(
    bus_and_connection: BusAndConnection,
) -> None:
    """The bus delivers the second frame first, and the connection returns it last."""
    bus, connection, _unexpected_frames = bus_and_connection
    first = sent_estimate(sender=1, tick=0)
    second = sent_estimate(sender=2, tick=0)
    bus.send(second.frame)
    bus.send(first.frame)

    received_frames = receive_within_10_ms(connection, expected=[first, second])
    assert received_frames == identifiers_and_data([first.frame, second.frame])


def test_the_received_frame_is_that_of_the_bus_and_not_the_expected_one(
    bus_and_connection: BusAndConnection,
) -> None:
    """The returned frame is another object, and is marked as received (``is_rx``)."""
    bus, connection, _unexpected_frames = bus_and_connection
    expected_frame = sent_estimate(sender=1, tick=0)
    bus.send(expected_frame.frame)
    [received_frame] = connection.receive_expected([expected_frame], timeout=0.01)

    assert received_frame.frame is not expected_frame.frame
    assert received_frame.frame.is_rx


def test_a_late_frame_is_received_with_the_next_ones_and_counted_once(
    bus_and_connection: BusAndConnection,
) -> None:
    """A frame is expected the first time, and comes before the third. It counts as missed once.

    It is received with the frame that is expected the third time, and is not reported as unexpected.
    """
    bus, connection, unexpected_frames = bus_and_connection
    late = sent_estimate(sender=1, tick=0)
    following = sent_estimate(sender=1, tick=1)
    assert receive_within_10_ms(connection, expected=[late]) == []
    assert receive_within_10_ms(connection, expected=[]) == []
    bus.send(late.frame)
    bus.send(following.frame)

    received_frames = receive_within_10_ms(connection, expected=[following])
    assert received_frames == identifiers_and_data([late.frame, following.frame])
    assert connection.missed_count == 1
    assert unexpected_frames == []


def test_all_late_frames_are_received_together_if_no_other_frame_is_expected(
    bus_and_connection: BusAndConnection,
) -> None:
    """A robot that hears nobody else any more receives its late frames in this way."""
    bus, connection, _unexpected_frames = bus_and_connection
    late_frames = [sent_estimate(sender=1, tick=0), sent_estimate(sender=2, tick=0)]
    assert receive_within_10_ms(connection, expected=late_frames) == []
    for late in late_frames:
        bus.send(late.frame)

    received_frames = receive_within_10_ms(connection, expected=[])
    assert received_frames == identifiers_and_data([late.frame for late in late_frames])


def test_a_lost_frame_does_not_hold_up_the_frames_that_are_expected_after_it(
    bus_and_connection: BusAndConnection,
) -> None:
    """Otherwise a swarm in real time would wait in every later tick, each time as long as a tick may wait."""
    bus, connection, _unexpected_frames = bus_and_connection
    assert receive_within_10_ms(connection, expected=[sent_estimate(sender=1, tick=0)]) == []
    following = sent_estimate(sender=1, tick=1)
    bus.send(following.frame)

    start = time.monotonic()
    assert len(connection.receive_expected([following], timeout=10)) == 1
    assert time.monotonic() - start < 10, "seconds that a tick of this swarm may wait"


def test_a_frame_that_comes_after_a_thousand_were_lost_is_not_expected_any_more(
    bus_and_connection: BusAndConnection,
) -> None:
    """Otherwise a swarm would remember all frames that a bus has lost in days."""
    bus, connection, unexpected_frames = bus_and_connection
    first_lost = sent_estimate(sender=1, tick=0)
    last_lost = sent_estimate(sender=2, tick=0)
    assert connection.receive_expected([first_lost, *[last_lost] * 1024], timeout=0) == []
    bus.send(first_lost.frame)
    bus.send(last_lost.frame)

    assert receive_within_10_ms(connection, expected=[]) == identifiers_and_data([last_lost.frame])
    assert identifiers_and_data(unexpected_frames) == identifiers_and_data([first_lost.frame])


def test_of_frames_that_are_alike_each_is_received_once(bus_and_connection: BusAndConnection) -> None:
    """Three equal frames come, and two were expected. The third is reported as unexpected."""
    bus, connection, unexpected_frames = bus_and_connection
    sent_frame = sent_estimate(sender=1, tick=0)
    for _ in range(3):
        bus.send(sent_frame.frame)
    received_frames = receive_within_10_ms(connection, expected=[sent_frame, sent_frame])
    assert len(received_frames) == 2
    connection.discard_echoes()  # reads the rest

    assert identifiers_and_data(unexpected_frames) == identifiers_and_data([sent_frame.frame])


def test_a_frame_that_nobody_expects_is_reported(bus_and_connection: BusAndConnection) -> None:
    """It is reported once, and not again when the bus is read again."""
    bus, connection, unexpected_frames = bus_and_connection
    frame = sent_estimate(sender=1, tick=0).frame
    bus.send(frame)
    connection.discard_echoes()  # reads all that has come
    connection.discard_echoes()

    assert identifiers_and_data(unexpected_frames) == identifiers_and_data([frame])


FOREIGN_FRAMES = [
    can.Message(arbitration_id=0x123, is_extended_id=False, data=b"1234"),  # an identifier of 11 bits
    can.Message(arbitration_id=0x106BB82A, is_remote_frame=True, dlc=8),
    can.Message(arbitration_id=0x106BB801, data=b"\xff" * 8),  # x_hat is above 1
    can.Message(arbitration_id=0x106BB801, data=b"\0" * 7),  # a byte is missing
    encode_estimate(Estimate(sender=99, x_hat=Q23_ONE, alpha=0x4F000000, transfer_id=5), FrameFormat()),
    encode_estimate(Estimate(sender=1, x_hat=Q23_ONE, alpha=0x4F000000, transfer_id=4), FrameFormat()),
    can.Message(arbitration_id=8, is_error_frame=True),
]
"""Four malformed frames, two estimates from outside the swarm (one as robot 1), and an error frame.

Estimates have the identifiers 0x106BB8.., which end in the sender."""


def run_with_foreign_frames() -> tuple[SwarmRun, list[can.Message]]:
    """Run a swarm while another program sends FOREIGN_FRAMES after the fifth tick; return all frames, too."""

    def send_foreign_frames(swarm: Swarm) -> None:
        if swarm.ticks == 5:
            with one_bus() as other_program:
                for frame in FOREIGN_FRAMES:
                    other_program.send(frame, timeout=1)

    return run_and_record(small_swarm(), hooks=[send_foreign_frames])


def test_frames_of_another_program_are_recorded_as_received_in_their_place_after_tick_5() -> None:
    """The other program sends FOREIGN_FRAMES, a list of seven, after tick 5.

    Before and after them are the frames that the swarm of five robots sends when it is alone. In five ticks
    each robot sends a heartbeat and five estimates.
    """
    _run, frames = run_with_foreign_frames()
    _run, frames_of_swarm = run_and_record(small_swarm())
    robots, heartbeats, estimates = 5, 1, 5
    number_in_5_ticks = robots * (heartbeats + estimates)
    before = frames_of_swarm[:number_in_5_ticks]
    after = frames_of_swarm[number_in_5_ticks:]
    expected_frames = [*before, *FOREIGN_FRAMES, *after]
    assert identifiers_and_data(frames) == identifiers_and_data(expected_frames)
    assert all(frame.is_rx for frame in frames)


def test_frames_of_another_program_change_nothing_for_the_robots() -> None:
    """The robots end in the same state as without these frames."""
    disturbed_run, _frames = run_with_foreign_frames()
    undisturbed_run, _frames = run_and_record(small_swarm())
    assert saved_robots(disturbed_run.nodes) == saved_robots(undisturbed_run.nodes)


def test_frames_of_another_program_are_counted_by_each_of_five_robots() -> None:
    """The program sends four malformed frames, two estimates from outside the swarm, and an error frame.

    One of the estimates is under the id of robot 1, which counts it as a conflict. An estimate that no robot
    of the swarm has sent is a stray.
    """
    run, _frames = run_with_foreign_frames()
    robots = 5
    frame_counts = run.results["frames"]
    assert frame_counts["strays"] == 2 * robots
    assert frame_counts["id_conflicts"] == {"1": 1}  # the count of each id
    assert frame_counts["errors_heard"] == 1 * robots
    assert frame_counts["rejected"] == {"STANDARD_ID": 5, "REMOTE_FRAME": 5, "X_HAT": 5, "LENGTH": 5}


def run_of_disagreeing_robots(seed: int = 11) -> SwarmRun:
    """Run five robots that lose half of all frames, so that each has an estimate of its own in the end."""
    run, _frames = run_and_record(small_swarm("loss=0.5", robots=5, seed=seed))
    return run


@pytest.mark.parametrize(("seed", "is_low"), [(11, False), (15, True)])
def test_results_have_the_mean_estimate_and_its_error(seed: int, is_low: bool) -> None:
    """Five robots estimate the share of black, which is 0.55. The error is their mean distance from 0.55.

    With one seed the mean estimate is above 0.55, with the other below it.
    """
    run = run_of_disagreeing_robots(seed)
    estimates = [node.robot.x for node in run.nodes]
    errors = [abs(estimate - 0.55) for estimate in estimates]

    assert run.results["mean_x"] == pytest.approx(sum(estimates) / 5, abs=1e-15)
    assert run.results["mean_error"] == pytest.approx(sum(errors) / 5, abs=1e-15)
    assert (run.results["mean_x"] < 0.55) == is_low


@pytest.mark.parametrize(
    ("group", "robots", "b_hat_at_start"), [("flawed", [0, 1], 0.55), ("other", [2, 3, 4], 0.95)]
)
def test_results_have_mean_and_limits_of_b_hat_of_flawed_and_of_other_robots(
    group: str, robots: list[int], b_hat_at_start: float
) -> None:
    """b_hat, the accuracy that a robot assumes, begins with 0.55 if it is flawed, and else with 0.95."""
    run = run_of_disagreeing_robots()
    b_hat_at_end = [run.nodes[robot].robot.b_hat for robot in robots]
    result = run.results["b_hat"][group]

    assert result["before"] == pytest.approx(b_hat_at_start, abs=1e-6)
    assert result["after"] == pytest.approx(sum(b_hat_at_end) / len(robots), abs=1e-15)
    assert result["after_min"] == min(b_hat_at_end)
    assert result["after_max"] == max(b_hat_at_end)


def test_results_have_the_sums_of_the_robots_tests_and_updates() -> None:
    """A robot's filter tests the assumed accuracy, and updates it if the test rejects it."""
    run = run_of_disagreeing_robots()
    tests_by_robot = [node.robot.counters.tests for node in run.nodes]
    updates_by_robot = [node.robot.counters.updates for node in run.nodes]
    assert run.results["tests"] == sum(tests_by_robot)
    assert run.results["updates"] == sum(updates_by_robot)
    assert sum(tests_by_robot) > sum(updates_by_robot) > 0
