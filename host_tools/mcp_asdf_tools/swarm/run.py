"""One run of a swarm from start to end: its history and its results."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from statistics import fmean
from typing import Any

import can
import numpy as np
from numpy.typing import NDArray

from mcp_asdf_tools.bus import BIT_RATES, bus_load
from mcp_asdf_tools.common import software_versions
from mcp_asdf_tools.robots import ClockKind, LockstepError
from mcp_asdf_tools.swarm.connection import SwarmError
from mcp_asdf_tools.swarm.medium import Wiring
from mcp_asdf_tools.swarm.remote_robot import RemoteNode
from mcp_asdf_tools.swarm.settings import SwarmSettings
from mcp_asdf_tools.swarm.swarm import Swarm, SwarmRobot
from mcp_asdf_tools.swarm.traffic import Traffic

QUANTITIES = ("b_hat", "x_hat", "x")
"""Quantities of each robot in a history."""

MAX_SAMPLES = 2000
"""About as many as a plot can show."""

SwarmHook = Callable[[Swarm], None]
"""Called after every tick."""


class History:
    """Every robot's b_hat, x_hat and x over time, thinned so that memory does not grow with the run."""

    def __init__(self, ticks: int) -> None:
        """Prepare for a run of ``ticks``."""
        self._sampling_interval = -(-ticks // MAX_SAMPLES)
        self._ticks: list[int] = []
        self._rows: list[list[list[float]]] = []

    def sample(self, swarm: Swarm) -> None:
        """Keep the present state if a sample is due."""
        if swarm.ticks % self._sampling_interval == 0:
            self.add(swarm)

    def add(self, swarm: Swarm) -> None:
        """Keep the present state, once."""
        if self._ticks[-1:] != [swarm.ticks]:
            self._ticks.append(swarm.ticks)
            self._rows.append([[getattr(node.robot, name) for node in swarm.nodes] for name in QUANTITIES])

    @property
    def ticks(self) -> NDArray[np.int64]:
        """Ticks done at each sample, rising from 0."""
        return np.array(self._ticks, dtype=np.int64)

    def values(self, quantity: str) -> NDArray[np.float64]:
        """One of QUANTITIES, of shape (samples, robots)."""
        index = QUANTITIES.index(quantity)
        return np.array([row[index] for row in self._rows], dtype=np.float64)


@dataclass
class SwarmRun:
    """Run of a swarm, finished or not.

    Attributes:
        settings: Its parameters.
        nodes: The robots in their last state.
        history: Their states over time.
        results: Results as plain values, for JSON.
        interrupted: Whether Ctrl-C ended it.
        failure: Failure of the bus that ended it; None if there was none.
    """

    settings: SwarmSettings
    nodes: Sequence[SwarmRobot]
    history: History
    results: dict[str, Any] = field(default_factory=dict)
    interrupted: bool = False
    failure: str | None = None

    def report(self, bus: dict[str, Any]) -> dict[str, Any]:
        """Everything needed to repeat the run, and its results, as plain values; equal for equal runs."""
        return {
            "parameters": self.settings.plain(),
            "bus": bus,
            "versions": software_versions(),
            "interrupted": self.interrupted,
            "failure": self.failure,
            "results": self.results,
        }


def run_swarm(swarm: Swarm, hooks: Sequence[SwarmHook] = ()) -> SwarmRun:
    """Run ``swarm`` for the ticks its settings ask for, calling every hook after each tick.

    KeyboardInterrupt (from a hook, say) and a failing bus end the run early; the ticks done count.
    """
    history = History(swarm.settings.steps)
    history.add(swarm)
    outcome = SwarmRun(swarm.settings, swarm.nodes, history)
    try:
        while swarm.ticks < swarm.settings.steps:
            swarm.tick()
            history.sample(swarm)
            for hook in hooks:
                hook(swarm)
    except KeyboardInterrupt:
        outcome.interrupted = True
    except (SwarmError, LockstepError, can.CanError) as error:
        outcome.failure = f"tick {swarm.ticks + 1}: {error}"
    history.add(swarm)
    outcome.results = _results(swarm, history)
    return outcome


class Companion:
    """Hook that keeps the same swarm without the filter in step, so that both can be compared at any time.

    It has no bus, which makes no difference to its robots.

    Attributes:
        swarm: The swarm without the filter.
        seconds: Time spent on it.
    """

    def __init__(self, settings: SwarmSettings) -> None:
        """Make the other swarm. Raises as ``Swarm``."""
        self.swarm = Swarm(replace(settings.without_filter(), clock=ClockKind.LOCKSTEP), Wiring())
        self.seconds = 0.0
        self._history = History(settings.steps)
        self._history.add(self.swarm)

    def __call__(self, swarm: Swarm) -> None:
        """Take a step, as ``swarm`` has."""
        began = time.monotonic()
        self.swarm.tick()
        self._history.sample(self.swarm)
        self.seconds += time.monotonic() - began

    def results(self) -> dict[str, Any]:
        """Its results so far, as those of a run."""
        self._history.add(self.swarm)
        return _results(self.swarm, self._history)


def _results(swarm: Swarm, history: History) -> dict[str, Any]:
    x, x_hat = history.values("x")[-1], history.values("x_hat")[-1]
    counters = [node.counters for node in swarm.nodes]
    has_remote = any(isinstance(node, RemoteNode) for node in swarm.nodes)
    flawed = [node.id for node in swarm.nodes if swarm.settings.is_flawed(node.id)]
    other = [node.id for node in swarm.nodes if not swarm.settings.is_flawed(node.id)]
    tick = 1 / swarm.settings.steps_per_second
    return {
        "steps": swarm.ticks,
        "mean_x": fmean(x),
        "mean_error": fmean(np.abs(x - swarm.settings.fill_ratio)),
        "spread_x": float(np.ptp(x)),
        "spread_x_hat": float(np.ptp(x_hat)),
        "tests": None if has_remote else sum(each.tests for each in counters),
        "updates": sum(each.updates for each in counters),
        "b_hat": {
            "flawed": _before_and_after(history, flawed),
            "other": _before_and_after(history, other),
        },
        "frames": swarm.traffic.figures(),
        "faults": swarm.faults.figures(),
        "bus_load": loads(swarm.traffic, swarm.ticks * tick, tick),
        "clock": swarm.clock.figures(),
        "robots": [_robot_figures(node) for node in swarm.nodes],
    }


def _before_and_after(history: History, robots: Sequence[int]) -> dict[str, Any] | None:
    """Mean b_hat of ``robots`` at the start and at the end; None if there are none."""
    if not robots:
        return None
    chosen = history.values("b_hat")[:, robots]
    after = chosen[-1]
    return {
        "robots": len(robots),
        "before": fmean(chosen[0]),
        "after": fmean(after),
        "after_min": float(after.min()),
        "after_max": float(after.max()),
    }


def loads(traffic: Traffic, seconds: float, tick: float) -> dict[str, dict[str, float]]:
    """Load of a run's traffic on one real bus, by bit rate.

    ``mean`` over the ``seconds`` of the run, and ``peak`` in the busiest tick, of ``tick`` seconds.
    """
    return {
        str(rate): {
            "mean": bus_load(traffic.bits, seconds, rate) if seconds else 0.0,
            "peak": bus_load(traffic.peak_bits, tick, rate),
        }
        for rate in BIT_RATES
    }


def _robot_figures(node: SwarmRobot) -> dict[str, Any]:
    """Figures of one robot."""
    reception, counters = node.reception, node.counters
    return {
        "id": node.id,
        "delivered": reception.delivered,
        "refused": reception.refused,
        "rejected": {reason.name: count for reason, count in reception.rejected.items()},
        "tests": None if isinstance(node, RemoteNode) else counters.tests,
        "updates": counters.updates,
        "t": node.robot.t,
        "b_hat": node.robot.b_hat,
        "x": node.robot.x,
    }
