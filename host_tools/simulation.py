"""Run trials of an experiment on any firmware and measure them.

Native trials run in the C engine; those of the other firmwares robot by robot and message by message in
Python, with the same draws. The series of informed estimates of a trial is dropped as soon as K and e are
known.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, cast

import numpy as np
from numpy.typing import NDArray

from firmware_py.fixed_point import ONE, UNITS_PER_ALPHA, b_hat_to_raw
from firmware_py.reference import AUTHORS, PAPER, ReferenceRobot
from firmware_py.robot import FixedPointRobot, Observation, Robot, Status
from host_tools.draws import observations
from host_tools.errors import UsageError
from host_tools.experiments import Convention, Experiment
from host_tools.firmwares import RobotMaker, load_firmware
from host_tools.scores import DELTA, settling_step
from host_tools.sensors import black_probabilities

if TYPE_CHECKING:
    from host_tools.engine.native import RawOutcome

QUANTITIES = ("t", "n", "x_hat", "alpha", "x_bar", "beta", "x", "b_hat")
"""What is recorded of a robot, named as the attributes of ``Robot``."""

_COLOURS = (Observation.WHITE, Observation.BLACK)


@dataclass(frozen=True)
class Measured:
    """What is kept of trials ``first`` .. of an experiment; the first axis is the trial.

    Attributes:
        first: Number of the first trial.
        settled: K of each robot, shape (trials, N).
        errors: e of each robot, shape (trials, N).
        b_hat: Assumed accuracies after each filter step, shape (trials, T // filter_period, N).
        tests: Hypothesis tests run by each robot, shape (trials, N); at most 65535, as ``updates``.
        updates: Re-estimates of b_hat by each robot, shape (trials, N).
        records: Values of QUANTITIES each ``thinning`` steps, from step 0 on, shape (quantities, trials,
            T // thinning + 1, N); no rows without recording.
    """

    first: int
    settled: NDArray[np.int64]
    errors: NDArray[np.float64]
    b_hat: NDArray[np.float64]
    tests: NDArray[np.int64]
    updates: NDArray[np.int64]
    records: NDArray[np.float64]


def run_trials(experiment: Experiment, first: int, trials: int, thinning: int = 0) -> Measured:
    """Run trials ``first`` .. ``first + trials - 1``; with ``thinning`` above 0 record every so many steps.

    Raises UsageError if the firmware cannot be had. O(trials steps robots), robots squared where not native.
    """
    if experiment.firmware == "native":
        return _run_native(experiment, first, trials, thinning)
    each = [_run_robots(experiment, first + index, thinning) for index in range(trials)]
    return Measured(
        first, *(np.concatenate([getattr(one, name) for one in each], axis=axis) for name, axis in _AXES)
    )


_AXES = (("settled", 0), ("errors", 0), ("b_hat", 0), ("tests", 0), ("updates", 0), ("records", 1))


def measure(
    series: NDArray[np.uint32] | NDArray[np.float64], unit: float, fill_ratio: float
) -> tuple[int, float]:
    """K and e of one series of informed estimates, given in units of ``unit``."""
    settled = settling_step(series, DELTA / unit)
    return settled, abs(float(series[settled]) * unit - fill_ratio)


def _run_native(experiment: Experiment, first: int, trials: int, thinning: int) -> Measured:
    try:
        # Other firmwares shall run where nothing has been built.
        from host_tools.engine import native  # noqa: PLC0415
    except ImportError as error:
        raise UsageError(
            f"the engine cannot be loaded ({error}); build it with 'pip install .' or choose firmware mirror"
        ) from error
    raw = native.run(experiment, first, trials, thinning)
    pairs = np.array(
        [[measure(series, 1 / ONE, experiment.fill_ratio) for series in trial] for trial in raw.x]
    )
    every = np.broadcast_to(pairs, (trials, experiment.robots, 2))
    return Measured(
        first,
        every[..., 0].astype(np.int64),
        every[..., 1].copy(),
        raw.b_hat / 2.0**32,
        raw.counters["tests"].astype(np.int64),
        raw.counters["updates"].astype(np.int64),
        _records_of(experiment, raw, bool(thinning)),
    )


def _records_of(experiment: Experiment, raw: RawOutcome, recorded: bool) -> NDArray[np.float64]:
    """The engine's records as floats, with step 0 before them."""
    shape = (len(QUANTITIES), len(raw.x), raw.records.shape[1] + recorded, experiment.robots)
    records = np.empty(shape)
    if recorded:
        start = {"x_hat": 0.5, "x_bar": 0.5, "x": 0.5}
        units = {"x_hat": ONE, "x_bar": ONE, "x": ONE, "beta": UNITS_PER_ALPHA, "b_hat": 2**32}
        for values, name in zip(records, QUANTITIES, strict=True):
            values[:, 0] = start.get(name, 0.0)
            whole = raw.records[name]
            values[:, 1:] = whole.view(np.float32) if name == "alpha" else whole / units.get(name, 1)
        records[-1, :, 0] = [b_hat_to_raw(experiment.b_hat(j)) / 2**32 for j in range(experiment.robots)]
    return records


def _run_robots(experiment: Experiment, trial: int, thinning: int) -> Measured:
    """One trial in Python."""
    robots = _make_robots(experiment)
    shape = (experiment.steps, experiment.robots)
    seen = observations(
        experiment.seed, trial, np.broadcast_to(black_probabilities(experiment, trial), shape)
    )
    x, b_hat, records = [_all(robots, "x")], [], [_snapshot(robots)] if thinning else []
    for step, colours in enumerate(seen.tolist(), start=1):
        _tick(robots, colours)
        x.append(_all(robots, "x"))
        if step % experiment.filter_period == 0:
            b_hat.append(_all(robots, "b_hat"))
        if thinning and step % thinning == 0:
            records.append(_snapshot(robots))
    pairs = [measure(series, 1.0, experiment.fill_ratio) for series in np.array(x).T]
    counters = [robot.counters for robot in robots]
    return Measured(
        trial,
        np.array([[settled for settled, _ in pairs]]),
        np.array([[error for _, error in pairs]]),
        np.array(b_hat).reshape(1, -1, len(robots)),
        np.array([[counter.tests for counter in counters]]),
        np.array([[counter.updates for counter in counters]]),
        np.array(records).reshape(-1, len(QUANTITIES), len(robots)).swapaxes(0, 1)[:, np.newaxis],
    )


def _make_robots(experiment: Experiment) -> list[Robot]:
    make: RobotMaker = load_firmware(experiment.firmware)
    if experiment.firmware == "reference":
        conventions = AUTHORS if experiment.conventions is Convention.AUTHORS else PAPER
        make = partial(ReferenceRobot, conventions=conventions, omega=float(experiment.omega))
    return [
        make(experiment.config(robot), robot, experiment.b_hat(robot)) for robot in range(experiment.robots)
    ]


def _tick(robots: Sequence[Robot], colours: Sequence[bool]) -> None:
    """One step of all robots together: all observe, every one hears every other, all settle."""
    due = False
    for robot, black in zip(robots, colours, strict=True):
        due = robot.observe(_COLOURS[black]) == Status.DUE  # periods are equal, so all are due at once
    if due:
        for sender, robot in enumerate(robots):
            _broadcast(sender, robot, [*robots[:sender], *robots[sender + 1 :]])
    for robot in robots:
        robot.settle()


def _broadcast(sender: int, robot: Robot, others: Sequence[Robot]) -> None:
    if isinstance(robot, FixedPointRobot):
        x_raw, alpha_raw = robot.x_hat_raw, robot.alpha_raw
        for neighbour in cast(Sequence[FixedPointRobot], others):
            neighbour.receive_raw(sender, x_raw, alpha_raw)
    else:
        x_hat, alpha = robot.x_hat, robot.alpha
        for other in others:
            other.receive(sender, x_hat, alpha)


def _all(robots: Sequence[Robot], quantity: str) -> list[float]:
    return [getattr(robot, quantity) for robot in robots]


def _snapshot(robots: Sequence[Robot]) -> list[list[float]]:
    return [_all(robots, quantity) for quantity in QUANTITIES]
