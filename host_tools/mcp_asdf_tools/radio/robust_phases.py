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

from collections.abc import Callable, Sequence
from functools import partial
from typing import TypeVar

from mcp_asdf.fixed_point import ALPHA_MAX, HALF, ONE
from mcp_asdf.robot import Observation
from mcp_asdf.robust_filter import REJECTED_SIGMAS_SQUARED, SLOT_ESTIMATE_MAX, SLOTS, q23_from_q16
from mcp_asdf_tools.crosscheck.crafted_rounds import ALPHA_LEAST, NeighbourEstimate, draw_normal_alpha
from mcp_asdf_tools.crosscheck.crafted_slots import (
    SLOT_HALF,
    SLOT_INFORMATIVE_DISTANCE,
    SlotsAtTest,
    agreeing_estimate,
    draw_slots_at_threshold,
    opposite_end,
    slots_at_test,
    slots_with_supporters,
)
from mcp_asdf_tools.radio.bench import BURST, Bench
from mcp_asdf_tools.radio.filter_phases import observe_until_excess_of_black, required_updates
from mcp_asdf_tools.robots.robot_setup import RobotSetup

_FIRST_SLOTS = (15, 0, 31, 16, 7, 8, 23, 24, 1, 30, 12, 19)
"""Slots that are filled before the others: the first of them are at the ends of bytes and words."""
_FILLING_ORDER = (*_FIRST_SLOTS, *(slot for slot in range(SLOTS) if slot not in _FIRST_SLOTS))
"""All slots in the order in which estimates are sent to them."""
_ROUNDS_OF_ALL_VOTES = SLOTS + 1
"""Number of rounds after which every slot, and then the robot's own estimate, has had a vote."""

_X_HAT_PER_SLOT_UNIT = q23_from_q16(1)
"""Units of x_hat, 2**-23, in one unit of a slot's estimate, 2**-16."""

NARROW_WIDTH, WIDE_WIDTH = 4, 1 << 13
"""How far estimates are from their middle: so little that their spread is the smallest one, or much."""
_FILL_RATIO_BEFORE_TEST = 0.75
"""Fill ratio that the observations indicate before a test. Higher and lower estimates can contradict it."""
_MIN_INFORMATION = 0.05
"""|2 b_hat - 1| of the initial b_hat below which estimates move the threshold too little to be shown."""
_MAX_INFORMATION_FOR_LARGEST_SPREAD = 0.4
"""|2 b_hat - 1| of the initial b_hat up to which observations can be so far from estimates of 0 and 3/4 that
a test rejects."""

_MAX_DRAWS_BY_WIDTH = {NARROW_WIDTH: 20, WIDE_WIDTH: 400}
"""Number of draws of estimates at a test's threshold, of which one is chosen.

Close to their middle, all estimates have the same spread, so that further draws come no nearer to it."""
_MAX_BURSTS = 500
"""Number of bursts of observations after which a phase gives up what they were to bring about."""
_BEYOND_SMALLEST_SPREAD = 40
"""Distance in units of 2**-16 that is above the smallest spread of votes, 2**-12, which is 16 units."""
_ROUNDS_TO_SMALLEST_SPREAD = 2500
"""Rounds of votes that agree after which the spread would be below its lower limit, if it had none. The
filter counts only a fifth as many votes."""


# --- Controllers to which a phase applies ---


def _initial_information(b_hat: float) -> float:
    """Return g = |2 b_hat - 1|: 0 if an observation says nothing about a tile, 1 if it says all."""
    return abs(2 * b_hat - 1)


def can_estimates_decide_test(setup: RobotSetup) -> bool:
    """Return whether the initial b_hat is so far from 1/2 that estimates can decide the robot's test.

    Near 1/2, it predicts nearly the same share of black observations from all estimates.
    """
    return _initial_information(setup.b_hat) >= _MIN_INFORMATION


def can_contradict_extreme_estimate(setup: RobotSetup) -> bool:
    """Return whether a run has enough observations for a test that rejects with estimates of 0 or 1.

    The share of black is taken to be one that the initial b_hat predicts from some fill ratio. Then the test
    needs 12 / g**2 observations, with g = |2 b_hat - 1|, and more if they depend on each other.
    """
    # A full memory is halved, so that a test is sure to have only half of it.
    possible_observations = min(setup.config.memory // 2, _MAX_BURSTS * BURST)
    # Twice as many as independent observations would take. Not divided by g**2, which may be 0.
    return possible_observations * _initial_information(setup.b_hat) ** 2 >= 2 * REJECTED_SIGMAS_SQUARED


def can_largest_spread_decide_test(setup: RobotSetup) -> bool:
    """Return whether a run can bring about a test that only the limit of the spread lets reject."""
    return (
        can_estimates_decide_test(setup)
        and can_contradict_extreme_estimate(setup)
        and _initial_information(setup.b_hat) <= _MAX_INFORMATION_FOR_LARGEST_SPREAD
    )


# --- Phases: votes ---


def receive_first_estimates(bench: Bench) -> None:
    """Send the controller its first estimate, one of another robot that replaces it, and then a few more.

    The controller keeps the latest estimate of each id modulo 32. After each of these steps some rounds pass
    without messages. In each round one of the kept estimates, or its own, votes: this moves the controller's
    answer x, which the bench compares with the model's.
    """
    _observe_as_at_three_quarters(bench)
    estimates_without_confidence = [NeighbourEstimate(x_hat, alpha=0) for x_hat in (ONE, ONE, 0)]
    bench.play_round("confidences of 0 before the first estimate", estimates_without_confidence)

    first_sender, sender_of_same_slot, *_ = _ids_of_slot(bench, _FILLING_ORDER[0])
    # Before the first vote the centre is 1/2 and the spread is 1/4, so that this one is as far away.
    first_estimate = NeighbourEstimate(HALF + HALF // 2, ALPHA_MAX)
    bench.play_round("the first vote, as far from the centre as the spread", [first_estimate], [first_sender])
    _let_rounds_vote(bench, 3)  # by turns, its own estimate and the one that it keeps
    other_estimate = NeighbourEstimate(0, ALPHA_LEAST)
    bench.play_round("a sender whose id is equal modulo 32", [other_estimate], [sender_of_same_slot])
    _let_rounds_vote(bench, 3)
    _fill_slots(bench, "estimates of the extremes, and votes by turns", _extremes(4))
    _let_rounds_vote(bench, 12)  # twice the four estimates and its own, and two of them again


def vote_with_every_slot(bench: Bench) -> None:
    """Let the controller keep as many estimates as it can, and pass rounds in which each of them is a vote.

    These are 32 estimates, one in each slot. A vote moves the controller's answer x, and after all 32 its own
    estimate votes. Then the estimates of some slots are replaced, and the turn goes on from where it was.
    The first round is that of a test, in which all estimates are farther than the spread from their centre.
    """
    _play_test(bench, "estimates of the extremes in all slots", _extremes(SLOTS))
    _let_rounds_vote(bench, _ROUNDS_OF_ALL_VOTES + 2)  # and the first two slots again
    _fill_slots(bench, "new estimates in some slots", [SLOT_HALF + slot for slot in range(5)])
    _let_rounds_vote(bench, _ROUNDS_OF_ALL_VOTES)


def vote_without_own_confidence(bench: Bench) -> None:
    """Bring b_hat to exactly 1/2, with which the robot's own estimate has no confidence, and let rounds vote.

    In these rounds its own estimate must not vote, but only those in the slots. b_hat becomes 1/2 by a
    re-estimate when half of the observations are black. If that does not come about, this is noted as not
    exercised, and no rounds vote.
    """
    bench.activity = "observations, half of them black"
    observe_until_excess_of_black(bench, 0)
    contradicting_estimate = _most_contradicting_estimate(bench)
    would_reject = partial(_would_reject, bench, [contradicting_estimate] * SLOTS)
    # Observing the rarer colour alternates between both from here on, so that they stay equally frequent.
    if not _observe_until(bench, would_reject, _rarer_colour):
        bench.not_exercised.append("a re-estimate of b_hat as 1/2")
        return
    _play_test(bench, "a re-estimate of b_hat as 1/2", [contradicting_estimate] * SLOTS)
    bench.play_tick(Observation.BLACK)  # An observation forms x_hat and alpha from the new b_hat.
    _fill_slots(bench, "votes of a robot without confidence", _extremes(SLOTS))
    _let_rounds_vote(bench, 2 * SLOTS)  # each slot twice


def vote_until_spread_is_smallest(bench: Bench) -> None:
    """Let all votes agree until their spread is at its lower limit, and then let them disagree.

    A vote is an estimate that moves the controller's answer x at the end of a round. The spread limits by how
    much: with the smallest one, votes that disagree still move it. The more votes the filter has counted, the
    less each moves it; so many pass here that a controller that counts further than the filter shows.
    """
    x_hat_in_slot_units = bench.model_state.x_hat // _X_HAT_PER_SLOT_UNIT
    own_estimate = min(x_hat_in_slot_units, SLOT_ESTIMATE_MAX)  # an x_hat of 1 is more than a slot can hold
    _fill_slots(bench, "votes that agree", [own_estimate] * SLOTS)
    _let_rounds_vote(bench, _ROUNDS_TO_SMALLEST_SPREAD)
    below = max(own_estimate - _BEYOND_SMALLEST_SPREAD, 0)
    above = min(own_estimate + _BEYOND_SMALLEST_SPREAD, SLOT_ESTIMATE_MAX)
    estimates_around = [below, above] * (SLOTS // 2)
    _fill_slots(bench, "votes on both sides of a centre with the least spread", estimates_around)
    _let_rounds_vote(bench, _ROUNDS_OF_ALL_VOTES)


# --- Phases: tests ---


def test_few_estimates(bench: Bench) -> None:
    """Play tests with four estimates, which are too few for the filter, and with five.

    All of them contradict the observations.
    """
    for count in (4, 5):
        estimates = [_most_contradicting_estimate(bench)] * count
        _play_test_and_observe(
            bench, f"a test with {count} estimates, all of which contradict the observations", estimates
        )


def threshold_phase(*counts: int, widths: Sequence[int]) -> Callable[[Bench], None]:
    """Return a phase that plays the robust filter's test on both sides of its threshold.

    The phase begins with observations as on a floor of which 3/4 are black. For each number of estimates in
    ``counts``, with each width, it plays a test that just does not reject and a test that just does. The
    estimates differ by up to the width from their middle, in units of 2**-16. Slots are never emptied. So
    before the phase no more slots may be filled than the first of ``counts``, and the next must not be lower.
    """

    def play(bench: Bench) -> None:
        """Observe, and play two tests for each number and width."""
        _observe_as_at_three_quarters(bench)
        for count in counts:
            for width in widths:
                _play_tests_at_threshold(bench, count, width)

    return play


def test_with_supporters(bench: Bench) -> None:
    """Play tests that reject although some of the estimates support the robot, enough or just too few.

    Supporters are estimates that agree with the robot's observations. If no observations bring a test about,
    this is noted as not exercised.
    """
    # Four of ten do not protect a robot, three of seven and five of twelve do.
    for count, supporter_count in ((7, 3), (10, 4), (12, 5)):
        bench.activity = f"observations that {supporter_count} of {count} estimates support"
        craft_slots = partial(slots_with_supporters, bench.model_state, count, supporter_count)
        slots = _observe_until_crafted(bench, craft_slots)
        if slots is not None:
            activity = f"a test in which {supporter_count} of {count} estimates support the robot"
            _play_test_and_observe(bench, activity, slots.estimates)


def test_estimates_far_apart(bench: Bench) -> None:
    """Play a test against estimates whose median distance from their median is above the largest spread.

    Half of them are 0 and the others 3/4, so that their centre and the distance are 3/8. The observations are
    such that the test rejects with the largest spread, 1/4, and would not with that distance. If there are
    too few for that, as with a short memory, no test is played.
    """
    three_quarters = 3 * SLOT_HALF // 2  # in units of 2**-16
    estimates = [0, three_quarters] * (SLOTS // 2)
    # Many observations are rejected if their share of black deviates from the prediction by more than
    # sqrt(12) g spread, with g the information: 0.87 g with a spread of 1/4, 1.3 g with one of 3/8. So they
    # are to deviate by 1.1 g.
    deviation = 1.1 * _initial_information(bench.setup.b_hat)
    black_share = _predict_black_share(bench, fill_ratio=3 / 8) + deviation
    bench.activity = "observations that estimates far apart contradict"
    if _observe_until_black_share(bench, black_share, partial(_would_reject, bench, estimates)):
        _play_test_and_observe(bench, "a test with estimates that are far apart", estimates)


def test_dependent_observations(bench: Bench) -> None:
    """Play tests at their threshold after batches of observations that raise and lower the dispersion.

    A batch is what the robot observes from one test to the next. The dispersion says how much more the
    observations vary than independent ones.
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
        for observation in observations:
            bench.play_tick(observation)
        _play_tests_at_threshold(bench, SLOTS, NARROW_WIDTH)


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
        estimates = [SLOT_HALF + offset] * SLOTS
        bench.activity = f"observations that contradict estimates {offset:+} units from 1/2"
        if not _observe_until(bench, partial(_would_reject, bench, estimates), _more_frequent_colour):
            bench.not_exercised.append(bench.activity)
            return
        _play_test_and_observe(bench, f"a test with estimates {offset:+} units from 1/2", estimates)


def re_estimate_often(bench: Bench) -> None:
    """Let tests reject so often that the controller's counter of updates overflows if it has too few bits.

    After every test that rejects, b_hat is re-estimated, which counts as an update. If no observations make a
    test reject, this is noted as not exercised, and nothing is re-estimated.
    """
    bench.activity = "observations until the test rejects"
    if not _observe_until(bench, partial(_can_test_reject, bench), _more_frequent_colour):
        bench.not_exercised.append(bench.activity)
        return
    # From here on there are no observations, so that all tests reject as the first one does.
    contradicting_estimates = [_most_contradicting_estimate(bench)] * SLOTS
    _fill_slots(bench, "estimates that contradict the observations", contradicting_estimates)
    missing_updates = required_updates(bench.setup) - bench.model_state.updates
    # If earlier phases have made all of them, the estimates just sent are tested once all the same.
    for _ in range(max(missing_updates, 1)):
        bench.play_test_round("one of many re-estimates", [])


# --- Estimates for the slots ---


def _extremes(count: int) -> list[int]:
    """Return ``count`` estimates, an even number. Half of them are 0, the others the largest of a slot."""
    return [0, SLOT_ESTIMATE_MAX] * (count // 2)


def _ids_of_slot(bench: Bench, slot: int) -> list[int]:
    """Return the ids, without the controller's own, whose estimates it keeps in this one of its 32 slots."""
    return [robot for robot in bench.other_ids if robot % SLOTS == slot]


def _draw_senders(bench: Bench, count: int) -> list[int]:
    """Draw a sender for each of the first ``count`` slots of ``_FILLING_ORDER``, and return their ids."""
    return [bench.rng.choice(_ids_of_slot(bench, slot)) for slot in _FILLING_ORDER[:count]]


def _draw_message(bench: Bench, estimate: int) -> NeighbourEstimate:
    """Draw a message that the controller keeps as this estimate, in units of 2**-16.

    Its x_hat, in units of 2**-23, is the smallest or the largest of those that are rounded to the estimate,
    to nearest and halves up.
    """
    exact_x_hat = estimate * _X_HAT_PER_SLOT_UNIT
    half_unit = _X_HAT_PER_SLOT_UNIT // 2
    smallest_x_hat = max(exact_x_hat - half_unit, 0)
    largest_x_hat = exact_x_hat + half_unit - 1  # one more, which is a half, would be rounded up
    if estimate == SLOT_ESTIMATE_MAX:
        # There is no larger estimate, also not for 1.0, so all x_hat above it become this one.
        largest_x_hat = ONE
    x_hat = bench.rng.choice((smallest_x_hat, largest_x_hat))
    return NeighbourEstimate(x_hat, draw_normal_alpha(bench.rng))


def _fill_slots(bench: Bench, activity: str, estimates: Sequence[int]) -> None:
    """Play a round without a test after which the controller keeps these estimates, in units of 2**-16.

    They are in the first slots of ``_FILLING_ORDER``. The other slots keep what they have.
    """
    messages = [_draw_message(bench, estimate) for estimate in estimates]
    bench.play_round(activity, messages, _draw_senders(bench, len(messages)))


def _let_rounds_vote(bench: Bench, rounds: int) -> None:
    """Let so many whole rounds pass without messages: in each a kept estimate or the robot's votes."""
    bench.skip_to_round()
    bench.skip_ticks(rounds * bench.setup.comms_period)


def _play_test(bench: Bench, activity: str, estimates: Sequence[int]) -> None:
    """Fill slots with these estimates, in units of 2**-16, in the round of the next test.

    The controller observes nothing in this round and before it.
    """
    messages = [_draw_message(bench, estimate) for estimate in estimates]
    bench.play_test_round(activity, messages, _draw_senders(bench, len(messages)))


def _play_test_and_observe(bench: Bench, activity: str, estimates: Sequence[int]) -> None:
    """Play the next test with these estimates, in units of 2**-16, and observe once after it.

    With this observation the robot forms its x_hat from the b_hat that the test has left.
    """
    _play_test(bench, activity, estimates)
    bench.play_tick(bench.draw_observation())


# --- Observations ---


def _observe_until(
    bench: Bench, is_reached: Callable[[], bool], choose_colour: Callable[[Bench], Observation]
) -> bool:
    """Observe the chosen colours in bursts of 16 until ``is_reached`` returns True.

    Returns whether it does so within 8000 observations.
    """
    for _ in range(_MAX_BURSTS):
        if is_reached():
            return True
        bench.skip_ticks(BURST, partial(choose_colour, bench))
    return False


def _observe_as_at_three_quarters(bench: Bench) -> None:
    """Observe until the share of black is about what the initial b_hat predicts for a fill ratio of 3/4."""
    bench.activity = "observations, of which the initial b_hat explains the share"
    black_share = _predict_black_share(bench, _FILL_RATIO_BEFORE_TEST)
    _observe_until_black_share(bench, black_share)


def _observe_until_black_share(
    bench: Bench, black_share: float, is_enough: Callable[[], bool] = lambda: True
) -> bool:
    """Observe until the share of black is within 0.01 of ``black_share``, and ``is_enough`` returns True.

    Returns whether that has come about within 8000 observations.
    """
    state = bench.model_state

    def is_reached() -> bool:
        """Return whether the share is that near, and ``is_enough`` returns True."""
        return abs(state.n - black_share * state.t) < 0.01 * state.t and is_enough()

    def choose_colour(_bench: Bench) -> Observation:
        """Return black while the share of black is too low."""
        is_share_too_low = state.n < black_share * state.t
        return Observation(is_share_too_low)

    return _observe_until(bench, is_reached, choose_colour)


Crafted = TypeVar("Crafted")


def _observe_until_crafted(bench: Bench, craft: Callable[[], Crafted | None]) -> Crafted | None:
    """Observe until ``craft`` returns estimates for the next test, and not None; return what it returns.

    All observations of a burst have one colour. It is the more frequent colour while no estimate contradicts
    the observations enough for the test to reject. Once some estimate does, it is the other colour, so that
    the contradiction does not become too large. If nothing is crafted after 500 bursts of 16 observations,
    the result is None, and ``activity`` of the bench is noted as not exercised.
    """
    for _ in range(_MAX_BURSTS):
        crafted = craft()
        if crafted is not None:
            return crafted
        colour = _rarer_colour(bench) if _can_test_reject(bench) else _more_frequent_colour(bench)
        bench.skip_ticks(BURST, partial(Observation, colour))
    bench.not_exercised.append(bench.activity)
    return None


def _more_frequent_colour(bench: Bench) -> Observation:
    """Return the colour that the robot has observed more often, and white if both are equally frequent."""
    black_count = bench.model_state.n
    white_count = bench.model_state.t - black_count
    return Observation(black_count > white_count)


def _rarer_colour(bench: Bench) -> Observation:
    """Return the colour that the robot has observed less often, and black if both are equally frequent."""
    return Observation.WHITE if _more_frequent_colour(bench) is Observation.BLACK else Observation.BLACK


# --- What decides a test ---


def _predict_black_share(bench: Bench, fill_ratio: float) -> float:
    """Return the share of black observations that the initial b_hat predicts for a fill ratio (eq. 1)."""
    b_hat = bench.setup.b_hat
    black_seen_as_black = b_hat * fill_ratio
    white_seen_as_black = (1 - b_hat) * (1 - fill_ratio)
    return black_seen_as_black + white_seen_as_black


def _most_contradicting_estimate(bench: Bench) -> int:
    """Return 0 or the largest estimate of a slot, whichever contradicts the robot's observations more."""
    return opposite_end(agreeing_estimate(bench.model_state))


def _would_reject(bench: Bench, estimates: Sequence[int]) -> bool:
    """Return whether a test before the next observation would reject with these estimates in the slots."""
    return slots_at_test(bench.model_state, estimates).is_rejected


def _can_test_reject(bench: Bench) -> bool:
    """Return whether there are estimates with which a test before the next observation would reject."""
    # No estimates contradict the observations more than this one in every slot.
    return _would_reject(bench, [_most_contradicting_estimate(bench)] * SLOTS)


# --- Tests that are decided by a hair ---


def _play_tests_at_threshold(bench: Bench, count: int, width: int) -> None:
    """Play a test that just does not reject with ``count`` estimates, and then one that just does.

    Before, the controller observes until both can be brought about; if they cannot, this is noted as not
    exercised. The estimates differ by up to ``width`` from their middle, in units of 2**-16.
    """
    bench.activity = f"observations before a test of {count} estimates"
    slots_on_both_sides = _observe_until_crafted(bench, partial(_draw_both_sides, bench, count, width))
    if slots_on_both_sides is None:
        return
    accepted_slots, rejected_slots = slots_on_both_sides
    # It observes nothing between the two tests, as both are drawn for its present observations.
    _play_test(bench, "a test that just does not reject", accepted_slots.estimates)
    _play_test_and_observe(bench, "a test that just rejects", rejected_slots.estimates)


def _draw_both_sides(bench: Bench, count: int, width: int) -> tuple[SlotsAtTest, SlotsAtTest] | None:
    """Return ``count`` estimates by which the next test just does not reject, and others by which it does.

    They differ by up to ``width`` from their middle, in units of 2**-16. Of many draws, one is taken for
    either side in which the last bit of the centre decides the test; without such a draw, the first one.
    Returns None if no draw brings a test to its threshold.
    """
    accepted_slots: SlotsAtTest | None = None
    rejected_slots: SlotsAtTest | None = None
    for _ in range(_MAX_DRAWS_BY_WIDTH[width]):
        drawn_slots = draw_slots_at_threshold(bench.model_state, count, width, bench.rng)
        if drawn_slots is None:
            continue
        accepted, rejected = drawn_slots
        if accepted_slots is None or accepted.is_decided_by_last_bit:
            accepted_slots = accepted
        if rejected_slots is None or rejected.is_decided_by_last_bit:
            rejected_slots = rejected
    if accepted_slots is None or rejected_slots is None:
        return None
    return accepted_slots, rejected_slots
