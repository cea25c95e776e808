/* The baseline as a robot with the firmware's calls: the equations of plain.h in REAL (float or double). */
#include "../plain.h"
#include "mcp_asdf_arithmetic.h"
#include "robot.h"

typedef struct {
    plain_t own;
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
    robot.own.b_hat = (REAL)b_hat * (REAL)(1.0 / 4294967296.0);
}

void bench_set(uint32_t filter_period, uint32_t memory, uint32_t t, uint32_t n)
{
    (void)memory; /* it keeps all */
    robot.filter_left = robot.filter_period = filter_period;
    robot.own.t = t;
    robot.own.n = n;
}

uint32_t bench_updates(void) { return robot.updates; }

uint32_t bench_size(void) { return (uint32_t)sizeof robot; }

void plain_robot_observe(plain_robot_t *own, mcp_asdf_observation_t z)
{
    plain_observe(&own->own, (uint32_t)z);
}

void plain_robot_receive(plain_robot_t *own, uint8_t sender, uint32_t x_hat, uint32_t alpha)
{
    union {
        uint32_t bits;
        float value;
    } number = {alpha};
    (void)sender;
    plain_hear(&own->open, (REAL)x_hat * (REAL)(1.0 / 8388608.0), (REAL)number.value);
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
            own->updates += (uint32_t)plain_filter(&own->own, &own->open, (REAL)k * (REAL)(1.0 / 67108864.0));
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
    const REAL alpha = own->own.alpha;
    return (uint32_t)((alpha * own->own.x_hat + own->beta_x) / (alpha + own->beta) * 8388608);
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
