"""A run of a swarm from start to end, and its results."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from statistics import fmean
from typing import Any

import can

from mcp_asdf_tools.bus.load import BIT_RATES, bus_load
from mcp_asdf_tools.common.versions import software_versions
from mcp_asdf_tools.robots.bus_robot import BusRobot
from mcp_asdf_tools.robots.filters import FILTERS
from mcp_asdf_tools.robots.lockstep import LockstepError
from mcp_asdf_tools.swarm.carrier import SwarmError, Wiring
from mcp_asdf_tools.swarm.settings import SwarmSettings
from mcp_asdf_tools.swarm.swarm import Swarm

SwarmHook = Callable[[Swarm], None]
"""Called after every tick."""


@dataclass
class SwarmRun:
    """A run of a swarm that has ended, after all its ticks or before.

    Attributes:
        settings: Parameters of the swarm.
        nodes: The robots in their last state.
        results: Results as plain values, for JSON.
        seconds: Time that its ticks took, without the hooks between them.
        interrupted: Whether the run was asked to stop before its end.
        failure: Why the bus or a remote robot ended the run, with the tick; None if it did not.
    """

    settings: SwarmSettings
    nodes: Sequence[BusRobot]
    results: dict[str, Any] = field(default_factory=dict)
    seconds: float = 0.0
    interrupted: bool = False
    failure: str | None = None

    def report(self, bus: dict[str, Any]) -> dict[str, Any]:
        """Return the results with all that is needed to repeat the run, as plain values for JSON.

        That is the parameters, ``bus``, a description of the bus, the versions of software, and whether and
        why the run ended early. Equal runs have equal reports.
        """
        return {
            "parameters": self.settings.plain(),
            "bus": bus,
            "versions": software_versions(),
            "interrupted": self.interrupted,
            "failure": self.failure,
            "results": self.results,
        }


def run_swarm(
    swarm: Swarm, hooks: Sequence[SwarmHook] = (), should_stop: Callable[[], bool] = lambda: False
) -> SwarmRun:
    """Run ``swarm`` for as many ticks as its settings have, and call every hook after each tick.

    The run ends early when ``should_stop``, which is called after each tick, returns true, on
    KeyboardInterrupt, and when the bus or a remote robot fails: no exception leaves this function for these,
    but the result says so. The results are those of the ticks that were done.
    """
    run = SwarmRun(swarm.settings, swarm.nodes)
    try:
        while swarm.ticks < swarm.settings.steps and not run.interrupted:
            start_time = time.monotonic()
            swarm.tick()
            run.seconds += time.monotonic() - start_time
            for hook in hooks:
                hook(swarm)
            run.interrupted = should_stop()
    except KeyboardInterrupt:
        run.interrupted = True
    except (SwarmError, LockstepError, can.CanError) as error:
        # The number of ticks done does not include the one that failed.
        run.failure = f"tick {swarm.ticks + 1}: {error}"
    run.results = results_of(swarm)
    return run


class Baselines:
    """Hook that runs the same swarm with other filters beside it, so that all can be compared at any time.

    The baselines have no bus, which makes no difference to their robots.

    Attributes:
        swarms: The baselines by filter.
    """

    def __init__(self, settings: SwarmSettings) -> None:
        """Create the baselines of a swarm with these settings: the same swarm with each filter to compare.

        The swarm's own filter is left out. Baselines run in lockstep and without a bus. Raises UsageError if
        the robots' firmware is not available here.
        """
        self.swarms: dict[str, Swarm] = {}
        for swarm_filter in FILTERS.values():
            if swarm_filter.is_baseline and swarm_filter.name != settings.filter:
                # In lockstep, whatever the clock of the swarm: without a bus there is nothing to wait for.
                baseline = replace(settings, filter=swarm_filter.name, clock="lockstep")
                self.swarms[swarm_filter.name] = Swarm(baseline, Wiring())

    def __call__(self, swarm: Swarm) -> None:
        """Let all baselines take a tick."""
        for baseline in self.swarms.values():
            baseline.tick()

    def mean_errors(self) -> dict[str, float]:
        """Return the present mean error of each baseline, by filter."""
        return {baseline_filter: mean_error(swarm) for baseline_filter, swarm in self.swarms.items()}


def results_of(swarm: Swarm) -> dict[str, Any]:
    """Return the results of a swarm's ticks so far as plain values, for JSON.

    They are the robots' estimates and errors, b_hat before and after, the numbers of tests, updates and
    frames, the hits of faults, the load of a real bus, how late the clock was, and results of each robot.
    """
    settings = swarm.settings
    nodes = swarm.nodes
    x = [node.robot.x for node in nodes]
    x_hat = [node.robot.x_hat for node in nodes]
    # Remote robots do not report how many tests they have made.
    total_tests = None if swarm.remote_robots else sum(node.counters.tests for node in nodes)
    return {
        "filter": settings.filter_description,
        "steps": swarm.ticks,
        "mean_x": fmean(x),
        "mean_error": mean_error(swarm),
        "spread_x": max(x) - min(x),
        "spread_x_hat": max(x_hat) - min(x_hat),
        "tests": total_tests,
        "updates": sum(node.counters.updates for node in nodes),
        "b_hat": {
            "flawed": _b_hat_before_and_after(swarm, range(settings.flawed)),
            "other": _b_hat_before_and_after(swarm, range(settings.flawed, settings.robots)),
        },
        "frames": swarm.traffic.figures(),
        "faults": swarm.faults.figures(),
        "bus_load": _bus_loads(swarm),
        "clock": None if swarm.clock is None else swarm.clock.figures(),
        "robots": [_robot_results(swarm, node) for node in nodes],
    }


def _bus_loads(swarm: Swarm) -> dict[str, dict[str, float]]:
    """Return the share of the time for which a real bus would be busy, at each usual bit rate.

    The keys are bit rates as texts, as JSON has them, then "mean", over all ticks so far, and "peak", in the
    tick with the most bits.
    """
    traffic = swarm.traffic
    seconds_per_tick = 1 / swarm.settings.steps_per_second
    bus_loads = {}
    for bit_rate in BIT_RATES:
        mean_load = 0.0  # before the first tick, when no time has passed
        if swarm.ticks > 0:
            mean_load = bus_load(traffic.bits, swarm.ticks * seconds_per_tick, bit_rate)
        peak_load = bus_load(traffic.peak_bits, seconds_per_tick, bit_rate)
        bus_loads[str(bit_rate)] = {"mean": mean_load, "peak": peak_load}
    return bus_loads


def mean_error(swarm: Swarm) -> float:
    """Return the mean over the robots of |x - f|: the distance of estimates from the share of black tiles."""
    return fmean(abs(node.robot.x - swarm.settings.fill_ratio) for node in swarm.nodes)


def _b_hat_before_and_after(swarm: Swarm, robots: Sequence[int]) -> dict[str, Any] | None:
    """Return how b_hat, the accuracy that robots assume of their sensors, has changed in a group of robots.

    Keys: ``robots``, their number; ``before`` and ``after``, the mean at the start and at present;
    ``after_min`` and ``after_max``, the extremes at present. Returns None for an empty group.
    """
    if not robots:
        return None
    b_hat_now = [swarm.nodes[robot].robot.b_hat for robot in robots]
    return {
        "robots": len(robots),
        "before": fmean(swarm.b_hat_at_start[robot] for robot in robots),
        "after": fmean(b_hat_now),
        "after_min": min(b_hat_now),
        "after_max": max(b_hat_now),
    }


def _robot_results(swarm: Swarm, node: BusRobot) -> dict[str, Any]:
    """Return the results of one robot as plain values, for JSON.

    ``delivered`` counts the estimates that its firmware got, ``refused`` those that it refused, ``rejected``
    other frames by the reason why they are no estimates. ``t`` is the number of observations, ``x`` the
    estimate, ``b_hat`` the assumed accuracy. ``tests`` is None for a remote robot.
    """
    reception = node.reception
    counters = node.counters
    return {
        "id": node.id,
        "delivered": reception.delivered,
        "refused": reception.refused,
        "rejected": {reason.name: count for reason, count in reception.rejected.items()},
        "tests": None if node.id in swarm.remote_robots else counters.tests,
        "updates": counters.updates,
        "t": node.robot.t,
        "b_hat": node.robot.b_hat,
        "x": node.robot.x,
    }
