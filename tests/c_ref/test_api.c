/* Black box: what mcp_asdf.h promises and the independent implementation (tests/third) does not see: the size
 * of a robot, the usual configuration, and the entry of the table that decides for a number of messages. */
#include "check.h"
#include "mcp_asdf.h"

/* The budget of RAM, where a pointer has 32 bits. */
typedef char robot_is_small[sizeof(void *) != 4 || sizeof(mcp_asdf_t) <= 160 ? 1 : -1];

/* Three messages at distances 1, 2 and 3 from the own estimate have the ratio 6: with q = 3 the entry of 3
 * decides, not the last one, which is for more. */
static void each_number_of_messages_has_its_entry(void)
{
    for (uint32_t k_3 = 5; k_3 <= 7; k_3 += 2) {
        uint32_t table[] = {
            0x4D435403, 1, UINT32_C(8) << 26, k_3 << 26, k_3 == 7 ? UINT32_C(5) << 26 : UINT32_C(4) << 26,
            0x811C9DC5};
        for (uint32_t i = 0; i < 5; ++i) { /* FNV-1a */
            table[5] = (table[5] ^ table[i]) * UINT32_C(0x01000193);
        }
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

int main(void)
{
    each_number_of_messages_has_its_entry();
    return check_report();
}
