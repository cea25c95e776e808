/* Words, shifts, products and quotients of the MCP-ASDF firmware. Private: only its own sources include
 * it. Everything that depends on a target is here.
 *
 * Each function has one contract, which all variants meet to the bit: inputs, result, bound. [a, b) is the
 * range of the integer on the left; "Q32" is a value in units of 2^-32. Inputs outside the ranges, which only
 * damaged memory can bring about, give a meaningless result, but never a trap or an endless loop. "Lemma"
 * names the proof of a contract, for all arguments and every variant, in tests/proofs/arithmetic.py.
 */
#ifndef MCP_ASDF_ARITHMETIC_H
#define MCP_ASDF_ARITHMETIC_H

#include <stdbool.h>
#include <stdint.h>

#include "mcp_asdf_rom.h"

/* ---- Choices: of speed and size, never of result ------------------------------------------------------ */

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
#error                                                                                                       \
    "MCP_ASDF_DIVIDE is out of range: choose MCP_ASDF_DIVIDE_BY_HARDWARE, _BY_TABLE, _BY_BITS or _BY_INCLUDER"
#endif

/* Whether 32 x 32 -> 64 bits are multiplied in halves: on cores without an instruction for it. */
#ifndef MCP_ASDF_SPLIT_MULTIPLY
#if defined(__ARM_ARCH_6M__) || defined(__ARM_ARCH_8M_BASE__)
#define MCP_ASDF_SPLIT_MULTIPLY 1
#else
#define MCP_ASDF_SPLIT_MULTIPLY 0
#endif
#endif
#if MCP_ASDF_SPLIT_MULTIPLY < 0 || MCP_ASDF_SPLIT_MULTIPLY > 1
#error "MCP_ASDF_SPLIT_MULTIPLY is out of range: choose 0 or 1"
#endif

/* Whether a shift is a loop of single bits, so that whole bytes are worth shifting first. */
#ifndef MCP_ASDF_SHIFT_BYTES
#ifdef __AVR__
#define MCP_ASDF_SHIFT_BYTES 1
#else
#define MCP_ASDF_SHIFT_BYTES 0
#endif
#endif
#if MCP_ASDF_SHIFT_BYTES < 0 || MCP_ASDF_SHIFT_BYTES > 1
#error "MCP_ASDF_SHIFT_BYTES is out of range: choose 0 or 1"
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
#if MCP_ASDF_HAS_CLZ < 0 || MCP_ASDF_HAS_CLZ > 1
#error "MCP_ASDF_HAS_CLZ is out of range: choose 0 or 1"
#endif

#ifdef __GNUC__
#define UNUSED __attribute__((unused)) /* no source needs all of this header */
#define ALWAYS_INLINE static inline __attribute__((always_inline))
#define NOINLINE static UNUSED __attribute__((noinline))
#else
#define UNUSED
#define ALWAYS_INLINE static inline
#define NOINLINE static
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

/* ---- Words -------------------------------------------------------------------------------------------- */

#if defined(__AVR__)
/* avr-gcc calls a loop even for a shift by 32. It is little-endian, and defines what another member reads. */
typedef union {
    uint64_t both;
    uint32_t word[2];
} words_t;

static inline uint64_t join(uint32_t high, uint32_t low)
{
    const words_t words = {.word = {low, high}};
    return words.both;
}

static inline uint32_t high_word(uint64_t value)
{
    const words_t words = {.both = value};
    return words.word[1];
}
#else
/* high 2^32 + low. Lemma join. */
ALWAYS_INLINE uint64_t join(uint32_t high, uint32_t low) { return (uint64_t)high << 32 | low; }

/* floor(value / 2^32). Lemma high_word. */
ALWAYS_INLINE uint32_t high_word(uint64_t value) { return (uint32_t)(value >> 32); }
#endif

/* value modulo 2^32. Lemma low_word. */
ALWAYS_INLINE uint32_t low_word(uint64_t value) { return (uint32_t)value; }

/* ---- Shifts ------------------------------------------------------------------------------------------- */

#if MCP_ASDF_SHIFT_BYTES
/* The same as below, in counts of a byte. Lemmas shift_left_by, shift_right_by. */
NOINLINE uint32_t shift_left_by(uint32_t value, uint8_t count)
{
    for (; count >= 8U; count = (uint8_t)(count - 8U)) { /* at most 3 turns */
        value <<= 8;
    }
    return value << count; /* a shift by at most 7 */
}

NOINLINE uint32_t shift_right_by(uint32_t value, uint8_t count)
{
    for (; count >= 8U; count = (uint8_t)(count - 8U)) { /* at most 3 turns */
        value >>= 8;
    }
    return value >> count; /* a shift by at most 7 */
}

static inline uint32_t shift_left(uint32_t value, uint32_t count)
{
    return shift_left_by(value, (uint8_t)count);
}

static inline uint32_t shift_right(uint32_t value, uint32_t count)
{
    return shift_right_by(value, (uint8_t)count);
}
#else
/* value 2^count modulo 2^32, and floor(value / 2^count), count in [0, 31]: callers mask what memory holds.
 * Lemmas shift_left, shift_right. */
ALWAYS_INLINE uint32_t shift_left(uint32_t value, uint32_t count) { return value << count; }
ALWAYS_INLINE uint32_t shift_right(uint32_t value, uint32_t count) { return value >> count; }
#endif

/* floor(value / 2^count), count in [0, 63]; of other counts the lower 6 bits. Lemma shift_right_64. */
ALWAYS_INLINE uint64_t shift_right_64(uint64_t value, uint32_t count)
{
    if ((count & 32U) != 0U) {
        value = high_word(value);
    }
    count &= 31U;
    const uint32_t high = high_word(value), crossing = shift_left(high << 1, count ^ 31U);
    return join(shift_right(high, count), shift_right(low_word(value), count) | crossing);
}

/* high 2^32 + low, in words apart, which gcc multiplies with fewer instructions. */
typedef struct {
    uint32_t high, low;
} word_pair_t;

/* value 2^count, count in [0, 31]; of other counts the lower 5 bits. Lemma shift_left_wide. */
ALWAYS_INLINE word_pair_t shift_left_wide(uint32_t value, uint32_t count)
{
    const uint32_t masked = count & 31U;
#ifdef __riscv /* whose shifts take the lower 5 bits of any count */
    const uint32_t complement = ~count & 31U;
#else
    const uint32_t complement = masked ^ 31U;
#endif
    const word_pair_t shifted = {shift_right(value >> 1, complement), shift_left(value, masked)};
    return shifted;
}

/* Upper word of value 2^count modulo 2^64, count in [0, 31]. Lemma upper. */
ALWAYS_INLINE uint32_t upper(uint64_t value, uint32_t count)
{
    return shift_left(high_word(value), count) | shift_right(low_word(value) >> 1, count ^ 31U);
}

/* Leading zeros of value > 0: [0, 31]; 31 for value = 0. Lemma leading_zeros. */
#if MCP_ASDF_DIVIDE == MCP_ASDF_DIVIDE_BY_INCLUDER /* has it */
#elif MCP_ASDF_HAS_CLZ
ALWAYS_INLINE uint32_t leading_zeros(uint32_t value) { return (uint32_t)__builtin_clz(value | 1U); }
#elif MCP_ASDF_SHIFT_BYTES
WARM uint32_t leading_zeros(uint32_t value)
{
    uint8_t zeros = 0;
    for (value |= 1U; (uint8_t)(value >> 24) == 0U; value <<= 8) { /* at most 3 turns */
        zeros = (uint8_t)(zeros + 8U);
    }
    for (uint8_t top = (uint8_t)(value >> 24); top < 0x80U; top = (uint8_t)(top << 1)) { /* at most 7 turns */
        ++zeros;
    }
    return zeros;
}
#else
#if MCP_ASDF_SPLIT_MULTIPLY /* cores with few registers */
WARM
#else
HOT
#endif
    uint32_t
    leading_zeros(uint32_t value)
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
    return zeros + (~value >> 31);
}
#endif

/* ---- Products ----------------------------------------------------------------------------------------- */

#if MCP_ASDF_SPLIT_MULTIPLY
WARM uint64_t multiply(uint32_t a, uint32_t b)
{
    const uint32_t a0 = a & 0xFFFFU, a1 = a >> 16, b0 = b & 0xFFFFU, b1 = b >> 16;
    const uint32_t low = a0 * b0;                          /* (2^16 - 1)^2 < 2^32, as are the others */
    const uint32_t middle = a1 * b0 + (low >> 16);         /* (2^16 - 1)^2 + 2^16 - 1 < 2^32 */
    const uint32_t middle2 = a0 * b1 + (middle & 0xFFFFU); /* the same */
    const uint32_t high = a1 * b1 + (middle >> 16) + (middle2 >> 16); /* upper word of a product < 2^64 */
    return join(high, middle2 << 16 | (low & 0xFFFFU));
}

WARM uint32_t multiply_high(uint32_t a, uint32_t b)
{
    const uint32_t a1 = a >> 16, b1 = b >> 16;
    a &= 0xFFFFU; /* in place: gcc then finds registers for all */
    b &= 0xFFFFU;
    const uint32_t middle = a1 * b + (a * b >> 16);
    const uint32_t middle2 = a * b1 + (middle & 0xFFFFU);
    return a1 * b1 + (middle >> 16) + (middle2 >> 16);
}
#else
/* a b, and floor(a b / 2^32): exact. Lemmas multiply, multiply_high. */
#ifdef __AVR__ /* where avr-gcc, inlining it, often multiplies 64 by 64 bits */
NOINLINE uint64_t multiply(uint32_t a, uint32_t b) { return (uint64_t)a * b; }
#else
ALWAYS_INLINE uint64_t multiply(uint32_t a, uint32_t b) { return (uint64_t)a * b; }
#endif
ALWAYS_INLINE uint32_t multiply_high(uint32_t a, uint32_t b) { return high_word(multiply(a, b)); }
#endif

/* *sum += term, in memory before anything further begins: the sums of a round, which a compiler would gladly
 * add side by side, are more than a small core has registers for. Lemma add. */
ALWAYS_INLINE void add(uint64_t *sum, uint64_t term)
{
    *sum += term;
#ifdef __GNUC__
    __asm__ volatile("" ::: "memory");
#endif
}

/* ---- Quotients ---------------------------------------------------------------------------------------- */

/* Long division. A digit of up to 13 bits is estimated from the upper bits of rest and divisor, never too
 * large and less than 2 too small, so the rest stays in [0, 2 d) and arithmetic modulo 2^32 gives it exactly.
 * The last rest corrects the quotient: it is the exact floor however the digits were estimated.
 *
 * take_digit(): the next `bits` <= 12 bits of a quotient, of which d = [2^30, 2^31] is the divisor, and
 * prepare(d) what all digits share. The rest is below 2 d before and after. Lemmas prepare, estimate_digit,
 * take_digit. */
#if MCP_ASDF_DIVIDE == MCP_ASDF_DIVIDE_BY_HARDWARE
ALWAYS_INLINE uint32_t prepare(uint32_t d) { return (d >> 15) + 1U; } /* > d / 2^15 */

/* rest 2^bits / d, as (rest / 2^(15 - bits)) / (d / 2^15). */
ALWAYS_INLINE uint32_t estimate_digit(uint32_t rest, uint32_t prepared, uint32_t bits)
{
    return (rest >> (15U - bits)) / prepared;
}
#elif MCP_ASDF_DIVIDE == MCP_ASDF_DIVIDE_BY_TABLE || MCP_ASDF_DIVIDE == MCP_ASDF_DIVIDE_BY_INCLUDER
#if MCP_ASDF_DIVIDE == MCP_ASDF_DIVIDE_BY_TABLE
/* 256 (1 / y - 1), rounded, and 1, at the middles y of 64 steps from 1/2 to 1, and at 1. */
static const uint8_t reciprocals[65] MCP_ASDF_ROM = {
    253, 245, 238, 230, 223, 216, 210, 203, 197, 191, 185, 179, 173, 168, 162, 157, 152,
    147, 142, 137, 133, 128, 124, 119, 115, 111, 107, 103, 99,  95,  92,  88,  85,  81,
    78,  74,  71,  68,  65,  62,  59,  56,  53,  50,  47,  44,  42,  39,  36,  34,  31,
    29,  26,  24,  22,  19,  17,  15,  12,  10,  8,   6,   4,   2,   1};

/* 2^46 / d, at most 0.71 2^-13 of it too small, never too large: [2^15 - 4, 2^16]. One Newton step r (2 - y
 * r) from below, as y = d / 2^31 is rounded up. */
ALWAYS_INLINE uint32_t prepare(uint32_t d)
{
    const uint32_t step = (d >> 24) - 64U; /* above 64 only where memory is damaged */
    const uint32_t r = 255U + (uint32_t)MCP_ASDF_READ_BYTE(&reciprocals[step <= 64U ? step : 64U]); /* Q8 */
    const uint32_t y_r = ((d >> 8) + 1U) * r; /* r is in [256, 508], so this is 1 +- 2^-6 as Q31 */
    return (r * ((0U - y_r) >> 9)) >> 15;     /* Q8 Q22 = Q30 <= 2.0; then Q15 */
}
#endif

/* rest 2^bits / d, as (rest / 2^15) (2^46 / d) / 2^(31 - bits); the product is < 2^32 for rest < 2 d. */
ALWAYS_INLINE uint32_t estimate_digit(uint32_t rest, uint32_t prepared, uint32_t bits)
{
    return ((rest >> 15) * prepared) >> (31U - bits);
}
#endif

#if MCP_ASDF_DIVIDE == MCP_ASDF_DIVIDE_BY_BITS
/* floor(2^bits a / d) for bits 24 and 31, a < 2 d and d <= 2^31, which keeps a below 2^32. Each byte of the
 * quotient is collected by itself: a shift of one takes a quarter of the time. Lemma divide_by_bits. */
NOINLINE uint32_t divide_by_bits(uint32_t a, uint32_t d, uint8_t bits)
{
    uint32_t quotient = 0;
    uint8_t turns = (uint8_t)((bits & 7U) + 1U);
    for (uint8_t bytes = (uint8_t)(bits / 8U + 1U); bytes != 0U; --bytes) { /* at most 4 */
        uint8_t byte = 0;
        for (; turns != 0U; --turns) { /* at most 8 */
            byte = (uint8_t)(byte << 1);
            if (a >= d) {
                a -= d;
                byte |= 1U;
            }
            a <<= 1; /* < 2 d */
        }
        quotient = quotient << 8 | byte;
        turns = 8;
    }
    return quotient;
}

static inline uint32_t divide_24(uint32_t a, uint32_t d) { return divide_by_bits(a, d, 24); }
static inline uint32_t divide_31(uint32_t a, uint32_t d) { return divide_by_bits(a, d, 31); }
#else
ALWAYS_INLINE uint32_t take_digit(uint32_t *rest, uint32_t d, uint32_t prepared, uint32_t bits)
{
    const uint32_t digit = estimate_digit(*rest, prepared, bits);
    *rest = (*rest << bits) - digit * d; /* modulo 2^32 */
    return digit;
}

/* floor(2^24 a / d) for a < 2 d and 2^29 <= d <= 2^31: below 2^25. The reciprocals begin at 2^30. Lemma
 * divide_24. */
SHARED uint32_t divide_24(uint32_t a, uint32_t d)
{
    if (MCP_ASDF_DIVIDE == MCP_ASDF_DIVIDE_BY_TABLE && d >> 30 == 0U) {
        a <<= 1;
        d <<= 1;
    }
    const uint32_t prepared = prepare(d), first = take_digit(&a, d, prepared, 12);
    const uint32_t second = take_digit(&a, d, prepared, 12);
    return (first << 12) + second + (uint32_t)(a >= d);
}

/* floor(2^31 a / d) for a < 2 d and 2^30 <= d <= 2^31: below 2^32. Lemma divide_31. */
ALWAYS_INLINE uint32_t divide_31(uint32_t a, uint32_t d)
{
    const uint32_t prepared = prepare(d), first = take_digit(&a, d, prepared, 12);
    const uint32_t second = take_digit(&a, d, prepared, 12), third = take_digit(&a, d, prepared, 7);
    return (first << 19) + (second << 7) + third + (uint32_t)(a >= d);
}
#endif

/* The upper 32 bits of 0 <= a <= d and half of those of d > 0, rounded up, for divide_24() and divide_31():
 * the dividend and the divisor, in that order. Their quotient is at most 2^-31 + 2^-30 a / d less than a / d,
 * and never more. Lemma ratio. */
ALWAYS_INLINE word_pair_t ratio(uint64_t a, uint64_t d)
{
    if (high_word(d) == 0U) {
        a = join(low_word(a), 0);
        d = join(low_word(d), 0);
    }
    const uint32_t shift = leading_zeros(high_word(d));
    const word_pair_t found = {upper(a, shift), (upper(d, shift) >> 1) + 1U};
    return found;
}

/* a / d as Q32, for d > 0 and 0 <= a <= d: at most 7 units too small, never too large. Lemma quotient. */
SHARED uint32_t quotient(uint64_t a, uint64_t d)
{
    const word_pair_t found = ratio(a, d);
    return divide_31(found.high, found.low);
}

/* ---- Hash --------------------------------------------------------------------------------------------- */

/* FNV-1a taken over words, from HASH_START: (hash xor word) times its prime, modulo 2^32. Lemma hash_word. */
#define HASH_START UINT32_C(0x811C9DC5)
ALWAYS_INLINE uint32_t hash_word(uint32_t hash, uint32_t word)
{
    return (hash ^ word) * UINT32_C(0x01000193);
}

/* ---- Alpha -------------------------------------------------------------------------------------------- */

/* The word of the largest alpha: mantissa ALPHA_MANTISSA_MAX, shift ALPHA_SHIFT_MAX. */
#define ALPHA_MANTISSA_MAX UINT32_C(0xFFFFFF)
#define ALPHA_SHIFT_MAX 31U
#define ALPHA_MAX (ALPHA_MANTISSA_MAX << 8 | ALPHA_SHIFT_MAX)

#endif
