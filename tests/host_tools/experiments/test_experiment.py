"""Experiments, and the files that describe them."""

from __future__ import annotations

import os
import re
from decimal import Decimal
from pathlib import Path
from typing import Any

import pytest

from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.common.parameters import parameters_of
from mcp_asdf_tools.experiments.experiment import MAX_EXPERIMENTS, Experiment, combinations, grid
from mcp_asdf_tools.experiments.experiment_files import STUDIES, read_experiments
from mcp_asdf_tools.world.graph import MAX_ON_BUS
from support import ROOT, blocks

# --- Values ----------------------------------------------------------------------------------------------


def test_parameters_come_back() -> None:
    changes: dict[str, Any] = {
        "filter": "asdf-minus",
        "drift": "linear",
        "drift_rate": -1e-4,
        "seed": 2**64 - 1,
    }
    experiment = Experiment(omega=Decimal("0.15"), **changes)
    assert Experiment(**experiment.parameters()) == experiment
    whole, exact = Experiment(true_accuracy=1, fill_ratio=0), Experiment(true_accuracy=1.0, fill_ratio=0.0)

    assert repr(whole) == repr(exact)
    assert Experiment(robots=MAX_ON_BUS, firmware="mirror").parameter_lacking_in_c == "firmware"
    assert next(combinations({"seed": [7] * MAX_EXPERIMENTS})) == {"seed": 7}


# --- TOML ------------------------------------------------------------------------------------------------


def experiments_of(folder: Path, text: str) -> list[Experiment]:
    path = folder / "grid.toml"
    path.write_text(text, encoding="utf-8")
    return read_experiments(path)


def test_files_describe_grids_on_the_keys_above_them(tmp_path: Path) -> None:
    assert read_experiments("physical") == read_experiments(STUDIES / "physical.toml")
    found = experiments_of(tmp_path, 'steps = 1e3\nflawed = [1, 3]\nfilter = ["none", "asdf-plus"]\n')
    assert [(each.flawed, each.filter) for each in found] == [
        (flawed, mode) for flawed in (1, 3) for mode in ("none", "asdf-plus")
    ]
    assert {each.steps for each in found} == {1000}
    text = 'trials = 2\nflawed = 1\n[[grid]]\nfill_ratio = 0.9\n[[grid]]\nflawed = "50%"\ntrials = 3\n'
    found = experiments_of(tmp_path, text)
    assert [(each.trials, each.flawed, each.fill_ratio) for each in found] == [(2, 1, 0.9), (3, 10, 0.55)]
    text = (
        "who = [{flawed = 1, seed = [5, 6]}, {flawed = 2, more = [{seed = 7}]}]\nseed = 4\nsteps = [8, 9]\n"
    )
    found = experiments_of(tmp_path, text)
    expected = [(1, 5, 8), (1, 5, 9), (1, 6, 8), (1, 6, 9), (2, 7, 8), (2, 7, 9)]
    assert [(each.flawed, each.seed, each.steps) for each in found] == expected
    (tmp_path / "ring").write_text("0 1\n1 2\n2 0\n")
    (wired,) = experiments_of(tmp_path, 'topology = "graph"\ngraph = "ring"\nrobots = 3\n')

    assert wired.graph == Experiment(topology="graph", graph=str(tmp_path / "ring"), robots=3).graph
    assert found == grid(who=[{"flawed": 1, "seed": [5, 6]}, {"flawed": 2, "seed": 7}], seed=4, steps=[8, 9])


@pytest.mark.parametrize("graph", ["pipe", "/dev/zero", "absent", "a" * 300])
def test_a_graph_of_a_file_of_experiments_is_a_regular_file(graph: str, tmp_path: Path) -> None:
    """Reading a pipe that nobody writes would wait for ever."""
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(UsageError, match=r"line 2: graph is '.*', which is no regular file; give"):
        experiments_of(tmp_path, f'topology = "graph"\ngraph = "{graph}"\n')


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("steps = 10\nrobotz = 3\n", "line 2: unknown key 'robotz'"),
        ("\n\nrobots = [3, 0]\n", "line 3: robots is 0"),
        ("steps = 1\n[[grid]]\nfilter = 'x'\n", "line 3: filter is 'x'"),
        ("steps = 1\n[[grid]]\n[[grid]]\nsteps = 0\n", "line 4: steps is 0"),
        ("flawed = 2.5\n[[grid]]\nseed = 1\n", "line 1: flawed is 2.5; give a count, 0 to 20, or a share"),
        ("trials = []\n", "line 1: trials makes 0"),
        ("steps = \n", "line 1"),
        ("memory = 63\n", "line 1: memory is 63; it must be 64 to 2147483648"),
        ("conventions = 'authors'\n", "line 1: .*choose firmware reference"),
        ("grid = 3\n", r"write \[\[grid\]\]"),
        ("grid = []\n", r"write \[\[grid\]\]"),
        ("steps = 5\ngrid = []\n", r"write \[\[grid\]\]"),
        ("grid = [{}, 3]\n", r"write \[\[grid\]\]"),
        ("steps = [[1]]\n", "line 1: steps is"),
        ("x = [\n{robots = 3},\n{steps = 9, robots = 0}]\n", "line 2 or 3: robots is 0"),
        ("x = [{}, 3]\n", "line 1: unknown key 'x'"),
        (f"seed = {list(range(400))}\nsteps = {list(range(1, 400))}\n", "line 2: steps makes 159600"),
    ],
)
def test_an_error_names_file_and_line(tmp_path: Path, text: str, words: str) -> None:
    with pytest.raises(UsageError, match=words) as error:
        experiments_of(tmp_path, text)
    assert str(tmp_path / "grid.toml") in str(error.value)


def test_the_page_translates_the_authors_template(tmp_path: Path) -> None:
    """Each parameter that its table of their keys names is one of ours, and its file is read."""
    page = ROOT / "docs/platforms/authors.md"
    (text,) = (block for block in blocks(page, "toml") if block.startswith("robots = 10"))
    found = experiments_of(tmp_path, text)
    assert [(each.robots, each.flawed, each.comms_period) for each in found] == [
        (10, flawed, 10) for flawed in (1, 2, 3, 4)
    ]
    assert {(each.filter, str(each.omega), each.steps) for each in found} == {("asdf-minus", "0.1", 1000)}
    (table,) = re.findall(r"\| theirs, YAML .*\n((?:\|.*\n)+)", page.read_text(encoding="utf-8"))
    our_cells = [row.split("|")[3] for row in table.splitlines()]
    names = {name for cell in our_cells for name in re.findall(r"^ `(\w+)", cell)}

    assert len(names) > 15
    assert names <= set(parameters_of(Experiment))


@pytest.mark.parametrize("text", ["", "\n# steps = 10\n", "[[grid]]\n", "[[grid]]\n[[grid]]\n"])
def test_a_file_that_names_no_parameter_is_refused(text: str, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"grid\.toml names no parameter; give at least one, such as trials"):
        experiments_of(tmp_path, text)


def test_a_file_may_begin_with_a_byte_order_mark(tmp_path: Path) -> None:
    assert experiments_of(tmp_path, "\ufeffsteps = 5\n") == [Experiment(steps=5)]


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("grid.json", r"name it \.toml"),
        ("absent.toml", "cannot read"),
        ("studio", "no file studio; those that come with the program are .*physical"),
    ],
)
def test_other_files_are_refused(name: str, words: str) -> None:
    with pytest.raises(UsageError, match=words):
        read_experiments(Path(name))
