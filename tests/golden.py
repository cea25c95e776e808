"""Results of an earlier commit, which must stay as they are: texts in golden_files and in pages."""

from __future__ import annotations

import difflib
import os
from pathlib import Path

FOLDER = Path(__file__).with_name("golden_files")
RENEW = "RENEW_GOLDEN_FILES"
"""The environment variable with which a run writes the files and pages instead of comparing with them."""


def assert_equals_golden_file(name: str, lines: list[str]) -> None:
    """Fail with the lines that differ if ``lines`` are not those of a file in golden_files."""
    path = FOLDER / name
    if RENEW in os.environ:
        path.write_text("".join(f"{line}\n" for line in lines), encoding="utf-8")
    expected_lines = path.read_text(encoding="utf-8").splitlines()
    differences = list(difflib.unified_diff(expected_lines, lines, name, "this run", lineterm="", n=0))
    shown = "\n".join(differences[:40])
    assert lines == expected_lines, f"if this is on purpose, run it with {RENEW}=1:\n{shown}"


def assert_equals_section(page: Path, name: str, text: str) -> None:
    """Fail unless a page has the text between ``<!-- NAME -->`` and ``<!-- end of NAME -->``.

    With RENEW the text is written there instead.
    """
    start, end = f"<!-- {name} -->\n", f"\n<!-- end of {name} -->"
    before, found_start, behind_start = page.read_text(encoding="utf-8").partition(start)
    section, found_end, after = behind_start.partition(end)
    assert found_start, f"{page} has no {start}"
    assert found_end, f"{page} has no {end}"
    if RENEW in os.environ:
        page.write_text(before + start + text + end + after, encoding="utf-8")
    else:
        assert section == text, f"if this is on purpose, run it with {RENEW}=1"
