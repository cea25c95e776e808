"""The verdict on a controller: a right one passes, and every wrong one is found where it is wrong."""

from __future__ import annotations

import json
import random
import re
import shlex
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import can
import pytest

from golden import assert_equals_golden_file
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
from wrong_robots import ALWAYS, B_HAT, DEFAULT, ID, VOTES, WRONG, Wrong, right, surroundings, with_node

pytestmark = pytest.mark.usefixtures("private_setup")

TICKS = 25
"""Ticks of a phase among neighbours."""
QUICK: dict[str, Any] = {"b_hat": B_HAT}
"""A configuration with which a verification is short."""
OFF: dict[str, Any] = {"filter": Filter.OFF, "table": None}

CRAFTED_PHASES = tuple(phase for phase in PHASES if phase.play is not None)
"""Phases written for their purpose, round by round."""
ROBUST_PHASES = {
    phase.name for phase in PHASES if phase.play is not None and "robust" in phase.play.__module__
}
ASDF_PHASES = {
    phase.name for phase in PHASES if phase.play is not None and "filter_phases" in phase.play.__module__
} - {"no filter", "halvings", "long run"}
"""Phases of the paper's filters alone."""


def phases_named(*names: str) -> list[Phase]:
    return [phase for phase in PHASES if phase.name in names]


def right_controller(firmware: str = "native", **config: Any) -> RobotNode:
    return RobotNode(right(**{"firmware": firmware, **config}))


def run_verification(
    controller: RobotNode | Wire,
    settings: RadioSettings | None = None,
    phases: Sequence[Phase] = PHASES,
    **options: Any,
) -> Verification:
    """Verify a controller, which is alone or on a wire, and return the verification when it is over."""
    wire = controller if isinstance(controller, Wire) else Wire(controller)
    with still():
        verification = Verification(
            settings or surroundings(), BenchOptions(wire, TICKS, 0.05, **options), phases
        )
        verification.run()
    return verification


def verify(*arguments: Any, **options: Any) -> ControllerVerdict:
    """Verify a controller as ``run_verification`` does, and return the verdict."""
    return run_verification(*arguments, **options).verdict


def verify_wrong(wrong: Wrong, seed: int = 6, config: dict[str, Any] = QUICK) -> ControllerVerdict:
    """Return the verdict on a wrong controller, with other settings that by default make it short."""
    settings = surroundings(right(**config | wrong.config), seed=seed)
    return verify(wrong.make(config), settings)


# --- Right controllers ---


@dataclass(frozen=True)
class ObservedRun:
    """A verification that is over, and what was seen of it.

    Attributes:
        verification: The verification.
        ticks: Numbers of ticks that it reported as done.
        activities: What it was doing whenever a tick was done, a text for each tick.
    """

    verification: Verification
    ticks: list[int]
    activities: list[str]


def observe_run(wire: Wire, settings: RadioSettings, phases: Sequence[Phase]) -> ObservedRun:
    """Verify a controller, and return what was seen of it."""
    ticks: list[int] = []
    activities: list[str] = []

    def progress(tick: int) -> None:
        ticks.append(tick)
        activities.append(verification.bench.activity)

    with still():
        verification = Verification(settings, BenchOptions(wire, TICKS, 0.05, progress=progress), phases)
        verification.run()
    return ObservedRun(verification, ticks, activities)


def describe_activities(activities: list[str]) -> Iterator[str]:
    """Yield a line for each activity, with the number of ticks that it took, in the order of their begin."""
    for activity, ticks in Counter(activities).items():
        yield f"{ticks} ticks: {activity}"


def describe_frames(frames: Sequence[can.Message]) -> Iterator[str]:
    """Yield every thousandth frame, and two sums over all frames that tell other sequences from this one."""
    for index in range(0, len(frames), 1000):
        frame = frames[index]
        yield f"frame {index}: {frame.arbitration_id:08X}#{frame.data.hex().upper()}"
    byte_sum = sum(sum(frame.data) for frame in frames)
    sum_by_place = sum(place * sum(frame.data) for place, frame in enumerate(frames))
    yield f"{len(frames)} frames; sum of all bytes {byte_sum}; times the place of their frame {sum_by_place}"


@dataclass(frozen=True)
class RunOfAllPhases:
    """A verification of a right controller in all phases.

    Attributes:
        config: In what the configuration of the controller differs from the usual one.
        controller: The controller.
        run: The verification, and what was seen of it.
    """

    config: dict[str, Any]
    controller: RobotNode
    run: ObservedRun


@pytest.fixture(scope="module", params=[{"memory": 64}, *slow([VOTES, {}])], ids=str)
def run_of_all_phases(request: pytest.FixtureRequest) -> RunOfAllPhases:
    config = request.param
    controller = right_controller(**config)
    return RunOfAllPhases(
        config, controller, observe_run(Wire(controller), surroundings(right(**config)), PHASES)
    )


def test_a_right_controller_passes_every_phase(run_of_all_phases: RunOfAllPhases) -> None:
    verdict = run_of_all_phases.run.verification.verdict
    assert verdict.has_passed, verdict.headline
    assert verdict.repeated == 0


def test_phases_that_do_not_apply_to_a_controller_are_left_out(run_of_all_phases: RunOfAllPhases) -> None:
    """A phase is for the paper's filters or for the robust one, and for a short memory or for a long one."""
    config, verdict = run_of_all_phases.config, run_of_all_phases.run.verification.verdict
    expected = {"no filter", "re-estimates without a test"}
    expected |= {"long run"} if "memory" in config else {"halvings"}
    expected |= ASDF_PHASES if "filter" in config else ROBUST_PHASES

    assert {phase.name for phase in PHASES} - {phase.name for phase in verdict.phases} == expected


def test_each_phase_reports_its_ticks_equal_frames_and_injected_faults(
    run_of_all_phases: RunOfAllPhases,
) -> None:
    verification = run_of_all_phases.run.verification
    for result, phase in zip(verification.verdict.phases, verification._phases, strict=True):
        # An estimate in every tick, telemetry in those that are settled, and a heartbeat in every tenth.
        assert 0 < result.ticks < result.equal <= 2.1 * result.ticks + 1
        assert result.injected > 0 or not phase.fault
        is_among_neighbours = phase.play is None
        assert result.ticks == TICKS or not is_among_neighbours


def test_all_frames_of_a_right_controller_are_compared(run_of_all_phases: RunOfAllPhases) -> None:
    """An estimate in each tick, a heartbeat in every tenth, and telemetry whenever a tick is done."""
    run, controller = run_of_all_phases.run, run_of_all_phases.controller
    last_tick = run.ticks[-1]

    assert last_tick == controller.ticks == sum(result.ticks for result in run.verification.verdict.phases)
    assert run.verification.bench.comparison.equal_frames == {
        "estimate": last_tick,
        "heartbeat": (last_tick - 1) // 10,
        "telemetry": len(run.ticks),
    }


def test_the_model_of_a_verification_ends_in_the_state_of_the_controller(
    run_of_all_phases: RunOfAllPhases,
) -> None:
    """The model is a robot in Python that gets the same messages; both have re-estimated often by then."""
    robot, model = run_of_all_phases.controller.robot, run_of_all_phases.run.verification.bench.firmware
    assert isinstance(robot, FixedPointRobot)
    assert robot.state() == model.state()
    assert robot.counters == model.counters
    assert model.s.updates > 10
    assert model.s.t > 10_000 or "memory" in run_of_all_phases.config


PERIODS = [
    {"comms_period": 5, "filter_period": 10},
    {"comms_period": 10, "filter_period": 10},
    {"comms_period": 1, "filter_period": 1},
    {"comms_period": 1, "filter_period": 2},
    {"comms_period": 40, "filter_period": 600},
]
B_HATS = (2**-20, 0.02, 0.4999, 0.5, 0.75, 0.95, 1 - 2**-20)
CONFIGS: list[dict[str, Any]] = [
    *(OFF, ALWAYS, ALWAYS | {"comms_period": 5}, {"filter_period": 997, "memory": 2048}),
    *({"robot": robot} for robot in (0, 1, 125, 127)),
    *(periods | filter_config for periods in PERIODS for filter_config in ({}, VOTES)),
    *({"b_hat": b_hat} | filter_config for b_hat in B_HATS for filter_config in ({}, VOTES)),
    *({"memory": memory} | VOTES for memory in (64, 2048)),
]


@pytest.mark.slow
@pytest.mark.parametrize("config", CONFIGS, ids=str)
def test_a_right_controller_of_another_configuration_passes(config: dict[str, Any]) -> None:
    setup, seed = record(**{"robot": ID, "b_hat": B_HAT, **config}), random.randrange(2**32)
    verdict = verify(RobotNode(setup), surroundings(setup, seed=seed))
    assert verdict.has_passed, (seed, verdict.headline)


@pytest.mark.parametrize(
    ("name", "config", "phases"),
    [
        ("no_filter", OFF, phases_named("first black tiles", "no filter")),
        ("memory_80", {"memory": 80}, phases_named("alone", "messages and silence", "halvings")),
        ("memory_76", {"memory": 76}, phases_named("first black tiles", "halvings")),
        *slow(
            [
                ("always", {"comms_period": 5, "filter_period": 20, "memory": 512, **ALWAYS}, CRAFTED_PHASES),
                (
                    "robust_first_phases",
                    {"b_hat": 0.4, **VOTES},
                    phases_named("first black tiles", "first estimates", "test of a wide spread"),
                ),
                ("all_phases", {}, PHASES),
                ("all_phases_memory_64", {"memory": 64}, PHASES),
                ("all_phases_robust", VOTES, PHASES),
                ("crafted_phases_no_filter", OFF, CRAFTED_PHASES),
            ]
        ),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_the_same_seed_verifies_with_the_same_frames_again(
    name: str, config: dict[str, Any], phases: Sequence[Phase]
) -> None:
    """So the seed in a report is enough to repeat a run."""
    wire = Wire(right_controller(**config))
    run = observe_run(wire, surroundings(right(**config)), phases)
    assert run.verification.verdict.difference is None
    lines = [*describe_activities(run.activities), *describe_frames(wire.sent)]
    assert_equals_golden_file(f"verification_{name}.txt", lines)


# --- What is put to the test ---


def test_each_fault_that_the_user_asks_for_is_one_more_phase() -> None:
    phases = [*phases_named("alone"), *phases_named("liar")]
    settings = surroundings(faults="loss=0.7,receivers=3 liar,robots=1,x=0")
    verdict = verify(right_controller(), settings, phases)

    assert [(phase.name, phase.fault) for phase in verdict.phases] == [
        ("alone", None),
        ("liar", "liar=1,x=1,alpha=1e38,robots=0"),
        ("loss", "loss=0.7,receivers=3"),
        ("liar", "liar=1.0,robots=1,x=0.0"),
    ]


def test_a_phase_with_a_fault_is_long_enough_for_two_broadcasts_of_a_slow_controller() -> None:
    """It broadcasts in every 40th tick. The phase has a fault of its own, and one that the user asks for."""
    config: dict[str, Any] = {"filter_period": 600, "comms_period": 40}
    settings = surroundings(right(**config), faults="loss=0.7,receivers=3")
    phases = verify(right_controller(**config), settings, phases_named("liar")).phases

    assert [phase.ticks for phase in phases] == [2 * 40, 2 * 40]
    assert all(phase.injected > 0 and phase.outcome == "passed" for phase in phases)


@pytest.mark.parametrize(
    ("config", "faults", "missing"),
    [
        ({}, "loss=0", 'the fault of phase "loss"'),
        ({"filter_period": 20_001}, "", "the filter: its period is too long for a run"),
    ],
)
def test_a_controller_does_not_pass_if_something_was_never_put_to_the_test(
    config: dict[str, Any], faults: str, missing: str
) -> None:
    verdict = verify(right_controller(**config), surroundings(right(**config), faults=faults), PHASES[:2])
    assert not verdict.has_passed
    assert verdict.headline.startswith("NOT EXERCISED: ")
    assert verdict.headline.endswith(f", no difference, but never put to the test: {missing}")


def test_a_verification_does_not_wait_for_a_filter_that_runs_too_rarely() -> None:
    """The filter runs in every 20,001st tick, and 20,000 are the most that a verification waits for."""
    config: dict[str, Any] = {"filter_period": 20_001}
    verdict = verify(right_controller(**config), surroundings(right(**config)), PHASES[:1])

    assert verdict.phases[0].ticks < 1000
    assert can_wait_for_tests(right(filter_period=20_000))
    assert not can_wait_for_tests(right(filter_period=20_001))


def test_situations_of_the_robust_filter_that_no_observations_lead_to_are_listed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The user learns what the verdict does not cover."""
    monkeypatch.setattr(robust_phases, "_MAX_BURSTS", 0)  # as if all attempts had been in vain
    phases = phases_named("first estimates", "test of a wide spread", "many rejections")
    verdict = verify(right_controller(**VOTES), surroundings(right(**VOTES)), phases)

    assert verdict.difference is None
    assert verdict.not_exercised == [
        *["observations before a test of 5 estimates"] * 2,
        *["observations before a test of 6 estimates"] * 2,
        *["observations before a test of 32 estimates"] * 2,
        "observations until the test rejects",
    ]


def test_re_estimates_of_the_accuracy_that_no_messages_lead_to_are_listed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The user learns what the verdict does not cover: the five results that a re-estimate can have."""
    phases = phases_named("first black tiles", "re-estimates")
    monkeypatch.setattr(crafted_rounds, "_MAX_DRAWS_FOR_UPDATE", 0)  # as if all attempts had been in vain

    verdict = verify(right_controller(), phases=phases)

    results = (Update.ABOVE, Update.BELOW, Update.MAXIMUM, Update.MINIMUM, Update.KEPT)
    assert verdict.not_exercised == [f"a re-estimate: {result.value}" for result in results]
    assert verdict.difference is None


OPEN_ABOUT_RE_ESTIMATES = [
    "a re-estimate before its first white tile",
    "a counter of more than 257 updates",
    "a re-estimate from tiles of both colours",
]
ALWAYS_OPEN = [
    "more than 505 messages in a tick",
    "its own clock",
    "saving and restoring",
    "its behaviour on a bus",
    "vendor status",
    "the largest alpha",
    "counts above t = ",
]


@pytest.mark.parametrize(
    ("config", "first_lines"),
    [
        (
            {},
            [
                "thresholds of rounds of",
                "rounds longer",
                "forgetting: its memory is 2147483648",
                *OPEN_ABOUT_RE_ESTIMATES,
            ],
        ),
        (OFF | {"memory": 64, "comms_period": 5}, ["the test and re-estimates: it does not"]),
        (
            ALWAYS | {"memory": 20_000},
            ["the test: it re-estimates always", "rounds longer", *OPEN_ABOUT_RE_ESTIMATES],
        ),
        (
            {"filter_period": 5, "comms_period": 5, "memory": 20_004},
            ["thresholds", "rounds without a test", "forgetting", *OPEN_ABOUT_RE_ESTIMATES],
        ),
    ],
)
def test_a_verdict_lists_what_was_not_checked(config: dict[str, Any], first_lines: list[str]) -> None:
    """The beginnings of the lines: those of this configuration, and those that no verification checks."""
    verdict = verify(right_controller(**config), surroundings(right(**config)), PHASES[:1])
    lines = [line for line in verdict.not_checked if not line.startswith("whether it ")]
    for line, beginning in zip(lines, first_lines + ALWAYS_OPEN, strict=True):
        assert line.startswith(beginning)


# --- Wrong controllers ---


MISTAKE_BY_PHASE = {
    wrong.phase: name for name, wrong in WRONG.items() if wrong.config.get("filter") is not Filter.ROBUST
}
SAMPLE = [*MISTAKE_BY_PHASE.values()][::6]
"""A mistake for a sixth of the phases that find any, as each takes a second; the slow tests have all."""


@pytest.mark.slow
@pytest.mark.parametrize("name", SAMPLE)
def test_a_wrong_controller_is_found(name: str) -> None:
    assert verify_wrong(WRONG[name]).difference is not None


@pytest.mark.slow
@pytest.mark.parametrize("name", WRONG)
def test_a_wrong_controller_of_the_default_configuration_fails_in_the_phase_of_its_mistake(
    name: str,
) -> None:
    verdict = verify_wrong(WRONG[name], config=DEFAULT)
    assert verdict.difference is not None
    assert verdict.difference.startswith(f'phase "{WRONG[name].phase}'), verdict
    outcomes = [phase.outcome for phase in verdict.phases]
    failed_index = outcomes.index("failed")

    assert set(outcomes[:failed_index]) <= {"passed"}
    assert set(outcomes[failed_index + 1 :]) <= {"not run"}


ONLY_BY_DEFAULT = {
    "variance of the prediction alone",
    "t of 14 bits in eq. 8",
    "four estimates are enough",
}
"""Mistakes that some seeds show with the default configuration alone.

With the short one both variances decide alike, and all re-estimates come before 2^14 observations. With a
b_hat of 0.55 few observations do not contradict four estimates."""


@pytest.mark.slow
def test_a_wrong_controller_is_found_with_any_seed() -> None:
    seed = random.randrange(2**32)
    for name, wrong in WRONG.items():
        config = DEFAULT if name in ONLY_BY_DEFAULT else QUICK
        assert verify_wrong(wrong, seed, config).difference is not None, (seed, name)


# --- Known mistakes ---


MISTAKES_SHOWN_LATE = [mistake for mistake in KNOWN_MISTAKES if "14 bits" in mistake.name]
MISTAKES_SHOWN_EARLY = [mistake for mistake in KNOWN_MISTAKES if mistake not in MISTAKES_SHOWN_LATE]


@pytest.mark.parametrize(
    "mistake", [*MISTAKES_SHOWN_EARLY, *slow(MISTAKES_SHOWN_LATE)], ids=lambda mistake: mistake.name
)
def test_a_verdict_names_the_known_mistake_that_a_controller_makes(mistake: KnownMistake) -> None:
    filter_kind = next(iter(mistake.filters))
    config = QUICK | ({} if filter_kind is Filter.ADAPTIVE else {"filter": filter_kind, "table": None})
    setup = record(**{"robot": ID, "firmware": "mirror", **config})

    def make_robot() -> MirrorRobot:
        return mistake.make_model(MirrorRobot(setup.config, setup.id, setup.b_hat))

    verdict = verify(RobotNode(setup, make=make_robot), surroundings(right(**config)))
    _, _, named_mistakes = str(verdict.difference).partition("so would answer a controller that ")
    assert mistake.name in named_mistakes.split(", or one that ")


def test_a_verdict_lists_the_mistakes_that_no_frame_would_have_shown() -> None:
    verdict = verify(right_controller(**VOTES), surroundings(right(**VOTES)), phases_named("alone"))
    line = "whether it tests in float32: no frame of this run would have shown it"
    assert line in verdict.not_checked


@pytest.mark.slow
def test_a_run_of_all_phases_leaves_no_known_mistake_open() -> None:
    verdict = verify(right_controller(**VOTES), surroundings(right(**VOTES)))
    assert not [line for line in verdict.not_checked if line.startswith("whether it ")]


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


LATE_DIFFERENCES = ["rejects its own estimate"]
"""Differences that come in a late phase, after seconds."""


@pytest.mark.parametrize("name", [*sorted(DIFFERENCES.keys() - LATE_DIFFERENCES), *slow(LATE_DIFFERENCES)])
def test_a_difference_names_the_field_with_the_expected_and_the_received_value(name: str) -> None:
    difference = verify_wrong(WRONG[name]).difference
    assert difference is not None
    time_pattern = r'phase "[^"]+"( \(.*?\))?, tick \d+: '
    assert re.match(time_pattern + DIFFERENCES[name], difference), difference


# --- Other nodes on the bus ---


def verify_beside(message: Any) -> ControllerVerdict:
    """Verify a right controller beside a node that answers every command with a message."""

    def receive_frame(frame: can.Message) -> list[can.Message]:
        return [encoded(message)] if isinstance(decode_command(frame), Command) else []

    other_node = Mock()
    other_node.start.return_value = []
    other_node.receive_frame.side_effect = receive_frame
    return verify(Wire(right_controller(), other_node), phases=PHASES[:2])


@pytest.mark.parametrize(
    "message",
    [Heartbeat(40, 7, 0), Telemetry(40, 7, 16, 0, 0), Command(40, 1000, 77, Action.SETTLE, 0)],
)
def test_a_controller_passes_beside_a_node_that_does_not_concern_it(message: Any) -> None:
    """Node 40 answers each command with a heartbeat, telemetry, or a command to robot 77."""
    assert verify_beside(message).has_passed


@pytest.mark.parametrize(
    ("message", "kind"),
    [
        (Estimate(40, 1 << 22, 0x80000001, 0), "estimates"),
        (Command(40, 1000, ID, Action.OBSERVE_BLACK, 0), "commands"),
        (Command(40, 1000, 255, Action.SETTLE, 0), "commands"),
    ],
)
def test_a_node_that_the_controller_acts_on_is_named_and_not_blamed_on_it(message: Any, kind: str) -> None:
    """Node 40 sends estimates, or commands to this robot or to all (255)."""
    verdict = verify_beside(message)
    assert verdict.difference is None
    assert verdict.phases[0].outcome == "disturbed"
    assert verdict.headline.startswith("DISTURBED, no verdict: 0 of")
    assert f"node 40 sends {kind} on this bus, too" in verdict.headline


# --- Frames that a controller may send ---


def with_health(severity: int, from_tick: int | None = None) -> Wrong:
    """Return a controller whose heartbeats have this health after a tick left open, or from some tick on."""

    def observe(node: RobotNode, usual: Any, z: Observation | None) -> Any:
        *heartbeats, estimate = usual(z)
        is_from_tick = from_tick is not None and node.ticks >= from_tick
        for frame in heartbeats:
            frame.data[4] = severity if node.unsettled > 0 or is_from_tick else 0
        return [*heartbeats, estimate]

    return with_node("", observe=observe)


def test_a_controller_may_report_a_tick_left_open_as_advice() -> None:
    """Its heartbeat may say advisory (1) when a command to end a tick did not come, as in some phases."""
    controller = with_health(severity=1).make(QUICK)
    assert verify(controller, phases=PHASES[1:7]).difference is None
    assert controller.unsettled > 0


@pytest.mark.parametrize("wrong", [with_health(severity=1, from_tick=30), with_health(severity=2)])
def test_a_controller_may_report_nothing_else_in_its_health(wrong: Wrong) -> None:
    """Neither advisory (1) before a tick was left open, nor caution (2)."""
    verdict = verify(wrong.make(QUICK), phases=PHASES[1:7])
    assert "heartbeat, health: expected" in str(verdict.difference)


def test_frames_of_the_controller_of_other_subjects_are_not_compared() -> None:
    frame = can.Message(arbitration_id=4 << 26 | 3 << 21 | 7510 << 8 | ID, data=b"any")
    controller = with_node("", settle=lambda node, usual: [*usual(), frame]).make(QUICK)
    assert verify(controller, phases=PHASES[:1]).has_passed


class WireWithLateFrame(Wire):
    """A wire on which a controller settles once more after its last answer."""

    def __init__(self, controller: RobotNode, last_tick: int) -> None:
        super().__init__(controller)
        self._controller = controller
        self._last_tick = last_tick
        self._has_sent_late = False

    def recv(self, timeout: float | None = None) -> can.Message | None:
        frame = super().recv(timeout)
        is_over = self._controller.ticks == self._last_tick and self._controller.is_settled
        if frame is None and timeout and is_over and not self._has_sent_late:
            self._has_sent_late = True
            self.say(self._controller, self._controller.settle()[:1])
            frame = super().recv(timeout)
        return frame


def test_a_frame_that_a_controller_sends_after_its_last_answer_is_found() -> None:
    wire = WireWithLateFrame(right_controller(), last_tick=72)
    verdict = verify(wire, phases=phases_named("alone"))
    assert "telemetry, extra: expected nothing" in str(verdict.difference)


def test_other_nodes_delay_the_verdict_by_a_tenth_of_a_second_at_most(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Node 40 sends heartbeats without end, so the bus is never quiet. Each takes 0.01 s."""
    monkeypatch.setattr(controller_link, "time", CLOCK)
    wire = EndlessWire()
    assert verify(wire, phases=[Phase("nothing", lambda bench: None)]).has_passed
    assert 10 <= wire.frames <= 12


# --- The run ---


def test_a_verification_may_be_stopped_between_two_ticks() -> None:
    """It is asked to stop when 75 ticks are done; five of the 80 until then were left open."""
    controller, ticks = right_controller(), list[int]()

    verdict = verify(controller, progress=ticks.append, should_stop=lambda: len(ticks) == 75)

    assert verdict.is_interrupted
    assert not verdict.has_passed
    assert verdict.difference is None
    assert [phase.ticks for phase in verdict.phases[:3]] == [20, 60, 0]
    assert [phase.outcome for phase in verdict.phases[:3]] == ["passed", "not run", "not run"]
    assert controller.ticks == 20 + 60
    assert controller.is_settled
    assert verdict.headline.startswith("INTERRUPTED: 1 of")


@pytest.mark.parametrize("wire_class", [Wire, EndlessWire])
def test_a_verification_may_be_stopped_while_it_waits(wire_class: type[Wire]) -> None:
    """For a controller that is not there, on a quiet bus or on one that is never quiet."""
    verdict = verify(wire_class(), wait=1e9, should_stop=lambda: True)
    assert (verdict.is_interrupted, verdict.difference) == (True, None)


def test_commands_that_the_bus_loses_are_repeated_and_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    wire, frame_numbers = Wire(right_controller()), count(1)
    send = wire.send

    def lose_two(frame: can.Message, timeout: float | None = None) -> None:
        if next(frame_numbers) not in (11, 21):  # an observe and a settle
            send(frame, timeout)

    monkeypatch.setattr(wire, "send", lose_two)
    assert verify(wire, phases=PHASES[1:4]).headline.endswith("; 2 commands were repeated")


def test_a_bus_that_fails_is_not_blamed_on_the_controller(monkeypatch: pytest.MonkeyPatch) -> None:
    wire = Wire(right_controller())
    monkeypatch.setattr(wire, "send", Mock(side_effect=can.CanOperationError("cable pulled")))
    headline = verify(wire).headline

    assert headline.startswith("DISTURBED, no verdict: 0 of")
    assert "cable pulled" in headline


def test_a_controller_that_starts_while_it_is_waited_for_passes() -> None:
    assert verify(right_controller(), phases=PHASES[:3], wait=0.05).has_passed


def test_a_controller_that_does_not_start_fails_in_the_first_phase() -> None:
    """It is on the bus, but has sent no heartbeat."""
    silent_wire = Wire()
    silent_wire.nodes.append(right_controller())
    verdict = verify(silent_wire, phases=PHASES[:3], wait=0.05)
    expected = 'phase "nothing seen", tick 0: robot 3 did not send a heartbeat '

    assert str(verdict.difference).startswith(expected)
    assert [phase.outcome for phase in verdict.phases] == ["failed", "not run", "not run"]


def test_a_wrong_first_heartbeat_is_compared_with_the_right_one() -> None:
    def start(node: RobotNode, usual: Any) -> list[can.Message]:
        (heartbeat,) = usual()
        heartbeat.data[5] = 2
        return [heartbeat]

    verdict = verify(with_node("", start=start).make(QUICK), phases=PHASES[:1])
    assert "heartbeat, mode: expected 107D5503" in str(verdict.difference)
    assert verdict.phases[0].outcome == "failed"


@pytest.mark.parametrize("first_heartbeats", [0, 1, 3])
def test_a_controller_passes_after_any_number_of_resets(first_heartbeats: int) -> None:
    """After each it has sent its first heartbeat again, and these wait to be received."""
    wire = Wire(right_controller())
    wire._waiting.clear()
    wire._waiting.extend(wire.told * first_heartbeats)
    assert verify(wire, phases=PHASES[:2]).has_passed


# --- The command ---

CONTROLLER = f"--id {ID} --b-hat {B_HAT} --filter-period 10 --neighbours 20"


def radio(options: str) -> int:
    return main(["radio", "--interface", "virtual", *shlex.split(options)])


@pytest.mark.slow
def test_a_verification_leaves_a_report_and_a_log_to_replay(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    report_path, log_path = tmp_path / "report.md", tmp_path / "run.log"
    config = "--memory 64"
    with node_in_a_thread(f"{CONTROLLER} {config}"):
        options = f"{CONTROLLER} {config} --verify --robots 5 --timeout 20 --steps 10 --json"
        assert radio(f"{options} --report '{report_path}' --log '{log_path}'") == 0
    report = json.loads(capsys.readouterr().out)
    verdict, parameters = report["verdict"], report["parameters"]

    assert verdict["passed"]
    names = {phase["name"] for phase in verdict["phases"]}
    not_played = {"no filter", "re-estimates without a test", "long run"} | ROBUST_PHASES
    assert names == {phase.name for phase in PHASES} - not_played
    assert parameters["controller"] == record(ID, "mirror", B_HAT, memory=64).plain()
    assert (parameters["seed"], parameters["steps"]) == (1, 10)

    markdown = report_path.read_text()
    assert f"**PASSED: {len(names)} of {len(names)} phases passed;" in markdown
    assert "\nNot checked:\n\n- thresholds of rounds" in markdown
    assert json.loads(markdown.partition("```json\n")[2].partition("```")[0])["parameters"] == parameters
    rows = [
        [cell.strip() for cell in line.split("|")[1:-1]]
        for line in markdown.splitlines()
        if line.startswith("| ")
    ]
    columns = ("name", "ticks", "injected", "equal", "outcome", "fault")
    assert rows[2:] == [[str(phase[name] or "") for name in columns] for phase in verdict["phases"]]

    assert main(["replay", str(log_path)]) == 0
    ticks = sum(phase["ticks"] for phase in verdict["phases"])
    assert f"{ticks}  broadcasts reproduced" in capsys.readouterr().out


def test_a_report_has_a_table_of_the_phases_and_lists_of_what_was_not_checked() -> None:
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
def test_radio_fails_on_a_wrong_controller_and_prints_the_first_difference(
    capsys: pytest.CaptureFixture[str], config: str, phases: int
) -> None:
    """The controller assumes an accuracy of 0.56, and 0.55 is expected."""
    controller = f"--id {ID} --filter-period 10 {config}"
    with node_in_a_thread(f"{controller} --b-hat 0.56"):
        assert radio(f"{controller} --b-hat {B_HAT} --verify --timeout 20") == 1
    line = f'FAILED: 0 of {phases} phases passed; first in phase "nothing seen" (no observation), tick 0'

    assert line in capsys.readouterr().out
