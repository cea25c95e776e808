/* The baseline as a robot with the firmware's calls: the method as one would write it down in floating point,
 * in REAL (float or double). It checks nothing and forgets nothing, and has no filter: the steps that are
 * compared are those in which the filter is not due. */
#include "robot.h"

typedef struct {
    REAL alpha, alpha_x;
    uint32_t m;
} plain_sums_t;

typedef struct {
    REAL b_hat, x_hat, alpha;
    uint32_t t, n;
    plain_sums_t open, closed;
    uint32_t filter_left, filter_period;
} plain_robot_t;

plain_robot_t robot;

void plain_robot_observe(plain_robot_t *own, mcp_asdf_observation_t z);
void plain_robot_receive(plain_robot_t *own, uint8_t sender, uint32_t x_hat, uint32_t alpha);
void plain_robot_settle(plain_robot_t *own);
void plain_robot_step(plain_robot_t *own, mcp_asdf_observation_t z);
uint32_t plain_robot_x(const plain_robot_t *own);

void bench_start(uint32_t b_hat)
{
    robot = (plain_robot_t){0};
    robot.b_hat = (REAL)b_hat * (REAL)(1.0 / 4294967296.0);
}

void bench_set(uint32_t filter_period, uint32_t memory, uint32_t t, uint32_t n)
{
    (void)memory; /* it keeps all */
    robot.filter_left = robot.filter_period = filter_period;
    robot.t = t;
    robot.n = n;
}

uint32_t bench_updates(void) { return 0; }

static REAL confidence(const plain_robot_t *own, REAL t, REAL n)
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

void plain_robot_observe(plain_robot_t *own, mcp_asdf_observation_t z)
{
    const REAL t = (REAL)(own->t += 1), n = (REAL)(own->n += (uint32_t)z);
    REAL x = (n / t + own->b_hat - 1) / (2 * own->b_hat - 1);
    x = x < 0 ? 0 : x;
    own->x_hat = x > 1 ? 1 : x;
    own->alpha = confidence(own, t, n);
}

/* alpha is binary32, as in a frame. */
void plain_robot_receive(plain_robot_t *own, uint8_t sender, uint32_t x_hat, uint32_t alpha)
{
    union {
        uint32_t bits;
        float value;
    } number = {alpha};
    const REAL x = (REAL)x_hat * (REAL)(1.0 / 8388608.0), confidence_of_x = (REAL)number.value;
    (void)sender;
    own->open.alpha += confidence_of_x;
    own->open.alpha_x += confidence_of_x * x;
    ++own->open.m;
}

void plain_robot_settle(plain_robot_t *own)
{
    own->closed = own->open;
    if (--own->filter_left == 0) {
        own->filter_left = own->filter_period;
    }
    own->open = (plain_sums_t){0};
}

void plain_robot_step(plain_robot_t *own, mcp_asdf_observation_t z)
{
    plain_robot_observe(own, z);
    plain_robot_settle(own);
}

/* Unit 2^-23. */
uint32_t plain_robot_x(const plain_robot_t *own)
{
    return (uint32_t)((own->alpha * own->x_hat + own->closed.alpha_x) / (own->alpha + own->closed.alpha) *
                      8388608);
}

int main(void)
{
    bench_start(UINT32_C(0xF3333333));
    bench_set(1000, 0, 0, 0);
    plain_robot_observe(&robot, MCP_ASDF_BLACK);
    plain_robot_receive(&robot, 6, 0, 0);
    plain_robot_settle(&robot);
    return (int)plain_robot_x(&robot);
}
