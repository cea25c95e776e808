"""Results as files: what is written is what was measured, and readable without this project."""

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

from host_tools.test_untrusted import PARSERS, sound_results, try_to_read
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.common.versions import software_versions
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.results import (
    FORMAT,
    QUANTITIES,
    differing,
    experiments_at,
    experiments_in,
    matching,
    metadata_of,
    only,
    read_table,
    rescored,
    stretches_of,
    table_of,
    write_csv,
    write_tables,
)
from mcp_asdf_tools.experiments.scores import SCORES, Limits
from mcp_asdf_tools.experiments.trials import run_trials
from support import draws

SHORT = Experiment(robots=4, flawed=1, filter="asdf-plus", steps=300, filter_period=100, trials=3)
OTHER = replace(SHORT, filter="none", seed=2**64 - 1)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """A file of two experiments with values over time, trials of the first in another order."""
    parts = [(SHORT, 2, 1), (SHORT, 0, 2), (OTHER, 0, 3)]
    tables = [table_of(run_trials(*part, sampling_interval=10), 10) for part in parts]
    write_tables(tmp_path / "results.parquet", [pa.concat_tables(tables)])
    return tmp_path / "results.parquet"


def test_results_come_back(path: Path, tmp_path: Path) -> None:
    found = experiments_in(read_table(path))
    assert [each[1:] for each in stretches_of(read_table(path))] == [(0, 3), (3, 6)]
    assert [trials.experiment for trials in found] == [SHORT, OTHER]
    for trials in found:
        measured = run_trials(trials.experiment, 0, 3, sampling_interval=10)
        assert trials.numbers == [0, 1, 2]
        for name in ("convergence_steps", "errors", "b_hat", "tests", "updates", "sampling_interval"):
            assert np.array_equal(getattr(trials, name), getattr(measured, name)), name
        for name in QUANTITIES:
            assert np.array_equal(trials.records[name], measured.records[name]), name
        assert trials.records["x"].shape == (3, 31, 4)
    alone = replace(SHORT, robots=1)
    write_tables(tmp_path / "brief.parquet", [table_of(run_trials(alone, 0, 1))])
    (found_again,) = experiments_in(read_table(tmp_path / "brief.parquet"))
    assert (found_again.experiment, found_again.records) == (alone, {})


def test_experiments_are_found_by_their_parameters(path: Path) -> None:
    """A number in any of its spellings."""
    both = first, second = experiments_in(read_table(path))
    assert matching(both, {}) == matching(both, {"steps": "3e2", "fill_ratio": 0.55}) == both
    for where in ({"filter": "none"}, {"seed": str(OTHER.seed)}):
        assert only(matching(both, where)) is second
    assert only([first]) is first and differing([first]) == "no parameters"
    varied = rf"seed=1\|{OTHER.seed}, filter=asdf-plus\|none"
    for where, words in (
        ({"filtr": "none"}, rf"called so; did you mean filter\?; the experiments differ in {varied}"),
        ({"filter": "non"}, "filter=non: no experiment has it; filter is asdf-plus or none"),
        ({"steps": "many"}, "steps=many: no experiment has it; steps is 300"),
        ({}, f"2 experiments match; choose one with where {varied}"),
    ):
        with pytest.raises(UsageError, match=words):
            only(matching(both, where))


def test_any_reader_of_parquet_finds_everything(path: Path) -> None:
    file = pq.ParquetFile(path)
    row = file.read().to_pylist()[1]
    trials = run_trials(SHORT, 0, 1)
    for name, value in SHORT.parameters().items():
        assert row[name] == value, name
    assert row["trial"] == 0
    assert (row["k"], row["e"]) == (trials.convergence_steps[0].tolist(), trials.errors[0].tolist())
    assert row["b_hat"] == trials.b_hat.ravel().tolist()
    assert (row["H"], row["h_K"], row["h_e"]) == tuple(each[0] for each in trials.scores().values())
    said = json.loads(file.schema_arrow.metadata[b"mcp-asdf"])
    columns = said.pop("columns")
    assert list(columns) == file.schema_arrow.names
    assert all(each["meaning"] for each in columns.values())
    units = [columns[name]["unit"] for name in ("k", "filter_period", "tile", "speed", "H", "fill_ratio")]
    assert units == ["step", "step", "m", "m/s", "point of 100", "1"]
    assert said == {"format": FORMAT, "versions": software_versions(), "delta": 0.01, "sampling_interval": 10}
    assert said == metadata_of(read_table(path))


def with_column(name: str, values: object) -> pa.Table:
    table = sound_results()
    return table.set_column(table.column_names.index(name), name, values)


def each_damage() -> Iterator[tuple[pa.Table, str]]:
    """Tables with one thing wrong, and what the refusal has to name."""
    table = sound_results()
    yield pa.table({"k": [1]}), "holds no results"
    yield table.slice(0, 0), "holds no trials; run mcp-asdf sweep again"
    yield table.drop_columns(["e", "k"]), "it has no e, k; run mcp-asdf sweep again"
    older = table.replace_schema_metadata({b"mcp-asdf": json.dumps({"format": FORMAT - 1})})
    yield older, f"in format {FORMAT - 1}; format {FORMAT} is needed: run mcp-asdf sweep again"
    for name in table.column_names:
        if name not in Experiment().parameters():
            yield table.drop_columns([name]), f"has no {name}"
        yield with_column(name, pa.array([b"?"] * len(table))), f"column {name} "
        if name not in ("omega", *SCORES):  # what may be left out, and what is found anew
            yield with_column(name, pa.array([None] * len(table), table[name].type)), ""
        if pa.types.is_list(table[name].type):
            lists = table[name].to_pylist()
            wrong: list[Any]
            for wrong in (
                [*lists[1:], lists[0][:-1]],
                [[None] * len(each) for each in lists],
                [[]] * len(lists),
            ):
                told = f"column {'record_' if name == 'record_t' else name}"
                yield with_column(name, pa.array(wrong, table[name].type)), told
        elif table[name].type == pa.uint64():
            for number in (0, 2**64 - 1):
                yield with_column(name, pa.array([number] * len(table), pa.uint64())), ""
    yield table.append_column("k", table["k"]), "k"
    known = metadata_of(table)
    for text in (b"[" * 100_000, b'{"a":' * 100_000, b"[]", b"\xff", b"{", json.dumps(None).encode()):
        yield table.replace_schema_metadata({b"mcp-asdf": text}), "no results"
    for key, value in (("sampling_interval", -1), ("sampling_interval", "1"), ("versions", 3)):
        changed = json.dumps(known | {key: value})
        yield table.replace_schema_metadata({b"mcp-asdf": changed}), "metadata"


@pytest.mark.random
def test_results_of_the_present_format_with_one_thing_wrong_are_refused(path: Path) -> None:
    damages = list(each_damage())
    assert len(damages) > 100
    for table, told in damages[:4] + damages[4 :: len(damages) // draws(len(damages))]:
        pq.write_table(table, path)
        said = try_to_read(PARSERS["results"], path, path.read_bytes())
        assert told in said and (said or not told), (told, said)
    assert f"cannot read {path}: " in try_to_read(PARSERS["results"], path, b"nothing")
    path.unlink()
    with pytest.raises(UsageError, match="there is no such file"):
        read_table(path)


@pytest.mark.parametrize("name", [*Experiment().parameters()])
def test_results_without_a_parameter_have_its_default(name: str, path: Path) -> None:
    values = {"trials": 1, "robots": 20, "flawed": 6, name: getattr(Experiment(), name)}
    experiment = replace(SHORT, **values)
    pq.write_table(table_of(run_trials(experiment, 0, 1)).drop_columns([name]), path)
    (trials,) = experiments_at(path)
    assert trials.experiment == experiments_in(read_table(path))[0].experiment
    assert trials.experiment.parameters()[name] == Experiment().parameters()[name]


def test_a_table_without_a_parameter_can_be_scored_again() -> None:
    table = table_of(run_trials(SHORT, 0, 2))
    again = rescored(table.drop_columns(["latency"]), Limits())
    assert again["H"].equals(table["H"])


def test_results_of_before_a_parameter_stand_beside_newer_ones(tmp_path: Path) -> None:
    table = table_of(run_trials(SHORT, 0, 2))
    pq.write_table(table.drop_columns(["latency"]), tmp_path / "1.parquet")
    pq.write_table(table, tmp_path / "2.parquet")
    assert read_table(tmp_path)["latency"].to_pylist() == [0, 0, 0, 0]


def results_with_drift_spread(value: float) -> Any:
    """Return results of an earlier version, which had this parameter."""
    table = table_of(run_trials(SHORT, 0, 2))
    return table.append_column("drift_spread", pa.array([value] * len(table)))


def test_results_with_a_former_parameter_that_had_no_effect_are_read(path: Path) -> None:
    pq.write_table(results_with_drift_spread(0.0), path)
    (trials,) = experiments_at(path)
    assert trials.experiment == SHORT


def test_results_with_a_former_parameter_that_had_an_effect_are_refused(path: Path) -> None:
    pq.write_table(results_with_drift_spread(1e-6), path)
    with pytest.raises(UsageError, match="has results with drift_spread, a parameter of earlier versions"):
        list(experiments_at(path))


def test_results_may_not_name_a_file_as_their_graph(path: Path, tmp_path: Path) -> None:
    """Opening this one, a pipe that nobody writes, would wait for ever."""
    os.mkfifo(tmp_path / "pipe")
    wired = replace(SHORT, topology="graph", graph="0 1", trials=1)
    table = table_of(run_trials(wired, 0, 1))
    graphs = pa.array([str(tmp_path / "pipe")])
    pq.write_table(table.set_column(table.column_names.index("graph"), "graph", graphs), path)
    with pytest.raises(UsageError, match="has to hold the edges themselves"):
        list(experiments_at(path))


def test_other_limits_change_the_scores_and_nothing_else(path: Path) -> None:
    table, limits = read_table(path), Limits(1000, 0.7)
    other = rescored(table, limits)
    assert other.schema.equals(table.schema, check_metadata=True)
    kept = [name for name in table.column_names if name not in ("H", "h_K", "h_e")]
    assert other.select(kept).equals(table.select(kept))
    scores = experiments_in(table)[1].scores(limits)
    for name, values in zip(("H", "h_K", "h_e"), scores.values(), strict=True):
        assert other[name].to_pylist()[3:] == values.tolist()
        assert not other[name].equals(table[name])


def test_csv_has_a_line_for_every_trial(path: Path, tmp_path: Path) -> None:
    found, limits = experiments_in(read_table(path)), Limits(300, 0.55)
    write_csv(tmp_path / "results.csv", found, limits)
    with (tmp_path / "results.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [(row["filter"], row["trial"], row["seed"]) for row in rows] == [
        (experiment.filter, str(trial), str(experiment.seed))
        for experiment in (SHORT, OTHER)
        for trial in range(3)
    ]
    first, row = found[0], rows[1]
    scores = (each[1] for each in first.scores(limits).values())
    means = (first.convergence_steps[1].mean(), first.errors[1].mean(), first.b_hat[1, -1].mean())
    expected = (*scores, *means, first.tests[1].sum(), first.updates[1].sum(), limits.k_max, limits.e_max)
    names = ("H", "h_K", "h_e", "mean_K", "mean_e", "mean_b_hat", "tests", "updates", "K_max", "e_max")
    assert [float(row[name]) for name in names] == pytest.approx(expected)
