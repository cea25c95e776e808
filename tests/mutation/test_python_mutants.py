"""Small mistakes in the Python are noticed by the tests of their room (``python -m mutation`` tries any)."""

from __future__ import annotations

import random
from pathlib import Path

import pytest

from mutation.c_killers import MUTATED
from mutation.mutants import equivalents, mistakes, mutants
from mutation.python_killers import is_noticed
from support import ROOT

FIRMWARE = [
    ROOT / f"firmware_py/mcp_asdf/{name}.py"
    for name in ("mirror", "robust_filter", "arithmetic", "fixed_point")
]
TOOLS = ROOT / "host_tools/mcp_asdf_tools"


def plant_mistakes(files: list[Path], sample: int) -> list[str]:
    """Plant so many random mistakes in the files of a package, and return the names of those unnoticed.

    They are planted one at a time, and the quick tests of the package are run. Fails if a test fails without
    a mistake: then any would be noticed.
    """
    assert not is_noticed(files[0], files[0].read_text(encoding="utf-8"))
    all_mistakes = [mistake for file in files for mistake in mistakes(file)]
    return [
        mutant.name
        for mutant in random.sample(all_mistakes, sample)
        if not is_noticed(mutant.path, mutant.source())
    ]


@pytest.mark.slow
def test_every_small_mistake_in_the_firmware_s_python_is_noticed_by_its_tests() -> None:
    """A mistake is, say, a + that becomes a -. Those that are listed as harmless are not drawn."""
    assert plant_mistakes(FIRMWARE, sample=12) == []


@pytest.mark.slow
def test_most_small_mistakes_in_a_room_of_the_tools_are_noticed_by_its_quick_tests() -> None:
    """A room is a package of the tools or their ``library.py``. Each run of this test draws one of them.

    Of 39 mistakes that were drawn from most rooms, the tests noticed 34. If they noticed only half, this test
    would fail in one of three runs. Harmless changes to the tools are not listed, as they are few.
    """
    rooms = [path for path in TOOLS.iterdir() if path.suffix in ("", ".py") and path.name[0] != "_"]
    room = random.choice(rooms)
    unnoticed = plant_mistakes(sorted(room.rglob("*.py")) if room.is_dir() else [room], sample=8)
    assert len(unnoticed) <= 4, unnoticed


def test_each_change_that_is_listed_as_harmless_is_one_that_is_tried() -> None:
    """An entry of equivalents.toml about code of the past would hide a mistake later."""
    names = {mutant.name for path in (*MUTATED, *FIRMWARE) for mutant in mutants(path)}
    assert set(equivalents()) <= names
