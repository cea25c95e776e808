"""Logs from somebody else: each is shown or refused in a line, and opens no other file."""

from __future__ import annotations

import gzip
import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import can
import pytest

from events_files import lines_of
from mcp_asdf_tools.cli.main import main
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.recording.events import events_path
from mcp_asdf_tools.robots.population import Population
from mcp_asdf_tools.view.run_histories import recompute_swarm_history

pytestmark = pytest.mark.usefixtures("private_setup")

Header = dict[str, Any]


@pytest.fixture(scope="module")
def recorded_log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The log of a swarm of 20 robots, all of whose parameters but the length are the defaults."""
    path = tmp_path_factory.mktemp("recorded") / "run.log"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(can, "rc", {})  # no bus that the user has configured
        assert main(["swarm", "--steps", "5", "--quiet", "--log", str(path)]) == 0
    return path


@pytest.fixture
def log(recorded_log: Path, tmp_path: Path) -> Path:
    """A copy of the log and its events, which a test may change."""
    path = tmp_path / "run.log"
    shutil.copy(recorded_log, path)
    shutil.copy(events_path(recorded_log), events_path(path))
    return path


def change_header(log: Path, change: Callable[[Header], object]) -> None:
    """Change the first line of a log's events."""
    events = events_path(log)
    first_line, *lines = lines_of(events)
    header = json.loads(first_line)
    change(header)
    with gzip.open(events, "wt") as file:
        file.write("".join([json.dumps(header) + "\n", *lines]))


def set_parameters(**values: Any) -> Callable[[Header], object]:
    """Return a function that sets parameters in a header."""
    return lambda header: header["parameters"].update(values)


def set_entries(**values: Any) -> Callable[[Header], object]:
    """Return a function that sets entries of a header."""
    return lambda header: header.update(values)


def remove_entry(name: str) -> Callable[[Header], object]:
    """Return a function that removes an entry of a header."""
    return lambda header: header.pop(name)


OPTIONAL_PARAMETERS = {*Population().parameters(), "allow", "faults"} - {"flawed"}


def remove_optional_parameters(header: Header) -> None:
    """Remove all parameters but the number of flawed robots."""
    for name in OPTIONAL_PARAMETERS:
        del header["parameters"][name]


def test_a_log_without_optional_parameters_is_viewed_with_their_defaults(log: Path) -> None:
    """An earlier version may have written it. All parameters of this log but its five steps are defaults.

    The title names parameters: "20 robots, 10 flawed, ...".
    """
    title_with_all_parameters = recompute_swarm_history(log).description.title
    change_header(log, remove_optional_parameters)
    title_with_defaults = recompute_swarm_history(log).description.title
    assert title_with_defaults == title_with_all_parameters


def remove_optional_settings_of_robots(header: Header) -> None:
    for robot in header["robots"]:
        for name in ("comms_period", "filter_period", "memory", "firmware"):
            del robot[name]


def test_a_log_whose_robots_lack_optional_settings_is_replayed_with_defaults(log: Path) -> None:
    """The settings are periods, memory and firmware.

    A replay with other settings would not come out equal, and the exit code would not be 0.
    """
    change_header(log, remove_optional_settings_of_robots)
    assert main(["replay", str(log)]) == 0


@pytest.mark.parametrize("name", ["frames", "parameters", "seed", "versions"])
def test_a_log_whose_first_line_lacks_an_optional_entry_is_replayed(name: str, log: Path) -> None:
    """The first line of a log's events is a JSON object; only the entries on its robots are needed.

    The exit code 0 says that replay has reproduced all broadcasts.
    """
    change_header(log, remove_entry(name))
    assert main(["replay", str(log)]) == 0


def test_a_log_of_a_single_robot_cannot_be_viewed_as_one_of_a_swarm(log: Path) -> None:
    """``mcp-asdf node``, which runs one robot, writes the parameters steps_per_second and steps alone."""
    change_header(log, set_entries(parameters={"steps_per_second": 10, "steps": 5}))
    with pytest.raises(UsageError, match="is not the log of a swarm; give one of mcp-asdf swarm"):
        recompute_swarm_history(log)


def test_a_log_that_names_a_file_as_its_graph_is_refused_and_the_file_is_not_opened(
    log: Path, tmp_path: Path
) -> None:
    """Somebody else's log must not make the user's files be read.

    This file is a pipe into which nobody writes: opening it would wait for ever.
    """
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    change_header(log, set_parameters(topology="graph", graph=str(pipe)))
    with pytest.raises(UsageError, match="has to hold the edges themselves"):
        recompute_swarm_history(log)


@pytest.mark.parametrize(
    ("change_of_header", "expected_message"),
    [
        (set_parameters(robots=8), "it is of 8 robots, but lists 20, 0-19; the ids must be"),
        (lambda header: header["robots"].pop(), "it is of 20 robots, but lists 19, 0-18"),
        (lambda header: header["robots"].clear(), "it is of 20 robots, but lists 0, none"),
        (lambda header: header["robots"].append(header["robots"][0]), "two robots have the same id"),
        (set_entries(parameters=[]), r"parameters is \[\]; it must be an object"),
        (set_entries(robots=[7]), "a robot is 7; give its settings"),
        (set_parameters(steps=4), "the run goes on after the 4 steps of the first line"),
        (set_parameters(steps=[]), r"damaged: steps is \[\]; give a number"),
        (set_parameters(faults=3), "faults is 3; give several in a list"),
        (set_parameters(faults=[[]]), r"damaged: .*\[\]"),
        (set_parameters(allow=5), "allow is 5; give a text"),
    ],
)
def test_a_log_whose_first_line_has_an_impossible_entry_is_refused_with_the_entry(
    change_of_header: Callable[[Header], object], expected_message: str, log: Path
) -> None:
    """The first line of a log's events is changed, by a function, before the log is viewed.

    For example, the number of robots is set to 8 where 20 are listed: "it is of 8 robots, but lists 20".
    """
    change_header(log, change_of_header)
    with pytest.raises(UsageError, match=expected_message):
        recompute_swarm_history(log)


def test_a_log_that_claims_a_billion_steps_is_viewed_as_far_as_it_goes(log: Path) -> None:
    """It has five steps, and of a billion only every 100,000th would be shown. So the start, 0, is shown.

    The chart lacks the errors of the same robots without a filter: to compute them would take hours.
    """
    change_header(log, set_parameters(steps=10**9))
    history = recompute_swarm_history(log)
    shown_steps = [state.tick for state in history.states_since().states]
    assert shown_steps == [0]
    assert len(history.description.unfiltered_errors) == 0
