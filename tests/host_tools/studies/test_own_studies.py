"""This project's own studies: measures by hand, tables, pictures, programs; and the peers."""

from __future__ import annotations

import argparse
import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

import mcp_asdf_tools as m
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.results import Trials
from mcp_asdf_tools.experiments.trials import run_trials
from mcp_asdf_tools.studies import ageing, error_tables, peers, robust_filter, swarm_sizes
from mcp_asdf_tools.studies.ageing_sensors import WanderingSensors
from mcp_asdf_tools.studies.bootstrap import Interval
from support import ROOT

UNDERCONFIDENT = {"fill_ratio": 0.55, "true_accuracy": 0.95, "flawed_accuracy": 0.55}
OVERCONFIDENT = {"fill_ratio": 0.95, "true_accuracy": 0.55, "flawed_accuracy": 0.95}


# --- Measures --------------------------------------------------------------------------------------------


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
    assert error_tables.late_errors(trials, honest=3, fill_ratio=0.6) == pytest.approx([expected, expected])


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


# --- Text ------------------------------------------------------------------------------------------------


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


def short_trials(**parameters: Any) -> list[Trials]:
    """Run the experiments of a grid for two short trials, recorded every 100 steps."""
    settings: dict[str, Any] = {"robots": 4, "flawed": 1, "steps": 400, "filter_period": 100, "trials": 2}
    return [run_trials(experiment, 0, 2, 100) for experiment in m.grid(**settings | parameters)]


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


# --- The robust filter -----------------------------------------------------------------------------------

MOVING: dict[str, Any] = {"topology": "dynamic", "latency": 1, "robots": 20, "flawed": 6}


@pytest.mark.parametrize(
    ("changes", "row"),
    [
        ({}, "moving"),
        ({"topology": "fully-connected", "latency": 0}, "fully connected"),
        ({"robots": 21}, "moving, 21 robots"),
        ({"density": 3}, "moving, density 3"),
        ({"latency": 0}, "moving, latency 0"),
        ({"white_offset": -0.1}, "moving, b -0.1 on white"),
        ({"sensor": WanderingSensors}, "moving, sensors age each in its own way"),
        ({"drift": "linear"}, "moving, sensors age alike"),
    ],
)
def test_a_row_beyond_the_grid_says_what_is_different(changes: dict[str, Any], row: str) -> None:
    assert robust_filter.beyond_row(Experiment(**MOVING | changes)) == row


@pytest.mark.parametrize(
    ("changes", "row"),
    [
        ({"steps": 20_000}, "moving, 30 % flawed"),
        ({"steps": 10_000}, "moving, 30 % flawed, 10,000 steps"),
        ({"steps": 20_000, "flawed": 0}, "moving, 0 % flawed"),
    ],
)
def test_a_row_of_peers_says_how_many_robots_are_flawed(changes: dict[str, Any], row: str) -> None:
    assert robust_filter.peer_row(Experiment(**MOVING | changes)) == row


def test_hard_worlds_have_the_rows_of_the_page() -> None:
    rows = {robust_filter.world_row(experiment) for experiment in robust_filter.world_experiments()}
    page = (ROOT / "docs/robust.md").read_text(encoding="utf-8")
    table = page.partition("<!-- worlds -->")[2].partition("<!-- end -->")[0]
    assert rows == set(re.findall(r"^\| ((?:fully|moving)[^|]*) \|", table, re.MULTILINE))


def test_liars_are_not_counted_in_the_error() -> None:
    (trials,) = short_trials(robots=20, flawed=0, firmware=peers.five_liars, filter="none")
    trials.records["x"][:, :, :15] = trials.experiment.fill_ratio
    assert robust_filter.late_errors_of_honest_robots(trials) == pytest.approx([0, 0])


def test_the_error_after_the_floor_changes_is_that_of_the_new_floor() -> None:
    (trials,) = short_trials(sensor=peers.ChangingFloor, filter="none")
    trials.records["x"][:] = 0.95
    assert robust_filter.late_errors_of_honest_robots(trials) == pytest.approx([0, 0])


def test_a_cell_of_the_grid_has_score_errors_and_harm() -> None:
    (trials,) = short_trials(filter="robust")
    assert re.fullmatch(r"[\d.]+.*, 0\.\d+.*, 0\.\d+, [\d.]+.* %", robust_filter.grid_text([trials]))


def test_a_cell_without_healthy_robots_has_no_harm() -> None:
    (trials,) = short_trials(filter="robust", flawed=4)
    assert not robust_filter.grid_text([trials]).endswith("%")


@pytest.mark.slow
@pytest.mark.parametrize("share", ["10 %", "30 %"])
@pytest.mark.parametrize(("filter_name", "column"), [("none", 0), ("asdf-minus", 1), ("robust", 3)])
def test_the_page_has_what_few_trials_of_another_seed_give(share: str, filter_name: str, column: int) -> None:
    page = (ROOT / "docs/robust.md").read_text(encoding="utf-8")
    row = re.search(rf"^\| moving, {share} flawed \|(.*)\|$", page, re.MULTILINE)
    assert row is not None
    h, late_error = (float(text.split()[0]) for text in row[1].split("|")[column].split(", ")[:2])
    study_results = [
        run_trials(replace(experiment, seed=5), 0, 3, 1000)
        for experiment in m.read_experiments("robust_grid")
        if experiment.is_dynamic
        and experiment.filter == filter_name
        and error_tables.flawed_label(experiment) == f"{share} flawed"
    ]
    scores = error_tables.mean_of_medians(lambda trials: trials.scores()["H"], study_results)
    assert scores.value == pytest.approx(h, abs=5)
    errors = error_tables.mean_of_medians(error_tables.late_errors, study_results)
    assert errors.value == pytest.approx(late_error, rel=0.5)


# --- Ageing ----------------------------------------------------------------------------------------------


def test_each_way_to_age_has_a_row_for_each_memory() -> None:
    rows = {ageing.row_label(experiment) for experiment in ageing.ageing_experiments()}
    assert len(rows) == 12


def test_the_ageing_picture_has_a_panel_for_each_way() -> None:
    experiments = [
        run_trials(replace(experiment, steps=4000), 0, 1, 1000)
        for experiment in ageing.ageing_experiments()[:38:5]
    ]
    lasting = [each.experiment for each in experiments if each.experiment.memory == ageing.LONGEST_MEMORY]
    titles = [axes.get_title("left") for axes in ageing.draw_errors(experiments).axes if axes.axison]
    assert titles == list(dict.fromkeys(ageing.way_of_ageing(experiment) for experiment in lasting))


# --- Swarm sizes -----------------------------------------------------------------------------------------


def test_density_and_world_are_the_same_at_every_size() -> None:
    varied = {"robots": 0, "flawed": 0, "trials": 0}
    experiments = m.read_experiments("scale")
    worlds = {tuple({**experiment.parameters(), **varied}.items()) for experiment in experiments}
    assert len(experiments) == 24
    assert len(worlds) == 4  # two filters, two kinds of flawed robots
    assert {experiment.flawed / experiment.robots for experiment in experiments} == {0.3}


def test_processor_time_is_the_best_of_three_measurements(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = iter([0.0, 5.0, 7.0, 14.0, 14.0, 16.0])  # trials of 5, 7 and 2 seconds
    monkeypatch.setattr(swarm_sizes, "process_time", lambda: next(clock))
    assert swarm_sizes.processor_seconds(Experiment(robots=2, steps=10, filter_period=10, seed=77)) == 2


@pytest.fixture
def trials_of_two_sizes(monkeypatch: pytest.MonkeyPatch) -> list[Trials]:
    """Run swarms of 3 and 9 robots, as if a trial took 3 s and 2 ns for each robot and step."""
    monkeypatch.setattr(
        swarm_sizes,
        "processor_seconds",
        lambda experiment: 3 + 2e-9 * experiment.robots * experiment.steps,
    )
    return short_trials(
        robots=[3, 9],
        flawed="33.4%",
        sensors=[UNDERCONFIDENT, OVERCONFIDENT],
        filter=["none", "robust"],
    )


def test_the_cost_of_a_step_leaves_out_the_start_of_a_trial(trials_of_two_sizes: list[Trials]) -> None:
    for trials in trials_of_two_sizes:
        assert swarm_sizes.step_cost(trials) == pytest.approx([2, 2])


def test_the_size_table_ends_in_the_cost(trials_of_two_sizes: list[Trials]) -> None:
    rows = swarm_sizes.size_table(trials_of_two_sizes).splitlines()[2:]
    assert [row.split("|")[1].strip() for row in rows] == [
        "3 robots, underconfident",
        "9 robots, underconfident",
        "3 robots, overconfident",
        "9 robots, overconfident",
    ]
    assert all(row.endswith(", 2 |") for row in rows)


def test_the_size_picture_has_score_error_and_cost(trials_of_two_sizes: list[Trials]) -> None:
    axes = swarm_sizes.draw_sizes(trials_of_two_sizes).axes
    assert [each.get_title() for each in axes] == ["underconfident"] * 3 + ["overconfident"] * 3
    assert {each.get_xscale() for each in axes} == {"log"}
    cost_lines = np.concatenate([np.asarray(line.get_ydata()) for line in axes[2].lines])
    assert cost_lines == pytest.approx([2] * 4)


def test_the_size_picture_draws_medians(trials_of_two_sizes: list[Trials]) -> None:
    error_axes = swarm_sizes.draw_sizes(trials_of_two_sizes).axes[1]
    unfiltered = [
        float(np.median(error_tables.late_errors(trials)))
        for trials in trials_of_two_sizes
        if trials.experiment.filter == "none" and trials.experiment.true_accuracy == 0.95
    ]
    assert error_axes.lines[0].get_ydata() == pytest.approx(unfiltered)


# --- Programs --------------------------------------------------------------------------------------------


def arguments_for(folder: Path, quick: bool = True) -> argparse.Namespace:
    return argparse.Namespace(folder=folder, workers=1, quick=quick)


def test_the_quick_form_has_few_and_short_trials(tmp_path: Path) -> None:
    experiments = m.grid(robots=3, flawed=1, steps=9000, trials=30)
    (trials,) = error_tables.run_experiments("a", experiments, arguments_for(tmp_path))
    assert (trials.experiment.trials, trials.experiment.steps) == (2, 4000)
    assert (tmp_path / "a.parquet").exists()


def test_the_full_form_is_that_of_the_experiments(tmp_path: Path) -> None:
    experiments = m.grid(robots=3, flawed=1, steps=400, filter_period=100, trials=3)
    (trials,) = error_tables.run_experiments("a", experiments, arguments_for(tmp_path, False), record=50)
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


# --- Peers -----------------------------------------------------------------------------------------------


def error_of(true_fill_ratio: float = 0.55, **changes: Any) -> float:
    """Return the error at the end of a short trial of 20 moving robots, without the last five."""
    world: dict[str, Any] = {**UNDERCONFIDENT, "topology": "dynamic", "latency": 1, "steps": 4000}
    (experiment,) = m.grid(**{**world, "trials": 1, "seed": 77, **changes})
    x = run_trials(experiment, 0, 1, 50).records["x"][0, -20:, :15]
    return float(abs(x - true_fill_ratio).mean())


@pytest.fixture(scope="module")
def error_without_filter() -> float:
    return error_of(filter="none")


@pytest.fixture(scope="module")
def error_with_robust_filter() -> float:
    return error_of(filter="robust")


@pytest.mark.slow
def test_all_counts_are_a_bound_of_the_robust_filter(
    error_with_robust_filter: float, error_without_filter: float
) -> None:
    bound = error_of(firmware=peers.AllCountsRobot, filter="none")
    assert bound < error_with_robust_filter < error_without_filter / 3


@pytest.mark.slow
def test_a_memory_halves_the_error_without_a_filter(error_without_filter: float) -> None:
    assert error_of(firmware=peers.RememberingRobot, filter="none") < error_without_filter / 2


@pytest.mark.slow
def test_bayescpf_is_another_filter_than_asdf_plus() -> None:
    assert error_of(firmware=peers.BayesCpfRobot, filter="asdf-plus") != error_of(filter="asdf-plus")


@pytest.mark.slow
def test_lost_messages_change_the_estimates(error_with_robust_filter: float) -> None:
    assert error_of(firmware=peers.LossyRobot, filter="robust") != error_with_robust_filter


@pytest.mark.slow
def test_each_liar_makes_a_swarm_without_a_filter_worse() -> None:
    honest, one, five = (
        error_of(firmware=firmware, filter="none", flawed=0)
        for firmware in ("native", peers.one_liar, peers.five_liars)
    )
    assert honest < one < five


@pytest.mark.slow
def test_the_robust_filter_withstands_two_liars() -> None:
    five_without_filter = error_of(firmware=peers.five_liars, filter="none", flawed=0)
    assert error_of(firmware=peers.two_liars, filter="robust", flawed=0) < five_without_filter / 2


@pytest.mark.slow
def test_a_changing_floor_ends_with_the_other_fill_ratio() -> None:
    world = {"sensor": peers.ChangingFloor, "filter": "none", "flawed": 0, "memory": 1024}
    assert error_of(0.95, **world) < 0.1 < error_of(0.55, **world)


def ageing_error_of(**changes: Any) -> float:
    """Return the error at the end of a short trial in which all sensors lose 0.4 alike."""
    world: dict[str, Any] = {"steps": 4000, "drift": "linear", "drift_rate": -1e-4, "fill_ratio": 0.75}
    robots: dict[str, Any] = {"robots": 10, "flawed": 0, "sensor": peers.KnownSensors, "filter": "none"}
    (experiment,) = m.grid(**{**world, **robots, "seed": 7, "trials": 1, **changes})
    return float(abs(run_trials(experiment, 0, 1, 100).records["x"][0, -5:] - 0.75).mean())


@pytest.mark.slow
@pytest.mark.parametrize("firmware", ["reference", peers.OracleRobot])
def test_a_robot_that_knows_its_sensor_now_is_wrong(firmware: Any) -> None:
    assert ageing_error_of(firmware=firmware) > 0.06


@pytest.mark.slow
@pytest.mark.parametrize("memory", [2**31, 1024])
def test_a_robot_that_knows_the_accuracy_of_what_it_counts_is_right(memory: int) -> None:
    assert ageing_error_of(firmware=peers.MeanAccuracyRobot, memory=memory) < 0.03


@pytest.mark.slow
def test_bayescpf_makes_use_of_the_known_drift() -> None:
    knowing, unknowing = (
        ageing_error_of(firmware=firmware, filter="asdf-plus")
        for firmware in (peers.AgeingBayesCpfRobot, peers.BayesCpfRobot)
    )
    assert knowing != unknowing


def test_every_peer_has_a_column_of_its_own() -> None:
    experiments = [*robust_filter.peer_experiments(), *ageing.peer_experiments()]
    firmwares = {experiment.firmware for experiment in experiments} - {"native"}
    labels = {peers.column_label(experiment) for experiment in experiments if experiment.firmware != "native"}
    assert len(firmwares) == 6
    assert labels == {
        "no filter with memory",
        "ASDF- with memory",
        "BayesCPF",
        "all counts",
        "knows b now",
        "knows its mean",
    }


def test_the_robust_picture_has_a_panel_for_each_world(monkeypatch: pytest.MonkeyPatch) -> None:
    shown: dict[str, list[Trials]] = {}

    def note_panels(panels: dict[str, list[Trials]]) -> Figure:
        shown.update(panels)
        return Figure()

    monkeypatch.setattr(robust_filter, "errors_over_time", note_panels)
    common: dict[str, Any] = {**MOVING, "filter": "none", "sensors": [UNDERCONFIDENT, OVERCONFIDENT]}
    grid = short_trials(**{**common, "flawed": [6, 10]})
    worlds = short_trials(**common, firmware=peers.five_liars)
    robust_filter.draw_errors(grid, worlds)
    assert {title: len(experiments) for title, experiments in shown.items()} == {
        f"{world}, {flaw}": 1
        for flaw in ("underconfident", "overconfident")
        for world in ("30 % flawed", "30 % flawed and 5 liars", "50 % flawed")
    }


def test_a_curve_leaves_out_liars_and_most_of_the_values() -> None:
    (trials,) = short_trials(robots=20, flawed=0, firmware=peers.five_liars, filter="none", steps=3200)
    thinned = robust_filter.thin_out(trials)
    assert thinned.records["x"].shape == (2, 17, 15)
    assert thinned.sampling_interval == 200
    assert thinned.records["x"][:, -1].tolist() == trials.records["x"][:, -1, :15].tolist()
