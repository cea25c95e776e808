"""The C engine's Python side: trials on the native firmware, outside the interpreter's lock."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from mcp_asdf.fixed_point import b_hat_to_raw
from mcp_asdf.robot import Config, FirmwareError, Status
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.experiments import _engine
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.world.arena import Arena, allocate_memory, make_config
from mcp_asdf_tools.world.sensors import black_probabilities, make_sensor_model
from mcp_asdf_tools.world.topology import Graph

RECORD = np.dtype(
    [("beta", "u8"), *((name, "u4") for name in ("t", "n", "x_hat", "alpha", "x_bar", "x", "b_hat"))],
    align=True,
)
"""A robot's values after a step, in the firmware's units."""

COUNTERS = ("tests", "updates")


class EngineTrials:
    """Some trials: what the engine takes, and the results, in the firmware's units.

    Attributes:
        experiment: The C struct that describes them.
        robots: The C structs of the robots at the end, robots of the first trial first.
        x: Informed estimates of steps 0 .. T, shape (trials, 1 or N, T + 1): one column if all robots have
            the same in any case.
        b_hat: Assumed accuracies after each filter step, shape (trials, T // filter_period, N).
        records: Values of every robot once per ``sampling_interval`` steps, of dtype RECORD, shape
            (trials, T // sampling_interval, N).
    """

    def __init__(self, experiment: Experiment, first: int, trials: int, sampling_interval: int) -> None:
        """Describe them. Results are valid after ``execute``."""
        ffi, count, steps = _engine.ffi, experiment.robots, experiment.steps
        configs = [experiment.config(robot) for robot in range(count)]
        made = {config: _config(config) for config in set(configs)}
        black = _probabilities(experiment, first, trials)
        self._kept: list[Any] = [made]
        members = {
            "seed": experiment.seed,
            "first_trial": first,
            "trials": trials,
            "robots": count,
            "steps": steps,
            "sampling_interval": sampling_interval,
            "comms_period": experiment.comms_period,
            "observation_period": experiment.observation_period,
            "latency": experiment.latency,
            "configs": self._array("mcp_asdf_config_t *", [made[config][0] for config in configs]),
            "b_hat": self._array("uint32_t", [b_hat_to_raw(experiment.b_hat(j)) for j in range(count)]),
            "black": self._array("uint32_t", black),
        }
        names = ("trial_stride", "step_stride", "robot_stride")
        for name, stride, size in zip(names, black.strides, black.shape, strict=True):
            members[name] = stride // black.itemsize if size > 1 else 0
        if experiment.is_dynamic:
            arenas = [make_config(experiment, first + index, ffi) for index in range(trials)]
            self._kept.append(arenas)
            members["arenas"] = self._array("mcp_asdf_arena_config_t", [values for values, _ in arenas])
        if isinstance(experiment.graph, Graph):
            arcs = self._array("mcp_asdf_pair_t", sorted(experiment.graph.links))
            members |= {"arcs": arcs, "arc_count": len(arcs)}
        self.experiment = ffi.new("mcp_asdf_experiment_t *", members)
        self.robots = ffi.new("mcp_asdf_t[]", trials * count)
        self.b_hat = np.empty((trials, steps // experiment.filter_period, count), np.uint32)
        samples = steps // sampling_interval if sampling_interval else 0
        self.records = np.empty((trials, samples, count), RECORD)

    def execute(self, lanes: bool) -> Status:
        """Run them, with ``lanes`` in the faster of two engines with equal results."""
        engine, of_trials = _engine.lib, self.experiment
        columns = engine.mcp_asdf_engine_columns(of_trials)
        self.x = np.empty((of_trials.trials, columns, of_trials.steps + 1), np.uint32)
        x, b_hat = (self._array("uint32_t", values) for values in (self.x, self.b_hat))
        results = (self.robots, x, b_hat, self._array("mcp_asdf_record_t", self.records))
        memory = _engine.ffi.from_buffer(allocate_memory(engine.mcp_asdf_engine_bytes(of_trials)))
        outcome = _engine.ffi.new("mcp_asdf_outcome_t *", results)
        return Status(engine.mcp_asdf_engine_run(of_trials, lanes, outcome, memory))

    @property
    def counters(self) -> dict[str, NDArray[np.int64]]:
        """Tests and updates of each robot, shape (trials, N) each, modulo 65536."""
        counted = {name: [getattr(each.counters, name) for each in self.robots] for name in COUNTERS}
        return {name: np.array(values).reshape(len(self.x), -1) for name, values in counted.items()}

    def images(self) -> list[bytes]:
        """State of each robot at the end as the firmware saves it."""
        images = [_engine.ffi.new("uint8_t[]", _engine.lib.MCP_ASDF_IMAGE_SIZE) for _ in self.robots]
        for index, image in enumerate(images):
            _engine.lib.mcp_asdf_save(_engine.ffi.addressof(self.robots, index), image)
        return [bytes(image) for image in images]

    def _array(self, kind: str, values: Any) -> Any:
        """An array of C that lives as long as this: of listed values, or in the memory of one of numpy."""
        make = _engine.ffi.from_buffer if isinstance(values, np.ndarray) else _engine.ffi.new
        self._kept.append(make(f"{kind}[]", values))
        return self._kept[-1]


def run(
    experiment: Experiment, first: int, trials: int, sampling_interval: int = 0, lanes: bool | None = None
) -> EngineTrials:
    """Run trials ``first`` .. ``first + trials - 1`` of a native experiment.

    Robots are recorded once per ``sampling_interval`` steps unless that is 0. ``lanes`` chooses the faster of
    two engines with equal results, by default where it can run. Raises UsageError if something is
    ``lacking_in_c`` or as ``Arena``, FirmwareError as the firmware's init. O(trials steps robots), and four
    bytes for each estimate.
    """
    if key := experiment.lacking_in_c:
        raise UsageError(f"the engine in C lacks this {key}, {getattr(experiment, key)}; use run_trials")
    made = EngineTrials(experiment, first, trials, sampling_interval)
    has_lanes = _engine.lib.mcp_asdf_engine_has_lanes(made.experiment)
    status = made.execute(has_lanes if lanes is None else lanes)
    if status is not Status.OK:
        for index in range(trials if experiment.is_dynamic else 0):
            Arena(experiment, first + index)  # says so where robots find no room
        raise FirmwareError(status, "the firmware refuses the experiment's settings")
    return made


def _probabilities(experiment: Experiment, first: int, trials: int) -> NDArray[np.uint32]:
    """The engine's ``black``, with axes of length 1 where all are alike: of trials, unless sensors are an
    extension's."""
    worlds = range(trials if experiment.sensor else 1)
    ratio = None if experiment.is_dynamic else experiment.fill_ratio
    models = [make_sensor_model(experiment, first + index) for index in worlds]
    return np.stack([black_probabilities(model.advance(experiment.steps), ratio)[0] for model in models])


def _config(config: Config) -> tuple[Any, Any]:
    """The C struct of a config and its table."""
    ffi = _engine.ffi
    table = ffi.NULL if config.table is None else ffi.new("uint32_t[]", list(config.table.words()))
    values = (table, config.filter_period, config.memory, int(config.filter))
    return ffi.new("mcp_asdf_config_t *", values), table
