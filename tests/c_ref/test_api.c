/* Black box: what mcp_asdf.h promises and the independent implementation (tests/third) does not see or seldom
 * meets: the size of a robot, the usual configuration, the entry of the table that decides for a number of
 * messages, tables that are too long, and every sender of every robot. */
#include "check.h"
#include "mcp_asdf_image.h"

/* The budget of RAM, where a pointer has 32 bits. */
typedef char robot_is_small[sizeof(void *) != 4 || sizeof(mcp_asdf_t) <= 160 ? 1 : -1];

/* Its last word: FNV-1a over those before. */
static void seal(uint32_t *table, uint32_t words)
{
    table[words - 1] = UINT32_C(0x811C9DC5);
    for (uint32_t i = 0; i < words - 1; ++i) {
        table[words - 1] = (table[words - 1] ^ table[i]) * UINT32_C(0x01000193);
    }
}

/* Three messages at distances 1, 2 and 3 from the own estimate have the ratio 6: with q = 3 the entry of 3
 * decides, not the last one, which is for more. */
/* design: R27 */
static void each_number_of_messages_has_its_entry(void)
{
    for (uint32_t k_3 = 5; k_3 <= 7; k_3 += 2) {
        uint32_t table[] = {
            0x4D435403, 1, UINT32_C(8) << 26, k_3 << 26, k_3 == 7 ? UINT32_C(5) << 26 : UINT32_C(4) << 26, 0};
        seal(table, COUNT(table));
        mcp_asdf_config_t config = MCP_ASDF_CONFIG(table);
        CHECK(config.filter_period == 1000 && config.memory == MCP_ASDF_MEMORY_MAX);
        CHECK(config.table == table && config.filter == MCP_ASDF_ADAPTIVE);
        config.filter_period = 1;
        mcp_asdf_t robot;
        CHECK_EQUAL(mcp_asdf_init(&robot, &config, 9, 0xC0000000), MCP_ASDF_OK);
        CHECK_EQUAL(mcp_asdf_observe(&robot, MCP_ASDF_BLACK), MCP_ASDF_OK);
        for (uint8_t i = 1; i <= 3; ++i) {
            CHECK_EQUAL(mcp_asdf_receive(&robot, i, mcp_asdf_x_hat(&robot) - 1000U * i, 0x80000001),
                        MCP_ASDF_OK);
        }
        GIVEN(k_3, 0, 0);
        CHECK_EQUAL(mcp_asdf_settle(&robot), k_3 == 7 ? MCP_ASDF_OK : MCP_ASDF_UPDATED);
    }
}

/* Tables of any q, sound but for their length where that is not 2 to 127. */
/* design: R28 */
static void a_table_has_entries_for_2_to_127(void)
{
    for (uint32_t q = 0; q <= 255; ++q) {
        uint32_t table[255 + 3] = {0x4D435400 + q, 1};
        for (uint32_t m = 2; m <= q + 1; ++m) {
            table[m] = (UINT32_C(63) << 26) - m;
        }
        seal(table, q + 3);
        const mcp_asdf_config_t config = MCP_ASDF_CONFIG(table);
        mcp_asdf_t robot;
        GIVEN(q, 0, 0);
        CHECK_EQUAL(mcp_asdf_init(&robot, &config, 0, 0xC0000000),
                    2 <= q && q <= 127 ? MCP_ASDF_OK : MCP_ASDF_ERR_TABLE);
    }
}

/* A robot hears the 127 others once a round, itself and those that cannot be never. */
static void every_robot_hears_all_others(void)
{
    static const mcp_asdf_config_t config = {0, 1, MCP_ASDF_MEMORY_MAX, MCP_ASDF_OFF};
    for (uint32_t id = 0; id <= MCP_ASDF_MAX_ID; ++id) {
        mcp_asdf_t robot;
        CHECK_EQUAL(mcp_asdf_init(&robot, &config, (uint8_t)id, 0xC0000000), MCP_ASDF_OK);
        for (uint32_t call = 0; call < 4 * 256; ++call) { /* two rounds, everyone twice in each */
            const uint32_t sender = call & 255;
            const bool is_other = sender <= MCP_ASDF_MAX_ID && sender != id, again = (call >> 8 & 1) != 0;
            GIVEN(id, sender, call >> 8);
            CHECK_EQUAL(mcp_asdf_receive(&robot, (uint8_t)sender, MCP_ASDF_ONE, 0x100),
                        !is_other ? MCP_ASDF_ERR_SENDER
                        : again   ? MCP_ASDF_REPEATED
                                  : MCP_ASDF_OK);
            if (call % 512 == 511) {
                CHECK(mcp_asdf_invariants_hold(&robot));
                robot.heard.of[id / 8] |= (uint8_t)(1U << id % 8);
                CHECK(!mcp_asdf_invariants_hold(&robot));
                CHECK_EQUAL(mcp_asdf_settle(&robot), MCP_ASDF_OK);
                CHECK_EQUAL(mcp_asdf_beta(&robot), 127);
            }
        }
        const mcp_asdf_counters_t counters = mcp_asdf_counters(&robot);
        CHECK(counters.accepted == 254 && counters.repeated == 254 && counters.rejected == 4 * 129);
    }
}

int main(void)
{
    a_table_has_entries_for_2_to_127();
    every_robot_hears_all_others();
    each_number_of_messages_has_its_entry();
    return check_report();
}
