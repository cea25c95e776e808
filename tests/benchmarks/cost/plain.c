/* The baseline as a robot with the firmware's calls: the method as one would write it down in floating point,
 * in REAL (float or double). It checks nothing and forgets nothing; the test has no square root, as the
 * firmware's. */
#include "mcp_asdf_arithmetic.h"
#include "robot.h"

/* Sums over the messages of a round. */
typedef struct {
    REAL alpha, alpha_x, x, x_squared;
    uint32_t m;
} plain_sums_t;

typedef struct {
    REAL b_hat, x_hat, alpha;
    uint32_t t, n;
    plain_sums_t open;
    REAL beta, beta_x;
    uint32_t filter_left, filter_period, updates;
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

uint32_t bench_updates(void) { return robot.updates; }

uint32_t bench_size(void) { return (uint32_t)sizeof robot; }

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

void plain_robot_receive(plain_robot_t *own, uint8_t sender, uint32_t x_hat, uint32_t alpha)
{
    union {
        uint32_t bits;
        float value;
    } number = {alpha};
    const REAL x = (REAL)x_hat * (REAL)(1.0 / 8388608.0), confidence_of_x = (REAL)number.value;
    plain_sums_t *const sums = &own->open;
    (void)sender;
    sums->alpha += confidence_of_x;
    sums->alpha_x += confidence_of_x * x;
    sums->x += x;
    sums->x_squared += x * x;
    ++sums->m;
}

/* Whether b_hat changed; k is k_m of the t-table. */
static uint32_t filter(plain_robot_t *own, REAL k)
{
    const plain_sums_t *const sums = &own->open;
    const REAL m = (REAL)sums->m, difference = sums->x - m * own->x_hat;
    if (difference * difference <= k * (m * sums->x_squared - sums->x * sums->x)) {
        return 0;
    }
    const REAL x_bar = sums->alpha_x / sums->alpha;
    const REAL b = ((REAL)own->n / (REAL)own->t + x_bar - 1) / (2 * x_bar - 1);
    own->b_hat = b < (REAL)1e-6 ? (REAL)1e-6 : b > 1 - (REAL)1e-6 ? 1 - (REAL)1e-6 : b;
    return 1;
}

void plain_robot_settle(plain_robot_t *own)
{
    const uint32_t m = own->open.m;
    own->beta = own->open.alpha;
    own->beta_x = own->open.alpha_x;
    if (--own->filter_left == 0) {
        own->filter_left = own->filter_period;
        if (m >= 2) {
            const uint32_t k = MCP_ASDF_READ_WORD(&TABLE_OF(Q)[m <= Q ? m : Q + 1]);
            own->updates += filter(own, (REAL)k * (REAL)(1.0 / 67108864.0));
        }
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
    return (uint32_t)((own->alpha * own->x_hat + own->beta_x) / (own->alpha + own->beta) * 8388608);
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
