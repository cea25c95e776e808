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

#define ARENAS 8 /* trials of moving swarms side by side, of up to MCP_ASDF_ENGINE_MAX_CONNECTED robots */

/* Trials under way.
 *   is_robust   whether the robots have the robust filter: messages are votes then, and there are no sums
 *   columns     series of x in a trial
 *   side        trials side by side: lane j side + l is robot j of trial l, from 0; the others run idle
 *   lanes       in `rows` rows
 *   arenas      NULL, or the arena of each trial
 *   index       of the first of the `used` trials
 *   t           observations of each robot
 *   ticks       steps since the last one of the firmware, and
 *   observed    how many of them had observations, and
 *   kept        how many of them have informed estimates that are not yet written down */
typedef struct {
    const mcp_asdf_experiment_t *experiment;
    bool has_lanes;
    bool is_robust;
    uint32_t columns;
    uint32_t side;
    uint32_t rows;
    lanes_t *lanes;
    mcp_asdf_arena_t *arenas;
    uint32_t index;
    uint32_t used;
    trial_t trials[LANES];
    uint32_t t;
    uint32_t ticks;
    uint32_t observed;
    uint32_t kept;
} run_t;

/* --- What robots see --- */

/* Draws of steps 4 group .. 4 group + 3. */
FOR_EACH_TARGET static void draw(lanes_t *rows, uint32_t count, uint64_t seed, uint32_t group)
{
    for (lanes_t *row = rows; row < rows + count; ++row) {
        SIDE_BY_SIDE
        for (uint32_t l = 0; l < LANES; ++l) {
            const philox_t drawn = draws(seed, row->trial[l], row->robot[l], group);
            row->words[0][l] = drawn.word[0];
            row->words[1][l] = drawn.word[1];
            row->words[2][l] = drawn.word[2];
            row->words[3][l] = drawn.word[3];
        }
    }
}

/* Limits of step k: the probability of black, on a white floor that of a mistake. The floor is chance, so a
 * branch on it could not be predicted. */
static void look(const run_t *run, uint32_t k)
{
    const mcp_asdf_experiment_t *const e = run->experiment;
    for (uint32_t l = 0; l < run->used; ++l) {
        const uint32_t *black = e->black + (run->index + l) * e->trial_stride + k * e->step_stride;
        const uint8_t *const floor = run->arenas == NULL ? NULL : run->arenas[l].black;
        for (uint32_t j = 0, c = l; j < e->robots; ++j, c += run->side, black += e->robot_stride) {
            const uint32_t is_white = floor != NULL && floor[j] == 0;
            run->lanes[c / LANES].limit[c % LANES] =
                *black + is_white * (MCP_ASDF_ENGINE_CERTAIN - 2 * *black);
        }
    }
}

/* What the robots see in step k. */
static void see(const run_t *run, uint32_t k)
{
    if (k % 4 == 0) {
        draw(run->lanes, run->rows, run->experiment->seed, k / 4);
    }
    if (k == 0 || run->arenas != NULL || run->experiment->step_stride != 0) {
        look(run, k);
    }
}

/* --- Steps in lanes --- */

IN_LOOPS void hear_one(const run_t *run, uint32_t receiver, uint32_t sender)
{
    lanes_t *const row = &run->lanes[receiver / LANES];
    const lanes_t *const other = &run->lanes[sender / LANES];
    const uint32_t to = receiver % LANES, from = sender % LANES;
    ++row->messages[to];
    if (run->is_robust) {
        lanes_vote(row, to, other, from);
        return;
    }
    row->heard.alpha[to] += other->said.alpha[from];
    row->heard.alpha_x_low[to] += other->said.alpha_x_low[from];
    row->heard.alpha_x_high[to] += other->said.alpha_x_high[from];
}

/* Each robot hears its neighbours in ascending order, as links and arcs are. */
static void hear_linked(const run_t *run)
{
    const mcp_asdf_experiment_t *const e = run->experiment;
    const uint32_t side = run->side;
    for (uint32_t l = 0; l < run->used && run->arenas != NULL; ++l) {
        const mcp_asdf_pair_t *const links = run->arenas[l].links;
        const uint32_t count = run->arenas[l].link_count;
        for (uint32_t p = 0; p < count; ++p) {
            const uint32_t a = links[p].a * side + l, b = links[p].b * side + l;
            hear_one(run, a, b);
            hear_one(run, b, a);
        }
    }
    for (size_t p = 0; e->arcs != NULL && p < e->arc_count; ++p) {
        hear_one(run, e->arcs[p].b, e->arcs[p].a);
    }
}

/* In a fully connected swarm the sums over all robots of each trial are with the first one. */
FOR_EACH_TARGET static void hear_all(lanes_t *rows, uint32_t robots)
{
    lanes_sums_t all = rows->heard;
    for (const lanes_t *row = rows + 1; row < rows + robots; ++row) {
        for (uint32_t l = 0; l < LANES; ++l) {
            all.alpha[l] += row->said.alpha[l];
            all.alpha_x_low[l] += row->said.alpha_x_low[l];
            all.alpha_x_high[l] += row->said.alpha_x_high[l];
        }
    }
    rows->heard = all;
}

static void hear(const run_t *run)
{
    if (trial_is_linked(run->experiment)) {
        hear_linked(run);
    } else if (run->is_robust) {
        lanes_vote_all(run->lanes, run->rows);
    } else {
        hear_all(run->lanes, run->rows);
    }
}

/* Write down the estimates of the `kept` steps up to `step`, series by series: each value alone would wait
 * for a page of memory of its own. */
static void write_down(run_t *run, uint32_t step)
{
    const size_t before = (size_t)step + 1 - run->kept, size = run->kept * sizeof(uint32_t);
    uint32_t series[LANES][STEPS_KEPT];
    for (uint32_t c = 0; c < run->columns * run->side && run->kept != 0; ++c) {
        const uint32_t j = c / run->side, l = c % run->side;
        for (uint32_t k = 0; k < LANES * STEPS_KEPT && c % LANES == 0; ++k) {
            series[k % LANES][k / LANES] = run->lanes[c / LANES].x[k / LANES][k % LANES];
        }
        if (l < run->used) {
            uint32_t *const x = run->trials[l].x + j * ((size_t)run->experiment->steps + 1);
            memcpy(x + before, series[c % LANES], size);
        }
    }
    run->kept = 0;
}

static void inform(run_t *run, uint32_t step)
{
    if (run->is_robust) {
        lanes_centre(run->lanes, run->rows, run->kept);
    } else {
        lanes_inform(run->lanes, run->columns == 1 ? 1 : run->rows, run->kept);
    }
    if (++run->kept == STEPS_KEPT) {
        write_down(run, step);
    }
}

/* Step k (from 0), in an arena that has moved. Until robots observe, their messages are still those of the
 * step before; before step 0 there were none. */
static void run_lanes(run_t *run, uint32_t k)
{
    const bool is_late = run->experiment->latency != 0;
    if (is_late && k > 0) {
        hear(run);
    }
    if (trial_observes(run->experiment, k)) {
        lanes_observe(run->lanes, run->rows, ++run->t, k);
        ++run->observed;
    }
    if (!is_late) {
        hear(run);
    }
    inform(run, k + 1);
    ++run->ticks;
}

/* --- Steps of the firmware --- */

/* Bring robot j of trial l to the state after the steps in lanes, except for members that its next step forms
 * anew. */
static void hand_over(const run_t *run, uint32_t j, uint32_t l)
{
    const uint32_t lane = (j * run->side + l) % LANES, all = run->ticks * (run->experiment->robots - 1);
    const lanes_t *const row = &run->lanes[(j * run->side + l) / LANES];
    mcp_asdf_t *const robot = &run->trials[l].robots[j];
    const uint32_t messages = trial_is_linked(run->experiment) ? row->messages[lane] : all;
    robot->t = run->t;
    robot->n = row->n[lane];
    robot->x_hat = row->x_hat[lane];
    robot->alpha = row->alpha[lane];
    robot->updated = run->observed == 0 ? robot->updated : 0;
    robot->filter_left -= run->ticks;
    robot->counters.accepted = (uint16_t)(robot->counters.accepted + messages);
    lanes_unload(row, lane, robot);
}

/* Begin steps in lanes. */
static void load(run_t *run)
{
    const uint32_t robots = run->experiment->robots, side = run->side;
    run->t = mcp_asdf_t_count(&run->trials[0].robots[0]);
    run->ticks = run->observed = 0;
    for (uint32_t c = 0; c < run->rows * LANES; ++c) {
        const uint32_t j = c / side, l = c % side;
        lanes_t *const row = &run->lanes[c / LANES];
        row->messages[c % LANES] = 0;
        lanes_load(row, c % LANES, &run->trials[l < run->used ? l : 0].robots[j < robots ? j : 0]);
    }
}

static bool needs_firmware(const run_t *run, uint32_t k)
{
    const mcp_asdf_experiment_t *const experiment = run->experiment;
    const mcp_asdf_config_t *const config = experiment->configs[0];
    return !run->has_lanes || (k + 1) % config->filter_period == 0 || k + 1 == experiment->steps ||
           (run->t + 1 == config->memory && trial_observes(experiment, k));
}

static void run_firmware(run_t *run, uint32_t k)
{
    const mcp_asdf_experiment_t *const experiment = run->experiment;
    write_down(run, k);
    for (uint32_t l = 0; l < run->used; ++l) {
        const mcp_asdf_arena_t *const arena = run->arenas == NULL ? NULL : &run->arenas[l];
        for (uint32_t j = 0; j < experiment->robots && run->has_lanes; ++j) {
            hand_over(run, j, l);
        }
        trial_tick(experiment, &run->trials[l], arena, k, (trial_eyes_t){run->lanes, l, run->side});
        trial_keep(experiment, &run->trials[l], k + 1);
    }
    if (run->has_lanes) {
        load(run);
    }
}

/* --- Runs --- */

static mcp_asdf_status_t start(run_t *run, const mcp_asdf_outcome_t *outcome, uint32_t index)
{
    const mcp_asdf_experiment_t *const e = run->experiment;
    const uint32_t rest = e->trials - index;
    uint8_t *memory = (void *)(run->arenas + run->side);
    run->index = index;
    run->used = rest < run->side ? rest : run->side;
    run->kept = 0;
    for (uint32_t l = 0; l < run->used; ++l) {
        run->trials[l] = trial_part(e, outcome, index + l);
        const mcp_asdf_status_t status = trial_start(e, &run->trials[l]);
        if (status != MCP_ASDF_OK) {
            return status;
        }
        if (e->arenas != NULL) {
            const mcp_asdf_arena_config_t *const world = &e->arenas[index + l];
            if (!mcp_asdf_arena_init(&run->arenas[l], world, memory)) {
                return MCP_ASDF_ERR_CONFIG;
            }
            memory += mcp_asdf_arena_bytes(world);
        }
    }
    memset(run->lanes, 0, run->rows * sizeof *run->lanes);
    for (uint32_t c = 0; c < run->rows * LANES; ++c) {
        const uint32_t l = c % run->side;
        run->lanes[c / LANES].trial[c % LANES] = e->first_trial + index + (l < run->used ? l : 0);
        run->lanes[c / LANES].robot[c % LANES] = c / run->side;
    }
    load(run);
    return MCP_ASDF_OK;
}

static mcp_asdf_status_t run_trials(run_t *run, const mcp_asdf_outcome_t *outcome, uint32_t index)
{
    const mcp_asdf_status_t status = start(run, outcome, index);
    for (uint32_t k = 0; k < run->experiment->steps && status == MCP_ASDF_OK; ++k) {
        if (run->arenas != NULL) {
            mcp_asdf_arena_step(run->arenas, run->used);
        }
        see(run, k);
        if (needs_firmware(run, k)) {
            run_firmware(run, k);
        } else {
            run_lanes(run, k);
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

/* Trials side by side in lanes. */
static uint32_t side_of(const mcp_asdf_experiment_t *experiment)
{
    if (!trial_is_linked(experiment)) {
        return LANES;
    }
    if (experiment->arenas == NULL || experiment->robots > MCP_ASDF_ENGINE_MAX_CONNECTED ||
        experiment->trials == 0) {
        return 1;
    }
    const uint32_t runs = (experiment->trials + ARENAS - 1) / ARENAS; /* of about as many trials each */
    return (experiment->trials + runs - 1) / runs;
}

static uint32_t rows_of(const mcp_asdf_experiment_t *experiment, uint32_t side)
{
    return (experiment->robots * side + LANES - 1) / LANES;
}

size_t mcp_asdf_engine_bytes(const mcp_asdf_experiment_t *experiment)
{
    const uint32_t side = side_of(experiment);
    const size_t of_arena = experiment->arenas == NULL || experiment->trials == 0
                                ? 0
                                : sizeof(mcp_asdf_arena_t) + mcp_asdf_arena_bytes(experiment->arenas);
    return VECTOR_BYTES - 1 + rows_of(experiment, side) * sizeof(lanes_t) + side * of_arena;
}

mcp_asdf_status_t mcp_asdf_engine_run(const mcp_asdf_experiment_t *experiment, bool lanes,
                                      const mcp_asdf_outcome_t *outcome, void *memory)
{
    mcp_asdf_status_t status = MCP_ASDF_OK;
    const uint32_t side = lanes ? side_of(experiment) : 1, rows = rows_of(experiment, side);
    lanes_t *const first = (void *)((uint8_t *)memory + -(uintptr_t)memory % VECTOR_BYTES);
    run_t run = {.experiment = experiment,
                 .has_lanes = lanes,
                 .is_robust = mcp_asdf_is_robust(experiment->configs[0]),
                 .columns = mcp_asdf_engine_columns(experiment),
                 .side = side,
                 .rows = rows,
                 .lanes = first,
                 .arenas = experiment->arenas == NULL ? NULL : (void *)(first + rows)};
    for (uint32_t i = 0; i < experiment->trials && status == MCP_ASDF_OK; i += side) {
        status = run_trials(&run, outcome, i);
    }
    return status;
}
