"""The tool that puts what a study has found into the documentation."""

from __future__ import annotations

from pathlib import Path

import pytest
from PIL import Image

from benchmarks import pages

PAGE = """Words.

<!-- grid -->
| H | no filter |
|---|---|
| moving | old |
| other | old |
<!-- end -->

More words."""


@pytest.fixture
def root(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Make a folder with pages, in place of the project's."""
    for folder in ("docs/images", "docs/internals", "tests/data"):
        (tmp_path / folder).mkdir(parents=True)
    monkeypatch.setattr(pages, "ROOT", tmp_path)
    return tmp_path


def put(study: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> int:
    monkeypatch.setattr("sys.argv", ["pages.py", study, str(folder)])
    return pages.main()


def test_rows_of_the_page_are_replaced_and_others_left_out() -> None:
    study = "<!-- grid -->\n| H | no filter |\n|---|---|\n| moving | new |\n| not shown | new |\n<!-- end -->"
    assert pages.update_tables(PAGE, study) == PAGE.replace("| moving | old |", "| moving | new |")


def test_a_table_that_the_study_has_not_stays() -> None:
    assert pages.update_tables(PAGE, "<!-- other -->\n| moving | new |\n<!-- end -->") == PAGE


def test_tables_and_picture_of_a_study_go_into_its_page(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (root / "docs/internals/ageing.md").write_text(PAGE.replace("grid", "filters"))
    (root / "ageing.md").write_text("<!-- filters -->\n| moving | new |\n<!-- end -->")
    Image.new("RGB", (4, 4)).save(root / "ageing.png")

    assert put("ageing", root, monkeypatch) == 0
    assert "| moving | new |" in (root / "docs/internals/ageing.md").read_text()
    assert (root / "docs/images/ageing.webp").read_bytes()[8:12] == b"WEBP"


REPORT = """# The study

1 of 2 claims hold.

| for a user | dynamic |
|---|---|
| Is it 1 of 2? | [yes](#a), 1 of 1 |

## What was run

30 trials

## Claims

Many."""
COMPARISONS = """claim,part,verdict,holds
first,dynamic,agree,yes
second,dynamic,mixed,yes
second,dynamic,mixed,no
"""


@pytest.fixture
def study_folder(root: Path) -> Path:
    """Make a page and the report of a study for it."""
    (root / "docs/internals/study.md").write_text(
        "Words.\n\n<!-- results -->\nold\n<!-- end -->\n\nMore words."
    )
    (root / "report.md").write_text(REPORT)
    (root / "comparisons.csv").write_text(COMPARISONS)
    return root


def test_the_overview_of_the_study_goes_into_its_page(
    study_folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert put("study", study_folder, monkeypatch) == 0
    table = "| for a user | dynamic |\n|---|---|\n| Is it 1 of 2? | yes |"
    overview = f"1 of 2 claims hold.\n\n{table}\n\n### What was run\n\n30 trials"
    expected = f"Words.\n\n<!-- results -->\n{overview}\n<!-- end -->\n\nMore words."
    assert (study_folder / "docs/internals/study.md").read_text() == expected


def test_the_verdicts_of_the_study_are_recorded(study_folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The tool counts how many comparisons of each claim hold, and keeps that for a test of the page."""
    put("study", study_folder, monkeypatch)
    assert (study_folder / "tests/data/study_verdicts.csv").read_text().splitlines() == [
        "claim,part,verdict,holds,of",
        "first,dynamic,agree,1,1",
        "second,dynamic,mixed,1,2",
    ]


def test_a_study_without_verdicts_changes_no_page(
    study_folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (study_folder / "report.md").write_text("# The study\n\n**Too short for verdicts**")
    assert put("study", study_folder, monkeypatch) == 1
    assert "old" in (study_folder / "docs/internals/study.md").read_text()
