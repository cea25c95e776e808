"""Experiments, and the files that describe them."""

from __future__ import annotations

import os
import re
from decimal import Decimal
from pathlib import Path

import pytest

from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.common.parameters import parameters_of
from mcp_asdf_tools.experiments.experiment import MAX_EXPERIMENTS, Experiment, combinations, grid
from mcp_asdf_tools.experiments.experiment_files import SHIPPED_STUDIES, read_experiments
from support import ROOT, block_with

# --- Values ----------------------------------------------------------------------------------------------


def test_an_experiment_is_made_again_from_the_parameters_that_its_results_keep() -> None:
    experiment = Experiment(
        omega=Decimal("0.15"), filter="asdf-minus", drift="linear", drift_rate=-1e-4, seed=2**64 - 1
    )
    assert Experiment(**experiment.parameters()) == experiment


def test_the_largest_grid_of_experiments_is_accepted() -> None:
    """A larger grid is refused, as test_an_error_in_a_file_of_experiments... shows."""
    all_combinations = list(combinations({"seed": [7] * MAX_EXPERIMENTS}))
    assert all_combinations == [{"seed": 7}] * MAX_EXPERIMENTS


# --- TOML ------------------------------------------------------------------------------------------------


def experiments_of(folder: Path, text: str) -> list[Experiment]:
    """Write a text to the file ``grid.toml``, and return the experiments that it describes."""
    path = folder / "grid.toml"
    path.write_text(text, encoding="utf-8")
    return read_experiments(path)


def test_a_study_that_comes_with_the_program_is_read_by_its_name() -> None:
    assert read_experiments("physical") == read_experiments(SHIPPED_STUDIES / "physical.toml")


def test_lists_of_values_in_a_file_describe_experiments_of_all_their_combinations(tmp_path: Path) -> None:
    experiments = experiments_of(tmp_path, 'steps = 1e3\nflawed = [1, 3]\nfilter = ["none", "asdf-plus"]\n')

    flawed_and_filters = [(experiment.flawed, experiment.filter) for experiment in experiments]
    assert flawed_and_filters == [(1, "none"), (1, "asdf-plus"), (3, "none"), (3, "asdf-plus")]
    assert [experiment.steps for experiment in experiments] == [1000] * 4


def test_each_grid_of_a_file_takes_the_keys_above_the_first_grid_and_may_change_them(tmp_path: Path) -> None:
    """The first grid gives another key. The second one changes both keys that stand above the first."""
    keys_above = "trials = 2\nflawed = 1\n"
    first_grid = "[[grid]]\nfill_ratio = 0.9\n"
    second_grid = '[[grid]]\nflawed = "50%"\ntrials = 3\n'
    first, second = experiments_of(tmp_path, keys_above + first_grid + second_grid)

    assert (first.trials, first.flawed, first.fill_ratio) == (2, 1, 0.9)
    assert (second.trials, second.flawed) == (3, 10)  # half of 20 robots
    default_fill_ratio = Experiment().fill_ratio
    assert second.fill_ratio == default_fill_ratio


def test_tables_in_a_file_give_values_that_are_not_combined_with_those_of_other_tables(
    tmp_path: Path,
) -> None:
    """Swarms with one flawed robot have seeds 5 and 6; with two, seed 7. Each runs with 8 and 9 steps.

    The names of lists of tables, here who and more, do not matter. A value in a table, here of the seed,
    replaces the value outside.
    """
    text = """\
who = [{flawed = 1, seed = [5, 6]}, {flawed = 2, more = [{seed = 7}]}]
seed = 4
steps = [8, 9]
"""
    experiments = experiments_of(tmp_path, text)

    flawed_seed_and_steps = [
        (experiment.flawed, experiment.seed, experiment.steps) for experiment in experiments
    ]
    assert flawed_seed_and_steps == [(1, 5, 8), (1, 5, 9), (1, 6, 8), (1, 6, 9), (2, 7, 8), (2, 7, 9)]


def test_the_library_s_grid_makes_the_same_experiments_as_a_file_of_equal_values(tmp_path: Path) -> None:
    """Values that belong together are in a list of dictionaries here, and in a list of tables in the file."""
    text = "who = [{flawed = 1, seed = [5, 6]}, {flawed = 2, seed = 7}]\nseed = 4\nsteps = [8, 9]\n"
    who = [{"flawed": 1, "seed": [5, 6]}, {"flawed": 2, "seed": 7}]
    assert grid(who=who, seed=4, steps=[8, 9]) == experiments_of(tmp_path, text)


def test_a_graph_is_looked_for_in_the_folder_of_the_file_that_names_it(tmp_path: Path) -> None:
    """A graph is a file that says which robots are neighbours. Here it stands beside grid.toml.

    An experiment keeps the edges of its graph, so it is compared with one that got the file's whole path.
    """
    edges_of_a_triangle = "0 1\n1 2\n2 0\n"
    (tmp_path / "ring").write_text(edges_of_a_triangle)
    (experiment,) = experiments_of(tmp_path, 'topology = "graph"\ngraph = "ring"\nrobots = 3\n')

    experiment_of_path = Experiment(topology="graph", graph=str(tmp_path / "ring"), robots=3)
    assert experiment.graph == experiment_of_path.graph


@pytest.mark.parametrize("graph", ["pipe", "/dev/zero", "absent", "a" * 300])
def test_a_graph_that_is_no_regular_file_is_refused_and_not_opened(graph: str, tmp_path: Path) -> None:
    """The four are a pipe, a device, a missing file and a name that is too long for any file.

    Reading a pipe that nobody writes would wait for ever.
    """
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(UsageError, match=r"line 2: graph is '.*', which is no regular file; give"):
        experiments_of(tmp_path, f'topology = "graph"\ngraph = "{graph}"\n')


@pytest.mark.parametrize(
    ("text", "expected_message"),
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
        (
            "topology = 'dynamic'\nrobots = 129\nfirmware = 'mirror'\n",
            "line 3: robots is 129, .* ids of 7 bits; take at most 128",
        ),
        ("grid = 3\n", r"write \[\[grid\]\]"),
        ("steps = 5\ngrid = []\n", r"write \[\[grid\]\]"),
        ("grid = [{}, 3]\n", r"write \[\[grid\]\]"),
        ("steps = [[1]]\n", "line 1: steps is"),
        ("x = [\n{robots = 3},\n{steps = 9, robots = 0}]\n", "line 2 or 3: robots is 0"),
        ("x = [{}, 3]\n", "line 1: unknown key 'x'"),
        (f"seed = {list(range(400))}\nsteps = {list(range(1, 400))}\n", "line 2: steps makes 159600"),
    ],
)
def test_an_error_in_a_file_of_experiments_is_reported_with_file_line_and_key(
    tmp_path: Path, text: str, expected_message: str
) -> None:
    """The text is written to the file grid.toml. The expected message has the line and the key."""
    with pytest.raises(UsageError, match=expected_message) as error:
        experiments_of(tmp_path, text)
    assert str(tmp_path / "grid.toml") in str(error.value)


PAGE_OF_AUTHORS = ROOT / "docs/platforms/authors.md"
"""The page on how to run the experiments of the paper's authors here."""


def test_docs_platforms_authors_md_translates_the_four_experiments_of_the_authors_template(
    tmp_path: Path,
) -> None:
    """The authors' programs come with a file of four experiments. The page has the same file in our TOML."""
    toml_on_the_page = block_with(PAGE_OF_AUTHORS, "robots = 10", "toml")
    assert experiments_of(tmp_path, toml_on_the_page) == grid(
        robots=10,
        flawed=[1, 2, 3, 4],
        flawed_accuracy=0.75,
        filter="asdf-minus",
        omega="0.1",
        comms_period=10,
        filter_period=250,
        steps=1000,
        trials=2,
    )


def third_column_of_the_table_of_keys() -> list[str]:
    """Return the names at the beginning of the third cells in the table of keys on the page."""
    page = PAGE_OF_AUTHORS.read_text(encoding="utf-8")
    (rows,) = re.findall(r"\| theirs, YAML .*\n((?:\|.*\n)+)", page)
    return re.findall(r"^\|[^|]*\|[^|]*\| `(\w+)", rows, re.MULTILINE)


def test_docs_platforms_authors_md_translates_the_authors_keys_into_parameters_that_exist() -> None:
    """A row of its table has their keys in YAML and for ARGoS; its third cell begins with our parameter."""
    our_parameters = third_column_of_the_table_of_keys()
    assert len(our_parameters) > 15, "the rows of the table have been found"
    assert set(our_parameters) <= set(parameters_of(Experiment))


@pytest.mark.parametrize("text", ["", "\n# steps = 10\n", "[[grid]]\n", "[[grid]]\n[[grid]]\n"])
def test_a_file_of_experiments_without_any_parameter_is_refused(text: str, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"grid\.toml names no parameter; give at least one, such as trials"):
        experiments_of(tmp_path, text)


def test_a_file_of_experiments_may_begin_with_a_byte_order_mark(tmp_path: Path) -> None:
    """Some editors write one, the character FEFF, at the beginning of a text."""
    assert experiments_of(tmp_path, "\ufeffsteps = 5\n") == [Experiment(steps=5)]


@pytest.mark.parametrize(
    ("name", "expected_message"),
    [
        ("grid.json", r"name it \.toml"),
        ("absent.toml", "cannot read"),
        ("studio", "no file studio; those that come with the program are .*physical"),
    ],
)
def test_a_file_of_experiments_that_is_missing_or_not_toml_is_refused(
    name: str, expected_message: str
) -> None:
    """A name without a suffix is that of a study that comes with the program. There is no studio."""
    with pytest.raises(UsageError, match=expected_message):
        read_experiments(Path(name))
