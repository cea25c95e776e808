"""Examples of help texts run, and slips are answered with what was meant."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import pytest

from mcp_asdf_tools.cli import main as cli
from mcp_asdf_tools.cli.main import main
from support import ROOT, run

CAN0 = "--interface socketcan --channel can0"
NO_CAN = "wants a CAN interface"
CTRL_C = "ends with Ctrl-C"
LONG = "takes minutes or hours"
NOT_RUN = {
    "swarm --topology dynamic --view": CTRL_C,
    "swarm --interface socketcan --channel vcan0 --robots 5": NO_CAN,
    "swarm --slcan 20000": "opens a port that may be in use",
    "swarm --interface udp_multicast --processes --robots 4 --steps 100": "tests/test_docs.py runs it",
    "swarm --channel 'vcan{robot}' --device 3=slcan:socket://127.0.0.1:20001": "wants a controller there",
    "view run.parquet": CTRL_C,
    "view grid.parquet --where filter=none --trial 3": CTRL_C,
    "view run.log": CTRL_C,
    "view --interface socketcan --channel vcan0": NO_CAN,
    f"radio --id 3 --robots 11 {CAN0}": NO_CAN,
    f"radio --id 3 --robots 11 {CAN0} --fault loss=0.3": NO_CAN,
    f"radio --id 3 {CAN0} --verify --wait 60 --report it.md": NO_CAN,
    "node --id 3 --interface udp_multicast": CTRL_C,
    f"node --id 3 {CAN0} --b-hat 0.8 --log run.log": NO_CAN,
    "table --verify firmware.elf": "wants an image; tests/host_tools/tables has some",
    "crosscheck --steps 100000000 --seed 7": LONG,
    "sweep grid.toml --scheduler tcp://head:8786": "wants several machines",
    "plot grid.parquet curves.svg --kind curve --x omega --hue density --y e": (
        "wants a sweep over both; tests/host_tools/experiments/test_curves.py draws such curves"
    ),
    "reproduce": LONG,
    "reproduce --paper": LONG,
    "reproduce --quick": "tests/host_tools/reproduction/test_study.py runs it",
    "reproduce --part fully_connected --seed 7 --output other": LONG,
    "reproduce --firmware reference --conventions authors --trials 30 --output authors": LONG,
}
"""Examples that are parsed alone, and why."""

FIRST = (
    "simulate --topology dynamic --steps 2000 --trials 1 --record 100 --output run.parquet",
    "swarm --steps 200 --log run.log",
    "sweep grid.toml --record 10",
)
"""Commands that make what examples read."""
GRID = """\
robots = 4
steps = 2000
trials = 4
flawed = 2
filter = ["none", "asdf-plus"]
fill_ratio = [0.55, 0.95]
"""


def examples(name: str) -> list[str]:
    """The examples of a command, without the program's name and comments."""
    lines = (line for line in cli._load(name).EPILOG.splitlines() if line.startswith("  mcp-asdf "))
    return [re.sub(r"\s+#.*", "", line).removeprefix("  mcp-asdf ").strip() for line in lines]


@pytest.mark.parametrize(
    ("line", "told"),
    [
        ("node --id 3 --interface socketcn", "; did you mean socketcan?"),
        ("plot a.parquet b.png --kind boxs", "; did you mean boxes?"),
        ("node --id 3 --fd", "no such option: --fd"),
    ],
)
def test_a_word_that_is_no_choice_takes_two_lines(
    line: str, told: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(line.split()) == 2
    out, err = capsys.readouterr()
    assert told in err
    assert (out, err.count("\n")) == ("", 2)


@pytest.mark.parametrize("name", ["score", "replay", "plot", "view", "sweep", "simulate"])
def test_a_missing_file_is_named(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    kind = {"replay": "log", "sweep": "toml", "simulate": "toml"}.get(name, "parquet")
    missing = tmp_path / f"no such file.{kind}"
    assert main([name, str(missing), *([str(tmp_path / "x.svg")] if name == "plot" else [])]) == 2
    out, err = capsys.readouterr()
    assert str(missing) in err and "o such file" in err.replace(str(missing), "")
    assert (out, err.count("\n")) == ("", 1)


@pytest.mark.slow
def test_the_examples_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As they stand, but for the length of swarms."""
    monkeypatch.setenv("HOME", str(tmp_path))
    for folder in (".local/share/bash-completion/completions", ".zfunc", ".config/fish/completions"):
        (tmp_path / folder).mkdir(parents=True)
    shutil.copytree(ROOT / "tables", tmp_path / "tables")
    (tmp_path / "grid.toml").write_text(GRID)
    lines = [line for name in cli.COMMANDS for line in examples(name) if line not in NOT_RUN]
    for line in (*FIRST, *lines):
        if line in ("sweep grid.toml", "simulate --trials 1 --record 100 --output run.parquet"):
            line += " --output of_its_own.parquet"  # noqa: PLW2901
            (tmp_path / "of_its_own.parquet").unlink(missing_ok=True)
        is_long = line.startswith("swarm") and "--steps" not in line
        run("sh", "-exc", f"mcp-asdf {line}{' --steps 300' * is_long}", cwd=tmp_path, MPLBACKEND="Agg")


@pytest.mark.parametrize(
    ("line", "told"),
    [
        ("help", "did you mean --help?"),
        ("simulate none.toml", "cannot read none.toml: No such file or directory\n"),
    ],
)
def test_what_a_stranger_types_is_answered_with_the_fix(
    line: str, told: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(line.split()) == 2
    out, err = capsys.readouterr()
    assert told in err
    assert out == "" and err.count("\n") <= 2
