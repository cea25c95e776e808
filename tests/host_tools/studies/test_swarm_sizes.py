"""The study of swarm sizes: costs, table and picture of its page."""

from __future__ import annotations

import numpy as np
import pytest

import mcp_asdf_tools as m
from host_tools.studies.conftest import OVERCONFIDENT, UNDERCONFIDENT, short_trials
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.results import Trials
from mcp_asdf_tools.studies import error_tables, swarm_sizes


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


def test_the_first_trial_is_not_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    events: list[str] = []
    monkeypatch.setattr(swarm_sizes, "run_trials", lambda *arguments, **options: events.append("trial"))

    def note_clock() -> float:
        events.append("clock")
        return 0.0

    monkeypatch.setattr(swarm_sizes, "process_time", note_clock)
    swarm_sizes.processor_seconds(Experiment(robots=2, steps=10, filter_period=10, seed=78))
    assert events == ["trial", *["clock", "trial", "clock"] * 3]
