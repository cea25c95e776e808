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
    ("paths", "sample", "most_survivors"), [(FIRMWARE, 24, 0), ([TOOLS], 40, 16)], ids=["firmware", "tools"]
)
def test_small_mistakes_in_the_python_are_noticed_by_its_tests(
    paths: list[str], sample: int, most_survivors: int
) -> None:
    """So many are drawn, and the command that repeats them is printed. Mistakes that no test notices survive.

    Only quick tests are run. Slow ones have the wrong controllers and most planted faults, so that a quarter
    of the mistakes in the tools survive here. More than 16 of 40 would be one run in a hundred.
    They are tried by a program of its own: this one has imported the tests with code without mistakes.
    """
    seed = random.randrange(1 << 32)
    options = [*paths, "--sample", str(sample), "--seed", str(seed)]
    environment = {name: value for name, value in os.environ.items() if not name.startswith("PYTEST_")}

    done = subprocess.run(
        [sys.executable, "-m", "mutation", *options],
        cwd=ROOT,
        env={**environment, "PYTHONPATH": "tests"},
        capture_output=True,
        text=True,
        check=False,
    )

    print(f"python -m mutation {' '.join(options)}\n{done.stdout}{done.stderr}")
    last_line = re.search(r"^(\d+) mutants, (\d+) survive$", done.stdout, re.MULTILINE)
    assert last_line is not None
    mutants_tried, survivors = map(int, last_line.groups())
    assert mutants_tried > 0.9 * sample
    assert survivors <= most_survivors


@pytest.mark.slow
def test_each_change_that_is_listed_as_harmless_is_one_that_is_tried() -> None:
    """A list that is about code of the past would hide mistakes of the future."""
    names = {mutant.name for path in (*FIRMWARE, TOOLS) for mutant in mutants(Path(path))}
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
    """If all survived, or none, the harness above would not try anything.

    The change is to the largest confidence, from which on any has the same word.
    """
    output = run(sys.executable, "-c", PROGRAM, PYTHONPATH="tests")

    [survivor] = output.splitlines()
    assert survivor.startswith("survives: firmware_py/mcp_asdf/fixed_point.py#")
    assert survivor.endswith(
        "[limited_alpha = min(alpha, 2.0 ** 31) => limited_alpha = min(alpha, 2.0 ** 32)]"
    )
