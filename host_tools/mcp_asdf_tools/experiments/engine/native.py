"""Trials on the native firmware in the C engine, which runs outside the interpreter's lock."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from mcp_asdf.fixed_point import b_hat_to_raw
from mcp_asdf.image_format import image_size
from mcp_asdf.robot import Config, FirmwareError, Status
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.experiments import _engine
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.world.arena import Arena, allocate_memory, make_config
from mcp_asdf_tools.world.graph import Graph
from mcp_asdf_tools.world.sensors import (
    black_probabilities_anywhere,
    black_probabilities_by_colour,
    make_sensor_model,
)

RECORD_DTYPE = np.dtype(
    [("beta", "u8"), *((name, "u4") for name in ("t", "n", "x_hat", "alpha", "x_bar", "x", "b_hat"))],
    align=True,
)
"""A robot's values after a step, in the firmware's units."""

COUNTERS = ("tests", "updates")


class EngineTrials:
    """Trials of one experiment as the C engine takes them, and their results, in the firmware's units.

    N is the number of robots, and T the number of steps.

    Attributes:
        experiment: The C struct that describes them.
        robots: The C structs of the robots at the end, robots of the first trial first.
        x: Informed estimates of steps 0 .. T, shape (trials, 1 or N, T + 1): 1 if the robots of a trial
            always have the same x.
        b_hat: Assumed accuracies after each filter step, shape (trials, T // filter_period, N).
        records: Values of every robot once per ``sampling_interval`` steps, of dtype RECORD_DTYPE, shape
            (trials, T // sampling_interval, N).
    """

    def __init__(self, experiment: Experiment, first: int, trials: int, sampling_interval: int) -> None:
        """Describe trials ``first`` .. ``first + trials - 1`` in C. Results are valid after ``execute``.

        Robots are recorded once per ``sampling_interval`` steps, or never if it is 0. Raises UsageError if a
        sensor extension cannot be loaded or gives wrong accuracies.
        """
        robots, steps = experiment.robots, experiment.steps
        # C structs hold bare addresses, and Python would free what nothing else refers to: what they point to
        # is kept in this list, to live as long as this object.
        self._referenced_memory: list[Any] = []
        members = self._make_members(experiment, first, trials)
        members["sampling_interval"] = sampling_interval
        self.experiment = _engine.ffi.new("mcp_asdf_experiment_t *", members)
        # Results, into which ``execute`` lets C write
        self.robots = _engine.ffi.new("mcp_asdf_t[]", trials * robots)
        self.b_hat = np.empty((trials, steps // experiment.filter_period, robots), np.uint32)
        samples = steps // sampling_interval if sampling_interval else 0
        self.records = np.empty((trials, samples, robots), RECORD_DTYPE)

    def _make_members(self, experiment: Experiment, first: int, trials: int) -> dict[str, Any]:
        """Return the members of the C struct of an experiment, but for ``sampling_interval``, by their names.

        The trials are ``first`` .. ``first + trials - 1``. Members that the experiment does not use are left
        out: bits of rounded messages, arenas of moving robots, and arcs of a graph.
        """
        initial_b_hat = [b_hat_to_raw(experiment.b_hat(robot)) for robot in range(experiment.robots)]
        members: dict[str, Any] = {
            "seed": experiment.seed,
            "first_trial": first,
            "trials": trials,
            "robots": experiment.robots,
            "steps": experiment.steps,
            "comms_period": experiment.comms_period,
            "observation_period": experiment.observation_period,
            "latency": experiment.latency,
            "configs": self._make_configs(experiment),
            "b_hat": self._array("uint32_t", initial_b_hat),
        }
        if experiment.message_code is not None:
            members["x_hat_bits"] = experiment.message_code.x_hat_bits
            members["alpha_bits"] = experiment.message_code.alpha_bits
        members |= self._make_probabilities(experiment, first, trials)
        if experiment.is_dynamic:
            members["arenas"] = self._make_arenas(experiment, first, trials)
        if isinstance(experiment.graph, Graph):
            # The order of arcs is that in which C delivers, which has to be by ascending senders.
            arcs = self._array("mcp_asdf_pair_t", sorted(experiment.graph.links))
            members |= {"arcs": arcs, "arc_count": len(arcs)}
        return members

    def _make_configs(self, experiment: Experiment) -> Any:
        """Return the C array of pointers to the robots' configs; robots with equal configs share one."""
        configs = [experiment.config(robot) for robot in range(experiment.robots)]
        struct_by_config: dict[Config, Any] = {}
        for config in set(configs):
            struct, table = _make_c_config(config)
            struct_by_config[config] = struct
            # The struct points to the table, and the array below to the struct.
            self._referenced_memory += [struct, table]
        return self._array("mcp_asdf_config_t *", [struct_by_config[config] for config in configs])

    def _make_arenas(self, experiment: Experiment, first: int, trials: int) -> Any:
        """Return the C array of the configs of the arenas in which robots move; each trial has an arena."""
        configs_of_arenas = []
        for trial in range(first, first + trials):
            members_of_arena, floor_image = make_config(experiment, trial, _engine.ffi)
            configs_of_arenas.append(members_of_arena)
            self._referenced_memory.append(floor_image)  # to which the config points
        return self._array("mcp_asdf_arena_config_t", configs_of_arenas)

    def _make_probabilities(self, experiment: Experiment, first: int, trials: int) -> dict[str, Any]:
        """Return the members of the C struct that hold the probabilities of a black observation.

        These are the array ``black`` of the trials from ``first`` on, and the number of elements from one
        trial, step and robot to the next in it: 0 along an axis whose values are alike, so that C reads the
        same one again.
        """
        black = _black_probabilities(experiment, first, trials)
        members = {"black": self._array("uint32_t", black)}
        stride_names = ("trial_stride", "step_stride", "robot_stride")
        for name, bytes_to_next, length in zip(stride_names, black.strides, black.shape, strict=True):
            # NumPy counts bytes, the C elements.
            members[name] = bytes_to_next // black.itemsize if length > 1 else 0
        return members

    def execute(self, lanes: bool) -> Status:
        """Run the trials, fill in the results and return the engine's status: OK, or what went wrong.

        ``lanes`` chooses the faster of two engines with equal results. The array ``x`` is made here, and so
        is memory in which the engine works.
        """
        engine = _engine.lib
        # A trial has a series of x for each robot, or one if all its robots always have the same x.
        series_of_trial = engine.mcp_asdf_engine_columns(self.experiment)
        self.x = np.empty((self.experiment.trials, series_of_trial, self.experiment.steps + 1), np.uint32)
        result_arrays = {
            "robots": self.robots,
            "x": self._array("uint32_t", self.x),
            "b_hat": self._array("uint32_t", self.b_hat),
            "records": self._array("mcp_asdf_record_t", self.records),
        }
        outcome = _engine.ffi.new("mcp_asdf_outcome_t *", result_arrays)
        memory_size = engine.mcp_asdf_engine_bytes(self.experiment)
        memory = _engine.ffi.from_buffer(allocate_memory(memory_size))
        return Status(engine.mcp_asdf_engine_run(self.experiment, lanes, outcome, memory))

    @property
    def counters(self) -> dict[str, NDArray[np.int64]]:
        """The numbers of hypothesis tests and of updates of b_hat of each robot, by the name in COUNTERS.

        Each array has the shape (trials, N); the numbers are modulo 65536.
        """
        counters = {}
        trial_count = len(self.x)
        for name in COUNTERS:
            # The robots of the first trial come first, then those of the second, and so on.
            values = [getattr(robot.counters, name) for robot in self.robots]
            counters[name] = np.array(values).reshape(trial_count, self.experiment.robots)
        return counters

    def images(self) -> list[bytes]:
        """Return the state of each robot at the end, as the firmware saves it."""
        images = []
        for index, robot in enumerate(self.robots):
            c_image = _engine.ffi.new("uint8_t[]", _engine.lib.MCP_ASDF_IMAGE_SIZE)
            # The function in C takes a pointer to one robot of the array.
            _engine.lib.mcp_asdf_save(_engine.ffi.addressof(self.robots, index), c_image)
            # The array has room for the longest image; those of most filters are shorter.
            images.append(bytes(c_image)[: image_size(robot.config.filter)])
        return images

    def _array(self, c_type: str, values: Any) -> Any:
        """Return values as a C array that lives as long as this object; ``c_type`` is its elements' type.

        It is a copy of a list, but the memory of a NumPy array itself, so that C can write into that array.
        """
        if isinstance(values, np.ndarray):
            array = _engine.ffi.from_buffer(f"{c_type}[]", values)
        else:
            array = _engine.ffi.new(f"{c_type}[]", values)
        self._referenced_memory.append(array)
        return array


def run(
    experiment: Experiment, first: int, trials: int, sampling_interval: int = 0, lanes: bool | None = None
) -> EngineTrials:
    """Run trials ``first`` .. ``first + trials - 1`` of a native experiment.

    Robots are recorded once per ``sampling_interval`` steps unless that is 0. ``lanes`` chooses the faster of
    two engines with equal results, which computes several trials side by side; by default it is chosen where
    it can run. Raises UsageError if the experiment has something that the engine lacks
    (``Experiment.parameter_lacking_in_c``) or its robots find no room in an arena, and FirmwareError if the
    firmware refuses its settings. O(trials steps robots), and four bytes for each estimate.
    """
    if experiment.parameter_lacking_in_c:
        name = experiment.parameter_lacking_in_c
        raise UsageError(f"the engine in C lacks this {name}, {getattr(experiment, name)}; use run_trials")
    engine_trials = EngineTrials(experiment, first, trials, sampling_interval)
    # Lanes lack, for example, records and comms_period above 1.
    if lanes is None:
        lanes = _engine.lib.mcp_asdf_engine_has_lanes(engine_trials.experiment)
    status = engine_trials.execute(lanes)
    if status is Status.OK:
        return engine_trials
    if experiment.is_dynamic:
        for trial in range(first, first + trials):
            # Made only for its exception: UsageError with a reason, where robots find no room.
            Arena(experiment, trial)
    raise FirmwareError(status, "the firmware refuses the experiment's settings")


def _black_probabilities(experiment: Experiment, first: int, trials: int) -> NDArray[np.uint32]:
    """Return the probabilities of a black observation, by trial, step and robot, in units of 2**-31.

    They are those of ``trials`` trials from number ``first`` on. Where robots move, they are the
    probabilities on a black tile, otherwise those on a floor with the experiment's share of black. An axis
    along which all values are alike has the length 1. Raises UsageError if a sensor extension answers
    otherwise than it should.
    """
    # Built-in sensors are alike in all trials, so that one trial stands for all.
    distinct_trial_count = trials if experiment.sensor else 1
    probabilities = []
    for index in range(distinct_trial_count):
        accuracies = make_sensor_model(experiment, first + index).advance(experiment.steps)
        if experiment.is_dynamic:
            # The engine derives the probability on white tiles: trials run in C only where the accuracies on
            # both colours are equal.
            on_black, _on_white = black_probabilities_by_colour(accuracies)
            probabilities.append(on_black)
        else:
            probabilities.append(black_probabilities_anywhere(accuracies, experiment.fill_ratio))
    return np.stack(probabilities)


def _make_c_config(config: Config) -> tuple[Any, Any]:
    """Return the C struct of a config, and its t-table in C, which has to live as long as the struct.

    The table is a null pointer for a config without one.
    """
    ffi = _engine.ffi
    table = ffi.NULL if config.table is None else ffi.new("uint32_t[]", list(config.table.words()))
    members_in_order = (table, config.filter_period, config.memory, int(config.filter))
    return ffi.new("mcp_asdf_config_t *", members_in_order), table
