"""Phases that put the paper's filter to the test: its period, thresholds and re-estimates, and the memory.

A test compares the robot's x_hat with the estimates of a round, every filter period. If it rejects x_hat,
b_hat, the accuracy that the robot assumes of its sensor, is re-estimated (eq. 8) from x_bar, the weighted
mean of these estimates.

A phase only observes and sends: its bench gives the same to a model of the controller, and compares the two
after each tick.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from random import Random

from mcp_asdf.fixed_point import HALF, ONE
from mcp_asdf.robot import Filter, Observation
from mcp_asdf_tools.crosscheck.crafted_rounds import (
    ALPHA_SCALES,
    NeighbourEstimate,
    RobotState,
    Update,
    draw_alphas_of_one_scale,
    draw_distant_estimates,
    draw_estimate,
    draw_round_for_update,
    draw_round_of_distant_sum,
    draw_round_of_large_scatter,
    draw_rounds_at_threshold,
)
from mcp_asdf_tools.radio.bench import BURST, Bench
from mcp_asdf_tools.robots.robot_setup import RobotSetup

LONG_RUN = 20_000
"""Observations after which a controller must not have forgotten any, unless its memory is shorter: more than
2**14, so that narrower counts show."""
_WHITE_TILES = 60
"""White tiles before the re-estimate, beside the white tiles of earlier phases."""
_SMALL_COUNT = 2**12
"""Observations below which the divisor of eq. 8, t (2 x_bar - 1), is below 1 for an x_bar of 1/2 + 2**-13."""
_EARLY_COUNTS = (250, 350, 480)
"""Observations after which b_hat is re-estimated early."""
_MAX_PERIOD_FOR_MANY_UPDATES = 50
"""Largest number of ticks between tests with which a run has time for more than 2**8 updates."""

SIZES_AT_THRESHOLD = (2, 3, 5, 10, 30, 126)
"""Numbers of estimates of the rounds that lie just inside and just outside the threshold."""
_MAX_ATTEMPTS_TO_UPDATE = 4
"""Tests after which it is given up to bring a robot to a kind of update."""
_NEAR_HALF = (Update.HALF, Update.FAINT)
"""Updates for which the share of black tiles must be near 1/2."""
_HALF_BLACK = "many observations, half of them black"
_MANY_OBSERVATIONS = "many observations in a row"
_ROUND_SIZE = 5
"""Estimates in a round whose size does not matter. The adaptive filter tests rounds of two or more."""


def re_estimate_to_half(bench: Bench) -> None:
    """Bring b_hat to 1/2, and then to almost 1/2, by re-estimates, and let the controller observe with it.

    With a b_hat of 1/2 its observations carry no information, and next to 1/2 hardly any. After either
    re-estimate it observes three times. If it has made fewer than 4096 observations when half of them are
    black, it first tests estimates whose mean is 2**-13 above 1/2.
    """
    state = bench.model_state
    bench.activity = _HALF_BLACK
    observe_until_excess_of_black(bench, 0)
    if state.t < _SMALL_COUNT:
        _test_with_divisor_below_1(bench)
    # With as many black tiles as white ones eq. 8 gives a b_hat of 1/2, whatever the estimates are.
    _play_update(bench, Update.HALF)
    _observe_three_times_without_knowledge(bench)

    bench.activity = _HALF_BLACK
    # Few more black tiles than white ones: about one of 4096.
    observe_until_excess_of_black(bench, state.t // 4096 + 1)
    _play_update(bench, Update.FAINT)
    _observe_three_times_without_knowledge(bench)


def _test_with_divisor_below_1(bench: Bench) -> None:
    """Play a test of five equal estimates that are slightly more than 2**-13 above 1/2.

    The robot must have made fewer than 2**12 observations. Then the divisor of eq. 8, t (2 x_bar - 1), is
    below 1.
    """
    x_hat = HALF + 2**10 + 2  # in units of 2**-23, of which 2**10 are 2**-13
    _play_test_round(
        bench,
        "a mean so close to 1/2 that the divisor of eq. 8 is below 1",
        draw_equal_estimates(x_hat, bench.rng),
    )


def _observe_three_times_without_knowledge(bench: Bench) -> None:
    """Let the controller make three observations with a b_hat at 1/2 or next to it."""
    bench.activity = "observations of a robot that knows hardly anything"
    for _ in range(3):
        bench.play_tick(bench.draw_observation())


def observe_until_excess_of_black(bench: Bench, excess: int) -> None:
    """Observe until the robot has observed ``excess`` more black tiles than white ones."""
    state = bench.model_state

    def missing_black() -> int:
        """Return how many more black tiles are needed; below 0 if more white ones are."""
        white_count = state.t - state.n
        return excess - (state.n - white_count)

    while missing_black() != 0:
        needs_black = missing_black() > 0
        # At most half of the way at once: a memory that is full halves the excess on the way.
        ticks = max(abs(missing_black()) // 2, 1)
        bench.skip_ticks(ticks, partial(Observation, needs_black))


def re_estimate_without_black(bench: Bench) -> None:
    """Let the controller observe a few white tiles, and re-estimate b_hat before its first black one.

    It re-estimates from five estimates of 1/4. After the white tiles it observes nothing until the test.
    """
    bench.activity = "white tiles, and then none until the test"
    # So few that t is still small in the next phases.
    bench.skip_ticks(_WHITE_TILES, lambda: Observation.WHITE)
    quarter = HALF // 2
    estimates = draw_equal_estimates(quarter, bench.rng)
    _play_test_round(bench, "a re-estimate without a black tile", estimates)


def re_estimate_from_ends(bench: Bench) -> None:
    """Let the controller re-estimate b_hat from neighbours that all estimate 0, and then 1, or the reverse.

    First comes the end farther from its own estimate. After each re-estimate it observes three white tiles
    and three black ones, twice: with one of these colours its x_hat would leave the range 0 .. 1, and must be
    limited.
    """
    is_own_estimate_high = bench.model_state.x_hat > HALF
    ends = (0, ONE) if is_own_estimate_high else (ONE, 0)
    for end in ends:
        _observe_until_filter_runs(bench)
        _play_test_round(bench, f"estimates of {end // ONE}", draw_equal_estimates(end, bench.rng))
        bench.activity = f"tiles of one colour, then of the other, after estimates of {end // ONE}"
        for colour in (Observation.WHITE, Observation.BLACK) * 2:
            for _ in range(3):
                bench.play_tick(colour)


DrawRound = Callable[[RobotState, Random], Sequence[NeighbourEstimate]]
"""A function that draws the estimates of a round for a robot in a given state, which is to receive them."""


def draw_equal_estimates(x_hat: int, rng: Random) -> list[NeighbourEstimate]:
    """Draw five estimates of this x_hat, whose confidences differ but are of similar size."""
    return [NeighbourEstimate(x_hat, alpha) for alpha in draw_alphas_of_one_scale(rng, _ROUND_SIZE)]


def draw_own_estimates(robot: RobotState, rng: Random) -> list[NeighbourEstimate]:
    """Draw five estimates whose x_hat is the robot's own. They must pass a test."""
    return draw_equal_estimates(robot.x_hat, rng)


LONGEST_NUMBERS: dict[str, DrawRound] = {
    "a spread of 2^57": draw_round_of_large_scatter,
    "a distance of the sum above 2^27": draw_round_of_distant_sum,
}
"""Rounds with the longest numbers in eq. 12, the test, by their activity: a controller may cut them short."""
OWN_ESTIMATES: dict[str, DrawRound] = {"messages equal to its own estimate": draw_own_estimates}
NOT_REJECTED_BY_A_TEST: dict[str, DrawRound] = {
    "a re-estimate from a single message": partial(draw_distant_estimates, m=1),  # a test needs two
    "a re-estimate from messages equal to its own estimate": draw_own_estimates,
}
"""Rounds that change b_hat by a filter that re-estimates without a test alone, by their activity."""


def phase_of_tests(draw_by_activity: dict[str, DrawRound]) -> Callable[[Bench], None]:
    """Return a phase that plays a test of each of these rounds.

    Before each of them the controller observes, at least once, and the round is drawn for the state that it
    has then. A difference is reported with the activity.
    """

    def play(bench: Bench) -> None:
        """Play the tests in order."""
        for activity, draw_round in draw_by_activity.items():
            _observe_until_filter_runs(bench)
            _play_test_round(bench, activity, draw_round(bench.robot_state, bench.rng))

    return play


def threshold_phase(m: int) -> Callable[[Bench], None]:
    """Return a phase that plays two tests of ``m`` estimates: one just passes, and the other just rejects.

    The estimates are drawn so that both are as near as possible to k_m, the threshold of the test for m.
    """

    def play(bench: Bench) -> None:
        """Play a test inside the threshold, and one outside."""
        _observe_until_filter_runs(bench)
        passing, rejected = draw_rounds_at_threshold(bench.robot_state, m, bench.rng)
        _play_test_round(bench, f"{m} messages just inside the threshold", passing)
        # It observes nothing between the two, so that its x_hat is still the one for which both are drawn.
        _play_test_round(bench, f"{m} messages just outside the threshold", rejected)

    return play


def re_estimate_early(bench: Bench) -> None:
    """Let the controller re-estimate b_hat after 250, 350 and 480 observations, above 1/2 and below 1/2.

    About 3/5 of them are black, so that b_hat can be off its limits. Numbers that earlier phases have passed,
    and re-estimates for which no estimates are drawn, are left out.
    """
    state = bench.model_state
    for t in _EARLY_COUNTS:
        if state.t > t:
            continue
        bench.activity = f"{t} observations"
        bench.skip_ticks(t - state.t, bench.draw_observation)
        for update in (Update.ABOVE, Update.BELOW):
            bench.skip_to_test_round()
            estimates = draw_round_for_update(bench.robot_state, update, bench.rng)
            if estimates is not None:
                bench.play_test_round(f"a re-estimate after {state.t} observations", estimates)
                bench.play_tick(None)


def required_updates(setup: RobotSetup) -> int:
    """Return how many updates of b_hat a run makes at least, so that a counter of too few bits shows.

    They are 257, more than a counter of 8 bits can hold. If tests are more than 50 ticks apart, a run has
    time for 33 alone.
    """
    has_frequent_tests = setup.filter_period <= _MAX_PERIOD_FOR_MANY_UPDATES
    if has_frequent_tests:
        return 2**8 + 1
    return 2**5 + 1


def re_estimate_often(bench: Bench) -> None:
    """Let the controller re-estimate b_hat so often that a counter of updates with too few bits shows.

    The estimates have confidences (alpha) of every size, one size a round. There are at least as many rounds
    as sizes, also if earlier phases have made all required re-estimates.
    """
    missing_updates = required_updates(bench.setup) - bench.model_state.updates
    round_count = max(missing_updates, len(ALPHA_SCALES))
    for index in range(round_count):
        bench.skip_to_test_round(bench.draw_observation)
        scale = ALPHA_SCALES[index % len(ALPHA_SCALES)]
        bench.play_test_round("one of many re-estimates", _draw_distant_estimates_of_scale(bench, scale))
        bench.play_tick(bench.draw_observation())


def _draw_distant_estimates_of_scale(bench: Bench, scale: tuple[int, int]) -> list[NeighbourEstimate]:
    """Draw estimates far from the controller's own, with confidences of a scale, as in ``ALPHA_SCALES``."""
    distant_estimates = _draw_distant_estimates(bench)
    alphas = draw_alphas_of_one_scale(bench.rng, len(distant_estimates), scale)
    return [estimate._replace(alpha=alpha) for estimate, alpha in zip(distant_estimates, alphas, strict=True)]


def play_rounds_without_test(bench: Bench) -> None:
    """Play a test's round with too few estimates for it, and rounds without a test before and after that.

    A test would reject all these estimates, so that one that is run in the wrong round, or with too few
    messages, shows. Estimates with a confidence of 0 do not count; the adaptive filter needs two others, and
    the filter that re-estimates always needs one.
    """
    bench.activity = _MANY_OBSERVATIONS
    bench.skip_to_test_round(bench.draw_observation, rounds_before=1)
    bench.play_round("a round before that of the test", _draw_distant_estimates(bench))
    too_few_estimates = _draw_too_few_estimates(bench)
    bench.play_test_round("too few messages with a confidence above 0 for a test", too_few_estimates)
    for _ in range(2):
        bench.play_round("a round after that of the test", _draw_distant_estimates(bench))


def _draw_distant_estimates(bench: Bench) -> list[NeighbourEstimate]:
    """Draw four estimates so far from the controller's own that a test rejects them."""
    return draw_distant_estimates(bench.robot_state, bench.rng)


def _draw_too_few_estimates(bench: Bench) -> list[NeighbourEstimate]:
    """Draw distant estimates for a round in which the controller's filter must not test or re-estimate.

    None of them has confidence, except for the first one if the filter is adaptive.
    """
    with_confidence = _draw_distant_estimates(bench)
    without_confidence = [estimate._replace(alpha=0) for estimate in _draw_distant_estimates(bench)]
    if bench.config.filter is Filter.ADAPTIVE:
        return [with_confidence[0], *without_confidence]
    return without_confidence


def re_estimate_to_each_kind(bench: Bench) -> None:
    """Let the controller re-estimate b_hat to every kind of value in ``Update`` but 1/2 and almost 1/2.

    These two follow only if about half of the observed tiles are black; here more are.
    """
    state = bench.model_state
    bench.activity = "more black tiles, for a b_hat that is off 1/2"
    while 20 * state.n < 11 * state.t:  # the share of black ones, n / t, is below 11/20
        bench.skip_ticks(BURST, lambda: Observation.BLACK)
    for update in Update:
        if update not in _NEAR_HALF:
            _play_update(bench, update)


def play_without_filter(bench: Bench) -> None:
    """Play five rounds of estimates far from the robot's own, in a robot whose filter is off.

    If the filter period is up to LONG_RUN ticks, the robot first observes until the round at whose end a
    filter would test, which is the first of the five. A controller that filters nevertheless would change its
    b_hat there, and so differ from the model.
    """
    if bench.setup.filter_period <= LONG_RUN:
        bench.activity = _MANY_OBSERVATIONS
        bench.skip_to_test_round(bench.draw_observation)
    for _ in range(5):
        bench.play_round("messages far away", _draw_distant_estimates(bench))


def halve_memory(bench: Bench) -> None:
    """Fill the memory four times: n has the remainder 1, 3, 0 and 2 modulo 4.

    When t, the number of observations, reaches ``memory``, the controller halves t and n. The half of an n
    with remainder 1 is rounded down, to an even number. With remainder 3 it is rounded up. Other halves are
    exact. The last four observations give n its remainder: black ones until n has it, and then white ones.
    If fewer than four observations are missing at the beginning, the memory is filled once more before that.
    """
    state = bench.model_state
    t_before_last_four = bench.config.memory - 4
    bench.activity = "observations until the memory is halved"
    # Fewer than four are missing now, so these fill the memory once more.
    while state.t > t_before_last_four:
        bench.play_tick(bench.draw_observation())
    for remainder in (1, 3, 0, 2):
        bench.skip_ticks(t_before_last_four - state.t, bench.draw_observation)
        for _ in range(4):
            is_black = state.n % 4 != remainder
            bench.play_tick(Observation(is_black))  # The fourth of these halves t and n.


def observe_long(bench: Bench) -> None:
    """Let the controller make 20,000 observations in all, so that a memory that is too short shows.

    It makes at least 16 more, even if it has made as many in earlier phases.
    """
    bench.activity = _MANY_OBSERVATIONS
    missing_observations = LONG_RUN - bench.model_state.t
    bench.skip_ticks(max(missing_observations, BURST), bench.draw_observation)


# --- Steps ---


def _observe_until_filter_runs(bench: Bench) -> None:
    """Let the controller observe, at least once, until the round begins at whose end its filter runs next."""
    bench.activity = _MANY_OBSERVATIONS  # named by the progress, and by a difference that shows meanwhile
    # A b_hat that the last round has changed enters x_hat with the next observation, so that it shows.
    bench.play_tick(bench.draw_observation())
    bench.skip_to_test_round(bench.draw_observation)


def _play_test_round(bench: Bench, activity: str, estimates: Sequence[NeighbourEstimate]) -> None:
    """Play the round of the next test with these estimates, and then a round of others without a test.

    The other estimates are drawn, and come from the same senders. A new round must count these senders again.
    """
    senders = bench.rng.sample(bench.other_ids, len(estimates))
    bench.play_test_round(activity, estimates, senders)
    other_estimates = [draw_estimate(bench.rng) for _ in senders]
    bench.play_round(f"{activity}; then others of the same senders", other_estimates, senders)


def _play_update(bench: Bench, update: Update) -> None:
    """Play a round after which b_hat is re-estimated to a value of this kind.

    Estimates that lead to it are searched for up to four times. After each search in vain a round of distant
    estimates brings about another re-estimate, which changes the robot's state. If all searches are in vain,
    this is noted as a case that was not exercised.
    """
    activity = f"a round for a re-estimate: {update.value}"
    for _ in range(_MAX_ATTEMPTS_TO_UPDATE):
        if update in _NEAR_HALF:
            bench.skip_to_test_round()  # observations would change the share of black tiles
        else:
            _observe_until_filter_runs(bench)
        estimates = draw_round_for_update(bench.robot_state, update, bench.rng)
        if estimates is not None:
            _play_test_round(bench, activity, estimates)
            return
        bench.play_test_round(activity, _draw_distant_estimates(bench))
    bench.not_exercised.append(f"a re-estimate: {update.value}")
