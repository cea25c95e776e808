/* White box: what the independent implementation (tests/third) cannot see of the arithmetic, since a later
 * step corrects it, only damaged memory asks for it, or few arguments do. Everything else about it is proved
 * for all arguments (tests/proofs) and compared there. */
#include "white_box.h"

static void shifts_by_any_count(void)
{
    static const uint64_t values[] = {UINT64_C(0x8123456789ABCDEF), 1, UINT64_MAX};
    for (size_t i = 0; i < COUNT(values); ++i) {
        for (uint32_t count = 0; count < 256; ++count) { /* of damaged memory the lower 6 bits count */
            GIVEN(values[i], count, 0);
            CHECK_EQUAL(shift_right_64(values[i], count), values[i] >> count % 64);
        }
    }
}

static void zeros_lead_in_every_word(void)
{
    CHECK_EQUAL(leading_zeros(0), 31);
    for (uint32_t bit = 0; bit < 32; ++bit) {
        const uint32_t power = UINT32_C(1) << bit;
        GIVEN(bit, 0, 0);
        CHECK_EQUAL(leading_zeros(power), 31 - bit);
        CHECK_EQUAL(leading_zeros(power | (power - 1)), 31 - bit);
    }
}

static void products_are_exact(void)
{
    for (uint32_t i = 0; i < 1000000; ++i) { /* a carry shows in one of 100,000 */
        const uint32_t a = check_random_word() - (i & 1), b = check_random_word() - (i >> 1 & 1);
        GIVEN(a, b, 0);
        CHECK_EQUAL(multiply(a, b), (uint64_t)a * b);
        CHECK_EQUAL(multiply_high(a, b), (uint64_t)a * b >> 32);
    }
}

/* Divisors where one unit more or less, or another entry, makes another reciprocal; and those of damaged
 * memory. */
static void reciprocals_are_pinned(void)
{
#if MCP_ASDF_DIVIDE == MCP_ASDF_DIVIDE_BY_TABLE
    /* Entry i is 1 + 256 (1 / y - 1), rounded, at y = (129 + 2 i) / 256, and at y = 1. */
    for (uint32_t i = 0; i < 64; ++i) {
        const uint32_t over = 129 + 2 * i, above = 256 * (256 - over);
        GIVEN(i, 0, 0);
        CHECK_EQUAL(reciprocals[i], 1 + (2 * above + over) / (2 * over));
    }
    CHECK_EQUAL(reciprocals[64], 1);
    CHECK_EQUAL(prepare(UINT32_MAX), 0); /* the last entry, 2^8 as Q8 */
    CHECK_EQUAL(prepare(UINT32_C(0x81000000)), 0x7EFF);
#elif MCP_ASDF_DIVIDE == MCP_ASDF_DIVIDE_BY_INCLUDER
    CHECK_EQUAL(prepare(UINT32_C(0x400C8100)), 65485);
    CHECK_EQUAL(prepare(UINT32_C(0x401C0A00)), 65424);
    CHECK_EQUAL(prepare(0), prepare(UINT32_C(1) << 29));
    CHECK_EQUAL(prepare(UINT32_C(0x18000000)), prepare(UINT32_C(1) << 29));
#elif MCP_ASDF_DIVIDE == MCP_ASDF_DIVIDE_BY_HARDWARE
    /* The upper bits of d, rounded up, and more only where they are a whole number already. */
    CHECK_EQUAL(prepare(UINT32_C(1) << 30), 32769);
    CHECK_EQUAL(prepare((UINT32_C(1) << 30) + 32767), 32769);
    CHECK_EQUAL(prepare(UINT32_C(1) << 31), 65537);
#endif
}

/* upper(N, D) of docs/design.md, section 8, for divisors of every length, where the dividend is the divisor,
 * 1 less, or next to nothing. */
static void quotients_at_their_ends(void)
{
    for (uint32_t i = 0; i < 64 * 64; ++i) {
        const uint32_t highest = i % 64, widen = highest < 32 ? 32 : 0, s = highest + widen - 31;
        const uint64_t power = UINT64_C(1) << highest, random = check_random_word();
        const uint64_t rest = i < 64 ? 0 : i < 128 ? UINT64_MAX : random << 32 | check_random_word();
        const uint64_t d = power | rest % power, dividends[] = {d, d - 1, 1, 0};
        for (size_t k = 0; k < COUNT(dividends); ++k) {
            const uint64_t n = dividends[k];
            GIVEN(n, d, 0);
            CHECK_EQUAL(quotient(n, d), (n << widen >> s << 31) / ((d << widen >> s >> 1) + 1));
        }
    }
}

int main(void)
{
    shifts_by_any_count();
    zeros_lead_in_every_word();
    products_are_exact();
    reciprocals_are_pinned();
    quotients_at_their_ends();
    return check_report();
}
