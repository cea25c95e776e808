"""The effects of ``.ci/setup`` on a virtual environment, which are those of the page's way by hand."""

from __future__ import annotations

import os
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from support import ROOT, blocks, require, run

PAGE = ROOT / ".github/CONTRIBUTING.md"
PYTHON = """#!/bin/sh
# Stands in for Python: writes down how it was called, and makes environments whose Python does the same.
for word in "$0" "$@"; do printf "'%s' " "$word"; done >>"$CALLS"
echo >>"$CALLS"
for last; do :; done
if [ "$1 $2" = "-m venv" ]; then mkdir -p "$last/bin" && cp "$0" "$last/bin/python"; fi
"""
WITHOUT_PIP = '#!/bin/sh\n[ "$1 $2" != "-m pip" ] || { echo "No module named pip" >&2; exit 1; }\n'


@pytest.fixture
def clone(tmp_path: Path) -> Path:
    """A folder with the set-up in it; in ``bin`` a stand-in for Python, and somebody who is not root."""
    require("cc", "gcc libc6-dev")
    for folder in (".ci", "bin"):
        (tmp_path / folder).mkdir()
    shutil.copy(ROOT / ".ci/setup", tmp_path / ".ci/setup")
    program(tmp_path / "bin/python3", PYTHON)
    program(tmp_path / "bin/id", "#!/bin/sh\necho 1000\n")
    return tmp_path


def program(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    path.chmod(0o755)


def history(clone: Path, purpose: str, status: int = 0) -> list[str]:
    """Run the set-up; returns what it says and which programs it calls, in order."""
    calls = clone / "calls"
    calls.unlink(missing_ok=True)
    path = f"{clone / 'bin'}:/usr/bin:/bin"
    set_up = f'.ci/setup {purpose} >>"$CALLS" 2>&1 || [ $? = {status} ]'
    run("sh", "-c", set_up, cwd=clone, PATH=path, CALLS=str(calls))
    return calls.read_text().splitlines()


def set_up(clone: Path, purpose: str) -> list[list[str]]:
    """Run the set-up; returns the calls of Python that make environments and install packages."""
    words = [shlex.split(line) for line in history(clone, purpose) if not line.startswith("setup: ")]
    return [call for call in words if "-m" in call and "--version" not in call]


def test_an_environment_that_lacks_pip_is_made_again(clone: Path) -> None:
    """Ctrl-C while the environment is made leaves one whose Python is there and whose pip is not."""
    program(clone / ".venv/bin/python", WITHOUT_PIP)
    made, *installed = set_up(clone, "run")
    assert made[1:] == ["-m", "venv", "--clear", ".venv"]
    assert all("install" in call for call in installed) and len(installed) == 2
    assert (clone / ".venv/ready-to-run").exists()
    assert set_up(clone, "run") == installed, "what has pip is kept"


@pytest.mark.slow
def test_without_root_it_names_what_is_missing_and_goes_on(clone: Path) -> None:
    program(clone / "bin/avr-gcc", "#!/bin/sh\nexit 1\n")
    program(clone / "bin/apt-get", '#!/bin/sh\necho "apt-get $*" >>"$CALLS"\n')
    done = history(clone, "test")
    told = next(line for line in done if line.startswith("setup: "))
    assert "apt-get install" in told and "gcc-avr avr-libc" in told
    assert not any(line.startswith("apt-get") for line in done)
    assert (clone / ".venv/ready-to-test").exists()


@pytest.mark.slow
def test_without_the_index_of_packages_it_says_so_in_one_line(clone: Path) -> None:
    """pip's own message where nothing answers."""
    nowhere = "-qq --isolated --retries 1 --index-url http://127.0.0.1:1/simple mcp-asdf-of-nowhere"
    asks = f'[ "$5" != install ] || exec {shlex.quote(sys.executable)} -m pip download {nowhere}\n'
    program(clone / ".venv/bin/python", f"#!/bin/sh\n{asks}")
    said = history(clone, "run", status=1)
    assert said[-1].startswith("setup: no connection to the index of Python packages; connect to the network")
    assert "installing the Python packages" in said[-2], "and nothing of pip's"
    assert not (clone / ".venv/ready-to-run").exists()


@pytest.mark.slow
def test_the_set_up_by_hand_is_the_same(clone: Path) -> None:
    """The page's commands are what made the environment of these tests; only how much pip says may differ."""
    (block,) = (block for block in blocks(PAGE, "sh") if "venv" in block)
    shown = [shlex.split(line) for line in block.splitlines()]
    quiet = {"-qq", "--disable-pip-version-check"}
    done = [[word for word in call if word not in quiet] for call in set_up(clone, "test")]
    assert [call[1:] for call in shown] == [call[1:] for call in done]
    assert [Path(call[0]).name for call in shown] == [Path(call[0]).name for call in done]


def make_newest(folder: Path, available: str) -> tuple[int, list[str]]:
    """Run ``.ci/newest`` with a stand-in for uv that has one Python; returns exit code and output."""
    (folder / ".ci").mkdir()
    shutil.copy(ROOT / ".ci/newest", folder / ".ci/newest")
    (folder / "pyproject.toml").write_text(
        "".join(f'    "Programming Language :: Python :: 3.{minor}",\n' for minor in (9, 11, 10))
    )
    program(folder / "bin/uv", f'#!/bin/sh\ncase "$*" in *" {available} "*) ;; *) exit 2 ;; esac\n')
    done = subprocess.run(
        [folder / ".ci/newest", "build/newest"],
        env={**os.environ, "PATH": f"{folder / 'bin'}:/usr/bin:/bin"},
        capture_output=True,
        text=True,
        check=False,
    )
    return done.returncode, done.stdout.splitlines()


def test_the_newest_python_that_can_be_had_is_taken_and_others_are_named(tmp_path: Path) -> None:
    status, lines = make_newest(tmp_path, available="3.10")
    assert status == 0
    assert lines == ["newest: Python 3.11 cannot be had here", "newest: Python 3.10"]


def test_without_any_python_the_run_with_the_newest_fails(tmp_path: Path) -> None:
    status, lines = make_newest(tmp_path, available="2.7")
    assert status == 1 and len(lines) == 3
