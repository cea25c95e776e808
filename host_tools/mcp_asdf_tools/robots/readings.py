"""Readings of a ground sensor over tiles of known colour, as text of a sensor, R, Excel or pandas."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field

from mcp_asdf_tools.common.errors import UsageError

_IS_BLACK = {"black": True, "1": True, "white": False, "0": False}
_COLOUR_NAMES = ("colour", "color")
_NO_ANSWER = -1.0
"""What ``tile_sensor`` of docs/khepera.md prints when the sensor did not answer."""
_SEPARATORS = ";\t,"
"""The first of these in a line separates its columns; without any, white space does."""
_EXCEL_SEPARATOR = "sep="
_QUOTES = "\"'"


@dataclass
class Readings:
    """Readings, and the lines of their text that hold none.

    Attributes:
        rows: Each reading with whether its tile was black.
        left_out: Number of lines that were left out, by the reason.
    """

    rows: list[tuple[float, bool]] = field(default_factory=list)
    left_out: Counter[str] = field(default_factory=Counter)


def parse_readings(text: str, name: str) -> Readings:
    """Return the readings in lines such as ``512,black``.

    The columns may be separated by commas, semicolons, tabs or spaces. A header names the columns
    ``reading`` and ``colour``, others are ignored; without a header there are these two. With semicolons,
    tabs or spaces a number may have a decimal comma. Left out are readings of -1, words in place of a number
    (``NA``, ``nan``, an error text), comments, and a header that comes again. Raises UsageError, which names
    the text by ``name``, the line and its form, for anything else.
    """
    readings = Readings()
    header: Sequence[str] | None = None
    columns: _Columns | None = None
    for number, line in enumerate(text.splitlines(), start=1):
        position = f"{name}, line {number}: {line.strip()!r}"
        if not line.strip() or line.lower().startswith(_EXCEL_SEPARATOR):
            continue
        if line.lstrip().startswith("#"):
            readings.left_out["comment"] += 1
            continue
        fields = _split(line)
        if columns is None:  # the first line that is neither empty nor a comment
            columns = _columns_of_header(fields, position)
            if columns is not None:
                header = fields
                continue
            columns = _Columns(reading=0, colour=1, count=2)
        if fields == header:
            readings.left_out["header"] += 1
            continue
        reading_text, colour_text = columns.choose(fields, position)
        if colour_text not in _IS_BLACK:
            raise UsageError(f"{position} has the colour {colour_text!r}; write black or white, or 1 or 0")
        reading = _parse_number(reading_text, position)
        if reading is None:
            readings.left_out["no number"] += 1
        elif reading == _NO_ANSWER:
            readings.left_out["reading -1"] += 1
        else:
            readings.rows.append((reading, _IS_BLACK[colour_text]))
    return readings


@dataclass(frozen=True)
class _Columns:
    """Where a line has the reading and the colour.

    Attributes:
        reading: Index of the column with the reading.
        colour: Index of the column with the colour.
        count: Number of columns.
        has_header: Whether the first line names them. R then begins every other line with one more field,
            the name of the row.
    """

    reading: int
    colour: int
    count: int
    has_header: bool = False

    def choose(self, fields: Sequence[str], position: str) -> tuple[str, str]:
        """Return reading and colour of a line. Raises UsageError if it has another number of columns."""
        has_row_name = self.has_header and len(fields) == self.count + 1
        if len(fields) != self.count and not has_row_name:
            raise UsageError(
                f"{position} has {_count(len(fields), 'column')} where {self.count} are expected; write a "
                "reading and the colour of its tile, such as 512,black, or name the columns in the first line"
            )
        offset = 1 if has_row_name else 0
        return fields[self.reading + offset], fields[self.colour + offset]


def _columns_of_header(fields: Sequence[str], position: str) -> _Columns | None:
    """Return the columns that a header names, None if the line is none.

    Raises UsageError for a header that lacks one: a line of words alone, of which none is a colour.
    """
    colour_columns = [index for index, name in enumerate(fields) if name in _COLOUR_NAMES]
    if "reading" in fields and colour_columns:
        return _Columns(fields.index("reading"), colour_columns[0], len(fields), has_header=True)
    has_digit = any(character.isdigit() for name in fields for character in name)
    if has_digit or any(name in _IS_BLACK for name in fields):
        return None
    raise UsageError(f"{position} is a header without the columns reading and colour; rename them so")


def _split(line: str) -> list[str]:
    """Return the fields of a line in lower case, without quotes."""
    separator = next((character for character in _SEPARATORS if character in line), None)
    fields = line.split(separator)  # None splits at white space
    return [text.strip().strip(_QUOTES).strip().lower() for text in fields]


def _parse_number(text: str, position: str) -> float | None:
    """Return the number in a text such as ``512``, ``512.5`` or ``512,5``; None for a text without digits.

    Raises UsageError, naming the ``position``, for a text that has digits but is no finite number. To leave
    it out would hide that a form of numbers is misread.
    """
    if not any(character.isdigit() for character in text):
        return None
    # A comma beside a point is a separator of thousands, which float() refuses.
    text_with_point = text if "." in text else text.replace(",", ".")
    with suppress(ValueError):
        number = float(text_with_point)
        if math.isfinite(number):
            return number
    raise UsageError(
        f"{position} has the reading {text!r}, which is no number; write it as 512, 512.5 or 512,5 "
        "(with semicolons between columns), without separators of thousands and units"
    )


def _count(number: int, noun: str) -> str:
    """Return a number with its noun, which has an s unless it is one."""
    return f"{number} {noun}{'' if number == 1 else 's'}"
