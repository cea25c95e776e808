"""A swarm of robots on CAN buses, tick by tick.

Every robot runs a firmware of its own and joins the bus with a connection of its own. In one tick all
robots observe, those whose broadcast is due send a frame, all hear what the carrier brings them, and all
settle: the latency 0 of the paper's Algorithm 1. In lockstep a tick ends only when nothing is missing that
the faults have not taken away, so that a run depends on its settings alone, not on the timing of the bus.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from statistics import fmean
from typing import Any

import can

from mcp_asdf.robot import Observation
from mcp_asdf_tools.bus.frames import Estimate, FrameFormat, alpha_float32_bits, decode_estimate
from mcp_asdf_tools.bus.load import BIT_RATES, bus_load
from mcp_asdf_tools.common.versions import software_versions
from mcp_asdf_tools.recording.input_log import InputLogWriter
from mcp_asdf_tools.robots.bus_robot import BusRobot, Recorder
from mcp_asdf_tools.robots.clock import RealTimeClock
from mcp_asdf_tools.robots.filters import FILTERS
from mcp_asdf_tools.robots.lockstep import LockstepError
from mcp_asdf_tools.robots.node import FrameTaker
from mcp_asdf_tools.swarm.carrier import Carrier, SwarmError, Wiring
from mcp_asdf_tools.swarm.delivery import Delivery, SentFrame, content_of
from mcp_asdf_tools.swarm.faults import Faults
from mcp_asdf_tools.swarm.remote_robot import Driver, RemoteFirmware, check_remote, remote_robot
from mcp_asdf_tools.swarm.settings import SwarmSettings
from mcp_asdf_tools.swarm.traffic import Traffic
from mcp_asdf_tools.world.world import SteppedWorld


class Swarm:
    """Robots on a bus. A context manager: leaving it takes them off the bus.

    Attributes:
        settings: Its parameters.
        world: The ground truth.
        nodes: The robots by id.
        faults: The faults between them.
        clock: The clock that ends ticks; None in lockstep.
        traffic: Frames on the bus so far.
        ticks: Ticks done.
        b_hat_at_start: Assumed accuracy of each robot at the start.
    """

    def __init__(
        self,
        settings: SwarmSettings,
        wiring: Wiring,
        log: FrameTaker | None = None,
        input_log: InputLogWriter | None = None,
    ) -> None:
        """Make the robots and let each join its bus.

        ``log`` takes every frame that robots send, ``input_log`` the events of each. If some run elsewhere,
        call ``wait_until_up`` before the first tick. Raises UsageError if the firmware or the bus is not
        available, or the settings are impossible for robots elsewhere.
        """
        self.settings = settings
        self.ticks = 0
        self.world = SteppedWorld(settings)
        self.faults = Faults(settings.faults, settings.seed, settings.frames)
        is_lockstep = settings.clock == "lockstep"
        self.clock = None if is_lockstep else RealTimeClock(settings.steps_per_second)
        self._input_log = input_log
        self._remote = wiring.remote
        check_remote(settings, wiring)
        recorders: Mapping[int, Recorder] = {} if input_log is None else input_log.robots
        self.nodes = [
            (remote_robot if record.id in wiring.remote else BusRobot)(
                record, settings.frames, recorders.get(record.id)
            )
            for record in settings.records()
        ]
        self.b_hat_at_start = [node.robot.b_hat for node in self.nodes]
        self._here = [node for node in self.nodes if node.id not in wiring.remote]
        self.traffic = Traffic([node.reception for node in self.nodes])
        self._delivery = Delivery(lambda: self.world.current_neighbours, self.faults.paths, settings.latency)
        taker = None if log is None else _as_received(log, wiring)
        self._carrier = Carrier(self.nodes, self._delivery, settings.frames, self.clock)
        self._carrier.join(wiring, taker)
        self._drivers = self._drive(wiring, taker)

    def _drive(self, wiring: Wiring, log: FrameTaker | None) -> list[Driver]:
        """Drivers of the robots elsewhere, one a bus."""
        away = [node for node in self.nodes if node.id in wiring.remote]
        groups = [away] if wiring.is_shared and away else [[node] for node in away]
        ends = self._carrier.ends
        frames, in_turn = self.settings.frames, self.settings.swarm_filter.order_matters
        return [Driver(ends[nodes[0].id].bus, nodes, frames, log, in_turn) for nodes in groups]

    def __enter__(self) -> Swarm:
        return self

    def __exit__(self, *_: object) -> None:
        self._carrier.close()

    def wait_until_up(self, timeout: float, check: Callable[[], None] = lambda: None) -> None:
        """Return when all remote robots are there.

        ``check`` is called while waiting for them, now and later; it may raise an error that ends the wait.
        Raises LockstepError, naming missing robots, after ``timeout`` seconds.
        """
        for driver in self._drivers:
            driver.wait_until_up(timeout, check)

    def tick(self) -> None:
        """Let all robots take one step together.

        Raises SwarmError if the bus loses a frame in lockstep, LockstepError if a remote robot does not
        answer, can.CanError if the bus takes no frame; the swarm is then halfway through a tick and
        unusable. O(robots**2).
        """
        if self.clock is not None:
            self.clock.begin(self.ticks)
        seen = self.world.step()
        alive = self._here
        if self.faults.faults:
            alive = [node for node in alive if self.faults.survives(node, self.ticks)]
        frames: list[tuple[BusRobot, can.Message]] = [*self._reports(alive)]
        estimates = [*self._estimates(alive, seen), *self._commanded(seen)]
        # The robust filter hears by rising id, wherever the robots run.
        frames += sorted(estimates, key=lambda each: each[0].id)
        sent = self._babble(is_early=True)
        sent += [each for node, frame in frames for each in self._send(node, frame)]
        sent += self._babble(is_early=False)
        self._carrier.carry(self.ticks)
        for node in alive:
            node.end()
        for driver in self._drivers:
            driver.settle(driver.nodes)
        self.ticks += 1
        self.traffic.add([each.frame for each in sent])
        self.traffic.in_range, self.traffic.arrived = self._delivery.in_range, self._delivery.arrived
        self.traffic.missed = self._carrier.missed

    def _commanded(self, seen: Sequence[Observation | None]) -> Iterator[tuple[BusRobot, can.Message]]:
        """Let remote robots observe; yields what they send."""
        for driver in self._drivers:
            for node, frame in driver.observe({robot: seen[robot] for robot in driver.nodes}):
                is_estimate = isinstance(decode_estimate(frame, self.settings.frames), Estimate)
                self.traffic.sent += is_estimate
                self.traffic.heartbeats_sent += not is_estimate
                yield node, frame

    def _reports(self, alive: list[BusRobot]) -> Iterator[tuple[BusRobot, can.Message]]:
        """Heartbeats, then telemetry of the state before this tick."""
        now = self._now
        period = self.settings.telemetry_period
        for node in alive:
            if node.is_heartbeat_due(self.settings.steps_per_second):
                self.traffic.heartbeats_sent += 1
                yield node, node.heartbeat(now)
        if period and self.ticks % period == 0:
            self.traffic.telemetry_sent += len(alive)
            yield from ((node, node.telemetry(now)) for node in alive)

    def _estimates(
        self, alive: list[BusRobot], seen: Sequence[Observation | None]
    ) -> list[tuple[BusRobot, can.Message]]:
        """Let robots observe; returns the estimates due. They follow frames that no robot waits for."""
        now = self._now
        due = [(node, frame) for node in alive for frame in node.broadcast(seen[node.id], now)]
        self.traffic.sent += len(due)
        return due

    def _send(self, node: BusRobot, frame: can.Message) -> list[SentFrame]:
        """Let a robot send what the faults make of its frame."""
        leaving = self.faults.leave(frame, node.id, self.ticks)
        # A frame of a robot elsewhere is on its bus already, unchanged by faults.
        if self._input_log is not None and node.id not in self._remote:
            _note_fate(self._input_log, node.id, frame, leaving, self.settings.frames)
        for sent in leaving:
            self._carrier.send(sent)
        return leaving

    def _babble(self, is_early: bool) -> list[SentFrame]:
        """Let nodes send what they send besides their own frames."""
        leaving: list[SentFrame] = []
        for node in self.nodes if self.faults.faults else ():
            for frame in self.faults.babble(node.id, self.ticks, self._now, is_early):
                for sent in self.faults.leave(frame, node.id, self.ticks):
                    if self._input_log is not None and node.id not in self._remote:
                        self._input_log.injected(sent.frame)
                    self._carrier.send(sent)
                    leaving.append(sent)
        return leaving

    @property
    def _now(self) -> float:
        """Simulated time, seconds."""
        return self.ticks / self.settings.steps_per_second


def _as_received(log: FrameTaker, wiring: Wiring) -> FrameTaker:
    """Mark frames as received: SocketCAN marks those from this computer as sent."""

    def take(frame: can.Message) -> None:
        frame.is_rx = True
        if wiring.open_bus is None:
            frame.channel = wiring.channel
        log(frame)

    return take


def _note_fate(
    input_log: InputLogWriter,
    robot: int,
    frame: can.Message,
    leaving: Sequence[SentFrame],
    frames: FrameFormat,
) -> None:
    """Record how what leaves the robot, a frame or none, differs from its own ``frame``."""
    after = leaving[0].frame if leaving else None
    if after is not None and content_of(after) == content_of(frame):
        return
    own, said = (None if each is None else decode_estimate(each, frames) for each in (frame, after))
    if (
        after is not None
        and isinstance(own, Estimate)
        and isinstance(said, Estimate)
        and said.sender == robot
    ):
        input_log.robots[robot].falsified(said.x_hat, alpha_float32_bits(after))
        return
    if after is not None:
        input_log.injected(after)
    if isinstance(own, Estimate):
        input_log.robots[robot].silent()


# --- A run from start to end ---

SwarmHook = Callable[[Swarm], None]
"""Called after every tick."""


@dataclass
class SwarmRun:
    """Run of a swarm, finished or not.

    Attributes:
        settings: Its parameters.
        nodes: The robots in their last state.
        results: Results as plain values, for JSON.
        interrupted: Whether Ctrl-C ended it.
        failure: Failure of the bus that ended it; None if there was none.
    """

    settings: SwarmSettings
    nodes: Sequence[BusRobot]
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


def run_swarm(
    swarm: Swarm, hooks: Sequence[SwarmHook] = (), should_stop: Callable[[], bool] = lambda: False
) -> SwarmRun:
    """Run ``swarm`` for the ticks its settings ask for, calling every hook after each tick.

    ``should_stop``, KeyboardInterrupt and a failing bus end the run early; the ticks done count.
    """
    outcome = SwarmRun(swarm.settings, swarm.nodes)
    try:
        while swarm.ticks < swarm.settings.steps and not outcome.interrupted:
            swarm.tick()
            for hook in hooks:
                hook(swarm)
            outcome.interrupted = should_stop()
    except KeyboardInterrupt:
        outcome.interrupted = True
    except (SwarmError, LockstepError, can.CanError) as error:
        outcome.failure = f"tick {swarm.ticks + 1}: {error}"
    outcome.results = results_of(swarm)
    return outcome


class Companions:
    """Hook that keeps the same swarm with other filters in step, so that all can be compared at any time.

    They have no bus, which makes no difference to their robots.

    Attributes:
        swarms: The other swarms by filter.
        seconds: Time spent on them.
    """

    def __init__(self, settings: SwarmSettings) -> None:
        """Make the other swarms. Raises as ``Swarm``."""
        self.swarms = {
            baseline.name: Swarm(replace(settings, filter=baseline.name, clock="lockstep"), Wiring())
            for baseline in FILTERS.values()
            if baseline.is_baseline and baseline.name != settings.filter
        }
        self.seconds = 0.0

    def __call__(self, swarm: Swarm) -> None:
        """Take a step, as ``swarm`` has."""
        began = time.monotonic()
        for other in self.swarms.values():
            other.tick()
        self.seconds += time.monotonic() - began

    def errors(self) -> dict[str, float]:
        """The other swarms' mean errors at present."""
        return {each: mean_error(swarm) for each, swarm in self.swarms.items()}


def results_of(swarm: Swarm) -> dict[str, Any]:
    """Results of a swarm so far, as plain values."""
    settings, nodes = swarm.settings, swarm.nodes
    x, x_hat = ([getattr(node.robot, name) for node in nodes] for name in ("x", "x_hat"))
    has_remote = any(isinstance(node.robot, RemoteFirmware) for node in nodes)
    traffic, tick = swarm.traffic, 1 / settings.steps_per_second
    return {
        "filter": settings.filter_description,
        "steps": swarm.ticks,
        "mean_x": fmean(x),
        "mean_error": mean_error(swarm),
        "spread_x": max(x) - min(x),
        "spread_x_hat": max(x_hat) - min(x_hat),
        "tests": None if has_remote else sum(node.counters.tests for node in nodes),
        "updates": sum(node.counters.updates for node in nodes),
        "b_hat": {
            "flawed": _before_and_after(swarm, range(settings.flawed)),
            "other": _before_and_after(swarm, range(settings.flawed, settings.robots)),
        },
        "frames": traffic.figures(),
        "faults": swarm.faults.figures(),
        "bus_load": {
            str(rate): {
                "mean": bus_load(traffic.bits, swarm.ticks * tick, rate) if swarm.ticks else 0.0,
                "peak": bus_load(traffic.peak_bits, tick, rate),
            }
            for rate in BIT_RATES
        },
        "clock": None if swarm.clock is None else swarm.clock.figures(),
        "robots": [_robot_figures(node) for node in nodes],
    }


def mean_error(swarm: Swarm) -> float:
    """Mean |x - f| over the robots at present."""
    return fmean(abs(node.robot.x - swarm.settings.fill_ratio) for node in swarm.nodes)


def _before_and_after(swarm: Swarm, robots: Sequence[int]) -> dict[str, Any] | None:
    """Mean b_hat of ``robots`` at the start and at present; None if there are none."""
    if not robots:
        return None
    after = [swarm.nodes[robot].robot.b_hat for robot in robots]
    return {
        "robots": len(robots),
        "before": fmean(swarm.b_hat_at_start[robot] for robot in robots),
        "after": fmean(after),
        "after_min": min(after),
        "after_max": max(after),
    }


def _robot_figures(node: BusRobot) -> dict[str, Any]:
    """Figures of one robot."""
    reception, counters = node.reception, node.counters
    return {
        "id": node.id,
        "delivered": reception.delivered,
        "refused": reception.refused,
        "rejected": {reason.name: count for reason, count in reception.rejected.items()},
        "tests": None if isinstance(node.robot, RemoteFirmware) else counters.tests,
        "updates": counters.updates,
        "t": node.robot.t,
        "b_hat": node.robot.b_hat,
        "x": node.robot.x,
    }
