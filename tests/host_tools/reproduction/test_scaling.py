"""The study of many robots: its command, its grid and its costs."""

from __future__ import annotations

import csv
from pathlib import Path

import pytest

from mcp_asdf_tools.cli.main import main
from mcp_asdf_tools.experiments.experiment_files import STUDIES, read_experiments
from mcp_asdf_tools.reproduction import resampling, robust, scaling

FILTERS = ("no filter", "robust")


@pytest.mark.slow
def test_the_command_writes_tables_and_picture(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    wrong = "fill_ratio = 0.95\ntrue_accuracy = 0.55\nflawed_accuracy = 0.95\n"
    text = f'topology = "dynamic"\nrobots = [3, 9]\nfilter = ["none", "robust"]\n[[grid]]\n[[grid]]\n{wrong}'
    (tmp_path / "scale.toml").write_text(text)
    monkeypatch.setattr(robust, "STUDIES", tmp_path)
    monkeypatch.setattr(resampling, "RESAMPLES", 50)
    monkeypatch.setattr(scaling, "_ROBOT_STEPS", 1000)
    options = ["--part", "scale", "--trials", "2", "--steps", "4000", "--workers", "1", "--quick"]
    assert main(["reproduce", *options, "--output", str(tmp_path / "out")]) == 0
    rows = list(csv.DictReader((tmp_path / "out/scale.csv").read_text().splitlines()))
    ways = ("underconfident", "overconfident")
    places = {(f"{robots} robots, {way}", each) for robots in (3, 9) for way in ways for each in FILTERS}
    for measure in ("H", "late", "cost"):
        assert {(row["row"], row["filter"]) for row in rows if row["measure"] == measure} == places
    page = (tmp_path / "out/scale.md").read_text()
    assert (
        page.startswith("# Many robots\n")
        and "H, error of the last quarter, ns" in page
        and "](scale.svg)" in page
    )
    assert (tmp_path / "out/scale.svg").read_bytes().startswith(b"<?xml")


def test_density_and_world_are_the_same_for_every_number_of_robots() -> None:
    experiments = read_experiments(STUDIES / "scale.toml")
    varied = {"robots": 0, "flawed": 0, "trials": 0}
    worlds = {tuple({**each.parameters(), **varied}.items()) for each in experiments}
    assert len(worlds) == 4 and len(experiments) == 24
    assert all(10 * each.flawed == 3 * each.robots for each in experiments)
