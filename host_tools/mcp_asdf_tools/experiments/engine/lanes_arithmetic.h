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
    } as = {(float)(int32_t)sparse}; /* its other member, as.bits, reads the bits of the number */
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

/* Prepare divisions by d, which is in [2^29, 2^31]: returns the reciprocal, 2^46 / d, with which
 * estimate_digit() multiplies in place of dividing. It is never too large, and too small by at most 0.252
 * 2^-13 of its value. All d were tried. */
LANES_INLINE uint32_t prepare(uint32_t d)
{
    /* Without its lowest 8 bits d is exact as a float, which has 24: 2^46 / d is about 2^38 / (d / 2^8). */
    const uint32_t upper_bits = d >> 8;
    /* Only damaged memory has less; the bound keeps the quotient within the numbers of 32 bits. */
    const uint32_t valid_min = UINT32_C(1) << 21;
    const uint32_t bounded_bits = upper_bits > valid_min ? upper_bits : valid_min;
    /* The lost bits are worth almost 1, and the quotient below may be rounded up: with 2 more in the divisor
     * it is never too large. */
    const uint32_t divisor = bounded_bits + 2U;
    /* Converted by way of signed numbers, for which AVX2 has instructions. */
    return (uint32_t)(int32_t)(0x1p38F / (float)(int32_t)divisor);
}

#endif
