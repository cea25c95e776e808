"""Parser of a sensor's readings over tiles of known colour, as a sensor, R, Excel or pandas writes them."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

from mcp_asdf_tools.common.errors import UsageError

_IS_BLACK = {"black": True, "1": True, "white": False, "0": False}
_COLUMN_NAMES_OF_COLOUR = ("colour", "color")
_NO_ANSWER = -1.0
"""Reading that ``tile_sensor`` of docs/platforms/khepera.md prints if the sensor did not answer."""
_SEPARATORS = ";\t,"
"""Characters that may separate columns: the first of these that a line contains does. If it contains none of
them, white space separates its columns."""
_EXCEL_SEPARATOR_LINE = "sep="
"""Beginning of a line by which Excel learns the separator."""
_QUOTES = "\"'"


@dataclass
class Readings:
    """Readings in a text, and the number of lines without one.

    Attributes:
        rows: The readings, each with whether its tile was black.
        left_out: Number of lines that were left out, by the reason: "comment", "header", "no number" or
            "reading -1".
    """

    rows: list[tuple[float, bool]] = field(default_factory=list)
    left_out: Counter[str] = field(default_factory=Counter)


def parse_readings(readings_text: str, name: str) -> Readings:
    """Return the readings in a text with lines such as ``512,black``.

    Columns may be separated by commas, semicolons, tabs or spaces; unless it is by commas, a number may have
    a decimal comma. A header may name the columns ``reading`` and ``colour`` among others, which are ignored.
    Without a header, a line has these two.

    Readings of -1, words in place of a number (``NA``, ``nan``, an error text), comments and repeated headers
    are left out and counted. Raises UsageError, which names the text by ``name``, the line and what it should
    look like, for any other line.
    """
    readings = Readings()
    header: Sequence[str] | None = None
    columns: _Columns | None = None
    for position, fields in _lines_with_fields(readings_text, name, readings):
        if columns is None:  # this is the first line
            columns = _columns_of_header(fields, position)
            if columns is not None:
                header = fields
                continue
            columns = _Columns(reading_index=0, colour_index=1, count=2)
        if fields == header:
            readings.left_out["header"] += 1
            continue
        reading_text, colour_text = columns.choose(fields, position)
        _add_reading(readings, reading_text, colour_text, position)
    return readings


def _lines_with_fields(
    readings_text: str, name: str, readings: Readings
) -> Iterator[tuple[str, Sequence[str]]]:
    """Yield the position and the fields of each line of a text. Error messages begin with the position.

    Empty lines and Excel's line with the separator are skipped. So are comments, which ``readings`` counts as
    left out. The position has the text's ``name``, the number of the line and the line.
    """
    for line_number, line in enumerate(readings_text.splitlines(), start=1):
        stripped_line = line.strip()
        if not stripped_line or line.lower().startswith(_EXCEL_SEPARATOR_LINE):
            continue
        if stripped_line.startswith("#"):
            readings.left_out["comment"] += 1
            continue
        yield f"{name}, line {line_number}: {stripped_line!r}", _split(line)


def _add_reading(readings: Readings, reading_text: str, colour_text: str, position: str) -> None:
    """Add the reading and the colour of a line to ``readings``, or count the line as left out.

    Left out are texts without digits, such as ``NA``, and readings of -1. Raises UsageError, which begins
    with ``position``, for a text that is no colour, or has digits and is no number.
    """
    if colour_text not in _IS_BLACK:
        raise UsageError(f"{position} has the colour {colour_text!r}; write black or white, or 1 or 0")
    reading = _parse_number(reading_text, position)
    if reading is None:
        readings.left_out["no number"] += 1
    elif reading == _NO_ANSWER:
        # The sensor did not answer, so that this is no reading of either colour.
        readings.left_out["reading -1"] += 1
    else:
        readings.rows.append((reading, _IS_BLACK[colour_text]))


@dataclass(frozen=True)
class _Columns:
    """Positions of the two columns that matter in every line.

    Attributes:
        reading_index: Index of the reading.
        colour_index: Index of the tile's colour.
        count: Number of columns that a line has.
        has_header: Whether a header names them. Then a line may have one column more at its beginning: R
            begins every line with the row's name, and has no header above these names.
    """

    reading_index: int
    colour_index: int
    count: int
    has_header: bool = False

    def choose(self, fields: Sequence[str], position: str) -> tuple[str, str]:
        """Return the reading and the colour of a line.

        Below a header a line may have one more column: the name of the row, which comes first and is ignored.
        Raises UsageError, which begins with ``position``, if the line has another number of columns.
        """
        has_row_name = self.has_header and len(fields) == self.count + 1
        if len(fields) != self.count and not has_row_name:
            column_count = _count_with_noun(len(fields), "column")
            raise UsageError(
                f"{position} has {column_count} where {self.count} are expected; write a "
                "reading and the colour of its tile, such as 512,black, or name the columns in the first line"
            )
        # The name of the row moves the columns that the header names.
        offset = 1 if has_row_name else 0
        reading_text = fields[self.reading_index + offset]
        colour_text = fields[self.colour_index + offset]
        return reading_text, colour_text


def _columns_of_header(fields: Sequence[str], position: str) -> _Columns | None:
    """Return the columns that the first line names if it is a header, or None if it is a reading.

    A header has the names "reading" and "colour" (or "color") among its fields. Any other line with a digit,
    or with a colour such as "black", is a reading. Raises UsageError, which begins with ``position``, for a
    line that is neither: a header that lacks one of the two names.
    """
    colour_indices = [index for index, name in enumerate(fields) if name in _COLUMN_NAMES_OF_COLOUR]
    if "reading" in fields and colour_indices:
        return _Columns(fields.index("reading"), colour_indices[0], count=len(fields), has_header=True)
    has_digit = _has_digit("".join(fields))
    has_colour = not _IS_BLACK.keys().isdisjoint(fields)
    if has_digit or has_colour:
        return None
    raise UsageError(f"{position} is a header without the columns reading and colour; rename them so")


def _split(line: str) -> list[str]:
    """Return the fields of a line in lower case, without quotes.

    Semicolons separate them, otherwise tabs, otherwise commas, and white space if the line has none of these.
    """
    separators_in_line = [character for character in _SEPARATORS if character in line]
    separator = separators_in_line[0] if separators_in_line else None  # None stands for white space
    fields = line.split(separator)
    # White space may be outside the quotes, and inside.
    return [column.strip().strip(_QUOTES).strip().lower() for column in fields]


def _parse_number(number_text: str, position: str) -> float | None:
    """Return a number with a decimal point or comma; None for a text without digits, such as ``NA``.

    Raises UsageError, which begins with ``position``, for a text that has digits and is no finite number: if
    it were left out, nobody would notice that the file has another form.
    """
    if not _has_digit(number_text):
        return None
    # A comma beside a point is a separator of thousands, which float() refuses.
    text_with_point = number_text if "." in number_text else number_text.replace(",", ".")
    try:
        number = float(text_with_point)
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise UsageError(
            f"{position} has the reading {number_text!r}, which is no number; write it as 512, 512.5 or "
            "512,5 (with semicolons between columns), without separators of thousands and units"
        )
    return number


def _has_digit(text: str) -> bool:
    """Return whether a text has a digit anywhere."""
    return any(character.isdigit() for character in text)


def _count_with_noun(number: int, noun: str) -> str:
    """Return a number with its noun in the singular or plural, such as ``2 columns``."""
    plural_ending = "" if number == 1 else "s"
    return f"{number} {noun}{plural_ending}"
