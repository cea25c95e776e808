"""The proofs give the C the meaning that a compiler gives it: both compute the same of any numbers."""

from __future__ import annotations

import ctypes
import random
from pathlib import Path
from typing import Any

import pytest
import z3

from proofs.arithmetic import RECIPROCAL_LIMITS
from proofs.machine import INTEGER_TYPES, Machine, terms_of
from proofs.numbers import IntegerType, Number
from proofs.source import ARITHMETIC, HEADER, HERE, Program, Variant, program
from support import run, slow

COUNTS = {"count": 31, "bits": 12, "prepared": 2**17}
"""The largest values of parameters that are not any number."""
EDGES = (0, 1, 2**15, 2**16, 2**29, 2**30, 2**31 - 1, 2**31, 2**32 - 1, 2**32, 2**62, 2**63, 2**64 - 1)


@pytest.mark.parametrize("variant", [HERE[0], *slow(HERE[1:])], ids=str)
def test_the_proofs_read_the_c_as_a_compiler_does(variant: Variant, tmp_path: Path) -> None:
    """Each function of the arithmetic, called twelve times with random numbers, gives the same in both.

    ``interpret`` computes what the proofs take for its result. A variant is how a target divides and shifts.
    """
    code = program(variant)
    names = functions_of_numbers(code)
    assert len(names) > 10
    library, rng = compile_functions(code, names, tmp_path), random.Random(str(variant))

    twelve_times_each = names * 12
    for name in twelve_times_each:
        arguments = draw_arguments(code, name, rng)
        result_of_compiler = call_compiled(library, name, arguments)
        result_of_proofs = interpret(code, name, arguments)
        assert result_of_proofs == result_of_compiler, f"{name}{tuple(arguments)}, {variant}"


def functions_of_numbers(code: Program) -> list[str]:
    """Return the names of the functions of the arithmetic whose parameters are numbers.

    Where reciprocals come from a table or from the compiler, functions that need one are left out.
    """
    names = []
    for name in code.defined_in(*ARITHMETIC):
        has_numbers_alone = None not in types_of_parameters(code, name)
        needs_reciprocal = "prepare" in code.closure(name)
        if has_numbers_alone and not (needs_reciprocal and code.variant.divide in RECIPROCAL_LIMITS):
            names.append(name)
    return names


def types_of_parameters(code: Program, name: str) -> list[Any]:
    """Return the types of a function's parameters: None for what is no number."""
    types = []
    for parameter in code.parameters(name):
        *_, type_name = getattr(parameter.type.type, "names", [""])
        types.append(INTEGER_TYPES.get(type_name))
    return types


def draw_arguments(code: Program, name: str, rng: random.Random) -> list[int]:
    """Draw a number for each parameter of a function."""
    parameters = zip(code.parameters(name), types_of_parameters(code, name), strict=True)
    return [draw_argument(parameter.name, type_, rng) for parameter, type_ in parameters]


def draw_argument(name: str, type_: IntegerType, rng: random.Random) -> int:
    """Draw an edge, or a number of any length, for a parameter of that name."""
    if name in COUNTS:
        return rng.randint(1, COUNTS[name])
    if rng.random() < 0.3:
        return rng.choice(EDGES) & type_.maximum
    return rng.getrandbits(rng.randint(1, type_.bits))


def interpret(code: Program, name: str, arguments: list[int]) -> int:
    """Call a function in the machine of the proofs, and return the value of its term."""
    types = types_of_parameters(code, name)
    numbers = []
    for argument, type_ in zip(arguments, types, strict=True):
        numbers.append(Number(z3.BitVecVal(argument, type_.bits), type_))
    result = terms_of(Machine(code).call(name, *numbers))
    if isinstance(result, dict):  # a pair of words
        result = z3.Concat(result["high"], result["low"])
    return int(z3.simplify(result).as_long())


def call_compiled(library: ctypes.CDLL, name: str, arguments: list[int]) -> int:
    """Call a function as the compiler has translated it, and return its result."""
    function = getattr(library, f"call_{name}")
    function.restype = ctypes.c_uint64
    return int(function(*map(ctypes.c_uint64, arguments)))


def compile_functions(code: Program, names: list[str], folder: Path) -> ctypes.CDLL:
    """Compile functions of a variant into a library, in a folder; there they take and return long words."""
    lines = ['#include "mcp_asdf_arithmetic.h"']
    for name in names:
        parameters = [parameter.name for parameter in code.parameters(name)]
        declarations = ", ".join(f"uint64_t {parameter}" for parameter in parameters)
        result = f"{name}({', '.join(parameters)})"
        if "word_pair_t" in str(code.functions[name].decl.type.type.type.names):
            body = f"const word_pair_t pair = {result}; return join(pair.high, pair.low);"
        else:
            body = f"return {result};"
        lines.append(f"uint64_t call_{name}({declarations}) {{ {body} }}")
    (folder / "calls.c").write_text("\n".join(lines), encoding="utf-8")
    flags = ("-std=gnu99", "-O1", "-shared", "-fPIC", f"-I{HEADER.parent}", *code.variant.flags())
    run("gcc", *flags, "calls.c", "-o", "calls.so", cwd=folder)
    return ctypes.CDLL(str(folder / "calls.so"))
