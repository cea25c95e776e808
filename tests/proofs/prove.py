"""Contracts of functions, and their proof: what a caller owes, and what it gets for it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import z3

from proofs.machine import Machine, Place, Summary
from proofs.numbers import Integers, Words
from proofs.source import Program

EFFORTS = (10**6, 8 * 10**6, 64 * 10**6)
"""The solver's steps for one query, in one attempt after the other. With ten seeds none needed more than 5
million: the last attempt gives twelve times as many."""
SOLVERS = (z3.SimpleSolver, z3.Solver)
"""The solvers of each attempt. The first settles whole numbers within moments, the second long words."""
Formula = Callable[..., Any]


class UnprovenError(AssertionError):
    """Some values break a claim, or the solver cannot settle it."""


def prove(claim: Any, *known: Any, about: str = "") -> None:
    """Prove that the claim holds for all values for which the rest is known to hold."""
    answer, solver = _answer(*known, z3.Not(claim))
    if answer == z3.sat:
        raise UnprovenError(f"{about}: broken by {solver.model()}")
    if answer == z3.unknown:
        raise UnprovenError(f"{about}: not settled, {solver.reason_unknown()}")


def _text(formulas: Iterable[Any]) -> str:
    """Return the text that the solver reads: the formulas, and the sort of each name in them."""
    query = z3.Solver()
    query.add(*formulas)
    return str(query.sexpr())


def _answer(*formulas: Any) -> tuple[Any, Any]:
    """Return whether all of the formulas can hold, and the solver that knows.

    Each attempt has a context of its own and counts steps, not time. So the answer depends on the text of the
    formulas alone, and not on queries before or on the load of the machine.
    """
    text = _text(formulas)
    for seed, steps in enumerate(EFFORTS):
        for make in SOLVERS:
            solver = make(ctx=z3.Context())
            solver.set(random_seed=seed, rlimit=steps)
            solver.from_string(text)
            answer = solver.check()
            if answer != z3.unknown:
                return answer, solver
    return answer, solver


def require_possible(known: Iterable[Any], about: str) -> None:
    """Require that something satisfies the premises of a proof: anything follows from a contradiction."""
    if _answer(*known)[0] != z3.sat:
        raise UnprovenError(f"{about}: nothing is found that satisfies what is taken for known")


def prove_all(claims: Iterable[tuple[str, Any, list[Any]]]) -> None:
    """Prove each claim, which has a name, from what is known of it."""
    possible = set[str]()
    for about, claim, known in claims:
        text = _text(known)
        if text not in possible:
            require_possible(known, about)
        possible.add(text)
        prove(claim, *known, about=about)
    if not possible:
        raise UnprovenError("nothing is claimed")


def always(*_: Any) -> Any:
    return z3.BoolVal(True)


@dataclass(frozen=True, eq=False)
class Contract:
    """The promises of a function. A formula takes the terms of the function's arguments.

    Attributes:
        ensures: What holds of the result, the first argument, if ``requires`` did. Of a pointer, the argument
            is what it pointed to, and what it then points to stands behind the result.
        arithmetic: Integers in which ``ensures`` is proved.
        requires: What a caller has to fulfil.
        cases: A parameter that is a constant in all calls, and its values. Each value has a proof of its own.
        uses: Called functions that are known by their lemmas in the proof of ``ensures``.
        instead: Stand-ins for other called functions in that proof.
        steps: Claims that lead to ``ensures``. Each is proved with the claims before it.
        invariant: Makes what is called after each turn of its loops, for one run: it claims what the turn
            left, and lets nothing else be known of that.
    """

    ensures: Formula
    arithmetic: type[Words | Integers] = Words
    requires: Formula = always
    cases: tuple[str, tuple[int, ...]] = ("", (0,))
    uses: tuple[str, ...] = ()
    instead: Mapping[str, Summary] = field(default_factory=dict)
    steps: tuple[Formula, ...] = ()
    invariant: Callable[[], Callable[[Machine], None]] | None = None

    def stands_in(self, name: str) -> Summary:
        """Return the function as its callers may see it."""

        def summary(machine: Machine, *arguments: Any) -> Any:
            before = [machine.seen(each) for each in arguments]
            machine.claim(self.requires(*before), f"what {name} requires")
            result = any_result(name)(machine, *arguments)
            machine.know(self.ensures(*_results(machine, result, arguments), *before))
            return result

        return summary


Contracts = Mapping[str, Contract]
"""Contracts of a program's functions, by name. All are proved. A proof may rely on others of them."""


def prove_contract(program: Program, name: str, contracts: Contracts) -> None:
    """Prove that the function keeps its contract, and what its code relies on."""
    contract = contracts[name]
    lemmas = {each: contracts[each].stands_in(each) for each in contract.uses}
    constant, values = contract.cases
    if not values:
        raise UnprovenError(f"{name}: there is no case")
    for value in values:
        machine = Machine(program, contract.arithmetic, {**lemmas, **contract.instead})
        machine.after_turn = contract.invariant() if contract.invariant else None
        before, results = _run(machine, name, contract.requires, {constant: value})
        prove_obligations(machine, name)
        require_possible(machine.facts, name)
        shown: list[Any] = []
        for number, step in enumerate((*contract.steps, contract.ensures), 1):
            formula = step(*results, *before)
            prove(formula, *machine.facts, *shown, about=f"{name}: step {number}")
            shown.append(formula)


def prove_lemma(program: Program, name: str, contracts: Contracts, done: set[Any] | None = None) -> None:
    """Prove that the function keeps its contract, unless this proof is among the ``done`` proofs.

    A proof is done if the contract, the text of the function, and the lemmas that it relies on are the same.
    Raises UnprovenError if the function breaks its contract for some arguments.
    """
    if done is None:
        done = set()
    contract = contracts[name]
    text = program.text(name, {*contract.uses, *contract.instead})
    key = (text, contract, *(contracts[each] for each in contract.uses))
    if key not in done:
        prove_contract(program, name, contracts)
    done.add(key)


def any_result(name: str) -> Summary:
    """Return a stand-in for a function. It may return anything, and write anything where it may write.

    Only pointers in structures stay as they are: no function writes one.
    """

    def summary(machine: Machine, *arguments: Any) -> Any:
        for parameter, each in zip(machine.program.parameters(name), arguments, strict=True):
            if isinstance(each, Place) and "const" not in parameter.type.type.quals:
                before, after = machine.load(each), machine.unknown_of(parameter.type.type, name)
                if isinstance(before, dict):
                    after |= {member: at for member, at in before.items() if isinstance(at, Place)}
                machine.store(each, after)
        return machine.unknown_of(machine.program.heads[name].type, name)

    return summary


def _run(
    machine: Machine, name: str, requires: Formula, constants: Mapping[str, int]
) -> tuple[list[Any], list[Any]]:
    """Run a function on unknown arguments that fulfil ``requires``. Return the terms of the arguments before,
    and the terms of the result and of the targets of pointers after."""
    parameters = machine.program.parameters(name)
    arguments = [
        machine.constant_of(each.type, constants[each.name])
        if each.name in constants
        else machine.parameter_of(each)
        for each in parameters
    ]
    before = [machine.seen(each) for each in arguments]
    machine.given = {each.name: term for each, term in zip(parameters, before, strict=True)}
    machine.facts.append(requires(*before))
    result = machine.call(name, *arguments)
    return before, _results(machine, result, arguments)


def _results(machine: Machine, result: Any, arguments: Iterable[Any]) -> list[Any]:
    pointed_to = [machine.seen(each) for each in arguments if isinstance(each, Place)]
    return [*([] if result is None else [machine.seen(result)]), *pointed_to]


def prove_obligations(machine: Machine, name: str) -> None:
    for each in machine.obligations:
        prove(each.claim, *each.known, about=f"{name}: {each.about}")
