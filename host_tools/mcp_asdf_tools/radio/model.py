"""Model of the controller: the firmware's mirror as a node, which counts what a run puts to the test.

The one place that says which firmware a controller must equal, bit for bit.
"""

from __future__ import annotations

from mcp_asdf.fixed_point import B_HAT_MAX, B_HAT_MIN
from mcp_asdf.mirror import MirrorRobot, reestimate, rejects
from mcp_asdf.robot import Config, Observation, Status
from mcp_asdf_tools.radio.coverage import Coverage, Update, filters, is_adaptive
from mcp_asdf_tools.radio.neighbourhood import RadioSettings
from mcp_asdf_tools.robots import NodeSettings, Recorder, RobotNode, TickedRobot

_NO_INFORMATION = 1 << 20
"""|2 b_hat - 1| below which a robot knows nothing, in units of 2**-32."""


class Model(RobotNode):
    """Node that does what the controller must do.

    Attributes:
        firmware: Its firmware, whose state phases look at.
        coverage: What it was taken through.
    """

    def __init__(self, settings: RadioSettings, recorder: Recorder | None = None) -> None:
        """Start like the controller of the settings, with its configuration."""
        own = settings.controller
        self.coverage = Coverage(own.id, own.config)
        self.firmware = WatchedMirror(own.config.in_rounds(), own.id, own.b_hat, self.coverage)
        super().__init__(
            TickedRobot(self.firmware, own.config.comms_period),
            NodeSettings(own.id, settings.subjects, settings.swarm.steps_per_second),
            recorder,
        )


class WatchedMirror(MirrorRobot):
    """The firmware's mirror, which notes what it is taken through."""

    def __init__(self, config: Config, robot_id: int, b_hat: float, coverage: Coverage) -> None:
        """Make the robot as ``MirrorRobot`` does; it counts into ``coverage``."""
        super().__init__(config, robot_id, b_hat)
        self._coverage = coverage

    def observe(self, z: Observation) -> Status:
        """Count an observation and form x_hat and alpha."""
        n, t = self.s.n + z, self.s.t
        status = super().observe(z)
        self._coverage.observations += 1
        if self.s.t < t:
            self._coverage.halvings[n % 4] += 1
        return status

    def settle(self) -> Status:
        """Close the round, and filter every ``filter_period`` rounds."""
        s, run = self.s, self._coverage
        run.most_messages = max(run.most_messages, sum(word.bit_count() for word in s.heard))
        run.quiet_rounds += s.filter_left > 1 and self.would_reject()
        return super().settle()

    def _receive(self, sender: int, x_hat: int, alpha: int) -> Status:
        status = super()._receive(sender, x_hat, alpha)
        if status == Status.OK:
            self._coverage.senders.add(sender)
        return status

    def _filter(self) -> bool:
        s, run, tests = self.s, self._coverage, self.s.tests
        has_rejected = self.would_reject()
        if has_rejected:
            run.updates[update_of(reestimate(s.t, s.n, s.closed))] += 1
        is_updated = super()._filter()
        if s.tests != tests:
            run.tests[s.open.count] += 1
            run.rejections[s.open.count] += has_rejected
        return is_updated

    def would_reject(self) -> bool:
        """True if a test now would lead to a re-estimate of b_hat, unless x_bar is 1/2."""
        s, config = self.s, self._coverage.config
        if not is_adaptive(config):
            return bool(filters(config) and s.t and s.open.count)
        assert config.table is not None
        return s.t > 0 and s.open.count > 1 and rejects(config.table, s.open, s.x_hat)


def update_of(b_hat: int | None) -> Update:
    """The kind of update to ``b_hat``, in units of 2**-32; None is no update."""
    if b_hat is None:
        return Update.KEPT
    if b_hat in (B_HAT_MIN, B_HAT_MAX):
        return Update.MINIMUM if b_hat == B_HAT_MIN else Update.MAXIMUM
    if abs(2 * b_hat - (1 << 32)) < _NO_INFORMATION:
        return Update.HALF
    return Update.ABOVE if 2 * b_hat > 1 << 32 else Update.BELOW
