"""Put the results of a study into docs/reproduce.md: its overview and its tables of claims.

    python tests/benchmarks/study_page.py FOLDER

FOLDER is what ``mcp-asdf reproduce`` has written. Exit code 1 if its report has no verdicts.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

PAGE = Path(__file__).resolve().parents[2] / "docs/reproduce.md"
START, END = "<!-- results -->", "<!-- end of results -->"


def results_of(report: str) -> str:
    """The overview, what was run and the tables of a report, without links to its pictures."""
    chosen = report.partition("\n\n")[2].partition("## Pictures of the claims")[0]
    chosen = re.sub(r"^(#+) ", r"#\1 ", chosen, flags=re.M)
    return re.sub(r"\[([^\]]*(?:\[[^\]]*\][^\]]*)*)\]\(#[^)]*\)", r"\1", chosen).strip()


def main() -> int:
    """Replace what stands between the markers; returns the exit code."""
    report = (Path(sys.argv[1]) / "report.md").read_text(encoding="utf-8")
    if "Too short for verdicts" in report:
        return 1
    page = PAGE.read_text(encoding="utf-8")
    head, _, rest = page.partition(START)
    PAGE.write_text(f"{head}{START}\n{results_of(report)}\n{END}{rest.partition(END)[2]}", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
