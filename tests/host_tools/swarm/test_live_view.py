"""The view of a running swarm: a bar on a terminal, and lines with fields in a pipe.

Baselines are copies of the swarm with other filters, which run beside it for comparison.
"""

from __future__ import annotations

import io
import itertools
import re
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from types import SimpleNamespace
from typing import Any

import pytest
from rich.cells import cell_len
from rich.console import Console

from mcp_asdf_tools.swarm import run as run_module
from mcp_asdf_tools.swarm.carrier import Wiring
from mcp_asdf_tools.swarm.live_view import LiveView
from mcp_asdf_tools.swarm.run import Baselines, mean_error, run_swarm
from mcp_asdf_tools.swarm.settings import SwarmSettings
from mcp_asdf_tools.swarm.swarm import Swarm

MOVING = SwarmSettings(
    robots=8, flawed="50%", steps=400, filter="asdf-minus", filter_period=50, topology="dynamic", density=4
)


@dataclass
class ViewedRun:
    """What a run has shown, and what it did.

    Attributes:
        output: All that was written on the console.
        mean_errors: Mean error of the swarm, then of each baseline, after each tick; by tick, from 1.
        b_hat: Assumed accuracies of the robots, at the start and after each tick.
    """

    output: str = ""
    mean_errors: dict[int, list[float]] = field(default_factory=dict)
    b_hat: list[list[float]] = field(default_factory=list)


def view_run(steps: int, compare: bool, **console_options: Any) -> ViewedRun:
    """Run a swarm on a console, with baselines beside it if ``compare``, and return what was shown."""
    settings = replace(MOVING, steps=steps)
    baselines = Baselines(settings) if compare else None
    console_file = io.StringIO()
    console = Console(file=console_file, **console_options)
    viewed_run = ViewedRun()

    def record(swarm: Swarm) -> None:
        """Keep the present errors and accuracies; called after each tick."""
        mean_errors = [mean_error(swarm)]
        if baselines is not None:
            mean_errors += [mean_error(baseline) for baseline in baselines.swarms.values()]
        viewed_run.mean_errors[swarm.ticks] = mean_errors
        viewed_run.b_hat.append([node.robot.b_hat for node in swarm.nodes])

    with Swarm(settings, Wiring()) as swarm, LiveView(console, baselines) as view:
        viewed_run.b_hat.append(swarm.b_hat_at_start)
        callbacks: list[Callable[[Swarm], None]] = [record, view]
        if baselines is not None:
            callbacks.insert(0, baselines)  # first, so that the other two meet them after the same tick
        run_swarm(swarm, callbacks)
    viewed_run.output = console_file.getvalue()
    return viewed_run


def lines_that_begin_with(word: str, output: str) -> list[str]:
    """Return the lines of an output that begin with a word."""
    return [line for line in output.splitlines() if line.startswith(word)]


def test_a_pipe_gets_the_mean_error_twenty_times_in_a_run() -> None:
    viewed_run = view_run(400, compare=False)
    expected_lines = []
    for tick in range(20, 401, 20):  # 20, 40, ..., 400
        swarm_error = viewed_run.mean_errors[tick][0]
        expected_lines.append(f"step\t{tick}\tmean_error\t{swarm_error:.5f}")

    assert lines_that_begin_with("step", viewed_run.output) == expected_lines


def test_a_pipe_gets_no_mean_error_at_the_end_of_an_incomplete_twentieth() -> None:
    lines = lines_that_begin_with("step", view_run(390, compare=False).output)
    steps = [int(line.split("\t")[1]) for line in lines]
    assert steps == list(range(20, 390, 20))


def test_a_pipe_gets_the_mean_errors_of_baselines_behind_that_of_the_swarm() -> None:
    viewed_run = view_run(20, compare=True)
    swarm_error, error_without_filter, error_with_robust_filter = viewed_run.mean_errors[20]

    assert viewed_run.output.splitlines()[-1] == (
        f"step\t20\tmean_error\t{swarm_error:.5f}\tnone\t{error_without_filter:.5f}"
        f"\trobust\t{error_with_robust_filter:.5f}"
    )


def test_a_pipe_gets_each_change_of_b_hat_that_is_more_than_a_correction() -> None:
    """b_hat is the accuracy that a robot assumes of its sensor; changes below 0.002 are corrections."""
    viewed_run = view_run(390, compare=False)
    expected_lines = []
    for tick in range(1, 391):
        for robot in range(8):
            before, after = viewed_run.b_hat[tick - 1][robot], viewed_run.b_hat[tick][robot]
            if abs(after - before) > 0.002:
                expected_lines.append(f"robot\t{robot}\tstep\t{tick}\tb_hat\t{before:.4f}\t{after:.4f}")

    assert expected_lines, "some changes are large enough"
    assert lines_that_begin_with("robot", viewed_run.output) == expected_lines


def pictures(output: str) -> list[str]:
    """Return the pictures of the bar that were drawn one over the other, first to last.

    Between two pictures the cursor goes back, by escape sequences of the terminal or carriage returns.
    """
    separated = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "\n", output).replace("\r", "\n")
    return [line for line in separated.splitlines() if line.strip()]


TERMINAL: dict[str, Any] = {"force_terminal": True, "color_system": None}


def test_a_terminal_gets_a_bar_that_is_drawn_now_and_then_from_the_first_step_to_the_last() -> None:
    drawn = pictures(view_run(200, compare=False, width=80, **TERMINAL).output)
    assert drawn[0].startswith("1/200 ")
    assert drawn[-1].startswith("200/200 ")
    assert drawn[-1].count("━") == 10
    assert len(drawn) < 200


def test_a_bar_has_the_present_mean_error_beside_it() -> None:
    viewed_run = view_run(200, compare=False, width=80, **TERMINAL)
    swarm_error = viewed_run.mean_errors[200][0]
    assert f"mean error {swarm_error:.4f}" in pictures(viewed_run.output)[-1]
    assert "no filter" not in viewed_run.output


def test_a_bar_has_the_mean_errors_of_baselines_beside_it() -> None:
    viewed_run = view_run(200, compare=True, width=200, **TERMINAL)
    swarm_error, error_without_filter, error_with_robust_filter = viewed_run.mean_errors[200]

    assert (
        f"mean error {swarm_error:.4f}, no filter {error_without_filter:.4f}, "
        f"robust {error_with_robust_filter:.4f}"
    ) in pictures(viewed_run.output)[-1]


def test_a_narrow_terminal_gets_as_much_as_fits_and_the_error_of_the_swarm_first() -> None:
    viewed_run = view_run(200, compare=True, width=60, **TERMINAL)
    drawn = pictures(viewed_run.output)
    swarm_error = viewed_run.mean_errors[200][0]

    assert all(cell_len(picture) <= 60 for picture in drawn)
    assert f"mean error {swarm_error:.4f}" in drawn[-1]


@pytest.mark.parametrize("is_terminal", [False, True])
def test_a_quiet_console_stays_empty(is_terminal: bool) -> None:
    assert view_run(20, compare=True, quiet=True, force_terminal=is_terminal).output == ""


def test_baselines_are_the_same_swarm_with_other_filters_in_lockstep() -> None:
    swarms = Baselines(replace(MOVING, clock="real-time")).swarms
    assert list(swarms) == ["none", "robust"]
    assert [swarm.clock for swarm in swarms.values()] == [None, None]


def test_baselines_have_taken_no_time_before_the_run() -> None:
    assert Baselines(MOVING).seconds == 0


def test_baselines_measure_the_seconds_that_they_take_of_a_run(monkeypatch: pytest.MonkeyPatch) -> None:
    """The clock goes on by 10 s from one reading to the next, and each of 5 ticks is between two."""
    clock_readings = itertools.count(start=1000.0, step=10.0)
    monkeypatch.setattr(run_module, "time", SimpleNamespace(monotonic=lambda: next(clock_readings)))
    settings = replace(MOVING, steps=5)
    baselines = Baselines(settings)
    with Swarm(settings, Wiring()) as swarm:
        run_swarm(swarm, [baselines])

    assert baselines.seconds == 50
