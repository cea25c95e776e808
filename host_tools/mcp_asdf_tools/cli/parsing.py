"""Parser of a command line whose errors take two lines and offer what was probably meant."""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Sequence
from difflib import get_close_matches
from typing import Any, NoReturn


class Parser(argparse.ArgumentParser):
    """ArgumentParser of a command."""

    def __init__(self, prog: str, description: str, epilog: str | None = None) -> None:
        super().__init__(
            prog=prog,
            description=description,
            epilog=epilog,
            formatter_class=argparse.RawDescriptionHelpFormatter,
            allow_abbrev=False,
        )

    def parsed(self, words: Sequence[str]) -> argparse.Namespace:
        """The options; what was typed is in ``command_line``, program first."""
        found, unknown = self.parse_known_args(words)
        if unknown:
            first = next((word for word in unknown if word.startswith("-")), unknown[0])
            options = [option for action in self._actions for option in action.option_strings]
            kind = "option" if first.startswith("-") else "argument"
            self.error(f"no such {kind}: {first}{offer(first.partition('=')[0], options)}")
        found.command_line = [self.prog, *words]
        return found

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        """Offer the nearest choice; argparse's own message has none."""
        if action.choices is not None and value not in action.choices:
            known = ", ".join(map(str, action.choices))
            raise argparse.ArgumentError(
                action, f"{value!r} is none of {known}{offer(value, action.choices)}"
            )

    def error(self, message: str) -> NoReturn:
        """Print the error and where help is; end the program with exit code 2."""
        self.exit(2, f"{self.prog}: error: {message}\nSee '{self.prog} --help'.\n")


def offer(word: str, known: Iterable[str]) -> str:
    """A question that offers the nearest of the ``known`` words; nothing if none is near."""
    near = get_close_matches(word, list(known), n=1)
    return f"; did you mean {near[0]}?" if near else ""
