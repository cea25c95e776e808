"""Files of the paper's authors' programs: parameters in YAML, results in JSON."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from mcp_asdf_tools.common import ParameterError, UsageError, write_atomically
from mcp_asdf_tools.experiments.experiment import MAX_EXPERIMENTS, Experiment
from mcp_asdf_tools.experiments.results import Trials
from mcp_asdf_tools.robots import Activation, Filtering


@dataclass(frozen=True)
class _Value:
    """A scalar of a YAML file, as written, and where."""

    text: str
    line: int


_RANGE = "flawedRobotRange"


_OMEGA = "filterSpecificParams.type_2_err_prob"


_KEYS = {
    "numRobots": "robots",
    f"{_RANGE}.min": "flawed",
    f"{_RANGE}.max": "flawed",
    f"{_RANGE}.incSteps": "",
    "commsPeriod": "comms_period",
    "flawedSensorAccB": "flawed_accuracy",
    "flawedSensorAccW": "",
    "flawedSensorCovariance": "",
    "correctSensorAccB": "true_accuracy",
    "correctSensorAccW": "",
    "targFillRatio": "fill_ratio",
    "sensorFilterPeriod": "filter_period",
    "numSteps": "steps",
    "numTrials": "trials",
    "fullyConnected": "topology",
    "method": "activation",
    _OMEGA: "omega",
    "correctFilter": "filter",
}
"""Their keys, a dot for a level, and what the plain numbers among them are here."""


_METHODS = {"ALPHA": "always", "BRAVO": "adaptive"}


_SWITCHES = {"true": True, "yes": True, "on": True, "false": False, "no": False, "off": False}


class _Parameters:
    """The authors' parameters by key, every one present."""

    def __init__(self, path: Path, text: str) -> None:
        self._path = path
        try:
            node = yaml.compose(text, Loader=yaml.SafeLoader)
        except (yaml.YAMLError, ValueError, RecursionError) as error:
            raise UsageError(f"{path}: {error}") from error
        if not isinstance(node, yaml.MappingNode):
            raise UsageError(f"{path}: no parameters; write lines like numRobots: 10")
        self._values = dict(self._flatten("", node))
        optional = {_OMEGA} if self._values.get("method", _Value("", 0)).text == "ALPHA" else set()
        if missing := [key for key in _KEYS if key not in self._values and key not in optional]:
            end = text.rstrip().count("\n") + 1
            raise UsageError(f"{path}, line {end}: the file ends without {', '.join(missing)}; add it")

    def _flatten(self, prefix: str, node: yaml.MappingNode) -> Iterator[tuple[str, _Value]]:
        seen: set[str] = set()
        for key_node, value in node.value:
            line = key_node.start_mark.line + 1
            if not isinstance(key_node, yaml.ScalarNode):
                raise UsageError(f"{self._path}, line {line}: a key is a list or a table; give it a name")
            key = f"{prefix}{key_node.value}"
            if key in seen:
                raise UsageError(f"{self._path}, line {line}: {key} stands here twice; leave one")
            seen.add(key)
            if (
                isinstance(value, yaml.MappingNode)
                and not prefix
                and any(k.startswith(f"{key}.") for k in _KEYS)
            ):
                yield from self._flatten(f"{key}.", value)
            elif key not in _KEYS:
                raise UsageError(
                    f"{self._path}, line {line}: unknown key {key!r}; known are {', '.join(_KEYS)}"
                )
            elif not isinstance(value, yaml.ScalarNode):
                raise UsageError(f"{self._path}, line {line}: {key} is no single value; give one")
            else:
                yield key, _Value(value.value, line)

    def has(self, key: str) -> bool:
        """True if ``key`` is given."""
        return key in self._values

    def error(self, key: str, message: str) -> UsageError:
        """An error at ``key``."""
        return UsageError(f"{self._path}, line {self._values[key].line}: {message}")

    def number(self, key: str) -> float:
        """The value as a number, however it is written: 40000, 4e4, 4.0e+4."""
        try:
            return float(self._values[key].text)
        except ValueError:
            raise self.error(key, f"{key} is {self._values[key].text!r}; give a number") from None

    def whole(self, key: str) -> int:
        """The value as a whole number."""
        value = self.number(key)
        if value % 1 != 0:
            raise self.error(key, f"{key} is {value:g}; it must be a whole number")
        return int(value)

    def switch(self, key: str) -> bool:
        """The value as true or false."""
        return bool(self._one_of(key, _SWITCHES, self._values[key].text.lower()))

    def method(self) -> str:
        """Our word for their method."""
        return str(self._one_of("method", _METHODS, self._values["method"].text.upper()))

    def _one_of(self, key: str, choices: dict[str, Any], value: str) -> Any:
        if value not in choices:
            raise self.error(key, f"{key} is {self._values[key].text!r}; choose one of {', '.join(choices)}")
        return choices[value]


def read_yaml(path: Path, text: str) -> list[Experiment]:
    given = _Parameters(path, text)
    _check_unsupported(given)
    parameters: dict[str, Any] = {
        ours: given.number(theirs)
        for theirs, ours in _KEYS.items()
        if ours not in ("", "activation", "filter", "flawed", "topology") and given.has(theirs)
    }
    parameters["activation"] = given.method()
    if not given.switch("fullyConnected"):
        parameters |= {"topology": "dynamic", "latency": 1}
    parameters["filter"] = "asdf-plus" if given.switch("correctFilter") else "asdf-minus"
    experiments = []
    for flawed in _flawed_counts(given):
        try:
            experiments.append(Experiment.from_parameters({**parameters, "flawed": flawed}))
        except ParameterError as error:
            # What is not theirs has our default, which fullyConnected chose.
            theirs = {ours: theirs for theirs, ours in _KEYS.items()}.get(error.key, "fullyConnected")
            raise given.error(theirs, f"{theirs}: {error}") from error
    return experiments


def _check_unsupported(given: _Parameters) -> None:
    given.number("flawedSensorCovariance")  # which their simulator does not use either
    for sensor in ("flawedSensorAcc", "correctSensorAcc"):
        black, white = given.number(f"{sensor}B"), given.number(f"{sensor}W")
        if black != white:
            message = (
                f"{sensor}W is {white:g} and {sensor}B {black:g}; make them equal: sensors have one accuracy"
            )
            raise given.error(f"{sensor}W", message)


def _flawed_counts(given: _Parameters) -> Sequence[int]:
    """``incSteps`` numbers of flawed robots, evenly from ``min`` to ``max``."""
    least, most = given.whole(f"{_RANGE}.min"), given.whole(f"{_RANGE}.max")
    count = given.whole(f"{_RANGE}.incSteps")
    if (
        not 1 <= count <= MAX_EXPERIMENTS
        or (count == 1) != (least == most)
        or (most - least) % max(1, count - 1)
    ):
        message = f"incSteps is {count}; it must reach from min {least} to max {most} in equal whole steps"
        raise given.error(f"{_RANGE}.incSteps", message)
    return [least + (most - least) * index // max(1, count - 1) for index in range(count)]


def write_authors_json(folder: Path, trials: Trials) -> list[Path]:
    """Write a file for each trial as the simulator of the paper's authors does; returns their paths.

    A robot's row of a step is "seed,n,t,x_hat,alpha,x_bar,beta,x,b_hat,w_hat", from step 0 on. Raises
    UsageError if not every step was recorded or the folder cannot be written.
    """
    if not trials.records or trials.records["t"].shape[1] != trials.experiment.steps + 1:
        raise UsageError("the authors' layout holds every step; record with a sampling interval of 1")
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UsageError(f"cannot make the folder {folder}: {error.strerror}; choose another") from error
    paths = []
    for index, number in enumerate(trials.numbers):
        paths.append(folder / f"f{trials.experiment.flawed}_t{number}.json")
        content = _authors_parameters(trials.experiment) | {
            "trial_ind": number,
            "data_str": _data_rows(trials, index),
        }
        write_atomically(paths[-1], json.dumps(content))
    return paths


def _data_rows(trials: Trials, index: int) -> list[list[str]]:
    """Rows by robot and step."""
    order = ("n", "t", "x_hat", "alpha", "x_bar", "beta", "x", "b_hat", "b_hat")
    values = np.stack([trials.records[name][index] for name in order], axis=-1).swapaxes(0, 1)
    seed = trials.experiment.seed
    return [
        [",".join([str(seed), *(f"{value:.12g}" for value in row)]) for row in robot]
        for robot in values.tolist()
    ]


def _authors_parameters(experiment: Experiment) -> dict[str, Any]:
    adaptive = experiment.activation is Activation.ADAPTIVE
    return {
        "sim_type": f"{'dynamic' if experiment.is_dynamic else 'static'}_topo_static_deg",
        "method": "BRAVO" if adaptive else "ALPHA",
        "num_robots": experiment.robots,
        "num_flawed_robots": experiment.flawed,
        "num_correct_robots": experiment.robots - experiment.flawed,
        "num_steps": experiment.steps,
        "num_trials": experiment.trials,
        "comms_period": experiment.comms_period,
        "sensor_filter_period": experiment.filter_period,
        "tfr": experiment.fill_ratio,
        "flawed_sensor_acc_b": experiment.flawed_accuracy,
        "flawed_sensor_acc_w": experiment.flawed_accuracy,
        "correct_sensor_acc_b": experiment.true_accuracy,
        "correct_sensor_acc_w": experiment.true_accuracy,
        "correct_robot_filter": experiment.filter is Filtering.ASDF_PLUS,
        "fully_connected": not experiment.is_dynamic,
        "filter_specific_params": {"type_2_err_prob": float(experiment.omega)} if adaptive else {},
    }
