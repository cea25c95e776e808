/* One trial of robots that are the firmware: its start, its steps, and the results of each. */
#include "trial.h"

/* Steps from one test of the filter to the next. */
static uint64_t steps_between_tests(const mcp_asdf_experiment_t *experiment)
{
    return (uint64_t)experiment->configs[0]->filter_period * experiment->comms_period;
}

/* Returns the number of series of x in a trial: 1 if x is the same in all robots, else one a robot. x is the
 * same if every robot combines the estimates of all robots, its own included. That fails if it receives from
 * some only (links), if its own estimate is newer than the broadcasts (comms_period), if a liar broadcasts
 * another estimate than its own, and with the robust filter, where x depends on the order of messages. */
uint32_t mcp_asdf_engine_columns(const mcp_asdf_experiment_t *experiment)
{
    bool has_common_x =
        !trial_is_linked(experiment) && experiment->comms_period == 1 && experiment->liars == 0;
    for (uint32_t j = 0; j < experiment->robots && has_common_x; ++j) {
        has_common_x = !mcp_asdf_is_robust(experiment->configs[j]);
    }
    return has_common_x ? 1 : experiment->robots;
}

trial_t trial_outcome(const mcp_asdf_experiment_t *experiment, const mcp_asdf_outcome_t *outcome,
                      uint32_t index)
{
    const size_t count = experiment->robots, steps = experiment->steps;
    const uint32_t interval = experiment->sampling_interval;
    const size_t records = interval == 0 ? 0 : steps / interval * count;
    return (trial_t){outcome->robots + index * count,
                     outcome->x + (size_t)index * mcp_asdf_engine_columns(experiment) * (steps + 1),
                     outcome->b_hat + index * (steps / steps_between_tests(experiment)) * count,
                     records == 0 ? 0 : outcome->records + index * records};
}

/* Returns the sums `all` without the message whose sums are `one`: exact, so equal to adding the others. */
static mcp_asdf_open_t subtract_message(mcp_asdf_open_t all, const mcp_asdf_open_t *one)
{
    all.alpha -= one->alpha;
    all.alpha_x_low -= one->alpha_x_low;
    all.alpha_x_high -= one->alpha_x_high;
    all.x_squared -= one->x_squared;
    all.x -= one->x;
    all.count -= one->count;
    return all;
}

/* Let a robot receive what robot `from` broadcasts: its estimate or, from one of the last robots, a lie.
 * Among many robots ids repeat, so the firmware must not take an id for its own, or for that of a sender
 * which it has received from in this round. */
static void receive_from(const mcp_asdf_experiment_t *experiment, const mcp_asdf_t *robots, mcp_asdf_t *robot,
                         uint32_t from)
{
    const uint8_t own_id = robot->id, sender_id = mcp_asdf_id(&robots[from]);
    const bool lies = from >= experiment->robots - experiment->liars;
    if (experiment->robots > MCP_ASDF_ENGINE_MAX_CONNECTED) {
        robot->heard.all[0] = robot->heard.all[1] = 0;
        robot->id = sender_id ^ 1;
    }
    (void)mcp_asdf_receive(robot, sender_id, lies ? experiment->lie[0] : mcp_asdf_x_hat(&robots[from]),
                           lies ? experiment->lie[1] : mcp_asdf_alpha(&robots[from]));
    robot->id = own_id;
}

/* The sums of the messages of robots first .. end - 1: the open round of a neighbour that receives nothing
 * else. */
static mcp_asdf_open_t sum_messages(const mcp_asdf_experiment_t *experiment, const mcp_asdf_t *robots,
                                    uint32_t first, uint32_t end)
{
    const mcp_asdf_config_t config_without_filter = {NULL, 1, MCP_ASDF_MEMORY_MAX, MCP_ASDF_OFF};
    mcp_asdf_t neighbour = {.config = &config_without_filter};
    for (uint32_t j = first; j < end; ++j) {
        neighbour.id = mcp_asdf_id(&robots[j]) ^ 1;
        receive_from(experiment, robots, &neighbour, j);
    }
    return neighbour.open;
}

/* Deliver all messages to all other robots. Those with the robust filter receive one by one, in ascending
 * order of ids. The open rounds of the others, still empty, become what receiving message by message would
 * make of them; marks of the senders are left out, since the rounds close at once. */
static void deliver_to_all(const mcp_asdf_experiment_t *experiment, mcp_asdf_t *robots)
{
    const uint32_t count = experiment->robots;
    const mcp_asdf_open_t all = sum_messages(experiment, robots, 0, count);
    for (uint32_t j = 0; j < count; ++j) {
        if (!mcp_asdf_is_robust(experiment->configs[j])) {
            const mcp_asdf_open_t own_message = sum_messages(experiment, robots, j, j + 1);
            robots[j].open = subtract_message(all, &own_message);
            robots[j].counters.accepted = (uint16_t)(robots[j].counters.accepted + count - 1);
            continue;
        }
        for (uint32_t i = 0; i < count; ++i) {
            if (i != j) {
                receive_from(experiment, robots, &robots[j], i);
            }
        }
    }
}

/* Deliver the last message of each robot to the robots that are linked to it now. The order of links and arcs
 * gives each robot its messages by ascending ids: votes of the robust filter do not commute. */
static void deliver_along_links(const mcp_asdf_experiment_t *experiment, mcp_asdf_t *robots,
                                const mcp_asdf_arena_t *arena)
{
    for (uint32_t p = 0; arena != NULL && p < arena->link_count; ++p) {
        receive_from(experiment, robots, &robots[arena->links[p].a], arena->links[p].b);
        receive_from(experiment, robots, &robots[arena->links[p].b], arena->links[p].a);
    }
    for (size_t p = 0; experiment->arcs != NULL && p < experiment->arc_count; ++p) {
        receive_from(experiment, robots, &robots[experiment->arcs[p].b], experiment->arcs[p].a);
    }
}

/* Deliver the messages of one step. */
static void deliver_messages(const mcp_asdf_experiment_t *experiment, mcp_asdf_t *robots,
                             const mcp_asdf_arena_t *arena)
{
    if (trial_is_linked(experiment)) {
        deliver_along_links(experiment, robots, arena);
    } else {
        deliver_to_all(experiment, robots);
    }
}

void trial_tick(const mcp_asdf_experiment_t *experiment, const trial_t *trial, const mcp_asdf_arena_t *arena,
                uint32_t k, trial_observations_t observations)
{
    const uint32_t count = experiment->robots;
    const bool is_late = experiment->latency != 0, closes_round = trial_closes_round(experiment, k);
    /* Before robots observe, their x_hat and alpha are still the messages of the step before. */
    if (is_late && k > 0 && trial_closes_round(experiment, k - 1)) {
        deliver_messages(experiment, trial->robots, arena);
    }
    for (uint32_t j = 0; j < count && trial_observes(experiment, k); ++j) {
        const uint32_t lane = observations.first_lane + j * observations.parallel_trials;
        const uint32_t black = lanes_is_black(&observations.lanes[lane / LANES], lane % LANES, k);
        (void)mcp_asdf_observe(&trial->robots[j], (mcp_asdf_observation_t)black);
    }
    if (!is_late && closes_round) {
        deliver_messages(experiment, trial->robots, arena);
    }
    for (uint32_t j = 0; j < count && closes_round; ++j) {
        (void)mcp_asdf_settle(&trial->robots[j]);
    }
}

/* Record the informed estimates after a step, one for each series. */
static void record_x(const mcp_asdf_experiment_t *experiment, const trial_t *trial, uint32_t step)
{
    const uint32_t columns = mcp_asdf_engine_columns(experiment);
    for (uint32_t column = 0; column < columns; ++column) {
        trial->x[column * ((size_t)experiment->steps + 1) + step] = mcp_asdf_x(&trial->robots[column]);
    }
}

void trial_record(const mcp_asdf_experiment_t *experiment, const trial_t *trial, uint32_t step)
{
    const uint32_t count = experiment->robots, interval = experiment->sampling_interval;
    const uint64_t period = steps_between_tests(experiment);
    record_x(experiment, trial, step);
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
    record_x(experiment, trial, 0);
    return MCP_ASDF_OK;
}
