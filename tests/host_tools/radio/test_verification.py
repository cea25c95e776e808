"""The verdict on a controller: a right one passes, and every wrong one is found where it is wrong."""

from __future__ import annotations

import json
import random
import re
import shlex
from collections.abc import Sequence
from hashlib import sha256
from itertools import count
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import can
import pytest

from mcp_asdf.mirror import MirrorRobot
from mcp_asdf.robot import Filter, FixedPointRobot, Observation
from mcp_asdf_tools.bus.frame_layout import Action
from mcp_asdf_tools.bus.frames import Command, Estimate, Heartbeat, Telemetry, decode_command
from mcp_asdf_tools.cli.main import main
from mcp_asdf_tools.crosscheck import crafted_rounds
from mcp_asdf_tools.crosscheck.crafted_rounds import Update
from mcp_asdf_tools.radio import controller_link, robust_phases
from mcp_asdf_tools.radio.controller_link import BenchOptions
from mcp_asdf_tools.radio.known_mistakes import KNOWN_MISTAKES, KnownMistake
from mcp_asdf_tools.radio.neighbourhood import RadioSettings
from mcp_asdf_tools.radio.phases import PHASES, Phase, can_wait_for_tests
from mcp_asdf_tools.radio.verification import ControllerVerdict, PhaseResult, Verification, details
from mcp_asdf_tools.robots.node import RobotNode
from messages import encoded
from support import slow
from wire import CLOCK, EndlessWire, Wire, node_in_a_thread, record, still
from wrong_robots import B_HAT, DEFAULT, ID, VOTES, WRONG, Wrong, right, surroundings, with_node

pytestmark = pytest.mark.usefixtures("private_setup")

TICKS = 25
ROBUST = {phase.name for phase in PHASES if phase.play is not None and "robust" in phase.play.__module__}
PAPERS = {phase.name for phase in PHASES if phase.play is not None and "filter_ph" in phase.play.__module__}
PAPERS -= {"no filter", "halvings", "long run"}
"""Phases of one filter alone."""
NOT_ADAPTIVE = {"no filter", "re-estimates without a test"}
"""Phases of other filters than the paper's with its test."""
CRAFTED = tuple(phase for phase in PHASES if phase.play is not None)
"""Phases made for their purpose."""

MODERATE = "test of a moderate spread"


def named(*names: str) -> list[Phase]:
    return [phase for phase in PHASES if phase.name in names]


def verification(
    controller: RobotNode | Wire,
    plan: RadioSettings | None = None,
    phases: Sequence[Phase] = PHASES,
    **options: Any,
) -> Verification:
    """A verification of a controller, by itself or on a wire, that is over."""
    wire = controller if isinstance(controller, Wire) else Wire(controller)
    with still():
        done = Verification(plan or surroundings(), BenchOptions(wire, TICKS, 0.05, **options), phases)
        done.run()
    return done


def judge(*arguments: Any, **options: Any) -> ControllerVerdict:
    """The verdict of a verification."""
    return verification(*arguments, **options).verdict


def obedient(firmware: str = "native", **config: Any) -> RobotNode:
    """A right controller."""
    return RobotNode(right(**{"firmware": firmware, **config}))


# Right controllers


OFF: dict[str, Any] = {"filter": Filter.OFF, "table": None}
ALWAYS: dict[str, Any] = {"filter": Filter.ALWAYS, "table": None}


def seen_by(wire: Wire, plan: RadioSettings, phases: Sequence[Phase]) -> tuple[Verification, list[int], str]:
    """A verification that is over, the ticks it told of, and a digest of what it sent, and what for."""
    ticks, doing = list[int](), list[str]()

    def progress(tick: int) -> None:
        ticks.append(tick)
        doing.append(run.bench.activity)

    with still():
        run = Verification(plan, BenchOptions(wire, TICKS, 0.05, progress=progress), phases)
        run.run()
    sent = [(f.arbitration_id, f.is_extended_id, f.is_remote_frame, f.dlc, bytes(f.data)) for f in wire.sent]
    return run, ticks, sha256(repr((sent, doing)).encode()).hexdigest()[:16]


@pytest.mark.parametrize(
    ("config", "digest"),
    [({"memory": 64}, "20ace46b5a67a0f2"), (VOTES, "af6c630157c1d8a1"), *slow([({}, "dde7bb5febfce51d")])],
    ids=str,
)
def test_a_right_controller_passes_every_phase(config: dict[str, Any], digest: str) -> None:
    controller = obedient(**config)
    done, ticks, found = seen_by(Wire(controller), surroundings(right(**config)), PHASES)
    verdict, run = done.verdict, done.bench.firmware
    assert verdict.has_passed, verdict.headline
    assert {phase.name for phase in PHASES} - {phase.name for phase in verdict.phases} == {
        *("no filter", "long run" if "memory" in config else "halvings"),
        *(PAPERS if "filter" in config else ROBUST),
        "re-estimates without a test",
    }
    assert run.s.updates > 10
    assert all(0 < 10 * phase.ticks < 10 * phase.equal <= 21 * phase.ticks + 10 for phase in verdict.phases)
    assert all(phase.injected > 0 for phase in verdict.phases if phase.fault)
    assert all(
        phase.ticks == TICKS
        for phase, plan in zip(verdict.phases, done._phases, strict=True)
        if not plan.play
    )
    assert verdict.repeated == 0
    assert ticks[-1] == controller.ticks == sum(phase.ticks for phase in verdict.phases)
    equal = done.bench.comparison.equal_frames
    assert equal == {"estimate": ticks[-1], "heartbeat": (ticks[-1] - 1) // 10, "telemetry": len(ticks)}
    assert equal.total() == sum(phase.equal for phase in verdict.phases)
    assert isinstance(controller.robot, FixedPointRobot)
    assert (controller.robot.counters, controller.robot.state()) == (run.counters, run.state())
    assert run.s.t > 10_000 or "memory" in config
    assert found == digest, "who changes the phases on purpose writes the new digest here"


PERIODS = ((5, 10), (10, 10), (1, 1), (1, 2), (40, 600))
B_HATS = (2**-20, 0.02, 0.4999, 0.5, 0.75, 0.95, 1 - 2**-20)
CONFIGS: list[dict[str, Any]] = [
    *(OFF, ALWAYS, ALWAYS | {"comms_period": 5}, {"filter_period": 997, "memory": 2048}),
    *({"robot": robot} for robot in (0, 1, 125, 127)),
    *(
        {"comms_period": comms, "filter_period": tau, **kind}
        for comms, tau in PERIODS
        for kind in ({}, VOTES)
    ),
    *({"b_hat": b_hat, **kind} for b_hat in B_HATS for kind in ({}, VOTES)),
    *({"memory": memory, **VOTES} for memory in (64, 2048)),
]


@pytest.mark.slow
@pytest.mark.parametrize("config", CONFIGS, ids=str)
def test_other_configurations_pass(config: dict[str, Any]) -> None:
    own, seed = record(**{"robot": ID, "b_hat": B_HAT, **config}), random.randrange(2**32)
    verdict = judge(RobotNode(own), surroundings(own, seed=seed))
    assert verdict.has_passed, (seed, verdict.headline)


@pytest.mark.parametrize(
    ("config", "phases", "digest"),
    [
        ({"comms_period": 5, "filter_period": 20, "memory": 512, **ALWAYS}, CRAFTED, "c6c5a1b6e3b9abce"),
        ({"b_hat": 0.4, **VOTES}, named("first black tiles", "few voices", MODERATE), "649ca5a08b11edfc"),
        (OFF, named("first black tiles", "no filter"), "b5911caf01c76e19"),
        ({"memory": 80}, named("alone", "messages and silence", "halvings"), "10b82ac699f41f47"),
        ({"memory": 76}, named("first black tiles", "halvings"), "7fae411d4a628d8c"),
        *slow([(OFF, CRAFTED, "a955cf607a15a6c5")]),
    ],
    ids=lambda each: "" if isinstance(each, Sequence) else str(each),
)
def test_a_seed_repeats_the_same_frames_for_the_same_purposes(
    config: dict[str, Any], phases: Sequence[Phase], digest: str
) -> None:
    """So a report says what to run again."""
    run, _, found = seen_by(Wire(obedient(**config)), surroundings(right(**config)), phases)
    assert run.verdict.difference is None
    assert found == digest, "who changes the phases on purpose writes the new digest here"


# What is put to the test


def test_own_faults_are_phases_more() -> None:
    """A phase has two rounds, however rarely the controller broadcasts."""
    config: dict[str, Any] = {"filter_period": 600, "comms_period": 40}
    plan = surroundings(right(**config), faults="loss=0.7,receivers=3 liar,robots=1,x=0")
    phases = judge(
        obedient(**config), plan, [PHASES[1], *(each for each in PHASES if "liar" in each.fault)]
    ).phases
    assert [phase.name for phase in phases] == ["alone", "liar", "loss", "liar"]
    assert [phase.ticks for phase in phases] == [72, 80, 80, 80]
    one = "liar=1,x=1,alpha=1e38,robots=0"
    assert [phase.fault for phase in phases[1:]] == [one, "loss=0.7,receivers=3", "liar=1.0,robots=1,x=0.0"]
    assert all(phase.injected > 0 and phase.outcome == "passed" for phase in phases[1:])


@pytest.mark.parametrize(
    ("config", "faults", "missing"),
    [
        ({}, "loss=0", 'the fault of phase "loss"'),
        ({"filter_period": 20_001}, "", "the filter: its period is too long for a run"),
    ],
)
def test_what_is_not_put_to_the_test_proves_nothing(
    config: dict[str, Any], faults: str, missing: str
) -> None:
    verdict = judge(obedient(**config), surroundings(right(**config), faults=faults), PHASES[:2])
    assert can_wait_for_tests(right(filter_period=20_000))
    assert not verdict.has_passed and verdict.phases[0].ticks < 1000
    assert verdict.headline.startswith("NOT EXERCISED: ")
    assert verdict.headline.endswith(f", no difference, but never put to the test: {missing}")


def test_what_a_robot_cannot_be_brought_to_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(robust_phases, "_MAX_ROUNDS", 0)
    monkeypatch.setattr(robust_phases, "_MAX_OBSERVATIONS", 0)
    phases = named("few voices", MODERATE, "test of the least spread")
    verdict = judge(obedient(**VOTES), surroundings(right(**VOTES)), phases)
    crowd, rejects = "a crowd in the middle", ["observations of one colour: a test that rejects"] * 2
    told = ["two voices", "a crowd of two voices that stays"]
    told += [crowd, "a spread of 0.0625", *rejects, crowd, "a spread of 0.000244141", *rejects]
    assert (verdict.difference, verdict.not_exercised) == (None, told)
    monkeypatch.setattr(crafted_rounds, "_MAX_DRAWS_FOR_UPDATE", 0)
    verdict = judge(obedient(), phases=named("first black tiles", "re-estimates"))
    told = [f"a re-estimate: {each.value}" for each in Update if each not in (Update.HALF, Update.FAINT)]
    assert (verdict.difference, verdict.not_exercised) == (None, told)


OF_RE_ESTIMATES = [
    "a re-estimate before its first white tile",
    "a counter of more than 257 updates",
    "a re-estimate from tiles of both colours",
]
OF_ALL = [
    "more than 505 messages in a tick",
    "its own clock",
    "saving and restoring",
    "its behaviour on a bus",
    "vendor status",
    "the largest alpha",
    "counts above t = ",
]
SLOW = {"filter_period": 5, "comms_period": 5, "memory": 20_004}


@pytest.mark.parametrize(
    ("config", "first"),
    [
        (
            {},
            [
                "thresholds of rounds of",
                "rounds longer",
                "forgetting: its memory is 2147483648",
                *OF_RE_ESTIMATES,
            ],
        ),
        (
            OFF | {"memory": 64, "comms_period": 5},
            ["the test and re-estimates: it does not"],
        ),
        (
            ALWAYS | {"memory": 20_000},
            ["the test: it re-estimates always", "rounds longer", *OF_RE_ESTIMATES],
        ),
        (SLOW, ["thresholds", "rounds without a test", "forg", *OF_RE_ESTIMATES]),
    ],
)
def test_what_was_not_checked_is_listed(config: dict[str, Any], first: list[str]) -> None:
    listed = judge(obedient(**config), surroundings(right(**config)), PHASES[:1]).not_checked
    mistakes = [line for line in listed if line.startswith("whether it ")]
    for line, begin in zip(listed, first + OF_ALL + mistakes, strict=True):
        assert line.startswith(begin)


# Wrong controllers


QUICK: dict[str, Any] = {"b_hat": B_HAT}
"""A configuration with which a verification is short."""


def found(wrong: Wrong, seed: int = 6, others: dict[str, Any] = QUICK) -> ControllerVerdict:
    """The verdict on a wrong controller, by default with the other settings that make it short."""
    return judge(wrong.make(others), surroundings(right(**others | wrong.config), seed=seed))


ONE_BY_PHASE = {wrong.phase: what for what, wrong in WRONG.items() if wrong.config is not VOTES}
SAMPLE = [*ONE_BY_PHASE.values()][::3]
"""One for a third of the phases that find any, since each takes a second; make verify has all."""


@pytest.mark.parametrize("what", SAMPLE)
def test_wrong_controllers_are_found(what: str) -> None:
    assert found(WRONG[what]).difference is not None


@pytest.mark.slow
@pytest.mark.parametrize("what", WRONG)
def test_wrong_controllers_fail_where_they_are_wrong(what: str) -> None:
    """At the default configuration."""
    verdict = found(WRONG[what], others=DEFAULT)
    assert not verdict.has_passed
    assert verdict.difference is not None
    assert verdict.difference.startswith(f'phase "{WRONG[what].phase}'), verdict
    outcomes = [each.outcome for each in verdict.phases]
    place = outcomes.index("failed")
    assert set(outcomes[:place]) <= {"passed"}
    assert set(outcomes[place + 1 :]) <= {"not run"}


BY_DEFAULT_ALONE = {"variance of the prediction alone", "t of 14 bits in eq. 8"}
"""Wrong robots that need the default configuration: with the short one both variances decide alike, and all
re-estimates come before 2^14 observations."""


@pytest.mark.slow
def test_wrong_controllers_are_found_with_any_seed() -> None:
    seed = random.randrange(2**32)
    for what, wrong in WRONG.items():
        others = DEFAULT if what in BY_DEFAULT_ALONE else QUICK
        assert found(wrong, seed, others).difference is not None, (seed, what)


# A known mistake is named


MISTAKES_SHOWN_EARLY = [
    mistake for mistake in KNOWN_MISTAKES if "three voices" in mistake.name or "modulo" in mistake.name
]
MISTAKES_SHOWN_LATE = [mistake for mistake in KNOWN_MISTAKES if mistake not in MISTAKES_SHOWN_EARLY]


@pytest.mark.parametrize(
    "mistake", [*MISTAKES_SHOWN_EARLY, *slow(MISTAKES_SHOWN_LATE)], ids=lambda mistake: mistake.name
)
def test_a_verdict_names_a_known_mistake(mistake: KnownMistake) -> None:
    filter_kind = next(iter(mistake.filters))
    config = QUICK | ({} if filter_kind is Filter.ADAPTIVE else {"filter": filter_kind, "table": None})
    controller = record(**{"robot": ID, "firmware": "mirror", **config})

    def make() -> MirrorRobot:
        return mistake.make_model(MirrorRobot(controller.config, controller.id, controller.b_hat))

    difference = str(judge(RobotNode(controller, make=make), surroundings(right(**config))).difference)
    mistakes = difference.partition("so would answer a controller that ")[2]
    assert mistake.name in mistakes.split(", or one that ")


def test_a_verdict_lists_the_mistakes_that_no_frame_would_have_shown() -> None:
    listed = judge(obedient(**VOTES), surroundings(right(**VOTES)), named("alone")).not_checked
    assert "whether it counts voices modulo 16: no frame of this run would have shown it" in listed


@pytest.mark.slow
def test_a_right_controller_leaves_no_known_mistake_open() -> None:
    listed = judge(obedient(**VOTES), surroundings(right(**VOTES))).not_checked
    assert not [line for line in listed if line.startswith("whether it ")]


# Each way to differ is told by field, expected and got: the pattern of the difference


DIFFERENCES = {
    "another b_hat": r"telemetry, b_hat: expected .*b_hat 0x8ccccc \(0\.55.*, got .*b_hat 0x8f5c28 \(0\.559",
    "rejects its own estimate": r"telemetry, updates: expected .* updates (\d+), .* updates (?!\2)\d+, ",
    "bit 23 set": "estimate, identifier: expected 106BB803 .*, got 10EBB803 ",
    "another priority": "estimate, priority: expected 106BB803 .*, got 146BB803 ",
    "CAN FD": r"estimate, frame: expected .*, got 106BB803#\w+$",
    "7 bytes": r"telemetry, length: expected .*, got 186BB903#\w{14}$",
    "another tail": r"estimate, tail: expected .*, got 106BB803#\w{14}20$",
    "transfer ids stand still": "heartbeat, transfer_id: expected .* transfer_id 1, .* transfer_id 0, ",
    "says it twice": r"estimate, twice: expected (106BB803 .*), got \2 and \2$",
    "no heartbeats": "heartbeat, missing: expected 107D5503 transfer_id 1, .*, got nothing$",
    "heartbeats twice as often": "heartbeat, extra: expected nothing, got 107D5503 ",
    "uptime in ticks": "heartbeat, uptime: expected .*uptime 1, .* got .*uptime 10, ",
    "health caution": "heartbeat, health: expected .*health 0, got .*health 2",
    "mode maintenance": "heartbeat, mode: expected .*mode 0, .*got .*mode 2, ",
    "alpha of 20 bits": r"estimate, alpha: expected .*hat 0x\w+ \([\d.]+\), alpha 0x\w+ \([\d.e+-]+\), got",
    "x rounded in telemetry": r"telemetry, x: expected .*, x 0x\w+ \([\d.]+\), got .*, x 0x\w+ \(",
    "estimate before heartbeat": "estimate, order: expected the heartbeat first, got it before the ",
    "hangs": "robot 3 did not ",
}


@pytest.mark.parametrize("what", DIFFERENCES)
def test_a_difference_says_what_was_expected_and_what_came(what: str) -> None:
    difference = found(WRONG[what]).difference
    assert difference is not None
    assert re.match(r'phase "[^"]+"( \(.*?\))?, tick \d+: ' + DIFFERENCES[what], difference), difference


# Others on the bus


def is_command(frame: can.Message) -> bool:
    return isinstance(decode_command(frame), Command)


@pytest.mark.parametrize(
    ("message", "kind"),
    [
        (Heartbeat(40, 7, 0), None),
        (Telemetry(40, 7, 16, 0, 0), None),
        (Command(40, 1000, 77, Action.SETTLE, 0), None),
        (Estimate(40, 1 << 22, 0x80000001, 0), "estimates"),
        (Command(40, 1000, ID, Action.OBSERVE_BLACK, 0), "commands"),
        (Command(40, 1000, 255, Action.SETTLE, 0), "commands"),
    ],
)
def test_a_node_that_the_controller_hears_is_named_and_not_blamed_on_it(
    message: Any, kind: str | None
) -> None:
    talker = Mock()
    talker.start.return_value = []
    talker.receive_frame.side_effect = lambda frame: [encoded(message)] if is_command(frame) else []
    verdict = judge(Wire(obedient(), talker), phases=PHASES[:2])
    assert verdict.difference is None
    if kind is None:
        assert verdict.has_passed
        return
    assert verdict.phases[0].outcome == "disturbed"
    assert verdict.headline.startswith("DISTURBED, no verdict: 0 of")
    assert f"node 40 sends {kind} on this bus, too" in verdict.headline


@pytest.mark.parametrize(("from_tick", "severity"), [(10**6, 1), (30, 1), (10**6, 2)])
def test_a_controller_may_complain_of_ticks_left_open_and_of_nothing_else(
    from_tick: int, severity: int
) -> None:
    """In its health, as advice; not before a tick stayed open."""

    def observe(robot: RobotNode, usual: Any, z: Observation | None) -> Any:
        *heartbeats, estimate = usual(z)
        for frame in heartbeats:
            frame.data[4] = severity * (robot.unsettled > 0 or robot.ticks >= from_tick)
        return [*heartbeats, estimate]

    controller = with_node("", observe=observe).make(QUICK)
    difference = str(judge(controller, phases=PHASES[1:7]).difference)
    is_legal = (from_tick, severity) == (10**6, 1)
    assert difference == "None" if is_legal else "heartbeat, health: expected" in difference
    assert controller.unsettled > 0 or not is_legal


def test_other_frames_of_the_controller_are_not_judged() -> None:
    own = can.Message(arbitration_id=4 << 26 | 3 << 21 | 7510 << 8 | ID, data=b"any")
    controller = with_node("", settle=lambda robot, usual: [*usual(), own]).make(QUICK)
    assert judge(controller, phases=PHASES[:1]).has_passed


def test_what_comes_after_the_last_answer_counts(monkeypatch: pytest.MonkeyPatch) -> None:
    """But others who talk on do not keep the verdict for more than a tenth of a second."""

    class Late(Wire):
        def recv(self, timeout: float | None = None) -> can.Message | None:
            frame = super().recv(timeout)
            if frame is None and timeout and controller.ticks == 72 and controller.is_settled and not late:
                late.append(controller.settle()[0])
                self.say(controller, late)
                frame = super().recv(timeout)
            return frame

    controller, late = obedient(), list[can.Message]()
    assert "telemetry, extra: expected nothing" in str(judge(Late(controller), phases=PHASES[1:2]).difference)
    monkeypatch.setattr(controller_link, "time", CLOCK)
    wire = EndlessWire()
    assert judge(wire, phases=[Phase("nothing", lambda bench: None)]).has_passed
    assert 10 <= wire.frames <= 12


# The bus


def test_a_verification_may_be_stopped_between_two_ticks() -> None:
    controller, done = obedient(), list[int]()
    verdict = judge(controller, progress=done.append, should_stop=lambda: len(done) == 75)
    assert (verdict.is_interrupted, verdict.has_passed, verdict.difference) == (True, False, None)
    assert [phase.ticks for phase in verdict.phases[:3]] == [20, 60, 0]
    assert [phase.outcome for phase in verdict.phases[:3]] == ["passed", "not run", "not run"]
    assert (controller.ticks, controller.is_settled) == (80, True)
    assert verdict.headline.startswith("INTERRUPTED: 1 of")


@pytest.mark.parametrize("kind", [Wire, EndlessWire])
def test_a_verification_may_be_stopped_while_it_waits_or_others_talk(kind: type[Wire]) -> None:
    verdict = judge(kind(), wait=1e9, should_stop=lambda: True)
    assert (verdict.is_interrupted, verdict.difference) == (True, None)


def test_commands_that_the_bus_loses_are_said_again_and_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    """An observe and a settle of the first phase."""
    wire, number = Wire(obedient()), count(1)
    send = wire.send

    def lose_two(frame: can.Message, timeout: float | None = None) -> None:
        if next(number) not in (11, 21):
            send(frame, timeout)

    monkeypatch.setattr(wire, "send", lose_two)
    assert judge(wire, phases=PHASES[1:4]).headline.endswith("; 2 commands were repeated")


def test_a_bus_that_fails_is_not_blamed_on_the_controller(monkeypatch: pytest.MonkeyPatch) -> None:
    wire = Wire(obedient())
    monkeypatch.setattr(wire, "send", Mock(side_effect=can.CanOperationError("cable pulled")))
    headline = judge(wire).headline
    assert headline.startswith("DISTURBED, no verdict: 0 of")
    assert "cable pulled" in headline


def test_a_controller_may_be_started_afterwards() -> None:
    assert judge(obedient(), phases=PHASES[:3], wait=0.05).has_passed  # it says at once that it is there
    silent = Wire()
    silent.nodes.append(obedient())
    verdict = judge(silent, phases=PHASES[:3], wait=0.05)
    assert str(verdict.difference).startswith(
        'phase "nothing seen", tick 0: robot 3 did not send a heartbeat '
    )
    assert [phase.outcome for phase in verdict.phases] == ["failed", "not run", "not run"]


def test_a_wrong_greeting_is_compared_with_the_right_one() -> None:
    def start(robot: RobotNode, usual: Any) -> list[can.Message]:
        (greeting,) = usual()
        greeting.data[5] = 2
        return [greeting]

    verdict = judge(with_node("", start=start).make(QUICK), phases=PHASES[:1])
    assert "heartbeat, mode: expected 107D5503" in str(verdict.difference)
    assert verdict.phases[0].outcome == "failed"


@pytest.mark.parametrize("greetings", [0, 1, 3])
def test_a_controller_may_have_been_reset_several_times(greetings: int) -> None:
    wire = Wire(obedient())
    wire._waiting.extend(wire.told * (greetings - 1))
    if greetings == 0:
        wire._waiting.clear()
    assert judge(wire, phases=PHASES[:2]).has_passed


# The command

CONTROLLER = f"--id {ID} --b-hat {B_HAT} --filter-period 10 --neighbours 20"


def radio(options: str) -> int:
    return main(["radio", "--interface", "virtual", *shlex.split(options)])


def test_a_verification_leaves_a_report_and_a_log(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    report, log = tmp_path / "report.md", tmp_path / "run.log"
    config = "--memory 64"
    options = f"{CONTROLLER} {config} --verify --robots 5 --timeout 20 --steps 10 --json"
    with node_in_a_thread(f"{CONTROLLER} {config}"):
        assert radio(f"{options} --report {report} --log {log}") == 0
    content = json.loads(capsys.readouterr().out)
    verdict, text = content["verdict"], report.read_text()
    assert verdict["passed"]
    names = {phase["name"] for phase in verdict["phases"]}
    assert names == {phase.name for phase in PHASES} - NOT_ADAPTIVE - {"long run"} - ROBUST
    assert content["parameters"]["controller"] == record(ID, "mirror", B_HAT, memory=64).plain()
    assert (content["parameters"]["seed"], content["parameters"]["steps"]) == (1, 10)
    parameters = json.loads(text.partition("```json\n")[2].partition("```")[0])["parameters"]
    assert parameters == content["parameters"]
    rows = [list(map(str.strip, row.split("|")[1:-1])) for row in text.splitlines() if row.startswith("| ")]
    columns = ("name", "ticks", "injected", "equal", "outcome", "fault")
    assert rows[2:] == [[str(phase[name] or "") for name in columns] for phase in verdict["phases"]]
    assert f"**PASSED: {len(names)} of {len(names)} phases passed;" in text
    assert "\nNot checked:\n\n- thresholds of rounds" in text
    assert main(["replay", str(log)]) == 0
    ticks = sum(phase["ticks"] for phase in verdict["phases"])
    assert f"{ticks}  broadcasts reproduced" in capsys.readouterr().out


def test_details_are_a_table_and_lists() -> None:
    phases = [PhaseResult("alone", None, 72, 0, 144, "passed"), PhaseResult("loss", "loss=0.5,receivers=3")]
    verdict = ControllerVerdict(phases, not_exercised=["a", "b"], not_checked=["c"])
    assert details(verdict).split("\n") == [
        "| phase | ticks | injected | equal frames | outcome | fault |",
        "| ----- | ----- | -------- | ------------ | ------- | ----- |",
        "| alone | 72    |          | 144          | passed  |       |",
        "| loss  |       |          |              | not run | loss=0.5,receivers=3 |",
        *("", "Not exercised:", "", "- a", "- b", "", "Not checked:", "", "- c", ""),
    ]


@pytest.mark.parametrize(
    ("config", "phases"), [("--neighbours 20", 45), ("--activation always", 38), ("--filter none", 31)]
)
def test_a_wrong_controller_gives_an_exit_code_and_a_line(
    capsys: pytest.CaptureFixture[str], config: str, phases: int
) -> None:
    own = f"--id {ID} --filter-period 10 {config}"
    with node_in_a_thread(f"{own} --b-hat 0.56"):
        assert radio(f"{own} --b-hat {B_HAT} --verify --timeout 20") == 1
    shown = capsys.readouterr().out
    first = f'FAILED: 0 of {phases} phases passed; first in phase "nothing seen" (no observation), tick 0'
    assert first in shown
