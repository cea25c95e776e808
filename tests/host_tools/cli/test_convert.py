"""``mcp-asdf convert`` makes results of the authors' trial files, which the other commands take."""

from __future__ import annotations

import json
from pathlib import Path

import pyarrow.parquet as pq  # type: ignore[import-untyped]
import pytest

from authors_files import FIXED, MOVING, write_trial
from mcp_asdf_tools.cli.main import main
from support import slow

Capture = pytest.CaptureFixture[str]


@pytest.fixture(autouse=True)
def trials_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The present folder, which has two trials of a fixed network and one of a moving swarm in data."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "data").mkdir()
    write_trial(tmp_path / "data/flw2_t0.json", FIXED, number=0)
    write_trial(tmp_path / "data/flw2_t1.json", FIXED, number=1)
    write_trial(tmp_path / "data/moving.json", MOVING, number=2)
    return tmp_path


def test_convert_prints_the_scores_of_a_folder_of_the_authors_trials(capsys: Capture) -> None:
    """The folder data has two of three trials of a fully connected swarm, and one of a moving one."""
    assert main(["convert", "data", "--output", "theirs.parquet"]) == 0
    output = capsys.readouterr().out

    assert "fully-connected" in output
    assert "2 of 3" in output
    assert "1 of 3" in output
    assert "h_K" in output, "the column of a score"


def test_convert_writes_all_trials_into_one_row_group() -> None:
    """The folder data has three trials.

    A row group for each trial would let the time of reading grow with the square of their number.
    """
    main(["convert", "data", "--output", "theirs.parquet"])
    metadata = pq.read_metadata("theirs.parquet")
    assert metadata.num_rows == 3
    assert metadata.num_row_groups == 1


def test_convert_with_json_reports_the_authors_program_the_file_and_the_number_of_trials(
    capsys: Capture,
) -> None:
    """The source that it reports is the repository of the authors' program on GitHub."""
    assert main(["convert", "data/flw2_t1.json", "--output", "theirs.parquet", "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    [experiment] = report["experiments"]

    assert report["source"] == "NESTLab/sensor-degradation-filter"
    assert report["output"] == "theirs.parquet"
    assert experiment["trials"] == 1


def test_score_prints_of_converted_results_what_convert_has_printed(capsys: Capture) -> None:
    """Both print a table with the scores of each experiment, here of the authors' trials in a folder."""
    main(["convert", "data", "--output", "theirs.parquet"])
    printed_by_convert = capsys.readouterr().out
    assert main(["score", "theirs.parquet"]) == 0
    assert capsys.readouterr().out == printed_by_convert


@pytest.mark.parametrize("kind", ["boxes", *slow(["bands", "series"])])
def test_plot_draws_converted_results_as_a_picture(kind: str) -> None:
    """``kind`` is a kind of plot. A picture as a PNG file begins with the byte 0x89 and these letters."""
    main(["convert", "data/flw2_t0.json", "--output", "theirs.parquet"])
    assert main(["plot", "theirs.parquet", "picture.png", "--kind", kind]) == 0
    assert Path("picture.png").read_bytes().startswith(b"\x89PNG")


def test_view_exports_a_converted_trial_as_a_web_page_that_names_the_authors_program() -> None:
    """Trial 2 of the folder data is one of a moving swarm, whose topology is dynamic."""
    main(["convert", "data", "--output", "theirs.parquet"])
    view = ["view", "theirs.parquet", "--where", "topology=dynamic", "--trial", "2"]
    assert main([*view, "--export", "page.html"]) == 0
    page = Path("page.html").read_text(encoding="utf-8")
    assert "trial 2 of NESTLab/sensor-degradation-filter" in page


def test_view_refuses_a_trial_that_was_converted_without_recorded_values(capsys: Capture) -> None:
    """``--record 0`` keeps no values. The error says so, and the exit code for a wrong use is 2."""
    main(["convert", "data/moving.json", "--output", "theirs.parquet", "--record", "0"])
    assert main(["view", "theirs.parquet", "--trial", "2", "--export", "page.html"]) == 2
    assert "nothing is recorded" in capsys.readouterr().err


def test_convert_writes_nothing_if_one_of_the_files_is_damaged(trials_folder: Path, capsys: Capture) -> None:
    """The last file of the folder, zzz.json, holds nothing but an opening brace. The error names it."""
    (trials_folder / "data/zzz.json").write_text("{", encoding="utf-8")
    assert main(["convert", "data", "--output", "theirs.parquet"]) == 2
    assert "data/zzz.json" in capsys.readouterr().err
    assert list(trials_folder.glob("*theirs*")) == [], "neither theirs.parquet nor a part of it"


@pytest.mark.parametrize(
    ("wrong_options", "expected_message"),
    [
        ("data --output theirs.csv", "choose a name that ends in .parquet"),
        ("data --output no/theirs.parquet", "its folder does not exist"),
        ("data --output theirs.parquet --record -1", "--record is -1; choose a number of steps"),
        ("other --output theirs.parquet", "other is no file"),
        ("data", "--output"),
    ],
)
def test_convert_refuses_wrong_files_and_options_with_the_reason(
    wrong_options: str, expected_message: str, capsys: Capture
) -> None:
    """The reason for ``data --output theirs.csv`` is "choose a name that ends in .parquet", for example."""
    assert main(["convert", *wrong_options.split()]) == 2
    assert expected_message in capsys.readouterr().err
