/* Many trials of a fully connected swarm side by side. engine.h is the manual.
 *
 * Every LANES trials take their steps together, computed by lanes.h. The steps in which the filter may run, t
 * reaches the memory or the trial ends are the firmware's own; before them the lanes hand over t and n, from
 * which it forms everything else.
 */
#define LANES 16

#include "lanes.h"

/* Sums over the robots of each trial, as in mcp_asdf_sums_t. */
typedef struct {
    uint64_t alpha[LANES];
    uint64_t alpha_x_low[LANES];
    uint64_t alpha_x_high[LANES];
} sum_lanes_t;

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

/* Count an observation of one robot in every trial and add what it says to the sums. */
INLINE void observe_and_add(robot_lanes_t *robot, const uint32_t *black, const step_t *step,
                            sum_lanes_t *sums)
{
    FOR_LANES
    {
        const estimate_t estimate = observe_lane(robot, l, black[l], step);
        sums->alpha[l] += estimate.alpha;
        sums->alpha_x_low[l] += low_product(estimate);
        sums->alpha_x_high[l] += high_product(estimate);
    }
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
        FOR_LANES { x[l] = informed_lane(sums.alpha[l], sums.alpha_x_low[l], sums.alpha_x_high[l]); }
        for (uint32_t l = 0; l < block->used; ++l) {
            block->trials[l].x[k + 1] = x[l];
        }
    }
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
    const bool is_alike = experiment->trial_stride == 0 && experiment->robot_stride == 0;
    return config->comms_period == 1 && (is_alike || experiment->arenas != NULL) &&
           experiment->thinning == 0 &&
           (experiment->steps <= MCP_ASDF_ENGINE_LANES_MAX_COUNT ||
            config->memory <= MCP_ASDF_ENGINE_LANES_MAX_COUNT);
}

static mcp_asdf_status_t run_blocks(const mcp_asdf_experiment_t *experiment,
                                    const mcp_asdf_outcome_t *outcome)
{
    mcp_asdf_status_t status = MCP_ASDF_OK;
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

mcp_asdf_status_t mcp_asdf_engine_run_lanes(const mcp_asdf_experiment_t *experiment,
                                            const mcp_asdf_outcome_t *outcome)
{
    mcp_asdf_status_t status = engine_check(experiment);
    if (status == MCP_ASDF_OK && experiment->arenas == NULL) {
        return run_blocks(experiment, outcome);
    }
    for (uint32_t index = 0; index < experiment->trials && status == MCP_ASDF_OK; ++index) {
        const trial_t trial = engine_trial(experiment, outcome, index);
        status = moving_run_lanes(experiment, index, &trial);
    }
    return status;
}
