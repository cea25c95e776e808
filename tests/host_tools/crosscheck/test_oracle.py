"""The oracle of the cross-check: its bounds, what it finds wrong in a call, and the errors it collects."""

from __future__ import annotations

from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Any

import pytest

from crosschecks import check_calls, with_outcome, with_value_after
from mcp_asdf.fixed_point import alpha_from_word
from mcp_asdf.reference import assumed_accuracy_update, local_estimate
from mcp_asdf.robot import Filter
from mcp_asdf_tools.crosscheck.audit import Audit, Errors, region_of
from mcp_asdf_tools.crosscheck.bounds import (
    HALF,
    alpha_bounds,
    alpha_error,
    b_hat_error,
    exact_alpha,
    is_update_expected,
    x_hat_bounds,
)
from mcp_asdf_tools.crosscheck.oracle import check_call
from mcp_asdf_tools.crosscheck.scenario import CallRecord, parse_scenario
from robots import ALPHA_ONE

# --- Bounds ----------------------------------------------------------------------------------------------


def test_the_exact_confidence_alpha_is_the_fisher_information_of_the_observations() -> None:
    """alpha is t (2 b - 1)^2 / (h (1 - h)) for t observations with accuracy b, of which a share h is black.

    Here one of two observations is black, and b is 3/4.
    """
    t, b, h = 2, Fraction(3, 4), Fraction(1, 2)
    fisher_information = t * (2 * b - 1) ** 2 / (h * (1 - h))
    assert fisher_information == 2
    assert exact_alpha(n=1, t=2, b=b) == fisher_information


def test_the_firmware_s_largest_alpha_limits_the_exact_one() -> None:
    """Unlimited, it would be about 2**31 / 2**-20, as a share of 2**-20 of 2**31 observations is black."""
    largest_alpha = 2**31 - 2**7  # the largest number below 2**31 of 24 bits, as many as an alpha word has
    assert exact_alpha(n=2**11, t=2**31, b=1 - Fraction(1, 2**20)) == largest_alpha


def test_an_estimate_from_a_sensor_that_guesses_is_exactly_one_half() -> None:
    """A sensor of accuracy 1/2 guesses, so three black tiles of seven say nothing. Both bounds are 1/2."""
    lower, upper = x_hat_bounds(n=3, t=7, b=HALF)
    assert lower == HALF
    assert upper == HALF


B_95, B_NEARLY_HALF = Fraction(19, 20), Fraction(1025, 2048)


@pytest.mark.parametrize(
    ("n", "b", "lowest_units", "highest_units"),
    [
        (0, B_95, 0, 0),
        (300_000, B_95, 2330168, 2330168),  # (0.3 - 0.05) / 0.9 is 2330168.9 units, rounded down
        (500_100, B_NEARLY_HALF, 5053297, 5053298),  # 1 less those below: the colours are exchanged
        (499_900, B_NEARLY_HALF, 3335310, 3335311),  # 0.3976 is 3335310.5 units, or 0.8 more at most
    ],
)
def test_bounds_of_x_hat_are_those_of_the_design(
    n: int, b: Fraction, lowest_units: int, highest_units: int
) -> None:
    """x_hat estimates the fill ratio from n black of a million tiles and an accuracy b.

    Exactly it is (n / t - (1 - b)) / (2 b - 1), but not below 0. A robot computes it with integers, in units
    of 2**-23. docs/internals/properties.md states how far it may be off.
    """
    lower, upper = x_hat_bounds(n, t=10**6, b=b)
    assert lower * 2**23 == lowest_units
    assert upper * 2**23 == highest_units


@pytest.mark.parametrize(
    ("n", "b", "downwards_units", "upwards_units"),
    [
        (0, B_95, 66, 2),  # where x_hat is 0 or 1: 2**-22 + 2**-27, and 2**-30
        # Elsewhere: 2**-28 + 2**-27 + 2**-31, and about (2 r + 1) 2**-30 for r = 1 / (2 b - 1)
        (300_000, B_95, 3.125, 6.444),
        (500_100, B_NEARLY_HALF, 3.125, 4098.002),
        (499_900, B_NEARLY_HALF, 3.125, 4098.002),
    ],
)
def test_errors_of_alpha_are_those_of_the_design(
    n: int, b: Fraction, downwards_units: float, upwards_units: float
) -> None:
    """alpha is the confidence after n black of a million tiles, with a sensor of accuracy b.

    A robot's alpha may be too small by some units of 2**-28 of the exact one, and too large by some units of
    2**-31 of it. docs/internals/properties.md derives them.
    """
    too_small, too_large = alpha_error(n, t=10**6, b=b)
    assert too_small * 2**28 == pytest.approx(downwards_units, abs=1e-3)
    assert too_large * 2**31 == pytest.approx(upwards_units, abs=1e-3)


@pytest.mark.parametrize(
    ("n", "b"), [(0, B_95), (300_000, B_95), (500_100, B_NEARLY_HALF), (499_900, B_NEARLY_HALF)]
)
def test_bounds_of_alpha_have_room_for_an_alpha_word(n: int, b: Fraction) -> None:
    """A robot sends its confidence alpha as a word of 24 bits, or in units of 2**-24, rounded down.

    So the word may be smaller than what the robot computes, which has an error of its own, and never larger.
    """
    exact = exact_alpha(n, t=10**6, b=b)
    too_small, too_large = alpha_error(n, t=10**6, b=b)
    smallest_computed = exact * (1 - too_small)
    largest_computed = exact * (1 + too_large)
    part_cut_off_by_24_bits = Fraction(1, 2**23)
    unit_of_small_words = Fraction(1, 2**24)
    smallest_word = smallest_computed * (1 - part_cut_off_by_24_bits) - unit_of_small_words

    lower, upper = alpha_bounds(n, t=10**6, b=b)
    assert lower == smallest_word
    assert upper == largest_computed


# design: R26
@pytest.mark.parametrize(
    ("x_bar", "expected_units"),
    [(Fraction(11, 20), 59), (Fraction(9, 20), 45), (Fraction(0), 9), (Fraction(1), 14)],
)
def test_the_error_of_b_hat_is_that_of_the_design(x_bar: Fraction, expected_units: int) -> None:
    """The error bound is (4 x_bar + 3) / |2 x_bar - 1| + 7 units of 2**-32, with 2 for 3 if x_bar < 1/2.

    x_bar is the mean of the estimates from which b_hat follows. The whole number of units is compared.
    """
    error_in_units = b_hat_error(x_bar) * 2**32
    assert round(error_in_units) == expected_units


# design: R25
@pytest.mark.parametrize("side_of_one_half", [1, -1])
@pytest.mark.parametrize(("rounding_errors_above_limit", "is_expected"), [(-1.7, False), (2.01, True)])
def test_an_update_is_expected_from_an_informative_x_bar(
    side_of_one_half: int, rounding_errors_above_limit: float, is_expected: bool
) -> None:
    """x_bar, the mean of the estimates, is informative if |2 x_bar - 1| is above the limit of 2**-12.

    A robot's x_bar may be up to 2 rounding errors too near to 1/2, and up to 1.6 too far from it. So an exact
    one that is 2.01 errors above the limit is informative in any case, and one 1.7 errors below it is not.
    """
    largest_rounding_error = Fraction(5, 4) / 2**30
    limit = Fraction(1, 2**12)
    distance_of_2_x_bar_from_1 = limit + Fraction(rounding_errors_above_limit) * largest_rounding_error
    x_bar = (1 + side_of_one_half * distance_of_2_x_bar_from_1) / 2
    assert is_update_expected(x_bar) is is_expected


def test_an_x_bar_so_near_to_the_limit_that_rounding_decides_may_lead_to_an_update_or_not() -> None:
    """``is_update_expected`` is None: both outcomes are right. x_bar is a rounding error beyond the limit.

    The limit is 2**-12 for |2 x_bar - 1|, and so half of it, 2**-13, for the distance of x_bar from 1/2.
    """
    rounding_error = Fraction(1, 2**31)
    x_bar = Fraction(1, 2) + Fraction(1, 2**13) + rounding_error
    assert is_update_expected(x_bar) is None


# --- What is found wrong in a call -----------------------------------------------------------------------


def last_call(text: str, audit: Audit) -> CallRecord:
    """Make the calls of a scenario, and return the last call. Exact arithmetic must find nothing wrong."""
    return list(check_calls(parse_scenario(text), audit))[-1]


def robot(mode: Filter, b_hat: int = 3 << 30) -> str:
    """Return the beginning of a scenario: a robot whose filter runs in every round; b_hat is 3/4 of 2**32."""
    filter_period, memory, robot_id = 1, 64, 0
    return f"robot:{mode:d}:{filter_period}:{memory}:{robot_id}:{b_hat}"


def receive(sender: int, x_hat: int) -> str:
    """Return the call by which a robot receives an x_hat, in units of 2**-23, with a confidence of 1."""
    return f"receive:{sender}:{x_hat}:{ALPHA_ONE}"


def problems_of_changed_update(value_name: str, change: int) -> list[str]:
    """Make a call that updates b_hat, change a value after it, and return what an audit finds wrong."""
    audit = Audit()
    scenario = f"{robot(Filter.ALWAYS)},step:1,step:0,{receive(sender=1, x_hat=3_000_000)},step:0"
    update = last_call(scenario, audit)
    assert update.is_updated
    changed_update = with_value_after(update, value_name, update.new_state[value_name] + change)
    return check_call(changed_update, audit)


# design: R21
@pytest.mark.parametrize(
    ("value_name", "change", "expected_problem"),
    [
        ("x_hat", 2, "x_hat is"),  # at most two neighbouring values are right
        ("x_hat", -2, "x_hat is"),
        ("alpha", 16 << 8, "alpha is"),  # 16 units of the mantissa, which begins at bit 8
        ("b_hat()", 50, "b_hat is"),  # rounding leads to 19 units at most, for an x_bar of 3,000,000 / 2**23
        ("b_hat()", -50, "b_hat is"),
        ("x()", 1, "x() is"),
        ("x_bar()", -1, "x_bar() is"),
        ("holds_invariants()", -1, "the invariants do not hold"),
    ],
)
def test_a_value_out_of_bounds_is_reported(value_name: str, change: int, expected_problem: str) -> None:
    """One value after a call that updates b_hat is changed by more than rounding explains.

    The oracle returns its problems as lines that begin with the name of the value.
    """
    problems = problems_of_changed_update(value_name, change)
    assert any(problem.startswith(expected_problem) for problem in problems)


def test_a_value_that_follows_from_no_equation_is_not_checked() -> None:
    """The oracle does not know open_x, a sum of messages; only the two firmwares are compared in it."""
    assert problems_of_changed_update("open_x", change=1) == []


def make_step_after_messages(mode: Filter, message_count: int, audit: Audit) -> CallRecord:
    """Return a right call of ``step`` that runs the filter. Messages with different x_hat came before.

    The audit finds nothing wrong in these calls, and counts the tests of the filter.
    """
    messages = [receive(sender, 3_000_000 + sender) for sender in range(1, message_count + 1)]
    return last_call(",".join(["table:0.05:2", robot(mode), *messages, "step:1"]), audit)


@pytest.mark.parametrize(
    ("mode", "message_count"), [(Filter.OFF, 2), (Filter.ALWAYS, 0), (Filter.ADAPTIVE, 1)]
)
def test_a_change_of_b_hat_without_a_reason_is_reported(mode: Filter, message_count: int) -> None:
    """The robot's filter is off, has no message, or has only one where its test needs two.

    So its call of ``step`` kept b_hat, the accuracy that it assumes of its sensor, and returned OK. Here that
    is replaced by UPDATED, as if b_hat had changed.
    """
    audit = Audit()
    step = make_step_after_messages(mode, message_count, audit)
    wrong_step = with_outcome(step, "UPDATED")

    assert check_call(wrong_step, audit) == ["b_hat is re-estimated, wrongly"]
    assert audit.tests == 0, "tests of the filter, of which there is none in such a step"


@pytest.mark.parametrize(
    ("mode", "message_count", "expected_tests"), [(Filter.ALWAYS, 1, 0), (Filter.ADAPTIVE, 2, 2)]
)
def test_a_b_hat_that_is_kept_where_it_had_to_change_is_reported(
    mode: Filter, message_count: int, expected_tests: int
) -> None:
    """Two messages contradict the robot. For a filter without a test, one message is enough.

    So its call of ``step`` changed b_hat, the accuracy that it assumes of its sensor, and returned UPDATED.
    Here that is replaced by OK, as if b_hat had been kept.
    """
    audit = Audit()
    step = make_step_after_messages(mode, message_count, audit)
    wrong_step = with_outcome(step, "OK")

    assert check_call(wrong_step, audit) == ["b_hat is not re-estimated, wrongly"]
    assert audit.tests == expected_tests, (
        "tests of the filter, one in the right call and one in the wrong one"
    )


def test_a_change_of_b_hat_before_the_filter_period_has_passed_is_reported() -> None:
    """The filter runs every few rounds. Before the right call one round was left, and so it changed b_hat.

    This is replaced by two rounds, as if the filter had run too early.
    """
    audit = Audit()
    step = make_step_after_messages(Filter.ALWAYS, message_count=1, audit=audit)
    state_before = step.old_state | {"filter_left": 2}
    wrong_step = replace(step, before=replace(step.before, state=state_before))

    assert check_call(wrong_step, audit) == ["b_hat is re-estimated, wrongly"]


def test_no_update_is_expected_of_a_call_that_the_robot_refuses() -> None:
    """The result of a right call is replaced by a refused observation. No filter runs after a refusal."""
    audit = Audit()
    step = make_step_after_messages(Filter.ALWAYS, message_count=1, audit=audit)
    refused_step = with_outcome(step, "ERR_OBSERVATION")
    assert check_call(refused_step, audit) == []


# --- What is counted -------------------------------------------------------------------------------------


def test_of_several_errors_the_largest_is_kept_whatever_its_sign() -> None:
    """Each value has an error against exact numbers and one against floats. There are two values."""
    errors = Errors()
    errors.add(exact_error=Fraction(-3, 4), float64_error=0.25)
    errors.add(exact_error=Fraction(1, 4), float64_error=-0.5)
    assert errors == Errors(samples=2, exact=0.75, float64=0.5)


@pytest.mark.parametrize(
    ("value", "expected_region"),
    [
        (0, "below 2^-12"),
        (2**-12, "2^-12 to 0.02"),
        (-0.02, "0.02 to 0.2"),
        (0.2, "0.2 to 0.9"),
        (0.9, "0.9 to 0.999"),
        (0.999, "0.999 to 1"),
        (1, "0.999 to 1"),
    ],
)
def test_a_value_is_in_the_region_of_its_size(value: float, expected_region: str) -> None:
    """A region is a range of values, without their sign, for which the largest error is reported.

    The lower end of a range belongs to it.
    """
    assert region_of(Fraction(value)) == expected_region


@dataclass
class CollectedErrors:
    """The rows of an audit's errors after one call, and the state of the robot after it."""

    rows: list[dict[str, Any]]
    state: dict[str, int]


def collect_errors_of_third_step(b_hat: int, x_bar: int) -> CollectedErrors:
    """Return the errors that an audit collects in a step that observes a white tile and re-estimates b_hat.

    Before, the robot has observed two black tiles and received an estimate of ``x_bar`` with alpha 1.
    """
    scenario = f"{robot(Filter.ALWAYS, b_hat)},step:1,step:1,{receive(sender=1, x_hat=x_bar)},step:0"
    step = last_call(scenario, Audit())
    audit = Audit()  # a new one, which has no errors of the calls before
    assert check_call(step, audit) == []
    return CollectedErrors(audit.as_dict()["errors"], step.new_state)


B_HAT_099, B_HAT_055 = 4252017623, 2362232013
"""0.99 and 0.55 in units of 2**-32."""
X_BAR_09, X_BAR_0505 = 7549747, 4236247
"""0.9 and 0.505 in units of 2**-23."""


@pytest.mark.parametrize(
    ("b_hat", "x_bar", "quantities_and_regions"),
    [
        (
            B_HAT_099,
            X_BAR_09,
            [("x_hat", "0.9 to 0.999"), ("alpha", "0.9 to 0.999"), ("b_hat", "0.2 to 0.9")],
        ),
        (
            B_HAT_099,
            X_BAR_0505,
            [("x_hat", "0.9 to 0.999"), ("alpha", "0.9 to 0.999"), ("b_hat", "2^-12 to 0.02")],
        ),
        # Here alpha is below 1/2, where its relative error says nothing.
        (B_HAT_055, X_BAR_09, [("x_hat", "0.02 to 0.2"), ("b_hat", "0.2 to 0.9")]),
    ],
)
def test_an_error_of_each_quantity_is_collected_in_its_region(
    b_hat: int, x_bar: int, quantities_and_regions: list[tuple[str, str]]
) -> None:
    """A robot with ``b_hat`` observes two black tiles and a white one, and receives ``x_bar``.

    Then it re-estimates b_hat. A region is a range of values: the error of each quantity is reported for it.
    """
    collected = collect_errors_of_third_step(b_hat, x_bar)
    assert [(row["quantity"], row["region"]) for row in collected.rows] == quantities_and_regions
    assert all(row["samples"] == 1 for row in collected.rows)


def collected_error(collected: CollectedErrors, quantity: str) -> float:
    """Return the error of a quantity against exact arithmetic, which must be nearly that against floats."""
    [row] = [row for row in collected.rows if row["quantity"] == quantity]
    assert abs(row["float64"] - row["exact"]) < 2**-24
    error: float = row["exact"]
    return error


in_all_regions = pytest.mark.parametrize(
    ("b_hat", "x_bar"), [(B_HAT_099, X_BAR_09), (B_HAT_099, X_BAR_0505), (B_HAT_055, X_BAR_09)]
)


@in_all_regions
def test_the_error_of_x_hat_is_its_distance_from_the_exact_one(b_hat: int, x_bar: int) -> None:
    """x_hat is the estimate of a robot that has observed three tiles, two of them black.

    It has ``b_hat``, in units of 2**-32. Its x_hat is in units of 2**-23.
    """
    collected = collect_errors_of_third_step(b_hat, x_bar)
    exact_x_hat = local_estimate(n=2, t=3, b=Fraction(b_hat, 2**32))
    error = Fraction(collected.state["x_hat"], 2**23) - exact_x_hat
    assert collected_error(collected, "x_hat") == abs(float(error))


def test_the_error_of_alpha_is_relative_to_the_exact_one() -> None:
    """alpha is the confidence of a robot that has observed three tiles, two of them black.

    It has a b_hat of 0.99, in units of 2**-32.
    """
    collected = collect_errors_of_third_step(B_HAT_099, X_BAR_09)
    alpha = Fraction(alpha_from_word(collected.state["alpha"]))
    error = alpha / exact_alpha(n=2, t=3, b=Fraction(B_HAT_099, 2**32)) - 1
    assert collected_error(collected, "alpha") == abs(float(error))


@in_all_regions
def test_the_error_of_b_hat_is_its_distance_from_the_b_hat_of_eq_8(b_hat: int, x_bar: int) -> None:
    """Equation 8 re-estimates b_hat from the black tiles, two of three, and x_bar, the others' estimate.

    x_bar is in units of 2**-23, and b_hat in units of 2**-32.
    """
    collected = collect_errors_of_third_step(b_hat, x_bar)
    exact_b_hat = assumed_accuracy_update(n=2, t=3, x_bar=Fraction(x_bar, 2**23))
    assert exact_b_hat is not None
    error = Fraction(collected.state["b_hat()"], 2**32) - exact_b_hat
    assert collected_error(collected, "b_hat") == abs(float(error))
