"""Proofs by z3: a claim holds for all values, or some values break it, or the solver gives up."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import z3

from proofs.integers import as_integers

STEP_LIMITS = (4 * 10**6, 64 * 10**6)
"""The solver's steps for one query, in one attempt after the other."""


class UnprovenError(AssertionError):
    """Some values break a claim, or the solver cannot settle it."""


def prove(formula: Any, *facts: Any, description: str = "") -> None:
    """Prove that the formula holds for all values for which the facts hold.

    Raises UnprovenError, with values that break the formula or with the reason why the solver gave up.
    """
    # There is a proof if nothing satisfies the facts and the opposite.
    answer, explanation = check_satisfiable(*facts, z3.Not(formula))
    if answer == z3.sat:
        raise UnprovenError(f"{description}: broken by {explanation}")
    if answer == z3.unknown:
        raise UnprovenError(f"{description}: not settled, {explanation}")


def check_satisfiable(*formulas: Any) -> tuple[Any, Any]:
    """Return z3's answer whether all of the formulas can hold, and an explanation.

    The explanation is values for which they hold, or the reason why the solver gave up. It is None if they
    cannot all hold.

    Each attempt has a context of its own and counts steps, not time. So the answer depends on the text of the
    formulas alone, and not on queries before or on the load of the machine.
    """
    bit_text, integer_text, refusal = _solver_text(formulas), None, ""
    if "bvmul" in bit_text or "bvudiv" in bit_text:
        # If as_integers() cannot translate a formula, there is no query of integers. No claim is proved by
        # that: the query of words, which has all of the formulas, has to be settled instead. Nothing in this
        # block executes C, so an error of the machine about C that it does not know is never suppressed.
        try:
            integer_text = _solver_text(as_integers(formulas))
        except NotImplementedError as error:
            refusal = f"; {error}"
    # Another seed and more steps may settle what an attempt has not: the solver's search is a heuristic.
    for seed, step_limit in enumerate(STEP_LIMITS):
        for query_text in (integer_text, bit_text):
            if query_text is None:
                continue
            context = z3.Context()
            # The first settles integers within moments, the second bits.
            solver = z3.SimpleSolver(ctx=context) if query_text is integer_text else z3.Solver(ctx=context)
            solver.set(random_seed=seed, rlimit=step_limit)
            solver.from_string(query_text)
            answer = solver.check()
            if answer != z3.unknown:
                return answer, solver.model() if answer == z3.sat else None
    return answer, solver.reason_unknown() + refusal


def _solver_text(formulas: Iterable[Any]) -> str:
    """Return the text that the solver reads: the formulas, and the sort of each name in them."""
    solver = z3.SimpleSolver()
    solver.add(*formulas)
    return str(solver.sexpr())
