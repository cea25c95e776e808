"""The paper's equations, one function each, and a robot that computes them in float64.

Nothing is quantised here and alpha has no upper limit, so this is the measure for the fixed-point firmwares.
Names and cases are the paper's, with w_hat = b_hat: the accuracy that a robot assumes of its sensor. x_hat is
the robot's local estimate of the share of black tiles after n black among t observations, and alpha its
confidence; ``mcp_asdf.robot`` defines the other words. Equation numbers count its numbered rows in order, so
the hypothesis test is eq. 12. The robust filter, which is not the paper's, is ``mcp_asdf.robust_reference``.

The equations but eq. 10 and 12 take floats or fractions: from `fractions.Fraction` they give exact results.
Sums of floats are correctly rounded, so that no result depends on the order of the messages.

Where an equation divides by zero, `Conventions` says what it gives. Arguments outside the ranges that a
function names, NaN among them, raise ValueError.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Sequence
from dataclasses import dataclass, fields
from fractions import Fraction
from functools import cache
from statistics import mean, stdev
from typing import Any, Generic, NamedTuple, cast

from mcp_asdf.robot import (
    B_HAT_MARGIN,
    MAX_ID,
    Config,
    Counters,
    Filter,
    FirmwareError,
    Observation,
    Status,
    check_alpha,
    check_id_and_b_hat,
    check_settings,
    check_table,
    create_rejection,
    describe_robot,
)
from mcp_asdf.robust_reference import TESTED_ESTIMATES_MIN, Number, RobustReference

INFORMATIVE_G = 2.0**-12
"""Smallest |2 p - 1| of an accuracy, or a social estimate, p that carries information."""

MAX_OMEGA = 0.9
"""Largest omega, which is the type II error probability of the hypothesis test."""

COUNTER_MODULUS = 2**16
"""Counters of events have 16 bits in the firmware."""


@dataclass(frozen=True)
class Conventions:
    """Choices in which the firmware and the authors' programs differ.

    Attributes:
        lost_degrees: The t-score has m - ``lost_degrees`` degrees of freedom.
        strict: The test rejects if the deviation is above the interval (eq. 12), and not if it equals it.
        guarded: If b_hat carries no information (`INFORMATIVE_G`), x_hat is 1/2 and alpha is 0, and from
            such an x_bar no update follows. If not ``guarded``, a division by zero gives infinity as IEEE 754
            says, which the cases of eq. 3 and 8 then clamp. Only 0/0, where the authors' programs have NaN,
            is 1/2: the value of both equations at n/t = 1/2 for every other b_hat or x_bar.
        clamp_at: A b_hat of eq. 8 at most ``clamp_at``, or at least 1 - ``clamp_at``, is replaced ...
        clamp_to: ... by ``clamp_to`` or 1 - ``clamp_to``.
        zero_confidence: Value that replaces alpha = 0 once there is an observation.
    """

    lost_degrees: int = 1
    strict: bool = True
    guarded: bool = True
    clamp_at: float = B_HAT_MARGIN
    clamp_to: float = B_HAT_MARGIN
    zero_confidence: float = 0.0


PAPER = Conventions()
"""The paper's equations, with the firmware's meanings where these leave something open."""

AUTHORS = Conventions(
    lost_degrees=0, strict=False, guarded=False, clamp_at=0.0, clamp_to=1e-6, zero_confidence=1e-6
)
"""The authors' programs (github.com/NESTLab/sensor-degradation-filter)."""


class Estimate(NamedTuple, Generic[Number]):
    """What a robot broadcasts: its local estimate of the share of black tiles, in [0, 1], and its confidence.

    The confidence alpha, which is finite and >= 0, is the estimate's Fisher information.
    """

    x_hat: Number
    alpha: Number


# ---- The local estimate ----


def local_estimate(n: int, t: int, b: Number, conventions: Conventions = PAPER) -> Number:
    """Return the estimated share of black tiles, x_hat in [0, 1], after ``n`` black among ``t`` observations.

    ``b`` in [0, 1] is the assumed accuracy of the sensor. The result is (eq. 3)

        x_hat = (n / t + b - 1) / (2 b - 1)     clamped to [0, 1]

    It is 1/2 before the first observation, and for a ``b`` so near 1/2 that the sensor carries no
    information. If the conventions do not guard against such a ``b`` (``Conventions.guarded``), it is 1/2
    only where the fraction is 0/0, and 0 or 1 where only its denominator is 0. Raises ValueError for counts
    or a ``b`` out of range. O(1).
    """
    _check_counts(n, t)
    _check_is_in_unit_interval(b, "b")
    to_number = _number_type(b)
    if t == 0 or _carries_no_information(b, conventions):
        return to_number(0.5)
    observed_share = to_number(n) / t
    return _quotient_in_unit_interval(numerator=observed_share + b - 1, denominator=2 * b - 1)


def local_confidence(n: int, t: int, b: Number, conventions: Conventions = PAPER) -> Number:
    """Return the confidence alpha >= 0 of what `local_estimate` returns for the same arguments (eq. 4). O(1).

    With d = (2 b - 1)**2 it is

        alpha = d (n / (1 - b)**2 + (t - n) / b**2)     if x_hat is 0
                d ((t - n) / (1 - b)**2 + n / b**2)     if x_hat is 1
                d t**3 / (n (t - n))                    otherwise

    It is 0 before the first observation, and ``conventions.zero_confidence`` for a ``b`` so near 1/2 that the
    sensor carries no information. Raises ZeroDivisionError where alpha is infinite: for a perfect sensor,
    ``b`` 0 or 1, after observations of one colour only.
    """
    to_number = _number_type(b)
    x_hat = local_estimate(n, t, b, conventions)
    if t == 0:
        return to_number(0)
    if _carries_no_information(b, conventions):
        return to_number(conventions.zero_confidence)
    d = (2 * b - 1) ** 2  # the paper's name
    # The paper prints the first case as d (t b**2 - (2 b - 1) (t - n)) / (b**2 (b - 1)**2), which is equal.
    # Here it is a sum, so that nothing is subtracted that could cancel. The second case is the first one with
    # the colours exchanged.
    if x_hat == 0:
        alpha = d * (n / (1 - b) ** 2 + (t - n) / b**2)
    elif x_hat == 1:
        alpha = d * ((t - n) / (1 - b) ** 2 + n / b**2)
    else:
        alpha = d * t**3 / (n * (t - n))
    # Conventions that do not guard against a ``b`` of 1/2 get here with one, and d and alpha are 0 then.
    if alpha == 0:
        return to_number(conventions.zero_confidence)
    return alpha


# ---- The social and the informed estimate ----


def social_estimate(estimates: Sequence[Estimate[Number]]) -> Number:
    """Return x_bar in [0, 1]: the mean of the neighbours' x_hat, weighted by their alpha (eq. 5). O(m).

    It is sum alpha_j x_hat_j / sum alpha_j over the estimates j, and 1/2 where this is undefined, because no
    estimate has alpha > 0. Raises ValueError for an estimate that is out of range.
    """
    return _weighted_mean(estimates, default=0.5)


def social_confidence(estimates: Sequence[Estimate[Number]]) -> Number:
    """Return beta >= 0: the sum of the alpha of the neighbours' estimates (eq. 6). O(m).

    It is 0 if there are none. Raises ValueError for an estimate that is out of range.
    """
    _check_estimates(estimates)
    return _sum([alpha for _, alpha in estimates])


def informed_estimate(own_estimate: Estimate[Number], estimates: Sequence[Estimate[Number]]) -> Number:
    """Return x in [0, 1]: the mean of the x_hat of a robot and of its neighbours, weighted by their alpha.

    This is eq. 7 in its second form, with sums over the neighbours' estimates j:

        x = (alpha x_hat + sum alpha_j x_hat_j) / (alpha + sum alpha_j)

    The result is the robot's x_hat if all confidences are 0. Raises ValueError for an estimate that is out of
    range. O(m).
    """
    all_estimates = [own_estimate]
    # The own estimate is a term like the others, so robots that all receive from each other get the same
    # bits.
    all_estimates += estimates
    return _weighted_mean(all_estimates, default=own_estimate.x_hat)


# ---- The sensor degradation filter ----


def assumed_accuracy_update(n: int, t: int, x_bar: Number, conventions: Conventions = PAPER) -> Number | None:
    """Return the accuracy b_hat with which a robot would have estimated ``x_bar``, as its neighbours did.

    ``x_bar`` is in [0, 1], and ``n`` of ``t`` observations were black. The result is (eq. 8)

        b_hat = (n / t + x_bar - 1) / (2 x_bar - 1)     clamped to [0, 1]

    but ``conventions.clamp_to`` where it would be at most ``conventions.clamp_at``, and 1 - ``clamp_to``
    where it would be at least 1 - ``clamp_at``: at 0 or 1 the next alpha could be infinite. Returns None, so
    that b_hat stays, before the first observation and if ``x_bar`` is so near 1/2 that it carries no
    information. Raises ValueError for counts or an ``x_bar`` out of range. O(1).
    """
    _check_counts(n, t)
    _check_is_in_unit_interval(x_bar, "x_bar")
    if t == 0 or _carries_no_information(x_bar, conventions):
        return None
    to_number = _number_type(x_bar)
    observed_share = to_number(n) / t
    b_hat = _quotient_in_unit_interval(numerator=observed_share + x_bar - 1, denominator=2 * x_bar - 1)
    if b_hat <= conventions.clamp_at:
        return to_number(conventions.clamp_to)
    if b_hat >= 1 - conventions.clamp_at:
        return 1 - to_number(conventions.clamp_to)
    return b_hat


@cache
def t_score(m: int, omega: float, conventions: Conventions = PAPER) -> float:
    """Return t_{m-1,(1-omega)/2}, which a T variable exceeds with probability (1 - omega)/2 (eq. 10).

    ``m`` >= 2 is the number of messages, and ``omega``, between 0 and 1, the type II error probability of the
    test. T has m - 1 degrees of freedom in the paper, and m - ``conventions.lost_degrees`` here. Raises
    ValueError outside these ranges. O(1) after the first call with the same arguments.
    """
    from scipy.special import stdtrit  # type: ignore[import-untyped] # noqa: PLC0415 (loads slowly)

    if not (m >= 2 and 0 < omega < 1):
        raise ValueError(f"m is {m} and omega {omega}; there is a t-score for m >= 2 and 0 < omega < 1")
    # Below the t-score lies what is not above it: 1 - (1 - omega) / 2.
    probability_below = (1 + omega) / 2
    return float(stdtrit(m - conventions.lost_degrees, probability_below))


def asdf_test_rejects(
    x_hat: float, neighbours: Sequence[float], omega: float, conventions: Conventions = PAPER
) -> bool:
    """Return whether ``x_hat`` differs too much from the local estimates of m neighbours (eq. 12). O(m).

    With X and S, the mean and the standard deviation of the neighbours' estimates, it does if

        |X - x_hat| > (t_{m-1,(1-omega)/2} / sqrt(m) + 1) S

    or, with conventions that are not ``strict``, if both sides are equal. It never does for m < 2, where the
    sample has no variance. ``omega``, between 0 and 1, is the type II error probability of the test, and
    ``t_{...}`` what `t_score` returns. Raises ValueError if an estimate is infinite or NaN.
    """
    if not all(map(math.isfinite, (x_hat, *neighbours))):
        raise ValueError(f"x_hat is {x_hat}, its neighbours' {list(neighbours)}; all must be finite")
    m = len(neighbours)
    if m < 2:
        return False
    # mean and stdev of `statistics` are exact before they are rounded: the stdev of equal estimates is 0.
    deviation = abs(mean(neighbours) - x_hat)
    limit = (t_score(m, omega, conventions) / math.sqrt(m) + 1) * stdev(neighbours)
    if conventions.strict:
        return deviation > limit
    return deviation >= limit


# ---- Arguments and numbers ----


def _check_counts(n: int, t: int) -> None:
    """Raise ValueError unless ``n`` may be the number of black among ``t`` observations."""
    if not 0 <= n <= t:
        raise ValueError(f"n is {n} and t {t}; counts are 0 <= n <= t")


def _check_is_in_unit_interval(value: float | Fraction, name: str) -> None:
    """Raise ValueError, with the argument's name, unless ``value`` is in [0, 1]."""
    if not 0 <= value <= 1:
        raise ValueError(f"{name} is {value}; it lies in [0, 1]")


def _check_estimates(estimates: Sequence[Estimate[Any]]) -> None:
    """Raise ValueError unless each x_hat is in [0, 1], and each alpha finite and not negative."""
    for x_hat, alpha in estimates:
        if not (0 <= x_hat <= 1 and 0 <= alpha < math.inf):
            raise ValueError(
                f"a message has x_hat {x_hat} and alpha {alpha}; x_hat is in [0, 1], alpha finite and >= 0"
            )


def is_informative(p: float | Fraction) -> bool:
    """Return whether an observation with accuracy ``p``, or a social estimate ``p``, carries information."""
    return abs(2 * p - 1) >= INFORMATIVE_G


def _carries_no_information(p: float | Fraction, conventions: Conventions) -> bool:
    """Return whether ``p``, an accuracy or a social estimate, is to be treated as uninformative.

    That is if it is too near 1/2 (see `is_informative`), but never if the conventions are not guarded.
    """
    return conventions.guarded and not is_informative(p)


def _number_type(value: Number) -> type[Number]:
    """Return the type in which to compute with ``value``: Fraction for a fraction, and float otherwise."""
    return Fraction if isinstance(value, Fraction) else float


def _quotient_in_unit_interval(numerator: Number, denominator: Number) -> Number:
    """Return a quotient clamped to [0, 1].

    A division by zero gives infinity, clamped likewise, and 0/0 gives 1/2 (see ``Conventions.guarded``).
    """
    to_number = _number_type(numerator)
    if denominator != 0:
        return max(to_number(0), min(numerator / denominator, to_number(1)))
    if numerator == 0:
        return to_number(0.5)
    return to_number(1) if numerator > 0 else to_number(0)


def _sum(terms: Sequence[Number]) -> Number:
    """Return the exact sum if there is a fraction among the terms, else the correctly rounded one of floats.

    It is 0.0 if there are no terms.
    """
    is_exact = any(isinstance(term, Fraction) for term in terms)
    return cast(Number, sum(terms) if is_exact else math.fsum(terms))


def _weighted_mean(estimates: Sequence[Estimate[Number]], default: float | Fraction) -> Number:
    """Return the mean of all x_hat weighted by alpha, or ``default`` if there are none or all alpha are 0.

    Raises ValueError for an estimate with an x_hat outside [0, 1], or an alpha that is negative, infinite or
    NaN.
    """
    _check_estimates(estimates)
    # `_sum`, because the result of sum() for floats depends on the order of the estimates.
    total_weight = _sum([alpha for _, alpha in estimates])
    if total_weight == 0:
        return cast(Number, default)  # ``cast`` only calms the type checker, and changes nothing
    return _sum([alpha * x_hat for x_hat, alpha in estimates]) / total_weight


# ---- The robot ----


class ReferenceRobot:
    """A robot that computes in float64. Implements ``mcp_asdf.robot.Robot``.

    The thresholds of the hypothesis test are computed from omega, its type II error probability: ``omega`` in
    (0, 0.9] if it is given, and else the omega of the config's table. The table's entries are not used.
    ``conventions`` are the choices that the equations leave open, such as whether the test rejects at the
    threshold itself. ``settle`` is O(m) for the m <= 127 messages of a round, as these are kept in order to
    be summed exactly.

    Raises FirmwareError with ERR_CONFIG, ERR_TABLE, ERR_ID or ERR_B_HAT, in this order.
    """

    def __init__(
        self,
        config: Config,
        robot_id: int,
        b_hat: float,
        conventions: Conventions = PAPER,
        *,
        omega: float | None = None,
    ) -> None:
        """Make a robot without observations, which assumes that its sensor has the accuracy ``b_hat``.

        ``omega``, or for None the table's, is the type II error probability of the adaptive filter's test;
        other filters do not use it. Raises FirmwareError for an argument that the firmware would refuse.
        """
        check_settings(config)
        self._omega = 0.0  # not used by the other filters
        if config.filter == Filter.ADAPTIVE:
            self._omega = _choose_omega(config, omega)
            # Where SciPy is missing this fails now, and not at the first test.
            t_score(2, self._omega, conventions)
        check_id_and_b_hat(robot_id, b_hat)
        self._config = config
        self._id = operator.index(robot_id)  # as Python's own int
        self._conventions = conventions
        self._t = 0
        self._n = 0
        self._b_hat = float(b_hat)
        self._own_estimate = Estimate(x_hat=0.5, alpha=0.0)
        self._open_round: dict[int, Estimate[float]] = {}
        """Estimates of the open round, by sender."""
        self._closed_round: list[Estimate[float]] = []
        """Estimates with confidence of the last closed round; none with the robust filter."""
        self._robust = RobustReference(initial_b_hat=float(b_hat))
        self._filter_left = config.filter_period
        """Rounds until the filter runs next."""
        self._counts = {counter.name: 0 for counter in fields(Counters)}
        """Numbers of events, by the names of `Counters`."""

    def observe(self, z: Observation) -> Status:
        """Count an observation, and compute x_hat and alpha from all observations so far. O(1).

        At ``config.memory`` observations both counts, t and n, are halved, and the robust filter begins a new
        batch of observations. Returns OK; or ERR_OBSERVATION, and changes nothing, if ``z`` is neither WHITE
        nor BLACK.
        """
        colour = operator.index(z)  # raises TypeError for a float, and turns a NumPy integer into an int
        if colour not in (Observation.WHITE, Observation.BLACK):
            return Status.ERR_OBSERVATION
        self._t += 1
        if colour == Observation.BLACK:
            self._n += 1
        if self._t == self._config.memory:
            # Halving keeps the share of black tiles, and lets new observations weigh more than old ones.
            self._t //= 2
            self._n = round(self._n / 2)  # round() takes ties to even
            # The counts at the beginning of the present batch can no longer be compared with these.
            self._robust.begin_batch(self._n, self._t)
        self._own_estimate = Estimate(
            local_estimate(self._n, self._t, self._b_hat, self._conventions),
            local_confidence(self._n, self._t, self._b_hat, self._conventions),
        )
        return Status.OK

    def receive(self, sender: int, x_hat: float, alpha: float) -> Status:
        """Add a neighbour's estimate to the open round: what was received since the last ``settle``. O(1).

        Returns OK if the estimate was accepted; or REPEATED, and ignores it, if the round already has one of
        this sender. Raises FirmwareError, and counts the message as rejected, if ``sender`` is not in
        0 .. 127 or is the robot's own id (ERR_SENDER), or if ``x_hat`` is not in [0, 1] (ERR_X_HAT). Raises
        ValueError, and changes nothing, for an ``alpha`` that is no confidence: negative (also -0.0),
        infinite or NaN. An estimate with alpha = 0 is accepted, but has no weight. With the robust filter any
        other is also kept, as the latest one of its sender.
        """
        sender = operator.index(sender)  # as Python's own int
        check_alpha(alpha)  # first, since a wrong alpha is the caller's mistake and not counted
        status = self._check_message(sender, x_hat)
        if status != Status.OK:
            self._count("rejected")
            raise create_rejection(status, sender, x_hat)
        if sender in self._open_round:
            self._count("repeated")
            return Status.REPEATED
        self._count("accepted")
        self._open_round[sender] = Estimate(float(x_hat), float(alpha))
        if self._is_robust and alpha > 0:
            self._robust.keep_estimate(sender, float(x_hat))
        return Status.OK

    def _check_message(self, sender: int, x_hat: float) -> Status:
        """Return ERR_SENDER or ERR_X_HAT for a message that the robot must reject, or OK for any other.

        ERR_SENDER: ``sender`` is not in 0 .. 127, or is the robot's own id. ERR_X_HAT: ``x_hat`` is not in
        [0, 1]. If both apply, the result is ERR_SENDER.
        """
        if not 0 <= sender <= MAX_ID or sender == self._id:
            return Status.ERR_SENDER
        if not 0 <= x_hat <= 1:
            return Status.ERR_X_HAT
        return Status.OK

    def settle(self) -> Status:
        """End the open round, and run the filter if ``filter_period`` rounds have passed. O(m).

        The ended round becomes the closed one, about which x_bar, beta and x are from now on, and an empty
        round opens. With the robust filter one of the estimates that the robot keeps, or its own, becomes a
        vote instead, which moves the robot's answer x. Returns UPDATED if the filter has re-estimated b_hat,
        the assumed accuracy, and OK otherwise.
        """
        if self._is_robust:
            self._robust.take_vote(self._own_estimate.x_hat, has_confidence=self._own_estimate.alpha > 0)
        else:
            # Estimates without confidence have no weight in the means, and no part in the test.
            estimates = self._open_round.values()
            self._closed_round = [estimate for estimate in estimates if estimate.alpha > 0]
        self._open_round = {}
        self._filter_left -= 1
        if self._filter_left > 0:
            return Status.OK
        self._filter_left = self._config.filter_period
        return self._update_b_hat()

    def step(self, z: Observation) -> Status:
        """Observe ``z``, then settle.

        Returns UPDATED if the filter has run and re-estimated b_hat, and OK otherwise; or ERR_OBSERVATION,
        without settling, for an invalid ``z``.
        """
        status = self.observe(z)
        if status == Status.OK:
            return self.settle()
        return status

    def _update_b_hat(self) -> Status:
        """Run the robot's filter, the paper's or the robust one, which may change b_hat (assumed accuracy).

        Returns UPDATED if b_hat has changed, else OK. Before the first observation nothing is done.
        """
        if self._t == 0:
            return Status.OK  # there is no estimate to be tested
        new_b_hat = None
        if self._is_robust:
            new_b_hat = self._run_robust_filter()
        elif self._is_update_needed():
            new_b_hat = self.reestimate_b_hat()
        if new_b_hat is None:
            return Status.OK
        self._b_hat = new_b_hat
        self._count("updates")
        return Status.UPDATED

    def reestimate_b_hat(self) -> float | None:
        """Return the next b_hat, the assumed accuracy of the sensor (eq. 8), or None to keep the present one.

        It is the accuracy with which this robot would have estimated x_bar, as its neighbours did. It is None
        before the first observation, and if x_bar carries no information: |2 x_bar - 1| < 2**-12 (but see
        ``Conventions.guarded``). The robot does not change. The filter calls this when its test rejects
        x_hat, or in each of its runs if it has no test; the robust filter does not call it. Subclasses may
        override it for a filter of their own.
        """
        return assumed_accuracy_update(self._n, self._t, self.x_bar, self._conventions)

    def _is_update_needed(self) -> bool:
        """Return whether the paper's filter is to re-estimate b_hat from the round that has just ended.

        b_hat is the assumed accuracy. Only messages with a confidence above 0 are considered. The result is,
        by the filter of the configuration:

        - OFF: False.
        - ALWAYS: whether the round has a message.
        - ADAPTIVE: False if it has fewer than two messages. Otherwise the hypothesis test (eq. 12) runs and
          is counted, and the result is whether it rejects x_hat.
        """
        if self._config.filter == Filter.OFF:
            return False
        if self._config.filter == Filter.ALWAYS:
            return bool(self._closed_round)
        if len(self._closed_round) < 2:
            return False
        self._count("tests")
        neighbours = [estimate.x_hat for estimate in self._closed_round]
        # The conventions say how many degrees of freedom the t-score has, and if equality rejects, too.
        return asdf_test_rejects(self._own_estimate.x_hat, neighbours, self._omega, self._conventions)

    def _run_robust_filter(self) -> float | None:
        """Test the initial b_hat against the estimates that the robot keeps, one of each neighbour.

        Returns the new b_hat, or None if b_hat stays. First the observations since the last run enter the
        dispersion, which says how much more the robot's observations vary than independent ones. Then the
        first of these cases that applies decides:

        - The robot keeps fewer than five estimates: None, without a test. Of five, two can be outvoted.
        - The test, which is counted, rejects the initial b_hat, and at most two fifths of the estimates
          support this robot: the accuracy with which the robot would have estimated their centre (eq. 8), or
          None if the centre carries no information.
        - Otherwise: the initial b_hat, or None if that is the present b_hat.
        """
        robust = self._robust
        robust.end_batch(self._n, self._t)
        if len(robust.estimates) < TESTED_ESTIMATES_MIN:
            return None
        # The test and the question who supports the robot are one call: it returns the centre of the
        # estimates if the test rejects without enough support, and None otherwise.
        self._count("tests")
        contradicted_centre = robust.find_contradiction(self._n, self._t)
        if contradicted_centre is not None:
            return assumed_accuracy_update(self._n, self._t, contradicted_centre, self._conventions)
        # An earlier test may have replaced the initial b_hat, and then it comes back.
        is_initial = self._b_hat == robust.initial_b_hat
        return None if is_initial else robust.initial_b_hat

    @property
    def _is_robust(self) -> bool:
        """True if this robot has the robust filter."""
        return self._config.filter == Filter.ROBUST

    def _count(self, counter: str) -> None:
        """Increment the counter of this name, modulo 2**16 as in the firmware."""
        self._counts[counter] = (self._counts[counter] + 1) % COUNTER_MODULUS

    def __repr__(self) -> str:
        """Return class, id, observations and estimates in one line."""
        return describe_robot(self)

    @property
    def id(self) -> int:
        """Id of this robot."""
        return self._id

    @property
    def t(self) -> int:
        """Number of observations."""
        return self._t

    @property
    def n(self) -> int:
        """Number of black observations."""
        return self._n

    @property
    def b_hat(self) -> float:
        """Accuracy that this robot assumes of its sensor, in [2**-20, 1 - 2**-20]."""
        return self._b_hat

    @property
    def x_hat(self) -> float:
        """Local estimate of the share of black tiles (eq. 3), in [0, 1]."""
        return self._own_estimate.x_hat

    @property
    def alpha(self) -> float:
        """Confidence of the local estimate x_hat (eq. 4), >= 0."""
        return self._own_estimate.alpha

    @property
    def x_bar(self) -> float:
        """Social estimate (eq. 5): weighted mean of the x_hat of the last closed round; 1/2 if ``beta`` is 0.

        With the robust filter: the centre of the votes, or 1/2 before the first. O(m).
        """
        if self._is_robust:
            return self._robust.votes.centre
        return social_estimate(self._closed_round)

    @property
    def beta(self) -> float:
        """Social confidence (eq. 6): sum of the alpha of the last closed round. O(m).

        It is 0 without messages, and always with the robust filter.
        """
        return social_confidence(self._closed_round)

    @property
    def x(self) -> float:
        """Informed estimate (eq. 7) of the present local estimate and the last closed round. O(m).

        With the robust filter: the centre of the votes, or this robot's own x_hat before the first.
        """
        if self._is_robust:
            return self._robust.votes.centre if self._robust.votes.count else self._own_estimate.x_hat
        return informed_estimate(self._own_estimate, self._closed_round)

    @property
    def counters(self) -> Counters:
        """Numbers of events since the robot was made."""
        return Counters(**self._counts)


def _choose_omega(config: Config, omega: float | None) -> float:
    """Return the type II error probability of the hypothesis test: ``omega``, or for None the table's.

    Raises FirmwareError (ERR_TABLE) for an ``omega`` outside (0, 0.9]; or, where it is None, if the config
    has no table or one that the firmware would refuse.
    """
    if omega is not None:
        if not 0 < omega <= MAX_OMEGA:
            raise FirmwareError(Status.ERR_TABLE, f"omega is {omega}; choose one in (0, {MAX_OMEGA}]")
        return omega
    return check_table(config.table).omega
