"""The neighbours of a real controller: a swarm with a gap, and a judge who finds every wrong controller."""

from __future__ import annotations

import json
import os
import random
import shlex
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, cast

import can
import pytest
from can.interfaces import virtual

from mcp_asdf.robot import Filter, FixedPointRobot, Observation, Status
from mcp_asdf_tools.bus.frames import (
    EVERY_ROBOT,
    ONE,
    Action,
    FrameFormat,
    Message,
    Rejection,
    alpha_bits,
    bits_of,
    decode,
    decode_command,
    encode,
    word_of,
)
from mcp_asdf_tools.cli.main import main
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.radio.invalid_frames import malformed, stray_commands
from mcp_asdf_tools.radio.neighbourhood import Neighbourhood, RadioSettings, choose_ids, configured_like
from mcp_asdf_tools.radio.real_time import RadioRun
from mcp_asdf_tools.radio.verification import PHASES, ControllerBench, ControllerVerdict, Phase, Verification
from mcp_asdf_tools.radio.verification_report import headline, markdown
from mcp_asdf_tools.recording.frame_logs import read_log
from mcp_asdf_tools.robots.lockstep import Lockstep
from mcp_asdf_tools.robots.node import NodeSettings, RobotNode, Subjects
from mcp_asdf_tools.robots.node_run import BusLink
from mcp_asdf_tools.robots.processes import start_nodes
from mcp_asdf_tools.robots.record import RobotRecord
from mcp_asdf_tools.swarm.fault_spec import parse_fault
from mcp_asdf_tools.swarm.medium import Wiring
from mcp_asdf_tools.swarm.settings import SwarmSettings
from mcp_asdf_tools.swarm.swarm import Swarm
from mcp_asdf_tools.world.world import World
from multicast import multicast
from node_thread import join, meanwhile, node_in_a_thread
from support import PATIENCE
from wire import Wire, record, still

ID = 3
TICKS = 25


@pytest.fixture(autouse=True)
def private_setup(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[None]:
    """Keep the user's bus configuration out, and fail if a test leaves a bus open."""
    for name in [name for name in os.environ if name.startswith("CAN_")]:
        monkeypatch.delenv(name)
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setattr(can, "rc", {})
    yield
    assert not virtual.channels


def settings(controller: RobotRecord | None = None, faults: str = "", **world: Any) -> RadioSettings:
    """A controller, robot 3, among robots 0, 1, 2 and 4."""
    own = controller or record(ID, "mirror", 0.55)
    neighbours = tuple(configured_like(own, robot, 0.95) for robot in choose_ids(own.id, 4))
    return RadioSettings(
        own,
        neighbours,
        SwarmSettings(robots=5, **{"seed": 6} | world),
        Subjects(),
        tuple(parse_fault(text) for text in faults.split()),
    )


# Neighbours


def test_a_controller_among_its_neighbours_is_a_robot_in_a_swarm() -> None:
    """Robot 3 lives outside; all five end with the same bits as in an emulated swarm."""
    world = SwarmSettings(robots=5, flawed=0.6, steps=120, filter_period=20, seed=9, fill_ratio=0.9)
    records = world.records()
    others = tuple(each for each in records if each.id != ID)
    neighbourhood = Neighbourhood(RadioSettings(records[ID], others, world, Subjects()))
    controller = RobotNode(records[ID].make(), NodeSettings(ID))
    for _ in range(120):
        for frame in neighbourhood.finish(controller.observe(neighbourhood.begin())):
            controller.hear(frame)
        controller.settle()
    with Swarm(world, Wiring(lambda robot: can.Bus("s", "virtual"))) as swarm:
        for _ in range(120):
            swarm.tick()
        expected = {each.id: state(each.robot) for each in swarm.nodes}
    alone = {robot: state(each.robot) for robot, each in (neighbourhood.nodes | {ID: controller}).items()}
    assert alone == expected
    assert any(each["updates"] for each in expected.values())


def state(robot: object) -> dict[str, int]:
    assert isinstance(robot, FixedPointRobot)
    return robot.state() | {"updates": robot.counters.updates}


def test_a_controller_hears_and_is_heard_in_range_only() -> None:
    ids = (3, 10, 11, 40, 90)
    own = record(ID)
    world = SwarmSettings(robots=5, topology="dynamic", seed=4)
    neighbourhood = Neighbourhood(
        RadioSettings(own, tuple(configured_like(own, robot, 0.9) for robot in ids[1:]), world, Subjects())
    )
    twin = World(world)
    seen: set[int] = set()
    for tick in range(300):
        z = neighbourhood.begin()
        assert z == twin.step()[0]
        near = {ids[place] for place in twin.neighbours(0)}
        before = {robot: node.robot.counters.accepted for robot, node in neighbourhood.nodes.items()}
        frames = neighbourhood.finish([encode(Message(ID, 1, 0, tick % 32), FrameFormat())])
        estimates = [m for f in frames if isinstance(m := decode(f, FrameFormat()), Message)]
        assert {message.sender for message in estimates} == near
        for robot, node in neighbourhood.nodes.items():
            around = {ids[place] for place in twin.neighbours(ids.index(robot))}
            assert node.robot.counters.accepted - before[robot] == len(around)
        seen.add(len(near))
    assert len(seen) > 2


def test_crashed_neighbours_are_silent_and_rejoin_new_or_as_they_were() -> None:
    for rejoin in ("new", "restored"):
        neighbourhood = Neighbourhood(
            settings(faults=f"crash,robots=1,from=10,to=11,ticks=5,rejoin={rejoin}")
        )
        senders = []
        for _ in range(30):
            neighbourhood.begin()
            heard = [
                m for f in neighbourhood.finish([]) if isinstance(m := decode(f, FrameFormat()), Message)
            ]
            senders.append({message.sender for message in heard})
        assert [tick for tick in range(30) if 1 not in senders[tick]] == list(range(10, 15))
        assert neighbourhood.nodes[1].robot.t == (15 if rejoin == "new" else 25)
        assert neighbourhood.nodes[0].robot.t == 30


def test_ids_are_chosen_around_the_controller() -> None:
    assert choose_ids(3, 5) == (0, 1, 2, 4, 5)
    assert choose_ids(3, 5, 3) == (4, 5, 6, 7, 8)
    assert choose_ids(127, 126) == tuple(range(126))
    for count, first, text in (
        (0, 0, "robots is 1; from id 0"),
        (126, 0, "room for 2 to 126"),
        (3, 124, "room for 2 to 3"),
        (1, 126, "first-id is 126; it must be 0 to 125"),
        (1, -1, "first-id is -1"),
    ):
        with pytest.raises(UsageError, match=text):
            choose_ids(3, count, first)
    with pytest.raises(UsageError, match=r"two robots have one id among \[1, 1\]"):
        RadioSettings(record(1), (record(1),), SwarmSettings(robots=2), Subjects())


# Odd frames


def test_malformed_frames_are_no_estimates() -> None:
    draw, subjects, reasons = random.Random(1), Subjects(), set[Rejection]()
    for _ in range(200):
        for frame in malformed(draw, subjects, 9):
            verdict = decode(frame, subjects.estimates)
            assert isinstance(verdict, Rejection)
            assert isinstance(decode_command(frame, subjects.commands), Rejection)
            reasons.add(verdict)
    own_kind = {Rejection.MODE, Rejection.X, Rejection.B_HAT, Rejection.TARGET, Rejection.ACTION}
    assert reasons == set(Rejection) - own_kind - {Rejection.ERROR_FRAME, Rejection.FD_FRAME}


@pytest.mark.parametrize("tick", [0, 17, 2**32 - 1])
def test_stray_commands_are_not_obeyed(tick: int) -> None:
    draw = random.Random(2)
    robot = RobotNode(record(ID).make(), NodeSettings(ID))
    command = stray_commands(draw, Subjects().commands, 9, ID, tick)[5]  # observe, for robot 3
    robot.hear(command)
    for _ in range(200):
        for frame in stray_commands(draw, Subjects().commands, ID, 9, tick):
            assert robot.hear(frame) == []
    assert (robot.robot.t, robot.reception.rejected) == (1, {})


# The verdict


def judge(
    controller: RobotNode, plan: RadioSettings | None = None, phases: Sequence[Phase] = PHASES
) -> ControllerVerdict:
    """Verdict on a controller."""
    with still():
        return Verification(plan or settings(), ControllerBench(Wire(controller), TICKS, 0.05), phases).run()


def obedient(firmware: str = "native") -> RobotNode:
    return RobotNode(record(ID, firmware, 0.55).make(), NodeSettings(ID))


@pytest.mark.parametrize("firmware", ["native", "mirror"])
def test_a_right_controller_passes_every_phase(firmware: str) -> None:
    controller = obedient(firmware)
    verdict = judge(controller)
    assert verdict.has_passed, verdict
    assert len(verdict.phases) == len(PHASES)
    assert all(phase.ticks == phase.broadcasts == TICKS for phase in verdict.phases)
    unsettled = {"lost commands": (TICKS + 1) // 2}
    assert all(phase.answers == TICKS - unsettled.get(phase.name, 0) for phase in verdict.phases)
    assert verdict.repeated == 0
    assert all(phase.injected > 0 for phase in verdict.phases[1:])
    assert controller.robot.counters.updates > 0
    assert controller.robot.counters.rejected > 0
    assert verdict.other_frames == 1 + (len(PHASES) * TICKS - 1) // 10  # heartbeats
    assert (controller.traffic.disobeyed, controller.traffic.unsettled) == (4 * TICKS, (TICKS + 1) // 2)


@pytest.mark.parametrize(
    "config", [{"comms_period": 5}, {"filter": Filter.ALWAYS}, {"filter": Filter.OFF}, {"memory": 64}]
)
def test_other_configurations_pass(config: dict[str, Any]) -> None:
    own = record(ID, "native", 0.8, **config)
    verdict = judge(RobotNode(own.make(), NodeSettings(ID)), settings(own))
    assert verdict.has_passed, verdict
    assert verdict.phases[0].broadcasts == TICKS // config.get("comms_period", 1)


def test_own_faults_are_phases_more() -> None:
    plan = settings(faults="loss=0.7,receivers=3 liar,robots=1,x=0")
    verdict = judge(obedient(), plan, PHASES[:1])
    assert verdict.has_passed
    own = verdict.phases[1:]
    assert [phase.name for phase in own] == ["loss", "liar"]
    assert own[0].fault == "loss=0.7,receivers=3"
    assert all(phase.injected > 0 for phase in own)


def test_a_phase_in_which_nothing_happens_proves_nothing() -> None:
    verdict = judge(obedient(), settings(faults="loss=0"), PHASES[:2])
    assert not verdict.has_passed
    assert [phase.name for phase in verdict.phases if phase.outcome == "nothing happened"] == ["loss"]


@still()
def test_a_verification_may_be_stopped_between_two_ticks() -> None:
    controller, done = obedient(), list[int]()
    bench = ControllerBench(
        Wire(controller), TICKS, 0.05, progress=done.append, should_stop=lambda: len(done) == TICKS + 3
    )
    verdict = Verification(settings(), bench).run()
    assert (verdict.is_interrupted, verdict.has_passed, verdict.difference) == (True, False, None)
    assert [phase.ticks for phase in verdict.phases[:3]] == [TICKS, 3, 0]
    assert [phase.outcome for phase in verdict.phases[:3]] == ["passed", "not run", "not run"]
    assert (controller.ticks, controller.is_settled) == (TICKS + 3, True)


@still()
def test_commands_that_the_bus_loses_are_said_again_and_counted() -> None:
    """An observe and a settle of the first phase."""

    def is_command(frame: can.Message) -> bool:
        return not isinstance(decode_command(frame, Subjects().commands), Rejection)

    class Losing(Wire):
        orders = 0

        def send(self, msg: can.Message, timeout: float | None = None) -> None:
            self.orders += is_command(msg)
            if is_command(msg) and self.orders in (11, 21):
                self.sent.append(msg)
            else:
                super().send(msg, timeout)

    verdict = Verification(settings(), ControllerBench(Losing(obedient()), TICKS, 0.05)).run()
    assert verdict.has_passed, verdict
    assert verdict.repeated == 2
    assert headline(verdict.plain()).endswith("; 2 commands were repeated")
    assert "twice" not in headline(judge(obedient()).plain())


@still()
def test_a_bus_that_fails_ends_a_verification() -> None:
    class Failing(Wire):
        def send(self, msg: can.Message, timeout: float | None = None) -> None:
            if len(self.sent) == 100:
                raise can.CanOperationError("cable pulled")
            super().send(msg, timeout)

    verdict = Verification(settings(), ControllerBench(Failing(obedient()), TICKS, 0.05)).run()
    assert verdict.difference is not None
    assert "cable pulled" in verdict.difference


def test_neighbours_go_on_when_the_bus_fails() -> None:
    class Failing(Wire):
        def send(self, msg: can.Message, timeout: float | None = None) -> None:
            self.sent.append(msg)
            if len(self.sent) % 2:
                raise can.CanOperationError("cable pulled")

    plan = settings(steps_per_second=1000)
    run = RadioRun(Neighbourhood(plan), BusLink(Failing(), endures=True), ticks=20)
    run.run()
    figures = run.figures()
    assert (figures["steps"], figures["ending"]) == (20, "all ticks done")
    assert figures["bus_failures"] == figures["frames_sent"] == 4 * 21 // 2
    assert all(node.robot.t == 20 for node in run.neighbours.nodes.values())


# Wrong controllers, by what is wrong with them


class Controller(RobotNode):
    """A right one, for others to differ from."""

    def __init__(self) -> None:
        super().__init__(record(ID, "native", 0.55).make(), NodeSettings(ID))

    def give(self, message: Message, sender: int | None = None) -> Status:
        """Let the firmware have a message, under another id if one is given."""
        own = message.sender if sender is None else sender
        return cast(FixedPointRobot, self._bus_robot.robot).receive_raw(own, message.x_hat, message.alpha)

    def lenient(self, frame: can.Message) -> None:
        """Read an estimate out of anything of 8 bytes."""
        content = int.from_bytes(frame.data.ljust(8, b"\0"), "little")
        alpha = word_of(min(content >> 24 & 0x7FFF_FFFF, 0x7F7F_FFFF))
        self.give(Message(frame.arbitration_id & 0x7F, min(content & 0xFF_FFFF, ONE), alpha, 0))


class CountsRepeated(Controller):
    def _receive(self, message: Message) -> None:
        if self.give(message) == Status.REPEATED:
            self.give(message, 100 + message.sender % 20)


class HearsItself(Controller):
    def _receive(self, message: Message) -> None:
        self.give(message, 99 if message.sender == ID else None)


class StopsListening(Controller):
    """As with a receive buffer that is too small."""

    def __init__(self) -> None:
        super().__init__()
        self.room = 30

    def hear(self, frame: can.Message) -> list[can.Message]:
        self.room -= 1
        answers = super().hear(frame) if self.room > 0 or frame.arbitration_id >> 8 & 0x1FFF == 3002 else []
        self.room = 30 if answers else self.room
        return answers


def accepting(*reasons: Rejection) -> type[Controller]:
    """A controller whose codec lets through what it should reject for these reasons."""

    class Lax(Controller):
        def hear(self, frame: can.Message) -> list[can.Message]:
            if decode(frame, FrameFormat()) in reasons:
                self.lenient(frame)
                return []
            return super().hear(frame)

    return Lax


class SettlesInAnyTick(Controller):
    def _obey(self, command: Any) -> list[can.Message]:
        if command.action is Action.SETTLE and command.target in (ID, EVERY_ROBOT):
            self._tick_of_command = command.tick
        return super()._obey(command)


class StaysInATick(Controller):
    """Waits for the settle of the open tick, ignoring everything else."""

    def _obey(self, command: Any) -> list[can.Message]:
        is_stuck = not self.is_settled and command.tick != self._tick_of_command
        return [] if is_stuck else super()._obey(command)


class AnswersLate(Controller):
    """Answers a settle that has not come."""

    def observe(self, z: Observation | None) -> list[can.Message]:
        return ([] if self.is_settled else self.settle()) + super().observe(z)


class ForgetsARound(Controller):
    """Begins the next tick without ending the last."""

    def observe(self, z: Observation | None) -> list[can.Message]:
        self.is_settled = True
        return super().observe(z)


class ObeysOthers(Controller):
    def _obey(self, command: Any) -> list[can.Message]:
        return super()._obey(type(command)(command.sender, command.tick, ID, command.action, 0))


class ObservesTwice(Controller):
    def _obey(self, command: Any) -> list[can.Message]:
        is_repeated = not self.is_settled and command.tick == self._tick_of_command
        if is_repeated and command.action is not Action.SETTLE and command.target == ID:
            self._bus_robot._ticked.observe(command.action.observation)
        return super()._obey(command)


class CountsNothingAsWhite(Controller):
    def observe(self, z: Observation | None) -> list[can.Message]:
        return super().observe(Observation.WHITE if z is None else z)


class RoundsTelemetry(Controller):
    def settle(self) -> list[can.Message]:
        (frame,) = super().settle()
        frame.data[0] ^= 1
        return [frame]


class SendsMoreOfAlpha(Controller):
    """As its firmware has it before it is rounded to the grid."""

    def observe(self, z: Observation | None) -> list[can.Message]:
        frames = super().observe(z)
        frames[-1].data[3] |= alpha_bits(frames[-1]) < bits_of(0.25)
        return frames


class NumbersModulo16(Controller):
    def observe(self, z: Observation | None) -> list[can.Message]:
        frames = super().observe(z)
        frames[-1].data[7] &= 0xEF
        return frames


class SaysItTwice(Controller):
    def observe(self, z: Observation | None) -> list[can.Message]:
        frames = super().observe(z)
        return [*frames, frames[-1]]


class AnswersTwice(Controller):
    def settle(self) -> list[can.Message]:
        return super().settle() * 2


class Malformed(Controller):
    def observe(self, z: Observation | None) -> list[can.Message]:
        frames = super().observe(z)
        frames[-1].data[7] &= 0x3F
        return [*super().settle(), *frames] if self.ticks == 30 else frames


class HangsAfterAWhile(Controller):
    def hear(self, frame: can.Message) -> list[can.Message]:
        return super().hear(frame) if self.ticks < 100 else []


class ForgetsAfterAConflict(Controller):
    def _receive(self, message: Message) -> None:
        if message.sender == ID:
            self._bus_robot._drive(record(ID, "native", 0.55).make())
        super()._receive(message)


def _after_a_tick() -> RobotNode:
    controller = obedient()
    controller.observe(Observation.BLACK)
    controller.settle()
    return controller


LAX = {
    "x_hat above 1": (Rejection.X_HAT,),
    "alpha that is none": (Rejection.ALPHA,),
    "short frames": (Rejection.LENGTH,),
    "other tails": (Rejection.MULTI_FRAME,),
    "remote frames": (Rejection.REMOTE_FRAME,),
    "11-bit identifiers": (Rejection.STANDARD_ID,),
    "services": (Rejection.SERVICE,),
    "anonymous senders": (Rejection.ANONYMOUS,),
    "reserved bits": (Rejection.RESERVED_BITS,),
}
WRONG: dict[str, tuple[Callable[[], RobotNode], str, str]] = {
    "another b_hat": (
        lambda: RobotNode(record(ID, "native", 0.56).make(), NodeSettings(ID)),
        "nothing wrong",
        "estimate: the controller sent x_hat",
    ),
    "another period": (
        lambda: RobotNode(record(ID, "native", 0.55, comms_period=2).make(), NodeSettings(ID)),
        "nothing wrong",
        "robot 3 did not broadcast its estimate",
    ),
    "no test": (
        lambda: RobotNode(record(ID, "native", 0.55, filter=Filter.ALWAYS).make(), NodeSettings(ID)),
        "",
        "telemetry: the controller sent x",
    ),
    "another id": (
        lambda: RobotNode(record(4, "native", 0.55).make(), NodeSettings(4)),
        "nothing wrong",
        "robot 3 did not broadcast",
    ),
    "has run before": (
        _after_a_tick,
        "nothing wrong",
        "the controller sent x_hat 0x",
    ),
    "counts repeated messages": (CountsRepeated, "delay", "telemetry"),
    "hears itself": (HearsItself, "node-id conflict", "telemetry"),
    "forgets after a conflict": (ForgetsAfterAConflict, "node-id conflict", ""),
    "stops listening": (StopsListening, "flood", "telemetry"),
    "counts nothing as white": (CountsNothingAsWhite, "no observations", "estimate"),
    "rounds telemetry": (RoundsTelemetry, "nothing wrong", "telemetry: the controller sent x 0x"),
    "sends more of alpha": (SendsMoreOfAlpha, "nothing wrong", "estimate: the controller sent x_hat"),
    "numbers modulo 16": (NumbersModulo16, "nothing wrong", "transfer_id 0, the model x_hat"),
    "says it twice": (SaysItTwice, "nothing wrong", "estimate: the controller sent x_hat"),
    "answers twice": (AnswersTwice, "nothing wrong", "tick 1: telemetry: the controller sent x"),
    "malformed": (Malformed, "nothing wrong", "sent a malformed frame (not a single-frame transfer)"),
    "hangs": (HangsAfterAWhile, "silence", "tick 99: robot 3 did not settle"),
    "stays in a tick": (StaysInATick, "lost commands", "tick 426: robot 3 did not broadcast its estimate"),
    "answers late": (AnswersLate, "lost commands", "tick 426: robot 3 answered in tick 426 with transfer_id"),
    "forgets a round": (ForgetsARound, "lost commands", "telemetry"),
    "settles in any tick": (SettlesInAnyTick, "commands out of order", ""),
    "obeys others": (ObeysOthers, "commands out of order", ""),
    "observes twice": (ObservesTwice, "commands out of order", ""),
}


@pytest.mark.parametrize("what", WRONG)
def test_wrong_controllers_fail_where_they_are_wrong(what: str) -> None:
    make, phase, difference = WRONG[what]
    verdict = judge(make())
    assert not verdict.has_passed
    assert verdict.difference is not None
    assert verdict.difference.startswith(f'phase "{phase}')
    assert difference in verdict.difference
    outcomes = [each.outcome for each in verdict.phases]
    place = outcomes.index("failed")
    assert set(outcomes[:place]) <= {"passed"}
    assert set(outcomes[place + 1 :]) <= {"not run"}


def test_a_controller_that_closes_a_round_in_every_tick_fails() -> None:
    class ClosesEveryTick(RobotNode):
        def settle(self) -> list[can.Message]:
            self.robot.settle()
            return super().settle()

    own = record(ID, "native", 0.55, comms_period=5)
    assert judge(RobotNode(own.make(), NodeSettings(ID)), settings(own), PHASES[:1]).has_passed
    verdict = judge(ClosesEveryTick(own.make(), NodeSettings(ID)), settings(own), PHASES[:1])
    assert verdict.difference is not None
    assert verdict.difference.startswith('phase "nothing wrong", tick 4: telemetry')


@pytest.mark.parametrize("what", LAX)
def test_lax_codecs_fail(what: str) -> None:
    phases = [phase for phase in PHASES if phase.invalid == "malformed"]
    assert judge(obedient(), phases=phases).has_passed
    verdict = judge(accepting(*LAX[what])(), phases=phases)
    assert verdict.difference is not None
    assert verdict.difference.startswith('phase "malformed frames", tick 0: telemetry')


# The command


CONTROLLER = "--id 3 --b-hat 0.55 --filter-period 10 --neighbours 20"


def radio(options: str) -> int:
    return main(["radio", *shlex.split(options)])


def test_a_verification_leaves_a_report_and_a_log(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    report, log = tmp_path / "report.json", tmp_path / "run.log"
    options = f"{CONTROLLER} --verify --steps 20 --timeout 20 --json --report {report} --log {log}"
    with node_in_a_thread(f"{CONTROLLER} --lockstep"):
        assert radio(options) == 0
    content = json.loads(capsys.readouterr().out)
    assert json.loads(report.read_text()) == content
    assert content["verdict"]["passed"]
    assert [phase["name"] for phase in content["verdict"]["phases"]] == [phase.name for phase in PHASES]
    assert content["parameters"]["controller"] == record(3, "mirror", 0.55).plain()
    assert content["parameters"]["seed"] == 1
    assert content["model"]["t"] == 20 * (len(PHASES) - 1)  # one phase without observations
    assert main(["replay", str(log)]) == 0
    assert f"{20 * len(PHASES)}  broadcasts reproduced" in capsys.readouterr().out
    shown = markdown(content)
    for phase in content["verdict"]["phases"]:
        row = f"| {phase['name']} | {phase['fault'] or ''} | 20 | {phase['frames']} |"
        assert row in shown
    assert "**PASSED: 19 of 19 phases passed;" in shown


def test_a_wrong_controller_gives_exit_code_1_and_the_first_difference(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    report = tmp_path / "report.md"
    with node_in_a_thread(f"{CONTROLLER} --lockstep --b-hat 0.56"):
        assert radio(f"{CONTROLLER} --verify --steps 40 --timeout 20 --report {report}") == 1
    shown = " ".join(capsys.readouterr().out.split())
    assert 'FAILED: 0 of 19 phases passed; first in phase "nothing wrong", tick 0: estimate: the co' in shown
    assert "**FAILED: 0 of 19 phases passed" in report.read_text()
    assert "| nothing wrong |  | 0 | 38 | 0 | 0 | 0 | failed |" in report.read_text()
    assert "| silence | loss=1,receivers=3 | 0 | 0 | 0 | 0 | 0 | not run |" in report.read_text()


def test_a_controller_that_is_not_there(capsys: pytest.CaptureFixture[str]) -> None:
    assert radio("--id 3 --verify --timeout 0.05 --json") == 1
    verdict = json.loads(capsys.readouterr().out)["verdict"]
    assert verdict["difference"].startswith('phase "nothing wrong", tick 0: robot 3 did not broadcast')
    assert radio("--id 3 --verify --wait 0.05") == 1
    assert "robot 3 did not send a heartbeat within 0.05 s" in " ".join(capsys.readouterr().out.split())


@still()
def test_a_controller_may_be_started_afterwards() -> None:
    controller = obedient()
    wire = Wire(controller)  # it says at once that it is there
    assert (
        Verification(settings(), ControllerBench(wire, TICKS, 0.05, wait=0.05), PHASES[:2]).run().has_passed
    )
    wire = Wire()
    wire.nodes.append(obedient())
    verdict = Verification(settings(), ControllerBench(wire, TICKS, 0.05, wait=0.05), PHASES[:2]).run()
    assert verdict.difference is not None
    assert [phase.outcome for phase in verdict.phases] == ["failed", "not run"]


def test_a_process_is_verified_over_a_real_socket(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    choice, own = multicast(9), record(3, "native", 0.55)
    log = tmp_path / "run.log"
    with choice.open() as bus, start_nodes([own], lambda robot: choice, Subjects(), 10) as nodes:
        Lockstep(bus, check=nodes.check).wait_until_up({3}, PATIENCE)
        options = f"{CONTROLLER} --verify --steps 20 --timeout 30 --log {log}"
        assert radio(f"{options} {shlex.join(choice.arguments())}") == 0
    assert "PASSED: 19 of 19 phases passed" in capsys.readouterr().out
    assert nodes.reports[3]["results"]["steps"] == 20 * len(PHASES)
    assert main(["replay", str(log)]) == 0


def test_neighbours_in_real_time_hear_and_are_heard(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    log, node_log = tmp_path / "run.log", tmp_path / "node.log"
    node_options = f"--id 3 --steps-per-second 100 --telemetry-period 5 --log {node_log}"
    with node_in_a_thread(node_options), meanwhile(lambda: speak_as(1, 9)):
        code = radio(
            "--id 3 --robots 5 --steps-per-second 100 --steps 100 --fault loss=0.5,receivers=3 --json "
            f"--log {log}"
        )
    assert code == 0
    report = json.loads(capsys.readouterr().out)
    assert json.loads(Path(f"{log}.json").read_text()) == report
    results = report["results"]
    assert results["steps"] == 100
    assert results["estimates_heard"] > 0
    assert results["strangers"] == 1
    assert list(results["id_conflicts"]) == ["1"]
    lost = results["faults"][0]["injected"]
    assert results["frames_sent"] + lost == 4 * (100 + 1)  # with a heartbeat each
    heard = [m for f in read_log(node_log) if isinstance(m := decode(f, FrameFormat()), Message)]
    from_neighbours = [message for message in heard if message.sender in (0, 1, 2, 4)]
    assert from_neighbours
    assert main(["replay", str(node_log)]) == 0


def speak_as(*senders: int) -> None:
    """Let other nodes say something once the radio is at work."""
    with join() as bus:
        while (frame := bus.recv(PATIENCE)) is not None and frame.arbitration_id & 0x7F != 4:
            pass
        for sender in senders:
            bus.send(encode(Message(sender, 7, 0, 0), FrameFormat()), timeout=1)


BAD = {
    "": "--id",
    "--id 128": "robot id is 128",
    "--id 3 --robots 1": "robots is 1; from id 0 on there is room for 2 to 126",
    "--id 3 --robots 5 --first-id 123": "robots is 5; from id 123 on there is room for 2 to 4",
    "--id 3 --first-id 126": "first-id is 126; it must be 0 to 125",
    "--id 3 --steps 0": "steps is 0",
    "--id 3 --fill-ratio 1.5": "fill-ratio is 1.5",
    "--id 3 --steps-per-second 0": "steps-per-second is 0",
    "--id 3 --fault gremlin": "no kind is called 'gremlin'",
    "--id 3 --verify --fault collide": "fault collide needs the id",
    "--id 3 --topology dynamic --density -1": "--density is -1.0; it must be",
    "--id 3 --report x.md": "--report is for a verification",
    "--id 3 --timeout 2": "--timeout is for a verification",
    "--id 3 --verify --timeout 0": "timeout is 0.0",
    "--id 3 --verify --wait nan": "wait is nan",
    "--id 3 --verify --report x.txt": "report x.txt has no known format",
    "--id 126 --verify": "robot 126 has the id of the simulator",
    "--id 3 --log run.db": "SQLite",
    "--id 3 --command-subject 3000": "choose three different ones",
    "--id 3 --interface socketcan --channel vcan97": "ip link add dev vcan97 type vcan",
}


@pytest.mark.parametrize(
    ("options", "obstructed"),
    [
        ("--log run.log", "run.log"),
        ("--log run.log", "run.log.json"),
        ("--verify --log run.log", "run.log.events"),
        ("--verify --report report.md", "report.md"),
    ],
)
def test_what_cannot_be_written_is_told_before_the_first_tick(
    options: str,
    obstructed: str,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
) -> None:
    for kind in (RadioRun, Verification):
        monkeypatch.setattr(kind, "run", lambda self: pytest.fail("it ran"))
    monkeypatch.chdir(tmp_path)
    (tmp_path / obstructed).mkdir()
    assert radio(f"--id 3 {options}") == 2
    assert f"cannot write {obstructed}: it is not a regular file" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == [obstructed]


@pytest.mark.parametrize("arguments", BAD)
def test_bad_usage(
    arguments: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    assert radio(arguments) == 2
    assert BAD[arguments] in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []
