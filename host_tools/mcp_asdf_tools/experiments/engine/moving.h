/* Private to the engine: a trial in a moving world, shared by its two ways to run one. */
#ifndef MCP_ASDF_MOVING_H
#define MCP_ASDF_MOVING_H

#include "trial.h"

/* A trial under way. `words` are the draws of four steps by robot, and a few more. */
typedef struct {
    const mcp_asdf_experiment_t *experiment;
    uint32_t index;
    const trial_t *trial;
    uint32_t words[4][MCP_ASDF_ENGINE_MAX_ROBOTS];
    mcp_asdf_arena_t arena;
} moving_t;

/* Begin: robots without observations in an arena at tick 0. Fails as mcp_asdf_engine_run(). */
mcp_asdf_status_t moving_start(moving_t *moving, const mcp_asdf_experiment_t *experiment, uint32_t index,
                               const trial_t *trial);

/* Whether robots observe in step k, from 0. */
static inline bool moving_observes(const moving_t *moving, uint32_t k)
{
    return (k + 1) % moving->experiment->observation_period == 0;
}

/* Draw the words of steps 4 block .. 4 block + 3. */
void moving_draw(moving_t *moving, uint32_t block);

/* Each robot's observation of the floor in step k, 1 for black. Needs the words of the step. */
void moving_see(const moving_t *moving, uint32_t k, uint32_t *restrict black);

/* The firmware's part of step k (from 0), in an arena that has moved and with words that are drawn. */
void moving_tick(moving_t *moving, uint32_t k);

#endif
