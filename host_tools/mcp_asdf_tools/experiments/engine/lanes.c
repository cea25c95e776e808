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

/* Set message_sums of lane l to the sums of a round in which its message (x_hat, alpha) is the only one:
 * alpha, and alpha x_hat in two parts, for the lower and the upper word of alpha. */
ALWAYS_INLINE void form_message_sums(lanes_t *row, size_t l)
{
    const word_pair_t wide_alpha = alpha_units(row->alpha[l]); /* in units of 2^-24, as two words */
    row->message_sums.alpha[l] = join(wide_alpha.high, wide_alpha.low);
    row->message_sums.alpha_x_low[l] = multiply(wide_alpha.low, row->x_hat[l]);
    row->message_sums.alpha_x_high[l] = multiply(wide_alpha.high, row->x_hat[l]);
}

/* Copy from a robot into lane l all that steps in lanes need of it:
 *   n, x_hat, alpha            black observations, and the local estimate with its confidence
 *   b_hat .. rare_shift        the accuracy: b_hat and what follows from it
 *   centre .. turn             what the robust filter remembers of votes; with other filters of no use
 *   estimates                  those that the robust filter keeps, copied only if the robot has this filter
 * and set message_sums to the sums of a round in which the robot's message is the only one. t, the number of
 * observations, is the same in all lanes and not kept there. */
void lanes_load_robot(lanes_t *row, uint32_t l, const mcp_asdf_t *robot)
{
    row->n[l] = robot->n;
    row->x_hat[l] = robot->x_hat;
    row->alpha[l] = robot->alpha;
    row->b_hat[l] = robot->accuracy.b_hat;
    row->c[l] = robot->accuracy.c;
    row->common[l] = robot->accuracy.common;
    row->rare[l] = robot->accuracy.rare;
    row->g_shift[l] = robot->accuracy.g_shift;
    row->rare_shift[l] = robot->accuracy.rare_shift;
    row->centre[l] = robot->robust.centre;
    row->spread[l] = robot->robust.spread;
    row->filled_slots[l] = robot->robust.filled_slots;
    row->votes[l] = robot->robust.votes;
    row->turn[l] = robot->robust.turn;
    /* Robots with other filters have no estimates: in the union `received` they have the sums of rounds. */
    if (mcp_asdf_is_robust(robot->config)) {
        for (uint32_t slot = 0; slot < MCP_ASDF_SLOTS; ++slot) {
            row->estimates[slot][l] = robot->received.estimates[slot];
        }
    }
    form_message_sums(row, l);
}

/* Make the t-th observation, which the draws of step k decide, in all lanes of `count` rows: n grows by 1 in
 * lanes that observe black, and x_hat, alpha and the sums of the message follow from t and n. */
FOR_EACH_TARGET void lanes_observe(lanes_t *rows, uint32_t count, uint32_t t, uint32_t k)
{
    for (lanes_t *row = rows; row < rows + count; ++row) {
        SIDE_BY_SIDE
        for (uint32_t l = 0; l < LANES; ++l) {
            const mcp_asdf_accuracy_t accuracy = {.b_hat = row->b_hat[l],
                                                  .c = row->c[l],
                                                  .common = row->common[l],
                                                  .rare = row->rare[l],
                                                  .g_shift = row->g_shift[l],
                                                  .rare_shift = row->rare_shift[l]};
            row->n[l] += lanes_is_black(row, l, k);
            const estimate_t message = estimate(t, row->n[l], &accuracy);
            row->x_hat[l] = message.x_hat;
            row->alpha[l] = message.alpha;
            form_message_sums(row, l);
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
        for (uint32_t l = 0; l < LANES; ++l) {
            const mcp_asdf_closed_t closed = {.alpha = row->round_sums.alpha[l],
                                              .alpha_x_low = row->round_sums.alpha_x_low[l],
                                              .alpha_x_high = row->round_sums.alpha_x_high[l]};
            row->x[x_index][l] = informed_estimate(&closed, row->x_hat[l], row->alpha[l]);
            row->round_sums.alpha[l] = 0;
            row->round_sums.alpha_x_low[l] = 0;
            row->round_sums.alpha_x_high[l] = 0;
        }
    }
}

/* Keep the message of robot `sender`, x_hat as Q23 and an alpha word, in the robust filter of lane l, unless
 * its alpha is 0: in slot `sender` modulo 32, in place of an earlier one. What the slot would hold is formed
 * in any case, and then that or the old value is selected: vectors have no branches. */
ALWAYS_INLINE void keep_in_lane(lanes_t *row, size_t l, uint32_t sender, uint32_t x_hat, uint32_t alpha)
{
    const uint32_t slot = sender % MCP_ASDF_SLOTS;
    const bool counts = alpha >> 8 != 0U; /* the mantissa, in bits 31 to 8, is not 0 */
    row->estimates[slot][l] = counts ? slot_estimate(x_hat) : row->estimates[slot][l];
    row->filled_slots[l] |= (uint32_t)counts << slot; /* no bit if it does not count */
}

/* Keep the message of lane `sender` of sender_row in lane `receiver` of `row`, unless its alpha is 0. */
void lanes_keep_estimate(lanes_t *row, uint32_t receiver, const lanes_t *sender_row, uint32_t sender)
{
    keep_in_lane(row, receiver, sender_row->robot[sender], sender_row->x_hat[sender],
                 sender_row->alpha[sender]);
}

/* Keep the message of each robot in the robust filters of all others of its swarm, senders in ascending
 * order. Row j has robot j of LANES swarms, one in each lane. */
FOR_EACH_TARGET void lanes_keep_all_estimates(lanes_t *rows, uint32_t robots)
{
    for (uint32_t sender = 0; sender < robots; ++sender) {
        const lanes_t *const sender_row = &rows[sender];
        for (lanes_t *row = rows; row < rows + robots; ++row) {
            if (row == sender_row) {
                continue;
            }
            SIDE_BY_SIDE
            for (uint32_t l = 0; l < LANES; ++l) {
                keep_in_lane(row, l, sender, sender_row->x_hat[l], sender_row->alpha[l]);
            }
        }
    }
}

/* Choose the estimate that votes next in lane l, and set the turn to what follows it: filled slots vote in
 * ascending order, from the turn on; after the last one the robot's own estimate does, unless it has no
 * confidence; then the first filled slot again. Returns the x_hat of the vote as Q23. While no slot is filled
 * there is no vote: then the robot's own x_hat is returned, which is not used, and the turn stays. */
static uint32_t choose_vote(lanes_t *row, size_t l)
{
    if (row->filled_slots[l] == 0U) {
        return row->x_hat[l];
    }
    const bool has_confidence = row->alpha[l] >> 8 != 0U; /* the mantissa, in bits 31 to 8, is not 0 */
    const uint32_t slot = next_slot(row->filled_slots[l], row->turn[l], has_confidence);
    const bool is_own = slot >= MCP_ASDF_SLOTS;
    row->turn[l] = is_own ? 0U : slot + 1U;
    return is_own ? row->x_hat[l] : q23_from_q16(row->estimates[slot][l]);
}

/* Take a vote for the x_hat `vote`, Q23, in lane l, if a slot is filled there: it changes the centre of the
 * votes, their spread and their number. These are formed in any case, and then the new or the old ones are
 * selected: vectors have no branches. */
ALWAYS_INLINE void take_vote_in_lane(lanes_t *row, size_t l, uint32_t vote)
{
    const vote_statistics_t before = {
        .centre = row->centre[l], .spread = row->spread[l], .votes = row->votes[l]};
    const vote_statistics_t after = statistics_after_vote(before, vote);
    const bool counts = row->filled_slots[l] != 0U; /* else choose_vote() has found no vote */
    row->centre[l] = counts ? after.centre : before.centre;
    row->spread[l] = counts ? after.spread : before.spread;
    row->votes[l] = counts ? after.votes : before.votes;
}

/* Take a vote in each lane in which a slot is filled, and store the informed estimate of each lane, Q23, in
 * x[x_index]: the centre, or the robot's own estimate before the first vote. Which slot votes differs from
 * lane to lane, so that this is found lane by lane; what the vote changes is computed side by side. */
FOR_EACH_TARGET void lanes_settle_votes(lanes_t *rows, uint32_t count, uint32_t x_index)
{
    for (lanes_t *row = rows; row < rows + count; ++row) {
        uint32_t votes[LANES];
        for (uint32_t l = 0; l < LANES; ++l) {
            votes[l] = choose_vote(row, l);
        }
        SIDE_BY_SIDE
        for (uint32_t l = 0; l < LANES; ++l) {
            take_vote_in_lane(row, l, votes[l]);
            const bool has_voted = row->filled_slots[l] != 0U; /* slots stay filled */
            row->x[x_index][l] = has_voted ? q23_from_q30(row->centre[l]) : row->x_hat[l];
        }
    }
}

/* Copy from lane l into a robot what steps in lanes have changed in its robust filter: by votes the centre,
 * the spread, the number of votes and the turn (the slot from which on the next one votes), and by received
 * messages the estimates in the slots and which of these are filled. Does nothing if the robot has another
 * filter. */
void lanes_store_filter(const lanes_t *row, uint32_t l, mcp_asdf_t *robot)
{
    if (!mcp_asdf_is_robust(robot->config)) {
        return;
    }
    robot->robust.centre = row->centre[l];
    robot->robust.spread = row->spread[l];
    robot->robust.filled_slots = row->filled_slots[l];
    robot->robust.votes = (uint16_t)row->votes[l];
    robot->robust.turn = (uint8_t)row->turn[l];
    /* The estimates are in the union `received`, as robots with other filters have sums in their place. */
    for (uint32_t slot = 0; slot < MCP_ASDF_SLOTS; ++slot) {
        robot->received.estimates[slot] = row->estimates[slot][l];
    }
}
