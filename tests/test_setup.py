"""The effects of ``.ci/setup`` on a virtual environment. The page's commands by hand have the same."""

from __future__ import annotations

import os
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from support import ROOT, block_with, require, run

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
    """A folder with the set-up. In ``bin`` are stand-ins for Python and for an ``id`` that is not root's."""
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


def lines_of_set_up(clone: Path, purpose: str, exit_code: int = 0) -> list[str]:
    """Run the set-up, and check that it ends with this exit code.

    Returns the lines that it prints and those of the programs that it calls, which write down their words.
    """
    calls = clone / "calls"
    calls.unlink(missing_ok=True)
    path = f"{clone / 'bin'}:/usr/bin:/bin"
    set_up = f'.ci/setup {purpose} >>"$CALLS" 2>&1 || [ $? = {exit_code} ]'
    run("sh", "-c", set_up, cwd=clone, PATH=path, CALLS=str(calls))
    return calls.read_text().splitlines()


def python_calls_of_set_up(clone: Path, purpose: str) -> list[list[str]]:
    """Run the set-up, and return the words of Python's calls that make environments and install packages."""
    words = [shlex.split(line) for line in lines_of_set_up(clone, purpose) if not line.startswith("setup: ")]
    return [call for call in words if "-m" in call and "--version" not in call]


def test_an_environment_that_lacks_pip_is_made_again(clone: Path) -> None:
    """Ctrl-C while the environment is made leaves one whose Python is there and whose pip is not.

    The set-up for a run of the tools makes the environment, and then installs twice: first a newer pip, then
    the project. A file marks that it has ended.
    """
    program(clone / ".venv/bin/python", WITHOUT_PIP)

    making, *installations = python_calls_of_set_up(clone, "run")

    _python, *words = making
    assert words == ["-m", "venv", "--clear", ".venv"]
    assert len(installations) == 2
    for call in installations:
        assert "install" in call
    assert (clone / ".venv/ready-to-run").exists()


def test_an_environment_that_has_pip_is_kept(clone: Path) -> None:
    """The first run of the set-up makes it. A second run only installs packages into it again."""
    making, *installations = python_calls_of_set_up(clone, "run")
    assert "venv" in making

    assert python_calls_of_set_up(clone, "run") == installations


@pytest.mark.slow
def test_a_set_up_without_root_names_the_packages_that_are_missing_and_goes_on(clone: Path) -> None:
    """It does not call apt-get, which would ask for a password. avr-gcc, which fails here, is missing."""
    program(clone / "bin/avr-gcc", "#!/bin/sh\nexit 1\n")
    program(clone / "bin/apt-get", '#!/bin/sh\necho "apt-get $*" >>"$CALLS"\n')

    lines = lines_of_set_up(clone, "test")

    message = next(line for line in lines if line.startswith("setup: "))
    assert "apt-get install" in message
    assert "gcc-avr avr-libc" in message
    calls_of_apt_get = [line for line in lines if line.startswith("apt-get")]
    assert calls_of_apt_get == []
    assert (clone / ".venv/ready-to-test").exists(), "the mark that the set-up has ended"


@pytest.mark.slow
def test_a_set_up_without_a_network_says_so_in_one_line(clone: Path) -> None:
    """No server answers pip. Its own message of many lines is not shown.

    The environment's Python is a script here, whose pip asks an address where no server is.
    """
    nowhere = "-qq --isolated --retries 1 --index-url http://127.0.0.1:1/simple mcp-asdf-of-nowhere"
    pip_without_network = (
        f'[ "$5" != install ] || exec {shlex.quote(sys.executable)} -m pip download {nowhere}\n'
    )
    program(clone / ".venv/bin/python", f"#!/bin/sh\n{pip_without_network}")

    *_, line_before, last_line = lines_of_set_up(clone, "run", exit_code=1)

    assert last_line.startswith(
        "setup: no connection to the index of Python packages; connect to the network"
    )
    assert "installing the Python packages" in line_before
    assert not (clone / ".venv/ready-to-run").exists()


def without_quiet_options(call: list[str]) -> list[str]:
    """Return a call of pip without what says how much it prints, and Python by its name alone."""
    python, *words = call
    quiet_options = ("-qq", "--disable-pip-version-check")
    return [Path(python).name, *(word for word in words if word not in quiet_options)]


@pytest.mark.slow
def test_the_set_up_by_hand_that_contributing_shows_calls_the_same_programs(clone: Path) -> None:
    """The page's commands are those that the script runs, also for the environment of these tests."""
    lines = block_with(PAGE, "venv", "sh").splitlines()

    calls_of_script = python_calls_of_set_up(clone, "test")

    calls_by_hand = [shlex.split(line) for line in lines]
    assert list(map(without_quiet_options, calls_of_script)) == list(
        map(without_quiet_options, calls_by_hand)
    )


def take_newest_python(folder: Path, available: str) -> subprocess.CompletedProcess[str]:
    """Run ``.ci/newest`` for a project that supports Python 3.9 to 3.11, where uv has one version alone.

    A stand-in takes the place of uv.
    """
    (folder / ".ci").mkdir()
    shutil.copy(ROOT / ".ci/newest", folder / ".ci/newest")
    (folder / "pyproject.toml").write_text(
        "".join(f'    "Programming Language :: Python :: 3.{minor}",\n' for minor in (9, 11, 10))
    )
    program(folder / "bin/uv", f'#!/bin/sh\ncase "$*" in *" {available} "*) ;; *) exit 2 ;; esac\n')
    environment = {**os.environ, "PATH": f"{folder / 'bin'}:/usr/bin:/bin"}
    command = [str(folder / ".ci/newest"), "build/newest"]
    return subprocess.run(command, env=environment, capture_output=True, text=True, check=False)


def test_the_newest_python_that_can_be_had_is_taken_and_others_are_named(tmp_path: Path) -> None:
    """The project supports 3.9 to 3.11, and 3.11 cannot be had."""
    result = take_newest_python(tmp_path, available="3.10")

    assert result.returncode == 0
    assert result.stdout == "newest: Python 3.11 cannot be had here\nnewest: Python 3.10\n"


def test_where_no_supported_python_can_be_had_the_run_with_the_newest_fails(tmp_path: Path) -> None:
    """The project supports 3.9 to 3.11, and only 2.7 can be had."""
    result = take_newest_python(tmp_path, available="2.7")

    assert result.returncode == 1
    assert len(result.stdout.splitlines()) == 3, "3.9, 3.10 and 3.11 have a line: they cannot be had"
