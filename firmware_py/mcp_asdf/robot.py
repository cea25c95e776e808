"""The interface of a robot's firmware, and what its three implementations share.

The implementations are `ReferenceRobot` (the paper's equations in float64), `MirrorRobot` (the firmware in
Python integers) and `NativeRobot` (the C itself). A tool that is written for `Robot` runs on any of them. The
latter two also implement `FixedPointRobot`, whose ``*_raw`` members are the firmware's own integers. What a
robot does in each call, to the bit, is specified in ``docs/design.md``.

A robot observes the colour of the tile under it, and exchanges estimates with its neighbours. These words
have the same meaning in the whole package; "eq." means an equation of the paper:

- ``t`` and ``n``: number of observations so far, and how many of them were black.
- ``b_hat``: the accuracy that the robot assumes of its own sensor, which is the probability that the sensor
  names a colour correctly. The filter re-estimates it; such a re-estimate is an *update*.
- ``x_hat`` and ``alpha``: the *local* estimate of the share of black tiles, which follows from t, n and
  b_hat, and its confidence, which is its Fisher information.
- *Message*: what a robot broadcasts, that is its id (``sender``), x_hat and alpha.
- *Round*: the messages received from one ``settle`` to the next. The *open* round still takes messages, and
  the *closed* round is the last one that ``settle`` has ended. m is its number of messages with alpha > 0.
- ``x_bar`` and ``beta``: the *social* estimate, which is the mean of a round's x_hat weighted by alpha, and
  its confidence, which is the sum of these alpha.
- ``x``: the *informed* estimate, which is the mean of x_hat and x_bar weighted by alpha and beta.
- ``omega``: type II error probability of the hypothesis test by which the paper's filter decides on an
  update.
- *Robust filter*: this project's own filter. It keeps the latest x_hat of each sender. Each ``settle`` takes
  one estimate as a *vote*: a sender's, in turn, or the robot's own. The *centre* of the votes is the robot's
  informed estimate.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum
from typing import TYPE_CHECKING, Protocol, runtime_checkable

from mcp_asdf.table import Table, TableError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

MAX_ID = 127
"""Largest robot id."""
MAX_ROUND_SIZE = MAX_ID
"""Largest number of messages in a round: one of each robot but the one that receives them."""

DEFAULT_FILTER_PERIOD = 1000
"""Rounds from one run of the filter to the next."""
MAX_FILTER_PERIOD = 2**32 - 1

DEFAULT_MEMORY = 2**31
"""Number of observations at which t and n are halved: the largest number that the firmware can count."""
MIN_MEMORY = 64

B_HAT_MARGIN = 2.0**-20
"""b_hat stays in [2**-20, 1 - 2**-20]."""


class Observation(IntEnum):
    """Colour of the tile under the robot."""

    WHITE = 0
    BLACK = 1


class Filter(IntEnum):
    """Condition under which the filter, which runs every ``filter_period`` rounds, re-estimates b_hat."""

    ADAPTIVE = 0
    """The hypothesis test (eq. 12) rejects. This is the paper's filter, ASDF."""
    ALWAYS = 1
    """Every run re-estimates b_hat, without a test."""
    OFF = 2
    """No run re-estimates b_hat. This is collective perception without calibration."""
    ROBUST = 3
    """The robot's count of black tiles contradicts the latest estimates of its neighbours. This is this
    project's filter and not the paper's (``docs/internals/robust.md``)."""


class Status(IntEnum):
    """Result of a call, with the numbers of ``mcp_asdf_status_t`` in the C header.

    Zero and positive values mean success. Negative values are errors, after which nothing but the
    ``rejected`` counter has changed.
    """

    OK = 0
    REPEATED = 1
    """``receive`` ignored a message, because the round already has one of the same sender."""
    UPDATED = 2
    """``settle`` or ``step`` re-estimated b_hat."""
    ERR_CONFIG = -1
    """The filter, the filter period or the memory of the config is out of range."""
    ERR_TABLE = -2
    """The adaptive filter has no table, or one that is damaged."""
    ERR_ID = -3
    """The robot's own id is outside 0 .. 127."""
    ERR_B_HAT = -4
    """The initial b_hat is outside [2**-20, 1 - 2**-20]."""
    ERR_OBSERVATION = -5
    """An observation is neither white nor black."""
    ERR_SENDER = -6
    """The sender of a message is outside 0 .. 127, or is the receiver itself."""
    ERR_X_HAT = -7
    """The x_hat of a message is outside [0, 1]."""
    ERR_IMAGE = -8
    """An image is damaged, of another version or impossible with the config."""


class FirmwareError(ValueError):
    """The firmware refused to make or restore a robot, or rejected a message.

    Attributes:
        status: The firmware's error code.
    """

    def __init__(self, status: Status, message: str) -> None:
        """Create the error, whose text is the message with the status in parentheses."""
        super().__init__(f"{message} ({status.name})")
        self.status = status


@dataclass(frozen=True)
class Config:
    """Settings of the firmware, which all robots of a swarm may share.

    Attributes:
        table: Thresholds of the hypothesis test. May be None unless ``filter`` is ADAPTIVE.
        filter: Condition under which b_hat, the accuracy that a robot assumes of its sensor, is re-estimated.
        filter_period: Rounds from one run of the filter to the next, 1 .. 2**32 - 1. This is the paper's
            nominal filtering period tau divided by the period of broadcasts, which the caller keeps.
        memory: Number of observations at which t and n are halved, a multiple of 4 in 64 .. 2**31.
    """

    table: Table | None = None
    filter: Filter = Filter.ADAPTIVE
    filter_period: int = DEFAULT_FILTER_PERIOD
    memory: int = DEFAULT_MEMORY


@dataclass(frozen=True)
class Counters:
    """Numbers of events since the robot was made, modulo 2**16.

    Attributes:
        accepted: Messages that counted.
        repeated: Messages that were ignored, because their sender was in the round already.
        rejected: Messages with an invalid sender or estimate.
        tests: Hypothesis tests, of either outcome.
        updates: Re-estimates of b_hat.
    """

    accepted: int = 0
    repeated: int = 0
    rejected: int = 0
    tests: int = 0
    updates: int = 0


@dataclass
class Sums:
    """Exact sums over the estimates that a robot received in one round, as in ``mcp_asdf_open_t``.

    Each estimate is a pair of x_hat and its confidence alpha; those with alpha = 0 are left out. In all sums
    alpha is in units of 2**-24 and x_hat in units of 2**-23. The sum of alpha x_hat is kept in two halves,
    because it needs more than 64 bits in C.

    Attributes:
        alpha: Sum of alpha.
        alpha_x_low: Sum of (alpha mod 2**32) x_hat.
        alpha_x_high: Sum of (alpha div 2**32) x_hat.
        x_squared: Sum of the squares of x_hat.
        x: Sum of x_hat.
        count: Number of messages, m.
    """

    alpha: int = 0
    alpha_x_low: int = 0
    alpha_x_high: int = 0
    x_squared: int = 0
    x: int = 0
    count: int = 0


@runtime_checkable
class Robot(Protocol):
    """The firmware of one robot, with estimates and confidences as floats.

    Constructors take ``(config, robot_id, b_hat)``: a `Config`, an id in 0 .. 127 and the initial assumed
    accuracy in [2**-20, 1 - 2**-20]. They raise `FirmwareError`.

    Wherever an ``int`` is declared, any integer will do, also NumPy's, and any real number for a ``float``.
    """

    def observe(self, z: Observation) -> Status:
        """Count an observation, and compute x_hat and alpha from all observations so far. O(1).

        Returns OK; or ERR_OBSERVATION, and changes nothing, if ``z`` is neither WHITE nor BLACK.
        """

    def receive(self, sender: int, x_hat: float, alpha: float) -> Status:
        """Add a neighbour's estimate to the open round: what was received since the last ``settle``. O(1).

        Returns OK if the estimate was accepted; or REPEATED, and ignores it, if the round already has one of
        this sender. Raises FirmwareError, and counts the message as rejected, if ``sender`` is outside
        0 .. 127 or the robot's own id (ERR_SENDER), or ``x_hat`` is outside [0, 1] or NaN (ERR_X_HAT).
        Raises ValueError, and changes nothing, for an ``alpha`` that is no confidence: negative (also -0.0),
        infinite or NaN.
        """

    def settle(self) -> Status:
        """Close the open round, and run the filter if ``filter_period`` rounds have passed. O(1).

        With the robust filter one of the estimates that it keeps, or the robot's own, becomes a vote, which
        moves the robot's answer. Returns UPDATED if the filter has re-estimated b_hat, and OK otherwise.
        """

    def step(self, z: Observation) -> Status:
        """Observe ``z``, then settle.

        Returns UPDATED if the filter has run and re-estimated b_hat, and OK otherwise; or ERR_OBSERVATION,
        without settling, for an invalid ``z``.
        """

    @property
    def id(self) -> int:
        """Id of this robot."""

    @property
    def t(self) -> int:
        """Number of observations."""

    @property
    def n(self) -> int:
        """Number of black observations."""

    @property
    def b_hat(self) -> float:
        """Accuracy that this robot assumes of its sensor, in [2**-20, 1 - 2**-20]."""

    @property
    def x_hat(self) -> float:
        """Local estimate of the share of black tiles (eq. 3), in [0, 1]."""

    @property
    def alpha(self) -> float:
        """Confidence of the local estimate x_hat (eq. 4), >= 0."""

    @property
    def x_bar(self) -> float:
        """Social estimate (eq. 5): weighted mean of the x_hat of the last closed round; 1/2 if ``beta`` is 0.

        With the robust filter: the centre of the votes, or 1/2 before the first.
        """

    @property
    def beta(self) -> float:
        """Social confidence (eq. 6): sum of the alpha of the last closed round.

        It is 0 without messages, and always with the robust filter.
        """

    @property
    def x(self) -> float:
        """Informed estimate (eq. 7) of the present local estimate and the last closed round, in [0, 1].

        With the robust filter: the centre of the votes, or this robot's own x_hat before the first.
        """

    @property
    def counters(self) -> Counters:
        """Numbers of events since the robot was made."""


@runtime_checkable
class FixedPointRobot(Robot, Protocol):
    """A robot that computes in the firmware's fixed-point numbers; ``*_raw`` members are its integers."""

    def receive_raw(self, sender: int, x_hat: int, alpha: int) -> Status:
        """Add a neighbour's estimate to the open round; x_hat in units of 2**-23, alpha as an alpha word.

        An alpha word is 32 bits, a mantissa (bits 8 to 31) and a shift (bits 0 to 4), and stands for mantissa
        * 2**shift * 2**-24. Returns OK if the estimate was accepted, and REPEATED, which ignores it, if the
        round already has one of this sender.

        This is for programs that read a bus. They meet invalid messages all the time, so these are no
        exceptions here: where ``receive`` raises FirmwareError this returns ERR_SENDER or ERR_X_HAT, which
        the caller may count. Raises ValueError, and changes nothing, for an ``alpha`` that does not fit 32
        bits.
        """

    def receive_all(self, messages: NDArray[np.uint32]) -> int:
        """Receive messages in order, and return how many were accepted. O(messages).

        ``messages`` has shape (messages, 3), the columns sender, x_hat and alpha as in ``receive_raw``.
        Raises ValueError, and changes nothing, for an array of another type or shape, or one that is not
        C-contiguous.
        """

    def save(self) -> bytes:
        """Return the state as an image for ``restore``."""

    @classmethod
    def restore(cls, config: Config, image: bytes) -> FixedPointRobot:
        """Make a robot from an image of ``save``, whichever firmware saved it. O(q), to check the table.

        ``image`` may also be a bytearray or a memoryview; anything else raises TypeError. Raises
        FirmwareError for settings (ERR_CONFIG) or a table (ERR_TABLE) that the firmware would refuse, and for
        an image that is damaged, of another version or impossible with ``config`` (ERR_IMAGE).
        """

    def state(self) -> dict[str, int]:
        """Return every field of the state by name, to compare two firmwares bit for bit."""

    def holds_invariants(self) -> bool:
        """Return whether calls of this interface alone could have led to this state. O(1).

        False means that the state was damaged, for example in memory.
        """

    @property
    def b_hat_raw(self) -> int:
        """Accuracy that this robot assumes of its sensor, in units of 2**-32."""

    @property
    def x_hat_raw(self) -> int:
        """Local estimate in units of 2**-23."""

    @property
    def alpha_raw(self) -> int:
        """Local confidence as an alpha word: a mantissa (bits 8 to 31) and a shift (bits 0 to 4)."""

    @property
    def x_bar_raw(self) -> int:
        """Social estimate in units of 2**-23."""

    @property
    def beta_raw(self) -> int:
        """Social confidence in units of 2**-24."""

    @property
    def x_raw(self) -> int:
        """Informed estimate in units of 2**-23."""


def check_settings(config: Config) -> None:
    """Raise FirmwareError (ERR_CONFIG) for a filter, filter period or memory that the firmware would refuse.

    The memory must be a multiple of 4. The table is not checked here but in `check_table`.
    """
    period = config.filter_period
    memory = config.memory
    if config.filter not in tuple(Filter):
        raise FirmwareError(Status.ERR_CONFIG, f"filter is {config.filter}; choose a Filter")
    if not 1 <= period <= MAX_FILTER_PERIOD:
        raise FirmwareError(
            Status.ERR_CONFIG, f"filter_period is {period} rounds; choose 1 .. {MAX_FILTER_PERIOD}"
        )
    is_memory_in_range = MIN_MEMORY <= memory <= DEFAULT_MEMORY
    # Half of a multiple of 4 is even, so that exchanged colours stay mirror images when t is halved.
    if not is_memory_in_range or memory % 4 != 0:
        raise FirmwareError(
            Status.ERR_CONFIG,
            f"memory is {memory}; choose a multiple of 4, {MIN_MEMORY} .. {DEFAULT_MEMORY}",
        )


def check_table(table: Table | None) -> Table:
    """Return the table of the test's thresholds if the firmware would accept it.

    Raises FirmwareError (ERR_TABLE) if it would not: for None, and for a table with a q, omega or threshold
    that no t-table has (see ``Table.from_words``).
    """
    if table is None:
        raise FirmwareError(
            Status.ERR_TABLE, "the adaptive filter needs a table; make one with mcp-asdf table"
        )
    # ``Table(...)`` takes any numbers and checks none; only ``from_words`` checks what the firmware would.
    try:
        return Table.from_words(table.words())
    except TableError as error:
        raise FirmwareError(Status.ERR_TABLE, str(error)) from error


def check_id_and_b_hat(robot_id: int, b_hat: float) -> None:
    """Raise FirmwareError for an id (ERR_ID) or an initial accuracy (ERR_B_HAT) that is out of range.

    Ids are 0 .. 127, and b_hat is in [2**-20, 1 - 2**-20].
    """
    if not 0 <= robot_id <= MAX_ID:
        raise FirmwareError(Status.ERR_ID, f"robot id is {robot_id}; choose 0 .. {MAX_ID}")
    if not B_HAT_MARGIN <= b_hat <= 1 - B_HAT_MARGIN:
        raise FirmwareError(Status.ERR_B_HAT, f"b_hat is {b_hat}; choose one in [2**-20, 1 - 2**-20]")


def check_alpha(alpha: float) -> None:
    """Raise ValueError for an alpha that is no confidence: a negative number, -0.0, infinity or NaN."""
    is_in_range = 0 <= alpha < math.inf  # False for NaN, but True for -0.0
    has_minus_sign = math.copysign(1, alpha) < 0
    if not is_in_range or has_minus_sign:
        raise ValueError(f"alpha is {alpha}; a confidence is finite, not negative and not -0.0")


def create_rejection(status: Status, sender: int, x_hat: float) -> FirmwareError:
    """Return the exception for a message that was rejected with ``status``, ERR_SENDER or ERR_X_HAT.

    Its text names the wrong value, and what is allowed. The wrong value is the sender for ERR_SENDER, and
    else x_hat.
    """
    if status == Status.ERR_SENDER:
        return FirmwareError(
            status, f"sender is {sender}; it must be 0 .. {MAX_ID} and not the receiver's own id"
        )
    return FirmwareError(status, f"x_hat is {x_hat}; it must be in [0, 1]")


def describe_robot(robot: Robot) -> str:
    """Return a robot's class, id, observations and estimates in one line, for ``repr``.

    For example ``<MirrorRobot 3: t=20 n=5 b_hat=0.9 x_hat=0.1875 alpha=68.2667 x=0.2>``.
    """
    values = (f"{name}={getattr(robot, name):.6g}" for name in ("b_hat", "x_hat", "alpha", "x"))
    return f"<{type(robot).__name__} {robot.id}: t={robot.t} n={robot.n} {' '.join(values)}>"
