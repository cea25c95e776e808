"""The assurance case names evidence that is there, and its figures are those of the evidence."""

from __future__ import annotations

import re

import assurance
from support import ROOT, run

TEXT = assurance.PAGE.read_text(encoding="utf-8")


def test_the_figures_are_not_stale() -> None:
    assert assurance.filled(TEXT) == TEXT, "run: PYTHONPATH=tests python -m assurance"


def test_the_commands_name_what_is_there() -> None:
    table = TEXT.partition("## The claims")[2].partition("<!--")[0]
    rows = [line.split("|") for line in table.splitlines() if "| **" in line]
    commands = [each for row in rows for each in re.findall(r"`([^`]+)`", row[3])]
    for command in commands:
        program, *words = command.split()
        assert program in ("pytest", "make", "mcp-asdf")
        if program == "make":
            run("make", "-n", *words)
        elif program == "pytest":
            assert all((ROOT / word).exists() for word in words), command
    assert len(commands) >= len(rows) > 5
