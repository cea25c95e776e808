"""Put what a study has found into the documentation: tables between their marks, and a picture.

mcp-asdf reproduce --trials 120 --output FOLDER      # also the verdicts, into tests/data/study_verdicts.csv
PYTHONPATH=tests python -m benchmarks.pages study FOLDER

python -m mcp_asdf_tools.studies.robust_filter FOLDER    # or another study
PYTHONPATH=tests python -m benchmarks.pages robust FOLDER

A page shows some rows of a table, or none: those that stand in it are replaced. The exit code is 1 if the
report of a study has no verdicts.
"""

from __future__ import annotations

import csv
import re
import sys
from pathlib import Path

from PIL import Image

ROOT = Path(__file__).resolve().parents[2]

PAGES = {
    "robust": "internals/robust.md",
    "ageing": "internals/ageing.md",
    "related_work": "internals/related_work.md",
    "two_readings": "internals/two_readings.md",
    "small_messages": "internals/small_messages.md",
}
"""The page of docs/ that has the tables of each study, if any, and its picture."""

MARKED = re.compile(r"<!-- (\w+) -->\n(.*?)\n<!-- end -->", re.DOTALL)
"""A table, or other text, between its mark and the end."""


# --- Tables ----------------------------------------------------------------------------------------------


def row_name(line: str) -> str:
    """Return the first cell of a table's line."""
    return line.split("|")[1].strip()


def update_rows(page_table: str, study_table: str) -> str:
    """Replace each row of the page's table by the row with the same name in the study's table."""
    new_rows = {row_name(line): line for line in study_table.splitlines()}
    return "\n".join(new_rows.get(row_name(line), line) for line in page_table.splitlines())


def update_tables(page: str, study: str) -> str:
    """Return the text of a page with the rows of all tables that the study's text has, too."""
    study_tables = dict(MARKED.findall(study))

    def updated(marked: re.Match[str]) -> str:
        mark, page_table = marked.groups()
        table = update_rows(page_table, study_tables[mark]) if mark in study_tables else page_table
        return f"<!-- {mark} -->\n{table}\n<!-- end -->"

    return MARKED.sub(updated, page)


# --- The paper's study -----------------------------------------------------------------------------------


def overview_of(report: str) -> str:
    """Return what a report says before its claims, without links, and its headings one level lower.

    Of a verdict in a table only the word stays: the counts are in the record of the verdicts.
    """
    overview = report.partition("\n\n")[2].partition("## Claims")[0]
    overview = re.sub(r"^(#+) ", r"#\1 ", overview, flags=re.MULTILINE)
    overview = re.sub(r", \d+ of \d+(?= \|)", "", overview)
    return re.sub(r"\[([^\]]*)\]\(#[^)]*\)", r"\1", overview).strip()


def write_verdicts(comparisons: Path, verdicts: Path) -> None:
    """Write a table with one line per part of a claim: the verdict, and how many of its comparisons hold."""
    holding: dict[tuple[str, str, str], list[bool]] = {}
    with comparisons.open(encoding="utf-8", newline="") as file:
        for row in csv.DictReader(file):
            claim = (row["claim"], row["part"], row["verdict"])
            holding.setdefault(claim, []).append(row["holds"] == "yes")
    with verdicts.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(("claim", "part", "verdict", "holds", "of"))
        writer.writerows((*claim, sum(holds), len(holds)) for claim, holds in holding.items())


def put_study(folder: Path) -> int:
    """Write the overview of the paper's study into its page, and the verdicts; returns the exit code."""
    report = (folder / "report.md").read_text(encoding="utf-8")
    if "Too short for verdicts" in report:
        return 1
    write_verdicts(folder / "comparisons.csv", ROOT / "tests/data/study_verdicts.csv")
    page = ROOT / "docs/internals/study.md"
    overview = f"<!-- results -->\n{overview_of(report)}\n<!-- end -->"
    page.write_text(MARKED.sub(lambda _: overview, page.read_text(encoding="utf-8")), encoding="utf-8")
    return 0


def put_tables_and_picture(study: str, folder: Path) -> int:
    """Write tables and picture of one of our own studies into its page; returns the exit code."""
    page = ROOT / "docs" / PAGES[study]
    tables = (folder / f"{study}.md").read_text(encoding="utf-8")
    page.write_text(update_tables(page.read_text(encoding="utf-8"), tables), encoding="utf-8")
    with Image.open(folder / f"{study}.png") as picture:  # WebP is smaller, and is kept with the sources
        picture.save(ROOT / f"docs/images/{study}.webp", quality=75)
    return 0


def main() -> int:
    """Put the study that the command line names into the documentation; returns the exit code."""
    study, folder = sys.argv[1], Path(sys.argv[2])
    return put_study(folder) if study == "study" else put_tables_and_picture(study, folder)


if __name__ == "__main__":
    sys.exit(main())
