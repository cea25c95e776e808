/* Black box: what mcp_asdf.h and mcp_asdf_image.h promise and the independent implementation (tests/third)
 * does not see: bytes that must be written or left alone, tables of other sizes, and settings at the ends of
 * their ranges. */
#include "check.h"
#include "mcp_asdf.h"
#include "mcp_asdf_image.h"

#include <string.h>

#define ID 9
#define B_HAT UINT32_C(0xC0000000)
#define WORDS 33 /* of the q = 30 table */

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

/* Robots made in different memory have one state, and readings of a robot that knows nothing. */
static void init_writes_every_member(void)
{
    const mcp_asdf_t robot = robot_from(0xA5, &usual), other = robot_from(0x5A, &usual);
    const mcp_asdf_counters_t counters = mcp_asdf_counters(&robot);
    uint8_t a[MCP_ASDF_IMAGE_SIZE], b[MCP_ASDF_IMAGE_SIZE];
    mcp_asdf_save(&robot, a);
    mcp_asdf_save(&other, b);
    CHECK(memcmp(a, b, sizeof a) == 0);
    CHECK(mcp_asdf_id(&robot) == ID && mcp_asdf_b_hat(&robot) == B_HAT);
    CHECK(mcp_asdf_t_count(&robot) == 0 && mcp_asdf_n_count(&robot) == 0);
    CHECK(mcp_asdf_alpha(&robot) == 0 && mcp_asdf_beta(&robot) == 0);
    CHECK(mcp_asdf_x_hat(&robot) == MCP_ASDF_HALF && mcp_asdf_x_bar(&robot) == MCP_ASDF_HALF);
    CHECK_EQUAL(mcp_asdf_x(&robot), MCP_ASDF_HALF);
    CHECK((counters.accepted | counters.repeated | counters.rejected | counters.tests | counters.updates) ==
          0);
}

/* What init gives; a failure changes no byte. */
static void check_init(const mcp_asdf_config_t *config, uint8_t id, uint32_t b_hat,
                       mcp_asdf_status_t expected)
{
    mcp_asdf_t robot, before;
    memset(&robot, 0xA5, sizeof robot);
    memset(&before, 0xA5, sizeof before);
    CHECK_EQUAL(-mcp_asdf_init(&robot, config, id, b_hat), -expected);
    CHECK((memcmp(&robot, &before, sizeof robot) == 0) == (expected != MCP_ASDF_OK));
}

static void init_refuses_bad_settings(void)
{
    static const mcp_asdf_config_t bad = {0, 2, 66, MCP_ASDF_OFF},
                                   longest = {0, UINT32_MAX, 64, MCP_ASDF_OFF};
    check_init(&longest, 127, MCP_ASDF_B_HAT_MAX, MCP_ASDF_OK);
    check_init(&bad, 128, 0, MCP_ASDF_ERR_CONFIG); /* the first complaint counts */
    check_init(&plain, 128, 0, MCP_ASDF_ERR_ID);
    check_init(&plain, ID, MCP_ASDF_B_HAT_MIN - 1, MCP_ASDF_ERR_B_HAT);
    check_init(&plain, ID, MCP_ASDF_B_HAT_MAX + 1, MCP_ASDF_ERR_B_HAT);
}

/* ---- The table ---- */

static uint32_t table[127 + 3]; /* a table of WORDS words, and room for as many as a damaged q may claim */
static const mcp_asdf_config_t with_table = MCP_ASDF_CONFIG(table);

static void seal(uint32_t words)
{
    uint32_t hash = UINT32_C(0x811C9DC5);
    for (uint32_t i = 0; i < words - 1; ++i) {
        hash = (hash ^ table[i]) * UINT32_C(0x01000193);
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

/* ---- Refusals change no byte but those of their counter ---- */

static void what_is_refused_leaves_the_robot_alone(void)
{
    mcp_asdf_t robot = robot_from(0xA5, &plain), before;
    (void)mcp_asdf_receive(&robot, 1, 0, 0x80000001);
    memcpy(&before, &robot, sizeof robot);
    for (int wrong = 2; wrong < 600; wrong += 127) {
        GIVEN(wrong, 0, 0);
        CHECK_EQUAL(-mcp_asdf_observe(&robot, (mcp_asdf_observation_t)wrong), -MCP_ASDF_ERR_OBSERVATION);
        CHECK_EQUAL(-mcp_asdf_step(&robot, (mcp_asdf_observation_t)wrong), -MCP_ASDF_ERR_OBSERVATION);
    }
    CHECK(memcmp(&robot, &before, sizeof robot) == 0); /* nothing is settled, either */
    CHECK_EQUAL(-mcp_asdf_receive(&robot, ID, UINT32_MAX, 0), -MCP_ASDF_ERR_SENDER);
    CHECK_EQUAL(-mcp_asdf_receive(&robot, 1, MCP_ASDF_ONE + 1, 0), -MCP_ASDF_ERR_X_HAT);
    CHECK_EQUAL(mcp_asdf_counters(&robot).rejected, 2);
    robot.counters.rejected = 0;
    CHECK(memcmp(&robot, &before, sizeof robot) == 0);
}

int main(void)
{
    init_writes_every_member();
    init_refuses_bad_settings();
    table_of_127();
    every_flipped_bit_of_a_table_is_refused();
    each_number_of_messages_has_its_entry();
    only_an_adaptive_filter_reads_the_table();
    what_is_refused_leaves_the_robot_alone();
    return check_report();
}
