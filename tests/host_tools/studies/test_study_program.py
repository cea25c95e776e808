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
from host_tools.studies.conftest import short_trials
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.results import Trials
from mcp_asdf_tools.studies import (
    ageing,
    peers,
    related_work,
    robust_filter,
    study_program,
    swarm_sizes,
    two_readings,
)
from mcp_asdf_tools.studies.bootstrap import Interval, resample_mean
from mcp_asdf_tools.studies.study_program import FLAWS
from support import ROOT

# --- Measures ------------------------------------------------------------------------------------------


def trials_of_four_robots(x: Any, b_hat: Any = None, **changes: Any) -> Trials:
    """Make two trials of four robots, the first of them flawed, with f = 0.5, b = 0.9 and these values of x.

    ``x`` has the shape (trials, samples, robots), and b_hat (trials, filter steps, robots); None stands for
    a b_hat of 0.9.
    """
    settings = {"robots": 4, "flawed": 1, "steps": 4000, "fill_ratio": 0.5, "true_accuracy": 0.9, "trials": 2}
    return Trials(
        experiment=Experiment(**settings | changes),
        numbers=[0, 1],
        convergence_steps=np.zeros((2, 4), np.int64),
        errors=np.zeros((2, 4)),
        b_hat=np.full((2, 1, 4), 0.9) if b_hat is None else b_hat,
        tests=np.zeros((2, 4), np.int64),
        updates=np.zeros((2, 4), np.int64),
        records={"x": np.asarray(x)},
    )


def series_ending_in(*last_values: Sequence[float], length: int = 9) -> Any:
    """Return x of two equal trials that is 0.7 but for the last values: a list over the robots for each."""
    x = np.full((2, length, 4), 0.7)
    x[:, -len(last_values) :] = last_values
    return x


def test_the_late_error_is_that_of_the_last_quarter() -> None:
    """A quarter of nine samples is two. The error is the mean distance of four robots' x from f = 0.5.

    Both trials are equal, so they have the same error.
    """
    trials = trials_of_four_robots(series_ending_in([0.4, 0.6, 0.8, 0.0], [0.5, 0.7, 0.6, 0.0]))
    errors_of_last_but_one_sample = [0.1, 0.1, 0.3, 0.5]
    errors_of_last_sample = [0.0, 0.2, 0.1, 0.5]
    mean_error = sum(errors_of_last_but_one_sample + errors_of_last_sample) / 8

    assert study_program.late_errors(trials) == pytest.approx([mean_error, mean_error])


def test_the_late_error_of_three_samples_is_that_of_the_last_one() -> None:
    """A quarter of three is none, but at least one sample counts."""
    trials = trials_of_four_robots(series_ending_in([0.4, 0.6, 0.8, 0.0], length=3))
    errors_of_last_sample = [0.1, 0.1, 0.3, 0.5]
    mean_error = sum(errors_of_last_sample) / 4

    assert study_program.late_errors(trials) == pytest.approx([mean_error, mean_error])


X_AT_THE_SHARE_OF_BLACK = series_ending_in([0.5, 0.5, 0.5, 0.5])
"""Estimates of two trials that end at the right one, for tests of something else."""


def test_healthy_robots_are_harmed_if_b_hat_ends_more_than_0_05_off() -> None:
    """Their accuracy is 0.9. In the second trial one of three healthy robots, with 0.84, is harmed.

    The first of the four robots is flawed, and does not count.
    """
    b_hat_of_first_trial = [0.5, 0.9, 0.9, 0.9]
    b_hat_of_second_trial = [0.5, 0.84, 0.94, 0.9]
    one_filter_step = np.array([[b_hat_of_first_trial], [b_hat_of_second_trial]])
    trials = trials_of_four_robots(X_AT_THE_SHARE_OF_BLACK, b_hat=one_filter_step)

    assert study_program.harmed_percents(trials) == pytest.approx([0, 100 / 3])


def test_only_the_last_filter_step_says_who_is_harmed() -> None:
    """After the first step the healthy robots' b_hat is 0.6, which is wrong, and after the second 0.9."""
    two_filter_steps = [[0.5, 0.6, 0.6, 0.6], [0.5, 0.9, 0.9, 0.9]]
    b_hat_of_two_trials = np.array([two_filter_steps, two_filter_steps])
    trials = trials_of_four_robots(X_AT_THE_SHARE_OF_BLACK, b_hat=b_hat_of_two_trials)

    assert study_program.harmed_percents(trials).tolist() == [0, 0]


def test_a_trial_that_ends_before_the_first_filter_step_harms_nobody() -> None:
    no_filter_steps = np.empty((2, 0, 4))  # by trial, filter step and robot
    trials = trials_of_four_robots(X_AT_THE_SHARE_OF_BLACK, b_hat=no_filter_steps)
    assert study_program.harmed_percents(trials).tolist() == [0, 0]


def test_swarms_without_healthy_robots_have_no_percentage_of_harmed_ones() -> None:
    trials = trials_of_four_robots(X_AT_THE_SHARE_OF_BLACK, flawed=4)
    assert np.isnan(study_program.harmed_percents(trials)).all()


def measured_numbers(trials: Any) -> Any:
    """Measure lists of numbers, which stand for the trials of experiments."""
    return np.asarray(trials, float)


def test_medians_are_averaged_over_experiments() -> None:
    """Each experiment has nine trials; the medians are 4 and 104. The interval is about their mean, 54."""
    experiments: Any = [range(9), range(100, 109)]
    value, low, high = study_program.mean_over_experiments(measured_numbers, experiments)
    assert value == 54
    assert 50 < low < 54 < high < 58


def test_measures_that_are_rarely_above_0_are_averaged_by_means() -> None:
    """Their medians would be 0. One of 40 numbers is 1 here; the others are 0."""
    experiments: Any = [[1] + [0] * 19, [0] * 20]
    interval = study_program.mean_over_experiments(measured_numbers, experiments, resample_mean)
    # The one is drawn up to three times in the resamples within the interval.
    assert interval == pytest.approx((1 / 40, 0, 3 / 40))


# --- Text ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("error", "text"), [(0.00994, "0.0099"), (0.01, "0.010"), (0.1, "0.100")])
def test_errors_have_two_or_three_significant_digits(error: float, text: str) -> None:
    assert study_program.format_error(error) == text


@pytest.mark.parametrize(
    ("interval", "text"),
    [
        (Interval(50, 49.5, 50.5), "50.0"),
        (Interval(50, 49, 50), "50.0 (49.0..50.0)"),
        (Interval(50, 50, 51), "50.0 (50.0..51.0)"),
        (Interval(50, 49.98, 50.01), "50.0"),
    ],
)
def test_an_interval_is_shown_if_it_reaches_beyond_the_tolerance(interval: Interval, text: str) -> None:
    """An interval is a value with a lower and an upper end; the tolerance is 0.5 on either side."""
    tolerance = 0.5
    assert study_program.format_interval(interval, study_program.format_tenths, tolerance) == text


def test_an_interval_that_rounds_to_one_number_is_not_shown() -> None:
    interval = Interval(50, 49.96, 50.04)
    assert study_program.format_interval(interval, study_program.format_tenths, 0.01) == "50.0"


def two_trials_with_x(first: float, second: float) -> Trials:
    """Make two trials in each of which all four robots have the same x; the right one is f = 0.5."""
    return trials_of_four_robots([[[first] * 4], [[second] * 4]])


def test_an_error_shows_its_interval_if_that_is_as_wide_as_a_tenth_of_the_error() -> None:
    """The errors of the trials are 0.11 and 0.1, and then 0.2 and 0.1."""
    narrow = two_trials_with_x(0.61, 0.6)
    wide = two_trials_with_x(0.7, 0.6)
    assert study_program.late_error_text([narrow]) == "0.105"
    assert study_program.late_error_text([wide]) == "0.150 (0.100..0.200)"


def test_a_plain_error_has_no_interval() -> None:
    wide = two_trials_with_x(0.7, 0.6)
    assert study_program.plain_error_text([wide]) == "0.150"


def test_a_score_has_one_decimal() -> None:
    """These trials have converged at step 0, without an error, which is worth 100 points."""
    trials = trials_of_four_robots(X_AT_THE_SHARE_OF_BLACK)
    assert study_program.score_text([trials]) == "100.0"


def test_the_error_of_underconfident_swarms_stands_before_that_of_overconfident_ones() -> None:
    """Underconfident ones have an accuracy of 0.95 here, and x is 0.75 where 0.55 of the tiles are black."""
    overconfident = trials_of_four_robots(np.full((2, 1, 4), 0.9), fill_ratio=0.95, true_accuracy=0.55)
    underconfident = trials_of_four_robots(np.full((2, 1, 4), 0.75), fill_ratio=0.55, true_accuracy=0.95)
    assert study_program.under_and_over_text([overconfident, underconfident]) == "0.200, 0.050"


def test_a_cell_of_one_kind_of_swarm_has_one_error() -> None:
    """x is 0.9 where 0.95 of the tiles are black."""
    overconfident = trials_of_four_robots(np.full((2, 1, 4), 0.9), fill_ratio=0.95, true_accuracy=0.55)
    assert study_program.under_and_over_text([overconfident]) == "0.050"


def test_a_table_has_labelled_rows_and_a_column_for_each_filter() -> None:
    rows = {
        "4 robots": short_trials(filter=["none", "robust"]),
        "8 robots": short_trials(robots=8, filter="asdf-minus", fill_ratio=[0.5, 0.6]),
    }
    table = study_program.markdown_table("experiments", rows, lambda group: str(len(group)))

    assert table.splitlines() == [
        "| experiments | no filter | robust | ASDF- |",
        "|---|---|---|---|",
        "| 4 robots | 1 | 1 |  |",
        "| 8 robots |  |  | 2 |",
    ]


def test_tables_are_written_between_their_marks(tmp_path: Path) -> None:
    study_program.write_tables(tmp_path / "a.md", "A study", {"first": "| 1 |", "second": "| 2 |"})
    text = (tmp_path / "a.md").read_text(encoding="utf-8")
    assert text.startswith("# A study\n\nMedians over trials.")
    assert text.endswith("<!-- first -->\n| 1 |\n<!-- end -->\n\n<!-- second -->\n| 2 |\n<!-- end -->\n")


def test_a_note_of_the_study_stands_above_its_tables(tmp_path: Path) -> None:
    study_program.write_tables(tmp_path / "a.md", "A study", {"first": "| 1 |"}, note="Means.")
    assert (tmp_path / "a.md").read_text(encoding="utf-8").startswith("# A study\n\nMeans.\n\n<!-- first -->")


# --- Programs ------------------------------------------------------------------------------------------


def arguments_for(folder: Path, *, quick: bool = False, workers: int = 1) -> argparse.Namespace:
    return argparse.Namespace(folder=folder, workers=workers, quick=quick)


def test_the_quick_form_has_two_trials_of_4000_steps(tmp_path: Path) -> None:
    rows = {"three robots": m.grid(robots=3, flawed=1, steps=9000, trials=30)}
    (trials,) = study_program.run_rows("a", rows, arguments_for(tmp_path, quick=True))["three robots"]
    assert (trials.experiment.trials, trials.experiment.steps) == (2, 4000)


def test_the_quick_form_lengthens_no_trial(tmp_path: Path) -> None:
    rows = {"three robots": m.grid(robots=3, flawed=1, steps=1000)}
    (trials,) = study_program.run_rows("a", rows, arguments_for(tmp_path, quick=True))["three robots"]
    assert trials.experiment.steps == 1000


def test_results_are_returned_by_row_and_written_to_a_file(tmp_path: Path) -> None:
    common = {"flawed": 1, "steps": 400, "filter_period": 100, "trials": 3}
    rows = {"three robots": m.grid(robots=3, **common), "four robots": m.grid(robots=4, **common)}
    results = study_program.run_rows("a", rows, arguments_for(tmp_path / "new folder"), record=50)
    experiments = {label: [trials.experiment for trials in row] for label, row in results.items()}

    assert experiments == rows
    assert results["four robots"][0].sampling_interval == 50
    assert (tmp_path / "new folder/a.parquet").exists()


@pytest.mark.slow
def test_robots_of_a_study_run_the_same_in_several_processes(tmp_path: Path) -> None:
    rows = {"peers": m.grid(robots=3, flawed=1, steps=1000, firmware=peers.RememberingRobot)}
    (parallel,) = study_program.run_rows("a", rows, arguments_for(tmp_path, quick=True, workers=2))["peers"]
    (alone,) = study_program.run_rows("b", rows, arguments_for(tmp_path, quick=True))["peers"]
    assert parallel.errors.tolist() == alone.errors.tolist()


STUDIES = [
    pytest.param(robust_filter, "robust", id="robust"),
    pytest.param(ageing, "ageing", id="ageing"),
    pytest.param(swarm_sizes, "scale", id="scale"),
    pytest.param(related_work, "related_work", id="related_work"),
    pytest.param(two_readings, "two_readings", id="two_readings"),
]
"""The programs, and the name of the page's tables and picture that each writes."""


def run_tiny_program(study: Any, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Run a study's program with two short experiments in place of each of its tables, and without plots."""
    tiny = m.grid(robots=3, flawed=1, steps=1000, filter_period=100, trials=2, filter=["none", "robust"])
    names = [name for name in vars(study) if name.endswith("_rows") and not name.startswith("_")]
    names.remove("run_rows")
    assert names
    for function in names:
        monkeypatch.setattr(study, function, lambda: {"a row": tiny})
    for function in ("draw_errors", "draw_sizes"):
        monkeypatch.setattr(study, function, lambda *rows: Figure(), raising=False)
    monkeypatch.setattr(swarm_sizes, "TIMED_ROBOT_STEPS", 1000)
    monkeypatch.setattr("sys.argv", ["study", str(folder)])
    study.main()


@pytest.mark.parametrize(("study", "name"), STUDIES)
def test_a_program_writes_its_tables_and_its_picture(
    study: Any, name: str, few_resamples: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run_tiny_program(study, tmp_path, monkeypatch)
    marks = {
        "robust": ["grid", "beyond", "peers", "worlds"],
        "ageing": ["filters", "peers"],
        "related_work": ["early", "late", "colour"],
        "two_readings": ["errors", "harm"],
    }
    text = (tmp_path / f"{name}.md").read_text(encoding="utf-8")
    tables = re.findall(r"<!-- (\w+) -->\n(\|.*?)\n<!-- end -->", text, re.DOTALL)

    assert [mark for mark, _ in tables] == marks.get(name, [name])
    assert all(table.splitlines()[0].endswith("| no filter | robust |") for _, table in tables)
    assert (tmp_path / f"{name}.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("study", "intervals"),
    [
        (
            robust_filter,
            {"robust_grid": 1000, "robust_beyond": 1000, "robust_peers": 500, "robust_worlds": 500},
        ),
        (ageing, {"ageing": 1000, "ageing_peers": 1000}),
        (swarm_sizes, {"scale": 1000}),
        (related_work, {"related_resilience": 100, "related_colour": 500}),
        (two_readings, {"two_readings": 500}),
    ],
)
def test_a_program_keeps_its_results_with_values_over_time(
    study: Any,
    intervals: dict[str, int],
    few_resamples: None,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    run_tiny_program(study, tmp_path, monkeypatch)
    assert {path.stem: sampling_interval(path) for path in tmp_path.glob("*.parquet")} == intervals


def sampling_interval(path: Path) -> int:
    return m.experiments_in(m.read_table(path))[0].sampling_interval


@pytest.mark.parametrize(
    ("rows_of", "page", "mark"),
    [
        (ageing.ageing_rows, "ageing", "filters"),
        (ageing.peer_rows, "ageing", "peers"),
        (related_work.resilience_rows, "related_work", "late"),
        (related_work.colour_rows, "related_work", "colour"),
        (two_readings.two_readings_rows, "two_readings", "errors"),
        (two_readings.two_readings_rows, "two_readings", "harm"),
    ],
)
def test_a_page_shows_rows_of_its_study(rows_of: Any, page: str, mark: str) -> None:
    page_rows = rows_of_page(page, mark)
    assert page_rows
    assert set(page_rows) <= set(rows_of())


def test_the_page_of_ageing_fills_the_cells_of_which_there_are_experiments() -> None:
    filled_cells = {
        row: len(cells) - cells.count("") for row, cells in rows_of_page("ageing", "peers").items()
    }
    columns = {
        row: len({peers.column_label(experiment) for experiment in experiments})
        for row, experiments in ageing.peer_rows().items()
    }

    assert filled_cells and filled_cells == {row: columns[row] for row in filled_cells}  # it shows some rows


def rows_of_page(page: str, mark: str) -> dict[str, list[str]]:
    """Return the cells of each row of a table in a page of docs/internals/, by the row's label."""
    text = (ROOT / f"docs/internals/{page}.md").read_text(encoding="utf-8")
    table = text.partition(f"<!-- {mark} -->\n")[2].partition("\n<!-- end -->")[0]
    rows = [[cell.strip() for cell in line.split("|")[1:-1]] for line in table.splitlines()[2:]]
    return {label: cells for label, *cells in rows}


@pytest.mark.parametrize("rows", [robust_filter.peer_rows(), robust_filter.world_rows()])
def test_peers_and_hard_worlds_have_a_seed_that_no_tuning_has_seen(rows: Any) -> None:
    assert {experiment.seed for experiments in rows.values() for experiment in experiments} == {4713}


@pytest.mark.slow
@pytest.mark.parametrize(("study", "name"), STUDIES)
def test_the_quick_form_of_a_program_runs_all_its_experiments(
    study: Any, name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(study_program, "QUICK_STEPS", 1000)
    monkeypatch.setattr("sys.argv", ["study", str(tmp_path), "--quick", "--workers", "2"])
    monkeypatch.setattr(swarm_sizes, "TIMED_ROBOT_STEPS", 1000)
    study.main()

    assert "nan" not in (tmp_path / f"{name}.md").read_text(encoding="utf-8")
    assert (tmp_path / f"{name}.png").read_bytes().startswith(b"\x89PNG")


def test_both_kinds_of_flaws_are_wrong_by_0_4() -> None:
    offsets = {flaw: sensors["flawed_accuracy"] - sensors["true_accuracy"] for flaw, sensors in FLAWS.items()}
    assert offsets == pytest.approx({"underconfident": -0.4, "overconfident": 0.4})
