"""Parser of a command line whose errors take two lines and offer what was probably meant."""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Iterable, Sequence
from difflib import get_close_matches
from textwrap import fill
from typing import Any, NoReturn

_UNKNOWN = re.compile(r"unrecognized arguments: (.*)")
_NO_CHOICE = re.compile(r".*invalid choice: '(.*?)' \(choose from (.*)\)")


class _Formatter(argparse.HelpFormatter):
    """Formatter that wraps the prose around examples and lists, whose lines are indented and stay."""

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        lines: list[str] = []
        for line in text.splitlines():
            goes_on = lines and lines[-1][-1:] not in ("", ":") and not lines[-1].startswith(" ")
            if goes_on and not line.startswith((" ", "exit code")) and line:
                lines[-1] += f" {line}"
            else:
                lines.append(line)
        is_prose = [bool(line) and not line.startswith(" ") for line in lines]
        return "\n".join(
            fill(line, width) if wraps else line for line, wraps in zip(lines, is_prose, strict=True)
        )


class Parser(argparse.ArgumentParser):
    """ArgumentParser of a command; what it parses is in the result's ``command_line``, program first."""

    def __init__(self, prog: str, description: str, epilog: str | None = None) -> None:
        super().__init__(
            prog=prog,
            description=description,
            epilog=epilog,
            formatter_class=_Formatter,
            allow_abbrev=False,
        )

    def parse_known_args(  # type: ignore[override] # overloads of a method that takes any namespace
        self, args: Sequence[str] | None = None, namespace: Any = None
    ) -> tuple[Any, list[str]]:
        """Parse; see ``argparse.ArgumentParser``."""
        words = sys.argv[1:] if args is None else list(args)
        found, rest = super().parse_known_args(words, namespace)
        found.command_line = [self.prog, *words]
        return found, rest

    def error(self, message: str) -> NoReturn:
        """Print the error and where help is; end the program with exit code 2."""
        if found := _UNKNOWN.fullmatch(message):
            message = self._unknown(found.group(1).split())
        elif found := _NO_CHOICE.fullmatch(message):
            message += offer(found.group(1), found.group(2).replace("'", "").split(", "))
        self.exit(2, f"{self.prog}: error: {message}\nSee '{self.prog} --help'.\n")

    def _unknown(self, words: list[str]) -> str:
        options = [option for action in self._actions for option in action.option_strings]
        first = next((word for word in words if word.startswith("-")), words[0])
        kind = "option" if first.startswith("-") else "argument"
        return f"no such {kind}: {first}{offer(first.partition('=')[0], options)}"


def offer(word: str, known: Iterable[str]) -> str:
    """A question that offers the nearest of the ``known`` words; nothing if none is near."""
    near = get_close_matches(word, list(known), n=1)
    return f"; did you mean {near[0]}?" if near else ""
