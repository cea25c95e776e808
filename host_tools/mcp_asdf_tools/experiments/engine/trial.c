/* One trial of robots that are the firmware: its start, its steps, and the results of each. */
#include "trial.h"

#include "mcp_asdf_small.h"

/* Returns the number of steps from one test of the filter to the next. */
static uint64_t steps_between_tests(const mcp_asdf_experiment_t *experiment)
{
    return (uint64_t)experiment->configs[0]->filter_period * experiment->comms_period;
}

/* Returns the number of series of x in a trial: 1 if x is the same in all robots, else one a robot. x is the
 * same if every robot combines the estimates of all robots, its own included. That fails if it receives from
 * some only (links), if its own estimate is newer than the broadcasts (comms_period), if a liar broadcasts
 * another estimate than its own, if messages are rounded and its own estimate is not, and with the robust
 * filter, where each robot takes votes of its own. */
uint32_t mcp_asdf_engine_columns(const mcp_asdf_experiment_t *experiment)
{
    bool has_common_x = !trial_is_linked(experiment) && experiment->comms_period == 1 &&
                        experiment->liars == 0 && experiment->x_hat_bits == 0;
    for (uint32_t robot = 0; robot < experiment->robots && has_common_x; ++robot) {
        has_common_x = !mcp_asdf_is_robust(experiment->configs[robot]);
    }
    return has_common_x ? 1 : experiment->robots;
}

/* Returns the part of the outcome in which the index-th trial has its results. The arrays hold one trial
 * after another. In x a trial has T + 1 entries in each of its columns, in b_hat an entry per robot and test,
 * in records an entry per robot and sampling interval; records is NULL if there are none. */
trial_t trial_outcome(const mcp_asdf_experiment_t *experiment, const mcp_asdf_outcome_t *outcome,
                      uint32_t index)
{
    const size_t count = experiment->robots, steps = experiment->steps;
    const uint32_t interval = experiment->sampling_interval;
    const size_t estimates_of_trial = mcp_asdf_engine_columns(experiment) * (steps + 1);
    const size_t tests = steps / steps_between_tests(experiment);
    const size_t accuracies_of_trial = tests * count;
    const size_t records_of_trial = interval == 0 ? 0 : (steps / interval) * count;
    return (trial_t){.robots = outcome->robots + index * count,
                     .x = outcome->x + index * estimates_of_trial,
                     .b_hat = outcome->b_hat + index * accuracies_of_trial,
                     .records = records_of_trial == 0 ? NULL : outcome->records + index * records_of_trial};
}

/* Returns the sums of a round without one of its messages: `message` has the sums of a round of this message
 * alone. The sums are integers, so the result is exactly the sums of the other messages. */
static mcp_asdf_open_t subtract_message(mcp_asdf_open_t sums, const mcp_asdf_open_t *message)
{
    sums.alpha -= message->alpha;
    sums.alpha_x_low -= message->alpha_x_low;
    sums.alpha_x_high -= message->alpha_x_high;
    sums.x_squared -= message->x_squared;
    sums.x -= message->x;
    sums.count -= message->count;
    return sums;
}

/* Let `robot` receive what robot number `sender` of `robots` broadcasts: its x_hat and alpha or, for the
 * liars, which are the last robots, the experiment's lie; both values are rounded to the bits of a message,
 * if the experiment has x_hat_bits. In a swarm of more than 128 robots, where ids repeat, the set of senders
 * that the robot has received from in this round is cleared before. The robot's id is the same afterwards. */
static void receive_from(const mcp_asdf_experiment_t *experiment, const mcp_asdf_t *robots, mcp_asdf_t *robot,
                         uint32_t sender)
{
    const uint8_t own_id = robot->id, sender_id = mcp_asdf_id(&robots[sender]);
    const bool is_liar = sender >= experiment->robots - experiment->liars;
    uint32_t x_hat = is_liar ? experiment->lie[0] : mcp_asdf_x_hat(&robots[sender]);
    uint32_t alpha = is_liar ? experiment->lie[1] : mcp_asdf_alpha(&robots[sender]);
    if (experiment->x_hat_bits != 0) { /* through the codec, to and fro */
        const uint32_t x_hat_code = mcp_asdf_x_hat_to_code(x_hat, experiment->x_hat_bits);
        const uint32_t alpha_code = mcp_asdf_alpha_to_code(alpha, experiment->alpha_bits);
        x_hat = mcp_asdf_x_hat_from_code(x_hat_code, experiment->x_hat_bits);
        alpha = mcp_asdf_alpha_from_code(alpha_code, experiment->alpha_bits);
    }
    if (experiment->robots > MCP_ASDF_ENGINE_MAX_CONNECTED) {
        /* Ids repeat among so many robots. The firmware must not take the sender for one that it has received
         * from in this round: so the set of senders becomes empty, which has a bit for each id in two words.
         * Nor must it take the sender for itself: until the message is received it has another id. */
        robot->heard.all[0] = 0;
        robot->heard.all[1] = 0;
        robot->id = sender_id ^ 1; /* any id but the sender's */
    }
    (void)mcp_asdf_receive(robot, sender_id, x_hat, alpha);
    robot->id = own_id;
}

/* Returns the sums of the messages of the robots `first` to `end` - 1. They are formed by the firmware: as
 * the sums of the open round of a made-up neighbour, which receives these messages and nothing else. */
static mcp_asdf_open_t sum_messages(const mcp_asdf_experiment_t *experiment, const mcp_asdf_t *robots,
                                    uint32_t first, uint32_t end)
{
    const mcp_asdf_config_t config_without_filter = {
        .filter_period = 1, .memory = MCP_ASDF_MEMORY_MAX, .filter = MCP_ASDF_OFF};
    mcp_asdf_t neighbour = {.config = &config_without_filter};
    for (uint32_t sender = first; sender < end; ++sender) {
        neighbour.id = mcp_asdf_id(&robots[sender]) ^ 1; /* any id but the sender's */
        receive_from(experiment, robots, &neighbour, sender);
    }
    return neighbour.received.sums.open;
}

/* Deliver all messages to all other robots. Those with the robust filter receive one by one, in ascending
 * order of senders. The open rounds of the others, still empty, become what receiving message by message
 * would make of them, and `accepted` counts the messages; only the set of the round's senders is left empty,
 * since the round closes at once. */
static void deliver_to_all(const mcp_asdf_experiment_t *experiment, mcp_asdf_t *robots)
{
    const uint32_t count = experiment->robots;
    const mcp_asdf_open_t sums_of_all = sum_messages(experiment, robots, 0, count);
    for (uint32_t receiver = 0; receiver < count; ++receiver) {
        mcp_asdf_t *const robot = &robots[receiver];
        if (!mcp_asdf_is_robust(experiment->configs[receiver])) {
            const mcp_asdf_open_t own_message = sum_messages(experiment, robots, receiver, receiver + 1);
            robot->received.sums.open = subtract_message(sums_of_all, &own_message);
            robot->counters.accepted = (uint16_t)(robot->counters.accepted + count - 1); /* modulo 2^16 */
            continue;
        }
        for (uint32_t sender = 0; sender < count; ++sender) {
            if (sender != receiver) {
                receive_from(experiment, robots, robot, sender);
            }
        }
    }
}

/* Deliver the last message of each robot to the robots that are linked to it now: along the links of `arena`,
 * both ways, or if that is NULL along the arcs of the experiment's graph, from a to b. The order of links and
 * arcs gives each robot its messages by ascending ids: for the robust filter it matters which of two senders
 * with ids equal modulo 32 is the last. */
static void deliver_along_links(const mcp_asdf_experiment_t *experiment, mcp_asdf_t *robots,
                                const mcp_asdf_arena_t *arena)
{
    if (arena == NULL) {
        for (size_t i = 0; i < experiment->arc_count; ++i) {
            const mcp_asdf_pair_t arc = experiment->arcs[i];
            receive_from(experiment, robots, &robots[arc.b], arc.a);
        }
        return;
    }
    for (uint32_t i = 0; i < arena->link_count; ++i) {
        const mcp_asdf_pair_t link = arena->links[i];
        receive_from(experiment, robots, &robots[link.a], link.b);
        receive_from(experiment, robots, &robots[link.b], link.a);
    }
}

/* Let all robots of a trial receive the messages of one step: in a moving world along the links of `arena`,
 * both ways; else `arena` is NULL, and they receive along the arcs of the experiment's graph, one way, or in
 * fully connected swarms from all others. */
static void deliver_messages(const mcp_asdf_experiment_t *experiment, mcp_asdf_t *robots,
                             const mcp_asdf_arena_t *arena)
{
    if (trial_is_linked(experiment)) {
        deliver_along_links(experiment, robots, arena);
    } else {
        deliver_to_all(experiment, robots);
    }
}

/* Take step `step_index`, from 0, of a trial by calls of the firmware: robots receive the messages of the
 * step before if there is latency, observe if it is time, receive the messages of this step if there is no
 * latency, and settle at the end of a round. What they observe is decided by the draws in the lanes. */
void trial_step(const mcp_asdf_experiment_t *experiment, const trial_t *trial, const mcp_asdf_arena_t *arena,
                uint32_t step_index, trial_observations_t observations)
{
    const uint32_t count = experiment->robots;
    const bool is_late = experiment->latency != 0;
    const bool closes_round = trial_closes_round(experiment, step_index);
    /* Before robots observe, their x_hat and alpha are still the messages of the step before. */
    if (is_late && step_index > 0 && trial_closes_round(experiment, step_index - 1)) {
        deliver_messages(experiment, trial->robots, arena);
    }
    if (trial_observes(experiment, step_index)) {
        for (uint32_t robot = 0; robot < count; ++robot) {
            /* Lanes are counted through all rows, which have LANES of them each. */
            const uint32_t lane_index = observations.first_lane + robot * observations.parallel_trials;
            const lanes_t *const row = &observations.lanes[lane_index / LANES];
            const uint32_t is_black = lanes_is_black(row, lane_index % LANES, step_index);
            (void)mcp_asdf_observe(&trial->robots[robot], is_black ? MCP_ASDF_BLACK : MCP_ASDF_WHITE);
        }
    }
    if (!closes_round) {
        return;
    }
    if (!is_late) {
        deliver_messages(experiment, trial->robots, arena);
    }
    for (uint32_t robot = 0; robot < count; ++robot) {
        (void)mcp_asdf_settle(&trial->robots[robot]);
    }
}

/* Returns the values of a robot that the outcome keeps at the sampling interval: its own estimate x_hat and
 * alpha, the neighbours' x_bar and beta, the informed estimate x, the numbers t and n of all and of black
 * observations, and the assumed accuracy b_hat. */
static mcp_asdf_record_t record_of_robot(const mcp_asdf_t *robot)
{
    return (mcp_asdf_record_t){.beta = mcp_asdf_beta(robot),
                               .t = mcp_asdf_t_count(robot),
                               .n = mcp_asdf_n_count(robot),
                               .x_hat = mcp_asdf_x_hat(robot),
                               .alpha = mcp_asdf_alpha(robot),
                               .x_bar = mcp_asdf_x_bar(robot),
                               .x = mcp_asdf_x(robot),
                               .b_hat = mcp_asdf_b_hat(robot)};
}

/* Store the informed estimates x (Q23) after step number `step`, 0 .. T, in the outcome: as entry `step` of
 * each robot's series of x, or of the one series, robot 0's, where all robots have the same x. */
static void record_x(const mcp_asdf_experiment_t *experiment, const trial_t *trial, uint32_t step)
{
    const uint32_t columns = mcp_asdf_engine_columns(experiment);
    const size_t steps_of_series = (size_t)experiment->steps + 1; /* with step 0 */
    for (uint32_t column = 0; column < columns; ++column) {
        trial->x[column * steps_of_series + step] = mcp_asdf_x(&trial->robots[column]);
    }
}

/* Store the robots' values after step number `step`, 1 .. T, in the outcome: x always, b_hat after a step in
 * which the filter may have changed it, and all values of a robot at the sampling interval. */
void trial_record(const mcp_asdf_experiment_t *experiment, const trial_t *trial, uint32_t step)
{
    const uint32_t count = experiment->robots, interval = experiment->sampling_interval;
    const uint64_t period = steps_between_tests(experiment);
    record_x(experiment, trial, step);
    if (step % period == 0) {
        const uint64_t earlier_tests = step / period - 1;
        uint32_t *const b_hats = trial->b_hat + earlier_tests * count; /* an entry for each robot */
        for (uint32_t robot = 0; robot < count; ++robot) {
            b_hats[robot] = mcp_asdf_b_hat(&trial->robots[robot]);
        }
    }
    if (trial->records != NULL && step % interval == 0) {
        const size_t earlier_samples = step / interval - 1;
        mcp_asdf_record_t *const records = trial->records + earlier_samples * count; /* one for each robot */
        for (uint32_t robot = 0; robot < count; ++robot) {
            records[robot] = record_of_robot(&trial->robots[robot]);
        }
    }
}

/* Initialise the robots of a trial, whose ids count from 0 and repeat after 128, and store their x as that of
 * step 0. Returns the first error of mcp_asdf_init(). */
mcp_asdf_status_t trial_start(const mcp_asdf_experiment_t *experiment, const trial_t *trial)
{
    for (uint32_t robot = 0; robot < experiment->robots; ++robot) {
        const mcp_asdf_status_t status =
            mcp_asdf_init(&trial->robots[robot], experiment->configs[robot],
                          (uint8_t)(robot % MCP_ASDF_ENGINE_MAX_CONNECTED), experiment->b_hat[robot]);
        if (status != MCP_ASDF_OK) {
            return status;
        }
    }
    record_x(experiment, trial, 0);
    return MCP_ASDF_OK;
}
