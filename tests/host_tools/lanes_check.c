/* The lanes' divisions against exact ones: what shows in an estimate only once in a million steps. */
#include "lanes.c"

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

int main(void)
{
    int failed = check_divide_24();
    for (uint32_t t = 1; t <= 3000; ++t) {
        failed |= check_ratio(t);
    }
    for (uint32_t t = MCP_ASDF_ENGINE_LANES_MAX_COUNT - 200; t <= MCP_ASDF_ENGINE_LANES_MAX_COUNT; ++t) {
        failed |= check_ratio(t);
    }
    return failed;
}
