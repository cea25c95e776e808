"""Contracts of functions, and their proof: what a caller owes, and what it gets for it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import z3

from proofs.machine import Location, Machine, Summary
from proofs.numbers import BitVectorArithmetic, IntegerArithmetic
from proofs.source import Program

STEP_LIMITS = (10**6, 8 * 10**6, 64 * 10**6)
"""The solver's steps for one query, in one attempt after the other. With ten seeds none needed more than 5
million: the last attempt gives twelve times as many."""
SOLVER_KINDS = (z3.SimpleSolver, z3.Solver)
"""The solvers of each attempt. The first settles integers within moments, the second long bit vectors."""
Formula = Callable[..., Any]
"""Takes terms, and returns a formula of them."""


class UnprovenError(AssertionError):
    """Some values break a claim, or the solver cannot settle it."""


class Claim(NamedTuple):
    """A formula to prove, with its name, for all values for which the assumptions hold."""

    name: str
    formula: Any
    assumptions: list[Any]


def prove(formula: Any, *assumptions: Any, description: str = "") -> None:
    """Prove that the formula holds for all values for which the assumptions hold.

    Raises UnprovenError, with values that break the formula or with the reason why the solver gave up.
    """
    # There is a proof if nothing satisfies the assumptions and the opposite.
    answer, solver = _check_satisfiable(*assumptions, z3.Not(formula))
    if answer == z3.sat:
        raise UnprovenError(f"{description}: broken by {solver.model()}")
    if answer == z3.unknown:
        raise UnprovenError(f"{description}: not settled, {solver.reason_unknown()}")


def _solver_text(formulas: Iterable[Any]) -> str:
    """Return the text that the solver reads: the formulas, and the sort of each name in them."""
    solver = z3.Solver()
    solver.add(*formulas)
    return str(solver.sexpr())


def _check_satisfiable(*formulas: Any) -> tuple[Any, Any]:
    """Return z3's answer whether all of the formulas can hold, and the solver that gave it.

    Each attempt has a context of its own and counts steps, not time. So the answer depends on the text of the
    formulas alone, and not on queries before or on the load of the machine.
    """
    query_text = _solver_text(formulas)
    # Another seed and more steps may settle what an attempt has not: the solver's search is a heuristic.
    for seed, step_limit in enumerate(STEP_LIMITS):
        for make_solver in SOLVER_KINDS:
            solver = make_solver(ctx=z3.Context())
            solver.set(random_seed=seed, rlimit=step_limit)
            solver.from_string(query_text)
            answer = solver.check()
            if answer != z3.unknown:
                return answer, solver
    return answer, solver


def require_satisfiable(assumptions: Iterable[Any], description: str) -> None:
    """Require that something satisfies the assumptions of a proof: anything follows from a contradiction."""
    answer, _solver = _check_satisfiable(*assumptions)
    if answer != z3.sat:
        raise UnprovenError(f"{description}: nothing is found that satisfies what is taken for known")


def prove_all(claims: Iterable[Claim]) -> None:
    """Prove each claim, and that its assumptions can be satisfied. No claims at all are an error."""
    satisfiable_texts = set[str]()
    for claim in claims:
        query_text = _solver_text(claim.assumptions)
        # Many claims share their assumptions, which need one check.
        if query_text not in satisfiable_texts:
            require_satisfiable(claim.assumptions, claim.name)
        satisfiable_texts.add(query_text)
        prove(claim.formula, *claim.assumptions, description=claim.name)
    if not satisfiable_texts:
        raise UnprovenError("nothing is claimed")


def always(*_terms: Any) -> Any:
    """Return a formula that holds for any terms."""
    return z3.BoolVal(True)


@dataclass(frozen=True, eq=False)
class Contract:
    """The promises of a function. A formula takes the terms of the function's arguments.

    Attributes:
        ensures: What holds of the result, the first argument, if ``requires`` did. Of a pointer, the argument
            is what it pointed to, and what it then points to stands behind the result.
        arithmetic: The kind of terms with which ``ensures`` is proved.
        requires: What a caller has to fulfil.
        constant_parameter: A parameter that is a constant in all calls, or "".
        constant_values: The values of that parameter. Each has a proof of its own.
        used_lemmas: Called functions of which the proof of ``ensures`` knows their contracts alone.
        stand_ins: Summaries of other called functions in that proof.
        proof_steps: Claims that lead to ``ensures``. Each is proved with the claims before it.
        make_loop_invariant: Makes what is called after each turn of the function's loops, for one run: it
            claims what holds after the turn, and lets nothing else be known of what the turn did.
    """

    ensures: Formula
    arithmetic: type[BitVectorArithmetic | IntegerArithmetic] = BitVectorArithmetic
    requires: Formula = always
    constant_parameter: str = ""
    constant_values: tuple[int, ...] = (0,)
    used_lemmas: tuple[str, ...] = ()
    stand_ins: Mapping[str, Summary] = field(default_factory=dict)
    proof_steps: tuple[Formula, ...] = ()
    make_loop_invariant: Callable[[], Callable[[Machine], None]] | None = None

    def as_summary(self, name: str) -> Summary:
        """Return a stand-in for the function ``name`` that knows its contract alone.

        Each call becomes an obligation to fulfil ``requires``. The result is any that fulfils ``ensures``.
        """

        def call_by_contract(machine: Machine, *arguments: Any) -> Any:
            # The contract speaks of arguments as they were before the call, which may change their targets.
            argument_terms = [machine.terms_of(argument) for argument in arguments]
            machine.require(self.requires(*argument_terms), f"what {name} requires")
            result = any_result(name)(machine, *arguments)
            result_terms = _result_terms(machine, result, arguments)
            machine.assume(self.ensures(*result_terms, *argument_terms))
            return result

        return call_by_contract


Contracts = Mapping[str, Contract]
"""Contracts of a program's functions, by name. All are proved. A proof may rely on others of them."""


def prove_contract(program: Program, name: str, contracts: Contracts) -> None:
    """Prove that the function keeps its contract, and what its code relies on.

    Raises UnprovenError if the function breaks its contract for some arguments.
    """
    contract = contracts[name]
    lemmas = {lemma: contracts[lemma].as_summary(lemma) for lemma in contract.used_lemmas}
    if not contract.constant_values:
        raise UnprovenError(f"{name}: there is no case")
    for constant_value in contract.constant_values:
        machine = Machine(program, contract.arithmetic, {**lemmas, **contract.stand_ins})
        if contract.make_loop_invariant is not None:
            machine.after_loop_turn = contract.make_loop_invariant()
        constants = {contract.constant_parameter: constant_value}
        argument_terms, result_terms = _run_function(machine, name, contract.requires, constants)
        prove_obligations(machine, name)
        # If no arguments fulfilled the facts, any result would.
        require_satisfiable(machine.facts, name)
        proved_formulas: list[Any] = []
        for step_number, make_formula in enumerate((*contract.proof_steps, contract.ensures), start=1):
            formula = make_formula(*result_terms, *argument_terms)
            description = f"{name}: step {step_number}"
            prove(formula, *machine.facts, *proved_formulas, description=description)
            proved_formulas.append(formula)


def prove_lemma(
    program: Program, name: str, contracts: Contracts, done_proofs: set[Any] | None = None
) -> None:
    """Prove that the function keeps its contract, unless this proof is among ``done_proofs``, and add it.

    A proof is done if the contract, the text of the function, and the lemmas that it relies on are the same.
    Raises UnprovenError if the function breaks its contract for some arguments.
    """
    contract = contracts[name]
    # The code of functions with a stand-in is not executed, so it does not belong to the key.
    code_text = program.definition_text(name, {*contract.used_lemmas, *contract.stand_ins})
    proof_key = (code_text, contract, *(contracts[lemma] for lemma in contract.used_lemmas))
    if done_proofs is not None and proof_key in done_proofs:
        return
    prove_contract(program, name, contracts)
    if done_proofs is not None:
        done_proofs.add(proof_key)


def any_result(name: str) -> Summary:
    """Return a stand-in for a function. It may return anything, and write anything where it may write.

    Only pointers in structures stay as they are: no function writes one.
    """

    def call_anything(machine: Machine, *arguments: Any) -> Any:
        for parameter, argument in zip(machine.program.parameters(name), arguments, strict=True):
            if not isinstance(argument, Location):
                continue
            target_type = parameter.type.type
            # A function only reads through a pointer to constants.
            if "const" in target_type.quals:
                continue
            old_value, new_value = machine.load(argument), machine.fresh_value(target_type, name)
            if isinstance(old_value, dict):
                pointers = {key: member for key, member in old_value.items() if isinstance(member, Location)}
                new_value |= pointers
            machine.store(argument, new_value)
        return machine.fresh_value(machine.program.signatures[name].type, name)

    return call_anything


def _run_function(
    machine: Machine, name: str, requires: Formula, constants: Mapping[str, int]
) -> tuple[list[Any], list[Any]]:
    """Run a function on unknown arguments that fulfil ``requires``, and on some constants by parameter.

    Return the terms of the arguments before the call, and the result terms of ``Contract.ensures`` after it.
    """
    parameters = machine.program.parameters(name)
    arguments: list[Any] = []
    for parameter in parameters:
        if parameter.name in constants:
            arguments.append(machine.constant_argument(parameter, constants[parameter.name]))
        else:
            arguments.append(machine.fresh_argument(parameter))
    argument_terms = [machine.terms_of(argument) for argument in arguments]
    parameter_names = [parameter.name for parameter in parameters]
    machine.argument_terms = dict(zip(parameter_names, argument_terms, strict=True))
    machine.facts.append(requires(*argument_terms))
    result = machine.call(name, *arguments)
    return argument_terms, _result_terms(machine, result, arguments)


def _result_terms(machine: Machine, result: Any, arguments: Iterable[Any]) -> list[Any]:
    """Return the terms of a result, if there is one, and of what pointers among the arguments point to."""
    targets = [machine.terms_of(argument) for argument in arguments if isinstance(argument, Location)]
    return targets if result is None else [machine.terms_of(result), *targets]


def prove_obligations(machine: Machine, name: str) -> None:
    """Prove the claims that the machine met in a function, each from what was known there."""
    for obligation in machine.obligations:
        description = f"{name}: {obligation.description}"
        prove(obligation.claim, *obligation.assumptions, description=description)
