"""``mcp-asdf swarm --compare``: the difference that the filter makes, on the same seed."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mcp_asdf_tools.cli.main import main
from mcp_asdf_tools.experiments.engine import native
from mcp_asdf_tools.experiments.experiment import Experiment
from support import ROOT

SMALL = ["swarm", "--robots", "8", "--steps", "600", "--filter-period", "100", "--flawed", "50%"]


def test_the_other_run_is_the_same_swarm_without_a_filter(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A sentence says what the filter is good for, and the log is that of the run with it."""
    log = tmp_path / "run.log"
    assert main([*SMALL, "--set", "omega=0.1", "--compare", "--quiet", "--log", str(log)]) == 0
    said = capsys.readouterr().out.splitlines()[-1]
    assert main([*SMALL, "--filter", "none", "--json"]) == 0
    report = json.loads(Path(f"{log}.json").read_text())
    assert report["without_filter"] == json.loads(capsys.readouterr().out)["results"]
    assert report["results"]["updates"] > 0
    with_it, without = (report[name]["mean_error"] for name in ("results", "without_filter"))
    assert (
        f"With the filter the mean error is {with_it:.3f}; without it, on the same seed, {without:.3f}."
        in said
    )
    assert main(["replay", str(log)]) == 0


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        ("--filter none", "but filter is none; leave it out"),
        ("--processes --interface udp_multicast", "but robots elsewhere run once; leave it out"),
    ],
)
def test_what_cannot_be_compared_is_refused(
    options: str, reason: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*SMALL, *options.split(), "--compare"]) == 2
    assert reason in capsys.readouterr().err


def test_the_figures_of_the_readme_are_those_of_its_first_command() -> None:
    """Computed by the engine, since a swarm is trial 0 of the experiment with the same parameters."""
    common = Experiment(topology="dynamic", filter="asdf-minus", flawed="50%", trials=1)
    errors = []
    for experiment in (common, replace(common, filter="none")):
        x = native.run(experiment, 0, 1).x[0, :, -1] / 2**23
        errors.append(float(np.abs(x - experiment.fill_ratio).mean()))
    readme = " ".join((ROOT / "README.md").read_text(encoding="utf-8").split())
    assert f"is {errors[0]:.3f} at the end; without it, on the same seed, it is {errors[1]:.3f}." in readme
    options = "--topology dynamic --filter asdf-minus --flawed 50% --compare"
    assert f"mcp-asdf swarm {options}\n" in (ROOT / "Makefile").read_text(encoding="utf-8")
