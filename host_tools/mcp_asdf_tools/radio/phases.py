"""Phases of a verification, in their order: each adds one thing, so that the first difference tells which.

The first ones are made for the purpose, round by round; the last ones let faults strike among emulated
neighbours.
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

_TESTS = 20
"""Tests of the filter that a run waits for."""
_MOST_TICKS = 400_000
"""Ticks that a run waits for them at most: on a bus of 500 kbit/s these are 4 minutes."""
_LONGEST_MEMORY = 20_000
"""Memories up to this length are filled until they are halved."""


@dataclass(frozen=True)
class Phase:
    """Ticks with one purpose.

    Attributes:
        name: Name in reports.
        play: The phase if it is made for its purpose; None if it takes place among emulated neighbours.
        fault: Faults among these in the texts of ``parse_fault``, separated by spaces, with {me} for the
            controller's id, {them} for all neighbours and {one} for one of them.
        applies: Whether it has a meaning for a controller with this configuration.
    """

    name: str
    play: Callable[[Bench], None] | None = None
    fault: str = ""
    applies: Callable[[RobotSetup], bool] = lambda record: True


def is_in_reach(record: RobotSetup) -> bool:
    """True if the tests of the filter come often enough for a run."""
    return _TESTS * record.filter_period <= _MOST_TICKS


def is_halved(record: RobotSetup) -> bool:
    """True if the memory is short enough for a run to fill it."""
    return record.config.memory <= _LONGEST_MEMORY


def _has(filters: Collection[Filter], record: RobotSetup) -> bool:
    """Whether a controller has one of these filters, with tests often enough for a run."""
    return record.config.filter in filters and is_in_reach(record)


_tests, _votes = partial(_has, {Filter.ADAPTIVE}), partial(_has, {Filter.ROBUST})
_always = partial(_has, {Filter.ALWAYS})
_re_estimates = partial(_has, {Filter.ADAPTIVE, Filter.ALWAYS})

PHASES: tuple[Phase, ...] = (
    Phase("nothing seen", protocol.nothing_seen),
    Phase("alone", protocol.alone),
    Phase("all white", filtering.all_white, applies=_re_estimates),
    Phase("first black tiles", protocol.first_black_tiles),
    Phase("few observations", filtering.few_observations, applies=_re_estimates),
    Phase("few voices", robust.few_voices, applies=_votes),
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
    Phase("no filter", filtering.quiet, applies=lambda record: record.config.filter is Filter.OFF),
    Phase("no information", filtering.no_information, applies=_re_estimates),
    Phase("rounds without a test", filtering.no_test, applies=_re_estimates),
    *(Phase(f"threshold of {m} messages", play, applies=_tests) for m, play in filtering.THRESHOLDS.items()),
    Phase("large sums", filtering.large_sums, applies=_tests),
    Phase("re-estimates without a test", filtering.without_test, applies=_always),
    Phase("own estimate", filtering.own_estimate, applies=_tests),
    Phase("re-estimates", filtering.updates, applies=_re_estimates),
    Phase("estimates of 0 and 1", filtering.ends, applies=_re_estimates),
    Phase("many updates", filtering.many_updates, applies=_re_estimates),
    Phase("votes", robust.votes, applies=_votes),
    Phase("moving up", robust.moving(ONE), applies=_votes),
    Phase("test of a moderate spread", robust.thresholds(robust.MODERATE), applies=_votes),
    Phase("centre at 1/2", robust.uninformative, applies=_votes),
    Phase("limits of the trend", robust.trend_limits, applies=_votes),
    Phase("moving down", robust.moving(0), applies=_votes),
    Phase("halvings", filtering.halvings, applies=is_halved),
    Phase("long run", filtering.long_run, applies=lambda record: not is_halved(record)),
    Phase("test of the least spread", robust.thresholds(robust.NARROW), applies=_votes),
    Phase("many rejections", robust.many_updates, applies=_votes),
    Phase("many votes", robust.many_votes, applies=_votes),
    Phase("among neighbours"),
    Phase("loss", fault="loss=0.5,receivers={me}"),
    Phase("delay", fault="delay=0.5,ticks=3,receivers={me}"),
    Phase("repeated messages", fault="duplicate=0.7,ticks=0,receivers={me}"),
    Phase("corrupted bits", fault="corrupt=0.5,bits=3,receivers={me}"),
    # Half of it a tick late, before the messages of that tick, which a controller deaf after a flood misses.
    Phase("flood", fault="babble=1,frames=10,robots={them} delay=0.5,receivers={me}"),
    Phase("crash and rejoin", fault="crash=0.2,ticks=5,robots={them}"),
    Phase("frozen neighbours", fault="freeze=0.8,robots={them}"),
    Phase("liar", fault="liar=1,x=1,alpha=1e38,robots={one}"),
    Phase("node-id conflict", fault="collide=0.5,id={me},robots={them}"),
    Phase("bus-off", fault="busoff=0.2,ticks=5,robots={them}"),
)
