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

/* Leading zeros of value > 0; 31 for 0. From the exponent of a binary32, without an instruction that AVX2
 * lacks. Where bit 31 is not set, clearing each bit that follows another one keeps the number from being
 * rounded up to the next power of two. */
LANES_INLINE uint32_t leading_zeros(uint32_t value)
{
    const uint32_t sparse = (value | 1U) & ~(value >> 1);
    const union {
        float number;
        int32_t bits;
    } as = {(float)(int32_t)sparse};
    const int32_t zeros = 158 - (as.bits >> 23 & 0x1FF); /* negative numbers, with bit 31 set: below 0 */
    return (uint32_t)(zeros > 0 ? zeros : 0) & 31U;      /* which is there for analysers only */
}

/* 2^46 / d, at most 0.252 2^-13 of it too small, never too large: all d were tried. */
LANES_INLINE uint32_t prepare(uint32_t d)
{
    const uint32_t y = d >> 8 > UINT32_C(1) << 21 ? d >> 8 : UINT32_C(1) << 21; /* less in damaged memory */
    const uint32_t above = y + 2U;
    return (uint32_t)(int32_t)(0x1p38F / (float)(int32_t)above);
}

#endif
