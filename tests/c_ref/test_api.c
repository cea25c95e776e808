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

/* ---- The filter ---- */

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

/* ---- Saving ---- */

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
    table_of_127();
    every_flipped_bit_of_a_table_is_refused();
    each_number_of_messages_has_its_entry();
    only_an_adaptive_filter_reads_the_table();
    receive_refuses_what_is_no_message();
    observe_refuses_what_is_no_colour();
    the_longest_filter_period();
    an_image_must_fit_the_config();
    return check_report();
}
