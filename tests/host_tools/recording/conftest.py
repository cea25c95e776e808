"""The log of a swarm that several tests read."""

from __future__ import annotations

import shlex
from pathlib import Path

import pytest

from mcp_asdf_tools.cli.main import main

FOUR_ROBOTS_IN_40_STEPS = "--robots 4 --steps 40 --filter-period 10 --flawed 0.5 --seed 3 --quiet"


@pytest.fixture(scope="session")
def swarm_log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The log of a swarm with 4 * 40 estimates and 16 heartbeats, with events beside it; only to be read."""
    log = tmp_path_factory.mktemp("swarm") / "run.log"
    assert main(["swarm", *shlex.split(FOUR_ROBOTS_IN_40_STEPS), "--log", str(log)]) == 0
    return log
