/* The baseline: the same equations as one would write them down, in REAL (float or double), without checks.
 */
#include <stdint.h>

#ifndef REAL
#define REAL double
#endif

typedef struct {
    REAL b, x_hat, alpha, x_bar, beta, x;
    REAL sum_alpha, sum_alpha_x, sum_x, sum_x_squared;
    uint32_t t, n, m;
} plain_t;

plain_t plain;

void plain_set(uint32_t b_q32, uint32_t t, uint32_t n);
void plain_receive(uint32_t x_q23, uint32_t alpha);
void plain_observe(uint32_t black);
void plain_settle(void);
void plain_step(uint32_t black);

void plain_set(uint32_t b_q32, uint32_t t, uint32_t n)
{
    plain = (plain_t){0};
    plain.b = (REAL)b_q32 / (REAL)4294967296.0;
    plain.t = t;
    plain.n = n;
}

static REAL confidence(REAL t, REAL n)
{
    const REAL b = plain.b, d = (2 * b - 1) * (2 * b - 1), w = (1 - b) * (1 - b);
    if (plain.x_hat <= 0) {
        return d * (t * b * b - (2 * b - 1) * (t - n)) / (b * b * w);
    }
    if (plain.x_hat >= 1) {
        return d * (t * b * b - (2 * b - 1) * n) / (b * b * w);
    }
    return d * t * t * t / (n * (t - n));
}

void plain_observe(uint32_t black)
{
    ++plain.t;
    plain.n += black;
    const REAL t = (REAL)plain.t, n = (REAL)plain.n;
    REAL x = (n / t + plain.b - 1) / (2 * plain.b - 1);
    x = x < 0 ? 0 : x;
    plain.x_hat = x > 1 ? 1 : x;
    plain.alpha = confidence(t, n);
}

void plain_receive(uint32_t x_q23, uint32_t alpha_bits)
{
    union {
        uint32_t bits;
        float value;
    } alpha = {alpha_bits};
    const REAL x = (REAL)x_q23 * (REAL)(1.0 / 8388608.0), a = (REAL)alpha.value;
    plain.sum_alpha += a;
    plain.sum_alpha_x += a * x;
    plain.sum_x += x;
    plain.sum_x_squared += x * x;
    ++plain.m;
}

void plain_settle(void)
{
    plain.beta = plain.sum_alpha;
    plain.x_bar = plain.m > 0 ? plain.sum_alpha_x / plain.sum_alpha : 0;
    plain.x = (plain.alpha * plain.x_hat + plain.sum_alpha_x) / (plain.alpha + plain.sum_alpha);
    plain.sum_alpha = plain.sum_alpha_x = plain.sum_x = plain.sum_x_squared = 0;
    plain.m = 0;
}

void plain_step(uint32_t black)
{
    plain_observe(black);
    plain_settle();
}
