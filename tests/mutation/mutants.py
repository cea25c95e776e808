"""Mutants: sources with one small mistake in them, and the list of those that are no mistakes."""

from __future__ import annotations

import re
import tomllib
from collections import Counter
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from mutation import c_code, python_code
from mutation.changes import Change, changes_of_tokens

LINE_END = re.compile(r" /\*|  #|\n")
"""Matches the beginning of a comment, too."""


@dataclass(frozen=True)
class Mutant:
    """A source with one mistake in it.

    Attributes:
        path: The source.
        name: File, function and line, in which brackets show what is replaced by what:
            ``a.py add: return a [+ => -] b``. It stays the same when lines are added above.
        change: The characters that are replaced.
    """

    path: Path
    name: str
    change: Change

    def source(self) -> str:
        """Return the whole source with the mistake in it."""
        source = self.path.read_text(encoding="utf-8")
        return source[: self.change.start] + self.change.replacement + source[self.change.end :]


@cache
def equivalents() -> dict[str, str]:
    """Return the names of mutants that are no mistakes, with the reason of each."""
    groups = tomllib.loads(Path(__file__).with_name("equivalents.toml").read_text(encoding="utf-8"))
    return {name: reason for reason, names in groups.items() for name in names}


def mutants(path: Path) -> list[Mutant]:
    """Return all mutants of a source, in its order. No two have the same name."""
    source = path.read_text(encoding="utf-8")
    code = (python_code if path.suffix == ".py" else c_code).find_code(source)
    name_counts: Counter[str] = Counter()
    all_mutants = []
    for change in sorted({*code.changes, *changes_of_tokens(code.text)}):
        functions = [
            function.name for function in code.functions if function.start <= change.start < function.end
        ]
        name = f"{path.name} {functions[0] if functions else ''}: {_changed_line(source, change)}"
        name_counts[name] += 1
        unique_name = name if name_counts[name] == 1 else f"{name} ({name_counts[name]})"
        all_mutants.append(Mutant(path, unique_name, change))
    return all_mutants


def mistakes(path: Path) -> list[Mutant]:
    """Return the mutants of a source that are mistakes: all but the equivalents."""
    return [mutant for mutant in mutants(path) if mutant.name not in equivalents()]


def _changed_line(source: str, change: Change) -> str:
    """Return the line with a change, without indentation and comment: ``return a [+ => -] b;``."""
    line_start = source.rfind("\n", 0, change.start) + 1
    before = source[line_start : change.start]
    replaced = source[change.start : change.end]
    after = LINE_END.split(source[change.end :], maxsplit=1)[0]
    return " ".join(f"{before}[{replaced} => {change.replacement}]{after}".split())
