"""A sensor's threshold and accuracy follow from readings over tiles of known colour."""

from __future__ import annotations

import json
import random
from io import BytesIO, TextIOWrapper
from pathlib import Path
from unittest.mock import Mock

import pytest

from mcp_asdf.robot import Observation
from mcp_asdf_tools.cli.main import main
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.robots.calibration import Calibration, calibrate
from wire import setup_of_robot

ReadingsWithColours = list[tuple[float, bool]]
"""Readings of a sensor, each with whether it was over a black tile."""
BLACK, WHITE = True, False
Capture = pytest.CaptureFixture[str]


# --- The threshold and the accuracy -------------------------------------------------------------------


def draw_overlapping_readings(black_centre: float, *, are_whole: bool) -> ReadingsWithColours:
    """Draw 60 readings over each colour, which overlap, with a fixed seed.

    Those over black are around ``black_centre``, those over white around 1000 less that.
    """
    draw = random.Random(f"{black_centre} {are_whole}")
    readings: ReadingsWithColours = []
    for _ in range(60):
        for centre, colour in ((black_centre, BLACK), (1000 - black_centre, WHITE)):
            reading = draw.gauss(centre, 250)
            readings.append((float(round(reading)) if are_whole else reading, colour))
    return readings


def share_below(readings: ReadingsWithColours, colour: bool, threshold: float) -> float:
    """Return the share of the readings over a colour that are below a threshold."""
    readings_of_colour = [reading for reading, reading_colour in readings if reading_colour == colour]
    return sum(reading < threshold for reading in readings_of_colour) / len(readings_of_colour)


def accuracy_by_colour(readings: ReadingsWithColours, threshold: float, black_is: str) -> dict[str, float]:
    """Return the share of right readings over each colour, if readings "below" or "above" mean black."""
    black_below = share_below(readings, BLACK, threshold)
    white_below = share_below(readings, WHITE, threshold)
    if black_is == "below":
        return {"black": black_below, "white": 1 - white_below}
    return {"black": 1 - black_below, "white": white_below}


@pytest.mark.parametrize("black_centre", [300, 700])
@pytest.mark.parametrize("are_whole", [True, False])
def test_no_threshold_recognises_the_worse_colour_better_than_the_threshold_of_the_calibration(
    black_centre: int, are_whole: bool
) -> None:
    """The other thresholds are the readings themselves. Each is tried with black below it and above it.

    The readings are drawn around ``black_centre`` over black, and around 1000 less that over white.
    """
    readings = draw_overlapping_readings(black_centre, are_whole=are_whole)
    accuracy_on_worse_colour = min(calibrate(readings).accuracy.values())

    for other_threshold, _colour in readings:
        for black_is in ("below", "above"):
            other_accuracies = accuracy_by_colour(readings, other_threshold, black_is)
            assert min(other_accuracies.values()) <= accuracy_on_worse_colour + 1e-12


@pytest.mark.parametrize(("black_centre", "black_is"), [(300, "below"), (700, "above")])
def test_the_accuracies_of_a_sensor_are_its_shares_of_right_readings(
    black_centre: int, black_is: str
) -> None:
    """A sensor that reads low over black is right there below the threshold, and over white above it.

    The readings are drawn around ``black_centre`` over black, and around 1000 less that over white.
    """
    readings = draw_overlapping_readings(black_centre, are_whole=False)
    calibration = calibrate(readings)

    expected_accuracies = accuracy_by_colour(readings, calibration.threshold, black_is)
    assert calibration.black_is == black_is
    assert calibration.accuracy == pytest.approx(expected_accuracies)


@pytest.mark.parametrize(
    ("black_reading", "white_reading", "expected_threshold"),
    [(7.5, 21.0, (7.5 + 21.0) / 2), (7.0, 20.0, 14)],
    ids=["7.5 and 21", "7 and 20, whole numbers"],
)
def test_a_threshold_lies_in_the_middle_between_the_colours_and_is_whole_if_readings_are(
    black_reading: float, white_reading: float, expected_threshold: float
) -> None:
    """A sensor reads the same over all black tiles, and over all white ones.

    Half-way from 7 to 20 is 13.5, which is rounded up to 14.
    """
    readings = [(black_reading, BLACK), (white_reading, WHITE)] * 40
    assert calibrate(readings).threshold == expected_threshold


def test_of_equal_thresholds_the_one_in_the_widest_gap_is_taken() -> None:
    """A threshold between 0 and 8 is as good as one between 9 and 11: one of 20 readings is wrong.

    With the first it is the 9 over black, with the second the 8 over white. The gap from 0 to 8 is wider.
    """
    black_readings = [(0.0, BLACK)] * 9 + [(9.0, BLACK)]
    white_readings = [(8.0, WHITE)] + [(11.0, WHITE)] * 9
    assert calibrate(black_readings + white_readings).threshold == (0 + 8) / 2


def calibrate_with_accuracies(
    *, on_black: float, on_white: float, count_per_colour: int = 4000
) -> Calibration:
    """Return the calibration of a sensor that reads 0 over black, 1 over white, in these shares of cases."""
    right_over_black = round(on_black * count_per_colour)
    right_over_white = round(on_white * count_per_colour)
    return calibrate(
        [
            *[(0.0, BLACK)] * right_over_black,
            *[(1.0, BLACK)] * (count_per_colour - right_over_black),
            *[(1.0, WHITE)] * right_over_white,
            *[(0.0, WHITE)] * (count_per_colour - right_over_white),
        ]
    )


def test_the_uncertainty_covers_the_true_mean_accuracy() -> None:
    """The assumed accuracy b_hat is off by less than the uncertainty, which is below 0.01.

    The sensor is right on 0.97 of 4000 readings over black, and on 0.87 of 4000 over white.
    """
    calibration = calibrate_with_accuracies(on_black=0.97, on_white=0.87)
    mean_accuracy = (0.97 + 0.87) / 2
    assert abs(calibration.b_hat - mean_accuracy) < calibration.uncertainty < 0.01


def test_half_as_many_readings_give_an_accuracy_less_certain_by_the_square_root_of_two() -> None:
    """The uncertainty is larger by that factor, to within 1 %."""
    all_readings = calibrate_with_accuracies(on_black=0.97, on_white=0.87, count_per_colour=4000)
    half_of_them = calibrate_with_accuracies(on_black=0.97, on_white=0.87, count_per_colour=2000)
    assert half_of_them.uncertainty == pytest.approx(all_readings.uncertainty * 2**0.5, rel=0.01)


def test_the_bias_is_the_error_of_a_robot_with_such_a_sensor() -> None:
    """The robot looks at 1000 tiles, 400 of them black. Its estimate x_hat is too large by the bias.

    The sensor is right on 0.97 of the black tiles and on 0.87 of the white ones.
    """
    calibration = calibrate_with_accuracies(on_black=0.97, on_white=0.87)
    right_black_observations = round(0.97 * 400)
    wrong_black_observations = round((1 - 0.87) * 600)  # of white tiles
    black_observations = right_black_observations + wrong_black_observations

    robot = setup_of_robot(1, "native", b_hat=calibration.b_hat).make_robot()
    for _ in range(black_observations):
        robot.observe(Observation.BLACK)
    for _ in range(1000 - black_observations):
        robot.observe(Observation.WHITE)

    true_share_of_black = 0.4
    assert robot.x_hat == pytest.approx(true_share_of_black + calibration.bias, abs=0.001)


def test_a_sensor_without_a_wrong_reading_is_not_taken_for_perfect() -> None:
    """All forty readings over each colour are right, and yet the assumed accuracy b_hat is below 1.

    By Laplace's rule of succession it is (40 + 1) / (40 + 2). No bias follows, and no warning.
    """
    calibration = calibrate([(7.0, BLACK), (21.0, WHITE)] * 40)
    assert calibration.b_hat == (40 + 1) / (40 + 2)
    assert 1 - calibration.b_hat < calibration.uncertainty < 0.04
    assert calibration.bias == 0
    assert calibration.warning is None


@pytest.mark.parametrize("sensor_readings", [[5.0], [5.0, 6.0]])
def test_readings_that_are_the_same_over_both_colours_are_refused(sensor_readings: list[float]) -> None:
    """A sensor reads 5 everywhere, or 5 and 6 equally often over each colour. No threshold tells them."""
    readings_over_black = [(reading, BLACK) for reading in sensor_readings]
    readings_over_white = [(reading, WHITE) for reading in sensor_readings]
    with pytest.raises(UsageError, match="the readings do not tell black from white"):
        calibrate((readings_over_black + readings_over_white) * 10)


@pytest.mark.parametrize(
    ("readings", "expected_message"),
    [
        ([], "0 readings over black tiles; take 10 or more"),
        ([(5.0, BLACK)] * 10 + [(4.0, WHITE)] * 9, "9 readings over white tiles; take 10 or more"),
    ],
)
def test_too_few_readings_over_a_colour_are_refused(
    readings: ReadingsWithColours, expected_message: str
) -> None:
    """A calibration needs ten readings over each colour. The error has their number and the colour.

    One case has no reading at all, the other ten readings over black, but only nine over white.
    """
    with pytest.raises(UsageError, match=expected_message):
        calibrate(readings)


# --- The command --------------------------------------------------------------------------------------


def write_readings(folder: Path, lines: str) -> Path:
    """Write a file of readings, with a header above the lines, and return its path."""
    path = folder / "readings.csv"
    path.write_text("reading,colour\n" + lines)
    return path


def run_calibrate(path: Path, *options: str) -> int:
    """Run ``mcp-asdf calibrate`` on a file, and return its exit code."""
    return main(["calibrate", str(path), *options])


def test_the_command_calibrate_prints_threshold_and_accuracy(tmp_path: Path, capsys: Capture) -> None:
    """The file has 90 readings of 300 over black and 90 of 700 over white, so the threshold is 500."""
    readings_file = write_readings(tmp_path, "700,white\n300,black\n" * 90)
    assert run_calibrate(readings_file) == 0
    expected = "threshold 500: below it a tile is black\naccuracy on black 1.0000 (90 readings)\n"
    assert expected in capsys.readouterr().out


def test_readings_may_have_an_encoding_of_excel(tmp_path: Path, capsys: Capture) -> None:
    """Excel saves text as UTF-16, with tabs between the columns."""
    readings_file = tmp_path / "readings.txt"
    readings_file.write_text("reading\tcolour\n" + "700\twhite\n300\tblack\n" * 90, encoding="utf-16")
    assert run_calibrate(readings_file) == 0
    assert "threshold 500" in capsys.readouterr().out


def test_the_command_calibrate_reports_in_json_what_it_also_prints(tmp_path: Path, capsys: Capture) -> None:
    """The printed text ends with the option ``--b-hat``, which tells a robot the accuracy of its sensor."""
    readings_file = write_readings(tmp_path, "700,white\n300,black\n" * 90)
    assert run_calibrate(readings_file, "--json") == 0
    report = json.loads(capsys.readouterr().out)
    assert run_calibrate(readings_file) == 0
    printed_text = capsys.readouterr().out

    assert report["threshold"] == (700 + 300) / 2
    assert report["accuracy"] == {"black": 1.0, "white": 1.0}
    assert printed_text.endswith(f"--b-hat {report['b_hat']:.4f} (+- {report['uncertainty']:.4f}, 95 %)\n")


def test_the_command_calibrate_warns_of_a_bias(tmp_path: Path, capsys: Capture) -> None:
    """Ten of 100 readings over white are as over black. The bias is (1 - 0.9) / 2 / (1 + 0.9 - 1) = 0.056."""
    readings_file = write_readings(tmp_path, "700,white\n300,black\n" * 90 + "300,white\n" * 10)
    assert run_calibrate(readings_file) == 0
    assert "x_hat is off by +0.056 on every floor" in capsys.readouterr().err


def test_the_command_calibrate_reports_a_bias_and_the_warning_of_it_in_json(
    tmp_path: Path, capsys: Capture
) -> None:
    """A program that calibrates many sensors would otherwise accept one that is wrong on every floor.

    Ten of 100 readings over white are as over black. The bias is (1 - 0.9) / 2 / (1 + 0.9 - 1) = 0.056.
    """
    readings_file = write_readings(tmp_path, "700,white\n300,black\n" * 90 + "300,white\n" * 10)
    assert run_calibrate(readings_file, "--json") == 0
    report = json.loads(capsys.readouterr().out)

    assert report["bias"] == pytest.approx(0.056, abs=0.001)
    assert "x_hat is off by +0.056 on every floor" in report["warning"]


def test_the_command_calibrate_reports_how_many_lines_it_leaves_out(tmp_path: Path, capsys: Capture) -> None:
    """Ten readings are -1, which stands for a sensor that did not answer. All else is as without them."""
    readings_file = write_readings(tmp_path, "700,white\n300,black\n" * 90)
    run_calibrate(readings_file)
    lines_without_them = capsys.readouterr().out.splitlines()
    readings_file.write_text(readings_file.read_text() + "-1,white\n-1,black\n" * 5)

    assert run_calibrate(readings_file) == 0
    lines = capsys.readouterr().out.splitlines()
    run_calibrate(readings_file, "--json")
    report = json.loads(capsys.readouterr().out)

    assert "left out 10 lines: reading -1 10" in lines
    assert [line for line in lines if not line.startswith("left out")] == lines_without_them
    assert report["left_out"] == {"reading -1": 10}


def test_an_error_about_too_few_readings_says_how_many_lines_were_left_out(
    tmp_path: Path, capsys: Capture
) -> None:
    """All 30 readings are -1, which stands for a sensor that did not answer."""
    readings_file = write_readings(tmp_path, "-1,black\n" * 30)
    assert run_calibrate(readings_file) == 2
    message = "0 readings over black tiles; take 10 or more, better 1000 (left out 30 lines"
    assert message in capsys.readouterr().err


# --- Standard input -----------------------------------------------------------------------------------


def put_on_standard_input(monkeypatch: pytest.MonkeyPatch, content: bytes) -> None:
    """Let the program read these bytes from its standard input."""
    monkeypatch.setattr("sys.stdin", TextIOWrapper(BytesIO(content)))


def test_readings_may_come_from_standard_input(monkeypatch: pytest.MonkeyPatch, capsys: Capture) -> None:
    """A dash in place of the file stands for standard input."""
    put_on_standard_input(monkeypatch, b"700,white\n300,black\n" * 90)
    assert run_calibrate(Path("-")) == 0
    assert "threshold 500: below it a tile is black\n" in capsys.readouterr().out


def test_a_wrong_line_of_standard_input_is_named(monkeypatch: pytest.MonkeyPatch, capsys: Capture) -> None:
    """The colour of its only line is neither black nor white. The exit code is 2."""
    put_on_standard_input(monkeypatch, b"700,grey\n")
    assert run_calibrate(Path("-")) == 2
    assert "standard input, line 1: '700,grey' has the colour" in capsys.readouterr().err


def test_a_closed_standard_input_is_refused(monkeypatch: pytest.MonkeyPatch, capsys: Capture) -> None:
    """Python has None for such an input. The exit code is 2, and the error says that it is closed."""
    monkeypatch.setattr("sys.stdin", None)
    assert run_calibrate(Path("-")) == 2
    assert "cannot read standard input: it is closed" in capsys.readouterr().err


def test_standard_input_without_an_end_is_refused(monkeypatch: pytest.MonkeyPatch, capsys: Capture) -> None:
    """The input has as many bytes as are asked for, again and again. At most 16 MiB are read of it.

    The exit code is 2, and the error says so.
    """

    def read_from_endless_input(size: int) -> bytes:
        return b"5" * size

    monkeypatch.setattr("sys.stdin", Mock(buffer=Mock(read=read_from_endless_input)))
    assert run_calibrate(Path("-")) == 2
    message = f"cannot read standard input: it has more than {16 * 2**20} bytes; give a shorter one"
    assert message in capsys.readouterr().err
