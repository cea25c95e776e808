/* Swarms in plain double C, as one would write them for speed alone: a yardstick of engine.py, without checks
 * and a filter. plain_swarm full|moving TRIALS prints robot-steps per second of processor time. */
#include "arena.h"

#include <stdio.h>
#include <stdlib.h>
#include <time.h>

enum { STEPS = 40000, MOST = 20 };

static struct {
    double b_hat, x_hat, alpha, heard_alpha, heard_alpha_x;
    uint32_t t, n;
} robots[MOST];
static float series[MOST][STEPS];
static mcp_asdf_arena_t arena;
static double memory[1 << 16]; /* twice what the arena needs */
static uint64_t state = 88172645463325252u;

static uint32_t draw(double probability)
{
    state ^= state << 13;
    state ^= state >> 7;
    state ^= state << 17;
    return (double)(state >> 11) * 0x1p-53 < probability;
}

/* Eq. 3 and 4. */
static void observe(int i, uint32_t black)
{
    const double t = robots[i].t += 1, n = robots[i].n += black, b = robots[i].b_hat, g = 2 * b - 1;
    const double x = (n / t + b - 1) / g, edge = g * g / (b * b * (1 - b) * (1 - b));
    const double inner = g * g * t * t * t / (n * (t - n)), rare = x <= 0 ? t - n : n;
    robots[i].x_hat = x < 0 ? 0 : x > 1 ? 1 : x;
    robots[i].alpha = x > 0 && x < 1 ? inner : edge * (t * b * b - g * rare);
}

static void hear(int receiver, int sender)
{
    robots[receiver].heard_alpha += robots[sender].alpha;
    robots[receiver].heard_alpha_x += robots[sender].alpha * robots[sender].x_hat;
}

/* All hear all, so all have one x. */
static void full_step(int k)
{
    double alpha = 0, alpha_x = 0;
    for (int i = 0; i < 10; ++i) {
        observe(i, draw(0.545));
        alpha += robots[i].alpha;
        alpha_x += robots[i].alpha * robots[i].x_hat;
    }
    series[0][k] = (float)(alpha_x / alpha);
}

/* By the arena's links they hear what was said a step ago. */
static void moving_step(int k)
{
    mcp_asdf_arena_step(&arena, 1);
    for (uint32_t p = 0; p < arena.link_count; ++p) {
        hear(arena.links[p].a, arena.links[p].b);
        hear(arena.links[p].b, arena.links[p].a);
    }
    for (int i = 0; i < MOST; ++i) {
        observe(i, draw(0.95) == arena.black[i]);
        const double alpha = robots[i].alpha + robots[i].heard_alpha;
        series[i][k] = (float)((robots[i].alpha * robots[i].x_hat + robots[i].heard_alpha_x) / alpha);
        robots[i].heard_alpha = robots[i].heard_alpha_x = 0;
    }
}

int main(int argc, char **argv)
{
    const int moves = argc == 3 && argv[1][0] == 'm', trials = argc == 3 ? atoi(argv[2]) : 1;
    mcp_asdf_arena_config_t world = {0, MOST, 5.5486, 5.5486, 0.1414, 0.7, 0.1, 0.01, 0.55, NULL, 0, 0};
    const clock_t start = clock();
    for (; world.seed < (uint64_t)trials && mcp_asdf_arena_init(&arena, &world, memory); ++world.seed) {
        for (int i = 0; i < MOST; ++i) {
            robots[i].b_hat = i % 10 < 3 ? 0.55 : 0.95;
            robots[i].t = robots[i].n = 0;
        }
        for (int k = 0; k < STEPS; ++k) {
            (moves ? moving_step : full_step)(k);
        }
    }
    const double seconds = (double)(clock() - start) / CLOCKS_PER_SEC, used = (double)series[0][STEPS - 1];
    return printf("%.6g %g\n", (double)trials * STEPS * (moves ? MOST : 10) / seconds, used) < 0;
}
