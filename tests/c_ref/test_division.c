/* White box: division in digits or bits. The oracle is the compiler's own 64-bit division. */
#include "white_box.h"

#define D_MIN (UINT32_C(1) << 30)
#define D_MAX (UINT32_C(1) << 31)
#define WORST_SEED UINT32_C(1124076800) /* where the reciprocal is 0.7 2^-13 too small, the most */

/* Divisors at the ends of the seeds' 64 intervals, beside them and within. */
static uint32_t divisor_near_end(uint32_t i)
{
    static const int32_t offsets[] = {-257, -256, -1, 0, 1, 255, 256, 257, 1 << 23};
    const int64_t d = (int64_t)D_MIN + ((int64_t)(i / COUNT(offsets)) << 24) + offsets[i % COUNT(offsets)];
    return d < D_MIN ? D_MIN : d > D_MAX ? D_MAX : (uint32_t)d;
}

#define ENDS (65 * 9)

static uint32_t random_divisor(void) { return D_MIN + (uint32_t)(check_random() >> 34); }

#if !MCP_ASDF_EIGHT_BIT
#if !MCP_ASDF_HARDWARE_DIVIDE
/* "256 (1 / y - 1), rounded, and 1, at the middles y of 64 steps from 1/2 to 1, and at 1": y = (129 + 2 i) /
 * 256 */
static void every_seed_is_rounded(void)
{
    for (uint32_t i = 0; i < 64; ++i) {
        const uint32_t y = 129 + 2 * i;
        GIVEN(i, 0, 0);
        CHECK_EQUAL(reciprocals[i], (2 * 256 * (256 - y) + y) / (2 * y) + 1);
    }
    CHECK_EQUAL(reciprocals[64], 1);
}

/* "at most 2^-13 of it too small, never too large: [2^15 - 4, 2^16]", for every divisor: its lowest 8 bits do
 * not matter, so the ends of each 256 divisors stand for all. The table's index stays in 0 .. 64. */
static void prepare_bounds_for_every_divisor(void)
{
    const uint64_t one = UINT64_C(1) << 46;
    for (uint64_t first = D_MIN; first <= D_MAX; first += 256) {
        const uint64_t last = first == D_MAX ? first : first + 255;
        const uint64_t prepared = prepare((uint32_t)first);
        GIVEN(first, prepared, 0);
        CHECK(prepared * last <= one && one - prepared * first <= one >> 13 && prepared >= (1 << 15) - 4 &&
              prepared <= 1 << 16);
    }
    for (uint32_t i = 0; i < 4096; ++i) {
        const uint32_t first = random_divisor() & ~UINT32_C(255);
        CHECK_EQUAL(prepare(first | (i & 255)), prepare(first));
    }
}
#else
/* "> divisor / 2^15" */
static void prepare_bounds_for_every_divisor(void)
{
    for (uint64_t step = D_MIN >> 15; step <= D_MAX >> 15; ++step) {
        const uint64_t last = step == D_MAX >> 15 ? D_MAX : ((step + 1) << 15) - 1;
        const uint64_t prepared = prepare((uint32_t)last);
        GIVEN(last, prepared, 0);
        CHECK(prepared << 15 > last && (prepared - 1) << 15 <= last);
    }
}
#endif

/* A digit is never too large, and the remainder it leaves is below 2 divisor. */
static void check_digit(uint64_t remainder, uint32_t d, uint32_t bits)
{
    const uint64_t estimate = digit((uint32_t)remainder, prepare(d), bits);
    GIVEN(remainder, d, bits);
    CHECK(estimate * d <= remainder << bits && remainder << bits < (estimate + 2) * d);
}

/* "never too large and less than 2 too small, so a remainder stays in [0, 2 divisor)"; "the product is < 2^32
 * for remainder < 2 divisor" */
static void digit_is_less_than_two_too_small(void)
{
    for (uint32_t i = 0; i <= ENDS; ++i) {
        const uint32_t d = i < ENDS ? divisor_near_end(i) : WORST_SEED;
        const uint64_t remainders[] = {0, 1, d - 1, d, d + 1, 2 * (uint64_t)d - 1, 2 * (uint64_t)d - 32768};
        for (uint32_t bits = 10; bits <= 12; ++bits) {
            for (size_t j = 0; j < COUNT(remainders); ++j) {
                check_digit(remainders[j], d, bits);
            }
        }
    }
    for (int i = 0; i < 1000000; ++i) {
        const uint32_t d = random_divisor();
        check_digit(check_random() % (2 * (uint64_t)d), d, 10 + (uint32_t)i % 3);
    }
}

static void digits_are_within_their_bounds(void)
{
#if !MCP_ASDF_HARDWARE_DIVIDE
    every_seed_is_rounded();
#endif
    prepare_bounds_for_every_divisor();
    digit_is_less_than_two_too_small();
}
#endif

static void check_divide(uint64_t a, uint32_t d)
{
    GIVEN(a, d, 0);
    if (a < d) {
        CHECK_EQUAL(divide((uint32_t)a, d), (a << 32) / d);
    }
}

static void check_divide_24(uint64_t a, uint32_t d)
{
    GIVEN(a, d, 24);
    if (a < 2 * (uint64_t)d) {
        CHECK_EQUAL(divide_24((uint32_t)a, d), (a << 24) / d);
    }
}

/* Numerators around each multiple of a digit: there an estimate that is one too small must be corrected, and
 * one too large would show. */
static void divide_at_every_digit_boundary(void)
{
    static const uint32_t units[] = {0, 10, 21}; /* lowest bits of the third, second and first digit */
    for (uint32_t i = 0; i < ENDS; i += 3) {
        const uint32_t d = divisor_near_end(i);
        for (uint32_t value = 0; value < 2048; value += 1 + (i & 1)) {
            for (size_t j = 0; j < COUNT(units); ++j) {
                const uint64_t a = ((uint64_t)value << units[j]) * d >> 32;
                check_divide(a, d);
                check_divide(a + 1, d);
            }
        }
    }
}

static void divide_24_at_every_digit_boundary(void)
{
    for (uint32_t i = 0; i < ENDS; i += 3) {
        const uint32_t d = divisor_near_end(i);
        for (uint32_t value = 0; value < 8192; value += 1 + (i & 1)) {
            const uint64_t a = ((uint64_t)value << 12) * d >> 24;
            check_divide_24(a, d);
            check_divide_24(a + 1, d);
            check_divide_24(((uint64_t)value * d >> 24) + 1, d);
        }
    }
}

/* "floor(a 2^32 / d) for a < d", "floor(a 2^24 / d) for a < 2 d" */
static void divide_at_the_ends_of_its_range(void)
{
    for (uint32_t i = 0; i <= ENDS; ++i) {
        const uint32_t d = i < ENDS ? divisor_near_end(i) : WORST_SEED;
        for (uint32_t near = 0; near < 64; ++near) {
            check_divide(near, d);
            check_divide(d - 1 - near, d);
            check_divide_24(near, d);
            check_divide_24(d - 32 + near, d);
            check_divide_24(2 * (uint64_t)d - 1 - near, d);
        }
    }
    for (int i = 0; i < 2000000; ++i) {
        const uint32_t d = random_divisor();
        check_divide(check_random() % d, d);
        check_divide_24(check_random() % (2 * (uint64_t)d), d);
    }
}

/* "rounded down and then by at most 2^3 too small", on divisors and numerators of one word. */
static void quotient_of_one_word(void)
{
    static const uint32_t divisors[] = {1,         2,         3,         255, 1 << 16, TOTAL_MIN - 1,
                                        TOTAL_MIN, TOTAL_MAX, UINT32_MAX};
    for (size_t i = 0; i < COUNT(divisors); ++i) {
        for (int j = 0; j < 2000; ++j) {
            const uint32_t whole = (uint32_t)(check_random() % divisors[i]);
            const uint64_t exact = ((uint64_t)whole << 32) / divisors[i];
            const uint64_t found = quotient(whole, divisors[i]);
            GIVEN(whole, divisors[i], found);
            CHECK(found <= exact && exact - found <= 8);
        }
    }
}

/* "a quotient of at most 1, which becomes less" */
static void quotient_of_one(void)
{
    for (uint32_t bit = 0; bit < 62; ++bit) {
        const uint64_t lowest = UINT64_C(1) << bit, highest = lowest + (lowest - 1);
        GIVEN(lowest, highest, 0);
        CHECK(quotient(lowest, lowest) >= UINT32_MAX - 8);
        CHECK(quotient(highest, highest) >= UINT32_MAX - 8);
    }
}

int main(void)
{
#if !MCP_ASDF_EIGHT_BIT
    digits_are_within_their_bounds();
#endif
    divide_at_every_digit_boundary();
    divide_24_at_every_digit_boundary();
    divide_at_the_ends_of_its_range();
    quotient_of_one_word();
    quotient_of_one();
    return check_report();
}
