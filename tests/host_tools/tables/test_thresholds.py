"""T-tables: every entry against SciPy's quantiles, and the figures of docs/internals/t_tables.md."""

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
from support import ROOT, cells_of_line, section_of

SHIPPED = [("0.05", 127), ("0.05", 30)]
EDGES = [("0.9", 127), ("0.9", 2), ("0.000000001", 127), ("0.5", 3)]
"""Omegas and numbers of neighbours q of tables."""


def limit_in_spreads(omega: float, m: int) -> float:
    """Return t/sqrt(m) + 1 of eq. 12, in double precision with SciPy's quantile t.

    An estimate that is farther than so many spreads from the mean of m others is rejected.
    """
    return float(scipy.stats.t.isf((1 - omega) / 2, m - 1)) / math.sqrt(m) + 1


def wrongly_rounded_entries(table: Table, omega: Decimal) -> list[int]:
    """Return the indices of entries that are not k_m rounded to nearest.

    SciPy's doubles are good for 10**-5 of an entry's unit.
    """
    thresholds = [threshold(limit_in_spreads(float(omega), m), m) for m in range(2, table.q + 1)]
    # The last entry, for more than q messages, has a normal quantile in place of t.
    normal_quantile = float(scipy.stats.norm.isf((1 - float(omega)) / 2))
    thresholds.append(threshold(normal_quantile / math.sqrt(table.q + 1) + 1, table.q + 1))
    expected_entries = np.array(thresholds) * 2**FRACTION_BITS
    return np.flatnonzero(abs(expected_entries - table.entries) > 0.5 + 1e-5).tolist()


def threshold(limit: float, m: int) -> float:
    """Return k_m for m messages. ``limit`` is the limit of eq. 12 as a number of spreads."""
    return limit**2 * m / (m - 1)


# --- The generator ------------------------------------------------------------------------------------


# design: R27
@pytest.mark.parametrize(("omega", "q"), [*SHIPPED, *EDGES])
def test_every_threshold_of_a_table_is_the_nearest_to_the_exact_one(omega: str, q: int) -> None:
    """SciPy computes the exact one, and the table has it rounded to an integer.

    Among the tables are those of the largest omega, 0.9, whose first entry needs all 32 bits, and of the
    smallest one.
    """
    table = generate(Decimal(omega), q)
    assert table.q == q
    assert wrongly_rounded_entries(table, Decimal(omega)) == []


@pytest.mark.parametrize(("omega", "q"), [*SHIPPED, *EDGES])
def test_a_generated_table_is_read_from_its_words_as_the_same_table(omega: str, q: int) -> None:
    """Reading checks all that the firmware checks: the length, the order of thresholds and the checksum."""
    table = generate(Decimal(omega), q)
    table_from_words = Table.from_words(table.words())
    assert table_from_words == table


def test_a_table_has_omega_in_units_of_2_to_the_minus_32_rounded_to_nearest() -> None:
    """A robot shows by this word which omega its table is for."""
    table = generate(Decimal("0.05"), q=2)
    omega_in_units = Fraction("0.05") * 2**32  # exact
    assert table.omega_word == round(omega_in_units)


@pytest.mark.slow
@settings(max_examples=24)
@given(st.integers(1000, 900_000_000), st.integers(2, 127))
def test_every_threshold_of_any_table_is_the_nearest_to_the_exact_one(billionths: int, q: int) -> None:
    """Omega is 10**-6 or more: for smaller ones SciPy's quantiles are too coarse to judge a table."""
    omega = Decimal(billionths) / 10**9
    assert wrongly_rounded_entries(generate(omega, q), omega) == []


def relative_error(table: Table, omega: str, m: int) -> float:
    """Return the relative error of a table's threshold for m messages, against the threshold of eq. 12.

    A table has k_m, the square of eq. 12's t/sqrt(m) + 1 times m / (m - 1), in units of 2**-FRACTION_BITS.
    """
    k_m = table.entry(m) / 2**FRACTION_BITS
    multiple_of_table = math.sqrt(k_m * (m - 1) / m)
    return abs(multiple_of_table / limit_in_spreads(float(omega), m) - 1)


@pytest.mark.parametrize(("omega", "q"), [*SHIPPED, ("0.9", 2), ("0.5", 100), ("0.05", 126)])
def test_the_errors_that_a_table_states_are_those_of_its_worst_thresholds(omega: str, q: int) -> None:
    """``mcp-asdf table`` prints them. For 2 to q messages the table has an entry of its own.

    More messages have the threshold of the last entry. A robot hears at most 127 others.
    """
    table = generate(Decimal(omega), q)
    stated_errors = worst_threshold_error(Decimal(omega), table)

    worst_error_up_to_q = max(relative_error(table, omega, m) for m in range(2, q + 1))
    # SciPy is not exact enough for more than the size of so small an error.
    assert stated_errors.rounding == pytest.approx(worst_error_up_to_q, rel=0.02, abs=1e-14)

    errors_beyond_q = [relative_error(table, omega, m) for m in range(q + 1, 128)]
    worst_error_beyond_q = max(errors_beyond_q, default=0.0)  # there are none if q is 127
    # It may be stated as up to a hundredth of itself larger, and not as smaller but for SciPy's error.
    assert stated_errors.beyond_q <= worst_error_beyond_q * 1.01
    assert stated_errors.beyond_q >= worst_error_beyond_q * (1 - 1e-9)


@pytest.mark.parametrize("text", ["0.05", "0.050", ".05", "5e-2", " +0.05 ", "0.05000000000000000000000000"])
def test_omega_is_the_same_in_any_spelling(text: str) -> None:
    """The text is one of several spellings of 0.05, such as ".05" and "5e-2"."""
    assert str(parse_omega(text)) == "0.05"


def smallest_largest_and_random_omegas() -> list[Decimal]:
    """Return the smallest and largest omegas of 9 places, and 200 more, drawn with a fixed seed."""
    source = random.Random(4)
    billionths = [1, 2, 899_999_999, 900_000_000, *(source.randint(1, 900_000_000) for _ in range(200))]
    return [Decimal(number) / 10**9 for number in billionths]


def test_an_omega_is_found_again_from_the_word_that_a_table_stores_of_it() -> None:
    """Omega has at most nine decimal places, and the word is in units of 2**-32, which are finer."""
    for omega in smallest_largest_and_random_omegas():
        word = omega_word(omega)
        assert omega_from_word(word) == omega


def test_a_word_next_to_that_of_an_omega_has_no_omega_or_the_next_with_nine_decimal_places() -> None:
    """A table stores omega in units of 2**-32. Neighbouring omegas are four or five units apart."""
    for omega in smallest_largest_and_random_omegas():
        word = omega_word(omega)
        next_lower_omega = omega - Decimal("1e-9")
        next_higher_omega = omega + Decimal("1e-9")
        assert omega_from_word(word - 1) in (None, next_lower_omega)
        assert omega_from_word(word + 1) in (None, next_higher_omega)


@pytest.mark.parametrize("word", [0, 1, round(Decimal("0.900000001") * 2**32), 2**32 - 1])
def test_a_word_to_which_no_omega_is_rounded_has_no_omega(word: int) -> None:
    """A table stores omega in units of 2**-32.

    Omega is above 0, at most 0.9 and has at most nine decimal places.
    """
    assert omega_from_word(word) is None


# --- The page -----------------------------------------------------------------------------------------


def page_rows(heading: str) -> list[dict[str, str]]:
    """Return the rows of the first table below a heading of the page, each as cells by column."""
    section = section_of(ROOT / "docs/internals/t_tables.md", heading)
    first_table = re.search(r"(?:^\|.*\n)+", section, re.MULTILINE)
    assert first_table is not None
    titles, _ruler, *rows = [cells_of_line(line) for line in first_table[0].splitlines()]
    return [dict(zip(titles, row, strict=True)) for row in rows]


def test_the_page_t_tables_has_the_thresholds_that_scipy_computes() -> None:
    """Its table "Choosing omega" has a row for each number of messages m, and a column for each omega.

    A row is a dictionary by the heads of the columns: "m", "omega 0.05" and so on.
    """
    for row in page_rows("Choosing omega"):
        m = int(row.pop("m"))
        for column, cell in row.items():
            omega = float(column.removeprefix("omega "))
            assert cell == f"{limit_in_spreads(omega, m):.4f}"


def test_the_page_t_tables_says_how_much_too_high_the_last_threshold_of_a_short_table_is() -> None:
    """A short table with q entries has a row; more than q messages have the last threshold.

    The row is a dictionary by the heads of the columns: "q", "omega 0.05" and so on.
    """
    for row in page_rows("What a shorter table costs"):
        q = int(row.pop("q"))
        for column, cell in row.items():
            omega = Decimal(column.removeprefix("omega "))
            errors = worst_threshold_error(omega, generate(omega, q))
            assert cell == f"{errors.beyond_q:.2%}"


with_each_choice = pytest.mark.parametrize(
    "row",
    page_rows("What a choice means for one test"),
    ids=lambda row: f"omega {row['omega']}, m {row['m']}",
)


@with_each_choice
def test_the_page_t_tables_has_how_often_an_estimate_of_the_same_kind_is_rejected(
    row: dict[str, str],
) -> None:
    """The robot has m estimates, and the tested one is one more with the same mean and spread.

    Its difference from their mean, over their spread, has Student's t distribution times sqrt(1 + 1/m).
    """
    m = int(row["m"])
    omega = float(row["omega"])
    limit_of_t = limit_in_spreads(omega, m) / math.sqrt(1 + 1 / m)
    rate_of_too_high = scipy.stats.t.sf(limit_of_t, df=m - 1)
    rate_of_too_low = rate_of_too_high  # the distribution is symmetric
    assert row["one of them"] == f"{rate_of_too_high + rate_of_too_low:.1%}"


@with_each_choice
def test_the_page_t_tables_has_how_often_an_estimate_at_a_distance_is_rejected(row: dict[str, str]) -> None:
    """Its difference from the mean of m estimates, over their spread, is multiplied by sqrt(m).

    The product has a noncentral t distribution. The row has columns for distances of some standard
    deviations, such as "2 sigma".
    """
    m = int(row["m"])
    omega = float(row["omega"])
    limit_of_t = limit_in_spreads(omega, m) * math.sqrt(m)
    columns_of_distances = [column for column in row if column.endswith(" sigma")]
    assert len(columns_of_distances) > 1
    for column in columns_of_distances:
        distance = float(Fraction(column.removesuffix(" sigma")))
        noncentrality = distance * math.sqrt(m)
        rate_of_too_high = scipy.stats.nct.sf(limit_of_t, df=m - 1, nc=noncentrality)
        rate_of_too_low = scipy.stats.nct.sf(limit_of_t, df=m - 1, nc=-noncentrality)
        assert row[column] == f"{rate_of_too_high + rate_of_too_low:.1%}"
