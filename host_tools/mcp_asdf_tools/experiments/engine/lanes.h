/* Private to the engine: estimates of many robots side by side, in vector registers. A lane is a robot. The
 * arithmetic is the core's own, which lanes.c includes.
 */
#ifndef MCP_ASDF_LANES_H
#define MCP_ASDF_LANES_H

#include "engine.h"
#include "targets.h"

#define LANES 16        /* side by side */
#define STEPS_IN_ROW 32 /* of which a row keeps the informed estimates */

/* The sums of a message or of a round, as in mcp_asdf_closed_t, by lane. */
typedef struct {
    uint64_t alpha[LANES];
    uint64_t alpha_x_low[LANES];
    uint64_t alpha_x_high[LANES];
} lanes_sums_t;

/* A row of LANES robots side by side: entry `lane` of each array, 0 .. LANES - 1, describes the robot of this
 * lane. In arrays of two dimensions the lane is the last index, which runs fastest.
 *   n .. turn       members of mcp_asdf_t, of its accuracy and of its robust filter
 *   estimates       those that the robust filter keeps, a slot in each estimates[...]
 *   trial, robot    numbers of the trial and the robot, which decide the draws
 *   draws           random words of four steps: draws[step_index % 4] of this step
 *   black_limit     probability of observing black, unit 2^-31: black is observed if the upper 31 bits of the
 *                   draw are below this; 0 for idle lanes, whose n must not pass t
 *   message_count   messages from linked robots since the last step of the firmware
 *   message_sums    sums of the robot's own message alone
 *   round_sums      sums of the messages received in this round
 *   x               informed estimates of the last steps, Q23, a step in each x[...] */
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
    uint32_t filled_slots[LANES];
    uint32_t votes[LANES];
    uint32_t turn[LANES];
    uint16_t estimates[MCP_ASDF_SLOTS][LANES];
    uint32_t trial[LANES];
    uint32_t robot[LANES];
    uint32_t draws[4][LANES];
    uint32_t black_limit[LANES];
    uint32_t message_count[LANES];
    lanes_sums_t message_sums;
    lanes_sums_t round_sums;
    uint32_t x[STEPS_IN_ROW][LANES];
} lanes_t;

/* Returns 1 if the robot of `lane` observes black in step `step_index`, from 0, for which draws and
 * black_limit must be set; else 0. */
IN_LOOPS uint32_t lanes_is_black(const lanes_t *row, uint32_t lane, uint32_t step_index)
{
    const uint32_t draw = row->draws[step_index % 4][lane]; /* one call of the generator serves four steps */
    const uint32_t upper_31_bits = draw >> 1;
    return upper_31_bits < row->black_limit[lane]; /* a probability in units of 2^-31 */
}

/* Copy a robot's values into `lane` of a row, and form the sums of its message. */
void lanes_load_robot(lanes_t *row, uint32_t lane, const mcp_asdf_t *robot);

/* Let the robots of `count` rows make their t-th observation, in step `step_index`, from 0: n, x_hat, alpha
 * and the sums of the message change. */
void lanes_observe(lanes_t *rows, uint32_t count, uint32_t t, uint32_t step_index);

/* End the round of robots with the paper's filter or none: informed estimates go to x[x_index], and the next
 * round is empty. */
void lanes_settle_sums(lanes_t *rows, uint32_t count, uint32_t x_index);

/* Keep the message of the robot in sender_lane of sender_row in the robust filter of the robot in
 * receiver_lane of `row`, unless its alpha is 0. */
void lanes_keep_estimate(lanes_t *row, uint32_t receiver_lane, const lanes_t *sender_row,
                         uint32_t sender_lane);

/* Keep all messages of fully connected swarms in the robust filters of their receivers, senders in ascending
 * order. LANES swarms run side by side, with a row for each robot. */
void lanes_keep_all_estimates(lanes_t *rows, uint32_t robots);

/* End the round of robots with the robust filter: each takes a vote, and informed estimates go to
 * x[x_index]. */
void lanes_settle_votes(lanes_t *rows, uint32_t count, uint32_t x_index);

/* Copy the robust filter's values of `lane` into a robot that has this filter; does nothing to another one.
 */
void lanes_store_filter(const lanes_t *row, uint32_t lane, mcp_asdf_t *robot);

#endif
