/* White box: division in digits or bits, and ratios of long numbers. The oracle is the compiler's own 64-bit
 * division; products beyond 64 bits are checked in test_wide.c. */
#include "white_box.h"

#define D_MIN (UINT32_C(1) << 30)
#define D_MAX (UINT32_C(1) << 31)
#define HALF_MIN (UINT32_C(1) << 29)    /* of divide_24() */
#define WORST_SEED UINT32_C(1124076800) /* where the reciprocal is 0.7 2^-13 too small, the most */

/* Divisors at the ends of the table's 64 steps, beside them and within. */
static uint32_t divisor_near_end(uint32_t i)
{
    static const int32_t offsets[] = {-257, -256, -1, 0, 1, 255, 256, 257, 1 << 23};
    const int64_t d = (int64_t)D_MIN + ((int64_t)(i / COUNT(offsets)) << 24) + offsets[i % COUNT(offsets)];
    return d < D_MIN ? D_MIN : d > D_MAX ? D_MAX : (uint32_t)d;
}

#define ENDS (65 * 9)

static uint32_t random_divisor(void) { return D_MIN + (uint32_t)(check_random() >> 34); }

/* ---- Digits ---- */

#if MCP_ASDF_DIVIDE != MCP_ASDF_DIVIDE_BY_BITS
#if MCP_ASDF_DIVIDE == MCP_ASDF_DIVIDE_BY_TABLE
/* "256 (1 / y - 1), rounded, and 1, at the middles y of 64 steps from 1/2 to 1, and at 1": y = (129 + 2 i) /
 * 256 */
static void every_reciprocal_is_rounded(void)
{
    for (uint32_t i = 0; i < 64; ++i) {
        const uint32_t y = 129 + 2 * i;
        GIVEN(i, 0, 0);
        CHECK_EQUAL(reciprocals[i], (2 * 256 * (256 - y) + y) / (2 * y) + 1);
    }
    CHECK_EQUAL(reciprocals[64], 1);
}
#endif

#if MCP_ASDF_DIVIDE == MCP_ASDF_DIVIDE_BY_HARDWARE
/* "> d / 2^15" for every d: the lower 15 bits do not matter. */
static void prepare_bounds_for_every_divisor(void)
{
    for (uint64_t step = HALF_MIN >> 15; step <= D_MAX >> 15; ++step) {
        const uint64_t last = step == D_MAX >> 15 ? D_MAX : ((step + 1) << 15) - 1;
        const uint64_t prepared = prepare((uint32_t)last);
        GIVEN(last, prepared, 0);
        CHECK(prepared << 15 > last && (prepared - 1) << 15 <= last);
    }
}
#else
/* "2^46 / d, at most 0.71 2^-13 of it too small, never too large", in lanes 0.252 2^-13, for every d that it
 * is given: the lower 8 bits do not matter, so the ends of each 256 divisors stand for all. The table's index
 * stays in 0 .. 64. */
static void prepare_bounds_for_every_divisor(void)
{
    const uint64_t one = UINT64_C(1) << 46;
    const uint64_t most = MCP_ASDF_DIVIDE == MCP_ASDF_DIVIDE_IN_LANES ? 252 : 710; /* 2^-13 / 1000 */
    const uint64_t loss = most * (one >> 13) / 1000;
    const uint64_t least = MCP_ASDF_DIVIDE == MCP_ASDF_DIVIDE_IN_LANES ? HALF_MIN : D_MIN;
    uint32_t misses = 0; /* checked once, as there are millions of divisors */
    for (uint64_t first = least; first <= D_MAX; first += 256) {
        const uint64_t last = first == D_MAX ? first : first + 255;
        const uint64_t prepared = prepare((uint32_t)first);
        if (prepared * last > one || one - prepared * first > loss) {
            GIVEN(first, prepared, ++misses);
        }
    }
    CHECK_EQUAL(misses, 0);
    for (uint32_t i = 0; i < 4096; ++i) {
        const uint32_t first = random_divisor() & ~UINT32_C(255);
        CHECK_EQUAL(prepare(first | (i & 255)), prepare(first));
    }
}
#endif

/* Only damaged memory has other divisors: reciprocals stay those of an end of the range, so that no index or
 * conversion leaves its own. */
static void divisors_out_of_range_are_those_at_its_ends(void)
{
#if MCP_ASDF_DIVIDE == MCP_ASDF_DIVIDE_BY_TABLE
    for (uint32_t d = D_MAX; d >= D_MAX; d += UINT32_C(1) << 23) { /* until it wraps */
        const uint32_t y_r = ((d >> 8) + 1) * 256;
        GIVEN(d, 0, 0);
        CHECK_EQUAL(prepare(d), 256 * ((0 - y_r) >> 9) >> 15);
    }
#elif MCP_ASDF_DIVIDE == MCP_ASDF_DIVIDE_IN_LANES
    for (uint32_t d = 0; d < HALF_MIN; d += UINT32_C(1) << 20) {
        GIVEN(d, 0, 0);
        CHECK_EQUAL(prepare(d), prepare(HALF_MIN));
    }
#endif
}

/* A digit is never too large, and the rest it leaves is below 2 d: exactly what modulo 2^32 shows of it. */
static void check_digit(uint64_t rest, uint32_t d, uint32_t bits)
{
    uint32_t left = (uint32_t)rest;
    const uint64_t estimate = take_digit(&left, d, prepare(d), bits);
    GIVEN(rest, d, bits);
    CHECK(estimate * d <= rest << bits && rest << bits < (estimate + 2) * d);
    CHECK_EQUAL(left, (rest << bits) - estimate * d);
}

/* The same below 2^30, where divide_24() doubles the divisor first if there is a table. */
static void check_half_digit(uint64_t rest, uint32_t d, uint32_t bits)
{
    if (MCP_ASDF_DIVIDE != MCP_ASDF_DIVIDE_BY_TABLE && rest < 2 * (uint64_t)d) {
        check_digit(rest, d, bits);
    }
}

/* "never too large and less than 2 too small, so the rest stays in [0, 2 d)"; "the product is < 2^32 for rest
 * < 2 d". Digits of 7 and of 12 bits are what quotients are made of. */
static void digits_are_less_than_two_too_small(void)
{
    for (uint32_t i = 0; i <= ENDS; ++i) {
        const uint32_t d = i < ENDS ? divisor_near_end(i) : WORST_SEED;
        const uint64_t rests[] = {0, 1, d - 1, d, d + 1, 2 * (uint64_t)d - 1, 2 * (uint64_t)d - 32768};
        for (uint32_t bits = 7; bits <= 12; ++bits) {
            for (size_t j = 0; j < COUNT(rests); ++j) {
                check_digit(rests[j], d, bits);
                check_half_digit(rests[j] / 2, d / 2, bits);
            }
        }
    }
    for (int i = 0; i < 200000; ++i) {
        const uint32_t d = random_divisor();
        check_digit(check_random() % (2 * (uint64_t)d), d, i % 2 == 0 ? 12 : 7);
        check_half_digit(check_random() % d, d / 2, 12);
    }
}

static void digits_are_within_their_bounds(void)
{
#if MCP_ASDF_DIVIDE == MCP_ASDF_DIVIDE_BY_TABLE
    every_reciprocal_is_rounded();
#endif
    prepare_bounds_for_every_divisor();
    divisors_out_of_range_are_those_at_its_ends();
    digits_are_less_than_two_too_small();
}
#endif

/* ---- Quotients: "floor(2^31 a / d) for a < 2 d and 2^30 <= d <= 2^31", 2^24 also from 2^29 <= d on ---- */

static void check_quotients(uint64_t a, uint32_t d)
{
    GIVEN(a, d, 0);
    if (a < 2 * (uint64_t)d) {
        CHECK_EQUAL(divide_24((uint32_t)a, d), (a << 24) / d);
        CHECK_EQUAL(divide_31((uint32_t)a, d), (a << 31) / d);
    }
    a /= 2;
    d /= 2;
    if (a < 2 * (uint64_t)d) {
        CHECK_EQUAL(divide_24((uint32_t)a, d), (a << 24) / d);
    }
}

/* Dividends around each multiple of a digit: there an estimate that is one too small must be corrected, and
 * one too large would show. */
static void quotients_at_every_digit_boundary(void)
{
    static const uint32_t places[] = {12, 0, 19, 7}; /* of the digits of 24 bits, then of 31 */
    static const uint32_t bits[] = {24, 24, 31, 31};
    for (uint32_t i = 0; i < ENDS; i += 9) {
        const uint32_t d = divisor_near_end(i + i / 9 % 9);
        for (uint32_t value = i % 11; value < 8192; value += 11) {
            for (size_t j = 0; j < COUNT(places); ++j) {
                const uint64_t a = ((uint64_t)value << places[j]) * d >> bits[j];
                check_quotients(a, d);
                check_quotients(a + 1, d);
            }
        }
    }
}

static void quotients_at_the_ends_of_their_range(void)
{
    for (uint32_t i = 0; i <= ENDS; ++i) {
        const uint32_t d = i < ENDS ? divisor_near_end(i) : WORST_SEED;
        for (uint32_t near = 0; near < 32; ++near) {
            check_quotients(near, d);
            check_quotients(d - 16 + near, d);
            check_quotients(2 * (uint64_t)d - 1 - near, d);
        }
    }
    for (int i = 0; i < 200000; ++i) {
        const uint32_t d = random_divisor();
        check_quotients(check_random() % (2 * (uint64_t)d), d);
    }
}

/* ---- Ratios ---- */

/* "The upper 32 bits of d > 0 and of 0 <= a <= d, in the same places: the dividend in the upper word, and in
 * the lower word half the divisor, rounded up" */
static void check_ratio(uint64_t a, uint64_t d)
{
    const uint64_t found = ratio(a, d);
    uint64_t dividend = a, divisor = d;
    while (divisor >> 63 == 0) {
        dividend <<= 1;
        divisor <<= 1;
    }
    GIVEN(a, d, found);
    CHECK_EQUAL(found >> 32, dividend >> 32);
    CHECK_EQUAL(found & UINT32_MAX, (divisor >> 33) + 1);
    CHECK((found >> 32) < 2 * (found & UINT32_MAX)); /* what the divisions need */
}

static void ratios_of_every_length(void)
{
    for (uint32_t bit = 0; bit < 64; ++bit) {
        const uint64_t lowest = UINT64_C(1) << bit, highest = lowest + (lowest - 1);
        const uint64_t divisors[] = {lowest, lowest + lowest / 2, highest};
        for (size_t i = 0; i < COUNT(divisors); ++i) {
            check_ratio(0, divisors[i]);
            check_ratio(1, divisors[i]);
            check_ratio(divisors[i] / 2, divisors[i]);
            check_ratio(divisors[i] - 1, divisors[i]);
            check_ratio(divisors[i], divisors[i]);
        }
        for (int i = 0; i < 1000; ++i) {
            const uint64_t d = lowest | (check_random() & (lowest - 1));
            check_ratio(check_random() % d, d);
        }
    }
}

int main(void)
{
#if MCP_ASDF_DIVIDE != MCP_ASDF_DIVIDE_BY_BITS
    digits_are_within_their_bounds();
#endif
    quotients_at_every_digit_boundary();
    quotients_at_the_ends_of_their_range();
    ratios_of_every_length();
    return check_report();
}
