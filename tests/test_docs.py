"""Everything the README and the docs show works: commands run, programs compile, links lead somewhere."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
BLOCK = re.compile(r"^```(\w+)\n(.*?)^```", re.DOTALL | re.MULTILINE)
LINK = re.compile(r"\]\((?!https?:)([^)#\s]+)(?:#[^)]*)?\)")
OUTSIDE = ("make ", "git clone", "cd ")
"""Commands that set up or test everything themselves; that ``make`` knows the target is checked."""


def blocks(page: Path, language: str) -> list[str]:
    return [code for kind, code in BLOCK.findall(page.read_text(encoding="utf-8")) if kind == language]


def commands(page: Path) -> list[str]:
    """Lines of the page's ``sh`` blocks, comments cut, continued lines joined."""
    lines = "\n".join(blocks(page, "sh")).replace("\\\n", " ").splitlines()
    stripped = (re.sub(r"\s+#.*$", "", line).strip() for line in lines)
    return [line for line in stripped if line and not line.startswith("#")]


def cases(outside: bool) -> list[tuple[str, str]]:
    return [
        (page.name, command)
        for page in PAGES
        for command in commands(page)
        if command.startswith(OUTSIDE) == outside
    ]


@pytest.fixture(scope="module")
def workplace(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with what the commands expect to find in the project's own."""
    folder = tmp_path_factory.mktemp("docs")
    for name in ("tables", "c_ref"):
        shutil.copytree(ROOT / name, folder / name)
    return folder


def environment() -> dict[str, str]:
    return {
        **os.environ,
        "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}",
        "MPLBACKEND": "Agg",
    }


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_commands_of_the_page_work(page: Path, workplace: Path) -> None:
    for command in commands(page):
        if command.startswith(OUTSIDE):
            continue
        done = subprocess.run(
            command,
            shell=True,
            cwd=workplace,
            env=environment(),
            capture_output=True,
            text=True,
            check=False,
            timeout=300,
        )
        assert done.returncode == 0, f"{page.name}: {command}\n{done.stdout}\n{done.stderr}"


@pytest.mark.parametrize("command", sorted({c for _, c in cases(outside=True) if c.startswith("make ")}))
def test_make_knows_the_target(command: str) -> None:
    done = subprocess.run(
        ["make", "-n", *command.split()[1:]], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr


def test_there_are_commands_to_test() -> None:
    assert len(cases(outside=False)) >= 5
    assert ("README.md", "make test") in cases(outside=True)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_lead_somewhere(page: Path) -> None:
    for target in LINK.findall(page.read_text(encoding="utf-8")):
        assert (page.parent / target).exists(), f"{page.name} links to {target}"


def test_the_c_program_of_the_readme_runs(tmp_path: Path) -> None:
    (code,) = blocks(ROOT / "README.md", "c")
    (tmp_path / "main.c").write_text(code)
    sources = [tmp_path / "main.c", ROOT / "c_ref/src/mcp_asdf.c", ROOT / "tables/t_table_omega05_q30.c"]
    compiler = shutil.which("cc") or "gcc"
    flags = ["-std=c99", "-pedantic-errors", "-Wall", "-Wextra", "-Werror", "-I", str(ROOT / "c_ref/src")]
    subprocess.run([compiler, *flags, *map(str, sources), "-o", str(tmp_path / "robot")], check=True)
    shown = subprocess.run([tmp_path / "robot"], capture_output=True, text=True, check=True).stdout
    assert shown == "fill ratio 0.685\n"  # (2/3 + 0.95 - 1) / (2 0.95 - 1) = 0.6852


def test_the_python_program_of_the_readme_runs() -> None:
    (code,) = blocks(ROOT / "README.md", "python")
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    names, values = zip(
        *((line.split()[0], line.split()[1:]) for line in done.stdout.splitlines()), strict=True
    )
    assert names == ("NativeRobot", "MirrorRobot", "ReferenceRobot")
    assert values[0] == values[1]
    assert [float(v) for v in values[0]] == pytest.approx([float(v) for v in values[2]], abs=2e-6)
