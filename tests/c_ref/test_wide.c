/* White box: products beyond 64 bits against the compiler's 128-bit integers. Skipped, visibly, without them.
 */
#include "white_box.h"

#ifndef __SIZEOF_INT128__
int main(void)
{
    printf("skipped: this compiler has no 128-bit integers for this target\n");
    return CHECK_SKIPPED;
}
#else
__extension__ typedef unsigned __int128 wide_t;

#define ONE_32 (UINT64_C(1) << 32)

/* A random number below 2^bits, every length equally likely. */
static uint64_t random_below(uint32_t bits)
{
    return check_random() >> (64 - bits) >> (check_random() % bits);
}

static void check_quotient(uint64_t whole, uint32_t fraction, uint64_t divisor)
{
    const wide_t scaled = (wide_t)whole << 32 | fraction;
    if (scaled <= (wide_t)divisor << 32) {
        const ratio_t found = ratio(whole, fraction, divisor);
        const uint64_t exact = (uint64_t)(scaled / divisor), error = exact - divide(found.a, found.d);
        const uint64_t short_error = (exact >> 9) - (divide_24(found.a, found.d) >> 1);
        GIVEN(whole, divisor, error);
        CHECK(found.a < found.d && found.d > UINT32_C(1) << 30 && found.d <= UINT32_C(1) << 31);
        CHECK(error <= 8 && short_error <= 1);
    }
}

/* The upper 31 bits of both numbers cost less than 2^32 (2^-30 + 2^-30) = 8 before the last rounding; one
 * word more or less in the divisor, and divisors around powers of two, are where bits can go wrong. */
static void ratio_at_every_length(void)
{
    for (uint32_t bit = 0; bit < 62; ++bit) {
        for (uint32_t i = 0; i < 20000; ++i) {
            const uint64_t divisor = (UINT64_C(1) << bit) + (bit == 0 ? 0 : random_below(bit));
            const uint64_t whole = i % 8 == 0 ? divisor - 1 : check_random() % divisor;
            check_quotient(whole, divisor >> 32 == 0 ? (uint32_t)check_random() : 0, divisor);
        }
    }
}

static void check_mean(uint64_t alpha, wide_t sum)
{
    const uint64_t high = (uint64_t)(sum >> 32), low = (uint64_t)sum & UINT32_MAX;
    const uint64_t moved =
        high < 1000 ? high : random_below(29) % high; /* part of it carried by the low sum */
    GIVEN(alpha, high, low);
    if (high - moved < UINT64_C(1) << 53) {
        CHECK_EQUAL(mean(alpha, moved << 32 | low, high - moved), (uint64_t)(sum / alpha));
    }
}

/* "the quotient's upper 23 bits are right or one too small; the remainder tells which": sums of every length,
 * at random, and just below, at and above each exact multiple */
static void mean_is_the_exact_quotient(void)
{
    for (uint32_t i = 0; i < 400000; ++i) {
        const uint64_t alpha = random_below(62) + 1, x = check_random() % MCP_ASDF_ONE;
        const wide_t exact = (wide_t)alpha * x;
        check_mean(alpha, exact);
        check_mean(alpha, exact + (alpha - 1));
        check_mean(alpha, exact + check_random() % alpha);
        check_mean(alpha, (wide_t)alpha * MCP_ASDF_ONE - (i & 1));
    }
    const uint64_t most =
        128 * ((UINT64_C(1) << 55) - (UINT64_C(1) << 31)); /* 127 neighbours and the robot */
    check_mean(most, (wide_t)most * MCP_ASDF_ONE);
    check_mean(most, (wide_t)most * MCP_ASDF_ONE - 1);
}

static uint32_t table[TABLE_HEADER + 2];
static const mcp_asdf_config_t adaptive = {table, 1, 1, MCP_ASDF_MEMORY_MAX, MCP_ASDF_ADAPTIVE};

static void set_table(uint32_t fraction_bits, uint32_t k)
{
    table[1] = TABLE_VERSION << 24 | UINT32_C(2) << 16 | fraction_bits << 8;
    table[TABLE_HEADER] = k; /* header and last entry are not read by the test */
    table[TABLE_HEADER + 1] = k;
}

static void check_test(mcp_asdf_t *robot, uint32_t fraction_bits, uint32_t k)
{
    const int64_t difference = (int64_t)robot->open.x - (int64_t)robot->open.count * robot->x_hat;
    const wide_t square = (wide_t)((uint64_t)(difference * difference));
    const wide_t spread =
        (wide_t)robot->open.count * robot->open.x_squared - (wide_t)robot->open.x * robot->open.x;
    set_table(fraction_bits, k);
    robot->config = &adaptive;
    GIVEN(fraction_bits, k, robot->open.count);
    CHECK_EQUAL(test_rejects(robot), square << fraction_bits > k * spread);
}

/* The largest k that rejects and the smallest that does not, where 32 bits can hold them. */
static void check_test_at_threshold(mcp_asdf_t *robot, uint32_t fraction_bits)
{
    const int64_t difference = (int64_t)robot->open.x - (int64_t)robot->open.count * robot->x_hat;
    const wide_t square = (wide_t)((uint64_t)(difference * difference));
    const wide_t spread =
        (wide_t)robot->open.count * robot->open.x_squared - (wide_t)robot->open.x * robot->open.x;
    const wide_t most = fraction_bits < 26 ? (UINT64_C(64) << fraction_bits) - 1 : UINT32_MAX - 1;
    const wide_t edge = spread == 0 ? most : (square << fraction_bits) / spread;
    for (uint32_t i = 0; i < 3; ++i) {
        const wide_t k = edge + i - (edge == 0 ? 0 : 1);
        check_test(robot, fraction_bits, (uint32_t)(k > most ? most : k));
    }
    check_test(robot, fraction_bits, (uint32_t)most);
    check_test(robot, fraction_bits, UINT32_C(1) << fraction_bits | 1);
}

/* Every F from 1 to 31, every m from 2 to 127, messages of one colour, of both and at random */
static void test_is_exact(void)
{
    for (uint32_t m = 2; m <= 127; ++m) {
        for (uint32_t i = 0; i < 60; ++i) {
            mcp_asdf_t robot = robot_at(1, 0, 0xC0000000);
            const uint32_t limit = i % 3 == 0 ? MCP_ASDF_ONE : 1 + check_random_word() % MCP_ASDF_ONE;
            for (uint32_t j = 0; j < m; ++j) {
                const uint32_t x = i % 3 == 0 ? (j & 1) * limit : (uint32_t)check_random() % (limit + 1);
                (void)mcp_asdf_sums_add(&robot.open, x, 0x3F800000);
            }
            robot.x_hat = i % 2 == 0 ? check_random_word() % (MCP_ASDF_ONE + 1) : MCP_ASDF_ONE;
            check_test_at_threshold(&robot, 1 + i % 31);
        }
    }
}

/* Never above the exact value of eq. 8, and less than 2^-29 below it: what ratio() loses in general would
 * be 9 units, but numerator and denominator share their low bits here (see check_quotient and
 * docs/design.md). */
static void reestimate_is_within_its_bound(void)
{
    for (uint32_t i = 0; i < 1000000; ++i) {
        const uint32_t t = check_random_word() % 0xFFFFFFFD + 1, rest = check_random_word() % MCP_ASDF_HALF;
        const uint32_t n = i % 2 == 0 ? (uint32_t)(check_random() % ((uint64_t)t + 1))
                                      : t - check_random_word() % (t / 2 + 1);
        const int64_t numerator = (int64_t)((uint64_t)n << 23) - (int64_t)((uint64_t)t * rest);
        const uint64_t denominator = (uint64_t)t * (MCP_ASDF_ONE - 2 * rest);
        mcp_asdf_t robot = robot_at(t, n, 0xC0000000);
        robot.closed_alpha = 1;
        robot.closed_alpha_x_low = MCP_ASDF_ONE - rest;
        CHECK(reestimate(&robot));
        GIVEN(t, n, rest);
        const wide_t scaled = numerator < 0 ? 0 : (wide_t)(uint64_t)numerator << 32;
        const wide_t found = (wide_t)robot.b_hat * denominator;
        CHECK(found <= scaled || robot.b_hat == MCP_ASDF_B_HAT_MIN);
        CHECK(scaled < found + 8 * (wide_t)denominator || robot.b_hat == MCP_ASDF_B_HAT_MAX);
    }
}

/* |computed 2^shift - exact| in parts of 2^-30 of the exact value, both products of docs/design.md section 7
 */
static void check_ratio(wide_t computed, wide_t exact, uint32_t below, uint32_t above)
{
    CHECK(computed >= exact - (exact >> 30) * below - below);
    CHECK(computed <= exact + (exact >> 30) * above + above);
}

/* edge: from 2^-22 + 3 2^-30 below to 2^-30 above (g / (1 - c))^2; odds: from 2^-22 + 4 2^-30 below to exact
 * ((1 - c) / c)^2 */
static void check_squares(uint32_t c)
{
    const mcp_asdf_accuracy_t a = accuracy_of(c);
    const uint64_t g = ONE_32 - 2 * (uint64_t)c, rest = ONE_32 - c;
    if (a.g_shift == MCP_ASDF_UNINFORMATIVE) {
        return;
    }
    GIVEN(c, a.edge, a.odds);
    /* edge 2^(-32 - edge_shift) (1 - c)^2 against g^2: 96 bits against at most 64 + 54 */
    check_ratio((wide_t)a.edge * rest * rest, (wide_t)(g * g) << (32 + a.edge_shift), 256 + 3, 1);
    /* odds 2^(odds_left - odds_right) c^2 against (1 - c)^2, both at most 96 bits */
    check_ratio(((wide_t)a.odds * c * c) << a.odds_left, (wide_t)rest * rest << a.odds_right, 256 + 4, 0);
}

static void squares_are_within_their_bounds(void)
{
    for (uint32_t bit = 12; bit < 31; ++bit) {
        for (uint32_t i = 0; i < 2000; ++i) {
            check_squares((UINT32_C(1) << bit) + (uint32_t)random_below(bit));
        }
    }
    check_squares(C_MAX);
}

/* Eq. 4 at an end: from 3 2^-22 + 11 2^-30 below the exact value to 2^-30 above. */
static void check_end(uint32_t c, uint32_t total, uint32_t part)
{
    const mcp_asdf_accuracy_t a = accuracy_of(c);
    const uint64_t rest_c = ONE_32 - c;
    int32_t exponent = 0;
    if (a.g_shift == MCP_ASDF_UNINFORMATIVE || !at_end(part, total, a.c)) {
        return;
    }
    const uint32_t mantissa = confidence_at_end(&a, part, total - part, &exponent);
    /* (g / (1 - c))^2 (rest + ((1 - c) / c)^2 part) as a double: 53 bits are plenty for bounds of 2^-30 */
    const double ratio = (double)(ONE_32 - 2 * (uint64_t)c) / (double)rest_c,
                 odds = (double)rest_c / (double)c;
    const double exact = ratio * ratio * ((double)(total - part) + odds * odds * (double)part);
    double found = (double)mantissa * 256; /* the result's unit is 2^8 of those of total */
    for (; exponent > 0; --exponent) {
        found *= 2;
    }
    for (; exponent < 0; ++exponent) {
        found /= 2;
    }
    GIVEN(c, total, part);
    CHECK(found <= exact * (1 + 1.0 / (1 << 30)) &&
          found >= exact * (1 - 3.0 / (1 << 22) - 11.0 / (1 << 30)));
}

/* Eq. 4 inside, for n / t = nu exactly: from 2^-22 + 2^-28 below to one unit of nu (1 - nu) above. */
static void check_inside(uint32_t c, uint32_t total, uint32_t nu)
{
    const mcp_asdf_accuracy_t a = accuracy_of(c);
    if (a.g_shift == MCP_ASDF_UNINFORMATIVE) {
        return;
    }
    int32_t exponent = 0;
    const uint32_t mantissa = confidence_inside(&a, nu, total, &exponent);
    const double g = 1 - (double)c / (double)(ONE_32 / 2), share = (double)nu / (double)ONE_32;
    const double exact = g * g * total / (share * (1 - share)),
                 unit = 1 / (share * (double)(ONE_32 - nu) - 1);
    double found = (double)mantissa * 256; /* the result's unit is 2^8 of those of total */
    for (; exponent > 0; --exponent) {
        found *= 2;
    }
    for (; exponent < 0; ++exponent) {
        found /= 2;
    }
    GIVEN(c, total, nu);
    CHECK(found <= exact * (1 + unit) && found >= exact * (1 - 1.0 / (1 << 22) - 1.0 / (1 << 28)));
}

static void confidence_inside_is_within_its_bound(void)
{
    for (uint32_t i = 0; i < 400000; ++i) {
        const uint32_t c = 0x1000 + check_random_word() % (C_MAX - 0x1000);
        const uint32_t total = TOTAL_MIN + (check_random_word() & (TOTAL_MIN - 1));
        check_inside(c, total, c);
        check_inside(c, total, UINT32_C(1) << 31);
        check_inside(c, total, c + check_random_word() % ((UINT32_C(1) << 31) - c));
    }
}

static void confidence_at_end_is_within_its_bound(void)
{
    for (uint32_t i = 0; i < 400000; ++i) {
        const uint32_t c = 0x1000 + check_random_word() % (C_MAX - 0x1000),
                       total = TOTAL_MIN + (check_random_word() & (TOTAL_MIN - 1));
        const uint32_t most = multiply_high(total, c);
        check_end(c, total, most);
        check_end(c, total, 0);
        check_end(c, total, check_random_word() % (most + 1));
    }
}

int main(void)
{
    ratio_at_every_length();
    mean_is_the_exact_quotient();
    test_is_exact();
    reestimate_is_within_its_bound();
    squares_are_within_their_bounds();
    confidence_at_end_is_within_its_bound();
    confidence_inside_is_within_its_bound();
    return check_report();
}
#endif
