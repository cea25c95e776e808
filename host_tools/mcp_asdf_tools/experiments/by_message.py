"""Trials in Python, robot by robot and message by message, on any firmware."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import cast

import numpy as np

from mcp_asdf.reference import ReferenceRobot
from mcp_asdf.robot import FixedPointRobot, Observation, Robot
from mcp_asdf_tools.experiments import reference_arrays
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.measurement import QUANTITIES, Measured, measured_trial
from mcp_asdf_tools.robots import RobotMaker, load_firmware
from mcp_asdf_tools.world import World

_STEPS_AT_ONCE = 512


_COLOURS = (Observation.WHITE, Observation.BLACK)


def run_by_message(experiment: Experiment, trial: int, sampling_interval: int = 0) -> Measured:
    """One trial in Python, robot by robot and message by message, as a swarm would."""
    robots = _make_robots(experiment)
    exchange = _Exchange(robots, experiment.comms_period, late=experiment.latency > 0)
    x, b_hat, records = [_all(robots, "x")], [], [_snapshot(robots)] if sampling_interval else []
    for step, (seen, pairs) in enumerate(_steps(experiment, trial), start=1):
        exchange.tick(seen, pairs)
        x.append(_all(robots, "x"))
        if step % experiment.filter_period == 0:
            b_hat.append(_all(robots, "b_hat"))
        if sampling_interval and step % sampling_interval == 0:
            records.append(_snapshot(robots))
    counters = [robot.counters for robot in robots]
    counts = [np.array([getattr(each, name) for each in counters]) for name in ("tests", "updates")]
    measured = measured_trial(experiment, trial, np.array(x).T, np.array(b_hat), counts)
    shape = (-1, len(QUANTITIES), len(robots))
    return replace(measured, records=np.array(records).reshape(shape).swapaxes(0, 1)[:, np.newaxis])


Pairs = Sequence[Sequence[int]]
"""Receiver and sender of each message."""


def _steps(experiment: Experiment, trial: int) -> Iterator[tuple[Sequence[Observation | None], Pairs]]:
    """The observation of each robot in every step, None where it makes none, and the pairs in range."""
    world, none = World(experiment, trial), [None] * experiment.robots
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
        make(experiment.config(robot).in_rounds(), robot, experiment.b_hat(robot))
        for robot in range(experiment.robots)
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
