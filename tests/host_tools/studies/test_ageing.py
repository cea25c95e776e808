"""The study of sensors that age: rows and picture of its page."""

from __future__ import annotations

from dataclasses import replace

import mcp_asdf_tools as m
from mcp_asdf_tools.experiments.trials import run_trials
from mcp_asdf_tools.studies import ageing


def test_each_way_to_age_has_a_row_for_each_memory() -> None:
    rows = {ageing.row_label(experiment) for experiment in m.read_experiments("ageing")}
    assert len(rows) == 12


def test_the_ageing_picture_has_a_panel_for_each_way() -> None:
    experiments = [
        run_trials(replace(experiment, steps=4000), 0, 1, 1000)
        for experiment in m.read_experiments("ageing")[:38:5]
    ]
    lasting = [each.experiment for each in experiments if each.experiment.memory == ageing.LONGEST_MEMORY]
    titles = [axes.get_title("left") for axes in ageing.draw_errors(experiments).axes if axes.axison]
    assert titles == list(dict.fromkeys(ageing.way_of_ageing(experiment) for experiment in lasting))
