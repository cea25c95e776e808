"""Small mistakes in the Python are noticed by the tests of their room (``python -m mutation`` tries any)."""

from __future__ import annotations

import os
import random
import re
import subprocess
import sys
from pathlib import Path

import pytest

from mutation.equivalents import equivalents
from mutation.python_mutants import mutants
from support import ROOT, run

FIRMWARE = [
    f"firmware_py/mcp_asdf/{name}.py" for name in ("mirror", "robust_filter", "arithmetic", "fixed_point")
]
TOOLS = "host_tools/mcp_asdf_tools"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("paths", "sample", "most"), [(FIRMWARE, 24, 0), ([TOOLS], 40, 7)], ids=["firmware", "tools"]
)
def test_some_mistakes_are_noticed(paths: list[str], sample: int, most: int) -> None:
    """In a program of its own: this one has imported tests, which hold on to the code without mistakes."""
    command = [*paths, "--sample", str(sample), "--seed", str(random.randrange(1 << 32))]
    clean = {name: value for name, value in os.environ.items() if not name.startswith("PYTEST_")}
    done = subprocess.run(
        [sys.executable, "-m", "mutation", *command],
        cwd=ROOT,
        env={**clean, "PYTHONPATH": "tests"},
        capture_output=True,
        text=True,
        check=False,
    )
    print(f"python -m mutation {' '.join(command)}\n{done.stdout}{done.stderr}")
    found = re.search(r"^(\d+) mutants, (\d+) survive$", done.stdout, re.MULTILINE)
    assert found
    assert int(found[1]) > 0.9 * sample
    assert int(found[2]) <= most


@pytest.mark.slow
def test_each_equivalent_mutant_is_a_mutant() -> None:
    names = {each.name for path in (*FIRMWARE, TOOLS) for each in mutants(Path(path))}
    assert set(equivalents("python")) <= names


# Each mutant with its tests, in a program of its own as above.
PROGRAM = """
from pathlib import Path
from mutation.__main__ import survivors
from mutation.python_mutants import mutants
path, tests = Path("firmware_py/mcp_asdf/fixed_point.py"), Path("tests/firmware_py/test_errors.py")
function = "alpha_word_from_float: "
changes = [
    "[limited_alpha = min(alpha, 2.0 ** 31) => limited_alpha = min(alpha, 2.0 ** 32)]",
    "[limited_alpha = min(alpha, 2.0 ** 31) => limited_alpha = max(alpha, 2.0 ** 31)]",
]
mutants_by_name = {mutant.name: mutant for mutant in mutants(path)}
survivors([mutants_by_name[function + change] for change in changes], [tests])
"""


@pytest.mark.slow
def test_a_harmless_change_survives_and_a_mistake_does_not() -> None:
    """From the largest confidence on, any has the same word."""
    output = run(sys.executable, "-c", PROGRAM, PYTHONPATH="tests")
    (line,) = output.splitlines()
    assert line.endswith("[limited_alpha = min(alpha, 2.0 ** 31) => limited_alpha = min(alpha, 2.0 ** 32)]")
    assert line.startswith("survives: firmware_py/mcp_asdf/fixed_point.py#")
