/* White box: a round's sums, the test of eq. 12 and the re-estimate of eq. 8, at the ends of their ranges.
 * Products beyond 64 bits are checked in test_wide.c. */
#include "white_box.h"

#define MOST 127
#define ALPHA_HALF UINT32_C(0x3F000000) /* 1/2, the least alpha with all 24 bits on the grid */

static mcp_asdf_t robot_with(const mcp_asdf_config_t *config, uint32_t b_hat)
{
    mcp_asdf_t robot;
    memset(&robot, 0xA5, sizeof robot);
    CHECK_EQUAL(mcp_asdf_init(&robot, config, 127, b_hat), MCP_ASDF_OK);
    return robot;
}

static void fill_round(mcp_asdf_t *robot, uint8_t messages, uint32_t x_hat, uint32_t alpha)
{
    for (uint8_t sender = 0; sender < messages; ++sender) {
        CHECK_EQUAL(mcp_asdf_receive(robot, sender, x_hat, alpha), MCP_ASDF_OK);
    }
}

/* "+ 2^55", "+ 2^46", "+ 2^23" a message: 127 of the largest reach, and do not pass, the header's bounds */
static void sums_of_127_largest_messages(void)
{
    mcp_asdf_t robot = robot_with(&white_box_config, 0xC0000000);
    fill_round(&robot, MOST, MCP_ASDF_ONE, MCP_ASDF_ALPHA_MAX);
    CHECK_EQUAL(robot.open.alpha, MOST * ((UINT64_C(1) << 55) - (UINT64_C(1) << 31)));
    CHECK(robot.open.alpha < UINT64_C(1) << 62 && robot.open.alpha_x_low < UINT64_C(1) << 62);
    CHECK_EQUAL(robot.open.alpha_x_high, MOST * UINT64_C(0x7FFFFF) << 23);
    CHECK(robot.open.alpha_x_high < UINT64_C(1) << 53 && robot.open.x_squared < UINT64_C(1) << 53);
    CHECK_EQUAL(robot.open.x_squared, (uint64_t)MOST << 46);
    CHECK(robot.open.x < UINT32_C(1) << 30 && robot.open.count == MOST && mcp_asdf_invariants_hold(&robot));
}

/* The largest low word is 0xFFFFFF00, where a 24-bit mantissa is shifted by 8. */
static void alpha_x_low_at_its_largest(void)
{
    mcp_asdf_sums_t sums = {0, 0, 0, 0, 0, 0};
    for (int i = 0; i < MOST; ++i) {
        CHECK(mcp_asdf_sums_add(&sums, MCP_ASDF_ONE, (8 + ALPHA_UNIT_EXPONENT) << 23 | ALPHA_FRACTION));
    }
    CHECK_EQUAL(sums.alpha_x_low, MOST * UINT64_C(0xFFFFFF00) << 23);
    CHECK(sums.alpha_x_low < UINT64_C(1) << 62 && sums_possible(&sums));
}

/* Whole and, with the own estimate, 128 largest confidences: the mean of equal numbers is that number. */
static void mean_of_equal_numbers(void)
{
    static const uint32_t xs[] = {
        0, 1, MCP_ASDF_HALF - 1, MCP_ASDF_HALF, 0x555555, MCP_ASDF_ONE - 1, MCP_ASDF_ONE};
    static const uint32_t alphas[] = {0x33800000, 0x33FFFFFF, ALPHA_HALF, 0x3F7FFFFF,        0x437FFFFF,
                                      0x437F0001, 0x46FFFFFF, 0x4E800000, MCP_ASDF_ALPHA_MAX};
    for (size_t i = 0; i < COUNT(xs); ++i) {
        for (size_t j = 0; j < COUNT(alphas); ++j) {
            mcp_asdf_t robot = robot_with(&white_box_config, 0xC0000000);
            GIVEN(xs[i], alphas[j], 0);
            fill_round(&robot, MOST, xs[i], alphas[j]);
            (void)mcp_asdf_step(&robot, MCP_ASDF_NONE);
            CHECK_EQUAL(mcp_asdf_x_bar(&robot), xs[i]);
            robot.settled_x_hat = xs[i];
            robot.settled_alpha = MCP_ASDF_ALPHA_MAX;
            CHECK_EQUAL(mcp_asdf_x(&robot), xs[i]);
            CHECK(mcp_asdf_beta(&robot) < UINT64_C(1) << 62);
        }
    }
}

/* The own confidence is one unit, has no bits above or none below bit 32, or is the largest. */
static void own_confidence_of_every_size(void)
{
    static const uint32_t alphas[] = {0x33800000, 0x3EFFFFFE, ALPHA_HALF,
                                      0x437FFFFF, 0x4E800000, MCP_ASDF_ALPHA_MAX};
    static const uint64_t units[] = {1, 0x7FFFFF, 0x800000, 0xFFFFFF00, UINT64_C(1) << 54, 0x7FFFFF80000000};
    for (size_t i = 0; i < COUNT(alphas); ++i) {
        mcp_asdf_t robot = robot_with(&white_box_config, 0xC0000000);
        robot.settled_x_hat = MCP_ASDF_ONE;
        robot.settled_alpha = alphas[i];
        robot.closed_alpha = units[i]; /* as much for 0 as for 1 */
        GIVEN(alphas[i], units[i], 0);
        CHECK_EQUAL(mcp_asdf_x(&robot), MCP_ASDF_HALF);
        robot.closed_alpha = units[i] + 1;
        CHECK_EQUAL(mcp_asdf_x(&robot),
                    (units[i] >> 24 != 0) ? MCP_ASDF_HALF - 1 : (units[i] << 23) / (2 * units[i] + 1));
    }
}

/* "the quotient's upper 23 bits are right or one too small": means just below and at each multiple of 2^-23
 */
static void mean_at_multiples_of_its_unit(void)
{
    for (uint32_t i = 0; i < 20000; ++i) {
        const uint32_t x = check_random_word() % MCP_ASDF_ONE, weight = check_random_word() % 0xFFFFFF + 1;
        GIVEN(x, weight, 0);
        CHECK_EQUAL(mean(weight, (uint64_t)x * weight, 0), x);
        CHECK_EQUAL(mean(weight, (uint64_t)x * weight + (weight - 1), 0), x);
        CHECK_EQUAL(mean(weight, (uint64_t)(x + 1) * weight, 0), x + 1);
        CHECK_EQUAL(mean((uint64_t)weight << 32, 0, (uint64_t)x * weight), x);
        CHECK_EQUAL(mean((uint64_t)weight << 32, UINT32_MAX, (uint64_t)x * weight + weight - 1), x);
    }
}

/* ---- Test of eq. 12 ---- */

static uint32_t table[TABLE_HEADER + MCP_ASDF_MAX_ID];
static const mcp_asdf_config_t adaptive = {table, 1, 1, MCP_ASDF_MEMORY_MAX, MCP_ASDF_ADAPTIVE};

/* A table whose entries fall from `first` by `step`. */
static void make_table(uint32_t q, uint32_t fraction_bits, uint32_t first, uint32_t step)
{
    table[0] = TABLE_MAGIC;
    table[1] = TABLE_VERSION << 24 | q << 16 | fraction_bits << 8;
    table[2] = 1;
    uint32_t hash = hash_word(hash_word(hash_word(HASH_START, table[0]), table[1]), table[2]);
    for (uint32_t i = 0; i < q; ++i) {
        table[TABLE_HEADER + i] = first - i * step;
        hash = hash_word(hash, table[TABLE_HEADER + i]);
    }
    table[3] = hash;
}

/* A robot at x_hat with a round of `low` messages of 0 and `high` messages of x. */
static mcp_asdf_t with_round(uint32_t x_hat, uint8_t low, uint8_t high, uint32_t x)
{
    mcp_asdf_t robot = robot_with(&adaptive, 0xC0000000);
    robot.x_hat = x_hat;
    for (uint8_t i = 0; i < low + high; ++i) {
        CHECK_EQUAL(mcp_asdf_receive(&robot, i, i < low ? 0 : x, ALPHA_HALF), MCP_ASDF_OK);
    }
    return robot;
}

/* One message of 0 and one of x: spread = x^2, difference = |x - 2 x_hat|, so eq. 12 is (x - 2 x_hat)^2 > k
 * x^2. With k = 4 and x_hat = 3 x / 2 both sides are equal: no rejection. One unit further rejects. */
static void threshold_is_strict_at_every_fraction_bits(void)
{
    const uint32_t x = 0x300000;
    for (uint32_t fraction_bits = 1; fraction_bits <= 29; ++fraction_bits) {
        make_table(2, fraction_bits, UINT32_C(4) << fraction_bits, 1);
        mcp_asdf_t robot = with_round(3 * x / 2, 1, 1, x);
        GIVEN(fraction_bits, 0, 0);
        CHECK(table_valid(table));
        CHECK(!test_rejects(&robot));
        ++robot.x_hat;
        CHECK(test_rejects(&robot));
        make_table(2, fraction_bits, (UINT32_C(4) << fraction_bits) + 1, 1);
        CHECK_EQUAL(test_rejects(&robot),
                    8 * x + 4 > (uint64_t)x * x >> fraction_bits); /* (2x + 2)^2 - 4 x^2 */
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

/* A round of m with a spread of about 2^24: the largest difference that does not reject under k, and the
 * next. */
static void check_entry(uint32_t m, uint32_t k)
{
    mcp_asdf_t robot = robot_with(&adaptive, 0xC0000000);
    robot.x_hat = 0x1000;
    robot.open.count = m;
    for (uint32_t more = 0; more < 2; ++more) {
        const uint64_t difference = root_of(k) + more, x = m * UINT64_C(0x1000) + difference;
        robot.open.x = (uint32_t)x;
        robot.open.x_squared = (x * x + (UINT32_C(1) << 24)) / m; /* spread is at most m - 1 below 2^24 */
        const uint64_t spread = m * robot.open.x_squared - x * x;
        CHECK_EQUAL(test_rejects(&robot), difference * difference > k * spread >> 24);
    }
}

/* The entries for m = 2, q, q + 1 and 127 are those at their places; neighbours differ by a 1/32 and more. */
static void entry_is_the_one_for_m(void)
{
    for (uint32_t q = 2; q <= 127; q += q == 2 ? 1 : 31) {
        make_table(q, 24, UINT32_C(6) << 24, UINT32_C(1) << 19);
        CHECK(table_valid(table));
        for (uint32_t m = 2; m <= 127; ++m) {
            GIVEN(q, m, 0);
            check_entry(m, table[TABLE_HEADER + (m <= q ? m - 2 : q - 1)]);
        }
    }
}

/* "< 2^30", "< 2^60", "< 2^58", "< 2^6 2^58": m = 127, messages half 0 and half 1.0, the largest entry of
 * each F. At F = 31 no table has an entry above 2.0. */
static void products_at_their_largest(void)
{
    for (uint32_t fraction_bits = 1; fraction_bits <= 31; ++fraction_bits) {
        const uint32_t most = fraction_bits < 26 ? (UINT32_C(1) << (fraction_bits + 6)) - 1 : UINT32_MAX - 1;
        make_table(2, fraction_bits, most, 1);
        mcp_asdf_t robot = with_round(MCP_ASDF_ONE, 64, 63, MCP_ASDF_ONE);
        const uint64_t spread = MOST * robot.open.x_squared - (uint64_t)robot.open.x * robot.open.x;
        GIVEN(fraction_bits, most, spread);
        CHECK(table_valid(table));
        CHECK_EQUAL(spread, UINT64_C(64) * 63 << 46);
        CHECK(spread < UINT64_C(1) << 58 && (uint64_t)MOST * robot.open.x_squared < UINT64_C(1) << 60);
        CHECK(!test_rejects(&robot)); /* 64^2 < k 64 63 for every k > 64/63; here k is at least 2 - 2^-30 */
        robot.open.x_squared =
            (((uint64_t)robot.open.x * robot.open.x) + MOST - 1) / MOST; /* hardly any spread */
        CHECK(test_rejects(&robot));
        make_table(2, fraction_bits, most, 1);
        ++table[TABLE_HEADER];
        CHECK(!table_valid(table)); /* one more is out of range, or breaks the checksum */
    }
}

static void first_entry_stays_below_64(void)
{
    for (uint32_t fraction_bits = 1; fraction_bits < 26; ++fraction_bits) {
        make_table(2, fraction_bits, (UINT32_C(64) << fraction_bits) - 1, 1);
        GIVEN(fraction_bits, 0, 0);
        CHECK(table_valid(table));
        make_table(2, fraction_bits, UINT32_C(64) << fraction_bits, 1);
        CHECK(!table_valid(table));
    }
}

/* ---- Re-estimate, eq. 8 ---- */

static uint32_t estimate_again(uint32_t t, uint32_t n, uint32_t x_bar)
{
    mcp_asdf_t robot = robot_at(t, n, 0x60000000);
    robot.closed_alpha = 1;
    robot.closed_alpha_x_low = x_bar;
    const bool done = reestimate(&robot);
    CHECK_EQUAL(done, x_bar != MCP_ASDF_HALF);
    CHECK(accuracy_current(&robot) && (done || robot.b_hat == 0x60000000));
    return robot.b_hat;
}

/* "< 2^55", "[2, 2^55)", and both clamps */
static void reestimate_at_the_ends(void)
{
    static const uint32_t ts[] = {1, 2, 3, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFD};
    static const uint32_t x_bars[] = {
        0, 1, MCP_ASDF_HALF - 1, MCP_ASDF_HALF, MCP_ASDF_HALF + 1, MCP_ASDF_ONE - 1, MCP_ASDF_ONE};
    for (size_t i = 0; i < COUNT(ts); ++i) {
        const uint32_t t = ts[i], ns[] = {0, 1, t / 2, t - t / 2, t - 1, t};
        for (size_t j = 0; j < COUNT(ns); ++j) {
            for (size_t k = 0; k < COUNT(x_bars); ++k) {
                const uint32_t b_hat = estimate_again(t, ns[j], x_bars[k]);
                GIVEN(t, ns[j], x_bars[k]);
                CHECK(b_hat >= MCP_ASDF_B_HAT_MIN && b_hat <= MCP_ASDF_B_HAT_MAX);
                CHECK_EQUAL(b_hat, estimate_again(t, t - ns[j], MCP_ASDF_ONE - x_bars[k]));
            }
        }
        CHECK_EQUAL(estimate_again(t, t, MCP_ASDF_ONE), MCP_ASDF_B_HAT_MAX);
        CHECK_EQUAL(estimate_again(t, 0, MCP_ASDF_ONE), MCP_ASDF_B_HAT_MIN);
        CHECK_EQUAL(estimate_again(t, t, 0), MCP_ASDF_B_HAT_MIN);
        CHECK_EQUAL(estimate_again(t, t, MCP_ASDF_HALF + 1), MCP_ASDF_B_HAT_MAX);
        CHECK_EQUAL(estimate_again(t, 0, MCP_ASDF_HALF + 1), MCP_ASDF_B_HAT_MIN);
    }
}

int main(void)
{
    sums_of_127_largest_messages();
    alpha_x_low_at_its_largest();
    mean_of_equal_numbers();
    own_confidence_of_every_size();
    mean_at_multiples_of_its_unit();
    threshold_is_strict_at_every_fraction_bits();
    entry_is_the_one_for_m();
    products_at_their_largest();
    first_entry_stays_below_64();
    reestimate_at_the_ends();
    return check_report();
}
