"""A running swarm is shown as it is: by a bar on a terminal, by lines of fields in a pipe."""

from __future__ import annotations

import io
import re
import time
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
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


def shown(steps: int, compare: bool, **options: Any) -> tuple[str, list[str], NDArray[np.float64]]:
    """All that a run writes on a console, the mean errors and b_hat after each tick, and at the start."""
    settings, out = replace(MOVING, steps=steps), io.StringIO()
    baselines = Baselines(settings) if compare else None
    errors, b_hat, began = [""], list[list[float]](), time.monotonic()

    def note(swarm: Swarm) -> None:
        found = [mean_error(each) for each in (swarm, *(baselines.swarms.values() if baselines else ()))]
        errors.append("\t".join(f"{each:.5f}" for each in found))
        b_hat.append([node.robot.b_hat for node in swarm.nodes])

    with Swarm(settings, Wiring()) as swarm, LiveView(Console(file=out, **options), baselines) as live:
        b_hat.append(swarm.b_hat_at_start)
        run_swarm(swarm, [*([baselines] if baselines else []), note, live])
    assert baselines is None or 0 < baselines.seconds < time.monotonic() - began
    return out.getvalue(), errors, np.array(b_hat)


@pytest.mark.parametrize("compare", [False, True])
def test_a_pipe_gets_lines_of_fields(compare: bool) -> None:
    text, errors, b_hat = shown(390, compare)
    rows, names = text.splitlines(), ["step", "mean_error", *(["none", "robust"] if compare else [])]
    assert [row for row in rows if row.startswith("step")] == [
        "\t".join(
            f"{name}\t{value}" for name, value in zip(names, (tick, *errors[tick].split()), strict=True)
        )
        for tick in range(20, 390, 20)
    ]
    changes = [
        f"robot\t{robot}\tstep\t{i + 1}\tb_hat\t{b_hat[i, robot]:.4f}\t{b_hat[i + 1, robot]:.4f}"
        for i, robot in np.argwhere(np.abs(np.diff(b_hat, axis=0)) > 0.002)
    ]
    assert [row for row in rows if row.startswith("robot")] == changes
    assert changes and len(rows) == 19 + len(changes)


@pytest.mark.parametrize(("width", "compare"), [(60, True), (80, False), (200, True)])
def test_a_terminal_gets_a_bar_with_the_present_error(width: int, compare: bool) -> None:
    text, errors, _ = shown(200, compare, width=width, force_terminal=True, color_system=None)
    pictures = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "\n", text).replace("\r", "\n").splitlines()
    assert max(map(cell_len, pictures)) <= width
    drawn = [each for each in pictures if each.strip()]
    assert drawn[0].startswith("1/200 ") and len(drawn) < 200, (
        "drawn from the first step on, and now and then"
    )
    last = drawn[-1]
    assert last.startswith("200/200 ") and last.count("━") == (0 if width == 60 else 10)
    told = re.findall(r"\d\.\d{4}", last)
    expected = [f"{float(each):.4f}" for each in errors[-1].split()]
    assert told[:1] == expected[:1] and (width == 60 or told == expected)
    assert "mean error" in last and (", no filter" in last) == compare


@pytest.mark.parametrize("is_terminal", [False, True])
def test_a_quiet_console_stays_empty(is_terminal: bool) -> None:
    assert shown(20, True, quiet=True, force_terminal=is_terminal)[0] == ""


def test_the_other_swarms_keep_step_and_have_no_clock() -> None:
    swarms = Baselines(replace(MOVING, clock="real-time")).swarms
    assert [*swarms] == ["none", "robust"] and all(each.clock is None for each in swarms.values())
