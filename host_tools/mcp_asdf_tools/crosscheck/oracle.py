"""Check the calls of a scenario against the paper's equations, in exact fractions.

x_hat and alpha are computed anew from t, n and b_hat. Values that have one right result must have it to the
last bit. The others must keep the bounds of ``bounds``. What depends on the robot's filter is checked by the
functions of ``checked_filters``.
"""

from __future__ import annotations

from fractions import Fraction

from mcp_asdf.fixed_point import ONE
from mcp_asdf_tools.crosscheck.audit import Audit
from mcp_asdf_tools.crosscheck.bounds import alpha_bounds, x_hat_bounds
from mcp_asdf_tools.crosscheck.checked_filters import checked_filter_of
from mcp_asdf_tools.crosscheck.checks import alpha_units, check_bounds
from mcp_asdf_tools.crosscheck.scenario import CallRecord


def check_call(record: CallRecord, audit: Audit) -> list[str]:
    """Check a call by the states before and after it, and return one line per problem.

    The invariants are checked after every call, and so is what depends on the filter, such as x_bar, x and
    changes of b_hat. After an observation x_hat and alpha are checked, too. Errors of results, and events of
    filters, are added to ``audit``.
    """
    problems = []
    if not record.new_state["holds_invariants()"]:
        problems.append("the invariants do not hold")
    if record.is_observation:
        problems += _check_estimate(record, audit)
    checked_filter = checked_filter_of(record.setup.filter)
    return problems + checked_filter.check_call(record, audit)


def _check_estimate(record: CallRecord, audit: Audit) -> list[str]:
    """Check x_hat and alpha after an observation, and return one line per value that is out of its bounds.

    Their errors are added to ``audit``.
    """
    n, t = record.new_state["n"], record.new_state["t"]
    # They were computed before the call may have re-estimated b_hat.
    b_hat = Fraction(record.old_state["b_hat()"], 2**32)
    x_hat = Fraction(record.new_state["x_hat"], ONE)
    alpha = Fraction(alpha_units(record.new_state["alpha"]), 2**24)
    audit.collect_error_of_x_hat(n, t, b_hat, x_hat)
    audit.collect_error_of_alpha(n, t, b_hat, alpha)
    problems = check_bounds("x_hat", x_hat, x_hat_bounds(n, t, b_hat))
    return problems + check_bounds("alpha", alpha, alpha_bounds(n, t, b_hat))
