"""The committed golden vectors are what the mirror gives, and its faults change them."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from mcp_asdf import mirror
from mcp_asdf.fixed_point import ONE
from mcp_asdf_tools.crosscheck.scenario import TableChoice, build_table
from targets.golden_scenarios import edge_scenarios, run_scenarios
from targets.golden_vectors import digest, explain, main, outcomes

HERE = Path(__file__).parent
SCENARIOS = edge_scenarios() + run_scenarios()


@pytest.mark.slow
def test_the_committed_files_are_what_the_mirror_gives() -> None:
    assert main(["--check", str(HERE)]) == 0


LONGER = build_table(TableChoice("0.05", 31))
"""A table with an entry of its own for 31 messages."""


@cache
def digests_of_edges() -> list[int]:
    """Those of the right mirror, as the tests that change it begin with it."""
    return [digest(scenario) for scenario in edge_scenarios()]


@pytest.mark.parametrize(
    ("name", "fault"),
    [
        ("alpha_word", lambda f: lambda mantissa, exponent: f(mantissa | 1, exponent)),
        ("sums_add", lambda f: lambda s, x, word: f(s, x, word + 0x100 if word & 0xE0 else word)),
        ("sums_add", lambda f: lambda s, x, word: f(s, x, word if word >> 8 else 0x100 | word)),
        ("sums_add", lambda f: lambda s, x, word: f(s, x, word ^ 1 if word >> 8 == 3 else word)),
        ("informed_estimate", lambda f: lambda s, x, own: f(s, x, own) - (s.alpha + own >= 1 << 61)),
        ("confidence_inside", lambda f: lambda a, t, r, scale, s: f(a, t, r, scale - 512, s)),
        ("confidence_at_end", lambda f: lambda a, t, part: f(a, t, part - part // 99)),
        ("square_of_ratio", lambda f: lambda g, p: f(g, p) + (p == 1 << 31)),
        ("upper_quotient", lambda f: lambda a, d: f(a, d) + (a.bit_length() > 54)),
        ("reestimate", lambda f: lambda t, n, s: f(t, n, s) or 1 << 31),
        ("rejects", lambda f: lambda table, s, x: f(table, s, x + (s.count == 127))),
        ("rejects", lambda f: lambda table, s, x: f(table, s, x) or s.count * x == s.x),
        ("rejects", lambda f: lambda table, s, x: f(LONGER if s.count == 31 else table, s, x)),
        ("estimate", lambda f: lambda t, n, a: (f(t, n, a)[0] ^ (t > 0x7FFFFF00), f(t, n, a)[1])),
        ("sums_possible", lambda f: lambda s: f(s) or s.x_squared == s.x * ONE + 1),
        ("sums_possible", lambda f: lambda s: f(s) and s.count * s.x_squared != s.x * s.x),
        ("estimate_possible", lambda f: lambda s: f(s) or s.updated == 2),
        ("estimate_possible", lambda f: lambda s: f(s) and not s.updated),
    ],
)
def test_small_faults_change_a_digest(
    name: str, fault: Callable[[Any], Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    expected = digests_of_edges()
    monkeypatch.setattr(mirror, name, fault(getattr(mirror, name)))
    assert any(digest(each) != right for each, right in zip(edge_scenarios(), expected, strict=True))


# ---- Telling what differed ----


def printed(number: int, change: int | None, field: str = "state") -> str:
    """Output of a target that gets the call ``change`` of a scenario wrong, and all that follow."""
    lines = [f"scenario {number} expected 1 found 2"]
    for index, (_, outcome) in enumerate(outcomes(SCENARIOS[number])):
        values = {"status": outcome.status, "x": outcome.x, "x_bar": outcome.x_bar, "state": outcome.state}
        if change is not None and index >= change:
            values[field] ^= 1
        lines.append(f"call {index} " + " ".join(f"{name} {value}" for name, value in values.items()))
    return "\n".join([*lines, "FAIL"])


@pytest.mark.parametrize("field", ["status", "x", "x_bar", "state"])
@pytest.mark.parametrize(("number", "change"), [(0, 0), (0, 3), (42, 5), (108, 30)])
def test_the_first_difference_is_named(number: int, change: int, field: str) -> None:
    told = explain(printed(number, change, field), SCENARIOS)
    what, _ = list(outcomes(SCENARIOS[number]))[change]
    assert told.startswith(f"scenario {number} ({SCENARIOS[number].name}), call {change}, {what}:")
