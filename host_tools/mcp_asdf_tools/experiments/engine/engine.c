/* Trials side by side, with a lane for every robot. engine.h is the manual.
 *
 * Sixteen trials of fully connected swarms take their steps together, or one in its arena. Robots observe,
 * hear (in an arena message by message) and settle in lanes; the steps in which the filter may run or t
 * reaches the memory, and the last one, are the firmware's own: before them the lanes hand over what they
 * changed. Without lanes every step is its own.
 */
#include "lanes.h"
#include "philox.h"
#include "trial.h"

#define MULTIPLE 8 /* of lanes in use, so that vectors are full */

/* Trials under way; lanes beyond the last trial or robot run idle.
 *   is_robust  whether the robots have the robust filter: messages are votes then, and there are no sums
 *   columns   series of x in a trial
 *   index     of the first trial
 *   used      trials in use, of `side` side by side
 *   count     lanes in use: lane j side + l is robot j of trial l, here and in all arrays below
 *   trial_of, robot_of  whose draws a lane has
 *   words     draws of four steps
 *   limit     of a draw for black; 0 for idle lanes, whose n must not pass t
 *   ticks     steps since the last one of the firmware, and
 *   observed  how many of them had observations, and
 *   messages  how many messages each robot heard in them in its arena
 *   t         observations of each robot
 *   said      sums of each message
 *   heard     sums of each round; in a fully connected swarm that of robot 0 stands for all */
typedef struct {
    const mcp_asdf_experiment_t *experiment;
    bool has_lanes;
    bool is_robust;
    uint32_t columns;
    uint32_t index;
    uint32_t side;
    uint32_t used;
    uint32_t count;
    trial_t trials[LANES_OF_TRIALS];
    mcp_asdf_arena_t arena;
    uint32_t trial_of[LANES];
    uint32_t robot_of[LANES];
    uint32_t words[4][LANES];
    uint32_t limit[LANES];
    uint32_t black[LANES];
    uint32_t ticks;
    uint32_t observed;
    uint32_t messages[MCP_ASDF_ENGINE_MAX_ROBOTS];
    uint32_t t;
    lanes_t lanes;
    lanes_sums_t said;
    lanes_sums_t heard;
} block_t;

/* --- What robots see --- */

/* Draws of steps 4 group .. 4 group + 3. */
FOR_EACH_TARGET static void draw(block_t *block, uint32_t group)
{
    const uint64_t seed = block->experiment->seed;
    const uint32_t count = block->count;
    for (uint32_t c = 0; c < count; ++c) {
        const philox_t drawn = draws(seed, block->trial_of[c], block->robot_of[c], group);
        block->words[0][c] = drawn.word[0];
        block->words[1][c] = drawn.word[1];
        block->words[2][c] = drawn.word[2];
        block->words[3][c] = drawn.word[3];
    }
}

/* Limits of step k: the probability of black, on a white floor that of a mistake. The floor is chance, so a
 * branch on it could not be predicted. */
static void look(block_t *block, uint32_t k)
{
    const mcp_asdf_experiment_t *const e = block->experiment;
    const uint32_t used = block->used, side = block->side;
    const uint32_t *const black = e->black + block->index * e->trial_stride + k * e->step_stride;
    for (uint32_t j = 0; j < e->robots; ++j) {
        const uint32_t is_white = e->arenas != NULL && block->arena.black[j] == 0;
        for (uint32_t l = 0; l < used; ++l) {
            const uint32_t limit = black[l * e->trial_stride + j * e->robot_stride];
            block->limit[j * side + l] = limit + is_white * (MCP_ASDF_ENGINE_CERTAIN - 2 * limit);
        }
    }
}

FOR_EACH_TARGET static void see(block_t *block, uint32_t k)
{
    const uint32_t *const words = block->words[k % 4];
    const uint32_t count = block->count;
    for (uint32_t c = 0; c < count; ++c) {
        block->black[c] = words[c] >> 1 < block->limit[c];
    }
}

/* --- Steps in lanes --- */

static void hear_nobody(block_t *block)
{
    for (uint32_t c = 0; c < block->count; ++c) {
        block->heard.alpha[c] = block->heard.alpha_x_low[c] = block->heard.alpha_x_high[c] = 0;
    }
}

static void hear_one(block_t *block, uint32_t receiver, uint32_t sender)
{
    ++block->messages[receiver];
    if (block->is_robust) {
        lanes_vote(&block->lanes, receiver, sender);
        return;
    }
    block->heard.alpha[receiver] += block->said.alpha[sender];
    block->heard.alpha_x_low[receiver] += block->said.alpha_x_low[sender];
    block->heard.alpha_x_high[receiver] += block->said.alpha_x_high[sender];
}

/* Each robot hears its neighbours in ascending order, as the links are. */
static void hear_linked(block_t *block)
{
    hear_nobody(block);
    for (uint32_t p = 0; p < block->arena.link_count; ++p) {
        hear_one(block, block->arena.links[p].a, block->arena.links[p].b);
        hear_one(block, block->arena.links[p].b, block->arena.links[p].a);
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

FOR_EACH_TARGET static void hear_all(block_t *block)
{
    const uint32_t robots = block->experiment->robots;
    add_up(robots, block->said.alpha, block->heard.alpha);
    add_up(robots, block->said.alpha_x_low, block->heard.alpha_x_low);
    add_up(robots, block->said.alpha_x_high, block->heard.alpha_x_high);
}

static void hear(block_t *block)
{
    if (block->experiment->arenas != NULL) {
        hear_linked(block);
    } else if (block->is_robust) {
        lanes_vote_all(&block->lanes, block->experiment->robots);
    } else {
        hear_all(block);
    }
}

static void inform(block_t *block, uint32_t step)
{
    const uint32_t columns = block->columns, side = block->side;
    const size_t length = (size_t)block->experiment->steps + 1;
    uint32_t x[LANES];
    if (block->is_robust) {
        lanes_centre(&block->lanes, block->count, x);
    } else {
        lanes_inform(&block->lanes, columns == 1 ? side : block->count, &block->heard, x);
    }
    for (uint32_t j = 0; j < columns; ++j) {
        for (uint32_t l = 0; l < block->used; ++l) {
            block->trials[l].x[j * length + step] = x[j * side + l];
        }
    }
}

/* Step k (from 0), in an arena that has moved. Until robots observe, their messages are still those of the
 * step before; before step 0 there were none. */
static void run_lanes(block_t *block, uint32_t k)
{
    const bool is_late = block->experiment->latency != 0;
    if (is_late && k > 0) {
        hear(block);
    }
    if (trial_observes(block->experiment, k)) {
        lanes_observe(&block->lanes, block->count, ++block->t, block->black);
        lanes_say(&block->lanes, block->count, &block->said);
        ++block->observed;
    }
    if (!is_late) {
        hear(block);
    }
    inform(block, k + 1);
    ++block->ticks;
}

/* --- Steps of the firmware --- */

/* Bring a robot to the state after the steps in lanes, except for members that its next step forms anew. */
static void hand_over(const block_t *block, mcp_asdf_t *robot, uint32_t lane)
{
    const uint32_t all = block->ticks * (block->experiment->robots - 1);
    const uint32_t messages = block->experiment->arenas == NULL ? all : block->messages[lane];
    robot->t = block->t;
    robot->n = block->lanes.n[lane];
    robot->x_hat = block->lanes.x_hat[lane];
    robot->alpha = block->lanes.alpha[lane];
    robot->updated = block->observed == 0 ? robot->updated : 0;
    robot->filter_left -= block->ticks;
    robot->counters.accepted = (uint16_t)(robot->counters.accepted + messages);
    lanes_unload(&block->lanes, lane, robot);
}

static void load(block_t *block)
{
    const uint32_t robots = block->experiment->robots, side = block->side;
    block->t = mcp_asdf_t_count(&block->trials[0].robots[0]);
    block->ticks = block->observed = 0;
    for (uint32_t c = 0; c < block->count; ++c) {
        const uint32_t j = c / side, l = c % side;
        lanes_load(&block->lanes, c, &block->trials[l < block->used ? l : 0].robots[j < robots ? j : 0]);
    }
    for (uint32_t j = 0; j < robots; ++j) {
        block->messages[j] = 0;
    }
    lanes_say(&block->lanes, block->count, &block->said);
}

static bool needs_firmware(const block_t *block, uint32_t k)
{
    const mcp_asdf_experiment_t *const experiment = block->experiment;
    const mcp_asdf_config_t *const config = experiment->configs[0];
    return !block->has_lanes || (k + 1) % config->filter_period == 0 || k + 1 == experiment->steps ||
           (block->t + 1 == config->memory && trial_observes(experiment, k));
}

static void run_firmware(block_t *block, uint32_t k)
{
    const mcp_asdf_experiment_t *const experiment = block->experiment;
    const mcp_asdf_arena_t *const arena = experiment->arenas == NULL ? NULL : &block->arena;
    for (uint32_t l = 0; l < block->used; ++l) {
        const trial_t *const trial = &block->trials[l];
        for (uint32_t j = 0; j < experiment->robots && block->has_lanes; ++j) {
            hand_over(block, &trial->robots[j], j * block->side + l);
        }
        trial_tick(experiment, trial, arena, k, (trial_tiles_t){block->black + l, block->side});
        trial_keep(experiment, trial, k + 1);
    }
    if (block->has_lanes) {
        load(block);
    }
}

/* --- Blocks --- */

static mcp_asdf_status_t start(block_t *block, const mcp_asdf_outcome_t *outcome)
{
    const mcp_asdf_experiment_t *const e = block->experiment;
    const uint32_t rest = e->trials - block->index, side = block->side;
    block->used = rest < side ? rest : side;
    block->count = (e->robots * side + MULTIPLE - 1) / MULTIPLE * MULTIPLE;
    for (uint32_t c = 0; c < block->count; ++c) {
        block->trial_of[c] = e->first_trial + block->index + (c % side < block->used ? c % side : 0);
        block->robot_of[c] = c / side;
        block->limit[c] = 0;
    }
    for (uint32_t l = 0; l < block->used; ++l) {
        block->trials[l] = trial_part(e, outcome, block->index + l);
        const mcp_asdf_status_t status = trial_start(e, &block->trials[l]);
        if (status != MCP_ASDF_OK) {
            return status;
        }
    }
    if (e->arenas != NULL && (e->arenas[block->index].robots != e->robots ||
                              !mcp_asdf_arena_init(&block->arena, &e->arenas[block->index]))) {
        return MCP_ASDF_ERR_CONFIG;
    }
    look(block, 0);
    hear_nobody(block);
    load(block);
    return MCP_ASDF_OK;
}

static mcp_asdf_status_t run_block(block_t *block, const mcp_asdf_outcome_t *outcome)
{
    const mcp_asdf_experiment_t *const experiment = block->experiment;
    const bool is_moving = experiment->arenas != NULL;
    const mcp_asdf_status_t status = start(block, outcome);
    for (uint32_t k = 0; k < experiment->steps && status == MCP_ASDF_OK; ++k) {
        if (k % 4 == 0) {
            draw(block, k / 4);
        }
        if (is_moving) {
            mcp_asdf_arena_step(&block->arena);
        }
        if (is_moving || experiment->step_stride != 0) {
            look(block, k);
        }
        see(block, k);
        if (needs_firmware(block, k)) {
            run_firmware(block, k);
        } else {
            run_lanes(block, k);
        }
    }
    return status;
}

static mcp_asdf_status_t check(const mcp_asdf_experiment_t *experiment)
{
    const mcp_asdf_config_t *const first = experiment->configs[0];
    bool is_valid = experiment->robots >= 1 && experiment->robots <= MCP_ASDF_ENGINE_MAX_ROBOTS &&
                    experiment->steps >= 1 && experiment->steps < INT32_MAX &&
                    experiment->comms_period >= 1 && experiment->observation_period >= 1 &&
                    (experiment->latency == 0 || experiment->arenas != NULL) &&
                    experiment->liars <= experiment->robots;
    for (uint32_t j = 1; j < experiment->robots && is_valid; ++j) {
        const mcp_asdf_config_t *const config = experiment->configs[j];
        is_valid = config->filter_period == first->filter_period && config->memory == first->memory;
    }
    return is_valid ? MCP_ASDF_OK : MCP_ASDF_ERR_CONFIG;
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

mcp_asdf_status_t mcp_asdf_engine_run(const mcp_asdf_experiment_t *experiment, bool lanes,
                                      const mcp_asdf_outcome_t *outcome)
{
    mcp_asdf_status_t status = check(experiment);
    block_t block;
    block.experiment = experiment;
    block.has_lanes = lanes;
    block.is_robust = mcp_asdf_is_robust(experiment->configs[0]);
    block.columns = mcp_asdf_engine_columns(experiment);
    block.side = lanes && experiment->arenas == NULL ? LANES_OF_TRIALS : 1;
    for (block.index = 0; block.index < experiment->trials && status == MCP_ASDF_OK;
         block.index += block.side) {
        status = run_block(&block, outcome);
    }
    return status;
}
