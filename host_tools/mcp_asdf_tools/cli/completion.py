"""``mcp-asdf completion``: a script with which a shell completes commands, options and their values."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import shtab

from mcp_asdf_tools.cli.main import whole_parser

EPILOG = """\
examples:
  mcp-asdf completion bash > ~/.local/share/bash-completion/completions/mcp-asdf
  mcp-asdf completion zsh > ~/.zfunc/_mcp-asdf          # a folder of your $fpath
  mcp-asdf completion fish > ~/.config/fish/completions/mcp-asdf.fish
New shells complete then; write the script again after an update.
exit code: 0 done, 2 bad usage"""

SHELLS = ("bash", "zsh", "fish")
_FOLDERS = ("DIR", "FOLDER")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("shell", choices=SHELLS, help="shell that the script is for")


def run(args: argparse.Namespace) -> int:
    """Print the script."""
    parser = whole_parser(_with_files)
    script = shtab.complete(parser, args.shell)
    print(json.dumps({"shell": args.shell, "script": script}) if args.json else script)
    return 0


def _with_files(parser: argparse.ArgumentParser) -> argparse.ArgumentParser:
    """The parser, whose options for files complete the names of files."""
    for action in parser._actions:
        if action.metavar in _FOLDERS:
            action.complete = shtab.DIRECTORY  # type: ignore[attr-defined] # shtab reads it
        elif action.type is Path or action.metavar == "FILE":
            action.complete = shtab.FILE  # type: ignore[attr-defined]
    return parser
