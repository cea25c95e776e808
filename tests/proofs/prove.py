"""Contracts of functions, and their proof: what a caller owes, and what it gets for it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import z3

from proofs.machine import Machine, PathEndsError, Pointer, Summary, all_paths, terms_of
from proofs.numbers import Number, constant
from proofs.solver import UnprovenError, check_satisfiable, prove
from proofs.source import Program

Formula = Callable[..., Any]
"""Takes terms, and returns a formula of them."""


def always(*_terms: Any) -> Any:
    """Return a formula that holds for any terms."""
    return z3.BoolVal(True)


@dataclass(frozen=True, eq=False)
class Contract:
    """The promises of a function. A formula takes the terms of the function's arguments.

    Attributes:
        ensures: What the function promises if ``requires`` held before the call. The formula takes the
            result, unless there is none, then what each pointer among the arguments points to after the call,
            and then all arguments as they were before it. Of a pointer it takes what the pointer pointed to.
            It may return several formulas: each is proved with those before it, and the last one is the
            promise.
        requires: What a caller has to fulfil.
        constant_parameter: A parameter that is a constant in all calls, or "".
        constant_values: The values of that parameter. Each has a proof of its own.
        used_lemmas: Called functions of which the proof of ``ensures`` knows their contracts alone.
        stand_ins: Summaries of other called functions in that proof.
        loop_invariant: What holds after each turn of the function's innermost loops, and is all that its
            proof knows of what a turn did. It takes two dictionaries of terms by name: the function's
            arguments before the call, and its variables after the turn.
    """

    ensures: Formula
    requires: Formula = always
    constant_parameter: str = ""
    constant_values: tuple[int, ...] = (0,)
    used_lemmas: tuple[str, ...] = ()
    stand_ins: Mapping[str, Summary] = field(default_factory=dict)
    loop_invariant: Formula | None = None


Contracts = Mapping[str, Contract]
"""Contracts of a program's functions, by name. All are proved. A proof may rely on others of them."""


def prove_contract(program: Program, name: str, contracts: Contracts) -> None:
    """Prove that the function keeps its contract, and what its code relies on, on each of its paths.

    Raises UnprovenError if the function breaks its contract for some arguments.
    """
    contract = contracts[name]
    summaries = _summaries_of_callees(program, contract, contracts)
    for constant_value in contract.constant_values:
        constants = {contract.constant_parameter: constant_value}
        is_possible = False
        for machine in all_paths(program, summaries):
            with suppress(PathEndsError):
                terms = _run_function(machine, name, contract, constants)
                # One path is enough: the solver is not asked about the others.
                is_possible = is_possible or check_satisfiable(*machine.facts)[0] == z3.sat
                for formula in _each(contract.ensures(*terms)):
                    prove(formula, *machine.facts, description=name)
                    machine.facts.append(formula)  # known in the proof of the next one
        # If no arguments fulfilled the facts, any result would.
        if not is_possible:
            raise UnprovenError(f"{name}: nothing is found that satisfies what is taken for known")


def _summaries_of_callees(program: Program, contract: Contract, contracts: Contracts) -> dict[str, Summary]:
    """Return what stands for called functions in the proof of a contract, by their names.

    These are its stand-ins, and the lemmas that it uses.
    """
    summaries = dict(contract.stand_ins)
    for lemma in contract.used_lemmas:
        requires = _requires_proved_constant(program, lemma, contracts[lemma])
        summaries[lemma] = stand_in(lemma, requires=requires, ensures=contracts[lemma].ensures)
    return summaries


def _requires_proved_constant(program: Program, name: str, contract: Contract) -> Formula:
    """Return the condition for a call: ``requires`` holds, and the constant is one that has a proof."""
    if not contract.constant_parameter:
        return contract.requires
    position = [parameter.name for parameter in program.parameters(name)].index(contract.constant_parameter)

    def requires(*terms: Any) -> Any:
        is_proved_constant = z3.Or([terms[position] == value for value in contract.constant_values])
        return z3.And(contract.requires(*terms), is_proved_constant)

    return requires


def proof_key(program: Program, name: str, contracts: Contracts) -> Any:
    """Return all that the proof of a contract depends on, so that what has the same key is proved once.

    That is the contract, the text of the function, and the lemmas that its proof relies on.
    """
    contract = contracts[name]
    # The code of functions with a stand-in is not executed, so it does not belong to the key.
    code_text = program.definition_text(name, {*contract.used_lemmas, *contract.stand_ins})
    return code_text, contract, *(contracts[lemma] for lemma in contract.used_lemmas)


def _each(formulas: Any) -> list[Any]:
    """Return one formula or several as a list."""
    return list(formulas) if isinstance(formulas, (list, tuple)) else [formulas]


def _run_function(machine: Machine, name: str, contract: Contract, constants: Mapping[str, int]) -> list[Any]:
    """Run a function on unknown arguments that fulfil what its contract requires.

    ``constants`` are the values of arguments that are known, by the parameter's name. Returns the terms that
    ``Contract.ensures`` takes.
    """
    arguments = {}
    for parameter in machine.program.parameters(name):
        argument = machine.fresh_argument(parameter)
        if parameter.name in constants:
            argument = constant(constants[parameter.name], argument.type)
        arguments[parameter.name] = argument
    argument_terms = terms_of(arguments)
    machine.facts.append(contract.requires(*argument_terms.values()))
    if contract.loop_invariant is not None:
        machine.loop_invariant = partial(contract.loop_invariant, argument_terms)
    result = machine.call(name, *arguments.values())
    return [*_result_terms(result, arguments.values()), *argument_terms.values()]


def _result_terms(result: Any, arguments: Iterable[Any]) -> list[Any]:
    """Return the terms of a result, unless it is None, and of what pointers among the arguments point to."""
    targets = [terms_of(argument) for argument in arguments if isinstance(argument, Pointer)]
    return targets if result is None else [terms_of(result), *targets]


# --- Stand-ins for called functions ------------------------------------------------------------------------


def stand_in(
    name: str, *changed_members: str, requires: Formula = always, ensures: Formula = always
) -> Summary:
    """Return a summary that stands for a called function in proofs that do not enter its code.

    The proofs only know that a caller has to fulfil ``requires``, and that ``ensures`` then holds; both are
    as in a ``Contract``. The function's result and what it writes may be anything, but depend on its
    arguments alone: see ``result_of``. It changes these members of what its first argument points to. If no
    members are given, it changes all that it may write.
    """

    def call(machine: Machine, *arguments: Any) -> Any:
        # The contract speaks of arguments as they were before the call, which may change their targets.
        terms = [terms_of(argument) for argument in arguments]
        machine.require(requires(*terms), f"what {name} requires")
        if changed_members:
            places = [Pointer(machine.load(arguments[0]), member) for member in changed_members]
        else:
            places = _writable_places(machine.program.parameters(name), arguments)
        for place in places:
            machine.store(place, _results_like(machine.load(place), f"{name} {place.key}", terms))
        result = machine.fresh_value(machine.program.signatures[name].type, name)
        result = _results_like(result, name, terms)
        promise = _each(ensures(*_result_terms(result, arguments), *terms))[-1]
        machine.facts.append(promise)
        return result

    return call


def _writable_places(parameters: list[Any], arguments: Iterable[Any]) -> list[Pointer]:
    """Return pointers to all that a function may write through its arguments.

    It writes nothing through a pointer to constants.
    """
    places = []
    for parameter, argument in zip(parameters, arguments, strict=True):
        if isinstance(argument, Pointer) and "const" not in parameter.type.type.quals:
            # A pointer to the first element stands for the array.
            keys = list(argument.container) if argument.key == 0 else [argument.key]
            places += [Pointer(argument.container, key) for key in keys]
    return places


def _results_like(value: Any, name: str, arguments: list[Any]) -> Any:
    """Return a copy of a value in which each number is the result of an unknown function of the arguments.

    Pointers in it stay the same, as no function writes one.
    """
    if isinstance(value, dict):
        return {key: _results_like(member, f"{name} {key}", arguments) for key, member in value.items()}
    return Number(result_of(name, value.term, *arguments), value.type) if isinstance(value, Number) else value


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
    """Yield all words in the terms of a value, but none of a table, as no function writes one."""
    if isinstance(terms, dict):
        for member in terms.values():
            yield from _iterate_words(member)
    elif isinstance(terms, z3.ExprRef):
        yield terms
