/* A program with the firmware whose cost is measured. main() calls the few functions that every robot needs;
 * where WHOLE is defined it calls all others, too. */
#include "mcp_asdf_image.h"

/* A robot's settings and its past, all in words of 32 bits. The program that measures writes them here. */
struct {
    uint32_t b_hat, filter, filter_period, memory, t, n;
    uint32_t centre, spread, votes, turn, batch_t, batch_n, dispersion, filled_slots;
    uint32_t estimates[32];
} bench_state;

/* Make a robot with id 5 of bench_state. */
void bench_start(void);
/* Tests (times 2^16) and re-estimates of b_hat since the start. */
uint32_t bench_filtered(void);

extern const uint32_t mcp_asdf_t_table_omega05_q30[33];

mcp_asdf_t robot;
#if MCP_ASDF_WITH_ASDF
mcp_asdf_config_t config = MCP_ASDF_CONFIG_ASDF(mcp_asdf_t_table_omega05_q30);
#else
mcp_asdf_config_t config = MCP_ASDF_CONFIG_ROBUST;
#endif
uint8_t image[MCP_ASDF_IMAGE_SIZE];

void bench_start(void)
{
    const uint8_t filter = (uint8_t)bench_state.filter;
    /* first as one that needs no table, so that this is not checked every time */
    config.filter = filter == MCP_ASDF_ADAPTIVE ? (uint8_t)MCP_ASDF_OFF : filter;
    (void)mcp_asdf_init(&robot, &config, 5, bench_state.b_hat);
    config.filter = filter;
    config.filter_period = robot.filter_left = bench_state.filter_period;
    config.memory = bench_state.memory;
    robot.t = bench_state.t;
    robot.n = bench_state.n;
#if MCP_ASDF_WITH_ROBUST
    if (mcp_asdf_is_robust(&config)) {
        robot.robust.centre = bench_state.centre;
        robot.robust.spread = bench_state.spread;
        robot.robust.votes = (uint16_t)bench_state.votes;
        robot.robust.turn = (uint8_t)bench_state.turn;
        robot.robust.batch_t = bench_state.batch_t;
        robot.robust.batch_n = bench_state.batch_n;
        robot.robust.dispersion = (uint16_t)bench_state.dispersion;
        robot.robust.filled_slots = bench_state.filled_slots;
        for (uint8_t slot = 0; slot < MCP_ASDF_SLOTS; ++slot) {
            robot.received.estimates[slot] = (uint16_t)bench_state.estimates[slot];
        }
    }
#endif
}

uint32_t bench_filtered(void) { return (uint32_t)robot.counters.tests << 16 | robot.counters.updates; }

int main(void)
{
    (void)mcp_asdf_init(&robot, &config, 5, MCP_ASDF_PROBABILITY(95, 100));
    (void)mcp_asdf_observe(&robot, MCP_ASDF_BLACK);
    (void)mcp_asdf_receive(&robot, 6, mcp_asdf_x_hat(&robot), mcp_asdf_alpha(&robot));
    (void)mcp_asdf_settle(&robot);
#ifdef WHOLE
    mcp_asdf_save(&robot, image);
    (void)mcp_asdf_restore(&robot, &config, image);
    (void)mcp_asdf_step(&robot, mcp_asdf_invariants_hold(&robot) ? MCP_ASDF_WHITE : MCP_ASDF_BLACK);
    return (int)(mcp_asdf_x(&robot) - mcp_asdf_x_bar(&robot) - mcp_asdf_counters(&robot).tests);
#else
    return (int)mcp_asdf_x(&robot);
#endif
}
