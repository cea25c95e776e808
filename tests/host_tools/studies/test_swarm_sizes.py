"""The study of swarm sizes: costs, table and picture."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from matplotlib.axes import Axes

from host_tools.studies.conftest import two_trials_with
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.results import Trials
from mcp_asdf_tools.studies import swarm_sizes
from mcp_asdf_tools.studies.study_program import PARAMETERS_BY_FLAW

# --- Costs -----------------------------------------------------------------------------------------------


@pytest.fixture
def seconds_of_next_trials(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """Return a list to be filled with seconds: how long each trial takes that is run from then on."""
    seconds_of_next_trials: list[float] = []
    clock = 0.0

    def let_time_pass(*arguments: Any, **options: Any) -> None:
        nonlocal clock
        clock += seconds_of_next_trials.pop(0)

    monkeypatch.setattr(swarm_sizes, "run_trials", let_time_pass)
    monkeypatch.setattr(swarm_sizes, "process_time", lambda: clock)
    swarm_sizes.processor_seconds.cache_clear()
    return seconds_of_next_trials


def test_the_processor_time_of_a_trial_is_the_shortest_of_three_after_a_first_one_that_does_not_count(
    seconds_of_next_trials: list[float],
) -> None:
    """The first of four trials would be the shortest. Of the other three the last one is.

    No trial is run. By a fixture, each one takes the next number of seconds in this list.
    """
    seconds_of_next_trials += [1.0, 5.0, 7.0, 2.0]
    assert swarm_sizes.processor_seconds(Experiment(robots=2)) == 2.0


def test_the_cost_of_a_robot_s_step_leaves_out_what_a_trial_takes_before_its_first_step(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Here a trial takes 3 s to start, and 2 ns for each step of each robot. The cost is in nanoseconds."""

    def seconds_of_trial(experiment: Experiment) -> float:
        return 3 + 2e-9 * experiment.robots * experiment.steps

    monkeypatch.setattr(swarm_sizes, "processor_seconds", seconds_of_trial)
    costs_of_two_trials = swarm_sizes.step_cost(two_trials_with(robots=9))
    assert costs_of_two_trials == pytest.approx([2, 2])


@pytest.mark.parametrize(("robots", "steps"), [(3, 10**6 // 3), (20_000, 100)])
def test_the_fewer_robots_a_swarm_has_the_more_steps_are_measured(
    robots: int, steps: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The first trial takes a million robot-steps, but at least 100 steps. The second takes twice as many."""
    measured_steps = set()

    def record_steps(experiment: Experiment) -> float:
        measured_steps.add(experiment.steps)
        return 0.0

    monkeypatch.setattr(swarm_sizes, "processor_seconds", record_steps)
    swarm_sizes.step_cost(two_trials_with(topology="dynamic", latency=1, robots=robots))

    assert measured_steps == {steps, 2 * steps}


# --- Table and picture -----------------------------------------------------------------------------------


@pytest.fixture
def step_costs_2_ns(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let a robot's step cost 2 ns, without a measurement."""
    monkeypatch.setattr(swarm_sizes, "step_cost", lambda trials: np.full(2, 2.0))


@pytest.mark.usefixtures("few_resamples", "step_costs_2_ns")
def test_a_cell_has_the_score_the_late_error_and_the_nanoseconds_of_a_robot_s_step() -> None:
    """All robots converge at once without an error, worth 100 points. Later they estimate 0.6 for 0.5.

    A fixture lets the step of a robot cost 2 ns.
    """
    trials = two_trials_with(fill_ratio=0.5, x=0.6)
    score = "100.0"
    late_error = "0.100"
    nanoseconds = "2"
    assert swarm_sizes.size_text([trials]) == f"{score}, {late_error}, {nanoseconds}"


def rows_of_two_sizes() -> dict[str, list[Trials]]:
    """Return results of swarms of 3 and of 9 robots with errors of 0.3 and of 0.1, of both kinds of flaws."""
    rows = {}
    for flaw, sensors in PARAMETERS_BY_FLAW.items():
        for robots, error in ((3, 0.3), (9, 0.1)):
            rows[f"{robots} robots, {flaw}"] = [
                two_trials_with(
                    **sensors,
                    robots=robots,
                    flawed=robots // 3,
                    filter=filter_name,
                    x=sensors["fill_ratio"] - error,
                )
                for filter_name in ("none", "robust")
            ]
    return rows


@pytest.fixture
def panels(step_costs_2_ns: None) -> list[Axes]:
    """The six panels of the picture of ``rows_of_two_sizes``."""
    return swarm_sizes.draw_sizes(rows_of_two_sizes()).axes


def test_the_picture_of_swarm_sizes_has_score_error_and_cost_of_both_kinds_of_flaws(
    panels: list[Axes],
) -> None:
    """It has six panels: three for underconfident flawed robots, and three for overconfident ones."""
    titles_and_quantities = [(panel.get_title(), panel.get_ylabel()) for panel in panels]

    assert titles_and_quantities == [
        ("underconfident", "score H"),
        ("underconfident", "error of the last quarter"),
        ("underconfident", "ns, robot and step"),
        ("overconfident", "score H"),
        ("overconfident", "error of the last quarter"),
        ("overconfident", "ns, robot and step"),
    ]


def test_the_picture_of_swarm_sizes_has_logarithmic_axes_of_robots_and_errors(panels: list[Axes]) -> None:
    """The axis of the number of robots is the horizontal one. Scores are from 0 to 100, costs from 0 on."""
    score_panel, error_panel, cost_panel, *_overconfident = panels
    lowest_cost, _highest_cost = cost_panel.get_ylim()

    for panel in (score_panel, error_panel, cost_panel):
        assert panel.get_xscale() == "log"
    assert error_panel.get_yscale() == "log"
    assert score_panel.get_yscale() == "linear"
    assert score_panel.get_ylim() == (0, 100)
    assert lowest_cost == 0


def test_the_picture_draws_the_error_of_each_size_and_the_measured_cost(panels: list[Axes]) -> None:
    """Swarms of 3 robots have an error of 0.3, swarms of 9 an error of 0.1. A robot's step costs 2 ns."""
    _score_panel, error_panel, cost_panel, *_overconfident = panels
    unfiltered_errors, _robust_errors = error_panel.lines
    unfiltered_costs, robust_costs = cost_panel.lines

    assert unfiltered_errors.get_ydata() == pytest.approx([0.3, 0.1])
    assert unfiltered_costs.get_ydata() == pytest.approx([2, 2])
    assert robust_costs.get_ydata() == pytest.approx([2, 2])
