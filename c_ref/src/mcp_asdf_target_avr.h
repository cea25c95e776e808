/* The variants of cores whose registers have 8 bits, for mcp_asdf_target.h alone. */
#ifndef MCP_ASDF_TARGET_AVR_H
#define MCP_ASDF_TARGET_AVR_H

#ifdef __AVR__
/* A uint64_t and its two words, lower one first. avr-gcc calls a loop even for a shift by 32, so that words
 * are taken from memory instead. It is little-endian, and defines what another member of a union reads. */
typedef union {
    uint64_t both;
    uint32_t word[2];
} words_t;

/* high 2^32 + low. */
static inline uint64_t join(uint32_t high, uint32_t low)
{
    const words_t words = {.word = {low, high}};
    return words.both;
}

/* floor(value / 2^32). */
static inline uint32_t high_word(uint64_t value)
{
    const words_t words = {.both = value};
    return words.word[1];
}

#if !MCP_ASDF_SPLIT_MULTIPLY
/* a b. Not inlined: avr-gcc would then often multiply 64 by 64 bits. */
NOINLINE uint64_t multiply(uint32_t a, uint32_t b) { return (uint64_t)a * b; }
#endif
#endif

#if MCP_ASDF_SHIFT_BYTES
/* value 2^count modulo 2^32, count in [0, 31], first by whole bytes. Lemma shift_left_by. */
NOINLINE uint32_t shift_left_by(uint32_t value, uint8_t count)
{
    for (; count >= 8U; count = (uint8_t)(count - 8U)) { /* at most 3 turns */
        value <<= 8;
    }
    return value << count; /* a shift by at most 7 */
}

/* floor(value / 2^count), count in [0, 31], first by whole bytes. Lemma shift_right_by. */
NOINLINE uint32_t shift_right_by(uint32_t value, uint8_t count)
{
    for (; count >= 8U; count = (uint8_t)(count - 8U)) { /* at most 3 turns */
        value >>= 8;
    }
    return value >> count; /* a shift by at most 7 */
}

/* shift_left_by(), with a count in a word as on other targets. */
static inline uint32_t shift_left(uint32_t value, uint32_t count)
{
    return shift_left_by(value, (uint8_t)count);
}

/* shift_right_by(), with a count in a word as on other targets. */
static inline uint32_t shift_right(uint32_t value, uint32_t count)
{
    return shift_right_by(value, (uint8_t)count);
}

#if !MCP_ASDF_HAS_CLZ && MCP_ASDF_DIVIDE != MCP_ASDF_DIVIDE_BY_INCLUDER
/* Returns the number of leading zeros of value > 0, or 31 for 0: first those of whole bytes, then those in
 * the first byte that is not 0. */
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
#endif
#endif

#if MCP_ASDF_DIVIDE == MCP_ASDF_DIVIDE_BY_BITS
/* Returns floor(2^bits a / d) for bits 24 and 31, a < 2 d and d <= 2^31, which keeps a below 2^32. It is long
 * division bit by bit, from the highest. The quotient has bits + 1 bits, which are collected in bytes, as to
 * shift a byte takes a quarter of the time of a word. Lemma divide_by_bits. */
NOINLINE uint32_t divide_by_bits(uint32_t a, uint32_t d, uint8_t bits)
{
    uint32_t quotient = 0;
    uint8_t turns = (uint8_t)((bits & 7U) + 1U);                            /* bits of the first byte */
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
        quotient = (quotient << 8) | byte;
        turns = 8;
    }
    return quotient;
}

/* floor(2^24 a / d), in the range of divide_by_bits(). */
static inline uint32_t divide_24(uint32_t a, uint32_t d) { return divide_by_bits(a, d, 24); }
/* floor(2^31 a / d), likewise. */
static inline uint32_t divide_31(uint32_t a, uint32_t d) { return divide_by_bits(a, d, 31); }
#endif

#endif
