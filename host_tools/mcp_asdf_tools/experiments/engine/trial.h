/* Private to the engine: a trial whose robots are the firmware, and what is kept of it. */
#ifndef MCP_ASDF_TRIAL_H
#define MCP_ASDF_TRIAL_H

#include "lanes.h"

/* One trial's part of the outcome; members as in mcp_asdf_outcome_t. */
typedef mcp_asdf_outcome_t trial_t;

/* What its robots observe: robot j as lane first + j side. */
typedef struct {
    const lanes_t *lanes;
    uint32_t first;
    uint32_t side;
} trial_eyes_t;

/* Whether robots hear some of the others: those linked in the arena, or by arcs. */
static inline bool trial_is_linked(const mcp_asdf_experiment_t *experiment)
{
    return experiment->arenas != NULL || experiment->arcs != NULL;
}

/* Whether robots broadcast and close their rounds in step k, from 0. */
static inline bool trial_closes(const mcp_asdf_experiment_t *experiment, uint32_t k)
{
    return (k + 1) % experiment->comms_period == 0;
}

/* Whether robots observe in step k, from 0. */
static inline bool trial_observes(const mcp_asdf_experiment_t *experiment, uint32_t k)
{
    return (k + 1) % experiment->observation_period == 0;
}

/* The part of the index-th of these trials. */
trial_t trial_part(const mcp_asdf_experiment_t *experiment, const mcp_asdf_outcome_t *outcome,
                   uint32_t index);

/* Initialise a trial's robots and write down step 0. Fails as mcp_asdf_init(). */
mcp_asdf_status_t trial_start(const mcp_asdf_experiment_t *experiment, const trial_t *trial);

/* Step k (from 0) of a trial's robots, by the firmware, in an arena that has moved, or NULL.  */
void trial_tick(const mcp_asdf_experiment_t *experiment, const trial_t *trial, const mcp_asdf_arena_t *arena,
                uint32_t k, trial_eyes_t eyes);

/* Write down what the outcome shows of `step`, 1 .. T. */
void trial_keep(const mcp_asdf_experiment_t *experiment, const trial_t *trial, uint32_t step);

#endif
