"""``mcp-asdf export`` and ``to_frame``: values of robots over time from results, and from logs by replay."""

from __future__ import annotations

import gzip
import json
from pathlib import Path
from typing import Any

import pyarrow as pa  # type: ignore[import-untyped]
import pyarrow.csv  # type: ignore[import-untyped]
import pyarrow.parquet as pq  # type: ignore[import-untyped]
import pytest

from events_files import lines_of
from mcp_asdf_tools import Experiment, UsageError, library, read_table, simulate, to_frame
from mcp_asdf_tools.cli.main import main
from mcp_asdf_tools.recording.events import events_path

pytestmark = pytest.mark.usefixtures("no_bus_is_left")

Capture = pytest.CaptureFixture[str]

PARAMETERS: dict[str, Any] = {
    "robots": 4,
    "flawed": 1,
    "steps": 60,
    "filter": "asdf-plus",
    "filter_period": 20,
    "topology": "dynamic",
    "seed": 3,
}
"""Parameters of a swarm, and of an experiment whose trial 0 is the same run."""


def write_log(path: Path, *options: str) -> Path:
    """Run the swarm by the command, with further options and a log, and return the log's path."""
    parameters = [f"--{name.replace('_', '-')}={value}" for name, value in PARAMETERS.items()]
    assert main(["swarm", *parameters, *options, "--log", str(path), "--quiet"]) == 0
    return path


@pytest.fixture(scope="module")
def swarm_log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The log of the swarm, with events beside it; only to be read."""
    return write_log(tmp_path_factory.mktemp("swarm") / "run.log")


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Results of trial 0 with the values of every step; only to be read."""
    path = tmp_path_factory.mktemp("results") / "run.parquet"
    simulate(Experiment(**PARAMETERS, trials=1), path, record=1)
    return path


# --- The library -----------------------------------------------------------------------------------------


def test_a_log_of_a_swarm_gives_the_same_table_as_a_simulated_trial_with_the_same_parameters(
    swarm_log: Path, results: Path
) -> None:
    """The table has a row for each robot and step, with the robot's values."""
    assert to_frame(swarm_log).equals(to_frame(results))


def test_results_in_memory_give_the_same_table_as_their_file(results: Path) -> None:
    assert to_frame(read_table(results)).equals(to_frame(str(results)))


def test_a_folder_of_results_gives_the_table_of_the_results_in_it(results: Path) -> None:
    """An unfinished sweep leaves a folder. This folder has a single file, with the results."""
    assert to_frame(results.parent).equals(to_frame(results))


def test_one_of_three_trials_gives_a_table_of_its_robots_and_recorded_steps() -> None:
    """Trial 1 has four robots, which are recorded at the steps 0, 30 and 60."""
    results_of_three_trials = simulate(Experiment(**PARAMETERS, trials=3), record=30)
    results_of_trial_1 = results_of_three_trials.slice(offset=1, length=1)
    table = to_frame(results_of_trial_1)

    assert table["trial"].to_pylist() == [1] * 12
    assert table["step"].to_pylist() == [0, 0, 0, 0, 30, 30, 30, 30, 60, 60, 60, 60]


def test_a_log_that_is_replayed_in_pieces_gives_the_same_table(
    swarm_log: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A piece has at most seven rows here, so each of 61 states, with rows of four robots, is a piece."""
    table_at_once = to_frame(swarm_log)
    monkeypatch.setattr(library, "_ROWS_AT_ONCE", 7)
    assert len(list(library.stream_tidy_tables(swarm_log))) == 61
    assert to_frame(swarm_log).equals(table_at_once)


def test_a_dead_robot_has_rows_without_values(tmp_path: Path) -> None:
    """Robot 2 crashes in step 21, and is dead for 15 steps."""
    log = write_log(tmp_path / "run.log", "--fault", "crash=1.0,from=20,to=21,robots=2,ticks=15")
    table = to_frame(log)
    rows_without_values = table.filter(pa.compute.is_null(table["x"]))

    assert rows_without_values["step"].to_pylist() == list(range(21, 21 + 15))
    assert rows_without_values["robot"].to_pylist() == [2] * 15
    assert rows_without_values["b_hat"].null_count == 15


def test_a_log_that_was_cut_off_is_exported_as_far_as_it_goes(swarm_log: Path, tmp_path: Path) -> None:
    """Its events are a header, a line for each of four robots in nine steps, and the beginning of a line.

    The last step in the table is 9. Values are computed from the events, so there is no file of frames.
    """
    cut_off_log = tmp_path / "run.log.part"
    header, *lines_of_robots = lines_of(events_path(swarm_log))
    lines_of_nine_steps = lines_of_robots[: 9 * 4]
    with gzip.open(events_path(cut_off_log), "wt") as file:
        file.write("".join([header, *lines_of_nine_steps, "[0,1,"]))

    assert max(to_frame(cut_off_log)["step"].to_pylist()) == 9


def test_a_log_without_events_cannot_be_exported(tmp_path: Path) -> None:
    """The error says that the events are missing, and that results can be given instead."""
    with pytest.raises(UsageError, match=r"there is no .*/run\.log\.events, .* give results \(\.parquet\)"):
        to_frame(tmp_path / "run.log")


# --- The command -----------------------------------------------------------------------------------------


def test_export_writes_the_values_of_a_log_as_csv(swarm_log: Path, tmp_path: Path, capsys: Capture) -> None:
    """The file has 4 * (1 + 60) = 244 rows: four robots at the start and after each of 60 steps."""
    path = tmp_path / "robots.csv"
    assert main(["export", str(swarm_log), str(path)]) == 0
    assert capsys.readouterr().out == f"wrote 244 rows to {path}\n"
    assert pyarrow.csv.read_csv(path)["x"].to_pylist() == to_frame(swarm_log)["x"].to_pylist()


def test_export_writes_the_values_of_results_as_parquet(results: Path, tmp_path: Path) -> None:
    path = tmp_path / "robots.parquet"
    assert main(["export", str(results), str(path)]) == 0
    assert pq.read_table(path).equals(to_frame(results))


@pytest.mark.parametrize("name", ["run.pq", "run.PARQUET"])
def test_export_reads_results_whose_file_has_another_suffix_of_parquet(
    name: str, results: Path, tmp_path: Path
) -> None:
    """The files are called run.pq and run.PARQUET."""
    path = tmp_path / name
    path.write_bytes(results.read_bytes())
    assert main(["export", str(path), str(tmp_path / "robots.csv")]) == 0


def test_export_reports_the_files_and_the_number_of_rows_as_json(
    results: Path, tmp_path: Path, capsys: Capture
) -> None:
    """The source is the file that is read. The table is the file that is written.

    It has a row for each of four robots at the start and after each of 60 steps.
    """
    path = tmp_path / "robots.csv"
    assert main(["export", str(results), str(path), "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report == {"source": str(results), "table": str(path), "rows": 4 * (1 + 60)}


def test_export_refuses_to_write_its_table_over_the_log(
    swarm_log: Path, tmp_path: Path, capsys: Capture
) -> None:
    """The log of a swarm may be a CSV file itself. The command is refused, and the log stays as it is."""
    log = tmp_path / "run.csv"
    log.write_bytes(b"frames")
    events_path(log).write_bytes(events_path(swarm_log).read_bytes())

    assert main(["export", str(log), str(log)]) == 2
    assert f"{log} is what is to be exported; choose another name" in capsys.readouterr().err
    assert log.read_bytes() == b"frames"


def test_export_of_results_without_records_leaves_no_file(tmp_path: Path, capsys: Capture) -> None:
    """Results have values of robots only if they were recorded. The error says how to record them."""
    simulate(Experiment(**PARAMETERS, trials=1), tmp_path / "run.parquet")
    assert main(["export", str(tmp_path / "run.parquet"), str(tmp_path / "robots.csv")]) == 2
    assert "run simulate or sweep again with --record 100" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["run.parquet"]


def test_export_refuses_a_table_called_xlsx_before_it_reads_the_log(tmp_path: Path, capsys: Capture) -> None:
    """The log does not even exist, but the error is about the name of the table."""
    assert main(["export", str(tmp_path / "missing.log"), str(tmp_path / "robots.xlsx")]) == 2
    assert "choose a name that ends in .csv or .parquet" in capsys.readouterr().err
