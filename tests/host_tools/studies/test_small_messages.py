"""The study of messages of few bits: experiments, ratios of errors, tables and picture."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import mcp_asdf_tools as m
from mcp_asdf_tools.experiments.message_codes import MessageCode
from mcp_asdf_tools.experiments.trials import run_trials
from mcp_asdf_tools.studies import small_messages, study_program
from mcp_asdf_tools.studies.bootstrap import Interval, Resampled
from mcp_asdf_tools.studies.small_messages import SWARMS
from support import ROOT

# --- Experiments -----------------------------------------------------------------------------------------


def test_every_swarm_has_experiments_with_each_code_and_with_exact_messages() -> None:
    """A code such as 7+4 has 7 bits of x_hat, one of six choices, and 4 of alpha, one of five."""
    experiments = small_messages.experiments_of("asdf-minus")
    assert len(experiments) == len(SWARMS) * (6 * 5 + 1)
    assert {experiment.message_bits for experiment in experiments["7+4, moving, overconfident"]} == {"7+4"}
    assert experiments["exact, fully connected, underconfident"][0].message_code is None


def test_swarms_have_floors_of_five_shares_of_black() -> None:
    experiments = small_messages.experiments_of("robust")["16+1, moving, underconfident"]
    assert [experiment.fill_ratio for experiment in experiments] == [0.55, 0.65, 0.75, 0.85, 0.95]
    assert {(experiment.filter, experiment.robots, experiment.flawed) for experiment in experiments} == {
        ("robust", 20, 6)
    }


def test_the_robust_filter_is_run_with_one_bit_of_alpha() -> None:
    codes = small_messages.codes_of("robust")
    assert [str(code) for code in codes] == ["4+1", "5+1", "6+1", "7+1", "8+1", "16+1"]


def test_more_bits_of_alpha_change_nothing_for_the_robust_filter() -> None:
    """It asks only whether a sender has any confidence alpha; 7+1 has one bit of it, and 7+9 nine."""
    experiment = small_messages.experiments_of("robust")["7+1, moving, overconfident"][0]
    short = replace(experiment, steps=1500, trials=1)
    one_bit = run_trials(short, 0, 1)
    nine_bits = run_trials(replace(short, message_bits="7+9"), 0, 1)

    assert np.array_equal(one_bit.errors, nine_bits.errors)


# --- Ratios ----------------------------------------------------------------------------------------------


def resampled(value: float, resamples: list[float]) -> Resampled:
    """Return a value, and those that come out of resampled trials, which show how uncertain it is."""
    return Resampled(value, np.array(resamples, np.float32))


def test_a_ratio_divides_values_and_resamples_in_pairs() -> None:
    ratio = resampled(3.0, [2.0, 8.0]) / resampled(2.0, [1.0, 2.0])

    assert ratio.value == 3.0 / 2.0
    assert ratio.resamples.tolist() == [2.0 / 1.0, 8.0 / 2.0]


def test_the_ratio_of_a_code_is_that_of_the_worst_swarm(monkeypatch: pytest.MonkeyPatch) -> None:
    """A ratio compares the error of a swarm with that of the same swarm with exact messages.

    Here one kind of swarm has three times the error with the code 4+1, and all other errors are equal. A
    ratio comes with the ends of its interval.
    """
    short_code, long_code = MessageCode(4, 1), MessageCode(16, 9)

    def planted_error(rows: object, message_bits: str, swarm: str) -> Resampled:
        is_worst = swarm == "moving, overconfident" and message_bits == "4+1"
        error = 0.3 if is_worst else 0.1
        return resampled(error, [error] * 100)

    monkeypatch.setattr(small_messages, "late_error", planted_error)
    ratios = small_messages.worst_ratios({}, [short_code, long_code])

    assert ratios[short_code] == pytest.approx((3.0, 3.0, 3.0))
    assert ratios[long_code] == pytest.approx((1.0, 1.0, 1.0))


@pytest.mark.parametrize(
    ("ratio", "text"),
    [
        (Interval(1.02, 0.97, 1.1), "**1.02**"),
        (Interval(1.02, 0.97, 1.11), "1.02"),
        (Interval(3.456, 3.0, 4.0), "3.46"),
    ],
)
def test_a_ratio_is_in_bold_type_if_all_of_its_interval_is_tolerable(ratio: Interval, text: str) -> None:
    assert small_messages.ratio_text(ratio) == text


def test_codes_about_which_few_trials_decide_nothing_have_many() -> None:
    experiments = small_messages.experiments_of("asdf-minus", small_messages.CLOSE_CODES, trials=600)
    all_experiments = [experiment for row in experiments.values() for experiment in row]
    assert {experiment.message_bits for experiment in all_experiments} == {"exact", "7+4", "8+4"}
    assert {experiment.trials for experiment in all_experiments} == {600}


def test_a_table_has_the_ends_of_an_interval_beside_its_ratio() -> None:
    table = small_messages.interval_table({MessageCode(7, 4): Interval(1.107, 1.0685, 1.155)})
    assert table.splitlines()[2:] == ["| 7 | 4 | 1.11 | 1.07 | 1.16 |"]


# --- The program -----------------------------------------------------------------------------------------


@pytest.fixture
def study_folder(few_resamples: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder of a study of two codes, one floor and short trials, after the program has run."""
    monkeypatch.setattr(small_messages, "X_HAT_BITS", (4, 16))
    monkeypatch.setattr(small_messages, "ALPHA_BITS", {"asdf-minus": (4, 9), "robust": (1,)})
    monkeypatch.setattr(small_messages, "FILL_RATIOS", [0.55])
    monkeypatch.setattr(small_messages, "CLOSE_CODES", (MessageCode(7, 4),))
    monkeypatch.setattr(study_program, "QUICK_STEPS", 1000)
    monkeypatch.setattr("sys.argv", ["study", str(tmp_path), "--quick"])
    small_messages.main()
    return tmp_path


def test_the_program_writes_a_table_for_each_filter_and_a_picture(study_folder: Path) -> None:
    text = (study_folder / "small_messages.md").read_text(encoding="utf-8")
    tables = dict(re.findall(r"<!-- (\w+) -->\n(\|.*?)\n<!-- end -->", text, re.DOTALL))

    assert list(tables) == ["exact", "asdf_minus", "robust", "close"]
    assert [line.partition(" |")[0] for line in tables["robust"].splitlines()[2:]] == [
        "| x_hat 4",
        "| x_hat 16",
    ]
    assert (study_folder / "small_messages.png").read_bytes().startswith(b"\x89PNG")


def test_the_program_keeps_the_results_of_each_filter(study_folder: Path) -> None:
    files = sorted(study_folder.glob("*.parquet"))
    assert [path.stem for path in files] == [
        "small_messages_asdf-minus",
        "small_messages_close",
        "small_messages_robust",
    ]
    (first, *_) = m.experiments_in(m.read_table(files[0]))
    assert (first.sampling_interval, first.experiment.filter) == (250, "asdf-minus")


# --- The page --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("filter_name", ["asdf-minus", "robust"])
def test_the_page_has_a_ratio_of_every_code(filter_name: str) -> None:
    mark = filter_name.replace("-", "_")
    text = (ROOT / "docs/internals/small_messages.md").read_text(encoding="utf-8")
    table = text.partition(f"<!-- {mark} -->\n")[2].partition("\n<!-- end -->")[0]
    rows = [[cell.strip(" *") for cell in line.split("|")[1:-1]] for line in table.splitlines()[2:]]

    assert [label for label, *_ in rows] == [f"x_hat {bits}" for bits in small_messages.X_HAT_BITS]
    assert all(len(ratios) == len(small_messages.ALPHA_BITS[filter_name]) for _, *ratios in rows)
    assert all(float(ratio) > 0.5 for _, *ratios in rows for ratio in ratios)
