/* White box: x_hat and alpha from t, n and b_hat, to the bit against the formulas of docs/design.md in plain
 * 64-bit arithmetic, and their symmetries. Errors against exact numbers are measured in test_wide.c. */
#include "white_box.h"

#define T_MAX (MCP_ASDF_MEMORY_MAX - 1)

/* The smallest and the largest c, those around powers of two and of sqrt(2), and two that say nothing. */
static const uint32_t accuracies[] = {0x1000,     0x1001,     0x16A0,     0x16A1,     0x1FFF,     0x2000,
                                      0x2D41,     0x3FFF,     0x4000,     0x7FFF,     0x8000,     0xFFFF,
                                      0x10000,    0x10001,    0x12345678, 0x33333333, 0x40000000, 0x55555555,
                                      0x6CCCCCCD, 0x7FF7FFFF, C_MAX,      C_MAX + 1,  ONE_HALF};

typedef struct {
    uint64_t mantissa;
    int32_t exponent;
} plain_t;

/* "part (g / c)^2 + (t - part) (g / (1 - c))^2": p at the end of its range. "< 2^63", "< 2^64". */
static plain_t plain_at_end(const mcp_asdf_accuracy_t *a, uint64_t t, uint64_t part)
{
    plain_t found = {(t - part) * a->common, 10 - 2 * (int32_t)a->g_shift}; /* unit 2^-30, less 2^8 */
    CHECK(t - part < UINT64_C(1) << 31);
    if (part != 0) {
        found.mantissa >>= a->rare_shift;
        CHECK(part * a->rare <= UINT64_MAX - found.mantissa);
        found.mantissa += part * a->rare;
        found.exponent += (int32_t)a->rare_shift;
    }
    found.exponent -= 16;
    for (; found.mantissa >> 24 != 0; ++found.exponent) {
        found.mantissa >>= 1;
    }
    for (; found.mantissa >> 23 == 0; --found.exponent) {
        found.mantissa <<= 1;
    }
    return found;
}

/* "g^2 total^2 t / (rarer (total - rarer))", with the ranges that the comments state. */
static plain_t plain_inside(uint64_t total, uint64_t rarer, uint64_t scale, int32_t shift, int32_t g_shift)
{
    uint64_t square = (scale * scale >> 32) * total >> 32, spread = rarer * (total - rarer);
    int32_t exponent = 32 - shift - 2 * g_shift;
    CHECK(square >> 27 != 0 && square >> 32 == 0);
    CHECK(spread >> 41 != 0 && spread <= UINT64_C(1) << 62);
    for (; square >> 31 == 0; --exponent) {
        square <<= 1;
    }
    for (; spread >> 63 == 0; ++exponent) {
        spread <<= 1;
    }
    plain_t found = {((square >> 1) << 24) / (spread >> 33), exponent};
    CHECK(found.mantissa >= UINT32_C(1) << 23 && found.mantissa < UINT32_C(1) << 25);
    if (found.mantissa >> 24 != 0) {
        found.mantissa >>= 1;
        ++found.exponent;
    }
    return found;
}

/* What is below a unit goes, but never all of it. */
static uint32_t plain_word(plain_t alpha)
{
    CHECK(alpha.mantissa >> 23 == 1 && alpha.exponent >= -22);
    if (alpha.exponent > 31) {
        return ALPHA_MAX;
    }
    for (; alpha.exponent < 0; ++alpha.exponent) {
        alpha.mantissa >>= 1;
    }
    return (uint32_t)alpha.mantissa << 8 | (uint32_t)alpha.exponent;
}

static message_t plain_estimate(uint32_t t, uint32_t n, const mcp_asdf_accuracy_t *a)
{
    const uint32_t part = n < t - n ? n : t - n, shift = plain_zeros(t);
    const uint64_t total = (uint64_t)t << shift, rarer = (uint64_t)part << shift, least = a->c * total >> 32;
    message_t found = {MCP_ASDF_HALF, 0};
    if (a->c == UINT32_MAX) {
        CHECK(rarer <= least);
        return found;
    }
    if (rarer <= least) {
        found.x_hat = 0;
        found.alpha = plain_word(plain_at_end(a, t, part));
    } else {
        const uint64_t scale = (total - 2 * least) << a->g_shift;
        CHECK(scale >> 30 != 0 && scale >> 32 == 0);
        found.x_hat = (uint32_t)((((rarer - least) << a->g_shift) << 22) / (scale >> 1));
        found.alpha = plain_word(plain_inside(total, rarer, scale, (int32_t)shift, (int32_t)a->g_shift));
    }
    if ((n > t / 2) != (a->b_hat < ONE_HALF)) {
        found.x_hat = MCP_ASDF_ONE - found.x_hat;
    }
    return found;
}

static void check_same(const message_t *left, const message_t *right)
{
    CHECK_EQUAL(left->x_hat, right->x_hat);
    CHECK_EQUAL(left->alpha, right->alpha);
}

/* To the bit; exchanged colours, and b_hat for 1 - b_hat, are mirror images; half of the observations black
 * is 1/2; and only a b_hat that says nothing gives no confidence. */
static void check_estimate(uint32_t t, uint32_t n, uint32_t b_hat)
{
    const mcp_asdf_t robot = robot_at(t, n, b_hat), opposite = robot_with(&white_box_config, 0, 0 - b_hat);
    GIVEN(t, n, b_hat);
    const message_t found = estimate(t, n, &robot.accuracy), plain = plain_estimate(t, n, &robot.accuracy);
    const message_t exchanged = estimate(t, t - n, &robot.accuracy);
    const message_t inverted = estimate(t, t - n, &opposite.accuracy);
    const uint32_t believed = b_hat < ONE_HALF ? t - n : n; /* blacks, as b_hat has them */
    check_same(&found, &plain);
    check_same(&found, &inverted);
    CHECK_EQUAL(found.x_hat + exchanged.x_hat, MCP_ASDF_ONE);
    CHECK_EQUAL(found.alpha, exchanged.alpha);
    CHECK_EQUAL(found.alpha >> 8 == 0, robot.accuracy.c == UINT32_MAX);
    CHECK(2 * believed != t || found.x_hat == MCP_ASDF_HALF);
    CHECK(believed > t / 2 || found.x_hat <= MCP_ASDF_HALF);
    CHECK(believed < t - t / 2 || found.x_hat >= MCP_ASDF_HALF);
}

/* Under b_hat = c and 1 - c, with blacks at the ends, at half, and where part / t passes c. */
static void check_around(uint32_t t, uint32_t c)
{
    const uint32_t edge = (uint32_t)((uint64_t)c * t >> 32);
    const uint32_t blacks[] = {0,    1,       t / 3, t / 2, t - t / 2, t - 1, t, edge == 0 ? 0 : edge - 1,
                               edge, edge + 1};
    for (size_t i = 0; i < COUNT(blacks); ++i) {
        if (blacks[i] <= t) {
            check_estimate(t, blacks[i], c);
            check_estimate(t, blacks[i], 0 - c);
        }
    }
}

static void estimate_at_the_ends(void)
{
    for (size_t i = 0; i < COUNT(accuracies); ++i) {
        for (uint32_t bit = 0; bit < 31; ++bit) {
            const uint32_t power = UINT32_C(1) << bit;
            check_around(power, accuracies[i]);
            check_around(power + (power - 1), accuracies[i]);
            check_around(power + power / 2, accuracies[i]);
            check_around(power + bit % 2, accuracies[i]);
        }
        check_around(T_MAX, accuracies[i]);
        check_around(T_MAX - 1, accuracies[i]);
    }
}

static void estimate_of_few_observations(void)
{
    for (uint32_t t = 1; t <= 32; ++t) {
        for (uint32_t n = 0; n <= t; ++n) {
            for (size_t i = 0; i < COUNT(accuracies); i += 2) {
                check_estimate(t, n, 0 - accuracies[i]);
            }
        }
    }
}

static void estimate_of_any_numbers(void)
{
    for (int i = 0; i < 4000; ++i) {
        const uint32_t t = random_below(T_MAX) + 1, c = C_MIN + random_below(C_MAX - C_MIN + 1);
        check_estimate(t, (uint32_t)(check_random() % ((uint64_t)t + 1)), c);
        check_around(t, c);
        check_estimate(t, random_below(t + 1), 0 - c);
    }
}

/* part / t = c is at the end, one observation more is inside, and x_hat has no step between. */
static void estimate_at_the_meeting_point(void)
{
    const uint32_t t = UINT32_C(1) << 30, quarter = t / 4;
    const mcp_asdf_t at = robot_at(t, quarter, UINT32_C(3) << 30); /* b_hat = 3/4 */
    const mcp_asdf_t past = robot_at(t, quarter + 1, UINT32_C(3) << 30);
    CHECK_EQUAL(at.x_hat, 0);
    CHECK_EQUAL(past.x_hat, 0);
    CHECK((past.alpha >> 8) - (at.alpha >> 8) <= 4); /* 4/3 2^30, which the formulas round differently */
    CHECK_EQUAL(past.alpha & 31, at.alpha & 31);
    const mcp_asdf_t further = robot_at(t, quarter + 256, UINT32_C(3) << 30);
    CHECK_EQUAL(further.x_hat, 4); /* 2^-22 of t makes 2^-21 in x_hat */
}

/* ---- Halving at the memory: "n to nearest, ties to even", and mirror images stay so as M / 2 is even ----
 */

static mcp_asdf_t halved(uint32_t memory, uint32_t n, uint32_t z, uint32_t b_hat)
{
    const mcp_asdf_config_t config = {0, 1, memory, MCP_ASDF_OFF};
    mcp_asdf_t robot = robot_at(memory - 1, n, b_hat);
    robot.config = &config;
    CHECK_EQUAL(mcp_asdf_observe(&robot, (mcp_asdf_observation_t)z), MCP_ASDF_OK);
    robot.config = &white_box_config;
    return robot;
}

static void check_halving(uint32_t memory, uint32_t n, uint32_t z, uint32_t b_hat)
{
    const mcp_asdf_t robot = halved(memory, n, z, b_hat);
    const mcp_asdf_t exchanged = halved(memory, memory - 1 - n, 1 - z, b_hat);
    const mcp_asdf_t inverted = halved(memory, memory - 1 - n, 1 - z, 0 - b_hat);
    const uint32_t down = (n + z) / 2, is_odd = (n + z) % 2;
    GIVEN(memory, n, z);
    CHECK_EQUAL(robot.t, memory / 2);
    CHECK_EQUAL(robot.n, down + (is_odd != 0 && down % 2 != 0));
    CHECK_EQUAL(robot.n + exchanged.n, memory / 2);
    CHECK_EQUAL(robot.x_hat + exchanged.x_hat, MCP_ASDF_ONE);
    CHECK(robot.alpha == exchanged.alpha && robot.alpha == inverted.alpha);
    CHECK_EQUAL(robot.x_hat, inverted.x_hat);
    CHECK(2 * (n + z) != memory || robot.x_hat == MCP_ASDF_HALF);
}

static void halving_keeps_mirror_images(void)
{
    static const uint32_t short_memories[] = {64, 68, 72, 100};
    for (size_t i = 0; i < COUNT(short_memories); ++i) {
        for (uint32_t n = 0; n < short_memories[i]; ++n) {
            check_halving(short_memories[i], n, n % 3 % 2, UINT32_C(0xE0000000));
            check_halving(short_memories[i], n, 1 - n % 3 % 2, UINT32_C(0x60000000));
        }
    }
    for (uint32_t i = 0; i < 4000; ++i) {
        const uint32_t memory = i < 8 ? MCP_ASDF_MEMORY_MAX - 4 * i : 64 + (random_below(T_MAX - 64) & ~3U);
        const uint32_t ns[] = {0, memory - 1, memory / 2 - 1, memory / 2, random_below(memory)};
        for (size_t j = 0; j < COUNT(ns); ++j) {
            check_halving(memory, ns[j], i % 2, C_MIN + random_below(C_MAX - C_MIN + 1));
        }
    }
}

/* "to the memory": one observation before it nothing is halved, and a longer one changes nothing. */
static void nothing_is_halved_before_the_memory(void)
{
    const mcp_asdf_config_t config = {0, 1, 64, MCP_ASDF_OFF};
    for (uint32_t t = 0; t < 63; ++t) {
        mcp_asdf_t robot = robot_with(&config, 0, UINT32_C(0xE0000000));
        robot.t = t;
        robot.n = t / 2;
        GIVEN(t, 0, 0);
        CHECK_EQUAL(mcp_asdf_observe(&robot, MCP_ASDF_BLACK), MCP_ASDF_OK);
        CHECK(robot.t == t + 1 && robot.n == t / 2 + 1);
        CHECK_EQUAL(robot.x_hat, plain_estimate(t + 1, t / 2 + 1, &robot.accuracy).x_hat);
    }
}

int main(void)
{
    estimate_at_the_ends();
    estimate_of_few_observations();
    estimate_of_any_numbers();
    estimate_at_the_meeting_point();
    halving_keeps_mirror_images();
    nothing_is_halved_before_the_memory();
    return check_report();
}
