"""The tools default to ASDF-, and each report names the filter of its robots."""

from __future__ import annotations

import argparse
import json
import os
import shlex
from collections.abc import Iterator
from pathlib import Path

import pytest

from mcp_asdf.robot import Config, Filter
from mcp_asdf_tools import Experiment, SwarmSettings, experiments_in, grid, plot_curve, simulate
from mcp_asdf_tools.cli.main import main
from mcp_asdf_tools.cli.radio import add_arguments as add_radio_arguments
from mcp_asdf_tools.cli.radio import settings_of
from mcp_asdf_tools.robots.filters import describe_filters
from mcp_asdf_tools.tables.thresholds import generate, parse_omega

SWARM = "--robots 4 --steps 20 --filter-period 10 --flawed 50%"
ASDF_MINUS = "ASDF-: only the flawed robots recalibrate"
TABLE = generate(parse_omega("0.05"), 4)
OFF, ADAPTIVE = Config(filter=Filter.OFF), Config(TABLE)
ALWAYS, ROBUST = Config(filter=Filter.ALWAYS), Config(filter=Filter.ROBUST)

pytestmark = pytest.mark.usefixtures("private_setup")


def printed_by(command: str, capsys: pytest.CaptureFixture[str]) -> str:
    """Run a command that succeeds, and return its standard output."""
    capsys.readouterr()
    assert main(shlex.split(command)) == 0
    return capsys.readouterr().out


@pytest.mark.parametrize("kind", [Experiment, SwarmSettings])
def test_by_default_only_the_flawed_robots_of_an_experiment_or_a_swarm_recalibrate(
    kind: type[Experiment | SwarmSettings],
) -> None:
    """Robot 0 is flawed: it has the paper's filter, Filter.ADAPTIVE, and the other three have none."""
    settings = kind(robots=4, flawed=1)
    filters = [settings.config(robot).filter for robot in range(4)]
    assert filters == [Filter.ADAPTIVE, Filter.OFF, Filter.OFF, Filter.OFF]


def test_without_flawed_robots_no_robot_changes_its_estimated_accuracy_by_default() -> None:
    """Each of four trials has 20 filter steps. Accuracies b_hat are compared with those at the start."""
    experiment = Experiment(robots=6, flawed=0, steps=2000, filter_period=100, trials=4)
    (trials,) = experiments_in(simulate(experiment))
    b_hat_at_start = trials.b_hat[:, :1]
    assert (trials.b_hat == b_hat_at_start).all()


@pytest.mark.parametrize(
    ("configs", "description"),
    [
        ([OFF, OFF], "no filter: no robot recalibrates"),
        ([ADAPTIVE, OFF], ASDF_MINUS),
        ([ADAPTIVE, ADAPTIVE], "ASDF+: all robots recalibrate"),
        ([ALWAYS, OFF], f"{ASDF_MINUS}, in every filter step without a test"),
        ([ADAPTIVE], "ASDF: the robot recalibrates, by the paper's filter"),
        ([ROBUST, ROBUST], "robust: all robots recalibrate, by this project's own filter"),
        ([ROBUST, OFF], "mixed: robots with the filters off, robust"),
    ],
)
def test_robots_are_described_by_the_filters_they_have(configs: list[Config], description: str) -> None:
    """Two robots that both have the filter OFF, for example, are "no filter: no robot recalibrates"."""
    assert describe_filters(config.filter for config in configs) == description


@pytest.fixture
def recordings(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Iterator[None]:
    """Work in a folder with run.log of a swarm with ASDF-, and results of two filters in grid.parquet.

    The standard input of ``mcp-asdf node --until-eof`` is empty, so that it stops at once.
    """
    monkeypatch.chdir(tmp_path)
    printed_by(f"swarm {SWARM} --quiet --log run.log", capsys)
    simulate(grid(robots=4, flawed=1, steps=20, trials=1, filter=["none", "asdf-minus"]), "grid.parquet")
    with Path(os.devnull).open("rb") as empty:
        monkeypatch.setattr("mcp_asdf_tools.cli.node.standard_input_descriptor", empty.fileno)
        yield


NO_FILTER = "no filter: no robot recalibrates"
RADIO = "radio --interface virtual --id 3 --robots 3 --steps 2 --steps-per-second 1000"


@pytest.mark.usefixtures("recordings")
@pytest.mark.parametrize("output", ["", "--json"])
@pytest.mark.parametrize(
    ("command", "descriptions"),
    [
        (f"swarm {SWARM}", [ASDF_MINUS]),
        (f"simulate --trials 2 {SWARM}", [ASDF_MINUS]),
        ("score grid.parquet", [NO_FILTER, ASDF_MINUS]),
        ("replay run.log", [ASDF_MINUS]),
        (
            "node --id 3 --filter robust --until-eof",
            ["robust: the robot recalibrates, by this"],
        ),
        (RADIO, [ASDF_MINUS]),
    ],
)
def test_a_command_describes_the_filters_of_its_robots_as_text_and_in_json(
    command: str, descriptions: list[str], output: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """``replay run.log``, for example, prints "ASDF-: only the flawed robots recalibrate"."""
    printed_text = printed_by(f"{command} {output}", capsys)
    for description in descriptions:
        assert description in printed_text


def test_swarm_with_quiet_prints_the_name_of_its_filter(capsys: pytest.CaptureFixture[str]) -> None:
    """With ``--quiet`` it prints one line, which begins with robots, filter and steps."""
    assert "4 robots, ASDF-, 20 steps" in printed_by(f"swarm {SWARM} --quiet", capsys)


def test_swarm_with_compare_and_json_reports_the_filter_of_each_compared_swarm(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """``--compare`` also runs the same robots without a filter and with the robust one."""
    report = json.loads(printed_by(f"swarm {SWARM} --compare --json", capsys))
    assert report["compared"]["none"]["filter"] == NO_FILTER
    assert report["compared"]["robust"]["filter"].startswith("robust: all robots")


@pytest.mark.parametrize(
    ("option", "filter_of_neighbours"), [("", Filter.OFF), ("--filter asdf-plus", Filter.ADAPTIVE)]
)
def test_the_neighbours_that_radio_emulates_filter_only_if_asdf_plus_is_chosen(
    option: str, filter_of_neighbours: Filter
) -> None:
    """``mcp-asdf radio`` emulates the neighbours of one controller, a real robot.

    The controller runs the paper's filter, Filter.ADAPTIVE, in any case. With ASDF-, which is the default, it
    is the only one; with ASDF+ all robots do.
    """
    parser = argparse.ArgumentParser()
    add_radio_arguments(parser)
    settings = settings_of(parser.parse_args(f"--id 3 --robots 4 {option}".split()))

    assert settings.controller.config.filter is Filter.ADAPTIVE
    assert {neighbour.config.filter for neighbour in settings.neighbours} == {filter_of_neighbours}


def test_a_figure_of_curves_has_the_filter_in_a_text() -> None:
    """ASDF- is the default; a figure shows it with a minus sign in place of a hyphen."""
    table = simulate(grid(robots=4, flawed=1, steps=20, trials=1, density=[1.0, 2.0], topology="dynamic"))
    figure = plot_curve(table, "density")
    text_in_figure = " ".join(text.get_text() for text in figure.texts)
    assert "ASDF\N{MINUS SIGN}" in text_in_figure
