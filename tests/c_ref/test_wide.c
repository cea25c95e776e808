/* White box: products beyond 64 bits against the compiler's 128-bit integers, and errors against exact
 * numbers. Skipped, visibly, where there are no such integers. */
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
static uint64_t random_bits(uint32_t bits)
{
    return check_random() >> (64 - bits) >> (check_random() % bits);
}

/* ---- Ratios: "at most 2^-31 + 2^-30 a / d less than a / d, and never more" ---- */

static void check_quotient(uint64_t a, uint64_t d)
{
    const uint64_t found = ratio(a, d), upper_a = found >> 32, twice_d = 2 * (found & UINT32_MAX);
    const wide_t exact = (wide_t)a * twice_d, less = (wide_t)upper_a * d; /* both over d twice_d */
    GIVEN(a, d, found);
    CHECK(less <= exact);
    CHECK(exact - less <= ((wide_t)d * twice_d >> 31) + ((wide_t)a * twice_d >> 30) + 2);
    CHECK_EQUAL(divide_31((uint32_t)upper_a, (uint32_t)(twice_d / 2)), (upper_a << 32) / twice_d);
}

static void ratios_are_within_their_bound(void)
{
    for (uint32_t bit = 0; bit < 62; ++bit) {
        for (uint32_t i = 0; i < 1500; ++i) {
            const uint64_t d = (UINT64_C(1) << bit) + (bit == 0 ? 0 : random_bits(bit));
            check_quotient(i % 8 == 0 ? d - i / 8 % 2 : check_random() % d, d);
        }
    }
}

/* ---- Means: "the exact quotient, rounded down" ---- */

/* The sums of a round with this sum of alpha x_hat; some of what belongs to the high sum is in the low one.
 */
static mcp_asdf_closed_t closed_with(uint64_t alpha, wide_t sum)
{
    const uint64_t high = (uint64_t)(sum >> 32), low = (uint64_t)sum & UINT32_MAX, limit = UINT64_C(1) << 29;
    const uint64_t moved = high < limit ? high : random_bits(29);
    const mcp_asdf_closed_t closed = {alpha, moved << 32 | low, high - moved};
    return closed;
}

static void check_informed(uint64_t alpha, wide_t sum, uint32_t x_hat, uint32_t own)
{
    const mcp_asdf_closed_t closed = closed_with(alpha, sum);
    const uint64_t own_units = (uint64_t)(own >> 8) << (own & 31);
    const wide_t whole = sum + (wide_t)own_units * x_hat;
    GIVEN(alpha, sum >> 32, own);
    if (alpha + own_units != 0) {
        CHECK_EQUAL(informed_estimate(&closed, x_hat, own), (uint64_t)(whole / (alpha + own_units)));
    }
}

/* Sums of every length, at random, and just below, at and above each exact multiple of 2^-23. */
static void informed_estimates_are_exact_quotients(void)
{
    for (uint32_t i = 0; i < 10000; ++i) {
        const uint64_t alpha = random_bits(61) + 1, x = check_random() % MCP_ASDF_ONE;
        const wide_t exact = (wide_t)alpha * x;
        check_informed(alpha, exact, MCP_ASDF_HALF, 0);
        check_informed(alpha, exact + (alpha - 1), MCP_ASDF_HALF, 0);
        check_informed(alpha, exact + check_random() % alpha, MCP_ASDF_HALF, 0);
        check_informed(alpha, (wide_t)alpha * MCP_ASDF_ONE - (i & 1), MCP_ASDF_HALF, 0);
        check_informed(alpha, exact + check_random() % alpha, random_below(MCP_ASDF_ONE + 1),
                       (uint32_t)check_random());
        check_informed(alpha >> 30, (wide_t)(alpha >> 30) * x, random_below(MCP_ASDF_ONE + 1),
                       check_random_word());
    }
    const wide_t most = MOST * ALPHA_MAX_UNITS;
    check_informed((uint64_t)most, most * MCP_ASDF_ONE, MCP_ASDF_ONE, ALPHA_MAX);
    check_informed((uint64_t)most, most * MCP_ASDF_ONE - 1, MCP_ASDF_ONE, ALPHA_MAX);
    check_informed((uint64_t)most, 0, 0, ALPHA_MAX);
    check_informed(0, 0, MCP_ASDF_ONE, 0x100);
}

/* ---- Test: eq. 12, "an integer compared with a real" ---- */

static uint32_t table[5] = {TABLE_MAGIC | 2, 1, 0, 0, 0};
static const mcp_asdf_config_t adaptive = {table, 1, MCP_ASDF_MEMORY_MAX, MCP_ASDF_ADAPTIVE};

/* 2^26 times the left side of eq. 12, and the right side without k. */
static void sides(const mcp_asdf_t *robot, wide_t *left, wide_t *right)
{
    const int64_t difference = (int64_t)robot->open.x - (int64_t)robot->open.count * robot->x_hat;
    *left = (wide_t)((uint64_t)(difference * difference)) << 26;
    *right = (wide_t)robot->open.count * robot->open.x_squared - (wide_t)robot->open.x * robot->open.x;
}

static void check_test(const mcp_asdf_t *robot, wide_t k)
{
    wide_t left, right;
    sides(robot, &left, &right);
    k = k > UINT32_MAX ? UINT32_MAX : k;
    table[2] = table[3] = (uint32_t)k; /* magic and checksum are not read by the test */
    GIVEN(k, robot->open.count, robot->x_hat);
    CHECK_EQUAL(test_rejects(robot), left > k * right);
}

/* Every m from 2 to 127, messages of one colour, of both and at random: the largest k that rejects and the
 * smallest that does not, where 32 bits can hold them, and the ends of k. */
static void test_is_exact(void)
{
    for (uint32_t m = 2; m <= MOST; ++m) {
        for (uint32_t i = 0; i < 30; ++i) {
            mcp_asdf_t robot = robot_with(&white_box_config, 127, 0xC0000000);
            const uint32_t limit = i % 3 == 0 ? MCP_ASDF_ONE : 1 + random_below(MCP_ASDF_ONE);
            for (uint8_t j = 0; j < m; ++j) {
                const uint32_t x = i % 3 == 0 ? (j & 1) * limit : (uint32_t)check_random() % (limit + 1);
                (void)mcp_asdf_receive(&robot, j, x, ALPHA_ONE);
            }
            robot.config = &adaptive;
            robot.x_hat = i % 2 == 0 ? random_below(MCP_ASDF_ONE + 1) : MCP_ASDF_ONE;
            wide_t left, right;
            sides(&robot, &left, &right);
            const wide_t edge = right == 0 ? 0 : left / right;
            check_test(&robot, edge == 0 ? 0 : edge - 1);
            check_test(&robot, edge);
            check_test(&robot, edge + 1);
            check_test(&robot, K_ONE + 1);
            check_test(&robot, UINT32_MAX);
        }
    }
}

/* ---- Re-estimate: eq. 8 ---- */

static uint64_t plain_upper_quotient(wide_t numerator, wide_t denominator)
{
    for (; denominator >> 64 != 0; denominator >>= 1) {
        numerator >>= 1;
    }
    for (; denominator >> 63 == 0; denominator <<= 1) {
        numerator <<= 1;
    }
    return (uint64_t)(((numerator >> 32) << 31) / ((denominator >> 33) + 1));
}

/* b_hat by docs/design.md, in any length; 0 for no update. */
static uint64_t plain_b_hat(uint32_t t, uint32_t n, uint64_t alpha, wide_t sum)
{
    const uint32_t more = alpha >> 32 == 0 ? 32 : 0; /* bits of the quotient that the units cannot hold */
    const uint64_t x_bar = plain_upper_quotient(sum << more >> 23, (wide_t)alpha << more);
    const uint64_t a = x_bar < ONE_HALF ? UINT32_MAX - x_bar : x_bar;
    const wide_t seen = (wide_t)(x_bar < ONE_HALF ? t - n : n) << 32;
    const wide_t least = (wide_t)t * (ONE_32 - a), most = (wide_t)t * a;
    if (2 * a - ONE_32 < INFORMATIVE) {
        return 0;
    }
    const uint64_t b_hat = seen <= least  ? 0
                           : seen >= most ? UINT32_MAX
                                          : plain_upper_quotient(seen - least, most - least);
    return b_hat < MCP_ASDF_B_HAT_MIN   ? MCP_ASDF_B_HAT_MIN
           : b_hat > MCP_ASDF_B_HAT_MAX ? MCP_ASDF_B_HAT_MAX
                                        : b_hat;
}

/* Less than 2^-29 / |2 x_bar - 1| above the exact value, and 2^-29 more than that below. x_bar is less than
 * 8 2^-32 off, or 1 - x_bar where that counts: the ratio loses 6 of them, its division and the fraction of
 * the sum one each. Eq. 8 multiplies that by at most 1 / |2 x_bar - 1| between the clamps, and its own ratio
 * and division lose 7 more. In double, whose error is below 2^-18 of that unit. */
static void check_b_hat(uint32_t b_hat, uint32_t t, uint32_t n, uint64_t alpha, uint64_t sum)
{
    const double x_bar = (double)sum / ((double)alpha * MCP_ASDF_ONE), g = 2 * x_bar - 1;
    const double exact = ((double)n / t + x_bar - 1) / g * (double)ONE_32;
    const double least = exact < (double)MCP_ASDF_B_HAT_MIN ? (double)MCP_ASDF_B_HAT_MIN : exact;
    const double clamped = least > (double)MCP_ASDF_B_HAT_MAX ? (double)MCP_ASDF_B_HAT_MAX : least;
    const double reach = 8 / (g < 0 ? -g : g) + 0.01;
    CHECK(b_hat <= clamped + reach && b_hat >= clamped - reach - 7);
}

static void check_reestimate(uint32_t t, uint32_t n, uint64_t alpha, wide_t sum)
{
    mcp_asdf_t robot = robot_with(&white_box_config, 0, 0xC0000000);
    const uint64_t expected = plain_b_hat(t, n, alpha, sum);
    robot.t = t;
    robot.n = n;
    robot.closed = closed_with(alpha, sum);
    GIVEN(t, n, alpha);
    CHECK_EQUAL(reestimate(&robot), expected != 0);
    CHECK_EQUAL(robot.accuracy.b_hat, expected == 0 ? 0xC0000000 : expected);
    if (expected != 0 && sum >> 53 == 0) {
        check_b_hat(robot.accuracy.b_hat, t, n, alpha, (uint64_t)sum);
    }
}

/* Any sums; x_bar near the ends, near 1/2 and anywhere; n near what makes b_hat 0, 1 and anything. */
static void reestimate_is_within_its_bound(void)
{
    for (uint32_t i = 0; i < 20000; ++i) {
        const uint64_t alpha = random_bits(i % 2 == 0 ? 30 : 61) + 1;
        const wide_t one = (wide_t)alpha * MCP_ASDF_ONE, part = one >> check_random() % 24;
        const uint32_t t = random_below(MCP_ASDF_MEMORY_MAX - 1) + 1;
        const wide_t sum = i % 3 == 0   ? part
                           : i % 3 == 1 ? one - part
                                        : one / 2 + (i % 2 == 0 ? part / 2 : 0) - (i % 2 == 0 ? 0 : part / 2);
        const uint32_t edge = (uint32_t)((double)t * (double)sum / (double)one);
        check_reestimate(t, (uint32_t)(check_random() % ((uint64_t)t + 1)), alpha, sum);
        check_reestimate(t, t - random_below(t / 2 + 1), alpha, sum);
        check_reestimate(t, edge > t ? t : edge, alpha, sum);
    }
}

/* ---- What follows from b_hat ---- */

/* `computed` is from `below` 2^-30 of `exact` below it to `above` 2^-30 above. */
static void check_relative(wide_t computed, wide_t exact, uint32_t below, uint32_t above)
{
    CHECK(computed >= exact - (exact >> 30) * below - below);
    CHECK(computed <= exact + (exact >> 30) * above + above);
}

/* common: from 2^-22 + 2^-28 below (g / (1 - c))^2, twice 2^-23 of a quotient and 2^-28 of its square, to
 * 2^-30 above, as 1 - c may lose its last bit; rare, with an even divisor, never above (g / c)^2. */
static void check_squares(uint32_t c)
{
    const mcp_asdf_t robot = robot_with(&white_box_config, 0, c);
    const mcp_asdf_accuracy_t *const a = &robot.accuracy;
    const uint64_t g = ONE_32 - 2 * (uint64_t)c, rest = ONE_32 - c, rare = (uint64_t)c << a->rare_shift / 2;
    const wide_t scaled = (wide_t)(g * g) << (30 + 2 * a->g_shift);
    GIVEN(c, a->common, a->rare);
    check_relative((wide_t)a->common * rest * rest, scaled, 256 + 4, 1);
    check_relative((wide_t)a->rare * rare * rare, scaled, 256 + 4, 0);
}

static void squares_are_within_their_bounds(void)
{
    for (uint32_t bit = 12; bit < 31; ++bit) {
        for (uint32_t i = 0; i < 1000; ++i) {
            const uint32_t c = (UINT32_C(1) << bit) + (uint32_t)random_bits(bit);
            check_squares(c < C_MAX ? c : C_MAX);
        }
    }
    check_squares(C_MIN);
    check_squares(C_MAX);
}

/* ---- Eq. 3 and 4: errors against exact numbers ---- */

/* On the nearer half of the scale x is rounded down to 2^-23, after at most 2^-31 / g + 2^-32 too much: c t
 * is rounded down by less than one in t >= 2^31, and half the divisor loses half a unit. */
static void check_x_hat(uint32_t t, uint32_t part, uint32_t c, uint32_t x)
{
    const wide_t g = ONE_32 - 2 * (uint64_t)c, divisor = g * t, found = (wide_t)x * divisor;
    const uint64_t seen = (uint64_t)part << 32, least = (uint64_t)c * t;
    if (seen <= least) {
        CHECK_EQUAL(x, 0);
    } else {
        const wide_t exact = (wide_t)(seen - least) << 23; /* over divisor, unit 2^-23 */
        CHECK(found + divisor > exact);
        CHECK(found <= exact + ((wide_t)t << 24) + (divisor >> 9));
        CHECK(x <= MCP_ASDF_HALF);
    }
}

/* Eq. 4 in double, whose error of less than 2^-49 is far below the limits. */
static double exact_alpha(double t, double part, double c)
{
    const double g = 1 - 2 * c;
    if (part > c * t) {
        return g * g * t * t * t / (part * (t - part));
    }
    return part * (g / c) * (g / c) + (t - part) * (g / (1 - c)) * (g / (1 - c));
}

/* Inside, g t is up to twice 2^-31 / g too large, and squared; the divisor of the quotient loses 2^-30. Its
 * 24 bits lose 2^-23, products of 32 bits less than 2^-26. At an end, the squares of quotients lose 2^-22 and
 * the mantissa 2^-23, and (1 - c)^2 is up to 2^-30 too small. Then down to the grid of 2^-24, and to the cap.
 */
static void check_alpha(uint32_t t, uint32_t part, uint32_t c, uint32_t alpha)
{
    const double found = (double)((uint64_t)(alpha >> 8) << (alpha & 31)) / (1 << 24);
    const double cap = 2147483520.0, exact = exact_alpha(t, part, (double)c / (double)ONE_32);
    const bool is_inside = (uint64_t)part << 32 > (uint64_t)c * t;
    const double unit = 1.0 / (1 << 30), g = 1 - (double)c / (double)ONE_HALF;
    const double above = is_inside ? (1 + unit / g) * (1 + unit / g) * (1 + unit) - 1 : unit;
    const double below = (is_inside ? 128 : 3 * 128) * unit + 16 * unit;
    const double least = (exact < cap ? exact : cap) * (1 - below) - 1.0 / (1 << 24);
    CHECK(found >= least && found <= exact * (1 + above) * (1 + unit / (1 << 18)) && found <= cap);
}

static void check_estimate(uint32_t t, uint32_t part, uint32_t c)
{
    if (part <= t / 2) {
        const mcp_asdf_t robot = robot_with(&white_box_config, 0, 0 - c);
        const message_t found = estimate(t, part, &robot.accuracy);
        GIVEN(t, part, c);
        check_x_hat(t, part, c, found.x_hat);
        check_alpha(t, part, c, found.alpha);
    }
}

static void estimates_are_within_their_bounds(void)
{
    for (uint32_t i = 0; i < 20000; ++i) {
        const uint32_t c =
            i % 5 == 0 ? C_MAX - random_below(C_MAX - C_MIN) : C_MIN + random_below(C_MAX - C_MIN);
        const uint32_t t = i % 7 == 0 ? MCP_ASDF_MEMORY_MAX - 1 - random_below(1000)
                                      : random_below(MCP_ASDF_MEMORY_MAX - 1) + 1;
        const uint32_t edge = (uint32_t)((uint64_t)c * t >> 32);
        check_estimate(t, 0, c);
        check_estimate(t, 1, c);
        check_estimate(t, edge, c);
        check_estimate(t, edge + 1, c);
        check_estimate(t, t / 2, c);
        check_estimate(t, random_below(t / 2 + 1), c);
        check_estimate(t, random_below(edge + 1), c);
        check_estimate(t, edge + random_below(t / 2 - edge + 1), c);
    }
}

int main(void)
{
    ratios_are_within_their_bound();
    informed_estimates_are_exact_quotients();
    test_is_exact();
    reestimate_is_within_its_bound();
    squares_are_within_their_bounds();
    estimates_are_within_their_bounds();
    return check_report();
}
#endif
