/* The lanes' divisions against exact ones, and their estimates against the firmware's: what shows in an
 * experiment only once in a million steps. */
#define LANES 16

#include "lanes.h"

#include <stdio.h>

static uint64_t state = 88172645463325252U;

static uint32_t word(void)
{
    state ^= state << 13;
    state ^= state >> 7;
    state ^= state << 17;
    return (uint32_t)(state >> 32);
}

/* Pairs whose quotient is just below an integer are what the remainder is for; some must have been met. */
static int check_divide_24(void)
{
    uint32_t close = 0;
    for (uint32_t i = 0; i < 20000000; ++i) {
        const uint32_t scale = (word() >> 2) + (UINT32_C(1) << 30),
                       spread = (word() >> 2) + (UINT32_C(1) << 30);
        const uint64_t dividend = (uint64_t)scale << 24;
        close += dividend % spread > spread - (spread >> 20);
        if (divide_24(scale, spread) != dividend / spread) {
            printf("divide_24(%u, %u)\n", (unsigned)scale, (unsigned)spread);
            return 1;
        }
    }
    return close == 0;
}

static int check_ratio(uint32_t t)
{
    const step_t step = step_at(t);
    for (uint32_t rare = 0; rare <= t / 2; ++rare) {
        if (ratio(rare, &step) != ((uint64_t)rare << 32) / t) {
            printf("ratio(%u) at t = %u\n", (unsigned)rare, (unsigned)t);
            return 1;
        }
    }
    return 0;
}

/* Every n of every t up to 400. An alpha that differs in its last bit seldom shows in x. */
static int check_estimates(uint32_t b_hat)
{
    static const mcp_asdf_config_t config = {0, 1, 1, MCP_ASDF_MEMORY_MAX, MCP_ASDF_OFF};
    static robot_lanes_t lanes;
    mcp_asdf_t robot;
    if (mcp_asdf_init(&robot, &config, 0, b_hat) != MCP_ASDF_OK) {
        return 1;
    }
    load(&lanes, 3, &robot);
    for (uint32_t t = 1; t <= 400; ++t) {
        const step_t step = step_at(t);
        for (uint32_t n = 0; n < t; ++n) {
            mcp_asdf_sums_t sums = {0};
            robot.t = t - 1;
            robot.n = lanes.n[3] = n;
            (void)mcp_asdf_observe(&robot, MCP_ASDF_WHITE);
            (void)mcp_asdf_sums_add(&sums, mcp_asdf_x_hat(&robot), mcp_asdf_alpha(&robot));
            const estimate_t estimate = observe_lane(&lanes, 3, 0, &step);
            if (estimate.alpha != sums.alpha ||
                (sums.alpha != 0 && estimate.x_hat != mcp_asdf_x_hat(&robot))) {
                printf("b_hat %u, t %u, n %u\n", (unsigned)b_hat, (unsigned)t, (unsigned)n);
                return 1;
            }
        }
    }
    return 0;
}

/* Accuracies that have fractions n / t at the ends of the scale, and their neighbours. */
static int check_all_estimates(void)
{
    int failed = check_estimates(MCP_ASDF_B_HAT_MIN) | check_estimates(MCP_ASDF_B_HAT_MAX);
    for (uint32_t twentieths = 1; twentieths < 20; ++twentieths) {
        const uint32_t b_hat = (uint32_t)((UINT64_C(1) << 32) * twentieths / 20);
        failed |= check_estimates(b_hat - 1) | check_estimates(b_hat) | check_estimates(b_hat + 1);
    }
    for (uint32_t i = 0; i < 20; ++i) {
        failed |= check_estimates(word() | MCP_ASDF_B_HAT_MIN);
    }
    return failed;
}

int main(void)
{
    int failed = check_divide_24() | check_all_estimates();
    for (uint32_t t = 1; t <= 3000; ++t) {
        failed |= check_ratio(t);
    }
    for (uint32_t t = MCP_ASDF_ENGINE_LANES_MAX_COUNT - 200; t <= MCP_ASDF_ENGINE_LANES_MAX_COUNT; ++t) {
        failed |= check_ratio(t);
    }
    return failed;
}
