"""``mcp-asdf node``: what it reports, refuses and saves, and every way to end."""

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
from unittest.mock import Mock, call

import can
import pytest

from mcp_asdf.robot import FixedPointRobot, Observation
from mcp_asdf_tools.bus.alpha_words import alpha_word_from_float32_bits, float32_bits
from mcp_asdf_tools.bus.frames import COMMAND_FORMAT, Estimate, FrameFormat, decode_estimate, encode_estimate
from mcp_asdf_tools.cli.main import main
from mcp_asdf_tools.common.signals import ENDING_SIGNALS
from mcp_asdf_tools.robots.lockstep import Lockstep
from mcp_asdf_tools.robots.node import BusLink, RobotNode, filters_for, run_node, send_all
from mcp_asdf_tools.robots.suspicion import MEANINGS, Suspicion
from support import PATIENCE, ROOT, interruptible
from wire import join, meanwhile, node, record

pytestmark = pytest.mark.usefixtures("private_setup")

WHITE, BLACK = Observation


def test_filters_pass_what_decoders_may_accept_and_nothing_else() -> None:
    """Their mask is the one of docs/frame.md."""
    draw = random.Random(6)
    subjects = FrameFormat(3000), COMMAND_FORMAT
    page = (ROOT / "docs/frame.md").read_text(encoding="utf-8")
    assert f"mask `{filters_for(*subjects)[0]['can_mask']:#010X}`".replace("0X", "0x") in page
    with can.Bus(interface="virtual", channel="filters", ignore_config=True) as bus:
        bus.set_filters(filters_for(*subjects))
        passed = 0
        for _ in range(20_000):
            identifier = draw.choice([draw.randrange(1 << 29), 0x106BB82A ^ 1 << draw.randrange(29)])
            frame = can.Message(arbitration_id=identifier, data=b"\0\0\0\0\0\0\0\xe0")
            frame.is_extended_id = identifier > 0x7FF
            wanted = any(isinstance(decode_estimate(frame, subject), Estimate) for subject in subjects)
            assert bus._matches_filters(frame) == wanted, "replay: random.Random(6)"
            passed += wanted
    assert passed > 1000


def test_a_node_s_frames_have_its_own_time_and_number_and_a_heartbeat_begins_each_second() -> None:
    """By their subjects, 7509 that of heartbeats."""
    node = RobotNode(record(5, comms_period=2), steps_per_second=3)
    frames = node.start() + [each for _ in range(200) for each in node.observe(None) + node.settle()]
    expected: list[tuple[int, int, float]] = []
    for tick in range(200):
        expected += [(7509, tick // 3 % 32, tick / 3)] * (tick % 3 == 0)
        expected += [(3000, tick // 2 % 32, tick / 3)] * (tick % 2 == 1)
        expected += [(3001, tick % 32, (tick + 1) / 3)]
    found = [(each.arbitration_id >> 8 & 0x1FFF, each.data[-1] % 32, each.timestamp) for each in frames]
    assert found == expected


FRAME = encode_estimate(Estimate(9, 1, 0, 0), FrameFormat())
FULL, DOWN = errno.ENOBUFS, errno.ENETDOWN


def outcomes(*codes: int) -> list[can.CanOperationError | None]:
    """What calls of a bus do that have these error codes, 0 for success."""
    return [can.CanOperationError("no luck", code) if code else None for code in codes]


def test_a_full_send_queue_is_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    frames, bus, slept = [can.Message(arbitration_id=n) for n in range(50)], Mock(), list[float]()
    monkeypatch.setattr(time, "sleep", slept.append)
    bus.send.side_effect = cycle(outcomes(FULL, FULL, 0))
    send_all(bus, frames, 10)
    assert len(slept) == 100
    assert [each.args[0] for each in bus.send.call_args_list] == [each for each in frames for _ in range(3)]
    bus.send.side_effect = outcomes(FULL, DOWN)
    with pytest.raises(can.CanOperationError, match="no luck"):
        send_all(bus, frames, 10)
    bus.send.side_effect = cycle(outcomes(FULL))
    with pytest.raises(can.CanTimeoutError, match="the bus took no frame for 0 s"):
        send_all(bus, frames, 0)


def test_a_link_that_endures_counts_failures_and_one_that_does_not_ends_the_run(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """What the driver marks as sent by itself is not heard."""
    log, bus, slept = list[can.Message](), Mock(), list[float]()
    monkeypatch.setattr(time, "sleep", slept.append)
    bus.send.side_effect, bus.recv.side_effect = outcomes(0, 0, DOWN, DOWN, 0), [*outcomes(DOWN), FRAME]
    link = BusLink(bus, endures=True, log=log.append)
    assert [link.send(FRAME) for _ in range(5)] == [True, True, False, False, True]
    assert [link.receive(9), link.receive(0)] == [None, None]
    assert slept == [0.1] and bus.recv.call_args_list == [call(0.1), call(0)]
    assert (len(log), link.failures) == (3, 3)
    assert abs(log[0].timestamp - time.time()) < PATIENCE
    bus.send.side_effect, bus.recv.side_effect = outcomes(0), outcomes(DOWN)
    outcome = run_node(node(5), BusLink(bus))
    assert outcome.has_failed and not outcome.is_interrupted
    assert outcome.ending == "the bus failed: no luck [Error Code 100]"
    monkeypatch.setattr("mcp_asdf_tools.robots.node.run_node", lambda *_: outcome)
    assert main(["node", "--id", "5", "--quiet"]) == 1
    assert capsys.readouterr() == ("", f"mcp-asdf node: {outcome.ending}\n")
    bus.recv.side_effect, heard = None, can.Message(is_rx=True)
    bus.recv.return_value = heard
    assert link.receive(0) is log[-1] is heard
    assert BusLink(bus).receive(0) is heard
    bus.recv.side_effect, taken = [heard, heard, None, heard], list[can.Message]()
    BusLink(bus).catch_up(taken.append)
    assert taken == [heard, heard] and bus.recv.call_args == call(0)


# The command


def test_a_driven_node_reports_what_its_robot_is(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    """Also while another node sends under its id."""
    log, twin = tmp_path / "run.log", node(5, "mirror", 0.7, comms_period=2)

    def drive(bus: can.BusABC) -> None:
        lockstep = Lockstep(bus, timeout=PATIENCE)
        lockstep.wait_until_up({5}, PATIENCE)
        for tick in range(40):
            z = (WHITE, BLACK, None)[tick * tick % 3]
            lockstep.observe({5: z})
            twin.observe(z)
            if tick in (7, 8, 9):
                stranger = encode_estimate(Estimate(5, tick, 0, tick), FrameFormat())
                cut = can.Message(arbitration_id=stranger.arbitration_id, data=stranger.data[:7])
                for frame in (stranger, cut):
                    bus.send(frame, timeout=1)
                    twin.receive_frame(frame)
            lockstep.settle({5})
            twin.settle()

    robot = "node --id 5 --b-hat 0.7 --comms-period 2 --filter-period 10 --neighbours 20 --steps 40"
    with join() as bus, meanwhile(lambda: drive(bus)):
        assert main([*robot.split(), "--json", "--log", str(log)]) == 0
    captured = capsys.readouterr()
    report, warning = json.loads(captured.out), "another node sends under this node's own id; give one of"
    assert captured.err.count(warning) == 1
    assert isinstance(twin.robot, FixedPointRobot)
    state = report["results"]["robot"]
    assert state["raw"] == {name: getattr(twin.robot, f"{name}_raw") for name in state["raw"]}
    assert state["counters"]["rejected"] == 3
    assert (report["results"]["ending"], report["results"]["steps"]) == ("all ticks done", 40)
    assert report["results"]["frames"] == {
        **{"estimates_sent": 20, "heartbeats_sent": 4, "telemetry_sent": 40, "delivered": 3, "refused": 3},
        **{"obeyed": 80, "disobeyed": 0, "unsettled": 0, "rejected": {"LENGTH": 3}, "id_conflicts": 3},
        "events": [{"event": "conflict", "sender": 5, "estimates": 3}],
    }
    assert report["parameters"]["robot"] == record(5, "native", 0.7, comms_period=2).plain()
    assert main(["replay", str(log)]) == 0
    assert "3  frames under a robot's id that it did not send" in capsys.readouterr().out


def test_suspicious_estimates_are_told_once_for_each_kind_and_sender(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Those of unknown ids are dropped; own ones are heard, whatever is allowed. A confidence may double when
    it is new or has fallen, but not after 32 rounds."""
    few, twice, many = (float32_bits(alpha) for alpha in (40.0, 80.0, 1e30))
    alphas = {6: [*range(few, few + 32), twice + 31, *[few] * 33, twice - 1], 7: [few, *[twice] * 32, many]}
    alphas |= {8: [*[twice] * 33, *[few] * 32, twice], 9: [twice, *[few] * 33, twice]}

    def drive(bus: can.BusABC) -> None:
        lockstep = Lockstep(bus, timeout=PATIENCE)
        lockstep.wait_until_up({5}, PATIENCE)
        for tick in range(70):
            lockstep.observe({5: WHITE})
            said = {each: bits[tick] for each, bits in alphas.items() if tick < len(bits)}
            for sender, bits in (said | dict.fromkeys((5, 30, 127), many)).items():
                bus.send(
                    encode_estimate(
                        Estimate(sender, 9, alpha_word_from_float32_bits(bits), tick % 32), FrameFormat()
                    ),
                    timeout=1,
                )
            lockstep.settle({5})

    with join() as bus, meanwhile(lambda: drive(bus)):
        words = ["--id", "5", "--allow", "6+7-9", "--filter", "none", "--steps", "70", "--json"]
        assert main(["node", *words]) == 0
    captured = capsys.readouterr()
    report = json.loads(captured.out)
    frames, counters = (report["results"][name] for name in ("frames", "robot"))
    told = {(each["event"], each["sender"]): each["estimates"] for each in frames["events"]}
    expected = {("conflict", 5): 70, ("unknown", 30): 70, ("unknown", 127): 70}
    expected |= {("jump", sender): 1 for sender in (6, 7, 9)}
    assert told == expected
    assert frames["delivered"] == 70 + sum(map(len, alphas.values()))
    assert counters["counters"]["accepted"] == sum(map(len, alphas.values()))
    assert report["parameters"]["robot"]["allow"] == "6-9"
    lines = [line for line in captured.err.splitlines() if ": node " in line]
    assert {*lines} == {
        f"mcp-asdf node: node {sender}: {MEANINGS[Suspicion(kind)]}" for kind, sender in expected
    }
    assert len(lines) == len(expected)


ENDINGS = {"": signal.SIGINT, "--steps 100000": signal.SIGTERM, "--until-eof": None}


@pytest.mark.parametrize("options", ENDINGS)
@interruptible()
def test_it_ends_when_asked_to_with_all_saved(
    options: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """It is asked by a signal or the end of its input; input that can be read is no end."""
    number, (reading, writing) = ENDINGS[options], os.pipe()
    handlers = [signal.getsignal(each) for each in ENDING_SIGNALS]

    def end_it(bus: can.BusABC) -> None:
        os.write(writing, b"something")
        lockstep = Lockstep(bus, timeout=PATIENCE)
        lockstep.wait_until_up({3}, PATIENCE)
        lockstep.observe({3: BLACK})
        lockstep.settle({3})
        os.kill(os.getpid(), number or 0)
        os.close(writing)

    words = ["node", "--id", "3", *options.split(), "--log", f"{tmp_path}/run.log"]
    with os.fdopen(reading) as stdin, join() as bus, meanwhile(lambda: end_it(bus)):
        monkeypatch.setattr("sys.stdin", stdin)
        assert main(words) == (128 + number if number is not None and "--steps" in options else 0)
    shown = " ".join(capsys.readouterr().out.split())
    assert "1 ticks as robot 3; stopped" in shown
    assert shlex.split(shown.partition("again: mcp-asdf ")[2]) == words
    assert main(["replay", f"{tmp_path}/run.log"]) == 0
    assert [signal.getsignal(each) for each in ENDING_SIGNALS] == handlers


BAD = {
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


@pytest.mark.parametrize("arguments", BAD)
def test_bad_usage(
    arguments: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["node", *shlex.split(arguments)]) == 2
    captured = capsys.readouterr()
    assert BAD[arguments] in captured.err
    assert captured.out == ""
    assert not list(tmp_path.iterdir())
