"""Random values for calls of a robot, most of them next to an edge.

A uniform draw would hardly ever meet the values where an implementation can go wrong: both sides of every
limit, the ends of every range, and numbers of a few units.
"""

from __future__ import annotations

from collections.abc import Sequence
from random import Random

from mcp_asdf.arithmetic import Q32_HALF, Q32_ONE
from mcp_asdf.fixed_point import ALPHA_MAX, B_HAT_MAX, B_HAT_MIN, LARGEST_ALPHA_UNITS, ONE
from mcp_asdf.mirror import INFORMATIVE_G
from mcp_asdf.robot import MAX_ROUND_SIZE, Sums
from mcp_asdf_tools.crosscheck.crafted_rounds import ALPHA_ONE, draw_alpha_of_bits
from mcp_asdf_tools.crosscheck.image_numbers import MAX_32_BITS

B_HAT_INFORMATIVE_DISTANCE = INFORMATIVE_G // 2
"""Distance of b_hat from 1/2 from which on an observation carries information, in units of 2**-32."""

IGNORED_ALPHA_BITS = 0xE0
"""Bits of an alpha word between its shift (5 bits) and its mantissa, which no firmware may evaluate."""

SPECIAL_ALPHAS = (
    # No confidence: the mantissa is 0, whatever the other bits are.
    *(0, 31, IGNORED_ALPHA_BITS, IGNORED_ALPHA_BITS | 31),
    # One unit of 2**-24, with ignored bits, and shifted by 31
    *(0x100, 0x1FF, 0x100 | 31),
    # 1.0, the same with ignored bits, and as another word: 2**8 units shifted by 16
    *(ALPHA_ONE, ALPHA_ONE | IGNORED_ALPHA_BITS, 0x00010010),
    # The ends of the mantissa, and where its value just fits in 32 bits of units, or just does not
    *(0x7FFFFF00, 0x80000000, 0xFFFFFF00, 0x80000001, 0xFFFFFF07, 0xFFFFFF08, 0x80000009, 0x00000118),
    # The largest confidence, and those near it
    *(0x8000001F, ALPHA_MAX - 0x100, ALPHA_MAX - 1, ALPHA_MAX),
    *(ALPHA_MAX | IGNORED_ALPHA_BITS, ALPHA_MAX & ~0xFF),
)
"""Alpha words at edges."""


def clamp(value: int, minimum: int, maximum: int) -> int:
    """Return the value, or the limit beyond which it is."""
    return min(max(value, minimum), maximum)


def draw_number_of_any_size(rng: Random, min_bits: int, max_bits: int) -> int:
    """Draw a number whose size is uniform: first a count of bits, then any number that fits in so many bits.

    So numbers of a few units come as often as those near 2**max_bits.
    """
    bits = rng.randint(min_bits, max_bits)
    return rng.randrange(1 << bits)


def draw_at_edges(rng: Random, edges: Sequence[int], minimum: int, maximum: int) -> int:
    """Draw a number from ``minimum`` to ``maximum``, in half of the cases an edge or a unit beside one.

    In a quarter of the cases it is at a distance of any size from an edge, so that few units are as frequent
    as many, and in the last quarter anywhere. A number that would be out of the range becomes its end.
    """
    edge = rng.choice(edges)
    beside_edge = edge + rng.randint(-1, 1)
    range_bits = (maximum - minimum).bit_length()
    off_edge = edge + rng.choice([-1, 1]) * draw_number_of_any_size(rng, 0, range_bits)
    anywhere = rng.randint(minimum, maximum)
    return clamp(rng.choice([beside_edge, beside_edge, off_edge, anywhere]), minimum, maximum)


def draw_at_ends(rng: Random, minimum: int, maximum: int) -> int:
    """Draw a number from ``minimum`` to ``maximum`` as ``draw_at_edges`` does; its edges are these two."""
    return draw_at_edges(rng, [minimum, maximum], minimum, maximum)


def draw_usual_alpha(rng: Random) -> int:
    """Draw an alpha word as robots send them, for a confidence of any number of bits that a word can hold."""
    return draw_alpha_of_bits(rng, 1, LARGEST_ALPHA_UNITS.bit_length())


def draw_alpha(rng: Random) -> int:
    """Draw an alpha word: in three of five cases one as robots send it, else one at an edge, or any bits.

    The word of any bits has up to 32 of them. If they are few, it has no confidence, or a shift although its
    mantissa is short. If they are many, some of them may be bits that must be ignored. A robot never forms
    such words.
    """
    usual = draw_usual_alpha(rng)
    special = rng.choice(SPECIAL_ALPHAS)
    any_bits = draw_number_of_any_size(rng, 0, 32)
    return rng.choice([usual, usual, usual, special, any_bits])


def draw_b_hat(rng: Random) -> int:
    """Draw b_hat in units of 2**-32, an accuracy within the firmware's limits.

    Its edges are these limits, 1/2, and where it just carries information.
    """
    just_informative = (Q32_HALF - B_HAT_INFORMATIVE_DISTANCE, Q32_HALF + B_HAT_INFORMATIVE_DISTANCE)
    return draw_at_edges(rng, [B_HAT_MIN, Q32_HALF, *just_informative, B_HAT_MAX], B_HAT_MIN, B_HAT_MAX)


def draw_t(rng: Random, memory: int) -> int:
    """Draw a number of observations from 0 to ``memory`` - 1. Its edges are a power of two, and the memory.

    ``memory`` is the number of observations at which t and n are halved.
    """
    # Divisions and shifts by the count of bits change where t gets another bit.
    power_of_two = 1 << rng.randrange(32)
    # The next observation, or that after it or the third, reaches the memory.
    before_halving = memory - 2
    return draw_at_edges(rng, [power_of_two, before_halving], 0, memory - 1)


def draw_n(rng: Random, t: int, b_hat: int) -> int:
    """Draw how many of ``t`` observations are black. The edges are none, all, half, and two others.

    At t b_hat and t (1 - b_hat) eq. 3 changes its case, as x_hat reaches 0 or 1. ``b_hat`` is in units of
    2**-32.
    """
    corners = [(t * share) >> 32 for share in (b_hat, Q32_ONE - b_hat)]
    return draw_at_edges(rng, [0, t // 2, t, *corners], 0, t)


def draw_sums(rng: Random) -> Sums:
    """Draw sums of a round that messages might have.

    The edges of a sum are the limits that are left to it by the sums that are drawn before it.
    """
    count = draw_at_ends(rng, 1, MAX_ROUND_SIZE)
    x = draw_at_ends(rng, 0, count * ONE)  # where all x_hat are 1
    smallest_alpha = count  # one unit for every message
    largest_alpha = count * LARGEST_ALPHA_UNITS
    alpha = draw_at_ends(rng, smallest_alpha, largest_alpha)
    # The sum of alpha x_hat is kept in two parts: with the bits of each alpha from 32 up, and with those
    # below. Either part is largest where all these bits are set, and both together where all x_hat are 1.
    largest_alpha_x = alpha * ONE
    alpha_x_high = draw_at_ends(rng, 0, min(x * (LARGEST_ALPHA_UNITS >> 32), largest_alpha_x >> 32))
    alpha_x_low = draw_at_ends(rng, 0, min(x * MAX_32_BITS, largest_alpha_x - (alpha_x_high << 32)))
    # The squares are smallest where all x_hat are alike, and largest where each is 0 or 1.
    smallest_x_squared = (x * x + count - 1) // count  # the quotient, rounded up
    largest_x_squared = x * ONE
    x_squared = draw_at_ends(rng, smallest_x_squared, largest_x_squared)
    return Sums(alpha, alpha_x_low, alpha_x_high, x_squared, x, count)


def draw_sums_of_closed_round(rng: Random) -> tuple[int, int, int]:
    """Draw the sums that are kept of a closed round.

    They are the sum of alpha, and the sum of alpha x_hat in two parts, the lower one first. The edges of a
    sum are the limits that are left to it by the sums that are drawn before it.
    """
    alpha = draw_at_ends(rng, 0, MAX_ROUND_SIZE * LARGEST_ALPHA_UNITS)
    largest_alpha_x = alpha * ONE  # where all x_hat are 1
    alpha_x_low = draw_at_ends(rng, 0, min((1 << 62) - 1, largest_alpha_x))
    alpha_x_high = draw_at_ends(rng, 0, (largest_alpha_x - alpha_x_low) >> 32)
    return alpha, alpha_x_low, alpha_x_high
