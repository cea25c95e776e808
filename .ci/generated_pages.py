"""Parts of the documentation that are made from the program: its commands, C headers and Python packages."""

from __future__ import annotations

import argparse
import html
import re
from importlib import import_module
from pathlib import Path

from mcp_asdf_tools.cli import main as cli

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ROOT / "host_tools/mcp_asdf_tools"
HEADERS = ("mcp_asdf", "mcp_asdf_frame", "mcp_asdf_small", "mcp_asdf_image")

_LONG_OPTION = re.compile(r"(?<![\w-])--\w[\w-]*")


# --- Commands --------------------------------------------------------------------------------------------


def describe_commands() -> str:
    """Return every command with its options, as its parser has them, in Markdown."""
    sections = []
    for group_title, command_names in cli.GROUPS.items():
        commands = "\n".join(_describe_command(name) for name in command_names)
        sections.append(f"## {group_title}\n\n{commands}")
    return "\n".join(sections)


def _describe_command(name: str) -> str:
    """Return the description of a command, a table for each group of its options, and its examples."""
    parser = cli._parser_for(name, cli._load(name))
    parser.color = False  # from Python 3.14 on, where it is True, options have escape codes on a terminal
    parts = [f"### {name}\n\n{parser.description}\n"]
    for group in parser._action_groups:
        options = [action for action in group._group_actions if action.help is not argparse.SUPPRESS]
        if options:
            rows = "\n".join(_describe_option(parser, option) for option in options)
            title = _escape_markdown(group.title)
            parts.append(f"\n**{title}**\n\n| option | meaning |\n|---|---|\n{rows}\n")
    return "".join(parts) + _describe_epilog(parser.epilog or "")


def _describe_option(parser: argparse.ArgumentParser, option: argparse.Action) -> str:
    """Return an option and its meaning as a row of a table."""
    formatter = parser._get_formatter()
    usage = _in_one_cell(formatter._format_action_invocation(option))
    meaning = formatter._expand_help(option) if option.help else ""
    return f"| `{usage}` | {_format_sentences(_in_one_cell(meaning))} |"


def _describe_epilog(epilog: str) -> str:
    """Return the end of a help text: examples as code; sentences and exit codes as paragraphs."""
    title, *lines = epilog.splitlines()
    examples = [line for line in lines if line.startswith("  ")]
    text_behind_examples = " ".join(lines[len(examples) :])
    sentences, exit_code_title, exit_codes = text_behind_examples.partition("exit code:")
    paragraphs = [_format_sentences(sentences.strip()), _format_sentences(exit_code_title + exit_codes)]
    code_block = "\n".join(["```text", title, *examples, "```"])
    return f"\n{code_block}\n\n" + "\n\n".join(paragraphs) + "\n\n"


def _format_sentences(text: str) -> str:
    """Return sentences of a help text in Markdown, with options as code."""
    return _LONG_OPTION.sub(r"`\g<0>`", _escape_markdown(text))


def _escape_markdown(text: str | None) -> str:
    """Return a text in which Markdown finds no markup."""
    return html.escape(text or "", quote=False).replace("*", r"\*")


def _in_one_cell(text: str) -> str:
    """Return a text that fits a cell of a table in Markdown, in one line."""
    return " ".join(text.split()).replace("|", "\\|")


# --- C headers -------------------------------------------------------------------------------------------


def list_headers() -> str:
    """Return the C headers, whose comments document them, as blocks of code."""
    sections = []
    for name in HEADERS:
        source = (ROOT / f"c_ref/src/{name}.h").read_text(encoding="utf-8")
        sections.append(f"## {name}.h\n\n```c\n{source}```\n")
    return "\n".join(sections)


# --- Python packages -------------------------------------------------------------------------------------


def package_names() -> list[str]:
    """Return the packages of the tools whose functions others call; the command line is for people."""
    return sorted(path.parent.name for path in PACKAGES.glob("*/__init__.py") if path.parent.name != "cli")


def list_packages() -> str:
    """Return a line on each package, with a link to its page."""
    return "\n".join(f"- [{name}](api/{name}.md): {_summary(name)}" for name in package_names())


def package_page(package_name: str) -> str:
    """Return the page of a package, on which mkdocstrings puts its public classes and functions."""
    module_names = sorted(path.stem for path in (PACKAGES / package_name).glob("[!_]*.py"))
    directives = [f"::: mcp_asdf_tools.{package_name}.{module_name}\n" for module_name in module_names]
    return f"# {package_name}\n\n{_summary(package_name)}\n\n" + "\n".join(directives)


def _summary(package_name: str) -> str:
    return (import_module(f"mcp_asdf_tools.{package_name}").__doc__ or "").strip()
