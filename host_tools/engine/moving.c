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

/* What everybody said last reaches who is linked now. */
static void deliver(mcp_asdf_t *robots, const mcp_asdf_arena_t *arena)
{
    for (uint32_t p = 0; p < arena->link_count; ++p) {
        const uint8_t a = arena->links[p].a, b = arena->links[p].b;
        (void)mcp_asdf_receive(&robots[a], b, mcp_asdf_x_hat(&robots[b]), mcp_asdf_alpha(&robots[b]));
        (void)mcp_asdf_receive(&robots[b], a, mcp_asdf_x_hat(&robots[a]), mcp_asdf_alpha(&robots[a]));
    }
}

/* Before a robot observes, its x_hat and alpha are still those that it said in the step before. */
bool moving_tick(moving_t *moving, uint32_t k, bool said)
{
    mcp_asdf_t *const robots = moving->trial->robots;
    const bool is_late = moving->experiment->latency != 0, observes = moving_observes(moving, k);
    bool due = false;
    if (is_late && said) {
        deliver(robots, &moving->arena);
    }
    for (uint32_t j = 0; j < moving->experiment->robots; ++j) {
        const uint32_t z = observes ? moving_sees_black(moving, k, j) : (uint32_t)MCP_ASDF_NONE;
        due = mcp_asdf_observe(&robots[j], (mcp_asdf_observation_t)z) == MCP_ASDF_DUE;
    }
    if (!is_late && due) {
        deliver(robots, &moving->arena);
    }
    for (uint32_t j = 0; j < moving->experiment->robots; ++j) {
        (void)mcp_asdf_settle(&robots[j]);
    }
    return due;
}

static void draw(moving_t *moving, uint32_t block)
{
    const mcp_asdf_experiment_t *const experiment = moving->experiment;
    for (uint32_t j = 0; j < experiment->robots; ++j) {
        const philox_t drawn = draws(experiment->seed, experiment->first_trial + moving->index, j, block);
        for (uint32_t i = 0; i < 4; ++i) {
            moving->words[i][j] = drawn.word[i];
        }
    }
}

mcp_asdf_status_t moving_run(const mcp_asdf_experiment_t *experiment, uint32_t index, const trial_t *trial)
{
    moving_t moving;
    bool said = false;
    const mcp_asdf_status_t status = moving_start(&moving, experiment, index, trial);
    for (uint32_t k = 0; k < experiment->steps && status == MCP_ASDF_OK; ++k) {
        if (k % 4 == 0) {
            draw(&moving, k / 4);
        }
        mcp_asdf_arena_step(&moving.arena);
        said = moving_tick(&moving, k, said);
        engine_keep(experiment, trial, k + 1);
    }
    return status;
}
