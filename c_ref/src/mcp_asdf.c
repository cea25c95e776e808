/* The method of MCP-ASDF, in the order of the paper. mcp_asdf.h is the manual, docs/design.md the
 * specification of every bit. Words, products and quotients are those of mcp_asdf_arithmetic.h; "Q32" is a
 * number in units of 2^-32, "[a, b)" the range of the integer on its left.
 *
 * A sum or product below cannot wrap unless its comment says that it may. A range in a comment says why.
 */
#include "mcp_asdf.h"

#include <stddef.h>

#include "mcp_asdf_arithmetic.h"
#include "mcp_asdf_robust.h"

#define Q32_HALF (UINT32_C(1) << 31)
/* |2 p - 1| = 2^-12 as Q32. A probability p that is closer to 1/2 carries no information. */
#define INFORMATIVE_G (UINT32_C(1) << 20)
#define TABLE_MAGIC UINT32_C(0x4D435400)     /* its last byte is q */
#define TABLE_OMEGA_MAX UINT32_C(3865470566) /* 0.9 as Q32 */
#define THRESHOLD_ONE (UINT32_C(1) << 26)    /* thresholds k_m are Q26 in 32 bits: below 64 */

/* The exponents of alpha count the bits behind the binary point of these numbers. */
#define ALPHA_FRACTION_BITS 24U    /* of a unit of alpha */
#define WEIGHT_FRACTION_BITS 30U   /* of accuracy->common and accuracy->rare, before their shifts */
#define QUOTIENT_FRACTION_BITS 24U /* of a result of divide_24() */
#define BITS_BELOW_MANTISSA 40U    /* bits of a 64-bit number behind the 24 of its mantissa */

/* The filters that are built. */
#define FILTER_FIRST ((uint32_t)(MCP_ASDF_WITH_ASDF ? MCP_ASDF_ADAPTIVE : MCP_ASDF_ROBUST))
#define FILTER_LAST ((uint32_t)(MCP_ASDF_WITH_ROBUST ? MCP_ASDF_ROBUST : MCP_ASDF_OFF))

/* Bounds that the comments rely on, as far as the compiler can see them. */
#define ASSERT(name, condition) typedef char assert_##name[(condition) ? 1 : -1]
ASSERT(enough_senders, sizeof(((mcp_asdf_t *)0)->heard) * 8 == MCP_ASDF_MAX_ID + 1);
ASSERT(size_is_stated, sizeof(mcp_asdf_t) <= MCP_ASDF_SIZE_MAX);
ASSERT(t_is_a_word, MCP_ASDF_MEMORY_MAX <= Q32_HALF);
ASSERT(halves_mirror, MCP_ASDF_MEMORY_MIN % 4 == 0);
ASSERT(b_hat_mirrors, MCP_ASDF_B_HAT_MIN + MCP_ASDF_B_HAT_MAX == 0); /* modulo 2^32 */

/* ---- The local estimate: eq. 3 and 4 ---- */

/* Returns (g / p)^2 as Q30, for two numbers in [2^31, 2^32) of one format. Both are halved for divide_24(),
 * which takes a divisor of at most 2^31; their quotient stays g / p. */
static uint32_t square_of_ratio(uint32_t g, uint32_t p)
{
    const uint32_t ratio = divide_24(g >> 1, p >> 1) << 7; /* Q24 to Q31: (2^30, 2^32) */
    return multiply_high(ratio, ratio);                    /* Q31 Q31 = Q62, to Q30: [2^28, 2^32) */
}

/* Assume an accuracy b_hat, as Q32 from MCP_ASDF_B_HAT_MIN to MCP_ASDF_B_HAT_MAX, and compute what eq. 3 and
 * 4 need of it, so that an observation needs no division for it: the probability c that the sensor is wrong,
 * with colours exchanged if b_hat is below 1/2, and with g = 1 - 2c the weights (g / (1 - c))^2 of a reading
 * of the common colour and (g / c)^2 of one of the rare colour. They are stored in robot->accuracy, the
 * weights with the shifts that give their units. For a b_hat so close to 1/2 that readings carry no
 * information, the largest c, 2^32 - 1, is stored in place of c. */
static void set_b_hat(mcp_asdf_t *robot, uint32_t b_hat)
{
    mcp_asdf_accuracy_t *const accuracy = &robot->accuracy;
    const uint32_t c = b_hat < Q32_HALF ? b_hat : one_minus(b_hat); /* min(b_hat, 1 - b_hat): [2^12, 2^31] */
    const uint32_t g = one_minus(2U * c);                           /* [0, 2^32 - 2^13] */
    const uint32_t g_shift = leading_zeros(g);                      /* [0, 31] */
    const uint32_t c_shift = leading_zeros(c);                      /* [0, 19] */
    const bool has_information = g >= INFORMATIVE_G;
    accuracy->b_hat = b_hat;
    accuracy->c = has_information ? c : UINT32_MAX;
    /* Both sides of a ratio are shifted until their highest bit is set, so that its quotient has as many
     * significant bits as it can; 1 - c is at least 1/2 and needs no shift. Each weight is too large then by
     * 2^(2 g_shift), and the weight of the rare colour too small by 2^(2 c_shift). confidence_at_end() makes
     * up for this by means of g_shift and rare_shift. */
    const uint32_t shifted_g = shift_left(g, g_shift);
    accuracy->common = square_of_ratio(shifted_g, one_minus(c));
    accuracy->rare = square_of_ratio(shifted_g, shift_left(c, c_shift));
    accuracy->g_shift = g_shift;
    accuracy->rare_shift = 2U * c_shift;
}

/* A local estimate: x_hat as Q23, and alpha as an alpha word. */
typedef struct {
    uint32_t x_hat, alpha;
} estimate_t;

/* A confidence of mantissa 2^exponent units of 2^-24. The mantissa is in [2^23, 2^24), the exponent at least
 * -22, and in two's complement if it is negative. */
typedef struct {
    uint32_t mantissa, exponent;
} confidence_t;

/* Converts a confidence to an alpha word: mantissa in bits 31 to 8, shift in bits 4 to 0. Both arguments are
 * as in confidence_t, which has a wider exponent than the word has a shift: a negative one loses the bits
 * below a unit of 2^-24, and one above 31 gives the largest alpha. */
HOT uint32_t alpha_word_from_mantissa(uint32_t mantissa, uint32_t exponent)
{
    const bool is_negative = exponent >> 31 != 0U;
    if (is_negative) {
        /* 0U - exponent is the amount of the negative exponent, at most 22; the mask keeps the shift in its
         * range where memory is damaged. */
        const uint32_t lost_bits = (0U - exponent) & 31U;
        return shift_right(mantissa, lost_bits) << 8; /* with a shift of 0 */
    }
    return exponent <= ALPHA_SHIFT_MAX ? (mantissa << 8) | exponent : ALPHA_MAX;
}

/* Returns `sum`, which is above 0, as a confidence: the 24 bits from its highest bit down are the mantissa,
 * and bits below these are lost. The sum is shifted left until bit 63 is its highest bit: first by a whole
 * word if the upper one is 0, and then by the rest. `exponent` is the exponent of a sum that needs no shift.
 * That of the result is less by the number of bits of the shift. */
ALWAYS_INLINE confidence_t confidence_of_sum(uint64_t sum, uint32_t exponent)
{
    if (high_word(sum) == 0U) {
        sum = join(low_word(sum), 0); /* shifted left by 32 */
        exponent -= 32U;
    }
    const uint32_t sum_shift = leading_zeros(high_word(sum));
    const uint32_t highest_bits = shifted_high_word(sum, sum_shift);
    const confidence_t confidence = {highest_bits >> 8, exponent - sum_shift}; /* 32 bits to 24 */
    return confidence;
}

/* Returns alpha where x_hat is 0 or 1 (eq. 4 of the paper, first two cases), that is
 *
 *     rare_observations (g / c)^2 + (t - rare_observations) (g / (1 - c))^2
 *
 * after t observations, rare_observations of them of the rarer colour, with the probability c that the sensor
 * is wrong and g = 1 - 2c. The squares are the weights that set_b_hat() has computed, as integers:
 *
 *     accuracy->common   (g / (1 - c))^2 in units of 2^(-30 - 2 g_shift)
 *     accuracy->rare     (g / c)^2 in units of 2^(-30 - 2 g_shift + rare_shift)
 *
 * with accuracy->rare_shift, and g_shift at most 31. */
ALWAYS_INLINE confidence_t confidence_at_end(uint32_t t, uint32_t rare_observations, uint32_t g_shift,
                                             const mcp_asdf_accuracy_t *accuracy)
{
    uint64_t sum = multiply(t - rare_observations, accuracy->common); /* < 2^63 */
    /* The exponent of a sum whose highest bit is bit 63, by what a unit of its mantissa is worth:
     *
     *     BITS_BELOW_MANTISSA     the mantissa leaves out 40 bits of the 64
     *     -WEIGHT_FRACTION_BITS   units of the weights, and so of the sum: 2^-30,
     *     -2 g_shift              and 2^(-2 g_shift)
     *     ALPHA_FRACTION_BITS     as alpha counts units of 2^-24
     *
     * It may be negative, in two's complement. */
    uint32_t exponent = BITS_BELOW_MANTISSA - WEIGHT_FRACTION_BITS + ALPHA_FRACTION_BITS - 2U * g_shift;
    if (rare_observations != 0U) {
        /* The rare colour's weight has units 2^rare_shift times as large: the sum changes to these. */
        sum = multiply(rare_observations, accuracy->rare) +
              shift_right_64(sum, accuracy->rare_shift); /* < 2^64 */
        exponent += accuracy->rare_shift;
    }
    return confidence_of_sum(sum, exponent);
}

/* Returns alpha where x_hat is between 0 and 1 (eq. 4 of the paper, last case), that is
 *
 *     g^2 t / (p (1 - p))
 *
 * after t observations, with the share p of the rarer colour among them and g = 1 - 2c, where c is the
 * probability that the sensor is wrong. The arguments are t, p t and g t, shifted left so that products and
 * quotients keep many significant bits. The exponent of the result takes the shifts back.
 *   total     t 2^shift                    [2^31, 2^32)
 *   rarer     p t 2^shift                  [2^11, total / 2]
 *   g_total   g t 2^(shift + g_shift)      [2^30, 2^32)
 *   g_shift   by how much g was shifted    at most 31
 *   shift     by how much t was shifted    at most 31
 *
 * With t^2 above and below, alpha = (g t)^2 t / (p t (1 - p) t), a dividend by a divisor. The dividend is a
 * product of three words: each multiply_high() leaves out the lower 32 bits, and the upper word of the three
 * is what is left. The divisor keeps both of its words. */
ALWAYS_INLINE confidence_t confidence_inside(uint32_t total, uint32_t rarer, uint32_t g_total,
                                             uint32_t g_shift, uint32_t shift)
{
    const uint32_t square = multiply_high(g_total, g_total);
    const uint32_t dividend = multiply_high(square, total);  /* [2^27, 2^32) */
    const uint64_t divisor = multiply(rarer, total - rarer); /* [2^41, 2^62] */
    /* Both are shifted until their highest bit is set, and of the divisor the upper word is taken, so that
     * the quotient has as many significant bits as it can. */
    const uint32_t dividend_shift = leading_zeros(dividend);
    const uint32_t divisor_shift = leading_zeros(high_word(divisor));
    /* The exponent takes back what was left out or shifted:
     *
     *     64                        bits left out of the dividend
     *     -32                       bits left out of the divisor
     *     -QUOTIENT_FRACTION_BITS   bits of divide_24()'s result behind its binary point
     *     ALPHA_FRACTION_BITS       as alpha counts units of 2^-24
     *     -2 g_shift                the dividend has g twice
     *     -shift                    the dividend has t three times, the divisor twice
     *
     * and then the two shifts above. It may be negative, in two's complement. */
    uint32_t exponent = 64U - 32U - QUOTIENT_FRACTION_BITS + ALPHA_FRACTION_BITS - 2U * g_shift - shift;
    exponent = exponent + divisor_shift - dividend_shift;
    /* divide_24() takes divisors up to 2^31: both sides are halved, which costs their lowest bits. */
    const uint32_t shifted_divisor = shifted_high_word(divisor, divisor_shift);
    uint32_t mantissa = divide_24(shift_left(dividend, dividend_shift) >> 1, shifted_divisor >> 1);
    /* The quotient is in [2^23, 2^25), a mantissa below 2^24: a 25th bit goes into the exponent. */
    const uint32_t excess_bit = (mantissa >> 24) & 1U;
    mantissa >>= excess_bit; /* a shift by at most 1 */
    exponent += excess_bit;
    const confidence_t alpha = {mantissa, exponent};
    return alpha;
}

/* Returns the local estimate after n black observations of t > 0, with a sensor of this accuracy: x_hat, the
 * share of black tiles that explains them best (eq. 3 of the paper), as Q23, and as an alpha word its
 * confidence alpha, the Fisher information of x_hat (eq. 4).
 *
 * White and black are mirror images, and so are b_hat and 1 - b_hat. So only one case is computed, and the
 * result is mirrored in the others: how much of the floor has the rarer colour, if a share p of the
 * observations has it and the sensor is wrong with probability c = min(b_hat, 1 - b_hat). That is
 *
 *     x = (p - c) / (1 - 2c), or 0 if p is at most c.
 *
 * Alpha has an equation for each of these two cases: confidence_inside() and confidence_at_end().
 *
 * A sensor that is as often right as wrong has no information, which a `c` of 2^32 - 1 says: then x_hat is
 * 1/2 and alpha 0. */
HOT estimate_t estimate(uint32_t t, uint32_t n, const mcp_asdf_accuracy_t *accuracy)
{
    const uint32_t g_shift = accuracy->g_shift & 31U; /* whatever damaged memory holds */
    const uint32_t white = t - n;                     /* observations, as n are black */
    const uint32_t rare_observations = n < white ? n : white;
    /* Numbers of observations are multiplied by 2^shift, with which t fills 32 bits. */
    const uint32_t shift = leading_zeros(t);
    const uint32_t total = shift_left(t, shift);                 /* t: [2^31, 2^32) */
    const uint32_t rarer = shift_left(rare_observations, shift); /* p t: at most total / 2 */
    /* On a floor without the rarer colour the sensor would show it so often, by its errors. */
    const uint32_t errors = multiply_high(accuracy->c, total); /* c t */
    uint32_t x = 0;
    confidence_t alpha;
    if (rarer <= errors) { /* always so without information, where c is 2^32 - 1 */
        if (accuracy->c == UINT32_MAX) {
            const estimate_t no_information = {MCP_ASDF_HALF, 0};
            return no_information;
        }
        alpha = confidence_at_end(t, rare_observations, g_shift, accuracy);
    } else {
        /* x = (p t - c t) / (g t) with g = 1 - 2c. Both are shifted by g_shift, which leaves their quotient
         * as it is, so that the divisor has 31 or 32 bits. */
        const uint32_t g_total = shift_left(total - 2U * errors, g_shift); /* g t: [2^30, 2^32) */
        const uint32_t excess = shift_left(rarer - errors, g_shift);       /* <= g_total / 2, as x <= 1/2 */
        /* divide_24() takes a divisor of at most 31 bits. With half of it the quotient is twice x, as Q24. */
        const uint32_t twice_x = divide_24(excess, g_total >> 1);
        x = twice_x >> 2; /* by 1 to undo the doubling, and by 1 from Q24 to Q23 */
        alpha = confidence_inside(total, rarer, g_total, g_shift, shift);
    }
    /* x is the share of black if black is the rarer colour (n - white is negative: bit 31 is set) and the
     * sensor is right more often than wrong (bit 31 of b_hat is set), or if neither is so. If only one is so,
     * these bits differ, and x is the share of white. */
    const uint32_t differing_bits = (n - white) ^ accuracy->b_hat;
    const bool is_mirrored = differing_bits >> 31 != 0U;
    const estimate_t result = {is_mirrored ? MCP_ASDF_ONE - x : x,
                               alpha_word_from_mantissa(alpha.mantissa, alpha.exponent)};
    return result;
}

/* Count the observation z, and form the local estimate x_hat (Q23) and its alpha word. When t reaches the
 * memory, t and n are halved (half of an odd n is rounded to the even one of its neighbours): this keeps the
 * share of black, and new observations weigh more; the robust filter then begins a new batch of observations.
 * Sets `updated` to 0. Returns OK, or ERR_OBSERVATION if z is no observation; the robot is then as it was. */
HOT_PUBLIC mcp_asdf_status_t mcp_asdf_observe(mcp_asdf_t *robot, mcp_asdf_observation_t z)
{
    if ((uint32_t)z > (uint32_t)MCP_ASDF_BLACK) {
        return MCP_ASDF_ERR_OBSERVATION;
    }
    uint32_t t = robot->t + 1U, n = robot->n + (uint32_t)z; /* <= 2^31 */
    const bool is_halved = t >= robot->config->memory;
    if (is_halved) {
        t >>= 1; /* exact, as the memory is even */
        /* To nearest, ties to even. Half of an odd n lies between two integers, of which the even one is
         * wanted: the upper one, if the lower one is odd. 1 is added to n for that. If n is even, a 1 that is
         * added is lost in the shift. */
        const uint32_t rounded_down = n >> 1;
        const uint32_t is_rounded_down_odd = rounded_down & 1U;
        n = (n + is_rounded_down_odd) >> 1;
    }
    robot->t = t;
    robot->n = n;
    if (is_halved) { /* the counts at the beginning of a batch are no longer comparable with these */
        begin_batch(robot);
    }
    robot->updated = 0;
    const estimate_t local = estimate(t, n, &robot->accuracy);
    robot->x_hat = local.x_hat;
    robot->alpha = local.alpha;
    return MCP_ASDF_OK;
}

/* ---- The round: eq. 5 to 7, and 12 ---- */

#if MCP_ASDF_WITH_ASDF

/* Returns the value of an alpha word, its mantissa (bits 31 to 8) times 2^shift (bits 4 to 0), in units of
 * 2^-24: below 2^55, as two words. Bits 7 to 5 are ignored, by shift_left_wide(). */
ALWAYS_INLINE word_pair_t alpha_units(uint32_t alpha) { return shift_left_wide(alpha >> 8, alpha); }

/* Count a neighbour's estimate in the open round, and add it to the round's sums of alpha, alpha x_hat,
 * x_hat^2 and x_hat. x_hat is Q23, and `alpha` an alpha word above 0. */
HOT void add_estimate(mcp_asdf_t *robot, uint32_t x_hat, uint32_t alpha)
{
    mcp_asdf_open_t *const open = &robot->received.sums.open;
    /* Alpha has up to 55 bits and x_hat 24, so that their product may have more than 64. So it is summed in
     * two parts, for the lower and the upper word of alpha. At the right is what each term is at most; a
     * round has up to 127 of them, less than 2^7, so that no sum wraps. */
    const word_pair_t wide_alpha = alpha_units(alpha);
    add(&open->alpha, join(wide_alpha.high, wide_alpha.low));   /* 2^55 */
    add(&open->alpha_x_low, multiply(wide_alpha.low, x_hat));   /* 2^32 2^23 */
    add(&open->alpha_x_high, multiply(wide_alpha.high, x_hat)); /* 2^23 2^23 */
    add(&open->x_squared, multiply(x_hat, x_hat));              /* 2^23 2^23 */
    open->x += x_hat;                                           /* 2^23 */
    ++open->count;
}

/* Returns the mean of x_hat weighted by alpha, the sum of alpha x_hat divided by the sum of alpha (eq. 5 and
 * 7 of the paper), as Q32: less than 8 units too small, so that 1.0 is 2^32 - 1 or little less. `alpha` > 0
 * is the sum of alpha in units of 2^-24. The sum of alpha x_hat in units of 2^-47 is 2^32 alpha_x_high +
 * alpha_x_low. */
HOT uint32_t round_mean(uint64_t alpha, uint64_t alpha_x_low, uint64_t alpha_x_high)
{
    const uint64_t upper_sum = alpha_x_high + high_word(alpha_x_low); /* < 2^53 + 2^30 */
    const uint32_t lower_sum = low_word(alpha_x_low);
    /* These are the sum of alpha x_hat in units of 2^-23 of a unit of alpha: 2^32 upper_sum + lower_sum. The
     * dividend is this sum without its 23 bits behind the point, in whole units of alpha like the divisor: <=
     * alpha < 2^62. The upper part goes 32 - 23 bits to the left, the lower word 23 to the right. */
    uint64_t dividend = (upper_sum << 9) | (lower_sum >> 23);
    if (high_word(alpha) == 0U) {
        /* In so small sums those 23 bits count. Dividend and alpha fit in a word, and are multiplied by 2^32
         * before the bits are appended. */
        dividend = join(low_word(dividend), lower_sum << 9);
        alpha = join(low_word(alpha), 0);
    }
    return quotient(dividend, alpha);
}

/* Returns the informed estimate x (eq. 7 of the paper) as Q23: the mean of x_hat over the messages of a
 * closed round and the robot's own estimate, each weighted by its alpha. `closed` has the sums of the round.
 * The mean is the exact quotient of the sums, rounded down, or x_hat if all alphas are 0. `own_alpha` is an
 * alpha word, x_hat is Q23. */
HOT uint32_t informed_estimate(const mcp_asdf_closed_t *closed, uint32_t x_hat, uint32_t own_alpha)
{
    const word_pair_t wide_own_alpha = alpha_units(own_alpha);
    const uint64_t alpha =
        closed->alpha + join(wide_own_alpha.high, wide_own_alpha.low); /* of 128 robots: < 2^62 */
    if (alpha == 0U) {
        return x_hat;
    }
    const uint64_t alpha_x_low = closed->alpha_x_low + multiply(wide_own_alpha.low, x_hat);
    const uint64_t alpha_x_high = closed->alpha_x_high + multiply(wide_own_alpha.high, x_hat);
    /* Q32 to Q23. The mean is at most 7 of its units too small, and a unit of x has 512 of these: x is right
     * or one too small. */
    const uint32_t x = round_mean(alpha, alpha_x_low, alpha_x_high) >> 9;
    /* The remainder sum - x alpha of the division shows which: it is below 2 alpha < 2^63, and at least alpha
     * if x is one too small. Sum and product may have more than 64 bits; their lower 64 are enough, as their
     * difference modulo 2^64 is the remainder. */
    const uint64_t sum = alpha_x_low + join(low_word(alpha_x_high), 0); /* 2^32 alpha_x_high + alpha_x_low */
    /* x alpha: x times the lower word of alpha, and x times the upper one, which counts 2^32 times as much */
    const uint64_t product = multiply(x, low_word(alpha)) + join(x * high_word(alpha), 0);
    const bool is_one_too_small = sum - product >= alpha;
    return x + (uint32_t)is_one_too_small;
}

/* Returns the mean of the last closed round and the robot's own estimate (eq. 7), as Q23. With an `alpha` of
 * 0 this is x_bar (eq. 5), or x_hat if the round is empty. */
ALWAYS_INLINE uint32_t combine_with_round(const mcp_asdf_t *robot, uint32_t x_hat, uint32_t alpha)
{
    return informed_estimate(&robot->received.sums.closed, x_hat, alpha);
}

/* Whether x_hat differs too much from the m >= 2 estimates of the open round (eq. 12 of the paper, a t-test).
 * With the t-table's threshold k_m for m estimates, squared and multiplied out, this is
 *
 *     (sum x - m x_hat)^2 > k_m (m sum x^2 - (sum x)^2)
 *
 * where the bracket on the right is m^2 times the variance of the estimates. */
static bool asdf_test_rejects(const mcp_asdf_t *robot)
{
    const uint32_t *const table = robot->config->table;
    /* The last byte of the table's first word is q: word m has the threshold for m estimates, up to m = q,
     * and word q + 1 the threshold for more. */
    const uint32_t q = MCP_ASDF_READ_WORD(&table[0]) & 0xFFU;
    const uint32_t m = robot->received.sums.open.count;
    const uint32_t k = MCP_ASDF_READ_WORD(&table[m <= q ? m : q + 1U]);              /* Q26 */
    const uint32_t x_sum = robot->received.sums.open.x, m_x_hat = m * robot->x_hat;  /* Q23: < 2^30 */
    const uint32_t difference = x_sum > m_x_hat ? x_sum - m_x_hat : m_x_hat - x_sum; /* < 2^30 */
    const uint64_t spread = m * robot->received.sums.open.x_squared -
                            multiply(x_sum, x_sum); /* Q46: [0, m^2 / 4 2^46] (Cauchy): < 2^58 */
    /* k spread would be a Q72. It is formed from the two words of spread, and shifted to Q46: the upper word
     * by 32 - 26 to the left, the lower one by 26 to the right. The left side is an integer, so that rounding
     * the right side down decides alike. */
    const uint64_t upper_part = multiply(k, high_word(spread)) << 6; /* < 2^64 */
    const uint64_t squared_difference = multiply(difference, difference);
    const uint64_t lower_part = multiply(k, low_word(spread)) >> 26;
    return squared_difference > upper_part + lower_part;
}

/* Run the paper's filter at the end of a round, for t > 0. The filter ADAPTIVE tests first, if two estimates
 * or more came in the round, and counts the test; ALWAYS takes one estimate and has no test; OFF does
 * nothing. Returns the new b_hat as Q32, re-estimated from the mean over the round (eq. 8), or 0 if b_hat
 * stays: there are too few estimates, the test does not reject x_hat, or the mean carries no information. */
ALWAYS_INLINE uint32_t run_asdf_filter(mcp_asdf_t *robot)
{
    /* The sums of the round that ends have been copied to `closed`; its number of estimates is only in
     * `open`, which is cleared after the filter. */
    const mcp_asdf_closed_t *const closed = &robot->received.sums.closed;
    const uint8_t filter = robot->config->filter;
    /* At least two estimates are needed for the variance in eq. 12, one for a re-estimate without a test. */
    if (filter == MCP_ASDF_OFF || robot->received.sums.open.count < (filter == MCP_ASDF_ADAPTIVE ? 2U : 1U)) {
        return 0;
    }
    if (filter == MCP_ASDF_ADAPTIVE) {
        ++robot->counters.tests;
        if (!asdf_test_rejects(robot)) {
            return 0;
        }
    }
    const uint32_t x_bar = round_mean(closed->alpha, closed->alpha_x_low, closed->alpha_x_high); /* Q32 */
    return reestimate(robot, x_bar);
}

/* Copy the sums of the open round that x and x_bar need, which stay until the next round closes. */
ALWAYS_INLINE void publish_round_sums(mcp_asdf_t *robot)
{
    const mcp_asdf_open_t *const open = &robot->received.sums.open;
    robot->received.sums.closed.alpha = open->alpha;
    robot->received.sums.closed.alpha_x_low = open->alpha_x_low;
    robot->received.sums.closed.alpha_x_high = open->alpha_x_high;
}

/* Set the sums of the open round to 0. Member by member: cheaper than the library call that a compiler makes
 * of a whole struct. */
ALWAYS_INLINE void clear_round_sums(mcp_asdf_t *robot)
{
    mcp_asdf_open_t *const open = &robot->received.sums.open;
    open->alpha = 0;
    open->alpha_x_low = 0;
    open->alpha_x_high = 0;
    open->x_squared = 0;
    open->x = 0;
    open->count = 0;
}

/* Whether a t-table is undamaged and in order: q and omega are in their ranges, the thresholds fall, and the
 * hash fits the words before it. If q is bad, only the first word is read. Its words are
 *
 *     0            TABLE_MAGIC + q, the number of neighbours up to which it has thresholds: 2 .. 127
 *     1            omega, the tolerated error probability of the test, as Q32
 *     2 .. q       thresholds k_m for m estimates, Q26: each is less than the one before
 *     q + 1        the threshold for any m above q, the least of all, but still above 1.0
 *     q + 2        FNV-1a over the words before it */
static bool is_valid_table(const uint32_t *table)
{
    const uint32_t head = MCP_ASDF_READ_WORD(&table[0]);
    /* The last byte of `head` is q, since the last byte of TABLE_MAGIC is 0. In other heads this byte means
     * nothing, and they are refused below, before it is used. */
    const uint8_t hash_index = (uint8_t)(head + 2U); /* q + 2 */
    /* No robot has more neighbours than there are ids but its own: q is at most MCP_ASDF_MAX_ID. */
    if (head < TABLE_MAGIC + 2U || head > TABLE_MAGIC + MCP_ASDF_MAX_ID) {
        return false;
    }
    uint32_t hash = HASH_START, previous = 0;
    for (uint8_t i = 0; i < hash_index; ++i) { /* at most 129 turns */
        const uint32_t word = MCP_ASDF_READ_WORD(&table[i]);
        /* Thresholds must fall: each from word 3 on is compared with the one before. Word 2 is the first
         * threshold; words 0 and 1 are no thresholds. */
        if (word >= previous && i > 2U) {
            return false;
        }
        previous = word;
        hash = hash_word(hash, word);
    }
    /* `previous` is word q + 1 now, the least threshold. omega, word 1, must be from 1 to TABLE_OMEGA_MAX:
     * one comparison shows both, as an omega of 0 less 1 wraps to 2^32 - 1, which is not below the limit. */
    return previous > THRESHOLD_ONE && hash == MCP_ASDF_READ_WORD(&table[hash_index]) &&
           MCP_ASDF_READ_WORD(&table[1]) - 1U < TABLE_OMEGA_MAX;
}

#else /* the robust filter alone: calls of what follows disappear */

ALWAYS_INLINE void add_estimate(const mcp_asdf_t *robot, uint32_t x_hat, uint32_t alpha)
{
    (void)robot, (void)x_hat, (void)alpha;
}
ALWAYS_INLINE uint32_t combine_with_round(const mcp_asdf_t *robot, uint32_t x_hat, uint32_t alpha)
{
    return (void)robot, (void)alpha, x_hat;
}
ALWAYS_INLINE uint32_t run_asdf_filter(const mcp_asdf_t *robot) { return (void)robot, 0; }
ALWAYS_INLINE void publish_round_sums(const mcp_asdf_t *robot) { (void)robot; }
ALWAYS_INLINE void clear_round_sums(const mcp_asdf_t *robot) { (void)robot; }
ALWAYS_INLINE bool is_valid_table(const uint32_t *table) { return (void)table, true; }

#endif

/* Returns the informed estimate x as Q23: the mean over the last closed round and the robot's own estimate
 * (eq. 7); or with the robust filter the centre of its votes, x_hat before the first. */
uint32_t mcp_asdf_x(const mcp_asdf_t *robot)
{
    return mcp_asdf_is_robust(robot->config) ? robust_estimate(robot, robot->x_hat)
                                             : combine_with_round(robot, robot->x_hat, robot->alpha);
}

/* Returns the social estimate x_bar as Q23: the mean over the last closed round alone (eq. 5), 1/2 if that is
 * empty; or with the robust filter the centre of its votes, 1/2 before the first. */
uint32_t mcp_asdf_x_bar(const mcp_asdf_t *robot)
{
    return mcp_asdf_is_robust(robot->config) ? robust_estimate(robot, MCP_ASDF_HALF)
                                             : combine_with_round(robot, MCP_ASDF_HALF, 0);
}

/* ---- Receive ---- */

/* Add the estimate of `sender` (x_hat as Q23, alpha an alpha word) to the open round or, with the robust
 * filter, to the slots, unless the sender has been received from in this round. Every call counts as
 * accepted, repeated or rejected. Returns OK, also for an estimate without confidence (alpha 0), which counts
 * as accepted but changes no sum and no slot; REPEATED; or ERR_SENDER or ERR_X_HAT if the estimate is not
 * valid, in this order. */
mcp_asdf_status_t mcp_asdf_receive(mcp_asdf_t *robot, uint8_t sender, uint32_t x_hat, uint32_t alpha)
{
    if (sender > MCP_ASDF_MAX_ID || sender == robot->id) {
        ++robot->counters.rejected;
        return MCP_ASDF_ERR_SENDER;
    }
    if (x_hat > MCP_ASDF_ONE) {
        ++robot->counters.rejected;
        return MCP_ASDF_ERR_X_HAT;
    }
    /* The set of this round's senders has bit (id mod 8) of byte (id div 8) for each id: `senders` is the
     * byte that has the bit of this sender. */
    uint8_t *const senders = &robot->heard.of[sender >> 3];
    const uint32_t bit_of_sender = UINT32_C(1) << (sender & 7U);
    const uint32_t old_senders = *senders, new_senders = old_senders | bit_of_sender;
    if (old_senders == new_senders) { /* the bit was set before */
        ++robot->counters.repeated;
        return MCP_ASDF_REPEATED;
    }
    ++robot->counters.accepted;
    *senders = (uint8_t)new_senders;
    const uint32_t alpha_mantissa = alpha >> 8;
    if (alpha_mantissa == 0U) { /* alpha is 0, whatever the shift in the lower bits of the word */
        return MCP_ASDF_OK;
    }
    if (mcp_asdf_is_robust(robot->config)) {
        keep_estimate(robot, sender, x_hat);
    } else {
        add_estimate(robot, x_hat, alpha);
    }
    return MCP_ASDF_OK;
}

/* ---- The filter: eq. 8 ---- */

/* Returns the b_hat, as Q32, for which x_hat would be x_bar (eq. 8 of the paper), for x_bar as Q32 and t > 0;
 * or 0 if x_bar carries no information: it is near 1/2, |2 x_bar - 1| below 2^-12. It is (n / t + x_bar - 1)
 * / (2 x_bar - 1), both sides multiplied by t, and limited to the range of b_hat. */
static uint32_t reestimate(const mcp_asdf_t *robot, uint32_t x_bar)
{
    const uint32_t t = robot->t;
    uint32_t n = robot->n;
    if (x_bar < Q32_HALF) { /* exchange the colours, so that 2 x_bar - 1 is not negative */
        x_bar = ~x_bar;     /* 1 - x_bar, and 2^-32 less */
        n = t - n;
    }
    const uint32_t g = 2U * x_bar; /* 2 x_bar - 1 as Q32: the 1 is 2^32, which is lost in 32 bits */
    if (g < INFORMATIVE_G) {
        return 0;
    }
    const uint64_t divisor = multiply(t, g); /* t (2 x_bar - 1): < 2^63 */
    /* n - t (1 - x_bar), in two's complement: within 2^63 of 0 */
    const uint64_t difference = join(n, 0) - multiply(t, one_minus(x_bar));
    const uint64_t dividend = difference >> 63 == 0U ? difference : 0U; /* 0 if it is negative */
    const uint64_t limited_dividend = dividend < divisor ? dividend : divisor;
    uint32_t b_hat = quotient(limited_dividend, divisor);
    b_hat = b_hat > MCP_ASDF_B_HAT_MIN ? b_hat : MCP_ASDF_B_HAT_MIN;
    return b_hat < MCP_ASDF_B_HAT_MAX ? b_hat : MCP_ASDF_B_HAT_MAX;
}

/* Run the robot's filter at the end of a round, before its sums are cleared. Returns UPDATED if it has
 * re-estimated b_hat, which is then counted in `updates` and marked in `updated`; else OK. x_hat and alpha
 * stay as they are until the next observation. */
NOINLINE mcp_asdf_status_t update_b_hat(mcp_asdf_t *robot)
{
    if (robot->t == 0U) { /* there is no estimate to be tested */
        return MCP_ASDF_OK;
    }
    const uint32_t b_hat =
        mcp_asdf_is_robust(robot->config) ? run_robust_filter(robot) : run_asdf_filter(robot);
    if (b_hat == 0U) {
        return MCP_ASDF_OK;
    }
    set_b_hat(robot, b_hat);
    ++robot->counters.updates;
    robot->updated = 1;
    return MCP_ASDF_UPDATED;
}

/* ---- Rounds ---- */

/* Close the round: publish its sums, from which x and x_bar are computed, or with the robust filter take a
 * vote. Then begin the next round with empty sums, which robots with the robust filter do not have, and
 * without senders. Every filter_period rounds the filter runs in between. Returns UPDATED if it has
 * re-estimated b_hat, else OK. */
HOT_PUBLIC mcp_asdf_status_t mcp_asdf_settle(mcp_asdf_t *robot)
{
    /* The constant spares a build without the robust filter a load of robot->config. */
    const bool is_robust = MCP_ASDF_WITH_ROBUST && mcp_asdf_is_robust(robot->config);
    mcp_asdf_status_t status = MCP_ASDF_OK;
    if (is_robust) {
        take_vote(robot);
    } else {
        publish_round_sums(robot);
    }
    if (--robot->filter_left == 0U) {
        robot->filter_left = robot->config->filter_period;
        /* Before the sums are cleared: the test needs some that are not published. */
        status = update_b_hat(robot);
    }
    if (!is_robust) {
        clear_round_sums(robot);
    }
    /* The set of senders has one bit per id: `all` has the 128 bits in two words. */
    robot->heard.all[0] = 0;
    robot->heard.all[1] = 0;
    return status;
}

/* Observe z, then settle: a tick that is a round. Returns UPDATED if settling has re-estimated b_hat, else
 * OK; or ERR_OBSERVATION if z is no observation, and then nothing is settled. */
mcp_asdf_status_t mcp_asdf_step(mcp_asdf_t *robot, mcp_asdf_observation_t z)
{
    const mcp_asdf_status_t status = mcp_asdf_observe(robot, z);
    return status == MCP_ASDF_OK ? mcp_asdf_settle(robot) : status;
}

/* ---- Init ---- */

/* Returns the status of mcp_asdf_init() for these arguments: OK, or the first of ERR_CONFIG, ERR_TABLE,
 * ERR_ID and ERR_B_HAT that applies. */
static mcp_asdf_status_t check_init_arguments(const mcp_asdf_config_t *config, uint8_t id, uint32_t b_hat)
{
    if (config->filter_period == 0U || config->memory < MCP_ASDF_MEMORY_MIN ||
        config->memory > MCP_ASDF_MEMORY_MAX || config->memory % 4U != 0U) {
        return MCP_ASDF_ERR_CONFIG;
    }
    /* One comparison checks both ends of the range: for a filter below FILTER_FIRST the difference wraps to a
     * large number. */
    const uint32_t filters_from_first = (uint32_t)config->filter - FILTER_FIRST;
    if (filters_from_first > FILTER_LAST - FILTER_FIRST) {
        return MCP_ASDF_ERR_CONFIG;
    }
    if (config->filter == MCP_ASDF_ADAPTIVE && (config->table == NULL || !is_valid_table(config->table))) {
        return MCP_ASDF_ERR_TABLE;
    }
    if (id > MCP_ASDF_MAX_ID) {
        return MCP_ASDF_ERR_ID;
    }
    if (b_hat < MCP_ASDF_B_HAT_MIN || b_hat > MCP_ASDF_B_HAT_MAX) {
        return MCP_ASDF_ERR_B_HAT;
    }
    return MCP_ASDF_OK;
}

/* Initialise *robot with the settings `config`, the id (0 .. 127) and b_hat (Q32). Returns OK, or the first
 * error and leaves *robot as it was. */
mcp_asdf_status_t mcp_asdf_init(mcp_asdf_t *robot, const mcp_asdf_config_t *config, uint8_t id,
                                uint32_t b_hat)
{
    const mcp_asdf_status_t status = check_init_arguments(config, id, b_hat);
    if (status == MCP_ASDF_OK) {
        *robot = (mcp_asdf_t){
            .id = id, .config = config, .x_hat = MCP_ASDF_HALF, .filter_left = config->filter_period};
        init_robust_filter(robot, b_hat);
        set_b_hat(robot, b_hat);
    }
    return status;
}
