"""That a loop ends, whatever the memory around it holds."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import z3
from pycparser import c_ast

from proofs.machine import Machine
from proofs.numbers import Words
from proofs.prove import Contract, always, prove_obligations, prove_safe
from proofs.source import Program, nodes


def loops_in(program: Program, name: str) -> list[Any]:
    """The loops of a function, of every kind."""
    body = program.functions[name].body
    return [loop for kind in (c_ast.For, c_ast.While, c_ast.DoWhile) for loop in nodes(body, kind)]


KNOWN: dict[str, dict[str, Callable[[Any], Any]]] = {
    "table_valid": {"end": lambda end: z3.ULE(end, 129)}  # q + 2, as a head with another q is refused before
}
"""Limits that a function's earlier lines leave to variables that bound its loop."""


def prove_ends(program: Program, name: str, loop: Any) -> None:
    """A loop that counts ends by its counter alone; any other one with its function, on unknown arguments."""
    if not isinstance(loop, c_ast.For):
        prove_safe(program, name, {name: Contract(always)})
        return
    (counter,) = loop.init.decls
    assert not any(_changes(node, counter.name) for node in _writes(loop.stmt)), f"{name}: counter changed"
    machine = Machine(program, Words)
    used = {node.name for node in nodes(loop.cond, c_ast.ID)} - {counter.name}
    function = program.functions[name]
    for declaration in (*nodes(function.body, c_ast.Decl), *program.parameters(name)):
        if declaration.name in used:
            machine.declare(declaration)
            known = KNOWN.get(name, {}).get(declaration.name, always)
            machine.know(known(machine.load(machine.variable(declaration.name)).term))
    machine.execute(c_ast.For(loop.init, loop.cond, loop.next, c_ast.EmptyStatement(), loop.coord))
    prove_obligations(machine, name)


def _writes(body: Any) -> list[Any]:
    return [*nodes(body, c_ast.Assignment), *nodes(body, c_ast.UnaryOp)]


def _changes(node: Any, name: str) -> bool:
    """True if this assigns to the variable, counts it or takes its address."""
    target = node.lvalue if isinstance(node, c_ast.Assignment) else node.expr
    writes = isinstance(node, c_ast.Assignment) or node.op in ("++", "--", "p++", "p--", "&")
    return writes and isinstance(target, c_ast.ID) and target.name == name
