"""Check what a call does to a robot with one of the paper's filters or none, in exact arithmetic.

The social values, the test and b_hat are computed anew from the sums of the round.
"""

from __future__ import annotations

from fractions import Fraction

from mcp_asdf.fixed_point import HALF, ONE
from mcp_asdf.robot import Filter
from mcp_asdf.table import FRACTION_BITS
from mcp_asdf_tools.crosscheck.audit import Audit
from mcp_asdf_tools.crosscheck.checks import alpha_units, check_exact, check_whether_updated
from mcp_asdf_tools.crosscheck.scenario import CallRecord, State


def check_asdf_call(record: CallRecord, audit: Audit) -> list[str]:
    """Check x_bar and x after a call, and b_hat after the end of a round. Return one line per problem.

    A test that the filter had to make is counted in ``audit``, which also collects the error of b_hat.
    """
    problems = _check_means(record.new_state)
    if record.is_end_of_round:
        problems += _check_filter(record, audit)
    return problems


def _check_filter(record: CallRecord, audit: Audit) -> list[str]:
    """Check the filter at the end of a round, and return one line per problem.

    b_hat must have been re-estimated, to the right value (eq. 8), if the adaptive filter's test (eq. 12)
    rejects, or if the filter is the one without a test. It must not have been where the filter does not run,
    where the round has no message, or where it has a single one and the filter is adaptive. Each test is
    counted in ``audit.tests``, and the error of a re-estimated b_hat is added to ``audit.errors``.
    """
    filter_number = record.setup.filter
    if filter_number == Filter.OFF or not record.had_to_run_filter:
        return check_whether_updated(record.is_updated, expected=False)
    message_count = record.old_state["open_count"]
    # The adaptive filter's test needs a variance, and so two messages.
    messages_needed = 2 if filter_number == Filter.ADAPTIVE else 1
    if message_count < messages_needed:
        return check_whether_updated(record.is_updated, expected=False)
    if filter_number == Filter.ADAPTIVE:
        audit.tests += 1
        if not _test_rejects(record):
            return check_whether_updated(record.is_updated, expected=False)
    new_state = record.new_state
    # The mean of the neighbours' x_hat in the round that has ended, of which ONE is an x_hat of 1.
    x_bar = Fraction(_closed_alpha_x(new_state), new_state["closed_alpha"] * ONE)
    return audit.check_b_hat(record, x_bar)


def _test_rejects(record: CallRecord) -> bool:
    """Return whether the test (eq. 12) rejects the robot's x_hat by the messages of the round that has ended.

    Equality is no rejection.
    """
    table_choice = record.setup.table
    assert table_choice is not None
    # The sums of the round are still there before the call, and a ``step`` computes x_hat in the call.
    m = record.old_state["open_count"]
    sum_x, sum_x_squared = record.old_state["open_x"], record.old_state["open_x_squared"]
    x_hat = record.new_state["x_hat"]  # in units of 2**-23
    # X and S are the mean and the standard deviation of the m estimates, and eq. 12 is
    #     |X - x_hat| > (t / sqrt(m) + 1) S
    # Whole numbers decide it exactly, once both sides are squared and multiplied by m**2. What then stands
    # before m (m - 1) S**2 is the table's entry, (t / sqrt(m) + 1)**2 m / (m - 1).
    threshold = table_choice.build().entry(m)  # with FRACTION_BITS bits after the point
    squared_difference = (sum_x - m * x_hat) ** 2  # m**2 (X - x_hat)**2
    scaled_variance = m * sum_x_squared - sum_x**2  # m (m - 1) S**2
    return (squared_difference << FRACTION_BITS) > threshold * scaled_variance


def _closed_alpha_x(state: State) -> int:
    """Return the sum of alpha x_hat of the last closed round.

    A robot keeps it in two parts: with the lowest 32 bits of each alpha, and with the bits above these.
    """
    return (state["closed_alpha_x_high"] << 32) + state["closed_alpha_x_low"]


def _check_means(state: State) -> list[str]:
    """Check x_bar and x, which are quotients of integers, rounded down. Return one line per wrong value.

    x_bar is the mean of the neighbours' x_hat, weighted by their alpha, and x that mean with the robot's own
    x_hat among them. If all weights of a mean are 0, x_bar must be 1/2, and x the robot's own x_hat.
    """
    # Sums over the messages of the last closed round: of alpha, which is called beta, and of alpha x_hat
    beta, alpha_x = state["closed_alpha"], _closed_alpha_x(state)
    x_bar = HALF
    if beta > 0:
        x_bar = alpha_x // beta
    # The robot's own. Each alpha is in units of 2**-24, each x_hat in units of 2**-23.
    own_alpha, own_x_hat = alpha_units(state["alpha"]), state["x_hat"]
    x = own_x_hat
    if own_alpha + beta > 0:
        x = (own_alpha * own_x_hat + alpha_x) // (own_alpha + beta)
    # Names that end in () are results of methods, of which the state has the values, too.
    return check_exact(state, {"x()": x, "x_bar()": x_bar})
