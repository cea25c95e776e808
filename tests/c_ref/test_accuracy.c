/* White box: what depends on b_hat alone, and confidences on their grid. */
#include "white_box.h"

#define ALPHA_LARGEST_UNITS ((UINT64_C(1) << 55) - (UINT64_C(1) << 31))

static struct {
    uint32_t least, most;
} g_shifts = {255, 0}, g_squared_shifts = {255, 0}, edge_shifts = {255, 0}, lefts = {255, 0},
  rights = {255, 0};

#define EXTEND(range, value)                                                                                 \
    do {                                                                                                     \
        (range).least = (value) < (range).least ? (value) : (range).least;                                   \
        (range).most = (value) > (range).most ? (value) : (range).most;                                      \
    } while (0)

/* inverse_g, g_squared and the normal form of every mantissa, for a c that says something. */
static void check_accuracy(uint32_t c)
{
    const mcp_asdf_accuracy_t a = accuracy_of(c);
    const uint64_t g = (UINT64_C(1) << 32) - 2 * (uint64_t)c;
    const uint64_t mantissa = g << a.g_shift;
    GIVEN(c, a.edge_shift, a.odds_right);
    CHECK(a.c == c && a.inverted == 1);
    CHECK_EQUAL(mantissa >> 31, 1);
    CHECK_EQUAL(a.inverse_g, (UINT64_C(1) << 62) / mantissa + 1);
    CHECK(a.g_squared >> 31 == 1 && a.edge >> 31 == 1 && a.odds >> 31 == 1);
    CHECK(a.odds_left == 0 || a.odds_right == 0);
    EXTEND(g_shifts, a.g_shift);
    EXTEND(g_squared_shifts, a.g_squared_shift);
    EXTEND(edge_shifts, a.edge_shift);
    EXTEND(lefts, a.odds_left);
    EXTEND(rights, a.odds_right);
}

/* g^2 = g_squared 2^(-32 - g_squared_shift), at most two units of g_squared too small */
static void check_g_squared(uint32_t c)
{
    const mcp_asdf_accuracy_t a = accuracy_of(c);
    const uint64_t g = (UINT64_C(1) << 32) - 2 * (uint64_t)c;
    const uint64_t unit = g * g >> (32 - a.g_squared_shift); /* floor(g^2 / unit of g_squared) */
    GIVEN(c, unit, a.g_squared);
    CHECK(a.g_squared <= unit && unit - a.g_squared <= 1);
}

static void check_around(uint32_t c)
{
    for (uint32_t i = 0; i <= 4; ++i) {
        const uint32_t near = c - 2 + i;
        if (near >= MCP_ASDF_B_HAT_MIN && near <= C_MAX) {
            check_accuracy(near);
            check_g_squared(near);
        }
    }
}

/* "[0, 11]", "0 .. 23", "0 .. 22", "[-31, 8]": the header's ranges of the shifts, all of them reached */
static void shifts_cover_their_ranges(void)
{
    for (uint32_t bit = 12; bit < 31; ++bit) {
        const uint32_t power = UINT32_C(1) << bit;
        check_around(power);
        check_around(power + (power >> 1));
        check_around((uint32_t)(power * UINT64_C(6074000999) >> 32)); /* sqrt(2) */
        check_around((UINT32_C(1) << 31) - power);                    /* where g is a power of two */
    }
    check_around(C_MAX);
    for (int i = 0; i < 200000; ++i) {
        check_around(check_random_word() & TOTAL_MAX);
    }
    CHECK(g_shifts.least == 0 && g_shifts.most == 11);
    CHECK(g_squared_shifts.least == 0 && g_squared_shifts.most == 23);
    CHECK(edge_shifts.least == 0 && edge_shifts.most == 22);
    CHECK(lefts.least == 0 && lefts.most == 8);
    CHECK(rights.least == 0 && rights.most == 31);
}

/* |2 b_hat - 1| < 2^-12 says nothing, = 2^-12 does; then c = 2^32 - 1 puts every part at the end */
static void uninformative_exactly_below_the_limit(void)
{
    const uint32_t half = UINT32_C(1) << 31, distance = INFORMATIVE_G >> 1;
    CHECK_EQUAL(accuracy_of(half - distance).g_shift, 11);
    CHECK_EQUAL(accuracy_of(half + distance).g_shift, 11);
    for (uint32_t i = 0; i < 5; ++i) {
        const uint32_t near[] = {half - distance + 1, half - 1, half, half + 1, half + distance - 1};
        CHECK_EQUAL(accuracy_of(near[i]).g_shift, MCP_ASDF_UNINFORMATIVE);
        CHECK_EQUAL(accuracy_of(near[i]).c, UINT32_MAX);
    }
    CHECK(multiply_high(TOTAL_MIN, UINT32_MAX) >= TOTAL_MIN / 2);
    CHECK(multiply_high(TOTAL_MAX, UINT32_MAX) >= TOTAL_MAX / 2);
}

/* b_hat and 1 - b_hat differ in `inverted` only */
static void inverted_accuracies_are_alike(void)
{
    for (int i = 0; i < 20000; ++i) {
        const uint32_t b_hat = MCP_ASDF_B_HAT_MIN + check_random_word() % (TOTAL_MAX - MCP_ASDF_B_HAT_MIN);
        const mcp_asdf_accuracy_t low = accuracy_of(b_hat);
        mcp_asdf_t robot = robot_at(1, 0, 0 - b_hat);
        GIVEN(b_hat, 0, 0);
        CHECK(low.inverted == 1 && robot.accuracy.inverted == 0);
        CHECK(accuracy_current(&robot));
        robot.accuracy.inverted = 1;
        robot.b_hat = b_hat;
        CHECK(accuracy_current(&robot));
    }
}

/* "mantissa, [2^31, 2^32)", "shift, [0, 3]", "24 or 25 bits" at the ends of both operands */
static void square_of_ratio_is_normal(void)
{
    static const uint32_t operands[] = {0x80000000, 0x80000001, 0xB504F333,
                                        0xB504F334, 0xFFFFFFFE, 0xFFFFFFFF};
    for (size_t i = 0; i < COUNT(operands); ++i) {
        for (size_t j = 0; j < COUNT(operands); ++j) {
            uint32_t shift = 0;
            const uint32_t mantissa = square_of_ratio(operands[i], operands[j], &shift);
            GIVEN(operands[i], operands[j], mantissa);
            const uint64_t quotient = ((uint64_t)(operands[i] >> 1) << 24) / (operands[j] >> 1);
            CHECK(quotient >> 23 != 0 && quotient >> 25 == 0);
            CHECK(mantissa >> 31 == 1 && shift <= 3);
        }
    }
}

/* Units of alpha's bits, by the definition of binary32. */
static uint64_t units_of(uint32_t alpha)
{
    const uint64_t mantissa = (alpha & 0x7FFFFF) + (UINT32_C(1) << 23);
    const int32_t shift = (int32_t)(alpha >> 23) - 127 - 23 + 24;
    if (alpha >> 23 == 0 || shift < -23) {
        return 0; /* below 2^-24 */
    }
    return shift > 31 ? ALPHA_LARGEST_UNITS : shift < 0 ? mantissa >> -shift : mantissa << shift;
}

/* The largest number on the grid not above mantissa 2^exponent units. */
static uint64_t grid_below(uint64_t mantissa, int32_t exponent)
{
    if (exponent > 31) {
        return ALPHA_LARGEST_UNITS; /* mantissa >= 2^22 makes at least 2^54: see alpha_bits_at_the_cap */
    }
    uint64_t units = exponent < 0 ? mantissa >> -exponent : mantissa << exponent;
    uint32_t lost = 0;
    while (units >> lost >= UINT64_C(1) << 24) {
        ++lost;
    }
    units = units >> lost << lost;
    return units > ALPHA_LARGEST_UNITS ? ALPHA_LARGEST_UNITS : units;
}

/* "mantissa in [2^22, 2^25), exponent >= -22", "bits worth less than a unit go; exponent >= -23" */
static void alpha_bits_over_its_range(void)
{
    static const uint32_t mantissas[] = {0x400000, 0x400001,  0x7FFFFF,  0x800000,  0x800001,
                                         0xFFFFFF, 0x1000000, 0x1000001, 0x1FFFFFF, 0x1555555};
    for (int32_t exponent = -22; exponent <= 31; ++exponent) {
        for (size_t i = 0; i < COUNT(mantissas); ++i) {
            const uint32_t bits = alpha_bits(mantissas[i], exponent);
            GIVEN(mantissas[i], exponent, bits);
            CHECK_EQUAL(units_of(bits), grid_below(mantissas[i], exponent));
            CHECK(estimate_possible(0, bits));
        }
    }
}

/* "alpha = 24 bits shifted left by at most this": 2^55 - 2^31 units is the last that is kept as it is */
static void alpha_bits_at_the_cap(void)
{
    CHECK_EQUAL(alpha_bits(0xFFFFFF, 31), MCP_ASDF_ALPHA_MAX);
    CHECK_EQUAL(alpha_bits(0xFFFFFE, 31), MCP_ASDF_ALPHA_MAX - 1);
    CHECK_EQUAL(alpha_bits(0x1FFFFFF, 30), MCP_ASDF_ALPHA_MAX);
    CHECK_EQUAL(alpha_bits(0x7FFFFF, 32), MCP_ASDF_ALPHA_MAX - 1);
    CHECK_EQUAL(alpha_bits(0x400000, 32), alpha_bits(0x800000, 31));
    CHECK_EQUAL(alpha_bits(0x800000, 32), MCP_ASDF_ALPHA_MAX);
    CHECK_EQUAL(alpha_bits(0x1000000, 31), MCP_ASDF_ALPHA_MAX);
    CHECK_EQUAL(alpha_bits(0x400000, 33), MCP_ASDF_ALPHA_MAX);
    CHECK_EQUAL(alpha_bits(0x1FFFFFF, 100), MCP_ASDF_ALPHA_MAX);
}

/* "high 2^32 + low units, high < 2^23", "cut to it", "subnormal numbers lose everything": every exponent */
static void units_of_every_exponent(void)
{
    static const uint32_t fractions[] = {0, 1, 0x2AAAAA, 0x400000, 0x7FFFFE, 0x7FFFFF};
    for (uint32_t exponent = 0; exponent < 255; ++exponent) {
        for (size_t i = 0; i < COUNT(fractions); ++i) {
            const uint32_t alpha = exponent << 23 | fractions[i];
            mcp_asdf_sums_t sums = {0, 0, 0, 0, 0, 0};
            const bool entered = mcp_asdf_sums_add(&sums, MCP_ASDF_ONE, alpha);
            GIVEN(alpha, sums.alpha, units_of(alpha));
            CHECK_EQUAL(sums.alpha, units_of(alpha));
            CHECK_EQUAL(entered, units_of(alpha) != 0);
            CHECK_EQUAL(sums.count, entered);
            CHECK_EQUAL(sums.alpha_x_low, (sums.alpha & UINT32_MAX) << 23);
            CHECK_EQUAL(sums.alpha_x_high, sums.alpha >> 32 << 23);
            CHECK(sums.alpha <= ALPHA_LARGEST_UNITS && sums.alpha >> 32 < UINT32_C(1) << 23);
            CHECK_EQUAL(on_grid(alpha), exponent >= 126 && exponent <= 157);
        }
    }
}

int main(void)
{
    shifts_cover_their_ranges();
    uninformative_exactly_below_the_limit();
    inverted_accuracies_are_alike();
    square_of_ratio_is_normal();
    alpha_bits_over_its_range();
    alpha_bits_at_the_cap();
    units_of_every_exponent();
    return check_report();
}
