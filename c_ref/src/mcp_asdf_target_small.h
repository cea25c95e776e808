/* Variants of cores without 64-bit product, divider or count of leading zeros, for mcp_asdf_target.h alone.
 */
#ifndef MCP_ASDF_TARGET_SMALL_H
#define MCP_ASDF_TARGET_SMALL_H

#if MCP_ASDF_SPLIT_MULTIPLY
/* Returns the product a b, by long multiplication with digits of 16 bits:
 *
 *     (2^16 a1 + a0)(2^16 b1 + b0) = 2^32 a1 b1 + 2^16 (a1 b0 + a0 b1) + a0 b0
 *
 * Each product of digits is at most (2^16 - 1)^2. As in long multiplication on paper, the upper half of each
 * sum is carried to the next one to the left, which therefore stays below 2^32. */
WARM uint64_t multiply(uint32_t a, uint32_t b)
{
    const uint32_t a0 = a & 0xFFFFU, a1 = a >> 16, b0 = b & 0xFFFFU, b1 = b >> 16;
    const uint32_t low = a0 * b0;
    const uint32_t middle = a1 * b0 + (low >> 16);
    const uint32_t both_middles = a0 * b1 + (middle & 0xFFFFU);
    const uint32_t high = a1 * b1 + (middle >> 16) + (both_middles >> 16);
    /* Bits 32 to 63, 16 to 31 and 0 to 15. The carry of both_middles is in `high` already: here it is shifted
     * out of the word. */
    return (uint64_t)high << 32 | both_middles << 16 | (low & 0xFFFFU);
}

/* Returns the upper word of the product a b, in the same way; the lower one is not put together. */
WARM uint32_t multiply_high(uint32_t a, uint32_t b)
{
    const uint32_t a1 = a >> 16, b1 = b >> 16;
    a &= 0xFFFFU; /* a0 and b0, in place: gcc then finds registers for all */
    b &= 0xFFFFU;
    const uint32_t middle = a1 * b + (a * b >> 16);
    const uint32_t both_middles = a * b1 + (middle & 0xFFFFU);
    return a1 * b1 + (middle >> 16) + (both_middles >> 16);
}
#endif

#if !MCP_ASDF_HAS_CLZ && !MCP_ASDF_SHIFT_BYTES && MCP_ASDF_DIVIDE != MCP_ASDF_DIVIDE_BY_INCLUDER
#if MCP_ASDF_SPLIT_MULTIPLY /* such cores have few registers, and better call the function */
#define ZEROS WARM
#else
#define ZEROS HOT
#endif
/* Returns the number of leading zeros of value > 0, or 31 for 0, by bisection: if the upper 16 bits are 0,
 * the lower ones take their place and 16 zeros are counted; then the same with 8 bits of these, 4 and 2. */
ZEROS uint32_t leading_zeros(uint32_t value)
{
    uint32_t zeros = 0;
    if (value >> 16 == 0U) {
        value <<= 16;
        zeros = 16;
    }
    if (value >> 24 == 0U) {
        value <<= 8;
        zeros += 8U;
    }
    if (value >> 28 == 0U) {
        value <<= 4;
        zeros += 4U;
    }
    if (value >> 30 == 0U) {
        value <<= 2;
        zeros += 2U;
    }
    return zeros + (~value >> 31); /* one more if the highest bit is not set */
}
#endif

#if MCP_ASDF_DIVIDE == MCP_ASDF_DIVIDE_BY_TABLE
/* Reciprocals 1 / y of y in [1/2, 1], in 64 steps: 256 / y - 255, which fits in a byte, rounded, at the
 * middle y of each step. The last entry is for y = 1. */
static const uint8_t reciprocals[65] MCP_ASDF_ROM = {
    253, 245, 238, 230, 223, 216, 210, 203, 197, 191, 185, 179, 173, 168, 162, 157, 152,
    147, 142, 137, 133, 128, 124, 119, 115, 111, 107, 103, 99,  95,  92,  88,  85,  81,
    78,  74,  71,  68,  65,  62,  59,  56,  53,  50,  47,  44,  42,  39,  36,  34,  31,
    29,  26,  24,  22,  19,  17,  15,  12,  10,  8,   6,   4,   2,   1};

/* Returns 2^46 / d for d in [2^30, 2^31], at most 0.71 2^-13 of it too small, never too large: it is in
 * [2^15 - 4, 2^16]. With y = d / 2^31 this is 1 / y as Q15. The table has a reciprocal r of 8 bits, which one
 * Newton step improves: r (2 - y r). The result comes from below, as y is rounded up. */
ALWAYS_INLINE uint32_t prepare(uint32_t d)
{
    const uint32_t step = (d >> 24) - 64U; /* above 64 only where memory is damaged */
    const uint32_t index = step <= 64U ? step : 64U;
    const uint32_t r = 255U + (uint32_t)MCP_ASDF_READ_BYTE(&reciprocals[index]); /* Q8: [256, 508] */
    const uint32_t y = (d >> 8) + 1U;                                            /* Q23, rounded up */
    const uint32_t y_r = y * r;                                                  /* Q23 Q8 = Q31: 1 +- 2^-6 */
    const uint32_t two_minus_y_r = 0U - y_r; /* as Q31, where 2.0 is 2^32, and so 0 in 32 bits */
    return (r * (two_minus_y_r >> 9)) >> 15; /* Q8 Q22 = Q30 <= 2.0; then Q15 */
}
#endif

#if MCP_ASDF_DIVIDE == MCP_ASDF_DIVIDE_BY_TABLE || MCP_ASDF_DIVIDE == MCP_ASDF_DIVIDE_BY_INCLUDER
/* Returns the next digit of a quotient, rest 2^bits / d, from prepare(d) = 2^46 / d. It is formed as
 * (rest / 2^15) (2^46 / d) / 2^(31 - bits), whose product is < 2^32 for rest < 2 d. */
ALWAYS_INLINE uint32_t estimate_digit(uint32_t rest, uint32_t prepared, uint32_t bits)
{
    return ((rest >> 15) * prepared) >> (31U - bits);
}
#endif

#endif
