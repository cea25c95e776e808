/* Trials in a moving world, every value from a call of the firmware. engine.h is the manual. */
#include "moving.h"

mcp_asdf_status_t moving_start(moving_t *moving, const mcp_asdf_experiment_t *experiment, uint32_t index,
                               const trial_t *trial)
{
    moving->experiment = experiment;
    moving->index = index;
    moving->trial = trial;
    if (experiment->arenas[index].robots != experiment->robots ||
        mcp_asdf_arena_init(&moving->arena, &experiment->arenas[index]) != MCP_ASDF_ARENA_OK) {
        return MCP_ASDF_ERR_CONFIG;
    }
    return engine_start(experiment, trial);
}

FOR_EACH_TARGET void moving_draw(moving_t *moving, uint32_t block)
{
    const mcp_asdf_experiment_t *const experiment = moving->experiment;
    const uint32_t trial = experiment->first_trial + moving->index;
    const uint32_t count = (experiment->robots + 7) / 8 * 8; /* for full vectors; at most 128 */
    for (uint32_t j = 0; j < count; ++j) {
        const philox_t drawn = draws(experiment->seed, trial, j, block);
        moving->words[0][j] = drawn.word[0];
        moving->words[1][j] = drawn.word[1];
        moving->words[2][j] = drawn.word[2];
        moving->words[3][j] = drawn.word[3];
    }
}

void moving_see(const moving_t *moving, uint32_t k, uint32_t *restrict black)
{
    const mcp_asdf_experiment_t *const e = moving->experiment;
    const uint32_t *const limits = &e->black[moving->index * e->trial_stride + k * e->step_stride];
    const uint32_t *const words = moving->words[k % 4];
    for (uint32_t j = 0; j < e->robots; ++j) {
        const uint32_t limit = limits[j * e->robot_stride];
        black[j] = words[j] >> 1 < (moving->arena.black[j] != 0 ? limit : MCP_ASDF_ENGINE_CERTAIN - limit);
    }
}

/* The last message of each robot reaches the robots that are linked to it now. */
static void deliver(mcp_asdf_t *robots, const mcp_asdf_arena_t *arena)
{
    for (uint32_t p = 0; p < arena->link_count; ++p) {
        const uint8_t a = arena->links[p].a, b = arena->links[p].b;
        (void)mcp_asdf_receive(&robots[a], b, mcp_asdf_x_hat(&robots[b]), mcp_asdf_alpha(&robots[b]));
        (void)mcp_asdf_receive(&robots[b], a, mcp_asdf_x_hat(&robots[a]), mcp_asdf_alpha(&robots[a]));
    }
}

static void observe(moving_t *moving, uint32_t k)
{
    uint32_t black[MCP_ASDF_ENGINE_MAX_ROBOTS];
    moving_see(moving, k, black);
    for (uint32_t j = 0; j < moving->experiment->robots; ++j) {
        (void)mcp_asdf_observe(&moving->trial->robots[j], (mcp_asdf_observation_t)black[j]);
    }
}

/* Before a robot observes, its x_hat and alpha are still those that it said in the step before. */
void moving_tick(moving_t *moving, uint32_t k)
{
    const mcp_asdf_experiment_t *const experiment = moving->experiment;
    mcp_asdf_t *const robots = moving->trial->robots;
    const bool is_late = experiment->latency != 0, closes = engine_closes(experiment, k);
    if (is_late && k > 0 && engine_closes(experiment, k - 1)) {
        deliver(robots, &moving->arena);
    }
    if (moving_observes(moving, k)) {
        observe(moving, k);
    }
    if (!is_late && closes) {
        deliver(robots, &moving->arena);
    }
    for (uint32_t j = 0; j < experiment->robots && closes; ++j) {
        (void)mcp_asdf_settle(&robots[j]);
    }
}

mcp_asdf_status_t moving_run(const mcp_asdf_experiment_t *experiment, uint32_t index, const trial_t *trial)
{
    moving_t moving;
    const mcp_asdf_status_t status = moving_start(&moving, experiment, index, trial);
    for (uint32_t k = 0; k < experiment->steps && status == MCP_ASDF_OK; ++k) {
        if (k % 4 == 0) {
            moving_draw(&moving, k / 4);
        }
        mcp_asdf_arena_step(&moving.arena);
        moving_tick(&moving, k);
        engine_keep(experiment, trial, k + 1);
    }
    return status;
}
