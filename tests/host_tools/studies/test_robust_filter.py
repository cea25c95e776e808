"""The page of the robust filter, whose numbers another simulator computed, beside trials of the engine."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest

import mcp_asdf_tools as m
from host_tools.studies.conftest import page_path, parse_table
from mcp_asdf_tools.experiments.trials import run_trials
from mcp_asdf_tools.studies import study_program
from mcp_asdf_tools.studies.study_program import PARAMETERS_BY_FLAW


def late_error_on_page(flaw: str, column: str) -> float:
    """Return the late error that docs/internals/robust.md has for 30 % flawed robots in moving swarms."""
    page = page_path("robust").read_text(encoding="utf-8")
    [markdown] = re.findall(r"^\| case \| swarm \|.*?\n\n", page, re.DOTALL | re.MULTILINE)
    lines = markdown.splitlines()
    [row] = [line for line in lines if line.startswith(f"| moving, .3 flawed | {flaw} |")]
    table = parse_table("\n".join([*lines[:2], row]))
    [[_flaw, *errors]] = table.rows.values()
    return float(dict(zip(table.columns[1:], errors, strict=True))[column])


@pytest.mark.slow
@pytest.mark.parametrize("flaw", ["underconfident", "overconfident"])
@pytest.mark.parametrize(
    ("filter_name", "column"), [("none", "no filter"), ("asdf-minus", "ASDF-"), ("robust", "robust")]
)
def test_ten_trials_of_another_seed_give_about_the_errors_on_the_page_of_the_robust_filter(
    flaw: str, filter_name: str, column: str
) -> None:
    """The page has medians over 40 trials of moving swarms with 30 % flawed robots."""
    swarm: dict[str, Any] = {"topology": "dynamic", "latency": 1, "robots": 20, "flawed": 6}
    (experiment,) = m.grid(
        **swarm, **PARAMETERS_BY_FLAW[flaw], filter=filter_name, steps=40_000, trials=10, seed=5
    )
    trials = run_trials(experiment, first=0, trials=10, sampling_interval=1000)

    median_error = float(np.median(study_program.late_errors(trials)))

    # The median of so few trials may be half as large again, or half as large.
    assert median_error == pytest.approx(late_error_on_page(flaw, column), rel=0.5)
