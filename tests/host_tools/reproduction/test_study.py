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
from mcp_asdf_tools.common.figures import empty_figure
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.results import Trials, experiments_in, read_table
from mcp_asdf_tools.experiments.scores import Limits, score
from mcp_asdf_tools.experiments.trials import Job, run_trials
from mcp_asdf_tools.reproduction import report_text, resampling, study, study_report
from mcp_asdf_tools.reproduction.claims import CLAIMS
from mcp_asdf_tools.reproduction.decisions import Decision, abouts
from mcp_asdf_tools.reproduction.paper_figures import FIGURES
from mcp_asdf_tools.reproduction.resampling import exactly
from mcp_asdf_tools.reproduction.study import (
    H_E,
    H_K,
    PERIODS,
    QUICK,
    Cell,
    Effort,
    H,
    Part,
    Scale,
    cells_of,
    experiment_of,
    study_of,
)
from mcp_asdf_tools.reproduction.verdicts import Comparison, Expectation, Finding, Place
from mcp_asdf_tools.robots.population import Filtering
from support import ROOT

FULL, DYNAMIC, PHYSICAL = Part
SMALL = ("--trials", "2", "--steps", "4000", "--workers", "1", "--seeds", "1")
TINY = ("--part", "physical", *SMALL)


@pytest.fixture(autouse=True)
def few_resamples(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of the intervals nothing but their presence matters here."""
    monkeypatch.setattr(resampling, "RESAMPLES", 50)


def draw_only(monkeypatch: pytest.MonkeyPatch, *names: str) -> None:
    """Leave pictures out of reports that take long and have their like among these, and those of claims."""
    chosen = [figure for figure in FIGURES if figure.name in names]
    assert len(chosen) == len(names)
    monkeypatch.setattr(study_report, "FIGURES", chosen)
    monkeypatch.setattr(study_report, "heat_map", lambda comparisons: empty_figure(1, 1))


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
    assert {part: each.trials for part, each in swarms.items()} == {FULL: 300, DYNAMIC: 60, PHYSICAL: 300}
    assert swarms[DYNAMIC].sides[0] == pytest.approx(0.7 * np.sqrt(20 * np.pi))


def test_physical_sensors_are_perfect_and_099_is_assumed() -> None:
    for cell in cells_of(PHYSICAL):
        experiment = experiment_of(cell, Scale())
        assert experiment.true_accuracy == 1
        assert {experiment.b_hat(robot) for robot in range(experiment.flawed, 8)} <= {0.99}


def test_flawed_robots_are_counted() -> None:
    for part, percent, flawed in ((FULL, 30, 3), (DYNAMIC, 10, 2), (PHYSICAL, 25, 2), (PHYSICAL, 100, 8)):
        assert experiment_of(Cell(part, 0.448, 1.0, 0.55, percent), Scale()).flawed == flawed


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
        base.but(filter=Filtering.ASDF_PLUS),
        base.but(period=2000),
        base.but(flawed_accuracy=0.55),
        base.but(percent=0, filter=Filtering.ASDF_PLUS),
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

    def counted(job: Job) -> Trials:
        if len(started) == most:
            raise KeyboardInterrupt
        started.append(job)
        return run(job)

    monkeypatch.setattr(Job, "run", counted)
    return started


@pytest.mark.slow
def test_the_whole_study_makes_a_report(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    found = answer(capsys, *SMALL, "--output", str(tmp_path))
    expected = [(claim.name, part and part.value) for claim in CLAIMS for part in abouts(claim)]
    assert sorted((each["claim"], str(each["part"])) for each in found["claims"]) == sorted(
        (name, str(part)) for name, part in expected
    )
    _check_report(tmp_path, len(expected), len(FIGURES))
    with (tmp_path / "comparisons.csv").open(encoding="utf-8", newline="") as file:
        comparisons = list(csv.DictReader(file))
    assert {row["claim"] for row in comparisons} == {claim.name for claim in CLAIMS}


def _check_report(folder: Path, claims: int, figures: int) -> None:
    """Every claim and figure has its picture, described, captioned and linked, on a page that needs no other
    file."""
    report = (folder / "report.md").read_text(encoding="utf-8")
    shown = re.findall(r"^!\[([^\]]+)\]\(([^)]+)\)$", report, re.M)
    assert {name for _, name in shown} == {
        f"{path.parent.name}/{path.name}"
        for kind in ("claims/*.svg", "figures/*.png")
        for path in folder.glob(kind)
    }
    assert sum(name.startswith("claims/") for _, name in shown) == claims
    assert sum(name.startswith("figures/") for _, name in shown) == figures
    links, anchors = re.findall(r"\]\(#([^)]+)\)", report), re.findall(r'<a id="([^"]+)">', report)
    assert set(links) == set(anchors)
    page = (folder / "report.html").read_text(encoding="utf-8")
    sources = re.findall(r'src="([^"]*)"', page)
    assert len(sources) == len(shown)
    assert all(source.startswith("data:image/") for source in sources)
    described = [re.findall(r'alt="([^"]*)"', tag) for tag in re.findall(r"<img\b[^>]*>", page)]
    assert all(len(" ".join(words).split()) >= 5 for words in described)
    assert not re.search(r"(src|href)=\"(?!data:|#)", page)


@pytest.mark.slow
def test_figures_say_what_they_show(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    draw_only(monkeypatch, "confidence", "physical_scores", "physical_scatter", "physical_paths")
    answer(capsys, *TINY, "--output", str(tmp_path))
    _check_report(tmp_path, 14, 4)
    report = (tmp_path / "report.md").read_text(encoding="utf-8")
    for figure in ("8a", "8b"):
        (caption,) = re.findall(rf"^.*\(the paper's figure {figure}\).*$", report, re.M)
        assert caption.endswith("2 trials of each experiment; K_max = 4000, e_max = 0.45.")
    assert "within 1.5" in next(figure.note for figure in FIGURES if figure.paper == "3a")
    assert [figure.paper for figure in FIGURES if figure.paper] == [
        *("2", "3a", "3b", "4", "5a", "5b", "6", "7", "8a", "8b")
    ]


def test_a_short_run_gives_no_verdict(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    draw_only(monkeypatch)
    assert not QUICK.allows_verdicts
    found = answer(capsys, *TINY, "--output", str(tmp_path))
    assert {each["verdict"] for each in found["claims"]} == {None}
    for name in ("report.md", "report.html"):
        page = (tmp_path / name).read_text(encoding="utf-8")
        head = page.split("What was run")[0]
        assert "Too short for verdicts: none is given" in head
        assert not re.search(r"\b(agree|mixed|disagree|undecided)\b", page.split("How a claim is decided")[0])


def test_an_interrupted_study_goes_on_to_the_same_report(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    draw_only(monkeypatch, "physical_scores")
    whole, halves = tmp_path / "whole", tmp_path / "halves"
    found = answer(capsys, *TINY, "--output", str(whole))
    with monkeypatch.context() as patch:
        count_jobs(patch, 8)
        assert cli.main(["reproduce", *TINY, "--output", str(halves)]) == 130
    assert "24 of 40 trials left; the same command goes on" in capsys.readouterr().err
    assert cli.main(["reproduce", *TINY, "--output", str(halves), "--redraw"]) == 2
    assert "physical.parquet lacks 24 trials; leave out --redraw to run them" in capsys.readouterr().err
    started = count_jobs(monkeypatch)
    assert answer(capsys, *TINY, "--output", str(halves))["claims"] == found["claims"]
    assert sum(job.count for job in started) == 24
    assert _files(whole) == _files(halves)
    count_jobs(monkeypatch, 0)
    before = _files(whole)
    (whole / "report.html").unlink()
    answer(capsys, *TINY, "--output", str(whole), "--redraw")
    assert _files(whole) == before


def _files(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.mark.slow
def test_trials_are_added_where_comparisons_are_open(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Up to the most, with every seed, and the finished study is the same when it is taken up again."""
    draw_only(monkeypatch)
    monkeypatch.setitem(study.ENOUGH, PHYSICAL, Effort(2, 8, 2))
    options = ("--part", "physical", "--steps", "4000", "--workers", "1", "--output", str(tmp_path))
    assert cli.main(["reproduce", *options]) == 0
    assert "80 trials to run, about" in capsys.readouterr().err
    for name in ("physical", "physical_seed2"):
        trials = {
            len(each.numbers): each.experiment
            for each in experiments_in(read_table(tmp_path / f"{name}.parquet"))
        }
        assert set(trials) <= {2, 4, 8}
        assert len(trials) > 1
        assert {each.seed for each in trials.values()} == {2 if name.endswith("2") else 1}
    before = _files(tmp_path)
    count_jobs(monkeypatch, 0)
    assert cli.main(["reproduce", *options]) == 0
    assert _files(tmp_path) == before


def test_efforts_count_their_looks() -> None:
    assert [Effort(60, most, 1).looks for most in (60, 120, 240)] == [1, 2, 3]


@pytest.mark.slow
def test_the_study_is_scored_as_the_paper_does(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    draw_only(monkeypatch)
    answer(capsys, *TINY, "--seed", "7", "--output", str(tmp_path))
    results, scale = experiments_in(read_table(tmp_path / "physical.parquet")), Scale(2, 4000, 7)
    found = study_of([(PHYSICAL, results)], scale)
    for cell in cells_of(PHYSICAL):
        measured = run_trials(experiment_of(cell, scale), 0, 2)
        scores = score(measured.convergence_steps, measured.errors, Limits(4000, 0.45))
        for measure, values in ((H, scores.h), (H_K, scores.h_k), (H_E, scores.h_e)):
            assert np.array_equal(found.sample(cell, measure), values)


@pytest.mark.slow
def test_another_firmware_can_run_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    draw_only(monkeypatch)
    options = ("--firmware", "reference", "--conventions", "authors", "--output", str(tmp_path))
    answer(capsys, *TINY, *options)
    for trials in experiments_in(read_table(tmp_path / "physical.parquet")):
        assert (trials.experiment.firmware, trials.experiment.conventions.value) == ("reference", "authors")
    assert "Reference firmware, conventions of the authors;" in (tmp_path / "report.md").read_text()


def test_people_are_shown_the_verdicts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    draw_only(monkeypatch)
    assert cli.main(["reproduce", *TINY, "--output", str(tmp_path / "new")]) == 0
    out = capsys.readouterr().out
    assert "plus does no harm in short runs" in out
    assert str(tmp_path / "new" / "report.html") in out


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--trials", "1"], "--trials is 1; give at least 2"),
        (["--trials", "1000001"], "--trials: trials is 1000001"),
        (["--seed", "-1"], "--seed: seed is -1"),
        (["--seeds", "0"], "--seeds is 0; give 1 to 100"),
        (["--quick", "--paper"], "not allowed with argument"),
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
    options = ["reproduce", *TINY, "--output", str(tmp_path)]
    assert cli.main(options) == 0
    before = (tmp_path / "physical.parquet").read_bytes()
    assert cli.main([*options, "--seed", "2"]) == 2
    assert "choose another name" in capsys.readouterr().err
    assert (tmp_path / "physical.parquet").read_bytes() == before


def test_an_overview_fits_a_screen() -> None:
    """With every part, every verdict and every question of a user."""
    decided = [
        Decision(
            claim,
            part,
            Finding([Comparison(Place("", ""), exactly(9), Expectation.ABOVE, 2)]),
            {},
            frozenset(),
        )
        for claim in CLAIMS
        for part in abouts(claim)
    ]
    shown = report_text.overview(decided, Scale())
    assert shown.count("\n") <= 25
    assert f"{len(decided)} of {len(decided)} claims hold" in shown
    assert shown.count("[yes](#") == sum(len(parts) for _, _, parts in report_text._QUESTIONS)


def test_the_docs_show_every_claim() -> None:
    page = (ROOT / "docs/reproduce.md").read_text(encoding="utf-8")
    for claim in CLAIMS:
        assert page.count(f'| {claim.where} | "{claim.words}" |') >= len(abouts(claim)), claim.name


def test_tables_hold_any_words() -> None:
    assert report_text.table(["a", "b"], [["x | y", "p---q"]]) == "| a | b |\n|---|---|\n| x \\| y | p---q |"
