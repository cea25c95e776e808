"""The study of sensors that age: its command, its rows; and robots that know their sensors."""

from __future__ import annotations

import csv
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from mcp_asdf_tools.cli.main import main
from mcp_asdf_tools.common import extensions
from mcp_asdf_tools.experiments.experiment import grid
from mcp_asdf_tools.experiments.experiment_files import STUDIES, read_experiments
from mcp_asdf_tools.experiments.trials import run_trials
from mcp_asdf_tools.reproduction import ageing, resampling, robust
from support import ROOT


def test_the_command_writes_table_and_picture(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    drifts = '[[grid]]\n[[grid]]\ndrift = "linear"\ndrift_rate = -1e-5\n'
    text = f'robots = 4\nsteps = 4000\nmemory = [2147483648, 4096]\nfilter = ["none", "robust"]\n{drifts}'
    (tmp_path / "ageing.toml").write_text(text)
    monkeypatch.setattr(robust, "STUDIES", tmp_path)
    monkeypatch.setattr(resampling, "RESAMPLES", 50)
    options = ["--part", "ageing", "--trials", "2", "--workers", "1", "--seed", "9"]
    assert main(["reproduce", *options, "--output", str(tmp_path / "out")]) == 0
    rows = list(csv.DictReader((tmp_path / "out/ageing.csv").read_text().splitlines()))
    ways, memories = ("none ages", "all age alike"), ("longest", "short")
    kinds = [f"{way}, {memory} memory" for way in ways for memory in memories]
    assert list(dict.fromkeys(row["row"] for row in rows)) == kinds
    table = (tmp_path / "out/ageing.md").read_text()
    assert all(f"| {kind} | 0." in table for kind in kinds) and "![Sensors that age](ageing.svg)" in table
    assert (tmp_path / "out/ageing.svg").read_bytes().startswith(b"<?xml")


def test_each_way_to_age_has_a_row_of_its_own() -> None:
    experiments = read_experiments(STUDIES / "ageing.toml")
    rows = {ageing.row_of(each) for each in experiments}
    assert len(rows) == 12 and len({(ageing.row_of(each), each.filter) for each in experiments}) == 38
    assert len(experiments) == 3 * 38  # fill ratios


@pytest.fixture
def peers(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """The extensions of tests/peers, found by this process."""
    monkeypatch.syspath_prepend(str(ROOT / "tests/peers"))
    extensions._points.cache_clear()
    yield
    extensions._points.cache_clear()


def late_error(**changes: Any) -> float:
    """The error at the end of a short trial in which all sensors lose 0.4 alike."""
    world: dict[str, Any] = {"steps": 4000, "drift": "linear", "drift_rate": -1e-4, "fill_ratio": 0.75}
    robots: dict[str, Any] = {"robots": 10, "flawed": 0, "sensor": "known", "filter": "none"}
    (experiment,) = grid(seed=7, trials=1, **world | robots | changes)
    return float(abs(run_trials(experiment, 0, 1, 100).records["x"][0, -5:] - 0.75).mean())


@pytest.mark.slow
@pytest.mark.usefixtures("peers")
def test_only_who_knows_how_accurate_the_counted_observations_were_is_right() -> None:
    plain, oracle, mean = (late_error(firmware=each) for each in ("reference", "oracle", "mean-accuracy"))
    assert mean < 0.03 and min(plain, oracle) > 0.06
    assert late_error(firmware="mean-accuracy", memory=1024) < 0.03
    ageing_peer = late_error(firmware="ageing-bayescpf", filter="asdf-plus")
    assert ageing_peer != late_error(firmware="bayescpf", filter="asdf-plus")
