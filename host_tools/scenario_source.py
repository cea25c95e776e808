"""Random scenarios for the cross-check, drawn from pools that are heavy with edges.

Every scenario is a function of a seed and a number. Uniform values would hardly ever meet what the firmware
treats apart, so pools mix them with both sides of every edge; counts jump to where years of observations
would lead; and some rounds are built so that the hypothesis test is decided by the last bits of its threshold.
"""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from math import isqrt
from random import Random

from firmware_py.fixed_point import ALPHA_INFINITE, ALPHA_MAX, B_HAT_MAX, B_HAT_MIN, HALF, ONE
from firmware_py.mirror import sums_add
from firmware_py.robot import DEFAULT_MEMORY, Filter, Sums
from firmware_py.table import Table
from host_tools.scenarios import Call, Scenario, Setup, TableChoice, build_table

TABLES = (("0.05", 30), ("0.05", 127), ("0.9", 2), ("0.25", 5))
_SIGN, _BIT_32 = 1 << 31, 1 << 32
_HALF_B_HAT, _INFORMATIVE = 1 << 31, 1 << 19
"""b_hat = 1/2, and how far from it an observation says something."""

# Words of an image (docs/design.md, section 8).
_T, _N, _B_HAT, _X_HAT, _ALPHA = 1, 2, 3, 4, 5
_COMMS_LEFT, _FILTER_LEFT = 28, 29
_COUNTERS = (30, 31, 32)
_WORDS = range(1, 33)

_ALPHAS = (
    *(0, 1, 0x007FFFFF, 0x00800000, _SIGN, ALPHA_INFINITE, ALPHA_INFINITE + 1, ALPHA_INFINITE - 1),
    *(ALPHA_MAX - 1, ALPHA_MAX, ALPHA_MAX + 1, 0x3F800000, 0xFFFFFFFF),
    *(0x33000000, 0x337FFFFF, 0x33800000, 0x33800001, 0x34000000, 0x3EFFFFFF, 0x3F000000, 0x3F000001),
)
"""Zeros, subnormals, not-a-numbers; the ends of the grid and of the range without lost bits."""


def random_scenario(seed: int, number: int) -> Scenario:
    """Scenario ``number`` of the sequence that ``seed`` starts; about 50 calls on average."""
    return _Author(Random(f"{seed}/{number}")).write()


class _Author:
    """Writes one scenario."""

    def __init__(self, source: Random) -> None:
        self._source = source
        self._setup = _setup(source)
        self._calls: list[Call] = []
        self._centre = source.choice([source.randint(0, ONE), 0, HALF, ONE])

    def write(self) -> Scenario:
        """Return the scenario."""
        source = self._source
        actions = (self._tick, self._jump, self._image, self._sums, self._decide)
        weights = source.choice([(10, 2, 1, 1, 1), (10, 0, 0, 0, 0), (1, 1, 0, 0, 0), (1, 1, 1, 1, 3)])
        for _ in range(source.choice([3, 10, 30])):
            source.choices(actions, weights)[0]()
        return Scenario(self._setup, tuple(self._calls))

    def _call(self, name: str, *numbers: int) -> None:
        self._calls.append(Call(name, numbers))

    def _tick(self) -> None:
        for _ in range(self._source.choice([0, 0, 1, 2, 3, 10])):
            self._call("receive", self._sender(), self._x_hat(), self._alpha())
        z = self._source.choice([0, 0, 0, 1, 1, 1, 2, 3])
        if self._source.random() < 0.5:
            self._call("step", z)
            return
        self._call("observe", z)
        if self._source.random() < 0.9:
            self._call("settle")

    def _sender(self) -> int:
        source = self._source
        return source.choice([source.randrange(10), source.randrange(128), self._setup.robot_id, 127, 128, 255])

    def _x_hat(self) -> int:
        """Often near the round's centre, so that tests find both agreement and difference."""
        source = self._source
        near = min(max(self._centre + source.randint(-1, 1) * source.randrange(1 << 16), 0), ONE)
        edges = [0, 1, HALF - 1, HALF, HALF + 1, ONE - 1, ONE, ONE + 1, _BIT_32 - 1]
        return source.choice([near, near, near, source.randint(0, ONE), source.choice(edges)])

    def _alpha(self) -> int:
        """Often of a usual size, that is from 2**-24 to 2**31."""
        source = self._source
        usual = source.randrange(0x33800000, ALPHA_MAX + 1)
        return source.choice([usual, usual, usual, source.choice(_ALPHAS), source.randrange(_BIT_32)])

    def _jump(self) -> None:
        """Go to any time, a share of black near where eq. 3 changes its case, and perhaps another b_hat."""
        source, words = self._source, []
        b_hat = self._setup.b_hat
        if source.random() < 0.5:
            b_hat = _b_hat(source)
            words = [_B_HAT, b_hat]
        t = _observations(source, self._setup.memory)
        self._call("restore", _T, t, _N, _blacks(source, t, b_hat), *words)
        self._call(*source.choice([("step", 0), ("step", 1), ("observe", 0), ("observe", 1)]))

    def _image(self) -> None:
        """Save and restore: as it is, damaged, with full counters, near a period's end, with any other word."""
        source = self._source
        kind = source.randrange(6)
        if kind == 0:
            self._call("damage", source.randrange(136), 1 << source.randrange(8))
        elif kind == 1:
            self._call("restore", *sum(([word, source.randrange(1 << 16) | 0xFFFE] for word in _COUNTERS[:1]), []))
        elif kind == 2:
            high, low = source.choice([0xFFFF, 0xFFFE, 0]), source.choice([0xFFFF, 0xFFFD, 0])
            self._call("restore", source.choice(_COUNTERS[:2]), high << 16 | low)
        elif kind == 3:
            self._call("restore", _COUNTERS[2], self._setup.robot_id << 24 | source.choice([0xFFFF, 0xFFFE]))
        elif kind == 4:
            self._call("restore", _COMMS_LEFT, source.randrange(2), _FILTER_LEFT, self._setup.comms_period)
        else:
            bits = source.choice([0, 1, 1 << source.randrange(32), source.randrange(_BIT_32)])
            self._call("restore", *([source.choice(_WORDS), bits] if source.random() < 0.8 else []))
