/* Private to the engine: estimates of many robots side by side, in vector registers. A lane is a robot. The
 * arithmetic is the core's own, which lanes.c includes.
 */
#ifndef MCP_ASDF_LANES_H
#define MCP_ASDF_LANES_H

#include "engine.h"
#include "targets.h"

#define LANES_OF_TRIALS 16 /* trials of a fully connected swarm side by side */
#define LANES (LANES_OF_TRIALS * MCP_ASDF_ENGINE_MAX_CONNECTED)

/* Members of mcp_asdf_t, of its accuracy and of its crowd, by lane. */
typedef struct {
    uint32_t n[LANES];
    uint32_t x_hat[LANES];
    uint32_t alpha[LANES];
    uint32_t b_hat[LANES];
    uint32_t c[LANES];
    uint32_t common[LANES];
    uint32_t rare[LANES];
    uint32_t g_shift[LANES];
    uint32_t rare_shift[LANES];
    uint32_t centre[LANES];
    uint32_t spread[LANES];
    uint32_t voices[LANES];
    uint32_t votes[LANES];
    uint32_t trend[LANES];
} lanes_t;

/* Members of mcp_asdf_closed_t by lane. */
typedef struct {
    uint64_t alpha[LANES];
    uint64_t alpha_x_low[LANES];
    uint64_t alpha_x_high[LANES];
} lanes_sums_t;

/* Copy a robot's values into lane l. */
void lanes_load(lanes_t *lanes, uint32_t l, const mcp_asdf_t *robot);

/* Count an observation of each of the first `count` lanes, 1 if black, as their t-th, and estimate. */
void lanes_observe(lanes_t *lanes, uint32_t count, uint32_t t, const uint32_t *restrict black);

/* The sums of each lane's message alone. */
void lanes_say(const lanes_t *lanes, uint32_t count, lanes_sums_t *said);

/* Each lane's informed estimate after a round of these sums. */
void lanes_inform(const lanes_t *lanes, uint32_t count, const lanes_sums_t *heard, uint32_t *restrict x);

/* With the robust filter: the message of lane `sender` of these or others, from robot `id`, is a vote in lane
 * `receiver`. */
void lanes_vote(lanes_t *lanes, uint32_t receiver, const lanes_t *others, uint32_t sender, uint32_t id);

/* The same of all messages of fully connected swarms, LANES_OF_TRIALS of them side by side: senders in
 * ascending order. */
void lanes_vote_all(lanes_t *lanes, uint32_t robots);

/* With the robust filter: each lane's informed estimate. */
void lanes_centre(const lanes_t *lanes, uint32_t count, uint32_t *restrict x);

/* Bring a robot's crowd to that of lane l. */
void lanes_unload(const lanes_t *lanes, uint32_t l, mcp_asdf_t *robot);

#endif
