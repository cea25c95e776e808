"""Nodes of robots: their frames, their connection to a bus, and the command ``mcp-asdf node``."""

from __future__ import annotations

import errno
import json
import os
import random
import shlex
import signal
import time
from itertools import cycle
from pathlib import Path
from typing import Any
from unittest.mock import Mock, call

import can
import pytest

from mcp_asdf.robot import FixedPointRobot, Observation
from mcp_asdf_tools.bus.alpha_words import alpha_word_from_float32_bits, float32_bits
from mcp_asdf_tools.bus.frames import COMMAND_FORMAT, Estimate, FrameFormat, decode_estimate, encode_estimate
from mcp_asdf_tools.cli.main import main
from mcp_asdf_tools.common.signals import ENDING_SIGNALS
from mcp_asdf_tools.robots.lockstep import Lockstep
from mcp_asdf_tools.robots.node import BusLink, RobotNode, RunOutcome, filters_for, run_node, send_all
from mcp_asdf_tools.robots.suspicion import MEANINGS, Suspicion
from support import PATIENCE, ROOT, interruptible
from wire import join, meanwhile, node, record

pytestmark = pytest.mark.usefixtures("private_setup")

WHITE, BLACK = Observation


SUBJECTS = FrameFormat(3000), COMMAND_FORMAT


def test_the_specification_states_the_mask_by_which_a_receiver_filters_frames() -> None:
    page = (ROOT / "docs/design.md").read_text(encoding="utf-8")
    mask = filters_for(*SUBJECTS)[0]["can_mask"]
    assert f"mask `0x{mask:08X}`" in page


def test_a_robot_s_filters_pass_the_frames_that_it_can_decode_and_no_others() -> None:
    """Of 20,000 identifiers half are drawn at random, and half are one bit away from that of an estimate."""
    draw = random.Random(6)
    passed = 0
    with can.Bus(interface="virtual", channel="filters", ignore_config=True) as bus:
        bus.set_filters(filters_for(*SUBJECTS))
        for _ in range(20_000):
            near_an_estimate = 0x106BB82A ^ (1 << draw.randrange(29))
            identifier = draw.choice([draw.randrange(1 << 29), near_an_estimate])
            frame = can.Message(arbitration_id=identifier, data=b"\0\0\0\0\0\0\0\xe0")
            frame.is_extended_id = identifier > 0x7FF
            is_accepted = any(isinstance(decode_estimate(frame, subject), Estimate) for subject in SUBJECTS)
            assert bus._matches_filters(frame) == is_accepted, "replay: random.Random(6)"
            passed += is_accepted

    assert passed > 1000, "too few of the drawn frames are ones that pass"


def frames_of_200_ticks(subject: int) -> list[tuple[int, float]]:
    """Return transfer_id and time of a node's frames of a subject.

    Its robot broadcasts in every second tick, and a second of its time has 3 ticks.
    """
    node = RobotNode(record(5, comms_period=2), steps_per_second=3)
    frames = node.start()
    for _ in range(200):
        frames += node.observe(None) + node.settle()
    return [
        (frame.data[-1] % 32, frame.timestamp)
        for frame in frames
        if (frame.arbitration_id >> 8) & 0x1FFF == subject
    ]


def test_a_node_sends_a_heartbeat_at_the_beginning_of_each_second() -> None:
    assert frames_of_200_ticks(7509) == [(second % 32, second) for second in range(67)]


def test_a_node_sends_estimates_in_the_last_tick_of_each_round_with_the_time_of_its_beginning() -> None:
    assert frames_of_200_ticks(3000) == [(index % 32, (2 * index + 1) / 3) for index in range(100)]


def test_a_node_sends_telemetry_at_the_end_of_each_tick() -> None:
    assert frames_of_200_ticks(3001) == [(tick % 32, (tick + 1) / 3) for tick in range(200)]


FRAME = encode_estimate(Estimate(9, 1, 0, 0), FrameFormat())
FULL, DOWN = errno.ENOBUFS, errno.ENETDOWN


def outcomes(*codes: int) -> list[can.CanOperationError | None]:
    """Return what calls of a bus do that have these error codes, 0 for success."""
    return [can.CanOperationError("no luck", code) if code else None for code in codes]


@pytest.fixture
def pauses(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """Seconds for which the program has paused; none of them passes."""
    seconds: list[float] = []
    monkeypatch.setattr(time, "sleep", seconds.append)
    return seconds


def test_a_frame_is_sent_again_until_the_bus_has_room_for_it(pauses: list[float]) -> None:
    """The queue of the bus is full for two attempts at each frame."""
    frames, bus = [can.Message(arbitration_id=identifier) for identifier in range(50)], Mock()
    bus.send.side_effect = cycle(outcomes(FULL, FULL, 0))
    send_all(bus, frames, 10)

    # Each of 50 frames is tried three times, with a pause after the first and the second attempt.
    tried_frames = [sending.args[0] for sending in bus.send.call_args_list]
    assert tried_frames == [frame for frame in frames for _ in range(3)]
    assert len(pauses) == 50 * 2


def test_frames_do_not_wait_for_a_bus_that_is_down(pauses: list[float]) -> None:
    bus = Mock()
    bus.send.side_effect = outcomes(FULL, DOWN)
    with pytest.raises(can.CanOperationError, match="no luck"):
        send_all(bus, [FRAME], 10)


def test_frames_do_not_wait_longer_than_the_timeout(pauses: list[float]) -> None:
    bus = Mock()
    bus.send.side_effect = cycle(outcomes(FULL))
    with pytest.raises(can.CanTimeoutError, match="the bus took no frame for 0 s"):
        send_all(bus, [FRAME], 0)


def test_a_link_that_survives_failures_counts_the_frames_that_it_could_not_send() -> None:
    bus = Mock()
    bus.send.side_effect = outcomes(0, DOWN, DOWN, 0)
    link = BusLink(bus, endures=True)

    assert [link.send(FRAME) for _ in range(4)] == [True, False, False, True]
    assert link.failures == 2


def test_a_link_that_survives_failures_pauses_when_it_cannot_receive(pauses: list[float]) -> None:
    """Or it would ask a bus that is down without end."""
    bus = Mock()
    bus.recv.side_effect = outcomes(DOWN)
    link = BusLink(bus, endures=True)

    assert link.receive(9) is None
    assert (link.failures, pauses) == (1, [0.1])


def test_a_link_waits_at_most_a_tenth_of_a_second_for_a_frame() -> None:
    """So a signal to end is noticed soon, also if the caller would wait for 9 s."""
    bus = Mock(recv=Mock(return_value=None))
    for seconds in (9, 0):
        BusLink(bus).receive(seconds)
    assert bus.recv.call_args_list == [call(0.1), call(0)]


def test_a_link_does_not_receive_its_own_frames() -> None:
    """A driver that returns them marks them as sent."""
    sent_frame, received_frame = can.Message(is_rx=False), can.Message(is_rx=True)
    bus = Mock(recv=Mock(side_effect=[sent_frame, received_frame]))
    link = BusLink(bus)

    assert link.receive(0) is None
    assert link.receive(0) is received_frame


def test_a_link_logs_what_was_sent_and_received_and_the_time_of_sending() -> None:
    """Of two attempts to send the second fails, so it is not in the log."""
    log: list[can.Message] = []
    received_frame = can.Message(is_rx=True)
    bus = Mock()
    bus.send.side_effect = outcomes(0, DOWN)
    bus.recv.return_value = received_frame
    link = BusLink(bus, endures=True, log=log.append)

    link.send(FRAME)
    link.send(FRAME)
    link.receive(0)

    assert log == [FRAME, received_frame]
    assert abs(log[0].timestamp - time.time()) < PATIENCE


def test_a_late_node_catches_up_with_all_frames_that_wait() -> None:
    """Two frames wait; then there is none, and it does not wait for the next."""
    frame = can.Message(is_rx=True)
    bus = Mock(recv=Mock(side_effect=[frame, frame, None, frame]))
    received: list[can.Message] = []
    BusLink(bus).catch_up(received.append)

    assert received == [frame, frame]
    assert bus.recv.call_args == call(0)


def test_a_bus_that_fails_ends_the_run_of_a_node() -> None:
    bus = Mock()
    bus.send.side_effect, bus.recv.side_effect = outcomes(0), outcomes(DOWN)
    outcome = run_node(node(5), BusLink(bus))
    assert outcome == RunOutcome("the bus failed: no luck [Error Code 100]", has_failed=True)


# The command


def test_the_command_of_a_node_fails_with_the_reason_if_its_bus_fails(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    outcome = RunOutcome("the bus failed: no luck", has_failed=True)
    monkeypatch.setattr("mcp_asdf_tools.robots.node.run_node", lambda *_: outcome)
    assert main(["node", "--id", "5", "--quiet"]) == 1
    assert capsys.readouterr() == ("", "mcp-asdf node: the bus failed: no luck\n")


ROBOT_5 = "node --id 5 --b-hat 0.7 --comms-period 2 --filter-period 10 --neighbours 20 --steps 40 --json"
"""A node that broadcasts in every second tick, and runs its filter in every tenth."""


def drive_robot_5(model: RobotNode, bus: can.BusABC) -> None:
    """Drive robot 5 and its model for 40 ticks.

    In three of them another node sends an estimate under the id of the robot, and the first seven bytes of it
    once more.
    """
    lockstep = Lockstep(bus, timeout=PATIENCE)
    lockstep.wait_until_up({5}, PATIENCE)
    for tick in range(40):
        z = (WHITE, BLACK, None)[tick * tick % 3]
        lockstep.observe({5: z})
        model.observe(z)
        if tick in (7, 8, 9):
            estimate = encode_estimate(Estimate(5, tick, 0, tick), FrameFormat())
            short_frame = can.Message(arbitration_id=estimate.arbitration_id, data=estimate.data[:7])
            for frame in (estimate, short_frame):
                bus.send(frame, timeout=1)
                model.receive_frame(frame)
        lockstep.settle({5})
        model.settle()


def run_robot_5(*options: str) -> RobotNode:
    """Run the command of robot 5 while it is driven, and return its model."""
    model = node(5, "mirror", 0.7, comms_period=2)
    with join() as bus, meanwhile(lambda: drive_robot_5(model, bus)):
        assert main([*ROBOT_5.split(), *options]) == 0
    return model


def test_a_robot_driven_by_commands_ends_in_the_state_of_its_model(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """The model is the same robot in this process, computed in Python."""
    model = run_robot_5()
    reported_state = json.loads(capsys.readouterr().out)["results"]["robot"]["raw"]
    assert isinstance(model.robot, FixedPointRobot)
    assert reported_state == {name: getattr(model.robot, f"{name}_raw") for name in reported_state}


def test_a_driven_node_reports_the_frames_that_it_sent_and_received(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """In 40 ticks, and three estimates and three short frames of another node under its id."""
    run_robot_5()

    assert json.loads(capsys.readouterr().out)["results"]["frames"] == {
        "estimates_sent": 40 // 2,
        "heartbeats_sent": 40 // 10,
        "telemetry_sent": 40,
        "delivered": 3,
        "refused": 3,
        "obeyed": 40 * 2,  # to observe, and to end the tick
        "disobeyed": 0,
        "unsettled": 0,
        "rejected": {"LENGTH": 3},
        "id_conflicts": 3,
        "events": [{"event": "conflict", "sender": 5, "estimates": 3}],
    }


def test_a_driven_node_reports_its_setup_and_why_it_ended(capsys: pytest.CaptureFixture[str]) -> None:
    run_robot_5()
    report = json.loads(capsys.readouterr().out)

    assert report["parameters"]["robot"] == record(5, "native", 0.7, comms_period=2).plain()
    assert report["results"]["ending"] == "all ticks done"
    assert report["results"]["steps"] == 40
    estimates_under_its_own_id = 3
    assert report["results"]["robot"]["counters"]["rejected"] == estimates_under_its_own_id


def test_a_node_warns_once_of_another_with_its_id(capsys: pytest.CaptureFixture[str]) -> None:
    run_robot_5()
    errors = capsys.readouterr().err
    assert errors.count("another node sends under this node's own id; give one of them another") == 1


def test_the_log_of_a_node_is_replayed_with_the_frames_that_others_sent_under_its_id(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    run_robot_5("--log", f"{tmp_path}/run.log")
    capsys.readouterr()
    assert main(["replay", f"{tmp_path}/run.log"]) == 0
    assert "3  frames under a robot's id that it did not send" in capsys.readouterr().out


# Suspicious estimates

SMALL, DOUBLE, HUGE = float32_bits(40.0), float32_bits(80.0), float32_bits(1e30)
ALPHA_BITS_BY_SENDER = {
    # Up to 32 estimates may have any alpha. The 33rd has just twice that of the one before, which is a jump;
    # twice is no jump any more after an alpha that has fallen by half, and less than twice never is.
    6: [*range(SMALL, SMALL + 32), DOUBLE + 31, *[SMALL] * 33, DOUBLE - 1],
    7: [SMALL, *[DOUBLE] * 32, HUGE],
    8: [*[DOUBLE] * 33, *[SMALL] * 32, DOUBLE],
    9: [DOUBLE, *[SMALL] * 33, DOUBLE],
}
"""Alpha of each estimate of robots 6 to 9, as float32 bits."""


def send_suspicious_estimates(bus: can.BusABC) -> None:
    """Drive robot 5 for 70 ticks, while robots 6 to 9 send the estimates above.

    Another node sends an estimate in each tick under the id of the robot, and two that are not allowed do so,
    too.
    """
    lockstep = Lockstep(bus, timeout=PATIENCE)
    lockstep.wait_until_up({5}, PATIENCE)
    for tick in range(70):
        lockstep.observe({5: WHITE})
        alpha_bits = dict.fromkeys((5, 30, 127), HUGE)
        alpha_bits |= {
            sender: bits[tick] for sender, bits in ALPHA_BITS_BY_SENDER.items() if tick < len(bits)
        }
        for sender, bits in alpha_bits.items():
            estimate = Estimate(sender, 9, alpha_word_from_float32_bits(bits), tick % 32)
            bus.send(encode_estimate(estimate, FrameFormat()), timeout=1)
        lockstep.settle({5})


SUSPICIONS = {
    ("conflict", 5): 70,
    ("unknown", 30): 70,
    ("unknown", 127): 70,
    ("jump", 6): 1,
    ("jump", 7): 1,
    ("jump", 9): 1,
}
"""Numbers of these estimates that are suspicious, by kind and sender."""


def run_among_suspicious_neighbours(capsys: pytest.CaptureFixture[str]) -> tuple[dict[str, Any], str]:
    """Run robot 5, which allows ids 6 to 9, among them, and return its report and what it warned of."""
    with join() as bus, meanwhile(lambda: send_suspicious_estimates(bus)):
        assert main(["node", "--id=5", "--allow=6+7-9", "--filter=none", "--steps=70", "--json"]) == 0
    output = capsys.readouterr()
    return json.loads(output.out), output.err


def test_a_node_counts_suspicious_estimates_by_kind_and_sender(capsys: pytest.CaptureFixture[str]) -> None:
    """Suspicious are the robot's own id, ids that are not allowed, and a confidence alpha that jumps."""
    report, _ = run_among_suspicious_neighbours(capsys)
    events = report["results"]["frames"]["events"]
    assert {(event["event"], event["sender"]): event["estimates"] for event in events} == SUSPICIONS


def test_a_node_warns_once_of_each_kind_of_suspicious_estimates_and_each_sender(
    capsys: pytest.CaptureFixture[str],
) -> None:
    _, errors = run_among_suspicious_neighbours(capsys)
    warnings = [line for line in errors.splitlines() if ": node " in line]

    assert sorted(warnings) == sorted(
        f"mcp-asdf node: node {sender}: {MEANINGS[Suspicion(kind)]}" for kind, sender in SUSPICIONS
    )


def test_a_node_drops_the_estimates_of_ids_that_are_not_allowed(capsys: pytest.CaptureFixture[str]) -> None:
    """In each of 70 ticks one estimate has the node's own id. It reaches the firmware, which refuses it."""
    report, _ = run_among_suspicious_neighbours(capsys)

    estimates_of_allowed = sum(map(len, ALPHA_BITS_BY_SENDER.values()))
    assert report["results"]["frames"]["delivered"] == 70 + estimates_of_allowed
    assert report["results"]["robot"]["counters"]["accepted"] == estimates_of_allowed


def test_a_node_reports_the_allowed_ids_as_ranges(capsys: pytest.CaptureFixture[str]) -> None:
    """They were given as 6+7-9."""
    report, _ = run_among_suspicious_neighbours(capsys)
    assert report["parameters"]["robot"]["allow"] == "6-9"


# The end of a run

ENDINGS = {"": signal.SIGINT, "--steps 100000": signal.SIGTERM, "--until-eof": None}
"""Signals by the options of a node that they end; None is the end of its input."""


@pytest.mark.parametrize("options", ENDINGS)
@interruptible()
def test_a_node_that_is_asked_to_end_saves_its_log_and_says_how_to_run_it_again(
    options: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    ending_signal = ENDINGS[options]
    handlers = [signal.getsignal(number) for number in ENDING_SIGNALS]
    reading_end, writing_end = os.pipe()

    def end_after_a_tick(bus: can.BusABC) -> None:
        os.write(writing_end, b"something")  # input that can be read is no end of it
        lockstep = Lockstep(bus, timeout=PATIENCE)
        lockstep.wait_until_up({3}, PATIENCE)
        lockstep.observe({3: BLACK})
        lockstep.settle({3})
        os.kill(os.getpid(), ending_signal or 0)
        os.close(writing_end)

    words = ["node", "--id", "3", *options.split(), "--log", f"{tmp_path}/run.log"]
    with os.fdopen(reading_end) as stdin, join() as bus, meanwhile(lambda: end_after_a_tick(bus)):
        monkeypatch.setattr("sys.stdin", stdin)
        exit_code = main(words)
    # Only a run with a number of steps has been interrupted: the others have no other end.
    assert exit_code == (128 + signal.SIGTERM if "--steps" in options else 0)
    output = " ".join(capsys.readouterr().out.split())
    assert "1 ticks as robot 3; stopped" in output
    assert shlex.split(output.partition("again: mcp-asdf ")[2]) == words
    assert main(["replay", f"{tmp_path}/run.log"]) == 0
    assert [signal.getsignal(number) for number in ENDING_SIGNALS] == handlers


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


@pytest.mark.parametrize("arguments", MESSAGES_BY_WRONG_OPTIONS)
def test_a_wrong_option_of_a_node_is_reported_and_nothing_is_written(
    arguments: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["node", *shlex.split(arguments)]) == 2
    output = capsys.readouterr()

    assert MESSAGES_BY_WRONG_OPTIONS[arguments] in output.err
    assert output.out == ""
    assert not list(tmp_path.iterdir())
