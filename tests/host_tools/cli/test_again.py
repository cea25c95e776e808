"""The line "again: mcp-asdf ..." with which every run ends: it is parsed to the same run."""

from __future__ import annotations

import argparse
import shlex
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from mcp_asdf_tools.bus import interfaces
from mcp_asdf_tools.cli import main as cli
from mcp_asdf_tools.cli import radio, reproduce, simulate, swarm

SHORT = "--robots 4 --steps 30 --filter-period 10"
TABLE = "--omega 0.10 --neighbours 3"
GRID = """\
robots = 3
steps = 20
filter_period = 10
trials = 2
[[grid]]
filter = ["none", "asdf-plus"]
"""
PRINTED = "again: mcp-asdf "


def settled_bus(args: argparse.Namespace) -> tuple[str, str | None]:
    choice = interfaces.choose_bus(args)
    return choice.interface, choice.channel


SETTINGS: dict[str, Callable[[argparse.Namespace], Any]] = {
    "swarm": lambda args: (swarm.settings_of(args), settled_bus(args)),
    "radio": lambda args: (radio.settings_of(args), settled_bus(args)),
    "simulate": simulate.settings_of,
    "reproduce": reproduce.scale_of,
}
"""Everything that decides a run, where more does than the options as they were parsed."""

RUNS = [
    f"swarm {SHORT} --flawed 50% --set omega=0.15 --fault 'loss=0.5,robots=0+2' --fault liar,robots=3,x=1",
    f"swarm {SHORT} --seed=7 --set true-accuracy=0.30000000000000004 --set latency=1 --compare",
    "radio --id 3 --robots 3 --steps 2 --steps-per-second 500 --fault loss=0.3",
    f"simulate {SHORT} --trials 2 --drift linear --drift-rate=-1e-5",
    "simulate --output results.parquet one.toml --seed 3",
    "sweep grid.toml --output 'two words.parquet'",
    f"table --output tables {TABLE}",
]


@pytest.fixture(autouse=True)
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("grid.toml").write_text(GRID)
    Path("one.toml").write_text(GRID.partition("[[grid]]")[0])


def printed(capsys: pytest.CaptureFixture[str], *words: str) -> str:
    """Command to type again, the last line of a run."""
    assert cli.main(words) == 0
    lines = [line for line in capsys.readouterr().out.splitlines() if "on the same seed" not in line]
    assert lines[-1].startswith(PRINTED)
    return lines[-1].removeprefix(PRINTED)


def decided_by(*words: str) -> Any:
    """Settings that decide the run of a command line."""
    name, *options = words
    args = cli._parser_for(name, cli._load(name)).parse_args(options)
    settings = SETTINGS[name](args) if name in SETTINGS else None
    ignored = (
        {"command_line", "seed", "steps", "interface", "channel", "bus_kwargs"}
        if settings
        else {"command_line"}
    )
    return settings, {key: value for key, value in vars(args).items() if key not in ignored}


@pytest.mark.parametrize("line", RUNS)
def test_the_line_is_the_same_run(line: str, capsys: pytest.CaptureFixture[str]) -> None:
    words = shlex.split(line)
    again = shlex.split(printed(capsys, *words))
    wanted, found = decided_by(*words), decided_by(*again)
    assert found[0] == wanted[0]
    assert {name: found[1][name] for name, value in wanted[1].items() if value is not None} == {
        name: value for name, value in wanted[1].items() if value is not None
    }
    assert printed(capsys, *again) == shlex.join(again)


@pytest.mark.slow
@pytest.mark.parametrize("line", [f"swarm {SHORT}", f"simulate {SHORT} --trials 2", "sweep grid.toml"])
def test_the_seed_is_said_even_if_it_was_not_given(line: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert "--seed=1" in printed(capsys, *line.split()).split()


def test_a_log_replayed(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main([*f"swarm {SHORT} --log run.log --quiet".split()]) == 0
    assert capsys.readouterr().out.count(PRINTED) == 0
    assert printed(capsys, "replay", "run.log") == "replay run.log"


def test_machines_get_json_alone(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main([*f"swarm {SHORT} --json".split()]) == 0
    assert PRINTED not in capsys.readouterr().out
