"""The figures of docs/threats.md are those of the runs that it names."""

from __future__ import annotations

import json
import re
from statistics import fmean

import pytest

from mcp_asdf_tools.cli.main import main
from support import ROOT

PAGE = ROOT / "docs/threats.md"
FIGURES = re.compile(r"error (\d\.\d+), flawed (\d\.\d+), sound (\d\.\d+)")
QUICK = 2
"""Rows for every run of the tests: none, and the liar that takes all; the others are for ``make verify``."""


def rows() -> list[tuple[tuple[str, ...], str]]:
    """Faults of each measured row of the table, and its figures."""
    found = []
    for line in PAGE.read_text(encoding="utf-8").splitlines():
        measured = FIGURES.search(line)
        if line.startswith("|") and measured:
            faults = re.findall(r"`(\w+,robots=[^`]*)`", line.split("|")[1])
            found.append((tuple(faults), measured.group()))
    assert len(found) == 12 and found[0][0] == ()
    return found


ROWS = [
    pytest.param(*row, marks=[pytest.mark.slow] if place >= QUICK else [], id=" ".join(row[0]) or "none")
    for place, row in enumerate(rows())
]


@pytest.mark.parametrize(("faults", "figures"), ROWS)
def test_the_table_says_what_happens(
    faults: tuple[str, ...], figures: str, capsys: pytest.CaptureFixture[str]
) -> None:
    options = ["--steps", "500", "--filter-period", "100", "--json"]
    assert main(["swarm", *options, *(f"--fault={fault}" for fault in faults)]) == 0
    robots = [each for each in json.loads(capsys.readouterr().out)["results"]["robots"] if each["id"] != 6]
    error = fmean(abs(each["x"] - 0.55) for each in robots)
    flawed = fmean(each["b_hat"] for each in robots if each["id"] < 6)
    sound = fmean(each["b_hat"] for each in robots if each["id"] > 6)
    assert f"error {error:.3f}, flawed {flawed:.3f}, sound {sound:.3f}" == figures
