"""The firmware's C with one small mistake in it: an operator, a constant, a condition, a statement."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from proofs.source import LANES_HEADER, SOURCES

MUTATED = (
    "mcp_asdf.c",
    "mcp_asdf_robust.h",
    "mcp_asdf_arithmetic.h",
    "mcp_asdf_target.h",
    "mcp_asdf_target_avr.h",
    "mcp_asdf_target_small.h",
    "lanes_arithmetic.h",
    "mcp_asdf_image.c",
    "mcp_asdf_frame.c",
    "mcp_asdf_small.c",
)
"""The firmware, and what the engine divides with. The other headers declare what callers see; tests in both
languages compare their numbers."""

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
TOKEN = re.compile(
    r"->|<<=|>>=|\+\+|--|<<|>>|[<>=!+\-*/%&|^]=|&&|\|\|"
    r"|[-+*/%&|^~!<>=?:;,(){}\[\].]|0x[0-9A-Fa-f]+(?=U?\b)|\b\d+(?=U?\b)|\w+"
)
NUMBER = re.compile(r"0x[0-9A-Fa-f]+|\d+")
REPLACEMENTS: dict[str, tuple[str, ...]] = {
    **{"+": ("-",), "-": ("+",), "*": ("+",), "/": ("*",), "%": ("/",), "<<": (">>",), ">>": ("<<",)},
    **{"==": ("!=",), "!=": ("==",), "&&": ("||",), "||": ("&&",), "&": ("|",), "|": ("&",)},
    **{"++": ("--",), "--": ("++",), "+=": ("-=",), "-=": ("+=",), "|=": ("&=",), "&=": ("|=",)},
    **{"<<=": (">>=",), ">>=": ("<<=",), "true": ("false",), "false": ("true",), "^": ("|", "&")},
    **{"<": ("<=", ">="), "<=": ("<", ">"), ">": (">=", "<="), ">=": (">", "<")},
}
"""What a token is replaced by, one at a time."""
UNARY_OPERATORS = ("-", "~", "!")
TYPE_CAST = re.compile(r"\(\s*(?:const\s+)?(?:\w+_t|bool|float|char|int|void)\s*\**\s*\)$")
TYPE_BEFORE_POINTER = re.compile(r"(?:\b\w+_t|\bconst|\bvoid|\*)\s*$")
STATEMENT = re.compile(
    r"(?<=[;{}:])\s*((?:\+\+|--|\*|\(void\)(?=\w+\())?[a-z][\w>.\[\]\-]*\s*(?:(?:[-+|&<>^]*=|\()[^;{}]*)?;)"
)
CONDITION = re.compile(r"\b(if|while) \(")
SMALLER_OR_LARGER = re.compile(r"\b(\w+) ([<>]=?) (\w+) \? \1 : \3\b(?! [-+])")
"""Matches a choice of the smaller or larger of two numbers. It makes no difference which of two equal numbers
is chosen, and so none whether the operator is "<" or "<="."""


def path_of(file: str) -> Path:
    """Return the path of a mutated source."""
    return LANES_HEADER if file == LANES_HEADER.name else SOURCES / file


@dataclass(frozen=True)
class Mutant:
    """A source with one mistake in it.

    Attributes:
        file: Name of the source.
        function: Function with the mistake, or ``define NAME`` for a macro, or nothing for data.
        text: The line, in which brackets show what is replaced by what: ``return a [+ => -] b;``.
        start, end: First character that is replaced, and the character behind the last one.
        replacement: What stands there instead.
    """

    file: str
    function: str
    text: str
    start: int
    end: int
    replacement: str

    def source(self) -> str:
        """Return the whole file with the mistake in it."""
        correct_source = _read(self.file)
        return correct_source[: self.start] + self.replacement + correct_source[self.end :]

    @property
    def name(self) -> str:
        """Name without ``start`` and ``end``, which change with every line above them."""
        return f"{self.file} {self.function}: {self.text}"


@dataclass(frozen=True)
class Region:
    """A function or macro in a source, with its first character and the one behind its last."""

    start: int
    end: int
    name: str


@dataclass(frozen=True, order=True)
class Change:
    """A replacement of some characters of a source."""

    start: int
    end: int
    replacement: str


def mutants(file: str) -> Iterator[Mutant]:
    """Yield all mutants of a source, in its order. No two have the same name."""
    source = _read(file)
    # What is blanked keeps its length, so that positions in the code are those in the source.
    code = NOT_CODE.sub(_blank, source)
    regions = list(_functions(code))
    regions += [Region(*macro.span(), f"define {macro[1]}") for macro in DEFINITION.finditer(source)]
    changes = set(_changes_of_statements(code))
    # Values of macros are mutated, too, but only their tokens.
    code = _with_macro_values(code, source)
    changes |= set(_changes_of_tokens(code))
    name_counts: Counter[str] = Counter()
    for change in sorted(changes):
        mutant = _mutant_of(change, file, code, regions)
        name_counts[mutant.name] += 1
        occurrence = name_counts[mutant.name]
        yield mutant if occurrence == 1 else replace(mutant, text=f"{mutant.text} ({occurrence})")


def _read(file: str) -> str:
    return path_of(file).read_text(encoding="utf-8")


def _blank(match: re.Match[str]) -> str:
    """Return spaces and line ends in place of a match, as many characters as it has."""
    return re.sub(r"[^\n]", " ", match[0])


def _with_macro_values(code: str, source: str) -> str:
    """Return the code with the values of the source's macros, which were blanked there."""
    for macro in DEFINITION.finditer(source):
        if not UNCHANGED_DEFINITIONS.match(macro[1]):
            value = COMMENT.sub(_blank, macro[2]).replace("\\", " ")
            code = code[: macro.start(2)] + value + code[macro.end(2) :]
    return code


def _mutant_of(change: Change, file: str, code: str, regions: list[Region]) -> Mutant:
    """Return the mutant of a change, named after its line and the function or macro around it."""
    line_start, line_end = code.rfind("\n", 0, change.start) + 1, code.find("\n", change.end)
    replaced = code[change.start : change.end]
    line = (
        f"{code[line_start : change.start]}[{replaced} => {change.replacement}]{code[change.end : line_end]}"
    )
    names = [region.name for region in regions if region.start <= change.start < region.end]
    function = names[0] if names else ""
    return Mutant(file, function, " ".join(line.split()), change.start, change.end, change.replacement)


def _functions(code: str) -> Iterator[Region]:
    for head in FUNCTION_HEAD.finditer(code):
        opening_brace = head.end() - 1
        yield Region(head.start(), _closing_bracket(code, opening_brace), head[1])


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


def _changes_of_statements(code: str) -> Iterator[Change]:
    """Yield changes that remove a statement, or let a condition always or never hold."""
    for function in _functions(code):
        body = code[function.start : function.end]
        for statement in STATEMENT.finditer(body):
            if not statement[1].startswith(("return", "for", "typedef", "static", "__asm__")):
                start, end = statement.span(1)
                yield Change(function.start + start, function.start + end, ";")
        for condition in CONDITION.finditer(body):
            opening_bracket = condition.end() - 1
            start = function.start + opening_bracket + 1
            end = function.start + _closing_bracket(body, opening_bracket)
            yield Change(start, end, "0")
            if condition[1] == "if":  # a loop without an end would only cost time
                yield Change(start, end, "1")


def _changes_of_tokens(code: str) -> Iterator[Change]:
    """Yield changes that replace an operator or a truth value, drop a unary one, or move a number by 1."""
    choices = {choice.start(2) for choice in SMALLER_OR_LARGER.finditer(code)}
    previous_token = ""
    for match in TOKEN.finditer(code):
        token, (start, end) = match[0], match.span()
        code_before = code[:start][-40:]
        # Behind an operand an operator is binary; a cast ends with a bracket, but is no operand.
        follows_operand = re.search(r"[\w)\]]$", previous_token) is not None
        follows_operand = follows_operand and not TYPE_CAST.search(code_before.rstrip())
        is_pointer = token in "*&" and (not follows_operand or TYPE_BEFORE_POINTER.search(code_before))
        if NUMBER.fullmatch(token):
            for number in _neighbours_of_number(token):
                yield Change(start, end, number)
        elif token in UNARY_OPERATORS and not follows_operand:
            yield Change(start, end, "")
        elif not is_pointer:
            for replacement in REPLACEMENTS.get(token, ()):
                if start in choices and replacement[0] == token[0]:
                    continue  # such as "<=" for "<"
                yield Change(start, end, replacement)
        previous_token = "" if token == "return" else token  # no operand, though it is a word


def _neighbours_of_number(number: str) -> Iterator[str]:
    """Yield the next larger number and, for numbers above 0, the next smaller one, with the same base."""
    value = int(number, 0)
    format_number = hex if number.startswith("0x") else str
    yield format_number(value + 1)
    if value > 0:
        yield format_number(value - 1)
