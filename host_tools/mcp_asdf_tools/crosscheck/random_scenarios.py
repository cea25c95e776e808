"""Random scenarios for the cross-check, built so that they meet the edges at which an implementation can err.

A scenario is a function of a seed and an index, for a robot with one of the paper's filters;
``robust_scenarios`` has those of the robust one. ``random_values`` draws most of its numbers from pools that
are heavy with edges. Besides, robots are restored with counts of years of observations; and some rounds are
built so that the last bits of a threshold decide the hypothesis test, or whether x_bar, the neighbours' mean,
carries information.
"""

from __future__ import annotations

from dataclasses import fields
from random import Random

from mcp_asdf.fixed_point import B_HAT_MAX, B_HAT_MIN, HALF, LARGEST_ALPHA_UNITS, ONE
from mcp_asdf.mirror import INFORMATIVE_G, accuracy_of, estimate
from mcp_asdf.robot import DEFAULT_MEMORY, MAX_ID, MAX_ROUND_SIZE, Filter, Sums
from mcp_asdf_tools.crosscheck.crafted_rounds import ALPHA_ONE, NeighbourEstimate, draw_x_hats_at_threshold
from mcp_asdf_tools.crosscheck.image_words import (
    ALPHA_WORD,
    B_HAT_WORD,
    CLOSED_ROUND_WORD,
    FILTER_LEFT_WORD,
    MAX_16_BITS,
    MAX_32_BITS,
    N_WORD,
    T_WORD,
    X_HAT_WORD,
    layout_of,
    pack_closed_round,
    pack_open_round_with_all_senders,
    pack_pair,
    pack_updates_and_id,
    split_in_words,
)
from mcp_asdf_tools.crosscheck.random_values import (
    SPECIAL_ALPHAS,
    SPECIAL_X_HATS,
    clamp,
    draw_alpha,
    draw_b_hat,
    draw_extreme_sums,
    draw_n,
    draw_number_of_any_size,
    draw_t,
    draw_usual_alpha,
)
from mcp_asdf_tools.crosscheck.scenario import Call, Scenario, Setup, TableChoice

TABLES = (TableChoice("0.05", 30), TableChoice("0.05", 127), TableChoice("0.9", 2), TableChoice("0.25", 5))
"""The tables that scenarios use."""

_X_BAR_INFORMATIVE_DISTANCE = INFORMATIVE_G >> 10
"""Distance of x_bar from 1/2 from which on it carries information, in units of 2**-23.

It is half of the smallest informative |2 x_bar - 1|, which is in units of 2**-32: 1 bit and 9 bits."""
_ALPHA_UNIT = 1 << 8
"""Alpha word of the smallest confidence, with mantissa 1; times k it is the word of k units of 2**-24."""


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
        self._layout = layout_of(setup.filter)
        self._b_hat = setup.b_hat
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

    def _add_restore(self, words: dict[int, int]) -> None:
        """Append a call that saves the robot, replaces words of its image, and restores it from that.

        ``words`` are the new words by their index in the image. The firmware must refuse some images.
        """
        numbers: list[int] = []  # pairs of an index and a word, one after the other
        for index, word in words.items():
            numbers += [index, word]
        self._add_call("restore", *numbers)

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
        """Restore the robot from an image with any t, n and b_hat, and let it observe one tile.

        n of its t observations are black. Often n / t is a share at which x_hat, which eq. 3 limits to 0 and
        1, just reaches one of these.
        """
        rng, setup = self._rng, self._setup
        if rng.random() < 0.5:
            self._b_hat = draw_b_hat(rng)
        t = draw_t(rng, setup.memory)
        n = draw_n(rng, t, self._b_hat)
        updates = rng.choice([0, 0, 1, MAX_16_BITS])
        # The image must be legal: x_hat and alpha have to follow from t, n and b_hat, unless b_hat was
        # re-estimated after they were computed.
        is_b_hat_newer = rng.random() < 0.3
        if is_b_hat_newer:
            x_hat, alpha = self._draw_x_hat(), draw_alpha(rng)
        elif t > 0:
            x_hat, alpha = estimate(t, n, accuracy_of(self._b_hat))
        else:
            x_hat, alpha = HALF, 0  # before the first observation
        words = {
            B_HAT_WORD: self._b_hat,
            T_WORD: t,
            N_WORD: n,
            X_HAT_WORD: x_hat,
            ALPHA_WORD: alpha,
            self._layout.updates_and_id_word: self._pack_updates(int(is_b_hat_newer), updates=updates),
        }
        words |= self._draw_filter_words(t, n)
        self._add_restore(words)
        call_name = rng.choice(["step", "observe"])
        colour = rng.randrange(2)  # white (0) or black (1)
        self._add_call(call_name, colour)

    def _draw_filter_words(self, t: int, n: int) -> dict[int, int]:
        """Return no words, since an image with counts t and n needs no others with the paper's filters.

        The robust filter does need some, by their index; its subclass draws them. The b_hat of the image is
        ``self._b_hat``.
        """
        return {}

    def _add_restore_of_changed_image(self) -> None:
        """Restore the robot from an image with one kind of change that makes it just legal, or just not.

        In one of ten cases a bit of the image is flipped instead, which its checksum must show. A message
        follows. Whether it changes the robot as it must shows if an image was wrongly refused or accepted.
        """
        rng = self._rng
        counter = rng.choice([0, MAX_16_BITS - 1, MAX_16_BITS])
        alpha = rng.choice(SPECIAL_ALPHAS)
        changes = self._draw_changes_of_image(counter, alpha)
        if rng.random() < 0.1:
            byte_index = rng.randrange(4 * self._layout.word_count)
            flipped_bit = 1 << rng.randrange(8)
            self._add_call("damage", byte_index, flipped_bit)
        else:
            self._add_restore(rng.choice(changes))
        self._add_call("receive", self._draw_sender(), self._draw_x_hat(), rng.choice([0, alpha]))

    def _draw_changes_of_image(self, counter: int, alpha: int) -> list[dict[int, int]]:
        """Draw one change of each kind, as new words of an image by their index.

        Many make the image just legal, or just not. ``counter`` is the number to which counters are set, and
        ``alpha`` the word of the robot's confidence in the change that sets that.
        """
        rng = self._rng
        updates_word = self._layout.updates_and_id_word  # with the counter of updates, "updated" and the id
        filter_words = self._draw_filter_words_at_limits()
        filter_left = self._draw_filter_left()
        repeated_tests_updates, accepted_rejected = self._pack_counters(counter)
        any_estimate = {
            ALPHA_WORD: alpha,
            X_HAT_WORD: self._draw_x_hat(),
            # Legal only if b_hat is newer, and if alpha is written as robots write it
            updates_word: self._pack_updates(updated=rng.choice([0, 1, 1])),
        }
        itself_among_senders = self._layout.pack_sender(self._setup.robot_id)  # is impossible
        # Only 0 and 1 are legal.
        updated_flag = {updates_word: self._pack_updates(updated=rng.choice([0, 1, 2, 3, 128, 255]))}
        # Ids up to 127 are legal. One differs from the robot's in the lowest bit.
        another_robot_id = rng.choice([self._setup.robot_id ^ 1, MAX_ID, MAX_ID + 1, 255])
        another_id = {updates_word: pack_updates_and_id(another_robot_id)}
        # Three illegal ones, and one that x_hat and alpha hardly follow from
        b_hat = {B_HAT_WORD: rng.choice([0, B_HAT_MIN - 1, B_HAT_MAX + 1, draw_b_hat(rng)])}
        # Only below the memory t is legal: it would have been halved there.
        t_at_memory = {
            T_WORD: self._setup.memory - rng.randrange(2),
            updates_word: self._pack_updates(updated=1),
        }
        word_index = rng.randint(B_HAT_WORD, updates_word)
        one_bit = 1 << rng.randrange(32)
        any_word = {word_index: rng.choice([0, 1, one_bit, MAX_32_BITS])}  # from b_hat to the last counter
        return [
            {},  # An image that was not changed must be restored.
            filter_left,
            repeated_tests_updates,
            accepted_rejected,
            any_estimate,
            filter_words,
            itself_among_senders,
            updated_flag,
            another_id,
            b_hat,
            t_at_memory,
            any_word,
        ]

    def _draw_filter_words_at_limits(self) -> dict[int, int]:
        """Draw words of an image, by index, that bring two sums of the closed round about to their limits.

        These are the sum of alpha, and ``alpha_x_low``: the sum of the lower 32 bits of alpha times x_hat.
        """
        largest_beta = MAX_ROUND_SIZE * LARGEST_ALPHA_UNITS
        # At the limit, or one unit below or above it
        beta_words = split_in_words(largest_beta + self._rng.randint(-1, 1))
        # The sum alpha_x_low has 62 bits, so its upper word has 30.
        alpha_x_low_upper_word = self._rng.choice([0, (1 << 30) - 1, 1 << 30, MAX_32_BITS])
        return {
            CLOSED_ROUND_WORD: beta_words[0],
            CLOSED_ROUND_WORD + 1: beta_words[1],
            CLOSED_ROUND_WORD + 3: alpha_x_low_upper_word,
        }

    def _draw_filter_left(self) -> dict[int, int]:
        """Draw the word of the rounds until the filter runs next: from 1 to its period, or just beyond.

        Zero, and one more than the period, are not legal.
        """
        period = self._setup.filter_period
        one_beyond = (period + 1) & MAX_32_BITS
        return {FILTER_LEFT_WORD: self._rng.choice([0, 1, 1, period, one_beyond])}

    def _pack_counters(self, counter: int) -> tuple[dict[int, int], dict[int, int]]:
        """Return two changes that set counters, which may then be about to wrap.

        The first sets the counters of repeated messages, tests and updates, the second the counters of
        accepted and of rejected messages, to ``counter``. Other counters in the same words get other numbers.
        """
        other_counter = MAX_16_BITS - counter  # An implementation that exchanges the halves shows.
        repeated_tests_updates = {
            self._layout.accepted_and_repeated_word: pack_pair(other_counter, counter),
            self._layout.rejected_and_tests_word: pack_pair(0, counter),
            self._layout.updates_and_id_word: self._pack_updates(updates=counter),
        }
        accepted_rejected = {
            self._layout.accepted_and_repeated_word: pack_pair(counter, other_counter),
            self._layout.rejected_and_tests_word: pack_pair(counter, 0),
        }
        return repeated_tests_updates, accepted_rejected

    def _add_restore_at_limits(self) -> None:
        """End a round, and restore the robot with sums of a round at their limits, or one just beyond.

        They are the sums of the last closed round, or of the open one.
        """
        rng = self._rng
        sums = draw_extreme_sums(rng)
        if rng.random() < 0.7:
            # One unit more is beyond a limit that the sum is at, and must be refused.
            sum_names = [field.name for field in fields(Sums)]
            changed_name = rng.choice(sum_names)
            changed_sum = getattr(sums, changed_name) + rng.choice([-1, 1, 1])
            setattr(sums, changed_name, max(changed_sum, 0))
        # The end of the round empties the open one, in which there may be a message already.
        self._add_call("settle")
        is_closed_round = rng.random() < 0.3
        if is_closed_round:
            self._add_restore(pack_closed_round(sums))
        else:
            self._add_restore(pack_open_round_with_all_senders(sums, self._setup.robot_id))

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
        m = self._draw_round_size(table_choice.q)
        thresholds = table_choice.build()
        threshold = thresholds.entry(m)  # for the test against m estimates
        own_x_hat, passed_x_hats, rejected_x_hats = self._draw_x_hats_around_threshold(m, threshold)
        # Where all x_hat are equal, both sides of eq. 12 are 0. The test must not reject at equality, either.
        equal_x_hats = [own_x_hat] * m
        # Equal ones are drawn once in seven cases.
        x_hats = self._rng.choice([passed_x_hats, rejected_x_hats] * 3 + [equal_x_hats])
        estimates = [NeighbourEstimate(x_hat, draw_usual_alpha(self._rng)) for x_hat in x_hats]
        self._add_filter_run(own_x_hat, estimates)

    def _draw_round_size(self, q: int) -> int:
        """Draw a number of estimates, from 2 to 127, for a test whose table has a threshold for each up to q.

        Two of three are those at which an index of the table that is off by one shows: the smallest numbers,
        the last one with a threshold of its own and the first one without, and the largest.
        """
        rng = self._rng
        at_edge = rng.choice([2, 3, q, q + 1, MAX_ROUND_SIZE])
        anywhere = rng.randint(2, MAX_ROUND_SIZE)
        return min(rng.choice([at_edge, at_edge, anywhere]), MAX_ROUND_SIZE)

    def _draw_x_hats_around_threshold(self, m: int, threshold: int) -> tuple[int, list[int], list[int]]:
        """Draw an x_hat of the robot, and two lists of ``m`` neighbours' x_hat, for a test of the first.

        The test just does not reject the robot's x_hat by the first list, and just does by the second.
        ``threshold`` is k_m, the test's threshold for m estimates. All x_hat are in units of 2**-23.
        """
        rng = self._rng
        # Not all draws leave room for two such lists in 0 .. 1.
        while True:
            own_x_hat = rng.choice([0, HALF, ONE, rng.randint(0, ONE), rng.randint(0, ONE)])
            # Far apart, x_hat have sums with most bits; close together, a variance of few units.
            any_share = rng.random()
            narrowing_bits = rng.choice([0, 0, 0, rng.randrange(20)])
            gap_share = any_share / (1 << narrowing_bits)
            x_hats_of_rounds = draw_x_hats_at_threshold(own_x_hat, threshold, m, rng, gap_share)
            if x_hats_of_rounds is not None:
                passed_x_hats, rejected_x_hats = x_hats_of_rounds
                return own_x_hat, passed_x_hats, rejected_x_hats

    def _add_filter_near_one_half(self) -> None:
        """Run the filter on estimates whose mean is just informative, just not informative, or almost 1/2.

        The mean, x_bar, is informative if it is so far from 1/2 that b_hat can be re-estimated from it. The
        last one is off by a few units of 2**-32, which rounding makes 1/2 to the bit.
        """
        rng = self._rng
        if rng.random() < 0.3:
            # 255 units of confidence at 1/2, and up to 4 units one step of 2**-23 beside it
            beside_half = HALF + rng.choice([-1, 1])
            light_estimate = NeighbourEstimate(beside_half, rng.randint(0, 4) * _ALPHA_UNIT)
            estimates = [NeighbourEstimate(HALF, 255 * _ALPHA_UNIT), light_estimate]
        else:
            distance = _X_BAR_INFORMATIVE_DISTANCE + rng.randint(-1, 1)
            x_hat = HALF + rng.choice([-distance, distance])
            # Among several x_hat, some are one step higher, so that x_bar lies between two steps.
            m = rng.choice([1, 2, 2, 10])
            estimates = [NeighbourEstimate(x_hat + rng.randrange(2), draw_usual_alpha(rng)) for _ in range(m)]
        # An own x_hat at an end, far from all these, so that the test rejects
        self._add_filter_run(rng.choice([0, ONE]), estimates)

    def _add_filter_run(self, own_x_hat: int, estimates: list[NeighbourEstimate]) -> None:
        """Restore the robot with this x_hat, receive these estimates, and run its filter.

        The robot's observations are drawn, and in one of three cases its counter of tests is at its maximum.
        The estimates come from different robots, in random order.
        """
        words = self._draw_words_before_filter_run(own_x_hat)
        self._add_call("settle")  # The end of a round empties the open one.
        self._add_restore(words)
        other_ids = [sender for sender in range(MAX_ID + 1) if sender != self._setup.robot_id]
        senders = self._rng.sample(other_ids, len(estimates))
        for sender, (x_hat, alpha) in zip(senders, estimates, strict=True):
            self._add_call("receive", sender, x_hat, alpha)
        self._add_call("settle")  # at which the filter runs

    def _draw_words_before_filter_run(self, own_x_hat: int) -> dict[int, int]:
        """Draw words of an image, by index, of a robot with this x_hat whose filter runs at the next settle.

        Its observations are drawn, and in one of three cases its counter of tests is at its maximum.
        """
        rng = self._rng
        t = max(draw_t(rng, self._setup.memory), 1)  # without an observation the filter does not run
        words = {
            T_WORD: t,
            N_WORD: draw_n(rng, t, self._b_hat),
            X_HAT_WORD: own_x_hat,
            ALPHA_WORD: ALPHA_ONE,
        }
        is_counter_at_maximum = rng.choice([False, False, True])  # then the test makes it 0
        if is_counter_at_maximum:
            words |= self._counter_of_tests_before_wrap()
        # As if b_hat had just changed: otherwise x_hat and alpha would have to follow from t, n and b_hat.
        words[self._layout.updates_and_id_word] = self._pack_updates(updated=1)
        words[FILTER_LEFT_WORD] = 1  # rounds until the filter runs: at the end of this one
        return words

    # --- Values ---

    def _counter_of_tests_before_wrap(self) -> dict[int, int]:
        """Return the word, by index, in which the counter of tests is at its maximum: a test makes it 0."""
        return {self._layout.rejected_and_tests_word: pack_pair(0, MAX_16_BITS)}

    def _pack_updates(self, updated: int = 0, updates: int = 0) -> int:
        """Return the word of an image that has the updates and the robot's id, by ``pack_updates_and_id``."""
        return pack_updates_and_id(self._setup.robot_id, updated, updates)

    def _draw_observation(self) -> int:
        """Draw white (0) or black (1), in one of ten cases a number that is neither."""
        rng = self._rng
        # 256 and 2**31 are 0 in 8 bits: they show an implementation that cuts the number.
        illegal_number = rng.choice([2, 2, 3, 255, 256, 1 << 31, MAX_32_BITS])
        if rng.random() < 0.1:
            return illegal_number
        return rng.randrange(2)

    def _draw_sender(self) -> int:
        """Draw the id of a sender: one of ten, so that some repeat; any; the robot's own; or beyond 127."""
        rng = self._rng
        one_of_ten = rng.randrange(10)
        any_id = rng.randrange(MAX_ID + 1)
        return rng.choice([one_of_ten, any_id, self._setup.robot_id, MAX_ID, MAX_ID + 1, 255])

    def _draw_x_hat(self) -> int:
        """Draw an x_hat in units of 2**-23: in half of the cases near one x_hat of the scenario, else any.

        So the filter meets neighbours that agree and others that do not. Some of these others are at the ends
        of the range, or too large.
        """
        rng = self._rng
        side = rng.randint(-1, 1)
        distance = draw_number_of_any_size(rng, min_bits=1, max_bits=19)
        near = clamp(self._common_x_hat + side * distance, 0, ONE)
        anywhere = rng.choice([rng.randint(0, ONE), rng.choice(SPECIAL_X_HATS)])
        return rng.choice([near, anywhere])
