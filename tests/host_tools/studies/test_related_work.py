"""The study of rules from related work: its percentage of right answers, and its picture."""

from __future__ import annotations

from host_tools.experiments.drawn_figures import legend_of, titles_of
from host_tools.studies.conftest import run_two_short_trials, two_trials_with
from mcp_asdf_tools.studies import peers, related_work, study_program


def test_only_robots_whose_estimate_is_above_one_half_answer_rightly_that_black_prevails() -> None:
    """0.55 of the floor is black. Two of four robots, with 0.9 and 0.51, are right in both trials."""
    trials = two_trials_with(fill_ratio=0.55, x=[0.9, 0.51, 0.5, 0.2])
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

    figure = study_program.plot_errors_of_swarms(results_by_row, related_work.DRAWN_SWARMS)

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
