/* Private to the engine: trials, shared by its two ways to run them. */
#ifndef MCP_ASDF_TRIAL_H
#define MCP_ASDF_TRIAL_H

#include "engine.h"
#include "philox.h"

/* Compiles a function for several vector sizes; the one for the processor at hand is chosen when the program
 * starts. Results are the same. Tests and benchmarks set it to compile for one of them. */
#ifndef FOR_EACH_TARGET
#if defined(__GNUC__) && !defined(__clang__) && defined(__x86_64__) && defined(__gnu_linux__)
#define FOR_EACH_TARGET __attribute__((target_clones("default", "arch=x86-64-v3", "arch=x86-64-v4")))
#else
#define FOR_EACH_TARGET
#endif
#endif

/* One trial's part of the outcome; members as in mcp_asdf_outcome_t. */
typedef mcp_asdf_outcome_t trial_t;

/* Ticks from one run of the filter to the next. */
static inline uint64_t engine_filter_ticks(const mcp_asdf_experiment_t *experiment)
{
    return (uint64_t)experiment->configs[0]->filter_period * experiment->comms_period;
}

/* Whether robots broadcast and close their rounds in `step`, from 0. */
static inline bool engine_closes(const mcp_asdf_experiment_t *experiment, uint32_t step)
{
    return (step + 1) % experiment->comms_period == 0;
}

static inline uint32_t engine_columns(const mcp_asdf_experiment_t *experiment)
{
    const bool is_same = experiment->arenas == NULL && experiment->comms_period == 1;
    return is_same ? 1 : experiment->robots;
}

static inline trial_t engine_trial(const mcp_asdf_experiment_t *experiment, const mcp_asdf_outcome_t *outcome,
                                   uint32_t index)
{
    const size_t count = experiment->robots, steps = experiment->steps;
    const size_t records =
        experiment->sampling_interval == 0 ? 0 : steps / experiment->sampling_interval * count;
    return (trial_t){outcome->robots + index * count,
                     outcome->x + (size_t)index * engine_columns(experiment) * (steps + 1),
                     outcome->b_hat + index * (steps / engine_filter_ticks(experiment)) * count,
                     records == 0 ? 0 : outcome->records + index * records};
}

/* Fails as mcp_asdf_engine_run() does but for what mcp_asdf_init() checks. */
mcp_asdf_status_t engine_check(const mcp_asdf_experiment_t *experiment);

/* Initialise a trial's robots and write down step 0. Fails as mcp_asdf_init(). */
mcp_asdf_status_t engine_start(const mcp_asdf_experiment_t *experiment, const trial_t *trial);

/* One tick of all robots; `closes` is whether they broadcast and close their rounds in it. */
void engine_tick(mcp_asdf_t *robots, uint32_t count, const uint8_t *observations, bool closes);

/* Run trial `index` in its arena; the same, between filter steps in lanes. Fail as mcp_asdf_engine_run(). */
mcp_asdf_status_t moving_run(const mcp_asdf_experiment_t *experiment, uint32_t index, const trial_t *trial);
mcp_asdf_status_t moving_run_lanes(const mcp_asdf_experiment_t *experiment, uint32_t index,
                                   const trial_t *trial);

/* Write down what the outcome shows of `step`, 1 .. T. */
void engine_keep(const mcp_asdf_experiment_t *experiment, const trial_t *trial, uint32_t step);

#endif
