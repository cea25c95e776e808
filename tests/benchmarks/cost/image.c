/* What the cost benchmark runs under emulation: one robot, set to any moment of its life. */
#include "mcp_asdf.h"

extern const uint32_t mcp_asdf_t_table_omega05_q127[131];

mcp_asdf_t robot;
static mcp_asdf_config_t config = MCP_ASDF_CONFIG(mcp_asdf_t_table_omega05_q127);

mcp_asdf_status_t bench_init(uint32_t b_hat, uint32_t filter_period);
void bench_set(uint32_t t, uint32_t n);
uint32_t bench_robot_size(void);
uint32_t robot_main(uint32_t b_hat);

mcp_asdf_status_t bench_init(uint32_t b_hat, uint32_t filter_period)
{
    config.filter_period = filter_period;
    return mcp_asdf_init(&robot, &config, 5, b_hat);
}

void bench_set(uint32_t t, uint32_t n)
{
    robot.t = t;
    robot.n = n;
}

uint32_t bench_robot_size(void) { return (uint32_t)sizeof(mcp_asdf_t); }

/* The least a robot links: entry point of the image whose size is measured. */
uint32_t robot_main(uint32_t b_hat)
{
    if (mcp_asdf_init(&robot, &config, 5, b_hat) == MCP_ASDF_OK) {
        (void)mcp_asdf_observe(&robot, MCP_ASDF_BLACK);
        (void)mcp_asdf_receive(&robot, 6, mcp_asdf_x_hat(&robot), mcp_asdf_alpha(&robot));
        (void)mcp_asdf_settle(&robot);
    }
    return mcp_asdf_x(&robot);
}
