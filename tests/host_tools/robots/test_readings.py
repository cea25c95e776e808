"""Readings of a sensor are parsed in every form that common programs write, and other lines are named."""

from __future__ import annotations

import pytest

from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.robots.readings import Readings, parse_readings

BLACK, WHITE = True, False


@pytest.mark.parametrize(
    ("program", "text"),
    [
        ("a sensor", "300,black\n700.5,white\n"),
        ("a sensor with spaces", "\n300 black\n\n700.5   white"),
        ("a sensor with capitals and a header", "colour,reading\nBLACK,300\nWhite,700.5\n"),
        ("a logger with times", "time,reading,colour\n12:00:01,300,black\n12:00:02,700.5,white\n"),
        ("German Excel", "300;black\n700,5;white\n"),
        ("Excel with its separator", "sep=;\nreading;color\n300;1\n700,5;0\n"),
        ("Excel as text", "reading\tcolour\n300\tblack\n700,5\twhite\n"),
        ("pandas", ",reading,colour\n0,300.0,black\n1,700.5,white\n"),
        ("write.csv of R", '"","reading","colour"\n"1",300,"black"\n"2",700.5,"white"\n'),
        ("write.table of R", '"reading" "colour"\n"1" 300 "black"\n"2" 700.5 "white"\n'),
    ],
)
def test_readings_are_parsed_in_the_forms_that_common_programs_write(program: str, text: str) -> None:
    """Each text has a reading of 300 over a black tile, and one of 700.5 over a white tile."""
    readings = parse_readings(text, "x.csv")
    assert readings == Readings([(300.0, BLACK), (700.5, WHITE)]), program


def test_readings_of_minus_one_are_left_out_and_counted() -> None:
    """A program that reads a sensor may print -1 if the sensor did not answer.

    tile_sensor of docs/platforms/khepera.md does. Of four lines two have a -1, which may be a -1.0.
    """
    readings = parse_readings("300,black\n-1,black\n-1.0,white\n700,white\n", "x.csv")
    assert readings.rows == [(300.0, BLACK), (700.0, WHITE)]
    assert readings.left_out == {"reading -1": 2}


@pytest.mark.parametrize("word", ["NA", "nan", "", "timeout"])
def test_a_reading_that_is_a_word_in_place_of_a_number_is_left_out_and_counted(word: str) -> None:
    """A program may write "NA", "nan", "timeout" or nothing if the sensor did not answer.

    The line counts as "no number".
    """
    readings = parse_readings(f"300,black\n{word},black\n", "x.csv")
    assert readings.rows == [(300.0, BLACK)]
    assert readings.left_out == {"no number": 1}


def test_comments_and_repeated_headers_are_left_out_and_counted() -> None:
    """A line that begins with # counts as "comment", and a second header as "header".

    The first header belongs to the file, and is not counted.
    """
    lines = ["reading,colour", "# bright", "300,black", "reading,colour", "7,white"]
    readings = parse_readings("\n".join(lines), "x.csv")
    assert readings.rows == [(300.0, BLACK), (7.0, WHITE)]
    assert readings.left_out == {"comment": 1, "header": 1}


@pytest.mark.parametrize(
    ("text", "expected_message"),
    [
        ("reading,colour\n512,grey", "line 2: '512,grey' has the colour 'grey'; write black or white, or 1"),
        ("512", "line 1: '512' has 1 column where 2 are expected; write a reading and the colour of"),
        ("512,black,3", "line 1: '512,black,3' has 3 columns where 2 are expected"),
        ("512,5,black", "line 1: '512,5,black' has 3 columns where 2 are expected"),
        ("1e999,1", "line 1: '1e999,1' has the reading '1e999', which is no number; write it as 512"),
        ("1.024,5;1", "line 1: '1.024,5;1' has the reading '1.024,5', which is no number"),
        ("512 mV;black", "line 1: '512 mV;black' has the reading '512 mv', which is no number"),
        ("512,black\nreading,colour", "line 2: 'reading,colour' has the colour 'colour'"),
        ("wert;farbe\n512;black", "line 1: 'wert;farbe' is a header without the columns reading and colour"),
    ],
)
def test_a_line_that_is_no_reading_with_a_colour_is_refused_by_its_number(
    text: str, expected_message: str
) -> None:
    """The error names the file, the line, what it has, and how it should be."""
    with pytest.raises(UsageError) as caught:
        parse_readings(text, "readings.csv")
    assert str(caught.value).startswith(f"readings.csv, {expected_message}")
