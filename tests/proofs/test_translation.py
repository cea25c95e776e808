"""The proofs give the C the meaning that a compiler gives it: both compute the same of any numbers."""

from __future__ import annotations

import ctypes
import random
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

    Left out are those with other parameters than numbers, and those that need a reciprocal where these come
    from elsewhere.
    """
    code = program(variant)
    types_by_function = {name: types(code, name) for name in code.defined_in(*ARITHMETIC)}
    left_out = {"prepare"} if variant.divide in PREPARED else set[str]()
    names = [
        name
        for name, types_of_parameters in types_by_function.items()
        if None not in types_of_parameters and not left_out & code.closure(name)
    ]
    assert len(names) > 10
    library, chance = compiled(code, names, tmp_path), random.Random(str(variant))
    for name in names * 12:
        parameters = [parameter.name for parameter in code.parameters(name)]
        arguments = [
            draw_argument(parameter, type_, chance)
            for parameter, type_ in zip(parameters, types_by_function[name], strict=True)
        ]

        compiled_result = getattr(library, f"call_{name}")(*map(ctypes.c_uint64, arguments))
        proved_result = interpreted(code, name, arguments, types_by_function[name])

        assert proved_result == compiled_result, f"{name}{tuple(arguments)}, {variant}"


def types(code: Program, name: str) -> list[Any]:
    """Types of the function's parameters: None for what is no number."""
    return [INTEGERS.get(getattr(each.type.type, "names", [""])[-1]) for each in code.parameters(name)]


def draw_argument(name: str, type_: Type, chance: random.Random) -> int:
    """Draw an edge, or a number of any length, for a parameter of that name."""
    if name in COUNTS:
        return chance.randint(1, COUNTS[name])
    length = chance.randint(1, type_.bits)
    return (chance.choice(EDGES) if chance.random() < 0.3 else chance.getrandbits(length)) & type_.most


def interpreted(code: Program, name: str, arguments: list[int], of: list[Type]) -> int:
    numbers = [
        Number(z3.BitVecVal(each, type_.bits), type_) for each, type_ in zip(arguments, of, strict=True)
    ]
    machine = Machine(code, Words)
    found = machine.seen(machine.call(name, *numbers))
    word = z3.Concat(found["high"], found["low"]) if isinstance(found, dict) else found
    return int(z3.simplify(word).as_long())


def compiled(code: Program, names: list[str], folder: Path) -> Any:
    """The variant's functions, called with long words."""
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
    library = ctypes.CDLL(str(folder / "calls.so"))
    for name in names:
        getattr(library, f"call_{name}").restype = ctypes.c_uint64
    return library
