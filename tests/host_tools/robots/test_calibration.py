"""A sensor's threshold and accuracy follow from readings over tiles of known colour."""

from __future__ import annotations

import json
import random
import shlex
import subprocess
import sys
from collections.abc import Callable
from io import BytesIO, TextIOWrapper
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from mcp_asdf.robot import Observation
from mcp_asdf_tools.cli.main import main
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.robots.calibration import Calibration, calibrate
from wire import record

Rows = list[tuple[float, bool]]
Capture = pytest.CaptureFixture[str]


# --- The threshold and the accuracy -------------------------------------------------------------------


def draw_readings(
    black_centre: float, white_centre: float, spread: float, rounding: Callable[[float], float]
) -> Rows:
    """Draw 60 readings over each colour around its centre, with a fixed seed."""
    draw = random.Random(f"{black_centre} {white_centre} {spread}")
    centres = [(black_centre, True), (white_centre, False)] * 60
    return [(float(rounding(draw.gauss(centre, spread))), is_black) for centre, is_black in centres]


def readings_over(rows: Rows, colour: str) -> NDArray[np.float64]:
    """Return the readings over tiles of a colour."""
    return np.array([reading for reading, is_black in rows if is_black == (colour == "black")])


def worse_accuracy(rows: Rows, threshold: float, black_is: str) -> float:
    """Return the accuracy over the colour that a threshold recognises worse."""
    black_below = np.mean(readings_over(rows, "black") < threshold)
    white_below = np.mean(readings_over(rows, "white") < threshold)
    if black_is == "below":
        return float(min(black_below, 1 - white_below))
    return float(min(1 - black_below, white_below))


SENSORS = [*product((300, 700), (60, 250), (round, float))]
"""Centre of the readings over black, their spread, and whether they are whole numbers."""


@pytest.mark.parametrize(("black_centre", "spread", "rounding"), SENSORS)
def test_no_threshold_recognises_the_worse_colour_better(
    black_centre: int, spread: int, rounding: Callable[[float], float]
) -> None:
    """The threshold below which a tile is taken for black is compared with each of the readings as one."""
    rows = draw_readings(black_centre, 1000 - black_centre, spread, rounding)
    calibration = calibrate(rows)
    best_accuracy = max(
        worse_accuracy(rows, threshold, black_is) for threshold, _ in rows for black_is in ("below", "above")
    )

    assert min(calibration.accuracy.values()) >= best_accuracy - 1e-12


@pytest.mark.parametrize(("black_centre", "spread", "rounding"), SENSORS)
def test_the_accuracies_are_those_of_readings_below_the_threshold(
    black_centre: int, spread: int, rounding: Callable[[float], float]
) -> None:
    """A sensor may read low numbers over black tiles (300 here), or high ones (700)."""
    rows = draw_readings(black_centre, 1000 - black_centre, spread, rounding)
    calibration = calibrate(rows)
    black_below = np.mean(readings_over(rows, "black") < calibration.threshold)
    white_below = np.mean(readings_over(rows, "white") < calibration.threshold)
    expected = {"black": black_below, "white": 1 - white_below}
    if black_centre == 700:
        expected = {"black": 1 - black_below, "white": white_below}

    assert calibration.black_is == ("below" if black_centre == 300 else "above")
    assert calibration.accuracy == pytest.approx(expected)


def test_a_threshold_lies_in_the_middle_of_the_gap_between_the_colours() -> None:
    assert calibrate([(7.5, True), (21.0, False)] * 40).threshold == 14.25


def test_the_threshold_of_whole_readings_is_a_whole_number() -> None:
    assert calibrate([(7.0, True), (21.0, False)] * 40).threshold == 14


def test_of_equal_thresholds_the_one_in_the_widest_gap_is_taken() -> None:
    """With each, nine of ten readings over the worse colour are right. The widest gap is from 0 to 8."""
    rows = [(0.0, True)] * 9 + [(8.0, False), (9.0, True)] + [(11.0, False)] * 9
    assert calibrate(rows).threshold == 4


UNEQUAL_ROWS: Rows = [
    *((float(number % 1000 < 870), False) for number in range(4000)),
    *((float(number % 1000 >= 970), True) for number in range(4000)),
]
"""Readings 0 and 1 with accuracy 0.97 over black and 0.87 over white tiles."""


@pytest.fixture(scope="module")
def unequal() -> Calibration:
    """The calibration of a sensor whose accuracy depends on the colour."""
    return calibrate(UNEQUAL_ROWS)


def test_each_colour_has_an_accuracy(unequal: Calibration) -> None:
    assert unequal.threshold == 1
    assert unequal.accuracy == {"black": 0.97, "white": 0.87}


def test_the_uncertainty_covers_the_true_mean_accuracy(unequal: Calibration) -> None:
    assert abs(unequal.b_hat - 0.92) < unequal.uncertainty < 0.01


def test_half_as_many_readings_are_less_certain_by_the_square_root_of_two(unequal: Calibration) -> None:
    assert calibrate(UNEQUAL_ROWS[::2]).uncertainty == pytest.approx(unequal.uncertainty * 2**0.5, rel=0.01)


def test_the_bias_is_the_error_of_a_robot_with_such_a_sensor(unequal: Calibration) -> None:
    """The robot looks at 1000 tiles, of which 400 are black."""
    black_observations = 0.97 * 400 + 0.13 * 600
    robot = record(1, "native", unequal.b_hat).make_robot()
    for number in range(1000):
        robot.observe(Observation(int(number < black_observations)))

    assert robot.x_hat == pytest.approx(0.4 + unequal.bias, abs=0.001)


def test_a_bias_of_more_than_two_hundredths_gives_a_warning(unequal: Calibration) -> None:
    assert unequal.warning is not None
    assert "x_hat is off by +0.060 on every floor" in unequal.warning


def test_a_sensor_without_a_wrong_reading_is_not_taken_for_perfect() -> None:
    """By the rule of succession, forty right readings over a colour make (40 + 1) / (40 + 2)."""
    calibration = calibrate([(7.0, True), (21.0, False)] * 40)
    assert calibration.b_hat == 41 / 42
    assert 0.02 < calibration.uncertainty < 0.04
    assert (calibration.bias, calibration.warning) == (0, None)


@pytest.mark.parametrize(
    "rows", [[(5.0, True), (5.0, False)] * 10, [(5.0, True), (5.0, False), (6.0, True), (6.0, False)] * 10]
)
def test_readings_that_do_not_distinguish_the_colours_are_refused(rows: Rows) -> None:
    with pytest.raises(UsageError, match="the readings do not tell black from white"):
        calibrate(rows)


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        ([], "0 readings over black tiles; take 10 or more"),
        ([(5.0, True)] * 10 + [(4.0, False)] * 9, "9 readings over white tiles; take 10 or more"),
    ],
)
def test_too_few_readings_over_a_colour_are_refused(rows: Rows, message: str) -> None:
    with pytest.raises(UsageError, match=message):
        calibrate(rows)


# --- The command --------------------------------------------------------------------------------------


@pytest.fixture
def readings_file(tmp_path: Path) -> Path:
    """A file of 180 readings, all of them right with the threshold 500."""
    path = tmp_path / "readings.csv"
    path.write_text("reading,colour\n" + "700,white\n300,black\n" * 90)
    return path


def run_calibrate(path: Path, *options: str) -> int:
    """Run ``mcp-asdf calibrate`` on a file, and return its exit code."""
    return main(["calibrate", str(path), *options])


def test_calibrate_prints_threshold_and_accuracy(readings_file: Path, capsys: Capture) -> None:
    assert run_calibrate(readings_file) == 0
    expected = "threshold 500: below it a tile is black\naccuracy on black 1.0000 (90 readings)\n"
    assert expected in capsys.readouterr().out


def test_calibrate_reports_threshold_and_accuracy_in_json(readings_file: Path, capsys: Capture) -> None:
    assert run_calibrate(readings_file, "--json") == 0
    report = json.loads(capsys.readouterr().out)
    assert report["threshold"] == 500
    assert report["accuracy"] == {"black": 1.0, "white": 1.0}


def test_calibrate_ends_with_the_option_that_tells_a_robot_its_accuracy(
    readings_file: Path, capsys: Capture
) -> None:
    run_calibrate(readings_file, "--json")
    report = json.loads(capsys.readouterr().out)
    run_calibrate(readings_file)
    option = f"--b-hat {report['b_hat']:.4f} (+- {report['uncertainty']:.4f}, 95 %)"

    assert capsys.readouterr().out.endswith(f"{option}\n")


def test_calibrate_warns_of_a_bias(readings_file: Path, capsys: Capture) -> None:
    readings_file.write_text(readings_file.read_text() + "300,white\n" * 10)
    assert run_calibrate(readings_file) == 0
    assert "x_hat is off by +0.056 on every floor" in capsys.readouterr().err


def test_calibrate_counts_the_lines_that_it_leaves_out(readings_file: Path, capsys: Capture) -> None:
    readings_file.write_text(readings_file.read_text() + "-1,white\n-1,black\n" * 5)
    assert run_calibrate(readings_file) == 0
    assert "left out 10 lines: reading -1 10\n" in capsys.readouterr().out


def test_calibrate_reports_the_lines_that_it_leaves_out_in_json(readings_file: Path, capsys: Capture) -> None:
    readings_file.write_text(readings_file.read_text() + "-1,white\n-1,black\n" * 5)
    assert run_calibrate(readings_file, "--json") == 0
    assert json.loads(capsys.readouterr().out)["left_out"] == {"reading -1": 10}


def test_lines_that_are_left_out_change_nothing_else(readings_file: Path, capsys: Capture) -> None:
    run_calibrate(readings_file)
    lines_before = capsys.readouterr().out.splitlines()
    readings_file.write_text(readings_file.read_text() + "-1,white\n-1,black\n" * 5)
    run_calibrate(readings_file)
    lines_after = capsys.readouterr().out.splitlines()

    assert [line for line in lines_after if not line.startswith("left out")] == lines_before


def test_too_few_readings_are_refused_with_the_lines_that_were_left_out(
    readings_file: Path, capsys: Capture
) -> None:
    readings_file.write_text("-1,black\n" * 30)
    assert run_calibrate(readings_file) == 2
    message = "0 readings over black tiles; take 10 or more, better 1000 (left out 30 lines"
    assert message in capsys.readouterr().err


def test_a_missing_file_of_readings_is_refused(tmp_path: Path, capsys: Capture) -> None:
    assert run_calibrate(tmp_path / "absent.csv") == 2
    assert "absent.csv: No such file or directory" in capsys.readouterr().err


# --- Encodings and standard input ---------------------------------------------------------------------


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])
def test_readings_may_have_the_encodings_of_excel(
    encoding: str, readings_file: Path, capsys: Capture
) -> None:
    readings_file.write_text("reading\tcolour\n" + "700\twhite\n300\tblack\n" * 90, encoding=encoding)
    assert run_calibrate(readings_file) == 0
    assert "threshold 500" in capsys.readouterr().out


def test_a_file_that_is_no_text_is_refused(readings_file: Path, capsys: Capture) -> None:
    readings_file.write_bytes(b"512,black\n\xe9")
    assert run_calibrate(readings_file) == 2
    assert "it is no text in UTF-8 (byte 10)" in capsys.readouterr().err


def test_readings_may_come_from_standard_input(monkeypatch: pytest.MonkeyPatch, capsys: Capture) -> None:
    monkeypatch.setattr("sys.stdin", TextIOWrapper(BytesIO(b"700,white\n300,black\n" * 90)))
    assert run_calibrate(Path("-")) == 0
    assert "threshold 500: below it a tile is black\n" in capsys.readouterr().out


def test_a_wrong_line_of_standard_input_is_named(monkeypatch: pytest.MonkeyPatch, capsys: Capture) -> None:
    monkeypatch.setattr("sys.stdin", TextIOWrapper(BytesIO(b"700,grey\n")))
    assert run_calibrate(Path("-")) == 2
    assert "standard input, line 1: '700,grey' has the colour" in capsys.readouterr().err


def test_closed_standard_input_is_refused(monkeypatch: pytest.MonkeyPatch, capsys: Capture) -> None:
    monkeypatch.setattr("sys.stdin", None)
    assert run_calibrate(Path("-")) == 2
    assert "cannot read standard input: it is closed" in capsys.readouterr().err


def test_standard_input_without_an_end_is_refused() -> None:
    command = f"yes 512,black | {shlex.quote(sys.executable)} -m mcp_asdf_tools.cli.main calibrate -"
    result = subprocess.run(["sh", "-c", command], capture_output=True, text=True, timeout=60, check=False)
    assert result.returncode == 2
    message = "cannot read standard input: it has more than 16777216 bytes; give a shorter one"

    assert message in result.stderr
