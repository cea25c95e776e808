/* A trial in a moving world, shared by the plain engine and the lanes; not for others. */
#ifndef MCP_ASDF_MOVING_H
#define MCP_ASDF_MOVING_H

#include "trial.h"

/* A trial under way. `words` are the draws of four steps by robot. */
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

/* What robot j's sensor says of the floor in step k: 1 for black. Needs the words of the step. */
static inline uint32_t moving_sees_black(const moving_t *moving, uint32_t k, uint32_t j)
{
    const mcp_asdf_experiment_t *const e = moving->experiment;
    const uint32_t limit =
        e->black[moving->index * e->trial_stride + k * e->step_stride + j * e->robot_stride];
    return moving->words[k % 4][j] >> 1 <
           (moving->arena.black[j] != 0 ? limit : MCP_ASDF_ENGINE_CERTAIN - limit);
}

/* The firmware's part of step k (from 0), in an arena that has moved and with words that are drawn; `said` is
 * whether all broadcast in the step before. Returns whether they do in this one. */
bool moving_tick(moving_t *moving, uint32_t k, bool said);

#endif
