"""Buses of tests: none is configured by the user, and none is left open."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import can
import pytest
from can.interfaces import virtual


@pytest.fixture
def no_bus_is_left() -> Iterator[None]:
    """Fail if a test leaves a bus open."""
    yield
    assert not virtual.channels


@pytest.fixture
def private_setup(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, no_bus_is_left: None) -> None:
    """Keep the user's bus configuration out, and fail if a test leaves a bus open."""
    for name in [name for name in os.environ if name.startswith("CAN_")]:
        monkeypatch.delenv(name)
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setattr(can, "rc", {})
