"""The firmware in plain Python integers: the same bits as ``c_ref/src/mcp_asdf.c`` after every call.

Read it next to the C, function by function; where the C needs several words or an estimated digit, the exact
quotient stands here, so agreement of the two proves the C's shortcuts. Rounding is always down unless a
comment says otherwise. The rules are those of ``docs/design.md``; "eq." means an equation of the paper.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, field, fields
from operator import index

from mcp_asdf.fixed_point import (
    ALPHA_MAX,
    B_HAT_MAX,
    B_HAT_MIN,
    HALF,
    ONE,
    SHIFT_MAX,
    FixedPointView,
    alpha_units,
    b_hat_to_raw,
    mean_possible,
    sums_add,
    sums_possible,
)
from mcp_asdf.robot import (
    MAX_ID,
    Config,
    Counters,
    Filter,
    FirmwareError,
    Observation,
    Status,
    Sums,
    check_identity,
    check_settings,
    check_table,
    reading,
)
from mcp_asdf.table import FRACTION_BITS, MAX_WORD, Table, checksum

INFORMATIVE_G = 1 << 20
SPREAD_LEAST, SPREAD_START = 1 << 18, 1 << 28
VOTES_MOST, VOTES_MOVED = 1 << 14, 1 << 8
TREND_SHIFT, TREND_EVEN, TREND_UP, MAX_TREND = 8, 1 << 7, 0xFF, 0xFFFF
SIGMAS_SQUARED = 12
COUNTER_MASK = 0xFFFF
IMAGE_MAGIC = 0x4D435302
ROBUST_IMAGE = 1 << 7
IMAGE_WORDS = 31


@dataclass(frozen=True)
class Accuracy:
    """b_hat and what follows from it alone; see ``mcp_asdf_accuracy_t``."""

    b_hat: int
    c: int
    common: int
    rare: int
    g_shift: int
    rare_shift: int


def leading_zeros(value: int) -> int:
    """Leading zeros of 0 < value < 2**32; 31 for 0."""
    return 32 - max(value.bit_length(), 1)


def square_of_ratio(g: int, p: int) -> int:
    """(g / p)**2 in units of 2**-30; g and p in [2**31, 2**32)."""
    ratio = ((g >> 1) << 24) // (p >> 1) << 7
    return ratio * ratio >> 32


def accuracy_of(b_hat: int) -> Accuracy:
    """Values derived from ``b_hat`` in units of 2**-32."""
    c = min(b_hat, (1 << 32) - b_hat)
    g = (1 << 32) - 2 * c
    g_shift, c_shift = leading_zeros(g), leading_zeros(c)
    return Accuracy(
        b_hat=b_hat,
        c=MAX_WORD if g < INFORMATIVE_G else c,
        common=square_of_ratio(g << g_shift, (1 << 32) - c),
        rare=square_of_ratio(g << g_shift, c << c_shift),
        g_shift=g_shift,
        rare_shift=2 * c_shift,
    )


def alpha_word(mantissa: int, exponent: int) -> int:
    """The word of the largest alpha not above mantissa 2**exponent units, mantissa in [2**23, 2**24)."""
    if exponent > SHIFT_MAX:
        return ALPHA_MAX
    if exponent < 0:
        mantissa, exponent = mantissa >> -exponent, 0
    return mantissa << 8 | exponent


def confidence_at_end(accuracy: Accuracy, t: int, part: int) -> tuple[int, int]:
    """Mantissa and exponent of part (g / c)**2 + (t - part) (g / (1 - c))**2: eq. 4, first two cases."""
    total, exponent = (t - part) * accuracy.common, 24 - 30 - 2 * accuracy.g_shift
    if part != 0:
        total = part * accuracy.rare + (total >> accuracy.rare_shift)
        exponent += accuracy.rare_shift
    shift = total.bit_length() - 24
    return total >> shift, exponent + shift


def confidence_inside(accuracy: Accuracy, total: int, rarer: int, scale: int, shift: int) -> tuple[int, int]:
    """Mantissa and exponent of (g total)**2 t / (rarer (total - rarer)): eq. 4, last case."""
    square, spread = (scale * scale >> 32) * total >> 32, rarer * (total - rarer)
    square_shift, spread_shift = leading_zeros(square), 64 - spread.bit_length()
    mantissa = ((square << square_shift >> 1) << 24) // (spread << spread_shift >> 33)
    exponent = 32 + spread_shift - square_shift - 2 * accuracy.g_shift - shift
    excess = mantissa >> 24
    return mantissa >> excess, exponent + excess


def estimate(t: int, n: int, accuracy: Accuracy) -> tuple[int, int]:
    """x_hat (eq. 3) and the word of alpha (eq. 4) for t > 0, from the rarer colour."""
    part, shift = min(n, t - n), leading_zeros(t)
    total, rarer = t << shift, part << shift
    least = accuracy.c * total >> 32
    x_hat = 0
    if rarer <= least:
        if accuracy.c == MAX_WORD:
            return HALF, 0
        mantissa, exponent = confidence_at_end(accuracy, t, part)
    else:
        scale = total - 2 * least << accuracy.g_shift
        x_hat = (rarer - least << accuracy.g_shift + 22) // (scale >> 1)
        mantissa, exponent = confidence_inside(accuracy, total, rarer, scale, shift)
    mirrored = (n < t - n) == (accuracy.b_hat < 1 << 31)
    return ONE - x_hat if mirrored else x_hat, alpha_word(mantissa, exponent)


def informed_estimate(closed: Closed, x_hat: int, alpha: int) -> int:
    """Eq. 7 in units of 2**-23, the exact quotient; x_hat where there is no confidence at all."""
    own = alpha_units(alpha)
    if closed.alpha + own == 0:
        return x_hat
    return (closed.alpha_x() + own * x_hat) // (closed.alpha + own)


def rejects(table: Table, open_round: Sums, x_hat: int) -> bool:
    """Eq. 12 on the m >= 2 messages of a round."""
    m = open_round.count
    difference = open_round.x - m * x_hat
    spread = m * open_round.x_squared - open_round.x * open_round.x
    return difference * difference > table.entry(m) * spread >> FRACTION_BITS


def upper_quotient(numerator: int, denominator: int) -> int:
    """A quotient in units of 2**-32, from the upper 32 bits of the denominator and those of the numerator in
    the same places. The denominator's are rounded up to an even number."""
    shift = denominator.bit_length() - 32
    if shift < 0:
        numerator, denominator, shift = numerator << 32, denominator << 32, shift + 32
    return ((numerator >> shift) << 31) // ((denominator >> shift + 1) + 1)


def reestimate(t: int, n: int, closed: Closed) -> int | None:
    """b_hat from x_bar (eq. 8); None where x_bar is uninformative."""
    return b_hat_from(t, n, upper_quotient(closed.alpha_x(), closed.alpha * ONE))


def b_hat_from(t: int, n: int, x_bar: int) -> int | None:
    """The same for a fill ratio in units of 2**-32."""
    if x_bar < 1 << 31:
        x_bar, n = MAX_WORD - x_bar, t - n  # the colours exchanged
    g = 2 * x_bar - (1 << 32)
    if g < INFORMATIVE_G:
        return None
    b_hat = upper_quotient((n << 32) - t * ((1 << 32) - x_bar), t * g)  # may be below 0 or above 1
    return min(max(b_hat, B_HAT_MIN), B_HAT_MAX)


def vote(crowd: Crowd, sender: int, x_hat: int) -> None:
    """A message to a robot with the robust filter moves the crowd's centre towards x_hat, and its spread."""
    said = x_hat << 7
    is_above = said > crowd.centre
    distance = said - crowd.centre if is_above else crowd.centre - said
    crowd.votes = min(crowd.votes + 1, VOTES_MOST)
    shift = max(crowd.votes.bit_length() - 3, 3)
    step = min(distance, crowd.spread) >> shift
    change = crowd.spread >> shift + 1
    crowd.trend -= crowd.trend >> TREND_SHIFT
    if step == 0:
        crowd.trend += TREND_EVEN
    elif is_above:
        crowd.trend += TREND_UP
    crowd.voices |= 1 << (sender & 31)
    crowd.centre += step if is_above else -step
    spread = crowd.spread + (change if distance > crowd.spread else -change)
    crowd.spread = min(max(spread, SPREAD_LEAST), SPREAD_START)


def crowd_mean(crowd: Crowd) -> int:
    """The centre in units of 2**-32, 1 as the largest word."""
    return min(crowd.centre << 2, MAX_WORD)


def deviates(crowd: Crowd, t: int, n: int) -> bool:
    """The robust filter's test of n black tiles of t > 0 against the first b_hat and the crowd."""
    r, b_hat = crowd_mean(crowd), crowd.first
    p = (b_hat * r >> 32) + ((MAX_WORD - b_hat) * (MAX_WORD - r) >> 32)
    seen = upper_quotient(n, t)
    variance = max((1 << 32) * value - value * value >> 32 for value in (seen, p))
    g = (1 << 32) - 2 * min(b_hat, (1 << 32) - b_hat)
    g_spread = g * (crowd.spread << 2) >> 32
    square, least = (seen - p) * (seen - p), SIGMAS_SQUARED * (g_spread * g_spread)
    return square > least and t * (square - least) >> 32 > SIGMAS_SQUARED * variance


def estimate_possible(s: State) -> bool:
    """True if t, n and b_hat give x_hat and alpha or, if b_hat was updated since, another one may have."""
    if s.updated:
        is_canonical = s.alpha & 0xE0 == 0 and (s.alpha >> 31 == 1 or s.alpha & SHIFT_MAX == 0)
        return s.updated == 1 and s.t > 0 and s.x_hat <= ONE and is_canonical
    return (s.x_hat, s.alpha) == (estimate(s.t, s.n, s.accuracy) if s.t else (HALF, 0))


def check_config(config: Config) -> None:
    """Raises FirmwareError where ``mcp_asdf_init`` fails with ERR_CONFIG or ERR_TABLE."""
    check_settings(config)
    if config.filter == Filter.ADAPTIVE:
        check_table(config.table)


@dataclass
class Closed:
    """Sums of the last closed round; see ``mcp_asdf_closed_t``."""

    alpha: int = 0
    alpha_x_low: int = 0
    alpha_x_high: int = 0

    def alpha_x(self) -> int:
        """The sum of alpha x_hat."""
        return (self.alpha_x_high << 32) + self.alpha_x_low


@dataclass
class Crowd:
    """What the robust filter knows of the others; see ``mcp_asdf_crowd_t``."""

    centre: int = 1 << 29
    spread: int = SPREAD_START
    voices: int = 0
    first: int = 0
    votes: int = 0
    trend: int = 1 << 15

    @property
    def is_moving(self) -> bool:
        """True if more than 7 of 8 late moves of the centre went one way."""
        return not 1 << 13 <= self.trend < 7 << 13

    def is_possible(self, b_hat: int) -> bool:
        """True if votes can have made it so, where the robust filter runs and b_hat is ``b_hat`` now."""
        if self.votes == 0:
            return self == Crowd(first=b_hat)
        return (
            self.centre <= ONE << 7
            and SPREAD_LEAST <= self.spread <= SPREAD_START
            and self.voices != 0
            and B_HAT_MIN <= self.first <= B_HAT_MAX
            and self.votes <= VOTES_MOST
        )


@dataclass
class State:
    """The members of ``mcp_asdf_t``, by the same names."""

    id: int
    accuracy: Accuracy
    filter_left: int
    t: int = 0
    n: int = 0
    x_hat: int = HALF
    alpha: int = 0
    heard: list[int] = field(default_factory=lambda: [0, 0, 0, 0])
    crowd: Crowd = field(default_factory=Crowd)
    open: Sums = field(default_factory=Sums)
    closed: Closed = field(default_factory=Closed)
    accepted: int = 0
    repeated: int = 0
    rejected: int = 0
    tests: int = 0
    updates: int = 0
    updated: int = 0


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
        self.config = config
        raw = b_hat_to_raw(b_hat)
        self.s = State(index(robot_id), accuracy_of(raw), index(config.filter_period))
        if config.filter == Filter.ROBUST:
            self.s.crowd.first = raw

    def observe(self, z: Observation) -> Status:
        """Count an observation and form x_hat and alpha."""
        s, seen = self.s, index(z)
        if seen not in (0, 1):
            return Status.ERR_OBSERVATION
        s.t += 1
        s.n += seen
        if s.t >= self.config.memory:
            s.t, s.n = s.t >> 1, s.n + (s.n >> 1 & 1) >> 1  # to nearest, ties to even
        s.x_hat, s.alpha = estimate(s.t, s.n, s.accuracy)
        s.updated = 0
        return Status.OK

    def _receive(self, sender: int, x_hat: int, alpha: int) -> Status:
        s = self.s
        status = self._check_message(sender, x_hat)
        if status != Status.OK:
            s.rejected = s.rejected + 1 & COUNTER_MASK
            return status
        if s.heard[sender >> 5] >> (sender & 31) & 1:
            s.repeated = s.repeated + 1 & COUNTER_MASK
            return Status.REPEATED
        s.heard[sender >> 5] |= 1 << (sender & 31)
        s.accepted = s.accepted + 1 & COUNTER_MASK
        if self.config.filter != Filter.ROBUST:
            sums_add(s.open, x_hat, alpha)
        elif alpha >> 8:
            vote(s.crowd, sender, x_hat)
        return Status.OK

    def _check_message(self, sender: int, x_hat: int) -> Status:
        if not 0 <= sender <= MAX_ID or sender == self.s.id:
            return Status.ERR_SENDER
        return Status.OK if 0 <= x_hat <= ONE else Status.ERR_X_HAT

    def settle(self) -> Status:
        """Close the round, and filter every ``filter_period`` rounds."""
        s, updated = self.s, False
        s.closed = Closed(s.open.alpha, s.open.alpha_x_low, s.open.alpha_x_high)
        s.filter_left -= 1
        if s.filter_left == 0:
            s.filter_left = index(self.config.filter_period)
            updated = self._filter()
        s.open, s.heard = Sums(), [0, 0, 0, 0]
        return Status.UPDATED if updated else Status.OK

    def step(self, z: Observation) -> Status:
        """``observe(z)`` then ``settle()``: what ``settle`` returns, or the error of ``observe``."""
        status = self.observe(z)
        return self.settle() if status == Status.OK else status

    def _filter(self) -> bool:
        s = self.s
        if s.t == 0:
            return False
        b_hat = self._crowd_b_hat() if self.config.filter == Filter.ROBUST else self._round_b_hat()
        if b_hat is None:
            return False
        s.accuracy = accuracy_of(b_hat)
        s.updates = s.updates + 1 & COUNTER_MASK
        s.updated = 1
        return True

    def _round_b_hat(self) -> int | None:
        """What b_hat becomes by the paper's filter; None if it stays."""
        s, mode = self.s, self.config.filter
        if mode == Filter.OFF or s.open.count < (2 if mode == Filter.ADAPTIVE else 1):
            return None
        if mode == Filter.ADAPTIVE:
            s.tests = s.tests + 1 & COUNTER_MASK
            assert self.config.table is not None
            if not rejects(self.config.table, s.open, s.x_hat):
                return None
        return reestimate(s.t, s.n, s.closed)

    def _crowd_b_hat(self) -> int | None:
        """The same by the robust filter: None while the crowd moves, or before three voices were heard."""
        s, crowd = self.s, self.s.crowd
        if crowd.is_moving:
            if crowd.votes >= 2 * VOTES_MOVED:
                crowd.votes >>= 1
            return None
        if crowd.voices.bit_count() < 3:
            return None
        s.tests = s.tests + 1 & COUNTER_MASK
        if deviates(crowd, s.t, s.n):
            return b_hat_from(s.t, s.n, crowd_mean(crowd))
        return crowd.first if s.accuracy.b_hat != crowd.first else None

    id = reading(lambda robot: robot.s.id, "Own id.")
    t = reading(lambda robot: robot.s.t, "Observations counted.")
    n = reading(lambda robot: robot.s.n, "Black ones among them.")
    b_hat_raw = reading(lambda robot: robot.s.accuracy.b_hat, "b_hat in units of 2**-32.")
    x_hat_raw = reading(lambda robot: robot.s.x_hat, "x_hat in units of 2**-23.")
    alpha_raw = reading(lambda robot: robot.s.alpha, "alpha as the firmware's word.")
    beta_raw = reading(lambda robot: robot.s.closed.alpha, "beta in units of 2**-24.")

    @property
    def x_bar_raw(self) -> int:
        """x_bar in units of 2**-23; HALF where nothing was heard."""
        return self._estimate(HALF, 0)

    @property
    def x_raw(self) -> int:
        """x in units of 2**-23."""
        return self._estimate(self.s.x_hat, self.s.alpha)

    def _estimate(self, x_hat: int, alpha: int) -> int:
        if self.config.filter == Filter.ROBUST:
            return self.s.crowd.centre >> 7 if self.s.crowd.votes else x_hat
        return informed_estimate(self.s.closed, x_hat, alpha)

    @property
    def counters(self) -> Counters:
        """Diagnostics since the robot was made."""
        s = self.s
        return Counters(s.accepted, s.repeated, s.rejected, s.tests, s.updates)

    def state(self) -> dict[str, int]:
        """Every member of the state by name; nested ones as ``open_alpha``, ``accuracy_c``, ``heard_0``."""
        flat: dict[str, int] = {}
        for member in fields(State):
            value = getattr(self.s, member.name)
            if isinstance(value, (Sums, Accuracy, Closed, Crowd)):
                flat.update({f"{member.name}_{m.name}": getattr(value, m.name) for m in fields(value)})
            elif isinstance(value, list):
                flat.update({f"{member.name}_{i}": word for i, word in enumerate(value)})
            else:
                flat[member.name] = value
        return flat

    def holds_invariants(self) -> bool:
        """True if the state could have come from calls alone (``docs/invariants.md``)."""
        s, config = self.s, self.config
        is_robust = config.filter == Filter.ROBUST
        heard = sum(word.bit_count() for word in s.heard)
        return (
            s.id <= MAX_ID
            and s.n <= s.t < config.memory
            and B_HAT_MIN <= s.accuracy.b_hat <= B_HAT_MAX
            and s.accuracy == accuracy_of(s.accuracy.b_hat)
            and estimate_possible(s)
            and mean_possible(s.closed.alpha, s.closed.alpha_x_low, s.closed.alpha_x_high)
            and sums_possible(s.open)
            and (s.crowd.is_possible(s.accuracy.b_hat) if is_robust else s.crowd == Crowd())
            and (not is_robust or s.open.count == s.closed.alpha == 0)
            and s.open.count <= heard
            and s.heard[s.id >> 5] >> (s.id & 31) & 1 == 0
            and 1 <= s.filter_left <= config.filter_period
        )

    def save(self) -> bytes:
        """The state as ``mcp_asdf_save`` writes it: little-endian words, the last a checksum."""
        s = self.s
        words = [_magic(self.config), s.accuracy.b_hat, s.t, s.n, s.x_hat, s.alpha, s.filter_left]
        words += _crowd_words(s.crowd) if self.config.filter == Filter.ROBUST else _round_words(s)
        words += s.heard
        words += [s.repeated << 16 | s.accepted, s.tests << 16 | s.rejected]
        words += [s.updates | s.updated << 16 | s.id << 24]
        return struct.pack(f"<{IMAGE_WORDS}I", *words, checksum(words))

    @classmethod
    def restore(cls, config: Config, image: bytes) -> MirrorRobot:
        """A robot from ``save``'s image. Raises FirmwareError as ``mcp_asdf_restore`` fails."""
        plain = bytes(memoryview(image))
        check_config(config)
        words = struct.unpack(f"<{IMAGE_WORDS}I", plain) if len(plain) == 4 * IMAGE_WORDS else (0,)
        if words[0] != _magic(config) or checksum(words[:-1]) != words[-1]:
            raise FirmwareError(Status.ERR_IMAGE, "the image is damaged or of another version")
        if not B_HAT_MIN <= words[1] <= B_HAT_MAX:
            raise FirmwareError(Status.ERR_IMAGE, f"b_hat = {words[1]} is out of range")
        robot = cls.__new__(cls)
        robot.config, robot.s = config, _state_from(config, words)
        if not robot.holds_invariants() or (config.filter == Filter.ROBUST and any(words[12:23])):
            raise FirmwareError(Status.ERR_IMAGE, "the image does not fit the configuration")
        return robot


def _magic(config: Config) -> int:
    """The first word of an image."""
    return IMAGE_MAGIC | (ROBUST_IMAGE if config.filter == Filter.ROBUST else 0)


def _round_words(s: State) -> list[int]:
    """Both rounds in an image."""
    doubles = [s.closed.alpha, s.closed.alpha_x_low, s.closed.alpha_x_high]
    doubles += [s.open.alpha, s.open.alpha_x_low, s.open.alpha_x_high, s.open.x_squared]
    return [*(word for value in doubles for word in (value & MAX_WORD, value >> 32)), s.open.x, s.open.count]


def _crowd_words(crowd: Crowd) -> list[int]:
    """What stands in their place with the robust filter."""
    words = [crowd.centre, crowd.spread, crowd.voices, crowd.first, crowd.votes | crowd.trend << 16]
    return words + [0] * 11


def _state_from(config: Config, words: tuple[int, ...]) -> State:
    state = State(
        id=words[29] >> 24,
        accuracy=accuracy_of(words[1]),
        t=words[2],
        n=words[3],
        x_hat=words[4],
        alpha=words[5],
        filter_left=words[6],
        heard=list(words[23:27]),
        accepted=words[27] & COUNTER_MASK,
        repeated=words[27] >> 16,
        rejected=words[28] & COUNTER_MASK,
        tests=words[28] >> 16,
        updates=words[29] & COUNTER_MASK,
        updated=words[29] >> 16 & 0xFF,
    )
    if config.filter == Filter.ROBUST:
        state.crowd = Crowd(words[7], words[8], words[9], words[10], words[11] & MAX_TREND, words[11] >> 16)
    else:
        doubles = struct.unpack("<7Q", struct.pack("<14I", *words[7:21]))
        state.closed, state.open = Closed(*doubles[:3]), Sums(*doubles[3:], *words[21:23])
    return state
