"""The phases of a verification, in order. Each adds one thing, so that the first that fails tells which.

The first phases are written for their purpose, round by round. In the last ones faults are injected among
emulated neighbours.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass
from functools import partial

from mcp_asdf.robot import Filter
from mcp_asdf.robust_filter import SLOTS
from mcp_asdf_tools.radio import filter_phases as filtering
from mcp_asdf_tools.radio import protocol_phases as protocol
from mcp_asdf_tools.radio import robust_phases as robust
from mcp_asdf_tools.radio.bench import Bench
from mcp_asdf_tools.robots.robot_setup import RobotSetup

_TESTS_NEEDED = 20
"""Number of the filter's tests that the phases need."""
_MAX_TICKS_TO_WAIT = 400_000
"""Largest number of ticks to wait for these tests: they take 4 minutes on a bus of 500 kbit/s."""
_MAX_MEMORY_TO_FILL = 20_000
"""Longest memory, in observations, that a run fills until the counts are halved."""


@dataclass(frozen=True)
class Phase:
    """Ticks of a verification with one purpose.

    Attributes:
        name: Name of the phase in reports.
        play: Runs the phase on a bench. None for a phase among emulated neighbours, which runs a fixed number
            of ticks.
        fault: Faults to inject among the neighbours, in the format of ``parse_fault`` and separated by
            spaces, with {me} for the controller's id, {them} for all neighbours and {one} for one of them.
        applies: Returns whether the phase has a meaning for a controller with this setup.
    """

    name: str
    play: Callable[[Bench], None] | None = None
    fault: str = ""
    applies: Callable[[RobotSetup], bool] = lambda setup: True


def can_wait_for_tests(setup: RobotSetup) -> bool:
    """Return whether the filter tests often enough for a run to see as many tests as it needs."""
    return _TESTS_NEEDED * setup.filter_period <= _MAX_TICKS_TO_WAIT


def can_fill_memory(setup: RobotSetup) -> bool:
    """Return whether the memory is short enough for a run to fill it, so that the counts are halved."""
    return setup.config.memory <= _MAX_MEMORY_TO_FILL


def _has_filter(filters: Collection[Filter], setup: RobotSetup) -> bool:
    """Return whether a controller has one of these filters, and tests often enough for a run."""
    return setup.config.filter in filters and can_wait_for_tests(setup)


_has_adaptive_filter = partial(_has_filter, {Filter.ADAPTIVE})
_has_robust_filter = partial(_has_filter, {Filter.ROBUST})


def _has_robust_filter_and(condition: Callable[[RobotSetup], bool], setup: RobotSetup) -> bool:
    """Return whether a controller has the robust filter, tests often enough, and meets the condition, too."""
    return _has_robust_filter(setup) and condition(setup)


_can_estimates_decide = partial(_has_robust_filter_and, robust.can_estimates_decide_test)
_can_contradict_extremes = partial(_has_robust_filter_and, robust.can_contradict_extreme_estimate)
_can_largest_spread_decide = partial(_has_robust_filter_and, robust.can_largest_spread_decide_test)
_re_estimates_always = partial(_has_filter, {Filter.ALWAYS})
_has_asdf_filter = partial(_has_filter, {Filter.ADAPTIVE, Filter.ALWAYS})

PHASES: tuple[Phase, ...] = (
    Phase("nothing seen", protocol.receive_before_observing),
    Phase("alone", protocol.observe_alone),
    Phase("all white", filtering.re_estimate_without_black, applies=_has_asdf_filter),
    Phase("first black tiles", protocol.observe_first_black),
    Phase("few observations", filtering.re_estimate_early, applies=_has_asdf_filter),
    Phase("first estimates", robust.receive_first_estimates, applies=_has_robust_filter),
    Phase("test of few estimates", robust.test_few_estimates, applies=_has_robust_filter),
    Phase(
        "threshold of few estimates",
        # The smallest odd and the smallest even number of estimates that are tested.
        robust.threshold_phase(5, 6, widths=[robust.WIDE_WIDTH, robust.NARROW_WIDTH]),
        applies=_can_estimates_decide,
    ),
    Phase("supporters", robust.test_with_supporters, applies=_can_contradict_extremes),
    Phase("messages and silence", protocol.receive_and_wait),
    Phase("lost commands", protocol.lose_settles),
    Phase("stray commands", protocol.send_stray_commands),
    Phase("heartbeats", protocol.wait_for_heartbeats),
    Phase("every sender", protocol.receive_from_every_sender),
    Phase("alike ids", protocol.receive_from_alike_ids),
    Phase("growing rounds", protocol.receive_growing_rounds),
    Phase("between ticks", protocol.receive_between_ticks),
    Phase("unusual commands", protocol.send_unusual_commands),
    Phase("extreme messages", protocol.receive_extremes),
    Phase("same sender", protocol.receive_repeated_sender),
    Phase("a crowded tick", protocol.receive_crowded_tick),
    Phase("its own id", protocol.receive_own_id),
    Phase("unusual identifiers", protocol.receive_unusual_identifiers),
    Phase("invalid frames", protocol.receive_malformed),
    Phase(
        "no filter", filtering.play_without_filter, applies=lambda setup: setup.config.filter is Filter.OFF
    ),
    Phase("no information", filtering.re_estimate_to_half, applies=_has_asdf_filter),
    Phase("rounds without a test", filtering.play_rounds_without_test, applies=_has_asdf_filter),
    *(
        Phase(f"threshold of {m} messages", filtering.threshold_phase(m), applies=_has_adaptive_filter)
        for m in filtering.SIZES_AT_THRESHOLD
    ),
    Phase("large sums", filtering.phase_of_tests(filtering.LONGEST_NUMBERS), applies=_has_adaptive_filter),
    Phase(
        "re-estimates without a test",
        filtering.phase_of_tests(filtering.NOT_REJECTED_BY_A_TEST),
        applies=_re_estimates_always,
    ),
    Phase("own estimate", filtering.phase_of_tests(filtering.OWN_ESTIMATES), applies=_has_adaptive_filter),
    Phase("re-estimates", filtering.re_estimate_to_each_kind, applies=_has_asdf_filter),
    Phase("estimates of 0 and 1", filtering.re_estimate_from_ends, applies=_has_asdf_filter),
    Phase("many updates", filtering.re_estimate_often, applies=_has_asdf_filter),
    Phase("votes by turns", robust.vote_with_every_slot, applies=_has_robust_filter),
    Phase("no confidence of its own", robust.vote_without_own_confidence, applies=_can_contradict_extremes),
    Phase(
        "test of a wide spread",
        # Twice: a controller whose arithmetic is wrong errs about some estimates at the threshold, not all.
        robust.threshold_phase(SLOTS, SLOTS, widths=[robust.WIDE_WIDTH]),
        applies=_can_estimates_decide,
    ),
    Phase("estimates far apart", robust.test_estimates_far_apart, applies=_can_largest_spread_decide),
    Phase("estimates of 1/2", robust.re_estimate_near_half, applies=_has_robust_filter),
    Phase("dependent observations", robust.test_dependent_observations, applies=_can_estimates_decide),
    Phase("halvings", filtering.halve_memory, applies=can_fill_memory),
    Phase("long run", filtering.observe_long, applies=lambda setup: not can_fill_memory(setup)),
    Phase(
        "test of the least spread",
        robust.threshold_phase(SLOTS, widths=[robust.NARROW_WIDTH]),
        applies=_can_estimates_decide,
    ),
    Phase("many rejections", robust.re_estimate_often, applies=_has_robust_filter),
    Phase("votes that agree", robust.vote_until_spread_is_smallest, applies=_has_robust_filter),
    Phase("among neighbours"),
    Phase("loss", fault="loss=0.5,receivers={me}"),
    Phase("delay", fault="delay=0.5,ticks=3,receivers={me}"),
    Phase("repeated messages", fault="duplicate=0.7,ticks=0,receivers={me}"),
    Phase("corrupted bits", fault="corrupt=0.5,bits=3,receivers={me}"),
    # Half of the flood comes a tick late, before that tick's other messages. So a controller that loses what
    # follows a flood is found out.
    Phase("flood", fault="babble=1,frames=10,robots={them} delay=0.5,receivers={me}"),
    Phase("crash and rejoin", fault="crash=0.2,ticks=5,robots={them}"),
    Phase("frozen neighbours", fault="freeze=0.8,robots={them}"),
    Phase("liar", fault="liar=1,x=1,alpha=1e38,robots={one}"),
    Phase("node-id conflict", fault="collide=0.5,id={me},robots={them}"),
    Phase("bus-off", fault="busoff=0.2,ticks=5,robots={them}"),
)
