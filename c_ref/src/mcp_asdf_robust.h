/* The robust filter, which is this project's own and not the paper's. Private: a part of mcp_asdf.c, which
 * provides eq. 8. docs/robust.md explains the filter, docs/design.md, section 13, states every bit.
 *
 * A robot with this filter keeps no sums of rounds. It follows the centre of all estimates that it receives,
 * its crowd, and tests its own observations against that centre.
 *
 * Every estimate with confidence is one vote, however large its alpha. A vote moves the centre towards its
 * x_hat, by a limited distance, so that a liar's vote moves it no farther than another's (a Huber
 * M-estimate). The spread is the median distance of the votes from the centre. Both move by a share of the
 * distance, the gain, which falls from 1/8 to 2^-12 as votes are counted (stochastic approximation). In
 * between it is 4 / votes to 8 / votes. */
#ifndef MCP_ASDF_ROBUST_H
#define MCP_ASDF_ROBUST_H

#include "mcp_asdf.h"
#include "mcp_asdf_arithmetic.h"

/* Returns the new b_hat by eq. 8, as Q32, for x_bar as Q32; or 0 if x_bar carries no information. */
static uint32_t reestimate(const mcp_asdf_t *robot, uint32_t x_bar);

#if MCP_ASDF_WITH_ROBUST
/* Fewer votes count as so many: the gain is at most 2^-3. */
#define VOTES_OF_MAX_GAIN 32U
/* While the crowd moves, votes are halved down to this number, where the gain is 2^-6. */
#define VOTES_MIN_WHILE_MOVING (UINT32_C(1) << 8)
/* What a vote adds to the trend, a moving average of about 256 votes in units of 2^-16. */
#define TREND_STEP_UP 255U
#define TREND_STEP_EVEN 128U
/* 1/8 of the trend's range: below it the crowd moves down, so far below the range's end it moves up. */
#define TREND_MOVING_DOWN 0x2000U
/* The test rejects beyond sqrt(12) standard deviations, where a sound robot is in 1 of 2000 tests. */
#define REJECTED_SIGMAS_SQUARED 12U

/* Formats: x_hat is Q23, in units of 2^-23; positions (centre, spread, distances) are Q30; probabilities and
 * shares of observations are Q32. 1.0 is 2^30 as Q30, and has no Q32. */
ALWAYS_INLINE uint32_t q30_from_q23(uint32_t x_hat) { return x_hat << 7; }
ALWAYS_INLINE uint32_t q23_from_q30(uint32_t position) { return position >> 7; }

/* Returns -number if the mask is all ones, number if it is 0: without a branch, modulo 2^32. In two's
 * complement -number is ~number + 1: the XOR with all ones is the ~, and subtracting all ones adds 1. */
ALWAYS_INLINE uint32_t negate_if(uint32_t number, uint32_t mask) { return (number ^ mask) - mask; }

/* Initialise the crowd of a new robot, whose votes and set of senders heard are 0 already. The initial b_hat
 * is kept in crowd.first, for the tests; with other filters that is 0. */
ALWAYS_INLINE void init_crowd(mcp_asdf_t *robot, uint32_t b_hat)
{
    robot->crowd.first = mcp_asdf_is_robust(robot->config) ? b_hat : 0U;
    robot->crowd.centre = MCP_ASDF_CENTRE_START;
    robot->crowd.spread = MCP_ASDF_SPREAD_MAX;
    robot->crowd.trend = MCP_ASDF_TREND_START;
}

/* The members of mcp_asdf_crowd_t that a vote changes whoever its sender is, in full words. */
typedef struct {
    uint32_t centre, spread; /* Q30 */
    uint32_t votes;
    uint32_t trend; /* Q16 */
} crowd_statistics_t;

/* Returns the statistics after a vote for x_hat, Q23 and at most 1.0. The centre moves towards it, by at most
 * a spread times the gain and never beyond it. */
ALWAYS_INLINE crowd_statistics_t statistics_after_vote(crowd_statistics_t statistics, uint32_t x_hat)
{
    const uint32_t centre = statistics.centre, spread = statistics.spread;
    const uint32_t votes = statistics.votes + (statistics.votes < MCP_ASDF_VOTES_MAX ? 1U : 0U);
    /* The gain is 2^-gain_shift. Only the highest bit of the number of votes counts for it; the OR sees to it
     * that this is at least that of VOTES_OF_MAX_GAIN. */
    const uint32_t gain_shift = 29U - leading_zeros(votes | VOTES_OF_MAX_GAIN); /* log2(votes) - 2: [3, 12] */
    const uint32_t spread_step = shift_right(spread, gain_shift + 1U);          /* <= spread / 16 */
    const uint32_t difference = centre - q30_from_q23(x_hat); /* modulo 2^32: within 2^30 of 0 */
    const uint32_t is_up_mask =
        0U - (difference >> 31); /* all ones if the vote is above the centre, else 0 */
    const uint32_t distance = negate_if(difference, is_up_mask);
    /* Votes outside the spread widen it and votes inside narrow it, by the same step. It rests where both are
     * equally frequent: at the median distance. */
    uint32_t limited_distance = distance, new_spread = spread - spread_step;
    if (distance > spread) {
        limited_distance = spread;
        new_spread = spread + spread_step; /* < 2^29 */
        new_spread = new_spread < MCP_ASDF_SPREAD_MAX ? new_spread : MCP_ASDF_SPREAD_MAX;
    } else {
        new_spread = new_spread > MCP_ASDF_SPREAD_MIN ? new_spread : MCP_ASDF_SPREAD_MIN;
    }
    const uint32_t step = shift_right(limited_distance, gain_shift);
    /* Each vote takes 1/256 of the trend away, and one that moves the centre up adds as much of its range. A
     * vote that does not move the centre counts as half up, half down. */
    const uint32_t trend_step = step == 0U ? TREND_STEP_EVEN : is_up_mask & TREND_STEP_UP;
    const uint32_t trend = statistics.trend - (statistics.trend >> 8) + trend_step; /* < 2^16 */
    const crowd_statistics_t result = {centre - negate_if(step, is_up_mask), new_spread, votes, trend};
    return result;
}

/* Count a neighbour's x_hat (Q23) as one vote: it changes the centre and the spread of the estimates, the
 * number of votes and the trend. Sets the sender's bit in `voices`, the set of senders that have voted. */
HOT void update_crowd(mcp_asdf_t *robot, uint8_t sender, uint32_t x_hat)
{
    mcp_asdf_crowd_t *const crowd = &robot->crowd;
    const crowd_statistics_t old_statistics = {crowd->centre, crowd->spread, crowd->votes, crowd->trend};
    const crowd_statistics_t statistics = statistics_after_vote(old_statistics, x_hat);
    crowd->trend = (uint16_t)statistics.trend;
    crowd->votes = (uint16_t)statistics.votes;
    crowd->voices |= shift_left(1, sender & 31U); /* ids modulo 32 */
    crowd->centre = statistics.centre;
    crowd->spread = statistics.spread;
}

/* Returns the centre as Q23; before the first vote x_hat, which the caller chooses for that case. */
ALWAYS_INLINE uint32_t crowd_estimate(const mcp_asdf_t *robot, uint32_t x_hat)
{
    return robot->crowd.votes == 0U ? x_hat : q23_from_q30(robot->crowd.centre);
}

/* Returns the centre as Q32, which the test and eq. 8 need, with 2^32 - 1 for 1.0. */
ALWAYS_INLINE uint32_t crowd_fill_ratio(const mcp_asdf_t *robot)
{
    return robot->crowd.centre >> 30 == 0U ? robot->crowd.centre << 2 : UINT32_MAX;
}

/* Whether at least three bits of a set of senders are set: of three robots one that is wrong can be outvoted.
 * Robots whose ids are equal modulo 32 have the same bit. */
ALWAYS_INLINE bool has_three_senders(uint32_t senders)
{
    /* senders & (senders - 1) clears the lowest bit that is set. */
    const uint32_t without_one = senders & (senders - 1U);
    return (without_one & (without_one - 1U)) != 0U;
}

/* Whether the crowd is moving, as after a change of the floor: more than 7 of 8 recent moves of the centre
 * went the same way. Its centre then lags behind, and a robot that is ahead of it is not wrong. */
ALWAYS_INLINE bool is_crowd_moving(uint32_t trend)
{
    /* Below TREND_MOVING_DOWN, or as far below 2^16: added modulo 2^16, one comparison covers both. */
    return ((trend + TREND_MOVING_DOWN) & 0xFFFFU) < 2U * TREND_MOVING_DOWN;
}

/* Whether n black observations of t > 0 contradict the initial b_hat, if the crowd's centre r is right. Then
 * black is observed with probability p = b_hat r + (1 - b_hat)(1 - r). The test rejects if the share n / t
 * deviates from that by more than sqrt(12) standard deviations:
 *
 *     (n / t - p)^2 > 12 (v / t + (g spread)^2)
 *
 * Here v / t is the variance of n / t, for the larger v of p (1 - p) and n / t (1 - n / t); and g spread,
 * with g = |2 b_hat - 1|, is how far p may be off because r is. */
static bool robust_test_rejects(const mcp_asdf_t *robot)
{
    /* Shares are Q32, their squares Q64. 1 - x is 0U - x, or ~x, which is 2^-32 less and never out of range.
     */
    const uint32_t b_hat = robot->crowd.first, r = crowd_fill_ratio(robot); /* b_hat at the start */
    const uint32_t p = multiply_high(b_hat, r) + multiply_high(~b_hat, ~r); /* < 2^32 - 1 */
    const uint32_t share = quotient(robot->n, robot->t);                    /* n / t */
    const uint32_t deviation = share > p ? share - p : p - share;           /* |n / t - p| */
    const uint32_t variance_of_share = multiply_high(share, 0U - share);    /* <= 2^30, as is the next */
    const uint32_t variance_of_p = multiply_high(p, 0U - p);
    /* |2 b_hat - 1|: below 1/2 it is 1 - 2 b_hat; above, the 1 is 2^32, which is lost in 32 bits. */
    const uint32_t g = b_hat >> 31 == 0U ? 0U - 2U * b_hat : 2U * b_hat;
    const uint32_t g_spread = multiply_high(g, robot->crowd.spread << 2); /* the spread is Q30; < 2^30 */
    const uint64_t spread_limit = REJECTED_SIGMAS_SQUARED * multiply(g_spread, g_spread); /* < 12 2^60 */
    /* By how much the left side exceeds what the spread allows. It is used where it is positive: the rest
     * must be more than 12 v / t. */
    const uint64_t square = multiply(deviation, deviation), excess = square - spread_limit;
    /* Both sides are multiplied by t, so that v needs no division. t excess is formed as Q32: of the product
     * with the lower word of the Q64 only the upper word is kept. < 2^64 */
    const uint64_t t_excess =
        multiply(robot->t, high_word(excess)) + high_word(multiply(robot->t, low_word(excess)));
    const uint32_t variance = variance_of_share > variance_of_p ? variance_of_share : variance_of_p; /* v */
    return square > spread_limit && t_excess > multiply(REJECTED_SIGMAS_SQUARED, variance);
}

/* Run the robust filter at the end of a round, for t > 0. Returns the new b_hat as Q32, or 0 if it stays.
 * Counts the test if there is one.
 *
 * Nothing is tested while the crowd moves, nor before three senders have voted. Otherwise the initial b_hat
 * is tested: if it is rejected, b_hat is re-estimated from the centre; if not, b_hat is the initial one
 * again. So a robot that was misled by the crowd comes back. */
static uint32_t run_robust_filter(mcp_asdf_t *robot)
{
    mcp_asdf_crowd_t *const crowd = &robot->crowd;
    if (is_crowd_moving(crowd->trend)) {
        /* With half as many votes the gain is twice as large, and the centre follows faster. */
        if (crowd->votes >= 2U * VOTES_MIN_WHILE_MOVING) {
            crowd->votes = (uint16_t)(crowd->votes >> 1);
        }
        return 0;
    }
    if (!has_three_senders(crowd->voices)) {
        return 0;
    }
    ++robot->counters.tests;
    if (robust_test_rejects(robot)) {
        return reestimate(robot, crowd_fill_ratio(robot));
    }
    return robot->accuracy.b_hat != crowd->first ? crowd->first : 0U;
}

#else /* without it: calls of what follows disappear */
ALWAYS_INLINE void init_crowd(const mcp_asdf_t *robot, uint32_t b_hat) { (void)robot, (void)b_hat; }
ALWAYS_INLINE void update_crowd(const mcp_asdf_t *robot, uint8_t sender, uint32_t x_hat)
{
    (void)robot, (void)sender, (void)x_hat;
}
ALWAYS_INLINE uint32_t crowd_estimate(const mcp_asdf_t *robot, uint32_t x_hat) { return (void)robot, x_hat; }
ALWAYS_INLINE uint32_t run_robust_filter(const mcp_asdf_t *robot) { return (void)robot, 0; }
#endif
#endif
