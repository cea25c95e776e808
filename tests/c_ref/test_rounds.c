/* White box: a round's sums, the test of eq. 12 and the re-estimate of eq. 8, at the ends of their ranges.
 * Sums and products beyond 64 bits are checked in test_wide.c. */
#include "white_box.h"

#define OWN_ID 127

static void fill_round(mcp_asdf_t *robot, uint8_t messages, uint32_t x_hat, uint32_t alpha)
{
    for (uint8_t sender = 0; sender < messages; ++sender) {
        CHECK_EQUAL(mcp_asdf_receive(robot, sender, x_hat, alpha), MCP_ASDF_OK);
    }
}

/* ---- Sums: eq. 5 and 6 ---- */

/* "+ 2^55", "+ 2^46", "+ 2^23" a message: 127 of the largest reach, and do not pass, the header's bounds. */
static void sums_of_127_largest_messages(void)
{
    mcp_asdf_t robot = robot_with(&white_box_config, OWN_ID, 0xC0000000);
    fill_round(&robot, MOST, MCP_ASDF_ONE, ALPHA_MAX);
    CHECK_EQUAL(robot.open.alpha, MOST * ALPHA_MAX_UNITS);
    CHECK(robot.open.alpha < UINT64_C(1) << 62 && robot.open.alpha_x_low < UINT64_C(1) << 62);
    CHECK_EQUAL(robot.open.alpha_x_high, MOST * UINT64_C(0x7FFFFF) << 23);
    CHECK(robot.open.alpha_x_high < UINT64_C(1) << 53 && robot.open.x_squared < UINT64_C(1) << 53);
    CHECK_EQUAL(robot.open.x_squared, (uint64_t)MOST << 46);
    CHECK(robot.open.x == MOST * MCP_ASDF_ONE && robot.open.x < UINT32_C(1) << 30);
    CHECK_EQUAL(robot.open.count, MOST);
}

/* The largest low word is 0xFFFFFF00, where a mantissa of 24 bits is shifted by 8. */
static void alpha_x_low_at_its_largest(void)
{
    mcp_asdf_t robot = robot_with(&white_box_config, OWN_ID, 0xC0000000);
    fill_round(&robot, MOST, MCP_ASDF_ONE, UINT32_C(0xFFFFFF08));
    CHECK_EQUAL(robot.open.alpha_x_low, MOST * UINT64_C(0xFFFFFF00) << 23);
    CHECK(robot.open.alpha_x_low < UINT64_C(1) << 62 && robot.open.alpha_x_high == 0);
}

/* Every sum, against plain ones; bits 7..5 of an alpha do not matter, and one without a mantissa enters no
 * sum. */
static void sums_are_those_of_the_messages(void)
{
    for (int i = 0; i < 300; ++i) {
        mcp_asdf_t robot = robot_with(&white_box_config, OWN_ID, 0xC0000000);
        mcp_asdf_open_t sums = {0, 0, 0, 0, 0, 0};
        for (uint8_t sender = 0; sender < 40; ++sender) {
            const uint32_t x = random_below(MCP_ASDF_ONE + 1);
            const uint32_t alpha = sender % 8 == 0 ? random_below(256) : (uint32_t)check_random();
            const uint64_t worth = (uint64_t)(alpha >> 8) << (alpha & 31);
            CHECK_EQUAL(mcp_asdf_receive(&robot, sender, x, alpha), MCP_ASDF_OK);
            if (worth != 0) {
                sums.alpha += worth;
                sums.alpha_x_low += worth % (UINT64_C(1) << 32) * x;
                sums.alpha_x_high += (worth >> 32) * x;
                sums.x_squared += (uint64_t)x * x;
                sums.x += x;
                ++sums.count;
            }
            GIVEN(x, alpha, sender);
            CHECK(memcmp(&robot.open, &sums, sizeof sums) == 0); /* it has no padding */
        }
    }
    CHECK_EQUAL(sizeof(mcp_asdf_open_t), 40);
}

/* ---- Means: eq. 5 and 7 ---- */

/* Whole and, with the own estimate, 128 largest confidences: the mean of equal numbers is that number. */
static void mean_of_equal_numbers(void)
{
    static const uint32_t xs[] = {
        0, 1, MCP_ASDF_HALF - 1, MCP_ASDF_HALF, 0x555555, MCP_ASDF_ONE - 1, MCP_ASDF_ONE};
    static const uint32_t alphas[] = {0x100,      0x200,      0x7FFFFF00, 0xFFFFFF00, 0xFFFFFF08,
                                      0x80000001, 0xFFFFFF09, 0xFFFFFF18, 0x8000001F, ALPHA_MAX};
    for (size_t i = 0; i < COUNT(xs); ++i) {
        for (size_t j = 0; j < COUNT(alphas); ++j) {
            mcp_asdf_t robot = robot_with(&white_box_config, OWN_ID, 0xC0000000);
            GIVEN(xs[i], alphas[j], 0);
            fill_round(&robot, MOST, xs[i], alphas[j]);
            CHECK_EQUAL(mcp_asdf_settle(&robot), MCP_ASDF_OK);
            CHECK_EQUAL(mcp_asdf_x_bar(&robot), xs[i]);
            robot.x_hat = xs[i];
            robot.alpha = ALPHA_MAX;
            CHECK_EQUAL(mcp_asdf_x(&robot), xs[i]);
            CHECK(mcp_asdf_beta(&robot) < UINT64_C(1) << 62);
        }
    }
}

/* The own confidence is one unit, has no bits above or none below bit 32, or is the largest. */
static void own_confidence_of_every_size(void)
{
    static const uint32_t alphas[] = {0x100, 0x7FFFFF00, 0x80000000, 0xFFFFFF08, 0x8000001F, ALPHA_MAX};
    static const uint64_t worth[] = {1, 0x7FFFFF, 0x800000, 0xFFFFFF00, UINT64_C(1) << 54, ALPHA_MAX_UNITS};
    for (size_t i = 0; i < COUNT(alphas); ++i) {
        mcp_asdf_t robot = robot_with(&white_box_config, OWN_ID, 0xC0000000);
        robot.x_hat = MCP_ASDF_ONE;
        robot.alpha = alphas[i];
        robot.closed.alpha = worth[i]; /* as much for 0 as for 1 */
        GIVEN(alphas[i], worth[i], 0);
        CHECK_EQUAL(mcp_asdf_x(&robot), MCP_ASDF_HALF);
        robot.closed.alpha = worth[i] + 1;
        CHECK_EQUAL(mcp_asdf_x(&robot),
                    worth[i] >> 24 != 0 ? MCP_ASDF_HALF - 1 : (worth[i] << 23) / (2 * worth[i] + 1));
    }
}

/* Without any confidence x is x_hat, and x_bar 1/2. */
static void no_confidence_at_all(void)
{
    mcp_asdf_t robot = robot_with(&white_box_config, OWN_ID, 0xC0000000);
    robot.x_hat = 12345;
    CHECK_EQUAL(mcp_asdf_x(&robot), 12345);
    CHECK_EQUAL(mcp_asdf_x_bar(&robot), MCP_ASDF_HALF);
    robot.alpha = 0x1F; /* a shift of nothing */
    CHECK_EQUAL(mcp_asdf_x(&robot), 12345);
    robot.closed.alpha = 1;
    CHECK_EQUAL(mcp_asdf_x(&robot), 0);
    CHECK_EQUAL(mcp_asdf_x_bar(&robot), 0);
}

static void check_mean(uint64_t alpha, uint64_t low, uint64_t high, uint32_t x)
{
    const mcp_asdf_closed_t closed = {alpha, low, high};
    GIVEN(alpha, low, high);
    CHECK_EQUAL(informed_estimate(&closed, MCP_ASDF_HALF, 0), x);
}

/* "the upper 23 bits are right or one too small": means just below and at each multiple of 2^-23 */
static void mean_at_multiples_of_its_unit(void)
{
    for (uint32_t i = 0; i < 20000; ++i) {
        const uint32_t x = random_below(MCP_ASDF_ONE), weight = random_below(0xFFFFFF) + 1;
        check_mean(weight, (uint64_t)x * weight, 0, x);
        check_mean(weight, (uint64_t)x * weight + (weight - 1), 0, x);
        check_mean(weight, (uint64_t)(x + 1) * weight, 0, x + 1);
        check_mean((uint64_t)weight << 32, 0, (uint64_t)x * weight, x);
        check_mean((uint64_t)weight << 32, UINT32_MAX, (uint64_t)x * weight + weight - 1, x);
        check_mean((uint64_t)weight << 32, UINT64_C(1) << 32, (uint64_t)(x + 1) * weight - 1, x + 1);
    }
}

/* ---- Test of eq. 12 ---- */

static uint32_t table[MCP_ASDF_MAX_ID + 3];
static const mcp_asdf_config_t adaptive = {table, 1, MCP_ASDF_MEMORY_MAX, MCP_ASDF_ADAPTIVE};
static const mcp_asdf_config_t always = {0, 1, MCP_ASDF_MEMORY_MAX, MCP_ASDF_ALWAYS};

/* A table whose entries fall from `first` by `step`. */
static void make_table(uint32_t q, uint32_t first, uint32_t step)
{
    uint32_t hash = HASH_START;
    table[0] = TABLE_MAGIC | q;
    table[1] = 1;
    for (uint32_t i = 0; i < q; ++i) {
        table[i + 2] = first - i * step;
    }
    for (uint32_t i = 0; i < q + 2; ++i) {
        hash = (uint32_t)((hash ^ table[i]) * (uint64_t)HASH_FACTOR & UINT32_MAX);
    }
    table[q + 2] = hash;
}

/* A robot at x_hat with a round of `low` messages of 0 and `high` messages of x. */
static mcp_asdf_t with_round(uint32_t x_hat, uint8_t low, uint8_t high, uint32_t x)
{
    mcp_asdf_t robot = robot_with(&adaptive, OWN_ID, 0xC0000000);
    robot.x_hat = x_hat;
    for (uint8_t i = 0; i < low + high; ++i) {
        CHECK_EQUAL(mcp_asdf_receive(&robot, i, i < low ? 0 : x, ALPHA_ONE), MCP_ASDF_OK);
    }
    return robot;
}

/* One message of 0 and one of x: spread = x^2, difference = |x - 2 x_hat|, so eq. 12 is (x - 2 x_hat)^2 > k
 * x^2. With k = 4 and x_hat = 3 x / 2 both sides are equal: no rejection. One unit further rejects, and a k
 * that is 2^-26 more does so no longer. */
static void threshold_is_strict(void)
{
    const uint32_t x = 0x300000;
    make_table(2, 4 * K_ONE, 1);
    CHECK(table_valid(table));
    mcp_asdf_t robot = with_round(3 * x / 2, 1, 1, x);
    CHECK(!test_rejects(&robot));
    ++robot.x_hat;
    CHECK(test_rejects(&robot));
    const uint32_t more = 8 * x + 4; /* (2 x + 2)^2 - 4 x^2, in units of x^2 2^-26: below 180 */
    make_table(2, 4 * K_ONE + (uint32_t)(((uint64_t)more << 26) / ((uint64_t)x * x)), 1);
    CHECK(test_rejects(&robot));
    make_table(2, 4 * K_ONE + (uint32_t)(((uint64_t)more << 26) / ((uint64_t)x * x)) + 1, 1);
    CHECK(!test_rejects(&robot));
}

/* All messages equal: no spread, so only the own estimate itself is not rejected. */
static void equal_messages_without_spread(void)
{
    make_table(2, UINT32_MAX, 1);
    for (uint8_t m = 2; m <= MOST - 1; ++m) {
        mcp_asdf_t robot = with_round(0x300000, 0, m, 0x300000);
        GIVEN(m, 0, 0);
        CHECK(!test_rejects(&robot));
        ++robot.x_hat;
        CHECK(test_rejects(&robot));
        robot.x_hat -= 2;
        CHECK(test_rejects(&robot));
    }
}

/* The largest root with root^2 <= value < 2^60. */
static uint64_t root_of(uint64_t value)
{
    uint64_t root = 0;
    for (uint64_t bit = UINT64_C(1) << 29; bit != 0; bit >>= 1) {
        root += (root + bit) * (root + bit) <= value ? bit : 0;
    }
    return root;
}

/* A round of m with a spread of about 2^26: the largest difference that does not reject under k, and the
 * next. */
static void check_entry(uint32_t m, uint32_t k)
{
    mcp_asdf_t robot = robot_with(&adaptive, OWN_ID, 0xC0000000);
    robot.x_hat = 0x10000;
    robot.open.count = m;
    for (uint32_t more = 0; more < 2; ++more) {
        const uint64_t difference = root_of(k) + more, x = m * UINT64_C(0x10000) + difference;
        robot.open.x = (uint32_t)x;
        robot.open.x_squared = (x * x + K_ONE) / m; /* spread is at most m - 1 below 2^26 */
        const uint64_t spread = m * robot.open.x_squared - x * x;
        CHECK_EQUAL(test_rejects(&robot), difference * difference > k * spread >> 26);
    }
}

/* The entries for m = 2, q, q + 1 and 127 are those at their places; neighbours differ by 1/32, the two
 * differences above by 1/1000 of k. */
static void entry_is_the_one_for_m(void)
{
    for (uint32_t q = 2; q <= MOST; q += q == 2 ? 1 : 31) {
        make_table(q, 6 * K_ONE, K_ONE / 32);
        CHECK(table_valid(table));
        for (uint32_t m = 2; m <= MOST; ++m) {
            GIVEN(q, m, 0);
            check_entry(m, table[m <= q ? m : q + 1]);
        }
    }
}

/* "< 2^30", "< 2^58", "< 2^64": m = 127, messages half 0 and half 1.0, the largest entry */
static void products_at_their_largest(void)
{
    make_table(2, UINT32_MAX, 1);
    CHECK(table_valid(table));
    mcp_asdf_t robot = with_round(MCP_ASDF_ONE, 64, 63, MCP_ASDF_ONE);
    const uint64_t spread = MOST * robot.open.x_squared - (uint64_t)robot.open.x * robot.open.x;
    CHECK_EQUAL(spread, UINT64_C(64) * 63 << 46);
    CHECK(spread < UINT64_C(1) << 58 && MOST * MCP_ASDF_ONE < UINT32_C(1) << 30);
    CHECK(!test_rejects(&robot));             /* 64^2 < k 64 63 for every k > 64/63 */
    make_table(2, K_ONE + K_ONE / 63 + 1, 1); /* of which the entry for m > 2 is one less */
    CHECK(test_rejects(&robot));
    make_table(2, K_ONE + K_ONE / 63 + 2, 1);
    CHECK(!test_rejects(&robot));
    make_table(2, UINT32_MAX, 1);
    robot.open.x_squared = ((uint64_t)robot.open.x * robot.open.x + MOST - 1) / MOST; /* hardly any spread */
    CHECK(test_rejects(&robot));
}

/* Exchanged colours leave the decision as it is, for k near the threshold. */
static void decisions_are_mirror_images(void)
{
    uint32_t rejections = 0;
    for (uint32_t i = 0; i < 20000; ++i) {
        const uint32_t m = 2 + i % 20, middle = random_below(MCP_ASDF_ONE / 2),
                       width = random_below(1U << 20) + 1;
        mcp_asdf_t robot = robot_with(&adaptive, OWN_ID, 0xC0000000), exchanged = robot;
        robot.x_hat = middle + random_below(3 * width);
        exchanged.x_hat = MCP_ASDF_ONE - robot.x_hat;
        for (uint8_t sender = 0; sender < m; ++sender) {
            const uint32_t x = middle + (uint32_t)check_random() % width;
            (void)mcp_asdf_receive(&robot, sender, x, ALPHA_ONE);
            (void)mcp_asdf_receive(&exchanged, sender, MCP_ASDF_ONE - x, ALPHA_ONE);
        }
        const double spread = (double)(m * robot.open.x_squared - (uint64_t)robot.open.x * robot.open.x);
        const double difference = (double)robot.open.x - (double)m * robot.x_hat;
        const double k = spread > 0 ? difference * difference / spread * K_ONE : K_ONE;
        make_table(2, k < K_ONE + 10 ? K_ONE + 10 : k < 4e9 ? (uint32_t)k + i % 3 : UINT32_MAX, i % 2 + 1);
        const bool rejects = test_rejects(&robot);
        GIVEN(i, m, robot.x_hat);
        CHECK_EQUAL(rejects, test_rejects(&exchanged));
        rejections += rejects;
    }
    CHECK(rejections > 1000 && rejections < 19000);
}

/* ---- Re-estimate: eq. 8 ---- */

static uint32_t plain_upper_quotient(uint64_t numerator, uint64_t denominator)
{
    for (; denominator >> 63 == 0; denominator <<= 1) {
        numerator <<= 1;
    }
    return (uint32_t)(((numerator >> 32) << 31) / ((denominator >> 33) + 1));
}

/* x_bar as Q32 of a round whose alpha is below 2^9, so that everything fits 64 bits. */
static uint32_t plain_x_bar(uint32_t alpha, uint32_t alpha_x)
{
    return plain_upper_quotient((uint64_t)alpha_x << 32 >> 23, (uint64_t)alpha << 32);
}

/* b_hat by docs/design.md; 0 for no update. */
static uint32_t plain_b_hat(uint32_t t, uint32_t n, uint32_t x_bar)
{
    const bool low = x_bar < ONE_HALF;
    const uint64_t a = low ? UINT32_MAX - x_bar : x_bar, seen = (uint64_t)(low ? t - n : n) << 32;
    const uint64_t least = t * ((UINT64_C(1) << 32) - a), most = t * a;
    if (2 * a - (UINT64_C(1) << 32) < INFORMATIVE) {
        return 0;
    }
    const uint32_t b_hat = seen <= least  ? 0
                           : seen >= most ? UINT32_MAX
                                          : plain_upper_quotient(seen - least, most - least);
    return b_hat < MCP_ASDF_B_HAT_MIN   ? MCP_ASDF_B_HAT_MIN
           : b_hat > MCP_ASDF_B_HAT_MAX ? MCP_ASDF_B_HAT_MAX
                                        : b_hat;
}

/* To the bit; an update writes all of `accuracy`, and none of it is written without one. */
static uint32_t check_reestimate(uint32_t t, uint32_t n, uint32_t alpha, uint32_t alpha_x)
{
    mcp_asdf_t robot = robot_with(&white_box_config, 0, 0x60000000), expected;
    robot.t = t;
    robot.n = n;
    robot.closed.alpha = alpha;
    robot.closed.alpha_x_low = alpha_x;
    memcpy(&expected, &robot, sizeof robot); /* with the padding */
    const uint32_t b_hat = plain_b_hat(t, n, plain_x_bar(alpha, alpha_x));
    GIVEN(t, n, alpha_x);
    CHECK_EQUAL(reestimate(&robot), b_hat != 0);
    if (b_hat != 0) {
        set_b_hat(&expected, b_hat);
    }
    CHECK_EQUAL(robot.accuracy.b_hat, expected.accuracy.b_hat);
    CHECK(memcmp(&robot, &expected, sizeof robot) == 0);
    return b_hat;
}

static const uint32_t observed[] = {1, 2, 3, 1000, 0x40000000, 0x7FFFFFFE, 0x7FFFFFFF};

static void reestimate_at_the_ends(void)
{
    static const uint32_t x_bars[] = {0,
                                      1,
                                      MCP_ASDF_HALF - 1025,
                                      MCP_ASDF_HALF - 1024,
                                      MCP_ASDF_HALF - 1023,
                                      MCP_ASDF_HALF,
                                      MCP_ASDF_HALF + 1023,
                                      MCP_ASDF_HALF + 1024,
                                      MCP_ASDF_HALF + 1025,
                                      MCP_ASDF_ONE - 1,
                                      MCP_ASDF_ONE};
    for (size_t i = 0; i < COUNT(observed); ++i) {
        const uint32_t t = observed[i], ns[] = {0, 1, t / 3, t / 2, t - t / 2, t - 1, t};
        for (size_t j = 0; j < COUNT(ns); ++j) {
            for (size_t k = 0; k < COUNT(x_bars); ++k) {
                (void)check_reestimate(t, ns[j], 1, x_bars[k]);
                (void)check_reestimate(t, ns[j], 511, 511 * x_bars[k]);
            }
        }
    }
    for (int i = 0; i < 30000; ++i) {
        const uint32_t t = random_below(MCP_ASDF_MEMORY_MAX - 1) + 1, alpha = random_below(511) + 1;
        const uint32_t n = (uint32_t)(check_random() % ((uint64_t)t + 1));
        (void)check_reestimate(t, n, alpha, random_below(alpha * MCP_ASDF_ONE + 1));
        (void)check_reestimate(t, n, alpha, alpha * MCP_ASDF_ONE - random_below(alpha * MCP_ASDF_ONE + 1));
    }
}

/* "clamp to [eps, 1 - eps]": everything black where all say black, and so on */
static void b_hat_saturates(void)
{
    for (size_t i = 0; i < COUNT(observed); ++i) {
        const uint32_t t = observed[i];
        CHECK_EQUAL(check_reestimate(t, t, 1, MCP_ASDF_ONE), MCP_ASDF_B_HAT_MAX);
        CHECK_EQUAL(check_reestimate(t, 0, 1, 0), MCP_ASDF_B_HAT_MAX);
        CHECK_EQUAL(check_reestimate(t, 0, 1, MCP_ASDF_ONE), MCP_ASDF_B_HAT_MIN);
        CHECK_EQUAL(check_reestimate(t, t, 1, 0), MCP_ASDF_B_HAT_MIN);
        CHECK_EQUAL(check_reestimate(t, t, 1, MCP_ASDF_HALF + 1025), MCP_ASDF_B_HAT_MAX);
        CHECK_EQUAL(check_reestimate(t, 0, 1, MCP_ASDF_HALF + 1025), MCP_ASDF_B_HAT_MIN);
        CHECK_EQUAL(check_reestimate(t, t, 1, MCP_ASDF_HALF - 1025), MCP_ASDF_B_HAT_MIN);
        CHECK_EQUAL(check_reestimate(t, 0, 1, MCP_ASDF_HALF - 1025), MCP_ASDF_B_HAT_MAX);
    }
    CHECK_EQUAL(check_reestimate(0x7FFFFFFF, 0x7FFFFFFE, 1, MCP_ASDF_ONE), MCP_ASDF_B_HAT_MAX);
    CHECK_EQUAL(check_reestimate(0x7FFFFFFF, 1, 1, MCP_ASDF_ONE), MCP_ASDF_B_HAT_MIN);
}

/* "|2 x_bar - 1| < 2^-12 means no update", but that x_bar is up to 2^-29 off: on both sides of 1/2, x_bar
 * that are 2^-31 apart pass from no update to an update, less than 2^-28 from the limit. */
static void no_update_where_x_bar_says_nothing(void)
{
    const uint32_t alpha = 256, half = alpha * MCP_ASDF_HALF, limit = 256 * 1024; /* 2^-13, unit 2^-31 */
    for (uint32_t away = limit - 64; away <= limit + 64; ++away) {
        const uint32_t above = check_reestimate(1000, 600, alpha, half + away);
        const uint32_t below = check_reestimate(1000, 600, alpha, half - away);
        GIVEN(away, above, below);
        CHECK(away >= limit - 8 || (above == 0 && below == 0));
        CHECK(away < limit + 8 || (above == MCP_ASDF_B_HAT_MAX && below == MCP_ASDF_B_HAT_MIN));
    }
    for (uint32_t weight = 1; weight < 512; ++weight) {
        CHECK_EQUAL(check_reestimate(1000, 600, weight, weight * MCP_ASDF_HALF), 0);
    }
    bool is_half = false;
    for (uint32_t away = 0; away < 64; ++away) { /* rounded, 1/2 to the bit is among them */
        is_half |= plain_x_bar(alpha, half + away) == ONE_HALF;
        CHECK_EQUAL(check_reestimate(1000, 600, alpha, half + away), 0);
    }
    CHECK(is_half);
}

/* ---- When the filter runs ---- */

/* A round of m equal messages, far from x_hat, closes after an observation of black or, for t = 0, none. */
static mcp_asdf_t settled(const mcp_asdf_config_t *config, uint8_t m, uint32_t x, bool observes)
{
    mcp_asdf_t robot = robot_with(config, OWN_ID, 0xC0000000);
    if (observes) {
        CHECK_EQUAL(mcp_asdf_observe(&robot, MCP_ASDF_BLACK), MCP_ASDF_OK);
    }
    fill_round(&robot, m, x, ALPHA_ONE);
    (void)mcp_asdf_receive(&robot, OWN_ID - 1, 0, 0); /* says nothing, and is not one of the m */
    const mcp_asdf_status_t status = mcp_asdf_settle(&robot);
    CHECK_EQUAL(status, robot.counters.updates != 0 ? MCP_ASDF_UPDATED : MCP_ASDF_OK);
    CHECK_EQUAL(robot.updated, robot.counters.updates);
    CHECK_EQUAL(robot.accuracy.b_hat != 0xC0000000, robot.counters.updates);
    return robot;
}

static void check_filter(const mcp_asdf_config_t *config, uint8_t least)
{
    for (uint8_t m = 0; m < MOST; ++m) {
        const bool enough = m >= least;
        mcp_asdf_t robot = settled(config, m, 0x100000, true);
        GIVEN(m, least, 0);
        CHECK_EQUAL(robot.counters.updates, enough);
        CHECK_EQUAL(robot.counters.tests, enough && config->filter == MCP_ASDF_ADAPTIVE);
        robot = settled(config, m, MCP_ASDF_HALF, true); /* x_bar says nothing */
        CHECK_EQUAL(robot.counters.updates, 0);
        CHECK_EQUAL(robot.counters.tests, enough && config->filter == MCP_ASDF_ADAPTIVE);
        robot = settled(config, m, 0x100000, false);
        CHECK(robot.counters.updates == 0 && robot.counters.tests == 0);
    }
}

/* "m < 2: no test"; without a test one message is enough; with t = 0, or off, nothing is. */
static void the_filter_needs_messages_and_observations(void)
{
    make_table(30, 4 * K_ONE, 1);
    check_filter(&adaptive, 2);
    check_filter(&always, 1);
    check_filter(&white_box_config, MOST); /* off: never */
}

/* A test that does not reject is counted, and changes nothing. */
static void a_test_that_does_not_reject_updates_nothing(void)
{
    make_table(2, 4 * K_ONE, 1);
    mcp_asdf_t robot = robot_with(&adaptive, OWN_ID, 0xC0000000);
    CHECK_EQUAL(mcp_asdf_observe(&robot, MCP_ASDF_BLACK), MCP_ASDF_OK);
    fill_round(&robot, 5, mcp_asdf_x_hat(&robot), ALPHA_ONE);
    CHECK_EQUAL(mcp_asdf_settle(&robot), MCP_ASDF_OK);
    CHECK(robot.counters.tests == 1 && robot.counters.updates == 0 && robot.accuracy.b_hat == 0xC0000000);
}

int main(void)
{
    sums_of_127_largest_messages();
    alpha_x_low_at_its_largest();
    sums_are_those_of_the_messages();
    mean_of_equal_numbers();
    own_confidence_of_every_size();
    no_confidence_at_all();
    mean_at_multiples_of_its_unit();
    threshold_is_strict();
    equal_messages_without_spread();
    entry_is_the_one_for_m();
    products_at_their_largest();
    decisions_are_mirror_images();
    reestimate_at_the_ends();
    b_hat_saturates();
    no_update_where_x_bar_says_nothing();
    the_filter_needs_messages_and_observations();
    a_test_that_does_not_reject_updates_nothing();
    return check_report();
}
