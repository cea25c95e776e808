"""Tests that a mutant of the Python has to get past: the tests of its room, in child processes."""

from __future__ import annotations

import ast
import builtins
import importlib
import json
import os
import re
import signal
import sys
import time
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

from mutation.python_mutants import Mutant, with_probes
from support import DRAWS_ALL, ROOT

SECONDS, TIMES = 10, 4
"""Limit of a test's time: these seconds, and so many times its time without a mistake. A hang is noticed."""
QUIET = ("-q", "-p", "no:xdist", "-p", "no:cacheprovider", "-p", "no:anyio", "-m")
HEAVY = ("numpy", "scipy.stats", "pyarrow.parquet", "matplotlib.figure", "can", "cffi")
"""Libraries that most tests need, imported once before processes split."""
PROBE = "_mcp_asdf_probe"
"""Built-in function, while tests are recorded, that a probe calls with the name of its statement."""
_FORK = get_context("fork")


def tests_of(path: Path) -> list[Path]:
    """Folders with the tests of a file's room. All folders test commands and files that all rooms share. The
    cross-check tests the firmware, too."""
    if path.parts[0] == "firmware_py":
        return [Path("tests/firmware_py"), Path("tests/host_tools/crosscheck")]
    found = [each.relative_to(ROOT) for each in (ROOT / "tests/host_tools").glob("**/test_*.py")]
    rooms = {each.parent if len(each.parts) > 3 else each for each in found}
    own = Path("tests/host_tools", path.parts[2])
    is_tested_everywhere = path.parts[2] in ("cli", "common")
    return [own] if own in rooms and not is_tested_everywhere else sorted(rooms)


@dataclass
class Record:
    """What the tests do without a mistake.

    Attributes:
        marks: Which tests, in pytest's words.
        seconds: Time of each test, by its name.
        tests: Tests that run a mutant's statement, by ``FILE#PLACE``.
        failed: Tests that fail, and notice nothing.
    """

    marks: str
    seconds: dict[str, float] = field(default_factory=dict)
    tests: dict[str, list[str]] = field(default_factory=dict)
    failed: list[str] = field(default_factory=list)

    def running(self, mutant: Mutant, folders: Iterable[Path]) -> list[str]:
        """Tests in the folders that run the mutant's statement, fast ones first."""
        inside = tuple(map(str, folders))
        found = [test for test in self.tests.get(_statement(mutant), []) if test.startswith(inside)]
        return sorted(found, key=self.seconds.__getitem__)


def record(of: Iterable[Mutant], folders: Iterable[Path], marks: str = "not slow") -> Record:
    """Run the tests of these folders once, and note which run the statements of these mutants.

    A probe before each statement says so: the tests take half the time that they take with all lines traced.
    Rooms are run one by one: what one of them keeps in a cache, the next computes again.
    """
    for library in HEAVY:
        importlib.import_module(library)
    probes: dict[Path, dict[int, str]] = {}
    for each in of:
        probes.setdefault(each.path, {})[each.place] = f"{PROBE}({_statement(each)!r})"
    whole = Record(marks)
    with TemporaryDirectory() as made:
        file = Path(made) / "record.json"
        for folder in sorted({*folders}):
            if not _in_child(partial(_record_into, file, probes, folder, marks), None):
                raise RuntimeError(f"{folder}: its tests ended without a record")
            part = Record(**json.loads(file.read_text(encoding="utf-8")))
            whole.seconds |= part.seconds
            whole.failed += part.failed
            for statement, tests in part.tests.items():
                whole.tests.setdefault(statement, []).extend(tests)
    return whole


def _statement(mutant: Mutant) -> str:
    return f"{mutant.path}#{mutant.place}"


def _record_into(file: Path, probes: dict[Path, dict[int, str]], folder: Path, marks: str) -> bool:
    recorder = _Recorder(marks)
    setattr(builtins, PROBE, recorder.ran.add)
    _install({path: with_probes(path, texts) for path, texts in probes.items()})
    pytest.main([*QUIET, marks, str(folder)], plugins=[recorder])
    file.write_text(json.dumps(vars(recorder.record)), encoding="utf-8")
    return True


class _Recorder:
    """Plugin of pytest that notes which statements a test runs, its fixtures included, in every thread."""

    def __init__(self, marks: str) -> None:
        self.ran: set[str] = set()
        self.record = Record(marks)

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Iterator[None]:
        """Let statements count for this test."""
        start = time.monotonic()
        self.ran.clear()
        try:
            return (yield)
        finally:
            for statement in [*self.ran]:
                self.record.tests.setdefault(statement, []).append(item.nodeid)
            self.record.seconds[item.nodeid] = time.monotonic() - start

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Note a test that fails."""
        if report.failed:
            self.record.failed.append(report.nodeid)


def dies(mutant: Mutant, known: Record, folders: Iterable[Path]) -> bool:
    """True if a test in the folders fails. Files with tests that run the statement are tried as a whole: a
    cache or a fixture may bring the result to their other tests."""
    running = known.running(mutant, folders)
    files = list(dict.fromkeys(test.partition("::")[0] for test in running))
    # Most mutants fail a test of the two quickest files. To import all other files takes seconds.
    for some_files in (files[:2], files):
        usual = sum(taken for test, taken in known.seconds.items() if test.partition("::")[0] in some_files)
        passes = partial(_passes, mutant, some_files, running, known)
        if running and not _in_child(passes, 3 * SECONDS + TIMES * usual):
            return True
    return False


def _passes(mutant: Mutant, files: list[str], running: list[str], known: Record) -> bool:
    _install({mutant.path: mutant.code})
    plugin = _Sorter({test: number for number, test in enumerate(running)}, known)
    return pytest.main([*QUIET, known.marks, "-x", *files], plugins=[plugin]) == pytest.ExitCode.OK


@dataclass(frozen=True)
class _Sorter:
    """Plugin of pytest that runs the tests in this order, then all others but those that fail anyway."""

    order: dict[str, int]
    known: Record

    @pytest.hookimpl(trylast=True)
    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        """Sort the tests, and limit the time of each."""
        items[:] = [each for each in items if each.nodeid not in self.known.failed]
        for each in items:
            seconds = SECONDS + TIMES * self.known.seconds.get(each.nodeid, 0)
            each.add_marker(pytest.mark.timeout(seconds), append=False)
        items.sort(key=lambda each: self.order.get(each.nodeid, len(self.order)))


def _install(changed: Mapping[Path, str | ast.Module]) -> None:
    """Let files be imported in this form from now on, also by modules that were imported before."""
    for name in [each for each in sys.modules if re.match(r"mcp_asdf(_tools)?(\.(?!_)|$)", each)]:
        del sys.modules[name]
    usual = SourceFileLoader.get_code

    def get_code(self: SourceFileLoader, name: str) -> CodeType | None:
        source = changed.get(Path(self.path).relative_to(ROOT)) if self.path.startswith(str(ROOT)) else None
        return usual(self, name) if source is None else compile(source, self.path, "exec")

    patch.object(SourceFileLoader, "get_code", get_code).start()


def _in_child(act: Callable[[], bool], seconds: float | None) -> bool:
    """The answer of ``act`` in a process of its own, with its output dropped; False if it dies or hangs."""
    child = _FORK.Process(target=_answer, args=(act,))
    child.start()
    child.join(seconds)
    if child.is_alive():
        assert child.pid is not None
        os.killpg(child.pid, signal.SIGKILL)
        child.join()
    return child.exitcode == 0


def _answer(act: Callable[[], bool]) -> None:
    status = 1
    try:
        os.setsid()
        os.chdir(ROOT)
        os.environ.pop(DRAWS_ALL, None)  # random tests that draw all their cases are slow ones
        nowhere = os.open(os.devnull, os.O_RDWR)
        for stream in range(3):
            os.dup2(nowhere, stream)
        status = 0 if act() else 1
    finally:
        os._exit(status)
