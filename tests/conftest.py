"""Random tests draw some of their cases in ``make test``, and all of them in ``make verify``."""

from __future__ import annotations

import os

import pytest

from support import DRAWS_ALL


def pytest_configure(config: pytest.Config) -> None:
    """Before ``support`` is imported by the tests."""
    if config.option.markexpr == "slow":
        os.environ[DRAWS_ALL] = "1"


def pytest_itemcollected(item: pytest.Item) -> None:
    if item.get_closest_marker("random") and DRAWS_ALL in os.environ:
        item.add_marker("slow")
