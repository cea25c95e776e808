"""Python with one small mistake in it: an operator, a constant, a condition, a statement."""

from __future__ import annotations

import ast
import copy
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from support import ROOT

OPERATORS: dict[type[ast.AST], type[ast.AST]] = {
    **{ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Add, ast.FloorDiv: ast.Mult, ast.Div: ast.Mult},
    **{ast.LShift: ast.RShift, ast.RShift: ast.LShift, ast.BitAnd: ast.BitOr, ast.BitOr: ast.BitAnd},
    **{ast.BitXor: ast.BitOr, ast.Mod: ast.FloorDiv, ast.Pow: ast.Mult, ast.And: ast.Or, ast.Or: ast.And},
    **{ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq},
    **{ast.NotEq: ast.Eq, ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In},
}
SWAPPED = {"min": "max", "max": "min", "any": "all", "all": "any"}

Function = ast.FunctionDef | ast.AsyncFunctionDef
Change = Callable[[], None]
"""Makes one mistake in a tree that was parsed for it."""


@dataclass(frozen=True)
class Mutant:
    """One mistake.

    Attributes:
        path: File, relative to the project.
        number: Place among the mistakes of the file.
        place: Of its statement, among those of the file that may be changed.
        name: Function, and the statement as it is and as it becomes.
    """

    path: Path
    number: int
    place: int
    name: str

    def __str__(self) -> str:
        return f"{self.path}#{self.number}"

    @property
    def code(self) -> str:
        """The file with the mistake in it."""
        tree = _parsed(self.path)
        changes = [change for _, statement in _places(tree) for change in _changes(statement)]
        changes[self.number]()
        return ast.unparse(tree)


def mutants(path: Path) -> list[Mutant]:
    """All mutants of a file or folder. Types, documentation and messages of errors are left alone."""
    files = sorted((ROOT / path).rglob("*.py")) if (ROOT / path).is_dir() else [ROOT / path]
    return [
        Mutant(file.relative_to(ROOT), number, place, name)
        for file in files
        for number, (place, name) in enumerate(_mistakes(file))
    ]


def with_probes(path: Path, probes: dict[int, str]) -> ast.Module:
    """The file, with each of these expressions evaluated before the statement at its place."""
    tree = _parsed(path)
    statements = [statement for _, statement in _places(tree)]
    planted = {statements[place]: ast.parse(text).body for place, text in probes.items()}

    class Planter(ast.NodeTransformer):
        def visit(self, node: ast.AST) -> ast.AST | list[ast.AST]:
            self.generic_visit(node)
            return [*planted[node], node] if node in planted else node

    Planter().visit(tree)
    return ast.fix_missing_locations(tree)


def _mistakes(file: Path) -> Iterator[tuple[int, str]]:
    """Place and name of each."""
    for place, (function, statement) in enumerate(_places(_parsed(file))):
        head = _head(statement)
        for number, _ in enumerate(_changes(head)):
            changed = copy.deepcopy(head)
            list(_changes(changed))[number]()
            yield place, f"{function.name}: [{_text(head)} => {_text(changed)}]"


def _parsed(path: Path) -> ast.Module:
    return ast.parse((ROOT / path).read_text(encoding="utf-8"))


def _places(tree: ast.Module) -> list[tuple[Function, ast.stmt]]:
    """Every statement that may be changed, with its function."""
    functions = [each for each in ast.walk(tree) if isinstance(each, ast.FunctionDef | ast.AsyncFunctionDef)]
    return [(function, statement) for function in functions for statement in _statements(function)]


def _statements(function: ast.AST) -> Iterator[ast.stmt]:
    """Statements of a function, without the statements of functions in it."""
    for child in ast.iter_child_nodes(function):
        if isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            continue
        is_text = isinstance(child, ast.Expr) and isinstance(child.value, ast.Constant)
        is_other = isinstance(child, ast.Raise | ast.Import | ast.ImportFrom | ast.Pass)
        if isinstance(child, ast.stmt) and not (is_text or is_other):
            yield child
        yield from _statements(child)


def _head(statement: ast.stmt) -> ast.stmt:
    """The statement without statements in it."""
    head = copy.copy(statement)
    for part in ("body", "orelse", "finalbody"):
        if getattr(head, part, None):
            setattr(head, part, [ast.Pass()])
    return head


def _text(statement: ast.stmt) -> str:
    return " ".join(ast.unparse(statement).split())


def _changes(statement: ast.stmt) -> Iterator[Change]:
    if isinstance(statement, ast.Assign | ast.AugAssign | ast.Expr):
        yield lambda: _remove(statement)
    if isinstance(statement, ast.If | ast.While):
        values = [value for value in (True, False) if ast.unparse(statement.test) != str(value)]
        yield from (_set(statement, "test", ast.Constant(value)) for value in values)
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
    """Expressions of the statement itself, not of statements in it."""
    waiting: list[ast.AST] = [statement]
    while waiting:
        node = waiting.pop()
        yield node
        children = [
            each for each in ast.iter_child_nodes(node) if not isinstance(each, ast.stmt | ast.JoinedStr)
        ]
        if isinstance(node, ast.AnnAssign):
            children = [each for each in children if each is not node.annotation]
        if isinstance(node, ast.keyword) and ast.unparse(node) == "strict=True":
            children = []  # zip(strict=True) states what holds in any case
        waiting.extend(reversed(children))


def _set(node: ast.AST, name: str, value: object) -> Change:
    return lambda: setattr(node, name, value)


def _remove(statement: ast.stmt) -> None:
    statement.__class__ = ast.Expr
    statement.__dict__.update(value=ast.Constant(0))
