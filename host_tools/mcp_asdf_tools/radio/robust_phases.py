"""Phases that put the robust filter to the test: voices, votes, its test, the way back, a crowd that moves.

What is sent is chosen by the model's state, so that one vote or one observation makes the difference.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from copy import copy
from dataclasses import dataclass

from mcp_asdf.fixed_point import ALPHA_MAX, HALF, ONE
from mcp_asdf.mirror import (
    TREND_SHIFT,
    TREND_STEP_EVEN,
    TREND_STEP_UP,
    VOTES_MAX,
    VOTES_MIN_WHILE_MOVING,
    Crowd,
    MirrorRobot,
    robust_test_rejects,
    update_crowd,
)
from mcp_asdf.robot import Observation
from mcp_asdf_tools.radio.bench import BURST, Bench
from mcp_asdf_tools.radio.filter_phases import updates_to_see
from mcp_asdf_tools.radio.rounds import ordinary_alpha

_ALL = 126
"""Votes of a round in which every other robot has one."""
_MOST_OBSERVED = 10_000
"""Observations that a threshold of the test is looked for."""
_MOST_ROUNDS = 120
"""Rounds that the crowd is brought somewhere in."""
_MORE_ROUNDS = 8
"""Rounds after it has come there, in which a spread without a limit would shrink on."""
_LEAST_ALPHA = 0x0000_0100
_MOST_EXTRA, _VOTES_TO_EDGE = 30, 40
"""Observations and votes with which a threshold of the test is looked for, from a place near it."""
_VOTES_TO_MOVE = 360
"""Votes for one side after which a crowd that has been balanced moves."""
AT_HALF = 1 << 24
"""Spread with which some votes move the centre by 2**17, and which the test hardly feels."""
TREND_LIMITS = (1 << 13, (1 << 13) - 1, (7 << 13) - 1, 7 << 13)
MODERATE, NARROW = 1 << 26, 1 << 18
"""Spreads: 1/16, with which there are counts to reject any accuracy, and the least."""


def few_voices(bench: Bench) -> None:
    """Two voices are too few for a test that would reject, but not for halving the votes; a third is enough.

    The ids of the first and the third voice are equal modulo 16, and the bits of voices are at both ends of
    a word's halves.
    """
    s = bench.firmware.s
    bench.activity = "many black tiles"
    while 8 * s.n < 7 * s.t:
        bench.skip_ticks(BURST, lambda: Observation.BLACK)
    one, other, third = ([robot for robot in bench.other_ids if robot % 32 == rest] for rest in (15, 0, 31))
    bench.activity = "confidences of 0 before the first vote"
    bench.play_round((ONE, 0), (ONE, 0), (0, 0))
    bench.activity = "the first vote, as far from the centre as the spread"
    bench.play_round((ONE - HALF // 2, ALPHA_MAX), senders=one[:1])
    bench.activity = "votes of robots whose ids modulo 32 are two"
    end = 0 if 2 * s.crowd.first >= 1 << 32 else ONE
    two_voices = one + other

    def vote_for(value: int, count: int) -> None:
        _vote(bench, [value] * count, two_voices[:count])

    for _ in range(2):
        vote_for(end, len(two_voices))
    _bring(bench, "two voices", lambda: _rejects(bench), lambda: vote_for(end, len(two_voices)))
    _test(bench)
    bench.activity = "votes of two voices, for one side in the end"
    while s.crowd.votes < 4 * VOTES_MIN_WHILE_MOVING - _VOTES_TO_MOVE:
        _vote(bench, [0, ONE] * (len(two_voices) // 2), two_voices[: len(two_voices) // 2 * 2])
    while s.crowd.votes < 4 * VOTES_MIN_WHILE_MOVING and not (
        s.crowd.is_moving and bench.setup.filter_period < BURST
    ):
        vote_for(end, min(len(two_voices), 4 * VOTES_MIN_WHILE_MOVING - s.crowd.votes))
    _halve_to_floor(bench)
    bench.activity = "votes of two voices for the other side"
    _bring(
        bench,
        "a crowd of two voices that stays",
        lambda: not s.crowd.is_moving,
        lambda: vote_for(ONE - end, 1),
    )
    bench.activity = "a vote of a third"
    _vote(bench, [ONE - end], third[:1])
    _test(bench)


def votes(bench: Bench) -> None:
    """Votes just inside and just outside the spread, with the largest confidence or the least.

    Four of the far end follow each: their steps show what became of the spread.
    """
    for is_above in (True, False, True, False):
        for is_outside in (False, True):
            crowd, end = bench.firmware.s.crowd, ONE if is_above else 0
            inside = (
                crowd.centre + crowd.spread >> 7 if is_above else -(crowd.spread - crowd.centre >> 7)
            )  # at most a spread away: rounded towards the centre
            value = min(max(inside + is_outside * (1 if is_above else -1), 0), ONE)
            bench.activity = f"a vote just {'outside' if is_outside else 'inside'} the spread"
            alphas = (ALPHA_MAX, _LEAST_ALPHA) * 3
            bench.play_round(*zip((value, *[ONE - end] * 4), alphas, strict=False))


def moving(end: int) -> Callable[[Bench], None]:
    """Return a phase in which votes are for ``end``, 0 or 1, until there is no test and the gain is back."""

    def play(bench: Bench) -> None:
        crowd = bench.firmware.s.crowd
        bench.activity = "votes for one side"
        count = _votes_until_moving(bench, end) - 1
        for first in range(0, count, _ALL):
            _vote(bench, [end] * min(count - first, _ALL))
        _test(bench)
        if crowd.spread < MODERATE and not _rejects(bench):
            bench.play_tick(_up_to(bench, True))
        bench.activity = "the vote with which the crowd moves"
        _vote(bench, [end])
        _test(bench)
        bench.activity = "votes after the crowd has moved"
        _vote(bench, [ONE - end] * 5)
        bench.activity = "votes until the crowd moves on"
        for _ in range(_MOST_ROUNDS):
            if crowd.is_moving:
                break
            _vote(bench, [end] * 5)
        _halve_to_floor(bench)
        bench.activity = "one vote less than are halved"
        while crowd.votes < 2 * VOTES_MIN_WHILE_MOVING - 1:
            _vote(bench, [end] * min(_ALL, 2 * VOTES_MIN_WHILE_MOVING - 1 - crowd.votes))
        _test(bench)
        _vote(bench, [ONE - end] * 5)

    return play


def trend_limits(bench: Bench) -> None:
    """Test crowds whose trend is just inside and just outside each limit."""
    crowd = bench.firmware.s.crowd
    for trend in TREND_LIMITS:
        bench.activity = f"votes to a trend of {trend}"
        if crowd.votes < 2 * VOTES_MIN_WHILE_MOVING:
            for _ in range(3):
                _vote(bench, [ONE, 0] * (_ALL // 2))
        if not 1 << 28 < crowd.centre < 3 << 28:
            _bring(
                bench,
                "a crowd in the middle",
                lambda: _is_in_the_middle(crowd),
                lambda: _vote(bench, [HALF] * _ALL),
            )
        moves = moves_to_trend(crowd.trend, trend)
        if moves is None:
            bench.not_exercised.append(bench.activity)
            continue
        for first in range(0, len(moves), _ALL):
            _vote_moves(bench, moves[first : first + _ALL])
        assert crowd.trend == trend, (crowd, trend)
        bench.activity = f"a test at a trend of {trend}"
        _test(bench)
        # Where no test shows by a new b_hat, the halved votes show by the next steps.
        bench.activity = f"votes after a test at a trend of {trend}"
        _vote(bench, [0, ONE, 0])


def uninformative(bench: Bench) -> None:
    """Let the test reject with a centre that is just informative, and just not, on either side of 1/2."""
    state = bench.firmware.s
    crowd = state.crowd
    # As many of these votes are above 1/2 as below, and those at 1/2 bring the centre there.
    values = [HALF - (AT_HALF >> 7), HALF, HALF + (AT_HALF >> 7)] * (_ALL // 3)

    def is_at_half() -> bool:
        is_near = abs(crowd.centre - (1 << 29)) < AT_HALF >> 3 and crowd.spread < 2 * AT_HALF
        return is_near and _is_in_the_middle(crowd) and crowd.votes >= 2 * VOTES_MIN_WHILE_MOVING

    for offset in (1 << 17, (1 << 17) - 1, -(1 << 17), -(1 << 17) - 1, 0):
        bench.activity = "votes around 1/2"
        _bring(bench, "a crowd at 1/2", is_at_half, lambda: _vote(bench, values))
        if not _observe_until_rejected(bench):
            return
        bench.activity = f"a test with a centre {offset} units from 1/2"
        final_values = votes_to_centre(crowd, (1 << 29) + offset)
        if final_values is None:
            bench.not_exercised.append(bench.activity)
            return
        # The final votes bring the centre nearer to the observed share, and the test may then no longer
        # reject. More observations of the colour that is seen more often take the share away from it.
        crowd_at_test = copy(crowd)
        for value in final_values:
            update_crowd(crowd_at_test, 0, value)
        while not robust_test_rejects(crowd_at_test, state.t, state.n):
            bench.play_tick(Observation(2 * state.n > state.t))
        bench.skip_to_test_round()
        _vote(bench, final_values)


def thresholds(spread: int) -> Callable[[Bench], None]:
    """A phase in which the crowd's spread becomes at most ``spread``, and the test then rejects and just does
    not, and again: b_hat is found anew, and the first one comes back."""

    def play(bench: Bench) -> None:
        crowd, draw = bench.firmware.s.crowd, bench.draw
        # A crowd that predicts the count as it is needs the fewest observations to a threshold.
        aim = _predicting_estimate(bench)

        def vote_around(value: int, width: int) -> None:
            values = [value + draw.randint(-width, width) for _ in range(_ALL)]
            _vote(bench, [min(max(value, 0), ONE) for value in values])

        bench.activity = "votes from both sides"
        _bring(
            bench,
            "a crowd in the middle",
            lambda: abs(crowd.centre - (aim << 7)) < MODERATE and _is_balanced(crowd),
            lambda: vote_around(aim, ONE // 4),
        )
        bench.activity = "votes that agree"

        def agree() -> None:
            vote_around(crowd.centre >> 7, spread >> 7)

        _bring(bench, f"a spread of {spread / 2**30:g}", lambda: crowd.spread <= spread, agree)
        for _ in range(_MORE_ROUNDS if spread == NARROW else 0):
            agree()
        for side in (1, -1 if spread == NARROW else 1):
            _cross(bench, side)

    return play


def many_updates(bench: Bench) -> None:
    """Let the test reject until a counter of updates of too few bits shows."""
    if not _observe_until_rejected(bench):
        return
    bench.activity = "one of many re-estimates"
    for _ in range(max(updates_to_see(bench.setup) - bench.firmware.s.updates, 1)):
        _test(bench)


def many_votes(bench: Bench) -> None:
    """Twice as many votes as count, of both sides, and then a round of one side."""
    bench.activity = "many votes"
    for _ in range(2 * VOTES_MAX // _ALL + 1):
        _vote(bench, [0, ONE] * (_ALL // 2))
    bench.activity = "votes with the least gain"
    _vote(bench, [ONE] * _ALL)


def _vote(bench: Bench, values: list[int], senders: list[int] | None = None) -> None:
    """A round of votes."""
    bench.play_round(*((value, ordinary_alpha(bench.draw)) for value in values), senders=senders)


def _test(bench: Bench) -> None:
    """Nothing until the next test, and that."""
    bench.skip_to_test_round()
    bench.play_round()


def _bring(bench: Bench, what: str, is_there: Callable[[], bool], step: Callable[[], None]) -> None:
    """Steps until it is there."""
    for _ in range(_MOST_ROUNDS):
        if is_there():
            return
        step()
    bench.not_exercised.append(what)


def _rejects(bench: Bench, z: Observation | None = None) -> bool:
    """Whether the test would reject now, or after an observation."""
    robot = _observer_like(bench.firmware)
    if z is not None:
        robot.observe(z)
    return robust_test_rejects(robot.s.crowd, robot.s.t, robot.s.n)


def _observer_like(firmware: MirrorRobot) -> MirrorRobot:
    """Return a robot that may observe on its own, and shares the crowd with ``firmware``."""
    robot = MirrorRobot.__new__(MirrorRobot)
    robot.config, robot.s = firmware.config, copy(firmware.s)
    return robot


def _observe_until_rejected(bench: Bench) -> bool:
    """Observe one colour until the test would reject; returns whether it does."""
    bench.activity = "observations until the test rejects"
    while not _rejects(bench):
        colour = _up_to(bench, True)
        if colour is None:
            return False
        bench.play_tick(colour)
    return True


def _votes_until_moving(bench: Bench, end: int) -> int:
    """Votes for ``end`` with which the crowd moves."""
    crowd, count = copy(bench.firmware.s.crowd), 0
    while not crowd.is_moving:
        update_crowd(crowd, 0, end)
        count += 1
    return count


def _up_to(bench: Bench, wanted: bool, side: int = 1) -> Observation | None:
    """Observations of one colour until the next one makes the test reject or, unless ``wanted``, not reject.

    Returns that colour, None if there is none. Away from what the crowd predicts it goes towards the colour
    that is expected less, or with ``side`` -1 to the other one.
    """
    s = bench.firmware.s
    r, b_hat = s.crowd.centre / 2**30, s.crowd.first / 2**32
    expected = b_hat * r + (1 - b_hat) * (1 - r)
    is_black = (expected < 0.5) == (side == 1) if wanted else s.n < expected * s.t
    for _ in range(_MOST_OBSERVED):
        if _rejects(bench, Observation(is_black)) is wanted:
            return Observation(is_black)
        bench.play_tick(Observation(is_black))
    bench.not_exercised.append(f"{bench.activity}: a test that {'rejects' if wanted else 'does not reject'}")
    return None


def _cross(bench: Bench, side: int) -> None:
    """Play tests just before their threshold and just behind it, and back again.

    Observations come near the threshold, and votes then move the centre to it, by a unit of 2**-30.
    """
    for wants_rejection in (not _rejects(bench), _rejects(bench)) * 2:
        bench.activity = "observations of one colour"
        if _rejects(bench) != wants_rejection:
            colour = _up_to(bench, wants_rejection, side)
            if colour is None:
                return
            bench.play_tick(colour)
        bench.activity = "observations and votes towards the threshold of the test"
        edge = _nearest_edge(bench, wants_rejection)
        if edge is not None:
            for colour in edge.observations:
                bench.play_tick(colour)
        bench.activity = "a test that " + ("just rejects" if wants_rejection else "just does not reject")
        bench.skip_to_test_round()
        _vote(bench, edge.values if edge is not None else [])


# --- Crowds at an exact place ---


@dataclass(frozen=True)
class Edge:
    """A way to the threshold of the robust filter's test.

    Attributes:
        observations: Observations to make first.
        values: Votes after which the centre is the last one, or the first, that the test rejects.
        suspects: Mistakes that show in the test.
    """

    observations: list[Observation]
    values: list[int]
    suspects: int


def votes_to_centre(crowd: Crowd, target: int) -> list[int] | None:
    """Return estimates whose votes move the centre to exactly ``target``; None if no round of them does."""
    crowd, values = copy(crowd), list[int]()
    while crowd.centre != target:
        is_up = target > crowd.centre
        sign = 1 if is_up else -1
        votes = min(crowd.votes + 1, VOTES_MAX)
        shift = max(votes.bit_length() - 3, 3)
        # A vote moves the centre by its distance shifted right, so the last one may be this far away, or
        # farther by less than 2**shift. Others are as far away as the spread, which then shrinks.
        missing = abs(target - crowd.centre)
        is_last = missing <= crowd.spread >> shift
        if is_last:
            place = crowd.centre + sign * (missing << shift)
            value = -(-place >> 7) if is_up else place >> 7
        else:
            place = crowd.centre + sign * crowd.spread
            value = place >> 7 if is_up else -(-place >> 7)
        if not 0 <= value <= ONE or len(values) == _ALL:
            return None
        values.append(value)
        update_crowd(crowd, 0, value)
        if is_last and crowd.centre != target:
            return None
    return values


def moves_to_trend(start: int, target: int) -> list[int] | None:
    """Return the shortest sequence of moves of the centre (1 up, -1 down, 0 none) from one trend to another.

    Returns None if there is none.
    """
    added = {1: TREND_STEP_UP, 0: TREND_STEP_EVEN, -1: 0}
    came_from: dict[int, tuple[int, int]] = {start: (start, 0)}
    frontier = [start]
    while frontier and target not in came_from:
        reached = []
        for trend in frontier:
            for move, gain in added.items():
                following = trend - (trend >> TREND_SHIFT) + gain
                if following not in came_from:
                    came_from[following] = trend, move
                    reached.append(following)
        frontier = reached
    if target not in came_from:
        return None
    moves, trend = list[int](), target
    while trend != start:
        trend, move = came_from[trend]
        moves.append(move)
    return moves[::-1]


def _vote_moves(bench: Bench, moves: Sequence[int]) -> None:
    """Play a round of votes that move the centre up (1), down (-1) or not at all (0)."""
    crowd, values = copy(bench.firmware.s.crowd), list[int]()
    for move in moves:
        values.append({1: ONE, -1: 0, 0: crowd.centre >> 7}[move])
        update_crowd(crowd, 0, values[-1])
    _vote(bench, values)


def _nearest_edge(bench: Bench, wants_rejection: bool) -> Edge | None:
    """Return the way to a threshold at which most mistakes show that no frame has shown so far.

    Returns None if no threshold is near enough.
    """
    best: Edge | None = None
    for observations in _near_threshold(bench):
        robot = _observer_like(bench.firmware)
        for z in observations:
            robot.observe(z)
        values = _votes_to_threshold(robot, wants_rejection)
        if values is None:
            continue
        crowd = copy(robot.s.crowd)
        for value in values:
            update_crowd(crowd, 0, value)
        decisions = [rules.rejects(crowd, robot.s.t, robot.s.n) for rules in bench.lineup.rules.values()]
        edge = Edge(observations, values, decisions.count(not wants_rejection))
        if best is None or edge.suspects > best.suspects:
            best = edge
    return best


def _near_threshold(bench: Bench) -> Iterator[list[Observation]]:
    """Yield up to so many observations, that leave the share of black ones nearly as it is."""
    s = bench.firmware.s
    for count in range(_MOST_EXTRA):
        blacks = count * s.n // s.t
        for number in {max(blacks - 1, 0), blacks, min(blacks + 1, count)}:
            yield [Observation.BLACK] * number + [Observation.WHITE] * (count - number)


def _votes_to_threshold(robot: MirrorRobot, wants_rejection: bool) -> list[int] | None:
    """Return votes that move the centre next to the test's threshold, to the side that is wanted.

    Returns None if the threshold is too far from the centre, or an end of the room too near.
    """
    crowd, t, n = robot.s.crowd, robot.s.t, robot.s.n

    def rejects_at(centre: int) -> bool | None:
        values = votes_to_centre(crowd, centre)
        if values is None:
            return None
        moved = copy(crowd)
        for value in values:
            update_crowd(moved, 0, value)
        return robust_test_rejects(moved, t, n)

    reach = _VOTES_TO_EDGE * crowd.spread >> max(crowd.votes.bit_length() - 3, 3)
    for end in (crowd.centre - reach, crowd.centre + reach):
        here, there = crowd.centre, end
        at_end, at_start = rejects_at(end), rejects_at(crowd.centre)
        if at_end is None or at_end == at_start:
            continue
        while abs(there - here) > 1:
            middle = (here + there) // 2
            decision = rejects_at(middle)
            if decision is None:
                return None
            if decision == at_start:
                here = middle
            else:
                there = middle
        return votes_to_centre(crowd, here if at_start == wants_rejection else there)
    return None


def _halve_to_floor(bench: Bench) -> None:
    """Let tests pass while the crowd moves until the votes are at their floor, once more, and then vote."""
    crowd = bench.firmware.s.crowd
    bench.activity = "tests while the crowd moves"
    for _ in range(VOTES_MAX.bit_length()):
        if not crowd.is_moving or crowd.votes < 2 * VOTES_MIN_WHILE_MOVING:
            break
        _test(bench)
    _test(bench)
    bench.activity = "a vote after the votes were halved"
    _vote(bench, [ONE if crowd.centre < 1 << 29 else 0], bench.other_ids[:1])


def _predicting_estimate(bench: Bench) -> int:
    """Return an estimate that predicts the present share of black tiles, within [1/4, 3/4], not near 1/2."""
    s = bench.firmware.s
    b_hat = s.crowd.first / 2**32
    x = HALF if s.crowd.first == 1 << 31 else round((s.n / max(s.t, 1) + b_hat - 1) / (2 * b_hat - 1) * ONE)
    x = min(max(x, ONE // 4), 3 * ONE // 4)
    return x if abs(x - HALF) > ONE // 16 else HALF + ONE // 8


def _is_in_the_middle(crowd: Crowd) -> bool:
    """Return True if the crowd is near 1/2 and does not move."""
    return abs(crowd.centre - (1 << 29)) < 1 << 28 and _is_balanced(crowd)


def _is_balanced(crowd: Crowd) -> bool:
    """Return True if at least a quarter of the crowd's late moves went up, and a quarter down."""
    return 1 << 14 < crowd.trend < 3 << 14
