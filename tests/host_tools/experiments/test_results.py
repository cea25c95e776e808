"""Results as files: what is written is what was measured, and readable without this project."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa  # type: ignore[import-untyped]
import pyarrow.parquet as pq  # type: ignore[import-untyped]
import pytest

from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.common.versions import software_versions
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.results import (
    FORMAT,
    QUANTITIES,
    experiments_in,
    metadata_of,
    read_table,
    rescored,
    table_of,
    write_csv,
    write_table,
)
from mcp_asdf_tools.experiments.scores import Limits, score
from mcp_asdf_tools.experiments.trials import run_trials

SHORT = Experiment(robots=4, flawed=1, steps=300, filter_period=100, trials=3)
OTHER = replace(SHORT, filter="none", seed=2**64 - 1)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """A file of two experiments, the first recorded."""
    tables = [table_of(run_trials(each, 0, 3, sampling_interval=10), 10) for each in (SHORT, OTHER)]
    write_table(tmp_path / "results.parquet", pa.concat_tables(tables))
    return tmp_path / "results.parquet"


def test_results_come_back(path: Path) -> None:
    table = read_table(path)
    found = experiments_in(table)
    assert [trials.experiment for trials in found] == [SHORT, OTHER]
    for trials in found:
        measured = run_trials(trials.experiment, 0, 3, sampling_interval=10)
        assert trials.numbers == [0, 1, 2]
        for name in ("convergence_steps", "errors", "b_hat", "tests", "updates"):
            assert np.array_equal(getattr(trials, name), getattr(measured, name)), name
        for name in QUANTITIES:
            assert np.array_equal(trials.records[name], measured.records[name]), name
        assert trials.records["x"].shape == (3, 31, 4)


def test_trials_are_sorted(tmp_path: Path) -> None:
    tables = [table_of(run_trials(SHORT, first, 1)) for first in (2, 0, 1)]
    write_table(tmp_path / "results.parquet", pa.concat_tables(tables))
    (trials,) = experiments_in(read_table(tmp_path / "results.parquet"))
    assert trials.numbers == [0, 1, 2]
    assert np.array_equal(trials.convergence_steps, run_trials(SHORT, 0, 3).convergence_steps)
    assert trials.records == {}


def test_any_reader_of_parquet_finds_everything(path: Path) -> None:
    file = pq.ParquetFile(path)
    row = file.read().to_pylist()[0]
    for name, value in SHORT.parameters().items():
        assert row[name] == value, name
    assert len(row["k"]) == len(row["e"]) == 4
    assert len(row["b_hat"]) == 3 * 4
    said = json.loads(file.schema_arrow.metadata[b"mcp-asdf"])
    assert said == {"format": FORMAT, "versions": software_versions(), "delta": 0.01, "sampling_interval": 10}
    assert said == metadata_of(read_table(path))


def test_a_file_of_something_else_is_refused(tmp_path: Path) -> None:
    for name, content in (("text", b"nothing"), ("empty", b"")):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(UsageError, match="cannot read"):
            read_table(tmp_path / name)
    with pytest.raises(UsageError, match="cannot read"):
        read_table(tmp_path / "absent")
    pq.write_table(pa.table({"k": [1]}), tmp_path / "other.parquet")
    with pytest.raises(UsageError, match="holds no results"):
        read_table(tmp_path / "other.parquet")


def test_a_file_without_trials_is_refused(path: Path) -> None:
    pq.write_table(pq.read_table(path).slice(0, 0), path)
    with pytest.raises(UsageError, match=r"results\.parquet holds no trials; run mcp-asdf sweep again"):
        read_table(path)


def test_a_file_of_an_older_format_is_named(path: Path) -> None:
    older = read_table(path).replace_schema_metadata({b"mcp-asdf": json.dumps({"format": FORMAT - 1})})
    pq.write_table(older, path)
    message = f"holds results in format {FORMAT - 1}; format {FORMAT} is needed: run mcp-asdf sweep again"
    with pytest.raises(UsageError, match=message):
        read_table(path)


def test_a_table_holds_the_scores_with_the_papers_limits(path: Path) -> None:
    table = read_table(path)
    for start, trials in zip((0, 3), experiments_in(table), strict=True):
        expected = score(trials.convergence_steps, trials.errors, Limits(300, 0.45))
        for name, values in (("H", expected.h), ("h_K", expected.h_k), ("h_e", expected.h_e)):
            assert table[name].to_pylist()[start : start + 3] == values.tolist(), name


def test_other_limits_change_the_scores_and_nothing_else(path: Path) -> None:
    table, limits = read_table(path), Limits(1000, 0.7)
    other = rescored(table, lambda experiment: limits)
    assert other.schema.equals(table.schema, check_metadata=True)
    kept = [name for name in table.column_names if name not in ("H", "h_K", "h_e")]
    assert other.select(kept).equals(table.select(kept))
    assert not other["H"].equals(table["H"])
    trials = experiments_in(table)[1]
    assert other["h_K"].to_pylist()[3:] == score(trials.convergence_steps, trials.errors, limits).h_k.tolist()


def test_csv_has_a_line_for_every_trial(path: Path, tmp_path: Path) -> None:
    found, limits = experiments_in(read_table(path)), Limits(300, 0.55)
    write_csv(tmp_path / "results.csv", found, lambda _: limits)
    with (tmp_path / "results.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [(row["filter"], row["trial"], row["seed"]) for row in rows] == [
        (experiment.filter, str(trial), str(experiment.seed))
        for experiment in (SHORT, OTHER)
        for trial in range(3)
    ]
    scores = score(found[0].convergence_steps, found[0].errors, limits)
    assert float(rows[1]["H"]) == pytest.approx(scores.h[1])
    assert float(rows[1]["mean_K"]) == found[0].convergence_steps[1].mean()
    assert float(rows[1]["mean_e"]) == pytest.approx(found[0].errors[1].mean())
    assert float(rows[1]["mean_b_hat"]) == pytest.approx(found[0].b_hat[1, -1].mean())
    assert float(rows[1]["updates"]) == found[0].updates[1].sum()
