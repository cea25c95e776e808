"""A newcomer's first hour: what README and tutorials print, typed into an environment that has the base
alone, and then with the extra that the page names.

The environment is real but for the download: it finds the packages of this one, less those of extras that are
not installed there.
"""

from __future__ import annotations

import re
import sysconfig
from pathlib import Path

import pytest

import test_tutorials
from mcp_asdf_tools.common.extras import install_instruction
from support import HIDING, ROOT, block_with, blocks, require, run

EXPERIMENT, INSTALLING = ROOT / "docs/experiment_tutorial.md", ROOT / "docs/installing.md"
SYSTEM = "/usr/local/bin:/usr/bin:/bin"


def make_environment(folder: Path, command: str) -> None:
    """Make it with the page's command, and put in place what pip would."""
    run("sh", "-exc", f"{command} --without-pip", cwd=folder)
    (packages,) = folder.glob(".venv/lib/python*/site-packages")
    (packages / "hiding.py").write_text(HIDING)
    here = sysconfig.get_path("purelib")
    (packages / "installed.pth").write_text(f"import site; site.addsitedir({here!r})\nimport hiding\n")
    program = folder / ".venv/bin/mcp-asdf"
    program.write_text(f'#!/bin/sh\nexec {program.with_name("python")} -m mcp_asdf_tools.cli.main "$@"\n')
    program.chmod(0o755)


@pytest.mark.slow
def test_the_first_hour(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    require("cc", "gcc libc6-dev")
    readme, refused = ROOT / "README.md", "2>&1 || echo exit code $?"
    (block,) = blocks(INSTALLING, "sh")
    make, install, activate, first = block.splitlines()
    assert re.fullmatch(r"\.venv/bin/python -m pip install '\.\[all\]'", install)
    make_environment(tmp_path, make)
    monkeypatch.setattr("support.PATH", SYSTEM)
    monkeypatch.setenv("EXTRAS", "")

    def types(*lines: str) -> str:
        return run("sh", "-ec", "\n".join((activate, *lines)), cwd=tmp_path, MPLBACKEND="Agg")

    def runs(program: str, ending: str = "") -> str:
        (tmp_path / "program.py").write_text(program)
        return types(f"python program.py {ending}")

    types(f"{first} --steps 300 --quiet")
    (tmp_path / "robot.c").write_text(blocks(readme, "c")[0])
    printed = types(block_with(readme, "robot.c", "sh"))
    assert printed.endswith(block_with(readme, "share of black 0.685", "text"))
    assert runs(blocks(readme, "python")[0]) == block_with(readme, "tick 1000", "text")

    with monkeypatch.context() as inside:
        inside.setattr("support.PATH", f"{tmp_path}/.venv/bin:{SYSTEM}")
        test_tutorials.build_alone(tmp_path)

    program, *more = blocks(EXPERIMENT, "python")
    (extra,) = re.findall(r"with the extra `(\w+)`", EXPERIMENT.read_text(encoding="utf-8"))
    *_, last, code = runs(program, refused).splitlines()
    assert code == "exit code 1" and last.endswith(install_instruction(extra)), "as the page says"
    monkeypatch.setenv("EXTRAS", extra)
    for each in (program, *more):
        runs(each)
    types(*blocks(EXPERIMENT, "sh"))
    types("mcp-asdf view question.parquet --where density=0.5 --where filter=none --export page.html")
    made = {"one_trial.png", "comparison.png", "question.png", "page.html"}
    assert made <= {path.name for path in tmp_path.iterdir()}
