"""Python with one small mistake in it, and whether its tests notice: ``python -m mutation.python_mutants``.

The mirror must differ from the C in the cross-check at its default length: what it finds of a mistake in the
mirror, it finds of the same mistake in the C. The oracle must fail its own tests.
"""

from __future__ import annotations

import argparse
import ast
import copy
import importlib
import os
import random
import re
import resource
import sys
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from importlib.util import spec_from_loader
from pathlib import Path
from types import ModuleType

import pytest

from mutation.equivalents import equivalents
from support import DRAWS_ALL, ROOT

MIRROR = "mcp_asdf.mirror"
ORACLES = ("mcp_asdf_tools.crosscheck.exact", "mcp_asdf_tools.crosscheck.oracle")
FOLDERS = {"mcp_asdf": ROOT / "firmware_py", "mcp_asdf_tools": ROOT / "host_tools"}
SECONDS = 120
"""Of processor for one mutant."""

OPERATORS: dict[type[ast.AST], type[ast.AST]] = {
    **{ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Add, ast.FloorDiv: ast.Mult, ast.Div: ast.Mult},
    **{ast.LShift: ast.RShift, ast.RShift: ast.LShift, ast.BitAnd: ast.BitOr, ast.BitOr: ast.BitAnd},
    **{ast.BitXor: ast.BitOr, ast.Mod: ast.FloorDiv, ast.Pow: ast.Mult, ast.And: ast.Or, ast.Or: ast.And},
    **{
        ast.Lt: ast.LtE,
        ast.LtE: ast.Lt,
        ast.Gt: ast.GtE,
        ast.GtE: ast.Gt,
        ast.Eq: ast.NotEq,
        ast.NotEq: ast.Eq,
    },
}
SWAPPED = {"min": "max", "max": "min", "any": "all", "all": "any"}


@dataclass(frozen=True)
class Mutant:
    """One mistake.

    Attributes:
        module: In which it is.
        name: Function, and the statement as it is and as it becomes.
        code: The module with the mistake in it.
    """

    module: str
    name: str
    code: str


def source(module: str) -> Path:
    return FOLDERS[module.partition(".")[0]].joinpath(*module.split(".")).with_suffix(".py")


def mutants(module: str) -> Iterator[Mutant]:
    """All of a module, in its order. Types, documentation and messages of errors are left alone."""
    tree = ast.parse(source(module).read_text(encoding="utf-8"))
    names: Counter[str] = Counter()
    for function in (each for each in ast.walk(tree) if isinstance(each, ast.FunctionDef)):
        for statement in _statements(function):
            before = _shown(statement)
            for change, undo in _changes(statement):
                change()
                name = f"{function.name}: [{before} => {_shown(statement)}]"
                names[name] += 1
                yield Mutant(
                    module, name if names[name] == 1 else f"{name} ({names[name]})", ast.unparse(tree)
                )
                undo()


def _statements(function: ast.FunctionDef) -> Iterator[ast.stmt]:
    for statement in ast.walk(function):
        is_text = isinstance(statement, ast.Expr) and isinstance(statement.value, ast.Constant)
        is_other = isinstance(statement, ast.FunctionDef | ast.Raise | ast.Import | ast.ImportFrom | ast.Pass)
        if isinstance(statement, ast.stmt) and not (is_text or is_other):
            yield statement


def _shown(statement: ast.stmt) -> str:
    """Of a statement with others in it only its head."""
    head = copy.copy(statement)
    for part in ("body", "orelse", "finalbody"):
        if getattr(head, part, None):
            setattr(head, part, [ast.Pass()])
    return " ".join(ast.unparse(head).split())


Change = tuple[Callable[[], None], Callable[[], None]]
"""Does it, and undoes it."""


def _changes(statement: ast.stmt) -> Iterator[Change]:
    if isinstance(statement, ast.Assign | ast.AugAssign | ast.Expr):
        yield _without(statement)
    if isinstance(statement, ast.If | ast.While):
        yield from (_set(statement, "test", ast.Constant(value)) for value in (True, False))
    for node in _expressions(statement):
        if isinstance(node, ast.BinOp | ast.BoolOp | ast.AugAssign) and type(node.op) in OPERATORS:
            yield _set(node, "op", OPERATORS[type(node.op)]())
        elif isinstance(node, ast.Compare):
            for number, operator in enumerate(node.ops):
                if type(operator) in OPERATORS:
                    swapped = [*node.ops[:number], OPERATORS[type(operator)](), *node.ops[number + 1 :]]
                    yield _set(node, "ops", swapped)
        elif isinstance(node, ast.Constant) and type(node.value) is int:
            yield from (_set(node, "value", node.value + step) for step in (1, -1))
        elif isinstance(node, ast.Constant) and type(node.value) is bool:
            yield _set(node, "value", not node.value)
        elif isinstance(node, ast.Name) and node.id in SWAPPED:
            yield _set(node, "id", SWAPPED[node.id])
        elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not | ast.USub | ast.Invert):
            yield _set(node, "op", ast.UAdd())


def _expressions(statement: ast.stmt) -> Iterator[ast.AST]:
    """Those of the statement itself, not of statements in it."""
    waiting: list[ast.AST] = [statement]
    while waiting:
        node = waiting.pop()
        yield node
        children = [
            each for each in ast.iter_child_nodes(node) if not isinstance(each, ast.stmt | ast.JoinedStr)
        ]
        if isinstance(node, ast.AnnAssign):
            children = [each for each in children if each is not node.annotation]
        waiting.extend(reversed(children))


def _set(node: ast.AST, name: str, value: object) -> Change:
    before = getattr(node, name)
    return lambda: setattr(node, name, value), lambda: setattr(node, name, before)


def _without(statement: ast.Assign | ast.AugAssign | ast.Expr) -> Change:
    """The statement does nothing, but its names are there."""
    kind, before = statement.__class__, dict(statement.__dict__)

    def change() -> None:
        statement.__class__ = ast.Expr
        statement.__dict__.update(value=ast.Constant(0))

    def undo() -> None:
        statement.__class__ = kind
        statement.__dict__.clear()
        statement.__dict__.update(before)

    return change, undo


# ---- What notices ----


def dies(mutant: Mutant) -> bool:
    """True if its tests fail, in a process of its own."""
    child = os.fork()
    if child == 0:
        status = 1
        try:
            _quiet()
            _install(mutant)
            notices = _crosscheck_fails if mutant.module == MIRROR else _tests_fail
            status = 1 if notices() else 0
        finally:
            os._exit(status)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) != 0


def _quiet() -> None:
    resource.setrlimit(resource.RLIMIT_CPU, (SECONDS, SECONDS))
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    os.dup2(nowhere, 2)


@dataclass(frozen=True)
class _Importer(MetaPathFinder, Loader):
    """Importer of the mutant in the place of its module."""

    mutant: Mutant

    def find_spec(self, fullname: str, *_: object) -> ModuleSpec | None:
        """Of the mutant alone."""
        origin = str(source(fullname)) if fullname == self.mutant.module else None
        return spec_from_loader(fullname, self, origin=origin) if origin else None

    def exec_module(self, module: ModuleType) -> None:
        """Its code."""
        exec(compile(self.mutant.code, str(source(self.mutant.module)), "exec"), module.__dict__)


def _install(mutant: Mutant) -> None:
    """From now on the mutant is imported, by all that is imported: tests loaded before have the original."""
    for name, module in list(sys.modules.items()):
        is_test = str(ROOT / "tests") in (getattr(module, "__file__", None) or "") and name != __name__
        if is_test or re.match(r"mcp_asdf(_tools)?(\.(?!_)|$)", name):
            del sys.modules[name]
    sys.meta_path.insert(0, _Importer(mutant))


def _crosscheck_fails() -> bool:
    command = importlib.import_module("mcp_asdf_tools.cli.crosscheck")
    check = command._check_with(command.Audit())
    outcome = command.crosscheck(check, command.SEED, command.STEPS, lambda _: None)
    return outcome.failing is not None


def _tests_fail() -> bool:
    """Its own tests come first, as most mistakes fail there.

    Random tests draw some of their cases, as in ``make test``: where they draw all they are slow.
    """
    os.environ.pop(DRAWS_ALL, None)
    room = ROOT / "tests/host_tools/crosscheck"
    own = room / "test_oracle.py"
    quiet = ["-q", "-x", "-p", "no:xdist", "-p", "no:cacheprovider", "-m", "not slow"]
    return pytest.main([*quiet, str(own)]) != 0 or pytest.main([*quiet, str(room), f"--ignore={own}"]) != 0


def mistakes(*modules: str) -> list[Mutant]:
    """All mutants that must be noticed."""
    return [each for module in modules for each in mutants(module) if each.name not in equivalents("python")]


def sample(module: str, count: int, seed: int) -> list[Mutant]:
    """Some that must be noticed."""
    return random.Random(seed).sample(mistakes(module), count)


def main() -> None:
    """Try all, or some at random of each module, and print what survives."""
    parser = argparse.ArgumentParser(prog="python -m mutation.python_mutants", description=__doc__)
    parser.add_argument("module", nargs="*", default=[MIRROR, *ORACLES])
    parser.add_argument("--sample", type=int, help="so many of each module, at random")
    parser.add_argument("--seed", type=int, default=random.randrange(1 << 32))
    given = parser.parse_args()
    chosen = mistakes(*given.module)
    if given.sample is not None:
        chosen = [each for module in given.module for each in sample(module, given.sample, given.seed)]
        print(f"seed {given.seed}")
    survived = 0
    for number, mutant in enumerate(chosen, 1):
        if not dies(mutant):
            survived += 1
            print(f"survives: {mutant.module} {mutant.name}", flush=True)
        if sys.stderr.isatty():
            print(f"\r{number} of {len(chosen)}", end="", file=sys.stderr)
    print(f"{len(chosen)} mutants, {survived} survive")
    sys.exit(survived != 0)


if __name__ == "__main__":
    main()
