/* The firmware, and its estimates in lanes. lanes.h is the manual.
 *
 * The core is compiled here, once for the whole engine, so that the loops below can call its static
 * functions: the engine has no arithmetic of its own. gcc turns these loops into vector instructions as long
 * as no value in those functions comes from a table, a call or more than four ways; the benchmark shows it.
 * It needs -fno-trapping-math, because it may then compute both ways of an `if` with a division in it.
 * SIDE_BY_SIDE before a loop tells it that no lane needs what another one writes (targets.h).
 */
#define MCP_ASDF_DIVIDE MCP_ASDF_DIVIDE_BY_INCLUDER

#include "lanes_arithmetic.h"
/* clang-format off: the core divides with what stands above. */
#include "mcp_asdf.c" /* NOLINT(bugprone-suspicious-include): see above */
/* clang-format on */

#include "lanes.h"

/* Set message_sums of `lane` to the sums of a round in which the message of this lane's robot (x_hat, alpha)
 * is the only one: alpha, and alpha x_hat in two parts, for the lower and the upper word of alpha. */
ALWAYS_INLINE void form_message_sums(lanes_t *row, size_t lane)
{
    const word_pair_t wide_alpha = alpha_units(row->alpha[lane]); /* in units of 2^-24, as two words */
    row->message_sums.alpha[lane] = join(wide_alpha.high, wide_alpha.low);
    row->message_sums.alpha_x_low[lane] = multiply(wide_alpha.low, row->x_hat[lane]);
    row->message_sums.alpha_x_high[lane] = multiply(wide_alpha.high, row->x_hat[lane]);
}

/* Copy from a robot into `lane` of a row all that steps in lanes need of it:
 *   n, x_hat, alpha            black observations, and the local estimate with its confidence
 *   b_hat .. rare_shift        the accuracy: b_hat and what follows from it
 *   centre .. turn             what the robust filter remembers of votes; with other filters of no use
 *   estimates                  those that the robust filter keeps, copied only if the robot has this filter
 * and set message_sums to the sums of a round in which the robot's message is the only one. t, the number of
 * observations, is the same in all lanes and not kept there. */
void lanes_load_robot(lanes_t *row, uint32_t lane, const mcp_asdf_t *robot)
{
    row->n[lane] = robot->n;
    row->x_hat[lane] = robot->x_hat;
    row->alpha[lane] = robot->alpha;
    row->b_hat[lane] = robot->accuracy.b_hat;
    row->c[lane] = robot->accuracy.c;
    row->common[lane] = robot->accuracy.common;
    row->rare[lane] = robot->accuracy.rare;
    row->g_shift[lane] = robot->accuracy.g_shift;
    row->rare_shift[lane] = robot->accuracy.rare_shift;
    row->centre[lane] = robot->robust.centre;
    row->spread[lane] = robot->robust.spread;
    row->filled_slots[lane] = robot->robust.filled_slots;
    row->votes[lane] = robot->robust.votes;
    row->turn[lane] = robot->robust.turn;
    /* Robots with other filters have no estimates: in the union `received` they have the sums of rounds. */
    if (mcp_asdf_is_robust(robot->config)) {
        for (uint32_t slot = 0; slot < MCP_ASDF_SLOTS; ++slot) {
            row->estimates[slot][lane] = robot->received.estimates[slot];
        }
    }
    form_message_sums(row, lane);
}

/* Make the t-th observation, which the draws of step `step_index` decide, in all lanes of `count` rows: n
 * grows by 1 in lanes that observe black, and x_hat, alpha and the sums of the message follow from t and n.
 */
FOR_EACH_TARGET void lanes_observe(lanes_t *rows, uint32_t count, uint32_t t, uint32_t step_index)
{
    for (lanes_t *row = rows; row < rows + count; ++row) {
        SIDE_BY_SIDE
        for (uint32_t lane = 0; lane < LANES; ++lane) {
            const mcp_asdf_accuracy_t accuracy = {.b_hat = row->b_hat[lane],
                                                  .c = row->c[lane],
                                                  .common = row->common[lane],
                                                  .rare = row->rare[lane],
                                                  .g_shift = row->g_shift[lane],
                                                  .rare_shift = row->rare_shift[lane]};
            row->n[lane] += lanes_is_black(row, lane, step_index); /* 1 for black */
            const estimate_t message = estimate(t, row->n[lane], &accuracy);
            row->x_hat[lane] = message.x_hat;
            row->alpha[lane] = message.alpha;
            form_message_sums(row, lane);
        }
    }
}

/* End the round in all lanes of `count` rows: form the informed estimate x of each lane, Q23, which is the
 * mean of x_hat weighted by alpha over the messages of the round and the lane's own one; store it in
 * x[x_index], and set the sums of the round to 0. */
FOR_EACH_TARGET void lanes_settle_sums(lanes_t *rows, uint32_t count, uint32_t x_index)
{
    for (lanes_t *row = rows; row < rows + count; ++row) {
        SIDE_BY_SIDE
        for (uint32_t lane = 0; lane < LANES; ++lane) {
            const mcp_asdf_closed_t closed = {.alpha = row->round_sums.alpha[lane],
                                              .alpha_x_low = row->round_sums.alpha_x_low[lane],
                                              .alpha_x_high = row->round_sums.alpha_x_high[lane]};
            row->x[x_index][lane] = informed_estimate(&closed, row->x_hat[lane], row->alpha[lane]);
            row->round_sums.alpha[lane] = 0;
            row->round_sums.alpha_x_low[lane] = 0;
            row->round_sums.alpha_x_high[lane] = 0;
        }
    }
}

/* Keep the message of robot `sender`, x_hat as Q23 and an alpha word, in the robust filter of `lane`, unless
 * its alpha is 0: in slot `sender` modulo 32, in place of an earlier one. The new value of the slot is formed
 * in any case, and then the new or the old value is selected: vectors have no branches. */
ALWAYS_INLINE void keep_in_lane(lanes_t *row, size_t lane, uint32_t sender, uint32_t x_hat, uint32_t alpha)
{
    const uint32_t slot = sender % MCP_ASDF_SLOTS;
    const bool has_confidence = alpha >> 8 != 0U; /* alpha > 0: the mantissa, in bits 31 to 8, is not 0 */
    row->estimates[slot][lane] = has_confidence ? slot_estimate(x_hat) : row->estimates[slot][lane];
    row->filled_slots[lane] |= (uint32_t)has_confidence
                               << slot; /* a message without confidence sets no bit */
}

/* Keep the message of the robot in sender_lane of sender_row in the robust filter of the robot in
 * receiver_lane of `row`, unless its alpha is 0. */
void lanes_keep_estimate(lanes_t *row, uint32_t receiver_lane, const lanes_t *sender_row,
                         uint32_t sender_lane)
{
    const uint32_t sender = sender_row->robot[sender_lane]; /* the number of the robot in its trial */
    keep_in_lane(row, receiver_lane, sender, sender_row->x_hat[sender_lane], sender_row->alpha[sender_lane]);
}

/* Keep the message of each robot in the robust filters of all others of its swarm, senders in ascending
 * order. LANES swarms run side by side: the first row has robot 0 of all swarms, a swarm in each lane, the
 * second row robot 1, and so on. */
FOR_EACH_TARGET void lanes_keep_all_estimates(lanes_t *rows, uint32_t robots)
{
    for (uint32_t sender = 0; sender < robots; ++sender) {
        const lanes_t *const sender_row = &rows[sender];
        for (lanes_t *row = rows; row < rows + robots; ++row) {
            if (row == sender_row) {
                continue; /* a robot does not receive its own message */
            }
            SIDE_BY_SIDE
            for (uint32_t lane = 0; lane < LANES; ++lane) {
                keep_in_lane(row, lane, sender, sender_row->x_hat[lane], sender_row->alpha[lane]);
            }
        }
    }
}

/* Choose the estimate that votes next in `lane`, and set the turn to what follows it: filled slots vote in
 * ascending order, from the turn on; after the last one the robot's own estimate does, unless it has no
 * confidence; then the first filled slot again. Returns the x_hat of the vote as Q23. While no slot is filled
 * there is no vote: then the robot's own x_hat is returned, which is not used, and the turn stays. */
static uint32_t choose_vote(lanes_t *row, size_t lane)
{
    if (row->filled_slots[lane] == 0U) {
        return row->x_hat[lane];
    }
    const bool has_confidence = row->alpha[lane] >> 8 != 0U; /* alpha > 0: its mantissa is in bits 31 to 8 */
    const uint32_t slot = next_slot(row->filled_slots[lane], row->turn[lane], has_confidence);
    const bool is_own = slot >= MCP_ASDF_SLOTS; /* next_slot() returns MCP_ASDF_SLOTS for the robot's own */
    row->turn[lane] = is_own ? 0U : slot + 1U;
    return is_own ? row->x_hat[lane] : q23_from_q16(row->estimates[slot][lane]);
}

/* Take a vote in `lane`, if a slot is filled there, for x_hat (Q23): the vote changes the centre of the
 * votes, their spread and their number. The new values are formed in any case, and then the new or the old
 * values are selected: vectors have no branches. */
ALWAYS_INLINE void take_vote_in_lane(lanes_t *row, size_t lane, uint32_t x_hat)
{
    const vote_statistics_t before = {
        .centre = row->centre[lane], .spread = row->spread[lane], .votes = row->votes[lane]};
    const vote_statistics_t after = statistics_after_vote(before, x_hat);
    const bool has_vote = row->filled_slots[lane] != 0U; /* else choose_vote() has found no vote */
    row->centre[lane] = has_vote ? after.centre : before.centre;
    row->spread[lane] = has_vote ? after.spread : before.spread;
    row->votes[lane] = has_vote ? after.votes : before.votes;
}

/* Take a vote in each lane in which a slot is filled, and store the informed estimate of each lane, Q23, in
 * x[x_index]: the centre, or the robot's own estimate before the first vote. Which slot votes differs from
 * lane to lane, so that the votes are chosen lane by lane; what they change is computed side by side. */
FOR_EACH_TARGET void lanes_settle_votes(lanes_t *rows, uint32_t count, uint32_t x_index)
{
    for (lanes_t *row = rows; row < rows + count; ++row) {
        uint32_t chosen_x_hats[LANES]; /* the votes, Q23 */
        for (uint32_t lane = 0; lane < LANES; ++lane) {
            chosen_x_hats[lane] = choose_vote(row, lane);
        }
        SIDE_BY_SIDE
        for (uint32_t lane = 0; lane < LANES; ++lane) {
            take_vote_in_lane(row, lane, chosen_x_hats[lane]);
            const bool has_votes =
                row->filled_slots[lane] != 0U; /* a filled slot stays filled, and has voted now */
            row->x[x_index][lane] = has_votes ? q23_from_q30(row->centre[lane]) : row->x_hat[lane];
        }
    }
}

/* Copy from `lane` of a row into a robot what steps in lanes have changed in its robust filter: by votes the
 * centre, the spread, the number of votes and the turn (the slot from which on the next one votes), and by
 * received messages the estimates in the slots and which of these are filled. Does nothing if the robot has
 * another filter. */
void lanes_store_filter(const lanes_t *row, uint32_t lane, mcp_asdf_t *robot)
{
    if (!mcp_asdf_is_robust(robot->config)) {
        return;
    }
    robot->robust.centre = row->centre[lane];
    robot->robust.spread = row->spread[lane];
    robot->robust.filled_slots = row->filled_slots[lane];
    robot->robust.votes = (uint16_t)row->votes[lane];
    robot->robust.turn = (uint8_t)row->turn[lane];
    /* The estimates are in the union `received`, as robots with other filters have sums in their place. */
    for (uint32_t slot = 0; slot < MCP_ASDF_SLOTS; ++slot) {
        robot->received.estimates[slot] = row->estimates[slot][lane];
    }
}
