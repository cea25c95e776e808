/* Static functions of the core, and invariants that need damaged memory: what a comparison with the
 * independent implementation (tests/third) cannot find, since a later step corrects it, only damaged memory
 * or few arguments show it. Everything else is proved for all arguments (tests/proofs) and compared there.
 * Expected values come from formulas of docs/design.md, computed in the widest type at hand, never from the
 * core. */
#include "check.h"

#include "mcp_asdf.c"

#include "mcp_asdf_image.c"

/* ---- Arithmetic ---- */

static void only_the_lower_6_bits_of_a_shift_count(void)
{
    static const uint64_t values[] = {UINT64_C(0x8123456789ABCDEF), 1, UINT64_MAX};
    for (size_t i = 0; i < COUNT(values); ++i) {
        for (uint32_t count = 0; count < 256; ++count) { /* of damaged memory the lower 6 bits count */
            GIVEN(values[i], count, 0);
            CHECK_EQUAL(shift_right_64(values[i], count), values[i] >> count % 64);
        }
    }
}

static void leading_zeros_are_counted_for_every_highest_bit(void)
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
static void reciprocals_follow_their_formula(void)
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
static void quotients_follow_their_formula_for_divisors_of_every_length(void)
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

/* ---- Size of a robot, tables, and invariants of damaged robots (docs/internals/properties.md) ---- */

/* The budget of RAM, where a pointer has 32 bits. */
typedef char robot_is_small[sizeof(void *) != 4 || sizeof(mcp_asdf_t) <= 176 ? 1 : -1];

/* Write the last word of a table: FNV-1a over those before. */
static void write_table_hash(uint32_t *table, uint32_t words)
{
    table[words - 1] = UINT32_C(0x811C9DC5);
    for (uint32_t i = 0; i < words - 1; ++i) {
        table[words - 1] = (table[words - 1] ^ table[i]) * UINT32_C(0x01000193);
    }
}

/* Tables of any q. Only their length may be wrong: it has to be 2 to 127. */
/* design: R28 */
static void a_table_has_entries_for_2_to_127(void)
{
    for (uint32_t q = 0; q <= 255; ++q) {
        uint32_t table[255 + 3] = {0x4D435400 + q, 1};
        for (uint32_t m = 2; m <= q + 1; ++m) {
            table[m] = (UINT32_C(63) << 26) - m;
        }
        write_table_hash(table, q + 3);
        const mcp_asdf_config_t config = MCP_ASDF_CONFIG_ASDF(table);
        mcp_asdf_t robot;
        CHECK(config.filter_period == 1000 && config.memory == MCP_ASDF_MEMORY_MAX);
        CHECK(config.table == table && config.filter == MCP_ASDF_ADAPTIVE);
        GIVEN(q, 0, 0);
        CHECK_EQUAL(mcp_asdf_init(&robot, &config, 0, 0xC0000000),
                    2 <= q && q <= 127 ? MCP_ASDF_OK : MCP_ASDF_ERR_TABLE);
    }
}

static const mcp_asdf_config_t config = {0, 6, 1000, MCP_ASDF_OFF};
static const mcp_asdf_config_t robust_config = {0, 6, 1000, MCP_ASDF_ROBUST};

/* A robot with observations, a closed round, and an open round in which one message has no confidence. */
static mcp_asdf_t make_busy_robot(const mcp_asdf_config_t *robot_config)
{
    mcp_asdf_t robot;
    CHECK_EQUAL(mcp_asdf_init(&robot, robot_config, 40, 0xC1000000), MCP_ASDF_OK);
    for (uint32_t tick = 0; tick < 38; ++tick) {
        for (uint8_t sender = 0; sender < 5; ++sender) {
            (void)mcp_asdf_receive(&robot, sender, 0x200000 + sender, sender == 2 ? 0 : 0x8123450A);
        }
        (void)mcp_asdf_step(&robot, tick % 3 == 0 ? MCP_ASDF_BLACK : MCP_ASDF_WHITE);
    }
    (void)mcp_asdf_receive(&robot, 7, 0x200000, 0x8000000A);
    (void)mcp_asdf_receive(&robot, 126, 0x300000, 0);
    CHECK(mcp_asdf_invariants_hold(&robot));
    return robot;
}

/* Check whether the invariants hold after a change of a busy robot. */
#define CHECK_INVARIANTS(change, expected) CHECK_INVARIANTS_WITH(&config, change, expected)
#define CHECK_INVARIANTS_WITH(robot_config, change, expected)                                                \
    do {                                                                                                     \
        mcp_asdf_t robot = make_busy_robot(robot_config);                                                    \
        change;                                                                                              \
        CHECK_EQUAL(mcp_asdf_invariants_hold(&robot), expected);                                             \
    } while (0)

/* The same if b_hat was updated before: x_hat and alpha then need not follow from t, n and b_hat. */
#define CHECK_INVARIANTS_UPDATED(change, expected) CHECK_INVARIANTS((robot.updated = 1, change), expected)

/* Whatever memory a damaged configuration has. */
static void a_t_beyond_the_longest_memory_breaks_an_invariant(void)
{
    static const mcp_asdf_config_t longest = {0, 6, MCP_ASDF_MEMORY_MAX, MCP_ASDF_OFF};
    static const mcp_asdf_config_t damaged = {0, 6, UINT32_MAX, MCP_ASDF_OFF};
    CHECK_INVARIANTS_UPDATED((robot.config = &longest, robot.t = MCP_ASDF_MEMORY_MAX - 1), true);
    CHECK_INVARIANTS_UPDATED((robot.config = &longest, robot.t = MCP_ASDF_MEMORY_MAX), false);
    CHECK_INVARIANTS_UPDATED((robot.config = &damaged, robot.t = MCP_ASDF_MEMORY_MAX), false);
}

/* To read it would take a time that grows with its length. */
static void a_check_of_the_invariants_does_not_read_the_table(void)
{
    static const uint32_t invalid_table[] = {1, 2, 3};
    static const mcp_asdf_config_t with_invalid_table = {invalid_table, 6, 1000, MCP_ASDF_ADAPTIVE};
    CHECK_INVARIANTS(robot.config = &with_invalid_table, true);
}

/* design: R17, R32 */
static void a_flipped_bit_of_the_accuracy_breaks_an_invariant(void)
{
    for (uint32_t bit = 0; bit < 32; ++bit) {
        const uint32_t flip = UINT32_C(1) << bit;
        GIVEN(bit, 0, 0);
        CHECK_INVARIANTS_UPDATED(robot.accuracy.b_hat ^= flip, false);
        CHECK_INVARIANTS_UPDATED(robot.accuracy.c ^= flip, false);
        CHECK_INVARIANTS_UPDATED(robot.accuracy.common ^= flip, false);
        CHECK_INVARIANTS_UPDATED(robot.accuracy.rare ^= flip, false);
        CHECK_INVARIANTS_UPDATED(robot.accuracy.g_shift ^= flip, false);
        CHECK_INVARIANTS_UPDATED(robot.accuracy.rare_shift ^= flip, false);
    }
}

static void an_estimate_that_does_not_follow_from_b_hat_breaks_an_invariant(void)
{
    CHECK_INVARIANTS(set_b_hat(&robot, 0xC1000000 - 4096), false);
}

static void a_robust_robot_with_another_filter_breaks_an_invariant(void)
{
    CHECK_INVARIANTS_WITH(&robust_config, (void)robot, true);
    CHECK_INVARIANTS_WITH(&robust_config, robot.config = &config, false);
}

static void a_robot_that_gets_the_robust_filter_breaks_an_invariant(void)
{
    CHECK_INVARIANTS(robot.config = &robust_config, false);
}

/* Images of a robot without the robust filter do not hold these members. */
static void members_of_the_robust_filter_that_changed_without_it_break_an_invariant(void)
{
    CHECK_INVARIANTS(++robot.robust.centre, false);
    CHECK_INVARIANTS(--robot.robust.spread, false);
    CHECK_INVARIANTS(robot.robust.initial_b_hat = robot.accuracy.b_hat, false);
    CHECK_INVARIANTS(robot.robust.filled_slots = 1, false);
    CHECK_INVARIANTS(robot.robust.batch_t = 1, false);
    CHECK_INVARIANTS(robot.robust.batch_n = 1, false);
    CHECK_INVARIANTS(robot.robust.votes = 1, false);
    CHECK_INVARIANTS(++robot.robust.dispersion, false);
    CHECK_INVARIANTS(robot.robust.turn = 1, false);
}

/* Of these bytes an image keeps one alone, 255. */
static void a_turn_beyond_the_last_slot_breaks_an_invariant(void)
{
    for (uint8_t turn = UINT8_MAX; turn > MCP_ASDF_SLOTS; --turn) {
        GIVEN(turn, 0, 0);
        CHECK_INVARIANTS_WITH(&robust_config, robot.robust.turn = turn, false);
    }
}

/* With a damaged turn the robot itself votes, until the invariants are checked. */
static void a_turn_beyond_the_last_slot_lets_the_robot_itself_vote(void)
{
    mcp_asdf_t robot = make_busy_robot(&robust_config);
    robot.robust.turn = UINT8_MAX;
    CHECK_EQUAL(mcp_asdf_settle(&robot), MCP_ASDF_OK);
    CHECK_EQUAL(robot.robust.turn, 0);
}

/* ---- Numbers and configurations that the header offers ---- */

/* Four messages of the closed round have an alpha of 0x812345 2^10 units; the fifth has none. */
static void beta_is_the_sum_of_alpha_in_the_closed_round(void)
{
    const mcp_asdf_t robot = make_busy_robot(&config);
    CHECK_EQUAL(mcp_asdf_beta(&robot), UINT64_C(4) * 0x812345 << 10);
}

static void beta_is_zero_with_the_robust_filter(void)
{
    const mcp_asdf_t robot = make_busy_robot(&robust_config);
    CHECK(robot.robust.filled_slots != 0);
    CHECK_EQUAL(mcp_asdf_beta(&robot), 0);
}

/* Against 64-bit arithmetic, for every x_hat, x_bar and x. */
static void thousandths_are_rounded_to_nearest(void)
{
    for (uint32_t x = 0; x <= MCP_ASDF_ONE; ++x) {
        GIVEN(x, 0, 0);
        CHECK_EQUAL(mcp_asdf_thousandths(x), (UINT64_C(1000) * x + MCP_ASDF_HALF) / MCP_ASDF_ONE);
    }
    CHECK_EQUAL(mcp_asdf_thousandths(MCP_ASDF_B_HAT_MAX >> 9), 1000);
}

/* As initialisers of static objects, which have to be constants. */
static void probabilities_are_rounded_to_nearest(void)
{
    static const uint32_t probabilities[] = {
        MCP_ASDF_PROBABILITY(0, 1),
        MCP_ASDF_PROBABILITY(95, 100),
        MCP_ASDF_PROBABILITY(55, 100),
        MCP_ASDF_PROBABILITY(999999, 1000000),
        MCP_ASDF_PROBABILITY(UINT32_C(4294967294), UINT32_C(4294967295)),
        MCP_ASDF_PROBABILITY(1, 1),
        MCP_ASDF_PROBABILITY(120, 100),
    };
    CHECK_EQUAL(probabilities[0], 0);
    CHECK_EQUAL(probabilities[1], 0xF3333333); /* 0.95 2^32 is this and 0.2 */
    CHECK_EQUAL(probabilities[2], 0x8CCCCCCD); /* 0.55 2^32 is 0.2 less */
    CHECK_EQUAL(probabilities[3], 0xFFFFEF39); /* 2^32 - 4294.97 */
    CHECK_EQUAL(probabilities[4], UINT32_MAX);
    CHECK_EQUAL(probabilities[5], UINT32_MAX);
    CHECK_EQUAL(probabilities[6], UINT32_MAX);
}

static void certainty_is_refused_as_an_accuracy(void)
{
    mcp_asdf_t robot;
    CHECK_EQUAL(mcp_asdf_init(&robot, &config, 0, MCP_ASDF_PROBABILITY(1, 1)), MCP_ASDF_ERR_B_HAT);
    CHECK_EQUAL(mcp_asdf_init(&robot, &config, 0, MCP_ASDF_PROBABILITY(0, 1)), MCP_ASDF_ERR_B_HAT);
    CHECK_EQUAL(mcp_asdf_init(&robot, &config, 0, MCP_ASDF_PROBABILITY(95, 100)), MCP_ASDF_OK);
}

static void configurations_have_the_filter_that_their_name_says(void)
{
    static const uint32_t table[1] = {0};
    static const mcp_asdf_config_t asdf = MCP_ASDF_CONFIG_ASDF(table), off = MCP_ASDF_CONFIG_OFF,
                                   robust = MCP_ASDF_CONFIG_ROBUST;
    CHECK(asdf.filter == MCP_ASDF_ADAPTIVE && asdf.table == table);
    CHECK(off.filter == MCP_ASDF_OFF && off.table == NULL);
    CHECK(robust.filter == MCP_ASDF_ROBUST && robust.table == NULL);
    CHECK(off.filter_period == 1000 && off.memory == MCP_ASDF_MEMORY_MAX);
    CHECK(robust.filter_period == 1000 && robust.memory == MCP_ASDF_MEMORY_MAX);
}

/* The tests that try the most values come last: of the many mistakes that tests/mutation plants, most fail a
 * quicker test before. */
int main(void)
{
    beta_is_the_sum_of_alpha_in_the_closed_round();
    beta_is_zero_with_the_robust_filter();
    probabilities_are_rounded_to_nearest();
    certainty_is_refused_as_an_accuracy();
    configurations_have_the_filter_that_their_name_says();
    only_the_lower_6_bits_of_a_shift_count();
    leading_zeros_are_counted_for_every_highest_bit();
    reciprocals_follow_their_formula();
    quotients_follow_their_formula_for_divisors_of_every_length();
    a_table_has_entries_for_2_to_127();
    a_t_beyond_the_longest_memory_breaks_an_invariant();
    a_check_of_the_invariants_does_not_read_the_table();
    a_flipped_bit_of_the_accuracy_breaks_an_invariant();
    an_estimate_that_does_not_follow_from_b_hat_breaks_an_invariant();
    a_robust_robot_with_another_filter_breaks_an_invariant();
    a_robot_that_gets_the_robust_filter_breaks_an_invariant();
    members_of_the_robust_filter_that_changed_without_it_break_an_invariant();
    a_turn_beyond_the_last_slot_breaks_an_invariant();
    a_turn_beyond_the_last_slot_lets_the_robot_itself_vote();
    thousandths_are_rounded_to_nearest();
    products_are_exact();
    return check_report();
}
