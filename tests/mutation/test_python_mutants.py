"""Small mistakes in the Python are noticed by the tests of their room (``python -m mutation`` tries any)."""

from __future__ import annotations

import os
import random
import re
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import pytest

from mutation.equivalents import equivalents
from mutation.python_mutants import mutants
from support import ROOT, run

FIRMWARE = [
    f"firmware_py/mcp_asdf/{name}.py" for name in ("mirror", "robust_filter", "arithmetic", "fixed_point")
]
TOOLS = "host_tools/mcp_asdf_tools"


@dataclass(frozen=True)
class Trial:
    """The number of mistakes that were planted, one at a time, and of those that no test noticed."""

    planted: int
    unnoticed: int


def plant_mistakes(paths: list[str], sample: int) -> Trial:
    """Plant so many random mistakes in files, and run the quick tests of each file's package.

    ``python -m mutation`` does it, in a process of its own: this one has imported the code without mistakes.
    The command that repeats the same mistakes is printed, with those that no test noticed.
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
    [(planted, unnoticed)] = re.findall(r"^(\d+) mutants, (\d+) survive$", done.stdout, re.MULTILINE)
    return Trial(int(planted), int(unnoticed))


@pytest.mark.slow
def test_every_small_mistake_in_the_firmware_s_python_is_noticed_by_its_tests() -> None:
    """A mistake is, say, a + that becomes a -. Of 24 that are drawn, those listed as harmless are not tried.

    One in 50 is listed, so more than 18 are left.
    """
    trial = plant_mistakes(FIRMWARE, sample=24)
    assert trial.planted > 18
    assert trial.unnoticed == 0


@pytest.mark.slow
def test_most_small_mistakes_in_a_room_of_the_tools_are_noticed_by_its_quick_tests() -> None:
    """A room is a package of the tools or their ``library.py``. Each run of this test draws one of them.

    Of 90 mistakes that were drawn from all rooms, the tests noticed 78. If they noticed only three of four,
    this test would fail once in 50 runs. Harmless changes to the tools are not listed, as they are few.
    """
    names = [path.name for path in (ROOT / TOOLS).iterdir() if path.suffix in ("", ".py")]
    rooms = [name for name in names if not name.startswith("_")]
    trial = plant_mistakes([f"{TOOLS}/{random.choice(rooms)}"], sample=30)
    assert trial.planted == 30
    assert trial.unnoticed <= 12


def test_each_change_that_is_listed_as_harmless_is_one_that_is_tried() -> None:
    """An entry of equivalents.toml about code of the past would hide a mistake later."""
    names_of_mutants = {mutant.name for path in FIRMWARE for mutant in mutants(Path(path))}
    assert set(equivalents("python")) <= names_of_mutants


# A larger limit is harmless: all confidences from 2**31 on have the same word. A lower limit is a mistake.
HARMLESS_CHANGE = "[limited_alpha = min(alpha, 2.0 ** 31) => limited_alpha = min(alpha, 2.0 ** 32)]"
MISTAKE = "[limited_alpha = min(alpha, 2.0 ** 31) => limited_alpha = max(alpha, 2.0 ** 31)]"

# Tries both in a process of its own: this one has imported the code without mistakes.
PROGRAM = f"""
from pathlib import Path
from mutation.__main__ import print_survivors
from mutation.python_mutants import mutants
path, tests = Path("firmware_py/mcp_asdf/fixed_point.py"), Path("tests/firmware_py/test_errors.py")
mutants_by_name = {{mutant.name: mutant for mutant in mutants(path)}}
names = ["alpha_word_from_float: {HARMLESS_CHANGE}", "alpha_word_from_float: {MISTAKE}"]
print_survivors([mutants_by_name[name] for name in names], [tests])
"""


@pytest.mark.slow
def test_a_harmless_change_passes_the_tests_and_a_mistake_fails_one() -> None:
    """PROGRAM tries both, and prints which change passes: one line, with the harmless one.

    That is a larger limit for confidences, all of which have the same word from 2^31 on. The mistake takes
    the larger of two numbers for the smaller. If both passed, or none, the tests would not have been run.
    """
    output = run(sys.executable, "-c", PROGRAM, PYTHONPATH="tests")

    [line] = output.splitlines()
    assert line.startswith("survives: firmware_py/mcp_asdf/fixed_point.py#")
    assert line.endswith("[limited_alpha = min(alpha, 2.0 ** 31) => limited_alpha = min(alpha, 2.0 ** 32)]")
