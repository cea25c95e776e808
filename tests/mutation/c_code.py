"""Where the firmware's C may be changed."""

from __future__ import annotations

import re
from collections.abc import Iterator

from mutation.changes import Change, Code, Function, blank

COMMENT = re.compile(r"/\*.*?\*/", re.DOTALL)
NOT_CODE = re.compile(
    r'/\*.*?\*/|"[^"\n]*"|^ASSERT\([^\n]*|^[ \t]*#(?:[^\n]*\\\n)*[^\n]*', re.MULTILINE | re.DOTALL
)
"""Comments, texts, static assertions, and lines of the preprocessor with their continuations."""
DEFINITION = re.compile(r"^#define (\w+)([ \t]+(?:[^\n]*\\\n)*[^\n]*)", re.MULTILINE)
UNCHANGED_DEFINITIONS = re.compile("MCP_ASDF|UNUSED|HOT|SHARED|WARM|ZEROS|NOINLINE|ALWAYS|FENCE")
"""Beginnings of macros that choose between variants, or tell a compiler something."""
FUNCTION_HEAD = re.compile(
    r"^(?!typedef|static const|ASSERT)[ \t]*\w[^;{}=]*?\b(\w+)\([^;{}]*\)\s*\{", re.MULTILINE
)
STATEMENT = re.compile(
    r"(?<=[;{}])\s*((?:\+\+|--|\*|\(void\)(?=\w+\())?[a-z][\w>.\[\]\-]*\s*(?:(?:[-+|&<>^]*=|\()[^;{}]*)?;)"
)
CONDITION = re.compile(r"\b(if|while) \(")


def find_code(source: str) -> Code:
    """Return what may be changed in a source: functions and data, and the tokens of macros' values."""
    code = NOT_CODE.sub(lambda match: blank(match[0]), source)
    functions = list(_functions(code))
    changes = list(_changes_of_statements(code, functions))
    for macro in DEFINITION.finditer(source):
        if not UNCHANGED_DEFINITIONS.match(macro[1]):
            value = COMMENT.sub(lambda match: blank(match[0]), macro[2]).replace("\\", " ")
            code = code[: macro.start(2)] + value + code[macro.end(2) :]
    return Code(code, functions, changes)


def _functions(code: str) -> Iterator[Function]:
    for head in FUNCTION_HEAD.finditer(code):
        opening_brace = head.end() - 1
        yield Function(head.start(), _closing_bracket(code, opening_brace), head[1])


def _closing_bracket(code: str, opening: int) -> int:
    """Return the position of the bracket or brace that closes the one at ``opening``."""
    depth = 0
    for position in range(opening, len(code)):
        if code[position] in "({":
            depth += 1
        elif code[position] in ")}":
            depth -= 1
        if depth == 0:
            return position
    raise ValueError(f"nothing closes {code[opening : opening + 40]!r}")


def _changes_of_statements(code: str, functions: list[Function]) -> Iterator[Change]:
    """Yield changes that remove a statement, or let a condition always or never hold."""
    for function in functions:
        for statement in STATEMENT.finditer(code, function.start, function.end):
            if not statement[1].startswith(("return", "for", "typedef", "static", "__asm__")):
                yield Change(*statement.span(1), ";")
        for condition in CONDITION.finditer(code, function.start, function.end):
            end = _closing_bracket(code, condition.end() - 1)
            yield Change(condition.end(), end, "0")
            if condition[1] == "if":  # a loop without an end would only cost time
                yield Change(condition.end(), end, "1")
