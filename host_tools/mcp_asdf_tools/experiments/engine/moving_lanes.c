/* Trials in a moving world in lanes. engine.h is the manual.
 *
 * Robots observe and settle side by side; what they hear goes along the links of the arena, one by one. The
 * steps in which the filter may run or t reaches the memory and the last one are the firmware's own; before
 * them the lanes hand over what they changed.
 */
#include "lanes.h"
#include "moving.h"

#define FOR_ROBOTS for (uint32_t j = 0; j < world->count; ++j)
#define MULTIPLE 8 /* of lanes in use, so that vectors are full */

/* A trial under way. Lanes beyond the last robot run idle.
 *   count     lanes in use
 *   ticks     steps since the last one of the firmware, and
 *   observed  how many of them had observations, and
 *   messages  how many messages each robot heard in them
 *   t         observations of each robot
 *   said      sums of each message
 *   heard     sums of each round */
typedef struct {
    moving_t moving;
    uint32_t count;
    uint32_t ticks;
    uint32_t observed;
    uint32_t messages[MCP_ASDF_ENGINE_MAX_ROBOTS];
    uint32_t t;
    lanes_t lanes;
    lanes_sums_t said;
    lanes_sums_t heard;
} world_t;

/* Step k of those with observations; idle lanes never see black. */
static void observe(world_t *world, uint32_t k)
{
    uint32_t black[MCP_ASDF_ENGINE_MAX_ROBOTS];
    for (uint32_t j = world->moving.experiment->robots; j < world->count; ++j) {
        black[j] = 0;
    }
    moving_see(&world->moving, k, black);
    lanes_observe(&world->lanes, world->count, ++world->t, black);
    lanes_say(&world->lanes, world->count, &world->said);
    ++world->observed;
}

static void hear_one(world_t *world, uint32_t receiver, uint32_t sender)
{
    world->heard.alpha[receiver] += world->said.alpha[sender];
    world->heard.alpha_x_low[receiver] += world->said.alpha_x_low[sender];
    world->heard.alpha_x_high[receiver] += world->said.alpha_x_high[sender];
    ++world->messages[receiver];
}

static void hear(world_t *world)
{
    const mcp_asdf_arena_t *const arena = &world->moving.arena;
    FOR_ROBOTS { world->heard.alpha[j] = world->heard.alpha_x_low[j] = world->heard.alpha_x_high[j] = 0; }
    for (uint32_t p = 0; p < arena->link_count; ++p) {
        hear_one(world, arena->links[p].a, arena->links[p].b);
        hear_one(world, arena->links[p].b, arena->links[p].a);
    }
}

static void inform(world_t *world, uint32_t step)
{
    const size_t length = (size_t)world->moving.experiment->steps + 1;
    uint32_t x[MCP_ASDF_ENGINE_MAX_ROBOTS];
    lanes_inform(&world->lanes, world->count, &world->heard, x);
    for (uint32_t j = 0; j < world->moving.experiment->robots; ++j) {
        world->moving.trial->x[j * length + step] = x[j];
    }
}

/* Step k (from 0) of robots in an arena that has moved. Until they observe, their messages are still those of
 * the step before; before step 0 there were none. */
static void run_step(world_t *world, uint32_t k)
{
    const bool is_late = world->moving.experiment->latency != 0;
    if (is_late && k > 0) {
        hear(world);
    }
    if (moving_observes(&world->moving, k)) {
        observe(world, k);
    }
    if (!is_late) {
        hear(world);
    }
    inform(world, k + 1);
    ++world->ticks;
}

/* Bring the robots to the state after the steps in lanes, except for members that the next step of the
 * firmware forms anew. */
static void hand_over(world_t *world)
{
    for (uint32_t j = 0; j < world->moving.experiment->robots; ++j) {
        mcp_asdf_t *const robot = &world->moving.trial->robots[j];
        robot->t = world->t;
        robot->n = world->lanes.n[j];
        robot->x_hat = world->lanes.x_hat[j];
        robot->alpha = world->lanes.alpha[j];
        robot->updated = world->observed == 0 ? robot->updated : 0;
        robot->filter_left -= world->ticks;
        robot->counters.accepted = (uint16_t)(robot->counters.accepted + world->messages[j]);
    }
}

static void load_all(world_t *world)
{
    const mcp_asdf_t *const robots = world->moving.trial->robots;
    world->t = mcp_asdf_t_count(&robots[0]);
    world->ticks = world->observed = 0;
    FOR_ROBOTS
    {
        lanes_load(&world->lanes, j, &robots[j < world->moving.experiment->robots ? j : 0]);
        world->messages[j] = 0;
    }
    lanes_say(&world->lanes, world->count, &world->said);
}

static bool needs_firmware(const world_t *world, uint32_t k)
{
    const mcp_asdf_experiment_t *const experiment = world->moving.experiment;
    const mcp_asdf_config_t *const config = experiment->configs[0];
    return (k + 1) % config->filter_period == 0 || k + 1 == experiment->steps ||
           (world->t + 1 == config->memory && moving_observes(&world->moving, k));
}

mcp_asdf_status_t moving_run_lanes(const mcp_asdf_experiment_t *experiment, uint32_t index,
                                   const trial_t *trial)
{
    world_t world = {.count = (experiment->robots + MULTIPLE - 1) / MULTIPLE * MULTIPLE};
    const mcp_asdf_status_t status = moving_start(&world.moving, experiment, index, trial);
    if (status != MCP_ASDF_OK) {
        return status;
    }
    load_all(&world);
    for (uint32_t k = 0; k < experiment->steps; ++k) {
        if (k % 4 == 0) {
            moving_draw(&world.moving, k / 4);
        }
        mcp_asdf_arena_step(&world.moving.arena);
        if (!needs_firmware(&world, k)) {
            run_step(&world, k);
            continue;
        }
        hand_over(&world);
        moving_tick(&world.moving, k);
        engine_keep(experiment, trial, k + 1);
        load_all(&world);
    }
    return MCP_ASDF_OK;
}
