"""The options -v and -vv: what this project and python-can log, on standard error."""

from __future__ import annotations

import argparse
import logging
import sys
from collections.abc import Iterator
from contextlib import contextmanager

_LOGGED_PACKAGES = ("mcp_asdf_tools", "can")
"""Packages whose logs help to find the cause of a failure."""


def add_verbosity_option(parser: argparse.ArgumentParser) -> None:
    """Declare ``-v``, whose parsed value is how often it was given."""
    parser.add_argument(
        "-v",
        "--verbose",
        action="count",
        default=0,
        help="log on standard error what is opened, run and written; -vv: details, too, for a bug report",
    )


@contextmanager
def log_to_standard_error(verbosity: int) -> Iterator[None]:
    """Log to standard error inside this context: nothing if ``verbosity`` is 0, at 1 INFO, beyond DEBUG."""
    if verbosity == 0:
        yield
        return
    level = logging.INFO if verbosity == 1 else logging.DEBUG
    handler = _StandardErrorHandler(level)
    handler.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(name)s: %(message)s"))
    loggers = [logging.getLogger(package) for package in _LOGGED_PACKAGES]
    former_levels = [logger.level for logger in loggers]
    for logger in loggers:
        logger.addHandler(handler)
        logger.setLevel(level)
    try:
        yield
    finally:
        for logger, former_level in zip(loggers, former_levels, strict=True):
            logger.removeHandler(handler)
            logger.setLevel(former_level)


class _StandardErrorHandler(logging.Handler):
    """Handler that prints to whatever ``sys.stderr`` is at the time.

    While a progress bar is shown, rich replaces that stream, so that lines do not run into the bar.
    """

    def emit(self, record: logging.LogRecord) -> None:
        """Print one record as a line."""
        try:
            print(self.format(record), file=sys.stderr, flush=True)
        except Exception:
            self.handleError(record)
