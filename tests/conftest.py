"""Random tests draw some of their cases in ``make test``, and all in ``make verify``; no test may hang."""

from __future__ import annotations

import os

import pytest

from support import DRAWS_ALL

SLOW_TIMEOUT = 1200
"""Seconds that a slow test may take; others have the timeout in ``pyproject.toml``."""


def pytest_configure(config: pytest.Config) -> None:
    """Before ``support`` is imported by the tests."""
    if config.option.markexpr == "slow":
        os.environ[DRAWS_ALL] = "1"


def pytest_itemcollected(item: pytest.Item) -> None:
    if item.get_closest_marker("random") and DRAWS_ALL in os.environ:
        item.add_marker("slow")
    if item.get_closest_marker("slow"):
        item.add_marker(pytest.mark.timeout(SLOW_TIMEOUT))
