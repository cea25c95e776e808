/* What an image of the cost benchmark offers beside the calls that are measured: one robot, of the firmware
 * or of the baseline, which can be set to any moment of its life. */
#ifndef MCP_ASDF_COST_ROBOT_H
#define MCP_ASDF_COST_ROBOT_H

#include "mcp_asdf.h"

/* Make a robot with id 5. */
void bench_start(uint32_t b_hat);

/* Let it filter every filter_period rounds and halve t when it reaches memory, and set the numbers of
 * observations and of black ones among them. */
void bench_set(uint32_t filter_period, uint32_t memory, uint32_t t, uint32_t n);

/* Times that b_hat was re-estimated since the start. */
uint32_t bench_updates(void);

#endif
