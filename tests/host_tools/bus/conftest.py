"""Tests of buses close many connections to serial adapters."""

from __future__ import annotations

from collections.abc import Iterator
from types import SimpleNamespace

import pytest
from serial.urlhandler import protocol_socket  # type: ignore[import-untyped]


@pytest.fixture(scope="package", autouse=True)
def ports_close_without_a_pause() -> Iterator[None]:
    """Leave out the 0.3 s that pyserial sleeps after it has closed a port at socket://HOST:PORT."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(protocol_socket, "time", SimpleNamespace(sleep=lambda seconds: None))
        yield
