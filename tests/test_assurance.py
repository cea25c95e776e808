"""The assurance case names evidence that is there, and its figures are those of the evidence."""

from __future__ import annotations

import re

import assurance
from support import ROOT, run

TEXT = assurance.PAGE.read_text(encoding="utf-8")
CLAIMS = (
    *(
        "Exact.",
        "Bounded.",
        "Total.",
        "Deterministic.",
        "Portable.",
        "O(1).",
        "No overflow",
        "Decisions right.",
    ),
    "The swarm agrees.",
)


def rows() -> dict[str, list[str]]:
    """Cells of the claims' table by the claim's name."""
    table = TEXT.partition("## The claims")[2].partition("<!--")[0]
    cells = [
        [each.strip() for each in line.split("|")[1:-1]] for line in table.splitlines() if "| **" in line
    ]
    return {re.findall(r"\*\*(.+?)\*\*", first)[0]: [first, *rest] for first, *rest in cells}


def test_the_figures_are_not_stale() -> None:
    assert assurance.filled(TEXT) == TEXT, "run: PYTHONPATH=tests python -m assurance"


def test_a_stale_figure_is_seen() -> None:
    assert assurance.filled(TEXT.replace("| api ", "| api 1")) == assurance.filled(TEXT) == TEXT


def test_each_claim_has_evidence_a_command_and_limits() -> None:
    assert list(rows()) == list(CLAIMS)
    for name, cells in rows().items():
        assert len(cells) == 4, name
        assert all(cells[:3]), name


def test_the_commands_name_what_is_there() -> None:
    commands = [each for cells in rows().values() for each in re.findall(r"`([^`]+)`", cells[2])]
    for command in commands:
        program, *words = command.split()
        assert program in ("pytest", "make", "mcp-asdf")
        if program == "make":
            run("make", "-n", *words)
        elif program == "pytest":
            assert all((ROOT / word).exists() for word in words), command
    assert len(commands) >= len(CLAIMS)
