/* The plain engine: every value comes out of a call of the firmware. engine.h is the manual. */
#include "engine.h"

#include "trial.h"

void mcp_asdf_engine_philox(const uint32_t counter[4], const uint32_t key[2], uint32_t words[4])
{
    const philox_t drawn =
        philox((philox_t){{counter[0], counter[1], counter[2], counter[3]}}, key[0], key[1]);
    for (uint32_t i = 0; i < 4; ++i) {
        words[i] = drawn.word[i];
    }
}

mcp_asdf_status_t engine_check(const mcp_asdf_experiment_t *experiment)
{
    if (experiment->robots < 1 || experiment->robots > MCP_ASDF_ENGINE_MAX_ROBOTS || experiment->steps < 1 ||
        experiment->steps > INT32_MAX - 1 || experiment->observation_period < 1) {
        return MCP_ASDF_ERR_CONFIG;
    }
    if (experiment->comms_period < 1) {
        return MCP_ASDF_ERR_CONFIG;
    }
    const mcp_asdf_config_t *const first = experiment->configs[0];
    for (uint32_t j = 1; j < experiment->robots; ++j) {
        const mcp_asdf_config_t *const config = experiment->configs[j];
        if (config->filter_period != first->filter_period || config->memory != first->memory) {
            return MCP_ASDF_ERR_CONFIG;
        }
    }
    return MCP_ASDF_OK;
}

static void add(mcp_asdf_open_t *all, const mcp_asdf_open_t *one)
{
    all->alpha += one->alpha;
    all->alpha_x_low += one->alpha_x_low;
    all->alpha_x_high += one->alpha_x_high;
    all->x_squared += one->x_squared;
    all->x += one->x;
    all->count += one->count;
}

/* Sums of all messages but one: exact, so equal to adding the others. */
static mcp_asdf_open_t without(mcp_asdf_open_t all, const mcp_asdf_open_t *one)
{
    all.alpha -= one->alpha;
    all.alpha_x_low -= one->alpha_x_low;
    all.alpha_x_high -= one->alpha_x_high;
    all.x_squared -= one->x_squared;
    all.x -= one->x;
    all.count -= one->count;
    return all;
}

/* The sums of a robot's message alone: the round of a neighbour that hears nothing else. */
static mcp_asdf_open_t message_of(const mcp_asdf_t *robot)
{
    const uint8_t id = mcp_asdf_id(robot);
    mcp_asdf_t neighbour = {.id = id ^ 1};
    (void)mcp_asdf_receive(&neighbour, id, mcp_asdf_x_hat(robot), mcp_asdf_alpha(robot));
    return neighbour.open;
}

/* Every robot hears every other: the open rounds, still empty, become what receiving message by message makes
 * of them. The senders are not marked, since the rounds close at once. */
static void exchange(mcp_asdf_t *robots, uint32_t count)
{
    mcp_asdf_open_t own[MCP_ASDF_ENGINE_MAX_ROBOTS], all = {0};
    for (uint32_t j = 0; j < count; ++j) {
        own[j] = message_of(&robots[j]);
        add(&all, &own[j]);
    }
    for (uint32_t j = 0; j < count; ++j) {
        robots[j].open = without(all, &own[j]);
        robots[j].counters.accepted = (uint16_t)(robots[j].counters.accepted + count - 1);
    }
}

void engine_tick(mcp_asdf_t *robots, uint32_t count, const uint8_t *observations, bool closes)
{
    for (uint32_t j = 0; j < count; ++j) {
        (void)mcp_asdf_observe(&robots[j], (mcp_asdf_observation_t)observations[j]);
    }
    if (!closes) {
        return;
    }
    exchange(robots, count);
    for (uint32_t j = 0; j < count; ++j) {
        (void)mcp_asdf_settle(&robots[j]);
    }
}

static void record(const mcp_asdf_t *robots, uint32_t count, mcp_asdf_record_t *records)
{
    for (uint32_t j = 0; j < count; ++j) {
        const mcp_asdf_t *const robot = &robots[j];
        records[j] = (mcp_asdf_record_t){
            mcp_asdf_beta(robot),  mcp_asdf_t_count(robot), mcp_asdf_n_count(robot), mcp_asdf_x_hat(robot),
            mcp_asdf_alpha(robot), mcp_asdf_x_bar(robot),   mcp_asdf_x(robot),       mcp_asdf_b_hat(robot)};
    }
}

static void keep_x(const mcp_asdf_experiment_t *experiment, const trial_t *trial, uint32_t step)
{
    for (uint32_t column = 0; column < engine_columns(experiment); ++column) {
        trial->x[column * ((size_t)experiment->steps + 1) + step] = mcp_asdf_x(&trial->robots[column]);
    }
}

void engine_keep(const mcp_asdf_experiment_t *experiment, const trial_t *trial, uint32_t step)
{
    const uint32_t count = experiment->robots;
    const uint64_t period = engine_filter_ticks(experiment);
    keep_x(experiment, trial, step);
    if (step % period == 0) {
        for (uint32_t j = 0; j < count; ++j) {
            trial->b_hat[(step / period - 1) * count + j] = mcp_asdf_b_hat(&trial->robots[j]);
        }
    }
    if (trial->records != 0 && step % experiment->thinning == 0) {
        record(trial->robots, count, &trial->records[(step / experiment->thinning - 1) * (size_t)count]);
    }
}

mcp_asdf_status_t engine_start(const mcp_asdf_experiment_t *experiment, const trial_t *trial)
{
    for (uint32_t j = 0; j < experiment->robots; ++j) {
        const mcp_asdf_status_t status =
            mcp_asdf_init(&trial->robots[j], experiment->configs[j], (uint8_t)j, experiment->b_hat[j]);
        if (status != MCP_ASDF_OK) {
            return status;
        }
    }
    keep_x(experiment, trial, 0);
    return MCP_ASDF_OK;
}

/* The draws of four steps, [4][robots]. */
static void observe_block(const mcp_asdf_experiment_t *experiment, uint32_t index, uint32_t block,
                          uint8_t *observations)
{
    const uint32_t count = experiment->robots;
    for (uint32_t j = 0; j < count; ++j) {
        const philox_t drawn = draws(experiment->seed, experiment->first_trial + index, j, block);
        for (uint32_t i = 0; i < 4 && 4 * block + i < experiment->steps; ++i) {
            const uint32_t limit =
                experiment->black[index * experiment->trial_stride +
                                  (4 * block + i) * experiment->step_stride + j * experiment->robot_stride];
            observations[i * count + j] = drawn.word[i] >> 1 < limit;
        }
    }
}

static mcp_asdf_status_t run_trial(const mcp_asdf_experiment_t *experiment, uint32_t index,
                                   const trial_t *trial)
{
    uint8_t observations[4 * MCP_ASDF_ENGINE_MAX_ROBOTS];
    const mcp_asdf_status_t status = engine_start(experiment, trial);
    if (status != MCP_ASDF_OK) {
        return status;
    }
    for (uint32_t step = 0; step < experiment->steps; ++step) {
        if (step % 4 == 0) {
            observe_block(experiment, index, step / 4, observations);
        }
        engine_tick(trial->robots, experiment->robots, observations + (size_t)(step % 4) * experiment->robots,
                    engine_closes(experiment, step));
        engine_keep(experiment, trial, step + 1);
    }
    return MCP_ASDF_OK;
}

mcp_asdf_status_t mcp_asdf_engine_run(const mcp_asdf_experiment_t *experiment,
                                      const mcp_asdf_outcome_t *outcome)
{
    mcp_asdf_status_t status = engine_check(experiment);
    for (uint32_t index = 0; index < experiment->trials && status == MCP_ASDF_OK; ++index) {
        const trial_t trial = engine_trial(experiment, outcome, index);
        status = experiment->arenas == NULL ? run_trial(experiment, index, &trial)
                                            : moving_run(experiment, index, &trial);
    }
    return status;
}
