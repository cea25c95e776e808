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

from paper_figures import REPRODUCE, rows_by_figure_of_the_paper
from support import FENCED, PATH, ROOT, block_with, blocks, names_in, run

TUTORIAL, GUIDE = ROOT / "docs/experiment_tutorial.md", ROOT / "docs/experiments.md"
CLUSTER = re.compile("dask|tcp://")
"""A cluster's commands want several machines: tests/host_tools/experiments/test_sweep_cluster.py."""

SHORT_RUN_OPTIONS = ("--trials", "2", "--steps", "4000")
"""What is appended to a command of the study, so that it does not take long."""

ENVIRONMENT = {
    "MPLBACKEND": "Agg",
    # pip installs beside the page's files, from here, with the build tools that are there.
    "PIP_TARGET": "site",
    "PIP_NO_BUILD_ISOLATION": "0",
    "PIP_NO_DEPS": "1",
    "PIP_NO_INDEX": "1",
    "PYTHONPATH": "site",
}


@dataclass(frozen=True)
class Output:
    """What a page says that a program prints, and what it has printed."""

    shown: str
    printed: str

    @property
    def is_as_shown(self) -> bool:
        """Whether these are the same lines; dots stand for what is left out of the page."""
        pattern = re.escape(self.shown).replace(re.escape("..."), ".*?")
        printed = re.sub(" +$", "", self.printed, flags=re.MULTILINE)
        return re.fullmatch(pattern, printed, re.DOTALL) is not None


def follow(page: Path, folder: Path) -> list[Output]:
    """Do in a folder what a page shows, and return each output that it shows with what was printed.

    A block of text below a block of commands, or below a program without a name, is what that prints.
    """
    outputs, printed = [], ""
    for language, code in FENCED.findall(page.read_text(encoding="utf-8")):
        name_of_file = re.match(r"# (\S+\.\w+)\n", code)  # in a comment, if the block is a file
        if name_of_file is not None:
            path = folder / name_of_file[1]
            path.parent.mkdir(exist_ok=True)
            path.write_text(code, encoding="utf-8")
        elif language == "python":
            printed = run(sys.executable, "-c", code, cwd=folder, **ENVIRONMENT)
        elif language == "sh":
            printed = "" if CLUSTER.search(code) else run("sh", "-ec", code, cwd=folder, **ENVIRONMENT)
        elif language == "text":
            outputs.append(Output(code, printed))
            printed = ""
    return outputs


def commands(page: Path) -> list[str]:
    """Return the lines of all blocks of commands of a page."""
    return "".join(blocks(page, "sh")).splitlines()


@pytest.mark.slow
def test_the_tutorial_of_an_experiment_prints_what_it_shows_and_draws_its_pictures(tmp_path: Path) -> None:
    """Its programs and commands are run one after the other in an empty folder. Three of them print."""
    outputs = follow(TUTORIAL, tmp_path)

    assert len(outputs) == 3
    for output in outputs:
        assert output.is_as_shown
    assert {"one_trial.png", "comparison.png", "question.png"} <= set(names_in(tmp_path))


@dataclass(frozen=True)
class FollowedGuide:
    """The folder in which the guide of experiments was followed, and the outputs that the guide shows."""

    folder: Path
    outputs: list[Output]


@pytest.fixture(scope="module")
def followed_guide(tmp_path_factory: pytest.TempPathFactory) -> FollowedGuide:
    """Follow the guide of experiments, in which the reader writes a filter called beta and installs it."""
    pytest.importorskip("hatchling", reason="hatchling is not installed: make setup")
    folder = tmp_path_factory.mktemp("guide")
    return FollowedGuide(folder, follow(GUIDE, folder))


@pytest.mark.slow
def test_the_guide_of_experiments_prints_what_it_shows(followed_guide: FollowedGuide) -> None:
    """Its programs and commands have been run one after the other in an empty folder. Six of them print."""
    assert len(followed_guide.outputs) == 6
    for output in followed_guide.outputs:
        assert output.is_as_shown


@pytest.mark.slow
def test_the_guide_of_experiments_draws_the_reader_s_own_filter_beside_the_paper_s(
    followed_guide: FollowedGuide,
) -> None:
    """The reader's filter is called beta. The last commands of the guide draw the pictures."""
    assert (followed_guide.folder / "beside.png").exists()
    pictures = names_in(followed_guide.folder / "mine/figures")
    assert pictures == ["physical_asdf-plus.png", "physical_scatter.png", "physical_scatter_beta.png"]


@pytest.mark.slow
def test_the_command_with_the_reader_s_own_filter_on_the_page_about_the_paper_s_figures_is_understood(
    followed_guide: FollowedGuide,
) -> None:
    """It is run with a single trial: the error about that shows that all other options were understood.

    The reader's filter is called beta, and has been installed by following the guide.
    """
    [command] = [line for line in commands(REPRODUCE) if "beta" in line]

    completed = subprocess.run(
        [*shlex.split(command), "--trials", "1"],
        cwd=followed_guide.folder,
        env={"PATH": PATH, **ENVIRONMENT},
        capture_output=True,
        text=True,
        check=False,
    )

    assert "--trials is 1; give at least 2" in completed.stderr


# --- The paper's figures ---------------------------------------------------------------------------------


def test_the_page_about_the_paper_s_figures_has_a_command_for_each_of_them_and_for_all() -> None:
    """A row of its table has the number of a figure, or "all", and the command that makes it."""
    rows = rows_by_figure_of_the_paper()

    assert set(rows) == {"3", "4", "5", "6", "8", "all"}
    for row in rows.values():
        assert row.command.startswith("mcp-asdf reproduce")


@pytest.mark.slow
def test_the_command_for_figure_8_of_the_paper_makes_its_pictures(tmp_path: Path) -> None:
    """Two options make the run short, with few trials and steps. A test below has the other figures."""
    row = rows_by_figure_of_the_paper()["8"]

    run(*shlex.split(row.command), *SHORT_RUN_OPTIONS, cwd=tmp_path, **ENVIRONMENT)

    assert set(row.pictures) <= set(names_in(tmp_path / "reproduction/figures"))


@pytest.mark.slow
def test_the_quick_study_prints_what_the_page_about_the_paper_s_figures_shows(tmp_path: Path) -> None:
    """The command is a block of its own on the page, and its output the block below it."""
    page = REPRODUCE.read_text("utf-8")
    command_and_output = re.search(r"^```sh\n(.*)\n```\n\n```text\n([^`]*)^```$", page, re.MULTILINE)
    assert command_and_output is not None
    command, shown = command_and_output.groups()

    printed = run(*shlex.split(command), cwd=tmp_path, **ENVIRONMENT)

    assert Output(shown, printed).is_as_shown


@pytest.mark.slow
def test_the_command_with_the_robust_filter_prints_what_the_page_shows_and_draws_the_filter(
    tmp_path: Path,
) -> None:
    """The page shows the beginning of the output, and the command that repeats the study at its end.

    Here two options more make the run short, and so they also stand at the end of that command. It is the
    command for figure 5 with a filter more, so it makes the pictures of the paper's figures 3 to 6, too.
    """
    [command] = [line for line in commands(REPRODUCE) if "--filter robust" in line]
    rows = rows_by_figure_of_the_paper()
    assert command.startswith(rows["5"].command)

    printed = run(*shlex.split(command), *SHORT_RUN_OPTIONS, cwd=tmp_path, **ENVIRONMENT)

    shown = block_with(REPRODUCE, "--filter robust", "text").removesuffix("\n...\n")
    shown_with_short_options = f"{shown} {' '.join(SHORT_RUN_OPTIONS)}\n"
    assert Output(shown_with_short_options, printed).is_as_shown
    pictures = {"dynamic_scatter_robust.png"}.union(*(rows[figure].pictures for figure in "3456"))
    assert pictures <= set(names_in(tmp_path / "mine/figures"))
