/* Black box: what mcp_asdf.h and mcp_asdf_image.h promise, through their functions alone. */
#include "check.h"
#include "mcp_asdf.h"
#include "mcp_asdf_image.h"

#include <string.h>

#define ID 9
#define B_HAT UINT32_C(0xC0000000)
#define ALPHA_ONE UINT32_C(0x80000001)
#define WORDS 33 /* of the q = 30 table */
#define FNV_START UINT32_C(0x811C9DC5)
#define FNV_FACTOR UINT32_C(0x01000193)

/* The budget of RAM, where a pointer has 32 bits. */
typedef char robot_is_small[sizeof(void *) != 4 || sizeof(mcp_asdf_t) <= 152 ? 1 : -1];

extern const uint32_t mcp_asdf_t_table_omega05_q30[WORDS];
static const mcp_asdf_config_t usual = MCP_ASDF_CONFIG(mcp_asdf_t_table_omega05_q30);
static const mcp_asdf_config_t plain = {0, 2, 64, MCP_ASDF_OFF};
static const mcp_asdf_config_t always = {0, 1, 64, MCP_ASDF_ALWAYS};

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

static mcp_asdf_observation_t any_colour(void)
{
    return check_random() >> 63 != 0 ? MCP_ASDF_BLACK : MCP_ASDF_WHITE;
}

static void init_writes_every_member(void)
{
    mcp_asdf_t robot = robot_from(0xA5, &usual), other = robot_from(0x5A, &usual);
    const mcp_asdf_counters_t counters = mcp_asdf_counters(&robot);
    CHECK(same(&robot, &other));
    CHECK_EQUAL(mcp_asdf_id(&robot), ID);
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
        const mcp_asdf_observation_t z = any_colour();
        const uint32_t x_hat = (uint32_t)check_random() >> 9, alpha = (uint32_t)check_random();
        CHECK_EQUAL(mcp_asdf_receive(&robot, 3, x_hat, alpha), mcp_asdf_receive(&other, 3, x_hat, alpha));
        CHECK_EQUAL(mcp_asdf_step(&robot, z), mcp_asdf_step(&other, z));
    }
    CHECK(same(&robot, &other) && mcp_asdf_invariants_hold(&robot) && mcp_asdf_invariants_hold(&other));
}

/* What init gives, and restore where the complaint is of the config: a failure changes no byte. */
static void check_init(const mcp_asdf_config_t *config, uint8_t id, uint32_t b_hat,
                       mcp_asdf_status_t expected)
{
    uint8_t image[MCP_ASDF_IMAGE_SIZE];
    mcp_asdf_t robot, before, good = robot_from(0xA5, &plain);
    memset(&robot, 0xA5, sizeof robot);
    memset(&before, 0xA5, sizeof before);
    CHECK_EQUAL(-mcp_asdf_init(&robot, config, id, b_hat), -expected);
    CHECK((memcmp(&robot, &before, sizeof robot) == 0) == (expected != MCP_ASDF_OK));
    if (expected == MCP_ASDF_ERR_CONFIG || expected == MCP_ASDF_ERR_TABLE) {
        mcp_asdf_save(&good, image);
        memcpy(&robot, &before, sizeof robot);
        CHECK_EQUAL(-mcp_asdf_restore(&robot, config, image), -expected);
        CHECK(memcmp(&robot, &before, sizeof robot) == 0);
    }
}

static void init_refuses_bad_settings(void)
{
    static const mcp_asdf_config_t bad[] = {
        {0, 0, 64, MCP_ASDF_OFF}, {0, 2, 60, MCP_ASDF_OFF},         {0, 2, 65, MCP_ASDF_OFF},
        {0, 2, 66, MCP_ASDF_OFF}, {0, 2, 67, MCP_ASDF_OFF},         {0, 2, 0, MCP_ASDF_OFF},
        {0, 2, 4, MCP_ASDF_OFF},  {0, 2, UINT32_MAX, MCP_ASDF_OFF}, {0, 2, 64, 3},
        {0, 2, 64, 255},          {0, 2, 0xFFFFFFFC, MCP_ASDF_OFF}, {0, 2, 0x80000004, MCP_ASDF_OFF},
    };
    static const mcp_asdf_config_t good[] = {
        {0, 1, 64, MCP_ASDF_OFF},
        {0, UINT32_MAX, MCP_ASDF_MEMORY_MAX, MCP_ASDF_ALWAYS},
        {0, 7, 68, MCP_ASDF_ALWAYS},
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
    check_init(&plain, ID, UINT32_MAX, MCP_ASDF_ERR_B_HAT);
    check_init(&plain, 128, 0, MCP_ASDF_ERR_ID); /* the first complaint counts */
    check_init(&bad[0], 128, 0, MCP_ASDF_ERR_CONFIG);
}

/* ---- The table ---- */

static uint32_t table[127 + 3]; /* a table of WORDS words, and room for as many as a damaged q may claim */
static const mcp_asdf_config_t with_table = MCP_ASDF_CONFIG(table);

static void seal(uint32_t words)
{
    uint32_t hash = FNV_START;
    for (uint32_t i = 0; i < words - 1; ++i) {
        hash = (hash ^ table[i]) * FNV_FACTOR;
    }
    table[words - 1] = hash;
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
    CHECK_EQUAL(good[0], 0x4D43541E);
    check_word(0, good[0], WORDS, MCP_ASDF_OK);
    CHECK_EQUAL(table[WORDS - 1], good[WORDS - 1]);
    for (uint32_t bit = 8; bit < 32; ++bit) {
        check_word(0, good[0] ^ UINT32_C(1) << bit, WORDS, MCP_ASDF_ERR_TABLE);
    }
    check_word(0, 0x4D435402, 5, MCP_ASDF_OK); /* q */
    check_word(0, 0x4D435401, 4, MCP_ASDF_ERR_TABLE);
    check_word(0, 0x4D435400, 3, MCP_ASDF_ERR_TABLE);
    check_word(0, 0x4D43541D, WORDS, MCP_ASDF_ERR_TABLE);
    check_word(0, 0x4D435480, WORDS, MCP_ASDF_ERR_TABLE);
    check_word(0, 0x4D4354FF, WORDS, MCP_ASDF_ERR_TABLE);
    check_word(1, 0, WORDS, MCP_ASDF_ERR_TABLE); /* omega */
    check_word(1, 1, WORDS, MCP_ASDF_OK);
    check_word(1, 3865470566U, WORDS, MCP_ASDF_OK); /* 0.9 */
    check_word(1, 3865470567U, WORDS, MCP_ASDF_ERR_TABLE);
    check_word(1, UINT32_MAX, WORDS, MCP_ASDF_ERR_TABLE);
}

static void table_entries_fall(void)
{
    const uint32_t *const good = mcp_asdf_t_table_omega05_q30;
    check_word(2, UINT32_MAX, WORDS, MCP_ASDF_OK); /* 64.0 - 2^-26 */
    check_word(2, good[3] + 1, WORDS, MCP_ASDF_OK);
    check_word(2, good[3], WORDS, MCP_ASDF_ERR_TABLE);
    check_word(10, good[9], WORDS, MCP_ASDF_ERR_TABLE);
    check_word(10, good[9] - 1, WORDS, MCP_ASDF_OK);
    check_word(10, good[11], WORDS, MCP_ASDF_ERR_TABLE);
    check_word(10, good[11] + 1, WORDS, MCP_ASDF_OK);
    check_word(WORDS - 2, 1U << 26, WORDS, MCP_ASDF_ERR_TABLE); /* 1.0 */
    check_word(WORDS - 2, (1U << 26) + 1, WORDS, MCP_ASDF_OK);
    check_word(WORDS - 2, good[WORDS - 3], WORDS, MCP_ASDF_ERR_TABLE);
    check_word(WORDS - 2, good[WORDS - 3] - 1, WORDS, MCP_ASDF_OK);
}

/* The largest table, and no word of it left unread. */
static void table_of_127(void)
{
    for (uint32_t damaged = 0; damaged <= COUNT(table); ++damaged) {
        table[0] = 0x4D43547F;
        table[1] = 1;
        for (uint32_t i = 2; i < COUNT(table) - 1; ++i) {
            table[i] = (UINT32_C(2) << 26) - i;
        }
        seal(COUNT(table));
        if (damaged < COUNT(table)) {
            table[damaged] ^= 1;
        }
        GIVEN(damaged, 0, 0);
        check_init(&with_table, ID, B_HAT, damaged < COUNT(table) ? MCP_ASDF_ERR_TABLE : MCP_ASDF_OK);
    }
}

/* Three messages at distances 1, 2 and 3 from the own estimate have the ratio 6: with q = 3 the entry of 3
 * decides, not the last one, which is for more. */
static void each_number_of_messages_has_its_entry(void)
{
    for (uint32_t k_3 = 5; k_3 <= 7; k_3 += 2) {
        const uint32_t words[] = {
            0x4D435403, 1, UINT32_C(8) << 26, k_3 << 26, k_3 == 7 ? UINT32_C(5) << 26 : UINT32_C(4) << 26, 0};
        memcpy(table, words, sizeof words);
        seal(COUNT(words));
        mcp_asdf_config_t config = with_table;
        config.filter_period = 1;
        mcp_asdf_t robot;
        CHECK_EQUAL(mcp_asdf_init(&robot, &config, ID, B_HAT), MCP_ASDF_OK);
        CHECK_EQUAL(mcp_asdf_observe(&robot, MCP_ASDF_BLACK), MCP_ASDF_OK);
        for (uint8_t i = 1; i <= 3; ++i) {
            CHECK_EQUAL(mcp_asdf_receive(&robot, i, mcp_asdf_x_hat(&robot) - 1000U * i, 0x80000001),
                        MCP_ASDF_OK);
        }
        GIVEN(k_3, 0, 0);
        CHECK_EQUAL(mcp_asdf_settle(&robot), k_3 == 7 ? MCP_ASDF_OK : MCP_ASDF_UPDATED);
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

/* Without a test there is no need for a table: whatever the pointer is, it is not followed. */
static void only_an_adaptive_filter_reads_the_table(void)
{
    static const uint32_t no_table[1] = {0};
    const mcp_asdf_config_t adaptive = {no_table, 1, 64, MCP_ASDF_ADAPTIVE};
    const mcp_asdf_config_t others[] = {{no_table, 1, 64, MCP_ASDF_ALWAYS}, {no_table, 1, 64, MCP_ASDF_OFF}};
    check_init(&adaptive, ID, B_HAT, MCP_ASDF_ERR_TABLE);
    check_init(&others[0], ID, B_HAT, MCP_ASDF_OK);
    check_init(&others[1], ID, B_HAT, MCP_ASDF_OK);
}

/* ---- Messages ---- */

/* Nothing but the counter `rejected` changes, in no byte. */
static void check_rejected(uint8_t sender, uint32_t x_hat, uint32_t alpha, mcp_asdf_status_t expected)
{
    mcp_asdf_t robot = robot_from(0xA5, &plain), before;
    (void)mcp_asdf_observe(&robot, MCP_ASDF_BLACK);
    (void)mcp_asdf_receive(&robot, 2, 3, ALPHA_ONE);
    memcpy(&before, &robot, sizeof robot);
    GIVEN(sender, x_hat, alpha);
    CHECK_EQUAL(-mcp_asdf_receive(&robot, sender, x_hat, alpha), -expected);
    CHECK_EQUAL(mcp_asdf_counters(&robot).rejected, 1);
    robot.counters.rejected = 0;
    CHECK(memcmp(&robot, &before, sizeof robot) == 0);
}

static void receive_refuses_what_is_no_message(void)
{
    for (uint32_t sender = 128; sender < 256; ++sender) {
        check_rejected((uint8_t)sender, MCP_ASDF_HALF, ALPHA_ONE, MCP_ASDF_ERR_SENDER);
    }
    check_rejected(ID, MCP_ASDF_HALF, ALPHA_ONE, MCP_ASDF_ERR_SENDER);
    check_rejected(ID, MCP_ASDF_HALF, 0, MCP_ASDF_ERR_SENDER);
    check_rejected(1, MCP_ASDF_ONE + 1, ALPHA_ONE, MCP_ASDF_ERR_X_HAT);
    check_rejected(1, MCP_ASDF_ONE + 1, 0, MCP_ASDF_ERR_X_HAT);
    check_rejected(1, UINT32_MAX, ALPHA_ONE, MCP_ASDF_ERR_X_HAT);
    check_rejected(2, UINT32_MAX, ALPHA_ONE, MCP_ASDF_ERR_X_HAT);    /* heard before, but no repeat */
    check_rejected(ID, UINT32_MAX, UINT32_MAX, MCP_ASDF_ERR_SENDER); /* the first complaint counts */
    check_rejected(128 + ID, UINT32_MAX, ALPHA_ONE, MCP_ASDF_ERR_SENDER);
}

/* Every other sender is heard once a round: the first message counts. */
static void one_message_of_a_sender_in_a_round(void)
{
    mcp_asdf_t robot = robot_from(0xA5, &plain);
    for (uint32_t round = 1; round <= 3; ++round) {
        for (uint8_t sender = 0; sender < 128; ++sender) {
            GIVEN(sender, round, 0);
            if (sender != ID) {
                CHECK_EQUAL(mcp_asdf_receive(&robot, sender, MCP_ASDF_ONE, ALPHA_ONE), MCP_ASDF_OK);
                CHECK_EQUAL(mcp_asdf_receive(&robot, sender, 0, UINT32_MAX), MCP_ASDF_REPEATED);
                CHECK_EQUAL(mcp_asdf_receive(&robot, sender, 0, 0), MCP_ASDF_REPEATED);
            }
        }
        CHECK(mcp_asdf_invariants_hold(&robot));
        CHECK_EQUAL(mcp_asdf_settle(&robot), MCP_ASDF_OK);
        CHECK_EQUAL(mcp_asdf_x_bar(&robot), MCP_ASDF_ONE);
        CHECK_EQUAL(mcp_asdf_beta(&robot), UINT64_C(127) << 24);
        CHECK_EQUAL(mcp_asdf_counters(&robot).accepted, 127 * round);
        CHECK_EQUAL(mcp_asdf_counters(&robot).repeated, 254 * round);
        CHECK_EQUAL(mcp_asdf_counters(&robot).rejected, 0);
    }
    CHECK_EQUAL(mcp_asdf_settle(&robot), MCP_ASDF_OK); /* a round without messages */
    CHECK_EQUAL(mcp_asdf_beta(&robot), 0);
    CHECK_EQUAL(mcp_asdf_x_bar(&robot), MCP_ASDF_HALF);
}

/* "Every word is valid", and one without a mantissa is accepted and says nothing. */
static void receive_takes_any_alpha(void)
{
    static const uint32_t alphas[] = {0,          0x1F,       0xFF,       0x100,      0x1E0,      0x7FFFFF00,
                                      0x80000000, 0x80000018, 0x800000F8, 0xFFFFFF1F, 0xFFFFFFFF, 0x0000011F};
    static const uint64_t units[] = {0,
                                     0,
                                     0,
                                     1,
                                     1,
                                     0x7FFFFF,
                                     0x800000,
                                     UINT64_C(0x800000) << 24,
                                     UINT64_C(0x800000) << 24,
                                     UINT64_C(0xFFFFFF) << 31,
                                     UINT64_C(0xFFFFFF) << 31,
                                     UINT64_C(1) << 31};
    for (size_t i = 0; i < COUNT(alphas); ++i) {
        mcp_asdf_t robot = robot_from(0xA5, &plain);
        GIVEN(alphas[i], 0, 0);
        CHECK_EQUAL(mcp_asdf_receive(&robot, 0, MCP_ASDF_ONE, alphas[i]), MCP_ASDF_OK);
        CHECK_EQUAL(mcp_asdf_receive(&robot, 0, 0, ALPHA_ONE), MCP_ASDF_REPEATED);
        CHECK(mcp_asdf_beta(&robot) == 0 && mcp_asdf_invariants_hold(&robot)); /* the round is still open */
        CHECK_EQUAL(mcp_asdf_settle(&robot), MCP_ASDF_OK);
        CHECK_EQUAL(mcp_asdf_beta(&robot), units[i]);
        CHECK_EQUAL(mcp_asdf_x_bar(&robot), units[i] == 0 ? MCP_ASDF_HALF : MCP_ASDF_ONE);
        CHECK(mcp_asdf_counters(&robot).accepted == 1 && mcp_asdf_counters(&robot).repeated == 1);
    }
}

/* ---- Observations ---- */

static void observe_refuses_what_is_no_colour(void)
{
    static const int wrong[] = {2, 3, 4, 255, 256, 257, 0x7FFF};
    for (size_t i = 0; i < COUNT(wrong); ++i) {
        mcp_asdf_t robot = robot_from(0xA5, &plain), before;
        (void)mcp_asdf_receive(&robot, 1, 0, ALPHA_ONE);
        memcpy(&before, &robot, sizeof robot);
        GIVEN(wrong[i], 0, 0);
        CHECK_EQUAL(-mcp_asdf_observe(&robot, (mcp_asdf_observation_t)wrong[i]), -MCP_ASDF_ERR_OBSERVATION);
        CHECK_EQUAL(-mcp_asdf_step(&robot, (mcp_asdf_observation_t)wrong[i]), -MCP_ASDF_ERR_OBSERVATION);
        CHECK(memcmp(&robot, &before, sizeof robot) == 0); /* nothing is settled, either */
    }
}

static void step_is_observe_and_settle(void)
{
    mcp_asdf_t robot = robot_from(0xA5, &always), other = robot_from(0xA5, &always);
    unsigned updates = 0;
    for (int tick = 0; tick < 300; ++tick) {
        const mcp_asdf_observation_t z = any_colour();
        const uint32_t x_hat = check_random_word() & 0x7FFFFF;
        (void)mcp_asdf_receive(&robot, 1, x_hat, ALPHA_ONE);
        (void)mcp_asdf_receive(&other, 1, x_hat, ALPHA_ONE);
        const mcp_asdf_status_t status = mcp_asdf_step(&robot, z);
        CHECK_EQUAL(mcp_asdf_observe(&other, z), MCP_ASDF_OK);
        CHECK_EQUAL(mcp_asdf_settle(&other), status);
        CHECK(same(&robot, &other) && mcp_asdf_invariants_hold(&robot));
        updates += status == MCP_ASDF_UPDATED;
    }
    CHECK(updates > 100);
    CHECK_EQUAL(mcp_asdf_counters(&robot).updates, updates);
    CHECK_EQUAL(mcp_asdf_counters(&robot).tests, 0);
}

/* memory is 64: 32 observations stay, half of the black ones to nearest, ties to even */
static void halving_takes_ties_to_even(void)
{
    for (uint32_t black = 0; black <= 64; ++black) {
        mcp_asdf_t robot = robot_from(0xA5, &plain);
        for (uint32_t tick = 0; tick < 64; ++tick) {
            CHECK_EQUAL(mcp_asdf_t_count(&robot), tick);
            (void)mcp_asdf_observe(&robot, tick < black ? MCP_ASDF_BLACK : MCP_ASDF_WHITE);
        }
        GIVEN(black, 0, 0);
        CHECK_EQUAL(mcp_asdf_t_count(&robot), 32);
        CHECK_EQUAL(mcp_asdf_n_count(&robot), black / 2 + (black % 4 == 3));
        CHECK(mcp_asdf_invariants_hold(&robot));
    }
}

/* x is of the own estimate now and the last closed round: both may be the last to have changed. */
static void x_follows_the_own_estimate(void)
{
    mcp_asdf_t robot = robot_from(0xA5, &plain);
    CHECK_EQUAL(mcp_asdf_observe(&robot, MCP_ASDF_BLACK), MCP_ASDF_OK);
    CHECK_EQUAL(mcp_asdf_x(&robot), MCP_ASDF_ONE);
    CHECK_EQUAL(mcp_asdf_receive(&robot, 1, 0, mcp_asdf_alpha(&robot)), MCP_ASDF_OK);
    CHECK_EQUAL(mcp_asdf_x(&robot), MCP_ASDF_ONE); /* the round is open */
    CHECK_EQUAL(mcp_asdf_settle(&robot), MCP_ASDF_OK);
    CHECK_EQUAL(mcp_asdf_x(&robot), MCP_ASDF_HALF);
    CHECK_EQUAL(mcp_asdf_observe(&robot, MCP_ASDF_BLACK), MCP_ASDF_OK);
    CHECK_EQUAL(mcp_asdf_x(&robot), MCP_ASDF_ONE / 3 * 2 + 1); /* 2/3, rounded down */
    CHECK_EQUAL(mcp_asdf_settle(&robot), MCP_ASDF_OK);
    CHECK_EQUAL(mcp_asdf_x(&robot), MCP_ASDF_ONE);
}

/* ---- The filter ---- */

/* "Every filter_period rounds": the first time after that many, messages in between or not. */
static void the_filter_runs_every_filter_period_rounds(void)
{
    static const uint32_t periods[] = {1, 2, 3, 7, 1000};
    for (size_t i = 0; i < COUNT(periods); ++i) {
        const mcp_asdf_config_t config = {mcp_asdf_t_table_omega05_q30, periods[i], 64, MCP_ASDF_ADAPTIVE};
        mcp_asdf_t robot = robot_from(0xA5, &config);
        (void)mcp_asdf_observe(&robot, MCP_ASDF_WHITE);
        for (uint32_t round = 1; round <= 3 * periods[i] + 1; ++round) {
            (void)mcp_asdf_receive(&robot, 1, mcp_asdf_x_hat(&robot), ALPHA_ONE);
            (void)mcp_asdf_receive(&robot, 2, mcp_asdf_x_hat(&robot), ALPHA_ONE);
            GIVEN(periods[i], round, 0);
            CHECK_EQUAL(mcp_asdf_settle(&robot), MCP_ASDF_OK);
            CHECK_EQUAL(mcp_asdf_counters(&robot).tests, round / periods[i]);
        }
    }
}

/* The longest period: 2^32 - 1 rounds, not a moment that comes at once. */
static void the_longest_filter_period(void)
{
    static const mcp_asdf_config_t longest = {0, UINT32_MAX, 64, MCP_ASDF_ALWAYS};
    mcp_asdf_t robot = robot_from(0xA5, &longest);
    for (int round = 0; round < 1000; ++round) {
        (void)mcp_asdf_receive(&robot, 1, 0, ALPHA_ONE);
        CHECK_EQUAL(mcp_asdf_step(&robot, MCP_ASDF_BLACK), MCP_ASDF_OK);
    }
    robot.filter_left = 1;
    (void)mcp_asdf_receive(&robot, 1, 0, ALPHA_ONE);
    CHECK_EQUAL(mcp_asdf_step(&robot, MCP_ASDF_BLACK), MCP_ASDF_UPDATED);
}

/* An update shows in x_hat and alpha at the next observation, and not before. */
static void an_update_shows_at_the_next_observation(void)
{
    mcp_asdf_t robot = robot_from(0xA5, &always), other;
    (void)mcp_asdf_receive(&robot, 1, 0, ALPHA_ONE);
    CHECK_EQUAL(mcp_asdf_settle(&robot), MCP_ASDF_OK); /* nothing was observed */
    CHECK_EQUAL(mcp_asdf_b_hat(&robot), B_HAT);
    (void)mcp_asdf_observe(&robot, MCP_ASDF_BLACK);
    const uint32_t alpha = mcp_asdf_alpha(&robot);
    (void)mcp_asdf_receive(&robot, 1, 0, ALPHA_ONE);
    CHECK_EQUAL(mcp_asdf_settle(&robot), MCP_ASDF_UPDATED);
    CHECK_EQUAL(mcp_asdf_b_hat(&robot), MCP_ASDF_B_HAT_MIN); /* all black where none is */
    CHECK(mcp_asdf_x_hat(&robot) == MCP_ASDF_ONE && mcp_asdf_alpha(&robot) == alpha);
    CHECK_EQUAL(mcp_asdf_settle(&robot), MCP_ASDF_OK); /* no message */
    CHECK(mcp_asdf_x_hat(&robot) == MCP_ASDF_ONE && mcp_asdf_alpha(&robot) == alpha);
    CHECK(mcp_asdf_invariants_hold(&robot));
    (void)mcp_asdf_observe(&robot, MCP_ASDF_BLACK);
    CHECK_EQUAL(mcp_asdf_x_hat(&robot), 0);
    CHECK_EQUAL(mcp_asdf_init(&other, &always, ID, MCP_ASDF_B_HAT_MIN), MCP_ASDF_OK);
    (void)mcp_asdf_observe(&other, MCP_ASDF_BLACK);
    (void)mcp_asdf_observe(&other, MCP_ASDF_BLACK);
    CHECK_EQUAL(mcp_asdf_alpha(&robot), mcp_asdf_alpha(&other));
    CHECK(mcp_asdf_invariants_hold(&robot));
}

/* "each modulo 2^16: take differences" */
static void counters_wrap(void)
{
    static const mcp_asdf_config_t tested = {mcp_asdf_t_table_omega05_q30, 1, 64, MCP_ASDF_ADAPTIVE};
    mcp_asdf_t robot = robot_from(0xA5, &tested);
    robot.counters = (mcp_asdf_counters_t){65530, 65531, 65532, 65533, 65534};
    for (uint32_t i = 0; i < 20; ++i) {
        const mcp_asdf_counters_t counters = mcp_asdf_counters(&robot);
        GIVEN(i, 0, 0);
        CHECK_EQUAL(counters.accepted, (65530 + 3 * i) % 65536);
        CHECK_EQUAL(counters.repeated, (65531 + i) % 65536);
        CHECK_EQUAL(counters.rejected, (65532 + i) % 65536);
        CHECK_EQUAL(counters.tests, (65533 + i) % 65536);
        CHECK_EQUAL(counters.updates, (65534 + i) % 65536);
        for (uint8_t sender = 1; sender < 3; ++sender) {
            (void)mcp_asdf_receive(&robot, sender, i % 2 == 0 ? 0 : MCP_ASDF_ONE, ALPHA_ONE);
        }
        (void)mcp_asdf_receive(&robot, 3, MCP_ASDF_HALF, 0);
        (void)mcp_asdf_receive(&robot, 3, 0, ALPHA_ONE);
        (void)mcp_asdf_receive(&robot, ID, 0, ALPHA_ONE);
        (void)mcp_asdf_observe(&robot, MCP_ASDF_BLACK);
        robot.x_hat = MCP_ASDF_HALF; /* far from what all others say */
        CHECK_EQUAL(mcp_asdf_settle(&robot), MCP_ASDF_UPDATED);
    }
}

/* ---- Saving ---- */

static void restored_robots_go_on_alike(void)
{
    for (int ticks = 0; ticks < 130; ++ticks) {
        mcp_asdf_t robot = robot_from(0xA5, &always), copy;
        uint8_t image[MCP_ASDF_IMAGE_SIZE];
        for (int tick = 0; tick < ticks; ++tick) {
            (void)mcp_asdf_receive(&robot, (uint8_t)(check_random() % 128), (uint32_t)check_random() >> 9,
                                   (uint32_t)check_random());
            (void)mcp_asdf_step(&robot, any_colour());
        }
        (void)mcp_asdf_receive(&robot, 1, 12345, 54321);
        mcp_asdf_save(&robot, image);
        memset(&copy, 0xA5, sizeof copy);
        CHECK_EQUAL(mcp_asdf_restore(&copy, &always, image), MCP_ASDF_OK);
        CHECK(same(&robot, &copy) && mcp_asdf_invariants_hold(&copy));
        CHECK_EQUAL(mcp_asdf_receive(&copy, 1, 12345, 54321), mcp_asdf_receive(&robot, 1, 12345, 54321));
        CHECK_EQUAL(mcp_asdf_step(&copy, MCP_ASDF_BLACK), mcp_asdf_step(&robot, MCP_ASDF_BLACK));
        CHECK(same(&robot, &copy) && mcp_asdf_x(&robot) == mcp_asdf_x(&copy));
    }
}

static void an_image_must_fit_the_config(void)
{
    static const mcp_asdf_config_t shorter = {0, 1, 64, MCP_ASDF_OFF}, longer = {0, 8, 64, MCP_ASDF_ALWAYS};
    static const mcp_asdf_config_t large = {0, 2, 128, MCP_ASDF_OFF};
    mcp_asdf_t robot = robot_from(0xA5, &plain), copy;
    uint8_t image[MCP_ASDF_IMAGE_SIZE];
    mcp_asdf_save(&robot, image);
    CHECK_EQUAL(-mcp_asdf_restore(&copy, &shorter, image), -MCP_ASDF_ERR_IMAGE); /* 2 rounds left of 1 */
    CHECK_EQUAL(mcp_asdf_restore(&copy, &longer, image), MCP_ASDF_OK); /* 2 of 8: a moment that can be */
    CHECK_EQUAL(mcp_asdf_init(&robot, &large, ID, B_HAT), MCP_ASDF_OK);
    for (int tick = 0; tick < 64; ++tick) {
        (void)mcp_asdf_observe(&robot, MCP_ASDF_BLACK);
    }
    mcp_asdf_save(&robot, image);
    CHECK_EQUAL(mcp_asdf_restore(&copy, &large, image), MCP_ASDF_OK);
    CHECK_EQUAL(-mcp_asdf_restore(&copy, &plain, image), -MCP_ASDF_ERR_IMAGE); /* t = 64 of a memory of 64 */
    memset(image, 0, sizeof image);
    CHECK_EQUAL(-mcp_asdf_restore(&copy, &plain, image), -MCP_ASDF_ERR_IMAGE);
    memset(image, 0xFF, sizeof image);
    CHECK_EQUAL(-mcp_asdf_restore(&copy, &plain, image), -MCP_ASDF_ERR_IMAGE);
}

int main(void)
{
    init_writes_every_member();
    init_refuses_bad_settings();
    table_fields_have_ranges();
    table_entries_fall();
    table_of_127();
    every_flipped_bit_of_a_table_is_refused();
    each_number_of_messages_has_its_entry();
    only_an_adaptive_filter_reads_the_table();
    receive_refuses_what_is_no_message();
    one_message_of_a_sender_in_a_round();
    receive_takes_any_alpha();
    observe_refuses_what_is_no_colour();
    step_is_observe_and_settle();
    halving_takes_ties_to_even();
    x_follows_the_own_estimate();
    the_filter_runs_every_filter_period_rounds();
    the_longest_filter_period();
    an_update_shows_at_the_next_observation();
    counters_wrap();
    restored_robots_go_on_alike();
    an_image_must_fit_the_config();
    return check_report();
}
