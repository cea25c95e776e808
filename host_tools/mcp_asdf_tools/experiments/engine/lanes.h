/* Private to the engine: estimates of many robots side by side, in vector registers. A lane is a robot. The
 * arithmetic is the core's own, which lanes.c includes.
 */
#ifndef MCP_ASDF_LANES_H
#define MCP_ASDF_LANES_H

#include "engine.h"
#include "targets.h"

#define LANES 16 /* side by side */
#define STEPS_KEPT 32

/* The sums of a message or of a round, as in mcp_asdf_closed_t, by lane. */
typedef struct {
    uint64_t alpha[LANES];
    uint64_t alpha_x_low[LANES];
    uint64_t alpha_x_high[LANES];
} lanes_sums_t;

/* Robots side by side, by lane.
 *   n .. trend     members of mcp_asdf_t, of its accuracy and of its crowd
 *   trial, robot   whose draws it has
 *   words          draws of four steps
 *   limit          of a draw for black; 0 for idle lanes, whose n must not pass t
 *   messages       how many it heard from its neighbours since the last step of the firmware
 *   said           its message alone
 *   heard          its round so far
 *   x              informed estimates of the last steps */
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
    uint32_t trial[LANES];
    uint32_t robot[LANES];
    uint32_t words[4][LANES];
    uint32_t limit[LANES];
    uint32_t messages[LANES];
    lanes_sums_t said;
    lanes_sums_t heard;
    uint32_t x[STEPS_KEPT][LANES];
} lanes_t;

/* Whether lane l observes black in step k: 1 or 0. */
IN_LOOPS uint32_t lanes_black(const lanes_t *row, uint32_t l, uint32_t k)
{
    return row->words[k % 4][l] >> 1 < row->limit[l];
}

/* Copy a robot's values into lane l, which says what the robot says. */
void lanes_load(lanes_t *row, uint32_t l, const mcp_asdf_t *robot);

/* What the lanes of `count` rows observe in step k is their t-th observation: they estimate, and say so. */
void lanes_observe(lanes_t *rows, uint32_t count, uint32_t t, uint32_t k);

/* The informed estimates after a round are x[kept]; the next round is empty. */
void lanes_inform(lanes_t *rows, uint32_t count, uint32_t kept);

/* With the robust filter: the message of lane `sender` of `other` is a vote in lane `receiver`. */
void lanes_vote(lanes_t *row, uint32_t receiver, const lanes_t *other, uint32_t sender);

/* The same of all messages of fully connected swarms, LANES of them side by side with a row for each robot:
 * senders in ascending order. */
void lanes_vote_all(lanes_t *rows, uint32_t robots);

/* With the robust filter: the informed estimates are x[kept]. */
void lanes_centre(lanes_t *rows, uint32_t count, uint32_t kept);

/* Bring a robot's crowd to that of lane l. */
void lanes_unload(const lanes_t *row, uint32_t l, mcp_asdf_t *robot);

#endif
