"""Random values for calls of a robot, from pools that are heavy with edges.

A uniform draw would hardly ever meet the values where an implementation can go wrong. So a pool holds both
sides of every limit, the ends of every range, and numbers of any size from a few units up.

Each function draws all candidates, and only then picks one of them. That takes more random numbers than
needed, but it fixes their sequence: the golden vectors are made of it.
"""

from __future__ import annotations

from random import Random

from mcp_asdf.arithmetic import Q32_HALF, Q32_ONE
from mcp_asdf.fixed_point import (
    ALPHA_MAX,
    B_HAT_MAX,
    B_HAT_MIN,
    HALF,
    LARGEST_ALPHA_UNITS,
    MANTISSA_BITS,
    MANTISSA_POSITION,
    ONE,
    SHIFT_MAX,
)
from mcp_asdf.mirror import INFORMATIVE_G
from mcp_asdf.robot import MAX_ROUND_SIZE, Sums
from mcp_asdf_tools.crosscheck.crafted_rounds import ALPHA_ONE, draw_normal_alpha
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

SPECIAL_X_HATS = (0, 1, HALF - 1, HALF, HALF + 1, ONE - 1, ONE, ONE + 1, MAX_32_BITS)
"""x_hat at edges, in units of 2**-23: the ends, next to them, 1/2, next to it, and two that are too large."""


def clamp(value: int, minimum: int, maximum: int) -> int:
    """Return the value, or the limit beyond which it is."""
    return min(max(value, minimum), maximum)


def draw_number_of_any_size(rng: Random, min_bits: int, max_bits: int) -> int:
    """Draw a number whose size is uniform: first a count of bits, then any number that fits in so many bits.

    So numbers of a few units come as often as those near 2**max_bits.
    """
    bits = rng.randint(min_bits, max_bits)
    return rng.randrange(1 << bits)


def draw_alpha(rng: Random) -> int:
    """Draw an alpha word: in three of four cases one as robots send it, else one that a robot never forms.

    The latter are words at edges, any 32 bits, words with ignored bits set, words with a shift although the
    mantissa is short, and words without confidence.
    """
    usual = draw_usual_alpha(rng)

    special = rng.choice(SPECIAL_ALPHAS)
    any_word = rng.randint(0, MAX_32_BITS)
    # Shows an implementation that takes these bits for a part of the mantissa or of the shift.
    with_ignored_bits = usual | (IGNORED_ALPHA_BITS & rng.randint(0, MAX_32_BITS))
    # Shows one that relies on the mantissa's highest bit wherever there is a shift.
    mantissa_of_any_size = draw_number_of_any_size(rng, min_bits=1, max_bits=MANTISSA_BITS)
    any_shift = rng.randrange(SHIFT_MAX + 1)
    with_short_mantissa = (mantissa_of_any_size << MANTISSA_POSITION) | any_shift
    # Shows one that asks whether the word is 0, not whether the mantissa is.
    without_confidence = rng.randrange(1 << MANTISSA_POSITION)  # only bits below the mantissa
    unusual = rng.choice([special, any_word, with_ignored_bits, with_short_mantissa, without_confidence])

    return rng.choice([usual, usual, usual, unusual])


def draw_usual_alpha(rng: Random) -> int:
    """Draw an alpha word as robots send them, for a confidence of any size from 2**-24 to 2**31.

    One of five is below 1/2, where the mantissa is short and the shift is 0.
    """
    if rng.random() < 0.2:
        bits = rng.randrange(1, MANTISSA_BITS)
        short_mantissa = rng.randrange(1, 1 << bits)
        return short_mantissa << MANTISSA_POSITION  # with a shift of 0
    return draw_normal_alpha(rng, min_shift=0, max_shift=SHIFT_MAX)


def draw_b_hat(rng: Random) -> int:
    """Draw b_hat in units of 2**-32, an accuracy within the firmware's limits.

    It is anywhere between them, or near to 1/2, or near to one of them:

    - Near to 1/2 it is at 1/2 itself, where it just carries information, or at a distance of any size, so
      that 1 / (2 b_hat - 1) has any size. One unit more or less shows a limit that is off by one.
    - Near to a limit, where 1 - b_hat or b_hat itself has few bits, it is at the limit or at a distance of
      any size from it.
    """
    distance = rng.choice([0, draw_number_of_any_size(rng, 1, 31), B_HAT_INFORMATIVE_DISTANCE])
    side = rng.choice([-1, 1])
    near_half = Q32_HALF + side * (distance + rng.randint(-1, 1))

    off_low_end = B_HAT_MIN + draw_number_of_any_size(rng, 0, 30)
    near_low_end = rng.choice([off_low_end, B_HAT_MIN])

    anywhere = rng.randint(B_HAT_MIN, B_HAT_MAX)
    # The limits lie alike on both sides: the upper one is 1 - B_HAT_MIN.
    near_either_end = rng.choice([near_low_end, Q32_ONE - near_low_end])
    b_hat = rng.choice([anywhere, near_half, near_either_end])
    return clamp(b_hat, B_HAT_MIN, B_HAT_MAX)


def draw_t(rng: Random, memory: int) -> int:
    """Draw a number of observations from 0 to ``memory`` - 1: of any size, near a power of two, or the last.

    ``memory`` is the number of observations at which t and n are halved.
    """
    power_of_two = 1 << rng.randrange(32)
    any_size = rng.randrange(2 * power_of_two)
    # Divisions and shifts by the count of bits change where t gets another bit.
    near_power_of_two = power_of_two + rng.randint(-2, 1)
    # The next observation, or that after it or the third, reaches the memory.
    before_halving = memory - rng.randint(1, 3)
    t = rng.choice([any_size, near_power_of_two, before_halving])
    return clamp(t, 0, memory - 1)


def draw_n(rng: Random, t: int, b_hat: int) -> int:
    """Draw how many of ``t`` observations are black: any number, none, all, half, t b_hat or t (1 - b_hat).

    Two of five draws are one of the last two: there eq. 3 changes its case, as x_hat reaches 0 or 1. The
    number next to each of these, above or below, is as frequent.
    """
    corner_share = rng.choice([b_hat, Q32_ONE - b_hat])  # units of 2**-32
    corner = (t * corner_share) >> 32
    any_number = rng.randint(0, t)
    none_or_all = rng.choice([0, t])
    n = rng.choice([any_number, none_or_all, t // 2, corner, corner])
    return clamp(n + rng.randint(-1, 1), 0, t)


def draw_extreme_sums(rng: Random) -> Sums:
    """Draw sums over a round that messages might have: each at one of its limits, or anywhere between them.

    The sums depend on each other, so the sums already drawn limit the next one. The order is the count of
    messages, the sum of x_hat (x), the sum of alpha, the sum of alpha times x_hat, and the sum of the squares
    of x_hat. The sum of alpha times x_hat is kept in two parts, alpha_x_low and alpha_x_high.
    """
    count = rng.choice([1, 2, 3, MAX_ROUND_SIZE, rng.randint(1, MAX_ROUND_SIZE)])
    largest_x = count * ONE  # where all x_hat are 1
    x = rng.choice([0, 1, rng.randint(0, largest_x), largest_x - 1, largest_x])
    smallest_alpha = count  # one unit for every message
    largest_alpha = count * LARGEST_ALPHA_UNITS
    alpha = rng.choice(
        [smallest_alpha, rng.randint(smallest_alpha, largest_alpha), largest_alpha, largest_alpha]
    )
    largest_alpha_x = alpha * ONE  # where all x_hat are 1
    alpha_x = rng.choice([0, rng.randint(0, largest_alpha_x), largest_alpha_x, largest_alpha_x])
    alpha_x_low, alpha_x_high = _split_alpha_x(alpha_x, x)
    # The squares are smallest where all x_hat are alike, and largest where each is 0 or 1.
    smallest_x_squared = (x * x + count - 1) // count  # the quotient, rounded up
    largest_x_squared = x * ONE
    return Sums(
        alpha=alpha,
        alpha_x_low=alpha_x_low,
        alpha_x_high=alpha_x_high,
        x_squared=rng.choice([smallest_x_squared, largest_x_squared]),
        x=x,
        count=count,
    )


def _split_alpha_x(alpha_x: int, x: int) -> tuple[int, int]:
    """Return the lower and the upper one of the two sums in which a firmware keeps the sum of alpha x_hat.

    The upper sum is of x_hat times the bits of alpha from 32 up, and the lower sum of x_hat times the 32 bits
    below. As much as fits goes into the upper one, and what is left is cut to the limit of the lower one.
    ``x`` is the sum of x_hat.
    """
    largest_upper_sum = x * (LARGEST_ALPHA_UNITS >> 32)  # where every alpha is the largest
    upper_sum = min(alpha_x >> 32, largest_upper_sum)
    rest = alpha_x - (upper_sum << 32)
    largest_lower_sum = min(x * MAX_32_BITS, (1 << 62) - 1)  # the firmware allows it 62 bits
    return min(rest, largest_lower_sum), upper_sum
