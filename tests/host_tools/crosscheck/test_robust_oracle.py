"""The oracle of the robust filter: its bounds, its decisions, and what it finds wrong in a call."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterator
from fractions import Fraction

import pytest

from crosschecks import check_calls, with_outcome, with_value_after
from mcp_asdf.robot import Filter
from mcp_asdf.robust_reference import Observations, Votes
from mcp_asdf_tools.crosscheck.audit import Audit
from mcp_asdf_tools.crosscheck.oracle import check_call
from mcp_asdf_tools.crosscheck.robust_bounds import (
    dispersion_bounds,
    robust_test_outcome,
    rounded_centre_and_spread,
    rounded_votes_after,
    slot_estimate,
    support_outcome,
)
from mcp_asdf_tools.crosscheck.robust_scenarios import robust_scenario
from mcp_asdf_tools.crosscheck.scenario import CallRecord, parse_scenario
from robots import ALPHA_ONE

# --- Bounds ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("x_hat_units", "estimate_units"),
    [(0, 0), (63, 0), (64, 1), (191, 1), (192, 2), (2**23 - 65, 65535), (2**23, 65535)],
)
def test_a_robot_remembers_the_nearest_estimate_that_has_16_bits(
    x_hat_units: int, estimate_units: int
) -> None:
    """A neighbour sends x_hat in units of 2**-23. 16 bits have units of 2**-16, which are 128 times as large.

    A half of such a unit is rounded up, but 1 has no 16 bits, and is remembered as 65535 / 65536.
    """
    x_hat = Fraction(x_hat_units, 2**23)
    assert slot_estimate(x_hat) == Fraction(estimate_units, 2**16)


@pytest.mark.parametrize(
    ("x_hat_units", "centre_units", "spread_units"),
    [
        (2**23, 2**29 + 2**15, 2**18 + 2**14),  # 1/8 of the spread of 2**18, which widens by 1/16
        (0, 2**29 - 2**15, 2**18 + 2**14),
        (2**22, 2**29, 2**18),  # a vote of 1/2; the spread is no narrower than the smallest one
        (2**22 + 1, 2**29 + 2**4, 2**18),  # one unit of 2**-23 above 1/2 is 2**7 units, and 1/8 of them
    ],
)
def test_a_vote_moves_centre_and_spread_by_whole_units(
    x_hat_units: int, centre_units: int, spread_units: int
) -> None:
    """A vote weighs one estimate, x_hat: the centre goes 1/8 of the way to it, but at most 1/8 of a spread.

    The centre and the spread are in units of 2**-30, and x_hat is in units of 2**-23. Before this vote, the
    first, the centre is 1/2, which is 2**29 units, and the spread has 2**18 units. A vote that is farther off
    than the spread widens it by 1/16.
    """
    before = Votes(centre=Fraction(1, 2), spread=Fraction(2**18, 2**30), count=0)
    after = rounded_votes_after(before, x_hat=Fraction(x_hat_units, 2**23))
    assert after.centre * 2**30 == centre_units
    assert after.spread * 2**30 == spread_units


def test_a_vote_moves_the_centre_by_whole_units_and_less_than_a_unit_is_rounded_away() -> None:
    """After 512 votes the gain is 2**-7: the centre goes a part in 2**7 of the way to a neighbour's estimate.

    That estimate is one unit less than 3 * 2**7 units away, so the centre moves by two units, and not three.
    """
    unit = Fraction(1, 2**30)
    distance = (3 * 2**7 - 1) * unit
    before = Votes(centre=Fraction(1, 2), spread=2**18 * unit, count=512)
    after = rounded_votes_after(before, x_hat=before.centre - distance)
    assert after.centre == before.centre - 2 * unit


@pytest.mark.parametrize(
    ("batch_black_count", "dispersion_units"),
    [
        (250, 448),  # as many as expected: 7/8 of 2, which is 1.75
        (260, 473),  # a ratio of 0.8, from 10**2 / (500 / 4): 7/8 of 2, and 1/8 of 0.8, which is 1.85
        (500, 1216),  # an outlier counts as a ratio of 12 * 2 = 24: 7/8 of 2 and 1/8 of 24 are 4.75
    ],
)
def test_the_running_dispersion_of_observations_has_one_right_value_or_two(
    batch_black_count: int, dispersion_units: int
) -> None:
    """Dispersion is how much more observations vary than independent ones; it is 2 before this batch.

    The batch is of 500 observations, and half of all 1000 are black. The new dispersion is 7/8 of the old one
    and 1/8 of the batch's own: the squared excess of its black ones, divided by 500 / 4. Units are 2**-8.
    """
    observations = Observations(n=500, t=1000, dispersion=Fraction(2))
    smallest, largest = dispersion_bounds(observations, batch_black_count, batch_count=500)
    unit = Fraction(1, 2**8)
    assert smallest <= dispersion_units * unit <= largest
    assert largest - smallest <= unit


@pytest.mark.parametrize(("n", "batch_count"), [(0, 500), (500, 0)])
def test_a_batch_without_deviation_leaves_the_dispersion(n: int, batch_count: int) -> None:
    """Dispersion is how much more observations vary than independent ones; it is 3 before this batch.

    All observations are white, or the batch has none, so both bounds of the new dispersion are 3.
    """
    observations = Observations(n, t=1000, dispersion=Fraction(3))
    smallest, largest = dispersion_bounds(observations, batch_black_count=0, batch_count=batch_count)
    assert smallest == 3
    assert largest == 3


def test_the_dispersion_has_wide_bounds_where_the_variance_is_a_rounding_error() -> None:
    """One of 2**31 observations is black, so the variance of a batch is no larger than its rounding error.

    The new dispersion is 7/8 of the old one, which is 8, and 1/8 of the batch's ratio of variances. By
    rounding that is anything from 0 to 12 times the old dispersion, its limit.
    """
    observations = Observations(n=1, t=2**31, dispersion=Fraction(8))
    smallest, largest = dispersion_bounds(observations, batch_black_count=1, batch_count=2**20)
    smallest_ratio, largest_ratio = 0, 12 * 8
    assert smallest == Fraction(7 * 8 + smallest_ratio, 8)
    assert largest == Fraction(7 * 8 + largest_ratio, 8)


def test_the_centre_of_five_estimates_falls_one_unit_of_the_firmware_short_of_the_exact_one() -> None:
    """The spread is the median distance, 106, from the median, 300.

    Three estimates are within a spread: the mean of 200, 300 and 406 is 302. The outer two, 0 and 600, count
    as a spread below and a spread above, and so balance each other. The firmware's quotient of a step from
    300 to 302 is a little too small even though it needs no rounding, so the step ends a unit before 302.
    """
    unit_of_estimates, unit_of_firmware = Fraction(1, 2**16), Fraction(1, 2**24)
    estimates = [estimate * unit_of_estimates for estimate in (0, 200, 300, 406, 600)]
    centre, spread = rounded_centre_and_spread(estimates)
    assert spread == 106 * unit_of_estimates
    assert centre == 302 * unit_of_estimates - unit_of_firmware


@pytest.mark.parametrize(
    ("black_count", "expected_outcome"), [(554_100, False), (554_154, None), (554_200, True)]
)
def test_a_decision_of_the_robust_test_that_hangs_on_rounding_is_left_open(
    black_count: int, expected_outcome: bool | None
) -> None:
    """The test rejects b_hat, 3/4, if too many of a million observations are black; 1/2 would be expected.

    It does if the share is off by more than 0.054154, whose square is 12 (1/4 / 10**6 + (1/2 spread)**2). So
    with 554,154 a firmware that rounds may reject or not, and ``robust_test_outcome`` says None.
    """
    observations = Observations(n=black_count, t=10**6, dispersion=Fraction(1))
    is_rejected = robust_test_outcome(
        observations, b=Fraction(3, 4), centre=Fraction(1, 2), spread=Fraction(1, 32)
    )
    assert is_rejected is expected_outcome


@pytest.mark.parametrize(
    ("estimates", "expected_outcome"),
    [
        ([1.0, 1.0, 0.0, 0.0, 0.0], False),
        ([1.0, 1.0, 1.0, 0.0, 0.0], True),
        ([1.0, 1.0, 0.5, 0.0, 0.0], None),  # 1/2 is as near to the robot's share as to the centre
    ],
)
def test_supporters_are_more_than_two_of_five_unless_one_is_in_the_middle(
    estimates: list[float], expected_outcome: bool | None
) -> None:
    """A supporter's estimate predicts the robot's share of black tiles, here 3/4, better than the centre, 0.

    With an accuracy of 3/4, an estimate of 1 predicts 3/4, and one of 0 predicts 1/4. The outcome is whether
    there are enough supporters, or None if rounding may decide.
    """
    observations = Observations(n=3, t=4, dispersion=Fraction(1))
    exact_estimates = [Fraction(estimate) for estimate in estimates]
    has_support = support_outcome(
        observations, b=Fraction(3, 4), estimates=exact_estimates, centre=Fraction(0)
    )
    assert has_support is expected_outcome


# --- What is found wrong in a call -----------------------------------------------------------------------


MEMORY_FIELDS = (
    *("estimates_0", "robust_filled_slots", "robust_turn", "robust_centre", "robust_spread", "robust_votes"),
    *("robust_batch_t", "robust_batch_n", "robust_initial_b_hat"),
)
"""Fields that have one right value after every call."""
RESULTS = ("b_hat()", "tests", "x()", "x_bar()", "beta()")
"""Fields that have one right value after every run of the filter that does not re-estimate b_hat."""
DEVIATIONS_BY_EVENT = {
    "receive": MEMORY_FIELDS,
    "observe": MEMORY_FIELDS,
    "vote": MEMORY_FIELDS,
    "own vote": MEMORY_FIELDS,
    "too few": RESULTS,
    "accepted": RESULTS,
    "returned": RESULTS,
    "supported": RESULTS,
    "rejected": ("tests", "x()", "x_bar()", "beta()"),
}
"""Fields in which a deviation by one unit must be found, by event of the robust filter or call."""


def records_with_a_wrong_value(event: str, record: CallRecord) -> Iterator[CallRecord]:
    """Yield what a wrong firmware may show after an event of the robust filter: one field is a unit off."""
    for name in DEVIATIONS_BY_EVENT.get(event, ()):
        yield with_value_after(record, name, record.new_state[name] + 1)
        yield with_value_after(record, name, record.new_state[name] - 1)
    if event in ("too few", "accepted", "returned", "supported"):
        yield with_outcome(record, "OK" if record.is_updated else "UPDATED")


@pytest.fixture(scope="module")
def calls_by_event() -> dict[str, list[CallRecord]]:
    """The right calls of 40 random scenarios, by the events of the robust filter in them and by name."""
    calls: dict[str, list[CallRecord]] = defaultdict(list)
    audit = Audit()
    for index in range(40):
        for record in check_calls(robust_scenario(1, index), audit):
            for event in (*audit.events, record.call.name):
                calls[event].append(record)
            audit.events.clear()
    return calls


# design: R35, R37, R38
@pytest.mark.slow
@pytest.mark.parametrize("event", DEVIATIONS_BY_EVENT)
def test_a_wrong_result_of_any_event_of_the_robust_filter_is_reported(
    event: str, calls_by_event: dict[str, list[CallRecord]]
) -> None:
    """After a right call one value of the robot is changed by a unit. The oracle must report a problem.

    An event is, for example, that an estimate is weighed, or that the filter's test rejects b_hat. Up to ten
    calls with the event are checked, each with one wrong value after the other.
    """
    calls = calls_by_event[event]
    assert len(calls) >= 3, "the 40 scenarios hardly have this event"
    for right_call in calls[:10]:
        for wrong_call in records_with_a_wrong_value(event, right_call):
            problems = check_call(wrong_call, Audit())
            assert problems != [], f"{right_call.call} may give {wrong_call.after}"


ROBUST_ROBOT = f"robot:{Filter.ROBUST:d}:1:64:0:{3 << 30}"
"""A robot with the robust filter that assumes 3/4, in units of 2**-32, and tests itself in every round."""


def test_a_dispersion_out_of_bounds_is_reported() -> None:
    """The dispersion, in units of 2**-8, is how much more observations vary than independent ones.

    After two observations it is 1, or 256 units. The result of the last call, ``settle``, gets 258.
    """
    scenario = parse_scenario(f"{ROBUST_ROBOT},observe:1,observe:0,settle")
    *_, settle = check_calls(scenario, Audit())
    wrong_settle = with_value_after(settle, "robust_dispersion", 256 + 2)
    problems = check_call(wrong_settle, Audit())
    assert problems == ["dispersion is 1.0078125, outside 1 to 1"]


# --- What is counted -------------------------------------------------------------------------------------


def count_robust_events(text: str) -> tuple[Counter[str], int]:
    """Make the calls of a scenario, and return the events of the robust filter and the number of tests."""
    audit = Audit()
    list(check_calls(parse_scenario(text), audit))
    return audit.events, audit.tests


def receive(sender: int, x_hat: float) -> str:
    """Return the call by which a robot receives an estimate with a confidence of 1."""
    return f"receive:{sender}:{round(x_hat * 2**23)}:{ALPHA_ONE}"


def test_votes_and_a_filter_that_has_too_few_estimates_are_counted() -> None:
    """A vote weighs one estimate, and each ``settle`` ends a round with a vote and a run of the filter.

    The filter's test needs five estimates, and the robot has two: that of robot 1 and its own.
    """
    scenario = f"{ROBUST_ROBOT},{receive(sender=1, x_hat=0)},observe:1,settle,settle,settle"
    events, tests = count_robust_events(scenario)
    assert events == {
        "vote": 2,  # of robot 1, in the first and the third round
        "own vote": 1,  # of the robot itself, in the second round
        "too few": 3,  # in each round
    }
    assert tests == 0


def test_a_filter_without_an_observation_is_not_counted() -> None:
    """The robot weighs the estimate that it receives, which is a vote, but it has no observations to test."""
    events, tests = count_robust_events(f"{ROBUST_ROBOT},{receive(sender=1, x_hat=0)},settle")
    assert events == {"vote": 1}
    assert tests == 0


def test_a_test_that_five_estimates_pass_is_counted() -> None:
    """Five estimates are the fewest for a test, and any agree with a robot that has observed one tile.

    One of them is weighed in this round, which is the vote.
    """
    messages = ",".join(receive(sender, x_hat=0.5) for sender in (1, 2, 3, 4, 5))
    events, tests = count_robust_events(f"{ROBUST_ROBOT},{messages},observe:1,settle")
    assert events == {"vote": 1, "accepted": 1}
    assert tests == 1
