"""The tests of this folder in a guest, where this machine's kernel has no CAN."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import sys
from contextlib import suppress
from pathlib import Path

import pytest

from socketcan.guest import run_in_guest, why_not_native
from support import ROOT
from targets.c_node import CORTEX_A8, NODES, PLAIN_BUILD

SECONDS = 1100.0
"""Time limit for a guest's whole life, in which it starts and runs one test after the other."""

WORK = ROOT / "build/socketcan"


def script() -> str:
    """Return the script of the guest, which leaves the exit code of the tests in a file."""
    settings = {
        "PATH": os.environ["PATH"],
        "HOME": "/tmp",
        "PYTHONDONTWRITEBYTECODE": "1",
        "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1",
        NODES: WORK,
    }
    tests = [path for path in sorted(Path(__file__).parent.glob("test_*.py")) if path != Path(__file__)]
    pytest_words = (sys.executable, "-m", "pytest", "-p", "no:cacheprovider", "-v", "-rs", "--tb=short")
    lines = [
        shlex.join(("cd", str(ROOT))),
        shlex.join(("export", *(f"{name}={value}" for name, value in settings.items()))),
        shlex.join(map(str, (*pytest_words, *tests))),
        f"echo $? >{shlex.quote(str(WORK))}/shared/status",
    ]
    return "\n".join([*lines, ""])


@pytest.mark.slow
def test_the_tests_of_this_folder_pass_in_a_guest() -> None:
    """A guest is an emulated machine whose kernel has CAN. It shares a folder, into which it writes its log.

    Nodes are built here, which is much faster than there; the log of the tests is what this one prints.
    """
    if not why_not_native():
        pytest.skip("this machine's kernel has CAN, and the tests run on it")
    for kind in (PLAIN_BUILD, CORTEX_A8):
        with suppress(pytest.skip.Exception):  # the guest's test skips, too, and says why
            kind.build(WORK / kind.name)
    shared = WORK / "shared"
    shutil.rmtree(shared, ignore_errors=True)
    shared.mkdir(parents=True)

    run_in_guest(script(), shared, SECONDS)

    log = read_if_there(shared / "log")
    print(read_if_there(shared / "console"), log)
    status = read_if_there(shared / "status")
    assert status != "", f"the guest did not start, or broke off within {SECONDS:g} s"
    assert status == "0\n"
    assert count_in_summary(log, "passed") > 0  # the status is 0 even if all have been skipped
    skipped_count = count_in_summary(log, "skipped")
    if skipped_count > 0:
        pytest.skip(f"{skipped_count} tests were skipped in the guest, whose log says why")


def read_if_there(path: Path) -> str:
    return path.read_text(errors="replace") if path.exists() else ""


def count_in_summary(log: str, outcome: str) -> int:
    """Return the number of tests with an outcome, such as "passed", in the last line of pytest's log."""
    *_, summary = log.splitlines()
    count = re.search(rf"(\d+) {outcome}", summary)
    return 0 if count is None else int(count[1])


@pytest.mark.parametrize(
    ("summary", "expected_passed", "expected_skipped"),
    [
        ("==== 9 passed in 81.20s ====", 9, 0),
        ("==== 9 skipped in 1.02s ====", 0, 9),
        ("==== 7 passed, 2 skipped in 81.20s ====", 7, 2),
    ],
)
def test_the_last_line_of_a_log_says_how_many_tests_passed_and_were_skipped(
    summary: str, expected_passed: int, expected_skipped: int
) -> None:
    """These numbers decide whether the tests of a guest count as passed, as failed, or as skipped in part."""
    log = f"tests/socketcan/test_socketcan.py::test_a PASSED\n{summary}\n"
    assert count_in_summary(log, "passed") == expected_passed
    assert count_in_summary(log, "skipped") == expected_skipped
