"""The tool that puts what a study has found into the documentation."""

from __future__ import annotations

from pathlib import Path

import pytest
from PIL import Image

from benchmarks import pages


def marked_table(mark: str, *rows: str) -> str:
    """Return a table in Markdown with these rows, between its mark and the mark of its end."""
    return "\n".join([f"<!-- {mark} -->", "| H | no filter |", "|---|---|", *rows, "<!-- end -->"])


def page_with(table: str) -> str:
    """Return a page with words before and after a table."""
    return f"Words.\n\n{table}\n\nMore words."


def test_rows_of_a_table_on_a_page_are_replaced_by_those_of_the_study_and_no_other_row_is_added() -> None:
    """A row that the study lacks stays as it is."""
    page = page_with(marked_table("filters", "| moving | old |", "| not in study | old |"))
    tables_of_study = marked_table("filters", "| moving | new |", "| not on page | new |")

    updated_page = pages.update_tables(page, tables_of_study)

    assert updated_page == page_with(marked_table("filters", "| moving | new |", "| not in study | old |"))


@pytest.fixture
def project(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with empty folders for pages, pictures and data, which stands for the project's."""
    for folder in ("docs/images", "docs/internals", "tests/data"):
        (tmp_path / folder).mkdir(parents=True)
    monkeypatch.setattr(pages, "ROOT", tmp_path)
    return tmp_path


def run_tool(study: str, folder_of_results: Path) -> int:
    """Run the tool for a study, and return its exit code."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("sys.argv", ["pages.py", study, str(folder_of_results)])
        return pages.main()


def test_the_tool_puts_the_tables_of_a_study_into_its_page_and_its_picture_beside_the_others(
    project: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """The study of ageing sensors has written ageing.md and ageing.png into a folder of results."""
    page = project / "docs/internals/ageing.md"
    page.write_text(page_with(marked_table("filters", "| moving | old |")))
    results = tmp_path_factory.mktemp("results")
    (results / "ageing.md").write_text(marked_table("filters", "| moving | new |"))
    Image.new("RGB", (4, 4)).save(results / "ageing.png")

    exit_code = run_tool("ageing", folder_of_results=results)

    assert exit_code == 0
    assert page.read_text() == page_with(marked_table("filters", "| moving | new |"))
    with Image.open(project / "docs/images/ageing.webp") as picture:
        assert picture.format == "WEBP"


# --- The paper's study -----------------------------------------------------------------------------------


def study_page(results: str) -> str:
    """Return the page of the paper's study with these results."""
    return f"Words.\n\n<!-- results -->\n{results}\n<!-- end -->\n\nMore words."


def test_the_tool_puts_the_beginning_of_a_report_into_the_page_of_the_study_and_records_its_verdicts(
    project: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """The report's title, its links and its section "Claims" are left out; its headings are a level lower.

    Its comparisons.csv has a line for each comparison. A recorded line ends in the number of comparisons of a
    claim that hold, and in the number of all.
    """
    (project / "docs/internals/study.md").write_text(study_page(results="old"))
    folder = tmp_path_factory.mktemp("report")
    table_head = "| for a user | dynamic |\n|---|---|\n"
    (folder / "report.md").write_text(
        "# The study\n\n"
        "1 of 2 claims hold.\n\n"
        f"{table_head}| Is it 1 of 2? | [yes](#a), 1 of 1 |\n\n"
        "## What was run\n\n30 trials\n\n"
        "## Claims\n\nMany."
    )
    comparisons = "claim,part,verdict,holds\nfirst,dynamic,mixed,yes\nfirst,dynamic,mixed,no\n"
    (folder / "comparisons.csv").write_text(comparisons)

    assert run_tool("study", folder_of_results=folder) == 0

    beginning_of_report = (
        "1 of 2 claims hold.\n\n"
        f"{table_head}| Is it 1 of 2? | yes |\n\n"
        "### What was run\n\n30 trials"
    )  # fmt: skip
    page = (project / "docs/internals/study.md").read_text()
    assert page == study_page(results=beginning_of_report)
    recorded_verdicts = (project / "tests/data/study_verdicts.csv").read_text()
    assert recorded_verdicts == "claim,part,verdict,holds,of\nfirst,dynamic,mixed,1,2\n"


def test_the_tool_changes_no_page_by_a_study_that_is_too_short_for_verdicts(
    project: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """The report says so, and the tool ends with exit code 1."""
    page = project / "docs/internals/study.md"
    page.write_text(study_page(results="old"))
    folder = tmp_path_factory.mktemp("report")
    (folder / "report.md").write_text("# The study\n\n**Too short for verdicts**")

    assert run_tool("study", folder_of_results=folder) == 1
    assert page.read_text() == study_page(results="old")
