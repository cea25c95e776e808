"""The pages about experiments are followed literally: files written, commands run, output compared.

They are the tutorial of an experiment, the guide with a filter of the reader's own, and the paper's figures.
"""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import pytest

from support import FENCED, PATH, ROOT, block_with, names_in, run

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
def test_the_tutorial_of_an_experiment_prints_what_it_shows_and_draws_its_pictures(tmp_path: Path) -> None:
    outputs_compared = follow(TUTORIAL, tmp_path)

    assert outputs_compared == 3
    assert {"one_trial.png", "comparison.png", "question.png"} <= set(names_in(tmp_path))


@pytest.mark.slow
def test_the_guide_of_experiments_prints_what_it_shows_with_a_filter_of_the_reader_s(tmp_path: Path) -> None:
    """And draws the reader's filter, beta, beside the paper's; the second command below uses it, too.

    Without trials to spare that gets no farther, but it has understood the page's options.
    """
    pytest.importorskip("hatchling", reason="hatchling is not installed: make setup")

    outputs_compared = follow(GUIDE, tmp_path)

    assert outputs_compared == 6
    assert (tmp_path / "beside.png").exists()
    figures = {"physical_asdf-plus.png", "physical_scatter.png", "physical_scatter_beta.png"}
    assert set(names_in(tmp_path / "mine/figures")) == figures

    [command] = [line for line in commands(REPRODUCE) if "beta" in line]
    done = subprocess.run(
        [*shlex.split(command), "--trials", "1"],
        cwd=tmp_path,
        env={"PATH": PATH, **ENVIRONMENT},
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


@dataclass(frozen=True)
class PaperFigures:
    """A row of the page's table: a command, and the pictures that it makes like figures of the paper."""

    command: str
    pictures: set[str]


def paper_figures() -> dict[str, PaperFigures]:
    """Return the rows of the page's table, by the number of the paper's figure or "all"."""
    page = REPRODUCE.read_text("utf-8")
    rows = re.findall(r"^\| ([^|]+) \| `([^`]+)` \| ([^|]+) \|", page, re.MULTILINE)
    return {
        figures: PaperFigures(command, set(re.findall(r"`([^`]+)`", pictures)))
        for figures, command, pictures in rows
    }


def test_the_table_of_commands_has_a_row_for_each_figure_of_the_paper() -> None:
    assert set(paper_figures()) == {"3", "4", "5", "6", "8", "all"}


def test_the_table_of_commands_for_figures_has_only_commands_that_reproduce() -> None:
    for row in paper_figures().values():
        assert row.command.startswith("mcp-asdf reproduce")


@pytest.mark.slow
@pytest.mark.parametrize("figures", [("3", "4", "5", "6"), ("8",)])
def test_a_command_of_the_table_makes_the_pictures_of_the_paper(
    figures: tuple[str, ...], tmp_path: Path
) -> None:
    """One command makes all figures that come from the same trials: that for figure 5 also 3, 4 and 6."""
    rows = paper_figures()
    command = rows["5" if "5" in figures else "8"].command

    run(*shlex.split(command), *SHORT, cwd=tmp_path, **ENVIRONMENT)

    pictures = set[str]().union(*(rows[figure].pictures for figure in figures))
    assert pictures <= set(names_in(tmp_path / "reproduction/figures"))


@pytest.mark.slow
def test_the_quick_study_prints_what_the_page_shows(tmp_path: Path) -> None:
    """The command is a block of its own on the page, and its output the block below it."""
    page = REPRODUCE.read_text("utf-8")
    command_and_output = re.search(r"^```sh\n(.*)\n```\n\n```text\n([^`]*)^```$", page, re.MULTILINE)
    assert command_and_output is not None
    command, shown = command_and_output.groups()

    printed = run(*shlex.split(command), cwd=tmp_path, **ENVIRONMENT)

    assert_shown(printed, shown)


@pytest.mark.slow
def test_the_robust_filter_is_drawn_into_figure_5(tmp_path: Path) -> None:
    [command] = [line for line in commands(REPRODUCE) if "--filter robust" in line]

    printed = run(*shlex.split(command), *SHORT, cwd=tmp_path, **ENVIRONMENT)

    shown = block_with(REPRODUCE, "--filter robust", "text").removesuffix("\n...\n")
    assert_shown(printed, f"{shown} {' '.join(SHORT)}\n")
    pictures = {"topologies_asdf-minus.png", "dynamic_scatter_robust.png"}
    assert pictures <= set(names_in(tmp_path / "mine/figures"))
