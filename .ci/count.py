"""Print how many tests passed, failed and were skipped: ``python count.py FOLDER`` of JUnit reports."""

import sys
import xml.etree.ElementTree as ET
from collections import Counter
from pathlib import Path


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


def main() -> None:
    """Print the sum over a folder."""
    total = sum(map(count, Path(sys.argv[1]).glob("*.xml")), Counter[str]())
    print(f"{total['passed']} passed, {total['failed']} failed, {total['skipped']} skipped")


if __name__ == "__main__":
    main()
