/* What the core divides with in lanes: it has this header's leading_zeros() and prepare() in place of its
 * own, with the same contracts (mcp_asdf_arithmetic.h). Both come from binary32 numbers, which compilers turn
 * into vector instructions. For PCs only.
 */
#ifndef MCP_ASDF_LANES_ARITHMETIC_H
#define MCP_ASDF_LANES_ARITHMETIC_H

#include <stdint.h>

#ifdef __GNUC__
#define LANES_INLINE static inline __attribute__((always_inline))
#else
#define LANES_INLINE static inline
#endif

/* Returns the number of leading zeros of value > 0, or 31 for 0. They follow from the exponent of the value
 * as a binary32 number: this takes no instruction that AVX2 lacks.
 *
 * A float has 24 significant bits: a longer number may be rounded up to the next power of two, which has one
 * leading zero less. So in `sparse` each bit whose upper neighbour is set is cleared. That leaves the highest
 * set bit as it is, and no carry can reach it. The OR makes a value of 0 a 1, which has 31 leading zeros. */
LANES_INLINE uint32_t leading_zeros(uint32_t value)
{
    const uint32_t sparse = (value | 1U) & ~(value >> 1);
    const union {
        float number;
        int32_t bits;
    } as = {(float)(int32_t)sparse};
    /* A binary32 number in its 32 bits:
     *
     *     bit 31    bits 30 to 23                   bits 22 to 0
     *     sign      exponent, with 127 added        fraction
     *
     * For a highest set bit k in [0, 30] sign and exponent are 127 + k, and there are 31 - k leading zeros:
     * 158 less that. For k = 31 the conversion above has read a negative number: its sign bit counts 256, the
     * difference is negative, and there are 0 leading zeros. */
    const int32_t sign_and_exponent = (as.bits >> 23) & 0x1FF; /* 9 bits */
    const int32_t zeros = 158 - sign_and_exponent;
    return (uint32_t)(zeros > 0 ? zeros : 0) & 31U; /* the mask is there for analysers only */
}

/* Returns what estimate_digit() multiplies by in place of a division by d, which is in [2^29, 2^31]: 2^46 /
 * d, never too large, and too small by at most a share of 0.252 2^-13. All d were tried. */
LANES_INLINE uint32_t prepare(uint32_t d)
{
    const uint32_t least = UINT32_C(1) << 21; /* of d >> 8, but for damaged memory */
    const uint32_t y = d >> 8 > least ? d >> 8 : least;
    /* 2^46 / d = 2^38 / (d / 2^8). The divisor y + 2, at most 2^23 + 2, is exact as a float of 24 bits, but
     * larger than d / 2^8 by 1 to 2, so that the quotient stays too small when it is rounded to 24 bits. */
    const uint32_t divisor = y + 2U;
    return (uint32_t)(int32_t)(0x1p38F / (float)(int32_t)divisor);
}

#endif
