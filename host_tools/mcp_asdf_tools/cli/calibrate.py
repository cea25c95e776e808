"""``mcp-asdf calibrate``: a ground sensor's threshold and accuracy."""

from __future__ import annotations

import argparse
from dataclasses import asdict

from mcp_asdf_tools.cli.output import json_report, warn
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.common.files import LONGEST_TEXT, read_text
from mcp_asdf_tools.robots.calibration import Calibration, calibrate
from mcp_asdf_tools.robots.readings import Readings, parse_readings

EPILOG = f"""\
examples:
  mcp-asdf calibrate readings.csv                 # lines such as 512,black: a reading and its tile's colour
      threshold 377: below it a tile is black
      accuracy on black 1.0000 (20 readings)
      accuracy on white 1.0000 (20 readings)
      start with --b-hat 0.9545 (+- 0.0693, 95 %)
  mcp-asdf calibrate -                            # from standard input
Separate columns with commas, semicolons, tabs or spaces. A header may name the columns reading and colour;
other columns are ignored. Readings of -1, words instead of numbers and comments are left out and counted.
The input may have up to {LONGEST_TEXT >> 20} MiB.
exit code: 0 done, 2 bad usage"""
LIBRARIES = ()


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare FILE, which has the readings; ``-`` stands for standard input."""
    parser.add_argument(
        "file",
        metavar="FILE",
        help="readings over tiles of known colour, one a line: reading,colour (-: standard input)",
    )


def run(args: argparse.Namespace) -> int:
    """Calibrate the sensor by its readings, and print its threshold and accuracies; return exit code 0.

    Also printed are how many lines were left out, and the accuracy that the robot should assume; a warning
    about the sensor goes to standard error. With --json all of it is printed as one object. Raises UsageError
    if the file cannot be read, or has readings of another form, too few of them, or ones that do not
    distinguish the colours.
    """
    source_name = "standard input" if args.file == "-" else args.file
    readings = parse_readings(read_text(args.file), source_name)
    left_out = _describe_left_out_lines(readings)
    try:
        calibration = calibrate(readings.rows)
    except UsageError as error:
        # Lines that were left out may be the reason for too few readings.
        remark = f" ({left_out})" if left_out else ""
        raise UsageError(f"{error}{remark}") from error
    if args.json:
        # These are properties, which asdict() leaves out.
        derived_values = {
            name: getattr(calibration, name) for name in ("b_hat", "uncertainty", "bias", "warning")
        }
        print(json_report(asdict(calibration) | derived_values | {"left_out": readings.left_out}))
    else:
        _print_calibration(calibration, left_out)
    return 0


def _print_calibration(calibration: Calibration, left_out: str) -> None:
    """Print what a calibration has found, and ``left_out``, which lines it did without, unless it is empty.

    A warning about the sensor goes to standard error.
    """
    print(f"threshold {calibration.threshold:.10g}: {calibration.black_is} it a tile is black")
    for colour, accuracy in calibration.accuracy.items():
        print(f"accuracy on {colour} {accuracy:.4f} ({calibration.readings[colour]} readings)")
    if left_out:
        print(left_out)
    print(f"start with --b-hat {calibration.b_hat:.4f} (+- {calibration.uncertainty:.4f}, 95 %)")
    if calibration.warning is not None:
        warn("calibrate", calibration.warning)


def _describe_left_out_lines(readings: Readings) -> str:
    """Return how many lines were left out and why, or an empty text if none was."""
    if not readings.left_out:
        return ""
    reasons = ", ".join(f"{reason} {count}" for reason, count in readings.left_out.items())
    return f"left out {readings.left_out.total()} lines: {reasons}"
