"""What tests of several rooms share: where the project is, and running its tools."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
HEADER = ROOT / "c_ref/src/mcp_asdf.h"
CORE = ROOT / "c_ref/src/mcp_asdf.c"
TABLE = ROOT / "tables/t_table_omega05_q30.c"
PATH = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
"""Tools that came with the virtual environment go before the system's."""


def run(*command: str | Path, cwd: Path = ROOT, **environment: str) -> str:
    """What the command prints; fails with all that it said unless it exits with 0."""
    done = subprocess.run(
        command,
        cwd=cwd,
        env={**os.environ, "PATH": PATH, **environment},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, f"{' '.join(map(str, command))}\n{done.stdout}\n{done.stderr}"
    return done.stdout


def require(tool: str, packages: str | None = None) -> str:
    """The tool's name; skips the test where it is not installed, naming Debian's packages that have it."""
    if shutil.which(tool, path=PATH) is None:
        pytest.skip(f"{tool} is not installed: {f'apt-get install {packages}' if packages else 'make setup'}")
    return tool
