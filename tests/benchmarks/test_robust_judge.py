"""The judge of the robust filter makes the rows of its table again, and the page's figures are those rows."""

from __future__ import annotations

import csv
from pathlib import Path

import pytest

from benchmarks.robust_judge.__main__ import (
    ALL_CASES,
    CORE,
    VARIANT_CASES,
    compile_judge,
    read_rows,
    rows_of,
    run_case,
)
from benchmarks.robust_judge.variants import VARIANTS, write_variant
from support import ROOT

STUDY = ROOT / "docs/robust_study.csv"
VARIANT_STUDY = ROOT / "docs/robust_variants.csv"


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


# --- Variants of the filter ------------------------------------------------------------------------------


@pytest.mark.parametrize("variant", VARIANTS)
def test_a_variant_is_a_change_of_today_s_firmware(variant: str, tmp_path: Path) -> None:
    write_variant(CORE, tmp_path, variant)
    is_changed = [path.read_bytes() != (CORE / path.name).read_bytes() for path in tmp_path.iterdir()]
    assert any(is_changed)


def test_the_table_of_variants_has_every_case_with_each_variant() -> None:
    expected_rows = {(case.name, case.flaw, variant) for case in VARIANT_CASES for variant in VARIANTS}
    rows = [(row["case"], row["flaw"], row["filter"]) for row in read_rows(VARIANT_STUDY)]
    assert sorted(rows) == sorted(expected_rows)


@pytest.mark.slow
@pytest.mark.parametrize("variant", VARIANTS)
def test_a_variant_run_again_gives_the_row_of_the_table(variant: str, tmp_path: Path) -> None:
    case = next(case for case in VARIANT_CASES if case.name == "moving, 5 robots, .3 flawed")
    write_variant(CORE, tmp_path, variant)
    results = run_case(compile_judge(tmp_path, tmp_path), case, case.trials, ["robust"])
    key = (case.name, case.flaw, variant)
    expected_rows = [
        row for row in read_rows(VARIANT_STUDY) if (row["case"], row["flaw"], row["filter"]) == key
    ]
    assert list(rows_of(case, results, {"robust": variant})) == expected_rows


def test_the_page_compares_variants_by_figures_of_the_tables() -> None:
    rows_by_key = {
        (f"{row['case']}, {row['flaw']}", row["filter"]): row
        for row in [*read_rows(STUDY), *read_rows(VARIANT_STUDY)]
    }
    page = (ROOT / "docs/internals/robust.md").read_text(encoding="utf-8")
    table = page.split("<!-- variants -->\n")[1].split("<!-- end -->")[0]
    shown_rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in table.splitlines()[2:]]
    assert {variant for variant, *_ in shown_rows} == set(VARIANTS)
    for variant, case, quantity, as_it_is, changed in shown_rows:
        column = {"harmed, %": "harmed", "error": "error"}[quantity]
        for filter_name, shown in (("robust", as_it_is), (variant, changed)):
            assert f"{float(rows_by_key[case, filter_name][column]):.2g}" == shown
