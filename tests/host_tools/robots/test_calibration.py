"""A sensor's threshold and accuracy from readings over known tiles."""

from __future__ import annotations

import json
import random
import subprocess
import sys
from collections.abc import Callable
from io import BytesIO, TextIOWrapper
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from mcp_asdf.robot import Observation
from mcp_asdf_tools.cli.main import main
from mcp_asdf_tools.robots.calibration import calibrate
from mcp_asdf_tools.robots.readings import Readings, parse_readings
from wire import record

Rows = list[tuple[float, bool]]
Capture = pytest.CaptureFixture[str]


def drawn(black: float, white: float, spread: float, rounding: Callable[[float], float], count: int) -> Rows:
    draw = random.Random(f"{black} {white} {spread}")
    centres = [(black, True), (white, False)] * count
    return [(float(rounding(draw.gauss(centre, spread))), is_black) for centre, is_black in centres]


@pytest.mark.parametrize("case", [*product((300, 700), (60, 250), (round, float))])
def test_no_threshold_sees_the_worse_colour_better(case: tuple[int, int, Callable[[float], float]]) -> None:
    """By trying every threshold and either side; and the accuracies are those of ``reading < threshold``."""
    black, spread, rounding = case
    rows = drawn(black, 1000 - black, spread, rounding, 60)
    found = calibrate(rows)
    values = {False: np.array([r for r, is_black in rows if not is_black])}
    values[True] = np.array([r for r, is_black in rows if is_black])
    below = {colour: np.mean(values[colour] < found.threshold) for colour in values}
    is_below = found.black_is == "below"
    assert is_below == (black == 300)
    assert found.accuracy["black"] == pytest.approx(below[True] if is_below else 1 - below[True])
    assert found.accuracy["white"] == pytest.approx(1 - below[False] if is_below else below[False])
    for threshold, _ in rows:
        on_black, on_white = np.mean(values[True] < threshold), np.mean(values[False] >= threshold)
        assert (
            min(found.accuracy.values()) >= max(min(on_black, on_white), 1 - max(on_black, on_white)) - 1e-12
        )


def test_the_interval_holds_the_accuracy_and_the_bias_is_the_robot_s() -> None:
    """Accuracy 0.97 on black and 0.87 on white: a robot that starts with b_hat errs by the bias."""
    rows = [(float(number % 1000 < 870), False) for number in range(4000)]
    rows += [(float(number % 1000 >= 970), True) for number in range(4000)]
    found = calibrate(rows)
    assert found.threshold == 1
    assert found.accuracy == {"black": 0.97, "white": 0.87}
    assert abs(found.b_hat - 0.92) < found.uncertainty < 0.01
    assert found.warning is not None
    assert "+0.060" in found.warning
    robot = record(1, "native", found.b_hat).make_robot()
    for number in range(1000):  # of tiles of which 400 are black
        robot.observe(Observation(int(number < 0.97 * 400 + 0.13 * 600)))
    assert robot.x_hat == pytest.approx(0.4 + found.bias, abs=0.001)
    assert calibrate(rows[::2]).uncertainty == pytest.approx(found.uncertainty * 2**0.5, rel=0.01)


def test_colours_that_are_far_apart_are_no_proof_of_a_perfect_sensor() -> None:
    found = calibrate([(float(reading), reading < 10) for reading in range(8)] * 5 + [(21.0, False)] * 40)
    assert (found.threshold, found.black_is, found.warning, found.bias) == (14, "below", None, 0)
    assert found.b_hat == 41 / 42
    assert calibrate([(7.5, True), (21.0, False)] * 40).threshold == 14.25
    alike = [(0.0, True)] * 9 + [(8.0, False), (9.0, True)] + [(11.0, False)] * 9
    assert calibrate(alike).threshold == 4, "in the widest gap"
    assert 0.02 < found.uncertainty < 0.04


@pytest.mark.parametrize(
    ("lines", "told"),
    [
        ("reading,colour\n512,grey", "line 2: '512,grey' has the colour 'grey'; write black or white"),
        (
            "512",
            "line 1: '512' has 1 column where 2 are expected; write a reading and the colour of its tile",
        ),
        ("512,black,3", "line 1: '512,black,3' has 3 columns where 2 are expected"),
        ("512,5,black", "line 1: '512,5,black' has 3 columns"),
        ("1e999,1", "line 1: '1e999,1' has the reading '1e999', which is no number; write it as 512"),
        ("1.024,5;1", "line 1: '1.024,5;1' has the reading '1.024,5', which is no number"),
        ("512 mV;black", "line 1: '512 mV;black' has the reading '512 mv', which is no number"),
        ("512,black\nreading,colour", "line 2: 'reading,colour' has the colour 'colour'"),
        ("wert;farbe\n512;black", "line 1: 'wert;farbe' is a header without the columns reading and colour"),
        ("", "0 readings over black tiles; take 10 or more"),
        ("-1,black\n" * 30, "0 readings over black tiles; take 10 or more, better 1000 (left out 30 lines"),
        ("5,black\n" * 10 + "4,white\n" * 9, "9 readings over white tiles; take 10 or more"),
        ("5,1\n5,0\n" * 10, "the readings do not tell black from white"),
        ("5,1\n5,0\n6,1\n6,0\n" * 10, "the readings do not tell black from white"),
    ],
)
def test_what_cannot_be_used_is_named(lines: str, told: str, tmp_path: Path, capsys: Capture) -> None:
    (tmp_path / "readings.csv").write_text(lines, encoding="utf-8")
    assert main(["calibrate", str(tmp_path / "readings.csv")]) == 2
    assert told in capsys.readouterr().err


@pytest.mark.parametrize(
    "text",
    [
        "300,black\n700.5,white\n",
        "colour,reading\nBLACK,300\nWhite,700.5\n",
        "300;black\n700,5;white\n",
        "sep=;\nreading;color\n300;1\n700,5;0\n",
        "reading\tcolour\n300\tblack\n700,5\twhite\n",
        ",reading,colour\n0,300.0,black\n1,700.5,white\n",
        '"","reading","colour"\n"1",300,"black"\n"2",700.5,"white"\n',
        '"reading" "colour"\n"1" 300 "black"\n"2" 700.5 "white"\n',
        "time,reading,colour\n12:00:01,300,black\n12:00:02,700.5,white\n",
        "\n300 black\n\n700.5   white",
    ],
)
def test_readings_of_other_programs_are_read(text: str) -> None:
    """Of a sensor, of Excel in two languages, of pandas and of R's write.csv and write.table."""
    assert parse_readings(text, "x.csv") == Readings([(300.0, True), (700.5, False)])


def test_lines_that_hold_no_reading_are_left_out_and_counted() -> None:
    """-1 is what tile_sensor of docs/khepera.md prints when the sensor did not answer."""
    text = "reading,colour\n# bright\n300,black\n-1,black\n-1.0,white\nNA,black\nnan,white\n,black\n"
    text += "timeout,white\nreading,colour\n700,white\n"
    readings = parse_readings(text, "x.csv")
    assert readings.rows == [(300.0, True), (700.0, False)]
    assert readings.left_out == {"comment": 1, "reading -1": 2, "no number": 4, "header": 1}


def test_readings_of_a_sensor_that_did_not_answer_move_nothing(tmp_path: Path, capsys: Capture) -> None:
    path = tmp_path / "readings.csv"
    path.write_text("700,white\n300,black\n" * 95)
    assert main(["calibrate", str(path)]) == 0
    *all_but_last, last = capsys.readouterr().out.splitlines()
    path.write_text("700,white\n300,black\n" * 95 + "-1,white\n-1,black\n" * 5)
    assert main(["calibrate", str(path)]) == 0
    assert capsys.readouterr().out.splitlines() == [*all_but_last, "left out 10 lines: reading -1 10", last]
    assert main(["calibrate", str(path), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["left_out"] == {"reading -1": 10}


def test_readings_come_from_standard_input(monkeypatch: pytest.MonkeyPatch, capsys: Capture) -> None:
    monkeypatch.setattr("sys.stdin", TextIOWrapper(BytesIO(b"700,white\n300,black\n" * 90)))
    assert main(["calibrate", "-"]) == 0
    assert "threshold 500: below it a tile is black\n" in capsys.readouterr().out
    monkeypatch.setattr("sys.stdin", TextIOWrapper(BytesIO(b"700,grey\n")))
    assert main(["calibrate", "-"]) == 2
    assert "standard input, line 1: '700,grey' has the colour" in capsys.readouterr().err


def test_readings_without_an_end_are_refused() -> None:
    """By the command, as ``yes 512,black`` writes them."""
    command = f"yes 512,black | {sys.executable} -m mcp_asdf_tools.cli.main calibrate -"
    done = subprocess.run(["sh", "-c", command], capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 2
    assert "cannot read standard input: it has more than 16777216 bytes; give a shorter one" in done.stderr


def test_standard_input_may_be_closed(monkeypatch: pytest.MonkeyPatch, capsys: Capture) -> None:
    monkeypatch.setattr("sys.stdin", None)
    assert main(["calibrate", "-"]) == 2
    assert "cannot read standard input: it is closed" in capsys.readouterr().err


def test_excel_s_unicode_text_is_read(tmp_path: Path, capsys: Capture) -> None:
    path = tmp_path / "readings.txt"
    path.write_text("reading\tcolour\n" + "700\twhite\n300\tblack\n" * 90, encoding="utf-16")
    assert main(["calibrate", str(path)]) == 0
    assert "threshold 500" in capsys.readouterr().out
    path.write_bytes(b"512,black\n\xe9")
    assert main(["calibrate", str(path)]) == 2
    assert "it is no text in UTF-8 (byte 10)" in capsys.readouterr().err


def test_the_command_says_it_and_warns(tmp_path: Path, capsys: Capture) -> None:
    path = tmp_path / "readings.csv"
    path.write_text(
        "reading,colour\n" + "700, White\n300,black\n" * 90 + "300,0\n" * 10, encoding="utf-8-sig"
    )
    assert main(["calibrate", str(path)]) == 0
    said = capsys.readouterr()
    assert "threshold 500: below it a tile is black\naccuracy on black 1.0000 (90 readings)\n" in said.out
    assert "x_hat is off by +0.056 on every floor" in said.err
    assert main(["calibrate", str(path), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert (told["threshold"], told["accuracy"]) == (500, {"black": 1.0, "white": 0.9})
    assert said.out.endswith(f"--b-hat {told['b_hat']:.4f} (+- {told['uncertainty']:.4f}, 95 %)\n")
    assert told["warning"] in said.err
    assert main(["calibrate", str(tmp_path / "none.csv")]) == 2
