"""Helpers that tests of several rooms share: paths of the project, and running its tools."""

from __future__ import annotations

import fcntl
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from _pytest.mark import ParameterSet

ROOT = Path(__file__).parents[1]
HEADER = ROOT / "c_ref/src/mcp_asdf.h"
CORE = ROOT / "c_ref/src/mcp_asdf.c"
TABLE = ROOT / "tables/t_table_omega05_q30.c"
PATH = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
"""Tools that came with the virtual environment go before the system's."""
PATIENCE = 600.0
"""Seconds to wait for what has to happen; on a busy machine, too, only a program that hangs takes so long."""


DRAWS_ALL = "MCP_ASDF_TESTS_DRAW_ALL"
"""Environment variable that conftest.py sets for ``make verify``."""


def draws(number: int) -> int:
    """Cases that a test marked ``random`` draws: all in ``make verify``, a tenth in ``make test``."""
    return number if DRAWS_ALL in os.environ else -(-number // 10)


def run(*command: str | Path, cwd: Path = ROOT, **environment: str) -> str:
    """Run a command; returns its output. Fails with all that it printed unless it exits with 0."""
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


def wait_until(holds: Callable[[], bool]) -> None:
    """Return when something holds."""
    deadline = time.monotonic() + PATIENCE
    while not holds():
        assert time.monotonic() < deadline
        time.sleep(0.01)


def version_of_header() -> str:
    """The one place where the version stands."""
    text = HEADER.read_text(encoding="utf-8")
    return ".".join(
        re.findall(rf"^#define MCP_ASDF_VERSION_{part} (\d+)$", text, re.MULTILINE)[0]
        for part in ("MAJOR", "MINOR", "PATCH")
    )


PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
FENCED = re.compile(r"^```(\w*)\n(.*?)^```$", re.DOTALL | re.MULTILINE)


def blocks(page: Path, *languages: str) -> list[str]:
    """The page's blocks of code in these languages."""
    return [code for kind, code in FENCED.findall(page.read_text(encoding="utf-8")) if kind in languages]


def block_with(page: Path, part: str, *languages: str) -> str:
    """The page's only block of code in these languages that has this in it."""
    (found,) = [code for code in blocks(page, *languages) if part in code]
    return found


HIDING = """\
import os, sys
from mcp_asdf_tools.common.extras import EXTRAS

class Finder:
    def find_spec(self, name, path, target=None):
        extra = EXTRAS.get(name.partition(".")[0])
        if extra is not None and extra not in os.environ.get("EXTRAS", "").split(","):
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

sys.meta_path.insert(0, Finder())
"""
"""Beginning of a program that finds no modules of extras but those named in the variable EXTRAS."""


def require(tool: str, packages: str | None = None) -> str:
    """The tool's name; skips the test where it is not installed, naming Debian's packages that have it."""
    if shutil.which(tool, path=PATH) is None:
        pytest.skip(f"{tool} is not installed: {f'apt-get install {packages}' if packages else 'make setup'}")
    return tool


def slow(values: Iterable[Any]) -> list[ParameterSet]:
    """Values of a parametrisation, each for ``make verify``."""
    each = (value if isinstance(value, tuple) else (value,) for value in values)
    return [pytest.param(*value, marks=pytest.mark.slow) for value in each]


@contextmanager
def interruptible() -> Iterator[None]:
    """Ctrl-C and a hang-up as in a terminal, for this process and those it starts inside.

    A shell's background jobs ignore SIGINT, nohup's SIGHUP, and their children inherit that.
    """
    before = (
        signal.signal(signal.SIGINT, signal.default_int_handler),
        signal.signal(signal.SIGHUP, signal.SIG_DFL),
    )
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before[0])
        signal.signal(signal.SIGHUP, before[1])


def made_once(factory: pytest.TempPathFactory, name: str, make: Callable[[Path], object]) -> Path:
    """Folder that ``make`` has filled, once for all worker processes of this run of the tests."""
    own = factory.getbasetemp()
    folder = (own.parent if "PYTEST_XDIST_WORKER" in os.environ else own) / "made" / name
    folder.parent.mkdir(exist_ok=True)
    with folder.with_suffix(".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        done = folder.with_suffix(".done")
        if not done.exists():
            shutil.rmtree(folder, ignore_errors=True)
            folder.mkdir()
            make(folder)
            done.touch()
    return folder
