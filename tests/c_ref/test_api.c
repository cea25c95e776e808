/* Black box: what mcp_asdf.h promises, through its functions alone. */
#include "check.h"
#include "mcp_asdf.h"

#include <string.h>

#define ID 9
#define B_HAT UINT32_C(0xC0000000)
#define ALPHA_ONE UINT32_C(0x3F800000)
#define WORDS 34 /* of the q = 30 table */
#define FNV_START UINT32_C(0x811C9DC5)
#define FNV_FACTOR UINT32_C(0x01000193)

/* The budget of RAM, where a pointer has 32 bits. */
typedef char robot_is_small[sizeof(void *) != 4 || sizeof(mcp_asdf_t) <= 176 ? 1 : -1];

extern const uint32_t mcp_asdf_t_table_omega05_q30[WORDS];
static const mcp_asdf_config_t usual = MCP_ASDF_CONFIG(mcp_asdf_t_table_omega05_q30);
static const mcp_asdf_config_t plain = {0, 2, 4, 64, MCP_ASDF_OFF};

static mcp_asdf_t robot_from(uint8_t filling, const mcp_asdf_config_t *config)
{
    mcp_asdf_t robot;
    memset(&robot, filling, sizeof robot);
    CHECK_EQUAL(mcp_asdf_init(&robot, config, ID, B_HAT), MCP_ASDF_OK);
    CHECK(mcp_asdf_invariants_hold(&robot));
    return robot;
}

static bool same(const mcp_asdf_t *left, const mcp_asdf_t *right)
{
    uint8_t a[MCP_ASDF_IMAGE_SIZE], b[MCP_ASDF_IMAGE_SIZE];
    mcp_asdf_save(left, a);
    mcp_asdf_save(right, b);
    return memcmp(a, b, sizeof a) == 0;
}

static void init_writes_every_member(void)
{
    mcp_asdf_t robot = robot_from(0xA5, &usual), other = robot_from(0x5A, &usual);
    const mcp_asdf_counters_t counters = mcp_asdf_counters(&robot);
    CHECK(same(&robot, &other));
    CHECK_EQUAL(mcp_asdf_t_count(&robot), 0);
    CHECK_EQUAL(mcp_asdf_n_count(&robot), 0);
    CHECK_EQUAL(mcp_asdf_b_hat(&robot), B_HAT);
    CHECK_EQUAL(mcp_asdf_x_hat(&robot), MCP_ASDF_HALF);
    CHECK_EQUAL(mcp_asdf_alpha(&robot), 0);
    CHECK_EQUAL(mcp_asdf_x_bar(&robot), MCP_ASDF_HALF);
    CHECK_EQUAL(mcp_asdf_beta(&robot), 0);
    CHECK_EQUAL(mcp_asdf_x(&robot), MCP_ASDF_HALF);
    CHECK((counters.accepted | counters.repeated | counters.rejected | counters.tests | counters.updates) ==
          0);
    for (int tick = 0; tick < 3000; ++tick) {
        const mcp_asdf_observation_t z = (mcp_asdf_observation_t)(check_random() % 3);
        CHECK_EQUAL(mcp_asdf_step(&robot, z), mcp_asdf_step(&other, z));
    }
    CHECK(same(&robot, &other) && mcp_asdf_invariants_hold(&robot) && mcp_asdf_invariants_hold(&other));
}

static void check_init(const mcp_asdf_config_t *config, uint8_t id, uint32_t b_hat,
                       mcp_asdf_status_t expected)
{
    uint8_t image[MCP_ASDF_IMAGE_SIZE];
    mcp_asdf_t robot, before, good = robot_from(0xA5, &plain);
    memset(&robot, 0xA5, sizeof robot);
    memset(&before, 0xA5, sizeof before);
    CHECK_EQUAL(mcp_asdf_init(&robot, config, id, b_hat), expected);
    CHECK((memcmp(&robot, &before, sizeof robot) == 0) == (expected != MCP_ASDF_OK));
    if (expected == MCP_ASDF_ERR_CONFIG || expected == MCP_ASDF_ERR_TABLE) {
        mcp_asdf_save(&good, image);
        memcpy(&robot, &before, sizeof robot);
        CHECK_EQUAL(mcp_asdf_restore(&robot, config, image), expected);
        CHECK(memcmp(&robot, &before, sizeof robot) == 0);
    }
}

static void init_refuses_bad_settings(void)
{
    static const mcp_asdf_config_t bad[] = {
        {0, 0, 4, 64, MCP_ASDF_OFF}, {0, 2, 0, 64, MCP_ASDF_OFF},          {0, 2, 3, 64, MCP_ASDF_OFF},
        {0, 2, 1, 64, MCP_ASDF_OFF}, {0, 2, 4, 62, MCP_ASDF_OFF},          {0, 2, 4, 65, MCP_ASDF_OFF},
        {0, 2, 4, 0, MCP_ASDF_OFF},  {0, 2, 4, UINT32_MAX, MCP_ASDF_OFF},  {0, 2, 4, 64, 3},
        {0, 2, 4, 64, 255},          {0, UINT32_MAX, 1, 64, MCP_ASDF_OFF}, {0, 0, 0, 64, MCP_ASDF_OFF},
    };
    static const mcp_asdf_config_t good[] = {
        {0, 1, 1, 64, MCP_ASDF_OFF},
        {0, UINT32_MAX, UINT32_MAX, MCP_ASDF_MEMORY_MAX, MCP_ASDF_ALWAYS},
        {0, 7, 7 * 13, 66, MCP_ASDF_ALWAYS},
    };
    for (size_t i = 0; i < COUNT(bad); ++i) {
        GIVEN(i, 0, 0);
        check_init(&bad[i], ID, B_HAT, MCP_ASDF_ERR_CONFIG);
    }
    for (size_t i = 0; i < COUNT(good); ++i) {
        check_init(&good[i], ID, B_HAT, MCP_ASDF_OK);
    }
    check_init(&plain, 127, B_HAT, MCP_ASDF_OK);
    check_init(&plain, 128, B_HAT, MCP_ASDF_ERR_ID);
    check_init(&plain, 255, B_HAT, MCP_ASDF_ERR_ID);
    check_init(&plain, ID, MCP_ASDF_B_HAT_MIN, MCP_ASDF_OK);
    check_init(&plain, ID, MCP_ASDF_B_HAT_MIN - 1, MCP_ASDF_ERR_B_HAT);
    check_init(&plain, ID, MCP_ASDF_B_HAT_MAX, MCP_ASDF_OK);
    check_init(&plain, ID, MCP_ASDF_B_HAT_MAX + 1, MCP_ASDF_ERR_B_HAT);
    check_init(&plain, ID, 0, MCP_ASDF_ERR_B_HAT);
    check_init(&plain, 128, 0, MCP_ASDF_ERR_ID); /* the first complaint counts */
    check_init(&bad[0], 128, 0, MCP_ASDF_ERR_CONFIG);
}

/* ---- The table ---- */

static uint32_t table[4 + 127]; /* a table of WORDS words, and room for as many as a damaged q may claim */
static const mcp_asdf_config_t with_table = MCP_ASDF_CONFIG(table);

static void seal(uint32_t words)
{
    uint32_t hash = FNV_START;
    for (uint32_t i = 0; i < words; ++i) {
        hash = i == 3 ? hash : (hash ^ table[i]) * FNV_FACTOR;
    }
    table[3] = hash;
}

/* Word `index` of the good table becomes `value`, under a right checksum over `words`. */
static void check_word(uint32_t index, uint32_t value, uint32_t words, mcp_asdf_status_t expected)
{
    memcpy(table, mcp_asdf_t_table_omega05_q30, sizeof mcp_asdf_t_table_omega05_q30);
    table[index] = value;
    seal(words);
    GIVEN(index, value, words);
    check_init(&with_table, ID, B_HAT, expected);
}

static void table_fields_have_ranges(void)
{
    const uint32_t *const good = mcp_asdf_t_table_omega05_q30;
    const mcp_asdf_config_t without = MCP_ASDF_CONFIG(0);
    check_init(&without, ID, B_HAT, MCP_ASDF_ERR_TABLE);
    check_word(0, good[0], WORDS, MCP_ASDF_OK);
    CHECK_EQUAL(table[3], good[3]);
    check_word(0, good[0] ^ 1, WORDS, MCP_ASDF_ERR_TABLE);
    check_word(1, good[1] + (1U << 24), WORDS, MCP_ASDF_ERR_TABLE); /* version 2 */
    check_word(1, good[1] & 0xFFFFFF, WORDS, MCP_ASDF_ERR_TABLE);   /* version 0 */
    check_word(1, good[1] | 1, WORDS, MCP_ASDF_ERR_TABLE);          /* a bit that must be zero */
    check_word(1, (good[1] & 0xFF00FFFF) | 1U << 16, 4 + 1, MCP_ASDF_ERR_TABLE);
    check_word(1, (good[1] & 0xFF00FFFF) | 2U << 16, 4 + 2, MCP_ASDF_OK);
    check_word(1, (good[1] & 0xFF00FFFF) | 0U << 16, 4, MCP_ASDF_ERR_TABLE);
    check_word(1, (good[1] & 0xFF00FFFF) | 128U << 16, WORDS, MCP_ASDF_ERR_TABLE);
    check_word(1, good[1] & 0xFFFF00FF, WORDS, MCP_ASDF_ERR_TABLE); /* F = 0 */
    check_word(1, (good[1] & 0xFFFF00FF) | 32U << 8, WORDS, MCP_ASDF_ERR_TABLE);
    check_word(2, 0, WORDS, MCP_ASDF_ERR_TABLE);
    check_word(2, 1, WORDS, MCP_ASDF_OK);
    check_word(2, 3865470566U, WORDS, MCP_ASDF_OK); /* 0.9 */
    check_word(2, 3865470567U, WORDS, MCP_ASDF_ERR_TABLE);
}

static void table_entries_fall(void)
{
    static const uint32_t entries[] = {3, 2}; /* would be entries in units of 2^0 */
    const uint32_t *const good = mcp_asdf_t_table_omega05_q30;
    check_word(4, UINT32_MAX - 1, WORDS, MCP_ASDF_OK); /* F = 30: far below 64.0 */
    check_word(10, good[9], WORDS, MCP_ASDF_ERR_TABLE);
    check_word(10, good[9] - 1, WORDS, MCP_ASDF_OK);
    check_word(10, good[11], WORDS, MCP_ASDF_ERR_TABLE);
    check_word(10, good[11] + 1, WORDS, MCP_ASDF_OK);
    check_word(WORDS - 1, 1U << 30, WORDS, MCP_ASDF_ERR_TABLE); /* 1.0 */
    check_word(WORDS - 1, (1U << 30) + 1, WORDS, MCP_ASDF_OK);
    check_word(WORDS - 1, good[WORDS - 2], WORDS, MCP_ASDF_ERR_TABLE);
    for (uint32_t fraction_bits = 0; fraction_bits < 2; ++fraction_bits) {
        memcpy(table, good, sizeof mcp_asdf_t_table_omega05_q30);
        memcpy(&table[4], entries, sizeof entries);
        table[1] = 1U << 24 | 2U << 16 | fraction_bits << 8;
        table[5] += fraction_bits; /* 3.0 and 2.0 or, in units of 1/2, 2.5 and 1.5 */
        table[4] += 2 * fraction_bits;
        seal(4 + 2);
        check_init(&with_table, ID, B_HAT, fraction_bits == 0 ? MCP_ASDF_ERR_TABLE : MCP_ASDF_OK);
    }
}

/* A damaged q is no exception: with words behind the table that fall on as entries do. */
static void every_flipped_bit_of_a_table_is_refused(void)
{
    for (uint32_t bit = 0; bit < 32 * WORDS; ++bit) {
        memcpy(table, mcp_asdf_t_table_omega05_q30, sizeof mcp_asdf_t_table_omega05_q30);
        for (uint32_t i = WORDS; i < COUNT(table); ++i) {
            table[i] = table[i - 1] - 1;
        }
        table[bit / 32] ^= UINT32_C(1) << bit % 32;
        GIVEN(bit, 0, 0);
        check_init(&with_table, ID, B_HAT, MCP_ASDF_ERR_TABLE);
    }
}

/* ---- Messages ---- */

static void check_rejected(uint8_t sender, uint32_t x_hat, uint32_t alpha, mcp_asdf_status_t expected)
{
    mcp_asdf_t robot = robot_from(0xA5, &plain), other = robot_from(0xA5, &plain);
    (void)mcp_asdf_observe(&robot, MCP_ASDF_BLACK);
    (void)mcp_asdf_observe(&other, MCP_ASDF_BLACK);
    GIVEN(sender, x_hat, alpha);
    CHECK_EQUAL(mcp_asdf_receive(&robot, sender, x_hat, alpha), expected);
    CHECK_EQUAL(mcp_asdf_counters(&robot).rejected, 1);
    ++other.counters.rejected;
    CHECK(same(&robot, &other));
}

static void receive_refuses_what_is_no_message(void)
{
    static const uint32_t alphas[] = {0x80000000, 0x80000001, 0xBF800000, 0xFF800000, 0x7F800000,
                                      0x7F800001, 0x7FC00000, 0xFFFFFFFF, 0x7FFFFFFF};
    for (size_t i = 0; i < COUNT(alphas); ++i) {
        check_rejected(1, MCP_ASDF_HALF, alphas[i], MCP_ASDF_ERR_ALPHA);
    }
    check_rejected(ID, MCP_ASDF_HALF, ALPHA_ONE, MCP_ASDF_ERR_SENDER);
    check_rejected(128, MCP_ASDF_HALF, ALPHA_ONE, MCP_ASDF_ERR_SENDER);
    check_rejected(255, MCP_ASDF_HALF, ALPHA_ONE, MCP_ASDF_ERR_SENDER);
    check_rejected(1, MCP_ASDF_ONE + 1, ALPHA_ONE, MCP_ASDF_ERR_X_HAT);
    check_rejected(1, UINT32_MAX, ALPHA_ONE, MCP_ASDF_ERR_X_HAT);
    check_rejected(ID, UINT32_MAX, UINT32_MAX, MCP_ASDF_ERR_SENDER); /* checked in the order of the header */
    check_rejected(1, UINT32_MAX, UINT32_MAX, MCP_ASDF_ERR_X_HAT);
}

static void receive_takes_any_other_alpha(void)
{
    static const uint32_t alphas[] = {0,          1,          0x007FFFFF,         0x00800000,
                                      0x337FFFFF, 0x33800000, 0x33800001,         0x3EFFFFFF,
                                      0x3F000001, 0x4EFFFFFF, MCP_ASDF_ALPHA_MAX, 0x7F7FFFFF};
    static const uint64_t units[] = {
        0, 0, 0, 0, 0, 1, 1, 0x7FFFFF, 0x800001, 0x7FFFFF80000000, 0x7FFFFF80000000, 0x7FFFFF80000000};
    for (size_t i = 0; i < COUNT(alphas); ++i) {
        mcp_asdf_t robot = robot_from(0xA5, &plain);
        GIVEN(alphas[i], 0, 0);
        CHECK_EQUAL(mcp_asdf_receive(&robot, 0, MCP_ASDF_ONE, alphas[i]), MCP_ASDF_OK);
        CHECK_EQUAL(mcp_asdf_receive(&robot, 0, 0, ALPHA_ONE), MCP_ASDF_REPEATED);
        (void)mcp_asdf_step(&robot, MCP_ASDF_NONE);
        CHECK_EQUAL(mcp_asdf_beta(&robot), 0); /* comms_period is 2 */
        (void)mcp_asdf_step(&robot, MCP_ASDF_NONE);
        CHECK_EQUAL(mcp_asdf_beta(&robot), units[i]);
        CHECK_EQUAL(mcp_asdf_x_bar(&robot), units[i] == 0 ? MCP_ASDF_HALF : MCP_ASDF_ONE);
        CHECK(mcp_asdf_counters(&robot).accepted == 1 && mcp_asdf_counters(&robot).repeated == 1);
    }
}

static void observe_refuses_what_is_no_colour(void)
{
    static const int wrong[] = {3, 4, 255, 0x7FFF};
    for (size_t i = 0; i < COUNT(wrong); ++i) {
        mcp_asdf_t robot = robot_from(0xA5, &plain), other = robot_from(0xA5, &plain);
        CHECK_EQUAL(mcp_asdf_observe(&robot, (mcp_asdf_observation_t)wrong[i]), MCP_ASDF_ERR_OBSERVATION);
        CHECK_EQUAL(mcp_asdf_step(&robot, (mcp_asdf_observation_t)wrong[i]), MCP_ASDF_ERR_OBSERVATION);
        CHECK(same(&robot, &other));
    }
}

/* An error while a round waits to be settled: it goes on waiting. */
static void an_error_settles_nothing(void)
{
    mcp_asdf_t robot = robot_from(0xA5, &plain), other;
    (void)mcp_asdf_step(&robot, MCP_ASDF_BLACK);
    CHECK_EQUAL(mcp_asdf_observe(&robot, MCP_ASDF_BLACK), MCP_ASDF_DUE);
    (void)mcp_asdf_receive(&robot, 1, 0, ALPHA_ONE);
    other = robot;
    CHECK_EQUAL(mcp_asdf_step(&robot, (mcp_asdf_observation_t)3), MCP_ASDF_ERR_OBSERVATION);
    CHECK(same(&robot, &other));
    CHECK_EQUAL(mcp_asdf_observe(&robot, MCP_ASDF_NONE), MCP_ASDF_DUE); /* still */
    (void)mcp_asdf_settle(&robot);
    CHECK(mcp_asdf_beta(&robot) != 0 && mcp_asdf_invariants_hold(&robot));
    CHECK_EQUAL(mcp_asdf_observe(&robot, MCP_ASDF_NONE), MCP_ASDF_OK);
}

/* memory is 64: 32 observations stay, half of the black ones to nearest, ties to even */
static void halving_takes_ties_to_even(void)
{
    for (uint32_t black = 0; black <= 64; ++black) {
        mcp_asdf_t robot = robot_from(0xA5, &plain);
        for (uint32_t tick = 0; tick < 64; ++tick) {
            (void)mcp_asdf_step(&robot, tick < black ? MCP_ASDF_BLACK : MCP_ASDF_WHITE);
        }
        GIVEN(black, 0, 0);
        CHECK_EQUAL(mcp_asdf_t_count(&robot), 32);
        CHECK_EQUAL(mcp_asdf_n_count(&robot), black / 2 + (black % 4 == 3));
    }
}

static void no_filter_without_observations(void)
{
    static const mcp_asdf_config_t always = {0, 1, 1, 64, MCP_ASDF_ALWAYS};
    mcp_asdf_t robot = robot_from(0xA5, &always);
    (void)mcp_asdf_receive(&robot, 1, 0, ALPHA_ONE);
    (void)mcp_asdf_observe(&robot, MCP_ASDF_NONE);
    CHECK_EQUAL(mcp_asdf_settle(&robot), MCP_ASDF_OK);
    CHECK_EQUAL(mcp_asdf_b_hat(&robot), B_HAT);
    (void)mcp_asdf_receive(&robot, 1, 0, ALPHA_ONE);
    (void)mcp_asdf_observe(&robot, MCP_ASDF_BLACK);
    CHECK_EQUAL(mcp_asdf_settle(&robot), MCP_ASDF_UPDATED);
    CHECK_EQUAL(mcp_asdf_b_hat(&robot), MCP_ASDF_B_HAT_MIN); /* all black where none is */
}

/* ---- Saving, and rounds from sums ---- */

static void restored_robots_go_on_alike(void)
{
    for (int ticks = 0; ticks < 130; ++ticks) {
        mcp_asdf_t robot = robot_from(0xA5, &plain), copy;
        uint8_t image[MCP_ASDF_IMAGE_SIZE];
        for (int tick = 0; tick < ticks; ++tick) {
            (void)mcp_asdf_receive(&robot, (uint8_t)(check_random() % 128), (uint32_t)check_random() >> 9,
                                   ALPHA_ONE);
            (void)mcp_asdf_step(&robot, (mcp_asdf_observation_t)(check_random() % 3));
        }
        (void)mcp_asdf_receive(&robot, 1, 12345, 54321);
        mcp_asdf_save(&robot, image);
        memset(&copy, 0xA5, sizeof copy);
        CHECK_EQUAL(mcp_asdf_restore(&copy, &plain, image), MCP_ASDF_OK);
        CHECK(same(&robot, &copy) && mcp_asdf_invariants_hold(&copy));
        CHECK_EQUAL(mcp_asdf_receive(&copy, 1, 12345, 54321), mcp_asdf_receive(&robot, 1, 12345, 54321));
        CHECK_EQUAL(mcp_asdf_step(&copy, MCP_ASDF_BLACK), mcp_asdf_step(&robot, MCP_ASDF_BLACK));
        CHECK(same(&robot, &copy) && mcp_asdf_x(&robot) == mcp_asdf_x(&copy));
    }
}

static void an_image_must_fit_the_config(void)
{
    static const mcp_asdf_config_t shorter = {0, 1, 2, 64, MCP_ASDF_OFF}, other = {0, 2, 8, 64, MCP_ASDF_OFF};
    mcp_asdf_t robot = robot_from(0xA5, &plain), copy;
    uint8_t image[MCP_ASDF_IMAGE_SIZE];
    mcp_asdf_save(&robot, image);
    CHECK_EQUAL(mcp_asdf_restore(&copy, &shorter, image), MCP_ASDF_ERR_IMAGE); /* 2 ticks left of 1 */
    CHECK_EQUAL(mcp_asdf_restore(&copy, &other, image), MCP_ASDF_OK); /* 4 of 8: a moment that can be */
    memset(image, 0, sizeof image);
    CHECK_EQUAL(mcp_asdf_restore(&copy, &plain, image), MCP_ASDF_ERR_IMAGE);
    memset(image, 0xFF, sizeof image);
    CHECK_EQUAL(mcp_asdf_restore(&copy, &plain, image), MCP_ASDF_ERR_IMAGE);
}

static void add_round_is_receiving_one_by_one(void)
{
    mcp_asdf_t robot = robot_from(0xA5, &plain), other = robot_from(0xA5, &plain);
    mcp_asdf_sums_t sums = {0, 0, 0, 0, 0, 0};
    for (uint8_t sender = 10; sender < 90; ++sender) {
        const uint32_t x_hat = (uint32_t)check_random() >> 9, alpha = (uint32_t)check_random() % 0x7F800000;
        CHECK_EQUAL(mcp_asdf_receive(&robot, sender, x_hat, alpha), MCP_ASDF_OK);
        (void)mcp_asdf_sums_add(&sums, x_hat, alpha);
    }
    CHECK_EQUAL(mcp_asdf_add_round(&other, &sums, 80), MCP_ASDF_OK);
    CHECK_EQUAL(mcp_asdf_counters(&other).accepted, 80);
    for (int tick = 0; tick < 2; ++tick) { /* whose message it was is forgotten when the round closes */
        (void)mcp_asdf_step(&robot, MCP_ASDF_BLACK);
        (void)mcp_asdf_step(&other, MCP_ASDF_BLACK);
    }
    CHECK(same(&robot, &other) && mcp_asdf_beta(&robot) != 0);
}

static void add_round_refuses_impossible_sums(void)
{
    static const mcp_asdf_sums_t one = {1 << 24, UINT64_C(1) << 47, 0, UINT64_C(1) << 46, 1 << 23, 1},
                                 none = {0, 0, 0, 0, 0, 0};
    mcp_asdf_sums_t bad[11];
    mcp_asdf_t robot = robot_from(0xA5, &plain), other = robot_from(0xA5, &plain);
    for (size_t i = 0; i < COUNT(bad); ++i) {
        bad[i] = one;
    }
    bad[0].alpha = UINT64_C(1) << 55;
    bad[1].alpha_x_low = UINT64_C(1) << 56;
    bad[2].alpha_x_high = UINT64_C(1) << 47;
    bad[3].x_squared += 1;
    bad[4].x += 1;
    bad[5].count = 0;
    bad[6].alpha -= 1; /* now the mean is above 1.0 */
    bad[7].alpha = 0;
    bad[8].alpha_x_low += 1;
    bad[9].x_squared -= 1;                         /* below the square of the mean */
    bad[10] = (mcp_asdf_sums_t){0, 0, 0, 0, 0, 1}; /* x_hat = 0, but with no confidence */
    for (size_t i = 0; i < COUNT(bad); ++i) {
        GIVEN(i, 0, 0);
        CHECK_EQUAL(mcp_asdf_add_round(&robot, &bad[i], 1), MCP_ASDF_ERR_SUMS);
    }
    CHECK_EQUAL(mcp_asdf_add_round(&robot, &one, 0), MCP_ASDF_ERR_SUMS);
    CHECK_EQUAL(mcp_asdf_add_round(&robot, &none, 128), MCP_ASDF_ERR_SUMS);
    CHECK(same(&robot, &other));
    CHECK_EQUAL(mcp_asdf_add_round(&robot, &one, 2), MCP_ASDF_OK);
    CHECK_EQUAL(mcp_asdf_add_round(&robot, &none, 127), MCP_ASDF_ERR_SUMS);
    CHECK_EQUAL(mcp_asdf_add_round(&robot, &none, 126), MCP_ASDF_OK);
}

static void add_round_takes_a_message_of_the_least_confidence(void)
{
    static const mcp_asdf_sums_t least = {1, 0, 0, 0, 0, 1};
    mcp_asdf_t robot = robot_from(0xA5, &plain);
    CHECK_EQUAL(mcp_asdf_add_round(&robot, &least, 1), MCP_ASDF_OK);
}

/* The open round's own sums may be added to it: they are read before they are written. */
static void add_round_takes_the_open_round_itself(void)
{
    mcp_asdf_t robot = robot_from(0xA5, &plain);
    CHECK_EQUAL(mcp_asdf_receive(&robot, 1, MCP_ASDF_ONE, ALPHA_ONE), MCP_ASDF_OK);
    CHECK_EQUAL(mcp_asdf_add_round(&robot, &robot.open, 2), MCP_ASDF_OK);
    CHECK(robot.open.count == 2 && robot.silent == 1 && robot.open.x == 2 * MCP_ASDF_ONE);
    CHECK(mcp_asdf_invariants_hold(&robot));
}

/* Sender 0 is counted among those heard: a full load of silent messages leaves room for its message alone. */
static void invariants_count_every_sender(void)
{
    static const mcp_asdf_sums_t none = {0, 0, 0, 0, 0, 0};
    const uint8_t senders[] = {0, 31, 32, 127};
    for (size_t i = 0; i < COUNT(senders); ++i) {
        mcp_asdf_t robot = robot_from(0xA5, &plain);
        CHECK_EQUAL(mcp_asdf_add_round(&robot, &none, 127), MCP_ASDF_OK);
        CHECK_EQUAL(mcp_asdf_receive(&robot, senders[i], 0, 0), MCP_ASDF_OK);
        GIVEN(senders[i], 0, 0);
        CHECK(mcp_asdf_invariants_hold(&robot));
        robot.heard.of[senders[i] / 8] = 0;
        CHECK(!mcp_asdf_invariants_hold(&robot));
    }
}

/* A round that add_round() has filled takes no further sender; one that was heard before is still a repeat.
 */
static void a_full_round_is_closed_to_senders(void)
{
    mcp_asdf_t robot = robot_from(0xA5, &plain), other;
    mcp_asdf_sums_t sums = {0, 0, 0, 0, 0, 0};
    for (int i = 0; i < 127; ++i) {
        (void)mcp_asdf_sums_add(&sums, MCP_ASDF_ONE, MCP_ASDF_ALPHA_MAX);
    }
    CHECK_EQUAL(mcp_asdf_receive(&robot, 1, MCP_ASDF_ONE, ALPHA_ONE), MCP_ASDF_OK);
    CHECK_EQUAL(mcp_asdf_add_round(&robot, &sums, 127), MCP_ASDF_ERR_SUMS); /* 128 */
    sums = (mcp_asdf_sums_t){0, 0, 0, 0, 0, 0};
    for (int i = 0; i < 126; ++i) {
        (void)mcp_asdf_sums_add(&sums, MCP_ASDF_ONE, MCP_ASDF_ALPHA_MAX);
    }
    CHECK_EQUAL(mcp_asdf_add_round(&robot, &sums, 126), MCP_ASDF_OK);
    other = robot;
    CHECK_EQUAL(mcp_asdf_receive(&robot, 1, 0, ALPHA_ONE), MCP_ASDF_REPEATED);
    CHECK_EQUAL(mcp_asdf_receive(&robot, 2, 0, ALPHA_ONE), MCP_ASDF_ERR_SUMS);
    CHECK_EQUAL(mcp_asdf_receive(&robot, ID, 0, ALPHA_ONE), MCP_ASDF_ERR_SENDER);
    ++other.counters.repeated;
    other.counters.rejected = 2;
    CHECK(same(&robot, &other) && mcp_asdf_invariants_hold(&robot));
}

static void counters_stop_at_65535(void)
{
    static const mcp_asdf_config_t quick = {0, 1, 1, 64, MCP_ASDF_ALWAYS};
    mcp_asdf_t robot = robot_from(0xA5, &quick);
    for (uint32_t i = 0; i < 65540; ++i) {
        const uint64_t expected = i < 65535 ? i : 65535;
        const mcp_asdf_counters_t counters = mcp_asdf_counters(&robot);
        GIVEN(i, 0, 0);
        CHECK(counters.accepted == expected && counters.repeated == expected &&
              counters.rejected == expected);
        CHECK_EQUAL(counters.updates, expected);
        (void)mcp_asdf_receive(&robot, 1, 0, ALPHA_ONE);
        (void)mcp_asdf_receive(&robot, 1, 0, ALPHA_ONE);
        (void)mcp_asdf_receive(&robot, ID, 0, ALPHA_ONE);
        (void)mcp_asdf_step(&robot, MCP_ASDF_BLACK);
    }
}

int main(void)
{
    init_writes_every_member();
    init_refuses_bad_settings();
    table_fields_have_ranges();
    table_entries_fall();
    every_flipped_bit_of_a_table_is_refused();
    receive_refuses_what_is_no_message();
    receive_takes_any_other_alpha();
    observe_refuses_what_is_no_colour();
    an_error_settles_nothing();
    halving_takes_ties_to_even();
    no_filter_without_observations();
    restored_robots_go_on_alike();
    an_image_must_fit_the_config();
    add_round_is_receiving_one_by_one();
    add_round_refuses_impossible_sums();
    add_round_takes_a_message_of_the_least_confidence();
    add_round_takes_the_open_round_itself();
    invariants_count_every_sender();
    a_full_round_is_closed_to_senders();
    counters_stop_at_65535();
    return check_report();
}
