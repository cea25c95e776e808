"""Phases that put the robust filter to the test: voices, votes, its test, the way back, a crowd that moves.

What is sent is chosen by the model's state, so that one vote or one observation makes the difference.
"""

from __future__ import annotations

from collections.abc import Callable
from copy import copy, deepcopy

from mcp_asdf.fixed_point import ALPHA_MAX, HALF, ONE
from mcp_asdf.mirror import VOTES_MAX, robust_test_rejects, update_crowd
from mcp_asdf.robot import Observation
from mcp_asdf_tools.radio.bench import BURST, Bench
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
MODERATE, NARROW = 1 << 26, 1 << 18
"""Spreads: 1/16, with which there are counts to reject any accuracy, and the least."""


def few_voices(bench: Bench) -> None:
    """Two voices are too few for a test that would reject, whatever their votes; a third one is enough."""
    s, draw = bench.firmware.s, bench.draw
    bench.doing = "many black tiles"
    while 8 * s.n < 7 * s.t:
        bench.skip(BURST, lambda: Observation.BLACK)
    one, other, third = (
        [robot for robot in bench.others if robot % 32 == rest] for rest in draw.sample(range(32), 3)
    )
    bench.doing = "confidences of 0 before the first vote"
    bench.round((ONE, 0), (ONE, 0), (0, 0))
    bench.doing = "the first vote, as far from the centre as the spread"
    bench.round((ONE - HALF // 2, ALPHA_MAX), senders=one[:1])
    bench.doing = "votes of robots whose ids modulo 32 are two"
    end = 0 if 2 * s.crowd.first >= 1 << 32 else ONE
    for _ in range(2):
        _vote(bench, [end] * 6, one[:3] + other[:3])
    _bring(bench, "two voices", lambda: _rejects(bench), lambda: _vote(bench, [end] * 6, one[:3] + other[:3]))
    _test(bench)
    bench.doing = "a vote of a third"
    _vote(bench, [end], third[:1])
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
            bench.doing = f"a vote just {'outside' if is_outside else 'inside'} the spread"
            alphas = (ALPHA_MAX, _LEAST_ALPHA) * 3
            bench.round(*zip((value, *[ONE - end] * 4), alphas, strict=False))


def moving(end: int) -> Callable[[Bench], None]:
    """A phase in which all votes are for ``end``, 0 or 1, until there is no test and the gain is back."""

    def play(bench: Bench) -> None:
        bench.doing = "votes for one side"
        count = _votes_until_moving(bench, end) - 1
        for first in range(0, count, _ALL):
            _vote(bench, [end] * min(count - first, _ALL))
        _test(bench)
        if bench.firmware.s.crowd.spread < MODERATE and not _rejects(bench):
            bench.tick(_up_to(bench, True))
        bench.doing = "the vote with which the crowd moves"
        _vote(bench, [end])
        _test(bench)
        bench.doing = "votes after the crowd has moved"
        _vote(bench, [ONE - end] * 5)

    return play


def thresholds(spread: int) -> Callable[[Bench], None]:
    """A phase in which the crowd's spread becomes at most ``spread``, and the test then rejects and just does
    not, and again: b_hat is found anew, and the first one comes back."""

    def play(bench: Bench) -> None:
        crowd, draw = bench.firmware.s.crowd, bench.draw
        bench.doing = "votes from both sides"
        _bring(
            bench,
            "a crowd in the middle",
            lambda: abs(crowd.centre - (1 << 29)) < 1 << 28 and 1 << 14 < crowd.trend < 3 << 14,
            lambda: _vote(bench, [draw.randint(0, ONE) for _ in range(_ALL)]),
        )
        width = spread >> 7
        bench.doing = "votes that agree"

        def agree() -> None:
            values = [(crowd.centre >> 7) + draw.randint(-width, width) for _ in range(_ALL)]
            _vote(bench, [min(max(value, 0), ONE) for value in values])

        _bring(bench, f"a spread of {spread / 2**30:g}", lambda: crowd.spread <= spread, agree)
        for _ in range(_MORE_ROUNDS if spread == NARROW else 0):
            agree()
        for side in (1, -1 if spread == NARROW else 1):
            _cross(bench, side)

    return play


def many_votes(bench: Bench) -> None:
    """Twice as many votes as count, of both sides, and then a round of one side."""
    bench.doing = "many votes"
    for _ in range(2 * VOTES_MAX // _ALL + 1):
        _vote(bench, [0, ONE] * (_ALL // 2))
    bench.doing = "votes with the least gain"
    _vote(bench, [ONE] * _ALL)


def _vote(bench: Bench, values: list[int], senders: list[int] | None = None) -> None:
    """A round of votes."""
    bench.round(*((value, ordinary_alpha(bench.draw)) for value in values), senders=senders)


def _test(bench: Bench) -> None:
    """Nothing until the next test, and that."""
    bench.to_test()
    bench.round()


def _bring(bench: Bench, what: str, is_there: Callable[[], bool], step: Callable[[], None]) -> None:
    """Steps until it is there."""
    for _ in range(_MOST_ROUNDS):
        if is_there():
            return
        step()
    bench.missed.append(what)


def _rejects(bench: Bench, z: Observation | None = None) -> bool:
    """Whether the test would reject now, or after an observation."""
    robot = deepcopy(bench.firmware)
    if z is not None:
        robot.observe(z)
    return robust_test_rejects(robot.s.crowd, robot.s.t, robot.s.n)


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
        bench.tick(Observation(is_black))
    bench.missed.append(f"{bench.doing}: a test that {'rejects' if wanted else 'does not reject'}")
    return None


def _cross(bench: Bench, side: int) -> None:
    """Tests just before a threshold and just behind it, and back again."""
    for _ in range(2):
        bench.doing = "observations of one colour"
        colour = _up_to(bench, not _rejects(bench), side)
        if colour is None:
            return
        for z in (None, colour):
            bench.tick(z)
            bench.doing = "a test that " + ("just rejects" if _rejects(bench) else "just does not reject")
            _test(bench)
