"""Small charts made of text."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from rich.text import Text

_BLOCKS, _ASCII_BLOCKS = " ▁▂▃▄▅▆▇█", " .:-=+*%#"
_BAR, _ASCII_BAR = "━─│", "=-|"


def sparkline(values: Sequence[float], width: int, top: float, ascii_only: bool) -> str:
    """The values as ``width`` columns, each the mean of its share of them; ``top`` is a whole column.

    Fewer values than columns give as many columns.
    """
    blocks = _ASCII_BLOCKS if ascii_only else _BLOCKS
    if not values or width <= 0:
        return ""
    parts = np.array_split(np.asarray(values, dtype=np.float64), min(width, len(values)))
    shares = [min(float(part.mean()) / top, 1.0) if top > 0 else 0.0 for part in parts]
    # What is not 0 shows at least the lowest block.
    return "".join(blocks[int(np.ceil(share * (len(blocks) - 1)))] for share in shares)


def bar(share: float, mark: float, width: int, style: str, ascii_only: bool) -> Text:
    """A bar of ``share``, 0 .. 1, of the width, with a line across it at ``mark``."""
    full, empty, line = tuple(_ASCII_BAR if ascii_only else _BAR)
    filled, at = (round(each * (width - 1)) for each in (share, mark))
    text = Text(full * (filled + 1), style=style) + Text(empty * (width - 1 - filled), style="dim")
    return text[:at] + Text(line, style="bold") + text[at + 1 :]


class TextMap:
    """A map of characters, to be filled from the middle of an arena outwards."""

    def __init__(self, columns: int, rows: int, sides: tuple[float, float]) -> None:
        """Show an arena with these sides in metres on so many characters."""
        self._size = np.array([columns, rows])
        self._sides = np.array(sides)
        self._cells = [[(" ", "")] * columns for _ in range(rows)]

    def put(self, place: NDArray[np.float64], glyph: str, style: str) -> None:
        """Put a character at a place in metres from the middle; what was there is gone."""
        column, row = self._cell(place)
        self._cells[row][column] = glyph, style

    def connect(self, start: NDArray[np.float64], end: NDArray[np.float64], glyph: str, style: str) -> None:
        """Put characters along a line."""
        count = int(np.abs(np.subtract(self._cell(start), self._cell(end))).max())
        for share in np.linspace(0, 1, count + 1)[1:-1].tolist():
            self.put(start + share * (end - start), glyph, style)

    def _cell(self, place: NDArray[np.float64]) -> tuple[int, int]:
        east, south = place / self._sides * (1, -1) + 0.5
        columns, rows = self._size.tolist()
        return min(max(int(east * columns), 0), columns - 1), min(max(int(south * rows), 0), rows - 1)

    def text(self) -> Text:
        """The rows, the north on top."""
        return Text("\n").join(Text.assemble(*row) for row in self._cells)
