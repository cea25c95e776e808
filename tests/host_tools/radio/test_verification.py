"""The verdict on a controller: a right one passes, and every wrong one is found, with its cause."""

from __future__ import annotations

import json
import random
import re
import shlex
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import can
import pytest

from mcp_asdf.mirror import MirrorRobot, reestimate, rejects
from mcp_asdf.robot import Filter, Observation, Status
from mcp_asdf_tools.bus.frames import (
    Action,
    Command,
    FrameFormat,
    Heartbeat,
    Message,
    Rejection,
    decode_command,
    encode,
    encode_command,
    encode_heartbeat,
)
from mcp_asdf_tools.cli.main import main
from mcp_asdf_tools.radio.bench import BenchOptions
from mcp_asdf_tools.radio.neighbourhood import RadioSettings, choose_ids, configured_like
from mcp_asdf_tools.radio.phases import PHASES, Phase
from mcp_asdf_tools.radio.rounds import CRAFTED_SIZES, Update, update_of
from mcp_asdf_tools.radio.verification import ControllerVerdict, PhaseResult, Verification, markdown
from mcp_asdf_tools.robots.lockstep import Lockstep
from mcp_asdf_tools.robots.node import RobotNode, Subjects
from mcp_asdf_tools.robots.processes import NodeProcesses
from mcp_asdf_tools.robots.record import RobotRecord
from mcp_asdf_tools.swarm.fault_spec import parse_fault
from mcp_asdf_tools.swarm.settings import SwarmSettings
from multicast import multicast
from node_thread import node_in_a_thread
from support import PATIENCE, slow
from wire import EndlessWire, Wire, record, still
from wrong_robots import B_HAT, ID, WRONG, Wrong, right

pytestmark = pytest.mark.usefixtures("private_setup")

TICKS = 25
QUICK = tuple(phase for phase in PHASES if phase.name not in ("long run", "flood"))
"""All phases but the two that take long."""


def settings(controller: RobotRecord | None = None, faults: str = "", seed: int = 6) -> RadioSettings:
    """A controller, robot 3, among robots 0, 1, 2 and 4."""
    own = controller or right()
    neighbours = tuple(configured_like(own, robot, 0.95) for robot in choose_ids(own.id, 4))
    return RadioSettings(
        own,
        neighbours,
        SwarmSettings(robots=5, seed=seed),
        Subjects(),
        tuple(parse_fault(text) for text in faults.split()),
    )


def judge(
    controller: RobotNode | Wire,
    plan: RadioSettings | None = None,
    phases: Sequence[Phase] = PHASES,
    **options: Any,
) -> ControllerVerdict:
    """Verdict on a controller, by itself or on a wire."""
    return verification(controller, plan, phases, **options).verdict


def verification(
    controller: RobotNode | Wire,
    plan: RadioSettings | None = None,
    phases: Sequence[Phase] = PHASES,
    **options: Any,
) -> Verification:
    """A verification that is over."""
    wire = controller if isinstance(controller, Wire) else Wire(controller)
    with still():
        done = Verification(plan or settings(), BenchOptions(wire, TICKS, 0.05, **options), phases)
        done.run()
    return done


def obedient(firmware: str = "native", **config: Any) -> RobotNode:
    """A right controller."""
    return RobotNode(record(ID, firmware, B_HAT, **config))


# Right controllers


class WatchedMirror(MirrorRobot):
    """The model's firmware, which counts what a verification takes it through."""

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self.halvings = Counter[int]()
        self.tests_of, self.rejections = Counter[int](), Counter[int]()
        self.updates_of = Counter[Update]()
        self.senders, self.quiet_rounds, self.most_messages = set[int](), 0, 0

    def observe(self, z: Observation) -> Status:
        n, t = self.s.n + z, self.s.t
        status = super().observe(z)
        self.halvings[n % 4] += self.s.t < t
        return status

    def settle(self) -> Status:
        self.most_messages = max(self.most_messages, sum(word.bit_count() for word in self.s.heard))
        self.quiet_rounds += self.s.filter_left > 1 and self.would_reject()
        return super().settle()

    def _receive(self, sender: int, x_hat: int, alpha: int) -> Status:
        status = super()._receive(sender, x_hat, alpha)
        if status == Status.OK:
            self.senders.add(sender)
        return status

    def _filter(self) -> bool:
        s, tests, has_rejected = self.s, self.s.tests, self.would_reject()
        if has_rejected:
            self.updates_of[update_of(reestimate(s.t, s.n, s.closed))] += 1
        is_updated = super()._filter()
        self.tests_of[s.open.count] += s.tests != tests
        self.rejections[s.open.count] += has_rejected
        return is_updated

    def would_reject(self) -> bool:
        """True if a test now would lead to a re-estimate of b_hat, unless x_bar is 1/2."""
        s, table = self.s, self.config.table
        return table is not None and s.t > 0 and s.open.count > 1 and rejects(table, s.open, s.x_hat)


@pytest.mark.parametrize("memory", [2**31, 64])
def test_a_right_controller_passes_every_phase(memory: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """And is taken through all that the verdict claims."""
    monkeypatch.setattr("mcp_asdf_tools.radio.bench.MirrorRobot", WatchedMirror)
    controller = obedient(memory=memory)
    done = verification(controller, settings(right(memory=memory)))
    verdict, run = done.verdict, done.bench.firmware
    assert verdict.has_passed, verdict.headline
    left_out = ("no filter", "halvings" if memory > 64 else "long run")
    names = [phase.name for phase in PHASES if phase.name not in left_out]
    assert [phase.name for phase in verdict.phases] == names
    assert all(phase.broadcasts == phase.ticks >= phase.answers > 0 for phase in verdict.phases)
    assert all(phase.injected > 0 for phase in verdict.phases if phase.fault)
    assert (verdict.repeated, verdict.other_nodes, verdict.cause) == (0, [], None)
    assert verdict.latency_maximum >= verdict.latency_mean > 0
    ticks = sum(phase.ticks for phase in verdict.phases)
    equal = done.bench.comparison.equal
    assert (equal["estimate"], equal["heartbeat"]) == (ticks, (ticks - 1) // 10)
    assert isinstance(run, WatchedMirror)
    assert controller.robot.counters == run.counters
    assert run.s.t > 10_000 or all(run.halvings[n] > 0 for n in range(4))
    assert all(0 < run.rejections[m] < run.tests_of[m] for m in CRAFTED_SIZES)
    assert run.tests_of[1] == run.tests_of[0] == 0
    assert all(run.updates_of[update] > 0 for update in Update)
    assert run.senders == set(range(128)) - {ID}
    assert (run.most_messages, run.quiet_rounds > 0) == (126, True)


CONFIGS: list[dict[str, Any]] = [
    {"memory": 64},
    {"comms_period": 5},
    {"comms_period": 10},
    {"filter": Filter.ALWAYS, "table": None},
    {"filter": Filter.ALWAYS, "table": None, "comms_period": 5},
    {"filter": Filter.OFF, "table": None},
    {"filter_period": 1},
    {"filter_period": 2},
    {"filter_period": 997, "memory": 2048},
    {"filter_period": 600, "comms_period": 40},
]


@pytest.mark.parametrize("config", [CONFIGS[0], *slow(CONFIGS[1:])], ids=str)
def test_other_configurations_pass(config: dict[str, Any]) -> None:
    seed = random.randrange(2**32)
    verdict = judge(obedient(**config), settings(right(**config), seed=seed))
    assert verdict.has_passed, (seed, verdict.headline)


def test_a_fault_strikes_however_rarely_the_controller_broadcasts() -> None:
    """In a phase of 25 ticks without a broadcast a liar had said nothing."""
    config: dict[str, Any] = {"filter_period": 600, "comms_period": 40}
    verdict = judge(obedient(**config), settings(right(**config), seed=3548517347))
    assert verdict.has_passed, verdict.headline


@pytest.mark.slow
@pytest.mark.parametrize("robot", [0, 1, 125, 127])
def test_a_controller_with_any_id_passes(robot: int) -> None:
    own = record(robot, "native", B_HAT)
    verdict = judge(RobotNode(own), settings(own))
    assert verdict.has_passed, verdict.headline


@pytest.mark.slow
@pytest.mark.parametrize("b_hat", [2**-20, 0.02, 0.4999, 0.5, 0.75, 0.95, 1 - 2**-20])
def test_a_controller_with_any_b_hat_passes(b_hat: float) -> None:
    own, seed = record(ID, "native", b_hat), random.randrange(2**32)
    verdict = judge(RobotNode(own), settings(own, seed=seed), QUICK)
    assert verdict.difference is None, (seed, verdict.headline)
    assert verdict.not_exercised == [], seed


# What is put to the test


def test_own_faults_are_phases_more() -> None:
    verdict = judge(obedient(), settings(faults="loss=0.7,receivers=3 liar,robots=1,x=0"), PHASES[:1])
    assert [phase.name for phase in verdict.phases[1:]] == ["loss", "liar"]
    assert verdict.phases[1].fault == "loss=0.7,receivers=3"
    assert all(phase.injected > 0 and phase.outcome == "passed" for phase in verdict.phases[1:])


def test_a_fault_that_does_not_strike_proves_nothing() -> None:
    verdict = judge(obedient(), settings(faults="loss=0"), PHASES[:2])
    assert not verdict.has_passed
    assert [phase.name for phase in verdict.phases if phase.outcome == "not exercised"] == ["loss"]
    assert 'never put to the test: the fault of phase "loss"' in verdict.headline


def test_a_filter_that_comes_too_rarely_is_not_exercised() -> None:
    config: dict[str, Any] = {"filter_period": 10**6}
    verdict = judge(obedient(**config), settings(right(**config)), QUICK)
    assert verdict.not_exercised == ["the filter: its period is too long for a run"]
    assert not verdict.has_passed
    assert verdict.headline.startswith("NOT EXERCISED: ")


def test_what_was_not_checked_is_listed() -> None:
    assert judge(obedient(), phases=PHASES[:1]).not_checked[:3] == [
        "thresholds of rounds of other sizes than 2, 3, 5, 10, 30, 126",
        "rounds longer than a tick: it broadcasts in each",
        "forgetting: its memory is 2147483648, too long for a run",
    ]
    config: dict[str, Any] = {"filter": Filter.OFF, "table": None, "memory": 64, "comms_period": 5}
    assert judge(obedient(**config), settings(right(**config)), PHASES[:1]).not_checked[0] == (
        "the test and re-estimates: it does not filter"
    )


# Wrong controllers


def found(wrong: Wrong, seed: int = 6) -> ControllerVerdict:
    """The verdict on a wrong controller."""
    return judge(wrong.make(), settings(right(**wrong.config), seed=seed))


LATE = ("long run", "among neighbours")
"""Phases at the end of a run, which take long to reach."""


EARLY = [what for what, wrong in WRONG.items() if wrong.phase not in LATE]


SAMPLE = EARLY[::3]


@pytest.mark.parametrize("what", [*SAMPLE, *slow(sorted(WRONG.keys() - SAMPLE))])
def test_wrong_controllers_fail_where_they_are_wrong(what: str) -> None:
    wrong = WRONG[what]
    verdict = found(wrong)
    assert not verdict.has_passed
    assert verdict.difference is not None
    assert verdict.difference.startswith(f'phase "{wrong.phase}'), verdict
    outcomes = [each.outcome for each in verdict.phases]
    place = outcomes.index("failed")
    assert set(outcomes[:place]) <= {"passed"}
    assert set(outcomes[place + 1 :]) <= {"not run"}


def test_a_difference_says_what_was_expected_and_what_came() -> None:
    verdict = found(WRONG[">= instead of >"])
    assert verdict.cause == "its test rejects at equality: it compares with >= instead of >"
    assert verdict.difference is not None
    place, _, difference = verdict.difference.partition(": ")
    assert place.startswith('phase "own estimate" (messages equal to its own estimate), tick ')
    expected, got = re.findall(r"updates (\d+), ", difference)
    assert difference.startswith("telemetry, updates: expected ")
    assert int(got) == int(expected) + 1
    assert found(WRONG["eq. 8 in float32"]).cause is None  # the symptom leaves several causes


@pytest.mark.parametrize("seeds", [1, *slow([3])])
def test_wrong_controllers_are_found_with_any_seed(seeds: int) -> None:
    for seed in random.sample(range(2**32), seeds):
        for what in WRONG if seeds > 1 else random.sample(EARLY, 8):
            assert found(WRONG[what], seed).difference is not None, (seed, what)


# Others on the bus


class Talker(RobotNode):
    """Node with the id 40 that says something after each command."""

    def __init__(self, frame: can.Message) -> None:
        super().__init__(record(40))
        self.frame = frame

    def start(self) -> list[can.Message]:
        return []

    def hear(self, frame: can.Message) -> list[can.Message]:
        is_command = not isinstance(decode_command(frame, Subjects().commands), Rejection)
        return [self.frame] if is_command else []


def test_a_harmless_node_on_the_bus_is_named() -> None:
    talker = Talker(encode_heartbeat(Heartbeat(40, 7, 0)))
    verdict = judge(Wire(obedient(), talker), phases=PHASES[:2])
    assert (verdict.difference, verdict.disturbance) == (None, None)
    (line,) = verdict.other_nodes
    assert line.endswith(" frames of node 40")


@pytest.mark.parametrize(
    ("frame", "kind"),
    [
        (encode(Message(40, 1 << 22, 0x80000001, 0), FrameFormat()), "estimates"),
        (encode_command(Command(40, 1000, ID, Action.OBSERVE_BLACK, 0)), "commands"),
        (encode_command(Command(40, 1000, 255, Action.SETTLE, 0)), "commands"),
    ],
)
def test_a_node_that_the_controller_hears_is_named_and_not_blamed_on_it(
    frame: can.Message, kind: str
) -> None:
    verdict = judge(Wire(obedient(), Talker(frame)))
    assert not verdict.has_passed
    assert (verdict.difference, verdict.cause) == (None, None)
    assert verdict.disturbance is not None
    assert f"node 40 sends {kind} on this bus, too" in verdict.disturbance
    assert verdict.phases[0].outcome == "disturbed"
    assert verdict.headline.startswith("DISTURBED, no verdict: 0 of")


def test_a_command_of_a_node_for_another_is_harmless() -> None:
    talker = Talker(encode_command(Command(40, 1000, 77, Action.SETTLE, 0)))
    assert judge(Wire(obedient(), talker), phases=PHASES[:1]).difference is None


class Advises(RobotNode):
    """Says in its health that a tick stayed open, which is its right."""

    from_tick = 0

    def observe(self, z: Observation | None) -> list[can.Message]:
        frames = super().observe(z)
        for frame in frames[:-1]:
            frame.data[4] = int(self.unsettled > 0 or 0 < self.from_tick <= self.ticks)
        return frames


def test_a_controller_may_complain_of_ticks_left_open_and_of_nothing_else() -> None:
    assert judge(Advises(right()), phases=QUICK).difference is None
    controller = Advises(right())
    controller.from_tick = 30
    assert "heartbeat, health: expected" in str(judge(controller, phases=QUICK).difference)


def test_other_frames_of_the_controller_are_not_judged() -> None:
    class Publishes(RobotNode):
        def settle(self) -> list[can.Message]:
            own = can.Message(arbitration_id=4 << 26 | 3 << 21 | 7510 << 8 | ID, data=b"any")
            return [*super().settle(), own]

    verdict = judge(Publishes(right()), phases=PHASES[:1])
    assert verdict.difference is None
    assert verdict.other_frames == verdict.phases[0].ticks


# The bus


def test_a_verification_may_be_stopped_between_two_ticks() -> None:
    controller, done = obedient(), list[int]()
    verdict = judge(controller, progress=done.append, should_stop=lambda: len(done) == 75)
    assert (verdict.is_interrupted, verdict.has_passed, verdict.difference) == (True, False, None)
    assert [phase.ticks for phase in verdict.phases[:3]] == [72, 3, 0]
    assert [phase.outcome for phase in verdict.phases[:3]] == ["passed", "not run", "not run"]
    assert (controller.ticks, controller.is_settled) == (75, True)
    assert verdict.headline.startswith("INTERRUPTED: 1 of")


def test_a_verification_may_be_stopped_while_it_waits() -> None:
    verdict = judge(Wire(), wait=1e9, should_stop=lambda: True)
    assert (verdict.is_interrupted, verdict.difference) == (True, None)


def test_a_verification_may_be_stopped_while_others_talk() -> None:
    verdict = judge(EndlessWire(), wait=1e9, should_stop=lambda: True)
    assert (verdict.is_interrupted, verdict.difference) == (True, None)


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

    verdict = judge(Losing(obedient()), phases=PHASES[:3])
    assert verdict.difference is None
    assert verdict.repeated == 2
    assert verdict.headline.endswith("; 2 commands were repeated")


def test_a_bus_that_fails_is_not_blamed_on_the_controller() -> None:
    class Failing(Wire):
        def send(self, msg: can.Message, timeout: float | None = None) -> None:
            if len(self.sent) == 100:
                raise can.CanOperationError("cable pulled")
            super().send(msg, timeout)

    verdict = judge(Failing(obedient()))
    assert verdict.difference is not None
    assert "cable pulled" in verdict.difference
    assert verdict.cause == "the connection to the bus failed, which says nothing about the controller"


def test_a_controller_may_be_started_afterwards() -> None:
    assert (
        judge(obedient(), phases=PHASES[:2], wait=0.05).difference is None
    )  # it says at once that it is there
    silent = Wire()
    silent.nodes.append(obedient())
    verdict = judge(silent, phases=PHASES[:2], wait=0.05)
    assert verdict.difference is not None
    assert "did not send a heartbeat within 0.05 s" in verdict.difference
    assert [phase.outcome for phase in verdict.phases] == ["failed", "not run"]


@pytest.mark.parametrize("greetings", [0, 1, 3])
def test_a_controller_may_have_been_reset_several_times(greetings: int) -> None:
    controller = obedient()
    wire = Wire(controller)
    (greeting,) = wire.told
    wire._waiting.clear()
    for _ in range(greetings):
        wire._waiting.append(greeting)
    assert judge(wire, phases=PHASES[:2]).difference is None


# The command

CONTROLLER = f"--id {ID} --b-hat {B_HAT} --filter-period 10 --neighbours 20"


def radio(options: str) -> int:
    return main(["radio", *shlex.split(options)])


def test_a_verification_leaves_a_report_and_a_log(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    report, log = tmp_path / "report.json", tmp_path / "run.log"
    options = f"{CONTROLLER} --verify --robots 5 --timeout 20 --json --report {report} --log {log} --steps 10"
    config = "--memory 64"
    with node_in_a_thread(f"{CONTROLLER} {config}"):
        assert radio(f"{options} {config}") == 0
    content = json.loads(capsys.readouterr().out)
    assert json.loads(report.read_text()) == content
    verdict = content["verdict"]
    assert verdict["passed"]
    assert [phase["name"] for phase in verdict["phases"]] == [
        phase.name for phase in PHASES if phase.name not in ("no filter", "long run")
    ]
    assert content["parameters"]["controller"] == record(ID, "mirror", B_HAT, memory=64).plain()
    assert content["parameters"]["seed"] == 1
    assert verdict["latency_maximum"] >= verdict["latency_mean"] > 0
    assert main(["replay", str(log)]) == 0
    ticks = sum(phase["ticks"] for phase in verdict["phases"])
    assert f"{ticks}  broadcasts reproduced" in capsys.readouterr().out
    shown = markdown(ControllerVerdict([PhaseResult(**phase) for phase in verdict["phases"]]), content)
    for phase in verdict["phases"]:
        assert (
            f"| {phase['name']} | {phase['fault'] or ''} | {phase['ticks']} | {phase['frames'] or ''} |"
            in shown
        )
    assert f"**PASSED: {len(verdict['phases'])} of {len(verdict['phases'])} phases passed;" in shown


def test_a_wrong_controller_gives_exit_code_1_and_the_first_difference(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    report = tmp_path / "report.md"
    with node_in_a_thread(f"{CONTROLLER} --b-hat 0.56"):
        assert radio(f"{CONTROLLER} --verify --timeout 20 --report {report}") == 1
    shown = " ".join(capsys.readouterr().out.split())
    assert (
        'FAILED: 0 of 37 phases passed; first in phase "alone" (no observation), tick 0: telemetry' in shown
    )
    assert "**FAILED: 0 of 37 phases passed" in report.read_text()
    assert "| alone |  | 1 |  |  | 1 |  | failed |" in report.read_text()
    assert "| loss | loss=0.5,receivers=3 |  |  |  |  |  | not run |" in report.read_text()


def test_a_controller_that_broadcasts_too_rarely_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert radio("--id 3 --verify --comms-period 2000 --filter-period 2000") == 2
    assert "comms-period is 2000; a verification has hundreds of rounds" in capsys.readouterr().err


def test_a_controller_that_is_not_there(capsys: pytest.CaptureFixture[str]) -> None:
    assert radio("--id 3 --verify --timeout 0.05 --json") == 1
    verdict = json.loads(capsys.readouterr().out)["verdict"]
    assert verdict["difference"].startswith(
        'phase "alone" (no observation), tick 0: robot 3 did not broadcast'
    )
    assert radio("--id 3 --verify --wait 0.05") == 1
    assert "robot 3 did not send a heartbeat within 0.05 s" in " ".join(capsys.readouterr().out.split())


def test_a_process_is_verified_over_a_real_socket(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    choice, own = multicast(9), record(3, "native", B_HAT, memory=64)
    log = tmp_path / "run.log"
    with choice.open() as bus, NodeProcesses([own], lambda robot: choice, Subjects(), 10) as nodes:
        Lockstep(bus, check=nodes.check).wait_until_up({3}, PATIENCE)
        options = f"{CONTROLLER} --memory 64 --verify --robots 5 --steps 5 --timeout 30 --log {log}"
        assert radio(f"{options} {shlex.join(choice.arguments())}") == 0
    assert "PASSED: 37 of 37 phases passed" in capsys.readouterr().out
    assert main(["replay", str(log)]) == 0
