/* Many trials side by side: the firmware's arithmetic between two filter steps, in vector registers. engine.h
 * is the manual.
 *
 * Every LANES trials take their steps together. What the firmware computes per robot and tick
 * (docs/design.md, section 4) and per round (section 5) is computed here for all lanes in loops without
 * branches, which the compiler turns into vector instructions. Divisions are done in binary64 and made exact:
 * the comments say why. The steps in which the filter may run, t reaches the memory or the trial ends are the
 * firmware's own; before them the lanes hand over t and n, from which it forms everything else.
 */
#include <string.h>

#include "trial.h"

#define LANES 16
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

/* Sums over the robots of a trial, as in mcp_asdf_sums_t. */
typedef struct {
    uint64_t alpha[LANES];
    uint64_t alpha_x_low[LANES];
    uint64_t alpha_x_high[LANES];
} sum_lanes_t;

/* What all robots of all lanes share in a step. */
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

/* Count an observation in each lane and add x_hat and alpha to the sums. */
INLINE void observe_and_add(robot_lanes_t *robot, const uint32_t *black, const step_t *step,
                            sum_lanes_t *sums)
{
    FOR_LANES
    {
        const uint32_t blacks = robot->n[l] + black[l], whites = step->t - blacks;
        robot->n[l] = blacks;
        const uint32_t rare = blacks < whites ? blacks : whites, part = rare << step->shift >> 1;
        const uint32_t nu = ratio(rare, step);
        const uint32_t inside =
            multiply_high((nu - robot->c[l]) << robot->g_shift[l], robot->inverse_g[l]) >> 7;
        const confidence_t confidence = confidence_inside(robot, l, nu, step),
                           end = confidence_at_end(robot, l, part, step);
        const uint32_t at_end = part <= multiply_high(step->total, robot->c[l]);
        const confidence_t chosen = {
            choose(at_end, end.mantissa, confidence.mantissa),
            (int32_t)choose(at_end, (uint32_t)end.exponent, (uint32_t)confidence.exponent)};
        const uint64_t alpha = units(chosen, 33 - (int32_t)step->shift);
        const uint32_t x = choose(at_end, 0, inside), mirrored = (blacks < whites) == robot->inverted[l];
        const uint32_t x_hat = choose(mirrored, MCP_ASDF_ONE - x, x);
        sums->alpha[l] += alpha;
        sums->alpha_x_low[l] += (uint64_t)(uint32_t)alpha * x_hat;
        sums->alpha_x_high[l] += (uint64_t)(uint32_t)(alpha >> 32) * x_hat;
    }
}

/* x of every lane: floor of the quotient of the sums, which is at most 2^23. binary64 is off by less than
 * 2^-26, so the candidate is the floor or one more; the remainder, known modulo 2^64 and of less than 63
 * bits, tells. */
INLINE void informed(const sum_lanes_t *sums, uint32_t *x)
{
    FOR_LANES
    {
        const uint64_t alpha = sums->alpha[l];
        const double dividend = rounded(sums->alpha_x_high[l]) * 0x1p32 + rounded(sums->alpha_x_low[l]);
        const uint32_t candidate = nearly_floor(dividend / rounded(alpha));
        const uint64_t remainder =
            (sums->alpha_x_high[l] << 32) + sums->alpha_x_low[l] -
            ((uint64_t)candidate * (uint32_t)alpha + ((uint64_t)(candidate * (uint32_t)(alpha >> 32)) << 32));
        x[l] = choose(alpha == 0, MCP_ASDF_HALF, candidate - (uint32_t)(remainder >> 63));
    }
}

/* LANES trials at once. */
typedef struct {
    const mcp_asdf_experiment_t *experiment;
    uint32_t index; /* of the first trial; lanes beyond the last trial run idle */
    uint32_t used;
    trial_t trials[LANES];
    robot_lanes_t robots[MCP_ASDF_ENGINE_MAX_ROBOTS];
    uint32_t black[4][MCP_ASDF_ENGINE_MAX_ROBOTS][LANES];
} block_t;

INLINE void draw(block_t *block, uint32_t robot, uint32_t group)
{
    const mcp_asdf_experiment_t *const experiment = block->experiment;
    uint32_t limits[4];
    for (uint32_t i = 0; i < 4; ++i) {
        const uint32_t step = 4 * group + i;
        limits[i] = experiment->black[(step < experiment->steps ? step : 0) * experiment->step_stride];
    }
    const uint32_t first = experiment->first_trial + block->index;
    FOR_LANES
    {
        const philox_t drawn = draws(experiment->seed, first + l, robot, group);
        block->black[0][robot][l] = drawn.word[0] >> 1 < limits[0];
        block->black[1][robot][l] = drawn.word[1] >> 1 < limits[1];
        block->black[2][robot][l] = drawn.word[2] >> 1 < limits[2];
        block->black[3][robot][l] = drawn.word[3] >> 1 < limits[3];
    }
}

INLINE step_t step_at(uint32_t t)
{
    const uint32_t shift = (uint32_t)__builtin_clz(t);
    const double exact = t;
    return (step_t){t, shift, t << shift >> 1, 0x1p32 / exact, 0.5 + 0.5 / exact};
}

/* Steps `from` .. `to` - 1 (from 0), in which t grows to `t` + 1 and on. */
FOR_EACH_TARGET static void run_between(block_t *block, uint32_t from, uint32_t to, uint32_t t)
{
    const uint32_t count = block->experiment->robots;
    uint32_t x[LANES];
    for (uint32_t k = from; k < to; ++k) {
        const step_t step = step_at(++t);
        sum_lanes_t sums = {{0}, {0}, {0}};
        for (uint32_t j = 0; j < count; ++j) {
            if (k % 4 == 0) {
                draw(block, j, k / 4);
            }
            observe_and_add(&block->robots[j], block->black[k % 4][j], &step, &sums);
        }
        informed(&sums, x);
        for (uint32_t l = 0; l < block->used; ++l) {
            block->trials[l].x[k + 1] = x[l];
        }
    }
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

static void load_all(block_t *block)
{
    for (uint32_t j = 0; j < block->experiment->robots; ++j) {
        for (uint32_t l = 0; l < LANES; ++l) {
            load(&block->robots[j], l, &block->trials[l < block->used ? l : 0].robots[j]);
        }
    }
}

/* Hand a robot over: what `ticks` ticks without its filter leave behind, but for what its next tick forms
 * anew. */
static void hand_over(mcp_asdf_t *robot, uint32_t n, uint32_t ticks, uint32_t messages)
{
    const uint64_t accepted = robot->counters.accepted + (uint64_t)ticks * messages;
    robot->t += ticks;
    robot->n = n;
    robot->filter_left -= ticks;
    robot->counters.accepted = (uint16_t)(accepted > UINT16_MAX ? UINT16_MAX : accepted);
}

/* Step k (from 0), after `ticks` steps in lanes, by the firmware. */
static void run_firmware(block_t *block, uint32_t k, uint32_t ticks)
{
    const uint32_t count = block->experiment->robots;
    uint8_t observations[MCP_ASDF_ENGINE_MAX_ROBOTS];
    for (uint32_t j = 0; j < count && k % 4 == 0; ++j) {
        draw(block, j, k / 4);
    }
    for (uint32_t l = 0; l < block->used; ++l) {
        mcp_asdf_t *const robots = block->trials[l].robots;
        for (uint32_t j = 0; j < count; ++j) {
            hand_over(&robots[j], block->robots[j].n[l], ticks, count - 1);
            observations[j] = (uint8_t)block->black[k % 4][j][l];
        }
        engine_tick(robots, count, observations);
        engine_keep(block->experiment, &block->trials[l], k + 1);
    }
    load_all(block);
}

/* The first step from `step` on that the firmware takes: the end of a filtering period or of the trial, or
 * where t is halved. */
static uint32_t next_stop(const mcp_asdf_experiment_t *experiment, const mcp_asdf_t *robot, uint32_t step)
{
    const uint32_t left = robot->filter_left - 1, until_full = experiment->configs[0]->memory - robot->t - 1;
    const uint32_t least = left < until_full ? left : until_full;
    const uint32_t rest = experiment->steps - 1 - step;
    return step + (least < rest ? least : rest);
}

static mcp_asdf_status_t run_block(block_t *block)
{
    mcp_asdf_status_t status = MCP_ASDF_OK;
    for (uint32_t l = 0; l < block->used && status == MCP_ASDF_OK; ++l) {
        status = engine_start(block->experiment, &block->trials[l]);
    }
    if (status != MCP_ASDF_OK) {
        return status;
    }
    load_all(block);
    for (uint32_t step = 0; step < block->experiment->steps; ++step) {
        const mcp_asdf_t *const any = &block->trials[0].robots[0];
        const uint32_t stop = next_stop(block->experiment, any, step);
        run_between(block, step, stop, mcp_asdf_t_count(any));
        run_firmware(block, stop, stop - step);
        step = stop;
    }
    return MCP_ASDF_OK;
}

bool mcp_asdf_engine_has_lanes(const mcp_asdf_experiment_t *experiment)
{
    const mcp_asdf_config_t *const config = experiment->configs[0];
    return config->comms_period == 1 && experiment->trial_stride == 0 && experiment->robot_stride == 0 &&
           experiment->thinning == 0 &&
           (experiment->steps <= MCP_ASDF_ENGINE_LANES_MAX_COUNT ||
            config->memory <= MCP_ASDF_ENGINE_LANES_MAX_COUNT);
}

mcp_asdf_status_t mcp_asdf_engine_run_lanes(const mcp_asdf_experiment_t *experiment,
                                            const mcp_asdf_outcome_t *outcome)
{
    mcp_asdf_status_t status = engine_check(experiment);
    block_t block;
    block.experiment = experiment;
    for (block.index = 0; block.index < experiment->trials && status == MCP_ASDF_OK; block.index += LANES) {
        const uint32_t rest = experiment->trials - block.index;
        block.used = rest < LANES ? rest : LANES;
        for (uint32_t l = 0; l < block.used; ++l) {
            block.trials[l] = engine_trial(experiment, outcome, block.index + l);
        }
        status = run_block(&block);
    }
    return status;
}
