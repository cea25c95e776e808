"""Logs of frames: complete ones in any of python-can's formats, and parts that a run left."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import can

from mcp_asdf_tools.common.errors import UsageError

_LATEST = 1e11
"""Seconds; the times of frames are below. No number is no time, either."""

PART = ".part"
"""Suffix, behind all others, of a file that is not complete."""


def add_log_option(output: argparse._ArgumentGroup, beside: str) -> None:
    """Declare ``--log``; ``beside`` names the contents of the files beside the log."""
    text = f"keep all frames as candump does, in a file that ends in .log; {beside}"
    output.add_argument("--log", metavar="FILE", type=Path, help=text)


def check_log(path: Path | str) -> None:
    """Raises UsageError if there is no log that can be read, or an empty one; names its part if its run was
    cut off."""
    try:
        with Path(path).open("rb") as file:
            is_empty = not file.read(1)
    except OSError as error:
        part = Path(f"{path}{PART}")
        hint = f"; its run was cut off, partial data is in {part}" if part.exists() else ""
        raise UsageError(f"cannot read the log {path}: {error.strerror}{hint}") from error
    if is_empty:
        raise UsageError(f"the log {path} is empty: the disk was full, or nothing was sent yet; run it again")


def read_log(path: Path | str) -> Iterator[can.Message]:
    """Yield the frames of a log, in its order. The suffix gives the format.

    Of a part (``NAME.log.part``) it reads the frames that are complete. Raises UsageError, naming the place,
    if the log cannot be read, is malformed or holds no frame.
    """
    check_log(path)  # some readers would create a missing file
    number = 0
    try:
        with _opened(Path(path)) as reader:
            for frame in reader:
                number += 1
                if not abs(frame.timestamp) < _LATEST:
                    raise ValueError(f"its time is {frame.timestamp:g} s")
                yield frame
    except OSError as error:
        raise UsageError(f"cannot read the log {path}: {error.strerror or error}") from error
    except Exception as error:  # readers raise errors of any kind
        raise UsageError(
            f"the log {path} is malformed after frame {number} ({type(error).__name__}: {error}), or its "
            "suffix is wrong: .log (candump), .asc, .blf, .csv, .mf4 or .trc"
        ) from error
    if not number:
        raise UsageError(f"the log {path} holds no frame; does its suffix match its format?")


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    if path.suffix == PART:
        with path.open(encoding="utf-8") as file:
            whole_lines: Any = (line for line in file if line.endswith("\n"))
            yield can.CanutilsLogReader(whole_lines)
    else:
        with can.LogReader(path) as reader:
            yield reader
