"""Contracts of functions, and their proof: what a caller owes, and what it gets for it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import z3

from proofs.integers import as_integers
from proofs.machine import Machine, Pointer, Summary, all_paths, terms_of
from proofs.numbers import Number
from proofs.source import Program

STEP_LIMITS = (4 * 10**6, 64 * 10**6)
"""The solver's steps for one query, in one attempt after the other."""
Formula = Callable[..., Any]
"""Takes terms, and returns a formula of them."""


class UnprovenError(AssertionError):
    """Some values break a claim, or the solver cannot settle it."""


def prove(formula: Any, *facts: Any, description: str = "") -> None:
    """Prove that the formula holds for all values for which the facts hold.

    Raises UnprovenError, with values that break the formula or with the reason why the solver gave up.
    """
    # There is a proof if nothing satisfies the facts and the opposite.
    answer, solver = _check_satisfiable(*facts, z3.Not(formula))
    if answer == z3.sat:
        raise UnprovenError(f"{description}: broken by {solver.model()}")
    if answer == z3.unknown:
        raise UnprovenError(f"{description}: not settled, {solver.reason_unknown()}")


def _check_satisfiable(*formulas: Any) -> tuple[Any, Any]:
    """Return z3's answer whether all of the formulas can hold, and the solver that gave it.

    Each attempt has a context of its own and counts steps, not time. So the answer depends on the text of the
    formulas alone, and not on queries before or on the load of the machine.
    """
    bit_text, integer_text = _solver_text(formulas), None
    if "bvmul" in bit_text or "bvudiv" in bit_text:
        # If as_integers() cannot translate a formula, there is no query of integers. No claim is proved by
        # that: the query of words, which has all of the formulas, has to be settled instead. Nothing in this
        # block executes C, so an error of the machine about C that it does not know is never suppressed.
        with suppress(NotImplementedError):
            integer_text = _solver_text(as_integers(formulas))
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
                return answer, solver
    return answer, solver


def _solver_text(formulas: Iterable[Any]) -> str:
    """Return the text that the solver reads: the formulas, and the sort of each name in them."""
    solver = z3.SimpleSolver()
    solver.add(*formulas)
    return str(solver.sexpr())


def always(*_terms: Any) -> Any:
    """Return a formula that holds for any terms."""
    return z3.BoolVal(True)


@dataclass(frozen=True, eq=False)
class Contract:
    """The promises of a function. A formula takes the terms of the function's arguments.

    Attributes:
        ensures: What holds of the result, the first argument, if ``requires`` did. Of a pointer, the argument
            is what it pointed to, and what it then points to stands behind the result. It may return several
            formulas: each is proved with those before it, and the last one is the promise.
        requires: What a caller has to fulfil.
        constant_parameter: A parameter that is a constant in all calls, or "".
        constant_values: The values of that parameter. Each has a proof of its own.
        used_lemmas: Called functions of which the proof of ``ensures`` knows their contracts alone.
        stand_ins: Summaries of other called functions in that proof.
        make_loop_invariant: Makes what is called after each turn of the function's loops, for one path: it
            claims what holds after the turn, and lets nothing else be known of what the turn did.
    """

    ensures: Formula
    requires: Formula = always
    constant_parameter: str = ""
    constant_values: tuple[int, ...] = (0,)
    used_lemmas: tuple[str, ...] = ()
    stand_ins: Mapping[str, Summary] = field(default_factory=dict)
    make_loop_invariant: Callable[[], Callable[[Machine], None]] | None = None


Contracts = Mapping[str, Contract]
"""Contracts of a program's functions, by name. All are proved. A proof may rely on others of them."""


def prove_contract(program: Program, name: str, contracts: Contracts) -> None:
    """Prove that the function keeps its contract, and what its code relies on, on each of its paths.

    Raises UnprovenError if the function breaks its contract for some arguments.
    """
    contract = contracts[name]
    summaries = _summaries_of_callees(program, contract, contracts)

    def make_machine(decisions: tuple[bool, ...]) -> Machine:
        machine = Machine(program, summaries, decisions)
        if contract.make_loop_invariant is not None:
            machine.after_loop_turn = contract.make_loop_invariant()
        return machine

    for constant_value in contract.constant_values:
        constants = {contract.constant_parameter: constant_value}
        run = partial(_run_function, name=name, requires=contract.requires, constants=constants)
        is_possible = False
        for machine, terms in all_paths(make_machine, run):
            prove_obligations(machine, name)
            if terms is not None:
                # One path is enough: the solver is not asked about the others.
                is_possible = is_possible or _check_satisfiable(*machine.facts)[0] == z3.sat
                _prove_each(_each(contract.ensures(*terms)), machine, name)
        # If no arguments fulfilled the facts, any result would.
        if not is_possible:
            raise UnprovenError(f"{name}: nothing is found that satisfies what is taken for known")


def _summaries_of_callees(program: Program, contract: Contract, contracts: Contracts) -> dict[str, Summary]:
    """Return the summaries with which a contract is proved: its stand-ins, and one for each of its lemmas."""
    summaries = dict(contract.stand_ins)
    for lemma in contract.used_lemmas:
        requires = _requires_proved_constant(program, lemma, contracts[lemma])
        summaries[lemma] = any_result(lemma, requires, contracts[lemma].ensures)
    return summaries


def _prove_each(formulas: Iterable[Any], machine: Machine, name: str) -> None:
    """Prove formulas at the end of a path. Those that are proved are facts in the proof of the next one."""
    for formula in formulas:
        prove(formula, *machine.facts, description=name)
        machine.facts.append(formula)


def prove_obligations(machine: Machine, name: str) -> None:
    """Prove the machine's obligations: they are claims on which the code of the function relies."""
    for obligation in machine.obligations:
        prove(obligation.claim, *obligation.facts, description=f"{name}: {obligation.description}")


def _requires_proved_constant(program: Program, name: str, contract: Contract) -> Formula:
    """Return the condition for a call: ``requires`` holds, and the constant is one that has a proof."""
    if not contract.constant_parameter:
        return contract.requires
    position = [parameter.name for parameter in program.parameters(name)].index(contract.constant_parameter)

    def requires(*terms: Any) -> Any:
        is_proved_constant = z3.Or([terms[position] == value for value in contract.constant_values])
        return z3.And(contract.requires(*terms), is_proved_constant)

    return requires


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
    if done_proofs is None or proof_key not in done_proofs:
        prove_contract(program, name, contracts)
    if done_proofs is not None:
        done_proofs.add(proof_key)


def _each(formulas: Any) -> list[Any]:
    """Return one formula or several as a list."""
    return list(formulas) if isinstance(formulas, (list, tuple)) else [formulas]


def _run_function(machine: Machine, name: str, requires: Formula, constants: Mapping[str, int]) -> list[Any]:
    """Run a function on unknown arguments that fulfil ``requires``, and on some constants by parameter.

    Return the terms that ``Contract.ensures`` takes.
    """
    arguments: list[Any] = []
    for parameter in machine.program.parameters(name):
        if parameter.name in constants:
            arguments.append(machine.constant_argument(parameter, constants[parameter.name]))
        else:
            arguments.append(machine.fresh_argument(parameter))
        machine.argument_terms[parameter.name] = terms_of(arguments[-1])
    argument_terms = list(machine.argument_terms.values())
    machine.facts.append(requires(*argument_terms))
    result = machine.call(name, *arguments)
    return [*_result_terms(result, arguments), *argument_terms]


def _result_terms(result: Any, arguments: Iterable[Any]) -> list[Any]:
    """Return the terms of a result, if there is one, and of what pointers among the arguments point to."""
    targets = [terms_of(argument) for argument in arguments if isinstance(argument, Pointer)]
    return targets if result is None else [terms_of(result), *targets]


# --- Stand-ins for called functions ------------------------------------------------------------------------


Writer = Callable[[Machine, Sequence[Any], Sequence[Any]], Any]
"""Executes a call: it takes a machine, arguments and their terms, writes to memory and returns the result."""


def any_result(name: str, requires: Formula = always, ensures: Formula = always) -> Summary:
    """Return a stand-in for a function of which these formulas alone are known, as those of a ``Contract``.

    It may return anything, and write anything where it may write. Only pointers in structures stay as they
    are: no function writes one.
    """

    def write_anything(machine: Machine, arguments: Sequence[Any], _terms: Sequence[Any]) -> Any:
        for parameter, argument in zip(machine.program.parameters(name), arguments, strict=True):
            # A function only reads through a pointer to constants.
            if not isinstance(argument, Pointer) or "const" in parameter.type.type.quals:
                continue
            targets = argument.container if argument.key == 0 else {argument.key: machine.load(argument)}
            for key, target in targets.items():
                argument.container[key] = _fresh_like(machine, name, target)
        return machine.fresh_value(machine.program.signatures[name].type, name)

    return _stand_in(name, requires, ensures, write_anything)


def uninterpreted(
    name: str, *changed_members: str, requires: Formula = always, ensures: Formula = always
) -> Summary:
    """Return a stand-in for a function whose result depends on its arguments alone: see ``result_of``.

    It changes these members of what the first argument points to, also depending on its arguments alone, and
    nothing else. ``requires`` and ``ensures`` are as those of a ``Contract``.
    """

    def write_results(machine: Machine, arguments: Sequence[Any], terms: Sequence[Any]) -> Any:
        for member_name in changed_members:
            pointer = arguments[0].select(member_name)
            old_member = machine.load(pointer)
            new_terms = result_of(f"{name} {member_name}", terms_of(old_member), *terms)
            machine.store(pointer, _with_terms(old_member, new_terms))
        result = machine.fresh_value(machine.program.signatures[name].type, name)
        return None if result is None else _with_terms(result, result_of(name, terms_of(result), *terms))

    return _stand_in(name, requires, ensures, write_results)


def _stand_in(name: str, requires: Formula, ensures: Formula, write: Writer) -> Summary:
    """Return a stand-in that lets ``write`` execute the call.

    It obliges the caller to ``requires``, and lets ``ensures`` be known after the call.
    """

    def call(machine: Machine, *arguments: Any) -> Any:
        # The contract speaks of arguments as they were before the call, which may change their targets.
        argument_terms = [terms_of(argument) for argument in arguments]
        machine.require(requires(*argument_terms), f"what {name} requires")
        result = write(machine, arguments, argument_terms)
        promise = _each(ensures(*_result_terms(result, arguments), *argument_terms))[-1]
        machine.facts.append(promise)
        return result

    return call


def _fresh_like(machine: Machine, name: str, value: Any) -> Any:
    """Return an unknown value with the structure of this one; pointers are the same."""
    if isinstance(value, dict):
        return {key: _fresh_like(machine, name, member) for key, member in value.items()}
    return machine.fresh_number(name, value.type) if isinstance(value, Number) else value


def result_of(name: str, shape: Any, *arguments: Any) -> Any:
    """Return terms, in the same structure as ``shape``, that an unknown function makes of these arguments.

    Equal arguments give equal results. ``shape`` may also be the number of bits of a result.
    """
    if isinstance(shape, dict):
        return {key: result_of(f"{name} {key}", member, *arguments) for key, member in shape.items()}
    # A function of the solver, of which nothing is known: it takes all words of all arguments.
    words = [word for argument in arguments for word in _iterate_words(argument)]
    result_sort = z3.BitVecSort(shape) if isinstance(shape, int) else shape.sort()
    return z3.Function(name, *(word.sort() for word in words), result_sort)(*words)


def _iterate_words(terms: Any) -> Iterator[Any]:
    """Yield all words in the terms of a value; a table has none, as no function writes one."""
    if isinstance(terms, dict):
        for member in terms.values():
            yield from _iterate_words(member)
    elif isinstance(terms, z3.ExprRef):
        yield terms


def _with_terms(value: Any, terms: Any) -> Any:
    """Return terms as numbers that have the types, and the structure, of a value."""
    if isinstance(value, dict):
        return {key: _with_terms(member, terms[key]) for key, member in value.items()}
    return Number(terms, value.type)
