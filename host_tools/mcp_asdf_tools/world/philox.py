"""Random numbers of a world: Philox4x32-10, as in ``experiments/engine/philox.h``.

A draw is a function of seed, trial, robot and step alone. With steps, robots and trials counted from 0, the
counter of a block of four draws is (step div 4, robot, trial, stream), the key is the seed's lower and upper
32 bits, and the draw is word step mod 4. Stream 0 is for the sensors: a robot observes black if its draw,
without the last bit, is below the probability in units of 2**-31. Stream 1 moves sensors that drift at
random. Stream 2 has one block for each trial, (0, 0, trial, 2), whose first two words are the lower and upper
half of the seed of the trial's arena.

J. K. Salmon, M. A. Moraes, R. O. Dror, D. E. Shaw, "Parallel random numbers: as easy as 1, 2, 3", SC'11.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

OBSERVATIONS, MOVES, WORLDS = 0, 1, 2
"""Streams."""

CERTAIN = 1 << 31
"""Probability 1 in units of 2**-31."""

_ROUNDS = 10
_FACTORS = np.uint64(0xD2511F53), np.uint64(0xCD9E8D57)
_STEPS = 0x9E3779B9, 0xBB67AE85
_LOW, _WORD = np.uint64(0xFFFFFFFF), np.uint64(32)

Words = NDArray[np.uint64]


def philox(
    counter: tuple[Words, Words, Words, Words], key: tuple[int, int]
) -> tuple[Words, Words, Words, Words]:
    """Four random words for every element of the counter's arrays, all below 2**32. O(elements)."""
    c0, c1, c2, c3 = counter
    for turn in range(_ROUNDS):
        k0, k1 = (
            np.uint64((word + turn * step) & 0xFFFFFFFF) for word, step in zip(key, _STEPS, strict=True)
        )
        first, second = c0 * _FACTORS[0], c2 * _FACTORS[1]
        c0, c1, c2, c3 = (
            (second >> _WORD) ^ c1 ^ k0,
            second & _LOW,
            (first >> _WORD) ^ c3 ^ k1,
            first & _LOW,
        )
    return c0, c1, c2, c3


class Stream(NamedTuple):
    """One kind of draws of one trial.

    Attributes:
        number: OBSERVATIONS, MOVES or WORLDS.
        seed: Below 2**64.
        trial: Below 2**32.
        robots: Number of robots.
    """

    number: int
    seed: int
    trial: int
    robots: int

    def words(self, steps: int, first: int = 0) -> NDArray[np.uint32]:
        """Draws of steps ``first`` .. ``first + steps - 1``, shape (steps, robots)."""
        start, stop = first // 4, -(-(first + steps) // 4)
        blocks, robots = np.arange(start, stop, dtype=np.uint64), np.arange(self.robots, dtype=np.uint64)
        block, robot = np.meshgrid(blocks, robots, indexing="ij")
        constant = np.zeros_like(block)
        drawn = philox(
            (block, robot, constant + np.uint64(self.trial), constant + np.uint64(self.number)),
            (self.seed & 0xFFFFFFFF, self.seed >> 32),
        )
        rows = np.stack(drawn, axis=1).reshape(4 * (stop - start), self.robots)
        return rows[first - 4 * start :][:steps].astype(np.uint32)

    def uniforms(self, steps: int, first: int = 0) -> NDArray[np.float64]:
        """The same as numbers in (0, 1): the middles of 2**32 equal intervals."""
        return (self.words(steps, first).astype(np.float64) + 0.5) * 2.0**-32


def world_seed(seed: int, trial: int) -> int:
    """The seed of a trial's arena, below 2**64."""
    low, high = Stream(WORLDS, seed, trial, 1).words(2)[:, 0].tolist()
    return int(low) | int(high) << 32
