"""The robust filter in plain equations: its steps, in floats and in exact fractions."""

from __future__ import annotations

import random
from fractions import Fraction

import pytest

from mcp_asdf.reference import ReferenceRobot
from mcp_asdf.robot import Config, Filter, Observation, Status
from mcp_asdf.robust_reference import (
    Observations,
    RobustReference,
    Votes,
    dispersion_after_batch,
    huber_centre,
    huber_step,
    is_supported,
    robust_test_sides,
    spread_around,
    votes_after,
)
from robots import OWN_ID, observe_tiles, receive_estimates

ROUNDING = Fraction(1, 2**53)
"""The largest error of one rounding to float64, relative to the result."""

# --- Votes -----------------------------------------------------------------------------------------------


def test_a_vote_at_the_spread_moves_the_centre_up_and_narrows_the_spread() -> None:
    """A vote is what a neighbour estimates. Votes have a running centre, and a spread: their usual distance.

    Centre and spread are 0.5 and 0.25. A vote of 0.75 moves the centre by an eighth of the spread, and the
    spread shrinks by a sixteenth.
    """
    votes = votes_after(Votes(centre=0.5, spread=0.25, count=0), x_hat=0.5 + 0.25)
    assert votes == Votes(centre=0.5 + 0.25 / 8, spread=0.25 - 0.25 / 16, count=1)


def test_a_vote_beyond_the_spread_moves_the_centre_by_the_spread_alone_and_widens_the_spread() -> None:
    """The vote, 0.0, is four spreads below the centre, and counts as if it were one spread below.

    So the centre moves down by an eighth of the spread, which itself grows by a sixteenth.
    """
    votes = votes_after(Votes(centre=0.5, spread=0.125, count=0), x_hat=0.0)
    assert votes.centre == 0.5 - 0.125 / 8
    assert votes.spread == 0.125 + 0.125 / 16


@pytest.mark.parametrize(
    ("earlier_votes", "gain"),
    [(0, 2**-3), (62, 2**-3), (63, 2**-4), (126, 2**-4), (127, 2**-5), (511, 2**-7)],
)
def test_the_gain_falls_with_the_number_of_votes(earlier_votes: int, gain: float) -> None:
    """A vote moves the centre by a part of the spread, the gain. It changes the spread by half as much.

    The vote is a spread above the centre.
    """
    votes = votes_after(Votes(centre=0.5, spread=0.25, count=earlier_votes), x_hat=0.75)
    assert votes.centre == 0.5 + 0.25 * gain
    assert votes.spread == 0.25 - 0.25 * gain / 2


def test_votes_are_counted_up_to_512() -> None:
    """A vote weighs the less, the more were counted. So the weight of a vote never falls to 0."""
    votes_512 = votes_after(Votes(centre=0.5, spread=0.25, count=511), x_hat=0.5)
    assert votes_512.count == 512

    votes_with_one_more = votes_after(votes_512, x_hat=0.5)
    assert votes_with_one_more.count == 512


@pytest.mark.parametrize(("limit", "vote"), [(0.25, 1.0), (2**-12, 0.5)], ids=["largest", "smallest"])
def test_the_spread_of_votes_stays_within_its_limits(limit: float, vote: float) -> None:
    """The spread is the usual distance of votes from their centre, here 0.5: at most 1/4, at least 2**-12.

    A vote of 1 would widen the largest spread, and one at the centre narrow the smallest.
    """
    votes = votes_after(Votes(centre=0.5, spread=limit, count=0), x_hat=vote)
    assert votes.spread == limit


def draw_votes(rng: random.Random) -> Votes[float]:
    """Draw a centre and a spread of votes anywhere in their ranges, and how many votes there were."""
    return Votes(centre=rng.random(), spread=2 ** rng.uniform(-12, -2), count=rng.randrange(513))


def test_votes_in_float64_are_right_to_the_last_bits() -> None:
    """The same function computes both in exact fractions. They differ by one rounding at most."""
    rng = random.Random(23)
    for _ in range(500):
        before = draw_votes(rng)
        vote = rng.choice([0.0, 1.0, before.centre, rng.random()])

        after = votes_after(before, vote)

        exact_before = Votes(Fraction(before.centre), Fraction(before.spread), before.count)
        exact_after = votes_after(exact_before, Fraction(vote))
        assert abs(Fraction(after.centre) - exact_after.centre) <= ROUNDING, (before, vote)
        assert abs(Fraction(after.spread) - exact_after.spread) <= ROUNDING, (before, vote)


def test_neighbours_vote_in_the_order_of_their_slots_and_the_robot_itself_after_them() -> None:
    """Slots 9 and 2 have estimates. After the vote of slot i the turn is i + 1, after the robot's own 0."""
    robust = RobustReference(initial_b_hat=0.75, estimates={9: 1.0, 2: 0.0})

    turns = []
    for _ in range(4):
        robust.take_vote(own_x_hat=0.5, has_confidence=True)
        turns.append(robust.turn)

    after_slot_2, after_slot_9, after_the_robot = 3, 10, 0
    assert turns == [after_slot_2, after_slot_9, after_the_robot, after_slot_2]


def test_the_robot_s_own_estimate_is_a_vote_like_the_others() -> None:
    """It is the turn of slot 10. Slots 10 to 31 have no estimate, so the robot itself votes 0.75.

    The centre of the votes is 0.5 at first, their spread 0.25. They change by 1/8 and 1/16 of the spread.
    """
    robust = RobustReference(initial_b_hat=0.75, estimates={9: 1.0}, turn=10)
    robust.take_vote(own_x_hat=0.75, has_confidence=True)
    assert robust.votes == Votes(centre=0.5 + 0.25 / 8, spread=0.25 - 0.25 / 16, count=1)


def test_the_slot_whose_turn_it_is_votes() -> None:
    """The estimate in slot 2, 0.5, does not move the centre, now 0.5. The estimate in slot 9 would."""
    robust = RobustReference(initial_b_hat=0.75, estimates={2: 0.5, 9: 1.0}, turn=2)

    robust.take_vote(own_x_hat=0.5, has_confidence=True)

    assert robust.votes.centre == 0.5
    assert robust.turn == 3


def test_a_robot_without_confidence_does_not_vote() -> None:
    """Slot 9 has voted, so the robot would be next. Slot 2 votes instead: 0.0, below the centre, 0.5.

    So the centre moves down, by an eighth of the spread, 0.25.
    """
    robust = RobustReference(initial_b_hat=0.75, estimates={9: 1.0, 2: 0.0}, turn=10)

    robust.take_vote(own_x_hat=0.5, has_confidence=False)

    assert robust.votes.centre == 0.5 - 0.25 / 8
    assert robust.turn == 3


def test_senders_with_ids_equal_modulo_32_share_a_slot() -> None:
    """A robot has 32 slots for estimates. Senders 1 and 33 share slot 1, and the last estimate stays."""
    robust = RobustReference(initial_b_hat=0.75)

    robust.keep_estimate(sender=1, x_hat=0.25)
    robust.keep_estimate(sender=33, x_hat=0.75)

    assert robust.estimates == {1: 0.75}


# --- Dispersion ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("batch_black_count", "expected_dispersion"),
    [
        (50, 7 / 8 * 2),  # what was to be expected
        (60, 7 / 8 * 2 + 2**2 / 8),  # two standard deviations more
        (100, 7 / 8 * 2 + 12 * 2 / 8),  # ten standard deviations, which count as 12 times the dispersion
    ],
)
def test_a_batch_moves_the_dispersion_by_an_eighth(
    batch_black_count: int, expected_dispersion: float
) -> None:
    """The dispersion says how much more batches of tiles vary than independent ones would; here it is 2.

    Half of 1000 tiles are black. The batch is the last 100 of them, so that their standard deviation is 5.
    The new dispersion has 7/8 of the old one and 1/8 of the batch's squared deviation in variances.
    """
    observations = Observations(n=500, t=1000, dispersion=2.0)
    dispersion = dispersion_after_batch(observations, batch_black_count, batch_count=100)
    assert dispersion == expected_dispersion


def test_the_dispersion_does_not_fall_below_1() -> None:
    """The last 100 tiles are half black, exactly as all 1000 are."""
    observations = Observations(n=500, t=1000, dispersion=1.0)
    dispersion = dispersion_after_batch(observations, batch_black_count=50, batch_count=100)
    assert dispersion == 1


def test_the_dispersion_does_not_rise_above_16_bits_of_the_firmware() -> None:
    """The firmware has units of 1/256. Here the last 500 tiles are black, and the 500 before them white.

    Of the last 500 half should be black, with a variance of 125. The number is 250 off, and 250**2 is 500
    variances. So the dispersion would rise from 250 to 7/8 * 250 + 500 / 8 = 281.
    """
    observations = Observations(n=500, t=1000, dispersion=250.0)
    dispersion = dispersion_after_batch(observations, batch_black_count=500, batch_count=500)
    assert dispersion == (2**16 - 1) / 256


@pytest.mark.parametrize(("n", "batch_count"), [(0, 100), (1000, 100), (500, 0)])
def test_a_batch_without_deviation_leaves_the_dispersion(n: int, batch_count: int) -> None:
    """Where all tiles so far have one colour, or the batch is empty, there is no deviation to be measured.

    n of 1000 tiles are black, and the batch is the last ``batch_count`` of them.
    """
    observations = Observations(n=n, t=1000, dispersion=3.0)
    dispersion = dispersion_after_batch(observations, batch_black_count=0, batch_count=batch_count)
    assert dispersion == 3


def test_the_dispersion_is_computed_from_the_observations_since_the_last_batch() -> None:
    """The dispersion says how much more batches of tiles vary than independent ones would.

    Of the last 100 tiles 60 are black, and of all 1000 half: two standard deviations of 5 more. Their square,
    4 variances, counts an eighth, and the dispersion so far, 2, seven eighths.
    """
    robust = RobustReference(initial_b_hat=0.75, dispersion=2.0, batch_t=900, batch_n=440)

    robust.end_batch(n=500, t=1000)

    assert robust.dispersion == 7 / 8 * 2 + 1 / 8 * 4
    assert (robust.batch_t, robust.batch_n) == (1000, 500)


# --- The estimates in the slots --------------------------------------------------------------------------


def test_the_spread_of_estimates_is_their_median_distance() -> None:
    """The estimates are 0, 1/8, 1/4, 0 and 1/2 away from their median, 1/2. Of these 1/8 is in the middle."""
    spread = spread_around([0.5, 0.625, 0.25, 0.5, 1.0], middle=0.5)
    assert spread == 1 / 8


@pytest.mark.parametrize(
    ("estimates", "expected_spread"), [([0.5] * 5, 2**-12), ([0.0, 0.0, 0.5, 1.0, 1.0], 0.25)]
)
def test_the_spread_of_estimates_stays_within_its_limits(
    estimates: list[float], expected_spread: float
) -> None:
    """Median distances of 0 and 1/2 from the middle count as 2**-12 and 1/4."""
    assert spread_around(estimates, middle=0.5) == expected_spread


def test_an_outlier_moves_the_centre_by_the_spread_alone() -> None:
    """The outlier, 0.9, counts as if it were a spread away from the centre.

    So the mean of the four others moves by a quarter of the spread.
    """
    estimates = [0.4375, 0.4375, 0.5, 0.5, 0.9]
    mean_of_others = (0.4375 + 0.4375 + 0.5 + 0.5) / 4

    centre = huber_centre(estimates, middle=0.5, spread=0.0625)

    assert centre == mean_of_others + 0.0625 / 4


def test_the_centre_of_estimates_without_an_outlier_is_their_mean() -> None:
    """All estimates are within a spread of the middle, from which the search for the centre begins."""
    mean = (0.25 + 0.375 + 0.5 + 0.625) / 4
    centre = huber_centre([0.25, 0.375, 0.5, 0.625], middle=mean, spread=0.25)
    assert centre == mean


def test_an_estimate_at_the_distance_of_the_spread_is_inside() -> None:
    """So a step of the search for the centre, the sum of all distances, is divided by 2, the number inside.

    The distances are 0.125, which is the spread, and 0.
    """
    step = huber_step([0.625, 0.5], centre=0.5, spread=0.125)
    assert step == (0.125 + 0) / 2


def test_a_step_is_not_divided_if_no_estimate_is_inside_the_spread() -> None:
    """Otherwise it would be divided by the number of estimates inside, which is 0 here.

    The only estimate is two spreads away, and counts as one spread.
    """
    step = huber_step([0.75], centre=0.5, spread=0.125)
    assert step == 0.125


@pytest.mark.parametrize("estimate", [0.1, 0.9])
def test_the_centre_of_estimates_stays_between_0_and_1(estimate: float) -> None:
    """Four equal estimates, of 0.1 or 0.9, are more than a spread of 0.25 away from the middle.

    The first step is 4 * 0.25, and would lead from 1/2 to 3/2 or -1/2. It ends at 1 or 0 instead. From there
    further steps lead back to the estimate of all.
    """
    centre = huber_centre([estimate] * 4, middle=0.5, spread=0.25)
    assert centre == pytest.approx(estimate)


def test_the_centre_of_estimates_in_float64_is_right_to_the_last_bits() -> None:
    """The same function computes it in exact fractions. It may differ by 16 roundings.

    The estimates are those of 5 to 32 neighbours.
    """
    rng = random.Random(23)
    for _ in range(100):
        neighbours = rng.randint(5, 32)
        estimates = [rng.random() for _ in range(neighbours)]
        spread = spread_around(estimates, 0.5)

        centre = huber_centre(estimates, middle=0.5, spread=spread)

        exact_estimates = [Fraction(estimate) for estimate in estimates]
        exact_centre = huber_centre(exact_estimates, middle=Fraction(1, 2), spread=Fraction(spread))
        assert abs(Fraction(centre) - exact_centre) <= 16 * ROUNDING, estimates


# --- The test --------------------------------------------------------------------------------------------


def test_the_sides_of_the_test_are_a_squared_deviation_and_12_variances() -> None:
    """With an accuracy b of 1/2 a robot should see half black, whatever the others estimate, here 0.3.

    It saw 12 of 12 black, a deviation of 1/2. One tile of which half are black has a variance of 1/4, and the
    share of 12 tiles a twelfth of that, times the dispersion, 2.
    """
    observations = Observations(n=12, t=12, dispersion=2.0)
    squared_deviation, limit = robust_test_sides(observations, b=0.5, centre=0.3, spread=0.01)

    variance_of_tile = 1 / 4
    variance_of_share = 2 * variance_of_tile / 12
    assert squared_deviation == (1 / 2) ** 2
    assert limit == 12 * variance_of_share


@pytest.mark.parametrize(
    ("n", "centre"),
    [
        pytest.param(1, 1.0, id="1/2 observed, 3/4 expected"),
        pytest.param(2, 0.5, id="1 observed, 1/2 expected"),
    ],
)
def test_the_limit_of_the_test_has_the_larger_variance_of_two_shares(n: int, centre: float) -> None:
    """A share s of black has the variance s (1 - s), which is largest, 1/4, for s = 1/2.

    One share is what the robot has observed, n of 2 tiles. The other is to be expected by the centre of its
    neighbours' estimates. Here one of the two shares is 1/2.
    """
    observations = Observations(n=n, t=2, dispersion=1.0)
    _squared_deviation, limit = robust_test_sides(observations, b=0.75, centre=centre, spread=0.0)

    variance_of_mean_of_2_tiles = (1 / 4) / 2
    assert limit == 12 * variance_of_mean_of_2_tiles


def test_observations_at_the_limit_of_the_test_contradict_nothing() -> None:
    """All tiles of a robot were black, and all five neighbours estimate 0.5, which contradicts 13 tiles.

    With an accuracy of 1/2 the squared deviation is 1/4 for every t, and the limit, 12 / (4 t), equals it for
    12 tiles. Beyond the limit the centre of the contradicting estimates is returned.
    """
    estimates_by_slot = {0: 0.5, 1: 0.5, 2: 0.5, 3: 0.5, 4: 0.5}
    robust = RobustReference(initial_b_hat=0.5, estimates=estimates_by_slot)

    assert robust.find_contradiction(n=12, t=12) is None
    assert robust.find_contradiction(n=13, t=13) == 0.5


def test_the_spread_widens_the_limit_of_the_test() -> None:
    """The limit is 12 times the sum of two variances: of 1024 tiles, half black, and of the expected share.

    The spread is how far the centre of the others' estimates may be off. With b = 3/4 the expected share
    changes by 2 b - 1 = 1/2 of a change of the centre.
    """
    observations = Observations(n=512, t=1024, dispersion=1.0)
    squared_deviation, limit = robust_test_sides(observations, b=0.75, centre=0.5, spread=1 / 32)

    variance_of_tiles = 0.25 / 1024
    variance_of_expected_share = (1 / 2 * 1 / 32) ** 2
    assert squared_deviation == 0.0
    assert limit == 12 * (variance_of_tiles + variance_of_expected_share)


def test_the_sides_of_the_test_in_float64_are_right_to_the_last_bits() -> None:
    """The squared deviation is wrong by at most 8 roundings, and its limit by at most 16.

    The same function computes both in exact fractions.
    """
    rng = random.Random(23)
    for _ in range(500):
        dispersion = rng.uniform(1, 256)
        observations = Observations(n=rng.randint(0, 10**6), t=10**6, dispersion=dispersion)
        b_hat = rng.uniform(0.01, 0.99)
        centre = rng.random()
        spread = 2 ** rng.uniform(-12, -2)

        squared_deviation, limit = robust_test_sides(observations, b_hat, centre, spread)

        exact_observations = Observations(observations.n, observations.t, Fraction(dispersion))
        exact_squared_deviation, exact_limit = robust_test_sides(
            exact_observations, Fraction(b_hat), Fraction(centre), Fraction(spread)
        )
        error = abs(Fraction(squared_deviation) - exact_squared_deviation)
        error_of_limit = abs(Fraction(limit) - exact_limit)
        assert error <= 8 * ROUNDING, (observations, b_hat, centre, spread)
        assert error_of_limit <= 16 * ROUNDING * exact_limit, (observations, b_hat, centre, spread)


@pytest.mark.parametrize(
    ("supporters", "opponents", "expected_result"), [(2, 3, False), (3, 2, True), (4, 6, False), (5, 5, True)]
)
def test_more_than_two_fifths_of_the_estimates_are_a_party_that_supports_the_robot(
    supporters: int, opponents: int, expected_result: bool
) -> None:
    """A robot with an accuracy of 3/4 sees 3/4 of the tiles black, as it should if all are black, 1.0.

    So those who estimate 1.0 support it, and those who estimate 0.0, which is the centre, do not.
    """
    observations = Observations(n=3, t=4, dispersion=1.0)
    estimates = [1.0] * supporters + [0.0] * opponents

    result = is_supported(observations, b=0.75, estimates=estimates, centre=0.0)

    assert result == expected_result


def test_an_estimate_in_the_middle_does_not_support_the_robot() -> None:
    """The robot observes 3/4 black, by the centre it should observe 1/4, and by the estimate 1/2.

    The estimate would support it if its prediction were nearer to 3/4 than to 1/4.
    """
    observations = Observations(n=3, t=4, dispersion=1.0)
    assert not is_supported(observations, b=0.75, estimates=[0.5], centre=0.0)


# --- The filter of a robot -------------------------------------------------------------------------------


def make_robust_robot(b_hat: float) -> ReferenceRobot:
    """Make a robot with the robust filter, which runs in every round."""
    return ReferenceRobot(Config(filter=Filter.ROBUST, filter_period=1, memory=1000), OWN_ID, b_hat)


@pytest.mark.parametrize(("neighbours", "expected_tests"), [(4, 0), (5, 1)])
def test_a_robot_tests_itself_only_against_five_neighbours_or_more(
    neighbours: int, expected_tests: int
) -> None:
    """In a test a robot compares what it has observed with its neighbours' estimates.

    Four neighbours, who say that no tile is black, lead to no test in a round, and five to one.
    """
    robot = make_robust_robot(b_hat=0.75)
    observe_tiles(robot, black=50, white=50)
    receive_estimates(robot, *[0.0] * neighbours)

    robot.settle()  # ends the round, in which the filter runs

    assert robot.counters.tests == expected_tests


def test_a_robot_that_was_misled_returns_to_its_initial_accuracy() -> None:
    """This accuracy is 3/4. The robot sees half of the tiles black, and at first all others say that none is.

    A sensor that is right in half of the cases would explain that. Then the others agree with the robot.
    """
    robot = make_robust_robot(b_hat=0.75)
    observe_tiles(robot, black=200, white=200)
    receive_estimates(robot, 0.0, 0.0, 0.0, 0.0, 0.0)
    robot.settle()  # ends the round, in which the filter runs
    assert robot.b_hat == 0.5

    receive_estimates(robot, 0.5, 0.5, 0.5, 0.5, 0.5)
    robot.settle()  # ends another round, in which the filter runs

    assert robot.b_hat == 0.75


def test_a_robot_that_a_party_of_its_neighbours_supports_keeps_its_accuracy() -> None:
    """It sees half of the tiles black, as three of seven others do; four others say that none is.

    Three of seven are more than two fifths, which are enough.
    """
    robot = make_robust_robot(b_hat=0.75)
    observe_tiles(robot, black=200, white=200)
    receive_estimates(robot, 0.0, 0.0, 0.0, 0.0, 0.5, 0.5, 0.5)

    status = robot.settle()  # ends the round, in which the filter runs

    assert status == Status.OK
    assert robot.counters.tests == 1
    assert robot.b_hat == 0.75


def test_from_the_first_vote_on_a_robot_believes_the_centre_of_the_votes() -> None:
    """x is what the robot believes, and x_bar what it takes its neighbours to believe: both are the centre.

    The centre is 1/2 before the first vote, and the spread 1/4. A neighbour that estimates 0 moves the centre
    by an eighth of the spread.
    """
    robot = make_robust_robot(b_hat=0.75)
    robot.observe(Observation.BLACK)
    receive_estimates(robot, 0.0)

    robot.settle()  # the neighbour votes

    centre, spread = 1 / 2, 1 / 4
    assert robot.x == centre - spread / 8
    assert robot.x_bar == centre - spread / 8
