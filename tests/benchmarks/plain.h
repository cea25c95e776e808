/* The method as one would write it down in floating point: the baseline of cost. REAL is double unless it is
 * defined. It checks nothing and forgets nothing; the test has no square root, as the firmware's. */
#ifndef PLAIN_H
#define PLAIN_H

#include <stdint.h>

#ifndef REAL
#define REAL double
#endif

typedef struct {
    REAL b_hat, x_hat, alpha;
    uint32_t t, n;
} plain_t;

/* Sums over the messages of a round. */
typedef struct {
    REAL alpha, alpha_x, x, x_squared;
    uint32_t m;
} plain_sums_t;

static REAL plain_confidence(const plain_t *own, REAL t, REAL n)
{
    const REAL b = own->b_hat, d = (2 * b - 1) * (2 * b - 1), w = (1 - b) * (1 - b);
    if (own->x_hat <= 0) {
        return d * (t * b * b - (2 * b - 1) * (t - n)) / (b * b * w);
    }
    if (own->x_hat >= 1) {
        return d * (t * b * b - (2 * b - 1) * n) / (b * b * w);
    }
    return d * t * t * t / (n * (t - n));
}

static void plain_observe(plain_t *own, uint32_t black)
{
    const REAL t = (REAL)(own->t += 1), n = (REAL)(own->n += black);
    REAL x = (n / t + own->b_hat - 1) / (2 * own->b_hat - 1);
    x = x < 0 ? 0 : x;
    own->x_hat = x > 1 ? 1 : x;
    own->alpha = plain_confidence(own, t, n);
}

static void plain_hear(plain_sums_t *sums, REAL x_hat, REAL alpha)
{
    sums->alpha += alpha;
    sums->alpha_x += alpha * x_hat;
    sums->x += x_hat;
    sums->x_squared += x_hat * x_hat;
    ++sums->m;
}

/* Whether b_hat changed; k is k_m of the t-table. */
static int plain_filter(plain_t *own, const plain_sums_t *sums, REAL k)
{
    const REAL m = (REAL)sums->m, difference = sums->x - m * own->x_hat;
    if (difference * difference <= k * (m * sums->x_squared - sums->x * sums->x)) {
        return 0;
    }
    const REAL x_bar = sums->alpha_x / sums->alpha;
    const REAL b = ((REAL)own->n / (REAL)own->t + x_bar - 1) / (2 * x_bar - 1);
    own->b_hat = b < (REAL)1e-6 ? (REAL)1e-6 : b > 1 - (REAL)1e-6 ? 1 - (REAL)1e-6 : b;
    return 1;
}

#endif
