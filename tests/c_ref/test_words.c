/* White box: the words that everything else is made of. */
#include "white_box.h"

static const uint32_t ends[] = {0,          1,          2,          0x7FFF,     0x8000,     0xFFFF,
                                0x10000,    0x10001,    0x7FFFFFFF, 0x80000000, 0x80000001, 0xFFFF0000,
                                0xFFFF8000, 0xFFFFFFFE, 0xFFFFFFFF, 0x0000FFFE, 0xFFFE0001};

/* "(2^16 - 1)^2 + 2^16 - 1 < 2^32", "upper word of a product < 2^64" */
static void multiply_partial_products_fit(void)
{
    for (size_t i = 0; i < COUNT(ends); ++i) {
        for (size_t j = 0; j < COUNT(ends); ++j) {
            GIVEN(ends[i], ends[j], 0);
            CHECK_EQUAL(multiply(ends[i], ends[j]), (uint64_t)ends[i] * ends[j]);
            CHECK_EQUAL(multiply_high(ends[i], ends[j]), (uint64_t)ends[i] * ends[j] >> 32);
        }
    }
    for (int i = 0; i < 500000; ++i) {
        const uint32_t a = check_random_word(), b = check_random_word();
        GIVEN(a, b, 0);
        CHECK_EQUAL(multiply(a, b), (uint64_t)a * b);
        CHECK_EQUAL(multiply_high(a, b), (uint64_t)a * b >> 32);
    }
}

/* "a < 2^8 and b < 2^56" */
static void multiply_small_at_the_ends(void)
{
    const uint64_t most = (UINT64_C(1) << 56) - 1;
    for (uint32_t a = 0; a < 256; ++a) {
        for (size_t i = 0; i < COUNT(ends); ++i) {
            const uint64_t b = most - ((uint64_t)ends[i] << 8 | ends[COUNT(ends) - 1 - i] >> 24);
            GIVEN(a, b, 0);
            CHECK_EQUAL(multiply_small(a, b), a * b);
            CHECK_EQUAL(multiply_small(a, ends[i]), (uint64_t)a * ends[i]);
        }
    }
}

static void square_high_is_the_upper_word(void)
{
    for (size_t i = 0; i < COUNT(ends); ++i) {
        GIVEN(ends[i], 0, 0);
        CHECK_EQUAL(square_high(ends[i]), (uint64_t)ends[i] * ends[i] >> 32);
    }
    for (int i = 0; i < 1000000; ++i) {
        const uint32_t value = check_random_word();
        GIVEN(value, 0, 0);
        CHECK_EQUAL(square_high(value), (uint64_t)value * value >> 32);
    }
}

static uint32_t zeros_by_counting(uint32_t value)
{
    uint32_t zeros = 0;
    while (value >> 31 == 0) {
        value <<= 1;
        ++zeros;
    }
    return zeros;
}

/* "[0, 31]" */
static void leading_zeros_of_every_length(void)
{
    for (uint32_t bit = 0; bit < 32; ++bit) {
        const uint32_t lowest = UINT32_C(1) << bit, highest = lowest + (lowest - 1);
        GIVEN(lowest, highest, 0);
        CHECK_EQUAL(leading_zeros(lowest), 31 - bit);
        CHECK_EQUAL(leading_zeros(highest), 31 - bit);
        CHECK(bit < 30 || (leading_zero(lowest) == 31 - bit && leading_zero(highest) == 31 - bit));
    }
    for (int i = 0; i < 100000; ++i) {
        const uint32_t value = check_random_word() | 1;
        GIVEN(value, 0, 0);
        CHECK_EQUAL(leading_zeros(value), zeros_by_counting(value));
    }
}

/* "for a count in [0, 31]" */
static void shifts_by_every_count(void)
{
    for (uint32_t count = 0; count < 32; ++count) {
        for (size_t i = 0; i < COUNT(ends); ++i) {
            GIVEN(ends[i], count, 0);
            CHECK_EQUAL(shift_left(ends[i], count), ((uint64_t)ends[i] << count) & UINT32_MAX);
            CHECK_EQUAL(shift_right(ends[i], count), (uint64_t)ends[i] >> count);
        }
    }
}

/* "shift in [0, 31]; needs high < 2^(32 - shift)" */
static void upper_at_every_shift(void)
{
    for (uint32_t shift = 0; shift < 32; ++shift) {
        for (size_t i = 0; i < COUNT(ends); ++i) {
            const uint32_t high = UINT32_MAX >> shift, low = ends[i];
            GIVEN(high, low, shift);
            CHECK_EQUAL(upper(high, low, shift), (((uint64_t)high << 32 | low) << shift) >> 32);
            CHECK_EQUAL(upper(high >> 1, low, shift), (((uint64_t)(high >> 1) << 32 | low) << shift) >> 32);
        }
    }
}

static void add_saturating_stops_at_65535(void)
{
    for (uint32_t more = 0; more <= 254; ++more) {
        GIVEN(more, 0, 0);
        CHECK_EQUAL(add_saturating(0, more), more);
        CHECK_EQUAL(add_saturating((uint16_t)(65535 - more), more), 65535);
        CHECK_EQUAL(add_saturating((uint16_t)(65534 - more), more), 65534);
        CHECK_EQUAL(add_saturating(65535, more), 65535);
    }
    CHECK_EQUAL(add_saturating(65534, 2), 65535);
}

static void words_split_and_join(void)
{
    for (size_t i = 0; i < COUNT(ends); ++i) {
        const uint64_t whole = (uint64_t)ends[i] << 32 | ends[COUNT(ends) - 1 - i];
        CHECK_EQUAL(join(high_word(whole), low_word(whole)), whole);
        CHECK_EQUAL(high_word(whole), ends[i]);
    }
}

int main(void)
{
    multiply_partial_products_fit();
    multiply_small_at_the_ends();
    square_high_is_the_upper_word();
    leading_zeros_of_every_length();
    shifts_by_every_count();
    upper_at_every_shift();
    add_saturating_stops_at_65535();
    words_split_and_join();
    return check_report();
}
