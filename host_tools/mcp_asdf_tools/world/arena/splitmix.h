/* splitmix64: random numbers from a counter and a mixing function that is also a good hash. G. L. Steele,
 * D. Lea, C. H. Flood, "Fast splittable pseudorandom number generators", OOPSLA 2014. */
#ifndef MCP_ASDF_SPLITMIX_H
#define MCP_ASDF_SPLITMIX_H

#include <stdint.h>

static inline uint64_t splitmix(uint64_t z)
{
    z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9U;
    z = (z ^ (z >> 27)) * 0x94D049BB133111EBU;
    return z ^ (z >> 31);
}

/* The next number, uniform in [0, 1), of 53 bits. */
static inline double splitmix_uniform(uint64_t *counter)
{
    *counter += 0x9E3779B97F4A7C15U;
    return (double)(splitmix(*counter) >> 11) * 0x1p-53;
}

#endif
