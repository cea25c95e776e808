"""Completion on the command line: what a shell offers after Tab."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path

import pytest

from mcp_asdf_tools.cli import main as cli
from mcp_asdf_tools.cli.completion import SHELLS
from support import require, run


@pytest.fixture(scope="module")
def scripts(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """The scripts of all shells, by the shell's name."""
    folder = tmp_path_factory.mktemp("completion")
    for shell in SHELLS:
        (folder / shell).write_text(run("mcp-asdf", "completion", shell))
    return {shell: folder / shell for shell in SHELLS}


def offered(script: Path, line: str) -> set[str]:
    """Words that bash offers for the last word of ``line``, in a folder with a file and a folder."""
    place = script.parent / "place"
    (place / "folder").mkdir(parents=True, exist_ok=True)
    (place / "run.toml").touch()
    words = [*line.split(" ")]
    ask = (
        f"source {script}; COMP_WORDS=({' '.join(words[:-1])} '{words[-1]}'); COMP_CWORD={len(words) - 1}; "
        f'_shtab_mcp_asdf mcp-asdf "{words[-1]}" "{words[-2]}"; printf "%s\\n" "${{COMPREPLY[@]}}"'
    )
    return {word.strip() for word in run(require("bash"), "-c", ask, cwd=place).split("\n")} - {""}


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("mcp-asdf s", {"swarm", "simulate", "sweep", "score"}),
        ("mcp-asdf swarm --robo", {"--robots"}),
        ("mcp-asdf swarm --topology ", {"fully-connected", "dynamic", "graph"}),
        ("mcp-asdf node --interface socket", {"socketcan", "socketcand"}),
        ("mcp-asdf plot --kind b", {"boxes"}),
        ("mcp-asdf completion ", set(SHELLS)),
        ("mcp-asdf sweep run", {"run.toml"}),
        ("mcp-asdf swarm --log r", {"run.toml"}),
        ("mcp-asdf table --output ", {"folder"}),
    ],
)
def test_bash_completes(line: str, words: set[str], scripts: dict[str, Path]) -> None:
    found = offered(scripts["bash"], line)
    assert words <= found
    assert len(found) <= len(words) + 2  # -h and --help at most besides


@pytest.mark.parametrize("shell", SHELLS)
def test_a_script_has_every_command_and_option(shell: str, scripts: dict[str, Path]) -> None:
    text = scripts[shell].read_text()
    for name in cli.COMMANDS:
        assert name in text
        for action in cli._parser_for(name, cli._load(name))._actions:
            for option in action.option_strings:
                assert option.lstrip("-") in text, f"{name} {option}"


@pytest.mark.parametrize("shell", [shell for shell in SHELLS if shutil.which(shell)])
def test_a_shell_that_is_here_reads_its_script(shell: str, scripts: dict[str, Path]) -> None:
    done = subprocess.run(
        [shell, "-n", scripts[shell]], capture_output=True, text=True, check=False, timeout=60
    )
    assert (done.returncode, done.stderr) == (0, "")


def test_another_shell_is_refused_in_two_lines(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["completion", "csh"]) == 2
    first, second = capsys.readouterr().err.splitlines()
    assert "bash" in first and "zsh" in first and "fish" in first
    assert second == "See 'mcp-asdf completion --help'."


def test_the_script_as_json(capsys: pytest.CaptureFixture[str], scripts: dict[str, Path]) -> None:
    assert cli.main(["completion", "fish", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["script"].strip() == scripts["fish"].read_text().strip()
