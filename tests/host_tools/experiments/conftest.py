"""Results that the tests of several kinds of pictures draw."""

from __future__ import annotations

from dataclasses import replace

import pytest

from host_tools.experiments.drawn_figures import SHORT_EXPERIMENT, results_of
from mcp_asdf_tools.experiments.results import Trials
from mcp_asdf_tools.robots.filters import FILTERS


@pytest.fixture(scope="session")
def results_by_filter() -> dict[str, Trials]:
    """Run one trial with each filter, the last filter first."""
    return {
        name: results_of(replace(SHORT_EXPERIMENT, flawed=2, trials=1, filter=name))
        for name in reversed(FILTERS)
    }
