/* The baseline: step and x of a robot as one would write them down in floating point, in REAL (float or
 * double). It checks nothing and forgets nothing, heard the same ten neighbours in every round, and its
 * filter is never due. */
#include <stdint.h>

typedef struct {
    REAL alpha, alpha_x;
    uint32_t m;
} sums_t;

static struct {
    REAL b_hat, x_hat, alpha;
    uint32_t t, n, filter_left;
    sums_t open, closed;
} own = {.b_hat = (REAL)0.55, .filter_left = 1000};

void plain_hear(void);
void plain_step(unsigned z);
uint32_t plain_x(void);

static REAL confidence(REAL t, REAL n)
{
    const REAL b = own.b_hat, d = (2 * b - 1) * (2 * b - 1), w = (1 - b) * (1 - b);
    if (own.x_hat <= 0) {
        return d * (t * b * b - (2 * b - 1) * (t - n)) / (b * b * w);
    }
    if (own.x_hat >= 1) {
        return d * (t * b * b - (2 * b - 1) * n) / (b * b * w);
    }
    return d * t * t * t / (n * (t - n));
}

/* A round of ten messages. */
void plain_hear(void)
{
    for (; own.open.m < 10; ++own.open.m) {
        const REAL alpha = (REAL)(900 + own.open.m);
        own.open.alpha += alpha;
        own.open.alpha_x += alpha * (REAL)0.53;
    }
}

void plain_step(unsigned z)
{
    const REAL t = (REAL)(own.t += 1), n = (REAL)(own.n += z);
    REAL x = (n / t + own.b_hat - 1) / (2 * own.b_hat - 1);
    x = x < 0 ? 0 : x;
    own.x_hat = x > 1 ? 1 : x;
    own.alpha = confidence(t, n);
    own.closed = own.open;
    own.open = (sums_t){0};
    --own.filter_left;
}

/* Unit 2^-23. */
uint32_t plain_x(void)
{
    return (uint32_t)((own.alpha * own.x_hat + own.closed.alpha_x) / (own.alpha + own.closed.alpha) *
                      8388608);
}

int main(void)
{
    plain_hear();
    return (int)plain_x();
}
