"""A terminal shows the truth about a running swarm, at any width, without colour, and in a pipe."""

from __future__ import annotations

import io
import os
import pty
import re
import subprocess
import sys
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from rich.cells import cell_len
from rich.console import Console

from mcp_asdf_tools.swarm.carrier import Wiring
from mcp_asdf_tools.swarm.live_view import LiveView, SwarmPicture, Watch
from mcp_asdf_tools.swarm.settings import SwarmSettings
from mcp_asdf_tools.swarm.swarm import MAX_SAMPLES, Companion, Swarm, SwarmRun, run_swarm
from mcp_asdf_tools.swarm.text_charts import TextMap, bar, sparkline
from support import slow

MOVING = SwarmSettings(
    topology="dynamic",
    filter="asdf-minus",
    flawed="50%",
    robots=8,
    steps=400,
    filter_period=50,
    density=4,
)
SCREENS = [(80, 24), (120, 40), (200, 60), (60, 20), (40, 12)]


def shown(settings: SwarmSettings, compare: bool = True, **options: Any) -> tuple[str, SwarmRun, Watch]:
    """All that a run writes on a console with these options."""
    out = io.StringIO()
    console = Console(file=out, **options)
    companion = Companion(settings) if compare else None
    with Swarm(settings, Wiring()) as swarm, LiveView(console, companion) as live:
        run = run_swarm(swarm, [live] if companion is None else [companion, live])
        watch = live._watch
    return out.getvalue(), run, watch


@cache
def finished(settings: SwarmSettings) -> SwarmPicture:
    """The last picture of a run, to be drawn on any screen."""
    watch, companion = Watch(), Companion(settings)
    with Swarm(settings, Wiring()) as swarm:
        run_swarm(swarm, [companion, watch])
    return SwarmPicture(swarm, watch, companion, 12.0)


def last_picture(settings: SwarmSettings, width: int, height: int, **options: Any) -> list[str]:
    out = io.StringIO()
    Console(file=out, width=width, height=height, force_terminal=True, **options).print(finished(settings))
    return out.getvalue().splitlines()


@pytest.mark.parametrize(("width", "height"), SCREENS)
@pytest.mark.parametrize("topology", ["dynamic", "fully-connected"])
def test_a_picture_uses_the_screen_that_it_has(width: int, height: int, topology: str) -> None:
    settings = (
        MOVING
        if topology == "dynamic"
        else SwarmSettings(steps=20, filter_period=20, robots=128, comms_period=10)
    )
    lines = last_picture(settings, width, height, color_system=None, legacy_windows=False)
    widths = [cell_len(line.rstrip()) for line in lines]
    assert max(widths) <= width
    assert max(widths) > 0.8 * width
    assert len(lines) <= max(height, 15)


def test_every_robot_is_on_the_map_where_it_is() -> None:
    lines = last_picture(MOVING, 120, 40, color_system=None)
    top = next(i for i, line in enumerate(lines) if line.startswith("╭"))
    end = next(i for i, line in enumerate(lines) if line.startswith("╰"))
    rows = [line[1 : line.index("│", 1)] for line in lines[top + 1 : end]]
    found = {
        (row, column) for row, text in enumerate(rows) for column, sign in enumerate(text) if sign in "●▲"
    }
    with Swarm(MOVING, Wiring()) as swarm:
        run_swarm(swarm)
        assert swarm.world.positions is not None
        x, y = swarm.world.positions.T / np.array(MOVING.sides)[:, np.newaxis]
    expected = {
        (int((0.5 - south) * len(rows)), int((east + 0.5) * len(rows[0])))
        for east, south in zip(x.tolist(), y.tolist(), strict=True)
    }
    assert found == expected


def test_its_figures_are_those_of_the_run() -> None:
    text, run, watch = shown(MOVING, width=120, height=40, force_terminal=True, color_system=None)
    picture = text[text.rindex("step 400 of 400") :]
    without = SwarmSettings(**{**vars(MOVING), "filter": "none"})
    with Swarm(without, Wiring()) as swarm:
        other = run_swarm(swarm)
    assert f"with filter {run.results['mean_error']:.4f}" in picture
    assert f"without     {other.results['mean_error']:.4f}" in picture
    for node in run.nodes[: MOVING.flawed]:
        assert re.search(rf" {node.id} {node.robot.b_hat:.3f} ━", picture)
    b_hat, ticks = run.history.values("b_hat"), run.history.ticks
    assert len(ticks) == 401 < MAX_SAMPLES
    changes = [
        (int(ticks[i]), robot, b_hat[i - 1, robot], b_hat[i, robot])
        for i, robot in np.add(np.argwhere(np.abs(np.diff(b_hat, axis=0)) > 0.002), (1, 0))
    ]
    assert [tuple(each) for each in watch.recalibrations] == changes
    assert changes
    tick, robot, before, after = changes[-1]
    assert f"{tick:6}  robot {robot}: {before:.2f} -> {after:.2f}" in picture


@pytest.mark.parametrize("options", [{"no_color": True}, {"color_system": None}])
def test_without_colour_wrong_robots_are_told_by_their_sign(options: dict[str, Any]) -> None:
    settings = replace(MOVING.without_filter(), steps=5)
    out = io.StringIO()
    with Swarm(settings, Wiring()) as swarm:
        run_swarm(swarm)
        console = Console(file=out, width=100, height=30, force_terminal=True, **options)
        console.print(SwarmPicture(swarm, Watch(), None, 1.0))
    assert not re.search(r"\x1b\[[0-9;]*3[0-7]", out.getvalue()), "no colour"
    assert out.getvalue().count("▲") == 4 + 1  # one more in the legend
    assert out.getvalue().count("●") == 4 + 1


def test_terminals_that_know_letters_only_get_letters() -> None:
    content = io.BytesIO()
    out = io.TextIOWrapper(content, encoding="ascii", write_through=True)
    console = Console(file=out, width=80, height=24, force_terminal=True, color_system=None)
    with Swarm(MOVING, Wiring()) as swarm, LiveView(console, companion := Companion(MOVING)) as live:
        run_swarm(swarm, [companion, live])
    assert b"with filter" in content.getvalue()


def test_a_pipe_gets_lines_of_fields() -> None:
    text, run, watch = shown(MOVING)
    rows = [line.split("\t") for line in text.splitlines()]
    steps = [row for row in rows if row[0] == "step"]
    assert [row[1] for row in steps] == [str(20 * i) for i in range(1, 21)]
    assert {(row[2], row[4]) for row in steps} == {("mean_error", "without_filter")}
    assert steps[-1][3] == f"{run.results['mean_error']:.5f}"
    events = [row for row in rows if row[0] == "robot"]
    assert len(events) == len(watch.recalibrations) == len(rows) - len(steps)
    assert events[0][2::2] == ["step", "b_hat", events[0][6]]
    assert "\x1b" not in text


def test_a_quiet_console_stays_empty() -> None:
    text, _, _ = shown(replace(MOVING, steps=20), quiet=True, force_terminal=True)
    assert text == ""


def test_a_companion_is_the_swarm_without_the_filter() -> None:
    companion = Companion(MOVING)
    with Swarm(MOVING, Wiring()) as swarm:
        run_swarm(swarm, [companion])
    with Swarm(MOVING.without_filter(), Wiring()) as swarm:
        assert run_swarm(swarm).results == companion.results()
    assert companion.seconds > 0


@pytest.mark.parametrize(("columns", "is_plain"), [(80, False), *slow([(80, True), (132, False)])])
def test_in_a_terminal_the_command_shows_pictures_then_results(columns: int, is_plain: bool) -> None:
    """A pseudo-terminal, on which nothing is wrapped by the terminal itself."""
    words = "swarm --topology dynamic --filter asdf-minus --flawed 50% --robots 6 --steps 200 --compare"
    environment = {**os.environ, "TERM": "xterm-256color", "COLUMNS": str(columns), "LINES": "30"}
    environment |= {"NO_COLOR": "1"} if is_plain else {}
    main_end, end = pty.openpty()
    with subprocess.Popen(
        [sys.executable, "-m", "mcp_asdf_tools.cli.main", *words.split()],
        stdout=end,
        stderr=end,
        env=environment,
    ) as command:
        os.close(end)
        text = b""
        while True:
            try:
                text += os.read(main_end, 1 << 16)
            except OSError:  # the other end is closed
                break
    os.close(main_end)
    assert command.returncode == 0
    moved = re.sub(r"\x1b\[\d*A", "\n", text.decode())  # a picture begins where the one before it did
    plain = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", moved).replace("\r", "")
    lines = plain.splitlines()
    assert max(cell_len(line) for line in lines if not line.startswith("again: ")) <= columns
    assert "With the filter the mean error is " in " ".join(lines[-4:])
    assert "step 200 of 200" in plain and "knows its sensor" in plain
    colours = re.findall(r"\x1b\[[0-9;]*(?:3[0-7]|38;5;\d+)m", text.decode())
    assert bool(colours) != is_plain


def test_text_charts() -> None:
    assert sparkline([0, 1, 2, 4, 8], 5, 8, False) == " ▁▂▄█"
    assert sparkline([0, 1, 2, 4, 8], 5, 8, True) == " .:=#"
    assert sparkline([1, 3, 5, 7], 2, 8, False) == "▂▆"
    assert sparkline([9.0], 40, 8, False) == "█"
    assert sparkline([], 5, 8, False) == sparkline([1], 0, 8, False) == ""
    assert sparkline([0, 0], 2, 0, False) == "  "
    assert bar(0.5, 1, 11, "", False).plain == "━━━━━━────│"
    assert bar(1, 0, 5, "", True).plain == "|===="
    drawn = TextMap(5, 3, (1.0, 1.0))
    drawn.put(np.array([-0.5, 0.5]), "a", "")
    drawn.put(np.array([0.5, -0.5]), "b", "")
    drawn.connect(np.array([-0.4, 0.0]), np.array([0.4, 0.0]), ".", "")
    assert drawn.text().plain == "a    \n ... \n    b"
