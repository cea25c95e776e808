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

NOT_CODE = re.compile(
    r'/\*.*?\*/|"[^"\n]*"|^ASSERT\([^\n]*|^[ \t]*#(?:[^\n]*\\\n)*[^\n]*', re.MULTILINE | re.DOTALL
)
COMMENT = re.compile(r"/\*.*?\*/", re.DOTALL)
DEFINITION = re.compile(r"^#define (\w+)([ \t]+(?:[^\n]*\\\n)*[^\n]*)", re.MULTILINE)
COMPILERS = re.compile("MCP_ASDF|UNUSED|HOT|SHARED|WARM|ZEROS|NOINLINE|ALWAYS|FENCE")
"""Definitions that choose a way, or say something to a compiler."""
FUNCTION = re.compile(
    r"^(?!typedef|static const|ASSERT)[ \t]*\w[^;{}=]*?\b(\w+)\([^;{}]*\)\s*\{", re.MULTILINE
)
TOKEN = re.compile(
    r"->|<<=|>>=|\+\+|--|<<|>>|[<>=!+\-*/%&|^]=|&&|\|\|"
    r"|[-+*/%&|^~!<>=?:;,(){}\[\].]|0x[0-9A-Fa-f]+(?=U?\b)|\b\d+(?=U?\b)|\w+"
)
SWAPS = {
    **{"+": "-", "-": "+", "*": "+", "/": "*", "%": "/", "<<": ">>", ">>": "<<", "==": "!=", "!=": "=="},
    **{"&&": "||", "||": "&&", "&": "|", "|": "&", "++": "--", "--": "++"},
    **{"+=": "-=", "-=": "+=", "|=": "&=", "&=": "|=", "<<=": ">>=", ">>=": "<<=", "true": "false"},
    "false": "true",
}
TWICE = {"<": ("<=", ">="), "<=": ("<", ">"), ">": (">=", "<="), ">=": (">", "<"), "^": ("|", "&")}
UNARY = {"-": "", "~": "", "!": ""}
TYPE = re.compile(r"\(\s*(?:const\s+)?(?:\w+_t|bool|float|char|int|void)\s*\**\s*\)$")
DECLARES = re.compile(r"(?:\b\w+_t|\bconst|\bvoid|\*)\s*$")
STATEMENT = re.compile(
    r"(?<=[;{}:])\s*((?:\+\+|--|\*|\(void\))?[a-z][\w>.\[\]\-]*\s*(?:(?:[-+|&<>^]*=|\()[^;{}]*)?;)"
)
CONDITION = re.compile(r"\b(?:if|while) \(")


def path_of(file: str) -> Path:
    """Return the path of a mutated source."""
    return LANES_HEADER if file == LANES_HEADER.name else SOURCES / file


@dataclass(frozen=True)
class Mutant:
    """One mistake.

    Attributes:
        file: Name of the source.
        function: Where it is: the function, or ``define NAME``, or nothing for data.
        text: The line, with what is replaced and by what in brackets.
        start, end: Place in the source, of what ``new`` replaces.
    """

    file: str
    function: str
    text: str
    start: int
    end: int
    new: str

    def source(self) -> str:
        """Return the whole file with the mistake in it."""
        good = _read(self.file)
        return good[: self.start] + self.new + good[self.end :]

    @property
    def name(self) -> str:
        """Name without the place, which changes with every line above it."""
        return f"{self.file} {self.function}: {self.text}"


def _read(file: str) -> str:
    return path_of(file).read_text(encoding="utf-8")


def _blank(match: re.Match[str]) -> str:
    return re.sub(r"[^\n]", " ", match[0])


def mutants(file: str) -> Iterator[Mutant]:
    """Yield all mutants of a source, in its order."""
    good = _read(file)
    code = NOT_CODE.sub(_blank, good)
    places = [
        *_functions(code),
        *((*match.span(), f"define {match[1]}") for match in DEFINITION.finditer(good)),
    ]
    changes = {*_changes_of_statements(code)}
    for match in DEFINITION.finditer(good):
        if not COMPILERS.match(match[1]):
            value = COMMENT.sub(_blank, match[2]).replace("\\", " ")
            code = code[: match.start(2)] + value + code[match.end(2) :]
    names: Counter[str] = Counter()
    for change in sorted({*changes, *_changes_of_tokens(code)}):
        mutant = _mutant(file, code, places, change)
        names[mutant.name] += 1
        again = names[mutant.name]
        yield mutant if again == 1 else replace(mutant, text=f"{mutant.text} ({again})")


def _mutant(file: str, code: str, places: list[tuple[int, int, str]], change: tuple[int, int, str]) -> Mutant:
    start, end, new = change
    first, last = code.rfind("\n", 0, start) + 1, code.find("\n", end)
    text = f"{code[first:start]}[{code[start:end]} => {new}]{code[end:last]}"
    name = next((name for begin, stop, name in places if begin <= start < stop), "")
    return Mutant(file, name, " ".join(text.split()), start, end, new)


def _functions(code: str) -> Iterator[tuple[int, int, str]]:
    for match in FUNCTION.finditer(code):
        yield match.start(), _closing(code, match.end() - 1), match[1]


def _closing(code: str, opening: int) -> int:
    """Return the place of the bracket that closes this one."""
    depth = 0
    for place in range(opening, len(code)):
        depth += (code[place] in "({") - (code[place] in ")}")
        if depth == 0:
            return place
    raise ValueError(f"nothing closes {code[opening : opening + 40]!r}")


def _changes_of_statements(code: str) -> Iterator[tuple[int, int, str]]:
    for start, end, _ in _functions(code):
        body = code[start:end]
        for match in STATEMENT.finditer(body):
            if not match[1].startswith(("return", "for", "typedef", "static", "__asm__")):
                yield start + match.start(1), start + match.end(1), ";"
        for match in CONDITION.finditer(body):
            inside = start + match.end(), _closing(body, match.end() - 1) + start
            yield from (
                (*inside, value) for value in ("0", "1") if not match[0].startswith("while") or value == "0"
            )


def _changes_of_tokens(code: str) -> Iterator[tuple[int, int, str]]:
    before = ""
    for match in TOKEN.finditer(code):
        token, ahead = match[0], code[: match.start()]
        place = match.span()
        operand = re.search(r"[\w)\]]$", before) is not None and not TYPE.search(ahead[-40:].rstrip())
        if re.fullmatch(r"0x[0-9A-Fa-f]+|\d+", token):
            yield from ((*place, new) for new in _near(token))
        elif token in UNARY and not operand:
            yield (*place, UNARY[token])
        elif token in "*&" and (not operand or DECLARES.search(ahead[-40:])):
            pass  # a pointer
        elif token in TWICE:
            yield from ((*place, new) for new in TWICE[token])
        elif token in SWAPS:
            yield (*place, SWAPS[token])
        before = "" if token == "return" else token


def _near(number: str) -> Iterator[str]:
    value = int(number, 0)
    as_before = hex if number.startswith("0x") else str
    yield as_before(value + 1)
    if value > 0:
        yield as_before(value - 1)
