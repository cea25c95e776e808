/* Trials side by side, with a lane for every robot. engine.h is the manual.
 *
 * A lane is an entry of the arrays in lanes_t, which the compiler turns into vector instructions: one
 * instruction computes the estimates of many robots. Sixteen trials of fully connected swarms take their
 * steps together, or up to eight in their arenas. Robots observe, receive (in an arena message by message)
 * and settle in lanes. The steps in which the filter may test or t reaches the memory, and the last one, are
 * taken by the firmware, in a mcp_asdf_t for each robot: before such a step the values of the lanes are
 * stored in these, and after it they are loaded again. Without lanes the firmware takes every step.
 */
#include <string.h>

#include "lanes.h"
#include "philox.h"
#include "trial.h"

/* Moving swarms run side by side, up to so many of them, if each has at most so many robots. Larger ones fill
 * rows of lanes by themselves. */
#define MAX_PARALLEL_ARENAS 8
#define MAX_ROBOTS_OF_PARALLEL_ARENA 128

/* Trials under way.
 *   uses_lanes         whether steps are taken in lanes where that is possible
 *   is_robust          whether the robots have the robust filter, which keeps messages and has no sums
 *   columns            series of x in a trial
 *   parallel_trials    how many trials run side by side. The lane of a robot has the index robot *
 *                      parallel_trials + trial, both from 0: the trial runs fastest, and the robots of a
 *                      trial are parallel_trials lanes apart. Other lanes run idle
 *   lanes              in `rows` rows of LANES. A lane index counts through all rows: it stands for lane
 *                      (lane index % LANES) of row (lane index / LANES). What decides the observations is
 *                      kept there in any case, also where no step is taken in lanes
 *   arenas             NULL, or the arena of each trial
 *   first_index        index of the first of the `active_trials` trials among those of the experiment
 *   t                  observations of each robot
 *   steps_since_load   steps in lanes since these were loaded from the robots
 *   observations_since_load
 *                      how many of these steps had observations
 *   unwritten_steps    how many of these steps have informed estimates that are not yet in the outcome */
typedef struct {
    const mcp_asdf_experiment_t *experiment;
    bool uses_lanes;
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
    uint32_t steps_since_load;
    uint32_t observations_since_load;
    uint32_t unwritten_steps;
} run_t;

/* --- Observations --- */

/* Draw the random words of four steps, from step 4 * group on, for all lanes of `count` rows: draws[i] gets
 * the words of step 4 * group + i. They are functions of the seed, the trial and the robot of a lane, and the
 * step. */
FOR_EACH_TARGET static void draw_words(lanes_t *rows, uint32_t count, uint64_t seed, uint32_t group)
{
    for (lanes_t *row = rows; row < rows + count; ++row) {
        SIDE_BY_SIDE /* the lanes: the compiler may make vectors of this loop, as no lane needs another one */
        for (uint32_t lane = 0; lane < LANES; ++lane) {
            const philox_t block = draw_block(seed, row->trial[lane], row->robot[lane], group);
            row->draws[0][lane] = block.word[0];
            row->draws[1][lane] = block.word[1];
            row->draws[2][lane] = block.word[2];
            row->draws[3][lane] = block.word[3];
        }
    }
}

/* Returns the probability that a robot observes black. On a black floor that is `black`, the probability that
 * its sensor is right; on a white floor it is 1 - black, the probability of a mistake. Probabilities are in
 * units of 2^-31; `is_floor_white` is 1 or 0. */
static uint32_t probability_of_black(uint32_t black, uint32_t is_floor_white)
{
    /* What is added to `black` gives 1 - black; it may be negative, that is modulo 2^32. The floor is random,
     * so that the processor could not predict a branch on it: the product is 0 on a black floor instead. */
    const uint32_t difference = MCP_ASDF_ENGINE_CERTAIN - 2 * black;
    return black + is_floor_white * difference;
}

/* Set black_limit in the lanes of all robots of the active trials: the probability that the robot observes
 * black in step `step_index` (from 0), in units of 2^-31. A draw of 31 bits that is below this number means
 * black (lanes_is_black()). It comes from the experiment's `black` and, in an arena, from the colour of the
 * floor under the robot. */
static void set_black_limits(const run_t *run, uint32_t step_index)
{
    const mcp_asdf_experiment_t *const experiment = run->experiment;
    for (uint32_t trial = 0; trial < run->active_trials; ++trial) {
        /* The experiment's array `black` has a probability for each trial, step and robot: to observe black
         * if the robot stands on black or, without an arena, in any case. */
        const uint32_t *black = experiment->black + (run->first_index + trial) * experiment->trial_stride +
                                step_index * experiment->step_stride;
        /* The colours under the robots of this trial, by robot: 1 is black. */
        const uint8_t *const floor_colours = run->arenas == NULL ? NULL : run->arenas[trial].black;
        uint32_t lane_index = trial; /* of robot 0; the next robot is parallel_trials lanes further */
        for (uint32_t robot = 0; robot < experiment->robots; ++robot) {
            /* 0 where there is no arena */
            const uint32_t is_floor_white = floor_colours != NULL && floor_colours[robot] == 0;
            lanes_t *const row = &run->lanes[lane_index / LANES];
            row->black_limit[lane_index % LANES] = probability_of_black(*black, is_floor_white);
            lane_index += run->parallel_trials;
            black += experiment->robot_stride;
        }
    }
}

/* Set what decides the observations of step `step_index` (from 0), the draws and the limits below which they
 * mean black, except where that has been done in an earlier step: one call of the generator draws for four
 * steps, and limits stay where nobody moves and the probabilities do not change with the step. */
static void prepare_observations(const run_t *run, uint32_t step_index)
{
    if (step_index % 4 == 0) {
        draw_words(run->lanes, run->rows, run->experiment->seed, step_index / 4);
    }
    const bool robots_move = run->arenas != NULL;
    const bool probabilities_change = run->experiment->step_stride != 0;
    if (step_index == 0 || robots_move || probabilities_change) {
        set_black_limits(run, step_index);
    }
}

/* --- Steps in lanes --- */

/* Let the robot whose lane index is `receiver` receive the message of the robot whose lane index is `sender`;
 * lanes are counted through all rows. The robust filter keeps the message; with other filters its sums are
 * added to the sums of the receiver's round. In either case the receiver's message_count grows by 1. */
IN_LOOPS void receive_in_lane(const run_t *run, uint32_t receiver, uint32_t sender)
{
    lanes_t *const receiver_row = &run->lanes[receiver / LANES];
    const lanes_t *const sender_row = &run->lanes[sender / LANES];
    const lanes_sums_t *const message = &sender_row->message_sums;
    lanes_sums_t *const round = &receiver_row->round_sums;
    const uint32_t receiver_lane = receiver % LANES, sender_lane = sender % LANES;
    ++receiver_row->message_count[receiver_lane];
    if (run->is_robust) {
        lanes_keep_estimate(receiver_row, receiver_lane, sender_row, sender_lane);
        return;
    }
    round->alpha[receiver_lane] += message->alpha[sender_lane];
    round->alpha_x_low[receiver_lane] += message->alpha_x_low[sender_lane];
    round->alpha_x_high[receiver_lane] += message->alpha_x_high[sender_lane];
}

/* Let robots receive the messages of this step along the links of their arenas, both ways, or along the arcs
 * of a graph, from a to b. Their order gives each robot its messages by ascending senders. */
static void receive_along_links(const run_t *run)
{
    const mcp_asdf_experiment_t *const experiment = run->experiment;
    const uint32_t parallel_trials = run->parallel_trials;
    if (run->arenas == NULL) {
        /* A graph: there is one trial at a time, so that the lane index of a robot is its number. */
        for (size_t i = 0; i < experiment->arc_count; ++i) {
            receive_in_lane(run, experiment->arcs[i].b, experiment->arcs[i].a);
        }
        return;
    }
    for (uint32_t trial = 0; trial < run->active_trials; ++trial) {
        const mcp_asdf_pair_t *const links = run->arenas[trial].links;
        const uint32_t link_count = run->arenas[trial].link_count;
        for (uint32_t i = 0; i < link_count; ++i) {
            /* links[i] has the numbers of two robots, a and b: these are the indices of their lanes. */
            const uint32_t lane_of_a = links[i].a * parallel_trials + trial,
                           lane_of_b = links[i].b * parallel_trials + trial;
            receive_in_lane(run, lane_of_a, lane_of_b);
            receive_in_lane(run, lane_of_b, lane_of_a);
        }
    }
}

/* Add the messages of robots 1 to `robots` - 1 of each trial to the sums of the round of its robot 0, which
 * are 0 before. For fully connected swarms, whose first row has robot 0 of LANES trials, a trial in each
 * lane, the second row robot 1, and so on. Only robot 0 gets sums, as in such a swarm all robots have the
 * same x; its own message is left out, as settling adds it. */
FOR_EACH_TARGET static void sum_all_messages(lanes_t *rows, uint32_t robots)
{
    lanes_sums_t all = rows->round_sums; /* of row 0: all 0 since its last round was closed */
    for (const lanes_t *row = rows + 1; row < rows + robots; ++row) { /* from robot 1 on */
        for (uint32_t lane = 0; lane < LANES; ++lane) {
            all.alpha[lane] += row->message_sums.alpha[lane];
            all.alpha_x_low[lane] += row->message_sums.alpha_x_low[lane];
            all.alpha_x_high[lane] += row->message_sums.alpha_x_high[lane];
        }
    }
    rows->round_sums = all;
}

/* Let all robots of the active trials receive the messages of one step: along the links of their arenas or
 * the arcs of a graph, or in fully connected swarms from all others. In either case the robust filter keeps
 * the messages as estimates, and with other filters they are added to the sums of the round. */
static void deliver_messages(const run_t *run)
{
    if (trial_is_linked(run->experiment)) {
        receive_along_links(run); /* for all filters */
    } else if (run->is_robust) {
        lanes_keep_all_estimates(run->lanes, run->rows);
    } else {
        sum_all_messages(run->lanes, run->rows);
    }
}

/* Returns the number of rows that have informed estimates: a trial with one series of x has robot 0's, in the
 * first row. */
static uint32_t count_rows_with_x(const run_t *run) { return run->columns == 1 ? 1 : run->rows; }

/* Transpose the informed estimates of a row: x[step][lane], in which the lanes of a step are side by side, to
 * series[lane][step], in which the steps of a lane are. */
static void transpose_row(uint32_t series[LANES][STEPS_IN_ROW], const lanes_t *row)
{
    for (uint32_t step = 0; step < STEPS_IN_ROW; ++step) {
        for (uint32_t lane = 0; lane < LANES; ++lane) {
            series[lane][step] = row->x[step][lane];
        }
    }
}

/* Write the informed estimates of the unwritten steps, of which `last_step` (1 .. T) is the last, from the
 * lanes into the outcome, and set unwritten_steps to 0. Each series gets all these steps at once: if every
 * step were written by itself, each value would wait for a page of memory of its own. */
static void write_informed_estimates(run_t *run, uint32_t last_step)
{
    const size_t steps_of_series = (size_t)run->experiment->steps + 1; /* with step 0 */
    const size_t first_step = (size_t)last_step + 1 - run->unwritten_steps;
    const uint32_t rows = run->unwritten_steps == 0 ? 0 : count_rows_with_x(run);
    uint32_t series[LANES][STEPS_IN_ROW];
    for (uint32_t row = 0; row < rows; ++row) {
        transpose_row(series, &run->lanes[row]);
        for (uint32_t lane = 0; lane < LANES; ++lane) {
            /* Lanes are counted through all rows, first robot 0 of all trials, then robot 1, and so on. A
             * trial has a series, or column, of x for each robot, or for robot 0 alone. */
            const uint32_t lane_index = row * LANES + lane;
            const uint32_t column = lane_index / run->parallel_trials;
            const uint32_t trial = lane_index % run->parallel_trials;
            const bool is_idle = column >= run->columns || trial >= run->active_trials;
            if (!is_idle) {
                /* A trial's x has the shape [columns][T + 1], steps running fastest. */
                uint32_t *const x = run->trials[trial].x + column * steps_of_series;
                memcpy(x + first_step, series[lane], run->unwritten_steps * sizeof *x);
            }
        }
    }
    run->unwritten_steps = 0;
}

/* End the round of all lanes in step number `step`, 1 .. T, and keep the informed estimates after it in the
 * lanes, where unwritten_steps counts it; when the lanes have no room for another step, all are written into
 * the outcome. */
static void settle_lanes(run_t *run, uint32_t step)
{
    const uint32_t x_index = run->unwritten_steps; /* the first free place of the lanes for estimates */
    if (run->is_robust) {
        lanes_settle_votes(run->lanes, run->rows, x_index);
    } else {
        lanes_settle_sums(run->lanes, count_rows_with_x(run), x_index);
    }
    ++run->unwritten_steps;
    if (run->unwritten_steps == STEPS_IN_ROW) {
        write_informed_estimates(run, step);
    }
}

/* Take step `step_index`, from 0, of all active trials in lanes, that is without the firmware: all robots
 * observe, if it is time, receive the messages, and end the round. With a latency robots receive the messages
 * of the step before, and so before they observe: until then their estimates are still those messages. Before
 * step 0 there were none. Without a latency they receive after they have observed. Arenas have already moved
 * for this step. */
static void step_lanes(run_t *run, uint32_t step_index)
{
    const bool is_late = run->experiment->latency != 0;
    if (is_late && step_index > 0) {
        deliver_messages(run);
    }
    if (trial_observes(run->experiment, step_index)) {
        ++run->t;
        lanes_observe(run->lanes, run->rows, run->t, step_index);
        ++run->observations_since_load;
    }
    if (!is_late) {
        deliver_messages(run);
    }
    settle_lanes(run, step_index + 1); /* results count steps from 1, as step 0 is the start */
    ++run->steps_since_load;
}

/* --- Steps of the firmware --- */

/* Store in a robot of the firmware what the steps in lanes since the last load have made of it: the numbers t
 * and n of all and of black observations, x_hat and alpha, `updated`, the memory of the robust filter. Move
 * two of its counters on by these steps: filter_left, the rounds until its filter runs, falls, and the number
 * of accepted messages grows. `robot_index` and `trial` count from 0. What the robot's next step forms anew
 * is left as it is. */
static void store_in_robot(const run_t *run, uint32_t robot_index, uint32_t trial)
{
    mcp_asdf_t *const robot = &run->trials[trial].robots[robot_index];
    /* Lanes are counted through all rows, LANES in each: first robot 0 of all trials, then robot 1, and so
     * on. */
    const uint32_t lane_index = robot_index * run->parallel_trials + trial;
    const lanes_t *const row = &run->lanes[lane_index / LANES];
    const uint32_t lane = lane_index % LANES;
    /* In fully connected swarms lanes count no messages: in each step a robot gets one from each of the
     * others. */
    const uint32_t messages_of_others = run->steps_since_load * (run->experiment->robots - 1);
    const uint32_t messages =
        trial_is_linked(run->experiment) ? row->message_count[lane] : messages_of_others;
    robot->t = run->t;
    robot->n = row->n[lane];
    robot->x_hat = row->x_hat[lane];
    robot->alpha = row->alpha[lane];
    if (run->observations_since_load != 0) {
        robot->updated = 0; /* as mcp_asdf_observe() would have set it */
    }
    /* Each step is a round. It stays above 0, as the firmware takes the step in which the filter runs. */
    robot->filter_left -= run->steps_since_load;
    robot->counters.accepted = (uint16_t)(robot->counters.accepted + messages); /* modulo 2^16 */
    lanes_store_filter(row, lane, robot);
}

/* Load the values of all robots into the lanes, from which the next steps there go on, and count no steps, no
 * observations and no messages since then. Idle lanes, to which no robot of an active trial belongs, get the
 * values of robot 0 or of trial 0, so that they hold possible numbers. */
static void load_lanes_from_robots(run_t *run)
{
    const uint32_t robots = run->experiment->robots, parallel_trials = run->parallel_trials;
    run->t = mcp_asdf_t_count(&run->trials[0].robots[0]); /* all robots have made equally many observations */
    run->steps_since_load = 0;
    run->observations_since_load = 0;
    for (uint32_t lane_index = 0; lane_index < run->rows * LANES; ++lane_index) {
        const uint32_t robot_of_lane = lane_index / parallel_trials;
        const uint32_t trial_of_lane = lane_index % parallel_trials;
        const uint32_t robot = robot_of_lane < robots ? robot_of_lane : 0;
        const uint32_t trial = trial_of_lane < run->active_trials ? trial_of_lane : 0;
        lanes_t *const row = &run->lanes[lane_index / LANES];
        const uint32_t lane = lane_index % LANES;
        row->message_count[lane] = 0;
        lanes_load_robot(row, lane, &run->trials[trial].robots[robot]);
    }
}

/* Whether the firmware has to take step `step_index`, from 0, as lanes cannot: always if the run is not to
 * take steps in lanes; else at a test of the filter, where t reaches the memory, and in the last step, after
 * which the robots are results. */
static bool needs_firmware(const run_t *run, uint32_t step_index)
{
    const mcp_asdf_experiment_t *const experiment = run->experiment;
    const mcp_asdf_config_t *const config = experiment->configs[0];
    const uint32_t steps_taken = step_index + 1;                   /* with this one */
    const bool is_test = steps_taken % config->filter_period == 0; /* with lanes each step is a round */
    const bool is_last_step = steps_taken == experiment->steps;
    const bool fills_memory = run->t + 1 == config->memory && trial_observes(experiment, step_index);
    return !run->uses_lanes || is_test || is_last_step || fills_memory;
}

/* Store what the steps in lanes have made of the robots of all active trials in these robots. */
static void store_lanes_in_robots(const run_t *run)
{
    for (uint32_t trial = 0; trial < run->active_trials; ++trial) {
        for (uint32_t robot_index = 0; robot_index < run->experiment->robots; ++robot_index) {
            store_in_robot(run, robot_index, trial);
        }
    }
}

/* Take step `step_index`, from 0, of all active trials by calls of the firmware, for each robot in its
 * mcp_asdf_t, and record in the outcome the results of this step.
 *
 * In a run that takes steps in lanes (arrays with an entry for each robot), informed estimates of earlier
 * steps that are not in the outcome yet are written there first. Then the values of the lanes are stored in
 * the robots, and after the step the lanes are loaded from the robots again. */
static void step_firmware(run_t *run, uint32_t step_index)
{
    const uint32_t step = step_index + 1; /* in results, where step 0 is the start */
    write_informed_estimates(run, step - 1);
    if (run->uses_lanes) {
        store_lanes_in_robots(run);
    }
    for (uint32_t trial = 0; trial < run->active_trials; ++trial) {
        const mcp_asdf_arena_t *const arena = run->arenas == NULL ? NULL : &run->arenas[trial];
        /* The lanes hold the draws that decide the observations, also where no step is taken in lanes. */
        const trial_observations_t observations = {
            .lanes = run->lanes, .first_lane = trial, .parallel_trials = run->parallel_trials};
        trial_step(run->experiment, &run->trials[trial], arena, step_index, observations);
        trial_record(run->experiment, &run->trials[trial], step);
    }
    if (run->uses_lanes) {
        load_lanes_from_robots(run);
    }
}

/* --- Runs --- */

/* Give each lane the numbers of its robot and its trial, which decide its random draws, and set all its other
 * values to 0. Lanes are counted through all rows: first come the lanes of robot 0, one for each trial that
 * runs beside the others, then the lanes of robot 1, and so on. The active trials begin with the trial that
 * has this index in the experiment, from 0. Lanes of other trials are idle, and draw as that trial does. */
static void number_lanes(run_t *run, uint32_t index)
{
    memset(run->lanes, 0, run->rows * sizeof *run->lanes);
    for (uint32_t lane_index = 0; lane_index < run->rows * LANES; ++lane_index) {
        const uint32_t robot = lane_index / run->parallel_trials;
        const uint32_t parallel_trial = lane_index % run->parallel_trials;
        const bool is_idle = parallel_trial >= run->active_trials;
        const uint32_t index_of_trial = is_idle ? index : index + parallel_trial;
        lanes_t *const row = &run->lanes[lane_index / LANES];
        const uint32_t lane = lane_index % LANES;
        row->trial[lane] = run->experiment->first_trial + index_of_trial;
        row->robot[lane] = robot;
    }
}

/* Start the trials of the experiment from `index` on, as many as run side by side or are left: initialise
 * their robots and arenas, store step 0 in the outcome, and load the lanes. The arenas take the memory behind
 * the array of their structs. Returns the first error of mcp_asdf_init(), or MCP_ASDF_ERR_CONFIG if robots
 * find no room in their arena. */
static mcp_asdf_status_t start_trials(run_t *run, const mcp_asdf_outcome_t *outcome, uint32_t index)
{
    const mcp_asdf_experiment_t *const experiment = run->experiment;
    const uint32_t trials_left = experiment->trials - index;
    uint8_t *arena_memory = (void *)(run->arenas + run->parallel_trials);
    run->first_index = index;
    run->active_trials = trials_left < run->parallel_trials ? trials_left : run->parallel_trials;
    run->unwritten_steps = 0;
    for (uint32_t trial = 0; trial < run->active_trials; ++trial) {
        run->trials[trial] = trial_outcome(experiment, outcome, index + trial);
        const mcp_asdf_status_t status = trial_start(experiment, &run->trials[trial]);
        if (status != MCP_ASDF_OK) {
            return status;
        }
        if (experiment->arenas != NULL) {
            const mcp_asdf_arena_config_t *const world = &experiment->arenas[index + trial];
            if (!mcp_asdf_arena_init(&run->arenas[trial], world, arena_memory)) {
                return MCP_ASDF_ERR_CONFIG;
            }
            arena_memory += mcp_asdf_arena_bytes(world);
        }
    }
    number_lanes(run, index);
    load_lanes_from_robots(run);
    return MCP_ASDF_OK;
}

/* Run the trials of the experiment from `index` on, as many as run side by side or are left, from their first
 * step to the last. Returns the first error of start_trials(). */
static mcp_asdf_status_t run_trials(run_t *run, const mcp_asdf_outcome_t *outcome, uint32_t index)
{
    const mcp_asdf_status_t status = start_trials(run, outcome, index);
    if (status != MCP_ASDF_OK) {
        return status;
    }
    for (uint32_t step_index = 0; step_index < run->experiment->steps; ++step_index) {
        if (run->arenas != NULL) {
            mcp_asdf_arena_step(run->arenas, run->active_trials);
        }
        prepare_observations(run, step_index);
        if (needs_firmware(run, step_index)) {
            step_firmware(run, step_index);
        } else {
            step_lanes(run, step_index);
        }
    }
    return MCP_ASDF_OK;
}

/* Whether the engine can compute this experiment in lanes, with many robots side by side. Lanes deliver
 * messages in every step, exact ones, record nothing but x, have no liars, and either all robots have the
 * robust filter or none has. */
bool mcp_asdf_engine_has_lanes(const mcp_asdf_experiment_t *experiment)
{
    const bool is_first_robot_robust = mcp_asdf_is_robust(experiment->configs[0]);
    const bool is_recorded = experiment->sampling_interval != 0, is_rounded = experiment->x_hat_bits != 0;
    if (experiment->comms_period != 1 || is_recorded || experiment->liars != 0 || is_rounded) {
        return false;
    }
    for (uint32_t robot = 1; robot < experiment->robots; ++robot) {
        if (mcp_asdf_is_robust(experiment->configs[robot]) != is_first_robot_robust) {
            return false;
        }
    }
    return true;
}

/* Returns dividend / divisor, rounded up, for a divisor above 0. */
static uint32_t divide_rounding_up(uint32_t dividend, uint32_t divisor)
{
    return (dividend + divisor - 1) / divisor;
}

/* Returns the number of trials that run side by side in lanes, by the kind of the experiment:
 *
 *     fully connected swarms (no arenas, no graph)   LANES: a row then has the same robot of LANES trials
 *     moving swarms (arenas) of up to 128 robots     up to 8, and not more than there are trials. The trials
 *                                                    are divided into as few runs as possible, of about the
 *                                                    same size: 9 trials run as 5 and 4
 *     larger moving swarms, graphs; no trials        1: a row has robots of one trial */
static uint32_t count_parallel_trials(const mcp_asdf_experiment_t *experiment)
{
    if (!trial_is_linked(experiment)) { /* fully connected */
        return LANES;
    }
    const bool is_graph = experiment->arenas == NULL;
    if (is_graph || experiment->robots > MAX_ROBOTS_OF_PARALLEL_ARENA || experiment->trials == 0) {
        return 1;
    }
    const uint32_t runs = divide_rounding_up(experiment->trials, MAX_PARALLEL_ARENAS);
    return divide_rounding_up(experiment->trials, runs);
}

/* Returns the number of rows that have a lane for each robot of so many trials side by side. */
static uint32_t count_rows(const mcp_asdf_experiment_t *experiment, uint32_t parallel_trials)
{
    return divide_rounding_up(experiment->robots * parallel_trials, LANES);
}

/* Returns the bytes that a run needs at most: lanes, arenas, and some to align the lanes. All arenas of an
 * experiment take equally many. */
size_t mcp_asdf_engine_bytes(const mcp_asdf_experiment_t *experiment)
{
    const uint32_t parallel_trials = count_parallel_trials(experiment);
    size_t arena_bytes = 0;
    if (experiment->arenas != NULL && experiment->trials != 0) {
        arena_bytes = sizeof(mcp_asdf_arena_t) + mcp_asdf_arena_bytes(experiment->arenas);
    }
    const size_t lane_bytes = count_rows(experiment, parallel_trials) * sizeof(lanes_t);
    const size_t alignment_bytes = VECTOR_BYTES - 1; /* at most so many are left out before the lanes */
    return alignment_bytes + lane_bytes + parallel_trials * arena_bytes;
}

/* Run all trials, as many at a time as run side by side, and store their results in the outcome. `memory` has
 * mcp_asdf_engine_bytes(): the lanes come first, aligned for vectors, and then the arenas. Returns the first
 * error; the outcome is then incomplete. */
mcp_asdf_status_t mcp_asdf_engine_run(const mcp_asdf_experiment_t *experiment, bool in_lanes,
                                      const mcp_asdf_outcome_t *outcome, void *memory)
{
    mcp_asdf_status_t status = MCP_ASDF_OK;
    const uint32_t parallel_trials = in_lanes ? count_parallel_trials(experiment) : 1;
    const uint32_t rows = count_rows(experiment, parallel_trials);
    lanes_t *const first_row = (void *)((uint8_t *)memory + bytes_before_vector(memory));
    run_t run = {.experiment = experiment,
                 .uses_lanes = in_lanes,
                 .is_robust = mcp_asdf_is_robust(experiment->configs[0]),
                 .columns = mcp_asdf_engine_columns(experiment),
                 .parallel_trials = parallel_trials,
                 .rows = rows,
                 .lanes = first_row,
                 .arenas = experiment->arenas == NULL ? NULL : (void *)(first_row + rows)};
    for (uint32_t index = 0; index < experiment->trials && status == MCP_ASDF_OK; index += parallel_trials) {
        status = run_trials(&run, outcome, index);
    }
    return status;
}
