"""Continuous integration counts what ran: a missing gate must not look like a gate that holds."""

from __future__ import annotations

import io
import json
import runpy
import shutil
from contextlib import redirect_stdout
from dataclasses import dataclass
from pathlib import Path

import pytest

from support import ROOT, matching_files

FAILURE = '<failure message="assert 1 == 2"/>'
ERROR = '<error message="failed on setup"/>'
SKIPPED_FOR_A_TOOL = '<skipped message="frama-c is not installed: make setup"/>'
SKIPPED_FOR_THE_MACHINE = '<skipped message="this processor has no vectors of x86-64-v4"/>'


@dataclass(frozen=True)
class Count:
    """What the program of continuous integration ended with: its exit code and the lines that it printed."""

    status: int
    lines: list[str]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with the program and its list, by which tests/bus has 100 tests and tests/proofs has 50."""
    shutil.copy(ROOT / ".ci/count.py", tmp_path)
    (tmp_path / "test_counts.json").write_text('{"tests/bus": 100, "tests/proofs": 50}')
    (tmp_path / "reports").mkdir()
    return tmp_path


def write_report(folder: Path, module: str, count: int, special_outcome: str = "") -> None:
    """Write a report of passed tests. An element of JUnit is the first test's ``special_outcome``."""
    outcomes = [special_outcome] + [""] * (count - 1)
    cases = [
        f'<testcase classname="{module}" name="test_{index}">{outcome}</testcase>'
        for index, outcome in enumerate(outcomes)
    ]
    path = folder / f"reports/{module}.xml"
    path.write_text(f"<testsuites><testsuite>{''.join(cases)}</testsuite></testsuites>")


def count(folder: Path, *options: str) -> Count:
    """Run the program on the folder's reports."""
    main = runpy.run_path(str(folder / "count.py"))["main"]
    with redirect_stdout(io.StringIO()) as output:
        status = main([*options, str(folder / "reports")])
    return Count(status, output.getvalue().splitlines())


def test_reports_of_all_listed_tests_pass(folder: Path) -> None:
    """The fixture's list expects 100 tests of tests/bus and 50 of tests/proofs."""
    write_report(folder, "tests.bus.test_dbc", 100)
    write_report(folder, "tests.proofs.test_sums", 50)

    result = count(folder, "--strict")

    assert result == Count(status=0, lines=["150 passed, 0 failed, 0 skipped"])


@pytest.mark.parametrize("special_outcome", [FAILURE, ERROR])
def test_a_failure_and_an_error_of_a_fixture_count_as_failed(folder: Path, special_outcome: str) -> None:
    """The program ends with the code 1. pytest reports an error where what a test needs could not be made.

    The fixture's list expects 100 tests of tests/bus and 50 of tests/proofs. One test more fails.
    """
    write_report(folder, "tests.bus.test_dbc", 100 + 1, special_outcome)
    write_report(folder, "tests.proofs.test_sums", 50)

    result = count(folder, "--strict")

    assert result == Count(status=1, lines=["strict: 1 failed", "150 passed, 1 failed, 0 skipped"])


def test_a_skip_for_a_tool_that_is_not_installed_fails(folder: Path) -> None:
    """The set-up of continuous integration has to be complete. The program prints the reason of the skip."""
    write_report(folder, "tests.bus.test_dbc", 100)
    write_report(folder, "tests.proofs.test_sums", 50, SKIPPED_FOR_A_TOOL)

    result = count(folder, "--strict")

    assert result.status == 1
    assert result.lines == [
        "skipped: frama-c is not installed: make setup",
        "strict: 1 were skipped that a complete set-up runs",
        "149 passed, 0 failed, 1 skipped",
    ]


def test_a_skip_for_the_machine_is_no_failure(folder: Path) -> None:
    """One of 50 tests needs a processor that this machine does not have; that is no fault of the set-up."""
    write_report(folder, "tests.bus.test_dbc", 100)
    write_report(folder, "tests.proofs.test_sums", 50, SKIPPED_FOR_THE_MACHINE)

    result = count(folder, "--strict")

    assert result.status == 0


LOSS_IN_BUS = (
    "strict: tests/bus: 97 tests of 100; if they were removed on purpose, "
    "run .venv/bin/python .ci/count.py --renew"
)


@pytest.mark.parametrize(("passed", "complaints"), [(98, []), (97, [LOSS_IN_BUS])])
def test_a_loss_of_more_than_two_percent_of_a_folder_s_tests_fails_and_is_named(
    folder: Path, passed: int, complaints: list[str]
) -> None:
    """The list expects 100 tests of tests/bus and 50 of tests/proofs.

    Ten tests more of tests/proofs do not make up for a loss in tests/bus.
    """
    write_report(folder, "tests.bus.test_dbc", passed)
    write_report(folder, "tests.proofs.test_sums", 50 + 10)

    result = count(folder, "--strict")

    assert result.status == len(complaints)
    assert result.lines[:-1] == complaints


def test_a_test_that_is_in_two_reports_is_counted_once(folder: Path) -> None:
    """``make verify`` runs random tests of ``make test`` again, so they are in the reports of both.

    Here 25 tests of tests/proofs are in two reports. They are not taken for the 50 that the fixture's list
    expects.
    """
    write_report(folder, "tests.bus.test_dbc", 100)
    write_report(folder, "tests.proofs.test_sums", 25)
    reports = folder / "reports"
    shutil.copy(reports / "tests.proofs.test_sums.xml", reports / "verify.xml")

    first_line, *_ = count(folder, "--strict").lines

    assert first_line.startswith("strict: tests/proofs: 25 tests of 50")


def test_a_list_with_20_tests_fewer_than_170_has_to_be_renewed(folder: Path) -> None:
    """A tenth of the tests that ran may be missing from the list: 17 of 170, and 20 are more than that.

    The fixture's list has 150. With an older list many tests could vanish again unnoticed.
    """
    write_report(folder, "tests.bus.test_dbc", 100 + 20)
    write_report(folder, "tests.proofs.test_sums", 50)

    first_line, *_ = count(folder, "--strict").lines

    assert first_line == "strict: 170 tests, 150 listed; run .venv/bin/python .ci/count.py --renew"


def test_the_list_names_every_folder_that_has_tests() -> None:
    """Otherwise all tests of a folder could vanish unnoticed."""
    listed_counts = json.loads((ROOT / ".ci/test_counts.json").read_text(encoding="utf-8"))
    test_files = matching_files(ROOT / "tests", "**/test_*.py")
    folders = {str(path.parent.relative_to(ROOT)) for path in test_files}
    assert set(listed_counts) == folders, "run .venv/bin/python .ci/count.py --renew"


def test_continuous_integration_counts_strictly() -> None:
    """Without the option the program would end with success, with any number of skipped tests."""
    assert "count.py --strict build/reports" in (ROOT / ".ci/run").read_text(encoding="utf-8")
