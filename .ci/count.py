"""Count tests that passed, failed and were skipped, in JUnit reports: ``python count.py [--strict] FOLDER``.

The reason of each skipped test is printed. With --strict, as continuous integration has it, a skip fails, and
so do far fewer tests than there once were: a gate that is not there must not look like one that holds.
"""

import sys
import xml.etree.ElementTree as ET
from collections import Counter
from pathlib import Path

LAST_RELEASE = 3000
"""Tests of ``make test`` and ``make verify`` that passed before the last release, to be set before each: in
hundreds, and those twice that both run."""

OF_THE_MACHINE = (
    "this processor has no vectors of",
    "this machine's kernel has CAN, and the tests run on it",
)
"""How the reasons begin that no installation can remove."""


def count(report: Path) -> Counter[str]:
    """The outcomes in one report."""
    outcomes: Counter[str] = Counter()
    for suite in ET.parse(report).getroot().iter("testsuite"):
        numbers = {
            name: int(suite.get(name) or 0) for name in ("tests", "failures", "errors", "skipped", "disabled")
        }
        failed = numbers["failures"] + numbers["errors"]
        skipped = numbers["skipped"] + numbers["disabled"]
        outcomes.update(passed=numbers["tests"] - failed - skipped, failed=failed, skipped=skipped)
    return outcomes


def reasons(report: Path) -> list[str]:
    """Why tests of one report were skipped."""
    skips = ET.parse(report).getroot().iter("skipped")
    return [skip.get("message") or "no reason" for skip in skips]


def complaints(total: Counter[str], skips: list[str]) -> list[str]:
    """What a strict count finds wrong."""
    few = total["passed"] < LAST_RELEASE * 9 // 10
    skipped = total["skipped"] - sum(why.startswith(OF_THE_MACHINE) for why in skips)
    wrong = [f"{skipped} were skipped that a complete set-up runs"] if skipped else []
    wrong += [f"{total['passed']} passed; there were {LAST_RELEASE} at the last release"] if few else []
    return [*wrong, f"{total['failed']} failed"] if total["failed"] else wrong


def main(words: list[str]) -> int:
    """Print the sum over a folder on the last line; returns 1 if a strict count finds something wrong."""
    reports = sorted(Path(words[-1]).glob("*.xml"))
    total = sum(map(count, reports), Counter[str]())
    skips = [why for report in reports for why in reasons(report)]
    for why in skips:
        print(f"skipped: {why}")
    wrong = complaints(total, skips) if "--strict" in words else []
    for line in wrong:
        print(f"strict: {line}")
    print(f"{total['passed']} passed, {total['failed']} failed, {total['skipped']} skipped")
    return int(bool(wrong))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
