"""A running swarm is shown as it is: by a bar on a terminal, by lines of fields in a pipe."""

from __future__ import annotations

import io
import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from rich.cells import cell_len
from rich.console import Console

from host_tools.swarm.swarms import Track
from mcp_asdf_tools.swarm.carrier import Wiring
from mcp_asdf_tools.swarm.live_view import LiveView
from mcp_asdf_tools.swarm.settings import SwarmSettings
from mcp_asdf_tools.swarm.swarm import Companion, Swarm, results_of, run_swarm

MOVING = SwarmSettings(
    robots=8, flawed="50%", steps=400, filter="asdf-minus", filter_period=50, topology="dynamic", density=4
)


def shown(settings: SwarmSettings, compare: bool = True, **options: Any) -> tuple[str, Track, Track]:
    """All that a run writes on a console with these options, its track, and that without the filter."""
    out = io.StringIO()
    console = Console(file=out, **options)
    companion = Companion(settings) if compare else None
    track, without = Track(settings), Track(settings.without_filter())
    with Swarm(settings, Wiring()) as swarm, LiveView(console, companion) as live:
        run_swarm(swarm, [track, live] if companion is None else [companion, track, live])
    with Swarm(settings.without_filter(), Wiring()) as swarm:
        other = run_swarm(swarm, [without])
    assert companion is None or (results_of(companion.swarm) == other.results and companion.seconds > 0)
    return out.getvalue(), track, without


def mean_errors(track: Track) -> list[float]:
    errors: list[float] = np.abs(track["x"] - MOVING.fill_ratio).mean(axis=1).tolist()
    return errors


@pytest.mark.parametrize("compare", [False, True])
def test_a_pipe_gets_lines_of_fields(compare: bool) -> None:
    text, track, other = shown(MOVING, compare)
    rows = [line.split("\t") for line in text.splitlines()]
    found, without, b_hat = mean_errors(track), mean_errors(other), track["b_hat"]
    assert [row for row in rows if row[0] == "step"] == [
        ["step", str(tick), "mean_error", f"{found[tick]:.5f}"]
        + (["without_filter", f"{without[tick]:.5f}"] if compare else [])
        for tick in range(20, 401, 20)
    ]
    changes = [
        f"robot {robot} step {i + 1} b_hat {b_hat[i, robot]:.4f} {b_hat[i + 1, robot]:.4f}".split()
        for i, robot in np.argwhere(np.abs(np.diff(b_hat, axis=0)) > 0.002)
    ]
    assert [row for row in rows if row[0] == "robot"] == changes
    assert changes and len(rows) == 20 + len(changes)


@pytest.mark.parametrize(("width", "compare"), [(60, True), (80, False), (200, True)])
def test_a_terminal_gets_a_bar_with_the_present_error(width: int, compare: bool) -> None:
    settings = replace(MOVING, steps=200)
    text, track, other = shown(settings, compare, width=width, force_terminal=True, color_system=None)
    pictures = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "\n", text).replace("\r", "\n").splitlines()
    assert max(map(cell_len, pictures)) <= width
    last = [each for each in pictures if each.strip()][-1]
    assert last.startswith("200/200 ") and last.count("━") == (5 if width == 60 else 10)
    errors = f"mean error {mean_errors(track)[-1]:.4f}"
    errors += f", without filter {mean_errors(other)[-1]:.4f}" if compare else ""
    assert errors in last or (width == 60 and errors[:20] in last)


@pytest.mark.parametrize("is_terminal", [False, True])
def test_a_quiet_console_stays_empty(is_terminal: bool) -> None:
    assert shown(replace(MOVING, steps=20), quiet=True, force_terminal=is_terminal)[0] == ""
