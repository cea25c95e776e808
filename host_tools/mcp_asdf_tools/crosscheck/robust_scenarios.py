"""Random scenarios of robots with the robust filter, as ``random_scenarios`` has them of the paper's filters.

Robots are restored with any memory that the filter may have: votes, slots with estimates, and a batch of
observations. Many of these lie next to a limit: a vote at the distance of the spread, a batch whose deviation
is just an outlier, estimates that decide the test by one unit, and supporters that are two in five.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from math import isqrt
from random import Random

from mcp_asdf.arithmetic import Q32_ONE, q32_quotient
from mcp_asdf.fixed_point import B_HAT_MAX, B_HAT_MIN, ONE
from mcp_asdf.mirror import MirrorRobot, reestimate
from mcp_asdf.robot import MAX_ID, Filter
from mcp_asdf.robust_filter import (
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
from mcp_asdf_tools.crosscheck.crafted_rounds import draw_normal_alpha
from mcp_asdf_tools.crosscheck.crafted_slots import (
    SLOT_HALF,
    SLOT_INFORMATIVE_DISTANCE,
    SLOT_ONE,
    centre_and_spread,
    draw_slots_at_threshold,
    slots_with_supporters,
)
from mcp_asdf_tools.crosscheck.image_words import (
    ALPHA_WORD,
    B_HAT_WORD,
    FILTER_LEFT_WORD,
    MAX_16_BITS,
    MAX_32_BITS,
    N_WORD,
    T_WORD,
    X_HAT_WORD,
    pack_pair,
)
from mcp_asdf_tools.crosscheck.random_scenarios import ScenarioWriter, draw_setup
from mcp_asdf_tools.crosscheck.random_values import (
    clamp,
    draw_b_hat,
    draw_n,
    draw_number_of_any_size,
    draw_t,
)
from mcp_asdf_tools.crosscheck.scenario import Scenario

_CENTRE_ONE = q30_from_q23(ONE)
_SLOT_UNIT = q30_from_q23(q23_from_q16(1))
"""Unit of the estimates in slots, as a number of units of the votes."""

_FIRST_FILTER_WORD, _FIRST_SLOTS_WORD = 7, 15
"""First words of an image that hold what the filter remembers, and the estimates of its slots."""

_VOTE_COUNTS = (
    # No vote, and first ones
    *(0, 1, 2),
    # The gain is constant up to 63 votes, and then halves at each power of two.
    *(*range(30, 33), *range(62, 65), 126, 127, 128, 255, 256),
    # More than 2**9 votes are not counted, and a larger number is not legal.
    *range(VOTES_MAX - 2, VOTES_MAX + 1),
)
"""Numbers of votes at the edges of the gain."""

_DISTANCES_OF_SLOW_CENTRE = (0, 3, 3, 3, 6, 7, 8, 14, 41, 41, 41, 68, 68, 164, 186, 377, 377, *([833] * 15))
"""Distances of estimates from the smallest, with which each of five steps still moves their centre.

They were found by search.
"""

_MAX_DRAWS = 10
"""Robots that are drawn to find one for which there are estimates of a kind."""


@dataclass
class DrawnRobot:
    """What the robust filter of a robot works with, as an image holds it.

    Attributes:
        t: Number of observations, from 1.
        n: Number of black ones among them.
        b_hat: Present accuracy that the robot assumes of its sensor, in units of 2**-32.
        robust: What the filter remembers.
        estimates: The estimates of all 32 slots, in units of 2**-16.
    """

    t: int
    n: int
    b_hat: int
    robust: RobustFilter
    estimates: list[int]

    @property
    def may_have_been_tested(self) -> bool:
        """Whether the filter may have tested the robot, so that b_hat need not be the initial one.

        It may have if there are enough estimates for a test, and if it has run: then a batch has ended.
        """
        filled_slots = self.robust.filled_slots.bit_count()  # a mask with a bit for each slot
        has_ended_batch = self.robust.batch_t > 0
        return filled_slots >= TESTED_ESTIMATES_MIN and has_ended_batch

    def fill_slots(self, estimates: tuple[int, ...], rng: Random) -> None:
        """Put these estimates into slots drawn at random, and empty all other slots.

        The turn to vote becomes one that is possible with these slots.
        """
        slots = rng.sample(range(SLOTS), len(estimates))
        self.estimates = [0] * SLOTS
        self.robust.filled_slots = 0
        for slot, estimate in zip(slots, estimates, strict=True):
            self.estimates[slot] = estimate
            self.robust.filled_slots |= 1 << slot
        self.robust.turn = 0
        if self.robust.votes > 0:
            # A turn that is not 0 is the slot after a filled slot.
            self.robust.turn = rng.choice([0, slots[0] + 1])


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
        """Restore a robot whose filter remembers one value at its limit or just beyond, and settle."""
        self._add_restore(self._draw_filter_words_at_limits())
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
                self._draw_skewed_estimates,
                self._draw_slowly_centred_estimates,
            ]
        )
        for _ in range(_MAX_DRAWS):
            robot = self._draw_robot()
            estimates = draw_estimates(robot, count)
            if estimates is not None:
                robot.fill_slots(estimates, rng)
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
        robot.fill_slots(estimates, rng)
        # With observations of one colour, none or all of t, the test rejects.
        robot.n = rng.choice([0, robot.t, robot.n])
        # The next batch of observations is empty, so that it does not change their dispersion.
        robot.robust.batch_t, robot.robust.batch_n = robot.t, robot.n
        self._add_filter_run_of(robot)

    def _add_filter_run_of(self, robot: DrawnRobot) -> None:
        """Append calls that restore this robot from an image, and end a round at whose end its filter runs.

        In one of five cases the robot receives a message before the round ends, whose estimate may replace
        one of those that it keeps and tests itself against. The present b_hat of ``robot`` is drawn here.
        """
        rng = self._rng
        # An earlier test may have changed b_hat. If the next one passes, the initial b_hat must come back.
        is_b_hat_changed = robot.may_have_been_tested and rng.random() < 0.5
        robot.b_hat = draw_b_hat(rng) if is_b_hat_changed else robot.robust.initial_b_hat
        words = self._draw_image_words(robot)
        words[FILTER_LEFT_WORD] = 1  # rounds until the filter runs: at the end of this one
        is_counter_at_maximum = rng.choice([False, False, True])  # then the test makes it 0
        if is_counter_at_maximum:
            words |= self._counter_of_tests_before_wrap()
        self._add_restore(words)
        if rng.random() < 0.2:
            self._add_receive()
        self._add_call("settle")  # ends the round

    # --- Images ---

    def _draw_image_words(self, robot: DrawnRobot) -> dict[int, int]:
        """Return the words of an image of this robot, whose own x_hat and alpha are drawn.

        Its b_hat becomes that of the scenario's robot from now on.
        """
        rng = self._rng
        self._b_hat = robot.b_hat
        # Without confidence (0) the robot's own estimate does not vote.
        mantissa_without_shift = rng.randrange(1 << 24) << 8
        alpha = rng.choice([0, mantissa_without_shift, draw_normal_alpha(rng)])
        return {
            B_HAT_WORD: robot.b_hat,
            T_WORD: robot.t,
            N_WORD: robot.n,
            X_HAT_WORD: self._draw_own_x_hat(robot.robust),
            ALPHA_WORD: alpha,
            # As if b_hat had just changed: otherwise x_hat and alpha would have to follow from it.
            self._layout.updates_and_id_word: self._pack_updates(updated=1),
            **_pack_robust_filter(robot.robust, robot.estimates),
        }

    def _draw_filter_words(self, t: int, n: int) -> dict[int, int]:
        """Draw the words of the robust filter's memory, by index, after t observations of which n were black.

        The present b_hat is ``self._b_hat``. The initial one differs from it at most where a test may have
        changed b_hat.
        """
        robot = self._draw_robot_after(t, n, initial_b_hat=self._b_hat)
        if robot.may_have_been_tested:
            robot.robust.initial_b_hat = self._rng.choice([self._b_hat, draw_b_hat(self._rng)])
        return _pack_robust_filter(robot.robust, robot.estimates)

    def _draw_filter_words_at_limits(self) -> dict[int, int]:
        """Draw words of an image in which one value that the filter remembers is at or next to a limit.

        The image is that of a robot that is drawn, too. It may be one that the firmware must refuse.
        """
        rng = self._rng
        robot = self._draw_robot()
        robust = robot.robust
        if robot.may_have_been_tested:
            robot.b_hat = rng.choice([robot.b_hat, draw_b_hat(rng)])
        names = [field.name for field in fields(RobustFilter)]
        name = rng.choice(names)
        limits = _limits_by_name(robot)[name]
        # One unit more or less may be beyond the limit, and must be refused then.
        value = rng.choice(limits) + rng.choice([-1, 0, 0, 1])
        max_value = MAX_16_BITS if name in ("votes", "dispersion") else MAX_32_BITS
        setattr(robust, name, clamp(value, 0, max_value))
        if rng.random() < 0.1:
            # The estimate of an empty slot must be 0.
            robot.estimates[rng.randrange(SLOTS)] = rng.choice([0, 1, SLOT_ESTIMATE_MAX])
        return self._draw_image_words(robot)

    # --- Values ---

    def _draw_robot(self) -> DrawnRobot:
        """Draw a robot with any counts, any initial b_hat, which is also the present one, and any memory."""
        rng = self._rng
        t = max(draw_t(rng, self._setup.memory), 1)
        initial_b_hat = draw_b_hat(rng)
        n = draw_n(rng, t, initial_b_hat)
        return self._draw_robot_after(t, n, initial_b_hat)

    def _draw_robot_after(self, t: int, n: int, initial_b_hat: int) -> DrawnRobot:
        """Draw a robot with these counts and this b_hat, and what its filter remembers, within its limits.

        ``n`` of its ``t`` observations were black. The initial b_hat is also the present one. Drawn are which
        slots for neighbours' estimates are filled, and with what; the number of votes so far, and where there
        are any, their centre, their spread and whose turn to vote is next; and the batch of observations.
        """
        rng = self._rng
        robust = RobustFilter(initial_b_hat=initial_b_hat)
        robust.filled_slots = self._draw_filled_slots()
        if robust.filled_slots:
            robust.votes = rng.choice(_VOTE_COUNTS)
        if robust.votes > 0:
            robust.centre = self._draw_centre()
            robust.spread = self._draw_spread()
            # The next turn is slot 0, or the slot after a filled slot, often after the last.
            filled_slots = [slot for slot in range(SLOTS) if robust.is_filled(slot)]
            turn_after_any = rng.choice(filled_slots) + 1
            turn_after_last = filled_slots[-1] + 1
            robust.turn = rng.choice([0, turn_after_any, turn_after_last])
        self._fill_in_batch(robust, t, n)
        return DrawnRobot(t, n, initial_b_hat, robust, self._draw_estimates(robust))

    def _draw_filled_slots(self) -> int:
        """Draw which slots are filled, as a mask of a bit a slot: none, one, about five, any number, all.

        Five are just enough for a test. A single one is often the first or the last slot.
        """
        rng = self._rng
        count = rng.choice([0, 1, 4, 5, 5, 6, rng.randint(0, SLOTS), SLOTS - 1, SLOTS])
        slots = rng.sample(range(SLOTS), count)
        # A shift by 32, or a search from bit 1 on, would miss a slot at an end of the mask. This is drawn in
        # any case, as golden vectors are made of this sequence of draws.
        slots_if_one = rng.choice([[0], [SLOTS - 1], slots])
        if count == 1:
            slots = slots_if_one
        return sum(1 << slot for slot in slots)

    def _fill_in_batch(self, robust: RobustFilter, t: int, n: int) -> None:
        """Draw the dispersion of a robot's observations, and the batch that its next run of the filter ends.

        ``n`` of all its ``t`` observations were black. The batch is the last observations. Its number of
        black ones is the expected, the smallest or the largest possible number, or makes the batch just an
        outlier, or just not. ``robust`` gets the dispersion, and the counts with which the batch began. A
        robot without observations stays as a new one.
        """
        rng = self._rng
        if t == 0:
            return
        robust.dispersion = self._draw_dispersion()
        count_of_any_size = min(draw_number_of_any_size(rng, 1, 31), t)
        batch_count = rng.choice([0, 1, count_of_any_size, rng.randint(0, t), t])
        batch_black_count = self._draw_black_count_of_batch(robust.dispersion, batch_count, t, n)
        robust.batch_t = t - batch_count
        robust.batch_n = n - batch_black_count
        if robust.batch_t == 0:
            # No batch has ended yet.
            robust.batch_n, robust.dispersion = 0, DISPERSION_MIN

    def _draw_black_count_of_batch(self, dispersion: int, batch_count: int, t: int, n: int) -> int:
        """Draw how many of the last ``batch_count`` of t observations were black, if n of all t were.

        It is the smallest or the largest possible number, or lies near the expected one, or so far from it
        that the batch is just an outlier, or just not. ``dispersion`` is in units of 2**-8.
        """
        rng = self._rng
        white_count = t - n
        smallest_black_count = max(batch_count - white_count, 0)
        largest_black_count = min(batch_count, n)
        expected_black_count = batch_count * n // t
        largest_deviation = _largest_usual_deviation(dispersion, batch_count, t, n)
        deviation = rng.choice([0, draw_number_of_any_size(rng, 0, 8), largest_deviation])
        direction = rng.choice([-1, 1])
        deviating_black_count = expected_black_count + direction * deviation + rng.randint(-1, 1)
        black_count = rng.choice([deviating_black_count, smallest_black_count, largest_black_count])
        return clamp(black_count, smallest_black_count, largest_black_count)

    def _draw_dispersion(self) -> int:
        """Draw a dispersion of observations, in units of 2**-8: at either limit, or of any size between."""
        rng = self._rng
        small_dispersion = DISPERSION_MIN + draw_number_of_any_size(rng, 1, 8)
        any_dispersion = clamp(draw_number_of_any_size(rng, 9, 16), DISPERSION_MIN, DISPERSION_MAX)
        large_dispersion = DISPERSION_MAX - rng.randrange(2)
        return rng.choice([DISPERSION_MIN, small_dispersion, any_dispersion, large_dispersion])

    def _draw_centre(self) -> int:
        """Draw a centre of the votes in units of 2**-30: near the x_hat of messages, anywhere, 0 or 1.

        The four choices are equally likely. Half of the centres are multiples of 2**-16, as the estimates in
        slots are, so that a vote can equal them.
        """
        rng = self._rng
        max_distance = _CENTRE_ONE >> 10
        near_messages = q30_from_q23(self._common_x_hat) + rng.randint(-max_distance, max_distance)
        anywhere = rng.randint(0, _CENTRE_ONE)
        centre = clamp(rng.choice([near_messages, anywhere, 0, _CENTRE_ONE]), 0, _CENTRE_ONE)
        multiple_of_slot_unit = centre // _SLOT_UNIT * _SLOT_UNIT
        return rng.choice([centre, multiple_of_slot_unit])

    def _draw_spread(self) -> int:
        """Draw a spread of the votes in units of 2**-30, in half of the cases next to a power of two.

        The firmware shifts the spread to change it, and rounds otherwise where it has one bit less. One of
        three draws is a multiple of 2**-16, as the estimates in slots are.
        """
        rng = self._rng
        power_of_two = 1 << rng.randrange(18, 29)  # from SPREAD_MIN to SPREAD_MAX
        any_smaller = rng.randrange(power_of_two)
        around_power = power_of_two + rng.choice([-1, 0, 1, any_smaller])
        multiple_of_slot_unit = any_smaller // _SLOT_UNIT * _SLOT_UNIT
        spread = rng.choice([around_power, around_power, multiple_of_slot_unit])
        return clamp(spread, SPREAD_MIN, SPREAD_MAX)

    def _draw_estimates(self, robust: RobustFilter) -> list[int]:
        """Draw the estimates of all slots, in units of 2**-16: 0 for an empty slot.

        About half of the filled slots share one estimate, which is next to the centre of the votes or at the
        distance of the spread from it. The others have estimates as of messages.
        """
        rng = self._rng
        position = robust.centre + rng.choice([-1, 0, 1]) * robust.spread  # in units of 2**-30
        at_spread = clamp(position // _SLOT_UNIT + rng.randint(-1, 1), 0, SLOT_ESTIMATE_MAX)
        estimates = [0] * SLOTS
        for slot in range(SLOTS):
            if robust.is_filled(slot):
                as_of_message = slot_estimate(min(self._draw_x_hat(), ONE))
                estimates[slot] = rng.choice([at_spread, as_of_message])
        return estimates

    def _draw_own_x_hat(self, robust: RobustFilter) -> int:
        """Draw an x_hat of the robot itself, in units of 2**-23.

        In half of the cases it is at the centre of the votes, or at the distance of the spread from it.
        """
        rng = self._rng
        position = robust.centre + rng.choice([-1, 0, 1]) * robust.spread  # in units of 2**-30
        at_spread = clamp(q23_from_q30(position) + rng.randint(-1, 1), 0, ONE)
        return rng.choice([at_spread, min(self._draw_x_hat(), ONE)])

    def _draw_sender(self) -> int:
        """Draw the id of a sender, in one of four cases one that shares its slot with another."""
        rng = self._rng
        # Ids that are SLOTS apart share a slot. Here they are those of the first ten slots.
        of_same_slot = rng.randrange(10) + SLOTS * rng.randrange((MAX_ID + 1) // SLOTS)
        return of_same_slot if rng.random() < 0.25 else super()._draw_sender()

    # --- Estimates for a test ---

    def _mirror_of(self, robot: DrawnRobot) -> MirrorRobot:
        """Return a mirror with what the filter's test of the drawn robot needs: t, n, and the same memory."""
        mirror = MirrorRobot(self._setup.config(), self._setup.robot_id, robot.b_hat / Q32_ONE)
        mirror.s.t, mirror.s.n, mirror.s.robust = robot.t, robot.n, robot.robust
        return mirror

    def _draw_estimates_at_threshold(self, robot: DrawnRobot, count: int) -> tuple[int, ...] | None:
        """Draw estimates by which the robot's test just rejects, or just does not; None if there are none."""
        # How far the estimates are from their middle at most, in units of 2**-16: a number of 1 to 15 bits.
        width = draw_number_of_any_size(self._rng, 1, 15)
        drawn_slots = draw_slots_at_threshold(self._mirror_of(robot), count, width, self._rng)
        if drawn_slots is None:
            return None
        accepted_slots, rejected_slots = drawn_slots
        chosen_slots = self._rng.choice([accepted_slots, rejected_slots])
        return chosen_slots.estimates

    def _draw_supporters_and_others(self, robot: DrawnRobot, count: int) -> tuple[int, ...] | None:
        """Draw estimates by which the robot's test rejects, though about two in five support the robot.

        The others agree on an estimate that contradicts its observations. There are at least 11 estimates,
        also for a smaller ``count``, so that these others are more than a half. The result is None if the
        test does not reject by such estimates.
        """
        count = max(count, 11)
        supporter_count = 2 * count // 5 + self._rng.randint(0, 1)
        slots = slots_with_supporters(self._mirror_of(robot), count, supporter_count)
        return None if slots is None else slots.estimates

    def _draw_supporters_and_tie(self, robot: DrawnRobot, count: int) -> tuple[int, ...] | None:
        """Draw estimates: two in five support the robot, and one more almost does.

        The others agree on another estimate. There are at least 12 estimates, also for a smaller ``count``,
        so that the others are more than a half. The robot gets an initial b_hat by which that one
        estimate is in a tie, which must not count as support; the result is None if there is no such b_hat.
        """
        count = max(count, 12)
        supporter_count = 2 * count // 5
        supporter, tied, other = self._rng.sample(range(SLOT_ONE), 3)
        other_count = count - supporter_count - 1
        estimates = (supporter,) * supporter_count + (tied,) + (other,) * other_count
        # An estimate supports the robot if the share of black that it predicts is nearer to the robot's than
        # to the share that the Huber centre of all estimates predicts. A b_hat is searched with which the
        # prediction of the tied one is as far from both.
        centre, _spread = centre_and_spread(estimates)  # in units of 2**-24
        b_hat = _find_b_hat_of_tie(robot, q24_from_q16(tied), centre)
        if b_hat is None:
            return None
        robot.robust.initial_b_hat = b_hat
        return estimates

    def _draw_skewed_estimates(self, robot: DrawnRobot, count: int) -> tuple[int, ...]:
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

    def _draw_slowly_centred_estimates(self, robot: DrawnRobot, count: int) -> tuple[int, ...]:
        """Draw 32 estimates whose Huber centre three steps do not reach, so that a fourth would show.

        There are 32 for any ``robot`` and ``count``.
        """
        rng = self._rng
        direction = rng.choice([-1, 1])
        scale = rng.choice([1, 2, 4, 8])
        start = rng.randint(0, SLOT_ESTIMATE_MAX)
        distances = [scale * distance for distance in _DISTANCES_OF_SLOW_CENTRE]
        return tuple(clamp(start + direction * distance, 0, SLOT_ESTIMATE_MAX) for distance in distances)


def _limits_by_name(robot: DrawnRobot) -> dict[str, tuple[int, ...]]:
    """Return the limits of each value that a robot's robust filter remembers, by the value's name.

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
        "centre": (0, _CENTRE_ONE, CENTRE_START),
        "spread": (SPREAD_MIN, SPREAD_MAX),
        "initial_b_hat": (B_HAT_MIN, B_HAT_MAX, robot.b_hat),
        "filled_slots": (robust.filled_slots, slots_without_first),
        "batch_t": (0, robust.batch_n, largest_batch_t),
        "batch_n": (0, robot.n, robust.batch_t, smallest_batch_n),
        "votes": (0, VOTES_MAX),
        "dispersion": (DISPERSION_MIN, DISPERSION_MAX),
        "turn": (0, SLOTS, robust.turn),
    }


def _pack_robust_filter(robust: RobustFilter, estimates: Sequence[int]) -> dict[int, int]:
    """Return words 7 to 30 of an image, by index, for a robot whose robust filter remembers this.

    ``estimates`` are those of all 32 slots, in units of 2**-16. Members may be out of their ranges, as far as
    their bits of the image allow: votes, dispersion and estimates have 16 bits each, the others 32.
    """
    words = [
        robust.centre,
        robust.spread,
        robust.initial_b_hat,
        robust.filled_slots,
        robust.batch_t,
        robust.batch_n,
        pack_pair(robust.votes, robust.dispersion),
        robust.turn,
    ]
    slot_words = [pack_pair(estimates[slot], estimates[slot + 1]) for slot in range(0, SLOTS, 2)]
    return dict(enumerate(words, _FIRST_FILTER_WORD)) | dict(enumerate(slot_words, _FIRST_SLOTS_WORD))


def _largest_usual_deviation(dispersion: int, batch_count: int, t: int, n: int) -> int:
    """Return the largest deviation from the expected number of black ones with which a batch is no outlier.

    ``batch_count`` observations are in the batch, and ``n`` of all ``t`` observations are black. The
    dispersion is in units of 2**-8.
    """
    # A batch is an outlier if the square of its deviation is more than 12 times the dispersion times the
    # variance, which is count * n / t * (1 - n / t).
    variance_times_t_squared = batch_count * n * (t - n)
    limit_in_units = REJECTED_SIGMAS_SQUARED * dispersion * variance_times_t_squared // (t * t)
    square_limit = limit_in_units >> 8  # from the units of the dispersion, 2**-8
    return isqrt(square_limit)


def _find_b_hat_of_tie(robot: DrawnRobot, estimate: int, centre: int) -> int | None:
    """Return an initial b_hat by which an estimate neither supports the robot nor contradicts it, or None.

    By b_hat an estimate predicts a share of black observations. The estimate supports the robot if this share
    is nearer to the observed share than to the share that the centre of all estimates predicts. Here it is
    exactly as far from both. ``estimate`` and ``centre`` are in units of 2**-24, and b_hat is in units of
    2**-32.
    """
    # Seen from the estimate, this point lies opposite to the centre, and as far away. With the b_hat sought,
    # the point predicts the observed share.
    opposite_point = 2 * estimate - centre
    if not 0 <= opposite_point < q24_from_q16(SLOT_ONE):
        return None
    b_hat_of_point = reestimate(robot.t, robot.n, q32_from_q24(opposite_point))
    if b_hat_of_point is None:
        return None
    share = q32_quotient(robot.n, robot.t)
    # The prediction is rounded, so that a b_hat a few units beside may be the one.
    first_b_hat = max(b_hat_of_point - 8, B_HAT_MIN)
    end_of_b_hats = min(b_hat_of_point + 8, B_HAT_MAX)
    for b_hat in range(first_b_hat, end_of_b_hats):
        prediction = probability_of_black(b_hat, q32_from_q24(estimate))
        prediction_of_centre = probability_of_black(b_hat, q32_from_q24(centre))
        if abs(prediction - share) == abs(prediction - prediction_of_centre):
            return b_hat
    return None
