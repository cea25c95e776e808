"""Put the overview of a study into docs/reproduce.md, and its verdicts into tests/data/study_verdicts.csv.

    python tests/benchmarks/study_page.py FOLDER

FOLDER is what ``mcp-asdf reproduce`` has written. Exit code 1 if its report has no verdicts.
"""

from __future__ import annotations

import csv
import re
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PAGE, VERDICTS = ROOT / "docs/reproduce.md", ROOT / "tests/data/study_verdicts.csv"
START, END = "<!-- results -->", "<!-- end of results -->"

Row = tuple[str, str, str, int, int]
"""Claim, part, verdict, how many comparisons hold, and of how many."""


def overview_of(report: str) -> str:
    """What a report says before its claims, without links."""
    chosen = report.partition("\n\n")[2].partition("## Claims")[0]
    chosen = re.sub(r"^(#+) ", r"#\1 ", chosen, flags=re.M)
    return re.sub(r"\[([^\]]*)\]\(#[^)]*\)", r"\1", chosen).strip()


def rows_of(comparisons: Path) -> list[Row]:
    """The verdicts with the first seed."""
    found: dict[tuple[str, ...], list[bool]] = {}
    with comparisons.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    for row in rows:
        if row["seed"] == rows[0]["seed"]:
            key = (row["claim"], row["part"], row["verdict"])
            found.setdefault(key, []).append(row["holds"] == "yes")
    return [(*key, sum(holds), len(holds)) for key, holds in found.items()]  # type: ignore[misc]


def main() -> int:
    """Write both; returns the exit code."""
    folder = Path(sys.argv[1])
    report = (folder / "report.md").read_text(encoding="utf-8")
    if "Too short for verdicts" in report:
        return 1
    with VERDICTS.open("w", encoding="utf-8", newline="") as file:
        lines = csv.writer(file, lineterminator="\n")
        lines.writerow(("claim", "part", "verdict", "holds", "of"))
        lines.writerows(rows_of(folder / "comparisons.csv"))
    head, _, rest = PAGE.read_text(encoding="utf-8").partition(START)
    PAGE.write_text(f"{head}{START}\n{overview_of(report)}\n{END}{rest.partition(END)[2]}", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
