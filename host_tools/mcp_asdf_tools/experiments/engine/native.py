"""The C engine's Python side: trials on the native firmware, outside the interpreter's lock."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mcp_asdf.fixed_point import b_hat_to_raw
from mcp_asdf.robot import Config, FirmwareError, Status
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.experiments import _engine
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.world.arena import Arena, config_values, memory_of
from mcp_asdf_tools.world.sensors import black_probabilities, sensor_model
from mcp_asdf_tools.world.topology import Graph

RECORD = np.dtype(
    [("beta", "u8"), *((name, "u4") for name in ("t", "n", "x_hat", "alpha", "x_bar", "x", "b_hat"))],
    align=True,
)
"""A robot's values after a step, in the firmware's units."""

COUNTERS = ("tests", "updates")


@dataclass(frozen=True)
class EngineResults:
    """Results of trials, in the firmware's units.

    Attributes:
        x: Informed estimates of steps 0 .. T, shape (trials, 1 or N, T + 1): one column if all robots have
            the same in any case.
        b_hat: Assumed accuracies after each filter step, shape (trials, T // filter_period, N).
        counters: Tests and updates of each robot, shape (trials, N) each, modulo 65536.
        records: Values of every robot once per ``sampling_interval`` steps, of dtype RECORD, shape
            (trials, T // sampling_interval, N).
        robots: The C structs, for ``images``.
        call: What they point to: their settings, which an image depends on.
    """

    x: NDArray[np.uint32]
    b_hat: NDArray[np.uint32]
    counters: dict[str, NDArray[np.uint16]]
    records: NDArray[Any]
    robots: Any
    call: _Call

    def images(self) -> list[bytes]:
        """State of each robot at the end as the firmware saves it, robots of trial 0 first."""
        image = _engine.ffi.new("uint8_t[]", _engine.lib.MCP_ASDF_IMAGE_SIZE)
        images = []
        for index in range(len(self.robots)):
            _engine.lib.mcp_asdf_save(_engine.ffi.addressof(self.robots, index), image)
            images.append(bytes(image))
        return images


def run(
    experiment: Experiment, first: int, trials: int, sampling_interval: int = 0, lanes: bool | None = None
) -> EngineResults:
    """Run trials ``first`` .. ``first + trials - 1`` of a native experiment.

    Robots are recorded once per ``sampling_interval`` steps unless that is 0. ``lanes`` chooses the faster of
    two engines with equal results, by default where it can run. Raises UsageError if something is
    ``lacking_in_c`` or as ``Arena``, FirmwareError as the firmware's init. O(trials steps robots), and four
    bytes for each estimate.
    """
    if key := experiment.lacking_in_c:
        raise UsageError(f"the engine in C lacks this {key}, {getattr(experiment, key)}; use run_trials")
    call = _Call(experiment, first, trials, sampling_interval)
    engine = _engine.lib
    outcome = _allocate(experiment, trials, call, sampling_interval)
    use_lanes = engine.mcp_asdf_engine_has_lanes(call.experiment) if lanes is None else lanes
    status = _execute(call, use_lanes, outcome)
    if status is not Status.OK:
        for index in range(trials if experiment.is_dynamic else 0):
            Arena(experiment, first + index)  # says so where robots find no room
        raise FirmwareError(status, "the firmware refuses the experiment's settings")
    counters = outcome.counters
    for index in range(trials * experiment.robots):
        of_robot = outcome.robots[index].counters
        for name, values in counters.items():
            values.flat[index] = getattr(of_robot, name)
    return outcome


def _execute(call: _Call, lanes: bool, outcome: EngineResults) -> Status:
    engine = _engine.lib
    memory = _engine.ffi.from_buffer(memory_of(engine.mcp_asdf_engine_bytes(call.experiment)))
    return Status(engine.mcp_asdf_engine_run(call.experiment, lanes, _pointers(outcome), memory))


class _Call:
    """The engine's description of some trials, and what its pointers point to."""

    def __init__(self, experiment: Experiment, first: int, trials: int, sampling_interval: int) -> None:
        ffi, robots = _engine.ffi, range(experiment.robots)
        made = {config: _config(config) for config in {experiment.config(robot) for robot in robots}}
        black = _probabilities(experiment, first, trials)
        self._kept = [made, black]
        members = {
            "seed": experiment.seed,
            "first_trial": first,
            "trials": trials,
            "robots": experiment.robots,
            "steps": experiment.steps,
            "sampling_interval": sampling_interval,
            "comms_period": experiment.comms_period,
            "observation_period": experiment.observation_period,
            "latency": experiment.latency,
            "configs": self._array("mcp_asdf_config_t *[]", [made[experiment.config(j)][0] for j in robots]),
            "b_hat": self._array("uint32_t[]", [b_hat_to_raw(experiment.b_hat(j)) for j in robots]),
            "black": ffi.cast("uint32_t *", ffi.from_buffer(black)),
        }
        names = ("trial_stride", "step_stride", "robot_stride")
        for name, stride, size in zip(names, black.strides, black.shape, strict=True):
            members[name] = stride // black.itemsize if size > 1 else 0
        if experiment.is_dynamic:
            arenas = [config_values(experiment, first + index, ffi) for index in range(trials)]
            self._kept.append(arenas)
            members["arenas"] = self._array("mcp_asdf_arena_config_t[]", [values for values, _ in arenas])
        if isinstance(experiment.graph, Graph):
            arcs = np.array(sorted(experiment.graph.links), np.uint16).reshape(-1, 2)
            self._kept.append(arcs)
            members |= {"arcs": ffi.cast("mcp_asdf_pair_t *", arcs.ctypes.data), "arc_count": len(arcs)}
        self.experiment = ffi.new("mcp_asdf_experiment_t *", members)

    def _array(self, kind: str, values: list[Any]) -> Any:
        array = _engine.ffi.new(kind, values)
        self._kept.append(array)
        return array


def _probabilities(experiment: Experiment, first: int, trials: int) -> NDArray[np.uint32]:
    """The engine's ``black``, with axes of length 1 where all are alike: of trials, unless sensors move at
    random."""
    is_random = experiment.drift == "wiener" or experiment.drift_spread or experiment.sensor
    worlds = range(trials if is_random else 1)
    ratio = None if experiment.is_dynamic else experiment.fill_ratio
    models = [sensor_model(experiment, first + index) for index in worlds]
    return np.stack([black_probabilities(model.advance(experiment.steps), ratio)[0] for model in models])


def _config(config: Config) -> tuple[Any, Any]:
    """The C struct of a config and its table."""
    ffi = _engine.ffi
    table = ffi.NULL if config.table is None else ffi.new("uint32_t[]", list(config.table.words()))
    values = (table, config.filter_period, config.memory, int(config.filter))
    return ffi.new("mcp_asdf_config_t *", values), table


def _allocate(experiment: Experiment, trials: int, call: _Call, sampling_interval: int) -> EngineResults:
    count, steps = experiment.robots, experiment.steps
    columns = _engine.lib.mcp_asdf_engine_columns(call.experiment)
    return EngineResults(
        x=np.empty((trials, columns, steps + 1), np.uint32),
        b_hat=np.empty((trials, steps // experiment.filter_period, count), np.uint32),
        counters={name: np.empty((trials, count), np.uint16) for name in COUNTERS},
        records=np.empty((trials, steps // sampling_interval if sampling_interval else 0, count), RECORD),
        robots=_engine.ffi.new("mcp_asdf_t[]", trials * count),
        call=call,
    )


def _pointers(outcome: EngineResults) -> Any:
    kinds = {"x": "uint32_t *", "b_hat": "uint32_t *", "records": "mcp_asdf_record_t *"}
    members = {
        name: _engine.ffi.cast(kind, getattr(outcome, name).ctypes.data) for name, kind in kinds.items()
    }
    return _engine.ffi.new("mcp_asdf_outcome_t *", {"robots": outcome.robots, **members})
