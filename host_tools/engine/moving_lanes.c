/* The robots of a moving world side by side. engine.h is the manual.
 *
 * Robots observe and settle in lanes; what they hear goes along the links of the arena, one by one. The steps
 * in which the filter may run or t reaches the memory and the last one are the firmware's own; before them
 * the lanes hand over what they changed.
 */
#define LANES MCP_ASDF_ENGINE_MAX_ROBOTS

#include "lanes.h"
#include "moving.h"

#define FOR_ROBOTS for (uint32_t j = 0; j < world->lanes; ++j)
#define MULTIPLE 8 /* of lanes in use, so that vectors are full */

/* alpha and alpha x_hat by robot, as in mcp_asdf_sums_t. */
typedef struct {
    uint64_t alpha[LANES];
    uint64_t alpha_x_low[LANES];
    uint64_t alpha_x_high[LANES];
} sums_t;

/* A trial under way. Lanes beyond the last robot run idle.
 *   t         observations of each robot
 *   own       what each says, with its x_hat
 *   social    what each has heard in this step
 *   messages  heard since the last step of the firmware
 *   x         informed estimates of the last step that wrote them down */
typedef struct {
    moving_t moving;
    uint32_t lanes;
    uint32_t t;
    robot_lanes_t robots;
    uint32_t x_hat[LANES];
    sums_t own;
    sums_t social;
    uint32_t messages[LANES];
    uint32_t x[LANES];
} world_t;

INLINE void draw(world_t *world, uint32_t block)
{
    const mcp_asdf_experiment_t *const experiment = world->moving.experiment;
    const uint32_t trial = experiment->first_trial + world->moving.index;
    FOR_ROBOTS
    {
        const philox_t drawn = draws(experiment->seed, trial, j, block);
        world->moving.words[0][j] = drawn.word[0];
        world->moving.words[1][j] = drawn.word[1];
        world->moving.words[2][j] = drawn.word[2];
        world->moving.words[3][j] = drawn.word[3];
    }
}

/* What sensors say in step k; idle lanes see what robot 0 does. */
INLINE void see(const world_t *world, uint32_t k, uint32_t *black)
{
    const mcp_asdf_experiment_t *const e = world->moving.experiment;
    const uint32_t *const limits = &e->black[world->moving.index * e->trial_stride + k * e->step_stride];
    const uint32_t *const words = world->moving.words[k % 4];
    FOR_ROBOTS
    {
        const uint32_t limit = limits[(j < e->robots ? j : 0) * e->robot_stride];
        const uint32_t bound = choose(world->moving.arena.black[j], limit, MCP_ASDF_ENGINE_CERTAIN - limit);
        black[j] = words[j] >> 1 < bound;
    }
}

INLINE void observe(world_t *world, uint32_t k)
{
    const step_t step = step_at(++world->t);
    uint32_t black[LANES];
    see(world, k, black);
    FOR_ROBOTS
    {
        const estimate_t estimate = observe_lane(&world->robots, j, black[j], &step);
        world->x_hat[j] = estimate.x_hat;
        world->own.alpha[j] = estimate.alpha;
        world->own.alpha_x_low[j] = low_product(estimate);
        world->own.alpha_x_high[j] = high_product(estimate);
    }
}

INLINE void hear_one(world_t *world, uint32_t receiver, uint32_t sender)
{
    world->social.alpha[receiver] += world->own.alpha[sender];
    world->social.alpha_x_low[receiver] += world->own.alpha_x_low[sender];
    world->social.alpha_x_high[receiver] += world->own.alpha_x_high[sender];
    ++world->messages[receiver];
}

INLINE void hear(world_t *world)
{
    const mcp_asdf_arena_t *const arena = &world->moving.arena;
    for (uint32_t j = 0; j < world->lanes; ++j) {
        world->social.alpha[j] = world->social.alpha_x_low[j] = world->social.alpha_x_high[j] = 0;
    }
    for (uint32_t p = 0; p < arena->link_count; ++p) {
        hear_one(world, arena->links[p].a, arena->links[p].b);
        hear_one(world, arena->links[p].b, arena->links[p].a);
    }
}

INLINE void inform(world_t *world, uint32_t step)
{
    const sums_t *const own = &world->own, *const social = &world->social;
    FOR_ROBOTS
    {
        world->x[j] =
            informed_lane(own->alpha[j] + social->alpha[j], own->alpha_x_low[j] + social->alpha_x_low[j],
                          own->alpha_x_high[j] + social->alpha_x_high[j]);
    }
    const size_t length = (size_t)world->moving.experiment->steps + 1;
    for (uint32_t j = 0; j < world->moving.experiment->robots; ++j) {
        world->moving.trial->x[j * length + step] = world->x[j];
    }
}

/* Step k (from 0) of robots in an arena that has moved. What they say is still of the step before until they
 * observe; in step 0 nobody has said anything. */
FOR_EACH_TARGET static void run_lanes(world_t *world, uint32_t k)
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
}

FOR_EACH_TARGET static void draw_all(world_t *world, uint32_t block) { draw(world, block); }

/* The bits of an alpha of at most 24 significant ones. */
static uint32_t binary32(uint64_t units)
{
    const float value = (float)units * 0x1p-24F;
    uint32_t bits;
    memcpy(&bits, &value, sizeof bits);
    return bits;
}

/* What `ticks` steps in lanes leave behind, but for what the next step of the firmware forms anew. Where the
 * accuracy says nothing lanes have an x_hat at an end of the scale, without weight. */
static void hand_over(world_t *world, uint32_t ticks)
{
    for (uint32_t j = 0; j < world->moving.experiment->robots; ++j) {
        mcp_asdf_t *const robot = &world->moving.trial->robots[j];
        const uint32_t accepted = robot->counters.accepted + world->messages[j];
        robot->t = world->t;
        robot->n = world->robots.n[j];
        robot->x_hat = world->own.alpha[j] == 0 ? MCP_ASDF_HALF : world->x_hat[j];
        robot->alpha = binary32(world->own.alpha[j]);
        robot->filter_left -= ticks;
        robot->counters.accepted = (uint16_t)(accepted > UINT16_MAX ? UINT16_MAX : accepted);
        world->messages[j] = 0;
    }
}

static void load_all(world_t *world)
{
    const mcp_asdf_t *const robots = world->moving.trial->robots;
    world->t = mcp_asdf_t_count(&robots[0]);
    for (uint32_t j = 0; j < world->lanes; ++j) {
        const mcp_asdf_t *const robot = &robots[j < world->moving.experiment->robots ? j : 0];
        mcp_asdf_sums_t said = {0};
        (void)mcp_asdf_sums_add(&said, mcp_asdf_x_hat(robot), mcp_asdf_alpha(robot));
        load(&world->robots, j, robot);
        world->x_hat[j] = mcp_asdf_x_hat(robot);
        world->own.alpha[j] = said.alpha;
        world->own.alpha_x_low[j] = said.alpha_x_low;
        world->own.alpha_x_high[j] = said.alpha_x_high;
    }
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
    world_t world = {.lanes = (experiment->robots + MULTIPLE - 1) / MULTIPLE * MULTIPLE};
    const mcp_asdf_status_t status = moving_start(&world.moving, experiment, index, trial);
    uint32_t ticks = 0;
    if (status != MCP_ASDF_OK) {
        return status;
    }
    load_all(&world);
    for (uint32_t k = 0; k < experiment->steps; ++k) {
        if (k % 4 == 0) {
            draw_all(&world, k / 4);
        }
        mcp_asdf_arena_step(&world.moving.arena);
        if (!needs_firmware(&world, k)) {
            run_lanes(&world, k);
            ++ticks;
            continue;
        }
        hand_over(&world, ticks);
        (void)moving_tick(&world.moving, k, k > 0);
        engine_keep(experiment, trial, k + 1);
        load_all(&world);
        ticks = 0;
    }
    return MCP_ASDF_OK;
}
