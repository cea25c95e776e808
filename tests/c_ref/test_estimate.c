/* White box: x_hat and alpha from t, n and b_hat, at the ends of every range. Errors against exact rationals
 * are the business of tests/firmware_py/test_mirror_exact.py, through the mirror. */
#include "white_box.h"

static const uint32_t counts[] = {1,          2,          3,          63,         0x7FFFFFFE, 0x7FFFFFFF,
                                  0x80000000, 0x80000001, 0xC0000001, 0xFFFFFFFC, 0xFFFFFFFD};

/* The smallest and the largest c, the ends of each odds_left, and the middle. */
static const uint32_t accuracies[] = {0x1000,  0x1001,     0x16A0,     0x16A1,     0x1FFF,    0x2000,
                                      0x2D41,  0x2D42,     0x3FFF,     0x4000,     0x5A82,    0x5A83,
                                      0x7FFF,  0x8000,     0xB504,     0xB505,     0xFFFF,    0x10000,
                                      0x10001, 0x40000000, 0x55555555, 0x7FF7FFFF, 0x7FF80000};

/* The largest part whose nu is at most c. */
static uint32_t most_at_end(uint32_t total, uint32_t c)
{
    return (uint32_t)((((uint64_t)c + 1) * total - 1) >> 32);
}

/* "part 2^odds_left < 2^31", "rest >= 2^29", "[2^22, 2^24)": at the largest part that is at the end */
static void confidence_at_end_fits(void)
{
    static const uint32_t totals[] = {TOTAL_MIN, TOTAL_MAX};
    for (size_t i = 0; i < COUNT(accuracies); ++i) {
        const mcp_asdf_accuracy_t accuracy = accuracy_of(accuracies[i]);
        for (size_t j = 0; j < COUNT(totals); ++j) {
            const uint32_t most = most_at_end(totals[j], accuracy.c), parts[] = {0, 1 < most ? 1 : 0, most};
            GIVEN(accuracies[i], most, accuracy.odds_left);
            CHECK(accuracy.odds_left == 0 || accuracy.c <= 0x10000);
            CHECK((uint64_t)most << accuracy.odds_left < UINT64_C(1) << 31);
            CHECK(((uint64_t)most << accuracy.odds_left) * accuracy.odds >> accuracy.odds_right < UINT64_C(1)
                                                                                                      << 52);
            for (size_t k = 0; k < COUNT(parts); ++k) {
                int32_t exponent = 0;
                const uint32_t mantissa =
                    confidence_at_end(&accuracy, parts[k], totals[j] - parts[k], &exponent);
                CHECK(totals[j] - parts[k] >= UINT32_C(1) << 29);
                CHECK(mantissa >= UINT32_C(1) << 22 && mantissa < UINT32_C(1) << 24);
            }
        }
    }
}

/* "Q32, [2^11, 2^30]", "[0, 19]", "[2^29, 2^31)", "scale < 2^31 <= 2 spread 2^shift": nu from c to 1/2 */
static void confidence_inside_fits(void)
{
    static const uint32_t totals[] = {TOTAL_MIN, TOTAL_MAX};
    for (size_t i = 0; i < COUNT(accuracies); ++i) {
        const mcp_asdf_accuracy_t accuracy = accuracy_of(accuracies[i]);
        const uint32_t nus[] = {accuracy.c, accuracy.c + 1, 0x7FFFFFFF, 0x80000000};
        for (size_t j = 0; j < 2 * COUNT(nus); ++j) {
            const uint32_t nu = nus[j / 2], total = totals[j % 2];
            const uint64_t spread = (uint64_t)nu * ((UINT64_C(1) << 32) - nu) >> 32;
            int32_t exponent = 0;
            const uint32_t mantissa = confidence_inside(&accuracy, nu, total, &exponent);
            GIVEN(accuracies[i], nu, total);
            CHECK(spread >= UINT32_C(1) << 11 && spread <= UINT32_C(1) << 30);
            CHECK(exponent + accuracy.g_squared_shift >= 0 && exponent + accuracy.g_squared_shift <= 19);
            CHECK((uint64_t)total * accuracy.g_squared >> 32 >= UINT32_C(1) << 29);
            CHECK(mantissa >= UINT32_C(1) << 22 && mantissa < UINT32_C(1) << 25);
        }
    }
}

/* (c + 1) total one above a multiple of 2^32, where the sum in at_end() just reaches the next one. */
static void at_end_at_its_closest(void)
{
    for (int i = 0; i < 20000; ++i) {
        const uint32_t total = TOTAL_MIN + (check_random_word() >> 2 | 1);
        uint32_t inverse = total; /* modulo 2^3, as total is odd; each turn doubles the bits */
        for (int turn = 0; turn < 4; ++turn) {
            inverse *= 2 - total * inverse;
        }
        const uint32_t c = inverse - 1, part = (uint32_t)(((uint64_t)inverse * total) >> 32);
        CHECK_EQUAL(inverse * total, 1);
        for (uint32_t near = part - (part > 0); near <= part + 1; ++near) {
            GIVEN(near, total, c);
            CHECK(near > total / 2 || at_end(near, total, c) == (((uint64_t)near << 32) / total <= c));
        }
    }
}

/* "nu = floor(part 2^32 / total) <= c": around the largest part at the end, at both ends of total */
static void at_end_as_the_quotient_says(void)
{
    for (int i = 0; i < 100000; ++i) {
        const uint32_t random = TOTAL_MIN + (check_random_word() & (TOTAL_MIN - 1));
        const uint32_t total = i % 4 == 0 ? TOTAL_MIN : i % 4 == 1 ? TOTAL_MAX : random;
        const uint32_t c = i < (int)COUNT(accuracies) * 4 ? accuracies[i / 4] : check_random_word() % C_MAX;
        const uint32_t most = most_at_end(total, c);
        for (uint32_t part = most == 0 ? 0 : most - 1; part <= most + 1 && part <= total / 2; ++part) {
            GIVEN(part, total, c);
            CHECK_EQUAL(at_end(part, total, c), ((uint64_t)part << 32) / total <= c);
        }
    }
    CHECK(at_end(TOTAL_MAX / 2, TOTAL_MAX, UINT32_MAX) && at_end(TOTAL_MIN / 2, TOTAL_MIN, UINT32_MAX));
}

/* "(nu - c) 2^g_shift <= g 2^g_shift / 2 with inverse_g rounded up give x_hat <= 2^22, equal at nu = 1/2" */
static void x_hat_is_one_half_for_half_blacks(void)
{
    for (int i = 0; i < 20000; ++i) {
        const uint32_t c = i < (int)COUNT(accuracies) ? accuracies[i] : check_random_word() % C_MAX + 1;
        const mcp_asdf_accuracy_t a = accuracy_of(c < 0x1000 ? 0x1000 : c);
        if (a.g_shift != MCP_ASDF_UNINFORMATIVE) {
            const uint32_t distance = (UINT32_C(1) << 31) - a.c;
            GIVEN(a.c, a.inverse_g, 0);
            CHECK((uint64_t)distance << a.g_shift < UINT64_C(1) << 31);
            CHECK_EQUAL(multiply_high(distance << a.g_shift, a.inverse_g) >> 7, MCP_ASDF_HALF);
            CHECK(multiply_high((distance - 1) << a.g_shift, a.inverse_g) >> 7 <= MCP_ASDF_HALF);
        }
    }
}

static void check_estimate(uint32_t t, uint32_t n, uint32_t b_hat)
{
    mcp_asdf_t robot = robot_at(t, n, b_hat), mirrored = robot_at(t, t - n, b_hat),
               inverted = robot_at(t, t - n, 0 - b_hat);
    estimate_own(&robot);
    estimate_own(&mirrored);
    estimate_own(&inverted);
    GIVEN(t, n, b_hat);
    CHECK(estimate_possible(robot.x_hat, robot.alpha));
    CHECK_EQUAL(robot.x_hat + mirrored.x_hat, MCP_ASDF_ONE);
    CHECK_EQUAL(robot.alpha, mirrored.alpha);
    CHECK(robot.x_hat == inverted.x_hat && robot.alpha == inverted.alpha);
    CHECK((robot.alpha == 0) == (robot.accuracy.g_shift == MCP_ASDF_UNINFORMATIVE));
    const uint32_t believed = robot.accuracy.inverted != 0 ? t - n : n; /* blacks, as b_hat tells them */
    CHECK(believed <= t / 2 || robot.x_hat >= MCP_ASDF_HALF);
    CHECK(believed > t / 2 || robot.x_hat <= MCP_ASDF_HALF);
}

/* Ends of t, n and b_hat together: colours are mirror images, so are b_hat and 1 - b_hat, and only a b_hat
 * that says nothing gives no confidence. */
static void estimate_at_the_ends(void)
{
    for (size_t i = 0; i < COUNT(counts); ++i) {
        const uint32_t t = counts[i], blacks[] = {0, 1, t / 3, t / 2, t - t / 2, t - 1, t};
        for (size_t j = 0; j < COUNT(blacks); ++j) {
            for (size_t k = 0; k < COUNT(accuracies); ++k) {
                check_estimate(t, blacks[j], 0 - accuracies[k]);
                check_estimate(t, blacks[j], accuracies[k]);
            }
            check_estimate(t, blacks[j], 0x80000000);
            check_estimate(t, blacks[j], 0x7FF80001);
        }
    }
    for (int i = 0; i < 200000; ++i) {
        const uint32_t t = check_random_word() % 0xFFFFFFFD + 1, b_hat = check_random_word();
        check_estimate(t, (uint32_t)(check_random() % ((uint64_t)t + 1)), b_hat < 0x1000 ? 0x1000 : b_hat);
    }
}

/* part / total = c is at the end, one observation more is inside, and x_hat has no step between */
static void estimate_at_the_meeting_point(void)
{
    mcp_asdf_t at = robot_at(UINT32_C(1) << 30, UINT32_C(1) << 28, UINT32_C(3) << 30); /* b_hat = 3/4 */
    mcp_asdf_t past = robot_at(UINT32_C(1) << 30, (UINT32_C(1) << 28) + 1, UINT32_C(3) << 30);
    estimate_own(&at);
    estimate_own(&past);
    CHECK_EQUAL(at.x_hat, 0);
    CHECK_EQUAL(past.x_hat, 0);
    CHECK(past.alpha - at.alpha <= 8); /* 4/3 2^30 d, which the two formulas round differently */
    at.n += 256;                       /* 2^-22 of t makes 2^-21 in x_hat */
    estimate_own(&at);
    CHECK_EQUAL(at.x_hat, 4);
}

int main(void)
{
    confidence_at_end_fits();
    confidence_inside_fits();
    at_end_as_the_quotient_says();
    at_end_at_its_closest();
    x_hat_is_one_half_for_half_blacks();
    estimate_at_the_ends();
    estimate_at_the_meeting_point();
    return check_report();
}
