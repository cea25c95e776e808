"""Random scenarios for the cross-check, built so that they meet the edges at which an implementation can err.

A scenario is a function of a seed and an index, for a robot with one of the paper's filters;
``robust_scenarios`` has those of the robust one. ``random_values`` draws most of its numbers at edges.
Besides, robots are restored with counts of years of observations; and some rounds are built so that the last
bits of a threshold decide the hypothesis test, or whether x_bar, the neighbours' mean, carries information.
"""

from __future__ import annotations

from dataclasses import asdict
from random import Random

from mcp_asdf.fixed_point import B_HAT_MAX, B_HAT_MIN, HALF, ONE
from mcp_asdf.image_format import image_size
from mcp_asdf.mirror import INFORMATIVE_G, accuracy_of, estimate
from mcp_asdf.robot import DEFAULT_MEMORY, MAX_ID, MAX_ROUND_SIZE, Filter
from mcp_asdf_tools.crosscheck.crafted_rounds import ALPHA_ONE, draw_x_hats_at_threshold
from mcp_asdf_tools.crosscheck.image_numbers import (
    COUNTER_NAMES,
    MAX_16_BITS,
    MAX_32_BITS,
    largest_number_at,
    places_of_numbers,
)
from mcp_asdf_tools.crosscheck.random_values import (
    clamp,
    draw_alpha,
    draw_at_edges,
    draw_b_hat,
    draw_n,
    draw_sums,
    draw_sums_of_closed_round,
    draw_t,
    draw_usual_alpha,
)
from mcp_asdf_tools.crosscheck.scenario import Call, Scenario, Setup, TableChoice

TABLES = (TableChoice("0.05", 30), TableChoice("0.05", 127), TableChoice("0.9", 2), TableChoice("0.25", 5))
"""The tables that scenarios use."""

_X_BAR_INFORMATIVE_DISTANCE = INFORMATIVE_G >> 10
"""Distance of x_bar from 1/2 from which on it carries information, in units of 2**-23.

It is half of the smallest informative |2 x_bar - 1|, which is in units of 2**-32: 1 bit and 9 bits."""


def random_scenario(seed: int, index: int) -> Scenario:
    """Return a scenario of a robot with one of the paper's filters, of up to a few hundred calls.

    Each pair of ``seed`` and ``index`` gives its own scenario, always the same.
    """
    rng = Random(f"{seed}/{index}")
    return ScenarioWriter(rng, draw_setup(rng)).write()


def draw_setup(rng: Random) -> Setup:
    """Draw a robot's filter, its table of thresholds and period, its memory, its id and its b_hat.

    In three of five cases the filter is the adaptive one, the only one with a table. Otherwise it is the
    filter without a test, or none.
    """
    filter_kind = rng.choice([Filter.ADAPTIVE, Filter.ADAPTIVE, Filter.ADAPTIVE, Filter.ALWAYS, Filter.OFF])
    table = rng.choice(TABLES) if filter_kind == Filter.ADAPTIVE else None
    # Most filters run in every round or nearly so, as each run can show a mistake.
    filter_period = rng.choice([1, 1, 1, 2, 3, 20, MAX_32_BITS])
    # The largest memory, which is the default, is the most frequent. The smallest ones, 64 and 68, are so
    # small that a scenario has enough observations to fill them.
    memory = rng.choice([DEFAULT_MEMORY] * 3 + [64, 68, 1000, 1 << 16, DEFAULT_MEMORY - 4])
    # Ids at the ends of a word of the senders' mask
    robot_id = rng.choice([0, 5, 31, 32, 127])
    b_hat = draw_b_hat(rng)
    return Setup(table, int(filter_kind), filter_period, memory, robot_id, b_hat)


class ScenarioWriter:
    """Writes one scenario of a robot with one of the paper's filters.

    Its methods ``_add_...`` append calls to the scenario, ``_draw_...`` return values for them.
    """

    def __init__(self, rng: Random, setup: Setup) -> None:
        """Begin a scenario of a robot with this setup, without any call."""
        self._rng = rng
        self._setup = setup
        self._places_in_image = places_of_numbers(setup.filter)
        self._b_hat = setup.b_hat
        """b_hat of the setup or of the last image restored; the robot's filter may have changed it since."""
        self._common_x_hat = rng.choice([rng.randint(0, ONE), 0, HALF, ONE])
        """An x_hat near which many neighbours are."""
        self._calls: list[Call] = []

    def write(self) -> Scenario:
        """Draw 3, 10 or 30 actions, each of which adds one call or several, and return the scenario.

        Some scenarios are of ordinary ticks alone, others mix these with restored images and crafted rounds.
        """
        actions = (
            self._add_tick,
            self._add_observation_in_any_state,
            self._add_restore_of_changed_image,
            self._add_restore_at_limits,
            self._add_test_at_threshold,
            self._add_filter_near_one_half,
        )
        # Weights of these actions, in their order
        mixture = (20, 4, 2, 2, 4, 2)
        undisturbed_ticks = (1, 0, 0, 0, 0, 0)
        ticks_and_observations = (1, 1, 0, 0, 0, 0)
        mostly_tests = (2, 2, 2, 3, 12, 2)
        weights = self._rng.choice([mixture, undisturbed_ticks, ticks_and_observations, mostly_tests])
        action_count = self._rng.choice([3, 10, 30])
        for add_calls in self._rng.choices(actions, weights, k=action_count):
            add_calls()
        return Scenario(self._setup, tuple(self._calls))

    # --- Calls ---

    def _add_call(self, name: str, *numbers: int) -> None:
        """Append a call; ``numbers`` are those of ``Call``."""
        self._calls.append(Call(name, numbers))

    def _add_restore(self, new_numbers: dict[str, int]) -> None:
        """Append a call that saves the robot, replaces numbers of its image, and restores it from that.

        ``new_numbers`` are the numbers by their names in the image. The firmware must refuse some images.
        """
        self._calls.append(Call("restore", new_numbers=tuple(new_numbers.items())))

    def _add_receive(self) -> None:
        """Append a message of any sender, x_hat and alpha; some are illegal."""
        self._add_call("receive", self._draw_sender(), self._draw_x_hat(), draw_alpha(self._rng))

    def _add_tick(self) -> None:
        """Append up to ten messages, and then the calls of a tick: observations and the end of the round.

        A caller may observe and end rounds by timers of its own. So there may be an observation and the end
        of the round, only one of these, or two observations and the end.
        """
        rng = self._rng
        for _ in range(rng.choice([0, 0, 1, 2, 3, 10])):
            self._add_receive()
        # settle ends a round, and step is an observation followed by that.
        orders = (["step"], ["observe", "settle"], ["observe"], ["settle"], ["observe", "observe", "settle"])
        for call_name in rng.choice(orders):
            if call_name == "settle":
                self._add_call(call_name)
            else:
                self._add_call(call_name, self._draw_observation())

    def _add_observation_in_any_state(self) -> None:
        """Restore the robot from an image with any t and n, and let it observe one tile.

        n of its t observations are black. Often n / t is a share at which x_hat, which eq. 3 limits to 0 and
        1, just reaches one of these. In half of the cases b_hat is drawn anew, too. What the filter remembers
        is drawn only if it depends on t and n. The tile is observed by ``step`` or ``observe``.
        """
        rng = self._rng
        if rng.random() < 0.5:
            self._b_hat = draw_b_hat(rng)
        t = draw_t(rng, self._setup.memory)
        n = draw_n(rng, t, self._b_hat)
        new_numbers = {"b_hat": self._b_hat, "t": t, "n": n, **self._draw_counters()}
        new_numbers |= self._draw_own_estimate(t, n)
        new_numbers |= self._draw_filter_memory(t, n)
        self._add_restore(new_numbers)
        call_name = rng.choice(["step", "observe"])
        colour = rng.randrange(2)  # white (0) or black (1)
        self._add_call(call_name, colour)

    def _draw_own_estimate(self, t: int, n: int) -> dict[str, int]:
        """Return an x_hat and alpha that a robot with these counts and ``self._b_hat`` can have.

        Usually they follow from b_hat and from n black of t observations. In three of ten cases the flag
        ``updated``, which is returned with them, is 1 and not 0: b_hat has changed since x_hat and alpha were
        computed. Then any may be legal, and they are drawn.
        """
        rng = self._rng
        if rng.random() < 0.3:
            return {"x_hat": self._draw_x_hat(), "alpha": draw_alpha(rng), "updated": 1}
        x_hat, alpha = HALF, 0  # before the first observation
        if t > 0:
            x_hat, alpha = estimate(t, n, accuracy_of(self._b_hat))
        return {"x_hat": x_hat, "alpha": alpha, "updated": 0}

    def _draw_filter_memory(self, t: int, n: int) -> dict[str, int]:
        """Return nothing, as what the paper's filters remember does not depend on the counts t and n.

        A subclass draws the numbers of an image, by name, that its filter remembers after t observations, of
        which n were black, with a b_hat of ``self._b_hat``.
        """
        return {}

    def _add_restore_of_changed_image(self) -> None:
        """Restore the robot from an image with one number that makes it just legal, or just not.

        In one of ten cases a bit of the image is flipped instead, which its checksum must show. A message
        follows. Whether it changes the robot as it must shows if an image was wrongly refused or accepted.
        """
        rng = self._rng
        if rng.random() < 0.1:
            byte_index = rng.randrange(image_size(self._setup.filter))
            flipped_bit = 1 << rng.randrange(8)
            self._add_call("damage", byte_index, flipped_bit)
        elif rng.random() < 0.7:
            self._add_restore(self._draw_number_at_limit())
        else:
            self._add_restore(self._draw_any_number())
        self._add_receive()

    def _draw_number_at_limit(self) -> dict[str, int]:
        """Draw one number of an image, by name, at a limit of its range or one unit beside it.

        The numbers are those of robots with any filter. The flag ``updated`` is drawn, too: if it is 1, x_hat
        and alpha need not follow from the new number.
        """
        rng = self._rng
        robot_id = self._setup.robot_id
        limits_by_name = {
            "b_hat": (B_HAT_MIN, B_HAT_MAX),
            # At the memory, t would have been halved.
            "t": (0, self._setup.memory - 1),
            "filter_left": (1, self._setup.filter_period),
            "updated": (0, 1, 128, 255),
            # Another id than the robot's is as legal. One unit more or less differs in its lowest bit.
            "id": (robot_id, MAX_ID, 255),
            # The robot itself cannot be among the senders of the open round.
            f"heard_{robot_id // 32}": (1 << (robot_id % 32),),
        }
        name = rng.choice(list(limits_by_name))
        value = rng.choice(limits_by_name[name]) + rng.randint(-1, 1)
        return {"updated": rng.randrange(2), name: self._clamp_to_image(name, value)}

    def _draw_any_number(self) -> dict[str, int]:
        """Draw any number of an image, by name: 0, 1, its largest value, or one with a single bit."""
        rng = self._rng
        name = rng.choice(list(self._places_in_image))
        largest_value = largest_number_at(self._places_in_image[name])
        one_bit = 1 << rng.randrange(largest_value.bit_length())
        return {name: rng.choice([0, 1, one_bit, largest_value])}

    def _clamp_to_image(self, name: str, value: int) -> int:
        """Return the value, or the nearest one that the number of this name in an image has room for."""
        return clamp(value, 0, largest_number_at(self._places_in_image[name]))

    def _add_restore_at_limits(self) -> None:
        """End a round, and restore the robot with sums of a round at their limits, or one just beyond.

        They are the sums of the last closed round, or of the open one, which then has all other robots as
        senders.
        """
        rng = self._rng
        is_closed_round = rng.random() < 0.3
        if is_closed_round:
            names = ("closed_alpha", "closed_alpha_x_low", "closed_alpha_x_high")
            numbers = dict(zip(names, draw_sums_of_closed_round(rng), strict=True))
        else:
            numbers = {f"open_{name}": value for name, value in asdict(draw_sums(rng)).items()}
        if rng.random() < 0.7:
            # One unit more is beyond a limit that the sum is at, and must be refused.
            changed_name = rng.choice(list(numbers))
            numbers[changed_name] = max(numbers[changed_name] + rng.choice([-1, 1, 1]), 0)
        if not is_closed_round:
            numbers |= self._all_other_senders()
        # The end of the round empties the open one, in which there may be a message already.
        self._add_call("settle")
        self._add_restore(numbers)

    def _all_other_senders(self) -> dict[str, int]:
        """Return numbers of an image, by name, by which all other robots were heard in the open round."""
        # Ids 0 to 127 have one bit each, in four numbers of 32 bits.
        masks = {f"heard_{index}": MAX_32_BITS for index in range(4)}
        robot_id = self._setup.robot_id
        masks[f"heard_{robot_id // 32}"] ^= 1 << (robot_id % 32)
        return masks

    def _add_test_at_threshold(self) -> None:
        """Append to the scenario a hypothesis test that the robot's x_hat just passes, or just does not.

        The robot is restored with this x_hat, receives estimates, and ends the round at whose end its filter
        tests the x_hat against them. Sometimes all of them equal it. A robot whose filter has no test gets
        other calls: messages, an observation and the end of a round.
        """
        table_choice = self._setup.table
        if table_choice is None:  # as without the adaptive filter
            self._add_tick()
            return
        q = table_choice.q  # Above it, the table has a single threshold for all numbers of estimates.
        m = draw_at_edges(self._rng, [2, 3, q, q + 1, MAX_ROUND_SIZE], 2, MAX_ROUND_SIZE)
        threshold = table_choice.build().entry(m)  # for the test against m estimates
        own_x_hat, x_hats = self._draw_x_hats_around_threshold(m, threshold)
        self._add_filter_run(own_x_hat, x_hats)

    def _draw_x_hats_around_threshold(self, m: int, threshold: int) -> tuple[int, list[int]]:
        """Draw an x_hat of the robot, and the x_hat of ``m`` neighbours by which its filter tests it.

        In three of seven cases the test just does not reject, and in three it just does. In the other case
        all x_hat are equal. ``threshold`` is k_m, the test's threshold for m estimates. All x_hat are in
        units of 2**-23.
        """
        rng = self._rng
        # Not all draws leave room for such x_hat in 0 .. 1.
        while True:
            own_x_hat = draw_at_edges(rng, [0, HALF, ONE], 0, ONE)
            # Far apart, x_hat have sums with most bits; close together, a variance of few units.
            narrowing_bits = rng.choice([0, 0, 0, rng.randrange(20)])
            distance_share = rng.random() / (1 << narrowing_bits)
            x_hats_of_rounds = draw_x_hats_at_threshold(own_x_hat, threshold, m, rng, distance_share)
            if x_hats_of_rounds is not None:
                passed_x_hats, rejected_x_hats = x_hats_of_rounds
                # Where all x_hat are equal, both sides of eq. 12 are 0, and the test must not reject.
                equal_x_hats = [own_x_hat] * m
                return own_x_hat, rng.choice([passed_x_hats, rejected_x_hats] * 3 + [equal_x_hats])

    def _add_filter_near_one_half(self) -> None:
        """Run the filter on estimates whose mean is just informative, just not informative, or almost 1/2.

        The mean, x_bar, is informative if it is so far from 1/2 that b_hat can be re-estimated from it.
        """
        rng = self._rng
        distance = rng.choice([0, _X_BAR_INFORMATIVE_DISTANCE]) + rng.randint(-1, 1)
        x_hat = HALF + rng.choice([-1, 1]) * distance
        # Among several x_hat, some are one step higher, so that x_bar lies between two steps.
        m = rng.choice([1, 2, 2, 10])
        x_hats = [x_hat + rng.randrange(2) for _ in range(m)]
        # An own x_hat at an end, far from all these, so that the test rejects
        self._add_filter_run(rng.choice([0, ONE]), x_hats)

    def _add_filter_run(self, own_x_hat: int, x_hats: list[int]) -> None:
        """Restore the robot with this x_hat, receive estimates with these x_hat, and run its filter.

        The estimates come from different robots, in random order. The robot's observations and all
        confidences are drawn.
        """
        rng = self._rng
        t = max(draw_t(rng, self._setup.memory), 1)  # without an observation the filter does not run
        self._add_call("settle")  # The end of a round empties the open one.
        self._add_restore(
            {
                "t": t,
                "n": draw_n(rng, t, self._b_hat),
                "x_hat": own_x_hat,
                "alpha": ALPHA_ONE,
                # As if b_hat had just changed: otherwise x_hat and alpha would have to follow from it.
                "updated": 1,
                "filter_left": 1,
                **self._draw_counters(),
            }
        )
        other_ids = [sender for sender in range(MAX_ID + 1) if sender != self._setup.robot_id]
        senders = rng.sample(other_ids, len(x_hats))
        for sender, x_hat in zip(senders, x_hats, strict=True):
            self._add_call("receive", sender, x_hat, draw_usual_alpha(rng))
        self._add_call("settle")  # at which the filter runs

    # --- Values ---

    def _draw_counters(self) -> dict[str, int]:
        """Draw all counters of events, by name; many are at their maximum, or about to reach it."""
        return {name: self._rng.choice([0, MAX_16_BITS - 1, MAX_16_BITS]) for name in COUNTER_NAMES}

    def _draw_observation(self) -> int:
        """Draw white (0) or black (1), in one of ten cases a number that is neither."""
        rng = self._rng
        # 256 and 2**31 are 0 in 8 bits: they show an implementation that cuts the number.
        illegal_number = rng.choice([2, 2, 3, 255, 256, 1 << 31, MAX_32_BITS])
        if rng.random() < 0.1:
            return illegal_number
        return rng.randrange(2)

    def _draw_sender(self) -> int:
        """Draw the id of a sender: one of ten, so that some repeat; any; the robot's own; 127 or above."""
        rng = self._rng
        one_of_ten = rng.randrange(10)
        any_id = rng.randrange(MAX_ID + 1)
        return rng.choice([one_of_ten, any_id, self._setup.robot_id, MAX_ID, MAX_ID + 1, 255])

    def _draw_x_hat(self) -> int:
        """Draw an x_hat in units of 2**-23, often near one x_hat of the scenario, or near 0, 1/2 or 1.

        So the filter meets neighbours that agree and others that do not. A few are too large.
        """
        rng = self._rng
        x_hat = draw_at_edges(rng, [self._common_x_hat] * 3 + [0, HALF, ONE], 0, ONE)
        too_large = rng.choice([ONE + 1, MAX_32_BITS])
        return too_large if rng.random() < 0.05 else x_hat
