"""``mcp-asdf reproduce``: the command that runs the paper's study."""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import re
import shutil
import signal
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from unittest.mock import Mock

import pytest

from host_tools.studies.conftest import page_path, rare_resampling, values_of
from mcp_asdf_tools.cli import main as cli
from mcp_asdf_tools.cli import reproduce
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.experiments.trials import Job, run_trials
from mcp_asdf_tools.studies import report
from mcp_asdf_tools.studies.cells import Cell, StudyPart, StudySize, experiment_of, users_experiments_of
from mcp_asdf_tools.studies.claims import CLAIMS, Claim, Decision, decide
from mcp_asdf_tools.studies.study_results import StudyResults
from support import ROOT
from trials import record_jobs

SHORT_STUDY = ("--part", "physical", "--trials", "2", "--steps", "4000", "--workers", "1")
"""Options for two trials of each of 20 experiments of the physical part; both are one job."""


@pytest.fixture(autouse=True, scope="module")
def quick_report() -> Iterator[None]:
    """Draw no pictures, which take long, and few resamples."""
    with rare_resampling(), pytest.MonkeyPatch.context() as patch:
        patch.setattr(report, "draw_pictures", lambda study_results, study_size: [])
        yield


def run_short_study(folder: Path, *options: str) -> int:
    """Run the command in this process, and return its exit code."""
    return cli.main(["reproduce", *SHORT_STUDY, "--output", str(folder), *options])


def read_files(folder: Path) -> dict[str, bytes]:
    """Return the contents of the files of a folder by their names."""
    return {path.name: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@dataclass(frozen=True)
class FinishedStudy:
    """What a short study has written into its folder and printed, and its exit code."""

    folder: Path
    output: str
    exit_code: int


@pytest.fixture(scope="module")
def finished_study(tmp_path_factory: pytest.TempPathFactory) -> FinishedStudy:
    """Run a short study, for tests that change nothing in its folder."""
    folder = tmp_path_factory.mktemp("study")
    output = io.StringIO()
    with contextlib.redirect_stdout(output):
        exit_code = run_short_study(folder)
    return FinishedStudy(folder, output.getvalue(), exit_code)


@pytest.fixture
def copied_study(finished_study: FinishedStudy, tmp_path: Path) -> Path:
    """A folder of a short study that has finished."""
    shutil.copytree(finished_study.folder, tmp_path / "copy")
    return tmp_path / "copy"


# --- Results and report ----------------------------------------------------------------------------------


def test_a_study_of_one_part_writes_its_results_and_a_report_in_three_formats(
    finished_study: FinishedStudy,
) -> None:
    """The study is of the physical part, without pictures."""
    assert finished_study.exit_code == 0
    assert read_files(finished_study.folder).keys() == {
        "report.html",
        "report.md",
        "comparisons.csv",
        "physical.parquet",
    }


@pytest.fixture
def open_stores(monkeypatch: pytest.MonkeyPatch) -> Mock:
    """A mock of the function that opens results in a folder; the command ends there, before any trial."""
    open_stores = Mock(side_effect=UsageError("no trial is to be run"))
    monkeypatch.setattr(reproduce, "open_stores", open_stores)
    return open_stores


@pytest.mark.parametrize(
    ("options", "folder"), [([], "reproduction"), (["--quick"], "reproduction-quick")], ids=["full", "quick"]
)
def test_a_study_without_the_option_output_goes_into_the_folder_that_the_documentation_names(
    options: list[str], folder: str, open_stores: Mock
) -> None:
    """A quick study has another folder, so that nobody takes its trials for the full study's."""
    cli.main(["reproduce", *options])
    folder_of_results, _experiments_by_store = open_stores.call_args.args
    assert folder_of_results == Path(folder)


def test_a_study_runs_all_parts_that_the_options_name_in_the_order_of_the_paper(open_stores: Mock) -> None:
    """Figure 5 of the paper needs both parts that are named here. The paper begins with connected swarms."""
    cli.main(["reproduce", "--part", "dynamic", "--part", "fully_connected"])
    _folder, experiments_by_store = open_stores.call_args.args
    parts = [study_part for study_part, _users_name in experiments_by_store]
    assert parts == [StudyPart.FULLY_CONNECTED, StudyPart.DYNAMIC]


def test_a_study_prints_its_claims_the_path_of_its_report_and_the_command_that_repeats_it(
    finished_study: FinishedStudy,
) -> None:
    """The study has two trials, so claims are "too short" to be decided. Each has a line with its part."""
    report_path = finished_study.folder / "report.html"
    assert "too short  physical         short_runs_are_accurate\n" in finished_study.output
    assert f"\n{report_path}\nagain: mcp-asdf reproduce --seed=1 " in finished_study.output


def test_json_of_a_study_has_the_path_of_the_report_and_claims_without_verdicts_if_trials_are_short(
    copied_study: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The part of the study is None for claims that equations decide. The study has two trials only."""
    run_short_study(copied_study, "--json")

    answer = json.loads(capsys.readouterr().out)
    parts_of_claims = {claim["part"] for claim in answer["claims"]}
    verdicts = {claim["verdict"] for claim in answer["claims"]}
    assert answer["report"] == str(copied_study / "report.html")
    assert parts_of_claims == {None, "physical"}
    assert verdicts == {None}


def interrupt_short_study_after_16_of_40_trials(folder: Path) -> int:
    """Run the study until Ctrl-C comes after eight jobs of two trials; return the exit code."""
    with pytest.MonkeyPatch.context() as patch:
        record_jobs(patch, max_jobs=8)  # the next job is interrupted
        return run_short_study(folder)


def count_trials(jobs: list[Job]) -> int:
    """Return how many trials jobs run in all."""
    return sum(job.count for job in jobs)


def test_an_interrupted_study_says_how_many_trials_are_left_and_runs_only_these_the_next_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """It prints the number to stderr and ends with the exit code of Ctrl-C, 128 + SIGINT."""
    exit_code = interrupt_short_study_after_16_of_40_trials(tmp_path)

    assert exit_code == 128 + signal.SIGINT
    assert "24 of 40 trials left; the same command goes on" in capsys.readouterr().err

    jobs_of_next_time = record_jobs(monkeypatch)
    assert run_short_study(tmp_path) == 0
    assert count_trials(jobs_of_next_time) == 24


def test_the_report_of_a_finished_study_is_made_again_without_running_trials(
    copied_study: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The report is deleted, and the command writes the same files as before."""
    files_before = read_files(copied_study)
    (copied_study / "report.html").unlink()

    record_jobs(monkeypatch, max_jobs=0)  # Ctrl-C would interrupt the first job
    exit_code = run_short_study(copied_study)

    assert exit_code == 0
    assert read_files(copied_study) == files_before
    assert capsys.readouterr().err == "0 trials to run\n"


@pytest.mark.slow
def test_a_study_with_more_trials_runs_only_those_that_are_not_there(
    copied_study: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The study has two trials of each of 20 experiments, so a third one is run of each."""
    jobs = record_jobs(monkeypatch)
    run_short_study(copied_study, "--trials", "3")

    assert count_trials(jobs) == 20


def test_a_study_with_another_seed_is_refused_in_the_folder_of_one_and_leaves_its_files_alone(
    copied_study: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The study in the folder has the seed 1. The command with the seed 2 ends with exit code 2."""
    files_before = read_files(copied_study)

    exit_code = run_short_study(copied_study, "--seed", "2")

    assert exit_code == 2
    assert "choose another name" in capsys.readouterr().err
    assert read_files(copied_study) == files_before


# --- A firmware or filter of the user's ------------------------------------------------------------------


def test_a_firmware_of_the_user_s_runs_in_the_60_swarms_of_asdf_minus_and_asdf_plus() -> None:
    """Each of four pairs of f and b has both filters with three percentages of flawed robots.

    These assume one of two accuracies. ASDF- and ASDF+ are one swarm where all robots are flawed, and where
    none is. The swarms have the study's trials and steps, and the shortest filter period.
    """
    size = StudySize(trials=2, steps=4000)
    experiments = users_experiments_of(StudyPart.DYNAMIC, size, firmware="mirror", filter_name=None)

    filters = 2
    percentages = 3
    accuracies = 2
    partly_flawed = filters * percentages * accuracies
    wholly_flawed = accuracies
    not_flawed = 1
    different_experiments = set(experiments)
    assert len(experiments) == 4 * (partly_flawed + wholly_flawed + not_flawed)
    assert len(different_experiments) == 60
    assert values_of(experiments, "firmware") == {"mirror"}
    assert values_of(experiments, "trials") == {2}
    assert values_of(experiments, "steps") == {4000}
    assert values_of(experiments, "filter") == {"asdf-minus", "asdf-plus"}
    assert values_of(experiments, "filter_period") == {1000}


def test_a_filter_of_the_user_s_runs_once_where_asdf_minus_and_asdf_plus_are_two_swarms() -> None:
    """The paper's two filters have 60 swarms. 24 of these differ only in the filter from another one."""
    experiments = users_experiments_of(
        StudyPart.DYNAMIC, StudySize(), firmware="native", filter_name="robust"
    )

    different_experiments = set(experiments)
    assert len(experiments) == 60 - 24
    assert len(different_experiments) == 60 - 24
    assert values_of(experiments, "filter") == {"robust"}


@pytest.mark.slow
def test_a_filter_of_the_user_s_adds_a_file_of_results_and_changes_no_claim(copied_study: Path) -> None:
    """The results of the paper's filters and comparisons.csv, which has the claims, stay as they were.

    A sentence of the report says that its figures show the filter.
    """
    files_before = read_files(copied_study)

    run_short_study(copied_study, "--filter", "robust")

    files = read_files(copied_study)
    new_files = files.keys() - files_before.keys()
    assert new_files == {"physical_robust.parquet"}
    assert files["physical.parquet"] == files_before["physical.parquet"]
    assert files["comparisons.csv"] == files_before["comparisons.csv"]
    sentence = b"The figures also show robust, with a filter period of 1000 steps. No claim is about it."
    assert sentence not in files_before["report.md"]
    assert sentence in files["report.md"]


# --- Options ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "study_size"),
    [
        ("", StudySize(trials=30, steps=40_000, seed=1)),
        ("--seed 7", StudySize(trials=30, steps=40_000, seed=7)),
        ("--quick", StudySize(trials=10, steps=10_000, seed=1)),
        ("--quick --trials 2 --steps 4000", StudySize(trials=2, steps=4000, seed=1)),
    ],
)
def test_options_say_how_many_trials_and_steps_are_run_with_which_seed(
    options: str, study_size: StudySize
) -> None:
    """Without options the study has the paper's 30 trials and 40,000 steps, and the seed 1."""
    parser = argparse.ArgumentParser()
    reproduce.add_arguments(parser)
    arguments = parser.parse_args(options.split())
    assert reproduce.study_size_from(arguments) == study_size


@pytest.mark.parametrize(
    ("options", "message"),
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
def test_a_wrong_option_of_reproduce_is_refused_with_a_message_that_names_it(
    options: str, message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """The command ends with exit code 2 and prints the message to stderr."""
    assert cli.main(["reproduce", *options.split()]) == 2
    assert message in capsys.readouterr().err


# --- The page of the study -------------------------------------------------------------------------------

CHECKED_CLAIMS = (
    "plus_improves_few_overconfident",
    "minus_still_improves_where_clear",
    "overconfident_are_accurate_where_easy",
    "plus_is_worse_than_minus_where_clear",
)


def cells_compared_by(claims: list[Claim]) -> Iterator[Cell]:
    for claim in claims:
        for plan in claim.plan(StudyPart.FULLY_CONNECTED):
            yield plan.cell
            if plan.reference is not None:
                yield plan.reference


@pytest.fixture(scope="module")
def decisions_of_60_trials() -> dict[str, Decision]:
    """Decide CHECKED_CLAIMS about fully connected swarms by 60 trials of each experiment, by their names."""
    claims = [claim for claim in CLAIMS if claim.name in CHECKED_CLAIMS]
    study_size = StudySize(trials=60)
    trials_by_cell = {
        cell: run_trials(experiment_of(cell, study_size), first=0, trials=60)
        for cell in set(cells_compared_by(claims))
    }
    decisions = decide(StudyResults(trials_by_cell), claims)
    return {decision.claim.name: decision for decision in decisions}


@pytest.mark.slow
@pytest.mark.parametrize("claim", CHECKED_CLAIMS)
def test_60_trials_lead_to_the_verdict_on_a_claim_that_is_recorded_of_more_trials(
    claim: str, decisions_of_60_trials: dict[str, Decision]
) -> None:
    """A recorded line has the claim, the part of the study, the verdict, and how many comparisons hold."""
    decision = decisions_of_60_trials[claim]
    holding_count = decision.count(holds=True)
    count = len(decision.comparisons)
    line = f"{claim},fully connected,{decision.verdict.value},{holding_count},{count}"

    recorded_lines = (ROOT / "tests/data/study_verdicts.csv").read_text(encoding="utf-8").splitlines()
    assert line in recorded_lines


@pytest.mark.slow
def test_60_trials_give_about_the_gain_of_asdf_plus_that_the_page_about_the_study_says(
    decisions_of_60_trials: dict[str, Decision],
) -> None:
    """The page gives the lowest and highest gain in H. 60 trials come within 4 points of both."""
    page = page_path("study").read_text(encoding="utf-8")
    sentence = re.search(r"helps overconfident swarms only at P = 10 %\*\*, by (\d+) to (\d+) points", page)
    assert sentence is not None
    lowest_gain_on_page = int(sentence[1])
    highest_gain_on_page = int(sentence[2])

    comparisons = decisions_of_60_trials["plus_improves_few_overconfident"].comparisons
    lowest_gain, highest_gain = sorted(comparison.interval.value for comparison in comparisons)

    assert lowest_gain == pytest.approx(lowest_gain_on_page, abs=4)
    assert highest_gain == pytest.approx(highest_gain_on_page, abs=4)
