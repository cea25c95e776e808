/* The codec of small messages against the rules of docs/design.md, which are written here once more with
 * division and floating point. tests/firmware_py compares it with the codec in Python. */
#include "mcp_asdf_small.h"

#include "check.h"

#include <string.h>

#define UNITS_PER_ONE 16777216.0 /* of alpha */

static uint32_t largest_code(uint32_t bits) { return (UINT32_C(1) << bits) - 1; }

/* Returns one of at most 2^12 codes of so many bits, spread evenly and with the largest code. */
static uint32_t spread_code(uint32_t index, uint32_t bits)
{
    return bits <= 12 ? index & largest_code(bits) : index << (bits - 12) | (largest_code(bits) >> 12);
}

/* ---- x_hat ---- */

/* Distance between the numbers of a code and of x_hat, in units of 2^-23 / (2^bits - 1). */
static uint64_t distance_to_code(uint32_t x_hat, uint32_t code, uint32_t bits)
{
    const uint64_t from_x_hat = (uint64_t)x_hat * largest_code(bits), from_code = (uint64_t)code << 23;
    return from_x_hat > from_code ? from_x_hat - from_code : from_code - from_x_hat;
}

static void every_x_hat_gets_the_nearest_code(void)
{
    for (uint32_t x_hat = 0; x_hat <= MCP_ASDF_ONE; ++x_hat) {
        const uint32_t bits = x_hat % 23 + 1, code = mcp_asdf_x_hat_to_code(x_hat, bits);
        GIVEN(x_hat, bits, code);
        /* Neighbouring codes are 2^23 of these units apart. */
        CHECK(code <= largest_code(bits) && distance_to_code(x_hat, code, bits) <= MCP_ASDF_HALF);
    }
}

static void codes_of_x_hat_are_decoded_to_the_nearest_number(void)
{
    for (uint32_t bits = 1; bits <= MCP_ASDF_X_HAT_BITS_MAX; ++bits) {
        for (uint32_t index = 0; index < 4096; ++index) {
            const uint32_t code = spread_code(index, bits), x_hat = mcp_asdf_x_hat_from_code(code, bits);
            GIVEN(bits, code, x_hat);
            CHECK_EQUAL(x_hat, (uint32_t)(8388608.0 * code / largest_code(bits) + 0.5));
            CHECK_EQUAL(mcp_asdf_x_hat_to_code(x_hat, bits), code);
        }
    }
}

static void one_half_gets_the_larger_of_two_codes(void)
{
    for (uint32_t bits = 1; bits <= MCP_ASDF_X_HAT_BITS_MAX; ++bits) {
        CHECK_EQUAL(mcp_asdf_x_hat_to_code(MCP_ASDF_HALF, bits), UINT32_C(1) << (bits - 1));
    }
}

/* ---- alpha ---- */

static double value_of_word(uint32_t alpha)
{
    return (double)(alpha >> 8) * (double)(UINT32_C(1) << alpha % 32) / UNITS_PER_ONE;
}

/* Value of a code by docs/design.md: 2^-4 times a number whose exponent of 5 bits and fraction begin with the
 * code, and are 0 behind it. */
static double expected_value(uint32_t code, uint32_t bits)
{
    const double position = (double)code * 32.0 / (double)(UINT32_C(1) << bits);
    const uint32_t exponent = (uint32_t)position;
    const double fraction = position - exponent;
    return exponent == 0 ? fraction / 16 : (1 + fraction) * (double)(UINT32_C(1) << (exponent - 1)) / 16;
}

static void codes_of_alpha_are_decoded_exactly(void)
{
    for (uint32_t bits = 1; bits <= MCP_ASDF_ALPHA_BITS_MAX; ++bits) {
        for (uint32_t index = 0; index < 4096; ++index) {
            const uint32_t code = spread_code(index, bits), alpha = mcp_asdf_alpha_from_code(code, bits);
            GIVEN(bits, code, alpha);
            CHECK(value_of_word(alpha) == expected_value(code, bits));
            CHECK_EQUAL(mcp_asdf_alpha_to_code(alpha, bits), code);
            /* The smallest shift: either none, or a mantissa that fills its 24 bits. */
            CHECK((alpha & 0xFF) == 0 || alpha >> 31 == 1);
        }
    }
}

static void alpha_is_rounded_down_but_not_to_zero(void)
{
    for (uint32_t i = 0; i < 2000000; ++i) {
        const uint32_t alpha = check_random_word(), bits = i % 25 + 1;
        const uint32_t code = mcp_asdf_alpha_to_code(alpha, bits);
        const double value = value_of_word(alpha);
        GIVEN(alpha, bits, code);
        CHECK(code <= largest_code(bits) && (code == 0) == (value == 0));
        CHECK(code <= 1 || expected_value(code, bits) <= value);
        CHECK(code == 0 || code == largest_code(bits) || value < expected_value(code + 1, bits));
    }
}

static void the_largest_confidence_has_the_largest_code(void)
{
    CHECK_EQUAL(mcp_asdf_alpha_to_code(UINT32_MAX, 9), 511);
    CHECK(expected_value(511, 9) == 130023424.0); /* 31 2^22 */
}

/* ---- Messages ---- */

static void a_message_has_its_fields_from_the_lowest_bit_on(void)
{
    /* From node 42: x_hat 1, and alpha 1.0, whose code is 5 in the exponent and 0 behind it. */
    const mcp_asdf_small_message_t message = {42, MCP_ASDF_ONE, UINT32_C(0x80000001)};
    uint8_t bytes[MCP_ASDF_SMALL_BYTES];
    CHECK_EQUAL(mcp_asdf_encode_small(bytes, &message), MCP_ASDF_OK);
    CHECK(memcmp(bytes, "\x50\xFE\xFF\x55", 4) == 0);
}

static void encoding_what_was_decoded_gives_the_same_bytes(void)
{
    for (uint32_t i = 0; i < 2000000; ++i) {
        const uint32_t word = check_random_word();
        uint8_t bytes[MCP_ASDF_SMALL_BYTES], again[MCP_ASDF_SMALL_BYTES];
        mcp_asdf_small_message_t message;
        for (int index = 0; index < MCP_ASDF_SMALL_BYTES; ++index) {
            bytes[index] = (uint8_t)(word >> 8 * index);
        }
        mcp_asdf_decode_small(&message, bytes);
        GIVEN(word, message.x_hat, message.alpha);
        CHECK_EQUAL(message.node, word / 33554432);
        CHECK_EQUAL(mcp_asdf_encode_small(again, &message), MCP_ASDF_OK);
        CHECK(memcmp(bytes, again, sizeof bytes) == 0);
    }
}

static void values_out_of_range_are_refused_and_nothing_is_written(void)
{
    const mcp_asdf_small_message_t of_128 = {128, MCP_ASDF_ONE + 1, 0},
                                   above_one = {127, MCP_ASDF_ONE + 1, 0};
    uint8_t bytes[MCP_ASDF_SMALL_BYTES] = {1, 2, 3, 4};
    CHECK_EQUAL(-mcp_asdf_encode_small(bytes, &of_128), -MCP_ASDF_ERR_SENDER);
    CHECK_EQUAL(-mcp_asdf_encode_small(bytes, &above_one), -MCP_ASDF_ERR_X_HAT);
    CHECK(memcmp(bytes, "\1\2\3\4", 4) == 0);
}

/* The tests of few values come first: most mistakes fail one of them, and tests/mutation plants many. */
int main(void)
{
    one_half_gets_the_larger_of_two_codes();
    the_largest_confidence_has_the_largest_code();
    a_message_has_its_fields_from_the_lowest_bit_on();
    values_out_of_range_are_refused_and_nothing_is_written();
    codes_of_x_hat_are_decoded_to_the_nearest_number();
    codes_of_alpha_are_decoded_exactly();
    alpha_is_rounded_down_but_not_to_zero();
    encoding_what_was_decoded_gives_the_same_bytes();
    every_x_hat_gets_the_nearest_code();
    return check_report();
}
