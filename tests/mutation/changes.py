"""Small mistakes in source code of C or Python: an operator, a number or a truth value is replaced."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass

TOKEN = re.compile(
    r"\bfor\b.*?\bin\b|\bnot in\b|\bis not\b|->|<<=|>>=|//=|\*\*=|\+\+|--|<<|>>|//|\*\*|[<>=!+\-*/%&|^]=|&&"
    r"|\|\||[-+*/%&|^~!<>=?:;,(){}\[\]]|\d*\.\d+|0x[0-9A-Fa-f]+(?=U?\b)|\b\d+(?=U?\b)|\w+|\."
)
"""Matches a token of C or Python. The "in" of a loop is part of another one, as it compares nothing."""
NUMBER = re.compile(r"0x[0-9A-Fa-f]+|\d+")
REPLACEMENTS: dict[str, tuple[str, ...]] = {
    **{"+": ("-",), "-": ("+",), "*": ("+",), "/": ("*",), "%": ("/",), "<<": (">>",), ">>": ("<<",)},
    **{"==": ("!=",), "!=": ("==",), "&&": ("||",), "||": ("&&",), "&": ("|",), "|": ("&",)},
    **{"++": ("--",), "--": ("++",), "+=": ("-=",), "-=": ("+=",), "|=": ("&=",), "&=": ("|=",)},
    **{"<<=": (">>=",), ">>=": ("<<=",), "true": ("false",), "false": ("true",), "^": ("|", "&")},
    **{"<": ("<=", ">="), "<=": ("<", ">"), ">": (">=", "<="), ">=": (">", "<")},
    **{"True": ("False",), "False": ("True",), "and": ("or",), "or": ("and",), "//": ("*",), "**": ("*",)},
    **{"is": ("is not",), "is not": ("is",), "in": ("not in",), "not in": ("in",)},
    **{"min": ("max",), "max": ("min",), "any": ("all",), "all": ("any",)},
}
"""What a token is replaced by, one at a time. No name in the firmware's C is one of Python's words."""
UNARY_OPERATORS = ("-", "~", "!", "not")
WORDS_BEFORE_OPERAND = ("return", "and", "or", "not", "in", "not in", "is", "is not", "if", "else", "yield")
TYPE_CAST = re.compile(r"\(\s*(?:const\s+)?(?:\w+_t|bool|float|char|int|void)\s*\**\s*\)$")
TYPE_BEFORE_POINTER = re.compile(r"(?:\b\w+_t|\bconst|\bvoid|\*)\s*$")
CHOICE = re.compile(r"\b(\w+) ([<>]=?) (\w+) \? (?:\1 : \3\b(?! [-+])|\1 - \3 : (?:\3 - \1|0U?)\b)")
"""Matches a choice of the smaller or larger of two numbers, or their distance. It makes no difference what is
chosen where they are equal, and so none whether the operator is "<" or "<="."""
END_OF_OPERAND = re.compile(r"U? *(?:[;:?,)\]\n]|&&|\|\||and\b|or\b|else\b)")


@dataclass(frozen=True, order=True)
class Change:
    """A replacement of some characters of a source: from ``start`` up to the one before ``end``."""

    start: int
    end: int
    replacement: str


@dataclass(frozen=True)
class Function:
    """A function in a source, with its first character and the one behind its last."""

    start: int
    end: int
    name: str


@dataclass(frozen=True)
class Code:
    """What may be changed in a source.

    Attributes:
        text: The source with blanks for all characters that no change of a token touches.
        functions: Its functions. Of functions in each other, the outer one comes first.
        changes: Changes of whole statements and conditions.
    """

    text: str
    functions: list[Function]
    changes: list[Change]


def blank(text: str) -> str:
    """Return spaces and line ends in place of a text, as many characters as it has.

    So positions behind it stay those in the source.
    """
    return re.sub(r"[^\n]", " ", text)


def changes_of_tokens(code: str) -> Iterator[Change]:
    """Yield changes that replace an operator or a truth value, drop a unary one, or move a number by 1."""
    choices = {choice.start(2) for choice in CHOICE.finditer(code)}
    previous_token = ""
    for match in TOKEN.finditer(code):
        token, (start, end) = match[0], match.span()
        code_before = code[max(0, start - 40) : start]
        # Behind an operand an operator is binary; a cast ends with a bracket, but is no operand.
        follows_operand = re.search(r"[\w)\]]$", previous_token) is not None
        follows_operand = follows_operand and not TYPE_CAST.search(code_before.rstrip())
        is_pointer = token in ("*", "&", "**")
        is_pointer = is_pointer and (not follows_operand or bool(TYPE_BEFORE_POINTER.search(code_before)))
        if NUMBER.fullmatch(token):
            is_limit = END_OF_OPERAND.match(code, end) is not None
            for number in _neighbours_of_number(token, previous_token if is_limit else ""):
                yield Change(start, end, number)
        elif token in UNARY_OPERATORS and not follows_operand:
            yield Change(start, end, "")
        elif not is_pointer and previous_token != ".":
            for replacement in REPLACEMENTS.get(token, ()):
                if start in choices and replacement[0] == token[0]:
                    continue  # such as "<=" for "<"
                yield Change(start, end, replacement)
        previous_token = "" if token in WORDS_BEFORE_OPERAND else token


def _neighbours_of_number(number: str, operator_before: str) -> Iterator[str]:
    """Yield the next larger number and, for numbers above 0, the next smaller one, with the same base.

    One is left out if the number is compared and another operator does the same: x < 9 is x <= 8.
    """
    value = int(number, 0)
    format_number = hex if number.startswith("0x") else str
    if operator_before not in ("<", ">="):
        yield format_number(value + 1)
    if value > 0 and operator_before not in ("<=", ">"):
        yield format_number(value - 1)
