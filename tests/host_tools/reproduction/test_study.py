"""The study: its experiments, its report, and the command that runs it."""

from __future__ import annotations

import csv
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mcp_asdf_tools.cli import main as cli
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.measurement import Measured
from mcp_asdf_tools.experiments.results import experiments_in, read_table
from mcp_asdf_tools.experiments.scores import Limits, score
from mcp_asdf_tools.experiments.simulation import Job, run_trials
from mcp_asdf_tools.reproduction import study_report, verdicts
from mcp_asdf_tools.reproduction.paper_claims import CLAIMS
from mcp_asdf_tools.reproduction.paper_figures import FIGURES
from mcp_asdf_tools.reproduction.study import (
    H_E,
    H_K,
    PART_NAMES,
    PERIODS,
    Cell,
    H,
    Part,
    Scale,
    cells_of,
    experiment_of,
    study_of,
)
from mcp_asdf_tools.robots.population import Filtering
from support import ROOT

FULL, DYNAMIC, PHYSICAL = Part
SMALL = ("--trials", "2", "--steps", "4000", "--workers", "1")


@pytest.fixture(autouse=True)
def few_resamples(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of the intervals nothing but their presence matters here."""
    monkeypatch.setattr(verdicts, "_RESAMPLES", 50)


def draw_only(monkeypatch: pytest.MonkeyPatch, *names: str) -> None:
    """Leave pictures out of reports that take long and have their like among these."""
    chosen = [figure for figure in FIGURES if figure.name in names]
    assert len(chosen) == len(names)
    monkeypatch.setattr(study_report, "FIGURES", chosen)


# --- Cells -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("part", Part)
def test_cells_are_different_experiments(part: Part) -> None:
    cells = cells_of(part)
    experiments = {experiment_of(cell, Scale()) for cell in cells}
    assert len(experiments) == len(cells)
    assert all(cell.normal == cell for cell in cells)


def test_the_study_is_the_papers() -> None:
    """Per f and b: 4 without flawed robots, 2 x 3 x 7 partially flawed, 2 x 4 entirely."""
    assert len(cells_of(FULL)) == len(cells_of(DYNAMIC)) == 4 * (4 + 42 + 8)
    assert len(cells_of(PHYSICAL)) == 2 + 3 * 3 * 2
    swarms = {part: experiment_of(cells_of(part)[0], Scale()) for part in Part}
    assert {part: each.robots for part, each in swarms.items()} == {FULL: 10, DYNAMIC: 20, PHYSICAL: 8}
    assert {part: each.steps for part, each in swarms.items()} == {
        FULL: 40_000,
        DYNAMIC: 40_000,
        PHYSICAL: 10_000,
    }
    assert all(each.trials == 30 for each in swarms.values())
    assert swarms[DYNAMIC].sides[0] == pytest.approx(0.7 * np.sqrt(20 * np.pi))


def test_flawed_robots_are_counted() -> None:
    for part, percent, flawed in ((FULL, 30, 3), (DYNAMIC, 10, 2), (PHYSICAL, 25, 2), (PHYSICAL, 100, 8)):
        assert experiment_of(Cell(part, 0.448, 0.99, 0.55, percent), Scale()).flawed == flawed


@pytest.mark.parametrize(
    ("given", "same"),
    [
        (Cell(FULL, 0.55, 0.95, 0.75, 0), Cell(FULL, 0.55, 0.95, 0.55, 0)),
        (Cell(FULL, 0.55, 0.95, 0.75, 0, Filtering.ASDF_MINUS), Cell(FULL, 0.55, 0.95, 0.75, 0)),
        (Cell(FULL, 0.55, 0.95, 0.75, 30, period=4000), Cell(FULL, 0.55, 0.95, 0.75, 30)),
        (
            Cell(FULL, 0.55, 0.95, 0.75, 100, Filtering.ASDF_MINUS, 2000),
            Cell(FULL, 0.55, 0.95, 0.75, 100, Filtering.ASDF_PLUS, 2000),
        ),
    ],
)
def test_the_same_experiment_has_one_form(given: Cell, same: Cell) -> None:
    """Settings that the normal form leaves out do not change results."""
    assert given.normal == same.normal
    results = [run_trials(_shortened(cell), 0, 2) for cell in (given, same, given.normal)]
    for other in results[1:]:
        assert np.array_equal(results[0].convergence_steps, other.convergence_steps)
        assert np.array_equal(results[0].errors, other.errors)


def _shortened(cell: Cell) -> Experiment:
    return experiment_of(cell, Scale(trials=2, steps=8000))


def test_other_cells_are_kept_apart() -> None:
    base = Cell(FULL, 0.55, 0.95, 0.75, 30, Filtering.ASDF_MINUS)
    others = (
        base.but(mode=Filtering.ASDF_PLUS),
        base.but(period=2000),
        base.but(flawed_accuracy=0.55),
        base.but(percent=0, mode=Filtering.ASDF_PLUS),
    )
    assert len({cell.normal for cell in (base, *others)}) == 5


# --- The command -----------------------------------------------------------------------------------------


def answer(capsys: pytest.CaptureFixture[str], *arguments: str) -> dict[str, Any]:
    assert cli.main(["reproduce", *arguments, "--json"]) == 0
    content: dict[str, Any] = json.loads(capsys.readouterr().out)
    return content


def count_jobs(monkeypatch: pytest.MonkeyPatch, most: int = 10**9) -> list[Job]:
    """The jobs run from now on; one more than ``most`` ends in Ctrl-C."""
    started: list[Job] = []
    run = Job.run

    def counted(job: Job) -> Measured:
        if len(started) == most:
            raise KeyboardInterrupt
        started.append(job)
        return run(job)

    monkeypatch.setattr(Job, "run", counted)
    return started


@pytest.mark.slow
def test_the_whole_study_makes_a_report(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    draw_only(monkeypatch, "topologies_asdf-minus", "fully_connected_series", "dynamic_network")
    found = answer(capsys, *SMALL, "--output", str(tmp_path))
    assert [(each["claim"], each["part"]) for each in found["claims"]] == [
        (claim.name, claim.part and claim.part.value) for claim in CLAIMS
    ]
    report = (tmp_path / "report.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| [IV]+[-,].*\|$", report, re.MULTILINE)
    for row, claim in zip(rows, found["claims"], strict=True):
        assert row.endswith(f"| {claim['numbers']} | {claim['verdict']} |")
    _check_pictures(tmp_path, 3)
    with (tmp_path / "comparisons.csv").open(encoding="utf-8", newline="") as file:
        comparisons = list(csv.DictReader(file))
    assert {row["claim"] for row in comparisons} == {claim.name for claim in CLAIMS}


def _check_pictures(folder: Path, count: int) -> None:
    """Those of the report are there."""
    shown = re.findall(r"!\[\]\((.*)\)", (folder / "report.md").read_text(encoding="utf-8"))
    assert {folder / name for name in shown} == set(folder.glob("*.png"))
    assert len(shown) == count


def test_an_interrupted_study_goes_on_to_the_same_report(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    options = ("--part", "physical", *SMALL, "--output")
    whole, halves = tmp_path / "whole", tmp_path / "halves"
    found = answer(capsys, *options, str(whole))
    with monkeypatch.context() as patch:
        count_jobs(patch, 8)
        assert cli.main(["reproduce", *options, str(halves)]) == 130
    assert "24 of 40 trials left; the same command goes on" in capsys.readouterr().err
    started = count_jobs(monkeypatch)
    assert answer(capsys, *options, str(halves))["claims"] == found["claims"]
    assert sum(job.count for job in started) == 24
    assert {path.name for path in whole.iterdir()} == {path.name for path in halves.iterdir()}
    for path in whole.iterdir():
        assert path.read_bytes() == (halves / path.name).read_bytes(), path.name
    _check_pictures(whole, 3)


def test_the_study_is_scored_as_the_paper_does(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    draw_only(monkeypatch)
    answer(capsys, "--part", "physical", *SMALL, "--seed", "7", "--output", str(tmp_path))
    results, scale = experiments_in(read_table(tmp_path / "physical.parquet")), Scale(2, 4000, 7)
    study = study_of([(PHYSICAL, results)], scale)
    for cell in cells_of(PHYSICAL):
        measured = run_trials(experiment_of(cell, scale), 0, 2)
        scores = score(measured.convergence_steps, measured.errors, Limits(4000, 0.45))
        for measure, values in ((H, scores.h), (H_K, scores.h_k), (H_E, scores.h_e)):
            assert np.array_equal(study.sample(cell, measure), values)


def test_another_firmware_can_run_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    draw_only(monkeypatch)
    options = ("--firmware", "reference", "--conventions", "authors", "--output", str(tmp_path))
    answer(capsys, "--part", "physical", *SMALL, *options)
    for trials in experiments_in(read_table(tmp_path / "physical.parquet")):
        assert (trials.experiment.firmware, trials.experiment.conventions.value) == ("reference", "authors")
    assert "reference firmware, conventions of the authors;" in (tmp_path / "report.md").read_text()


def test_people_are_shown_the_verdicts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    draw_only(monkeypatch)
    assert cli.main(["reproduce", "--part", "physical", *SMALL, "--output", str(tmp_path / "new")]) == 0
    out = capsys.readouterr().out
    assert "plus does no harm in short runs" in out
    assert str(tmp_path / "new" / "report.md") in out


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--trials", "1"], "--trials is 1; give at least 2"),
        (["--trials", "1000001"], "--trials: trials is 1000001"),
        (["--seed", "-1"], "--seed: seed is -1"),
        (["--steps", "3999"], f"--steps is 3999; give at least {PERIODS[-1]}"),
        (["--workers", "0"], "--workers is 0"),
        (["--conventions", "authors"], "--conventions: firmware native has no conventions of the authors"),
        (["--output", "/dev/null/x"], "cannot make the folder"),
    ],
)
def test_bad_usage_is_told(arguments: list[str], words: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["reproduce", *arguments]) == 2
    assert words in capsys.readouterr().err


def test_results_of_another_run_are_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    draw_only(monkeypatch)
    options = ["reproduce", "--part", "physical", *SMALL, "--output", str(tmp_path)]
    assert cli.main(options) == 0
    before = (tmp_path / "physical.parquet").read_bytes()
    assert cli.main([*options, "--seed", "2"]) == 2
    assert "choose another name" in capsys.readouterr().err
    assert (tmp_path / "physical.parquet").read_bytes() == before


def test_the_docs_show_every_claim() -> None:
    page = (ROOT / "docs/reproduce.md").read_text(encoding="utf-8")
    shown = re.findall(
        r"^\| ([IV]+[-,][^|]*) \| ([^|]*) \| ([^|]*) \| [^|]* \| (?:agree|mixed|disagree) \|$", page, re.M
    )
    about = {part: PART_NAMES[part] for part in Part}
    assert shown == [
        (claim.section, about[claim.part] if claim.part else "equations", claim.text) for claim in CLAIMS
    ]
