"""Trial files of the paper's authors: the JSON that their simulators write, read as ``Trials``.

A file has one trial: its parameters by name, and under ``data_str`` a list for each robot with a text for
each step from 0 on. A text is numbers with commas between. The first ten are: seed, n, t, x_hat, alpha,
x_bar, beta, x, and the accuracies that the robot assumes on black and on white. Numbers from x_hat on have
six decimal places. The flawed robots are the last ones.

The format was read in github.com/NESTLab/sensor-degradation-filter at commit 7bc1acc. There
``scripts/python/sim_module.py`` writes the trials of fixed networks, and
``src/loop_functions/SensorDegLoopFunctions.cpp`` those of robots that move in ARGoS. Versions since
12 June 2024 write the same numbers; before, the seed was missing.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.common.files import read_at_most
from mcp_asdf_tools.common.parameters import ParameterError
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.results import QUANTITIES, Trials
from mcp_asdf_tools.experiments.trials import convergence_and_errors

SOURCE = "NESTLab/sensor-degradation-filter"
"""``Trials.source`` of trials that come from these files."""

_MAX_FILE_BYTES = 2**30
"""Maximum size of a file. One of 20 robots and 40,000 steps has 103 MB."""

_COLUMN_NAMES = ("n", "t", "x_hat", "alpha", "x_bar", "beta", "x", "b_hat", "b_hat on white")
"""What the numbers of a text mean, without the seed, which is the first."""
_QUANTITIES_FROM_0_TO_1 = ("x_hat", "x_bar", "x", "b_hat")
_CONFIDENCES = ("alpha", "beta")

_KEY_BY_PARAMETER = {
    "robots": "num_robots",
    "flawed": "num_flawed_robots",
    "steps": "num_steps",
    "trials": "num_trials",
    "fill_ratio": "tfr",
    "true_accuracy": "correct_sensor_acc_b",
    "flawed_accuracy": "flawed_sensor_acc_b",
    "comms_period": "comms_period",
    "filter_period": "sensor_filter_period",
}
"""Their keys of the parameters that all their files have, by our names."""
_MOVING_KEY_BY_PARAMETER = {
    "observation_period": "meas_period",
    "radio_range": "comms_range",
}
"""Their keys of the parameters that only files of moving robots have, with ``speed`` and ``density``."""
_CM_PER_M = 100
_DENSITY_DECIMALS = 3
"""Decimal places to which a density is rounded. The authors compute it from the positions of the walls, so
further places are only rounding errors."""
_ACTIVATION_BY_METHOD = {"BRAVO": "adaptive", "ALPHA": "always"}
"""What their methods are called here."""


def find_trial_files(paths: Iterable[Path]) -> list[Path]:
    """Return the files among ``paths``, and all .json files in the folders among them and below.

    They are sorted, and each is there once. Raises UsageError for a path that is neither a file nor a folder,
    and for a folder without such files.
    """
    files = []
    for path in paths:
        if path.is_dir():
            files_below = [file for file in path.rglob("*.json") if file.is_file()]
            if not files_below:
                raise UsageError(
                    f"there is no .json file in {path} or below; give the folder of their trials"
                )
            files += files_below
        elif path.is_file():
            files.append(path)
        else:
            raise UsageError(f"{path} is no file; give files, or folders, of the authors' trials")
    return sorted(set(files))


def read_trials(files: Iterable[Path], sampling_interval: int) -> Iterator[Trials]:
    """Yield the trial of each file, with values recorded every ``sampling_interval`` steps (0: never).

    Only one trial is in memory at a time. Raises UsageError, which names the file and what is wrong with it,
    for one that is no trial, that the paper's method cannot have made, or that repeats an earlier trial.
    """
    file_of_trial: dict[tuple[Experiment, int], Path] = {}
    for path in files:
        trials = _read_trial(path, sampling_interval)
        [number] = trials.numbers
        key = (trials.experiment, number)
        if key in file_of_trial:
            raise UsageError(
                f"{path} and {file_of_trial[key]} are both trial {number} of an experiment; give one of them"
            )
        file_of_trial[key] = path
        yield trials


def _read_trial(path: Path, sampling_interval: int) -> Trials:
    """Return the trial in a file, with values recorded every ``sampling_interval`` steps (0: never).

    A robot has updated its b_hat in each filter step in which b_hat changed; its number of tests, which the
    file does not have, is 0. Raises UsageError, which names the file and what is wrong with it, if it is no
    trial, or one that the paper's method cannot have made.
    """
    file = _TrialFile(path, _read_json(path))
    experiment = _experiment_of(file)
    number = _trial_number(file, experiment)
    history = _read_history(file, experiment)
    # The first axis of all arrays of ``Trials`` is the trial, of which there is one.
    x_series = history["x"].T[np.newaxis]  # shape (1, N, steps + 1)
    convergence_steps, errors = convergence_and_errors(experiment, x_series, unit=1.0)
    b_hat_at_filter_steps = history["b_hat"][:: experiment.filter_period]  # from step 0 on
    records = {}
    if sampling_interval:
        records = {name: history[name][np.newaxis, ::sampling_interval] for name in QUANTITIES}
    return Trials(
        experiment=experiment,
        numbers=[number],
        convergence_steps=convergence_steps,
        errors=errors,
        b_hat=b_hat_at_filter_steps[np.newaxis, 1:],
        tests=np.zeros((1, experiment.robots), np.int64),  # their files do not say
        updates=_count_changes(b_hat_at_filter_steps)[np.newaxis],
        records=records,
        sampling_interval=sampling_interval,
        source=SOURCE,
    )


def _trial_number(file: _TrialFile, experiment: Experiment) -> int:
    """Return the number of the trial in a file. Raises UsageError if the experiment has no such trial."""
    number = file.number("trial_ind")
    # A range holds no number with a fraction.
    if number not in range(experiment.trials):
        raise file.error("trial_ind", f"it must be 0 to {experiment.trials - 1}, as num_trials says")
    return int(number)


def _count_changes(b_hat: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return how often b_hat has changed in each robot, shape (N,).

    ``b_hat`` has the values of the robots at successive times, shape (times, N).
    """
    b_hat_before, b_hat_after = b_hat[:-1], b_hat[1:]
    # NaN, where their programs have divided by 0, is no change.
    has_changed = (b_hat_after != b_hat_before) & ~np.isnan(b_hat_after)
    time_axis = 0
    changes: NDArray[np.int64] = has_changed.sum(axis=time_axis)
    return changes


# --- Parameters ------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _TrialFile:
    """The content of a trial file, with errors that name the file and the key.

    Attributes:
        path: The file.
        content: What it has under each key.
    """

    path: Path
    content: dict[str, Any]

    def error(self, key: str, fix: str) -> UsageError:
        """Return an error that names a key and its value, and then says ``fix``.

        Raises another error, as ``value`` does, if the key is missing.
        """
        return UsageError(f"{self.path}: {key} is {self.value(key)!r}; {fix}")

    def value(self, key: str) -> Any:
        """Return what the file has under a key. Raises UsageError if it has nothing."""
        if key not in self.content:
            raise UsageError(f"{self.path}: it has no {key}; give a trial of {SOURCE}")
        return self.content[key]

    def number(self, key: str) -> float:
        """Return the number under a key.

        Raises UsageError if there is none that a float can hold. A text is no number, although float() would
        read it, and neither are true and false.
        """
        value = self.value(key)
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise self.error(key, "it must be a number")
        try:
            return float(value)
        except OverflowError as error:  # a number of hundreds of digits
            raise self.error(key, "it must be a number") from error


def _read_json(path: Path) -> dict[str, Any]:
    """Return the JSON object in a file.

    Raises UsageError if the file has none, cannot be read, or has more than _MAX_FILE_BYTES bytes.
    """
    try:
        content = json.loads(read_at_most(path, _MAX_FILE_BYTES))
    except OSError as error:
        raise UsageError(f"cannot read {path}: {error.strerror or error}") from error
    except (ValueError, RecursionError) as error:  # no JSON, or no UTF-8, or too large
        raise UsageError(f"cannot read {path}: {error}") from error
    if not isinstance(content, dict):
        raise UsageError(f"{path}: it is no trial but {type(content).__name__}; give a trial of {SOURCE}")
    return content


def _experiment_of(file: _TrialFile) -> Experiment:
    """Return the experiment that a file has a trial of.

    Its firmware is the reference with the authors' conventions, and its seed is 0, since their draws cannot
    be repeated here. It has no filter if the filtering period is longer than a trial. Moving robots have a
    latency of 1, and their speed is converted from cm to m. Raises UsageError for parameters that no
    experiment here has.
    """
    parameters: dict[str, Any] = {"firmware": "reference", "conventions": "authors", "seed": 0}
    if _has_moving_robots(file):
        parameters |= _parameters_of_motion(file)
    parameters |= {name: file.value(key) for name, key in _KEY_BY_PARAMETER.items()}
    _check_sensors(file)
    parameters |= _filter_parameters(file)
    try:
        experiment = Experiment(**parameters)
    except ParameterError as error:
        their_key = (_KEY_BY_PARAMETER | _MOVING_KEY_BY_PARAMETER).get(error.key)
        hint = f" (their {their_key})" if their_key else ""
        raise UsageError(f"{file.path}: {error}{hint}") from error
    # A period that never ends in a trial is their way to switch the filter off.
    if experiment.filter_period > experiment.steps:
        return replace(experiment, filter="none")
    return experiment


def _parameters_of_motion(file: _TrialFile) -> dict[str, Any]:
    """Return the parameters that only moving robots have. Raises UsageError if the file lacks one."""
    return {
        "topology": "dynamic",
        "latency": 1,
        # Without rounding, 14.14 cm would be 0.14140000000000003 m or the like.
        "speed": round(file.number("speed") / _CM_PER_M, 9),
        "density": round(file.number("density"), _DENSITY_DECIMALS),
        **{name: file.value(key) for name, key in _MOVING_KEY_BY_PARAMETER.items()},
    }


def _has_moving_robots(file: _TrialFile) -> bool:
    """Return whether a file is of robots that move, which the authors simulated with ARGoS.

    False stands for a network of robots that stay where they are. Raises UsageError for any other kind of
    simulation, for moving robots with a queue of observations, and for a network in which not all robots are
    neighbours: none of these has an equivalent here.
    """
    simulation = file.content.get("sim_type")
    if simulation == "dynamic_topo_static_deg_1d":
        if file.content.get("obs_queue_size", 0) != 0:  # versions before November 2024 had none
            raise file.error("obs_queue_size", "a queue of observations is not the paper's")
        return True
    if simulation == "static_topo_static_degrad_1d":
        if file.content.get("fully_connected") is not True:
            raise file.error("fully_connected", "neighbours that are drawn anew are not the paper's")
        return False
    raise file.error(
        "sim_type", "it must be static_topo_static_degrad_1d or dynamic_topo_static_deg_1d, of the paper"
    )


def _check_sensors(file: _TrialFile) -> None:
    """Raise UsageError if correct or flawed sensors have another accuracy on white than on black."""
    for robots in ("correct", "flawed"):
        on_black = file.number(f"{robots}_sensor_acc_b")
        on_white = file.number(f"{robots}_sensor_acc_w")
        if on_white != on_black:
            raise file.error(
                f"{robots}_sensor_acc_w",
                f"the method knows one accuracy for both colours, and that on black is {on_black}",
            )


def _filter_parameters(file: _TrialFile) -> dict[str, Any]:
    """Return the parameters "filter" and "activation" of a file, and "omega" if its method is BRAVO.

    Omega is the error probability of the test in BRAVO; the other method, ALPHA, has no test. Raises
    UsageError if a value in the file is not one of the paper's.
    """
    method = file.content.get("method")
    if not isinstance(method, str) or method not in _ACTIVATION_BY_METHOD:
        raise file.error("method", f"the paper's methods are {' and '.join(_ACTIVATION_BY_METHOD)}")
    all_robots_filter = file.content.get("correct_robot_filter")
    if not isinstance(all_robots_filter, bool):
        raise file.error("correct_robot_filter", "it must be true or false")
    parameters = {
        "filter": "asdf-plus" if all_robots_filter else "asdf-minus",
        "activation": _ACTIVATION_BY_METHOD[method],
    }
    if method == "BRAVO":
        # One simulator writes {"type_2_err_prob": "0.05"}, the other [0.05].
        key = "filter_specific_params"
        omegas = file.content.get(key)
        if isinstance(omegas, dict):
            omegas = list(omegas.values())
        if not isinstance(omegas, list) or len(omegas) != 1:
            raise file.error(key, "it must have the error probability of the test alone")
        parameters["omega"] = str(omegas[0])
    return parameters


# --- Series ----------------------------------------------------------------------------------------------


def _read_history(file: _TrialFile, experiment: Experiment) -> dict[str, NDArray[np.float64]]:
    """Return the recorded values of all robots by name, shape (steps + 1, N) each, flawed robots first.

    The names are those of _COLUMN_NAMES, such as "x" and "b_hat". Raises UsageError if robots or steps are
    missing, or a number is none that a robot can have.
    """
    texts_by_robot = file.content.get("data_str")
    if not isinstance(texts_by_robot, list) or len(texts_by_robot) != experiment.robots:
        raise UsageError(f"{file.path}: data_str must be {experiment.robots} lists, one of each robot")
    numbers_by_robot = []
    for index, texts in enumerate(texts_by_robot):
        try:
            numbers_by_robot.append(_parse_texts(texts, experiment.steps))
        except ValueError as error:
            raise UsageError(f"{file.path}: data_str of robot {index}: {error}") from error
    # In the authors' files the flawed robots are the last ones. Rolled on by their number, they are the
    # first.
    flawed_robots_first = np.roll(np.stack(numbers_by_robot), experiment.flawed, axis=0)
    columns = flawed_robots_first.T  # from shape (N, steps + 1, columns) to (columns, steps + 1, N)
    return dict(zip(_COLUMN_NAMES, columns, strict=True))


def _parse_texts(texts: Any, steps: int) -> NDArray[np.float64]:
    """Return the numbers in the texts of a robot, shape (steps + 1, columns), without the seed in each.

    NaN may be among them: their programs divide by 0 where b_hat becomes 1/2. Raises ValueError if there is
    not a text for each step, and for a text or number that no robot can have.
    """
    if not isinstance(texts, list) or len(texts) != steps + 1:
        raise ValueError(f"it must be a list of {steps + 1} texts, one of each step from 0 on")
    for step, text in enumerate(texts):
        if not isinstance(text, str) or not text.strip() or "\n" in text or "\r" in text:
            raise ValueError(f"step {step} is {text!r}, and must be a line of numbers")
    columns_without_seed = range(1, 1 + len(_COLUMN_NAMES))  # the seed is column 0
    numbers = np.loadtxt(texts, delimiter=",", usecols=columns_without_seed, comments=None, ndmin=2)
    values_by_column = numbers.T  # a row for each column, with a value of each step
    _check_numbers(dict(zip(_COLUMN_NAMES, values_by_column, strict=True)))
    return numbers


def _check_numbers(series: dict[str, NDArray[np.float64]]) -> None:
    """Raise ValueError, which names the quantity and its first wrong step, if a robot cannot have a number.

    ``series`` has the numbers of one robot by the name of the quantity, shape (steps + 1,) each.
    """
    for name, is_wrong in _find_wrong_numbers(series).items():
        if is_wrong.any():
            step = int(is_wrong.argmax())  # the first one
            raise ValueError(
                f"{name} is {series[name][step]:g} in step {step}, which no robot of the paper has"
            )


def _find_wrong_numbers(series: dict[str, NDArray[np.float64]]) -> dict[str, NDArray[np.bool_]]:
    """Return arrays that are True in the steps where no robot can have the number, by the quantity's name.

    Counts must be 0 <= n <= t <= step. Estimates and accuracies are 0 to 1, and confidences 0 or more and
    finite. The b_hat on white must equal the b_hat on black. Only the counts must not be NaN.
    """
    n, t = series["n"], series["t"]
    steps = np.arange(len(t))
    # Comparisons with NaN are false: a count of NaN is wrong, and any other value of NaN is not.
    is_possible_n = (n >= 0) & (n <= t)
    is_possible_t = (t >= 0) & (t <= steps)
    is_wrong = {"n": ~is_possible_n, "t": ~is_possible_t}
    for name in _QUANTITIES_FROM_0_TO_1:
        is_wrong[name] = (series[name] < 0) | (series[name] > 1)
    for name in _CONFIDENCES:
        is_wrong[name] = (series[name] < 0) | np.isinf(series[name])
    on_black, on_white = series["b_hat"], series["b_hat on white"]
    is_nan_in_both = np.isnan(on_white) & np.isnan(on_black)
    is_wrong["b_hat on white"] = (on_white != on_black) & ~is_nan_in_both
    return is_wrong
