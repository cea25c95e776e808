"""Parser of a command line: a short help and a full one, and errors that offer what was probably meant."""

from __future__ import annotations

import argparse
import re
from collections.abc import Sequence
from typing import Any, NoReturn

from mcp_asdf_tools.common.errors import UsageError, offer

_FEW, _FIRST = 4, 5
"""Options that are not worth hiding; examples of a short help."""


class Parser(argparse.ArgumentParser):
    """ArgumentParser of a command. ``--help`` shows some examples and their options."""

    def __init__(self, prog: str, description: str, epilog: str | None = None) -> None:
        raw = argparse.RawDescriptionHelpFormatter
        super().__init__(prog, None, description, epilog, formatter_class=raw, allow_abbrev=False)

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

    def format_help(self) -> str:
        """What ``--help`` shows."""
        lines = (self.epilog or "").splitlines()
        more = [line for line in lines if line.startswith(f"  {self.prog} ")][_FIRST:]
        epilog = "\n".join(line for line in lines if line not in more)
        words = set(re.findall(r"--?[a-z][a-z-]*", epilog)) | {"--help", "--help-all", "--json"}
        shown = [
            each
            for each in self._actions
            if each.required or not each.option_strings or words & {*each.option_strings}
        ]
        hidden = len(self._actions) - len(shown)
        if hidden < _FEW:
            return super().format_help()
        formatter = self._get_formatter()
        formatter.add_usage(None, [each for each in shown if not each.option_strings], [])
        formatter.add_text(self.description)
        for group in self._action_groups:
            own = [each for each in group._group_actions if each in shown]
            formatter.start_section(group.title)
            formatter.add_text(group.description if own else None)
            formatter.add_arguments(own)
            formatter.end_section()
        formatter.add_text(f"{hidden} options more, and examples: {self.prog} --help-all")
        formatter.add_text(epilog)
        return formatter.format_help().replace(self.prog, f"{self.prog} [OPTION ...]", 1)

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        """Offer the nearest choice; argparse's own message has none."""
        if action.choices is not None and value not in action.choices:
            known = ", ".join(map(str, action.choices))
            raise argparse.ArgumentError(
                action, f"{value!r} is none of {known}{offer(value, action.choices)}"
            )

    def error(self, message: str) -> NoReturn:
        """Raise UsageError, which ends the program as any other does."""
        raise UsageError(message)


class HelpAll(argparse.Action):
    """Print the whole help, and end the program."""

    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> None:
        """Find ``--help-all``."""
        print(argparse.ArgumentParser.format_help(parser), end="")
        parser.exit()
