/* Trials of a fully connected swarm in lanes. engine.h is the manual.
 *
 * LANES_OF_TRIALS trials take their steps together. The steps in which the filter may run, t reaches the
 * memory or the trial ends are the firmware's own; before them the lanes hand over t and n, from which it
 * forms everything else.
 */
#include "lanes.h"

/* Trials side by side; lanes beyond the last trial run idle.
 *   index   of the first trial
 *   lanes   lane j LANES_OF_TRIALS + l is robot j of trial l, here and in `black` and `said`
 *   black   observations of four steps
 *   said    sums of each message
 *   heard   sums of the rounds of robot 0 of each trial */
typedef struct {
    const mcp_asdf_experiment_t *experiment;
    uint32_t index;
    uint32_t used;
    trial_t trials[LANES_OF_TRIALS];
    lanes_t lanes;
    uint32_t black[4][MCP_ASDF_ENGINE_MAX_ROBOTS][LANES_OF_TRIALS];
    lanes_sums_t said;
    lanes_sums_t heard;
} block_t;

/* Observations of steps 4 group .. 4 group + 3. */
FOR_EACH_TARGET static void draw(block_t *block, uint32_t group)
{
    const mcp_asdf_experiment_t *const experiment = block->experiment;
    const uint32_t first = experiment->first_trial + block->index;
    uint32_t limits[4];
    for (uint32_t i = 0; i < 4; ++i) {
        const uint32_t step = 4 * group + i;
        limits[i] = experiment->black[(step < experiment->steps ? step : 0) * experiment->step_stride];
    }
    for (uint32_t j = 0; j < experiment->robots; ++j) {
        for (uint32_t l = 0; l < LANES_OF_TRIALS; ++l) {
            const philox_t drawn = draws(experiment->seed, first + l, j, group);
            block->black[0][j][l] = drawn.word[0] >> 1 < limits[0];
            block->black[1][j][l] = drawn.word[1] >> 1 < limits[1];
            block->black[2][j][l] = drawn.word[2] >> 1 < limits[2];
            block->black[3][j][l] = drawn.word[3] >> 1 < limits[3];
        }
    }
}

/* Sums over all robots of each trial but the first. */
ENGINE_INLINE void add_up(uint32_t robots, const uint64_t *restrict of_robots, uint64_t *restrict sums)
{
    uint64_t all[LANES_OF_TRIALS] = {0};
    for (uint32_t j = 1; j < robots; ++j) {
        of_robots += LANES_OF_TRIALS;
        for (uint32_t l = 0; l < LANES_OF_TRIALS; ++l) {
            all[l] += of_robots[l];
        }
    }
    for (uint32_t l = 0; l < LANES_OF_TRIALS; ++l) {
        sums[l] = all[l];
    }
}

/* Robot 0 of each trial hears all others. */
FOR_EACH_TARGET static void hear(block_t *block)
{
    const uint32_t robots = block->experiment->robots;
    add_up(robots, block->said.alpha, block->heard.alpha);
    add_up(robots, block->said.alpha_x_low, block->heard.alpha_x_low);
    add_up(robots, block->said.alpha_x_high, block->heard.alpha_x_high);
}

/* Steps `from` .. `to` - 1 (from 0), in which t grows to `t` + 1 and on. All robots of a trial have the same
 * x to the bit. */
static void run_between(block_t *block, uint32_t from, uint32_t to, uint32_t t)
{
    const uint32_t count = block->experiment->robots * LANES_OF_TRIALS;
    uint32_t x[LANES_OF_TRIALS];
    for (uint32_t k = from; k < to; ++k) {
        if (k % 4 == 0) {
            draw(block, k / 4);
        }
        lanes_observe(&block->lanes, count, ++t, block->black[k % 4][0]);
        lanes_say(&block->lanes, count, &block->said);
        hear(block);
        lanes_inform(&block->lanes, LANES_OF_TRIALS, &block->heard, x);
        for (uint32_t l = 0; l < block->used; ++l) {
            block->trials[l].x[k + 1] = x[l];
        }
    }
}

static void load_all(block_t *block)
{
    for (uint32_t j = 0; j < block->experiment->robots; ++j) {
        for (uint32_t l = 0; l < LANES_OF_TRIALS; ++l) {
            lanes_load(&block->lanes, j * LANES_OF_TRIALS + l,
                       &block->trials[l < block->used ? l : 0].robots[j]);
        }
    }
}

/* Bring a robot to the state after `ticks` ticks in lanes, except for members that its next tick forms anew.
 */
static void hand_over(mcp_asdf_t *robot, uint32_t n, uint32_t ticks, uint32_t messages)
{
    robot->t += ticks;
    robot->n = n;
    robot->filter_left -= ticks;
    robot->counters.accepted = (uint16_t)(robot->counters.accepted + ticks * messages);
}

/* Step k (from 0), after `ticks` steps in lanes, by the firmware. */
static void run_firmware(block_t *block, uint32_t k, uint32_t ticks)
{
    const uint32_t count = block->experiment->robots;
    uint8_t observations[MCP_ASDF_ENGINE_MAX_ROBOTS];
    if (k % 4 == 0) {
        draw(block, k / 4);
    }
    for (uint32_t l = 0; l < block->used; ++l) {
        mcp_asdf_t *const robots = block->trials[l].robots;
        for (uint32_t j = 0; j < count; ++j) {
            hand_over(&robots[j], block->lanes.n[j * LANES_OF_TRIALS + l], ticks, count - 1);
            observations[j] = (uint8_t)block->black[k % 4][j][l];
        }
        engine_tick(robots, count, observations, true);
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

static mcp_asdf_status_t run_blocks(const mcp_asdf_experiment_t *experiment,
                                    const mcp_asdf_outcome_t *outcome)
{
    mcp_asdf_status_t status = MCP_ASDF_OK;
    block_t block;
    block.experiment = experiment;
    for (block.index = 0; block.index < experiment->trials && status == MCP_ASDF_OK;
         block.index += LANES_OF_TRIALS) {
        const uint32_t rest = experiment->trials - block.index;
        block.used = rest < LANES_OF_TRIALS ? rest : LANES_OF_TRIALS;
        for (uint32_t l = 0; l < block.used; ++l) {
            block.trials[l] = engine_trial(experiment, outcome, block.index + l);
        }
        status = run_block(&block);
    }
    return status;
}

bool mcp_asdf_engine_has_lanes(const mcp_asdf_experiment_t *experiment)
{
    const bool is_alike = experiment->trial_stride == 0 && experiment->robot_stride == 0;
    return experiment->comms_period == 1 && (is_alike || experiment->arenas != NULL) &&
           experiment->sampling_interval == 0;
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
