"""The table of docs/reproduce.md, with the commands and the pictures for figures of the paper."""

from __future__ import annotations

import re
from dataclasses import dataclass

from support import ROOT

REPRODUCE = ROOT / "docs/reproduce.md"


@dataclass(frozen=True)
class PaperFigures:
    """A row of the page's table: a command, and the pictures that it makes like figures of the paper."""

    command: str
    pictures: list[str]


def rows_by_figure_of_the_paper() -> dict[str, PaperFigures]:
    """Return the rows of the page's table, by the number of the paper's figure or "all".

    A row is a line: | figure | `command` | `picture`, `picture` |.
    """
    page = REPRODUCE.read_text("utf-8")
    rows = re.findall(r"^\| ([^|]+) \| `([^`]+)` \| ([^|]+) \|", page, re.MULTILINE)
    return {
        figures: PaperFigures(command, re.findall(r"`([^`]+)`", pictures))
        for figures, command, pictures in rows
    }
