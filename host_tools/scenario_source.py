"""Random scenarios for the cross-check, drawn from pools that are heavy with edges.

Every scenario is a function of a seed and a number. Uniform values would hardly ever meet what the firmware
treats apart, so the pools mix them with both sides of every edge; counts jump to where years of observations
would lead; and some rounds are built so that the last bits of its threshold decide the hypothesis test.
"""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from math import ceil, isqrt
from random import Random
from typing import Any

from firmware_py.fixed_point import ALPHA_INFINITE, ALPHA_MAX, B_HAT_MAX, B_HAT_MIN, HALF, ONE
from firmware_py.mirror import IMAGE_WORDS, sums_add
from firmware_py.robot import DEFAULT_MEMORY, MAX_ID, Filter, Sums
from firmware_py.table import HEADER_WORDS, MAX_OMEGA_WORD, Table
from host_tools.scenarios import Call, Scenario, Setup, TableChoice, build_table

TABLES = (("0.05", 30), ("0.05", 127), ("0.9", 2), ("0.25", 5))
"""Omega and q of the tables that scenarios use."""

_BITS_16, _BITS_32 = 0xFFFF, 0xFFFFFFFF
_B_HAT_HALF, _INFORMATIVE = 1 << 31, 1 << 19
"""b_hat = 1/2, and how far from it an observation says something."""

# Words of an image (docs/design.md, section 8).
_T, _N, _B_HAT, _X_HAT, _ALPHA, _SETTLED_ALPHA, _CLOSED = 1, 2, 3, 4, 5, 7, 8
_HEARD, _COMMS_LEFT, _FILTER_LEFT, _COUNTERS, _LAST = 24, 28, 29, 30, 32

_ALPHA_ONE = 0x3F800000
_ALPHAS = (
    *(0, 1, 0x007FFFFF, 0x00800000, 0x80000000, ALPHA_INFINITE - 1, ALPHA_INFINITE, ALPHA_INFINITE + 1),
    *(ALPHA_MAX - 1, ALPHA_MAX, ALPHA_MAX + 1, _ALPHA_ONE, _BITS_32),
    *(0x33000000, 0x337FFFFF, 0x33800000, 0x33800001, 0x34000000, 0x3EFFFFFF, 0x3F000000, 0x3F000001),
)
"""Zeros, subnormals, infinity, not-a-numbers; ends of the range, of the grid and of its coarse part."""

_X_HATS = (0, 1, HALF - 1, HALF, HALF + 1, ONE - 1, ONE, ONE + 1, _BITS_32)


def random_scenario(seed: int, number: int) -> Scenario:
    """Scenario ``number`` of those that ``seed`` gives; up to a few hundred calls."""
    return _Author(Random(f"{seed}/{number}")).write()


class _Author:
    """Writes one scenario."""

    def __init__(self, source: Random) -> None:
        self._source = source
        self._setup = _setup(source)
        self._b_hat = self._setup.b_hat
        self._centre = source.choice([source.randint(0, ONE), 0, HALF, ONE])
        self._calls: list[Call] = []

    def write(self) -> Scenario:
        """The scenario; for one robot in ten it ends with making it, which most of them do not survive."""
        source = self._source
        if source.random() < 0.1:
            return Scenario(_spoilt(self._setup, source), ())
        actions = (self._tick, self._jump, self._image, self._sums, self._decide)
        weights = source.choice([(10, 2, 1, 1, 1), (1, 0, 0, 0, 0), (1, 1, 0, 0, 0), (1, 1, 1, 1, 3)])
        for action in source.choices(actions, weights, k=source.choice([3, 10, 30])):
            action()
        return Scenario(self._setup, tuple(self._calls))

    def _call(self, name: str, *numbers: int) -> None:
        self._calls.append(Call(name, numbers))

    def _tick(self) -> None:
        """A few messages and a step, or its two halves, the second sometimes forgotten."""
        source = self._source
        for _ in range(source.choice([0, 0, 1, 2, 3, 10])):
            self._call("receive", self._sender(), self._x_hat(), self._alpha())
        z = source.choice([0, 0, 0, 1, 1, 1, 2, 3])
        if source.random() < 0.5:
            self._call("step", z)
            return
        self._call("observe", z)
        if source.random() < 0.9:
            self._call("settle")

    def _sender(self) -> int:
        source, own = self._source, self._setup.robot_id
        return source.choice([source.randrange(10), source.randrange(128), own, 127, 128, 255])

    def _x_hat(self) -> int:
        """Often near the scenario's centre, so that tests find agreement and difference."""
        source = self._source
        near = self._centre + source.randint(-1, 1) * source.randrange(1 << source.randrange(1, 20))
        anywhere = source.choice([source.randint(0, ONE), source.choice(_X_HATS)])
        return source.choice([min(max(near, 0), ONE), anywhere])

    def _alpha(self) -> int:
        """Often of any size from 2**-24 to 2**31."""
        source = self._source
        usual = source.randint(0x33800000, ALPHA_MAX)
        return source.choice([usual, usual, usual, source.choice(_ALPHAS), source.randint(0, _BITS_32)])

    def _jump(self) -> None:
        """Observe at any time, with any b_hat, with a share of black where eq. 3 changes its case."""
        source, words = self._source, []
        if source.random() < 0.5:
            self._b_hat = _b_hat(source)
            words = [_B_HAT, self._b_hat]
        t = _observations(source, self._setup.memory)
        self._call("restore", _T, t, _N, _blacks(source, t, self._b_hat), *words)
        self._call(source.choice(["step", "observe"]), source.randrange(2))

    def _image(self) -> None:
        """Save and restore, with words of the image changed so that it should or should not be refused."""
        source, setup = self._source, self._setup
        own, edge = setup.robot_id, source.choice([0, _BITS_16 - 1, _BITS_16])
        alpha, x_hat = source.choice(_ALPHAS), source.choice([HALF, self._x_hat()])
        beta = (MAX_ID * 0xFFFFFF << 31) + source.randint(-1, 1)
        low = source.choice([0, (1 << 30) - 1, 1 << 30, _BITS_32])
        changes = (
            (),
            (_COMMS_LEFT, source.randrange(2), _FILTER_LEFT, source.choice([0, 1, 1]) * setup.comms_period),
            (_COUNTERS, edge << 16 | _BITS_16 - edge, _COUNTERS + 1, edge << 16, _LAST, own << 24 | edge),
            (_COUNTERS, _BITS_16 - edge << 16 | edge, _COUNTERS + 1, edge),
            (source.choice([_ALPHA, _SETTLED_ALPHA]), alpha, _X_HAT, x_hat),
            (_CLOSED, beta & _BITS_32, _CLOSED + 1, beta >> 32, _CLOSED + 3, low),
            (_HEARD + (own >> 5), 1 << (own & 31), _LAST, own << 24 | 1 << 16),
            (_LAST, own << 24 | source.choice([1, 127, 128, 254, 255]) << 16),
            (source.randint(_T, _LAST), source.choice([0, 1, 1 << source.randrange(32), _BITS_32])),
        )
        if source.random() < 0.1:
            self._call("damage", source.randrange(4 * IMAGE_WORDS), 1 << source.randrange(8))
        else:
            self._call("restore", *source.choice(changes))
        self._call("receive", self._sender(), self._x_hat(), source.choice([0, alpha]))

    def _sums(self) -> None:
        """Add a round's sums, some of them impossible."""
        source = self._source
        m = source.choice([0, 1, 2, 3, 30, 31, 126, 127, source.randint(0, MAX_ID)])
        largest, sums = source.random() < 0.2, Sums()
        for _ in range(m):
            x_hat, alpha = (ONE, ALPHA_MAX) if largest else (self._x_hat(), self._alpha())
            sums_add(sums, min(x_hat, ONE), alpha & ALPHA_MAX)
        numbers = [m + source.choice([0, 0, 0, 0, 1, 126, 128]), *_members(sums)]
        if source.random() < 0.3:
            member = source.randrange(len(numbers))
            number = numbers[member]
            numbers[member] = source.choice([max(number - 1, 0), number + 1, number ^ 1 << 20, number // 2])
        self._call("add", numbers[0] & 0xFF, *numbers[1:])

    def _decide(self) -> None:
        """Run the hypothesis test on a round at its threshold, where there is one."""
        source, choice = self._source, self._setup.table
        if choice is None:
            self._tick()
            return
        edge = source.choice([2, 3, choice.q, choice.q + 1, MAX_ID])
        m = min(source.choice([edge, source.randint(2, MAX_ID)]), MAX_ID)
        x_hats, own = round_at_threshold(source, build_table(choice), m)
        t = max(_observations(source, self._setup.memory), 1)
        words = [_T, t, _N, _blacks(source, t, self._b_hat), _X_HAT, own, _ALPHA, _ALPHA_ONE]
        self._call("restore", _COMMS_LEFT, 0)
        self._call("settle")
        self._call("restore", *words, _COMMS_LEFT, 0, _FILTER_LEFT, self._setup.comms_period)
        self._deliver(x_hats)
        self._call("settle")

    def _deliver(self, x_hats: list[int]) -> None:
        """One message for each, or all at once."""
        source, sums = self._source, Sums()
        senders = [sender for sender in range(MAX_ID + 1) if sender != self._setup.robot_id]
        one_by_one = source.random() < 0.2
        for sender, x_hat in zip(source.sample(senders, len(x_hats)), x_hats, strict=True):
            alpha = source.randint(0x33800000, ALPHA_MAX)
            if one_by_one:
                self._call("receive", sender, x_hat, alpha)
            else:
                sums_add(sums, x_hat, alpha)
        if not one_by_one:
            self._call("add", len(x_hats), *_members(sums))


def round_at_threshold(source: Random, table: Table, m: int) -> tuple[list[int], int]:
    """x_hat of ``m`` messages and the robot's own, close to where eq. 12 turns, on either side.

    With p messages at a and m - p at a + m d, and the own x_hat e beside their mean, eq. 12 is
    e/d > sqrt(k p (m - p)): the best rational approximations of that root come close, some within the
    rounding of the table's entry.
    """
    p = source.randrange(1, m)
    scale = 60
    root = isqrt((table.entry(m) * p * (m - p)) << (2 * scale - table.fraction_bits))
    ratio = Fraction(root, 1 << scale)
    most = ONE // (m + ceil(ratio))
    near = ratio.limit_denominator(source.randint(1, max(most >> source.randrange(6), 1)))
    factor = source.choice([0, 1, 1, 1, source.randint(1, max(most // near.denominator, 1))])
    d, e = factor * near.denominator, factor * near.numerator
    own = d * (m - p) + source.choice([-e, e])
    low, high = min(0, own), max(m * d, own)
    start = source.randint(-low, max(ONE - high, -low))
    x_hats = [min(start + m * d * (i >= p), ONE) for i in range(m)]
    return x_hats, min(start + own, ONE)


def _setup(source: Random) -> Setup:
    comms_period = source.choice([1, 1, 1, 2, 3, 7, _BITS_32])
    filter_period = min(
        comms_period * source.choice([1, 1, 2, 5, 20]), _BITS_32 // comms_period * comms_period
    )
    mode = source.choice([Filter.ADAPTIVE, Filter.ADAPTIVE, Filter.ADAPTIVE, Filter.ALWAYS, Filter.OFF])
    return Setup(
        TableChoice(*source.choice(TABLES)) if mode == Filter.ADAPTIVE else None,
        int(mode),
        comms_period,
        filter_period,
        source.choice([DEFAULT_MEMORY, DEFAULT_MEMORY, DEFAULT_MEMORY, 64, 66, 1000, 1 << 31]),
        source.choice([0, 5, 31, 32, 127]),
        _b_hat(source),
    )


def _spoilt(setup: Setup, source: Random) -> Setup:
    """The setup with one or two members, often the table, that a robot should refuse, or nearly so."""
    table: dict[str, Any] = {"table": spoilt_table(source), "filter": int(Filter.ADAPTIVE)}
    if source.random() < 0.5:
        return replace(setup, **table)
    changes: list[dict[str, Any]] = [
        {"comms_period": source.choice([0, 2, _BITS_32])},
        {"filter_period": source.choice([0, setup.filter_period - 1, _BITS_32])},
        {"memory": source.choice([0, 62, 63, 64, 65, _BITS_32, _BITS_32 - 1])},
        {"filter": source.choice([0, 3, 255])},
        {"robot_id": source.choice([128, 255])},
        {"b_hat": source.choice([0, B_HAT_MIN - 1, B_HAT_MAX + 1, _BITS_32])},
        table,
    ]
    for change in source.sample(changes, source.choice([1, 1, 1, 2])):
        setup = replace(setup, **change)
    return setup


def spoilt_table(source: Random) -> TableChoice:
    """A table with a word that a robot should refuse, or nearly so.

    Either the checksum fits, so that the word itself must be looked at, or it is all that tells.
    """
    choice = TableChoice(*source.choice(TABLES))
    words = build_table(choice).words()
    entry = source.randrange(HEADER_WORDS, len(words))
    flipped, any_word = 1 << source.randrange(32), source.randrange(len(words))
    shape = words[1].to_bytes(4, "big")
    changes: list[tuple[int, ...]] = [
        (0, words[0] ^ flipped),
        (1, _shape(shape, 0, shape[0] ^ 1 << source.randrange(8))),
        (1, _shape(shape, 1, source.choice([0, 1, choice.q - 1, choice.q ^ 64, 128, 255]))),
        _longer(source, words),
        (1, _shape(shape, 2, source.choice([0, 1, 20, 25, 26, 27, 31, 32, 255]))),
        (1, _shape(shape, 3, 1 << source.randrange(8))),
        (2, source.choice([0, 1, MAX_OMEGA_WORD, MAX_OMEGA_WORD + 1, _BITS_32])),
        (3, words[3] ^ flipped),
        (entry, _near_entry(source, words, entry)),
        (entry, words[entry] ^ flipped),
        (any_word, words[any_word] ^ flipped, 3, words[3]),
    ]
    return replace(choice, replaced=source.choice(changes))


def _shape(shape: bytes, place: int, value: int) -> int:
    """Word 1 with another version (place 0), q, number of fraction bits, or lowest byte."""
    return int.from_bytes(shape[:place] + bytes([value]) + shape[place + 1 :], "big")


def _longer(source: Random, words: tuple[int, ...]) -> tuple[int, ...]:
    """Replacements that give a table one more entry, sound or at the edge of that."""
    one = 1 << (words[1] >> 8 & 0xFF)
    value = source.choice([0, one, one + 1, words[-1] - 1, words[-1]])
    return (1, words[1] + (1 << 16), len(words), value)


def _near_entry(source: Random, words: tuple[int, ...], entry: int) -> int:
    """An entry near its neighbours, at the ends of its range, or anywhere."""
    neighbour = words[max(entry - 1, HEADER_WORDS)]
    values = (0, 1, 1 << source.randrange(32), neighbour, neighbour - 1, _BITS_32)
    return source.choice([*values, source.randint(0, _BITS_32)])


def _b_hat(source: Random) -> int:
    """Anywhere, at the ends, around 1/2 at every distance, and at the edge of saying nothing."""
    away = source.choice([0, source.randrange(1 << source.randrange(1, 32)), _INFORMATIVE])
    nearby = source.choice([-1, 1]) * (away + source.randint(-1, 1))
    end = source.choice([B_HAT_MIN + source.randrange(1 << source.randrange(31)), B_HAT_MIN])
    b_hat = source.choice(
        [source.randint(B_HAT_MIN, B_HAT_MAX), _B_HAT_HALF + nearby, source.choice([end, (1 << 32) - end])]
    )
    return min(max(b_hat, B_HAT_MIN), B_HAT_MAX)


def _observations(source: Random, memory: int) -> int:
    """t before the next observation, of any size: around powers of two, and where the memory halves it."""
    power = 1 << source.randrange(32)
    t = source.choice(
        [source.randrange(2 * power), power + source.randint(-2, 1), memory - source.randint(1, 3)]
    )
    return min(max(t, 0), memory - 1)


def _blacks(source: Random, t: int, b_hat: int) -> int:
    """n of t: anywhere, at the ends, at one half, and around t b_hat and t (1 - b_hat)."""
    corner = t * source.choice([b_hat, (1 << 32) - b_hat]) >> 32
    n = source.choice([source.randint(0, t), source.choice([0, t]), t // 2, corner, corner])
    return min(max(n + source.randint(-1, 1), 0), t)


def _members(sums: Sums) -> tuple[int, ...]:
    return (sums.alpha, sums.alpha_x_low, sums.alpha_x_high, sums.x_squared, sums.x, sums.count)
