"""Neighbours of one real controller in real time."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from statistics import fmean
from typing import Any

import can

from mcp_asdf_tools.bus.frames import Estimate, decode_estimate
from mcp_asdf_tools.radio.neighbourhood import RadioSettings, create_neighbours
from mcp_asdf_tools.robots.clock import RealTimeClock
from mcp_asdf_tools.robots.node import BusLink, RunOutcome, Stopped


class RadioRun:
    """Emulated neighbours around a controller that has its own clock.

    Attributes:
        settings: The surroundings of the controller.
        neighbours: The neighbours, in a swarm to which the controller belongs.
        link: The connection to the controller.
        outcome: How the run has ended.
        sent_count: Frames sent to the controller.
        estimate_count: Estimates received from the controller.
        foreign_count: Estimates of nodes that are neither the controller nor emulated.
        error_frame_count: Number of error frames.
        id_conflicts: Number of estimates that other nodes sent under ids of emulated robots, by id.
        on_tick: Called after each tick.
    """

    def __init__(self, settings: RadioSettings, link: BusLink, ticks: int | None = None) -> None:
        """Prepare a run of ``ticks`` ticks; None for one that goes on until it is stopped."""
        self.settings = settings
        self.neighbours = create_neighbours(settings)
        self.link = link
        self.outcome = RunOutcome("all ticks done")
        self.sent_count = 0
        self.estimate_count = 0
        self.foreign_count = 0
        self.error_frame_count = 0
        self.id_conflicts = Counter[int]()
        self.on_tick: Callable[[], None] = lambda: None
        self._ticks = ticks
        self._controller_frames: list[can.Message] = []
        """Estimates of the controller that its neighbours receive in the next tick."""

    def run(self) -> None:
        """Run until all ticks are done, the link asks to stop, or the bus has failed; then set ``outcome``.

        While a tick is waited for, the controller's frames are received; its neighbours get them in that
        tick, and it gets theirs. The bus may fail for a time in between: the run has failed only if the last
        attempt to use it did. Ctrl-C stops a run, too; one with a number of ticks is then interrupted.
        """
        # The clock does not just sleep until a tick: it receives frames in this time.
        clock = RealTimeClock(self.settings.swarm.steps_per_second, sleep=self._receive_while_waiting)
        try:
            self._run_ticks(clock)
        except (Stopped, KeyboardInterrupt):
            self.outcome.ending = "stopped"
            # A run without a number of ticks can end in no other way, and so is complete.
            self.outcome.is_interrupted = self._ticks is not None
        except can.CanError as error:
            self.link.last_failure = error
        finally:
            self.outcome.lateness = clock.figures()
        if self.link.last_failure is not None:
            self.outcome.ending = f"the bus failed: {self.link.last_failure}"
            self.outcome.has_failed = True

    def _run_ticks(self, clock: RealTimeClock) -> None:
        """Run all ticks, each at its time.

        Raises Stopped if the link asks to stop, and can.CanError if the bus is gone.
        """
        while self._ticks is None or self.neighbours.ticks < self._ticks:
            clock.wait_for_tick(self.neighbours.ticks)
            self.link.handle_waiting_frames(self._handle_frame)
            self._run_tick()
            self.on_tick()

    def figures(self) -> dict[str, Any]:
        """Return the results by name, as plain values for JSON: counts, how the run has ended, and mean x.

        ``mean_x`` and ``spread_x`` are the mean and the range, the largest minus the smallest, of the
        neighbours' estimates of the share of black tiles. In reports a tick is a step, and nodes that are
        neither the controller nor emulated are strangers.
        """
        x = [node.robot.x for node in self.neighbours.nodes]
        return {
            "steps": self.neighbours.ticks,
            "ending": self.outcome.ending,
            "is_interrupted": self.outcome.is_interrupted,
            "has_failed": self.outcome.has_failed,
            "lateness": self.outcome.lateness,
            "frames_sent": self.sent_count,
            "estimates_heard": self.estimate_count,
            "strangers": self.foreign_count,
            "error_frames": self.error_frame_count,
            # Keys of JSON are texts.
            "id_conflicts": {str(sender): count for sender, count in self.id_conflicts.items()},
            "bus_failures": self.link.failures,
            "faults": self.neighbours.faults.figures(),
            "mean_x": fmean(x),
            "spread_x": max(x) - min(x),
        }

    def _run_tick(self) -> None:
        """Let the neighbours take a tick, and send the controller what it receives of them.

        In a tick they observe once, receive the estimates that the controller has sent since the last tick,
        and end it.
        """
        self.neighbours.begin_tick()
        for frame in self.neighbours.finish_tick(self._controller_frames):
            is_sent = self.link.send(frame)
            if is_sent:
                self.sent_count += 1
        self._controller_frames = []

    def _receive_while_waiting(self, seconds: float) -> None:
        """Wait for a frame, but at most ``seconds``, and handle it."""
        frame = self.link.receive(seconds)
        if frame is not None:
            self._handle_frame(frame)

    def _handle_frame(self, frame: can.Message) -> None:
        """Keep an estimate of the controller for its neighbours; count others' estimates and error frames.

        Other frames, such as heartbeats, are ignored.
        """
        estimate = decode_estimate(frame, self.settings.subjects.estimates)
        if not isinstance(estimate, Estimate):
            if frame.is_error_frame:
                self.error_frame_count += 1
        elif estimate.sender == self.settings.controller.id:
            self.estimate_count += 1
            self._controller_frames.append(frame)
        elif estimate.sender in [neighbour.id for neighbour in self.settings.neighbours]:
            # Another node uses the id of an emulated neighbour.
            self.id_conflicts[estimate.sender] += 1
        else:
            self.foreign_count += 1
