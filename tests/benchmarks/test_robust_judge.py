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
"""Table of the cases' results: a row for each case, flaw and filter."""
VARIANT_STUDY = ROOT / "docs/robust_variants.csv"
"""Table of some cases' results with the variants of the robust filter, each of which changes its source."""


def test_the_table_has_every_case_with_each_filter() -> None:
    """There are three filters: none, ASDF- and the robust one."""
    rows = read_rows(STUDY)
    cases = {(case.group, case.name, case.flaw) for case in ALL_CASES}
    assert {(row["group"], row["case"], row["flaw"]) for row in rows} == cases
    assert len(rows) == 3 * len(cases)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["moving, 5 robots, .3 flawed", "ring, .3 flawed"])
def test_a_case_run_again_gives_the_rows_of_the_table(name: str, tmp_path: Path) -> None:
    """A case is a kind of swarm, simulated with each filter. docs/robust_study.csv has its results.

    Swarms of one name differ in their flaw: what is wrong with some of their sensors.
    """
    program = compile_judge(tmp_path)
    rows_of_study = read_rows(STUDY)
    cases = [case for case in ALL_CASES if case.name == name]
    assert cases

    for case in cases:
        results = run_case(program, case, case.trials)
        expected_rows = [row for row in rows_of_study if row["case"] == name and row["flaw"] == case.flaw]
        assert list(rows_of(case, results)) == expected_rows


def test_the_page_shows_figures_of_the_table() -> None:
    """docs/internals/robust.md shows ten rows of errors with each filter, rounded to 3 or 4 decimals."""
    errors_by_row = {
        (row["case"], row["flaw"], row["filter"]): float(row["error"]) for row in read_rows(STUDY)
    }
    page = (ROOT / "docs/internals/robust.md").read_text(encoding="utf-8")
    table = page[page.index("| case | swarm |") :].split("\n\n")[0]
    _heading, _rule, *lines = table.splitlines()
    shown_rows = list(csv.reader(lines, delimiter="|"))
    assert len(shown_rows) == 10
    # A line begins and ends with the separator, so its first and last cell are empty.
    for _, case, flaw, *errors, _ in shown_rows:
        for filter_name, error in zip(("none", "asdf-minus", "robust"), errors, strict=True):
            exact_error = errors_by_row[case.strip(), flaw.strip(), filter_name]
            # Half of the last decimal, and a little: errors below 0.0095 have four decimals.
            rounding = 0.00051 if exact_error >= 0.0095 else 0.000051
            assert float(error) == pytest.approx(exact_error, abs=rounding)


# --- Variants of the filter ------------------------------------------------------------------------------


@pytest.mark.parametrize("variant", VARIANTS)
def test_a_variant_is_a_change_of_today_s_firmware(variant: str, tmp_path: Path) -> None:
    """``write_variant`` copies the firmware into a folder, with lines of one file or more replaced."""
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
    """The judge is compiled with the variant of the firmware, and simulates one case again.

    The judge calls the filter "robust", and the table calls it by the variant's name.
    """
    case = next(case for case in VARIANT_CASES if case.name == "moving, 5 robots, .3 flawed")
    write_variant(CORE, tmp_path, variant)
    program = compile_judge(tmp_path, tmp_path)

    results = run_case(program, case, case.trials, ["robust"])

    expected_rows = [
        row
        for row in read_rows(VARIANT_STUDY)
        if row["case"] == case.name and row["flaw"] == case.flaw and row["filter"] == variant
    ]
    assert list(rows_of(case, results, labels={"robust": variant})) == expected_rows


def test_the_page_compares_variants_by_figures_of_the_tables() -> None:
    """Each row of the page's table has a quantity with the filter as it is, and with a variant of it."""
    rows_by_key = {
        (f"{row['case']}, {row['flaw']}", row["filter"]): row
        for row in [*read_rows(STUDY), *read_rows(VARIANT_STUDY)]
    }
    page = (ROOT / "docs/internals/robust.md").read_text(encoding="utf-8")
    table = page.split("<!-- variants -->\n")[1].split("<!-- end -->")[0]
    _heading, _rule, *lines = table.splitlines()
    shown_rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]
    assert {variant for variant, *_ in shown_rows} == set(VARIANTS)
    for variant, case, quantity, as_it_is, changed in shown_rows:
        column = {"harmed, %": "harmed", "error": "error"}[quantity]
        for filter_name, shown in (("robust", as_it_is), (variant, changed)):
            assert f"{float(rows_by_key[case, filter_name][column]):.2g}" == shown
