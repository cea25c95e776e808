"""``mcp-asdf view``: recordings become pages, and what cannot be shown is refused in one line."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pyarrow as pa  # type: ignore[import-untyped]
import pytest

from mcp_asdf_tools.cli.main import main
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.results import table_of, write_table
from mcp_asdf_tools.experiments.trials import run_trials

SWARM = ["swarm", "--robots", "5", "--steps", "60", "--filter-period", "20", "--quiet"]


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two experiments of two trials."""
    common = Experiment(robots=5, steps=60, filter_period=20, trials=2)
    experiments = [common, replace(common, filter="none")]
    tables = [table_of(run_trials(each, 0, 2)) for each in experiments]
    path = tmp_path_factory.mktemp("results") / "grid.parquet"
    write_table(path, pa.concat_tables(tables))
    return path


def test_a_log_and_a_trial_are_exported(
    results: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log, target = tmp_path / "run.log", tmp_path / "run.html"
    assert main([*SWARM, "--log", str(log)]) == 0
    capsys.readouterr()
    chosen = ["--where", "filter=none", "--trial", "1"]
    for words, title in (([str(log)], "ASDF+"), ([str(results), *chosen], "no filter")):
        assert main(["view", *words, "--export", str(target), "--json"]) == 0
        report = json.loads(capsys.readouterr().out)
        assert report == {"export": str(target), "bytes": target.stat().st_size, "states": 61}
        assert f"5 robots, 2 flawed, {title}" in target.read_text()


def test_what_cannot_be_shown_is_refused(
    results: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log, html = tmp_path / "run.log", ["--export", str(tmp_path / "out.html")]
    assert main([*SWARM, "--log", str(log)]) == 0
    cases = {
        (): "give a recording, or with --interface the bus",
        ("--export", "x.html", "--interface", "udp_multicast"): "--export is for recordings",
        (str(tmp_path / "none.log"),): "there is no log",
        (str(tmp_path / "none.parquet"),): "cannot read",
        (str(results), *html): "2 experiments of",
        (str(results), "--where", "filter=both", *html): "no experiment of",
        (str(results), "--where", "colour=red", *html): "--where colour=red: write NAME=VALUE",
        (str(results), "--where", "filter=none", "--trial", "9", *html): "no trial 9; choose one of 0 to 1",
        (str(log), "--trial", "1", *html): "--trial and --where choose from results",
        (str(log), "--export", str(tmp_path / "out.pdf")): "choose a name that ends in .html",
        (str(log), "--port", "99999"): "--port is 99999",
        ("--subject", "9999", "--interface", "udp_multicast"): "subject is 9999",
    }
    for words, reason in cases.items():
        capsys.readouterr()
        assert main(["view", *words]) == 2, words
        out, err = capsys.readouterr()
        assert reason in err and not out, words
        assert err.count("\n") == 1
    assert not (tmp_path / "out.html").exists()


def test_choices_are_named(results: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["view", str(results)]) == 2
    assert "choose one with --where filter=asdf-plus|none" in capsys.readouterr().err
