"""Nodes of robots: their frames, their connection to a bus, and the command ``mcp-asdf node``."""

from __future__ import annotations

import errno
import json
import os
import random
import shlex
import signal
import time
from collections.abc import Sequence
from itertools import cycle
from operator import itemgetter
from pathlib import Path
from typing import Any
from unittest.mock import Mock, call

import can
import pytest

from mcp_asdf.fixed_point import alpha_word_from_float
from mcp_asdf.robot import FixedPointRobot, Observation
from mcp_asdf_tools.bus.frames import COMMAND_FORMAT, Estimate, FrameFormat, decode_estimate, encode_estimate
from mcp_asdf_tools.cli.main import main
from mcp_asdf_tools.robots.lockstep import Lockstep
from mcp_asdf_tools.robots.node import BusLink, RobotNode, RunOutcome, filters_for, run_node, send_all
from mcp_asdf_tools.robots.suspicion import MEANINGS, AlphaWatch, Suspicion
from support import PATIENCE, ROOT, interruptible
from wire import join_virtual_bus, make_node, running_in_thread, setup_of_robot

pytestmark = pytest.mark.usefixtures("private_setup")

WHITE, BLACK = Observation


ESTIMATE_FORMAT = FrameFormat(3000)
ESTIMATE_IDENTIFIER = 0x106BB82A
"""The identifier of an estimate of robot 42: priority 4, reserved bits 3, subject 3000, sender 42."""


def test_the_specification_states_the_mask_by_which_a_receiver_filters_frames() -> None:
    """The mask has the bits that all estimates share in their identifiers. docs/design.md has it."""
    (filter_for_estimates,) = filters_for(FrameFormat(subject=3000))
    mask = filter_for_estimates["can_mask"]
    page = (ROOT / "docs/design.md").read_text(encoding="utf-8")
    assert f"mask `0x{mask:08X}`" in page


def draw_frames_near_estimates(count: int) -> list[can.Message]:
    """Draw frames with any identifier, or with an estimate's and one wrong bit. The seed is fixed."""
    draw = random.Random(6)
    frames = []
    for _ in range(count):
        near_an_estimate = ESTIMATE_IDENTIFIER ^ (1 << draw.randrange(29))
        identifier = draw.choice([draw.randrange(1 << 29), near_an_estimate])
        needs_more_than_11_bits = identifier > 0x7FF
        tail_byte_of_single_frames = 0xE0
        data = [0] * 7 + [tail_byte_of_single_frames]
        frames.append(
            can.Message(arbitration_id=identifier, data=data, is_extended_id=needs_more_than_11_bits)
        )
    return frames


def can_decode(frame: can.Message) -> bool:
    """Return whether a frame is an estimate of subject 3000, or would be one of the subject of commands."""
    contents = (decode_estimate(frame, ESTIMATE_FORMAT), decode_estimate(frame, COMMAND_FORMAT))
    return any(isinstance(content, Estimate) for content in contents)


def test_a_robot_s_filters_pass_the_frames_that_it_can_decode_and_no_others() -> None:
    """5000 frames are drawn, many of them with an identifier like that of an estimate but for a bit.

    The filters, for estimates and commands, look at identifiers alone.
    """
    frames = draw_frames_near_estimates(5000)
    with can.Bus(interface="virtual", channel="filters", ignore_config=True) as bus:
        bus.set_filters(filters_for(ESTIMATE_FORMAT, COMMAND_FORMAT))
        passed_frames = [frame for frame in frames if bus._matches_filters(frame)]

    assert passed_frames == [frame for frame in frames if can_decode(frame)]
    assert len(passed_frames) > 100, "too few of the drawn frames pass"


HEARTBEATS, ESTIMATES, TELEMETRY = 7509, 3000, 3001
"""Subjects of the kinds of frames that a node sends."""


def frames_of_200_ticks(subject: int) -> list[can.Message]:
    """Return a node's frames of a subject; it broadcasts in every second tick, and a second has 3 ticks."""
    node = RobotNode(setup_of_robot(5, comms_period=2), steps_per_second=3)
    frames = node.start()
    for _ in range(200):
        frames += node.begin_tick(None) + node.end_tick()
    subject_mask = 0x1FFF  # the 13 bits above the lowest 8
    return [frame for frame in frames if (frame.arbitration_id >> 8) & subject_mask == subject]


@pytest.mark.parametrize(
    ("subject", "expected_times"),
    [
        (HEARTBEATS, list(range(67))),  # the beginning of each second
        (ESTIMATES, [tick / 3 for tick in range(1, 200, 2)]),  # the last tick of each round
        (TELEMETRY, [ticks_ended / 3 for ticks_ended in range(1, 201)]),  # the end of each tick
    ],
)
def test_a_node_sends_each_kind_of_frames_at_its_times(subject: int, expected_times: list[float]) -> None:
    """Heartbeats have the subject 7509, estimates 3000, and telemetry 3001.

    The times are in seconds. A second has three ticks, and a round has two.
    """
    times = [frame.timestamp for frame in frames_of_200_ticks(subject)]
    assert times == expected_times


@pytest.mark.parametrize("subject", [HEARTBEATS, ESTIMATES, TELEMETRY])
def test_the_transfer_ids_of_a_node_s_frames_of_a_subject_count_modulo_32(subject: int) -> None:
    """The transfer_id, in the lowest five bits of the last byte, begins at 0 for each subject."""
    frames = frames_of_200_ticks(subject)
    last_bytes = [frame.data[-1] for frame in frames]
    transfer_ids = [byte % 32 for byte in last_bytes]
    assert transfer_ids == [index % 32 for index in range(len(frames))]


FRAME = can.Message(arbitration_id=1)
SUCCESS, QUEUE_FULL, BUS_DOWN = 0, errno.ENOBUFS, errno.ENETDOWN
"""Error codes of Linux: for a frame that is sent, a bus whose queue is full, and one that is switched off."""


def bus_whose_sends_end_with(*codes: int) -> Mock:
    """Return a bus on which sending frames ends with these error codes of Linux, in turn, again and again."""
    bus = Mock()
    bus.send.side_effect = cycle(can.CanOperationError("no luck", code) if code else None for code in codes)
    return bus


def frames_given_to(bus: Mock) -> list[can.Message]:
    """Return the frames with which the bus was called to send them, in order."""
    return [sending.args[0] for sending in bus.send.call_args_list]


def bus_that_receives(*frames: can.Message | can.CanError | None) -> Mock:
    """Return a bus on which these frames arrive in turn; None stands for no frame in time."""
    return Mock(recv=Mock(side_effect=frames))


@pytest.fixture
def pauses(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """Seconds for which the program has paused; none of them passes."""
    seconds: list[float] = []
    monkeypatch.setattr(time, "sleep", seconds.append)
    return seconds


def test_a_frame_is_sent_again_until_the_bus_has_room_for_it(pauses: list[float]) -> None:
    """Each of two frames is tried three times, as the queue is full twice. A pause follows each failure."""
    first, second = can.Message(arbitration_id=1), can.Message(arbitration_id=2)
    bus = bus_whose_sends_end_with(QUEUE_FULL, QUEUE_FULL, SUCCESS)
    send_all(bus, [first, second], timeout=10)

    assert frames_given_to(bus) == [first, first, first, second, second, second]
    assert len(pauses) == 2 * 2, "two failures of each of two frames"


@pytest.mark.usefixtures("pauses")
def test_frames_do_not_wait_for_a_bus_that_is_down() -> None:
    """The queue is full at the first attempt. At the second the bus is down, and its error is raised."""
    bus = bus_whose_sends_end_with(QUEUE_FULL, BUS_DOWN)
    with pytest.raises(can.CanOperationError, match="no luck"):
        send_all(bus, [FRAME], timeout=10)
    assert frames_given_to(bus) == [FRAME, FRAME]


@pytest.mark.usefixtures("pauses")
def test_frames_do_not_wait_longer_than_the_timeout_for_a_bus_that_stays_full() -> None:
    """The timeout of 0 s is over after the first attempt, and CanTimeoutError is raised."""
    bus = bus_whose_sends_end_with(QUEUE_FULL)
    with pytest.raises(can.CanTimeoutError, match="the bus took no frame for 0 s"):
        send_all(bus, [FRAME], timeout=0)


def test_a_link_that_survives_failures_counts_the_frames_that_it_could_not_send() -> None:
    """The bus takes the first and the last of four frames, as ``send`` returns, and ``failures`` is 2."""
    bus = bus_whose_sends_end_with(SUCCESS, BUS_DOWN, BUS_DOWN, SUCCESS)
    link = BusLink(bus, tolerates_failures=True)

    is_taken = [link.send(FRAME) for _ in range(4)]
    assert is_taken == [True, False, False, True]
    assert link.failures == 2


def test_a_link_that_survives_failures_pauses_when_it_cannot_receive(pauses: list[float]) -> None:
    """The link returns None after 0.1 s, and so does not ask a bus that is down again and again.

    The caller would wait for 9 s. The failure is counted.
    """
    bus = bus_that_receives(can.CanOperationError("down", BUS_DOWN))
    link = BusLink(bus, tolerates_failures=True)

    assert link.receive(seconds=9) is None
    assert link.failures == 1
    assert pauses == [0.1]


def test_a_link_waits_at_most_a_tenth_of_a_second_for_a_frame() -> None:
    """The caller would wait for 9 s, but a signal to end must be noticed soon."""
    bus = bus_that_receives(None)
    BusLink(bus).receive(seconds=9)
    assert bus.recv.call_args == call(0.1)


def test_a_link_does_not_receive_its_own_frames() -> None:
    """A driver may return a frame that was sent here, with ``is_rx`` false. None is received in its place."""
    sent_frame, received_frame = can.Message(is_rx=False), can.Message(is_rx=True)
    link = BusLink(bus_that_receives(sent_frame, received_frame))

    assert link.receive(seconds=0) is None
    assert link.receive(seconds=0) is received_frame


def test_a_link_logs_what_was_sent_and_received_and_the_time_of_sending() -> None:
    """The log has the frame that was sent, not the second one, which failed, and then the received one.

    The sent frame had a time of 0, and gets the time of day.
    """
    log: list[can.Message] = []
    sent_frame = can.Message(arbitration_id=1, timestamp=0.0)
    failed_frame = can.Message(arbitration_id=2)
    received_frame = can.Message(arbitration_id=3, is_rx=True)
    bus = bus_whose_sends_end_with(SUCCESS, BUS_DOWN)
    bus.recv.return_value = received_frame
    link = BusLink(bus, tolerates_failures=True, log=log.append)

    link.send(sent_frame)
    link.send(failed_frame)
    link.receive(seconds=0)

    assert log == [sent_frame, received_frame]
    seconds_since_sending = time.time() - sent_frame.timestamp
    assert abs(seconds_since_sending) < PATIENCE


def test_a_late_node_catches_up_with_all_frames_that_wait() -> None:
    """Two frames wait, and are passed on. The timeout is 0, so that a later one is not waited for."""
    first, second, later = (can.Message(arbitration_id=number, is_rx=True) for number in (1, 2, 3))
    no_frame_waits = None
    bus = bus_that_receives(first, second, no_frame_waits, later)
    received_frames: list[can.Message] = []
    BusLink(bus).handle_waiting_frames(received_frames.append)

    assert received_frames == [first, second]
    assert bus.recv.call_args == call(0), "timeout of the last call, in seconds"


def test_a_bus_that_fails_ends_the_run_of_a_node() -> None:
    """The bus cannot receive, but ``run_node`` raises nothing. The outcome has the error.

    100 is the code that Linux has for a bus that is down.
    """
    bus = bus_that_receives(can.CanOperationError("no luck", error_code=100))
    outcome = run_node(make_node(5), BusLink(bus))
    assert outcome == RunOutcome("the bus failed: no luck [Error Code 100]", has_failed=True)


# The command


ROBOT_5 = "node --id 5 --b-hat 0.7 --comms-period 2 --filter-period 10 --neighbours 20 --steps 40 --json"
"""A node that broadcasts in every second tick, and runs its filter in every tenth."""


def drive_robot_5(model: RobotNode, bus: can.BusABC) -> None:
    """Drive robot 5 and its model for 40 ticks.

    In three of them another node sends an estimate under the id of the robot, and a frame that is too short.
    """
    lockstep = Lockstep(bus, timeout=PATIENCE)
    lockstep.wait_until_up({5}, PATIENCE)
    for tick in range(40):
        observation = WHITE if tick % 3 == 0 else BLACK
        lockstep.observe({5: observation})
        model.begin_tick(observation)
        if tick in (7, 8, 9):
            estimate = encode_estimate(Estimate(5, tick, 0, tick), FrameFormat())
            short_frame = can.Message(arbitration_id=estimate.arbitration_id, data=estimate.data[:7])
            for frame in (estimate, short_frame):
                bus.send(frame, timeout=PATIENCE)
                model.receive_frame(frame)
        lockstep.settle({5})
        model.end_tick()


def run_robot_5_for_40_ticks(*options: str, command: Sequence[str] = ROBOT_5.split()) -> RobotNode:
    """Run the command of robot 5 while it is driven for 40 ticks, and return its model."""
    model = make_node(5, "mirror", 0.7, comms_period=2)
    with join_virtual_bus() as bus, running_in_thread(lambda: drive_robot_5(model, bus)):
        assert main([*command, *options]) == 0
    return model


def test_a_robot_that_a_driver_commands_over_the_bus_ends_in_the_state_of_its_model(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """The node reports the same integers and counters as its model, a robot in Python that is called.

    Both make 40 observations, and receive the same frames.
    """
    model = run_robot_5_for_40_ticks().robot
    reported_robot = json.loads(capsys.readouterr().out)["results"]["robot"]

    assert isinstance(model, FixedPointRobot)
    assert reported_robot["raw"] == {
        "x_hat": model.x_hat_raw,
        "alpha": model.alpha_raw,
        "x": model.x_raw,
        "b_hat": model.b_hat_raw,
        "x_bar": model.x_bar_raw,
        "beta": model.beta_raw,
    }
    assert reported_robot["counters"] == vars(model.counters)


def test_a_node_that_a_driver_commands_for_40_ticks_reports_the_frames_that_it_sent_and_received(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Robot 5 broadcasts in every second tick, with a heartbeat in every tenth.

    Another node sends three estimates and three frames that are too short under the id of robot 5.
    """
    run_robot_5_for_40_ticks()

    assert json.loads(capsys.readouterr().out)["results"]["frames"] == {
        "estimates_sent": 40 // 2,
        "heartbeats_sent": 40 // 10,
        "telemetry_sent": 40,
        "delivered": 3,
        "refused": 3,  # by the firmware, as they are under the robot's own id
        "obeyed": 40 * 2,  # to observe, and to end the tick
        "disobeyed": 0,
        "unsettled": 0,
        "rejected": {"LENGTH": 3},
        "id_conflicts": 3,
        "events": [{"event": "conflict", "sender": 5, "estimates": 3}],
    }


def test_a_node_reports_its_setup_its_bus_and_why_it_ended(capsys: pytest.CaptureFixture[str]) -> None:
    """Robot 5 is run for 40 ticks, with the options ``--b-hat 0.7`` and ``--comms-period 2`` among others."""
    run_robot_5_for_40_ticks()
    report = json.loads(capsys.readouterr().out)

    assert report["parameters"]["robot"] == setup_of_robot(5, "native", b_hat=0.7, comms_period=2).plain()
    assert report["bus"]["interface"] == "virtual"
    assert report["results"]["ending"] == "all ticks done"
    assert report["results"]["steps"] == 40


def test_a_node_with_the_setup_that_another_reported_ends_in_the_same_state(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """The first run of robot 5 has options such as ``--b-hat``, the second one the setup that it reports."""
    run_robot_5_for_40_ticks()
    first_report = json.loads(capsys.readouterr().out)
    setup_text = json.dumps(first_report["parameters"]["robot"])
    run_robot_5_for_40_ticks(command=["node", "--setup", setup_text, "--steps=40", "--json"])
    second_report = json.loads(capsys.readouterr().out)

    assert second_report == first_report


@pytest.mark.parametrize(
    "option", ["--id=5", "--b-hat=0.95", "--filter=robust", "--neighbours=3", "--allow=3"]
)
def test_a_setup_together_with_an_option_that_it_replaces_is_refused(
    option: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """The error names both, also if the option has its default value, as ``--b-hat=0.95``."""
    setup = '{"id": 5, "b_hat": 0.7, "filter": "robust"}'
    assert main(["node", "--setup", setup, option]) == 2
    error_line, _hint = capsys.readouterr().err.splitlines()
    name_of_option, _, _value = option.partition("=")
    assert "--setup" in error_line
    assert name_of_option in error_line


@pytest.mark.parametrize(
    ("setup_text", "expected_message"),
    [
        ('{"id": 5', "--setup is no JSON (Expecting ',' delimiter: line 1 column 9"),
        ("[" * 100_000, "--setup is no JSON (maximum recursion depth"),
        ('{"id": 5}', "--setup: 'b_hat' is missing; add it"),
        ('{"id": 5, "b_hat": 0.7}', "--setup: filter is 'adaptive', which needs table: give its omega"),
    ],
)
def test_a_node_refuses_a_setup_that_describes_no_robot(
    setup_text: str, expected_message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """The exit code is 2, and the error names the value and what to do about it."""
    assert main(["node", "--setup", setup_text]) == 2
    error_line, _hint = capsys.readouterr().err.splitlines()
    assert error_line.startswith(f"mcp-asdf node: error: {expected_message}")


def test_the_log_of_a_node_is_replayed_with_the_frames_that_others_sent_under_its_id(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """Three estimates come under the id of the node, robot 5, from another node. The replay counts them."""
    run_robot_5_for_40_ticks("--log", f"{tmp_path}/run.log")
    assert main(["replay", f"{tmp_path}/run.log"]) == 0
    assert "3  frames under a robot's id that it did not send" in capsys.readouterr().out


# Suspicious estimates


@pytest.mark.parametrize(
    ("alphas", "expected_jumps"),
    [
        ([40.0] * 32 + [80.0], 1),
        ([40.0] * 32 + [79.999], 0),
        ([40.0] * 31 + [80.0], 0),
        # A robot whose alpha falls by half has begun anew.
        ([80.0] * 33 + [40.0] * 32 + [80.0], 0),
        ([80.0] * 33 + [40.0] * 33 + [80.0], 1),
        ([0.0] * 100, 0),  # 0 is twice 0
    ],
)
def test_an_alpha_that_is_twice_the_one_before_counts_as_a_jump_after_32_estimates(
    alphas: list[float], expected_jumps: int
) -> None:
    """An alpha is the confidence of an estimate. Robot 6 sends these one after the other.

    The 32 estimates are counted anew after an alpha that is half of the one before, as of a new robot.
    """
    watch = AlphaWatch()
    jumps = 0
    for alpha in alphas:
        if watch.is_jump(6, alpha_word_from_float(alpha)):
            jumps += 1
    assert jumps == expected_jumps


OWN_ID, ALLOWED_ID, OTHER_ID = 5, 6, 30
SUSPICIOUS_ESTIMATES = [
    *[(ALLOWED_ID, 40.0)] * 32,
    *[(OWN_ID, 1.0)] * 2,
    *[(OTHER_ID, 1.0)] * 3,
    (ALLOWED_ID, 80.0),  # twice the last alpha of this robot, which is a jump
]
"""Sender and alpha of estimates that are sent to robot 5, which allows the ids 6 to 9."""


def send_suspicious_estimates(bus: can.BusABC) -> None:
    """Drive robot 5 for a tick, in which the estimates above are sent."""
    lockstep = Lockstep(bus, timeout=PATIENCE)
    lockstep.wait_until_up({5}, PATIENCE)
    lockstep.observe({5: WHITE})
    for sender, alpha in SUSPICIOUS_ESTIMATES:
        estimate = Estimate(sender, 9, alpha_word_from_float(alpha), transfer_id=0)
        bus.send(encode_estimate(estimate, FrameFormat()), timeout=PATIENCE)
    lockstep.settle({5})


def run_among_suspicious_neighbours(capsys: pytest.CaptureFixture[str]) -> tuple[dict[str, Any], str]:
    """Run robot 5, which allows ids 6 to 9, among them, and return its report and what it warned of."""
    with join_virtual_bus() as bus, running_in_thread(lambda: send_suspicious_estimates(bus)):
        assert main(["node", "--id=5", "--allow=6-9", "--filter=none", "--steps=1", "--json"]) == 0
    output = capsys.readouterr()
    return json.loads(output.out), output.err


def test_a_node_counts_suspicious_estimates_and_drops_those_of_ids_that_are_not_allowed(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """The node is robot 5, and only robots 6 to 9 are allowed. It gets 38 estimates in one round.

    33 are of robot 6, of which the firmware takes only the first. In the last of them the confidence alpha
    doubles, which is a jump. Two are under the node's own id: they are not dropped, but the firmware refuses
    them. Three are of robot 30, which is not allowed: they are dropped.
    """
    report, _errors = run_among_suspicious_neighbours(capsys)
    frames = report["results"]["frames"]

    assert frames["delivered"] == 33 + 2  # of robot 6, and under the node's own id
    assert frames["refused"] == 32 + 2  # all but the first of robot 6, and those two
    assert sorted(frames["events"], key=itemgetter("sender")) == [
        {"event": "conflict", "sender": 5, "estimates": 2},
        {"event": "jump", "sender": 6, "estimates": 1},
        {"event": "unknown", "sender": 30, "estimates": 3},
    ]


def test_a_node_warns_once_of_each_kind_of_suspicious_estimates_and_each_sender(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """A line of the error output names the sender and what is suspicious about its estimates.

    Several are under the id of the node itself, 5. Several are of robot 30, which is not allowed. The alpha
    of robot 6 jumps once.
    """
    _report, errors = run_among_suspicious_neighbours(capsys)
    warnings = [line for line in errors.splitlines() if ": node " in line]

    assert sorted(warnings) == [
        "mcp-asdf node: node 30: " + MEANINGS[Suspicion.UNKNOWN],
        "mcp-asdf node: node 5: " + MEANINGS[Suspicion.CONFLICT],
        "mcp-asdf node: node 6: " + MEANINGS[Suspicion.JUMP],
    ]


# The end of a run


def run_robot_3_until_it_is_asked_to_end(arguments: list[str], ending_signal: signal.Signals | None) -> int:
    """Run a node that is asked to end after a tick, and return its exit code.

    It is asked by a signal or, if that is None, by the end of its input, in which there is something to read.
    """
    read_end, write_end = os.pipe()

    def end_after_a_tick(bus: can.BusABC) -> None:
        os.write(write_end, b"something")
        lockstep = Lockstep(bus, timeout=PATIENCE)
        lockstep.wait_until_up({3}, PATIENCE)
        lockstep.observe({3: BLACK})
        lockstep.settle({3})
        if ending_signal is not None:
            os.kill(os.getpid(), ending_signal)
        os.close(write_end)

    with os.fdopen(read_end) as stdin, pytest.MonkeyPatch.context() as patch:
        patch.setattr("sys.stdin", stdin)
        with join_virtual_bus() as bus, running_in_thread(lambda: end_after_a_tick(bus)):
            return main(["node", "--id", "3", *arguments])


@pytest.mark.parametrize(
    ("options", "ending_signal", "exit_code"),
    [
        ([], signal.SIGINT, 0),
        (["--until-eof"], None, 0),
        # Only a run with a number of steps has been interrupted: the others have no other end.
        (["--steps", "100000"], signal.SIGTERM, 128 + signal.SIGTERM),
    ],
)
@interruptible()
def test_a_node_that_is_asked_to_end_stops_after_its_tick_and_its_log_can_be_replayed(
    options: list[str],
    ending_signal: signal.Signals | None,
    exit_code: int,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
) -> None:
    """A signal or, with None, the end of its input asks the node to end. It reports one tick.

    Only a run with the option ``--steps`` has been interrupted then, and has the exit code of the signal.
    ``replay`` accepts the log of each run.
    """
    arguments = [*options, "--log", f"{tmp_path}/run.log"]
    assert run_robot_3_until_it_is_asked_to_end(arguments, ending_signal) == exit_code
    output_in_one_line = " ".join(capsys.readouterr().out.split())  # it may be wrapped at any space
    assert "1 ticks as robot 3; stopped" in output_in_one_line
    assert main(["replay", f"{tmp_path}/run.log"]) == 0


@interruptible()
def test_a_node_that_has_ended_says_how_to_run_it_again(capsys: pytest.CaptureFixture[str]) -> None:
    """The node ends by SIGINT, and prints its command."""
    run_robot_3_until_it_is_asked_to_end(["--b-hat", "0.7"], signal.SIGINT)
    assert "again: mcp-asdf node --id 3 --b-hat 0.7\n" in capsys.readouterr().out


MESSAGES_BY_WRONG_OPTIONS = {
    "": "--id",
    "--id 128": "robot id is 128; choose 0 .. 127",
    "--id 1 --comms-period 3": "--filter-period is 1000; it must be a multiple of comms_period, 3",
    "--id 1 --neighbours 1": "--neighbours is 1; it must be 2 to 127",
    "--id 1 --filter none --omega 0.1": "--omega would do nothing: filter is none; leave it out",
    "--id 1 --activation always --neighbours 30": "--neighbours would do nothing: the robot uses no t-table",
    "--id 1 --filter robust --neighbours 30": "--neighbours would do nothing: the robot uses no t-table",
    "--id 1 --filter robust --activation always": "--activation would do nothing: filter is robust",
    "--id 1 --steps-per-second 0": "--steps-per-second is 0; it must be 1 to 1000000",
    "--id 1 --steps 0": "steps is 0",
    "--id 1 --until-eof": "there is no standard input",
    "--id 1 --telemetry-subject 3000": "the subjects [3000, 3000, 3002]; choose three different ones",
    "--id 1 --log run.db": "cannot log to run.db: choose .log",
}


@pytest.mark.parametrize(("arguments", "expected_message"), MESSAGES_BY_WRONG_OPTIONS.items())
def test_a_wrong_option_of_the_command_node_is_reported_and_no_file_is_written(
    arguments: str,
    expected_message: str,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
) -> None:
    """The exit code is 2, and the error output says what is wrong. Nothing else is printed."""
    monkeypatch.chdir(tmp_path)
    assert main(["node", *shlex.split(arguments)]) == 2
    output = capsys.readouterr()

    assert expected_message in output.err
    assert output.out == ""
    assert not list(tmp_path.iterdir())
