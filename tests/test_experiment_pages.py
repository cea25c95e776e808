"""The pages about experiments are followed literally: files written, commands run, output compared.

They are the tutorial of an experiment, the guide with a filter of the reader's own, and the paper's figures.
"""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from support import FENCED, PATH, ROOT, block_with, run

TUTORIAL, GUIDE, REPRODUCE = (
    ROOT / f"docs/{name}.md" for name in ("experiment_tutorial", "experiments", "reproduce")
)
CLUSTER = re.compile("dask|tcp://")
"""A cluster's commands want several machines: tests/host_tools/experiments/test_sweep_cluster.py."""

SHORT = ("--trials", "2", "--steps", "4000")
"""Options by which a command of the study is run in a short form."""

ENVIRONMENT = {
    "MPLBACKEND": "Agg",
    # pip installs beside the page's files, from here, with the build tools that are there.
    "PIP_TARGET": "site",
    "PIP_NO_BUILD_ISOLATION": "0",
    "PIP_NO_DEPS": "1",
    "PIP_NO_INDEX": "1",
    "PYTHONPATH": "site",
}


def follow(page: Path, folder: Path) -> int:
    """Do in a folder what a page shows, and compare what it prints; return how many outputs were compared.

    A block of text below a block of commands, or below a program without a name, is what that prints; dots
    stand for what is left out.
    """
    compared, printed = 0, ""
    for language, code in FENCED.findall(page.read_text(encoding="utf-8")):
        first_line = code.split("\n", 1)[0]
        if name := re.fullmatch(r"# (\S+\.\w+)", first_line):
            path = folder / name[1]
            path.parent.mkdir(exist_ok=True)
            path.write_text(code, encoding="utf-8")
        elif language == "python":
            printed = run(sys.executable, "-c", code, cwd=folder, **ENVIRONMENT)
        elif language == "sh":
            printed = "" if CLUSTER.search(code) else run("sh", "-ec", code, cwd=folder, **ENVIRONMENT)
        elif language == "text":
            assert_shown(printed, code)
            compared, printed = compared + 1, ""
    return compared


def assert_shown(printed: str, shown: str) -> None:
    """Fail unless the lines that a page shows are those that were printed."""
    pattern = re.escape(shown).replace(re.escape("..."), ".*?")
    assert re.fullmatch(pattern, re.sub(" +$", "", printed, flags=re.MULTILINE), re.DOTALL), printed


@pytest.mark.slow
def test_the_tutorial_prints_what_it_shows(tmp_path: Path) -> None:
    assert follow(TUTORIAL, tmp_path) == 3
    assert {"one_trial.png", "comparison.png", "question.png"} <= {path.name for path in tmp_path.iterdir()}


@pytest.mark.slow
def test_the_guide_prints_what_it_shows_with_a_filter_of_the_readers(tmp_path: Path) -> None:
    pytest.importorskip("hatchling", reason="hatchling is not installed: make setup")
    assert follow(GUIDE, tmp_path) == 6
    assert (tmp_path / "beside.png").exists(), "the reader's filter beside the paper's"
    figures = {path.name for path in (tmp_path / "mine/figures").iterdir()}
    assert figures == {"physical_asdf-plus.png", "physical_scatter.png", "physical_scatter_beta.png"}
    # Without trials to spare the command gets no farther, but it has understood the page's options.
    [command] = [line for line in commands(REPRODUCE) if "beta" in line]
    environment = {"PATH": PATH, **ENVIRONMENT}
    done = subprocess.run(
        [*shlex.split(command), "--trials", "1"],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert "--trials is 1; give at least 2" in done.stderr


# --- The paper's figures ---------------------------------------------------------------------------------


def commands(page: Path) -> list[str]:
    return [
        line
        for language, code in FENCED.findall(page.read_text("utf-8"))
        if language == "sh"
        for line in code.splitlines()
    ]


def pictures_and_commands() -> dict[str, tuple[str, list[str]]]:
    """Return the command and the pictures of each row of the page's table, by the paper's figures."""
    rows = re.findall(r"^\| ([^|]+) \| `([^`]+)` \| ([^|]+) \|", REPRODUCE.read_text("utf-8"), re.MULTILINE)
    return {figures: (command, re.findall(r"`([^`]+)`", pictures)) for figures, command, pictures in rows}


def test_the_table_has_a_row_for_each_figure_of_the_paper() -> None:
    rows = pictures_and_commands()
    assert set(rows) == {"3", "4", "5", "6", "8", "all"}
    assert {command.split()[1] for command, _ in rows.values()} == {"reproduce"}


@pytest.mark.slow
@pytest.mark.parametrize("figures", ["5", "8"])
def test_a_command_of_the_table_makes_the_pictures_of_the_paper(figures: str, tmp_path: Path) -> None:
    """The parts of figure 5 are those of figures 3, 4 and 6, too."""
    command, pictures = pictures_and_commands()[figures]
    run(*shlex.split(command), *SHORT, cwd=tmp_path, **ENVIRONMENT)
    folder = tmp_path / "reproduction/figures"
    expected = set(pictures)
    if figures == "5":
        for others in ("3", "4", "6"):
            expected |= set(pictures_and_commands()[others][1])
    assert expected <= {path.name for path in folder.iterdir()}


@pytest.mark.slow
def test_the_quick_study_prints_what_the_page_shows(tmp_path: Path) -> None:
    [(command, shown)] = re.findall(
        r"^```sh\n(.*)\n```\n\n```text\n(.*?)^```$", REPRODUCE.read_text("utf-8"), re.MULTILINE | re.DOTALL
    )[:1]
    assert_shown(run(*shlex.split(command), cwd=tmp_path, **ENVIRONMENT), shown)


@pytest.mark.slow
def test_the_robust_filter_is_drawn_into_figure_5(tmp_path: Path) -> None:
    [command] = [line for line in commands(REPRODUCE) if "--filter robust" in line]
    printed = run(*shlex.split(command), *SHORT, cwd=tmp_path, **ENVIRONMENT)
    shown = block_with(REPRODUCE, "--filter robust", "text").removesuffix("\n...\n")
    assert_shown(printed, f"{shown} {' '.join(SHORT)}\n")
    names = {path.name for path in (tmp_path / "mine/figures").iterdir()}
    assert {"topologies_asdf-minus.png", "dynamic_scatter_robust.png"} <= names
