"""Robots whose calls are counted, each with the state that makes a call the most expensive one."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from typing import Any, ClassVar

from mcp_asdf.fixed_point import ALPHA_MAX, HALF, ONE
from mcp_asdf.mirror import Closed, MirrorRobot
from mcp_asdf.robot import DEFAULT_MEMORY, Config, Filter
from mcp_asdf.robust_filter import VOTES_MAX
from mcp_asdf.table import MAX_Q, Table
from mcp_asdf_tools.crosscheck.crafted_rounds import ALPHA_ONE
from mcp_asdf_tools.tables.thresholds import generate, parse_omega

OWN_ID = 127
"""Id of these robots."""


@dataclass(frozen=True)
class Workload:
    """A robot whose calls are counted: before an observation, and in the last round before the filter runs.

    Attributes:
        t: Number of observations, with the next one.
        n: Number of black ones among them.
        b_hat: Assumed accuracy in units of 2**-32.
        m: Number of messages in the open round, and in the last closed one.
        alpha: Alpha word of the robot's confidence; the words of the messages differ from it in some bits.
        q: Number of entries of the table.
        halves: Whether the memory halves t and n at the next observation.
        agrees: Whether the filter's test does not reject: x_hat equals the messages'.
    """

    filter: ClassVar[Filter] = Filter.ADAPTIVE
    situations: ClassVar[tuple[dict[str, Any], ...]] = ({}, {"agrees": True}, {"alpha": ALPHA_MAX})
    """Attributes of the workloads, beside m, that lead to all branches of a call."""

    t: int = 1000
    n: int = 400
    b_hat: int = 3 << 30  # 0.75
    m: int = 20
    alpha: int = ALPHA_ONE
    q: int = MAX_Q
    halves: bool = False
    agrees: bool = False

    def make_robot(self, firmware: type[MirrorRobot]) -> MirrorRobot:
        """Make a robot of this firmware in the state that the attributes describe, before an observation.

        Its last closed round has the sums of the open one, which has a message of each of m senders. Its
        x_hat is the mean of the messages if it agrees with them, and 1.0 if it does not or has none.
        """
        robot = firmware(self._config(), OWN_ID, self.b_hat / 2**32)
        state = robot.s
        state.t = self.t - 1  # before the observation that is to come
        state.n = min(self.n, self.t - 1)
        state.alpha = self.alpha
        self._receive_messages(robot)
        sums = state.open
        state.closed = Closed(sums.alpha, sums.alpha_x_low, sums.alpha_x_high)
        state.x_hat = ONE
        if self.agrees and sums.count > 0:
            state.x_hat = sums.x // sums.count  # the mean of the messages
        return robot

    def _config(self) -> Config:
        """Return the settings of the robot, whose filter runs in every round.

        If the next observation is to halve t and n, the memory is t, which that observation fills. Otherwise
        it is the default one.
        """
        memory = self.t if self.halves else DEFAULT_MEMORY
        return Config(table_of_size(self.q), self.filter, filter_period=1, memory=memory)

    def _receive_messages(self, robot: MirrorRobot) -> None:
        """Let the robot receive the m messages of its open round, from senders 0 to m - 1; no two are alike.

        The robot adds them to the sums of the round.
        """
        for sender in range(self.m):
            # Alphas differ in the lowest bits of their mantissa, which begins at bit 8.
            alpha = self.alpha ^ (sender << 8)
            x_hat = self._smallest_x_hat + 1000 * sender
            robot.receive_raw(sender, x_hat, alpha)

    @property
    def _smallest_x_hat(self) -> int:
        """The smallest x_hat of the messages, in units of 2**-23; the others are little larger."""
        return ONE // 3


class RobustWorkload(Workload):
    """A robot with the robust filter, which has taken votes if there are messages.

    If it ``agrees``, its messages do not contradict half of the observations being black, and otherwise they
    do.
    """

    filter = Filter.ROBUST
    situations = ({"n": 500}, {"n": 500, "agrees": True})  # half of 1000 observations

    def make_robot(self, firmware: type[MirrorRobot]) -> MirrorRobot:
        """Make a robot as `Workload.make_robot` does, and with the most votes if it has messages."""
        robot = super().make_robot(firmware)
        if self.m > 0:
            robot.s.robust.votes = VOTES_MAX
        return robot

    @property
    def _smallest_x_hat(self) -> int:
        """1/2, which agrees with half of the observations being black, or 0, which does not."""
        return HALF if self.agrees else 0


@cache
def table_of_size(q: int) -> Table:
    """Return a table with q entries, to count what their number changes.

    It is the beginning of a larger table, so its last entry is not the last entry of a right table.
    """
    largest_table = generate(parse_omega("0.05"), MAX_Q)
    return replace(largest_table, entries=largest_table.entries[:q])
