"""The oracle of the robust filter: its bounds, its decisions, and what it finds wrong in a call."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from fractions import Fraction

import pytest

from crosschecks import check_calls, with_value
from mcp_asdf.fixed_point import ONE
from mcp_asdf.robust_reference import Observations, Votes
from mcp_asdf_tools.crosscheck.bounds import HALF
from mcp_asdf_tools.crosscheck.compare import CallResult
from mcp_asdf_tools.crosscheck.oracle import Audit
from mcp_asdf_tools.crosscheck.robust_bounds import (
    dispersion_bounds,
    robust_test_outcome,
    rounded_centre_and_spread,
    rounded_votes_after,
    slot_estimate,
    support_outcome,
)
from mcp_asdf_tools.crosscheck.robust_scenarios import robust_scenario

INDEPENDENT = Fraction(1)
"""The dispersion of independent observations."""

# --- Bounds ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("x_hat", "estimate"), [(0, 0), (63, 0), (64, 1), (191, 1), (192, 2), (ONE - 65, 65535), (ONE, 65535)]
)
def test_a_robot_remembers_the_nearest_estimate_that_has_16_bits(x_hat: int, estimate: int) -> None:
    """A neighbour sends x_hat in units of 2**-23, and 16 bits have units of 2**-16."""
    assert slot_estimate(Fraction(x_hat, ONE)) == Fraction(estimate, 2**16)


@pytest.mark.parametrize(
    ("x_hat", "centre", "spread"),
    [
        (ONE, 2**29 + 2**15, 2**18 + 2**14),
        (0, 2**29 - 2**15, 2**18 + 2**14),
        (2**22, 2**29, 2**18),  # no narrower than the smallest spread
        (2**22 + 1, 2**29 + 2**4, 2**18),
    ],
)
def test_a_vote_moves_centre_and_spread_by_whole_units(x_hat: int, centre: int, spread: int) -> None:
    """Before the vote, which is the first, the centre is 1/2 and the spread 2**18; units are 2**-30."""
    before = Votes(HALF, Fraction(2**18, 2**30), 0)
    after = rounded_votes_after(before, Fraction(x_hat, ONE))
    assert after.centre * 2**30 == centre
    assert after.spread * 2**30 == spread


def test_changes_of_less_than_a_unit_are_rounded_away() -> None:
    """The gain is 2**-7, so a distance of a little less than 3 * 2**7 units moves the centre by 2."""
    before = Votes(HALF, Fraction(2**18, 2**30), 512)
    after = rounded_votes_after(before, HALF - Fraction(3 * 2**7 - 1, 2**30))
    assert after.centre == HALF - Fraction(2, 2**30)


@pytest.mark.parametrize(
    ("batch_black_count", "dispersion"),
    [
        (250, 448),  # as many as expected: 7/8 of 2
        (260, 473),  # a ratio of 0.8: 7/8 of 2, and 1/8 of 0.8
        (500, 1216),  # an outlier, which counts 12 * 2
    ],
)
def test_the_running_dispersion_of_observations_has_one_right_value_or_two(
    batch_black_count: int, dispersion: int
) -> None:
    """Dispersion is how much more observations vary than independent ones; it is 2 before this batch.

    The batch is of 500 observations, and half of all 1000 are black; units are 2**-8.
    """
    smallest, largest = dispersion_bounds(Observations(500, 1000, Fraction(2)), batch_black_count, 500)
    assert smallest * 256 <= dispersion <= largest * 256
    assert largest - smallest <= Fraction(1, 256)


@pytest.mark.parametrize(("n", "batch_count"), [(0, 500), (500, 0)])
def test_a_batch_without_deviation_leaves_the_dispersion(n: int, batch_count: int) -> None:
    bounds = dispersion_bounds(Observations(n, 1000, Fraction(3)), 0, batch_count)
    assert bounds == (Fraction(3), Fraction(3))


def test_the_dispersion_has_wide_bounds_where_the_variance_is_a_rounding_error() -> None:
    """One of 2**31 observations is black: the variance of a batch is of the size of its rounding."""
    bounds = dispersion_bounds(Observations(1, 2**31, Fraction(8)), 1, 2**20)
    assert bounds == (Fraction(7), Fraction(19))


def test_the_centre_of_estimates_falls_one_unit_short_of_a_whole_number() -> None:
    """The mean of the three estimates within 100 of the median is 2 above it, and the outer ones balance."""
    estimates = [Fraction(estimate, 2**16) for estimate in (0, 200, 300, 406, 600)]
    centre, spread = rounded_centre_and_spread(estimates)
    assert spread == Fraction(106, 2**16)
    assert centre == Fraction(302 * 2**8 - 1, 2**24)


@pytest.mark.parametrize(("n", "outcome"), [(554_100, False), (554_154, None), (554_200, True)])
def test_a_decision_of_the_robust_test_that_hangs_on_rounding_is_left_open(
    n: int, outcome: bool | None
) -> None:
    observations = Observations(n, 10**6, INDEPENDENT)
    assert robust_test_outcome(observations, Fraction(3, 4), HALF, Fraction(1, 32)) is outcome


@pytest.mark.parametrize(
    ("estimates", "outcome"),
    [
        ([1, 1, 0, 0, 0], False),
        ([1, 1, 1, 0, 0], True),
        ([1, 1, HALF, 0, 0], None),  # 1/2 is as near to the robot's share as to the centre
    ],
)
def test_supporters_are_more_than_two_of_five_unless_one_is_in_the_middle(
    estimates: list[Fraction], outcome: bool | None
) -> None:
    observations = Observations(3, 4, INDEPENDENT)
    fractions = list(map(Fraction, estimates))
    assert support_outcome(observations, Fraction(3, 4), fractions, centre=Fraction(0)) is outcome


# --- What is found wrong in a call -----------------------------------------------------------------------


MEMORY_FIELDS = (
    *("estimates_0", "robust_filled_slots", "robust_turn", "robust_centre", "robust_spread", "robust_votes"),
    *("robust_batch_t", "robust_batch_n", "robust_initial_b_hat"),
)
"""Fields that have one right value after every call."""
RESULTS = ("b_hat()", "tests", "x()", "x_bar()", "beta()")
"""Fields of which the same holds after every run of the filter that does not re-estimate b_hat."""
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


def wrong_results(event: str, after: CallResult) -> Iterator[CallResult]:
    """Yield what a wrong firmware may show after an event of the robust filter: one field is a unit off."""
    for name in DEVIATIONS_BY_EVENT.get(event, ()):
        yield with_value(after, name, after.state[name] + 1)
        yield with_value(after, name, after.state[name] - 1)
    if event in ("too few", "accepted", "returned", "supported"):
        yield replace(after, outcome="UPDATED" if after.outcome == "OK" else "OK")


# design: R35, R37, R38
@pytest.mark.slow
def test_a_wrong_result_of_any_event_of_the_robust_filter_is_reported() -> None:
    """In 40 random scenarios, in which each event happens at least three times; the first ten are checked."""
    audit, events = Audit(), Counter[str]()
    for number in range(40):
        for checked in check_calls(str(robust_scenario(1, number)), audit):
            for event in (*audit.robust, checked.call.name):
                events[event] += 1
                if events[event] > 10:
                    continue
                for wrong in wrong_results(event, checked.after):
                    problems = Audit().check_call(checked.setup, checked.call, checked.before, wrong)
                    assert problems, f"{event}: {checked.call}"
            audit.robust.clear()
    for event in DEVIATIONS_BY_EVENT:
        assert events[event] >= 3, event


ROBOT = "robot:3:1:64:0:3221225472"
"""A robot with the robust filter that assumes 3/4 and tests itself in every round."""


def test_a_dispersion_out_of_bounds_is_reported() -> None:
    calls = list(check_calls(f"{ROBOT},observe:1,observe:0,settle", Audit()))[-1]
    wrong = with_value(calls.after, "robust_dispersion", calls.after.state["robust_dispersion"] + 2)
    problems = Audit().check_call(calls.setup, calls.call, calls.before, wrong)
    assert problems == ["dispersion is 1.0078125, outside 1 to 1"]


# --- What is counted -------------------------------------------------------------------------------------


def count_robust_events(text: str) -> tuple[Counter[str], int]:
    """Make the calls of a scenario, and return the events of the robust filter and the number of tests."""
    audit = Audit()
    list(check_calls(text, audit))
    return audit.robust, audit.tests


def test_votes_and_a_filter_that_has_too_few_estimates_are_counted() -> None:
    calls = "receive:1:99:2147483649,observe:1,settle,settle,settle"
    events, tests = count_robust_events(f"{ROBOT},{calls}")
    assert events == {"vote": 2, "own vote": 1, "too few": 3}
    assert tests == 0


def test_a_filter_without_an_observation_is_not_counted() -> None:
    events, tests = count_robust_events(f"{ROBOT},receive:1:99:2147483649,settle")
    assert events == {"vote": 1}
    assert tests == 0


def test_a_test_that_five_estimates_pass_is_counted() -> None:
    """Each is 1/2, in units of 2**-23, and five are the fewest for a test."""
    messages = ",".join(f"receive:{sender}:4194304:2147483649" for sender in range(1, 6))
    events, tests = count_robust_events(f"{ROBOT},{messages},observe:1,settle")
    assert events == {"vote": 1, "accepted": 1}
    assert tests == 1
