/* What an image of the cost benchmark offers beside the calls that are measured: one robot, of the firmware
 * or of the baseline, which can be set to any moment of its life. */
#ifndef MCP_ASDF_COST_ROBOT_H
#define MCP_ASDF_COST_ROBOT_H

#include "mcp_asdf.h"

#ifndef Q
#define Q 30
#endif
#define PASTE(a, b) a##b
#define TABLE_OF(q) PASTE(mcp_asdf_t_table_omega05_q, q)
extern const uint32_t TABLE_OF(Q)[Q + 3];

/* Make a robot with id 5. */
void bench_start(uint32_t b_hat);

/* Let it filter every filter_period rounds and halve t when it reaches memory, and set the numbers of
 * observations and of black ones among them. */
void bench_set(uint32_t filter_period, uint32_t memory, uint32_t t, uint32_t n);

/* Times that b_hat was re-estimated since the start. */
uint32_t bench_updates(void);

/* Bytes of RAM of a robot. */
uint32_t bench_size(void);

#endif
