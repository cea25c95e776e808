"""The figures of docs/advice.md are what its two sweeps give."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import mcp_asdf_tools as m
from support import ROOT, blocks

PAGE = ROOT / "docs/advice.md"
FILTERS = ("none", "asdf-minus", "asdf-plus")
Row = dict[str, object]


def cell(trials: list[Row]) -> str:
    """Median score, median error, and the error that one trial in ten exceeds."""
    errors = [float(np.mean(np.asarray(trial["e"]))) for trial in trials]
    score = float(np.median([float(str(trial["H"])) for trial in trials]))
    return f"{score:.0f}, {np.median(errors):.3f} ({np.quantile(errors, 0.9):.3f})"


def cells(rows: list[Row], **chosen: object) -> str:
    """One line's cells: a column for each filter that the rows have."""
    fitting = [row for row in rows if all(row[name] == value for name, value in chosen.items())]
    columns = ([row for row in fitting if row["filter"] == name] for name in FILTERS)
    return " | ".join(cell(trials) for trials in columns if trials)


def cases(rows: list[Row]) -> list[str]:
    """The lines of the first table."""
    names = {0.55: "underconfident", 0.95: "overconfident"}
    return [
        f"| {topology} | {names[accuracy]} | {flawed * 5} % | "
        f"{cells(rows, topology=topology, flawed_accuracy=accuracy, flawed=flawed)} |"
        for topology in ("dynamic", "fully-connected")
        for accuracy in names
        for flawed in (0, 2, 6, 10)
    ]


def knobs(rows: list[Row]) -> list[str]:
    """The lines of the second table. Where no robot is flawed ASDF- has none that filters."""
    usual = {"filter_period": 1000, "omega": 0.05, "density": 1.0}
    changes: list[tuple[str, float]] = [("filter_period", period) for period in (100, 1000, 4000)]
    changes += [("omega", omega) for omega in (0.25, 0.9)] + [("density", density) for density in (0.25, 4.0)]
    lines = []
    for name, value in changes:
        part = [row for row in rows if all(row[key] == v for key, v in (usual | {name: value}).items())]
        helped = cells([r for r in part if r["filter"] != "none"], flawed=6)
        healthy = cells([r for r in part if r["filter"] == "asdf-plus"], flawed=0)
        lines.append(f"| {name} {value} | {helped} | {healthy} |")
    return lines


@pytest.mark.slow
@pytest.mark.parametrize(("number", "lines"), [(0, cases), (1, knobs)])
def test_the_figures_are_those_of_the_sweep(
    number: int, lines: Callable[[list[Row]], list[str]], tmp_path: Path
) -> None:
    page, file = PAGE.read_text(encoding="utf-8"), tmp_path / "advice.toml"
    file.write_text(blocks(PAGE, "toml")[number])
    for line in lines(m.simulate(m.read_experiments(file)).to_pylist()):
        assert line in page, line


def test_the_defaults_are_the_advice() -> None:
    """Of a robot's configuration in C, and of the tools'."""
    header = (ROOT / "c_ref/src/mcp_asdf.h").read_text(encoding="utf-8")
    assert re.search(
        r"MCP_ASDF_CONFIG\(t_table\) \{\(t_table\), 1000, MCP_ASDF_MEMORY_MAX, MCP_ASDF_ADAPTIVE\}", header
    )
    default = m.Experiment()
    assert (default.filter_period, float(default.omega), default.memory) == (1000, 0.05, 2**31)
