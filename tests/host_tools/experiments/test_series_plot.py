"""The picture of runs over time: nothing is cut off or coloured as what it is not."""

from __future__ import annotations

import numpy as np

from mcp_asdf_tools.common.figures import FLAWED, INK, OTHER
from mcp_asdf_tools.experiments.series_plot import TimeSeries, draw_time_series

STEPS = np.arange(0.0, 101.0)


def test_runs_beside_each_other_share_axes_colours_and_legend() -> None:
    """Room is for all but the first moments, which are wild; flawed robots lie on top."""
    values = {name: np.array([[low, high]]).repeat(101, axis=0) for name, low, high in RANGES}
    for each in values.values():
        each[:2] = 0.0, 1.0
    other = {name: each * 0.5 for name, each in values.items()}
    runs = [TimeSeries("title", STEPS, each, 1, {"b": 0.95, "f": 0.55}) for each in (values, other)]
    figure = draw_time_series(runs)
    grid = np.array(figure.axes).reshape(3, 2)
    for pair, (name, low, high), truth in zip(grid, RANGES, (0.95, 0.55, 0.55), strict=True):
        least, most = min(low / 2, truth), max(high, truth)
        margin = max(0.06 * (most - least), 0.01)
        for axes, run in zip(pair, runs, strict=True):
            assert np.allclose(axes.get_ylim(), (least - margin, most + margin))
            assert axes.get_xlim() == (0, 100)
            assert [line.get_color() for line in axes.lines] == [OTHER, FLAWED, INK]
            assert np.array_equal(
                np.transpose([line.get_ydata() for line in axes.lines[1::-1]]), run.values[name]
            )
            assert np.asarray(axes.lines[2].get_ydata()).tolist() == [truth] * 2
            assert axes.lines[0].get_drawstyle() == ("steps-post" if name == "b_hat" else "default")
    texts = [text.get_text() for text in figure.legends[0].get_texts()]
    assert texts == ["flawed robots", "healthy robots", "true value"]
    assert [axes.get_title(loc="left") for axes in grid.flat] == ["title"] * 2 + [""] * 4


RANGES = (("b_hat", 0.5, 0.7), ("x_hat", 0.5, 0.6), ("x", 0.4, 0.58))
