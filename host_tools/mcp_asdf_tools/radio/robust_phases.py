"""Phases that put the robust filter to the test: its slots, its votes, and its test of the initial b_hat.

The filter keeps the latest estimate of each sender in one of 32 slots: the sender's id modulo 32. At the end
of each round one of these estimates votes, in turn. After the last of them the robot's own estimate votes.
Votes move their centre x, which telemetry shows: so each round shows one vote.

Every filter period, if five or more slots are filled, the robot tests whether its observations contradict the
estimates in them. If they do, the test rejects the initial b_hat, and the robot re-estimates b_hat, unless
more than two fifths of the estimates support it. If they do not, b_hat goes back to the initial one. A larger
dispersion, which is how much more the robot's observations vary than independent ones, makes the test more
careful.

What is sent depends on the model's state: one unit of the estimate in one slot decides a test. Estimates in
slots are in units of 2**-16, and x_hat in messages is in units of 2**-23.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from functools import partial

from mcp_asdf.fixed_point import ALPHA_MAX, HALF, ONE
from mcp_asdf.robot import Observation
from mcp_asdf.robust_filter import (
    REJECTED_SIGMAS_SQUARED,
    SLOT_ESTIMATE_MAX,
    SLOTS,
    VOTES_MAX,
    q23_from_q16,
)
from mcp_asdf_tools.crosscheck.crafted_rounds import ALPHA_LEAST, NeighbourEstimate, draw_normal_alpha
from mcp_asdf_tools.crosscheck.crafted_slots import (
    SLOT_HALF,
    SLOT_INFORMATIVE_DISTANCE,
    SlotsAtTest,
    draw_slots_at_threshold,
    estimate_that_predicts,
    filter_at_test,
    opposite_end,
    slots_with_supporters,
)
from mcp_asdf_tools.radio.bench import BURST, Bench
from mcp_asdf_tools.radio.filter_phases import observe_until_excess_of_black, required_updates

_FIRST_SLOTS = (15, 0, 31, 16, 7, 8, 23, 24, 1, 30, 12, 19)
"""Slots that are filled before the others: the first of them are at the ends of bytes and words."""
_FILLING_ORDER = (*_FIRST_SLOTS, *(slot for slot in range(SLOTS) if slot not in _FIRST_SLOTS))
"""All slots in the order in which estimates are sent to them."""

_X_HAT_PER_SLOT_UNIT = q23_from_q16(1)
"""Units of x_hat, 2**-23, in one unit of a slot's estimate, 2**-16."""

NARROW_WIDTH, WIDE_WIDTH = 4, 1 << 13
"""How far estimates are from their middle: so little that their spread is the smallest one, or much."""
_FILL_RATIO_BEFORE_TEST = 0.75
"""Fill ratio that the observations indicate before a test, with room for estimates on either side of it."""
_MIN_INFORMATION = 0.05
"""|2 b_hat - 1| of the initial b_hat below which estimates move the threshold too little to be shown."""

_MAX_DRAWS_BY_WIDTH = {NARROW_WIDTH: 20, WIDE_WIDTH: 400}
"""Number of draws of estimates at a test's threshold, of which one is chosen.

Close to their middle, all estimates have the same spread, so that further draws come no nearer to it."""
_MAX_BURSTS = 500
"""Number of bursts of observations after which a test that has not come about is given up."""
_OBSERVATIONS_TO_KNOW_SHARE = 64
"""Number of observations up to which their share of black ones is not yet taken as brought about."""
_MAX_OBSERVATIONS_FOR_SHARE = 4096
"""Number of observations after which a share of black ones that has not come about is given up."""
_MAX_PAIRS_OF_COLOURS = 4096
"""Number of pairs, of a black and a white observation, after which a rejection is no longer waited for."""
_BEYOND_SMALLEST_SPREAD = 40
"""Distance in units of 2**-16 that is above the smallest spread of votes, 2**-12, which is 16 units."""
_ROUNDS_TO_SMALLEST_SPREAD = 2500
"""Rounds of votes that agree after which the spread would be below its lower limit, if it had none."""


# --- Phases: votes ---


def receive_first_estimates(bench: Bench) -> None:
    """Send the controller its first estimates, and play its first votes and tests.

    A vote is an estimate that moves the robot's answer x, in a round of its own. A test asks whether the
    robot's observations contradict the estimates that it keeps. There are tests with four estimates, which
    are too few for the filter, and with five. Tests at the threshold follow unless the initial b_hat is so
    close to 1/2 that estimates cannot decide them. Last come tests in which some of the estimates support the
    robot, if a run has enough observations for these.
    """
    bench.activity = "observations, of which the initial b_hat explains the share"
    _observe_as_at_three_quarters(bench)
    _play_first_votes(bench)
    for count in (4, 5):
        bench.activity = f"a test with {count} estimates, all of which contradict the observations"
        _set_slots(bench, [_most_contradicting_estimate(bench)] * count)
        _play_test_round(bench)
        bench.play_tick(bench.draw_observation())
    if not _can_estimates_decide_test(bench):
        return
    for count in (5, 6):  # the smallest odd and the smallest even number of estimates that are tested
        _play_tests_on_both_sides_of_threshold(bench, count, WIDE_WIDTH)
        _play_tests_on_both_sides_of_threshold(bench, count, NARROW_WIDTH)
    if _can_contradict_extreme_estimate(bench):
        # Two of five and four of ten do not protect a robot, three of seven and five of twelve do.
        for count, supporter_count in ((5, 2), (7, 3), (10, 4), (12, 5)):
            _play_test_with_supporters(bench, count, supporter_count)


def _play_first_votes(bench: Bench) -> None:
    """Send the controller its first estimate, one of another robot that replaces it, and then a few more.

    The controller keeps the latest estimate of each id modulo 32. After each of these steps some rounds pass
    without messages. In each round one of the kept estimates, or its own, votes: this moves the controller's
    answer x, which the bench compares with the model's.
    """
    bench.activity = "confidences of 0 before the first estimate"
    estimates_without_confidence = [NeighbourEstimate(x_hat, alpha=0) for x_hat in (ONE, ONE, 0)]
    bench.play_round(*estimates_without_confidence)

    first_slot = _FILLING_ORDER[0]
    first_sender, sender_of_same_slot, *_ = _ids_of_slot(bench, first_slot)
    bench.activity = "the first vote, as far from the centre as the spread"
    # Before the first vote the centre is 1/2 and the spread is 1/4.
    centre, spread = HALF, HALF // 2
    bench.play_round(NeighbourEstimate(centre + spread, ALPHA_MAX), senders=[first_sender])
    _let_rounds_vote(bench, 3)  # by turns, its own estimate and the one that it keeps
    bench.activity = "a sender whose id is equal modulo 32"
    bench.play_round(NeighbourEstimate(0, ALPHA_LEAST), senders=[sender_of_same_slot])
    _let_rounds_vote(bench, 3)
    bench.activity = "estimates of the extremes, and votes by turns"
    _set_slots(bench, [0, SLOT_ESTIMATE_MAX, SLOT_ESTIMATE_MAX, 0])
    _let_rounds_vote(bench, 12)  # twice the four estimates and its own, and two of them again


def vote_with_every_slot(bench: Bench) -> None:
    """Let the controller keep as many estimates as it can, and pass rounds in which each of them is a vote.

    These are 32 estimates, one in each slot. A vote moves the controller's answer x, and after all 32 its own
    estimate votes. Then the estimate of every fifth slot is replaced, one after the other, and at the end all
    are replaced by estimates that show how a slot rounds.
    """
    bench.activity = "estimates of the extremes in all slots"
    _set_slots(bench, [0, SLOT_ESTIMATE_MAX] * (SLOTS // 2))
    rounds_of_all_votes = SLOTS + 1  # one for each slot, and one for its own estimate
    _let_rounds_vote(bench, rounds_of_all_votes + 2)  # and the first two slots again
    for slot in range(0, SLOTS, 5):
        bench.activity = f"a new estimate in slot {slot}"
        sender = _draw_sender(bench, slot)  # one of the ids whose estimates this slot keeps
        estimate = NeighbourEstimate(HALF + slot, draw_normal_alpha(bench.rng))
        bench.play_round(estimate, senders=[sender])
        _let_rounds_vote(bench, 2)  # the turn goes on from where it was
    _play_estimates_between_slot_units(bench)
    _let_rounds_vote(bench, rounds_of_all_votes)


def _play_estimates_between_slot_units(bench: Bench) -> None:
    """Play a round of estimates for all slots that lie about halfway between two units of a slot.

    In slots of odd numbers the controller must round them up, and in the others down.
    """
    bench.activity = "estimates that are halfway between two units of a slot"
    half_unit = _X_HAT_PER_SLOT_UNIT // 2
    estimates = []
    for slot in range(SLOTS):
        is_rounded_up = slot % 2 == 1
        # Half a unit is rounded up, and the next smaller fraction down.
        fraction = half_unit if is_rounded_up else half_unit - 1
        whole_units = HALF + slot * _X_HAT_PER_SLOT_UNIT  # units of 2**-23, as x_hat
        estimates.append(NeighbourEstimate(whole_units + fraction, draw_normal_alpha(bench.rng)))
    senders = [_draw_sender(bench, slot) for slot in range(SLOTS)]
    bench.play_round(*estimates, senders=senders)


def vote_without_own_confidence(bench: Bench) -> None:
    """Bring b_hat to exactly 1/2, with which the robot's own estimate has no confidence, and let rounds vote.

    In these rounds its own estimate must not vote, but only those in the slots. b_hat becomes 1/2 by a
    re-estimate when half of the observations are black. Nothing is played if a run is too short for that. If
    it does not come about, this is noted as not exercised, and no rounds vote.
    """
    if not _can_contradict_extreme_estimate(bench):
        return
    bench.activity = "observations, half of them black"
    observe_until_excess_of_black(bench, 0)
    contradicting_estimate = _most_contradicting_estimate(bench)
    if not _observe_equal_colours_until_rejection(bench, contradicting_estimate):
        bench.not_exercised.append("a re-estimate of b_hat as 1/2")
        return
    bench.activity = "a re-estimate of b_hat as 1/2"
    bench.skip_to_test_round()
    _set_slots(bench, [contradicting_estimate] * SLOTS)
    bench.play_tick(Observation.BLACK)  # An observation forms x_hat and alpha from the new b_hat.
    bench.activity = "votes of a robot without confidence"
    _set_slots(bench, [0, SLOT_ESTIMATE_MAX] * (SLOTS // 2))
    _let_rounds_vote(bench, 2 * SLOTS)  # each slot twice


def vote_until_spread_is_smallest(bench: Bench) -> None:
    """Let all votes agree until their spread is at its lower limit, and then let them disagree.

    A vote is an estimate that moves the controller's answer x at the end of a round. The spread limits by how
    much: with the smallest one, votes that disagree still move it.
    """
    bench.activity = "votes that agree"
    x_hat_in_slot_units = bench.model_state.x_hat // _X_HAT_PER_SLOT_UNIT
    own_estimate = min(x_hat_in_slot_units, SLOT_ESTIMATE_MAX)  # an x_hat of 1 is more than a slot can hold
    _set_slots(bench, [own_estimate] * SLOTS)
    _let_rounds_vote(bench, _ROUNDS_TO_SMALLEST_SPREAD)
    bench.activity = "votes on both sides of a centre with the least spread"
    below = max(own_estimate - _BEYOND_SMALLEST_SPREAD, 0)
    above = min(own_estimate + _BEYOND_SMALLEST_SPREAD, SLOT_ESTIMATE_MAX)
    _set_slots(bench, [below, above] * (SLOTS // 2))
    _let_rounds_vote(bench, SLOTS)


def vote_often(bench: Bench) -> None:
    """Let rounds vote twice as often as the filter counts votes, with estimates of 0 and of almost 1.

    The more votes are counted, the less each moves the answer. So a controller that counts further shows.
    """
    bench.activity = "many votes"
    _set_slots(bench, [0, 0, SLOT_ESTIMATE_MAX, SLOT_ESTIMATE_MAX] * (SLOTS // 4))
    _let_rounds_vote(bench, 2 * VOTES_MAX + SLOTS)


# --- Phases: tests ---


def threshold_phase(width: int) -> Callable[[Bench], None]:
    """Return a phase that plays the robust filter's test on both sides of its threshold.

    After observations as on a floor of which 3/4 are black, it plays a test that just rejects and a test that
    just does not, and then both kinds once more. All slots are filled with estimates that differ by up to
    ``width`` from their middle, in units of 2**-16. The phase plays nothing if the initial b_hat is so close
    to 1/2 that estimates cannot decide the test.
    """

    def play(bench: Bench) -> None:
        """Play two pairs of tests, if estimates can decide them."""
        if not _can_estimates_decide_test(bench):
            return
        _observe_as_at_three_quarters(bench)
        _play_tests_on_both_sides_of_threshold(bench, count=SLOTS, width=width)
        # Again with other estimates: a controller whose arithmetic is wrong errs about some at the threshold,
        # and not about all.
        _play_tests_on_both_sides_of_threshold(bench, count=SLOTS, width=width)

    return play


def test_estimates_far_apart(bench: Bench) -> None:
    """Play a test against estimates whose median distance from their median is above the largest spread.

    Half of them are 0 and the others 3/4, so that their centre and the distance are 3/8. The observations are
    such that the test rejects with the largest spread, 1/4, and would not with that distance. If the initial
    b_hat is far from 1/2 there are no such observations, and with a short memory too few. If it is next to
    1/2, estimates cannot decide the test. In these three cases no test is played.
    """
    if not _can_estimates_decide_test(bench):
        return
    # Many observations are rejected if their share of black deviates from the prediction by more than
    # sqrt(12) g spread, with g the information: 0.87 g with a spread of 1/4, 1.3 g with one of 3/8. So they
    # are to deviate by 1.1 g.
    deviation = 1.1 * _initial_information(bench)
    black_share_of_centre = _predict_black_share(bench, fill_ratio=3 / 8)
    black_share = black_share_of_centre + deviation
    if black_share >= 1:
        return
    three_quarters = 3 * SLOT_HALF // 2  # in units of 2**-16
    estimates = [0, three_quarters] * (SLOTS // 2)
    would_be_rejected = partial(_would_reject, bench, estimates)
    bench.activity = "observations that estimates far apart contradict"
    can_test = _observe_until_black_share(bench, black_share, would_be_rejected)
    if can_test:
        bench.activity = "a test with estimates that are far apart"
        _play_test_with_estimates(bench, estimates)


def test_dependent_observations(bench: Bench) -> None:
    """Play tests at their threshold after batches of observations that raise and lower the dispersion.

    A batch is what the robot observes from one test to the next. The dispersion says how much more the
    observations vary than independent ones. If the initial b_hat is so close to 1/2 that estimates cannot
    decide a test, each batch is followed by a test with the estimates that the slots have.
    """
    batches: dict[str, list[Observation]] = {
        "as many of one colour in a row as of the other": [Observation.BLACK] * 48 + [Observation.WHITE] * 48,
        "few observations of one colour": [Observation.BLACK] * 7,
        "many observations of one colour": [Observation.WHITE] * 300,
        "no observations": [],
        "colours by turns": [Observation.BLACK, Observation.WHITE] * 100,
    }
    for name, observations in batches.items():
        bench.activity = f"a batch of observations: {name}"
        _observe_in_order(bench, observations)
        if _can_estimates_decide_test(bench):
            _play_tests_on_both_sides_of_threshold(bench, count=SLOTS, width=NARROW_WIDTH)
        else:
            _play_test_round(bench)


def re_estimate_near_half(bench: Bench) -> None:
    """Play tests that reject, with estimates just far enough from 1/2 for a re-estimate and just too close.

    They are above 1/2 in the first two tests, below it in the next two, and exactly 1/2 in the last; with 1/2
    or too close to it the robot keeps its b_hat. In each test all slots have the same estimate. If no
    observations make a test reject, this is noted as not exercised, and the tests after it are left out.
    """
    # Offsets of estimates from 1/2, in units of 2**-16
    nearest_above = SLOT_INFORMATIVE_DISTANCE
    too_close_above = nearest_above - 1
    # Below 1/2 the firmware computes with 1 - x, which becomes one unit of 2**-32 too small. So an estimate
    # at the exact limit is too close to 1/2 there, and the nearest far enough is one unit of a slot below.
    too_close_below = -SLOT_INFORMATIVE_DISTANCE
    nearest_below = too_close_below - 1
    for offset in (nearest_above, too_close_above, too_close_below, nearest_below, 0):
        bench.activity = f"observations that contradict estimates {offset:+} units from 1/2"
        estimate = SLOT_HALF + offset
        if not _observe_until_rejection(bench, estimate):
            bench.not_exercised.append(bench.activity)
            return
        bench.activity = f"a test with estimates {offset:+} units from 1/2"
        _play_test_with_estimates(bench, [estimate] * SLOTS)


def re_estimate_often(bench: Bench) -> None:
    """Let tests reject so often that the controller's counter of updates overflows if it has too few bits.

    After every test that rejects, b_hat is re-estimated, which counts as an update. If no observations make a
    test reject, this is noted as not exercised, and nothing is re-estimated.
    """
    bench.activity = "observations until the test rejects"
    if not _observe_until_rejection(bench):
        bench.not_exercised.append(bench.activity)
        return
    # From here on there are no observations, so that all tests reject as the first one does.
    _set_slots(bench, [_most_contradicting_estimate(bench)] * SLOTS)
    bench.activity = "one of many re-estimates"
    updates_so_far = bench.model_state.updates
    missing_updates = required_updates(bench.setup) - updates_so_far
    # If earlier phases have made all of them, the estimates just sent are tested once all the same.
    test_count = missing_updates if missing_updates > 0 else 1
    for _ in range(test_count):
        _play_test_round(bench)


# --- Estimates for the slots ---


def _ids_of_slot(bench: Bench, slot: int) -> list[int]:
    """Return the ids, without the controller's own, whose estimates it keeps in this one of its 32 slots."""
    return [robot for robot in bench.other_ids if robot % SLOTS == slot]


def _draw_sender(bench: Bench, slot: int) -> int:
    """Draw one of the ids whose estimates the controller keeps in this slot."""
    return bench.rng.choice(_ids_of_slot(bench, slot))


def _set_slots(bench: Bench, estimates: Sequence[int]) -> None:
    """Play a round of messages after which the controller keeps these estimates, in units of 2**-16.

    Each estimate comes in a message of its own. The controller keeps it in the slot of the sender's id, and
    the ids are chosen to fill the first slots of ``_FILLING_ORDER``. The other slots keep what they have.
    """
    messages = []
    for estimate in estimates:
        x_hat = _draw_x_hat(bench, estimate)
        messages.append(NeighbourEstimate(x_hat, draw_normal_alpha(bench.rng)))
    slots = _FILLING_ORDER[: len(estimates)]
    senders = [_draw_sender(bench, slot) for slot in slots]
    bench.play_round(*messages, senders=senders)


def _draw_x_hat(bench: Bench, estimate: int) -> int:
    """Draw an x_hat, in units of 2**-23, that a controller rounds to ``estimate`` when it keeps it.

    It keeps estimates in units of 2**-16, which are 128 times as large, and rounds to nearest, halves up. So
    128 x_hat become the same estimate.
    """
    exact_x_hat = estimate * _X_HAT_PER_SLOT_UNIT
    half_unit = _X_HAT_PER_SLOT_UNIT // 2
    smallest_x_hat = max(exact_x_hat - half_unit, 0)
    largest_x_hat = exact_x_hat + half_unit - 1  # one more, which is a half, would be rounded up
    if estimate == SLOT_ESTIMATE_MAX:
        # There is no larger estimate, also not for 1.0, so all x_hat above it become this one.
        largest_x_hat = ONE
    return bench.rng.randint(smallest_x_hat, largest_x_hat)


# --- Rounds ---


def _let_rounds_vote(bench: Bench, rounds: int) -> None:
    """Let so many whole rounds pass without messages: in each a kept estimate or the robot's votes."""
    bench.skip_to_round()
    bench.skip_ticks(rounds * bench.setup.comms_period)


def _play_test_round(bench: Bench) -> None:
    """Let ticks pass until the round of the next test, and play that round without messages."""
    bench.skip_to_test_round()
    bench.play_round()


def _play_test_with_estimates(bench: Bench, estimates: Sequence[int]) -> None:
    """Send these estimates in the round of the next test, and observe once after it.

    No other observation comes before the test. The one after it makes the robot form its x_hat from the b_hat
    that the test has left.
    """
    bench.skip_to_test_round()
    _set_slots(bench, estimates)
    bench.play_tick(bench.draw_observation())


# --- Observations ---


def _observe_in_order(bench: Bench, observations: Sequence[Observation]) -> None:
    """Let the controller make these observations, one a tick."""
    remaining_observations = deque(observations)
    # The bench takes the observation of each tick when it comes to it.
    bench.skip_ticks(len(observations), remaining_observations.popleft)


def _observe_as_at_three_quarters(bench: Bench) -> None:
    """Observe until the share of black is about what the initial b_hat predicts for a fill ratio of 3/4."""
    black_share = _predict_black_share(bench, _FILL_RATIO_BEFORE_TEST)
    _observe_until_black_share(bench, black_share)


def _observe_until_black_share(
    bench: Bench, black_share: float, is_enough: Callable[[], bool] = lambda: True
) -> bool:
    """Observe until the share of black observations is near ``black_share`` and ``is_enough`` returns True.

    The share is near if it is off by less than 0.01, of more than 64 observations. Returns whether that has
    come about within 4096 observations.
    """
    state = bench.model_state

    def choose_colour() -> Observation:
        """Return black while the share of black is too low."""
        is_share_too_low = state.n < black_share * state.t
        return Observation(is_share_too_low)

    for _ in range(_MAX_OBSERVATIONS_FOR_SHARE // BURST):
        has_observed_enough = state.t > _OBSERVATIONS_TO_KNOW_SHARE
        is_near = has_observed_enough and abs(state.n - black_share * state.t) < 0.01 * state.t
        if is_near and is_enough():
            return True
        bench.skip_ticks(BURST, choose_colour)
    return False


def _observe_equal_colours_until_rejection(bench: Bench, estimate: int) -> bool:
    """Observe black and white by turns until a test would reject if all kept estimates were ``estimate``.

    Returns whether that has come about within 4096 observations of each colour.
    """
    for _ in range(_MAX_PAIRS_OF_COLOURS):
        if _would_reject(bench, [estimate] * SLOTS):
            return True
        bench.play_tick(Observation.BLACK)
        bench.play_tick(Observation.WHITE)
    return False


def _observe_until_rejection(bench: Bench, estimate: int | None = None) -> bool:
    """Observe the more frequent colour until a test would reject if all kept estimates were ``estimate``.

    By default, that is the estimate that contradicts the observations most. Returns whether that has come
    about within 8000 observations.
    """
    for _ in range(_MAX_BURSTS):
        tested_estimate = _most_contradicting_estimate(bench) if estimate is None else estimate
        if _would_reject(bench, [tested_estimate] * SLOTS):
            return True
        _observe_in_order(bench, [_more_frequent_colour(bench)] * BURST)
    return False


def _observe_until_slots_can_be_crafted(
    bench: Bench, craft_slots: Callable[[], SlotsAtTest | None]
) -> SlotsAtTest | None:
    """Observe until ``craft_slots`` returns estimates for the next test, and return these.

    All observations of a burst have one colour. It is the more frequent colour while no estimate contradicts
    the observations enough for the test to reject. Once some estimate does, it is the other colour, so that
    the contradiction does not become too large. If there are no estimates for the test after 500 bursts of 16
    observations, the result is None, and ``activity`` of the bench is noted as not exercised.
    """
    for _ in range(_MAX_BURSTS):
        slots = craft_slots()
        if slots is not None:
            return slots
        colour = _more_frequent_colour(bench)
        can_test_reject = _would_reject(bench, [_most_contradicting_estimate(bench)] * SLOTS)
        if can_test_reject:
            colour = Observation.WHITE if colour is Observation.BLACK else Observation.BLACK
        _observe_in_order(bench, [colour] * BURST)
    bench.not_exercised.append(bench.activity)
    return None


def _more_frequent_colour(bench: Bench) -> Observation:
    """Return the colour that the robot has observed more often, and white if both are equally frequent."""
    black_count = bench.model_state.n
    white_count = bench.model_state.t - black_count
    return Observation.BLACK if black_count > white_count else Observation.WHITE


# --- What decides a test ---


def _initial_b_hat(bench: Bench) -> float:
    """Return the accuracy, from 0 to 1, that the robot assumed of its sensor at its start."""
    return bench.model_state.robust.initial_b_hat / 2**32  # from units of 2**-32


def _initial_information(bench: Bench) -> float:
    """Return g = |2 b_hat - 1| of the initial b_hat: 0 if it says nothing about a tile, 1 if it says all."""
    return abs(2 * _initial_b_hat(bench) - 1)


def _can_estimates_decide_test(bench: Bench) -> bool:
    """Return whether the initial b_hat is so far from 1/2 that estimates can decide the robot's test.

    Near 1/2, it predicts nearly the same share of black observations from all estimates.
    """
    return _initial_information(bench) >= _MIN_INFORMATION


def _can_contradict_extreme_estimate(bench: Bench) -> bool:
    """Return whether a run has enough observations for a test that rejects with estimates of 0 or 1.

    The share of black is taken to be one that the initial b_hat predicts from some fill ratio. Then the test
    needs 12 / g**2 observations, with g = |2 b_hat - 1|, and more if they depend on each other.
    """
    information = _initial_information(bench)
    # A full memory is halved, so that a test is sure to have only half of it.
    possible_observations = min(bench.config.memory // 2, _MAX_BURSTS * BURST)
    # Twice as many as independent observations would take. Not divided by g**2, which may be 0.
    return possible_observations * information**2 >= 2 * REJECTED_SIGMAS_SQUARED


def _predict_black_share(bench: Bench, fill_ratio: float) -> float:
    """Return the share of black observations that the initial b_hat predicts for a fill ratio (eq. 1)."""
    b_hat = _initial_b_hat(bench)
    black_seen_as_black = b_hat * fill_ratio
    white_seen_as_black = (1 - b_hat) * (1 - fill_ratio)
    return black_seen_as_black + white_seen_as_black


def _most_contradicting_estimate(bench: Bench) -> int:
    """Return the estimate, 0 or the largest of a slot, that contradicts the robot's observations most."""
    state = bench.model_state
    observed_black_share = state.n / state.t
    agreeing_estimate = estimate_that_predicts(state.robust, observed_black_share)
    return opposite_end(agreeing_estimate)


def _would_reject(bench: Bench, estimates: Sequence[int]) -> bool:
    """Return whether a test before the next observation would reject with these estimates in the slots."""
    state = bench.model_state
    slots = SlotsAtTest(tuple(estimates), filter_at_test(state), state.t, state.n)
    return slots.is_rejected


# --- Tests that are decided by a hair, or by supporters ---


def _play_tests_on_both_sides_of_threshold(bench: Bench, count: int, width: int) -> None:
    """Play a test that just rejects with ``count`` estimates, and then one that just does not.

    The estimates differ by up to ``width`` from their middle, in units of 2**-16. The second test is left out
    if the first cannot be brought about.
    """
    has_rejected = _play_test_at_threshold(bench, count, width, is_rejection=True)
    if has_rejected:
        _play_test_at_threshold(bench, count, width, is_rejection=False)


def _play_test_at_threshold(bench: Bench, count: int, width: int, is_rejection: bool) -> bool:
    """Observe until a test with ``count`` estimates can be brought to its threshold, and play that test.

    It just rejects if ``is_rejection``, and otherwise just does not. The estimates differ by up to ``width``
    from their middle. Returns whether the test was played: if no observations bring it about, this is noted
    as not exercised, and the result is False.
    """
    bench.activity = f"observations before a test of {count} estimates"
    craft_slots = partial(_choose_slots_at_threshold, bench, count, width, is_rejection)
    slots = _observe_until_slots_can_be_crafted(bench, craft_slots)
    if slots is None:
        return False
    bench.activity = "a test that just rejects" if is_rejection else "a test that just does not reject"
    _play_test_with_estimates(bench, slots.estimates)
    return True


def _choose_slots_at_threshold(
    bench: Bench, count: int, width: int, is_rejection: bool
) -> SlotsAtTest | None:
    """Return ``count`` estimates with which the next test just rejects if ``is_rejection``, or else just not.

    They differ by up to ``width`` from their middle, in units of 2**-16. They are drawn until the last bit of
    their centre decides the test. If none of many draws is so near to the threshold, the first estimates with
    which the test just rejects, or just not, are returned, and None if there are none.
    """
    first_slots: SlotsAtTest | None = None
    for _ in range(_MAX_DRAWS_BY_WIDTH[width]):
        slots_on_both_sides = draw_slots_at_threshold(bench.model_robot, count, width, bench.rng)
        if slots_on_both_sides is None:
            continue
        accepted_slots, rejected_slots = slots_on_both_sides
        slots = rejected_slots if is_rejection else accepted_slots
        if slots.is_decided_by_last_bit:
            return slots
        if first_slots is None:
            first_slots = slots
    return first_slots


def _play_test_with_supporters(bench: Bench, count: int, supporter_count: int) -> None:
    """Play a test that rejects although ``supporter_count`` of ``count`` estimates support the robot.

    Supporters are estimates that agree with the robot's observations. If no observations bring the test
    about, this is noted as not exercised.
    """
    bench.activity = f"observations that {supporter_count} of {count} estimates support"
    craft_slots = partial(slots_with_supporters, bench.model_robot, count, supporter_count)
    slots = _observe_until_slots_can_be_crafted(bench, craft_slots)
    if slots is not None:
        bench.activity = f"a test in which {supporter_count} of {count} estimates support the robot"
        _play_test_with_estimates(bench, slots.estimates)
