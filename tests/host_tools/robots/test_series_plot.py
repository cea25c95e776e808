"""The picture of runs over time: nothing is hidden, cut off or coloured as what it is not."""

from __future__ import annotations

import numpy as np
import pytest

from mcp_asdf_tools.common.figures import FLAWED, OTHER
from mcp_asdf_tools.robots.series_plot import TimeSeries, draw_time_series

STEPS = np.arange(0.0, 101.0, 10.0)


def run_of(b_hat: list[float], x: list[float], last: float = 0.0) -> TimeSeries:
    """Robots whose values stand still, but for the last of b_hat; the first robot is flawed."""
    values = {"b_hat": np.tile(b_hat, (11, 1)), "x_hat": np.tile(x, (11, 1)), "x": np.tile(x, (11, 1))}
    values["b_hat"][-1] += last
    return TimeSeries("title", STEPS, values, 1, {"b": 0.95, "f": 0.55})


def test_the_last_jump_is_followed_by_what_it_led_to() -> None:
    (axes, _, _) = draw_time_series([run_of([0.5, 0.7], [0.5, 0.6], last=0.2)]).axes
    line = axes.lines[0]
    assert line.get_drawstyle() == "steps-post"
    assert np.asarray(line.get_ydata())[-2:].tolist() == pytest.approx([0.9, 0.9])
    assert float(np.asarray(line.get_xdata())[-1]) == axes.get_xlim()[1] > STEPS[-1]


def test_runs_beside_each_other_share_their_axes() -> None:
    low, high = run_of([0.55, 0.95], [0.5, 0.6]), run_of([0.2, 0.95], [0.5, 0.9])
    grid = np.array(draw_time_series([low, high]).axes).reshape(3, 2)
    for first, second in grid:
        assert first.get_ylim() == second.get_ylim()
    assert grid[0, 0].get_ylim()[0] < 0.2


def test_flawed_robots_are_on_top_and_in_their_colour() -> None:
    (axes, *_) = draw_time_series([run_of([0.55, 0.95], [0.5, 0.5])]).axes
    assert [line.get_color() for line in axes.lines[:2]] == [OTHER, FLAWED]
    assert np.asarray(axes.lines[-1].get_ydata()).tolist() == [0.95, 0.95], "the true value"
