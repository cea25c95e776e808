"""A newcomer's first hour: README and tutorials, in an environment with the base alone, then with an extra.

The environment is real but for the download: it finds the packages of this one, without those of extras that
are not installed there.
"""

from __future__ import annotations

import re
import sysconfig
from dataclasses import dataclass
from pathlib import Path

import pytest

import test_tutorials
from mcp_asdf_tools.common.extras import install_instruction
from support import HIDING, ROOT, block_with, blocks, names_in, require, run

pytestmark = pytest.mark.slow

README = ROOT / "README.md"
EXPERIMENT_TUTORIAL, INSTALLING = ROOT / "docs/experiment_tutorial.md", ROOT / "docs/installing.md"
SYSTEM_PATH = "/usr/local/bin:/usr/bin:/bin"
MAKE, INSTALL, ACTIVATE, FIRST_COMMAND = blocks(INSTALLING, "sh")[0].splitlines()
"""The lines by which docs/installing.md makes and tries an environment."""


def make_environment(folder: Path) -> None:
    """Make an environment in ``folder`` with the page's command, and put in place what pip would install."""
    run("sh", "-exc", f"{MAKE} --without-pip", cwd=folder)
    [packages] = folder.glob(".venv/lib/python*/site-packages")
    packages_here = sysconfig.get_path("purelib")
    (packages / "hiding.py").write_text(HIDING)
    (packages / "installed.pth").write_text(
        f"import site; site.addsitedir({packages_here!r})\nimport hiding\n"
    )
    program = folder / ".venv/bin/mcp-asdf"
    program.write_text(f'#!/bin/sh\nexec {program.with_name("python")} -m mcp_asdf_tools.cli.main "$@"\n')
    program.chmod(0o755)


@dataclass(frozen=True)
class Newcomer:
    """Somebody at a shell in the new environment.

    Attributes:
        folder: Where the shell is.
    """

    folder: Path

    def run_in_shell(self, *lines: str) -> str:
        """Run lines in the shell, and return what they print."""
        return run("sh", "-ec", "\n".join((ACTIVATE, *lines)), cwd=self.folder, MPLBACKEND="Agg")

    def run_python(self, program: str, shell_ending: str = "") -> str:
        """Run a program in Python, and return what it prints."""
        (self.folder / "program.py").write_text(program)
        return self.run_in_shell(f"python program.py {shell_ending}")


@pytest.fixture
def newcomer(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Newcomer:
    """Somebody whose environment has no extra; the variable EXTRAS names those that are installed later."""
    require("cc", "gcc libc6-dev")
    make_environment(tmp_path)
    monkeypatch.setattr("support.PATH", SYSTEM_PATH)
    monkeypatch.setenv("EXTRAS", "")
    return Newcomer(tmp_path)


def test_the_page_installs_all_extras() -> None:
    """An extra is a set of further packages. INSTALL is the line of docs/installing.md that installs."""
    assert re.fullmatch(r"\.venv/bin/python -m pip install '\.\[all\]'", INSTALL)


def test_the_first_command_of_the_page_runs(newcomer: Newcomer) -> None:
    """It is a swarm, made shorter here, and needs none of the extras. A command that fails raises."""
    newcomer.run_in_shell(f"{FIRST_COMMAND} --steps 300 --quiet")


def test_the_c_program_of_the_readme_prints_what_it_shows_in_a_new_environment(newcomer: Newcomer) -> None:
    """It needs a C compiler and the base alone, without any extra.

    The README has the program, the commands that build and run it, and what it prints.
    """
    [program] = blocks(README, "c")
    (newcomer.folder / "robot.c").write_text(program)

    commands = block_with(README, "robot.c", "sh")
    shown_output = block_with(README, "share of black 0.685", "text")

    printed = newcomer.run_in_shell(commands)

    assert printed.endswith(shown_output)


def test_the_first_program_of_the_python_api_prints_what_it_shows_in_a_new_environment(
    newcomer: Newcomer,
) -> None:
    """It needs the base alone, without any extra."""
    page = ROOT / "docs/api.md"
    printed = newcomer.run_python(block_with(page, "random.seed", "python"))
    assert printed == block_with(page, "tick 1000", "text")


def test_the_robot_of_the_tutorial_needs_no_extra(
    newcomer: Newcomer, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is built with the base alone: ``mcp-asdf firmware`` copies its C. The robot sees a black floor.

    The tutorial's commands find only programs of the system and of the newcomer's environment.
    """
    monkeypatch.setattr("support.PATH", f"{newcomer.folder}/.venv/bin:{SYSTEM_PATH}")

    printed = test_tutorials.build_first_robot(newcomer.folder)

    assert printed.endswith("share of black 1.000\n")


@pytest.fixture
def experiment_programs(newcomer: Newcomer) -> list[str]:
    """The programs of the experiment's tutorial, which are in the newcomer's folder as files, too."""
    programs = blocks(EXPERIMENT_TUTORIAL, "python")
    for program in programs:
        name = program.split("\n", 1)[0].removeprefix("# ")
        (newcomer.folder / name).write_text(program)
    return programs


def extra_of_experiment_tutorial() -> str:
    """Return the extra that the page says one needs."""
    page = EXPERIMENT_TUTORIAL.read_text(encoding="utf-8")
    [extra] = re.findall(r"with the extra `(\w+)`", page)
    return str(extra)


def test_the_experiment_of_the_tutorial_says_which_extra_it_lacks(
    newcomer: Newcomer, experiment_programs: list[str]
) -> None:
    """The base alone is installed; the page names the extra, a set of packages that its programs need."""
    first_program, *_other_programs = experiment_programs

    print_errors_and_exit_code = "2>&1 || echo exit code $?"
    printed = newcomer.run_python(first_program, print_errors_and_exit_code)

    *_, message, exit_code = printed.splitlines()
    extra_on_page = extra_of_experiment_tutorial()
    assert message.endswith(install_instruction(extra_on_page))
    assert exit_code == "exit code 1"


@pytest.mark.usefixtures("experiment_programs")
def test_the_experiment_of_the_tutorial_runs_with_the_extra_that_it_names(
    newcomer: Newcomer, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It draws its pictures, and ``mcp-asdf view`` makes a page of its results.

    Its programs are files in the newcomer's folder, which its commands run. Extras that the variable EXTRAS
    names count as installed.
    """
    monkeypatch.setenv("EXTRAS", extra_of_experiment_tutorial())

    newcomer.run_in_shell(*blocks(EXPERIMENT_TUTORIAL, "sh"))
    newcomer.run_in_shell(
        "mcp-asdf view question.parquet --where density=0.5 --where filter=none --export page.html"
    )

    pictures_and_page = {"one_trial.png", "comparison.png", "question.png", "page.html"}
    assert pictures_and_page <= set(names_in(newcomer.folder))
