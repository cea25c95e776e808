"""Fixtures for tests of the cross-check."""

from __future__ import annotations

import pytest

from mcp_asdf_tools.crosscheck.operation_count import CallCount, count_operations


@pytest.fixture(scope="session")
def operations() -> dict[str, CallCount]:
    """Operations of each call, counted once."""
    return count_operations()
