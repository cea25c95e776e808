"""``mcp-asdf calibrate``: a ground sensor's threshold and accuracy."""

from __future__ import annotations

import argparse
import sys
from dataclasses import asdict
from pathlib import Path

from mcp_asdf_tools.cli.again import json_report
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.robots.calibration import calibrate, read_readings

EPILOG = """\
examples:
  mcp-asdf calibrate readings.csv                 # lines such as 512,black: a reading and its tile's colour
  mcp-asdf calibrate readings.csv --json
exit code: 0 done, 2 bad usage"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("file", metavar="FILE", type=Path, help="readings over known tiles: reading,colour")


def run(args: argparse.Namespace) -> int:
    """Calibrate and print."""
    try:
        text = args.file.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise UsageError(f"cannot read {args.file}: {error}; give lines of text such as 512,black") from error
    found = calibrate(read_readings(text, str(args.file)))
    if args.json:
        worth = {name: getattr(found, name) for name in ("b_hat", "uncertainty", "bias", "warning")}
        print(json_report(asdict(found) | worth))
        return 0
    print(f"threshold {found.threshold:.10g}: {found.black_is} it a tile is black")
    for colour, accuracy in found.accuracy.items():
        print(f"accuracy on {colour} {accuracy:.4f} ({found.readings[colour]} readings)")
    print(f"start with --b-hat {found.b_hat:.4f} (+- {found.uncertainty:.4f}, 95 %)")
    if found.warning is not None:
        print(f"mcp-asdf calibrate: {found.warning}", file=sys.stderr)
    return 0
