"""A newcomer's first hour: what README and tutorials print, typed into an environment that has the base
alone, and then with the extra that the page names.

The environment is real but for the download: it finds the packages of this one, less those of extras that are
not installed there.
"""

from __future__ import annotations

import re
import subprocess
import sysconfig
from pathlib import Path

import pytest

import test_tutorials
from support import ROOT, blocks, require, run

EXPERIMENT, INSTALLING = ROOT / "docs/experiment_tutorial.md", ROOT / "docs/installing.md"
HIDING = """\
import os, sys
from mcp_asdf_tools.common.extras import EXTRAS

class Finder:
    def find_spec(self, name, path, target=None):
        extra = EXTRAS.get(name.partition(".")[0])
        if extra is not None and extra not in os.environ["EXTRAS"].split(","):
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

sys.meta_path.insert(0, Finder())
"""


class Newcomer:
    """Somebody with an empty folder and an environment made as docs/installing.md says."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.extras = folder, ""
        (block,) = blocks(INSTALLING, "sh")
        make, install, self._activate, self.first = block.splitlines()
        assert re.fullmatch(r"\.venv/bin/python -m pip install '\.\[all\]'", install)
        run("sh", "-exc", f"{make} --without-pip", cwd=folder)
        (packages,) = folder.glob(".venv/lib/python*/site-packages")
        (packages / "hiding.py").write_text(HIDING)
        here = sysconfig.get_path("purelib")
        (packages / "installed.pth").write_text(f"import site; site.addsitedir({here!r})\nimport hiding\n")
        command = folder / ".venv/bin/mcp-asdf"
        command.write_text(f'#!/bin/sh\nexec {command.with_name("python")} -m mcp_asdf_tools.cli.main "$@"\n')
        command.chmod(0o755)

    def types(self, *lines: str) -> subprocess.CompletedProcess[str]:
        """Run a shell's lines in the environment, which is on the path."""
        script = "\n".join((self._activate, *lines))
        environment = {"PATH": "/usr/local/bin:/usr/bin:/bin", "EXTRAS": self.extras, "MPLBACKEND": "Agg"}
        return subprocess.run(
            ["sh", "-ec", script],
            cwd=self.folder,
            env=environment,
            capture_output=True,
            text=True,
            check=False,
        )

    def runs(self, program: str) -> subprocess.CompletedProcess[str]:
        """Run a page's program in Python."""
        (self.folder / "program.py").write_text(program)
        return self.types("python program.py")


@pytest.mark.slow
def test_the_first_hour(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    require("cc", "gcc libc6-dev")
    newcomer, readme = Newcomer(tmp_path), ROOT / "README.md"
    assert newcomer.types(f"{newcomer.first} --steps 300 --quiet").returncode == 0

    (tmp_path / "robot.c").write_text(blocks(readme, "c")[0])
    (commands,) = [block for block in blocks(readme, "sh") if "robot.c" in block]
    for done, beginning in (
        (newcomer.types(commands), "share of black"),
        (newcomer.runs(blocks(readme, "python")[0]), "tick 1000"),
    ):
        (shown,) = [block for block in blocks(readme, "text") if block.startswith(beginning)]
        assert done.stdout.endswith(shown), done.stderr

    monkeypatch.setenv("EXTRAS", "")
    monkeypatch.setattr("support.PATH", f"{tmp_path}/.venv/bin:/usr/local/bin:/usr/bin:/bin")
    test_tutorials.build_alone(tmp_path)

    program, *more = blocks(EXPERIMENT, "python")
    refused = newcomer.runs(program)
    (named,) = re.findall(r"pip install '(mcp-asdf\[\w+\])'", EXPERIMENT.read_text(encoding="utf-8"))
    last = refused.stderr.splitlines()[-1]
    assert refused.returncode == 1 and f"run: pip install '{named}'" in last, (
        "the page's and the library's agree"
    )
    newcomer.extras = named[named.index("[") + 1 : -1]
    for done in (*map(newcomer.runs, (program, *more)), newcomer.types(*blocks(EXPERIMENT, "sh"))):
        assert done.returncode == 0, done.stderr
    page = newcomer.types("mcp-asdf view question.parquet --where density=0.5 --where filter=none")
    assert page.returncode == 2 and "[view]" in page.stderr, (
        "and the server's, where the tutorial leads to it"
    )
    made = {"one_trial.png", "comparison.png", "question.png"}
    assert made <= {path.name for path in tmp_path.iterdir()}
