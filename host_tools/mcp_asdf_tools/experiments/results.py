"""Results of trials in memory, the choice of experiments among them, and their summary as CSV."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mcp_asdf_tools.common.errors import UsageError, did_you_mean
from mcp_asdf_tools.common.files import write_atomically
from mcp_asdf_tools.common.parameters import parameters_of
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.metrics import score
from mcp_asdf_tools.experiments.scores import PAPER_LIMITS, SCORES, Limits

QUANTITIES = ("t", "n", "x_hat", "alpha", "x_bar", "beta", "x", "b_hat")
"""Recorded values of a robot, named as the attributes of ``Robot``."""

HARM_LIMIT = 0.05
"""A healthy robot whose b_hat ends farther from its first value than this has been harmed by its filter."""

PARAMETER_NAMES = tuple(parameters_of(Experiment))

_SUFFIXES = (".parquet", ".pq")
"""Suffixes of files of results, in upper or lower case."""


def is_results_path(path: Path) -> bool:
    """Return whether the suffix of a path is that of a file of results; other recordings are logs."""
    return path.suffix.lower() in _SUFFIXES


@dataclass(frozen=True)
class Trials:
    """Some or all trials of one experiment; the first axis of each array is the trial.

    N is the number of robots, and T the number of steps.

    Attributes:
        experiment: The definition; its ``trials`` may be more than these.
        numbers: The trials' numbers.
        convergence_steps: K of each robot, the step from which on its x stays within 0.01; shape (trials, N).
        errors: e of each robot, its error |x - f| at that step; shape (trials, N).
        b_hat: Assumed accuracies after each filter step, shape (trials, T // filter_period, N).
        tests: Hypothesis tests run by each robot, shape (trials, N), modulo 65536, as ``updates``.
        updates: Re-estimates of b_hat by each robot, shape (trials, N).
        records: QUANTITIES by name, at step 0 and every ``sampling_interval`` steps, shape
            (trials, T // sampling_interval + 1, N); empty without recording.
        sampling_interval: In steps; 0 without recording.
        source: The program whose trials these are; empty if it is this one, which can run them again.
    """

    experiment: Experiment
    numbers: list[int]
    convergence_steps: NDArray[np.int64]
    errors: NDArray[np.float64]
    b_hat: NDArray[np.float64]
    tests: NDArray[np.int64]
    updates: NDArray[np.int64]
    records: dict[str, NDArray[np.float64]]
    sampling_interval: int = 0
    source: str = ""

    def index_of(self, number: int) -> int:
        """Return the index of the trial of this number. Raises UsageError if there is none."""
        if number not in self.numbers:
            existing_numbers = f"{self.numbers[0]} to {self.numbers[-1]}"
            raise UsageError(f"there is no trial {number}; choose one of {existing_numbers}")
        return self.numbers.index(number)

    def scores(self, limits: Limits = PAPER_LIMITS) -> dict[str, NDArray[np.float64]]:
        """Return the scores H, h_K and h_e of each trial by the score's name, relative to ``limits``."""
        return score(self.convergence_steps, self.errors, *limits.of(self.experiment))

    def measures(self, limits: Limits = PAPER_LIMITS) -> dict[str, NDArray[np.float64 | np.signedinteger]]:
        """Return the measures of the trials by name. Each measure has one value per trial.

        The names are those of the scores, "K" and "e" for the means of convergence steps and errors over the
        robots, and "updates" for the sum of the robots' re-estimates of b_hat.
        """
        robot_axis = 1  # of the shape (trials, N)
        return {
            **self.scores(limits),
            "K": self.convergence_steps.mean(axis=robot_axis),
            "e": self.errors.mean(axis=robot_axis),
            "updates": self.updates.sum(axis=robot_axis),
        }

    def mean_errors_over_time(self) -> NDArray[np.float64]:
        """Return the mean error |x - f| over the robots at each recorded step, shape (trials, samples).

        x is a robot's recorded estimate, and f the share of black floor. Raises KeyError if x was not
        recorded.
        """
        robot_axis = 2  # of the shape (trials, samples, N)
        errors = abs(self.records["x"] - self.experiment.fill_ratio)
        mean_errors: NDArray[np.float64] = errors.mean(axis=robot_axis)
        return mean_errors

    @property
    def final_b_hat(self) -> NDArray[np.float64]:
        """The robots' b_hat after the last filter step, shape (trials, N); NaN if there was none."""
        trial_count, filter_step_count, robots = self.b_hat.shape
        if filter_step_count == 0:
            return np.full((trial_count, robots), np.nan)
        return self.b_hat[:, -1]

    def find_harmed_robots(self) -> NDArray[np.bool_]:
        """Return which of the healthy robots their filter has harmed, shape (trials, healthy robots).

        A robot is harmed if its b_hat, the accuracy that it assumes, is more than HARM_LIMIT from its initial
        b_hat after the last filter step. In trials that end before the first filter step no robot is. The
        first robots are the flawed ones, and all others start with the same b_hat.
        """
        final_b_hat_of_healthy_robots = self.final_b_hat[:, self.experiment.flawed :]
        last_robot = self.experiment.robots - 1
        initial_b_hat = self.experiment.b_hat(last_robot)
        # Without a filter step the difference is NaN, and so above no limit.
        return np.asarray(abs(final_b_hat_of_healthy_robots - initial_b_hat) > HARM_LIMIT)


def select_experiments(experiments: Sequence[Trials], where: Mapping[str, Any]) -> list[Trials]:
    """Return the experiments whose parameters have the values in ``where``.

    A number may be written in any way: 300, "300" and "3e2" are equal. Raises UsageError for a name that is
    no parameter, and with the existing values if no experiment is left.
    """
    selected = list(experiments)
    for parameter_name, value in where.items():
        if parameter_name not in PARAMETER_NAMES:
            nearest = did_you_mean(parameter_name, PARAMETER_NAMES)
            raise UsageError(
                f"where {parameter_name}={value}: no parameter is called so{nearest}; "
                f"the experiments differ in {describe_differences(selected)}"
            )
        selected = _select_by_value(selected, parameter_name, value)
    return selected


def _select_by_value(experiments: Sequence[Trials], parameter_name: str, value: Any) -> list[Trials]:
    """Return the experiments in which a parameter has a value, which may be given as a text or a number.

    Raises UsageError, with the existing values, if no experiment has it.
    """
    existing_texts: set[str] = set()
    selected = []
    for trials in experiments:
        existing_value = trials.experiment.parameters()[parameter_name]
        existing_texts.add(str(existing_value))
        if _is_same_value(existing_value, value):
            selected.append(trials)
    if not selected:
        alternatives = " or ".join(sorted(existing_texts))
        raise UsageError(
            f"where {parameter_name}={value}: no experiment has it; {parameter_name} is {alternatives}"
        )
    return selected


def single_experiment(experiments: Sequence[Trials]) -> Trials:
    """Return the only experiment of ``experiments``, of which there must be at least one.

    Raises UsageError, with the parameters that would select one, if there are several.
    """
    if len(experiments) > 1:
        differences = describe_differences(experiments)
        raise UsageError(f"{len(experiments)} experiments match; choose one with where {differences}")
    return experiments[0]


def describe_differences(experiments: Sequence[Trials]) -> str:
    """Return the parameters in which experiments differ, with their values: ``seed=1|2, filter=none|robust``.

    Returns "no parameters" if they do not differ.
    """
    differing_values = find_differences(trials.experiment.parameters() for trials in experiments)
    differences = []
    for parameter_name, values in differing_values.items():
        value_texts = sorted(str(value) for value in values)
        differences.append(f"{parameter_name}={'|'.join(value_texts)}")
    return ", ".join(differences) or "no parameters"


def find_differences(parameters_of_experiments: Iterable[Mapping[str, Any]]) -> dict[str, set[Any]]:
    """Return the values of those parameters in which experiments differ, by the names of the parameters."""
    values_by_parameter: dict[str, set[Any]] = {name: set() for name in PARAMETER_NAMES}
    for parameters in parameters_of_experiments:
        for name, value in parameters.items():
            values_by_parameter[name].add(value)
    return {name: values for name, values in values_by_parameter.items() if len(values) > 1}


def _is_same_value(parameter_value: object, requested_value: Any) -> bool:
    """Return whether a parameter has the requested value, as a text or as a number."""
    if str(parameter_value) == str(requested_value):
        # Words, such as the name of a filter, and numbers that are written as this program prints them.
        return True
    if not isinstance(parameter_value, int | float):
        return False
    try:
        return float(requested_value) == parameter_value
    except (TypeError, ValueError):  # the requested value is no number
        return False


def write_csv(path: Path, experiments: Iterable[Trials], limits: Limits = PAPER_LIMITS) -> None:
    """Write a CSV file with a header and a line for each trial.

    A line has the parameters and the trial's number; its scores H, h_K and h_e with these ``limits``; over
    the robots, the means of the convergence step K, of the error e then and of the final b_hat, and the sums
    of tests and updates; and the limits. An existing file is replaced when the new one is complete. Raises
    UsageError if it cannot be written.
    """
    csv_text = io.StringIO()
    writer = csv.writer(csv_text, lineterminator="\n")
    writer.writerow([*PARAMETER_NAMES, "trial", *_CSV_RESULT_COLUMNS])
    for trials in experiments:
        # A line repeats its experiment's parameters, so that it can be read alone.
        parameters = list(trials.experiment.parameters().values())
        results = _csv_results(trials, limits)
        for index, number in enumerate(trials.numbers):
            values = [f"{results[name][index]:.10g}" for name in _CSV_RESULT_COLUMNS]
            writer.writerow([*parameters, number, *values])
    write_atomically(path, csv_text.getvalue())


_CSV_RESULT_COLUMNS = (*SCORES, "mean_K", "mean_e", "mean_b_hat", "tests", "updates", "K_max", "e_max")
"""Columns of a CSV file behind the parameters and the number of the trial."""


def _csv_results(trials: Trials, limits: Limits) -> dict[str, NDArray[Any]]:
    """Return the columns of a CSV file that have results, by name. Each column has one value per trial.

    Besides the columns of _CSV_RESULT_COLUMNS there are measures that the file does not have.
    """
    k_max, e_max = limits.of(trials.experiment)
    trial_count = len(trials.numbers)
    robot_axis = 1  # of the shape (trials, N)
    measures = trials.measures(limits)
    return {
        **measures,
        "mean_K": measures["K"],
        "mean_e": measures["e"],
        "mean_b_hat": trials.final_b_hat.mean(axis=robot_axis),
        "tests": trials.tests.sum(axis=robot_axis),
        # The same in all lines of an experiment, but any line can be read alone.
        "K_max": np.full(trial_count, k_max),
        "e_max": np.full(trial_count, e_max),
    }
