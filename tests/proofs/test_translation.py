"""The proofs give the C the meaning that a compiler gives it: both compute the same of any numbers."""

from __future__ import annotations

import ctypes
import random
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
import z3

from proofs.arithmetic import PREPARED
from proofs.machine import INTEGERS, Machine
from proofs.numbers import Number, Type, Words
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

    for name in names * 12:
        arguments = draw_arguments(code, name, rng)
        result_of_compiler = library.call(name, arguments)
        result_of_proofs = interpret(code, name, arguments)
        assert result_of_proofs == result_of_compiler, f"{name}{tuple(arguments)}, {variant}"


def functions_of_numbers(code: Program) -> list[str]:
    """Return the names of the functions of the arithmetic whose parameters are numbers.

    Without those that need a reciprocal, where these come from a table or from the compiler.
    """
    left_out = {"prepare"} if code.variant.divide in PREPARED else set[str]()
    return [
        name
        for name in code.defined_in(*ARITHMETIC)
        if None not in types_of_parameters(code, name) and not left_out & code.closure(name)
    ]


def types_of_parameters(code: Program, name: str) -> list[Any]:
    """Return the types of a function's parameters: None for what is no number."""
    return [INTEGERS.get(getattr(each.type.type, "names", [""])[-1]) for each in code.parameters(name)]


def draw_arguments(code: Program, name: str, rng: random.Random) -> list[int]:
    """Draw a number for each parameter of a function."""
    parameters = zip(code.parameters(name), types_of_parameters(code, name), strict=True)
    return [draw_argument(parameter.name, type_, rng) for parameter, type_ in parameters]


def draw_argument(name: str, type_: Type, rng: random.Random) -> int:
    """Draw an edge, or a number of any length, for a parameter of that name."""
    if name in COUNTS:
        return rng.randint(1, COUNTS[name])
    length = rng.randint(1, type_.bits)
    return (rng.choice(EDGES) if rng.random() < 0.3 else rng.getrandbits(length)) & type_.most


def interpret(code: Program, name: str, arguments: list[int]) -> int:
    """Call a function in the machine of the proofs, and return the value of its term."""
    types = types_of_parameters(code, name)
    numbers = [
        Number(z3.BitVecVal(each, type_.bits), type_) for each, type_ in zip(arguments, types, strict=True)
    ]
    machine = Machine(code, Words)
    found = machine.seen(machine.call(name, *numbers))
    word = z3.Concat(found["high"], found["low"]) if isinstance(found, dict) else found
    return int(z3.simplify(word).as_long())


@dataclass(frozen=True)
class Library:
    """Functions of a variant as a compiler translates them.

    Attributes:
        of_c: The shared library, whose functions take long words.
    """

    of_c: ctypes.CDLL

    def call(self, name: str, arguments: list[int]) -> int:
        """Call a function, and return its result."""
        function = getattr(self.of_c, f"call_{name}")
        function.restype = ctypes.c_uint64
        return int(function(*map(ctypes.c_uint64, arguments)))


def compile_functions(code: Program, names: list[str], folder: Path) -> Library:
    """Compile functions of a variant into a library, in a folder."""
    lines = ['#include "mcp_asdf_arithmetic.h"']
    for name in names:
        parameters = [each.name for each in code.parameters(name)]
        head, call = (", ".join(f"{kind}{each}" for each in parameters) for kind in ("uint64_t ", ""))
        is_pair = "word_pair_t" in str(code.functions[name].decl.type.type.type.names)
        value = "join(found.high, found.low)" if is_pair else "found"
        kind = "word_pair_t" if is_pair else "uint64_t"
        lines.append(
            f"uint64_t call_{name}({head}) {{ const {kind} found = {name}({call}); return {value}; }}"
        )
    (folder / "calls.c").write_text("\n".join(lines), encoding="utf-8")
    flags = ("-std=gnu99", "-O1", "-shared", "-fPIC", f"-I{HEADER.parent}", *code.variant.flags())
    run("gcc", *flags, "calls.c", "-o", "calls.so", cwd=folder)
    return Library(ctypes.CDLL(str(folder / "calls.so")))
