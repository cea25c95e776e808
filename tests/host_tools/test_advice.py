"""Some figures of docs/advice.md are what the experiments give."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest

import mcp_asdf_tools as m
from support import ROOT

DYNAMIC = {"steps": 40_000, "trials": 200, "topology": "dynamic", "fill_ratio": 0.55, "flawed_accuracy": 0.55}
CONNECTED = {
    "steps": 40_000,
    "trials": 200,
    "fill_ratio": 0.95,
    "true_accuracy": 0.55,
    "flawed_accuracy": 0.95,
}
SOME: list[tuple[str, dict[str, Any]]] = [
    ("dynamic | underconfident | 50 % | {none} | {minus} | {robust} |", DYNAMIC | {"flawed": "50%"}),
    ("fully-connected | overconfident | 10 % | {none} | {minus} | {robust} |", CONNECTED | {"flawed": "10%"}),
    (
        "| filter_period 100 | {none} | {minus} | {robust} |",
        DYNAMIC | {"flawed": "30%", "filter_period": 100},
    ),
    ("| density 4.0 | {none} | {minus} | {robust} |", DYNAMIC | {"flawed": "30%", "density": 4.0}),
]


def cell(trials: list[dict[str, Any]]) -> str:
    """Median score, median error, and the error that one trial in ten exceeds."""
    errors = [np.mean(trial["e"]) for trial in trials]
    score = np.median([trial["H"] for trial in trials])
    return f"{score:.0f}, {np.median(errors):.3f} ({np.quantile(errors, 0.9):.3f})"


@pytest.mark.slow
@pytest.mark.parametrize(("line", "given"), SOME)
def test_some_figures_are_those_of_the_sweeps(line: str, given: dict[str, Any]) -> None:
    filters = {"none": "none", "minus": "asdf-minus", "robust": "robust"}
    cells = {name: cell(m.simulate(m.grid(**given, filter=f)).to_pylist()) for name, f in filters.items()}
    assert line.format(**cells) in (ROOT / "docs/advice.md").read_text(encoding="utf-8")


def test_the_page_on_the_method_has_the_figures_of_the_advice() -> None:
    advice, method = ((ROOT / f"docs/{page}.md").read_text(encoding="utf-8") for page in ("advice", "method"))
    row = r"\| dynamic \| underconfident \| 30 % \| \d+, ([\d.]+) \([\d.]+\) \| \d+, ([\d.]+) "
    found = re.search(row, advice)
    assert found is not None
    without_filter, with_filter = found.groups()
    assert f"moving swarm is {without_filter}; if they filter, {with_filter} " in method


def test_the_defaults_are_the_advice() -> None:
    """The tools have them, and so have all configurations of robots in C."""
    header = (ROOT / "c_ref/src/mcp_asdf.h").read_text(encoding="utf-8")
    configurations = re.findall(r"#define MCP_ASDF_CONFIG_(\w+)\S* \{(.*)\}", header)
    assert configurations == [
        ("ROBUST", "NULL, 1000, MCP_ASDF_MEMORY_MAX, MCP_ASDF_ROBUST"),
        ("ASDF", "(t_table), 1000, MCP_ASDF_MEMORY_MAX, MCP_ASDF_ADAPTIVE"),
        ("OFF", "NULL, 1000, MCP_ASDF_MEMORY_MAX, MCP_ASDF_OFF"),
    ]
    default = m.Experiment()
    assert (default.filter_period, float(default.omega), default.memory) == (1000, 0.05, 2**31)
