"""What the robust filter is compared with, and worlds that make it hard, as extensions.

``PYTHONPATH=tests/peers mcp-asdf sweep tests/peers/peers.toml`` finds them; docs/extending.md says how.
"""

from __future__ import annotations

import math
import random
from functools import partial
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
from scipy.special import betainc, betaln  # type: ignore[import-untyped]

from mcp_asdf import Config, ReferenceRobot, Status
from mcp_asdf.fixed_point import ALPHA_MAX
from mcp_asdf.mirror import MirrorRobot, crowd_fill_ratio, reestimate, robust_test_rejects
from mcp_asdf.native import NativeRobot
from mcp_asdf.robot import B_HAT_MARGIN, Filter, Observation
from mcp_asdf_tools.world.sensors import Accuracies, DriftingSensors
from mcp_asdf_tools.world.settings import WorldSettings

ROBOTS = 20
"""Robots of the swarms with liars."""


class RememberingRobot(ReferenceRobot):
    """The paper's filter, or none, with a memory: x_bar and x are means of all that was heard, weighted by
    alpha per observation, with the gains of the robust filter."""

    _votes, _weight, _sum = 0, 0.0, 0.0

    def receive(self, sender: int, x_hat: float, alpha: float) -> Status:
        status = super().receive(sender, x_hat, alpha)
        if status is Status.OK and alpha > 0:
            self._votes += 1
            gain = 2.0 ** -min(max(self._votes.bit_length() - 3, 3), 12)
            weight = alpha / max(self.t, 1)
            self._weight += gain * (weight - self._weight)
            self._sum += gain * (weight * x_hat - self._sum)
        return status

    @property
    def x_bar(self) -> float:
        return self._sum / self._weight if self._weight else 0.5

    @property
    def x(self) -> float:
        return self._sum / self._weight if self._weight else self.x_hat


class BayesCpfRobot(ReferenceRobot):
    """BayesCPF (Chin and Pinciroli 2025, arXiv 2504.04774) where sensors do not age, in all robots.

    An extended Kalman filter over b: measured is how many of the tiles since the last update were black,
    given x', the mean of the informed estimates since then in which older ones weigh more. The estimate
    is cut to [1/2, 1] as the mean of a truncated normal distribution. At the start b has the variance 0.04.
    """

    def __init__(self, config: Config, robot_id: int, b_hat: float) -> None:
        super().__init__(config, robot_id, b_hat)
        self._mean, self._variance = b_hat, 0.04
        self._late_n, self._late_t = 0, 0
        self._informed: list[float] = []

    def observe(self, z: Observation) -> Status:
        self._late_n, self._late_t = self._late_n + int(z), self._late_t + 1
        return super().observe(z)

    def settle(self) -> Status:
        self._informed.append(self.x)
        return super().settle()

    def _is_activated(self) -> bool:
        return self._config.filter != Filter.OFF and self._late_t > 0

    def reestimate_b_hat(self) -> float | None:
        n, t = self._late_n, self._late_t
        self._predict(t)
        x = float(np.average(self._informed, weights=range(len(self._informed), 0, -1)))
        self._late_n, self._late_t, self._informed = 0, 0, []
        if t * min(self._mean, 1 - self._mean) < 5:  # no normal approximation
            return None
        slope = t * (2 * x - 1)
        expected = t * (x * (2 * self._mean - 1) + 1 - self._mean)
        noise = t * ((2 * self._mean - 1) ** 2 * (x - x**2 - 0.25) + 0.25)
        gain = self._variance * slope / (slope**2 * self._variance + noise)
        self._mean += gain * (n - expected)
        self._variance *= 1 - gain * slope
        return min(max(self._truncated_mean(), 0.5 + 1e-6), 1 - 1e-6)

    def _predict(self, steps: int) -> None:
        """What is known of b after so many steps without a measurement."""

    def _truncated_mean(self) -> float:
        if 0.5 < self._mean < 1:
            return self._mean
        deviation = math.sqrt(self._variance)
        low, high = ((bound - self._mean) / deviation for bound in (0.5, 1.0))
        mass = math.erf(high / math.sqrt(2)) - math.erf(low / math.sqrt(2))
        if mass < 1e-12:
            return self._mean
        return self._mean + deviation * math.sqrt(2 / math.pi) / mass * (
            math.exp(-(low**2) / 2) - math.exp(-(high**2) / 2)
        )


class KnownSensors(DriftingSensors):
    """The built-in sensors of the last trial, whose accuracies robots may ask for."""

    last: ClassVar[KnownSensors]

    def __init__(self, settings: WorldSettings, trial: int) -> None:
        super().__init__(settings, trial)
        self.settings, self._paths = settings, list[list[float]]()
        KnownSensors.last = self

    def advance(self, steps: int) -> Accuracies:
        black, white = super().advance(steps)
        self._paths += np.broadcast_to(black, (steps, black.shape[1])).tolist()
        return black, white

    def b(self, step: int, robot: int) -> float:
        path: list[float] = self._paths[step]
        return path[robot % len(path)]


class AgeingBayesCpfRobot(BayesCpfRobot):
    """BayesCPF as it is meant: the filter knows how sensors drift, but not how far they have."""

    def _predict(self, steps: int) -> None:
        settings = KnownSensors.last.settings
        self._mean += settings.drift_rate * steps
        self._variance += settings.drift_diffusion**2 * steps


class OracleRobot(ReferenceRobot):
    """It knows its sensor's accuracy at each moment, without a filter."""

    _step = 0

    def observe(self, z: Observation) -> Status:
        self._b_hat = self._known(KnownSensors.last.b(self._step, self.id))
        self._step += 1
        return super().observe(z)

    def _known(self, b: float) -> float:
        return min(b, 1 - B_HAT_MARGIN)


class MeanAccuracyRobot(OracleRobot):
    """It knows the mean accuracy over the observations that it counts: one sum more."""

    _sum = 0.0

    def _known(self, b: float) -> float:
        self._sum += b
        mean = self._sum / (self.t + 1)
        if self.t + 1 == self._config.memory:
            self._sum /= 2
        return min(float(mean), 1 - B_HAT_MARGIN)


class OmniscientRobot(ReferenceRobot):
    """A bound, not a peer: every tau the posterior mean of f from the counts of all robots at once.

    A robot's b_hat is right with probability 0.9, otherwise any accuracy in [1/2, 1] is as likely.
    """

    _swarm: list[OmniscientRobot]
    _latest: list[OmniscientRobot] = []  # noqa: RUF012 (robots are made one swarm after the other, from id 0)
    _f = np.linspace(0.0005, 0.9995, 1000)

    def __init__(self, config: Config, robot_id: int, b_hat: float) -> None:
        super().__init__(config, robot_id, b_hat)
        if robot_id == 0:
            OmniscientRobot._latest = []
        self._swarm, self._known = OmniscientRobot._latest, 0.5
        self._swarm.append(self)

    def settle(self) -> Status:
        status = super().settle()
        if self.id == len(self._swarm) - 1 and self._filter_left == self._config.filter_period:
            likelihood = np.sum([robot._log_likelihood() for robot in self._swarm], axis=0)
            known = float(np.average(self._f, weights=np.exp(likelihood - likelihood.max())))
            for robot in self._swarm:
                robot._known = known
        return status

    def _log_likelihood(self) -> NDArray[np.float64]:
        n, white = self.n, self.t - self.n
        p = self._f * self.b_hat + (1 - self._f) * (1 - self.b_hat)
        right = n * np.log(p) + white * np.log1p(-p)
        between = betainc(n + 1, white + 1, self._f) - betainc(n + 1, white + 1, 0.5)
        wrong = betaln(n + 1, white + 1) + np.log(np.maximum(between / (self._f - 0.5), 1e-300))
        both: NDArray[np.float64] = np.logaddexp(np.log(0.9) + right, np.log(0.1) + wrong)
        return both

    x = property(lambda self: self._known)


class FirstDraftRobot(MirrorRobot):
    """The robust filter as it was first: a rejection is for life, and no trend is watched."""

    _flag = False

    def _run_robust_filter(self) -> int | None:
        state, crowd = self.s, self.s.crowd
        if crowd.voices.bit_count() < 3:
            return None
        crowd.first = state.accuracy.b_hat
        self._flag = self._flag or robust_test_rejects(crowd, state.t, state.n)
        return reestimate(state.t, state.n, crowd_fill_ratio(crowd)) if self._flag else None


class LossyRobot(NativeRobot):
    """The firmware behind a radio that loses three messages in ten."""

    def __init__(self, config: Config, robot_id: int, b_hat: float) -> None:
        super().__init__(config, robot_id, b_hat)
        self._random = random.Random(robot_id)

    def _receive(self, sender: int, x_hat: int, alpha: int) -> Status:
        return Status.OK if self._random.random() < 0.3 else super()._receive(sender, x_hat, alpha)


class Liar(NativeRobot):
    """Says "no tile is black" with the largest confidence."""

    x_hat_raw = property(lambda self: 0)
    alpha_raw = property(lambda self: ALPHA_MAX)


def _with_liars(count: int, config: Config, robot_id: int, b_hat: float) -> NativeRobot:
    """The last robots are liars; one with several ids is as bad where all hear all."""
    return (Liar if robot_id >= ROBOTS - count else NativeRobot)(config, robot_id, b_hat)


one_liar, two_liars, five_liars = (partial(_with_liars, count) for count in (1, 2, 5))


class ChangingFloor:
    """A floor of which AFTER is black from the middle of the trial on.

    Sensors cannot change the floor, but they can make its colours as frequent: white tiles are called black
    as often as it takes.
    """

    AFTER = 0.95

    def __init__(self, settings: WorldSettings, trial: int) -> None:
        self._settings, self._step = settings, 0

    def advance(self, steps: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        f, b = self._settings.fill_ratio, self._settings.true_accuracy
        black_seen = self.AFTER * b + (1 - self.AFTER) * (1 - b)
        step = np.arange(self._step, self._step + steps)[:, np.newaxis]
        self._step += steps
        changed = np.where(step < self._settings.steps // 2, b, 1 - (black_seen - f * b) / (1 - f))
        return np.full((1, 1), b), changed
