"""Helpers that tests of several rooms share: paths of the project, and running its tools."""

from __future__ import annotations

import fcntl
import math
import os
import re
import resource
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from importlib.machinery import SourceFileLoader
from importlib.util import module_from_spec, spec_from_loader
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from _pytest.mark import ParameterSet

ROOT = Path(__file__).parents[1]
HEADER = ROOT / "c_ref/src/mcp_asdf.h"
CORE = ROOT / "c_ref/src/mcp_asdf.c"
TABLE = ROOT / "tables/t_table_omega05_q30.c"
PATH = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
"""Search path of programs: the virtual environment comes before the system."""
WARNINGS = "-Wall -Wextra -Wpedantic -Wconversion -Wsign-conversion -Wshadow -Wundef -Werror"
"""Flags of compilers for C that is delivered: all of these warnings, as errors."""
PATIENCE = 600.0
"""Seconds after which a test gives up waiting: even on a busy machine only what hangs takes so long."""


DRAWS_ALL = "MCP_ASDF_TESTS_DRAW_ALL"
"""Environment variable that conftest.py sets for ``make verify``."""


def draws(number: int) -> int:
    """Return how many of ``number`` cases a test marked ``random`` draws.

    It is all of them in ``make verify``, and a tenth, rounded up, in ``make test``.
    """
    if DRAWS_ALL in os.environ:
        return number
    return math.ceil(number / 10)


def run(*command: str | Path, cwd: Path = ROOT, **environment: str) -> str:
    """Run a command in a folder, and return its output.

    ``environment`` has variables that are set for it. Fails, and shows all output, unless its exit code is 0.
    """
    result = subprocess.run(
        command,
        cwd=cwd,
        env={**os.environ, "PATH": PATH, **environment},
        capture_output=True,
        text=True,
        check=False,
    )
    command_line = " ".join(str(word) for word in command)
    assert result.returncode == 0, f"{command_line}\n{result.stdout}\n{result.stderr}"
    return result.stdout


def wait_until(holds: Callable[[], bool]) -> None:
    """Wait until a condition holds. Fails if it does not within PATIENCE."""
    deadline = time.monotonic() + PATIENCE
    while not holds():
        assert time.monotonic() < deadline
        time.sleep(0.01)


def version_of_header() -> str:
    """Return the project's version, such as "1.2.3", as the C header defines it in three macros."""
    text = HEADER.read_text(encoding="utf-8")
    macros = dict(re.findall(r"^#define MCP_ASDF_VERSION_(\w+) (\d+)$", text, re.MULTILINE))
    return f"{macros['MAJOR']}.{macros['MINOR']}.{macros['PATCH']}"


def matching_files(folder: Path, pattern: str) -> list[Path]:
    """Return the paths in a folder that match a pattern such as "*.md" or "**/*.c", sorted.

    Fails if there are none: a check of all files would pass, although it checks nothing.
    """
    paths = sorted(folder.glob(pattern))
    assert paths, f"no file in {folder} matches {pattern}"
    return paths


PAGES = [ROOT / "README.md", *matching_files(ROOT / "docs", "**/*.md")]
"""All pages of the documentation."""
FENCED = re.compile(r"^```(\w*)\n(.*?)^```$", re.DOTALL | re.MULTILINE)


def blocks(page: Path, *languages: str) -> list[str]:
    """Return the page's blocks of code in these languages, such as "sh" and "python"."""
    languages_and_blocks = FENCED.findall(page.read_text(encoding="utf-8"))
    return [code for language, code in languages_and_blocks if language in languages]


def block_with(page: Path, part: str, *languages: str) -> str:
    """Return the page's block of code in these languages with a text. Fails unless there is exactly one."""
    blocks_with_text = [code for code in blocks(page, *languages) if part in code]
    assert len(blocks_with_text) == 1, f"{len(blocks_with_text)} blocks of {page} contain {part!r}"
    return blocks_with_text[0]


def section_of(page: Path, heading: str) -> str:
    """Return the text below a page's heading "## ...", up to the next one. Fails if it is not there."""
    heading_line = f"\n## {heading}\n"
    text = page.read_text(encoding="utf-8")
    assert heading_line in text, f"{page} has no heading ## {heading}"
    _before, _, text_from_section_on = text.partition(heading_line)
    section, _, _next_sections = text_from_section_on.partition("\n## ")
    return section


def cells_of_line(line: str) -> list[str]:
    """Return the cells in a line of a table in Markdown, which stand between vertical bars."""
    return [cell.strip() for cell in line.strip("|").split("|")]


def replace_each(text: str, replacements: dict[str, str]) -> str:
    """Replace old texts by new texts. Fails if an old text is not there."""
    for old, new in replacements.items():
        assert old in text
        text = text.replace(old, new)
    return text


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
    """Return a tool's name, or skip the test if it is not installed.

    The reason tells how to install it: with ``packages`` of Debian, or else with ``make setup``.
    """
    if shutil.which(tool, path=PATH) is None:
        instruction = f"apt-get install {packages}" if packages else "make setup"
        pytest.skip(f"{tool} is not installed: {instruction}")
    return tool


def slow(values: Iterable[Any]) -> list[ParameterSet]:
    """Return values of a parametrisation that are run in ``make verify`` alone.

    A tuple has the values of several parameters.
    """
    arguments = [value if isinstance(value, tuple) else (value,) for value in values]
    return [pytest.param(*values_of_case, marks=pytest.mark.slow) for values_of_case in arguments]


@contextmanager
def interruptible() -> Iterator[None]:
    """Let SIGINT (Ctrl-C) and SIGHUP end this process and its child processes, as in a terminal.

    If the tests are a shell's background job, or run by nohup, they ignore SIGINT or SIGHUP, and the
    processes that they start inherit that.
    """
    previous_int_handler = signal.signal(signal.SIGINT, signal.default_int_handler)
    previous_hup_handler = signal.signal(signal.SIGHUP, signal.SIG_DFL)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, previous_int_handler)
        signal.signal(signal.SIGHUP, previous_hup_handler)


@contextmanager
def limited_file_size(max_bytes: int) -> Iterator[None]:
    """Let no file of this process become larger, which fails like a full disk."""
    previous_limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (max_bytes, previous_limits[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, previous_limits)


def made_once(factory: pytest.TempPathFactory, name: str, make: Callable[[Path], object]) -> Path:
    """Return a folder that ``make`` has filled, once for all worker processes of this run of the tests.

    The first process that needs the folder fills it, while the others wait for a lock.
    """
    folder_of_run = factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        folder_of_run = folder_of_run.parent  # each worker has a folder of its own in it
    folder = folder_of_run / "made" / name
    folder.parent.mkdir(exist_ok=True)
    with folder.with_suffix(".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        done_mark = folder.with_suffix(".done")
        if not done_mark.exists():
            shutil.rmtree(folder, ignore_errors=True)  # what a process that failed has left
            folder.mkdir()
            make(folder)
            done_mark.touch()
    return folder


def load_program(path: Path) -> ModuleType:
    """Return a Python file that belongs to no package as a module, whatever its name."""
    loader = SourceFileLoader(path.stem.replace(".", "_"), str(path))
    spec = spec_from_loader(loader.name, loader)
    assert spec is not None
    module = module_from_spec(spec)
    sys.modules[loader.name] = module  # where dataclasses look for their module
    loader.exec_module(module)
    return module


def names_in(folder: Path) -> list[str]:
    """Return the names of all files in a folder, sorted."""
    return sorted(path.name for path in folder.iterdir())
