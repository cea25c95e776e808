/* A swarm in the moving world of arena.c: a yardstick of engine.py. Prints robot-ticks per second of
 * processor time. */
#include "arena.h"
#include "plain_double.h"

#include <stdio.h>
#include <stdlib.h>
#include <time.h>

enum { ROBOTS = 20, STEPS = 40000, PERIOD = 1000, FLAWED = 6 };
static const double T_SCORE = 0.065, ACCURACY = 0.95, SIDE = 5.5486;

static void hear(heard_t *heard, const robot_t *sender)
{
    heard->count += 1;
    heard->x += sender->x_hat;
    heard->squares += sender->x_hat * sender->x_hat;
    heard->weight += sender->alpha;
    heard->weighted += sender->alpha * sender->x_hat;
}

static void run(robot_t *robots, mcp_asdf_arena_t *arena, float *series)
{
    for (int k = 1; k <= STEPS; ++k) {
        heard_t heard[ROBOTS] = {{0}};
        mcp_asdf_arena_step(arena);
        for (uint32_t p = 0; p < arena->link_count; ++p) { /* what was said a tick ago */
            hear(&heard[arena->links[p].a], &robots[arena->links[p].b]);
            hear(&heard[arena->links[p].b], &robots[arena->links[p].a]);
        }
        for (int i = 0; i < ROBOTS; ++i) {
            robot_t *const own = &robots[i];
            observe(own, k, draw(ACCURACY) == arena->black[i]);
            series[(long)i * (STEPS + 1) + k] =
                (float)((own->alpha * own->x_hat + heard[i].weighted) / (own->alpha + heard[i].weight));
            if (k % PERIOD == 0 && heard[i].count >= 2) {
                test_and_update(own, k, &heard[i], T_SCORE);
            }
        }
    }
}

int main(int argc, char **argv)
{
    static float series[ROBOTS * (STEPS + 1)];
    static mcp_asdf_arena_t arena;
    const int trials = argc > 1 ? atoi(argv[1]) : 10;
    double check = 0;
    const clock_t start = clock();
    for (int trial = 0; trial < trials; ++trial) {
        robot_t robots[ROBOTS];
        const mcp_asdf_arena_config_t config = {.seed = (uint64_t)trial,
                                                .robots = ROBOTS,
                                                .width = SIDE,
                                                .height = SIDE,
                                                .speed = 0.1414,
                                                .range = 0.7,
                                                .tick = 0.1,
                                                .tile = 0.01,
                                                .fill_ratio = 0.55};
        for (int i = 0; i < ROBOTS; ++i) {
            robots[i] = (robot_t){0, i < FLAWED ? 0.55 : 0.95, 0.5, 0};
        }
        if (mcp_asdf_arena_init(&arena, &config) != MCP_ASDF_ARENA_OK) {
            return 1;
        }
        run(robots, &arena, series);
        check += (double)series[STEPS];
    }
    const double seconds = (double)(clock() - start) / CLOCKS_PER_SEC;
    printf("%.6g %.6g\n", (double)trials * STEPS * ROBOTS / seconds, check / trials);
    return 0;
}
