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
from host_tools.studies.conftest import page_path, parse_table, tables_in, two_trials_with
from mcp_asdf_tools.experiments.experiment import Experiment, grid
from mcp_asdf_tools.experiments.results import Trials
from mcp_asdf_tools.experiments.trials import run_trials
from mcp_asdf_tools.studies import (
    ageing,
    peers,
    related_work,
    robust_filter,
    study_program,
    two_readings,
)
from mcp_asdf_tools.studies.two_readings import two_readings_rows

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


def test_liars_are_not_counted_in_the_error_of_a_swarm() -> None:
    """15 honest robots estimate the share of black, 0.5, rightly; the last five robots, which lie, say 0."""
    x = [0.5] * 15 + [0.0] * 5
    trials = two_trials_with(robots=20, firmware=peers.five_liars, fill_ratio=0.5, x=x)

    assert study_program.late_errors(study_program.without_liars(trials)).tolist() == [0, 0]


def test_all_robots_of_a_swarm_without_liars_are_counted_in_its_error() -> None:
    """Five of 20 robots estimate 0 for a floor of which half is black. They do not lie."""
    x = [0.5] * 15 + [0.0] * 5
    trials = two_trials_with(robots=20, firmware=peers.WmsrRobot, fill_ratio=0.5, x=x)

    late_errors = study_program.late_errors(study_program.without_liars(trials))

    mean_error = 5 * 0.5 / 20
    assert late_errors == pytest.approx([mean_error, mean_error])


# --- Text ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("x", "text"), [(0.50994, "0.0099"), (0.51004, "0.010"), (0.6, "0.100")], ids=["small", "limit", "large"]
)
def test_errors_have_four_decimals_below_0_01_and_otherwise_three(x: float, text: str) -> None:
    """All robots estimate x, and half of the floor is black."""
    trials = two_trials_with(fill_ratio=0.5, x=x)
    assert study_program.late_error_text([trials]) == text


def test_the_error_in_a_cell_of_a_table_is_the_mean_of_the_medians_over_the_trials(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Here the errors of the trials of two experiments are given, with the medians 0.2 and 0.4."""
    monkeypatch.setattr(study_program, "late_errors", np.array)
    errors_of_experiments: Any = [[0.1, 0.2, 0.9], [0.4, 0.4, 0.4]]
    assert study_program.late_error_text(errors_of_experiments) == "0.300"


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


def test_the_tables_of_a_study_are_written_between_their_marks_below_a_title(tmp_path: Path) -> None:
    """A mark is a comment with the name of the table that follows. The file ends in a line end."""
    tables = {"first": "| 1 |", "second": "| 2 |"}
    study_program.write_tables(tmp_path / "study.md", title="A study", tables=tables)

    assert (tmp_path / "study.md").read_text().split("\n") == [
        "# A study",
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


@pytest.mark.parametrize(("steps", "quick_steps"), [(9000, 4000), (400, 400)])
def test_the_quick_form_of_a_study_has_two_trials_of_at_most_4000_steps(
    steps: int, quick_steps: int, tmp_path: Path
) -> None:
    """The experiment has 30 trials. Long experiments are cut to 4000 steps; 400 steps stay 400."""
    experiment = Experiment(robots=3, flawed=1, steps=steps, filter_period=100, trials=30)
    arguments = argparse.Namespace(folder=tmp_path / "new folder", workers=1, quick=True)

    [trials] = study_program.run_rows("a", {"row": [experiment]}, arguments, record=50)["row"]

    assert trials.experiment.trials == 2
    assert len(trials.numbers) == 2
    assert trials.experiment.steps == quick_steps


def test_the_results_of_a_swarm_with_liars_have_the_estimates_of_the_honest_robots_alone(
    tmp_path: Path,
) -> None:
    """Five of 20 robots lie. Of one trial, estimates are recorded at steps 0, 50 and 100."""
    [swarm_with_liars] = grid(robots=20, flawed=0, firmware=peers.five_liars, steps=100, trials=1)
    arguments = argparse.Namespace(folder=tmp_path, workers=1, quick=False)

    rows = study_program.run_rows("study", {"liars": [swarm_with_liars]}, arguments, record=50)

    [trials] = rows["liars"]
    trial_count, sample_count, robot_count = trials.records["x"].shape
    assert (trial_count, sample_count, robot_count) == (1, 3, 15)


STUDIES = {
    "robust": robust_filter,
    "ageing": ageing,
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
    with pytest.MonkeyPatch.context() as patch:
        for function in functions_of_rows:
            patch.setattr(study, function, lambda: {"a row": tiny})
        for function in ("draw_errors", "plot_errors_of_swarms"):
            patch.setattr(study, function, lambda *rows: Figure(), raising=False)
        patch.setattr("sys.argv", ["study", str(folder)])
        study.main()


@pytest.mark.parametrize(
    ("study", "marks", "intervals_by_file"),
    [
        ("robust", ["errors"], {"robust": 1000}),
        ("ageing", ["filters", "peers"], {"ageing": 1000, "ageing_peers": 1000}),
        ("related_work", ["late", "colour"], {"related_resilience": 100, "related_colour": 500}),
        ("two_readings", ["errors", "harm"], {"two_readings": 500}),
    ],
)
def test_the_program_of_a_study_writes_its_tables_its_picture_and_its_results(
    study: str, marks: list[str], intervals_by_file: dict[str, int], tmp_path: Path
) -> None:
    """The Markdown file of the study has a table after each mark, such as <!-- filters -->.

    Each table has a single row with two experiments, without a filter and with the robust one. A file of
    results with an interval of 1000 has the estimates x at steps 0, 1000, 2000 and so on.
    """
    run_tiny_program(study, tmp_path)

    tables = tables_in(tmp_path / f"{study}.md")
    assert list(tables) == marks
    for table in tables.values():
        assert list(table) == ["a row"]
        assert list(table["a row"]) == ["no filter", "robust"]
    assert (tmp_path / f"{study}.png").read_bytes().startswith(b"\x89PNG")
    sampling_intervals = {}
    for path in tmp_path.glob("*.parquet"):
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
    table_on_page = tables_in(page_path(page))[mark]

    assert table_on_page != {}
    assert table_on_page.keys() <= rows_of_study().keys()


@pytest.mark.slow
@pytest.mark.usefixtures("few_resamples")
@pytest.mark.parametrize("name", STUDIES)
def test_the_quick_form_of_a_program_measures_something_in_all_its_experiments(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A measure without results would be "nan" in a table. The program draws its picture, too."""
    # Trials are even fewer and shorter than those of the quick form.
    monkeypatch.setattr(study_program, "QUICK_TRIALS", 1)
    monkeypatch.setattr(study_program, "QUICK_STEPS", 1000)
    monkeypatch.setattr("sys.argv", ["study", str(tmp_path), "--quick", "--workers", "2"])

    STUDIES[name].main()

    assert "nan" not in (tmp_path / f"{name}.md").read_text(encoding="utf-8")
    assert (tmp_path / f"{name}.png").read_bytes().startswith(b"\x89PNG")


TEXT_OF_CELL = {"colour": related_work.right_text, "harm": two_readings.harm_text}
"""Functions that make the text of a cell, by the mark of the table. Tables with other marks show errors."""


LIARS = "moving, 5 liars, "
TENTH_REPEATED = "none flawed, tenth repeated, overconfident"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("rows_of_study", "row", "columns", "sampling_interval", "mark"),
    [
        (ageing.ageing_rows, "six age alike, longest memory", ["robust"], 1000, "filters"),
        (two_readings_rows, "half flawed, underconfident", ["ASDF-"], 500, "errors"),
        (two_readings_rows, TENTH_REPEATED, ["robust"], 500, "harm"),
        (
            related_work.resilience_rows,
            LIARS + "overconfident",
            ["robust", "W-MSR", "trimmed mean"],
            100,
            "late",
        ),
        (related_work.colour_rows, LIARS + "underconfident", ["DMMD"], 500, "colour"),
    ],
)
def test_cells_that_are_simulated_again_have_the_numbers_on_the_page_of_their_study(
    rows_of_study: Callable[[], dict[str, Any]],
    row: str,
    columns: list[str],
    sampling_interval: int,
    mark: str,
) -> None:
    """Only a few columns of one row of each table are simulated, as all of them would take minutes.

    Together they have all kinds of sensors and robots but those with two readings, which take longest. The
    page has the name of the study's module, and ``mark`` names the table on it.
    """
    text_of_cell = TEXT_OF_CELL.get(mark, study_program.late_error_text)
    results = [
        study_program.without_liars(
            run_trials(experiment, 0, experiment.trials, sampling_interval=sampling_interval)
        )
        for experiment in rows_of_study()[row]
        if peers.column_label(experiment) in columns
    ]

    simulated = parse_table(study_program.markdown_table("", {row: results}, text_of_cell))

    page = rows_of_study.__module__.rpartition(".")[2]
    row_on_page = tables_in(page_path(page))[mark][row]
    assert simulated[row] == {column: row_on_page[column] for column in columns}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "column"),
    [
        ("all age alike", "knows b now"),
        ("all age alike", "knows its mean"),
        ("all age alike", "BayesCPF"),
        ("each ages in its own way", "BayesCPF"),
    ],
)
def test_a_trial_with_a_robot_that_knows_how_it_ages_has_about_the_error_on_the_page_about_ageing(
    kind: str, column: str
) -> None:
    """The page has the median over four trials, which take minutes. This is the first of them."""
    row = f"{kind}, longest memory"
    [experiment] = [
        experiment for experiment in ageing.peer_rows()[row] if peers.column_label(experiment) == column
    ]

    trial = run_trials(experiment, first=0, trials=1, sampling_interval=1000)

    error_on_page = float(tables_in(page_path("ageing"))["peers"][row][column])
    assert study_program.late_errors(trial) == pytest.approx([error_on_page], rel=0.5)
