/* One trial of robots that are the firmware: start, tick, and what is kept of each step. */
#include "trial.h"

/* Ticks from one run of the filter to the next. */
static uint64_t filter_ticks(const mcp_asdf_experiment_t *experiment)
{
    return (uint64_t)experiment->configs[0]->filter_period * experiment->comms_period;
}

uint32_t mcp_asdf_engine_columns(const mcp_asdf_experiment_t *experiment)
{
    bool is_same = !trial_is_linked(experiment) && experiment->comms_period == 1 && experiment->liars == 0;
    for (uint32_t j = 0; j < experiment->robots && is_same; ++j) {
        is_same = !mcp_asdf_is_robust(experiment->configs[j]);
    }
    return is_same ? 1 : experiment->robots;
}

trial_t trial_part(const mcp_asdf_experiment_t *experiment, const mcp_asdf_outcome_t *outcome, uint32_t index)
{
    const size_t count = experiment->robots, steps = experiment->steps;
    const size_t records =
        experiment->sampling_interval == 0 ? 0 : steps / experiment->sampling_interval * count;
    return (trial_t){outcome->robots + index * count,
                     outcome->x + (size_t)index * mcp_asdf_engine_columns(experiment) * (steps + 1),
                     outcome->b_hat + index * (steps / filter_ticks(experiment)) * count,
                     records == 0 ? 0 : outcome->records + index * records};
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

/* A robot takes what robot `from` broadcasts: its estimate, or, from one of the last robots, a lie. Among
 * many robots ids repeat, so the firmware must take none for its own or for one that it heard already. */
static void receive(const mcp_asdf_experiment_t *experiment, const mcp_asdf_t *robots, mcp_asdf_t *robot,
                    uint32_t from)
{
    const uint8_t own = robot->id, id = mcp_asdf_id(&robots[from]);
    const bool lies = from >= experiment->robots - experiment->liars;
    if (experiment->robots > MCP_ASDF_ENGINE_MAX_CONNECTED) {
        robot->heard.all[0] = robot->heard.all[1] = 0;
        robot->id = id ^ 1;
    }
    (void)mcp_asdf_receive(robot, id, lies ? experiment->lie[0] : mcp_asdf_x_hat(&robots[from]),
                           lies ? experiment->lie[1] : mcp_asdf_alpha(&robots[from]));
    robot->id = own;
}

/* The sums of what robots first .. end - 1 say: the round of a neighbour that hears nothing else. */
static mcp_asdf_open_t sums_of(const mcp_asdf_experiment_t *experiment, const mcp_asdf_t *robots,
                               uint32_t first, uint32_t end)
{
    const mcp_asdf_config_t sums = {NULL, 1, MCP_ASDF_MEMORY_MAX, MCP_ASDF_OFF};
    mcp_asdf_t neighbour = {.config = &sums};
    for (uint32_t j = first; j < end; ++j) {
        neighbour.id = mcp_asdf_id(&robots[j]) ^ 1;
        receive(experiment, robots, &neighbour, j);
    }
    return neighbour.open;
}

/* Every robot hears every other: with the robust filter one by one, in ascending order of ids; for the rest
 * the open rounds, still empty, become what receiving message by message makes of them, without marks of the
 * senders, since the rounds close at once. */
static void exchange(const mcp_asdf_experiment_t *experiment, mcp_asdf_t *robots)
{
    const uint32_t count = experiment->robots;
    const mcp_asdf_open_t all = sums_of(experiment, robots, 0, count);
    for (uint32_t j = 0; j < count; ++j) {
        if (!mcp_asdf_is_robust(experiment->configs[j])) {
            const mcp_asdf_open_t own = sums_of(experiment, robots, j, j + 1);
            robots[j].open = without(all, &own);
            robots[j].counters.accepted = (uint16_t)(robots[j].counters.accepted + count - 1);
            continue;
        }
        for (uint32_t i = 0; i < count; ++i) {
            if (i != j) {
                receive(experiment, robots, &robots[j], i);
            }
        }
    }
}

/* The last message of each robot reaches the robots that are linked to it now: in ascending order of ids,
 * which is that of links and arcs, as votes of the robust filter do not commute. */
static void deliver(const mcp_asdf_experiment_t *experiment, mcp_asdf_t *robots,
                    const mcp_asdf_arena_t *arena)
{
    for (uint32_t p = 0; arena != NULL && p < arena->link_count; ++p) {
        receive(experiment, robots, &robots[arena->links[p].a], arena->links[p].b);
        receive(experiment, robots, &robots[arena->links[p].b], arena->links[p].a);
    }
    for (size_t p = 0; experiment->arcs != NULL && p < experiment->arc_count; ++p) {
        receive(experiment, robots, &robots[experiment->arcs[p].b], experiment->arcs[p].a);
    }
}

static void hear(const mcp_asdf_experiment_t *experiment, mcp_asdf_t *robots, const mcp_asdf_arena_t *arena)
{
    if (trial_is_linked(experiment)) {
        deliver(experiment, robots, arena);
    } else {
        exchange(experiment, robots);
    }
}

/* Before a robot observes, its x_hat and alpha are still those that it said in the step before. */
void trial_tick(const mcp_asdf_experiment_t *experiment, const trial_t *trial, const mcp_asdf_arena_t *arena,
                uint32_t k, trial_eyes_t eyes)
{
    const uint32_t count = experiment->robots;
    const bool is_late = experiment->latency != 0, closes = trial_closes(experiment, k);
    if (is_late && k > 0 && trial_closes(experiment, k - 1)) {
        hear(experiment, trial->robots, arena);
    }
    for (uint32_t j = 0; j < count && trial_observes(experiment, k); ++j) {
        const uint32_t c = eyes.first + j * eyes.side;
        const uint32_t black = lanes_black(&eyes.lanes[c / LANES], c % LANES, k);
        (void)mcp_asdf_observe(&trial->robots[j], (mcp_asdf_observation_t)black);
    }
    if (!is_late && closes) {
        hear(experiment, trial->robots, arena);
    }
    for (uint32_t j = 0; j < count && closes; ++j) {
        (void)mcp_asdf_settle(&trial->robots[j]);
    }
}

static void keep_x(const mcp_asdf_experiment_t *experiment, const trial_t *trial, uint32_t step)
{
    const uint32_t columns = mcp_asdf_engine_columns(experiment);
    for (uint32_t column = 0; column < columns; ++column) {
        trial->x[column * ((size_t)experiment->steps + 1) + step] = mcp_asdf_x(&trial->robots[column]);
    }
}

void trial_keep(const mcp_asdf_experiment_t *experiment, const trial_t *trial, uint32_t step)
{
    const uint32_t count = experiment->robots, interval = experiment->sampling_interval;
    const uint64_t period = filter_ticks(experiment);
    keep_x(experiment, trial, step);
    for (uint32_t j = 0; j < count && step % period == 0; ++j) {
        trial->b_hat[(step / period - 1) * count + j] = mcp_asdf_b_hat(&trial->robots[j]);
    }
    for (uint32_t j = 0; j < count && trial->records != 0 && step % interval == 0; ++j) {
        const mcp_asdf_t *const robot = &trial->robots[j];
        trial->records[(step / interval - 1) * (size_t)count + j] = (mcp_asdf_record_t){
            mcp_asdf_beta(robot),  mcp_asdf_t_count(robot), mcp_asdf_n_count(robot), mcp_asdf_x_hat(robot),
            mcp_asdf_alpha(robot), mcp_asdf_x_bar(robot),   mcp_asdf_x(robot),       mcp_asdf_b_hat(robot)};
    }
}

mcp_asdf_status_t trial_start(const mcp_asdf_experiment_t *experiment, const trial_t *trial)
{
    for (uint32_t j = 0; j < experiment->robots; ++j) {
        const mcp_asdf_status_t status =
            mcp_asdf_init(&trial->robots[j], experiment->configs[j],
                          (uint8_t)(j % MCP_ASDF_ENGINE_MAX_CONNECTED), experiment->b_hat[j]);
        if (status != MCP_ASDF_OK) {
            return status;
        }
    }
    keep_x(experiment, trial, 0);
    return MCP_ASDF_OK;
}
