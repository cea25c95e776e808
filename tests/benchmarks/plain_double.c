/* A fully connected swarm: a yardstick of engine.py. Prints robot-steps per second of processor time. */
#include "plain_double.h"

#include <stdio.h>
#include <stdlib.h>
#include <time.h>

enum { ROBOTS = 10, STEPS = 40000, PERIOD = 1000, FLAWED = 3 };
static const double T_SCORE = 0.0646, PROBABILITY = 0.545; /* t for m = 9, omega = 0.05; f = 0.55, b = 0.95 */

static void filter(robot_t *robots, double t, const heard_t *all)
{
    for (int i = 0; i < ROBOTS; ++i) {
        const robot_t *const own = &robots[i];
        const double x = own->x_hat;
        const heard_t others = {ROBOTS - 1, all->x - x, all->squares - x * x, all->weight - own->alpha,
                                all->weighted - own->alpha * x};
        test_and_update(&robots[i], t, &others, T_SCORE);
    }
}

static void run(robot_t *robots, float *series)
{
    for (int k = 1; k <= STEPS; ++k) {
        heard_t all = {0};
        for (int i = 0; i < ROBOTS; ++i) {
            observe(&robots[i], k, draw(PROBABILITY));
            all.x += robots[i].x_hat;
            all.squares += robots[i].x_hat * robots[i].x_hat;
            all.weight += robots[i].alpha;
            all.weighted += robots[i].alpha * robots[i].x_hat;
        }
        series[k] = (float)(all.weighted / all.weight);
        if (k % PERIOD == 0) {
            filter(robots, k, &all);
        }
    }
}

int main(int argc, char **argv)
{
    static float series[STEPS + 1];
    const int trials = argc > 1 ? atoi(argv[1]) : 100;
    double check = 0;
    const clock_t start = clock();
    for (int trial = 0; trial < trials; ++trial) {
        robot_t robots[ROBOTS];
        for (int i = 0; i < ROBOTS; ++i) {
            robots[i] = (robot_t){0, i < FLAWED ? 0.55 : 0.95, 0.5, 0};
        }
        run(robots, series);
        check += (double)series[STEPS];
    }
    const double seconds = (double)(clock() - start) / CLOCKS_PER_SEC;
    printf("%.6g %.6g\n", (double)trials * STEPS * ROBOTS / seconds, check / trials);
    return 0;
}
