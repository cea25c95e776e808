"""The line "again: mcp-asdf ..." with which every run ends: what was typed, and what else decides the run."""

from __future__ import annotations

import shlex
from pathlib import Path

import pytest

from mcp_asdf_tools.cli import main as cli

SHORT = "--robots 4 --steps 30 --filter-period 10"
EXPERIMENT = "robots = 3\nsteps = 20\nfilter_period = 10\ntrials = 2\n"


@pytest.mark.parametrize(
    ("line", "settled"),
    [
        (f"swarm {SHORT} --flawed 50% --fault 'loss=0.5,robots=0+2' --fault liar,robots=3,x=1", "--seed=1"),
        (f"swarm {SHORT} --seed=7 --set true-accuracy=0.30000000000000004 --set latency=1 --compare", ""),
        ("radio --id 3 --robots 3 --steps 2 --steps-per-second 500 --fault loss=0.3", "--seed=1"),
        (f"simulate {SHORT} --trials 2 --drift linear --drift-rate=-1e-5", "--seed=1"),
        ("simulate --output results.parquet one.toml --seed 3", ""),
        ("sweep grid.toml --output 'two words.parquet'", "--seed=1"),
        ("table --output tables --omega 0.10 --neighbours 3", ""),
        ("table --output tables", "--omega=0.05 --neighbours=127"),
    ],
)
def test_the_line_is_the_same_run(
    line: str,
    settled: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """It needs no more words the second time, and machines get JSON alone."""
    monkeypatch.chdir(tmp_path)
    Path("one.toml").write_text(EXPERIMENT)
    Path("grid.toml").write_text(f'{EXPERIMENT}[[grid]]\nfilter = ["none", "asdf-plus"]\n')
    command, *options = shlex.split(line)
    again = [command, *settled.split(), *options]
    for words in ([command, *options], again):
        assert cli.main(words) == 0
        told = [each for each in capsys.readouterr().out.splitlines() if each.startswith("again: ")]
        assert told == [f"again: mcp-asdf {shlex.join(again)}"]
    assert cli.main([*again, "--json"]) == 0
    assert "again: " not in capsys.readouterr().out
