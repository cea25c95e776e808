"""Tables of texts in Markdown, for the studies' pages and the report."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence


def format_table(heads: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Return a table in Markdown with these heads of columns; each row of values becomes a line."""
    lines = [f"| {' | '.join(heads)} |", "|---" * len(heads) + "|"]
    for values in rows:
        texts = [str(value) for value in values]
        lines.append(f"| {' | '.join(texts)} |")
    return "\n".join(lines)


def format_cells(corner: str, text_by_cell: Mapping[tuple[str, str], str]) -> str:
    """Return a table in Markdown; ``text_by_cell`` has the texts of its cells by row and column.

    Cells without a text are empty. Rows and columns are in the order in which they first come in
    ``text_by_cell``. ``corner`` is the text in the upper left corner.
    """
    rows: list[str] = []
    columns: list[str] = []
    for row, column in text_by_cell:
        if row not in rows:
            rows.append(row)
        if column not in columns:
            columns.append(column)
    lines = []
    for row in rows:
        texts = [text_by_cell.get((row, column), "") for column in columns]
        lines.append([row, *texts])
    return format_table([corner, *columns], lines)
