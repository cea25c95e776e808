"""Slow tests are run, too: ``make test`` and ``make verify`` share all tests; ``.ci/run`` counts both."""

from __future__ import annotations

import os
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from support import ROOT, require, run
from test_docs import RUN_ELSEWHERE


def pytest_of(target: str) -> list[str]:
    """How a target of the Makefile calls pytest."""
    lines = run(require("make", "make"), "-n", "--no-print-directory", target).splitlines()
    (line,) = (line for line in lines if "pytest" in line)
    return shlex.split(line)


def test_every_test_is_run_by_one_of_the_two() -> None:
    test, verify = pytest_of("test"), pytest_of("verify")
    different = [(one, other) for one, other in zip(test, verify, strict=True) if one != other]
    reports = tuple(f"--junit-xml=build/reports/{name}.xml" for name in ("pytest", "verify"))
    assert different == [("not slow", "slow"), reports]
    assert test[test.index("not slow") - 1] == "-m"


MAKE = """#!/bin/sh
# Stands in for make: leaves the report of a target, and fails where it is asked to.
echo "$1" >>targets
mkdir -p build/reports
echo "<testsuites><testsuite tests='$((5 + ${#1}))' failures='1' errors='2' skipped='1'/></testsuites>" \\
    >"build/reports/$1.xml"
[ "$1" != "$FAILS" ]
"""


@pytest.mark.parametrize("fails", ["", "test", "verify"])
def test_continuous_integration_runs_and_counts_both(fails: str, tmp_path: Path) -> None:
    """And fails if one of them does."""
    for name in (".ci/run", ".ci/count.py"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        shutil.copy(ROOT / name, tmp_path / name)
    for path, text in ((tmp_path / "bin/make", MAKE), (tmp_path / ".venv/bin/python", python())):
        path.parent.mkdir(parents=True)
        path.write_text(text)
        path.chmod(0o755)
    environment = {"PATH": f"{tmp_path / 'bin'}{os.pathsep}{os.environ['PATH']}", "FAILS": fails}
    command = [tmp_path / ".ci/run"]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert (tmp_path / "targets").read_text().split() == ["test", "verify"]
    assert done.stdout.splitlines()[-1] == "12 passed, 6 failed, 2 skipped"
    assert (done.returncode != 0) == bool(fails)


def python() -> str:
    return f'#!/bin/sh\nexec {sys.executable} "$@"\n'


def test_commands_of_pages_that_other_tests_run_are_not_for_slow_ones_alone() -> None:
    command = [sys.executable, "-m", "pytest", "--collect-only", "-q", "-m", "not slow", *RUN_ELSEWHERE]
    collected = {line.partition("::")[0] for line in run(*command).splitlines() if "::" in line}
    assert collected == set(RUN_ELSEWHERE)
