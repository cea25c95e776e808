/* Trials side by side, with a lane for every robot. engine.h is the manual.
 *
 * Sixteen trials of fully connected swarms take their steps together, or up to eight in their arenas. Robots
 * observe, receive (in an arena message by message) and settle in lanes. The steps in which the filter may
 * test or t reaches the memory, and the last one, are the firmware's own: before them what the lanes have
 * changed is stored in the robots. Without lanes the firmware takes every step.
 */
#include <string.h>

#include "lanes.h"
#include "philox.h"
#include "trial.h"

/* Moving swarms side by side, of up to MCP_ASDF_ENGINE_MAX_CONNECTED robots. */
#define MAX_PARALLEL_ARENAS 8

/* Trials under way.
 *   has_lanes          whether steps are taken in lanes where that is possible
 *   is_robust          whether the robots have the robust filter: messages are votes, and there are no sums
 *   columns            series of x in a trial
 *   parallel_trials    lane j parallel_trials + l is robot j of trial l, both from 0; other lanes run idle
 *   lanes              in `rows` rows
 *   arenas             NULL, or the arena of each trial
 *   first_index        index of the first of the `active_trials` trials among those of the experiment
 *   t                  observations of each robot
 *   ticks              steps in lanes since the last one of the firmware
 *   observation_count  how many of these had observations
 *   unwritten_steps    how many of these have informed estimates that are not yet in the outcome */
typedef struct {
    const mcp_asdf_experiment_t *experiment;
    bool has_lanes;
    bool is_robust;
    uint32_t columns;
    uint32_t parallel_trials;
    uint32_t rows;
    lanes_t *lanes;
    mcp_asdf_arena_t *arenas;
    uint32_t first_index;
    uint32_t active_trials;
    trial_t trials[LANES];
    uint32_t t;
    uint32_t ticks;
    uint32_t observation_count;
    uint32_t unwritten_steps;
} run_t;

/* --- Observations --- */

/* Draw the random words of steps 4 group .. 4 group + 3. */
FOR_EACH_TARGET static void draw_words(lanes_t *rows, uint32_t count, uint64_t seed, uint32_t group)
{
    for (lanes_t *row = rows; row < rows + count; ++row) {
        SIDE_BY_SIDE
        for (uint32_t l = 0; l < LANES; ++l) {
            const philox_t block = draws(seed, row->trial[l], row->robot[l], group);
            row->draws[0][l] = block.word[0];
            row->draws[1][l] = block.word[1];
            row->draws[2][l] = block.word[2];
            row->draws[3][l] = block.word[3];
        }
    }
}

/* Set the limits of step k: the probability of black, which on a white floor is that of a mistake. The floor
 * is random, so a branch on it could not be predicted. */
static void set_black_limits(const run_t *run, uint32_t k)
{
    const mcp_asdf_experiment_t *const experiment = run->experiment;
    for (uint32_t l = 0; l < run->active_trials; ++l) {
        const uint32_t *black = experiment->black + (run->first_index + l) * experiment->trial_stride +
                                k * experiment->step_stride;
        const uint8_t *const floor = run->arenas == NULL ? NULL : run->arenas[l].black;
        uint32_t lane = l;
        for (uint32_t j = 0; j < experiment->robots; ++j) {
            const uint32_t is_white = floor != NULL && floor[j] == 0;
            run->lanes[lane / LANES].black_limit[lane % LANES] =
                *black + is_white * (MCP_ASDF_ENGINE_CERTAIN - 2 * *black);
            lane += run->parallel_trials;
            black += experiment->robot_stride;
        }
    }
}

/* Draw and set what decides the observations of step k, unless that has been done for an earlier step. */
static void prepare_observations(const run_t *run, uint32_t k)
{
    if (k % 4 == 0) {
        draw_words(run->lanes, run->rows, run->experiment->seed, k / 4);
    }
    if (k == 0 || run->arenas != NULL || run->experiment->step_stride != 0) {
        set_black_limits(run, k);
    }
}

/* --- Steps in lanes --- */

/* Let lane `receiver` receive the message of lane `sender`. */
IN_LOOPS void receive_in_lane(const run_t *run, uint32_t receiver, uint32_t sender)
{
    lanes_t *const receiver_row = &run->lanes[receiver / LANES];
    const lanes_t *const sender_row = &run->lanes[sender / LANES];
    const uint32_t to = receiver % LANES, from = sender % LANES;
    ++receiver_row->message_count[to];
    if (run->is_robust) {
        lanes_receive_vote(receiver_row, to, sender_row, from);
        return;
    }
    receiver_row->round_sums.alpha[to] += sender_row->message_sums.alpha[from];
    receiver_row->round_sums.alpha_x_low[to] += sender_row->message_sums.alpha_x_low[from];
    receiver_row->round_sums.alpha_x_high[to] += sender_row->message_sums.alpha_x_high[from];
}

/* Deliver messages along links or arcs, whose order gives each robot its messages by ascending senders. */
static void receive_along_links(const run_t *run)
{
    const mcp_asdf_experiment_t *const experiment = run->experiment;
    const uint32_t parallel_trials = run->parallel_trials;
    for (uint32_t l = 0; l < run->active_trials && run->arenas != NULL; ++l) {
        const mcp_asdf_pair_t *const links = run->arenas[l].links;
        const uint32_t count = run->arenas[l].link_count;
        for (uint32_t p = 0; p < count; ++p) {
            const uint32_t a = links[p].a * parallel_trials + l, b = links[p].b * parallel_trials + l;
            receive_in_lane(run, a, b);
            receive_in_lane(run, b, a);
        }
    }
    for (size_t p = 0; experiment->arcs != NULL && p < experiment->arc_count; ++p) {
        receive_in_lane(run, experiment->arcs[p].b, experiment->arcs[p].a);
    }
}

/* Form the sums over all robots of each trial, and keep them with its first robot: in a fully connected swarm
 * all robots have the same x. */
FOR_EACH_TARGET static void sum_all_messages(lanes_t *rows, uint32_t robots)
{
    lanes_sums_t all = rows->round_sums;
    for (const lanes_t *row = rows + 1; row < rows + robots; ++row) {
        for (uint32_t l = 0; l < LANES; ++l) {
            all.alpha[l] += row->message_sums.alpha[l];
            all.alpha_x_low[l] += row->message_sums.alpha_x_low[l];
            all.alpha_x_high[l] += row->message_sums.alpha_x_high[l];
        }
    }
    rows->round_sums = all;
}

/* Deliver the messages of one step in lanes. */
static void deliver_messages(const run_t *run)
{
    if (trial_is_linked(run->experiment)) {
        receive_along_links(run);
    } else if (run->is_robust) {
        lanes_receive_all_votes(run->lanes, run->rows);
    } else {
        sum_all_messages(run->lanes, run->rows);
    }
}

/* Write the estimates of the unwritten steps up to `step` into the outcome, series by series: written one by
 * one, each value would wait for a page of memory of its own. */
static void write_series(run_t *run, uint32_t step)
{
    const size_t first_step = (size_t)step + 1 - run->unwritten_steps;
    const size_t size = run->unwritten_steps * sizeof(uint32_t);
    uint32_t series[LANES][STEPS_IN_ROW];
    for (uint32_t lane = 0; lane < run->columns * run->parallel_trials && run->unwritten_steps != 0; ++lane) {
        const uint32_t j = lane / run->parallel_trials, l = lane % run->parallel_trials;
        /* At the first lane of a row its steps by lanes become lanes by steps. */
        for (uint32_t k = 0; k < LANES * STEPS_IN_ROW && lane % LANES == 0; ++k) {
            series[k % LANES][k / LANES] = run->lanes[lane / LANES].x[k / LANES][k % LANES];
        }
        if (l < run->active_trials) {
            uint32_t *const x = run->trials[l].x + j * ((size_t)run->experiment->steps + 1);
            memcpy(x + first_step, series[lane % LANES], size);
        }
    }
    run->unwritten_steps = 0;
}

/* End the round of all lanes, and keep the informed estimates after `step`. */
static void settle_lanes(run_t *run, uint32_t step)
{
    if (run->is_robust) {
        lanes_settle_votes(run->lanes, run->rows, run->unwritten_steps);
    } else {
        lanes_settle_sums(run->lanes, run->columns == 1 ? 1 : run->rows, run->unwritten_steps);
    }
    if (++run->unwritten_steps == STEPS_IN_ROW) {
        write_series(run, step);
    }
}

/* Take step k, from 0, in lanes; arenas have moved for it. Until robots observe, their messages are still
 * those of the step before; before step 0 there were none. */
static void step_lanes(run_t *run, uint32_t k)
{
    const bool is_late = run->experiment->latency != 0;
    if (is_late && k > 0) {
        deliver_messages(run);
    }
    if (trial_observes(run->experiment, k)) {
        lanes_observe(run->lanes, run->rows, ++run->t, k);
        ++run->observation_count;
    }
    if (!is_late) {
        deliver_messages(run);
    }
    settle_lanes(run, k + 1);
    ++run->ticks;
}

/* --- Steps of the firmware --- */

/* Give robot j of trial l the state after the steps in lanes, except for members that its next step forms
 * anew. */
static void store_in_robot(const run_t *run, uint32_t j, uint32_t l)
{
    const uint32_t lane = j * run->parallel_trials + l, column = lane % LANES;
    const uint32_t messages_of_all = run->ticks * (run->experiment->robots - 1);
    const lanes_t *const row = &run->lanes[lane / LANES];
    mcp_asdf_t *const robot = &run->trials[l].robots[j];
    const uint32_t messages = trial_is_linked(run->experiment) ? row->message_count[column] : messages_of_all;
    robot->t = run->t;
    robot->n = row->n[column];
    robot->x_hat = row->x_hat[column];
    robot->alpha = row->alpha[column];
    robot->updated = run->observation_count == 0 ? robot->updated : 0;
    robot->filter_left -= run->ticks;
    robot->counters.accepted = (uint16_t)(robot->counters.accepted + messages);
    lanes_store_filter(row, column, robot);
}

/* Begin steps in lanes with the values of the robots. Idle lanes have those of robot 0 or trial 0. */
static void load_lanes(run_t *run)
{
    const uint32_t robots = run->experiment->robots, parallel_trials = run->parallel_trials;
    run->t = mcp_asdf_t_count(&run->trials[0].robots[0]);
    run->ticks = run->observation_count = 0;
    for (uint32_t lane = 0; lane < run->rows * LANES; ++lane) {
        const uint32_t j = lane / parallel_trials, l = lane % parallel_trials;
        lanes_t *const row = &run->lanes[lane / LANES];
        row->message_count[lane % LANES] = 0;
        lanes_load_robot(row, lane % LANES,
                         &run->trials[l < run->active_trials ? l : 0].robots[j < robots ? j : 0]);
    }
}

/* Whether the firmware has to take step k itself. */
static bool needs_firmware(const run_t *run, uint32_t k)
{
    const mcp_asdf_experiment_t *const experiment = run->experiment;
    const mcp_asdf_config_t *const config = experiment->configs[0];
    return !run->has_lanes || (k + 1) % config->filter_period == 0 || k + 1 == experiment->steps ||
           (run->t + 1 == config->memory && trial_observes(experiment, k));
}

/* Take step k, from 0, by the firmware in all trials, and record it. */
static void step_firmware(run_t *run, uint32_t k)
{
    const mcp_asdf_experiment_t *const experiment = run->experiment;
    write_series(run, k);
    for (uint32_t l = 0; l < run->active_trials; ++l) {
        const mcp_asdf_arena_t *const arena = run->arenas == NULL ? NULL : &run->arenas[l];
        for (uint32_t j = 0; j < experiment->robots && run->has_lanes; ++j) {
            store_in_robot(run, j, l);
        }
        trial_tick(experiment, &run->trials[l], arena, k,
                   (trial_observations_t){run->lanes, l, run->parallel_trials});
        trial_record(experiment, &run->trials[l], k + 1);
    }
    if (run->has_lanes) {
        load_lanes(run);
    }
}

/* --- Runs --- */

/* Start the next active trials, of which the first has this index. `memory` behind the arenas' structs is
 * theirs. Fails as mcp_asdf_engine_run(). */
static mcp_asdf_status_t start_trials(run_t *run, const mcp_asdf_outcome_t *outcome, uint32_t index)
{
    const mcp_asdf_experiment_t *const experiment = run->experiment;
    const uint32_t rest = experiment->trials - index;
    uint8_t *memory = (void *)(run->arenas + run->parallel_trials);
    run->first_index = index;
    run->active_trials = rest < run->parallel_trials ? rest : run->parallel_trials;
    run->unwritten_steps = 0;
    for (uint32_t l = 0; l < run->active_trials; ++l) {
        run->trials[l] = trial_outcome(experiment, outcome, index + l);
        const mcp_asdf_status_t status = trial_start(experiment, &run->trials[l]);
        if (status != MCP_ASDF_OK) {
            return status;
        }
        if (experiment->arenas != NULL) {
            const mcp_asdf_arena_config_t *const world = &experiment->arenas[index + l];
            if (!mcp_asdf_arena_init(&run->arenas[l], world, memory)) {
                return MCP_ASDF_ERR_CONFIG;
            }
            memory += mcp_asdf_arena_bytes(world);
        }
    }
    memset(run->lanes, 0, run->rows * sizeof *run->lanes);
    for (uint32_t lane = 0; lane < run->rows * LANES; ++lane) {
        const uint32_t l = lane % run->parallel_trials;
        run->lanes[lane / LANES].trial[lane % LANES] =
            experiment->first_trial + index + (l < run->active_trials ? l : 0);
        run->lanes[lane / LANES].robot[lane % LANES] = lane / run->parallel_trials;
    }
    load_lanes(run);
    return MCP_ASDF_OK;
}

/* Run the next active trials from their first step to the last. Fails as start_trials(). */
static mcp_asdf_status_t run_trials(run_t *run, const mcp_asdf_outcome_t *outcome, uint32_t index)
{
    const mcp_asdf_status_t status = start_trials(run, outcome, index);
    for (uint32_t k = 0; k < run->experiment->steps && status == MCP_ASDF_OK; ++k) {
        if (run->arenas != NULL) {
            mcp_asdf_arena_step(run->arenas, run->active_trials);
        }
        prepare_observations(run, k);
        if (needs_firmware(run, k)) {
            step_firmware(run, k);
        } else {
            step_lanes(run, k);
        }
    }
    return status;
}

bool mcp_asdf_engine_has_lanes(const mcp_asdf_experiment_t *experiment)
{
    bool has_lanes =
        experiment->comms_period == 1 && experiment->sampling_interval == 0 && experiment->liars == 0;
    for (uint32_t j = 1; j < experiment->robots && has_lanes; ++j) {
        has_lanes = mcp_asdf_is_robust(experiment->configs[j]) == mcp_asdf_is_robust(experiment->configs[0]);
    }
    return has_lanes;
}

/* Number of trials that run side by side in lanes. */
static uint32_t count_parallel_trials(const mcp_asdf_experiment_t *experiment)
{
    if (!trial_is_linked(experiment)) {
        return LANES;
    }
    if (experiment->arenas == NULL || experiment->robots > MCP_ASDF_ENGINE_MAX_CONNECTED ||
        experiment->trials == 0) {
        return 1;
    }
    /* The trials are divided into runs of about the same size. */
    const uint32_t runs = (experiment->trials + MAX_PARALLEL_ARENAS - 1) / MAX_PARALLEL_ARENAS;
    return (experiment->trials + runs - 1) / runs;
}

/* Number of rows of lanes for so many trials side by side. */
static uint32_t count_rows(const mcp_asdf_experiment_t *experiment, uint32_t parallel_trials)
{
    return (experiment->robots * parallel_trials + LANES - 1) / LANES;
}

size_t mcp_asdf_engine_bytes(const mcp_asdf_experiment_t *experiment)
{
    const uint32_t parallel_trials = count_parallel_trials(experiment);
    const size_t arena_bytes = experiment->arenas == NULL || experiment->trials == 0
                                   ? 0
                                   : sizeof(mcp_asdf_arena_t) + mcp_asdf_arena_bytes(experiment->arenas);
    return VECTOR_BYTES - 1 + count_rows(experiment, parallel_trials) * sizeof(lanes_t) +
           parallel_trials * arena_bytes;
}

mcp_asdf_status_t mcp_asdf_engine_run(const mcp_asdf_experiment_t *experiment, bool lanes,
                                      const mcp_asdf_outcome_t *outcome, void *memory)
{
    mcp_asdf_status_t status = MCP_ASDF_OK;
    const uint32_t parallel_trials = lanes ? count_parallel_trials(experiment) : 1;
    const uint32_t rows = count_rows(experiment, parallel_trials);
    lanes_t *const first_row = (void *)((uint8_t *)memory + -(uintptr_t)memory % VECTOR_BYTES);
    run_t run = {.experiment = experiment,
                 .has_lanes = lanes,
                 .is_robust = mcp_asdf_is_robust(experiment->configs[0]),
                 .columns = mcp_asdf_engine_columns(experiment),
                 .parallel_trials = parallel_trials,
                 .rows = rows,
                 .lanes = first_row,
                 .arenas = experiment->arenas == NULL ? NULL : (void *)(first_row + rows)};
    for (uint32_t i = 0; i < experiment->trials && status == MCP_ASDF_OK; i += parallel_trials) {
        status = run_trials(&run, outcome, i);
    }
    return status;
}
