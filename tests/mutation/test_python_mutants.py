"""Small mistakes in the Python are noticed by the tests of their room (``python -m mutation`` tries any)."""

from __future__ import annotations

import random
from pathlib import Path

import pytest

from mutation.__main__ import chosen, survivors
from mutation.equivalents import equivalents
from mutation.python_mutants import mutants

FIRMWARE = [f"firmware_py/mcp_asdf/{name}.py" for name in ("mirror", "fixed_point")]
TOOLS = "host_tools/mcp_asdf_tools"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("paths", "tests", "sample", "most"),
    [
        (FIRMWARE, ["tests/firmware_py"], 24, 2),
        ([TOOLS], None, 40, 10),
    ],
    ids=["firmware", "tools"],
)
def test_some_mistakes_are_noticed(paths: list[str], tests: list[str] | None, sample: int, most: int) -> None:
    seed = random.randrange(1 << 32)
    print(f"python -m mutation {' '.join(paths)} --sample {sample} --seed {seed}")
    folders = None if tests is None else [Path(each) for each in tests]
    assert len(survivors(chosen(paths, sample, seed), folders)) <= most


@pytest.mark.slow
def test_each_equivalent_mutant_is_a_mutant() -> None:
    names = {each.name for path in (*FIRMWARE, TOOLS) for each in mutants(Path(path))}
    assert set(equivalents("python")) <= names
