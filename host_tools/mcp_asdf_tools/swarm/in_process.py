"""Frames handed over inside the process, for swarms that no other program can hear.

Every frame is made and logged as on a bus, and decoded once for all robots. Where nothing can come late or go
wrong, each robot is given the exact sums of the estimates that it hears in place of the estimates one by one;
the firmware's state after the round is the same to the bit.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy

import numpy as np

from mcp_asdf.fixed_point import sums_add
from mcp_asdf.robot import FixedPointRobot, Sums
from mcp_asdf_tools.bus import Message
from mcp_asdf_tools.robots import BusRobot, Decoder, FrameTaker
from mcp_asdf_tools.swarm.air import Air
from mcp_asdf_tools.swarm.transmission import SentFrame
from mcp_asdf_tools.world import World


class InProcess:
    """A medium without a bus. O(robots) a frame, with a small constant where rounds are summed."""

    missed = 0

    def __init__(
        self, robots: Sequence[BusRobot], air: Air, world: World, decoder: Decoder, log: FrameTaker | None
    ) -> None:
        """Carry frames between all robots of a swarm; ``log`` takes a copy of each."""
        self._robots = robots
        self._air = air
        self._world = world
        self._decode = decoder
        self._log = log
        self._sent: list[SentFrame] = []
        self._can_sum = air.is_plain and all(isinstance(each.robot, FixedPointRobot) for each in robots)

    def send(self, sent: SentFrame) -> None:
        """Take a frame, and log it as a bus would hand it over."""
        if self._log is not None:
            self._log(copy(sent.frame))
        self._sent.append(sent)

    def carry(self, tick: int) -> None:
        """Let every robot hear what it hears in this tick."""
        sent, self._sent = self._sent, []
        if self._can_sum:
            self._carry_sums(sent)
        else:
            self._air.hand_over(self._robots, tick, sent)

    def _carry_sums(self, sent: Sequence[SentFrame]) -> None:
        """Hand over other frames one by one, then the estimates of a round at once."""
        messages: dict[int, Message] = {}
        for each in sent:
            decoded = self._decode(each.frame)
            if isinstance(decoded, Message):
                messages[each.sender] = decoded
            else:
                self._hand_over(each)
        if messages:
            self._end_round(messages)

    def _hand_over(self, sent: SentFrame) -> None:
        for receiver in np.flatnonzero(self._world.hears[:, sent.sender]).tolist():
            self._air.count(1)
            self._robots[receiver].hear(sent.frame)

    def _end_round(self, messages: dict[int, Message]) -> None:
        """All robots send their estimates in the same tick, in which they also close their rounds."""
        terms = np.array([_terms(messages[robot.id]) for robot in self._robots], np.uint64)
        rows = (self._world.hears.astype(np.uint64) @ terms).tolist()
        for robot, row in zip(self._robots, rows, strict=True):
            heard = self._world.neighbours(robot.id)
            self._air.count(len(heard))
            robot.receive_round(Sums(*row), [messages[sender] for sender in heard])

    def __enter__(self) -> InProcess:
        return self

    def __exit__(self, *_: object) -> None:
        """Do nothing: there is no bus to leave."""


def _terms(message: Message) -> list[int]:
    """Terms of a message in ``Sums``; sums of 127 of each are below 2^62, so that 64 bits hold them."""
    sums = Sums()
    sums_add(sums, message.x_hat, message.alpha)
    return list(vars(sums).values())
