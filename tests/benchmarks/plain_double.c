/* A fully connected swarm in plain double C, as one writes it who wants nothing but speed: the yardstick of
 * engine.py. Prints the robot-steps of a second of processor time. */
#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

enum { ROBOTS = 10, STEPS = 40000, PERIOD = 1000, FLAWED = 3 };
static const double T_SCORE = 0.0646, PROBABILITY = 0.545; /* t for m = 9, omega = 0.05; f = 0.55, b = 0.95 */

typedef struct {
    double n, b_hat, x_hat, alpha;
} robot_t;

static uint64_t state = 88172645463325252u;

static int draw(void)
{
    state ^= state << 13;
    state ^= state >> 7;
    state ^= state << 17;
    return (double)(state >> 11) * 0x1p-53 < PROBABILITY;
}

static void observe(robot_t *robot, double t)
{
    const double b = robot->b_hat, d = 2 * b - 1, n = robot->n += draw();
    const double x = (n / t + b - 1) / d;
    if (x <= 0 || x >= 1) {
        const double rare = x <= 0 ? n : t - n;
        robot->x_hat = x > 0;
        robot->alpha = d * d * (rare / ((1 - b) * (1 - b)) + (t - rare) / (b * b));
    } else {
        robot->x_hat = x;
        robot->alpha = d * d * t * t * t / (n * (t - n));
    }
}

static void filter(robot_t *robots, double t, double sum, double squares, double weight, double weighted)
{
    const double m = ROBOTS - 1;
    for (int i = 0; i < ROBOTS; ++i) {
        robot_t *const own = &robots[i];
        const double x = own->x_hat, mean = (sum - x) / m;
        const double spread = sqrt(fabs((squares - x * x) - m * mean * mean) / (m - 1));
        const double x_bar = (weighted - own->alpha * x) / (weight - own->alpha);
        if (fabs(mean - x) > (T_SCORE / sqrt(m) + 1) * spread) {
            own->b_hat = fmin(fmax((own->n / t + x_bar - 1) / (2 * x_bar - 1), 1e-6), 1 - 1e-6);
        }
    }
}

static void run(robot_t *robots, float *series)
{
    for (int k = 1; k <= STEPS; ++k) {
        double sum = 0, squares = 0, weight = 0, weighted = 0;
        for (int i = 0; i < ROBOTS; ++i) {
            observe(&robots[i], k);
            sum += robots[i].x_hat;
            squares += robots[i].x_hat * robots[i].x_hat;
            weight += robots[i].alpha;
            weighted += robots[i].alpha * robots[i].x_hat;
        }
        series[k] = (float)(weighted / weight);
        if (k % PERIOD == 0) {
            filter(robots, k, sum, squares, weight, weighted);
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
        check += series[STEPS];
    }
    const double seconds = (double)(clock() - start) / CLOCKS_PER_SEC;
    printf("%.6g %.6g\n", (double)trials * STEPS * ROBOTS / seconds, check / trials);
    return 0;
}
