"""Reads the table of docs/reproduce.md, which says how to draw pictures like the figures of the paper."""

from __future__ import annotations

import re
from dataclasses import dataclass

from support import ROOT

REPRODUCE = ROOT / "docs/reproduce.md"


@dataclass(frozen=True)
class PaperFigures:
    """A row of the page's table.

    Attributes:
        command: The command that makes pictures like a figure of the paper.
        pictures: The names of their files.
    """

    command: str
    pictures: list[str]


def rows_by_figure_of_the_paper() -> dict[str, PaperFigures]:
    """Return the rows of the page's table by their first cells.

    The first cell is the number of a figure of the paper, or "all". The lines of the page have the form
    | figure | `command` | `picture`, `picture` |.
    """
    page = REPRODUCE.read_text("utf-8")
    rows = re.findall(r"^\| ([^|]+) \| `([^`]+)` \| ([^|]+) \|", page, re.MULTILINE)
    return {
        figures: PaperFigures(command, re.findall(r"`([^`]+)`", pictures))
        for figures, command, pictures in rows
    }
