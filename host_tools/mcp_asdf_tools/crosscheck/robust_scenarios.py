"""Random scenarios of robots with the robust filter, as ``random_scenarios`` has them of the paper's filters.

Robots are restored with any memory that the filter may have: votes, slots with estimates, and a batch of
observations. Many of these lie next to a limit: a vote at the distance of the spread, a batch whose deviation
is just an outlier, estimates that decide the test by one unit, and supporters that are two in five.
"""

from __future__ import annotations

from dataclasses import asdict, replace
from math import isqrt
from random import Random

from mcp_asdf.arithmetic import Q32_HALF, Q32_ONE, q32_quotient
from mcp_asdf.fixed_point import B_HAT_MAX, B_HAT_MIN, ONE
from mcp_asdf.mirror import State, accuracy_of
from mcp_asdf.robot import MAX_ID, Filter
from mcp_asdf.robust_filter import (
    CENTRE_MAX,
    CENTRE_START,
    DISPERSION_MAX,
    DISPERSION_MIN,
    REJECTED_SIGMAS_SQUARED,
    SLOT_ESTIMATE_MAX,
    SLOTS,
    SPREAD_MAX,
    SPREAD_MIN,
    TESTED_ESTIMATES_MIN,
    VOTES_MAX,
    RobustFilter,
    probability_of_black,
    q23_from_q16,
    q23_from_q30,
    q24_from_q16,
    q30_from_q23,
    q32_from_q24,
    slot_estimate,
)
from mcp_asdf_tools.crosscheck.crafted_slots import (
    SLOT_HALF,
    SLOT_INFORMATIVE_DISTANCE,
    SLOT_ONE,
    centre_and_spread,
    draw_slots_at_threshold,
    slots_with_supporters,
)
from mcp_asdf_tools.crosscheck.random_scenarios import ScenarioWriter, draw_setup
from mcp_asdf_tools.crosscheck.random_values import (
    clamp,
    draw_at_edges,
    draw_at_ends,
    draw_b_hat,
    draw_n,
    draw_number_of_any_size,
    draw_t,
    draw_usual_alpha,
)
from mcp_asdf_tools.crosscheck.scenario import Scenario

_SLOT_UNIT = q30_from_q23(q23_from_q16(1))
"""Unit of the estimates in slots, as a number of units of the votes."""

_DISTANCES_OF_SLOW_CENTRE = (0, 3, 3, 3, 6, 7, 8, 14, 41, 41, 41, 68, 68, 164, 186, 377, 377, *([833] * 15))
"""Distances of estimates from the smallest, with which each of five steps still moves their centre.

They were found by search.
"""

_MAX_DRAWS = 10
"""Robots that are drawn to find one for which there are estimates of a kind."""


def robust_scenario(seed: int, index: int) -> Scenario:
    """Return a scenario of a robot with the robust filter, of up to a few hundred calls.

    Each pair of ``seed`` and ``index`` gives its own scenario, always the same.
    """
    rng = Random(f"{seed}/robust/{index}")
    setup = replace(draw_setup(rng), table=None, filter=int(Filter.ROBUST))
    return RobustScenarioWriter(rng, setup).write()


class RobustScenarioWriter(ScenarioWriter):
    """Writes one scenario of a robot with the robust filter, which has slots and votes in place of rounds."""

    # --- Calls ---

    def _add_restore_at_limits(self) -> None:
        """Restore a drawn robot whose filter remembers one value at its limit or just beyond, and settle.

        So the firmware must refuse some of these images. In one of ten cases the estimate of a slot is
        replaced, too, though the slot may be empty.
        """
        rng = self._rng
        robot = self._draw_robot()
        numbers = self._image_numbers(robot)
        limits_by_name = _limits_by_name(robot)
        name = rng.choice(list(limits_by_name))
        value = rng.choice(limits_by_name[name]) + rng.choice([-1, 0, 0, 1])
        numbers[name] = self._clamp_to_image(name, value)
        if rng.random() < 0.1:
            # The estimate of an empty slot must be 0.
            slot = rng.randrange(SLOTS)
            numbers[f"estimates_{slot}"] = rng.choice([0, 1, SLOT_ESTIMATE_MAX])
        self._add_restore(numbers)
        self._add_call("settle")

    def _add_test_at_threshold(self) -> None:
        """Run the filter on estimates with which the smallest mistake in its test or centre shows.

        In some sets a unit of one estimate decides whether the test rejects, or one estimate decides whether
        the robot is supported. In other sets the centre is far from the median, or is reached slowly. If no
        such estimates are found for the robots that are drawn, no calls are added.
        """
        rng = self._rng
        # Most often the least and the largest numbers of estimates that are tested
        count = rng.choice([5, 5, 6, 31, 32, rng.randint(TESTED_ESTIMATES_MIN, SLOTS)])
        draw_estimates = rng.choice(
            [
                self._draw_estimates_at_threshold,
                self._draw_estimates_at_threshold,
                self._draw_supporters_and_others,
                self._draw_supporters_and_others,
                self._draw_supporters_and_tie,
                self._draw_opposite_estimates,
                self._draw_skewed_estimates,
                self._draw_slowly_centred_estimates,
            ]
        )
        for _ in range(_MAX_DRAWS):
            robot = self._draw_robot()
            estimates = draw_estimates(robot, count)
            if estimates is not None:
                _fill_slots(robot, estimates, rng)
                self._add_filter_run_of(robot)
                return

    def _add_filter_near_one_half(self) -> None:
        """Run the filter with a centre of estimates just far enough from 1/2 for a re-estimate, or just not.

        In half of the cases the centre is about 1/2 itself.
        """
        rng = self._rng
        robot = self._draw_robot()
        distance = rng.choice([0, SLOT_INFORMATIVE_DISTANCE]) + rng.randint(-1, 1)
        middle = SLOT_HALF + rng.choice([-1, 1]) * distance
        count = rng.randint(TESTED_ESTIMATES_MIN, SLOTS)
        # Among several estimates some are one unit higher, so that their centre lies between two units.
        raised_count = rng.choice([0, 0, 1, rng.randint(0, count)])
        estimates = (middle,) * (count - raised_count) + (middle + 1,) * raised_count
        _fill_slots(robot, estimates, rng)
        # With observations of one colour, none or all of t, the test rejects.
        _replace_observations(robot, rng.choice([0, robot.t, robot.n]))
        self._add_filter_run_of(robot)

    def _add_filter_run_of(self, robot: State) -> None:
        """Append calls that restore this robot from an image, and end a round at whose end its filter runs.

        In one of five cases the robot receives a message before the round ends, whose estimate may replace
        one of those that it keeps and tests itself against.
        """
        self._add_restore(self._image_numbers(robot) | {"filter_left": 1, **self._draw_counters()})
        if self._rng.random() < 0.2:
            self._add_receive()
        self._add_call("settle")  # ends the round

    # --- Images ---

    def _image_numbers(self, robot: State) -> dict[str, int]:
        """Return the numbers of an image of this robot, by name, with an x_hat and alpha that are drawn.

        An earlier test may have changed the robot's b_hat. If so, the present b_hat is drawn, too, in half of
        the cases: if the next test passes, the initial one must come back. ``self._b_hat`` becomes the
        present b_hat.
        """
        rng = self._rng
        self._b_hat = robot.robust.initial_b_hat
        if _may_have_been_tested(robot) and rng.random() < 0.5:
            self._b_hat = draw_b_hat(rng)
        own_position = q23_from_q30(self._draw_vote_at_edge(robot.robust))
        return {
            "b_hat": self._b_hat,
            "t": robot.t,
            "n": robot.n,
            "x_hat": draw_at_edges(rng, [own_position], 0, ONE),
            # Without confidence (0) the robot's own estimate does not vote.
            "alpha": rng.choice([0, draw_usual_alpha(rng)]),
            # As if b_hat had just changed: otherwise x_hat and alpha would have to follow from it.
            "updated": 1,
            **_memory_numbers(robot),
        }

    def _draw_filter_memory(self, t: int, n: int) -> dict[str, int]:
        """Draw what the robust filter remembers after t observations of which n were black, by name.

        The present b_hat is ``self._b_hat``. The initial one differs from it at most where a test may have
        changed b_hat.
        """
        robot = self._draw_robot_after(t, n, initial_b_hat=self._b_hat)
        if _may_have_been_tested(robot):
            robot.robust.initial_b_hat = self._rng.choice([self._b_hat, draw_b_hat(self._rng)])
        return _memory_numbers(robot)

    # --- Values ---

    def _draw_robot(self) -> State:
        """Draw a robot with any counts, any initial b_hat, which is also the present one, and any memory."""
        rng = self._rng
        t = max(draw_t(rng, self._setup.memory), 1)
        initial_b_hat = draw_b_hat(rng)
        n = draw_n(rng, t, initial_b_hat)
        return self._draw_robot_after(t, n, initial_b_hat)

    def _draw_robot_after(self, t: int, n: int, initial_b_hat: int) -> State:
        """Draw a robot with these counts and this b_hat, and what its filter remembers, within its limits.

        ``n`` of its ``t`` observations were black. The initial b_hat is also the present one.
        """
        robot = State(self._setup.robot_id, accuracy_of(initial_b_hat), filter_left=1, t=t, n=n)
        robot.robust.initial_b_hat = initial_b_hat
        robot.robust.filled_slots = self._draw_filled_slots()
        # Only estimates that are kept vote.
        if robot.robust.filled_slots:
            # The gain halves where their number reaches a power of two, the last of which is the limit.
            robot.robust.votes = draw_at_edges(self._rng, [0, 1 << self._rng.randrange(10)], 0, VOTES_MAX)
        if robot.robust.votes > 0:
            self._fill_in_votes(robot.robust)
        self._fill_in_batch(robot)
        robot.estimates = self._draw_estimates(robot.robust)
        return robot

    def _fill_in_votes(self, robust: RobustFilter) -> None:
        """Draw the centre and the spread of the votes, and whose turn to vote is next.

        The centre is often near the x_hat of messages, 0 or 1. The spread is often next to a power of two:
        the firmware shifts it to change it, and rounds otherwise where it has one bit less.
        """
        rng = self._rng
        centre_of_messages = q30_from_q23(self._common_x_hat)
        centre = draw_at_edges(rng, [0, centre_of_messages, CENTRE_MAX], 0, CENTRE_MAX)
        power_of_two = 1 << rng.randrange(18, 29)  # from SPREAD_MIN to SPREAD_MAX
        spread = draw_at_edges(rng, [SPREAD_MIN, power_of_two, power_of_two], SPREAD_MIN, SPREAD_MAX)
        # In half of the cases they are multiples of the unit of slots, so that a vote can be at the centre,
        # or exactly as far from it as the spread.
        unit = rng.choice([1, _SLOT_UNIT])
        robust.centre = centre // unit * unit
        robust.spread = spread // unit * unit
        robust.turn = self._draw_turn(robust)

    def _draw_turn(self, robust: RobustFilter) -> int:
        """Draw the turn to vote: that of slot 0, or of the slot after a filled one, often after the last."""
        filled_slots = [slot for slot in range(SLOTS) if robust.is_filled(slot)]
        after_any = self._rng.choice(filled_slots) + 1
        after_last = filled_slots[-1] + 1
        return self._rng.choice([0, after_any, after_last])

    def _draw_filled_slots(self) -> int:
        """Draw which slots are filled, as a mask of a bit a slot: none, one, about five, any number, all.

        Five are just enough for a test.
        """
        rng = self._rng
        count = rng.choice([0, 1, 4, 5, 5, 6, rng.randint(0, SLOTS), SLOTS - 1, SLOTS])
        return sum(1 << slot for slot in rng.sample(range(SLOTS), count))

    def _fill_in_batch(self, robot: State) -> None:
        """Draw the dispersion of a robot's observations, and the batch that its next run of the filter ends.

        The batch is the last of its observations. Drawn are how many these are, and how many of them were
        black: often the expected number, or one so far from it that the batch is just an outlier, or just
        not. From these follow the counts with which the batch began. If it began with the first observation,
        no batch has ended yet, and the dispersion is that of a new robot.
        """
        rng = self._rng
        t, n = robot.t, robot.n
        batch_count = draw_at_ends(rng, 0, t)
        if batch_count == t:
            return
        robot.robust.dispersion = draw_at_ends(rng, DISPERSION_MIN, DISPERSION_MAX)
        expected_black_count = batch_count * n // t
        deviation = _largest_usual_deviation(robot, batch_count)
        # The batch has no more observations of a colour than the robot has made in all.
        smallest_black_count = max(batch_count - (t - n), 0)
        largest_black_count = min(batch_count, n)
        black_count = draw_at_edges(
            rng,
            [expected_black_count - deviation, expected_black_count, expected_black_count + deviation],
            smallest_black_count,
            largest_black_count,
        )
        robot.robust.batch_t = t - batch_count
        robot.robust.batch_n = n - black_count

    def _draw_estimates(self, robust: RobustFilter) -> list[int]:
        """Draw the estimates of all slots, in units of 2**-16: 0 for an empty slot.

        About half of the filled slots share one estimate, for which `_draw_vote_at_edge` draws a vote, or a
        unit beside that. The others have estimates as of messages.
        """
        rng = self._rng
        shared_position = self._draw_vote_at_edge(robust) // _SLOT_UNIT + rng.randint(-1, 1)
        shared_estimate = clamp(shared_position, 0, SLOT_ESTIMATE_MAX)
        estimates = [0] * SLOTS
        for slot in range(SLOTS):
            if robust.is_filled(slot):
                estimate_of_message = slot_estimate(min(self._draw_x_hat(), ONE))
                estimates[slot] = rng.choice([shared_estimate, estimate_of_message])
        return estimates

    def _draw_vote_at_edge(self, robust: RobustFilter) -> int:
        """Draw where a vote meets an edge: at the centre of the votes, or the spread above or below it.

        The result is in units of 2**-30, and may be out of 0 .. 1.
        """
        return robust.centre + self._rng.choice([-1, 0, 1]) * robust.spread

    def _draw_sender(self) -> int:
        """Draw the id of a sender, in one of four cases one of those that share the first ten slots."""
        rng = self._rng
        # Ids that are SLOTS apart share a slot.
        id_of_first_slots = rng.randrange(10) + SLOTS * rng.randrange((MAX_ID + 1) // SLOTS)
        return id_of_first_slots if rng.random() < 0.25 else super()._draw_sender()

    # --- Estimates for a test ---

    def _draw_estimates_at_threshold(self, robot: State, count: int) -> tuple[int, ...] | None:
        """Draw estimates by which the robot's test just rejects, or just does not; None if there are none."""
        # The estimates are at most so far from their middle.
        width = draw_number_of_any_size(self._rng, 1, 15)
        drawn_slots = draw_slots_at_threshold(robot, count, width, self._rng)
        if drawn_slots is None:
            return None
        chosen_slots = self._rng.choice(drawn_slots)
        return chosen_slots.estimates

    def _draw_supporters_and_others(self, robot: State, count: int) -> tuple[int, ...] | None:
        """Draw estimates by which the robot's test rejects, though two in five support it, or one more.

        The others agree on an estimate that contradicts its observations. There are 15, 20, 25 or 30, for any
        ``count``. The result is None if the test does not reject by such estimates.
        """
        fifth = self._rng.randint(3, 6)
        supporter_count = 2 * fifth + self._rng.randint(0, 1)
        slots = slots_with_supporters(robot, 5 * fifth, supporter_count)
        return None if slots is None else slots.estimates

    def _draw_supporters_and_tie(self, robot: State, count: int) -> tuple[int, ...] | None:
        """Draw estimates: two in five support the robot, and one more almost does.

        The others agree on another estimate. There are at least 12 estimates, also for a smaller ``count``,
        so that the others are more than a half. The robot gets observations by which that one estimate is in
        a tie, which must not count as support; the result is None if there are no such observations.
        """
        count = max(count, 12)
        supporter_count = 2 * count // 5
        tied, other = self._rng.sample(range(SLOT_ONE), 2)
        supporter = clamp(2 * tied - other, 0, SLOT_ESTIMATE_MAX)  # which predicts what the robot observes
        other_count = count - supporter_count - 1
        estimates = (supporter,) * supporter_count + (tied,) + (other,) * other_count
        share = _black_share_of_tie(robot, tied, estimates)
        # Each of 2**30 observations is 4 units of the share, and the firmware's n / t is 1 to 4 too small.
        t = 1 << 30
        n = share // 4 + 1
        is_possible = 0 <= n <= t < self._setup.memory and q32_quotient(n, t) == share
        if not is_possible:
            return None
        robot.t = t
        _replace_observations(robot, n)
        return estimates

    def _draw_opposite_estimates(self, robot: State, count: int) -> tuple[int, ...]:
        """Draw as many estimates of 0 as of the largest, so that their spread is above the largest one.

        There are at least six, and one less than ``count`` if that is odd. The robot gets a b_hat, and
        observations of one colour, by which its test rejects, but would not if the spread were not limited.
        """
        rng = self._rng
        # The centre, 1/2, predicts half black, and the share of black is 1/2 off. So the test rejects if
        # 1/4 > 12 g**2 spread**2 for g = 2 b_hat - 1. The limited spread is 1/4, and without limit it is 1/2.
        distance_from_half = round(rng.uniform(0.15, 0.28) * Q32_ONE)  # g is twice that
        robot.robust.initial_b_hat = Q32_HALF + rng.choice([-1, 1]) * distance_from_half
        _replace_observations(robot, rng.choice([0, robot.t]))
        return (0, SLOT_ESTIMATE_MAX) * max(count // 2, 3)

    def _draw_skewed_estimates(self, robot: State, count: int) -> tuple[int, ...]:
        """Draw estimates on one side of a point, at small distances from it as often as at large ones.

        So their Huber centre is far from their median, from which its computation starts. The point is any
        estimate, 0 or the largest one. The estimates have nothing to do with ``robot``.
        """
        rng = self._rng
        point = rng.choice([rng.randint(0, SLOT_ESTIMATE_MAX), 0, SLOT_ESTIMATE_MAX])
        # Distances of any size come from a number of bits each, so small ones are as frequent as large ones.
        max_bits = rng.randint(2, 16)
        direction = rng.choice([-1, 1])
        distances = [draw_number_of_any_size(rng, 0, max_bits) for _ in range(count)]
        return tuple(clamp(point + direction * distance, 0, SLOT_ESTIMATE_MAX) for distance in distances)

    def _draw_slowly_centred_estimates(self, robot: State, count: int) -> tuple[int, ...]:
        """Draw 32 estimates whose Huber centre three steps do not reach, so that a fourth would show.

        There are 32 for any ``count``. The robot gets observations with any share of black: a b_hat that is
        re-estimated from them is seldom at a limit, where it would not show the centre.
        """
        rng = self._rng
        _replace_observations(robot, rng.randint(0, robot.t))
        direction = rng.choice([-1, 1])
        scale = rng.choice([1, 2, 4, 8])
        start = rng.randint(0, SLOT_ESTIMATE_MAX)
        distances = [scale * distance for distance in _DISTANCES_OF_SLOW_CENTRE]
        return tuple(clamp(start + direction * distance, 0, SLOT_ESTIMATE_MAX) for distance in distances)


def _may_have_been_tested(robot: State) -> bool:
    """Return whether the filter may have tested the robot, so that b_hat need not be the initial one.

    It may have done so if there are enough estimates for a test, and if a batch has ended, as at every run of
    the filter.
    """
    filled_slots = robot.robust.filled_slots.bit_count()  # a mask with one bit per slot
    has_ended_batch = robot.robust.batch_t > 0
    return filled_slots >= TESTED_ESTIMATES_MIN and has_ended_batch


def _replace_observations(robot: State, n: int) -> None:
    """Make ``n`` of the robot's observations black, all in earlier batches.

    The batch that its next run of the filter ends is empty, and does not change the dispersion.
    """
    robot.n = n
    robot.robust.batch_t, robot.robust.batch_n = robot.t, n


def _fill_slots(robot: State, estimates: tuple[int, ...], rng: Random) -> None:
    """Put these estimates into slots of the robot drawn at random, and empty all other slots.

    The turn to vote becomes one that is possible with these slots.
    """
    slots = rng.sample(range(SLOTS), len(estimates))
    robot.estimates = [0] * SLOTS
    robot.robust.filled_slots = 0
    for slot, estimate in zip(slots, estimates, strict=True):
        robot.estimates[slot] = estimate
        robot.robust.filled_slots |= 1 << slot
    robot.robust.turn = 0
    if robot.robust.votes > 0:
        # A turn that is not 0 is the slot after a filled slot.
        robot.robust.turn = rng.choice([0, slots[0] + 1])


def _memory_numbers(robot: State) -> dict[str, int]:
    """Return what a robot's robust filter remembers, as the numbers of an image by name."""
    numbers = {f"robust_{name}": value for name, value in asdict(robot.robust).items()}
    for slot, estimate in enumerate(robot.estimates):
        numbers[f"estimates_{slot}"] = estimate
    return numbers


def _limits_by_name(robot: State) -> dict[str, tuple[int, ...]]:
    """Return the limits of each value that a robot's robust filter remembers, by its name in an image.

    Values that are legal only in connection with others have the limits that these allow. Among the limits
    there may be the present value.
    """
    robust = robot.robust
    slots_without_first = robust.filled_slots & (robust.filled_slots - 1)  # the lowest bit is cleared
    # When the batch began there were no more observations of either colour than now.
    white_count = robot.t - robot.n
    largest_batch_t = robust.batch_n + white_count
    smallest_batch_n = max(robust.batch_t - white_count, 0)
    return {
        "robust_centre": (0, CENTRE_MAX, CENTRE_START),
        "robust_spread": (SPREAD_MIN, SPREAD_MAX),
        "robust_initial_b_hat": (B_HAT_MIN, B_HAT_MAX, robust.initial_b_hat),
        "robust_filled_slots": (robust.filled_slots, slots_without_first),
        "robust_batch_t": (0, robust.batch_n, largest_batch_t),
        "robust_batch_n": (0, robot.n, robust.batch_t, smallest_batch_n),
        "robust_votes": (0, VOTES_MAX),
        "robust_dispersion": (DISPERSION_MIN, DISPERSION_MAX),
        "robust_turn": (0, SLOTS, robust.turn),
    }


def _largest_usual_deviation(robot: State, batch_count: int) -> int:
    """Return the largest deviation of a batch's number of black observations from the expected number.

    With a larger deviation the batch is an outlier. ``batch_count`` of the robot's observations are in it.
    """
    # A batch is an outlier if the square of its deviation is more than 12 times the dispersion times the
    # variance, which is count * n / t * (1 - n / t).
    t, n = robot.t, robot.n
    variance_times_t_squared = batch_count * n * (t - n)
    limit_in_units = REJECTED_SIGMAS_SQUARED * robot.robust.dispersion * variance_times_t_squared // (t * t)
    square_limit = limit_in_units >> 8  # from the units of the dispersion, 2**-8
    return isqrt(square_limit)


def _black_share_of_tie(robot: State, estimate: int, all_estimates: tuple[int, ...]) -> int:
    """Return the observed share of black with which an estimate is in a tie, in units of 2**-32.

    An estimate supports the robot if the share that it predicts by the initial b_hat is nearer to the
    observed one than to the share that the centre of all estimates predicts. In a tie it is exactly as far
    from both. The result may be out of 0 .. 1. Estimates are in units of 2**-16.
    """
    b_hat = robot.robust.initial_b_hat
    centre, _spread = centre_and_spread(all_estimates)  # in units of 2**-24
    prediction = probability_of_black(b_hat, q32_from_q24(q24_from_q16(estimate)))
    prediction_of_centre = probability_of_black(b_hat, q32_from_q24(centre))
    return 2 * prediction - prediction_of_centre
