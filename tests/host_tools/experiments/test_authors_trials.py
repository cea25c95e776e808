"""Trial files of the paper's authors become results."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from authors_files import FIXED as FIXED_NETWORK
from authors_files import MOVING as MOVING_SWARM
from authors_files import trial_content, write_trial
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.experiments.authors_trials import find_trial_files, read_trials
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.result_files import write_tables
from mcp_asdf_tools.experiments.result_tables import trials_to_table
from mcp_asdf_tools.experiments.results import QUANTITIES, Trials
from mcp_asdf_tools.experiments.store import Store
from mcp_asdf_tools.experiments.trials import run_trials

with_fixed_and_with_moving_robots = pytest.mark.parametrize(
    "experiment", [FIXED_NETWORK, MOVING_SWARM], ids=["fixed", "moving"]
)


def read_trial(path: Path, sampling_interval: int = 0) -> Trials:
    """Return the trial in a file of the authors' format.

    With a ``sampling_interval`` it has records: the robots' quantities at this interval of steps.
    """
    [trials] = read_trials([path], sampling_interval)
    return trials


# --- What is read ----------------------------------------------------------------------------------------


@with_fixed_and_with_moving_robots
def test_a_trial_read_from_the_authors_format_has_its_parameters_and_number(
    experiment: Experiment, tmp_path: Path
) -> None:
    """An experiment has several trials, numbered from 0: the file is of its trial 2."""
    path = write_trial(tmp_path / "trial.json", experiment, number=2)
    trials = read_trial(path)
    assert trials.experiment == experiment
    assert trials.numbers == [2]


@with_fixed_and_with_moving_robots
def test_a_trial_from_a_file_has_the_convergence_errors_and_accuracies_that_were_written(
    experiment: Experiment, tmp_path: Path
) -> None:
    """``write_trial`` runs trial 1 as ``run_trials`` does, and writes it as the authors' programs would.

    Numbers in their files have six decimal places, so only steps of convergence, which are whole, are exact.
    """
    path = write_trial(tmp_path / "trial.json", experiment, number=1)
    trials_from_file = read_trial(path)
    expected_trials = run_trials(experiment, first=1, trials=1)

    assert np.array_equal(trials_from_file.convergence_steps, expected_trials.convergence_steps)
    assert trials_from_file.errors == pytest.approx(expected_trials.errors, abs=1e-6)
    assert trials_from_file.b_hat == pytest.approx(expected_trials.b_hat, abs=1e-6)


def test_the_filter_steps_that_changed_b_hat_are_counted_as_updates(tmp_path: Path) -> None:
    """The authors' files have b_hat in each step, but not how often the filter has updated it.

    The numbers of updates are compared with those of the run that was written to the file.
    """
    path = write_trial(tmp_path / "trial.json", FIXED_NETWORK, number=1)
    updates_from_file = read_trial(path).updates
    expected_updates = run_trials(FIXED_NETWORK, first=1, trials=1).updates

    assert np.array_equal(updates_from_file, expected_updates)
    assert expected_updates.sum() > 0


@with_fixed_and_with_moving_robots
def test_a_trial_from_a_file_has_records_of_every_25th_step_if_asked_for(
    experiment: Experiment, tmp_path: Path
) -> None:
    """Records are the robots' quantities in these steps. They equal the run that was written to the file.

    ``write_trial`` runs trial 1 as ``run_trials`` does, and writes it as the authors' programs would.
    """
    path = write_trial(tmp_path / "trial.json", experiment, number=1)
    trials_from_file = read_trial(path, sampling_interval=25)
    expected_trials = run_trials(experiment, first=1, trials=1, sampling_interval=25)

    assert trials_from_file.sampling_interval == 25
    assert list(trials_from_file.records) == list(QUANTITIES)
    for quantity, expected_values in expected_trials.records.items():
        # Numbers in the file have six decimal places.
        assert trials_from_file.records[quantity] == pytest.approx(expected_values, abs=1e-6), quantity


def first_ten_numbers(text: str) -> str:
    """Return the beginning of a step's text: ten numbers, separated by commas."""
    return ",".join(text.split(",")[:10])


def test_a_trial_of_the_authors_version_of_june_2024_is_read(tmp_path: Path) -> None:
    """This version wrote ten numbers for each robot and step, later ones thirteen.

    It had no parameter obs_queue_size. ``write_trial`` leaves out what is None.
    """
    short_texts_by_robot = []
    for texts_of_steps in trial_content(MOVING_SWARM, number=0)["data_str"]:  # of one robot
        short_texts_by_robot.append([first_ten_numbers(text) for text in texts_of_steps])
    path = tmp_path / "trial.json"
    write_trial(path, MOVING_SWARM, number=0, data_str=short_texts_by_robot, obs_queue_size=None)

    assert read_trial(path).experiment == MOVING_SWARM


def test_a_trial_that_ends_before_its_filter_is_due_has_no_filter(tmp_path: Path) -> None:
    """The trial has 60 steps, and the filter would have run for the first time in step 61.

    So b_hat has values of five robots in no filter step.
    """
    path = write_trial(tmp_path / "trial.json", FIXED_NETWORK, number=0, sensor_filter_period=61)
    trials = read_trial(path)

    assert trials.experiment.filter == "none"
    trial_count, filter_steps, robots = trials.b_hat.shape
    assert (trial_count, filter_steps, robots) == (1, 0, 5)


def test_the_method_alpha_of_the_authors_is_a_filter_that_is_always_active(tmp_path: Path) -> None:
    """It re-estimates b_hat without a test, so it has no omega, the probability of that test's error.

    The authors' files have -1 in its place, which we read as the default.
    """
    path = tmp_path / "trial.json"
    write_trial(path, FIXED_NETWORK, number=0, method="ALPHA", filter_specific_params=[-1.0])
    experiment = read_trial(path).experiment

    default_omega = Experiment().omega
    assert experiment.activation == "always"
    assert experiment.omega == default_omega


def test_a_robot_whose_b_hat_became_nan_has_a_nan_as_its_error_and_the_swarm_a_score(tmp_path: Path) -> None:
    """Two of five robots are flawed. The authors' files have them last, and results have them first.

    So the last robot of the file is the second of the results. Its estimates are lost in the last step, 60,
    as can happen in the authors' programs and in our float reference.
    The numbers of a step are -1, n, t, x_hat, alpha, x_bar, beta, x, and b_hat on black and on white.
    """
    texts_by_robot = trial_content(FIXED_NETWORK, number=0)["data_str"]
    *_, texts_of_last_robot = texts_by_robot
    texts_of_last_robot[60] = "-1,30,60,nan,nan,0.5,1.0,nan,nan,nan,"
    path = write_trial(tmp_path / "trial.json", FIXED_NETWORK, number=0, data_str=texts_by_robot)
    trials = read_trial(path)

    [errors_by_robot] = trials.errors  # of the only trial
    assert np.isnan(errors_by_robot).tolist() == [False, True, False, False, False]
    assert np.isfinite(trials.scores()["H"]).all()


# --- Files and folders -----------------------------------------------------------------------------------


def test_all_json_files_of_a_folder_and_below_are_found_once(tmp_path: Path) -> None:
    """The arguments are a folder and one of its two files of JSON again. A text file there is left out."""
    subfolder = tmp_path / "flw2"
    subfolder.mkdir()
    for path in (subfolder / "t1.json", subfolder / "t0.json", tmp_path / "notes.txt"):
        path.touch()
    files = find_trial_files([tmp_path, subfolder / "t0.json"])

    assert [path.name for path in files] == ["t0.json", "t1.json"]


def test_a_folder_without_any_json_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"there is no \.json file in .* or below"):
        find_trial_files([tmp_path])


@pytest.mark.parametrize("path", ["no/such.json", "/dev/zero"])
def test_a_missing_file_and_a_device_are_refused_as_no_files(path: str) -> None:
    with pytest.raises(UsageError, match=f"{path} is no file; give files, or folders"):
        find_trial_files([Path(path)])


def test_two_files_of_one_trial_are_refused_by_their_names(tmp_path: Path) -> None:
    """Else the trial would count twice. Without ``list`` nothing would be read, as trials are yielded."""
    first_path = write_trial(tmp_path / "a.json", FIXED_NETWORK, number=1)
    second_path = write_trial(tmp_path / "b.json", FIXED_NETWORK, number=1)
    with pytest.raises(UsageError, match=r"b\.json and .*a\.json are both trial 1 of an experiment"):
        list(read_trials([first_path, second_path], sampling_interval=0))


@pytest.fixture
def authors_results(tmp_path: Path) -> Path:
    """A file of results with one trial that was read from the authors' format."""
    path = tmp_path / "theirs.parquet"
    trials = read_trial(write_trial(tmp_path / "trial.json", FIXED_NETWORK, number=0))
    write_tables(path, [trials_to_table(trials)])
    return path


def test_a_sweep_does_not_take_results_of_the_authors_programs_for_its_own(authors_results: Path) -> None:
    """The file has a trial of the same experiment, which a sweep into this file would leave out."""
    with pytest.raises(UsageError, match="hold results of other experiments"):
        Store(authors_results, [FIXED_NETWORK])


# --- What is refused -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("changed_keys", "expected_message"),
    [
        ({"num_robots": None}, "it has no num_robots; give a trial of"),
        ({"num_robots": "5"}, "robots is '5'; give a number (their num_robots)"),
        ({"num_robots": 6}, "data_str must be 6 lists, one of each robot"),
        ({"num_flawed_robots": 9}, "flawed is 9;"),
        ({"num_flawed_robots": 9}, " (their num_flawed_robots)"),
        ({"num_steps": 61}, "data_str of robot 0: it must be a list of 62 texts"),
        ({"tfr": 1.5}, "fill_ratio is 1.5; it must be 0 to 1 (their tfr)"),
        ({"tfr": 10**400}, "; give a number (their tfr)"),
        ({"comms_period": 7}, "filter_period is 20; it must be a multiple of comms_period, 7"),
        ({"trial_ind": 3}, "trial_ind is 3; it must be 0 to 2, as num_trials says"),
        ({"trial_ind": "1"}, "trial_ind is '1'; it must be a number"),
        ({"sim_type": None}, "it has no sim_type; give a trial of"),
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
def test_a_trial_with_a_parameter_that_cannot_be_run_is_refused_with_its_name(
    changed_keys: dict[str, Any], expected_message: str, tmp_path: Path
) -> None:
    """A valid trial is changed in one key of the authors' format. A change to None leaves the key out."""
    path = write_trial(tmp_path / "trial.json", FIXED_NETWORK, number=0, **changed_keys)
    with pytest.raises(UsageError) as refusal:
        read_trial(path)
    assert str(refusal.value).startswith(f"{path}: ")
    assert expected_message in str(refusal.value)


@pytest.mark.parametrize(
    ("key", "value", "expected_message"),
    [
        ("obs_queue_size", 1000, "a queue of observations is not the paper's"),
        ("comms_range", -1.0, "radio_range is -1.0"),
        ("density", -1.0, "density is -1.0"),
        ("speed", "14.14", "speed is '14.14'; it must be a number"),
        ("density", True, "density is True; it must be a number"),
        ("speed", 10**400, "; it must be a number"),
    ],
)
def test_a_trial_with_a_parameter_that_moving_robots_cannot_have_is_refused_with_its_name(
    key: str, value: object, expected_message: str, tmp_path: Path
) -> None:
    """The file uses the authors' keys. The message uses our names, such as radio_range."""
    path = write_trial(tmp_path / "trial.json", MOVING_SWARM, number=0, **{key: value})
    with pytest.raises(UsageError) as refusal:
        read_trial(path)
    assert expected_message in str(refusal.value)


@pytest.mark.parametrize(
    ("text_of_step", "expected_message"),
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
def test_values_that_no_robot_can_have_are_refused_with_their_robot_and_step(
    text_of_step: object, expected_message: str, tmp_path: Path
) -> None:
    """Step 7 of robot 3 is replaced. Its ten numbers are -1, n, t, x_hat, alpha, x_bar, beta, x, and b_hat
    on black and on white."""
    robot, step = 3, 7
    texts_by_robot = trial_content(FIXED_NETWORK, number=0)["data_str"]
    texts_by_robot[robot][step] = text_of_step
    path = write_trial(tmp_path / "trial.json", FIXED_NETWORK, number=0, data_str=texts_by_robot)

    with pytest.raises(UsageError) as refusal:
        read_trial(path)
    assert str(refusal.value).startswith(f"{path}: data_str of robot 3: ")
    assert expected_message in str(refusal.value)


@pytest.mark.parametrize(
    ("content", "expected_message"),
    [
        ("", "Expecting value"),
        ("[1, 2]", "it is no trial but list"),
        ('{"sim_type": "static_topo_static_degrad_1d"', "Expecting ',' delimiter"),
        ("[" * 100_000, "recursion"),
    ],
    ids=["empty", "a list", "cut off", "nested too deeply"],
)
def test_a_file_without_a_json_object_is_refused(content: str, expected_message: str, tmp_path: Path) -> None:
    path = tmp_path / "trial.json"
    path.write_text(content, encoding="utf-8")

    with pytest.raises(UsageError) as refusal:
        read_trial(path)
    assert expected_message in str(refusal.value)
