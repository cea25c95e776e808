"""The view of a running swarm: a bar on a terminal, and lines with fields in a pipe."""

from __future__ import annotations

import io
import re
from dataclasses import dataclass, field, replace
from typing import Any

import pytest
from rich.cells import cell_len
from rich.console import Console

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
    """Run a swarm on a console, with or without baselines beside it."""
    settings, console_file, viewed_run = replace(MOVING, steps=steps), io.StringIO(), ViewedRun()
    baselines = Baselines(settings) if compare else None
    console = Console(file=console_file, **console_options)

    def record(swarm: Swarm) -> None:
        swarms = [swarm, *(baselines.swarms.values() if baselines else ())]
        viewed_run.mean_errors[swarm.ticks] = [mean_error(each_swarm) for each_swarm in swarms]
        viewed_run.b_hat.append([node.robot.b_hat for node in swarm.nodes])

    with Swarm(settings, Wiring()) as swarm, LiveView(console, baselines) as view:
        viewed_run.b_hat.append(swarm.b_hat_at_start)
        run_swarm(swarm, [*([baselines] if baselines else []), record, view])
    viewed_run.output = console_file.getvalue()
    return viewed_run


def test_a_pipe_gets_the_mean_error_twenty_times_in_a_run() -> None:
    viewed_run = view_run(390, compare=False)
    lines = [line for line in viewed_run.output.splitlines() if line.startswith("step")]
    assert lines == [
        f"step\t{tick}\tmean_error\t{viewed_run.mean_errors[tick][0]:.5f}" for tick in range(20, 390, 20)
    ]


def test_a_pipe_gets_the_mean_errors_of_baselines_behind_that_of_the_swarm() -> None:
    viewed_run = view_run(20, compare=True)
    own_error, error_without_filter, error_with_robust_filter = viewed_run.mean_errors[20]
    assert viewed_run.output.splitlines()[-1] == (
        f"step\t20\tmean_error\t{own_error:.5f}\tnone\t{error_without_filter:.5f}"
        f"\trobust\t{error_with_robust_filter:.5f}"
    )


def test_a_pipe_gets_each_change_of_b_hat_that_is_more_than_a_correction() -> None:
    viewed_run = view_run(390, compare=False)
    expected_lines = []
    for tick in range(1, 391):
        for robot, (before, after) in enumerate(zip(*viewed_run.b_hat[tick - 1 : tick + 1], strict=True)):
            if abs(after - before) > 0.002:
                expected_lines.append(f"robot\t{robot}\tstep\t{tick}\tb_hat\t{before:.4f}\t{after:.4f}")
    assert expected_lines
    assert [line for line in viewed_run.output.splitlines() if line.startswith("robot")] == expected_lines


def pictures(output: str) -> list[str]:
    """Return the pictures of the bar that were drawn one over the other."""
    lines = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "\n", output).replace("\r", "\n").splitlines()
    return [line for line in lines if line.strip()]


TERMINAL: dict[str, Any] = {"force_terminal": True, "color_system": None}


def test_a_terminal_gets_a_bar_that_is_drawn_now_and_then_from_the_first_step_to_the_last() -> None:
    drawn = pictures(view_run(200, compare=False, width=80, **TERMINAL).output)
    assert drawn[0].startswith("1/200 ")
    assert drawn[-1].startswith("200/200 ")
    assert drawn[-1].count("━") == 10
    assert len(drawn) < 200


def test_a_bar_has_the_present_mean_error_beside_it() -> None:
    viewed_run = view_run(200, compare=False, width=80, **TERMINAL)
    assert f"mean error {viewed_run.mean_errors[200][0]:.4f}" in pictures(viewed_run.output)[-1]
    assert "no filter" not in viewed_run.output


def test_a_bar_has_the_mean_errors_of_baselines_beside_it() -> None:
    viewed_run = view_run(200, compare=True, width=200, **TERMINAL)
    own_error, error_without_filter, error_with_robust_filter = viewed_run.mean_errors[200]
    assert (
        f"mean error {own_error:.4f}, no filter {error_without_filter:.4f}, "
        f"robust {error_with_robust_filter:.4f}"
    ) in pictures(viewed_run.output)[-1]


def test_a_narrow_terminal_gets_as_much_as_fits_and_the_error_of_the_swarm_first() -> None:
    viewed_run = view_run(200, compare=True, width=60, **TERMINAL)
    drawn = pictures(viewed_run.output)
    assert max(map(cell_len, drawn)) <= 60
    assert f"mean error {viewed_run.mean_errors[200][0]:.4f}" in drawn[-1]


@pytest.mark.parametrize("is_terminal", [False, True])
def test_a_quiet_console_stays_empty(is_terminal: bool) -> None:
    assert view_run(20, compare=True, quiet=True, force_terminal=is_terminal).output == ""


def test_baselines_are_the_same_swarm_with_other_filters_in_lockstep() -> None:
    swarms = Baselines(replace(MOVING, clock="real-time")).swarms
    assert list(swarms) == ["none", "robust"]
    assert [swarm.clock for swarm in swarms.values()] == [None, None]


def test_baselines_measure_the_time_that_they_take() -> None:
    settings = replace(MOVING, steps=5)
    baselines = Baselines(settings)
    assert baselines.seconds == 0
    with Swarm(settings, Wiring()) as swarm:
        run_swarm(swarm, [baselines])
    assert 0 < baselines.seconds < 60
