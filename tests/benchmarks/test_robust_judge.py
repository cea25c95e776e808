"""The judge of the robust filter makes the rows of its table again, and the page's figures are those rows."""

from __future__ import annotations

from collections.abc import Iterable
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
from support import ROOT, cells_of_line

Row = dict[str, str]
STUDY = ROOT / "docs/robust_study.csv"
"""Table of the cases' results. It has one row per case, flaw and filter."""
VARIANT_STUDY = ROOT / "docs/robust_variants.csv"
"""Table of some cases' results with variants of the robust filter. Each variant changes its source."""


def test_docs_robust_study_csv_has_every_case_with_each_of_three_filters() -> None:
    """A case is a kind of swarm and a flaw of sensors. The filters are none, ASDF- and the robust one."""
    expected_rows = set()
    for case in ALL_CASES:
        for filter_name in ("none", "asdf-minus", "robust"):
            expected_rows.add((case.group, case.name, case.flaw, filter_name))
    rows = [(row["group"], row["case"], row["flaw"], row["filter"]) for row in read_rows(STUDY)]
    assert sorted(rows) == sorted(expected_rows)


def rows_with(rows: Iterable[Row], **value_by_column: str) -> list[Row]:
    """Return the rows of a table that have these values in these columns."""
    return [row for row in rows if all(row[column] == value for column, value in value_by_column.items())]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["moving, 5 robots, .3 flawed", "ring, .3 flawed"])
@pytest.mark.parametrize("flaw", ["underconfident", "overconfident"])
def test_a_case_that_is_simulated_again_gives_its_rows_of_docs_robust_study_csv(
    flaw: str, name: str, tmp_path: Path
) -> None:
    """A case is a kind of swarm and a flaw of some sensors. It has a row for each of three filters."""
    [case] = [case for case in ALL_CASES if (case.name, case.flaw) == (name, flaw)]
    expected_rows = rows_with(read_rows(STUDY), case=name, flaw=flaw)

    results = run_case(compile_judge(tmp_path), case)

    assert list(rows_of(case, results)) == expected_rows


def cells_of_page(beginning: str) -> list[list[str]]:
    """Return the cells of a table of docs/internals/robust.md, row by row, without its titles.

    ``beginning`` is the line before the table, or the beginning of its titles.
    """
    page = (ROOT / "docs/internals/robust.md").read_text(encoding="utf-8")
    _before, _beginning, after = page.partition(beginning)
    table, _, _ = after.partition("\n\n")
    _titles, _rule, *lines = table.removesuffix("\n<!-- end -->").splitlines()
    return [cells_of_line(line) for line in lines]


def test_docs_internals_robust_md_shows_errors_of_ten_cases_as_docs_robust_study_csv_has_them() -> None:
    """Numbers are rounded to 3 decimals, and to 4 if they are below 0.0095."""
    rows = read_rows(STUDY)
    shown_rows = cells_of_page("| case | swarm |")
    assert len(shown_rows) == 10

    for case, flaw, *shown_errors in shown_rows:
        for filter_name, shown_error in zip(("none", "asdf-minus", "robust"), shown_errors, strict=True):
            [row] = rows_with(rows, case=case, flaw=flaw, filter=filter_name)
            error = float(row["error"])
            half_of_last_decimal = 0.0005 if error >= 0.0095 else 0.00005
            allowed = 1.02 * half_of_last_decimal  # a little more, as the table's errors are rounded, too
            assert float(shown_error) == pytest.approx(error, abs=allowed)


# --- Variants of the filter ------------------------------------------------------------------------------


@pytest.mark.parametrize("variant", VARIANTS)
def test_the_changes_of_each_variant_of_the_filter_can_still_be_made_to_the_firmware(
    variant: str, tmp_path: Path
) -> None:
    """A variant is the firmware with some lines replaced. write_variant() raises if one is not there."""
    write_variant(CORE, tmp_path, variant)

    changed_files = []
    for path in tmp_path.iterdir():
        if path.read_bytes() != (CORE / path.name).read_bytes():
            changed_files.append(path.name)
    assert len(changed_files) > 0


def test_docs_robust_variants_csv_has_every_case_with_each_variant_of_the_filter() -> None:
    """A case is a swarm and a flaw of sensors. A variant is the robust filter with one rule changed."""
    expected_rows = {(case.name, case.flaw, variant) for case in VARIANT_CASES for variant in VARIANTS}
    rows = [(row["case"], row["flaw"], row["filter"]) for row in read_rows(VARIANT_STUDY)]
    assert sorted(rows) == sorted(expected_rows)


@pytest.mark.slow
@pytest.mark.parametrize("variant", VARIANTS)
def test_a_variant_that_is_simulated_again_gives_its_row_of_docs_robust_variants_csv(
    variant: str, tmp_path: Path
) -> None:
    """A variant is the robust filter with one rule changed. The simulator is compiled with that firmware.

    It calls the variant "robust", as it knows of no change. It runs the first case of five moving robots.
    """
    case = next(case for case in VARIANT_CASES if case.name == "moving, 5 robots, .3 flawed")
    write_variant(CORE, tmp_path, variant)
    simulator = compile_judge(tmp_path, tmp_path)

    results = run_case(simulator, case, ["robust"])

    rows = rows_of(case, results, labels={"robust": variant})
    stored_rows = rows_with(read_rows(VARIANT_STUDY), case=case.name, flaw=case.flaw, filter=variant)
    assert list(rows) == stored_rows


COLUMN_OF_QUANTITY = {"harmed, %": "harmed", "error": "error"}
"""Columns of both CSV files, by the names of the quantities on the page."""


def test_docs_internals_robust_md_shows_values_of_each_variant_as_the_csv_files_have_them() -> None:
    """A row of the page's table compares a variant with the robust filter in one quantity of one case.

    It has two values of two digits: with the filter and with the variant. The case ends with a flaw, such as
    "ring, .3 flawed, overconfident".
    """
    rows = [*read_rows(STUDY), *read_rows(VARIANT_STUDY)]
    shown_rows = cells_of_page("<!-- variants -->\n")
    assert {variant for variant, *_ in shown_rows} == set(VARIANTS)

    for variant, case_and_flaw, quantity, value_of_filter, value_of_variant in shown_rows:
        case, flaw = case_and_flaw.rsplit(", ", maxsplit=1)
        [row_of_filter] = rows_with(rows, case=case, flaw=flaw, filter="robust")
        [row_of_variant] = rows_with(rows, case=case, flaw=flaw, filter=variant)
        column = COLUMN_OF_QUANTITY[quantity]
        assert value_of_filter == f"{float(row_of_filter[column]):.2g}"
        assert value_of_variant == f"{float(row_of_variant[column]):.2g}"
