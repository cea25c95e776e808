"""The firmware in plain Python integers: the same bits as ``c_ref/src/mcp_asdf.c`` after every call.

Read it beside the C, function by function; where the C needs several words or an estimate to stay small,
the exact quotient stands here, so agreement of the two proves the C's shortcuts. Rounding is always down
unless a comment says otherwise. The rules are those of ``docs/design.md``; "eq." means an equation of the
paper. Only operators of ``int`` and ``bit_length`` are used, so that counting integers can run this code.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, field, fields

from firmware_py.fixed_point import (
    ALPHA_INFINITE,
    ALPHA_MAX,
    B_HAT_MAX,
    B_HAT_MIN,
    HALF,
    ONE,
    FixedPointView,
    b_hat_to_raw,
)
from firmware_py.robot import (
    MAX_ID,
    Config,
    Counters,
    Filter,
    FirmwareError,
    Observation,
    Status,
    Sums,
    check_identity,
    check_periods,
    check_table,
    whole_number,
)
from firmware_py.table import Table, checksum

UNINFORMATIVE = 255
MASK_32 = 0xFFFFFFFF
INFORMATIVE_G = 1 << 20
FRACTION_BITS = 0x007FFFFF
IMPLICIT_BIT = 0x00800000
UNIT_EXPONENT = 126
SHIFT_MAX = 31
COUNTER_MAX = 0xFFFF
IMAGE_MAGIC = 0x4D435301
IMAGE_WORDS = 34


@dataclass(frozen=True)
class Accuracy:
    """What depends on b_hat alone; see ``mcp_asdf_accuracy_t``."""

    c: int
    inverse_g: int = 0
    g_squared: int = 0
    edge: int = 0
    odds: int = 0
    g_shift: int = UNINFORMATIVE
    g_squared_shift: int = 0
    edge_shift: int = 0
    odds_left: int = 0
    odds_right: int = 0
    inverted: int = 0


def leading_zeros(value: int) -> int:
    """Leading zeros of 0 < value < 2**32."""
    return 32 - value.bit_length()


def square_of_ratio(a: int, k: int) -> tuple[int, int]:
    """Mantissa and shift of (a / k)**2 = mantissa / 2**(30 + shift); a, k and mantissa in [2**31, 2**32)."""
    quotient = ((a >> 1) << 24) // (k >> 1) << 7
    shift = leading_zeros(quotient)
    square = (quotient << shift) ** 2 >> 32
    shift2 = leading_zeros(square)
    return square << shift2, 2 * shift + shift2


def accuracy_of(b_hat: int) -> Accuracy:
    """Form the cache for ``b_hat`` in units of 2**-32."""
    inverted = int(b_hat < 1 << 31)
    c = b_hat if inverted else (1 << 32) - b_hat
    g = (1 << 32) - 2 * c
    if g < INFORMATIVE_G:
        return Accuracy(c=MASK_32, inverted=inverted)
    g_shift = leading_zeros(g)
    mantissa = g << g_shift
    square = mantissa * mantissa >> 32
    square_shift = leading_zeros(square)
    rest = (1 << 32) - c
    edge, edge_shift = square_of_ratio(mantissa, rest)
    c_shift = leading_zeros(c)
    odds, odds_shift = square_of_ratio(rest, c << c_shift)
    odds_exponent = 2 * c_shift - 30 - odds_shift
    return Accuracy(
        c=c,
        inverse_g=(1 << 62) // mantissa + 1,
        g_squared=square << square_shift,
        edge=edge,
        odds=odds,
        g_shift=g_shift,
        g_squared_shift=2 * g_shift + square_shift,
        edge_shift=2 * g_shift + edge_shift - 2,
        odds_left=max(odds_exponent, 0),
        odds_right=max(-odds_exponent, 0),
        inverted=inverted,
    )


def alpha_bits(mantissa: int, exponent: int) -> int:
    """Bits of the largest alpha on the grid not above ``mantissa * 2**exponent`` units."""
    if mantissa < IMPLICIT_BIT:
        mantissa, exponent = mantissa << 1, exponent - 1
    elif mantissa >> 24:
        mantissa, exponent = mantissa >> 1, exponent + 1
    if exponent > SHIFT_MAX:
        return ALPHA_MAX
    if exponent < 0:
        mantissa = mantissa >> -exponent << -exponent
    return (exponent + UNIT_EXPONENT - 1 << 23) + mantissa


def alpha_units(alpha: int) -> int:
    """Units of any binary32 number >= 0, rounded down to the grid and cut to its largest value."""
    mantissa = (alpha & FRACTION_BITS) | IMPLICIT_BIT
    shift = (alpha >> 23) - UNIT_EXPONENT
    if shift > SHIFT_MAX:
        return 0xFFFFFF << SHIFT_MAX
    if shift >= 0:
        return mantissa << shift
    return mantissa >> -shift if shift >= -23 else 0  # subnormal numbers lose everything, too


def sums_add(sums: Sums, x_hat: int, alpha: int) -> bool:
    """Add one message; False where its alpha is 0 on the grid."""
    units = alpha_units(alpha)
    if units == 0:
        return False
    sums.alpha += units
    sums.alpha_x_low += (units & MASK_32) * x_hat
    sums.alpha_x_high += (units >> 32) * x_hat
    sums.x_squared += x_hat * x_hat
    sums.x += x_hat
    sums.count += 1
    return True


def mean(alpha: int, alpha_x_low: int, alpha_x_high: int) -> int:
    """floor(sum of alpha x_hat / sum of alpha), the exact quotient."""
    return ((alpha_x_high << 32) + alpha_x_low) // alpha


def confidence_at_end(accuracy: Accuracy, part: int, rest: int) -> tuple[int, int]:
    """Mantissa and exponent of (g / (1 - c))**2 (rest + ((1 - c) / c)**2 part): eq. 4, first two cases."""
    total = ((part << accuracy.odds_left) * accuracy.odds >> accuracy.odds_right) + rest
    exponent = total.bit_length() - 32
    mantissa = total >> exponent if exponent > 0 else total << -exponent
    return mantissa * accuracy.edge >> 40, exponent - accuracy.edge_shift


def confidence_inside(accuracy: Accuracy, nu: int, total: int) -> tuple[int, int]:
    """Mantissa and exponent of g**2 total / (nu (1 - nu)): eq. 4, last case."""
    spread = nu * ((1 << 32) - nu) >> 32
    shift = leading_zeros(spread) - 1
    scale = total * accuracy.g_squared >> 32
    return (scale << 24) // (spread << shift), shift - accuracy.g_squared_shift


def estimate(t: int, n: int, accuracy: Accuracy) -> tuple[int, int]:
    """x_hat (eq. 3) and the bits of alpha (eq. 4) for t > 0."""
    shift = leading_zeros(t)
    total = t << shift >> 1
    part = min(n, t - n) << shift >> 1
    x_hat = 0
    nu = (part << 32) // total
    if nu <= accuracy.c:
        if accuracy.g_shift == UNINFORMATIVE:
            return HALF, 0
        mantissa, exponent = confidence_at_end(accuracy, part, total - part)
    else:
        x_hat = (nu - accuracy.c << accuracy.g_shift) * accuracy.inverse_g >> 39
        mantissa, exponent = confidence_inside(accuracy, nu, total)
    mirrored = (n < t - n) == (accuracy.inverted != 0)
    return ONE - x_hat if mirrored else x_hat, alpha_bits(mantissa, exponent + 33 - shift)


def rejects(table: Table, open_round: Sums, x_hat: int) -> bool:
    """Eq. 12 on the m >= 2 messages of a round."""
    m = open_round.count
    difference = open_round.x - m * x_hat
    spread = m * open_round.x_squared - open_round.x * open_round.x
    return difference * difference > table.entry(m) * spread >> table.fraction_bits


def upper_quotient(numerator: int, denominator: int) -> int:
    """2**32 numerator / denominator from the upper 31 bits of both, the denominator's rounded up."""
    shift = denominator.bit_length() - 31
    if shift < 0:
        return (numerator << 32 - shift) // ((denominator << -shift) + 1)
    return (numerator >> shift << 32) // ((denominator >> shift) + 1)


def reestimate(t: int, n: int, x_bar: int) -> int | None:
    """b_hat from x_bar (eq. 8); None where x_bar = 1/2."""
    if x_bar == HALF:
        return None
    inverted = x_bar < HALF
    rest = x_bar if inverted else ONE - x_bar
    whole, offset = (t - n if inverted else n) * ONE, t * rest
    denominator = t * (ONE - 2 * rest)
    if whole <= offset:
        return B_HAT_MIN
    if whole - offset >= denominator:
        return B_HAT_MAX
    return min(max(upper_quotient(whole - offset, denominator), B_HAT_MIN), B_HAT_MAX)


def mean_possible(alpha: int, alpha_x_low: int, alpha_x_high: int) -> bool:
    """Whether sums of alpha and of alpha x_hat are in range and give a mean of at most 1."""
    return (
        alpha <= MAX_ID * 0xFFFFFF << SHIFT_MAX
        and 0 <= alpha_x_low < 1 << 62
        and 0 <= alpha_x_high < 1 << 53
        and (alpha_x_high << 32) + alpha_x_low <= alpha * ONE
    )


def sums_possible(sums: Sums) -> bool:
    """Whether ``count`` messages can have given these sums."""
    return (
        0 <= sums.count <= MAX_ID
        and 0 <= sums.x <= sums.count * ONE
        and 0 <= sums.x_squared <= sums.x * ONE
        and sums.count * sums.x_squared >= sums.x * sums.x
        and sums.count <= sums.alpha <= sums.count * 0xFFFFFF << SHIFT_MAX
        and sums.alpha_x_low <= sums.x * MASK_32
        and sums.alpha_x_high <= sums.x * 0x7FFFFF
        and mean_possible(sums.alpha, sums.alpha_x_low, sums.alpha_x_high)
    )


def estimate_possible(x_hat: int, alpha: int) -> bool:
    """x_hat <= 1; alpha on its grid; no confidence only with x_hat = 1/2."""
    if alpha == 0:
        return x_hat == HALF
    lost = max(UNIT_EXPONENT - (alpha >> 23), 0)
    return x_hat <= ONE and alpha <= ALPHA_MAX and lost <= 23 and alpha & (1 << lost) - 1 == 0


def check_config(config: Config) -> None:
    """Raises FirmwareError where ``mcp_asdf_init`` fails with ERR_CONFIG or ERR_TABLE."""
    check_periods(config)
    if config.filter == Filter.ADAPTIVE:
        check_table(config.table)


@dataclass
class State:
    """The members of ``mcp_asdf_t``, by the same names."""

    id: int
    b_hat: int
    accuracy: Accuracy
    comms_left: int
    filter_left: int
    t: int = 0
    n: int = 0
    x_hat: int = HALF
    alpha: int = 0
    settled_x_hat: int = HALF
    settled_alpha: int = 0
    closed_alpha: int = 0
    closed_alpha_x_low: int = 0
    closed_alpha_x_high: int = 0
    open: Sums = field(default_factory=Sums)
    heard: list[int] = field(default_factory=lambda: [0, 0, 0, 0])
    accepted: int = 0
    repeated: int = 0
    rejected: int = 0
    tests: int = 0
    updates: int = 0
    silent: int = 0


class MirrorRobot(FixedPointView):
    """MCP-ASDF in Python integers. Implements ``FixedPointRobot``.

    Args:
        config: Shared settings.
        robot_id: Own id, 0..127.
        b_hat: Initial assumed accuracy, rounded to a multiple of 2**-32.

    Raises:
        FirmwareError: As ``mcp_asdf_init`` fails.
    """

    def __init__(self, config: Config, robot_id: int, b_hat: float) -> None:
        check_config(config)
        check_identity(robot_id, b_hat)
        own_id, raw = whole_number(robot_id), b_hat_to_raw(b_hat)
        self.config = config
        self.s = State(own_id, raw, accuracy_of(raw), config.comms_period, config.filter_period)

    def observe(self, z: Observation) -> Status:
        """Count an observation and estimate; DUE when (x_hat, alpha) is to be broadcast."""
        s, seen = self.s, whole_number(z)
        if seen not in (0, 1, 2):
            return Status.ERR_OBSERVATION
        if seen != Observation.NONE:
            s.t += 1
            s.n += seen
            if s.t == self.config.memory:
                half = s.n >> 1
                s.t, s.n = s.t >> 1, half + (half & s.n & 1)  # to nearest, ties to even
            s.x_hat, s.alpha = estimate(s.t, s.n, s.accuracy)
        if s.comms_left != 0:  # 0 if a round was not settled: it is still due
            s.comms_left -= 1
        return Status.DUE if s.comms_left == 0 else Status.OK

    def _receive(self, sender: int, x_hat: int, alpha: int) -> Status:
        s = self.s
        status = self._check_message(sender, x_hat, alpha)
        word, bit = sender >> 5, 1 << (sender & 31)
        if status == Status.OK:
            if s.heard[word] & bit:
                s.repeated = min(s.repeated + 1, COUNTER_MAX)
                return Status.REPEATED
            if s.open.count >= MAX_ID:  # add_round has filled the round
                status = Status.ERR_SUMS
        if status != Status.OK:
            s.rejected = min(s.rejected + 1, COUNTER_MAX)
            return status
        s.heard[word] |= bit
        if not sums_add(s.open, x_hat, alpha):
            s.silent += 1
        return Status.OK

    def _check_message(self, sender: int, x_hat: int, alpha: int) -> Status:
        if not 0 <= sender <= MAX_ID or sender == self.s.id:
            return Status.ERR_SENDER
        if not 0 <= x_hat <= ONE:
            return Status.ERR_X_HAT
        return Status.OK if 0 <= alpha < ALPHA_INFINITE else Status.ERR_ALPHA

    def _add_round(self, sums: Sums, messages: int) -> Status:
        s = self.s
        silent = s.silent + messages - sums.count
        if (
            not sums_possible(sums)
            or sums.count > messages
            or s.open.count + sums.count > MAX_ID
            or silent > MAX_ID
        ):
            return Status.ERR_SUMS
        for name in (member.name for member in fields(Sums)):
            setattr(s.open, name, getattr(s.open, name) + getattr(sums, name))
        s.silent = silent
        return Status.OK

    def settle(self) -> Status:
        """Close the round if a broadcast was due, and filter when the time has come."""
        s = self.s
        s.settled_x_hat, s.settled_alpha = s.x_hat, s.alpha
        return Status.UPDATED if s.comms_left == 0 and self._close_round() else Status.OK

    def step(self, z: Observation) -> Status:
        """``observe(z)`` then ``settle()``; returns what ``observe`` returned."""
        status = self.observe(z)
        if status >= Status.OK:
            self.settle()
        return status

    def _close_round(self) -> bool:
        s, updated = self.s, False
        s.closed_alpha = s.open.alpha
        s.closed_alpha_x_low = s.open.alpha_x_low
        s.closed_alpha_x_high = s.open.alpha_x_high
        s.accepted = min(s.accepted + s.open.count + s.silent, COUNTER_MAX)
        s.filter_left -= self.config.comms_period
        if s.filter_left == 0:
            s.filter_left = self.config.filter_period
            updated = self._filter()
        s.open, s.heard, s.silent = Sums(), [0, 0, 0, 0], 0
        s.comms_left = self.config.comms_period
        return updated

    def _filter(self) -> bool:
        s, config = self.s, self.config
        if config.filter == Filter.OFF or s.t == 0:
            return False
        if config.filter == Filter.ADAPTIVE:
            if s.open.count < 2:
                return False
            s.tests = min(s.tests + 1, COUNTER_MAX)
            assert config.table is not None
            if not rejects(config.table, s.open, s.x_hat):
                return False
        b_hat = reestimate(s.t, s.n, self.x_bar_raw)
        if b_hat is None:
            return False
        s.b_hat, s.accuracy = b_hat, accuracy_of(b_hat)
        s.updates = min(s.updates + 1, COUNTER_MAX)
        return True

    @property
    def t(self) -> int:
        """Observations counted."""
        return self.s.t

    @property
    def n(self) -> int:
        """Black ones among them."""
        return self.s.n

    @property
    def b_hat_raw(self) -> int:
        """b_hat in units of 2**-32."""
        return self.s.b_hat

    @property
    def x_hat_raw(self) -> int:
        """x_hat in units of 2**-23."""
        return self.s.x_hat

    @property
    def alpha_raw(self) -> int:
        """alpha as binary32 bits."""
        return self.s.alpha

    @property
    def beta_raw(self) -> int:
        """beta in units of 2**-24."""
        return self.s.closed_alpha

    @property
    def x_bar_raw(self) -> int:
        """x_bar in units of 2**-23; HALF where beta is 0."""
        s = self.s
        return mean(s.closed_alpha, s.closed_alpha_x_low, s.closed_alpha_x_high) if s.closed_alpha else HALF

    @property
    def x_raw(self) -> int:
        """x in units of 2**-23."""
        s = self.s
        own = alpha_units(s.settled_alpha)
        if s.closed_alpha + own == 0:
            return s.settled_x_hat
        low, high = (own & MASK_32) * s.settled_x_hat, (own >> 32) * s.settled_x_hat
        return mean(s.closed_alpha + own, s.closed_alpha_x_low + low, s.closed_alpha_x_high + high)

    @property
    def counters(self) -> Counters:
        """Diagnostics, the open round's messages included."""
        s = self.s
        accepted = min(s.accepted + s.open.count + s.silent, COUNTER_MAX)
        return Counters(accepted, s.repeated, s.rejected, s.tests, s.updates)

    def state(self) -> dict[str, int]:
        """Every member of the state by name; nested ones as ``open_alpha``, ``accuracy_c``, ``heard_0``."""
        flat: dict[str, int] = {}
        for member in fields(State):
            value = getattr(self.s, member.name)
            if isinstance(value, (Sums, Accuracy)):
                flat.update({f"{member.name}_{m.name}": getattr(value, m.name) for m in fields(value)})
            elif isinstance(value, list):
                flat.update({f"{member.name}_{i}": word for i, word in enumerate(value)})
            else:
                flat[member.name] = value
        return flat

    def holds_invariants(self) -> bool:
        """Whether the state could have come from calls alone (``docs/invariants.md``)."""
        s, config = self.s, self.config
        return (
            s.id <= MAX_ID
            and s.t < config.memory
            and s.n <= s.t
            and B_HAT_MIN <= s.b_hat <= B_HAT_MAX
            and s.accuracy == accuracy_of(s.b_hat)
            and estimate_possible(s.x_hat, s.alpha)
            and estimate_possible(s.settled_x_hat, s.settled_alpha)
            and mean_possible(s.closed_alpha, s.closed_alpha_x_low, s.closed_alpha_x_high)
            and sums_possible(s.open)
            and self._senders_possible()
            and s.comms_left <= config.comms_period
            and 1 <= s.filter_left <= config.filter_period
            and s.filter_left % config.comms_period == 0
        )

    def _senders_possible(self) -> bool:
        s = self.s
        messages = s.open.count + s.silent
        heard = sum(word.bit_count() for word in s.heard)
        return s.silent <= MAX_ID + heard and heard <= messages and s.heard[s.id >> 5] >> (s.id & 31) & 1 == 0

    def save(self) -> bytes:
        """The state as ``mcp_asdf_save`` writes it: little-endian words, the last a checksum."""
        s, words = self.s, [IMAGE_MAGIC]
        words += [s.t, s.n, s.b_hat, s.x_hat, s.alpha, s.settled_x_hat, s.settled_alpha]
        doubles = [s.closed_alpha, s.closed_alpha_x_low, s.closed_alpha_x_high]
        doubles += [s.open.alpha, s.open.alpha_x_low, s.open.alpha_x_high, s.open.x_squared]
        for value in doubles:
            words += [value & MASK_32, value >> 32]
        words += [s.open.x, s.open.count, *s.heard, s.comms_left, s.filter_left]
        words += [s.repeated << 16 | s.accepted, s.tests << 16 | s.rejected]
        words += [s.updates | s.silent << 16 | s.id << 24]
        return struct.pack(f"<{IMAGE_WORDS}I", *words, checksum(words))

    @classmethod
    def restore(cls, config: Config, image: bytes) -> MirrorRobot:
        """A robot from ``save``'s image. Raises FirmwareError as ``mcp_asdf_restore`` fails."""
        plain = bytes(memoryview(image))
        check_config(config)
        words = struct.unpack(f"<{IMAGE_WORDS}I", plain) if len(plain) == 4 * IMAGE_WORDS else (0,)
        if words[0] != IMAGE_MAGIC or checksum(words[:-1]) != words[-1]:
            raise FirmwareError(Status.ERR_IMAGE, "the image is damaged or of another version")
        robot = cls.__new__(cls)
        robot.config = config
        if not B_HAT_MIN <= words[3] <= B_HAT_MAX:
            raise FirmwareError(Status.ERR_IMAGE, f"b_hat = {words[3]} is out of range")
        robot.s = _state_from(words)
        if not robot.holds_invariants():
            raise FirmwareError(Status.ERR_IMAGE, "the image does not fit the configuration")
        return robot


def _state_from(words: tuple[int, ...]) -> State:
    doubles = [low | high << 32 for low, high in zip(words[8:22:2], words[9:22:2], strict=True)]
    return State(
        t=words[1],
        n=words[2],
        b_hat=words[3],
        accuracy=accuracy_of(words[3]),
        x_hat=words[4],
        alpha=words[5],
        settled_x_hat=words[6],
        settled_alpha=words[7],
        closed_alpha=doubles[0],
        closed_alpha_x_low=doubles[1],
        closed_alpha_x_high=doubles[2],
        open=Sums(doubles[3], doubles[4], doubles[5], doubles[6], words[22], words[23]),
        heard=list(words[24:28]),
        comms_left=words[28],
        filter_left=words[29],
        accepted=words[30] & COUNTER_MAX,
        repeated=words[30] >> 16,
        rejected=words[31] & COUNTER_MAX,
        tests=words[31] >> 16,
        updates=words[32] & COUNTER_MAX,
        silent=words[32] >> 16 & 0xFF,
        id=words[32] >> 24,
    )
