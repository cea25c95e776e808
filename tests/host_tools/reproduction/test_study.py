"""The study: its experiments, the command that runs it, its report."""

from __future__ import annotations

import argparse
import json
import re
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from mcp_asdf_tools.cli import main as cli
from mcp_asdf_tools.cli import reproduce
from mcp_asdf_tools.experiments import plots
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.results import Trials
from mcp_asdf_tools.experiments.sweep import run_missing
from mcp_asdf_tools.experiments.trials import run_trials
from mcp_asdf_tools.reproduction import report, resampling, runs, study
from mcp_asdf_tools.reproduction.claims import CLAIMS
from mcp_asdf_tools.reproduction.decisions import decide
from mcp_asdf_tools.reproduction.figures import pictures
from mcp_asdf_tools.reproduction.runs import StudyFolder
from mcp_asdf_tools.reproduction.study import Cell, Effort, Part, Scale, Study, cells_of, experiment_of
from support import ROOT
from trials import noted_jobs

FULL, DYNAMIC, PHYSICAL = Part
SMALL = ("--trials", "2", "--steps", "4000", "--workers", "1", "--seeds", "1")
TINY = ("--part", "physical", *SMALL)


@pytest.fixture(autouse=True)
def quickly(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing but the presence of intervals matters here; pictures take long."""
    monkeypatch.setattr(resampling, "RESAMPLES", 50)
    monkeypatch.setattr(report, "pictures", lambda study, scale: [])


def answer(capsys: pytest.CaptureFixture[str], *arguments: str) -> dict[str, Any]:
    assert cli.main(["reproduce", *arguments, "--json"]) == 0
    found: dict[str, Any] = json.loads(capsys.readouterr().out)
    return found


def files_of(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


# --- Cells -----------------------------------------------------------------------------------------------


def test_the_study_is_the_papers() -> None:
    """Per f and b: 4 without flawed robots, 2 x 3 x 7 partially flawed, 2 x 4 entirely."""
    assert [len(cells_of(part)) for part in Part] == [4 * (4 + 42 + 8)] * 2 + [2 + 3 * 3 * 2]
    swarms: list[Experiment] = []
    for part in Part:
        cells = cells_of(part)
        assert all(cell.normal == cell for cell in cells)
        assert len({experiment_of(cell, Scale()) for cell in cells}) == len(cells)
        swarms.append(experiment_of(cells[0], Scale()))
    assert [(each.robots, each.steps, each.trials) for each in swarms] == [
        (10, 40_000, 300),
        (20, 40_000, 60),
        (8, 10_000, 300),
    ]
    assert swarms[1].sides[0] == pytest.approx(0.7 * np.sqrt(20 * np.pi))
    physical = swarms[2]
    assert (physical.sides, physical.floor, physical.speed) == ((3.0353, 3.0226), "code", 0.1)
    assert physical.steps_per_second / physical.observation_period == 2, "observations a second"
    for cell in cells_of(PHYSICAL):
        assert (cell.fill_ratio, cell.true_accuracy) == (0.448, 1.0)
        assert experiment_of(cell, Scale()).flawed == cell.percent * 8 // 100


def test_only_flawed_robots_that_are_some_make_another_swarm() -> None:
    minus = Cell(DYNAMIC, 0.55, 0.95, 0.55, 50, "asdf-minus", 2000)
    without, everyone = minus.but(percent=0).normal, minus.but(percent=100).normal
    assert without == Cell(DYNAMIC, 0.55, 0.95, 0.95, 0) and minus.normal == minus
    assert everyone == minus.but(percent=100, filter="asdf-plus")


def test_efforts_count_their_looks() -> None:
    assert [Effort(60, most, 1).looks for most in (60, 120, 240)] == [1, 2, 3]
    allowed = [
        Scale(trials, steps).allows_verdicts for trials in (None, 29, 30) for steps in (39_999, 40_000)
    ]
    assert allowed == [False, True, False, False, False, True]


@pytest.mark.slow
def test_the_page_has_the_figures_of_the_study() -> None:
    """Some verdicts and the gain of ASDF+ in docs/reproduce.md, with a fifth of its trials."""
    page = (ROOT / "docs/reproduce.md").read_text(encoding="utf-8")
    verdicts = (ROOT / "tests/data/study_verdicts.csv").read_text(encoding="utf-8")
    names = ["plus_improves_few_overconfident", "minus_still_improves_where_clear"]
    names += ["overconfident_are_accurate_where_easy", "plus_is_worse_than_minus_where_clear"]
    claims, scale = [claim for claim in CLAIMS if claim.name in names], Scale(trials=60)
    cells = {cell for claim in claims for asked in claim.reading.questions(FULL) for cell in asked.cells}
    results = {cell: run_trials(experiment_of(cell, scale), 0, 60) for cell in cells}
    found = decide(Study(results), scale, claims)
    for each in found:
        finding = each.finding
        numbers = f"{finding.count(True)},{len(finding.comparisons)}"
        assert f"{each.claim.name},fully connected,{finding.verdict.value},{numbers}\n" in verdicts
    (gain,) = [each.finding for each in found if each.claim.name == names[0]]
    printed = re.search(
        r"ASDF\+ helps overconfident swarms only at P = 10 %\*\*, by (\d+) to (\d+) points", page
    )
    assert printed
    values = sorted(each.estimate.value for each in gain.comparisons)
    assert values == pytest.approx([float(each) for each in printed.groups()], abs=4)


def test_pictures_are_the_papers_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each is of the cells that the paper's figure has; no panel is empty."""

    @dataclass
    class Results:
        experiment: Experiment

    class Whole(Study):
        @property
        def parts(self) -> set[Part]:
            return there

        def of(self, part: Part) -> list[Any]:
            return [Results(experiment_of(cell, Scale())) for cell in cells_of(part)]

    def drawn(shown: list[Any], number: int = 0, name: Any = lambda each: "") -> list[set[Any]]:
        assert number == 0 and all(each.numbers == [0] for each in shown if isinstance(each, Trials))
        every = [trials.experiment for trials in shown]
        shares = {each.flawed / each.robots for each in every}
        names, cells = set(map(name, every)), {(e.filter, e.flawed / e.robots) for e in every}
        return [{e.filter for e in every}, {e.filter_period for e in every}, shares, names, cells]

    for kind in ("boxes", "scatter", "bands", "series_beside"):
        monkeypatch.setattr(plots, kind, drawn)
    for there, count in (({DYNAMIC}, 4), ({PHYSICAL}, 2), (set(Part), 13)):  # noqa: B007 (``Whole``)
        found: dict[str, Any] = {each.name: each for each in pictures(Whole({}), Scale(2, 4000))}
        assert len(found) == count
    numbers = {name: [*re.findall(r"figure (\w+)\)$", each.title), ""] for name, each in found.items()}
    papers = {"dynamic_asdf-minus": "3a", "dynamic_asdf-plus": "3b", "dynamic_scatter": "4", "series": "6"}
    papers |= {"topologies_asdf-minus": "5a", "topologies_asdf-plus": "5b"}
    papers |= {"physical_asdf-plus": "8a", "physical_scatter": "8b"}
    assert {name: number for name, (number, *_) in numbers.items() if number} == papers
    some, every, shares = {1000}, {1000, 2000, 4000}, {0.1, 0.3, 0.5}
    for name, filters, periods, flawed in (
        ("dynamic_asdf-minus", {"none", "asdf-minus"}, every, {0, *shares}),
        ("dynamic_asdf-plus", {"none", "asdf-plus"}, every, {0, *shares, 1}),
        ("dynamic_scatter", {"none", "asdf-minus", "asdf-plus"}, some, {0, *shares, 1}),
        ("fully_connected_bands", {"asdf-plus"}, some, shares),
        ("topologies_asdf-minus", {"none", "asdf-minus"}, some, {0, *shares, 1}),
        ("series", {"none", "asdf-plus"}, some, {0.5}),
        ("physical_asdf-plus", {"none", "asdf-plus"}, some, {0, 0.25, 0.5, 1}),
    ):
        assert found[name].figure[:3] == [filters, periods, flawed], name
    names = {f"{where}, {who}" for where in ("dynamic", "fully connected") for who in ("no filter", "ASDF+")}
    assert found["topologies_asdf-plus"].figure[3] == names
    for name in ("dynamic_scatter", "topologies_asdf-minus"):
        assert {("asdf-minus", 0), ("asdf-minus", 1)} <= found[name].figure[4]
    assert "with ASDF\N{MINUS SIGN}" in found["dynamic_asdf-minus"].title


# --- Runs ------------------------------------------------------------------------------------------------


def test_an_interrupted_study_goes_on_to_the_same_report(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    whole, halves = tmp_path / "whole", tmp_path / "halves"
    found = answer(capsys, *TINY, "--output", str(whole))
    with monkeypatch.context() as patch:
        noted_jobs(patch, 8)
        assert cli.main(["reproduce", *TINY, "--output", str(halves)]) == 130
    assert "24 of 40 trials left; the same command goes on" in capsys.readouterr().err
    started = noted_jobs(monkeypatch)
    assert answer(capsys, *TINY, "--output", str(halves))["claims"] == found["claims"]
    assert sum(job.count for job in started) == 24
    assert files_of(whole) == files_of(halves)
    noted_jobs(monkeypatch, 0)
    before = files_of(whole)
    (whole / "report.html").unlink()
    assert cli.main(["reproduce", *TINY, "--output", str(whole)]) == 0
    out, err = capsys.readouterr()
    assert f"{'too short':10} physical" in out and f"\n{whole}/report.html\nagain: " in out
    assert err == "0 trials to run\n"
    assert files_of(whole) == before
    assert cli.main(["reproduce", *TINY, "--output", str(whole), "--seed", "2"]) == 2
    assert "choose another name" in capsys.readouterr().err
    assert files_of(whole) == before


def test_trials_are_added_where_comparisons_are_open(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Doubled up to the most, with every seed."""
    monkeypatch.setitem(study.ENOUGH, PHYSICAL, Effort(2, 6, 2))
    unsettled = {cells_of(PHYSICAL)[3]}
    monkeypatch.setattr(runs, "decide", lambda *_: [SimpleNamespace(unsettled=unsettled)])
    folder = StudyFolder(tmp_path, [PHYSICAL], Scale(steps=4000))
    assert [store.left for store in folder.stores] == [40, 40]
    found = list(folder.runs(lambda store: run_missing(store, 1)))
    assert [run.seed for run in found] == [1, 2]
    for run in found:
        trials = {cell: run.study.trials(cell) for cell in cells_of(PHYSICAL)}
        assert {cell for cell, each in trials.items() if len(each.numbers) == 6} == unsettled
        assert sorted(len(each.numbers) for each in trials.values()) == [2] * 19 + [6]
        assert {each.experiment.seed for each in trials.values()} == {run.seed}
    assert {path.name for path in tmp_path.iterdir()} == {"physical.parquet", "physical_seed2.parquet"}


def test_options_are_the_scale() -> None:
    parser = argparse.ArgumentParser()
    reproduce.add_arguments(parser)
    assert reproduce.scale_of(parser.parse_args([])) == Scale()
    assert reproduce.scale_of(parser.parse_args(["--paper", "--seed", "7"])) == Scale(30, seed=7, seeds=1)
    words = ["--quick", "--trials", "2", "--steps", "4000", "--seeds", "3"]
    assert reproduce.scale_of(parser.parse_args(words)) == Scale(2, 4000, 1, 3)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ("--trials 1", "--trials is 1; give at least 2"),
        ("--trials 1000001", "--trials: trials is 1000001"),
        ("--seeds 0", "--seeds is 0; give at least 1"),
        ("--steps 3999", "--steps is 3999; give at least 4000"),
        ("--workers 0", "--workers is 0"),
        ("--output /dev/null/x", "cannot write /dev/null/x: Not a directory; choose a folder"),
    ],
)
def test_bad_usage_is_told(arguments: str, words: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["reproduce", *arguments.split()]) == 2
    assert words in capsys.readouterr().err
