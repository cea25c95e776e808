"""The firmware's C as a syntax tree, once for every choice that a target can make."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from pycparser import c_ast, c_generator, c_parser

from support import CORE, ROOT, matching_files, run

SOURCES = CORE.parent
HEADER = SOURCES / "mcp_asdf_arithmetic.h"
ARITHMETIC = (HEADER, *matching_files(SOURCES, "mcp_asdf_target*.h"))
"""The private headers. The first includes all others."""
FIRMWARE = (CORE, *(SOURCES / f"mcp_asdf_{part}" for part in ("robust.h", "image.c", "frame.c", "small.c")))
"""The firmware without the arithmetic."""
LANES_HEADER = ROOT / "host_tools/mcp_asdf_tools/experiments/engine/lanes_arithmetic.h"
"""The header that divides in the experiments' engine, which includes the core."""
INCLUDE = Path(__file__).parent / "include"
CHOICE_MACROS = ("DIVIDE", "SPLIT_MULTIPLY", "SHIFT_BYTES", "HAS_CLZ")
"""The macros, without their prefix."""
HARDWARE, TABLE, BITS, LANES = range(1, 5)
"""Values of the first choice; all other choices are 0 or 1."""


@dataclass(frozen=True)
class Variant:
    """The definitions with which a target compiles the firmware.

    Attributes:
        digits: The values of ``CHOICE_MACROS``, one digit each.
        target: The compiler's macro for a target that has code of its own, or "".
    """

    digits: str
    target: str = ""

    def __str__(self) -> str:
        return self.digits + self.target

    @property
    def divide(self) -> int:
        """How the variant divides: HARDWARE, TABLE, BITS or LANES."""
        return int(self.digits[0])

    @property
    def int_bits(self) -> int:
        """The bits of C's int."""
        return 16 if self.target == "__AVR__" else 32

    def flags(self) -> list[str]:
        """Return the arguments of the preprocessor that select this variant."""
        flags = [
            f"-DMCP_ASDF_{macro}={digit}" for macro, digit in zip(CHOICE_MACROS, self.digits, strict=True)
        ]
        if self.divide == LANES:
            flags += [f"-I{LANES_HEADER.parent}", "-include", LANES_HEADER.name]
        if self.target:
            flags.append(f"-D{self.target}")
        return flags


HERE = tuple(Variant(digits) for digits in ("1001", "2100", "1000", "3010", "4000", "2000"))
"""What targets choose: together they have every variant of every function that a compiler for this machine
takes."""
AVR = Variant("3010", "__AVR__")
VARIANTS = (*HERE, AVR, Variant("1000", "__riscv"))
"""The same, and the two targets that have code of their own, with what they choose."""


class Program:
    """A C file, preprocessed for one variant and parsed.

    Attributes:
        variant: The variant for which the file was preprocessed.
        functions: Definitions by name.
        signatures: What functions take and return, by name, also of those that are only declared.
        types: What each typedef stands for, by name.
        constants: The values of enumerations, by name.
    """

    def __init__(self, path: Path, variant: Variant) -> None:
        # Own headers instead of the system's, and no macros of the compiler for this machine.
        flags = ["-undef", "-nostdinc", f"-I{INCLUDE}", f"-I{SOURCES}", *variant.flags(), "-x", "c"]
        preprocessed_text = run("gcc", "-E", *flags, path)
        # pycparser takes no pragmas, and they change no result.
        c_text = re.sub(r"^# .*pragma.*$", "", preprocessed_text, flags=re.MULTILINE)
        syntax_tree = c_parser.CParser().parse(c_text, str(path))

        self.variant = variant
        self.functions: dict[str, Any] = {}
        self.signatures: dict[str, Any] = {}
        self.types: dict[str, Any] = {}
        for node in syntax_tree.ext:
            # A declaration stands by itself, or at the head of a definition.
            declaration = node
            if isinstance(node, c_ast.FuncDef):
                declaration = node.decl
                self.functions[declaration.name] = node
            if isinstance(declaration.type, c_ast.FuncDecl):
                self.signatures[declaration.name] = declaration.type
            if isinstance(node, c_ast.Typedef):
                self.types[node.name] = node.type
        self.constants = {node.name: node.value for node in nodes(syntax_tree, c_ast.Enumerator)}

    def defined_in(self, *paths: Path) -> list[str]:
        """Return the names of the functions that these files define."""
        return [name for name, function in self.functions.items() if Path(function.coord.file) in paths]

    def parameters(self, name: str) -> list[Any]:
        """Return the declarations of a function's parameters."""
        return list(self.signatures[name].args.params)

    def callees(self, name: str) -> set[str]:
        """Return the functions of the program that a function calls."""
        # What has no definition here, such as a builtin of the compiler, is left out.
        called_names = {call.name.name for call in nodes(self.functions[name], c_ast.FuncCall)}
        return called_names & set(self.functions)

    def closure(self, name: str, excluded_names: Collection[str] = ()) -> set[str]:
        """Return a function and all that it calls, directly or not; excluded functions are not followed."""
        reached_names, new_names = set[str](), {name}
        while new_names:
            # Each round goes one call further from the function.
            reached_names |= new_names
            called_names = set[str]().union(*(self.callees(new_name) for new_name in new_names))
            new_names = called_names - reached_names - set(excluded_names)
        return reached_names

    def definition_text(self, name: str, excluded_names: Collection[str] = ()) -> str:
        """Return the text of all that can change what a function does; equal texts need one proof."""
        generator = c_generator.CGenerator()
        reached_names = sorted(self.closure(name, excluded_names))
        definitions = [generator.visit(self.functions[reached_name]) for reached_name in reached_names]
        # The same text means something else where an int has another length.
        return "\n".join([str(self.variant.int_bits), *definitions])


def nodes(root: Any, kind: type[Any]) -> Iterator[Any]:
    """Yield all nodes of one kind in a syntax tree, its root included, in the order of the text."""
    if isinstance(root, kind):
        yield root
    for child in root:
        yield from nodes(child, kind)


def variables_changed_by(statement: Any) -> set[str]:
    """Return the variables that a statement may change, as it assigns to them or takes their address.

    An array is not among them if only its elements are changed.
    """
    targets = [assignment.lvalue for assignment in nodes(statement, c_ast.Assignment)]
    for unary in nodes(statement, c_ast.UnaryOp):
        if unary.op in ("++", "--", "p++", "p--", "&"):
            targets.append(unary.expr)
    return {target.name for target in targets if isinstance(target, c_ast.ID)}


@cache
def program(variant: Variant, path: Path = HEADER) -> Program:
    """Return the program of a file and a variant; each is parsed once."""
    return Program(path, variant)


@cache
def _source_lines(path: str) -> list[str]:
    return Path(path).read_text(encoding="utf-8").splitlines()


def documented_max_turns(loop: Any) -> int:
    """Return the bound in the comment beside a loop, ``at most 3 turns``. A loop without one is an error."""
    max_turns = _number_beside(loop, r"/\* at most (\d+)")
    assert max_turns is not None, f"the loop in line {loop.coord.line} states no bound"
    return max_turns


def documented_max_shift(node: Any) -> int | None:
    """Return the bound in the comment beside a shift, ``a shift by at most 7``, or None without one."""
    return _number_beside(node, r"a shift by at most (\d+)")


def _number_beside(node: Any, pattern: str) -> int | None:
    """Return the number that a pattern captures in the line of a node, or None without a match."""
    # The parser drops comments, so they are read from the line of the source where the node stands.
    match = re.search(pattern, _source_lines(node.coord.file)[node.coord.line - 1])
    return int(match[1]) if match else None
