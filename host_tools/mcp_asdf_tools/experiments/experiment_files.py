"""Files that describe experiments: our TOML, and the YAML of the paper's authors' own simulator.

TOML: a line ``key = value`` for every attribute of Experiment that is not the default. A list in place of a
value makes a grid: one experiment for each combination. Tables ``[[grid]]`` hold grids of their own, each on
top of the keys above them. ``flawed_proportion`` may stand for ``flawed``. The path of a picture is relative
to the file's folder.

YAML: the parameter file of github.com/NESTLab/sensor-degradation-filter for its fully connected simulator, as
it is. That does not look at ``fullyConnected``; here, false stands for the paper's dynamic topology, with the
density 1 and the latency of its physics simulation.

Every error names file and line. A name without a suffix is that of a file that comes with the program, in the
folder ``studies``.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import yaml

from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.experiments.experiment import Experiment, ExperimentError

MAX_EXPERIMENTS = 100_000
STUDIES = Path(__file__).with_name("studies")
GRID = "grid"
PROPORTION = "flawed_proportion"

_HEADER = re.compile(r"\s*\[\[\s*grid\s*\]\]")
_KEY = re.compile(r"""\s*["']?([A-Za-z0-9_-]+)["']?\s*=""")


def read_experiments(path: Path) -> list[Experiment]:
    """The experiments of a file, in its order. Raises UsageError, naming the line, for what will not do."""
    if not path.suffix and not path.exists():
        path = _shipped(path)
    if path.suffix not in (".toml", ".yml", ".yaml"):
        raise UsageError(
            f"{path}: cannot tell what this is; name it .toml, or .yml for the authors' parameters"
        )
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise UsageError(f"cannot read {path}: {error}") from error
    return _read_toml(path, text) if path.suffix == ".toml" else _read_yaml(path, text)


def _shipped(name: Path) -> Path:
    shipped = {path.stem: path for path in sorted(STUDIES.glob("*.toml"))}
    if str(name) not in shipped:
        raise UsageError(f"there is no file {name}; what comes with the program is {', '.join(shipped)}")
    return shipped[str(name)]


# --- TOML ------------------------------------------------------------------------------------------------


def _read_toml(path: Path, text: str) -> list[Experiment]:
    try:
        content = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise UsageError(f"{path}: {error}") from error
    grids = content.pop(GRID, [{}])
    if not (isinstance(grids, list) and all(isinstance(grid, dict) for grid in grids)):
        raise UsageError(f"{path}: grid is no table; write [[grid]] above its keys")
    lines = _TomlLines(path, text)
    experiments: list[Experiment] = []
    for number, grid in enumerate(grids, start=1):
        for choice in _combinations({**_without_rival(content, grid), **grid}, lines, number):
            experiments.append(_experiment(choice, lines, number))
    return experiments


def _without_rival(common: dict[str, Any], grid: dict[str, Any]) -> dict[str, Any]:
    """The keys above the grids, less the one that a grid's other way to say ``flawed`` replaces."""
    rivals = {"flawed": PROPORTION, PROPORTION: "flawed"}
    return {key: value for key, value in common.items() if rivals.get(key) not in grid}


class _TomlLines:
    """Where keys stand in a file."""

    def __init__(self, path: Path, text: str) -> None:
        self.path = path
        self._of: dict[tuple[int, str], int] = {}
        grid = 0
        for number, line in enumerate(text.splitlines(), start=1):
            grid += bool(_HEADER.match(line))
            if found := _KEY.match(line):
                self._of.setdefault((grid, found[1]), number)

    def error(self, grid: int, key: str, message: str) -> UsageError:
        """An error at ``key`` of the ``grid``-th grid, or above the grids if it stands there."""
        line = self._of.get((grid, key), self._of.get((0, key)))
        return UsageError(f"{self.path}{'' if line is None else f', line {line}'}: {message}")


def _combinations(grid: dict[str, Any], lines: _TomlLines, number: int) -> Iterator[dict[str, Any]]:
    axes = [value if isinstance(value, list) else [value] for value in grid.values()]
    size = 1
    for key, axis in zip(grid, axes, strict=True):
        size *= len(axis)
        if not 0 < size <= MAX_EXPERIMENTS:
            raise lines.error(number, key, f"{key} makes {size} experiments; give 1 to {MAX_EXPERIMENTS}")
    for values in product(*axes):
        yield dict(zip(grid, values, strict=True))


def _experiment(parameters: dict[str, Any], lines: _TomlLines, number: int) -> Experiment:
    given = dict(parameters)
    if isinstance(given.get("picture"), str) and given["picture"]:
        given["picture"] = str(lines.path.parent / given["picture"])
    try:
        if PROPORTION in given:
            given = _with_count(given)
        return Experiment.from_parameters(given)
    except ExperimentError as error:
        key = PROPORTION if error.key == "flawed" and PROPORTION in parameters else error.key
        raise lines.error(number, key, str(error)) from error


def _with_count(given: dict[str, Any]) -> dict[str, Any]:
    """``given`` with the count in place of the proportion of flawed robots."""
    if "flawed" in given:
        raise ExperimentError("flawed", f"flawed and {PROPORTION} say the same; give one of them")
    rest = {key: value for key, value in given.items() if key != PROPORTION}
    robots = Experiment.from_parameters({**rest, "flawed": 0}).robots
    return {**rest, "flawed": flawed_count(given[PROPORTION], robots)}


def flawed_count(proportion: Any, robots: int) -> int:
    """P N as a whole number of robots. Raises ExperimentError if it is none or P is outside 0 .. 1."""
    is_number = isinstance(proportion, int | float) and not isinstance(proportion, bool)
    if not (is_number and 0 <= proportion <= 1):
        raise ExperimentError("flawed", f"{PROPORTION} is {proportion!r}; it must be 0 to 1")
    count: int = round(proportion * robots)
    if abs(count - proportion * robots) > 1e-9:
        share = f"{proportion} of {robots} robots is {proportion * robots:g}"
        message = f"{PROPORTION} {share}; choose one that makes whole robots"
        raise ExperimentError("flawed", message)
    return count


# --- The authors' YAML -----------------------------------------------------------------------------------


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
    "correctFilter": "mode",
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
        except yaml.YAMLError as error:
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
            key, line = f"{prefix}{key_node.value}", key_node.start_mark.line + 1
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
        """Whether ``key`` is given."""
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


def _read_yaml(path: Path, text: str) -> list[Experiment]:
    given = _Parameters(path, text)
    _check_unsupported(given)
    parameters: dict[str, Any] = {
        ours: given.number(theirs)
        for theirs, ours in _KEYS.items()
        if ours not in ("", "activation", "mode", "flawed", "topology") and given.has(theirs)
    }
    parameters["activation"] = given.method()
    if not given.switch("fullyConnected"):
        parameters |= {"topology": "dynamic", "latency": 1}
    parameters["mode"] = "asdf_plus" if given.switch("correctFilter") else "asdf_minus"
    experiments = []
    for flawed in _flawed_counts(given):
        try:
            experiments.append(Experiment.from_parameters({**parameters, "flawed": flawed}))
        except ExperimentError as error:
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
