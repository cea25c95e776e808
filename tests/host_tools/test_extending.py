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
    information = folder / f"{name.replace('-', '_')}-{version}.dist-info"
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
def test_a_firmware_whose_name_two_installed_packages_offer_is_refused(package: Path) -> None:
    """The documentation's package my-swarm, which is installed here, offers a firmware "beta", too."""
    project: Any = {
        "name": "their-swarm",
        "version": "1.0",
        "entry-points": {"mcp_asdf.firmwares": {"beta": "their_swarm:Robot"}},
    }
    write_package_information(package, project)
    message = "'beta' is offered by .*swarm .* and .*swarm .*; uninstall all but"

    with pytest.raises(UsageError, match=message):
        extensions.load(extensions.FIRMWARES, "beta")


# --- The commands of the page ----------------------------------------------------------------------------


def run_in_package(command_line: str, package: Path) -> Any:
    """Run a command of the page where it finds the page's package, and return the JSON that it prints."""
    output = run(*command_line.split(), "--json", cwd=package, PYTHONPATH=str(package))
    return json.loads(output)


@pytest.mark.slow
def test_the_commands_of_the_documentation_of_extensions_print_what_it_shows(package: Path) -> None:
    """The documentation shows all commands in one block and their output in another, with "..." for gaps."""
    [commands], [shown_output] = blocks(PAGE, "sh"), blocks(PAGE, "text")
    printed_output = run("sh", "-ec", commands, cwd=package, PYTHONPATH=str(package))
    pattern = re.escape(shown_output).replace(re.escape("..."), ".*?")
    assert re.fullmatch(pattern, printed_output, re.DOTALL), printed_output


@pytest.mark.slow
def test_the_documented_swarm_has_the_firmware_topology_and_sensor_of_the_documented_package(
    package: Path,
) -> None:
    """Its command names all three by options, as the two before it do that simulate trials."""
    [commands] = blocks(PAGE, "sh")
    _simulate_firmware, _simulate_topology_and_sensor, swarm, _sweep = commands.splitlines()
    report = run_in_package(swarm, package)

    assert report["parameters"]["firmware"] == "beta"
    assert report["parameters"]["topology"] == "geometric"
    assert report["parameters"]["sensor"] == "wandering"
    assert report["results"]["steps"] == 200


@pytest.mark.slow
def test_the_documented_sweep_has_eight_experiments_with_all_combinations_of_the_extensions(
    package: Path,
) -> None:
    """Each extension makes a difference: the median scores, called H, of the eight experiments differ."""
    [commands] = blocks(PAGE, "sh")
    *_other_commands, sweep = commands.splitlines()
    assert "--workers 2" in sweep
    combinations, median_scores = set(), set()
    for experiment in run_in_package(sweep, package)["experiments"]:
        parameters = experiment["parameters"]
        combinations.add((parameters["firmware"], parameters["topology"], parameters["sensor"]))
        median_scores.add(experiment["H"]["median"])

    assert len(combinations) == 8
    assert len(median_scores) == 8


# --- In this process -------------------------------------------------------------------------------------


@pytest.mark.usefixtures("installed")
def test_robots_with_an_installed_topology_and_sensor_end_in_the_same_state_on_a_bus_as_simulated() -> None:
    """The documentation shows how to write the topology "geometric" and the sensor "wandering".

    Robots are compared by their images, in which the firmware saves its state.
    """
    extensions_of_page: Any = {"topology": "geometric", "sensor": "wandering"}
    parameters: Any = {"robots": 6, "steps": 100, "filter_period": 50, "firmware": "mirror"}
    with Swarm(SwarmSettings(**parameters, **extensions_of_page), Wiring()) as swarm:
        for _ in range(100):
            swarm.tick()
        images_on_bus = [cast(MirrorRobot, node.robot).save() for node in swarm.nodes]
    experiment = Experiment(**parameters, **extensions_of_page, trials=1)

    assert images_on_bus == images_by_message(experiment, trial=0)


@pytest.mark.usefixtures("installed")
def test_accuracies_of_wandering_sensors_change_at_random_by_a_thousandth_in_each_step() -> None:
    """The documentation shows how to write these sensors.

    In each step every accuracy changes by a random number with a standard deviation of 0.001. The changes of
    two robots are not correlated.
    """
    settings = WorldSettings(robots=100, true_accuracy=0.75, seed=3, sensor="wandering")
    accuracy_on_black, _accuracy_on_white = make_sensor_model(settings, trial=0).advance(400)
    changes = np.diff(accuracy_on_black, axis=0)  # by step and robot
    first_robot, second_robot, *_ = changes.T

    assert changes.std() == pytest.approx(0.001, rel=0.02)
    # The correlation of 399 independent pairs has a standard deviation of 0.05.
    assert abs(np.corrcoef(first_robot, second_robot)[0, 1]) < 0.2


@pytest.mark.usefixtures("installed")
def test_wandering_sensors_have_the_same_accuracies_whether_100_steps_are_taken_at_once_or_in_parts() -> None:
    """The documentation shows how to write these sensors. Here they take 100 steps, or 1, 7 and 92."""
    settings = WorldSettings(robots=6, seed=3, sensor="wandering")
    accuracies_at_once, _accuracies_on_white = make_sensor_model(settings, trial=0).advance(100)
    sensors = make_sensor_model(settings, trial=0)
    accuracies_of_parts = []
    for steps in (1, 7, 92):
        accuracies_on_black, _accuracies_on_white = sensors.advance(steps)
        accuracies_of_parts.append(accuracies_on_black)

    assert np.array_equal(np.concatenate(accuracies_of_parts), accuracies_at_once)
