/* White box: the words, shifts and products that everything else is made of. */
#include "white_box.h"

static const uint32_t ends[] = {0,          1,          2,          0x7FFF,     0x8000,     0xFFFF,
                                0x10000,    0x10001,    0x7FFFFFFF, 0x80000000, 0x80000001, 0xFFFF0000,
                                0xFFFF8000, 0xFFFFFFFE, 0xFFFFFFFF, 0x0000FFFE, 0xFFFE0001};

static void check_product(uint32_t a, uint32_t b)
{
    GIVEN(a, b, 0);
    CHECK_EQUAL(multiply(a, b), (uint64_t)a * b);
    CHECK_EQUAL(multiply_high(a, b), (uint64_t)a * b >> 32);
}

/* "(2^16 - 1)^2 + 2^16 - 1 < 2^32", "upper word of a product < 2^64" */
static void products_are_exact(void)
{
    for (size_t i = 0; i < COUNT(ends); ++i) {
        for (size_t j = 0; j < COUNT(ends); ++j) {
            check_product(ends[i], ends[j]);
        }
    }
    for (int i = 0; i < 200000; ++i) {
        check_product(check_random_word(), check_random_word());
    }
}

static void check_zeros(uint32_t value)
{
    GIVEN(value, 0, 0);
    CHECK_EQUAL(leading_zeros(value), plain_zeros(value));
}

/* "[0, 31]; 31 for value = 0": each length with every pattern of the 10 bits behind the first one, and those
 * below all 0 or all 1, where a conversion to binary32 might round up to the next length. */
static void leading_zeros_of_every_length(void)
{
    check_zeros(0);
    for (uint32_t length = 1; length <= 32; ++length) {
        const uint32_t first = UINT32_C(1) << (length - 1), below = length < 11 ? 0 : length - 11;
        for (uint32_t pattern = 0; pattern < 1024 && pattern << below < first; ++pattern) {
            check_zeros(first | pattern << below);
            check_zeros(first | pattern << below | ((UINT32_C(1) << below) - 1));
        }
        check_zeros(first - 1);
    }
    for (int i = 0; i < 100000; ++i) {
        check_zeros(check_random_word());
    }
}

static void check_shifts(uint32_t value, uint32_t count)
{
    GIVEN(value, count, 0);
    CHECK_EQUAL(shift_left(value, count), ((uint64_t)value << count) & UINT32_MAX);
    CHECK_EQUAL(shift_right(value, count), (uint64_t)value >> count);
}

/* "count in [0, 31]" */
static void shifts_by_every_count(void)
{
    for (uint32_t count = 0; count < 32; ++count) {
        for (size_t i = 0; i < COUNT(ends); ++i) {
            check_shifts(ends[i], count);
        }
        for (int i = 0; i < 500; ++i) {
            check_shifts(check_random_word(), count);
        }
    }
}

/* A pair of words with all ends in both places, then random ones. */
static uint64_t pair(uint32_t i)
{
    if (i >= COUNT(ends) * COUNT(ends)) {
        return check_random() >> (i & 63);
    }
    return (uint64_t)ends[i / COUNT(ends)] << 32 | ends[i % COUNT(ends)];
}

#define PAIRS (COUNT(ends) * COUNT(ends) + 256)

/* "count in [0, 63]; of other counts the lower 6 bits" */
static void long_shifts_by_every_count(void)
{
    for (uint32_t count = 0; count < 256; ++count) {
        for (uint32_t i = 0; i < PAIRS; ++i) {
            const uint64_t value = pair(i);
            GIVEN(value, count, 0);
            CHECK_EQUAL(shift_right_64(value, count), value >> (count & 63));
        }
    }
}

/* "Upper word of value 2^count modulo 2^64, count in [0, 31]" */
static void upper_at_every_shift(void)
{
    for (uint32_t count = 0; count < 32; ++count) {
        for (uint32_t i = 0; i < PAIRS; ++i) {
            const uint64_t value = pair(i);
            GIVEN(value, count, 0);
            CHECK_EQUAL(upper(value, count), value << count >> 32);
        }
    }
}

static void words_split_and_join(void)
{
    for (uint32_t i = 0; i < PAIRS; ++i) {
        const uint64_t whole = pair(i);
        GIVEN(whole, 0, 0);
        CHECK_EQUAL(high_word(whole), whole / (UINT64_C(1) << 32));
        CHECK_EQUAL(low_word(whole), whole % (UINT64_C(1) << 32));
        CHECK_EQUAL(join(high_word(whole), low_word(whole)), whole);
    }
}

int main(void)
{
    products_are_exact();
    leading_zeros_of_every_length();
    shifts_by_every_count();
    long_shifts_by_every_count();
    upper_at_every_shift();
    words_split_and_join();
    return check_report();
}
