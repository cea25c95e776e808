"""Run trials of an experiment on any firmware and measure them.

Native trials run in the C engine, those of the reference in arrays; those of the mirror, and what the arrays
cannot do, robot by robot and message by message in Python. All see the same draws. The series of informed
estimates of a trial is dropped as soon as K and e are known.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, cast

import numpy as np
from mcp_asdf.fixed_point import ONE, SHIFT_MAX, UNITS_PER_ALPHA, b_hat_to_raw
from mcp_asdf.reference import ReferenceRobot
from mcp_asdf.robot import FixedPointRobot, Observation, Robot
from numpy.typing import NDArray

from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.experiments import reference_arrays
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.scores import DELTA, settling_step
from mcp_asdf_tools.robots.firmwares import RobotMaker, load_firmware
from mcp_asdf_tools.world.world import TrialWorld

if TYPE_CHECKING:
    from mcp_asdf_tools.experiments.engine.native import RawOutcome

QUANTITIES = ("t", "n", "x_hat", "alpha", "x_bar", "beta", "x", "b_hat")
"""Recorded values of a robot, named as the attributes of ``Robot``."""

_STEPS_AT_ONCE = 512
_COLOURS = (Observation.WHITE, Observation.BLACK)


@dataclass(frozen=True)
class Measured:
    """Results of trials ``first`` .. of an experiment; the first axis is the trial.

    Attributes:
        first: Number of the first trial.
        settled: K of each robot, shape (trials, N).
        errors: e of each robot, shape (trials, N).
        b_hat: Assumed accuracies after each filter step, shape (trials, T // filter_period, N).
        tests: Hypothesis tests run by each robot, shape (trials, N), modulo 65536, as ``updates``.
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
    if experiment.firmware == "native" and not experiment.is_dynamic:
        return _run_native(experiment, first, trials, thinning)
    each = [_run_one(experiment, first + index, thinning) for index in range(trials)]
    return Measured(
        first, *(np.concatenate([getattr(one, name) for one in each], axis=axis) for name, axis in _AXES)
    )


def _run_one(experiment: Experiment, trial: int, thinning: int) -> Measured:
    if experiment.firmware == "native":
        return _run_native(experiment, trial, 1, thinning)
    if experiment.firmware == "reference" and thinning == 0 and reference_arrays.can_run(experiment):
        return _run_float64(experiment, trial)
    return run_by_message(experiment, trial, thinning)


_AXES = (("settled", 0), ("errors", 0), ("b_hat", 0), ("tests", 0), ("updates", 0), ("records", 1))


def measure(
    series: NDArray[np.uint32] | NDArray[np.float64], unit: float, fill_ratio: float
) -> tuple[int, float]:
    """K and e of one series of informed estimates, given in units of ``unit``."""
    settled = settling_step(series, DELTA / unit)
    return settled, abs(float(series[settled]) * unit - fill_ratio)


def _run_native(experiment: Experiment, first: int, trials: int, thinning: int) -> Measured:
    try:
        # Imported here, so that other firmwares run where nothing has been built.
        from mcp_asdf_tools.experiments.engine import native  # noqa: PLC0415
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
            values[:, 1:] = _confidences(whole) if name == "alpha" else whole / units.get(name, 1)
        records[-1, :, 0] = [b_hat_to_raw(experiment.b_hat(j)) / 2**32 for j in range(experiment.robots)]
    return records


def _confidences(words: NDArray[np.uint32]) -> NDArray[np.float64]:
    """The values of alpha words, exactly."""
    return np.ldexp((words >> 8) / UNITS_PER_ALPHA, (words & SHIFT_MAX).astype(np.int32))


def _run_float64(experiment: Experiment, trial: int) -> Measured:
    outcome = reference_arrays.run(experiment, trial)
    counts = (outcome.tests, outcome.updates)
    return _measured(experiment, trial, outcome.x, outcome.b_hat, counts)


def run_by_message(experiment: Experiment, trial: int, thinning: int = 0) -> Measured:
    """One trial in Python, robot by robot and message by message, as a swarm would."""
    robots = _make_robots(experiment)
    exchange = _Exchange(robots, experiment.comms_period, late=experiment.latency > 0)
    x, b_hat, records = [_all(robots, "x")], [], [_snapshot(robots)] if thinning else []
    for step, (seen, pairs) in enumerate(_steps(experiment, trial), start=1):
        exchange.tick(seen, pairs)
        x.append(_all(robots, "x"))
        if step % experiment.filter_period == 0:
            b_hat.append(_all(robots, "b_hat"))
        if thinning and step % thinning == 0:
            records.append(_snapshot(robots))
    counters = [robot.counters for robot in robots]
    counts = [np.array([getattr(each, name) for each in counters]) for name in ("tests", "updates")]
    measured = _measured(experiment, trial, np.array(x).T, np.array(b_hat), counts)
    shape = (-1, len(QUANTITIES), len(robots))
    return replace(measured, records=np.array(records).reshape(shape).swapaxes(0, 1)[:, np.newaxis])


def _measured(
    experiment: Experiment,
    trial: int,
    x: NDArray[np.float64],
    b_hat: NDArray[np.float64],
    counts: Sequence[NDArray[np.int64]],
) -> Measured:
    """One trial from its series of x, shape (N, T + 1), which is not needed any more."""
    pairs = [measure(series, 1.0, experiment.fill_ratio) for series in x]
    return Measured(
        trial,
        np.array([[settled for settled, _ in pairs]]),
        np.array([[error for _, error in pairs]]),
        b_hat.reshape(1, -1, experiment.robots),
        counts[0].reshape(1, -1),
        counts[1].reshape(1, -1),
        np.empty((len(QUANTITIES), 1, 0, experiment.robots)),
    )


Pairs = Sequence[Sequence[int]]
"""Receiver and sender of each message."""


def _steps(experiment: Experiment, trial: int) -> Iterator[tuple[Sequence[Observation | None], Pairs]]:
    """The observation of each robot in every step, None where it makes none, and the pairs in range."""
    world, none = TrialWorld(experiment, trial), [None] * experiment.robots
    for first in range(0, experiment.steps, _STEPS_AT_ONCE):
        scene = world.advance(min(_STEPS_AT_ONCE, experiment.steps - first))
        for black, observes, hears in zip(scene.black.tolist(), scene.observes, scene.hears, strict=True):
            yield [_COLOURS[colour] for colour in black] if observes else none, np.argwhere(hears).tolist()


def _make_robots(experiment: Experiment) -> list[Robot]:
    make: RobotMaker = load_firmware(experiment.firmware)
    if experiment.firmware == "reference":
        conventions = reference_arrays.conventions_of(experiment)
        make = partial(ReferenceRobot, conventions=conventions, omega=float(experiment.omega))
    return [
        make(experiment.config(robot), robot, experiment.b_hat(robot)) for robot in range(experiment.robots)
    ]


class _Exchange:
    """Steps of all robots together: all observe, hear their pairs' messages, and close their rounds.

    Robots broadcast in every ``comms_period``-th step. Messages that are ``late`` reach the robots that hear
    their sender in the step after the one that they were said in: until a robot observes again its values are
    those it said.
    """

    def __init__(self, robots: Sequence[Robot], comms_period: int, late: bool) -> None:
        self._robots, self._period, self._late = robots, comms_period, late
        self._steps_taken = 0
        self._deliver = self._send_raw if isinstance(robots[0], FixedPointRobot) else self._send

    def tick(self, seen: Sequence[Observation | None], pairs: Pairs) -> None:
        """One step."""
        if self._late and self._steps_taken > 0 and self._steps_taken % self._period == 0:
            self._deliver(pairs)
        for robot, observation in zip(self._robots, seen, strict=True):
            if observation is not None:
                robot.observe(observation)
        self._steps_taken += 1
        if self._steps_taken % self._period == 0:
            self._close_rounds(pairs)

    def _close_rounds(self, pairs: Pairs) -> None:
        if not self._late:
            self._deliver(pairs)
        for robot in self._robots:
            robot.settle()

    def _send(self, pairs: Pairs) -> None:
        said = [(robot.x_hat, robot.alpha) for robot in self._robots]
        for receiver, sender in pairs:
            self._robots[receiver].receive(sender, *said[sender])

    def _send_raw(self, pairs: Pairs) -> None:
        robots = cast(Sequence[FixedPointRobot], self._robots)
        said = [(robot.x_hat_raw, robot.alpha_raw) for robot in robots]
        for receiver, sender in pairs:
            robots[receiver].receive_raw(sender, *said[sender])


def _all(robots: Sequence[Robot], quantity: str) -> list[float]:
    return [getattr(robot, quantity) for robot in robots]


def _snapshot(robots: Sequence[Robot]) -> list[list[float]]:
    return [_all(robots, quantity) for quantity in QUANTITIES]
