"""What this project's own studies share: measures, text and tables, and running their programs."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

import mcp_asdf_tools as m
from golden import assert_equals_golden_file
from host_tools.studies.conftest import page_path, rare_resampling, tables_in, two_trials_with
from mcp_asdf_tools.experiments.experiment import Experiment, grid
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
from mcp_asdf_tools.studies.study_program import PARAMETERS_BY_FLAW

# --- Measures ------------------------------------------------------------------------------------------


def test_the_late_error_is_the_mean_distance_from_f_in_the_last_quarter() -> None:
    """A quarter of nine samples is two. Each sample has the estimates of four robots."""
    first_seven_samples = [[0.7, 0.7, 0.7, 0.7]] * 7
    last_two_samples = [
        [0.4, 0.6, 0.8, 0.0],  # 0.1, 0.1, 0.3 and 0.5 from f
        [0.5, 0.7, 0.6, 0.0],  # 0.0, 0.2, 0.1 and 0.5 from f
    ]
    trials = two_trials_with(fill_ratio=0.5, x=first_seven_samples + last_two_samples)

    mean_distance = ((0.1 + 0.1 + 0.3 + 0.5) + (0.0 + 0.2 + 0.1 + 0.5)) / 8
    assert study_program.late_errors(trials) == pytest.approx([mean_distance, mean_distance])


def test_the_late_error_of_three_samples_is_the_error_of_the_last_sample() -> None:
    """The last quarter of three samples is rounded up to one sample, with the estimates of four robots."""
    first_two_samples = [[0.7, 0.7, 0.7, 0.7]] * 2
    last_sample = [0.4, 0.6, 0.8, 0.0]  # 0.1, 0.1, 0.3 and 0.5 from f
    trials = two_trials_with(fill_ratio=0.5, x=[*first_two_samples, last_sample])

    mean_distance = (0.1 + 0.1 + 0.3 + 0.5) / 4
    assert study_program.late_errors(trials) == pytest.approx([mean_distance, mean_distance])


def test_healthy_robots_are_harmed_if_b_hat_ends_more_than_0_05_from_their_accuracy() -> None:
    """The first of four robots is flawed, and does not count. b_hat is recorded once in each trial.

    In the second trial one of three healthy robots, with 0.84, is harmed.
    """
    b_hat_of_first_trial = [0.5, 0.9, 0.9, 0.9]
    b_hat_of_second_trial = [0.5, 0.84, 0.94, 0.9]
    trials = two_trials_with(
        robots=4, flawed=1, true_accuracy=0.9, b_hat=[[b_hat_of_first_trial], [b_hat_of_second_trial]]
    )

    assert study_program.harmed_percents(trials) == pytest.approx([0, 100 / 3])


def test_robots_whose_b_hat_is_wrong_only_before_the_last_filter_step_are_not_harmed() -> None:
    """The first of four robots is flawed; the others should assume 0.9, and do so in the end."""
    b_hat_after_first_step = [0.5, 0.6, 0.6, 0.6]
    b_hat_after_last_step = [0.5, 0.9, 0.9, 0.9]
    trials = two_trials_with(
        robots=4, flawed=1, true_accuracy=0.9, b_hat=[b_hat_after_first_step, b_hat_after_last_step]
    )

    assert study_program.harmed_percents(trials).tolist() == [0, 0]  # of two trials


def test_a_trial_that_ends_before_the_first_filter_step_harms_no_robot() -> None:
    """b_hat is recorded after each filter step, so nothing is recorded in such trials."""
    no_b_hat = np.empty((2, 0, 4))  # of two trials, no filter step and four robots
    trials_without_filter_steps = two_trials_with(b_hat=no_b_hat)
    assert study_program.harmed_percents(trials_without_filter_steps).tolist() == [0, 0]


def test_the_percentage_of_harmed_robots_is_nan_in_swarms_without_healthy_robots() -> None:
    """All four robots are flawed, so the percentage of nobody is not a number, in either trial."""
    trials = two_trials_with(robots=4, flawed=4)
    assert np.isnan(study_program.harmed_percents(trials)).all()


def measure_numbers(trials: Any) -> Any:
    """Return a list of numbers, which stand for the trials of an experiment, as their measures."""
    return np.asarray(trials, float)


def test_a_measure_of_two_experiments_is_the_mean_of_their_medians_with_an_interval() -> None:
    """One experiment has nine trials with the measures 0 to 8, the other nine trials with 100 to 108.

    So the medians are 4 and 104, and their mean is 54. The trials are drawn again, at random, for the
    interval: their medians are around these.
    """
    experiments: Any = [range(9), range(100, 109)]

    value, low, high = study_program.mean_over_experiments(measure_numbers, experiments)

    assert value == (4 + 104) / 2
    assert 50 < low < value < high < 58


def test_a_measure_that_is_rarely_above_0_can_be_averaged_by_means_instead_of_medians() -> None:
    """Two experiments have 20 trials each. The measure is 1 in a single trial, and 0 in all others.

    Both medians would be 0. In the resamples within the interval the trial with the 1 is drawn up to three
    times.
    """
    experiments: Any = [[1] + [0] * 19, [0] * 20]

    value, low, high = study_program.mean_over_experiments(
        measure_numbers, experiments, resample=resample_mean
    )

    assert value == pytest.approx(1 / 40)
    assert low == 0
    assert high == pytest.approx(3 / 40)


# --- Text ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("error", "text"), [(0.00994, "0.0099"), (0.01, "0.010"), (0.1, "0.100")])
def test_errors_have_four_decimals_below_0_01_and_otherwise_three(error: float, text: str) -> None:
    assert study_program.format_error(error) == text


@pytest.mark.parametrize(
    ("low", "high", "tolerance", "text"),
    [
        (49.5, 50.5, 0.5, "50.0"),
        (49.0, 50.0, 0.5, "50.0 (49.0..50.0)"),
        (50.0, 51.0, 0.5, "50.0 (50.0..51.0)"),
        (49.96, 50.04, 0.01, "50.0"),  # both ends are 50.0 when rounded to tenths
    ],
)
def test_an_interval_is_shown_if_an_end_is_farther_from_the_value_than_the_tolerance(
    low: float, high: float, tolerance: float, text: str
) -> None:
    """The value is 50. No interval is shown either if both ends are the same text as the value: 50.0."""
    interval = Interval(value=50, low=low, high=high)
    assert study_program.format_interval(interval, study_program.format_tenths, tolerance) == text


@pytest.mark.parametrize(
    ("x_of_second_trial", "text"), [(0.61, "0.105"), (0.7, "0.150 (0.100..0.200)")], ids=["narrow", "wide"]
)
def test_an_error_shows_its_interval_if_an_end_is_more_than_a_tenth_of_the_error_off(
    x_of_second_trial: float, text: str
) -> None:
    """All robots estimate 0.6 in the first trial, 0.1 from f. In the second they are 0.11 or 0.2 from it.

    The error is the mean of both trials, and the interval reaches from one to the other: 0.100 to 0.110 is
    within a tenth of 0.105, and 0.100 to 0.200 is not within a tenth of 0.150.
    """
    x_by_trial_sample_and_robot = [[[0.6] * 4], [[x_of_second_trial] * 4]]
    trials = two_trials_with(fill_ratio=0.5, x=x_by_trial_sample_and_robot)
    assert study_program.late_error_text([trials]) == text


def test_a_plain_error_has_no_interval_even_if_trials_differ() -> None:
    """All robots estimate 0.6 in one trial, and 0.7 in the other, for a floor that is half black.

    So the errors of the trials are 0.1 and 0.2, with a mean of 0.15.
    """
    x_by_trial_sample_and_robot = [[[0.6] * 4], [[0.7] * 4]]
    trials = two_trials_with(fill_ratio=0.5, x=x_by_trial_sample_and_robot)
    assert study_program.plain_error_text([trials]) == "0.150"


def test_the_error_of_underconfident_swarms_stands_before_that_of_overconfident_ones() -> None:
    """The test passes overconfident swarms first. A cell with only overconfident swarms has one error.

    The floor of underconfident swarms is 0.55 black, and the floor of overconfident ones 0.95.
    """
    underconfident = two_trials_with(**PARAMETERS_BY_FLAW["underconfident"], x=0.75)
    overconfident = two_trials_with(**PARAMETERS_BY_FLAW["overconfident"], x=0.9)

    error_of_underconfident = 0.75 - 0.55
    error_of_overconfident = 0.95 - 0.9
    assert study_program.under_and_over_text([overconfident, underconfident]) == (
        f"{error_of_underconfident:.3f}, {error_of_overconfident:.3f}"
    )
    assert study_program.under_and_over_text([overconfident]) == f"{error_of_overconfident:.3f}"


def test_a_table_has_labelled_rows_and_a_column_for_each_filter_that_a_row_needs() -> None:
    """Each cell has the number of its experiments, and is empty where there are none."""
    no_filter = two_trials_with(filter="none")
    robust = two_trials_with(filter="robust")
    asdf_minus = two_trials_with(filter="asdf-minus")
    rows = {"4 robots": [no_filter, robust], "8 robots": [asdf_minus, asdf_minus]}

    def text_of_cell(experiments: Sequence[Trials]) -> str:
        return str(len(experiments))

    table = study_program.markdown_table("experiments", rows, text_of_cell)

    assert table.splitlines() == [
        "| experiments | no filter | robust | ASDF- |",
        "|---|---|---|---|",
        "| 4 robots | 1 | 1 |  |",
        "| 8 robots |  |  | 2 |",
    ]


def test_the_tables_of_a_study_are_written_between_their_marks_below_a_title_and_a_note(
    tmp_path: Path,
) -> None:
    """A mark is a comment with the name of the table that follows. The file ends in a line end."""
    tables = {"first": "| 1 |", "second": "| 2 |"}
    study_program.write_tables(tmp_path / "study.md", title="A study", tables=tables, note="Means.")

    assert (tmp_path / "study.md").read_text().split("\n") == [
        "# A study",
        "",
        "Means.",
        "",
        "<!-- first -->",
        "| 1 |",
        "<!-- end -->",
        "",
        "<!-- second -->",
        "| 2 |",
        "<!-- end -->",
        "",
    ]


# --- Programs ------------------------------------------------------------------------------------------


def run_experiment(
    experiment: Experiment,
    folder: Path,
    *,
    quick: bool = False,
    workers: int = 1,
    sampling_interval: int = 50,
) -> Trials:
    """Run an experiment as a study's program does, and return its trials.

    The experiment is the only one of a table "a" with a single row.
    """
    arguments = argparse.Namespace(folder=folder, workers=workers, quick=quick)
    results_by_row = study_program.run_rows("a", {"row": [experiment]}, arguments, record=sampling_interval)
    [trials] = results_by_row["row"]
    return trials


@pytest.mark.parametrize(("steps", "quick_steps"), [(9000, 4000), (400, 400)])
def test_the_quick_form_of_a_study_has_two_trials_of_at_most_4000_steps(
    steps: int, quick_steps: int, tmp_path: Path
) -> None:
    """The experiment has 30 trials. Long experiments are cut to 4000 steps; 400 steps stay 400."""
    experiment = Experiment(robots=3, flawed=1, steps=steps, filter_period=100, trials=30)

    trials = run_experiment(experiment, tmp_path, quick=True)

    assert trials.experiment.trials == 2
    assert len(trials.numbers) == 2
    assert trials.experiment.steps == quick_steps


def test_the_results_of_a_study_are_recorded_and_written_to_a_file_in_a_new_folder(tmp_path: Path) -> None:
    """The study has one table, "a", so its results are in the file a.parquet."""
    folder = tmp_path / "new folder"
    experiment = Experiment(robots=3, flawed=1, steps=400, filter_period=100, trials=3)

    trials = run_experiment(experiment, folder, sampling_interval=50)

    assert trials.experiment == experiment
    assert trials.sampling_interval == 50
    assert (folder / "a.parquet").exists()


@pytest.mark.slow
def test_robots_of_a_study_have_the_same_results_in_one_process_and_in_two(tmp_path: Path) -> None:
    """The firmware is a class of a study, not built in, so a second process has to import it."""
    [experiment] = grid(robots=3, flawed=1, steps=1000, firmware=peers.RememberingRobot)
    trials_of_one_process = run_experiment(experiment, tmp_path / "one", quick=True, workers=1)
    trials_of_two_processes = run_experiment(experiment, tmp_path / "two", quick=True, workers=2)

    assert trials_of_two_processes.errors.tolist() == trials_of_one_process.errors.tolist()


STUDIES = {
    "robust": robust_filter,
    "ageing": ageing,
    "scale": swarm_sizes,
    "related_work": related_work,
    "two_readings": two_readings,
}
"""The programs, by the name of the tables and of the picture that each writes."""


def run_tiny_program(name: str, folder: Path) -> None:
    """Run a study's program with two short experiments in place of each of its tables, and without plots."""
    study = STUDIES[name]
    tiny = grid(robots=3, flawed=1, steps=1000, filter_period=500, trials=2, filter=["none", "robust"])
    functions_of_rows = [
        function for function in vars(study) if function.endswith("_rows") and function != "run_rows"
    ]
    with rare_resampling(), pytest.MonkeyPatch.context() as patch:
        for function in functions_of_rows:
            patch.setattr(study, function, lambda: {"a row": tiny})
        for function in ("draw_errors", "draw_sizes"):
            patch.setattr(study, function, lambda *rows: Figure(), raising=False)
        patch.setattr(swarm_sizes, "TIMED_ROBOT_STEPS", 1000)
        patch.setattr("sys.argv", ["study", str(folder)])
        study.main()


@pytest.fixture(scope="module")
def folders_of_tiny_programs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Run the program of each study, with "a row" of two experiments in each table; return its folder."""
    folders = {name: tmp_path_factory.mktemp(name) for name in STUDIES}
    for name, folder in folders.items():
        run_tiny_program(name, folder)
    return folders


@pytest.mark.parametrize(
    ("study", "marks"),
    [
        ("robust", ["grid", "beyond", "peers", "worlds"]),
        ("ageing", ["filters", "peers"]),
        ("scale", ["scale"]),
        ("related_work", ["early", "late", "colour"]),
        ("two_readings", ["errors", "harm"]),
    ],
)
def test_the_program_of_a_study_writes_its_tables_and_its_picture(
    study: str, marks: list[str], folders_of_tiny_programs: dict[str, Path]
) -> None:
    """The Markdown file of the study has a table after each mark, such as <!-- grid -->.

    Each table of the tiny programs has a single row with two experiments, without a filter and with the
    robust one.
    """
    folder = folders_of_tiny_programs[study]

    tables = tables_in(folder / f"{study}.md")
    assert list(tables) == marks
    for table in tables.values():
        assert table.columns == ["no filter", "robust"]
        assert list(table.rows) == ["a row"]
    assert (folder / f"{study}.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("study", "intervals_by_file"),
    [
        ("robust", {"robust_grid": 1000, "robust_beyond": 1000, "robust_peers": 500, "robust_worlds": 500}),
        ("ageing", {"ageing": 1000, "ageing_peers": 1000}),
        ("scale", {"scale": 1000}),
        ("related_work", {"related_resilience": 100, "related_colour": 500}),
        ("two_readings", {"two_readings": 500}),
    ],
)
def test_the_program_of_a_study_keeps_its_results_with_values_so_many_steps_apart(
    study: str, intervals_by_file: dict[str, int], folders_of_tiny_programs: dict[str, Path]
) -> None:
    """A file with an interval of 1000 has the estimates x at steps 0, 1000, 2000 and so on."""
    sampling_intervals = {}
    for path in folders_of_tiny_programs[study].glob("*.parquet"):
        trials_of_first_experiment, *_others = m.experiments_in(m.read_table(path))
        sampling_intervals[path.stem] = trials_of_first_experiment.sampling_interval

    assert sampling_intervals == intervals_by_file


@pytest.mark.parametrize(
    ("rows_of_study", "page", "mark"),
    [
        (ageing.ageing_rows, "ageing", "filters"),
        (ageing.peer_rows, "ageing", "peers"),
        (related_work.resilience_rows, "related_work", "late"),
        (related_work.colour_rows, "related_work", "colour"),
        (two_readings.two_readings_rows, "two_readings", "errors"),
        (two_readings.two_readings_rows, "two_readings", "harm"),
    ],
)
def test_the_rows_in_a_table_of_a_page_are_rows_of_its_study(
    rows_of_study: Callable[[], dict[str, Any]], page: str, mark: str
) -> None:
    """A mark in the Markdown of the page names the table. The page may leave out rows, but adds none."""
    rows_on_page = tables_in(page_path(page))[mark].rows

    assert rows_on_page != {}
    assert rows_on_page.keys() <= rows_of_study().keys()


def test_the_page_about_ageing_has_a_number_for_each_robot_that_knows_how_sensors_age() -> None:
    """Its table "peers" has a row for each kind of ageing; cells are empty where no such robot ran."""
    cells_by_row = tables_in(page_path("ageing"))["peers"].rows
    experiments_by_row = ageing.peer_rows()

    assert cells_by_row != {}
    for row, cells in cells_by_row.items():
        numbers = [cell for cell in cells if cell != ""]
        assert len(numbers) == len(experiments_by_row[row])


@pytest.mark.slow
@pytest.mark.parametrize("name", STUDIES)
def test_the_quick_form_of_a_program_measures_something_in_all_its_experiments(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A measure without results would be "nan" in a table. The program draws its picture, too."""
    # Trials are even shorter than those of the quick form.
    monkeypatch.setattr(study_program, "QUICK_STEPS", 1000)
    monkeypatch.setattr(swarm_sizes, "TIMED_ROBOT_STEPS", 1000)
    monkeypatch.setattr("sys.argv", ["study", str(tmp_path), "--quick", "--workers", "2"])

    study = STUDIES[name]
    study.main()

    assert "nan" not in (tmp_path / f"{name}.md").read_text(encoding="utf-8")
    assert (tmp_path / f"{name}.png").read_bytes().startswith(b"\x89PNG")


# --- Experiments -----------------------------------------------------------------------------------------

TABLES_OF_STUDIES = (
    ageing.ageing_rows,
    ageing.peer_rows,
    related_work.resilience_rows,
    related_work.colour_rows,
    robust_filter.grid_rows,
    robust_filter.beyond_rows,
    robust_filter.peer_rows,
    robust_filter.world_rows,
    swarm_sizes.size_rows,
    two_readings.two_readings_rows,
)


def describe_row(label: str, experiments: Sequence[Experiment]) -> str:
    """Describe a row of a study's table: its columns, and the parameters that do not have their defaults."""
    columns = dict.fromkeys(peers.column_label(experiment) for experiment in experiments)
    descriptions = [f"{label}: {len(experiments)} experiments", "/".join(columns)]
    for name in Experiment().parameters():
        values = dict.fromkeys(str(getattr(experiment, name)) for experiment in experiments)
        if list(values) != [str(getattr(Experiment(), name))]:
            descriptions.append(f"{name} {'/'.join(values)}")
    return ", ".join(descriptions)


def test_the_experiments_of_each_study_are_those_by_which_its_page_was_made() -> None:
    """The golden file has the columns and the parameters of each row: robots, trials, seed and so on."""
    descriptions = []
    for rows_of_table in TABLES_OF_STUDIES:
        for label, experiments in rows_of_table().items():
            descriptions.append(describe_row(label, experiments))
    assert_equals_golden_file("experiments_of_studies.txt", descriptions)
