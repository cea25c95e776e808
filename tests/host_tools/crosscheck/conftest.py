"""Fixtures for tests of the cross-check."""

from __future__ import annotations

import pytest

from mcp_asdf_tools.crosscheck.operation_count import Counts, count_operations


@pytest.fixture(scope="session")
def operations() -> Counts:
    """Instructions of each call, counted once."""
    return count_operations()
