"""Neighbours of one real controller in real time."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from statistics import fmean
from typing import Any

import can

from mcp_asdf_tools.bus.frames import Estimate, decode_estimate
from mcp_asdf_tools.radio.neighbourhood import Neighbourhood
from mcp_asdf_tools.robots.clock import RealTimeClock
from mcp_asdf_tools.robots.node import BusLink, RunOutcome, Stopped


class RadioRun:
    """Emulated neighbours around a controller that has its own clock.

    Attributes:
        neighbours: The neighbours.
        link: The connection to the controller.
        outcome: How the run ended, once it is over.
        sent: Frames sent to the controller.
        heard: Estimates heard from it.
        strangers: Legal estimates from nodes that are neither the controller nor emulated.
        error_frames: Error frames, and what could not be decoded.
        id_conflicts: Estimates of other nodes under ids of emulated robots, by id.
        watch: Called after each tick.
    """

    def __init__(self, neighbours: Neighbourhood, link: BusLink, ticks: int | None = None) -> None:
        """Prepare for ``ticks`` ticks, or for any number if None."""
        self.neighbours = neighbours
        self.link = link
        self.outcome = RunOutcome("all ticks done")
        self.sent = self.heard = self.strangers = self.error_frames = 0
        self.id_conflicts = Counter[int]()
        self.watch: Callable[[], None] = lambda: None
        self._ticks = ticks
        self._said: list[can.Message] = []

    def run(self) -> None:
        """Tick until all ticks are done, until asked to stop, or until the bus is gone.

        Frames of the controller are heard at the next tick, and it is sent frames at ticks. The bus may fail
        meanwhile, but a run has failed if the last attempt to use the bus did.
        """
        clock = RealTimeClock(self.neighbours.settings.swarm.steps_per_second, sleep=self._listen)
        try:
            while self._ticks is None or self.neighbours.tick < self._ticks:
                clock.begin(self.neighbours.tick)
                self.link.catch_up(self._take)
                self._tick()
                self.watch()
        except (Stopped, KeyboardInterrupt):
            self.outcome.ending = "stopped"
            self.outcome.is_interrupted = self._ticks is not None
        except can.CanError as error:
            self.link.last_failure = error
        finally:
            self.outcome.lateness = clock.figures()
        if self.link.last_failure is not None:
            self.outcome.ending = f"the bus failed: {self.link.last_failure}"
            self.outcome.has_failed = True

    def figures(self) -> dict[str, Any]:
        """Results as plain values, for JSON."""
        x = [node.robot.x for node in self.neighbours.nodes.values()]
        return {
            "steps": self.neighbours.tick,
            **vars(self.outcome),
            "frames_sent": self.sent,
            "estimates_heard": self.heard,
            "strangers": self.strangers,
            "error_frames": self.error_frames,
            "id_conflicts": {str(sender): count for sender, count in self.id_conflicts.items()},
            "bus_failures": self.link.failures,
            "faults": self.neighbours.faults.figures(),
            "mean_x": fmean(x),
            "spread_x": max(x) - min(x),
        }

    def _tick(self) -> None:
        self.neighbours.begin()
        for frame in self.neighbours.finish(self._said):
            self.sent += self.link.send(frame)
        self._said = []

    def _listen(self, seconds: float) -> None:
        frame = self.link.receive(seconds)
        if frame is not None:
            self._take(frame)

    def _take(self, frame: can.Message) -> None:
        estimate = decode_estimate(frame, self.neighbours.settings.subjects.estimates)
        if not isinstance(estimate, Estimate):
            self.error_frames += frame.is_error_frame
            return
        if estimate.sender == self.neighbours.settings.controller.id:
            self.heard += 1
            self._said.append(frame)
        elif estimate.sender in self.neighbours.nodes:
            self.id_conflicts[estimate.sender] += 1
        else:
            self.strangers += 1
