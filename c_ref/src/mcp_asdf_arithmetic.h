/* Shifts, products and quotients of the MCP-ASDF firmware, on top of what its target does its own way
 * (mcp_asdf_target.h). Private: only the firmware's own sources include it.
 *
 * Each function has one contract, which all variants meet to the bit: inputs, result, bound. [a, b) is the
 * range of the integer on the left; "Q32" is a value in units of 2^-32. Inputs outside the ranges, which only
 * damaged memory can bring about, give a meaningless result, but never a trap or an endless loop. "Lemma"
 * names the proof of a contract, for all arguments and every variant, in tests/proofs/arithmetic.py.
 */
#ifndef MCP_ASDF_ARITHMETIC_H
#define MCP_ASDF_ARITHMETIC_H

#include "mcp_asdf_target.h"

/* ---- Words and shifts ---------------------------------------------------------------------------------- */

/* value modulo 2^32. Lemma low_word. */
ALWAYS_INLINE uint32_t low_word(uint64_t value) { return (uint32_t)value; }

/* Returns a word whose highest bits are the lowest `count` bits of `value`, and whose other bits are 0; count
 * in [0, 31]. Lemma lowest_bits_to_top.
 *
 * That is value << (32 - count), but for a count of 0 this would be a shift by 32, which C leaves undefined.
 * So the word is shifted by 1 and then by 31 - count. count ^ 31 is 31 - count: in a number of 5 bits both
 * turn each 0 into a 1 and each 1 into a 0. */
ALWAYS_INLINE uint32_t lowest_bits_to_top(uint32_t value, uint32_t count)
{
    return shift_left(value << 1, count ^ 31U); /* for a count of 0: by 1 and by 31, which leaves 0 */
}

/* Returns a word whose lowest bits are the highest `count` bits of `value`, and whose other bits are 0; count
 * in [0, 31]. That is value >> (32 - count), in two shifts as above. Lemma highest_bits_to_bottom. */
ALWAYS_INLINE uint32_t highest_bits_to_bottom(uint32_t value, uint32_t count)
{
    return shift_right(value >> 1, count ^ 31U); /* for a count of 0: by 1 and by 31, which leaves 0 */
}

/* Returns floor(value / 2^count), count in [0, 63]; of other counts the lower 6 bits. Lemma
 * shift_right_64. */
ALWAYS_INLINE uint64_t shift_right_64(uint64_t value, uint32_t count)
{
    if ((count & 32U) != 0U) { /* by a whole word, then by the rest */
        value = high_word(value);
    }
    count &= 31U;
    /* What is left is a shift by 0 to 31, by which bits of the upper word cross into the lower one:
     *
     *     value                 high        |              low
     *     result        0 | high >> count   |   crossing | low >> count */
    const uint32_t high = high_word(value), crossing = lowest_bits_to_top(high, count);
    return join(shift_right(high, count), shift_right(low_word(value), count) | crossing);
}

/* high 2^32 + low, as two words: gcc multiplies them with fewer instructions than a uint64_t. */
typedef struct {
    uint32_t high, low;
} word_pair_t;

/* Returns value 2^count, count in [0, 31]; of other counts the lower 5 bits. Lemma shift_left_wide. */
ALWAYS_INLINE word_pair_t shift_left_wide(uint32_t value, uint32_t count)
{
    const uint32_t masked = count & 31U;
    const uint32_t complement = COMPLEMENT(count, masked); /* 31 - masked */
    /* The upper word gets the highest `masked` bits of the value: value >> (32 - masked), in shifts by 1 and
     * by 31 - masked, as no shift may be 32. The lower word gets the rest. */
    const word_pair_t shifted = {shift_right(value >> 1, complement), shift_left(value, masked)};
    return shifted;
}

/* Returns the upper word of value 2^count modulo 2^64, count in [0, 31]: the highest `count` bits of the
 * lower word cross into the bottom of the upper one. Lemma shifted_high_word. */
ALWAYS_INLINE uint32_t shifted_high_word(uint64_t value, uint32_t count)
{
    return shift_left(high_word(value), count) | highest_bits_to_bottom(low_word(value), count);
}

/* ---- Sums and quotients -------------------------------------------------------------------------------- */

/* Returns 1 - x for a share or a probability x > 0, both as Q32: 1.0 is 2^32, which is 0 in 32 bits. Lemma
 * one_minus. */
ALWAYS_INLINE uint32_t one_minus(uint32_t x) { return 0U - x; }

/* Add a term to *sum, which is written to memory before anything further begins. Else a compiler would add
 * all sums of a round side by side, for which a small core has too few registers. Lemma add. */
ALWAYS_INLINE void add(uint64_t *sum, uint64_t term)
{
    *sum += term;
    FENCE();
}

/* Returns a dividend (as `high`) and a divisor (as `low`) of 32 bits for divide_31(), for 0 <= a <= d, d > 0.
 * First a and d are shifted alike until the highest bit of d is set, by a whole word if the upper word of d
 * is 0, and then by the rest. The dividend is the upper word of a then. The divisor is half of the upper word
 * of d, rounded down, plus 1, and is in [2^30, 2^31]. Half of their quotient is at most 2^-31 + 2^-30 a / d
 * less than a / d, and never more. Lemma ratio. */
ALWAYS_INLINE word_pair_t ratio(uint64_t a, uint64_t d)
{
    if (high_word(d) == 0U) {
        a = join(low_word(a), 0); /* shifted left by 32; no bit is lost, as a <= d */
        d = join(low_word(d), 0);
    }
    const uint32_t shift = leading_zeros(high_word(d));
    const uint32_t dividend = shifted_high_word(a, shift), divisor = shifted_high_word(d, shift);
    /* The bits of d that are left out here are worth less than 1, so that the divisor is never too small. */
    const word_pair_t words = {dividend, (divisor >> 1) + 1U};
    return words;
}

/* Returns a / d as Q32, for d > 0 and 0 <= a <= d: at most 7 units too small, never too large, so that 1.0 is
 * below 2^32. Lemma quotient. */
SHARED uint32_t quotient(uint64_t a, uint64_t d)
{
    const word_pair_t words = ratio(a, d);
    /* 2^31 times a quotient by half of the divisor is 2^32 times that by all of it. */
    return divide_31(words.high, words.low);
}

/* ---- Hash --------------------------------------------------------------------------------------------- */

/* FNV-1a taken over words, from HASH_START: (hash xor word) times its prime, modulo 2^32. Lemma hash_word. */
#define HASH_START UINT32_C(0x811C9DC5)
ALWAYS_INLINE uint32_t hash_word(uint32_t hash, uint32_t word)
{
    return (hash ^ word) * UINT32_C(0x01000193);
}

/* ---- Alpha -------------------------------------------------------------------------------------------- */

/* The largest mantissa and shift of an alpha word, and the word of the largest alpha. */
#define ALPHA_MANTISSA_MAX UINT32_C(0xFFFFFF)
#define ALPHA_SHIFT_MAX 31U
#define ALPHA_MAX ((ALPHA_MANTISSA_MAX << 8) | ALPHA_SHIFT_MAX)

#endif
