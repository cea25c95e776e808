"""The machine gives C the meaning that a compiler gives it, and refuses what C leaves undefined."""

from __future__ import annotations

import ctypes
import random
from itertools import product
from pathlib import Path
from typing import Any

import pytest
import z3

from proofs.arithmetic import RECIPROCAL_LIMITS
from proofs.machine import INTEGER_TYPES, all_paths, terms_of
from proofs.numbers import IntegerType, Number, constant
from proofs.prove import Contract, always, prove_contract
from proofs.solver import UnprovenError
from proofs.source import ARITHMETIC, HEADER, HERE, Program, Variant, program
from support import run, slow

WORD = INTEGER_TYPES["uint32_t"]


def results_on_paths(code: Program, name: str, *arguments: Number) -> list[tuple[Any, Any]]:
    """Execute a function on all of its paths.

    Returns pairs of the condition under which a path is taken, and of the result that it has there.
    """
    results = []
    for machine in all_paths(code):
        result = terms_of(machine.call(name, *arguments))
        if isinstance(result, dict):  # a pair of words
            result = z3.Concat(result["high"], result["low"])
        results.append((z3.And(machine.facts), result))
    return results


def compile_library(folder: Path, source_text: str, *flags: str) -> ctypes.CDLL:
    """Compile a C file into a library, both in a folder."""
    (folder / "calls.c").write_text(source_text, encoding="utf-8")
    run("gcc", "-std=gnu99", "-O1", "-shared", "-fPIC", *flags, "calls.c", "-o", "calls.so", cwd=folder)
    return ctypes.CDLL(str(folder / "calls.so"))


# --- Unknown numbers ---------------------------------------------------------------------------------------

EDGES = (0, 1, 3, 6, 8, 200, 2**31 - 1, 2**31, 2**32 - 1)


def function_text(body: str) -> str:
    """Return the text of a C file with a function f of two words a and b, which has this body."""
    return f"#include <stdint.h>\nuint32_t f(uint32_t a, uint32_t b) {{ {body} }}\n"


def parse_function(folder: Path, body: str) -> Program:
    """Parse a function f of two words a and b with this body, in a file in a folder."""
    path = folder / "f.c"
    path.write_text(function_text(body), encoding="utf-8")
    return Program(path, Variant("1000"))


BODIES = {
    "two branches": ("uint32_t r = 0; if (a > 7U) { r += 1U; } if (b > 7U) { r += 2U; } return r;"),
    "a longer type repeats the sign": "return (uint32_t)(int8_t)(a & 255U);",
    "a shift to the right repeats the sign": "return (uint32_t)((int32_t)a >> 1);",
    "a shorter type keeps the lower bits": "const uint8_t sum = (uint8_t)(a + b); return sum;",
    "a negative number becomes a large one beside an unsigned one": "return (int32_t)a < 7U;",
    "a hexadecimal number that fits no int is unsigned": "return (int32_t)a < 0x80000000;",
    "a choice has the type of both its operands": "return (uint32_t)((uint64_t)(a > 7U ? -1 : b) >> 32);",
    "a truth value is 1 for every number but 0": "const _Bool is_set = (_Bool)a; return is_set;",
    "an unknown element is written": (
        "uint32_t words[2]; words[0] = a; words[1] = b; words[b & 1U] = 0; return words[0];"
    ),
    "a variable is written through a pointer": "uint32_t *p = &a; *p = b; return a;",
    "the value of a++ is the old one": "const uint32_t old = a++; return old;",
    "a loop has no turn, or some": (
        "while (a > 3U) { /* at most 3 turns */ a = a > 5U ? 5U : a - 1U; } return a;"
    ),
    "an operand that is not chosen is not evaluated": "return b != 0U ? a / b : 7U;",
    "the right operand counts if the left one is true": "return b != 0U && a / b > 1U;",
    "the right operand counts if the left one is false": "return b == 0U || a / b > 1U;",
    "the members of a union share their bits": (
        "union { uint32_t word; uint8_t bytes[4]; } u = {a}; u.bytes[2] = (uint8_t)b; return u.word;"
    ),
}
"""Bodies of functions of two words, a and b, by the rule of C that each shows."""


@pytest.mark.parametrize("body", BODIES.values(), ids=BODIES.keys())
def test_a_function_of_unknown_numbers_means_what_a_compiler_makes_of_it(body: str, tmp_path: Path) -> None:
    """The function has two words a and b, which may be anything, so that it has a path for each decision.

    Each pair of edges meets the conditions of one path, whose result is then that of the compiled function.
    """
    words = [Number(z3.BitVec(name, 32), WORD) for name in "ab"]
    paths = results_on_paths(parse_function(tmp_path, body), "f", *words)
    library = compile_library(tmp_path, function_text(body))
    library.f.restype = ctypes.c_uint32

    for a, b in product(EDGES, repeat=2):
        values = [(words[0].term, z3.BitVecVal(a, 32)), (words[1].term, z3.BitVecVal(b, 32))]
        assert result_for(values, paths) == library.f(ctypes.c_uint32(a), ctypes.c_uint32(b)), (a, b)


def result_for(values: list[tuple[Any, Any]], paths: list[tuple[Any, Any]]) -> int:
    """Return the result of the one path that is taken if the unknown words have some values.

    ``values`` are pairs of an unknown word and its value, and ``paths`` are pairs of a path's condition and
    its result.
    """
    (result,) = [
        z3.simplify(z3.substitute(result, *values))
        for condition, result in paths
        if z3.is_true(z3.simplify(z3.substitute(condition, *values)))
    ]
    return int(result.as_long())


UNDEFINED_BODIES = {
    # b & 32U may be 32, and a has 32 bits.
    "if (a > 7U) { a = 7U; } return a << (b & 32U);": "shift by the width",
    "return b > 7U ? a >> 32 : a;": "shift by the width",
    # The quotient comes before the comparison of b with 0.
    "return a / b > 1U || b == 0U;": "division by 0",
    # The sum of two numbers of 31 bits may exceed the largest int32_t.
    "return (uint32_t)((int32_t)(a >> 1) + (int32_t)(b >> 1));": "overflow of +",
    # A byte becomes an int, of which the highest bit is the sign.
    "return (uint32_t)((uint8_t)a << 24);": "overflow of <<",
    # a % 4U may be 3, and the last element is words[2].
    "uint32_t words[3]; words[a % 4U] = b; return words[0];": "an element",
    # b & 3U may be 3, and i then has the values 0 to 3, in four turns.
    "for (uint32_t i = 0; i <= (b & 3U); ++i) { /* at most 3 turns */ ++a; } return a;": "at most 3 turns",
}
"""Bodies of functions of two words, a and b, with the error of each.

C leaves open what the body does, or the body breaks its bound.
"""


@pytest.mark.parametrize(("body", "description"), UNDEFINED_BODIES.items(), ids=UNDEFINED_BODIES.values())
def test_code_that_c_leaves_undefined_or_that_breaks_its_bound_is_refused(
    body: str, description: str, tmp_path: Path
) -> None:
    """The body breaks a rule of C, or a bound that a comment states, for some words a and b.

    The contract says nothing about the result. So its proof can only fail at the code that breaks the rule,
    and the error has the ``description`` of what is wrong there.
    """
    with pytest.raises(UnprovenError, match=description):
        prove_contract(parse_function(tmp_path, body), "f", {"f": Contract(always)})


UNKNOWN_BODIES = {
    "switch (a) { default: return b; }": ("does not know Switch", "Switch"),
    "while (a > 7U) { /* at most 3 turns */ break; } return a;": ("does not know Break", "Break"),
    "return a + sizeof(b);": ("does not know the operator sizeof", "UnaryOp"),
    "return (uint32_t)((int32_t)a / 2);": ("/ of signed numbers is not known", "BinaryOp"),
    "return a < 0x10000000000000000;": ("no integer type for 0x10000000000000000", "Constant"),
    "(a, b) = 3U; return a;": ("no pointer to ExprList", "Assignment"),
}
"""Bodies of functions with C that the machine does not know, with the error of each and its node."""


@pytest.mark.parametrize(("body", "error"), UNKNOWN_BODIES.items(), ids=UNKNOWN_BODIES.keys())
def test_code_that_the_machine_does_not_know_is_refused_with_its_place(
    body: str, error: tuple[str, str], tmp_path: Path
) -> None:
    """The error names what is not known, and has a note with the node, the file and the line."""
    description, node = error
    with pytest.raises(NotImplementedError, match=description) as refusal:
        prove_contract(parse_function(tmp_path, body), "f", {"f": Contract(always)})

    [place] = refusal.value.__notes__
    assert place.startswith(f"{node} at {tmp_path / 'f.c'}:2:")


# --- The arithmetic ----------------------------------------------------------------------------------------

LIMITS = {"count": 31, "bits": 12, "prepared": 2**17}
"""The largest values of the parameters that may not be any number, by name."""
LONG_EDGES = (0, 1, 2**15, 2**16, 2**29, 2**30, 2**31 - 1, 2**31, 2**32 - 1, 2**32, 2**62, 2**63, 2**64 - 1)


@pytest.mark.parametrize("variant", [HERE[0], *slow(HERE[1:])], ids=str)
def test_the_arithmetic_means_what_a_compiler_makes_of_it(variant: Variant, tmp_path: Path) -> None:
    """Each of its functions, called twelve times with random numbers, gives the same in both.

    A variant is how a target divides and shifts.
    """
    code, rng = program(variant), random.Random(str(variant))
    types_by_function = functions_of_numbers(code)
    assert len(types_by_function) > 10
    library = compile_arithmetic(code, list(types_by_function), tmp_path)

    for name, types in 12 * list(types_by_function.items()):
        arguments = [draw_argument(parameter, type_, rng) for parameter, type_ in types.items()]
        paths = results_on_paths(code, name, *map(constant, arguments, types.values()))
        compiled_result = getattr(library, f"call_{name}")(*map(ctypes.c_uint64, arguments))
        assert result_for([], paths) == compiled_result, f"{name}{tuple(arguments)}, {variant}"


def functions_of_numbers(code: Program) -> dict[str, dict[str, IntegerType]]:
    """Return the functions of the arithmetic that take numbers alone, with their parameters' types by name.

    Where reciprocals come from a table or from the compiler, functions that need one are left out.
    """
    functions = {}
    for name in code.defined_in(*ARITHMETIC):
        types = {}
        for parameter in code.parameters(name):
            *_, type_name = getattr(parameter.type.type, "names", [""])  # a pointer has none
            if type_name in INTEGER_TYPES:
                types[parameter.name] = INTEGER_TYPES[type_name]
        takes_numbers_alone = len(types) == len(code.parameters(name))
        needs_reciprocal = code.variant.divide in RECIPROCAL_LIMITS and "prepare" in code.closure(name)
        if takes_numbers_alone and not needs_reciprocal:
            functions[name] = types
    return functions


def draw_argument(name: str, type_: IntegerType, rng: random.Random) -> int:
    """Draw an edge, or a number of any length, for a parameter of that name."""
    if name in LIMITS:
        return rng.randint(1, LIMITS[name])
    if rng.random() < 0.3:
        return rng.choice(LONG_EDGES) & type_.maximum
    return rng.getrandbits(rng.randint(1, type_.bits))


def compile_arithmetic(code: Program, names: list[str], folder: Path) -> ctypes.CDLL:
    """Compile functions of a variant into a library, in a folder.

    In the library their names begin with "call_", and they take and return long words.
    """
    lines = ['#include "mcp_asdf_arithmetic.h"']
    for name in names:
        parameters = [parameter.name for parameter in code.parameters(name)]
        declarations = ", ".join(f"uint64_t {parameter}" for parameter in parameters)
        result = f"{name}({', '.join(parameters)})"
        body = f"return {result};"
        if "word_pair_t" in code.functions[name].decl.type.type.type.names:
            body = f"const word_pair_t pair = {result}; return join(pair.high, pair.low);"
        lines.append(f"uint64_t call_{name}({declarations}) {{ {body} }}")
    library = compile_library(folder, "\n".join(lines), f"-I{HEADER.parent}", *code.variant.flags())
    for name in names:
        getattr(library, f"call_{name}").restype = ctypes.c_uint64
    return library
