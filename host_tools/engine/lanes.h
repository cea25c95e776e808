/* The firmware's arithmetic between two filter steps, in vector registers. engine.h is the manual; for the
 * engine's own files, which define LANES before.
 *
 * What the firmware computes per robot and tick (docs/design.md, section 4) and per round (section 5) is
 * computed here for LANES robots, which have the same t, in loops without branches, which the compiler turns
 * into vector instructions. Divisions are done in binary64 and made exact: the comments say why.
 */
#ifndef MCP_ASDF_LANES_H
#define MCP_ASDF_LANES_H

#include <string.h>

#include "trial.h"

#define FOR_LANES for (uint32_t l = 0; l < LANES; ++l)

/* One kernel for the processor at hand, chosen when the program starts: results are the same. */
#if defined(__GNUC__) && !defined(__clang__) && defined(__x86_64__) && defined(__gnu_linux__) &&             \
    !defined(LANES_ONE_TARGET)
#define FOR_EACH_TARGET __attribute__((target_clones("default", "arch=x86-64-v3", "arch=x86-64-v4")))
#else
#define FOR_EACH_TARGET
#endif
#define INLINE static inline __attribute__((always_inline))

/* What the firmware keeps of a robot's accuracy (mcp_asdf_accuracy_t), and its n, by lane. */
typedef struct {
    uint32_t n[LANES];
    uint32_t inverted[LANES];
    uint32_t c[LANES];
    uint32_t inverse_g[LANES];
    uint32_t g_squared[LANES];
    uint32_t edge[LANES];
    uint32_t odds[LANES];
    uint32_t g_shift[LANES];
    uint32_t odds_left[LANES];
    uint32_t odds_right[LANES];
    int32_t g_squared_shift[LANES];
    int32_t edge_shift[LANES];
} robot_lanes_t;

/* What all lanes share in a step. */
typedef struct {
    uint32_t t;
    uint32_t shift;
    uint32_t total;
    double inverse; /* 2^32 / t */
    double nudge;   /* 1/2 + 1 / 2t */
} step_t;

INLINE uint32_t multiply_high(uint32_t a, uint32_t b) { return (uint32_t)((uint64_t)a * b >> 32); }

INLINE uint64_t bits_of(double value)
{
    uint64_t bits;
    memcpy(&bits, &value, sizeof bits);
    return bits;
}

INLINE double from_bits(uint64_t bits)
{
    double value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

#define TWO_52 0x1p52
#define TWO_52_BITS UINT64_C(0x4330000000000000)
#define TWO_84_BITS UINT64_C(0x4530000000000000)
#define FRACTION ((UINT64_C(1) << 52) - 1)

/* The integer nearest to value - 1, for 0 <= value < 2^32: it stands in the last bits of value + 2^52. */
INLINE uint32_t nearest_less_1(double value) { return (uint32_t)bits_of(value + TWO_52) - 1; }

/* floor(value), or the next integer where value is less than 2^-20 below it. */
INLINE uint32_t nearly_floor(double value) { return nearest_less_1(value + (0.5 + 0x1p-20)); }

/* Exact for value < 2^52. */
INLINE double to_double(uint64_t value) { return from_bits(value | TWO_52_BITS) - TWO_52; }

/* Within 2^-53 of it, any value. */
INLINE double rounded(uint64_t value)
{
    const double high = from_bits(value >> 32 | TWO_84_BITS) - (0x1p84 + 0x1p52); /* exact */
    return high + from_bits((uint32_t)value | TWO_52_BITS);
}

/* floor(2^32 part / total) for part / total = rare / t <= 1/2: t <= 2^18, so that the quotient is either an
 * integer or more than 2^-19 away from the next; all errors together are below 2^-20, so that adding 1 / 2t -
 * 1/2 makes the nearest integer the floor. */
INLINE uint32_t ratio(uint32_t rare, const step_t *step)
{
    return nearest_less_1((double)(int32_t)rare * step->inverse + step->nudge);
}

/* floor(2^24 scale / spread), scale < 2^31, 2^30 <= spread <= 2^31. The binary64 quotient, below 2^25, is off
 * by less than 2^-28, so the candidate is the floor or one more; the remainder tells. */
INLINE uint32_t divide_24(uint32_t scale, uint32_t spread)
{
    const double quotient = (double)(int32_t)scale * 0x1p24 / (double)(int32_t)spread;
    const uint32_t candidate = nearly_floor(quotient);
    const uint32_t remainder = (scale << 24) - candidate * spread; /* modulo 2^32; [-2^12, 2^30) */
    return candidate - (remainder >> 31);
}

/* A confidence: mantissa 2^exponent units, not yet on the grid. */
typedef struct {
    uint32_t mantissa;
    int32_t exponent;
} confidence_t;

INLINE confidence_t confidence_inside(const robot_lanes_t *robot, uint32_t l, uint32_t nu, const step_t *step)
{
    const uint32_t spread = multiply_high(nu, 0 - nu);
    const int32_t size =
        (int32_t)(bits_of((double)(int32_t)spread) >> 52) - 1023; /* floor(log2 spread) <= 30 */
    const uint32_t shift = (uint32_t)(30 - size) & 31;
    const uint32_t scale = multiply_high(step->total, robot->g_squared[l]);
    return (confidence_t){divide_24(scale, spread << shift), (int32_t)shift - robot->g_squared_shift[l]};
}

INLINE confidence_t confidence_at_end(const robot_lanes_t *robot, uint32_t l, uint32_t part,
                                      const step_t *step)
{
    const uint64_t odd = (uint64_t)(part << robot->odds_left[l]) * robot->odds[l] >> robot->odds_right[l];
    const uint64_t bits = bits_of(to_double(odd + (step->total - part))); /* the sum is below 2^52 */
    const uint32_t mantissa = (uint32_t)(((bits & FRACTION) | (FRACTION + 1)) >> 21);
    return (confidence_t){multiply_high(mantissa, robot->edge[l]) >> 8,
                          (int32_t)(bits >> 52) - (1023 + 31) - robot->edge_shift[l]};
}

/* alpha in units of 2^-24, as alpha_bits() of the firmware brings it to the grid. */
INLINE uint64_t units(confidence_t confidence, int32_t exponent)
{
    uint32_t mantissa = confidence.mantissa;
    exponent += confidence.exponent;
    const uint32_t small = mantissa < (UINT32_C(1) << 23), large = mantissa >> 24;
    mantissa = mantissa << small >> large;
    exponent += (int32_t)large - (int32_t)small;
    mantissa = exponent > 31 ? UINT32_C(0xFFFFFF) : mantissa;
    exponent = exponent > 31 ? 31 : exponent;
    const uint32_t left = exponent > 0 ? (uint32_t)exponent : 0,
                   right = exponent < 0 ? (uint32_t)-exponent : 0;
    return (uint64_t)(mantissa >> (right & 31)) << left;
}

/* `yes` if condition is 1, `no` if it is 0, without a branch: a loop with branches is not turned into vector
 * instructions. */
INLINE uint32_t choose(uint32_t condition, uint32_t yes, uint32_t no)
{
    return no ^ ((yes ^ no) & (0 - condition));
}

/* What a robot says: x_hat in units of 2^-23, alpha in units of 2^-24. */
typedef struct {
    uint32_t x_hat;
    uint64_t alpha;
} estimate_t;

/* Count an observation of lane l, 1 if black, and estimate. */
INLINE estimate_t observe_lane(robot_lanes_t *robot, uint32_t l, uint32_t black, const step_t *step)
{
    const uint32_t blacks = robot->n[l] + black, whites = step->t - blacks;
    robot->n[l] = blacks;
    const uint32_t rare = blacks < whites ? blacks : whites, part = rare << step->shift >> 1;
    const uint32_t nu = ratio(rare, step);
    const uint32_t inside = multiply_high((nu - robot->c[l]) << robot->g_shift[l], robot->inverse_g[l]) >> 7;
    const confidence_t confidence = confidence_inside(robot, l, nu, step),
                       end = confidence_at_end(robot, l, part, step);
    const uint32_t at_end = nu <= robot->c[l];
    const confidence_t chosen = {
        choose(at_end, end.mantissa, confidence.mantissa),
        (int32_t)choose(at_end, (uint32_t)end.exponent, (uint32_t)confidence.exponent)};
    const uint32_t x = choose(at_end, 0, inside), mirrored = (blacks < whites) == robot->inverted[l];
    return (estimate_t){choose(mirrored, MCP_ASDF_ONE - x, x), units(chosen, 33 - (int32_t)step->shift)};
}

/* alpha x_hat in the two parts of mcp_asdf_sums_t. */
INLINE uint64_t low_product(estimate_t estimate)
{
    return (uint64_t)(uint32_t)estimate.alpha * estimate.x_hat;
}

INLINE uint64_t high_product(estimate_t estimate)
{
    return (uint64_t)(uint32_t)(estimate.alpha >> 32) * estimate.x_hat;
}

/* x from sums of alpha and alpha x_hat: floor of their quotient, which is at most 2^23. binary64 is off by
 * less than 2^-26, so the candidate is the floor or one more; the remainder, known modulo 2^64 and of less
 * than 63 bits, tells. Without any confidence x is x_hat, and that is 1/2. */
INLINE uint32_t informed_lane(uint64_t alpha, uint64_t alpha_x_low, uint64_t alpha_x_high)
{
    const double dividend = rounded(alpha_x_high) * 0x1p32 + rounded(alpha_x_low);
    const uint32_t candidate = nearly_floor(dividend / rounded(alpha));
    const uint64_t remainder =
        (alpha_x_high << 32) + alpha_x_low -
        ((uint64_t)candidate * (uint32_t)alpha + ((uint64_t)(candidate * (uint32_t)(alpha >> 32)) << 32));
    return choose(alpha == 0, MCP_ASDF_HALF, candidate - (uint32_t)(remainder >> 63));
}

INLINE step_t step_at(uint32_t t)
{
    const uint32_t shift = (uint32_t)__builtin_clz(t);
    const double exact = t;
    return (step_t){t, shift, t << shift >> 1, 0x1p32 / exact, 0.5 + 0.5 / exact};
}

static void load(robot_lanes_t *lanes, uint32_t l, const mcp_asdf_t *robot)
{
    const mcp_asdf_accuracy_t *const accuracy = &robot->accuracy;
    lanes->n[l] = robot->n;
    lanes->inverted[l] = accuracy->inverted;
    lanes->c[l] = accuracy->c;
    lanes->inverse_g[l] = accuracy->inverse_g;
    lanes->g_squared[l] = accuracy->g_squared;
    lanes->edge[l] = accuracy->edge;
    lanes->odds[l] = accuracy->odds;
    lanes->g_shift[l] = accuracy->g_shift & 31; /* any where b_hat says nothing: edge and so alpha are 0 */
    lanes->odds_left[l] = accuracy->odds_left;
    lanes->odds_right[l] = accuracy->odds_right;
    lanes->g_squared_shift[l] = accuracy->g_squared_shift;
    lanes->edge_shift[l] = accuracy->edge_shift;
}

#endif
