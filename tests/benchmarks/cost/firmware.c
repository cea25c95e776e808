/* The firmware under measurement; main() is the least that a robot uses of it, and with WHOLE all there is.
 */
#include "mcp_asdf_image.h"

/* Make a robot with id 5 and this filter. */
void bench_start(uint32_t b_hat, uint32_t filter);
/* Let it filter every filter_period rounds and halve t when it reaches memory, and set the numbers of
 * observations and of black ones among them. */
void bench_set(uint32_t filter_period, uint32_t memory, uint32_t t, uint32_t n);
/* Tests (times 2^16) and re-estimates of b_hat since the start. */
uint32_t bench_filtered(void);
#if MCP_ASDF_WITH_ROBUST
/* Set its votes; their number in the lower half of a word, the turn in the upper one. */
void bench_votes(uint32_t centre, uint32_t spread, uint32_t votes_and_turn);
/* Set its present batch of observations. */
void bench_batch(uint32_t batch_t, uint32_t batch_n, uint32_t dispersion);
/* Set which slots are filled, and the estimates of slots 4 `group` to 4 `group` + 3, two in a word. */
void bench_estimates(uint32_t filled_slots, uint32_t group, uint32_t first_two, uint32_t last_two);
#endif

extern const uint32_t mcp_asdf_t_table_omega05_q30[33];

mcp_asdf_t robot;
#if MCP_ASDF_WITH_ASDF
mcp_asdf_config_t config = MCP_ASDF_CONFIG_ASDF(mcp_asdf_t_table_omega05_q30);
#else
mcp_asdf_config_t config = MCP_ASDF_CONFIG_ROBUST;
#endif
uint8_t image[MCP_ASDF_IMAGE_SIZE];

void bench_start(uint32_t b_hat, uint32_t filter)
{
    /* first as one that needs no table, so that this is not checked every time */
    config.filter = filter == MCP_ASDF_ADAPTIVE ? (uint8_t)MCP_ASDF_OFF : (uint8_t)filter;
    (void)mcp_asdf_init(&robot, &config, 5, b_hat);
    config.filter = (uint8_t)filter;
}

void bench_set(uint32_t filter_period, uint32_t memory, uint32_t t, uint32_t n)
{
    config.filter_period = filter_period;
    config.memory = memory;
    robot.filter_left = filter_period;
    robot.t = t;
    robot.n = n;
}

uint32_t bench_filtered(void) { return (uint32_t)robot.counters.tests << 16 | robot.counters.updates; }

#if MCP_ASDF_WITH_ROBUST
void bench_votes(uint32_t centre, uint32_t spread, uint32_t votes_and_turn)
{
    robot.robust.centre = centre;
    robot.robust.spread = spread;
    robot.robust.votes = (uint16_t)votes_and_turn;
    robot.robust.turn = (uint8_t)(votes_and_turn >> 16);
}

void bench_batch(uint32_t batch_t, uint32_t batch_n, uint32_t dispersion)
{
    robot.robust.batch_t = batch_t;
    robot.robust.batch_n = batch_n;
    robot.robust.dispersion = (uint16_t)dispersion;
}

void bench_estimates(uint32_t filled_slots, uint32_t group, uint32_t first_two, uint32_t last_two)
{
    uint16_t *const estimates = &robot.received.estimates[4U * group];
    robot.robust.filled_slots = filled_slots;
    estimates[0] = (uint16_t)first_two;
    estimates[1] = (uint16_t)(first_two >> 16);
    estimates[2] = (uint16_t)last_two;
    estimates[3] = (uint16_t)(last_two >> 16);
}
#endif

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
