"""T-tables: every entry against an independent 60-digit oracle, and the figures of docs/tables.md.

The oracle shares nothing with the generator: it uses the ``decimal`` module and the closed finite
series of Student's distribution for whole degrees of freedom, and it inverts nothing. An entry e is
the rounding of k_m if and only if P(|T| < t) lies at or below omega for the t that belongs to e - 1/2 and
at or above it for e + 1/2.
"""

from __future__ import annotations

import math
import random
import re
from collections.abc import Callable
from decimal import Context, Decimal, localcontext
from fractions import Fraction
from functools import lru_cache, partial

import pytest
import scipy.stats  # type: ignore[import-untyped]
from hypothesis import given, settings
from hypothesis import strategies as st

from mcp_asdf.table import FRACTION_BITS, Table
from mcp_asdf_tools.common.errors import UsageError
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
PRECISION = Context(prec=60)


# --- The oracle ---------------------------------------------------------------------------------------


def arctangent(x: Decimal) -> Decimal:
    """Taylor's series after halving the angle four times."""
    for _ in range(4):
        x = x / (1 + (1 + x * x).sqrt())
    term, total, n = x, Decimal(0), 1
    while abs(term) > Decimal("1e-65"):
        total += term / n
        term, n = -term * x * x, n + 2
    return 16 * total


@lru_cache(maxsize=1)
def pi() -> Decimal:
    """Machin's formula."""
    return 16 * arctangent(Decimal(1) / 5) - 4 * arctangent(Decimal(1) / 239)


def student(t: Decimal, freedom: int) -> Decimal:
    """P(|T| < t) for t >= 0 by the finite series in cos(theta), tan(theta) = t / sqrt(freedom)."""
    cosine_squared = freedom / (freedom + t * t)
    sine = t / (freedom + t * t).sqrt()
    odd = freedom % 2
    term = cosine_squared.sqrt() if odd else Decimal(1)
    total = Decimal(0)
    for power in range(odd, freedom - 1, 2):
        total += term
        term *= cosine_squared * (power + 1) / (power + 2)
    if not odd:
        return sine * total
    return 2 / pi() * (arctangent(t / Decimal(freedom).sqrt()) + sine * total)


def gauss(t: Decimal) -> Decimal:
    """P(|Z| < t) by the all-positive series exp(-t^2/2) sum t^(2n+1) / (2n+1)!!."""
    term, total, n = t, Decimal(0), 1
    while term > Decimal("1e-65"):
        total += term
        n += 2
        term *= t * t / n
    return (2 / pi()).sqrt() * (-t * t / 2).exp() * total


def is_rounded(entry: int, m: int, omega: Decimal, probability: Callable[[Decimal], Decimal]) -> bool:
    """True if ``entry`` is k_m in units of 2**-26 to nearest; ``probability`` is that of (-t, t)."""

    def side(halves: int) -> Decimal:
        k = Decimal(halves) / 2**27
        t = Decimal(m).sqrt() * ((k * (m - 1) / m).sqrt() - 1)
        return probability(max(t, Decimal(0)))

    with localcontext(PRECISION):
        return side(2 * entry - 1) <= omega <= side(2 * entry + 1)


def wrong_entries(table: Table, omega: Decimal) -> list[int]:
    """Indices of the entries that are not correctly rounded."""
    last = table.q - 1
    wrong = [
        index
        for index, entry in enumerate(table.entries[:-1])
        if not is_rounded(entry, index + 2, omega, partial(student, freedom=index + 1))
    ]
    return wrong + ([] if is_rounded(table.entries[last], table.q + 1, omega, gauss) else [last])


@pytest.mark.parametrize(("omega", "q"), SHIPPED)
def test_the_oracle_refuses_a_neighbouring_entry(omega: str, q: int) -> None:
    table = generate(Decimal(omega), q)
    for index in (0, 1, q // 2, q - 2, q - 1):
        for error in (-1, 1):
            entries = list(table.entries)
            entries[index] += error
            wrong = Table(table.omega_word, tuple(entries))
            assert wrong_entries(wrong, Decimal(omega)) == [index]


# --- The generator ------------------------------------------------------------------------------------


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
@given(st.integers(1, 900_000_000), st.integers(2, 127))
def test_every_entry_of_any_table_is_correctly_rounded(billionths: int, q: int) -> None:
    omega = Decimal(billionths).scaleb(-9)
    assert wrong_entries(generate(omega, q), omega) == []


def eq_12_multiple(omega: float, m: int) -> float:
    """t/sqrt(m) + 1 in double precision by scipy."""
    return float(scipy.stats.t.isf((1 - omega) / 2, m - 1)) / math.sqrt(m) + 1


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


@pytest.mark.parametrize(("omega", "q"), [("0.95", 30), ("0.05", 1), ("0.05", 128)])
def test_a_table_that_no_firmware_takes_is_not_made(omega: str, q: int) -> None:
    with pytest.raises(UsageError, match="must be"):
        generate(Decimal(omega), q)


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
            multiple = eq_12_multiple(float(title.removeprefix("omega ")), m)
            assert cell == f"{multiple:.4f} / {multiple**2 * m / (m - 1):.4f}", (m, title)


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


def test_the_costs_on_the_page() -> None:
    for row in page_rows("Choosing q"):
        q = int(row.pop("q"))
        assert row.pop("bytes") == str(4 * len(generate(Decimal("0.05"), q).words()))
        for title, cell in row.items():
            omega = Decimal(title.removeprefix("omega "))
            assert cell == f"{worst_threshold_error(omega, generate(omega, q)).beyond_q:.2%}"
