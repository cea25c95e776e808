"""Check what a call does to a robot with one of the paper's filters or none, in exact arithmetic.

The social values, the test and b_hat are computed anew from the sums of the round.
"""

from __future__ import annotations

from fractions import Fraction
from typing import TYPE_CHECKING

from mcp_asdf.fixed_point import HALF, ONE
from mcp_asdf.robot import Filter
from mcp_asdf.table import FRACTION_BITS
from mcp_asdf_tools.crosscheck.checks import (
    alpha_units,
    check_exact,
    check_update,
    ends_round,
    is_filter_run,
)
from mcp_asdf_tools.crosscheck.scenario import Call, CallResult, Setup, State

if TYPE_CHECKING:
    from mcp_asdf_tools.crosscheck.oracle import Audit


def check_asdf_call(
    audit: Audit, setup: Setup, call: Call, before: CallResult, after: CallResult
) -> list[str]:
    """Check x_bar and x after a call, and b_hat after the end of a round. Return a line for each problem."""
    problems = _check_means(after.state)
    if ends_round(call, after):
        problems += _check_filter(audit, setup, before.state, after.state, after.outcome == "UPDATED")
    return problems


def _check_filter(
    audit: Audit, setup: Setup, old_state: State, new_state: State, is_updated: bool
) -> list[str]:
    """Return a line for each problem of the filter at the end of a round.

    It must have re-estimated b_hat if its test (eq. 12) rejects, and not otherwise, and the result must be
    right (eq. 8).
    """
    m = old_state["open_count"]
    is_adaptive = setup.filter == Filter.ADAPTIVE
    is_run = setup.filter != Filter.OFF and is_filter_run(old_state, new_state)
    # The test needs a variance, and so two messages.
    messages_needed = 2 if is_adaptive else 1
    if not is_run or m < messages_needed:
        return check_update(is_updated, expected=False)
    if is_adaptive:
        assert setup.table is not None
        audit.tests += 1
        # Eq. 12 squared and multiplied out, which whole numbers decide exactly. Equality is no rejection.
        difference_squared = (old_state["open_x"] - m * new_state["x_hat"]) ** 2
        scaled_variance = m * old_state["open_x_squared"] - old_state["open_x"] ** 2
        # The threshold has FRACTION_BITS bits after the point, so the other side gets as many.
        threshold = setup.table.build().entry(m)
        scaled_difference_squared = difference_squared << FRACTION_BITS
        is_rejected = scaled_difference_squared > threshold * scaled_variance
        if not is_rejected:
            return check_update(is_updated, expected=False)
    x_bar = Fraction(_closed_alpha_x(new_state), new_state["closed_alpha"] * ONE)
    return audit.check_b_hat(new_state, x_bar, is_updated)


def _closed_alpha_x(state: State) -> int:
    """Return the sum of alpha x_hat of the last closed round."""
    return (state["closed_alpha_x_high"] << 32) + state["closed_alpha_x_low"]


def _check_means(state: State) -> list[str]:
    """Return what is wrong with x_bar and x, a line each. Both are quotients of integers, rounded down.

    x_bar is the mean of the neighbours' x_hat, weighted by their alpha, and x that mean with the robot's own
    x_hat among them. Without any message x_bar is 1/2 and x is the robot's own x_hat.
    """
    # Sums over the messages of the last closed round: of alpha, which is called beta, and of alpha x_hat
    beta, alpha_x = state["closed_alpha"], _closed_alpha_x(state)
    # The robot's own. Each alpha is in units of 2**-24, each x_hat in units of 2**-23.
    alpha, x_hat = alpha_units(state["alpha"]), state["x_hat"]
    x = (alpha * x_hat + alpha_x) // (alpha + beta) if alpha + beta > 0 else x_hat
    x_bar = alpha_x // beta if beta > 0 else HALF
    return check_exact(state, {"x()": x, "x_bar()": x_bar})
