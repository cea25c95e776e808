"""A sensor's threshold and accuracy follow from readings over tiles of known colour."""

from __future__ import annotations

import json
import random
from io import BytesIO, TextIOWrapper
from itertools import product
from pathlib import Path
from unittest.mock import Mock

import pytest

from mcp_asdf.robot import Observation
from mcp_asdf_tools.cli.main import main
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.robots.calibration import Calibration, calibrate
from wire import record as setup_of_robot

ReadingsWithColours = list[tuple[float, bool]]
"""Readings of a sensor, each with whether it was over a black tile."""
BLACK, WHITE = True, False
Capture = pytest.CaptureFixture[str]


# --- The threshold and the accuracy -------------------------------------------------------------------


def draw_readings(black_centre: float, *, are_whole: bool) -> ReadingsWithColours:
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


def shares_of_right_readings(readings: ReadingsWithColours, threshold: float) -> dict[str, dict[str, float]]:
    """Return the accuracy on each colour, twice: if readings "below" or "above" the threshold mean black."""
    black_below = share_below(readings, BLACK, threshold)
    white_below = share_below(readings, WHITE, threshold)
    return {
        "below": {"black": black_below, "white": 1 - white_below},
        "above": {"black": 1 - black_below, "white": white_below},
    }


@pytest.mark.parametrize("black_centre", [300, 700])
@pytest.mark.parametrize("are_whole", [True, False])
def test_no_threshold_recognises_the_worse_colour_better_than_the_threshold_of_the_calibration(
    black_centre: int, are_whole: bool
) -> None:
    """Each of the readings is tried as a threshold, with black below it and above it."""
    readings = draw_readings(black_centre, are_whole=are_whole)
    calibration = calibrate(readings)

    for reading, _ in readings:
        for accuracy in shares_of_right_readings(readings, threshold=reading).values():
            assert min(calibration.accuracy.values()) >= min(accuracy.values()) - 1e-12


@pytest.mark.parametrize(("black_centre", "black_is"), [(300, "below"), (700, "above")])
def test_the_accuracies_of_a_sensor_are_its_shares_of_right_readings(
    black_centre: int, black_is: str
) -> None:
    """A sensor that reads low over black is right there below the threshold, and over white above it."""
    readings = draw_readings(black_centre, are_whole=False)
    calibration = calibrate(readings)

    accuracies = shares_of_right_readings(readings, calibration.threshold)
    assert calibration.black_is == black_is
    assert calibration.accuracy == pytest.approx(accuracies[black_is])


@pytest.mark.parametrize(("black", "white", "threshold"), [(7.5, 21.0, 14.25), (7.0, 20.0, 14)])
def test_a_threshold_lies_in_the_middle_between_the_colours_and_is_whole_if_readings_are(
    black: float, white: float, threshold: float
) -> None:
    """A sensor reads the same over all black tiles. Half-way from 7 to 20 is 13.5, which is rounded up."""
    assert calibrate([(black, BLACK), (white, WHITE)] * 40).threshold == threshold


def test_of_equal_thresholds_the_one_in_the_widest_gap_is_taken() -> None:
    """With each, nine of ten readings over the worse colour are right. The widest gap is from 0 to 8."""
    readings = [(0.0, BLACK)] * 9 + [(8.0, WHITE), (9.0, BLACK)] + [(11.0, WHITE)] * 9
    assert calibrate(readings).threshold == 4


UNEQUAL_READINGS: ReadingsWithColours = [
    *[(0.0, BLACK)] * 3880,
    *[(1.0, BLACK)] * 120,
    *[(1.0, WHITE)] * 3480,
    *[(0.0, WHITE)] * 520,
]
"""4000 readings over each colour. Over black, 0.97 of them are 0; over white, 0.87 are 1."""


@pytest.fixture(scope="module")
def unequal_calibration() -> Calibration:
    """The calibration of a sensor that is right on 0.97 of black tiles, and on 0.87 of white ones."""
    return calibrate(UNEQUAL_READINGS)


def test_each_colour_has_an_accuracy(unequal_calibration: Calibration) -> None:
    """The share of right readings is 0.97 over black tiles, and 0.87 over white ones."""
    assert unequal_calibration.threshold == 1
    assert unequal_calibration.accuracy == {"black": 0.97, "white": 0.87}


def test_the_uncertainty_covers_the_true_mean_accuracy(unequal_calibration: Calibration) -> None:
    """The assumed accuracy b_hat is off by less than the uncertainty, which is below 0.01."""
    mean_accuracy = (0.97 + 0.87) / 2
    assert abs(unequal_calibration.b_hat - mean_accuracy) < unequal_calibration.uncertainty < 0.01


def test_half_as_many_readings_give_an_accuracy_less_certain_by_the_square_root_of_two(
    unequal_calibration: Calibration,
) -> None:
    """The uncertainty is larger by that factor, to within 1 %."""
    every_second_reading = UNEQUAL_READINGS[::2]
    uncertainty = calibrate(every_second_reading).uncertainty
    assert uncertainty == pytest.approx(unequal_calibration.uncertainty * 2**0.5, rel=0.01)


def test_the_bias_is_the_error_of_a_robot_with_such_a_sensor(unequal_calibration: Calibration) -> None:
    """The robot looks at 1000 tiles, 400 of them black. Its estimate x_hat is too large by the bias."""
    black_observations = round(0.97 * 400 + (1 - 0.87) * 600)  # right ones, and wrong ones over white
    robot = setup_of_robot(1, "native", unequal_calibration.b_hat).make_robot()
    for _ in range(black_observations):
        robot.observe(Observation.BLACK)
    for _ in range(1000 - black_observations):
        robot.observe(Observation.WHITE)

    assert robot.x_hat == pytest.approx(0.4 + unequal_calibration.bias, abs=0.001)


def test_a_bias_of_more_than_two_hundredths_gives_a_warning(unequal_calibration: Calibration) -> None:
    """The bias is half of the difference of the accuracies, 0.97 and 0.87, divided by their sum less 1."""
    assert unequal_calibration.warning is not None
    assert "x_hat is off by +0.060 on every floor" in unequal_calibration.warning


def test_a_sensor_without_a_wrong_reading_is_not_taken_for_perfect() -> None:
    """b_hat is (40 + 1) / (40 + 2) after forty right readings over each colour, by the rule of succession."""
    calibration = calibrate([(7.0, BLACK), (21.0, WHITE)] * 40)
    assert calibration.b_hat == (40 + 1) / (40 + 2)
    assert 1 - calibration.b_hat < calibration.uncertainty < 0.04
    assert calibration.bias == 0
    assert calibration.warning is None


@pytest.mark.parametrize("readings", [(5.0,), (5.0, 6.0)])
def test_readings_that_are_the_same_over_both_colours_are_refused(readings: tuple[float, ...]) -> None:
    """The error says so, since no threshold tells black from white."""
    with pytest.raises(UsageError, match="the readings do not tell black from white"):
        calibrate([*product(readings, (BLACK, WHITE))] * 10)


@pytest.mark.parametrize(
    ("readings", "message"),
    [
        ([], "0 readings over black tiles; take 10 or more"),
        ([(5.0, BLACK)] * 10 + [(4.0, WHITE)] * 9, "9 readings over white tiles; take 10 or more"),
    ],
)
def test_too_few_readings_over_a_colour_are_refused(readings: ReadingsWithColours, message: str) -> None:
    """A calibration needs ten readings over each colour. The error has their number and the colour."""
    with pytest.raises(UsageError, match=message):
        calibrate(readings)


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


def test_the_command_calibrate_prints_threshold_and_accuracy(readings_file: Path, capsys: Capture) -> None:
    """The file has 90 readings of 300 over black and 90 of 700 over white, so the threshold is 500."""
    assert run_calibrate(readings_file) == 0
    expected = "threshold 500: below it a tile is black\naccuracy on black 1.0000 (90 readings)\n"
    assert expected in capsys.readouterr().out


def test_the_command_calibrate_reports_in_json_what_it_also_prints(
    readings_file: Path, capsys: Capture
) -> None:
    """The printed text ends with the option ``--b-hat``, which tells a robot the accuracy of its sensor."""
    assert run_calibrate(readings_file, "--json") == 0
    report = json.loads(capsys.readouterr().out)
    run_calibrate(readings_file)
    output = capsys.readouterr().out

    assert report["threshold"] == 500  # between readings of 300 over black and of 700 over white
    assert report["accuracy"] == {"black": 1.0, "white": 1.0}
    assert output.endswith(f"--b-hat {report['b_hat']:.4f} (+- {report['uncertainty']:.4f}, 95 %)\n")


def test_the_command_calibrate_warns_of_a_bias(readings_file: Path, capsys: Capture) -> None:
    """Ten of 100 readings over white are as over black. The bias is (1 - 0.9) / 2 / (1 + 0.9 - 1) = 0.056."""
    readings_file.write_text(readings_file.read_text() + "300,white\n" * 10)
    assert run_calibrate(readings_file) == 0
    assert "x_hat is off by +0.056 on every floor" in capsys.readouterr().err


def test_the_command_calibrate_reports_a_bias_and_the_warning_of_it_in_json(
    readings_file: Path, capsys: Capture
) -> None:
    """A program that calibrates many sensors would otherwise accept one that is wrong on every floor."""
    readings_file.write_text(readings_file.read_text() + "300,white\n" * 10)
    assert run_calibrate(readings_file, "--json") == 0
    report = json.loads(capsys.readouterr().out)

    assert report["bias"] == pytest.approx(0.056, abs=0.001)
    assert "x_hat is off by +0.056 on every floor" in report["warning"]


def test_the_command_calibrate_reports_how_many_lines_it_leaves_out(
    readings_file: Path, capsys: Capture
) -> None:
    """Ten readings are -1, which stands for a sensor that did not answer. All else is as without them."""
    run_calibrate(readings_file)
    lines_before = capsys.readouterr().out.splitlines()
    readings_file.write_text(readings_file.read_text() + "-1,white\n-1,black\n" * 5)

    assert run_calibrate(readings_file) == 0
    lines = capsys.readouterr().out.splitlines()
    run_calibrate(readings_file, "--json")
    report = json.loads(capsys.readouterr().out)

    assert "left out 10 lines: reading -1 10" in lines
    assert [line for line in lines if not line.startswith("left out")] == lines_before
    assert report["left_out"] == {"reading -1": 10}


def test_an_error_about_too_few_readings_says_how_many_lines_were_left_out(
    readings_file: Path, capsys: Capture
) -> None:
    """All 30 readings are -1, which stands for a sensor that did not answer."""
    readings_file.write_text("-1,black\n" * 30)
    assert run_calibrate(readings_file) == 2
    message = "0 readings over black tiles; take 10 or more, better 1000 (left out 30 lines"
    assert message in capsys.readouterr().err


def test_a_missing_file_of_readings_is_refused(tmp_path: Path, capsys: Capture) -> None:
    """The exit code is 2, and the error names the file."""
    assert run_calibrate(tmp_path / "absent.csv") == 2
    assert "absent.csv: No such file or directory" in capsys.readouterr().err


# --- Encodings and standard input ---------------------------------------------------------------------


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16"])
def test_readings_may_have_the_encodings_of_excel(
    encoding: str, readings_file: Path, capsys: Capture
) -> None:
    """Excel saves text as UTF-8 with a mark at its beginning, or as UTF-16."""
    readings_file.write_text("reading\tcolour\n" + "700\twhite\n300\tblack\n" * 90, encoding=encoding)
    assert run_calibrate(readings_file) == 0
    assert "threshold 500" in capsys.readouterr().out


def test_a_file_of_readings_that_is_no_text_is_refused(readings_file: Path, capsys: Capture) -> None:
    """Its byte 10 is é in Latin-1, which is no character in UTF-8."""
    readings_file.write_bytes(b"512,black\n\xe9")
    assert run_calibrate(readings_file) == 2
    assert "it is no text in UTF-8 (byte 10)" in capsys.readouterr().err


def test_readings_may_come_from_standard_input(monkeypatch: pytest.MonkeyPatch, capsys: Capture) -> None:
    """A dash in place of the file stands for standard input."""
    monkeypatch.setattr("sys.stdin", TextIOWrapper(BytesIO(b"700,white\n300,black\n" * 90)))
    assert run_calibrate(Path("-")) == 0
    assert "threshold 500: below it a tile is black\n" in capsys.readouterr().out


def test_a_wrong_line_of_standard_input_is_named(monkeypatch: pytest.MonkeyPatch, capsys: Capture) -> None:
    """The colour is neither black nor white."""
    monkeypatch.setattr("sys.stdin", TextIOWrapper(BytesIO(b"700,grey\n")))
    assert run_calibrate(Path("-")) == 2
    assert "standard input, line 1: '700,grey' has the colour" in capsys.readouterr().err


def test_a_closed_standard_input_is_refused(monkeypatch: pytest.MonkeyPatch, capsys: Capture) -> None:
    """Python has None for such an input. The exit code is 2, and the error says that it is closed."""
    monkeypatch.setattr("sys.stdin", None)
    assert run_calibrate(Path("-")) == 2
    assert "cannot read standard input: it is closed" in capsys.readouterr().err


def test_standard_input_without_an_end_is_refused(monkeypatch: pytest.MonkeyPatch, capsys: Capture) -> None:
    """The exit code is 2, and the error says that at most 16 MiB are read."""
    endless_input = Mock(buffer=Mock(read=lambda size: b"5" * size))  # every read is filled
    monkeypatch.setattr("sys.stdin", endless_input)
    assert run_calibrate(Path("-")) == 2
    message = "cannot read standard input: it has more than 16777216 bytes; give a shorter one"
    assert message in capsys.readouterr().err
