"""Count tests that passed, failed and were skipped, in the JUnit reports of a folder.

Usage: python .ci/count.py [--strict] FOLDER      count; the sum is on the last line
       python .ci/count.py --renew                write test_counts.json: how many tests each folder has

The reason of each skipped test is printed. With --strict, as continuous integration has it, a gate that is
not there must not look like one that holds: a skipped test fails, and so does a folder that has 2 % fewer
tests than test_counts.json lists.
"""

from __future__ import annotations

import json
import subprocess
import sys
import xml.etree.ElementTree as ET
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
COUNTS_FILE = Path(__file__).with_name("test_counts.json")
RENEW_COMMAND = ".venv/bin/python .ci/count.py --renew"

SMALLEST_SHARE = 0.98
"""Share of a folder's listed tests that have to pass."""
LARGEST_SHARE = 1.1
"""Share of all listed tests above which the list is too old: it would not notice a loss of the new ones."""

MACHINE_REASONS = (
    "this processor has no vectors of",
    "this machine's kernel has CAN, and the tests run on it",
)
"""How the reasons of skipped tests begin that no installation can remove."""


@dataclass(frozen=True)
class ReportedTest:
    """One test in a report.

    Attributes:
        name: Module and name, the same in each report that has the test.
        folder: Folder of its module, such as "tests/host_tools/bus".
        outcome: "passed", "failed" or "skipped".
        reason: Why it was skipped, or empty.
    """

    name: str
    folder: str
    outcome: str
    reason: str = ""


def read_report(report: Path) -> Iterator[ReportedTest]:
    """Yield the tests of a JUnit report. An error, as of a fixture, is a failure."""
    for element in ET.parse(report).getroot().iter("testcase"):
        module = element.get("classname", "")
        name, folder = f"{module}::{element.get('name')}", folder_of(module)
        skip = element.find("skipped")
        if element.find("failure") is not None or element.find("error") is not None:
            yield ReportedTest(name, folder, "failed")
        elif skip is not None:
            yield ReportedTest(name, folder, "skipped", skip.get("message") or "no reason")
        else:
            yield ReportedTest(name, folder, "passed")


def folder_of(module: str) -> str:
    """Return the folder of a module's file: "tests/host_tools/bus" of "tests.host_tools.bus.test_dbc"."""
    parts = module.split(".")
    folders = [part for part in parts if not part.startswith("test_")]
    return "/".join(folders)


def find_complaints(tests: list[ReportedTest], listed_counts: dict[str, int]) -> list[str]:
    """Return what a strict count finds wrong, one line each."""
    complaints = []
    outcomes = Counter(test.outcome for test in tests)
    if outcomes["failed"] > 0:
        complaints.append(f"{outcomes['failed']} failed")
    avoidable_skips = [test for test in tests if test.outcome == "skipped" and is_avoidable(test.reason)]
    if avoidable_skips:
        complaints.append(f"{len(avoidable_skips)} were skipped that a complete set-up runs")
    # Random tests are in two reports, and count once. What this machine cannot run is not lost.
    kept_tests = {(test.name, test.folder) for test in tests if test.outcome != "failed"}
    counts = Counter(folder for _, folder in kept_tests)
    for folder, listed_count in listed_counts.items():
        if counts[folder] < SMALLEST_SHARE * listed_count:
            complaints.append(
                f"{folder}: {counts[folder]} tests of {listed_count}; "
                f"if they were removed on purpose, run {RENEW_COMMAND}"
            )
    if counts.total() > LARGEST_SHARE * sum(listed_counts.values()):
        complaints.append(
            f"{counts.total()} tests, {sum(listed_counts.values())} listed; run {RENEW_COMMAND}"
        )
    return complaints


def is_avoidable(reason: str) -> bool:
    """Return whether a test that is skipped for this reason would run on the same machine, set up fully."""
    return not reason.startswith(MACHINE_REASONS)


def collect_counts() -> dict[str, int]:
    """Return how many tests pytest finds in each folder, slow ones included. Takes some 15 seconds."""
    command = [sys.executable, "-m", "pytest", "--collect-only", "--quiet"]
    result = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    files = [line.partition("::")[0] for line in result.stdout.splitlines() if line.startswith("tests/")]
    return dict(sorted(Counter(str(Path(file).parent) for file in files).items()))


def main(arguments: list[str]) -> int:
    """Count, or write the list of counts; returns 1 if a strict count finds something wrong."""
    if arguments == ["--renew"]:
        COUNTS_FILE.write_text(json.dumps(collect_counts(), indent=2) + "\n", encoding="utf-8")
        return 0
    reports = sorted(Path(arguments[-1]).glob("*.xml"))
    tests = [test for report in reports for test in read_report(report)]
    for test in tests:
        if test.outcome == "skipped":
            print(f"skipped: {test.reason}")
    complaints = []
    if "--strict" in arguments:
        complaints = find_complaints(tests, json.loads(COUNTS_FILE.read_text(encoding="utf-8")))
    for complaint in complaints:
        print(f"strict: {complaint}")
    outcomes = Counter(test.outcome for test in tests)
    print(f"{outcomes['passed']} passed, {outcomes['failed']} failed, {outcomes['skipped']} skipped")
    return int(bool(complaints))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
