/* What depends on the target. Private; all variants of a function have one contract, as mcp_asdf_arithmetic.h
 * explains. Those of this file are for cores with a 64-bit product and registers of 32 bits. */
#ifndef MCP_ASDF_TARGET_H
#define MCP_ASDF_TARGET_H

#include <stdint.h>

#include "mcp_asdf_rom.h"

/* ---- Choices: of speed and size, never of result ------------------------------------------------------- */

/* How quotients are estimated: with the target's divider; with a reciprocal from a table; bit by bit, on
 * cores with registers of eight bits; by prepare() and leading_zeros() of whoever includes the sources, such
 * as an engine on a host. */
#define MCP_ASDF_DIVIDE_BY_HARDWARE 1
#define MCP_ASDF_DIVIDE_BY_TABLE 2
#define MCP_ASDF_DIVIDE_BY_BITS 3
#define MCP_ASDF_DIVIDE_BY_INCLUDER 4

#ifndef MCP_ASDF_DIVIDE
#if defined(__AVR__)
#define MCP_ASDF_DIVIDE MCP_ASDF_DIVIDE_BY_BITS
#elif defined(__ARM_FEATURE_IDIV) || defined(__riscv_div) || defined(__x86_64__) || defined(__aarch64__)
#define MCP_ASDF_DIVIDE MCP_ASDF_DIVIDE_BY_HARDWARE
#else
#define MCP_ASDF_DIVIDE MCP_ASDF_DIVIDE_BY_TABLE
#endif
#endif
#if MCP_ASDF_DIVIDE < 1 || MCP_ASDF_DIVIDE > 4
#error "MCP_ASDF_DIVIDE is out of range: choose one of the four above, such as MCP_ASDF_DIVIDE_BY_TABLE"
#endif

/* Whether 32 x 32 -> 64 bits are multiplied in halves: on cores without an instruction for it. */
#ifndef MCP_ASDF_SPLIT_MULTIPLY
#if defined(__ARM_ARCH_6M__) || defined(__ARM_ARCH_8M_BASE__)
#define MCP_ASDF_SPLIT_MULTIPLY 1
#else
#define MCP_ASDF_SPLIT_MULTIPLY 0
#endif
#endif

/* Whether a shift is a loop of single bits, so that whole bytes are worth shifting first. */
#ifndef MCP_ASDF_SHIFT_BYTES
#ifdef __AVR__
#define MCP_ASDF_SHIFT_BYTES 1
#else
#define MCP_ASDF_SHIFT_BYTES 0
#endif
#endif

/* Whether the compiler has an instruction that counts leading zeros. */
#ifndef MCP_ASDF_HAS_CLZ
#if defined(__GNUC__) && MCP_ASDF_DIVIDE != MCP_ASDF_DIVIDE_BY_INCLUDER &&                                   \
    (defined(__ARM_FEATURE_CLZ) || defined(__x86_64__) || defined(__i386__))
#define MCP_ASDF_HAS_CLZ 1
#else
#define MCP_ASDF_HAS_CLZ 0
#endif
#endif

/* UNUSED: no source needs all of this header. FENCE(): what was written is in memory before anything
 * further. */
#ifdef __GNUC__
#define UNUSED __attribute__((unused))
#define ALWAYS_INLINE static inline __attribute__((always_inline))
#define NOINLINE static UNUSED __attribute__((noinline))
#define FENCE() __asm__ volatile("" ::: "memory")
#else
#define UNUSED
#define ALWAYS_INLINE static inline
#define NOINLINE static
#define FENCE()
#endif

/* HOT: what every tick runs is worth repeating wherever it stands, unless size counts. HOT_PUBLIC: the same
 * of a function that the header declares, and which stays a function of its own (clang has doubts about
 * that). SHARED: what several places run, which cores with few registers do better to call. WARM: what only
 * some ticks run is worth repeating only in engines that compute many robots side by side. */
#ifdef __OPTIMIZE_SIZE__
#define HOT static UNUSED
#else
#define HOT ALWAYS_INLINE
#endif
#if defined(__OPTIMIZE_SIZE__) || !defined(__GNUC__) || defined(__clang__)
#define HOT_PUBLIC
#else
#define HOT_PUBLIC inline __attribute__((always_inline))
#endif
#if defined(__OPTIMIZE_SIZE__) || MCP_ASDF_SPLIT_MULTIPLY
#define SHARED NOINLINE
#else
#define SHARED ALWAYS_INLINE
#endif
#if MCP_ASDF_DIVIDE == MCP_ASDF_DIVIDE_BY_INCLUDER
#define WARM ALWAYS_INLINE
#else
#define WARM static UNUSED
#endif

/* ---- Primitives ---------------------------------------------------------------------------------------- */

#include "mcp_asdf_target_avr.h"
#include "mcp_asdf_target_small.h"

#ifndef __AVR__
/* high 2^32 + low. Lemma join. */
ALWAYS_INLINE uint64_t join(uint32_t high, uint32_t low) { return (uint64_t)high << 32 | low; }

/* floor(value / 2^32). Lemma high_word. */
ALWAYS_INLINE uint32_t high_word(uint64_t value) { return (uint32_t)(value >> 32); }
#endif

#if !MCP_ASDF_SHIFT_BYTES
/* value 2^count modulo 2^32, and floor(value / 2^count), count in [0, 31]: callers mask what memory holds.
 * Lemmas shift_left, shift_right. */
ALWAYS_INLINE uint32_t shift_left(uint32_t value, uint32_t count) { return value << count; }
/* NOLINTNEXTLINE(clang-analyzer-core.BitwiseShift): no caller's count is above 31, by its lemma */
ALWAYS_INLINE uint32_t shift_right(uint32_t value, uint32_t count) { return value >> count; }
#endif

/* 31 - masked, where masked is count modulo 32: RISC-V's shifts take that of any count. */
#ifdef __riscv
#define COMPLEMENT(count, masked) (~(count) & 31U)
#else
#define COMPLEMENT(count, masked) ((masked) ^ 31U)
#endif

#if MCP_ASDF_HAS_CLZ && MCP_ASDF_DIVIDE != MCP_ASDF_DIVIDE_BY_INCLUDER /* which has its own */
/* Leading zeros of value > 0: [0, 31]; 31 for value = 0. Lemma leading_zeros. */
ALWAYS_INLINE uint32_t leading_zeros(uint32_t value) { return (uint32_t)__builtin_clz(value | 1U); }
#endif

#if !MCP_ASDF_SPLIT_MULTIPLY
#ifndef __AVR__
/* The product a b, and its upper word, floor(a b / 2^32): exact. Lemmas multiply, multiply_high. */
ALWAYS_INLINE uint64_t multiply(uint32_t a, uint32_t b) { return (uint64_t)a * b; }
#endif
ALWAYS_INLINE uint32_t multiply_high(uint32_t a, uint32_t b) { return high_word(multiply(a, b)); }
#endif

/* ---- Division ------------------------------------------------------------------------------------------ */

/* Long division, from the highest digit of the quotient to the lowest. A digit of up to 13 bits is estimated
 * from the upper bits of the rest and of the divisor d, never too large and less than 2 too small, so the
 * rest stays in [0, 2 d) and arithmetic modulo 2^32 gives it exactly. The last rest corrects the quotient: it
 * is the exact floor however the digits were estimated. prepare(d) is computed once for all digits; d is in
 * [2^29, 2^31], or in [2^30, 2^31] where prepare() takes a reciprocal from the table. Lemmas prepare,
 * take_digit. */
#if MCP_ASDF_DIVIDE == MCP_ASDF_DIVIDE_BY_HARDWARE
/* Returns what estimate_digit() divides by: a number above d / 2^15, so that no digit is too large. */
ALWAYS_INLINE uint32_t prepare(uint32_t d) { return (d >> 15) + 1U; }

/* Returns the next digit of a quotient, rest 2^bits / d, as (rest / 2^(15 - bits)) / (d / 2^15). */
ALWAYS_INLINE uint32_t estimate_digit(uint32_t rest, uint32_t prepared, uint32_t bits)
{
    return (rest >> (15U - bits)) / prepared;
}
#endif

#if MCP_ASDF_DIVIDE != MCP_ASDF_DIVIDE_BY_BITS
/* Returns the next digit of a quotient *rest / d, its next `bits` <= 12 bits, and updates *rest to what is to
 * be divided after them: below 2 d, before and after. Lemma take_digit. */
ALWAYS_INLINE uint32_t take_digit(uint32_t *rest, uint32_t d, uint32_t prepared, uint32_t bits)
{
    const uint32_t digit = estimate_digit(*rest, prepared, bits);
    *rest = (*rest << bits) - digit * d; /* both modulo 2^32; the difference is below 2^32 */
    return digit;
}

/* Returns floor(2^24 a / d), the quotient a / d as Q24, for a < 2 d and 2^29 <= d <= 2^31: below 2^25. Lemma
 * divide_24. */
SHARED uint32_t divide_24(uint32_t a, uint32_t d)
{
    if (MCP_ASDF_DIVIDE == MCP_ASDF_DIVIDE_BY_TABLE && d >> 30 == 0U) {
        a <<= 1; /* The reciprocals of the table begin at 2^30. Both are doubled: the quotient stays. */
        d <<= 1;
    }
    /* Two digits of 12 bits; each call leaves the rest in `a`. One more if the last rest is not below d. */
    const uint32_t prepared = prepare(d);
    const uint32_t first = take_digit(&a, d, prepared, 12);
    const uint32_t second = take_digit(&a, d, prepared, 12);
    return (first << 12) + second + (uint32_t)(a >= d);
}

/* Returns floor(2^31 a / d), the quotient a / d as Q31, for a < 2 d and 2^30 <= d <= 2^31: below 2^32. It has
 * digits of 12, 12 and 7 bits, and is one more if the rest is not below d. Lemma divide_31. */
ALWAYS_INLINE uint32_t divide_31(uint32_t a, uint32_t d)
{
    const uint32_t prepared = prepare(d);
    const uint32_t first = take_digit(&a, d, prepared, 12); /* each call leaves the rest in `a` */
    const uint32_t second = take_digit(&a, d, prepared, 12);
    const uint32_t third = take_digit(&a, d, prepared, 7);
    return (first << 19) + (second << 7) + third + (uint32_t)(a >= d);
}
#endif

#endif
