"""Random numbers of a world: Philox4x32-10, as in ``experiments/engine/philox.h``.

A draw is a function of seed, trial, robot and step alone. With steps, robots and trials counted from 0, the
counter of a block of four draws is (step div 4, robot, trial, stream), the key is the seed's lower and upper
32 bits, and the draw is word step mod 4. Stream 0 is for observations: a robot observes black if its draw,
without the last bit, is below the probability in units of 2**-31. Stream 1 is for sensor models whose
accuracies change at random. Stream 2 has one block for each trial, (0, 0, trial, 2), whose first two words
are the lower and upper half of the seed of the trial's arena.

J. K. Salmon, M. A. Moraes, R. O. Dror, D. E. Shaw, "Parallel random numbers: as easy as 1, 2, 3", SC'11.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

OBSERVATION_STREAM, SENSOR_STREAM, ARENA_STREAM = 0, 1, 2

PROBABILITY_ONE = 1 << 31
"""Probability 1 in units of 2**-31."""

_ROUNDS = 10
_MULTIPLIERS = np.uint64(0xD2511F53), np.uint64(0xCD9E8D57)
_KEY_INCREMENTS = 0x9E3779B9, 0xBB67AE85
"""What the key's words grow by from round to round."""
_LOW_WORD = 0xFFFFFFFF
"""Mask of the lower 32 bits."""
_LOW_WORD_MASK = np.uint64(_LOW_WORD)
_WORD_BITS = np.uint64(32)
_WORDS_IN_BLOCK = 4

WordArray = NDArray[np.uint64]
"""Words of 32 bits, in 64 bits each so that their products fit."""


def philox(
    counter: tuple[WordArray, WordArray, WordArray, WordArray], key: tuple[int, int]
) -> tuple[WordArray, WordArray, WordArray, WordArray]:
    """Return four random words of 32 bits for every element of the counter's four arrays. O(elements).

    Equal counters and keys give equal words. The key is two words of 32 bits; the names below are those of
    the paper's algorithm.
    """
    c0, c1, c2, c3 = counter
    first_k0, first_k1 = key
    k0_increment, k1_increment = _KEY_INCREMENTS
    c0_multiplier, c2_multiplier = _MULTIPLIERS
    for round_index in range(_ROUNDS):
        # Both words of the key grow from round to round, modulo 2**32.
        k0 = np.uint64((first_k0 + round_index * k0_increment) & _LOW_WORD)
        k1 = np.uint64((first_k1 + round_index * k1_increment) & _LOW_WORD)
        # Products have 64 bits; their upper and lower words go different ways.
        product0 = c0 * c0_multiplier
        product2 = c2 * c2_multiplier
        upper0, lower0 = product0 >> _WORD_BITS, product0 & _LOW_WORD_MASK
        upper2, lower2 = product2 >> _WORD_BITS, product2 & _LOW_WORD_MASK
        # All four change at once, as each new word is made of old ones.
        c0, c1, c2, c3 = upper2 ^ c1 ^ k0, lower2, upper0 ^ c3 ^ k1, lower0
    return c0, c1, c2, c3


class Stream(NamedTuple):
    """The draws of one trial for one purpose: one word for every step and robot.

    Attributes:
        number: OBSERVATION_STREAM, SENSOR_STREAM or ARENA_STREAM.
        seed: Seed of the run, below 2**64.
        trial: Number of the trial, below 2**32.
        robots: Number of robots.
    """

    number: int
    seed: int
    trial: int
    robots: int

    def draw_words(self, steps: int, first_step: int = 0) -> NDArray[np.uint32]:
        """Return random words of 32 bits for ``steps`` steps from ``first_step`` on.

        The shape is (steps, robots). A step's words do not depend on the steps that are drawn with it. Whole
        blocks are drawn, and the words before the first step and after the last one left out.
        """
        first_block, words_to_skip = divmod(first_step, _WORDS_IN_BLOCK)
        end_block = math.ceil((first_step + steps) / _WORDS_IN_BLOCK)
        words = self._draw_blocks(first_block, end_block)
        return words[words_to_skip : words_to_skip + steps].astype(np.uint32)

    def _draw_blocks(self, first_block: int, end_block: int) -> WordArray:
        """Return the random words of blocks ``first_block`` .. ``end_block - 1``.

        A block has the words of four consecutive steps. So the result has the shape (4 * blocks, robots).
        """
        blocks = np.arange(first_block, end_block, dtype=np.uint64)
        robots = np.arange(self.robots, dtype=np.uint64)
        # The counter of a block of a robot is these four numbers; all arrays have the shape (blocks, robots).
        block, robot = np.meshgrid(blocks, robots, indexing="ij")
        trial = np.full_like(block, self.trial)
        stream = np.full_like(block, self.number)
        key = (self.seed & _LOW_WORD, self.seed >> 32)  # the lower and the upper 32 bits
        four_words = philox((block, robot, trial, stream), key)
        words_by_block = np.stack(four_words, axis=1)  # shape (blocks, 4, robots)
        return words_by_block.reshape(-1, self.robots)

    def draw_uniforms(self, steps: int, first_step: int = 0) -> NDArray[np.float64]:
        """Return random numbers in (0, 1) for ``steps`` steps from ``first_step`` on.

        The shape is (steps, robots). Each number is the middle of one of 2**32 equal intervals, which a
        random word chooses.
        """
        random_words = self.draw_words(steps, first_step)
        # Half a unit keeps out 0 and 1, of which a logarithm or a quantile may be infinite.
        return (random_words.astype(np.float64) + 0.5) * 2.0**-32


def arena_seed(seed: int, trial: int) -> int:
    """Return the seed of a trial's arena, below 2**64: the first two words of the trial's ARENA_STREAM.

    The stream is drawn as for a single robot. Its two steps are the two words.
    """
    seed_words = Stream(ARENA_STREAM, seed, trial, robots=1).draw_words(steps=2)
    only_robot = 0
    low_word, high_word = seed_words[:, only_robot].tolist()
    return int(low_word) | (int(high_word) << 32)
