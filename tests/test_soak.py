"""A soak of seconds, and for ``make verify`` of a minute, in which processes are killed, too."""

from __future__ import annotations

import pytest
from rich.console import Console

from mcp_asdf_tools.swarm.fault_spec import FaultKind
from soak import Survived, soak
from support import slow


@pytest.mark.parametrize(("seconds", "kills"), [(2, False), *slow([(60, True)])])
def test_everything_is_survived(seconds: float, kills: bool) -> None:
    survived = soak(seconds, seed=1, kills=kills)
    assert survived.wrong == []
    assert survived.counts["swarms"] > 0
    assert survived.counts["broadcasts replayed"] > 0
    assert survived.counts["estimates heard"] > 0
    assert bool(survived.counts["processes killed"]) == kills
    console = Console(width=200)
    with console.capture() as told:
        console.print(survived.table())
    lines = told.get().splitlines()
    assert [line.split()[-1] for line in lines if "not survived" in line] == ["nothing"]
    assert sum(line.startswith(" fault ") for line in lines) == len(FaultKind)


def test_memory_or_files_that_grow_are_told() -> None:
    survived = Survived(memory=[80.0] * 8, files=[6] * 8)
    survived.check_growth()
    assert survived.wrong == []
    survived.memory[6:] = [87.0, 88.0]
    survived.files[6:] = [7, 7]
    survived.check_growth()
    assert survived.wrong == ["memory grew from 80.0 to 87.5 MB", "open files grew from 6 to 7"]
