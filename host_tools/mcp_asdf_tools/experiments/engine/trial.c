/* One trial of robots that are the firmware: start, tick, and what is kept of each step. */
#include "trial.h"

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
    if (trial->records != 0 && step % experiment->sampling_interval == 0) {
        record(trial->robots, count,
               &trial->records[(step / experiment->sampling_interval - 1) * (size_t)count]);
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
