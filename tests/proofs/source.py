"""The firmware's C as a syntax tree, once for every choice that a target can make."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from pycparser import c_ast, c_generator, c_parser

from support import ROOT, matching_files, run

SOURCES = ROOT / "c_ref/src"
HEADER = SOURCES / "mcp_asdf_arithmetic.h"
ARITHMETIC = (HEADER, *matching_files(SOURCES, "mcp_asdf_target*.h"))
"""The private headers. The first includes all others."""
LANES_HEADER = ROOT / "host_tools/mcp_asdf_tools/experiments/engine/lanes_arithmetic.h"
"""What the experiments' engine divides with: it includes the core and brings this."""
INCLUDE = Path(__file__).parent / "include"
CHOICES = ("DIVIDE", "SPLIT_MULTIPLY", "SHIFT_BYTES", "HAS_CLZ")
"""The macros, without their prefix."""
HARDWARE, TABLE, BITS, LANES = range(1, 5)
"""Values of the first choice; all other choices are 0 or 1."""


@dataclass(frozen=True)
class Variant:
    """Definitions for the preprocessor: the digits are values of ``CHOICES``, the macro names a target."""

    digits: str
    target: str = ""

    def __str__(self) -> str:
        return self.digits + self.target

    @property
    def divide(self) -> int:
        return int(self.digits[0])

    @property
    def int_bits(self) -> int:
        return 16 if self.target == "__AVR__" else 32

    def flags(self) -> list[str]:
        chosen = zip(CHOICES, self.digits, strict=True)
        flags = [f"-DMCP_ASDF_{name}={digit}" for name, digit in chosen]
        if self.divide == LANES:
            flags += [f"-I{LANES_HEADER.parent}", "-include", LANES_HEADER.name]
        return [*flags, f"-D{self.target}"] if self.target else flags


HERE = tuple(Variant(digits) for digits in ("1001", "2100", "1000", "3010", "4000", "2000"))
"""What targets choose: together they have every variant of every function that a compiler for this machine
takes."""
AVR = Variant("3010", "__AVR__")
VARIANTS = (*HERE, AVR, Variant("1000", "__riscv"))
"""The same, and the two targets that have code of their own, with what they choose."""


class Program:
    """One C file, preprocessed for one variant and parsed.

    Attributes:
        functions: Definitions by name.
        heads: What functions take and return, by name, where they are only declared, too.
        types: What each typedef stands for, by name.
        constants: The values of enumerations, by name.
    """

    def __init__(self, path: Path, variant: Variant) -> None:
        text = run(
            *("gcc", "-E", "-undef", "-nostdinc", f"-I{INCLUDE}", f"-I{SOURCES}", *variant.flags()),
            *("-x", "c", path),
        )
        self.variant = variant
        tree = c_parser.CParser().parse(re.sub(r"^# .*pragma.*$", "", text, flags=re.MULTILINE), str(path))
        self.functions = {each.decl.name: each for each in tree.ext if isinstance(each, c_ast.FuncDef)}
        declared = [getattr(each, "decl", each) for each in tree.ext]
        self.heads = {each.name: each.type for each in declared if isinstance(each.type, c_ast.FuncDecl)}
        self.constants = {each.name: each.value for each in nodes(tree, c_ast.Enumerator)}
        self.types = {each.name: each.type for each in tree.ext if isinstance(each, c_ast.Typedef)}

    def defined_in(self, *paths: Path) -> list[str]:
        """Return the names of the functions that these files define."""
        return [name for name, each in self.functions.items() if Path(each.coord.file) in paths]

    def parameters(self, name: str) -> list[Any]:
        """Return the declarations of a function's parameters."""
        return list(self.heads[name].args.params)

    def callees(self, name: str) -> set[str]:
        """Return the functions of the program that a function calls."""
        return {
            node.name.name
            for node in nodes(self.functions[name], c_ast.FuncCall)
            if node.name.name in self.functions
        }

    def closure(self, name: str, without: Collection[str] = ()) -> set[str]:
        """Return a function and all that it calls, directly or not."""
        found, new = set[str](), {name}
        while new:
            found |= new
            new = set().union(*(self.callees(each) for each in new)) - found - set(without)
        return found

    def text(self, name: str, without: Collection[str] = ()) -> str:
        """Return the text of all that can change what a function does; equal texts need one proof."""
        generator = c_generator.CGenerator()
        parts = [generator.visit(self.functions[each]) for each in sorted(self.closure(name, without))]
        return "\n".join([str(self.variant.int_bits), *parts])


def nodes(root: Any, kind: type[Any]) -> Iterator[Any]:
    """Yield all nodes of one kind below this one, in the order of the text."""
    if isinstance(root, kind):
        yield root
    for child in root:
        yield from nodes(child, kind)


@cache
def program(variant: Variant, path: Path = HEADER) -> Program:
    return Program(path, variant)


@cache
def _lines(path: str) -> list[str]:
    return Path(path).read_text(encoding="utf-8").splitlines()


def stated_turns(loop: Any) -> int:
    """Return the bound in the comment beside a loop, ``at most 3 turns``."""
    most = _stated(loop, r"/\* at most (\d+)")
    assert most is not None, f"the loop in line {loop.coord.line} states no bound"
    return most


def stated_shift(node: Any) -> int | None:
    """Return the bound in the comment beside a shift, ``a shift by at most 7``."""
    return _stated(node, r"a shift by at most (\d+)")


def _stated(node: Any, pattern: str) -> int | None:
    found = re.search(pattern, _lines(node.coord.file)[node.coord.line - 1])
    return int(found[1]) if found else None
