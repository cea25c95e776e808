"""The judge of the robust filter makes the rows of its table again, and the page's figures are those rows."""

from __future__ import annotations

import csv
from pathlib import Path

import pytest

from benchmarks.robust_judge.__main__ import ALL_CASES, compile_judge, read_rows, rows_of, run_case
from support import ROOT

STUDY = ROOT / "docs/robust_study.csv"


def test_the_table_has_every_case_with_each_filter() -> None:
    rows = read_rows(STUDY)
    cases = {(case.group, case.name, case.flaw) for case in ALL_CASES}
    assert {(row["group"], row["case"], row["flaw"]) for row in rows} == cases
    assert len(rows) == 3 * len(cases)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["moving, 5 robots, .3 flawed", "ring, .3 flawed"])
def test_a_case_run_again_gives_the_rows_of_the_table(name: str, tmp_path: Path) -> None:
    program = compile_judge(tmp_path)
    for case in (case for case in ALL_CASES if case.name == name):
        rows = list(rows_of(case, run_case(program, case, case.trials)))
        assert rows == [row for row in read_rows(STUDY) if (row["case"], row["flaw"]) == (name, case.flaw)]


def test_the_page_shows_figures_of_the_table() -> None:
    errors_by_row = {
        (row["case"], row["flaw"], row["filter"]): float(row["error"]) for row in read_rows(STUDY)
    }
    page = (ROOT / "docs/internals/robust.md").read_text(encoding="utf-8")
    table = page[page.index("| case | swarm |") :].split("\n\n")[0]
    shown_rows = list(csv.reader(table.splitlines()[2:], delimiter="|"))
    assert len(shown_rows) == 10
    for _, case, flaw, *errors, _ in shown_rows:
        for filter_name, error in zip(("none", "asdf-minus", "robust"), errors, strict=True):
            exact_error = errors_by_row[case.strip(), flaw.strip(), filter_name]
            assert float(error) == pytest.approx(
                exact_error, abs=0.00051 if exact_error >= 0.0095 else 0.000051
            )
