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

from host_tools.test_untrusted import PARSERS, is_one_short_line, read_or_refuse, valid_results_table
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.common.versions import software_versions
from mcp_asdf_tools.experiments import result_files
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.result_files import collect_rows, read_table, stream_experiments, write_tables
from mcp_asdf_tools.experiments.result_tables import (
    PRESENT_FORMAT,
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

SHORT_EXPERIMENT = Experiment(robots=4, flawed=1, filter="asdf-plus", steps=300, filter_period=100, trials=3)
OTHER_EXPERIMENT = replace(SHORT_EXPERIMENT, filter="none", seed=2**64 - 1)


def replace_column(table: pa.Table, name: str, values: object) -> pa.Table:
    """Return the table with other values in the column of this name."""
    return table.set_column(table.column_names.index(name), name, values)


@pytest.fixture(scope="module")
def results_path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A file, only to be read, of two experiments with recorded values.

    The trials of the first experiment are in the order 2, 0, 1.
    """
    path = tmp_path_factory.mktemp("results") / "results.parquet"
    tables = [
        trials_to_table(run_trials(SHORT_EXPERIMENT, first=2, trials=1, sampling_interval=10)),
        trials_to_table(run_trials(SHORT_EXPERIMENT, first=0, trials=2, sampling_interval=10)),
        trials_to_table(run_trials(OTHER_EXPERIMENT, first=0, trials=3, sampling_interval=10)),
    ]
    write_tables(path, [pa.concat_tables(tables)])
    return path


@pytest.fixture(scope="module")
def experiments(results_path: Path) -> list[Trials]:
    """The two experiments of the file, with the trials 0 to 2 of each."""
    return list(stream_experiments(results_path))


@pytest.fixture(scope="module")
def trials_run_again() -> list[Trials]:
    """The same experiments, run once more and not written to a file."""
    return [
        run_trials(experiment, first=0, trials=3, sampling_interval=10)
        for experiment in (SHORT_EXPERIMENT, OTHER_EXPERIMENT)
    ]


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """Path of a file that a test writes."""
    return tmp_path / "results.parquet"


# --- What is read is what was written --------------------------------------------------------------------


def test_a_file_of_results_gives_back_its_experiments_with_their_trials_in_order(
    experiments: list[Trials],
) -> None:
    """The rows of the first experiment hold trials 2, 0 and 1."""
    assert [trials.experiment for trials in experiments] == [SHORT_EXPERIMENT, OTHER_EXPERIMENT]
    assert [trials.numbers for trials in experiments] == [[0, 1, 2], [0, 1, 2]]


def test_a_file_of_results_gives_back_all_values_that_were_measured_and_recorded_over_time(
    experiments: list[Trials], trials_run_again: list[Trials]
) -> None:
    """The same trials are run once more, and compared with the trials from the file.

    Values of 4 robots were recorded every 10 steps: at step 0, and 30 times in 300 steps of 3 trials.
    """
    for trials_from_file, expected_trials in zip(experiments, trials_run_again, strict=True):
        assert trials_from_file.sampling_interval == 10
        assert trials_from_file.records["x"].shape == (3, 31, 4)
        for result in ("convergence_steps", "errors", "b_hat", "tests", "updates"):
            assert np.array_equal(getattr(trials_from_file, result), getattr(expected_trials, result)), result
        for quantity in QUANTITIES:
            values = trials_from_file.records[quantity]
            expected_values = expected_trials.records[quantity]
            assert np.array_equal(values, expected_values), quantity


def test_results_of_one_robot_without_recorded_values_are_read_from_their_file(path: Path) -> None:
    """Such results have the shortest lists. Short lists must not be taken for missing lists."""
    experiment = replace(SHORT_EXPERIMENT, robots=1)
    table = trials_to_table(run_trials(experiment, first=0, trials=1))
    write_tables(path, [table])
    [trials] = stream_experiments(path)

    assert trials.experiment == experiment
    assert trials.records == {}


def test_the_trials_of_an_experiment_may_be_spread_over_the_files_of_a_folder(tmp_path: Path) -> None:
    """Three files hold trial 0 of an experiment, trial 1 of another one, and trial 2 of the first again."""
    for trial, experiment in enumerate((SHORT_EXPERIMENT, OTHER_EXPERIMENT, SHORT_EXPERIMENT)):
        table = trials_to_table(run_trials(experiment, first=trial, trials=1))
        write_tables(tmp_path / f"{trial}.parquet", [table])
    trials, trials_of_other_experiment = stream_experiments(tmp_path)

    assert trials.experiment == SHORT_EXPERIMENT
    assert trials.numbers == [0, 2]
    assert trials_of_other_experiment.experiment == OTHER_EXPERIMENT
    assert trials_of_other_experiment.numbers == [1]


def test_small_tables_are_joined_until_they_have_enough_bytes(monkeypatch: pytest.MonkeyPatch) -> None:
    """There are five tables of one row. Two have enough bytes, so the fifth is left over."""
    table_of_one_row = trials_to_table(run_trials(SHORT_EXPERIMENT, first=0, trials=1))
    monkeypatch.setattr(result_files, "ROW_GROUP_BYTES", 2 * table_of_one_row.nbytes)
    larger_tables = collect_rows([table_of_one_row] * 5)
    assert [len(larger_table) for larger_table in larger_tables] == [2, 2, 1]


def test_any_reader_of_parquet_finds_the_parameters_and_the_results_of_a_trial_in_its_row(
    results_path: Path,
) -> None:
    """A row has the scores of a trial, and lists with one value per robot: step of convergence k and error e.

    The list of b_hat has a value of each robot in each filter step. The second row holds trial 0, which the
    test runs again.
    """
    _row_of_trial_2, row_of_trial_0, *_ = pq.read_table(results_path).to_pylist()
    trial_0 = run_trials(SHORT_EXPERIMENT, first=0, trials=1)

    assert row_of_trial_0["trial"] == 0
    for parameter, value in SHORT_EXPERIMENT.parameters().items():
        assert row_of_trial_0[parameter] == value
    assert row_of_trial_0["k"] == trial_0.convergence_steps.ravel().tolist()
    assert row_of_trial_0["e"] == trial_0.errors.ravel().tolist()
    assert row_of_trial_0["b_hat"] == trial_0.b_hat.ravel().tolist()
    for name in SCORES:
        [score_of_trial_0] = trial_0.scores()[name]
        assert row_of_trial_0[name] == score_of_trial_0


@pytest.fixture(scope="module")
def described_columns(results_path: Path) -> dict[str, dict[str, str]]:
    """The entry of each column in the metadata of a file of results, such as its meaning, by name."""
    metadata = json.loads(pq.read_schema(results_path).metadata[b"mcp-asdf"])
    return dict(metadata["columns"])


def test_the_metadata_of_results_give_every_column_a_meaning(
    described_columns: dict[str, dict[str, str]], results_path: Path
) -> None:
    """Metadata have one entry per column, in the order of columns. A meaning is a text."""
    assert list(described_columns) == pq.read_schema(results_path).names
    for column in described_columns.values():
        assert column["meaning"] != ""


@pytest.mark.parametrize(
    ("name", "unit"),
    [
        ("k", "step"),
        ("filter_period", "step"),
        ("tile", "m"),
        ("speed", "m/s"),
        ("H", "point of 100"),
        ("fill_ratio", "1"),
    ],
)
def test_the_metadata_of_results_give_a_column_its_unit(
    name: str, unit: str, described_columns: dict[str, dict[str, str]]
) -> None:
    assert described_columns[name]["unit"] == unit


def test_the_metadata_of_results_say_how_they_were_made(results_path: Path) -> None:
    """Metadata name the versions of format and software, and the number of steps between records.

    delta is how much an estimate that counts as converged may still change.
    """
    assert read_metadata(read_table(results_path)) == {
        "format": PRESENT_FORMAT,
        "versions": software_versions(),
        "delta": 0.01,
        "sampling_interval": 10,
    }


# --- Choosing experiments --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("condition", "selected_filters"),
    [
        ({"steps": "3e2", "fill_ratio": 0.55}, ["asdf-plus", "none"]),  # both have 300 steps
        ({"seed": "18446744073709551615"}, ["none"]),  # 2^64 - 1, which no float is exactly
        ({"filter": "none"}, ["none"]),
    ],
)
def test_experiments_are_selected_by_the_values_of_their_parameters(
    condition: dict[str, Any], selected_filters: list[str], experiments: list[Trials]
) -> None:
    """There are two experiments, one with the filter asdf-plus and one with none."""
    selected = select_experiments(experiments, condition)
    assert [trials.experiment.filter for trials in selected] == selected_filters


@pytest.mark.parametrize(
    ("condition", "expected_message"),
    [
        ({"filter": "non"}, "filter=non: no experiment has it; filter is asdf-plus or none"),
        ({"steps": "many"}, "steps=many: no experiment has it; steps is 300"),
        (
            {"filtr": "none"},
            r"did you mean filter\?; the experiments differ in seed=1\|18446744073709551615, filter=",
        ),
    ],
)
def test_a_condition_that_no_experiment_meets_is_refused_with_what_could_be_meant(
    condition: dict[str, str], expected_message: str, experiments: list[Trials]
) -> None:
    """The condition has a wrong value or a wrong name. There are two experiments with different filters."""
    with pytest.raises(UsageError, match=expected_message):
        select_experiments(experiments, condition)


def test_a_single_experiment_is_chosen_and_has_no_parameters_that_differ(experiments: list[Trials]) -> None:
    trials, _trials_of_other_experiment = experiments
    assert single_experiment([trials]) is trials
    assert describe_differences([trials]) == "no parameters"


# --- Old and damaged files -------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("parameter", [*Experiment().parameters()])
def test_results_from_before_a_parameter_existed_are_read_with_its_default(
    parameter: str, path: Path
) -> None:
    """They have no column of this parameter."""
    default = Experiment().parameters()[parameter]
    # The defaults of some parameters need as many robots as there are by default: 20, of which 6 are flawed.
    settings: dict[str, Any] = {"trials": 1, "robots": 20, "flawed": 6}
    experiment = replace(SHORT_EXPERIMENT, **settings | {parameter: default})
    table = trials_to_table(run_trials(experiment, first=0, trials=1))
    pq.write_table(table.drop_columns([parameter]), path)

    [trials] = stream_experiments(path)
    assert trials.experiment.parameters()[parameter] == default


def test_results_from_before_a_parameter_existed_can_be_scored_again() -> None:
    """The parameter is latency, which has no column in the older table. Scores do not change."""
    table = trials_to_table(run_trials(SHORT_EXPERIMENT, first=0, trials=2))
    older_table = table.drop_columns(["latency"])
    older_table_scored_again = score_table(older_table, Limits())
    assert older_table_scored_again["H"].equals(table["H"])


def test_results_from_before_a_parameter_existed_are_read_together_with_newer_ones(tmp_path: Path) -> None:
    """Each of two files has two trials; the first has no latency, whose default is 0."""
    table = trials_to_table(run_trials(SHORT_EXPERIMENT, first=0, trials=2))
    older_table = table.drop_columns(["latency"])
    pq.write_table(older_table, tmp_path / "1.parquet")
    pq.write_table(table, tmp_path / "2.parquet")
    assert read_table(tmp_path)["latency"].to_pylist() == [0, 0, 0, 0]


FORMAT_5_FILE = Path(__file__).with_name("results_format_5.parquet")
"""Two trials of an experiment of three robots and two of one of two, written in format 5.

Values of 20 steps are recorded every 10 steps. In format 5 each record is one flat list.
"""


def test_results_in_the_earlier_format_5_give_back_their_records_by_step_and_robot() -> None:
    """The file has two trials of 3 robots and two of 2, each recorded at the steps 0, 10 and 20.

    t is how often a robot has observed by then, and x its estimate, which was the same in both of two robots.
    """
    trials_of_3_robots, trials_of_2_robots = stream_experiments(FORMAT_5_FILE)
    t_in_first_trial, t_in_second_trial = trials_of_3_robots.records["t"].tolist()
    assert t_in_first_trial == [[0, 0, 0], [10, 10, 10], [20, 20, 20]]
    assert t_in_second_trial == [[0, 0, 0], [10, 10, 10], [20, 20, 20]]

    _x_in_first_trial, x_in_second_trial = trials_of_2_robots.records["x"].tolist()
    _x_at_step_0, _x_at_step_10, x_at_step_20 = x_in_second_trial
    assert x_at_step_20 == [0.6703321933746338, 0.6703321933746338]  # as the file has it


def test_results_in_the_earlier_format_5_are_read_as_a_table_of_the_present_format() -> None:
    """It has the columns, types and format number of new results, and a record is a list for each step.

    The last two of four rows are trials of 2 robots, which had observed 0, 10 and 20 times when recorded.
    """
    table = read_table(FORMAT_5_FILE)
    new_table = trials_to_table(run_trials(SHORT_EXPERIMENT, first=0, trials=1, sampling_interval=10))
    assert table.schema.equals(new_table.schema)
    assert read_metadata(table)["format"] == read_metadata(new_table)["format"]

    _row_0, _row_1, observations_in_row_2, _row_3 = table["record_t"].to_pylist()
    assert observations_in_row_2 == [[0, 0], [10, 10], [20, 20]]


def test_results_in_the_earlier_format_5_may_be_read_by_another_program() -> None:
    """It gives the table to ``stream_experiments``. At step 20, each of 3 robots has observed 20 times, t."""
    table_of_another_program = pq.read_table(FORMAT_5_FILE)
    trials_of_3_robots, _trials_of_2_robots = stream_experiments(table_of_another_program)
    _t_in_first_trial, t_in_second_trial = trials_of_3_robots.records["t"].tolist()
    _t_at_step_0, _t_at_step_10, t_at_step_20 = t_in_second_trial
    assert t_at_step_20 == [20, 20, 20]


@pytest.mark.parametrize("robots", [0, 2, 2**64 - 1])
def test_a_record_in_format_5_that_has_not_a_value_of_each_robot_at_each_step_is_refused(
    robots: int, path: Path
) -> None:
    """The first record is a list of 9 values, those of 3 robots at 3 steps.

    The number of robots is changed in all rows of the file. 9 is no multiple of 2 robots.
    """
    table = pq.read_table(FORMAT_5_FILE)
    wrong_robots = pa.array([robots] * len(table), pa.uint64())
    pq.write_table(replace_column(table, "robots", wrong_robots), path)

    with pytest.raises(UsageError, match="column record_t has gaps, or not a value of each robot"):
        read_table(path)


def test_a_file_in_the_present_format_with_records_as_in_format_5_is_refused(path: Path) -> None:
    """No version has written such a file: in format 6 a record is a list for each step."""
    table = valid_results_table()
    flat_records = pa.array([[0.5] * 6] * len(table))
    pq.write_table(replace_column(table, "record_x", flat_records), path)

    with pytest.raises(UsageError, match="is damaged: column record_x is not list<element: list<element"):
        read_table(path)


def test_a_column_that_another_program_has_added_stays_behind_the_others(path: Path) -> None:
    """The other program has put its column first, and the table that is read has it last."""
    table = valid_results_table()
    pq.write_table(table.add_column(0, "remark", pa.array(["mine"] * len(table))), path)

    read = read_table(path)

    assert read.column_names == [*table.column_names, "remark"]
    assert read["remark"].to_pylist() == ["mine"] * len(table)


def with_column(name: str, values: object) -> pa.Table:
    """Return results in which a column has other values."""
    return replace_column(valid_results_table(), name, values)


def damaged_tables() -> Iterator[tuple[pa.Table, str]]:
    """Yield pairs of a table with one thing wrong and the words that the error about it must contain."""
    table = valid_results_table()
    yield pa.table({"k": [1]}), "holds no results"
    yield table.slice(0, 0), "holds no trials; run mcp-asdf sweep again"
    yield table.drop_columns(["e", "k"]), "it has no e, k; run mcp-asdf sweep again"
    older = table.replace_schema_metadata({b"mcp-asdf": json.dumps({"format": 4})})
    yield older, f"in format 4; format {PRESENT_FORMAT} is needed: run mcp-asdf sweep again"
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

    Each comes with words that the error must contain; empty if the table may as well be read.
    """
    column_type = table[name].type
    if name not in Experiment().parameters():
        yield table.drop_columns([name]), f"has no {name}"
    yield with_column(name, pa.array([b"?"] * len(table))), f"column {name} "
    may_be_empty = name in ("omega", *SCORES)  # it may be left out, or is computed again
    if not may_be_empty:
        yield with_column(name, pa.array([None] * len(table), column_type)), ""
    if column_type == pa.uint64():
        for number in (0, 2**64 - 1):
            yield with_column(name, pa.array([number] * len(table), pa.uint64())), ""
    if pa.types.is_list(column_type):
        expected_words = f"column {'record_' if name == 'record_t' else name}"
        for damaged_lists in damages_of_lists(table[name].to_pylist(), is_record=name.startswith("record_")):
            yield with_column(name, pa.array(damaged_lists, column_type)), expected_words


def damages_of_lists(lists: list[Any], *, is_record: bool) -> Iterator[list[Any]]:
    """Yield damaged versions of the lists of a column: one list too short, gaps in all, or all empty.

    A record is a list of lists, one per step. It is also damaged in two ways in the last step alone.
    """
    first_list, *other_lists = lists
    yield [*other_lists, first_list[:-1]]
    yield [[None] * len(values) for values in lists]
    yield [[]] * len(lists)
    if is_record:
        *other_steps, last_step = first_list
        yield [[*other_steps, last_step[:-1]], *other_lists]
        yield [[*other_steps, [None] * len(last_step)], *other_lists]


def damaged_tables_to_try() -> list[tuple[pa.Table, str]]:
    """Return the first four damaged tables, and of more than a hundred others a tenth in the quick run."""
    damages = list(damaged_tables())
    assert len(damages) > 100
    interval = len(damages) // draws(len(damages))  # from one damage that is tried to the next
    always_tried, others = damages[:4], damages[4:]
    return always_tried + others[::interval]


def error_of_reading(path: Path) -> str | None:
    """Return the error with which a file of results is refused; None if it is read."""
    return read_or_refuse(PARSERS["results"], path, path.read_bytes())


@pytest.mark.random
def test_a_file_of_results_with_one_thing_wrong_is_refused_with_its_name(path: Path) -> None:
    """The error is one short line with the words that name what is wrong.

    Some damage does not have to be noticed. No words are expected then.
    """
    for damaged_table, expected_words in damaged_tables_to_try():
        pq.write_table(damaged_table, path)
        error = error_of_reading(path)
        if error is None:  # the file was read in spite of its damage
            assert expected_words == ""
        else:
            assert is_one_short_line(error)
            assert expected_words in error


def test_a_file_that_is_no_parquet_is_refused_with_its_name(path: Path) -> None:
    path.write_bytes(b"nothing")
    with pytest.raises(UsageError, match=f"cannot read {path}: "):
        read_table(path)


def test_a_missing_file_of_results_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="there is no such file"):
        read_table(tmp_path / "missing.parquet")


def results_with_drift_spread(value: float) -> Any:
    """Return results of an earlier version, which had the parameter drift_spread."""
    table = trials_to_table(run_trials(SHORT_EXPERIMENT, first=0, trials=2))
    return table.append_column("drift_spread", pa.array([value] * len(table)))


def test_results_with_a_parameter_of_earlier_versions_are_read_if_it_had_no_effect(path: Path) -> None:
    """A drift_spread of 0 had none. The experiment that is read does not have this parameter."""
    pq.write_table(results_with_drift_spread(0.0), path)
    [trials] = stream_experiments(path)
    assert trials.experiment == SHORT_EXPERIMENT


def test_results_with_a_parameter_of_earlier_versions_are_refused_if_it_had_an_effect(path: Path) -> None:
    """A drift_spread above 0 had one, so that the present version could not run the experiment again."""
    pq.write_table(results_with_drift_spread(1e-6), path)
    with pytest.raises(UsageError, match="has results with drift_spread, a parameter of earlier versions"):
        list(stream_experiments(path))


def test_results_that_name_a_file_as_their_graph_are_refused_and_it_is_not_opened(
    path: Path, tmp_path: Path
) -> None:
    """Results have to hold the edges. The file is a pipe: to open it would wait for ever for a writer."""
    os.mkfifo(tmp_path / "pipe")
    experiment = replace(SHORT_EXPERIMENT, topology="graph", graph="0 1", trials=1)
    table_of_one_row = trials_to_table(run_trials(experiment, first=0, trials=1))
    graph_of_the_row = pa.array([str(tmp_path / "pipe")])
    pq.write_table(replace_column(table_of_one_row, "graph", graph_of_the_row), path)

    with pytest.raises(UsageError, match="has to hold the edges themselves"):
        list(stream_experiments(path))


# --- Other limits, and CSV -------------------------------------------------------------------------------


@pytest.mark.parametrize("name", SCORES)
def test_scores_in_a_table_are_computed_again_for_limits_that_the_user_chooses(
    name: str, results_path: Path, experiments: list[Trials]
) -> None:
    """A score is relative to limits of convergence and of errors. Those in the file are the paper's.

    The file has three rows of each of two experiments. Those of the second one are compared.
    """
    limits = Limits(k_max=1000, e_max=0.7)
    _first_experiment, second_experiment = experiments
    table = read_table(results_path)
    table_scored_again = score_table(table, limits)

    scores_before = table[name].to_pylist()[3:]
    scores_again = table_scored_again[name].to_pylist()[3:]
    assert scores_again == second_experiment.scores(limits)[name].tolist()
    assert scores_again != scores_before


def test_limits_that_the_user_chooses_change_no_column_but_the_scores(results_path: Path) -> None:
    """Nor do they change the types of columns and the metadata, which the schema holds."""
    table = read_table(results_path)
    table_scored_again = score_table(table, Limits(k_max=1000, e_max=0.7))
    other_columns = [name for name in table.column_names if name not in SCORES]

    assert table_scored_again.schema.equals(table.schema, check_metadata=True)
    assert table_scored_again.select(other_columns).equals(table.select(other_columns))


@pytest.fixture
def csv_rows(experiments: list[Trials], path: Path) -> list[dict[str, str]]:
    """The two experiments, written as CSV and read again: a row for each of their three trials."""
    write_csv(path, experiments, Limits(k_max=300, e_max=0.55))
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def test_csv_has_a_line_for_every_trial_with_its_parameters(csv_rows: list[dict[str, str]]) -> None:
    """The seed of the second experiment is 2^64 - 1, which has 20 digits."""
    assert [(row["filter"], row["trial"], row["seed"]) for row in csv_rows] == [
        ("asdf-plus", "0", "1"),
        ("asdf-plus", "1", "1"),
        ("asdf-plus", "2", "1"),
        ("none", "0", "18446744073709551615"),
        ("none", "1", "18446744073709551615"),
        ("none", "2", "18446744073709551615"),
    ]


def test_a_line_of_csv_has_the_scores_of_its_trial_and_their_limits(
    experiments: list[Trials], csv_rows: list[dict[str, str]]
) -> None:
    """The file was written with 300 as the limit K_max of convergence, and 0.55 as the limit e_max of errors.

    Its first line holds trial 0 of the first experiment.
    """
    row_of_trial_0, *_ = csv_rows
    assert (row_of_trial_0["K_max"], row_of_trial_0["e_max"]) == ("300", "0.55")

    first_experiment, _second_experiment = experiments
    for name, scores_of_trials in first_experiment.scores(Limits(k_max=300, e_max=0.55)).items():
        score_of_trial_0, *_ = scores_of_trials
        assert float(row_of_trial_0[name]) == pytest.approx(score_of_trial_0)


def test_a_line_of_csv_has_means_and_sums_over_the_robots_of_its_trial(
    experiments: list[Trials], csv_rows: list[dict[str, str]]
) -> None:
    """The second line holds trial 1 of the first experiment, with the b_hat of the last filter step.

    K is a robot's step of convergence, and e its error. Sums are of how often robots tested and updated.
    """
    trials, _trials_of_other_experiment = experiments
    _row_of_trial_0, row_of_trial_1, *_ = csv_rows
    *_, b_hat_of_last_filter_step = trials.b_hat[1]

    assert float(row_of_trial_1["mean_K"]) == pytest.approx(trials.convergence_steps[1].mean())
    assert float(row_of_trial_1["mean_e"]) == pytest.approx(trials.errors[1].mean())
    assert float(row_of_trial_1["mean_b_hat"]) == pytest.approx(b_hat_of_last_filter_step.mean())
    assert int(row_of_trial_1["tests"]) == sum(trials.tests[1])
    assert int(row_of_trial_1["updates"]) == sum(trials.updates[1])
