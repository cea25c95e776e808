"""With what a run ends: its report as JSON, or the line to type for the same run again."""

from __future__ import annotations

import argparse
import json
import shlex


def json_report(report: object) -> str:
    """A report for machines that people can read."""
    return json.dumps(report, indent=2)


def print_again(args: argparse.Namespace, **settled: object) -> None:
    """Print the command line of this run.

    It is what was typed, and in front of it ``settled`` parameters (the seed), whose defaults may change.
    """
    program, *words = args.command_line
    given = {word.partition("=")[0] for word in words}
    more = {f"--{name.replace('_', '-')}": value for name, value in settled.items()}
    options = [f"{option}={value}" for option, value in more.items() if option not in given]
    print(f"again: {program} {shlex.join([*options, *words])}".rstrip())
