"""One robot on a bus: what it hears, says and reports, by either clock, and every way to end."""

from __future__ import annotations

import errno
import io
import json
import os
import random
import shlex
import signal
import time
from collections import deque
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import can
import pytest
from can.interfaces import virtual

from input_logs import input_log_in
from mcp_asdf.robot import FixedPointRobot, Observation
from mcp_asdf_tools.bus.frames import (
    COMMANDS,
    FrameFormat,
    Heartbeat,
    Message,
    Telemetry,
    decode,
    decode_heartbeat,
    decode_telemetry,
    encode,
)
from mcp_asdf_tools.bus.interfaces import WithoutEcho
from mcp_asdf_tools.cli.main import main
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.common.signals import ENDING_SIGNALS
from mcp_asdf_tools.recording.frame_logs import read_log
from mcp_asdf_tools.recording.input_log import InputLogHeader, InputLogReader
from mcp_asdf_tools.robots.lockstep import Lockstep
from mcp_asdf_tools.robots.node import NodeSettings, RobotNode, filters_for, send_all
from mcp_asdf_tools.robots.node_run import BusLink, NodeRun
from mcp_asdf_tools.robots.observations import LineSource, WorldSource
from mcp_asdf_tools.world.settings import WorldSettings
from mcp_asdf_tools.world.world import World
from node_thread import join, meanwhile, node_in_a_thread
from robots import ALPHA_ONE
from support import PATIENCE, interruptible
from wire import node, record

WHITE, BLACK = Observation


@pytest.fixture(autouse=True)
def private_setup(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[None]:
    """Keep the user's bus configuration out, and fail if a test leaves a bus open."""
    for name in [name for name in os.environ if name.startswith("CAN_")]:
        monkeypatch.delenv(name)
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setattr(can, "rc", {})
    yield
    assert not virtual.channels


def estimates(frames: list[can.Message], sender: int) -> list[Message]:
    decoded = [decode(frame, FrameFormat()) for frame in frames]
    return [each for each in decoded if isinstance(each, Message) and each.sender == sender]


# Observations


def test_the_world_shows_a_robot_what_it_shows_it_in_any_swarm() -> None:
    world = World(WorldSettings(robots=9, fill_ratio=0.3, true_accuracy=0.8, seed=77))
    source = WorldSource(5, 0.3, 0.8, 77)
    assert [source.next(0) for _ in range(3000)] == [world.step()[5] for _ in range(3000)]


@pytest.mark.parametrize("bad", [(1.5, 0.9, 1), (0.5, -0.1, 1), (0.5, 0.9, -1)])
def test_a_world_that_cannot_be(bad: tuple[float, float, int]) -> None:
    with pytest.raises(UsageError):
        WorldSource(0, *bad)


def test_lines_are_taken_as_they_come(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    # The reading end is opened first so that opening it does not wait.
    reading = os.open(tmp_path / "pipe", os.O_RDONLY | os.O_NONBLOCK)
    writing = os.open(tmp_path / "pipe", os.O_WRONLY)
    source = LineSource(str(tmp_path / "pipe"))
    os.close(reading)
    with pytest.raises(TimeoutError):
        source.next(0)
    os.write(writing, b"0\n1")
    assert source.next(1) is WHITE
    with pytest.raises(TimeoutError):
        source.next(0)
    os.write(writing, b"\n-\r\n 1 \n0")
    assert [source.next(1) for _ in range(3)] == [BLACK, None, BLACK]
    with pytest.raises(TimeoutError):
        source.next(0)
    os.close(writing)
    assert source.next(1) is WHITE  # without its end
    for _ in range(2):
        with pytest.raises(EOFError):
            source.next(1)
    source.close()


@pytest.mark.parametrize("line", ["2", "", "01", "x", "é"])
def test_what_is_no_observation(line: str, tmp_path: Path) -> None:
    (tmp_path / "lines").write_text(f"0\n{line}\n1\n")
    source = LineSource(str(tmp_path / "lines"))
    assert source.next(0) is WHITE
    with pytest.raises(UsageError, match=f"lines, line 2: '{line}' is no observation; give 0"):
        source.next(0)
    source.close()


def test_observations_that_cannot_be_read(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"cannot read observations from .*absent"):
        LineSource(str(tmp_path / "absent"))
    source = LineSource(str(tmp_path))
    with pytest.raises(UsageError, match="Is a directory"):
        source.next(0)
    source.close()


# Filters and sending


def test_filters_pass_what_decoders_may_accept_and_nothing_else() -> None:
    draw = random.Random(6)
    subjects = FrameFormat(3000), COMMANDS
    with can.Bus(interface="virtual", channel="filters", ignore_config=True) as bus:
        bus.set_filters(filters_for(*subjects))
        passed = 0
        for _ in range(20_000):
            identifier = draw.choice([draw.randrange(1 << 29), 0x106BB82A ^ 1 << draw.randrange(29)])
            frame = can.Message(arbitration_id=identifier, data=b"\0\0\0\0\0\0\0\xe0")
            frame.is_extended_id = identifier > 0x7FF
            wanted = any(isinstance(decode(frame, subject), Message) for subject in subjects)
            assert bus._matches_filters(frame) == wanted, "replay: random.Random(6)"
            passed += wanted
    assert passed > 1000


class Full:
    """A bus whose send queue has room for one frame in three."""

    def __init__(self, code: int = errno.ENOBUFS) -> None:
        self.sent: list[can.Message] = []
        self._code = code
        self._tries = 0

    def send(self, frame: can.Message, timeout: float) -> None:
        self._tries += 1
        if self._tries % 3:
            raise can.CanOperationError("no room", self._code)
        self.sent.append(frame)


def test_a_full_send_queue_is_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    frames = [can.Message(arbitration_id=n) for n in range(50)]
    bus = Full()
    send_all(bus, frames, 10)  # type: ignore[arg-type]
    assert bus.sent == frames
    with pytest.raises(can.CanOperationError, match="no room"):
        send_all(Full(errno.ENETDOWN), frames, 10)  # type: ignore[arg-type]
    monkeypatch.setattr(time, "sleep", lambda seconds: None)
    with pytest.raises(can.CanTimeoutError, match="the bus took no frame for 0 s"):
        send_all(Full(), frames, 0)  # type: ignore[arg-type]


class Echoing(can.BusABC):
    """A connection to a bus of which everybody gets every frame, the sender too."""

    everybody: list[Echoing]

    def __init__(self, everybody: list[Echoing]) -> None:
        super().__init__(channel="echo")
        self.channel_info = "echo"
        self._waiting: deque[can.Message] = deque()
        self.everybody = everybody
        everybody.append(self)

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        for each in self.everybody:
            each._waiting.append(msg)

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        return (self._waiting.popleft() if self._waiting else None), False

    def fileno(self) -> int:
        return 99


def test_no_node_hears_itself_on_a_bus_that_echoes() -> None:
    everybody: list[Echoing] = []
    connections = [WithoutEcho(Echoing(everybody)) for _ in range(3)]
    draw, heard, due = random.Random(2), [[], [], []], [[], [], []]  # type: ignore[var-annotated]
    for _ in range(2000):
        place = draw.randrange(3)
        if draw.random() < 0.5:
            # Contents come again and again, also from others at the same time.
            frame = can.Message(arbitration_id=draw.randrange(2), data=bytes([draw.randrange(2)]))
            connections[place].send(frame, timeout=1)
            for other in {0, 1, 2} - {place}:
                due[other].append((frame.arbitration_id, bytes(frame.data)))
        frame_or_none = connections[place].recv(0)
        if frame_or_none is not None:
            heard[place].append((frame_or_none.arbitration_id, bytes(frame_or_none.data)))
    for place, connection in enumerate(connections):
        heard[place] += [(f.arbitration_id, bytes(f.data)) for f in iter(lambda: connection.recv(0), None)]  # noqa: B023
        assert sorted(heard[place]) == sorted(due[place]), "replay: random.Random(2)"
        assert connection.fileno() == 99
        connection.shutdown()


# Real time


class Scripted(can.BusABC):
    """A bus that hands over given frames at once, notes what is sent and fails when asked to."""

    def __init__(self, *frames: can.Message, fails: Callable[[int], bool] = lambda number: False) -> None:
        super().__init__(channel="script")
        self.frames = deque(frames)
        self.tried: list[can.Message] = []
        self.sent: list[can.Message] = []
        self._fails = fails

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        self.tried.append(msg)
        if self._fails(len(self.tried)):
            raise can.CanOperationError("the interface is down", errno.ENETDOWN)
        self.sent.append(msg)

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        if self._fails(len(self.tried)):
            raise can.CanOperationError("the interface is down", errno.ENETDOWN)
        if not self.frames:
            time.sleep(timeout or 0)
        return (self.frames.popleft() if self.frames else None), True

    def __del__(self) -> None:
        """Nothing to close."""


def lines(tmp_path: Path, text: str) -> LineSource:
    (tmp_path / "lines").write_text("\n".join(text))
    return LineSource(str(tmp_path / "lines"))


def fast(telemetry_period: int = 0) -> RobotNode:
    """Robot 5."""
    settings = NodeSettings(5, steps_per_second=2000, telemetry_period=telemetry_period)
    return RobotNode(record(5).make(), settings)


def test_a_tick_lasts_until_the_next(tmp_path: Path) -> None:
    heard = [encode(Message(9, 1 << 21, ALPHA_ONE, n), FrameFormat()) for n in range(3)]
    for frame in heard:
        frame.is_rx = True
    heard.insert(1, encode(Message(8, 1 << 21, ALPHA_ONE, 0), FrameFormat()))  # its own, says the driver
    source, bus = lines(tmp_path, "110-0"), Scripted(*heard)
    run = NodeRun(fast(telemetry_period=2), BusLink(bus))
    run.in_real_time(source)
    source.close()
    assert run.outcome.ending == "the observations ended"
    assert (run.node.ticks, run.node.is_settled) == (5, True)
    assert (run.node.robot.t, run.node.robot.n) == (4, 2)
    # All came in the first tick: one counts.
    assert (run.node.robot.counters.accepted, run.node.robot.counters.repeated) == (1, 2)
    assert [m.transfer_id for m in estimates(bus.sent, 5)] == list(range(5))
    assert isinstance(decode_heartbeat(bus.sent[0]), Heartbeat)
    assert sum(isinstance(decode_telemetry(frame), Telemetry) for frame in bus.sent) == 2
    assert run.outcome.lateness is not None


def test_the_first_ticks_are_enough_when_so_many_are_asked_for(tmp_path: Path) -> None:
    source = lines(tmp_path, "1" * 100)
    run = NodeRun(fast(), BusLink(Scripted()), ticks=7)
    run.in_real_time(source)
    source.close()
    assert (run.node.robot.t, run.outcome.ending) == (7, "all ticks done")


def test_a_robot_goes_on_when_its_bus_fails_and_a_replay_knows(tmp_path: Path) -> None:
    """Frames 5 to 20 are not taken, and nothing is received meanwhile."""
    from mcp_asdf_tools.recording.replay import verify  # noqa: PLC0415

    log: list[can.Message] = []
    bus = Scripted(fails=lambda number: 5 <= number <= 20)
    header = InputLogHeader([record(5)], None, FrameFormat())
    with input_log_in(tmp_path / "events", header) as writer:
        source = lines(tmp_path, "10" * 20)
        robot = RobotNode(record(5).make(), NodeSettings(5, steps_per_second=2000), writer.robots[5])
        run = NodeRun(robot, BusLink(bus, endures=True, log=log.append))
        run.in_real_time(source)
        source.close()
    assert (run.node.robot.t, run.outcome.has_failed) == (40, False)
    assert run.link.failures >= 16
    assert run.link.last_failure == "the interface is down [Error Code 100]"
    lost = sum(isinstance(decode(frame, FrameFormat()), Message) for frame in bus.tried[4:20])
    with InputLogReader(tmp_path / "events") as input_log:
        verdict = verify(log, input_log)
    assert (verdict.reproduced, verdict.not_logged, verdict.difference) == (40 - lost, 0, None)


def test_in_lockstep_a_failing_bus_is_the_end() -> None:
    run = NodeRun(node(5), BusLink(Scripted(fails=lambda number: number == 1)))
    run.in_lockstep()
    assert run.outcome.has_failed
    assert run.outcome.ending == "the bus failed: the interface is down [Error Code 100]"


# The command


def report_of(capsys: pytest.CaptureFixture[str]) -> dict[str, Any]:
    report: dict[str, Any] = json.loads(capsys.readouterr().out)
    return report


def test_nodes_that_hear_each_other_are_reproduced_from_their_logs(tmp_path: Path) -> None:
    """Each in a thread with a clock of its own, for long enough to filter several times."""
    logs = [tmp_path / f"{robot}.log" for robot in (3, 4)]
    common = "--steps-per-second 400 --filter-period 20 --fill-ratio 0.9"
    with node_in_a_thread(f"--id 4 --b-hat 0.95 --log {logs[1]} {common}"):
        words = f"node --id 3 --b-hat 0.55 --steps 150 --quiet --log {logs[0]} {common}"
        assert main(shlex.split(words)) == 0
    for robot, log in zip((3, 4), logs, strict=True):
        results = json.loads(Path(f"{log}.json").read_text())["results"]
        assert results["frames"]["delivered"] > 0
        assert results["frames"]["id_conflicts"] == {}
        assert len(estimates(list(read_log(log)), robot)) == results["steps"] >= 5
        assert main(["replay", str(log)]) == 0


def test_a_driven_node_reports_what_its_robot_is(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    log, twin = tmp_path / "run.log", node(5, "mirror", 0.7, comms_period=2)

    def drive() -> None:
        with join() as bus:
            lockstep = Lockstep(bus, timeout=PATIENCE)
            lockstep.wait_until_up({5}, PATIENCE)
            for tick in range(40):
                z = (WHITE, BLACK, None)[tick * tick % 3]
                lockstep.observe({5: z})
                twin.observe(z)
                if tick % 2:
                    said = lockstep.estimates({5})[5]
                    assert (said.x_hat, said.alpha) == (twin.robot.x_hat_raw, twin.robot.alpha_raw)  # type: ignore[attr-defined]
                answer = lockstep.settle({5})[5]
                twin.settle()
                assert answer.x == twin.robot.x_raw  # type: ignore[attr-defined]

    robot = "--id 5 --b-hat 0.7 --comms-period 2 --filter-period 10 --neighbours 20"
    with meanwhile(drive):
        code = main(["node", *shlex.split(robot), "--lockstep", "--steps", "40", "--json", "--log", str(log)])
    assert code == 0
    report = report_of(capsys)
    assert json.loads(Path(f"{log}.json").read_text()) == report
    assert isinstance(twin.robot, FixedPointRobot)
    raw = report["results"]["robot"]["raw"]
    assert raw == {name: getattr(twin.robot, f"{name}_raw") for name in raw}
    assert report["results"]["ending"] == "all ticks done"
    assert report["results"]["lateness"] is None
    assert report["results"]["frames"]["obeyed"] == 80
    assert report["parameters"]["robot"] == record(5, "native", 0.7, comms_period=2).plain()
    assert main(["replay", str(log)]) == 0


@interruptible()
def test_another_node_with_this_id_is_reported_and_no_trouble_for_a_replay(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    log = tmp_path / "run.log"

    def impersonate() -> None:
        with join() as bus:
            while estimates([frame] if (frame := bus.recv(PATIENCE)) else [], 3) == []:
                pass
            for number in range(3):
                bus.send(encode(Message(3, number, 0, number), FrameFormat()), timeout=1)
            for _ in range(5):  # ticks in which it hears that
                assert bus.recv(PATIENCE) is not None
        os.kill(os.getpid(), signal.SIGINT)

    with meanwhile(impersonate):
        assert main(["node", *shlex.split("--id 3 --steps-per-second 100 --log"), str(log)]) == 0
    captured = capsys.readouterr()
    warning = "another node sends under this node's own id: 3; give one of them another"
    assert captured.err.count(warning) == 1
    assert warning in " ".join(captured.out.split())
    assert json.loads(Path(f"{log}.json").read_text())["results"]["robot"]["counters"]["rejected"] == 3
    assert main(["replay", str(log)]) == 0
    assert "3  frames under a robot's id that it did not send" in capsys.readouterr().out


@pytest.mark.parametrize("number", ENDING_SIGNALS)
@pytest.mark.parametrize(("ticks", "is_early"), [("", False), ("--steps 100000", True)])
@interruptible()
def test_signals_end_it_with_all_saved(
    number: signal.Signals, ticks: str, is_early: bool, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    log, handlers = tmp_path / "run.log", [signal.getsignal(each) for each in ENDING_SIGNALS]

    def end_it() -> None:
        with join() as bus:
            for _ in range(5):
                assert bus.recv(PATIENCE) is not None
        os.kill(os.getpid(), number)

    with meanwhile(end_it):
        assert (
            main(["node", *shlex.split(f"--id 3 --steps-per-second 50 {ticks} --json --log"), str(log)])
            == (128 + number) * is_early
        )
    assert report_of(capsys)["results"]["ending"] == "stopped"
    assert main(["replay", str(log)]) == 0
    assert [signal.getsignal(each) for each in ENDING_SIGNALS] == handlers


def test_it_ends_with_its_standard_input_if_asked_to(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    reading, writing = os.pipe()
    monkeypatch.setattr("sys.stdin", stdin := os.fdopen(reading))

    def end_it() -> None:
        os.write(writing, b"something to read is no end\n")
        with join() as bus:
            for _ in range(5):
                assert bus.recv(PATIENCE) is not None
        os.close(writing)

    with meanwhile(end_it):
        assert main(["node", "--id", "3", "--steps-per-second", "50", "--until-eof", "--json"]) == 0
    assert report_of(capsys)["results"]["steps"] >= 4
    stdin.close()


def test_the_summary_says_what_to_type_for_the_same_again(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    (tmp_path / "lines").write_text("1\n0\n1\n")
    words = ["--id", "9", "--b-hat", "0.30000000000000004", "--observations", str(tmp_path / "lines")]
    words += shlex.split(
        "--steps-per-second 500 --memory 64 --activation always --firmware mirror --subject 5 --priority 1"
    )
    assert main(["node", *words]) == 0
    shown = " ".join(capsys.readouterr().out.split())
    again = shlex.split(shown.partition("again: mcp-asdf ")[2])
    reports = []
    for arguments in (["node", *words], again):
        assert main([*arguments, "--json"]) == 0
        report = report_of(capsys)
        del report["results"]["lateness"]
        reports.append(report)
    assert reports[0] == reports[1]
    assert reports[0]["results"]["robot"]["t"] == 3


def test_nothing_is_printed_if_asked_for_quiet(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["node", "--id", "3", "--steps", "2", "--steps-per-second", "100", "--quiet"]) == 0
    assert capsys.readouterr() == ("", "")


BAD = {
    "": "--id",
    "--id 128": "robot id is 128; choose 0 .. 127",
    "--id -1": "robot id is -1",
    "--id 1 --b-hat 1.5": "b_hat is 1.5",
    "--id 1 --memory 66": "memory is 66; choose a multiple of 4",
    "--id 1 --comms-period 3": "filter_period is 1000; choose a multiple of comms_period 3",
    "--id 1 --comms-period 0": "comms_period is 0",
    "--id 1 --omega 0.95": "omega is 0.95",
    "--id 1 --neighbours 128": "the number of neighbours is 128",
    "--id 1 --filter some": "some",
    "--id 1 --filter none --omega 0.1": "the robot runs no test: leave out --omega",
    "--id 1 --activation always --neighbours 30": "leave out --omega and --neighbours",
    "--id 1 --firmware own": "own",
    "--id 1 --steps-per-second 0": "steps-per-second is 0; it must be 1 to 10000",
    "--id 1 --steps 0": "steps is 0",
    "--id 1 --telemetry-period -1": "telemetry-period is -1",
    "--id 1 --subject 6144": "subject is 6144",
    "--id 1 --priority 8": "priority is 8",
    "--id 1 --telemetry-subject 3000": "the subjects [3000, 3000, 3002]; choose three different ones",
    "--id 1 --fill-ratio 2": "fill_ratio is 2.0",
    "--id 1 --observations absent": "cannot read observations from absent",
    "--id 1 --observations bad": "bad, line 1: 'white' is no observation",
    "--id 1 --observations bad --lockstep": "leave out --observations",
    "--id 1 --observations - --until-eof": "leave out --until-eof",
    "--id 1 --log run.db": "cannot log to run.db: choose .log",
    "--id 1 --log no/such/run.log": "cannot write no/such/run.log: its folder does not exist",
    "--id 1 --interface nonsense": "nonsense",
    "--id 1 --interface slcan --channel socket://127.0.0.1:1": "cannot open the bus slcan socket://127.0.0.1:1",
}


@pytest.mark.parametrize("arguments", BAD)
def test_bad_usage(
    arguments: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "bad").write_text("white\n")
    assert main(["node", *shlex.split(arguments)]) == 2
    captured = capsys.readouterr()
    assert BAD[arguments] in captured.err
    assert captured.out == ""
    assert [path.name for path in tmp_path.iterdir()] == ["bad"]


@pytest.mark.parametrize("obstructed", ["run.log", "run.log.events", "run.log.json"])
def test_what_cannot_be_written_is_told_before_the_first_tick(
    obstructed: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(NodeRun, "in_real_time", lambda self, source: pytest.fail("it ran"))
    (tmp_path / obstructed).mkdir()
    assert main(["node", "--id", "3", "--steps", "1", "--log", f"{tmp_path}/run.log"]) == 2
    assert f"cannot write {tmp_path / obstructed}: it is not a regular file" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == [obstructed]


def test_results_that_fail_at_the_end_cost_neither_the_summary_nor_the_log(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(NodeRun, "in_real_time", lambda self, source: (tmp_path / "run.log.json").mkdir())
    assert main(["node", "--id", "3", "--steps", "1", "--log", f"{tmp_path}/run.log"]) == 2
    out, err = capsys.readouterr()
    assert "0 ticks as robot 3" in out
    assert f"cannot write {tmp_path}/run.log.json" in err
    assert {path.name for path in tmp_path.iterdir()} == {"run.log", "run.log.events", "run.log.json"}


@pytest.mark.parametrize("option", ["--until-eof", "--observations=-"])
def test_without_a_standard_input_nothing_can_read_it(
    option: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    for stdin in (None, io.StringIO()):
        monkeypatch.setattr("sys.stdin", stdin)
        assert main(["node", "--id", "1", option]) == 2
        assert "there is no standard input" in capsys.readouterr().err


def test_a_missing_vcan_is_told_how_to_make(capsys: pytest.CaptureFixture[str]) -> None:
    """Either this kernel has no CAN or it only lacks the interface."""
    assert main(shlex.split("node --id 1 --interface socketcan --channel vcan97")) == 2
    shown = capsys.readouterr().err
    assert "modprobe vcan && ip link add dev vcan97 type vcan && ip link set vcan97 up" in shown
    assert main(shlex.split("node --id 1 --interface socketcan --channel can97")) == 2
    assert "modprobe can-raw && ip link set can97 up type can bitrate 500000\n" in capsys.readouterr().err


def test_an_interface_of_a_variable_that_does_not_exist(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("CAN_INTERFACE", "socketcann")
    assert main(["node", "--id", "1"]) == 2
    assert "there is no such interface; choose one of canalystii," in capsys.readouterr().err
