"""``mcp-asdf reproduce``: the command that runs the paper's study."""

from __future__ import annotations

import argparse
import json
import re
import signal
from pathlib import Path
from typing import Any

import pytest

from mcp_asdf_tools.cli import main as cli
from mcp_asdf_tools.cli import reproduce
from mcp_asdf_tools.experiments.trials import run_trials
from mcp_asdf_tools.studies import report
from mcp_asdf_tools.studies.cells import Cell, StudyPart, StudySize, experiment_of, own_experiments_of
from mcp_asdf_tools.studies.claims import CLAIMS, Claim, Decision, decide
from mcp_asdf_tools.studies.study_results import StudyResults
from support import ROOT
from trials import record_jobs

SHORT_STUDY = ("--part", "physical", "--trials", "2", "--steps", "4000", "--workers", "1")
TRIALS = 20 * 2
"""Two trials of each of 20 experiments of the physical part; a job is those of one experiment."""


def interrupt_study_after_eight_jobs(folder: Path) -> None:
    """Run the study until Ctrl-C comes when 16 of its 40 trials are done."""
    with pytest.MonkeyPatch.context() as patch:
        record_jobs(patch, max_jobs=8)  # the next job is interrupted
        assert run_plain(folder) == 128 + signal.SIGINT


@pytest.fixture(autouse=True)
def quick_report(few_resamples: None, monkeypatch: pytest.MonkeyPatch) -> None:
    """Draw no pictures, which take long."""
    monkeypatch.setattr(report, "draw_pictures", lambda study_results, study_size: [])


def run_json(capsys: pytest.CaptureFixture[str], folder: Path, *arguments: str) -> dict[str, Any]:
    assert cli.main(["reproduce", *SHORT_STUDY, "--output", str(folder), "--json", *arguments]) == 0
    answer: dict[str, Any] = json.loads(capsys.readouterr().out)
    return answer


def run_plain(folder: Path, *arguments: str) -> int:
    return cli.main(["reproduce", *SHORT_STUDY, "--output", str(folder), *arguments])


def contents_of(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_the_study_is_a_report_and_its_results(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    answer = run_json(capsys, tmp_path)
    assert set(contents_of(tmp_path)) == {
        "report.html",
        "report.md",
        "comparisons.csv",
        "physical.parquet",
    }
    assert answer["report"] == f"{tmp_path}/report.html"


def test_short_trials_get_no_verdict(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    claims = run_json(capsys, tmp_path)["claims"]
    assert {claim["part"] for claim in claims} == {None, "physical"}
    assert {claim["verdict"] for claim in claims} == {None}


def test_an_interrupted_study_runs_the_trials_that_are_left(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    interrupt_study_after_eight_jobs(tmp_path)
    assert "24 of 40 trials left; the same command goes on" in capsys.readouterr().err

    jobs = record_jobs(monkeypatch)
    run_json(capsys, tmp_path)

    assert sum(job.count for job in jobs) == 24


@pytest.mark.slow
def test_an_interrupted_study_ends_in_the_files_of_one_that_was_not(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run_json(capsys, tmp_path / "uninterrupted")

    interrupt_study_after_eight_jobs(tmp_path / "resumed")
    run_json(capsys, tmp_path / "resumed")

    assert contents_of(tmp_path / "resumed") == contents_of(tmp_path / "uninterrupted")


def test_the_report_of_a_finished_study_is_made_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    run_json(capsys, tmp_path)
    before = contents_of(tmp_path)
    (tmp_path / "report.html").unlink()
    record_jobs(monkeypatch, max_jobs=0)  # any job would be an interrupt

    assert run_plain(tmp_path) == 0
    assert contents_of(tmp_path) == before
    assert capsys.readouterr().err == "0 trials to run\n"


def test_the_claims_are_printed_with_the_report_and_the_line_to_repeat(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run_plain(tmp_path) == 0
    output = capsys.readouterr().out
    assert f"{'too short':10} physical" in output
    assert f"\n{tmp_path}/report.html\nagain: mcp-asdf reproduce --seed=1 " in output


@pytest.mark.slow
def test_more_trials_are_added_to_those_that_are_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    run_json(capsys, tmp_path)
    started = record_jobs(monkeypatch)
    run_json(capsys, tmp_path, "--trials", "3")
    assert sum(job.count for job in started) == TRIALS // 2


def test_results_of_another_seed_are_not_overwritten(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run_json(capsys, tmp_path)
    before = contents_of(tmp_path)

    assert run_plain(tmp_path, "--seed", "2") == 2
    assert "choose another name" in capsys.readouterr().err
    assert contents_of(tmp_path) == before


@pytest.mark.parametrize(("firmware", "filter_name"), [("mirror", None), ("native", "robust")])
def test_a_firmware_or_filter_of_the_users_is_run_in_the_swarms_of_the_papers_filters(
    firmware: str, filter_name: str | None
) -> None:
    """Where ASDF- and ASDF+ are two swarms, a filter in their place is one."""
    study_size = StudySize(trials=2, steps=4000)
    experiments = own_experiments_of(StudyPart.DYNAMIC, study_size, firmware, filter_name)

    assert len(set(experiments)) == len(experiments) == (60 if filter_name is None else 36)
    for experiment in experiments:
        assert experiment.firmware == firmware
        assert experiment.filter_period == 1000
        assert (experiment.trials, experiment.steps) == (2, 4000)
    filters = {experiment.filter for experiment in experiments}
    assert filters == ({filter_name} if filter_name else {"asdf-minus", "asdf-plus"})


@pytest.mark.slow
def test_a_filter_of_the_users_adds_results_and_changes_no_claim(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    claims = run_json(capsys, tmp_path)["claims"]
    files_before = contents_of(tmp_path)

    claims_with_filter = run_json(capsys, tmp_path, "--filter", "robust")["claims"]

    assert claims_with_filter == claims
    files = contents_of(tmp_path)
    assert files.keys() - files_before.keys() == {"physical_robust.parquet"}
    assert files["physical.parquet"] == files_before["physical.parquet"]


@pytest.mark.slow
def test_the_report_says_that_no_claim_is_about_a_filter_of_the_users(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run_json(capsys, tmp_path)
    report_before = (tmp_path / "report.md").read_text(encoding="utf-8")
    run_json(capsys, tmp_path, "--filter", "robust")
    report_with_filter = (tmp_path / "report.md").read_text(encoding="utf-8")

    sentence = "The figures also show robust, with a filter period of 1000 steps. No claim is about it."
    assert sentence in report_with_filter
    assert sentence not in report_before


@pytest.mark.slow
def test_the_report_gets_the_trials_with_a_filter_of_the_users(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    reported: list[StudyResults] = []
    render_markdown = report.render_markdown

    def record_results(study_results: StudyResults, *others: Any) -> str:
        reported.append(study_results)
        return render_markdown(study_results, *others)

    monkeypatch.setattr(report, "render_markdown", record_results)
    run_json(capsys, tmp_path)
    run_json(capsys, tmp_path, "--filter", "robust")

    without_filter, with_filter = reported
    assert without_filter.own_name == ""
    assert with_filter.own_name == "robust"
    experiments = [trials.experiment for trials in with_filter.own_trials_of(StudyPart.PHYSICAL)]
    assert experiments == own_experiments_of(StudyPart.PHYSICAL, StudySize(2, 4000), "native", "robust")


@pytest.mark.parametrize(
    ("arguments", "study_size"),
    [
        ([], StudySize(30, 40_000, 1)),
        (["--seed", "7"], StudySize(30, 40_000, 7)),
        (["--quick"], StudySize(10, 10_000, 1)),
        (["--quick", "--trials", "2", "--steps", "4000"], StudySize(2, 4000, 1)),
    ],
)
def test_options_say_how_much_is_run(arguments: list[str], study_size: StudySize) -> None:
    parser = argparse.ArgumentParser()
    reproduce.add_arguments(parser)
    assert reproduce.study_size_from(parser.parse_args(arguments)) == study_size


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("--trials 1", "--trials is 1; give at least 2"),
        ("--trials 1000001", "--trials: trials is 1000001"),
        ("--steps 3999", "--steps is 3999; give at least 4000"),
        ("--workers 0", "--workers is 0"),
        ("--firmware native", "--firmware native would do nothing: the study runs it anyway"),
        ("--firmware refrence", "argument --firmware: 'refrence' is none of native, mirror, reference"),
        ("--filter asdf-plus", "argument --filter: 'asdf-plus' is none of robust"),
        ("--output /dev/null/x", "cannot write /dev/null/x: Not a directory; choose a folder"),
    ],
)
def test_bad_usage_is_reported_with_its_fix(
    arguments: str, message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["reproduce", *arguments.split()]) == 2
    assert message in capsys.readouterr().err


# --- The page of the study -------------------------------------------------------------------------------

CHECKED_CLAIMS = (
    "plus_improves_few_overconfident",
    "minus_still_improves_where_clear",
    "overconfident_are_accurate_where_easy",
    "plus_is_worse_than_minus_where_clear",
)


@pytest.fixture(scope="module")
def decisions_of_60_trials() -> list[Decision]:
    """Decide some claims about fully connected swarms by 60 trials of each experiment."""
    claims = [claim for claim in CLAIMS if claim.name in CHECKED_CLAIMS]
    study_size = StudySize(trials=60)
    study_results = {
        cell: run_trials(experiment_of(cell, study_size), 0, 60) for cell in cells_compared(claims)
    }
    return decide(StudyResults(study_results), claims)


def cells_compared(claims: list[Claim]) -> set[Cell]:
    plans = [plan for claim in claims for plan in claim.plan(StudyPart.FULLY_CONNECTED)]
    return {plan.cell for plan in plans} | {plan.reference for plan in plans if plan.reference}


@pytest.mark.slow
def test_recorded_verdicts_are_those_of_fewer_trials(decisions_of_60_trials: list[Decision]) -> None:
    recorded = (ROOT / "tests/data/study_verdicts.csv").read_text(encoding="utf-8")
    for decision in decisions_of_60_trials:
        counts = f"{decision.count(True)},{len(decision.comparisons)}"
        assert f"{decision.claim.name},fully connected,{decision.verdict.value},{counts}\n" in recorded


@pytest.mark.slow
def test_the_page_has_the_gain_of_asdf_plus_that_fewer_trials_give(
    decisions_of_60_trials: list[Decision],
) -> None:
    page = (ROOT / "docs/internals/study.md").read_text(encoding="utf-8")
    gain = re.search(r"helps overconfident swarms only at P = 10 %\*\*, by (\d+) to (\d+) points", page)
    assert gain
    (decision,) = [each for each in decisions_of_60_trials if each.claim.name == CHECKED_CLAIMS[0]]
    values = sorted(comparison.interval.value for comparison in decision.comparisons)

    assert values == pytest.approx([float(number) for number in gain.groups()], abs=4)
