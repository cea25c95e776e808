"""Votes that bring the crowd of the robust filter to an exact state: a centre, a trend, or a threshold.

The crowd summarises the estimates that a robot has received, each of which is a vote for its x_hat, in units
of 2**-23. Its centre is where the votes lie, and its spread the median of their distances from there, both in
units of 2**-30. Its trend is the share of the centre's recent moves that went up, in units of 2**-16.

No function changes the crowd that it is given.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from typing import NamedTuple

from mcp_asdf.fixed_point import ONE
from mcp_asdf.mirror import (
    TREND_SHIFT,
    TREND_STEP_EVEN,
    TREND_STEP_UP,
    VOTES_MAX,
    VOTES_OF_MAX_GAIN,
    Crowd,
    q23_from_q30,
    robust_test_rejects,
    update_crowd,
)

MAX_VOTES_IN_ROUND = 126
"""Votes of a round in which every other robot has one."""
UP, DOWN, NO_MOVE = 1, -1, 0
"""Moves of the centre at a vote."""

_VOTES_TO_THRESHOLD = 40
"""Votes, each a spread away, within whose reach a threshold of the test is looked for."""
_ANY_SENDER = 0
"""The sender of a vote has no influence on centre, spread and trend."""


def crowd_after(crowd: Crowd, x_hats: Sequence[int]) -> Crowd:
    """Return a copy of a crowd after votes for these x_hat."""
    changed_crowd = copy(crowd)
    for x_hat in x_hats:
        update_crowd(changed_crowd, _ANY_SENDER, x_hat)
    return changed_crowd


def count_votes_until_moving(crowd: Crowd, x_hat: int) -> int:
    """Return how many votes for the same x_hat it takes until the crowd counts as moving."""
    changed_crowd, count = copy(crowd), 0
    while not changed_crowd.is_moving:
        update_crowd(changed_crowd, _ANY_SENDER, x_hat)
        count += 1
    return count


def votes_to_centre(crowd: Crowd, target: int) -> list[int] | None:
    """Return x_hat of the votes that move the centre to exactly ``target``, in units of 2**-30.

    Returns None if no votes of one round do.
    """
    moved = _move_to_centre(crowd, target)
    return None if moved is None else moved.x_hats


class _MovedCrowd(NamedTuple):
    """Votes for these x_hat, and the crowd after them."""

    x_hats: list[int]
    crowd: Crowd


def _move_to_centre(crowd: Crowd, target: int) -> _MovedCrowd | None:
    """Return the votes that move the centre to exactly ``target``, and the crowd then.

    Returns None if no votes of one round do.
    """
    crowd = copy(crowd)
    x_hats: list[int] = []
    while crowd.centre != target:
        if len(x_hats) == MAX_VOTES_IN_ROUND:
            return None
        gain_shift = _gain_shift(min(crowd.votes + 1, VOTES_MAX))
        missing = abs(target - crowd.centre)
        # A vote moves the centre by its distance shifted right, so the last one may be this far away, or
        # farther by less than 2**gain_shift. Others are as far away as the spread, which then shrinks.
        is_last = missing <= crowd.spread >> gain_shift
        distance = missing << gain_shift if is_last else crowd.spread
        direction = UP if target > crowd.centre else DOWN
        position = crowd.centre + direction * distance
        # The last vote is rounded away from the centre, lest its step be too short, and the others towards
        # it, lest they be outside the spread.
        is_above_centre = direction == UP
        is_rounded_up = is_above_centre if is_last else not is_above_centre
        x_hat = q23_from_q30_rounded_up(position) if is_rounded_up else q23_from_q30(position)
        if not 0 <= x_hat <= ONE:
            return None  # no vote can be so far away
        x_hats.append(x_hat)
        update_crowd(crowd, _ANY_SENDER, x_hat)
        if is_last and crowd.centre != target:
            return None  # an x_hat is too coarse to move the centre by this distance
    return _MovedCrowd(x_hats, crowd)


def q23_from_q30_rounded_up(position: int) -> int:
    """Convert a position from units of 2**-30 to units of 2**-23, rounded up."""
    return -q23_from_q30(-position)


def _gain_shift(votes: int) -> int:
    """Return by how many bits the distance of the last of so many votes is shifted, to move the centre.

    It is 3 up to 63 votes, as in ``update_crowd``, and one more at each further power of two.
    """
    return max(votes, VOTES_OF_MAX_GAIN).bit_length() - 3


def votes_to_threshold(crowd: Crowd, t: int, n: int, is_rejection_wanted: bool) -> list[int] | None:
    """Return x_hat of the votes that move the centre next to the threshold of the robust filter's test.

    The test of ``n`` black among ``t`` observations then just rejects, or just does not; if the centre moved
    by one unit of 2**-30 more, or less, it would decide otherwise. Returns None if the threshold is too far
    from the centre, or too near 0 or 1.
    """

    def rejects_at(centre: int) -> bool | None:
        """Return what the test decides with this centre; None if no votes move it there."""
        moved = _move_to_centre(crowd, centre)
        return None if moved is None else robust_test_rejects(moved.crowd, t, n)

    reach = (_VOTES_TO_THRESHOLD * crowd.spread) >> _gain_shift(crowd.votes)
    decision_here = rejects_at(crowd.centre)
    # The test is looked for below the centre first, and then above it.
    for end in (crowd.centre - reach, crowd.centre + reach):
        decision_there = rejects_at(end)
        if decision_there is None or decision_there == decision_here:
            continue
        # Bisect: the test decides at ``near`` as it does here, and at ``far`` otherwise.
        near, far = crowd.centre, end
        while abs(far - near) > 1:
            middle = (near + far) // 2
            decision = rejects_at(middle)
            if decision is None:
                return None
            if decision == decision_here:
                near = middle
            else:
                far = middle
        return votes_to_centre(crowd, near if decision_here == is_rejection_wanted else far)
    return None


def moves_to_trend(start: int, target: int) -> list[int] | None:
    """Return the shortest sequence of moves, UP, DOWN or NO_MOVE, that leads from one trend to another.

    Returns None if there is none.
    """
    added_by_move = {UP: TREND_STEP_UP, NO_MOVE: TREND_STEP_EVEN, DOWN: 0}
    # Breadth-first search; of each trend that was reached it keeps the one before, and the move between them.
    trend_and_move_before: dict[int, tuple[int, int]] = {start: (start, NO_MOVE)}
    last_reached = [start]
    while last_reached and target not in trend_and_move_before:
        newly_reached = []
        for trend in last_reached:
            for move, added in added_by_move.items():
                next_trend = trend - (trend >> TREND_SHIFT) + added
                if next_trend not in trend_and_move_before:
                    trend_and_move_before[next_trend] = trend, move
                    newly_reached.append(next_trend)
        last_reached = newly_reached
    if target not in trend_and_move_before:
        return None
    # Go back from the target to the start, and then turn the moves around.
    moves: list[int] = []
    trend = target
    while trend != start:
        trend, move = trend_and_move_before[trend]
        moves.append(move)
    return moves[::-1]


def votes_of_moves(crowd: Crowd, moves: Sequence[int]) -> list[int]:
    """Return x_hat of votes that move the centre UP or DOWN, or with NO_MOVE leave it where it is."""
    crowd = copy(crowd)
    x_hats = []
    for move in moves:
        # A vote at the centre is so near it that the step is 0.
        x_hat_by_move = {UP: ONE, DOWN: 0, NO_MOVE: q23_from_q30(crowd.centre)}
        x_hat = x_hat_by_move[move]
        x_hats.append(x_hat)
        update_crowd(crowd, _ANY_SENDER, x_hat)
    return x_hats
