"""Trial files of the paper's authors become results."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from authors_files import FIXED, MOVING, trial_content, write_trial
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.experiments.authors_trials import SOURCE, find_trial_files, read_trials
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.result_files import stream_experiments, write_tables
from mcp_asdf_tools.experiments.result_tables import trials_to_table
from mcp_asdf_tools.experiments.results import QUANTITIES, Trials
from mcp_asdf_tools.experiments.store import Store
from mcp_asdf_tools.experiments.trials import run_trials

KINDS = pytest.mark.parametrize("experiment", [FIXED, MOVING], ids=["fixed", "moving"])
DECIMALS = 6
"""Decimal places in the authors' files."""
ROUNDING = 10**-DECIMALS
"""Largest difference of a number in such a file from the one that was computed."""


def read_trial(path: Path, sampling_interval: int = 0) -> Trials:
    """Return the trial in a file of the authors' format.

    With a ``sampling_interval`` it has records: the robots' quantities after each so many steps.
    """
    [trials] = read_trials([path], sampling_interval)
    return trials


# --- What is read ----------------------------------------------------------------------------------------


@KINDS
def test_a_trial_has_its_experiment_number_and_source(experiment: Experiment, tmp_path: Path) -> None:
    """The source says that the trial was not run by these tools."""
    trials = read_trial(write_trial(tmp_path / "trial.json", experiment, number=2))
    assert trials.experiment == experiment
    assert trials.numbers == [2]
    assert trials.source == SOURCE


def read_and_run(experiment: Experiment, path: Path) -> tuple[Trials, Trials]:
    """Return trial 1 of an experiment as read from a file at ``path``, and as these tools run it.

    ``write_trial`` runs it in the same way, and writes it as the authors' programs would.
    """
    return read_trial(write_trial(path, experiment, number=1)), run_trials(experiment, first=1, trials=1)


@KINDS
def test_a_trial_from_a_file_has_the_convergence_and_errors_that_were_written(
    experiment: Experiment, tmp_path: Path
) -> None:
    trials, expected_trials = read_and_run(experiment, tmp_path / "trial.json")

    assert np.array_equal(trials.convergence_steps, expected_trials.convergence_steps)
    assert trials.errors == pytest.approx(expected_trials.errors, abs=ROUNDING)


@KINDS
def test_a_trial_from_a_file_has_the_accuracies_that_were_written(
    experiment: Experiment, tmp_path: Path
) -> None:
    trials, expected_trials = read_and_run(experiment, tmp_path / "trial.json")

    assert trials.b_hat == pytest.approx(expected_trials.b_hat, abs=ROUNDING)


def test_updates_are_the_filter_steps_that_changed_b_hat(tmp_path: Path) -> None:
    """The authors' files have b_hat in each step, but not how often the filter has updated it."""
    trials, expected_trials = read_and_run(FIXED, tmp_path / "trial.json")

    assert np.array_equal(trials.updates, expected_trials.updates)
    assert expected_trials.updates.sum() > 0


@KINDS
def test_a_trial_from_a_file_has_records_of_every_25th_step_if_asked_for(
    experiment: Experiment, tmp_path: Path
) -> None:
    """Records are the robots' quantities in these steps: those of the run that was written to the file.

    ``write_trial`` runs trial 1 as ``run_trials`` does, and writes it as the authors' programs would.
    """
    path = write_trial(tmp_path / "trial.json", experiment, number=1)
    trials = read_trial(path, sampling_interval=25)
    expected_trials = run_trials(experiment, first=1, trials=1, sampling_interval=25)

    assert trials.sampling_interval == 25
    assert list(trials.records) == list(QUANTITIES)
    for name in QUANTITIES:
        assert trials.records[name] == pytest.approx(expected_trials.records[name], abs=ROUNDING), name


def test_without_recording_there_are_no_records(tmp_path: Path) -> None:
    assert read_trial(write_trial(tmp_path / "trial.json", FIXED, number=0)).records == {}


def test_a_trial_of_their_version_of_june_2024_is_read(tmp_path: Path) -> None:
    data_str = trial_content(MOVING, 0)["data_str"]
    ten_numbers = [[",".join(text.split(",")[:10]) for text in texts] for texts in data_str]
    path = write_trial(tmp_path / "trial.json", MOVING, 0, data_str=ten_numbers, obs_queue_size=None)
    assert read_trial(path).experiment == MOVING


def test_a_filter_period_beyond_the_end_is_no_filter(tmp_path: Path) -> None:
    trials = read_trial(write_trial(tmp_path / "trial.json", FIXED, 0, sensor_filter_period=61))
    assert trials.experiment.filter == "none"
    assert trials.b_hat.shape == (1, 0, 5)


def test_the_method_alpha_is_a_filter_without_a_test(tmp_path: Path) -> None:
    path = write_trial(tmp_path / "trial.json", FIXED, 0, method="ALPHA", filter_specific_params=[-1.0])
    experiment = read_trial(path).experiment
    assert experiment.activation == "always"
    assert experiment.omega == Experiment().omega


def test_a_b_hat_that_became_nan_scores_as_in_results_of_the_reference(tmp_path: Path) -> None:
    content = trial_content(FIXED, 0)
    content["data_str"][4][60] = "-1,30,60,nan,nan,0.5,1.0,nan,nan,nan,"
    trials = read_trial(write_trial(tmp_path / "trial.json", FIXED, 0, data_str=content["data_str"]))

    # The last of their robots is the second of ours.
    assert np.isnan(trials.errors[0]).tolist() == [False, True, False, False, False]
    assert np.isfinite(trials.scores()["H"]).all()


# --- Files and folders -----------------------------------------------------------------------------------


def test_all_json_files_of_a_folder_and_below_are_found(tmp_path: Path) -> None:
    (tmp_path / "flw2").mkdir()
    for name in ("flw2/t1.json", "flw2/t0.json", "notes.txt"):
        (tmp_path / name).touch()
    files = find_trial_files([tmp_path, tmp_path / "flw2/t0.json"])

    assert [path.name for path in files] == ["t0.json", "t1.json"]


def test_a_folder_without_trials_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"there is no \.json file in .* or below"):
        find_trial_files([tmp_path])


@pytest.mark.parametrize("path", ["no/such.json", "/dev/zero"])
def test_what_is_no_file_is_refused(path: str) -> None:
    with pytest.raises(UsageError, match=f"{path} is no file; give files, or folders"):
        find_trial_files([Path(path)])


def test_a_trial_that_is_there_twice_is_refused(tmp_path: Path) -> None:
    paths = [write_trial(tmp_path / name, FIXED, 1) for name in ("a.json", "b.json")]
    with pytest.raises(UsageError, match=r"b\.json and .*a\.json are both trial 1 of an experiment"):
        list(read_trials(paths, 0))


def test_a_sweep_does_not_take_them_for_its_own(tmp_path: Path) -> None:
    output = tmp_path / "theirs.parquet"
    write_tables(output, [trials_to_table(read_trial(write_trial(tmp_path / "trial.json", FIXED, 0)))])
    with pytest.raises(UsageError, match="hold results of other experiments"):
        Store(output, [FIXED])


def test_the_source_is_kept_in_a_file_of_results(tmp_path: Path) -> None:
    output = tmp_path / "theirs.parquet"
    write_tables(output, [trials_to_table(read_trial(write_trial(tmp_path / "trial.json", FIXED, 0)))])
    [trials] = stream_experiments(output)
    assert trials.source == SOURCE


# --- What is refused -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"num_robots": None}, "it has no num_robots; give a trial of"),
        ({"num_robots": "5"}, "num_robots is '5'; it must be a whole number"),
        ({"num_robots": 6}, "data_str must be 6 lists, one of each robot"),
        ({"num_flawed_robots": 9}, "flawed is 9; .* (their num_flawed_robots)"),
        ({"num_steps": 61}, "data_str of robot 0: it must be a list of 62 texts"),
        ({"tfr": 1.5}, "fill_ratio is 1.5; it must be 0 to 1 (their tfr)"),
        ({"tfr": 10**400}, "it must be a smaller number"),
        ({"comms_period": 7}, "filter_period is 20; it must be a multiple of comms_period, 7"),
        ({"trial_ind": 3}, "trial_ind is 3; it must be 0 to 2, as num_trials says"),
        ({"sim_type": "real_robot_dynamic_deg_1d"}, "sim_type is 'real_robot_dynamic_deg_1d'; it must be"),
        ({"fully_connected": False}, "fully_connected is False; neighbours that are drawn anew"),
        ({"method": "CHARLIE"}, "method is 'CHARLIE'; the paper's methods are BRAVO and ALPHA"),
        ({"method": ["BRAVO"]}, "method is ['BRAVO']; the paper's methods"),
        ({"correct_robot_filter": 1}, "correct_robot_filter is 1; it must be true or false"),
        ({"filter_specific_params": "None"}, "filter_specific_params is 'None'; it must have"),
        ({"filter_specific_params": [2]}, "omega"),
        ({"correct_sensor_acc_w": 0.9}, "correct_sensor_acc_w is 0.9; the method knows one accuracy"),
        ({"data_str": 5}, "data_str must be 5 lists, one of each robot"),
    ],
)
def test_a_parameter_that_no_experiment_has_is_refused_by_its_name(
    changes: dict[str, Any], message: str, tmp_path: Path
) -> None:
    path = write_trial(tmp_path / "trial.json", FIXED, 0, **changes)
    with pytest.raises(UsageError) as refusal:
        read_trial(path)
    assert str(refusal.value).startswith(f"{path}: ")
    for part in message.split(".*"):
        assert part in str(refusal.value)


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("obs_queue_size", 1000, "a queue of observations is not the paper's"),
        ("comms_range", -1.0, "radio_range is -1.0"),
        ("density", -1.0, "density is -1.0"),
        ("speed", "fast", "speed is 'fast'; it must be a number"),
    ],
)
def test_a_parameter_that_no_moving_swarm_has_is_refused_by_its_name(
    key: str, value: object, message: str, tmp_path: Path
) -> None:
    path = write_trial(tmp_path / "trial.json", MOVING, 0, **{key: value})
    with pytest.raises(UsageError) as refusal:
        read_trial(path)
    assert message in str(refusal.value)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "step 7 is '', and must be a line of numbers"),
        ("1,2\n3", "step 7 is '1,2\\n3', and must be a line of numbers"),
        (7, "step 7 is 7, and must be a line of numbers"),
        ("-1,3,7,0.5", "invalid column index"),
        ("-1,3,7,half,1,0.5,1,0.5,0.95,0.95", "could not convert string 'half'"),
        ("-1,8,7,0.5,1,0.5,1,0.5,0.95,0.95", "n is 8 in step 7"),
        ("-1,3,8,0.5,1,0.5,1,0.5,0.95,0.95", "t is 8 in step 7"),
        ("-1,nan,7,0.5,1,0.5,1,0.5,0.95,0.95", "n is nan in step 7"),
        ("-1,3,7,0.5,-1,0.5,1,0.5,0.95,0.95", "alpha is -1 in step 7"),
        ("-1,3,7,0.5,1,0.5,inf,0.5,0.95,0.95", "beta is inf in step 7"),
        ("-1,3,7,0.5,1,0.5,1,1.5,0.95,0.95", "x is 1.5 in step 7"),
        ("-1,3,7,0.5,1,0.5,1,0.5,0.95,0.9", "b_hat on white is 0.9 in step 7"),
    ],
)
def test_a_step_that_no_robot_makes_is_refused_by_its_number(
    text: object, message: str, tmp_path: Path
) -> None:
    data_str = trial_content(FIXED, 0)["data_str"]
    data_str[3][7] = text
    path = write_trial(tmp_path / "trial.json", FIXED, 0, data_str=data_str)

    with pytest.raises(UsageError) as refusal:
        read_trial(path)
    assert str(refusal.value).startswith(f"{path}: data_str of robot 3: ")
    assert message in str(refusal.value)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("", "Expecting value"),
        ("[1, 2]", "it is no trial but list"),
        (json.dumps({"sim_type": "static_topo_static_degrad_1d"})[:-1], "Expecting ',' delimiter"),
        ("[" * 100_000, "recursion"),
    ],
)
def test_a_file_without_an_object_is_refused(content: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / "trial.json"
    path.write_text(content, encoding="utf-8")

    with pytest.raises(UsageError) as refusal:
        read_trial(path)
    assert message in str(refusal.value)
