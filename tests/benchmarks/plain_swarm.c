/* A swarm in plain double C: a yardstick of engine.py. plain_swarm full|moving TRIALS prints robot-ticks per
 * second of processor time, and a check. */
#include "arena.h"
#include "plain.h"

#include <stdio.h>
#include <stdlib.h>
#include <time.h>

enum { STEPS = 40000, PERIOD = 1000, MOST = 20 };
static const double T_SCORE = 0.065, ACCURACY = 0.95, FILL_RATIO = 0.55, SIDE = 5.5486;
static plain_t robots[MOST];
static float series[MOST * (STEPS + 1)];
static mcp_asdf_arena_t arena;
static uint64_t state = 88172645463325252u;

static uint32_t draw(double probability)
{
    state ^= state << 13;
    state ^= state >> 7;
    state ^= state << 17;
    return (double)(state >> 11) * 0x1p-53 < probability;
}

static void filter(plain_t *own, const plain_sums_t *heard)
{
    const double m = heard->m, root = __builtin_sqrt(m);
    if (m >= 2) {
        (void)plain_filter(own, heard, (T_SCORE / root + 1) * (T_SCORE / root + 1) * m / (m - 1));
    }
}

/* All hear all: sums of all, and for the test less the own message. */
static void run_full(int count)
{
    for (int k = 1; k <= STEPS; ++k) {
        plain_sums_t all = {0};
        for (int i = 0; i < count; ++i) {
            plain_observe(&robots[i], draw(0.545));
            plain_hear(&all, robots[i].x_hat, robots[i].alpha);
        }
        series[k] = (float)(all.alpha_x / all.alpha);
        for (int i = 0; k % PERIOD == 0 && i < count; ++i) {
            const double x = robots[i].x_hat, alpha = robots[i].alpha;
            const plain_sums_t others = {all.alpha - alpha, all.alpha_x - alpha * x, all.x - x,
                                         all.x_squared - x * x, all.m - 1};
            filter(&robots[i], &others);
        }
    }
}

/* What was said a tick ago, by the arena's links. */
static void run_moving(int count)
{
    for (int k = 1; k <= STEPS; ++k) {
        plain_sums_t heard[MOST] = {{0}};
        mcp_asdf_arena_step(&arena);
        for (uint32_t p = 0; p < arena.link_count; ++p) {
            const int a = (int)arena.links[p].a, b = (int)arena.links[p].b;
            plain_hear(&heard[a], robots[b].x_hat, robots[b].alpha);
            plain_hear(&heard[b], robots[a].x_hat, robots[a].alpha);
        }
        for (int i = 0; i < count; ++i) {
            plain_t *const own = &robots[i];
            plain_observe(own, draw(ACCURACY) == arena.black[i]);
            series[(long)i * (STEPS + 1) + k] =
                (float)((own->alpha * own->x_hat + heard[i].alpha_x) / (own->alpha + heard[i].alpha));
            if (k % PERIOD == 0) {
                filter(own, &heard[i]);
            }
        }
    }
}

int main(int argc, char **argv)
{
    const int moves = argc > 1 && argv[1][0] == 'm', trials = argc > 2 ? atoi(argv[2]) : 10;
    const int count = moves ? 20 : 10, flawed = 3 * count / 10;
    double check = 0;
    const clock_t start = clock();
    for (int trial = 0; trial < trials; ++trial) {
        const mcp_asdf_arena_config_t config = {.seed = (uint64_t)trial,
                                                .robots = (uint32_t)count,
                                                .width = SIDE,
                                                .height = SIDE,
                                                .speed = 0.1414,
                                                .range = 0.7,
                                                .tick = 0.1,
                                                .tile = 0.01,
                                                .fill_ratio = FILL_RATIO};
        for (int i = 0; i < count; ++i) {
            robots[i] = (plain_t){i < flawed ? 0.55 : ACCURACY, 0.5, 0, 0, 0};
        }
        if (moves && mcp_asdf_arena_init(&arena, &config) != MCP_ASDF_ARENA_OK) {
            return 1;
        }
        (moves ? run_moving : run_full)(count);
        check += (double)series[STEPS];
    }
    const double seconds = (double)(clock() - start) / CLOCKS_PER_SEC;
    printf("%.6g %.6g\n", (double)trials * STEPS * count / seconds, check / trials);
    return 0;
}
