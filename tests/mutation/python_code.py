"""Where Python may be changed: in the functions, but not in their types, texts and errors."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from itertools import accumulate
from typing import Any

from mutation.changes import Change, Code, Function, blank

COMMENT = re.compile(r"#[^\n]*")


def find_code(source: str) -> Code:
    """Return what may be changed in a source."""
    # Columns of the parser count bytes. With a byte for each character they count characters.
    tree = ast.parse(re.sub(r"[^\x00-\x7f]", "?", source))
    line_starts = list(accumulate(map(len, source.splitlines(keepends=True)), initial=0))

    def span_of(node: ast.AST) -> tuple[int, int]:
        place: Any = node  # only nodes that stand in the source have these attributes
        start = line_starts[place.lineno - 1] + place.col_offset
        return start, line_starts[place.end_lineno - 1] + place.end_col_offset

    function_nodes = [
        node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
    ]
    # The signature is no part of a function here.
    functions = [Function(span_of(node.body[0])[0], span_of(node)[1], node.name) for node in function_nodes]
    text = blank(source)
    for function in functions:
        text = _with_part(text, function.start, source[function.start : function.end])
    for node in _nodes_without_code(tree):
        start, end = span_of(node)
        text = _with_part(text, start, blank(source[start:end]))
    text = COMMENT.sub(lambda comment: blank(comment[0]), text)
    changes = {
        Change(*span_of(node), replacement)
        for function_node in function_nodes
        for node, replacement in _replacements_in(function_node)
    }
    return Code(text, functions, sorted(changes))


def _with_part(text: str, start: int, part: str) -> str:
    """Return the text with this part in place of as many characters."""
    return text[:start] + part + text[start + len(part) :]


def _nodes_without_code(tree: ast.AST) -> Iterator[ast.AST]:
    """Yield the nodes that are not changed: types, texts, errors and imports."""
    for node in ast.walk(tree):
        annotation = getattr(node, "annotation", None) or getattr(node, "returns", None)
        if annotation is not None:
            yield annotation
        is_text = isinstance(node, ast.Constant) and isinstance(node.value, str | bytes)
        # zip(strict=True) states what holds in any case.
        is_strict = isinstance(node, ast.keyword) and node.arg == "strict"
        is_left_alone = isinstance(node, ast.JoinedStr | ast.Raise | ast.Import | ast.ImportFrom)
        if is_text or is_strict or is_left_alone:
            yield node


def _replacements_in(function: ast.AST) -> Iterator[tuple[ast.AST, str]]:
    """Yield each statement that can be removed and each condition, with what replaces it."""
    for node in ast.walk(function):
        is_docstring = isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
        if isinstance(node, ast.Assign | ast.AugAssign | ast.Expr) and not is_docstring:
            yield node, "pass"
        if isinstance(node, ast.If | ast.While):
            yield node.test, "False"
        if isinstance(node, ast.If):  # a loop without an end would only cost time
            yield node.test, "True"
