"""The paper's equations in float64, one function each, and a robot made of them; and the robust filter, which
is not the paper's (``docs/robust.md``).

Nothing here is quantised and alpha has no upper limit, so this is what the fixed-point firmwares are
measured against. Names and cases are the paper's, with w_hat = b_hat; equation numbers count its
numbered rows in order, so the hypothesis test is eq. 12. Sums are correctly rounded (``math.fsum``,
``statistics``): no result depends on the order of the messages.

Where the equations divide by zero a `Conventions` decides. Arguments outside the ranges
that a function names, NaN among them, raise ValueError.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from operator import index
from statistics import mean, stdev
from typing import NamedTuple

from mcp_asdf.robot import (
    B_HAT_MARGIN,
    MAX_ID,
    Config,
    Counters,
    Filter,
    FirmwareError,
    Observation,
    Status,
    accepted,
    check_alpha,
    check_identity,
    check_settings,
    check_table,
    reading,
    shown,
)

UNINFORMATIVE = 2.0**-12
"""Where |2 p - 1| is below this, an accuracy or a social estimate p is uninformative."""

MAX_OMEGA = 0.9

LEAST_SPREAD, MOST_SPREAD = 2.0**-12, 0.25
MOST_VOTES, VOTES_MOVED = 2**14, 2**8
SIGMAS_SQUARED, FEWEST_VOICES, LEAST_MOVE = 12, 3, 2.0**-30
"""Constants of the robust filter, whose reasons are in ``docs/robust.md``."""

COUNTER_MODULUS = 2**16


@dataclass(frozen=True)
class Conventions:
    """Where the firmware and the authors' programs differ.

    Attributes:
        lost_degrees: The t-score has m - ``lost_degrees`` degrees of freedom.
        strict: Update where the deviation is above the interval (eq. 12), not where it equals it.
        guarded: b_hat within UNINFORMATIVE of saying nothing gives x_hat = 1/2 and alpha = 0, and no
            update follows from such an x_bar. Otherwise a division by zero is IEEE 754's, whose infinity
            the case distinctions of eq. 3 and 8 then clamp; 0/0 alone, NaN in the authors' programs,
            is 1/2: the value of both equations at n/t = 1/2 for every other b_hat or x_bar.
        clamp_at: A quotient of eq. 8 at most ``clamp_at`` or at least 1 - ``clamp_at`` ...
        clamp_to: ... becomes ``clamp_to`` or 1 - ``clamp_to``.
        zero_confidence: Value in place of alpha = 0 once there is an observation.
    """

    lost_degrees: int = 1
    strict: bool = True
    guarded: bool = True
    clamp_at: float = B_HAT_MARGIN
    clamp_to: float = B_HAT_MARGIN
    zero_confidence: float = 0.0


PAPER = Conventions()
"""The paper's equations with the firmware's meanings at their edges."""

AUTHORS = Conventions(
    lost_degrees=0, strict=False, guarded=False, clamp_at=0.0, clamp_to=1e-6, zero_confidence=1e-6
)
"""The authors' programs (github.com/NESTLab/sensor-degradation-filter)."""


class Message(NamedTuple):
    """A robot's broadcast: its local estimate in [0, 1] and its confidence, >= 0 and finite."""

    x_hat: float
    alpha: float


def local_estimate(n: int, t: int, b: float, conventions: Conventions = PAPER) -> float:
    """x_hat in [0, 1] from ``n`` black among ``t`` observations, 0 <= n <= t, and ``b`` in [0, 1] (eq. 3).

    1/2 before the first observation. O(1).
    """
    _check_counts(n, t)
    _check_unit(b, "b")
    if t == 0 or _is_uninformative(b, conventions):
        return 0.5
    return max(0.0, min(_quotient(n / t + b - 1, 2 * b - 1), 1.0))


def local_confidence(n: int, t: int, b: float, conventions: Conventions = PAPER) -> float:
    """alpha >= 0 of the local estimate, whose arguments these are (eq. 4). O(1).

    0 before the first observation. The numerators of the first two cases are multiplied out, which
    leaves no difference to cancel: t w^2 - (2w - 1)(t - n) = n w^2 + (t - n)(1 - w)^2. Raises
    ZeroDivisionError where alpha is infinite: a perfect sensor, ``b`` 0 or 1, that saw one colour only.
    """
    x_hat, d = local_estimate(n, t, b, conventions), (2 * b - 1) ** 2
    if t == 0:
        return 0.0
    if _is_uninformative(b, conventions):
        return conventions.zero_confidence
    if x_hat == 0:
        alpha = d * (n / (1 - b) ** 2 + (t - n) / b**2)
    elif x_hat == 1:
        alpha = d * ((t - n) / (1 - b) ** 2 + n / b**2)
    else:
        alpha = d * t**3 / (n * (t - n))
    return alpha or conventions.zero_confidence


def social_estimate(messages: Sequence[Message]) -> float:
    """x_bar in [0, 1] (eq. 5); 1/2 where it is undefined, when no message has alpha > 0. O(m)."""
    return _weighted_mean(messages, undefined=0.5)


def social_confidence(messages: Sequence[Message]) -> float:
    """beta >= 0 (eq. 6); 0 without messages. O(m)."""
    _check_messages(messages)
    return math.fsum(message.alpha for message in messages)


def informed_estimate(own: Message, messages: Sequence[Message]) -> float:
    """x in [0, 1] (eq. 7, second form); the own x_hat if all confidences are 0. O(m).

    The own message is one term among the others: robots that hear each other get the same bits.
    """
    return _weighted_mean([own, *messages], undefined=own.x_hat)


def assumed_accuracy_update(n: int, t: int, x_bar: float, conventions: Conventions = PAPER) -> float | None:
    """The b_hat that makes ``x_bar`` in [0, 1] the local estimate (eq. 8), off 0 and 1 by ``clamp_to``. O(1).

    None, no update, before the first observation and where ``x_bar`` is uninformative.
    """
    _check_counts(n, t)
    _check_unit(x_bar, "x_bar")
    if t == 0 or _is_uninformative(x_bar, conventions):
        return None
    b = _quotient(n / t + x_bar - 1, 2 * x_bar - 1)
    if b <= conventions.clamp_at:
        return conventions.clamp_to
    if b >= 1 - conventions.clamp_at:
        return 1 - conventions.clamp_to
    return b


@cache
def t_score(m: int, omega: float, conventions: Conventions = PAPER) -> float:
    """t_{m-1,(1-omega)/2}, which a T variable exceeds with probability (1 - omega)/2 (eq. 10).

    ``m`` >= 2, 0 < ``omega`` < 1. O(1) after the first call with the same arguments.
    """
    from scipy.special import stdtrit  # type: ignore[import-untyped] # noqa: PLC0415 (loads slowly)

    if not (m >= 2 and 0 < omega < 1):
        raise ValueError(f"m is {m} and omega {omega}; there is a t-score for m >= 2 and 0 < omega < 1")
    return float(stdtrit(m - conventions.lost_degrees, (1 + omega) / 2))


def rejects(
    x_hat: float, neighbours: Sequence[float], omega: float, conventions: Conventions = PAPER
) -> bool:
    """True if ``x_hat`` differs too much from the m local estimates ``neighbours`` (eq. 12). O(m).

    Never for m < 2, where the sample has no variance. All estimates are finite, 0 < ``omega`` < 1.
    """
    if not all(map(math.isfinite, (x_hat, *neighbours))):
        raise ValueError(f"x_hat is {x_hat}, its neighbours' {list(neighbours)}; all must be finite")
    m = len(neighbours)
    if m < 2:
        return False
    deviation = abs(mean(neighbours) - x_hat)
    interval = (t_score(m, omega, conventions) / math.sqrt(m) + 1) * stdev(neighbours)
    return deviation > interval or (deviation == interval and not conventions.strict)


@dataclass(frozen=True)
class Crowd:
    """What a robot with the robust filter knows of the others.

    Attributes:
        centre: Of the estimates heard, in [0, 1].
        spread: Their median distance from it, in [LEAST_SPREAD, MOST_SPREAD].
        trend: Share of the centre's late moves that went up; a move below LEAST_MOVE is half of one.
        votes: Messages that moved it, up to MOST_VOTES.
        voices: Who was heard, modulo 32.
    """

    centre: float = 0.5
    spread: float = MOST_SPREAD
    trend: float = 0.5
    votes: int = 0
    voices: frozenset[int] = frozenset()

    @property
    def is_moving(self) -> bool:
        """True if 7 of 8 late moves of the centre went one way: it lags behind a floor that has changed."""
        return not 1 / 8 <= self.trend < 7 / 8


def vote(crowd: Crowd, sender: int, x_hat: float) -> Crowd:
    """The crowd after a message: one step of Robbins and Monro's stochastic approximation. O(1).

    The centre moves as for Huber's M-estimate clamped at the spread, the spread as for the median of the
    distances, with a gain of 4/votes to 8/votes that stays within 2**-12 and 2**-3.
    """
    _check_unit(x_hat, "x_hat")
    votes = min(crowd.votes + 1, MOST_VOTES)
    gain, distance = 2.0 ** -max(votes.bit_length() - 3, 3), x_hat - crowd.centre
    step = gain * max(-crowd.spread, min(distance, crowd.spread))
    widening = gain / 2 if abs(distance) > crowd.spread else -gain / 2
    way = float(step > 0) if abs(step) >= LEAST_MOVE else 0.5
    return Crowd(
        centre=crowd.centre + step,
        spread=max(LEAST_SPREAD, min(crowd.spread * (1 + widening), MOST_SPREAD)),
        trend=crowd.trend + (way - crowd.trend) / 256,
        votes=votes,
        voices=crowd.voices | {sender % 32},
    )


def deviates(n: int, t: int, b: float, centre: float, spread: float) -> bool:
    """The robust filter's test: True if ``n`` black among ``t`` > 0 cannot be chance, given ``b``. O(1).

    D**2 > 12 (v/t + (2b - 1)**2 spread**2), where D is the distance of n/t from p = b r + (1 - b)(1 - r), r
    the ``centre``, and v the larger of p (1 - p) and n/t (1 - n/t).
    """
    _check_counts(n, t)
    _check_unit(b, "b")
    _check_unit(centre, "centre")
    seen, p = n / t, b * centre + (1 - b) * (1 - centre)
    variance = max(p * (1 - p), seen * (1 - seen))
    return (seen - p) ** 2 > SIGMAS_SQUARED * (variance / t + (2 * b - 1) ** 2 * spread**2)


def _check_counts(n: int, t: int) -> None:
    if not 0 <= n <= t:
        raise ValueError(f"n is {n} and t {t}; counts are 0 <= n <= t")


def _check_unit(value: float, name: str) -> None:
    if not 0 <= value <= 1:
        raise ValueError(f"{name} is {value}; it lies in [0, 1]")


def _check_messages(messages: Sequence[Message]) -> None:
    for x_hat, alpha in messages:
        if not (0 <= x_hat <= 1 and 0 <= alpha < math.inf):
            raise ValueError(
                f"a message has x_hat {x_hat} and alpha {alpha}; x_hat is in [0, 1], alpha finite and >= 0"
            )


def _is_uninformative(p: float, conventions: Conventions) -> bool:
    return conventions.guarded and abs(2 * p - 1) < UNINFORMATIVE


def _quotient(numerator: float, denominator: float) -> float:
    """Divide as IEEE 754 does, but 0/0 is 1/2 (see ``Conventions.guarded``)."""
    if denominator != 0:
        return numerator / denominator
    return 0.5 if numerator == 0 else math.copysign(math.inf, numerator)


def _weighted_mean(messages: Sequence[Message], undefined: float) -> float:
    _check_messages(messages)
    beta = math.fsum(message.alpha for message in messages)
    moments = (message.alpha * message.x_hat for message in messages)
    return math.fsum(moments) / beta if beta else undefined


class ReferenceRobot:
    """A robot in float64; see `mcp_asdf.robot.Robot`.

    ``settle`` is O(m), as the messages of a round are kept to be summed exactly; m <= 127. The t-scores
    are computed for the table's omega, or for ``omega`` in (0, 0.9] if it is given; the table's entries
    are not used. Raises FirmwareError with ERR_CONFIG, ERR_TABLE, ERR_ID or ERR_B_HAT, in this order.
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
        check_settings(config)
        self._omega = _checked_omega(config, omega) if config.filter == Filter.ADAPTIVE else 0.0
        if self._omega:
            t_score(2, self._omega, conventions)  # where SciPy is missing, now and not at the first test
        check_identity(robot_id, b_hat)
        self._config, self._id, self._conventions = config, index(robot_id), conventions
        self._t, self._n, self._b_hat, self._first = 0, 0, float(b_hat), float(b_hat)
        self._crowd = Crowd()
        self._own = Message(x_hat=0.5, alpha=0.0)
        self._open: dict[int, Message] = {}
        self._round: list[Message] = []
        self._filter_left = config.filter_period
        self._counts = dict.fromkeys(Counters.__dataclass_fields__, 0)

    def observe(self, z: Observation) -> Status:
        """Count an observation and form x_hat and alpha. O(1)."""
        if index(z) not in (Observation.WHITE, Observation.BLACK):
            return Status.ERR_OBSERVATION
        self._t += 1
        self._n += z == Observation.BLACK
        if self._t == self._config.memory:
            self._t, self._n = self._t // 2, round(self._n / 2)  # round() takes ties to even
        self._own = Message(
            local_estimate(self._n, self._t, self._b_hat, self._conventions),
            local_confidence(self._n, self._t, self._b_hat, self._conventions),
        )
        return Status.OK

    def receive(self, sender: int, x_hat: float, alpha: float) -> Status:
        """Take a neighbour's message into the open round; raises as the interface says. O(1)."""
        sender = index(sender)
        check_alpha(alpha)
        status = self._check_message(sender, x_hat)
        if status < Status.OK:
            self._count("rejected")
        elif sender in self._open:
            self._count("repeated")
            status = Status.REPEATED
        else:
            self._count("accepted")
            self._open[sender] = Message(float(x_hat), float(alpha))
            if self._is_robust and alpha > 0:
                self._crowd = vote(self._crowd, sender, float(x_hat))
        return accepted(status, sender, x_hat)

    def settle(self) -> Status:
        """Close the round, and filter every ``filter_period`` rounds. O(m)."""
        messages = () if self._is_robust else self._open.values()
        self._round = [message for message in messages if message.alpha > 0]
        self._open = {}
        self._filter_left -= 1
        if self._filter_left:
            return Status.OK
        self._filter_left = self._config.filter_period
        return self._filter()

    def step(self, z: Observation) -> Status:
        """``observe(z)`` then ``settle()``: what ``settle`` returns, or the error of ``observe``."""
        status = self.observe(z)
        return self.settle() if status == Status.OK else status

    def _check_message(self, sender: int, x_hat: float) -> Status:
        if not 0 <= sender <= MAX_ID or sender == self._id:
            return Status.ERR_SENDER
        if not 0 <= x_hat <= 1:
            return Status.ERR_X_HAT
        return Status.OK

    def _filter(self) -> Status:
        if self._is_robust:
            b_hat = self._crowd_b_hat()
        else:
            b_hat = self.reestimated() if self._is_activated() else None
        if b_hat is None:
            return Status.OK
        self._b_hat = b_hat
        self._count("updates")
        return Status.UPDATED

    def reestimated(self) -> float | None:
        """The next assumed accuracy (eq. 8), None to keep the present one; variants override it."""
        return assumed_accuracy_update(self._n, self._t, self.x_bar, self._conventions)

    @property
    def _is_robust(self) -> bool:
        return self._config.filter == Filter.ROBUST

    def _crowd_b_hat(self) -> float | None:
        """The same by the robust filter: the first b_hat where the test does not reject that."""
        crowd = self._crowd
        if self._t == 0:
            return None
        if crowd.is_moving:
            if crowd.votes >= 2 * VOTES_MOVED:
                self._crowd = replace(crowd, votes=crowd.votes // 2)
            return None
        if len(crowd.voices) < FEWEST_VOICES:
            return None
        self._count("tests")
        if deviates(self._n, self._t, self._first, crowd.centre, crowd.spread):
            return self.reestimated()
        return self._first if self._b_hat != self._first else None

    def _is_activated(self) -> bool:
        if self._config.filter == Filter.OFF or self._t == 0:
            return False
        if self._config.filter == Filter.ALWAYS:
            return bool(self._round)
        if len(self._round) < 2:
            return False
        self._count("tests")
        neighbours = [message.x_hat for message in self._round]
        return rejects(self._own.x_hat, neighbours, self._omega, self._conventions)

    def _count(self, counter: str) -> None:
        self._counts[counter] = (self._counts[counter] + 1) % COUNTER_MODULUS

    def __repr__(self) -> str:
        return shown(self)

    id = reading(lambda robot: robot._id, "Own id.")
    t = reading(lambda robot: robot._t, "Observations counted.")
    n = reading(lambda robot: robot._n, "Black ones among them.")
    b_hat = reading(lambda robot: robot._b_hat, "Assumed accuracy.")
    x_hat = reading(lambda robot: robot._own.x_hat, "Local estimate (eq. 3), in [0, 1].")
    alpha = reading(lambda robot: robot._own.alpha, "Local confidence (eq. 4), >= 0.")

    @property
    def x_bar(self) -> float:
        """Social estimate (eq. 5) of the last closed round; 1/2 when ``beta`` is 0. O(m).

        Robust: the crowd's centre.
        """
        if self._is_robust:
            return self._crowd.centre
        return social_estimate(self._round)

    @property
    def beta(self) -> float:
        """Social confidence (eq. 6) of the last closed round; 0 without neighbours and if robust. O(m)."""
        return social_confidence(self._round)

    @property
    def x(self) -> float:
        """Informed estimate (eq. 7) of the own estimate now and the last closed round, in [0, 1]; O(m).

        Robust: the centre, or x_hat while nobody was heard.
        """
        if self._is_robust:
            return self._crowd.centre if self._crowd.votes else self._own.x_hat
        return informed_estimate(self._own, self._round)

    @property
    def counters(self) -> Counters:
        """Diagnostics since the robot was made."""
        return Counters(**self._counts)


def _checked_omega(config: Config, omega: float | None) -> float:
    if omega is not None:
        if not 0 < omega <= MAX_OMEGA:
            raise FirmwareError(Status.ERR_TABLE, f"omega is {omega}; choose one in (0, {MAX_OMEGA}]")
        return omega
    return check_table(config.table).omega
