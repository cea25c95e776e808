"""The verdict on a controller: a right controller passes, and a wrong one fails at its mistake.

A controller is a robot under test. The tool, ``mcp-asdf radio --verify``, gives it observations and messages,
phase after phase, and compares its frames with those of a model, the same robot in Python.
"""

from __future__ import annotations

import json
import math
import random
import re
from collections.abc import Iterator, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import can
import pytest

from golden import assert_equals_golden_file
from mcp_asdf.robot import Filter, FixedPointRobot, Observation
from mcp_asdf_tools.bus.frame_layout import EVERY_ROBOT, Action, Health, Mode
from mcp_asdf_tools.bus.frames import Command, Estimate, Heartbeat, Telemetry, decode_command
from mcp_asdf_tools.cli.main import main
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.common.signals import INTERRUPTED
from mcp_asdf_tools.crosscheck import crafted_rounds
from mcp_asdf_tools.radio import controller_link, robust_phases
from mcp_asdf_tools.radio.bench import Bench
from mcp_asdf_tools.radio.controller_link import BenchOptions
from mcp_asdf_tools.radio.neighbourhood import RadioSettings
from mcp_asdf_tools.radio.phases import PHASES, Phase, can_wait_for_tests
from mcp_asdf_tools.radio.verification import (
    ControllerVerdict,
    PhaseResult,
    Verification,
    details,
    plan_phases,
)
from mcp_asdf_tools.robots.node import RobotNode
from messages import encoded
from support import blocks, slow
from wire import CLOCK, EndlessWire, Wire, frozen_clock, node_in_a_thread, radio, setup_of_robot
from wrong_robots import (
    B_HAT,
    DEFAULT_CONFIG,
    FILTER_WITHOUT_TEST,
    ID,
    ROBUST_FILTER,
    WRONG,
    Wrong,
    right_setup,
    settings_with_four_neighbours,
    with_node,
)

pytestmark = pytest.mark.usefixtures("private_setup")

TICKS = 25
"""Ticks of a phase among neighbours."""
SHORT_RUN_CONFIG: dict[str, Any] = {"b_hat": B_HAT}
"""A configuration with which a verification has few ticks."""
NO_FILTER: dict[str, Any] = {"filter": Filter.OFF, "table": None}

CRAFTED_PHASES = tuple(phase for phase in PHASES if phase.play is not None)
"""Phases written for their purpose, round by round; the others are among neighbours."""


def phases_named(*names: str) -> list[Phase]:
    return [phase for phase in PHASES if phase.name in names]


def right_controller(firmware: str = "native", **config: Any) -> RobotNode:
    return RobotNode(right_setup(**{"firmware": firmware, **config}))


def controller_with(**methods: Any) -> RobotNode:
    """Return a controller with other methods; each gets the node, the right method and its arguments."""
    return with_node("", **methods).make(SHORT_RUN_CONFIG)


def verify(
    controller: RobotNode | Wire,
    settings: RadioSettings | None = None,
    phases: Sequence[Phase] = PHASES,
    **options: Any,
) -> ControllerVerdict:
    """Return the verdict on a controller, which is alone or on a wire."""
    wire = controller if isinstance(controller, Wire) else Wire(controller)
    bench_options = BenchOptions(wire, TICKS, timeout=0.05, **options)
    with frozen_clock():
        return Verification(settings or settings_with_four_neighbours(), bench_options, phases).run()


def verify_right_controller(
    config: dict[str, Any], phases: Sequence[Phase], faults: str = ""
) -> ControllerVerdict:
    """Return the verdict on a right controller with this configuration."""
    return verify(
        right_controller(**config),
        settings_with_four_neighbours(right_setup(**config), faults=faults),
        phases,
    )


def verify_wrong_controller(
    wrong: Wrong, seed: int = 6, config: dict[str, Any] = SHORT_RUN_CONFIG
) -> ControllerVerdict:
    """Return the verdict on a wrong controller, with other settings that by default make it short."""
    settings = settings_with_four_neighbours(right_setup(**config | wrong.config), seed=seed)
    return verify(wrong.make(config), settings)


# --- Right controllers ---


@dataclass(frozen=True)
class ObservedRun:
    """A finished verification of a right controller, and what was seen of it.

    Attributes:
        name: The name of its golden file, which follows "verification_".
        config: The configuration of the controller, where it is not the usual one.
        controller: The controller.
        wire: The wire between the tool and the controller.
        verification: The verification.
        settled_ticks: Numbers of ticks that it reported as done.
        frame_counts: Number of frames that the tool had sent at the end of each phase, by index of the phase.
    """

    name: str
    config: dict[str, Any]
    controller: RobotNode
    wire: Wire
    verification: Verification
    settled_ticks: list[int]
    frame_counts: dict[int, int]

    @property
    def verdict(self) -> ControllerVerdict:
        """The verdict on the controller."""
        return self.verification.verdict


def observe_run(name: str, config: dict[str, Any], phases: Sequence[Phase]) -> ObservedRun:
    """Verify a right controller with this configuration, and return what was seen of it."""
    controller = right_controller(**config)
    wire = Wire(controller)
    settled_ticks: list[int] = []
    frame_counts: dict[int, int] = {}

    def progress(tick: int) -> None:
        settled_ticks.append(tick)
        outcomes = [phase.outcome for phase in verification.verdict.phases]
        frame_counts[outcomes.index("not run")] = len(wire.sent)  # so it is the phase that is running

    options = BenchOptions(wire, TICKS, timeout=0.05, progress=progress)
    with frozen_clock():
        verification = Verification(settings_with_four_neighbours(right_setup(**config)), options, phases)
        verification.run()
    return ObservedRun(name, config, controller, wire, verification, settled_ticks, frame_counts)


def describe_run(run: ObservedRun) -> Iterator[str]:
    """Yield one line per phase, with its ticks, how many frames the tool has sent, and two sums of these.

    A line changes if the tool sends other frames in that phase, or the same ones in another order.
    """
    first_frame = 0
    for phase_index, result in enumerate(run.verdict.phases):
        next_frame = run.frame_counts.get(phase_index, first_frame)
        frames = run.wire.sent[first_frame:next_frame]
        byte_sum = sum(sum(frame.data) for frame in frames)
        sum_by_place = sum(place * sum(frame.data) for place, frame in enumerate(frames))
        yield (
            f"{result.name}: {result.ticks} ticks, {len(frames)} frames; "
            f"sum of all bytes {byte_sum}, times the place of their frame {sum_by_place}"
        )
        first_frame = next_frame


ALL_PHASES_CONFIGS: dict[str, dict[str, Any]] = {
    "all_phases_memory_64": {"memory": 64},
    "all_phases_robust": ROBUST_FILTER,
    "all_phases": {},
}
"""Configurations of right controllers by the name of the golden file that has the frames of their run."""


@pytest.fixture(
    name="run", scope="module", params=["all_phases_memory_64", *slow(["all_phases_robust", "all_phases"])]
)
def run_of_all_phases(request: pytest.FixtureRequest) -> ObservedRun:
    """A verification of a right controller in all phases that is over."""
    return observe_run(request.param, ALL_PHASES_CONFIGS[request.param], PHASES)


def test_a_right_controller_passes_every_phase(run: ObservedRun) -> None:
    """In each phase it sends the same frames as the model. It answers each command at once."""
    assert run.verdict.has_passed, run.verdict.headline
    assert run.verdict.repeated == 0, "commands sent again because the controller had not answered"


def test_each_phase_reports_its_ticks_and_the_faults_that_it_injected(run: ObservedRun) -> None:
    """``injected`` is above 0 in the phases that have a fault, and 0 in the others.

    The user asks for 25 ticks of each phase that is not written round by round but played among neighbours.
    """
    phase_by_name = {phase.name: phase for phase in PHASES}
    for result in run.verdict.phases:
        phase = phase_by_name[result.name]
        is_among_neighbours = phase.play is None
        if is_among_neighbours:
            assert result.ticks == 25
        has_fault = phase.fault != ""
        assert (result.injected > 0) == has_fault


def test_each_phase_reports_one_or_two_frames_a_tick_that_equal_those_of_the_model(run: ObservedRun) -> None:
    """``equal`` counts an estimate in every tick, telemetry in most, and a heartbeat in every tenth."""
    for result in run.verdict.phases:
        most_heartbeats = result.ticks / 10 + 1  # rounded up
        most_frames = result.ticks + result.ticks + most_heartbeats  # estimates, telemetry, heartbeats
        assert result.ticks > 0
        assert result.ticks < result.equal <= most_frames


def test_all_frames_of_a_right_controller_are_compared_with_those_of_the_model(run: ObservedRun) -> None:
    """``equal_frames`` has an estimate a tick, a heartbeat each tenth tick, and telemetry for each settle.

    The verdict on the phases has the same number of ticks as the controller.
    """
    ticks = run.controller.ticks
    assert ticks == sum(result.ticks for result in run.verdict.phases)
    assert run.verification.bench.comparison.equal_frames == {
        "estimate": ticks,
        "heartbeat": (ticks - 1) // 10,  # but for the first heartbeat, which came before
        "telemetry": len(run.settled_ticks),  # all ticks but those that were left open
    }


def test_the_model_of_a_verification_ends_in_the_state_of_the_controller(run: ObservedRun) -> None:
    """The model is a robot in Python that gets the same messages.

    By then it has re-estimated b_hat often and, unless its memory is short, has observed many tiles.
    """
    robot = run.controller.robot
    model = run.verification.bench.model_robot
    assert isinstance(robot, FixedPointRobot)
    assert robot.state() == model.state()
    assert robot.counters == model.counters
    assert model.s.updates > 10, "re-estimates of b_hat"
    has_short_memory = "memory" in run.config
    assert model.s.t > 10_000 or has_short_memory, "observations"


def test_a_run_of_all_phases_sends_the_same_frames_as_at_an_earlier_commit(run: ObservedRun) -> None:
    """A golden file has what the tool sent then. So the seed in a report is enough to repeat a run."""
    assert_equals_golden_file(f"verification_{run.name}.txt", list(describe_run(run)))


SLOW_CONFIG = {"comms_period": 5, "filter_period": 20, "memory": 512, **FILTER_WITHOUT_TEST}


@pytest.mark.parametrize(
    ("name", "config", "phases"),
    [
        ("no_filter", NO_FILTER, phases_named("first black tiles", "no filter")),
        ("memory_80", {"memory": 80}, phases_named("alone", "messages and silence", "halvings")),
        ("memory_76", {"memory": 76}, phases_named("first black tiles", "halvings")),
        *slow([("always", SLOW_CONFIG, CRAFTED_PHASES)]),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_a_run_of_some_phases_sends_the_same_frames_as_at_an_earlier_commit(
    name: str, config: dict[str, Any], phases: Sequence[Phase]
) -> None:
    """A golden file has what the tool sent then. So the seed in a report is enough to repeat a run.

    The controller is right, so that no difference ends the run early.
    """
    run = observe_run(name, config, phases)
    assert run.verdict.difference is None
    assert_equals_golden_file(f"verification_{name}.txt", list(describe_run(run)))


PERIODS = [
    {"comms_period": 5, "filter_period": 10},
    {"comms_period": 1, "filter_period": 1},
    {"comms_period": 40, "filter_period": 600},
]
CONFIGS: list[dict[str, Any]] = [
    NO_FILTER,
    FILTER_WITHOUT_TEST,
    FILTER_WITHOUT_TEST | {"comms_period": 5},
    {"filter_period": 997, "memory": 2048},
    *PERIODS,
    {"comms_period": 10, "filter_period": 10},
    {"comms_period": 1, "filter_period": 2},
    {"robot": 0, "b_hat": 2**-20},
    {"robot": 1, "b_hat": 0.02},
    {"robot": 125, "b_hat": 0.75},
    {"robot": 127, "b_hat": 0.95},
    *({"b_hat": b_hat} for b_hat in (0.4999, 0.5, 1 - 2**-20)),
    # With the robust filter a verification takes longer, so there are fewer.
    *(ROBUST_FILTER | periods for periods in PERIODS[:2]),
    *(ROBUST_FILTER | {"b_hat": b_hat} for b_hat in (0.02, 0.5, 1 - 2**-20)),
    ROBUST_FILTER | {"memory": 64},
]


@pytest.mark.slow
@pytest.mark.parametrize("config", CONFIGS, ids=str)
def test_a_right_controller_of_another_configuration_passes(config: dict[str, Any]) -> None:
    """Observations and neighbours are drawn from a seed. The seed is new each time."""
    seed = random.randrange(2**32)
    setup = right_setup(firmware="native", **config)
    verdict = verify(RobotNode(setup), settings_with_four_neighbours(setup, seed=seed))
    assert verdict.has_passed, (seed, verdict.headline)


# --- What is put to the test ---


def phases_of_module(name: str) -> set[str]:
    """Return the names of the phases that are defined in a module of the tools with this name."""
    return {phase.name for phase in CRAFTED_PHASES if phase.play and name in phase.play.__module__}


ROBUST_PHASES = phases_of_module("robust_phases")
"""Names of the phases of the robust filter."""
ASDF_PHASES = phases_of_module("filter_phases") - {"no filter", "halvings", "long run"}
"""Names of the phases of the paper's filters, with or without a test."""
THRESHOLD_PHASES = {name for name in ASDF_PHASES if name.startswith("threshold of")}
PHASES_OF_INFORMATION = {
    "threshold of few estimates",
    "test of a wide spread",
    "dependent observations",
    "test of the least spread",
}
"""Names of the phases in which estimates decide a test of the robust filter."""
PHASES_OF_LONG_MEMORY = {"supporters", "no confidence of its own", "estimates far apart"}
"""Names of the phases in which many observations contradict estimates, with a b_hat that is not near 1."""
TEST_PHASES = THRESHOLD_PHASES | {"large sums", "own estimate"}
"""Names of the phases of the test of the paper's filter."""


@pytest.mark.parametrize(
    ("config", "omitted_phases"),
    [
        ({"memory": 64}, {"no filter", "re-estimates without a test", "long run"} | ROBUST_PHASES),
        ({}, {"no filter", "re-estimates without a test", "halvings"} | ROBUST_PHASES),
        (FILTER_WITHOUT_TEST, {"no filter", "halvings"} | TEST_PHASES | ROBUST_PHASES),
        (ROBUST_FILTER, {"no filter", "halvings"} | ASDF_PHASES),
        (ROBUST_FILTER | {"b_hat": 0.95}, {"no filter", "halvings", "estimates far apart"} | ASDF_PHASES),
        (
            ROBUST_FILTER | {"b_hat": 0.5},
            {"no filter", "halvings"} | ASDF_PHASES | PHASES_OF_INFORMATION | PHASES_OF_LONG_MEMORY,
        ),
        (ROBUST_FILTER | {"memory": 64}, {"no filter", "long run"} | ASDF_PHASES | PHASES_OF_LONG_MEMORY),
        (NO_FILTER, {"halvings"} | ASDF_PHASES | ROBUST_PHASES),
    ],
)
def test_phases_that_do_not_apply_to_a_controller_are_left_out(
    config: dict[str, Any], omitted_phases: set[str]
) -> None:
    """Phases of other filters are left out, and "halvings" for a long memory, or "long run" for a short one.

    With the robust filter, tests are left out that no observations can bring about. With a b_hat of 1/2
    estimates decide no test. With a b_hat of 0.95, estimates that are far apart contradict no observations.
    """
    settings = settings_with_four_neighbours(right_setup(**config))
    planned_phases, _faults = plan_phases(settings, PHASES, ticks=25)

    names_of_planned_phases = {phase.name for phase in planned_phases}
    assert {phase.name for phase in PHASES} - names_of_planned_phases == omitted_phases


def test_each_fault_that_the_user_asks_for_is_one_more_phase() -> None:
    """The user's two faults follow the phases. The phase "liar" has its own fault, of the first neighbour.

    A fault's defaults are filled in: a liar lies in all cases, so its rate is 1.0.
    """
    settings = settings_with_four_neighbours(faults="loss=0.7,receivers=3 liar,robots=1,x=0")
    phases, _faults = plan_phases(settings, phases_named("alone", "liar"), ticks=25)

    assert [(phase.name, phase.fault) for phase in phases] == [
        ("alone", ""),
        ("liar", "liar=1,x=1,alpha=1e38,robots=0"),
        ("loss", "loss=0.7,receivers=3"),
        ("liar", "liar=1.0,robots=1,x=0.0"),
    ]


def test_a_phase_with_a_fault_lasts_for_two_broadcasts_of_a_slow_controller() -> None:
    """It broadcasts every 40 ticks, so a phase lasts 80. The user asks for the fault of phase "loss"."""
    config = {"comms_period": 40, "filter_period": 600}
    verdict = verify_right_controller(config, phases_named("liar"), faults="loss=0.7,receivers=3")

    liar, loss = verdict.phases
    assert liar.ticks == loss.ticks == 2 * 40
    assert liar.outcome == loss.outcome == "passed"
    assert liar.injected > 0
    assert loss.injected > 0


@pytest.mark.parametrize(
    ("config", "faults", "untested_feature"),
    [
        ({}, "loss=0", 'the fault of phase "loss"'),
        ({"filter_period": 20_001}, "", "the filter: its period is too long for a run"),
    ],
)
def test_a_controller_does_not_pass_if_something_was_never_put_to_the_test(
    config: dict[str, Any], faults: str, untested_feature: str
) -> None:
    """The headline names a fault that never hits, as its rate is 0, or a filter that runs too rarely."""
    verdict = verify_right_controller(config, phases_named("nothing seen", "alone"), faults)

    assert not verdict.has_passed
    assert verdict.headline.startswith("NOT EXERCISED: ")
    assert verdict.headline.endswith(f", no difference, but never put to the test: {untested_feature}")


def test_a_verification_waits_for_the_next_test_of_a_filter_for_20_000_ticks_at_most() -> None:
    """``filter_period`` is the number of ticks from one test to the next. A verification needs 20 tests."""
    assert can_wait_for_tests(right_setup(filter_period=20_000))
    assert not can_wait_for_tests(right_setup(filter_period=20_001))


def test_a_phase_does_not_wait_for_a_filter_that_runs_too_rarely() -> None:
    """The filter runs every 20,001 ticks. A phase that waited for it would last as long."""
    verdict = verify_right_controller({"filter_period": 20_001}, phases_named("nothing seen"))
    (phase,) = verdict.phases
    assert phase.ticks < 1000


def test_a_verdict_lists_the_observations_before_a_test_of_the_robust_filter_that_were_not_found(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """In three phases the tool searches for observations after which a test just rejects, or just does not.

    Their tests are against 5, 6 and 32 estimates. Here the tool may not try any observations, so it finds
    none, and ``not_exercised`` has an entry for each search.
    """
    monkeypatch.setattr(robust_phases, "_MAX_BURSTS", 0)  # the largest number of bursts of observations
    phases = phases_named("alone", "threshold of few estimates", "test of a wide spread", "many rejections")
    verdict = verify_right_controller(ROBUST_FILTER, phases)

    assert verdict.difference is None
    # Two searches for each number of estimates: of two widths, or of the same one twice. The phase "many
    # rejections" searches once.
    assert verdict.not_exercised == [
        "observations before a test of 5 estimates",
        "observations before a test of 5 estimates",
        "observations before a test of 6 estimates",
        "observations before a test of 6 estimates",
        "observations before a test of 32 estimates",
        "observations before a test of 32 estimates",
        "observations until the test rejects",
    ]


def test_a_verdict_lists_the_results_of_a_re_estimate_for_which_no_messages_were_found(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Messages are drawn that lead b_hat to each of five values. No draw succeeds, and all are listed."""
    monkeypatch.setattr(crafted_rounds, "_MAX_DRAWS_FOR_UPDATE", 0)  # as if all attempts had been in vain

    verdict = verify(right_controller(), phases=phases_named("first black tiles", "re-estimates"))

    assert verdict.difference is None
    assert verdict.not_exercised == [
        "a re-estimate: b_hat above 1/2, off the limit",
        "a re-estimate: b_hat below 1/2, off the limit",
        "a re-estimate: b_hat at its upper limit",
        "a re-estimate: b_hat at its lower limit",
        "a re-estimate: b_hat kept, as x_bar is 1/2",
    ]


RE_ESTIMATES_NOT_CHECKED = [
    "a re-estimate before its first white tile",
    "a counter of more than 257 updates",
    "a re-estimate from tiles of both colours",
]
NEVER_CHECKED = [
    "more than 505 messages in a tick",
    "its own clock",
    "saving and restoring",
    "its behaviour on a bus",
    "vendor status",
    "the largest alpha",
    "counts above t = ",
]
"""Beginnings of the lines about what no verification checks, whatever the configuration."""


@pytest.mark.parametrize(
    ("config", "beginnings_for_config"),
    [
        (
            {},
            [
                "thresholds of rounds of",
                "rounds longer",
                "forgetting: its memory is 2147483648",
                *RE_ESTIMATES_NOT_CHECKED,
            ],
        ),
        (NO_FILTER | {"memory": 64, "comms_period": 5}, ["the test and re-estimates: it does not"]),
        (
            FILTER_WITHOUT_TEST | {"memory": 20_000},
            ["the test: it re-estimates always", "rounds longer", *RE_ESTIMATES_NOT_CHECKED],
        ),
        (
            ROBUST_FILTER | {"memory": 64, "b_hat": 0.5},
            [
                "rounds longer",
                "a counter of more than 257 updates",
                "rounding of its test",
                "the last step",
                "its test at the threshold",
                "those that support it, and a b_hat of exactly 1/2",
                "the largest spread in its test",
            ],
        ),
        (
            ROBUST_FILTER | {"b_hat": 0.95},
            [
                "rounds longer",
                "forgetting",
                "a counter of more than 257 updates",
                "rounding of its test",
                "the last step",
                "the largest spread in its test",
            ],
        ),
        (
            {"filter_period": 5, "comms_period": 5, "memory": 20_004},
            ["thresholds", "rounds without a test", "forgetting", *RE_ESTIMATES_NOT_CHECKED],
        ),
    ],
)
def test_a_verdict_lists_what_was_not_checked(
    config: dict[str, Any], beginnings_for_config: list[str]
) -> None:
    """Lines about this configuration come first, then the lines of every verdict.

    Only their beginnings are compared.
    """
    verdict = verify_right_controller(config, phases_named("nothing seen"))

    expected_beginnings = beginnings_for_config + NEVER_CHECKED
    for line, beginning in zip(verdict.not_checked, expected_beginnings, strict=True):
        assert line.startswith(beginning)


# --- Wrong controllers ---


@pytest.mark.slow
@pytest.mark.parametrize("mistake", WRONG)
def test_a_wrong_controller_fails_in_the_phase_that_is_about_its_mistake(mistake: str) -> None:
    """The verdict names this phase. The phases before it have passed, and those after it are not run.

    WRONG has a wrong controller for each mistake that its maker may make, and the phase that finds it.
    """
    wrong_controller = WRONG[mistake]
    verdict = verify_wrong_controller(wrong_controller, config=DEFAULT_CONFIG)

    assert str(verdict.difference).startswith(f'phase "{wrong_controller.phase}'), verdict
    outcomes = [phase.outcome for phase in verdict.phases]
    failed_index = outcomes.index("failed")
    earlier_outcomes = outcomes[:failed_index]
    later_outcomes = outcomes[failed_index + 1 :]
    assert all(outcome == "passed" for outcome in earlier_outcomes)
    assert all(outcome == "not run" for outcome in later_outcomes)


SHOWN_WITH_DEFAULTS_ALONE = {
    "variance of the prediction alone",
    "t of 14 bits in eq. 8",
    "table: four estimates",
}
"""Mistakes that some seeds show with the default configuration alone.

With the short one both variances decide alike, and all re-estimates come before 2^14 observations. With a
b_hat of 0.55 few observations do not contradict four estimates."""


@pytest.mark.slow
def test_a_wrong_controller_is_found_with_any_seed() -> None:
    """The verdict on each controller has a difference, whatever observations and neighbours are drawn.

    The seed is new each time, and so is the choice of 45 of the controllers: each has its turn in some run.
    Few mistakes need the default configuration, with which a verification is long.
    """
    seed = random.randrange(2**32)
    for mistake in random.sample(sorted(WRONG), 45):
        config = DEFAULT_CONFIG if mistake in SHOWN_WITH_DEFAULTS_ALONE else SHORT_RUN_CONFIG
        verdict = verify_wrong_controller(WRONG[mistake], seed, config)
        assert verdict.difference is not None, (seed, mistake)


DIFFERENCE_BY_MISTAKE = {
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
"""Regular expressions for the text of a difference after phase and tick, by the mistake of the controller.

A frame is an identifier, such as 106BB803 for an estimate of robot 3, and its fields."""
MISTAKES_FOUND_LATE = ["rejects its own estimate"]
"""Mistakes whose difference comes in a late phase, after seconds."""


@pytest.mark.parametrize(
    "mistake", [*sorted(DIFFERENCE_BY_MISTAKE.keys() - MISTAKES_FOUND_LATE), *slow(MISTAKES_FOUND_LATE)]
)
def test_a_difference_names_the_field_with_the_expected_and_the_received_value(mistake: str) -> None:
    """Before these it has the phase, the tick and the kind of frame.

    There is a regular expression for the rest of the text, by the mistake that the controller makes.
    """
    verdict = verify_wrong_controller(WRONG[mistake])
    phase_and_tick = r'phase "[^"]+"( \(.*?\))?, tick \d+: '
    expected_text = phase_and_tick + DIFFERENCE_BY_MISTAKE[mistake]
    assert re.match(expected_text, str(verdict.difference)), verdict.difference


# --- Other nodes on the bus ---


def verify_beside_a_node_that_answers_with(message: Any) -> ControllerVerdict:
    """Verify a right controller beside a node that answers every command with this message."""

    def receive_frame(frame: can.Message) -> list[can.Message]:
        return [encoded(message)] if isinstance(decode_command(frame), Command) else []

    other_node = Mock()
    other_node.start.return_value = []
    other_node.receive_frame.side_effect = receive_frame
    return verify(Wire(right_controller(), other_node), phases=phases_named("nothing seen"))


@pytest.mark.parametrize(
    "message",
    [
        Heartbeat(sender=40, uptime=7, transfer_id=0),
        Telemetry(sender=40, x=7, b_hat=16, updates=0, transfer_id=0),
        Command(sender=40, tick=1000, target=77, action=Action.SETTLE, transfer_id=0),
    ],
)
def test_a_controller_passes_beside_a_node_that_does_not_concern_it(message: Any) -> None:
    """Node 40 answers each command with a heartbeat, with telemetry, or with a command to robot 77.

    The controller ignores it.
    """
    assert verify_beside_a_node_that_answers_with(message).has_passed


@pytest.mark.parametrize(
    ("message", "kind_of_message"),
    [
        # An x_hat of 1/2 with a confidence alpha of 1
        (Estimate(sender=40, x_hat=1 << 22, alpha=0x80000001, transfer_id=0), "estimates"),
        (Command(sender=40, tick=1000, target=ID, action=Action.OBSERVE_BLACK, transfer_id=0), "commands"),
        (Command(sender=40, tick=1000, target=EVERY_ROBOT, action=Action.SETTLE, transfer_id=0), "commands"),
    ],
)
def test_a_verdict_names_another_node_that_the_controller_acts_on_and_does_not_blame_the_controller(
    message: Any, kind_of_message: str
) -> None:
    """The controller receives what node 40 sends, and the model does not. The headline names node and kind.

    So a difference would be no mistake of the controller, and its phase is "disturbed".
    """
    verdict = verify_beside_a_node_that_answers_with(message)
    (phase,) = verdict.phases
    assert verdict.difference is None
    assert phase.outcome == "disturbed"
    assert verdict.headline.startswith("DISTURBED, no verdict: 0 of")
    assert f"node 40 sends {kind_of_message} on this bus, too" in verdict.headline


# --- Frames that a controller may send ---


def controller_with_health(health: Health, from_tick: float = math.inf) -> RobotNode:
    """Return a controller whose heartbeats have this health after a tick left open, or from some tick on."""

    def begin_tick(node: RobotNode, usual_begin_tick: Any, observation: Observation | None) -> Any:
        *heartbeats, estimate = usual_begin_tick(observation)
        for frame in heartbeats:
            has_health = node.unsettled > 0 or node.ticks >= from_tick
            reported_health = health if has_health else Health.NOMINAL
            frame.data[4] = reported_health.value  # byte 4 is the health
        return [*heartbeats, estimate]

    return controller_with(begin_tick=begin_tick)


def test_a_controller_may_report_the_health_advisory_after_a_tick_that_was_left_open() -> None:
    """In the phase "nothing seen" some commands that end a tick are left out. There is no difference.

    The heartbeats have this health from then on.
    """
    controller = controller_with_health(Health.ADVISORY)
    verdict = verify(controller, phases=phases_named("nothing seen", "alone"))
    assert verdict.difference is None
    assert controller.unsettled > 0, "ticks left open"


def test_a_controller_must_not_report_the_health_advisory_before_a_tick_was_left_open() -> None:
    """Its heartbeats report it from tick 30 on. The model's heartbeats are nominal. The difference says so.

    In the phase "alone" no tick is left open.
    """
    controller = controller_with_health(Health.ADVISORY, from_tick=30)
    verdict = verify(controller, phases=phases_named("alone"))
    assert controller.unsettled == 0, "ticks left open"
    assert "heartbeat, health: expected" in str(verdict.difference)


def test_a_controller_that_sends_frames_of_another_subject_too_passes() -> None:
    """No estimate, telemetry, command or heartbeat has the subject 7510, so the frame is ignored.

    An identifier of 29 bits has the priority from bit 26 on, reserved bits from 21, the subject from 8, and
    the sender, here robot 3.
    """
    identifier = (4 << 26) | (3 << 21) | (7510 << 8) | 3
    frame = can.Message(arbitration_id=identifier, data=b"any")

    def end_tick_with_one_more_frame(node: RobotNode, usual_end_tick: Any) -> list[can.Message]:
        return [*usual_end_tick(), frame]

    controller = controller_with(end_tick=end_tick_with_one_more_frame)
    assert verify(controller, phases=phases_named("nothing seen")).has_passed


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
            (telemetry,) = self._controller.end_tick()
            self.send_from(self._controller, [telemetry])
            frame = super().recv(timeout)
        return frame


def test_telemetry_that_a_controller_sends_once_more_after_its_last_answer_is_a_difference() -> None:
    """The phase "alone" has 72 ticks. The controller ends the last twice. The second telemetry is "extra"."""
    wire = WireWithLateFrame(right_controller(), last_tick=72)
    verdict = verify(wire, phases=phases_named("alone"))
    assert "telemetry, extra: expected nothing" in str(verdict.difference)


def test_other_nodes_delay_the_verdict_by_a_tenth_of_a_second_at_most(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """At the end the tool reads for 0.1 s. Node 40 sends a heartbeat each 0.01 s, so it reads about ten.

    There is one phase, in which nothing is done, and no controller.
    """
    monkeypatch.setattr(controller_link, "time", CLOCK)
    wire = EndlessWire()

    def do_nothing(bench: Bench) -> None:
        pass

    assert verify(wire, phases=[Phase("nothing", do_nothing)]).has_passed
    assert 10 <= wire.frames <= 12, "heartbeats that the tool has read"


# --- The run ---


def test_a_verification_that_is_stopped_after_75_ticks_reports_the_phases_until_then() -> None:
    """The first phase has 20 ticks, of which five are left open: no command ends them, and none counts.

    So the 75th tick that ends is tick 60 of the second phase, which would have 72.
    """
    controller = right_controller()
    ended_ticks: list[int] = []

    def have_75_ticks_ended() -> bool:
        return len(ended_ticks) == 75

    verdict = verify(controller, progress=ended_ticks.append, should_stop=have_75_ticks_ended)

    first, second, *later_phases = verdict.phases
    assert (first.ticks, first.outcome) == (20, "passed")
    assert (second.ticks, second.outcome) == (60, "not run")
    for phase in later_phases:
        assert (phase.ticks, phase.outcome) == (0, "not run")
    assert controller.ticks == 20 + 60
    assert controller.is_settled


def test_a_verification_that_is_stopped_at_once_neither_passes_nor_fails() -> None:
    """It is interrupted, and has found no difference between the controller and the model."""
    verdict = verify(right_controller(), should_stop=lambda: True)

    assert verdict.is_interrupted
    assert not verdict.has_passed
    assert verdict.difference is None
    assert verdict.headline.startswith("INTERRUPTED: 0 of")


@pytest.mark.parametrize("wire_class", [Wire, EndlessWire], ids=["quiet bus", "busy bus"])
def test_a_verification_may_be_stopped_while_it_waits_for_a_controller(wire_class: type[Wire]) -> None:
    """The verdict is interrupted. The bus is quiet, or another node sends on it without end.

    No controller is on the bus, and the tool would wait 1e9 s for it.
    """
    verdict = verify(wire_class(), wait=1e9, should_stop=lambda: True)
    assert verdict.is_interrupted
    assert verdict.difference is None


class WireThatLosesFrames(Wire):
    """A wire that loses some frames of the tool, by their number; the first is frame 1."""

    def __init__(self, controller: RobotNode, lost_numbers: set[int]) -> None:
        super().__init__(controller)
        self._lost_numbers = lost_numbers
        self._number = 0

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        self._number += 1
        if self._number not in self._lost_numbers:
            super().send(msg, timeout)


def test_commands_that_the_bus_loses_are_repeated_and_counted_in_the_headline() -> None:
    """The bus loses the frames 11 and 21 of the tool, a command to observe and one to settle."""
    wire = WireThatLosesFrames(right_controller(), lost_numbers={11, 21})
    verdict = verify(wire, phases=phases_named("alone"))
    assert verdict.has_passed
    assert verdict.headline.endswith("; 2 commands were repeated")


def test_a_bus_that_fails_is_not_blamed_on_the_controller(monkeypatch: pytest.MonkeyPatch) -> None:
    """The headline begins with DISTURBED and has the error of the bus, on which no frame can be sent."""
    wire = Wire(right_controller())
    failing_send = Mock(side_effect=can.CanOperationError("cable pulled"))
    monkeypatch.setattr(wire, "send", failing_send)
    headline = verify(wire).headline

    assert headline.startswith("DISTURBED, no verdict: 0 of")
    assert "cable pulled" in headline


def test_a_controller_passes_whose_first_heartbeat_is_waited_for() -> None:
    """The tool waits up to 0.05 s for it (``wait``), and then verifies the controller as usual."""
    assert verify(right_controller(), phases=phases_named("nothing seen"), wait=0.05).has_passed


def test_a_controller_that_does_not_start_fails_in_the_first_phase() -> None:
    """The difference says that robot 3 has sent no heartbeat. The next phase is not run."""
    silent_wire = Wire()
    silent_wire.nodes.append(right_controller())  # too late for the wire to start it
    verdict = verify(silent_wire, phases=phases_named("nothing seen", "alone"), wait=0.05)

    message = 'phase "nothing seen", tick 0: robot 3 did not send a heartbeat '
    assert str(verdict.difference).startswith(message)
    first_phase, next_phase = verdict.phases
    assert first_phase.outcome == "failed"
    assert next_phase.outcome == "not run"


def test_a_controller_fails_if_the_heartbeat_with_which_it_starts_has_another_mode() -> None:
    """The difference names the mode, which is "maintenance" in place of "operational"."""

    def start_in_maintenance(node: RobotNode, usual_start: Any) -> list[can.Message]:
        (heartbeat,) = usual_start()
        heartbeat.data[5] = Mode.MAINTENANCE.value  # byte 5 is the mode
        return [heartbeat]

    verdict = verify(controller_with(start=start_in_maintenance), phases=phases_named("nothing seen"))

    assert "heartbeat, mode: expected " in str(verdict.difference)
    (phase,) = verdict.phases
    assert phase.outcome == "failed"


@pytest.mark.parametrize("number_of_first_heartbeats", [0, 1, 3])
def test_a_controller_passes_after_any_number_of_resets(number_of_first_heartbeats: int) -> None:
    """Each reset sends the first heartbeat again. So it waits on the bus several times when the tool begins.

    It is not there if the controller had started before the tool was on the bus.
    """
    wire = Wire(right_controller())
    (first_heartbeat,) = wire.frames_of_nodes
    wire.frames_for_tool.clear()
    wire.frames_for_tool.extend([first_heartbeat] * number_of_first_heartbeats)
    assert verify(wire, phases=phases_named("nothing seen")).has_passed


# --- The command ---

CONTROLLER_OPTIONS = f"--id {ID} --b-hat {B_HAT} --filter-period 10 --neighbours 20"


@pytest.fixture
def verification_of_two_phases(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> dict[str, Any]:
    """The JSON of a verification of a right controller in two phases, which leaves report.md and run.log."""
    phases = phases_named("alone", "loss")
    short_verification = partial(Verification, phases=phases)
    monkeypatch.setattr("mcp_asdf_tools.radio.verification.Verification", short_verification)
    with node_in_a_thread(CONTROLLER_OPTIONS):
        options = f"{CONTROLLER_OPTIONS} --verify --robots 5 --timeout 20 --steps 10 --json"
        assert radio(f"{options} --report '{tmp_path}/report.md' --log '{tmp_path}/run.log'") == 0
    report: dict[str, Any] = json.loads(capsys.readouterr().out)
    return report


def test_the_json_of_a_verification_has_the_verdict_and_the_parameters(
    verification_of_two_phases: dict[str, Any],
) -> None:
    """``mcp-asdf radio --verify --json`` prints them. The controller has passed both phases, of 10 steps.

    It is robot 3 with the accuracy 0.55. The seed is the default, 1.
    """
    verdict = verification_of_two_phases["verdict"]
    assert verdict["passed"]
    assert [phase["name"] for phase in verdict["phases"]] == ["alone", "loss"]

    parameters = verification_of_two_phases["parameters"]
    assert parameters["controller"] == setup_of_robot(3, "mirror", b_hat=0.55).plain()
    assert parameters["seed"] == 1
    assert parameters["steps"] == 10


def test_the_report_of_a_verification_has_the_headline_the_details_and_the_parameters(
    verification_of_two_phases: dict[str, Any], tmp_path: Path
) -> None:
    """The report is a page of Markdown, at whose end the parameters are in a block of JSON.

    The option ``--report`` has named report.md.
    """
    report = (tmp_path / "report.md").read_text()

    assert "**PASSED: 2 of 2 phases passed;" in report
    assert "\n| alone | 72 " in report
    assert "\nNot checked:\n\n- thresholds of rounds" in report
    (json_block,) = blocks(tmp_path / "report.md", "json")
    assert json.loads(json_block)["parameters"] == verification_of_two_phases["parameters"]


def test_the_log_of_a_verification_can_be_replayed(
    verification_of_two_phases: dict[str, Any], capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """The replay reproduces a broadcast for each tick: 72 of the phase "alone", and 10 with losses."""
    assert main(["replay", f"{tmp_path}/run.log"]) == 0
    assert f"{72 + 10}  broadcasts reproduced" in capsys.readouterr().out


def test_a_report_has_a_table_of_the_phases_and_lists_of_what_was_not_checked() -> None:
    """The table is in Markdown. One phase has passed, and the other, which has a fault, is not run."""
    passed_phase = PhaseResult("alone", fault=None, ticks=72, injected=0, equal=144, outcome="passed")
    phase_not_run = PhaseResult("loss", fault="loss=0.5,receivers=3")
    verdict = ControllerVerdict([passed_phase, phase_not_run], not_exercised=["a", "b"], not_checked=["c"])

    assert details(verdict).split("\n") == [
        "| phase | ticks | injected | equal frames | outcome | fault |",
        "| ----- | ----- | -------- | ------------ | ------- | ----- |",
        "| alone | 72    |          | 144          | passed  |       |",
        "| loss  |       |          |              | not run | loss=0.5,receivers=3 |",
        "",
        *("Not exercised:", "", "- a", "- b", ""),
        *("Not checked:", "", "- c", ""),
    ]


def test_the_command_radio_fails_on_a_wrong_controller_and_prints_the_first_difference(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """The exit code is 1. The controller assumes an accuracy of 0.56 where 0.55 is expected.

    So it differs in the first tick of the first of the 45 phases that there are for its filter.
    """
    options = f"--id {ID} --filter-period 10 --neighbours 20"
    with node_in_a_thread(f"{options} --b-hat 0.56"):
        assert radio(f"{options} --b-hat 0.55 --verify --timeout 20") == 1

    headline = 'FAILED: 0 of 45 phases passed; first in phase "nothing seen" (no observation), tick 0'
    assert headline in capsys.readouterr().out


def test_the_command_radio_fails_if_a_fault_that_the_user_asks_for_never_hits(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The user asks how a controller bears lost frames, but at a rate of 0 none is lost (``loss=0``).

    So nothing was put to the test, and the exit code is 1, although no frame differs: in CI nothing but the
    code is read. Beside the user's fault there is one phase, "alone", which has none.
    """
    short_verification = partial(Verification, phases=phases_named("alone"))
    monkeypatch.setattr("mcp_asdf_tools.radio.verification.Verification", short_verification)
    with node_in_a_thread(CONTROLLER_OPTIONS):
        assert radio(f"{CONTROLLER_OPTIONS} --verify --robots 5 --timeout 20 --fault loss=0") == 1

    assert "NOT EXERCISED: " in capsys.readouterr().out


def test_the_command_radio_ends_with_the_exit_code_of_a_signal_that_stops_a_verification(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A script must not take the verdict of a run that Ctrl-C has ended for one that passed or failed.

    ``with stopping() as should_stop`` gives the command a function that tells whether a signal has come. Here
    one has, at once.
    """
    has_signal_come = Mock(return_value=True)
    stopping = Mock(return_value=nullcontext(has_signal_come))
    monkeypatch.setattr("mcp_asdf_tools.cli.radio.stopping", stopping)
    assert radio(f"{CONTROLLER_OPTIONS} --verify --robots 5") == INTERRUPTED
    assert "INTERRUPTED: 0 of " in capsys.readouterr().out


def test_the_command_radio_prints_a_verdict_whose_report_cannot_be_written(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """The disk is full at the end of a run of one phase, "alone", whose verdict must not be lost.

    The exit code is 2.
    """
    short_verification = partial(Verification, phases=phases_named("alone"))
    monkeypatch.setattr("mcp_asdf_tools.radio.verification.Verification", short_verification)
    failing_write = Mock(side_effect=UsageError("the disk is full"))
    monkeypatch.setattr("mcp_asdf_tools.common.files.write_atomically", failing_write)
    report = tmp_path / "controller.md"
    with node_in_a_thread(CONTROLLER_OPTIONS):
        assert radio(f"{CONTROLLER_OPTIONS} --verify --robots 5 --timeout 20 --report {report}") == 2

    output, errors = capsys.readouterr()
    assert "PASSED: 1 of 1 phases passed" in output
    assert "the disk is full" in errors
