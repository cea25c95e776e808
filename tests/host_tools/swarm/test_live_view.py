"""The progress of a running swarm: a bar on a terminal, and a line a minute elsewhere.

Baselines are copies of the swarm with other filters, which run beside it for comparison.
"""

from __future__ import annotations

import io
import itertools
import re
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any
from unittest.mock import Mock

import pytest
from rich.console import Console

from mcp_asdf_tools.common import progress_bar
from mcp_asdf_tools.swarm import run as run_module
from mcp_asdf_tools.swarm.carrier import Wiring
from mcp_asdf_tools.swarm.live_view import live_view
from mcp_asdf_tools.swarm.run import Baselines, mean_error, run_swarm
from mcp_asdf_tools.swarm.settings import SwarmSettings
from mcp_asdf_tools.swarm.swarm import Swarm

MOVING_SWARM = SwarmSettings(
    robots=8, flawed="50%", steps=400, filter="asdf-minus", filter_period=50, topology="dynamic", density=4
)


@dataclass(frozen=True)
class ViewedRun:
    """What a run has shown, and how it has ended.

    Attributes:
        output: All that was written on the console.
        mean_error: Mean error of the swarm after the last tick.
        mean_errors_of_baselines: Mean error of each baseline after the last tick.
    """

    output: str
    mean_error: float
    mean_errors_of_baselines: list[float]


def view_run(steps: int, with_baselines: bool, **console_options: Any) -> ViewedRun:
    """Run a swarm of eight robots, and return what its view has shown on a console.

    If ``with_baselines``, the same swarm without a filter and with the robust one run with it, as baselines.
    """
    settings = replace(MOVING_SWARM, steps=steps)
    baselines = Baselines(settings) if with_baselines else None
    output = io.StringIO()
    console = Console(file=output, **console_options)
    with Swarm(settings, Wiring()) as swarm, live_view(console, steps, baselines) as view:
        # Baselines come first, so that the view meets them after the same tick.
        hooks = [hook for hook in (baselines, view) if hook is not None]
        run_swarm(swarm, hooks)
    mean_errors = {} if baselines is None else baselines.mean_errors()
    return ViewedRun(output.getvalue(), mean_error(swarm), list(mean_errors.values()))


def pictures_of_bar(output: str) -> list[str]:
    """Return the pictures of the bar that were drawn one over the other, first to last.

    Between two pictures the cursor goes back, by escape sequences of the terminal or carriage returns.
    """
    separated = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "\n", output).replace("\r", "\n")
    return [line for line in separated.splitlines() if line.strip()]


def view_run_on_terminal(steps: int, with_baselines: bool, width: int) -> ViewedRun:
    """Run the swarm of ``view_run``, and return what its view has shown on a terminal of so many columns."""
    return view_run(steps, with_baselines, width=width, force_terminal=True, color_system=None)


def test_a_terminal_gets_a_progress_bar_from_the_first_step_to_the_last() -> None:
    """The bar is redrawn in place, at most four times a second, so not after each of 200 short steps.

    A full bar has ten marks.
    """
    viewed_run = view_run_on_terminal(steps=200, with_baselines=False, width=80)
    first_picture, *other_pictures, last_picture = pictures_of_bar(viewed_run.output)
    assert first_picture.startswith("1/200 ")
    assert len(other_pictures) < 198
    assert last_picture.startswith("200/200 ")
    assert last_picture.count("━") == 10


def test_the_progress_bar_of_a_swarm_with_baselines_ends_with_the_mean_error_of_each() -> None:
    """Baselines are the same swarm without a filter and with the robust one."""
    viewed_run = view_run_on_terminal(steps=20, with_baselines=True, width=200)
    error_without_filter, error_with_robust_filter = viewed_run.mean_errors_of_baselines

    *_, last_picture = pictures_of_bar(viewed_run.output)
    assert (
        f"mean error {viewed_run.mean_error:.4f}, no filter {error_without_filter:.4f}, "
        f"robust {error_with_robust_filter:.4f}"
    ) in last_picture


def test_a_terminal_shows_its_cursor_again_after_the_progress_bar() -> None:
    hide_cursor, show_cursor = "\x1b[?25l", "\x1b[?25h"
    output = view_run_on_terminal(steps=20, with_baselines=False, width=80).output
    assert output.index(hide_cursor) < output.index(show_cursor)


def test_a_swarm_in_a_pipe_reports_its_ticks_on_standard_error(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Lines come once a minute; here after each tick. The pipe itself gets the results alone, at the end."""
    monkeypatch.setattr(progress_bar, "_SECONDS_BETWEEN_LINES", 0.0)
    viewed_run = view_run(steps=20, with_baselines=True)

    assert viewed_run.output == ""
    first_line, *_, last_line = capsys.readouterr().err.splitlines()
    assert first_line.startswith("ticks: 1 of 20, ")
    assert last_line.startswith("ticks: 20 of 20, ")


@pytest.mark.parametrize("is_terminal", [False, True])
def test_a_quiet_swarm_shows_nothing_while_it_runs(
    is_terminal: bool, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Neither a terminal nor a pipe, nor standard error, gets anything of a run with baselines."""
    monkeypatch.setattr(progress_bar, "_SECONDS_BETWEEN_LINES", 0.0)
    viewed_run = view_run(steps=20, with_baselines=True, quiet=True, force_terminal=is_terminal)
    assert viewed_run.output == ""
    assert capsys.readouterr().err == ""


def test_the_baselines_of_a_swarm_with_asdf_minus_have_no_filter_and_the_robust_one() -> None:
    """Baselines are the same swarm with other filters. They are listed by the names of their filters."""
    baselines = Baselines(replace(MOVING_SWARM, filter="asdf-minus"))
    assert list(baselines.swarms) == ["none", "robust"]


def test_the_baselines_of_a_swarm_in_real_time_have_no_clock() -> None:
    """A baseline takes a tick whenever the swarm has taken one, so it needs no clock."""
    baselines = Baselines(replace(MOVING_SWARM, clock="real-time"))
    for baseline in baselines.swarms.values():
        assert baseline.clock is None


def test_a_run_measures_the_seconds_that_its_ticks_take_without_those_of_its_hooks(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Each of 5 ticks takes 10 s: the clock is read before and after it, and goes on by 10 s a reading.

    The hook reads the clock, too, so that it takes 10 s as well.
    """
    read_clock = Mock(side_effect=itertools.count(start=1000.0, step=10.0))
    monkeypatch.setattr(run_module, "time", SimpleNamespace(monotonic=read_clock))

    def take_10_seconds(swarm: Swarm) -> None:
        read_clock()

    with Swarm(replace(MOVING_SWARM, steps=5), Wiring()) as swarm:
        run = run_swarm(swarm, [take_10_seconds])

    assert run.seconds == 5 * 10
