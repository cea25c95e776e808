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
from mcp_asdf.robot import FixedPointRobot, Observation, Robot
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.common.extras import install_instruction
from mcp_asdf_tools.common.versions import own_version
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.results import QUANTITIES, Trials
from mcp_asdf_tools.experiments.scores import DELTA, convergence_step
from mcp_asdf_tools.robots.firmwares import RobotMaker, load_firmware
from mcp_asdf_tools.world.world import World

Floats = NDArray[np.float64]


TRIALS_AT_ONCE = 8
"""Trials of moving swarms that the engine runs side by side."""

SERIES_BYTES = 32 << 20
"""Of their estimates together, unless one trial has more."""


def run_trials(experiment: Experiment, first: int, trials: int, sampling_interval: int = 0) -> Trials:
    """Run ``trials`` trials from ``first`` on, recorded every ``sampling_interval`` steps unless that is 0.

    Raises UsageError if the firmware cannot be had. O(trials steps robots), robots squared where not native.
    """
    numbers = range(first, first + trials)
    if not experiment.lacking_in_c:
        if experiment.topology == "fully-connected":
            return _run_native(experiment, first, trials, sampling_interval)
        # Elsewhere a trial has a series of x for each robot: a few at a time bound the memory.
        few = min(max(SERIES_BYTES // (4 * experiment.robots * (experiment.steps + 1)), 1), TRIALS_AT_ONCE)
        parts = (numbers[start : start + few] for start in range(0, trials, few))
        return _joined([_run_native(experiment, part[0], len(part), sampling_interval) for part in parts])
    return _joined([_run_by_message(experiment, number, sampling_interval) for number in numbers])


def _joined(parts: Sequence[Trials]) -> Trials:
    """Trials of one experiment together."""
    arrays: dict[str, Any] = {
        name: np.concatenate([getattr(part, name) for part in parts])
        for name in ("convergence_steps", "errors", "b_hat", "tests", "updates")
    }
    return replace(
        parts[0],
        numbers=[number for part in parts for number in part.numbers],
        **arrays,
        records={name: np.concatenate([part.records[name] for part in parts]) for name in parts[0].records},
    )


def _measured(experiment: Experiment, x: NDArray[Any], unit: float) -> tuple[NDArray[np.int64], Floats]:
    """K and e of each robot from the series of x in units of ``unit``, shape (trials, N or 1, steps + 1).

    One series stands for all robots of its trial.
    """
    steps = np.array([[convergence_step(series, DELTA / unit) for series in trial] for trial in x])
    settled = np.take_along_axis(x, steps[..., np.newaxis], 2)[..., 0]
    errors = abs(settled.astype(np.float64) * unit - experiment.fill_ratio)
    shape = (len(x), experiment.robots)
    return np.broadcast_to(steps, shape).astype(np.int64), np.broadcast_to(errors, shape).copy()


# --- In the C engine -------------------------------------------------------------------------------------


def _engine() -> ModuleType:
    """The engine, loaded when first needed: other firmwares run where nothing has been built."""
    try:
        from mcp_asdf_tools.experiments.engine import native  # noqa: PLC0415
    except ImportError as error:
        raise UsageError(
            f"the engine cannot be loaded ({error}); choose firmware mirror, or to build the engine, "
            f"{install_instruction()}"
        ) from error
    return native


def _run_native(experiment: Experiment, first: int, trials: int, sampling_interval: int) -> Trials:
    raw = _engine().run(experiment, first, trials, sampling_interval)
    counted = raw.counters
    return Trials(
        experiment,
        list(range(first, first + trials)),
        *_measured(experiment, raw.x, 1 / ONE),
        raw.b_hat / 2.0**32,
        counted["tests"],
        counted["updates"],
        _records_of(experiment, raw.records) if sampling_interval else {},
        sampling_interval,
    )


def _records_of(experiment: Experiment, raw: NDArray[Any]) -> dict[str, Floats]:
    """The engine's records as floats, with step 0 before them."""
    b_hat = [b_hat_to_raw(experiment.b_hat(robot)) / 2**32 for robot in range(experiment.robots)]
    start: dict[str, Any] = {"x_hat": 0.5, "x_bar": 0.5, "x": 0.5, "b_hat": b_hat}
    units = {"x_hat": ONE, "x_bar": ONE, "x": ONE, "beta": UNITS_PER_ALPHA, "b_hat": 2**32}
    records = {}
    for name in QUANTITIES:
        values = records[name] = np.empty((len(raw), raw.shape[1] + 1, experiment.robots))
        values[:, 0] = start.get(name, 0.0)
        values[:, 1:] = _confidences(raw[name]) if name == "alpha" else raw[name] / units.get(name, 1)
    return records


def _confidences(words: NDArray[np.uint32]) -> Floats:
    """The values of alpha words, exactly."""
    return np.ldexp((words >> 8) / UNITS_PER_ALPHA, (words & SHIFT_MAX).astype(np.int32))


# --- Message by message ----------------------------------------------------------------------------------

_STEPS_AT_ONCE = 512
_COLOURS = (Observation.WHITE, Observation.BLACK)

Pairs = Sequence[Sequence[int]]
"""Receiver and sender of each message."""


def _run_by_message(experiment: Experiment, trial: int, sampling_interval: int) -> Trials:
    swarm = MessageSwarm(experiment, trial)
    x, b_hat, records = [swarm.all("x")], [], [swarm.snapshot()]
    for step in swarm.steps():
        x.append(swarm.all("x"))
        if step % experiment.filter_period == 0:
            b_hat.append(swarm.all("b_hat"))
        if sampling_interval and step % sampling_interval == 0:
            records.append(swarm.snapshot())
    counters = [robot.counters for robot in swarm.robots]
    return Trials(
        experiment,
        [trial],
        *_measured(experiment, np.array(x).T[np.newaxis], 1.0),
        np.reshape(b_hat, (1, -1, experiment.robots)),
        np.array([[each.tests for each in counters]]),
        np.array([[each.updates for each in counters]]),
        dict(zip(QUANTITIES, np.array(records).swapaxes(0, 1)[:, np.newaxis], strict=True))
        if sampling_interval
        else {},
        sampling_interval,
    )


class MessageSwarm:
    """A trial in Python on any firmware: all robots observe, hear their pairs' messages, and settle.

    Robots broadcast in every ``comms_period``-th step. With a latency messages reach the robots that hear
    their sender in the step after the one that they were said in: until a robot observes again its values
    are those it said.
    """

    def __init__(self, experiment: Experiment, trial: int) -> None:
        self._experiment, self._world = experiment, World(experiment, trial)
        self.robots = _make_robots(experiment)
        # An extension may mix robots of both kinds, and then all of them exchange floats.
        have_raw_values = all(isinstance(robot, FixedPointRobot) for robot in self.robots)
        self._deliver = self._send_raw if have_raw_values else self._send

    def steps(self) -> Iterator[int]:
        """Take every step of the trial; yields its number, from 1, when it is over."""
        period, is_late = self._experiment.comms_period, self._experiment.latency > 0
        for step, (seen, pairs) in enumerate(self._scenes(), start=1):
            if is_late and step > 1 and (step - 1) % period == 0:
                self._deliver(pairs)
            for robot, observation in zip(self.robots, seen, strict=True):
                if observation is not None:
                    robot.observe(observation)
            if step % period == 0:
                if not is_late:
                    self._deliver(pairs)
                for robot in self.robots:
                    robot.settle()
            yield step

    def _scenes(self) -> Iterator[tuple[Sequence[Observation | None], Pairs]]:
        """The observation of each robot in every step, None where it makes none, and the pairs in range."""
        steps, none = self._experiment.steps, [None] * len(self.robots)
        for first in range(0, steps, _STEPS_AT_ONCE):
            scene = self._world.advance(min(_STEPS_AT_ONCE, steps - first))
            for black, observes, hears in zip(
                scene.black.tolist(), scene.observes, scene.neighbours, strict=True
            ):
                yield (
                    [_COLOURS[colour] for colour in black] if observes else none,
                    np.argwhere(hears).tolist(),
                )

    def _send(self, pairs: Pairs) -> None:
        said = [(robot.x_hat, robot.alpha) for robot in self.robots]
        for receiver, sender in pairs:
            self.robots[receiver].receive(sender, *said[sender])

    def _send_raw(self, pairs: Pairs) -> None:
        robots = cast(Sequence[FixedPointRobot], self.robots)
        said = [(robot.x_hat_raw, robot.alpha_raw) for robot in robots]
        for receiver, sender in pairs:
            robots[receiver].receive_raw(sender, *said[sender])

    def all(self, quantity: str) -> list[float]:
        """A value of each robot now."""
        return [getattr(robot, quantity) for robot in self.robots]

    def snapshot(self) -> list[list[float]]:
        """QUANTITIES of each robot now."""
        return [self.all(quantity) for quantity in QUANTITIES]


def _make_robots(experiment: Experiment) -> list[Robot]:
    make: RobotMaker = load_firmware(experiment.firmware)
    if experiment.firmware == "reference":
        conventions = AUTHORS if experiment.conventions == "authors" else PAPER
        make = partial(ReferenceRobot, conventions=conventions, omega=float(experiment.omega))
    return [
        make(experiment.config(robot), robot, experiment.b_hat(robot)) for robot in range(experiment.robots)
    ]


# --- Jobs ------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Job:
    """Arguments of ``run_trials`` for a worker process, which must have this version of the program."""

    experiment: Experiment
    first: int
    count: int
    sampling_interval: int = 0
    version: str = field(default_factory=own_version)

    def run(self) -> Trials:
        """The job's results. Raises UsageError in a program of another version, and as ``run_trials``."""
        if self.version != (own := own_version()):
            raise UsageError(f"a worker has mcp-asdf {own}, this is {self.version}; install the same on all")
        return run_trials(self.experiment, self.first, self.count, self.sampling_interval)
