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
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.result_files import collect_rows, read_table, stream_experiments, write_tables
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
OTHER_EXPERIMENT = replace(SHORT, filter="none", seed=2**64 - 1)


@pytest.fixture(scope="module")
def results_path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A file, only to be read, of two experiments with recorded values.

    The trials of the first experiment are in the order 2, 0, 1.
    """
    path = tmp_path_factory.mktemp("results") / "results.parquet"
    tables = [
        trials_to_table(run_trials(SHORT, first=2, trials=1, sampling_interval=10)),
        trials_to_table(run_trials(SHORT, first=0, trials=2, sampling_interval=10)),
        trials_to_table(run_trials(OTHER_EXPERIMENT, first=0, trials=3, sampling_interval=10)),
    ]
    write_tables(path, [pa.concat_tables(tables)])
    return path


@pytest.fixture(scope="module")
def experiments(results_path: Path) -> list[Trials]:
    """The two experiments of the file, with the trials 0 to 2 of each."""
    return experiments_in(read_table(results_path))


@pytest.fixture(scope="module")
def trials_run_again() -> list[Trials]:
    """The same experiments, run once more and not written to a file."""
    return [
        run_trials(experiment, first=0, trials=3, sampling_interval=10)
        for experiment in (SHORT, OTHER_EXPERIMENT)
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
    assert [trials.experiment for trials in experiments] == [SHORT, OTHER_EXPERIMENT]
    assert [trials.numbers for trials in experiments] == [[0, 1, 2], [0, 1, 2]]


def test_a_file_of_results_gives_back_all_values_that_were_measured_and_recorded_over_time(
    experiments: list[Trials], trials_run_again: list[Trials]
) -> None:
    """The same trials are run once more, and compared with the trials from the file."""
    for trials_read, expected_trials in zip(experiments, trials_run_again, strict=True):
        for name in ("convergence_steps", "errors", "b_hat", "tests", "updates"):
            assert np.array_equal(getattr(trials_read, name), getattr(expected_trials, name)), name
        for name in QUANTITIES:
            assert np.array_equal(trials_read.records[name], expected_trials.records[name]), name


def test_a_file_of_results_gives_back_how_often_values_were_recorded(experiments: list[Trials]) -> None:
    """Values of 4 robots were recorded at step 0 and 30 times in 300 steps of 3 trials."""
    first_experiment, _ = experiments
    assert first_experiment.sampling_interval == 10
    trial_count, sample_count, robots = first_experiment.records["x"].shape
    assert (trial_count, sample_count, robots) == (3, 31, 4)


def test_results_of_one_robot_without_recorded_values_are_read_from_their_file(path: Path) -> None:
    """Such results have the shortest lists. Short lists must not be taken for missing lists."""
    experiment = replace(SHORT, robots=1)
    write_tables(path, [trials_to_table(run_trials(experiment, first=0, trials=1))])
    [trials] = experiments_in(read_table(path))
    assert (trials.experiment, trials.records) == (experiment, {})


def test_the_trials_of_an_experiment_may_be_spread_over_the_files_of_a_folder(tmp_path: Path) -> None:
    """The first and third file hold trials of the same experiment. They become one entry."""
    for trial, experiment in enumerate((SHORT, OTHER_EXPERIMENT, SHORT)):
        table = trials_to_table(run_trials(experiment, first=trial, trials=1))
        write_tables(tmp_path / f"{trial}.parquet", [table])
    first, second = stream_experiments(tmp_path)

    assert (first.experiment, first.numbers) == (SHORT, [0, 2])
    assert (second.experiment, second.numbers) == (OTHER_EXPERIMENT, [1])


def test_small_tables_are_joined_until_they_have_enough_bytes() -> None:
    """There are five tables of one row. Two tables fill a group, so the fifth is a group of its own."""
    table = trials_to_table(run_trials(SHORT, first=0, trials=1))
    larger_tables = collect_rows([table] * 5, min_bytes=2 * table.nbytes)
    assert [len(larger_table) for larger_table in larger_tables] == [2, 2, 1]


def test_any_reader_of_parquet_finds_the_parameters_and_the_results_of_a_trial_in_its_row(
    results_path: Path,
) -> None:
    """A row has the scores of a trial, and lists with one value per robot: step of convergence k and error e.

    The second row holds trial 0. The test runs this trial again.
    """
    _row_of_trial_2, row, *_ = pq.read_table(results_path).to_pylist()
    trials = run_trials(SHORT, first=0, trials=1)

    assert row["trial"] == 0
    assert {name: row[name] for name in SHORT.parameters()} == SHORT.parameters()
    assert row["k"] == trials.convergence_steps.ravel().tolist()
    assert row["e"] == trials.errors.ravel().tolist()
    assert row["b_hat"] == trials.b_hat.ravel().tolist()
    for name in SCORES:
        assert [row[name]] == trials.scores()[name]


@pytest.fixture(scope="module")
def described_columns(results_path: Path) -> dict[str, dict[str, str]]:
    """The entry of each column in the metadata of a file of results, such as its meaning, by name."""
    metadata = json.loads(pq.read_schema(results_path).metadata[b"mcp-asdf"])
    return dict(metadata["columns"])


def test_the_metadata_of_results_give_every_column_a_meaning(
    described_columns: dict[str, dict[str, str]], results_path: Path
) -> None:
    assert list(described_columns) == pq.read_schema(results_path).names
    assert all(column["meaning"] for column in described_columns.values())


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
        "format": FORMAT,
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
    ("condition", "message"),
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
    condition: dict[str, str], message: str, experiments: list[Trials]
) -> None:
    with pytest.raises(UsageError, match=message):
        select_experiments(experiments, condition)


def test_several_experiments_in_place_of_one_are_refused_with_their_differences(
    experiments: list[Trials],
) -> None:
    with pytest.raises(UsageError, match=r"2 experiments match; choose one with where seed=1\|"):
        single_experiment(experiments)


def test_a_single_experiment_has_no_parameters_that_differ(experiments: list[Trials]) -> None:
    first_experiment, _ = experiments
    assert single_experiment([first_experiment]) is first_experiment
    assert describe_differences([first_experiment]) == "no parameters"


# --- Old and damaged files -------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("name", [*Experiment().parameters()])
def test_results_from_before_a_parameter_existed_are_read_with_its_default(name: str, path: Path) -> None:
    """They have no column of this parameter."""
    default = Experiment().parameters()[name]
    experiment = replace(SHORT, **{"trials": 1, "robots": 20, "flawed": 6, name: default})
    table = trials_to_table(run_trials(experiment, first=0, trials=1)).drop_columns([name])
    pq.write_table(table, path)
    [trials] = stream_experiments(path)
    [trials_read_at_once] = experiments_in(read_table(path))

    assert trials.experiment.parameters()[name] == default
    assert trials_read_at_once.experiment == trials.experiment


def test_results_from_before_a_parameter_existed_can_be_scored_again() -> None:
    table = trials_to_table(run_trials(SHORT, first=0, trials=2))
    table_scored_again = score_table(table.drop_columns(["latency"]), Limits())
    assert table_scored_again["H"].equals(table["H"])


def test_results_from_before_a_parameter_existed_are_read_together_with_newer_ones(tmp_path: Path) -> None:
    """Each of two files has two trials; the first has no latency, whose default is 0."""
    table = trials_to_table(run_trials(SHORT, first=0, trials=2))
    pq.write_table(table.drop_columns(["latency"]), tmp_path / "1.parquet")
    pq.write_table(table, tmp_path / "2.parquet")
    assert read_table(tmp_path)["latency"].to_pylist() == [0, 0, 0, 0]


FORMAT_5_FILE = Path(__file__).with_name("results_format_5.parquet")
"""Two trials of an experiment of three robots and two of one of two, written in format 5.

Values of 20 steps are recorded every 10 steps. In format 5 each record is one flat list.
"""


def test_results_in_the_earlier_format_5_give_back_their_records_by_step_and_robot() -> None:
    """Each of 3 robots had observed 0, 10 and 20 times, t, when its values were recorded."""
    three_robots, two_robots = stream_experiments(FORMAT_5_FILE)  # named by their numbers of robots
    first_trial, second_trial = three_robots.records["t"].tolist()
    assert first_trial == second_trial == [[0, 0, 0], [10, 10, 10], [20, 20, 20]]

    last_trial = two_robots.records["x"].tolist()[-1]
    assert last_trial[-1] == [0.6703321933746338, 0.6703321933746338]


def test_results_in_the_earlier_format_5_are_read_as_a_table_of_the_present_format() -> None:
    """The last two rows are trials of 2 robots, which had observed 0, 10 and 20 times when recorded."""
    table = read_table(FORMAT_5_FILE)
    new_table = trials_to_table(run_trials(SHORT, first=0, trials=1, sampling_interval=10))
    *_, first_trial_of_two_robots, _ = table["record_t"].to_pylist()

    assert table.schema.equals(new_table.schema)
    assert read_metadata(table)["format"] == FORMAT
    assert first_trial_of_two_robots == [[0, 0], [10, 10], [20, 20]]


def test_results_in_the_earlier_format_5_may_be_read_by_another_program() -> None:
    """It gives the table to ``experiments_in``. After 20 steps, each of 3 robots has observed 20 times, t."""
    three_robots, _ = experiments_in(pq.read_table(FORMAT_5_FILE))
    _, second_trial = three_robots.records["t"].tolist()
    assert second_trial[-1] == [20, 20, 20]


@pytest.mark.parametrize("robots", [0, 2, 2**64 - 1])
def test_a_record_in_format_5_that_has_not_a_value_of_each_robot_at_each_step_is_refused(
    robots: int, path: Path
) -> None:
    """The first record is a list of 9 values. 9 is no multiple of 2 robots."""
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

    Each comes with words that the error must contain; empty if the table may as well be read.
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
def test_a_file_of_results_with_one_thing_wrong_is_refused_with_its_name(path: Path) -> None:
    """The error is one short line with the words that name what is wrong.

    The first four damages are always tried, and of more than a hundred others a tenth in the quick run.
    """
    damages = list(damaged_tables())
    assert len(damages) > 100
    interval = len(damages) // draws(len(damages))  # from one damage that is tried to the next
    always_tried, others = damages[:4], damages[4:]
    for table, expected_words in always_tried + others[::interval]:
        pq.write_table(table, path)
        refusal = read_or_refuse(PARSERS["results"], path, path.read_bytes())
        if refusal is None:
            assert expected_words == "", "the file may be read in spite of its damage"
        else:
            assert is_one_short_line(refusal)
            assert expected_words in refusal


def test_a_file_that_is_no_parquet_is_refused_with_its_name(path: Path) -> None:
    path.write_bytes(b"nothing")
    with pytest.raises(UsageError, match=f"cannot read {path}: "):
        read_table(path)


def test_a_missing_file_of_results_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="there is no such file"):
        read_table(tmp_path / "missing.parquet")


def results_with_drift_spread(value: float) -> Any:
    """Return results of an earlier version, which had the parameter drift_spread."""
    table = trials_to_table(run_trials(SHORT, first=0, trials=2))
    return table.append_column("drift_spread", pa.array([value] * len(table)))


def test_results_with_a_parameter_of_earlier_versions_are_read_if_it_had_no_effect(path: Path) -> None:
    """A drift_spread of 0 had none."""
    pq.write_table(results_with_drift_spread(0.0), path)
    [trials] = stream_experiments(path)
    assert trials.experiment == SHORT


def test_results_with_a_parameter_of_earlier_versions_are_refused_if_it_had_an_effect(path: Path) -> None:
    pq.write_table(results_with_drift_spread(1e-6), path)
    with pytest.raises(UsageError, match="has results with drift_spread, a parameter of earlier versions"):
        list(stream_experiments(path))


def test_results_that_name_a_file_as_their_graph_are_refused_and_it_is_not_opened(
    path: Path, tmp_path: Path
) -> None:
    """Results have to hold the edges. The file is a pipe: to open it would wait for ever for a writer."""
    os.mkfifo(tmp_path / "pipe")
    experiment = replace(SHORT, topology="graph", graph="0 1", trials=1)
    table = trials_to_table(run_trials(experiment, first=0, trials=1))
    graphs = pa.array([str(tmp_path / "pipe")])
    pq.write_table(table.set_column(table.column_names.index("graph"), "graph", graphs), path)

    with pytest.raises(UsageError, match="has to hold the edges themselves"):
        list(stream_experiments(path))


# --- Other limits, and CSV -------------------------------------------------------------------------------


OTHER_LIMITS = Limits(k_max=1000, e_max=0.7)
"""Limits of scores that a user may choose in place of the paper's."""


@pytest.mark.parametrize("name", SCORES)
def test_scores_in_a_table_are_computed_again_for_limits_that_the_user_chooses(
    name: str, results_path: Path, experiments: list[Trials]
) -> None:
    """A score is relative to limits of convergence and of errors. Those in the file are the paper's."""
    _, second_experiment = experiments
    table = read_table(results_path)
    scores_before = table[name].to_pylist()

    scores = score_table(table, OTHER_LIMITS)[name].to_pylist()

    last_3_rows = slice(-3, None)  # the trials of the second experiment
    assert scores[last_3_rows] == second_experiment.scores(OTHER_LIMITS)[name].tolist()
    assert scores[last_3_rows] != scores_before[last_3_rows]


def test_limits_that_the_user_chooses_change_no_column_but_the_scores(results_path: Path) -> None:
    table = read_table(results_path)
    table_scored_again = score_table(table, OTHER_LIMITS)
    other_columns = [name for name in table.column_names if name not in SCORES]

    assert table_scored_again.schema.equals(table.schema, check_metadata=True)
    assert table_scored_again.select(other_columns).equals(table.select(other_columns))


CSV_LIMITS = Limits(k_max=300, e_max=0.55)
"""Limits of scores: a robot that converges at step 300, or with an error of 0.55, gets no points."""


@pytest.fixture
def csv_rows(experiments: list[Trials], path: Path) -> list[dict[str, str]]:
    """The two experiments, written as CSV and read again: a row for each of their three trials."""
    write_csv(path, experiments, CSV_LIMITS)
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
    """The limits K_max and e_max are those with which the file was written."""
    first_experiment, _ = experiments
    row_of_trial_0, *_ = csv_rows
    for name, scores in first_experiment.scores(CSV_LIMITS).items():
        score_of_trial_0, *_ = scores
        assert float(row_of_trial_0[name]) == pytest.approx(score_of_trial_0)
    assert (row_of_trial_0["K_max"], row_of_trial_0["e_max"]) == ("300", "0.55")


def test_a_line_of_csv_has_means_and_sums_over_the_robots_of_its_trial(
    experiments: list[Trials], csv_rows: list[dict[str, str]]
) -> None:
    """The second line holds trial 1 of the first experiment, with the b_hat of the last filter step."""
    trials, _ = experiments
    trial = 1
    row = csv_rows[trial]
    *_, b_hat_of_last_filter_step = trials.b_hat[trial]

    assert float(row["mean_K"]) == pytest.approx(trials.convergence_steps[trial].mean())
    assert float(row["mean_e"]) == pytest.approx(trials.errors[trial].mean())
    assert float(row["mean_b_hat"]) == pytest.approx(b_hat_of_last_filter_step.mean())
    assert int(row["tests"]) == sum(trials.tests[trial])
    assert int(row["updates"]) == sum(trials.updates[trial])
