"""From a test on the host to its report from the guest: there all tests run when the first is asked for."""

from __future__ import annotations

import fcntl
import json
import os
import shutil
import sys
import time
from collections import defaultdict
from pathlib import Path
from typing import Any, Literal

import pytest

from socketcan.guest import NoGuestError, run_in_guest, shell_line, why_not_native
from support import PATIENCE, ROOT
from targets.c_node import CORTEX_A8, NODES, PLAIN

REPORTS = "MCP_ASDF_SOCKETCAN_REPORTS"
"""Set in a guest: the file that takes the reports, one JSON value a line."""

SECONDS = 3 * PATIENCE
"""Time limit for a guest's whole life, in which it starts and runs one test after the other."""

WORK = ROOT / "build/socketcan"
_KEPT_SECONDS = 3600

Reports = dict[str, list[pytest.TestReport]]
_REPORTS = pytest.StashKey[Reports | str]()


class Reporter:
    """Writes a guest's reports down, so that a guest that breaks off leaves those that were made."""

    def __init__(self, config: pytest.Config, path: str) -> None:
        self._config = config
        self._path = Path(path)

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Append one."""
        data = self._config.hook.pytest_report_to_serializable(config=self._config, report=report)
        with self._path.open("a", encoding="utf-8") as stream:
            stream.write(json.dumps(data) + "\n")


def reports_of(item: pytest.Item) -> list[pytest.TestReport]:
    """The guest's reports of a test, or one that says why there are none."""
    try:
        every = _reports(item.session)
    except NoGuestError as error:
        reason = f"Skipped: {why_not_native()}, and no guest: {error}"
        return [_report(item, "skipped", (str(item.path), 0, reason))]
    reports = every.get(item.nodeid, [])
    if not any(report.when == "teardown" for report in reports):
        files = [_folder(item.config) / name for name in ("console", "log")]
        told = "\n".join(path.read_text(errors="replace")[-3000:] for path in files if path.exists())
        explanation = f"the guest did not start, or broke off within {SECONDS:g} s:\n{told}"
        reports = [*reports, _report(item, "failed", explanation)]
    return reports


def _report(item: pytest.Item, outcome: Literal["failed", "skipped"], explanation: Any) -> pytest.TestReport:
    return pytest.TestReport(item.nodeid, item.location, {}, outcome, explanation, "setup")


def _reports(session: pytest.Session) -> Reports:
    """All that the guest reported. Raises NoGuestError if none can be had."""
    if _REPORTS not in session.stash:
        shared = _folder(session.config)
        reason = _run_all(session, shared)
        session.stash[_REPORTS] = reason or _read(session.config, shared / "reports")
    found = session.stash[_REPORTS]
    if isinstance(found, str):
        raise NoGuestError(found)
    return found


def _run_all(session: pytest.Session, shared: Path) -> str:
    """Run the session's tests in a guest, unless another of its worker processes has done so.

    Returns why no guest can be had; empty if one can.
    """
    tests = [item.nodeid for item in session.items if item.get_closest_marker("socketcan")]
    verdict = shared / "verdict"
    with (shared / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not verdict.exists():
            try:
                run_in_guest(_script(shared, tests), shared, SECONDS)
                verdict.touch()
            except NoGuestError as error:
                verdict.write_text(str(error), encoding="utf-8")
    return verdict.read_text(encoding="utf-8")


def _read(config: pytest.Config, path: Path) -> Reports:
    reports: Reports = defaultdict(list)
    for line in path.read_text(encoding="utf-8").splitlines():
        report = config.hook.pytest_report_from_serializable(config=config, data=json.loads(line))
        if report.skipped and isinstance(report.longrepr, list):
            report.longrepr = tuple(report.longrepr)  # JSON knows no tuples, pytest wants one
        reports[report.nodeid].append(report)
    return reports


def _folder(config: pytest.Config) -> Path:
    """Where this run and its guest meet; the same for all workers. Old ones are removed."""
    WORK.mkdir(parents=True, exist_ok=True)
    for folder in WORK.iterdir():
        if time.time() - folder.stat().st_mtime > _KEPT_SECONDS and folder.name != NODES_FOLDER:
            shutil.rmtree(folder, ignore_errors=True)
    workerinput = getattr(config, "workerinput", None)
    shared: Path = WORK / (workerinput["testrunuid"] if workerinput else str(os.getpid()))
    shared.mkdir(exist_ok=True)
    return shared


NODES_FOLDER = "nodes"


def _script(shared: Path, tests: list[str]) -> str:
    """The guest's script. Nodes are built here, which is much faster than there."""
    for kind in (PLAIN, CORTEX_A8):
        try:
            kind.build(WORK / NODES_FOLDER / kind.name)
        except pytest.skip.Exception:
            continue  # the guest's test skips, too, and says why
    (shared / "reports").touch()
    (shared / "tests").write_text("".join(f"{ROOT}/{test}\n" for test in tests), encoding="utf-8")
    options = ("-p", "no:cacheprovider", "--rootdir", ROOT, "--tb=short", f"@{shared}/tests")
    settings = {
        "PATH": os.environ["PATH"],
        "HOME": "/tmp",
        "PYTHONDONTWRITEBYTECODE": "1",
        "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1",
        REPORTS: shared / "reports",
        NODES: WORK / NODES_FOLDER,
    }
    return "".join(
        [
            shell_line("cd", ROOT),
            "for module in vcan vxcan can-raw sch_netem; do modprobe $module; done\n",
            *(shell_line("export", f"{name}={value}") for name, value in settings.items()),
            shell_line(sys.executable, "-m", "pytest", *options),
        ]
    )
