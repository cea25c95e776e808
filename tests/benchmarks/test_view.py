"""The page stays smooth with a long film."""

from __future__ import annotations

import pytest

from benchmarks.view import measure


@pytest.mark.slow
def test_a_long_film_stays_smooth_and_small() -> None:
    """A picture has 16.7 ms; the limits leave room for a machine that is busy with other tests."""
    found = measure()
    assert found.scripts[0] < 10, found
    assert found.frames[0] < 50, found
    assert found.charts < 1500, found
    assert found.megabytes < 3, found
