"""The kinds of faults, a class for each. A new kind is a class here, and its entry in ``FAULT_KINDS``."""

from __future__ import annotations

import copy
from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar, Literal

from mcp_asdf_tools.bus.alpha_words import float32_bits, float32_value
from mcp_asdf_tools.bus.frame_layout import (
    ESTIMATE,
    MAX_FLOAT32_BITS,
    MAX_NODE_ID,
    Q23_ONE,
    TRANSFER_ID_MODULUS,
)
from mcp_asdf_tools.bus.frames import NODE_ID_MASK, Estimate, decode_estimate, encode_estimate, make_frame
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.common.parameters import parameter
from mcp_asdf_tools.swarm.fault_injection.fault import MAX_TICK, Fault, Outage

if TYPE_CHECKING:
    import can

    from mcp_asdf_tools.swarm.delivery import Deliveries, SentFrame
    from mcp_asdf_tools.swarm.fault_injection.fault_run import FaultRun

# --- Links: a frame on its way to one receiver ---


@dataclass(frozen=True, kw_only=True)
class LinkFault(Fault, ABC):
    """A fault of frames on their way: each receiver of a frame is hit or spared by itself.

    Attributes:
        receivers: The receivers that it affects; None for all.
    """

    receivers: frozenset[int] | None = None

    def on_delivery(self, deliveries: Deliveries, run: FaultRun) -> list[Deliveries]:
        """Return the spared deliveries, and what ``change`` makes of the deliveries that are hit.

        Deliveries are frames on their way, with the robots that receive each of them. The first random word
        of a frame and a receiver decides whether the frame is hit on its way there. The hits are counted.
        O(frames receivers).
        """
        is_hit = run.hits_receivers(deliveries, self.random_words)
        if self.receivers is not None:
            _, robot_count = is_hit.shape
            spared_robots = [robot for robot in range(robot_count) if robot not in self.receivers]
            # The frames for these robots pass, whatever random words were drawn for them.
            is_hit[:, spared_robots] = False
        run.hit_count += int(is_hit.sum())
        spared_deliveries = replace(deliveries, receivers=deliveries.receivers & ~is_hit)
        hit_deliveries = replace(deliveries, receivers=is_hit)
        return [spared_deliveries, *self.change(hit_deliveries, run)]

    @property
    def random_words(self) -> int:
        """Number of random words for each frame and receiver, the first of which decides on a hit."""
        return 1

    @property
    def named_robots(self) -> frozenset[int]:
        """Ids of all nodes that the options name, as senders or as receivers."""
        return super().named_robots | (self.receivers or frozenset())

    @abstractmethod
    def change(self, hit: Deliveries, run: FaultRun) -> list[Deliveries]:
        """Return the deliveries that take the place of ``hit``.

        ``hit`` has the frames that the fault hits, each with the receivers for which it is hit. ``run`` is
        the state of the fault in this run.
        """


@dataclass(frozen=True, kw_only=True)
class Loss(LinkFault):
    """A frame does not reach a receiver."""

    name = "loss"
    summary = "a frame does not reach a neighbour"

    def change(self, hit: Deliveries, run: FaultRun) -> list[Deliveries]:
        """Return nothing: the frames are lost."""
        return []


@dataclass(frozen=True, kw_only=True)
class Delay(LinkFault):
    """A frame reaches a receiver some ticks later."""

    name = "delay"
    summary = "a frame reaches a neighbour ticks later"

    ticks: int = parameter("how late", 1, MAX_TICK, default=1)

    def change(self, hit: Deliveries, run: FaultRun) -> list[Deliveries]:
        """Return the deliveries, later by ``ticks``."""
        return [replace(hit, delay=hit.delay + self.ticks)]


@dataclass(frozen=True, kw_only=True)
class Duplicate(LinkFault):
    """A frame reaches a receiver, and once more some ticks later or in the same tick."""

    name = "duplicate"
    summary = "a frame comes once more, ticks later"

    ticks: int = parameter("by how much the copy is later", 0, MAX_TICK, default=1)

    def change(self, hit: Deliveries, run: FaultRun) -> list[Deliveries]:
        """Return the deliveries, and copies of them that are later by ``ticks``.

        Copy numbers have a bit for each duplicate fault, so that copies made by different faults have
        different ones.
        """
        bit_of_this_fault = 1 << run.fault_number
        copy_number = hit.copy_number | bit_of_this_fault
        copies = replace(hit, delay=hit.delay + self.ticks, copy_number=copy_number)
        return [hit, copies]


@dataclass(frozen=True, kw_only=True)
class Corrupt(LinkFault):
    """Bits of a frame's data are flipped on the way to a receiver, other bits for each receiver."""

    name = "corrupt"
    summary = "bits of the data are flipped, unseen by the bus's checksum"

    bits: int = parameter("different bits of a frame that are flipped", 1, 64, default=1)

    @property
    def random_words(self) -> int:
        """Number of random words for each frame and receiver: besides the first, one for each bit to flip."""
        return 1 + self.bits

    def change(self, hit: Deliveries, run: FaultRun) -> list[Deliveries]:
        """Return the deliveries in ``hit`` with bits of their data flipped, other bits for each receiver."""
        return [run.corrupt(hit, self.random_words)]


# --- Outages: a node that is off the bus for some ticks ---


@dataclass(frozen=True, kw_only=True)
class OutageFault(Fault, ABC):
    """A fault that takes a node off the bus for some ticks."""

    ticks: int = parameter("how long", 1, MAX_TICK, default=1)

    @property
    @abstractmethod
    def outage(self) -> Outage:
        """State of a node that is hit."""

    def on_tick(self, node: int, tick: int, run: FaultRun) -> Outage | None:
        """Return the outage of a node that is off the bus in this tick; None for one that is on it.

        An outage lasts for ``ticks`` ticks. While it lasts the node cannot be hit again, but each of its
        ticks counts as a hit of the fault.
        """
        outage_end = run.memory.get(node, 0)  # the first tick after the node's latest outage
        if tick >= outage_end and run.hits_node(node, tick):
            outage_end = tick + self.ticks
            run.memory[node] = outage_end
        if tick >= outage_end:
            return None
        run.hit_count += 1
        return self.outage


@dataclass(frozen=True, kw_only=True)
class Crash(OutageFault):
    """A node is dead for some ticks, with its robot."""

    name = "crash"
    summary = "a node is dead for ticks, then rejoins new or restored"

    rejoin: Literal["new", "restored"] = parameter("new, or as it was when it crashed", default="new")

    @property
    def outage(self) -> Outage:
        """State of a node that is hit."""
        return Outage(stops_robot=True, loses_state=self.rejoin == "new")


@dataclass(frozen=True, kw_only=True)
class BusOff(OutageFault):
    """A node is cut off from the bus for some ticks, while its robot goes on."""

    name = "busoff"
    summary = "a node neither sends nor hears for ticks, while its robot goes on"

    @property
    def outage(self) -> Outage:
        """State of a node that is hit."""
        return Outage(stops_robot=False)


# --- Senders: a robot's frame that is changed before it is on the bus ---


@dataclass(frozen=True, kw_only=True)
class Freeze(Fault):
    """A robot's estimate is replaced by the last one that was not frozen."""

    name = "freeze"
    summary = "a broadcast repeats the estimate of the robot's last regular one"

    def on_send(self, sent_frame: SentFrame, run: FaultRun) -> SentFrame:
        """Return the frame or, if the fault hits it, one with the values of an earlier estimate of the robot.

        They are those of its last estimate that the fault did not hit; the transfer_id stays. Frames that are
        no estimate are not changed, nor is a robot's first estimate.
        """
        estimate = decode_estimate(sent_frame.frame, run.frame_format)
        if not isinstance(estimate, Estimate):
            return sent_frame
        # The memory of a node is its last estimate that was not frozen. The first one has none to repeat.
        last_regular = run.memory.get(sent_frame.sender)
        if last_regular is None or not run.hits_frame(sent_frame):
            run.memory[sent_frame.sender] = estimate
            return sent_frame
        repeated = replace(estimate, x_hat=last_regular.x_hat, alpha=last_regular.alpha)
        frame = encode_estimate(repeated, run.frame_format, sent_frame.frame.timestamp)
        return sent_frame.with_false_estimate(frame)


@dataclass(frozen=True, kw_only=True)
class Liar(Fault):
    """A robot's estimate is replaced by a false one.

    Attributes:
        x: Estimate that is claimed.
        alpha: Confidence that is claimed.
    """

    name = "liar"
    summary = "a broadcast carries x and alpha instead of the robot's own"

    x: float = parameter("estimate that is claimed", 0, 1, default=1.0)
    alpha: float = parameter("confidence that is claimed", 0, float32_value(MAX_FLOAT32_BITS), default=1e6)

    def on_send(self, sent_frame: SentFrame, run: FaultRun) -> SentFrame:
        """Return the frame with ``x`` and ``alpha`` in place of the robot's estimate, if the fault hits it.

        Frames that are no estimate are not changed.
        """
        estimate = decode_estimate(sent_frame.frame, run.frame_format)
        if not isinstance(estimate, Estimate) or not run.hits_frame(sent_frame):
            return sent_frame
        # The id in the frame may be another node's, if another fault has changed it before.
        identifier = run.frame_format.identifier(estimate.sender)
        payload = _encode_claim(self.x, self.alpha, estimate.transfer_id)
        return sent_frame.with_false_estimate(make_frame(identifier, payload, sent_frame.frame.timestamp))


@dataclass(frozen=True, kw_only=True)
class Collide(Fault):
    """A node sends a frame under another node's id.

    Attributes:
        id: The other node's id.
    """

    name = "collide"
    summary = "a node sends under another's id"

    id: int | None = parameter("id to send under, must be given", 0, MAX_NODE_ID, default=None)

    def check(self) -> None:
        """Raise UsageError if there is no id."""
        if self.id is None:
            raise UsageError(f"fault {self.name} needs the id to send under, such as id=3")

    def on_send(self, sent_frame: SentFrame, run: FaultRun) -> SentFrame:
        """Return the frame under the node id ``id`` if the fault hits it, otherwise as it is."""
        if self.id is None or not run.hits_frame(sent_frame):
            return sent_frame
        frame = copy.copy(sent_frame.frame)
        identifier_without_sender = frame.arbitration_id & ~NODE_ID_MASK
        frame.arbitration_id = identifier_without_sender | self.id
        return replace(sent_frame, frame=frame)


# --- Extra frames: a node that sends more than its robot does ---


@dataclass(frozen=True, kw_only=True)
class Babble(Fault):
    """A node sends frames of random content under its own identifier, after those of all robots.

    Attributes:
        frames: How many.
    """

    name = "babble"
    summary = "a node sends frames of random content besides its own, each tick"

    frames: int = parameter("frames per tick", 0, 10_000, default=10)

    def extra_frames(self, node: int, tick: int, timestamp: float, run: FaultRun) -> list[can.Message]:
        """Return ``frames`` frames with the node's identifier and 64 random bits of data each.

        Returns none in a tick in which the fault does not hit the node. The frames count as hits of the
        fault.
        """
        if not run.hits_node(node, tick):
            return []
        run.hit_count += self.frames
        identifier = run.frame_format.identifier(node)
        # The subject is that of estimates, but with random tail bytes decoders refuse seven of eight frames.
        contents = [run.content_word(node, tick, index) for index in range(self.frames)]
        return [make_frame(identifier, content, timestamp) for content in contents]


@dataclass(frozen=True, kw_only=True)
class Sybil(Fault):
    """A node sends false estimates under several other ids, before the robots send theirs.

    Attributes:
        x: Estimate that is claimed.
        alpha: Confidence that is claimed.
        ids: The other ids.
    """

    name = "sybil"
    summary = "a node sends estimates under other ids, too, before all others"
    sends_before_others: ClassVar[bool] = True

    x: float = parameter("estimate that is claimed", 0, 1, default=1.0)
    alpha: float = parameter("confidence that is claimed", 0, float32_value(MAX_FLOAT32_BITS), default=1e6)
    ids: frozenset[int] | None = None

    def check(self) -> None:
        """Raise UsageError if there are no ids."""
        if self.ids is None:
            raise UsageError(f"fault {self.name} needs the ids to send under, such as ids=30-39")

    def extra_frames(self, node: int, tick: int, timestamp: float, run: FaultRun) -> list[can.Message]:
        """Return a false estimate, ``x`` with confidence ``alpha``, under each of the fault's ``ids``.

        Their transfer_id is the tick, modulo TRANSFER_ID_MODULUS. Returns none in a tick in which the fault
        does not hit the node. The frames count as hits of the fault.
        """
        if self.ids is None or not run.hits_node(node, tick):
            return []
        run.hit_count += len(self.ids)
        payload = _encode_claim(self.x, self.alpha, tick % TRANSFER_ID_MODULUS)
        # Sorted, as a set has no order that a repeated run could rely on.
        identifiers = [run.frame_format.identifier(robot) for robot in sorted(self.ids)]
        return [make_frame(identifier, payload, timestamp) for identifier in identifiers]


def _encode_claim(x: float, alpha: float, transfer_id: int) -> int:
    """Return the payload of an estimate that claims exactly ``x`` and ``alpha``.

    The codec of estimates does not serve here: it rounds alpha to the numbers that the firmware can have.
    """
    x_hat = round(x * Q23_ONE)  # units of 2**-23
    return ESTIMATE.pack(transfer_id, {"x_hat": x_hat, "alpha": float32_bits(alpha)})


FAULT_KINDS: tuple[type[Fault], ...] = (
    *(Loss, Delay, Duplicate, Corrupt),
    *(Babble, Crash, Freeze, Liar, Collide, Sybil, BusOff),
)
"""All kinds of faults, in the order of the help."""
