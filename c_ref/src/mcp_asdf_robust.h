/* The robust filter, which is this project's own and not the paper's. Private: a part of mcp_asdf.c, which
 * provides eq. 8. docs/internals/robust.md explains the filter, docs/design.md, section 13, states every bit.
 *
 * A robot with this filter keeps no sums of rounds, but of each sender the latest estimate that had any
 * confidence; how much does not matter. Each round one estimate is a vote: the kept ones in turn, then the
 * robot's own, then the first again. A vote moves the robot's answer, the centre, towards its x_hat, by a
 * limited distance: a wrong one moves it no farther than another (a Huber M-estimate).
 *
 * Every filter_period rounds the robot tests its own observations against the estimates that it keeps. */
#ifndef MCP_ASDF_ROBUST_H
#define MCP_ASDF_ROBUST_H

#include "mcp_asdf.h"
#include "mcp_asdf_arithmetic.h"

/* Returns the new b_hat by eq. 8, as Q32, for x_bar as Q32; or 0 if x_bar carries no information. */
static uint32_t reestimate(const mcp_asdf_t *robot, uint32_t x_bar);

#if MCP_ASDF_WITH_ROBUST
/* Fewer votes count as so many: the gain is at most 2^-3. */
#define VOTES_OF_MAX_GAIN 32U
/* Steps from the median of the estimates to their Huber centre, which a further step hardly ever moves. */
#define HUBER_STEPS 3U
/* The test rejects beyond sqrt(12) standard deviations, where a sound robot is in 1 of 2000 tests. 32 bits,
 * as products with a dispersion need more than the 16 of a small int. */
#define REJECTED_SIGMAS_SQUARED UINT32_C(12)
/* A batch of observations counts 1/8 in the dispersion, all batches before it 7/8. */
#define DISPERSION_SHIFT 3U

/* Formats: x_hat is Q23, in units of 2^-23; estimates in slots are Q16; centre and spread of the votes are
 * Q30, centre and spread of the slots Q24; probabilities and shares of observations are Q32. */
ALWAYS_INLINE uint32_t q30_from_q23(uint32_t x_hat) { return x_hat << 7; }
ALWAYS_INLINE uint32_t q23_from_q30(uint32_t centre) { return centre >> 7; }
ALWAYS_INLINE uint32_t q23_from_q16(uint32_t estimate) { return estimate << 7; }
ALWAYS_INLINE uint32_t q24_from_q16(uint32_t estimate) { return estimate << 8; }
ALWAYS_INLINE uint32_t q32_from_q16(uint32_t estimate) { return estimate << 16; }
ALWAYS_INLINE uint32_t q32_from_q24(uint32_t estimate) { return estimate << 8; }

/* Returns |a - b|. */
ALWAYS_INLINE uint32_t distance_between(uint32_t a, uint32_t b) { return a > b ? a - b : b - a; }

/* Returns all ones if number is negative in two's complement, which its highest bit says, else 0. */
ALWAYS_INLINE uint32_t sign_mask(uint32_t number) { return 0U - (number >> 31); }

/* Returns -number if the mask is all ones, number if it is 0: without a branch, modulo 2^32. In two's
 * complement -number is ~number + 1: the XOR with all ones is the ~, and subtracting all ones adds 1. */
ALWAYS_INLINE uint32_t negate_if(uint32_t number, uint32_t mask) { return (number ^ mask) - mask; }

/* Set the members of a new robot's robust filter that are not 0, where the caller has set all to 0: the
 * centre of the votes is 1/2, the spread the largest and the dispersion the least one. The initial b_hat,
 * which the tests judge, is `b_hat` (Q32); with another filter it stays 0. */
ALWAYS_INLINE void init_robust_filter(mcp_asdf_t *robot, uint32_t b_hat)
{
    robot->robust.initial_b_hat = mcp_asdf_is_robust(robot->config) ? b_hat : 0U;
    robot->robust.centre = MCP_ASDF_CENTRE_START;
    robot->robust.spread = MCP_ASDF_SPREAD_MAX;
    robot->robust.dispersion = MCP_ASDF_DISPERSION_MIN;
}

/* ---- Receive: the latest estimate of each sender ---- */

/* Returns x_hat (Q23) as a slot keeps it: Q16, to nearest, and 1 - 2^-16 for 1.0, as a slot has 16 bits. */
ALWAYS_INLINE uint16_t slot_estimate(uint32_t x_hat)
{
    const uint32_t rounded = (x_hat + 64U) >> 7; /* 64 is half of 2^7: to nearest, halves up; <= 2^16 */
    return (uint16_t)(rounded < UINT16_MAX ? rounded : UINT16_MAX);
}

/* Keep a neighbour's x_hat (Q23) in the slot of its sender, in place of an earlier one. Senders whose ids are
 * equal modulo 32 share a slot. */
ALWAYS_INLINE void keep_estimate(mcp_asdf_t *robot, uint8_t sender, uint32_t x_hat)
{
    const uint32_t slot = (uint32_t)sender % MCP_ASDF_SLOTS;
    robot->received.estimates[slot] = slot_estimate(x_hat);
    robot->robust.filled_slots |= shift_left(1, slot);
}

/* ---- Settle: one vote ---- */

/* The members of mcp_asdf_robust_t that a vote changes, in full words. */
typedef struct {
    uint32_t centre, spread; /* Q30 */
    uint32_t votes;
} vote_statistics_t;

/* Returns the statistics after a vote for x_hat, Q23 and at most 1.0. The centre moves towards the vote by
 * gain times min(distance, spread). The spread grows by gain / 2 of itself if the vote is farther away, and
 * else shrinks by as much, so that it follows the median distance of the votes from the centre. The gain
 * falls from 1/8 to 1/128 as votes are counted (stochastic approximation). Centre, spread and distances are
 * Q30. */
ALWAYS_INLINE vote_statistics_t statistics_after_vote(vote_statistics_t statistics, uint32_t x_hat)
{
    const uint32_t centre = statistics.centre, spread = statistics.spread;
    const uint32_t votes = statistics.votes + (statistics.votes < MCP_ASDF_VOTES_MAX ? 1U : 0U);
    /* The gain is 2^-gain_shift. 31 - leading_zeros() is the index of the highest bit, log2(votes) rounded
     * down, and the shift is 2 less: 3 for 32 votes, 4 for 64. The OR gives fewer votes the highest bit
     * of 32. */
    const uint32_t gain_shift = 29U - leading_zeros(votes | VOTES_OF_MAX_GAIN); /* [3, 7] */
    const uint32_t spread_step = shift_right(spread, gain_shift + 1U);          /* <= spread / 16 */
    const uint32_t difference = centre - q30_from_q23(x_hat); /* within 2^30 of 0, in two's complement */
    const uint32_t is_up_mask = sign_mask(difference);        /* set if the vote is above the centre */
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
    const vote_statistics_t result = {centre - negate_if(step, is_up_mask), new_spread, votes};
    return result;
}

/* Returns the slot whose estimate is the next vote, or MCP_ASDF_SLOTS if the robot's own estimate is. That is
 * the first filled slot from `turn` on. If there is none, it is the robot's own estimate; and if this has no
 * confidence, the first of all filled slots. `filled_slots` is a mask of 32 bits and not 0. */
ALWAYS_INLINE uint32_t next_slot(uint32_t filled_slots, uint32_t turn, bool has_confidence)
{
    uint32_t remaining_slots =
        turn < MCP_ASDF_SLOTS ? filled_slots & shift_left(UINT32_MAX, turn) : 0U; /* from `turn` on */
    if (remaining_slots == 0U) {
        if (has_confidence) {
            return MCP_ASDF_SLOTS;
        }
        remaining_slots = filled_slots;
    }
    /* slots & -slots is the lowest bit that is set, alone; 31 - leading_zeros() is its index. */
    const uint32_t lowest_slot_bit = remaining_slots & (0U - remaining_slots);
    return 31U - leading_zeros(lowest_slot_bit);
}

/* Count one estimate as a vote, at the end of a round: the next slot's or the robot's own, which is left out
 * while its alpha is 0. The vote moves the centre, changes the spread, is counted in `votes`, and the turn
 * passes on. Nothing happens before the first message has filled a slot. */
HOT void take_vote(mcp_asdf_t *robot)
{
    mcp_asdf_robust_t *const robust = &robot->robust;
    if (robust->filled_slots == 0U) {
        return;
    }
    const uint32_t alpha_mantissa = robot->alpha >> 8; /* 0 if alpha is, whatever the shift below it */
    const uint32_t slot = next_slot(robust->filled_slots, robust->turn, alpha_mantissa != 0U);
    const bool is_own = slot >= MCP_ASDF_SLOTS; /* next_slot() returns MCP_ASDF_SLOTS then */
    const uint32_t x_hat = is_own ? robot->x_hat : q23_from_q16(robot->received.estimates[slot]);
    const vote_statistics_t before = {robust->centre, robust->spread, robust->votes};
    const vote_statistics_t after = statistics_after_vote(before, x_hat);
    robust->turn = is_own ? 0U : (uint8_t)(slot + 1U);
    robust->centre = after.centre;
    robust->spread = after.spread;
    robust->votes = (uint16_t)after.votes;
}

/* Returns the centre of the votes as Q23; before the first vote x_hat, which the caller chooses for that
 * case. */
ALWAYS_INLINE uint32_t robust_estimate(const mcp_asdf_t *robot, uint32_t x_hat)
{
    return robot->robust.votes == 0U ? x_hat : q23_from_q30(robot->robust.centre);
}

/* ---- The test ---- */

/* Begin a new batch of observations: keep t and n, from which its observations are counted. Without the
 * robust filter nothing happens. */
ALWAYS_INLINE void begin_batch(mcp_asdf_t *robot)
{
    if (mcp_asdf_is_robust(robot->config)) {
        robot->robust.batch_t = robot->t;
        robot->robust.batch_n = robot->n;
    }
}

/* Returns factor times half_word. By multiply(), as avr-gcc calls another helper of its library where it
 * knows that both have 16 bits. */
ALWAYS_INLINE uint32_t times_half_word(uint32_t factor, uint16_t half_word)
{
    return low_word(multiply(factor, half_word));
}

/* Returns ratio times variance, below 2^63, as Q22 and rounded down, for a ratio below 2^20 (Q8) and a
 * variance below 2^61 (Q32). The whole product, a Q40, may have more than 64 bits. So it is formed from the
 * two words of the variance, and shifted by 40 - 22 = 18 bits to the right: the upper word by 32 - 18 to the
 * left. */
ALWAYS_INLINE uint64_t ratio_times_variance(uint32_t ratio, uint64_t variance)
{
    const uint64_t upper_part = multiply(ratio, high_word(variance)) << 14;
    const uint64_t lower_part = multiply(ratio, low_word(variance)) >> 18;
    return upper_part + lower_part;
}

/* Returns (black - count share)^2 as Q22, for the share as Q32: the square of how far the number of black
 * observations of a batch is from the expected one. Where they differ by 2^21 or more, the result is the
 * largest one, which is beyond every limit of end_batch(). */
ALWAYS_INLINE uint64_t square_of_deviation(uint32_t black, uint32_t count, uint32_t share)
{
    const uint64_t observed = join(black, 0), expected = multiply(count, share); /* Q32: < 2^63 */
    const uint64_t deviation = observed > expected ? observed - expected : expected - observed;
    const uint64_t short_deviation = deviation >> 21; /* Q11, so that its square, Q22, has 64 bits */
    const uint32_t limited_deviation =
        high_word(short_deviation) == 0U ? low_word(short_deviation) : UINT32_MAX;
    return multiply(limited_deviation, limited_deviation);
}

/* End a batch of observations: let it enter the dispersion, and begin the next batch. `share` is n / t, Q32.
 *
 * Of the batch's `count` observations, count share are expected to be black. If they are independent, the
 * square of the deviation from that is on average the variance, count share (1 - share). It is larger if the
 * robot observes a tile several times: the dispersion says how many times (the phi of overdispersed binomial
 * models). It is a moving average of the ratio deviation^2 / variance: the batch that ends has a weight of
 * 1/8, the average before it 7/8. A ratio above 12 times the dispersion counts as 12 times: it comes from a
 * change of the floor.
 *
 * Without observations in the batch, or while the share is 0, the dispersion stays as it is. It is at least
 * MCP_ASDF_DISPERSION_MIN, 1, and at most what its 16 bits hold. Dispersion and ratios are Q8, the variance
 * is Q32, and squares are Q22. */
static void end_batch(mcp_asdf_t *robot, uint32_t share)
{
    mcp_asdf_robust_t *const robust = &robot->robust;
    const uint32_t count = robot->t - robust->batch_t; /* observations in the batch */
    const uint32_t black = robot->n - robust->batch_n; /* the black ones among them */
    const uint64_t variance = multiply(count, multiply_high(share, one_minus(share)));           /* < 2^61 */
    const uint32_t largest_ratio = times_half_word(REJECTED_SIGMAS_SQUARED, robust->dispersion); /* < 2^20 */
    /* The square of the deviation at which the ratio is the largest. It is 0 where the variance is. */
    const uint64_t largest_square =
        ratio_times_variance(largest_ratio, variance); /* <= 12 2^8 2^29: < 2^63 */
    const uint64_t square = square_of_deviation(black, count, share);
    begin_batch(robot);
    if (largest_square == 0U) {
        return;
    }
    /* quotient() takes no fraction above 1, but square / variance may be above 1. As largest_square /
     * variance is the largest ratio, the ratio is the largest ratio times square / largest_square. */
    const uint64_t limited_square = square < largest_square ? square : largest_square;
    const uint32_t fraction_of_largest = quotient(limited_square, largest_square); /* Q32 */
    const uint32_t ratio = multiply_high(largest_ratio, fraction_of_largest);      /* < 2^20 */
    const uint32_t old_weight = (UINT32_C(1) << DISPERSION_SHIFT) - 1U; /* 7, where a batch has 1 */
    const uint32_t weighted_sum = times_half_word(old_weight, robust->dispersion) + ratio; /* of weight 8 */
    const uint32_t average = weighted_sum >> DISPERSION_SHIFT;                             /* rounded down */
    const uint32_t limited_average = average < UINT16_MAX ? average : UINT16_MAX;
    robust->dispersion =
        (uint16_t)(limited_average > MCP_ASDF_DISPERSION_MIN ? limited_average : MCP_ASDF_DISPERSION_MIN);
}

/* Copy the estimates of all filled slots to `sorted`, in ascending order. Returns how many there are. */
static uint32_t sort_estimates(const mcp_asdf_t *robot, uint16_t sorted[MCP_ASDF_SLOTS])
{
    uint32_t count = 0;
    for (uint32_t slot = 0; slot < MCP_ASDF_SLOTS; ++slot) { /* at most 32 turns */
        /* Nothing is sorted into this entry yet, as count <= slot. It becomes 0 so that all are written. */
        sorted[slot] = 0;
        if ((robot->robust.filled_slots & shift_left(1, slot)) != 0U) {
            const uint16_t estimate = robot->received.estimates[slot];
            uint32_t i = count++; /* the first free entry; the estimates before it are sorted */
            /* Larger estimates move up by one entry, until there is room for this one. */
            for (; i > 0U && sorted[i - 1U] > estimate; --i) { /* at most 31 turns, 496 in all */
                sorted[i] = sorted[i - 1U];
            }
            sorted[i] = estimate;
        }
    }
    return count;
}

/* Returns the median distance of sorted estimates (Q16) from their median (Q24), as Q24 and within the limits
 * of a spread. Sorted estimates that are passed from the middle outwards, each time the nearer of the next
 * ones on either side, are passed in the order of their distances. So the distance with the rank of the
 * median is found without sorting the distances. */
static uint32_t median_distance(const uint16_t *sorted, uint32_t count, uint32_t median)
{
    uint32_t below = count / 2U, above = below, distance = 0, last_distance = 0;
    /* Estimates `below` to `above` - 1 are passed: none at first. With an odd number the first one that is
     * passed is the median itself, at a distance of 0. A side with no more estimates is farther than any. */
    for (uint32_t rank = 0; rank <= count / 2U; ++rank) { /* at most 17 turns */
        const uint32_t distance_below = below > 0U ? median - q24_from_q16(sorted[below - 1U]) : UINT32_MAX;
        const uint32_t distance_above = above < count ? q24_from_q16(sorted[above]) - median : UINT32_MAX;
        last_distance = distance;
        /* That an estimate is left below is asked again for analysers: a distance of UINT32_MAX is never
         * less. */
        if (below > 0U && distance_below < distance_above) {
            distance = distance_below;
            --below;
        } else {
            distance = distance_above;
            ++above;
        }
    }
    /* An even number of estimates has two in the middle: the mean of their distances. */
    distance = count % 2U == 0U ? (distance + last_distance) / 2U : distance;
    const uint32_t largest = MCP_ASDF_SPREAD_MAX >> 6, least = MCP_ASDF_SPREAD_MIN >> 6; /* Q30 to Q24 */
    distance = distance < largest ? distance : largest;
    return distance > least ? distance : least;
}

/* Returns the centre of the estimates (Q16) after one step of Newton's method from `centre`, by Huber's
 * M-estimator. That is the point at which the balance is 0: the sum of the estimates' differences from it,
 * each limited to `spread` in either direction. A step is the balance divided by the number of estimates
 * whose difference is not limited, or by 1 if there is none. Centre and spread are Q24. */
static uint32_t huber_step(const uint16_t *estimates, uint32_t count, uint32_t centre, uint32_t spread)
{
    /* An estimate that is limited to these has a limited difference from the centre. No estimate is below 0,
     * so the lower limit need not be, either. */
    const uint32_t lower_limit = centre > spread ? centre - spread : 0U, upper_limit = centre + spread;
    uint32_t sum = 0, inside = 0;          /* sum: <= 32 upper limits < 2^30 */
    for (uint32_t i = 0; i < count; ++i) { /* at most 32 turns */
        const uint32_t estimate = q24_from_q16(estimates[i]);
        if (estimate < lower_limit) {
            sum += lower_limit;
        } else if (estimate > upper_limit) {
            sum += upper_limit;
        } else {
            sum += estimate;
            ++inside;
        }
    }
    const uint32_t sum_at_centre = count * centre; /* what the sum would be with a balance of 0: < 2^29 */
    const uint32_t balance = distance_between(sum, sum_at_centre); /* without its sign */
    /* `inside` as Q24, as the balance is; <= 2^29. The quotient is a Q32, and the step at most 1.0. */
    const uint32_t divisor = (inside > 0U ? inside : 1U) << 24;
    const uint32_t limited_balance = balance < divisor ? balance : divisor;
    const uint32_t step = quotient(limited_balance, divisor) >> 8; /* Q24 */
    const uint32_t below = centre > step ? centre - step : 0U;
    const uint32_t above = centre + step, largest = q24_from_q16(UINT16_MAX); /* of all estimates */
    const uint32_t limited_above = above < largest ? above : largest;
    /* A sum that is too small comes from estimates below the centre. */
    return sum < sum_at_centre ? below : limited_above;
}

/* Returns the probability that a robot observes black where the fill ratio is x, for its initial b_hat: b_hat
 * x + (1 - b_hat)(1 - x), all as Q32. 1 - x is ~x here, which is 2^-32 less. */
ALWAYS_INLINE uint32_t probability_of_black(const mcp_asdf_t *robot, uint32_t x)
{
    const uint32_t b_hat = robot->robust.initial_b_hat;
    return multiply_high(b_hat, x) + multiply_high(~b_hat, ~x); /* < 2^32 - 1 */
}

/* Returns factor times number, a Q64, as Q32 and rounded down: < 2^64. The product with the lower word of
 * `number` counts with its upper word only. */
ALWAYS_INLINE uint64_t times_q64(uint32_t factor, uint64_t number)
{
    return multiply(factor, high_word(number)) + high_word(multiply(factor, low_word(number)));
}

/* Returns p (1 - p), at most 2^30, for a probability or a share p; both are Q32. */
ALWAYS_INLINE uint32_t variance_of_observation(uint32_t p) { return multiply_high(p, one_minus(p)); }

/* Returns |2 b_hat - 1| as Q32: by how much probability_of_black() changes if x changes by 1. */
ALWAYS_INLINE uint32_t slope_of_probability(uint32_t b_hat)
{
    /* For b_hat above 1/2 the 1 is 2^32, which is lost in 32 bits. */
    return b_hat < UINT32_C(1) << 31 ? one_minus(2U * b_hat) : 2U * b_hat;
}

/* Whether the share n / t of black observations, t > 0, contradicts the initial b_hat, if the fill ratio is
 * `centre`. Then black is observed with the probability p of probability_of_black(). The test rejects if the
 * share deviates from p by more than sqrt(12) standard deviations:
 *
 *     (n / t - p)^2 > 12 (dispersion v / t + (g spread)^2)
 *
 * Here dispersion v / t is the variance of n / t, where v is the variance of one observation: the larger of p
 * (1 - p) and n / t (1 - n / t). And g spread, with g = |2 b_hat - 1|, is how far p may be off because the
 * centre is. The dispersion is Q8, squares are Q64, and all else is Q32. */
static bool robust_test_rejects(const mcp_asdf_t *robot, uint32_t share, uint32_t centre, uint32_t spread)
{
    const uint32_t p = probability_of_black(robot, centre);
    const uint32_t deviation = distance_between(share, p);
    const uint64_t square = multiply(deviation, deviation);
    /* g spread: < 2^30, as a spread is at most 1/4 */
    const uint32_t uncertainty_of_p =
        multiply_high(slope_of_probability(robot->robust.initial_b_hat), spread);
    const uint64_t spread_limit =
        REJECTED_SIGMAS_SQUARED * multiply(uncertainty_of_p, uncertainty_of_p); /* < 12 2^60 */
    if (square <= spread_limit) {
        return false;
    }
    const uint32_t variance_of_share = variance_of_observation(share);
    const uint32_t variance_of_p = variance_of_observation(p);
    const uint32_t variance = variance_of_share > variance_of_p ? variance_of_share : variance_of_p; /* v */
    /* Both sides are multiplied by t, so that v needs no division. */
    const uint64_t t_excess = times_q64(robot->t, square - spread_limit);
    /* 12 dispersion v: < 2^20 2^30, a Q40 before the shift and then a Q32, rounded down */
    const uint32_t dispersion_limit =
        times_half_word(REJECTED_SIGMAS_SQUARED, robot->robust.dispersion); /* < 2^20 */
    const uint64_t t_variance_limit = multiply(dispersion_limit, variance) >> 8;
    return t_excess > t_variance_limit;
}

/* Whether more than 2/5 of the estimates support the robot, whose share of black observations is `share`. An
 * estimate predicts a share of black, by probability_of_black(), and so does the centre of all estimates. An
 * estimate whose prediction is nearer to the robot's own share than to the centre's prediction supports the
 * robot. Robots with such support are a party of their own, and not outliers: nothing can be said about who
 * is right. Share and centre are Q32. */
static bool is_supported(const mcp_asdf_t *robot, const uint16_t *estimates, uint32_t count, uint32_t share,
                         uint32_t centre)
{
    const uint32_t p_of_centre = probability_of_black(robot, centre);
    uint32_t supporters = 0;
    for (uint32_t i = 0; i < count; ++i) { /* at most 32 turns */
        const uint32_t p_of_estimate = probability_of_black(robot, q32_from_q16(estimates[i]));
        const uint32_t distance_from_robot = distance_between(p_of_estimate, share);
        const uint32_t distance_from_centre = distance_between(p_of_estimate, p_of_centre);
        const bool supports_robot = distance_from_robot < distance_from_centre;
        supporters += supports_robot ? 1U : 0U;
    }
    return 5U * supporters > 2U * count; /* supporters / count > 2 / 5 */
}

/* Run the robust filter at the end of a round, for t > 0: the batch of observations ends, and the initial
 * b_hat is tested, which is counted. The test compares the robot's share of black observations with the
 * centre of the kept estimates. That is their median, moved by three Huber steps towards a mean in which no
 * estimate counts by more than a limited distance. Returns b_hat after that as Q32, or 0 if it stays as it
 * is:
 *
 *   - with fewer than five estimates it stays, and there is no test;
 *   - if robust_test_rejects() the initial b_hat, and the robot is not supported by others (is_supported()),
 *     it is re-estimated from the centre of the estimates;
 *   - else it is the initial b_hat, so that a robot that was misled by the others comes back. */
static uint32_t run_robust_filter(mcp_asdf_t *robot)
{
    uint16_t sorted[MCP_ASDF_SLOTS];
    const uint32_t share = quotient(robot->n, robot->t); /* n / t */
    end_batch(robot, share);
    const uint32_t count = sort_estimates(robot, sorted);
    if (count < MCP_ASDF_TESTED_ESTIMATES_MIN) {
        return 0;
    }
    /* The median is the mean of the two estimates in the middle or, if the count is odd, of the middle one
     * with itself. Their sum is a Q16: shifted by 8 it would be a Q24, and shifted by 7 it is half of that.
     */
    const uint32_t median = ((uint32_t)sorted[(count - 1U) / 2U] + sorted[count / 2U]) << 7;
    const uint32_t spread = median_distance(sorted, count, median); /* Q24, as the median and the centre */
    uint32_t centre = median;
    for (uint32_t i = 0; i < HUBER_STEPS; ++i) { /* at most 3 turns */
        centre = huber_step(sorted, count, centre, spread);
    }
    ++robot->counters.tests;
    if (robust_test_rejects(robot, share, q32_from_q24(centre), q32_from_q24(spread)) &&
        !is_supported(robot, sorted, count, share, q32_from_q24(centre))) {
        return reestimate(robot, q32_from_q24(centre));
    }
    const uint32_t initial_b_hat = robot->robust.initial_b_hat;
    return robot->accuracy.b_hat != initial_b_hat ? initial_b_hat : 0U;
}

#else /* without it: calls of what follows disappear */
ALWAYS_INLINE void init_robust_filter(const mcp_asdf_t *robot, uint32_t b_hat) { (void)robot, (void)b_hat; }
ALWAYS_INLINE void keep_estimate(const mcp_asdf_t *robot, uint8_t sender, uint32_t x_hat)
{
    (void)robot, (void)sender, (void)x_hat;
}
ALWAYS_INLINE void take_vote(const mcp_asdf_t *robot) { (void)robot; }
ALWAYS_INLINE uint32_t robust_estimate(const mcp_asdf_t *robot, uint32_t x_hat) { return (void)robot, x_hat; }
ALWAYS_INLINE void begin_batch(const mcp_asdf_t *robot) { (void)robot; }
ALWAYS_INLINE uint32_t run_robust_filter(const mcp_asdf_t *robot) { return (void)robot, 0; }
#endif
#endif
