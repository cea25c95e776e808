"""The tools default to ASDF-, and each report names the filter of its robots."""

from __future__ import annotations

import argparse
import json
import os
import shlex
from pathlib import Path

import pytest

from mcp_asdf.robot import Config, Filter
from mcp_asdf_tools import Experiment, SwarmSettings, experiments_in, grid, plot_curve, simulate
from mcp_asdf_tools.cli.main import main
from mcp_asdf_tools.cli.radio import add_arguments as add_radio_arguments
from mcp_asdf_tools.cli.radio import settings_of
from mcp_asdf_tools.robots.filters import describe_filters
from mcp_asdf_tools.tables.thresholds import generate, parse_omega

SWARM = "--robots 4 --steps 40 --filter-period 10 --flawed 50%"
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
def test_by_default_only_the_flawed_robots_recalibrate(kind: type[Experiment | SwarmSettings]) -> None:
    settings = kind(robots=4, flawed=1)
    assert [settings.config(robot).filter for robot in range(4)] == [Filter.ADAPTIVE, *[Filter.OFF] * 3]


def test_without_flawed_robots_no_estimated_accuracy_changes_by_default() -> None:
    experiment = Experiment(robots=6, flawed=0, steps=2000, filter_period=100, trials=4)
    (trials,) = experiments_in(simulate(experiment))
    assert (trials.b_hat == trials.b_hat[:, :1]).all()


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
    assert describe_filters(config.filter for config in configs) == description


@pytest.mark.parametrize("command", [f"swarm {SWARM}", f"simulate --trials 2 {SWARM}"])
def test_the_text_of_a_run_names_the_filter(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert ASDF_MINUS in printed_by(command, capsys)


def test_a_quiet_swarm_names_the_filter(capsys: pytest.CaptureFixture[str]) -> None:
    assert "4 robots, ASDF-, 40 steps" in printed_by(f"swarm {SWARM} --quiet", capsys)


def test_the_json_of_a_swarm_names_the_filter_of_each_run(capsys: pytest.CaptureFixture[str]) -> None:
    report = json.loads(printed_by(f"swarm {SWARM} --compare --json", capsys))
    assert report["results"]["filter"] == ASDF_MINUS
    assert report["compared"]["none"]["filter"] == "no filter: no robot recalibrates"
    assert report["compared"]["robust"]["filter"].startswith("robust: all robots")


def test_the_json_of_simulate_names_the_filter(capsys: pytest.CaptureFixture[str]) -> None:
    report = json.loads(printed_by(f"simulate --trials 2 {SWARM} --json", capsys))
    assert report["filter"] == ASDF_MINUS


def test_scores_name_the_filter_of_each_experiment(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    filters = ["none", "asdf-minus", "asdf-plus"]
    simulate(grid(robots=4, flawed=1, steps=40, trials=1, filter=filters), tmp_path / "grid.parquet")
    text = printed_by(f"score '{tmp_path}/grid.parquet'", capsys)
    for description in ("no filter: no robot", ASDF_MINUS, "ASDF+: all robots recalibrate"):
        assert description in text
    rows = json.loads(printed_by(f"score '{tmp_path}/grid.parquet' --json", capsys))["experiments"]

    assert [row["filter"].partition(":")[0] for row in rows] == ["no filter", "ASDF-", "ASDF+"]


def test_a_replay_names_the_filter(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    printed_by(f"swarm {SWARM} --quiet --log '{tmp_path}/run.log'", capsys)
    assert ASDF_MINUS in printed_by(f"replay '{tmp_path}/run.log'", capsys)
    assert json.loads(printed_by(f"replay '{tmp_path}/run.log' --json", capsys))["filter"] == ASDF_MINUS


@pytest.mark.parametrize("output", ["", "--json"])
def test_a_node_names_its_filter(
    output: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its standard input is at its end, so it stops at once."""
    with Path(os.devnull).open("rb") as empty:
        monkeypatch.setattr("mcp_asdf_tools.cli.node.standard_input_descriptor", empty.fileno)
        text = printed_by(f"node --id 3 --filter robust --until-eof {output}", capsys)
    assert "robust: the robot recalibrates, by this project's own filter" in text


@pytest.mark.parametrize("output", ["", "--json"])
def test_neighbours_in_real_time_name_the_filter(output: str, capsys: pytest.CaptureFixture[str]) -> None:
    command = f"radio --interface virtual --id 3 --robots 3 --steps 2 --steps-per-second 1000 {output}"
    assert ASDF_MINUS in printed_by(command, capsys)


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


def test_a_picture_of_curves_names_the_filter() -> None:
    table = simulate(grid(robots=4, flawed=1, steps=40, trials=1, density=[1.0, 2.0], topology="dynamic"))
    figure = plot_curve(table, "density")
    assert any("ASDF\N{MINUS SIGN}" in text.get_text() for text in figure.texts)
