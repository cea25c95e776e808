"""Run trials of an experiment on any firmware and measure them.

Native trials run in the C engine where it can; all others run in Python, robot by robot and message by
message. All see the same draws. The series of informed estimates of a trial is dropped once K and e are
known.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from types import ModuleType
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from mcp_asdf.fixed_point import ONE, SHIFT_MAX, UNITS_PER_ALPHA, b_hat_to_raw
from mcp_asdf.reference import AUTHORS, PAPER, ReferenceRobot
from mcp_asdf.robot import FixedPointRobot, Robot
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.common.extras import install_instruction
from mcp_asdf_tools.common.versions import own_version
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.metrics import DELTA, convergence_step
from mcp_asdf_tools.experiments.results import QUANTITIES, Trials
from mcp_asdf_tools.robots.firmwares import RobotMaker, load_firmware
from mcp_asdf_tools.world.world import SteppedWorld

Floats = NDArray[np.float64]


def run_trials(experiment: Experiment, first: int, trials: int, sampling_interval: int = 0) -> Trials:
    """Run ``trials`` trials from number ``first`` on, recorded every ``sampling_interval`` steps (0: never).

    The C engine runs them, or if it lacks something that the experiment has, Python does, message by message.
    Raises UsageError if the firmware or an extension cannot be loaded, or if an arena has too little room.
    O(trials steps robots), robots squared in Python.

    The engine keeps every estimate of a robot, of four bytes, until K and e are known. So only a few long
    trials should be run at a time, as in the jobs of a sweep.
    """
    numbers = range(first, first + trials)
    if experiment.parameter_lacking_in_c:
        return _concatenate([_run_by_message(experiment, number, sampling_interval) for number in numbers])
    return _run_native(experiment, numbers, sampling_interval)


def _concatenate(all_trials: Sequence[Trials]) -> Trials:
    """Return trials of one experiment, recorded equally often, as one object, in the order passed."""
    numbers: list[int] = []
    for trials in all_trials:
        numbers += trials.numbers
    arrays: dict[str, Any] = {}
    for name in ("convergence_steps", "errors", "b_hat", "tests", "updates"):
        arrays[name] = np.concatenate([getattr(trials, name) for trials in all_trials])
    records: dict[str, Floats] = {}
    for quantity in all_trials[0].records:
        records[quantity] = np.concatenate([trials.records[quantity] for trials in all_trials])
    return replace(all_trials[0], numbers=numbers, records=records, **arrays)


def convergence_and_errors(
    experiment: Experiment, x_series: NDArray[Any], unit: float
) -> tuple[NDArray[np.int64], Floats]:
    """Return each robot's convergence step K, and its error |x - f| in step K; two arrays, shape (trials, N).

    ``x_series`` has the robots' estimates x in units of ``unit``, shape (trials, N, steps + 1). Where all
    robots of a trial have the same x its shape is (trials, 1, steps + 1), and all get the same K and error.
    """
    delta = DELTA / unit  # in the unit of the series
    step_axis = 2
    convergence_steps = np.apply_along_axis(convergence_step, step_axis, x_series, delta)
    # The steps are indices into a series here, so they get an axis in the place of the steps.
    x_then = np.take_along_axis(x_series, convergence_steps[:, :, np.newaxis], axis=step_axis)
    errors = abs(x_then[:, :, 0] * unit - experiment.fill_ratio)
    # If a trial has one series for all robots, its K and its error are those of all robots, too.
    shape = (len(x_series), experiment.robots)
    return np.broadcast_to(convergence_steps, shape).copy(), np.broadcast_to(errors, shape).copy()


# --- In the C engine -------------------------------------------------------------------------------------


def _load_engine() -> ModuleType:
    """Load the C engine when it is first needed, since other firmwares run where nothing has been built.

    Raises UsageError if it cannot be loaded.
    """
    try:
        from mcp_asdf_tools.experiments.engine import native  # noqa: PLC0415
    except ImportError as error:
        raise UsageError(
            f"the engine cannot be loaded ({error}); choose firmware mirror, or to build the engine, "
            f"{install_instruction()}"
        ) from error
    return native


def _run_native(experiment: Experiment, numbers: range, sampling_interval: int) -> Trials:
    """Run trials of consecutive numbers in the C engine, and convert its integers to the paper's units.

    Values are recorded every ``sampling_interval`` steps, or never if it is 0.
    """
    engine_trials = _load_engine().run(experiment, numbers[0], len(numbers), sampling_interval)
    # The engine counts x in units of 1 / ONE, and b_hat in units of 2^-32.
    convergence_steps, errors = convergence_and_errors(experiment, engine_trials.x, unit=1 / ONE)
    counters = engine_trials.counters
    records = {}
    if sampling_interval:
        records = _records_in_paper_units(experiment, engine_trials.records)
    return Trials(
        experiment=experiment,
        numbers=list(numbers),
        convergence_steps=convergence_steps,
        errors=errors,
        b_hat=engine_trials.b_hat / 2.0**32,
        tests=counters["tests"],
        updates=counters["updates"],
        records=records,
        sampling_interval=sampling_interval,
    )


def _records_in_paper_units(experiment: Experiment, raw_records: NDArray[Any]) -> dict[str, Floats]:
    """Convert the integers that the engine has recorded to floats by quantity, in the units of the paper.

    x_hat, x_bar, x and b_hat become numbers from 0 to 1, and alpha and beta confidences; counts stay as they
    are. The values at step 0, which the engine does not record, come before the others.

    Args:
        experiment: The experiment, for the initial b_hat of each robot.
        raw_records: Records in the engine's dtype RECORD_DTYPE, shape (trials, samples, N).

    Returns:
        Values by the name of each quantity, shape (trials, samples + 1, N).
    """
    initial_b_hat = [b_hat_to_raw(experiment.b_hat(robot)) / 2**32 for robot in range(experiment.robots)]
    # These are the values of a robot that has neither observed nor received anything.
    initial_values: dict[str, Any] = {"t": 0, "n": 0, "alpha": 0, "beta": 0}
    initial_values |= {"x_hat": 0.5, "x_bar": 0.5, "x": 0.5, "b_hat": initial_b_hat}
    trial_count, sample_count, robots = raw_records.shape
    records = {}
    for quantity in QUANTITIES:
        values = np.empty((trial_count, sample_count + 1, robots))
        values[:, 0] = initial_values[quantity]
        values[:, 1:] = _in_paper_units(quantity, raw_records[quantity])
        records[quantity] = values
    return records


_INTEGER_OF_ONE = {
    **dict.fromkeys(("t", "n"), 1),
    **dict.fromkeys(("x_hat", "x_bar", "x"), ONE),
    "beta": UNITS_PER_ALPHA,
    "b_hat": 2**32,
}
"""The integer that stands for 1, by quantity. Alpha has none: its word is a mantissa and a shift."""


def _in_paper_units(quantity: str, raw_values: NDArray[Any]) -> Floats:
    """Convert recorded integers of a quantity to floats in the units of the paper, in the same shape."""
    if quantity == "alpha":
        return _alpha_of_words(raw_values)
    values: Floats = raw_values / _INTEGER_OF_ONE[quantity]
    return values


def _alpha_of_words(alpha_words: NDArray[np.uint32]) -> Floats:
    """Return the exact values of alpha words, the robots' confidences as the firmware packs them in 32 bits.

    The upper 24 bits of a word are its mantissa, in units of 1 / UNITS_PER_ALPHA. The lowest five bits are a
    shift: alpha is the mantissa times 2 to the power of the shift.
    """
    bits_below_mantissa = 8
    mantissas = alpha_words >> bits_below_mantissa
    shifts = (alpha_words & SHIFT_MAX).astype(np.int32)
    return np.ldexp(mantissas / UNITS_PER_ALPHA, shifts)


# --- Message by message ----------------------------------------------------------------------------------


def _run_by_message(experiment: Experiment, number: int, sampling_interval: int) -> Trials:
    """Run the trial of this number in Python, message by message.

    All quantities of the robots are recorded every ``sampling_interval`` steps; 0 means never.
    """
    swarm = MessageSwarm(experiment, number)
    # Series and records begin with step 0, before the first observation.
    x_by_step = [swarm.values_of("x")]
    b_hat_by_filter_step = []
    snapshots = [swarm.snapshot()]
    for step in swarm.steps():
        x_by_step.append(swarm.values_of("x"))
        if step % experiment.filter_period == 0:  # the filter has run in this step
            b_hat_by_filter_step.append(swarm.values_of("b_hat"))
        if sampling_interval and step % sampling_interval == 0:
            snapshots.append(swarm.snapshot())
    # The first axis of all arrays is the trial. There is one here, so its values are an array's only element.
    x_by_robot = np.transpose(x_by_step)  # from shape (steps + 1, N) to shape (N, steps + 1)
    convergence_steps, errors = convergence_and_errors(experiment, np.array([x_by_robot]), unit=1.0)
    # The shape is given, as the list of a trial without a filter step does not tell the number of robots.
    b_hat_shape = (1, len(b_hat_by_filter_step), experiment.robots)
    return Trials(
        experiment=experiment,
        numbers=[number],
        convergence_steps=convergence_steps,
        errors=errors,
        b_hat=np.reshape(b_hat_by_filter_step, b_hat_shape),
        tests=np.array([[robot.counters.tests for robot in swarm.robots]]),
        updates=np.array([[robot.counters.updates for robot in swarm.robots]]),
        records=_records_of_snapshots(snapshots) if sampling_interval else {},
        sampling_interval=sampling_interval,
    )


def _records_of_snapshots(snapshots: list[list[list[float]]]) -> dict[str, Floats]:
    """Return the records of one trial by quantity, shape (1, samples, N) each.

    A snapshot has a list for each of QUANTITIES, with a value of each robot.
    """
    values = np.array([snapshots])  # shape (1, samples, quantities, N): the first axis is the trial
    return {name: values[:, :, index, :] for index, name in enumerate(QUANTITIES)}


class MessageSwarm:
    """A trial in Python on any firmware: all robots observe, receive their neighbours' messages, and settle.

    Robots broadcast in every ``comms_period``-th step. With a latency, messages reach the robots in range of
    their sender one step after the broadcast: until a robot observes again, its values are those that it
    broadcast.

    Attributes:
        robots: The robots, by id.
    """

    def __init__(self, experiment: Experiment, trial: int) -> None:
        """Make the world of a trial and its robots. Raises UsageError if one of them cannot be made."""
        self._experiment = experiment
        self._message_code = experiment.message_code
        self._world = SteppedWorld(experiment, trial)
        self.robots = _make_robots(experiment)
        # An extension may mix robots of both kinds, and then all of them exchange floats.
        have_raw_values = all(isinstance(robot, FixedPointRobot) for robot in self.robots)
        self._deliver = self._deliver_raw if have_raw_values else self._deliver_floats

    def steps(self) -> Iterator[int]:
        """Take all steps of the trial, and yield the number of each, from 1, when it is over.

        Robots may observe in any step. In every ``comms_period``-th step they broadcast their estimates and
        end the round. Their messages arrive before that or, with latency, in the next step.
        """
        comms_period = self._experiment.comms_period
        has_latency = self._experiment.latency > 0
        are_messages_under_way = False
        for step in range(1, self._experiment.steps + 1):
            observations = self._world.step()
            # Until they observe again, robots have the values that they broadcast in the last step.
            if are_messages_under_way:
                self._deliver()
            for robot, observation in zip(self.robots, observations, strict=True):
                if observation is not None:
                    robot.observe(observation)
            is_broadcast_step = step % comms_period == 0
            if is_broadcast_step:
                if not has_latency:
                    self._deliver()
                for robot in self.robots:
                    robot.settle()
            are_messages_under_way = is_broadcast_step and has_latency
            yield step

    def _receivers_and_senders(self) -> list[list[int]]:
        """Return the ids of receiver and sender of each message at present, by rising ids of receivers."""
        neighbours = self._world.current_neighbours  # entry (i, j): whether robot i receives from robot j
        pairs: list[list[int]] = np.argwhere(neighbours).tolist()
        return pairs

    def _deliver_floats(self) -> None:
        """Let each robot receive its neighbours' estimates as floats, rounded as the experiment's code does.

        Without a code, as with most experiments, they are exact.
        """
        estimates = [(robot.x_hat, robot.alpha) for robot in self.robots]
        if self._message_code is not None:
            estimates = [self._message_code.round_floats(*estimate) for estimate in estimates]
        for receiver, sender in self._receivers_and_senders():
            x_hat, alpha = estimates[sender]
            self.robots[receiver].receive(sender, x_hat, alpha)

    def _deliver_raw(self) -> None:
        """Let each robot receive its neighbours' estimates in the firmware's integers.

        They are rounded as the experiment's code does; without a code, as with most experiments, exact.
        """
        robots = cast(Sequence[FixedPointRobot], self.robots)
        estimates = [(robot.x_hat_raw, robot.alpha_raw) for robot in robots]
        if self._message_code is not None:
            estimates = [self._message_code.round_raw(*estimate) for estimate in estimates]
        for receiver, sender in self._receivers_and_senders():
            x_hat_raw, alpha_raw = estimates[sender]
            robots[receiver].receive_raw(sender, x_hat_raw, alpha_raw)

    def values_of(self, quantity: str) -> list[float]:
        """Return one of QUANTITIES of each robot at present, by id."""
        return [getattr(robot, quantity) for robot in self.robots]

    def snapshot(self) -> list[list[float]]:
        """Return all QUANTITIES of each robot at present, in their order."""
        return [self.values_of(quantity) for quantity in QUANTITIES]


def _make_robots(experiment: Experiment) -> list[Robot]:
    """Return the robots of an experiment in a list, where the index of a robot is its id.

    Robots of the firmware "reference" also get the experiment's conventions and omega. Raises UsageError if
    the firmware cannot be loaded.
    """
    make_robot: RobotMaker = load_firmware(experiment.firmware)
    # No config says which conventions the reference follows, nor the exact omega.
    if experiment.firmware == "reference":
        conventions = AUTHORS if experiment.conventions == "authors" else PAPER
        make_robot = partial(ReferenceRobot, conventions=conventions, omega=float(experiment.omega))
    return [
        make_robot(experiment.config(robot), robot, experiment.b_hat(robot))
        for robot in range(experiment.robots)
    ]


# --- Jobs ------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Job:
    """Arguments of ``run_trials`` that can be sent to a worker process.

    Attributes:
        experiment: What to run.
        first: Number of the first trial.
        count: How many trials to run.
        sampling_interval: Steps between recorded values; 0 for none.
        version: Version of the program that made the job; its worker has to have the same.
    """

    experiment: Experiment
    first: int
    count: int
    sampling_interval: int = 0
    version: str = field(default_factory=own_version)

    def run(self) -> Trials:
        """Run the job and return its results.

        Raises UsageError in a worker of another version of the program, and where ``run_trials`` does.
        """
        worker_version = own_version()
        # Another version may compute other results, or may not even know the experiment's parameters.
        if self.version != worker_version:
            raise UsageError(
                f"a worker has mcp-asdf {worker_version}, this is {self.version}; install the same on all"
            )
        return run_trials(self.experiment, self.first, self.count, self.sampling_interval)
