"""Slow tests are run, too: ``make test`` and ``make verify`` share all tests."""

from __future__ import annotations

import shlex
import sys

from support import require, run
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


def test_commands_of_pages_that_other_tests_run_are_not_for_slow_ones_alone() -> None:
    command = [sys.executable, "-m", "pytest", "--collect-only", "-q", "-m", "not slow", *RUN_ELSEWHERE]
    collected = {line.partition("::")[0] for line in run(*command).splitlines() if "::" in line}
    assert collected == set(RUN_ELSEWHERE)
