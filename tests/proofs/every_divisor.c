/* prepare() for every divisor, and for every word that damaged memory can hold in its place.
 *
 * It reads the upper 24 bits of its argument alone, as the first loop shows on the lowest and the highest
 * word of each 256 and on one between. LEAST is the least divisor, LOST_TIMES / LOST_OVER of 2^-13 how much
 * of itself a reciprocal may be too small. A product with the largest of 256 divisors is the largest, one
 * with the smallest the smallest: these two decide for all. */
#include "mcp_asdf_arithmetic.h"

#include <stdio.h>

#ifndef LEAST /* as analysers see it; the test defines all three */
#define LEAST (UINT32_C(1) << 30)
#define LOST_TIMES 1
#define LOST_OVER 1
#endif
#define GREATEST (UINT64_C(1) << 31)
#define ONE (UINT64_C(1) << 46)

static uint32_t depends_on_lower_bits(void)
{
    uint32_t wrong = 0;
    for (uint32_t step = 0; step < UINT32_C(1) << 24; ++step) {
        const uint32_t first = step << 8, found = prepare(first);
        wrong += found != prepare(first | 0xFF) || found != prepare(first | (step & 0xFF));
    }
    return wrong;
}

static uint32_t beyond_bounds(void)
{
    uint32_t wrong = 0;
    for (uint64_t first = LEAST; first <= GREATEST; first += 256) {
        const uint64_t last = first == GREATEST ? first : first + 255, found = prepare((uint32_t)first);
        wrong += found * last > ONE || (ONE - found * first) * LOST_OVER > LOST_TIMES * (ONE >> 13);
    }
    return wrong;
}

int main(void)
{
    const uint32_t dependent = depends_on_lower_bits(), beyond = beyond_bounds();
    printf("%lu depend on lower bits, %lu beyond bounds\n", (unsigned long)dependent, (unsigned long)beyond);
    return dependent != 0 || beyond != 0;
}
