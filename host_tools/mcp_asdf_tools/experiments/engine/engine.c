/* The plain engine: every value comes out of a call of the firmware. engine.h is the manual. */
#include "engine.h"

#include "trial.h"

void mcp_asdf_engine_philox(const uint32_t counter[4], const uint32_t key[2], uint32_t words[4])
{
    const philox_t drawn =
        philox((philox_t){{counter[0], counter[1], counter[2], counter[3]}}, key[0], key[1]);
    for (uint32_t i = 0; i < 4; ++i) {
        words[i] = drawn.word[i];
    }
}

/* The draws of four steps, [4][robots]. */
static void observe_block(const mcp_asdf_experiment_t *experiment, uint32_t index, uint32_t block,
                          uint8_t *observations)
{
    const uint32_t count = experiment->robots;
    for (uint32_t j = 0; j < count; ++j) {
        const philox_t drawn = draws(experiment->seed, experiment->first_trial + index, j, block);
        for (uint32_t i = 0; i < 4 && 4 * block + i < experiment->steps; ++i) {
            const uint32_t limit =
                experiment->black[index * experiment->trial_stride +
                                  (4 * block + i) * experiment->step_stride + j * experiment->robot_stride];
            observations[i * count + j] = drawn.word[i] >> 1 < limit;
        }
    }
}

static mcp_asdf_status_t run_trial(const mcp_asdf_experiment_t *experiment, uint32_t index,
                                   const trial_t *trial)
{
    uint8_t observations[4 * MCP_ASDF_ENGINE_MAX_ROBOTS];
    const mcp_asdf_status_t status = engine_start(experiment, trial);
    if (status != MCP_ASDF_OK) {
        return status;
    }
    for (uint32_t step = 0; step < experiment->steps; ++step) {
        if (step % 4 == 0) {
            observe_block(experiment, index, step / 4, observations);
        }
        engine_tick(trial->robots, experiment->robots, observations + (size_t)(step % 4) * experiment->robots,
                    engine_closes(experiment, step));
        engine_keep(experiment, trial, step + 1);
    }
    return MCP_ASDF_OK;
}

mcp_asdf_status_t mcp_asdf_engine_run(const mcp_asdf_experiment_t *experiment,
                                      const mcp_asdf_outcome_t *outcome)
{
    mcp_asdf_status_t status = engine_check(experiment);
    for (uint32_t index = 0; index < experiment->trials && status == MCP_ASDF_OK; ++index) {
        const trial_t trial = engine_trial(experiment, outcome, index);
        status = experiment->arenas == NULL ? run_trial(experiment, index, &trial)
                                            : moving_run(experiment, index, &trial);
    }
    return status;
}
