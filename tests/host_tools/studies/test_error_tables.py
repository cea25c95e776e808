"""What this project's own studies share: measures, text and tables, and running their programs."""

from __future__ import annotations

import argparse
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

import mcp_asdf_tools as m
from host_tools.studies.conftest import OVERCONFIDENT, UNDERCONFIDENT, short_trials
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.results import Trials
from mcp_asdf_tools.studies import ageing, error_tables, peers, robust_filter, swarm_sizes
from mcp_asdf_tools.studies.bootstrap import Interval
from support import ROOT

# --- Measures ------------------------------------------------------------------------------------------


def trials_of_four_robots(x: Any, b_hat: Any = None, **changes: Any) -> Trials:
    """Make two trials of four robots, the first of them flawed, with the given values over time."""
    settings = {"robots": 4, "flawed": 1, "steps": 4000, "fill_ratio": 0.5, "true_accuracy": 0.9, "trials": 2}
    experiment = Experiment(**settings | changes)
    counts = np.zeros((2, 4), np.int64)
    b_hat = np.full((2, 1, 4), 0.9) if b_hat is None else b_hat
    return Trials(experiment, [0, 1], counts, np.zeros((2, 4)), b_hat, counts, counts, {"x": np.asarray(x)})


def series_ending_in(*last_values: Sequence[float], length: int = 9) -> Any:
    """Return x of two equal trials that is 0.7 but for the last values, one list over the robots each."""
    x = np.full((2, length, 4), 0.7)
    x[:, -len(last_values) :] = last_values
    return x


def test_the_late_error_is_that_of_the_last_quarter() -> None:
    trials = trials_of_four_robots(series_ending_in([0.4, 0.6, 0.8, 0.0], [0.5, 0.7, 0.6, 0.0]))
    expected = (0.1 + 0.1 + 0.3 + 0.5 + 0.0 + 0.2 + 0.1 + 0.5) / 8  # two of nine values
    assert error_tables.late_errors(trials) == pytest.approx([expected, expected])


def test_the_late_error_of_few_values_is_that_of_the_last_one() -> None:
    trials = trials_of_four_robots(series_ending_in([0.4, 0.6, 0.8, 0.0], length=3))
    assert error_tables.late_errors(trials) == pytest.approx([0.25, 0.25])


def test_the_late_error_may_leave_out_robots_and_have_another_fill_ratio() -> None:
    trials = trials_of_four_robots(series_ending_in([0.4, 0.6, 0.8, 0.0], [0.5, 0.7, 0.6, 0.0]))
    expected = (0.2 + 0.0 + 0.2 + 0.1 + 0.1 + 0.0) / 6
    assert error_tables.late_errors(trials, honest_robots=3, late_fill_ratio=0.6) == pytest.approx(
        [expected, expected]
    )


def test_healthy_robots_are_harmed_where_b_hat_ends_more_than_0_05_off() -> None:
    b_hat = np.array([[[0.5, 0.9, 0.9, 0.9]], [[0.5, 0.84, 0.94, 0.9]]])
    trials = trials_of_four_robots(series_ending_in([0.5] * 4), b_hat)
    assert error_tables.harmed_shares(trials) == pytest.approx([0, 1 / 3])


def test_nobody_can_be_harmed_where_all_robots_are_flawed() -> None:
    trials = trials_of_four_robots(series_ending_in([0.5] * 4), flawed=4)
    assert np.isnan(error_tables.harmed_shares(trials)).all()


def measured_numbers(trials: Any) -> Any:
    """Measure lists of numbers, which stand for the trials of experiments."""
    return np.asarray(trials, float)


def test_the_mean_of_medians_lies_in_its_interval() -> None:
    experiments: Any = [range(9), range(100, 109)]
    value, low, high = error_tables.mean_of_medians(measured_numbers, experiments)
    assert value == 54
    assert 50 < low < 54 < high < 58


def test_rare_events_are_averaged_by_means() -> None:
    experiments: Any = [[1] + [0] * 19, [0] * 20]
    value, low, high = error_tables.mean_of_means(measured_numbers, experiments)
    assert (value, low, high) == pytest.approx((1 / 40, 0, 3 / 40))  # resamples have the one up to 3 times


# --- Text ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("error", "text"), [(0.00994, "0.0099"), (0.01, "0.010"), (0.1, "0.100")])
def test_errors_have_two_or_three_significant_digits(error: float, text: str) -> None:
    assert error_tables.format_error(error) == text


@pytest.mark.parametrize(
    ("interval", "text"),
    [
        (Interval(50, 49.5, 50.5), "50.0"),
        (Interval(50, 49, 50), "50.0 (49.0..50.0)"),
        (Interval(50, 50, 51), "50.0 (50.0..51.0)"),
        (Interval(50, 49.98, 50.01), "50.0"),
    ],
)
def test_an_interval_is_shown_where_it_is_wide(interval: Interval, text: str) -> None:
    assert error_tables.format_interval(interval, error_tables.format_tenths, 0.5) == text


def test_an_interval_that_rounds_to_one_number_is_not_shown() -> None:
    interval = Interval(50, 49.96, 50.04)
    assert error_tables.format_interval(interval, error_tables.format_tenths, 0.01) == "50.0"


def test_a_table_has_the_rows_and_columns_of_its_experiments() -> None:
    experiments = short_trials(who=[{"robots": 4, "filter": ["none", "robust"]}, {"robots": 8}])
    table = error_tables.markdown_table(
        "trials",
        experiments,
        lambda experiment: f"{experiment.robots} robots",
        peers.column_label,
        lambda group: str(len(group)),
    )
    assert table.splitlines() == [
        "| trials | no filter | robust | ASDF- |",
        "|---|---|---|---|",
        "| 4 robots | 1 | 1 |  |",
        "| 8 robots |  |  | 1 |",
    ]


def test_underconfident_robots_stand_before_overconfident_ones() -> None:
    experiments = short_trials(sensors=[OVERCONFIDENT, UNDERCONFIDENT])
    overconfident, underconfident = (error_tables.late_error_text([trials]) for trials in experiments)
    assert error_tables.under_and_over_text(experiments) == f"{underconfident}, {overconfident}"
    assert error_tables.under_and_over_text(experiments[:1]) == overconfident


def test_tables_are_written_between_their_marks(tmp_path: Path) -> None:
    error_tables.write_tables(tmp_path / "a.md", "A study", {"first": "| 1 |", "second": "| 2 |"})
    text = (tmp_path / "a.md").read_text(encoding="utf-8")
    assert text.startswith("# A study\n\nMedians over trials.")
    assert text.endswith("<!-- first -->\n| 1 |\n<!-- end -->\n\n<!-- second -->\n| 2 |\n<!-- end -->\n")


# --- Programs ------------------------------------------------------------------------------------------


def arguments_for(folder: Path, quick: bool = True) -> argparse.Namespace:
    return argparse.Namespace(folder=folder, workers=1, quick=quick)


def test_the_quick_form_has_few_and_short_trials(tmp_path: Path) -> None:
    experiments = m.grid(robots=3, flawed=1, steps=9000, trials=30)
    (trials,) = error_tables.run_experiments("a", experiments, arguments_for(tmp_path))
    assert (trials.experiment.trials, trials.experiment.steps) == (2, 4000)
    assert (tmp_path / "a.parquet").exists()


def test_the_full_form_is_that_of_the_experiments(tmp_path: Path) -> None:
    experiments = m.grid(robots=3, flawed=1, steps=400, filter_period=100, trials=3)
    new_folder = tmp_path / "not there yet"
    (trials,) = error_tables.run_experiments("a", experiments, arguments_for(new_folder, False), record=50)
    assert trials.experiment == experiments[0]
    assert trials.sampling_interval == 50


def test_robots_of_the_package_run_in_one_process(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    chosen_workers = []

    def simulate(experiments: Any, output: Path, *, workers: int, record: int) -> Any:
        chosen_workers.append(workers)
        return m.simulate(experiments, output, workers=1, record=record)

    library = argparse.Namespace(simulate=simulate, experiments_in=m.experiments_in)
    monkeypatch.setattr(error_tables, "m", library)
    arguments = argparse.Namespace(folder=tmp_path, workers=7, quick=True)
    plain = m.grid(robots=3, flawed=1)
    peer = m.grid(robots=3, flawed=1, firmware=peers.OracleRobot, sensor=peers.KnownSensors)
    error_tables.run_experiments("plain", plain, arguments)
    error_tables.run_experiments("peer", peer, arguments)
    assert chosen_workers == [7, 1]


def run_tiny_program(study: Any, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Run a study's program with two short experiments in place of each of its sets, and without plots."""
    tiny = m.grid(robots=3, flawed=1, steps=1000, filter_period=100, trials=2, filter=["none", "robust"])
    monkeypatch.setattr(m, "read_experiments", lambda file_name: tiny)
    for function in ("ageing", "peer", "wandering", "world"):
        monkeypatch.setattr(study, f"{function}_experiments", lambda: tiny, raising=False)
    for function in ("draw_errors", "draw_sizes"):
        monkeypatch.setattr(study, function, lambda *experiments: Figure(), raising=False)
    monkeypatch.setattr(swarm_sizes, "TIMED_ROBOT_STEPS", 1000)
    monkeypatch.setattr("sys.argv", ["study", str(folder)])
    study.main()


@pytest.mark.parametrize(
    ("study", "name", "marks"),
    [
        (robust_filter, "robust", ["grid", "beyond", "peers", "worlds"]),
        (ageing, "ageing", ["filters", "peers"]),
        (swarm_sizes, "scale", ["scale"]),
    ],
)
def test_a_program_writes_its_tables_and_its_picture(
    study: Any, name: str, marks: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run_tiny_program(study, tmp_path, monkeypatch)
    text = (tmp_path / f"{name}.md").read_text(encoding="utf-8")
    tables = re.findall(r"<!-- (\w+) -->\n(\|.*?)\n<!-- end -->", text, re.DOTALL)
    assert [mark for mark, _ in tables] == marks
    assert all(table.splitlines()[0].endswith("| no filter | robust |") for _, table in tables)
    assert (tmp_path / f"{name}.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("study", "intervals"),
    [
        (
            robust_filter,
            {
                "robust_grid": 1000,
                "robust_beyond": 1000,
                "robust_wandering": 1000,
                "robust_peers": 500,
                "robust_worlds": 500,
            },
        ),
        (ageing, {"ageing": 1000, "ageing_peers": 1000}),
        (swarm_sizes, {"scale": 1000}),
    ],
)
def test_a_program_keeps_its_results_with_values_over_time(
    study: Any, intervals: dict[str, int], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run_tiny_program(study, tmp_path, monkeypatch)
    assert {path.stem: sampling_interval(path) for path in tmp_path.glob("*.parquet")} == intervals


def sampling_interval(path: Path) -> int:
    return m.experiments_in(m.read_table(path))[0].sampling_interval


@pytest.mark.slow
@pytest.mark.parametrize(
    ("study", "name"), [(robust_filter, "robust"), (ageing, "ageing"), (swarm_sizes, "scale")]
)
def test_a_program_writes_the_tables_and_the_picture_of_its_page(
    study: Any, name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(error_tables, "QUICK_STEPS", 2000)
    monkeypatch.setattr("sys.argv", ["study", str(tmp_path), "--quick", "--workers", "2"])
    monkeypatch.setattr(swarm_sizes, "TIMED_ROBOT_STEPS", 1000)
    study.main()
    page_name = {"scale": "robust"}.get(name, name)
    page = (ROOT / f"docs/{page_name}.md").read_text(encoding="utf-8")
    marked = re.findall(
        r"<!-- (\w+) -->\n(.*?)\n<!-- end -->", (tmp_path / f"{name}.md").read_text(), re.DOTALL
    )
    assert marked
    for mark, table in marked:
        page_table = page.partition(f"<!-- {mark} -->\n")[2].partition("\n<!-- end -->")[0]
        rows = {line.split("|")[1] for line in table.splitlines()}
        # The quick form is shorter than what the page calls 10,000 steps.
        page_rows = {line.split("|")[1].replace(", 10,000 steps", "") for line in page_table.splitlines()}
        assert page_rows <= rows
    assert (tmp_path / f"{name}.png").read_bytes().startswith(b"\x89PNG")
