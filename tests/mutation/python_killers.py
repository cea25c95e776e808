"""Find out whether tests notice a mutant of the Python: run the tests of its package in a child process."""

from __future__ import annotations

import builtins
import importlib
import json
import os
import re
import signal
import sys
import time
from ast import Module
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from importlib.machinery import SourceFileLoader
from multiprocessing import get_context
from pathlib import Path
from tempfile import TemporaryDirectory
from types import CodeType
from unittest.mock import patch

import pytest

from mutation.python_mutants import Mutant, insert_before_statements
from support import DRAWS_ALL, ROOT

TIMEOUT_SECONDS, TIMEOUT_FACTOR = 10, 4
"""A test may take so many seconds, and so many times the time that it takes without a mistake. Then a mutant
hangs, and has been noticed."""
PYTEST_OPTIONS = ("-q", "-p", "no:xdist", "-p", "no:cacheprovider", "-p", "no:anyio")
SLOW_LIBRARIES = ("numpy", "scipy.stats", "pyarrow.parquet", "matplotlib.figure", "can", "cffi")
"""Libraries that most tests need: imported once, before child processes are forked."""
PROBE = "_mcp_asdf_probe"
"""Name of a built-in function that exists while tests are recorded: it is called before each statement that a
mutant changes."""
_FORK = get_context("fork")


def folders_with_tests_of(path: Path) -> list[Path]:
    """Return the folders with the tests of a file's package.

    The packages cli and common have all folders, as everything uses them. The firmware has its own tests and
    those of the cross-check.
    """
    if path.parts[0] == "firmware_py":
        return [Path("tests/firmware_py"), Path("tests/host_tools/crosscheck")]
    test_files = [file.relative_to(ROOT) for file in (ROOT / "tests/host_tools").glob("**/test_*.py")]
    # A test file that is in no folder of a package stands for itself.
    all_folders = {file.parent if len(file.parts) > 3 else file for file in test_files}
    package = path.parts[2]
    package_folder = Path("tests/host_tools", package)
    if package_folder in all_folders and package not in ("cli", "common"):
        return [package_folder]
    return sorted(all_folders)


# --- Which tests run which statements --------------------------------------------------------------------


@dataclass
class Baseline:
    """What the tests do while there is no mistake in the code.

    Attributes:
        marks: Which tests were run: an expression of pytest's marks, such as "not slow".
        seconds: Time that each test took, by its id.
        tests_of_statement: Ids of the tests that run a statement, by the key of the statement.
        failed: Ids of tests that fail without a mistake; they can notice nothing.
    """

    marks: str
    seconds: dict[str, float] = field(default_factory=dict)
    tests_of_statement: dict[str, list[str]] = field(default_factory=dict)
    failed: list[str] = field(default_factory=list)

    def tests_that_run(self, mutant: Mutant, folders: Iterable[Path]) -> list[str]:
        """Return the ids of the tests in these folders that run the mutant's statement, fast ones first."""
        folder_names = tuple(str(folder) for folder in folders)
        test_ids = self.tests_of_statement.get(_statement_key(mutant), [])
        return sorted(
            (test_id for test_id in test_ids if test_id.startswith(folder_names)),
            key=self.seconds.__getitem__,
        )

    def add(self, other: Baseline) -> None:
        """Add the record of other tests, which were run with the same marks."""
        self.seconds |= other.seconds
        self.failed += other.failed
        for statement, test_ids in other.tests_of_statement.items():
            self.tests_of_statement.setdefault(statement, []).extend(test_ids)


def run_baseline(mutants: Iterable[Mutant], folders: Iterable[Path], marks: str = "not slow") -> Baseline:
    """Run the tests of these folders once, and record which of them run the statements of these mutants.

    Before each statement a call of the probe is inserted, which takes half the time that tracing all lines
    would take. Folders are run one by one, each in a process of its own: what the tests of one folder leave
    in a cache, those of another must compute again, or their statements would not run.

    Raises RuntimeError if the process of a folder dies.
    """
    for library in SLOW_LIBRARIES:
        importlib.import_module(library)
    probes_by_file = _probes_of(mutants)
    baseline = Baseline(marks)
    with TemporaryDirectory() as temporary_folder:
        record_file = Path(temporary_folder) / "record.json"
        for folder in sorted(set(folders)):
            if not _succeeds_in_child(partial(_record_folder, record_file, probes_by_file, folder, marks)):
                raise RuntimeError(f"{folder}: its tests ended without a record")
            record = json.loads(record_file.read_text(encoding="utf-8"))
            baseline.add(Baseline(**record))
    return baseline


def _probes_of(mutants: Iterable[Mutant]) -> dict[Path, dict[int, str]]:
    """Return the calls of the probe that are inserted before the statements that mutants change.

    The keys are the file and the index of the statement.
    """
    probes_by_file: dict[Path, dict[int, str]] = {}
    for mutant in mutants:
        probes = probes_by_file.setdefault(mutant.path, {})
        probes[mutant.statement_index] = f"{PROBE}({_statement_key(mutant)!r})"
    return probes_by_file


def _statement_key(mutant: Mutant) -> str:
    return f"{mutant.path}#{mutant.statement_index}"


def _record_folder(
    record_file: Path, probes_by_file: dict[Path, dict[int, str]], folder: Path, marks: str
) -> bool:
    """Run the tests of a folder with the probes in the code, and write the record to a file as JSON."""
    recorder = _Recorder(marks)
    setattr(builtins, PROBE, recorder.statements_of_test.add)
    _replace_modules(
        {path: insert_before_statements(path, probes) for path, probes in probes_by_file.items()}
    )
    pytest.main([*PYTEST_OPTIONS, "-m", marks, str(folder)], plugins=[recorder])
    record_file.write_text(json.dumps(vars(recorder.baseline)), encoding="utf-8")
    return True


class _Recorder:
    """Plugin of pytest that records which statements a test runs, in its fixtures and other threads, too."""

    def __init__(self, marks: str) -> None:
        self.statements_of_test: set[str] = set()
        self.baseline = Baseline(marks)

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Iterator[None]:
        """Run a test, and record its time and the statements of which the probe was called."""
        start_time = time.monotonic()
        self.statements_of_test.clear()
        try:
            return (yield)
        finally:
            # A copy, since a thread of the test may still add statements.
            for statement in list(self.statements_of_test):
                self.baseline.tests_of_statement.setdefault(statement, []).append(item.nodeid)
            self.baseline.seconds[item.nodeid] = time.monotonic() - start_time

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Record a test that fails."""
        if report.failed:
            self.baseline.failed.append(report.nodeid)


# --- Whether tests notice a mutant -----------------------------------------------------------------------


def is_noticed(mutant: Mutant, baseline: Baseline, folders: Iterable[Path]) -> bool:
    """Return whether a test in these folders fails with the mutant, or hangs.

    Of each file with a test that runs the mutant's statement all tests are run, since a cache or a fixture
    may bring the statement's result to the others.
    """
    test_ids = baseline.tests_that_run(mutant, folders)
    files = list(dict.fromkeys(_file_of(test_id) for test_id in test_ids))  # each once, the fastest first
    # Most mutants fail a test of the two fastest files; to import all other files takes seconds.
    for some_files in (files[:2], files):
        if not some_files:
            return False
        usual_seconds = sum(
            seconds for test_id, seconds in baseline.seconds.items() if _file_of(test_id) in some_files
        )
        tests_pass = partial(_tests_pass, mutant, some_files, test_ids, baseline)
        # Each test has a timeout of its own; this one is for a mutant that hangs while files are imported.
        if not _succeeds_in_child(tests_pass, 3 * TIMEOUT_SECONDS + TIMEOUT_FACTOR * usual_seconds):
            return True
    return False


def _file_of(test_id: str) -> str:
    """Return the file of a test; an id is such as ``tests/test_a.py::test_b``."""
    return test_id.partition("::")[0]


def _tests_pass(mutant: Mutant, files: list[str], first_tests: list[str], baseline: Baseline) -> bool:
    """Return whether all tests of these files pass with the mutant; ``first_tests`` are run first."""
    _replace_modules({mutant.path: mutant.code})
    plugin = _TestOrder({test_id: position for position, test_id in enumerate(first_tests)}, baseline)
    exit_code = pytest.main([*PYTEST_OPTIONS, "-m", baseline.marks, "-x", *files], plugins=[plugin])
    return exit_code == pytest.ExitCode.OK


@dataclass(frozen=True)
class _TestOrder:
    """Plugin of pytest that runs the tests with a position first, and leaves out those that always fail."""

    positions: dict[str, int]
    baseline: Baseline

    @pytest.hookimpl(trylast=True)
    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        """Choose and sort the tests, and give each a timeout."""
        items[:] = [item for item in items if item.nodeid not in self.baseline.failed]
        for item in items:
            usual_seconds = self.baseline.seconds.get(item.nodeid, 0)
            timeout = TIMEOUT_SECONDS + TIMEOUT_FACTOR * usual_seconds
            item.add_marker(pytest.mark.timeout(timeout), append=False)
        last_position = len(self.positions)
        items.sort(key=lambda item: self.positions.get(item.nodeid, last_position))


# --- Child processes -------------------------------------------------------------------------------------


def _replace_modules(changed_files: Mapping[Path, str | Module]) -> None:
    """Let Python import these files with other text, or another tree, until this process ends.

    All modules of the project that have been imported are forgotten, so that they import the changed ones.
    """
    for name in list(sys.modules):
        # Compiled modules, whose names begin with "_", cannot be imported twice.
        if re.match(r"mcp_asdf(_tools)?(\.(?!_)|$)", name):
            del sys.modules[name]
    original_get_code = SourceFileLoader.get_code

    def get_code(self: SourceFileLoader, name: str) -> CodeType | None:
        path = Path(self.path)
        changed_source = changed_files.get(path.relative_to(ROOT)) if path.is_relative_to(ROOT) else None
        if changed_source is None:
            return original_get_code(self, name)
        return compile(changed_source, self.path, "exec")

    patch.object(SourceFileLoader, "get_code", get_code).start()


def _succeeds_in_child(action: Callable[[], bool], timeout: float | None = None) -> bool:
    """Run ``action`` in a process of its own, without its output, and return what it returns.

    Returns False if the process dies or takes longer than ``timeout`` seconds; then it is killed with all
    processes that it has started.
    """
    child = _FORK.Process(target=_exit_with_result, args=(action,))
    child.start()
    child.join(timeout)
    if child.is_alive():
        assert child.pid is not None
        os.killpg(child.pid, signal.SIGKILL)
        child.join()
    return child.exitcode == 0


def _exit_with_result(action: Callable[[], bool]) -> None:
    """End this process, a new child, with exit code 0 if ``action`` returns True, and 1 otherwise."""
    exit_code = 1
    try:
        os.setsid()  # a process group of its own, which can be killed as a whole
        os.chdir(ROOT)
        os.environ.pop(DRAWS_ALL, None)  # random tests that draw all their cases are slow ones
        null_device = os.open(os.devnull, os.O_RDWR)
        for standard_stream in range(3):
            os.dup2(null_device, standard_stream)
        exit_code = 0 if action() else 1
    finally:
        os._exit(exit_code)
