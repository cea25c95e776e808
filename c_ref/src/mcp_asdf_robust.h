/* The robust filter, which is this project's own and not the paper's. Private: a part of mcp_asdf.c, which
 * gives it eq. 8. docs/robust.md explains it, docs/design.md, section 13, states every bit.
 * Every message is one vote, whatever its alpha. Votes move the centre of the crowd, a Huber M-estimate of
 * where the estimates lie, and the spread, the median of their distances from it: by stochastic approximation
 * with a gain of 4 / votes to 8 / votes, at least 2^-12. Against the centre a robot tests its own count. */
#ifndef MCP_ASDF_ROBUST_H
#define MCP_ASDF_ROBUST_H

#include "mcp_asdf.h"
#include "mcp_asdf_arithmetic.h"

static uint32_t reestimate(const mcp_asdf_t *robot, uint32_t a); /* eq. 8; 0 where a, as Q32, says nothing */

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

ALWAYS_INLINE void start_crowd(mcp_asdf_t *robot, uint32_t b_hat)
{
    robot->crowd.first = mcp_asdf_is_robust(robot->config) ? b_hat : 0U;
    robot->crowd.centre = MCP_ASDF_CENTRE_START;
    robot->crowd.spread = MCP_ASDF_SPREAD_MAX;
    robot->crowd.trend = MCP_ASDF_TREND_START;
}

/* What a vote moves: members of mcp_asdf_crowd_t. */
typedef struct {
    uint32_t centre, spread, votes, trend;
} middle_t;

/* The middle after a vote for x_hat, which is at most 1.0: the centre moves towards it, by at most a spread
 * times the gain and never beyond it. */
ALWAYS_INLINE middle_t middle_after(middle_t middle, uint32_t x_hat)
{
    const uint32_t centre = middle.centre, spread = middle.spread;
    const uint32_t votes = middle.votes + (middle.votes < MCP_ASDF_VOTES_MAX ? 1U : 0U);
    const uint32_t shift = 29U - leading_zeros(votes | VOTES_OF_MAX_GAIN); /* log2(votes) - 2: [3, 12] */
    const uint32_t change = shift_right(spread, shift + 1U);
    const uint32_t away = centre - (x_hat << 7); /* Q30, modulo 2^32: within 2^30 of 0 */
    const uint32_t up = 0U - (away >> 31);       /* all ones where the vote is above the centre, else 0 */
    const uint32_t distance = (away ^ up) - up;  /* abs(away) */
    uint32_t pull = distance, width = spread - change; /* change <= spread / 16 */
    if (distance > spread) {
        pull = spread;
        width = spread + change; /* < 2^29 */
        width = width < MCP_ASDF_SPREAD_MAX ? width : MCP_ASDF_SPREAD_MAX;
    } else {
        width = width > MCP_ASDF_SPREAD_MIN ? width : MCP_ASDF_SPREAD_MIN;
    }
    const uint32_t step = shift_right(pull, shift);
    const uint32_t way = step == 0U ? TREND_STEP_EVEN : up & TREND_STEP_UP; /* neither way without a move */
    const uint32_t trend = middle.trend - (middle.trend >> 8) + way;        /* < 2^16 */
    const middle_t moved = {centre - ((step ^ up) - up), width, votes, trend}; /* the centre modulo 2^32 */
    return moved;
}

HOT void vote(mcp_asdf_t *robot, uint8_t sender, uint32_t x_hat)
{
    mcp_asdf_crowd_t *const crowd = &robot->crowd;
    const middle_t middle = {crowd->centre, crowd->spread, crowd->votes, crowd->trend};
    const middle_t moved = middle_after(middle, x_hat);
    crowd->trend = (uint16_t)moved.trend;
    crowd->votes = (uint16_t)moved.votes;
    crowd->voices |= shift_left(1, sender & 31U);
    crowd->centre = moved.centre;
    crowd->spread = moved.spread;
}

/* The centre as x_hat; before the first vote `alone`. */
ALWAYS_INLINE uint32_t crowd_x(const mcp_asdf_t *robot, uint32_t alone)
{
    return robot->crowd.votes == 0U ? alone : robot->crowd.centre >> 7;
}

/* The centre as Q32, 1.0 as 2^32 - 1. */
ALWAYS_INLINE uint32_t crowd_mean(const mcp_asdf_t *robot)
{
    return robot->crowd.centre >> 30 == 0U ? robot->crowd.centre << 2 : UINT32_MAX;
}

/* Whether three robots were heard, of whom one that is wrong can be outvoted. Of robots whose ids are equal
 * modulo 32 one counts. */
ALWAYS_INLINE bool is_crowd(uint32_t voices)
{
    const uint32_t without_one = voices & (voices - 1U);
    return (without_one & (without_one - 1U)) != 0U;
}

/* Whether the crowd is on its way elsewhere, as after a change of the floor: more than 7 of 8 moves of the
 * centre went one way. It then lags behind, and a robot that runs ahead of it is not wrong. */
ALWAYS_INLINE bool is_moving(uint32_t trend)
{
    return ((trend + TREND_MOVING_DOWN) & 0xFFFFU) < 2U * TREND_MOVING_DOWN;
}

/* Whether n / t deviates by more than sqrt(12) standard deviations from what the first b_hat and the centre r
 * predict, for t > 0: D^2 > 12 (v / t + g^2 spread^2). D = n / t - p, p = b_hat r + (1 - b_hat)(1 - r),
 * g = 2 b_hat - 1, and v is the larger of p (1 - p) and n / t (1 - n / t). */
static bool deviates(const mcp_asdf_t *robot)
{
    const uint32_t b_hat = robot->crowd.first, r = crowd_mean(robot);
    const uint32_t p = multiply_high(b_hat, r) + multiply_high(~b_hat, ~r); /* Q32, as all here: < 2^32 - 1 */
    const uint32_t seen = quotient(robot->n, robot->t);
    const uint32_t d = seen > p ? seen - p : p - seen;
    const uint32_t v_seen = multiply_high(seen, 0U - seen), v_p = multiply_high(p, 0U - p); /* <= 2^30 */
    const uint32_t g = b_hat >> 31 == 0U ? 0U - 2U * b_hat : 2U * b_hat;           /* abs(2 b_hat - 1) */
    const uint32_t g_spread = multiply_high(g, robot->crowd.spread << 2);          /* < 2^30 */
    const uint64_t least = REJECTED_SIGMAS_SQUARED * multiply(g_spread, g_spread); /* Q64: < 12 2^60 */
    const uint64_t square = multiply(d, d), excess = square - least; /* used where it is positive */
    /* t excess as Q32: below 2^64 */
    const uint64_t above =
        multiply(robot->t, high_word(excess)) + high_word(multiply(robot->t, low_word(excess)));
    return square > least && above > multiply(REJECTED_SIGMAS_SQUARED, v_seen > v_p ? v_seen : v_p);
}

/* What b_hat becomes after a round, for t > 0, or 0: the first one, unless the test rejects it. So a robot
 * that was wronged by the crowd comes back. */
static uint32_t crowd_b_hat(mcp_asdf_t *robot)
{
    mcp_asdf_crowd_t *const crowd = &robot->crowd;
    if (is_moving(crowd->trend)) {
        if (crowd->votes >= 2U * VOTES_MIN_WHILE_MOVING) { /* twice the gain, test after test */
            crowd->votes = (uint16_t)(crowd->votes >> 1);
        }
        return 0;
    }
    if (!is_crowd(crowd->voices)) {
        return 0;
    }
    ++robot->counters.tests;
    if (deviates(robot)) {
        return reestimate(robot, crowd_mean(robot));
    }
    return robot->accuracy.b_hat != crowd->first ? crowd->first : 0U;
}

#else /* without it: calls of what follows disappear */
ALWAYS_INLINE void start_crowd(const mcp_asdf_t *robot, uint32_t b_hat) { (void)robot, (void)b_hat; }
ALWAYS_INLINE void vote(const mcp_asdf_t *robot, uint8_t id, uint32_t x) { (void)robot, (void)id, (void)x; }
ALWAYS_INLINE uint32_t crowd_x(const mcp_asdf_t *robot, uint32_t alone) { return (void)robot, alone; }
ALWAYS_INLINE uint32_t crowd_b_hat(const mcp_asdf_t *robot) { return (void)robot, 0; }
#endif
#endif
