"""Tests that a mutant of the Python has to get past: the quick ones of its room, in child processes."""

from __future__ import annotations

import json
import os
import re
import resource
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec, SourceFileLoader
from importlib.util import spec_from_file_location
from multiprocessing import get_context
from pathlib import Path
from tempfile import TemporaryDirectory
from types import CodeType, FrameType

import pytest

from mutation.python_mutants import Mutant
from support import DRAWS_ALL, ROOT

PROCESSOR_SECONDS, SECONDS = 120, 900
"""Limits for one mutant: what hangs has been noticed."""
QUIET = ("-q", "-p", "no:xdist", "-p", "no:cacheprovider", "-m", "not slow")
_FORK = get_context("fork")


def tests_of(path: Path) -> Path:
    """Tests of the room that a file is in; commands and what all rooms share are tested everywhere."""
    if path.parts[0] == "firmware_py":
        return Path("tests/firmware_py")
    room = Path("tests/host_tools", path.parts[2])
    is_room = path.parts[2] != "cli" and (ROOT / room).is_dir()
    return room if is_room else room.parent


@dataclass
class Record:
    """What the tests do without a mistake.

    Attributes:
        seconds: Time of each test, by its name.
        tests: Tests that call a function, by ``FILE:FIRST LINE``.
        failed: Tests that fail, and notice nothing.
    """

    seconds: dict[str, float] = field(default_factory=dict)
    tests: dict[str, list[str]] = field(default_factory=dict)
    failed: list[str] = field(default_factory=list)

    def calling(self, mutant: Mutant, folders: Iterable[Path]) -> list[str]:
        """Tests in the folders that call the mutant's function, fast ones first."""
        found = self.tests.get(f"{mutant.path}:{mutant.function}", [])
        inside = tuple(map(str, folders))
        return sorted((each for each in found if each.startswith(inside)), key=self.seconds.__getitem__)


def record(folders: Iterable[Path]) -> Record:
    """Run the tests of these folders once."""
    with TemporaryDirectory() as made:
        file = Path(made) / "record.json"
        paths = sorted({*map(str, folders)})
        _in_child(lambda: _record_into(file, paths), None)
        return Record(**json.loads(file.read_text(encoding="utf-8")))


def _record_into(file: Path, paths: list[str]) -> bool:
    recorder = _Recorder()
    pytest.main([*QUIET, *paths], plugins=[recorder])
    file.write_text(json.dumps(vars(recorder.found)), encoding="utf-8")
    return True


class _Recorder:
    """Plugin of pytest that notes which functions of the project a test calls."""

    def __init__(self) -> None:
        self.found = Record()
        self._called: set[CodeType] = set()

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> object:
        """Trace calls, in every thread, while a test and its fixtures run."""
        start = time.monotonic()
        self._called.clear()
        threading.settrace(self._trace)
        sys.settrace(self._trace)
        try:
            return (yield)
        finally:
            sys.settrace(None)
            self.found.seconds[item.nodeid] = time.monotonic() - start
            for code in self._called:
                if code.co_filename.startswith(str(ROOT)):
                    function = f"{Path(code.co_filename).relative_to(ROOT)}:{code.co_firstlineno}"
                    self.found.tests.setdefault(function, []).append(item.nodeid)

    def _trace(self, frame: FrameType, event: str, argument: object) -> None:
        self._called.add(frame.f_code)

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Note a test that fails."""
        if report.failed:
            self.found.failed.append(report.nodeid)


def dies(mutant: Mutant, known: Record, folders: Iterable[Path]) -> bool:
    """True if a test in the folders fails: one that calls the function, or another of the same file, to which
    a cache or a fixture may bring the result."""
    calling = known.calling(mutant, folders)
    return bool(calling) and not _in_child(lambda: _passes(mutant, calling, known.failed), SECONDS)


def _passes(mutant: Mutant, calling: list[str], failed: list[str]) -> bool:
    resource.setrlimit(resource.RLIMIT_CPU, (PROCESSOR_SECONDS, PROCESSOR_SECONDS))
    _install(mutant)
    files = dict.fromkeys(test.partition("::")[0] for test in calling)
    plugin = _Sorter({test: number for number, test in enumerate(calling)}, {*failed})
    return pytest.main([*QUIET, "-x", *files], plugins=[plugin]) == pytest.ExitCode.OK


@dataclass(frozen=True)
class _Sorter:
    """Plugin of pytest that runs the tests in this order, others after them, and some not at all."""

    order: dict[str, int]
    without: set[str]

    @pytest.hookimpl(trylast=True)
    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        """Sort the tests."""
        items[:] = [each for each in items if each.nodeid not in self.without]
        items.sort(key=lambda each: self.order.get(each.nodeid, len(self.order)))


class _MutatedFile(SourceFileLoader):
    """Loader of the mutant in the place of its file."""

    def __init__(self, mutant: Mutant) -> None:
        super().__init__(mutant.module, str(ROOT / mutant.path))
        self._code = mutant.code

    def get_code(self, fullname: str) -> CodeType:
        """The mutant's code, never from a cache."""
        return compile(self._code, self.path, "exec")


@dataclass(frozen=True)
class _Finder(MetaPathFinder):
    """Finder of the mutant, and of nothing else."""

    mutant: Mutant

    def find_spec(self, fullname: str, *_: object) -> ModuleSpec | None:
        """The mutant's specification."""
        if fullname != self.mutant.module:
            return None
        return spec_from_file_location(fullname, ROOT / self.mutant.path, loader=_MutatedFile(self.mutant))


def _install(mutant: Mutant) -> None:
    """Let the mutant be imported from now on, also by modules that were imported before."""
    for name in [each for each in sys.modules if re.match(r"mcp_asdf(_tools)?(\.(?!_)|$)", each)]:
        del sys.modules[name]
    sys.meta_path.insert(0, _Finder(mutant))


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
