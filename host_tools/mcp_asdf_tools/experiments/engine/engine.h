/* Many robots, driven through the firmware's own functions. For PCs only.
 *
 * A trial is N robots that take T steps together: all observe, each receives from others, all settle. In a
 * fully connected swarm each receives from all others (latency 0 of Algorithm 1); in a moving world, arena.h,
 * those that are linked in this step; in a graph, those from which an arc leads to it. A trial depends on the
 * experiment, the seed and its number alone, not on the other trials of a call or on how they are run;
 * docs/internals/study.md describes the draws. Nothing here is static or shared: any number of threads may
 * run trials at once.
 *
 * Ids have 16 bits here, 7 in the firmware, whose rounds end at 127 messages: no robot may receive from
 * more than 127 others in a step. Where there are more than 128 robots, one receives from another under its
 * id modulo 128, without the check for repeats, as nothing arrives twice; the robust filter looks at the id
 * modulo 32 alone.
 *
 * The engine draws observations, carries messages and keeps results. All estimates come from the core, which
 * is compiled into it (lanes.c).
 */
#ifndef MCP_ASDF_ENGINE_H
#define MCP_ASDF_ENGINE_H

#include <stddef.h>

#include "arena.h"
#include "mcp_asdf.h"

#define MCP_ASDF_ENGINE_MAX_ROBOTS MCP_ASDF_ARENA_MAX_ROBOTS
#define MCP_ASDF_ENGINE_MAX_CONNECTED 128           /* robots, where each receives from all others */
#define MCP_ASDF_ENGINE_CERTAIN (UINT32_C(1) << 31) /* probability 1 of an observation */

/* A run of trials, which must be in these ranges: the tools check them (experiment.py).
 *   seed          of all draws
 *   first_trial   number of the first of `trials` trials
 *   robots        N, 1 .. MCP_ASDF_ENGINE_MAX_ROBOTS, fully connected MCP_ASDF_ENGINE_MAX_CONNECTED
 *   steps         T, 1 .. 2^31 - 2
 *   configs       [N] settings by robot, all with the same filter_period, in rounds, and memory
 *   comms_period  steps between broadcasts, the first in step `comms_period`; 1 or more. Every robot
 *                 broadcasts and closes its round in the same steps
 *   b_hat         [N] assumed accuracies at the start, as mcp_asdf_init() takes them
 *   black         probability that a robot observes black, unit 2^-31, 0 .. MCP_ASDF_ENGINE_CERTAIN;
 *                 black[i * trial_stride + k * step_stride + j * robot_stride] is that of the i-th of these
 *                 trials in step k for robot j, all from 0; a stride of 0 repeats one value. In a moving
 *                 world it is that on a black floor; on a white one the robot observes white with it
 *   sampling_interval  record every robot each `sampling_interval` steps; 0 for never
 *   observation_period  steps between observations, the first in step `observation_period`; 1 or more
 *   arenas        NULL where nobody moves; otherwise [trials] worlds of `robots` robots that differ in seeds
 *   arcs          NULL unless there is a graph: `arc_count` pairs, b receives from a, in ascending order of a
 *   latency       0: a message reaches the robots linked to its sender in its step; 1: in the next. Fully
 *                 connected 0
 *   x_hat_bits    bits of x_hat in a message, 1 .. MCP_ASDF_X_HAT_BITS_MAX: what robots receive is rounded to
 *                 codes of mcp_asdf_small.h. 0: messages are exact
 *   alpha_bits    bits of alpha in a message, 1 .. MCP_ASDF_ALPHA_BITS_MAX; unused if x_hat_bits is 0
 *   liars         number of robots that broadcast a lie in place of their estimates, 0 .. N: the last ones
 *   lie           x_hat and alpha that they broadcast, as mcp_asdf_receive() takes them */
typedef struct {
    uint64_t seed;
    uint32_t first_trial;
    uint32_t trials;
    uint32_t robots;
    uint32_t steps;
    const mcp_asdf_config_t *const *configs;
    uint32_t comms_period;
    const uint32_t *b_hat;
    const uint32_t *black;
    size_t trial_stride;
    size_t step_stride;
    size_t robot_stride;
    uint32_t sampling_interval;
    uint32_t observation_period;
    const mcp_asdf_arena_config_t *arenas;
    const mcp_asdf_pair_t *arcs;
    size_t arc_count;
    uint32_t latency;
    uint32_t x_hat_bits;
    uint32_t alpha_bits;
    uint32_t liars;
    uint32_t lie[2];
} mcp_asdf_experiment_t;

/* A robot's values after a step, in the firmware's units. */
typedef struct {
    uint64_t beta;
    uint32_t t;
    uint32_t n;
    uint32_t x_hat;
    uint32_t alpha;
    uint32_t x_bar;
    uint32_t x;
    uint32_t b_hat;
} mcp_asdf_record_t;

/* Results, in memory of the caller.
 *   robots    [trials][N] at the end
 *   x         [trials][columns][T + 1] informed estimates, MCP_ASDF_HALF at step 0, with columns from
 *             mcp_asdf_engine_columns()
 *   b_hat     [trials][T / (filter_period comms_period)][N] assumed accuracies after each filter step
 *   records   [trials][T / sampling_interval][N]; not used if sampling_interval is 0 */
typedef struct {
    mcp_asdf_t *robots;
    uint32_t *x;
    uint32_t *b_hat;
    mcp_asdf_record_t *records;
} mcp_asdf_outcome_t;

/* Series of x in a trial: 1 where all robots have the same x to the bit, in a fully connected swarm without
 * robust filters, liars and rounded messages if comms_period is 1; otherwise N. */
uint32_t mcp_asdf_engine_columns(const mcp_asdf_experiment_t *experiment);

/* Whether trials can be run in lanes: comms_period 1, nothing recorded, no liars, exact messages, and
 * the robust filter in all robots or in none. */
bool mcp_asdf_engine_has_lanes(const mcp_asdf_experiment_t *experiment);

/* Bytes of memory that a run needs, for any number of trials: linear in robots, from 2048 on. O(1). */
size_t mcp_asdf_engine_bytes(const mcp_asdf_experiment_t *experiment);

/* Run the trials, one by one through calls of the firmware for every robot and step, or `in_lanes` the same
 * to the bit, faster: between filter steps several fully connected trials are computed side by side, or the
 * robots of one that move. O(trials steps robots).
 * Fails as mcp_asdf_init() does, and with MCP_ASDF_ERR_CONFIG where robots find no room in their arena. With
 * `in_lanes` it needs mcp_asdf_engine_has_lanes(). `memory`, of mcp_asdf_engine_bytes() and aligned for
 * doubles, is free again afterwards. */
mcp_asdf_status_t mcp_asdf_engine_run(const mcp_asdf_experiment_t *experiment, bool in_lanes,
                                      const mcp_asdf_outcome_t *outcome, void *memory);

#endif
