/* White box: what depends on b_hat alone, and confidences as words. */
#include "white_box.h"

static const uint64_t one_32 = UINT64_C(1) << 32; /* 1.0 as Q32 */

/* ---- set_b_hat ---- */

static mcp_asdf_accuracy_t accuracy_of(uint32_t b_hat)
{
    mcp_asdf_t robot;
    memset(&robot, 0xA5, sizeof robot);
    set_b_hat(&robot, b_hat);
    return robot.accuracy;
}

/* (numerator / denominator)^2 as Q30, from a quotient with the bits that docs/design.md gives it. */
static uint64_t plain_square(uint64_t numerator, uint64_t denominator)
{
    const uint64_t quotient = (((numerator >> 1) << 24) / (denominator >> 1)) << 7;
    return quotient * quotient >> 32;
}

static struct {
    uint32_t least, most;
} g_shifts = {255, 0}, rare_shifts = {255, 0};

#define EXTEND(range, value)                                                                                 \
    do {                                                                                                     \
        (range).least = (value) < (range).least ? (value) : (range).least;                                   \
        (range).most = (value) > (range).most ? (value) : (range).most;                                      \
    } while (0)

/* Every member for a c that says something, under b_hat = c and b_hat = 1 - c. */
static void check_accuracy(uint32_t c)
{
    const mcp_asdf_accuracy_t a = accuracy_of(c), mirrored = accuracy_of(0 - c);
    const uint64_t g = one_32 - 2 * (uint64_t)c;
    const uint32_t g_shift = plain_zeros((uint32_t)g), c_shift = plain_zeros(c);
    GIVEN(c, a.common, a.rare);
    CHECK(a.b_hat == c && mirrored.b_hat == one_32 - c);
    CHECK(a.c == c && mirrored.c == c);
    CHECK(a.g_shift == g_shift && mirrored.g_shift == g_shift);
    CHECK(a.rare_shift == 2 * c_shift && mirrored.rare_shift == a.rare_shift);
    CHECK_EQUAL(a.common, plain_square(g << g_shift, one_32 - c));
    CHECK_EQUAL(a.rare, plain_square(g << g_shift, (uint64_t)c << c_shift));
    CHECK(mirrored.common == a.common && mirrored.rare == a.rare);
    CHECK(a.common >= UINT32_C(1) << 28 && a.rare >= UINT32_C(1) << 28);
    EXTEND(g_shifts, a.g_shift);
    EXTEND(rare_shifts, a.rare_shift);
}

static void check_around(uint32_t c)
{
    for (uint32_t near = c - 2; near != c + 3; ++near) {
        if (near >= C_MIN && near <= C_MAX) {
            check_accuracy(near);
        }
    }
}

/* "0 .. 11", "2 .. 38": the header's ranges of the shifts, all of them reached and none passed */
static void members_follow_from_b_hat(void)
{
    for (uint32_t bit = 12; bit < 31; ++bit) {
        const uint32_t power = UINT32_C(1) << bit;
        check_around(power);
        check_around(power + (power >> 1));
        check_around(ONE_HALF - power); /* where g is a power of two */
    }
    check_around(C_MAX);
    for (int i = 0; i < 20000; ++i) {
        check_around(random_below(C_MAX + 1));
    }
    CHECK(g_shifts.least == 0 && g_shifts.most == 11);
    CHECK(rare_shifts.least == 2 && rare_shifts.most == 38);
}

/* |2 b_hat - 1| < 2^-12 says nothing, = 2^-12 does; then c = 2^32 - 1 puts every part at the end of the scale
 */
static void uninformative_exactly_below_the_limit(void)
{
    const uint32_t distance = INFORMATIVE >> 1;
    CHECK_EQUAL(accuracy_of(ONE_HALF - distance).c, ONE_HALF - distance);
    CHECK_EQUAL(accuracy_of(ONE_HALF + distance).c, ONE_HALF - distance);
    for (uint32_t i = 0; i < distance; i = 2 * i + 1) {
        GIVEN(i, 0, 0);
        CHECK_EQUAL(accuracy_of(ONE_HALF - i).c, UINT32_MAX);
        CHECK_EQUAL(accuracy_of(ONE_HALF + i).c, UINT32_MAX);
    }
    CHECK_EQUAL(accuracy_of(ONE_HALF - distance + 1).c, UINT32_MAX);
    CHECK_EQUAL(accuracy_of(ONE_HALF + distance - 1).c, UINT32_MAX);
}

/* "[2^28, 2^32)", "from a quotient of 24 or 25 bits": at the ends of both operands */
static void square_of_ratio_is_in_range(void)
{
    static const uint32_t operands[] = {0x80000000, 0x80000001, 0xB504F333,
                                        0xB504F334, 0xFFFFFFFE, 0xFFFFFFFF};
    for (size_t i = 0; i < COUNT(operands); ++i) {
        for (size_t j = 0; j < COUNT(operands); ++j) {
            const uint64_t quotient = ((uint64_t)(operands[i] >> 1) << 24) / (operands[j] >> 1);
            const uint32_t square = square_of_ratio(operands[i], operands[j]);
            GIVEN(operands[i], operands[j], square);
            CHECK(quotient >> 23 != 0 && quotient >> 25 == 0);
            CHECK_EQUAL(square, plain_square(operands[i], operands[j]));
            CHECK(square >= UINT32_C(1) << 28);
        }
    }
}

/* ---- Words of alpha ---- */

/* mantissa 2^exponent units, rounded down to a whole one, at most the largest confidence; bit by bit. */
static uint64_t plain_units(uint64_t mantissa, int32_t exponent)
{
    for (; exponent < 0; ++exponent) {
        mantissa >>= 1;
    }
    for (; exponent > 0 && mantissa <= ALPHA_MAX_UNITS; --exponent) {
        mantissa <<= 1;
    }
    return mantissa > ALPHA_MAX_UNITS ? ALPHA_MAX_UNITS : mantissa;
}

static uint64_t units_of(uint32_t alpha)
{
    const word_pair_t found = units(alpha);
    return (uint64_t)found.high << 32 | found.low;
}

static const uint32_t mantissas[] = {0x800000, 0x800001, 0x955555, 0xBFFFFF, 0xC00000, 0xFFFFFE, 0xFFFFFF};

/* "mantissa in [2^23, 2^24)", "at most 21: what is below a unit goes" */
static void alpha_word_over_its_range(void)
{
    for (int32_t exponent = -31; exponent <= 80; ++exponent) {
        for (size_t i = 0; i < COUNT(mantissas); ++i) {
            const uint32_t word = alpha_word(mantissas[i], (uint32_t)exponent);
            GIVEN(mantissas[i], exponent, word);
            CHECK_EQUAL(units_of(word), plain_units(mantissas[i], exponent));
            CHECK_EQUAL(word & 0xE0, 0);
            CHECK((word & 31) == 0 || word >> 31 == 1); /* one number, one word */
        }
    }
}

/* "a word: mantissa times 2^shift units of 2^-24", the largest of which is 2^31 - 2^7 */
static void alpha_word_at_the_cap(void)
{
    CHECK_EQUAL(units_of(ALPHA_MAX), ALPHA_MAX_UNITS);
    CHECK_EQUAL(alpha_word(0xFFFFFF, 31), ALPHA_MAX);
    CHECK_EQUAL(alpha_word(0xFFFFFE, 31), ALPHA_MAX - 0x100);
    CHECK_EQUAL(alpha_word(0x800000, 31), UINT32_C(0x8000001F));
    CHECK_EQUAL(alpha_word(0x800000, 32), ALPHA_MAX);
    CHECK_EQUAL(alpha_word(0xFFFFFF, 30), ALPHA_MAX - 1);
}

/* "bits 7..5 are ignored", "every word is valid: 0 .. 2^31 - 2^7", "below 2^55": every shift */
static void units_of_every_word(void)
{
    static const uint32_t values[] = {0, 1, 2, 0x7FFFFF, 0x800000, 0xAAAAAA, 0xFFFFFE, 0xFFFFFF};
    for (uint32_t low = 0; low < 256; ++low) {
        for (size_t i = 0; i < COUNT(values); ++i) {
            GIVEN(values[i], low, 0);
            CHECK_EQUAL(units_of(values[i] << 8 | low), (uint64_t)values[i] << low % 32);
            CHECK(units_of(values[i] << 8 | low) <= ALPHA_MAX_UNITS);
        }
    }
    for (int i = 0; i < 50000; ++i) {
        const uint32_t word = (uint32_t)check_random();
        GIVEN(word, 0, 0);
        CHECK_EQUAL(units_of(word), (uint64_t)(word >> 8) << (word & 31));
    }
}

int main(void)
{
    members_follow_from_b_hat();
    uninformative_exactly_below_the_limit();
    square_of_ratio_is_in_range();
    alpha_word_over_its_range();
    alpha_word_at_the_cap();
    units_of_every_word();
    return check_report();
}
