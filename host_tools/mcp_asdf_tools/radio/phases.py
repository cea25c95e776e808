"""The phases of a verification, in order. Each adds one thing, so that the first that fails tells which.

The first phases are written for their purpose, round by round. In the last ones faults are injected among
emulated neighbours.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass
from functools import partial

from mcp_asdf.fixed_point import ONE
from mcp_asdf.robot import Filter
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
_re_estimates_always = partial(_has_filter, {Filter.ALWAYS})
_has_asdf_filter = partial(_has_filter, {Filter.ADAPTIVE, Filter.ALWAYS})

PHASES: tuple[Phase, ...] = (
    Phase("nothing seen", protocol.nothing_seen),
    Phase("alone", protocol.alone),
    Phase("all white", filtering.all_white, applies=_has_asdf_filter),
    Phase("first black tiles", protocol.first_black_tiles),
    Phase("few observations", filtering.few_observations, applies=_has_asdf_filter),
    Phase("few voices", robust.few_voices, applies=_has_robust_filter),
    Phase("messages and silence", protocol.messages_and_silence),
    Phase("lost commands", protocol.lost_settles),
    Phase("stray commands", protocol.stray),
    Phase("heartbeats", protocol.heartbeats),
    Phase("every sender", protocol.every_sender),
    Phase("alike ids", protocol.alike_ids),
    Phase("growing rounds", protocol.growing_rounds),
    Phase("between ticks", protocol.between_ticks),
    Phase("unusual commands", protocol.unusual_commands),
    Phase("extreme messages", protocol.extremes),
    Phase("same sender", protocol.same_sender),
    Phase("a crowded tick", protocol.crowded_tick),
    Phase("its own id", protocol.own_id),
    Phase("unusual identifiers", protocol.unusual_messages),
    Phase("invalid frames", protocol.invalid),
    Phase("no filter", filtering.quiet, applies=lambda setup: setup.config.filter is Filter.OFF),
    Phase("no information", filtering.no_information, applies=_has_asdf_filter),
    Phase("rounds without a test", filtering.no_test, applies=_has_asdf_filter),
    *(
        Phase(f"threshold of {m} messages", play, applies=_has_adaptive_filter)
        for m, play in filtering.THRESHOLDS.items()
    ),
    Phase("large sums", filtering.large_sums, applies=_has_adaptive_filter),
    Phase("re-estimates without a test", filtering.without_test, applies=_re_estimates_always),
    Phase("own estimate", filtering.own_estimate, applies=_has_adaptive_filter),
    Phase("re-estimates", filtering.updates, applies=_has_asdf_filter),
    Phase("estimates of 0 and 1", filtering.ends, applies=_has_asdf_filter),
    Phase("many updates", filtering.many_updates, applies=_has_asdf_filter),
    Phase("votes", robust.votes, applies=_has_robust_filter),
    Phase("moving up", robust.moving(ONE), applies=_has_robust_filter),
    Phase("test of a moderate spread", robust.thresholds(robust.MODERATE), applies=_has_robust_filter),
    Phase("centre at 1/2", robust.uninformative, applies=_has_robust_filter),
    Phase("limits of the trend", robust.trend_limits, applies=_has_robust_filter),
    Phase("moving down", robust.moving(0), applies=_has_robust_filter),
    Phase("halvings", filtering.halvings, applies=can_fill_memory),
    Phase("long run", filtering.long_run, applies=lambda setup: not can_fill_memory(setup)),
    Phase("test of the least spread", robust.thresholds(robust.NARROW), applies=_has_robust_filter),
    Phase("many rejections", robust.many_updates, applies=_has_robust_filter),
    Phase("many votes", robust.many_votes, applies=_has_robust_filter),
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
