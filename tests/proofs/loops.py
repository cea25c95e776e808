"""A proof that the loops of a function end within the turns that a comment beside them states."""

from __future__ import annotations

from typing import Any

import z3
from pycparser import c_ast

from proofs.machine import Machine, all_paths
from proofs.prove import Contract, always, prove_contract
from proofs.source import Program, nodes, variables_changed_by

LIMITS = {
    ("is_valid_table", "hash_index"): (0, 129),
    ("mcp_asdf_x_hat_from_code", "bits"): (1, 23),  # what its header asks of a caller
    # The number of estimates kept is that of sort_estimates(), which counts once in each of 32 turns at most.
    **{(name, "count"): (0, 32) for name in ("median_distance", "huber_step", "is_supported")},
    ("sort_estimates", "i"): (0, 31),  # the count before it is incremented
}
"""The lowest and the highest value of a variable that a loop's counter starts from or is compared with.

The key has the names of the function and of the variable.
"""
REQUIREMENTS = {"long_code_from_alpha": lambda alpha: z3.LShR(alpha, 8) != 0}
"""The condition under which a function's loop ends, by the function's name.

A condition takes the term of the function's argument. The function's callers see to it.
"""


def prove_loops_end(code: Program, name: str) -> None:
    """Prove that the loops of a function end. Raises UnprovenError if one might have more turns than stated.

    For a ``while`` the whole function is executed with unknown arguments. For a ``for`` its head is enough,
    as the body must not change the variables in the head (rule 14.2 of MISRA). Raises AssertionError if a
    body does, or if the function has a ``do`` or ``goto``, for which there is no proof here.
    """
    function = code.functions[name]
    has_other_loops = any(nodes(function, c_ast.DoWhile)) or any(nodes(function, c_ast.Goto))
    assert not has_other_loops, f"{name} may loop by do or goto"
    if any(nodes(function, c_ast.While)):
        prove_contract(code, name, {name: Contract(always, REQUIREMENTS.get(name, always))})
    for loop in nodes(function, c_ast.For):
        names_in_head = _names_in(loop.init, loop.cond, loop.next)
        changed_names = names_in_head & variables_changed_by(loop.stmt)
        assert not changed_names, f"{name}: the body of a loop changes {changed_names}"
        _prove_head_ends(code, name, loop, names_in_head)


def _prove_head_ends(code: Program, name: str, loop: Any, names_in_head: set[str]) -> None:
    """Prove that a ``for`` ends with an empty body. The variables in its head may have any value at first."""
    loop_without_body = c_ast.For(loop.init, loop.cond, loop.next, c_ast.EmptyStatement(), loop.coord)
    for machine in all_paths(code):
        for declaration in nodes(code.functions[name], c_ast.Decl):
            if declaration.name in names_in_head:
                _declare_unknown(machine, name, declaration)
        machine.evaluate(loop_without_body)


def _declare_unknown(machine: Machine, function_name: str, declaration: Any) -> None:
    """Declare a variable with any value, within its limits if it has some."""
    value = machine.fresh_argument(declaration)
    machine.declare(declaration.name, declaration.type, value)
    if (function_name, declaration.name) in LIMITS:
        lowest, highest = LIMITS[function_name, declaration.name]
        machine.facts.append(z3.And(z3.UGE(value.term, lowest), z3.ULE(value.term, highest)))


def _names_in(*trees: Any) -> set[str]:
    """Return the names that occur in some syntax trees. Parts that a loop's head lacks are None."""
    return {identifier.name for tree in trees if tree for identifier in nodes(tree, c_ast.ID)}
