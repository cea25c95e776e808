"""``import mcp_asdf_tools``: what it offers is small, loads late and agrees with the rooms behind it."""

from __future__ import annotations

import sys
from pathlib import Path

import can
import pytest
from matplotlib.figure import Figure

import mcp_asdf_tools as m
from mcp_asdf.robot import FixedPointRobot
from mcp_asdf_tools.experiments.results import table_of
from mcp_asdf_tools.experiments.trials import run_trials
from mcp_asdf_tools.swarm.swarm import Swarm
from support import ROOT, run

SHORT = m.Experiment(robots=4, steps=120, filter_period=20, trials=3, flawed=1)
SETTINGS = m.SwarmSettings(robots=4, steps=60, filter_period=20, flawed=1, faults=("loss=0.2",))


def test_the_page_has_every_name() -> None:
    page = (ROOT / "docs/library.md").read_text(encoding="utf-8")
    for name in m.__all__:
        assert f"m.{name}" in page or f"`{name}`" in page, name
        assert getattr(m, name).__doc__


def test_importing_loads_no_plotting_and_no_tables() -> None:
    check = "assert not {'matplotlib', 'pyarrow'} & {*sys.modules}"
    run(sys.executable, "-c", f"import sys, mcp_asdf_tools as m; m.Experiment; {check}")


def test_an_experiment_gives_the_table_of_its_trials_and_the_same_call_resumes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    expected, output = table_of(run_trials(SHORT, 0, 3)), tmp_path / "grid.parquet"
    assert m.simulate(SHORT).equals(expected)
    assert m.simulate([SHORT], output, workers=2).equals(expected)
    assert m.score(m.read_table(output)).equals(expected)
    assert isinstance(m.plot(m.read_table(output)), Figure)
    monkeypatch.setattr("mcp_asdf_tools.experiments.sweep.jobs_of", lambda store, interval: iter([]))
    assert m.simulate(SHORT, str(output)).equals(expected), "nothing was left to run"
    with pytest.raises(m.UsageError, match="results of other experiments"):
        m.simulate(m.grid(robots=3, steps=50, trials=1), output)


def images(swarm: Swarm) -> list[bytes]:
    robots = [node.robot for node in swarm.nodes]
    return [robot.save() for robot in robots if isinstance(robot, FixedPointRobot)]


def test_a_swarm_on_a_channel_is_heard_and_ends_in_the_same_bits() -> None:
    with m.start_swarm(SETTINGS) as alone, m.start_swarm(SETTINGS, "library test") as heard:
        with can.Bus("library test", "virtual") as other:
            for _ in range(SETTINGS.steps):
                alone.tick()
                heard.tick()
            frame = other.recv(0)
            assert frame is not None and frame.timestamp < 1, "simulated time"
        assert images(alone) == images(heard)
        assert len(images(alone)) == 4
        whole = m.emulate(SETTINGS)
        assert [each["x"] for each in whole.results["robots"]] == [node.robot.x for node in alone.nodes]
