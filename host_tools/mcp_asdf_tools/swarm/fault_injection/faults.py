"""All faults of a run, applied where nodes and frames pass.

``Faults`` stands between nodes and the carrier of their frames. In every tick it is used as follows::

    faults.begin_tick(tick, nodes)
    for node in nodes:
        if faults.robot_outage(node) is None: ...                # it observes, and settles later
        for frame in frames_of(node):
            sent_frame = faults.on_send(frame, node)             # None: nothing gets onto the bus
    deliveries = faults.on_delivery(sent_frames, in_range)       # what becomes of them at each receiver

Faults act in the order in which they are given, each on what those before it have left.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from typing import Any

import can

from mcp_asdf_tools.bus.frames import FrameFormat
from mcp_asdf_tools.swarm.delivery import Deliveries, ReceiverMask, SentFrame
from mcp_asdf_tools.swarm.fault_injection.fault import Fault, Outage
from mcp_asdf_tools.swarm.fault_injection.fault_run import FaultRun


class Faults:
    """The faults of one run.

    Attributes:
        faults: The faults, in the order in which they act.
    """

    def __init__(self, faults: Sequence[Fault], seed: int, frame_format: FrameFormat) -> None:
        """Prepare the faults; ``seed`` has up to 128 bits, ``frame_format`` is that of estimates."""
        self.faults = tuple(faults)
        self._runs: list[FaultRun] = []
        faults_of_kind = Counter[str]()
        for fault in self.faults:
            # Two faults of one kind have different numbers, and so draw different random words.
            self._runs.append(FaultRun(fault, faults_of_kind[fault.name], seed, frame_format))
            faults_of_kind[fault.name] += 1
        self._tick = -1
        self._outages: dict[int, list[Outage]] = {}
        """The outages of this tick, by node; nodes that are on the bus have none."""
        self._frames_sent = Counter[tuple[int, int]]()
        """Frames sent in this tick, by sender and identifier."""

    def begin_tick(self, tick: int, nodes: Iterable[int]) -> None:
        """Begin a tick: decide which of all ``nodes`` are off the bus in it. Ticks must rise one by one."""
        self._tick = tick
        self._frames_sent.clear()
        self._outages.clear()
        if not self._runs:
            return
        for node in nodes:
            # Every fault is asked, also if another one has hit the node: each counts its own ticks.
            outages = [run.fault.on_tick(node, tick, run) for run in self._runs]
            present_outages = [outage for outage in outages if outage is not None]
            if present_outages:
                self._outages[node] = present_outages

    def robot_outage(self, node: int) -> Outage | None:
        """Return the outage that keeps a node's robot dead in this tick; None while it lives."""
        for outage in self._outages.get(node, []):
            if outage.stops_robot:
                return outage
        return None

    def is_off_bus(self, node: int) -> bool:
        """Return whether a node neither sends nor receives in this tick: crashed, or cut off from the bus."""
        return node in self._outages

    def extra_frames(self, node: int, timestamp: float, *, before_others: bool) -> list[can.Message]:
        """Return the frames that a node sends in this tick besides its own, stamped ``timestamp`` (seconds).

        ``before_others`` asks for those that precede the frames of all robots, otherwise for those that
        follow them. A node that is off the bus sends none. Call this once per tick for either, and pass each
        frame to ``on_send``.
        """
        if self.is_off_bus(node):
            return []
        frames: list[can.Message] = []
        for run in self._runs:
            if run.fault.sends_before_others == before_others:
                frames += run.fault.extra_frames(node, self._tick, timestamp, run)
        return frames

    def on_send(self, frame: can.Message, sender: int) -> SentFrame | None:
        """Return what gets onto the bus when a node sends ``frame`` in this tick; None while it is off.

        Faults may have changed the frame, its id or its estimate. Call this once per frame, in the order in
        which they are sent.
        """
        if not self._runs:
            return SentFrame(frame, sender, self._tick)
        if self.is_off_bus(sender):
            return None
        # Frames with the same identifier in a tick draw different random words by their repetition.
        repetition = self._frames_sent[sender, frame.arbitration_id]
        self._frames_sent[sender, frame.arbitration_id] += 1
        sent_frame = SentFrame(frame, sender, self._tick, repetition)
        for run in self._runs:
            sent_frame = run.fault.on_send(sent_frame, run)
        return sent_frame

    def on_delivery(self, sent_frames: Sequence[SentFrame], in_range: ReceiverMask) -> list[Deliveries]:
        """Return what becomes of frames at the receivers that are in range in this tick.

        Some may be lost, changed, duplicated, or delayed to a later tick. Nodes that are off the bus receive
        nothing. Call this once per tick with all frames. O(faults frames receivers).
        """
        receivers = in_range.copy()
        nodes_off_bus = list(self._outages)
        receivers[:, nodes_off_bus] = False
        deliveries = [Deliveries(sent_frames, receivers)]
        for run in self._runs:
            changed_deliveries: list[Deliveries] = []
            for earlier in deliveries:
                # A fault may split deliveries, such as into those that it delays and all others.
                changed_deliveries += run.fault.on_delivery(earlier, run)
            # Those that nobody receives are left out.
            deliveries = [changed for changed in changed_deliveries if changed.receivers.any()]
        return deliveries

    def figures(self) -> list[dict[str, Any]]:
        """Return each fault's text, ``fault``, and its hits, ``injected``, as plain values for JSON.

        Outages count ticks of a robot, all other kinds frames.
        """
        return [{"fault": str(run.fault), "injected": run.hit_count} for run in self._runs]
