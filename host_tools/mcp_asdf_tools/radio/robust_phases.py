"""Phases that put the robust filter to the test: its slots, its votes, and its test of the initial b_hat.

The filter keeps the latest estimate of each sender in one of 32 slots, that of the sender's id modulo 32. At
the end of each round one of these estimates is a vote, in turn, and after the last of them the robot's own
estimate is one. Votes move x, their centre, which telemetry shows, so each round shows one of them.

Every filter period the robot tests whether its observations contradict the estimates in the slots, if these
are five or more. If they do, it re-estimates b_hat, unless more than two fifths of the estimates support it;
if they do not, b_hat goes back to the initial one. A larger dispersion, which is how much more the robot's
observations vary than independent ones, makes the test more careful.

What is sent depends on the model's state: one unit of the estimate in one slot decides a test.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import TypeVar

from mcp_asdf.fixed_point import ALPHA_MAX, HALF, ONE
from mcp_asdf.robot import Observation
from mcp_asdf.robust_filter import SLOT_ESTIMATE_MAX, SLOTS, VOTES_MAX
from mcp_asdf_tools.crosscheck.crafted_rounds import ALPHA_LEAST, NeighbourEstimate, draw_normal_alpha
from mcp_asdf_tools.crosscheck.crafted_slots import (
    SlotsAtTest,
    draw_slots_at_threshold,
    estimate_that_predicts,
    filter_at_test,
    slots_of_two_parties,
)
from mcp_asdf_tools.radio.bench import BURST, Bench
from mcp_asdf_tools.radio.filter_phases import count_updates_to_check, observe_until_excess

_FIRST_SLOTS = (15, 0, 31, 16, 7, 8, 23, 24, 1, 30, 12, 19)
"""Slots in the order in which the first phase fills them: early ones are at the ends of bytes and words."""
_HALF_OF_SLOT = SLOT_ESTIMATE_MAX // 2 + 1
"""1/2 in units of 2**-16, as slots have them."""
_FILL_RATIO = 0.75
"""Fill ratio that the observations indicate before the tests: estimates fit in on either side of it."""
_INFORMATIVE_DISTANCE = 8
"""Distance of estimates from 1/2 from which on they carry information, in units of 2**-16: 2**-13."""
NARROW_WIDTH, WIDE_WIDTH = 4, 1 << 13
"""How far estimates are from their middle, in units of 2**-16: their spread is the least one, or large."""
_MAX_DRAWS = 400
"""Draws of estimates at the threshold of a test among which one is chosen."""
_MAX_ATTEMPTS = 500
"""Times that a burst of observations is made to bring about a test."""
_MIN_INFORMATION = 0.05
"""|2 b_hat - 1| of an initial b_hat below which estimates move the threshold too little to be shown."""
_BALANCED_OBSERVATIONS = 4096
"""Largest number of observations to bring the share of black ones to some value."""
_ROUNDS_AT_SPREAD_MIN = 2500
"""Rounds of votes that agree after which the spread would be below its limit, if it had none."""

_Result = TypeVar("_Result")


def receive_first_estimates(bench: Bench) -> None:
    """Fill the first slots one by one, and test with four, five and more estimates."""
    bench.activity = "observations, of which the initial b_hat explains the share"
    _observe_share(bench, _predicted_share(bench, _FILL_RATIO))
    bench.activity = "confidences of 0 before the first estimate"
    bench.play_round(*(NeighbourEstimate(x_hat, 0) for x_hat in (ONE, ONE, 0)))
    first_senders = [robot for robot in bench.other_ids if robot % SLOTS == _FIRST_SLOTS[0]]
    bench.activity = "the first vote, as far from the centre as the spread"
    bench.play_round(NeighbourEstimate(ONE - HALF // 2, ALPHA_MAX), senders=first_senders[:1])
    _let_vote(bench, 3)
    bench.activity = "a sender whose id is equal modulo 32"
    bench.play_round(NeighbourEstimate(0, ALPHA_LEAST), senders=first_senders[1:2])
    _let_vote(bench, 3)
    bench.activity = "estimates of the extremes, and votes by turns"
    _set_slots(bench, [0, SLOT_ESTIMATE_MAX, SLOT_ESTIMATE_MAX, 0])
    _let_vote(bench, 12)
    for count in (4, 5):
        bench.activity = f"a test with {count} estimates, all of which contradict the observations"
        _set_slots(bench, [_contradicting_estimate(bench)] * count)
        _play_test(bench)
        bench.play_tick(bench.draw_observation())
    if not _estimates_decide(bench):
        return
    for count in (5, 6):
        _cross_threshold(bench, count, WIDE_WIDTH)
        _cross_threshold(bench, count, NARROW_WIDTH)
    if _opposite_estimate_is_rejected(bench):
        # Two of five and four of ten do not protect a robot, three of seven and five of twelve do.
        for count, supporter_count in ((5, 2), (7, 3), (10, 4), (12, 5)):
            _test_two_parties(bench, count, supporter_count)


def vote_with_every_slot(bench: Bench) -> None:
    """Fill all slots, and let them vote by turns, the robot itself among them, and some change in between."""
    bench.activity = "estimates of the extremes in all slots"
    _set_slots(bench, [0, SLOT_ESTIMATE_MAX] * (SLOTS // 2))
    _let_vote(bench, SLOTS + 3)
    for slot in range(0, SLOTS, 5):
        bench.activity = f"a new estimate in slot {slot}"
        senders = _draw_senders(bench, [slot])
        bench.play_round(NeighbourEstimate(HALF + slot, draw_normal_alpha(bench.rng)), senders=senders)
        _let_vote(bench, 2)
    bench.activity = "estimates that are halfway between two units of a slot"
    x_hats = [HALF + 128 * slot + (63, 64)[slot % 2] for slot in range(SLOTS)]
    estimates = [NeighbourEstimate(x_hat, draw_normal_alpha(bench.rng)) for x_hat in x_hats]
    bench.play_round(*estimates, senders=_draw_senders(bench, range(SLOTS)))
    _let_vote(bench, SLOTS + 1)


def vote_without_own_confidence(bench: Bench) -> None:
    """Bring b_hat to exactly 1/2, with which the robot has no confidence, and let the slots vote without it.

    That takes a re-estimate when half of the observations are black.
    """
    if not _opposite_estimate_is_rejected(bench):
        return
    bench.activity = "observations, half of them black"
    observe_until_excess(bench, 0)
    estimate = _contradicting_estimate(bench)
    for _ in range(_BALANCED_OBSERVATIONS):
        if _rejected_slots(bench, estimate) is not None:
            break
        bench.play_tick(Observation.BLACK)
        bench.play_tick(Observation.WHITE)
    else:
        bench.not_exercised.append("a re-estimate of b_hat as 1/2")
        return
    bench.activity = "a re-estimate of b_hat as 1/2"
    bench.skip_to_test_round()
    _set_slots(bench, [estimate] * SLOTS)
    bench.play_tick(Observation.BLACK)
    bench.activity = "votes of a robot without confidence"
    _set_slots(bench, [0, SLOT_ESTIMATE_MAX] * (SLOTS // 2))
    _let_vote(bench, 2 * SLOTS)


def vote_until_spread_is_least(bench: Bench) -> None:
    """Let all estimates agree until the spread is at its lower limit, and then disagree."""
    bench.activity = "votes that agree"
    own_estimate = min(bench.firmware.s.x_hat >> 7, SLOT_ESTIMATE_MAX)
    _set_slots(bench, [own_estimate] * SLOTS)
    _let_vote(bench, _ROUNDS_AT_SPREAD_MIN)
    bench.activity = "votes on both sides of a centre with the least spread"
    _set_slots(bench, [max(own_estimate - 40, 0), min(own_estimate + 40, SLOT_ESTIMATE_MAX)] * (SLOTS // 2))
    _let_vote(bench, SLOTS)


def vote_often(bench: Bench) -> None:
    """Let twice as many votes be taken as are counted, for both ends."""
    bench.activity = "many votes"
    _set_slots(bench, [0, 0, SLOT_ESTIMATE_MAX, SLOT_ESTIMATE_MAX] * (SLOTS // 4))
    _let_vote(bench, 2 * VOTES_MAX + SLOTS)


def threshold_phase(width: int) -> Callable[[Bench], None]:
    """Return a phase that plays the robust filter's test on both sides of its threshold.

    The phase is a function that plays it on the bench of a controller. All slots have estimates, which differ
    by up to ``width`` from their middle, in units of 2**-16.
    """

    def play(bench: Bench) -> None:
        if not _estimates_decide(bench):
            return
        _observe_share(bench, _predicted_share(bench, _FILL_RATIO))
        for _ in range(2):
            _cross_threshold(bench, SLOTS, width)

    return play


def test_estimates_far_apart(bench: Bench) -> None:
    """Play a test against estimates whose median distance from their median is above the largest spread.

    Half of them are 0 and the others 3/4, so that their centre and the distance are 3/8. The observations are
    such that the test rejects with the largest spread, 1/4, and would not with that distance. If the initial
    b_hat is far from 1/2 there are no such observations, and with a short memory too few. Then nothing is
    played.
    """
    g = abs(2 * bench.firmware.s.robust.initial_b_hat / 2**32 - 1)
    # Many observations are rejected if they deviate by more than sqrt(12) g spread: 0.87 g with a spread of
    # 1/4, and 1.3 g with one of 3/8.
    share = _predicted_share(bench, fill_ratio=3 / 8) + 1.1 * g
    if not _estimates_decide(bench) or share >= 1:
        return
    bench.activity = "observations that estimates far apart contradict"
    estimates = (0, 3 * _HALF_OF_SLOT // 2) * (SLOTS // 2)
    if not _observe_share(bench, share, lambda: _slots_at_test(bench, estimates).is_rejected()):
        return
    bench.activity = "a test with estimates that are far apart"
    bench.skip_to_test_round()
    _set_slots(bench, estimates)
    bench.play_tick(bench.draw_observation())


def test_dependent_observations(bench: Bench) -> None:
    """Play tests at their threshold after batches of observations that raise and lower the dispersion.

    A batch is what the robot observes from one test to the next.
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
        bench.skip_ticks(len(observations), partial(next, iter(observations)))
        if _estimates_decide(bench):
            _cross_threshold(bench, SLOTS, NARROW_WIDTH)
        else:
            _play_test(bench)


def reject_near_half(bench: Bench) -> None:
    """Let the test reject with estimates that carry just enough information, or just too little, or 1/2.

    All slots have the same estimate. The first two are played on either side of 1/2.
    """
    limit = _INFORMATIVE_DISTANCE
    # One unit nearer to 1/2 above, and one unit farther away below, is on the other side of the limit.
    for offset in (limit, limit - 1, -limit, -limit - 1, 0):
        bench.activity = f"observations that contradict estimates of 1/2 and {offset} units"
        estimate = _HALF_OF_SLOT + offset
        slots = _observe_until(bench, partial(_rejected_slots, bench, estimate), estimate)
        if slots is None:
            return
        bench.activity = f"a test with estimates of 1/2 and {offset} units"
        bench.skip_to_test_round()
        _set_slots(bench, slots.estimates)
        bench.play_tick(bench.draw_observation())


def reject_often(bench: Bench) -> None:
    """Let the test reject so often that a controller shows whose counter of updates has too few bits."""
    bench.activity = "observations until the test rejects"
    slots = _observe_until(bench, lambda: _rejected_slots(bench, _contradicting_estimate(bench)))
    if slots is None:
        return
    _set_slots(bench, slots.estimates)
    bench.activity = "one of many re-estimates"
    missing_updates = count_updates_to_check(bench.setup) - bench.firmware.s.updates
    for _ in range(max(missing_updates, 1)):
        _play_test(bench)


# --- Steps ---


def _draw_senders(bench: Bench, slots: Sequence[int]) -> list[int]:
    """Draw a sender for each slot: one of the ids that are equal to its number modulo 32, but not our own."""
    return [bench.rng.choice([robot for robot in bench.other_ids if robot % SLOTS == slot]) for slot in slots]


def _set_slots(bench: Bench, estimates: Sequence[int]) -> None:
    """Play a round of messages that set as many slots to these estimates, in the order of the first phase."""
    order = _FIRST_SLOTS + tuple(slot for slot in range(SLOTS) if slot not in _FIRST_SLOTS)
    messages = [
        NeighbourEstimate(_draw_x_hat(bench, estimate), draw_normal_alpha(bench.rng))
        for estimate in estimates
    ]
    bench.play_round(*messages, senders=_draw_senders(bench, order[: len(estimates)]))


def _draw_x_hat(bench: Bench, estimate: int) -> int:
    """Draw an x_hat, in units of 2**-23, that a slot keeps as this estimate, in units of 2**-16."""
    nearest = estimate << 7
    largest = ONE if estimate == SLOT_ESTIMATE_MAX else nearest + 63
    return bench.rng.randint(max(nearest - 64, 0), largest)


def _let_vote(bench: Bench, rounds: int) -> None:
    """Let rounds without messages pass, in each of which a slot or the robot itself votes."""
    bench.skip_to_round()
    bench.skip_ticks(rounds * bench.setup.comms_period)


def _play_test(bench: Bench) -> None:
    """Skip ticks until the round of the next test, and play that round without messages."""
    bench.skip_to_test_round()
    bench.play_round()


def _observe_share(bench: Bench, share: float, is_enough: Callable[[], bool] = lambda: True) -> bool:
    """Observe until the share of black observations is near ``share`` and ``is_enough`` returns True.

    Returns whether that was reached; it is given up after many observations.
    """
    state = bench.firmware.s
    for _ in range(_BALANCED_OBSERVATIONS // BURST):
        is_near = state.t > 4 * BURST and abs(state.n - share * state.t) < 0.01 * state.t
        if is_near and is_enough():
            return True
        bench.skip_ticks(BURST, lambda: Observation(state.n < share * state.t))
    return False


def _observe_until(
    bench: Bench, make: Callable[[], _Result | None], rejected_estimate: int | None = None
) -> _Result | None:
    """Observe until ``make`` returns something, and return that.

    The observations bring the test nearer to its threshold: where ``rejected_estimate``, in all slots, would
    not be rejected, they are of the colour that is seen more often, and otherwise of the other one. By
    default it is the estimate that contradicts the observations most. If ``make`` returns nothing after many
    of them, the present activity is noted as not exercised.
    """
    state = bench.firmware.s
    for _ in range(_MAX_ATTEMPTS):
        result = make()
        if result is not None:
            return result
        is_black_more_frequent = 2 * state.n > state.t
        estimate = _contradicting_estimate(bench) if rejected_estimate is None else rejected_estimate
        is_too_near = _rejected_slots(bench, estimate) is None
        colour = Observation(is_black_more_frequent == is_too_near)
        bench.skip_ticks(BURST, partial(Observation, colour))
    bench.not_exercised.append(bench.activity)
    return None


# --- The test and its threshold ---


def _estimates_decide(bench: Bench) -> bool:
    """Return whether the initial b_hat is so far from 1/2 that estimates can decide the robot's test."""
    b_hat = bench.firmware.s.robust.initial_b_hat / 2**32
    return abs(2 * b_hat - 1) >= _MIN_INFORMATION


def _opposite_estimate_is_rejected(bench: Bench) -> bool:
    """Return whether a run has enough observations for a test that rejects while estimates explain the share.

    The share of black is then that of a fill ratio between 0 and 1, and contradicts an estimate of 0 or 1. It
    takes 12 / g**2 observations, and more where they depend on each other, with g = |2 b_hat - 1|.
    """
    g = abs(2 * bench.firmware.s.robust.initial_b_hat / 2**32 - 1)
    possible_observations = min(bench.config.memory // 2, _MAX_ATTEMPTS * BURST)
    return possible_observations * g**2 >= 2 * 12


def _predicted_share(bench: Bench, fill_ratio: float) -> float:
    """Return the share of black observations that the initial b_hat predicts for a fill ratio (eq. 1)."""
    b_hat = bench.firmware.s.robust.initial_b_hat / 2**32
    return b_hat * fill_ratio + (1 - b_hat) * (1 - fill_ratio)


def _contradicting_estimate(bench: Bench) -> int:
    """Return the estimate, 0 or almost 1, that contradicts the robot's observations most."""
    state = bench.firmware.s
    explaining_estimate = estimate_that_predicts(state.robust, state.n / state.t)
    return 0 if explaining_estimate > _HALF_OF_SLOT else SLOT_ESTIMATE_MAX


def _slots_at_test(bench: Bench, estimates: tuple[int, ...]) -> SlotsAtTest:
    """Return these estimates with what the next test needs beside them, if no observation comes before."""
    state = bench.firmware.s
    return SlotsAtTest(estimates, filter_at_test(state), state.t, state.n)


def _rejected_slots(bench: Bench, estimate: int) -> SlotsAtTest | None:
    """Return slots with this estimate alone if the next test, before another observation, rejects them."""
    slots = _slots_at_test(bench, (estimate,) * SLOTS)
    return slots if slots.is_rejected() else None


def _cross_threshold(bench: Bench, count: int, width: int) -> None:
    """Play a test that just rejects, and one that just does not, with ``count`` estimates."""
    for is_rejection in (True, False):
        bench.activity = f"observations before a test of {count} estimates"
        slots = _observe_until(bench, partial(_choose_slots, bench, count, width, is_rejection))
        if slots is None:
            return
        bench.activity = "a test that " + ("just rejects" if is_rejection else "just does not reject")
        bench.skip_to_test_round()
        _set_slots(bench, slots.estimates)
        bench.play_tick(bench.draw_observation())


def _choose_slots(bench: Bench, count: int, width: int, is_rejection: bool) -> SlotsAtTest | None:
    """Return estimates that a test just rejects, or just does not, and that show most known mistakes.

    A mistake counts only while no frame has shown it. The search ends with the first estimates that show one.
    Returns None if the test cannot be brought to its threshold.
    """
    first_slots: SlotsAtTest | None = None
    for slots in _draw_slots_at_threshold(bench, count, width, is_rejection):
        if first_slots is None:
            first_slots = slots
        wrong_tests = bench.mistaken_models.robust_tests
        if any(slots.is_rejected(test) != is_rejection for test in wrong_tests) and not slots.is_supported:
            return slots
    return first_slots


def _draw_slots_at_threshold(
    bench: Bench, count: int, width: int, is_rejection: bool
) -> Iterator[SlotsAtTest]:
    """Yield estimates by which the next test just rejects, or just does not.

    Of many draws if mistakes are still to be shown, otherwise of one. There are none if no draw reaches the
    threshold.
    """
    draw_count = _MAX_DRAWS if bench.mistaken_models.robust_tests else 1
    for _ in range(draw_count):
        pair = draw_slots_at_threshold(bench.firmware, count, width, bench.rng)
        if pair is not None:
            yield pair[is_rejection]


def _test_two_parties(bench: Bench, count: int, supporter_count: int) -> None:
    """Play a test that rejects although ``supporter_count`` of ``count`` estimates support the robot."""
    bench.activity = f"observations that {supporter_count} of {count} estimates support"
    slots = _observe_until(bench, lambda: slots_of_two_parties(bench.firmware, count, supporter_count))
    if slots is None:
        return
    bench.activity = f"a test in which {supporter_count} of {count} estimates support the robot"
    bench.skip_to_test_round()
    _set_slots(bench, slots.estimates)
    bench.play_tick(bench.draw_observation())
