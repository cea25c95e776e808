/* The firmware, and its estimates in lanes. lanes.h is the manual.
 *
 * The core is compiled here, once for the whole engine, so that the loops below can call its static
 * functions: the engine has no arithmetic of its own. gcc turns these loops into vector instructions as long
 * as no value in those functions comes from a table, a call or more than four ways; the benchmark shows it.
 * It needs -fno-trapping-math, because it may then compute both ways of an `if` with a division in it.
 */
#define MCP_ASDF_DIVIDE MCP_ASDF_DIVIDE_BY_INCLUDER

#include "lanes_arithmetic.h"
/* clang-format off: the core divides with what stands above. */
#include "mcp_asdf.c" /* NOLINT(bugprone-suspicious-include): see above */
/* clang-format on */

#include "lanes.h"

void lanes_load(lanes_t *lanes, uint32_t l, const mcp_asdf_t *robot)
{
    lanes->n[l] = robot->n;
    lanes->x_hat[l] = robot->x_hat;
    lanes->alpha[l] = robot->alpha;
    lanes->b_hat[l] = robot->accuracy.b_hat;
    lanes->c[l] = robot->accuracy.c;
    lanes->common[l] = robot->accuracy.common;
    lanes->rare[l] = robot->accuracy.rare;
    lanes->g_shift[l] = robot->accuracy.g_shift;
    lanes->rare_shift[l] = robot->accuracy.rare_shift;
    lanes->centre[l] = robot->crowd.centre;
    lanes->spread[l] = robot->crowd.spread;
    lanes->voices[l] = robot->crowd.voices;
    lanes->votes[l] = robot->crowd.votes;
    lanes->trend[l] = robot->crowd.trend;
}

FOR_EACH_TARGET void lanes_observe(lanes_t *lanes, uint32_t count, uint32_t t, const uint32_t *restrict black)
{
    for (uint32_t l = 0; l < count; ++l) {
        const mcp_asdf_accuracy_t accuracy = {lanes->b_hat[l], lanes->c[l],       lanes->common[l],
                                              lanes->rare[l],  lanes->g_shift[l], lanes->rare_shift[l]};
        const message_t own = estimate(t, lanes->n[l] += black[l], &accuracy);
        lanes->x_hat[l] = own.x_hat;
        lanes->alpha[l] = own.alpha;
    }
}

FOR_EACH_TARGET void lanes_say(const lanes_t *lanes, uint32_t count, lanes_sums_t *said)
{
    for (uint32_t l = 0; l < count; ++l) {
        const word_pair_t alpha = units(lanes->alpha[l]);
        said->alpha[l] = join(alpha.high, alpha.low);
        said->alpha_x_low[l] = multiply(alpha.low, lanes->x_hat[l]);
        said->alpha_x_high[l] = multiply(alpha.high, lanes->x_hat[l]);
    }
}

FOR_EACH_TARGET void lanes_inform(const lanes_t *lanes, uint32_t count, const lanes_sums_t *heard,
                                  uint32_t *restrict x)
{
    for (uint32_t l = 0; l < count; ++l) {
        const mcp_asdf_closed_t closed = {heard->alpha[l], heard->alpha_x_low[l], heard->alpha_x_high[l]};
        x[l] = informed_estimate(&closed, lanes->x_hat[l], lanes->alpha[l]);
    }
}

/* A vote of `sender` in lane l, if its alpha is not 0: both ways are computed. */
ALWAYS_INLINE void vote_in_lane(lanes_t *lanes, size_t l, uint32_t sender, uint32_t x_hat, uint32_t alpha)
{
    const middle_t before = {lanes->centre[l], lanes->spread[l], lanes->votes[l], lanes->trend[l]};
    const middle_t after = middle_after(before, x_hat);
    const bool counts = alpha >> 8 != 0U;
    lanes->centre[l] = counts ? after.centre : before.centre;
    lanes->spread[l] = counts ? after.spread : before.spread;
    lanes->votes[l] = counts ? after.votes : before.votes;
    lanes->trend[l] = counts ? after.trend : before.trend;
    lanes->voices[l] |= (uint32_t)counts << (sender & 31U);
}

void lanes_vote(lanes_t *lanes, uint32_t receiver, const lanes_t *others, uint32_t sender, uint32_t id)
{
    vote_in_lane(lanes, receiver, id, others->x_hat[sender], others->alpha[sender]);
}

FOR_EACH_TARGET void lanes_vote_all(lanes_t *lanes, uint32_t robots)
{
    for (uint32_t sender = 0; sender < robots; ++sender) {
        const size_t from = (size_t)sender * LANES_OF_TRIALS, end = (size_t)robots * LANES_OF_TRIALS;
        uint32_t x_hat[LANES_OF_TRIALS], alpha[LANES_OF_TRIALS];
        for (size_t l = 0; l < LANES_OF_TRIALS; ++l) {
            x_hat[l] = lanes->x_hat[from + l];
            alpha[l] = lanes->alpha[from + l];
        }
        for (size_t to = 0; to < end; to += LANES_OF_TRIALS) {
            for (size_t l = 0; l < LANES_OF_TRIALS && to != from; ++l) {
                vote_in_lane(lanes, to + l, sender, x_hat[l], alpha[l]);
            }
        }
    }
}

FOR_EACH_TARGET void lanes_centre(const lanes_t *lanes, uint32_t count, uint32_t *restrict x)
{
    for (uint32_t l = 0; l < count; ++l) {
        const mcp_asdf_t robot = {.crowd = {.centre = lanes->centre[l], .votes = (uint16_t)lanes->votes[l]}};
        x[l] = crowd_x(&robot, lanes->x_hat[l]);
    }
}

void lanes_unload(const lanes_t *lanes, uint32_t l, mcp_asdf_t *robot)
{
    robot->crowd.centre = lanes->centre[l];
    robot->crowd.spread = lanes->spread[l];
    robot->crowd.voices = lanes->voices[l];
    robot->crowd.votes = (uint16_t)lanes->votes[l];
    robot->crowd.trend = (uint16_t)lanes->trend[l];
}
