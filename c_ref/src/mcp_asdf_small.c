/* The codec of small messages. mcp_asdf_small.h is the manual; docs/design.md gives the layout. */
#include "mcp_asdf_small.h"

#include "mcp_asdf_arithmetic.h"

/* Where the fields of the 32 bits begin, whose lowest 8 are the first byte: alpha at bit 0. */
#define SMALL_X_HAT_START 9U
#define SMALL_NODE_START 25U

/* A code of alpha is the beginning of these 32 bits: 5 of an exponent, then 27 of a fraction. */
#define ALPHA_EXPONENT_LENGTH 5U
#define ALPHA_FRACTION_LENGTH 27U
/* Confidences below 2^20 units of 2^-24, which is 2^-4, have the exponent 0. */
#define ALPHA_LINEAR_BITS 20U

/* ---- x_hat ------------------------------------------------------------------------------------------ */

/* Returns x_hat, which is Q23 up to 1.0, as a code of 1 to 23 bits: times the largest code, to nearest. */
uint32_t mcp_asdf_x_hat_to_code(uint32_t x_hat, uint32_t bits)
{
    const uint32_t largest_code = (UINT32_C(1) << bits) - 1U;
    /* x_hat << 8 is a Q31, and so is its product with the code; with the doubled code it is a Q32: < 2^56. */
    const uint64_t product = multiply(x_hat << 8, largest_code << 1);
    return high_word(product + (UINT64_C(1) << 31)); /* 1/2 is added to round to nearest */
}

/* Returns the x_hat nearest to a code of 1 to 23 bits divided by the largest such code, as Q23.
 *
 * The digits of code / (2^bits - 1) behind the binary point are those of the code, again and again, just as
 * 37 / 99 is 0.373737... in the decimal system. So the code is copied behind itself until there are 24
 * digits: the copies double in each turn. */
uint32_t mcp_asdf_x_hat_from_code(uint32_t code, uint32_t bits)
{
    uint32_t digits = code << (32U - bits);
    for (uint32_t length = bits; length < 24U; length *= 2U) { /* at most 5 turns */
        digits |= digits >> length;
    }
    /* The first 24 digits are rounded to 23: up if the 24th is 1. That is to nearest, since a quotient by an
     * odd number never lies halfway. 1.0 has only digits of 1, and is rounded up to 2^23. */
    return ((digits >> 8) + 1U) >> 1;
}

/* ---- alpha ------------------------------------------------------------------------------------------ */

/* Returns the 32 bits whose first bits are an alpha code, for an alpha word above 0: 5 bits of an exponent
 * and 27 of a fraction, like a float. The word's value is its mantissa (bits 31 to 8) times 2^shift (bits 4
 * to 0), in units of 2^-24. A value of up to 20 bits has the exponent 0, and the fraction is the value times
 * 2^7. A longer one has the exponent length - 20, and the fraction is what follows its highest bit. From 2^51
 * units on all 32 bits are 1. */
static uint32_t long_code_from_alpha(uint32_t alpha)
{
    /* ALPHA_SHIFT_MAX, 31, is also the mask of the 5 bits that hold the shift. */
    uint32_t mantissa = alpha >> 8;
    /* The number of bits of the value, if the highest of the mantissa's 24 bits is set. */
    uint32_t length = 24U + (alpha & ALPHA_SHIFT_MAX);
    /* Shift the mantissa until this bit is set. Each shift shows that the value has one bit less. */
    while (mantissa >> 23 == 0U) { /* at most 23 turns, so the length stays above 0 */
        mantissa <<= 1;
        --length;
    }
    if (length > ALPHA_LINEAR_BITS + 31U) { /* the exponent, of 5 bits, is 31 at most */
        return UINT32_MAX;
    }
    /* The highest bit moves from bit 23 to bit 27, with the fraction in the 27 bits below it: [2^27, 2^28) */
    const uint32_t significand = mantissa << (ALPHA_FRACTION_LENGTH - 23U);
    if (length <= ALPHA_LINEAR_BITS) {
        return significand >> (ALPHA_LINEAR_BITS + 1U - length); /* a shift by [1, 20]; below 2^27 */
    }
    /* The exponent is length - ALPHA_LINEAR_BITS. It enters less 1: the highest bit of the significand is
     * just above the fraction, and adds the 1. */
    return ((length - ALPHA_LINEAR_BITS - 1U) << ALPHA_FRACTION_LENGTH) + significand;
}

/* Returns the code of an alpha word in 1 to 25 bits: the first bits of its long code, so that it is rounded
 * down, but not to 0, which is the code of no confidence (alpha 0). */
uint32_t mcp_asdf_alpha_to_code(uint32_t alpha, uint32_t bits)
{
    const uint32_t mantissa = alpha >> 8;
    if (mantissa == 0U) { /* so alpha is 0, whatever the shift in the lower bits of the word */
        return 0;
    }
    const uint32_t code = long_code_from_alpha(alpha) >> (32U - bits);
    return code != 0U ? code : 1U;
}

/* Returns the alpha word that a code of 1 to 25 bits stands for, with the smallest shift: mantissa in bits 31
 * to 8, times 2 to the power of bits 4 to 0, in units of 2^-24. Exact for every code. Bits of `code` above
 * its length are ignored. */
uint32_t mcp_asdf_alpha_from_code(uint32_t code, uint32_t bits)
{
    const uint32_t long_code = code << (32U - bits);
    const uint32_t exponent = long_code >> ALPHA_FRACTION_LENGTH;
    /* The lowest 7 bits are 0 even in codes of 25 bits, so the shifts to the right are exact. */
    if (exponent == 0U) { /* the fraction is the value times 2^7, and the value a mantissa with shift 0 */
        return (long_code >> (ALPHA_FRACTION_LENGTH - ALPHA_LINEAR_BITS)) << 8;
    }
    /* The mantissa has 24 bits: the highest, which codes leave out, and 23 of the fraction. The shift to the
     * left drops the exponent; the shift to the right leaves 32 - 9 bits. */
    const uint32_t fraction = (long_code << ALPHA_EXPONENT_LENGTH) >> 9; /* [0, 2^23) */
    const uint32_t mantissa = (UINT32_C(1) << 23) | fraction;
    /* The value is mantissa 2^(exponent - 4) units. */
    return exponent < 4U ? (mantissa >> (4U - exponent)) << 8 : (mantissa << 8) | (exponent - 4U);
}

/* ---- Messages --------------------------------------------------------------------------------------- */

/* Write a message to 4 bytes, the lowest bits first: 9 bits of alpha's code, 16 of x_hat's, 7 of the node. In
 * the message x_hat is Q23 and alpha an alpha word; codes round them.
 * Returns OK; or ERR_SENDER if the node is above 127, else ERR_X_HAT if x_hat is above 1.0, and leaves the
 * bytes as they were. */
mcp_asdf_status_t mcp_asdf_encode_small(uint8_t bytes[MCP_ASDF_SMALL_BYTES],
                                        const mcp_asdf_small_message_t *message)
{
    if (message->node > MCP_ASDF_MAX_ID) {
        return MCP_ASDF_ERR_SENDER;
    }
    if (message->x_hat > MCP_ASDF_ONE) {
        return MCP_ASDF_ERR_X_HAT;
    }
    const uint32_t x_hat_code = mcp_asdf_x_hat_to_code(message->x_hat, MCP_ASDF_SMALL_X_HAT_BITS);
    const uint32_t alpha_code = mcp_asdf_alpha_to_code(message->alpha, MCP_ASDF_SMALL_ALPHA_BITS);
    const uint32_t word =
        ((uint32_t)message->node << SMALL_NODE_START) | (x_hat_code << SMALL_X_HAT_START) | alpha_code;
    bytes[0] = (uint8_t)word;
    bytes[1] = (uint8_t)(word >> 8);
    bytes[2] = (uint8_t)(word >> 16);
    bytes[3] = (uint8_t)(word >> 24);
    return MCP_ASDF_OK;
}

/* Read a message from 4 bytes, the lowest bits first: 9 bits of alpha's code, 16 of x_hat's, 7 of the node.
 * In the message x_hat is Q23 and alpha an alpha word. Any bytes are a valid message. */
void mcp_asdf_decode_small(mcp_asdf_small_message_t *message, const uint8_t bytes[MCP_ASDF_SMALL_BYTES])
{
    const uint32_t word =
        bytes[0] | ((uint32_t)bytes[1] << 8) | ((uint32_t)bytes[2] << 16) | ((uint32_t)bytes[3] << 24);
    message->node = (uint8_t)(word >> SMALL_NODE_START);
    /* Both decoders ignore the bits above their code. */
    message->x_hat = mcp_asdf_x_hat_from_code(word >> SMALL_X_HAT_START, MCP_ASDF_SMALL_X_HAT_BITS);
    message->alpha = mcp_asdf_alpha_from_code(word, MCP_ASDF_SMALL_ALPHA_BITS);
}
