"""The study of rules from related work: its experiments, measures and picture."""

from __future__ import annotations

import pytest

from host_tools.experiments.drawn_figures import legend_of, titles_of
from host_tools.studies.conftest import run_two_short_trials, two_trials_with
from mcp_asdf_tools.studies import peers, related_work


def test_the_early_error_is_the_mean_distance_from_f_in_the_first_quarter_without_step_0() -> None:
    """There are eight samples of the robots' estimates after step 0, so the first quarter has two."""
    step_0 = [0.9, 0.9, 0.9, 0.9]  # by robot
    first_quarter = [[0.6, 0.6, 0.6, 0.6], [0.8, 0.8, 0.8, 0.8]]  # 0.1 and 0.3 from f
    later = [[0.9, 0.9, 0.9, 0.9]] * 6
    trials = two_trials_with(fill_ratio=0.5, x=[step_0, *first_quarter, *later])

    mean_distance = (0.1 + 0.3) / 2
    assert related_work.early_errors(trials) == pytest.approx([mean_distance, mean_distance])


@pytest.mark.usefixtures("few_resamples")
def test_only_robots_whose_estimate_is_above_one_half_answer_rightly_that_black_prevails() -> None:
    """0.55 of the floor is black. Two of four robots, with 0.9 and 0.51, are right in both trials."""
    trials = two_trials_with(fill_ratio=0.55, x=[0.9, 0.51, 0.5, 0.2])
    assert related_work.right_percents(trials).tolist() == [50, 50]
    assert related_work.right_text([trials]) == "50.0"


def test_the_picture_has_a_line_for_each_rule_in_three_swarms_of_both_kinds_of_flaws() -> None:
    """Each of the six panels has the label of a table's row as its title; here all draw the same results."""
    results = [
        *run_two_short_trials(filter="none"),
        *run_two_short_trials(filter="robust"),
        *run_two_short_trials(filter="none", firmware=peers.WmsrRobot),
        *run_two_short_trials(filter="none", firmware=peers.TrimmedMeanRobot),
    ]
    results_by_row = {row: results for row in related_work.resilience_rows()}

    figure = related_work.draw_errors(results_by_row)

    assert titles_of(figure) == [
        "fully connected, 5 liars, underconfident",
        "moving, 5 liars, underconfident",
        "moving, 6 flawed, underconfident",
        "fully connected, 5 liars, overconfident",
        "moving, 5 liars, overconfident",
        "moving, 6 flawed, overconfident",
    ]
    assert legend_of(figure) == ["no filter", "W-MSR", "trimmed mean", "robust"]
    for panel in figure.axes:
        assert len(panel.lines) == 4
