/* Trials side by side, with a lane for every robot. engine.h is the manual.
 *
 * Sixteen trials of fully connected swarms take their steps together, or up to eight in their arenas. Robots
 * observe, hear (in an arena message by message) and settle in lanes; the steps in which the filter may run
 * or t reaches the memory, and the last one, are the firmware's own: before them the lanes hand over what
 * they changed. Without lanes every step is its own.
 */
#include <string.h>

#include "lanes.h"
#include "philox.h"
#include "trial.h"

#define MULTIPLE 8 /* of lanes in use, so that vectors are full */
#define STEPS_KEPT 8
#define ARENAS 8 /* trials of moving swarms side by side, of up to MCP_ASDF_ENGINE_MAX_CONNECTED robots */

/* Trials under way; lanes beyond the last trial or robot run idle.
 *   is_robust   whether the robots have the robust filter: messages are votes then, and there are no sums
 *   columns     series of x in a trial
 *   index       of the first trial
 *   used        trials in use, of `side` side by side
 *   count       lanes in use: lane j side + l is robot first + j of trial l, here and in all arrays below
 *   first       robots of the blocks before this one: a swarm of more than LANES, which moves or is in a
 *               graph, is in `blocks` blocks in a row
 *   arenas      NULL, or the arena of each trial
 *   trial_of, robot_of   whose draws a lane has
 *   words       draws of four steps
 *   limit       of a draw for black; 0 for idle lanes, whose n must not pass t
 *   ticks       steps since the last one of the firmware, and
 *   observed    how many of them had observations, and
 *   messages    how many messages each robot heard in them from its neighbours
 *   x           informed estimates of the last `kept` steps, not yet written down
 *   t           observations of each robot
 *   said        sums of each message
 *   heard       sums of each round; in a fully connected swarm that of robot 0 stands for all */
typedef struct {
    const mcp_asdf_experiment_t *experiment;
    bool has_lanes;
    bool is_robust;
    uint32_t columns;
    uint32_t index;
    uint32_t side;
    uint32_t used;
    uint32_t count;
    uint32_t first;
    uint32_t blocks;
    trial_t trials[LANES_OF_TRIALS];
    mcp_asdf_arena_t *arenas;
    uint32_t trial_of[LANES];
    uint32_t robot_of[LANES];
    uint32_t words[4][LANES];
    uint32_t limit[LANES];
    uint32_t *black;
    uint32_t ticks;
    uint32_t observed;
    uint32_t messages[LANES];
    uint32_t kept;
    uint32_t x[STEPS_KEPT][LANES];
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
    const uint32_t side = block->side, first = block->first, left = e->robots - first;
    const uint32_t robots = left < LANES / side ? left : LANES / side;
    for (uint32_t l = 0; l < block->used; ++l) {
        const uint32_t *const black =
            e->black + (block->index + l) * e->trial_stride + k * e->step_stride + first * e->robot_stride;
        const uint8_t *const floor = block->arenas == NULL ? NULL : block->arenas[l].black + first;
        for (uint32_t j = 0; j < robots; ++j) {
            const uint32_t limit = black[j * e->robot_stride], is_white = floor != NULL && floor[j] == 0;
            block->limit[j * side + l] = limit + is_white * (MCP_ASDF_ENGINE_CERTAIN - 2 * limit);
        }
    }
}

FOR_EACH_TARGET static void compare(block_t *block, uint32_t k)
{
    uint32_t *const restrict black = block->black;
    const uint32_t *const words = block->words[k % 4];
    const uint32_t count = block->count;
    for (uint32_t c = 0; c < count; ++c) {
        black[c] = words[c] >> 1 < block->limit[c];
    }
}

/* What the robots of a block observe in step k. */
static void see(block_t *block, uint32_t k)
{
    if (k % 4 == 0) {
        draw(block, k / 4);
    }
    if (block->arenas != NULL || block->experiment->step_stride != 0) {
        look(block, k);
    }
    compare(block, k);
}

/* --- Steps in lanes --- */

static void hear_nobody(block_t *block)
{
    for (uint32_t c = 0; c < block->count; ++c) {
        block->heard.alpha[c] = block->heard.alpha_x_low[c] = block->heard.alpha_x_high[c] = 0;
    }
}

IN_LOOPS void hear_one(block_t *blocks, uint32_t receiver, uint32_t sender)
{
    block_t *const block = &blocks[receiver / LANES];
    const block_t *const other = &blocks[sender / LANES];
    const uint32_t to = receiver % LANES, from = sender % LANES;
    ++block->messages[to];
    if (block->is_robust) {
        lanes_vote(&block->lanes, to, &other->lanes, from, sender / block->side);
        return;
    }
    block->heard.alpha[to] += other->said.alpha[from];
    block->heard.alpha_x_low[to] += other->said.alpha_x_low[from];
    block->heard.alpha_x_high[to] += other->said.alpha_x_high[from];
}

/* Each robot hears its neighbours in ascending order, as links and arcs are. */
static void hear_linked(block_t *blocks)
{
    const mcp_asdf_experiment_t *const e = blocks->experiment;
    const uint32_t side = blocks->side;
    for (uint32_t b = 0; b < blocks->blocks; ++b) {
        hear_nobody(&blocks[b]);
    }
    for (uint32_t l = 0; l < blocks->used && blocks->arenas != NULL; ++l) {
        const mcp_asdf_arena_t *const arena = &blocks->arenas[l];
        for (uint32_t p = 0; p < arena->link_count; ++p) {
            const uint32_t a = arena->links[p].a * side + l, b = arena->links[p].b * side + l;
            hear_one(blocks, a, b);
            hear_one(blocks, b, a);
        }
    }
    for (size_t p = 0; e->arcs != NULL && p < e->arc_count; ++p) {
        hear_one(blocks, e->arcs[p].b, e->arcs[p].a);
    }
}

/* Sums over all robots of each trial but the first. */
IN_LOOPS void add_up(uint32_t robots, const uint64_t *restrict of_robots, uint64_t *restrict sums)
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

static void hear(block_t *blocks)
{
    if (trial_is_linked(blocks->experiment)) {
        hear_linked(blocks);
    } else if (blocks->is_robust) {
        lanes_vote_all(&blocks->lanes, blocks->experiment->robots);
    } else {
        hear_all(blocks);
    }
}

/* Write down the estimates of the `kept` steps up to `step`, together: each step alone would write to as many
 * pages of memory as there are series. */
static void write_down(block_t *block, uint32_t step)
{
    const uint32_t rest = block->columns - block->first, columns = rest < LANES ? rest : LANES;
    const uint32_t side = block->side, kept = block->kept;
    const size_t length = (size_t)block->experiment->steps + 1;
    for (uint32_t j = 0; j < columns; ++j) {
        for (uint32_t l = 0; l < block->used; ++l) {
            uint32_t *const x = block->trials[l].x + (block->first + j) * length + step + 1 - kept;
            for (uint32_t k = 0; k < kept; ++k) {
                x[k] = block->x[k][j * side + l];
            }
        }
    }
    block->kept = 0;
}

static void inform(block_t *block, uint32_t step)
{
    uint32_t *const x = block->x[block->kept++];
    if (block->is_robust) {
        lanes_centre(&block->lanes, block->count, x);
    } else {
        lanes_inform(&block->lanes, block->columns == 1 ? block->side : block->count, &block->heard, x);
    }
    if (block->kept == STEPS_KEPT) {
        write_down(block, step);
    }
}

/* Step k (from 0), in an arena that has moved. Until robots observe, their messages are still those of the
 * step before; before step 0 there were none. */
static void run_lanes(block_t *blocks, uint32_t k)
{
    const bool is_late = blocks->experiment->latency != 0;
    if (is_late && k > 0) {
        hear(blocks);
    }
    for (block_t *b = blocks; b < blocks + blocks->blocks && trial_observes(b->experiment, k); ++b) {
        lanes_observe(&b->lanes, b->count, ++b->t, b->black);
        lanes_say(&b->lanes, b->count, &b->said);
        ++b->observed;
    }
    if (!is_late) {
        hear(blocks);
    }
    for (block_t *b = blocks; b < blocks + blocks->blocks; ++b) {
        inform(b, k + 1);
        ++b->ticks;
    }
}

/* --- Steps of the firmware --- */

/* Bring a robot to the state after the steps in lanes, except for members that its next step forms anew. */
static void hand_over(const block_t *block, mcp_asdf_t *robot, uint32_t lane)
{
    const uint32_t all = block->ticks * (block->experiment->robots - 1);
    const uint32_t messages = trial_is_linked(block->experiment) ? block->messages[lane] : all;
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
        const uint32_t j = block->first + c / side, l = c % side;
        lanes_load(&block->lanes, c, &block->trials[l < block->used ? l : 0].robots[j < robots ? j : 0]);
    }
    memset(block->messages, 0, sizeof *block->messages * block->count);
    lanes_say(&block->lanes, block->count, &block->said);
}

static bool needs_firmware(const block_t *block, uint32_t k)
{
    const mcp_asdf_experiment_t *const experiment = block->experiment;
    const mcp_asdf_config_t *const config = experiment->configs[0];
    return !block->has_lanes || (k + 1) % config->filter_period == 0 || k + 1 == experiment->steps ||
           (block->t + 1 == config->memory && trial_observes(experiment, k));
}

static void run_firmware(block_t *blocks, uint32_t k)
{
    const mcp_asdf_experiment_t *const experiment = blocks->experiment;
    const uint32_t side = blocks->side;
    for (uint32_t b = 0; b < blocks->blocks; ++b) {
        write_down(&blocks[b], k);
    }
    for (uint32_t l = 0; l < blocks->used; ++l) {
        const trial_t *const trial = &blocks->trials[l];
        const mcp_asdf_arena_t *const arena = blocks->arenas == NULL ? NULL : &blocks->arenas[l];
        for (uint32_t j = 0; j < experiment->robots && blocks->has_lanes; ++j) {
            const uint32_t lane = j * side + l;
            hand_over(&blocks[lane / LANES], &trial->robots[j], lane % LANES);
        }
        trial_tick(experiment, trial, arena, k, (trial_tiles_t){blocks->black + l, side});
        trial_keep(experiment, trial, k + 1);
    }
    for (uint32_t b = 0; b < blocks->blocks && blocks->has_lanes; ++b) {
        load(&blocks[b]);
    }
}

/* --- Blocks --- */

/* Prepare lanes of a block for the trials that have started. */
static void fill(block_t *block)
{
    const mcp_asdf_experiment_t *const e = block->experiment;
    const uint32_t side = block->side, lanes = (e->robots - block->first) * side;
    block->count = lanes < LANES ? (lanes + MULTIPLE - 1) / MULTIPLE * MULTIPLE : LANES;
    for (uint32_t c = 0; c < block->count; ++c) {
        block->trial_of[c] = e->first_trial + block->index + (c % side < block->used ? c % side : 0);
        block->robot_of[c] = block->first + c / side;
        block->limit[c] = 0;
    }
    look(block, 0);
    hear_nobody(block);
    load(block);
}

static mcp_asdf_status_t start(block_t *blocks, const mcp_asdf_outcome_t *outcome, uint32_t index)
{
    const mcp_asdf_experiment_t *const e = blocks->experiment;
    const uint32_t rest = e->trials - index, side = blocks->side;
    uint8_t *memory = (void *)(blocks->arenas + side);
    for (uint32_t b = 0; b < blocks->blocks; ++b) {
        blocks[b].index = index;
        blocks[b].kept = 0;
        blocks[b].used = rest < side ? rest : side;
        for (uint32_t l = 0; l < blocks[b].used; ++l) {
            blocks[b].trials[l] = trial_part(e, outcome, index + l);
        }
    }
    for (uint32_t l = 0; l < blocks->used; ++l) {
        const mcp_asdf_status_t status = trial_start(e, &blocks->trials[l]);
        if (status != MCP_ASDF_OK) {
            return status;
        }
        if (e->arenas != NULL) {
            const mcp_asdf_arena_config_t *const world = &e->arenas[index + l];
            if (!mcp_asdf_arena_init(&blocks->arenas[l], world, memory)) {
                return MCP_ASDF_ERR_CONFIG;
            }
            memory += mcp_asdf_arena_bytes(world);
        }
    }
    for (uint32_t b = 0; b < blocks->blocks; ++b) {
        fill(&blocks[b]);
    }
    return MCP_ASDF_OK;
}

static mcp_asdf_status_t run_blocks(block_t *blocks, const mcp_asdf_outcome_t *outcome, uint32_t index)
{
    const mcp_asdf_experiment_t *const experiment = blocks->experiment;
    const bool is_moving = experiment->arenas != NULL;
    const mcp_asdf_status_t status = start(blocks, outcome, index);
    for (uint32_t k = 0; k < experiment->steps && status == MCP_ASDF_OK; ++k) {
        if (is_moving) {
            mcp_asdf_arena_step(blocks->arenas, blocks->used);
        }
        for (block_t *b = blocks; b < blocks + blocks->blocks; ++b) {
            see(b, k);
        }
        if (needs_firmware(blocks, k)) {
            run_firmware(blocks, k);
        } else {
            run_lanes(blocks, k);
        }
    }
    return status;
}

static mcp_asdf_status_t check(const mcp_asdf_experiment_t *experiment)
{
    const mcp_asdf_config_t *const first = experiment->configs[0];
    bool is_valid =
        experiment->robots >= 1 &&
        experiment->robots <=
            (trial_is_linked(experiment) ? MCP_ASDF_ENGINE_MAX_ROBOTS : MCP_ASDF_ENGINE_MAX_CONNECTED) &&
        experiment->steps >= 1 && experiment->steps < INT32_MAX && experiment->comms_period >= 1 &&
        experiment->observation_period >= 1 && (experiment->latency == 0 || trial_is_linked(experiment)) &&
        experiment->liars <= experiment->robots;
    for (uint32_t j = 1; j < experiment->robots && is_valid; ++j) {
        const mcp_asdf_config_t *const config = experiment->configs[j];
        is_valid = config->filter_period == first->filter_period && config->memory == first->memory;
    }
    for (uint32_t i = 0; i < experiment->trials && is_valid && experiment->arenas != NULL; ++i) {
        is_valid = experiment->arenas[i].robots == experiment->robots;
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

static uint32_t blocks_of(const mcp_asdf_experiment_t *experiment)
{
    return trial_is_linked(experiment) ? (experiment->robots + LANES - 1) / LANES : 1;
}

/* Trials side by side in lanes. */
static uint32_t side_of(const mcp_asdf_experiment_t *experiment)
{
    if (!trial_is_linked(experiment)) {
        return LANES_OF_TRIALS;
    }
    if (experiment->arenas == NULL || experiment->robots > MCP_ASDF_ENGINE_MAX_CONNECTED ||
        experiment->trials == 0) {
        return 1;
    }
    const uint32_t runs = (experiment->trials + ARENAS - 1) / ARENAS; /* of about as many trials each */
    return (experiment->trials + runs - 1) / runs;
}

/* Bytes of the blocks, and of their `black`, in an experiment's memory. The arenas come last. */
static size_t bytes_of_blocks(const mcp_asdf_experiment_t *experiment)
{
    return blocks_of(experiment) * (sizeof(block_t) + (size_t)LANES * sizeof(uint32_t));
}

size_t mcp_asdf_engine_bytes(const mcp_asdf_experiment_t *experiment)
{
    size_t of_arena = 0;
    for (uint32_t i = 0; i < experiment->trials && experiment->arenas != NULL; ++i) {
        const size_t bytes = sizeof(mcp_asdf_arena_t) + mcp_asdf_arena_bytes(&experiment->arenas[i]);
        of_arena = bytes > of_arena ? bytes : of_arena;
    }
    return bytes_of_blocks(experiment) + side_of(experiment) * of_arena;
}

static block_t *make_blocks(const mcp_asdf_experiment_t *experiment, bool lanes, void *memory)
{
    block_t *const made = memory;
    const uint32_t count = blocks_of(experiment);
    uint32_t *const black = (void *)(made + count);
    for (uint32_t b = 0; b < count; ++b) {
        made[b].experiment = experiment;
        made[b].has_lanes = lanes;
        made[b].is_robust = mcp_asdf_is_robust(experiment->configs[0]);
        made[b].columns = mcp_asdf_engine_columns(experiment);
        made[b].side = lanes ? side_of(experiment) : 1;
        made[b].first = b * LANES;
        made[b].blocks = count;
        made[b].black = black + (size_t)b * (size_t)LANES;
        made[b].arenas = experiment->arenas == NULL ? NULL : (void *)(black + (size_t)count * (size_t)LANES);
    }
    return made;
}

mcp_asdf_status_t mcp_asdf_engine_run(const mcp_asdf_experiment_t *experiment, bool lanes,
                                      const mcp_asdf_outcome_t *outcome, void *memory)
{
    mcp_asdf_status_t status = check(experiment);
    if (status != MCP_ASDF_OK) {
        return status;
    }
    block_t *const blocks = make_blocks(experiment, lanes, memory);
    for (uint32_t i = 0; i < experiment->trials && status == MCP_ASDF_OK; i += blocks->side) {
        status = run_blocks(blocks, outcome, i);
    }
    return status;
}
