"""The end of a command's output: its report as JSON, or the line to type for the same run again."""

from __future__ import annotations

import argparse
import json
import shlex


def json_report(report: object) -> str:
    """Return a report of plain values as indented JSON."""
    return json.dumps(report, indent=2)


def print_again(args: argparse.Namespace, **settled_parameters: object) -> None:
    """Print the command line that makes the same run again.

    It is what the user typed. In front of it are those ``settled_parameters``, such as the seed, that the
    user left to their defaults, since a later version may have other defaults.
    """
    program, *words = args.command_line
    typed_options = {word.partition("=")[0] for word in words}
    settled_options = []
    for name, value in settled_parameters.items():
        option = f"--{name.replace('_', '-')}"
        if option not in typed_options:
            settled_options.append(f"{option}={value}")
    print(f"again: {program} {shlex.join([*settled_options, *words])}".rstrip())
