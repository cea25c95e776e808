"""The extensions of docs/platforms/extending.md work as an installed package, in worker processes too."""

from __future__ import annotations

import json
import re
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, cast

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
from support import ROOT, block_with, blocks, run
from trials import images_by_message

PAGE = ROOT / "docs/platforms/extending.md"
PAGE_OF_FILTER = ROOT / "docs/experiments.md"


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """Return a folder with the page's package, as ``pip install`` leaves it, and the page's grid.toml.

    The first line of each Python block on the page is a comment with the path of its module. The firmware is
    that of the page about experiments.
    """
    for code in blocks(PAGE, "python"):
        first_line, _ = code.split("\n", 1)
        path = tmp_path / first_line.removeprefix("# ")
        path.parent.mkdir(exist_ok=True)
        path.write_text(code, encoding="utf-8")
    firmware = block_with(PAGE_OF_FILTER, "class BetaRobot", "python")
    (tmp_path / "my_swarm/beta.py").write_text(firmware, encoding="utf-8")
    pyproject, grid = blocks(PAGE, "toml")
    (tmp_path / "grid.toml").write_text(grid)
    write_package_information(tmp_path, tomllib.loads(pyproject)["project"])
    return tmp_path


def write_package_information(folder: Path, project: dict[str, Any]) -> None:
    """Write the folder by which Python knows a package as installed, with its entry points."""
    name, version = project["name"], project["version"]
    information = folder / f"my_swarm-{version}.dist-info"
    information.mkdir()
    (information / "METADATA").write_text(f"Name: {name}\nVersion: {version}\n")
    lines = []
    for group, entry_points in project["entry-points"].items():
        lines.append(f"[{group}]")
        lines += [f"{entry_point} = {target}" for entry_point, target in entry_points.items()]
    (information / "entry_points.txt").write_text("\n".join(lines))


@pytest.fixture
def installed(package: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Let this process find the page's package as an installed one."""
    monkeypatch.syspath_prepend(str(package))
    extensions._entry_points.cache_clear()
    yield
    extensions._entry_points.cache_clear()
    for name in list(sys.modules):
        if name.split(".")[0] == "my_swarm":
            del sys.modules[name]


@pytest.mark.usefixtures("installed")
def test_a_name_that_two_packages_offer_is_refused(package: Path) -> None:
    their_information = package / "their_swarm-1.0.dist-info"
    their_information.mkdir()
    (their_information / "METADATA").write_text("Name: their-swarm\nVersion: 1.0\n")
    (their_information / "entry_points.txt").write_text(
        "[mcp_asdf.firmwares]\nbeta = their_swarm:Robot\n"  # the page's package offers a firmware beta, too
    )
    message = "'beta' is offered by .*swarm .* and .*swarm .*; uninstall all but"

    with pytest.raises(UsageError, match=message):
        extensions.load(extensions.FIRMWARES, "beta")


# --- The commands of the page ----------------------------------------------------------------------------


def command_lines_of_page() -> list[str]:
    """Return the four commands of the page, which stand in one block; each has a test below."""
    scripts = blocks(PAGE, "sh")
    assert len(scripts) == 1
    lines = scripts[0].splitlines()
    assert len(lines) == 4
    return lines


def run_in_package(command_line: str, package: Path) -> Any:
    """Run a command of the page where it finds the page's package, and return the JSON that it prints."""
    output = run(*command_line.split(), "--json", cwd=package, PYTHONPATH=str(package))
    return json.loads(output)


@pytest.mark.slow
def test_the_commands_of_the_page_print_what_it_shows(package: Path) -> None:
    [commands], [shown] = blocks(PAGE, "sh"), blocks(PAGE, "text")
    printed = run("sh", "-ec", commands, cwd=package, PYTHONPATH=str(package))
    pattern = re.escape(shown).replace(re.escape("..."), ".*?")
    assert re.fullmatch(pattern, printed, re.DOTALL), printed


@pytest.mark.slow
def test_the_page_simulates_its_firmware(package: Path) -> None:
    line = command_lines_of_page()[0]
    assert line.startswith("mcp-asdf simulate ")
    assert run_in_package(line, package)["parameters"]["firmware"] == "beta"


@pytest.mark.slow
def test_the_page_simulates_its_topology_and_sensor(package: Path) -> None:
    line = command_lines_of_page()[1]
    assert line.startswith("mcp-asdf simulate ")
    parameters = run_in_package(line, package)["parameters"]

    assert parameters["topology"] == "geometric"
    assert parameters["sensor"] == "wandering"


@pytest.mark.slow
def test_the_page_runs_a_swarm_to_its_end(package: Path) -> None:
    line = command_lines_of_page()[2]
    assert line.startswith("mcp-asdf swarm ")
    assert run_in_package(line, package)["results"]["steps"] == 200


@pytest.mark.slow
def test_the_page_sweeps_all_eight_combinations_of_its_extensions_with_workers(package: Path) -> None:
    line = command_lines_of_page()[3]
    assert line.startswith("mcp-asdf sweep ")
    assert "--workers 2" in line
    experiments = run_in_package(line, package)["experiments"]
    extension_points = ("firmware", "topology", "sensor")
    combinations = {
        tuple(experiment["parameters"][point] for point in extension_points) for experiment in experiments
    }
    median_scores = {experiment["H"]["median"] for experiment in experiments}

    assert len(combinations) == 8
    assert len(median_scores) == 8, "each extension makes a difference"


# --- In this process -------------------------------------------------------------------------------------


def changes_of_wandering_accuracies(robots: int, steps: int) -> Any:
    """Return how much accuracies on black tiles change: an array of shape (steps - 1, robots)."""
    settings = WorldSettings(robots=robots, true_accuracy=0.75, seed=3, sensor="wandering")
    accuracy_on_black, _accuracy_on_white = make_sensor_model(settings, 0).advance(steps)
    return np.diff(accuracy_on_black, axis=0)


@pytest.mark.usefixtures("installed")
def test_a_swarm_with_extensions_ends_in_the_same_bits_as_the_same_simulated_experiment() -> None:
    parameters: dict[str, Any] = {
        "robots": 6,
        "steps": 300,
        "filter_period": 50,
        "seed": 3,
        "firmware": "mirror",
        "topology": "geometric",
        "sensor": "wandering",
    }
    with Swarm(SwarmSettings(**parameters), Wiring()) as swarm:
        for _ in range(300):
            swarm.tick()
        robots = [cast(MirrorRobot, node.robot) for node in swarm.nodes]
    images = [robot.save() for robot in robots]

    assert images == images_by_message(Experiment(**parameters, trials=1), 0)


@pytest.mark.usefixtures("installed")
def test_accuracies_of_the_page_s_sensors_walk_at_random_in_steps_of_a_thousandth() -> None:
    """The page docs/platforms/extending.md shows how to write sensors, which it calls "wandering".

    In each step every accuracy changes by a random number with a standard deviation of 0.001.
    """
    changes_by_step_and_robot = changes_of_wandering_accuracies(robots=100, steps=400)
    assert changes_by_step_and_robot.std() == pytest.approx(0.001, rel=0.02)


@pytest.mark.usefixtures("installed")
def test_accuracies_of_the_page_s_sensors_walk_independently_of_each_other() -> None:
    """The steps of two robots are not correlated."""
    changes_by_step_and_robot = changes_of_wandering_accuracies(robots=100, steps=400)
    first_robot, second_robot = changes_by_step_and_robot[:, 0], changes_by_step_and_robot[:, 1]
    matrix = np.corrcoef(first_robot, second_robot)
    correlation = matrix[0, 1]

    assert abs(correlation) < 0.2


@pytest.mark.usefixtures("installed")
def test_the_page_s_sensors_are_the_same_however_many_steps_are_taken_at_once() -> None:
    """100 steps at once, and 1, 7 and 92 steps of sensors with the same seed."""
    settings = WorldSettings(robots=6, seed=3, sensor="wandering")
    accuracies_at_once, _accuracies_on_white = make_sensor_model(settings, 0).advance(100)
    sensors = make_sensor_model(settings, 0)
    accuracies_of_parts = []
    for steps in (1, 7, 92):
        accuracy_on_black, _ = sensors.advance(steps)
        accuracies_of_parts.append(accuracy_on_black)

    assert np.array_equal(np.concatenate(accuracies_of_parts), accuracies_at_once)
