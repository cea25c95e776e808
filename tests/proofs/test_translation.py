"""The proofs give the C the meaning that a compiler gives it: both compute the same of any numbers."""

from __future__ import annotations

import ctypes
import random
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import z3

from proofs.machine import INTEGERS, Machine
from proofs.numbers import Number, Type, Words
from proofs.prove import terms
from proofs.source import HEADER, LANES, Program, Variant, program
from support import run

HERE = [Variant(digits) for digits in ("1001", "2100", "1000", "3010", "4000", "2000")]
"""Together they have every variant of every function that a compiler for this machine takes."""
CASES = 12
"""For each function of each variant."""
COUNTS = {"count": 31, "bits": 12, "prepared": 2**17}
"""The largest values of parameters that are not any number."""
EDGES = (0, 1, 2**15, 2**16, 2**29, 2**30, 2**31 - 1, 2**31, 2**32 - 1, 2**32, 2**62, 2**63, 2**64 - 1)


@pytest.mark.parametrize("variant", HERE, ids=str)
def test_translation_and_compiler_agree(variant: Variant, tmp_path: Path) -> None:
    code = program(variant)
    names = [name for name in code.defined_in(HEADER) if is_translated(code, name)]
    assert len(names) > 10
    library = compiled(code, names, tmp_path)
    chance = random.Random(str(variant))
    for name in names:
        for arguments in some(code, name, chance):
            expected = ctypes.c_uint64(
                getattr(library, f"call_{name}")(*map(ctypes.c_uint64, arguments))
            ).value
            assert interpreted(code, name, arguments) == expected, f"{name}{tuple(arguments)}, {variant}"


def types(code: Program, name: str) -> list[Any]:
    """Of the function's parameters: None for what is no number."""
    return [INTEGERS.get(getattr(each.type.type, "names", [""])[-1]) for each in code.parameters(name)]


def is_translated(code: Program, name: str) -> bool:
    """Of numbers only, and without a quotient of binary32."""
    return None not in types(code, name) and not (
        code.variant.divide == LANES and "prepare" in code.closure(name)
    )


def some(code: Program, name: str, chance: random.Random) -> Iterator[list[int]]:
    """Edges, and numbers of every length."""
    for _ in range(CASES):
        yield [
            one(parameter.name, type_, chance)
            for parameter, type_ in zip(code.parameters(name), types(code, name), strict=True)
        ]


def one(name: str, type_: Type, chance: random.Random) -> int:
    if name in COUNTS:
        return chance.randint(1, COUNTS[name])
    number = (
        chance.choice(EDGES) if chance.random() < 0.3 else chance.getrandbits(chance.randint(1, type_.bits))
    )
    return number & type_.most


def interpreted(code: Program, name: str, arguments: list[int]) -> int:
    machine = Machine(code, Words)
    numbers = zip(arguments, types(code, name), strict=True)
    found = terms(machine.call(name, *(Number(z3.BitVecVal(value, of.bits), of) for value, of in numbers)))
    if isinstance(found, dict):
        return int(z3.simplify(z3.Concat(found["high"], found["low"])).as_long())
    return int(z3.simplify(found).as_long())


def compiled(code: Program, names: list[str], folder: Path) -> Any:
    """The variant's functions, called with long words."""
    lines = ['#include "mcp_asdf_arithmetic.h"']
    for name in names:
        parameters = [each.name for each in code.parameters(name)]
        head = ", ".join(f"uint64_t {each}" for each in parameters)
        call = f"{name}({', '.join(parameters)})"
        pair = "word_pair_t" in str(code.functions[name].decl.type.type.type.names)
        value = (
            f"word_pair_t found = {call}; return join(found.high, found.low);" if pair else f"return {call};"
        )
        lines.append(f"uint64_t call_{name}({head}) {{ {value} }}")
    (folder / "calls.c").write_text("\n".join(lines), encoding="utf-8")
    flags = ("-std=gnu99", "-O1", "-shared", "-fPIC", f"-I{HEADER.parent}", *code.variant.flags())
    run("gcc", *flags, "calls.c", "-o", "calls.so", cwd=folder)
    library = ctypes.CDLL(str(folder / "calls.so"))
    for name in names:
        getattr(library, f"call_{name}").restype = ctypes.c_uint64
    return library
