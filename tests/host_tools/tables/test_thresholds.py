"""T-tables: every entry against SciPy's quantiles, and the figures of docs/tables.md."""

from __future__ import annotations

import math
import random
import re
from decimal import Decimal
from fractions import Fraction

import numpy as np
import pytest
import scipy.stats  # type: ignore[import-untyped]
from hypothesis import given, settings
from hypothesis import strategies as st

from mcp_asdf.table import FRACTION_BITS, Table
from mcp_asdf_tools.tables.thresholds import (
    generate,
    omega_from_word,
    omega_word,
    parse_omega,
    worst_threshold_error,
)
from support import ROOT

SHIPPED = [("0.05", 127), ("0.05", 30)]
EDGES = [("0.9", 127), ("0.9", 2), ("0.000000001", 127), ("0.000000001", 2), ("0.5", 3), ("0.2", 126)]


def eq_12_multiple(omega: float, m: int) -> float:
    """t/sqrt(m) + 1 in double precision by scipy."""
    return float(scipy.stats.t.isf((1 - omega) / 2, m - 1)) / math.sqrt(m) + 1


def wrong_entries(table: Table, omega: Decimal) -> list[int]:
    """Indices of the entries that are not k_m rounded to nearest; doubles are good for 10**-5 of a unit."""
    multiples = [eq_12_multiple(float(omega), m) for m in range(2, table.q + 1)]
    m = table.q + 1
    multiples.append(float(scipy.stats.norm.isf((1 - float(omega)) / 2)) / math.sqrt(m) + 1)
    k = np.square(multiples) * [m / (m - 1) for m in range(2, table.q + 2)] * 2**FRACTION_BITS
    return np.flatnonzero(abs(k - table.entries) > 0.5 + 1e-5).tolist()


# --- The generator ------------------------------------------------------------------------------------


# design: R27
@pytest.mark.parametrize(("omega", "q"), [*SHIPPED, *EDGES])
def test_every_entry_is_correctly_rounded(omega: str, q: int) -> None:
    """The firmware takes the table, too; omega 0.9 needs all 32 bits of its first entry."""
    table = generate(Decimal(omega), q)
    assert table.q == q
    assert wrong_entries(table, Decimal(omega)) == []
    assert Table.from_words(table.words()) == table
    assert table.omega_word == int(Decimal(omega) * 2**32 + Decimal("0.5"))


@pytest.mark.slow
@settings(max_examples=24)
@given(st.integers(1000, 900_000_000), st.integers(2, 127))
def test_every_entry_of_any_table_is_correctly_rounded(billionths: int, q: int) -> None:
    """SciPy's quantiles are too coarse to judge the smallest omega, which are next to the median."""
    omega = Decimal(billionths).scaleb(-9)
    assert wrong_entries(generate(omega, q), omega) == []


@pytest.mark.parametrize(("omega", "q"), [*SHIPPED, ("0.9", 2), ("0.5", 100), ("0.05", 126)])
def test_the_stated_error_is_the_worst_of_all_thresholds(omega: str, q: int) -> None:
    table = generate(Decimal(omega), q)
    stated = worst_threshold_error(Decimal(omega), table)
    used = {m: math.sqrt(table.entry(m) / 2**FRACTION_BITS * (m - 1) / m) for m in range(2, 128)}
    errors = [abs(used[m] / eq_12_multiple(float(omega), m) - 1) for m in range(2, 128)]
    beyond = max(errors[q - 1 :], default=0.0)
    assert stated.rounding == pytest.approx(max(errors[: q - 1]), rel=0.02, abs=1e-14)
    assert beyond * (1 - 1e-9) <= stated.beyond_q <= beyond * 1.01


@pytest.mark.parametrize("text", ["0.05", "0.050", ".05", "5e-2", " +0.05 ", "0.05000000000000000000000000"])
def test_one_omega_in_many_spellings(text: str) -> None:
    assert str(parse_omega(text)) == "0.05"


def test_an_omega_is_told_by_its_word() -> None:
    source = random.Random(4)
    for digits in [1, 2, 899_999_999, 900_000_000, *(source.randint(1, 900_000_000) for _ in range(2000))]:
        omega = Decimal(digits).scaleb(-9)
        word = omega_word(omega)
        assert omega_from_word(word) == omega, f"digits {digits}"
        for other in (word - 1, word + 1):
            assert omega_from_word(other) in (None, omega - Decimal("1e-9"), omega + Decimal("1e-9"))
    for word in (0, 1, round(Decimal("0.900000001") * 2**32), 2**32 - 1):
        assert omega_from_word(word) is None


# --- The page -----------------------------------------------------------------------------------------


def page_rows(heading: str) -> list[dict[str, str]]:
    """The rows of the first table below a heading of docs/tables.md, by column."""
    page = (ROOT / "docs" / "tables.md").read_text()
    below = page[page.index(f"## {heading}\n") :]
    lines = re.findall(r"(?:^\|.*\n)+", below, re.MULTILINE)[0].splitlines()
    titles, _, *rows = ([cell.strip() for cell in line.strip("|").split("|")] for line in lines)
    return [dict(zip(titles, row, strict=True)) for row in rows]


def test_the_thresholds_on_the_page() -> None:
    for row in page_rows("Choosing omega"):
        m = int(row.pop("m"))
        for title, cell in row.items():
            assert cell == f"{eq_12_multiple(float(title.removeprefix('omega ')), m):.4f}", (m, title)


def test_the_rejections_on_the_page() -> None:
    """The mean minus an estimate at a distance, over S, has a noncentral t distribution."""
    for row in page_rows("What a choice means for one test"):
        m, omega = int(row.pop("m")), float(row.pop("omega"))
        limit = eq_12_multiple(omega, m) * math.sqrt(m)
        same = 2 * scipy.stats.t.sf(limit / math.sqrt(m + 1), m - 1)  # both estimates vary
        assert row.pop("one of them") == f"{same:.1%}"
        for title, cell in row.items():
            away = float(Fraction(title.removesuffix(" sigma"))) * math.sqrt(m)
            share = sum(scipy.stats.nct.sf(limit, m - 1, each) for each in (away, -away))
            assert cell == f"{share:.1%}", (m, omega, title)
