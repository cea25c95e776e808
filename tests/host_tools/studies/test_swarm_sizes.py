"""The study of swarm sizes: costs, table and picture."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from host_tools.studies.conftest import short_trials
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.results import Trials
from mcp_asdf_tools.studies import study_program, swarm_sizes
from mcp_asdf_tools.studies.study_program import FLAWS

SHORT_EXPERIMENT = Experiment(robots=2, steps=10, filter_period=10, seed=77)


@pytest.mark.parametrize(
    ("row", "robots", "flawed", "trials"),
    [
        ("20 robots, underconfident", 20, 6, 12),
        ("1,000 robots, overconfident", 1000, 300, 12),
        ("10,000 robots, overconfident", 10_000, 3000, 3),
    ],
)
def test_the_largest_swarms_have_fewer_trials(row: str, robots: int, flawed: int, trials: int) -> None:
    experiments = swarm_sizes.size_rows()[row]
    sizes = {(experiment.robots, experiment.flawed, experiment.trials) for experiment in experiments}
    assert sizes == {(robots, flawed, trials)}
    assert [experiment.filter for experiment in experiments] == ["none", "robust"]


def test_density_and_world_are_the_same_at_every_size() -> None:
    experiments = [experiment for row in swarm_sizes.size_rows().values() for experiment in row]
    worlds = {
        (experiment.density, experiment.latency, experiment.steps, experiment.seed)
        for experiment in experiments
    }

    assert worlds == {(1, 1, 10_000, 65536)}


def test_processor_time_is_the_shortest_of_three_measurements(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = iter([0.0, 5.0, 7.0, 14.0, 14.0, 16.0])  # trials of 5, 7 and 2 seconds
    monkeypatch.setattr(swarm_sizes, "process_time", lambda: next(clock))
    swarm_sizes.processor_seconds.cache_clear()
    assert swarm_sizes.processor_seconds(SHORT_EXPERIMENT) == 2


def test_the_first_trial_is_not_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    events: list[str] = []
    monkeypatch.setattr(swarm_sizes, "run_trials", lambda *arguments, **options: events.append("trial"))

    def record_clock() -> float:
        events.append("clock")
        return 0.0

    monkeypatch.setattr(swarm_sizes, "process_time", record_clock)
    swarm_sizes.processor_seconds.cache_clear()
    swarm_sizes.processor_seconds(SHORT_EXPERIMENT)
    assert events == ["trial", *["clock", "trial", "clock"] * 3]


@pytest.fixture(scope="module")
def rows_of_two_sizes() -> dict[str, list[Trials]]:
    return {
        f"{robots} robots, {flaw}": short_trials(
            **sensors, robots=robots, flawed="33.4%", filter=["none", "robust"]
        )
        for flaw, sensors in FLAWS.items()
        for robots in (3, 9)
    }


@pytest.fixture(autouse=True)
def known_costs(monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest) -> None:
    """Let a trial take 3 s and 2 ns for each robot and step, in tests of finished trials."""
    if "rows_of_two_sizes" in request.fixturenames:
        monkeypatch.setattr(
            swarm_sizes,
            "processor_seconds",
            lambda experiment: 3 + 2e-9 * experiment.robots * experiment.steps,
        )


def test_the_cost_of_a_step_leaves_out_the_start_of_a_trial(
    rows_of_two_sizes: dict[str, list[Trials]],
) -> None:
    (trials, _) = rows_of_two_sizes["9 robots, overconfident"]
    assert swarm_sizes.step_cost(trials) == pytest.approx([2, 2])


@pytest.mark.parametrize(("robots", "steps"), [(3, [333_333, 666_666]), (20_000, [100, 200])])
def test_small_swarms_are_measured_for_more_steps(
    robots: int, steps: list[int], rows_of_two_sizes: dict[str, list[Trials]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A trial and one of twice as many steps are measured, the longer the fewer robots there are."""
    measured_steps: list[int] = []

    def record_steps(experiment: Experiment) -> float:
        measured_steps.append(experiment.steps)
        return 0.0

    monkeypatch.setattr(swarm_sizes, "processor_seconds", record_steps)
    (trials, _) = rows_of_two_sizes["3 robots, overconfident"]
    moving = Experiment(topology="dynamic", latency=1, robots=robots)
    swarm_sizes.step_cost(replace(trials, experiment=moving))
    assert sorted(measured_steps) == steps


def test_a_cell_has_score_error_and_cost(
    rows_of_two_sizes: dict[str, list[Trials]], few_resamples: None
) -> None:
    (trials, _) = rows_of_two_sizes["9 robots, overconfident"]
    score, error = study_program.score_text([trials]), study_program.late_error_text([trials])
    assert swarm_sizes.size_text([trials]) == f"{score}, {error}, 2"


def test_the_picture_has_score_error_and_cost_of_both_flaws(
    rows_of_two_sizes: dict[str, list[Trials]],
) -> None:
    axes = swarm_sizes.draw_sizes(rows_of_two_sizes).axes
    assert [each.get_title() for each in axes] == ["underconfident"] * 3 + ["overconfident"] * 3
    assert [each.get_ylabel() for each in axes[:3]] == [
        "score H",
        "error of the last quarter",
        "ns, robot and step",
    ]


def test_the_picture_has_logarithmic_axes_of_robots_and_errors(
    rows_of_two_sizes: dict[str, list[Trials]],
) -> None:
    score_axes, error_axes, cost_axes = swarm_sizes.draw_sizes(rows_of_two_sizes).axes[:3]
    assert {axes.get_xscale() for axes in (score_axes, error_axes, cost_axes)} == {"log"}
    assert (score_axes.get_yscale(), error_axes.get_yscale()) == ("linear", "log")
    assert score_axes.get_ylim() == (0, 100)
    assert cost_axes.get_ylim()[0] == 0


def test_the_picture_draws_costs_of_both_filters(rows_of_two_sizes: dict[str, list[Trials]]) -> None:
    cost_axes = swarm_sizes.draw_sizes(rows_of_two_sizes).axes[2]
    costs = np.concatenate([np.asarray(line.get_ydata()) for line in cost_axes.lines])
    assert costs == pytest.approx([2] * 4)


def test_the_picture_draws_medians_of_errors(rows_of_two_sizes: dict[str, list[Trials]]) -> None:
    error_axes = swarm_sizes.draw_sizes(rows_of_two_sizes).axes[1]
    unfiltered_medians = [
        float(np.median(study_program.late_errors(unfiltered)))
        for unfiltered, _robust in (
            rows_of_two_sizes["3 robots, underconfident"],
            rows_of_two_sizes["9 robots, underconfident"],
        )
    ]

    assert error_axes.lines[0].get_ydata() == pytest.approx(unfiltered_medians)
