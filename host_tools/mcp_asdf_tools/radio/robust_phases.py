"""Phases that put the robust filter to the test: voices, votes, its test, the way back, a moving crowd.

Each estimate with a confidence above 0 is a vote for its x_hat. The crowd summarises the votes: their centre,
in units of 2**-30, their spread, the median of their distances from it, and the number of votes, with which
the gain falls, the share of its distance by which a vote moves the centre. Its voices are the senders, modulo
32; at least three are needed for a test. Its trend is the share of the centre's recent moves that went up, in
units of 2**-16: near 0 or 1 the crowd moves. Then there is no test, but the votes are halved, so that the
gain comes back.

The test rejects the initial b_hat, the accuracy that the robot assumed at its start, if that and the centre
predict another share of black than the robot has observed. If it does not, b_hat goes back to the initial
one.

What is sent depends on the model's state, so that one vote or one observation makes the difference.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from copy import copy
from dataclasses import dataclass

from mcp_asdf.fixed_point import ALPHA_MAX, HALF, ONE
from mcp_asdf.mirror import (
    CENTRE_START,
    INFORMATIVE_G,
    Q32_HALF,
    SPREAD_MIN,
    TREND_MOVING_DOWN,
    TREND_MOVING_UP,
    VOTES_MAX,
    VOTES_MIN_WHILE_MOVING,
    Crowd,
    MirrorRobot,
    q23_from_q30,
    q30_from_q23,
    robust_test_rejects,
)
from mcp_asdf.robot import Observation
from mcp_asdf_tools.crosscheck.crafted_rounds import ALPHA_LEAST, NeighbourEstimate, draw_normal_alpha
from mcp_asdf_tools.radio.bench import BURST, Bench
from mcp_asdf_tools.radio.crowd_votes import (
    MAX_VOTES_IN_ROUND,
    count_votes_until_moving,
    crowd_after,
    moves_to_trend,
    q23_from_q30_rounded_up,
    votes_of_moves,
    votes_to_centre,
    votes_to_threshold,
)
from mcp_asdf_tools.radio.filter_phases import count_updates_to_check

_CENTRE_HALF, _CENTRE_QUARTER = CENTRE_START, CENTRE_START // 2
"""1/2 and 1/4 in units of 2**-30, as centres have them."""
_MAX_OBSERVATIONS = 10_000
"""Observations with which a threshold of the test is looked for."""
_MAX_ROUNDS = 120
"""Rounds in which the crowd is brought to some state."""
_ROUNDS_AT_SPREAD_MIN = 8
"""Rounds after it has the least spread, in which a spread without a limit would shrink on."""
_MAX_OBSERVATIONS_NEAR_THRESHOLD = 30
"""Observations with which the test's threshold is approached, from nearby."""
_VOTES_TO_MOVE = 360
"""Votes for one side after which a crowd that has been balanced moves."""
_SPREAD_AT_HALF = 1 << 24
"""Spread with which some votes move the centre by 2**17, and which hardly changes the test."""
_TREND_LIMITS = (TREND_MOVING_DOWN, TREND_MOVING_DOWN - 1, TREND_MOVING_UP - 1, TREND_MOVING_UP)
"""Trends on both sides of each limit: the first and the third are of a crowd that stays."""
_CENTRE_INFORMATIVE_DISTANCE = INFORMATIVE_G >> 3
"""Distance of the centre from 1/2 from which on it carries information, in units of 2**-30."""
_VOTES_THAT_ARE_HALVED = 2 * VOTES_MIN_WHILE_MOVING
"""Fewest votes that are halved while the crowd moves."""
MODERATE_SPREAD = 1 << 26
"""1/16, with which there are counts of black tiles to reject any accuracy."""
LEAST_SPREAD = SPREAD_MIN


def vote_with_few_voices(bench: Bench) -> None:
    """Vote with two voices, too few for a test but not for halving the votes, and then with a third.

    A voice is all senders whose ids are equal modulo 32. Those of the first and the third are equal modulo
    16, and the bits of all three are at the ends of the two halves of a word.
    """
    crowd = bench.firmware.s.crowd
    first_ids = [robot for robot in bench.other_ids if robot % 32 == 15]
    second_ids = [robot for robot in bench.other_ids if robot % 32 == 0]
    third_ids = [robot for robot in bench.other_ids if robot % 32 == 31]
    two_voices = first_ids + second_ids
    _cast_first_votes(bench, first_ids[0])
    bench.activity = "votes of robots whose ids modulo 32 are two"
    # Most tiles were black, so an accuracy of 1/2 or more contradicts a crowd at 0, a smaller one that at 1.
    end = 0 if crowd.first >= Q32_HALF else ONE

    def vote_for_end() -> None:
        _vote(bench, [end] * len(two_voices), two_voices)

    for _ in range(2):
        vote_for_end()
    _repeat_until(bench, "two voices", lambda: _is_rejected(bench), vote_for_end)
    _play_test(bench)
    _halve_votes_of_two_voices(bench, two_voices, end)
    bench.activity = "votes of two voices for the other side"
    _repeat_until(
        bench,
        "a crowd of two voices that stays",
        lambda: not crowd.is_moving,
        lambda: _vote(bench, [ONE - end], two_voices[:1]),
    )
    bench.activity = "a vote of a third"
    _vote(bench, [ONE - end], third_ids[:1])
    _play_test(bench)


def _cast_first_votes(bench: Bench, sender: int) -> None:
    """Observe many black tiles, send estimates that are no votes, and then the first vote."""
    state = bench.firmware.s
    bench.activity = "many black tiles"
    while 8 * state.n < 7 * state.t:
        bench.skip_ticks(BURST, lambda: Observation.BLACK)
    bench.activity = "confidences of 0 before the first vote"
    bench.play_round(*(NeighbourEstimate(x_hat, 0) for x_hat in (ONE, ONE, 0)))
    bench.activity = "the first vote, as far from the centre as the spread"
    bench.play_round(NeighbourEstimate(ONE - HALF // 2, ALPHA_MAX), senders=[sender])


def _halve_votes_of_two_voices(bench: Bench, two_voices: Sequence[int], end: int) -> None:
    """Cast many votes of two voices, at first for both sides and then for ``end``, and let them be halved."""
    crowd, vote_count = bench.firmware.s.crowd, 2 * _VOTES_THAT_ARE_HALVED
    bench.activity = "votes of two voices, for one side in the end"
    pair_count = len(two_voices) // 2
    while crowd.votes < vote_count - _VOTES_TO_MOVE:
        _vote(bench, [0, ONE] * pair_count, two_voices[: 2 * pair_count])
    while crowd.votes < vote_count:
        # With frequent tests the votes are halved as soon as the crowd moves, and never become so many.
        if crowd.is_moving and bench.setup.filter_period < BURST:
            break
        senders = two_voices[: vote_count - crowd.votes]
        _vote(bench, [end] * len(senders), senders)
    _halve_votes_to_minimum(bench)


def vote_at_spread(bench: Bench) -> None:
    """Cast votes at the spread's distance from the centre, and one unit farther, above it and below it.

    Votes inside narrow the spread and those outside widen it. Four votes for the far end follow each: their
    steps show what became of the spread. Confidences alternate between the largest and the least, as votes do
    not depend on them.
    """
    for is_above in (True, False, True, False):
        for is_outside in (False, True):
            crowd = bench.firmware.s.crowd
            # The farthest x_hat that is at most a spread away, so it is rounded towards the centre: down
            # above it, and up below it.
            if is_above:
                x_hat = q23_from_q30(crowd.centre + crowd.spread) + is_outside
            else:
                x_hat = q23_from_q30_rounded_up(crowd.centre - crowd.spread) - is_outside
            far_end = 0 if is_above else ONE
            bench.activity = f"a vote just {'outside' if is_outside else 'inside'} the spread"
            x_hats = [min(max(x_hat, 0), ONE)] + [far_end] * 4
            alphas = [ALPHA_MAX, ALPHA_LEAST, ALPHA_MAX, ALPHA_LEAST, ALPHA_MAX]
            bench.play_round(*map(NeighbourEstimate, x_hats, alphas))


def moving_phase(end: int) -> Callable[[Bench], None]:
    """Return a phase that votes for ``end``, an x_hat of 0 or ONE, until the crowd counts as moving.

    The filter runs one vote before that, when it still tests, and with that vote, when it no longer does.
    Then it runs until it has halved the votes to the minimum, and once with one vote less than it halves.
    """

    def play(bench: Bench) -> None:
        crowd = bench.firmware.s.crowd
        bench.activity = "votes for one side"
        count = count_votes_until_moving(crowd, end) - 1
        for start in range(0, count, MAX_VOTES_IN_ROUND):
            _vote(bench, [end] * min(count - start, MAX_VOTES_IN_ROUND))
        _play_test(bench)
        if crowd.spread < MODERATE_SPREAD and not _is_rejected(bench):
            bench.play_tick(_observe_up_to_decision(bench, is_rejection=True))
        bench.activity = "the vote with which the crowd moves"
        _vote(bench, [end])
        _play_test(bench)
        bench.activity = "votes after the crowd has moved"
        _vote(bench, [ONE - end] * 5)
        bench.activity = "votes until the crowd moves on"
        for _ in range(_MAX_ROUNDS):
            if crowd.is_moving:
                break
            _vote(bench, [end] * 5)
        _halve_votes_to_minimum(bench)
        bench.activity = "one vote less than are halved"
        while crowd.votes < _VOTES_THAT_ARE_HALVED - 1:
            missing_votes = _VOTES_THAT_ARE_HALVED - 1 - crowd.votes
            _vote(bench, [end] * min(missing_votes, MAX_VOTES_IN_ROUND))
        _play_test(bench)
        _vote(bench, [ONE - end] * 5)

    return play


def reach_trend_limits(bench: Bench) -> None:
    """Run the filter on crowds whose trend is at one of its limits, 1/8 and 7/8, or one unit beside it.

    Votes that move the centre up or down bring the trend to each of these. A trend that no votes reach is
    noted as not exercised.
    """
    crowd = bench.firmware.s.crowd
    for trend in _TREND_LIMITS:
        bench.activity = f"votes to a trend of {trend}"
        if crowd.votes < _VOTES_THAT_ARE_HALVED:
            for _ in range(3):
                _vote(bench, [ONE, 0] * (MAX_VOTES_IN_ROUND // 2))
        is_away_from_ends = _CENTRE_QUARTER < crowd.centre < 3 * _CENTRE_QUARTER
        if not is_away_from_ends:
            _repeat_until(
                bench,
                "a crowd in the middle",
                lambda: _is_near_half_and_stays(crowd),
                lambda: _vote(bench, [HALF] * MAX_VOTES_IN_ROUND),
            )
        moves = moves_to_trend(crowd.trend, trend)
        if moves is None:
            bench.not_exercised.append(bench.activity)
            continue
        for start in range(0, len(moves), MAX_VOTES_IN_ROUND):
            _vote(bench, votes_of_moves(crowd, moves[start : start + MAX_VOTES_IN_ROUND]))
        assert crowd.trend == trend, (crowd, trend)
        bench.activity = f"a test at a trend of {trend}"
        _play_test(bench)
        # Where no test shows by a new b_hat, the halved votes show by the next steps.
        bench.activity = f"votes after a test at a trend of {trend}"
        _vote(bench, [0, ONE, 0])


def reject_near_half(bench: Bench) -> None:
    """Let the test reject with a centre that carries just enough information, or just too little, or at 1/2.

    The first two are played on either side of 1/2. A centre that votes do not reach ends the phase, and is
    noted as not exercised.
    """
    state = bench.firmware.s
    crowd = state.crowd
    # As many of these votes are above 1/2 as below, and those at 1/2 bring the centre there.
    distance = q23_from_q30(_SPREAD_AT_HALF)
    x_hats = [HALF - distance, HALF, HALF + distance] * (MAX_VOTES_IN_ROUND // 3)

    def is_crowd_at_half() -> bool:
        is_centre_near = abs(crowd.centre - _CENTRE_HALF) < _SPREAD_AT_HALF >> 3
        is_spread_small = crowd.spread < 2 * _SPREAD_AT_HALF
        has_many_votes = crowd.votes >= _VOTES_THAT_ARE_HALVED
        return is_centre_near and is_spread_small and has_many_votes and _is_near_half_and_stays(crowd)

    limit = _CENTRE_INFORMATIVE_DISTANCE
    # One unit nearer to 1/2 above, and one unit farther away below, is on the other side of the limit.
    for offset in (limit, limit - 1, -limit, -limit - 1, 0):
        bench.activity = "votes around 1/2"
        _repeat_until(bench, "a crowd at 1/2", is_crowd_at_half, lambda: _vote(bench, x_hats))
        if not _observe_until_rejected(bench):
            return
        bench.activity = f"a test with a centre {offset} units from 1/2"
        final_x_hats = votes_to_centre(crowd, _CENTRE_HALF + offset)
        if final_x_hats is None:
            bench.not_exercised.append(bench.activity)
            return
        # The final votes bring the centre nearer to the observed share, and the test may then no longer
        # reject. More observations of the colour that is seen more often take the share away from it.
        crowd_at_test = crowd_after(crowd, final_x_hats)
        while not robust_test_rejects(crowd_at_test, state.t, state.n):
            bench.play_tick(Observation(2 * state.n > state.t))
        bench.skip_to_test_round()
        _vote(bench, final_x_hats)


def threshold_phase(max_spread: int) -> Callable[[Bench], None]:
    """Return a phase that plays the robust filter's test on both sides of its threshold.

    The phase is a function that plays it on the bench of a controller. First it sends votes, estimates with
    confidence, until the spread of the crowd, their summary, is at most ``max_spread`` in units of 2**-30.
    Then it crosses the threshold up to eight times. By turns the test just rejects, so that b_hat, the
    accuracy that the robot assumes, is re-estimated, and just does not reject, so that the initial b_hat
    comes back. What cannot be brought about is noted as not exercised.
    """
    has_least_spread = max_spread == LEAST_SPREAD

    def play(bench: Bench) -> None:
        crowd = bench.firmware.s.crowd
        # A crowd that predicts the count as it is needs the fewest observations to a threshold.
        predicting_x_hat = _x_hat_that_predicts_count(bench)

        def is_near_predicting_x_hat() -> bool:
            return abs(crowd.centre - q30_from_q23(predicting_x_hat)) < MODERATE_SPREAD

        def vote_around(centre: int, width: int) -> None:
            x_hats = [centre + bench.rng.randint(-width, width) for _ in range(MAX_VOTES_IN_ROUND)]
            _vote(bench, [min(max(x_hat, 0), ONE) for x_hat in x_hats])

        def agree() -> None:
            vote_around(q23_from_q30(crowd.centre), q23_from_q30(max_spread))

        bench.activity = "votes from both sides"
        _repeat_until(
            bench,
            "a crowd in the middle",
            lambda: is_near_predicting_x_hat() and _has_balanced_trend(crowd),
            lambda: vote_around(predicting_x_hat, ONE // 4),
        )
        bench.activity = "votes that agree"
        _repeat_until(bench, f"a spread of {max_spread / 2**30:g}", lambda: crowd.spread <= max_spread, agree)
        # A spread that is not limited to the least one would go on to shrink in these rounds.
        if has_least_spread:
            for _ in range(_ROUNDS_AT_SPREAD_MIN):
                agree()
        # Each call crosses it four times. The second approaches the rejections by the other colour, but with
        # the least spread by the same one again.
        _cross_threshold(bench, is_towards_rarer_colour=True)
        _cross_threshold(bench, is_towards_rarer_colour=not has_least_spread)

    return play


def reject_often(bench: Bench) -> None:
    """Let the test reject so often that a controller shows whose counter of updates has too few bits."""
    if not _observe_until_rejected(bench):
        return
    bench.activity = "one of many re-estimates"
    missing_updates = count_updates_to_check(bench.setup) - bench.firmware.s.updates
    for _ in range(max(missing_updates, 1)):
        _play_test(bench)


def vote_often(bench: Bench) -> None:
    """Cast twice as many votes as are counted, for both sides, and then a round for one side."""
    bench.activity = "many votes"
    for _ in range(2 * VOTES_MAX // MAX_VOTES_IN_ROUND + 1):
        _vote(bench, [0, ONE] * (MAX_VOTES_IN_ROUND // 2))
    bench.activity = "votes with the least gain"
    _vote(bench, [ONE] * MAX_VOTES_IN_ROUND)


# --- Steps ---


def _vote(bench: Bench, x_hats: Sequence[int], senders: Sequence[int] | None = None) -> None:
    """Play a round of votes for these x_hat, of these senders or, by default, of random ones."""
    estimates = [NeighbourEstimate(x_hat, draw_normal_alpha(bench.rng)) for x_hat in x_hats]
    bench.play_round(*estimates, senders=senders)


def _play_test(bench: Bench) -> None:
    """Skip ticks until the round of the next test, and play that round without votes."""
    bench.skip_to_test_round()
    bench.play_round()


def _repeat_until(
    bench: Bench, goal: str, is_reached: Callable[[], bool], play_step: Callable[[], None]
) -> None:
    """Repeat a step until a goal is reached, or for many rounds; then the goal is noted as not exercised."""
    for _ in range(_MAX_ROUNDS):
        if is_reached():
            return
        play_step()
    bench.not_exercised.append(goal)


def _halve_votes_to_minimum(bench: Bench) -> None:
    """Let tests pass while the crowd moves until the votes are halved no more, and then vote once."""
    crowd = bench.firmware.s.crowd
    bench.activity = "tests while the crowd moves"
    for _ in range(VOTES_MAX.bit_length()):
        if not crowd.is_moving or crowd.votes < _VOTES_THAT_ARE_HALVED:
            break
        _play_test(bench)
    _play_test(bench)
    bench.activity = "a vote after the votes were halved"
    _vote(bench, [ONE if crowd.centre < _CENTRE_HALF else 0], bench.other_ids[:1])


# --- The test and its threshold ---


def _is_rejected(bench: Bench, z: Observation | None = None) -> bool:
    """Return whether the test would reject now or, with ``z``, after that observation."""
    state = bench.firmware.s
    if z is not None:
        robot = _copy_for_observing(bench.firmware)
        robot.observe(z)
        state = robot.s
    return robust_test_rejects(state.crowd, state.t, state.n)


def _copy_for_observing(firmware: MirrorRobot) -> MirrorRobot:
    """Return a copy of a robot that may observe by itself, but shares the crowd with ``firmware``."""
    robot = MirrorRobot.__new__(MirrorRobot)
    robot.config, robot.s = firmware.config, copy(firmware.s)
    return robot


def _observe_until_rejected(bench: Bench) -> bool:
    """Observe one colour until the test would reject; returns whether it does in the end."""
    bench.activity = "observations until the test rejects"
    while not _is_rejected(bench):
        last_observation = _observe_up_to_decision(bench, is_rejection=True)
        if last_observation is None:
            return False
        bench.play_tick(last_observation)
    return True


def _observe_up_to_decision(
    bench: Bench, is_rejection: bool, is_towards_rarer_colour: bool = True
) -> Observation | None:
    """Observe one colour until one more observation makes the test reject or, with False, not reject.

    Returns that observation, which is not made. Returns None, and notes this as not exercised, if it does not
    come. Towards a rejection the colour is that which the crowd predicts less often, or the other one if
    ``is_towards_rarer_colour`` is False; otherwise it is that which is missing.
    """
    state = bench.firmware.s
    fill_ratio, b_hat = state.crowd.centre / 2**30, state.crowd.first / 2**32
    predicted_share = b_hat * fill_ratio + (1 - b_hat) * (1 - fill_ratio)
    if is_rejection:
        is_black_rarer = predicted_share < 0.5
        colour = Observation(is_black_rarer == is_towards_rarer_colour)
    else:
        colour = Observation(state.n < predicted_share * state.t)
    for _ in range(_MAX_OBSERVATIONS):
        if _is_rejected(bench, colour) is is_rejection:
            return colour
        bench.play_tick(colour)
    decision = "rejects" if is_rejection else "does not reject"
    bench.not_exercised.append(f"{bench.activity}: a test that {decision}")
    return None


def _cross_threshold(bench: Bench, is_towards_rarer_colour: bool) -> None:
    """Play tests just before their threshold and just behind it, and back again.

    Observations come near the threshold, and votes then move the centre to it, by a unit of 2**-30.
    """
    is_rejected_at_start = _is_rejected(bench)
    for is_rejection in (not is_rejected_at_start, is_rejected_at_start) * 2:
        bench.activity = "observations of one colour"
        if _is_rejected(bench) != is_rejection:
            last_observation = _observe_up_to_decision(bench, is_rejection, is_towards_rarer_colour)
            if last_observation is None:
                return
            bench.play_tick(last_observation)
        bench.activity = "observations and votes towards the threshold of the test"
        approach = _choose_approach(bench, is_rejection)
        if approach is not None:
            for z in approach.observations:
                bench.play_tick(z)
        bench.activity = "a test that " + ("just rejects" if is_rejection else "just does not reject")
        bench.skip_to_test_round()
        _vote(bench, approach.x_hats if approach is not None else [])


@dataclass(frozen=True)
class Approach:
    """A way to the threshold of the test.

    Attributes:
        observations: Observations to make first.
        x_hats: Votes after which the centre is the last one, or the first, that the test rejects.
        shown_mistakes: Number of known mistakes with which a controller would decide otherwise there.
    """

    observations: list[Observation]
    x_hats: list[int]
    shown_mistakes: int


def _choose_approach(bench: Bench, is_rejection: bool) -> Approach | None:
    """Return the approach that shows most mistakes that no frame has shown so far; None if there is none.

    At its end the test just rejects or, if ``is_rejection`` is False, just does not.
    """
    best: Approach | None = None
    for observations in _observations_that_keep_share(bench):
        robot = _copy_for_observing(bench.firmware)
        for z in observations:
            robot.observe(z)
        state = robot.s
        x_hats = votes_to_threshold(state.crowd, state.t, state.n, is_rejection)
        if x_hats is None:
            continue
        crowd = crowd_after(state.crowd, x_hats)
        decisions = [rules.rejects(crowd, state.t, state.n) for rules in bench.mistaken_models.robust_rules]
        approach = Approach(observations, x_hats, shown_mistakes=decisions.count(not is_rejection))
        if best is None or approach.shown_mistakes > best.shown_mistakes:
            best = approach
    return best


def _observations_that_keep_share(bench: Bench) -> Iterator[list[Observation]]:
    """Yield lists of up to 29 observations, which leave the share of black ones nearly as it is."""
    state = bench.firmware.s
    for count in range(_MAX_OBSERVATIONS_NEAR_THRESHOLD):
        proportional_count = count * state.n // state.t
        # One more or less, too, as far as there are so many observations. A set, so that none comes twice.
        one_less, one_more = max(proportional_count - 1, 0), min(proportional_count + 1, count)
        for black_count in {one_less, proportional_count, one_more}:
            yield [Observation.BLACK] * black_count + [Observation.WHITE] * (count - black_count)


def _x_hat_that_predicts_count(bench: Bench) -> int:
    """Return an x_hat that predicts the observed share of black, from 1/4 to 3/4 but not near 1/2."""
    state = bench.firmware.s
    if state.crowd.first == Q32_HALF:
        return HALF + ONE // 8  # a b_hat of 1/2 predicts the same whatever x_hat is
    b_hat, observed_share = state.crowd.first / 2**32, state.n / max(state.t, 1)
    x_hat = round((observed_share + b_hat - 1) / (2 * b_hat - 1) * ONE)
    x_hat = min(max(x_hat, ONE // 4), 3 * ONE // 4)
    return x_hat if abs(x_hat - HALF) > ONE // 16 else HALF + ONE // 8


def _is_near_half_and_stays(crowd: Crowd) -> bool:
    """Return whether the centre is less than 1/4 from 1/2, and the trend balanced."""
    return abs(crowd.centre - _CENTRE_HALF) < _CENTRE_QUARTER and _has_balanced_trend(crowd)


def _has_balanced_trend(crowd: Crowd) -> bool:
    """Return whether over a quarter of the centre's recent moves went up, and over a quarter down."""
    quarter = 1 << 14  # in units of 2**-16
    return quarter < crowd.trend < 3 * quarter
