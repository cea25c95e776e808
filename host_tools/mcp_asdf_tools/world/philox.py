"""The random numbers of an experiment: Philox4x32-10, as in ``experiments/engine/philox.h``.

A draw is a function of seed, trial, robot and step alone. With steps, robots and trials counted from 0, the
counter of a block of four draws is (step div 4, robot, trial, stream), the key is the seed's lower and upper
32 bits, and the draw is word step mod 4. Stream 0 is for the sensors: a robot observes black if its draw,
without the last bit, is below the probability in units of 2**-31. Stream 1 moves sensors that drift at
random. Stream 2 has one block for each trial, (0, 0, trial, 2), whose first two words are the lower and upper
half of the seed of the trial's arena.

J. K. Salmon, M. A. Moraes, R. O. Dror, D. E. Shaw, "Parallel random numbers: as easy as 1, 2, 3", SC'11.
"""

from __future__ import annotations

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


def words(seed: int, trial: int, robots: int, steps: int, stream: int) -> NDArray[np.uint32]:
    """The draws of a trial, shape (steps, robots). ``seed`` is below 2**64, the others below 2**32."""
    blocks = -(-steps // 4)
    block, robot = np.meshgrid(
        np.arange(blocks, dtype=np.uint64), np.arange(robots, dtype=np.uint64), indexing="ij"
    )
    constant = np.zeros_like(block)
    drawn = philox(
        (block, robot, constant + np.uint64(trial), constant + np.uint64(stream)),
        (seed & 0xFFFFFFFF, seed >> 32),
    )
    return np.stack(drawn, axis=1).reshape(4 * blocks, robots)[:steps].astype(np.uint32)


def uniforms(seed: int, trial: int, robots: int, steps: int) -> NDArray[np.float64]:
    """Numbers in (0, 1) of stream 1, shape (steps, robots): the middles of 2**32 equal intervals."""
    return (words(seed, trial, robots, steps, MOVES).astype(np.float64) + 0.5) * 2.0**-32


def world_seed(seed: int, trial: int) -> int:
    """The seed of a trial's arena, below 2**64."""
    low, high = words(seed, trial, 1, 2, WORLDS)[:, 0].tolist()
    return int(low) | int(high) << 32
