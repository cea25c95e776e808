"""The interface of a robot's firmware, whichever arithmetic runs inside.

Three firmwares implement `Robot`: the paper's equations in float64 (``reference``), plain
integers (``mirror``) and the C itself (``native``). A tool written against this module runs on any
of them. The two fixed-point ones also implement `FixedPointRobot`, whose ``*_raw`` members
are the firmware's own integers; the step's exact meaning is in ``docs/design.md``.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum
from typing import TYPE_CHECKING, Any, Protocol, TypeVar, runtime_checkable

from mcp_asdf.table import Table, TableError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

_T = TypeVar("_T")

MAX_ID = 127
"""Largest robot id; a round therefore holds at most 127 messages."""

DEFAULT_FILTER_PERIOD = 1000
"""Rounds from one run of the filter to the next."""

DEFAULT_MEMORY = 2**31
"""Observations at which t and n are halved; the largest the firmware can count."""

MIN_MEMORY = 64
MAX_FILTER_PERIOD = 2**32 - 1
B_HAT_MARGIN = 2.0**-20
"""b_hat stays in [2**-20, 1 - 2**-20]."""


class Observation(IntEnum):
    """Colour of the tile under the robot."""

    WHITE = 0
    BLACK = 1


class Filter(IntEnum):
    """When the assumed accuracy is re-estimated, every ``filter_period`` rounds."""

    ADAPTIVE = 0
    """When the hypothesis test (eq. 12) rejects: the paper's ASDF."""
    ALWAYS = 1
    """Without a test."""
    OFF = 2
    """Never: plain collective perception."""
    ROBUST = 3
    """Not the paper's: while the own count of black tiles differs too much from what the centre of all
    estimates heard predicts (``docs/robust.md``)."""


class Status(IntEnum):
    """Result of a call; the numbers are those of ``mcp_asdf_status_t`` in the C header.

    Zero and positive values mean success, negative values are errors: nothing but the ``rejected`` counter
    has changed.
    """

    OK = 0
    REPEATED = 1
    """receive: this sender was heard in this round already; the message is ignored."""
    UPDATED = 2
    """settle, step: the assumed accuracy was re-estimated."""
    ERR_CONFIG = -1
    ERR_TABLE = -2
    ERR_ID = -3
    ERR_B_HAT = -4
    ERR_OBSERVATION = -5
    ERR_SENDER = -6
    ERR_X_HAT = -7
    ERR_IMAGE = -8


class FirmwareError(ValueError):
    """A robot was not made or restored, or refused a message; ``status`` is the firmware's own error code."""

    def __init__(self, status: Status, message: str) -> None:
        super().__init__(f"{message} ({status.name})")
        self.status = status


@dataclass(frozen=True)
class Config:
    """Settings that robots share.

    Attributes:
        table: Thresholds of the hypothesis test; may be None unless ``filter`` is ADAPTIVE.
        filter: When the assumed accuracy is re-estimated.
        filter_period: Rounds from one run of the filter to the next, 1 .. 2**32 - 1: the nominal filtering
            period tau divided by the broadcast period, which is the caller's.
        memory: When t reaches this multiple of 4 (64 .. 2**31), t and n are halved.
    """

    table: Table | None = None
    filter: Filter = Filter.ADAPTIVE
    filter_period: int = DEFAULT_FILTER_PERIOD
    memory: int = DEFAULT_MEMORY


@dataclass(frozen=True)
class Counters:
    """Diagnostics, each modulo 2**16."""

    accepted: int = 0
    repeated: int = 0
    rejected: int = 0
    tests: int = 0
    updates: int = 0


@dataclass
class Sums:
    """Exact sums over a round's messages with alpha > 0 (units: see ``mcp_asdf_open_t``).

    With every alpha in units of 2**-24 and every x_hat in units of 2**-23: ``alpha`` is the sum of
    alpha; ``alpha_x_low`` and ``alpha_x_high`` are the sums of (alpha mod 2**32) x_hat and of
    (alpha div 2**32) x_hat; ``x`` and ``x_squared`` the sums of x_hat and its square; ``count`` is
    m, the number of messages.
    """

    alpha: int = 0
    alpha_x_low: int = 0
    alpha_x_high: int = 0
    x_squared: int = 0
    x: int = 0
    count: int = 0


@runtime_checkable
class Robot(Protocol):
    """One robot's MCP-ASDF firmware. Estimates and confidences are floats here.

    Constructors take ``(config, robot_id, b_hat)``: a `Config`, an id in 0..127 and the
    initial assumed accuracy in [2**-20, 1 - 2**-20]; they raise `FirmwareError`.

    An ``int`` may be any integer, NumPy's included, and a ``float`` any real number.
    """

    def observe(self, z: Observation) -> Status:
        """Count an observation and form x_hat and alpha. Fails for another z (ERR_OBSERVATION). O(1)."""

    def receive(self, sender: int, x_hat: float, alpha: float) -> Status:
        """Take a neighbour's message into the open round; REPEATED if its sender was heard already. O(1).

        Raises FirmwareError, and counts the message as rejected, if ``sender`` is outside 0 .. 127 or the own
        id (ERR_SENDER), or ``x_hat`` outside [0, 1] or NaN (ERR_X_HAT). Raises ValueError, and changes
        nothing, for an ``alpha`` that is no confidence: negative (-0.0, too), infinite or NaN.
        """

    def settle(self) -> Status:
        """Close the round, and filter every ``filter_period`` rounds; UPDATED after a re-estimate. O(1)."""

    def step(self, z: Observation) -> Status:
        """``observe(z)`` then ``settle()``: what ``settle`` returns, or the error of ``observe``."""

    @property
    def id(self) -> int:
        """Own id."""

    @property
    def t(self) -> int:
        """Observations counted."""

    @property
    def n(self) -> int:
        """Black ones among them."""

    @property
    def b_hat(self) -> float:
        """Assumed accuracy."""

    @property
    def x_hat(self) -> float:
        """Local estimate (eq. 3), in [0, 1]."""

    @property
    def alpha(self) -> float:
        """Local confidence (eq. 4), >= 0."""

    @property
    def x_bar(self) -> float:
        """Social estimate (eq. 5) of the last closed round; 1/2 when ``beta`` is 0.

        Robust: the crowd's centre; 1/2 while nobody was heard.
        """

    @property
    def beta(self) -> float:
        """Social confidence (eq. 6) of the last closed round; 0 without neighbours, and in robust mode."""

    @property
    def x(self) -> float:
        """Informed estimate (eq. 7) of the present local estimate and the last closed round, in [0, 1].

        Robust: the crowd's centre, or x_hat while nobody was heard.
        """

    @property
    def counters(self) -> Counters:
        """Diagnostics since the robot was made."""


@runtime_checkable
class FixedPointRobot(Robot, Protocol):
    """A robot whose arithmetic is the firmware's; raw values are its integers."""

    def receive_raw(self, sender: int, x_hat: int, alpha: int) -> Status:
        """The C call: x_hat in units of 2**-23, alpha as the firmware's word. For programs that read a bus.

        Invalid messages are part of a bus's life, so the status is the answer here: where ``receive`` raises
        FirmwareError this returns ERR_SENDER or ERR_X_HAT, for the caller to count. Raises ValueError, and
        changes nothing, for an ``alpha`` that is no word of 32 bits.
        """

    def receive_all(self, messages: NDArray[np.uint32]) -> int:
        """``receive_raw`` of several messages in order; returns how many were accepted. O(messages).

        ``messages`` has shape (messages, 3), the columns sender, x_hat and alpha. Raises ValueError, and
        changes nothing, for an array of another type or shape, or one that is not C-contiguous.
        """

    def save(self) -> bytes:
        """The state as an image that ``restore`` takes back."""

    @classmethod
    def restore(cls, config: Config, image: bytes) -> FixedPointRobot:
        """A robot from ``save``'s image, whichever firmware saved it; O(q), for the table is checked.

        ``image`` may be a bytearray or a memoryview, too; what is no bytes at all raises TypeError. Raises
        FirmwareError with ERR_CONFIG or ERR_TABLE as constructors do, and with ERR_IMAGE for an image that
        is damaged, of another version or impossible with ``config``.
        """

    def state(self) -> dict[str, int]:
        """Every field of the state by name, for comparing two firmwares bit for bit."""

    def holds_invariants(self) -> bool:
        """True if the state could have come from calls of this interface alone. O(1)."""

    @property
    def b_hat_raw(self) -> int:
        """b_hat in units of 2**-32."""

    @property
    def x_hat_raw(self) -> int:
        """x_hat in units of 2**-23."""

    @property
    def alpha_raw(self) -> int:
        """alpha as the firmware's word."""

    @property
    def x_bar_raw(self) -> int:
        """x_bar in units of 2**-23."""

    @property
    def beta_raw(self) -> int:
        """beta in units of 2**-24."""

    @property
    def x_raw(self) -> int:
        """x in units of 2**-23."""


def reading(read: Callable[[Any], _T], meaning: str) -> _T:
    """A property of a robot, which ``read`` gives."""
    return property(read, doc=meaning)  # type: ignore[return-value]


def check_settings(config: Config) -> None:
    """Raises FirmwareError (ERR_CONFIG) for a filter, period or memory that the firmware would refuse."""
    period, memory = config.filter_period, config.memory
    if config.filter not in tuple(Filter):
        raise FirmwareError(Status.ERR_CONFIG, f"filter is {config.filter}; choose a Filter")
    if not 1 <= period <= MAX_FILTER_PERIOD:
        raise FirmwareError(
            Status.ERR_CONFIG, f"filter_period is {period} rounds; choose 1 .. {MAX_FILTER_PERIOD}"
        )
    if not MIN_MEMORY <= memory <= DEFAULT_MEMORY or memory % 4:
        raise FirmwareError(
            Status.ERR_CONFIG,
            f"memory is {memory}; choose a multiple of 4, {MIN_MEMORY} .. {DEFAULT_MEMORY}",
        )


def check_alpha(alpha: float) -> None:
    """Raises ValueError for what is no confidence: a negative number, -0.0, infinity or NaN."""
    if not 0 <= alpha < math.inf or math.copysign(1, alpha) < 0:
        raise ValueError(f"alpha is {alpha}; a confidence is finite, not negative and not -0.0")


def check_table(table: Table | None) -> Table:
    """The table, if it is one. Raises FirmwareError (ERR_TABLE) where the firmware would refuse it."""
    if table is None:
        raise FirmwareError(
            Status.ERR_TABLE, "the adaptive filter needs a table; make one with mcp-asdf table"
        )
    try:
        return Table.from_words(table.words())
    except TableError as error:
        raise FirmwareError(Status.ERR_TABLE, str(error)) from error


def accepted(status: Status, sender: int, x_hat: float) -> Status:
    """``status``, if a message of these was taken. Raises FirmwareError if it was refused."""
    if status == Status.ERR_SENDER:
        raise FirmwareError(
            status, f"sender is {sender}; it must be 0 .. {MAX_ID} and not the receiver's own id"
        )
    if status == Status.ERR_X_HAT:
        raise FirmwareError(status, f"x_hat is {x_hat}; it must be in [0, 1]")
    return status


def shown(robot: Any) -> str:
    """A robot's id and state in one line, for ``repr``."""
    values = (f"{name}={getattr(robot, name):.6g}" for name in ("b_hat", "x_hat", "alpha", "x"))
    return f"<{type(robot).__name__} {robot.id}: t={robot.t} n={robot.n} {' '.join(values)}>"


def check_identity(robot_id: int, b_hat: float) -> None:
    """Raises FirmwareError for an id (ERR_ID) or an initial accuracy (ERR_B_HAT) out of range."""
    if not 0 <= robot_id <= MAX_ID:
        raise FirmwareError(Status.ERR_ID, f"robot id is {robot_id}; choose 0 .. {MAX_ID}")
    if not B_HAT_MARGIN <= b_hat <= 1 - B_HAT_MARGIN:
        raise FirmwareError(Status.ERR_B_HAT, f"b_hat is {b_hat}; choose one in [2**-20, 1 - 2**-20]")
