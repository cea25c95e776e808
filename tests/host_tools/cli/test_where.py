"""Experiments chosen from a sweep by ``--where``, and a sweep that keeps values over time."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from mcp_asdf_tools.cli.main import main
from mcp_asdf_tools.experiments.results import experiments_in, read_table

GRID = """\
robots = 4
steps = 40
filter_period = 10
trials = 2
flawed = 2
filter = ["none", "asdf-plus"]
fill_ratio = [0.55, 0.95]
"""
ONE = "--where filter=none --where fill_ratio=.950 --where robots=4"


@pytest.fixture(scope="module")
def grid(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Results of four experiments, with values every 10 steps."""
    folder = tmp_path_factory.mktemp("where")
    (folder / "grid.toml").write_text(GRID)
    assert main(["sweep", str(folder / "grid.toml"), "--record", "10", "--workers", "1", "--json"]) == 0
    return folder / "grid.parquet"


def test_rows_are_picked(grid: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for trials in experiments_in(read_table(grid)):
        assert trials.records["x"].shape == (2, 5, 4)
    counts = {"": 4, "--where fill_ratio=0.95": 2, f"--kind series {ONE}": 1}
    for options, count in counts.items():
        capsys.readouterr()
        assert main(["plot", str(grid), str(tmp_path / "x.svg"), "--json", *options.split()]) == 0
        assert json.loads(capsys.readouterr().out)["experiments"] == count, options


REFUSED = {
    "--where colour=red": "--where colour=red: write NAME=VALUE with a parameter's name; in ",
    "--where filte=none": "write NAME=VALUE with a parameter's name; did you mean filter?",
    "--where filter": "differ fill_ratio=0.55|0.95, filter=asdf-plus|none",
    "--where filter=both": "has it; filter is asdf-plus or none",
    "--where filter=none --where filter=asdf-plus": "has it; filter is none",
    "--kind series": "match; choose one with --where fill_ratio=0.55|",
    "--kind series --where filter=none": "match; choose one with --where fill_ratio=0.55|0.95",
}


@pytest.mark.parametrize("options", REFUSED)
def test_what_is_not_there_is_named(
    options: str, grid: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    capsys.readouterr()
    assert main(["plot", str(grid), str(tmp_path / "no.svg"), *options.split()]) == 2
    out, err = capsys.readouterr()
    assert REFUSED[options] in err
    assert (out, err.count("\n")) == ("", 1)
    assert not (tmp_path / "no.svg").exists()
