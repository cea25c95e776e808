/* Private to the engine: one trial whose robots are the firmware, and its results. */
#ifndef MCP_ASDF_TRIAL_H
#define MCP_ASDF_TRIAL_H

#include "lanes.h"

/* One trial's part of the outcome; members as in mcp_asdf_outcome_t. */
typedef mcp_asdf_outcome_t trial_t;

/* What the robots of one trial observe: a robot, counted from 0, the same as the lane with the index
 * first_lane
 * + robot * parallel_trials. A lane index counts through all rows: it stands for lane index % LANES of row
 * index / LANES. */
typedef struct {
    const lanes_t *lanes;
    uint32_t first_lane;
    uint32_t parallel_trials;
} trial_observations_t;

/* Whether robots receive from some of the others only: those linked in the arena, or by arcs. */
static inline bool trial_is_linked(const mcp_asdf_experiment_t *experiment)
{
    return experiment->arenas != NULL || experiment->arcs != NULL;
}

/* Whether robots broadcast and close their rounds in step `step_index`, from 0. */
static inline bool trial_closes_round(const mcp_asdf_experiment_t *experiment, uint32_t step_index)
{
    const uint32_t steps_taken = step_index + 1; /* with this one */
    return steps_taken % experiment->comms_period == 0;
}

/* Whether robots observe in step `step_index`, from 0. */
static inline bool trial_observes(const mcp_asdf_experiment_t *experiment, uint32_t step_index)
{
    const uint32_t steps_taken = step_index + 1; /* with this one */
    return steps_taken % experiment->observation_period == 0;
}

/* Returns those parts of the outcome's arrays that hold the results of the index-th trial, from 0. */
trial_t trial_outcome(const mcp_asdf_experiment_t *experiment, const mcp_asdf_outcome_t *outcome,
                      uint32_t index);

/* Initialise a trial's robots and record step 0. Fails as mcp_asdf_init(). */
mcp_asdf_status_t trial_start(const mcp_asdf_experiment_t *experiment, const trial_t *trial);

/* Take step `step_index`, from 0, of a trial's robots by the firmware. `arena` is NULL, or has moved for this
 * step. */
void trial_step(const mcp_asdf_experiment_t *experiment, const trial_t *trial, const mcp_asdf_arena_t *arena,
                uint32_t step_index, trial_observations_t observations);

/* Record what the outcome holds of the robots after `step`, 1 .. T. */
void trial_record(const mcp_asdf_experiment_t *experiment, const trial_t *trial, uint32_t step);

#endif
