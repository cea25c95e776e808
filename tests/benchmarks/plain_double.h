/* The method in plain double C, written for speed alone: shared by the yardsticks of engine.py. */
#ifndef PLAIN_DOUBLE_H
#define PLAIN_DOUBLE_H

#include <math.h>
#include <stdint.h>

typedef struct {
    double n, b_hat, x_hat, alpha;
} robot_t;

static uint64_t state = 88172645463325252u;

static int draw(double probability)
{
    state ^= state << 13;
    state ^= state >> 7;
    state ^= state << 17;
    return (double)(state >> 11) * 0x1p-53 < probability;
}

static void observe(robot_t *robot, double t, int black)
{
    const double b = robot->b_hat, d = 2 * b - 1, n = robot->n += black;
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

/* Sums over the messages that a robot hears. */
typedef struct {
    double count, x, squares, weight, weighted;
} heard_t;

static void test_and_update(robot_t *own, double t, const heard_t *heard, double t_score)
{
    const double m = heard->count, mean = heard->x / m;
    const double spread = sqrt(fabs(heard->squares - m * mean * mean) / (m - 1));
    const double x_bar = heard->weighted / heard->weight;
    if (fabs(mean - own->x_hat) > (t_score / sqrt(m) + 1) * spread) {
        own->b_hat = fmin(fmax((own->n / t + x_bar - 1) / (2 * x_bar - 1), 1e-6), 1 - 1e-6);
    }
}

#endif
