"""Results as tables and files: they come back as they were measured, and damaged ones are refused."""

from __future__ import annotations

import csv
import json
import os
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa  # type: ignore[import-untyped]
import pyarrow.parquet as pq  # type: ignore[import-untyped]
import pytest

from host_tools.test_untrusted import PARSERS, try_to_read, valid_results_table
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.common.versions import software_versions
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.result_files import (
    collect_rows,
    read_table,
    stream_experiments,
    write_tables,
)
from mcp_asdf_tools.experiments.result_tables import (
    FORMAT,
    experiments_in,
    read_metadata,
    score_table,
    trials_to_table,
)
from mcp_asdf_tools.experiments.results import (
    QUANTITIES,
    Trials,
    describe_differences,
    select_experiments,
    single_experiment,
    write_csv,
)
from mcp_asdf_tools.experiments.scores import SCORES, Limits
from mcp_asdf_tools.experiments.trials import run_trials
from support import draws

SHORT = Experiment(robots=4, flawed=1, filter="asdf-plus", steps=300, filter_period=100, trials=3)
OTHER = replace(SHORT, filter="none", seed=2**64 - 1)


@pytest.fixture(scope="module")
def results_path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A file, only to be read, of two experiments with recorded values.

    The trials of the first experiment are in the order 2, 0, 1.
    """
    path = tmp_path_factory.mktemp("results") / "results.parquet"
    tables = [
        trials_to_table(run_trials(SHORT, 2, 1, sampling_interval=10)),
        trials_to_table(run_trials(SHORT, 0, 2, sampling_interval=10)),
        trials_to_table(run_trials(OTHER, 0, 3, sampling_interval=10)),
    ]
    write_tables(path, [pa.concat_tables(tables)])
    return path


@pytest.fixture(scope="module")
def experiments(results_path: Path) -> list[Trials]:
    """The two experiments of the file, with the trials 0 to 2 of each."""
    return experiments_in(read_table(results_path))


@pytest.fixture(scope="module")
def measured() -> list[Trials]:
    """The same experiments, as they were measured."""
    return [run_trials(experiment, 0, 3, sampling_interval=10) for experiment in (SHORT, OTHER)]


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """Path of a file that a test writes."""
    return tmp_path / "results.parquet"


# --- What is read is what was written --------------------------------------------------------------------


def test_a_file_gives_back_the_experiments_in_the_order_of_their_first_rows(
    experiments: list[Trials],
) -> None:
    assert [trials.experiment for trials in experiments] == [SHORT, OTHER]
    assert [trials.numbers for trials in experiments] == [[0, 1, 2], [0, 1, 2]]


@pytest.mark.parametrize("name", ["convergence_steps", "errors", "b_hat", "tests", "updates"])
def test_a_file_gives_back_all_measured_values(
    name: str, experiments: list[Trials], measured: list[Trials]
) -> None:
    for read_trials, measured_trials in zip(experiments, measured, strict=True):
        assert np.array_equal(getattr(read_trials, name), getattr(measured_trials, name))


@pytest.mark.parametrize("name", QUANTITIES)
def test_a_file_gives_back_all_recorded_values(
    name: str, experiments: list[Trials], measured: list[Trials]
) -> None:
    for read_trials, measured_trials in zip(experiments, measured, strict=True):
        assert np.array_equal(read_trials.records[name], measured_trials.records[name])


def test_a_file_gives_back_how_often_values_were_recorded(experiments: list[Trials]) -> None:
    """Values of 4 robots were recorded at step 0 and 30 times in 300 steps of 3 trials."""
    assert experiments[0].sampling_interval == 10
    assert experiments[0].records["x"].shape == (3, 31, 4)


def test_a_file_of_one_robot_without_records_comes_back(path: Path) -> None:
    """The smallest lists: a file must not take them for missing ones."""
    experiment = replace(SHORT, robots=1)
    write_tables(path, [trials_to_table(run_trials(experiment, 0, 1))])
    [trials] = experiments_in(read_table(path))
    assert (trials.experiment, trials.records) == (experiment, {})


def test_experiments_read_one_by_one_may_be_spread_over_files(tmp_path: Path) -> None:
    for number, experiment in enumerate((SHORT, OTHER, SHORT)):
        table = trials_to_table(run_trials(experiment, number, 1))
        write_tables(tmp_path / f"{number}.parquet", [table])
    streamed = list(stream_experiments(tmp_path))

    assert [(trials.experiment, trials.numbers) for trials in streamed] == [(SHORT, [0, 2]), (OTHER, [1])]


def test_small_tables_are_joined_until_they_have_enough_bytes() -> None:
    """Five tables of one row, and two of them are enough; the last one stays alone."""
    table = trials_to_table(run_trials(SHORT, 0, 1))
    larger_tables = collect_rows([table] * 5, min_bytes=2 * table.nbytes)
    assert [len(larger_table) for larger_table in larger_tables] == [2, 2, 1]


def test_any_reader_of_parquet_finds_parameters_and_results_of_a_trial(results_path: Path) -> None:
    """The fixture has trials 2, 0 and 1 in its first rows; the second is compared with trial 0, run again."""
    row = pq.read_table(results_path).to_pylist()[1]
    trials = run_trials(SHORT, 0, 1)

    assert {name: row[name] for name in SHORT.parameters()} == SHORT.parameters()
    assert row["trial"] == 0
    assert row["k"] == trials.convergence_steps[0].tolist()
    assert row["e"] == trials.errors[0].tolist()
    assert row["b_hat"] == trials.b_hat.ravel().tolist()
    assert [row[name] for name in SCORES] == [scores[0] for scores in trials.scores().values()]


def test_the_metadata_describe_every_column(results_path: Path) -> None:
    schema = pq.read_schema(results_path)
    columns = json.loads(schema.metadata[b"mcp-asdf"])["columns"]

    assert list(columns) == schema.names
    assert all(column["meaning"] for column in columns.values())
    for name, unit in {
        "k": "step",
        "tile": "m",
        "speed": "m/s",
        "H": "point of 100",
        "fill_ratio": "1",
    }.items():
        assert columns[name]["unit"] == unit
    assert columns["filter_period"]["unit"] == "step"


def test_a_file_s_metadata_say_how_its_results_were_made(results_path: Path) -> None:
    """The version of the file format, those of the software, and how often values were recorded, in steps.

    delta is how much an estimate that counts as converged may still change.
    """
    assert read_metadata(read_table(results_path)) == {
        "format": FORMAT,
        "versions": software_versions(),
        "delta": 0.01,
        "sampling_interval": 10,
    }


# --- Choosing experiments --------------------------------------------------------------------------------


def test_a_number_selects_experiments_in_any_of_its_spellings(experiments: list[Trials]) -> None:
    assert select_experiments(experiments, {"steps": "3e2", "fill_ratio": 0.55}) == experiments


def test_a_seed_of_64_bits_selects_its_experiment(experiments: list[Trials]) -> None:
    assert select_experiments(experiments, {"seed": "18446744073709551615"}) == [experiments[1]]


def test_a_single_experiment_can_be_selected_by_a_text(experiments: list[Trials]) -> None:
    assert single_experiment(select_experiments(experiments, {"filter": "none"})) is experiments[1]


def test_a_misspelt_parameter_is_answered_with_the_nearest(experiments: list[Trials]) -> None:
    message = r"did you mean filter\?; the experiments differ in seed=1\|18446744073709551615, filter="
    with pytest.raises(UsageError, match=message):
        select_experiments(experiments, {"filtr": "none"})


@pytest.mark.parametrize(
    ("condition", "message"),
    [
        ({"filter": "non"}, "filter=non: no experiment has it; filter is asdf-plus or none"),
        ({"steps": "many"}, "steps=many: no experiment has it; steps is 300"),
    ],
)
def test_a_condition_that_nothing_meets_is_answered_with_the_values(
    condition: dict[str, str], message: str, experiments: list[Trials]
) -> None:
    with pytest.raises(UsageError, match=message):
        select_experiments(experiments, condition)


def test_several_experiments_in_place_of_one_are_refused_with_their_differences(
    experiments: list[Trials],
) -> None:
    with pytest.raises(UsageError, match=r"2 experiments match; choose one with where seed=1\|"):
        single_experiment(experiments)


def test_a_single_experiment_differs_in_no_parameters(experiments: list[Trials]) -> None:
    assert describe_differences(experiments[:1]) == "no parameters"


# --- Old and damaged files -------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("name", [*Experiment().parameters()])
def test_results_without_a_parameter_have_its_default(name: str, path: Path) -> None:
    values = {"trials": 1, "robots": 20, "flawed": 6, name: getattr(Experiment(), name)}
    experiment = replace(SHORT, **values)
    pq.write_table(trials_to_table(run_trials(experiment, 0, 1)).drop_columns([name]), path)
    [trials] = stream_experiments(path)

    assert trials.experiment == experiments_in(read_table(path))[0].experiment
    assert trials.experiment.parameters()[name] == Experiment().parameters()[name]


def test_a_table_without_a_parameter_can_be_scored_again() -> None:
    table = trials_to_table(run_trials(SHORT, 0, 2))
    scored_table = score_table(table.drop_columns(["latency"]), Limits())
    assert scored_table["H"].equals(table["H"])


def test_results_from_before_a_parameter_can_be_read_together_with_newer_ones(tmp_path: Path) -> None:
    table = trials_to_table(run_trials(SHORT, 0, 2))
    pq.write_table(table.drop_columns(["latency"]), tmp_path / "1.parquet")
    pq.write_table(table, tmp_path / "2.parquet")
    assert read_table(tmp_path)["latency"].to_pylist() == [0, 0, 0, 0]


FORMAT_5_FILE = Path(__file__).with_name("results_format_5.parquet")
"""Two trials of an experiment of three robots and two of one of two, written in format 5.

Values of 20 steps are recorded every 10 steps. In format 5 each record is one flat list.
"""


def test_results_in_format_5_give_back_their_records_by_step_and_robot() -> None:
    three_robots, two_robots = stream_experiments(FORMAT_5_FILE)
    assert three_robots.records["x"].shape == (2, 3, 3)
    assert three_robots.records["t"][0].tolist() == [[0, 0, 0], [10, 10, 10], [20, 20, 20]]
    assert two_robots.records["x"][1, 2].tolist() == [0.6703321933746338, 0.6703321933746338]


def test_results_in_format_5_are_read_as_a_table_of_the_present_format() -> None:
    table = read_table(FORMAT_5_FILE)
    new_table = trials_to_table(run_trials(SHORT, 0, 1, sampling_interval=10))

    assert table.schema.equals(new_table.schema)
    assert read_metadata(table)["format"] == FORMAT
    assert table["record_t"].to_pylist()[2] == [[0, 0], [10, 10], [20, 20]]


def test_a_table_in_format_5_that_another_program_has_read_gives_back_its_records() -> None:
    three_robots, _ = experiments_in(pq.read_table(FORMAT_5_FILE))
    assert three_robots.records["t"][1, 2].tolist() == [20, 20, 20]


@pytest.mark.parametrize("robots", [0, 2, 2**64 - 1])
def test_a_flat_record_without_a_value_of_each_robot_at_each_step_is_refused(robots: int, path: Path) -> None:
    """The first record has 9 values."""
    table = pq.read_table(FORMAT_5_FILE)
    robots_column = pa.array([robots] * len(table), pa.uint64())
    pq.write_table(table.set_column(table.column_names.index("robots"), "robots", robots_column), path)

    with pytest.raises(UsageError, match="column record_t has gaps, or not a value of each robot"):
        read_table(path)


def with_column(name: str, values: object) -> pa.Table:
    """Return results in which a column has other values."""
    table = valid_results_table()
    return table.set_column(table.column_names.index(name), name, values)


def damaged_tables() -> Iterator[tuple[pa.Table, str]]:
    """Yield tables with one thing wrong, each with words that the error must contain."""
    table = valid_results_table()
    yield pa.table({"k": [1]}), "holds no results"
    yield table.slice(0, 0), "holds no trials; run mcp-asdf sweep again"
    yield table.drop_columns(["e", "k"]), "it has no e, k; run mcp-asdf sweep again"
    older = table.replace_schema_metadata({b"mcp-asdf": json.dumps({"format": 4})})
    yield older, f"in format 4; format {FORMAT} is needed: run mcp-asdf sweep again"
    for name in table.column_names:
        yield from tables_with_damaged_column(table, name)
    yield table.append_column("k", table["k"]), "k"
    metadata = read_metadata(table)
    for text in (b"[" * 100_000, b'{"a":' * 100_000, b"[]", b"\xff", b"{", json.dumps(None).encode()):
        yield table.replace_schema_metadata({b"mcp-asdf": text}), "no results"
    for key, value in (("sampling_interval", -1), ("sampling_interval", "1"), ("versions", 3)):
        changed = json.dumps(metadata | {key: value})
        yield table.replace_schema_metadata({b"mcp-asdf": changed}), "metadata"


def tables_with_damaged_column(table: pa.Table, name: str) -> Iterator[tuple[pa.Table, str]]:
    """Yield tables in which a column is missing, of another type, empty, or has impossible values.

    Each comes with words that the error must contain; empty if any error will do.
    """
    column_type = table[name].type
    if name not in Experiment().parameters():
        yield table.drop_columns([name]), f"has no {name}"
    yield with_column(name, pa.array([b"?"] * len(table))), f"column {name} "
    may_be_empty = name in ("omega", *SCORES)  # it may be left out, or is computed again
    if not may_be_empty:
        yield with_column(name, pa.array([None] * len(table), column_type)), ""
    if pa.types.is_list(column_type):
        lists = table[name].to_pylist()
        too_short = [*lists[1:], lists[0][:-1]]
        gaps = [[None] * len(values) for values in lists]
        empty: list[Any] = [[]] * len(lists)
        damages = [too_short, gaps, empty]
        if name.startswith("record_"):
            # The damage is in the list of a single step, which has a value of each robot.
            *other_steps, last_step = lists[0]
            damages.append([[*other_steps, last_step[:-1]], *lists[1:]])
            damages.append([[*other_steps, [None] * len(last_step)], *lists[1:]])
        for damaged_lists in damages:
            expected_word = f"column {'record_' if name == 'record_t' else name}"
            yield with_column(name, pa.array(damaged_lists, column_type)), expected_word
    elif column_type == pa.uint64():
        for number in (0, 2**64 - 1):
            yield with_column(name, pa.array([number] * len(table), pa.uint64())), ""


@pytest.mark.random
def test_results_of_the_present_format_with_one_thing_wrong_are_refused(path: Path) -> None:
    damages = list(damaged_tables())
    assert len(damages) > 100
    for table, expected_words in damages[:4] + damages[4 :: len(damages) // draws(len(damages))]:
        pq.write_table(table, path)
        error = try_to_read(PARSERS["results"], path, path.read_bytes())
        assert expected_words in error and (error or not expected_words), (expected_words, error)


def test_a_file_that_is_no_parquet_is_refused_by_its_name(path: Path) -> None:
    assert f"cannot read {path}: " in try_to_read(PARSERS["results"], path, b"nothing")


def test_a_missing_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="there is no such file"):
        read_table(tmp_path / "missing.parquet")


def results_with_drift_spread(value: float) -> Any:
    """Return results of an earlier version, which had this parameter."""
    table = trials_to_table(run_trials(SHORT, 0, 2))
    return table.append_column("drift_spread", pa.array([value] * len(table)))


def test_results_with_a_former_parameter_that_had_no_effect_are_read(path: Path) -> None:
    """drift_spread, which there is no more, is 0 in all of them."""
    pq.write_table(results_with_drift_spread(0.0), path)
    [trials] = stream_experiments(path)
    assert trials.experiment == SHORT


def test_results_with_a_former_parameter_that_had_an_effect_are_refused(path: Path) -> None:
    pq.write_table(results_with_drift_spread(1e-6), path)
    with pytest.raises(UsageError, match="has results with drift_spread, a parameter of earlier versions"):
        list(stream_experiments(path))


def test_results_may_not_name_a_file_as_their_graph(path: Path, tmp_path: Path) -> None:
    """The file is a pipe that nobody writes to: to open it would wait for ever."""
    os.mkfifo(tmp_path / "pipe")
    experiment = replace(SHORT, topology="graph", graph="0 1", trials=1)
    table = trials_to_table(run_trials(experiment, 0, 1))
    graphs = pa.array([str(tmp_path / "pipe")])
    pq.write_table(table.set_column(table.column_names.index("graph"), "graph", graphs), path)

    with pytest.raises(UsageError, match="has to hold the edges themselves"):
        list(stream_experiments(path))


# --- Other limits, and CSV -------------------------------------------------------------------------------


@pytest.mark.parametrize("name", SCORES)
def test_scores_are_computed_again_for_limits_that_the_user_chooses(
    name: str, results_path: Path, experiments: list[Trials]
) -> None:
    table, limits = read_table(results_path), Limits(1000, 0.7)

    scores = score_table(table, limits)[name].to_pylist()

    second_experiment = slice(3, 6)  # rows: three trials of each
    assert scores[second_experiment] == experiments[1].scores(limits)[name].tolist()
    assert scores[second_experiment] != table[name].to_pylist()[second_experiment]


def test_limits_that_the_user_chooses_change_nothing_but_the_scores(results_path: Path) -> None:
    table = read_table(results_path)
    scored_table = score_table(table, Limits(1000, 0.7))
    other_columns = [name for name in table.column_names if name not in SCORES]

    assert scored_table.schema.equals(table.schema, check_metadata=True)
    assert scored_table.select(other_columns).equals(table.select(other_columns))


def csv_rows(experiments: list[Trials], limits: Limits, folder: Path) -> list[dict[str, str]]:
    """Write experiments as CSV, and return the rows that csv reads from it."""
    write_csv(folder / "results.csv", experiments, limits)
    with (folder / "results.csv").open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def test_csv_has_a_line_for_every_trial(experiments: list[Trials], tmp_path: Path) -> None:
    rows = csv_rows(experiments, Limits(300, 0.55), tmp_path)
    assert [(row["filter"], row["trial"], row["seed"]) for row in rows] == [
        ("asdf-plus", "0", "1"),
        ("asdf-plus", "1", "1"),
        ("asdf-plus", "2", "1"),
        ("none", "0", "18446744073709551615"),
        ("none", "1", "18446744073709551615"),
        ("none", "2", "18446744073709551615"),
    ]


def test_a_line_of_csv_has_scores_of_its_trial_and_means_and_sums_over_its_robots(
    experiments: list[Trials], tmp_path: Path
) -> None:
    """The second line is that of trial 1 of the first experiment."""
    limits = Limits(300, 0.55)
    trials = experiments[0]
    row = csv_rows(experiments, limits, tmp_path)[1]

    assert [float(row[name]) for name in SCORES] == pytest.approx(
        [scores[1] for scores in trials.scores(limits).values()]
    )
    assert float(row["mean_K"]) == pytest.approx(trials.convergence_steps[1].mean())
    assert float(row["mean_e"]) == pytest.approx(trials.errors[1].mean())
    assert float(row["mean_b_hat"]) == pytest.approx(trials.b_hat[1, -1].mean())
    assert int(row["tests"]) == trials.tests[1].sum()
    assert int(row["updates"]) == trials.updates[1].sum()
    assert row["K_max"] == "300"
    assert row["e_max"] == "0.55"
