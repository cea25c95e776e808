"""Mutants of Python files: each has one mistake in an operator, a constant, a condition or a statement."""

from __future__ import annotations

import ast
import copy
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from support import ROOT

REPLACED_OPERATORS: dict[type[ast.AST], type[ast.AST]] = {
    **{ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Add, ast.FloorDiv: ast.Mult, ast.Div: ast.Mult},
    **{ast.LShift: ast.RShift, ast.RShift: ast.LShift, ast.BitAnd: ast.BitOr, ast.BitOr: ast.BitAnd},
    **{ast.BitXor: ast.BitOr, ast.Mod: ast.FloorDiv, ast.Pow: ast.Mult, ast.And: ast.Or, ast.Or: ast.And},
    **{ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq},
    **{ast.NotEq: ast.Eq, ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In},
}
REPLACED_FUNCTIONS = {"min": "max", "max": "min", "any": "all", "all": "any"}

Function = ast.FunctionDef | ast.AsyncFunctionDef
Mistake = Callable[[], None]
"""Function that makes one mistake in the tree for which it was created."""


@dataclass(frozen=True)
class Mutant:
    """A Python file with one mistake in it.

    Attributes:
        path: The file, relative to the project.
        number: Index of the mistake among all mistakes of the file.
        statement_index: Index of the changed statement among those of the file that may be changed.
        name: Function, and the statement before and after the change, such as ``f: [a + b => a - b]``.
    """

    path: Path
    number: int
    statement_index: int
    name: str

    def __str__(self) -> str:
        return f"{self.path}#{self.number}"

    @property
    def code(self) -> str:
        """Text of the file with the mistake in it, without comments."""
        tree = _parse(self.path)
        mistakes = [
            mistake
            for _function, statement in _mutable_statements(tree)
            for mistake in _mistakes_in_statement(statement)
        ]
        make_mistake = mistakes[self.number]
        make_mistake()
        return ast.unparse(tree)


def mutants(path: Path) -> list[Mutant]:
    """Return all mutants of a file or folder. Types, documentation and messages of errors are not changed."""
    is_folder = (ROOT / path).is_dir()
    files = sorted((ROOT / path).rglob("*.py")) if is_folder else [ROOT / path]
    return [
        Mutant(file.relative_to(ROOT), number, statement_index, name)
        for file in files
        for number, (statement_index, name) in enumerate(_describe_mistakes(file))
    ]


def insert_before_statements(path: Path, expressions: dict[int, str]) -> ast.Module:
    """Return the tree of a file in which expressions are evaluated before some of its mutable statements.

    ``expressions`` has the text of an expression for the index of a statement.
    """
    tree = _parse(path)
    statements = [statement for _function, statement in _mutable_statements(tree)]
    inserted_before = {statements[index]: ast.parse(text).body for index, text in expressions.items()}

    class Inserter(ast.NodeTransformer):
        def visit(self, node: ast.AST) -> ast.AST | list[ast.AST]:
            self.generic_visit(node)
            return [*inserted_before[node], node] if node in inserted_before else node

    Inserter().visit(tree)
    return ast.fix_missing_locations(tree)


def _parse(path: Path) -> ast.Module:
    return ast.parse((ROOT / path).read_text(encoding="utf-8"))


# --- Statements ------------------------------------------------------------------------------------------


def _mutable_statements(tree: ast.Module) -> list[tuple[Function, ast.stmt]]:
    """Return every statement that may be changed, with its function."""
    functions = [node for node in ast.walk(tree) if isinstance(node, Function)]
    return [(function, statement) for function in functions for statement in _statements_in(function)]


def _statements_in(node: ast.AST) -> Iterator[ast.stmt]:
    """Yield the statements below a node that may be changed, without those of functions and classes in it."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            continue
        is_docstring = isinstance(child, ast.Expr) and isinstance(child.value, ast.Constant)
        is_left_alone = isinstance(child, ast.Raise | ast.Import | ast.ImportFrom | ast.Pass)
        if isinstance(child, ast.stmt) and not is_docstring and not is_left_alone:
            yield child
        yield from _statements_in(child)


def _describe_mistakes(file: Path) -> Iterator[tuple[int, str]]:
    """Yield the index of the statement and the name of each mistake in a file."""
    for statement_index, (function, statement) in enumerate(_mutable_statements(_parse(file))):
        head = _without_nested_statements(statement)
        mistake_count = sum(1 for _mistake in _mistakes_in_statement(head))
        for number in range(mistake_count):
            changed_head = copy.deepcopy(head)
            make_mistake = list(_mistakes_in_statement(changed_head))[number]
            make_mistake()
            yield statement_index, f"{function.name}: [{_in_one_line(head)} => {_in_one_line(changed_head)}]"


def _without_nested_statements(statement: ast.stmt) -> ast.stmt:
    """Return a copy of a statement that has ``pass`` in place of the statements in it."""
    head = copy.copy(statement)
    for block_name in ("body", "orelse", "finalbody"):
        if getattr(head, block_name, None):
            setattr(head, block_name, [ast.Pass()])
    return head


def _in_one_line(statement: ast.stmt) -> str:
    return " ".join(ast.unparse(statement).split())


# --- Mistakes --------------------------------------------------------------------------------------------


def _mistakes_in_statement(statement: ast.stmt) -> Iterator[Mistake]:
    """Yield all mistakes in a statement itself, always in the same order."""
    if isinstance(statement, ast.Assign | ast.AugAssign | ast.Expr):
        yield lambda: _remove(statement)
    if isinstance(statement, ast.If | ast.While):
        for value in (True, False):
            if ast.unparse(statement.test) != str(value):
                yield _set(statement, "test", ast.Constant(value))
    for node in _expressions_in(statement):
        yield from _mistakes_in_node(node)


def _mistakes_in_node(node: ast.AST) -> Iterator[Mistake]:
    """Yield the mistakes in a node of a statement, without those in the nodes below it."""
    if isinstance(node, ast.Compare):
        yield from _mistakes_in_comparison(node)
    elif isinstance(node, ast.Constant):
        yield from _mistakes_in_constant(node)
    elif isinstance(node, ast.BinOp | ast.BoolOp | ast.AugAssign) and type(node.op) in REPLACED_OPERATORS:
        yield _set(node, "op", REPLACED_OPERATORS[type(node.op)]())
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not | ast.USub | ast.Invert):
        yield _set(node, "op", ast.UAdd())
    elif isinstance(node, ast.Name) and node.id in REPLACED_FUNCTIONS:
        yield _set(node, "id", REPLACED_FUNCTIONS[node.id])


def _mistakes_in_comparison(comparison: ast.Compare) -> Iterator[Mistake]:
    """Yield a mistake for each operator of a comparison, of which 0 < x <= 1 has two."""
    for index, operator in enumerate(comparison.ops):
        if type(operator) in REPLACED_OPERATORS:
            changed_operators: list[ast.AST] = list(comparison.ops)
            changed_operators[index] = REPLACED_OPERATORS[type(operator)]()
            yield _set(comparison, "ops", changed_operators)


def _mistakes_in_constant(constant: ast.Constant) -> Iterator[Mistake]:
    """Yield the mistakes in a whole number or a truth value; other constants have none."""
    if type(constant.value) is int:
        yield _set(constant, "value", constant.value + 1)
        yield _set(constant, "value", constant.value - 1)
    elif type(constant.value) is bool:
        yield _set(constant, "value", not constant.value)


def _expressions_in(statement: ast.stmt) -> Iterator[ast.AST]:
    """Yield the nodes of a statement itself from left to right, without those of statements in it.

    Annotations and f-strings, most of which are messages, are left out.
    """
    waiting_nodes: list[ast.AST] = [statement]
    while waiting_nodes:
        node = waiting_nodes.pop()
        yield node
        children = [
            child for child in ast.iter_child_nodes(node) if not isinstance(child, ast.stmt | ast.JoinedStr)
        ]
        if isinstance(node, ast.AnnAssign):
            children = [child for child in children if child is not node.annotation]
        if isinstance(node, ast.keyword) and ast.unparse(node) == "strict=True":
            children = []  # zip(strict=True) states what holds in any case
        waiting_nodes.extend(reversed(children))


def _set(node: ast.AST, attribute: str, value: object) -> Mistake:
    """Return a mistake that sets an attribute of a node."""
    return lambda: setattr(node, attribute, value)


def _remove(statement: ast.stmt) -> None:
    """Turn a statement into the expression 0, which does nothing."""
    statement.__class__ = ast.Expr
    statement.__dict__.update(value=ast.Constant(0))
