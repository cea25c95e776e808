"""Contracts of functions, and their proof: what a caller owes, and what it gets for it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

import z3
from proofs.machine import Machine, Place, Summary
from proofs.numbers import Arithmetic, Number, Words
from proofs.source import Program

SECONDS = 20
"""For one query; those here take well under one."""
Formula = Callable[..., Any]


class UnprovenError(AssertionError):
    """A claim with values that break it, or one that the solver cannot settle."""


def prove(claim: Any, *known: Any, about: str = "") -> None:
    """That the claim holds for all values of which the rest is known."""
    solver = z3.Solver()
    solver.set("timeout", SECONDS * 1000)
    solver.add(*known, z3.Not(claim))
    answer = solver.check()
    if answer == z3.sat:
        raise UnprovenError(f"{about}: broken by {solver.model()}")
    if answer == z3.unknown:
        raise UnprovenError(f"{about}: not settled, {solver.reason_unknown()}")


def prove_opaque(claim: Any, *known: Any, about: str = "") -> None:
    """The same, whatever the products of unknown numbers are: all that is known of them stands in ``known``.
    What holds of any numbers in their place holds of the products, and takes no time."""
    formulas = [z3.simplify(each, som=True) if _has_integers(each) else each for each in (claim, *known)]
    names: list[tuple[Any, Any]] = []
    for formula in formulas:
        _name_products(formula, names, set())
    named = [z3.substitute(each, *names) for each in formulas]
    prove(*named, about=about)


def _has_integers(term: Any) -> bool:
    """Multiplied out, products of whole numbers are alike where they are equal; those of words are not."""
    return term.sort() == z3.IntSort() or any(_has_integers(each) for each in term.children())


def _name_products(term: Any, names: list[tuple[Any, Any]], seen: set[int]) -> None:
    """Adds a name for each product in a term that is new."""
    if term.get_id() in seen:
        return
    seen.add(term.get_id())
    if term.decl().kind() in (z3.Z3_OP_MUL, z3.Z3_OP_BMUL):
        unknown = [each for each in term.children() if not (z3.is_int_value(each) or z3.is_bv_value(each))]
        if len(unknown) > 1 and not any(term.eq(product) for product, _ in names):
            names.append((term, z3.FreshConst(term.sort())))
    for child in term.children():
        _name_products(child, names, seen)


def terms(value: Any) -> Any:
    """The solver's terms in a value: of a number one, of a structure by name."""
    if isinstance(value, Number):
        return value.term
    return {name: terms(each) for name, each in value.items()} if isinstance(value, dict) else value


def always(*_: Any) -> Any:
    return z3.BoolVal(True)


class Invariant(Protocol):
    """What stays true from turn to turn of a loop."""

    def after_turn(self, machine: Machine) -> None:
        """Claims it of what a turn left, and then knows nothing else of that."""

    def at_end(self, machine: Machine, found: Any) -> None:
        """Makes known what follows for the function's result."""


@dataclass(frozen=True)
class Contract:
    """What a function promises; formulas take the terms of its arguments.

    Attributes:
        ensures: What holds of the result, the first argument, if ``requires`` did. Of a pointer, the argument
            is what it pointed to, and what it then points to stands behind the result.
        arithmetic: In which integers this is shown.
        requires: What a caller owes for it.
        safe: What a caller owes for the function to end without a trap; by default nothing.
        result_matters: Whether callers are safe only for what it returns: to them its code is then known.
        cases: The values of a parameter that is a constant wherever the function is called.
        uses: What stands for called functions in the proof of ``ensures``.
        steps: Formulas of the same arguments that lead to ``ensures``, each proved with those before it. The
            rest of the proof then takes products for any numbers.
        invariant: Makes what follows the turns of its loops, for one run.
    """

    ensures: Formula
    arithmetic: Callable[..., Arithmetic] = Words
    requires: Formula = always
    safe: Formula = always
    result_matters: bool = False
    cases: tuple[str, Iterable[int]] = ("", (0,))
    uses: Mapping[str, Summary] = field(default_factory=dict)
    steps: tuple[Formula, ...] = ()
    invariant: Callable[[], Invariant] | None = None

    def stands_in(self, name: str) -> Summary:
        """The function as its callers may see it."""

        def summary(machine: Machine, *arguments: Any) -> Any:
            before = [_seen(machine, each) for each in arguments]
            machine.claim(self.requires(*before), f"what {name} requires")
            result = any_result(name)(machine, *arguments)
            machine.facts.append(self.ensures(*_results(machine, result, arguments), *before))
            return result

        return summary


def prove_contract(program: Program, name: str, contract: Contract) -> None:
    """That the function keeps its contract, and what its code relies on."""
    constant, values = contract.cases
    for value in values:
        machine = Machine(program, contract.arithmetic, contract.uses)
        invariant = contract.invariant() if contract.invariant else None
        machine.after_turn = invariant.after_turn if invariant else None
        before, results = _run(machine, name, contract.requires, {constant: value})
        if invariant:
            invariant.at_end(machine, results[0])
        _prove_obligations(machine, name)
        for number, step in enumerate(contract.steps, 1):
            machine.facts.append(step(*results, *before))
            prove(machine.facts[-1], *machine.facts[:-1], about=f"{name}: step {number}")
        last = prove_opaque if contract.steps else prove
        last(contract.ensures(*results, *before), *machine.facts, about=f"{name}: result")


def prove_safe(program: Program, name: str, contracts: Mapping[str, Contract]) -> None:
    """That the function traps nowhere, and no loop makes more turns than its comment says, whatever it is
    given."""
    machine = Machine(program, Words, safe_callees(name, contracts))
    _run(machine, name, contracts[name].safe, {})
    _prove_obligations(machine, name)


def safe_callees(name: str, contracts: Mapping[str, Contract]) -> dict[str, Summary]:
    """Functions that are safe for any arguments by their own lemmas: to this one, any of their results is."""
    return {
        each: any_result(each)
        for each, contract in contracts.items()
        if each != name and contract.safe is always and not contract.result_matters
    }


def any_result(name: str) -> Summary:
    """Stands for a function of which nothing is known, neither what it returns nor what it writes."""

    def summary(machine: Machine, *arguments: Any) -> Any:
        for each in arguments:
            if isinstance(each, Place):
                machine.store(each, machine.unknown(name, machine.load(each).type))
        return machine.unknown_of(machine.program.functions[name].decl.type.type, name)

    return summary


def _run(
    machine: Machine, name: str, requires: Formula, constants: Mapping[str, int]
) -> tuple[list[Any], list[Any]]:
    """Runs a function on unknown arguments of which ``requires`` is known; returns terms of the arguments
    before, and of the result and what pointers point to after."""
    parameters = machine.program.functions[name].decl.type.args.params
    arguments = [
        machine.constant_of(each.type, constants[each.name])
        if each.name in constants
        else machine.unknown_of(each.type, each.name)
        for each in parameters
    ]
    before = [_seen(machine, each) for each in arguments]
    machine.given = {each.name: term for each, term in zip(parameters, before, strict=True)}
    machine.facts.append(requires(*before))
    result = machine.call(name, *arguments)
    return before, _results(machine, result, arguments)


def _seen(machine: Machine, argument: Any) -> Any:
    return terms(machine.load(argument) if isinstance(argument, Place) else argument)


def _results(machine: Machine, result: Any, arguments: Iterable[Any]) -> list[Any]:
    pointed_to = [_seen(machine, each) for each in arguments if isinstance(each, Place)]
    return [*([] if result is None else [terms(result)]), *pointed_to]


def _prove_obligations(machine: Machine, name: str) -> None:
    for each in machine.obligations:
        prove(each.claim, *each.known, about=f"{name}: {each.about}")
