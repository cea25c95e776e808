"""Some figures behind docs/advice.md are what the experiments give."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest

from mcp_asdf_tools import Experiment, grid, simulate
from support import ROOT

FIGURES = ROOT / "docs/internals/filters.csv"
DYNAMIC = {"steps": 40_000, "trials": 200, "topology": "dynamic", "fill_ratio": 0.55, "flawed_accuracy": 0.55}
OVERCONFIDENT = {"true_accuracy": 0.55, "flawed_accuracy": 0.95}
CONNECTED = {"steps": 40_000, "trials": 200, "fill_ratio": 0.95} | OVERCONFIDENT
CASES = [
    ("dynamic,underconfident,30%,density=0.25", "asdf-minus", DYNAMIC | {"flawed": "30%", "density": 0.25}),
    (
        "dynamic,underconfident,30%,filter_period=100",
        "robust",
        DYNAMIC | {"flawed": "30%", "filter_period": 100},
    ),
    ("fully-connected,overconfident,10%,", "robust", CONNECTED | {"flawed": "10%"}),
    ("fully-connected,overconfident,30%,", "none", CONNECTED | {"flawed": "30%"}),
]
"""Beginnings of rows of the figures, each with a filter and the parameters of the row's experiment."""


def row_end(trials: list[dict[str, Any]]) -> str:
    """Return median score, median error, and the error that one trial in ten exceeds, as a row has them."""
    errors = [np.mean(trial["e"]) for trial in trials]
    median_score = np.median([trial["H"] for trial in trials])
    return f"{median_score:.0f},{np.median(errors):.3f},{np.quantile(errors, 0.9):.3f}"


@pytest.mark.slow
@pytest.mark.parametrize(("case", "filter_name", "parameters"), CASES)
def test_rows_of_the_figures_behind_the_advice_are_what_their_experiments_give(
    case: str, filter_name: str, parameters: dict[str, Any]
) -> None:
    """A row of docs/internals/filters.csv is a case, as "dynamic,underconfident,50%,", and its results."""
    published_rows = FIGURES.read_text(encoding="utf-8").splitlines()
    trials = simulate(grid(**parameters, filter=filter_name)).to_pylist()
    assert f"{case},{filter_name},{row_end(trials)}" in published_rows


def test_the_defaults_of_the_tools_are_those_that_the_documentation_advises() -> None:
    """docs/advice.md advises 1000 steps from filter to filter, an omega of 5 %, and the largest memory."""
    default = Experiment()
    assert default.filter_period == 1000
    assert float(default.omega) == 0.05
    assert default.memory == 2**31


def test_the_default_configurations_in_c_are_those_that_the_documentation_advises() -> None:
    """Each macro has a table (or none), a filter period of 1000 steps, the largest memory, and a filter."""
    header = (ROOT / "c_ref/src/mcp_asdf.h").read_text(encoding="utf-8")
    configurations = re.findall(r"#define MCP_ASDF_CONFIG_(\w+)\S* \{(.*)\}", header)
    assert configurations == [
        ("ROBUST", "NULL, 1000, MCP_ASDF_MEMORY_MAX, MCP_ASDF_ROBUST"),
        ("ASDF", "(t_table), 1000, MCP_ASDF_MEMORY_MAX, MCP_ASDF_ADAPTIVE"),
        ("OFF", "NULL, 1000, MCP_ASDF_MEMORY_MAX, MCP_ASDF_OFF"),
    ]
