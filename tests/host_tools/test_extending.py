"""The extensions of docs/extending.md work as an installed package, in worker processes too."""

from __future__ import annotations

import json
import shutil
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mcp_asdf.mirror import MirrorRobot
from mcp_asdf_tools.common import extensions
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.swarm.carrier import Wiring
from mcp_asdf_tools.swarm.settings import SwarmSettings
from mcp_asdf_tools.swarm.swarm import Swarm
from mcp_asdf_tools.world.sensors import make_sensor_model
from mcp_asdf_tools.world.settings import WorldSettings
from support import ROOT, blocks, run
from trials import images_by_message

PAGE = ROOT / "docs/extending.md"
SHORT: dict[str, Any] = {"robots": 6, "steps": 300, "filter_period": 50, "seed": 3}


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """A folder with the page's package, as ``pip install`` leaves it."""
    for code in blocks(PAGE, "python"):
        path = tmp_path / code.split("\n", 1)[0].removeprefix("# ")
        path.parent.mkdir(exist_ok=True)
        path.write_text(code, encoding="utf-8")
    project, grid = blocks(PAGE, "toml")
    settings = tomllib.loads(project)["project"]
    information = tmp_path / f"my_swarm-{settings['version']}.dist-info"
    information.mkdir()
    (information / "METADATA").write_text(f"Name: {settings['name']}\nVersion: {settings['version']}\n")
    lines = [
        line
        for group, points in settings["entry-points"].items()
        for line in (f"[{group}]", *(f"{name} = {value}" for name, value in points.items()))
    ]
    (information / "entry_points.txt").write_text("\n".join(lines))
    (tmp_path / "grid.toml").write_text(grid)
    return tmp_path


def test_a_name_that_two_packages_offer_is_refused(package: Path, installed: None) -> None:
    """Which of the two came first would be chance."""
    (ours,) = package.glob("*.dist-info")
    shutil.copytree(ours, package / "their_swarm-1.0.dist-info")
    (package / "their_swarm-1.0.dist-info/METADATA").write_text("Name: their-swarm\nVersion: 1.0\n")
    (name, *_) = extensions.installed_names(extensions.FIRMWARES)
    with pytest.raises(
        UsageError, match=f"'{name}' is offered by .*swarm .* and .*swarm .*; uninstall all but"
    ):
        extensions.load(extensions.FIRMWARES, name)


@pytest.fixture
def installed(package: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """The same, found by this process."""
    monkeypatch.syspath_prepend(str(package))
    extensions._entry_points.cache_clear()
    yield
    extensions._entry_points.cache_clear()
    for name in [name for name in sys.modules if name.split(".")[0] == "my_swarm"]:
        del sys.modules[name]


@pytest.mark.slow
def test_the_commands_of_the_page_find_the_extensions(package: Path) -> None:
    (script,) = blocks(PAGE, "sh")
    commands = script.splitlines()
    assert {command.split()[1] for command in commands} == {"simulate", "swarm", "sweep"}
    assert "--workers 2" in commands[-1]
    found = [
        json.loads(run(*command.split(), "--json", cwd=package, PYTHONPATH=str(package)))
        for command in commands
    ]
    assert found[0]["parameters"]["firmware"] == "beta"
    assert found[1]["parameters"]["topology"] == "geometric"
    assert found[1]["parameters"]["sensor"] == "wandering"
    assert found[2]["results"]["steps"] == 200
    chosen = {
        tuple(each["parameters"][name] for name in ("firmware", "topology", "sensor"))
        for each in found[3]["experiments"]
    }
    assert len(chosen) == len({each["H"]["median"] for each in found[3]["experiments"]}) == 8


@pytest.mark.usefixtures("installed")
def test_a_swarm_with_extensions_is_trial_0_to_the_bit() -> None:
    parameters = SHORT | {"firmware": "mirror", "topology": "geometric", "sensor": "wandering"}
    with Swarm(SwarmSettings(**parameters), Wiring()) as swarm:
        for _ in range(SHORT["steps"]):
            swarm.tick()
        robots = [node.robot for node in swarm.nodes]
    assert all(isinstance(robot, MirrorRobot) for robot in robots)
    images = [robot.save() for robot in robots if isinstance(robot, MirrorRobot)]
    assert images == images_by_message(Experiment(**parameters, trials=1), 0)


@pytest.mark.usefixtures("installed")
def test_the_page_s_sensors_do_random_walks() -> None:
    settings = WorldSettings(robots=100, true_accuracy=0.75, seed=3, sensor="wandering")
    accuracies, _ = make_sensor_model(settings, 0).advance(400)
    changes = np.diff(accuracies, axis=0)
    assert changes.std() == pytest.approx(0.001, rel=0.02)
    assert abs(np.corrcoef(changes[:, 0], changes[:, 1])[0, 1]) < 0.2


@pytest.mark.usefixtures("installed")
def test_the_page_s_sensors_are_the_same_however_many_steps_are_taken_at_once() -> None:
    settings = WorldSettings(robots=6, seed=3, sensor="wandering")
    whole, _ = make_sensor_model(settings, 0).advance(100)
    in_parts = make_sensor_model(settings, 0)
    parts = [in_parts.advance(steps)[0] for steps in (1, 7, 92)]
    assert np.array_equal(np.concatenate(parts), whole)
