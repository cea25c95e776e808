"""Estimates crafted for a robot with the robust filter, which decide its test by a hair.

The robust filter keeps the latest estimate of each sender in a slot. Its test asks whether the observations
of the robot contradict the centre of these estimates. A neighbour can set a slot to any value, so a test is
brought to its threshold by the estimates alone: one unit of one slot makes the difference.

Estimates in slots are in units of 2**-16, probabilities and shares in units of 1.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property
from random import Random

from mcp_asdf.mirror import INFORMATIVE_G, State
from mcp_asdf.robust_filter import (
    SLOT_ESTIMATE_MAX,
    RobustFilter,
    centre_and_spread_of,
    end_batch,
    is_supported,
    q24_from_q16,
    robust_test_rejects,
)

SLOT_ONE = SLOT_ESTIMATE_MAX + 1
"""1.0 in the unit of slots, which no estimate reaches."""
SLOT_HALF = SLOT_ONE // 2
SLOT_INFORMATIVE_DISTANCE = INFORMATIVE_G >> 17
"""Distance from 1/2 from which on an estimate is enough to re-estimate b_hat (eq. 8), in units of 2**-16.

It is 2**-13: half of INFORMATIVE_G, which is 2**-12 in units of 2**-32. The shift is by 1 and 16 bits."""


@dataclass(frozen=True)
class SlotsAtTest:
    """Estimates against which a robot would test itself, and what its test needs beside them.

    Attributes:
        estimates: The estimate of each slot.
        robust: What the robot remembers at the test, with the dispersion that it has there.
        t: Number of its observations.
        n: Number of black ones among them.
    """

    estimates: tuple[int, ...]
    robust: RobustFilter
    t: int
    n: int

    @property
    def is_rejected(self) -> bool:
        """Whether the test rejects the initial b_hat."""
        centre, spread = self._centre_and_spread
        return robust_test_rejects(self.robust, self.t, self.n, centre, spread)

    @property
    def is_decided_by_last_bit(self) -> bool:
        """Whether the test would decide otherwise if the centre of the estimates were a unit of 2**-24 off.

        Then a test in other arithmetic, such as float32, is likely to decide otherwise, too.
        """
        centre, spread = self._centre_and_spread
        decisions = set()
        for neighbouring_centre in (centre - 1, centre, centre + 1):
            decisions.add(robust_test_rejects(self.robust, self.t, self.n, neighbouring_centre, spread))
        return len(decisions) > 1

    @property
    def is_supported(self) -> bool:
        """Whether so many estimates support the robot that a test which rejects has no effect."""
        centre, _ = self._centre_and_spread
        tested_estimates = [q24_from_q16(estimate) for estimate in self.estimates]
        return is_supported(self.robust, self.t, self.n, tested_estimates, centre)

    def moved(self, direction: int, steps: int) -> SlotsAtTest:
        """Return the slots after this number of steps, each of which moves one estimate by a unit of 2**-16.

        The estimates are moved by turns. They move up for a ``direction`` of 1 and down for -1, and stop at
        the ends of a slot's range.
        """
        full_rounds, remaining_steps = divmod(steps, len(self.estimates))
        moved_estimates = []
        for index, estimate in enumerate(self.estimates):
            has_step_of_last_round = index < remaining_steps
            distance = full_rounds + 1 if has_step_of_last_round else full_rounds
            moved_estimates.append(_limit_estimate(estimate + direction * distance))
        return replace(self, estimates=tuple(moved_estimates))

    @cached_property
    def _centre_and_spread(self) -> tuple[int, int]:
        """Centre and spread of the estimates, in units of 2**-24."""
        return centre_and_spread(self.estimates)


def centre_and_spread(estimates: Sequence[int]) -> tuple[int, int]:
    """Return the centre and the spread of estimates, which are in units of 2**-16, in units of 2**-24."""
    ascending_q24_estimates = sorted(q24_from_q16(estimate) for estimate in estimates)
    return centre_and_spread_of(ascending_q24_estimates)


def filter_at_test(robot: State) -> RobustFilter:
    """Return the robust filter's memory as it would be at a test that comes before the next observation.

    The test would first end the batch of observations, which changes the dispersion. The robot stays as it
    is.
    """
    robust = copy(robot.robust)
    end_batch(robust, robot.t, robot.n)
    return robust


def estimate_that_predicts(robust: RobustFilter, share: float) -> int:
    """Return the fill ratio at which a robot of this initial b_hat should observe a ``share`` of black.

    The result is in units of 2**-16, as an estimate in a slot. If no estimate predicts the share, it is 0 or
    the largest one, whichever predicts a nearer one. With an initial b_hat of exactly 1/2 every estimate
    predicts a share of 1/2; then the result is 1/2.
    """
    initial_b_hat = robust.initial_b_hat / 2**32
    if initial_b_hat == 0.5:
        return SLOT_HALF
    # This solves share = b_hat * fill_ratio + (1 - b_hat) * (1 - fill_ratio).
    fill_ratio = (share + initial_b_hat - 1) / (2 * initial_b_hat - 1)
    return _limit_estimate(round(fill_ratio * SLOT_ONE))


def agreeing_estimate(robot: State) -> int:
    """Return the estimate that best predicts the share of black observations of a robot that has observed.

    It is in units of 2**-16.
    """
    return estimate_that_predicts(robot.robust, robot.n / robot.t)


def opposite_end(estimate: int) -> int:
    """Return 0 for an estimate above 1/2, and the largest estimate for any other. Units are 2**-16."""
    return 0 if estimate > SLOT_HALF else SLOT_ESTIMATE_MAX


def slots_at_test(robot: State, estimates: Sequence[int]) -> SlotsAtTest:
    """Return these estimates, and all that a test before the robot's next observation needs of its state."""
    return SlotsAtTest(tuple(estimates), filter_at_test(robot), robot.t, robot.n)


def draw_slots_at_threshold(
    robot: State, count: int, width: int, rng: Random
) -> tuple[SlotsAtTest, SlotsAtTest] | None:
    """Draw estimates by which a robot's test just does not reject, and by which it just does.

    The second estimates differ from the first by one unit in one slot, and at most two fifths of them support
    the robot. The test comes before the robot's next observation.

    Args:
        robot: State of the robot after its last observation before the test.
        count: Number of estimates.
        width: How far the estimates are from their middle, at most, in units of 2**-16.
        rng: Source of the estimates.

    Returns:
        The estimates by which the test does not reject, and those by which it does; None if there are none in
        the direction that was drawn, or if too many of the second ones support the robot.
    """
    # The first estimates agree with the observations, and are then moved away from them in one direction.
    middle = agreeing_estimate(robot)
    estimates = [middle + rng.randint(-width, width) for _ in range(count)]
    slots = slots_at_test(robot, estimates)
    direction = rng.choice((-1, 1))
    steps_to_end = count * SLOT_ONE  # after them all estimates are at the end of the range
    if slots.is_rejected or not slots.moved(direction, steps_to_end).is_rejected:
        return None
    accepted_steps = _last_steps_accepted(slots, direction, steps_to_end)
    accepted_slots = slots.moved(direction, accepted_steps)
    rejected_slots = slots.moved(direction, accepted_steps + 1)
    if rejected_slots.is_supported:
        return None
    return accepted_slots, rejected_slots


def _last_steps_accepted(slots: SlotsAtTest, direction: int, rejected_steps: int) -> int:
    """Return a number of steps after which the test does not reject, though it does after one step more.

    The estimates are moved in this direction. The test must not reject after 0 steps, and must after
    ``rejected_steps``. The number is found by bisection.
    """
    accepted_steps = 0
    while rejected_steps - accepted_steps > 1:
        middle_steps = (accepted_steps + rejected_steps) // 2
        if slots.moved(direction, middle_steps).is_rejected:
            rejected_steps = middle_steps
        else:
            accepted_steps = middle_steps
    return accepted_steps


def slots_with_supporters(robot: State, count: int, supporter_count: int) -> SlotsAtTest | None:
    """Return ``count`` estimates by which a robot's test rejects, although some of them support the robot.

    ``supporter_count`` of them predict the share of black that the robot has observed. The others agree on
    the estimate that contradicts it most. Returns None if the test does not reject by these estimates, or if
    the firmware would count others as supporters, too, or not all of these.
    """
    supporter = agreeing_estimate(robot)
    other = opposite_end(supporter)
    estimates = (supporter,) * supporter_count + (other,) * (count - supporter_count)
    slots = slots_at_test(robot, estimates)
    should_be_supported = 5 * supporter_count > 2 * count  # more than two in five
    if not slots.is_rejected or slots.is_supported != should_be_supported:
        return None
    return slots


def _limit_estimate(estimate: int) -> int:
    """Return the estimate, or the nearer end of the range that a slot can have."""
    return min(max(estimate, 0), SLOT_ESTIMATE_MAX)
