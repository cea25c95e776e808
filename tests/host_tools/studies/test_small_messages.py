"""The study of messages of few bits: experiments, ratios of errors, tables and picture.

A robot sends x_hat, its estimate of the share of black floor, and alpha, its confidence in it. A code such as
7+4 rounds them to 7 and to 4 bits.
"""

from __future__ import annotations

import itertools
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import mcp_asdf_tools as m
from host_tools.studies.conftest import (
    page_path,
    rare_resampling,
    tables_in,
    values_of,
)
from mcp_asdf_tools.experiments.message_codes import MessageCode
from mcp_asdf_tools.experiments.results import Trials
from mcp_asdf_tools.experiments.trials import run_trials
from mcp_asdf_tools.studies import small_messages, study_program
from mcp_asdf_tools.studies.bootstrap import Interval, Resampled

# --- Experiments -----------------------------------------------------------------------------------------


def test_each_of_four_swarms_runs_with_thirty_codes_and_with_exact_messages() -> None:
    """A code such as 7+4 has 7 bits for the estimate, one of six choices, and 4 for alpha, one of five."""
    experiments_by_row = small_messages.experiments_of("asdf-minus")

    swarms = 4
    codes = 6 * 5
    exact = 1
    assert len(experiments_by_row) == swarms * (codes + exact)
    experiments_with_code = experiments_by_row["7+4, moving, overconfident"]
    assert values_of(experiments_with_code, "message_bits") == {"7+4"}
    experiments_with_exact_messages = experiments_by_row["exact, fully connected, underconfident"]
    assert values_of(experiments_with_exact_messages, "message_bits") == {"exact"}


def test_each_swarm_of_the_study_of_small_messages_has_floors_of_five_shares_of_black() -> None:
    """The experiments of a row differ in this share. Six of the robots are flawed in all of them."""
    experiments_by_row = small_messages.experiments_of("robust")
    experiments = experiments_by_row["16+1, moving, underconfident"]

    assert [experiment.fill_ratio for experiment in experiments] == [0.55, 0.65, 0.75, 0.85, 0.95]
    assert values_of(experiments, "filter") == {"robust"}
    assert values_of(experiments, "flawed") == {6}


def test_the_robust_filter_runs_with_one_bit_of_alpha_only() -> None:
    """A code such as 4+1 has 4 bits for the estimate x_hat, and 1 for alpha, the confidence in it."""
    codes = small_messages.codes_of("robust")
    assert [str(code) for code in codes] == ["4+1", "5+1", "6+1", "7+1", "8+1", "16+1"]


def test_more_bits_of_alpha_change_nothing_for_the_robust_filter() -> None:
    """The filter asks only whether a sender has any confidence alpha. 7+1 has one bit of alpha, 7+9 nine."""
    experiments_by_row = small_messages.experiments_of("robust")
    experiment, *_others = experiments_by_row["7+1, moving, overconfident"]
    experiment_with_one_bit = replace(experiment, message_bits="7+1", steps=1500, trials=1)
    experiment_with_nine_bits = replace(experiment, message_bits="7+9", steps=1500, trials=1)

    trial_with_one_bit = run_trials(experiment_with_one_bit, first=0, trials=1)
    trial_with_nine_bits = run_trials(experiment_with_nine_bits, first=0, trials=1)

    assert trial_with_one_bit.errors.tolist() == trial_with_nine_bits.errors.tolist()


def test_two_codes_about_which_30_trials_decide_nothing_can_run_with_600() -> None:
    """The study is made for these codes alone, and for exact messages, with which they are compared."""
    close_codes = [MessageCode(x_hat_bits=7, alpha_bits=4), MessageCode(x_hat_bits=8, alpha_bits=4)]
    experiments_by_row = small_messages.experiments_of("asdf-minus", close_codes, trials=600)

    experiments = list(itertools.chain.from_iterable(experiments_by_row.values()))
    assert values_of(experiments, "message_bits") == {"exact", "7+4", "8+4"}
    assert values_of(experiments, "trials") == {600}


# --- Ratios ----------------------------------------------------------------------------------------------


def test_the_ratio_of_two_statistics_divides_their_values_and_their_resamples_in_pairs() -> None:
    """Resamples are the same statistic of trials drawn at random, which shows how uncertain it is."""
    dividend = Resampled(3.0, resamples=np.array([2.0, 8.0], np.float32))
    divisor = Resampled(2.0, resamples=np.array([1.0, 2.0], np.float32))

    ratio = dividend / divisor

    assert ratio.value == 3.0 / 2.0
    assert ratio.resamples.tolist() == [2.0 / 1.0, 8.0 / 2.0]


def test_the_error_ratio_of_a_code_is_the_largest_ratio_of_its_swarms(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A ratio divides the error of a swarm by the error of the same swarm with exact messages.

    All errors are 0.1, but one swarm with the code 4+1 has 0.3. In its resamples the error is 0.2 or 0.4.
    """
    usual_error = Resampled(0.1, resamples=np.full(100, 0.1, np.float32))
    larger_error = Resampled(0.3, resamples=np.repeat([0.2, 0.4], 50).astype(np.float32))

    def planted_error(results_by_row: object, message_bits: str, swarm: str) -> Resampled:
        if message_bits == "4+1" and swarm == "moving, overconfident":
            return larger_error
        return usual_error

    monkeypatch.setattr(small_messages, "late_error", planted_error)

    code_with_larger_error = MessageCode(x_hat_bits=4, alpha_bits=1)
    other_code = MessageCode(x_hat_bits=16, alpha_bits=9)
    no_results: dict[str, list[Trials]] = {}  # as the errors are planted
    ratios = small_messages.worst_ratios(no_results, [code_with_larger_error, other_code])

    larger_ratio = Interval(value=0.3 / 0.1, low=0.2 / 0.1, high=0.4 / 0.1)
    assert ratios[code_with_larger_error] == pytest.approx(larger_ratio)
    assert ratios[other_code] == pytest.approx(Interval(value=1, low=1, high=1))


@pytest.mark.parametrize(("high_end", "text"), [(1.1, "**1.02**"), (1.11, "1.02")])
def test_a_ratio_is_bold_if_its_interval_goes_no_higher_than_1_1(high_end: float, text: str) -> None:
    """A bold ratio of errors shows that a code costs at most a tenth more than exact messages."""
    ratio = Interval(value=1.02, low=0.97, high=high_end)
    assert small_messages.ratio_text(ratio) == text


def test_a_table_shows_a_ratio_and_both_ends_of_its_interval_with_two_decimals() -> None:
    """The row begins with the bits of the code, 7 for x_hat and 4 for alpha."""
    ratio = Interval(value=1.107, low=1.0685, high=1.155)
    code = MessageCode(x_hat_bits=7, alpha_bits=4)
    table = small_messages.interval_table({code: ratio})

    _column_heads, _separator, row = table.splitlines()
    assert row == "| 7 | 4 | 1.11 | 1.07 | 1.16 |"


# --- The program -----------------------------------------------------------------------------------------


def run_short_study(folder: Path) -> None:
    """Run the program with codes of 4 or 16 bits of x_hat, one floor and short trials."""
    with rare_resampling(), pytest.MonkeyPatch.context() as patch:
        patch.setattr(small_messages, "X_HAT_BITS", (4, 16))
        patch.setattr(small_messages, "ALPHA_BITS", {"asdf-minus": (4, 9), "robust": (1,)})
        patch.setattr(small_messages, "FILL_RATIOS", [0.55])
        patch.setattr(small_messages, "CLOSE_CODES", (MessageCode(7, 4),))
        patch.setattr(study_program, "QUICK_STEPS", 500)
        patch.setattr("sys.argv", ["study", str(folder), "--quick"])
        small_messages.main()


def test_the_program_writes_its_tables_of_both_filters_its_picture_and_its_results(tmp_path: Path) -> None:
    """The short study has codes with 4 or 16 bits of x_hat. Results have the estimates of each 250th step.

    If 30 trials decide nothing about a code, it runs with more trials, and enters the table "close".
    """
    run_short_study(tmp_path)

    tables = tables_in(tmp_path / "small_messages.md")

    assert list(tables) == ["exact", "asdf_minus", "robust", "close"]
    assert list(tables["asdf_minus"]) == ["x_hat 4", "x_hat 16"]
    assert list(tables["robust"]) == ["x_hat 4", "x_hat 16"]
    assert (tmp_path / "small_messages.png").read_bytes().startswith(b"\x89PNG")
    for file, filter_name in (("asdf-minus", "asdf-minus"), ("robust", "robust"), ("close", "asdf-minus")):
        results = m.experiments_in(m.read_table(tmp_path / f"small_messages_{file}.parquet"))
        assert {trials.experiment.filter for trials in results} == {filter_name}
        assert {trials.sampling_interval for trials in results} == {250}


# --- The page --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("table", "alpha_choices"), [("asdf_minus", 5), ("robust", 1)])
def test_the_page_about_small_messages_has_a_ratio_of_errors_for_every_code(
    table: str, alpha_choices: int
) -> None:
    """Tables have a row for each number of bits of the estimate x_hat, and a column for each of alpha.

    The errors with such messages are at least half as large as with exact ones.
    """
    ratios_by_row = tables_in(page_path("small_messages"))[table]

    assert list(ratios_by_row) == ["x_hat 4", "x_hat 5", "x_hat 6", "x_hat 7", "x_hat 8", "x_hat 16"]
    for ratios in ratios_by_row.values():
        assert len(ratios) == alpha_choices
        for ratio in ratios.values():
            ratio_without_bold_type = ratio.strip("*")
            assert float(ratio_without_bold_type) > 0.5
