"""Robots with which the studies compare the project's own, and robots that lie.

docs/platforms/extending.md says how to write such classes; experiments take them in place of a name.
docs/internals/related_work.md compares the methods from which some of them come.
"""

from __future__ import annotations

import math
import random
from collections.abc import Sequence
from statistics import fmean

import numpy as np

from mcp_asdf import Config, ReferenceRobot, Status
from mcp_asdf.fixed_point import ALPHA_MAX
from mcp_asdf.native import NativeRobot
from mcp_asdf.robot import B_HAT_MARGIN, Filter, Observation, Robot
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.robots.firmwares import RobotMaker
from mcp_asdf_tools.studies.ageing_sensors import DIFFUSION, DRIFT_RATE

ROBOTS_WITH_LIARS = 20
"""Number of robots of the swarms with liars."""

LIAR_COUNT = 5
"""Number of robots that lie in these swarms: the last ones."""

_LABEL_BY_PEER = {
    "DriftingBayesCpfRobot": "BayesCPF",
    "WanderingBayesCpfRobot": "BayesCPF",
    "KnownAccuracyRobot": "knows b now",
    "KnownMeanAccuracyRobot": "knows its mean",
    "WmsrRobot": "W-MSR",
    "wmsr_robots_and_five_liars": "W-MSR",
    "TrimmedMeanRobot": "trimmed mean",
    "trimmed_mean_robots_and_five_liars": "trimmed mean",
    "MajorityRobot": "DMMD",
    "majority_robots_and_five_liars": "DMMD",
    "TwoReadingsRobot": "two readings",
}
"""Heads of the columns of peers, by the firmware's name."""


def column_label(experiment: Experiment) -> str:
    """Return the head of an experiment's column: its filter, or the peer that stands for one."""
    return _LABEL_BY_PEER.get(_firmware_name(experiment), experiment.swarm_filter.term)


def has_liars(experiment: Experiment) -> bool:
    """Return whether the last LIAR_COUNT robots of an experiment lie, as its firmware makes them do."""
    return _firmware_name(experiment).endswith("five_liars")


def _firmware_name(experiment: Experiment) -> str:
    """Return the name of an experiment's firmware without its module."""
    return experiment.firmware.rpartition(".")[2]


# --- Other filters ---------------------------------------------------------------------------------------


class BayesCpfRobot(ReferenceRobot):
    """BayesCPF (Chin and Pinciroli 2025, arXiv 2504.04774); its subclasses say how sensors age.

    An extended Kalman filter over b. It measures how many of the tiles since the last update were black,
    given the mean of the informed estimates since then, in which older ones weigh more. The estimate is cut
    to [1/2, 1] as the mean of a truncated normal distribution. At the start b has the variance 0.04.

    Attributes:
        drift_rate: Change of b in one step that the filter expects.
        diffusion: Standard deviation of the random change of b in one step that the filter expects.
    """

    drift_rate = 0.0
    diffusion = 0.0

    def __init__(self, config: Config, robot_id: int, b_hat: float) -> None:
        """Start with b_hat as the estimate of b, and with nothing measured."""
        super().__init__(config, robot_id, b_hat)
        # Mean and variance of the estimate of b, whose standard deviation is 0.2 at first
        self._mean = b_hat
        self._variance = 0.04
        self._n_since_update = 0
        self._t_since_update = 0
        self._x_since_update: list[float] = []

    def observe(self, z: Observation) -> Status:
        """Count an observation in t and n, and also for the next measurement.

        Returns OK, or ERR_OBSERVATION if ``z`` is neither WHITE nor BLACK.
        """
        self._n_since_update += int(z)
        self._t_since_update += 1
        return super().observe(z)

    def settle(self) -> Status:
        """Keep x for the next measurement, end the round, and run the filter if it is time for that.

        Returns UPDATED if the filter has re-estimated b_hat, otherwise OK.
        """
        self._x_since_update.append(self.x)
        return super().settle()

    def _is_update_needed(self) -> bool:
        """Return whether b_hat is to be estimated anew in a filter step.

        With any filter it is needed if there are readings since the last update, and without one never.
        """
        return self._config.filter != Filter.OFF and self._t_since_update > 0

    def reestimate_b_hat(self) -> float | None:
        """Return b_hat after a step of the Kalman filter; None if there are too few readings to measure by.

        A step moves the estimate of b by the expected drift and then, with enough readings, corrects it by
        the number of black ones. In either case all that was counted since the last step is used up.
        """
        n = self._n_since_update  # black readings
        t = self._t_since_update  # all readings
        x = self._mean_x_since_update()
        self._n_since_update = 0
        self._t_since_update = 0
        self._x_since_update = []
        # The known part of the drift moves b, and the random part makes b less certain.
        self._mean += self.drift_rate * t
        self._variance += self.diffusion**2 * t
        # The filter takes the binomial count for a normally distributed number.
        is_nearly_normal = t * min(self._mean, 1 - self._mean) >= 5
        if not is_nearly_normal:
            return None
        self._correct_by_count(n, t, x)
        # b_hat stays off these ends, since at 1/2 the local estimate would divide by 0.
        lowest, highest = 0.5 + 1e-6, 1 - 1e-6
        return min(max(self._truncated_mean(), lowest), highest)

    def _mean_x_since_update(self) -> float:
        """Return the weighted mean of the informed estimates since the last update of b_hat.

        The oldest of them weighs most, and the newest has the weight 1.
        """
        weights = range(len(self._x_since_update), 0, -1)
        return float(np.average(self._x_since_update, weights=weights))

    def _correct_by_count(self, n: int, t: int, x: float) -> None:
        """Correct mean and variance of the estimate of b: ``n`` of ``t`` readings were black.

        ``x`` is the mean of the informed estimates of that time, and stands for the share of black floor.
        """
        # n is a binomial count: each of the t readings is black with this probability.
        black_probability = x * self._mean + (1 - x) * (1 - self._mean)
        expected_n = t * black_probability
        variance_of_n = t * black_probability * (1 - black_probability)
        slope = t * (2 * x - 1)  # by which expected_n grows with the mean
        # The equations of a Kalman filter for one number
        gain = self._variance * slope / (slope**2 * self._variance + variance_of_n)
        self._mean += gain * (n - expected_n)
        self._variance *= 1 - gain * slope

    def _truncated_mean(self) -> float:
        """Return the mean of the estimate of b, moved into the range from 1/2 to 1 if it is outside.

        It moves to the mean of the estimate's normal distribution when this is cut to the range.
        """
        from scipy.stats import truncnorm  # type: ignore[import-untyped]  # noqa: PLC0415 (loads slowly)

        if 0.5 < self._mean < 1:
            return self._mean
        deviation = math.sqrt(self._variance)
        # The limits 1/2 and 1, in deviations from the mean, as the standard normal distribution takes them.
        low = (0.5 - self._mean) / deviation
        high = (1 - self._mean) / deviation
        return float(truncnorm.mean(low, high, loc=self._mean, scale=deviation))


# --- Resilient consensus ---------------------------------------------------------------------------------


class WmsrRobot(ReferenceRobot):
    """W-MSR, "weighted mean-subsequence-reduced" (LeBlanc, Zhang, Koutsoukos and Sundaram 2013).

    x is a mean of local estimates: the robot's own, and the estimates of a round without the most extreme
    ones, as ``wmsr_mean`` says. A robot with few neighbours removes all their estimates, and x is its own
    estimate. b_hat, the accuracy that the robot assumes of its sensor, never changes.

    In the original rule robots send the mean, and average again. Here messages carry local estimates, which
    robots go on improving, so every round takes one step of the rule.

    Attributes:
        tolerated_liars: F, the number of neighbours in any round that may lie. The rule needs to know it.
    """

    tolerated_liars = 5

    @property
    def x(self) -> float:
        """The mean of the own local estimate and the estimates of the last round that the rule keeps."""
        received = [estimate.x_hat for estimate in self._closed_round]
        return wmsr_mean(self.x_hat, received, self.tolerated_liars)


def wmsr_mean(own_estimate: float, received_estimates: Sequence[float], tolerated_liars: int) -> float:
    """Return the mean of a robot's own estimate and of the received ones that W-MSR keeps.

    Of the estimates above the own one, the ``tolerated_liars`` largest are removed, and of those below it as
    many of the smallest; on a side with fewer estimates all are removed. Estimates that equal the own one are
    kept. Every kept estimate has the same weight.
    """
    ascending = sorted(received_estimates)
    below = [estimate for estimate in ascending if estimate < own_estimate]
    equal = [estimate for estimate in ascending if estimate == own_estimate]
    above = [estimate for estimate in ascending if estimate > own_estimate]
    kept_below = below[tolerated_liars:]
    kept_above = above[: max(0, len(above) - tolerated_liars)]
    return fmean([own_estimate, *kept_below, *equal, *kept_above])


class TrimmedMeanRobot(ReferenceRobot):
    """A robot whose x is the trimmed mean of its own local estimate and of those that it has just received.

    b_hat, the accuracy that the robot assumes of its sensor, never changes.

    Attributes:
        trimmed_share: Share of the estimates that is removed at either end.
    """

    trimmed_share = 0.25

    @property
    def x(self) -> float:
        """The trimmed mean of the own local estimate and the estimates of the last round."""
        received = [estimate.x_hat for estimate in self._closed_round]
        return trimmed_mean([self.x_hat, *received], self.trimmed_share)


def trimmed_mean(estimates: Sequence[float], trimmed_share: float) -> float:
    """Return the mean of estimates without the smallest and the largest ones.

    ``trimmed_share`` of them, rounded down to a whole number, is removed at either end. It is below 1/2, so
    that at least one estimate is left.
    """
    removed_at_each_end = int(trimmed_share * len(estimates))
    kept = sorted(estimates)[removed_at_each_end : len(estimates) - removed_at_each_end]
    return fmean(kept)


# --- A vote on the prevailing colour ---------------------------------------------------------------------


class MajorityRobot(ReferenceRobot):
    """DMMD, direct modulation of majority-based decisions (Valentini, Hamann and Dorigo 2015).

    A robot has an opinion on which colour prevails, and alternates between two tasks. While it explores, it
    counts how many of its readings have the colour of its opinion, and broadcasts no opinion. Then it
    broadcasts its opinion, and the larger that share was, the longer it does so. At the end it adopts the
    opinion of the majority of its neighbours and itself.

    An opinion travels as a local estimate of 1 for black, or of 0 for white. b_hat, the accuracy that the
    robot assumes of its sensor, is not used. Half of the robots begin with either opinion.

    Attributes:
        mean_exploration: Mean duration of an exploration in rounds; durations have an exponential
            distribution.
        mean_dissemination: Mean duration of a dissemination in rounds, for an opinion whose colour all
            readings have.
        listening_time: Number of rounds before the end of a dissemination in which received opinions count.
    """

    mean_exploration = 100.0
    mean_dissemination = 100.0
    listening_time = 30

    def __init__(self, config: Config, robot_id: int, b_hat: float) -> None:
        """Start to explore, with the opinion black if the id is odd, otherwise white.

        The robot's random sequence is seeded by its id.
        """
        super().__init__(config, robot_id, b_hat)
        self._random = random.Random(robot_id)
        has_odd_id = robot_id % 2 == 1
        self._opinion = Observation.BLACK if has_odd_id else Observation.WHITE
        self._opinion_by_sender: dict[int, Observation] = {}
        self._is_disseminating = False
        self._start_exploration()

    def observe(self, z: Observation) -> Status:
        """Count an observation in t and n, and also for the opinion while the robot explores.

        Returns OK, or ERR_OBSERVATION if ``z`` is neither WHITE nor BLACK.
        """
        if not self._is_disseminating:
            self._readings += 1
            if z == self._opinion:
                self._readings_of_opinion += 1
        return super().observe(z)

    def receive(self, sender: int, x_hat: float, alpha: float) -> Status:
        """Receive a neighbour's message, and keep its opinion if this robot is about to decide.

        The robot listens in the last ``listening_time`` rounds in which it broadcasts its own opinion.
        A message without confidence has no opinion. Of several messages of a sender the last one counts.
        Returns OK, or REPEATED if there is one of this sender in the round already. Raises FirmwareError for
        a sender or an x_hat that is impossible.
        """
        status = super().receive(sender, x_hat, alpha)
        is_listening = self._is_disseminating and self._rounds_left <= self.listening_time
        if status is Status.OK and alpha > 0 and is_listening:
            self._opinion_by_sender[sender] = Observation.BLACK if x_hat > 0.5 else Observation.WHITE
        return status

    def settle(self) -> Status:
        """End the round, and change between exploring and broadcasting the opinion if it is time for that.

        After a time of broadcasting the robot first adopts the opinion of the majority. Returns what the
        inherited method does: UPDATED if b_hat, which this robot does not use, was re-estimated, otherwise
        OK.
        """
        status = super().settle()
        self._rounds_left -= 1
        if self._rounds_left <= 0:
            if self._is_disseminating:
                self._adopt_majority_opinion()
                self._start_exploration()
            else:
                self._start_dissemination()
        return status

    def _start_exploration(self) -> None:
        """Begin to count readings, for a random time."""
        self._is_disseminating = False
        self._readings, self._readings_of_opinion = 0, 0
        self._rounds_left = self._draw_duration(self.mean_exploration)

    def _start_dissemination(self) -> None:
        """Begin to broadcast the opinion, for a random time.

        Its mean is proportional to the share of the opinion's colour in the readings of the exploration. All
        opinions that were received before are forgotten.
        """
        self._is_disseminating = True
        self._opinion_by_sender = {}
        share_of_colour = self._readings_of_opinion / max(1, self._readings)  # 0 without readings
        self._rounds_left = self._draw_duration(self.mean_dissemination * share_of_colour)

    def _draw_duration(self, mean: float) -> int:
        """Return a random number of rounds, at least 1, from an exponential distribution of this mean.

        With a mean of 0, which comes if the opinion's colour has not been read at all, it is 1.
        """
        if mean == 0:
            return 1
        duration = self._random.expovariate(1 / mean)
        return max(1, round(duration))

    def _adopt_majority_opinion(self) -> None:
        """Take over the opinion that most have, this robot included; keep the own one if neither leads."""
        opinions = [self._opinion, *self._opinion_by_sender.values()]
        black = opinions.count(Observation.BLACK)
        white = opinions.count(Observation.WHITE)
        if black != white:
            self._opinion = Observation.BLACK if black > white else Observation.WHITE

    @property
    def x_hat(self) -> float:
        """The opinion as a number, which messages carry: 1 for black, 0 for white."""
        return float(self._opinion)

    @property
    def alpha(self) -> float:
        """1 while the robot disseminates its opinion, and otherwise 0, which receivers do not count."""
        return float(self._is_disseminating)

    @property
    def x(self) -> float:
        """The opinion as a number, 1 for black or 0 for white, which is what the robot would answer."""
        return self.x_hat


# --- Robots that know how sensors age --------------------------------------------------------------------


class DriftingBayesCpfRobot(BayesCpfRobot):
    """BayesCPF as it is meant: the filter knows how fast all sensors drift, but not how far they have."""

    drift_rate = DRIFT_RATE


class WanderingBayesCpfRobot(BayesCpfRobot):
    """BayesCPF with sensors that wander: the filter knows how fast, but not in which direction."""

    diffusion = DIFFUSION


class KnownAccuracyRobot(ReferenceRobot):
    """A robot without a filter that knows its accuracy at each moment, as all drift by DRIFT_RATE."""

    def __init__(self, config: Config, robot_id: int, b_hat: float) -> None:
        """Start with b_hat as the true accuracy, which it is where no sensor is flawed."""
        super().__init__(config, robot_id, b_hat)
        self._true_accuracy = b_hat

    def observe(self, z: Observation) -> Status:
        """Set b_hat to the accuracy to assume, count an observation in t and n, and let the sensor age.

        b_hat stays below 1 by B_HAT_MARGIN. Returns OK, or ERR_OBSERVATION if ``z`` is neither WHITE nor
        BLACK.
        """
        self._b_hat = min(self._accuracy_to_assume(), 1 - B_HAT_MARGIN)
        # The sensor ages after this observation, so b_hat, which is set already, holds for it.
        self._true_accuracy += DRIFT_RATE
        return super().observe(z)

    def _accuracy_to_assume(self) -> float:
        """Return b_hat for the next observation."""
        return self._true_accuracy


class KnownMeanAccuracyRobot(KnownAccuracyRobot):
    """A robot that knows the mean accuracy over the observations that it counts: one sum beside t and n."""

    _accuracy_sum = 0.0

    def _accuracy_to_assume(self) -> float:
        """Return the mean accuracy of all observations that t counts, the next one included.

        The sum of these accuracies is kept from call to call, so there must be a call for each observation.
        """
        self._accuracy_sum += self._true_accuracy
        observations = self.t + 1
        mean_accuracy = self._accuracy_sum / observations
        if observations == self._config.memory:
            # The firmware is about to halve t and n: so the sum stays that of t observations.
            self._accuracy_sum /= 2
        return mean_accuracy


# --- Liars -----------------------------------------------------------------------------------------------


class Liar(NativeRobot):
    """A robot that broadcasts "no tile is black" with the largest confidence."""

    @property
    def x_hat_raw(self) -> int:
        """The lie: no tile is black."""
        return 0

    @property
    def alpha_raw(self) -> int:
        """The largest confidence that a robot can broadcast."""
        return ALPHA_MAX


def five_liars(config: Config, robot_id: int, b_hat: float) -> Robot:
    """Make a robot of a swarm with the project's firmware, whose last five robots lie."""
    return _make_robot(config, robot_id, b_hat, NativeRobot)


def wmsr_robots_and_five_liars(config: Config, robot_id: int, b_hat: float) -> Robot:
    """Make a robot of a swarm that uses W-MSR, and whose last five robots lie."""
    return _make_robot(config, robot_id, b_hat, WmsrRobot)


def trimmed_mean_robots_and_five_liars(config: Config, robot_id: int, b_hat: float) -> Robot:
    """Make a robot of a swarm that uses trimmed means, and whose last five robots lie."""
    return _make_robot(config, robot_id, b_hat, TrimmedMeanRobot)


def majority_robots_and_five_liars(config: Config, robot_id: int, b_hat: float) -> Robot:
    """Make a robot of a swarm that votes by DMMD, and whose last five robots lie."""
    return _make_robot(config, robot_id, b_hat, MajorityRobot)


def _make_robot(config: Config, robot_id: int, b_hat: float, honest_robot: RobotMaker) -> Robot:
    """Make a liar if the id is one of the last ones of the swarm, or else an honest robot."""
    first_liar = ROBOTS_WITH_LIARS - LIAR_COUNT
    make_robot = Liar if robot_id >= first_liar else honest_robot
    return make_robot(config, robot_id, b_hat)
