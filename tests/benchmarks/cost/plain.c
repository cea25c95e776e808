/* The baseline: the same equations as one would write them down, in REAL (float or double), divided like the
 * firmware's: x when it is read, x_bar when the test has rejected. It checks nothing, does not look for
 * repeated messages, and forgets nothing; the test has no square root, as the firmware's. */
#include "robot.h"

#include "mcp_asdf_arithmetic.h"

#ifndef REAL
#define REAL double
#endif

typedef struct {
    REAL b_hat, x_hat, alpha, beta, beta_x;
    REAL sum_alpha, sum_alpha_x, sum_x, sum_x_squared;
    uint32_t t, n, m, filter_left, filter_period, updates;
} plain_t;

plain_t robot;

void plain_observe(plain_t *own, mcp_asdf_observation_t z);
void plain_receive(plain_t *own, uint8_t sender, uint32_t x_hat, uint32_t alpha);
void plain_settle(plain_t *own);
void plain_step(plain_t *own, mcp_asdf_observation_t z);
uint32_t plain_x(const plain_t *own);

void bench_start(uint32_t b_hat)
{
    robot = (plain_t){0};
    robot.b_hat = (REAL)b_hat * (REAL)(1.0 / 4294967296.0);
}

void bench_set(uint32_t filter_period, uint32_t memory, uint32_t t, uint32_t n)
{
    (void)memory; /* it keeps all */
    robot.filter_left = robot.filter_period = filter_period;
    robot.t = t;
    robot.n = n;
}

uint32_t bench_updates(void) { return robot.updates; }

uint32_t bench_size(void) { return (uint32_t)sizeof robot; }

static REAL confidence(const plain_t *own, REAL t, REAL n)
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

void plain_observe(plain_t *own, mcp_asdf_observation_t z)
{
    ++own->t;
    own->n += (uint32_t)z;
    const REAL t = (REAL)own->t, n = (REAL)own->n;
    REAL x = (n / t + own->b_hat - 1) / (2 * own->b_hat - 1);
    x = x < 0 ? 0 : x;
    own->x_hat = x > 1 ? 1 : x;
    own->alpha = confidence(own, t, n);
}

void plain_receive(plain_t *own, uint8_t sender, uint32_t x_hat, uint32_t alpha)
{
    union {
        uint32_t bits;
        float value;
    } number = {alpha};
    const REAL x = (REAL)x_hat * (REAL)(1.0 / 8388608.0), a = (REAL)number.value;
    (void)sender;
    own->sum_alpha += a;
    own->sum_alpha_x += a * x;
    own->sum_x += x;
    own->sum_x_squared += x * x;
    ++own->m;
}

static void filter(plain_t *own)
{
    const REAL m = (REAL)own->m, difference = own->sum_x - m * own->x_hat;
    const REAL spread = m * own->sum_x_squared - own->sum_x * own->sum_x;
    const REAL k =
        (REAL)MCP_ASDF_READ_WORD(&TABLE_OF(Q)[own->m <= Q ? own->m : Q + 1]) * (REAL)(1.0 / 67108864.0);
    if (difference * difference > k * spread) {
        const REAL x_bar = own->sum_alpha_x / own->sum_alpha;
        const REAL b = ((REAL)own->n / (REAL)own->t + x_bar - 1) / (2 * x_bar - 1);
        ++own->updates;
        own->b_hat = b < (REAL)1e-6 ? (REAL)1e-6 : b > 1 - (REAL)1e-6 ? 1 - (REAL)1e-6 : b;
    }
}

void plain_settle(plain_t *own)
{
    own->beta = own->sum_alpha;
    own->beta_x = own->sum_alpha_x;
    if (--own->filter_left == 0) {
        own->filter_left = own->filter_period;
        if (own->m >= 2) {
            filter(own);
        }
    }
    own->sum_alpha = own->sum_alpha_x = own->sum_x = own->sum_x_squared = 0;
    own->m = 0;
}

void plain_step(plain_t *own, mcp_asdf_observation_t z)
{
    plain_observe(own, z);
    plain_settle(own);
}

/* Unit 2^-23. */
uint32_t plain_x(const plain_t *own)
{
    return (uint32_t)((own->alpha * own->x_hat + own->beta_x) / (own->alpha + own->beta) * 8388608);
}

int main(void)
{
    bench_start(UINT32_C(0xF3333333));
    bench_set(1000, 0, 0, 0);
    plain_observe(&robot, MCP_ASDF_BLACK);
    plain_receive(&robot, 6, 0, 0);
    plain_settle(&robot);
    return (int)plain_x(&robot);
}
